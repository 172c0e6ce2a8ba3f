"""The primary of one laser point and pixel: surfaces cut into cells, each of them spread over its arrival times.

A cell is a triangle, or a cluster of small ones. Its energy is exact for weights (`weights`) of second degree (three
quarters of the middle and a quarter of the vertices), its weights are taken as linear and its arrival times too,
moved so that their mean is that of second degree.
"""

from __future__ import annotations

import math

import numpy as np

from datagen.compiled import compiled
from datagen.records.arrays import Floats, Ints
from datagen.transport.brdf import LAMBERTIAN, OREN_NAYAR, dot
from datagen.transport.geometry import above, ball, corner, distance, get, half, less
from datagen.transport.quadrature.arrival_times import spread, widened
from datagen.transport.quadrature.clear_elements import put_clear, room_for_clear, spread_clear
from datagen.transport.quadrature.clusters import (
    COARSEST,
    anywhere,
    as_one,
    facing,
    facing_at_most,
    is_small,
    somewhere,
)
from datagen.transport.quadrature.waiting import (
    BOX,
    CELL,
    FRESH,
    KEPT,
    copy_cell,
    highest_above,
    middle_of,
    push,
    push_boxes,
    push_halves,
    put_vertex,
    vertex_of,
)
from datagen.transport.quadrature.weights import (
    OUTSIDE,
    brightest,
    judged,
    outside,
    smear,
    weight,
    weight_at_most,
)
from datagen.transport.sampling import mix, word_of
from datagen.transport.visibility.bvh import CLUSTER, SMALLEST
from datagen.transport.visibility.closed_surfaces import inner_side, seen_from_outside, side_turned
from datagen.transport.visibility.occlusion import LISTED, RING, hidden, lists, narrowed, shaded

PARTLY, UNFOUND, MESH = (0.5, 0.05), 0.05, 256
"""Error of a cell that one ray stands for, on a part of up to `MESH` triangles and on one of more, and of a cell of
which three rays found nothing, relative to its light. Of large faces few cells are partly seen, and they are found
by what is proven clear. Of a mesh nothing is proven, few cells are partly seen all the same, and they err to both
sides, for rays go to random points: twice the second asks up to a third more rays, half of it about as many."""
STILL_UNFOUND = 0.5
"""What the latter is multiplied with for each larger cell about it of which no ray found anything either: what lies
deep behind a mesh cannot be proven hidden, and is not searched as finely as an edge."""
PLACES = 2.0**20
"""Places along the scene whose cells have random points of their own."""
AT_ONCE = 0.01
"""Size of a patch, in bins, up to which all of it is reached at once."""
TURNS, FEWEST = 16, 1 / 64
"""Light up to which one quarter of a pixel stands for the others: relative to the error that a cell may make, and to
what all of the part might bring."""


@compiled()
def _digit(turn, share):  # type: ignore[no-untyped-def]
    """Of a number, to base 4, the digit after those that were used up to get to a share of 4^digits."""
    while share > 1.0:
        turn >>= 2
        share *= 0.25
    return turn & 3


@compiled()
def _word_at(seed, row, q, y, extent):  # type: ignore[no-untyped-def]
    """The word of a place y beside the laser point, seen from patch q, in a row of a stream: neither where the scene
    lies nor in which order its triangles are changes it."""
    word, per = mix(mix(np.uint64(seed), np.uint64(row)), np.uint64(q)), PLACES / extent
    for j in range(3):
        # Off the middle, as what lies level with the laser point would else be rounded to either side.
        word = mix(word, np.uint64(np.int64(math.floor(y[j] * per + 0.382))))
    return word


@compiled()
def _seen(y, x, z, f, first, middle, last, hides, listed):  # type: ignore[no-untyped-def]
    """Whether the laser point x lights y on triangle f and the patch at z sees it."""
    if first < middle and hidden(x, y, f, first, middle, hides, listed) > 0:
        return False
    return middle == last or hidden(z, y, f, middle, last, hides, listed) == 0


