"""The exposure for which a configuration asks: the number of cycles with which its objects have enough evidence.

The light of pilot scenes is simulated once, coarsely. After N cycles b_i = N D_i detections are expected in bin i, of
which s_i = N (D_i/λ_i) λᵒ_i are an object's light. The object's significance

    σ² = Σ s_i²/b_i = N Σ (s_i²/b_i of one cycle),   over bins with N D_i < the counter's maximum,

is known for every N from one cycle, since dead time and pile-up do not depend on N. It grows with √N, and more slowly
once counters are full. So does the significance of a change from one frame to the next (`datagen.evidence.change`).
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import islice

import numpy as np

from datagen.capture import capture_for, sensor_way
from datagen.config import DatasetConfig
from datagen.config.detector import ExposureFor
from datagen.config.scene_layouts import NoLayout
from datagen.design.light import coarse_transient, light_of, transport_effects
from datagen.design.scene_for import without_floors
from datagen.detector import Exposure, Spad, detector_for
from datagen.detector.own_light import own_light, squares_over
from datagen.detector.spad import MAX_CYCLES
from datagen.errors import InputError
from datagen.evidence.change import change_squares
from datagen.records import Capture, Scene
from datagen.records.arrays import Floats
from datagen.records.checks import check_kind
from datagen.scene import generate_scene
from datagen.transport.sequences import times_of

OBJECTS = 48
"""Number of objects at which pilot scenes are enough: the median significance is then known to about a fifth."""
PILOTS = 64
"""Most pilot scenes, of which sparse ones may hold few objects."""


@dataclass(frozen=True)
class _Pilot:
    """The objects of a pilot scene under its detector, in one cycle.

    counter_max : of the detector; infinite without counters. rate_hz : laser pulses per second.
    longest_s : longest exposure that fits into a frame; infinite of a scene that is measured once.
    brightest : expected counts of the brightest bin.
    counts : (frame, n) expected counts of the n bins of all histograms; squares : (object, frame, n) s²/b of each of
        these bins, or of a change from the frame before. If no counter can be full, n is 1: one entry, for all bins
        together. A scene that is measured once is one frame.
    """

    counter_max: float
    rate_hz: float
    longest_s: float
    brightest: float
    counts: Floats
    squares: Floats

    def significances(self, cycles: float) -> Floats:
        """(object,) the significance of each object after `cycles` cycles, in the median of the frames."""
        not_full = cycles * self.counts < self.counter_max
        sums = [self.squares[:, frame, of].sum(axis=1) for frame, of in enumerate(not_full)]
        return np.asarray(np.median(np.sqrt(cycles * np.array(sums)), axis=0))


def with_exposure_found(config: DatasetConfig) -> DatasetConfig:
    """The configuration with a number of cycles in place of `detector.exposure_for`; without that key, unchanged.

    It is the smallest number of cycles with which at most the share `quantile` of the objects of pilot scenes, whose
    light is simulated coarsely, has less significance than `evidence`; or, of those that move, than `change`, in the
    median of some frames of the sequence. It does not depend on the number of scenes.

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
        raise _refusal(request, f"none of the first {PILOTS} scenes has an object; add some to scene.contents")
    cycles = _enough_cycles(request, pilots)
    dtype, counter_max = config.store.histogram_dtype, config.detector.counter_max or math.inf
    fullest, largest = min(max(pilot.brightest for pilot in pilots) * cycles, counter_max), np.iinfo(dtype).max
    if fullest + 6 * math.sqrt(fullest) > largest and counter_max > largest:
        why = f"{cycles:g} cycles would do, but bring {fullest:.2g} counts into a bin, more than {dtype} holds"
        raise _refusal(request, f"{why}; set a wider store.histogram_dtype, or detector.counter_max")
    exposure = {"exposure_for": None, "found_for": request, "cycles": float(cycles)}
    return config.model_copy(update={"detector": config.detector.model_copy(update=exposure)})


def _pilots(config: DatasetConfig, request: ExposureFor) -> Iterator[_Pilot]:
    """Pilot scenes that hold objects, until there are `OBJECTS` of these; the same for any number of scenes."""
    one_cycle = config.detector.model_copy(update={"exposure_for": None, "cycles": 1.0})
    free = without_floors(config).model_copy(update={"detector": one_cycle})
    objects = 0
    for index in range(PILOTS):
        scene = generate_scene(free.scene, free.seed, index, clock=free.clock)
        names = scene.objects if request.change is None else scene.moving
        if not names:
            continue
        capture = capture_for(free, scene, free.seed, index)
        detector = detector_for(free.detector, free.seed, index, capture.time)
        measured = _of_evidence if request.change is None else _of_changes
        yield measured(free, request, index, scene, capture, *detector)
        objects += len(names)
        if objects >= OBJECTS:
            return


def _of_evidence(
    config: DatasetConfig, request: ExposureFor, index: int, scene: Scene, capture: Capture, spad: Spad,
    exposure: Exposure,
) -> _Pilot:  # fmt: skip
    """The evidence of the objects of a pilot scene; of a sequence, in its middle. exposure : of one cycle."""
    longest_s = _longest_s(config, capture)
    if config.clock is not None:
        middle_s = config.clock.duration_s / 2
        way = sensor_way(config, scene, capture, index)
        scene, capture = (
            scene.at(middle_s),
            capture if way is None else way.captures(capture, np.array([middle_s]))[0],
        )
    longest = replace(exposure, cycles=_most_cycles(request, exposure.repetition_rate_hz, longest_s))
    transient = coarse_transient(config, index, scene, capture, spad, longest)
    parts, unbounded = [transient.parts[name] for name in scene.objects], replace(spad, counter_max=None)
    blocks = [*own_light(transient.total, parts, transient.time, unbounded, exposure)]
    counts = np.concatenate([block.everything.reshape(-1) for block in blocks])
    squares = [[squares_over(own, block.everything).reshape(-1) for own in block.own] for block in blocks]
    each = np.concatenate([np.stack(of) for of in squares], axis=1)
    return _pilot(spad, exposure, longest_s, counts[None], each[:, None])


