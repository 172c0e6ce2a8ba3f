"""What Fig. 3 and 5 colour: observed points of the room with the weights that each estimator gives them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from datagen.paper.as_printed_paths import PrintedLookins, PrintedRoom, leaving, lighting, observe, place_lookins
from datagen.paper.as_printed_sampling import half_cube, ray_grid
from datagen.paper.runs import Runs
from datagen.records import Scene, SinLobe
from datagen.report.cutaway import normals_of

Array = NDArray[np.float64]
UNIT_M = 1e-3
_UPRIGHT = 0.5


Panels = Mapping[str, Sequence[tuple[str, Array]]]
"""Estimator → the (name, value of each point) of its three panels."""


@dataclass(frozen=True)
class Lit:
    """Fig. 3: all n observed points of all lookins.

    Attributes
    ----------
    position, face : (n, 3) metres, and (n,) the triangle that each lies on.
    lit : (n,) not in shadow.
    panels : values (n,).
    """

    position: Array
    face: NDArray[np.int32]
    lit: NDArray[np.bool_]
    panels: Panels


@dataclass(frozen=True)
class FromLookin:
    """Fig. 5: what one lookin sends to its n observed points.

    Attributes
    ----------
    where : what the lookin lies on, and by which B it scatters.
    lookin : (3,) its place.
    position, face : (n, 3) metres, and (n,) the triangle that each point lies on.
    brdf : (n,) α B as printed.
    in_view : (q,) indices of the points within the field of view.
    panels : values (n,) without and with 1/R², and (q,) with the last bounce into the sensor.
    """

    where: str
    lookin: Array
    position: Array
    face: NDArray[np.int32]
    brdf: Array
    in_view: NDArray[np.int64]
    panels: Panels

    @property
    def level_share(self) -> float:
        """Share of B that leaves within 45° of the level, of all that meets a surface."""
        span = self.position - self.lookin
        level = np.abs(span[:, 2]) < np.sqrt(0.5) * np.linalg.norm(span, axis=1)
        return float(self.brdf[level].sum() / self.brdf.sum())


def lit_points(runs: Runs) -> Lit:
    """Observed points of the sparse grid."""
    room = PrintedRoom.of(runs.scene, runs.capture, UNIT_M)
    camera = half_cube(runs.sizes.pixels)
    seen = observe(room, place_lookins(room, 0, ray_grid(runs.sparse, "angles")), camera)
    light = lighting(room, 0, seen)
    met = seen.face >= 0
    position, distance = seen.position[met], light.distance[met]
    span = (position - room.points.position[0]) / distance[:, None]
    one, spread = np.maximum(span @ room.points.normal[0], 0), (UNIT_M / distance) ** 2
    both = one * np.maximum(-np.einsum("nk,nk->n", span, seen.normal[met]), 0)
    panels = {
        "as printed": [("1/R²", spread), ("cosφ", one), ("cosφ / R²", one * spread)],
        "radiometric": [("1/R²", spread), ("cosφ · cosφ′", both), ("irradiance ∝ cosφ cosφ′ / R²", both * spread)],
    }
    return Lit(position, seen.face[met], light.lit[met], panels)


def example_lookins(runs: Runs) -> list[FromLookin]:
    """The paper's two examples where the room has them: the nearest wall by cosφ, and the pillar by |sinθ|.

    The text names no points: here, of the sparse grid's lookins (else the dense grid's), the nearest to the laser
    point that sends light into the field of view.
    """
    scene = runs.scene
    walls = [k for k, role in enumerate(scene.roles) if role == "structure"]
    upright = np.abs(normals_of(scene)[:, 2]) < _UPRIGHT
    found = [_example(runs, scene, lambda part, face: np.isin(part, walls) & upright[face], "nearest wall, B = cosφ")]
    if "pillar" in scene.part_names:
        pillar = scene.part_names.index("pillar")
        materials = list(scene.materials)
        materials[pillar] = SinLobe(materials[pillar].albedo)
        room = replace(scene, materials=tuple(materials))
        found.append(_example(runs, room, lambda part, face: part == pillar, "pillar, B = |sinθ|"))
    return [example for example in found if example is not None]


def _example(
    runs: Runs, scene: Scene, wanted: Callable[[NDArray[np.int64], NDArray[np.int32]], NDArray[np.bool_]], where: str
) -> FromLookin | None:
    room, camera = PrintedRoom.of(scene, runs.capture, UNIT_M), half_cube(runs.sizes.pixels)
    for rays in runs.sizes.rays:
        lookins = place_lookins(room, 0, ray_grid(rays, "angles"))
        rows = np.flatnonzero(wanted(lookins.part, lookins.face))
        for row in rows[np.argsort(lookins.distance[rows])]:
            example = _from_lookin(room, lookins.take(slice(row, row + 1)), camera, where)
            if len(example.in_view):
                return example
    return None


def _from_lookin(room: PrintedRoom, lookin: PrintedLookins, camera: Array, where: str) -> FromLookin:
    seen = observe(room, lookin, camera)
    out = leaving(room, lookin, seen, np.array([0]))
    met = np.flatnonzero(seen.face[0] >= 0)
    place = np.full(seen.face.shape[1], -1)
    place[met] = np.arange(len(met))
    in_view = place[out.point]
    position, distance = seen.position[0, met], seen.distance[0, met]
    received = np.maximum(np.einsum("nk,nk->n", lookin.position - position, seen.normal[0, met]) / distance, 0)
    share, spread = seen.share[0, met], (UNIT_M / distance) ** 2
    # |sinθ| as a BRDF keeps Lambert's polar dependence, cosφ as one is constant: either way B · cosφ, or cosφ alone.
    cosine = camera[met, 2]
    sine = room.materials.sine[lookin.part[0]]
    lobe = share * cosine if sine else cosine
    gain = received[in_view] / np.where(share[in_view] > 0, share[in_view], 1.0) * lobe[in_view]
    final = out.paths.energy
    panels = {
        "as printed": [("α B", share), ("α B / R²", share * spread), ("into the sensor", final)],
        "radiometric": [
            ("per solid angle", lobe),
            ("irradiance", lobe * spread * received),
            ("into the sensor", final * gain),
        ],
    }
    return FromLookin(where, lookin.position[0], position, seen.face[0, met], share, in_view, panels)
