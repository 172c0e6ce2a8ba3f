"""The exposure for which a configuration asks: the number of cycles with which its objects have enough evidence.

After N cycles b_i = N D_i detections are expected in bin i, and s_i = N (D_i/λ_i) λᵒ_i of an object's light. The
object's significance

    σ² = Σ s_i²/b_i = N Σ (s_i²/b_i of one cycle),   over bins with N D_i < the counter's maximum,

is known for every N from one cycle, since dead time and pile-up do not depend on N. The result is the least N with
which at most the share `quantile` of the objects of pilot scenes has less evidence than requested, rounded up to two
digits; the evidence is then checked for that N. The pilot scenes are the same for any number of scenes.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from datagen.capture import capture_for
from datagen.config import DatasetConfig
from datagen.config.detector import ExposureFor
from datagen.config.scene_layouts import NoLayout
from datagen.design.light import coarse_transient
from datagen.design.scene_for import without_floors
from datagen.detector import Exposure, Spad, detector_for
from datagen.detector.own_light import own_light, squared_over
from datagen.errors import InputError
from datagen.records import Scene, Transient
from datagen.records.arrays import Floats
from datagen.scene import generate_scene

OBJECTS = 48
"""Number of objects at which pilot scenes are enough: the median significance is then known to about a fifth. With
half as many, to about a quarter."""
PILOTS = 64
"""Most pilot scenes. With half as many, sparse scenes give fewer objects."""


@dataclass(frozen=True)
class _Pilot:
    """The objects of a pilot scene under its detector, in one cycle.

    counter_max : of the detector. rate_hz : laser pulses per second.
    counts : (n,) expected counts of the n bins of all histograms, in descending order.
    squares : object → (n,) Σ s²/b of each of these bins and all fainter ones.

    If no counter can saturate, n is 1: one entry, for all bins together.
    """

    counter_max: int | None
    rate_hz: float
    counts: Floats
    squares: dict[str, Floats]

    @cached_property
    def full(self) -> Floats:
        """(n,) the number of cycles after which each bin is full."""
        maximum = math.inf if self.counter_max is None else float(self.counter_max)
        most = np.full(len(self.counts), math.inf)
        np.divide(maximum, self.counts, out=most, where=self.counts > 0)
        return most

    def significance(self, name: str, cycles: float) -> float:
        """The significance of an object's light after `cycles` cycles."""
        first = 0 if self.counter_max is None else int(np.searchsorted(self.full, cycles, side="right"))
        squares = self.squares[name]
        return math.sqrt(cycles * float(squares[first])) if first < len(squares) else 0.0

    def cycles_for(self, name: str, evidence: float) -> float:
        """The least number of cycles that gives an object the significance `evidence`; infinite if none does."""
        squares = self.squares[name]
        if self.counter_max is None:
            return evidence**2 / float(squares[0]) if squares[0] > 0 else math.inf
        # Until the next bin is full, σ² is proportional to the number of cycles.
        least = np.divide(evidence**2, squares, out=np.full(len(squares), math.inf), where=squares > 0)
        reached = np.maximum(least, np.concatenate([[0.0], self.full[:-1]]))
        return float(reached[reached < self.full].min(initial=math.inf))


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
    request = config.detector.exposure_for
    if request is None:
        return config
    if isinstance(config.scene.layout, NoLayout):
        raise InputError("detector.exposure_for: only for scenes that are drawn; set cycles for those that are given")
    pilots = list(_pilots(config, request))
    needed = sorted(pilot.cycles_for(name, request.evidence) for pilot in pilots for name in pilot.squares)
    if not needed:
        raise _refused(request, f"none of the first {PILOTS} scenes has an object; add some to scene.contents")
    enough = math.ceil((1 - request.quantile) * len(needed) - 1e-9)
    longest = min(request.longest_s * pilot.rate_hz for pilot in pilots)
    if needed[enough - 1] > longest:
        raise _refused(request, _why_not(pilots, needed[enough - 1], enough))
    cycles = min(_rounded_up(needed[enough - 1]), max(math.floor(longest), 1))
    _check_counts(config, request, pilots, cycles, enough)
    exposure = {"exposure_for": None, "found_for": request, "cycles": float(cycles)}
    return config.model_copy(update={"detector": config.detector.model_copy(update=exposure)})


