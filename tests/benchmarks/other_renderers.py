"""Other renderers to compare with: mitransient, a path tracer, and plain quadrature of an unoccluded plate.

mitransient (Royo et al., "Non-line-of-sight transient rendering", Computers & Graphics 107 (2022); PyPI) is an
optional extra: `pip install '.[peers]'` and an LLVM of version 19 or later (Debian: libllvm19).

Both give the radiance that leaves points of the relay wall towards the sensor, per emitted photon; for pixels as
small as points `photons_to_radiance` converts our transients to it. Both put the energy of a path into the bin of its
arrival time. mitransient's laser is a lamp of unit intensity, so its radiance contains the irradiance cosθ/d² of the
laser point, by which it is divided.
"""

from __future__ import annotations

import functools
import glob
import importlib.util
import math
import os
import re
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from datagen.compiled import compiled
from datagen.errors import InputError
from datagen.records import Capture, Lambertian, Laser, Rectangle, Scene, Sensor, TimeAxis
from datagen.records.arrays import Floats
from datagen.units import path_from_time

OLDEST_LLVM = 19
VARIANT = "llvm_ad_mono"
POINT_HALF_SIDE_M = 1e-4
"""Half side of the pixels that stand for points."""


def missing_for_mitransient() -> str | None:
    """Why mitransient cannot run here, in one line, or None when it can."""
    for module in ("mitsuba", "mitransient"):
        if importlib.util.find_spec(module) is None:
            return f"{module} is not installed (pip install '.[peers]')"
    if not os.environ.get("DRJIT_LIBLLVM_PATH") and _newest_llvm() is None:
        return f"no LLVM of version {OLDEST_LLVM} or later found (Debian: apt-get install libllvm19)"
    return None


def _newest_llvm() -> str | None:
    """Path of the newest LLVM library that drjit can use; None without one."""
    folders = ("/usr/lib/*", "/usr/lib", "/usr/local/lib", "/usr/lib/llvm-*/lib", "/opt/homebrew/opt/llvm/lib")
    paths = [path for folder in folders for path in glob.glob(f"{folder}/libLLVM*")]
    versions = [(re.search(r"libLLVM(?:-|\.so\.|\.)(\d+)", path), path) for path in paths]
    found = [(int(version[1]), path) for version, path in versions if version and int(version[1]) >= OLDEST_LLVM]
    return max(found)[1] if found else None


@functools.cache
def _mitsuba() -> Any:
    """Mitsuba in its LLVM variant, with mitransient's plugins registered."""
    reason = missing_for_mitransient()
    if reason:
        raise InputError(f"peer mitransient: {reason}")
    newest = _newest_llvm()
    if newest:
        os.environ.setdefault("DRJIT_LIBLLVM_PATH", newest)
    import mitsuba

    mitsuba.set_variant(VARIANT)
    mitsuba.set_log_level(mitsuba.LogLevel.Error)
    import mitransient  # noqa: F401  (importing registers its plugins)

    return mitsuba


def grid_points(wall: Rectangle, columns: int, rows: int) -> Floats:
    """(rows · columns, 3) centres of a grid of cells on the wall, row by row from −up, each row from −right."""
    u = (np.arange(columns) + 0.5) / columns * 2 - 1
    v = (np.arange(rows) + 0.5) / rows * 2 - 1
    grid = wall.center + u[None, :, None] * wall.right + v[:, None, None] * wall.up
    return grid.reshape(-1, 3)


def point_capture(
    wall: Rectangle,
    points: Floats,
    device: ArrayLike,
    laser_points: Floats,
    axis: TimeAxis,
    confocal: bool = False,
) -> Capture:
    """Our capture of pixels as small as points, for `photons_to_radiance` to read."""
    right, up = (v * (POINT_HALF_SIDE_M / np.linalg.norm(v)) for v in (wall.right, wall.up))
    corners = points[:, None] + np.stack([-right - up, right - up, right + up, -right + up])
    pairing = "confocal" if confocal else "exhaustive"
    return Capture(Laser(device, laser_points), Sensor(device, corners), axis, pairing)  # type: ignore[arg-type]


