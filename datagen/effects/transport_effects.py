"""The transport's rows of the table of effects."""

from __future__ import annotations

import math

from datagen.effects.rule import Change, Effect
from datagen.effects.scene_figures import SceneFigures, is_lambertian


def _measured(given: SceneFigures, component: str, what: str) -> Change:
    """The change if a component is left out: its share of the light of a trial run."""
    trial = given.trial
    if trial is None:
        return Change(None, "trial", "not measured: a trial run would cost too much of so small a transport")
    share = None if trial.dark else trial.share(component)
    if share is None:
        return Change(None, "trial", "the trial run met too little light to tell")
    return Change(share, "trial", f"{what} ≤ {share:.2g} of the indirect light in the trial run")


def _direct_return(given: SceneFigures) -> Change:
    """The change without the direct return: 0 if it is proven that there is none, and otherwise unknown.

    A trial run would not do: few pairs of laser points and pixels have a direct return, and it may miss them all.
    """
    if given.laser_point_in_view:
        return Change(None, "bound", "a pixel looks at a laser point: one bounce returns light")
    if not given.view_is_flush:
        return Change(None, "bound", "laser points may light a surface in view: two bounces return light")
    return Change(0.0, "bound", "no pixel sees a laser point in time, and laser points light nothing in view")


def _attenuation(given: SceneFigures) -> Change:
    """Bound on the change without attenuation, that of the longest path."""
    value = math.expm1(min(given.scene.attenuation_per_m * given.longest_path_m, 700.0))
    return Change(value, "bound", f"the longest path recorded, {given.longest_path_m:.3g} m, loses ≤ {value:.2g}")


def _without_secondary(given: SceneFigures) -> SceneFigures:
    """The transport without light of four bounces."""
    if given.accuracy.max_bounces == 4:
        return given.with_accuracy(max_bounces=3)
    return given.with_accuracy(secondary="none")


TRANSPORT_EFFECTS: tuple[Effect[SceneFigures], ...] = (
    Effect(
        "direct_return", "direct return", "transport", "`transport.direct`",
        "Radiometry of one and two bounces (docs/physics.md): f cosθ A/R² of a laser point in a pixel's cone; "
        "coplanar surfaces do not light each other",
        0.3, lambda g: g.accuracy.direct, _direct_return, lambda g: g.with_accuracy(direct=False),
    ),
    Effect(
        "occlusion", "occlusion", "transport", "surfaces", "Shadow rays (`transport/visibility/raycast.py`)",
        0.0, lambda g: True, "exact: a shadow ray for every connection that could carry energy",
        lambda g: g.with_accuracy(occlusion="off"), lambda g, setting: g.with_accuracy(occlusion="on"),
    ),
    Effect(
        "secondary_bounce", "secondary bounce", "transport", "`transport.max_bounces` ≥ 4 and `transport.secondary`",
        "Scholes & Leach, Sensors 24, 6522 (2024), Eq. 8",
        0.7, lambda g: g.highest_order >= 4 and g.accuracy.secondary != "none",
        lambda g: _measured(g, "secondary", "four bounces"), _without_secondary,
        lambda g, setting: g if setting == "on" else g.with_accuracy(secondary=setting),
    ),
    Effect(
        "higher_bounces", "higher bounces", "transport", "`transport.max_bounces` ≥ 5, or none",
        "The same, continued",
        0.8, lambda g: g.highest_order >= 5, lambda g: _measured(g, "higher", "five bounces and more"),
        lambda g: g.with_accuracy(max_bounces=3 if g.accuracy.secondary == "none" else 4),
    ),
    Effect(
        "brdf", "non-Lambertian BRDF", "transport", "a surface that is not Lambertian",
        "`transport/brdf`; left out, the Lambertian surface of the same mean albedo (`effects/scene_figures.py`)",
        0.0, lambda g: not all(is_lambertian(material) for material in g.scene.materials),
        "as quick as Lambertian surfaces, and it takes a trial run of its own to show that a lobe does not matter",
        lambda g: g.all_lambertian,
    ),
    Effect(
        "attenuation", "atmospheric attenuation", "transport", "`attenuation_per_m` > 0",
        "Beer & Lambert: exp(−a R), R at most what the time window holds",
        0.1, lambda g: g.scene.attenuation_per_m > 0, _attenuation, lambda g: g.with_scene(attenuation_per_m=0.0),
    ),
    Effect(
        "extended_surfaces", "extended surfaces", "transport",
        "walls, floor or ceiling out of view that return light", "Eq. 6 split by the part of the hidden vertex",
        0.0, lambda g: bool(g.hidden_structure), "of 100 random rooms none had walls that could be left out",
        lambda g: g.without_structure,
    ),
)  # fmt: skip