def _pilots(config: DatasetConfig, request: ExposureFor) -> Iterator[_Pilot]:
    """Pilot scenes that hold objects, until there are `OBJECTS` of these."""
    free = without_floors(config)
    one_cycle = {"exposure_for": None, "cycles": 1.0}
    free = free.model_copy(update={"detector": config.detector.model_copy(update=one_cycle)})
    objects = 0
    for index in range(PILOTS):
        scene = generate_scene(free.scene, free.seed, index)
        if not scene.objects:
            continue
        capture = capture_for(free, scene, free.seed, index)
        spad, exposure = detector_for(free.detector, free.seed, index, capture.time)
        longest = replace(exposure, cycles=max(round(request.longest_s * exposure.repetition_rate_hz), 1))
        transient = coarse_transient(free, index, scene, capture, spad, longest)
        yield _Pilot(spad.counter_max, exposure.repetition_rate_hz, *_of_one_cycle(transient, scene, spad, exposure))
        objects += len(scene.objects)
        if objects >= OBJECTS:
            return


def _of_one_cycle(
    transient: Transient, scene: Scene, spad: Spad, exposure: Exposure
) -> tuple[Floats, dict[str, Floats]]:
    """The `counts` and `squares` of a `_Pilot`, from its transient under an exposure of one cycle."""
    counts, squares = list[Floats](), [list[Floats]() for _ in scene.objects]
    parts, unbounded = [transient.parts[name] for name in scene.objects], replace(spad, counter_max=None)
    for block in own_light(transient.total, parts, transient.time, unbounded, exposure):
        everything = block.everything.reshape(-1)
        counts.append(everything)
        for own, blocks in zip(block.own, squares, strict=True):
            blocks.append(squared_over(own.reshape(-1), everything))
    every = np.concatenate(counts)
    order = np.argsort(-every, kind="stable")
    sums = [np.concatenate(blocks)[order][::-1].cumsum()[::-1] for blocks in squares]
    kept = slice(1) if spad.counter_max is None else slice(None)
    return every[order][kept], {name: one[kept].copy() for name, one in zip(scene.objects, sums, strict=True)}


def _rounded_up(cycles: float) -> int:
    """Cycles rounded up to two significant digits, which hides last bits that differ between processors."""
    unit = int(10 ** max(math.floor(math.log10(max(cycles, 1.0))) - 1, 0))
    return max(math.ceil(cycles / unit - 1e-6) * unit, 1)


def _check_counts(
    config: DatasetConfig, request: ExposureFor, pilots: list[_Pilot], cycles: int, enough: int
) -> None:
    """Raise `InputError` unless enough objects have their evidence after `cycles` cycles and counts can be stored."""
    least = request.evidence * (1 - 1e-6)
    met = sum(pilot.significance(name, cycles) >= least for pilot in pilots for name in pilot.squares)
    if met < enough:
        raise _refused(request, f"{_FULL_BEFORE}; raise counter_max, or lower photons_per_pulse")
    maximum, dtype = config.detector.counter_max or math.inf, config.store.histogram_dtype
    fullest = min(max(float(pilot.counts[0]) for pilot in pilots) * cycles, maximum)
    if fullest + 6 * math.sqrt(fullest) > np.iinfo(dtype).max and maximum > np.iinfo(dtype).max:
        why = f"{cycles:g} cycles would do, but bring {fullest:.2g} counts into a bin, more than {dtype} holds"
        raise _refused(request, f"{why}; set a wider store.histogram_dtype, or detector.counter_max")


_FULL_BEFORE = "counters are full before enough of the objects have as much"


def _why_not(pilots: list[_Pilot], needed: float, enough: int) -> str:
    """Why no exposure that is short enough gives `enough` objects their evidence, and the remedy."""
    lit = [pilot.squares[name][0] > 0 for pilot in pilots for name in pilot.squares]
    if sum(lit) < enough:
        dark = f"of {len(lit) - sum(lit)} of {len(lit)} objects in pilot scenes no light is detected"
        return f"{dark}; raise photons_per_pulse or quantile, or move the gate"
    if math.isinf(needed):
        return f"{_FULL_BEFORE}; raise counter_max or quantile"
    slowest = min(pilot.rate_hz for pilot in pilots)
    return f"{needed / slowest:.2g} s would be needed; raise longest_s or photons_per_pulse, or lower evidence"


def _refused(request: ExposureFor, why: str) -> InputError:
    """The error that names the request and the reason."""
    given = ", ".join(f"{name}: {value:g}" for name, value in request.model_dump().items())
    return InputError(f"detector.exposure_for = {{{given}}}: {why}")
