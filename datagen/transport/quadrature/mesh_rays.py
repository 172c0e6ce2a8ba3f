"""Light of three bounces by way of meshes: rays from the laser point on a lattice of directions.

Nearly all of a mesh of many small triangles is hidden from the laser point x or from the pixel's point z, by itself
or by others: shadow rays to the surface elements that it is cut into would mostly find nothing. A ray that is sent
out from x finds a point y that x lights, and one shadow ray tells whether z sees y, too. With dω = cosθ₂/R₁² dA₂ the
primary becomes

    L = ∫ f₁ cosθ₁ · f₂ · cosθ₂′ cosθ₃ V₂₃/R₂₃² · f₃ W dω,

with W the sensor's factor (`weights.py`). The directions are a rank-1 lattice (Fibonacci's) in the rectangle that
frames the mesh, shifted at random. The light of a ray is spread over the arrival times of its cell of the lattice, a
parallelogram on the surface that it meets, so that the error falls nearly as 1/N for N rays; samples that fall into
one bin each would have 1/√N. The point that a ray meets is connected with points all over the pixel, the nearer it is
to the pixel, the more of them.
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
from datagen.transport.arrival_times import spread, widened
from datagen.transport.quadrature.footprints import finest_within
from datagen.transport.quadrature.weights import path_changes, weight
from datagen.transport.sampling import mix, word_of
from datagen.transport.visibility.raycast import Raycaster

TRIANGLES = 400
"""Number of triangles of a part from which on its light comes by rays. If it begins at 64 triangles, rooms with
furniture take 1.3 to 1.8 times as long; if at 1500, some rooms take 1.3 times as long."""
SHARPEST = 16.0
"""Largest 1/width² of the narrowest lobe on the path, rad⁻², for which rays are sent: with a narrower lobe a lattice
may miss the few normals that bring all the light, while elements are cut where these are. Half of it only costs time
with lobes in between."""
LEAST, MOST = 64, 1 << 17
"""Fewest rays of a mesh for each laser point and pixel, for each unit of 1/width² of the narrowest lobe, and most
rays. With half of the first, coarse lattices miss a tenth of what they see; half of the second gives up strict
targets earlier."""
CARRIED = 2.0
"""Light of a ray, if nothing hides it, relative to the error that a ray may make: at the mesh's outline about half of
the light is wrong. Half of it sends twice as many rays."""
FRAMED = 0.5
"""Least cosine between the directions to a corner and to the middle of a mesh for which a rectangle frames the mesh;
if a corner has less, rays go into the whole half space. With half of it, rectangles of near meshes get large, and
their corners get rays that carry little."""
GRAZING = 0.05
"""Least cosine that is assumed for the light that a ray carries. Half of it changes little, because it only sets how
many rays are sent."""
EDGE_ON = 0.3
"""Least cosine at a surface with which a ray's cell of the lattice is projected onto it for arrival times. With half
of it, light of a mesh that holds the laser point and the pixel arrives over 4 % too wide a time, however many rays
there are; twice as much adds noise to flat surfaces seen edge-on."""
FEW_BINS = 1.0
"""Bins over which the light of a footprint arrives up to which only their mean and variance count. Half of it changes
little; with twice as much, steps of the signal of a large pixel near a mesh are smeared."""
LEVEL, EDGE_LEVEL = 4, 3
"""Most times that a pixel is quartered for connections with what rays meet (with half as many, pixels 20 cm wide see
a mesh beside them too coarsely); and times that a footprint with an edge is quartered before one random point stands
for it (one less leaves twice the noise there)."""


class Outlines(NamedTuple):
    """Convex hulls of the parts that are meshes; parts that are no meshes have no corners and the radius 0.

    Attributes
    ----------
    corners : (V, 3) corners of all hulls, part by part, metres.
    first : (K + 1,) index of the first corner of each part.
    middle, radius : (K, 3), (K,) sphere about each part, metres.
    """

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
            [np.linalg.norm(h - m, axis=1).max(initial=0.0) for h, m in zip(hulls, middle, strict=True)]
        )
        first = np.concatenate([[0], np.cumsum([len(h) for h in hulls])])
        return cls(np.concatenate(hulls), first, middle, radius)


def _hull(vertices: Floats) -> Floats:
    """(V, 3) corners of the convex hull of vertices, metres, or of their bounding box if they lie in a plane."""
    try:
        return np.asarray(vertices[ConvexHull(vertices).vertices])
    except QhullError:
        low, high = vertices.min(axis=0), vertices.max(axis=0)
        return np.stack(np.meshgrid(*np.stack([low, high], axis=1)), axis=-1).reshape(-1, 3)


class Fans(NamedTuple):
    """n lattices of rays. The rays of one *fan* go from a laser point to one mesh, for the light of one pixel.

    Attributes
    ----------
    pair, part : (n,) indices of each fan's pair of laser point and pixel, and of its mesh.
    first : (n + 1,) index of the first ray of each fan, all rays counted one after the other.
    frame : (n, 9) rectangle that frames the mesh, in the plane at distance 1 from the laser point: vector to its
        first corner, and its two sides. Zeros if rays go into the half space before the laser point.
    """

    pair: Ints
    part: Ints
    first: Ints
    frame: Floats


class Connections(NamedTuple):
    """n connections of the points that rays meet with points of a pixel.

    Attributes
    ----------
    photons : (n,) light by way of each connection, if nothing hides it, per photon emitted.
    arrival, variance : (n,) its mean arrival time, bins, and variance over the ray's cell of the lattice, bins².
    across : (n, 2) change of its arrival time along the two sides of the footprint, bins.
    part, into : (n,) index of the mesh, and row of the histogram.
    start, end : (n, 3) ends of the shadow ray, a little above the surfaces, metres.
    needs_ray : (n,) whether a shadow ray has to be cast.
    """

    photons: Floats
    arrival: Floats
    variance: Floats
    across: Floats
    part: Ints
    into: Ints
    start: Floats
    end: Floats
    needs_ray: Bools

    @classmethod
    def room(cls, count: int) -> Connections:
        """Unfilled arrays for `count` connections."""
        photons, arrival, variance = np.empty((3, count))
        part, into = np.empty((2, count), np.int64)
        start, end = np.empty((2, count, 3))
        across = np.empty((count, 2))
        return cls(photons, arrival, variance, across, part, into, start, end, np.empty(count, np.bool_))


def gather_by_rays(  # type: ignore[no-untyped-def]
    caster: Raycaster, face_part: NDArray[np.integer], pairs: Ints, scan, outlines: Outlines, tally,
    footprint_ratio: float,
) -> None:  # fmt: skip
    """Add the light of meshes to the histograms of pairs (n, 2) of laser point and row of footprints.

    face_part : (F,) part of each triangle of the scene. scan, tally : `Scan` and `Tally`.
    footprint_ratio : largest footprint that is connected with the hit of a ray, relative to its distance from there.
    """
    parts, points = len(outlines.radius), min(4**LEVEL, scan.patches.part.shape[1])
    pairs_at_once, rays_at_once = VALUES_AT_ONCE // 512, VALUES_AT_ONCE // 128
    for run in range(0, len(pairs) if outlines.first[-1] else 0, pairs_at_once):
        batch = np.arange(run, min(run + pairs_at_once, len(pairs)))
        room = len(batch) * parts
        pair, part = np.empty((2, room), np.int64)
        fans = Fans(pair, part, np.zeros(room + 1, np.int64), np.zeros((room, 9)))
        first = fans.first[: 1 + _plan(pairs, batch, scan, outlines, fans)]
        # The rays of all fans are cast in batches of one size, however they are divided among fans.
        for start in range(0, int(first[-1]), rays_at_once):
            count = min(rays_at_once, int(first[-1]) - start)
            fan = int(np.searchsorted(first, start, side="right")) - 1
            origin, normal, direction = np.empty((3, count, 3))
            _aim(pairs, scan, tally, fans, fan, start, origin, normal, direction)
            hits = caster.leaving(origin, normal, direction)
            connections = Connections.room(count * points)
            n = _connect(
                pairs, scan, fans, fan, start, hits, face_part, caster.offset_m, footprint_ratio, tally, connections
            )
            to_test = np.flatnonzero(connections.needs_ray[:n])
            hidden = caster.occluded(connections.start[to_test], connections.end[to_test])
            connections.photons[to_test[hidden]] = 0.0
            _add_light(connections, n, tally)


@compiled(_nrt=False)
def _plan(pairs, batch, scan, outlines, fans):  # type: ignore[no-untyped-def]
    """Number of fans for the pairs in the rows `batch`, which are written to `fans`."""
    lasers, patches, cutting, n = scan.lasers, scan.patches, scan.cutting, 0
    for pair in batch:
        i, p = pairs[pair, 0], pairs[pair, 1]
        # The first of its footprints that sees a surface stands for where the pixel is.
        q = 0
        while q < patches.part.shape[1] and patches.part[p, q] < 0:
            q += 1
        if lasers.part[i] < 0 or q == patches.part.shape[1]:
            continue
        x, n1, k1, k3 = get(lasers.position, i, 0), get(lasers.normal, i, 0), lasers.part[i], patches.part[p, q]
        z, n3 = corner(patches.position, p, q), corner(patches.normal, p, q)
        for k in range(len(outlines.radius)):
            # Parts that are no meshes, or lie behind the laser point, get no rays.
            m, radius = get(outlines.middle, k, 0), outlines.radius[k]
            rise1, rise3 = dot(subtract(m, x), n1) + radius, dot(subtract(m, z), n3) + radius
            if radius == 0.0 or rise1 <= 0.0 or not cutting.error[k] < np.inf:
                continue
            # Upper bound of the light by way of the mesh, from which the number of rays follows.
            r1, r3 = max(distance(m, x), radius), max(distance(m, z), radius)
            light = (
                lasers.power[i] * patches.most_weight[p, 0] * cutting.peak[k1] * cutting.peak[k] * cutting.peak[k3]
            )
            light *= _frame(x, k, outlines, fans.frame, n) / (r3 * r3)
            light *= max(min(rise1 / r1, 1.0), GRAZING) * max(min(rise3 / r3, 1.0), GRAZING)
            sharpest = max(cutting.sharp[k1], cutting.sharp[k], cutting.sharp[k3])
            count = np.int64(min(max(light / (CARRIED * cutting.error[k]), LEAST * sharpest), MOST))
            fans.pair[n], fans.part[n], fans.first[n + 1] = pair, k, fans.first[n] + count
            n += 1
    return n


@compiled(_nrt=False)
def _frame(o, k, outlines, frame, n):  # type: ignore[no-untyped-def]
    """Approximate solid angle of mesh k seen from o, sr, after its frame was written to row n of `frame`."""
    axis = subtract(get(outlines.middle, k, 0), o)
    for j in range(9):
        frame[n, j] = 0.0
    if dot(axis, axis) == 0.0:
        return 2.0 * math.pi
    axis = unit(axis)
    # The smallest rectangle that holds all corners of the hull, in the plane at distance 1 across the axis.
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
    """Direction of ray j of a fan, of any length; the derivatives of that vector along the two sides of the frame;
    and the solid angle of the fan if all its rays stood as densely as this one, sr.

    n : normal at the laser point. word : random word that shifts the lattice.
    """
    count = fans.first[fan + 1] - fans.first[fan]
    s = ((j + 0.5) / count + np.float64(mix(word, np.uint64(0))) * 2.0**-32) % 1.0
    # The second coordinate goes on by the golden section from one ray to the next.
    t = (j * 0.6180339887498949 + np.float64(mix(word, np.uint64(1))) * 2.0**-32) % 1.0
    first, right, up = get(fans.frame, fan, 0), get(fans.frame, fan, 3), get(fans.frame, fan, 6)
    if first[0] == 0.0 and first[1] == 0.0 and first[2] == 0.0:
        # Directions are even over the half space if they are even in height and in angle about the normal.
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
    # The frame lies in a plane at distance 1, so that d · axis = 1.
    return d, right, up, math.sqrt(dot(right, right) * dot(up, up)) / (square * math.sqrt(square))


@compiled()
def _word(scan, tally, fans, fan):  # type: ignore[no-untyped-def]
    """Random word of a fan. It depends on the pair and the mesh, but not on how footprints are quartered."""
    return word_of(scan.cutting.seed[fans.part[fan]], tally.number[fans.pair[fan]], fans.part[fan])


@compiled(_nrt=False)
def _aim(pairs, scan, tally, fans, fan, start, origin, normal, direction):  # type: ignore[no-untyped-def]
    """Write origins, normals there and unit directions (n, 3) of the rays from index `start` on.

    fan : index of the fan to which ray `start` belongs.
    """
    for r in range(len(origin)):
        while start + r >= fans.first[fan + 1]:
            fan += 1
        i = pairs[fans.pair[fan], 0]
        n, word = get(scan.lasers.normal, i, 0), _word(scan, tally, fans, fan)
        put(origin, r, 0, get(scan.lasers.position, i, 0))
        put(normal, r, 0, n)
        put(direction, r, 0, unit(_direction(fans, fan, start + r - fans.first[fan], n, word)[0]))


@compiled()
def _connect(  # type: ignore[no-untyped-def]
    pairs, scan, fans, fan, start, hits, face_part, offset, footprint_ratio, tally, connections
):  # fmt: skip
    """Number of connections of the hits of rays from index `start` on, which are written to `connections`.

    fan : index of the fan to which ray `start` belongs. offset : by which shadow rays are lifted off surfaces,
    metres.
    """
    lasers, patches, clock, m = scan.lasers, scan.patches, scan.clock, 0
    chosen, waiting = np.empty((4**LEVEL, 2), np.int64), np.empty((4**LEVEL, 2), np.int64)
    for r in range(len(hits.face)):
        while start + r >= fans.first[fan + 1]:
            fan += 1
        k, j, pair = fans.part[fan], start + r - fans.first[fan], fans.pair[fan]
        tally.work[k, 0] += 1
        # Nothing was met, or another part, whose light comes by other rays or elements.
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
        # The cell of the lattice on the surface: its area, and the factor from direction vectors to lengths there.
        area, size = solid_angle * reach * reach * length / (steep * count), reach / (length * math.sqrt(count))
        g, many = unit(back1), _points(patches, p, y, footprint_ratio, mix(word, np.uint64(2 + j)), chosen, waiting)
        for c in range(many):
            # A random point of the footprint stands for its light, and its middle for the arrival time.
            q, here = chosen[c, 0], finest_within(patches.quarters, chosen[c, 0], mix(word, np.uint64(2 + j)))
            k3, stands_for = patches.part[p, here], chosen[c, 1] * patches.fraction[q] / patches.fraction[here]
            z, n3 = corner(patches.position, p, here), corner(patches.normal, p, here)
            seen = (z, n3, corner(patches.to_sensor, p, here), scan.kind[k3], scan.values[k3])
            w, r1, _ = weight(
                y, n, scan.kind[k], scan.values[k], lit, seen, patches.footprint[p, here], clock.attenuation
            )  # fmt: skip
            if not w > 0.0:
                continue
            back3 = subtract(y, corner(patches.position, p, q))
            r3 = math.sqrt(dot(back3, back3))
            # The gradient of the path at y, and by it how far paths differ along the two sides of the cell.
            h = (g[0] + back3[0] / r3, g[1] + back3[1] / r3, g[2] + back3[2] / r3)
            # A cell on a surface seen edge-on would reach far beyond the triangle.
            steepest = max(steep, EDGE_ON * length)
            one = min(abs(size * (dot(h, along) + dot(h, d) * dot(n, along) / steepest)), reach)
            other = min(abs(size * (dot(h, across) + dot(h, d) * dot(n, across) / steepest)), reach)
            u, v = path_changes(back3, corner(patches.to_sensor, p, q), clock.device, patches.across, p, q)
            device = lasers.leg[i] + patches.leg[p, q] if clock.device else 0.0
            connections.photons[m] = w * area * lasers.power[i] * patches.weight[p, here] * stands_for
            connections.arrival[m] = (r1 + r3 + device) * clock.per_metre - clock.start
            connections.variance[m] = (one * one + other * other) / 12 * clock.per_metre * clock.per_metre
            connections.across[m, 0], connections.across[m, 1] = u * clock.per_metre, v * clock.per_metre
            connections.part[m], connections.into[m] = k, tally.row_of_pair[pair] + tally.row_of_part[k]
            connections.needs_ray[m] = scan.cutting.rays_on_last_leg and distance(x, z) > scan.occluders.flat
            for a in range(3):
                connections.start[m, a], connections.end[m, a] = y[a] + offset * n[a], z[a] + offset * n3[a]
            m += 1
    return m


@compiled(_nrt=False)
def _points(patches, p, y, footprint_ratio, word, chosen, waiting):  # type: ignore[no-untyped-def]
    """Number of footprints of row p that are connected with y, which are written to `chosen`.

    footprint_ratio : their largest size, relative to their distance from y. word : random word.
    chosen : (n, 2) index of each footprint, and number of footprints that it stands for.
    waiting : (n, 2) scratch: footprints not yet dealt with, and their levels.
    """
    top, count, quarters = 1, 0, patches.quarters
    waiting[0, 0], waiting[0, 1] = 0, 0
    while top > 0:
        top -= 1
        q, level = waiting[top, 0], waiting[top, 1]
        finest, stands_for, edge = quarters[q, 0] < 0, np.int64(1), patches.uneven[p, q]
        if edge and not finest and level == EDGE_LEVEL:
            # Areas on both sides of an edge need many points: one of its finest footprints, at random, stands for it.
            whole, word = q, mix(word, np.uint64(q))
            q = finest_within(quarters, q, word)
            stands_for, finest = np.int64(patches.fraction[whole] / patches.fraction[q]), True
        fine = not edge and (
            level >= LEVEL or patches.size[p, q] <= footprint_ratio * distance(y, corner(patches.position, p, q))
        )
        if finest or fine:
            # A footprint whose line of sight meets nothing is overwritten by the next one.
            chosen[count, 0], chosen[count, 1] = q, stands_for
            count += patches.part[p, q] >= 0
        else:
            for quarter in quarters[q]:
                waiting[top, 0], waiting[top, 1] = quarter, level + 1
                top += 1
    return count


@compiled(_nrt=False)
def _add_light(connections, count, tally):  # type: ignore[no-untyped-def]
    """Add the light of the first `count` connections to the histograms."""
    for m in range(count):
        tally.work[connections.part[m], 1] += connections.needs_ray[m]
        if connections.photons[m] > 0.0:
            t, into, photons = connections.arrival[m], connections.into[m], connections.photons[m]
            u, v, variance = connections.across[m, 0], connections.across[m, 1], connections.variance[m]
            if abs(u) + abs(v) <= FEW_BINS:
                a, b, c = widened(t, t, t, variance + (u * u + v * v) / 12)
                tally.overflow[into] += spread(tally.histogram, into, a, b, c, 1.0, 1.0, 1.0, photons)
                continue
            # The footprint is two triangles, over which arrival times are linear.
            for sign in (-0.5, 0.5):
                a, b, c = widened(t + sign * (u + v), t + sign * (u - v), t - sign * (u - v), variance)
                tally.overflow[into] += spread(tally.histogram, into, a, b, c, 1.0, 1.0, 1.0, 0.5 * photons)
