"""What a matched filter makes of drawn histograms: the truth that a stated significance is held against.

    PYTHONPATH=. python tests/evidence/matched_filter.py 200

prints measured over stated separation for so many random scenes, a detector of another kind for each.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from functools import cache

import numpy as np

import datagen as dg
from datagen.config import config_from_mapping
from datagen.detector.own_light import own_light
from datagen.records import Transient

BINS, WIDTH_S = 128, 4e-10
PERIOD_S = BINS * WIDTH_S
DRAWS = 1000
SIGMA = 6.0
"""What every scene's exposure brings σ to, where drawing it takes a bearable time."""
MODES = ("ideal", "one a cycle", "gated", "free running", "dead for three bins")
DEAD_S = {"ideal": 0.0, "gated": 0.0, "one a cycle": 2 * PERIOD_S, "free running": 20 * WIDTH_S}


@cache
def config() -> dg.DatasetConfig:
    return config_from_mapping(
        {
            "seed": 9,
            "scene": {"layout": {"kind": "l_corridor"}, "contents": [{"kind": "pillar"}]},
            "capture": {"scan": {"rows": 2, "columns": 2}, "time": {"bins": BINS, "bin_width_ps": 1e12 * WIDTH_S}},
            "transport": {"target": 0.2},
        }
    )


@cache
def light_of(scene: int) -> Transient:
    room = dg.generate_scene(config().scene, config().seed, scene)
    capture = dg.capture_for(config(), room, config().seed, scene)
    return dg.simulate(room, capture, dg.Accuracy(target=0.2), seed=scene)


def detector(mode: str, light: Transient, scene: int) -> tuple[dg.Spad, dg.Exposure]:
    """One under which the dead time takes a tenth to a third of all detections, if it has one."""
    rng = np.random.default_rng(scene)
    dead = DEAD_S.get(mode, 3 * WIDTH_S)
    spad = dg.Spad(
        pde=0.3, dead_time_s=dead, dark_count_rate_hz=float(rng.uniform(0, 1e6)),
        mode="ideal" if dead == 0 else "synchronous" if mode == "one a cycle" else "free_running",
        gate_start_s=10 * WIDTH_S if mode == "gated" else None,
        gate_width_s=100 * WIDTH_S if mode == "gated" else None,
    )  # fmt: skip
    each_pulse = float(rng.uniform(0.1, 0.5)) / 0.3 / float(light.total.sum(axis=-1).max())
    exposure = dg.Exposure(
        repetition_rate_hz=1 / PERIOD_S, cycles=1000, photons_per_pulse=each_pulse,
        ambient_rate_hz=float(rng.uniform(0, 1e6)),
    )  # fmt: skip
    one = dg.own_evidence(light, spad, exposure, ["pillar"])["pillar"].significance
    return spad, replace(exposure, cycles=int(min(1e3 * (SIGMA / one) ** 2, 4e3 if dead else 1e15)) + 10)


def armed_cycles(counts: np.ndarray, spad: dg.Spad, exposure: dg.Exposure) -> np.ndarray:
    """(…, bin) cycles in which the diode was armed, as the histogram tells: a detection takes it away for so long."""
    cycles = np.full(counts.shape, float(exposure.cycles))
    if spad.mode == "ideal":
        return cycles
    if spad.mode == "synchronous":
        return cycles - np.cumsum(counts, axis=-1) + counts
    bins = round(spad.dead_time_s / WIDTH_S)
    for back in range(1, bins + 1):
        cycles -= (0.5 if back == bins else 1.0) * np.roll(counts, back, axis=-1)
    return cycles - 0.5 * counts


def separation(scene: int, mode: str) -> tuple[float, float, float]:
    """Stated σ, measured separation of the matched filter's mean with the pillar's light from that without it, and
    the standard error of the latter. Both in standard deviations with it."""
    light = light_of(scene)
    spad, exposure = detector(mode, light, scene)
    stated = dg.own_evidence(light, spad, exposure, ["pillar"])["pillar"].significance
    own = light.parts["pillar"]
    blocks = list(own_light(light.total, [own], light.time, spad, exposure))
    everything = np.concatenate([block.everything for block in blocks])
    weight = np.concatenate([block.own[0] for block in blocks]) / np.maximum(everything, 1e-300)
    rate = np.clip(everything / armed_cycles(everything, spad, exposure), 0.0, None)
    answers = []
    for seed, seen in enumerate((light.total, np.maximum(light.total - own, 0.0))):
        many = np.tile(seen, (DRAWS, 1, 1))
        counts = dg.detect(many, light.time, spad, exposure, seed=2 * scene + seed).astype(np.float64)
        counts = counts.reshape(DRAWS, *own.shape)
        surplus = counts - rate * armed_cycles(counts, spad, exposure)
        answers.append((weight * surplus).sum(axis=(1, 2, 3)))
    with_it, without = answers
    spread = with_it.std(ddof=1)
    measured = (with_it.mean() - without.mean()) / spread
    # Of a standard deviation the error depends on the fourth moment: weights are large where little is seen.
    fourth = float((((with_it - with_it.mean()) / spread) ** 4).mean())
    error = np.hypot(
        np.sqrt(1 + without.var() / spread**2) / np.sqrt(DRAWS), measured * np.sqrt((fourth - 1) / (4 * DRAWS))
    )
    return stated, float(measured), float(error)


if __name__ == "__main__":
    ratios, beyond = [], []
    for number in range(int(sys.argv[1]) if len(sys.argv) > 1 else 200):
        kind = MODES[number % len(MODES)]
        says, found, unsure = separation(number, kind)
        ratios.append(found / says)
        beyond.append((found - says) / unsure)
        print(f"{number:4d} {kind:20s} {says:8.3f} {found:8.3f} ± {unsure:.3f}  {found / says:.3f}", flush=True)
    print(f"median {np.median(ratios):.4f}; farthest {np.abs(beyond).max():.2f} standard errors")
