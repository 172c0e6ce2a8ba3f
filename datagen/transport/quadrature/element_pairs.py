"""Light of four bounces from pairs of surface elements: one that the laser point lights, one that the pixel sees.

With the light aᵢ w₁(i) and aⱼ w₃(j) of `transfer.py` and the mean positions of elements i and j at a distance R,

    energy = w₁(i) aᵢ · f_i cosθ cosθ′ V / R² · f_j · w₃(j) a_j,        arriving at (R₁ + R + R₃)/c,

exact to second order in the elements' size over R, R₁ and R₃. Where the remaining error is too large, the larger
element of the pair is halved, again and again. The path is taken as linear over both elements, which gives its mean
and its variance; the distribution of arrival times is replaced by a tent (a symmetric triangle) of the same mean and
variance.

The second derivative of a tent is three spikes (knots), so a tent adds nine numbers to a histogram of second
differences; two running sums give the histogram once all pairs are added.
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
"""Half width of the narrowest tent, in bins. Half of it makes a tent's share of its bins depend on where it falls."""
SHAPE = 0.1
"""L2 error of replacing the distribution of arrival times by a tent many bins wide, relative to the tent's norm. Half
of it halves fewer pairs whose light is spread widely."""
CLIPPED = 0.2
"""L2 error of a pair of elements of which almost no part faces each other, relative to the light of the part that
does. Half of it halves fewer elements that cross the other's plane."""
NEAREST = 2 / 9
"""Least squared distance between a cluster and another element, relative to the square of the cluster's size `LONG`:
four times the variance of the cluster's points, which is `LONG`²/18. With half of it, clusters that touch an element
give it too much light."""
FLAT = 1e-9
"""Height of a triangle above the plane of another, relative to the larger one's size, that is taken for rounding.
Half of it changes nothing: positions are rounded to 1e-16 m."""
TOO_NEAR = 8 / 9
"""The same ratio, below which the light between a cluster and another element is claimed as unknown: a ball on a
floor lost a quarter of its light, and all refinement levels agreed on that. With half of it, only a fifth of that
loss is claimed."""
DEEPEST = 64
"""Most pairs of elements on the stack. With half as many, the deepest pairs are taken as they are."""
AT = 0
"""First column of an arrival in its row of `Found.arrival`."""


class EndPairs(NamedTuple):
    """n pairs of a lit end and a seeing end.

    Attributes
    ----------
    ends : (n, 2) indices of the lit end and of the seeing end.
    gain : (n,) photons for an energy of one.
    zero : (n,) start of the window, in bins after a path of zero length between the ends.
    row : (n,) row of the histogram that the pair's light is added to.
    """

    ends: Ints
    gain: Floats
    zero: Floats
    row: Ints


class Rules(NamedTuple):
    """How elements are joined.

    Attributes
    ----------
    same : whether the two ends of each pair are the same point, seen from the same direction.
    allowed : L2 error that a pair of elements may make, for a gain of one.
    most_looked_at : number of pairs of elements after which `join` stops; it also stops when `Found` is full.
    attenuation : attenuation of the air, 1/m.
    per_metre : bins for each metre of path.
    offset : distance by which the ends of rays are lifted off their surfaces, metres.
    frame : (4,) centre and half extent of the scene; embree works in coordinates relative to these.
    """

    same: bool
    allowed: float
    most_looked_at: int
    attenuation: float
    per_metre: float
    offset: float
    frame: Floats


class Found(NamedTuple):
    """Pairs of elements that `join` has made.

    Attributes
    ----------
    arrival : (n, 3) mean arrival time in bins, its variance in bins², and photons.
    row : (n,) row of the histogram.
    origin, span : (n, 3) start of the shadow ray between the elements, and vector to its end, in embree's frame.
    """

    arrival: Floats
    row: Ints
    origin: NDArray[np.float32]
    span: NDArray[np.float32]

    @classmethod
    def room(cls, count: int) -> Found:
        """Uninitialised arrays for `count` pairs."""
        rays = np.empty((2, count, 3), np.float32)
        return cls(np.empty((count, 3)), np.empty(count, np.int64), rays[0], rays[1])


