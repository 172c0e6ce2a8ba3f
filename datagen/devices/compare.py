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

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Literal
from warnings import warn

import numpy as np
import scipy.optimize
from scipy.ndimage import convolve1d
from scipy.spatial.transform import Rotation

from datagen.capture.device_optics import zone_boxes
from datagen.config.device import DeviceConfig, device_names
from datagen.detector import expected_histogram
from datagen.detector.flux import dark_count_rates
from datagen.devices.agreement import Fitted, HistogramErrors, clustered_covariance, relative_l2
from datagen.devices.frames import Frames, fitted_and_tested
from datagen.devices.model import Device, device, has_shape_of, recorded_by
from datagen.devices.saturation import blind_periods, saturated, unsaturated
from datagen.devices.surfaces import UNIT, Pieces, material_of
from datagen.devices.zone_order import ORDERS, grid_of, zones_listed
from datagen.errors import InputError, InputWarning
from datagen.records import Lambertian, Material, Part, Scene
from datagen.records.arrays import Floats
from datagen.records.checks import as_names, as_paths, check_callable, check_choice, check_kind, check_path, option
from datagen.store.manifest import Manifest
from datagen.store.scenes import Scenes
from datagen.transport.brdf import MaterialTable
from datagen.transport.flood import RAYS, glass_light
from datagen.transport.rays import Raycaster
from scene_library.mesh_file import BadMesh
from scene_library.meshes import read_mesh

Placed = Literal["hand", "mesh", "zones"]
PLACED: tuple[Placed, ...] = ("hand", "mesh", "zones")
"""Groups of numbers that the light is not linear in."""
Group = Literal["hand", "mesh", "zones", "bounces", "angles"]
GROUPS: tuple[Group, ...] = (*PLACED, "bounces", "angles")
DEFAULT: tuple[Group, ...] = ("hand", "mesh", "bounces", "angles")
FIT_RAYS = 1 << 12
"""Rays of a frame's light while it is fitted. The time of a fit grows with them; with 2048 fitted shifts err by
0.2 mm more. Frames that test are simulated with `flood.RAYS`."""
FITTED_FRAMES = 32
"""Most frames of a fit, evenly spread over those that it may see: its time grows with them, and its errors fall with
their square root."""
FEWEST_HELD_OUT = 16
"""Frames from which half are held out to test. With fewer, twelve numbers of places would hang on too few poses."""
STEPS = 12
"""Most steps of a fit, each of which simulates the frames twice for every fitted number; fits of places converge
in about half of them."""
CLEARLY_BETTER = 0.8
"""Error of the zones in another order, relative to that as listed, below which the file is taken to list them so.
Around the real pyramid the right order is 0.54 to 0.61 of every other one, before the mount is fitted."""
PRIOR_WEIGHT = 0.01
"""Relative error of one histogram that costs a fit as much as a number that is one standard deviation of its prior
away from the prior's mean; histograms err by several times as much."""
ANGLES_DIFFER = 0.2
"""Standard deviation of the difference of a part's reflectances at neighbouring cosines: that of rough and of weakly
glossy surfaces. Angles that no frame shows follow from those that some do."""
CONCAVE_RAD = 0.1
"""Angle of a concave edge from which it divides a mesh into parts; flatter ones are taken for curved surfaces."""
TAIL_BINS = 8.0
"""Decay of the late light that `Comparison.left` looks for, bins: longer than the pulses of sensors of zones, which
would be taken for it, and shorter than their window."""
MOST_ZONES_LISTED = 64
"""Zones up to which the table has a line for each: sensors of 8 × 8 zones have one, cameras do not."""
MEANING = {
    "brightness": "gains of zones, albedos that vary over a part, gloss",
    "time": "places of sensor, mesh and zones; delays; drift",
    "width": "pulse, size of zones, rough surfaces",
    "late light": "light of several bounces, tail of the pulse, what the mesh lacks",
}
MOST_PARTS = 8
"""Pieces of a mesh that get albedos of their own. A mesh of more is one part: nine zones tell few albedos apart."""
TURN_STEP_RAD, SHIFT_STEP_M = 6e-3, 8e-4
"""Steps of the differences of turns and shifts. In smaller ones the noise of rays that pass an edge is larger."""