@compiled()
def _none_seen(x, a, b, c, z, f, first, middle, last, hides, listed):  # type: ignore[no-untyped-def]
    """Whether it is proven that nothing of the cell a, b, c is lit by the laser point and seen by the patch."""
    if first < middle and shaded(x, a, b, c, f, first, middle, hides, listed):
        return True
    return middle < last and shaded(z, a, b, c, f, middle, last, hides, listed)


@compiled()
def _inner_side(x, z, f, normal, corners, solid, solid_box):  # type: ignore[no-untyped-def]
    """Whether triangle f of a solid turns its inner side to the laser point or to the patch."""
    n = get(normal, f, 0)
    return inner_side(x, n, corners, f, solid, solid_box) or inner_side(z, n, corners, f, solid, solid_box)


def room_to_gather() -> tuple[Ints, Floats, Ints, Floats, Floats, Floats]:
    """What `gather` works in: tags and cells that wait, lists of candidates, and `room_for_clear`.

    What waits has its kind, number, patch and candidates, and a row of `waiting`.
    """
    return np.empty((1024, 6), np.int64), np.empty((1024, 18)), lists(1 << 14), *room_for_clear()


# Without `_nrt=False` arrays are counted in and out of every function, a third of the time.
@compiled(_nrt=False)
def gather(  # type: ignore[no-untyped-def]
    pairs, row, tree, occluders, lasers, patches, kind, values, cutting, clock, row_of_part, histogram, overflow,
    work, tag, cell, listed, clear, batch, cuts,
):  # fmt: skip
    """Add the primary of laser points and pixels to their histograms.

    pairs : (n, 2) laser point and pixel of each. row : (n,) first row of each, to which `row_of_part` (K,) is added.
    histogram (rows, T) and overflow (rows,) get the photons; work (K, 2) gets the cells that were spread and the rays
    asked, part by part. The rest is `room_to_gather`.

    What may stand between a cell and laser point or patch is among what may stand before all of the box or cell that
    it is cut from: each hands down its candidates, first … middle for the one and middle … last for the other, and
    where none is left nothing is hidden. Cells hand down their vertices' light, too.
    """
    # Records are taken apart here: in the loops every look into one costs as much as what it is for.
    corners, normal, area_before, extent = tree.corners, tree.normal, tree.area, tree.extent
    around, children, span, roots = tree.box, tree.children, tree.span, tree.roots
    cluster, moment = tree.cluster, tree.moment
    solid, solid_box, of_box = tree.solid, tree.solid_box, tree.of_box
    hides, flat = occluders.row, occluders.flat
    position1, normal1, to_laser1, part1, power1, leg1 = (
        lasers.position, lasers.normal, lasers.to_laser, lasers.part, lasers.power, lasers.leg
    )  # fmt: skip
    position3, normal3, to_sensor3, part3, weight3, footprint3 = (
        patches.position, patches.normal, patches.to_sensor, patches.part, patches.weight, patches.footprint
    )  # fmt: skip
    most3, leg3, size3, across3 = patches.most, patches.leg, patches.size, patches.across
    uneven3, quarters3, share3 = patches.uneven, patches.quarters, patches.share
    allowed, sharp, peak = cutting.error, cutting.sharp, cutting.peak
    limit, last_leg, proofs = cutting.coarsest, cutting.rays_on_last_leg, cutting.proofs
    per_metre, start_bin, attenuation = clock.per_metre, clock.start, clock.attenuation
    opens, closes = clock.opens, clock.closes
    enough = len(listed) - 4 * RING
    some, strongest = min(occluders.triangles, 1), 0.0
    to_z = LISTED + some
    free = to_z + some
    for k in range(len(peak)):
        strongest = max(strongest, peak[k])
    for pair in range(len(pairs)):
        i, p = pairs[pair, 0], pairs[pair, 1]
        if part1[i] < 0 or (part3[p, 0] < 0 and not uneven3[p, 0]):
            continue
        x, k1 = get(position1, i, 0), part1[i]
        n1, lit, z = get(normal1, i, 0), power1[i], corner(position3, p, 0)
        lit_from = (x, n1, get(to_laser1, i, 0), kind[k1], values[k1])
        two_legs = last_leg and distance(x, z) > flat
        for k in range(len(roots)):
            if allowed[k] == np.inf:
                continue
            into, kind2, values2, seed = row[pair] + row_of_part[k], kind[k], values[k], cutting.seed[k]
            word = word_of(seed, row[pair], k)
            partly = PARTLY[1] if span[roots[k], 1] - span[roots[k], 0] > MESH else PARTLY[0]
            most, turn, cells, rays = np.inf, np.int64(word >> np.uint64(8)), 0, 0
            cell[0, 16], cell[0, 17] = 1.0, UNFOUND
            top = push(tag, 0, BOX, roots[k], 0, LISTED, to_z, free if two_legs else to_z)
            alight = np.int64(0)
            while top > 0 or alight > 0:
                if top == 0:
                    alight, more, beyond, top = spread_clear(
                        clear, alight, batch, cuts, normal, x, n1, lit, leg1[i], p, patches, limit, allowed[k],
                        clock, AT_ONCE, SMALLEST * extent, histogram, into, tag, cell, free,
                    )  # fmt: skip
                    cells, overflow[into] = cells + more, overflow[into] + beyond
                    continue
                top -= 1
                what, at, q = tag[top, 0], tag[top, 1], tag[top, 2]
                first, middle, last = tag[top, 3], tag[top, 4], tag[top, 5]
                quarters = quarters3[q, 0] >= 0
                quarter = uneven3[p, q] and quarters
                k3 = part3[p, q]
                if k3 < 0 and not quarter:
                    continue
                z, n3 = corner(position3, p, q), corner(normal3, p, q)
                seen_from = (z, n3, corner(to_sensor3, p, q), kind[k3], values[k3])
                keen, tilt = max(sharp[k1], sharp[k], sharp[k3]), 0.0
                share, size, footprint = cell[top, 16], size3[p, q], footprint3[p, q]
                # What a lobe makes of a cell for one patch it makes for the next, unless chance does.
                of_pixel = share * share3[q] if keen > 1.0 else 1.0
                may, alike = allowed[k] * math.sqrt(of_pixel), allowed[k] * of_pixel
                gain = lit * weight3[p, q] * share
                few = halve = alone = cut = False
                if quarter:
                    if what == BOX:
                        m, h = ball(around, at)
                        area = area_before[span[at, 1]] - area_before[span[at, 0]]
                        rise, height = above(around, at, x, n1), np.inf
                        halve = children[at, 0] >= 0 and h > size
                    else:
                        m, side, h = middle_of(cell, top)
                        area, rise = cell[top, 15], highest_above(cell, top, x, n1)
                        height = abs(dot(less(x, vertex_of(cell, top, 0)), get(normal, at, 0)))
                        halve = h > max(size, SMALLEST * extent)
                    if rise <= 0.0 or most3[p, q] <= 0.0:
                        continue
                    at_most = share * lit * most3[p, q] * peak[k1] * peak[k] * strongest
                    at_most *= brightest(m, h, area, rise, height, x, z, size, attenuation)
                    if what == BOX and q == 0 and at == roots[k]:
                        most = at_most
                    # Whatever of the patch is seen, its light is little: one quarter stands for it, and such cells
                    # take turns, so that what one has too much of its neighbours lack.
                    few = at_most <= min(TURNS * allowed[k], most * FEWEST)
                    turn += few and share == 1.0
                    if halve and not few:
                        if what == BOX:
                            top = push_boxes(tag, cell, top, children[at], q, first, middle, last)
                        else:
                            y = half(vertex_of(cell, top, side), vertex_of(cell, top, (side + 1) % 3))
                            top = push_halves(tag, cell, top, side, y, 0.0, 0.0, FRESH, at, q, first, middle, last)
                        continue
                device = leg1[i] + leg3[p, q] if clock.device else 0.0
                if what == BOX and not quarter:
                    rise1, rise3 = above(around, at, x, n1), above(around, at, z, n3)
                    if rise1 <= 0.0 or (rise3 <= 0.0 and size <= 0.0):
                        continue
                    start, end = span[at, 0], span[at, 1]
                    many, area = end - start > CLUSTER, area_before[end] - area_before[start]
                    sides, diffuse, own = 0, kind2 == LAMBERTIAN, seen_from_outside(solid_box, of_box[at], x)
                    if many:
                        m, h = ball(around, at)
                        axis, cosine = get(moment, cluster[at], 15), moment[cluster[at], 18]
                        sine = math.sqrt(max(1.0 - cosine * cosine, 0.0))
                        sides = side_turned(less(x, m), h, axis, cosine, sine)
                        if proofs and own >= 0 and sides < 0:
                            continue
                        sides *= side_turned(less(z, m), h, axis, cosine, sine)
                        # The other side does not light the patch's middle; it may light parts of a large one.
                        if sides < 0 and not quarters:
                            continue
                        # One normal cannot stand for many where a lobe goes with each of them.
                        alone = (sides > 0 and (diffuse or kind2 == OREN_NAYAR)) or (sides == 0 and diffuse)
                        alone = alone and dot(less(m, x), n1) > h and dot(less(m, z), n3) > h
                    if many and not alone:
                        at_most = gain * peak[k1] * peak[k] * peak[k3] * area
                        at_most *= facing_at_most(m, h, axis, cosine, sine, x, rise1)
                        at_most *= facing_at_most(m, h + size, axis, cosine, sine, z, rise3 + size)
                        small, near3 = is_small(around, at, x, z, at_most, may, attenuation)
                        if sides > 0 and not small:
                            tilt = math.acos(max(cosine, -1.0))
                            at_most = gain * area * weight_at_most(
                                m, axis, kind2, values2, lit_from, seen_from, footprint, attenuation, 2.0 * h, size,
                                tilt,
                            )  # fmt: skip
                            small = at_most <= may and 2.0 * h <= COARSEST * near3
                        quarter = small and quarters and size > 0.3 * near3
                        if small and not quarter:
                            word = _word_at(seed, row[pair], q, less(m, x), extent)
                            f, y = anywhere(start, end, area_before, corners, word)
                            n = get(normal, f, 0)
                            w, r1, r3 = weight(y, n, kind2, values2, lit_from, seen_from, footprint, attenuation)
                            if not w > 0.0:
                                continue
                            cells += 1
                            if proofs and inner_side(x, n, corners, f, solid, solid_box):
                                continue
                            rays += 1
                            if _seen(y, x, z, f, first, middle, last, hides, listed):
                                path = r1 + r3
                                t = (path + device) * per_metre - start_bin
                                energy = w * gain * area
                                variance = smear(less(y, z), seen_from[2], clock.device, across3, p, q)
                                at_a, at_b, at_c = widened(t, t, t, variance * per_metre * per_metre)
                                overflow[into] += spread(histogram, into, at_a, at_b, at_c, 1.0, 1.0, 1.0, energy)
                            continue
                if not quarter and (alone or what != BOX):
                    if alone:
                        m, n, tilted, unlike, h, longer, apart = as_one(
                            moment, cluster[at], x, z, sides, diffuse, keen, per_metre
                        )
                        f, side, a, b, c, height1, height3 = at, 0, m, m, m, 1.0, 1.0
                        tilt = math.acos(max(cosine, -1.0))
                    else:
                        f, n = at, get(normal, at, 0)
                        if highest_above(cell, top, x, n1) <= 0.0 or highest_above(cell, top, z, n3) <= 0.0:
                            continue
                        a, b, c = vertex_of(cell, top, 0), vertex_of(cell, top, 1), vertex_of(cell, top, 2)
                        height1, height3 = dot(less(x, a), n), dot(less(z, a), n)
                        if abs(height1) < flat:
                            continue
                        if what == FRESH:
                            if proofs and inner_side(x, n, corners, f, solid, solid_box):
                                continue
                            for j in range(3):
                                y = vertex_of(cell, top, j)
                                w, r1, r3 = weight(y, n, kind2, values2, lit_from, seen_from, footprint, attenuation)
                                put_vertex(cell, top, j, y, w, r1 + r3)
                        if first == last and what != KEPT and height1 * height3 > 0.0 and abs(height3) > flat:
                            others = alight
                            alight = put_clear(clear, alight, cell, top, f, q, lit_from, kind2, values2, seen_from)
                            if alight > others:
                                continue
                        m, side, h = middle_of(cell, top)
                    wm, r1, r3 = weight(m, n, kind2, values2, lit_from, seen_from, footprint, attenuation)
                    if alone:
                        wm *= tilted
                        cell[top, 15] = area
                        for j in range(3):
                            put_vertex(cell, top, j, m, wm, r1 + r3 + 4.0 * longer + (j - 1.0) * apart)
                    bright = wm
                    if kind[k1] != LAMBERTIAN or kind2 != LAMBERTIAN or kind[k3] != LAMBERTIAN:
                        # A lobe that no point of the cell meets may cross it all the same: it is not dark for that.
                        bright = max(wm, weight_at_most(
                            m, n, kind2, values2, lit_from, seen_from, footprint, attenuation, h, size, tilt
                        ))  # fmt: skip
                    unseen = outside(cell[top, 4], cell[top, 9], cell[top, 14], r1 + r3, device, size, opens, closes)
                    cut, quarter, over, bend = judged(
                        cell, top, h, bright, r1, r3, gain, footprint, size, limit, keen, alike, quarters,
                        per_metre, attenuation, unseen,
                    )  # fmt: skip
                    if alone:
                        # What is cut once need not be cut again for each quarter of the pixel.
                        cut |= (over * unlike > alike and not unseen) or (quarter and h > 2.0 * size)
                        quarter &= not cut
                    if height1 * height3 <= 0.0 or abs(height3) < flat:
                        # This side does not light the patch's middle; it may light parts of it, as it does what lies
                        # so far above it.
                        if not (quarters and abs(height3) < size):
                            continue
                        rise = math.copysign(size, height1)
                        z_lit = (z[0] + rise * n[0], z[1] + rise * n[1], z[2] + rise * n[2])
                        lit_part = (z_lit, n3, seen_from[2], kind[k3], values[k3])
                        if gain * cell[top, 15] * weight_at_most(
                            m, n, kind2, values2, lit_from, lit_part, footprint, attenuation, h, size, tilt
                        ) <= alike:  # fmt: skip
                            continue
                        quarter = True
                    if not (quarter or over > 0.0):
                        continue
                    # One ray tells enough of what is partly seen, if that makes no larger error than it may.
                    at_stake = OUTSIDE * over if unseen else over
                    faint = partly * at_stake <= may
                    inner = alone and proofs and own >= 0 and sides == 0
                    if not quarter and (first < last or inner):
                        if cut and not alone and _none_seen(x, a, b, c, z, f, first, middle, last, hides, listed):
                            continue
                        if faint and not cut:
                            rays += 1
                            word = _word_at(seed, row[pair], q, less(m, x), extent)
                            if alone:
                                f, y = facing(start, end, area_before, corners, normal, x, z, word)
                                if inner and _inner_side(x, z, f, normal, corners, solid, solid_box):
                                    continue
                            else:
                                y = somewhere(a, b, c, word)
                            if not _seen(y, x, z, f, first, middle, last, hides, listed):
                                continue
                        elif not cut:
                            seen = 0
                            for j in range(3):
                                rays += 1
                                word = mix(_word_at(seed, row[pair], q, less(m, x), extent), np.uint64(j))
                                if alone:
                                    low, high = start + j * (end - start) // 3, start + (j + 1) * (end - start) // 3
                                    f, y = facing(low, high, area_before, corners, normal, x, z, word)
                                else:
                                    # One in each of the triangles that the middle makes with the sides.
                                    one, other = vertex_of(cell, top, j), vertex_of(cell, top, (j + 1) % 3)
                                    y = somewhere(m, one, other, word)
                                if not (inner and _inner_side(x, z, f, normal, corners, solid, solid_box)):
                                    seen += _seen(y, x, z, f, first, middle, last, hides, listed)
                                if 0 < seen <= j:
                                    break
                            # What three rays do not find may still be there: it is cut a little less eagerly.
                            cut = 0 < seen < 3 or (seen == 0 and cell[top, 17] * at_stake > may)
                            if seen == 0 and (
                                not cut
                                or (not alone and _none_seen(x, a, b, c, z, f, first, middle, last, hides, listed))
                            ):  # fmt: skip
                                continue
                            cell[top, 17] = STILL_UNFOUND * cell[top, 17] if seen == 0 else UNFOUND
                    # Rays find their way through what may hide the cell it is cut from; it pays to narrow that down
                    # for what is cut.
                    if cut and not (alone or quarter) and proofs and first < last < enough:
                        own = seen_from_outside(solid_box, solid[f], x)
                        half_way = narrowed(x, a, b, c, f, own, first, middle, last, hides, listed)
                        behind = narrowed(z, a, b, c, f, own, middle, last, half_way, hides, listed)
                        first, middle, last = last, half_way, behind
                if quarter:
                    cell[top, 17] = UNFOUND
                    # Another point of the wall, before which other things may stand; what may hide the cell from
                    # the laser point is what it was.
                    for j in range(middle - first):
                        listed[last + j] = listed[first + j]
                    first, middle = last, last + middle - first
                    last = middle + (some if last_leg else 0)
                    listed[middle] = 0
                    here, kept = top, BOX if what == BOX else FRESH
                    if few:
                        cell[top, 16] = 4.0 * share
                        only = quarters3[q, _digit(turn, share)]
                        top = push(tag, top, kept, at, only, first, middle, last)
                        continue
                    for j in range(4):
                        copy_cell(cell, here, top)
                        top = push(tag, top, kept, at, quarters3[q, j], first, middle, last)
                    continue
                if what == BOX and (cut or not alone):
                    if many:
                        top = push_boxes(tag, cell, top, children[at], q, first, middle, last)
                        continue
                    unfound = cell[top, 17]
                    for f in range(start, end):
                        cell[top, 16] = share
                        for j in range(3):
                            put_vertex(cell, top, j, corner(corners, f, j), 0.0, 0.0)
                        cell[top, 15], cell[top, 17] = area_before[f + 1] - area_before[f], unfound
                        top = push(tag, top, FRESH, f, q, first, middle, last)
                    continue
                if cut:
                    if h <= SMALLEST * extent:
                        continue
                    # Across the longest side.
                    y = half(vertex_of(cell, top, side), vertex_of(cell, top, (side + 1) % 3))
                    w, r1, r3 = weight(y, n, kind2, values2, lit_from, seen_from, footprint, attenuation)
                    top = push_halves(tag, cell, top, side, y, w, r1 + r3, CELL, f, q, first, middle, last)
                    continue
                wa, wb, wc = cell[top, 3], cell[top, 8], cell[top, 13]
                energy = gain * cell[top, 15] * (0.75 * wm + 0.25 * (wa + wb + wc) / 3)
                cells += 1
                zero = (device - 0.75 * bend) * per_metre - start_bin
                at_a, at_b, at_c = (
                    cell[top, 4] * per_metre + zero, cell[top, 9] * per_metre + zero, cell[top, 14] * per_metre + zero
                )  # fmt: skip
                if size * per_metre > AT_ONCE:
                    variance = smear(less(m, z), seen_from[2], clock.device, across3, p, q) * per_metre * per_metre
                    at_a, at_b, at_c = widened(at_a, at_b, at_c, variance)
                overflow[into] += spread(histogram, into, at_a, at_b, at_c, wa, wb, wc, energy)
            work[k, 0] += cells
            work[k, 1] += rays
