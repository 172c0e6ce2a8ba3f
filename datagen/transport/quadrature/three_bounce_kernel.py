"""The primary of laser points and pixels: surfaces cut into elements, each of them spread over its arrival times.

A surface element is a triangle or a part of one. Its energy is exact for weights (`weights.py`) of second degree:
three quarters of the weight in the middle and a quarter of the mean over the vertices. For its distribution over
time, weights and arrival times are taken as linear over the element, and the times are moved so that their mean is
exact for times of second degree.

`gather` goes through all pairs. `_gather_part` takes boxes of the BVH and elements from a stack, one after another;
the functions below it decide what becomes of each, and what is divided goes back on the stack.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from datagen.compiled import compiled
from datagen.records.arrays import Floats, Ints
from datagen.transport.brdf import LAMBERTIAN, Vector, dot
from datagen.transport.geometry import above, bounding_sphere, corner, distance, get, half, subtract
from datagen.transport.arrival_times import spread, widened
from datagen.transport.quadrature.clear_elements import put_clear, room_for_clear, spread_clear
from datagen.transport.quadrature.clusters import (
    COARSEST,
    facing_at_most,
    is_small,
    point_on_triangle,
    point_on_triangles,
    side_turned,
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
    AT_ONCE,
    OUTSIDE,
    footprint_variance,
    light_at_most,
    outside,
    verdict,
    weight,
    weight_at_most,
)
from datagen.transport.sampling import mix, word_of
from datagen.transport.bvh import CLUSTER, SMALLEST
from datagen.transport.visibility.occlusion import LISTED, RING, hidden, lists, narrowed, shaded

PARTLY, UNFOUND, MESH = (0.5, 0.05), 0.05, 256
"""Expected error of an element, relative to its light: of an element that a single shadow ray decides, on a part of
up to `MESH` triangles and on a larger part (`PARTLY`); and of an element of which three shadow rays found nothing, or
all (`UNFOUND`). On parts of few triangles most elements are proven clear, and those that are left are often partly
hidden. On meshes hardly anything is proven, but few elements are partly hidden, and their errors have both signs,
because rays go to random points: twice the second number takes up to a third more rays, half of it as many. Half of
`UNFOUND` may miss more of what is seen through gaps, and more thin things that hide something."""
STILL_UNFOUND = 0.5
"""Factor by which `UNFOUND` falls with each halving after which rays again find nothing, or all: what lies deep
behind a mesh cannot be proven hidden, and is not searched as finely as the edge of a shadow. Half of it searches
less."""
PLACES = 2.0**20
"""Steps along the scene's size to which positions are rounded before they seed an element's random points. Half of
it lets twice as many elements along a line have the same points."""
TURNS, FEWEST = 16, 1 / 64
"""Light of an element up to which one quarter of an uneven footprint stands for all four: relative to the error
that an element may make, and to the upper bound of all the part's light."""
CROSSED = 0.05
"""Change of a lobe over a footprint, relative to the lobe, up to which the footprint's middle stands for it. Half of
it changes little: boxes then take turns with quarters at one level more."""
DROPPED, OPENED, QUARTERED, IN_TURN, ONE_POINT, CUT, CLEAR, SPREAD = range(8)
"""What becomes of a box or element: it brings no light; what is in the box is put on the stack; it is put on the
stack once for each quarter of the footprint, or once for a quarter, chosen in turn, that stands for all four; one
random point stands for the box; the element is halved; it waits on the stack of clear elements; its light is added
to the histogram."""
STEP = {"forceinline": True, "_nrt": False}
"""How the steps of `_gather_part` are compiled. Calls would cost more than many of them; and without `_nrt=False`
arrays are counted in and out of every function, a third of the time."""


class Lit(NamedTuple):
    """A laser point.

    Attributes
    ----------
    x, normal : position, metres, and unit normal.
    vertex : position, normal and BRDF, as `weights.weight` takes them.
    part : part index.
    power : photons that arrive per photon emitted.
    leg : distance from the laser, metres.
    """

    x: Vector
    normal: Vector
    vertex: Any
    part: int
    power: float
    leg: float


