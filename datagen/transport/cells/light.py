"""The primary of one laser point and pixel: surfaces cut into cells, each of them spread over its arrival times.

Flux per hidden area at y, with x the laser point and z the middle of a patch of the pixel (docs/physics.md):

    w(y) = f₁ cosθ₁ cosθ₂ / R₁²  ·  f₂  ·  cosθ₂′ cosθ₃ / (R₂² + a/π)  ·  f₃ W,     arriving at (R₁ + R₂)/c,

a the patch's area, which bounds what a near cell can give it, and W the sensor's share. A cell is a triangle. Its
energy is exact for weights of second degree (three quarters of the middle and a quarter of the vertices), its weights
are taken as linear and its arrival times too, moved so that their mean is that of second degree.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from datagen.records.arrays import Floats, Ints
from datagen.transport.binning import put
from datagen.transport.brdf import dot, evaluate
from datagen.transport.cells.arrival import spread, widened
from datagen.transport.cells.occlusion import clear, cross, hidden, less, shaded
from datagen.transport.sampling import mix

COARSEST = 0.8
"""Largest cell or patch, relative to its distance."""
PARTLY, UNFOUND = 0.5, 0.05
"""Error of a cell that is partly seen, and of one of which three rays found nothing, relative to its light."""
SMEARED = 0.3
"""Of a patch, the share that its arrival times spread over."""
UNLIKE = 0.05
"""Error of a patch's arrival times, relative to its light, if they are known by their mean and variance alone."""
AT_ONCE = 0.01
"""Size of a patch, in bins, up to which all of it is reached at once."""
SMALLEST = 1e-8
"""Smallest cell that is cut, relative to the scene."""
FEWEST = 1 / 256
"""Light of a part that one quarter of a pixel may stand for at most, relative to what all of it might bring."""
BOX, CELL, CLEAR = 0, 1, 2
"""What waits to be looked at: a box, a cell, a cell of which nothing is hidden."""
CLUSTER = 4
"""Triangles of a box up to which each is a cell of its own; not below `hierarchy.LEAF`."""


class Lasers(NamedTuple):
    """Laser points as the loop wants them; the fields of `LaserPoints`, and `power` (L,), what arrives there."""

    position: Floats
    normal: Floats
    to_laser: Floats
    part: Ints
    power: Floats
    leg: Floats


class Cutting(NamedTuple):
    """How finely to cut.

    Attributes
    ----------
    error : (K,) L2 error in a histogram, in photons, up to which a cell of each part is left as it is.
    coarsest : (K,) largest cell of each part, relative to its distance.
    peak : (K,) largest value of each part's BRDF, 1/sr.
    rays_on_last_leg : whether it is asked what stands between a cell and the pixel.
    proofs : whether rays are saved where it is proven that nothing can stand in their way.
    seed : of the points that stand for clusters of small triangles.
    """

    error: Floats
    coarsest: Floats
    peak: Floats
    rays_on_last_leg: bool
    proofs: bool
    seed: int


class Clock(NamedTuple):
    """Path to bins: at = path · per_metre − start; `device` whether the legs of laser and sensor count."""

    per_metre: float
    start: float
    device: bool
    attenuation: float


@njit(cache=True, error_model="numpy")
def _at(array, i):  # type: ignore[no-untyped-def]
    return (array[i, 0], array[i, 1], array[i, 2])


@njit(cache=True, error_model="numpy")
def _point(array, i, j):  # type: ignore[no-untyped-def]
    return (array[i, j, 0], array[i, j, 1], array[i, j, 2])


