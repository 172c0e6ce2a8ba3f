"""The transport's rows of the table of effects: the direct return and the air by a bound, the light of four and more
bounces by a trial run."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from datagen.effects.clearance import flat_patch, pyramids_clear
from datagen.effects.rule import Change, Effect
from datagen.effects.trial import Trial, is_affordable, run_trial
from datagen.records import Accuracy, Capture, Scene
from datagen.transport.fields_of_view import PixelCones
from datagen.transport.laser_points import LaserPoints
from datagen.transport.rays import Raycaster
from datagen.units import path_from_time

PAIRS_CHECKED = 1 << 22
"""Most pairs of laser points and pixels that are checked one by one, in 100 MB; of more pairs one is taken to see a
laser point."""
ON_THE_EDGE = -1e-12
"""Least sine of the angle to a pixel's side at which a laser point counts as inside: beyond rounding of points on the
edge."""
FLAT = 1e-9
"""Rounding of points in which lines of sight meet a plane, relative to the distance."""


@dataclass(frozen=True)
class Transport:
    """A transport to be simulated, and what the decisions on its effects rest on.

    seed : seed of the trial run. given_caster : of the scene's triangles, if there is one already.
    """

    scene: Scene
    capture: Capture
    accuracy: Accuracy
    seed: int = 0
    given_caster: Raycaster | None = None

    def with_accuracy(self, **changes: object) -> Transport:
        """The transport with other values of some fields of `Accuracy`."""
        return replace(self, accuracy=replace(self.accuracy, **changes))  # type: ignore[arg-type]

    @property
    def highest_order(self) -> float:
        """Bounces of the longest paths; infinite if there is no limit."""
        return math.inf if self.accuracy.max_bounces is None else self.accuracy.max_bounces

    @cached_property
    def caster(self) -> Raycaster:
        """Queries against the scene's triangles."""
        return Raycaster(self.scene) if self.given_caster is None else self.given_caster

    @cached_property
    def laser_points(self) -> LaserPoints:
        """The laser points."""
        return LaserPoints.of(self.caster, self.scene, self.capture.laser)

    @cached_property
    def trial(self) -> Trial | None:
        """The trial run; None if the transport is so small that a trial run would not pay."""
        if not is_affordable(self.capture, self.accuracy):
            return None
        return run_trial(self.scene, self.capture, self.accuracy, self.seed, self.caster, self.laser_points)


def _direct_return(given: Transport) -> Change:
    """The change without the direct return: 0 if it is proven that there is none, and otherwise unknown.

    A trial run would not do: few pairs of laser points and pixels have a direct return, and it may miss them all.
    """
    if _laser_point_in_view(given):
        return Change(None, "bound", "a pixel looks at a laser point: one bounce returns light")
    if not _view_is_flush(given):
        return Change(None, "bound", "laser points may light a surface in view: two bounces return light")
    return Change(0.0, "bound", "no pixel sees a laser point in time, and laser points light nothing in view")


def _laser_point_in_view(given: Transport) -> bool:
    """Whether a laser point may lie in a pixel paired with it and its light may return within the time window."""
    sensor, axis, pixels = given.capture.sensor, given.capture.time, given.capture.shape[1]
    points = given.laser_points
    span = points.position - sensor.position
    reach = np.linalg.norm(span, axis=1)
    path = points.leg + reach if axis.origin == "source" else np.zeros(len(span))
    place = path / float(path_from_time(axis.width_s)) - axis.start_s / axis.width_s
    timely = np.flatnonzero((points.part >= 0) & (place > -1) & (place < axis.bins + 1))
    if not len(timely) or len(timely) * pixels > PAIRS_CHECKED:
        return bool(len(timely))
    planes, ahead = PixelCones.of(sensor).planes, span[timely] / reach[timely, None]
    if given.capture.pairing == "confocal":
        inside = np.einsum("psk,pk->ps", planes[timely], ahead).min(axis=1)
    else:
        inside = np.min([np.einsum("pk,lk->lp", planes[:, side], ahead) for side in range(4)], axis=0)
    return bool((inside >= ON_THE_EDGE).any())


def _view_is_flush(given: Transport) -> bool:
    """Whether it is proven that no light goes from a laser point to a surface that a pixel sees.

    The proof needs all laser points in one plane, and no triangle, however small, between the sensor and the field of
    view in that plane. Surfaces that pixels see beyond the plane, through a hole, are not lit by laser points, which
    face the sensor's side.
    """
    exists = given.laser_points.part >= 0
    if not exists.any():
        return True
    points, normals = given.laser_points.position[exists], given.laser_points.normal[exists]
    offset_m, sensor = given.caster.offset_m, given.capture.sensor
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
    triangles, facing = given.caster.corners, given.caster.face_normal
    return bool(pyramids_clear(sensor.position[None], patch, triangles, facing, offset_m)[0])


def _attenuation(given: Transport) -> Change:
    """Bound on the change without attenuation: that of the longest path which arrives within the time window, with
    the legs of laser and sensor."""
    axis, scene = given.capture.time, given.scene
    longest_m = float(path_from_time(max(axis.stop_s, 0.0) + axis.width_s))
    if axis.origin != "source":
        for device in (given.capture.laser, given.capture.sensor):
            longest_m += float(np.linalg.norm(scene.vertices - device.position, axis=1).max())
    value = math.expm1(min(scene.attenuation_per_m * longest_m, 700.0))
    return Change(value, "bound", f"the longest path recorded, {longest_m:.3g} m, loses ≤ {value:.2g}")


def _measured_change(given: Transport, component: str, what: str) -> Change:
    """The change if a component is left out: its share of the light of a trial run."""
    trial = given.trial
    if trial is None:
        return Change(None, "trial", "not measured: a trial run would cost too much of so small a transport")
    share = trial.share(component)
    if share is None:
        return Change(None, "trial", "the trial run met too little light to tell")
    return Change(share, "trial", f"{what} ≤ {share:.2g} of the indirect light in the trial run")


def _without_secondary(given: Transport) -> Transport:
    """The transport without light of four bounces."""
    if given.accuracy.max_bounces == 4:
        return given.with_accuracy(max_bounces=3)
    return given.with_accuracy(secondary=False)


TRANSPORT_EFFECTS: tuple[Effect[Transport, Transport], ...] = (
    Effect(
        "direct_return", "direct return", lambda g: g.accuracy.direct, lambda g: g.with_accuracy(direct=False),
        _direct_return, 0.3,
    ),
    # Scholes & Leach, Sensors 24, 6522 (2024), Eq. 8.
    Effect(
        "secondary_bounce", "secondary bounce",
        lambda g: g.highest_order >= 4 and g.accuracy.secondary, _without_secondary,
        lambda g: _measured_change(g, "secondary", "four bounces"), 0.7,
    ),
    Effect(
        "higher_bounces", "higher bounces", lambda g: g.highest_order >= 5,
        lambda g: g.with_accuracy(max_bounces=4 if g.accuracy.secondary else 3),
        lambda g: _measured_change(g, "higher", "five bounces and more"), 0.8,
    ),
    Effect(
        "attenuation", "atmospheric attenuation", lambda g: g.scene.attenuation_per_m > 0,
        lambda g: replace(g, scene=replace(g.scene, attenuation_per_m=0.0)), _attenuation, 0.1,
    ),
)  # fmt: skip
