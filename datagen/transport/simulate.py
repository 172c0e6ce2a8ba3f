"""Light transport: from scene and capture to transient, and the choice of the sampler.

With a number of samples (`Accuracy.samples`) all light comes by plain paths. With a target three bounces come by cuts
(`cuts.py`), four and more by blocks (`blocks.py`), and direct light and what these leave far from the target by plain
paths (`path_light.py`).
"""

from __future__ import annotations

import math
import time as clock_time
from collections.abc import Sequence
from typing import NamedTuple
from warnings import warn

import numpy as np

from datagen.errors import InputWarning
from datagen.records import Accuracy, Capture, Scene, Transient
from datagen.records.arrays import Floats, Ints, l2_norm
from datagen.records.checks import check_flag, check_kind, check_seed
from datagen.transport.blocks import LONGEST, Blocks, BlocksOf
from datagen.transport.coincidence import Apart, set_apart
from datagen.transport.cuts import Beside, PrimaryLight, primary_by_cuts
from datagen.transport.doubts import doubts, has_none, known_to
from datagen.transport.effort import Sampled, Source, is_enough, sample_to_target
from datagen.transport.flood import Beam, light_at_flooded_sensor, one_bounce_of_beam
from datagen.transport.laser_points import LaserPoints, parts_lit
from datagen.transport.path_light import PathsOf, with_samples
from datagen.transport.problem import Estimate, Problem, nothing
from datagen.transport.rays import Raycaster
from datagen.units import path_from_time

MET = 1.25
"""Claimed error over target up to which a target counts as met: it is aimed at, and a claim is an estimate."""

ABOUT = 0.2
"""Relative L2 error to which direct light is sampled first, only to tell what is asked of the primary."""


def simulate(
    scene: Scene, capture: Capture, accuracy: Accuracy | None = None, seed: int = 0, *, split_parts: bool = True
) -> Transient:
    """Follow light from each laser point around the corner and back.

    The photons that reach the aperture per emitted photon; with f the BRDFs, V the visibility, x₁ the laser point,
    x₂ a hidden vertex and x₃ a FoV point, the primary (three bounces) is (docs/physics.md; the paths are those of Eq.
    6 of Scholes & Leach, Sensors 24, 6522 (2024), with radiometric weights)

        L = ∫∫ f₁ cosθ₁ cosθ₂ V₁₂/R₁₂² · f₂ · cosθ₂′ cosθ₃ V₂₃/R₂₃² · f₃ cosθ₃′ V₃ₛ A/R₃ₛ² dA₂ dA₃

    and each further bounce adds a surface between x₂ and x₃ (the secondary is that of Eq. 8, all paths).

    Parameters
    ----------
    scene, capture : what is looked at, and how.
    accuracy : the error that is aimed at, or a number of samples, and the orders of light; default `Accuracy()`.
    seed : any integer ≥ 0; the same arguments and seed give the same transient.
    split_parts : also keep the primary split by part (`Transient.parts`), K times the memory for K parts.

    Returns
    -------
    Transient with arrays (L, P, T), photons at the aperture per emitted photon and bin. A laser ray that meets
    nothing, or a pixel that sees nothing, gives zeros. Flood illumination gives the weighted mean over its laser
    points, (1, P, T), with L as the number of points of its quadrature (`transport/flood.py`).

    Raises
    ------
    InputError : for a pixel that is no convex quadrilateral, a negative seed, or an argument of another type.

    Warns
    -----
    InputWarning : no light falls into the time axis, though some arrives outside it: mostly a scene in millimetres; a
        laser ray meets nothing, or, where there is a relay wall and `accuracy.direct` is off, an object; surfaces of
        two parts coincide where light gets to, and one is taken to lie on the other
        (`transport/coincidence.py`); a part so large that rays are coarse beside the legs of the light, a device
        inside of a wall, or nothing to light before the laser points or what pixels see (`transport/doubts.py`).

    Examples
    --------
    >>> import datagen as dg, trimesh
    >>> wall = trimesh.Trimesh([(0, -1, 0), (0, 1, 0), (0, 1, 2), (0, -1, 2)], [(0, 1, 2), (0, 2, 3)])
    >>> box = trimesh.creation.box(bounds=[(1, 0.3, 0.5), (1.5, 0.8, 1)])
    >>> scene = dg.Scene.from_parts([dg.Part("relay_wall", wall, dg.Lambertian(0.8)),
    ...                              dg.Part("box", box, dg.Lambertian(0.5))])
    >>> laser = dg.Laser((2, -1, 1), [(0, -0.2, 1)])
    >>> sensor = dg.Sensor.grid((2, -1, 1), (0, 0.2, 1), (0, 0.1, 0), (0, 0, 0.1), rows=1, columns=2)
    >>> capture = dg.Capture(laser, sensor, dg.TimeAxis(bins=200, width_s=1e-10, origin="wall"))
    >>> t = dg.simulate(scene, capture, dg.Accuracy(target=0.05, max_bounces=4), seed=0)
    >>> t.total.shape, sorted(t.components), bool(t.parts["box"].sum() > 0)
    ((1, 2, 200), ['primary', 'secondary'], True)
    """
    check_kind("scene", scene, Scene)
    check_kind("capture", capture, Capture)
    accuracy = Accuracy() if accuracy is None else accuracy
    check_kind("accuracy", accuracy, Accuracy, remedy="an error to be met is Accuracy(target=0.05)")
    check_seed(seed)
    check_flag("split_parts", split_parts)
    apart = set_apart(scene, capture)
    for line in warnings_of(apart, capture, accuracy):
        warn(f"simulate: {line}", InputWarning, stacklevel=2)
    scene, caster = apart.scene, apart.caster
    found = transient_of(scene, capture, accuracy, seed, split_parts=split_parts, caster=caster)
    if found.overflow.any() and not found.total.any():
        start, stop = capture.time.start_s * 1e9, capture.time.stop_s * 1e9
        warn(
            f"simulate: all light arrives outside the time axis, {start:.4g} … {stop:.4g} ns; is the scene in m?",
            InputWarning, stacklevel=2,
        )  # fmt: skip
    return found


