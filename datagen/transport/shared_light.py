"""Three bounces of all frames of a sequence, with what they share.

With A the light of the static room, from which moving parts are taken out, B_t what movers block of it in frame t,
and O_t what they bring by themselves,

    L_t = A + M_t,      M_t = O_t − B_t.

A is one run of cuts, the same to the bit in all frames. O_t (`moving_light.py`) and B_t (`silhouettes.py`) have the
same random numbers in all frames, and an effort of their own, which a pilot over some histograms and frames decides
once: M_t is to be known to `part_target` of its own norm, because it is a thousandth of all light.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from datagen.records import Accuracy, Capture, Scene, Transient
from datagen.records.arrays import Bools, Floats, Ints, l2_norm
from datagen.transport.coincidence import set_apart
from datagen.transport.cuts import CLOSE, COARSER, FAINT, FEW, SCATTER, SHAPES, SHARED, STEP, Cuts, spread_evenly
from datagen.transport.lines_of_sight import lines_of_sight
from datagen.transport.memory import VALUES_AT_ONCE
from datagen.transport.movers import Mover, movers_last, movers_of, places_before
from datagen.transport.moving_light import Jobs, OwnLight
from datagen.transport.problem import Problem
from datagen.transport.silhouettes import Shadows
from datagen.transport.simulate import transient_of

SIDE = 24
"""Cells along the front face of a hemicube in the pilot: 8 cm at a metre."""
FINER = 1.2
"""Power of a cell's size with which errors of shadows fall, as measured with 20, 40 and 80 cells a side."""
SIDES = 24, 128
"""Fewest and most cells along the front face."""
CORNERS = 25.0
"""L2 error, over the light, of the shape in time of shadows, times the square of the cells along a side: 0.10
with 16, 0.016 with 40, alike in all replicates."""
PROFILE = 16
"""Histograms of a first look at all frames."""
AT_ONCE = 64
"""Most frames of that look at once: with so many histograms of 512 bins they take 8 MB."""
PILOTS = 8
"""Most pilots: boxes and persons took 2 to 5."""
FALLS = 0.7
"""Power of δ with which errors of movers' own light fall: 0.6 to 0.9 of boxes and persons."""
ELEMENTS = 16
"""Elements of a mover in a histogram, at least: of fewer, those that a pilot missed have most of the error."""
LINES = 3
"""Lines of sight along a side of a pixel, on which movers may stand."""


class Static(NamedTuple):
    """The light A of the static room, and what else frames have in common.

    light : of the static room. problem : of all parts, whose rays meet the static room alone. movers : at the
    instants of all frames and laser points. target : relative L2 error asked of three bounces.
    """

    light: Transient
    problem: Problem
    movers: list[Mover]
    target: float

    @property
    def frames(self) -> int:
        """Number of frames."""
        return int(self.movers[0].pose.shape[1])


class Moving(NamedTuple):
    """The light M of all frames.

    light : (F, H, T) photons, with a sign. apart : (F, H, T) half of the difference of two replicates. own : mover →
    (F, H, T) light of its own. own_error : mover → (F,) L2 error of it, photons. blocked : static object → (F, H, T)
    what of the light by way of it is blocked. outside : (F, H) photons outside the window, with a sign. shape,
    change_shape : (F,) L2 errors that a frame, and its change from the frame before, may have in their shapes in
    time, alike in both replicates, photons. asked : (F,) L2 errors that were asked of frames, photons. rays : cast.
    """

    light: Floats
    apart: Floats
    own: dict[str, Floats]
    own_error: dict[str, Floats]
    blocked: dict[str, Floats]
    outside: Floats
    shape: Floats
    change_shape: Floats
    asked: Floats
    rays: float

    def error(self, frame: int) -> float:
        """L2 error of a frame's light that is claimed, photons."""
        return math.hypot(math.sqrt(SCATTER + SHARED) * l2_norm(self.apart[frame]), float(self.shape[frame]))

    @property
    def error_over_asked(self) -> float:
        """What is claimed over what was asked of all frames together, in which each counts alike."""
        return math.sqrt(np.mean([(self.error(f) / asked) ** 2 for f, asked in enumerate(self.asked)]))

    def change_error(self, frame: int) -> float:
        """L2 error of its change from the frame before that is claimed, photons."""
        apart = self.apart[frame] - self.apart[frame - 1]
        return math.hypot(math.sqrt(SCATTER + SHARED) * l2_norm(apart), float(self.change_shape[frame]))


class Effort(NamedTuple):
    """How fine all frames are: delta (F,) of each mover's `OwnLight.run`, and error (F,); `side` of `Shadows.run`."""

    delta: list[Floats]
    error: Floats
    side: int


