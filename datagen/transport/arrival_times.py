"""Light of an element over arrival times: of a triangle whose parts have linear times and weights, spread over the
times of a flat cluster of FoV points.

The light of a part that has arrived by time t is a sum of B-splines whose knots are the times at its corners, one of
them twice; that of all parts is a cubic polynomial between any two corners. Its fourth differences are four numbers
for each corner, wherever in its bin that is, and three running sums of them are the light of each bin: a triangle
costs its corners and its bins, however many parts it has.
"""

from __future__ import annotations

import math

import numpy as np

from datagen.compiled import compiled
from datagen.records.arrays import Floats, Ints

LEVELS, FINEST = 2, 3
"""Most times that a triangle is quartered, and that a bin is halved."""
TIE, TIED = 1e-4, 0.05
"""Corners of a part need times of their own: those of a triangle are tilted, one late and one early, by this share of
their span, at least so many bins."""
APART = 1e-12
"""Bins between corners that are at one time in spite of it, and that are divided by at least."""


def _divided() -> tuple[tuple[int, ...], Floats, Ints, Ints]:
    """How a triangle is divided into 4^level equal parts: for each level the number of their corners; where corners
    lie (n, 2), as shares of the ways to the second and third corner of the triangle; the two (n, 2) in the middle
    between which each lies; and the corners of each part (LEVELS + 1, 4^LEVELS, 3). Corners of a coarser level come
    first, in the same order."""
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
    return tuple(counts), np.array(list(where)), np.array(between), parts


CORNERS, PLACES, BETWEEN, PARTS = _divided()
"""Of a triangle's parts."""
MEETING = np.array(
    [np.bincount(of[: 4**level].ravel(), minlength=CORNERS[-1]) for level, of in enumerate(PARTS)], float
)
"""Number of the parts of each level that meet at each corner (LEVELS + 1, CORNERS[-1])."""


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
        u, v, w = u if u != 0.0 else APART, v if v != 0.0 else APART, w if w != 0.0 else APART
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
def _tilted(level, at):  # type: ignore[no-untyped-def]
    """By how much times become later in the mean, weighted by `at`, where corners are tilted by one."""
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
    """How times that are spread evenly over some bins become shares of bins: the number m of bins on either side of
    the middle that count as much as it, how much one more on either side counts, so that the variance is exact, and
    the change from a bin to the next where light changes by `tilt` over all of them, relative to its mean."""
    square = width * width
    m = int(0.5 * (math.sqrt(1.0 + square) - 1.0))
    end = (2.0 * m + 1.0) * (square - 4.0 * m * (m + 1.0)) / (24.0 * (m + 1.0) ** 2 - 2.0 * square)
    most = 1.0 / (m + 1.0)
    return m, end, max(min(tilt / max(width, APART), most), -most)


def reserved(bins: int, widest: float) -> Floats:
    """(3, n) zeros to work with, for histograms of some bins and clusters whose times change by `widest` fine bins at
    most, over both sides together."""
    return np.zeros((3, (bins << FINEST) + 3 * (int(widest) + 4) + 8))