@njit(cache=True, error_model="numpy")
def _weight(y, n, k, x, n1, to_laser, k1, z, n3, to_sensor, k3, kind, values, footprint):  # type: ignore[no-untyped-def]
    """w(y) but for power, sensor and air, and the path from laser point to patch."""
    d1, d3 = less(y, x), less(y, z)
    square1, square3 = dot(d1, d1), dot(d3, d3)
    r1, r3 = math.sqrt(square1), math.sqrt(square3)
    up1, up3 = dot(d1, n1), dot(d3, n3)
    in2, out2 = -dot(d1, n), -dot(d3, n)
    if up1 <= 0.0 or up3 <= 0.0 or in2 * out2 <= 0.0:
        return 0.0, r1 + r3
    if in2 < 0.0:
        n = (-n[0], -n[1], -n[2])
    w1, w3 = (d1[0] / r1, d1[1] / r1, d1[2] / r1), (d3[0] / r3, d3[1] / r3, d3[2] / r3)
    f1 = evaluate(kind[k1], values[k1], n1, to_laser, w1)
    f2 = evaluate(kind[k], values[k], n, (-w1[0], -w1[1], -w1[2]), (-w3[0], -w3[1], -w3[2]))
    f3 = evaluate(kind[k3], values[k3], n3, w3, to_sensor)
    w = f1 * f2 * f3 * up1 * in2 * out2 * up3 / (square1 * square1 * square3 * (square3 + footprint / math.pi))
    return w, r1 + r3


@njit(cache=True, error_model="numpy")
def _length(a):  # type: ignore[no-untyped-def]
    return math.sqrt(dot(a, a))


@njit(cache=True, error_model="numpy")
def _above(box, k, x, n):  # type: ignore[no-untyped-def]
    """How far the highest corner of a box lies above the plane through x with normal n."""
    height = 0.0
    for j in range(3):
        height += max(n[j] * (box[k, j] - x[j]), n[j] * (box[k, 3 + j] - x[j]))
    return height


@njit(cache=True)
def _push(tag, vertices, top, what, f, q, share, a, b, c):  # type: ignore[no-untyped-def]
    """A cell of triangle f for patch q, to be looked at next; returns how many wait."""
    tag[top, 0], tag[top, 1], tag[top, 2], vertices[top, 9] = what, f, q, share
    for j in range(3):
        vertices[top, j], vertices[top, 3 + j], vertices[top, 6 + j] = a[j], b[j], c[j]
    return top + 1


@njit(cache=True)
def _push_box(tag, vertices, top, at, q, share):  # type: ignore[no-untyped-def]
    tag[top, 0], tag[top, 1], tag[top, 2], vertices[top, 9] = BOX, at, q, share
    return top + 1


@njit(cache=True)
def _halve(tag, vertices, top, what, f, q, share, a, b, c):  # type: ignore[no-untyped-def]
    """The two halves of a cell, cut across its longest side."""
    long_ab, long_bc, long_ca = dot(less(b, a), less(b, a)), dot(less(c, b), less(c, b)), dot(less(a, c), less(a, c))
    if long_bc >= long_ca and long_bc > long_ab:
        a, b, c = b, c, a
    elif long_ca > long_ab:
        a, b, c = c, a, b
    half = _middle(a, b)
    top = _push(tag, vertices, top, what, f, q, share, a, half, c)
    return _push(tag, vertices, top, what, f, q, share, half, b, c)


@njit(cache=True)
def _middle(a, b):  # type: ignore[no-untyped-def]
    return (0.5 * (a[0] + b[0]), 0.5 * (a[1] + b[1]), 0.5 * (a[2] + b[2]))


@njit(cache=True)
def _digit(turn: int, share: float) -> int:
    """Of a number, to base 4, the digit after those that were used up to get to a share of 4^digits."""
    while share > 1.0:
        turn >>= 2
        share *= 0.25
    return turn & 3


@njit(cache=True)
def _anywhere(first, last, area_before, corners, word):  # type: ignore[no-untyped-def]
    """A point drawn uniformly on the triangles first … last, and which it lies on."""
    u = math.sqrt((np.float64(mix(word, np.uint64(1))) + 0.5) * 2.0**-32)
    v = (np.float64(mix(word, np.uint64(2))) + 0.5) * 2.0**-32
    wanted = area_before[first]
    wanted += (np.float64(word) + 0.5) * 2.0**-32 * (area_before[last] - area_before[first])
    low, high = first, last
    while high - low > 1:
        middle = (low + high) // 2
        if area_before[middle] <= wanted:
            low = middle
        else:
            high = middle
    return low, _on(corners, low, 1 - u, u * (1 - v), u * v)