class View(NamedTuple):
    """A footprint, and what all light that a part sends there has in common.

    Attributes
    ----------
    p, q : row and index of the footprint.
    z, normal : position, metres, and unit normal.
    vertex : position, normal and BRDF, as `weights.weight` takes them.
    size, area, quarters : largest extent, metres; area, m²; and whether it has quarters.
    bent : whether it has quarters that are turned against its middle: they may see what lies below its plane.
    gain : photons per unit of weight and of the element's area, m².
    allowed, allowed_alike : L2 error that one element may make, photons, if its errors for different footprints are
        independent, and if they are alike.
    keen : 1/width² of the narrowest lobe on the path.
    device : length of the legs from the laser and to the sensor, metres; 0 if they do not count.
    word : random word of the footprint and part, which each element combines with its place.
    """

    p: int
    q: int
    z: Vector
    normal: Vector
    vertex: Any
    size: float
    area: float
    quarters: bool
    bent: bool
    gain: float
    allowed: float
    allowed_alike: float
    keen: float
    device: float
    word: np.uint64


class Element(NamedTuple):
    """A surface element: a triangle of the scene or a part of one.

    Attributes
    ----------
    f : number of the triangle in the BVH. m, n : the element's middle, metres, and its unit normal.
    h, side : length of its longest side, metres, and which side (0–2) that is.
    w, r1, r3 : `weight` in the middle, and the distances from there to laser point and footprint, metres.
    rise1, rise3 : height of laser point and footprint above the element's plane, metres.
    """

    f: int
    m: Vector
    n: Vector
    h: float
    side: int
    w: float
    r1: float
    r3: float
    rise1: float
    rise3: float


class Room(NamedTuple):
    """Scratch arrays of `gather`: the stack (`tag` and `cell`), lists of possible occluders (`listed`), and the
    arrays of `room_for_clear`."""

    tag: Ints
    cell: Floats
    listed: Ints
    clear: Floats
    batch: Floats
    cuts: Floats

    @classmethod
    def new(cls) -> Room:
        """Arrays that are large enough for any scene: each halving leaves one element more on the stack, each
        quartering three."""
        return cls(np.empty((1024, 6), np.int64), np.empty((1024, 18)), lists(1 << 14), *room_for_clear())


@compiled(_nrt=False)
def gather(pairs, scan, by_rays, tally, room):  # type: ignore[no-untyped-def]
    """Add the primary of laser points and pixels to their histograms.

    pairs : (n, 2) laser point and row of footprints of each. scan, tally : `Scan` and `Tally`.
    by_rays : (K,) parts whose light comes by rays. room : `Room`.
    """
    lasers, patches, strongest, left = scan.lasers, scan.patches, 0.0, tally.most_work
    for k in range(len(scan.cutting.peak)):
        strongest = max(strongest, scan.cutting.peak[k])
    for pair in range(len(pairs)):
        i, p = pairs[pair, 0], pairs[pair, 1]
        if lasers.part[i] < 0 or (patches.part[p, 0] < 0 and not patches.uneven[p, 0]):
            continue
        x, n, k1 = get(lasers.position, i, 0), get(lasers.normal, i, 0), lasers.part[i]
        vertex = (x, n, get(lasers.to_laser, i, 0), scan.kind[k1], scan.values[k1])
        lit = Lit(x, n, vertex, k1, lasers.power[i], lasers.leg[i])
        # Where pixel and laser point are one, what hides an element from the one hides it from the other.
        apart = distance(x, corner(patches.position, p, 0)) > scan.occluders.flat
        two_legs = scan.cutting.rays_on_last_leg and apart
        for k in range(len(scan.tree.roots)):
            if scan.cutting.error[k] < np.inf and not by_rays[k]:
                left -= _gather_part(pair, p, k, lit, two_legs, strongest, left, scan, tally, room)
        if left < 0:
            # The rest would be in vain: `Gathering.gathered` gives up.
            return