def photons_to_radiance(photons: Floats, capture: Capture) -> Floats:
    """Photons L (laser, pixel, bin) of a transient → L / (A Ω), 1/(m² sr), for pixels small enough to be points."""
    a, b, d = (capture.sensor.pixels[:, k] for k in (0, 1, 3))
    centre = capture.sensor.pixels.mean(axis=1)
    away = capture.sensor.position - centre
    solid_angle = np.abs(np.einsum("pk,pk->p", np.cross(b - a, d - a), away)) / np.linalg.norm(away, axis=1) ** 3
    per_pixel = solid_angle * capture.sensor.aperture_area_m2
    return np.asarray(photons / (per_pixel[:, None, None] if capture.pairing == "confocal" else per_pixel[:, None]))


class MitransientPeer:
    """A scene rendered by mitransient, ready to be sampled again and again.

    scene : Lambertian throughout (shaded on both sides, as ours is).
    wall_name, wall : the part that is the relay wall, and the rectangle that stands for it.
    device : (3,) laser and sensor. laser_point : (3,) on the wall; None for a confocal scan.
    columns, rows : the grid of points on the wall, powers of two (its grid lookup rounds in single precision).
    axis : of origin `wall`. bounces : highest order followed, ≥ 3; the lowest is 3 as long as the wall is flat.
    aim_at_hidden : use its hidden-geometry sampling. Only for scenes without occlusion: mitransient divides by the
        density of the one point it aimed at, so a surface before that point is counted twice. It aims at front
        faces only, whatever the material.

    Raises `InputError` when mitransient cannot run, and for scenes that it cannot render as ours does.
    """

    def __init__(
        self, scene: Scene, wall_name: str, wall: Rectangle, device: ArrayLike, laser_point: ArrayLike | None,
        columns: int, rows: int, axis: TimeAxis, bounces: int, aim_at_hidden: bool = False,
    ) -> None:  # fmt: skip
        if columns & (columns - 1) or rows & (rows - 1):
            raise InputError(f"peer mitransient: {columns} × {rows} points; its grids need powers of two")
        if axis.origin != "wall":
            raise InputError("peer mitransient: time axis of origin 'source'; use origin='wall'")
        self._mi = _mitsuba()
        self.points = grid_points(wall, columns, rows)
        device = np.asarray(device, np.float64)
        lit = self.points if laser_point is None else np.asarray(laser_point, np.float64)[None]
        away = device - lit
        self._irradiance = np.abs(away @ wall.normal) / np.linalg.norm(away, axis=1) ** 3
        target = wall.center if laser_point is None else lit[0]
        width = float(path_from_time(axis.width_s))
        bsdfs = {name: self._bsdf(scene, k) for k, name in enumerate(scene.part_names)}
        contents: dict[str, Any] = {
            "type": "scene",
            "integrator": {
                "type": "transient_nlos_path",
                "capture_type": "confocal" if laser_point is None else "single",
                "nlos_laser_sampling": True,
                "nlos_hidden_geometry_sampling": aim_at_hidden,
                "account_first_and_last_bounces": False,
                "temporal_filter": "box",
                # Its depth counts the sensor's ray too but not the laser's: depth n holds up to n bounces. Its
                # filter_bounces counts the laser point twice, so the order is chosen by depth alone.
                "max_depth": bounces,
                "rr_depth": bounces + 1,
            },
            "relay_wall": {
                "type": "rectangle",
                "to_world": self._mi.ScalarTransform4f(_frame(wall)),
                "bsdf": bsdfs[wall_name],
                "sensor": {
                    "type": "nlos_capture_meter",
                    "sensor_origin": device.tolist(),
                    "sampler": {"type": "independent"},
                    "film": {
                        "type": "transient_hdr_film", "width": columns, "height": rows,
                        "temporal_bins": axis.bins, "bin_width_opl": width,
                        "start_opl": width * (axis.start_s / axis.width_s), "rfilter": {"type": "box"},
                    },
                },
            },
            "laser": {
                "type": "spot", "intensity": 1.0, "cutoff_angle": 1.0,
                "to_world": self._mi.ScalarTransform4f().look_at(
                    origin=device.tolist(), target=target.tolist(), up=(wall.up / np.linalg.norm(wall.up)).tolist()
                ),
            },
        }  # fmt: skip
        for name, bsdf in bsdfs.items():
            if name != wall_name:
                contents[f"part_{name}"] = self._mesh(scene, name, bsdf)
        self._scene = self._mi.load_dict(contents)

    def _bsdf(self, scene: Scene, part: int) -> Any:
        material = scene.materials[part]
        if not isinstance(material, Lambertian):
            raise InputError(f"peer mitransient: part {scene.part_names[part]!r} is no Lambertian surface")
        reflectance = {"type": "spectrum", "value": material.albedo}
        return self._mi.load_dict({"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": reflectance}})

    def _mesh(self, scene: Scene, name: str, bsdf: Any) -> Any:
        used, faces = np.unique(scene.triangles[scene.faces_of(name)], return_inverse=True)
        properties = self._mi.Properties()
        properties["bsdf"], properties["face_normals"] = bsdf, True
        mesh = self._mi.Mesh(name, len(used), faces.size // 3, props=properties)
        values = self._mi.traverse(mesh)
        values["vertex_positions"] = scene.vertices[used].astype(np.float32).ravel()
        values["faces"] = faces.astype(np.uint32).ravel()
        values.update()
        return mesh

    def render(self, samples: int, seed: int) -> Floats:
        """(pixel, bin) radiance of the points, 1/(m² sr), from `samples` paths a point."""
        _, image = self._scene.integrator().render(self._scene, seed=seed, spp=samples)
        film = np.array(image, np.float64)[..., 0].reshape(len(self.points), -1)
        return np.asarray(film / self._irradiance[:, None])


def _frame(wall: Rectangle) -> Floats:
    """The 4 × 4 matrix that takes the square ±1 in x and y, facing z, to the wall."""
    matrix = np.eye(4)
    matrix[:3] = np.stack([wall.right, wall.up, wall.normal, wall.center], axis=1)
    return matrix


def plate_quadrature(
    points: Floats,
    wall_normal: Floats,
    plate: Rectangle,
    albedos: tuple[float, float],
    axis: TimeAxis,
    knots: int,
) -> Floats:
    """Three-bounce radiance of confocal points (P, 3) from an unoccluded plate, by the midpoint rule.

        L = ρ₁²ρ₂/π³ ∫ (cosθ₁ cosθ₂)²/R⁴ dA₂   (wall albedo ρ₁, plate albedo ρ₂)

    knots² midpoints a point. Returns (P, bins), 1/(m² sr).
    """
    out = np.zeros((len(points), axis.bins))
    scale = albedos[0] ** 2 * albedos[1] / math.pi**3 * plate.area_m2 / knots**2
    per_metre = 1.0 / float(path_from_time(axis.width_s))
    frame, start = (plate.center, plate.right, plate.up, plate.normal), axis.start_s / axis.width_s
    _quadrature(points, wall_normal, *frame, knots, scale, per_metre, start, out)
    return out


@compiled()
def _quadrature(
    points: Any, wall_normal: Any, center: Any, right: Any, up: Any, normal: Any, knots: int, scale: float,
    per_metre: float, start: float, out: Any,
) -> None:  # fmt: skip
    for p in range(len(points)):
        # Midpoints, as shares of the plate's half extents: the integrand is smooth as nothing stands in between.
        for i in range(knots):
            u = (2 * i + 1) / knots - 1.0
            for j in range(knots):
                v = (2 * j + 1) / knots - 1.0
                square = to_wall = to_plate = 0.0
                for k in range(3):
                    x = center[k] + u * right[k] + v * up[k] - points[p, k]
                    square += x * x
                    to_wall += x * wall_normal[k]
                    to_plate += x * normal[k]
                # Confocal light goes and returns by the same way: the geometry term counts twice.
                cosines = to_wall * to_plate
                energy = scale * (cosines / (square * square)) ** 2
                position = 2.0 * math.sqrt(square) * per_metre - start
                if 0.0 <= position < out.shape[1]:
                    out[p, int(position)] += energy
