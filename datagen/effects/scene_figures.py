"""The input of the decisions on the transport's effects: scene, capture, accuracy, and figures found by few rays."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import numpy as np

from datagen.effects.trial import Trial, affordable, run_trial
from datagen.records import Accuracy, Capture, Lambertian, Material, OrenNayar, Phong, Retroreflector, Scene, SinLobe
from datagen.records.arrays import Floats, Ints
from datagen.transport.brdf import albedo
from datagen.transport.fields_of_view import PixelCones
from datagen.transport.path_tracing.vertices import LaserPoints
from datagen.transport.visibility.clearance import flat_patch, pyramids_clear
from datagen.transport.visibility.lines_of_sight import lines_of_sight
from datagen.transport.visibility.raycast import Raycaster
from datagen.units import path_from_time

PAIRS_CHECKED = 1 << 22
"""Most pairs of laser points and pixels that are checked one by one; of more pairs one is taken to see a laser
point. Halved, the direct return of large arrays is simulated without need."""
ON_THE_EDGE = -1e-12
"""Least sine of the angle to a pixel's side at which a laser point counts as inside, so that rounding does not decide
for points on the edge. Halved, it is still far above rounding."""
FLAT = 1e-9
"""Rounding of points in which lines of sight meet a plane, relative to the distance. Halved, it is still enough."""


@dataclass(frozen=True)
class SceneFigures:
    """A transport to be simulated, and figures on which the decisions on its effects rest.

    seed : seed of the trial run. caster : of the scene's triangles, if there is one already.
    """

    scene: Scene
    capture: Capture
    accuracy: Accuracy
    seed: int = 0
    caster: Raycaster | None = None

    def with_accuracy(self, **changes: object) -> SceneFigures:
        """The transport with other values of some fields of `Accuracy`."""
        return replace(self, accuracy=replace(self.accuracy, **changes))  # type: ignore[arg-type]

    def with_scene(self, **changes: object) -> SceneFigures:
        """The transport with other values of some fields of `Scene`."""
        return replace(self, scene=replace(self.scene, **changes))  # type: ignore[arg-type]

    @property
    def highest_order(self) -> float:
        """Bounces of the longest paths; infinite if there is no limit."""
        return np.inf if self.accuracy.max_bounces is None else self.accuracy.max_bounces

    @cached_property
    def trial(self) -> Trial | None:
        """The trial run; None if the transport is so small that a trial run would not pay."""
        if not affordable(self.capture, self.accuracy):
            return None
        return run_trial(self.scene, self.capture, self.accuracy, self.seed, self._caster)

    @property
    def all_lambertian(self) -> SceneFigures:
        """The transport with Lambertian surfaces of the same mean albedo in place of all others."""
        alike = tuple(m if is_lambertian(m) else lambertian_of(m) for m in self.scene.materials)
        return self.with_scene(materials=alike)

    @property
    def without_structure(self) -> SceneFigures:
        """The transport with black walls, floor and ceiling, where they are out of view."""
        dark = set(self.hidden_structure)
        kept = tuple(Lambertian(0.0) if k in dark else m for k, m in enumerate(self.scene.materials))
        return self.with_scene(materials=kept)

    @cached_property
    def laser_points(self) -> LaserPoints:
        """The laser points."""
        return LaserPoints.of(self._caster, self.scene, self.capture.laser)

    @cached_property
    def hidden_structure(self) -> tuple[int, ...]:
        """Parts of role `structure` that return light and hold neither a laser point nor any of the field of view."""
        seen = {*self.laser_points.part.tolist(), *self._view[1].reshape(-1).tolist()}
        return tuple(
            k
            for k, (role, material) in enumerate(zip(self.scene.roles, self.scene.materials, strict=True))
            if role == "structure" and material.albedo > 0 and k not in seen
        )

    @cached_property
    def view_is_flush(self) -> bool:
        """Whether it is proven that no light goes from a laser point to a surface that a pixel sees.

        The proof needs all laser points in one plane, and no triangle, however small, between the sensor and the
        field of view in that plane. Surfaces that pixels see beyond the plane, through a hole, are not lit by laser
        points, which face the sensor's side.
        """
        exists = self.laser_points.part >= 0
        if not exists.any():
            return True
        points, normals = self.laser_points.position[exists], self.laser_points.normal[exists]
        offset_m, sensor = self._caster.offset_m, self.capture.sensor
        if np.abs((points - points[0]) @ normals[0]).max() > offset_m or (normals @ normals[0]).min() <= 1 - 1e-9:
            return False
        above = (sensor.position - points[0]) @ normals[0]
        span = sensor.pixels.reshape(-1, 3) - sensor.position
        towards = -(span @ normals[0])
        if above <= offset_m or (towards <= 0).any():
            return False
        corners = sensor.position + span * (above / towards)[:, None]
        patch = flat_patch(corners, np.broadcast_to(normals[0], corners.shape), max(offset_m, FLAT * above))
        if patch is None:
            return False
        clear = pyramids_clear(
            sensor.position[None], patch, self._caster.corners, self._caster.face_normal, offset_m
        )  # fmt: skip
        return bool(clear[0])

    @cached_property
    def laser_point_in_view(self) -> bool:
        """Whether a laser point may lie in a pixel paired with it and its light may return within the time window."""
        sensor, axis, pixels = self.capture.sensor, self.capture.time, self.capture.shape[1]
        span = self.laser_points.position - sensor.position
        reach = np.linalg.norm(span, axis=1)
        path = self.laser_points.leg + reach if axis.origin == "source" else np.zeros(len(span))
        place = path / float(path_from_time(axis.width_s)) - axis.start_s / axis.width_s
        timely = np.flatnonzero((self.laser_points.part >= 0) & (place > -1) & (place < axis.bins + 1))
        if not len(timely) or len(timely) * pixels > PAIRS_CHECKED:
            return bool(len(timely))
        planes, ahead = PixelCones.of(sensor).planes, span[timely] / reach[timely, None]
        if self.capture.pairing == "confocal":
            beside = np.einsum("psk,pk->ps", planes[timely], ahead).min(axis=1)
        else:
            beside = np.min([np.einsum("pk,lk->lp", planes[:, side], ahead) for side in range(4)], axis=0)
        return bool((beside >= ON_THE_EDGE).any())

    @property
    def longest_path_m(self) -> float:
        """Metres of the longest path that arrives within the time window, with the legs of laser and sensor."""
        axis = self.capture.time
        longest = float(path_from_time(max(axis.stop_s, 0.0) + axis.width_s))
        if axis.origin == "source":
            return longest
        legs = [
            float(np.linalg.norm(self.scene.vertices - device.position, axis=1).max())
            for device in (self.capture.laser, self.capture.sensor)
        ]
        return longest + sum(legs)

    @cached_property
    def _caster(self) -> Raycaster:
        return Raycaster(self.scene) if self.caster is None else self.caster

    @cached_property
    def _view(self) -> tuple[Floats, Ints]:
        """(P, 9, 3) points where nine lines of sight of each pixel first meet the scene, and (P, 9) their parts, −1
        for none.

        The corners of a pixel are among the nine: a straight edge that cuts a pixel has a corner on either side.
        """
        lines = lines_of_sight(self._caster, self.capture.sensor, 3)
        part = np.where(lines.met.valid, self.scene.face_part[lines.met.face], -1)
        return lines.position, part.reshape(lines.valid.shape).astype(np.int64)


_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(24)
_COSINES, _SHARES = (_NODES + 1) / 2, _WEIGHTS / 2


def is_lambertian(material: Material) -> bool:
    """Whether the surface scatters by Lambert's law, as do black materials, and those whose lobe has no strength."""
    match material:
        case Lambertian() | Phong(exponent=0) | Phong(specular=0) | Retroreflector(retro=0) | OrenNayar(sigma_rad=0):
            return True
    return material.albedo == 0


