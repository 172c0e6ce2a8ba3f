"""Calibration of a sensor of zones from a sweep: frames at known distances from a plane that it faces.

The counts are first freed of saturation, which gives expected events per cycle λ (equation (1) of `saturation.py`). A
plane at the distance z gives a zone

    λ(t) = floor + glass + g ∫ w(u) r(θ(u)) cos³θ(u) / (z + z₀)² · pulse(t − delay − 2 (z + z₀) / (c cosθ)) du     (2)

over its footprint w, u the tangents of the direction, θ its angle from the axis and r the plane's reflectance, and
the nominal share of what the other zones get. N and z₀ follow from brightness over distance, the rest from the shapes
of the histograms: the pulse as samples ≥ 0 of a linear least-squares problem, bin width, footprints' place, scale and
blur, and each zone's delay by Gauss–Newton around it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import scipy.optimize
from scipy.special import ndtr

from datagen.capture.device_optics import zone_boxes
from datagen.config.device import DeviceConfig
from datagen.devices.agreement import Fitted, HistogramErrors, clustered_covariance
from datagen.devices.frames import Frames, fitted_and_tested
from datagen.devices.model import Device, recorded_by
from datagen.devices.saturation import blind_periods, saturated, unsaturated
from datagen.devices.surfaces import reflectance_of
from datagen.errors import InputError, shown
from datagen.records import Lambertian, Material
from datagen.records.arrays import Floats
from datagen.records.checks import check_callable, check_flag, check_kind, check_number
from datagen.units import SPEED_OF_LIGHT_M_PER_S

NEAREST_M = 0.12
"""Distance from which frames are used, m: nearer, the parallax of light and sensor, which (2) lacks, changes them."""
FARTHEST_M = 10.0
"""Distance up to which frames are used, m: farther than such sensors see."""
SUBSTEPS = 4
"""Samples of the pulse in a bin; with two, peaks move by up to 0.05 bin."""
BEFORE, AFTER = 3, 26
"""Bins before and after the peak that the pulse may take; 13 after it would cut off a tail of 1 %."""
SMOOTH = 2e-3
"""Weight of the second differences of the pulse's samples: enough that they do not follow the noise."""
FITTED_FRAMES = 14
"""Most frames of the fit of shapes: its time grows with them, and its errors fall with their square root."""
PRIORS = {"distance": (1.0, 0.2), "size": (1.0, 0.1), "shift": (0.0, 0.05), "blur": (0.03, 0.03)}
"""Mean and standard deviation of what a plane alone fixes badly: the distance of zones from the axis and their size,
relative to the nominal ones, the shift of all zones, and their blur. The deviations say how far a real
sensor may be from its data sheet."""
PRIOR_WEIGHT = 0.02
"""Weight of a prior's standard deviation beside residuals, which are relative to a histogram's energy."""


@dataclass(frozen=True)
class Calibration(HistogramErrors):
    """What `calibrate` found.

    Attributes
    ----------
    device : the calibrated device.
    fitted : name → number with its standard error.
    tested_m : (n,) distances of the frames that the fit did not see (or of all).
    measured, modelled : (n, zones, bins) histograms of those frames, as counted and as the device gives them.
    held_out : whether the fit did not see them.
    """

    device: Device
    fitted: dict[str, Fitted]
    tested_m: Floats
    measured: Floats
    modelled: Floats
    held_out: bool

    @cached_property
    def brightness_error(self) -> Floats:
        """(n, zones) relative error of a histogram's sum."""
        return np.asarray(self.modelled.sum(axis=2) / self.measured.sum(axis=2) - 1)

    def text(self) -> str:
        """A table of the fitted numbers and of the errors on the tested frames."""
        bright, shift = np.abs(self.brightness_error), np.abs(self.peak_shift)
        lines = ["fitted:"]
        lines += [f"  {name:24} {number}" for name, number in self.fitted.items()]
        lines += [
            f"{self.tested}, {self.tested_m.min():.3g} to {self.tested_m.max():.3g} m:",
            f"  relative L2 of histograms  median {np.median(self.relative_l2):.4f}, 90th percentile "
            f"{np.percentile(self.relative_l2, 90):.4f}",
            "  by zone                    " + " ".join(f"{v:.3f}" for v in np.median(self.relative_l2, axis=0)),
            f"  brightness                 median of |error| {np.median(bright):.4f}, worst zone "
            f"{np.median(bright, axis=0).max():.4f}, largest {bright.max():.4f}",
            f"  peak                       median of |shift| {np.median(shift):.3f} bins, worst zone "
            f"{np.median(shift, axis=0).max():.3f}",
        ]
        return "\n".join(lines)