def warnings_of(apart: Apart, capture: Capture, accuracy: Accuracy) -> list[str]:
    """Lines about what a user of a scene and capture did not mean, most likely."""
    scene, caster = apart.scene, apart.caster
    points = LaserPoints.of(caster, scene, capture.laser)
    astray = _warning_of_stray_rays(scene, accuracy, parts_lit(points, caster, scene, capture.laser))
    return [line for line in (apart.warning, astray) if line] + list(doubts(scene, capture, caster, accuracy.direct))


def _warning_of_stray_rays(scene: Scene, accuracy: Accuracy, part: Ints) -> str:
    """A warning about laser rays that meet nothing or an object instead of the relay wall; empty if all is well.

    part : (L,) index of the part that each laser ray meets, −1 for none.
    """
    missing = part < 0
    if missing.any():
        return (
            f"{missing.sum()} of {len(part)} laser rays, the first to Laser.targets[{missing.argmax()}], meet "
            "nothing and bring no light; aim them at the relay wall"
        )
    # A user who asks for direct light may well point the laser at objects on purpose.
    roles = np.array(scene.roles)
    on_object = roles[part] == "object"
    if accuracy.direct or "relay_wall" not in scene.roles or not on_object.any():
        return ""
    first = int(on_object.argmax())
    return (
        f"{on_object.sum()} of {len(part)} laser points, the first Laser.targets[{first}], lie on the object "
        f"{scene.part_names[part[first]]!r} and not on the relay wall; move them, or give the part another role"
    )