@compiled(_nrt=False)
def _gather_part(pair, p, k, lit, two_legs, strongest, left, scan, tally, room):  # type: ignore[no-untyped-def]
    """Number of elements and shadow rays that it took to add the light of part k to the histogram of one pair.

    p : the pair's row of footprints. left : number from which on nothing more is added.

    The possible occluders of an element are among those of the box or element that contains it. So each entry of the
    stack has lists of them, which `candidates` bounds: first … middle − 1 on the leg to the laser point, middle …
    last − 1 on the leg to the footprint. If both lists are empty, the element needs no shadow ray. Halves of an
    element also take over the weights at its vertices.
    """
    tree, patches, tag, cell = scan.tree, scan.patches, room.tag, room.cell
    allowed, into = scan.cutting.error[k], tally.row_of_pair[pair] + tally.row_of_part[k]
    number, root, some = tally.number[pair], tree.roots[k], min(scan.occluders.triangles, 1)
    turn = np.int64(word_of(scan.cutting.seed[k], number, k) >> np.uint64(8))
    to_z, free = LISTED + some, LISTED + 2 * some
    most, cells, rays, alight = np.inf, 0, 0, np.int64(0)
    cell[0, 16], cell[0, 17] = 1.0, UNFOUND
    top = push(tag, 0, BOX, root, 0, (LISTED, to_z, free if two_legs else to_z))
    while (top > 0 or alight > 0) and cells + rays <= left:
        if top == 0:
            # Clear elements are worked off together, so they wait until nothing else is left.
            alight, more, beyond, top = spread_clear(room, alight, scan, lit, p, allowed, tally.histogram, into, free)
            cells, tally.overflow[into] = cells + more, tally.overflow[into] + beyond
            continue
        top -= 1
        what, at, q = tag[top, 0], tag[top, 1], tag[top, 2]
        candidates = (tag[top, 3], tag[top, 4], tag[top, 5])
        uneven = patches.uneven[p, q] and patches.quarters[q, 0] >= 0
        if patches.part[p, q] < 0 and not uneven:
            continue
        share = cell[top, 16]
        if uneven:
            # An edge runs through the footprint: its middle does not represent it, no element is judged there.
            at_most, halve, side = _brightest(scan, lit, p, q, what, at, cell, top, k, strongest)
            if what == BOX and q == 0 and at == root:
                most = at_most
            if at_most < 0.0:
                continue
            # Where the light is little whatever the footprint sees, one of its quarters stands for all four. Elements
            # take turns with the four, so that errors of neighbours cancel.
            few = at_most <= min(TURNS * allowed, most * FEWEST)
            turn += few and share == 1.0
            if few or not halve:
                only = _digit(turn, share) if few else -1
                top = _quarter(scan, room, top, what, at, q, candidates, only)
            elif what == BOX:
                top = push_boxes(tag, cell, top, tree.children[at], q, candidates)
            else:
                y = half(vertex_of(cell, top, side), vertex_of(cell, top, (side + 1) % 3))
                top = push_halves(room, top, side, (y, 0.0, 0.0), FRESH, at, q, candidates)
            continue
        view = _view(scan, lit, p, q, k, share, number)
        becomes, only = SPREAD, -1
        if what == BOX:
            becomes = _of_box(scan, lit, view, at, k)
            if becomes == IN_TURN:
                becomes, only, turn = QUARTERED, _digit(turn, share), turn + (share == 1.0)
            if becomes == ONE_POINT:
                counted, asked = _one_point(scan, lit, view, at, k, candidates, room.listed, tally, into)
                cells, rays = cells + counted, rays + asked
                continue
            if becomes == DROPPED:
                continue
        else:
            becomes = _light_at_vertices(scan, lit, view, what, at, k, candidates, room, top, alight)
            alight += becomes == CLEAR
            if becomes in (DROPPED, CLEAR):
                continue
            if becomes == SPREAD:
                element = _as_element(scan, lit, view, at, k, cell, top)
                becomes, over, bend = _judge(scan, lit, view, element, k, cell, top)
            if becomes == DROPPED:
                continue
            if becomes != QUARTERED:
                becomes, asked = _look(scan, lit, view, element, k, becomes, over, candidates, room, top)
                rays += asked
                if becomes == DROPPED:
                    continue
                if becomes == CUT:
                    candidates = _narrow(scan, lit, view, element, candidates, room, top)
        if becomes == QUARTERED:
            top = _quarter(scan, room, top, what, at, q, candidates, only)
        elif what == BOX:
            top = _open(scan, room, top, at, q, candidates)
        elif becomes == CUT:
            if element.h > SMALLEST * tree.extent:
                # Across the longest side, so that halves of halves do not become needles.
                side = element.side
                y = half(vertex_of(cell, top, side), vertex_of(cell, top, (side + 1) % 3))
                w, r1, r3 = weight(
                    y, element.n, scan.kind[k], scan.values[k], lit.vertex, view.vertex, view.area,
                    scan.clock.attenuation,
                )  # fmt: skip
                top = push_halves(room, top, side, (y, w, r1 + r3), CELL, at, q, candidates)
        else:
            cells += 1
            tally.overflow[into] += _spread(scan, view, element, bend, cell, top, tally.histogram, into)
    tally.work[k, 0] += cells
    tally.work[k, 1] += rays
    return cells + rays