@lru_cache(maxsize=1024)
def mean_albedo(material: Material) -> float:
    """Share of diffuse light that the surface returns: 2 ∫ ρ(cosθ) cosθ dcosθ, ρ the directional albedo."""
    if is_lambertian(material):
        return material.albedo
    match material:
        case SinLobe():
            return material.albedo * 2 / math.pi
        case Phong():
            return material.albedo * (1 - material.specular + material.specular * _phong_share(material.exponent))
    return float(2 * np.sum(_SHARES * _COSINES * albedo(material, _COSINES)))


def _phong_share(exponent: float) -> float:
    """Share of diffuse light that the lobe (n + 2)/(2π) cosⁿα returns: 2/(3π) (π + W/(n + 2)), W = ∫ cosⁿα dα over
    0 … π/2.

    α is the angle to the mirrored direction, which is distributed like the incident one. So one may average over all
    surfaces at a fixed α instead: the mean of max(n·ω, 0) max(n·ω′, 0) over the sphere of normals n is
    (sin α + (π − α) cos α)/(6π) (Cho & Saul, NIPS 2009, Eq. 6). The integral over α follows by parts.
    """
    ends = math.lgamma((exponent + 1) / 2) - math.lgamma(exponent / 2 + 1)
    return 2 / (3 * math.pi) * (math.pi + math.sqrt(math.pi) / 2 * math.exp(ends) / (exponent + 2))


def lambertian_of(material: Material) -> Material:
    """The Lambertian material of the same mean albedo."""
    return material if isinstance(material, Lambertian) else Lambertian(min(mean_albedo(material), 1.0))
