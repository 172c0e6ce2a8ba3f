"""The light of sequences: frames of a scene in which things move, or that a moving sensor looks at."""

from __future__ import annotations

import math
import time as clock_time
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple
from warnings import warn

import numpy as np

from datagen.errors import InputError, InputWarning, shown
from datagen.records import Accuracy, Capture, Clock, Scene, SequenceLight, Transient
from datagen.records.arrays import Floats, l2_norm
from datagen.records.checks import check_kind, check_seed
from datagen.transport.coincidence import set_apart
from datagen.transport.cuts import FAINT, SCATTER, SHARED
from datagen.transport.dwell import MOST, MOST_WHOLE, instants, path_change
from datagen.transport.effort import is_enough
from datagen.transport.problem import components_asked
from datagen.transport.shared_light import Moving, Static, hidden_by_movers, moving_light, static_of
from datagen.transport.simulate import MET, warnings_of
from datagen.transport.whole_frames import OtherComponents, transient_of_moments


def simulate_sequence(
    scene: Scene, capture: Capture | Sequence[Capture], clock: Clock, accuracy: Accuracy | None = None, seed: int = 0,
    *, exposure_s: float | None = None,
) -> SequenceLight:  # fmt: skip
    """The light of all frames of a scene whose parts move along their paths.

    Three bounces of a scan with a target are simulated once for what stands, and for each frame only as far as they
    move: each laser point at its own time, with an error of `part_target` of the light that moves (docs/physics.md).
    All other light comes frame by frame, at the middle of the frame, with the same random numbers:
    `SequenceLight.samplers` tells which. Where things move by more than a quarter of a bin's path while a laser point
    is measured, light is the mean over instants of its exposure.

    Parameters
    ----------
    scene : what is looked at; its paths say where its parts are at each time.
    capture : how it is measured; or one capture for each frame, of a sensor that moves.
    clock : when.
    accuracy : of each frame, as of `simulate`.
    seed : any integer ≥ 0; the same arguments and seed give the same light. All frames have the same random numbers.
    exposure_s : how long each laser point is measured; left out, exposures fill their frames.

    Returns
    -------
    SequenceLight with arrays (F, L, P, T).

    Raises
    ------
    InputError : captures of another number than there are frames, or that differ in shape or time axis; exposures
        that do not fit into a frame; whatever `simulate` raises.

    Warns
    -----
    InputWarning : as `simulate`, of the first frame.

    Examples
    --------
    >>> import datagen as dg, trimesh
    >>> wall = trimesh.Trimesh([(0, -1, 0), (0, 1, 0), (0, 1, 2), (0, -1, 2)], [(0, 1, 2), (0, 2, 3)])
    >>> path = dg.Path(times_s=(0, 1), places=[(1.2, 0.3, 0.7), (1.2, -0.3, 0.7)])
    >>> scene = dg.Scene.from_parts([
    ...     dg.Part("relay_wall", wall, dg.Lambertian(0.8), "relay_wall"),
    ...     dg.Part("box", trimesh.creation.box((0.5, 0.5, 0.5)), dg.Lambertian(0.5), path=path)])
    >>> laser = dg.Laser((2, -1, 1), [(0, -0.2, 1), (0, 0.2, 1)])
    >>> sensor = dg.Sensor.grid((2, -1, 1), (0, 0, 1), (0, 0.1, 0), (0, 0, 0.05), rows=1, columns=2)
    >>> time = dg.TimeAxis(bins=200, width_s=1e-10, origin="wall")
    >>> capture = dg.Capture(laser, sensor, time, pairing="confocal")
    >>> light = dg.simulate_sequence(scene, capture, dg.Clock(frames=3, rate_hz=4), dg.Accuracy(target=0.05))
    >>> light.moving.shape, light.total(2).shape, light.times_s.round(4).tolist()[1]
    ((3, 2, 1, 200), (2, 1, 200), [0.3125, 0.4375])
    """
    check_kind("scene", scene, Scene)
    check_kind("clock", clock, Clock)
    captures = captures_of(capture, clock.frames)
    accuracy = Accuracy() if accuracy is None else accuracy
    check_kind("accuracy", accuracy, Accuracy, remedy="an error to be met is Accuracy(target=0.05)")
    check_seed(seed)
    times, exposure_s = times_of(captures[0], clock, exposure_s)
    for line in warnings_of(set_apart(scene.at(0.0), captures[0]), captures[0], accuracy):
        warn(f"simulate_sequence: {line}", InputWarning, stacklevel=2)
    return light_of_sequence(scene, captures, times, exposure_s, accuracy, seed)


