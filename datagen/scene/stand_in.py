"""A stored room whose mesh files are gone: the room as it was drawn, and a cuboid for each of its objects."""

from __future__ import annotations

from collections.abc import Mapping

from datagen.config.scene import SceneConfig
from datagen.records import Lambertian, Part, Pose, Rectangle, Scalar, Scene
from datagen.records.arrays import Floats
from datagen.scene.draws import draw_plan
from datagen.seeding import Purpose, generator
from scene_library.rooms import surfaces
from scene_library.solids import prism, rectangle


def stand_in(
    spec: SceneConfig, seed: int, index: int, parameters: Mapping[str, Scalar], stored: Mapping[str, Floats]
) -> Scene:
    """The room of a stored scene without its meshes: every object is a cuboid of its size, at its place.

    The walls are the first that is drawn of a room, so that they need no mesh; an uneven relay wall is flat here.

    parameters : what is stored of the scene. stored : its `relay_wall` and `hidden_view` (3, 3), middle, right and
    up, and its `hidden_bounds` (2, 3).
    """
    import trimesh

    rng = generator(seed, index, Purpose.SCENE, int(parameters["draws"]) - 1)
    plan, _ = draw_plan(spec.layout, rng)
    grey = Lambertian(0.5)
    parts = [
        Part(
            name,
            trimesh.Trimesh(*surface, process=False),
            grey,
            "relay_wall" if name == "relay_wall" else "structure",
        )
        for name, surface in surfaces(plan, floor=spec.layout.floor, ceiling=spec.layout.ceiling).items()
    ]
    for key in parameters:
        name = key.removesuffix(".rotation_deg")
        if name == key:
            continue
        x, y, z, turned, width, depth, height = (
            float(parameters[f"{name}.{of}"])
            for of in ("x_m", "y_m", "z_m", "rotation_deg", "width_m", "depth_m", "height_m")
        )
        solid = prism(rectangle(max(width, 1e-3), max(depth, 1e-3)), height)
        mesh = trimesh.Trimesh(solid.placed(x, y, z, turned), solid.triangles, process=False)
        pose = Pose.upright(str(parameters[f"{name}.class"]), turned)
        parts.append(Part(name, mesh, grey, "object", pose))
    wall, view = (Rectangle(*stored[name]) for name in ("relay_wall", "hidden_view"))
    return Scene.from_parts(
        parts, relay_wall=wall, hidden_view=view, hidden_bounds=stored["hidden_bounds"], device_position=plan.device,
        parameters=parameters,
    )  # fmt: skip
