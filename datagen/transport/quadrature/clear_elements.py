"""*Clear* elements: surface elements that nothing can hide, with only Lambertian surfaces on the path.

Most elements of a room are clear. They need no shadow rays, only arithmetic, and do not depend on one another. So
they wait on a stack of their own, and up to `WIDE` of them are taken from it together: middles, weights and verdicts
are computed in loops without branches, which compilers turn into vector instructions. The results equal those of
`weights.weight` and `weights.verdict`, operation by operation.
"""

from __future__ import annotations

import math

import numpy as np

from datagen.compiled import compiled
from datagen.records.arrays import Floats
from datagen.transport.brdf import LAMBERTIAN, dot
from datagen.transport.geometry import half, subtract, transmittance
from datagen.transport.arrival_times import pour, tent, widened
from datagen.transport.quadrature.waiting import KEPT, push
from datagen.transport.quadrature.weights import AT_ONCE, outside, path_variance, verdict
from datagen.transport.bvh import SMALLEST

WIDE = 64
"""Most elements that are taken from the stack together; half as many leave vector instructions less well filled."""
MOST_CLEAR = 1 << 12
"""Most elements on the stack when one more is put there; later ones are left to the kernel. Half of it takes half
the memory and leaves more elements to the kernel, which is slower."""
MOST_QUARTERED = 256
"""Number of elements that wait to be seen from quarters of their footprints, from which on these come first, because
the kernel's stack (`Room.new`) has space for no more. Half of it changes the order only."""
# A batch is one long row: number r of element j is at r · WIDE + j. The first `STACKED` numbers of an element are
# those that it has on the stack: three vertices, each with weight and path, as in `waiting.py` (0–14), `AREA`, its
# triangle (`OF`), its footprint (`PATCH`), the number of footprints for which that stands (`SHARE`) and the product
# of the three BRDFs (`BRDF`). Then follow `NORMAL` of the triangle; position (`SEEN_FROM`), normal (`NORMAL3`) and
# area (`FOOTPRINT`) of the footprint; a point (`POINT`), with weight, R₁ and R₂ there (`LIGHT`); length and number of
# the longest side (`LONG`); photons per unit of weight and area (`GAIN`); `SIZE` of the footprint, and whether it has
# `QUARTERS`; length of the legs to the device, 0 if they do not count (`LEGS`); sides of the footprint (`ACROSS`),
# and direction from there to the sensor (`TO_SENSOR`); `VERDICT` and `BEND` (`weights.verdict`); `ENERGY`; and the
# seven numbers of a `TENT` (`arrival_times.tent`). Most are np.int64, because numba compiles a function anew for each
# plain int.
FIRST, SECOND, THIRD = map(np.int64, (0, 5, 10))
AREA, OF, PATCH, SHARE, BRDF, STACKED = 15, 16, 17, 18, 19, 20
NORMAL, SEEN_FROM, NORMAL3, FOOTPRINT, POINT, LIGHT, LONG = map(np.int64, (20, 23, 26, 29, 30, 33, 36))
GAIN, SIZE, QUARTERS, LEGS, ACROSS, TO_SENSOR, VERDICT, BEND = map(np.int64, (38, 39, 40, 41, 42, 48, 51, 52))
ENERGY, TENT, NUMBERS = 53, 54, 61
DROPPED, SPREAD, CUT, QUARTERED = 0.0, 1.0, 2.0, 3.0
"""What becomes of an element, as in the kernel."""


def room_for_clear() -> tuple[Floats, Floats, Floats]:
    """Unfilled arrays: the stack of clear elements, a batch of elements, and a batch of new vertices."""
    # A batch leaves at most `WIDE` elements more than it took. Halving ends after some 55 levels (`SMALLEST`), so
    # that 256 batches more are ample.
    return np.empty((MOST_CLEAR + 256 * WIDE, STACKED)), np.empty(NUMBERS * WIDE), np.empty(NUMBERS * WIDE)


