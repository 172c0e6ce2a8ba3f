"""True errors: a reference that converged with other seeds, and settings run several times beside it."""

from __future__ import annotations

import statistics
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from datagen.bench.accuracy_settings import FACTORS, WIDEST, Setting
from datagen.errors import InputError
from datagen.records import Accuracy, Capture, Laser, Scene, Sensor, TimeAxis
from datagen.transport import simulate

Array = NDArray[np.float64]
REFERENCE_SEED = 1 << 40
SHARE_OF_REFERENCE = 0.5
FEWEST_LOOKINS = 64
SLOWEST_SHARE = 0.04
"""A setting of which one run takes more than this share of the budget is run once, and dearer ones not at all."""


@dataclass(frozen=True)
class Problem:
    """A scene, how it is looked at, and its name for the report."""

    scene: Scene
    capture: Capture

    def widened(self, p: int, q: int) -> Capture:
        """The capture with bins p/q times as wide over the same window (whole wide bins of it)."""
        axis = self.capture.time
        return replace(
            self.capture, time=TimeAxis(axis.bins * q // p, axis.width_s * p / q, axis.start_s, axis.origin)
        )


def fewer_laser_points(capture: Capture, most: int | None) -> Capture:
    """At most `most` of the laser points (confocal: with their pixels), spread evenly over the scan."""
    count = len(capture.laser.targets)
    if most is None or count <= most:
        return capture
    kept = np.unique(np.round((np.arange(most) + 0.5) * count / most - 0.5).astype(int))
    sensor = capture.sensor
    if capture.pairing == "confocal":
        sensor = Sensor(sensor.position, sensor.pixels[kept], sensor.aperture_radius_m, sensor.finite_aperture)
    return replace(capture, laser=Laser(capture.laser.position, capture.laser.targets[kept]), sensor=sensor)


def wider(transient: Array, times: int) -> Array:
    """(…, T) → (…, T // times): what bins `times` (odd) as wide hold, from what narrow ones hold.

    A path is shared by the two nearest bins, so bin i holds Σ E φ((t − tᵢ)/W) with the hat φ(x) = max(0, 1 − |x|).
    A wide hat is a sum of narrow ones: φ(x/m) = Σⱼ (1 − |j|/m) φ(x − j), |j| < m.
    """
    if times == 1:
        return transient
    if times % 2 == 0:
        raise ValueError(f"times = {times}: centres of wide bins are centres of narrow ones for odd ratios only")
    bins = transient.shape[-1] // times
    padded = np.pad(transient, [(0, 0)] * (transient.ndim - 1) + [(times, times)])
    result = np.zeros((*transient.shape[:-1], bins))
    first = times + (times - 1) // 2
    for shift in range(1 - times, times):
        start = first + shift
        result += (1 - abs(shift) / times) * padded[..., start : start + times * (bins - 1) + 1 : times]
    return result


def inner(transient: Array) -> Array:
    """Without the outermost bins, which lack what wide bins share with the outside of the window."""
    return transient[..., 1:-1] if transient.shape[-1] > 2 else transient


@dataclass(frozen=True)
class Truth:
    """The converged transient in bins of one width, less the outermost.

    value : mean of two halves. square_error : of it, ‖half₁ − half₂‖²/4. square : ‖truth‖², freed of that.
    """

    value: Array
    square_error: float
    square: float

    @classmethod
    def of(cls, halves: Sequence[Array]) -> Truth:
        one, two = (inner(half) for half in halves)
        mean = (one + two) / 2
        error = float(np.sum((one - two) ** 2)) / 4
        return cls(mean, error, max(float(np.sum(mean**2)) - error, 0.0))

    @property
    def relative_error(self) -> float:
        return float(np.sqrt(self.square_error / self.square)) if self.square > 0 else 0.0

    def error_of(self, transient: Array) -> float:
        """Relative L2 error of a transient, the reference's own error subtracted."""
        apart = float(np.sum((transient - self.value) ** 2)) - self.square_error
        return float(np.sqrt(max(apart, 0.0) / self.square))

    def scaled_to(self, transient: Array) -> Array:
        """The transient, scaled to come as close as it can."""
        own = float(np.sum(transient**2))
        return transient * (float(np.sum(transient * self.value)) / own if own > 0 else 0.0)


@dataclass(frozen=True)
class Reference:
    """truths : (all bounce orders?, bin widening) → truth. lookins : of both halves of each together. seconds :
    processor time of all."""

    truths: dict[tuple[bool, tuple[int, int]], Truth]
    lookins: dict[bool, int]
    seconds: float


@dataclass(frozen=True)
class Row:
    """One setting, measured. Medians over `repeats` runs with different seeds.

    Attributes
    ----------
    seconds : processor seconds of a run.
    complete : whether the truth is all bounce orders, or those of the base setting; always all paths.
    error : relative L2 error against the truth.
    noise : its random part, relative to what the setting converges to.
    bias : its systematic part, which more samples do not mend; 0 where it is not above what noise leaves uncertain.
    together : for other bin widths, the error after binning to the widest ones.
    front : on the Pareto front of its truth: nothing quicker has less error.
    """

    quantity: str
    value: str
    config: str
    repeats: int
    seconds: float
    error: float
    noise: float
    bias: float
    together: float | None
    complete: bool
    scaled: bool
    front: bool = False


def processor_seconds(accuracy: Accuracy, problem: Problem) -> float:
    """Of one run."""
    began = time.process_time()
    simulate(problem.scene, problem.capture, accuracy, 2, split_parts=False)
    return time.process_time() - began


def base_lookins(base: Accuracy, problem: Problem, seconds: float) -> Accuracy:
    """The base setting with as many lookins, up to its own, as take at most `seconds` processor seconds."""
    tried = replace(base, lookins=FEWEST_LOOKINS)
    processor_seconds(tried, problem)
    while 2 * tried.lookins <= base.lookins and processor_seconds(tried, problem) < seconds / 2:
        tried = replace(tried, lookins=2 * tried.lookins)
    return tried


def converge(problem: Problem, base: Accuracy, budget_s: float) -> Reference:
    """Long runs: of the base setting's bounce orders, and of all; together within the budget.

    Raises
    ------
    InputError : no light arrives within the window, so that there is nothing to be wrong about.
    """
    truths: dict[tuple[bool, tuple[int, int]], Truth] = {}
    lookins, seconds = dict[bool, int](), 0.0
    for complete in (False, True):
        accuracy = replace(base, max_bounces=None) if complete else base
        if complete and base.max_bounces is None:
            found = {widening: truths[False, widening] for widening in FACTORS}
            lookins[True] = lookins[False]
        else:
            found, lookins[complete], taken = _long_run(problem, accuracy, budget_s / 2)
            seconds += taken
        truths |= {(complete, widening): truth for widening, truth in found.items()}
    return Reference(truths, lookins, seconds)


def _long_run(
    problem: Problem, accuracy: Accuracy, budget_s: float
) -> tuple[dict[tuple[int, int], Truth], int, float]:
    """Truth by bin width, lookins and processor seconds of two halves, doubled until a further run would not fit."""
    finest = FACTORS[0]
    capture, count, spent = problem.widened(*finest), accuracy.lookins, 0.0
    while True:
        long = replace(accuracy, lookins=count, replicates=1)
        began = time.process_time()
        halves = [
            simulate(problem.scene, capture, long, REFERENCE_SEED + half, split_parts=False).total
            for half in range(2)
        ]
        taken = time.process_time() - began
        if not all(half.any() for half in halves):
            raise InputError(
                "the scene sends no light into the window, so there is no error to measure; try another --scene"
            )
        spent += taken
        times = 1 << max(0, int(np.log2(max((budget_s - spent) / max(taken, 1e-6), 1.0))))
        if times < 2:
            break
        count *= times
    truths = {(p, q): Truth.of([wider(half, p * finest[1] // q) for half in halves]) for p, q in FACTORS}
    return truths, 2 * count, spent


def measure(setting: Setting, problem: Problem, reference: Reference, repeats: int, slowest_s: float) -> Row:
    """Run a setting `repeats` times; less often if one run takes longer than `slowest_s`."""
    p, q = setting.widening
    truth, capture = reference.truths[setting.complete, (p, q)], problem.widened(p, q)
    widest = reference.truths[setting.complete, (WIDEST, 1)]
    seconds, errors, together = list[float](), list[float](), list[float]()
    total, squares = np.zeros_like(truth.value), 0.0
    for seed in range(1, 1 + (1 if setting.fixed else repeats)):
        began = time.process_time()
        whole = setting.run(problem.scene, capture, seed)
        seconds.append(time.process_time() - began)
        found = truth.scaled_to(inner(whole)) if setting.scaled else inner(whole)
        errors.append(truth.error_of(found))
        if setting.quantity == "bin width":
            together.append(widest.error_of(inner(wider(whole, WIDEST * q // p))))
        total += found
        squares += float(np.sum(found**2))
        # A first run may have waited for a kernel that no other setting needed.
        if min(seconds) > (slowest_s if len(seconds) > 1 else 4 * slowest_s):
            break
    runs = len(errors)
    noise, bias = _split(truth, total / runs, squares, runs, setting)
    return Row(
        setting.quantity, setting.value, setting.config, runs, statistics.median(seconds), statistics.median(errors),
        noise, bias, statistics.median(together) if together else None,
        setting.complete, setting.scaled,
    )  # fmt: skip


def _split(truth: Truth, mean: Array, squares: float, runs: int, setting: Setting) -> tuple[float, float]:
    """Noise relative to the mean, and bias relative to the truth; NaN where one run cannot tell them apart."""
    if setting.fixed:
        return 0.0, truth.error_of(mean)
    if runs == 1:
        return float("nan"), float("nan")
    own = float(np.sum(mean**2))
    variance = max(squares - runs * own, 0.0) / (runs - 1)
    uncertain = variance / runs + truth.square_error
    apart = float(np.sum((mean - truth.value) ** 2)) - uncertain
    noise = float(np.sqrt(variance / max(own - variance / runs, 1e-300)))
    # Few bright bins decide, so the squared distance fluctuates by about as much as chance alone makes it.
    return noise, float(np.sqrt(apart / truth.square)) if apart > uncertain else 0.0


def with_front(rows: Sequence[Row]) -> list[Row]:
    """The rows with the Pareto front marked: those than which nothing quicker has as little error.

    Other bin widths are other problems, and a transient that must be scaled gives less: neither takes part.
    """
    best, marked = {True: np.inf, False: np.inf}, dict[int, Row]()
    for k in sorted(range(len(rows)), key=lambda k: (rows[k].seconds, rows[k].error)):
        row = rows[k]
        takes_part = not row.scaled and row.quantity != "bin width"
        marked[k] = replace(row, front=takes_part and row.error < best[row.complete])
        if takes_part:
            best[row.complete] = min(best[row.complete], row.error)
    return [marked[k] for k in range(len(rows))]
