"""`datagen plan`: its scenes are those of the build, and a build is their mean times its number of scenes."""

from __future__ import annotations

import heapq
import json
from pathlib import Path

import pytest
from datasets import write_dataset

from datagen.building import plan as planning
from datagen.building.plan import AT_LEAST_S, WORTH, Pilots, plan_of, scene_limit, simulated_scenes
from datagen.cli import run
from datagen.config import DatasetConfig, config_from_mapping, load_config
from datagen.errors import InputError
from datagen.records import Sample
from datagen.store import committed_records, read_manifest

CONFIG = """
name: tiny
scenes: 3
capture: {scan: {rows: 2, columns: 2}, time: {bins: 64, bin_width_ps: 800}}
transport: {samples: 64}
detector: {photons_per_pulse: 1000.0}
labels: {rows: 8, columns: 8}
store: {scenes_per_shard: 2}
"""


@pytest.fixture
def config(tmp_path: Path) -> Path:
    path = tmp_path / "tiny.yaml"
    path.write_text(CONFIG)
    return path


def pilots(*seconds: float) -> Pilots:
    """Pilots that took so many seconds."""
    stages = tuple({"transport": 0.75 * taken, "store": 0.25 * taken} for taken in seconds)
    return Pilots(stages, ({},) * len(seconds), {"histogram": 90.0, "record": 10.0}, {})


def test_a_build_is_the_mean_scene_times_their_number() -> None:
    """The seconds of the first scene, which also loads compiled code, are no part of the mean."""
    plan = plan_of(config_from_mapping({"scenes": 20}), pilots(50.0, 1.0, 2.0, 3.0), 1, 2)
    assert plan.scene_s == (1.0, 2.0, 3.0) and plan.seconds == {"transport": 1.5, "store": 0.5}
    assert (plan.build_s, plan.build_bytes) == (40.0, 2000.0)
    assert plan_of(config_from_mapping({"scenes": 1}), pilots(50.0), 1, 2).build_s == 50.0


@pytest.mark.parametrize(("scenes", "workers"), [(5, 7), (28, 3), (160, 1), (160, 3)])
def test_wall_clock_of_workers_that_take_shards_and_share_the_last_ones(scenes: int, workers: int) -> None:
    """Against a plain simulation of the queue, in which the scenes of the last shards are jobs of their own."""
    config = config_from_mapping({"scenes": scenes, "store": {"scenes_per_shard": 4}})
    plan = plan_of(config, pilots(3.0), workers, 8)
    jobs: list[int] = []
    for shard in range(plan.shards):
        number = min(4, scenes - 4 * shard)
        jobs += [number] if plan.shards - shard > workers or workers == 1 else [1] * number
    free = [0.0] * min(workers, scenes)
    for number in jobs:
        heapq.heappush(free, heapq.heappop(free) + 3.0 * number)
    assert plan.build_s == pytest.approx(max(free))
    # More workers than cores share these.
    assert plan_of(config, pilots(3.0), workers, 1).build_s == pytest.approx(len(free) * plan.build_s)


def test_the_scenes_of_a_plan_are_those_of_the_build(config: Path, tmp_path: Path) -> None:
    """Bytes, errors, evidence and decisions are the dataset's."""
    settings = load_config(config)
    found = simulated_scenes(settings, 1e6)
    root = write_dataset(settings, tmp_path / "set")
    records = committed_records(root, read_manifest(root))
    assert found.parameters == tuple(scene.parameters for record in records for scene in record.scenes)
    assert len(found.seconds) == 3 and not found.failed
    # Until the seconds have passed, but three at least.
    assert len(simulated_scenes(settings.with_scenes(9), 1e-9).seconds) == 3
    for field in read_manifest(root).schema.fields:
        files = sum(of.bytes for r in records for path, of in r.files.items() if f"/{field.name}/" in path)
        assert 3 * found.stored[field.name] == pytest.approx(files), field.name
    kept = sum(len(record.to_bytes()) for record in records)
    assert 3 * found.stored["record"] == pytest.approx(kept, rel=0.05)