@compiled()
def put_clear(clear, waiting, cell, k, f, q, lit_from, kind2, values2, seen_from):  # type: ignore[no-untyped-def]
    """Height of the stack of clear elements, after entry k of `cell` was put on it.

    The entry is not put there, and the height stays, if the stack is full, a surface of the path is not Lambertian,
    or one end of the path faces away from the device.

    waiting : height of the stack. f, q : indices of the element's triangle, and of its footprint.
    lit_from, kind2, values2, seen_from : as in `weights.weight`.
    """
    _, n1, to_laser, kind1, values1 = lit_from
    _, n3, to_sensor, kind3, values3 = seen_from
    if waiting >= MOST_CLEAR or kind1 != LAMBERTIAN or kind2 != LAMBERTIAN or kind3 != LAMBERTIAN:
        return waiting
    brdf = values1[0] / math.pi * (values2[0] / math.pi) * (values3[0] / math.pi)
    if dot(n1, to_laser) <= 0.0 or dot(n3, to_sensor) <= 0.0 or not brdf > 0.0:
        return waiting
    for i in range(AREA + 1):
        clear[waiting, i] = cell[k, i]
    clear[waiting, OF], clear[waiting, PATCH], clear[waiting, SHARE], clear[waiting, BRDF] = f, q, cell[k, 16], brdf
    return waiting + 1


@compiled()
def light_at_points(batch, count, x, n1, attenuation):  # type: ignore[no-untyped-def]
    """Set weight, R₁ and R₂ at the points of the first `count` elements of a batch, as `weights.weight` does."""
    for j in range(min(count, WIDE)):
        y = _at(batch, POINT, j)
        # The order of operations is that of `weights.weight`, so that results agree to the last bit.
        d1, d3 = subtract(y, x), subtract(y, _at(batch, SEEN_FROM, j))
        n, n3 = _at(batch, NORMAL, j), _at(batch, NORMAL3, j)
        square1, square3 = dot(d1, d1), dot(d3, d3)
        up1, up3 = dot(d1, n1), dot(d3, n3)
        facing = -dot(d1, n) * -dot(d3, n)
        w = batch[BRDF * WIDE + j] * (up1 * up3) * facing
        w /= square1 * square1 * square3 * (square3 + batch[FOOTPRINT * WIDE + j] / math.pi)
        batch[LIGHT * WIDE + j] = w if (up1 > 0.0) & (up3 > 0.0) & (facing > 0.0) else 0.0
        batch[(LIGHT + 1) * WIDE + j], batch[(LIGHT + 2) * WIDE + j] = math.sqrt(square1), math.sqrt(square3)
    # In a loop of its own, because exponentials are no vector instructions.
    if attenuation > 0.0:
        for j in range(min(count, WIDE)):
            path = batch[(LIGHT + 1) * WIDE + j] + batch[(LIGHT + 2) * WIDE + j]
            batch[LIGHT * WIDE + j] *= transmittance(attenuation, path)


@compiled()
def _at(batch, row, j):  # type: ignore[no-untyped-def]
    """The vector whose components are numbers `row`, `row` + 1 and `row` + 2 of element j of a batch."""
    return (batch[row * WIDE + j], batch[(row + 1) * WIDE + j], batch[(row + 2) * WIDE + j])


@compiled()
def _middles(batch, count):  # type: ignore[no-untyped-def]
    """Set the points of a batch to the middles of its elements; and length and number of their longest sides."""
    for j in range(min(count, WIDE)):
        a, b, c = _at(batch, FIRST, j), _at(batch, SECOND, j), _at(batch, THIRD, j)
        u, v, w = subtract(b, a), subtract(c, b), subtract(a, c)
        ab, bc, ca = dot(u, u), dot(v, v), dot(w, w)
        for i in range(3):
            batch[(POINT + i) * WIDE + j] = (a[i] + b[i] + c[i]) / 3
        batch[LONG * WIDE + j] = math.sqrt(max(ab, bc, ca))
        other = 1.0 if bc >= ca else 2.0
        batch[(LONG + 1) * WIDE + j] = 0.0 if (ab >= bc) & (ab >= ca) else other


