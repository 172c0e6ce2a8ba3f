"""The light of objects in plain sight that `Transient.parts` does not count as theirs.

`Transient.parts` splits light of three bounces by the surface of the second bounce. If the sensor sees an object, or
the laser strikes it, more light comes from it: light of one bounce, of two with the wall, and of three whose
first or last bounce is on it. All of the object's light vanishes if it turns black in its place, so this light
is

    L(scene) − L(scene with the object black) − parts[object].

Both simulations use the same paths, so that only paths that touch the object remain in the difference. Of a beam with
cells (`Laser.flood`) light of one bounce is known by part without this, and belongs to `Transient.parts`.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from datagen.records import Accuracy, Capture, Lambertian, Scene
from datagen.records.arrays import Bools, Floats
from datagen.transport.fields_of_view import PixelCones
from datagen.transport.flood import light_at_sensor
from datagen.transport.laser_points import LaserPoints
from datagen.transport.lines_of_sight import lines_of_sight
from datagen.transport.path_light import with_samples
from datagen.transport.problem import Problem, nothing
from datagen.transport.rays import Raycaster

SAMPLES, LEAST = 1024, 4
"""Paths of each histogram where the accuracy states a target, and fewest of each pair of laser point and pixel of a
flood. Light of one bounce is exact with any number; two and three bounces are far fainter."""
LINES_ALONG = 9
"""Lines of sight along each side of a pixel that search for objects in it; rays to triangles find smaller ones."""
MOST_RAYS = 4096
"""Most triangles of an object to whose middles the sensor sends a ray: an object of more that shows only a few of
them may be missed."""


def light_in_sight(
    scene: Scene, capture: Capture, accuracy: Accuracy, seed: int = 0, caster: Raycaster | None = None
) -> dict[str, Floats]:
    """Object in plain sight → (L, P, T) its light of one to three bounces that `Transient.parts` does not contain.

    The unit is that of the transient that `simulate` gives for these arguments: photons at the aperture per emitted
    photon. The result is empty if the sensor sees no object and the laser strikes none, as in all scenes that hide
    them. Light of one and two bounces counts if `accuracy.direct` is set, for only then the transient contains it.
    """
    caster = Raycaster(scene) if caster is None else caster
    in_sight = objects_in_sight(scene, capture, caster)
    if not in_sight:
        return {}
    is_flood = capture.illumination == "flood"
    lasers = len(capture.laser.targets) if is_flood else 1
    samples = accuracy.samples or max(SAMPLES // lasers, LEAST)
    asked = Accuracy(samples=samples, max_bounces=3, direct=accuracy.direct)
    whole, light = _rows(scene, capture, asked, seed, caster), dict[str, Floats]()
    for name in in_sight:
        k = scene.part_names.index(name)
        black = replace(scene, materials=(*scene.materials[:k], Lambertian(0.0), *scene.materials[k + 1 :]))
        rest = _rows(black, capture, asked, seed, caster)
        # The row of the object itself is `parts[object]`, which the transient knows with a smaller error.
        own = sum((whole[row] - rest[row] for row in whole if row != name), start=np.zeros(capture.shape))
        np.maximum(own, 0.0, out=own)
        light[name] = light_at_sensor(own, capture) if is_flood else own
    return light


def _rows(scene: Scene, capture: Capture, accuracy: Accuracy, seed: int, caster: Raycaster) -> dict[str, Floats]:
    """Light (L, P, T) of three bounces by part, and direct light under the name ""; of a beam with cells without one
    bounce, and before what a flood's sensor adds."""
    problem = Problem.of(scene, capture, accuracy, seed, split_parts=True, caster=caster)
    found = with_samples(problem) if (problem.points.part >= 0).any() else nothing(problem)
    direct = {"": found.components["direct"]} if accuracy.direct else {}
    return {**found.parts, **direct}


def objects_in_sight(scene: Scene, capture: Capture, caster: Raycaster) -> tuple[str, ...]:
    """Names of the objects that a laser ray strikes first, or that the sensor sees inside a pixel."""
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
    # Lines of sight may pass a small object, so rays are sent to its triangles as well.
    in_view = {k for k in near if k in looked_at or _is_seen(scene, k, planes, sensor.position, caster)}
    return tuple(name for name in scene.objects if scene.part_names.index(name) in struck | in_view)


def _may_be_in_view(scene: Scene, part: int, planes: Floats, eye: Floats) -> bool:
    """Whether the bounding sphere of a part meets the cone of any pixel."""
    corners = scene.corners[scene.face_part == part].reshape(-1, 3)
    low, high = corners.min(axis=0), corners.max(axis=0)
    depth = np.einsum("psk,k->ps", planes, (low + high) / 2 - eye).min(axis=1)
    return bool((depth >= -np.linalg.norm(high - low) / 2).any())


def _is_seen(scene: Scene, part: int, planes: Floats, eye: Floats, caster: Raycaster) -> bool:
    """Whether the sensor sees the middle of a triangle of a part inside a pixel."""
    faces = np.flatnonzero(scene.face_part == part)
    faces = faces[:: 1 + len(faces) // MOST_RAYS]
    span = scene.corners[faces].mean(axis=1) - eye
    inside: Bools = np.zeros(len(faces), np.bool_)
    for pixel in planes:
        inside |= (span @ pixel.T >= 0).all(axis=1)
    if not inside.any():
        return False
    met = caster.closest(eye, span[inside])
    return bool((scene.face_part[met.face[met.valid]] == part).any())
