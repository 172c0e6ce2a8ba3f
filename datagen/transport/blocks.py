"""Light of four and more bounces by blocks of shared vertices: unbiased, whatever the effort.

A block serves one group of neighbouring laser points and pixels. It draws front vertices x from the mixture of the
BRDFs at the group's laser points, and back vertices y from the mixture at its FoV points, and joins each of them to
all laser points (FoV points). A shadow ray for each leg tells which see it, and with that the densities Q(x), Q(y) of
the mixtures. Pairs (x, y) are kept with a chance p in proportion to a guess of their light, some thousands of all.
Two more ways find y as the end of a BRDF ray from x, and x as the end of one from y; they bound the 1/R² of surfaces
that touch. A path counts, for all pairs of laser point and pixel at once, with its integrand over the expected number
of times that all ways find it (the balance heuristic, Veach & Guibas, SIGGRAPH 1995), which for four bounces is

    D = p F² Q(x) Q(y) + n Q(x) mean_l pdf(l, x → y) cosθ_y/R² + n Q(y) mean_p pdf(p, y → x) cosθ_x/R²

with F vertices of either kind and n rays onward, and mean_l over the laser points l in proportion to their share of
Q(x). For more bounces, the y found from x is the next front vertex and carries the light of all laser points along.

Only Q(y) bounds the 1/R² between y and a FoV point z, which is drawn on the pixel whatever is near it, and that is
not enough where x and y touch the laser point and each other, too. So there is one more way, *land*: a ray from a y
that was found from x, distributed as the cosine, if it lands in a pixel. It finds t = a cosθ_y cosθ_z/(π R²) times as
many z as the pixel draws, with a the area that z stands for. Of a path's light it brings, where t > 1, the share

    N (t − 1) / (N t + (p̄ F² Q(x) + n cosθ_x cosθ_y/(π R²)) chance_z pdf(z → y) cosθ_y/R²)

with N the middle term of D and p̄ the mean of p, and the other ways bring the rest. This is the balance heuristic
again, with a D that knows of no FoV point but z. Shares that knew of the others would not add up to 1: a z that is
drawn is one of those that Q(y) is made of, and a z where a ray landed is not. A path that lands is found N t times.
Seen from any y most pixels are small, so that t < 1 and nothing changes.

The guess, the groups and the numbers of vertices change the noise and never the mean.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from datagen.compiled import compiled
from datagen.records.arrays import Bools, Floats, Ints, joined_rows, rows_of
from datagen.seeding import LightStream
from datagen.transport.brdf import LAMBERTIAN, cosine_directions, dot, evaluate, pdf, sample
from datagen.transport.effort import REPLICATES, Floats32
from datagen.transport.fields_of_view import FovPool, fov_points, in_pixels
from datagen.transport.geometry import TINY, get, put
from datagen.transport.problem import Problem
from datagen.transport.rays import lifted_and_scaled, write_shadow_ray
from datagen.transport.sampling import SURVIVAL
from datagen.units import path_from_time

VERTICES = 128
"""F: front vertices, and back vertices, of a block; from half of them a BRDF ray goes on, n = F/2. More share the
cost of legs worse, fewer that of pairs."""
FOV_SETS = 8
"""Independent FoV points of each pixel in a block; vertex i meets those of set i mod 8."""
GROUP = {"confocal": 32, "exhaustive": 64}
"""Most laser points, and most pixels, of a group: a vertex is bright for neighbours alike."""
PAIRS = 8
"""Pairs of vertices kept in a block, in units of F, where a group has few laser points and pixels."""
LONGEST = 400
"""Bounces at which paths end that have no limit: a path survives so many once in 10⁹."""
NEAREST = 1e-9
"""Legs shorter than this, relative to the scene's half extent, carry no light: rounding decides about them."""
ADDED = 0.02
"""Cost of adding light to a bin, in shadow rays."""
PILOT = 64
"""Fewest blocks of a pilot, over all groups and replicates."""


class Bins(NamedTuple):
    """Where light of a path goes in the histograms of a group.

    per_metre, start : bins of a metre of path, and the first bin. stride : rows from one laser point to the next, 0
    where all laser points share the histograms of the pixels, −1 where pixel i looks at laser point i.
    """

    per_metre: float
    start: float
    stride: int


class Ends(NamedTuple):
    """Where paths begin or end: the N laser points of a group, or FoV points of its N pixels, in sets of N one after
    the other.

    position, normal, back : (n, 3) metres; unit normal; unit direction to laser or sensor. part : (n,) index, −1 for
    none. gain : (n,) what the device adds to a path: photons, or m² sr in units of `Blocks.unit`. leg : (n,) what its
    leg adds to the path that the clock sees, m. area : (n,) of surface that a FoV point stands for, m²; 0 for laser
    points. chance : (N,) of each laser point or pixel to have vertices drawn.
    """

    position: Floats
    normal: Floats
    back: Floats
    part: Ints
    gain: Floats
    leg: Floats
    area: Floats
    chance: Floats


class Vertices(NamedTuple):
    """n vertices. position, normal : (n, 3). part : (n,) index, −1 for none."""

    position: Floats
    normal: Floats
    part: Ints