@dataclass(frozen=True)
class Comparison(HistogramErrors):
    """Histograms as recorded and as simulated.

    Attributes
    ----------
    source, simulated_as : what was recorded, and by what it was simulated.
    fitted : name → number with its standard error.
    steps : what was fitted so far → median and 90th percentile of the relative L2 of the tested histograms.
    measured, modelled : (n, zones, bins) the tested histograms, counts.
    device : the device as fitted; None for two datasets.
    held_out : whether the fit did not see the tested histograms.
    reflectances : part that was seen → its reflectance back to where light comes from, relative to a white matt
        surface: one number, or one for each of evenly spaced cosines from 0 to 1 where it was fitted by angle.
    """

    source: str
    simulated_as: str
    fitted: dict[str, Fitted]
    steps: dict[str, tuple[float, float]]
    measured: Floats
    modelled: Floats
    device: Device | None = None
    held_out: bool = False
    reflectances: dict[str, tuple[float, ...]] = field(default_factory=dict)

    @property
    def materials(self) -> dict[str, Material]:
        """Part that was seen → its material, for scenes of your own (`write_materials` writes a file of them).

        Raises `InputError` where more light would leave a surface than arrives.
        """
        return {part: material_of(part, values) for part, values in self.reflectances.items()}

    @cached_property
    def residual_sd(self) -> Floats:
        """(zones,) root mean square of (measured − modelled) / √modelled: 1 if Poisson noise alone is left."""
        squares = (self.measured - self.modelled) ** 2 / np.maximum(self.modelled, 1.0)
        return np.asarray(np.sqrt(squares.mean(axis=(0, 2))))

    @cached_property
    def left(self) -> dict[str, float]:
        """What would explain the residuals: effect → share of ‖modelled − measured‖² that it removes if it is free
        in every histogram. Shares overlap, since effects resemble each other; all are 0 where nothing is left."""
        model = self.modelled
        residual = self.measured - model
        slope, bend = np.gradient(model, axis=2), np.gradient(np.gradient(model, axis=2), axis=2)
        taps = np.exp(-np.arange(int(6 * TAIL_BINS)) / TAIL_BINS)
        late = convolve1d(
            model, np.concatenate([np.zeros(len(taps) - 1), taps / taps.sum()]), axis=2, mode="constant"
        )
        weight = 1 / (self.measured**2).sum(axis=2)
        shares = {}
        for name, shape in (("brightness", model), ("time", slope), ("width", bend), ("late light", late)):
            along = (residual * shape).sum(axis=2) ** 2 / np.maximum((shape**2).sum(axis=2), 1e-300)
            left = float((weight * (residual**2).sum(axis=2)).sum())
            shares[name] = float((weight * along).sum()) / left if left > 0 else 0.0
        return shares

    def as_dict(self) -> dict[str, Any]:
        """All numbers, as `datagen compare --json` writes them."""
        error, shift = self.relative_l2, np.abs(self.peak_shift)
        return {
            "source": self.source,
            "simulated_as": self.simulated_as,
            "tested_frames": len(self.measured),
            "held_out": self.held_out,
            "median_relative_l2": float(np.median(error)),
            "p90_relative_l2": float(np.percentile(error, 90)),
            "median_relative_l2_by_zone": np.median(error, axis=0).tolist(),
            "p90_relative_l2_by_zone": np.percentile(error, 90, axis=0).tolist(),
            "residual_sd_by_zone": self.residual_sd.tolist(),
            "peak_shift_bins": {"median": float(np.median(shift)), "p90": float(np.percentile(shift, 90))},
            "peak_shift_bins_by_zone": np.median(self.peak_shift, axis=0).tolist(),
            "fitted": {name: {"value": of.value, "error": of.error} for name, of in self.fitted.items()},
            "steps": {name: {"median": a, "p90": b} for name, (a, b) in self.steps.items()},
            "left": self.left,
            "reflectances": {part: list(values) for part, values in self.reflectances.items()},
        }

    def text(self) -> str:
        """The numbers as a table."""
        error, shift = self.relative_l2, np.abs(self.peak_shift)
        zones = error.shape[1]
        lines = [f"{self.source}, simulated as {self.simulated_as}; {self.tested}", "fitted:"]
        lines += [f"  {name:32} {number}" for name, number in self.fitted.items()]
        lines.append("relative L2 of histograms, median (90th percentile), after fitting")
        lines += [f"  {name:32} {a:.4f} ({b:.4f})" for name, (a, b) in self.steps.items()]
        lines.append(
            f"peak: median of |shift| {np.median(shift):.3f} bins, 90th percentile {np.percentile(shift, 90):.3f}"
        )
        if zones <= MOST_ZONES_LISTED:
            lines.append(
                "by zone: relative L2, residual in standard deviations of Poisson noise, shift of the peak (bins)"
            )
            medians, shifts = np.median(error, axis=0), np.median(self.peak_shift, axis=0)
            lines += [
                f"  {zone:4} {medians[zone]:8.4f} {self.residual_sd[zone]:8.1f} {shifts[zone]:+8.3f}"
                for zone in range(zones)
            ]
        lines.append("of what is left, this would be explained by a free")
        lines += [f"  {name:12} {share:5.0%}  ({MEANING[name]})" for name, share in self.left.items()]
        return "\n".join(lines)


