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

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from datagen.records.arrays import Bools, Floats, Ints, joined_rows, rows_of
from datagen.seeding import LightStream
from datagen.transport.block_steps import (
    Bins,
    Ends,
    LitVertices,
    Odds,
    Sketch,
    Vertices,
    brightness,
    carry,
    choose_pairs,
    landings,
    rays_from_ends,
    rays_onward,
    remove_hidden,
    set_guesses,
    set_light,
    tally,
)
from datagen.transport.brdf import cosine_directions
from datagen.transport.effort import REPLICATES, Floats32
from datagen.transport.fields_of_view import FovPool, fov_points, in_pixels
from datagen.transport.geometry import TINY
from datagen.transport.laser_points import LaserPoints
from datagen.transport.problem import Problem
from datagen.transport.sampling import SURVIVAL
from datagen.units import path_from_time

VERTICES = 128
"""F: front vertices, and back vertices, of a block; from half of them a BRDF ray goes on, n = F/2. More share the
cost of legs worse, fewer that of pairs."""
FOV_SETS = 8
"""Independent FoV points of each pixel in a block; vertex i meets those of set i mod 8. Four bounces of ten rooms of
the ready configurations took as long with 4 and with 16 for the same error, within 3 % in the median."""
GROUP = {"confocal": 32, "exhaustive": 64}
"""Most laser points, and most pixels, of a group: a vertex is bright for neighbours alike. In the same rooms half as
many took 1.1 times as long for the same error in the median, twice as many 1.4 times."""
PAIRS = 8
"""Pairs of vertices kept in a block, in units of F, where a group has few laser points and pixels. Half and twice as
many took as long for the same error in the same rooms, within 3 % in the median."""
LONGEST = 400
"""Bounces at which paths end that have no limit: a path survives so many once in 10⁹."""
ADDED = 0.02
"""Cost of adding light to a bin, in shadow rays: by costs the effort of groups and components is weighed."""
PILOT = 64
"""Fewest blocks of a pilot, over all groups and replicates. Half and twice as many took as long for the same error in
the same rooms, within 4 % in the median."""


