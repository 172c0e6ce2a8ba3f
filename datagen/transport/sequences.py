"""The light of sequences: frames of a scene in which things move, or that a moving sensor looks at."""

from __future__ import annotations

import time as clock_time
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple
from warnings import warn

import numpy as np

from datagen.errors import InputError, InputWarning, shown
from datagen.records import Accuracy, Capture, Clock, Scene, SequenceLight, Transient
from datagen.records.arrays import Floats, l2_norm
from datagen.records.checks import check_kind, check_seed
from datagen.transport.coincidence import set_apart
from datagen.transport.simulate import transient_of, warnings_of


def simulate_sequence(
    scene: Scene, capture: Capture | Sequence[Capture], clock: Clock, accuracy: Accuracy | None = None, seed: int = 0,
    *, exposure_s: float | None = None,
) -> SequenceLight:  # fmt: skip
    """The light of all frames of a scene whose parts move along their paths.

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
    captures = _captures(capture, clock.frames)
    accuracy = Accuracy() if accuracy is None else accuracy
    check_kind("accuracy", accuracy, Accuracy, remedy="an error to be met is Accuracy(target=0.05)")
    check_seed(seed)
    times = times_of(captures[0], clock, exposure_s)
    for line in warnings_of(set_apart(scene.at(0.0), captures[0]), captures[0], accuracy):
        warn(f"simulate_sequence: {line}", InputWarning, stacklevel=2)
    return light_of_frames(scene, captures, times, accuracy, seed)


def _captures(capture: Capture | Sequence[Capture], frames: int) -> list[Capture]:
    """A capture for each frame; raises `InputError` for others."""
    if isinstance(capture, Capture):
        return [capture] * frames
    check_kind("capture", capture, Capture, Sequence, remedy="or one for each frame")
    for number, one in enumerate(capture):
        check_kind(f"capture[{number}]", one, Capture)
        for name in ("shape", "time", "pairing", "illumination"):
            if getattr(one, name) != getattr(capture[0], name):
                raise InputError(
                    f"capture[{number}].{name} = {shown(getattr(one, name))}: that of capture[0] is "
                    f"{shown(getattr(capture[0], name))}; all frames must be measured alike"
                )
    if len(capture) != frames:
        raise InputError(f"capture: {len(capture)} given for {frames} frames; give one, or one for each frame")
    return list(capture)


def times_of(capture: Capture, clock: Clock, exposure_s: float | None) -> Floats:
    """(F, L) seconds at which the laser points of each frame are measured; of a flood (F, 1).

    exposure_s : of a laser point; exposures fill their frames if it is None.
    """
    points = capture.shape[0]
    # A flood lights all of its points at once, in whatever order a scan would.
    clock = replace(clock, order="together", columns=None) if capture.illumination == "flood" else clock
    if exposure_s is None:
        exposure_s = 1.0 / clock.rate_hz / (1 if clock.order == "together" else points)
    times = clock.times(points, exposure_s)
    return np.asarray(np.broadcast_to(times, (clock.frames, points)))


def light_of_frames(
    scene: Scene, captures: Sequence[Capture], times: Floats, accuracy: Accuracy, seed: int
) -> SequenceLight:  # fmt: skip
    """The same as `simulate_sequence`, without checks and warnings, for arguments that were checked before.

    captures : one for each frame. times : (F, L) seconds.
    """
    began = clock_time.perf_counter()
    frames = [
        _frame(scene, capture, float(at.mean()), accuracy, seed) for capture, at in zip(captures, times, strict=True)
    ]
    return _of_transients(scene, times, frames, clock_time.perf_counter() - began)


def _frame(scene: Scene, capture: Capture, time_s: float, accuracy: Accuracy, seed: int) -> Transient:
    """The light of the scene as it stands at a time."""
    apart = set_apart(scene.at(time_s), capture)
    return transient_of(apart.scene, capture, accuracy, seed, caster=apart.caster)


class _Errors(NamedTuple):
    """Of changes: standard errors (F, L, P, T), and L2 errors (F,), photons."""

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
