"""The transport's rows of the table: which light is followed, and how much it would be missed."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from datagen.effects.decision import Effect, Estimate
from datagen.effects.lobes import is_lambertian, is_smooth, largest_deviation
from datagen.effects.pilot import SHARE, Pilot
from datagen.effects.transport_world import TransportWorld

CONNECTIONS_PER_PROOF = 8
"""FoV points that a vertex is joined to, from which a proof that it sees all of them is tried before rays. With fewer
the transport took 0.97 to 1.4 times as long with proofs as without, in rooms of 40 to 2800 triangles."""
MOST_VERTICES = 16
"""Vertices of a path on surfaces that are not Lambertian, at most, where there is no limit to its bounces."""


def _measured(pilot: Pilot | None, found: list[NDArray[np.float64]], what: str) -> Estimate:
    """How much of the light a pilot saw going `what` way."""
    if pilot is None:
        return Estimate(None, "pilot", "not measured: a pilot would cost too much of so small a transport")
    share = None if pilot.dark else pilot.share(*found)
    if share is None:
        return Estimate(None, "pilot", "the pilot met too little light to tell")
    return Estimate(share, "pilot", f"{what} ≤ {share:.2g} of the indirect light in the pilot")


def _of(pilot: Pilot | None, *names: str) -> list[NDArray[np.float64]]:
    return [] if pilot is None else [pilot.components[name] for name in names if name in pilot.components]


def _direct_return(world: TransportWorld, gone: frozenset[str]) -> Estimate:
    if world.view_is_flush and not world.spot_in_view:
        return Estimate(0.0, "bound", "no pixel sees a laser point in time, and laser points light nothing in view")
    return _measured(world.pilot, _of(world.pilot, "direct"), "direct light")


def _occlusion(world: TransportWorld, gone: frozenset[str]) -> Estimate:
    if world.in_the_way == 0:
        return Estimate(0.0, "bound", "all surfaces are walls with the whole scene on one side: none hides another")
    return Estimate(
        None, "bound", f"{world.in_the_way} triangles may hide others: a shadow ray wherever no proof excludes it"
    )


def _sooner_asked(world: TransportWorld) -> TransportWorld:
    """A proof of clear sight takes as long as some rays: it pays where it stands for many."""
    each = world.capture.shape[1] * world.accuracy.fov_samples
    few = world.accuracy.target is None and each < CONNECTIONS_PER_PROOF
    return world.with_accuracy(occlusion="on") if few and world.accuracy.occlusion == "auto" else world


def _secondary(world: TransportWorld, gone: frozenset[str]) -> Estimate:
    return _measured(world.pilot, _of(world.pilot, "secondary"), "four bounces")


def _higher(world: TransportWorld, gone: frozenset[str]) -> Estimate:
    return _measured(world.pilot, _of(world.pilot, "higher"), "five bounces and more")


def _extended(world: TransportWorld, gone: frozenset[str]) -> Estimate:
    """What structure sends back at once, and all light of more bounces, as if all of it went by the structure."""
    pilot = world.pilot
    if pilot is None:
        return _measured(None, [], "")
    structure = [pilot.parts[world.scene.part_names[k]] for k in world.hidden_structure]
    kept = [
        name
        for name, effect in (("secondary", "secondary_bounce"), ("higher", "higher_bounces"))
        if effect not in gone
    ]
    return _measured(pilot, structure + _of(pilot, *kept), "light by way of walls, floor and ceiling")


def _lobed(world: TransportWorld) -> list[int]:
    return [k for k, material in enumerate(world.scene.materials) if not is_lambertian(material)]


def _brdf(world: TransportWorld, gone: frozenset[str]) -> Estimate:
    """Lobes by their bounds; smooth surfaces by what the pilot changes when they are Lambertian. It takes a pilot of
    its own, which seldom shows that lobes may be left out: it is made where it is cheap beside the transport."""
    if not world.can_afford_pilot(SHARE):
        return _measured(None, [], "")
    materials = world.scene.materials
    smooth = [k for k in _lobed(world) if is_smooth(materials[k])]
    bounds = {k: largest_deviation(materials[k]) for k in _lobed(world) if k not in smooth}
    ends = (world.spot_parts, world.view_parts)
    at_ends = math.prod(1.0 + max((bounds.get(k, 0.0) for k in parts), default=0.0) for parts in ends)
    if math.isinf(sum(bounds.values())) or at_ends > 2.0:
        return Estimate(None, "bound", "a lobe has no useful bound where it is")
    matt = world.all_lambertian.pilot
    if matt is None or matt.dark:
        return _measured(matt, [], "")
    change = _by_lobes(world, matt, bounds)
    if change is None or at_ends * (1.0 + change) >= 2.0:
        return Estimate(None, "pilot", "lobes may differ from Lambert's law by more than the light they meet")
    change = at_ends * (1.0 + change) - 1.0
    # So far relative to the Lambertian light; what is asked is relative to the true one.
    value = change / (1.0 - change)
    if smooth:
        pilot = world.pilot
        if pilot is None or pilot.dark:
            return _measured(pilot, [], "")
        apart = pilot.share(*matt.components.values(), *(-component for component in pilot.components.values()))
        if apart is None:
            return _measured(pilot, [], "")
        value += apart
    return Estimate(value, "pilot", f"Lambert's law instead changes the light by ≤ {value:.2g} in the pilot")


def _by_lobes(world: TransportWorld, matt: Pilot, bounds: dict[int, float]) -> float | None:
    """Σ of |f / f_L − 1| over a path's inner vertices, weighed with the Lambertian light that takes each path."""
    if not bounds:
        return 0.0
    vertices = min(world.highest_order - 2, MOST_VERTICES)
    crossed = {"secondary": (1.0 + max(bounds.values())) ** 2 - 1.0}
    crossed["higher"] = (1.0 + max(bounds.values())) ** vertices - 1.0
    ways = [(factor, _of(matt, name)) for name, factor in crossed.items()]
    ways += [(d, [matt.parts[world.scene.part_names[k]]]) for k, d in bounds.items()]
    shares = [(factor, matt.share(*found)) for factor, found in ways if found]
    if any(share is None for _, share in shares):
        return None
    return sum(factor * share for factor, share in shares if share)