@compiled(allocates=False)
def spread(  # type: ignore[no-untyped-def]
    light, level, time, at, change, shift, histogram, row, steps, own, once, square, cube
):
    """Adds light to a row of histogram (…, T), photons; returns what is outside of it.

    level : of the 4^level equal parts of a triangle that it is spread over. time, at : times at the corners by way of
    the middle of the cluster, bins, which are changed, and weights there, in the order of `PLACES`. change : (4,) of
    times, bins, and of weights, relative to their mean, along both sides of the cluster. shift : light is spread over
    the cluster by steps of 2^−shift bins. steps, own, once : of `reserved`, zero before and after. square, cube :
    (CORNERS[-1],).

    The times of a flat cluster are those of two boxes, one after the other, and its weights a product of those along
    its two sides. To spread over a box is to sum over neighbouring bins: elements that fit together still do.
    """
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
    more = _tilted(level, at) if tie > TIED else 0.0
    m1, end1, tilt1 = _box(wide1, math.copysign(change[2], change[0] * change[2]))
    m2, end2, tilt2 = _box(wide2, math.copysign(change[3], change[1] * change[3]))
    # Light before the window or after it may be spread into it.
    reach, T = m1 + m2 + 2, histogram.shape[1] << shift
    bins = T + 2 * reach
    first, last = fine * first + reach - tie, fine * last + reach + tie
    if not (last > 0.0 and first < bins):
        return light
    for v in range(n):
        time[v] = fine * time[v] + tie * (0.5 * (PLACES[v, 0] - PLACES[v, 1]) - more) + reach
    scale, inside = light / _set_knots(level, at, time, square, cube), 0.0
    for v in range(n):
        if time[v] < bins:
            _add_steps(time[v], square[v], cube[v], steps)
    begin, end = np.uint64(max(first, 0.0)), np.uint64(min(last, bins - 1.0))
    late, by, row = np.uint64(2 * reach), np.uint64(shift), np.uint64(row)
    stop = min(end + late, np.uint64(bins - 1)) + np.uint64(1)
    scale /= (2.0 * m1 + 1.0 + 2.0 * end1) * (2.0 * m2 + 1.0 + 2.0 * end2)
    lean1, lean2 = (m1 + 1) * tilt1 * end1, (m2 + 1) * tilt2 * end2
    a1, b1, a2, b2 = end1 - lean1, end1 + lean1, end2 - lean2, end2 + lean2
    s1 = s2 = s3 = 0.0
    if m1 + m2 == 0:
        # Of two boxes of three bins each five are left, of the newest light and that of four bins before.
        c0, c1, c2, c3, c4 = (
            scale * a1 * a2, scale * (a1 + a2), scale * (1.0 + a1 * b2 + b1 * a2), scale * (b1 + b2), scale * b1 * b2,
        )  # fmt: skip
        v1 = v2 = v3 = v4 = 0.0
        for i in range(begin, stop):
            v0 = 0.0
            if i <= end:
                s1 += steps[i]
                s2 += s1
                s3 += s2
                steps[i] = 0.0
                v0 = max(s3, 0.0)
            if i >= late:
                here = max(c0 * v0 + c1 * v1 + c2 * v2 + c3 * v3 + c4 * v4, 0.0)
                inside += here
                histogram[row, (i - late) >> by] += here
            v1, v2, v3, v4 = v0, v1, v2, v3
    else:
        k1, k2 = np.uint64(2 * m1 + 2), np.uint64(2 * m2 + 2)
        for i in range(begin, end + np.uint64(1)):
            s1 += steps[i]
            s2 += s1
            s3 += s2
            steps[i] = 0.0
            own[i + late] = max(s3, 0.0)
        # `once` is m1 + 1 bins later than `own`, and what is spread twice m2 + 1 bins later than that. Of neighbours
        # s is the sum, and t that of each times how much later it becomes.
        s1 = s2 = t1 = t2 = 0.0
        for i in range(begin, stop):
            k = i + late
            new, old = own[k - np.uint64(1)], own[k - k1]
            t1 += s1 - (m1 + 1) * old - m1 * new
            s1 += new - old
            once[k] = s1 + tilt1 * t1 + a1 * own[k] + b1 * old
            new, old = once[k - np.uint64(1)], once[k - k2]
            t2 += s2 - (m2 + 1) * old - m2 * new
            s2 += new - old
            if i >= late:
                here = scale * max(s2 + tilt2 * t2 + a2 * once[k] + b2 * old, 0.0)
                inside += here
                histogram[row, (i - late) >> by] += here
        for i in range(begin, stop):
            own[i + late] = once[i + late] = 0.0
    for i in range(end + np.uint64(1), end + np.uint64(5)):
        steps[i] = 0.0
    return max(light - inside, 0.0) if first < 2 * reach or last >= T else 0.0