def read_parts(paths: Sequence[str | Path]) -> list[Part]:
    """The parts of mesh files in metres, in the coordinates of the poses: their albedos are fitted one by one.

    A file is divided at its concave edges, where surfaces usually change (a thing on a table), as far as these cut it
    into pieces. A `.glb`, whose y is up, is turned about x until z is up. Raises `InputError` for a file that
    cannot be read.
    """
    # Here, because it takes half a second, and every command that makes a scene imports this module.
    import trimesh

    parts = []
    for path in as_paths(option("paths"), paths, "name mesh files"):
        try:
            mesh_file = read_mesh(path)
        except BadMesh as error:
            raise InputError(f"{path}: {error}") from None
        if mesh_file.doubt:
            warn(f"{path}: {mesh_file.doubt}", InputWarning, stacklevel=2)
        whole = trimesh.Trimesh(mesh_file.vertices, mesh_file.triangles, process=True)
        joined = whole.face_adjacency_convex | (whole.face_adjacency_angles < CONCAVE_RAD)
        pieces = trimesh.graph.connected_components(
            whole.face_adjacency[joined], nodes=np.arange(len(whole.faces)), min_len=1
        )
        pieces = sorted(pieces, key=lambda piece: -float(whole.area_faces[piece].sum()))
        if len(pieces) > MOST_PARTS:
            pieces = [np.arange(len(whole.faces))]
        for number, piece in enumerate(pieces):
            name = path.stem if len(pieces) == 1 else f"{path.stem} {number}"
            mesh = trimesh.Trimesh(whole.vertices, whole.faces[piece], process=False)
            parts.append(Part(name, mesh, Lambertian(UNIT), "object"))
    names = [part.name for part in parts]
    if len(set(names)) < len(names):
        raise InputError(f"{option('paths')}: {', '.join(names)}: two files give parts of one name; rename a file")
    return parts


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
    frames, modes = _checked(frames, sensor)
    held_out = len(frames) >= FEWEST_HELD_OUT
    everything = np.arange(len(frames))
    fitted, tested = fitted_and_tested(len(frames)) if held_out else (everything, everything)
    fitted = fitted[np.unique(np.linspace(0, len(fitted) - 1, FITTED_FRAMES).round().astype(int))]
    session, test = _Session.of(frames.some(fitted), parts, doing), frames.some(tested)
    groups: list[Group] = [group for group in GROUPS if group in fit]
    starts = [_State(mode, np.zeros(6), np.zeros(6), Pieces(session.scene.part_names)) for mode in modes]
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


def _checked(frames: Frames, sensor: Device) -> tuple[Frames, list[Device]]:
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


