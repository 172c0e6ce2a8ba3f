"""The light of the static room that moving parts block, drawn through their silhouettes.

Let V be 1 where no mover stands on a leg. Of the light w V_static that goes from laser point x by hidden point y to
FoV point z, movers block

    1 − V_x V_z  =  (1 − V_x)  +  V_x (1 − V_z),

what they hide from the laser point, and what they hide from the FoV point alone. Either is drawn as its end sees it:
the directions from x, or from z, are the cells of a hemicube (`hemicube.py`), and a picture of the movers tells, for
each frame, how much of a cell they cover. What stands behind, the first static surface y along one ray of each cell,
does not depend on the frame. So rays are cast once for all frames, and light that stays blocked has no noise in the
change from one frame to the next. All random numbers follow from laser point, or pixel, and cell alone.

A cell that is covered in part counts by its covered places, with the light of the surface that its ray met, in
proportion to cosines and distances at their middle. Its light is spread over the arrival times of the covered places,
by their variance, and of the pixel.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from datagen.compiled import compiled
from datagen.records.arrays import Floats, Ints
from datagen.transport.brdf import Vector, dot
from datagen.transport.cut_elements import CutSetup
from datagen.transport.cut_steps import change_over_cluster
from datagen.transport.cuts import Cuts, outer_sides
from datagen.transport.fov_clusters import SQUARES, FovClusters
from datagen.transport.geometry import distance, get, put, subtract
from datagen.transport.hemicube import (
    FULL,
    PLACES,
    Drawn,
    Pictures,
    Views,
    along,
    face_toward,
    in_space,
    is_covered,
    number_of,
    off_face,
    on_face,
    pictures,
    place_of,
    toward,
    uniform,
)
from datagen.transport.movers import Mover
from datagen.transport.moving_light import Jobs
from datagen.transport.rays import lifted_and_scaled
from datagen.transport.weights import End, brdf_of, weight

STEPS = (0.7548776662466927, 0.5698402909980532)
"""Steps of an additive recurrence (Roberts 2018), which spreads the FoV points over neighbouring cells."""
FARTHEST = 3.0
"""Times over a cell are those of the plane that its ray met, up to so many times its distance."""
NARROW = 1e-3
"""Spread of times, bins, below which light arrives at one time."""
BESIDE = 1e-4
"""Share of a second spread of times in the first below which it does not count."""
LINKS = 1 << 19
"""Rays between hidden points and ends that are cast at once, about."""
Floats32 = NDArray[np.float32]


class Cells(NamedTuple):
    """Cells of the pictures of some views that a mover covers in any frame, view after view.

    first : (views + 1,) the first cell of each. number : (n,) of the cell in its hemicube. at : (views, cells) index
    of each cell here, −1 for others. point : (n,) FoV point that goes with the cell. start, direction : (n, 3) of its
    ray, metres, at depth 1. face : (n,) static triangle that the ray meets, −1 for none. depth : (n,) of that.
    """

    first: Ints
    number: Ints
    at: Ints
    point: Ints
    start: Floats
    direction: Floats
    face: Ints
    depth: Floats


class Ends(NamedTuple):
    """Laser points and FoV points, and what of the static room their light meets.

    setup : of cuts. seen : FoV points of all pixels, of both replicates. middle : (P, 3) directions from the middles
    of pixels to the sensor. corners, normal, part : (F, 3, 3), (F, 3), (F,) of the static triangles. slot : (K,) row
    of the light by way of a part.
    """

    setup: CutSetup
    seen: FovClusters
    middle: Floats
    corners: Floats
    normal: Floats
    part: Ints
    slot: Ints


class Middle(NamedTuple):
    """Middle of a pixel, metres, and the direction to the sensor there."""

    middle: Vector
    back: Vector


class Shadows:
    """What all movers together block of the static room's light.

    cuts : the problem of all parts, with the static room's rays. parts : static objects, whose light is kept by
    itself. rays : cast so far.
    """

    def __init__(self, cuts: Cuts, movers: Sequence[Mover]) -> None:
        problem = cuts.problem
        self.cuts, self.movers, self.caster, self.rays = cuts, movers, problem.caster, 0
        vertices = np.concatenate([mover.vertices for mover in movers])
        counts = [len(mover.vertices) for mover in movers]
        shift = np.cumsum([0, *counts])
        triangles = np.concatenate([mover.triangles + shift[m] for m, mover in enumerate(movers)])
        sides = outer_sides(problem.scene)
        outer = np.concatenate([np.full(len(mover.triangles), sides[mover.part]) for mover in movers])
        self.drawn = Drawn(vertices, np.repeat(np.arange(len(movers)), counts), triangles, outer)
        names = problem.scene.part_names[: movers[0].part]
        self.parts = tuple(name for name in names if problem.scene.roles[names.index(name)] == "object")
        self.slot = np.zeros(len(problem.scene.part_names), np.int64)
        for row, name in enumerate(self.parts):
            self.slot[names.index(name)] = row + 1
        # Where all laser points have one time, pixels see the same picture at all of them.
        self.has_one_time = all((mover.pose == mover.pose[..., :1, :]).all() for mover in movers)
        self.instants, self.frames = movers[0].pose.shape[:2]

    def run(self, jobs: Jobs, side: int, number: int) -> tuple[Floats, Floats]:
        """The light (2, S, F, n, T) of two replicates that is blocked in some histograms, by way of what is no object
        and of each of `parts`; and what of it is outside of the window (2, F, n).

        side : cells along a side of a hemicube's front face. number : of the run; each has random numbers of its own.
        """
        T, shape, rows = self.cuts.problem.capture.time.bins, jobs.frame.shape, 1 + len(self.parts)
        light, outside = np.zeros((2, rows, *shape, T)), np.zeros((2, *shape))
        for r in range(2):
            seed = self.cuts.seed(6, number, r)
            ends = self._ends(np.random.default_rng(seed))
            self._add(jobs, side, r, seed, ends, light[r].reshape(rows, -1, T), outside[r].reshape(-1))
        if self.instants > 1:
            light /= self.instants
            outside /= self.instants
        return light, outside

    def _ends(self, rng: np.random.Generator) -> Ends:
        """Laser points, and FoV points drawn anew."""
        problem = self.cuts.problem
        pixels, sensor = np.arange(len(problem.capture.sensor.pixels)), problem.capture.sensor
        seen = FovClusters.of(problem, pixels, SQUARES[0], rng)
        middle = sensor.position - seen.cluster[:, 0, :3]
        middle /= np.linalg.norm(middle, axis=1, keepdims=True)
        part = problem.scene.face_part[: len(self.caster.corners)].astype(np.int64)
        return Ends(self.cuts.setup, seen, middle, self.caster.corners, self.caster.face_normal, part, self.slot)

    def _add(
        self, jobs: Jobs, side: int, replicate: int, seed: int, ends: Ends, light: Floats, outside: Floats
    ) -> None:  # fmt: skip
        """Adds a replicate of the blocked light of some histograms, summed over the instants of their exposures, to
        light (S, F n, T) and outside (F n,)."""
        L, P = len(ends.setup.lasers.part), len(ends.middle)
        # The moments of an instant, in all frames, come one after another.
        moment = np.arange(self.instants)[:, None, None] * self.frames + jobs.frame
        laser, pixel = (np.broadcast_to(of, moment.shape).ravel() for of in (jobs.laser, jobs.pixel))
        row, moment = np.broadcast_to(np.arange(jobs.frame.size), (self.instants, jobs.frame.size)), moment.ravel()
        # A picture of each laser point in each frame, and of each pixel at that time.
        of_x, of_laser = np.unique(moment * L + laser, return_inverse=True)
        time = moment * L + (0 if self.has_one_time else laser)
        of_z, of_pixel = np.unique(time * P + pixel, return_inverse=True)
        lasers, at_laser = np.unique(laser, return_inverse=True)
        pixels, at_pixel = np.unique(pixel, return_inverse=True)
        pairs, of_pair = np.unique(at_laser * len(pixels) + at_pixel, return_inverse=True)
        pair = np.column_stack([pairs // len(pixels), pairs % len(pixels)])
        points, cluster = ends.setup.lasers, ends.seen.cluster[:, 0]
        views = Views.of(points.position, points.normal, seed), Views.of(cluster[:, :3], cluster[:, 3:6], seed + 1)
        drawn_x = self._pictures(views[0], of_x % L, of_x // L, of_x % L, side)
        if self._is_confocal(ends):
            # Laser points see what their pixels see, from within them; both are in one order.
            views, drawn_z, of_pixel = (views[0], views[0]), drawn_x, of_laser
        else:
            drawn_z = self._pictures(views[1], of_z % P, of_z // P // L, of_z // P % L, side)
        x_cells = self._cells(
            drawn_x, views[0], np.searchsorted(lasers, of_x % L), lasers, 0, side, replicate, ends, seed
        )
        z_cells = self._cells(
            drawn_z, views[1], np.searchsorted(pixels, of_z % P), pixels, 1, side, replicate, ends, seed
        )
        x_light = self._light(x_cells, pair, lasers, pixels, 0, replicate, side, ends)
        z_light = self._light(z_cells, pair, lasers, pixels, 1, replicate, side, ends)
        job = np.column_stack([of_laser, of_pixel, of_pair, at_laser, at_pixel, laser, pixel, row.ravel()])
        bits, near = np.zeros((2, 3 * side * side), np.int64), np.empty((2, 3 * side * side))
        done = np.full(3 * side * side, -1)
        _pour_all(
            job, (drawn_x, drawn_z), (x_cells, z_cells), (x_light, z_light), views, ends, side, bits, near, done,
            light, outside,
        )  # fmt: skip

    def _is_confocal(self, ends: Ends) -> bool:
        """Whether pixel i goes with laser point i, which lies within it."""
        row = ends.seen.cluster[:, 0]
        if self.cuts.problem.capture.pairing != "confocal":
            return False
        return bool((np.linalg.norm(ends.setup.lasers.position - row[:, :3], axis=1) <= row[:, 6]).all())

    def _pictures(self, views: Views, of_view: Ints, moment: Ints, laser: Ints, side: int) -> Pictures:
        """Pictures from views `of_view`, of movers as they are at a moment of a laser point."""
        instant, frame = np.divmod(moment, self.frames)
        pose = np.stack([mover.pose[instant, frame, laser] for mover in self.movers], axis=1)
        return pictures(views, of_view, pose, self.drawn, side)

    def _cells(
        self, drawn: Pictures, views: Views, of_view: Ints, number_of_view: Ints, ring: int, side: int,
        replicate: int, ends: Ends, seed: int,
    ) -> Cells:  # fmt: skip
        """The cells of some pictures, with their neighbours where `ring` is 1, which is for FoV points, and the rays
        through them. of_view : (M,) index in `number_of_view`, the numbers of the views."""
        at = np.full((len(number_of_view), 3 * side * side), -1, np.int64)
        _mark(drawn, of_view, ring, side, at)
        view, cell = np.nonzero(at == 0)
        at[view, cell] = np.arange(len(view))
        first = np.searchsorted(view, np.arange(len(number_of_view) + 1))
        n = len(view)
        point, face, depth = np.empty(n, np.int64), np.empty(n, np.int64), np.empty(n)
        start, direction = np.empty((2, n, 3))
        origin, span = np.empty((2, n, 3), np.float32)
        _aim(
            number_of_view[view], cell, views, side, ring == 1, replicate, np.uint64(seed), ends, point, start,
            direction, origin, span,
        )  # fmt: skip
        face[:] = self.caster.closest_scaled(origin, span) if n else -1
        self.rays += n
        _set_depths(start, direction, ends, face, depth)
        return Cells(first, cell, at, point, start, direction, face, depth)

    def _light(
        self, cells: Cells, pair: Ints, lasers: Ints, pixels: Ints, which: int, replicate: int, side: int, ends: Ends
    ) -> tuple[Ints, Floats, Floats]:
        """The first number of each pair's light; light (m,) that goes through the cells of its laser point (`which`
        0) or pixel (1), photons, if no mover were there; and room for time and two widths (m, 3) of it, the widths
        negative. pair : (n, 2) index of laser point and pixel."""
        view = pair[:, which]
        count = np.diff(cells.first)[view]
        first = np.concatenate([[0], np.cumsum(count)])
        light = np.empty(first[-1])
        step = max(len(pair) * LINKS // max(int(first[-1]), 1), 1)
        for at in range(0, len(pair), step):
            some = slice(at, at + step)
            m = int(count[some].sum())
            own = light[first[at] : first[at] + m]
            row, origin, span = np.empty(m, np.int64), np.empty((m, 3), np.float32), np.empty((m, 3), np.float32)
            k = _link(
                pair[some], lasers, pixels, cells, which, replicate, side, ends, own, row, origin, span
            )  # fmt: skip
            if k:
                own[row[:k][self.caster.occluded_scaled(origin[:k], span[:k])]] = 0.0
            self.rays += k
        return first, light, np.full((len(light), 3), -1.0)


@compiled(allocates=False)
def _mark(drawn, of_view, ring, side, at):  # type: ignore[no-untyped-def]
    """Sets at (views, cells) to 0 for cells of pictures, and for those that are up to `ring` cells away on a face."""
    for m in range(len(of_view)):
        for e in range(drawn.first[m], drawn.first[m + 1]):
            face, i, j = place_of(side, drawn.cell[e])
            high = side if face == 0 else side // 2
            for k in range(max(i - ring, 0), min(i + ring, side - 1) + 1):
                for q in range(max(j - ring, 0), min(j + ring, high - 1) + 1):
                    at[of_view[m], number_of(side, face, k, q)] = 0


@compiled(allocates=False)
def _aim(view, cell, views, side, is_pixel, replicate, seed, ends, point, start, direction, origin, span):  # type: ignore[no-untyped-def]
    """Sets what `Cells` says of rays of some views (n,) through cells (n,), and origin and span (n, 3) in embree's
    frame."""
    setup, seen = ends.setup, ends.seen
    squares = len(seen.part) // (2 * len(seen.cluster))
    for k in range(len(cell)):
        v, c = view[k], cell[k]
        face, i, j = place_of(side, c)
        phase = uniform(seed, v, 7, face) + i * STEPS[0] + j * STEPS[1]
        # FoV points of one replicate are every second.
        point[k] = 2 * min(int((phase - math.floor(phase)) * squares), squares - 1) + replicate
        a, b = toward(side, face, i + uniform(seed, v, c, 8), j + uniform(seed, v, c, 9))
        d = in_space(views.axes[v], off_face(face, (a, b, 1.0)))
        if is_pixel:
            q = v * 2 * squares + point[k]
            p, n = get(seen.position, q, 0), get(seen.normal, q, 0)
        else:
            p, n = get(setup.lasers.position, v, 0), get(setup.lasers.normal, v, 0)
        put(start, k, 0, p)
        put(direction, k, 0, d)
        origin[k, 0], origin[k, 1], origin[k, 2] = lifted_and_scaled(p, n, setup.scene.offset, setup.scene.frame)
        span[k, 0], span[k, 1], span[k, 2] = np.float32(d[0]), np.float32(d[1]), np.float32(d[2])


@compiled(allocates=False)
def _set_depths(start, direction, ends, face, depth):  # type: ignore[no-untyped-def]
    """Sets depths (n,) at which rays meet the planes of their triangles; one that meets none loses its triangle."""
    for k in range(len(face)):
        depth[k] = 0.0
        if face[k] >= 0:
            n, y = get(ends.normal, face[k], 0), get(ends.corners[face[k]], 0, 0)
            approach = dot(n, get(direction, k, 0))
            t = dot(n, subtract(y, get(start, k, 0))) / approach if approach != 0.0 else -1.0
            if 0.0 < t < 1e9:
                depth[k] = t
            else:
                face[k] = -1


@compiled(allocates=False)
def _link(pair, lasers, pixels, cells, which, replicate, side, ends, light, row, origin, span):  # type: ignore[no-untyped-def]
    """Sets light (m,) of some pairs through their cells, and rays from the hidden points to the ends that did not see
    them first, in embree's frame; returns the number of rays. row : the number of each ray's light."""
    setup, seen, used, at = ends.setup, ends.seen, 0, 0
    points, lit_by = len(seen.part) // len(seen.cluster), setup.lasers
    for number in range(len(pair)):
        i, p = lasers[pair[number, 0]], pixels[pair[number, 1]]
        view = pair[number, which]
        for k in range(cells.first[view], cells.first[view + 1]):
            at += 1
            light[at - 1] = 0.0
            j, f = p * points + cells.point[k], cells.face[k]
            if f < 0 or lit_by.part[i] < 0 or seen.part[j] < 0 or setup.power[i] <= 0.0:
                continue
            x, z, n = get(lit_by.position, i, 0), get(seen.position, j, 0), get(ends.normal, f, 0)
            s, d, t = get(cells.start, k, 0), get(cells.direction, k, 0), cells.depth[k]
            y = (s[0] + t * d[0], s[1] + t * d[1], s[2] + t * d[2])
            n1, n3 = get(lit_by.normal, i, 0), get(seen.normal, j, 0)
            lit = End(x, n1, get(lit_by.to_laser, i, 0), brdf_of(setup.scene, lit_by.part[i]))
            to = End(z, n3, get(seen.to_sensor, j, 0), brdf_of(setup.scene, seen.part[j]))
            own = brdf_of(setup.scene, ends.part[f])
            w, _, _ = weight(y, n, own, lit, to, setup.scene.values, 0.0, setup.scene.air)
            if w <= 0.0:
                continue
            # Of the solid angle of the cell, where its ray goes, to the area that it meets.
            length, cosine = math.sqrt(dot(d, d)), abs(dot(n, d))
            area = (2.0 / side) ** 2 / length**3 * (t * length) ** 2 * length / cosine
            light[at - 1] = w * area * setup.power[i] * seen.weight[j] * (points // 2)
            up = setup.scene.offset if dot(n, d) < 0.0 else -setup.scene.offset
            o = lifted_and_scaled(y, n, up, setup.scene.frame)
            e = (
                lifted_and_scaled(z, n3, setup.scene.offset, setup.scene.frame)
                if which == 0
                else lifted_and_scaled(x, n1, setup.scene.offset, setup.scene.frame)
            )
            for q in range(3):
                origin[used, q], span[used, q] = o[q], e[q] - o[q]
            row[used] = at - 1
            used += 1
    return used


class _Cell(NamedTuple):
    """A cell at work: its face and place (i, j) there; where its ray goes within one of its places, 0 … 1; axes of
    the view; start of its rays; normal and height
    above the start of the plane that they meet, metres; and the depth at which its own ray met it."""

    face: int
    i: int
    j: int
    across: float
    up: float
    u: Vector
    v: Vector
    n: Vector
    start: Vector
    normal: Vector
    height: float
    depth: float


class _Legs(NamedTuple):
    """The ends of a path: laser point and FoV point with their normals; middle and its direction to the sensor; the
    rest of the path, metres."""

    x: Vector
    x_normal: Vector
    z: Vector
    z_normal: Vector
    seen: Middle
    rest: float


@compiled(forceinline=True, allocates=False)
def _hidden_point(cell, a, b):  # type: ignore[no-untyped-def]
    """The point of the cell's plane across a and up b, and the direction to it at depth 1."""
    q, u, v, n = off_face(cell.face, (a, b, 1.0)), cell.u, cell.v, cell.n
    d = (
        q[0] * u[0] + q[1] * v[0] + q[2] * n[0], q[0] * u[1] + q[1] * v[1] + q[2] * n[1],
        q[0] * u[2] + q[1] * v[2] + q[2] * n[2],
    )  # fmt: skip
    approach = dot(cell.normal, d)
    t = cell.height / approach if approach != 0.0 else cell.depth
    # Where the plane turns away it is taken to end.
    t = t if cell.depth / FARTHEST < t < cell.depth * FARTHEST else cell.depth
    s = cell.start
    return (s[0] + t * d[0], s[1] + t * d[1], s[2] + t * d[2]), d