def test_a_scene_that_cannot_be_made_is_named(config: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    simulate, impossible = planning.simulate_sample, {0, 2}

    def refuse(settings: DatasetConfig, index: int) -> Sample:
        if index in impossible:
            raise InputError("impossible")
        return simulate(settings, index)

    monkeypatch.setattr(planning, "simulate_sample", refuse)
    settings = load_config(config)
    found = simulated_scenes(settings, 1e6)
    assert len(found.seconds) == len(found.parameters) == 1 and found.failed == {0: "impossible", 2: "impossible"}
    impossible |= {1}
    with pytest.raises(InputError, match="none of the first 3 scenes can be made; scene 0: impossible"):
        simulated_scenes(settings, 1e6)


def test_the_plan_says_what_a_build_takes_and_makes(
    config: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    numbers = tmp_path / "plan.json"
    assert run(["plan", str(config), "--workers", "2", "--seconds", "60", "--json", str(numbers)]) == 0
    text = capsys.readouterr().out
    for piece in ("4 laser points × 1 pixel × 64 bins", "3 scenes simulated in full", "timing_response", "2 workers"):
        assert piece in text, piece
    values = json.loads(numbers.read_text())
    expected = values["forecast"]
    assert (expected["scenes"], expected["workers"], expected["simulated"]) == (3, 2, 3)
    assert expected["build_s"] > 0 and expected["build_bytes"] > 0 and values["cores"] >= 1
    assert {of["kind"] for of in expected["evidence"]} == {"box", "pillar"}


def test_the_limit_is_given_or_follows_the_longest_scene(monkeypatch: pytest.MonkeyPatch) -> None:
    config = config_from_mapping({})
    assert scene_limit("2.5", config) == 2.5
    for longest, limit in ((0.01, AT_LEAST_S), (60.0, 60.0 * WORTH)):
        plan = plan_of(config, pilots(0.0, 0.001, longest), 1, 1)
        monkeypatch.setattr(planning, "plan_build", lambda _, plan=plan: plan)
        assert scene_limit("forecast", config) == limit


def test_a_window_that_misses_the_room_is_said_before_and_after(
    config: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """By the plan, at the end of the build and by `info`, with what to change; and no error is claimed that nobody
    knows."""
    text = CONFIG.replace("bin_width_ps: 800", "bin_width_ps: 20, origin: source")
    config.write_text(text.replace("samples: 64", "target: 0.1"))
    root = str(tmp_path / "set")
    for command in (["plan", str(config), "--seconds", "1"], ["build", str(config), root], ["info", root]):
        assert run(command) == 0
        said = "".join(capsys.readouterr())
        window = next(line for line in said.splitlines() if "outside of the time axis" in line)
        assert window.strip().startswith("window")
        assert "90% of the light or more" in window and "capture.time" in window and "relay_distance_m" in window
        assert "nan" not in said.lower()
    # With a window that the light falls into there is no such line.
    config.write_text(CONFIG)
    assert run(["plan", str(config), "--seconds", "1"]) == 0
    assert "outside of the time axis" not in "".join(capsys.readouterr())


def test_a_plan_of_sequences_says_frames_and_changes(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    values = {
        "scenes": 3, "transport": {"target": 0.3}, "sequence": {"frames": 3, "rate_hz": 5},
        "scene": {"contents": [{"kind": "box", "motion": {"kind": "walk"}}]},
        "capture": {"scan": {"rows": 2, "columns": 2}, "time": {"bins": 64, "bin_width_ps": 800}},
        "detector": {"cycles": 50_000}, "labels": {"rows": 8, "columns": 8},
    }  # fmt: skip
    path = tmp_path / "walks.yaml"
    path.write_text(json.dumps(values))
    assert run(["plan", str(path)]) == 0
    said = capsys.readouterr().out
    assert "sequence     3 frames each, 5 a second, laser points in the order raster" in said
    assert "  change     box: from frame to frame" in said and "histogram             3 × 4 × 1 × 64" in said