def compare_datasets(recorded: str | Path, simulated: str | Path) -> Comparison:
    """The histograms of all scenes that two datasets have in common; one scale and one floor are fitted.

    recorded, simulated : folders of datasets with the field histogram; each pixel of each laser point is a zone, and
        each scene a frame; of sequences each frame of each scene.

    Raises `InputError` for datasets without histograms, of other shapes or times, or with no scene in common.
    """
    for name, path in (("recorded", recorded), ("simulated", simulated)):
        check_path(name, path, "name the folder of a dataset")
    ours, theirs = Scenes(recorded), Scenes(simulated)
    common = sorted(set(ours.made()) & set(theirs.made()))
    for dataset in (ours, theirs):
        if "histogram" not in dataset.manifest.schema.by_name:
            raise InputError(f"{dataset.root}: has no field histogram; build it with histogram in store.fields")
    _check_alike(ours.manifest, theirs.manifest, f"{recorded} and {simulated}")
    if not common:
        raise InputError(f"{recorded} and {simulated}: have no scene in common; number scenes alike")
    stacks = [
        np.stack([np.asarray(dataset.read(index).arrays["histogram"], np.float64) for index in common])
        for dataset in (ours, theirs)
    ]
    if stacks[0].shape != stacks[1].shape:
        shapes = " and ".join(
            f"({', '.join(dataset.manifest.schema.by_name['histogram'].dims[1:])}) {stack.shape[1:]}"
            for dataset, stack in zip((ours, theirs), stacks, strict=True)
        )
        raise InputError(f"{recorded} and {simulated}: histograms of {shapes}; they must be alike")
    measured, model = (stack.reshape(-1, math.prod(stack.shape[-3:-1]), stack.shape[-1]) for stack in stacks)
    lit = np.linalg.norm(measured, axis=2, keepdims=True) > 0
    if not lit.all():
        raise InputError(f"{recorded}: {np.sum(~lit)} histograms are empty; nothing can be compared with them")
    weight = 1 / np.linalg.norm(measured, axis=2, keepdims=True)
    design = np.stack([(model * weight).ravel(), np.broadcast_to(weight, model.shape).ravel()], axis=1)
    # A floor that the simulation has, too, may have to be lowered.
    (scale, floor), *_ = np.linalg.lstsq(design, (measured * weight).ravel())
    residual = (measured * weight).ravel() - design @ [scale, floor]
    errors = np.sqrt(np.diag(clustered_covariance(design, residual, len(common))))
    fitted = {
        "scale": Fitted(float(scale), float(errors[0])),
        "floor (counts a bin)": Fitted(float(floor), float(errors[1])),
    }
    modelled = scale * model + floor
    steps = {}
    for name, values in (("nothing", model), ("scale, floor", modelled)):
        error = relative_l2(values, measured)
        steps[name] = float(np.median(error)), float(np.percentile(error, 90))
    return Comparison(str(recorded), str(simulated), fitted, steps, measured, modelled)


def _check_alike(recorded: Manifest, simulated: Manifest, names: str) -> None:
    """Raise `InputError` where histograms of two datasets have other times, or come from another kind of scan."""
    one, other = recorded.time, simulated.time
    half = min(one.width_s, other.width_s) / 2
    ends = abs(one.start_s - other.start_s), abs(one.stop_s - other.stop_s)
    if one.bins == other.bins and (one.origin != other.origin or max(ends) > half):
        texts = (f"{t.width_s * 1e12:.6g} ps from {t.start_s * 1e9:.6g} ns on ({t.origin})" for t in (one, other))
        raise InputError(
            f"{names}: bins of {' and of '.join(texts)}; they must be the same times, so simulate with the time axis "
            "of what was recorded"
        )
    for key, usual in (("pairing", "exhaustive"), ("illumination", "scan")):
        kinds = [manifest.config["capture"].get(key, usual) for manifest in (recorded, simulated)]
        if kinds[0] != kinds[1]:
            raise InputError(f"{names}: capture.{key} is {kinds[0]} and {kinds[1]}; they must be alike")


@dataclass(frozen=True)
class _State:
    """A device, the turn (rotation vector) and shift, metres, of hand (in the sensor's frame) and mesh, and what the
    light is divided into."""

    device: Device
    hand: Floats
    mesh: Floats
    pieces: Pieces


@dataclass(frozen=True)
class _Linear:
    """A linear fit: numbers (pieces,), also by name with errors, the floor in events per cycle, and reflectances."""

    numbers: Floats
    floor: Fitted
    by_name: dict[str, Fitted]
    reflectances: dict[str, tuple[float, ...]]