@compiled()
def _verdicts(batch, count, x, n1, allowed, clock):  # type: ignore[no-untyped-def]
    """Set the verdicts of a batch whose weights in the middle are known: DROPPED, SPREAD, CUT or QUARTERED.

    allowed : L2 error that an element may make, photons. The decisions are those of `_judge` in the kernel.
    """
    per_metre, attenuation, opens, closes = clock.per_metre, clock.attenuation, clock.opens, clock.closes
    for j in range(min(count, WIDE)):
        z, n3 = _at(batch, SEEN_FROM, j), _at(batch, NORMAL3, j)
        a, b, c = _at(batch, FIRST, j), _at(batch, SECOND, j), _at(batch, THIRD, j)
        # An element wholly below the plane of the laser point or of the footprint gets no light.
        above1 = max(dot(subtract(a, x), n1), dot(subtract(b, x), n1), dot(subtract(c, x), n1))
        above3 = max(dot(subtract(a, z), n3), dot(subtract(b, z), n3), dot(subtract(c, z), n3))
        w = max(batch[LIGHT * WIDE + j], batch[3 * WIDE + j], batch[8 * WIDE + j], batch[13 * WIDE + j])
        paths = (batch[4 * WIDE + j], batch[9 * WIDE + j], batch[14 * WIDE + j])
        r1, r3, size = batch[(LIGHT + 1) * WIDE + j], batch[(LIGHT + 2) * WIDE + j], batch[SIZE * WIDE + j]
        unseen = outside(paths, r1 + r3, batch[LEGS * WIDE + j], size, opens, closes)
        view = (batch[GAIN * WIDE + j], batch[FOOTPRINT * WIDE + j], size, batch[QUARTERS * WIDE + j] > 0.0)
        cut, quarter, norm, bend = verdict(
            paths, (batch[AREA * WIDE + j], w), (batch[LONG * WIDE + j], r1, r3), view, (1.0, allowed),
            (per_metre, attenuation), unseen,
        )  # fmt: skip
        becomes = CUT if cut else SPREAD
        becomes = QUARTERED if quarter else becomes
        dark = (above1 <= 0.0) | (above3 <= 0.0) | (not (quarter | (norm > 0.0)))
        batch[VERDICT * WIDE + j] = DROPPED if dark else becomes
        batch[BEND * WIDE + j] = bend


@compiled()
def _tents(batch, count, per_metre, start):  # type: ignore[no-untyped-def]
    """Set energy and `tent` of each element of a batch, as `_spread` in the kernel has them.

    Elements that are halved or dropped get them as well: computing them is cheaper than a branch.
    """
    for j in range(min(count, WIDE)):
        wa, wb, wc = batch[3 * WIDE + j], batch[8 * WIDE + j], batch[13 * WIDE + j]
        energy = batch[GAIN * WIDE + j] * batch[AREA * WIDE + j]
        energy *= 0.75 * batch[LIGHT * WIDE + j] + 0.25 * (wa + wb + wc) / 3
        zero = (batch[LEGS * WIDE + j] - 0.75 * batch[BEND * WIDE + j]) * per_metre - start
        a = batch[4 * WIDE + j] * per_metre + zero
        b = batch[9 * WIDE + j] * per_metre + zero
        c = batch[14 * WIDE + j] * per_metre + zero
        d3, to_sensor = subtract(_at(batch, POINT, j), _at(batch, SEEN_FROM, j)), _at(batch, TO_SENSOR, j)
        side, other = _at(batch, ACROSS, j), _at(batch, ACROSS + 3, j)
        variance = path_variance(d3, batch[(LIGHT + 2) * WIDE + j], to_sensor, side, other) * per_metre * per_metre
        wide_a, wide_b, wide_c = widened(a, b, c, variance)
        # Both are computed and one is chosen, again without a branch.
        large = batch[SIZE * WIDE + j] * per_metre > AT_ONCE
        a, b, c = wide_a if large else a, wide_b if large else b, wide_c if large else c
        shape = tent(a, b, c, wa, wb, wc, energy)
        batch[ENERGY * WIDE + j] = energy
        for i in range(7):
            batch[(TENT + i) * WIDE + j] = shape[i]


@compiled()
def _copy_to_batch(clear, first, count, batch, normal, p, lit, device, patches):  # type: ignore[no-untyped-def]
    """Copy `count` elements of the stack, from index `first` on, into a batch, with all that belongs to their
    triangles and footprints.

    normal : (F, 3) of triangles. p : row of footprints. device : whether the legs to the device count.
    """
    position3, normal3, to_sensor3, across3 = patches.position, patches.normal, patches.to_sensor, patches.across
    weight3, footprint3, size3, leg3, quarters3 = (
        patches.weight, patches.footprint, patches.size, patches.leg, patches.quarters
    )  # fmt: skip
    for j in range(min(count, WIDE)):
        for i in range(STACKED):
            batch[i * WIDE + j] = clear[first + j, i]
        f, q = int(clear[first + j, OF]), int(clear[first + j, PATCH])
        for i in range(3):
            batch[(NORMAL + i) * WIDE + j] = normal[f, i]
            batch[(SEEN_FROM + i) * WIDE + j], batch[(NORMAL3 + i) * WIDE + j] = position3[p, q, i], normal3[p, q, i]
            batch[(ACROSS + i) * WIDE + j], batch[(ACROSS + 3 + i) * WIDE + j] = (
                across3[p, q, 0, i],
                across3[p, q, 1, i],
            )
            batch[(TO_SENSOR + i) * WIDE + j] = to_sensor3[p, q, i] if device else 0.0
        batch[FOOTPRINT * WIDE + j], batch[SIZE * WIDE + j] = footprint3[p, q], size3[p, q]
        batch[GAIN * WIDE + j] = lit.power * weight3[p, q] * clear[first + j, SHARE]
        batch[QUARTERS * WIDE + j] = 1.0 if quarters3[q, 0] >= 0 else 0.0
        batch[LEGS * WIDE + j] = lit.leg + leg3[p, q] if device else 0.0