@njit(cache=True, error_model="numpy")
def _on(corners, f, r, s, t):  # type: ignore[no-untyped-def]
    """The point of triangle f with barycentric coordinates r, s, t."""
    return (
        r * corners[f, 0, 0] + s * corners[f, 1, 0] + t * corners[f, 2, 0],
        r * corners[f, 0, 1] + s * corners[f, 1, 1] + t * corners[f, 2, 1],
        r * corners[f, 0, 2] + s * corners[f, 1, 2] + t * corners[f, 2, 2],
    )


@njit(cache=True)
def _seen(y, x, z, one_ray, f, obstacle, number, box, child, span, waiting):  # type: ignore[no-untyped-def]
    """Whether the laser point x lights y on triangle f and the patch at z sees it."""
    if hidden(x, y, f, obstacle, number, box, child, span, waiting) >= 0:
        return False
    return one_ray or hidden(z, y, f, obstacle, number, box, child, span, waiting) < 0


@njit(cache=True)
def _all_seen(x, a, b, c, z, one_ray, f, obstacle, number, box, child, span, flat, waiting):  # type: ignore[no-untyped-def]
    """Whether that is proven for all of the cell a, b, c."""
    if not clear(x, a, b, c, f, obstacle, number, box, child, span, flat, waiting):
        return False
    return one_ray or clear(z, a, b, c, f, obstacle, number, box, child, span, flat, waiting)


@njit(cache=True)
def _none_seen(x, a, b, c, z, one_ray, f, obstacle, number, box, child, span, waiting):  # type: ignore[no-untyped-def]
    """Whether it is proven that nothing of the cell a, b, c is lit by the laser point and seen by the patch."""
    if shaded(x, a, b, c, f, obstacle, number, box, child, span, waiting):
        return True
    return not one_ray and shaded(z, a, b, c, f, obstacle, number, box, child, span, waiting)