class Lit(NamedTuple):
    """n vertices, and their light from N ends. Numbers with a sign are positive on the side of the normal.

    position, normal, part : as in `Vertices`.
    light : (n, N) f cosθ cosθ′ V / R² times the end's gain, over the density of the vertex if it has a history.
    path : (n, N) length from the device, m.
    density : (n, N) 1/m², with which the end's BRDF draws the vertex. mixed : (n, 2) mean of it over the ends, by
    their chances, for the back (0) and the front side (1).
    landing : (n, N) t of the FoV point, see the top of this file; 0 if t ≤ 1, and for laser points.
    came_from : (n, 3) direction that all light comes from, and has_history : (n,) whether this is so: for vertices
    that were found from other vertices, or whose ray landed in a pixel.
    """

    position: Floats
    normal: Floats
    part: Ints
    light: Floats32
    path: Floats32
    density: Floats32
    landing: Floats32
    mixed: Floats
    came_from: Floats
    has_history: Bools

    @classmethod
    def dark(cls, at: Vertices, ends: int) -> Lit:
        """The vertices without any light."""
        n = len(at.part)
        light, path, density, landing = np.zeros((4, n, ends), np.float32)
        none = np.zeros((n, 2)), np.zeros((n, 3)), np.zeros(n, np.bool_)
        return cls(*at, light, path, density, landing, *none)

    @property
    def at(self) -> Vertices:
        """The vertices alone."""
        return Vertices(self.position, self.normal, self.part)


class Sketch(NamedTuple):
    """What a guess of the light of pairs knows of their vertices: `position`, `normal` and `mixed` of `Lit`, and
    bright : (n, 2) the light that they send on to either side, about."""

    position: Floats
    normal: Floats
    mixed: Floats
    bright: Floats


class Odds(NamedTuple):
    """How often the ways find a pair of vertices.

    draws : times that the way of pairs has it drawn. onward : rays on from vertices. full : guess of pairs that are
    certain to be kept. evenly : times that a pair would be kept, for Q(x) Q(y) = 1, if all had the same chance.
    """

    draws: float
    onward: float
    full: float
    evenly: float


class Group(NamedTuple):
    """Indices of neighbouring laser points and pixels, and of the histograms of their pairs."""

    lasers: Ints
    pixels: Ints
    histograms: Ints


@compiled()
def _toward(a, b):  # type: ignore[no-untyped-def]
    """Unit vector from a to b, and the distance."""
    v = (b[0] - a[0], b[1] - a[1], b[2] - a[2])
    r = math.sqrt(dot(v, v))
    return (v[0] / max(r, TINY), v[1] / max(r, TINY), v[2] / max(r, TINY)), r


