"""Unbiased paths of light, drawn where light is: the truth that tests, benchmarks and second opinions use.

The integral is that of `reference.py`, equation (1) there, and the mean is the same in every scene, to which more
samples go; what differs is the noise. Nothing is shared with quadrature or path tracing but the ray
caster and the BRDFs.

The last two vertices, h = x_{B−1} and v = x_B, are drawn in three ways, given b = x_{B−2}:

- *join*: h from b (by b's BRDF; x₂ also uniform on the parts' areas), v from the pixel;
- *back*: v from the pixel, h from v by v's BRDF: this finds what stands right beside the field of view;
- *land*: h from b, v from h by h's BRDF, if that falls inside the pixel: for h on parts whose BRDF has a lobe.

Whichever way found it, a path counts the integrand over the sum of the densities of all three ways (the balance
heuristic: Veach & Guibas, SIGGRAPH 1995), so together they count every path once.

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
from datagen.transport.reference import Paths
from datagen.transport.sampled_paths_aim import Aim, Ends, aim
from datagen.transport.sampling import scrambled_sobol, stream_seeds
from datagen.transport.visibility.raycast import Hits, Raycaster

BY_AREA = 0.5
"""Share of x₂ drawn by area: whatever it is, the mean is the same. Half of it meets what is small or far half as
often, and what is near more often."""
SOBOL_DIMENSIONS = 9
"""Quasi-random numbers of a sample: two aim at the pixel, three at x₂, two go back from the pixel, two aim at x₃.
Later vertices, for which they gain little, have independent numbers."""
SURVIVAL = (0.05, 0.95)
"""Least and greatest chance to go on, where paths of all orders are followed: the one bounds how much a path's weight
grows at once, the other ends it in the end."""
ROULETTE_FROM = 4
"""Bounce order from which paths may end so."""
SMALLEST = 1e-200
"""Densities below are taken for 0: far below any with which a path is drawn, and safe to divide by."""


@dataclass(frozen=True)
class _Vertices:
    """Where n samples' paths have come to.

    sample, face, part : (n,). position, normal, back : (n, 3) metres; unit normal on the side that the path came
    from; unit direction back along it. power : (n,) photons that arrive. density : (n,) 1/m², with which the way from
    the laser draws this place. path : (n,) metres so far.
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
    """At n vertices the BRDF, and the density with which `_drawn` draws `w_out` for `w_in`; both (n,), 1/sr."""
    f, density = np.empty(len(part)), np.empty(len(part))
    for i in range(len(part)):
        k, material, n = kind[part[i]], values[part[i]], (normal[i, 0], normal[i, 1], normal[i, 2])
        a, b = (w_in[i, 0], w_in[i, 1], w_in[i, 2]), (w_out[i, 0], w_out[i, 1], w_out[i, 2])
        f[i], density[i] = evaluate(k, material, n, a, b), pdf(k, material, n, a, b)
    return f, density


@compiled()
def _drawn(kind, values, part, normal, w_in, uv):  # type: ignore[no-untyped-def]
    """(n, 3) directions drawn by the BRDFs of n vertices from points uv (n, 2) of the unit square."""
    w = np.empty((len(part), 3))
    for i in range(len(part)):
        n, a = (normal[i, 0], normal[i, 1], normal[i, 2]), (w_in[i, 0], w_in[i, 1], w_in[i, 2])
        w[i, 0], w[i, 1], w[i, 2] = sample(kind[part[i]], values[part[i]], n, a, uv[i, 0], uv[i, 1])
    return w


def _dot(a: Floats, b: Floats) -> Floats:
    return np.asarray(np.einsum("nk,nk->n", a, b))


def _leg(a: _Vertices, b: _Vertices) -> tuple[Floats, Floats, Floats, Floats]:
    """From a to b: unit direction (n, 3), distance, and the cosines at a and at b, 0 where a side faces away."""
    span = b.position - a.position
    distance = np.sqrt(_dot(span, span))
    w = span / np.maximum(distance, 1e-300)[:, None]
    return w, distance, np.maximum(_dot(a.normal, w), 0.0), np.maximum(-_dot(b.normal, w), 0.0)


