"""Light of four bounces from pairs of cells: one that the laser point lights, and one that the pixel sees.

With the light aᵢ w₁(i) and aⱼ w₃(j) of `transfer.py`, cells i and j with their middles R apart,

    energy = w₁(i) aᵢ · f_i cosθ cosθ′ V / R² · f_j · w₃(j) a_j,        arriving at (R₁ + R + R₃)/c,

exact to second order in the cells' size over R, R₁ and R₃. Where that is too large for the pair's energy the larger
of the two is halved, again and again. The path is taken as linear over both cells, which gives its mean and variance;
its distribution, that of two triangles folded, is taken for a tent of the same.

A tent is three knots of a running integral of second degree, so its shares of all bins are nine numbers, added up
twice when all pairs are done.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from datagen.compiled import compiled
from datagen.records.arrays import Floats, Ints
from datagen.transport.brdf import LAMBERTIAN, dot, evaluate, evaluate_at_most
from datagen.transport.geometry import get, put, subtract, transmittance
from datagen.transport.quadrature.transfer import (
    ALONG,
    BACK,
    BLUR,
    CLUSTERED,
    ENERGY,
    LENGTH,
    LONG,
    NORMAL,
    SPAN,
    TURNED,
    WEIGHT,
    forget_halves,
    halves_of,
)
from datagen.transport.visibility.raycast import lifted_and_scaled

NARROWEST = 0.25
"""Half width of the narrowest tent, in bins."""
SHAPE = 0.1
"""L2 error of a tent that is many bins wide, relative to its norm."""
CLIPPED = 0.2
"""L2 error of a pair of which almost nothing faces each other, relative to what does."""
NEAREST = 2 / 9
"""Least square of the distance of a cluster from another cell, relative to that of its size: four times the variance
of its points, which is an 18th of that of its longest side's."""
TOO_NEAR = 8 / 9
"""The same, under which it is not known what a cluster gives to another cell: a ball on a floor lost a quarter of its
light and agreed with itself at each finer level. With half of it a fifth of the loss is known."""
DEEPEST = 64
"""Pairs that wait to be cut, at most."""
AT = 0
"""Where a pair's arrival begins in its row."""


class EndPairs(NamedTuple):
    """ends (n, 2) one that is lit and one that sees; gain (n,) photons for an energy of one; zero (n,) bins before
    those of the path between the ends; row (n,) the histogram of each."""

    ends: Ints
    gain: Floats
    zero: Floats
    row: Ints


class Rules(NamedTuple):
    """How elements are joined.

    Attributes
    ----------
    same : whether the two ends of each pair are one.
    allowed : L2 error that a pair of elements may make, for a gain of one.
    most_looked_at : pairs of elements after which `join` stops, as it does where there is no more room.
    attenuation, per_metre : 1/m, and bins for each metre of path.
    offset, frame : by how much ends of rays are lifted, metres, and embree's frame.
    """

    same: bool
    allowed: float
    most_looked_at: int
    attenuation: float
    per_metre: float
    offset: float
    frame: Floats


class Found(NamedTuple):
    """Pairs of elements: arrival (n, 3) when, in bins, its variance, bins², and photons; row (n,) histogram; origin
    and span (n, 3) of the ray between the elements, in embree's frame."""

    arrival: Floats
    row: Ints
    origin: NDArray[np.float32]
    span: NDArray[np.float32]

    @classmethod
    def room(cls, count: int) -> Found:
        """Room for so many pairs."""
        rays = np.empty((2, count, 3), np.float32)
        return cls(np.empty((count, 3)), np.empty(count, np.int64), rays[0], rays[1])


