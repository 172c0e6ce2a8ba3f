"""Light by plain paths: the answer for a number of samples, and for what the other samplers leave."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from datagen.records.arrays import Floats, Ints
from datagen.seeding import LightStream
from datagen.transport.effort import REPLICATES, Floats32
from datagen.transport.path_steps import add
from datagen.transport.paths import Tracer
from datagen.transport.problem import Estimate, Problem, component_of
from datagen.transport.sampling import stream_seeds

PILOT = 1 << 13
"""Samples of a block, over all pairs of laser point and pixel; a pair has at least one, and at most half of them."""
RAYS = 8.0
"""Rays that a sample takes for paths of one order, about: three ways with rays for vertices and shadow rays."""


def with_samples(problem: Problem) -> Estimate:
    """The light of all components by `Accuracy.samples` plain paths of each pair of laser point and pixel."""
    samples, shape = problem.accuracy.samples, problem.capture.shape
    assert samples is not None
    replicates = min(REPLICATES, samples)
    each = [samples // replicates + (r < samples % replicates) for r in range(replicates)]
    pairs, rows = problem.pairs, Rows.of_components(problem, problem.components)
    light, overflow = np.zeros((rows.count, pairs.histograms, shape[2])), np.zeros(pairs.histograms)
    variance = np.full((pairs.histograms, shape[2]), np.nan)
    # Replicates of unequal size count by their size.
    share = np.array(each)[:, None, None, None] / samples
    for some, own in pairs.in_calls(rows.count * shape[2]):
        count = some.stop - some.start
        runs = np.stack([rows.light(problem, own, count, n, (0, r, some.start)) for r, n in enumerate(each)])
        light[:, some] = (share * runs[..., 1:-1]).sum(axis=0)
        overflow[some] = (share * runs[..., (0, -1)]).sum(axis=(0, 1, 3))
        if replicates > 1:
            variance[some] = runs[..., 1:-1].sum(axis=1).var(axis=0, ddof=1) / replicates
    of_rows = light.reshape(rows.count, *shape)
    return Estimate(
        {name: of_rows[rows.names[name]].sum(axis=0) for name in problem.components},
        dict(zip(problem.parts, of_rows, strict=False)), np.sqrt(variance).reshape(shape),
        overflow.reshape(shape[:2]),
        samplers=dict.fromkeys(problem.components, "paths"),
        rays=dict.fromkeys(problem.components, RAYS * samples * len(pairs.ends)),
    )  # fmt: skip


class PathsOf:
    """Plain paths of one component, a source for `effort.py`.

    parts : (K, H, T) light of the primary by part, of all blocks so far, where it is split by part. blocks : their
    number. samples : of each pair of laser point and pixel in a block.
    """

    first = 1

    def __init__(self, problem: Problem, component: str) -> None:
        self.problem, self.pairs = problem, problem.pairs
        self.rows = Rows.of_components(problem, (component,))
        self.histograms = [np.arange(self.pairs.histograms)]
        # The most light of a bin in the first block that has some: in this unit light has room in single precision.
        self.unit = 0.0
        self.samples = max(PILOT // max(len(self.pairs.ends), 2), 1)
        # Parts have to add up to the whole.
        self.can_blur = self.rows.count == 1
        shape = self.rows.count, self.pairs.histograms, problem.capture.time.bins
        self.parts, self.blocks = None if self.can_blur else np.zeros(shape), 0

    def light_of_parts(self) -> dict[str, Floats]:
        """Part → its light (H, T); empty where light is not split by part."""
        if self.parts is None:
            return {}
        return dict(zip(self.problem.parts, self.parts / self.blocks, strict=True))

    def aim(self, group: int, error: Floats) -> None:
        """Nothing: each pair has as many paths as any other."""

    def forget(self, group: int) -> None:
        """Leave out what was added so far."""
        self.blocks = 0
        if self.parts is not None:
            self.parts[:] = 0.0

    def add(self, group: int, replicate: int, number: int, light: Floats32) -> float:
        """Add a block to the light (H, T + 2); returns its cost in shadow rays."""
        for some, own in self.pairs.in_calls(self.rows.count * light.shape[1]):
            stream = 1, replicate, number, some.start
            found = self.rows.light(self.problem, own, some.stop - some.start, self.samples, stream)
            self.unit = self.unit or float(found.max())
            light[some] += found.sum(axis=0) / (self.unit or 1.0)
            if self.parts is not None:
                self.parts[:, some] += found[..., 1:-1]
        self.blocks += 1
        return RAYS * self.samples * len(self.pairs.ends)


@dataclass(frozen=True)
class Rows:
    """The histograms of each pair: one for each part of the primary, or one for all of it, and one for each other
    component.

    names : component → its rows. of : (orders, K) row of a path of one bounce, of two …, of which the last stands for
    all beyond, by the part of its last hidden vertex; −1 for paths that are not wanted. last : most bounces of paths;
    None for no limit. direct : whether one and two bounces are wanted.
    """

    names: dict[str, slice]
    of: Ints
    last: int | None
    direct: bool

    @classmethod
    def of_components(cls, problem: Problem, components: tuple[str, ...]) -> Rows:
        """The rows of some components of a problem."""
        parts, names, count = len(problem.scene.part_names), dict[str, slice](), 0
        # Parts come first, so that rows of parts have the parts' numbers.
        for name in sorted(components, key=lambda name: name != "primary"):
            more = parts if name == "primary" and problem.split_parts else 1
            names[name] = slice(count, count + more)
            count += more
        of, last = np.full((5, parts), -1), 2
        for order in range(1, 6):
            name = component_of(order)
            if name in names:
                is_split = names[name].stop - names[name].start > 1
                of[order - 1] = names[name].start + (np.arange(parts) if is_split else 0)
                last = order
        # One bounce of a beam that states its cells is left to `flood.one_bounce_of_beam`.
        if problem.capture.laser.cells is not None:
            of[0] = -1
        # Row 5 stands for all orders beyond, too.
        most = problem.accuracy.max_bounces
        return cls(names, of, most if last == 5 else min(last, most or last), "direct" in names)

    @property
    def count(self) -> int:
        """Number of rows."""
        return int(max(rows.stop for rows in self.names.values()))

    def light(self, problem: Problem, some: Ints, count: int, samples: int, stream: tuple[int, ...]) -> Floats:
        """(rows, count, T + 2) light of some pairs, by number, of which the i-th adds to histogram i mod `count`; the
        first and last column are what comes before and after the window.

        stream : numbers that tell this draw from others.
        """
        seed = int(stream_seeds(problem.seed, LightStream.PATHS, *stream)[0])
        time, capture = problem.capture.time, problem.capture
        pairs = problem.pairs.ends[some]
        share, light = problem.pairs.share[pairs[:, 0]], np.zeros((self.count, count, time.bins + 2))
        tracer = Tracer(problem.caster, problem.scene, problem.materials, capture, pairs, samples, seed)
        for first, order, found in tracer.paths(self.last, self.direct):
            add(found, order, first, samples, self.of, share, time.start_s, time.width_s, light)
        return light