@compiled()
def _met_by(ends, e, i):  # type: ignore[no-untyped-def]
    """Row of the end that vertex i meets for laser point or pixel e: one of set i, modulo the number of sets."""
    return e + i % (len(ends.part) // len(ends.chance)) * len(ends.chance)


@compiled()
def _rays(scene, ends, u, origin, normal, direction):  # type: ignore[no-untyped-def]
    """BRDF rays from random ends of the group, ray i from set i of FoV points; returns which exist.

    u : (n, 3) random numbers.
    """
    found = np.zeros(len(u), np.bool_)
    for i in range(len(u)):
        # Ends that do not exist are drawn, too, and send nothing: the densities count them with 0.
        e, run = 0, ends.chance[0]
        while run < u[i, 0] and e < len(ends.chance) - 1:
            e += 1
            run += ends.chance[e]
        e = _met_by(ends, e, i)
        found[i] = ends.part[e] >= 0 and ends.gain[e] > 0.0
        w = (0.0, 0.0, 1.0)
        if found[i]:
            k = ends.part[e]
            w = sample(
                scene.kind[k], scene.values[k], get(ends.normal, e, 0), get(ends.back, e, 0), u[i, 1], u[i, 2]
            )  # fmt: skip
        put(origin, i, 0, get(ends.position, e, 0))
        put(normal, i, 0, get(ends.normal, e, 0))
        put(direction, i, 0, w)
    return found


@compiled()
def _rays_onward(scene, ends, x, u, normal, direction):  # type: ignore[no-untyped-def]
    """BRDF rays on from vertices, of light from an end that is chosen by its share of the mixture; returns which
    exist."""
    found = np.zeros(len(u), np.bool_)
    for i in range(len(u)):
        direction[i, 2] = 1.0
        wanted = u[i, 2] * (x.mixed[i, 0] + x.mixed[i, 1])
        if x.part[i] < 0 or wanted <= 0.0:
            continue
        n, a = get(x.normal, i, 0), get(x.came_from, i, 0)
        if not x.has_history[i]:
            # The last end with a density stands in where rounding leaves the sum below what is wanted.
            e, run = -1, 0.0
            for j in range(x.density.shape[1]):
                run += ends.chance[j] * abs(x.density[i, j])
                if x.density[i, j] != 0.0:
                    e = j
                    if run >= wanted:
                        break
            a = _toward(get(x.position, i, 0), get(ends.position, _met_by(ends, e, i), 0))[0]
        if dot(n, a) < 0:
            n = (-n[0], -n[1], -n[2])
        w = sample(scene.kind[x.part[i]], scene.values[x.part[i]], n, a, u[i, 0], u[i, 1])
        found[i] = dot(w, n) > 0
        put(direction, i, 0, w)
        put(normal, i, 0, n)
    return found


@compiled(inline="always")
def _landing(area, up, down, r):  # type: ignore[no-untyped-def]
    """Times t that a cosine-distributed ray from a vertex finds a FoV point for each that the pixel draws it; 0 if
    t ≤ 1."""
    drawn, found = math.pi * r**2, area * up * abs(down)
    return found / drawn if found > drawn else 0.0


@compiled()
def _landings(y, z, row, area):  # type: ignore[no-untyped-def]
    """(k,) `_landing` for some rows of vertices y and of the places z where their rays landed; area : (k, 1)."""
    out = np.empty(len(row))
    for k in range(len(row)):
        v, r = _toward(get(y.position, row[k], 0), get(z.position, row[k], 0))
        up, down = -dot(get(z.normal, row[k], 0), v), dot(get(y.normal, row[k], 0), v)
        out[k] = _landing(area[k, 0], up, down, max(r, TINY))
    return out


@compiled()
def _light(scene, ends, x, origin, span, of):  # type: ignore[no-untyped-def]
    """Lights dark vertices x as if nothing stood between, and sets shadow rays for legs that may carry light; returns
    their number.

    origin, span : (n N, 3) rays in embree's frame. of : (n N,) index of each ray's leg.
    """
    rays, count = 0, x.light.shape[1]
    for i in range(len(x.part)):
        p, n = get(x.position, i, 0), get(x.normal, i, 0)
        for h in range(count):
            e = _met_by(ends, h, i)
            if x.part[i] < 0 or ends.part[e] < 0 or ends.gain[e] <= 0.0:
                continue
            q, m = get(ends.position, e, 0), get(ends.normal, e, 0)
            v, r = _toward(q, p)
            up, down = dot(m, v), -dot(n, v)
            if up <= 0.0 or down == 0.0 or r < NEAREST * scene.frame[3]:
                continue
            k, row, back = scene.kind[ends.part[e]], scene.values[ends.part[e]], get(ends.back, e, 0)
            x.light[i, h] = evaluate(k, row, m, back, v) * up * down / r**2 * ends.gain[e] * math.exp(-scene.air * r)
            x.landing[i, h] = _landing(ends.area[e], up, down, r)
            x.density[i, h] = pdf(k, row, m, back, v) * down / r**2
            x.path[i, h] = r + ends.leg[e]
            if x.density[i, h] != 0.0 or x.light[i, h] != 0.0:
                # Light may come to either side of the vertex; the ray has to begin on the same.
                a = lifted_and_scaled(p, n, math.copysign(scene.offset, down), scene.frame)
                write_shadow_ray(origin, span, rays, a, lifted_and_scaled(q, m, scene.offset, scene.frame))
                of[rays] = i * count + h
                rays += 1
    return rays


@compiled()
def _without_hidden(x, chance, hidden, of):  # type: ignore[no-untyped-def]
    """Takes hidden legs out, and sets the mean density by side."""
    for k in range(len(hidden)):
        if hidden[k]:
            i, h = of[k] // x.light.shape[1], of[k] % x.light.shape[1]
            x.light[i, h] = x.density[i, h] = 0.0
    for i in range(len(x.mixed)):
        for h in range(x.light.shape[1]):
            x.mixed[i, 1 if x.density[i, h] > 0 else 0] += chance[h] * abs(x.density[i, h])


@compiled()
def _sent_toward(scene, ends, x, i, v, side, out):  # type: ignore[no-untyped-def]
    """Sets out (N,) to each end's light times the BRDF of vertex i towards v, and returns the mixture's density there
    times that of going on so, 1/(m² sr)."""
    n, k, row, count, density = get(x.normal, i, 0), scene.kind[x.part[i]], scene.values[x.part[i]], len(out), 0.0
    if side == 0:
        n = (-n[0], -n[1], -n[2])
    if x.has_history[i]:
        # All light comes from one direction, so that one BRDF serves all ends.
        a = get(x.came_from, i, 0)
        on_this_side = dot(n, a) > 0
        f = evaluate(k, row, n, a, v) if on_this_side else 0.0
        for e in range(count):
            out[e] = abs(x.light[i, e]) * f
        return pdf(k, row, n, a, v) if on_this_side else 0.0
    for e in range(count):
        out[e] = 0.0
        if (x.density[i, e] > 0) == (side == 1) and x.density[i, e] != 0.0:
            a = _toward(get(x.position, i, 0), get(ends.position, _met_by(ends, e, i), 0))[0]
            out[e] = abs(x.light[i, e]) * evaluate(k, row, n, a, v)
            density += ends.chance[e] * abs(x.density[i, e]) * pdf(k, row, n, a, v)
    return density


@compiled()
def _sent_by_lambertian(kind, values, part, light):  # type: ignore[no-untyped-def]
    """(n, 2, N) light that Lambertian vertices send on to either side; and (n,) whether a vertex is Lambertian."""
    out, is_lambertian = np.zeros((len(light), 2, light.shape[1]), np.float32), np.zeros(len(light), np.bool_)
    for i in range(len(out)):
        is_lambertian[i] = part[i] >= 0 and kind[part[i]] == LAMBERTIAN
        if is_lambertian[i]:
            f = np.float32(values[part[i], 0] / math.pi)
            for e in range(light.shape[1]):
                out[i, 1, e] = max(f * light[i, e], np.float32(0.0))
                out[i, 0, e] = max(-f * light[i, e], np.float32(0.0))
    return out, is_lambertian


@compiled()
def _brightness(values, x):  # type: ignore[no-untyped-def]
    """(n, 2) root mean square over the ends of the light that vertices send on to either side, as if Lambertian."""
    out = np.zeros((len(x.part), 2))
    for i in range(len(x.part)):
        if x.part[i] >= 0:
            for e in range(x.light.shape[1]):
                out[i, 1 if x.light[i, e] > 0 else 0] += np.float64(x.light[i, e]) ** 2
            for k in range(2):
                out[i, k] = math.sqrt(out[i, k] / x.light.shape[1]) * values[x.part[i], 0] / math.pi
    return out


@compiled()
def _guess(x, y, i, j, draws, onward):  # type: ignore[no-untyped-def]
    """About the light of the pair of vertices x[i], y[j] over the number of its draws, as if both were Lambertian and
    saw each other. x, y : sketches of the vertices."""
    # Plain numbers, not vectors, so that the loop over all pairs becomes vector instructions.
    p, n, q, m = x.position, x.normal, y.position, y.normal
    v0, v1, v2 = q[j, 0] - p[i, 0], q[j, 1] - p[i, 1], q[j, 2] - p[i, 2]
    up = n[i, 0] * v0 + n[i, 1] * v1 + n[i, 2] * v2
    down = -(m[j, 0] * v0 + m[j, 1] * v1 + m[j, 2] * v2)
    side_x, side_y = 1 if up > 0 else 0, 1 if down > 0 else 0
    r2 = v0 * v0 + v1 * v1 + v2 * v2
    c = abs(up * down) / (r2 * r2 + 1e-30)
    light = x.bright[i, side_x] * y.bright[j, side_y]
    expected = draws * (x.mixed[i, 0] + x.mixed[i, 1]) * (y.mixed[j, 0] + y.mixed[j, 1])
    expected += onward * c / math.pi * (x.mixed[i, side_x] + y.mixed[j, side_y])
    return light * c / expected if light > 0.0 else 0.0


@compiled()
def _guesses(x, y, draws, onward, out):  # type: ignore[no-untyped-def]
    """Sets out (n, m) to the guesses of all pairs of sketches, and returns their sum."""
    total = 0.0
    for i in range(out.shape[0]):
        for j in range(out.shape[1]):
            out[i, j] = _guess(x, y, i, j, draws, onward)
            total += out[i, j]
    return total


@compiled()
def _chosen(scene, x, y, guess, full, u, pairs, origin, span):  # type: ignore[no-untyped-def]
    """Systematic choice of pairs with chances min(guess / full, 1), and their shadow rays; returns their number.

    x, y : sketches. pairs : (2, k) set to the vertices of each pair. u : a random number.
    """
    count, run = 0, u
    for i in range(guess.shape[0]):
        for j in range(guess.shape[1]):
            run += min(guess[i, j] / full, 1.0)
            if run >= 1.0:
                run -= 1.0
                p, q, n, m = get(x.position, i, 0), get(y.position, j, 0), get(x.normal, i, 0), get(y.normal, j, 0)
                v = _toward(p, q)[0]
                a = lifted_and_scaled(p, n, math.copysign(scene.offset, dot(n, v)), scene.frame)
                b = lifted_and_scaled(q, m, math.copysign(scene.offset, -dot(m, v)), scene.frame)
                write_shadow_ray(origin, span, count, a, b)
                pairs[0, count], pairs[1, count] = i, j
                count += 1
    return count


@compiled()
def _spread(of_x, of_y, time_x, time_y, g, between, stride, light, place, histogram):  # type: ignore[no-untyped-def]
    """Adds the light of_x · of_y · g of every pair of ends to the bin of its arrival.

    The first column of the histogram is what comes before the window, the last what comes after. stride : of
    `Bins`. light, place : arrays of N values to work in.
    """
    last = np.float32(histogram.shape[1] - 1)
    if stride < 0:
        for k in range(len(of_x)):
            light[k] = of_x[k] * of_y[k] * g
            place[k] = np.int32(min(max(time_x[k] + time_y[k] + between, np.float32(0.0)), last))
        for k in range(len(of_x)):
            histogram[k, place[k]] += light[k]
        return
    for k in range(len(of_x)):
        f, at, row = of_x[k] * g, time_x[k] + between, k * stride
        if f == 0:
            continue
        for p in range(len(of_y)):
            light[p] = f * of_y[p]
            place[p] = np.int32(min(max(at + time_y[p], np.float32(0.0)), last))
        for p in range(len(of_y)):
            histogram[row + p, place[p]] += light[p]


@compiled()
def _shared(y, chance, j, onward, rest, light, out):  # type: ignore[no-untyped-def]
    """Sets out (N,) to the share of the light (N,) of vertex y[j] that is for its way, land or another.

    chance : of the ends. onward, rest : N and what is before chance_z in the formula at the top of this file.
    """
    for h in range(len(out)):
        out[h], t = light[h], y.landing[j, h]
        if t > 0.0:
            land = onward * (t - 1.0) / max(onward * t + rest * chance[h] * abs(y.density[j, h]), TINY)
            out[h] *= land / t if y.has_history[j] else 1.0 - land


@compiled()
def _tally(scene, bins, front, back, x, y, sketches, odds, pairs, hidden, histogram):  # type: ignore[no-untyped-def]
    """Adds the light of all pairs of ends, `front` and `back`, by way of pairs of vertices (2, k), of which some are
    hidden (k,) from each other, to the histogram (H, T + 2)."""
    N, M, onward = x.light.shape[1], y.light.shape[1], odds.onward
    own_x, own_y = np.empty(N, np.float32), np.empty(M, np.float32)
    light, place = np.empty(max(N, M), np.float32), np.empty(max(N, M), np.int32)
    time_x, time_y = x.path * np.float32(bins.per_metre), y.path * np.float32(bins.per_metre)
    sent_x, simple_x = _sent_by_lambertian(scene.kind, scene.values, x.part, x.light)
    sent_y, simple_y = _sent_by_lambertian(scene.kind, scene.values, y.part, y.light)
    # Few vertices are so near to a pixel that a ray of theirs might land in it.
    touches = np.array([row.max() > 0.0 for row in y.landing])
    for k in range(len(hidden)):
        i, j = pairs[0, k], pairs[1, k]
        if hidden[k] or x.part[i] < 0 or y.part[j] < 0:
            continue
        v, r = _toward(get(x.position, i, 0), get(y.position, j, 0))
        up, down = dot(get(x.normal, i, 0), v), -dot(get(y.normal, j, 0), v)
        side_x, side_y = 1 if up > 0 else 0, 1 if down > 0 else 0
        chance = _guess(sketches[0], sketches[1], i, j, odds.draws, onward) / odds.full
        onto_y, onto_x = abs(up) / math.pi * x.mixed[i, side_x], abs(down) / math.pi * y.mixed[j, side_y]
        from_x, from_y = sent_x[i, side_x], sent_y[j, side_y]
        # Lambertian vertices, most of all, need no BRDF for each end.
        if not simple_x[i]:
            onto_y, from_x = _sent_toward(scene, front, x, i, v, side_x, own_x), own_x
        if not simple_y[j]:
            onto_x, from_y = _sent_toward(scene, back, y, j, (-v[0], -v[1], -v[2]), side_y, own_y), own_y
        mixed_x, mixed_y = x.mixed[i, 0] + x.mixed[i, 1], y.mixed[j, 0] + y.mixed[j, 1]
        expected = min(chance, 1.0) * odds.draws * mixed_x * mixed_y
        # A vertex x with a history was not found from y, and no x was found from a y whose ray landed.
        back_way = 0.0 if x.has_history[i] or y.has_history[j] else onto_x * abs(up)
        rays = onward / max(r, TINY) ** 2
        expected += rays * (onto_y * abs(down) + back_way)
        if expected > 0.0:
            if touches[j]:
                rest = odds.evenly * mixed_x
                if not x.has_history[i]:
                    rest += rays * abs(up * down) / math.pi
                _shared(y, back.chance, j, rays * onto_y * abs(down), rest, from_y, own_y)
                from_y = own_y
            g = np.float32(abs(up * down) / r**2 * math.exp(-scene.air * r) / expected)
            # One more bin, as the first column is what comes before the window.
            between = np.float32(r * bins.per_metre - bins.start + 1.0)
            _spread(from_x, from_y, time_x[i], time_y[j], g, between, bins.stride, light, place, histogram)


@compiled()
def _carry(scene, ends, x, onward, y, power):  # type: ignore[no-untyped-def]
    """Lights dark vertices y, at the end of one ray from each x, over the density of drawing them and their number;
    sets power (n,) to the sum of their light."""
    sent = np.empty(y.light.shape[1], np.float32)
    for i in range(len(y.part)):
        # The ray met nothing, or there was none.
        if y.part[i] < 0:
            continue
        v, r = _toward(get(x.position, i, 0), get(y.position, i, 0))
        up, down = dot(get(x.normal, i, 0), v), -dot(get(y.normal, i, 0), v)
        density = onward * _sent_toward(scene, ends, x, i, v, 1 if up > 0 else 0, sent)
        if density > 0:
            for e in range(len(sent)):
                y.light[i, e] = math.copysign(sent[e] * abs(up) * math.exp(-scene.air * r) / density, down)
                y.path[i, e] = x.path[i, e] + r
                power[i] += abs(y.light[i, e])
            put(y.came_from, i, 0, (-v[0], -v[1], -v[2]))


def _chances(error: Floats) -> Floats:
    """Chances of which half are even and half in proportion to errors: where an error is far too low, an end weighs
    at most twice as much as without aim."""
    even, total = np.full(len(error), 1.0 / len(error)), float(error.sum())
    return 0.5 * even + 0.5 * (error / total if total > 0 else even)


def _neighbours(points: Floats, most: int) -> list[Ints]:
    """Indices of points (n, 3) in groups of up to `most` neighbours; each is cut in half across its longest side."""
    todo, groups = [np.arange(len(points))], list[Ints]()
    while todo:
        group = todo.pop()
        if len(group) <= most:
            groups.append(np.sort(group))
            continue
        order = group[np.argsort(points[group][:, np.ptp(points[group], axis=0).argmax()], kind="stable")]
        todo += [order[: len(order) // 2], order[len(order) // 2 :]]
    return groups


class Blocks:
    """What all blocks of a problem share.

    lasers : the laser points. groups : of neighbouring laser points and pixels; each pair of the capture is in one of
    them. unit : photons that light in blocks is a multiple of, so that single precision has room for it.
    """

    def __init__(self, problem: Problem) -> None:
        self.problem, self.caster, capture = problem, problem.caster, problem.capture
        axis, points, P = capture.time, problem.points, len(capture.sensor.pixels)
        # Kinds of one type, so that kernels are compiled once, whether or not all parts of a scene are Lambertian.
        self.scene = problem.numbers._replace(kind=problem.materials.kind.astype(np.int64))
        self.per_metre, self.start = 1.0 / float(path_from_time(axis.width_s)), axis.start_s / axis.width_s
        self.is_confocal, self.is_flood = capture.pairing == "confocal", capture.illumination == "flood"
        exists = points.part >= 0
        leg = np.where(exists, points.leg, 0.0)
        self.lasers = Ends(
            np.where(exists[:, None], points.position, 0.0), points.normal, points.to_laser, points.part,
            np.where(exists, problem.pairs.share * np.exp(-self.scene.air * leg), 0.0),
            leg * self.scene.from_source,
            np.zeros(len(leg)), np.ones(len(leg)),
        )  # fmt: skip
        self.unit = 1.0
        middle = self.fov_points(np.arange(P), np.full((P, 1, 2), 0.5))
        self.unit = float(middle.gain.max()) or 1.0
        size = GROUP[capture.pairing]
        of_lasers = _neighbours(self.lasers.position, size)
        if self.is_confocal:
            self.groups = [Group(some, some, some) for some in of_lasers]
        else:
            self.groups = [
                Group(some, pixels, pixels if self.is_flood else (some[:, None] * P + pixels).ravel())
                for pixels in _neighbours(middle.position, size)
                for some in of_lasers
            ]

    def fov_points(self, pixels: Ints, uv: Floats) -> Ends:
        """FoV points at coordinates uv (P, Q, 2) of the quadrilaterals of some pixels, set after set."""
        problem = self.problem
        found = fov_points(self.caster, problem.scene, problem.capture.sensor, problem.cones, pixels, uv, 1)
        return self.ends_of(found)

    def ends_of(self, found: FovPool) -> Ends:
        """FoV points as ends of paths, set after set, gains in `unit`, without chances."""

        def in_sets(values: NDArray[Any]) -> NDArray[Any]:
            return np.ascontiguousarray(values.swapaxes(0, 1)).reshape(-1, *values.shape[2:])

        leg = np.where(found.part >= 0, found.last_leg, 0.0)
        gain = np.where(found.part >= 0, found.weight * np.exp(-self.scene.air * leg) / self.unit, 0.0)
        leg *= self.scene.from_source
        back = np.broadcast_to(found.to_sensor, found.position.shape)
        arrays = found.position, found.normal, back, found.part, gain, leg, found.footprint
        return Ends._make([*map(in_sets, arrays), np.empty(0)])


class BlocksOf:
    """The blocks that bring four bounces, or all orders from five to `last`: a source for `effort.py`.

    full : group → order → guess from which on pairs of vertices are certain to be kept. chances : group → those of
    its laser points, and of its pixels, to have vertices drawn.
    """

    can_blur = True

    def __init__(self, blocks: Blocks, last: int) -> None:
        self.blocks, self.last, self.unit = blocks, last, blocks.unit
        self.histograms = [group.histograms for group in blocks.groups]
        self.first = -(-PILOT // (REPLICATES * len(blocks.groups)))
        self.full = dict[int, dict[int, float]]()
        self.chances = dict[int, tuple[Floats, Floats]]()

    def forget(self, group: int) -> None:
        """Nothing: blocks do not remember."""

    def aim(self, group: int, error: Floats) -> None:
        """Draw vertices where errors (H,) of a group's histograms are large, from the next block on.

        One laser point at a corner may have nearly all of the error; it would get one in as many vertices as there
        are laser points.
        """
        by_laser = by_pixel = error
        if self.blocks.is_flood:
            by_laser = np.ones(len(self.blocks.groups[group].lasers))
        elif not self.blocks.is_confocal:
            table = error.reshape(len(self.blocks.groups[group].lasers), -1)
            by_laser, by_pixel = table.sum(axis=1), table.sum(axis=0)
        self.chances[group] = _chances(by_laser), _chances(by_pixel)

    def add(self, group: int, replicate: int, number: int, light: Floats32) -> float:
        """Add a block to the light (H, T + 2) of a group, in `unit`; its first and last column are what comes before
        and after the window. Returns the cost, in shadow rays.

        replicate, number : which block it is; each has random numbers of its own.
        """
        seed = LightStream.BLOCKS, self.blocks.problem.seed, group, min(self.last, 5)
        if group not in self.full:
            # Chances of pairs may not depend on the pairs that they choose. They follow a block that is not counted.
            measuring = _Block(self, group, np.random.default_rng([*seed, 0]), np.zeros_like(light), None)
            measuring.run(self.last)
            self.full[group] = measuring.full
        block = _Block(self, group, np.random.default_rng([*seed, 1, replicate, number]), light, self.full[group])
        block.run(self.last)
        return block.cost


class _Block:
    """One block at work.

    front, back : the ends. full : by order the guess from which on pairs are certain; a block that is given none
    measures it. cost : shadow rays so far.
    """

    def __init__(
        self, source: BlocksOf, group: int, rng: np.random.Generator, histogram: Floats32,
        full: dict[int, float] | None,
    ) -> None:  # fmt: skip
        self.blocks, self.group, self.scene = source.blocks, source.blocks.groups[group], source.blocks.scene
        self.caster, self.rng, self.histogram, self.cost = source.blocks.caster, rng, histogram, 0.0
        self.full, self.is_measuring = ({}, True) if full is None else (full, False)
        L, P = len(self.group.lasers), len(self.group.pixels)
        of_lasers, of_pixels = source.chances.get(group, (np.full(L, 1.0 / L), np.full(P, 1.0 / P)))
        self.front = rows_of(self.blocks.lasers, self.group.lasers)._replace(chance=of_lasers)
        # The sets of a pixel are a lattice with a shift of its own: evenly spread, and each point uniform.
        number = np.arange(FOV_SETS)
        lattice = np.stack([number, 3 * number % FOV_SETS], axis=1) / FOV_SETS
        uv = (rng.random((P, 1, 2)) + lattice) % 1.0
        self.back = self.blocks.fov_points(self.group.pixels, uv)._replace(chance=of_pixels)

    def run(self, last: int) -> None:
        """Add four bounces, or all orders from five to `last`."""
        # Both are drawn before either is lit, in the order of their random numbers.
        at_x, at_y = self.drawn(self.front), self.drawn(self.back)
        x, y = self.lit(self.front, at_x), self.lit(self.back, at_y)
        onward = VERTICES // 2
        some = np.arange(onward)
        on_from_x = rows_of(x, some)
        from_x = self.onward(self.front, on_from_x)
        if last == 4:
            # A path of four bounces has one x and one y: y is found from x, or x from y, or both are drawn.
            ys, landed = self.last_vertices(y, from_x)
            from_y = self.onward(self.back, rows_of(y, some))
            xs = joined_rows(x, self.lit(self.front, from_y))
            of_from_x = np.arange(VERTICES, len(ys.part))
            found = np.concatenate([some, landed, VERTICES + some]), np.append(of_from_x, some)
            self.join(4, onward, xs, VERTICES, ys, found)
            return
        # With more bounces the y found from x is the next x; those drawn stay the last vertices of all orders.
        x = on_from_x
        for order in range(5, last + 1):
            x = self.next(x, onward, from_x, order)
            if len(x.part) == 0:
                break
            onward, n = 1, len(x.part)
            from_x = self.onward(self.front, x)
            ys, landed = self.last_vertices(y, from_x)
            found = np.append(np.arange(n), landed), np.arange(VERTICES, len(ys.part))
            self.join(order, 1, x, n, ys, found)

    def drawn(self, ends: Ends) -> Vertices:
        """VERTICES vertices from the mixture of the BRDFs at some ends."""
        origin, normal, direction = np.empty((3, VERTICES, 3))
        found = _rays(self.scene, ends, self.rng.random((VERTICES, 3)), origin, normal, direction)
        return self.met(origin, normal, direction, found)

    def onward(self, ends: Ends, x: Lit) -> Vertices:
        """Where a BRDF ray from each vertex lands."""
        normal, direction = np.zeros((2, len(x.part), 3))
        found = _rays_onward(self.scene, ends, x, self.rng.random((len(x.part), 3)), normal, direction)
        return self.met(x.position, normal, direction, found)

    def met(self, origin: Floats, normal: Floats, direction: Floats, found: Bools) -> Vertices:
        """What rays that leave surfaces meet, those that were found."""
        hits = self.caster.leaving(origin, normal, direction)
        self.cost += len(direction)
        part = np.where(hits.valid & found, self.blocks.problem.scene.face_part[hits.face], -1).astype(np.int64)
        return Vertices(hits.position, hits.normal, part)

    def lit(self, ends: Ends, at: Vertices) -> Lit:
        """Vertices with the light of some ends."""
        x, n = Lit.dark(at, len(ends.chance)), len(at.part) * len(ends.chance)
        (origin, span), of = np.empty((2, n, 3), np.float32), np.empty(n, np.int64)
        rays = _light(self.scene, ends, x, origin, span, of)
        _without_hidden(x, ends.chance, self.hidden(origin[:rays], span[:rays]), of)
        return x

    def hidden(self, origin: Floats32, span: Floats32) -> Bools:
        """(n,) whether something stands on shadow rays in embree's frame."""
        self.cost += len(origin)
        return self.caster.occluded_scaled(origin, span) if len(origin) else np.zeros(0, np.bool_)

    def last_vertices(self, y: Lit, from_x: Vertices) -> tuple[Lit, Ints]:
        """Vertices y, those found from x, and once more those of the latter whose ray landed in a pixel; and which
        came once more."""
        row, landed = self.landed(from_x)
        return joined_rows(y, self.lit(self.back, from_x), landed), row

    def landed(self, y: Vertices) -> tuple[Ints, Lit]:
        """Which vertices have a cosine-distributed ray that lands in a pixel, and these, lit from where it landed."""
        problem, sensor = self.blocks.problem, self.blocks.problem.capture.sensor
        direction = cosine_directions(y.normal, self.rng.random((len(y.part), 2)))
        z = self.met(y.position, y.normal, direction, y.part >= 0)
        row, pixel, found = in_pixels(sensor, problem.cones, self.group.pixels, z.position, z.normal, z.part)
        # Elsewhere the share of this way is 0.
        some = np.flatnonzero(_landings(y, z, row, found.footprint))
        row, pixel, n = row[some], pixel[some], len(some)
        # No other way finds them: the mixture has no such vertex, and light from the pixel is that of this z alone.
        out = Lit.dark(rows_of(y, row), len(self.group.pixels))
        out = out._replace(came_from=direction[row], has_history=np.ones(n, np.bool_))
        if n:
            ends = self.blocks.ends_of(rows_of(found, some))._replace(chance=np.ones(1))
            unhidden = ~self.caster.occluded(sensor.position, ends.position + self.caster.offset_m * ends.normal)
            self.cost += n
            own, at = self.lit(ends, out.at), (np.arange(n), pixel)
            out.light[at], out.path[at] = own.light[:, 0] * unhidden, own.path[:, 0]
            out.density[at], out.landing[at] = own.density[:, 0], own.landing[:, 0]
        return row, out

    def next(self, x: Lit, onward: int, at: Vertices, order: int) -> Lit:
        """The vertices found from x as front vertices of paths of `order` bounces, with all light that they got."""
        y, power = Lit.dark(at, x.light.shape[1]), np.zeros(len(at.part))
        _carry(self.scene, self.front, x, float(onward), y, power)
        stays, light = power > 0, y.light
        if order > 5:
            chance = np.clip(power / np.maximum(np.abs(x.light).sum(axis=1), TINY), *SURVIVAL)
            stays &= self.rng.random(len(power)) < chance
            light /= chance[:, None].astype(np.float32)
        y = rows_of(y, np.flatnonzero(stays))
        # A path is counted by its weight alone from here on: its density is 1, on the side that the light came to.
        side = np.stack([(y.light < 0).any(axis=1), (y.light > 0).any(axis=1)], axis=1).astype(float)
        return y._replace(density=y.light, mixed=side, has_history=np.ones(len(side), np.bool_))

    def join(self, order: int, onward: int, x: Lit, n: int, y: Lit, found: tuple[Ints, Ints]) -> None:
        """Tallies chosen pairs of front vertices x and back vertices y, and the pairs that one found from the other.

        n : number of x that come from the mixture. found : vertices of the other pairs, which see each other.
        """
        values = self.scene.values
        sketches = (
            Sketch(x.position, x.normal, x.mixed, _brightness(values, x)),
            Sketch(y.position, y.normal, y.mixed, _brightness(values, y)),
        )
        # Vertices with a history come once each; of the others n were drawn from one mixture.
        draws, guess = float(VERTICES if x.has_history[0] else n * VERTICES), np.empty((n, VERTICES), np.float32)
        total = _guesses(*sketches, draws, float(onward), guess)
        ends = x.light.shape[1] + y.light.shape[1]
        wanted = max(PAIRS * VERTICES, ends * VERTICES // 2) // (1 if order == 4 else 4)
        full = self.guess_of_certain_pairs(order, total / wanted)
        # The measuring block may have met hardly any light: then all pairs are certain.
        most = int(min(total / full, n * VERTICES)) + 2
        pairs, (origin, span) = np.empty((2, most), np.int64), np.empty((2, most, 3), np.float32)
        k = _chosen(self.scene, *sketches, guess, full, self.rng.random(), pairs, origin, span)
        hidden = np.concatenate([self.hidden(origin[:k], span[:k]), np.zeros(len(found[0]), np.bool_)])
        self.cost += ADDED * len(hidden) * len(self.histogram)
        odds = Odds(draws, float(onward), full, draws * wanted / (n * VERTICES))
        pairs, blocks = np.hstack([pairs[:, :k], found]), self.blocks
        stride = -1 if blocks.is_confocal else 0 if blocks.is_flood else y.light.shape[1]
        bins = Bins(blocks.per_metre, blocks.start, stride)
        _tally(self.scene, bins, self.front, self.back, x, y, sketches, odds, pairs, hidden, self.histogram)

    def guess_of_certain_pairs(self, order: int, here: float) -> float:
        """The guess from which on pairs are certain for `order`; `here` is what suits this block."""
        if self.is_measuring:
            self.full[order] = max(here, TINY)
        # Orders that the measuring block did not get to are fainter than the last that it did.
        return self.full.get(order) or min(self.full.values(), default=TINY)