def captures_of(capture: Capture | Sequence[Capture], frames: int, called: str = "capture") -> list[Capture]:
    """A capture for each frame, from one for all or one for each.

    Raises `InputError`, which calls them `called`, for anything else, for another number of them, and where two
    differ in shape, bins, or number of laser points.
    """
    if isinstance(capture, Capture):
        return [capture] * frames
    check_kind(called, capture, Capture, Sequence, remedy="or one for each frame")
    for number, one in enumerate(capture):
        check_kind(f"{called}[{number}]", one, Capture)
        for name, of in _ALIKE.items():
            if of(one) != of(capture[0]):
                raise InputError(
                    f"{called}[{number}].{name} = {shown(of(one))}: that of {called}[0] is {shown(of(capture[0]))}; "
                    "all frames must be measured alike"
                )
    if len(capture) != frames:
        raise InputError(f"{called}: {len(capture)} given for {frames} frames; give one, or one for each frame")
    return list(capture)


_ALIKE: dict[str, Callable[[Capture], object]] = {
    "shape": lambda capture: capture.shape,
    "time": lambda capture: capture.time,
    "pairing": lambda capture: capture.pairing,
    "illumination": lambda capture: capture.illumination,
    # All points of a flood are one in its shape.
    "laser.targets": lambda capture: len(capture.laser.targets),
}
"""What the captures of all frames have in common, by name."""


def times_of(capture: Capture, clock: Clock, exposure_s: float | None) -> tuple[Floats, float]:
    """(F, L) seconds, the middles of the exposures of the laser points in each frame, of a flood (F, 1); and how long
    an exposure is, seconds.

    exposure_s : of a laser point; exposures fill their frames if it is None.
    """
    points = capture.shape[0]
    # A flood lights all of its points at once, in whatever order a scan would.
    clock = replace(clock, order="together", columns=None) if capture.illumination == "flood" else clock
    if exposure_s is None:
        exposure_s = 1.0 / clock.rate_hz / (1 if clock.order == "together" else points)
    times = clock.times(points, exposure_s)
    return np.asarray(np.broadcast_to(times, (clock.frames, points))), exposure_s


def light_of_sequence(
    scene: Scene, captures: Sequence[Capture], times: Floats, exposure_s: float, accuracy: Accuracy, seed: int,
    apart: bool = False,
) -> SequenceLight:  # fmt: skip
    """The same as `simulate_sequence`, without checks and warnings, for arguments that were checked before.

    captures : one for each frame. times : (F, L) seconds, the middles of exposures of `exposure_s`.
    apart : of a sensor that stands: `static` is the light of the scene without its moving parts, and `moving` what
        comes to it, also where frames do not share their light. That light is then simulated once more.
    """
    if all(capture is captures[0] for capture in captures):
        if not scene.moving:
            return _light_of_standing(scene, captures[0], times, accuracy, seed)
        light: SequenceLight | None = None
        if accuracy.target is not None and captures[0].illumination == "scan":
            light = shared_light(scene, captures[0], times, exposure_s, accuracy, seed, apart)
        if light is None:
            light = light_of_frames(scene, captures, times, exposure_s, accuracy, seed)
            if apart:
                light = _with_static_light(light, _without_movers(scene, captures[0], accuracy, seed))
        return light
    return light_of_frames(scene, captures, times, exposure_s, accuracy, seed)


def _without_movers(scene: Scene, capture: Capture, accuracy: Accuracy, seed: int) -> Floats:
    """(L, P, T) the light of the scene without its moving parts, with the random numbers of a frame."""
    if len(scene.moving) == len(scene.part_names):
        return np.zeros(capture.shape)
    return _frame(scene.without(*scene.moving), capture, np.zeros(1), accuracy, seed).total


