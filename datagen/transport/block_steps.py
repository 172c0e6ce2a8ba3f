"""The compiled steps of `blocks.py`: rays from ends and from vertices, the light of ends at vertices, the choice of
pairs of vertices, and their light in the histograms of all pairs of ends.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from datagen.compiled import compiled
from datagen.records.arrays import Bools, Floats, Ints
from datagen.transport.brdf import LAMBERTIAN, dot, evaluate, pdf, sample
from datagen.transport.effort import Floats32
from datagen.transport.geometry import TINY, get, put
from datagen.transport.rays import lifted_and_scaled, write_shadow_ray

NEAREST = 1e-9
"""Legs shorter than this, relative to the scene's half extent, carry no light: rounding decides about them."""


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


class LitVertices(NamedTuple):
    """n vertices, and their light from N ends. Numbers with a sign are positive on the side of the normal.

    position, normal, part : as in `Vertices`.
    light : (n, N) f cosθ cosθ′ V / R² times the end's gain, over the density of the vertex if it has a history.
    path : (n, N) length from the device, m.
    density : (n, N) 1/m², with which the end's BRDF draws the vertex. mixed : (n, 2) mean of it over the ends, by
    their chances, for the back (0) and the front side (1).
    landing : (n, N) t of the FoV point, see the top of `blocks.py`; 0 if t ≤ 1, and for laser points.
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
    def dark(cls, at: Vertices, ends: int) -> LitVertices:
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
    """What a guess of the light of pairs knows of n vertices.

    position, normal, mixed : as in `LitVertices`. bright : (n, 2) the light that they send on to either side, about.
    """

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


@compiled()
def _toward(a, b):  # type: ignore[no-untyped-def]
    """Unit vector from a to b, and the distance."""
    v = (b[0] - a[0], b[1] - a[1], b[2] - a[2])
    r = math.sqrt(dot(v, v))
    return (v[0] / max(r, TINY), v[1] / max(r, TINY), v[2] / max(r, TINY)), r


@compiled()
def _row_of_end(ends, e, i):  # type: ignore[no-untyped-def]
    """Row of the end that vertex i meets for laser point or pixel e: one of set i, modulo the number of sets."""
    return e + i % (len(ends.part) // len(ends.chance)) * len(ends.chance)


@compiled()
def rays_from_ends(scene, ends, u, origin, normal, direction):  # type: ignore[no-untyped-def]
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
        e = _row_of_end(ends, e, i)
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
def rays_onward(scene, ends, x, u, normal, direction):  # type: ignore[no-untyped-def]
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
            a = _toward(get(x.position, i, 0), get(ends.position, _row_of_end(ends, e, i), 0))[0]
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
def landings(y, z, row, area):  # type: ignore[no-untyped-def]
    """(k,) `_landing` for some rows of vertices y and of the places z where their rays landed; area : (k, 1)."""
    out = np.empty(len(row))
    for k in range(len(row)):
        v, r = _toward(get(y.position, row[k], 0), get(z.position, row[k], 0))
        up, down = -dot(get(z.normal, row[k], 0), v), dot(get(y.normal, row[k], 0), v)
        out[k] = _landing(area[k, 0], up, down, max(r, TINY))
    return out


@compiled()
def set_light(scene, ends, x, origin, span, of):  # type: ignore[no-untyped-def]
    """Lights dark vertices x as if nothing stood between, and sets shadow rays for legs that may carry light; returns
    their number.

    origin, span : (n N, 3) rays in embree's frame. of : (n N,) index of each ray's leg.
    """
    rays, count = 0, x.light.shape[1]
    for i in range(len(x.part)):
        p, n = get(x.position, i, 0), get(x.normal, i, 0)
        for h in range(count):
            e = _row_of_end(ends, h, i)
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
def remove_hidden(x, chance, hidden, of):  # type: ignore[no-untyped-def]
    """Takes hidden legs out, and sets the mean density by side."""
    for k in range(len(hidden)):
        if hidden[k]:
            i, h = of[k] // x.light.shape[1], of[k] % x.light.shape[1]
            x.light[i, h] = x.density[i, h] = 0.0
    for i in range(len(x.mixed)):
        for h in range(x.light.shape[1]):
            x.mixed[i, 1 if x.density[i, h] > 0 else 0] += chance[h] * abs(x.density[i, h])


@compiled()
def _set_light_toward(scene, ends, x, i, v, side, out):  # type: ignore[no-untyped-def]
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
            a = _toward(get(x.position, i, 0), get(ends.position, _row_of_end(ends, e, i), 0))[0]
            out[e] = abs(x.light[i, e]) * evaluate(k, row, n, a, v)
            density += ends.chance[e] * abs(x.density[i, e]) * pdf(k, row, n, a, v)
    return density


@compiled()
def _light_of_lambertian(kind, values, part, light):  # type: ignore[no-untyped-def]
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
def brightness(values, x):  # type: ignore[no-untyped-def]
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
def set_guesses(x, y, draws, onward, out):  # type: ignore[no-untyped-def]
    """Sets out (n, m) to the guesses of all pairs of sketches, and returns their sum."""
    total = 0.0
    for i in range(out.shape[0]):
        for j in range(out.shape[1]):
            out[i, j] = _guess(x, y, i, j, draws, onward)
            total += out[i, j]
    return total


@compiled()
def choose_pairs(scene, x, y, guess, full, u, pairs, origin, span):  # type: ignore[no-untyped-def]
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
def _add_light(of_x, of_y, time_x, time_y, g, between, stride, light, place, histogram):  # type: ignore[no-untyped-def]
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
def _set_share_of_way(y, chance, j, onward, rest, light, out):  # type: ignore[no-untyped-def]
    """Sets out (N,) to the share of the light (N,) of vertex y[j] that is for its way, land or another.

    chance : of the ends. onward, rest : N and what is before chance_z in the formula at the top of `blocks.py`.
    """
    for h in range(len(out)):
        out[h], t = light[h], y.landing[j, h]
        if t > 0.0:
            land = onward * (t - 1.0) / max(onward * t + rest * chance[h] * abs(y.density[j, h]), TINY)
            out[h] *= land / t if y.has_history[j] else 1.0 - land


@compiled()
def tally(scene, bins, front, back, x, y, sketches, odds, pairs, hidden, histogram):  # type: ignore[no-untyped-def]
    """Adds the light of all pairs of ends, `front` and `back`, by way of pairs of vertices (2, k), of which some are
    hidden (k,) from each other, to the histogram (H, T + 2)."""
    N, M, onward = x.light.shape[1], y.light.shape[1], odds.onward
    own_x, own_y = np.empty(N, np.float32), np.empty(M, np.float32)
    light, place = np.empty(max(N, M), np.float32), np.empty(max(N, M), np.int32)
    time_x, time_y = x.path * np.float32(bins.per_metre), y.path * np.float32(bins.per_metre)
    sent_x, simple_x = _light_of_lambertian(scene.kind, scene.values, x.part, x.light)
    sent_y, simple_y = _light_of_lambertian(scene.kind, scene.values, y.part, y.light)
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
            onto_y, from_x = _set_light_toward(scene, front, x, i, v, side_x, own_x), own_x
        if not simple_y[j]:
            onto_x, from_y = _set_light_toward(scene, back, y, j, (-v[0], -v[1], -v[2]), side_y, own_y), own_y
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
                _set_share_of_way(y, back.chance, j, rays * onto_y * abs(down), rest, from_y, own_y)
                from_y = own_y
            g = np.float32(abs(up * down) / r**2 * math.exp(-scene.air * r) / expected)
            # One more bin, as the first column is what comes before the window.
            between = np.float32(r * bins.per_metre - bins.start + 1.0)
            _add_light(from_x, from_y, time_x[i], time_y[j], g, between, bins.stride, light, place, histogram)


@compiled()
def carry(scene, ends, x, onward, y, power):  # type: ignore[no-untyped-def]
    """Lights dark vertices y, at the end of one ray from each x, over the density of drawing them and their number;
    sets power (n,) to the sum of their light."""
    sent = np.empty(y.light.shape[1], np.float32)
    for i in range(len(y.part)):
        # The ray met nothing, or there was none.
        if y.part[i] < 0:
            continue
        v, r = _toward(get(x.position, i, 0), get(y.position, i, 0))
        up, down = dot(get(x.normal, i, 0), v), -dot(get(y.normal, i, 0), v)
        density = onward * _set_light_toward(scene, ends, x, i, v, 1 if up > 0 else 0, sent)
        if density > 0:
            for e in range(len(sent)):
                y.light[i, e] = math.copysign(sent[e] * abs(up) * math.exp(-scene.air * r) / density, down)
                y.path[i, e] = x.path[i, e] + r
                power[i] += abs(y.light[i, e])
            put(y.came_from, i, 0, (-v[0], -v[1], -v[2]))