@compiled()
def _digit(turn, share):  # type: ignore[no-untyped-def]
    """Index (0–3) of the quarter that stands for all four: digit log₄(share) of `turn` in base 4, the last digit
    first.

    turn : running number of such elements. share : number of footprints that the present footprint stands for, 4 to
    the power of the number of quarterings so far in which one stood for all.
    """
    while share > 1.0:
        turn >>= 2
        share *= 0.25
    return turn & 3


@compiled(**STEP)
def _view(scan, lit, p, q, k, share, number):  # type: ignore[no-untyped-def]
    """The `View` from footprint q of row p to elements of part k; the footprint stands for `share` footprints.

    number : of the pair of laser point and pixel (`Tally.number`).
    """
    patches, cutting = scan.patches, scan.cutting
    z, n, k3 = corner(patches.position, p, q), corner(patches.normal, p, q), patches.part[p, q]
    vertex = (z, n, corner(patches.to_sensor, p, q), scan.kind[k3], scan.values[k3])
    keen = max(cutting.sharp[lit.part], cutting.sharp[k], cutting.sharp[k3])
    # With lobes, all footprints of a pixel err alike, so that each may make its part of the error only; errors of
    # shadow rays to random points are independent, and grow as the root of their number.
    of_pixel = share * patches.fraction[q] if keen > 1.0 else 1.0
    allowed, allowed_alike = cutting.error[k] * math.sqrt(of_pixel), cutting.error[k] * of_pixel
    device = lit.leg + patches.leg[p, q] if scan.clock.device else 0.0
    word = mix(mix(np.uint64(cutting.seed[k]), np.uint64(number)), np.uint64(q))
    quarters = patches.quarters[q, 0] >= 0
    return View(
        p, q, z, n, vertex, patches.size[p, q], patches.footprint[p, q], quarters, quarters and patches.bent[p, q],
        lit.power * patches.weight[p, q] * share, allowed, allowed_alike, keen, device, word,
    )  # fmt: skip


@compiled(**STEP)
def _brightest(scan, lit, p, q, what, at, cell, top, k, strongest):  # type: ignore[no-untyped-def]
    """Upper bound of the photons from a box or element to an uneven footprint, −1 if there are none; whether the box
    or element is so large that it is divided before the footprint is quartered; and number of its longest side."""
    tree, patches, size, side = scan.tree, scan.patches, scan.patches.size[p, q], 0
    if what == BOX:
        m, h = bounding_sphere(tree.box, at)
        area = tree.area[tree.span[at, 1]] - tree.area[tree.span[at, 0]]
        rise, height = above(tree.box, at, lit.x, lit.normal), np.inf
        halve = tree.children[at, 0] >= 0 and h > size
    else:
        m, side, h = middle_of(cell, top)
        area, rise = cell[top, 15], highest_above(cell, top, lit.x, lit.normal)
        height = abs(dot(subtract(lit.x, vertex_of(cell, top, 0)), get(tree.normal, at, 0)))
        halve = h > max(size, SMALLEST * tree.extent)
    if rise <= 0.0 or patches.most_weight[p, q] <= 0.0:
        return -1.0, halve, side
    peak = scan.cutting.peak
    at_most = cell[top, 16] * lit.power * patches.most_weight[p, q] * peak[lit.part] * peak[k] * strongest
    z, attenuation = corner(patches.position, p, q), scan.clock.attenuation
    return at_most * light_at_most(m, h, area, rise, height, lit.x, z, size, attenuation), halve, side