def transient_of(
    scene: Scene, capture: Capture, accuracy: Accuracy, seed: int, *, split_parts: bool = True,
    caster: Raycaster | None = None,
) -> Transient:  # fmt: skip
    """The same as `simulate`, without checks and warnings, for arguments that were checked before.

    caster : the ray caster of the scene, if there is one already.
    """
    began = clock_time.perf_counter()
    problem = Problem.of(scene, capture, accuracy, seed, split_parts=split_parts, caster=caster)
    ready = clock_time.perf_counter()
    beam, is_flood = None, capture.illumination == "flood"
    if is_flood and capture.laser.cells is not None and accuracy.direct:
        beam = one_bounce_of_beam(scene, capture, problem.caster, problem.materials)
    if not problem.is_lit:
        found = nothing(problem)
    else:
        found = with_samples(problem) if accuracy.target is None else _light_to_target(problem, beam)
    if is_flood:
        found = light_at_flooded_sensor(problem, found, beam)
    seconds = {"prepare": ready - began, "trace": clock_time.perf_counter() - ready}
    return Transient(time=capture.time, laser_points=problem.points.position, seconds=seconds, **vars(found))


def _light_to_target(problem: Problem, beam: Beam | None) -> Estimate:
    """The light of all components to a target: three bounces by cuts, four and more by blocks, direct light and what
    these leave by plain paths.

    beam : light of one bounce that is known; the target is that of all light.
    """
    accuracy, components = problem.accuracy, problem.components
    assert accuracy.target is not None
    others = [name for name in components if name != "primary"]
    first = np.zeros((problem.pairs.histograms, problem.capture.time.bins))
    of_parts = np.zeros(len(problem.scene.part_names))
    if beam is not None:
        first, of_parts = beam.light.sum(axis=0), np.array([l2_norm(of) for of in beam.light])
    beside = Beside(l2_norm(first), of_parts)
    if "direct" in components and "primary" in components:
        # What is asked of the primary follows from the light of all, of which direct light may be most.
        look = light_by_samples(problem, ["direct"], first, 0.0, ABOUT).found
        known = l2_norm(look.light["direct"] + first) ** 2 - look.error["direct"] ** 2
        beside = beside._replace(whole=max(math.sqrt(max(known, 0.0)), beside.whole))
    primary = None
    if "primary" in components:
        # Squared errors add up, and the primary takes an equal share; what it leaves of its share is for the others.
        primary = primary_by_cuts(problem, accuracy.target * math.sqrt(1 / len(components)), beside)
    if primary is None:
        return _estimate_of(problem, first, None, light_by_samples(problem, components, first, 0.0))
    own, so_far = primary.total, primary.total + first
    found = light_by_samples(problem, others, so_far, primary.error)
    norm = l2_norm(sum(found.found.light.values(), start=so_far))
    if is_enough(primary.error, l2_norm(own), norm, accuracy.target):
        return _estimate_of(problem, first, primary, found)
    # Narrow lobes may leave cuts far from the target; paths, which follow the lobes, are better there.
    rest = sum(found.found.light.values(), start=np.zeros_like(own)) + first
    again = light_by_samples(problem, ["primary"], rest, math.hypot(*found.found.error.values()))
    return _estimate_of(
        problem, first, None, Samples(found.sources | again.sources, found.found.with_components_of(again.found))
    )


def light_by_samples(
    problem: Problem, components: Sequence[str], known: Floats, error: float, target: float | None = None,
    like: Samples | None = None,
) -> Samples:  # fmt: skip
    """Some components by samples, beside the `known` light (H, T), which has the L2 error `error`; with the target of
    the problem where none is given. like : those of another scene, whose samplers and effort are taken, if given."""
    target = problem.accuracy.target if target is None else target
    by_paths = () if like is None else [name for name, of in like.sources.items() if isinstance(of, PathsOf)]
    by_blocks = [name for name in ("secondary", "higher") if name in components and name not in by_paths]
    blocks = Blocks(problem) if by_blocks else None
    sources = dict[str, Source]()
    for name in components:
        if blocks is not None and name in by_blocks:
            sources[name] = BlocksOf(blocks, 4 if name == "secondary" else problem.accuracy.max_bounces or LONGEST)
        else:
            sources[name] = PathsOf(problem, name)
    assert target is not None
    found = sample_to_target(sources, known.shape, target, known, error, None if like is None else like.found.turns)
    if blocks is None or like is not None:
        return Samples(sources, found)
    # In enclosures of narrow lobes blocks find little; paths, which follow the lobes, are better there.
    whole = l2_norm(known + sum(found.light.values()))
    poor = [
        name
        for name, light in found.light.items()
        if isinstance(sources[name], BlocksOf) and not is_enough(found.error[name], l2_norm(light), whole, target)
    ]
    if poor:
        paths: dict[str, Source] = {name: PathsOf(problem, name) for name in poor}
        kept = {name: light for name, light in found.light.items() if name not in poor}
        rest = math.hypot(error, *(found.error[name] for name in kept))
        # Whatever they claim: to choose what claims less is to choose what met less light.
        more = sample_to_target(paths, known.shape, target, known + sum(kept.values()), rest)
        found = found.with_components_of(more)
        sources |= paths
    return Samples(sources, found)