def _with_static_light(light: SequenceLight, static: Floats) -> SequenceLight:
    """The light with so much (L, P, T) more of it that is static."""
    return replace(light, static=light.static + static, moving=light.moving - static)


def light_of_frames(
    scene: Scene, captures: Sequence[Capture], times: Floats, exposure_s: float, accuracy: Accuracy, seed: int
) -> SequenceLight:  # fmt: skip
    """The light of a sequence whose frames are simulated by themselves, each in an exposure about the middle of its
    times (F, L)."""
    began = clock_time.perf_counter()
    whole = _frame_instants(times, exposure_s, path_change(scene, captures[0], times, exposure_s))
    frames = [_frame(scene, capture, at, accuracy, seed) for capture, at in zip(captures, whole, strict=True)]
    return _of_transients(scene, times, frames, clock_time.perf_counter() - began)


def _light_of_standing(scene: Scene, capture: Capture, times: Floats, accuracy: Accuracy, seed: int) -> SequenceLight:
    """The light of a scene in which nothing moves."""
    frames, began = len(times), clock_time.perf_counter()
    once = _frame(scene, capture, np.zeros(1), accuracy, seed)
    light = _of_transients(scene, times, [once] * frames, clock_time.perf_counter() - began)
    return replace(
        light, static=once.total, moving=np.zeros_like(light.moving), change_stderr=np.zeros_like(light.stderr),
        change_errors=np.zeros(frames), samplers=once.samplers, rays=once.rays,
    )  # fmt: skip


def shared_light(
    scene: Scene, capture: Capture, times: Floats, exposure_s: float, accuracy: Accuracy, seed: int,
    apart: bool = False,
) -> SequenceLight | None:  # fmt: skip
    """The light of a sequence whose static room is simulated once; None where that cannot be.

    Frames in which a mover stands in the device's view are simulated by themselves. apart : as in
    `light_of_sequence`.
    """
    began, components = clock_time.perf_counter(), components_asked(accuracy)
    if "primary" not in components or accuracy.target is None:
        return None
    bins = path_change(scene, capture, times, exposure_s)
    every, whole = instants(times, exposure_s, bins, MOST), _frame_instants(times, exposure_s, bins)
    static = static_of(scene, capture, every, accuracy, accuracy.target * math.sqrt(1.0 / len(components)), seed)
    if static is None:
        return None
    ready = clock_time.perf_counter()
    hidden = hidden_by_movers(static, capture)
    if hidden.all():
        return None
    others, moving = [name for name in components if name != "primary"], moving_light(static)
    if moving is None:
        return None
    light = _three_bounces(scene, times, static, moving, accuracy)
    norms = [l2_norm(light.total(f)) for f in range(light.frames)]
    poor = np.array([
        not is_enough(of * norm, norm, norm, static.target)
        for of, norm in zip(light.relative_error, norms, strict=True)
    ])  # fmt: skip
    if (hidden | poor).all():
        return None
    if others:
        light = _with_others(light, scene, whole, OtherComponents(capture, accuracy, seed, others), apart)
    for f in np.flatnonzero(hidden | poor).tolist():
        light = _with_frame(light, f, _frame(scene, capture, whole[f], accuracy, seed))
    # Of what moves not the own light is meant, which of somebody in dark clothes is less than the shadow, but both.
    met = (light.relative_error <= MET * accuracy.target) & (moving.error_over_asked <= MET)
    for name, error in light.part_errors.items():
        if name not in moving.own:
            met &= ~(error > MET * accuracy.each_part)
    samplers = {name: light.samplers[name] for name in components}
    if hidden.any():
        samplers["primary"] += f"; {hidden.sum()} frames by themselves, in which a mover is in the device's view"
    if (poor & ~hidden).any():
        samplers["primary"] += f"; {(poor & ~hidden).sum()} by themselves, of which cuts knew too little"
    seconds = {"static": ready - began, "moving": clock_time.perf_counter() - ready}
    return replace(light, met_target=met, samplers=samplers, seconds=seconds)