@compiled(**STEP)
def _of_box(scan, lit, view, at, k):  # type: ignore[no-untyped-def]
    """What becomes of a box of the BVH: DROPPED, OPENED, QUARTERED, IN_TURN or ONE_POINT."""
    tree, x, z = scan.tree, lit.x, view.z
    rise1 = above(tree.box, at, x, lit.normal)
    rise3 = np.inf if view.bent else above(tree.box, at, z, view.normal)
    # A large footprint may see what lies behind the plane of its middle.
    if rise1 <= 0.0 or (rise3 <= 0.0 and view.size <= 0.0):
        return DROPPED
    start, end = tree.span[at, 0], tree.span[at, 1]
    if end - start <= CLUSTER:
        return OPENED
    m, h = bounding_sphere(tree.box, at)
    axis, cosine = get(tree.cone, at, 0), tree.cone[at, 3]
    sine = math.sqrt(max(1.0 - cosine * cosine, 0.0))
    sides = side_turned(subtract(x, m), h, axis, cosine, sine) * side_turned(subtract(z, m), h, axis, cosine, sine)
    # The side that is lit is not the one that the footprint's middle sees; parts of a large footprint may see it.
    if sides < 0 and not view.quarters:
        return DROPPED
    area, peak, attenuation = tree.area[end] - tree.area[start], scan.cutting.peak, scan.clock.attenuation
    at_most = view.gain * peak[lit.part] * peak[k] * peak[scan.patches.part[view.p, view.q]] * area
    at_most *= facing_at_most(m, h, axis, cosine, sine, x, rise1)
    at_most *= facing_at_most(m, h + view.size, axis, cosine, sine, z, rise3 + view.size)
    small, near3 = is_small(tree.box, at, x, z, at_most, view.allowed, attenuation)
    if sides > 0 and not small and not view.bent:
        # The peak of a lobe is far more than what a box turned away from it brings.
        tilt = math.acos(max(cosine, -1.0))
        at_most = view.gain * area * weight_at_most(
            m, axis, scan.kind[k], scan.values[k], lit.vertex, view.vertex, view.area, attenuation, 2.0 * h,
            view.size, tilt,
        )  # fmt: skip
        small = at_most <= view.allowed and 2.0 * h <= COARSEST * near3
    if small and view.quarters and view.size > 0.3 * near3:
        return QUARTERED
    if small and view.quarters and view.keen > 1.0 and view.keen * view.size * view.size > CROSSED * near3 * near3:
        # A lobe changes over the footprint, whose middle would err alike for all boxes.
        return IN_TURN
    return ONE_POINT if small else OPENED


@compiled(**STEP)
def _one_point(scan, lit, view, at, k, candidates, listed, tally, into):  # type: ignore[no-untyped-def]
    """Let one random point stand for a faint box; returns the elements spread and the rays asked, 0 or 1 each."""
    tree, x, clock = scan.tree, lit.x, scan.clock
    start, end, m = tree.span[at, 0], tree.span[at, 1], bounding_sphere(tree.box, at)[0]
    f, y = point_on_triangles(start, end, tree.area, tree.corners, _word_at(view.word, subtract(m, x), tree.extent))
    n = get(tree.normal, f, 0)
    w, r1, r3 = weight(
        y, n, scan.kind[k], scan.values[k], lit.vertex, view.vertex, view.area, clock.attenuation
    )  # fmt: skip
    if not w > 0.0:
        return 0, 0
    if _seen(y, x, view.z, f, candidates, scan.occluders.row, listed):
        t, path = (r1 + r3 + view.device) * clock.per_metre - clock.start, subtract(y, view.z)
        variance = footprint_variance(path, view.vertex[2], clock.device, scan.patches.across, view.p, view.q)
        at_a, at_b, at_c = widened(t, t, t, variance * clock.per_metre * clock.per_metre)
        energy = w * view.gain * (tree.area[end] - tree.area[start])
        tally.overflow[into] += spread(tally.histogram, into, at_a, at_b, at_c, 1.0, 1.0, 1.0, energy)
    return 1, 1


@compiled(**STEP)
def _light_at_vertices(  # type: ignore[no-untyped-def]
    scan, lit, view, what, f, k, candidates, room, top, alight
):  # fmt: skip
    """What becomes of the element at `top`, on triangle f: DROPPED, QUARTERED, CLEAR (it was put on the stack of
    clear elements) or SPREAD (it has to be judged).

    A fresh element gets the weights at its vertices. alight : height of the stack of clear elements.
    """
    tree, cell, x, z, flat = scan.tree, room.cell, lit.x, view.z, scan.occluders.flat
    n, a, kind2, values2 = get(tree.normal, f, 0), vertex_of(cell, top, 0), scan.kind[k], scan.values[k]
    rise1, rise3 = dot(subtract(x, a), n), dot(subtract(z, a), n)
    # The element lies below the laser point's surface, or the laser point in the element's plane.
    if highest_above(cell, top, x, lit.normal) <= 0.0 or abs(rise1) < flat:
        return DROPPED
    if highest_above(cell, top, z, view.normal) <= 0.0:
        return QUARTERED if _seen_round_bend(scan, lit, view, f, k, cell, top) else DROPPED
    if what == FRESH:
        for j in range(3):
            y = vertex_of(cell, top, j)
            w, r1, r3 = weight(
                y, n, kind2, values2, lit.vertex, view.vertex, view.area, scan.clock.attenuation
            )  # fmt: skip
            put_vertex(cell, top, j, y, w, r1 + r3)
    first, _, last = candidates
    if first == last and what != KEPT and rise1 * rise3 > 0.0 and abs(rise3) > flat:
        waiting = put_clear(room.clear, alight, cell, top, f, view.q, lit.vertex, kind2, values2, view.vertex)
        return CLEAR if waiting > alight else SPREAD
    return SPREAD