@dataclass(frozen=True)
class _Session:
    """Frames, and what they are of. A fit sees the frames of its session alone. centre : (3,) the point that the mesh
    is turned around."""

    counts: Floats
    poses: Floats
    scene: Scene
    caster: Raycaster
    materials: MaterialTable
    centre: Floats
    doing: Callable[[str], None]

    @classmethod
    def of(cls, frames: Frames, parts: Sequence[Part], doing: Callable[[str], None]) -> _Session:
        """The session of frames before a mesh. Raises `InputError` if no frame's axis meets it."""
        assert frames.poses is not None
        scene = Scene.from_parts(list(parts))
        caster = Raycaster(scene)
        seen = caster.closest(frames.poses[:, :3, 3], frames.poses[:, :3, 2])
        if not seen.valid.any():
            raise InputError(
                f"{frames.source}: in no frame does the sensor's axis meet the mesh; give the mesh in metres, in the "
                "coordinates of the poses, whose third column looks out"
            )
        centre = np.median(seen.position[seen.valid], axis=0)
        materials = MaterialTable.of(scene.materials)
        return cls(frames.histograms, frames.poses, scene, caster, materials, centre, doing)

    def at(self, frames: Frames) -> _Session:
        """The session of other frames before the same mesh."""
        assert frames.poses is not None
        return replace(self, counts=frames.histograms, poses=frames.poses)

    def placed(self, state: _State, pose: Floats) -> Floats:
        """(4, 4) pose of the aperture before the mesh as its file has it, of a stated pose (4, 4)."""
        hand = np.eye(4)
        hand[:3, :3], hand[:3, 3] = Rotation.from_rotvec(state.hand[:3]).as_matrix(), state.hand[3:]
        pose = pose @ hand
        back = Rotation.from_rotvec(state.mesh[:3]).as_matrix().T
        pose[:3, :3] = back @ pose[:3, :3]
        pose[:3, 3] = back @ (pose[:3, 3] - self.centre - state.mesh[3:]) + self.centre
        return np.asarray(pose)

    def light(self, state: _State, pose: Floats, rays: int) -> Floats:
        """(pieces + 1, zones, steps) light of each piece with the number 1, as the zones record it, and of the
        glass."""
        capture, _, _ = state.device.at_pose(self.placed(state, pose))
        light = state.pieces.light(self.scene, capture, self.caster, self.materials, rays)
        return np.concatenate([light, glass_light(capture)])

    def events(self, state: _State, rays: int = FIT_RAYS) -> Floats:
        """(pieces + 1, n, zones, bins) events per cycle of that light, without saturation."""
        spad = replace(state.device.spad, mode="ideal", dead_time_s=0.0, dark_count_rate_hz=0.0)
        exposure = replace(state.device.exposure, cycles=1, ambient_rate_hz=0.0)
        counted = [
            expected_histogram(self.light(state, pose, rays), state.device.axis, spad, exposure)
            for pose in self.poses
        ]
        return np.stack(counted, axis=1)

    def errors_by_order(self, state: _State) -> dict[str, float]:
        """Order of the zones → median relative L2 of the histograms if the frames list them so; "" for the device's
        own order."""
        events, zones = self.events(state), state.device.zones
        count, errors = self.counts.shape[1], {"": 0.0}
        errors[""] = float(np.median(self.errors(state, events)))
        for name in ORDERS if grid_of(zones) is not None else ():
            listed = zones_listed("", name, zones, count)
            if not np.array_equal(listed, np.arange(count)):
                turned = replace(self, counts=self.counts[:, np.argsort(listed)])
                errors[name] = float(np.median(turned.errors(state, events)))
        return errors

    def balanced(self, state: _State, given: Floats | None = None) -> tuple[Floats, Floats, Floats, Floats]:
        """The linear fit: numbers (pieces + 1,) of the pieces and the floor; the modelled events (n, zones, bins);
        the design (rows, pieces + 1) and the residuals (rows,) of the fit, those of the frames first.

        given : the `events` of the state, where the caller has them.
        """
        device_ = state.device
        *pieces, glass = self.events(state) if given is None else given
        events = unsaturated(self.counts, device_.counting.cycles, blind_periods(device_)) - glass
        weight = 1 / np.linalg.norm(events, axis=2, keepdims=True)
        floors = dark_count_rates(replace(device_.spad, dark_count_rate_hz=1.0), events.shape[1])[:, None]
        columns = [(piece * weight).ravel() for piece in pieces] + [(floors * np.ones_like(events) * weight).ravel()]
        prior = PRIOR_WEIGHT / ANGLES_DIFFER * state.pieces.differences()
        design = np.concatenate([np.stack(columns, axis=1), np.pad(prior, ((0, 0), (0, 1)))])
        target = np.append((events * weight).ravel(), np.zeros(len(prior)))
        scale = np.maximum(np.linalg.norm(design, axis=0), 1e-300)
        found = scipy.optimize.nnls(design / scale, target)[0] / scale
        modelled = np.einsum("k,knzb->nzb", found[:-1], np.stack(pieces)) + found[-1] * floors + glass
        return found, modelled, design, target - design @ found

    def linear(self, state: _State) -> _Linear:
        """The linear fit with all rays; standard errors are by frames."""
        events = self.events(state, RAYS)
        found, modelled, design, residual = self.balanced(state, events)
        covariance = clustered_covariance(design, residual[: modelled.size], len(self.counts))
        errors = np.sqrt(np.maximum(np.diag(covariance), 0.0))
        seen = np.array([piece.any() for piece in events[:-1]])
        floor = Fitted(float(found[-1]), float(errors[-1]))
        by_name = state.pieces.by_name(found[:-1], errors[:-1], seen)
        return _Linear(found[:-1], floor, by_name, state.pieces.reflectances(found[:-1], seen))

    def residuals(self, state: _State, given: Floats | None = None) -> Floats:
        """(n, zones, bins) modelled minus measured counts, relative to each histogram's norm."""
        _, modelled, _, _ = self.balanced(state, given)
        model = saturated(modelled, state.device.counting.cycles, blind_periods(state.device))
        return np.asarray((model - self.counts) / np.linalg.norm(self.counts, axis=2, keepdims=True))

    def errors(self, state: _State, given: Floats | None = None) -> Floats:
        """(n, zones) relative L2 of the histograms."""
        return np.asarray(np.linalg.norm(self.residuals(state, given), axis=2))

    def expected_events(self, state: _State, numbers: Floats, floor: float) -> Floats:
        """(n, zones, bins) expected counts with all rays and the detector's own statistics."""
        width = state.device.time.bin_width_ps * 1e-12
        spad = replace(state.device.spad, dark_count_rate_hz=floor / width)
        whole = np.append(numbers, 1.0)
        light = np.stack([np.einsum("k,kzt->zt", whole, self.light(state, pose, RAYS)) for pose in self.poses])
        return expected_histogram(light, state.device.axis, spad, state.device.exposure, approximate=True)

    def after(self, state: _State, groups: Sequence[Group]) -> tuple[_State, dict[str, Fitted]]:
        """The state after a fit of groups, of which all but the last were fitted before; and the numbers that were
        fitted, without those of pieces, which every linear fit finds."""
        if groups and groups[-1] in ("bounces", "angles"):
            # Places are not fitted anew: with more pieces they would follow the noise of the light of two bounces.
            pieces = replace(state.pieces, angles="angles" in groups, bounces="bounces" in groups)
            return replace(state, pieces=pieces), {}
        return self.best_state(state, [group for group in PLACED if group in groups])

    def best_state(self, state: _State, groups: Sequence[Placed]) -> tuple[_State, dict[str, Fitted]]:
        """The state after a fit of groups, and the numbers that were fitted."""
        if not groups:
            return state, {}
        unknowns = [unknown for group in groups for unknown in UNKNOWNS[group](state)]
        begin = np.array([unknown.value for unknown in unknowns])
        unit = np.array([unknown.deviation for unknown in unknowns])
        step = np.array([unknown.step for unknown in unknowns]) / unit
        steps = itertools.count(1)

        def moved(x: Floats) -> _State:
            return _state_with(state, groups, begin + x * unit)

        def residuals(x: Floats) -> Floats:
            prior = np.array([unknown.prior for unknown in unknowns])
            return np.append(self.residuals(moved(x)).ravel(), PRIOR_WEIGHT * ((begin - prior) / unit + x))

        def jacobian(x: Floats) -> Floats:
            what = f"{', '.join(groups)} fitted to {len(self.counts)} frames"
            self.doing(f"{state.device.name}: {what}, step {next(steps)} of at most {STEPS}")
            # Wide central differences, since rays that pass an edge make small ones noisy.
            columns = [
                (residuals(x + along) - residuals(x - along)) / (2 * step[k]) for k, along in enumerate(np.diag(step))
            ]
            return np.stack(columns, axis=1)

        found = scipy.optimize.least_squares(
            residuals, np.zeros(len(unknowns)), jac=jacobian, max_nfev=STEPS, xtol=1e-3, ftol=1e-4
        )
        data = len(found.fun) - len(unknowns)
        errors = np.sqrt(np.diag(clustered_covariance(found.jac, found.fun[:data], len(self.counts)))) * unit
        values = begin + found.x * unit
        numbers = {
            unknown.name: Fitted(float(value * unknown.shown), float(error * unknown.shown))
            for unknown, value, error in zip(unknowns, values, errors, strict=True)
        }
        return moved(found.x), numbers


