"""Unbiased paths of light, drawn where most light is: the reference that tests, benchmarks and second opinions use.

The paths estimate the integral of `reference.py`, equation (1) there: the mean is the same in every scene, and the
noise is far smaller. Nothing is shared with quadrature or path tracing but the ray caster and the BRDFs.

The last two vertices of a path, h = x_{B−1} and v = x_B, are drawn in three ways, given b = x_{B−2}:

- *join*: h from b, by the BRDF at b or, for x₂, also uniformly on the parts' areas; v from the pixel;
- *back*: v from the pixel, h from v by the BRDF at v. This way finds surfaces right beside the field of view;
- *land*: h from b, v from h by the BRDF at h, if v falls inside the pixel. This way is for BRDFs with a lobe.

A path counts with the integrand over the sum of the densities of all three ways, whichever of them found it (the
balance heuristic: Veach & Guibas, SIGGRAPH 1995). So together they count every path once.

`sample_paths` returns weighted paths, to be added up as the caller likes; `reference` puts them into time bins:

    materials, caster = MaterialTable.of(scene.materials), Raycaster(scene)
    paths = sample_paths(caster, scene, materials, capture, pairs_of(capture), samples=64, max_bounces=4)
    primary = paths.take(paths.order == 3)
    energy_by_part = np.bincount(primary.part, primary.photons)
    transient = reference(scene, capture, samples=4096, max_bounces=4, draw=sample_paths)
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np

from datagen.compiled import compiled
from datagen.records import Capture, Scene
from datagen.records.arrays import Bools, Floats, Ints
from datagen.seeding import LightStream
from datagen.transport.brdf import LAMBERTIAN, OREN_NAYAR, SIN_LOBE, MaterialTable, evaluate, pdf, sample
from datagen.transport.fields_of_view import PixelCones
from datagen.transport.reference import Paths, aperture_area, dots
from datagen.transport.sampled_paths_aim import Aim, Ends, aim
from datagen.transport.sampling import ROULETTE_FROM, SURVIVAL, scrambled_sobol, stream_seeds
from datagen.transport.visibility.raycast import Hits, Raycaster

BY_AREA = 0.5
"""Share of the first hidden vertices x₂ that are drawn by area. The mean is the same for any share. Half of it meets
small or distant parts half as often, and near ones more often."""
SOBOL_DIMENSIONS = 9
"""Quasi-random numbers of a sample: two draw the FoV point, three x₂, two the ray back from the FoV point, two x₃.
Later vertices have independent numbers, as quasi-random ones would gain little there."""
SMALLEST = 1e-200
"""Densities below this count as 0. It is far below any density with which a path is drawn, and safe to divide by;
half of it would do the same."""


@dataclass(frozen=True)
class _Vertices:
    """The last vertices of n paths so far, at most one for each sample.

    sample, face, part : (n,) index of the sample, of the triangle, of the part. position, normal, back : (n, 3)
    metres; unit normal on the side that the path came from; unit direction to the vertex before. power : (n,) photons
    that arrive, over the density of drawing the path. density : (n,) 1/m², with which the way from the laser draws
    the vertex. path : (n,) length so far, m.
    """

    sample: Ints
    face: Ints
    part: Ints
    position: Floats
    normal: Floats
    back: Floats
    power: Floats
    density: Floats
    path: Floats

    def __len__(self) -> int:
        return len(self.sample)

    def take(self, which: Ints | Bools) -> _Vertices:
        rows = np.flatnonzero(which) if which.dtype == np.bool_ else which
        return _Vertices(*(getattr(self, field.name).take(rows, axis=0) for field in fields(self)))


@compiled()
def _brdf(kind, values, part, normal, w_in, w_out):  # type: ignore[no-untyped-def]
    """BRDFs (n,) at n vertices, and densities (n,) with which `_drawn` draws `w_out` (n, 3) for `w_in`; both 1/sr."""
    # Both in one pass, as every weight needs both.
    f, density = np.empty(len(part)), np.empty(len(part))
    for i in range(len(part)):
        k, material, n = kind[part[i]], values[part[i]], (normal[i, 0], normal[i, 1], normal[i, 2])
        a, b = (w_in[i, 0], w_in[i, 1], w_in[i, 2]), (w_out[i, 0], w_out[i, 1], w_out[i, 2])
        f[i], density[i] = evaluate(k, material, n, a, b), pdf(k, material, n, a, b)
    return f, density


@compiled()
def _drawn(kind, values, part, normal, w_in, uv):  # type: ignore[no-untyped-def]
    """(n, 3) unit directions drawn by the BRDFs of n vertices from points uv (n, 2) of the unit square."""
    w = np.empty((len(part), 3))
    for i in range(len(part)):
        n, a = (normal[i, 0], normal[i, 1], normal[i, 2]), (w_in[i, 0], w_in[i, 1], w_in[i, 2])
        w[i, 0], w[i, 1], w[i, 2] = sample(kind[part[i]], values[part[i]], n, a, uv[i, 0], uv[i, 1])
    return w


def _leg(a: _Vertices, b: _Vertices) -> tuple[Floats, Floats, Floats, Floats]:
    """Unit directions (n, 3) from a to b, distances (n,), and the cosines (n,) at a and at b, 0 for a side that faces
    away."""
    span = b.position - a.position
    distance = np.sqrt(dots(span, span))
    w = span / np.maximum(distance, 1e-300)[:, None]
    return w, distance, np.maximum(dots(a.normal, w), 0.0), np.maximum(-dots(b.normal, w), 0.0)


def _over(a: Floats, b: Floats) -> Floats:
    """(n,) quotients a / b; 0 where b is 0 or so small that nothing is drawn with this density."""
    return np.divide(a, b, out=np.zeros_like(a), where=b > SMALLEST)


class _Tracer:
    """The steps of `sample_paths` for some pairs of laser point and pixel."""

    def __init__(
        self, caster: Raycaster, scene: Scene, materials: MaterialTable, capture: Capture, pairs: Ints, samples: int,
        occlusion: bool,
    ) -> None:  # fmt: skip
        self.caster, self.scene, self.materials, self.capture = caster, scene, materials, capture
        self.samples, self.occlusion = samples, occlusion
        self.laser, self.pixel = np.repeat(pairs, samples, axis=0).T
        cones = PixelCones.of(capture.sensor)
        self.planes, self.solid_angle = cones.planes, cones.solid_angle
        self.has_lobe = ~np.isin(materials.kind, (LAMBERTIAN, OREN_NAYAR, SIN_LOBE))
        self.lasers, self.of_sample = self.laser_points()
        self.aim = self.aimed(pairs)

    def air(self, metres: Floats) -> Floats:
        """(n,) transmittance of air on paths (n,)."""
        return np.exp(-self.scene.attenuation_per_m * metres)

    def brdf(self, at: _Vertices, w_in: Floats, w_out: Floats) -> tuple[Floats, Floats]:
        """BRDFs (n,) at vertices, and densities (n,) with which `drawn` draws `w_out` (n, 3); both 1/sr."""
        f, density = _brdf(self.materials.kind, self.materials.values, at.part, at.normal, w_in, w_out)
        return f, density

    def drawn(self, at: _Vertices, numbers: Floats) -> Floats:
        """(n, 3) unit directions drawn by the BRDFs at vertices from numbers (n, 2) in 0 … 1."""
        kind, values = self.materials.kind, self.materials.values
        return np.asarray(_drawn(kind, values, at.part, at.normal, at.back, np.ascontiguousarray(numbers)))

    def lifted(self, at: _Vertices) -> Floats:
        """(n, 3) points a little above the surface at vertices, metres, where shadow rays begin and end."""
        return at.position + self.caster.offset_m * at.normal

    def met(self, sample: Ints, hits: Hits) -> _Vertices:
        """The vertices where rays of samples landed, without power and direction, which `lit` or `seen` adds.

        sample : (n,) index of each ray's sample. Rays that met nothing are left out.
        """
        rows = np.flatnonzero(hits.valid)
        face, zero = hits.face[rows].astype(np.int64), np.zeros(len(rows))
        part, nowhere = self.scene.face_part[face].astype(np.int64), np.zeros((len(rows), 3))
        position, normal = hits.position[rows], hits.normal[rows]
        return _Vertices(sample[rows], face, part, position, normal, nowhere, zero, zero, zero)

    def laser_points(self) -> tuple[_Vertices, Ints]:
        """The laser points x₁ of rays that meet a surface, and (n,) the index among these for each sample, or −1."""
        laser = self.capture.laser
        used, of_sample = np.unique(self.laser, return_inverse=True)
        span = laser.targets[used] - laser.position
        points = self.met(np.arange(len(used)), self.caster.closest(laser.position, span))
        to_laser = laser.position - points.position
        leg = np.sqrt(dots(to_laser, to_laser))
        counts = leg if self.capture.time.origin == "source" else np.zeros_like(leg)
        points = replace(points, back=to_laser / leg[:, None], power=self.air(leg) / self.samples, path=counts)
        number = np.full(len(used), -1)
        number[points.sample] = np.arange(len(points))
        return points, number[of_sample]

    def aimed(self, pairs: Ints) -> Aim:
        """The densities with which x₂ is drawn by area; they change nothing but the variance."""
        lasers, number = self.lasers, self.of_sample[:: self.samples]
        seen, gain = self.fov_points(pairs[:, 1], np.full((len(pairs), 2), 0.5))
        half = 0.5 * np.sqrt(self.solid_angle[pairs[:, 1]]) * seen.path
        lit = lasers.take(np.maximum(number, 0)) if len(lasers) else seen
        x = Ends(lit.position, lit.normal, lit.back, np.where(number < 0, -1, lit.part), half)
        v = Ends(seen.position, seen.normal, seen.back, np.where(gain > 0, seen.part, -1), half)
        planes = np.column_stack([lasers.position, lasers.normal])
        return aim(self.caster, self.scene, self.materials, planes, x, v, len(self.pixel))

    def fov_points(self, pixel: Ints, uv: Floats) -> tuple[_Vertices, Floats]:
        """FoV points v of the samples, and A dΩ/(du dv) (n,), the photons for each unit of f E at v; 0 without a v.

        A point uniform on the pixel's quadrilateral q(u, v), as seen from the sensor, stands for the solid angle
        dΩ/(du dv) = |q · (∂q/∂u × ∂q/∂v)| / |q|³.
        """
        a, b, c, d = (self.capture.sensor.pixels[pixel, k] - self.capture.sensor.position for k in range(4))
        u, v = uv[:, :1], uv[:, 1:]
        q = (1 - v) * ((1 - u) * a + u * b) + v * ((1 - u) * d + u * c)
        along_u, along_v = (1 - v) * (b - a) + v * (c - d), (1 - u) * (d - a) + u * (c - b)
        jacobian = np.abs(dots(q, np.cross(along_u, along_v))) / dots(q, q) ** 1.5
        hits = self.caster.closest(self.capture.sensor.position, q)
        there = hits.valid
        hits.face[~there] = 0
        points = self.seen(self.met(np.arange(len(q)), hits))
        return points, np.where(there, aperture_area(self.capture, points.path) * jacobian, 0.0)

    def seen(self, points: _Vertices) -> _Vertices:
        """The points as FoV points: `back` leads to the sensor, and `path` is the distance to the sensor."""
        to_sensor = self.capture.sensor.position - points.position
        leg = np.sqrt(dots(to_sensor, to_sensor))
        return replace(points, back=to_sensor / leg[:, None], path=leg)

    def second(self, b: _Vertices, numbers: Floats) -> _Vertices:
        """First hidden vertices x₂ that the laser points b light, drawn by area or by the BRDF.

        numbers : (n, 3), of which the first chooses between the two ways, and the triangle.
        """
        by_area = numbers[:, 0] < BY_AREA
        face = self.aim.drawn(b.sample // self.samples, numbers[:, 0] / BY_AREA)
        root, other = np.sqrt(numbers[:, 1]), numbers[:, 2]
        weights = np.stack([1 - root, root * (1 - other), root * other], axis=1)
        place = np.einsum("nk,nkj->nj", weights, self.caster.corners[face])
        w = np.where(by_area[:, None], place - self.lifted(b), self.drawn(b, numbers[:, 1:]))
        hits = self.caster.leaving(b.position, b.normal, w)
        # A place drawn by area counts only if its own triangle is met first, so that of two triangles that coincide
        # one counts, the same as for rays.
        hits.face[by_area & (hits.face != face)] = -1
        hits.position[by_area] = place[by_area]
        return self.lit(b.take(hits.valid), self.met(b.sample, hits), order=2)

    def onward(self, b: _Vertices, numbers: Floats, order: int) -> _Vertices:
        """The next vertices x of `order` ≥ 3, drawn by the BRDF at the vertex b before."""
        hits = self.caster.leaving(b.position, b.normal, self.drawn(b, numbers))
        return self.lit(b.take(hits.valid), self.met(b.sample, hits), order)

    def lit(self, b: _Vertices, x: _Vertices, order: int) -> _Vertices:
        """The vertices x of `order` that b lights, with their power f_b cosθ_b cosθ_x / R² over the density of x."""
        w, r, cos_b, cos_x = _leg(b, x)
        f, density = self.brdf(b, b.back, w)
        density = self.by_light(_over(density * cos_x, r**2), x, order)
        power = b.power * self.air(r) * _over(f * _over(cos_b * cos_x, r**2), density)
        x = replace(x, back=-w, power=power, density=density, path=b.path + r)
        return x.take(power > 0)

    def by_light(self, by_brdf: Floats, x: _Vertices, order: int) -> Floats:
        """(n,) density, 1/m², with which the way from the laser draws the vertices x of `order`.

        by_brdf : (n,) density by the BRDF at the vertex before. Only x₂ is drawn by area as well.
        """
        if order > 2:
            return by_brdf
        return np.asarray((1 - BY_AREA) * by_brdf + BY_AREA * self.aim.at(x.sample // self.samples, x.face))

    def join(self, x: _Vertices, fov: _Vertices, gain: Floats, order: int) -> Paths:
        """Paths of `order` bounces from vertices x to the FoV points drawn from the pixel."""
        x = x.take(gain[x.sample] > 0)
        v = fov.take(x.sample)
        photons, path_m = self.photons(x, v, gain[x.sample], order)
        bright = np.flatnonzero(photons > 0)
        if self.occlusion:
            bright = bright[~self.caster.occluded(self.lifted(x.take(bright)), self.lifted(v.take(bright)))]
        return self.paths(x, v, photons, path_m, order).take(bright)

    def beside(self, fov: _Vertices, gain: Floats, numbers: Floats) -> _Vertices:
        """The vertices that FoV points see along rays drawn by their BRDFs, against the direction of light."""
        v = fov.take(gain > 0)
        hits = self.caster.leaving(v.position, v.normal, self.drawn(v, numbers[gain > 0]))
        return self.met(v.sample, hits)

    def back(self, b: _Vertices, x: _Vertices, fov: _Vertices, gain: Floats, order: int) -> Paths:
        """Paths of `order` bounces from vertices b by way of vertices x that `beside` found."""
        both, of_b, of_x = np.intersect1d(b.sample, x.sample, assume_unique=True, return_indices=True)
        b, x = b.take(of_b), x.take(of_x)
        # A path counts if a ray from b would have met x at this place first: the two ways must draw the same paths.
        hits = self.caster.closest(self.lifted(b), x.position - self.lifted(b))
        same = np.abs(hits.position - x.position).max(axis=1) < self.caster.offset_m
        seen = np.flatnonzero(hits.valid & same)
        x = replace(self.met(both[seen], hits.take(seen)), normal=x.normal[seen])
        x = self.lit(b.take(seen), x, order - 1)
        v = fov.take(x.sample)
        photons, path_m = self.photons(x, v, gain[x.sample], order)
        return self.paths(x, v, photons, path_m, order).take(photons > 0)

    def land(self, x: _Vertices, v: _Vertices, order: int) -> Paths:
        """Paths of `order` bounces whose last vertex v, where a ray from x landed, falls inside the pixel."""
        of_x = np.searchsorted(x.sample, v.sample)
        if order > 2:
            lobed = np.flatnonzero(self.has_lobe[x.part[of_x]])
            of_x, v = of_x[lobed], v.take(lobed)
        span = self.capture.sensor.position - v.position
        inside = np.flatnonzero((np.einsum("nk,njk->nj", span, self.planes[self.pixel[v.sample]]) <= 0).all(axis=1))
        x, v = x.take(of_x[inside]), self.seen(v.take(inside))
        gain = aperture_area(self.capture, v.path) * self.solid_angle[self.pixel[v.sample]]
        photons, path_m = self.photons(x, v, gain, order)
        bright = np.flatnonzero(photons > 0)
        hidden = self.caster.occluded(self.capture.sensor.position, self.lifted(v.take(bright)))
        return self.paths(x, v, photons, path_m, order).take(bright[~hidden])

    def one_bounce(self, x: _Vertices) -> Paths:
        """Paths of one bounce, f cosθ A / R²: the laser points x themselves where the pixel sees them."""
        v = self.seen(x)
        inside = np.einsum("nk,njk->nj", v.back, self.planes[self.pixel[v.sample]]).max(axis=1) <= 0
        f, _ = self.brdf(x, x.back, v.back)
        aperture = aperture_area(self.capture, v.path)
        photons = x.power * f * dots(x.normal, v.back) * aperture / v.path**2 * self.air(v.path)
        bright = np.flatnonzero(inside & (photons > 0))
        hidden = self.caster.occluded(self.capture.sensor.position, self.lifted(v.take(bright)))
        device = v.path if self.capture.time.origin == "source" else 0.0
        return self.paths(x, x, photons, x.path + device, 1).take(bright[~hidden])

    def photons(self, x: _Vertices, v: _Vertices, gain: Floats, order: int) -> tuple[Floats, Floats]:
        """Photons (n,) of paths by way of x and v, and lengths (n,), m.

        The photons are the integrand over the sum of the densities of all three ways. With p as in `by_light`, and
        with 1/Ω for v drawn from the pixel, per solid angle at the sensor, these densities are

            join: p/Ω     back: pdf_v cosθ_x/R² /Ω     land: p · pdf_x cosθ_v/R² · R_s²/cosθ_s

        gain : (n,) m² sr that v stands for: A dΩ/(du dv) if v was drawn from the pixel, A Ω if a ray from x met it.
        """
        w, r, cos_x, cos_v = _leg(x, v)
        f_x, onto_v = self.brdf(x, x.back, w)
        f_v, onto_x = self.brdf(v, v.back, -w)
        ways = np.ones(len(r))
        if self.occlusion and order > 2:
            ways += _over(onto_x * _over(cos_x, r**2), x.density)
        if self.occlusion:
            lands = self.by_light(onto_v * _over(cos_v, r**2), v, order) * (self.has_lobe[x.part] | (order == 2))
            ways += lands * self.solid_angle[self.pixel[v.sample]] * _over(v.path**2, dots(v.normal, v.back))
        device = v.path if self.capture.time.origin == "source" else 0.0
        photons = x.power * f_x * _over(cos_x * cos_v, r**2) * f_v * gain * self.air(r + v.path) / ways
        return photons, x.path + r + device

    def paths(self, x: _Vertices, v: _Vertices, photons: Floats, path_m: Floats, order: int) -> Paths:
        """The paths by way of x and v as `Paths`, also those without light."""
        part = x.part if order > 2 else v.part
        return Paths(x.sample // self.samples, x.sample, np.full(len(part), order), part, path_m, photons)


def sample_paths(
    caster: Raycaster, scene: Scene, materials: MaterialTable, capture: Capture, pairs: Ints, samples: int, *,
    max_bounces: int | None = 3, direct: bool = False, occlusion: bool = True, seed: int = 0,
) -> Paths:  # fmt: skip
    """Weighted paths of light for some pairs of laser point and pixel, unbiased for any number of samples.

    pairs : (n, 2) indices of laser point and pixel. samples : number for each pair; a sample finds up to three paths
        of each order. A power of two makes the most of the quasi-random numbers.
    max_bounces : highest number of bounces, ≥ 3, or None for no limit (Russian roulette). direct : whether to add
        paths of one and two bounces. occlusion : whether a surface may hide the last hidden vertex from the FoV point
        (`Accuracy.occlusion` is not "off").
    seed : the same seed gives the same paths.
    """
    t = _Tracer(caster, scene, materials, capture, np.asarray(pairs), samples, occlusion)
    # A scrambling for each pair, so that the errors of pairs are independent.
    seeds = stream_seeds(seed, LightStream.SAMPLED_PATHS, np.arange(len(pairs)))
    numbers = scrambled_sobol(seeds, samples, SOBOL_DIMENSIONS).reshape(-1, SOBOL_DIMENSIONS)
    later = np.random.default_rng([LightStream.LATER_PATHS, seed])
    lit = np.flatnonzero(t.of_sample >= 0)
    x = replace(t.lasers.take(t.of_sample[lit]), sample=lit)
    fov, gain = t.fov_points(t.pixel, numbers[:, :2])
    beside = t.beside(fov, gain, numbers[:, 5:7]) if occlusion else None
    found = [t.one_bounce(x if direct else x.take(np.empty(0, np.int64)))]
    order, b = 2, x
    # x is the vertex before the FoV point of paths of `order`, and b the one before that.
    while len(x):
        joined = order > 2 or direct
        if joined:
            found.append(t.join(x, fov, gain, order))
        if order > 2 and beside is not None:
            found.append(t.back(b, beside, fov, gain, order))
        lands = joined and occlusion
        if order == max_bounces:
            x = x.take((t.has_lobe[x.part] | (order == 2)) & lands)
        if order == 2:
            y = t.second(x, numbers[x.sample, 2:5])
        else:
            y = t.onward(x, numbers[x.sample, 7:9] if order == 3 else later.random((len(x), 2)), order)
        if lands:
            found.append(t.land(x, y, order))
        if order == max_bounces:
            break
        if max_bounces is None and order >= ROULETTE_FROM:
            stays = np.clip(y.power / x.power[np.searchsorted(x.sample, y.sample)], *SURVIVAL)
            y = replace(y, power=y.power / stays).take(later.random(len(y.sample)) < stays)
        b, x, order = x, y, order + 1
    return Paths(**{f.name: np.concatenate([getattr(some, f.name) for some in found]) for f in fields(Paths)})