@compiled(forceinline=True, allocates=False)
def _density(cell, legs, a, b):  # type: ignore[no-untyped-def]
    """Light through a place of the cell for each unit of its area on the face, in proportion, from matt surfaces."""
    y, d = _hidden_point(cell, a, b)
    d1, d3, e = subtract(y, legs.x), subtract(y, legs.z), subtract(y, cell.start)
    one, three, length = dot(d1, d1), dot(d3, d3), dot(d, d)
    f = max(dot(d1, legs.x_normal), 0.0) * max(dot(d3, legs.z_normal), 0.0)
    f *= abs(dot(d1, cell.normal) * dot(d3, cell.normal)) / (one * one * three * three)
    # Area on the plane for each unit on the face.
    return f * dot(e, e) / (length * abs(dot(cell.normal, d)) + 1e-300)


@compiled(forceinline=True, allocates=False)
def _path(cell, legs, a, b):  # type: ignore[no-untyped-def]
    """Length of the path by way of a place of the cell and the middle of the pixel, metres."""
    y, _ = _hidden_point(cell, a, b)
    return distance(y, legs.x) + distance(y, legs.seen.middle) + legs.rest


@compiled(forceinline=True, allocates=False)
def _places_of(bits):  # type: ignore[no-untyped-def]
    """Number of covered places, their mean across and up, in units of the cell, variances, and covariance."""
    if bits == FULL:
        return PLACES * PLACES, 0.5, 0.5, 1.0 / 12.0, 1.0 / 12.0, 0.0
    count, a, b, aa, bb, ab = 0, 0.0, 0.0, 0.0, 0.0, 0.0
    for bit in range(PLACES * PLACES):
        if (bits >> bit) & 1:
            x, y = (bit // PLACES + 0.5) / PLACES, (bit % PLACES + 0.5) / PLACES
            count += 1
            a, b, aa, bb, ab = a + x, b + y, aa + x * x, bb + y * y, ab + x * y
    per, own = 1.0 / max(count, 1), 1.0 / (12.0 * PLACES * PLACES)
    a, b = a * per, b * per
    return count, a, b, aa * per - a * a + own, bb * per - b * b + own, ab * per - a * b


@compiled(forceinline=True, allocates=False)
def _ramp(x):  # type: ignore[no-untyped-def]
    return 0.5 * x * x if x > 0.0 else 0.0


@compiled(forceinline=True, allocates=False)
def _share_by(t, one, two):  # type: ignore[no-untyped-def]
    """Share of light that has come by time t after its mean, spread evenly over `one`, and again over `two` ≤ one."""
    if two < BESIDE * one:
        return min(max(t / one + 0.5, 0.0), 1.0)
    far, near = 0.5 * (one + two), 0.5 * (one - two)
    if t >= far:
        return 1.0
    return (_ramp(t + far) - _ramp(t + near) - _ramp(t - near)) / (one * two)


@compiled(allocates=False)
def _deposit(histogram, t, one, two, light):  # type: ignore[no-untyped-def]
    """Adds light to histogram (T,), about time t, spread over widths one ≥ two, bins; returns what is outside."""
    T = len(histogram)
    if one < NARROW:
        if 0.0 <= t < T:
            histogram[int(t)] += light
            return 0.0
        return light
    half = 0.5 * (one + two)
    if t + half <= 0.0 or t - half >= T:
        return light
    first, last = max(math.floor(t - half), 0), min(math.floor(t + half), T - 1)
    before = _share_by(first - t, one, two)
    begin = before
    for k in range(first, last + 1):
        now = _share_by(k + 1.0 - t, one, two)
        histogram[k] += light * (now - before)
        before = now
    return light * (1.0 - before + begin)


@compiled(allocates=False)
def _spread(cell, legs, bits, cluster, setup, side):  # type: ignore[no-untyped-def]
    """What covered places take of the light of a cell; its time, bins, and the two widths that it is spread over.

    cluster : (18,) of the pixel.
    """
    light = 1.0
    count, mean_a, mean_b, aa, bb, ab = _places_of(bits)
    a, b = toward(side, cell.face, cell.i + mean_a, cell.j + mean_b)
    own = _density(cell, legs, a, b)
    if bits != FULL:
        a0, b0 = toward(side, cell.face, cell.i + 0.5, cell.j + 0.5)
        whole = _density(cell, legs, a0, b0)
        light *= count / (PLACES * PLACES) * (min(own / whole, FARTHEST) if whole > 0.0 else 1.0)
    # Times and light over the cell, as they change over half of it to either side.
    step = 1.0 / side
    path = _path(cell, legs, a, b)
    a1, a2, b1, b2 = (
        _path(cell, legs, a - step, b), _path(cell, legs, a + step, b), _path(cell, legs, a, b - step),
        _path(cell, legs, a, b + step),
    )  # fmt: skip
    ga, gb = setup.per_metre * (a2 - a1), setup.per_metre * (b2 - b1)
    tilt_a = tilt_b = 0.0
    if own > 0.0:
        tilt_a = min(max((_density(cell, legs, a + step, b) - _density(cell, legs, a - step, b)) / own, -2.0), 2.0)
        tilt_b = min(max((_density(cell, legs, a, b + step) - _density(cell, legs, a, b - step)) / own, -2.0), 2.0)
    late = ga * (tilt_a * aa + tilt_b * ab) + gb * (tilt_b * bb + tilt_a * ab)
    late += 2.0 * setup.per_metre * ((a1 + a2 - 2.0 * path) * aa + (b1 + b2 - 2.0 * path) * bb)
    mean = one = two = 0.0
    if cluster[17] > 0.0:
        y, _ = _hidden_point(cell, a, b)
        mean, one, two = change_over_cluster(y, legs.seen, cluster, setup.scene.from_source)
    one, two = one * setup.per_metre, two * setup.per_metre
    # Four even spreads as two: the widest of them, and one with the variance of the others.
    w1, w2 = 12.0 * ga * ga * aa, 12.0 * gb * gb * bb
    cross_term = 24.0 * ga * gb * ab
    total = max(w1 + w2 + cross_term, 0.0)
    share = w1 / (w1 + w2) if w1 + w2 > 0.0 else 0.5
    w1, w2, w3, w4 = total * share, total * (1.0 - share), one * one, two * two
    most, every = max(w1, w2, w3, w4), total + w3 + w4
    rest = min(max(every - most, 0.0), 0.5 * every)
    wide, narrow = math.sqrt(every - rest), math.sqrt(rest)
    return light, (path + mean) * setup.per_metre + late - setup.start, wide, narrow


@compiled(forceinline=True, allocates=False)
def _legs_of(ends, i, p, j):  # type: ignore[no-untyped-def]
    """The `_Legs` of laser point i and FoV point j of pixel p."""
    setup, seen = ends.setup, ends.seen
    points, row = setup.lasers, seen.cluster[p]
    z, is_flat = get(seen.position, j, 0), row[0, 17] > 0.0
    leg = points.leg[i] + (row[0, 17] if is_flat else seen.leg[j]) if setup.scene.from_source else 0.0
    middle = Middle(get(row, 0, 0) if is_flat else z, get(ends.middle, p, 0))
    return _Legs(get(points.position, i, 0), get(points.normal, i, 0), z, get(seen.normal, j, 0), middle, leg)


@compiled(forceinline=True, allocates=False)
def _cell_at(cells, k, views, view, ends, side):  # type: ignore[no-untyped-def]
    """The `_Cell` of index k of a view."""
    face, i, j = place_of(side, cells.number[k])
    axes, f, s = views.axes[view], cells.face[k], get(cells.start, k, 0)
    n = get(ends.normal, f, 0)
    height = dot(n, subtract(get(ends.corners[f], 0, 0), s))
    d = on_face(face, along(axes, get(cells.direction, k, 0)))
    x, y = (
        0.5 * (d[0] / d[2] + 1.0) * side * PLACES,
        0.5 * (d[1] / d[2] + (1.0 if face == 0 else 0.0)) * side * PLACES,
    )
    return _Cell(
        face, i, j, x - math.floor(x), y - math.floor(y), get(axes, 0, 0), get(axes, 1, 0), get(axes, 2, 0), s, n,
        height, cells.depth[k],
    )  # fmt: skip


@compiled(forceinline=True, allocates=False)
def _is_hidden_from(point, view, views, side, bits, near):  # type: ignore[no-untyped-def]
    """Whether the picture of a view covers a point, and is nearer than it."""
    d = along(views.axes[view], subtract(point, get(views.origin, view, 0)))
    face = face_toward(d)
    if face < 0:
        return False
    q = on_face(face, d)
    a, b = q[0] / q[2], q[1] / q[2]
    if not is_covered(side, face, a, b, bits):
        return False
    i, j = int(0.5 * (a + 1.0) * side), int(0.5 * (b + (1.0 if face == 0 else 0.0)) * side)
    return near[number_of(side, face, i, j)] < q[2]


@compiled(forceinline=True, allocates=False)
def _neighbour(side, face, i, j):  # type: ignore[no-untyped-def]
    """The number of cell (i, j) of a face, −1 if it is none."""
    is_one = 0 <= i < side and 0 <= j < (side if face == 0 else side // 2)
    return number_of(side, face, i, j) if is_one else -1


@compiled(forceinline=True, allocates=False)
def _is_deep(point, view, views, side, bits):  # type: ignore[no-untyped-def]
    """Whether the picture of a view covers all about a point."""
    d = along(views.axes[view], subtract(point, get(views.origin, view, 0)))
    face = face_toward(d)
    if face < 0:
        return False
    q = on_face(face, d)
    i, j = int(0.5 * (q[0] / q[2] + 1.0) * side), int(0.5 * (q[1] / q[2] + (1.0 if face == 0 else 0.0)) * side)
    for k in range(9):
        number = _neighbour(side, face, i + k // 3 - 1, j + k % 3 - 1)
        if number < 0 or bits[number] != FULL:
            return False
    return True


@compiled(allocates=False)
def _places_seen_but_not_lit(cell, legs, nearest, shift, i, views, side, bits, near):  # type: ignore[no-untyped-def]
    """Bits of the places of a pixel's cell that movers hide from a FoV point and not from laser point i.

    nearest : depth of the movers there. shift : of the FoV point from the middle of the pixel, on the face. views :
    of laser points. bits, near : (2, cells) of the pictures of the laser point and the pixel.
    """
    found = 0
    a, b = toward(side, cell.face, cell.i + 0.5, cell.j + 0.5)
    if _is_deep(_hidden_point(cell, a, b)[0], i, views, side, bits[0]):
        return 0
    for bit in range(PLACES * PLACES):
        # Anywhere in a place, so that a shift by less than a place counts by its share.
        x, y = (bit // PLACES + cell.across) / PLACES, (bit % PLACES + cell.up) / PLACES
        a, b = toward(side, cell.face, cell.i + x, cell.j + y)
        # From the FoV point movers are seen beside where the middle of the pixel sees them.
        depth = nearest + shift[2]
        if depth > 0.0 and is_covered(
            side, cell.face, (nearest * a + shift[0]) / depth, (nearest * b + shift[1]) / depth, bits[1]
        ):
            point, _ = _hidden_point(cell, a, b)
            if not _is_hidden_from(point, i, views, side, bits[0], near[0]):
                found |= 1 << bit
    return found


@compiled(forceinline=True, allocates=False)
def _take(drawn, m, bits, near, is_shown):  # type: ignore[no-untyped-def]
    """Sets bits and near (cells,) to those of picture m, or bits back to 0."""
    for e in range(drawn.first[m], drawn.first[m + 1]):
        bits[drawn.cell[e]], near[drawn.cell[e]] = drawn.bits[e] if is_shown else 0, drawn.near[e]


@compiled(forceinline=True, allocates=False)
def _nearest(side, cell, bits, near):  # type: ignore[no-untyped-def]
    """Depth of what is covered in a cell, or else in its neighbours on the face; infinite if nothing is."""
    if bits[cell] != 0:
        return near[cell]
    face, i, j = place_of(side, cell)
    high, most = side if face == 0 else side // 2, np.inf
    for k in range(max(i - 1, 0), min(i + 1, side - 1) + 1):
        for q in range(max(j - 1, 0), min(j + 1, high - 1) + 1):
            other = number_of(side, face, k, q)
            if bits[other] != 0:
                most = min(most, near[other])
    return most


@compiled(allocates=False)
def _pour_all(job, drawn, cells, flows, views, ends, side, bits, near, done, light, outside):  # type: ignore[no-untyped-def]
    """Adds what is blocked in all histograms to light (S, n, T) and outside (n,).

    job : (m, 8) pictures of laser point and pixel, pair, index of both, number of both, row of `light`. drawn, cells,
    flows, views : those of laser points, and of pixels; flows of `_light`. bits, near : (2, cells), done : (cells,),
    to work in; bits are 0 before and after, done −1 before.
    """
    (drawn_x, drawn_z), (x_cells, z_cells), (x_light, z_light), (x_views, z_views) = drawn, cells, flows, views
    setup, seen = ends.setup, ends.seen
    points = len(seen.part) // len(seen.cluster)
    for h in range(len(job)):
        mx, mz, pair, view_x, view_z, i, p, to_row = (
            job[h, 0], job[h, 1], job[h, 2], job[h, 3], job[h, 4], job[h, 5], job[h, 6], job[h, 7]
        )  # fmt: skip
        if setup.lasers.part[i] < 0 or seen.cluster[p, 0, 9] <= 0.0:
            continue
        row = seen.cluster[p, 0]
        for e in range(drawn_x.first[mx], drawn_x.first[mx + 1]):
            k = x_cells.at[view_x, drawn_x.cell[e]]
            own = x_light[1][x_light[0][pair] + k - x_cells.first[view_x]]
            if own > 0.0 and drawn_x.near[e] < x_cells.depth[k]:
                known = x_light[2][x_light[0][pair] + k - x_cells.first[view_x]]
                to = light[ends.slot[ends.part[x_cells.face[k]]], to_row]
                if drawn_x.bits[e] != FULL or known[1] < 0.0:
                    cell, legs = (
                        _cell_at(x_cells, k, x_views, i, ends, side),
                        _legs_of(ends, i, p, p * points + x_cells.point[k]),
                    )
                    taken, time, wide, narrow = _spread(cell, legs, drawn_x.bits[e], row, setup, side)
                    if drawn_x.bits[e] == FULL:
                        # Whatever the frame.
                        known[0], known[1], known[2] = time, wide, narrow
                else:
                    taken, time, wide, narrow = 1.0, known[0], known[1], known[2]
                outside[to_row] += _deposit(to, time, wide, narrow, taken * own)
        if drawn_z.first[mz] == drawn_z.first[mz + 1]:
            continue
        _take(drawn_x, mx, bits[0], near[0], True)
        _take(drawn_z, mz, bits[1], near[1], True)
        for e in range(drawn_z.first[mz], drawn_z.first[mz + 1]):
            face, at_i, at_j = place_of(side, drawn_z.cell[e])
            for q in range(9):
                number = _neighbour(side, face, at_i + q // 3 - 1, at_j + q % 3 - 1)
                if number < 0 or done[number] == h:
                    continue
                done[number] = h
                k = z_cells.at[view_z, number]
                own = z_light[1][z_light[0][pair] + k - z_cells.first[view_z]]
                nearest = _nearest(side, number, bits[1], near[1]) if own > 0.0 else np.inf
                if not nearest < z_cells.depth[k]:
                    continue
                j = p * points + z_cells.point[k]
                cell, legs = _cell_at(z_cells, k, z_views, p, ends, side), _legs_of(ends, i, p, j)
                shift = on_face(face, along(z_views.axes[p], subtract(legs.z, get(z_views.origin, p, 0))))
                found = _places_seen_but_not_lit(cell, legs, nearest, shift, i, x_views, side, bits, near)
                if found != 0:
                    to = light[ends.slot[ends.part[z_cells.face[k]]], to_row]
                    taken, time, wide, narrow = _spread(cell, legs, found, row, setup, side)
                    outside[to_row] += _deposit(to, time, wide, narrow, taken * own)
        _take(drawn_x, mx, bits[0], near[0], False)
        _take(drawn_z, mz, bits[1], near[1], False)
