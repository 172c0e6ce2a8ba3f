"""The definition of a transient, in plain numpy, against which every faster method is tested.

A path of B bounces goes from the laser by x₁ … x_B to the sensor: x₁ is the laser point, x_B a point in the pixel's
field of view (FoV point), and those between are hidden vertices. The expected photons in the aperture per emitted
photon are the integral over all such paths

    L = ∫ … ∫  Π_{i<B} [ fᵢ cosθᵢ cosθᵢ₊₁ V / Rᵢ,ᵢ₊₁² ]  f_B A  exp(−κ · length)  dA₂ … dA_{B−1} dΩ          (1)

with BRDFs f, angles θ against the normals, visibility V (0 or 1), distances R, attenuation κ per metre, the sensor's
aperture A and the pixel's solid angle Ω. A path arrives at its length / c. Surfaces scatter on both sides and
transmit nothing, so both directions at a vertex lie on one side of it. A finite aperture of radius a counts A R²/(R²
+ a²) at distance R.

`plain_paths` is the plainest Monte Carlo estimate of (1): hidden vertices are uniform on all surfaces, and FoV points
are uniform on the pixel. Its mean is right in every scene, for every BRDF and number of bounces; its noise is large
where lobes are narrow. `reference` adds such paths up in time bins.

`paths.py` draws paths of the same integral where most light is, with far less noise. Tests compare it with
`plain_paths`, and all other ways with `paths.py`.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from datagen.compiled import compiled
from datagen.records import Capture, Laser, Scene, Transient
from datagen.records.accuracy import MAX_BOUNCES
from datagen.records.arrays import Floats, Ints, joined_rows, rows_of
from datagen.seeding import LightStream
from datagen.transport.brdf import MaterialTable, evaluate
from datagen.transport.coincidence import set_apart
from datagen.transport.fields_of_view import PixelCones, place_in_pixels, sensitivity
from datagen.transport.geometry import TINY
from datagen.transport.laser_points import LaserPoints
from datagen.transport.memory import in_calls
from datagen.transport.rays import Raycaster
from datagen.transport.sampling import stream_seeds
from datagen.units import time_from_path


class Paths(NamedTuple):
    """n weighted paths. All paths of one pair of laser point and pixel and of one order add up to its expected
    photons.

    Attributes
    ----------
    pair : (n,) row of `pairs`.
    sample : (n,) number of the sample that the path belongs to, pair · samples + 0 … samples − 1. All samples of a
        pair follow the same distribution, so the spread of their sums gives a standard error (one that is too large
        where the samples are stratified).
    order : (n,) number of bounces B.
    part : (n,) index of the part that the last hidden vertex x_{B−1} lies on; with one or two bounces, that of x_B.
    path_m : (n,) length that counts for the time axis, m. The legs from the laser and to the sensor count only with
        the time origin `source`.
    photons : (n,) expected photons at the aperture per emitted photon.
    """

    pair: Ints
    sample: Ints
    order: Ints
    part: Ints
    path_m: Floats
    photons: Floats


@compiled()
def brdf(kind, values, part, normal, w_in, w_out):  # type: ignore[no-untyped-def]
    """(n,) BRDFs f at n vertices, 1/sr.

    part : (n,) indices. w_in, w_out : (n, 3) unit directions away from the vertices. normal : (n, 3) on the side of
    both.
    """
    f = np.empty(len(part))
    for i in range(len(part)):
        n = (normal[i, 0], normal[i, 1], normal[i, 2])
        a, b = (w_in[i, 0], w_in[i, 1], w_in[i, 2]), (w_out[i, 0], w_out[i, 1], w_out[i, 2])
        f[i] = evaluate(kind[part[i]], values[part[i]], n, a, b)
    return f


def plain_paths(
    caster: Raycaster, scene: Scene, materials: MaterialTable, capture: Capture, pairs: Ints, samples: int, *,
    max_bounces: int | None = 3, direct: bool = False, seed: int = 0,
) -> Paths:  # fmt: skip
    """Weighted paths: for each pair of laser point and pixel `samples` samples, each of one path of every order.

    pairs : (n, 2) indices of laser point and pixel. max_bounces : highest number of bounces, or None for no limit.
    direct : whether to add paths of one and two bounces.
    """
    rng = np.random.default_rng([LightStream.PLAIN_REFERENCE, seed])
    laser, pixel = np.repeat(pairs, samples, axis=0).T
    count, device = len(pixel), capture.time.origin == "source"
    part_of_face = scene.face_part.astype(np.int64)

    def f(part: Ints, normal: Floats, w_in: Floats, w_out: Floats) -> Floats:
        return np.asarray(brdf(materials.kind, materials.values, part, normal, w_in, w_out))

    def air(metres: Floats) -> Floats:
        return np.exp(-scene.attenuation_per_m * metres)

    # x₁, the laser point: the first surface along the laser's ray, which a beam spreads over its cell. `power` is the
    # product in (1) so far, over the density with which the vertices were drawn; an emitted photon is shared by all
    # samples.
    hits = caster.closest(capture.laser.position, _targets(capture.laser, laser, rng) - capture.laser.position)
    x, n_x, part_x = hits.position, hits.normal, part_of_face[hits.face]
    first = capture.laser.position - x
    leg = np.linalg.norm(first, axis=1)
    back, power, path = first / leg[:, None], air(leg) * hits.valid / samples, leg * device
    # x_B, the FoV point: the first surface along a line of sight through q(u, v), which is uniform on the pixel's
    # quadrilateral. It stands for the solid angle dΩ/(du dv) = |q · (∂q/∂u × ∂q/∂v)| / |q|³; `gain` is A dΩ in (1).
    a, b, c, d = (capture.sensor.pixels[pixel, k] - capture.sensor.position for k in range(4))
    u, v = rng.random((2, count, 1))
    q = (1 - v) * ((1 - u) * a + u * b) + v * ((1 - u) * d + u * c)
    across = np.cross((1 - v) * (b - a) + v * (c - d), (1 - u) * (d - a) + u * (c - b))
    seen = caster.closest(capture.sensor.position, q)
    z, n_z, part_z = seen.position, seen.normal, part_of_face[seen.face]
    last = capture.sensor.position - z
    leg_z = np.linalg.norm(last, axis=1)
    gain = np.abs(dots(q, across)) / dots(q, q) ** 1.5 * air(leg_z) * seen.valid * aperture_area(capture, leg_z)
    if capture.sensor.footprints is not None:
        gain *= sensitivity(capture.sensor.footprints, pixel, np.hstack([u, v]))

    found = []
    if direct:
        # B = 1, which has no dΩ to integrate: the laser point itself, if it lies inside the pixel: f cosθ A / R².
        to = capture.sensor.position - x
        r = np.linalg.norm(to, axis=1)
        w = to / r[:, None]
        inside = np.einsum("nk,njk->nj", w, PixelCones.of(capture.sensor).planes[pixel]).max(axis=1) <= 0
        inside &= ~caster.occluded(capture.sensor.position, x + caster.offset_m * n_x)
        if capture.sensor.footprints is not None:
            uv, within = place_in_pixels(capture.sensor, -w)
            inside = sensitivity(capture.sensor.footprints, pixel, uv[pixel, np.arange(count)]) * (
                inside & within[pixel, np.arange(count)]
            )
        photons = power * f(part_x, n_x, back, w) * dots(n_x, w) * aperture_area(capture, r) / r**2 * air(r) * inside
        found.append(Paths(np.arange(count) // samples, np.arange(count), np.ones(count, np.int64), part_x,
                           path + r * device, photons))  # fmt: skip
    order, area = 2, caster.face_area_m2
    while max_bounces != 1:
        # End the path here: x is x_{B−1}, z is x_B. The last factors of (1) are f_x cosθ_x cosθ_z V / R² · f_z A dΩ.
        w, r, near = _between(caster, x, n_x, z, n_z)
        photons = power * f(part_x, n_x, back, w) * near * air(r) * f(part_z, n_z, -w, last / leg_z[:, None]) * gain
        if order > 2 or direct:
            of = part_x if order > 2 else part_z
            found.append(Paths(np.arange(count) // samples, np.arange(count), np.full(count, order), of,
                               path + r + leg_z * device, photons))  # fmt: skip
        if order == max_bounces or not power.any():
            break
        # Or go on to a further hidden vertex y, uniform on all surfaces, so that its density is 1/area; its normal is
        # turned to where light comes from. It brings the factor f_x cosθ_x cosθ_y V / R² dA.
        face = rng.choice(len(area), count, p=area / area.sum())
        root, other = np.sqrt(rng.random(count)), rng.random(count)
        weights = np.stack([1 - root, root * (1 - other), root * other], axis=1)
        y = np.einsum("nk,nkj->nj", weights, caster.corners[face])
        n_y = caster.face_normal[face] * np.sign(dots(caster.face_normal[face], x - y))[:, None]
        w, r, near = _between(caster, x, n_x, y, n_y)
        power = power * f(part_x, n_x, back, w) * near * air(r) * area.sum()
        x, n_x, part_x, back, path, order = y, n_y, part_of_face[face], -w, path + r, order + 1
        # Russian roulette: half of the paths go on, with twice the power.
        if max_bounces is None and order > 4:
            power = power * (rng.random(count) < 0.5) / 0.5
    every = joined_rows(*found)
    return rows_of(every, every.photons > 0)


def _targets(laser: Laser, number: Ints, rng: np.random.Generator) -> Floats:
    """(n, 3) targets of laser points by number: where a beam states its cells, random points of the cells."""
    if laser.cells is None:
        return laser.targets[number]
    a, b, _, d = (laser.cells[number, k] for k in range(4))
    u, v = rng.random((2, len(number), 1))
    return np.asarray(a + u * (b - a) + v * (d - a))


def _between(caster: Raycaster, x: Floats, n_x: Floats, y: Floats, n_y: Floats) -> tuple[Floats, Floats, Floats]:
    """Unit directions (n, 3) from points x to points y, distances R (n,), and cosθ cosθ′ V / R² (n,).

    n_x, n_y : (n, 3) unit normals at the points; a surface that faces away gives 0.
    """
    span = y - x
    r = np.linalg.norm(span, axis=1)
    w = span / np.maximum(r, TINY)[:, None]
    cosines = np.maximum(dots(n_x, w), 0.0) * np.maximum(-dots(n_y, w), 0.0)
    visible = ~caster.occluded(x + caster.offset_m * n_x, y + caster.offset_m * n_y)
    return w, r, np.divide(cosines, r**2, where=r > 0, out=np.zeros_like(r)) * visible


def dots(a: Floats, b: Floats) -> Floats:
    """(n,) scalar products of vectors a and b (n, 3)."""
    return np.asarray(np.einsum("nk,nk->n", a, b))


def aperture_area(capture: Capture, distance: Floats) -> Floats:
    """(n,) area A of equation (1), m², seen from distances (n,), metres: of a small aperture or of a finite disc."""
    sensor = capture.sensor
    near = sensor.aperture_radius_m**2 if sensor.finite_aperture else 0.0
    return np.asarray(sensor.aperture_area_m2 * distance**2 / (distance**2 + near))


def reference(
    scene: Scene, capture: Capture, *, samples: int = 4096, replicates: int = 8, max_bounces: int | None = 3,
    direct: bool = False, seed: int = 0, draw: Callable[..., Paths] = plain_paths,
) -> Transient:  # fmt: skip
    """The transient (L, P, T) of a capture by its definition, by component and part, with standard errors.

    samples : number for each pair of laser point and pixel in each of `replicates` independent runs, whose spread is
        the standard error. draw : function that draws the paths: `plain_paths`, or `paths.sample_paths`,
        which has the same arguments and the same mean with far less noise. The other arguments are those of `draw`.
    """
    apart = set_apart(scene, capture)
    scene, caster = apart.scene, apart.caster
    materials, axis, shape = MaterialTable.of(scene.materials), capture.time, capture.shape
    pairs = pairs_of(capture)
    # A flood is the weighted mean over its laser points (`flood.py`): all of a pixel's light goes into one histogram.
    flood = capture.illumination == "flood"
    histogram_of = pairs[:, 1] if flood else np.arange(len(pairs))
    share = (capture.laser.shares[pairs[:, 0]] if flood else np.ones(len(pairs))) / replicates
    parts = len(scene.part_names)
    rows, values = parts + 3, int(np.prod(shape))
    light, squares, overflow = np.zeros(rows * values), np.zeros(values), np.zeros(values // axis.bins)
    for replicate in range(replicates):
        before = light.reshape(rows, values).sum(axis=0)
        for some in in_calls(len(pairs), 64 * samples):
            own_seed = int(stream_seeds(seed, LightStream.REFERENCE, replicate, some.start)[0])
            paths = draw(
                caster, scene, materials, capture, pairs[some], samples, max_bounces=max_bounces, direct=direct,
                seed=own_seed,
            )  # fmt: skip
            # A bin is the integral of the flux between its edges; what arrives outside the window is overflow.
            place = np.floor((time_from_path(paths.path_m) - axis.start_s) / axis.width_s)
            inside = (place >= 0) & (place < axis.bins)
            histogram, photons = histogram_of[some][paths.pair], share[some][paths.pair] * paths.photons
            # The rows are the primary of each part, then direct light, the secondary and higher orders.
            row = np.where(paths.order == 3, paths.part, parts + np.clip(paths.order - 3, 0, 2))
            to = (row * len(overflow) + histogram) * axis.bins + place.astype(np.int64)
            light += np.bincount(to[inside], photons[inside], len(light))
            overflow += np.bincount(histogram[~inside], photons[~inside], len(overflow))
        squares += (light.reshape(rows, values).sum(axis=0) - before) ** 2
    by_row = light.reshape(rows, *shape)
    scatter = np.maximum(squares - by_row.sum(axis=0).ravel() ** 2 / replicates, 0.0)
    stderr = np.sqrt(scatter * replicates / (replicates - 1)) if replicates > 1 else np.full(values, np.nan)
    points = LaserPoints.of(caster, scene, capture.laser).position
    last = MAX_BOUNCES if max_bounces is None else max_bounces
    requested = {"direct": direct, "primary": True, "secondary": last > 3, "higher": last > 4}
    found = {"direct": by_row[parts], "primary": by_row[:parts].sum(axis=0), "secondary": by_row[parts + 1],
             "higher": by_row[parts + 2]}  # fmt: skip
    return Transient(
        axis, {name: found[name] for name in found if requested[name]}, dict(zip(scene.part_names, by_row,
        strict=False)), stderr.reshape(shape), overflow.reshape(shape[:2]), points,
    )  # fmt: skip


def pairs_of(capture: Capture) -> Ints:
    """(n, 2) indices of laser point and pixel, a row for each histogram in their order.

    A flood has a row for each of its laser points and each pixel.
    """
    lasers, pixels = len(capture.laser.targets), len(capture.sensor.pixels)
    if capture.pairing == "confocal":
        return np.stack([np.arange(lasers), np.arange(lasers)], axis=1)
    return np.stack(np.divmod(np.arange(lasers * pixels), pixels), axis=1)