def _three_bounces(scene: Scene, times: Floats, static: Static, moving: Moving, accuracy: Accuracy) -> SequenceLight:
    """Three bounces of a sequence, from the light of the static room and what moves."""
    A, F = static.light, len(times)
    shape, each = A.stderr.shape, SCATTER + SHARED
    light, apart = moving.light.reshape(F, *shape), moving.apart.reshape(F, *shape)
    change = np.zeros_like(apart)
    np.abs(np.diff(apart, axis=0), out=change[1:])
    change *= math.sqrt(each)
    norms = np.array([l2_norm(A.total + light[f]) for f in range(F)])
    error = np.hypot(A.relative_error * l2_norm(A.total), [moving.error(f) for f in range(F)])
    parts = {name: A.parts[name] - of.reshape(light.shape) for name, of in moving.blocked.items()}
    parts |= {name: of.reshape(light.shape) for name, of in moving.own.items()}
    errors = {name: np.full(F, A.part_errors[name]) for name in moving.blocked if name in A.part_errors}
    for name, own in moving.own.items():
        norm = np.array([l2_norm(of) for of in own])
        counts = norm > np.maximum(FAINT * norms, accuracy.faint_part)
        errors[name] = np.divide(moving.own_error[name], norm, out=np.full(F, np.nan), where=counts)
    return SequenceLight(
        A.time, times, A.total, light, {name: parts[name] for name in scene.objects},
        np.hypot(A.stderr, math.sqrt(each) * apart), change,
        np.array([moving.change_error(f) if f else 0.0 for f in range(F)]),
        A.overflow + moving.outside.reshape(F, *shape[:2]), np.tile(A.laser_points, (F, 1, 1)),
        np.divide(error, norms, out=np.zeros(F), where=norms > 0), None, errors, {"primary": "shared cuts"},
        {"primary": A.rays["primary"] + moving.rays},
        blocked=sum((of.sum(axis=(1, 2)) for of in moving.own.values()), start=-moving.light.sum(axis=(1, 2))),
    )  # fmt: skip


def _with_others(
    light: SequenceLight, scene: Scene, whole: Floats, others: OtherComponents, apart: bool
) -> SequenceLight:  # fmt: skip
    """The light with further components: of each frame by itself, at its instants, with the same random numbers.

    whole : (F, S) instants, seconds. apart : whether those of the scene without its moving parts, with these random
    numbers, too, become static light.
    """
    shape = light.static.shape
    moving, stderr, overflow = light.moving.copy(), light.stderr**2, light.overflow.copy()
    change, changes = light.change_stderr**2, light.change_errors**2
    norms = np.array([l2_norm(light.total(f)) for f in range(light.frames)])
    errors, rays = (light.relative_error * norms) ** 2, dict(light.rays)
    before: Floats | None = None
    for f, at in enumerate(whole):
        found = others.of([scene.at(float(time_s)) for time_s in at], light.total(f), math.sqrt(errors[f]))
        moving[f] += found.light.sum(axis=0).reshape(shape)
        stderr[f] += found.variance.sum(axis=0).reshape(shape)
        overflow[f] += found.outside
        errors[f] += found.square
        if before is not None:
            square = np.square(found.apart - before).sum(axis=0)
            change[f] += square.reshape(shape)
            changes[f] += square.sum()
        before = found.apart
        rays |= {name: rays.get(name, 0.0) + of for name, of in found.cost.items()}
    norms = np.array([l2_norm(light.static + of) for of in moving])
    relative = np.divide(np.sqrt(errors), norms, out=np.zeros(len(norms)), where=norms > 0)
    static = light.static
    light = replace(light, moving=moving)
    if apart:
        still = others.of([scene.without(*scene.moving)], static, 0.0)
        light = _with_static_light(light, still.light.sum(axis=0).reshape(shape))
    ways = {name: f"frames: {way}" for name, way in others.samplers.items()}
    return replace(
        light, stderr=np.sqrt(stderr), overflow=overflow, change_stderr=np.sqrt(change),
        change_errors=np.sqrt(changes), relative_error=relative, rays=rays, samplers={**light.samplers, **ways},
    )  # fmt: skip


