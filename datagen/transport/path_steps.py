"""The steps of paths of light (`paths.py`) as compiled loops: each makes the rays of a step, or reads what they met.

Between two loops embree finds the first triangle along each ray. A step keeps only the paths that can still carry
light, so rows get fewer; `sample` and `of` say where a row belongs.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from datagen.compiled import compiled
from datagen.records.arrays import Floats, Ints, R
from datagen.transport.brdf import Vector, dot, evaluate, pdf, sample
from datagen.transport.geometry import TINY, corner, cross, get, put, subtract, transmittance
from datagen.transport.path_aim import Aim, draw_triangle
from datagen.transport.rays import lifted_and_scaled, write_shadow_ray
from datagen.transport.sampling import BITS, word_of
from datagen.transport.scene_numbers import SceneNumbers
from datagen.units import SPEED_OF_LIGHT_M_PER_S

BY_AREA = 0.5
"""Share of the first hidden vertices x₂ that are drawn by area, which meets small and distant parts; the others are
drawn by the BRDF, which meets near ones. Any share is unbiased."""
DIMENSIONS = 11
"""Quasi-random numbers of a sample: two draw the FoV point, three x₂, two the ray back from the FoV point, two x₃,
two the laser point within the cell of a beam. Later vertices have independent numbers, as quasi-random ones would
gain little there."""
NO_GOAL, NO_NORMAL = np.int64(-1), (0.0, 0.0, 0.0)
"""The goal of a ray that is not aimed at a triangle, and the normal at the end of a ray that lies on no surface."""


class PathSetup(NamedTuple):
    """What the loops need to know of scene, materials and capture.

    scene : its numbers. corners : (F, 3, 3), face_normal : (F, 3), part : (F,) of the triangles. sensor : position.
    aperture_area, aperture_square : m²; the latter is the square of the radius, or 0 for a small aperture. planes,
    solid_angle : of the pixels' cones. footprints : (P, R, C) sensitivities within pixels, or one cell. into :
    (P, 3, 3) the matrix from a direction to its place in the pixel.
    """

    scene: SceneNumbers
    corners: Floats
    face_normal: Floats
    part: Ints
    sensor: Vector
    aperture_area: float
    aperture_square: float
    planes: Floats
    solid_angle: Floats
    footprints: Floats
    into: Floats


class Samples(NamedTuple):
    """n samples of a batch.

    pixel : (n,). numbers : (n, DIMENSIONS) quasi-random numbers. seeds, number : (n,) those of later vertices come
    from these. row : (n,) each sample's pair in `aim`, which says how pairs draw points by area.
    """

    pixel: Ints
    numbers: Floats
    seeds: NDArray[np.uint64]
    number: Ints
    row: Ints
    aim: Aim


class Vertices(NamedTuple):
    """The last vertices of n paths so far, at most one for each sample.

    sample, face : (n,) index of the sample, of the triangle. position, normal, back : (n, 3) metres; unit normal on
    the side that the path came from; unit direction to the vertex before. power : (n,) photons that arrive, over the
    density of drawing the path. density : (n,) 1/m², with which the way from the laser draws the vertex. path : (n,)
    length so far, m.

    Of FoV points `back` leads to the sensor, `path` is the distance to it, and `power` is what the point stands for:
    A dΩ, m² sr, with the transmittance of the air to the sensor and the pixel's sensitivity.
    """

    sample: Ints
    face: Ints
    position: Floats
    normal: Floats
    back: Floats
    power: Floats
    density: Floats
    path: Floats


class Vertex(NamedTuple):
    """One vertex: a row of `Vertices`, with the triangle's part and the kind of its BRDF.

    Functions that branch get vertices and numbers, as numba counts references to each array that a call passes.
    """

    face: int
    part: int
    kind: int
    position: Vector
    normal: Vector
    back: Vector
    power: float
    density: float
    path: float


class Rays(NamedTuple):
    """n rays in embree's frame, in single precision.

    of : (n,) row of the vertex that a ray leaves. goal : (n,) triangle that a ray is aimed at, −1 for none; place :
    (n, 3) the point there, m, set only for rays with a goal. origin, direction : (n, 3); a shadow ray ends where its
    direction ends.
    """

    of: Ints
    goal: Ints
    place: Floats
    origin: NDArray[np.float32]
    direction: NDArray[np.float32]


class Found(NamedTuple):
    """n paths of one order: index of the sample, of the part as in `reference.Paths`, length in m, and photons."""

    sample: Ints
    part: Ints
    path: Floats
    photons: Floats


def empty_record(record: type[R], n: int) -> R:
    """A record of n rows to be filled."""
    kinds = {"sample": np.int64, "face": np.int64, "of": np.int64, "goal": np.int64, "part": np.int64,
             "origin": np.float32, "direction": np.float32}  # fmt: skip
    vectors = ("position", "normal", "back", "place", "origin", "direction")
    return record(*(
        np.empty((n, 3) if name in vectors else n, kinds.get(name, np.float64))
        for name in record._fields  # type: ignore[attr-defined]
    ))  # fmt: skip


def first_rows(record: R, n: int) -> R:
    """The first n rows of a record of arrays."""
    return type(record)(*(values[:n] for values in record))


@compiled()
def _independent(seed, sample, which):  # type: ignore[no-untyped-def]
    """The pseudo-random number of a sample with the number `which`, in 0 … 1."""
    return (np.float64(word_of(seed, sample, which)) + 0.5) * 2.0**-BITS


@compiled()
def later_numbers(seeds, number, order):  # type: ignore[no-untyped-def]
    """(n,) numbers for the Russian roulette of samples."""
    out = np.empty(len(number))
    for i in range(len(out)):
        out[i] = _independent(seeds[i], number[i], 3 * order)
    return out


@compiled()
def _minus(a):  # type: ignore[no-untyped-def]
    """The vector −a."""
    return (-a[0], -a[1], -a[2])


@compiled()
def _along(a, s, w):  # type: ignore[no-untyped-def]
    """The point a + s w."""
    return (a[0] + s * w[0], a[1] + s * w[1], a[2] + s * w[2])


@compiled()
def _toward(a, b):  # type: ignore[no-untyped-def]
    """The unit vector from point a to point b, and their distance; the vector is 0 for a distance of 0."""
    span = subtract(b, a)
    r = math.sqrt(dot(span, span))
    s = 1.0 / max(r, TINY)
    return (s * span[0], s * span[1], s * span[2]), r


# What takes a record of arrays is inlined here and below: a call would count a reference to each of them.
@compiled(forceinline=True)
def _vertex(setup, face, position, normal, back, power, density, path):  # type: ignore[no-untyped-def]
    part = setup.part[face]
    return Vertex(face, part, setup.scene.kind[part], position, normal, back, power, density, path)


@compiled(forceinline=True)
def _row(setup, x, i):  # type: ignore[no-untyped-def]
    """Row i of vertices x."""
    position, normal, back = get(x.position, i, 0), get(x.normal, i, 0), get(x.back, i, 0)
    return _vertex(setup, x.face[i], position, normal, back, x.power[i], x.density[i], x.path[i])


@compiled()
def _write_vertex(x, k, sample, a):  # type: ignore[no-untyped-def]
    """Write vertex a of a sample to row k of vertices x."""
    x.sample[k], x.face[k], x.power[k], x.density[k], x.path[k] = sample, a.face, a.power, a.density, a.path
    put(x.position, k, 0, a.position)
    put(x.normal, k, 0, a.normal)
    put(x.back, k, 0, a.back)


@compiled()
def _write_path(found, k, sample, part, path, photons):  # type: ignore[no-untyped-def]
    """Write a path to row k."""
    found.sample[k], found.part[k], found.path[k], found.photons[k] = sample, part, path, photons


@compiled(forceinline=True)
def _write_ray(scene, rays, k, of, goal, p, n, direction):  # type: ignore[no-untyped-def]
    """Write a ray that leaves the point p of a surface with normal n to row k."""
    rays.of[k], rays.goal[k] = of, goal
    put(rays.origin, k, 0, lifted_and_scaled(p, n, scene.offset, scene.frame))
    put(rays.direction, k, 0, direction)


@compiled(forceinline=True)
def _write_shadow_ray(scene, rays, k, p, n, q, m):  # type: ignore[no-untyped-def]
    """Write a ray between points p and q of surfaces with normals n and m to row k."""
    a, b = lifted_and_scaled(p, n, scene.offset, scene.frame), lifted_and_scaled(q, m, scene.offset, scene.frame)
    write_shadow_ray(rays.origin, rays.direction, k, a, b)


@compiled()
def _brdf_and_density(values, a, w_in, w_out):  # type: ignore[no-untyped-def]
    """BRDF at vertex a, and the density with which `sample` draws `w_out` for `w_in`; both 1/sr."""
    # Both at once, as every weight needs both.
    row = values[a.part]
    return evaluate(a.kind, row, a.normal, w_in, w_out), pdf(a.kind, row, a.normal, w_in, w_out)


@compiled()
def _draw_direction(setup, a, u, v):  # type: ignore[no-untyped-def]
    """A unit direction drawn by the BRDF at vertex a."""
    return sample(a.kind, setup.scene.values[a.part], a.normal, a.back, u, v)


@compiled()
def _meeting_point(setup, face, origin, direction):  # type: ignore[no-untyped-def]
    """Where a ray meets the plane of a triangle; its normal, turned against the ray; whether the ray meets it.

    Only the triangle is embree's answer: the point is computed in double precision.
    """
    n, w = get(setup.face_normal, face, 0), (1.0 * direction[0], 1.0 * direction[1], 1.0 * direction[2])
    approach = dot(n, w)
    # Edge-on the plane gives no distance.
    reach = dot(n, subtract(corner(setup.corners, face, 0), origin)) / approach if approach != 0.0 else -1.0
    if approach > 0.0:
        n = _minus(n)
    return _along(origin, reach, w), n, 0.0 < reach < np.inf


@compiled(forceinline=True)
def _aperture(setup, r):  # type: ignore[no-untyped-def]
    """Area of the aperture seen from a distance, m²: of a small one, or of a finite disc."""
    return setup.aperture_area * r * r / (r * r + setup.aperture_square)


@compiled()
def _sensitivity(footprints, pixel, u, v):  # type: ignore[no-untyped-def]
    """Sensitivity of a pixel at the place (u, v) of its quadrilateral."""
    rows, columns = footprints.shape[1], footprints.shape[2]
    row, column = min(max(int(v * rows), 0), rows - 1), min(max(int(u * columns), 0), columns - 1)
    return footprints[pixel, row, column]


@compiled()
def _seen_within(planes, footprints, into, pixel, w):  # type: ignore[no-untyped-def]
    """Sensitivity of a pixel in the direction w from the sensor; 0 outside of it."""
    for k in range(4):
        if planes[pixel, k, 0] * w[0] + planes[pixel, k, 1] * w[1] + planes[pixel, k, 2] * w[2] < 0.0:
            return 0.0
    if footprints.shape[1] * footprints.shape[2] == 1:
        return footprints[pixel, 0, 0]
    m = into[pixel]
    over = dot(get(m, 2, 0), w)
    return _sensitivity(footprints, pixel, dot(get(m, 0, 0), w) / over, dot(get(m, 1, 0), w) / over)


@compiled()
def fill_laser_points(setup, points, number, x):  # type: ignore[no-untyped-def]
    """Fill x with the laser points of samples, those of `points` by number (n,), −1 for a sample without one; returns
    how many."""
    count = 0
    for s in range(len(number)):
        if number[s] >= 0:
            _write_vertex(x, count, s, _row(setup, points, number[s]))
            count += 1
    return count


@compiled()
def lines_of_sight(setup, corners, pixel, numbers, rays, solid):  # type: ignore[no-untyped-def]
    """Fill rays with lines of sight through pixels (n,), and `solid` (n,) with what each stands for: dΩ/(du dv) times
    the sensitivity.

    corners : (P, 4, 3) of the pixels, relative to the sensor. A point uniform on the pixel's quadrilateral q(u, v),
    as seen from the sensor, stands for the solid angle dΩ/(du dv) = |q · (∂q/∂u × ∂q/∂v)| / |q|³.
    """
    footprints, sensor = setup.footprints, setup.sensor
    for s in range(len(pixel)):
        u, v, p = numbers[s, 0], numbers[s, 1], pixel[s]
        a, b, c, d = corner(corners, p, 0), corner(corners, p, 1), corner(corners, p, 2), corner(corners, p, 3)
        lower, upper = _along(a, u, subtract(b, a)), _along(d, u, subtract(c, d))
        along_u, along_v = _along(subtract(b, a), v, subtract(subtract(c, d), subtract(b, a))), subtract(upper, lower)
        q = _along(lower, v, along_v)
        solid[s] = abs(dot(q, cross(along_u, along_v))) / (dot(q, q) * math.sqrt(dot(q, q)))
        solid[s] *= _sensitivity(footprints, p, u, v)
        _write_ray(setup.scene, rays, s, s, NO_GOAL, sensor, NO_NORMAL, q)


@compiled()
def fill_fov_points(setup, rays, faces, solid, v):  # type: ignore[no-untyped-def]
    """Fill v with the FoV points where lines of sight landed, a row for each; `power` is 0 where there is none."""
    sensor = setup.sensor
    for s in range(len(faces)):
        v.sample[s], v.power[s] = s, 0.0
        face = np.int64(faces[s])
        if face >= 0:
            # The direction as embree knows it, in single precision, is the one whose triangle was found.
            position, normal, meets = _meeting_point(setup, face, sensor, get(rays.direction, s, 0))
            if meets:
                back, leg = _toward(position, sensor)
                gain = solid[s] * _aperture(setup, leg) * transmittance(setup.scene.air, leg)
                _write_vertex(v, s, s, _vertex(setup, face, position, normal, back, gain, 0.0, leg))


@compiled()
def rays_back(setup, v, numbers, rays):  # type: ignore[no-untyped-def]
    """Fill rays with those from FoV points, drawn by their BRDFs against the direction of light; returns how many."""
    count = 0
    for s in range(len(v.power)):
        if v.power[s] > 0.0:
            a = _row(setup, v, s)
            w = _draw_direction(setup, a, numbers[s, 5], numbers[s, 6])
            # A lobe may reach below the surface, where the BRDF is 0.
            if dot(a.normal, w) > 0.0:
                _write_ray(setup.scene, rays, count, s, NO_GOAL, a.position, a.normal, w)
                count += 1
    return count


@compiled()
def fill_seen_vertices(setup, v, rays, faces, h):  # type: ignore[no-untyped-def]
    """Fill h with the vertices that FoV points v see along rays, a row for each sample; `face` is −1 for none."""
    for s in range(len(v.power)):
        h.face[s] = -1
    for k in range(len(faces)):
        face = np.int64(faces[k])
        if face >= 0:
            s = rays.of[k]
            position, normal, meets = _meeting_point(setup, face, get(v.position, s, 0), get(rays.direction, k, 0))
            if meets:
                h.face[s] = face
                put(h.position, s, 0, position)
                put(h.normal, s, 0, normal)


@compiled()
def _place_on(corners, face, u, v):  # type: ignore[no-untyped-def]
    """A point uniform on a triangle."""
    a, b, c, root = corner(corners, face, 0), corner(corners, face, 1), corner(corners, face, 2), math.sqrt(u)
    return _along(_along(a, root * (1.0 - v), subtract(b, a)), root * v, subtract(c, a))


@compiled()
def rays_to_second(setup, samples, b, rays):  # type: ignore[no-untyped-def]
    """Fill rays with those from laser points b to first hidden vertices, drawn by area or by the BRDF; returns how
    many."""
    count, numbers = 0, samples.numbers
    for i in range(len(b.sample)):
        s, a = b.sample[i], _row(setup, b, i)
        choice, u, v, goal = numbers[s, 2], numbers[s, 3], numbers[s, 4], NO_GOAL
        if choice < BY_AREA:
            # One number chooses way and triangle, so that its even spread serves both.
            goal = draw_triangle(samples.aim, samples.row[s], choice / BY_AREA)
            place = _place_on(setup.corners, goal, u, v)
            w = subtract(place, _along(a.position, setup.scene.offset, a.normal))
            put(rays.place, count, 0, place)
        else:
            w = _draw_direction(setup, a, u, v)
        if dot(a.normal, w) > 0.0:
            _write_ray(setup.scene, rays, count, i, goal, a.position, a.normal, w)
            count += 1
    return count


@compiled()
def rays_onward(setup, samples, x, order, rays):  # type: ignore[no-untyped-def]
    """Fill rays with those from vertices x, the last before the FoV point of paths of `order` bounces, drawn by their
    BRDFs; returns how many."""
    count = 0
    for i in range(len(x.sample)):
        s, a = x.sample[i], _row(setup, x, i)
        if order == 3:
            u, v = samples.numbers[s, 7], samples.numbers[s, 8]
        else:
            u = _independent(samples.seeds[s], samples.number[s], 3 * order + 1)
            v = _independent(samples.seeds[s], samples.number[s], 3 * order + 2)
        w = _draw_direction(setup, a, u, v)
        if dot(a.normal, w) > 0.0:
            _write_ray(setup.scene, rays, count, i, NO_GOAL, a.position, a.normal, w)
            count += 1
    return count


@compiled()
def rays_toward(setup, b, h, rays):  # type: ignore[no-untyped-def]
    """Fill rays with those from vertices b to the vertices h that FoV points see; returns how many."""
    count = 0
    for i in range(len(b.sample)):
        s, p, n = b.sample[i], get(b.position, i, 0), get(b.normal, i, 0)
        if h.face[s] >= 0:
            place = get(h.position, s, 0)
            w = subtract(place, _along(p, setup.scene.offset, n))
            # Between sides that face away from each other no light passes: the ray is saved.
            if dot(n, w) > 0.0 and dot(get(h.normal, s, 0), w) < 0.0:
                put(rays.place, count, 0, place)
                _write_ray(setup.scene, rays, count, i, h.face[s], p, n, w)
                count += 1
    return count


@compiled()
def _by_area(aim, part, row, face):  # type: ignore[no-untyped-def]
    """Density, 1/m², with which the pair of a row draws points on a triangle by area."""
    k = part[face]
    return aim.density[aim.begin[k] + row * aim.stride[k] + aim.rank[face]]


@compiled()
def _by_light(by_brdf, by_area, second):  # type: ignore[no-untyped-def]
    """Density, 1/m², with which the way from the laser draws a vertex; only x₂ is drawn by area, too."""
    return (1.0 - BY_AREA) * by_brdf + BY_AREA * by_area if second else by_brdf


@compiled()
def _end_of_leg(values, b, w, r, n, by_area, second):  # type: ignore[no-untyped-def]
    """f_b cosθ_b cosθ_x / R² at the end of a leg from vertex b along w, where the normal is n, and the density with
    which the way from the laser draws that end."""
    cos_b, cos_x = dot(b.normal, w), -dot(n, w)
    if cos_b <= 0.0 or cos_x <= 0.0:
        return 0.0, 0.0
    f, by_brdf = _brdf_and_density(values, b, b.back, w)
    return f * cos_b * cos_x / (r * r), _by_light(by_brdf * cos_x / (r * r), by_area, second)


@compiled()
def fill_arrivals(setup, samples, b, rays, faces, second, returning, x, of):  # type: ignore[no-untyped-def]
    """Fill x with the vertices that vertices b light along rays, with their power over their density, and `of` with
    the row of the b of each; returns how many.

    second : whether these are vertices x₂. returning : whether rays are aimed at vertices that FoV points see.
    """
    count, values, part, aim, row = 0, setup.scene.values, setup.part, samples.aim, samples.row
    for k in range(len(faces)):
        i, face, goal = rays.of[k], np.int64(faces[k]), rays.goal[k]
        # A place drawn by area counts only if its own triangle is met first, so that of two triangles that coincide
        # one counts, the same as for rays.
        if face < 0 or (goal >= 0 and face != goal and not returning):
            continue
        a, s = _row(setup, b, i), b.sample[i]
        # Where a ray goes is computed from the vertex itself, not from above it, where embree began: so hits have the
        # density of rays from there, even at the foot of a wall that is nearer than rays are lifted.
        start, direction, place = a.position, get(rays.direction, k, 0), a.position
        if goal >= 0:
            place, start = get(rays.place, k, 0), _along(a.position, setup.scene.offset, a.normal)
            direction = subtract(place, start)
        y, n, meets = _meeting_point(setup, face, start, direction)
        if goal >= 0:
            # A path counts if the ray meets this place first: all ways must draw the same paths.
            off = subtract(y, place)
            meets = meets and max(abs(off[0]), abs(off[1]), abs(off[2])) < setup.scene.offset
        if not meets:
            continue
        w, r = _toward(a.position, y)
        light, density = _end_of_leg(values, a, w, r, n, _by_area(aim, part, row[s], face) if second else 0.0, second)
        power = a.power * light * transmittance(setup.scene.air, r)
        if density > TINY and power > 0.0:
            end = _vertex(setup, face, y, n, _minus(w), power / density, density, a.path + r)
            _write_vertex(x, count, s, end)
            of[count] = i
            count += 1
    return count


@compiled()
def _photons(values, x, v, solid_angle, by_area, order):  # type: ignore[no-untyped-def]
    """Photons of the path of `order` bounces by way of vertex x and FoV point v in clear air, and the length of the
    leg between them, m.

    The photons are the integrand over the sum of the densities of all three ways. With p the density by light, and
    with 1/Ω for v drawn from the pixel, per solid angle at the sensor, these densities are

        join: p/Ω     back: pdf_v cosθ_x/R² /Ω     land: p · pdf_x cosθ_v/R² · R_s²/cosθ_s

    by_area : density with which v is drawn by area after the laser point.
    """
    w, r = _toward(x.position, v.position)
    cos_x, cos_v, square = dot(x.normal, w), -dot(v.normal, w), r * r
    if cos_x <= 0.0 or cos_v <= 0.0:
        return 0.0, r
    f_x, onto_v = _brdf_and_density(values, x, x.back, w)
    f_v, onto_x = _brdf_and_density(values, v, v.back, _minus(w))
    ways, cos_s = 1.0, dot(v.normal, v.back)
    if order > 2 and x.density > TINY:
        ways += onto_x * cos_x / (square * x.density)
    if cos_s > TINY:
        ways += _by_light(onto_v * cos_v / square, by_area, order == 2) * solid_angle * v.path * v.path / cos_s
    return x.power * v.power * f_x * f_v * cos_x * cos_v / (square * ways), r


@compiled()
def fill_joined_paths(setup, samples, x, v, order, found, rays):  # type: ignore[no-untyped-def]
    """Fill `found` with paths of `order` bounces from vertices x to the FoV points v of their samples, and rays with
    a shadow ray for each; returns how many."""
    count, values, part, aim, row = 0, setup.scene.values, setup.part, samples.aim, samples.row
    for i in range(len(x.sample)):
        s = x.sample[i]
        if v.power[s] > 0.0:
            a, c = _row(setup, x, i), _row(setup, v, s)
            by_area = _by_area(aim, part, row[s], c.face) if order == 2 else 0.0
            photons, r = _photons(values, a, c, setup.solid_angle[samples.pixel[s]], by_area, order)
            if photons > 0.0:
                path = a.path + r + c.path * setup.scene.from_source
                photons *= transmittance(setup.scene.air, r)
                _write_path(found, count, s, a.part if order > 2 else c.part, path, photons)
                _write_shadow_ray(setup.scene, rays, count, a.position, a.normal, c.position, c.normal)
                count += 1
    return count


@compiled()
def fill_landed_paths(setup, samples, x, y, of, order, found, rays):  # type: ignore[no-untyped-def]
    """Fill `found` with the paths of `order` bounces that end at those vertices y, lit by the vertices x of rows
    `of`, that the pixel of the sample may see, and rays with a shadow ray from the sensor for each; returns how many.
    """
    count, values, part, aim, row, pixel = 0, setup.scene.values, setup.part, samples.aim, samples.row, samples.pixel
    planes, footprints, into, sensor = setup.planes, setup.footprints, setup.into, setup.sensor
    for k in range(len(of)):
        s, a, c = y.sample[k], _row(setup, x, of[k]), _row(setup, y, k)
        back, leg = _toward(c.position, sensor)
        # The quick tests come first: few vertices lie in the pixel.
        if dot(c.normal, back) <= 0.0:
            continue
        seen = _seen_within(planes, footprints, into, pixel[s], _minus(back))
        if seen > 0.0:
            # As a FoV point the vertex stands for the pixel's whole solid angle.
            solid = setup.solid_angle[pixel[s]]
            gain = seen * _aperture(setup, leg) * solid * transmittance(setup.scene.air, leg)
            end = _vertex(setup, c.face, c.position, c.normal, back, gain, 0.0, leg)
            by_area = _by_area(aim, part, row[s], c.face) if order == 2 else 0.0
            photons, r = _photons(values, a, end, solid, by_area, order)
            if photons > 0.0:
                path = a.path + r + leg * setup.scene.from_source
                photons *= transmittance(setup.scene.air, r)
                _write_path(found, count, s, a.part if order > 2 else c.part, path, photons)
                _write_shadow_ray(setup.scene, rays, count, sensor, NO_NORMAL, c.position, c.normal)
                count += 1
    return count


@compiled()
def fill_paths_of_one_bounce(setup, samples, x, found, rays):  # type: ignore[no-untyped-def]
    """Fill `found` with paths of one bounce, f cosθ A / R²: the laser points x themselves where the pixel sees them;
    and rays with a shadow ray from the sensor for each; returns how many."""
    count, values, pixel = 0, setup.scene.values, samples.pixel
    planes, footprints, into, sensor = setup.planes, setup.footprints, setup.into, setup.sensor
    for i in range(len(x.sample)):
        s, a = x.sample[i], _row(setup, x, i)
        w, leg = _toward(a.position, sensor)
        cosine = dot(a.normal, w)
        seen = _seen_within(planes, footprints, into, pixel[s], _minus(w)) if cosine > 0.0 else 0.0
        if seen > 0.0:
            f, _ = _brdf_and_density(values, a, a.back, w)
            photons = a.power * f * cosine * seen * transmittance(setup.scene.air, leg)
            photons *= _aperture(setup, leg) / (leg * leg)
            _write_path(found, count, s, a.part, a.path + leg * setup.scene.from_source, photons)
            _write_shadow_ray(setup.scene, rays, count, sensor, NO_NORMAL, a.position, a.normal)
            count += 1
    return count


@compiled()
def add(found, order, first, samples, row_of, share, start_s, width_s, light):  # type: ignore[no-untyped-def]
    """Add paths of `order` bounces to the histograms `light` (rows, n, T + 2), whose first and last column hold what
    arrives before and after the time axis; pair i goes to column i modulo n of them.

    first : the number of the batch's first sample, counted over all pairs. row_of : (orders, K) row of a path of
    B bounces whose last hidden vertex lies on part k (with one or two bounces, whose last vertex does), in row_of[B −
    1, k]; its last row stands for all higher orders, too. −1 for paths that are not wanted. share : by which the
    light of each pair counts.
    """
    bins, row = light.shape[2] - 2, row_of[min(order, len(row_of)) - 1]
    for k in range(len(found.sample)):
        to = row[found.part[k]]
        if to >= 0:
            # A bin is the integral of the flux between its edges: each path goes whole into one.
            place = math.floor((found.path[k] / SPEED_OF_LIGHT_M_PER_S - start_s) / width_s)
            column = int(min(max(place, -1.0), bins)) + 1
            pair = (first + found.sample[k]) // samples
            light[to, pair % light.shape[1], column] += share[pair] * found.photons[k]
