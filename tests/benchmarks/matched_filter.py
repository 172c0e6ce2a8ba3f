"""The separation of a matched filter on drawn histograms, with which a stated significance is compared.

    python tests/benchmarks/matched_filter.py 200

prints measured over stated separation for 200 random scenes of the ready configurations, with scans of 2 × 2 points
and different kinds of detectors.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np
from scipy.stats import norm

import datagen as dg
from datagen.config import config_from_mapping
from datagen.detector.own_light import own_light
from datagen.records import Transient

BINS, WIDTH_S = 128, 4e-10
PERIOD_S = BINS * WIDTH_S
SIGMA = 6.0
"""Significance for which every scene's exposure is chosen, unless drawing it would take too long."""
MODES = ("ideal", "one a cycle", "gated", "free running", "dead for three bins")
DEAD_S = {"ideal": 0.0, "gated": 0.0, "one a cycle": 2 * PERIOD_S, "free running": 20 * WIDTH_S}


@cache
def ready() -> tuple[dg.DatasetConfig, ...]:
    """The rooms and contents of every ready configuration that draws them and in which nothing moves, seen by a scan
    of 2 × 2 points."""
    capture = {"scan": {"rows": 2, "columns": 2}, "time": {"bins": BINS, "bin_width_ps": 1e12 * WIDTH_S}}
    small = config_from_mapping({"seed": 9, "capture": capture})
    found = map(dg.load_config, sorted((Path(__file__).parents[2] / "configs").glob("*.yaml")))
    lean = {"seed": small.seed, "capture": small.capture}
    return tuple(of.model_copy(update=lean) for of in found if of.scenes > 1 and of.sequence is None)


@cache
def light_of(number: int) -> tuple[Transient, str]:
    """The transient of random scene `number`, and the name of the object that brings most light to it."""
    config = ready()[number % len(ready())]
    index = number // len(ready())
    while True:
        room = dg.generate_scene(config.scene, config.seed, index)
        capture = dg.capture_for(config, room, config.seed, index)
        light = dg.simulate(room, capture, dg.Accuracy(target=0.2), seed=index)
        brings = {name: float(light.parts[name].sum()) for name in room.objects}
        name = max(brings, key=lambda of: brings[of], default="")
        if name and brings[name] > 0:
            return light, name
        # A room whose objects bring no light is replaced by another one.
        index += 1000


def detector(mode: str, light: Transient, name: str, scene: int) -> tuple[dg.Spad, dg.Exposure]:
    """A detector whose dead time, if there is one, removes a tenth to a third of all detections."""
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
    one = dg.own_evidence(light, spad, exposure, [name])[name].significance
    return spad, replace(exposure, cycles=int(min(1e3 * (SIGMA / one) ** 2, 4e3 if dead else 1e15)) + 10)


def armed_cycles(counts: np.ndarray, spad: dg.Spad, exposure: dg.Exposure) -> np.ndarray:
    """(…, bin) number of cycles in which the diode was armed, from the counts before the bin within the dead time."""
    cycles = np.full(counts.shape, float(exposure.cycles))
    if spad.mode == "ideal":
        return cycles
    if spad.mode == "synchronous":
        return cycles - np.cumsum(counts, axis=-1) + counts
    bins = round(spad.dead_time_s / WIDTH_S)
    for back in range(1, bins + 1):
        cycles -= (0.5 if back == bins else 1.0) * np.roll(counts, back, axis=-1)
    return cycles - 0.5 * counts


@dataclass(frozen=True)
class Separation:
    """The stated σ, and the measured separation of the matched filter's means with and without an object's light, in
    standard deviations with it.

    error : standard error of `measured`.
    follows : the separation that the law of the detector predicts. Without the object the filter's mean is
        −Σ w_i s⁰_i, with w = s/b and s⁰_i = N A⁰_i λᵒ_i, the detections of its light by a diode that is armed as
        often as without it. So the separation is Σ w_i s⁰_i / σ, which is σ if the object's light causes no dead
        time.
    """

    stated: float
    measured: float
    error: float
    follows: float

    @property
    def beyond(self) -> float:
        """Difference of the measured from the predicted separation, in standard errors."""
        return abs(self.measured - self.follows) / self.error


def separation(scene: int, mode: str, draws: int = 1000) -> Separation:
    """The separation in random scene `scene` under a detector of kind `mode`, by so many histograms with and without
    the object."""
    light, name = light_of(scene)
    spad, exposure = detector(mode, light, name, scene)
    stated = dg.own_evidence(light, spad, exposure, [name])[name].significance
    own = light.parts[name]
    blocks = list(own_light(light.total, [own], light.time, spad, exposure))
    everything = np.concatenate([block.everything for block in blocks])
    weight = np.concatenate([block.own[0] for block in blocks]) / np.maximum(everything, 1e-300)
    rate = np.clip(everything / armed_cycles(everything, spad, exposure), 0.0, None)
    answers = []
    for seed, seen in enumerate((light.total, np.maximum(light.total - own, 0.0))):
        many = np.tile(seen, (draws, 1, 1))
        counts = dg.detect(many, light.time, spad, exposure, seed=2 * scene + seed).astype(np.float64)
        counts = counts.reshape(draws, *own.shape)
        surplus = counts - rate * armed_cycles(counts, spad, exposure)
        answers.append((weight * surplus).sum(axis=(1, 2, 3)))
    with_it, without = answers
    spread = with_it.std(ddof=1)
    measured = (with_it.mean() - without.mean()) / spread
    # The error of a standard deviation depends on the fourth moment: weights are large in bins with few counts.
    fourth = float((((with_it - with_it.mean()) / spread) ** 4).mean())
    error = np.hypot(
        np.sqrt(1 + without.var() / spread**2) / np.sqrt(draws), measured * np.sqrt((fourth - 1) / (4 * draws))
    )
    without_own = own_light(np.maximum(light.total - own, 0.0), [own], light.time, spad, exposure)
    follows = (weight * np.concatenate([block.own[0] for block in without_own])).sum() / stated
    return Separation(stated, float(measured), float(error), float(follows))


def farthest_of(scenes: int) -> float:
    """Standard errors that none of so many scenes exceeds, except in one run in a thousand (Bonferroni)."""
    return float(norm.isf(1e-3 / scenes / 2))


if __name__ == "__main__":
    scenes = int(sys.argv[1]) if len(sys.argv) > 1 else 200
    all_of_them = []
    for number in range(scenes):
        kind = MODES[number % len(MODES)]
        of = separation(number, kind)
        all_of_them.append(of)
        room, ratio = ready()[number % len(ready())].name, of.measured / of.stated
        line = f"{of.stated:8.3f} {of.follows:8.3f} {of.measured:8.3f} ± {of.error:.3f}  {ratio:.3f}"
        print(f"{number:4d} {room:26s} {kind:20s} {line}", flush=True)
    ratios, beyond = [of.measured / of.stated for of in all_of_them], [of.beyond for of in all_of_them]
    significant = [ratio for ratio, of in zip(ratios, all_of_them, strict=True) if of.stated > 1]
    print(
        f"median {np.median(ratios):.4f}, of the {len(significant)} with σ > 1 {np.median(significant):.4f};"
        f" farthest {max(beyond):.2f} standard errors from the prediction, at most {farthest_of(scenes):.2f} expected"
    )
