"""Scenes that are hard for samplers of light, each for one reason, with scans at random places.

Most are the closed room of `tests/rooms.py` with one thing changed.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import trimesh
from handmade_rooms import l_corridor
from numpy.typing import ArrayLike, NDArray
from rooms import bins_of_path, furnished_box, rectangle, square_pixels

from datagen.records import GGX, Capture, Lambertian, Laser, Material, Part, Phong, Retroreflector, Scene, Sensor

DEVICE = (1.5, 0.1, 1.3)
GAP_M = 0.002
TIME = bins_of_path(256, 0.05, 0.0)
WALL = Part("relay_wall", rectangle((0, 0, 1.25), (0, 1.5, 0), (0, 0, 1.25)), Lambertian(0.7), "relay_wall")
FLOOR = Part("floor", rectangle((2, 0, 0), (2, 0, 0), (0, 1.5, 0)), Lambertian(0.5), "structure")
Points = NDArray[np.float64]


def confocal(points: ArrayLike, half_side_m: float = 0.01, device: ArrayLike = DEVICE) -> Capture:
    return Capture(Laser(device, points), Sensor(device, square_pixels(points, half_side_m)), TIME, "confocal")


def exhaustive(lasers: ArrayLike, seen: ArrayLike, half_side_m: float = 0.01) -> Capture:
    return Capture(Laser(DEVICE, lasers), Sensor(DEVICE, square_pixels(seen, half_side_m)), TIME)


def with_objects(*meshes: trimesh.Trimesh) -> Scene:
    """A wall, a floor, and objects."""
    return Scene.from_parts([WALL, FLOOR, *(Part(f"object {k}", of, Lambertian(0.6)) for k, of in enumerate(meshes))])


def of_material(material: Material, *names: str) -> Scene:
    """The closed room, some parts of which are made of a material."""
    room = furnished_box()
    made = [material if name in names else of for name, of in zip(room.part_names, room.materials, strict=True)]
    return replace(room, materials=tuple(made))


def crease() -> trimesh.Trimesh:
    """Two faces of 2 × 4 cm that meet at a right angle and are open towards the wall and the device."""
    faces = [
        rectangle((0.31, 0.3, 1.2), (0.01, 0, 0), (0, 0, 0.02)),
        rectangle((0.3, 0.29, 1.2), (0, 0.01, 0), (0, 0, 0.02)),
    ]
    return trimesh.util.concatenate(faces)


def ball(subdivisions: int, radius: float, center: ArrayLike) -> trimesh.Trimesh:
    return trimesh.creation.icosphere(subdivisions=subdivisions, radius=radius).apply_translation(center)


def hard(scenes: int, first: int) -> Iterator[tuple[str, Scene, Capture]]:
    """Each hard scene, `scenes` times with other points on the wall."""
    for number in range(first, first + scenes):
        rng = np.random.default_rng([4711, number])
        places = np.column_stack([np.zeros(16), rng.uniform(-1.2, 1.2, 16), rng.uniform(0.3, 2.2, 16)])
        for name, scene, capture in _of_places(places):
            yield f"{name} {number}", scene, capture


def _of_places(places: Points) -> Iterator[tuple[str, Scene, Capture]]:
    room, few, seen = furnished_box(), places[:3], places[3:7]
    # What an object does beside the wall is hard at the places beside it.
    beside = np.array([0, 0.3, 1.2]) + 0.2 * (places - places.mean(axis=0))
    on_the_crease = DEVICE + (np.array([0.3, 0.3 - GAP_M, 1.2]) - DEVICE) * [[1.3]]
    yield "laser point 2 mm from a crease of 2 cm", with_objects(crease()), exhaustive(
        np.vstack([on_the_crease, few]), beside[:4]
    )  # fmt: skip
    yield "crease of 2 cm", with_objects(crease()), confocal(beside)
    corners = [[0, y, z] for y in (-1.5 + GAP_M, 1.5 - GAP_M) for z in (GAP_M, 2.5 - GAP_M)]
    yield "laser points 2 mm from corners", room, exhaustive(corners, seen)
    yield "lasers and pixels 2 mm from corners", room, confocal(corners, GAP_M / 2)
    plates = [
        rectangle((2, 0.5, 1.2), (0, 0.3, 0), (0, 0, 0.4)), rectangle((2, -0.2, 1.2), (0, 0.3, 0), (0, 0, 0.4)),
        rectangle((GAP_M, 0, 1.2), (0, 0.2, 0), (0, 0, 0.3)),
    ]  # fmt: skip
    yield "coplanar plates, and one on the wall", with_objects(*plates), exhaustive(few, seen)
    yield "plate that touches wall and floor", with_objects(
        rectangle((0.3, 0.2, 0.3), (0.3, 0.1, 0), (0, 0, 0.3))
    ), confocal(beside)  # fmt: skip
    inside = Scene.from_parts(
        [
            Part("ball", ball(4, 1.5, (0, 0, 0)), Lambertian(0.8), "structure"),
            Part("box", trimesh.creation.box((0.3, 0.3, 0.3)), Lambertian(0.5)),
        ]
    )
    around = (places[:, [1, 2, 0]] - [0, 1.25, 0.3]) * 1.5
    center = (0.2, -0.3, 0.5)
    sides = 0.05 * np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
    yield "device within a ball", inside, Capture(
        Laser(center, around[:3] - [0, 0, 1]), Sensor(center, around[3:7, None] - [0, 0, 1] + sides), TIME
    )  # fmt: skip
    yield "fog", replace(room, attenuation_per_m=0.5), confocal(places)
    names = ("walls", "floor", "ceiling", "box", "pillar")
    yield "objects of GGX 0.1", of_material(GGX(0.8, roughness=0.1), *names[3:]), confocal(places, 0.05)
    yield "objects of Phong 1000", of_material(Phong(0.8, exponent=1000.0), *names[3:]), exhaustive(few, seen, 0.05)
    yield "retroreflectors", of_material(Retroreflector(0.9), *names[3:]), confocal(places)
    yield "retroreflectors aside", of_material(Retroreflector(0.9), *names[3:]), exhaustive(few, seen, 0.1)
    yield "pixels of 2 mm", room, confocal(places, 0.001)
    yield "pixels of 20 cm", room, confocal(places, 0.1)
    yield "pixels of 20 cm beside a box", with_objects(
        trimesh.creation.box((0.2, 0.2, 0.2)).apply_translation((0.1, 0.3, 1.2))
    ), confocal(beside, 0.1)  # fmt: skip
    for end in (40, 80):
        early = replace(exhaustive(few, seen), time=bins_of_path(end, 0.05, 0.0))
        yield f"window that ends after {0.05 * end:.0f} m", room, early
    many = with_objects(ball(6, 0.3, (1.1, 0.5, 1.3)), ball(5, 0.2, (0.8, -0.5, 0.8)))
    yield "100 000 triangles", many, confocal(places)
    device = np.array([0.5, 0, 1])
    relay = np.array([[6, y, 1.25 + z] for y, z in 0.5 * places[:, 1:] - [0, 0.6]])
    legs = bins_of_path(400, 0.05, 0.0)
    yield "L-corridor", l_corridor(), Capture(
        Laser(device, relay[:3]), Sensor(device, square_pixels(relay[3:7], 0.05)), legs
    )  # fmt: skip
    # Last, as it takes longest, with few points and wide bins.
    mirrors = replace(confocal(places[:2], 0.1), time=bins_of_path(32, 0.4, 0.0))
    yield "enclosure of GGX 0.1", of_material(GGX(0.8, roughness=0.1), *names), mirrors
