"""How much sampled light is worth: replicates tell the error, a pilot decides the effort, and the claim is estimated.

Light is sampled in blocks (`Source`), in `REPLICATES` independent replicates. A pilot of a few blocks gives variance
and cost of each component in each group of laser points and pixels. The least cost for a given sum of variances
v/n is at n ∝ √(v/cost) (Neyman 1934, with costs), so that is the effort of the one run that follows; where it misses
its aim, one more run is made with what is known then.

Neighbouring bins are spread over boxes where that lowers the error. What a box blurs and what noise it leaves is
judged by replicates that had no say in its width, so that the error that is claimed is an estimate without bias of
that choice. What all replicates have in common they cannot see: the bins at the ends of the window, and an error of
the energy of all bins, which has one degree of freedom and is counted apart.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from datagen.compiled import compiled
from datagen.records.arrays import Floats, Ints, l2_norm

REPLICATES = 8
"""Independent replicates, from which errors are known to a fifth."""
WIDTHS = np.array([1, 3, 5, 9, 17])
"""Widths of boxes, in bins."""
WINDOW = 600
"""Values whose boxes have one width, histograms of a group times bins: of fewer the noise decides the width."""
WINDOW_BINS = 12, 64
"""Fewest and most bins whose boxes have one width, as shapes change along the window."""
GROWTH = 64
"""Most blocks of a run, in units of those of the pilot: bounds the time of a scene whose light is not found."""
AIM = 0.8
"""Squared error that a run aims at, relative to the one asked: boxes become narrower as noise falls, so errors fall
more slowly than with 1/√n."""
OWN = 0.2
"""Error of a component, relative to its own light, down to which effort is spent on it."""
SHARE = 0.3
"""Error of a component, relative to the whole error asked, below which no more effort is spent on it."""
ROUGH = 0.1
"""Error of a pilot's energy from which on the pilot does not count: what remains is off by tenths of a per cent."""

Floats32 = NDArray[np.float32]


class Source(Protocol):
    """Where sampled light comes from.

    histograms : for each group the indices of its histograms, to which several groups may add light. unit : photons
    that light is a multiple of. first : blocks of each replicate and group in the pilot. can_blur : whether bins may
    be spread over boxes.
    """

    histograms: list[Ints]
    unit: float
    first: int
    can_blur: bool

    def add(self, group: int, replicate: int, number: int, light: Floats32) -> float:
        """Add block `number` of a replicate to the light (H, T + 2) of a group, whose first and last column take what
        comes before and after the window. Returns the cost, in shadow rays."""

    def aim(self, group: int, error: Floats) -> None:
        """Learn the errors (H,) of the histograms of a group after the pilot, which may steer later blocks."""

    def forget(self, group: int) -> None:
        """Learn that the blocks of a group so far do not count."""


Turns = dict[tuple[str, int], list[tuple[bool, int]]]
"""Component and group → for each turn whether the light so far was dropped, and blocks that were added."""


class Sampled(NamedTuple):
    """Sampled light, by component.

    light : (H, T) photons. error : L2 error, photons. variance : (H, T) squared standard errors. outside : (H,)
    photons outside the window. cost : shadow rays. apart : (H, T) half of the difference of two halves of the
    replicates. turns : of each group, the effort of each turn after the pilot.
    """

    light: dict[str, Floats]
    error: dict[str, float]
    variance: dict[str, Floats]
    outside: dict[str, Floats]
    cost: dict[str, float]
    apart: dict[str, Floats]
    turns: Turns

    def overflow(self, shape: tuple[int, int, int]) -> Floats:
        """(L, P) photons of all components outside the window."""
        return sum((of.reshape(shape[:2]) for of in self.outside.values()), start=np.zeros(shape[:2]))

    def with_components_of(self, other: Sampled) -> Sampled:
        """The same with the components that `other` has, whose costs are added."""
        cost = {name: self.cost.get(name, 0.0) + other.cost.get(name, 0.0) for name in self.cost | other.cost}
        return Sampled(
            self.light | other.light, self.error | other.error, self.variance | other.variance,
            self.outside | other.outside, cost, self.apart | other.apart, self.turns | other.turns,
        )  # fmt: skip