def static_of(
    scene: Scene, capture: Capture, instants: Floats, accuracy: Accuracy, target: float, seed: int
) -> Static | None:
    """The static room of a sequence; None where its light does not come by cuts from laser points that stay, or where
    no laser ray meets it.

    instants : (S, F, L) seconds. target : relative L2 error asked of three bounces.
    """
    # A beam that states its cells has other laser points in each run.
    if set(scene.moving) == set(scene.part_names) or capture.laser.cells is not None:
        return None
    static = set_apart(scene.without(*scene.moving), capture)
    three = replace(accuracy, target=target, part_target=accuracy.each_part, max_bounces=3, direct=False)
    light = transient_of(static.scene, capture, three, seed, caster=static.caster)
    if light.samplers["primary"] != "cuts":
        return None
    every = movers_last(scene, static.scene)
    problem = Problem.of(every, capture, three, seed, split_parts=True, caster=static.caster)
    movers = movers_of(scene, static.caster, instants, len(static.scene.part_names))
    return Static(light, problem, movers, target)


def moving_light(static: Static) -> Moving | None:
    """The light of all frames that comes to that of the static room; None where cuts do not find it, as between
    narrow lobes, so that a pilot has more elements than what plain paths would take."""
    cuts = Cuts(static.problem, static.target)
    owns = [
        OwnLight(cuts, mover, [other for other in static.movers if other is not mover]) for mover in static.movers
    ]
    shadows = Shadows(cuts, static.movers)
    effort = _effort(static, cuts, owns, shadows)
    if effort is None:
        return None
    F, H, T = static.frames, cuts.pairs.histograms, cuts.problem.capture.time.bins
    found = Moving(
        np.zeros((F, H, T)), np.zeros((F, H, T)), {own.mover.name: np.zeros((F, H, T)) for own in owns},
        {own.mover.name: np.zeros(F) for own in owns}, {name: np.zeros((F, H, T)) for name in shadows.parts},
        np.zeros((F, H)), np.zeros(F), np.zeros(F), effort.error * math.sqrt(H * (1 + len(owns))), 0.0,
    )  # fmt: skip
    # With more numbers at once, memory that is new takes a third of the time; pictures of four instants take as much.
    step = max(VALUES_AT_ONCE // (2 * F * T * (2 + len(shadows.parts)) * -(-shadows.instants // 4)), 1)
    for at in range(0, H, step):
        some = np.arange(at, min(at + step, H))
        _add(found, some, owns, shadows, effort, Jobs.of(cuts, some, np.tile(np.arange(F)[:, None], len(some))))
    own = SHAPES * effort.error * math.sqrt(H)
    for error in found.own_error.values():
        np.sqrt((SCATTER + SHARED) * error + own**2, out=error)
    for shape in (found.shape, found.change_shape):
        np.hypot(np.sqrt(shape) * CORNERS / effort.side**2, own, out=shape)
    return found._replace(rays=float(shadows.rays + 4 * sum(own.samples for own in owns)))


def _add(
    found: Moving, some: Ints, owns: Sequence[OwnLight], shadows: Shadows, effort: Effort, jobs: Jobs
) -> None:  # fmt: skip
    """Adds the light of some histograms (n,) in all frames; errors of movers as sums of squares."""
    for own, delta in zip(owns, effort.delta, strict=True):
        (one, two), outside = own.run(jobs, delta, effort.error, 2)
        apart = 0.5 * (one - two)
        one += two
        one *= 0.5
        found.own[own.mover.name][:, some] = one
        found.own_error[own.mover.name] += np.einsum("fht,fht->f", apart, apart)
        found.light[:, some] += one
        found.apart[:, some] += apart
        found.outside[:, some] += outside.mean(axis=0)
    (one, two), outside = shadows.run(jobs, effort.side, 2)
    for row, name in enumerate(shadows.parts):
        found.blocked[name][:, some] = 0.5 * (one[row + 1] + two[row + 1])
    one, two = (of[0] if len(of) == 1 else of.sum(axis=0) for of in (one, two))
    found.apart[:, some] -= 0.5 * (one - two)
    one += two
    one *= 0.5
    found.light[:, some] -= one
    found.shape[:] += np.einsum("fht,fht->f", one, one)
    apart = np.diff(one, axis=0)
    found.change_shape[1:] += np.einsum("fht,fht->f", apart, apart)
    found.outside[:, some] -= outside.mean(axis=0)


class _Pilot(NamedTuple):
    """What a run of some histograms in some frames tells: both replicates of the light (2, …) over the weights of the
    frames, of 1/`more` of all."""

    both: Floats
    more: float

    @property
    def error(self) -> float:
        """L2 error of the mean, of all light, photons."""
        return math.sqrt(self.more * (SCATTER + SHARED)) * 0.5 * l2_norm(self.both[0] - self.both[1])

    @property
    def norm(self) -> float:
        """L2 norm of all light, photons, without its noise; the square is at least a tenth of what it is with it."""
        square = self.more * l2_norm(self.both.mean(axis=0)) ** 2
        return math.sqrt(max(square - self.more * 0.25 * l2_norm(self.both[0] - self.both[1]) ** 2, 0.1 * square))


def _light_of_movers(looks: Sequence[_Pilot], blocked: _Pilot) -> _Pilot:
    """The light of all movers, less what they block."""
    return _Pilot(sum((look.both for look in looks), start=-blocked.both), blocked.more)


class _Piloted(NamedTuple):
    """Histograms of a pilot, each in some frame.

    jobs : of each frame that is looked at. weights : (F,) of all frames. more : what all histograms in all frames are
    to those of the pilot.
    """

    jobs: list[Jobs]
    weights: Floats
    more: float

    @classmethod
    def of(cls, cuts: Cuts, weights: Floats) -> _Piloted:
        """As many as `FEW`, spread over histograms, and, by a permutation, over frames."""
        F, H = len(weights), cuts.pairs.histograms
        count = min(FEW, F * H)
        rng = np.random.default_rng(cuts.seed(7))
        histogram = np.resize(spread_evenly(cuts, H, FEW), count)
        frame = rng.permutation(np.arange(count) * F // count % F)
        each = [(histogram[frame == f], f) for f in np.unique(frame)]
        return cls([Jobs.of(cuts, some, np.full((1, len(some)), f)) for some, f in each], weights, F * H / count)

    def look(self, own: OwnLight, delta: float, error: float, number: int) -> _Pilot:
        """What a run tells of the own light of a mover, of elements that bring at most `delta` photons in a frame of
        weight 1."""
        found = []
        for jobs in self.jobs:
            weight = self.weights[jobs.frame[:, 0]]
            found.append(own.run(jobs, delta * weight, error * weight, number)[0] / weight)
        return _Pilot(np.concatenate(found, axis=2), self.more)

    def look_at(self, shadows: Shadows) -> _Pilot:
        """What a run tells of the light that all movers block."""
        found = [
            shadows.run(jobs, SIDE, 1)[0].sum(axis=1) / self.weights[jobs.frame[:, 0]] for jobs in self.jobs
        ]  # fmt: skip
        return _Pilot(np.concatenate(found, axis=2), self.more)


def _weights(static: Static, cuts: Cuts, owns: Sequence[OwnLight], shadows: Shadows) -> Floats:
    """(F,) by how much more or less light moves in a frame than on average, from a coarse look at few histograms.

    Errors are asked in proportion: somebody who comes near brings a hundred times the light that he brought from
    afar, and frames in which he is far are to be known, too.
    """
    F, H = static.frames, cuts.pairs.histograms
    some, square = spread_evenly(cuts, H, PROFILE), np.zeros(F)
    for frames in np.array_split(np.arange(F), -(-F // AT_ONCE)):
        jobs, any_size = Jobs.of(cuts, some, np.tile(frames[:, None], len(some))), np.full(len(frames), np.inf)
        light = -shadows.run(jobs, SIDE, 0)[0].sum(axis=1).mean(axis=0)
        for own in owns:
            light += own.run(jobs, any_size, any_size, 0)[0].mean(axis=0)
        square[frames] = np.einsum("fht,fht->f", light, light) * H / len(some)
    # What is fainter than what counts as an object's light is known no better than if it counted.
    least = max(FAINT * l2_norm(static.light.total), static.problem.accuracy.faint_part / math.sqrt(F), 1e-100)
    norm = np.maximum(np.sqrt(square), least)
    # In steps, so that neighbouring frames mostly have the same cuts, and less noise in their change.
    return np.asarray(np.exp2(np.round(np.log2(norm / math.sqrt(np.square(norm).mean())))))


def _effort(static: Static, cuts: Cuts, owns: Sequence[OwnLight], shadows: Shadows) -> Effort | None:
    """How fine all frames have to be, from a pilot over some histograms, each in some frame; None if that has more
    elements than it may. All norms and errors in
    it are of light over the weights of its frames, so that each frame counts alike."""
    F, H = static.frames, cuts.pairs.histograms
    weights = _weights(static, cuts, owns, shadows) if F > 1 else np.ones(1)
    pilot = _Piloted.of(cuts, weights)
    count = sum(len(jobs.laser) for jobs in pilot.jobs)
    whole = math.sqrt(F) * l2_norm(static.light.total)
    blocked = pilot.look_at(shadows)
    # Of each mover, and of their shadows, an equal share.
    share, per = math.sqrt(1.0 / (1 + len(owns))), math.sqrt(F * H)
    looks = [pilot.look(own, np.inf, np.inf, 1) for own in owns]
    asked = share * _error_asked(static, _light_of_movers(looks, blocked).norm, whole)
    delta, again, few = np.full(len(owns), COARSER * asked / per), *np.full((2, len(owns)), True)
    for turn in range(PILOTS):
        for m in np.flatnonzero(again).tolist():
            before = owns[m].samples
            looks[m] = pilot.look(owns[m], delta[m], asked / per, 10 + turn)
            few[m] = owns[m].samples - before < 2 * count * ELEMENTS
            if owns[m].is_limited:
                return None
        # With less noise there is less light than the look seemed to meet.
        asked = share * _error_asked(static, _light_of_movers(looks, blocked).norm, whole)
        error = np.maximum([look.error for look in looks], 1e-3 * asked)
        wanted = np.minimum(delta * (asked / error) ** (1.0 / FALLS), np.where(few, delta / CLOSE**2, delta))
        again = CLOSE * wanted < delta
        if turn == PILOTS - 1 or not again.any():
            break
        delta = np.where(again, np.maximum(wanted, delta / STEP), delta)
    delta = np.maximum(wanted, delta / STEP)
    side = max(
        SIDE * (max(blocked.error, 1e-100) / asked) ** (1.0 / FINER), math.sqrt(CORNERS * blocked.norm / asked)
    )  # fmt: skip
    cells = 2 * round(0.5 * float(np.clip(side, *SIDES)))
    return Effort([of * weights for of in delta], asked / per * weights, cells)


def _error_asked(static: Static, norm: float, whole: float) -> float:
    """L2 error that is asked of the light that moves, of all frames together, photons, where its L2 norm is `norm`,
    and that of the static light of all frames `whole`."""
    accuracy = static.problem.accuracy
    # What is fainter than what counts as an object's light is known no better than if it counted.
    own = accuracy.each_part * max(norm, FAINT * whole, accuracy.faint_part)
    return max(min(own, static.target * math.hypot(whole, norm)), 1e-100)


def hidden_by_movers(static: Static, capture: Capture) -> Bools:
    """(F,) whether a mover hides a laser point from the laser, or any of what a pixel sees from the sensor."""
    problem, sensor = static.problem, capture.sensor
    points, pairs = problem.points, problem.pairs.ends
    found, lit = np.zeros(static.frames, np.bool_), np.flatnonzero(points.part >= 0)
    sight = lines_of_sight(problem.caster, sensor, LINES)
    instants = range(len(static.movers[0].pose))
    for frame, instant, mover in itertools.product(range(len(found)), instants, static.movers):
        pose = mover.pose[instant, frame]
        # Where all laser points have one time, each pixel is looked at once.
        is_one = bool((pose == pose[:1]).all())
        laser, pixel = (np.zeros(len(sensor.pixels), np.int64), np.arange(len(sensor.pixels))) if is_one else pairs.T
        found[frame] |= _hides(static, mover, pose[lit], capture.laser.position, points.position[lit])
        for line in range(LINES * LINES):
            some = sight.valid[pixel, line]
            to = sight.position[pixel[some], line]
            found[frame] |= _hides(static, mover, pose[laser[some]], sensor.position, to)
    return found


def _hides(static: Static, mover: Mover, pose: Floats, device: Floats, points: Floats) -> bool:
    """Whether a mover at poses (n, 5) stands between the device (3,) and points (n, 3)."""
    low, high = mover.vertices.min(axis=0), mover.vertices.max(axis=0)
    middle, radius = 0.5 * (low + high), 0.5 * float(np.linalg.norm(high - low))
    a, b = places_before(pose, np.tile(device, (len(pose), 1))), places_before(pose, points)
    # Only what passes the mover's sphere is worth a ray.
    along = np.clip(np.einsum("nk,nk->n", middle - a, b - a) / np.maximum(((b - a) ** 2).sum(axis=1), 1e-300), 0, 1)
    near = np.linalg.norm(a + along[:, None] * (b - a) - middle, axis=1) <= radius
    if not near.any():
        return False
    caster = static.problem.caster
    start, end = caster._scaled(a[near]), caster._scaled(b[near])
    return bool(mover.hides(start, end - start).any())
