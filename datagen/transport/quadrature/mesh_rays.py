"""Light of three bounces by way of meshes: rays from the laser point on a lattice of directions.

Of a mesh of many small triangles nearly everything is hidden from somewhere, by itself or by others: of elements that
it is cut into, most would be asked for in vain. Sent out from the laser point x, a ray finds what x lights, and all
that is left to ask is whether the pixel's point z sees that, too. With dω = cosθ₂/R₁² dA₂ the primary becomes

    L = ∫ f₁ cosθ₁ · f₂ · cosθ₂′ cosθ₃ V₂₃/R₂₃² · f₃ W dω,

W the sensor's share. The directions are a rank-1 lattice (Fibonacci's) in the rectangle that frames the mesh, shifted
at random; the light of a ray is spread over the arrival times of its cell of the lattice, a parallelogram on the
surface that it meets. So the error falls nearly as 1/N for N rays, where samples that fall into one bin each have
1/√N. What a ray meets is connected with points all over the pixel, the closer ones the more densely.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, QhullError

from datagen.compiled import compiled
from datagen.records import Scene
from datagen.records.arrays import Bools, Floats, Ints
from datagen.transport.brdf import dot, in_frame_of
from datagen.transport.geometry import corner, distance, get, put, subtract, unit
from datagen.transport.memory import VALUES_AT_ONCE
from datagen.transport.quadrature.arrival_times import spread, widened
from datagen.transport.quadrature.weights import footprint_variance, weight
from datagen.transport.sampling import mix, word_of
from datagen.transport.visibility.raycast import Raycaster

TRIANGLES = 400
"""Triangles from which a part is a mesh. From 64 on, rooms with furniture took 1.3 to 1.8 times as long; from 1500 on
some rooms took 1.3 times as long."""
SHARPEST = 16.0
"""1/width² of the narrowest lobe, rad⁻², up to which rays are sent: of a narrower one a lattice may miss the few
normals that bring all the light, and elements are cut where they are."""
LEAST, MOST = 64, 1 << 17
"""Rays of a mesh at least, times 1/width² of the narrowest lobe, and at most, for each laser point and pixel. With
half the least, coarse lattices miss a tenth of what they see."""
CARRIED = 2.0
"""Light of a ray, as far as nothing hides it, relative to the error that one may make: at the mesh's outline about
half of it is wrong."""
FRAMED = 0.5
"""Least cosine of a corner of the mesh with the direction of its middle, for which a rectangle frames it; else it is
all around, and rays go into the whole half space."""
GRAZING = 0.05
"""Least cosine that is taken for the light that a ray carries: half of it changes little, for it only sets how many
rays are sent."""
LEVEL, EDGE_LEVEL = 4, 3
"""How often a pixel is quartered at most to be connected with what a ray meets: with half as many, pixels 20 cm wide
see a mesh beside them too coarsely. And how often where an edge runs through it, with one random point in each
footprint on the edge: one level less leaves twice the noise there."""
TURN = 0.6180339887498949
"""The golden section, by which the second coordinate of a lattice goes on from one ray to the next."""


class Outlines(NamedTuple):
    """The corners (V, 3) of the convex hulls of all meshes one after the other, metres; the first of each part's,
    (K + 1,); and middle (K, 3) and radius (K,) of a ball about it, metres. None of parts that are no meshes."""

    corners: Floats
    first: Ints
    middle: Floats
    radius: Floats

    @classmethod
    def of(cls, scene: Scene, meshes: Bools) -> Outlines:
        """The outlines of the parts that `meshes` (K,) marks."""
        hulls = [
            _hull(scene.vertices[np.unique(scene.triangles[scene.face_part == k])]) if is_mesh else np.empty((0, 3))
            for k, is_mesh in enumerate(meshes)
        ]
        middle = np.array([(h.min(axis=0) + h.max(axis=0)) / 2 if len(h) else np.zeros(3) for h in hulls])
        radius = np.array(
            [np.linalg.norm(h - c, axis=1).max(initial=0.0) for h, c in zip(hulls, middle, strict=True)]
        )
        first = np.concatenate([[0], np.cumsum([len(h) for h in hulls])])
        return cls(np.concatenate(hulls), first, middle, radius)


def _hull(vertices: Floats) -> Floats:
    """(V, 3) the corners of their convex hull, or of the box about them where they lie in a plane."""
    try:
        return np.asarray(vertices[ConvexHull(vertices).vertices])
    except QhullError:
        low, high = vertices.min(axis=0), vertices.max(axis=0)
        return np.stack(np.meshgrid(*np.stack([low, high], axis=1)), axis=-1).reshape(-1, 3)


class Fans(NamedTuple):
    """Lattices of rays, each from a laser point into the frame of one part, for one pixel.

    Attributes
    ----------
    pair, part : (n,) which pair of laser point and pixel, and which part.
    first : (n + 1,) number of the first ray of each.
    frame : (n, 9) direction of the rectangle's first corner, and its two sides, in units of the distance; zeros for
        the half space before the laser point.
    """

    pair: Ints
    part: Ints
    first: Ints
    frame: Floats


class Connections(NamedTuple):
    """What rays met, connected with points of a pixel.

    Attributes
    ----------
    photons : (n,) what arrives, if nothing hides it. at, variance : (n,) when, bins, and the variance of that, bins².
    part, into : (n,) of the mesh, and row of the histogram.
    start, end : (n, 3) what must be free, a little above the surfaces, metres.
    asked : (n,) whether it may be hidden at all.
    """

    photons: Floats
    at: Floats
    variance: Floats
    part: Ints
    into: Ints
    start: Floats
    end: Floats
    asked: Bools

    @classmethod
    def room(cls, count: int) -> Connections:
        """Unfilled arrays for `count` connections."""
        photons, at, variance = np.empty((3, count))
        part, into = np.empty((2, count), np.int64)
        start, end = np.empty((2, count, 3))
        return cls(photons, at, variance, part, into, start, end, np.empty(count, np.bool_))


def gather_by_rays(  # type: ignore[no-untyped-def]
    caster: Raycaster, face_part: NDArray[np.integer], pairs: Ints, scan, outlines: Outlines, tally, across: float
) -> None:
    """Add the light of meshes to the histograms of pairs of laser point and row of footprints.

    caster, face_part : of the scene's triangles (F,). pairs : (n, 2). scan, tally : `Scan` and `Tally`.
    across : largest footprint of a point that is connected with what rays meet, relative to its distance from there.
    """
    parts, points = len(outlines.radius), min(4**LEVEL, scan.patches.part.shape[1])
    pairs_at_once, rays_at_once = VALUES_AT_ONCE // 512, VALUES_AT_ONCE // 128
    for run in range(0, len(pairs) if outlines.first[-1] else 0, pairs_at_once):
        some = np.arange(run, min(run + pairs_at_once, len(pairs)))
        room = len(some) * parts
        pair, part = np.empty((2, room), np.int64)
        fans = Fans(pair, part, np.zeros(room + 1, np.int64), np.zeros((room, 9)))
        first = fans.first[: 1 + _plan(pairs, some, scan, outlines, fans)]
        for start in range(0, int(first[-1]), rays_at_once):
            count = min(rays_at_once, int(first[-1]) - start)
            fan = int(np.searchsorted(first, start, side="right")) - 1
            origin, normal, direction = np.empty((3, count, 3))
            _aim(pairs, scan, tally, fans, fan, start, origin, normal, direction)
            hits = caster.leaving(origin, normal, direction)
            found = Connections.room(count * points)
            n = _connect(pairs, scan, fans, fan, start, hits, face_part, caster.offset_m, across, tally, found)
            asked = np.flatnonzero(found.asked[:n])
            found.photons[asked[caster.occluded(found.start[asked], found.end[asked])]] = 0.0
            _put(found, n, tally)


@compiled(_nrt=False)
def _plan(pairs, some, scan, outlines, fans):  # type: ignore[no-untyped-def]
    """Fill `fans` for the pairs in rows `some`; returns how many there are."""
    lasers, patches, cutting, n = scan.lasers, scan.patches, scan.cutting, 0
    for pair in some:
        i, p = pairs[pair, 0], pairs[pair, 1]
        # Any of its footprints that sees a surface tells where the pixel is.
        q = 0
        while q < patches.part.shape[1] and patches.part[p, q] < 0:
            q += 1
        if lasers.part[i] < 0 or q == patches.part.shape[1]:
            continue
        x, n1, k1, k3 = get(lasers.position, i, 0), get(lasers.normal, i, 0), lasers.part[i], patches.part[p, q]
        z, n3 = corner(patches.position, p, q), corner(patches.normal, p, q)
        for k in range(len(outlines.radius)):
            m, radius = get(outlines.middle, k, 0), outlines.radius[k]
            rise1, rise3 = dot(subtract(m, x), n1) + radius, dot(subtract(m, z), n3) + radius
            if radius == 0.0 or rise1 <= 0.0 or not cutting.error[k] < np.inf:
                continue
            r1, r3 = max(distance(m, x), radius), max(distance(m, z), radius)
            light = (
                lasers.power[i] * patches.most_weight[p, 0] * cutting.peak[k1] * cutting.peak[k] * cutting.peak[k3]
            )
            light *= _frame(x, k, outlines, fans.frame, n) / (r3 * r3)
            light *= max(min(rise1 / r1, 1.0), GRAZING) * max(min(rise3 / r3, 1.0), GRAZING)
            keen = max(cutting.sharp[k1], cutting.sharp[k], cutting.sharp[k3])
            count = np.int64(min(max(light / (CARRIED * cutting.error[k]), LEAST * keen), MOST))
            fans.pair[n], fans.part[n], fans.first[n + 1] = pair, k, fans.first[n] + count
            n += 1
    return n


@compiled(_nrt=False)
def _frame(o, k, outlines, frame, n):  # type: ignore[no-untyped-def]
    """Put the frame of mesh k, seen from o, into row n; returns its solid angle, about."""
    axis = subtract(get(outlines.middle, k, 0), o)
    for j in range(9):
        frame[n, j] = 0.0
    if dot(axis, axis) == 0.0:
        return 2.0 * math.pi
    axis = unit(axis)
    right, up = in_frame_of(axis, 1.0, 0.0, 0.0), in_frame_of(axis, 0.0, 1.0, 0.0)
    left, low, most, high = np.inf, np.inf, -np.inf, -np.inf
    for v in range(outlines.first[k], outlines.first[k + 1]):
        d = subtract(get(outlines.corners, v, 0), o)
        depth = dot(d, axis)
        if depth <= 0.0 or depth * depth <= FRAMED * FRAMED * dot(d, d):
            return 2.0 * math.pi
        u, w = dot(d, right) / depth, dot(d, up) / depth
        left, most, low, high = min(left, u), max(most, u), min(low, w), max(high, w)
    for j in range(3):
        frame[n, j] = axis[j] + left * right[j] + low * up[j]
        frame[n, 3 + j], frame[n, 6 + j] = (most - left) * right[j], (high - low) * up[j]
    return (most - left) * (high - low)


@compiled()
def _direction(fans, fan, j, n, word):  # type: ignore[no-untyped-def]
    """Ray j of a fan from a laser point with normal n: its direction, of any length, what that changes by along both
    sides of the frame, and the solid angle of all rays if all were like this one; word : shifts the lattice."""
    count = fans.first[fan + 1] - fans.first[fan]
    s = ((j + 0.5) / count + np.float64(mix(word, np.uint64(0))) * 2.0**-32) % 1.0
    t = (j * TURN + np.float64(mix(word, np.uint64(1))) * 2.0**-32) % 1.0
    first, right, up = get(fans.frame, fan, 0), get(fans.frame, fan, 3), get(fans.frame, fan, 6)
    if first[0] == 0.0 and first[1] == 0.0 and first[2] == 0.0:
        # Evenly over the half space: evenly in height and angle.
        angle, sine = 2.0 * math.pi * t, max(math.sqrt(1.0 - s * s), 1e-9)
        east, north = math.cos(angle), math.sin(angle)
        along = in_frame_of(n, -s / sine * east, -s / sine * north, 1.0)
        round_it = in_frame_of(n, -2.0 * math.pi * sine * north, 2.0 * math.pi * sine * east, 0.0)
        return in_frame_of(n, sine * east, sine * north, s), along, round_it, 2.0 * math.pi
    d = (
        first[0] + s * right[0] + t * up[0],
        first[1] + s * right[1] + t * up[1],
        first[2] + s * right[2] + t * up[2],
    )
    square = dot(d, d)
    # The frame lies in a plane one away, across its axis.
    return d, right, up, math.sqrt(dot(right, right) * dot(up, up)) / (square * math.sqrt(square))


@compiled()
def _word(scan, tally, fans, fan):  # type: ignore[no-untyped-def]
    """The random word of a fan: of its histogram and part, so that it is the same whatever the footprints."""
    return word_of(scan.cutting.seed[fans.part[fan]], tally.row_of_pair[fans.pair[fan]], fans.part[fan])


@compiled(_nrt=False)
def _aim(pairs, scan, tally, fans, fan, start, origin, normal, direction):  # type: ignore[no-untyped-def]
    """Fill the places, normals and directions (n, 3) of the rays from number `start` on, which is of a fan."""
    for r in range(len(origin)):
        while start + r >= fans.first[fan + 1]:
            fan += 1
        i = pairs[fans.pair[fan], 0]
        n, word = get(scan.lasers.normal, i, 0), _word(scan, tally, fans, fan)
        put(origin, r, 0, get(scan.lasers.position, i, 0))
        put(normal, r, 0, n)
        put(direction, r, 0, unit(_direction(fans, fan, start + r - fans.first[fan], n, word)[0]))


@compiled()
def _connect(pairs, scan, fans, fan, start, hits, face_part, offset, wide, tally, found):  # type: ignore[no-untyped-def]
    """Fill `found` with what rays met, from ray number `start` on, which is of a fan; returns how many these are."""
    lasers, patches, clock, m = scan.lasers, scan.patches, scan.clock, 0
    chosen, waiting = np.empty((4**LEVEL, 2), np.int64), np.empty((4**LEVEL, 2), np.int64)
    for r in range(len(hits.face)):
        while start + r >= fans.first[fan + 1]:
            fan += 1
        k, j, pair = fans.part[fan], start + r - fans.first[fan], fans.pair[fan]
        tally.work[k, 1] += 1
        # What was met before the mesh is of another part.
        if hits.face[r] < 0 or face_part[hits.face[r]] != k:
            continue
        i, p, count = pairs[pair, 0], pairs[pair, 1], fans.first[fan + 1] - fans.first[fan]
        x, n1, k1 = get(lasers.position, i, 0), get(lasers.normal, i, 0), lasers.part[i]
        y, n, word = get(hits.position, r, 0), get(hits.normal, r, 0), _word(scan, tally, fans, fan)
        lit = (x, n1, get(lasers.to_laser, i, 0), scan.kind[k1], scan.values[k1])
        d, along, across, solid_angle = _direction(fans, fan, j, n1, word)
        back1, steep = subtract(y, x), -dot(d, n)
        reach, length = math.sqrt(dot(back1, back1)), math.sqrt(dot(d, d))
        if not (steep > 0.0 and reach > 0.0):
            continue
        # Its cell of the lattice on the surface that it meets: its area, and how far paths differ over it.
        area, size = solid_angle * reach * reach * length / (steep * count), reach / (length * math.sqrt(count))
        g, many = unit(back1), _points(patches, p, y, wide, mix(word, np.uint64(2 + j)), chosen, waiting)
        for c in range(many):
            q, share = chosen[c, 0], chosen[c, 1]
            k3 = patches.part[p, q]
            z, n3 = corner(patches.position, p, q), corner(patches.normal, p, q)
            seen = (z, n3, corner(patches.to_sensor, p, q), scan.kind[k3], scan.values[k3])
            w, r1, r3 = weight(
                y, n, scan.kind[k], scan.values[k], lit, seen, patches.footprint[p, q], clock.attenuation
            )  # fmt: skip
            if not w > 0.0:
                continue
            back3 = subtract(y, z)
            h = (g[0] + back3[0] / r3, g[1] + back3[1] / r3, g[2] + back3[2] / r3)
            # Edge-on a cell reaches far beyond the mesh.
            one = min(abs(size * (dot(h, along) + dot(h, d) * dot(n, along) / steep)), reach)
            other = min(abs(size * (dot(h, across) + dot(h, d) * dot(n, across) / steep)), reach)
            variance = (one * one + other * other) / 12 + footprint_variance(
                back3, seen[2], clock.device, patches.across, p, q
            )
            device = lasers.leg[i] + patches.leg[p, q] if clock.device else 0.0
            found.photons[m] = w * area * lasers.power[i] * patches.weight[p, q] * share
            found.at[m] = (r1 + r3 + device) * clock.per_metre - clock.start
            found.variance[m] = variance * clock.per_metre * clock.per_metre
            found.part[m], found.into[m] = k, tally.row_of_pair[pair] + tally.row_of_part[k]
            # The point of a confocal pixel that is the laser point sees what that lights.
            found.asked[m] = scan.cutting.rays_on_last_leg and distance(x, z) > scan.occluders.flat
            for a in range(3):
                found.start[m, a], found.end[m, a] = y[a] + offset * n[a], z[a] + offset * n3[a]
            m += 1
    return m


@compiled(_nrt=False)
def _points(patches, p, y, wide, word, chosen, waiting):  # type: ignore[no-untyped-def]
    """Choose the footprints of row p that are connected with y; returns how many.

    wide : their largest size, relative to their distance. chosen : (n, 2) which, and how many alike each stands for.
    waiting : (n, 2) room for what is looked at.
    """
    top, found, quarters = 1, 0, patches.quarters
    waiting[0, 0], waiting[0, 1] = 0, 0
    while top > 0:
        top -= 1
        q, level = waiting[top, 0], waiting[top, 1]
        finest, share, edge = quarters[q, 0] < 0, 1, patches.uneven[p, q]
        if edge and not finest and level == EDGE_LEVEL:
            # An edge runs through it: one of its finest footprints at random.
            while quarters[q, 0] >= 0:
                word = mix(word, np.uint64(q))
                q, share = quarters[q, np.int64(word & np.uint64(3))], 4 * share
            finest = True
        fine = not edge and (
            level >= LEVEL or patches.size[p, q] <= wide * distance(y, corner(patches.position, p, q))
        )
        if finest or fine:
            chosen[found, 0], chosen[found, 1] = q, share
            found += patches.part[p, q] >= 0
        else:
            for quarter in quarters[q]:
                waiting[top, 0], waiting[top, 1] = quarter, level + 1
                top += 1
    return found


@compiled(_nrt=False)
def _put(found, count, tally):  # type: ignore[no-untyped-def]
    """Add the light of the first `count` connections to the histograms."""
    for m in range(count):
        tally.work[found.part[m], 1] += found.asked[m]
        if found.photons[m] > 0.0:
            tally.work[found.part[m], 0] += 1
            t, into = found.at[m], found.into[m]
            a, b, c = widened(t, t, t, found.variance[m])
            tally.overflow[into] += spread(tally.histogram, into, a, b, c, 1.0, 1.0, 1.0, found.photons[m])
