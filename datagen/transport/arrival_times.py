"""Light of an element over arrival times: of a triangle whose parts have linear times and weights, spread over the
times of a flat cluster of FoV points.

The light of a part that has arrived by time t is a sum of B-splines whose knots are the times at its corners, one of
them twice; that of all parts is a cubic polynomial between any two corners. Its fourth differences are four numbers
for each corner, wherever in its bin that is, and three running sums of them are the light of each bin: a triangle
costs its corners and its bins, however many parts it has.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from datagen.compiled import compiled
from datagen.records.arrays import Floats, Ints

LEVELS = 2
"""Most times that a triangle is quartered: more parts make shapes in time more exact, and cost a guess a corner."""
SPANS = (24.0, 8.0, 2.0)
"""Span of an element's times, bins, below which its light is spread over a cluster by halves, quarters and eighths of
a bin: by whole bins rooms erred by 1.2 to 1.6 times as much."""
TIE = 1e-4
"""Share of the span of a triangle's times by half of which its second corner becomes later and its third one earlier,
as corners need times of their own, whose differences are divided by."""
TIED = 0.05
"""The same in steps, at least: little beside a step, and far more than rounding."""
LEAST_GAP = 1e-12
"""Steps that are divided by where times are the same in spite of that: far fewer than any that count."""


def _division() -> tuple[tuple[int, ...], Floats, Ints, Ints, Floats]:
    """How a triangle is divided into 4^level equal parts, for each level.

    Returns the number of corners of all parts of each level; the place of each corner (n, 2), as shares of the ways
    to the second and third corner of the triangle; the two corners (n, 2) in the middle between which each lies; the
    corners of each part (LEVELS + 1, 4^LEVELS, 3); and the number of parts that meet at each corner (LEVELS + 1, n).
    Corners of a coarser level come first, in the same order.
    """
    counts, where, between = list[int](), {(0.0, 0.0): 0, (1.0, 0.0): 1, (0.0, 1.0): 2}, [(0, 0), (1, 1), (2, 2)]
    parts = np.zeros((LEVELS + 1, 4**LEVELS, 3), np.int64)
    for level in range(LEVELS + 1):
        n = 2**level
        every = [(i, j) for i in range(n + 1) for j in range(n + 1 - i) if (i / n, j / n) not in where]
        where |= {(i / n, j / n): len(where) + k for k, (i, j) in enumerate(every)}
        # Along one of the three directions in which sides run.
        for i, j in every:
            a, b = (1, -(j % 2)) if i % 2 else (0, 1)
            between.append((where[(i - a) / n, (j - b) / n], where[(i + a) / n, (j + b) / n]))
        # A part that stands upright, and the one beside it that is upside down.
        of = [
            (where[(i + down) / n, j / n], where[(i + 1) / n, (j + down) / n], where[i / n, (j + 1) / n])
            for i in range(n) for j in range(n - i) for down in range(2 if j < n - i - 1 else 1)
        ]  # fmt: skip
        counts.append(len(where))
        parts[level, : len(of)] = of
    meeting = [np.bincount(of[: 4**level].ravel(), minlength=len(where)) for level, of in enumerate(parts)]
    return tuple(counts), np.array(list(where)), np.array(between), parts, np.array(meeting, float)


CORNERS, PLACES, BETWEEN, PARTS, MEETING = _division()
"""How a triangle is divided: see `_division`."""


class Work(NamedTuple):
    """Arrays to work with.

    steps : (n,) fourth differences of light; own, once : (n,) light that is spread over no side of the cluster yet,
    and over one. They are zero before and after use. square, cube : (CORNERS[-1],) of `_set_knots`.
    """

    steps: Floats
    own: Floats
    once: Floats
    square: Floats
    cube: Floats

    @classmethod
    def of(cls, bins: int, widest: float) -> Work:
        """Arrays for histograms of some bins, and clusters whose times change by `widest` steps at most, over both
        sides together."""
        return cls(*np.zeros((3, (bins << len(SPANS)) + 3 * (int(widest) + 4) + 8)), *np.empty((2, CORNERS[-1])))


class Box(NamedTuple):
    """How times that are spread evenly over some steps become shares of steps.

    m : number of steps on either side of the middle that count as much as it. tilt : change of light from a step to
    the next, relative to its mean. newest, oldest : how much one more step on either side counts, so that the
    variance is exact. total : of all.
    """

    m: int
    tilt: float
    newest: float
    oldest: float
    total: float


@compiled(forceinline=True, allocates=False)
def _set_knots(level, at, time, square, cube):  # type: ignore[no-untyped-def]
    """Sets square and cube (CORNERS[-1],) so that Σ square (t − tᵥ)² + cube (t − tᵥ)³, over the corners v with times
    tᵥ before t, is in proportion to the light that has arrived by t; returns what it is in the end."""
    total = 0.0
    for k in range(CORNERS[level]):
        square[k], cube[k] = 0.0, 0.0
    for part in range(1 << 2 * level):
        a, b, c = PARTS[level, part, 0], PARTS[level, part, 1], PARTS[level, part, 2]
        u, v, w = time[a] - time[b], time[b] - time[c], time[c] - time[a]
        u, v, w = u if u != 0.0 else LEAST_GAP, v if v != 0.0 else LEAST_GAP, w if w != 0.0 else LEAST_GAP
        of_all = 1.0 / (u * v * w)
        u, v, w = v * w * of_all, w * u * of_all, u * v * of_all
        of_a, of_b, of_c, at_a, at_b, at_c = -u * w, -u * v, -v * w, at[a], at[b], at[c]
        square[a] += 3.0 * of_a * at_a
        square[b] += 3.0 * of_b * at_b
        square[c] += 3.0 * of_c * at_c
        cube[a] += of_a * ((u - w) * at_a - u * at_b + w * at_c)
        cube[b] += of_b * ((v - u) * at_b - v * at_c + u * at_a)
        cube[c] += of_c * ((w - v) * at_c - w * at_a + v * at_b)
        total += at_a + at_b + at_c
    return total


@compiled(allocates=False)
def _delay_by_tilt(level, at):  # type: ignore[no-untyped-def]
    """By how much times become later in the mean, weighted by `at`, where the second corner of the triangle becomes
    later by a half, and the third one earlier."""
    total = later = 0.0
    for part in range(1 << 2 * level):
        a, b, c = PARTS[level, part, 0], PARTS[level, part, 1], PARTS[level, part, 2]
        one, two, three = PLACES[a, 0] - PLACES[a, 1], PLACES[b, 0] - PLACES[b, 1], PLACES[c, 0] - PLACES[c, 1]
        # Of a product of two linear functions over a triangle.
        own = at[a] + at[b] + at[c]
        later += own * (one + two + three) + at[a] * one + at[b] * two + at[c] * three
        total += own
    return later / (8.0 * total)


@compiled(forceinline=True, allocates=False)
def _add_steps(t, q, c, steps):  # type: ignore[no-untyped-def]
    """Adds to steps so that their threefold running sum is the light of each bin, if q (x − t)² + c (x − t)³ is that
    by time x > t, bins."""
    if t < 0.0:
        # The light of three bins tells that of all others.
        one = q * (1.0 - 2.0 * t) + c * (1.0 - 3.0 * t * (1.0 - t))
        two = q * (3.0 - 2.0 * t) + c * (7.0 - 3.0 * t * (3.0 - t))
        three = q * (5.0 - 2.0 * t) + c * (19.0 - 3.0 * t * (5.0 - t))
        steps[0] += one
        steps[1] += two - 3.0 * one
        steps[2] += three - 3.0 * (two - one)
        return
    # Indices without a sign are taken as they are. Of the bin that t is in, f is left and g is gone.
    i = np.uint64(t)
    f = np.float64(i) + 1.0 - t
    g = 1.0 - f
    f2, g2 = f * f, g * g
    steps[i] += f2 * (c * f + q)
    steps[i + np.uint64(1)] += c * (1.0 + 3.0 * (f + f2 - f2 * f)) + q * (1.0 + 2.0 * f - 3.0 * f2)
    steps[i + np.uint64(2)] += c * (1.0 + 3.0 * (g + g2 - g2 * g)) + q * (3.0 * f2 - 4.0 * f)
    steps[i + np.uint64(3)] += g2 * (c * g - q)


@compiled(forceinline=True, allocates=False)
def _box(width, tilt):  # type: ignore[no-untyped-def]
    """The `Box` of times that are spread evenly over `width` steps, where light changes by `tilt` over all of them,
    relative to its mean."""
    square = width * width
    m = int(0.5 * (math.sqrt(1.0 + square) - 1.0))
    end = (2.0 * m + 1.0) * (square - 4.0 * m * (m + 1.0)) / (24.0 * (m + 1.0) ** 2 - 2.0 * square)
    most = 1.0 / (m + 1.0)
    tilt = max(min(tilt / max(width, LEAST_GAP), most), -most)
    lean = (m + 1) * tilt * end
    return Box(m, tilt, end - lean, end + lean, 2.0 * m + 1.0 + 2.0 * end)


@compiled(forceinline=True, allocates=False)
def spread(batch, s, histogram, work):  # type: ignore[no-untyped-def]
    """Adds the light of sample s of a `Batch`, whose times are changed, to histogram (T,); returns what is outside of
    it, photons.

    The times of a flat cluster are those of two boxes, one after the other, and its weights a product of those along
    its two sides. To spread over a box is to sum over neighbouring steps: elements that fit together still do.
    """
    light, level, time, at, change, shift = (
        batch.light[s], batch.level[s], batch.time[s], batch.at[s], batch.change[s], batch.shift[s]
    )  # fmt: skip
    n, fine, first, last = CORNERS[level], float(1 << shift), time[0], time[0]
    for v in range(n):
        first, last = min(first, time[v]), max(last, time[v])
    span, wide1, wide2 = fine * (last - first), fine * abs(change[0]), fine * abs(change[1])
    tie = max(TIE * span, TIED)
    if wide1 + wide2 > 0.0 and span < 2.0:
        # What is narrower than steps is shared by two of them, so that its mean is kept: tilted by two it is a linear
        # spline. The wider box gives back the variance that is added, a twelfth of half the square.
        tie = max(tie, min(2.0 - span, math.sqrt(2.0) * max(wide1, wide2)))
        one, two = (0.5 * tie**2, 0.0) if wide1 > wide2 else (0.0, 0.5 * tie**2)
        wide1, wide2 = math.sqrt(max(wide1**2 - one, 0.0)), math.sqrt(max(wide2**2 - two, 0.0))
    more = _delay_by_tilt(level, at) if tie > TIED else 0.0
    box1 = _box(wide1, math.copysign(change[2], change[0] * change[2]))
    box2 = _box(wide2, math.copysign(change[3], change[1] * change[3]))
    # Light before the window or after it may be spread into it.
    reach, T = box1.m + box2.m + 2, len(histogram) << shift
    count = T + 2 * reach
    first, last = fine * first + reach - tie, fine * last + reach + tie
    if not (last > 0.0 and first < count):
        return light
    for v in range(n):
        time[v] = fine * time[v] + tie * (0.5 * (PLACES[v, 0] - PLACES[v, 1]) - more) + reach
    scale = light / _set_knots(level, at, time, work.square, work.cube)
    for v in range(n):
        if time[v] < count:
            _add_steps(time[v], work.square[v], work.cube[v], work.steps)
    begin, end, late = np.uint64(max(first, 0.0)), np.uint64(min(last, count - 1.0)), np.uint64(2 * reach)
    stop = min(end + late, np.uint64(count - 1)) + np.uint64(1)
    by, scale = np.uint64(shift), scale / (box1.total * box2.total)
    if box1.m + box2.m == 0:
        inside = _add_narrow(work, box1, box2, scale, begin, end, stop, late, histogram, by)
    else:
        inside = _add_wide(work, box1, box2, scale, begin, end, stop, late, histogram, by)
    for i in range(end + np.uint64(1), end + np.uint64(5)):
        work.steps[i] = 0.0
    return max(light - inside, 0.0) if first < 2 * reach or last >= T else 0.0


@compiled(forceinline=True, allocates=False)
def _add_narrow(work, one, two, scale, begin, end, stop, late, histogram, by):  # type: ignore[no-untyped-def]
    """Adds light that is spread over two boxes of three steps each to histogram (T,); returns the photons added.

    scale : photons for a unit of light in `work`. begin, end : first and last step that has light; stop : one after
    the last that it is spread to. late : steps before the window. by : a bin is 2^by steps.
    """
    # Five steps are left, of the newest light and that of four steps before.
    c0, c1, c2, c3, c4 = (
        scale * one.newest * two.newest, scale * (one.newest + two.newest),
        scale * (1.0 + one.newest * two.oldest + one.oldest * two.newest), scale * (one.oldest + two.oldest),
        scale * one.oldest * two.oldest,
    )  # fmt: skip
    inside = s1 = s2 = s3 = v1 = v2 = v3 = v4 = 0.0
    for i in range(begin, stop):
        v0 = 0.0
        if i <= end:
            s1 += work.steps[i]
            s2 += s1
            s3 += s2
            work.steps[i] = 0.0
            v0 = max(s3, 0.0)
        if i >= late:
            here = max(c0 * v0 + c1 * v1 + c2 * v2 + c3 * v3 + c4 * v4, 0.0)
            inside += here
            histogram[(i - late) >> by] += here
        v1, v2, v3, v4 = v0, v1, v2, v3
    return inside


@compiled(forceinline=True, allocates=False)
def _add_wide(work, one, two, scale, begin, end, stop, late, histogram, by):  # type: ignore[no-untyped-def]
    """Adds light that is spread over two boxes of any width to histogram (T,); returns the photons added."""
    own, once, unit = work.own, work.once, np.uint64(1)
    k1, k2 = np.uint64(2 * one.m + 2), np.uint64(2 * two.m + 2)
    inside = s1 = s2 = s3 = 0.0
    for i in range(begin, end + unit):
        s1 += work.steps[i]
        s2 += s1
        s3 += s2
        work.steps[i] = 0.0
        own[i + late] = max(s3, 0.0)
    # `once` is m + 1 steps of the first box later than `own`, and what is spread twice as much later again by the
    # second box. Of neighbours s is the sum, and t that of each times how much later it becomes.
    s1 = s2 = t1 = t2 = 0.0
    for i in range(begin, stop):
        k = i + late
        new, old = own[k - unit], own[k - k1]
        t1 += s1 - (one.m + 1) * old - one.m * new
        s1 += new - old
        once[k] = s1 + one.tilt * t1 + one.newest * own[k] + one.oldest * old
        new, old = once[k - unit], once[k - k2]
        t2 += s2 - (two.m + 1) * old - two.m * new
        s2 += new - old
        if i >= late:
            here = scale * max(s2 + two.tilt * t2 + two.newest * once[k] + two.oldest * old, 0.0)
            inside += here
            histogram[(i - late) >> by] += here
    for i in range(begin, stop):
        own[i + late] = once[i + late] = 0.0
    return inside