@dataclass(frozen=True)
class _Unknown:
    """A number that is fitted: its value now, its prior's mean and standard deviation, the step of its differences,
    and the factor to the unit of its name."""

    name: str
    value: float
    prior: float
    deviation: float
    step: float
    shown: float = 1.0


def _placing(which: str, turn_rad: float, shift_m: float) -> Callable[[_State], list[_Unknown]]:
    """What gives the six numbers of the placing `which`, with the standard deviations of turns and shifts."""

    def unknowns(state: _State) -> list[_Unknown]:
        values = getattr(state, which)
        turns = [
            _Unknown(f"{which}: turn {axis} (degrees)", values[k], 0.0, turn_rad, TURN_STEP_RAD, 180 / np.pi)
            for k, axis in enumerate("xyz")
        ]
        shifts = [
            _Unknown(f"{which}: shift {axis} (mm)", values[3 + k], 0.0, shift_m, SHIFT_STEP_M, 1e3)
            for k, axis in enumerate("xyz")
        ]
        return [*turns, *shifts]

    return unknowns


def _of_zones(state: _State) -> list[_Unknown]:
    """The numbers of the device, each with itself as the mean of its prior, in the order of `_with_zones`."""
    zones, light = state.device.zones, state.device.light
    count, boxes = zones.count, zone_boxes(zones)
    gains = np.array(zones.gains or [1.0] * count)
    delays = np.array(zones.delays_ps or [0.0] * count)
    unknowns = [
        _Unknown(f"zones: {axis} of zone {z} (tangent)", boxes[z, k], boxes[z, k], 0.03, 0.004)
        for k, axis in enumerate(("right", "up"))
        for z in range(count)
    ]
    unknowns += [
        _Unknown(f"zones: ln gain of zone {z}", np.log(g), np.log(g), 1.0, 0.03) for z, g in enumerate(gains)
    ]
    unknowns += [_Unknown(f"zones: delay of zone {z} (ps)", d, d, 50.0, 4.0) for z, d in enumerate(delays)]
    unknowns += [_Unknown(f"zones: ln {side} scale", 0.0, 0.0, 0.2, 0.03) for side in ("width", "height")]
    unknowns.append(_Unknown("zones: ln blur", np.log(max(zones.blur, 1e-3)), np.log(0.02), 0.7, 0.1))
    unknowns.append(_Unknown("zones: ln crosstalk", np.log(max(zones.crosstalk, 1e-4)), np.log(0.01), 0.5, 0.1))
    unknowns.append(_Unknown("light: ln spread", np.log(light.spread or 0.5), np.log(0.3), 0.7, 0.05))
    return unknowns


