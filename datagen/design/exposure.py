"""The exposure for which a configuration asks: the number of cycles with which its objects have enough evidence.

The light of pilot scenes is simulated once, coarsely. After N cycles b_i = N D_i detections are expected in bin i, of
which s_i = N (D_i/λ_i) λᵒ_i are an object's light. The object's significance

    σ² = Σ s_i²/b_i = N Σ (s_i²/b_i of one cycle),   over bins with N D_i < the counter's maximum,

is known for every N from one cycle, since dead time and pile-up do not depend on N. It grows with √N, and more slowly
once counters are full.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from datagen.capture import capture_for
from datagen.config import DatasetConfig
from datagen.config.detector import ExposureFor
from datagen.config.scene_layouts import NoLayout
from datagen.design.light import coarse_transient
from datagen.design.scene_for import without_floors
from datagen.detector import detector_for
from datagen.detector.own_light import own_light, squared_over
from datagen.detector.spad import MAX_CYCLES
from datagen.errors import InputError
from datagen.records.arrays import Floats
from datagen.records.checks import check_kind
from datagen.scene import generate_scene

OBJECTS = 48
"""Number of objects at which pilot scenes are enough: the median significance is then known to about a fifth."""
PILOTS = 64
"""Most pilot scenes, of which sparse ones may hold few objects."""


@dataclass(frozen=True)
class _Pilot:
    """The objects of a pilot scene under its detector, in one cycle.

    counter_max : of the detector; infinite without counters. rate_hz : laser pulses per second.
    brightest : expected counts of the brightest bin.
    counts : (n,) expected counts of the n bins of all histograms; squares : (object, n) s²/b of each of these bins.
        If no counter can be full, n is 1: one entry, for all bins together.
    """

    counter_max: float
    rate_hz: float
    brightest: float
    counts: Floats
    squares: Floats

    def significances(self, cycles: float) -> Floats:
        """(object,) the significance of each object after `cycles` cycles."""
        not_full = cycles * self.counts < self.counter_max
        return np.asarray(np.sqrt(cycles * self.squares[:, not_full].sum(axis=1)))


def with_exposure_found(config: DatasetConfig) -> DatasetConfig:
    """The configuration with a number of cycles in place of `detector.exposure_for`; without that key, unchanged.

    It is the smallest number of cycles with which at most the share `quantile` of the objects of pilot scenes, whose
    light is simulated coarsely, has less significance than `evidence`. It does not depend on the number of scenes.

    Raises
    ------
    InputError : no exposure up to `longest_s` is enough (the message says why); scenes that are given, not drawn.

    >>> import datagen as dg
    >>> from datagen.config import config_from_mapping
    >>> config = config_from_mapping({
    ...     "scene": {"contents": [{"kind": "box"}]}, "transport": {"target": 0.3},
    ...     "capture": {"scan": {"rows": 2, "columns": 2}, "time": {"bins": 64, "bin_width_ps": 800}},
    ...     "detector": {"exposure_for": {"evidence": 5}, "photons_per_pulse": 1e9}})
    >>> found = dg.with_exposure_found(config).detector
    >>> found.cycles > 1, found.exposure_for
    (True, None)
    """
    check_kind("config", config, DatasetConfig, remedy="such as load_config(path)")
    request = config.detector.exposure_for
    if request is None:
        return config
    if isinstance(config.scene.layout, NoLayout):
        raise InputError("detector.exposure_for: only for scenes that are drawn; set cycles for those that are given")
    pilots = list(_pilots(config, request))
    if not pilots:
        raise _refused(request, f"none of the first {PILOTS} scenes has an object; add some to scene.contents")
    cycles = _enough_cycles(request, pilots)
    dtype, counter_max = config.store.histogram_dtype, config.detector.counter_max or math.inf
    fullest, largest = min(max(pilot.brightest for pilot in pilots) * cycles, counter_max), np.iinfo(dtype).max
    if fullest + 6 * math.sqrt(fullest) > largest and counter_max > largest:
        why = f"{cycles:g} cycles would do, but bring {fullest:.2g} counts into a bin, more than {dtype} holds"
        raise _refused(request, f"{why}; set a wider store.histogram_dtype, or detector.counter_max")
    exposure = {"exposure_for": None, "found_for": request, "cycles": float(cycles)}
    return config.model_copy(update={"detector": config.detector.model_copy(update=exposure)})


def _pilots(config: DatasetConfig, request: ExposureFor) -> Iterator[_Pilot]:
    """Pilot scenes that hold objects, until there are `OBJECTS` of these; the same for any number of scenes."""
    one_cycle = config.detector.model_copy(update={"exposure_for": None, "cycles": 1.0})
    free = without_floors(config).model_copy(update={"detector": one_cycle})
    objects = 0
    for index in range(PILOTS):
        scene = generate_scene(free.scene, free.seed, index, clock=free.clock)
        if not scene.objects:
            continue
        capture = capture_for(free, scene, free.seed, index)
        spad, exposure = detector_for(free.detector, free.seed, index, capture.time)
        longest = replace(exposure, cycles=_most_cycles(request, exposure.repetition_rate_hz))
        transient = coarse_transient(free, index, scene, capture, spad, longest)
        parts, unbounded = [transient.parts[name] for name in scene.objects], replace(spad, counter_max=None)
        blocks = [*own_light(transient.total, parts, transient.time, unbounded, exposure)]
        counts = np.concatenate([block.everything.reshape(-1) for block in blocks])
        squares = [[squared_over(own, block.everything).reshape(-1) for own in block.own] for block in blocks]
        each = np.concatenate([np.stack(of) for of in squares], axis=1)
        brightest, counter_max = float(counts.max()), spad.counter_max
        if counter_max is None:
            counts, each = np.zeros(1), each.sum(axis=1, keepdims=True)
        yield _Pilot(counter_max or math.inf, exposure.repetition_rate_hz, brightest, counts, each)
        objects += len(scene.objects)
        if objects >= OBJECTS:
            return


def _enough_cycles(request: ExposureFor, pilots: list[_Pilot]) -> int:
    """The least number of cycles, rounded up to two digits, with which at most the share `quantile` of the objects
    has less significance than requested. Raises `InputError` if none up to `longest_s` is enough."""

    def significances(cycles: float) -> Floats:
        return np.sort(np.concatenate([pilot.significances(cycles) for pilot in pilots]))

    first = significances(1.0)
    # The object that must have enough: all that are brighter have more.
    weakest = len(first) - math.ceil((1 - request.quantile) * len(first) - 1e-9)
    if first[weakest] == 0:
        dark = f"of {np.count_nonzero(first == 0)} of {len(first)} objects in pilot scenes no light is detected"
        raise _refused(request, f"{dark}; raise photons_per_pulse or quantile, or move the gate")
    rate_hz, cycles, sigma = min(pilot.rate_hz for pilot in pilots), 1.0, first[weakest]
    longest = _most_cycles(request, rate_hz)
    while sigma < request.evidence * (1 - 1e-6):
        if sigma == 0:
            full = "counters are full before enough of the objects have as much"
            raise _refused(request, f"{full}; raise counter_max or quantile, or lower photons_per_pulse")
        # σ grows with √N at most, so no fewer cycles are enough. A hundredth more at least, or the last steps would
        # be as many as there are bins whose counters get full.
        needed = cycles * max(float(request.evidence / sigma) ** 2, 1.01)
        if needed > longest:
            remedy = "raise longest_s or photons_per_pulse, or lower evidence"
            if longest == MAX_CYCLES:
                remedy = f"no exposure has more than {MAX_CYCLES:g} cycles; raise photons_per_pulse or lower evidence"
            raise _refused(request, f"{needed / rate_hz:.2g} s would be needed; {remedy}")
        cycles = min(_rounded_up(needed), longest)
        sigma = significances(cycles)[weakest]
    return round(cycles)


def _most_cycles(request: ExposureFor, rate_hz: float) -> int:
    """Cycles of the longest exposure that may be chosen."""
    return max(min(math.floor(request.longest_s * rate_hz), MAX_CYCLES), 1)


def _rounded_up(cycles: float) -> int:
    """Cycles rounded up to two significant digits: more are not known."""
    unit = int(10 ** max(math.floor(math.log10(max(cycles, 1.0))) - 1, 0))
    return max(math.ceil(cycles / unit - 1e-6) * unit, 1)


def _refused(request: ExposureFor, why: str) -> InputError:
    """The error that names the request and the reason."""
    given = ", ".join(f"{name}: {value:g}" for name, value in request.model_dump().items())
    return InputError(f"detector.exposure_for = {{{given}}}: {why}")