class Group(NamedTuple):
    """Indices of neighbouring laser points and pixels, and of the histograms of their pairs."""

    lasers: Ints
    pixels: Ints
    histograms: Ints


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

    lasers : the laser points, of a beam the middles of its cells. groups : of neighbouring laser points and pixels;
    each pair of the capture is in one of them. unit : photons that light in blocks is a multiple of, so that single
    precision has room for it.
    """

    def __init__(self, problem: Problem) -> None:
        self.problem, self.caster, capture = problem, problem.caster, problem.capture
        axis, P = capture.time, len(capture.sensor.pixels)
        # Kinds of one type, so that kernels are compiled once, whether or not all parts of a scene are Lambertian.
        self.scene = problem.numbers._replace(kind=problem.materials.kind.astype(np.int64))
        self.per_metre, self.start = 1.0 / float(path_from_time(axis.width_s)), axis.start_s / axis.width_s
        self.is_confocal, self.is_flood = capture.pairing == "confocal", capture.illumination == "flood"
        self.lasers = self.ends_of_lasers(problem.points)
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

    def ends_of_lasers(self, points: LaserPoints) -> Ends:
        """(L) ends where paths begin, at laser points, with the share of the emitted light that arrives at each."""
        exists = points.part >= 0
        leg = np.where(exists, points.leg, 0.0)
        return Ends(
            np.where(exists[:, None], points.position, 0.0), points.normal, points.to_laser, points.part,
            np.where(exists, self.problem.pairs.share * np.exp(-self.scene.air * leg), 0.0),
            leg * self.scene.from_source,
            np.zeros(len(leg)), np.ones(len(leg)),
        )  # fmt: skip

    def lasers_of_block(self, rng: np.random.Generator) -> Ends:
        """The laser points that a block has; other ones in each where a beam states its cells."""
        problem = self.problem
        if problem.capture.laser.cells is None:
            return self.lasers
        return self.ends_of_lasers(LaserPoints.in_cells(self.caster, problem.scene, problem.capture.laser, 1, rng))

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
        self.front = rows_of(self.blocks.lasers_of_block(rng), self.group.lasers)._replace(chance=of_lasers)
        # The sets of a pixel are a lattice with a shift of its own: evenly spread, and each point uniform.
        number = np.arange(FOV_SETS)
        lattice = np.stack([number, 3 * number % FOV_SETS], axis=1) / FOV_SETS
        uv = (rng.random((P, 1, 2)) + lattice) % 1.0
        self.back = self.blocks.fov_points(self.group.pixels, uv)._replace(chance=of_pixels)

    def run(self, last: int) -> None:
        """Add four bounces, or all orders from five to `last`."""
        # Both are drawn before either is lit, in the order of their random numbers.
        at_x, at_y = self.draw_vertices(self.front), self.draw_vertices(self.back)
        x, y = self.lit_vertices(self.front, at_x), self.lit_vertices(self.back, at_y)
        onward = VERTICES // 2
        some = np.arange(onward)
        on_from_x = rows_of(x, some)
        from_x = self.vertices_onward(self.front, on_from_x)
        if last == 4:
            # A path of four bounces has one x and one y: y is found from x, or x from y, or both are drawn.
            ys, landed = self.last_vertices(y, from_x)
            from_y = self.vertices_onward(self.back, rows_of(y, some))
            xs = joined_rows(x, self.lit_vertices(self.front, from_y))
            of_from_x = np.arange(VERTICES, len(ys.part))
            found = np.concatenate([some, landed, VERTICES + some]), np.append(of_from_x, some)
            self.join(4, onward, xs, VERTICES, ys, found)
            return
        # With more bounces the y found from x is the next x; those drawn stay the last vertices of all orders.
        x = on_from_x
        for order in range(5, last + 1):
            x = self.next_vertices(x, onward, from_x, order)
            if len(x.part) == 0:
                break
            onward, n = 1, len(x.part)
            from_x = self.vertices_onward(self.front, x)
            ys, landed = self.last_vertices(y, from_x)
            found = np.append(np.arange(n), landed), np.arange(VERTICES, len(ys.part))
            self.join(order, 1, x, n, ys, found)

    def draw_vertices(self, ends: Ends) -> Vertices:
        """VERTICES vertices from the mixture of the BRDFs at some ends."""
        origin, normal, direction = np.empty((3, VERTICES, 3))
        found = rays_from_ends(self.scene, ends, self.rng.random((VERTICES, 3)), origin, normal, direction)
        return self.vertices_along(origin, normal, direction, found)

    def vertices_onward(self, ends: Ends, x: LitVertices) -> Vertices:
        """Where a BRDF ray from each vertex lands."""
        normal, direction = np.zeros((2, len(x.part), 3))
        found = rays_onward(self.scene, ends, x, self.rng.random((len(x.part), 3)), normal, direction)
        return self.vertices_along(x.position, normal, direction, found)

    def vertices_along(self, origin: Floats, normal: Floats, direction: Floats, found: Bools) -> Vertices:
        """Where rays that leave surfaces land. The part is −1 for rays that meet nothing, and for those that do not
        exist by `found` (n,)."""
        hits = self.caster.leaving(origin, normal, direction)
        self.cost += len(direction)
        part = np.where(hits.valid & found, self.blocks.problem.scene.face_part[hits.face], -1).astype(np.int64)
        return Vertices(hits.position, hits.normal, part)

    def lit_vertices(self, ends: Ends, at: Vertices) -> LitVertices:
        """Vertices with the light of some ends."""
        x, n = LitVertices.dark(at, len(ends.chance)), len(at.part) * len(ends.chance)
        (origin, span), of = np.empty((2, n, 3), np.float32), np.empty(n, np.int64)
        rays = set_light(self.scene, ends, x, origin, span, of)
        remove_hidden(x, ends.chance, self.is_hidden(origin[:rays], span[:rays]), of)
        return x

    def is_hidden(self, origin: Floats32, span: Floats32) -> Bools:
        """(n,) whether something stands on shadow rays in embree's frame."""
        self.cost += len(origin)
        return self.caster.occluded_scaled(origin, span) if len(origin) else np.zeros(0, np.bool_)

    def last_vertices(self, y: LitVertices, from_x: Vertices) -> tuple[LitVertices, Ints]:
        """Vertices y, those found from x, and once more those of the latter whose ray landed in a pixel; and which
        came once more."""
        row, landed = self.vertices_that_land(from_x)
        return joined_rows(y, self.lit_vertices(self.back, from_x), landed), row

    def vertices_that_land(self, y: Vertices) -> tuple[Ints, LitVertices]:
        """Which vertices have a cosine-distributed ray that lands in a pixel, and these, lit from where it landed."""
        problem, sensor = self.blocks.problem, self.blocks.problem.capture.sensor
        direction = cosine_directions(y.normal, self.rng.random((len(y.part), 2)))
        z = self.vertices_along(y.position, y.normal, direction, y.part >= 0)
        row, pixel, found = in_pixels(sensor, problem.cones, self.group.pixels, z.position, z.normal, z.part)
        # Elsewhere the share of this way is 0.
        some = np.flatnonzero(landings(y, z, row, found.footprint))
        row, pixel, n = row[some], pixel[some], len(some)
        # No other way finds them: the mixture has no such vertex, and light from the pixel is that of this z alone.
        out = LitVertices.dark(rows_of(y, row), len(self.group.pixels))
        out = out._replace(came_from=direction[row], has_history=np.ones(n, np.bool_))
        if n:
            ends = self.blocks.ends_of(rows_of(found, some))._replace(chance=np.ones(1))
            unhidden = ~self.caster.occluded(sensor.position, ends.position + self.caster.offset_m * ends.normal)
            self.cost += n
            own, at = self.lit_vertices(ends, out.at), (np.arange(n), pixel)
            out.light[at], out.path[at] = own.light[:, 0] * unhidden, own.path[:, 0]
            out.density[at], out.landing[at] = own.density[:, 0], own.landing[:, 0]
        return row, out

    def next_vertices(self, x: LitVertices, onward: int, at: Vertices, order: int) -> LitVertices:
        """The vertices found from x as front vertices of paths of `order` bounces, with all light that they got."""
        y, power = LitVertices.dark(at, x.light.shape[1]), np.zeros(len(at.part))
        carry(self.scene, self.front, x, float(onward), y, power)
        stays, light = power > 0, y.light
        if order > 5:
            chance = np.clip(power / np.maximum(np.abs(x.light).sum(axis=1), TINY), *SURVIVAL)
            stays &= self.rng.random(len(power)) < chance
            light /= chance[:, None].astype(np.float32)
        y = rows_of(y, np.flatnonzero(stays))
        # A path is counted by its weight alone from here on: its density is 1, on the side that the light came to.
        side = np.stack([(y.light < 0).any(axis=1), (y.light > 0).any(axis=1)], axis=1).astype(float)
        return y._replace(density=y.light, mixed=side, has_history=np.ones(len(side), np.bool_))

    def join(self, order: int, onward: int, x: LitVertices, n: int, y: LitVertices, found: tuple[Ints, Ints]) -> None:
        """Tallies chosen pairs of front vertices x and back vertices y, and the pairs that one found from the other.

        n : number of x that come from the mixture. found : vertices of the other pairs, which see each other.
        """
        values = self.scene.values
        sketches = (
            Sketch(x.position, x.normal, x.mixed, brightness(values, x)),
            Sketch(y.position, y.normal, y.mixed, brightness(values, y)),
        )
        # Vertices with a history come once each; of the others n were drawn from one mixture.
        draws, guess = float(VERTICES if x.has_history[0] else n * VERTICES), np.empty((n, VERTICES), np.float32)
        total = set_guesses(*sketches, draws, float(onward), guess)
        ends = x.light.shape[1] + y.light.shape[1]
        wanted = max(PAIRS * VERTICES, ends * VERTICES // 2) // (1 if order == 4 else 4)
        full = self.guess_of_certain_pairs(order, total / wanted)
        # The measuring block may have met hardly any light: then all pairs are certain.
        most = int(min(total / full, n * VERTICES)) + 2
        pairs, (origin, span) = np.empty((2, most), np.int64), np.empty((2, most, 3), np.float32)
        k = choose_pairs(self.scene, *sketches, guess, full, self.rng.random(), pairs, origin, span)
        hidden = np.concatenate([self.is_hidden(origin[:k], span[:k]), np.zeros(len(found[0]), np.bool_)])
        self.cost += ADDED * len(hidden) * len(self.histogram)
        odds = Odds(draws, float(onward), full, draws * wanted / (n * VERTICES))
        pairs, blocks = np.hstack([pairs[:, :k], found]), self.blocks
        stride = -1 if blocks.is_confocal else 0 if blocks.is_flood else y.light.shape[1]
        bins = Bins(blocks.per_metre, blocks.start, stride)
        tally(self.scene, bins, self.front, self.back, x, y, sketches, odds, pairs, hidden, self.histogram)

    def guess_of_certain_pairs(self, order: int, here: float) -> float:
        """The guess from which on pairs are certain for `order`; `here` is what suits this block."""
        if self.is_measuring:
            self.full[order] = max(here, TINY)
        # Orders that the measuring block did not get to are fainter than the last that it did.
        return self.full.get(order) or min(self.full.values(), default=TINY)