def sample_to_target(
    sources: Mapping[str, Source], shape: tuple[int, int], target: float, known: Floats, known_error: float,
    turns: Turns | None = None,
) -> Sampled:  # fmt: skip
    """Components from their sources, sampled until the error of the whole should be `target`.

    shape : (H, T) number of histograms, and of bins. known : (H, T) other light of the whole, with the L2 error
    `known_error`. turns : the effort, if that of another scene is to be repeated.
    """
    units = [
        _Unit(name, source, group, shape[1])
        for name, source in sources.items()
        for group in range(len(source.histograms))
    ]
    for unit in units:
        unit.run(unit.source.first)
        unit.source.aim(unit.group, np.sqrt(unit.variance.sum(axis=1)))
    found = Sampled({}, {}, {}, {}, {}, {}, {(unit.name, unit.group): [] for unit in units})
    for turn in range(2):
        if turns is None:
            # A pilot that met little light by chance also sees little noise, and would be followed by few blocks.
            # Where that would matter, it only decides the effort and does not count.
            more = [
                (turn == 0 and unit.is_rough, blocks)
                for unit, blocks in zip(units, _effort(units, target, known, known_error), strict=True)
            ]
        else:
            more = [turns[unit.name, unit.group][turn] for unit in units]
        for unit, (is_dropped, blocks) in zip(units, more, strict=True):
            unit.run(unit.restart() + blocks if is_dropped else blocks)
            found.turns[unit.name, unit.group].append((is_dropped, blocks))
        if turns is None and turn == 0 and not any(blocks for _, blocks in more):
            for done in found.turns.values():
                done.append((False, 0))
            break
    for name in sources:
        own = [unit for unit in units if unit.name == name]
        found.light[name], found.variance[name] = np.zeros(shape), np.zeros(shape)
        found.outside[name], found.apart[name] = np.zeros(shape[0]), np.zeros(shape)
        for unit in own:
            found.apart[name][unit.rows] += unit.apart
            found.light[name][unit.rows] += unit.mean
            found.variance[name][unit.rows] += unit.variance
            found.outside[name][unit.rows] += unit.outside
        found.error[name] = math.sqrt(sum(unit.error2 for unit in own))
        found.cost[name] = sum(unit.cost for unit in own)
    return found


def is_enough(error: float, own: float, whole: float, target: float) -> bool:
    """Whether a component's L2 error is at most twice what is asked, so that no other sampler is tried; `own` and
    `whole` are L2 norms of light."""
    return error <= 2.0 * max(OWN * own, SHARE * target * whole)


def _effort(units: list[_Unit], target: float, known: Floats, known_error: float) -> list[int]:
    """Blocks that the next run adds to each replicate of each unit; all 0 if errors are as asked."""
    if not units:
        return []
    total = known.copy()
    for unit in units:
        total[unit.rows] += unit.mean
    asked = target * l2_norm(total)
    left = math.sqrt(max(asked**2 - known_error**2, (SHARE * asked) ** 2))
    if asked == 0.0:
        return [0] * len(units)
    # A unit that has met no light yet gets the effort of a small share of the error.
    error2 = [unit.error2 for unit in units]
    least = 1e-3 * sum(error2) / len(units)
    price, of_error, of_light = dict[str, float](), dict[str, float](), dict[str, float]()
    for unit in units:
        price[unit.name] = price.get(unit.name, 0.0) + math.sqrt(max(unit.error2, least) * unit.counted_cost)
        of_error[unit.name] = of_error.get(unit.name, 0.0) + unit.error2
        of_light[unit.name] = of_light.get(unit.name, 0.0) + l2_norm(unit.mean) ** 2
    own = {name: max(OWN**2 * square, (SHARE * asked) ** 2) for name, square in of_light.items()}
    if sum(error2) <= left**2 and all(of_error[name] <= own[name] for name in own):
        return [0] * len(units)
    more = []
    for unit in units:
        cost = unit.counted_cost
        worth = unit.counted * math.sqrt(max(unit.error2, least) / cost) if cost > 0 else 0.0
        per_error2 = max(sum(price.values()) / (AIM * left**2), price[unit.name] / (AIM * own[unit.name]))
        more.append(int(min(max(math.ceil(worth * per_error2) - unit.counted, 0), GROWTH * unit.source.first)))
    return more