@compiled()
def _joined(one, i, two, j, parts, optics):  # type: ignore[no-untyped-def]
    """Energy of a pair of elements without occlusion, upper bound of that energy for any direction of their lobes,
    distance, mean and variance of the path, share of the pair that faces each other, and the mean position of that
    share on each element.

    Means over the elements are second-order series. With C = Σ p pᵀ the covariance of an element's points, the mean
    of cosθ cosθ′/R² is its value at the mean positions times 1 + Σ p·H·p/2, where H is the matrix of its second
    derivatives relative to that value. The mean path gains the same term of R, and the covariance of path and light.
    """
    (part1, part2), kind, values = parts, optics.kind, optics.values
    n1, n2 = get(one, i, NORMAL), get(two, j, NORMAL)
    # What lies behind the other's plane gives no light, so the series is about the rest of each element.
    y1, y2, share = _facing(one, i, two, j)
    d = subtract(y2, y1)
    square = dot(d, d)
    r = math.sqrt(square)
    # Mean positions of clusters may coincide.
    per = 1.0 / r if r > 0.0 else 0.0
    up, down = dot(d, n1), -dot(d, n2)
    # A cluster has many normals: the mean of the positive cosines is not the positive cosine of the mean.
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
        # A lobe may point at any direction between the elements, so its peak within that range bounds the energy.
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
        # Changes of the path and of the two cosines along p and q.
        longer_p, longer_q = one[i, ALONG + k] - along_p, two[j, ALONG + k] + along_q
        by_p, by_q = up * dot(n2, p), down * dot(n1, q)
        sizes = dot(p, p) + dot(q, q)
        # Variances of independent directions add up; `shift` is the covariance of path and light.
        variance += longer_p * longer_p + longer_q * longer_q
        shift += by_p * longer_p + by_q * longer_q + 4.0 * up * down * per * (along_p * longer_p - along_q * longer_q)
        path += 0.5 * per * (sizes - along_p * along_p - along_q * along_q)
        more += 12.0 * per * per * (along_p * along_p + along_q * along_q) - 2.0 * per * per * sizes
        turned += 4.0 * per * (by_p * along_p - by_q * along_q)
    # Where elements are as large as their distance the series diverges: its terms are bounded, so that such pairs
    # stay positive and finite until they are halved.
    whole = up * down * (1.0 + min(more, 1.0) if more > 0.0 else 1.0 / (1.0 - more))
    whole = max(whole + turned, 0.25 * whole)
    farthest = math.sqrt(variance)
    path += min(max(shift / whole, -farthest), farthest)
    # Clusters are not halved, and their mean positions may meet, though their points are apart: 1/R² is bounded.
    apart = _of_clusters(one, i, two, j)
    per = min(per, 1.0 / math.sqrt(NEAREST * apart)) if apart > 0.0 else per
    all_but_f = share * one[i, ENERGY] * two[j, ENERGY] * whole * (per * per) * (per * per)
    return all_but_f * f1 * f2, all_but_f * f_most, r, path, variance, share, y1, y2


@compiled()
def _of_clusters(one, i, two, j):  # type: ignore[no-untyped-def]
    """Sum of the squared sizes, m², of those of two elements that are clusters; 0 for two triangles."""
    return one[i, CLUSTERED] * one[i, LONG] * one[i, LONG] + two[j, CLUSTERED] * two[j, LONG] * two[j, LONG]


@compiled()
def _too_near(one, i, two, j, r):  # type: ignore[no-untyped-def]
    """1 if a cluster is `TOO_NEAR` to another element, else 0."""
    return 1.0 if r * r < TOO_NEAR * _of_clusters(one, i, two, j) else 0.0


@compiled()
def _positive(cosine, turned, other, k, per, n):  # type: ignore[no-untyped-def]
    """Mean of the positive part of the cosine between a cluster's normals, whose mean is n, and the directions to
    the points of another element. Cosines are taken as evenly distributed, with the variance of normals and
    points."""
    p, q = dot(n, get(other, k, SPAN)), dot(n, get(other, k, SPAN + 3))
    # An even distribution of variance v reaches √(3 v) to either side of its mean.
    most = math.sqrt(3.0 * (turned * max(1.0 - cosine * cosine, 0.0) + per * per * (p * p + q * q)))
    # All of it is positive, or none, or the part above zero: a triangle's integral.
    if cosine >= most:
        return cosine
    return (cosine + most) * (cosine + most) / (4.0 * most) if cosine > -most else 0.0