def _over(a: Floats, b: Floats) -> Floats:
    """a / b, and 0 where b is all but 0: a density that nothing is drawn with."""
    return np.divide(a, b, out=np.zeros_like(a), where=b > SMALLEST)


class _Tracer:
    """The paths of some pairs of laser point and pixel: the steps that `sample_paths` takes."""

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
        return np.exp(-self.scene.attenuation_per_m * metres)

    def brdf(self, at: _Vertices, w_in: Floats, w_out: Floats) -> tuple[Floats, Floats]:
        f, density = _brdf(self.materials.kind, self.materials.values, at.part, at.normal, w_in, w_out)
        return f, density

    def drawn(self, at: _Vertices, numbers: Floats) -> Floats:
        kind, values = self.materials.kind, self.materials.values
        return np.asarray(_drawn(kind, values, at.part, at.normal, at.back, np.ascontiguousarray(numbers)))

    def lifted(self, at: _Vertices) -> Floats:
        return at.position + self.caster.offset_m * at.normal

    def met(self, sample: Ints, hits: Hits) -> _Vertices:
        """The surfaces that samples' rays met; those of rays that met none are left out. What arrives comes later."""
        rows = np.flatnonzero(hits.valid)
        face, zero = hits.face[rows].astype(np.int64), np.zeros(len(rows))
        part, nowhere = self.scene.face_part[face].astype(np.int64), np.zeros((len(rows), 3))
        position, normal = hits.position[rows], hits.normal[rows]
        return _Vertices(sample[rows], face, part, position, normal, nowhere, zero, zero, zero)

    def laser_points(self) -> tuple[_Vertices, Ints]:
        """x₁ of the laser rays that meet a surface, the first along each; and which of them a sample has, or −1."""
        laser = self.capture.laser
        used, of_sample = np.unique(self.laser, return_inverse=True)
        span = laser.targets[used] - laser.position
        points = self.met(np.arange(len(used)), self.caster.closest(laser.position, span))
        to_laser = laser.position - points.position
        leg = np.sqrt(_dot(to_laser, to_laser))
        counts = leg if self.capture.time.origin == "source" else np.zeros_like(leg)
        points = replace(points, back=to_laser / leg[:, None], power=self.air(leg) / self.samples, path=counts)
        number = np.full(len(used), -1)
        number[points.sample] = np.arange(len(points))
        return points, number[of_sample]

    def aimed(self, pairs: Ints) -> Aim:
        """Where x₂ is drawn by area, which changes nothing but the variance."""
        lasers, number = self.lasers, self.of_sample[:: self.samples]
        seen, gain = self.fov_points(pairs[:, 1], np.full((len(pairs), 2), 0.5))
        half = 0.5 * np.sqrt(self.solid_angle[pairs[:, 1]]) * seen.path
        lit = lasers.take(np.maximum(number, 0)) if len(lasers) else seen
        x = Ends(lit.position, lit.normal, lit.back, np.where(number < 0, -1, lit.part), half)
        v = Ends(seen.position, seen.normal, seen.back, np.where(gain > 0, seen.part, -1), half)
        planes = np.column_stack([lasers.position, lasers.normal])
        return aim(self.caster, self.scene, self.materials, planes, x, v, len(self.pixel))

    def fov_points(self, pixel: Ints, uv: Floats) -> tuple[_Vertices, Floats]:
        """v of every sample, and the photons that it gives for each unit of f E there: A dΩ/(du dv); 0 without a v.

        A point uniform on the pixel's quadrilateral q(u, v), as seen from the sensor, stands for the solid angle
        dΩ/(du dv) = |q · (∂q/∂u × ∂q/∂v)| / |q|³.
        """
        a, b, c, d = (self.capture.sensor.pixels[pixel, k] - self.capture.sensor.position for k in range(4))
        u, v = uv[:, :1], uv[:, 1:]
        q = (1 - v) * ((1 - u) * a + u * b) + v * ((1 - u) * d + u * c)
        along_u, along_v = (1 - v) * (b - a) + v * (c - d), (1 - u) * (d - a) + u * (c - b)
        jacobian = np.abs(_dot(q, np.cross(along_u, along_v))) / _dot(q, q) ** 1.5
        hits = self.caster.closest(self.capture.sensor.position, q)
        there = hits.valid
        hits.face[~there] = 0
        points = self.seen(self.met(np.arange(len(q)), hits))
        return points, np.where(there, self.aperture(points) * jacobian, 0.0)

    def seen(self, points: _Vertices) -> _Vertices:
        """Places that the sensor sees as FoV points: `back` leads to the sensor, `path` is the distance to it."""
        to_sensor = self.capture.sensor.position - points.position
        leg = np.sqrt(_dot(to_sensor, to_sensor))
        return replace(points, back=to_sensor / leg[:, None], path=leg)

    def aperture(self, v: _Vertices) -> Floats:
        sensor = self.capture.sensor
        near = sensor.aperture_radius_m**2 if sensor.finite_aperture else 0.0
        return np.asarray(sensor.aperture_area_m2 * v.path**2 / (v.path**2 + near))

    def second(self, b: _Vertices, numbers: Floats) -> _Vertices:
        """x₂ seen from the laser points b: by area or by the BRDF, as the first of three numbers says."""
        by_area = numbers[:, 0] < BY_AREA
        face = self.aim.drawn(b.sample // self.samples, numbers[:, 0] / BY_AREA)
        root, other = np.sqrt(numbers[:, 1]), numbers[:, 2]
        weights = np.stack([1 - root, root * (1 - other), root * other], axis=1)
        place = np.einsum("nk,nkj->nj", weights, self.caster.corners[face])
        w = np.where(by_area[:, None], place - self.lifted(b), self.drawn(b, numbers[:, 1:]))
        hits = self.caster.leaving(b.position, b.normal, w)
        # A place counts for the one surface that is met there first, even where two lie on each other.
        hits.face[by_area & (hits.face != face)] = -1
        hits.position[by_area] = place[by_area]
        return self.lit(b.take(hits.valid), self.met(b.sample, hits), order=2)

    def onward(self, b: _Vertices, numbers: Floats, order: int) -> _Vertices:
        """x of `order` ≥ 3: by the BRDF of the vertex b before it."""
        hits = self.caster.leaving(b.position, b.normal, self.drawn(b, numbers))
        return self.lit(b.take(hits.valid), self.met(b.sample, hits), order)

    def lit(self, b: _Vertices, x: _Vertices, order: int) -> _Vertices:
        """The vertices x of `order` that b lights: the photons f_b cosθ_b cosθ_x / R² per area, over x's density."""
        w, r, cos_b, cos_x = _leg(b, x)
        f, density = self.brdf(b, b.back, w)
        density = self.by_light(_over(density * cos_x, r**2), x, order)
        power = b.power * self.air(r) * _over(f * _over(cos_b * cos_x, r**2), density)
        x = replace(x, back=-w, power=power, density=density, path=b.path + r)
        return x.take(power > 0)

    def by_light(self, by_brdf: Floats, x: _Vertices, order: int) -> Floats:
        """1/m², with which the way from the laser draws the vertices x of `order`."""
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
        """What the FoV points see along rays drawn by their BRDFs, against the light."""
        v = fov.take(gain > 0)
        hits = self.caster.leaving(v.position, v.normal, self.drawn(v, numbers[gain > 0]))
        return self.met(v.sample, hits)

    def back(self, b: _Vertices, x: _Vertices, fov: _Vertices, gain: Floats, order: int) -> Paths:
        """Paths of `order` bounces from vertices b by way of the x `beside` the FoV."""
        both, of_b, of_x = np.intersect1d(b.sample, x.sample, assume_unique=True, return_indices=True)
        b, x = b.take(of_b), x.take(of_x)
        # x is what b meets first at that place, which is what a ray from b would have found.
        hits = self.caster.closest(self.lifted(b), x.position - self.lifted(b))
        same = np.abs(hits.position - x.position).max(axis=1) < self.caster.offset_m
        seen = np.flatnonzero(hits.valid & same)
        x = replace(self.met(both[seen], hits.take(seen)), normal=x.normal[seen])
        x = self.lit(b.take(seen), x, order - 1)
        v = fov.take(x.sample)
        photons, path_m = self.photons(x, v, gain[x.sample], order)
        return self.paths(x, v, photons, path_m, order).take(photons > 0)

    def land(self, x: _Vertices, v: _Vertices, order: int) -> Paths:
        """Paths of `order` bounces whose last vertex v, met from x, falls inside the pixel."""
        of_x = np.searchsorted(x.sample, v.sample)
        if order > 2:
            lobed = np.flatnonzero(self.has_lobe[x.part[of_x]])
            of_x, v = of_x[lobed], v.take(lobed)
        span = self.capture.sensor.position - v.position
        inside = np.flatnonzero((np.einsum("nk,njk->nj", span, self.planes[self.pixel[v.sample]]) <= 0).all(axis=1))
        x, v = x.take(of_x[inside]), self.seen(v.take(inside))
        photons, path_m = self.photons(x, v, self.aperture(v) * self.solid_angle[self.pixel[v.sample]], order)
        bright = np.flatnonzero(photons > 0)
        hidden = self.caster.occluded(self.capture.sensor.position, self.lifted(v.take(bright)))
        return self.paths(x, v, photons, path_m, order).take(bright[~hidden])

    def one_bounce(self, x: _Vertices) -> Paths:
        """The laser points themselves, where the pixel sees them: f cosθ A / R²."""
        v = self.seen(x)
        inside = np.einsum("nk,njk->nj", v.back, self.planes[self.pixel[v.sample]]).max(axis=1) <= 0
        f, _ = self.brdf(x, x.back, v.back)
        photons = x.power * f * _dot(x.normal, v.back) * self.aperture(v) / v.path**2 * self.air(v.path)
        bright = np.flatnonzero(inside & (photons > 0))
        hidden = self.caster.occluded(self.capture.sensor.position, self.lifted(v.take(bright)))
        device = v.path if self.capture.time.origin == "source" else 0.0
        return self.paths(x, x, photons, x.path + device, 1).take(bright[~hidden])

    def photons(self, x: _Vertices, v: _Vertices, gain: Floats, order: int) -> tuple[Floats, Floats]:
        """What paths by way of x and v bring, and their length: the integrand over the sum of all ways' densities.

        With p of `by_light`, 1/Ω of v from the pixel, per solid angle at the sensor, these are

            join: p/Ω     back: pdf_v cosθ_x/R² /Ω     land: p · pdf_x cosθ_v/R² · R_s²/cosθ_s

        gain : (n,) m² sr, what v stands for: A dΩ/(du dv) where it was drawn from the pixel, A Ω where it was met.
        """
        w, r, cos_x, cos_v = _leg(x, v)
        f_x, onto_v = self.brdf(x, x.back, w)
        f_v, onto_x = self.brdf(v, v.back, -w)
        ways = np.ones(len(r))
        if self.occlusion and order > 2:
            ways += _over(onto_x * _over(cos_x, r**2), x.density)
        if self.occlusion:
            lands = self.by_light(onto_v * _over(cos_v, r**2), v, order) * (self.has_lobe[x.part] | (order == 2))
            ways += lands * self.solid_angle[self.pixel[v.sample]] * _over(v.path**2, _dot(v.normal, v.back))
        device = v.path if self.capture.time.origin == "source" else 0.0
        photons = x.power * f_x * _over(cos_x * cos_v, r**2) * f_v * gain * self.air(r + v.path) / ways
        return photons, x.path + r + device

    def paths(self, x: _Vertices, v: _Vertices, photons: Floats, path_m: Floats, order: int) -> Paths:
        """All of them, those without light too."""
        part = x.part if order > 2 else v.part
        return Paths(x.sample // self.samples, x.sample, np.full(len(part), order), part, path_m, photons)


def sample_paths(
    caster: Raycaster, scene: Scene, materials: MaterialTable, capture: Capture, pairs: Ints, samples: int, *,
    max_bounces: int | None = 3, direct: bool = False, occlusion: bool = True, seed: int = 0,
) -> Paths:  # fmt: skip
    """Weighted paths of light for some pairs of laser point and pixel, unbiased for any number of samples.

    pairs : (n, 2) indices of laser point and pixel. samples : of each pair; each finds up to three paths of an order.
        A power of two makes the most of the quasi-random numbers.
    max_bounces : highest order, ≥ 3, or None for all (by Russian roulette). direct : orders 1 and 2 as well.
    occlusion : whether anything may stand between last hidden vertex and FoV point (`Accuracy.occlusion` not "off").
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
