"""Captures held against their simulation: what a sensor recorded at known poses, and what its device gives there.

The light that a posed device gets from a mesh is that of one bounce (`datagen.transport.flood`), for each part of the
mesh with albedo 1. Freed of saturation (`saturation.unsaturated`), counts are linear in the parts' albedos and a
floor, so these follow from a non-negative least-squares fit, each histogram weighted by 1 / ‖histogram‖. What is not
linear is fitted around it by Levenberg–Marquardt, step by step, so that the gain of each step is seen:

    hand     the sensor on its mount: a turn and a shift from each frame's `pose` to the aperture;
    mesh     where the mesh stands: a turn and a shift from the file's coordinates to those of the poses;
    zones    the device: place, gain and delay of each zone, their common size and blur, crosstalk, spread of light;
    bounces  light of two bounces, a factor for each pair of parts (linear, see `surfaces.py`);
    angles   reflectance of each part by angle (linear, too).

The fit, the choice of the sensor's mode among them, gets the frames of `frames.fitted_and_tested` alone. Errors are
those of the other frames, simulated with the numbers that the fit found.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from datagen.config.device import DeviceConfig, device_names
from datagen.devices.agreement import Fitted, relative_l2
from datagen.devices.comparison import Comparison
from datagen.devices.frames import Frames, fitted_and_tested
from datagen.devices.model import Device, device, has_shape_of, recorded_by
from datagen.devices.saturation import blind_periods
from datagen.devices.session import GROUPS, Group, Session
from datagen.devices.surfaces import Pieces
from datagen.devices.unknowns import State
from datagen.errors import InputError
from datagen.records import Part
from datagen.records.checks import as_names, check_callable, check_choice, check_kind

DEFAULT: tuple[Group, ...] = ("hand", "mesh", "bounces", "angles")
FITTED_FRAMES = 32
"""Most frames of a fit, evenly spread over those that it may see: its time grows with them, and its errors fall with
their square root."""
FEWEST_HELD_OUT = 16
"""Frames from which half are held out to test. With fewer, twelve numbers of places would hang on too few poses."""
CLEARLY_BETTER = 0.8
"""Error of the zones in another order, relative to that as listed, below which the file is taken to list them so.
Around the real pyramid the right order is 0.54 to 0.61 of every other one, before the mount is fitted."""


def compare(
    frames: Frames, sensor: Device, parts: Sequence[Part], *, fit: Sequence[Group] = DEFAULT,
    doing: Callable[[str], None] | None = None,
) -> Comparison:  # fmt: skip
    """Frames of a sensor at known poses before a known mesh, held against their simulation.

    Parameters
    ----------
    frames : histograms and poses, in the order of recording. Of 16 frames or more the second and fourth quarter are
        held out and tested; the fit sees the others, 32 at most.
    sensor : the device that recorded them. If the catalogue has it in other modes, too (its name and `_`), that mode
        is taken which fits best, as frames do not say in which they were taken.
    parts : the mesh, in the coordinates of the poses; albedos are fitted (`read_parts`).
    fit : what is fitted besides albedos and floor (see the module), in the order hand, mesh, zones, bounces, angles.
    doing : called with a line of text before each step of the work, which takes seconds.

    Raises
    ------
    InputError : no poses, another number of zones or bins than the device has, histograms without a count, more
        counts than the device has cycles, no part in sight, or zones that fit far better in another order than the
        device's, if the file does not state its order.
    """
    check_kind("frames", frames, Frames, remedy="such as read_frames(path)")
    check_kind("sensor", sensor, DeviceConfig, remedy="such as dg.device('tmf8820')")
    check_kind("parts", parts, Sequence, remedy="such as read_parts(['plate.stl'])")
    for number, part in enumerate(parts):
        check_kind(f"parts[{number}]", part, Part, remedy="such as read_parts(['plate.stl'])")
    check_callable("doing", doing, "it gets a line of text")
    for group in as_names("fit", fit, f"any of {', '.join(GROUPS)}"):
        check_choice("fit", group, GROUPS)
    doing = doing or (lambda what: None)
    order_is_stated = frames.zone_order is not None
    frames, modes = _frames_and_modes(frames, sensor)
    held_out = len(frames) >= FEWEST_HELD_OUT
    everything = np.arange(len(frames))
    fitted, tested = fitted_and_tested(len(frames)) if held_out else (everything, everything)
    fitted = fitted[np.unique(np.linspace(0, len(fitted) - 1, FITTED_FRAMES).round().astype(int))]
    session, test = Session.of(frames.some(fitted), parts, doing), frames.some(tested)
    groups: list[Group] = [group for group in GROUPS if group in fit]
    starts = [State(mode, np.zeros(6), np.zeros(6), Pieces(session.scene.part_names)) for mode in modes]
    if not order_is_stated:
        _check_order(frames.source, [session.errors_by_order(start) for start in starts])
    trials = [session.after(start, groups[:1]) for start in starts]
    best = int(np.argmin([np.median(session.errors(state)) for state, _ in trials]))
    states, (state, numbers) = {"albedos, floor": starts[best]}, trials[best]
    for count, group in enumerate(groups, 1):
        if count > 1:
            state, found = session.after(state, groups[:count])
            numbers = numbers | found
        states[f"+ {group}"] = state
    steps = {}
    for what, state in states.items():
        doing(f"{len(test)} frames are simulated after a fit of {what.removeprefix('+ ')}")
        linear = session.linear(state)
        modelled = session.at(test).expected_events(state, linear.numbers, linear.floor.value)
        error = relative_l2(modelled, test.histograms)
        steps[what] = float(np.median(error)), float(np.percentile(error, 90))
    cycles = state.device.counting.cycles
    of_floor = {"floor (counts a bin)": Fitted(linear.floor.value * cycles, linear.floor.error * cycles)}
    return Comparison(
        frames.source, state.device.name, linear.by_name | of_floor | numbers, steps, test.histograms, modelled,
        state.device, held_out, linear.reflectances,
    )  # fmt: skip


def _frames_and_modes(frames: Frames, sensor: Device) -> tuple[Frames, list[Device]]:
    """The frames without a leading reference channel, and the modes of the sensor that have their shape. Raises
    `InputError` as `compare` does."""
    if frames.poses is None:
        raise InputError(f"{frames.source}: has no poses (`pose`); frames at known poses are needed")
    modes = [sensor, *(device(name) for name in device_names() if name.startswith(f"{sensor.name}_"))]
    modes = [mode for mode in modes if has_shape_of(frames, mode, mode.zones.count)] or [sensor]
    frames = recorded_by(frames.source, frames, modes[0], modes[0].zones.count)
    sums = frames.histograms.sum(axis=2)
    if not sums.all():
        raise InputError(
            f"{frames.source}: {np.sum(sums == 0)} histograms are empty; leave their frames out, since an error "
            "relative to nothing says nothing"
        )
    for mode in modes:
        most, blind, cycles = sums.max(), blind_periods(mode), mode.counting.cycles
        if not most * (1 + blind) < cycles:
            raise InputError(
                f"{frames.source}: a zone counted {most:.0f} events, {mode.name} has counting.cycles = {cycles}, "
                f"which give at most {cycles / (1 + blind):.0f}; raise cycles in a device file"
            )
    return frames, modes


def _check_order(source: str, errors_by_mode: Sequence[dict[str, float]]) -> None:
    """Raise `InputError` where the zones of frames fit far better in another order than in the device's, in the mode
    that fits best."""
    errors = min(errors_by_mode, key=lambda of: of[""])
    best = min(errors, key=lambda name: errors[name])
    if errors[best] < CLEARLY_BETTER * errors[""]:
        raise InputError(
            f"{source}: histograms are {errors['']:.0%} off as listed, and {errors[best]:.0%} if zones are listed as "
            f"{best!r}: state zone_order in the file (docs/devices.md), this or the one that they have"
        )