class _Unit:
    """A component in a group of histograms.

    light : (R, H, T + 2) sums over the `counted` blocks of each replicate, in units of the source. mean : (H, T)
    photons. apart : (H, T) half of the difference between the means of two halves of the replicates. error2 :
    estimated squared L2 error of the mean. variance : (H, T) squared standard errors, which add up to it. outside :
    (H,) photons outside the window. cost : shadow rays.
    """

    def __init__(self, name: str, source: Source, group: int, bins: int) -> None:
        self.name, self.source, self.group, self.rows = name, source, group, source.histograms[group]
        self.light = np.zeros((REPLICATES, len(self.rows), bins + 2), np.float32)
        self.blocks, self.counted, self.cost, self.error2, self.is_rough = 0, 0, 0.0, 0.0, False

    @property
    def counted_cost(self) -> float:
        """Cost of the blocks that count."""
        return self.cost * self.counted / max(self.blocks, 1)

    def restart(self) -> int:
        """Forget the light; returns the number of blocks of each replicate that it came from."""
        forgotten, self.counted = self.counted, 0
        self.light[:] = 0.0
        self.source.forget(self.group)
        return forgotten

    def run(self, blocks: int) -> None:
        """Add so many blocks to each replicate, and estimate the light anew."""
        if blocks == 0:
            return
        for replicate in range(REPLICATES):
            for number in range(self.blocks, self.blocks + blocks):
                self.cost += self.source.add(self.group, replicate, number, self.light[replicate])
        self.blocks, self.counted = self.blocks + blocks, self.counted + blocks
        scale = self.source.unit / self.counted
        each = self.light[..., 1:-1]
        mean, error2, variance, apart = estimate_of(each, self.source.can_blur)
        energy = each.sum(axis=(1, 2), dtype=np.float64)
        self.is_rough = energy.std(ddof=1) >= ROUGH * math.sqrt(REPLICATES) * energy.mean()
        # Counted twice: with one degree of freedom an error exceeds 1.5 of its root mean squares in 13 % of cases,
        # with this in 3 %.
        if energy.mean() > 0:
            error2 += energy.var(ddof=1) / REPLICATES * float(np.sum(mean**2)) / energy.mean() ** 2
        spread = float(variance.sum())
        self.mean, self.error2, self.apart = scale * mean, scale**2 * error2, scale * apart
        self.variance = scale**2 * variance * (error2 / spread if spread > 0 else 1.0)
        self.outside = scale * self.light[..., (0, -1)].sum(axis=2, dtype=np.float64).mean(axis=0)


