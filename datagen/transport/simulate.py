"""Light transport: from scene and capture to transient, and the choice of the integrator.

With a target (`Accuracy.target`) `error_control/meet_target.py` chooses: quadrature where that is possible, sampled
paths for the rest. With sample counts path tracing (`path_tracing/`) computes all components. The one exception is
the secondary: its factorised form (`factorised/`) is used if `Accuracy.observed` asks for it, or if path tracing
would seldom meet the surfaces that the secondary comes from.
"""

from __future__ import annotations

import time as clock_time
from dataclasses import replace
from functools import cache, partial
from warnings import warn

import numpy as np

from datagen.errors import InputError, InputWarning
from datagen.records import Accuracy, Capture, Scene, Spend, Transient
from datagen.records.arrays import Bools, Ints
from datagen.records.checks import check_kind, check_seed
from datagen.transport.brdf import MaterialTable
from datagen.transport.error_control.meet_target import meet_target
from datagen.transport.error_control.stratum import OBSERVED
from datagen.transport.error_control.surroundings import CONTACT, surroundings
from datagen.transport.factorised.secondary import factorising, secondary_transient
from datagen.transport.fields_of_view import PixelCones, PixelPatches
from datagen.transport.flood import as_scan, flooded, one_bounce_of_beam
from datagen.transport.path_tracing.averages import Average, Estimate, path_average, rays_of, split_rows
from datagen.transport.path_tracing.vertices import AreaTarget, LaserPoints
from datagen.transport.problem import Problem, TallyRows, components_asked
from datagen.transport.visibility.coincidence import set_apart
from datagen.transport.visibility.raycast import Raycaster


def simulate(
    scene: Scene, capture: Capture, accuracy: Accuracy | None = None, seed: int = 0, *, split_parts: bool = True
) -> Transient:
    """Follow light from each laser point around the corner and back.

    The photons that reach the aperture per emitted photon; with f the BRDFs, V the visibility, x₁ the laser point,
    x₂ a hidden vertex and x₃ a FoV point, the primary (three bounces) is (docs/physics.md; the paths are those of Eq.
    6 of Scholes & Leach, Sensors 24, 6522 (2024), with radiometric weights)

        L = ∫∫ f₁ cosθ₁ cosθ₂ V₁₂/R₁₂² · f₂ · cosθ₂′ cosθ₃ V₂₃/R₂₃² · f₃ cosθ₃′ V₃ₛ A/R₃ₛ² dA₂ dA₃

    and each further bounce adds a surface between x₂ and x₃. Light is traced from the laser point; every vertex is
    connected with FoV points, which gives all orders at once (the secondary is that of Eq. 8, all paths).

    Parameters
    ----------
    scene, capture : what is looked at, and how.
    accuracy : sample counts and effects, or the error to be met; default `Accuracy()`.
    seed : any integer ≥ 0; the same arguments and seed give the same transient.
    split_parts : also keep the primary split by part (`Transient.parts`), K times the memory for K parts.

    Returns
    -------
    Transient with arrays (L, P, T), photons at the aperture per emitted photon and bin. A laser ray that meets
    nothing, or a pixel that sees nothing, gives zeros. Flood illumination gives the weighted mean over its laser
    points, (1, P, T), with L as the number of points of its quadrature (`transport/flood.py`).

    Raises
    ------
    InputError : for a pixel that is no convex quadrilateral, a negative seed, an argument of another type, or a
        target for a sensor with footprints (`Sensor.footprints`), which needs sample counts.

    Warns
    -----
    InputWarning : no light falls into the time axis, though some arrives outside it: mostly a scene in millimetres; a
        laser ray meets nothing, or, where there is a relay wall and `accuracy.direct` is off, an object; surfaces of
        two parts coincide where light gets to, and one is taken to lie on the other
        (`transport/visibility/coincidence.py`).

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
    >>> t = dg.simulate(scene, capture, dg.Accuracy(lookins=1024, max_bounces=4), seed=0)
    >>> t.total.shape, sorted(t.components), bool(t.parts["box"].sum() > 0)
    ((1, 2, 200), ['primary', 'secondary'], True)
    """
    check_kind("scene", scene, Scene)
    check_kind("capture", capture, Capture)
    accuracy = Accuracy() if accuracy is None else accuracy
    check_kind("accuracy", accuracy, Accuracy, remedy="an error to be met is Accuracy(target=0.05)")
    check_seed(seed)
    if capture.sensor.footprints is not None and accuracy.target is not None:
        raise InputError(
            f"Accuracy.target = {accuracy.target:g} with Sensor.footprints: a target is met for pixels of even "
            "sensitivity only; give sample counts instead, such as Accuracy(lookins=1024, fov_samples=4)"
        )
    apart = set_apart(scene, capture)
    if apart.warning:
        warn(f"simulate: {apart.warning}", InputWarning, stacklevel=2)
    scene = apart.scene
    caster = Raycaster(scene)
    astray = _astray(scene, accuracy, LaserPoints.of(caster, scene, capture.laser).part)
    if astray:
        warn(f"simulate: {astray}", InputWarning, stacklevel=2)
    found = transient_of(scene, capture, accuracy, seed, split_parts=split_parts, caster=caster)
    if found.overflow.any() and not found.total.any():
        start, stop = capture.time.start_s * 1e9, capture.time.stop_s * 1e9
        warn(
            f"simulate: all light arrives outside the time axis, {start:.4g} … {stop:.4g} ns; is the scene in m?",
            InputWarning, stacklevel=2,
        )  # fmt: skip
    return found


