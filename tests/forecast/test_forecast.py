"""Forecasts from pilots of known cost; no test depends on a clock."""

from __future__ import annotations

import heapq
import math
from dataclasses import replace
from pathlib import Path

import numba
import numpy as np
import pytest
from datasets import write_dataset
from store import fake_samples

from datagen.config import DatasetConfig, config_from_mapping
from datagen.errors import InputError
from datagen.forecast.forecast import Forecast, forecast, outcomes, records_of
from datagen.forecast.pilots import MOST, Pilot, Pilots, run_pilots, spread_indices, with_less_effort
from datagen.pipeline import simulate_sample
from datagen.records import Sample
from datagen.seeding import Purpose, generator
from datagen.store import schema_of

FIXED_S, LOOKIN_S, DETECTOR_S = 0.2, 0.001, 0.3
NOISE = 20.0
"""Noise of one hidden vertex relative to the signal: with n of them, the error is that noise / √(n + noise²)."""


def small_config(**changes: object) -> DatasetConfig:
    """The small configuration of the tests of stores, with the number of samples that `Simulated` takes time for."""
    return fake_samples.small_config(**({"transport": {"lookins": 4096}} | changes))


class Simulated:
    """A sample function with a clock of its own: transport takes 0.2 s and a millisecond for each hidden vertex, in
    later scenes `harder` times the scene's number more."""

    def __init__(self, refused: tuple[int, ...] = (), compiling_s: float = 0.0, harder: float = 0.0) -> None:
        self.now_s, self.refused, self.compiling_s, self.harder = 0.0, refused, compiling_s, harder
        self.full: list[int] = []

    def __call__(self, config: DatasetConfig, index: int) -> Sample:
        if index in self.refused:
            raise InputError("impossible")
        rng, lookins = generator(config.seed, index, Purpose.SCENE), config.transport.lookins
        arrays = {
            f.name: rng.poisson(0.7, f.shape) if np.dtype(f.dtype).kind in "ui" else rng.random(f.shape)
            for f in schema_of(config).fields
        }
        seconds = {"scene": 0.01, "transport": FIXED_S + LOOKIN_S * lookins, "detector": DETECTOR_S}
        seconds["transport"] *= 1.0 + self.harder * index
        if lookins > 1000:
            if self.compiling_s:
                numba.njit(lambda x: x)(index)
            seconds["transport"] += self.compiling_s
            self.compiling_s = 0.0
            self.full.append(index)
        self.now_s += sum(seconds.values())
        error = math.sqrt(NOISE**2 / (lookins + NOISE**2))
        return Sample(index, arrays, {"transient.relative_error": error, "index": index}, seconds)

    def clock(self) -> float:
        return self.now_s


def pilots_of(config: DatasetConfig, budget_s: float, simulated: Simulated | None = None) -> Pilots:
    simulated = simulated or Simulated()
    return run_pilots(config, budget_s, simulated, simulated.clock)


def expected_of(config: DatasetConfig, pilots: Pilots, workers: int = 1, startup_s: float = 0.0) -> Forecast:
    return forecast(schema_of(config), pilots, startup_s, workers, cores=2)


@pytest.fixture(scope="module")
def one_pilot() -> Pilots:
    return pilots_of(small_config(), 4.0)


def test_known_costs_are_forecast() -> None:
    """The forecast has the cost of each stage and of the build; twice the scenes take twice the time and space."""
    config = small_config()
    pilots = pilots_of(config, 1000.0)
    assert [pilot.index for pilot in pilots.scenes] == spread_indices(12, MOST)
    one, two = expected_of(config, pilots), expected_of(config.with_scenes(24), pilots)
    assert one.effort == 1.0
    assert one.seconds["transport"] == pytest.approx(FIXED_S + LOOKIN_S * 4096)
    assert one.processor_s == pytest.approx(0.01 + FIXED_S + LOOKIN_S * 4096 + DETECTOR_S)
    assert one.error == pytest.approx([NOISE / math.sqrt(4096 + NOISE**2)] * 3)
    assert one.build_s == pytest.approx(12 * sum(one.seconds.values()))
    assert two.build_s == pytest.approx(2 * one.build_s)
    assert two.build_bytes - pilots.fixed_bytes == pytest.approx(2 * (one.build_bytes - pilots.fixed_bytes))


@pytest.mark.parametrize(("budget_s", "scenes"), [(20.0, 5), (4.7, 2), (3.1, 1)])
def test_pilots_keep_to_their_budget(budget_s: float, scenes: int) -> None:
    """A scene takes 4.6 s. One is always simulated, and none is begun once the budget is spent."""
    simulated = Simulated()
    assert len(pilots_of(small_config(), budget_s, simulated).scenes) == scenes == len(simulated.full)


@pytest.mark.parametrize("budget_s", [0.2, 1.0, 3.0])
def test_scenes_beyond_the_budget_are_compared_by_trials(budget_s: float) -> None:
    """Later scenes take longer; the mean of those compared is that of all, and one is simulated in full."""
    simulated = Simulated(harder=0.3)
    expected = expected_of(small_config(), pilots_of(small_config(), budget_s, simulated))
    assert (expected.effort, expected.pilots, len(simulated.full)) == (1.0, 4, 1)
    assert expected.seconds["transport"] == pytest.approx((FIXED_S + LOOKIN_S * 4096) * (1.0 + 0.3 * 5.5))
    assert expected.error[1] == pytest.approx(NOISE / math.sqrt(4096 + NOISE**2))


