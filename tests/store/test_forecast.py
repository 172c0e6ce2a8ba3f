"""Forecasts: pilots with timings that are known beforehand, so that nothing here depends on a clock."""

from __future__ import annotations

import heapq
import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from fake_samples import always_fails, fake_sample, small_config, too_many_counts

from datagen.config import DatasetConfig, config_from_mapping
from datagen.errors import InputError
from datagen.forecast.forecast import Forecast, against, forecast, wall_seconds
from datagen.forecast.ladder import Ladder, Pilot
from datagen.forecast.pilots import Pilots, effort_reduced, run_pilots, spread_indices
from datagen.forecast.probe import Workers
from datagen.pipeline import simulate_sample
from datagen.records import Sample
from datagen.store import committed, finish, prepare, schema_of, write_shard

FIXED_S, LOOKIN_S, DETECTOR_S = 0.2, 0.001, 0.3
NOISE = 20.0
"""Of one lookin, relative to the signal: the error of n lookins is what is noise of √(noise² + signal²)."""


def timed_sample(config: DatasetConfig, index: int) -> Sample:
    """Transport costs 0.2 s and a millisecond a lookin; its error falls with the root of the lookins."""
    sample = fake_sample(config, index)
    lookins = config.transport.lookins
    odds = NOISE**2 / lookins
    parameters = dict(sample.parameters) | {"transient.relative_error": math.sqrt(odds / (1 + odds))}
    seconds = {"scene": 0.01, "transport": FIXED_S + LOOKIN_S * lookins, "detector": DETECTOR_S}
    return replace(sample, seconds=seconds, parameters=parameters)


def made_here(config: DatasetConfig, root: Path, sample: Callable[[DatasetConfig, int], Sample]) -> None:
    """A whole dataset, written in this process."""
    manifest = prepare(root, config)
    for shard in range(manifest.schema.shards):
        samples = ((index, sample(config, index)) for index in manifest.schema.scenes_of(shard))
        write_shard(root, manifest.schema, shard, manifest.fingerprint, samples)
    finish(root, manifest, committed(root, manifest))


def expected_of(config: DatasetConfig, pilots: Pilots, workers: int = 1, **running: float) -> Forecast:
    return forecast(config, schema_of(config), pilots, Workers(running.get("startup_s", 0.0), 0.0), workers, cores=2)


@pytest.mark.parametrize(
    ("budget_s", "effort", "reached", "within"),
    [(1000.0, 1.0, 1.0, 1e-9), (12.0, 1 / 16, 1.0, 1e-9), (3.0, 1 / 64, 1.0, 1e-9), (2.5, 1 / 64, 0.25, 0.2)],
)
def test_less_effort_leads_to_the_same_forecast(
    budget_s: float, effort: float, reached: float, within: float
) -> None:
    """With full pilots; with a sixteenth or less of the lookins and one scene with all; with a quarter at most."""
    config = small_config(transport={"lookins": 4096})
    pilots = run_pilots(config, budget_s, timed_sample)
    expected = expected_of(config, pilots)
    assert (pilots.effort, pilots.ladder.top.effort, expected.reached) == (effort, reached, reached)
    assert expected.seconds["transport"] == pytest.approx(FIXED_S + LOOKIN_S * 4096, rel=within)
    assert expected.seconds["detector"] == pytest.approx(DETECTOR_S)
    assert expected.error[1] == pytest.approx(NOISE / math.sqrt(4096 + NOISE**2), rel=within)


def saturating(effort: float) -> Pilot:
    """What grows with effort until a quarter of it, then with a sixth of the slope; the error as effort^−0.6."""
    taken = 0.1 + 4 * min(effort, 0.25) + 0.7 * max(effort - 0.25, 0.0)
    odds = 0.01 * effort**-1.2
    stored = {"transient": round(1000 + 100 * math.log(effort))}
    seconds = {"transport": taken, "detector": 0.5}
    return Pilot(0, effort, seconds, 1.0, math.sqrt(odds / (1 + odds)), stored)


def test_one_scene_with_full_effort_scales_the_others() -> None:
    """Whatever law seconds, error and bytes follow, they are right once a rung has reached full effort."""
    efforts = (1 / 64, 1 / 16, 1.0)
    ladder, full = Ladder(tuple(map(saturating, efforts))), saturating(1.0)
    for effort in efforts:
        rung = ladder.at(effort)
        assert rung.transport_s * ladder.slower(effort) == pytest.approx(full.transport_s)
        assert ladder.at_full(rung.error, effort, targeted=False) == pytest.approx(full.error)
        assert rung.stored["transient"] * ladder.larger("transient", effort) == pytest.approx(
            full.stored["transient"]
        )
    assert ladder.scene_s(1.0) == ladder.most_s(1.0) == pytest.approx(full.total_s)


