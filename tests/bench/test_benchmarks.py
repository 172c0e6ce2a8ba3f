"""Every benchmark prints its table at a tiny size; what the loaders' rests on is held against what was written."""

from __future__ import annotations

import importlib.util
import sys
import tracemalloc
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from subprocess import CalledProcessError

import numpy as np
import pytest
from benchmarks import (
    acceptance,
    detector,
    devices,
    evidence,
    first_scene,
    large_datasets,
    loaders,
    long_builds,
    scaling,
    sequences,
)
from benchmarks.hard_scenes import hard
from damage import SCENES, sample, small_dataset
from datasets import write_dataset
from torch.utils.data import IterableDataset

from datagen import Accuracy, simulate
from datagen.bench.plain_check import Checked
from datagen.building.build import build
from datagen.config import DatasetConfig, config_from_mapping
from datagen.loader import TransientDataset
from datagen.pipeline import simulate_sample
from datagen.records import Sample
from datagen.store import verify
from datagen.store.info import info
from datagen.store.record import record_path


def test_loaders_hand_over_the_same_counts(tmp_path: Path) -> None:
    config = loaders.config_of((2, 3, 16), 9)
    loaders.write_ours(config, tmp_path / "ours")
    due = [loaders.counts_of(config, index) for index in range(9)]
    assert 0 < sum(map(np.count_nonzero, due)) < 0.1 * 9 * due[0].size
    there = [name for name, peer in loaders.PEERS.items() if importlib.util.find_spec(peer.module)]
    assert {"zarr", "np.memmap, uncompressed"} <= set(there)
    for number, name in enumerate(there):
        folder = tmp_path / str(number)
        disk_bytes, data = loaders.read_by(loaders.PEERS[name], folder, tmp_path / "ours", config)
        found = list(data) if isinstance(data, IterableDataset) else [data[index] for index in range(9)]
        assert disk_bytes > 0
        assert all(np.array_equal(a.numpy(), b) for a, b in zip(found, due, strict=True)), name
    ours = TransientDataset(tmp_path / "ours", ("histogram",), counts="stored")
    assert all(np.array_equal(ours[index]["histogram"].numpy(), due[index]) for index in range(9))