@compiled()
def _joined(one, i, two, j, parts, optics):  # type: ignore[no-untyped-def]
    """Energy of a pair of cells if nothing hides them from each other, the most that their lobes allow, their
    distance, the path's mean and variance, the share of them that face each other, and the middles of what does.

    With C = Σ p pᵀ the covariance of a cell's points, the mean over them of cosθ cosθ′/R² is 1 + Σ p·H·p/2 of that at
    their middles, H the matrix of its second derivatives, relative to it; and the mean path is longer by that of R,
    and by what it and the light have in common.
    """
    (part1, part2), kind, values = parts, optics.kind, optics.values
    n1, n2 = get(one, i, NORMAL), get(two, j, NORMAL)
    y1, y2, share = _facing(one, i, two, j)
    d = subtract(y2, y1)
    square = dot(d, d)
    r = math.sqrt(square)
    per = 1.0 / r if r > 0.0 else 0.0
    up, down = dot(d, n1), -dot(d, n2)
    if one[i, CLUSTERED] > 0.0:
        up = r * _positive(per * up, one[i, TURNED], two, j, per, n1)
    if two[j, CLUSTERED] > 0.0:
        down = r * _positive(per * down, two[j, TURNED], one, i, per, n2)
    if not share > 0.0 or up <= 0.0 or down <= 0.0:
        return 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, y1, y2
    w, back = (d[0] * per, d[1] * per, d[2] * per), (-d[0] * per, -d[1] * per, -d[2] * per)
    f1 = evaluate(kind[part1], values[part1], n1, get(one, i, BACK), w)
    f2 = evaluate(kind[part2], values[part2], n2, back, get(two, j, BACK))
    f_most = f1 * f2
    if kind[part1] != LAMBERTIAN or kind[part2] != LAMBERTIAN:
        # Directions turn over both cells, and from each to its own end.
        turn = (one[i, LONG] + two[j, LONG]) * per
        turn1, turn2 = turn + one[i, LONG] / one[i, LENGTH], turn + two[j, LONG] / two[j, LENGTH]
        f_most = max(f_most, evaluate_at_most(
            kind[part1], values[part1], n1, get(one, i, BACK), w, turn1, 0.0
        ) * evaluate_at_most(kind[part2], values[part2], n2, back, get(two, j, BACK), turn2, 0.0))  # fmt: skip
    variance, more, turned, shift = one[i, BLUR] + two[j, BLUR], 0.0, 0.0, 0.0
    path = one[i, LENGTH] + r + two[j, LENGTH]
    for k in range(2):
        p, q = get(one, i, SPAN + 3 * k), get(two, j, SPAN + 3 * k)
        along_p, along_q = dot(w, p), dot(w, q)
        # By how much the path, and the two cosines, change along them.
        longer_p, longer_q = one[i, ALONG + k] - along_p, two[j, ALONG + k] + along_q
        by_p, by_q = up * dot(n2, p), down * dot(n1, q)
        sizes = dot(p, p) + dot(q, q)
        variance += longer_p * longer_p + longer_q * longer_q
        shift += by_p * longer_p + by_q * longer_q + 4.0 * up * down * per * (along_p * longer_p - along_q * longer_q)
        path += 0.5 * per * (sizes - along_p * along_p - along_q * along_q)
        more += 12.0 * per * per * (along_p * along_p + along_q * along_q) - 2.0 * per * per * sizes
        turned += 4.0 * per * (by_p * along_p - by_q * along_q)
    # Where cells are as large as their distance the series says nothing: what it adds is held to bounds.
    whole = up * down * (1.0 + min(more, 1.0) if more > 0.0 else 1.0 / (1.0 - more))
    whole = max(whole + turned, 0.25 * whole)
    farthest = math.sqrt(variance)
    path += min(max(shift / whole, -farthest), farthest)
    # Clusters are not halved, and their middles may meet; their points are apart from each other all the same.
    apart = _of_clusters(one, i, two, j)
    per = min(per, 1.0 / math.sqrt(NEAREST * apart)) if apart > 0.0 else per
    all_but_f = share * one[i, ENERGY] * two[j, ENERGY] * whole * (per * per) * (per * per)
    return all_but_f * f1 * f2, all_but_f * f_most, r, path, variance, share, y1, y2


@compiled()
def _of_clusters(one, i, two, j):  # type: ignore[no-untyped-def]
    """Square of the size of those of two cells that are clusters."""
    return one[i, CLUSTERED] * one[i, LONG] * one[i, LONG] + two[j, CLUSTERED] * two[j, LONG] * two[j, LONG]


@compiled()
def _too_near(one, i, two, j, r):  # type: ignore[no-untyped-def]
    """1 where a cluster is `TOO_NEAR` to another cell, else 0."""
    return 1.0 if r * r < TOO_NEAR * _of_clusters(one, i, two, j) else 0.0


@compiled()
def _positive(cosine, turned, other, k, per, n):  # type: ignore[no-untyped-def]
    """Mean of the positive part of the cosine between a cluster's normals, whose mean is n, and the directions to
    another cell's points: taken as evenly spread with the variance of both."""
    p, q = dot(n, get(other, k, SPAN)), dot(n, get(other, k, SPAN + 3))
    most = math.sqrt(3.0 * (turned * max(1.0 - cosine * cosine, 0.0) + per * per * (p * p + q * q)))
    if cosine >= most:
        return cosine
    return (cosine + most) * (cosine + most) / (4.0 * most) if cosine > -most else 0.0