def calibrate(
    frames: Frames, device: Device, *, albedo: float = 0.8, held_out: bool = True, nearest_m: float = NEAREST_M,
    plane: Material | None = None, doing: Callable[[str], None] | None = None,
) -> Calibration:  # fmt: skip
    """A device whose numbers are those of the sensor that recorded a sweep before a plane.

    Parameters
    ----------
    frames : histograms and distances to a plane that the sensor faces squarely.
    device : what the sensor is nominally; what a plane does not tell (crosstalk, dead time, …) stays.
    albedo : of the plane, a diffuse one; the emitted light is known only relative to it.
    plane : its material, where that is known better, such as by angle (`read_materials`); `albedo` does not count
        then. Nobody can fit it to the sweep: each zone sees it at angles of its own, as if its gain were another.
    held_out : whether the second and fourth quarter of the distances are held out to test; else all are fitted, and
        tested.
    nearest_m : distance from which frames are used, metres.
    doing : called with a line of text before each step of the work, which takes seconds.

    Raises
    ------
    InputError : no distances, another number of zones or bins than the device has, or fewer than 8 usable frames.
    """
    check_kind("frames", frames, Frames, remedy="such as read_frames(path)")
    check_kind("device", device, DeviceConfig, remedy="such as dg.device('tmf8820')")
    check_flag("held_out", held_out)
    check_callable("doing", doing, "it gets a line of text")
    check_number("calibrate", "albedo", albedo, 1e-3, 1.0, "it is a share of the light")
    if plane is not None:
        check_kind("plane", plane, Material, remedy="such as dg.MeasuredByAngle(0.8, (0.5, 0.7, 0.8))")
    plane = Lambertian(albedo) if plane is None else plane
    if not (reflectance_of(plane, np.linspace(0.5, 1.0, 16)) > 0).all():
        raise InputError(f"plane = {shown(plane)}: sends no light back at some angle below 60 degrees; name another")
    check_number("calibrate", "nearest_m", nearest_m, 0.0, FARTHEST_M, "metres; 12 cm is 0.12")
    if frames.distances_m is None:
        raise InputError(f"{frames.source}: has no distances (dist_to_plane); a sweep before a plane is needed")
    frames = recorded_by(frames.source, frames, device, device.zones.count)
    if device.zones.weights:
        raise InputError(
            f"{device.name}: zones.weights or zones.map: a measured map is not fitted; name a device without"
        )
    z = frames.distances_m
    assert z is not None
    usable = np.flatnonzero((z >= nearest_m) & (z <= FARTHEST_M))
    usable = usable[np.argsort(z[usable], kind="stable")]
    if (z > FARTHEST_M).all():
        raise InputError(
            f"{frames.source}: all distances (dist_to_plane) are over {FARTHEST_M:g} m; give them in metres"
        )
    if len(usable) < 8:
        raise InputError(f"{frames.source}: {len(usable)} frames from {nearest_m:g} m on; at least 8 are needed")
    doing = doing or (lambda what: None)
    fitted, tested = (usable[rows] for rows in fitted_and_tested(len(usable))) if held_out else (usable, usable)
    fit = _Fit.of(frames.histograms[fitted], z[fitted], device, plane, doing)
    calibrated, numbers = fit.device()
    return Calibration(
        calibrated, numbers, z[tested], frames.histograms[tested], fit.histograms(z[tested]), held_out
    )  # fmt: skip