@compiled(forceinline=True)
def _facing(one, i, two, j):  # type: ignore[no-untyped-def]
    """Mean position of the part of each of two elements that lies above the other's plane, and the product of the
    fractions that these parts are.

    The heights of an element's points above the plane are taken as evenly distributed with their true variance.
    """
    y1, y2 = get(one, i, 0), get(two, j, 0)
    n1, n2 = get(one, i, NORMAL), get(two, j, NORMAL)
    d = subtract(y2, y1)
    up, down = dot(d, n1), -dot(d, n2)
    p, q, s, t = get(one, i, SPAN), get(one, i, SPAN + 3), get(two, j, SPAN), get(two, j, SPAN + 3)
    along_p, along_q, along_s, along_t = dot(n2, p), dot(n2, q), dot(n1, s), dot(n1, t)
    square1, square2 = along_p * along_p + along_q * along_q, along_s * along_s + along_t * along_t
    share = 1.0
    # A cluster has no plane: `_positive` accounts for the part of it that faces the other. Elements that lie above
    # the plane as a whole are left as they are.
    if two[j, CLUSTERED] == 0.0 and (down * down < 3.0 * square1 or down < 0.0):
        most = math.sqrt(3.0 * square1)
        share = 0.5 * (down + most) / most if square1 > 0.0 else 0.0
        # The mean of the heights above zero is higher than the mean of all: the position moves up by the difference.
        by = 0.5 * (most - down) / square1 if share > 0.0 else 0.0
        along_p, along_q = by * along_p, by * along_q
        y1 = (
            y1[0] + along_p * p[0] + along_q * q[0], y1[1] + along_p * p[1] + along_q * q[1],
            y1[2] + along_p * p[2] + along_q * q[2],
        )  # fmt: skip
    # The same for the second element and the first one's plane.
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
def _below(elements, k, others, m):  # type: ignore[no-untyped-def]
    """Whether no vertex of triangle k is above the plane of triangle m; false if one of them is a cluster.

    `_facing` knows the heights by their variance, and takes a triangle that touches the plane from below to reach
    above it: faces of a convex body that share an edge would light each other.
    """
    if elements.known[k, CLUSTERED] > 0.0 or others.known[m, CLUSTERED] > 0.0:
        return False
    n, y, highest = get(others.known, m, NORMAL), get(others.corner, m, 0), -np.inf
    for vertex in range(3):
        highest = max(highest, dot(subtract(get(elements.corner, k, 3 * vertex), y), n))
    return highest <= FLAT * max(elements.known[k, LONG], others.known[m, LONG])


@compiled()
def _error(one, i, two, j, most, sharpest, r, variance, share, haze):  # type: ignore[no-untyped-def]
    """Estimated L2 error of a pair of elements, in the units of `most`.

    most : upper bound of the pair's energy. sharpest : 1/width² of the narrower lobe. variance : of the path, bins².
    share : fraction of the pair that faces each other. haze : attenuation of the air for one bin of path.
    """
    # The series is of second order in each element's size over the distances to the other and to its own end.
    h1, h2 = one[i, LONG], two[j, LONG]
    size = (h1 + h2) / r
    near1, near2 = h1 / one[i, LENGTH], h2 / two[j, LENGTH]
    across = size * size + near1 * near1 + near2 * near2
    # A lobe narrower than the element multiplies the error, but not beyond all of the energy.
    wrong = (
        min(sharpest * across, max(across, 1.0))
        + SHAPE * min(variance, 1.0)
        + CLIPPED * (1.0 - share)
        + haze * haze * variance
    )
    # Light spread over many bins has a smaller norm than in one bin: by the fourth root of the variance.
    return most * wrong / math.sqrt(math.sqrt(1.0 + 24.0 * variance))


@compiled()
def _which(one, i, two, j):  # type: ignore[no-untyped-def]
    """Which of two elements to halve: 1 or 2 for the larger one, 0 for neither. Clusters are not halved, nor are
    elements much smaller than the cluster that they face."""
    h1, h2 = one[i, LONG], two[j, LONG]
    # Beside a cluster, halving a triangle below half the cluster's size does not make the pair more exact.
    if one[i, CLUSTERED] > 0.0:
        return 2 if two[j, CLUSTERED] == 0.0 and 2.0 * h2 > h1 else 0
    if two[j, CLUSTERED] > 0.0:
        return 1 if 2.0 * h1 > h2 else 0
    return 1 if h1 >= h2 else 2


@compiled()
def _ray_from(elements, k, turn, y, other):  # type: ignore[no-untyped-def]
    """Point of element k at which the shadow ray to point `other` starts, and the normal there: the mean position y
    for a triangle, one of the three stored points for a cluster, whose mean position may lie inside a solid."""
    if elements.known[k, CLUSTERED] == 0.0:
        return y, get(elements.known, k, NORMAL)
    # The points take turns, so that a cluster's many rays sample it; those that face away are skipped.
    for j in range(3):
        at = 3 * ((turn + j) % 3)
        z, n = get(elements.corner, k, at), get(elements.corner, k, WEIGHT + at)
        if dot(subtract(other, z), n) > 0.0:
            return z, n
    return y, get(elements.known, k, NORMAL)


