"""The paper's secondary with radiometric weights: laser point → observed point o → lookin b → FoV point.

The observed point is the first hidden vertex and the lookin the second; both words are those of Scholes & Leach,
Sensors 24, 6522 (2024). A lookin has Ñ observed points and M FoV points of each pixel. On Lambertian surfaces its
half paths from the laser and its half paths to the sensor factorise, so that all Ñ × M paths by way of it are one
convolution in time (`convolution.py`):

    L = ∫∫∫ f₁ cosθ₁cosθₒ V/R₁ₒ² · fₒ · cosθₒ′cosθ_b V/Rₒ_b² · f_b · cosθ_b′cosθ₄ V/R_b4² · f₄ · A dΩ dA_b dAₒ

The paper places lookins where rays from the laser point land (sec. 4, and `as_printed.py`), which leaves out all that
the laser point does not light. Here cosine-distributed rays from FoV points find most, and such rays from the laser
point the share `BY_LASER`. The density of a lookin is the sum over all points q that could have sent its ray, with
shares s (the balance heuristic: Veach & Guibas, SIGGRAPH 1995):

    D = Σ_q s_q cosθ_q cosθ_b V / (π R²)

Over the FoV points it is the same sum that the half paths out of the lookin take, so their energy over the density
never exceeds the weight of the whole field of view. Observed points are drawn in the same two ways, by rays from the
lookin and by rays from the laser point, which bounds the 1/R² of a short first leg. The mean is right for any counts.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from datagen.errors import InputError
from datagen.paper.convolution import SUB_BINS, Paths, convolve, keep_strongest
from datagen.paper.half_paths import Points, arriving_paths
from datagen.records import Capture, Lambertian, Scene
from datagen.records.arrays import Bools, Floats, Ints
from datagen.records.checks import check_integer, check_kind, check_seed
from datagen.seeding import LightStream
from datagen.transport.brdf import MaterialTable, cosine_directions
from datagen.transport.coincidence import set_apart
from datagen.transport.fields_of_view import PixelCones, fov_points
from datagen.transport.flood import as_scan, sum_of_flood
from datagen.transport.laser_points import LaserPoints
from datagen.transport.rays import Raycaster
from datagen.transport.sampling import scrambled_sobol, stream_seeds
from datagen.transport.scene_numbers import SceneNumbers
from datagen.units import path_from_time

FOV_POINTS = 16
"""FoV points of each pixel that a lookin is connected with. They cost little beside thousands of observed points."""
BY_LASER = 1 / 8
"""Share of the lookins and of the observed points that rays from the laser point find. They bring most of the light
of a laser point right beside another surface, where other rays seldom land. Without them the mean is the same; the
noise is the same in open places (0.012 and 0.016 % in a furnished room), and has no bound in corners."""
RAYS_AT_ONCE = 1 << 17
"""Rays in memory at once, with some 30 numbers each: 32 MiB. Half as many take twice the calls."""
MOST = 2**20
"""Most lookins, and most observed points of each."""


def secondary(
    scene: Scene, capture: Capture, lookins: int = 2025, observed: int = 3600, strongest: int | None = None,
    seed: int = 0,
) -> Floats:  # fmt: skip
    """The light of four bounces by the paper's scheme, with radiometric weights instead of the printed ones.

    Without `strongest` its mean is exact; its noise is large where laser point and field of view lie in one corner.
    It tells what the paper's scheme gives; for data use `dg.simulate`, which holds a target.

    Parameters
    ----------
    scene, capture : as for `dg.simulate`; all parts Lambertian.
    lookins : number N of hidden vertices from which light goes on to the field of view, for all laser points
        together, confocally for each. observed : number Ñ of points from which light arrives at each of them. The
        defaults are the paper's 45 × 45 and 60 × 60.
    strongest : how many of the strongest arriving paths of each lookin are kept (the paper's optimised scheme: 1),
        which loses light; None for all.
    seed : any integer ≥ 0; the same arguments and seed give the same light.

    Returns
    -------
    (L, P, T) photons at the aperture per emitted photon and bin, (1, P, T) for a flood. Light outside the time axis
    is left out, a laser ray that meets nothing brings none.

    Raises
    ------
    InputError : for a part that is not Lambertian, a pixel that is no convex quadrilateral, or a wrong count.
    """
    check_kind("scene", scene, Scene)
    check_kind("capture", capture, Capture)
    check_integer("secondary", "lookins", lookins, 1, MOST)
    check_integer("secondary", "observed", observed, 1, MOST)
    if strongest is not None:
        check_integer("secondary", "strongest", strongest, 1, MOST)
    check_seed(seed)
    for name, material in zip(scene.part_names, scene.materials, strict=True):
        if not isinstance(material, Lambertian):
            raise InputError(
                f"part {name!r}: {type(material).__name__} does not factorise, only Lambertian does: change it, or "
                "use dg.simulate"
            )
    if capture.illumination == "flood":
        return sum_of_flood(secondary(scene, as_scan(capture), lookins, observed, strongest, seed), capture)
    scheme = _Scheme.of(set_apart(scene, capture).scene, capture, observed, strongest, seed)
    light, existing = np.zeros(capture.shape), np.flatnonzero(scheme.points.part >= 0)
    # Laser points that all pixels see share their lookins.
    confocal = capture.pairing == "confocal"
    for lasers in existing[:, None] if confocal else [existing] * (len(existing) > 0):
        pixels = lasers if confocal else np.arange(capture.shape[1])
        numbers = scrambled_sobol(stream_seeds(seed, LightStream.FACTORISED_FIRST, lasers[0]), lookins, 8)[0]
        at_once = max(1, RAYS_AT_ONCE // max(observed, len(pixels) * FOV_POINTS))
        for first in range(0, lookins, at_once):
            scheme.add_lookins(light, lasers, pixels, numbers[first : first + at_once], first)
    return light / lookins


class FovPoints(NamedTuple):
    """M FoV points of each of P pixels for each of n lookins.

    position, normal : (n, P, M, 3) metres, unit normals.
    weight : (n, P, M) photons in the aperture for each unit of irradiance, 0 where a line of sight meets nothing.
    last_leg : (n, P, M) distance to the sensor, m.
    share : (n, P, M) probability with which the lookin is drawn from this point.
    """

    position: Floats
    normal: Floats
    weight: Floats
    last_leg: Floats
    share: Floats


@dataclass(frozen=True)
class _Scheme:
    """A secondary that is being computed.

    points : of the laser. albedo : (K,) of each part. per_metre : sub-bins for each metre of path.
    """

    scene: Scene
    capture: Capture
    caster: Raycaster
    cones: PixelCones
    points: LaserPoints
    albedo: Floats
    scene_numbers: SceneNumbers
    per_metre: float
    observed: int
    strongest: int | None
    seed: int

    @classmethod
    def of(cls, scene: Scene, capture: Capture, observed: int, strongest: int | None, seed: int) -> _Scheme:
        caster, axis = Raycaster(scene), capture.time
        scene_numbers = SceneNumbers.of(caster, scene, MaterialTable.of(scene.materials), axis)
        per_metre = SUB_BINS / float(path_from_time(axis.width_s))
        albedo = np.array([float(material.albedo) for material in scene.materials])
        cones, points = PixelCones.of(capture.sensor), LaserPoints.of(caster, scene, capture.laser)
        return cls(scene, capture, caster, cones, points, albedo, scene_numbers, per_metre, observed, strongest, seed)

    def add_lookins(self, light: Floats, lasers: Ints, pixels: Ints, numbers: Floats, first: int) -> None:
        """Add to `light`, times the number of all lookins, the paths from `lasers` to `pixels` by some lookins.

        numbers : (n, 8) in 0 … 1 for each lookin: its FoV point, its ray (2), the displacement of its sub-bins, and
        shifts of the directions to observed points, from it (2) and from a laser point (2). first : number of the
        first of them.
        """
        fov = self.fov_points(pixels, len(numbers), first)
        lookins, found = self.placed(fov, lasers, numbers)
        if not found.any():
            return
        numbers = numbers[found]
        leaving, density = self.leaving(lookins, FovPoints._make(values[found] for values in fov))
        density = (1 - BY_LASER) * density + BY_LASER * self.lit_density(lookins, lasers)
        by_laser = int(BY_LASER * self.observed)
        own, second = self.observed - by_laser, LightStream.FACTORISED_SECOND
        seen = self.observed_from(lookins, numbers[:, 4:6], own, second, first, lasers[0])
        for laser in lasers:
            each = np.full(len(numbers), laser)
            x1 = Points(self.points.position[each], self.points.normal[each], self.albedo[self.points.part[each]])
            lit = self.observed_from(x1, numbers[:, 6:], by_laser, LightStream.FACTORISED_LIT, first, laser)
            leg = float(self.points.leg[laser])
            arriving, *rays = arriving_paths(x1, leg, lookins, density, seen, lit, self.scene_numbers, self.per_metre)
            arriving.energy[self.caster.occluded_scaled(*rays)] = 0.0
            if self.strongest is not None:
                keep_strongest(arriving, self.strongest)
            convolve(arriving, leaving, numbers[:, 3].copy(), light[laser])

    def fov_points(self, pixels: Ints, count: int, first: int) -> FovPoints:
        """FoV points of `pixels` for each of `count` lookins."""
        seeds = stream_seeds(self.seed, LightStream.FACTORISED_FOV_POINTS, first, pixels)
        uv = scrambled_sobol(seeds, count * FOV_POINTS, 2)
        pool = fov_points(self.caster, self.scene, self.capture.sensor, self.cones, pixels, uv, FOV_POINTS)

        def apart(values: Floats) -> Floats:
            return values.reshape(len(pixels), count, FOV_POINTS, *values.shape[2:]).swapaxes(0, 1)

        # f₄ = ρ/π; where a line of sight meets nothing the weight is 0 and the part −1.
        weight = apart(pool.weight * self.albedo[pool.part] / np.pi)
        whole = weight.sum(axis=(1, 2), keepdims=True)
        share = weight / np.where(whole > 0, whole, 1.0)
        return FovPoints(apart(pool.position), apart(pool.normal), weight, apart(pool.last_leg), share)

    def placed(self, fov: FovPoints, lasers: Ints, numbers: Floats) -> tuple[Points, Bools]:
        """Lookins where rays from laser points and FoV points land, and (n,) which of the rays met a lit surface."""
        running = np.cumsum(fov.share.reshape(len(numbers), -1), axis=1)
        number = (numbers[:, :1] - BY_LASER) / (1 - BY_LASER)
        pick = np.minimum((running <= number * running[:, -1:]).sum(axis=1), running.shape[1] - 1)
        chosen = np.arange(len(numbers)), pick // FOV_POINTS, pick % FOV_POINTS
        position, normal = fov.position[chosen], fov.normal[chosen]
        by_laser = np.flatnonzero(number[:, 0] < 0)
        laser = lasers[(numbers[by_laser, 0] / BY_LASER * len(lasers)).astype(np.int64)]
        position[by_laser], normal[by_laser] = self.points.position[laser], self.points.normal[laser]
        found = self.met(position, normal, numbers[:, None, 1:3])
        kept = (found.albedo > 0) & (running[:, -1] > 0)
        return found.take(kept), kept

    def leaving(self, lookins: Points, fov: FovPoints) -> tuple[Paths, Floats]:
        """Half paths out of the lookins, rows (lookin, pixel), and the density (n,), 1/m², with which rays from the
        FoV points draw the lookins.

        The lookin's BRDF is not among the factors: it is constant, and `arriving_paths` multiplies by it.
        """
        scene, axis = self.scene_numbers, self.capture.time
        form, r = self.form(lookins.position[:, None, None], lookins.normal[:, None, None], fov.position, fov.normal)
        energy = fov.weight * form * np.exp(-scene.air * (r + fov.last_leg))
        # The displaced sub-bins of `convolve` need the length to the centre of the window's first sub-bin.
        start = SUB_BINS * axis.start_s / axis.width_s + 0.5
        position = (r + scene.from_source * fov.last_leg) * self.per_metre - start
        first = np.arange(0, form.size + 1, FOV_POINTS)
        return Paths(first, position.ravel(), energy.ravel()), (fov.share * form).sum(axis=(1, 2)) / np.pi

    def lit_density(self, lookins: Points, lasers: Ints) -> Floats:
        """(n,) density, 1/m², with which cosine-distributed rays from the laser points, in equal shares, land."""
        x1, normal_1 = self.points.position[lasers, None], self.points.normal[lasers, None]
        return np.asarray(self.form(x1, normal_1, lookins.position, lookins.normal)[0].mean(axis=0) / np.pi)

    def form(self, *ends: Floats) -> tuple[Floats, Floats]:
        """(…) geometry terms cosθ cosθ′ V / R², 1/m², and distances R, of points and normals, points and normals."""
        x, normal_x, y, normal_y = np.broadcast_arrays(*ends)
        span = y - x
        square, cos_x, cos_y = ((span * other).sum(axis=-1) for other in (span, normal_x, normal_y))
        form = np.maximum(cos_x, 0) * np.maximum(-cos_y, 0) / np.maximum(square, 1e-300) ** 2
        faced, offset = form > 0, self.caster.offset_m
        form[faced] *= ~self.caster.occluded(x[faced] + offset * normal_x[faced], y[faced] + offset * normal_y[faced])
        return form, np.sqrt(square)

    def observed_from(self, start: Points, shift: Floats, rays: int, stream: LightStream, *more: int) -> Points:
        """(n · rays,) what `rays` rays from each of n points meet.

        All share a net of directions, each with its own shift (n, 2), which keeps it well spread.
        """
        net = scrambled_sobol(stream_seeds(self.seed, stream, *more), rays, 2)[0]
        return self.met(start.position, start.normal, (net + shift[:, None]) % 1.0)

    def met(self, position: Floats, normal: Floats, uv: Floats) -> Points:
        """(n · m,) what cosine-distributed rays from n points (n, 3) meet, m of each, by numbers uv (n, m, 2)."""
        position, normal = (np.repeat(values, uv.shape[1], axis=0) for values in (position, normal))
        hits = self.caster.leaving(position, normal, cosine_directions(normal, uv.reshape(-1, 2)))
        albedo = np.where(hits.valid, self.albedo[self.scene.face_part[hits.face]], 0.0)
        return Points(hits.position, hits.normal, albedo)