@compiled(**STEP)
def _seen_round_bend(scan, lit, view, f, k, cell, top):  # type: ignore[no-untyped-def]
    """Whether the element at `top`, on triangle f, might send more light than it may miss to parts of the footprint
    that are turned against its middle, which does not see the element."""
    if not view.bent:
        return False
    m, _, h = middle_of(cell, top)
    rise = highest_above(cell, top, lit.x, lit.normal)
    height = abs(dot(subtract(lit.x, vertex_of(cell, top, 0)), get(scan.tree.normal, f, 0)))
    peak, area = scan.cutting.peak, cell[top, 15]
    at_most = view.gain * peak[lit.part] * peak[k] * peak[scan.patches.part[view.p, view.q]]
    at_most *= light_at_most(m, h, area, rise, height, lit.x, view.z, view.size, scan.clock.attenuation)
    return at_most > view.allowed_alike


@compiled(**STEP)
def _as_element(scan, lit, view, f, k, cell, top):  # type: ignore[no-untyped-def]
    """The `Element` at `top` of the stack, which lies on triangle f."""
    n, a, (m, side, h) = get(scan.tree.normal, f, 0), vertex_of(cell, top, 0), middle_of(cell, top)
    w, r1, r3 = weight(
        m, n, scan.kind[k], scan.values[k], lit.vertex, view.vertex, view.area, scan.clock.attenuation
    )  # fmt: skip
    rise1, rise3 = dot(subtract(lit.x, a), n), dot(subtract(view.z, a), n)
    return Element(f, m, n, h, side, w, r1, r3, rise1, rise3)


@compiled(**STEP)
def _judge(scan, lit, view, element, k, cell, top):  # type: ignore[no-untyped-def]
    """What becomes of an element that nothing hides: DROPPED, QUARTERED, CUT or SPREAD; the L2 error if all its light
    were missing, photons; and the `bend` of its arrival times (`weights.verdict`)."""
    clock, kind2, values2, m, n = scan.clock, scan.kind[k], scan.values[k], element.m, element.n
    bright, size, h, rise3 = element.w, view.size, element.h, element.rise3
    if lit.vertex[3] != LAMBERTIAN or kind2 != LAMBERTIAN or view.vertex[3] != LAMBERTIAN:
        # A lobe may cross the element between the points where its weight is known.
        bright = max(bright, weight_at_most(
            m, n, kind2, values2, lit.vertex, view.vertex, view.area, clock.attenuation, h, size, 0.0
        ))  # fmt: skip
    paths, r1, r3 = (cell[top, 4], cell[top, 9], cell[top, 14]), element.r1, element.r3
    unseen = outside(paths, r1 + r3, view.device, size, clock.opens, clock.closes)
    w = max(bright, cell[top, 3], cell[top, 8], cell[top, 13])
    cut, quarter, norm, bend = verdict(
        paths, (cell[top, 15], w), (h, r1, r3), (view.gain, view.area, size, view.quarters),
        (view.keen, view.allowed_alike), (clock.per_metre, clock.attenuation), unseen,
    )  # fmt: skip
    if element.rise1 * rise3 <= 0.0 or abs(rise3) < scan.occluders.flat:
        # The lit side faces away from the footprint's middle. A large footprint may reach above the element's plane:
        # the light that arrives `size` above the plane bounds what is lost if this is neglected.
        if _seen_round_bend(scan, lit, view, element.f, k, cell, top):
            return QUARTERED, norm, bend
        if not (view.quarters and abs(rise3) < size):
            return DROPPED, norm, bend
        rise, z = math.copysign(size, element.rise1), view.z
        z_lit = (z[0] + rise * n[0], z[1] + rise * n[1], z[2] + rise * n[2])
        _, n3, to_sensor, kind3, values3 = view.vertex
        if view.gain * cell[top, 15] * weight_at_most(
            m, n, kind2, values2, lit.vertex, (z_lit, n3, to_sensor, kind3, values3), view.area,
            clock.attenuation, h, size, 0.0,
        ) <= view.allowed_alike:  # fmt: skip
            return DROPPED, norm, bend
        quarter = True
    if not (quarter or norm > 0.0):
        return DROPPED, norm, bend
    return QUARTERED if quarter else CUT if cut else SPREAD, OUTSIDE * norm if unseen else norm, bend