@compiled(_nrt=False)
def join(begin, pairs, lit, ones, seen, twos, optics, rules, found, waiting):  # type: ignore[no-untyped-def]
    """Write pairs of elements, one of a lit end and one of a seeing end, into `found` while there is room.

    Returns where to go on, which is behind the last pair of ends if all are done; the number of pairs written; the
    number of pairs looked at for them; and photons of clusters `TOO_NEAR` to the other element.

    begin : index of the pair of ends, and of its two elements, to go on from; elements are −1 at the start.
    waiting : (DEEPEST + 2, 2) memory for the stack of pairs.
    """
    count, looked_at, near, room = 0, 0, 0.0, len(found.row)
    haze, per_square = rules.attenuation / rules.per_metre, rules.per_metre * rules.per_metre
    for k in range(begin[0], len(pairs.ends)):
        p, q = pairs.ends[k, 0], pairs.ends[k, 1]
        # Only the first pair of ends and its first element go on where the call before stopped.
        again = k == begin[0] and begin[1] >= 0
        for i in range(begin[1] if again else ones.first[p], ones.first[p + 1]):
            a = ones.part[i]
            again = k == begin[0] and i == begin[1]
            # Where the two ends are one, a pair of elements and its reverse are the same light: one stands for both.
            from_ = i + 1 if rules.same else twos.first[q]
            for j in range(begin[2] if again else from_, twos.first[q + 1]):
                # The other half of the room is for the pairs that this one pair may be divided into.
                if 2 * count > room or looked_at > rules.most_looked_at:
                    return (k, i, j), count, looked_at, near
                # Between pairs no row of a half is in use.
                forget_halves(ones)
                forget_halves(twos)
                b = twos.part[j]
                sharpest = max(optics.sharp[a], optics.sharp[b])
                waiting[0, 0], waiting[0, 1], top = i, j, 1
                while top > 0:
                    top -= 1
                    one, two = waiting[top, 0], waiting[top, 1]
                    looked_at += 1
                    energy, most, r, path, variance, share, y1, y2 = _joined(
                        ones.known, one, twos.known, two, (a, b), optics
                    )
                    # Elements that face away from each other exchange no light.
                    if not most > 0.0 or (
                        share < 1.0 and (_below(ones, one, twos, two) or _below(twos, two, ones, one))
                    ):
                        continue
                    left = transmittance(rules.attenuation, path)
                    energy, most, variance = energy * left, most * left, variance * per_square
                    larger = _which(ones.known, one, twos.known, two)
                    if (
                        larger > 0
                        and top + 2 <= len(waiting)
                        and count + top + 2 < room
                        and _error(ones.known, one, twos.known, two, most, sharpest, r, variance, share, haze)
                        > rules.allowed
                    ):
                        # Halves are computed once and serve all pairs that are as fine there.
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
                    # A pair that is fine enough, or that there is no room to divide: its light is taken as it is, and
                    # the shadow ray is cast later, together with many others.
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
    """Write row k of `found`: the histogram, the arrival, and the shadow ray from y1 to y2."""
    found.row[k] = row
    put(found.arrival, k, AT, arrival)
    # Both ends are lifted off their surfaces, which would else hide the ray in single precision.
    a, b = lifted_and_scaled(y1, n1, rules.offset, rules.frame), lifted_and_scaled(y2, n2, rules.offset, rules.frame)
    for axis in range(3):
        found.origin[k, axis], found.span[k, axis] = a[axis], b[axis] - a[axis]


@compiled()
def arrive(found, count, hidden, knots, photons):  # type: ignore[no-untyped-def]
    """Add the tents of the first `count` pairs of `found`, except those that are `hidden` (count,), to the
    histograms.

    knots : (n, T + 3) second differences of the histograms; the last three columns take knots in the last bins.
    photons : (n,) all photons, inside the window and outside.
    """
    for k in range(count):
        if hidden[k]:
            continue
        row, (at, variance, energy) = found.row[k], get(found.arrival, k, AT)
        # A tent of half width h has the variance h²/6; narrower ones would depend on where in a bin they fall.
        wide = max(math.sqrt(6.0 * variance), NARROWEST)
        weight = energy / (wide * wide)
        photons[row] += energy
        # The slope of a tent changes three times: at its start, its top and its end.
        _knot(knots, row, at - wide, weight)
        _knot(knots, row, at, -2.0 * weight)
        _knot(knots, row, at + wide, weight)


@compiled()
def _knot(knots, row, at, weight):  # type: ignore[no-untyped-def]
    """Add a knot to histogram `row`: from time `at` (in bins) on, the light that has arrived by time x grows by
    weight (x − at)²/2."""
    last = knots.shape[1] - 3
    # Before the window: the same parabola, as it continues from the first edge on.
    if at < 0.0:
        knots[row, 0] += weight * (0.5 - at)
        knots[row, 1] += weight * (0.5 + at)
    elif at < last:
        # Second differences, at bin edges, of that parabola: three bins, whose shares add up to `weight`.
        m = int(at)
        f = at - m
        knots[row, m] += weight * 0.5 * (1.0 - f) * (1.0 - f)
        knots[row, m + 1] += weight * (0.5 + f - f * f)
        knots[row, m + 2] += weight * 0.5 * f * f