def test_a_scene_far_beyond_the_budget_lies_on_the_line_of_two_trials() -> None:
    """The line includes the fixed cost of a scene; the error is that of independent samples."""
    simulated = Simulated()
    expected = expected_of(small_config(), pilots_of(small_config(), 0.1, simulated))
    assert (expected.effort, expected.pilots, simulated.full) == (1 / 16, 1, [])
    assert expected.seconds["transport"] == pytest.approx(FIXED_S + LOOKIN_S * 4096)
    assert expected.error[1] == pytest.approx(NOISE / math.sqrt(4096 + NOISE**2))
    looser, effort = with_less_effort(small_config(transport={"target": 0.02}), 16)
    assert looser.transport.target == pytest.approx(0.08) and effort == pytest.approx(1 / 16)


def test_stages_that_grow_more_slowly_than_paths_are_not_scaled_in_proportion() -> None:
    """The expected time lies between the trial's own and that in proportion to the paths; the expected error is the
    target, if the trial's was larger."""
    less = Pilot(0, 1 / 256, {"transport": 3.0, "labels": 1.0}, 4.0, 0.2, 0.02)
    for now_s, full_s in ((3.5, 3.5 + 0.5 * 16), (2.9, 2.9), (48.0, 48.0 + 45 * 16), (60.0, 960.0)):
        trial = Pilot(0, 1 / 16, {"transport": now_s, "labels": 1.0}, now_s + 1.0, 0.05, 0.02, less)
        full = trial.at_full_effort()
        assert full.seconds == {"transport": pytest.approx(full_s), "labels": 1.0} and full.error == 0.02
        assert full.processor_s == pytest.approx(full_s + 1.0)
    assert replace(trial, error=0.006).at_full_effort().error == 0.006


def test_a_pilot_that_compiles_a_kernel_is_run_again() -> None:
    expected = expected_of(small_config(), pilots_of(small_config(), 12.0, Simulated(compiling_s=30.0)))
    assert expected.seconds["transport"] == pytest.approx(FIXED_S + LOOKIN_S * 4096)


@pytest.mark.parametrize("workers", [1, 2, 3, 7])
@pytest.mark.parametrize("scenes", [1, 5, 25, 28, 160, 387])
def test_wall_clock_of_workers_that_take_shards_and_share_the_last_ones(
    scenes: int, workers: int, one_pilot: Pilots
) -> None:
    """Against a plain simulation of the queue."""
    config, startup_s = small_config(scenes=scenes), 1.5
    schema, pilots = schema_of(config), one_pilot
    expected = forecast(schema, pilots, startup_s, workers, cores=8)
    jobs: list[int] = []
    for shard in range(schema.shards):
        number = len(schema.scenes_of(shard))
        jobs += [number] if schema.shards - shard > workers or workers == 1 else [1] * number
    free = [(0.0, 0, worker) for worker in range(min(workers, scenes))]
    for number in jobs:
        at, done, worker = heapq.heappop(free)
        at += startup_s * (done == 0) + number * sum(expected.seconds.values())
        heapq.heappush(free, (at, done + 1, worker))
    assert expected.build_s == pytest.approx(max(free)[0])
    assert expected.working == len(free)
    # More workers than cores share these.
    assert forecast(schema, pilots, startup_s, workers, 1).build_s == pytest.approx(len(free) * expected.build_s)


def test_a_dataset_has_the_expected_error_and_size(tmp_path: Path) -> None:
    config = small_config(scenes=8, store={"fields": ["histogram", "transient", "depth"], "scenes_per_shard": 8})
    expected = expected_of(config, pilots_of(config, 1000.0))
    root = write_dataset(config, tmp_path / "set", Simulated())
    rows = {row.name: row for row in outcomes(expected, records_of(config, root), root)}
    assert rows["relative error"].ratio == pytest.approx(1.0)
    assert rows["bytes per scene"].ratio == pytest.approx(1.0, abs=0.02)
    with pytest.raises(InputError, match="another configuration"):
        records_of(config.model_copy(update={"seed": 6}), root)


def test_a_scene_that_cannot_be_made_is_named() -> None:
    config = small_config()
    expected = expected_of(config, pilots_of(config, 1000.0, Simulated(refused=(0, 5))))
    assert expected.failed == {0: "impossible", 5: "impossible"} and expected.pilots == 6
    with pytest.raises(InputError, match="none of the pilot scenes can be made; scene 0: impossible"):
        pilots_of(config, 1000.0, Simulated(refused=tuple(range(12))))


def test_unknown_error_is_no_number(one_pilot: Pilots) -> None:
    unknown = replace(one_pilot, scenes=tuple(replace(pilot, error=math.nan) for pilot in one_pilot.scenes))
    assert expected_of(small_config(), unknown).as_json()["error"] == [None, None, None]


def test_a_trial_simulates_what_the_scene_would() -> None:
    """Effects are decided for the configured number of samples; 1/64 of it alone would decide differently."""
    scan = {"scan": {"rows": 6, "columns": 6}}
    config = config_from_mapping(
        {"scenes": 1, "seed": 1, "capture": scan, "transport": {"lookins": 8192, "max_bounces": 5}}
    )
    reduced, _ = with_less_effort(config, 64)

    def decided(sample: Sample) -> dict[str, object]:
        transport = ("effect.secondary", "effect.higher", "effect.brdf", "effect.extended")
        return {key: value for key, value in sample.parameters.items() if key.startswith(transport)}

    alone, trial = decided(simulate_sample(reduced, 0)), decided(simulate_sample(reduced, 0, config.transport))
    assert alone != trial == decided(simulate_sample(config, 0))
