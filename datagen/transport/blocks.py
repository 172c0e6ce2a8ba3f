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
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from datagen.compiled import compiled
from datagen.records.arrays import Bools, Floats, Ints
from datagen.seeding import LightStream
from datagen.transport.brdf import LAMBERTIAN, cosine_directions, dot, evaluate, pdf, sample
from datagen.transport.effort import REPLICATES
from datagen.transport.fields_of_view import FovPool, fov_points, in_pixels
from datagen.transport.geometry import get
from datagen.transport.problem import Problem
from datagen.transport.rays import lifted_and_scaled
from datagen.units import path_from_time

VERTICES = 128
"""F: front vertices, and back vertices, of a block. More share the cost of legs worse, fewer that of pairs."""
ONWARD = VERTICES // 2
"""n: vertices of either kind from which a BRDF ray goes on."""
FOV_SETS = 8
"""Independent FoV points of each pixel in a block; vertex i meets those of set i mod 8."""
LATTICE = np.stack([np.arange(FOV_SETS), 3 * np.arange(FOV_SETS) % FOV_SETS], axis=1) / FOV_SETS
"""(FOV_SETS, 2) where the FoV points of a pixel lie to one another."""
GROUP = {"confocal": 32, "exhaustive": 64}
"""Most laser points, and most pixels, of a group: a vertex is bright for neighbours alike."""
PAIRS = 8
"""Pairs of vertices kept in a block, in units of F, where a group has few laser points and pixels."""
EVENLY = 0.5
"""Share of the vertices that are drawn for all laser points and pixels alike."""
SURVIVAL = (0.05, 0.95)
"""Least and greatest chance of a path to survive Russian roulette after each bounce beyond the fifth."""
LONGEST = 400
"""Bounces at which paths end that have no limit: a path survives so many once in 10⁹."""
FAST = {"reassoc", "contract", "arcp", "nsz"}
"""What LLVM may do to sums and products in loops over ends and pairs: they become vector instructions."""
NEAREST = 1e-9
"""Legs shorter than this, relative to the scene's half extent, carry no light: rounding decides about them."""

ADDED = 0.02
"""Cost of adding light to a bin, in shadow rays."""
PILOT = 64
"""Fewest blocks of a pilot, over all groups and replicates."""
DARK = 1e-300
"""Least guess that is divided by."""

Floats32 = NDArray[np.float32]