@dataclass(frozen=True)
class _Fit:
    """The fit of a sweep.

    nominal : the device before calibration. cycles, offset_m : N and z₀ of equations (1) and (2), and
    `brightness_errors` their standard errors. brightness : (zones,) events per cycle of the plane's light, times (z +
    z₀)². floor, glass : (zones,) and (zones,
    bins) events per cycle. shape : the parameters of the shapes (`_Shape`); covariance : theirs. pulse : (samples,).
    """

    nominal: Device
    cycles: float
    offset_m: float
    brightness_errors: tuple[float, float]
    brightness: Floats
    floor: Floats
    glass: Floats
    shape: _Shape
    covariance: Floats
    pulse: Floats

    @classmethod
    def of(cls, counts: Floats, z: Floats, nominal: Device, plane: Material, doing: Callable[[str], None]) -> _Fit:
        """The fit of counts (n, zones, bins) at distances z (n,)."""
        blind = blind_periods(nominal)
        start = _Shape.of(nominal, plane)
        first = int(min(start.zero_bins.min(), nominal.time.zero_bin)) - BEFORE
        doing("cycles and distance offset are fitted to the brightness over distance")
        cycles, offset = _brightness(counts, z, blind, first)
        rng = np.random.default_rng(0)
        resampled = [rng.integers(len(z), size=len(z)) for _ in range(20)]
        spread = np.std([_brightness(counts[rows], z[rows], blind, first) for rows in resampled], axis=0)
        events = unsaturated(counts, cycles, blind)
        floor = events[:, :, 1 : max(first, 2)].mean(axis=(0, 2))
        light = events - floor[:, None]
        # Far from the glass's bins the plane's own light is later, so what is there in far frames is the glass's.
        glass = np.zeros(light.shape[1:])
        early = slice(max(first, 0), int(start.zero_bins.max()) + BEFORE + 2)
        far = z > z.max() * 0.75
        glass[:, early] = np.maximum(light[far][:, :, early].mean(axis=0), 0.0)
        light = light - glass
        brightness = np.median(light.sum(axis=2) * (z[:, None] + offset) ** 2, axis=0)
        start = replace(start, sharing=_sharing(brightness, nominal.zones.crosstalk))
        rows = np.unique(np.linspace(0, len(z) - 1, FITTED_FRAMES).round().astype(int))
        problem = _ShapeProblem(light[rows], z[rows] + offset, start, doing)
        shape, covariance, pulse = problem.best_shape()
        errors = float(spread[0]), float(spread[1])
        return cls(nominal, cycles, offset, errors, brightness, floor, glass, shape, covariance, pulse)

    def histograms(self, z: Floats) -> Floats:
        """(n, zones, bins) expected counts before a plane at distances z (n,), by equations (1) and (2)."""
        bins = self.glass.shape[1]
        light = np.zeros((len(z), *self.glass.shape))
        for n, metres in enumerate(z + self.offset_m):
            for k, bright in enumerate(self.brightness):
                arrivals = self.shape.arrivals(k, metres, bins)
                whole = np.convolve(arrivals, self.pulse)[BEFORE * SUBSTEPS :][: bins * SUBSTEPS]
                light[n, k] = bright / metres**2 * whole.reshape(bins, SUBSTEPS).sum(axis=1)
        events = light + self.glass + self.floor[:, None]
        return saturated(events, self.cycles, blind_periods(self.nominal))

    def device(self) -> tuple[Device, dict[str, Fitted]]:
        """The nominal device with the fitted numbers, and these with their errors."""
        nominal, shape = self.nominal, self.shape
        width_ps = 2e12 / (SPEED_OF_LIGHT_M_PER_S * shape.bins_per_m)
        zero = float(shape.zero_bins.mean())
        errors = np.sqrt(np.maximum(np.diag(self.covariance), 0.0))
        source = "calibrated from a sweep before a plane"
        radius = nominal.zones.aperture_radius_mm * 1e-3
        # A beam sends the share fading du / field into du, so that g, the factor before ∫ w r fading cos³θ du / z² in
        # (2), is photons · pde / π · A / field.
        field = _lit_area(nominal)
        own = np.diag(shape.sharing) * self.brightness
        gains = own / shape.energies()
        top = float(gains.max())
        photons = top * field / (nominal.counting.pde * radius**2)
        glass = self.glass.sum(axis=1) / (nominal.counting.pde * photons)
        start_ps = -BEFORE * width_ps
        zones = nominal.zones.model_copy(update={
            "boxes": tuple(_rounded(box, 4) for box in shape.boxes), "field_deg": None,
            "blur": round(shape.blur, 5), "gains": _rounded(gains / top), "glass": _rounded(glass),
            "delays_ps": _rounded((shape.zero_bins - zero) * width_ps, 4),
            "dark_count_factors": _rounded(self.floor / self.floor.mean(), 4) if self.floor.any() else (),
        })  # fmt: skip
        counting = nominal.counting.model_copy(update={
            "cycles": round(self.cycles), "photons_per_pulse": float(f"{photons:.5g}"), "ambient_rate_hz": 0.0,
            "dark_count_rate_hz": float(f"{self.floor.mean() / (width_ps * 1e-12):.5g}"), "jitter_fwhm_ps": 0.0,
            "gate_ns": "histogram", "jitter_tail_ps": 0.0, "jitter_tail_fraction": 0.0,
        })  # fmt: skip
        time = nominal.time.model_copy(update={"bin_width_ps": round(width_ps, 4), "zero_bin": round(zero, 4)})
        pulse = nominal.pulse.model_copy(update={
            "fwhm_ps": None, "samples": _rounded(self.pulse / self.pulse.max(), 4),
            "sample_ps": round(width_ps / SUBSTEPS, 5), "start_ps": round(start_ps, 3),
        })  # fmt: skip
        of_zones = [f"zones.{key}" for key in ("boxes", "blur", "gains", "glass", "delays_ps", "dark_count_factors")]
        of_time = ["time.bin_width_ps", "time.zero_bin", "pulse"]
        of_counting = ["counting.cycles", "counting.dark_count_rate_hz"]
        sources = nominal.sources | dict.fromkeys([*of_zones, *of_time, *of_counting], source)
        sources["counting.photons_per_pulse"] = (
            f"{source}, for its {_plane_text(shape.plane)} and the aperture and PDE stated"
        )
        device = nominal.model_copy(update={
            "zones": zones, "counting": counting, "time": time, "pulse": pulse, "sources": sources,
        })  # fmt: skip
        numbers = {
            "bin width, ps": Fitted(width_ps, width_ps * errors[0] / shape.bins_per_m),
            "zero bin": Fitted(zero, float(errors[-len(gains) :].mean())),
            "cycles N": Fitted(self.cycles, self.brightness_errors[0]),
            "distance offset, mm": Fitted(1e3 * self.offset_m, 1e3 * self.brightness_errors[1]),
            "footprints' size": Fitted(shape.size, errors[1]),
            "shift to the right": Fitted(shape.shift[0], errors[2]),
            "shift up": Fitted(shape.shift[1], errors[3]),
            "footprints' blur": Fitted(shape.blur, errors[4]),
        }
        return device, numbers