def _astray(scene: Scene, accuracy: Accuracy, part: Ints) -> str:
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
    if capture.illumination == "flood":
        caster = Raycaster(scene) if caster is None else caster
        one_by_one = transient_of(
            scene, as_scan(capture), accuracy, seed, split_parts=split_parts, caster=caster
        )  # fmt: skip
        first = None
        if capture.laser.cells is not None and accuracy.direct:
            first = one_bounce_of_beam(scene, capture, caster, MaterialTable.of(scene.materials))
        return flooded(one_by_one, capture, first, scene.part_names if split_parts else ())
    began = clock_time.perf_counter()
    problem = prepared(scene, capture, accuracy, seed, split_parts=split_parts, caster=caster)
    ready = clock_time.perf_counter()
    if accuracy.target is not None:
        estimate, traced = meet_target(problem), clock_time.perf_counter()
    else:
        average = path_average(problem)
        traced = clock_time.perf_counter()
        estimate = _with_factorised(problem, average)
    finished = clock_time.perf_counter()
    seconds = {"prepare": ready - began, "trace": traced - ready, "secondary": finished - traced}
    return Transient(time=capture.time, laser_points=problem.points.position, seconds=seconds, **vars(estimate))


def prepared(
    scene: Scene, capture: Capture, accuracy: Accuracy, seed: int, *, split_parts: bool,
    caster: Raycaster | None = None,
) -> Problem:  # fmt: skip
    """The problem that the integrators of `simulate` solve."""
    caster = Raycaster(scene) if caster is None else caster
    materials = MaterialTable.of(scene.materials)
    cones = PixelCones.of(capture.sensor)
    points = LaserPoints.of(caster, scene, capture.laser)
    splits = TallyRows(scene.part_names if split_parts else (), components_asked(accuracy), len(scene.part_names))
    problem = Problem(
        scene, capture, accuracy, caster, materials, cones,
        PixelPatches.of(caster, capture.sensor, cones, accuracy.fov_samples), points,
        cache(partial(AreaTarget.choose, caster, scene, materials, points, seed)), seed, splits,
        _walked(accuracy, materials),
    )  # fmt: skip
    if _factorises_unasked(problem):
        counts = replace(accuracy, observed=OBSERVED)
        problem = replace(problem, accuracy=counts, walked=~factorising(materials))
    return problem


def _factorises_unasked(problem: Problem) -> bool:
    """Whether the secondary needs the factorised form although `Accuracy.observed` does not ask for it: path tracing
    would seldom meet the surfaces beside the field of view that it comes from."""
    accuracy = problem.accuracy
    unasked = accuracy.target is None and accuracy.observed is None and accuracy.occlusion != "off"
    if not unasked or "secondary" not in problem.tally_rows.components or not factorising(problem.materials).any():
        return False
    return surroundings(problem, problem.seed) > CONTACT


def _walked(accuracy: Accuracy, materials: MaterialTable) -> Bools:
    """(K,) whether path tracing finds the secondary by a part: of all parts, of none, or of those that do not
    factorise."""
    if accuracy.secondary == "none":
        return np.zeros(len(materials.kind), np.bool_)
    return np.ones(len(materials.kind), np.bool_) if accuracy.observed is None else ~factorising(materials)


def _with_factorised(problem: Problem, average: Average) -> Estimate:
    """The result of path tracing, to which the factorised form adds its part of the secondary.

    Their errors are independent and add up as squares.
    """
    accuracy, splits = problem.accuracy, problem.tally_rows
    components, parts = split_rows(average.rows, splits)
    stderr, overflow = average.stderr, average.overflow
    costs = dict.fromkeys(components, average.work.cost / len(components))
    way = dict.fromkeys(components, "walk")
    if "secondary" in components and not problem.walked.all():
        assert accuracy.observed is not None
        more = secondary_transient(problem, accuracy.observed, ~problem.walked)
        components["secondary"] += more.rows[0]
        np.hypot(stderr, more.stderr, out=stderr)
        overflow += more.overflow
        way["secondary"] = "walk + factorised" if problem.walked.any() else "factorised"
        costs["secondary"] = more.work.cost + costs["secondary"] * bool(problem.walked.any())
    total = sum(costs.values())
    spend = Spend(
        lookins=dict.fromkeys(components, float(accuracy.lookins)),
        share={name: value / total if total > 0 else 0.0 for name, value in costs.items()}, way=way,
        fov_samples=dict.fromkeys(components, int(accuracy.fov_samples)), rounds=1, cost=total,
        outcome="sample counts as given",
    )  # fmt: skip
    return Estimate(components, parts, stderr, overflow, spend, rays=rays_of(problem, average.work))