def test_a_large_dataset_is_a_whole_one(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """And opening it costs seconds and memory."""
    monkeypatch.setattr(large_datasets, "SIMULATED", SCENES)
    config = small_dataset(tmp_path / "few").with_scenes(31)
    large_datasets.copied(config, tmp_path / "few", tmp_path / "many")
    assert verify(tmp_path / "many", deep=True).problems == ()
    assert len(large_datasets.one_of_every_shard(str(tmp_path / "many"))) == 16 and large_datasets.own_mb() > 10


def test_the_second_process_finds_what_the_first_one_compiled() -> None:
    program = "from datagen.compiled import first_use; first_use()"
    first, second, stored = first_scene.measured(program, "")
    assert first > 0.0 and second > 0.0 and stored == 1


def rich_sample(config: DatasetConfig, index: int) -> Sample:
    """A scene of fifty parameters."""
    numbers = {f"room.p{number}": (index + 1) / (number + 1) for number in range(50)}
    return replace(sample(config, index), parameters=numbers)


def test_what_stays_of_a_scene_is_some_numbers(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Of each of 1024 scenes more, `info`, `verify` and a build with nothing left hold less than 2 kB; records would
    take 5 kB."""
    config = config_from_mapping({
        "scenes": 8, "name": "many", "capture": {"scan": {"rows": 1, "columns": 2}, "time": {"bins": 8}},
        "store": {"fields": ["histogram"], "scenes_per_shard": 256},
    })  # fmt: skip
    write_dataset(config, tmp_path / "few", rich_sample)
    peaks = []
    for scenes in (1024, 2048):
        many, root = config.with_scenes(scenes), tmp_path / str(scenes)
        large_datasets.copied(many, tmp_path / "few", root)
        again = partial(build, many, progress=False, sample_function=rich_sample)
        peaks.append([peak_bytes(step, root) for step in (info, verify, again)])
    assert all(most - least < 1024 * 2_000 for least, most in zip(*peaks, strict=True)), peaks


def test_a_long_build_is_told_by_its_parts() -> None:
    """Of 100 scenes in ten shards, of which each takes a second longer than the one before."""
    readings = [long_builds.Reading(shard * (shard + 1) / 2, shard, 100.0 + shard, 200.0) for shard in range(11)]
    table = long_builds.rows(readings, 100)
    assert [row[0] for row in table] == ["0 to 20", "20 to 40", "40 to 60", "60 to 80", "80 to 100"]
    assert [row[1:] for row in table[:2]] == [["0.150", "102", "200"], ["0.350", "104", "200"]]


def test_a_long_build_is_watched(tmp_path: Path) -> None:
    """Readings tell the memory of a process and of one that it has started, and shards as they are committed."""
    worker = "import time; held = b'1' * 50_000_000; time.sleep(1)"
    text = (
        "import pathlib, subprocess, sys, time\n"
        f"worker = subprocess.Popen([sys.executable, '-c', {worker!r}])\n"
        f"path = pathlib.Path({str(record_path(tmp_path, 0))!r})\n"
        "path.parent.mkdir(); path.touch(); worker.wait(); time.sleep(0.5)"
    )
    readings = long_builds.watched([sys.executable, "-c", text], tmp_path, every_s=0.05)
    assert readings[0].shards == 0 and readings[-1].shards == 1
    assert max(reading.worker_mb for reading in readings) > 50
    assert 1 < max(reading.build_mb for reading in readings) < 50
    with pytest.raises(CalledProcessError):
        long_builds.watched([sys.executable, "-c", "raise SystemExit(3)"], tmp_path, every_s=0.05)


def peak_bytes(step: Callable[[Path], object], root: Path) -> int:
    """The most memory that Python's objects take during a step."""
    tracemalloc.start()
    try:
        step(root)
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


def test_loaders_print_a_rate_of_each(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    """At a tiny size, without workers."""
    for name, small in (("WORKERS", (0,)), ("SIZES", ((4, 4, 64),)), ("DECODED_BYTES", 1e5), ("EPOCHS", 1)):
        monkeypatch.setattr(loaders, name, small)
    loaders.main()
    rows = [line.split(" | ") for line in capsys.readouterr().out.split("---:")[-1].splitlines()[1:]]
    assert [row[0].strip("| ") for row in rows[:4]] == [*loaders.OURS, "zarr"]
    assert all(float(row[2].rstrip(" |")) > 0 for row in rows), "samples a second"


def test_the_plain_detector_keeps_what_ours_expects(monkeypatch: pytest.MonkeyPatch) -> None:
    """Total counts of 2000 cycles: within 5 Poisson standard deviations, which dead time only makes smaller."""
    monkeypatch.setattr(detector, "CYCLES", 2000)
    exposure = detector.Exposure(1.0 / detector.PERIOD_S, 2000, 1.0)
    for name, spad in detector.CASES.items():
        if name.startswith("afterpulses"):
            continue
        flux = detector.demonstration_shape()
        assert flux.sum() == pytest.approx(1)
        mean = detector.expected_histogram(flux, detector.AXIS, spad, exposure, approximate=True).sum()
        assert abs(detector.plain_histogram(flux, spad).sum() - mean) < 5 * np.sqrt(mean), name


def test_detector(monkeypatch: pytest.MonkeyPatch) -> None:
    for name, small in (("CYCLES", 2000), ("TIMED_S", 1e-3), ("BLOCK", 2)):
        monkeypatch.setattr(detector, name, small)
    for name, spad in detector.CASES.items():
        assert all(float(cell.rstrip("×")) > 0 for cell in detector.row(name, spad, 0.5)[3:-1])


def test_devices(capsys: pytest.CaptureFixture[str]) -> None:
    """A device that looks at things has a row with both places, one that scans a relay wall with one."""
    devices.main(["vl53l1x", "linospad2", "--scenes", "1"])
    head, _, looking, scanning = capsys.readouterr().out.splitlines()[-4:]
    assert head.count("|") == looking.count("|") == scanning.count("|") == 8
    assert looking.startswith("| `vl53l1x` |") and "of 1 |" in looking.split("room")[-1] and "–" not in looking
    assert scanning.endswith("of 1 | – | – | – |")


def test_scaling(monkeypatch: pytest.MonkeyPatch) -> None:
    tiny = [(n, {"samples": n, "bins": 16, "lasers": 1}) for n in (16, 32, 64)]
    monkeypatch.setattr(scaling, "SWEEPS", {"samples": tiny})
    name, seconds, exponent = scaling.swept("samples")
    assert name == "samples" and seconds.count(";") == 2 and np.isfinite(float(exponent))


def test_evidence_is_that_of_the_samples() -> None:
    config = config_from_mapping({
        "scenes": 3, "scene": {"contents": [{"kind": "pillar"}, {"kind": "box", "count": 2}]},
        "capture": {"scan": {"rows": 1, "columns": 2}, "time": {"bins": 64, "bin_width_ps": 800}},
        "transport": {"target": 0.3},
    })  # fmt: skip
    box, pillar, every = evidence.found_in(config, 2, 0.0)
    assert (every.kind, every.objects) == ("all objects", 6)
    assert (box.kind, box.objects, pillar.kind, pillar.objects) == ("box", 4, "pillar", 2)
    of = [simulate_sample(config, k).parameters["evidence.pillar.significance"] for k in range(2)]
    assert pillar.median == sum(map(float, of)) / 2


@pytest.mark.filterwarnings("ignore:.*lie on the object")
def test_every_hard_scene_has_light() -> None:
    names = []
    for name, scene, capture in hard(1, 0):
        names.append(name)
        found = simulate(scene, capture, Accuracy(samples=64), seed=1)
        assert (found.total.sum(axis=2) + found.overflow).all(), name
    assert len(set(names)) == len(names)


def claim(claimed: float, error: float, noise: float, energy: float = 1.0) -> acceptance.Judged:
    """A claim whose error is found with some noise, both relative L2 errors."""
    return acceptance.Judged(claimed, Checked(error**2, noise**2), energy, 0.001)


def test_a_claim_that_is_far_too_small_is_known() -> None:
    """Noise counts relative to the larger of claim and error, as an error and not as a square."""
    assert claim(0.001, 0.03, 0.01).is_known and not claim(0.001, 0.001, 0.01).is_known
    assert claim(0.02, 0.0, 0.0069).is_known and not claim(0.02, 0.0, 0.0071).is_known
    assert claim(0.0, 0.02, 0.0069).is_known and not claim(0.0, 0.02, 0.0071).is_known


def test_kinds_weigh_the_same_and_nothing_is_left_out_in_silence() -> None:
    """Twenty scenes of one kind are one of three; claims of nothing, and those that are not known, have lines."""
    whole = [*[claim(0.02, 0.02, 0.001)] * 20, claim(0.02, 0.01, 0.001, 0.9), claim(0.01, 0.05, 0.001)]
    whole += [claim(0.02, 0.0, 0.02), claim(0.0, 1.0, 0.1, 0.0), claim(0.0, 0.0, 0.0)._replace(noise=0.0)]
    kinds = ["one"] * 20 + [f"{number}" for number in range(5)]
    cases = [
        acceptance.Case(kind, f"{kind} {n}", 1.0, of, {"primary": (of, "cuts")}, {"box": of._replace(claimed=np.nan)})
        for n, (kind, of) in enumerate(zip(kinds, whole, strict=True))
    ]
    lines = acceptance.summary(cases, Accuracy(target=0.02)).splitlines()
    assert lines[0] == "25 scenes of 6 kinds, 25.0 processor s"
    assert lines[1] == "22 of 23 claims of wholes are known, of 3 kinds"
    assert lines[2] == "2 more wholes where nothing was met, in 1 of which paths met light; 0 without a claim"
    assert lines[3].endswith("median 1.00, 95 % 5.00, largest 5.00 (1 21); 1 beyond 1.5")
    assert "0 of 0 claims of objects are known, of 0 kinds" in lines
    assert "0 more objects where nothing was met, in 0 of which paths met light; 25 without a claim" in lines
    assert any(line.startswith("energy of primary") and "of 24; furthest 0.0000" in line for line in lines)


def test_what_paths_say_of_light() -> None:
    """They find about the energy of a room, and are doubled until they know its errors, and claims that look off."""
    kind, name, scene, capture = next(acceptance.foreign(1, 0))
    case = acceptance.measured(kind, name, scene, capture, Accuracy(target=0.1, max_bounces=3), 2.0)
    assert (case.kind, case.name, set(case.components)) == ("0", "foreign 0", {"primary"})
    assert abs(case.whole.energy - 1) < 5 * case.whole.noise + 0.1
    far = case._replace(whole=claim(0.001, 0.03, 0.001), objects={})
    assert not far.is_done(0) and far.is_done(1)
    assert not case._replace(whole=claim(0.001, 0.0, 0.01), objects={}).is_done(1)


@pytest.mark.parametrize("what", sequences.WHAT)
def test_sequences_have_a_row_for_each_mover(what: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sequences, "SIDE", 2)
    monkeypatch.setattr(sequences, "FINE", Accuracy(target=0.05))
    *rooms, table = sequences.WHAT[what](["box"], 1)
    row = next(line for line in table.splitlines() if line.startswith("| box"))
    assert len(rooms) == 1 and row.count("|") == table.splitlines()[0].count("|")
    assert any(character.isdigit() for character in row)