@njit(cache=True, error_model="numpy")
def gather(  # type: ignore[no-untyped-def]
    pairs, row, tree, occluders, lasers, patches, kind, values, cutting, clock, row_of_part, histogram, overflow
):  # fmt: skip
    """Add the primary of laser points and pixels to their histograms.

    pairs : (n, 2) laser point and pixel of each. row : (n,) first row of each, to which `row_of_part` (K,) is added.
    histogram (rows, T) and overflow (rows,) get the photons.
    Returns the cells that were spread, and the rays asked.
    """
    vertices, tag = np.empty((1024, 10)), np.empty((1024, 3), np.int64)
    waiting = np.empty(512, np.int64)
    cells, rays = 0, 0
    # Records are taken apart here: in the loops every look into one costs as much as what it is for.
    corners, normal, area_before, extent = tree.corners, tree.normal, tree.area, tree.extent
    box, children, span, roots = tree.box, tree.children, tree.span, tree.roots
    obstacle, number, flat = occluders.corners, occluders.number, occluders.flat
    around, child, within = occluders.box, occluders.child, occluders.span
    position1, normal1, to_laser1, part1, power1, leg1 = (
        lasers.position, lasers.normal, lasers.to_laser, lasers.part, lasers.power, lasers.leg
    )  # fmt: skip
    position3, normal3, to_sensor3, part3, weight3, footprint3 = (
        patches.position, patches.normal, patches.to_sensor, patches.part, patches.weight, patches.footprint
    )  # fmt: skip
    most3, leg3, size3, across3 = patches.most, patches.leg, patches.size, patches.across
    uneven3, quarters3 = patches.uneven, patches.quarters
    allowed, coarsest, peak = cutting.error, cutting.coarsest, cutting.peak
    last_leg, proofs = cutting.rays_on_last_leg, cutting.proofs
    per_metre, clock_start, attenuation = clock.per_metre, clock.start, clock.attenuation
    brightest = peak.max()
    for pair in range(len(pairs)):
        i, p = pairs[pair, 0], pairs[pair, 1]
        if part1[i] < 0 or (part3[p, 0] < 0 and not uneven3[p, 0]):
            continue
        x, k1 = _at(position1, i), part1[i]
        n1, to_laser, lit = _at(normal1, i), _at(to_laser1, i), power1[i]
        for k in range(len(roots)):
            if allowed[k] == np.inf:
                continue
            into = row[pair] + row_of_part[k]
            most, turn = (
                np.inf,
                np.int64(mix(mix(np.uint64(cutting.seed), np.uint64(pair)), np.uint64(k)) >> np.uint64(8)),
            )
            top = _push_box(tag, vertices, 0, roots[k], 0, 1.0)
            while top > 0:
                top -= 1
                what, at, q = tag[top, 0], tag[top, 1], tag[top, 2]
                v = vertices[top]
                a, b, c = (v[0], v[1], v[2]), (v[3], v[4], v[5]), (v[6], v[7], v[8])
                share = v[9]
                quarters = quarters3[q, 0] >= 0
                if uneven3[p, q] and quarters:
                    if most3[p, q] <= 0.0:
                        continue
                    z, size = _point(position3, p, q), size3[p, q]
                    if what == BOX:
                        above, height = _above(box, at, x, n1), np.inf
                        low, high = (box[at, 0], box[at, 1], box[at, 2]), (box[at, 3], box[at, 4], box[at, 5])
                        m, h = _middle(low, high), _length(less(high, low))
                        area, several = area_before[span[at, 1]] - area_before[span[at, 0]], children[at, 0] >= 0
                    else:
                        m = ((a[0] + b[0] + c[0]) / 3, (a[1] + b[1] + c[1]) / 3, (a[2] + b[2] + c[2]) / 3)
                        h = max(_length(less(b, a)), _length(less(c, b)), _length(less(a, c)))
                        area, several = 0.5 * _length(cross(less(b, a), less(c, a))), False
                        above = max(dot(less(a, x), n1), dot(less(b, x), n1), dot(less(c, x), n1))
                        height = abs(dot(less(x, a), _at(normal, at)))
                    if above <= 0.0:
                        continue
                    near1 = max(_length(less(m, x)) - h, math.sqrt(area / (2 * math.pi)))
                    near3 = max(_length(less(m, z)) - h - size, 0.25 * size)
                    at_most = share * lit * most3[p, q] * peak[k1] * peak[k] * brightest * area
                    at_most *= min(1.0, above / near1) * min(1.0, height / near1)
                    at_most /= (near1 * near3) ** 2
                    if q == 0 and what == BOX and at == roots[k]:
                        most = at_most
                    if at_most <= min(allowed[k], most * FEWEST):
                        # Whatever of the patch is seen makes no larger error than may be: one quarter stands for it,
                        # and such cells take turns.
                        turn += share == 1.0
                        j = quarters3[q, _digit(turn, share)]
                        if what == BOX:
                            top = _push_box(tag, vertices, top, at, j, 4 * share)
                        else:
                            top = _push(tag, vertices, top, CELL, at, j, 4 * share, a, b, c)
                    elif several and h > size:
                        for j in range(2):
                            top = _push_box(tag, vertices, top, children[at, j], q, share)
                    elif what != BOX and h > max(size, SMALLEST * extent):
                        top = _halve(tag, vertices, top, CELL, at, q, share, a, b, c)
                    else:
                        for j in range(4):
                            if what == BOX:
                                top = _push_box(tag, vertices, top, at, quarters3[q, j], share)
                            else:
                                top = _push(tag, vertices, top, CELL, at, quarters3[q, j], share, a, b, c)
                    continue
                k3 = part3[p, q]
                if k3 < 0:
                    continue
                z, n3, to_sensor = _point(position3, p, q), _point(normal3, p, q), _point(to_sensor3, p, q)
                size, footprint = size3[p, q], footprint3[p, q]
                gain = lit * weight3[p, q] * share
                device = leg1[i] + leg3[p, q] if clock.device else 0.0
                one_ray = not last_leg or (x[0] == z[0] and x[1] == z[1] and x[2] == z[2])
                if what == BOX:
                    if _above(box, at, x, n1) <= 0.0:
                        continue
                    first, last = span[at, 0], span[at, 1]
                    low, high = (box[at, 0], box[at, 1], box[at, 2]), (box[at, 3], box[at, 4], box[at, 5])
                    middle, h = _middle(low, high), _length(less(high, low))
                    if _above(box, at, z, n3) <= 0.0 and size <= 0.0:
                        continue
                    if last - first > CLUSTER:
                        r1, r3 = _length(less(middle, x)), _length(less(middle, z))
                        near1, near3 = r1 - 0.5 * h, r3 - 0.5 * h
                        open_it = near1 <= 0.0 or near3 <= 0.0 or h > COARSEST * near1 or h > COARSEST * near3
                        if not open_it:
                            # As if all of it faced both: its light is at most that.
                            most = gain * peak[k1] * peak[k] * peak[k3]
                            most *= area_before[last] - area_before[first]
                            most /= near1 * near1 * near3 * near3
                            open_it = 0.5 * most > allowed[k]
                        if not open_it and quarters and size > 0.3 * near3:
                            for j in range(4):
                                top = _push_box(tag, vertices, top, at, quarters3[q, j], share)
                            continue
                        if open_it:
                            top = _push_box(tag, vertices, top, children[at, 1], q, share)
                            top = _push_box(tag, vertices, top, children[at, 0], q, share)
                            continue
                        # One point anywhere on the cluster stands for all of it.
                        word = mix(mix(np.uint64(cutting.seed), np.uint64(pair)), np.uint64(at) * np.uint64(8))
                        f, y = _anywhere(first, last, area_before, corners, word)
                        n, area = _at(normal, f), area_before[last] - area_before[first]
                        w, path = _weight(y, n, k, x, n1, to_laser, k1, z, n3, to_sensor, k3, kind, values, footprint)
                        if w > 0.0:
                            rays += 1
                            cells += 1
                            if _seen(y, x, z, one_ray, f, obstacle, number, around, child, within, waiting):
                                air = math.exp(-attenuation * (path + leg3[p, q])) if attenuation > 0.0 else 1.0
                                overflow[into] += put(
                                    histogram[into], (path + device) * per_metre - clock_start, w * air * gain * area
                                )
                        continue
                    for f in range(first, last):
                        one, two, other = _point(corners, f, 0), _point(corners, f, 1), _point(corners, f, 2)
                        top = _push(tag, vertices, top, CELL, f, q, share, one, two, other)
                    continue
                f, n = at, _at(normal, at)
                m = ((a[0] + b[0] + c[0]) / 3, (a[1] + b[1] + c[1]) / 3, (a[2] + b[2] + c[2]) / 3)
                if max(dot(less(a, x), n1), dot(less(b, x), n1), dot(less(c, x), n1)) <= 0.0:
                    continue
                if max(dot(less(a, z), n3), dot(less(b, z), n3), dot(less(c, z), n3)) <= 0.0:
                    continue
                height1, height3 = dot(less(x, a), n), dot(less(z, a), n)
                if abs(height1) < flat:
                    continue
                ab, bc, ca = less(b, a), less(c, b), less(a, c)
                long_ab, long_bc, long_ca = dot(ab, ab), dot(bc, bc), dot(ca, ca)
                h = math.sqrt(max(long_ab, long_bc, long_ca))
                d1, d3 = less(m, x), less(m, z)
                r1, r3 = _length(d1), _length(d3)
                # What the patch itself cannot tell apart needs no cutting.
                bound3 = math.sqrt(r3 * r3 + footprint / math.pi)
                ratio1, ratio3, ratio_z = h / r1, h / bound3, size / r3
                limit = coarsest[k]
                quarter = ratio_z > limit and quarters and size > 0.5 * h
                cut = not quarter and max(ratio1, ratio3) > limit
                if height1 * height3 <= 0.0 or abs(height3) < flat:
                    # The middle of the patch is not lit by this side of the triangle; parts of a large patch may be.
                    if not (quarters and abs(height3) < size and size > 0.1 * r3):
                        continue
                    quarter = True
                area = 0.5 * _length(cross(ab, ca))
                vis, error = 1.0, 0.0
                if not (cut or quarter):
                    wm, path = _weight(m, n, k, x, n1, to_laser, k1, z, n3, to_sensor, k3, kind, values, footprint)
                    wa, at_a = _weight(a, n, k, x, n1, to_laser, k1, z, n3, to_sensor, k3, kind, values, footprint)
                    wb, at_b = _weight(b, n, k, x, n1, to_laser, k1, z, n3, to_sensor, k3, kind, values, footprint)
                    wc, at_c = _weight(c, n, k, x, n1, to_laser, k1, z, n3, to_sensor, k3, kind, values, footprint)
                    air = math.exp(-attenuation * (path + leg3[p, q])) if attenuation > 0.0 else 1.0
                    energy = gain * air * area * (0.75 * wm + 0.25 * (wa + wb + wc) / 3)
                    bend = (at_a + at_b + at_c) / 3 - path
                    width = (max(at_a, at_b, at_c) - min(at_a, at_b, at_c)) * per_metre
                    bright = gain * area * max(wm, wa, wb, wc)
                    over = bright / math.sqrt(max(1.0, width))
                    sharp = (COARSEST / limit) ** 2
                    curved = sharp * (ratio1 * ratio1 + ratio3 * ratio3) + bend * per_metre / max(1.0, width)
                    smeared = ratio_z * ratio_z + min((SMEARED * size * per_metre / max(1.0, width)) ** 4, UNLIKE)
                    error = over * curved
                    if over * smeared > allowed[k]:
                        quarter = quarters
                    if not quarter and bright > 0.0:
                        faint = over <= allowed[k]
                        if (
                            what == CELL
                            and proofs
                            and not faint
                            and _all_seen(
                                x, a, b, c, z, one_ray, f, obstacle, number, around, child, within, flat, waiting
                            )
                        ):
                            what = CLEAR
                        cut = error > allowed[k]
                        if (
                            cut
                            and what == CELL
                            and _none_seen(
                                x, a, b, c, z, one_ray, f, obstacle, number, around, child, within, waiting
                            )
                        ):
                            continue
                        if not cut and what == CELL and faint:
                            # Seen or not, it can make no larger error than it may.
                            rays += 1
                            if not _seen(m, x, z, one_ray, f, obstacle, number, around, child, within, waiting):
                                continue
                        elif not cut and what == CELL:
                            seen = 0
                            for lone in range(3):
                                rays += 1
                                y = (
                                    (a[0] + b[0] + c[0] + 3 * v[3 * lone]) / 6,
                                    (a[1] + b[1] + c[1] + 3 * v[3 * lone + 1]) / 6,
                                    (a[2] + b[2] + c[2] + 3 * v[3 * lone + 2]) / 6,
                                )
                                seen += _seen(y, x, z, one_ray, f, obstacle, number, around, child, within, waiting)
                            vis = seen / 3
                            # What three rays do not find may still be there: it is cut a little less eagerly.
                            cut = seen < 3 and (PARTLY if seen > 0 else UNFOUND) * over > allowed[k]
                            if seen == 0 and (
                                not cut
                                or _none_seen(
                                    x, a, b, c, z, one_ray, f, obstacle, number, around, child, within, waiting
                                )
                            ):
                                continue
                if quarter:
                    for j in range(4):
                        top = _push(tag, vertices, top, CELL, f, quarters3[q, j], share, a, b, c)
                    continue
                if cut and h > SMALLEST * extent:
                    top = _halve(tag, vertices, top, what, f, q, share, a, b, c)
                    continue
                if cut or not energy > 0.0:
                    continue
                cells += 1
                scale, zero = per_metre, (device - 0.75 * bend) * per_metre - clock_start
                at_a, at_b, at_c = at_a * scale + zero, at_b * scale + zero, at_c * scale + zero
                if size * per_metre > AT_ONCE:
                    # From one side of the patch to the other the path changes, too.
                    smear = 0.0
                    for side in range(2):
                        longer = 0.0
                        for j in range(3):
                            slope = d3[j] / r3 + (to_sensor[j] if clock.device else 0.0)
                            longer += slope * across3[p, q, side, j]
                        smear += (longer * per_metre) ** 2 / 12
                    at_a, at_b, at_c = widened(at_a, at_b, at_c, smear)
                overflow[into] += spread(histogram[into], at_a, at_b, at_c, wa, wb, wc, vis * energy)
    return cells, rays