@compiled(forceinline=True)
def _facing(one, i, two, j):  # type: ignore[no-untyped-def]
    """Middles of what each of two cells has above the other's plane, and the share of the two that this is.

    A cell's points are taken as evenly spread over as many heights as have their variance.
    """
    y1, y2 = get(one, i, 0), get(two, j, 0)
    n1, n2 = get(one, i, NORMAL), get(two, j, NORMAL)
    d = subtract(y2, y1)
    up, down = dot(d, n1), -dot(d, n2)
    p, q, s, t = get(one, i, SPAN), get(one, i, SPAN + 3), get(two, j, SPAN), get(two, j, SPAN + 3)
    along_p, along_q, along_s, along_t = dot(n2, p), dot(n2, q), dot(n1, s), dot(n1, t)
    square1, square2 = along_p * along_p + along_q * along_q, along_s * along_s + along_t * along_t
    share = 1.0
    # A cluster has no plane: `_positive` counts what faces of it.
    if two[j, CLUSTERED] == 0.0 and (down * down < 3.0 * square1 or down < 0.0):
        most = math.sqrt(3.0 * square1)
        share = 0.5 * (down + most) / most if square1 > 0.0 else 0.0
        by = 0.5 * (most - down) / square1 if share > 0.0 else 0.0
        along_p, along_q = by * along_p, by * along_q
        y1 = (
            y1[0] + along_p * p[0] + along_q * q[0], y1[1] + along_p * p[1] + along_q * q[1],
            y1[2] + along_p * p[2] + along_q * q[2],
        )  # fmt: skip
    if one[i, CLUSTERED] == 0.0 and (up * up < 3.0 * square2 or up < 0.0):
        most = math.sqrt(3.0 * square2)
        share *= 0.5 * (up + most) / most if square2 > 0.0 and up > -most else 0.0
        by = 0.5 * (most - up) / square2 if share > 0.0 else 0.0
        along_s, along_t = by * along_s, by * along_t
        y2 = (
            y2[0] + along_s * s[0] + along_t * t[0], y2[1] + along_s * s[1] + along_t * t[1],
            y2[2] + along_s * s[2] + along_t * t[2],
        )  # fmt: skip
    return y1, y2, share


@compiled()
def _error(one, i, two, j, most, keen, r, variance, share, haze):  # type: ignore[no-untyped-def]
    """L2 error that a pair of cells may make, of at most so much energy; variance in bins², haze what air takes in a
    bin, keen 1/width² of the narrower of their lobes: never more than all of the energy."""
    h1, h2 = one[i, LONG], two[j, LONG]
    size = (h1 + h2) / r
    near1, near2 = h1 / one[i, LENGTH], h2 / two[j, LENGTH]
    across = size * size + near1 * near1 + near2 * near2
    wrong = (
        min(keen * across, max(across, 1.0))
        + SHAPE * min(variance, 1.0)
        + CLIPPED * (1.0 - share)
        + haze * haze * variance
    )
    return most * wrong / math.sqrt(math.sqrt(1.0 + 24.0 * variance))


@compiled()
def _which(one, i, two, j):  # type: ignore[no-untyped-def]
    """Which of two cells to halve: 1 or 2, the larger one; 0 for neither, for clusters are not halved, nor is what is
    much smaller than a cluster before it."""
    h1, h2 = one[i, LONG], two[j, LONG]
    if one[i, CLUSTERED] > 0.0:
        return 2 if two[j, CLUSTERED] == 0.0 and 2.0 * h2 > h1 else 0
    if two[j, CLUSTERED] > 0.0:
        return 1 if 2.0 * h1 > h2 else 0
    return 1 if h1 >= h2 else 2


@compiled()
def _ray_from(elements, k, turn, y, other):  # type: ignore[no-untyped-def]
    """Where the ray from an element to the middle of another leaves it, and the normal there: the middle y of a
    triangle, and of a cluster one of its points in turn, for its middle may lie inside of a solid."""
    if elements.known[k, CLUSTERED] == 0.0:
        return y, get(elements.known, k, NORMAL)
    for j in range(3):
        at = 3 * ((turn + j) % 3)
        z, n = get(elements.corner, k, at), get(elements.corner, k, WEIGHT + at)
        if dot(subtract(other, z), n) > 0.0:
            return z, n
    return y, get(elements.known, k, NORMAL)