@compiled(**STEP)
def _look(scan, lit, view, element, k, becomes, at_stake, candidates, room, top):  # type: ignore[no-untyped-def]
    """What becomes of an element by what shadow rays find of it, DROPPED, CUT or SPREAD; and the number of rays.

    becomes : what becomes of it if nothing hides it, CUT or SPREAD. at_stake : L2 error if all its light were
    missing, photons.
    """
    first, _, last = candidates
    if first == last:
        return becomes, 0
    if becomes == CUT:
        # It gets no rays, because rays to its halves tell more. Without a proof that it is hidden, triangles that lie
        # beneath darker ones would be halved for minutes.
        return DROPPED if _proven_hidden(scan, lit, view, element, candidates, room, top) else CUT, 0
    tree, cell = scan.tree, room.cell
    mesh = tree.span[tree.roots[k], 1] - tree.span[tree.roots[k], 0] > MESH
    # One ray to a random point is right on average; it is enough where its error is small.
    count = 1 if (PARTLY[1] if mesh else PARTLY[0]) * at_stake <= view.allowed else 3
    seen, rays = _points_seen(scan, lit, view, element, count, candidates, room, top)
    if count == 1:
        return SPREAD if seen > 0 else DROPPED, rays
    # Some of the element may be seen although three rays found nothing, and some of it hidden although all three
    # found it: it is halved if that might be too much. If it were halved in one of the two cases only, errors of
    # elements across the edges of shadows would not cancel.
    cut = 0 < seen < 3 or cell[top, 17] * at_stake > view.allowed
    if seen == 0 and (not cut or _proven_hidden(scan, lit, view, element, candidates, room, top)):
        return DROPPED, rays
    cell[top, 17] = UNFOUND if 0 < seen < 3 else STILL_UNFOUND * cell[top, 17]
    return CUT if cut else SPREAD, rays


@compiled(**STEP)
def _proven_hidden(scan, lit, view, element, candidates, room, top):  # type: ignore[no-untyped-def]
    """Whether it is proven that one triangle hides all of an element from the laser point or from the footprint."""
    (first, middle, last), row, listed, cell = candidates, scan.occluders.row, room.listed, room.cell
    a, b, c = vertex_of(cell, top, 0), vertex_of(cell, top, 1), vertex_of(cell, top, 2)
    return (first < middle and shaded(lit.x, a, b, c, element.f, first, middle, row, listed)) or (
        middle < last and shaded(view.z, a, b, c, element.f, middle, last, row, listed)
    )


@compiled(**STEP)
def _points_seen(scan, lit, view, element, count, candidates, room, top):  # type: ignore[no-untyped-def]
    """Number of random points of an element, out of `count` (1 or 3), that the laser point lights and the footprint
    sees; and number of points tried, fewer than `count` as soon as some are seen and some are not."""
    tree, x, z, m, cell = scan.tree, lit.x, view.z, element.m, room.cell
    seen, rays = 0, 0
    word_here = _word_at(view.word, subtract(m, x), tree.extent)
    for j in range(count):
        rays, word = rays + 1, word_here if count == 1 else mix(word_here, np.uint64(j))
        if count == 1:
            y = point_on_triangle(vertex_of(cell, top, 0), vertex_of(cell, top, 1), vertex_of(cell, top, 2), word)
        else:
            # One point in each of the three triangles between the middle and a side, so that they lie apart.
            y = point_on_triangle(m, vertex_of(cell, top, j), vertex_of(cell, top, (j + 1) % 3), word)
        seen += _seen(y, x, z, element.f, candidates, scan.occluders.row, room.listed)
        if 0 < seen <= j:
            break
    return seen, rays


@compiled()
def _word_at(word, y, extent):  # type: ignore[no-untyped-def]
    """Random word of the place y, a vector from the laser point, metres. It depends neither on where the scene lies
    nor on the order of its triangles."""
    per = PLACES / extent
    for j in range(3):
        # Without an offset, places level with the laser point would be rounded up or down by chance.
        word = mix(word, np.uint64(np.int64(math.floor(y[j] * per + 0.382))))
    return word


