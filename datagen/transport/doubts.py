"""Scenes and devices whose light is most likely not what was meant, each with a line for users.

Rays are of single precision, and their ends are lifted off their surface by a share of the scene's extent
(`rays.SURFACE_OFFSET`). Where one part is thousands of times as large as everything that light goes between, this
offset is no longer small beside the legs of the light: shadows move, and rays pass what is nearer than the offset.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from datagen.records import Capture, Scene, TimeAxis
from datagen.records.arrays import Bools, Floats
from datagen.transport.laser_points import LaserPoints
from datagen.transport.rays import SURFACE_OFFSET, Raycaster
from datagen.units import path_from_time

COARSE = 3e-3
"""Ray offset, relative to the legs of the light, from which on users get a line: a thousand times that of rooms. At a
third of it the light between plates of 2 m that are 1 mm apart is still right to 0.2 %. On a bench it is 1 cm: twice
as much doubles the light of a plate of 2 cm, and seventy times as much adds a third to all light."""
ACROSS = (0.05, 0.5, 0.95)
"""Places of a pixel at which it is asked what it sees, as shares of the way along either side: near its edges, as
walls end there, and its middle."""
LOOKED_FROM = 16
"""Most laser points whose legs are measured: more cost rays, and a few may all lie beside an edge."""
LEGS = 64
"""Rays from each of these laser points: the share of legs that are shorter than one is known to 6 % at worst."""
QUARTILE = 0.75
"""Share of the legs that are shorter than the one that counts: a laser point beside an edge, from which half of the
rays go no further than the wall next to it, is not in a large scene."""
ODD_WAYS = np.array([(0.83, 0.37, 0.41), (-0.29, 0.79, 0.54), (0.31, -0.47, 0.83)])
"""Directions along which surfaces are counted, off all axes, as edges and planes of rooms lie along these."""
INSET = 0.01
"""Share of the way to the middle of its part by which a triangle's middle is moved, off what the part stands on."""
PLANES = 256
"""Planes of which equal ones are looked for at once."""
ASKED = 9
"""Places of a part that tell whether it is inside another one."""


def doubts(scene: Scene, capture: Capture, caster: Raycaster, direct: bool) -> Iterator[str]:
    """A line for users for each thing that is most likely not meant; none for ordinary scenes.

    caster : of the scene's triangles. direct : whether light of one and two bounces counts.
    """
    points = LaserPoints.of(caster, scene, capture.laser)
    leg = common_leg(scene, caster, points, capture.time)
    if caster.offset_m > COARSE * leg > 0:
        yield _too_large(scene, caster, leg)
    places = {"Laser.position": (capture.laser.position, capture.laser.targets),
              "Sensor.position": (capture.sensor.position, capture.sensor.pixels.mean(axis=1))}  # fmt: skip
    for key, (position, towards) in places.items():
        name = _wall_about(scene, caster, position, towards)
        if name:
            yield (
                f"{key} = {_text(position)} lies inside of the part {name!r}, which shuts its light in; move it off "
                "that part, towards what it looks at"
            )
            return
    # A pixel whose middle looks past an edge may see light beside it.
    places_of = np.array([((1 - u) * (1 - v), u * (1 - v), u * v, (1 - u) * v) for u in ACROSS for v in ACROSS])
    looks = np.einsum("wc,pck->pwk", places_of, capture.sensor.pixels).reshape(-1, 3) - capture.sensor.position
    met = caster.closest(capture.sensor.position, looks)
    looked_at = {*points.part.tolist(), *scene.face_part[met.face[met.valid]].tolist()}
    # A bare wall is dark on purpose.
    if direct or not any(scene.part_names.index(name) not in looked_at for name in scene.objects):
        return
    seen = np.where(met.valid[:, None], met.position, np.nan)
    for what, key, at, normal in (
        ("laser points", "Laser.position", points.position, points.normal),
        ("surfaces that the pixels see", "Sensor.position", seen, met.normal),
    ):
        known = np.isfinite(at[:, 0])
        if not known.any():
            if key == "Sensor.position":
                yield (
                    "no pixel sees a surface, so that hardly any light can come back; aim "
                    "Sensor.pixels at the relay wall, and move Sensor.position a millimetre off any surface"
                )
        elif _nothing_before(scene, at[known], normal[known], 2 * caster.offset_m):
            yield (
                f"nothing of the scene lies before the {what}, so that no light goes around a corner; put {key} on "
                "the side of the relay wall where the hidden objects are"
            )


def has_none(scene: Scene, caster: Raycaster, points: LaserPoints) -> bool:
    """Whether no light can go around a corner, whatever rays met: no part of the scene lies before a laser point
    whose surface is not black."""
    is_lit = points.part >= 0
    is_lit[is_lit] = [scene.materials[k].albedo > 0 for k in points.part[is_lit]]
    return _nothing_before(scene, points.position[is_lit], points.normal[is_lit], 2 * caster.offset_m)


def known_to(scene: Scene, caster: Raycaster, points: LaserPoints, time: TimeAxis) -> float:
    """The relative error of light below which rays cannot know it: their offset over a common leg, and over the scene
    at least."""
    leg = common_leg(scene, caster, points, time)
    return max(SURFACE_OFFSET, caster.offset_m / leg if leg > 0 else 0.0)