def _lit_area(device: Device) -> float:
    """∫ fading du over the lit field, tangents²; fading is 1 on the axis."""
    light = device.light
    right, up = (2 * np.tan(np.radians(side) / 2) for side in light.field_deg)
    if light.spread is None:
        return float(right * up)
    across, along = (
        ((np.arange(count) + 0.5) / count - 0.5) * side for count, side in ((light.columns, right), (light.rows, up))
    )
    fading = np.exp(-0.5 * (across**2 + along[:, None] ** 2) / light.spread**2)
    return float(right * up * fading.mean())


def _plane_text(plane: Material) -> str:
    """What the light is relative to, in words."""
    return f"albedo {plane.albedo:g}" if isinstance(plane, Lambertian) else f"material {plane}"


def _rounded(values: Floats, digits: int = 5) -> tuple[float, ...]:
    """The values with so many significant digits, as a device file writes them."""
    return tuple(float(f"{value:.{digits}g}") for value in values)


def _brightness(counts: Floats, z: Floats, blind: float, first: int) -> tuple[float, float]:
    """Cycles N and distance offset z₀ with which each zone's events fall as (z + z₀)^−2 best, z₀ alike for all zones.

    first : bins before it hold the floor alone.
    """
    least = float((counts.sum(axis=2) * (1 + blind)).max()) * 1.05

    def misfit(parameters: Floats) -> float:
        cycles, offset = least * (1 + np.exp(parameters[0])), parameters[1]
        events = unsaturated(counts, cycles, blind)
        sums = (events - events[:, :, 1 : max(first, 2)].mean(axis=2, keepdims=True)).sum(axis=2)
        if not (sums > 0).all():
            return 1e9
        law = np.log(sums) + 2 * np.log(z + offset)[:, None]
        return float(np.var(law, axis=0).sum())

    bounds = [(-6.0, 6.0), (-0.3 * z.min(), 0.3 * z.min())]
    grid = [(a, b) for a in np.linspace(-3, 4, 8) for b in (-0.005, 0.0, 0.005)]
    begin = min(grid, key=lambda at: misfit(np.array(at)))
    found = scipy.optimize.minimize(
        misfit, np.array(begin), method="Nelder-Mead", bounds=bounds, options={"xatol": 1e-5, "fatol": 1e-10}
    )
    return least * (1 + float(np.exp(found.x[0]))), float(found.x[1])


RAYS_ALONG = 64
"""Directions along each side of the field, of which footprints are sums; with 32, footprints err by 1 %."""
SLANTS = 120
"""Slants 1/cosθ that arrivals are sorted by; with 60, arrivals are known to a tenth of a bin at 1 m."""