def estimate_of(each: Floats32, can_blur: bool = True) -> tuple[Floats, float, Floats, Floats]:
    """Mean (H, T) of replicates (R, H, T), the estimated square of its L2 error, variances of the plain mean, and
    half of the difference between the means of even and odd replicates.

    Each window of bins is spread over boxes of the width of least error. The widths that even replicates choose are
    judged by the odd ones, and vice versa.
    """
    R, H, T = each.shape
    plain, variance = np.empty((H, T)), np.empty((H, T))
    _mean_and_variance(each, plain, variance)
    apart = 0.5 * (each[::2].mean(axis=0, dtype=np.float64) - each[1::2].mean(axis=0, dtype=np.float64))
    if not can_blur:
        return plain, float(variance.sum()), variance, apart
    window = int(np.clip(WINDOW // H, *WINDOW_BINS))
    windows = -(-T // window)
    noise, bias = np.zeros((3, len(WIDTHS), windows)), np.zeros((3, len(WIDTHS), windows))
    _judge(each, WIDTHS, window, noise, bias)
    best, at = (noise / R + bias).argmin(axis=1), np.arange(windows)
    judged = [(noise[j, best[m], at].sum() / R, bias[j, best[m], at].sum()) for m, j in ((0, 1), (1, 0))]
    error2 = float(np.mean([of_noise for of_noise, _ in judged]) + max(np.mean([blur for _, blur in judged]), 0.0))
    if error2 >= variance.sum():
        return plain, float(variance.sum()), variance, apart
    of_all = WIDTHS[best[2]]
    return _spread_over_boxes(plain, of_all, window), error2, variance, _spread_over_boxes(apart, of_all, window)


@compiled()
def _mean_and_variance(each, mean, variance):  # type: ignore[no-untyped-def]
    """Sets the mean over replicates (R, H, T), and the variance of that mean."""
    R = each.shape[0]
    for h in range(each.shape[1]):
        for t in range(each.shape[2]):
            total = square = 0.0
            for r in range(R):
                total += each[r, h, t]
            for r in range(R):
                square += (each[r, h, t] - total / R) ** 2
            mean[h, t], variance[h, t] = total / R, square / (R * (R - 1))


@compiled()
def _box_sums(values, half, running, out):  # type: ignore[no-untyped-def]
    """Sets out (T,) to the sums of values (T,) over boxes that reach `half` bins to either side, cut at the ends."""
    T = len(values)
    running[0] = 0.0
    for t in range(T):
        running[t + 1] = running[t] + values[t]
    for t in range(T):
        out[t] = running[min(t + half + 1, T)] - running[max(t - half, 0)]


@compiled()
def _judge(each, widths, window, noise, bias):  # type: ignore[no-untyped-def]
    """Adds up, by width and window of bins, the variance of one replicate spread over boxes, and the square of what
    boxes blur: (3, widths, windows), as the even, the odd and all replicates of (R, H, T) judge."""
    R, H, T = each.shape
    # Of even, odd and all replicates: sums of values, of their squares, of what boxes change, of its squares.
    box, running, sums = np.empty((R, T)), np.empty(T + 1), np.empty((3, 4))
    for h in range(H):
        for k in range(len(widths)):
            for r in range(R):
                _box_sums(each[r, h], widths[k] // 2, running, box[r])
            for t in range(T):
                sums[:] = 0.0
                for r in range(R):
                    x = box[r, t] / widths[k]
                    y = x - each[r, h, t]
                    sums[r % 2, 0] += x
                    sums[r % 2, 1] += x * x
                    sums[r % 2, 2] += y
                    sums[r % 2, 3] += y * y
                for j in range(4):
                    sums[2, j] = sums[0, j] + sums[1, j]
                for m in range(3):
                    n = R if m == 2 else (R + 1 - m) // 2
                    noise[m, k, t // window] += (sums[m, 1] - sums[m, 0] ** 2 / n) / (n - 1)
                    # The square of a noisy mean is too large by its variance.
                    variance = (sums[m, 3] - sums[m, 2] ** 2 / n) / (n * (n - 1))
                    bias[m, k, t // window] += (sums[m, 2] / n) ** 2 - variance


@compiled()
def _spread_over_boxes(light, widths, window):  # type: ignore[no-untyped-def]
    """Light (H, T) spread over boxes, whose widths are given by window of bins."""
    H, T = light.shape
    out, box, running = np.empty((H, T)), np.empty(T), np.empty(T + 1)
    for h in range(H):
        for width in np.unique(widths):
            _box_sums(light[h], width // 2, running, box)
            for t in range(T):
                if widths[t // window] == width:
                    out[h, t] = box[t] / width
    return out
