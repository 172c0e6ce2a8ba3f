"""The light of objects in plain sight: what comes by way of an object other than around the corner.

`Transient.parts` splits light of three bounces by the surface of the second one. Of an object that the sensor sees,
or that the laser strikes, more of the light is its own: one bounce off it, two with the wall, and three of which the
first or the last is on it. All of it is what vanishes when the object turns black and still stands where it stood,

    L(scene) − L(scene with the object black) − parts[object],

found with the same paths for both, so that nothing is left in the difference but paths that touch the object.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from datagen.records import Accuracy, Capture, Lambertian, Scene
from datagen.records.arrays import Bools, Floats
from datagen.transport.brdf import MaterialTable
from datagen.transport.fields_of_view import PixelCones
from datagen.transport.path_tracing.averages import path_average
from datagen.transport.path_tracing.vertices import LaserPoints
from datagen.transport.simulate import prepared
from datagen.transport.visibility.lines_of_sight import lines_of_sight
from datagen.transport.visibility.raycast import Raycaster

LOOKINS, FOV_SAMPLES = 1024, 16
"""Samples where the accuracy asks for an error and states none. One bounce is exact with any; the error of two and of
three bounces, which are far fainter, doubles when a quarter of them is taken."""
LINES_ALONG = 9
"""Lines of sight along a side of a pixel by which an object is found in it."""
POINTS_AT_MOST = 4096
"""Triangles of an object whose middles are looked for from the sensor."""


def light_in_sight(
    scene: Scene, capture: Capture, accuracy: Accuracy, seed: int = 0, caster: Raycaster | None = None
) -> dict[str, Floats]:
    """Object in plain sight → its light of one to three bounces that is no part of `Transient.parts` (L, P, T).

    Photons at the aperture per emitted photon, as in a transient of `simulate` with these arguments; empty where the
    sensor sees no object and the laser strikes none, as in every scene that hides them. Light of one and two bounces
    counts where `accuracy.direct` asks for it, for only then is it in the transient.
    """
    caster = Raycaster(scene) if caster is None else caster
    seen = objects_in_sight(scene, capture, caster)
    if not seen:
        return {}
    few = {"lookins": LOOKINS, "fov_samples": FOV_SAMPLES} if accuracy.target is not None else {}
    asked = Accuracy(
        lookins=few.get("lookins", accuracy.lookins), fov_samples=few.get("fov_samples", accuracy.fov_samples),
        replicates=1, max_bounces=3, direct=accuracy.direct, secondary="none", occlusion=accuracy.occlusion,
    )  # fmt: skip
    flood = capture.illumination == "flood"
    task = prepared(
        scene, replace(capture, illumination="scan"), asked, seed, split_parts=True, caster=caster
    )  # fmt: skip
    whole, found = path_average(task).rows, {}
    for name in seen:
        k = scene.part_names.index(name)
        black = replace(scene, materials=(*scene.materials[:k], Lambertian(0.0), *scene.materials[k + 1 :]))
        rest = path_average(replace(task, scene=black, materials=MaterialTable.of(black.materials))).rows
        own = np.zeros_like(whole[0])
        for row, (there, left) in enumerate(zip(whole, rest, strict=True)):
            # The row of the object itself is `parts[object]`, which is known better.
            if row != k:
                own += there - left
        np.maximum(own, 0.0, out=own)
        found[name] = own.mean(axis=0, keepdims=True) if flood else own
    return found


def objects_in_sight(scene: Scene, capture: Capture, caster: Raycaster) -> tuple[str, ...]:
    """The objects that a laser ray strikes first, or of which the sensor sees something inside a pixel."""
    struck = set(LaserPoints.of(caster, scene, capture.laser).part.tolist())
    cones, sensor = PixelCones.of(capture.sensor), capture.sensor
    planes = cones.planes / np.linalg.norm(cones.planes, axis=2, keepdims=True)
    near = []
    for name in scene.objects:
        k = scene.part_names.index(name)
        if k not in struck and _may_be_in_view(scene, k, planes, sensor.position):
            near.append(k)
    looked_at: set[int] = set()
    if near:
        lines = lines_of_sight(caster, sensor, LINES_ALONG)
        looked_at = set(scene.face_part[lines.met.face[lines.met.valid]].tolist())
    in_view = {k for k in near if k in looked_at or _seen(scene, k, planes, sensor.position, caster)}
    return tuple(name for name in scene.objects if scene.part_names.index(name) in struck | in_view)


def _may_be_in_view(scene: Scene, part: int, planes: Floats, eye: Floats) -> bool:
    """Whether the ball about a part's bounds meets the cone of any pixel."""
    corners = scene.corners[scene.face_part == part].reshape(-1, 3)
    low, high = corners.min(axis=0), corners.max(axis=0)
    depth = np.einsum("psk,k->ps", planes, (low + high) / 2 - eye).min(axis=1)
    return bool((depth >= -np.linalg.norm(high - low) / 2).any())


def _seen(scene: Scene, part: int, planes: Floats, eye: Floats, caster: Raycaster) -> bool:
    """Whether the middle of some triangle of a part lies in a pixel with nothing before it."""
    faces = np.flatnonzero(scene.face_part == part)
    faces = faces[:: 1 + len(faces) // POINTS_AT_MOST]
    span = scene.corners[faces].mean(axis=1) - eye
    inside: Bools = np.zeros(len(faces), np.bool_)
    for pixel in planes:
        inside |= (span @ pixel.T >= 0).all(axis=1)
    if not inside.any():
        return False
    met = caster.closest(eye, span[inside])
    return bool((scene.face_part[met.face[met.valid]] == part).any())