def _sharing(brightness: Floats, crosstalk: float) -> Floats:
    """(zones, zones) share of each zone's light that comes through the footprint of each zone, with crosstalk.

    With the share c of the light of all others, brightness B = (1 − c) b + c Σ b; this is solved for the light b
    through each footprint.
    """
    zones = len(brightness)
    mixing = (1 - crosstalk) * np.eye(zones) + crosstalk
    through = np.maximum(np.linalg.solve(mixing, brightness), 0.0)
    light = mixing * through
    return np.asarray(light / light.sum(axis=1, keepdims=True))


@dataclass(frozen=True)
class _Shape:
    """What gives a plane's histograms their shape, but for the pulse.

    nominal : (zones, 4) nominal boxes, tangents. bins_per_m : bins that a plane moves by for each metre. size : of
    the boxes relative to the nominal ones. shift : of all boxes, to the right and up, tangents. blur : tangents.
    distance : (zones,) of each box's middle from the axis, relative to the nominal one. zero_bins : (zones,)
    fractional bin of distance 0. sharing : (zones, zones) share of each zone's light that comes through the footprint
    of each zone. plane : its material. spread : standard deviation of the beam that fades towards its edges,
    tangents; infinite: even.
    """

    nominal: Floats
    sharing: Floats
    bins_per_m: float
    size: float
    shift: tuple[float, float]
    blur: float
    distance: Floats
    zero_bins: Floats
    plane: Material
    spread: float = np.inf

    @classmethod
    def of(cls, device: Device, plane: Material) -> _Shape:
        """That of a device as it stands."""
        width = device.time.bin_width_ps
        delays = np.array(device.zones.delays_ps or [0.0] * device.zones.count) / width
        per_m = 2e12 / (SPEED_OF_LIGHT_M_PER_S * width)
        zones = device.zones.count
        blur = device.zones.blur or PRIORS["blur"][0]
        return cls(zone_boxes(device.zones), np.eye(zones), per_m, 1.0, (0.0, 0.0), blur, np.ones(zones),
                   device.time.zero_bin + delays, plane, device.light.spread or np.inf)  # fmt: skip

    @property
    def parameters(self) -> Floats:
        """(5 + 2 zones,) the numbers that are fitted."""
        return np.array([self.bins_per_m, self.size, *self.shift, self.blur, *self.distance, *self.zero_bins])

    def moved(self, parameters: Floats) -> _Shape:
        """The shape with other numbers."""
        per_m, size, right, up, blur = (float(value) for value in parameters[:5])
        distance, zero = np.split(parameters[5:], 2)
        return replace(
            self, bins_per_m=per_m, size=size, shift=(right, up), blur=max(blur, 1e-3), distance=distance,
            zero_bins=zero,
        )  # fmt: skip

    @cached_property
    def boxes(self) -> Floats:
        """(zones, 4) the box of each zone, tangents."""
        x, y, w, h = self.nominal.T
        placed = x * self.distance + self.shift[0], y * self.distance + self.shift[1]
        return np.stack([*placed, w * self.size, h * self.size], axis=1)

    @cached_property
    def _slants(self) -> tuple[Floats, Floats]:
        """(SLANTS,) slants 1/cosθ, and (zones, SLANTS) the energy ∫ w r cos³θ du of each zone at them."""
        x, y, w, h = self.boxes.T[:, :, None]
        reach = 1.2 * float((np.abs(np.stack([x, y])) + np.stack([w, h]) / 2).max() + 3 * self.blur)
        tangents = ((np.arange(RAYS_ALONG) + 0.5) / RAYS_ALONG * 2 - 1) * reach
        across = ndtr((tangents - x + w / 2) / self.blur) - ndtr((tangents - x - w / 2) / self.blur)
        upward = ndtr((tangents - y + h / 2) / self.blur) - ndtr((tangents - y - h / 2) / self.blur)
        slant = np.sqrt(1 + tangents[:, None] ** 2 + tangents**2)
        faded = np.exp(-0.5 * (slant**2 - 1) / self.spread**2) * reflectance_of(self.plane, 1 / slant)
        weights = across[:, None, :] * upward[:, :, None] * faded / slant**3 * (2 * reach / RAYS_ALONG) ** 2
        edges = np.linspace(1.0, slant.max() * (1 + 1e-9), SLANTS + 1)
        number = np.searchsorted(edges, slant.ravel(), side="right") - 1
        energy = np.stack([np.bincount(number, zone.ravel(), SLANTS) for zone in weights])
        return (edges[1:] + edges[:-1]) / 2, energy.astype(np.float64)

    def energies(self) -> Floats:
        """(zones,) ∫ w r cos³θ du."""
        return np.asarray(self._slants[1].sum(axis=1))

    def arrivals(self, zone: int, metres: float, bins: int) -> Floats:
        """(bins · SUBSTEPS,) arrival times of a plane's light in a zone, of sum 1; before the pulse."""
        slants, energy = self._slants
        place = (self.zero_bins[zone] + self.bins_per_m * metres * slants) * SUBSTEPS
        whole = np.floor(place).astype(np.int64)
        share = self.sharing[zone] @ (energy / energy.sum(axis=1, keepdims=True))
        inside = (whole >= 0) & (whole < bins * SUBSTEPS - 1)
        whole, later, share = whole[inside], (place - whole)[inside], share[inside]
        size = bins * SUBSTEPS
        return np.asarray(np.bincount(whole, share * (1 - later), size) + np.bincount(whole + 1, share * later, size))