@pytest.mark.parametrize("efforts", [(1 / 64, 1 / 16), (1 / 16, 1 / 4), (1 / 64, 1 / 16, 1 / 4)])
def test_what_is_out_of_reach_lies_between_a_power_law_and_a_straight_line(efforts: tuple[float, ...]) -> None:
    ladder = Ladder(tuple(map(saturating, efforts)))
    low, high = ladder.rungs[-2:]
    slope = (high.transport_s - low.transport_s) / (high.effort - low.effort)
    line = high.transport_s + slope * (1 - high.effort)
    power = math.log(high.transport_s / low.transport_s) / math.log(high.effort / low.effort)
    law = high.transport_s * high.effort**-power
    assert ladder.transport_s(1.0) == pytest.approx(math.sqrt(line * law)) and law < ladder.transport_s(1.0) < line
    assert ladder.most_s(1.0) == pytest.approx(line + 0.5)
    assert ladder.at_full(high.error, high.effort, targeted=False) == pytest.approx(saturating(1.0).error, rel=0.35)
    assert ladder.larger("transient", high.effort) * high.stored["transient"] == pytest.approx(1000, rel=0.01)


def test_a_single_rung_gives_an_upper_bound_and_noise_no_less_than_it_measured() -> None:
    """In proportion; and a higher rung that by chance was quicker than the lower is taken to cost as much."""
    assert Ladder((saturating(1 / 64),)).transport_s(1.0) == pytest.approx(64 * saturating(1 / 64).transport_s)
    quicker = replace(saturating(1 / 16), seconds={"transport": 0.01})
    assert Ladder((saturating(1 / 64), quicker)).transport_s(1.0) == pytest.approx(0.01)
    unknown = replace(saturating(1 / 16), error=math.nan)
    assert Ladder((unknown,)).at_full(0.1, 1 / 16, targeted=False) == pytest.approx(0.025, rel=0.01)


def test_pilots_with_less_effort_follow_the_light_that_the_scene_would() -> None:
    """Effects are decided by the configured lookins: 1/64 of them decide differently, the pilot does not."""
    config = config_from_mapping({"scenes": 1, "seed": 1, "transport": {"lookins": 8192, "fov_samples": 1}})
    reduced, _ = effort_reduced(config, 64)
    alone, pilot = simulate_sample(reduced, 0), simulate_sample(reduced, 0, planned=config.transport)
    whole = simulate_sample(config, 0)

    def decided(sample: Sample) -> dict[str, object]:
        transport = ("effect.secondary", "effect.higher", "effect.brdf", "effect.extended")
        return {key: value for key, value in sample.parameters.items() if key.startswith(transport)}

    assert decided(alone) != decided(whole)
    assert decided(pilot) == decided(whole)


def test_pilots_keep_to_their_budget() -> None:
    config = small_config(scenes=1000, transport={"lookins": 4096})
    for budget_s in (2.0, 3.0, 4.0, 6.0, 10.0, 30.0, 100.0):
        pilots = run_pilots(config, budget_s, timed_sample)
        spent_s = sum(p.total_s for p in (*pilots.ladder.rungs, *pilots.scenes[1:]))
        assert spent_s <= budget_s or (len(pilots.scenes) <= 3 and spent_s <= 2.4 * budget_s), budget_s
        assert len({p.effort for p in pilots.scenes}) == 1 and len(pilots.scenes) >= 3


def test_a_target_is_loosened_and_its_error_scaled_back() -> None:
    config = small_config(transport={"target": 0.02})
    looser, effort = effort_reduced(config, 16)
    assert looser.transport.target == pytest.approx(0.08) and effort == pytest.approx(1 / 16)
    assert looser.transport.accuracy().target == looser.transport.target

    def sample(config: DatasetConfig, index: int) -> Sample:
        target = config.transport.target
        assert target is not None
        made = timed_sample(config, index)
        seconds = {"transport": 0.1 + 1e-3 / target**2}
        return replace(made, seconds=seconds, parameters={"transient.relative_error": 0.9 * target})

    expected = expected_of(config, run_pilots(config, 1.5, sample))
    assert expected.effort < 1
    assert expected.error[1] == pytest.approx(0.018)
    assert expected.seconds["transport"] == pytest.approx(0.1 + 1e-3 / 0.02**2, rel=0.01)


def test_pilot_scenes_are_spread_over_the_dataset() -> None:
    assert spread_indices(1, 8) == [0]
    assert spread_indices(5, 8) == [0, 1, 2, 3, 4]
    assert spread_indices(1000, 8) == [0, 143, 285, 428, 571, 714, 856, 999]


@pytest.mark.parametrize("workers", [1, 2, 3, 7])
@pytest.mark.parametrize("shards", [1, 2, 6, 7, 40, 97])
def test_wall_clock_of_workers_that_take_shard_after_shard(shards: int, workers: int) -> None:
    """Against a plain simulation of the queue; a process is replaced after 16 shards."""
    shard_s, last_s, startup_s = 5.0, 2.0, 1.5
    workers = min(workers, shards)
    free = [(0.0, 0, worker) for worker in range(workers)]
    for shard in range(shards):
        at, done, worker = heapq.heappop(free)
        at += startup_s if done % 16 == 0 else 0.0
        heapq.heappush(free, (at + (last_s if shard == shards - 1 else shard_s), done + 1, worker))
    assert wall_seconds(shards, workers, shard_s, last_s, startup_s) == pytest.approx(max(free)[0])