PAIRS = 3
"""Pairs of frames of a pilot sequence, spread evenly over it: changes differ most where things come near."""


def _of_changes(
    config: DatasetConfig, request: ExposureFor, index: int, scene: Scene, capture: Capture, spad: Spad,
    exposure: Exposure,
) -> _Pilot:  # fmt: skip
    """The changes by the objects of a pilot sequence that move, of whose light coarse runs would know nothing.
    exposure : of one cycle."""
    assert config.clock is not None
    longest_s = _longest_s(config, capture)
    frames = config.clock.frames
    chosen, step = np.arange(frames), 1
    if frames > 2 * PAIRS:
        before = (np.arange(PAIRS) + 0.5) * (frames - 1) / PAIRS
        chosen, step = np.stack([before, before + 1], axis=1).astype(np.int64).reshape(-1), 2
    all_times, exposure_s = times_of(capture, config.clock, None)
    times = all_times[chosen]
    effects = transport_effects(config, scene.at(config.clock.duration_s / 2), capture, index)
    longest = replace(exposure, cycles=_most_cycles(request, exposure.repetition_rate_hz, longest_s))
    lit = light_of(config, index, scene, capture, effects, spad, longest, frames=frames)
    way = sensor_way(config, scene, capture, index)
    if way is not None:
        lit = replace(lit, captures=way.captures(capture, times.mean(axis=1)))
    light = lit.frames(times, exposure_s)
    counts, squares = list[Floats](), list[Floats]()
    every = change_squares(scene, light, replace(spad, counter_max=None), exposure, way is not None)
    for both, each, _ in islice(every, None, None, step):
        # Two frames hardly differ.
        counts.append(both.reshape(-1) / 2)
        nothing = np.zeros(both.size)
        squares.append(np.stack([each[name].reshape(-1) if name in each else nothing for name in scene.moving]))
    return _pilot(spad, exposure, longest_s, np.stack(counts), np.stack(squares, axis=1))


def _pilot(spad: Spad, exposure: Exposure, longest_s: float, counts: Floats, squares: Floats) -> _Pilot:
    """The pilot of counts (frame, n) and squares (object, frame, n) of all bins."""
    brightest, counter_max = float(counts.max()), spad.counter_max
    if counter_max is None:
        counts, squares = np.zeros((len(counts), 1)), squares.sum(axis=2, keepdims=True)
    return _Pilot(counter_max or math.inf, exposure.repetition_rate_hz, longest_s, brightest, counts, squares)


def _longest_s(config: DatasetConfig, capture: Capture) -> float:
    """Longest exposure of a histogram that fits into the frames of a sequence; infinite of other scenes."""
    if config.sequence is None:
        return math.inf
    points = 1 if config.sequence.order == "together" else capture.shape[0]
    return 1.0 / (config.sequence.rate_hz * points)


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
        raise _refusal(request, f"{dark}; raise photons_per_pulse or quantile, or move the gate")
    rate_hz, cycles, sigma = min(pilot.rate_hz for pilot in pilots), 1.0, first[weakest]
    frame_s = min(pilot.longest_s for pilot in pilots)
    longest = _most_cycles(request, rate_hz, frame_s)
    while sigma < request.least * (1 - 1e-6):
        if sigma == 0:
            full = "counters are full before enough of the objects have as much"
            raise _refusal(request, f"{full}; raise counter_max or quantile, or lower photons_per_pulse")
        # σ grows with √N at most, so no fewer cycles are enough. A hundredth more at least, or the last steps would
        # be as many as there are bins whose counters get full.
        needed = cycles * max(float(request.least / sigma) ** 2, 1.01)
        if needed > longest:
            remedy = f"raise longest_s or photons_per_pulse, or lower {request.of}"
            if longest == MAX_CYCLES:
                most = f"no exposure has more than {MAX_CYCLES:g} cycles"
                remedy = f"{most}; raise photons_per_pulse or lower {request.of}"
            if frame_s < request.longest_s:
                remedy = (
                    f"{frame_s:.2g} s fit into a frame; lower sequence.rate_hz or {request.of}, or raise "
                    "photons_per_pulse"
                )
            raise _refusal(request, f"{needed / rate_hz:.2g} s would be needed; {remedy}")
        cycles = min(_rounded_up(needed), longest)
        sigma = significances(cycles)[weakest]
    return round(cycles)


def _most_cycles(request: ExposureFor, rate_hz: float, frame_s: float) -> int:
    """Cycles of the longest exposure that may be chosen. frame_s : seconds that fit into a frame."""
    return max(min(math.floor(min(request.longest_s, frame_s) * rate_hz), MAX_CYCLES), 1)


def _rounded_up(cycles: float) -> int:
    """Cycles rounded up to two significant digits: more are not known."""
    unit = int(10 ** max(math.floor(math.log10(max(cycles, 1.0))) - 1, 0))
    return max(math.ceil(cycles / unit - 1e-6) * unit, 1)


def _refusal(request: ExposureFor, why: str) -> InputError:
    """The error that names the request and the reason."""
    given = ", ".join(f"{name}: {value:g}" for name, value in request.model_dump().items())
    return InputError(f"detector.exposure_for = {{{given}}}: {why}")