class Ends(NamedTuple):
    """Where paths begin or end: the laser points of a group, or FoV points of its pixels, FOV_SETS sets one after the
    other.

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

    def take(self, which: Ints, chance: Floats) -> Ends:
        """Some of the ends, with chances of their own."""
        return Ends(
            self.position[which], self.normal[which], self.back[which], self.part[which], self.gain[which],
            self.leg[which], self.area[which], chance,
        )  # fmt: skip


class Vertices(NamedTuple):
    """n vertices. position, normal : (n, 3). part : (n,) index, −1 for none."""

    position: Floats
    normal: Floats
    part: Ints


class Legs(NamedTuple):
    """Light from N ends at n vertices. Numbers with a sign have that of the vertex's side: + for its normal's.

    light : (n, N) f cosθ cosθ′ V / R² times the end's gain, over the density of the vertex if it has a history.
    path : (n, N) length from the device, m.
    density : (n, N) 1/m², with which the end's BRDF draws the vertex. mixed : (n, 2) mean of it over the ends, by
    their chances, for the back (0) and the front side (1).
    landing : (n, N) t of the FoV point, see the top of this file; 0 if t ≤ 1, and for
    laser points.
    came_from : (n, 3) direction that all light comes from, and has_history : (n,) whether this is so: for vertices
    that were found from other vertices, or whose ray landed in a pixel.
    """

    light: Floats32
    path: Floats32
    density: Floats32
    landing: Floats32
    mixed: Floats
    came_from: Floats
    has_history: Bools


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
    return (v[0] / max(r, 1e-300), v[1] / max(r, 1e-300), v[2] / max(r, 1e-300)), r


@compiled()
def _rays(kind, values, ends, count, u, origin, normal, direction):  # type: ignore[no-untyped-def]
    """BRDF rays from random ends of the group, ray i from set i of FoV points; returns which exist.

    count : number of laser points or pixels. u : (n, 3) random numbers.
    """
    found = np.zeros(len(u), np.bool_)
    for i in range(len(u)):
        e, run = 0, ends.chance[0]
        while run < u[i, 0] and e < count - 1:
            e += 1
            run += ends.chance[e]
        e += i % (len(ends.part) // count) * count
        found[i] = ends.part[e] >= 0 and ends.gain[e] > 0.0
        w = (0.0, 0.0, 1.0)
        if found[i]:
            k = ends.part[e]
            w = sample(kind[k], values[k], get(ends.normal, e, 0), get(ends.back, e, 0), u[i, 1], u[i, 2])
        for c in range(3):
            origin[i, c], normal[i, c], direction[i, c] = ends.position[e, c], ends.normal[e, c], w[c]
    return found


@compiled()
def _rays_onward(kind, values, ends, x, legs, u, normal, direction):  # type: ignore[no-untyped-def]
    """BRDF rays on from vertices, of light from an end that is chosen by its share of the mixture; returns which
    exist."""
    found, count = np.zeros(len(u), np.bool_), legs.density.shape[1]
    for i in range(len(u)):
        direction[i, 2] = 1.0
        wanted = u[i, 2] * (legs.mixed[i, 0] + legs.mixed[i, 1])
        if x.part[i] < 0 or wanted <= 0.0:
            continue
        n, a = get(x.normal, i, 0), get(legs.came_from, i, 0)
        if not legs.has_history[i]:
            e, run = -1, 0.0
            for j in range(count):
                run += ends.chance[j] * abs(legs.density[i, j])
                if legs.density[i, j] != 0.0:
                    e = j
                    if run >= wanted:
                        break
            a = _toward(get(x.position, i, 0), get(ends.position, e + i % (len(ends.part) // count) * count, 0))[0]
        if dot(n, a) < 0:
            n = (-n[0], -n[1], -n[2])
        w = sample(kind[x.part[i]], values[x.part[i]], n, a, u[i, 0], u[i, 1])
        found[i] = dot(w, n) > 0
        for c in range(3):
            direction[i, c], normal[i, c] = w[c], n[c]
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
        out[k] = _landing(area[k, 0], up, down, max(r, DARK))
    return out


@compiled()
def _legs(kind, values, air, ends, x, offset, frame, light, path, density, landing, origin, span, of):  # type: ignore[no-untyped-def]
    """Legs as if nothing stood between, and shadow rays for those that may carry light; returns their number.

    origin, span : rays in embree's frame. of : index of each ray's leg.
    """
    rays, count = 0, light.shape[1]
    for i in range(len(x.part)):
        p, n = get(x.position, i, 0), get(x.normal, i, 0)
        for h in range(count):
            e = h + i % (len(ends.part) // count) * count
            light[i, h] = density[i, h] = path[i, h] = landing[i, h] = 0.0
            if x.part[i] < 0 or ends.part[e] < 0 or ends.gain[e] <= 0.0:
                continue
            q, m = get(ends.position, e, 0), get(ends.normal, e, 0)
            v, r = _toward(q, p)
            up, down = dot(m, v), -dot(n, v)
            if up <= 0.0 or down == 0.0 or r < NEAREST * frame[3]:
                continue
            k, row, back = kind[ends.part[e]], values[ends.part[e]], get(ends.back, e, 0)
            light[i, h] = evaluate(k, row, m, back, v) * up * down / r**2 * ends.gain[e] * math.exp(-air * r)
            landing[i, h] = _landing(ends.area[e], up, down, r)
            density[i, h] = pdf(k, row, m, back, v) * down / r**2
            path[i, h] = r + ends.leg[e]
            if density[i, h] != 0.0 or light[i, h] != 0.0:
                a = lifted_and_scaled(p, n, math.copysign(offset, down), frame)
                b = lifted_and_scaled(q, m, offset, frame)
                for c in range(3):
                    origin[rays, c], span[rays, c] = a[c], b[c] - a[c]
                of[rays] = i * count + h
                rays += 1
    return rays


@compiled()
def _without_hidden(light, density, chance, hidden, of, mixed):  # type: ignore[no-untyped-def]
    """Takes hidden legs out, and sets the mean density by side."""
    for k in range(len(hidden)):
        if hidden[k]:
            i, h = of[k] // light.shape[1], of[k] % light.shape[1]
            light[i, h] = density[i, h] = 0.0
    for i in range(len(mixed)):
        for h in range(light.shape[1]):
            mixed[i, 1 if density[i, h] > 0 else 0] += chance[h] * abs(density[i, h])


@compiled()
def _sent_toward(kind, values, ends, x, legs, i, v, side, out):  # type: ignore[no-untyped-def]
    """Sets out (N,) to each end's light times the BRDF of vertex i towards v, and returns the mixture's density there
    times that of going on so, 1/(m² sr)."""
    n, k, row, count, density = get(x.normal, i, 0), kind[x.part[i]], values[x.part[i]], len(out), 0.0
    if side == 0:
        n = (-n[0], -n[1], -n[2])
    if legs.has_history[i]:
        a = get(legs.came_from, i, 0)
        on_this_side = dot(n, a) > 0
        f = evaluate(k, row, n, a, v) if on_this_side else 0.0
        for e in range(count):
            out[e] = abs(legs.light[i, e]) * f
        return pdf(k, row, n, a, v) if on_this_side else 0.0
    for e in range(count):
        out[e] = 0.0
        if (legs.density[i, e] > 0) == (side == 1) and legs.density[i, e] != 0.0:
            end = e + i % (len(ends.part) // count) * count
            a = _toward(get(x.position, i, 0), get(ends.position, end, 0))[0]
            out[e] = abs(legs.light[i, e]) * evaluate(k, row, n, a, v)
            density += ends.chance[e] * abs(legs.density[i, e]) * pdf(k, row, n, a, v)
    return density


@compiled(fastmath=FAST)
def _sent_by_lambertian(kind, values, x, legs):  # type: ignore[no-untyped-def]
    """(n, 2, N) light that Lambertian vertices send on to either side; and (n,) whether a vertex is Lambertian."""
    light, part = legs.light, x.part
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
def _brightness(values, x, legs):  # type: ignore[no-untyped-def]
    """(n, 2) root mean square over the ends of the light that vertices send on to either side, as if Lambertian."""
    out = np.zeros((len(x.part), 2))
    for i in range(len(x.part)):
        if x.part[i] >= 0:
            for e in range(legs.light.shape[1]):
                out[i, 1 if legs.light[i, e] > 0 else 0] += np.float64(legs.light[i, e]) ** 2
            for k in range(2):
                out[i, k] = math.sqrt(out[i, k] / legs.light.shape[1]) * values[x.part[i], 0] / math.pi
    return out


@compiled()
def _guess(x, n, y, m, of_x, of_y, mixed_x, mixed_y, i, j, draws, onward):  # type: ignore[no-untyped-def]
    """About the light of the pair of vertices x[i], y[j] over the number of its draws, as if both were Lambertian and
    saw each other."""
    v0, v1, v2 = y[j, 0] - x[i, 0], y[j, 1] - x[i, 1], y[j, 2] - x[i, 2]
    up = n[i, 0] * v0 + n[i, 1] * v1 + n[i, 2] * v2
    down = -(m[j, 0] * v0 + m[j, 1] * v1 + m[j, 2] * v2)
    side_x, side_y = 1 if up > 0 else 0, 1 if down > 0 else 0
    r2 = v0 * v0 + v1 * v1 + v2 * v2
    c = abs(up * down) / (r2 * r2 + 1e-30)
    light = of_x[i, side_x] * of_y[j, side_y]
    expected = draws * (mixed_x[i, 0] + mixed_x[i, 1]) * (mixed_y[j, 0] + mixed_y[j, 1])
    expected += onward * c / math.pi * (mixed_x[i, side_x] + mixed_y[j, side_y])
    return light * c / expected if light > 0.0 else 0.0


@compiled(fastmath=FAST)
def _guesses(x, y, of_x, of_y, mixed_x, mixed_y, draws, onward, out):  # type: ignore[no-untyped-def]
    """Sets out (n, m) to the guesses of all pairs, and returns their sum."""
    total, px, nx, py, ny = 0.0, x.position, x.normal, y.position, y.normal
    for i in range(out.shape[0]):
        for j in range(out.shape[1]):
            out[i, j] = _guess(px, nx, py, ny, of_x, of_y, mixed_x, mixed_y, i, j, draws, onward)
            total += out[i, j]
    return total


@compiled()
def _chosen(x, y, guess, full, u, offset, frame, a, b, origin, span):  # type: ignore[no-untyped-def]
    """Systematic choice of pairs with chances min(guess / full, 1), and their shadow rays; returns their number.

    a, b : set to the vertices of each pair. u : a random number.
    """
    count, run = 0, u
    for i in range(guess.shape[0]):
        for j in range(guess.shape[1]):
            run += min(guess[i, j] / full, 1.0)
            if run >= 1.0:
                run -= 1.0
                p, q, n, m = get(x.position, i, 0), get(y.position, j, 0), get(x.normal, i, 0), get(y.normal, j, 0)
                v = _toward(p, q)[0]
                p = lifted_and_scaled(p, n, math.copysign(offset, dot(n, v)), frame)
                q = lifted_and_scaled(q, m, math.copysign(offset, -dot(m, v)), frame)
                for c in range(3):
                    origin[count, c], span[count, c] = p[c], q[c] - p[c]
                a[count], b[count] = i, j
                count += 1
    return count


@compiled(fastmath=FAST)
def _spread(of_x, of_y, time_x, time_y, g, between, stride, light, place, histogram):  # type: ignore[no-untyped-def]
    """Adds the light of_x · of_y · g of every pair of ends to the bin of its arrival.

    The first column of the histogram is what comes before the window, the last what comes after. stride : rows from
    one laser point to the next, 0 where pixel i looks at laser point i. light, place : room for N values.
    """
    last = np.float32(histogram.shape[1] - 1)
    if stride == 0:
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
def _shared(legs, chance, j, onward, rest, light, out):  # type: ignore[no-untyped-def]
    """Sets out (N,) to the share of the light (N,) of vertex y[j] that is for its way, land or another.

    chance : of the ends. onward, rest : N and what is before chance_z in the formula at the top of this file.
    """
    for h in range(len(out)):
        out[h], t = light[h], legs.landing[j, h]
        if t > 0.0:
            land = onward * (t - 1.0) / max(onward * t + rest * chance[h] * abs(legs.density[j, h]), DARK)
            out[h] *= land / t if legs.has_history[j] else 1.0 - land


@compiled()
def _tally(  # type: ignore[no-untyped-def]
    kind, values, clock, front, back, x, y, of_x, of_y, draws, onward, full, evenly, a, b, hidden, stride, histogram
):  # fmt: skip
    """Adds the light of all pairs of ends by way of the vertices x[a], y[b].

    clock : bins for each metre, first bin, attenuation. front, back : the ends. of_x, of_y : legs and brightness.
    draws : of a pair by the way of pairs. onward : rays on from vertices. full : guess of pairs that are certain.
    evenly : times that a pair would be chosen, for Q(x) Q(y) = 1, if all had the same chance.
    """
    (legs_x, bright_x), (legs_y, bright_y), (per, start, air) = of_x, of_y, clock
    own_x, own_y = np.empty(legs_x.light.shape[1], np.float32), np.empty(legs_y.light.shape[1], np.float32)
    light, place = np.empty(max(len(own_x), len(own_y)), np.float32), np.empty(max(len(own_x), len(own_y)), np.int32)
    time_x, time_y = legs_x.path * np.float32(per), legs_y.path * np.float32(per)
    sent_x, simple_x = _sent_by_lambertian(kind, values, x, legs_x)
    sent_y, simple_y = _sent_by_lambertian(kind, values, y, legs_y)
    px, nx, py, ny, mixed_x, mixed_y = x.position, x.normal, y.position, y.normal, legs_x.mixed, legs_y.mixed
    touches = np.array([row.max() > 0.0 for row in legs_y.landing])
    for k in range(len(a)):
        i, j = a[k], b[k]
        if hidden[k] or x.part[i] < 0 or y.part[j] < 0:
            continue
        v, r = _toward(get(px, i, 0), get(py, j, 0))
        up, down = dot(get(nx, i, 0), v), -dot(get(ny, j, 0), v)
        side_x, side_y = 1 if up > 0 else 0, 1 if down > 0 else 0
        chance = _guess(px, nx, py, ny, bright_x, bright_y, mixed_x, mixed_y, i, j, draws, onward) / full
        onto_y, onto_x = abs(up) / math.pi * mixed_x[i, side_x], abs(down) / math.pi * mixed_y[j, side_y]
        from_x, from_y = sent_x[i, side_x], sent_y[j, side_y]
        if not simple_x[i]:
            onto_y, from_x = _sent_toward(kind, values, front, x, legs_x, i, v, side_x, own_x), own_x
        if not simple_y[j]:
            w = (-v[0], -v[1], -v[2])
            onto_x, from_y = _sent_toward(kind, values, back, y, legs_y, j, w, side_y, own_y), own_y
        expected = min(chance, 1.0) * draws * (mixed_x[i, 0] + mixed_x[i, 1]) * (mixed_y[j, 0] + mixed_y[j, 1])
        # A vertex x with a history was not found from y, and no x was found from a y whose ray landed.
        back_way = 0.0 if legs_x.has_history[i] or legs_y.has_history[j] else onto_x * abs(up)
        rays = onward / max(r, 1e-300) ** 2
        expected += rays * (onto_y * abs(down) + back_way)
        if expected > 0.0:
            if touches[j]:
                rest = evenly * (mixed_x[i, 0] + mixed_x[i, 1])
                if not legs_x.has_history[i]:
                    rest += rays * abs(up * down) / math.pi
                _shared(legs_y, back.chance, j, rays * onto_y * abs(down), rest, from_y, own_y)
                from_y = own_y
            g = np.float32(abs(up * down) / r**2 * math.exp(-air * r) / expected)
            # One more bin, as the first column is what comes before the window.
            between = np.float32(r * per - start + 1.0)
            _spread(from_x, from_y, time_x[i], time_y[j], g, between, stride, light, place, histogram)


@compiled()
def _carried(kind, values, air, ends, x, legs, onward, y, light, path, came_from, power):  # type: ignore[no-untyped-def]
    """Sets what arrives at y, at the end of one ray from each x, over the density of drawing it and its number."""
    sent = np.empty(light.shape[1], np.float32)
    for i in range(len(y.part)):
        if y.part[i] < 0:
            continue
        v, r = _toward(get(x.position, i, 0), get(y.position, i, 0))
        up, down = dot(get(x.normal, i, 0), v), -dot(get(y.normal, i, 0), v)
        density = onward * _sent_toward(kind, values, ends, x, legs, i, v, 1 if up > 0 else 0, sent)
        if density > 0:
            for e in range(len(sent)):
                light[i, e] = math.copysign(sent[e] * abs(up) * math.exp(-air * r) / density, down)
                path[i, e] = legs.path[i, e] + r
                power[i] += abs(light[i, e])
            for c in range(3):
                came_from[i, c] = -v[c]


def _rows(record: Any, which: Ints) -> Any:
    """Some rows of a record of arrays."""
    return type(record)(*(np.ascontiguousarray(values[which]) for values in record))


def _joined(*records: Any) -> Any:
    """The rows of records of arrays, one after the other."""
    return type(records[0])(*(np.concatenate(arrays) for arrays in zip(*records, strict=True)))


def _chances(error: Floats) -> Floats:
    """Chances in proportion to errors, but for a share that is even: where an error is far too low, an end still
    weighs at most 1 / `EVENLY` times as much as without aim."""
    even = np.full(len(error), 1.0 / len(error))
    total = float(error.sum())
    return EVENLY * even + (1 - EVENLY) * (error / total if total > 0 else even)


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
    """The blocks of a problem.

    groups : of neighbouring laser points and pixels; each pair of the capture is in one of them.
    unit : photons that light in blocks is a multiple of, so that single precision has room for it.
    """

    def __init__(self, problem: Problem) -> None:
        self.problem, self.caster, capture = problem, problem.caster, problem.capture
        self.kind, self.values = problem.materials.kind.astype(np.int64), problem.materials.values
        self.air, points, P = float(problem.scene.attenuation_per_m), problem.points, len(capture.sensor.pixels)
        self.frame = (*self.caster.center, self.caster.half_extent_m)
        axis, per = capture.time, 1.0 / float(path_from_time(capture.time.width_s))
        self.clock = (per, axis.start_s / axis.width_s, self.air)
        exists = points.part >= 0
        leg = np.where(exists, points.leg, 0.0)
        self.lasers = Ends(
            np.where(exists[:, None], points.position, 0.0), points.normal, points.to_laser, points.part,
            np.where(exists, np.exp(-self.air * leg), 0.0), leg * (axis.origin == "source"), np.zeros(len(leg)),
            np.empty(0),
        )  # fmt: skip
        middle = self.fov_points(np.arange(P), np.full((P, 1, 2), 0.5), 1.0)
        self.unit = float(middle.gain.max()) or 1.0
        size = GROUP[capture.pairing]
        of_lasers = _neighbours(self.lasers.position, size)
        if capture.pairing == "confocal":
            self.groups = [Group(some, some, some) for some in of_lasers]
        else:
            self.groups = [
                Group(some, pixels, (some[:, None] * P + pixels).ravel())
                for pixels in _neighbours(middle.position, size)
                for some in of_lasers
            ]
        self._full = dict[tuple[int, int], dict[int, float]]()
        self._chances = dict[tuple[int, int], tuple[Floats, Floats]]()

    def fov_points(self, pixels: Ints, uv: Floats, unit: float) -> Ends:
        """FoV points at coordinates uv (P, Q, 2) of the quadrilaterals of some pixels, set after set."""
        problem = self.problem
        found = fov_points(self.caster, problem.scene, problem.capture.sensor, problem.cones, pixels, uv, 1)
        return self._ends(found, unit)

    def _ends(self, found: FovPool, unit: float) -> Ends:
        """FoV points as ends of paths, set after set; gains in `unit`."""

        def in_sets(values: NDArray[Any]) -> NDArray[Any]:
            return np.ascontiguousarray(values.swapaxes(0, 1)).reshape(-1, *values.shape[2:])

        leg = np.where(found.part >= 0, found.last_leg, 0.0)
        gain = np.where(found.part >= 0, found.weight * np.exp(-self.air * leg) / unit, 0.0)
        leg *= self.problem.capture.time.origin == "source"
        back = np.broadcast_to(found.to_sensor, found.position.shape)
        return Ends(
            in_sets(found.position), in_sets(found.normal), in_sets(back), in_sets(found.part), in_sets(gain),
            in_sets(leg), in_sets(found.footprint), np.empty(0),
        )  # fmt: skip

    def add(self, group: int, replicate: int, number: int, last: int, histogram: Floats32) -> float:
        """Add a block of four bounces, or of all orders from five to `last`, to the histograms of a group.

        replicate, number : which block it is; each has random numbers of its own. histogram : (H, T + 2) photons in
        units of `unit`; the first and last column are what comes before and after the window. Returns the cost, in
        shadow rays.
        """
        key, seed = (group, min(last, 5)), (LightStream.BLOCKS, self.problem.seed, group, min(last, 5))
        if key not in self._full:
            # Chances of pairs may not depend on the pairs that they choose. They follow a block that is not counted.
            work = _Work(np.random.default_rng([*seed, 0]), {}, True, np.zeros_like(histogram))
            self._block(group, last, work)
            self._full[key] = work.full
        work = _Work(np.random.default_rng([*seed, 1, replicate, number]), self._full[key], False, histogram)
        self._block(group, last, work)
        return work.cost

    def aim(self, group: int, last: int, error: Floats) -> None:
        """Draw vertices for the laser points and pixels whose histograms err most, from the next block on.

        error : (H,) errors of the group's histograms. One laser point at a corner may have nearly all of the error;
        it would get one in as many vertices as there are laser points.
        """
        by_laser = by_pixel = error
        if self.problem.capture.pairing != "confocal":
            table = error.reshape(len(self.groups[group].lasers), -1)
            by_laser, by_pixel = table.sum(axis=1), table.sum(axis=0)
        self._chances[group, min(last, 5)] = _chances(by_laser), _chances(by_pixel)

    def _block(self, group: int, last: int, work: _Work) -> None:
        lasers, pixels, _ = self.groups[group]
        rng, L, P = work.rng, len(lasers), len(pixels)
        even = np.full(L, 1.0 / L), np.full(P, 1.0 / P)
        of_lasers, of_pixels = self._chances.get((group, min(last, 5)), even)
        front = self.lasers.take(lasers, of_lasers)
        # The sets of a pixel are a lattice with a shift of its own: evenly spread, and each point uniform.
        uv = (rng.random((P, 1, 2)) + LATTICE) % 1.0
        back = self.fov_points(pixels, uv, self.unit)._replace(chance=of_pixels)
        x, y = self._drawn(front, L, work), self._drawn(back, P, work)
        of_x, of_y = self._legs(front, L, x, work), self._legs(back, P, y, work)
        some = np.arange(ONWARD)
        x_on, of_x_on = _rows(x, some), _rows(of_x, some)
        from_x = self._onward(front, x_on, of_x_on, work)
        if last == 4:
            ys, of_ys, landed = self._last_vertices(back, pixels, y, of_y, from_x, work)
            from_y = self._onward(back, _rows(y, some), _rows(of_y, some), work)
            xs, of_xs = _joined(x, from_y), _joined(of_x, self._legs(front, L, from_y, work))
            of_from_x = np.arange(VERTICES, len(ys.part))
            found = np.concatenate([some, landed, VERTICES + some]), np.append(of_from_x, some)
            self._join(4, ONWARD, (front, xs, of_xs, VERTICES), (back, ys, of_ys, VERTICES), found, work)
            return
        x, of_x, onward = x_on, of_x_on, ONWARD
        for order in range(5, last + 1):
            x, of_x = self._next(front, x, of_x, onward, from_x, order, work)
            if len(x.part) == 0:
                break
            onward, n = 1, len(x.part)
            from_x = self._onward(front, x, of_x, work)
            ys, of_ys, landed = self._last_vertices(back, pixels, y, of_y, from_x, work)
            found = np.append(np.arange(n), landed), np.arange(VERTICES, len(ys.part))
            self._join(order, 1, (front, x, of_x, n), (back, ys, of_ys, VERTICES), found, work)

    def _next(
        self, ends: Ends, x: Vertices, legs: Legs, onward: int, y: Vertices, order: int, work: _Work
    ) -> tuple[Vertices, Legs]:
        """The vertices y found from x as front vertices of paths of `order` bounces, with all light that they got."""
        n, count = legs.light.shape
        light, path = np.zeros((n, count), np.float32), np.zeros((n, count), np.float32)
        came_from, power = np.zeros((n, 3)), np.zeros(n)
        _carried(self.kind, self.values, self.air, ends, x, legs, float(onward), y, light, path, came_from, power)
        stays = power > 0
        if order > 5:
            chance = np.clip(power / np.maximum(np.abs(legs.light).sum(axis=1), 1e-300), *SURVIVAL)
            stays &= work.rng.random(n) < chance
            light /= chance[:, None].astype(np.float32)
        kept = np.flatnonzero(stays)
        light = light[kept]
        # A path is counted by its weight alone from here on: its density is 1, on the side that the light came to.
        side = np.stack([(light < 0).any(axis=1), (light > 0).any(axis=1)], axis=1).astype(float)
        history = np.ones(len(kept), np.bool_)
        return _rows(y, kept), Legs(light, path[kept], light, np.zeros_like(light), side, came_from[kept], history)

    def _join(
        self, order: int, onward: int, front: tuple[Ends, Vertices, Legs, int],
        back: tuple[Ends, Vertices, Legs, int], found: tuple[Ints, Ints], work: _Work,
    ) -> None:  # fmt: skip
        """Tallies chosen pairs of front and back vertices, and the pairs that one found from the other.

        front, back : ends, vertices, their legs, and how many of them come from the mixture. found : vertices of the
        other pairs, which see each other.
        """
        (ends_x, x, of_x, n), (ends_y, y, of_y, m) = front, back
        bright_x, bright_y = _brightness(self.values, x, of_x), _brightness(self.values, y, of_y)
        # Vertices with a history come once each; of the others n were drawn from one mixture.
        draws, guess = float(m if of_x.has_history[0] else n * m), np.empty((n, m), np.float32)
        mixed = of_x.mixed, of_y.mixed
        total = _guesses(x, y, bright_x, bright_y, *mixed, draws, float(onward), guess)
        ends = of_x.light.shape[1] + of_y.light.shape[1]
        wanted = max(PAIRS * VERTICES, ends * VERTICES // 2) // (1 if order == 4 else 4)
        full = work.guess_of_certain_pairs(order, total / wanted)
        # The measuring block may have met hardly any light: then all pairs are certain.
        most = int(min(total / full, n * m)) + 2
        a, b = np.empty(most, np.int64), np.empty(most, np.int64)
        origin, span = np.empty((most, 3), np.float32), np.empty((most, 3), np.float32)
        offset = self.caster.offset_m
        k = _chosen(x, y, guess, full, work.rng.random(), offset, self.frame, a, b, origin, span)
        hidden = np.concatenate([self._hidden(origin[:k], span[:k], work), np.zeros(len(found[0]), np.bool_)])
        stride = 0 if self.problem.capture.pairing == "confocal" else of_y.light.shape[1]
        work.cost += ADDED * len(hidden) * len(work.histogram)
        _tally(
            self.kind, self.values, self.clock, ends_x, ends_y, x, y, (of_x, bright_x), (of_y, bright_y), draws,
            float(onward), full, draws * wanted / (n * m), np.concatenate([a[:k], found[0]]),
            np.concatenate([b[:k], found[1]]), hidden, stride, work.histogram,
        )  # fmt: skip

    def _drawn(self, ends: Ends, count: int, work: _Work) -> Vertices:
        """VERTICES vertices from the mixture of the BRDFs at some ends."""
        origin, normal, direction = np.empty((3, VERTICES, 3))
        u = work.rng.random((VERTICES, 3))
        found = _rays(self.kind, self.values, ends, count, u, origin, normal, direction)
        return self._met(origin, normal, direction, found, work)

    def _onward(self, ends: Ends, x: Vertices, legs: Legs, work: _Work) -> Vertices:
        """Where a BRDF ray from each vertex lands."""
        normal, direction = np.zeros((2, len(x.part), 3))
        u = work.rng.random((len(x.part), 3))
        found = _rays_onward(self.kind, self.values, ends, x, legs, u, normal, direction)
        return self._met(x.position, normal, direction, found, work)

    def _met(self, origin: Floats, normal: Floats, direction: Floats, found: Bools, work: _Work) -> Vertices:
        hits = self.caster.leaving(origin, normal, direction)
        work.cost += len(direction)
        part = np.where(hits.valid & found, self.problem.scene.face_part[hits.face], -1).astype(np.int64)
        return Vertices(hits.position, hits.normal, part)

    def _last_vertices(
        self, back: Ends, pixels: Ints, y: Vertices, of_y: Legs, from_x: Vertices, work: _Work
    ) -> tuple[Vertices, Legs, Ints]:
        """Vertices y, those found from x, and once more those of the latter whose ray landed in a pixel; the legs of
        all; and which came once more."""
        landed, of_landed = self._landed(pixels, from_x, work)
        ys = _joined(y, from_x, _rows(from_x, landed))
        return ys, _joined(of_y, self._legs(back, len(pixels), from_x, work), of_landed), landed

    def _landed(self, pixels: Ints, y: Vertices, work: _Work) -> tuple[Ints, Legs]:
        """The vertices whose cosine-distributed ray lands in a pixel, and the legs to where it landed."""
        problem, sensor = self.problem, self.problem.capture.sensor
        direction = cosine_directions(y.normal, work.rng.random((len(y.part), 2)))
        z = self._met(y.position, y.normal, direction, y.part >= 0, work)
        row, pixel, found = in_pixels(sensor, problem.cones, pixels, z.position, z.normal, z.part)
        # Elsewhere the share of this way is 0.
        some = np.flatnonzero(_landings(y, z, row, found.footprint))
        row, pixel, n = row[some], pixel[some], len(some)
        light, path, density, landing = np.zeros((4, n, len(pixels)), np.float32)
        if n:
            ends = self._ends(_rows(found, some), self.unit)._replace(chance=np.ones(1))
            work.cost += n
            unhidden = ~self.caster.occluded(sensor.position, ends.position + self.caster.offset_m * ends.normal)
            legs, at = self._legs(ends, 1, _rows(y, row), work), (np.arange(n), pixel)
            light[at], path[at] = legs.light[:, 0] * unhidden, legs.path[:, 0]
            density[at], landing[at] = legs.density[:, 0], legs.landing[:, 0]
        # No other way finds them: the mixture has no such vertex, and light from the pixel is that of this z alone.
        return row, Legs(light, path, density, landing, np.zeros((n, 2)), direction[row], np.ones(n, np.bool_))

    def _legs(self, ends: Ends, count: int, x: Vertices, work: _Work) -> Legs:
        """The legs from the ends to vertices."""
        n = len(x.part)
        (light, path, density, landing), mixed = np.empty((4, n, count), np.float32), np.zeros((n, 2))
        origin, span = np.empty((2, n * count, 3), np.float32)
        of, offset = np.empty(n * count, np.int64), self.caster.offset_m
        rays = _legs(
            self.kind, self.values, self.air, ends, x, offset, self.frame, light, path, density, landing, origin,
            span, of,
        )  # fmt: skip
        _without_hidden(light, density, ends.chance, self._hidden(origin[:rays], span[:rays], work), of, mixed)
        return Legs(light, path, density, landing, mixed, np.zeros((n, 3)), np.zeros(n, np.bool_))

    def _hidden(self, origin: Floats32, span: Floats32, work: _Work) -> Bools:
        work.cost += len(origin)
        return self.caster.occluded_scaled(origin, span) if len(origin) else np.zeros(0, np.bool_)


@dataclass(frozen=True)
class BlocksOf:
    """The blocks that bring four bounces, or all orders from five to `last`: a source for `effort.py`."""

    blocks: Blocks
    last: int
    can_blur: bool = True

    @property
    def histograms(self) -> list[Ints]:
        """For each group the indices of its histograms."""
        return [group.histograms for group in self.blocks.groups]

    @property
    def unit(self) -> float:
        """Photons that light in blocks is a multiple of."""
        return self.blocks.unit

    @property
    def first(self) -> int:
        """Blocks of each replicate and group in a pilot."""
        return -(-PILOT // (REPLICATES * len(self.blocks.groups)))

    def forget(self, group: int) -> None:
        """Nothing: blocks do not remember."""

    def aim(self, group: int, error: Floats) -> None:
        """Draw vertices where errors (H,) of a group's histograms are large, from the next block on."""
        self.blocks.aim(group, self.last, error)

    def add(self, group: int, replicate: int, number: int, light: Floats32) -> float:
        """Add a block to the light (H, T + 2) of a group; returns its cost in shadow rays."""
        return self.blocks.add(group, replicate, number, self.last, light)


class _Work:
    """A block at work: its random numbers, histogram and cost; and by order the guess from which on pairs are
    certain, which is being measured or known."""

    def __init__(self, rng: np.random.Generator, full: dict[int, float], is_measuring: bool, histogram: Floats32):
        self.rng, self.full, self.is_measuring, self.histogram, self.cost = rng, full, is_measuring, histogram, 0.0

    def guess_of_certain_pairs(self, order: int, here: float) -> float:
        """The guess for `order`; `here` is what suits this block."""
        if self.is_measuring:
            self.full[order] = max(here, DARK)
        # Orders that the measuring block did not get to are fainter than the last that it did.
        return self.full.get(order) or min(self.full.values(), default=DARK)
