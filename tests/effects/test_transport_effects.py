"""Each estimate of the transport's table bounds the change if the effect is left out; `auto` leaves out the effects
that do not matter, and no others."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from rooms import furnished_box, square_pixels

from datagen.config import EffectsConfig
from datagen.effects import EFFECTS, EffectDecisions, decide_transport_effects, trial
from datagen.records import Accuracy, Capture, Laser, Scene, Sensor, TimeAxis
from datagen.transport import simulate
from datagen.transport.laser_points import LaserPoints
from datagen.transport.rays import Raycaster

DEVICE = (1.5, 0.1, 1.3)
SPOTS = [(0, y, z) for y in (-0.8, 0.8) for z in (0.8, 1.6)]
VIEWS = [(0, y, z) for y in (-0.3, 0.3) for z in (0.9, 1.5)]
AXIS = TimeAxis(128, 0.4e-9, 0.0, "wall")
EVERYTHING = EffectsConfig.model_validate({row.name: "on" for row in EFFECTS})


def capture(pairing: str = "exhaustive", time: TimeAxis = AXIS) -> Capture:
    at = VIEWS if pairing == "exhaustive" else SPOTS
    return Capture(Laser(DEVICE, SPOTS), Sensor(DEVICE, square_pixels(at, 0.1)), time, pairing)  # type: ignore[arg-type]


def accuracy(max_bounces: int | None = 3, direct: bool = False) -> Accuracy:
    return Accuracy(samples=131072, max_bounces=max_bounces, direct=direct)


def left_out_change(scene: Scene, looked: Capture, wanted: Accuracy, effect: str) -> float:
    """Relative L2 change of the transient when only this effect is off, noise cancelled (two seeds)."""
    off = EffectsConfig.model_validate({row.name: "off" if row.name == effect else "on" for row in EFFECTS})
    runs, wanted = {}, replace(wanted, samples=1024)
    for name, settings in (("on", EVERYTHING), ("off", off)):
        plan = decide_transport_effects(scene, looked, wanted, settings)
        reduced, fewer = plan.apply_transport(scene, looked, wanted)
        runs[name] = [simulate(reduced, looked, fewer, seed=seed, split_parts=False).total for seed in (1, 2)]
    a, b = (runs["off"][k] - runs["on"][k] for k in (0, 1))
    square = float((a * b).sum() / (runs["on"][0] * runs["on"][1]).sum())
    return float(np.sqrt(max(square, 0.0)))


def planned(scene: Scene, looked: Capture, wanted: Accuracy, seed: int = 3) -> EffectDecisions:
    return decide_transport_effects(scene, looked, wanted, seed=seed)


CASES: dict[str, list[tuple[Scene, Capture, Accuracy, bool]]] = {
    "direct_return": [
        (furnished_box(), capture("confocal"), accuracy(direct=True), True),
        (furnished_box(), capture(), accuracy(direct=True), False),
        (furnished_box(), capture("confocal", TimeAxis(128, 0.4e-9, 2e-9, "wall")), accuracy(direct=True), False),
    ],
    "secondary_bounce": [
        (furnished_box(0.7), capture(), accuracy(4), True),
        (furnished_box(0.004), capture(), accuracy(4), False),
    ],
    "higher_bounces": [
        (furnished_box(0.7), capture(), accuracy(None), True),
        (furnished_box(0.02), capture(), accuracy(None), False),
    ],
    "attenuation": [
        (replace(furnished_box(), attenuation_per_m=0.05), capture(), accuracy(), True),
        (replace(furnished_box(), attenuation_per_m=2e-4), capture(), accuracy(), False),
    ],
}  # fmt: skip


@pytest.mark.parametrize("effect", CASES)
def test_estimate_bounds_the_change(effect: str) -> None:
    for scene, looked, wanted, matters in CASES[effect]:
        decision = planned(scene, looked, wanted)[effect]
        change = left_out_change(scene, looked, wanted, effect)
        assert decision.simulated is matters
        assert decision.estimate is None or decision.estimate >= change
        if matters:
            assert change > 0.01
        else:
            assert decision.estimate is not None
            assert change <= decision.estimate <= 0.01


def test_share_left_out_together_stays_within_the_tolerance() -> None:
    """Each of these alone could go; all of them together could not."""
    scene = replace(furnished_box(0.012), attenuation_per_m=3e-4)
    alone = {d.effect: d.estimate for d in planned(scene, capture(), accuracy(None)).decisions}
    for tolerance in (0.001, 0.003, 0.01, 0.03, 0.1):
        plan = decide_transport_effects(scene, capture(), accuracy(None), EffectsConfig(tolerance=tolerance), seed=3)
        gone = [d for d in plan.decisions if d.left_out]
        together = math.prod(1 + d.estimate for d in gone if d.estimate is not None) - 1
        assert together <= tolerance * (1 + 1e-12)
        for decision in plan.decisions:
            if decision.kind in ("bound", "trial") and decision.simulated and decision.estimate is not None:
                assert decision.estimate > decision.allowance
        assert {d.effect for d in gone} <= set(alone)
    assert len(gone) >= 3


def test_a_trial_run_decides_only_what_it_can() -> None:
    """One that meets no light proves nothing, a small transport is not worth one, and three bounces leave nothing."""
    far = capture(time=TimeAxis(64, 1e-10, 1e-6, "wall"))
    dark = planned(furnished_box(), far, accuracy(5))
    few = planned(furnished_box(), capture(), Accuracy(samples=64, max_bounces=4))
    assert all(dark[effect].simulated for effect in ("secondary_bounce", "higher_bounces"))
    assert few["secondary_bounce"].simulated and "cost" in few["secondary_bounce"].reason
    decided = planned(furnished_box(0.7), capture(), accuracy(3))
    assert "trial" not in {decision.kind for decision in decided.decisions}


def test_both_runs_of_a_trial_are_independent() -> None:
    """Over 100 seeds the noise of one must not show in the other: Σ cov(a, b) over all
    channels and bins is 0 to within 4 standard errors, where Σ var(a) is many times as much."""
    few = Accuracy(samples=1024, max_bounces=4)
    looked, room = replace(capture(), illumination="flood"), furnished_box(0.7)
    caster = Raycaster(room)
    points = LaserPoints.of(caster, room, looked.laser)
    # A trial takes two seeds, its own and the next one.
    runs = [trial.run_trial(room, looked, few, seed, caster, points) for seed in range(0, 200, 2)]
    total = np.array([sum(run.components.values()) for run in runs])
    assert total.shape == (100, 2, 4, AXIS.bins)
    noise = (total - total.mean(axis=0)) / np.sqrt(1 - 1 / len(runs))
    shared = (noise[:, 0] * noise[:, 1]).sum(axis=(1, 2))
    error = shared.std() / np.sqrt(len(shared))
    assert abs(shared.mean()) < 4 * error
    assert (noise[:, 0] ** 2).sum(axis=(1, 2)).mean() > 20 * error