@compiled(_nrt=False)
def join(begin, pairs, lit, ones, seen, twos, optics, rules, found, waiting):  # type: ignore[no-untyped-def]
    """Write into `found` the pairs of elements of ends that are lit and ends that see, while there is room.

    begin : pair of ends and its two elements to go on from, elements −1 for the first of all.
    Returns where it stopped, which is behind the last pair of ends if all are done, how many pairs of elements were
    found and how many were looked at to find them, and photons of clusters `TOO_NEAR` to the other element.
    """
    count, looked_at, near, room = 0, 0, 0.0, len(found.row)
    haze, per_square = rules.attenuation / rules.per_metre, rules.per_metre * rules.per_metre
    for k in range(begin[0], len(pairs.ends)):
        p, q = pairs.ends[k, 0], pairs.ends[k, 1]
        again = k == begin[0] and begin[1] >= 0
        for i in range(begin[1] if again else ones.first[p], ones.first[p + 1]):
            a = ones.part[i]
            again = k == begin[0] and i == begin[1]
            # The two ends are one: each pair stands for itself and its reverse.
            from_ = i + 1 if rules.same else twos.first[q]
            for j in range(begin[2] if again else from_, twos.first[q + 1]):
                # Half of the room is for what this pair alone may be cut into.
                if 2 * count > room or looked_at > rules.most_looked_at:
                    return (k, i, j), count, looked_at, near
                forget_halves(ones)
                forget_halves(twos)
                b = twos.part[j]
                keen = max(optics.sharp[a], optics.sharp[b])
                waiting[0, 0], waiting[0, 1], top = i, j, 1
                while top > 0:
                    top -= 1
                    one, two = waiting[top, 0], waiting[top, 1]
                    looked_at += 1
                    energy, most, r, path, variance, share, y1, y2 = _joined(
                        ones.known, one, twos.known, two, (a, b), optics
                    )
                    if not most > 0.0:
                        continue
                    left = transmittance(rules.attenuation, path)
                    energy, most, variance = energy * left, most * left, variance * per_square
                    larger = _which(ones.known, one, twos.known, two)
                    if (
                        larger > 0
                        and top + 2 <= len(waiting)
                        and count + top + 2 < room
                        and _error(ones.known, one, twos.known, two, most, keen, r, variance, share, haze)
                        > rules.allowed
                    ):
                        # Halves are made once and serve all pairs that want to be as fine there.
                        if larger == 1:
                            half = halves_of(ones, one, p, lit, optics)
                        else:
                            half = halves_of(twos, two, q, seen, optics)
                        if half >= 0:
                            for h in range(2):
                                waiting[top + h, 0] = half + h if larger == 1 else one
                                waiting[top + h, 1] = two if larger == 1 else half + h
                            top += 2
                            continue
                    if energy > 0.0:
                        near += energy * pairs.gain[k] * _too_near(ones.known, one, twos.known, two, r)
                        z1, n1 = _ray_from(ones, one, j, y1, y2)
                        z2, n2 = _ray_from(twos, two, i, y2, z1)
                        arrival = (path * rules.per_metre - pairs.zero[k], variance, energy * pairs.gain[k])
                        _note(found, count, pairs.row[k], arrival, z1, n1, z2, n2, rules)
                        count += 1
    return (len(pairs.ends), -1, -1), count, looked_at, near


@compiled()
def _note(found, k, row, arrival, y1, n1, y2, n2, rules):  # type: ignore[no-untyped-def]
    """Write down pair k: its histogram, when and how its light arrives, and the ray between its elements."""
    found.row[k] = row
    put(found.arrival, k, AT, arrival)
    a, b = lifted_and_scaled(y1, n1, rules.offset, rules.frame), lifted_and_scaled(y2, n2, rules.offset, rules.frame)
    for axis in range(3):
        found.origin[k, axis], found.span[k, axis] = a[axis], b[axis] - a[axis]


@compiled()
def arrive(found, count, hidden, knots, photons):  # type: ignore[no-untyped-def]
    """Add the tents of the first `count` pairs found, but for those that something hides from each other.

    knots : (n, T + 3) second differences of the histograms, and what the last two bins beyond need.
    photons : (n,) all photons, inside the window and outside.
    """
    for k in range(count):
        if hidden[k]:
            continue
        row, (at, variance, energy) = found.row[k], get(found.arrival, k, AT)
        # The tent with this variance; no narrower, for its height would then depend on where in a bin it falls.
        wide = max(math.sqrt(6.0 * variance), NARROWEST)
        weight = energy / (wide * wide)
        photons[row] += energy
        _knot(knots, row, at - wide, weight)
        _knot(knots, row, at, -2.0 * weight)
        _knot(knots, row, at + wide, weight)


@compiled()
def _knot(knots, row, at, weight):  # type: ignore[no-untyped-def]
    """Add a knot: what has come by time x > at grows as weight (x − at)²/2."""
    last = knots.shape[1] - 3
    if at < 0.0:
        knots[row, 0] += weight * (0.5 - at)
        knots[row, 1] += weight * (0.5 + at)
    elif at < last:
        m = int(at)
        f = at - m
        knots[row, m] += weight * 0.5 * (1.0 - f) * (1.0 - f)
        knots[row, m + 1] += weight * (0.5 + f - f * f)
        knots[row, m + 2] += weight * 0.5 * f * f