@compiled()
def _seen(y, x, z, f, candidates, hides, listed):  # type: ignore[no-untyped-def]
    """Whether the laser point x lights y on triangle f and the footprint at z sees it."""
    first, middle, last = candidates
    if first < middle and hidden(x, y, f, first, middle, hides, listed) > 0:
        return False
    return middle == last or hidden(z, y, f, middle, last, hides, listed) == 0


@compiled(**STEP)
def _narrow(scan, lit, view, element, candidates, room, top):  # type: ignore[no-untyped-def]
    """Bounds of the lists of those candidates that may hide some of the element at `top`, for its halves.

    Many halves then have empty lists and need no rays.
    """
    (first, middle, last), listed, cell, f = candidates, room.listed, room.cell, element.f
    # `narrowed` needs room for a ring of boxes on each leg.
    if not first < last < len(listed) - 4 * RING:
        return candidates
    a, b, c = vertex_of(cell, top, 0), vertex_of(cell, top, 1), vertex_of(cell, top, 2)
    row = scan.occluders.row
    half_way = narrowed(lit.x, a, b, c, f, first, middle, last, row, listed)
    return last, half_way, narrowed(view.z, a, b, c, f, middle, last, half_way, row, listed)


@compiled(**STEP)
def _quarter(scan, room, top, what, at, q, candidates, only):  # type: ignore[no-untyped-def]
    """New height of the stack, after the box or element at `top` was put there once for each quarter of footprint q,
    or once for quarter `only` ≥ 0, which then stands for all four."""
    tag, cell, listed, quarters = room.tag, room.cell, room.listed, scan.patches.quarters
    first, middle, last = candidates
    # Seen from another point of the wall, other things may hide the element: the list for that leg starts anew. The
    # list for the laser point stays.
    for j in range(middle - first):
        listed[last + j] = listed[first + j]
    first, middle = last, last + middle - first
    last = middle + (min(scan.occluders.triangles, 1) if scan.cutting.rays_on_last_leg else 0)
    listed[middle] = 0
    cell[top, 17] = UNFOUND
    kept = BOX if what == BOX else FRESH
    if only >= 0:
        cell[top, 16] = 4.0 * cell[top, 16]
        return push(tag, top, kept, at, quarters[q, only], (first, middle, last))
    here = top
    for j in range(4):
        copy_cell(cell, here, top)
        top = push(tag, top, kept, at, quarters[q, j], (first, middle, last))
    return top


@compiled(**STEP)
def _open(scan, room, top, at, q, candidates):  # type: ignore[no-untyped-def]
    """New height of the stack, after the two boxes within box `at`, or its triangles, were put there."""
    tree, tag, cell = scan.tree, room.tag, room.cell
    start, end = tree.span[at, 0], tree.span[at, 1]
    if end - start > CLUSTER:
        return push_boxes(tag, cell, top, tree.children[at], q, candidates)
    share, unfound = cell[top, 16], cell[top, 17]
    for f in range(start, end):
        for j in range(3):
            put_vertex(cell, top, j, corner(tree.corners, f, j), 0.0, 0.0)
        cell[top, 15], cell[top, 16], cell[top, 17] = tree.area[f + 1] - tree.area[f], share, unfound
        top = push(tag, top, FRESH, f, q, candidates)
    return top


@compiled(**STEP)
def _spread(scan, view, element, bend, cell, top, histogram, into):  # type: ignore[no-untyped-def]
    """Photons outside the window of time, after the light of the element at `top` was added to row `into`."""
    per_metre, wa, wb, wc = scan.clock.per_metre, cell[top, 3], cell[top, 8], cell[top, 13]
    energy = view.gain * cell[top, 15] * (0.75 * element.w + 0.25 * (wa + wb + wc) / 3)
    zero = (view.device - 0.75 * bend) * per_metre - scan.clock.start
    at_a, at_b, at_c = (
        cell[top, 4] * per_metre + zero, cell[top, 9] * per_metre + zero, cell[top, 14] * per_metre + zero
    )  # fmt: skip
    if view.size * per_metre > AT_ONCE:
        # Light reaches the footprint over a range of times.
        path, across = subtract(element.m, view.z), scan.patches.across
        variance = (
            footprint_variance(path, view.vertex[2], scan.clock.device, across, view.p, view.q)
            * per_metre
            * per_metre
        )
        at_a, at_b, at_c = widened(at_a, at_b, at_c, variance)
    return spread(histogram, into, at_a, at_b, at_c, wa, wb, wc, energy)
