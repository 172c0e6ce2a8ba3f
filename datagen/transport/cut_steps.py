"""The compiled steps of `cuts.py`: one sample of each element, and how its light is spread over arrival times."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from datagen.compiled import compiled
from datagen.records.arrays import Floats, Ints
from datagen.transport.arrival_times import BETWEEN, CORNERS, LEVELS, MEETING, PARTS, PLACES, SPANS, spread
from datagen.transport.brdf import Vector, dot
from datagen.transport.bvh import triangle_by_area
from datagen.transport.cut_elements import (
    COARSEST_CLUSTER,
    Surface,
    Verdict,
    Waiting,
    Way,
    cluster_of,
    guess,
    halve,
    judge,
    judge_box,
    open_box,
    open_cluster,
    push,
    way_to,
)
from datagen.transport.geometry import corner, distance, get, subtract, transmittance
from datagen.transport.rays import lifted_and_scaled
from datagen.transport.sampling import mix
from datagen.transport.weights import End, brdf_of, weight

LEAST = 0.1
"""Least density of the hidden point on an element, relative to the largest: bounds the weight where a guess is 0."""
POINTS = 4
"""Most FoV points that a hidden point is joined to, a power of 4; one of them, drawn by its light, gets a ray."""
OPENED = 16
"""Where a pixel was opened into so many clusters, samples are spread over a quarter of a piece, where into four times
as many over a sixteenth: each cluster draws its own, but the shape of a whole piece would be alike in all."""
LEAST_WIDTH = 1e-3
"""Change of times over a cluster, bins, below which all of the cluster counts as at one time."""
UNEVEN = 0.5
"""Range of the place at which pieces are halved, relative to their side: no two replicates have the same elements."""
STEPS = (0.8191725133961645, 0.6710436067037893, 0.5497004779019703)
"""Steps of additive recurrences (Roberts 2018), which spread the hidden and the FoV points of a pair evenly."""


class Asked(NamedTuple):
    """What is asked of each part (K,): delta, photons that an element brings at most; slot, the place of the part's
    rows, −1 for parts that are left out; error, L2 error that its histogram may have, photons. straight : bend of the
    times over a part of an element, relative to their span, up to which they count as linear. least : chance, at
    least, of an element that brings much less to get a sample, which then stands for all those that get none."""

    delta: Floats
    slot: Ints
    error: Floats
    straight: float
    least: float


class Pair(NamedTuple):
    """A laser point and a pixel: the distance from the laser where that counts, m; the share of light that the laser
    point stands for; the index of the pixel, and of the first of its FoV points that a replicate may use."""

    leg: float
    power: float
    pixel: int
    first: int


class Hidden(NamedTuple):
    """A hidden point, drawn on an element: place, metres, normal, and density, 1/m²; the guessed light of the element
    for each unit of gain; the corners of the triangle that it is spread over, the level of its parts, and by how much
    their mean times are late, bins."""

    point: Vector
    normal: Vector
    density: float
    light: float
    corners: tuple[Vector, Vector, Vector]
    level: int
    bend: float


class Batch(NamedTuple):
    """Samples that wait for their rays.

    ends : (n, 3, 3) laser point, hidden point and FoV point in embree's frame. row : (n,) of the histogram. light :
    (n,) photons. level : (n,) of the 4^level equal parts of a triangle that the light is spread over. time, at :
    (n, CORNERS[-1]) arrival times at their corners, by way of the middle of the cluster, bins, and weights there, in
    the order of `PLACES`. change : (n, 4) of times, bins, and of weights, relative to their mean, along both sides of
    the cluster. shift : (n,) light is spread over the cluster by steps of 2^−shift bins.
    """

    ends: NDArray[np.float32]
    row: Ints
    light: Floats
    level: Ints
    time: Floats
    at: Floats
    change: Floats
    shift: Ints

    @classmethod
    def of(cls, n: int) -> Batch:
        """Arrays for n samples, not yet set."""
        return cls(
            np.empty((n, 3, 3), np.float32), np.empty(n, np.int64), np.empty(n), np.empty(n, np.int64),
            np.empty((n, CORNERS[-1])), np.empty((n, CORNERS[-1])), np.empty((n, 4)), np.empty(n, np.int64),
        )  # fmt: skip


@compiled(forceinline=True, allocates=False)
def _random(state):  # type: ignore[no-untyped-def]
    """The next number in 0 … 1 of a stream, whose state is state[0] (Knuth's linear congruential generator)."""
    state[0] = state[0] * np.uint64(6364136223846793005) + np.uint64(1442695040888963407)
    return (np.float64(state[0] >> np.uint64(33)) + 0.5) * 2.0**-31


@compiled(forceinline=True, allocates=False)
def _fraction(u):  # type: ignore[no-untyped-def]
    """The part of u ≥ 0 after the point."""
    return u - math.floor(u)


@compiled(forceinline=True, allocates=False)
def _point_in(y0, y1, y2, s0, s1, s2):  # type: ignore[no-untyped-def]
    """The point of a triangle with some barycentric coordinates."""
    return (
        s0 * y0[0] + s1 * y1[0] + s2 * y2[0], s0 * y0[1] + s1 * y1[1] + s2 * y2[1],
        s0 * y0[2] + s1 * y1[2] + s2 * y2[2],
    )  # fmt: skip


@compiled(forceinline=True, allocates=False)
def _part_corner(y0, y1, y2, v):  # type: ignore[no-untyped-def]
    """Corner v of the parts of a triangle."""
    return _point_in(y0, y1, y2, 1.0 - PLACES[v, 0] - PLACES[v, 1], PLACES[v, 0], PLACES[v, 1])


@compiled(forceinline=True, allocates=False)
def _barycentric(u, v, w0, w1, w2):  # type: ignore[no-untyped-def]
    """A point of a triangle, drawn with a density that is linear between its corners, from (u, v) in the unit
    square."""
    # One corner, by its weight; the coordinate of that corner has the density 6 t (1 − t), the rest is uniform.
    u *= w0 + w1 + w2
    which = 0 if u < w0 else 1 if u < w0 + w1 else 2
    inner = u / w0 if which == 0 else (u - w0) / w1 if which == 1 else min((u - w0 - w1) / w2, 1.0)
    t = 0.5 - math.sin(math.asin(1.0 - 2.0 * inner) / 3.0)
    a, b = (1.0 - t) * v, (1.0 - t) * (1.0 - v)
    return t if which == 0 else a, t if which == 1 else a if which == 0 else b, t if which == 2 else b


@compiled(forceinline=True, allocates=False)
def change_over_cluster(y, seen, row, device):  # type: ignore[no-untyped-def]
    """By how much paths by way of y are longer in the mean over a flat cluster than by way of its middle, metres, and
    their change along each of its two sides.

    row : (18,) of the cluster. device : whether the leg to the sensor counts.

    The mean of a leg of length r, which is bent, grows by (s² − (s · w)²)/(24 r) for a side s and its direction w.
    """
    d, to_sensor = subtract(y, seen.middle), seen.back
    r, mean, (last, last_leg) = math.sqrt(dot(d, d)), 0.0, (1.0, row[17]) if device else (0.0, np.inf)
    s1, s2 = (row[11], row[12], row[13]), (row[14], row[15], row[16])
    for s in (s1, s2):
        mean += (dot(s, s) - (dot(d, s) / r) ** 2) / (24.0 * r)
        mean += (dot(s, s) - dot(to_sensor, s) ** 2) / (24.0 * last_leg)
    one, two = -dot(d, s1) / r - last * dot(to_sensor, s1), -dot(d, s2) / r - last * dot(to_sensor, s2)
    return mean, one, two


@compiled(forceinline=True, allocates=False)
def _draw_part(at, level, u):  # type: ignore[no-untyped-def]
    """The number of a part, drawn by its light; u as a new random number; and the sum of the guesses at all corners
    of all parts."""
    total, last = 0.0, (1 << 2 * level) - 1
    for v in range(CORNERS[level]):
        total += MEETING[level, v] * at[v]
    rest = u * total
    for part in range(last + 1):
        a, b, c = PARTS[level, part, 0], PARTS[level, part, 1], PARTS[level, part, 2]
        own = at[a] + at[b] + at[c]
        if rest < own or part == last:
            return part, min(max(rest / own, 0.0), 1.0), total
        rest -= own
    return last, 0.5, total


@compiled(forceinline=True, allocates=False)
def _draw(walk, top, piece, squares, straight, setup, way, at):  # type: ignore[no-untyped-def]
    """A `Hidden` point of the box or piece at `top`, drawn by the guessed light of its parts, which `at` becomes.

    squares : of the pixel. straight : of `Asked`.
    """
    bare = Way(way.surface, way.lit, way.seen, way.values, 0.0, way.plane)
    tree, f, level, area, bend, across = setup.tree, walk.tag[top, 1], 0, piece.area, piece.bend, piece.across
    clear0 = clear1 = clear2 = 1.0
    is_box, is_opened = walk.tag[top, 0] == Waiting.BOX, False
    if is_box:
        low, high = tree.span[f, 0], tree.span[f, 1]
        area = tree.area[high] - tree.area[low]
        f = triangle_by_area(low, high, tree.area, np.uint64(_random(walk.state) * 4294967296.0))
    n = get(tree.normal, f, 0)
    if is_box:
        y0, y1, y2 = corner(tree.corners, f, 0), corner(tree.corners, f, 1), corner(tree.corners, f, 2)
        w0 = w1 = w2 = 1.0
    else:
        own, least = walk.piece[top], LEAST * piece.most if piece.most > 0.0 else 1.0
        y0, y1, y2 = get(walk.piece, top, 0), get(walk.piece, top, 3), get(walk.piece, top, 6)
        w0, w1, w2 = max(own[9], least), max(own[10], least), max(own[11], least)
        is_opened = OPENED * walk.tag[top, 4] <= squares
        least = 0 if not is_opened else 1 if 4 * OPENED * walk.tag[top, 4] > squares else 2
        while level < LEVELS and (level < least or across > piece.even):
            level, bend, across = level + 1, 0.25 * bend, 0.25 * across
        # Air, which changes little over a piece, is interpolated: exponentials are no part of the loop over corners.
        clear0 = transmittance(setup.scene.air, own[12] + distance(y0, way.seen.middle))
        clear1 = transmittance(setup.scene.air, own[13] + distance(y1, way.seen.middle))
        clear2 = transmittance(setup.scene.air, own[14] + distance(y2, way.seen.middle))
    for v in range(CORNERS[level]):
        s1, s2 = PLACES[v, 0], PLACES[v, 1]
        s0 = 1.0 - s1 - s2
        light = s0 * w0 + s1 * w1 + s2 * w2
        if max(s0, s1, s2) < 1.0:
            y = _part_corner(y0, y1, y2, v)
            clear = s0 * clear0 + s1 * clear1 + s2 * clear2
            light = max(clear * guess(y, n, bare, 0.0)[0], LEAST * light)
        at[v] = light
    part, u, total = _draw_part(at, level, walk.numbers[0])
    a, b, c = PARTS[level, part, 0], PARTS[level, part, 1], PARTS[level, part, 2]
    t0, t1, t2 = _barycentric(u, walk.numbers[1], at[a], at[b], at[c])
    s1 = t0 * PLACES[a, 0] + t1 * PLACES[b, 0] + t2 * PLACES[c, 0]
    s2 = t0 * PLACES[a, 1] + t1 * PLACES[b, 1] + t2 * PLACES[c, 1]
    y = _point_in(y0, y1, y2, 1.0 - s1 - s2, s1, s2)
    light = area * total / (3.0 * (1 << 2 * level))
    density = (t0 * at[a] + t1 * at[b] + t2 * at[c]) / light
    if is_opened:
        y0, y1, y2 = _part_corner(y0, y1, y2, a), _part_corner(y0, y1, y2, b), _part_corner(y0, y1, y2, c)
        at[0], at[1], at[2], level = at[a], at[b], at[c], 0
    # For their times, which bend more than weights, parts are divided further.
    while not is_box and bend > straight * piece.width and level < LEVELS:
        for v in range(CORNERS[level], CORNERS[level + 1]):
            at[v] = 0.5 * (at[BETWEEN[v, 0]] + at[BETWEEN[v, 1]])
        level, bend = level + 1, 0.25 * bend
    # Of a small box nothing is guessed, and all of its light arrives at one time.
    corners = (y, y, y) if is_box else (y0, y1, y2)
    return Hidden(y, n, density, 0.0 if is_box else light, corners, level, bend)


@compiled(forceinline=True, allocates=False)
def _choose_fov_point(hidden, walk, top, setup, pool, pair, way, tilt):  # type: ignore[no-untyped-def]
    """Index of a FoV point of the cluster at `top` that gets a ray, −1 if none is lit, and the light of all.

    tilt : (2,) set to the change of weights along the sides of the cluster, relative to their mean.
    """
    q, many, total, chosen, one, two = walk.tag[top, 3], walk.tag[top, 4], 0.0, -1, 0.0, 0.0
    scene, points = setup.scene, min(many, POINTS)
    each = many // points
    for m in range(points):
        j = pair.first + 2 * (q + m * each + min(int(walk.numbers[2] * each), each - 1))
        k = pool.part[j]
        if k >= 0:
            brdf = brdf_of(scene, k)
            z = End(get(pool.position, j, 0), get(pool.normal, j, 0), get(pool.to_sensor, j, 0), brdf)
            w, _, _ = weight(hidden.point, hidden.normal, way.surface.brdf, way.lit, z, scene.values, 0.0, scene.air)
            light = pair.power * each * w * pool.weight[j] / hidden.density
            # One of them, drawn by its light, stands for all.
            total += light
            one += light if m % 2 else -light
            two += light if m // 2 else -light
            if light > 0.0 and (total == light or _random(walk.state) * total < light):
                chosen = j
    # One point in each quarter tells how weights change, which are at no corner below zero.
    if points > 1 and total > 0.0:
        most = max(2.0 * (abs(one) + abs(two)), total)
        tilt[0], tilt[1] = 4.0 * one / most, 4.0 * two / most
    else:
        tilt[0], tilt[1] = 0.0, 0.0
    return chosen, total


@compiled(forceinline=True, allocates=False)
def _set_rays(ends, hidden, lit, z, n3, scene):  # type: ignore[no-untyped-def]
    """Sets the ends (3, 3) of a sample's rays, lifted off their surfaces."""
    side = scene.offset if dot(subtract(lit.point, hidden.point), hidden.normal) > 0.0 else -scene.offset
    ends[0, 0], ends[0, 1], ends[0, 2] = lifted_and_scaled(lit.point, lit.normal, scene.offset, scene.frame)
    ends[1, 0], ends[1, 1], ends[1, 2] = lifted_and_scaled(hidden.point, hidden.normal, side, scene.frame)
    ends[2, 0], ends[2, 1], ends[2, 2] = lifted_and_scaled(z, n3, scene.offset, scene.frame)


@compiled(forceinline=True, allocates=False)
def _set_times(time, change, hidden, z, last_leg, row, setup, pair, way):  # type: ignore[no-untyped-def]
    """Sets the times (CORNERS[-1],) of a sample by way of FoV point z, and their change (2,) along the sides of the
    cluster, bins.

    last_leg : from z to the sensor, m. row : (18,) of the cluster.
    """
    per, mean, one, two = setup.per_metre, 0.0, 0.0, 0.0
    if row[17] > 0.0:
        # Times, which change most over a pixel, are those of all of a flat cluster.
        z, last_leg = way.seen.middle, row[17]
        mean, one, two = change_over_cluster(hidden.point, way.seen, row, setup.scene.from_source)
    # Times over a triangle that change by their squares are, on average, ¾ of the bend earlier than linear ones.
    path = pair.leg + (last_leg if setup.scene.from_source else 0.0) + mean - (setup.start + 0.75 * hidden.bend) / per
    y0, y1, y2 = hidden.corners
    for v in range(CORNERS[hidden.level]):
        y = _part_corner(y0, y1, y2, v)
        time[v] = (distance(y, way.lit.point) + distance(y, z) + path) * per
    is_narrow = abs(one) + abs(two) < LEAST_WIDTH / per
    change[0], change[1] = (0.0, 0.0) if is_narrow else (one * per, two * per)


@compiled(forceinline=True, allocates=False)
def _sample(walk, top, piece, chance, asked, setup, pool, pair, way, expected, batch, used):  # type: ignore[no-untyped-def]
    """Sets sample `used` of the batch to one of the box or piece at `top`, which is drawn with some chance; returns
    whether it brings light."""
    squares, seen = len(pool.part) // (2 * len(pool.cluster)), way.seen
    hidden = _draw(walk, top, piece, squares, asked.straight, setup, way, batch.at[used])
    lobe, many = min(way.surface.lobe, seen.lobe), walk.tag[top, 4]
    is_near = many == 1 and seen.size > COARSEST_CLUSTER * lobe * distance(hidden.point, seen.middle)
    expected[0] += seen.gain * hidden.light / chance
    expected[1] += seen.gain * hidden.light / chance if is_near else 0.0
    j, light = _choose_fov_point(hidden, walk, top, setup, pool, pair, way, batch.change[used, 2:])
    if j < 0:
        return False
    c = walk.tag[top, 2]
    if setup.uneven:
        # Light does not come from all of the cluster alike, but from all of the square of the FoV point. The elements
        # of a beam's many laser points are coarse, and what they blur is alike in all of them.
        c = pool.cluster.shape[1] - squares + (j - pair.first) // 2
        way = way_to(way, cluster_of(setup, pool, pair.pixel, c, pair.power))
        batch.change[used, 2], batch.change[used, 3] = 0.0, 0.0
    z, row = get(pool.position, j, 0), pool.cluster[pair.pixel, c]
    _set_rays(batch.ends[used], hidden, way.lit, z, get(pool.normal, j, 0), setup.scene)
    _set_times(batch.time[used], batch.change[used], hidden, z, pool.leg[j], row, setup, pair, way)
    batch.light[used], batch.level[used] = light / chance, hidden.level
    batch.shift[used] = 0
    for span in SPANS:
        batch.shift[used] += piece.width < span
    return True


@compiled(forceinline=True, allocates=False)
def _is_drawn(walk, chance):  # type: ignore[no-untyped-def]
    """Whether the next element gets a sample: systematic, so that those of neighbours are drawn evenly."""
    walk.numbers[3] += chance
    if walk.numbers[3] < 1.0:
        return False
    walk.numbers[3] -= 1.0
    return True


@compiled(forceinline=True, allocates=False)
def _cut(walk, top, enough, error, straight, setup, pool, pair, way):  # type: ignore[no-untyped-def]
    """The `Piece` of what waits at `top`, and the height of the stack after that has been cut, where it is; `enough`
    and the others as in `judge`."""
    at, last_leg = walk.tag[top, 1], pool.leg[way.seen.one]
    if walk.tag[top, 0] == Waiting.BOX:
        leg = pair.leg + (last_leg if setup.scene.from_source else 0.0)
        piece = judge_box(setup.tree, at, enough, leg, setup, way)
        return piece, open_box(walk, top, setup, way) if piece.verdict == Verdict.HALVES else top
    n = get(setup.tree.normal, at, 0)
    piece = judge(walk, top, n, enough, error, straight, pair.leg, last_leg, setup, way)
    if piece.verdict == Verdict.QUARTERS_OF_CLUSTER:
        top = open_cluster(walk, top, n, setup, pool, pair.pixel, pair.power, way)
    elif piece.verdict == Verdict.HALVES:
        top = halve(walk, top, 0.5 + UNEVEN * (_random(walk.state) - 0.5), n, way)
    return piece, top


@compiled(allocates=False)
def emit(pairs, rows, asked, most, replicate, seed, setup, pool, walk, expected, batch):  # type: ignore[no-untyped-def]
    """Fills the batch with a sample of each element of some pairs; returns the number of samples.

    pairs : (n, 3) laser point, index of the pixel in `pool`, and row of the histogram, of so many `rows`. asked :
    `Asked`. most : elements of the walk from which on only what is near is cut. replicate : 0 or 1. walk : goes on
    where the last batch was full; its pair is n when all is done. expected : (3,) photons as guessed, added up: of
    all pieces, of those whose FoV points are far apart for their distance, and of what may arrive within the window.
    """
    used, at, lasers, points = 0, walk.at, setup.lasers, len(pool.part) // len(pool.cluster)
    for number in range(at[0], len(pairs)):
        i, p, row = pairs[number, 0], pairs[number, 1], pairs[number, 2]
        k1 = lasers.part[i]
        if k1 < 0 or setup.power[i] <= 0.0 or pool.cluster[p, 0, 9] <= 0.0:
            continue
        brdf = brdf_of(setup.scene, k1)
        lit = End(get(lasers.position, i, 0), get(lasers.normal, i, 0), get(lasers.to_laser, i, 0), brdf)
        pair = Pair(lasers.leg[i] if setup.scene.from_source else 0.0, setup.power[i], p, p * points + replicate)
        if at[1] == 0 and at[2] == 0:
            walk.state[0] = mix(mix(np.uint64(seed), np.uint64(i)), np.uint64(p))
            walk.state[0] = (walk.state[0] << np.uint64(32)) | mix(walk.state[0], np.uint64(number))
            for d in range(len(STEPS)):
                walk.numbers[d] = _random(walk.state)
        for k in range(at[1], len(setup.tree.roots)):
            top, at[2] = at[2], 0
            if asked.slot[k] < 0:
                continue
            surface = Surface(brdf_of(setup.scene, k), setup.outer[k], setup.peak[k], setup.lobe[k])
            if top == 0:
                push(walk.tag, 0, Waiting.BOX, setup.tree.roots[k], 0, 0, points // 2)
                top = 1
            while top > 0:
                top -= 1
                # With an infinite δ only what is near is cut.
                enough, error = (asked.delta[k], asked.error[k]) if at[3] < most else (np.inf, np.inf)
                seen = cluster_of(setup, pool, p, walk.tag[top, 2], pair.power)
                way = Way(surface, lit, seen, setup.scene.values, setup.scene.air, setup.plane)
                piece, top = _cut(walk, top, enough, error, asked.straight, setup, pool, pair, way)
                if piece.verdict != Verdict.SAMPLE:
                    continue
                if used == len(batch.row):
                    at[0], at[1], at[2] = number, k, top + 1
                    return used
                guessed = seen.gain * piece.area * piece.most
                expected[2] += guessed if piece.inside else 0.0
                chance = min(max(guessed / (enough * math.sqrt(piece.width)), asked.least), 1.0)
                if not _is_drawn(walk, chance):
                    continue
                at[3] += 1
                for d in range(len(STEPS)):
                    walk.numbers[d] = _fraction(walk.numbers[d] + STEPS[d])
                if _sample(walk, top, piece, chance, asked, setup, pool, pair, way, expected, batch, used):
                    batch.row[used] = asked.slot[k] * rows + row
                    used += 1
        at[1] = 0
    at[0] = len(pairs)
    return used


@compiled(allocates=False)
def legs_of(batch, rows, leg, origin, span):  # type: ignore[no-untyped-def]
    """Sets origins and spans (…, 3) of the rays from the hidden points of some samples to the laser point (leg 0) or
    the FoV point (leg 1)."""
    for n in range(len(rows)):
        ends = batch.ends[rows[n]]
        for c in range(3):
            origin[n, c], span[n, c] = ends[1, c], ends[2 * leg, c] - ends[1, c]


@compiled(allocates=False)
def widest(batch, rows):  # type: ignore[no-untyped-def]
    """The largest change of times over both sides of a cluster together, of some samples, steps."""
    most = 0.0
    for s in rows:
        most = max(most, (abs(batch.change[s, 0]) + abs(batch.change[s, 1])) * (1 << batch.shift[s]))
    return most


@compiled(allocates=False)
def pour_all(batch, rows, histogram, outside, work):  # type: ignore[no-untyped-def]
    """Adds the light of some samples to their rows of histogram (…, T), and what is outside of it to outside (…).

    work : a `Work` for the `widest` of them.
    """
    for s in rows:
        outside[batch.row[s]] += spread(batch, s, histogram[batch.row[s]], work)