def _attenuation(world: TransportWorld, gone: frozenset[str]) -> Estimate:
    value = math.expm1(min(world.scene.attenuation_per_m * world.longest_path_m, 700.0))
    return Estimate(value, "bound", f"the longest path recorded, {world.longest_path_m:.3g} m, loses ≤ {value:.2g}")


def _without_secondary(world: TransportWorld) -> TransportWorld:
    if world.accuracy.max_bounces == 4:
        return world.with_accuracy(max_bounces=3)
    return world.with_accuracy(secondary="none")


def _without_higher(world: TransportWorld) -> TransportWorld:
    return world.with_accuracy(max_bounces=3 if world.accuracy.secondary == "none" else 4)


def _always_secondary(world: TransportWorld, setting: str | int) -> TransportWorld:
    return world if setting == "on" else world.with_accuracy(secondary=setting)


TRANSPORT_EFFECTS: tuple[Effect[TransportWorld], ...] = (
    Effect(
        "direct_return", "direct return", "transport",
        "`transport.direct`",
        "Radiometry of one and two bounces (DESIGN, sec. 2); coplanar surfaces do not light each other",
        0.3, lambda w: w.accuracy.direct, _direct_return, lambda w: w.with_accuracy(direct=False),
    ),
    Effect(
        "occlusion", "occlusion", "transport",
        "surfaces",
        "Separating planes (`transport/clearance.py`)",
        0.05, lambda w: True, _occlusion, lambda w: w.with_accuracy(occlusion="off"),
        lambda w, setting: w.with_accuracy(occlusion="on"), _sooner_asked,
    ),
    Effect(
        "secondary_bounce", "secondary bounce", "transport",
        "`transport.max_bounces` ≥ 4 and `transport.secondary`",
        "Scholes & Leach, Sensors 24, 6522 (2024), Eq. 8",
        0.7, lambda w: w.highest_order >= 4 and w.accuracy.secondary != "none", _secondary, _without_secondary,
        _always_secondary,
    ),
    Effect(
        "higher_bounces", "higher bounces", "transport",
        "`transport.max_bounces` ≥ 5, or none",
        "The same, continued",
        0.8, lambda w: w.highest_order >= 5, _higher, _without_higher,
    ),
    Effect(
        "brdf", "non-Lambertian BRDF", "transport",
        "a surface that is not Lambertian",
        "Extremes of each model's formula (`effects/lobes.py`); a pilot with Lambertian surfaces beside one without",
        0.5, lambda w: bool(_lobed(w)), _brdf, lambda w: w.all_lambertian,
    ),
    Effect(
        "attenuation", "atmospheric attenuation", "transport",
        "`attenuation_per_m` > 0",
        "Beer & Lambert: exp(−a R), R at most what the time window holds",
        0.1, lambda w: w.scene.attenuation_per_m > 0, _attenuation,
        lambda w: w.with_attenuation(0.0),
    ),
    Effect(
        "extended_surfaces", "extended surfaces", "transport",
        "walls, floor or ceiling out of view that return light",
        "Eq. 6 split by the part that holds the lookin",
        0.6, lambda w: bool(w.hidden_structure), _extended, lambda w: w.without_structure,
    ),
)  # fmt: skip