def _with_frame(light: SequenceLight, f: int, whole: Transient) -> SequenceLight:
    """The light with another one in place of that of frame f."""
    stderr, norms = light.stderr.copy(), [l2_norm(light.total(k)) for k in range(light.frames)]
    moving, overflow, relative = light.moving.copy(), light.overflow.copy(), light.relative_error.copy()
    moving[f], overflow[f], stderr[f] = whole.total - light.static, whole.overflow, whole.stderr
    norms[f], relative[f] = l2_norm(whole.total), whole.relative_error
    change, changes = light.change_stderr.copy(), light.change_errors.copy()
    # Of frames that share nothing the errors add up.
    for k in (f, f + 1):
        if 0 < k < light.frames:
            change[k] = np.hypot(stderr[k], stderr[k - 1])
            changes[k] = math.hypot(relative[k] * norms[k], relative[k - 1] * norms[k - 1])
    points = light.laser_points.copy()
    points[f] = whole.laser_points
    parts, errors = dict(light.parts), dict(light.part_errors)
    for name in parts:
        parts[name] = parts[name].copy()
        parts[name][f] = whole.parts.get(name, 0.0)
    for name in errors:
        errors[name] = errors[name].copy()
        errors[name][f] = whole.part_errors.get(name, np.nan)
    return replace(
        light, moving=moving, overflow=overflow, stderr=stderr, relative_error=relative, change_stderr=change,
        change_errors=changes, laser_points=points, parts=parts, part_errors=errors,
    )  # fmt: skip


def _frame_instants(times: Floats, exposure_s: float, bins: float) -> Floats:
    """(F, S) instants of frames that are simulated as a whole, seconds, in which paths change by so many bins."""
    return instants(times.mean(axis=1), exposure_s, bins, MOST_WHOLE).T


def _frame(scene: Scene, capture: Capture, at: Floats, accuracy: Accuracy, seed: int) -> Transient:
    """The mean light of the scene as it stands at instants (S,), seconds."""
    return transient_of_moments([scene.at(float(time_s)) for time_s in at], capture, accuracy, seed)


class _Errors(NamedTuple):
    """Errors of the changes from frame to frame: standard errors (F, L, P, T), and L2 errors (F,), photons."""

    stderr: Floats
    error: Floats


def _apart_of(frames: Sequence[Transient]) -> _Errors:
    """Errors of the changes between frames that were simulated by themselves, at most: those of both together. With
    the same random numbers most of them cancel, but nothing tells how much."""
    stderr = np.array([frame.stderr for frame in frames])
    error = np.array([frame.relative_error * l2_norm(frame.total) for frame in frames])
    both, every = np.zeros_like(stderr), np.zeros_like(error)
    both[1:], every[1:] = np.hypot(stderr[1:], stderr[:-1]), np.hypot(error[1:], error[:-1])
    return _Errors(both, every)


def _of_transients(scene: Scene, times: Floats, frames: Sequence[Transient], seconds: float) -> SequenceLight:
    """The light of a sequence whose frames were simulated by themselves."""
    first, changes = frames[0], _apart_of(frames)
    objects = [name for name in scene.objects if name in first.parts]
    met = [frame.met_target for frame in frames]
    errors = {name: np.array([frame.part_errors.get(name, np.nan) for frame in frames]) for name in objects}
    names = list(first.components)
    samplers = {name: "/".join(sorted({frame.samplers.get(name, "paths") for frame in frames})) for name in names}
    return SequenceLight(
        first.time, times, np.zeros(first.stderr.shape), np.array([frame.total for frame in frames]),
        {name: np.array([frame.parts[name] for frame in frames]) for name in objects},
        np.array([frame.stderr for frame in frames]), changes.stderr, changes.error,
        np.array([frame.overflow for frame in frames]), np.array([frame.laser_points for frame in frames]),
        np.array([frame.relative_error for frame in frames]), None if None in met else np.array(met, np.bool_),
        errors, {name: f"frames: {samplers[name]}" for name in names},
        {name: float(sum(frame.rays.get(name, 0.0) for frame in frames)) for name in names}, {"trace": seconds},
    )  # fmt: skip