class Samples(NamedTuple):
    """Sampled light, and where each component comes from."""

    sources: dict[str, Source]
    found: Sampled


def _estimate_of(problem: Problem, first: Floats, primary: PrimaryLight | None, samples: Samples) -> Estimate:
    """One estimate from the primary by cuts, if there is one, and the sampled components, beside the known light
    `first` (H, T)."""
    shape, (sources, found), target = problem.capture.shape, samples, problem.accuracy.target
    assert target is not None
    light = {name: of.reshape(shape) for name, of in found.light.items()}
    parts, part_errors = dict[str, Floats](), dict[str, float]()
    samplers = {name: "blocks" if isinstance(of, BlocksOf) else "paths" for name, of in sources.items()}
    squares, overflow, rays = list(found.variance.values()), found.overflow(shape), dict(found.cost)
    error = math.hypot(*found.error.values())
    if primary is not None:
        light["primary"] = primary.total.reshape(shape)
        parts = {name: of.reshape(shape) for name, of in zip(problem.parts, primary.light, strict=False)}
        samplers["primary"], rays["primary"] = "cuts", primary.rays
        squares.append(primary.variance)
        overflow = overflow + primary.outside.reshape(shape[:2])
        part_errors, error = primary.part_errors, math.hypot(error, primary.error)
    elif "primary" in sources:
        by_paths = sources["primary"]
        assert isinstance(by_paths, PathsOf)
        parts = {name: of.reshape(shape) for name, of in by_paths.light_of_parts().items()}
    norm = l2_norm(sum(light.values(), start=first.reshape(shape)))
    # That no light was met does not say that there is none. Cuts know where they looked at all laser points, which
    # they do not for a flood.
    is_proven = primary is not None and not sources and not error and problem.capture.illumination != "flood"
    relative = error / norm if norm > 0 else 0.0 if is_proven or _is_dark(problem) else math.nan
    if norm > 0:
        # Replicates agree in what no ray can know.
        floor = known_to(problem.scene, problem.caster, problem.points, problem.capture.time)
        relative, part_errors = max(relative, floor), {name: max(own, floor) for name, own in part_errors.items()}
    stderr = np.sqrt(sum(squares[1:], start=squares[0])).reshape(shape)
    met = relative <= MET * target and all(own <= MET * problem.accuracy.each_part for own in part_errors.values())
    return Estimate(
        {name: light[name] for name in problem.components}, parts, stderr, overflow, relative, met, part_errors,
        {name: samplers[name] for name in problem.components}, {name: rays[name] for name in problem.components},
    )  # fmt: skip


def _is_dark(problem: Problem) -> bool:
    """Whether no light can come back within the window, whatever rays met."""
    # The laser points of a beam with cells are their middles, which do not stand for all of it.
    return problem.capture.laser.cells is None and _has_no_light(problem)


def _has_no_light(problem: Problem) -> bool:
    """Whether no light can come back within the window from the laser points."""
    return _ends_before_light(problem) or (
        not problem.accuracy.direct and has_none(problem.scene, problem.caster, problem.points)
    )


def _ends_before_light(problem: Problem) -> bool:
    """Whether the window ends before any light could come: a path is at least as long as the way from the laser to a
    laser point and straight to the sensor."""
    points, axis = problem.points, problem.capture.time
    back = np.linalg.norm(points.position - problem.capture.sensor.position, axis=1)
    shortest = np.nanmin(points.leg + back) if axis.origin == "source" else 0.0
    return bool(shortest >= path_from_time(axis.stop_s))