@dataclass(frozen=True)
class _ShapeProblem:
    """The least-squares problem of the shapes. light : (n, zones, bins) events per cycle without floor and glass; z :
    (n,) metres; start : where the fit begins."""

    light: Floats
    z: Floats
    start: _Shape
    doing: Callable[[str], None]

    def best_shape(self) -> tuple[_Shape, Floats, Floats]:
        """The fitted shape, its parameters' covariance (by clusters), and the pulse (samples,), of sum 1."""
        begin = self.start.parameters
        scale = np.array([1.0, 0.1, 0.02, 0.02, 0.01, *np.full(len(begin) - 5, 0.1)])
        found = scipy.optimize.least_squares(
            lambda p: self.residuals(self.start.moved(p))[0], begin, x_scale=scale, max_nfev=15, diff_step=1e-4
        )
        shape = self.start.moved(found.x)
        data = len(found.fun) - len(self.priors(shape))
        covariance = clustered_covariance(found.jac, found.fun[:data], len(self.z))
        return shape, covariance, self.residuals(shape)[1]

    def residuals(self, shape: _Shape) -> tuple[Floats, Floats]:
        """Residuals of all histograms with the best pulse, each relative to its energy, then those of the priors; and
        that pulse."""
        designs, targets = [], []
        bins, taps = self.light.shape[2], (BEFORE + AFTER) * SUBSTEPS
        rows = np.arange(BEFORE + AFTER)
        for n, metres in enumerate(self.z):
            for k in range(self.light.shape[1]):
                running = np.concatenate([[0.0], np.cumsum(shape.arrivals(k, metres, bins))])
                first = int(shape.zero_bins[k] + shape.bins_per_m * metres) - BEFORE
                places = np.clip(rows + first, 0, bins - 1)
                # Arrivals that a pulse sample, `taps` of them, carries into a bin.
                since = places[:, None] * SUBSTEPS - (np.arange(taps) - BEFORE * SUBSTEPS)
                size = len(running) - 1
                designs.append(running[np.clip(since + SUBSTEPS, 0, size)] - running[np.clip(since, 0, size)])
                there = (rows + first < bins)[:, None]
                designs[-1] = designs[-1] * there
                mine = self.light[n, k]
                targets.append(mine[places] * there[:, 0] / mine[max(first, 0) :].sum())
        design, target = np.stack(designs), np.stack(targets)
        normal = np.einsum("hbi,hbj->ij", design, design)
        bend = np.diff(np.eye(taps), 2, axis=0)
        normal += SMOOTH * len(design) * bend.T @ bend + 1e-9 * np.trace(normal) / taps * np.eye(taps)
        root = np.linalg.cholesky(normal)
        pulse = scipy.optimize.nnls(root.T, np.linalg.solve(root, np.einsum("hbi,hb->i", design, target)))[0]
        misfit = (np.einsum("hbi,i->hb", design, pulse) - target).ravel()
        return np.concatenate([misfit, PRIOR_WEIGHT * self.priors(shape)]), pulse / pulse.sum()

    def priors(self, shape: _Shape) -> Floats:
        """(3 + zones + 1,) deviations from the priors, in their standard deviations."""
        return np.concatenate([
            (np.atleast_1d(getattr(shape, name)) - mean) / deviation for name, (mean, deviation) in PRIORS.items()
        ])  # fmt: skip