def common_leg(scene: Scene, caster: Raycaster, points: LaserPoints, time: TimeAxis) -> float:
    """Length of the way, metres, that light goes from the laser points to the next surface, the upper quartile of
    those that may end in the time window. If none of a few rays meets such a surface, the distance to the middle of
    the nearest part that the laser does not strike; 0 without any."""
    lit = np.flatnonzero(points.part >= 0)
    lit = lit[:: -(-len(lit) // LOOKED_FROM)] if len(lit) else lit
    at, normal = np.repeat(points.position[lit], LEGS, axis=0), np.repeat(points.normal[lit], LEGS, axis=0)
    hits = caster.leaving(at, normal, _directions_around(normal))
    leg = np.linalg.norm(hits.position - at, axis=1)
    window_m = float(path_from_time(max(time.stop_s, 0.0)))
    out = np.repeat(points.leg[lit], LEGS) if time.origin == "source" else 0.0
    within = leg[hits.valid & (leg + out < window_m)]
    if len(within):
        return float(np.quantile(within, QUARTILE))
    others = [part for part in np.unique(scene.face_part) if part not in points.part]
    middles = [scene.corners[scene.face_part == part].mean(axis=(0, 1)) for part in others if len(lit)]
    return min((float(np.linalg.norm(middle - points.position[lit[0]])) for middle in middles), default=0.0)


def _directions_around(normal: Floats) -> Floats:
    """(n, 3) directions about unit normals (n, 3), the same `LEGS` of a spiral for each run of so many, with the
    density cosθ/π."""
    k = np.arange(len(normal)) % LEGS
    turn, square = np.pi * (1 + np.sqrt(5)) * k, (k + 0.5) / LEGS
    # Any vector that is not along the normal gives a frame.
    side = np.cross(normal, np.where(np.abs(normal[:, :1]) < 0.7, [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]))
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    flat = np.cos(turn)[:, None] * side + np.sin(turn)[:, None] * np.cross(normal, side)
    return np.asarray(np.sqrt(square)[:, None] * flat + np.sqrt(1 - square)[:, None] * normal)


def _nothing_before(scene: Scene, at: Floats, normal: Floats, tolerance_m: float) -> bool:
    """Whether no corner of the scene lies before the plane of any of the points (n, 3) with unit normals (n, 3)."""
    planes = np.round(np.hstack([normal, np.einsum("nk,nk->n", normal, at)[:, None]]), 9)
    # Points of one plane ask the same question, and almost always the first ones answer it.
    few = (np.unique(planes[k : k + PLANES], axis=0) for k in range(0, len(planes), PLANES))
    return not any((scene.vertices @ n - d).max() > tolerance_m for some in few for *n, d in some)


def _too_large(scene: Scene, caster: Raycaster, leg: float) -> str:
    """The line about a ray offset that is not small beside the legs of the light."""
    sides = [np.ptp(scene.corners[scene.faces_of(name)].reshape(-1, 3), axis=0).max() for name in scene.part_names]
    largest = int(np.argmax(sides))
    what = f"the part {scene.part_names[largest]!r} is {sides[largest]:.2g} m large"
    if sides[largest] < 0.5 * 2 * caster.half_extent_m:
        what = f"its parts lie up to {2 * caster.half_extent_m:.2g} m apart"
    return (
        f"rays start {caster.offset_m:.2g} m off their surfaces, which is {caster.offset_m / leg:.2g} of the "
        f"{leg:.2g} m that light goes from the laser points: {what}, and single precision knows no smaller lengths "
        f"then; cut the scene to {float(f'{2 * COARSE * leg / SURFACE_OFFSET:.1g}'):g} m or less"
    )


def _wall_about(scene: Scene, caster: Raycaster, position: Floats, towards: Floats) -> str:
    """Name of the closed part that a device at `position` (3,), which looks at `towards` (n, 3), is inside of; "" if
    there is none, or if it is a room: one that holds another part, or beyond which the device looks."""
    met = caster.closest(position, towards - position)
    parts = np.unique(scene.face_part[met.face[met.valid]])
    if len(parts) != 1 or len(scene.part_names) < 2:
        return ""
    around = int(parts[0])
    shell = scene.corners[scene.face_part == around]
    if not _is_inside(shell, position[None], np.concatenate([ODD_WAYS, -ODD_WAYS])).all():
        return ""
    for part in range(len(scene.part_names)):
        middles = scene.corners[scene.face_part == part].mean(axis=1)
        if part == around or not len(middles):
            continue
        middles = middles[:: -(-len(middles) // ASKED)]
        asked = middles + INSET * (middles.mean(axis=0) - middles)
        if _is_inside(shell, asked, ODD_WAYS[:1]).mean() > 0.5:
            return ""
    return scene.part_names[around]


def _is_inside(shell: Floats, places: Floats, ways: Floats) -> Bools:
    """(n, w) whether rays from places (n, 3) along ways (w, 3) cross triangles (F, 3, 3) an odd number of times: all
    of them do inside of a closed surface.

    By the triangles' planes in double precision (Möller & Trumbore, Journal of Graphics Tools 2, 21 (1997)).
    """
    a, along, up = shell[:, 0], shell[:, 1] - shell[:, 0], shell[:, 2] - shell[:, 0]
    odd = np.zeros((len(places), len(ways)), np.bool_)
    for w, way in enumerate(ways):
        aside = np.cross(way, up)
        volume = np.einsum("fk,fk->f", along, aside)
        with np.errstate(divide="ignore", invalid="ignore"):
            for n, place in enumerate(places):
                across = place - a
                u = np.einsum("fk,fk->f", across, aside) / volume
                turned = np.cross(across, along)
                v, reach = turned @ way / volume, np.einsum("fk,fk->f", turned, up) / volume
                odd[n, w] = np.count_nonzero((u >= 0) & (v >= 0) & (u + v < 1) & (reach > 0)) % 2
    return odd


def _text(point: Floats) -> str:
    return "(" + ", ".join(f"{x:.3g}" for x in point) + ")"