def test_more_workers_than_cores_or_shards_do_not_help() -> None:
    config = small_config(scenes=40, transport={"lookins": 64})
    pilots = run_pilots(config, 100.0, timed_sample)
    times = {workers: expected_of(config, pilots, workers).build_s for workers in (1, 2, 4, 8, 50)}
    assert times[2] == pytest.approx(times[1] / 2)
    assert times[4] >= times[2] * 0.99 and times[50] >= times[2] * 0.99
    assert expected_of(config, pilots, 50).working == 10


def test_bytes_are_those_of_the_build(tmp_path: Path) -> None:
    """Files, records and table together within 6 % of what a build with the same samples leaves on the disk."""
    config = small_config(scenes=24, store={"fields": ["histogram", "transient", "depth"], "scenes_per_shard": 8})
    expected = expected_of(config, run_pilots(config, 1000.0, timed_sample))
    made_here(config, tmp_path / "set", timed_sample)
    actual = sum(path.stat().st_size for path in (tmp_path / "set").rglob("*") if path.is_file())
    assert expected.build_bytes == pytest.approx(actual, rel=0.06)


def test_a_scene_that_cannot_be_made_is_passed_over() -> None:
    config = small_config()
    pilots = run_pilots(config, 1000.0, too_many_counts)
    assert list(pilots.failed) == [2] and "70000" in pilots.failed[2]
    assert 2 not in [pilot.index for pilot in pilots.scenes]
    with pytest.raises(InputError, match="scene 0: impossible"):
        run_pilots(config, 1000.0, always_fails)


def test_unknown_error_is_no_number() -> None:
    config = small_config()
    expected = expected_of(config, run_pilots(config, 1000.0, fake_sample))
    assert math.isnan(expected.error[1]) and expected.as_json()["error"] == [None, None, None]


def test_predicted_error_and_bytes_come_true(tmp_path: Path) -> None:
    """Real scenes: a sixteenth of the lookins, a quarter for one, and the dataset: within a factor of 1.5."""
    config = config_from_mapping(
        {
            "scenes": 10,
            "seed": 5,
            "capture": {"scan": {"rows": 3, "columns": 3}, "time": {"bins": 128, "bin_width_ps": 400}},
            "transport": {"lookins": 1024, "fov_samples": 1},
            "detector": {"photons_per_pulse": 1e6},
            "labels": {"rows": 8, "columns": 8},
        }
    )

    def counted(config: DatasetConfig, index: int) -> Sample:
        """Seconds from the lookins, so that the clock does not decide how many are taken."""
        return replace(simulate_sample(config, index), seconds={"transport": config.transport.lookins / 1024})

    pilots = run_pilots(config, 0.5, counted)
    assert (pilots.effort, pilots.ladder.top.effort) == (1 / 16, 1 / 4)
    expected = expected_of(config, pilots)
    made_here(config, tmp_path / "set", simulate_sample)
    outcomes = {row.name: row for row in against(expected, config, tmp_path / "set")}
    for name in ("relative error", "bytes per scene"):
        assert 1 / 1.5 < outcomes[name].ratio < 1.5, outcomes[name]
    full = expected_of(config, run_pilots(config, 1000.0, counted))
    again = {row.name: row for row in against(full, config, tmp_path / "set")}
    assert 1 / 1.2 < again["relative error"].ratio < 1.2
    assert 1 / 1.1 < again["bytes per scene"].ratio < 1.1
    other = config.model_copy(update={"seed": 6})
    with pytest.raises(InputError, match="another configuration"):
        against(expected, other, tmp_path / "set")


def test_the_same_pilots_give_the_same_forecast() -> None:
    config = small_config(transport={"lookins": 4096})
    one, two = (run_pilots(config, 12.0, timed_sample) for _ in range(2))
    for pilot, same in zip(one.scenes, two.scenes, strict=True):
        assert (pilot.index, pilot.effort, pilot.error, pilot.seconds) == (
            same.index,
            same.effort,
            same.error,
            same.seconds,
        )
    assert np.array_equal(expected_of(config, one).error, expected_of(config, two).error)


def test_a_pilot_that_compiles_a_kernel_is_run_again() -> None:
    """The first run with more than 1000 lookins takes 30 s longer; the forecast does not know of it."""
    compiled = []

    def sample(config: DatasetConfig, index: int) -> Sample:
        made = timed_sample(config, index)
        if config.transport.lookins > 1000 and not compiled:
            compiled.append(index)
            return replace(made, seconds={**made.seconds, "transport": made.seconds["transport"] + 30.0})
        return made

    config = small_config(transport={"lookins": 4096})
    expected = expected_of(config, run_pilots(config, 12.0, sample))
    assert compiled and expected.seconds["transport"] == pytest.approx(FIXED_S + LOOKIN_S * 4096, rel=0.01)
