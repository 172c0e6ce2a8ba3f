"""Frames of one sensor before one mesh, fitted: the linear numbers by least squares, the others around them."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
import scipy.optimize
from scipy.spatial.transform import Rotation

from datagen.detector import expected_histogram
from datagen.detector.flux import dark_count_rates
from datagen.devices.agreement import Fitted, clustered_covariance
from datagen.devices.frames import Frames
from datagen.devices.saturation import blind_periods, saturated, unsaturated
from datagen.devices.unknowns import PLACED, UNKNOWNS, Placed, State, state_with
from datagen.devices.zone_order import ORDERS, grid_of, zones_listed
from datagen.errors import InputError
from datagen.records import Part, Scene
from datagen.records.arrays import Floats
from datagen.transport.brdf import MaterialTable
from datagen.transport.flood import RAYS, glass_light
from datagen.transport.rays import Raycaster

Group = Literal["hand", "mesh", "zones", "bounces", "angles"]
GROUPS: tuple[Group, ...] = (*PLACED, "bounces", "angles")
FIT_RAYS = 1 << 12
"""Rays of a frame's light while it is fitted. The time of a fit grows with them; with 2048 fitted shifts err by
0.2 mm more. Frames that test are simulated with `flood.RAYS`."""
STEPS = 12
"""Most steps of a fit, each of which simulates the frames twice for every fitted number; fits of places converge
in about half of them."""
PRIOR_WEIGHT = 0.01
"""Relative error of one histogram that costs a fit as much as a number that is one standard deviation of its prior
away from the prior's mean; histograms err by several times as much."""
ANGLES_DIFFER = 0.2
"""Standard deviation of the difference of a part's reflectances at neighbouring cosines: that of rough and of weakly
glossy surfaces. Angles that no frame shows follow from those that some do."""


@dataclass(frozen=True)
class Linear:
    """A linear fit: numbers (pieces,), also by name with errors, the floor in events per cycle, and reflectances."""

    numbers: Floats
    floor: Fitted
    by_name: dict[str, Fitted]
    reflectances: dict[str, tuple[float, ...]]


@dataclass(frozen=True)
class Session:
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
    def of(cls, frames: Frames, parts: Sequence[Part], doing: Callable[[str], None]) -> Session:
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

    def at(self, frames: Frames) -> Session:
        """The session of other frames before the same mesh."""
        assert frames.poses is not None
        return replace(self, counts=frames.histograms, poses=frames.poses)

    def aperture_pose(self, state: State, pose: Floats) -> Floats:
        """(4, 4) pose of the aperture before the mesh as its file has it, of a stated pose (4, 4)."""
        hand = np.eye(4)
        hand[:3, :3], hand[:3, 3] = Rotation.from_rotvec(state.hand[:3]).as_matrix(), state.hand[3:]
        pose = pose @ hand
        back = Rotation.from_rotvec(state.mesh[:3]).as_matrix().T
        pose[:3, :3] = back @ pose[:3, :3]
        pose[:3, 3] = back @ (pose[:3, 3] - self.centre - state.mesh[3:]) + self.centre
        return np.asarray(pose)

    def light(self, state: State, pose: Floats, rays: int) -> Floats:
        """(pieces + 1, zones, steps) light of each piece with the number 1, as the zones record it, and of the
        glass."""
        capture, _, _ = state.device.at_pose(self.aperture_pose(state, pose))
        light = state.pieces.light(self.scene, capture, self.caster, self.materials, rays)
        return np.concatenate([light, glass_light(capture)])

    def events(self, state: State, rays: int = FIT_RAYS) -> Floats:
        """(pieces + 1, n, zones, bins) events per cycle of that light, without saturation."""
        spad = replace(state.device.spad, mode="ideal", dead_time_s=0.0, dark_count_rate_hz=0.0)
        exposure = replace(state.device.exposure, cycles=1, ambient_rate_hz=0.0)
        counted = [
            expected_histogram(self.light(state, pose, rays), state.device.axis, spad, exposure)
            for pose in self.poses
        ]
        return np.stack(counted, axis=1)

    def errors_by_order(self, state: State) -> dict[str, float]:
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

    def least_squares(self, state: State, given: Floats | None = None) -> tuple[Floats, Floats, Floats, Floats]:
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

    def linear(self, state: State) -> Linear:
        """The linear fit with all rays; standard errors are by frames."""
        events = self.events(state, RAYS)
        found, modelled, design, residual = self.least_squares(state, events)
        covariance = clustered_covariance(design, residual[: modelled.size], len(self.counts))
        errors = np.sqrt(np.maximum(np.diag(covariance), 0.0))
        seen = np.array([piece.any() for piece in events[:-1]])
        floor = Fitted(float(found[-1]), float(errors[-1]))
        by_name = state.pieces.by_name(found[:-1], errors[:-1], seen)
        return Linear(found[:-1], floor, by_name, state.pieces.reflectances(found[:-1], seen))

    def residuals(self, state: State, given: Floats | None = None) -> Floats:
        """(n, zones, bins) modelled minus measured counts, relative to each histogram's norm."""
        _, modelled, _, _ = self.least_squares(state, given)
        model = saturated(modelled, state.device.counting.cycles, blind_periods(state.device))
        return np.asarray((model - self.counts) / np.linalg.norm(self.counts, axis=2, keepdims=True))

    def errors(self, state: State, given: Floats | None = None) -> Floats:
        """(n, zones) relative L2 of the histograms."""
        return np.asarray(np.linalg.norm(self.residuals(state, given), axis=2))

    def expected_events(self, state: State, numbers: Floats, floor: float) -> Floats:
        """(n, zones, bins) expected counts with all rays and the detector's own statistics."""
        width = state.device.time.bin_width_ps * 1e-12
        spad = replace(state.device.spad, dark_count_rate_hz=floor / width)
        whole = np.append(numbers, 1.0)
        light = np.stack([np.einsum("k,kzt->zt", whole, self.light(state, pose, RAYS)) for pose in self.poses])
        return expected_histogram(light, state.device.axis, spad, state.device.exposure, approximate=True)

    def after(self, state: State, groups: Sequence[Group]) -> tuple[State, dict[str, Fitted]]:
        """The state after a fit of groups, of which all but the last were fitted before; and the numbers that were
        fitted, without those of pieces, which every linear fit finds."""
        if groups and groups[-1] in ("bounces", "angles"):
            # Places are not fitted anew: with more pieces they would follow the noise of the light of two bounces.
            pieces = replace(state.pieces, angles="angles" in groups, bounces="bounces" in groups)
            return replace(state, pieces=pieces), {}
        return self.best_state(state, [group for group in PLACED if group in groups])

    def best_state(self, state: State, groups: Sequence[Placed]) -> tuple[State, dict[str, Fitted]]:
        """The state after a fit of groups, and the numbers that were fitted."""
        if not groups:
            return state, {}
        unknowns = [unknown for group in groups for unknown in UNKNOWNS[group](state)]
        begin = np.array([unknown.value for unknown in unknowns])
        unit = np.array([unknown.deviation for unknown in unknowns])
        step = np.array([unknown.step for unknown in unknowns]) / unit
        steps = itertools.count(1)

        def state_at(x: Floats) -> State:
            return state_with(state, groups, begin + x * unit)

        def residuals(x: Floats) -> Floats:
            prior = np.array([unknown.prior for unknown in unknowns])
            return np.append(self.residuals(state_at(x)).ravel(), PRIOR_WEIGHT * ((begin - prior) / unit + x))

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
        return state_at(found.x), numbers