@compiled(_nrt=False)
def spread_clear(room, waiting, scan, lit, p, allowed, histogram, into, free):  # type: ignore[no-untyped-def]
    """Halve the `waiting` elements of the stack as often as needed, and add their light to row `into` of a histogram.

    lit : the laser point. p : row of footprints. allowed : L2 error that an element may make, photons.
    free : index behind the last list of possible occluders.

    Returns the number of elements that still wait on this stack, the number whose light was added, the photons
    outside the window of time, and the number of elements that now wait on the kernel's stack to be seen from
    quarters of their footprints; after `MOST_QUARTERED` of these, no more elements are taken.
    """
    clear, batch, cuts, tag, cell = room.clear, room.batch, room.cuts, room.tag, room.cell
    x, n1, clock, smallest = lit.x, lit.normal, scan.clock, SMALLEST * scan.tree.extent
    cells, lost, top = 0, 0.0, 0
    while waiting > 0 and top < MOST_QUARTERED:
        count = min(waiting, WIDE)
        waiting -= count
        _copy_to_batch(clear, waiting, count, batch, scan.tree.normal, p, lit, clock.device, scan.patches)
        _middles(batch, count)
        light_at_points(batch, count, x, n1, clock.attenuation)
        _verdicts(batch, count, x, n1, allowed, clock)
        _tents(batch, count, clock.per_metre, clock.start)
        halves = 0
        for j in range(min(count, WIDE)):
            becomes = batch[VERDICT * WIDE + j]
            if becomes == SPREAD:
                shape = (
                    batch[TENT * WIDE + j], batch[(TENT + 1) * WIDE + j], batch[(TENT + 2) * WIDE + j],
                    batch[(TENT + 3) * WIDE + j], batch[(TENT + 4) * WIDE + j], batch[(TENT + 5) * WIDE + j],
                    batch[(TENT + 6) * WIDE + j],
                )  # fmt: skip
                lost += pour(histogram, into, shape, batch[ENERGY * WIDE + j])
                cells += 1
            elif becomes == CUT and batch[LONG * WIDE + j] > smallest:
                # Only the new vertex is noted here, so that weights at all new vertices are computed in one loop.
                side = 5 * int(batch[(LONG + 1) * WIDE + j])
                y = half(_at(batch, side, j), _at(batch, (side + 5) % 15, j))
                for i in range(3):
                    cuts[(POINT + i) * WIDE + halves] = y[i]
                for i in range(BRDF, FOOTPRINT + 1):
                    cuts[i * WIDE + halves] = batch[i * WIDE + j]
                cuts[halves] = j
                halves += 1
            elif becomes == QUARTERED:
                # It is still clear for the laser point, but the kernel has to find out what hides it from a quarter.
                for i in range(AREA + 1):
                    cell[top, i] = batch[i * WIDE + j]
                cell[top, 16], cell[top, 17] = batch[SHARE * WIDE + j], 0.0
                f, q = int(batch[OF * WIDE + j]), int(batch[PATCH * WIDE + j])
                top = push(tag, top, KEPT, f, q, (free, free, free))
        light_at_points(cuts, np.int64(halves), x, n1, clock.attenuation)
        for k in range(min(halves, WIDE)):
            j = int(cuts[k])
            side = 5 * int(batch[(LONG + 1) * WIDE + j])
            # Each half has the new vertex in place of one end of the side that was cut.
            for vertex in (side, (side + 5) % 15):
                for i in range(STACKED):
                    clear[waiting, i] = batch[i * WIDE + j]
                clear[waiting, AREA] *= 0.5
                for i in range(4):
                    clear[waiting, vertex + i] = cuts[(POINT + i) * WIDE + k]
                clear[waiting, vertex + 4] = cuts[(LIGHT + 1) * WIDE + k] + cuts[(LIGHT + 2) * WIDE + k]
                waiting += 1
    return waiting, cells, lost, top