UNKNOWNS: dict[Placed, Callable[[_State], list[_Unknown]]] = {
    "hand": _placing("hand", 0.05, 0.02),
    "mesh": _placing("mesh", 0.02, 0.005),
    "zones": _of_zones,
}


def _state_with(state: _State, groups: Sequence[Placed], values: Floats) -> _State:
    """The state with the numbers of groups, in the order of their unknowns."""
    for group in groups:
        if group == "zones":
            mine, values = values, values[:0]
            state = replace(state, device=_with_zones(state.device, mine))
        else:
            placed, values = values[:6], values[6:]
            state = replace(state, hand=placed) if group == "hand" else replace(state, mesh=placed)
    return state


def _with_zones(sensor: Device, values: Floats) -> Device:
    """The device with other numbers (4 zones + 5,)."""
    count = sensor.zones.count
    right, up, gains, delays, rest = np.split(values, [count, 2 * count, 3 * count, 4 * count])
    width, height, blur, crosstalk, spread = np.exp(rest)
    boxes = zone_boxes(sensor.zones) * [1, 1, width, height]
    boxes[:, 0], boxes[:, 1] = right, up
    zones = sensor.zones.model_copy(update={
        "boxes": tuple(tuple(map(float, box)) for box in boxes), "field_deg": None, "rows": 1, "columns": 1,
        "gains": tuple(map(float, np.exp(gains))), "delays_ps": tuple(map(float, delays)), "blur": float(blur),
        "crosstalk": float(min(crosstalk, 0.5)),
    })  # fmt: skip
    light = sensor.light.model_copy(update={"spread": float(spread)})
    return sensor.model_copy(update={"zones": zones, "light": light})
