"""The commands on a real dataset: plan, build, verify, info, schema, and how they end."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from damage import reseal
from datasets import rewritten

from datagen.cli import run
from datagen.report import pages
from datagen.store.scenes import Scenes
from datagen.store.verify import dataset_digest

pytestmark = pytest.mark.usefixtures("builds_here")

ROOT = Path(__file__).parents[2]
CONFIG = """
name: tiny
scenes: 3
capture: {scan: {rows: 2, columns: 2}, time: {bins: 64, bin_width_ps: 800}}
transport: {samples: 64}
detector: {mode: ideal, photons_per_pulse: 1000.0}
labels: {rows: 8, columns: 8}
store: {fields: [histogram, transient, transient_stderr, depth, part_id], scenes_per_shard: 2}
"""


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A dataset simulated for real, by the command."""
    folder = tmp_path_factory.mktemp("cli")
    (folder / "tiny.yaml").write_text(CONFIG)
    assert run(["build", str(folder / "tiny.yaml"), str(folder / "out/tiny.zarr"), "--quiet"]) == 0
    return folder


def test_the_whole_chain(built: Path, capsys: pytest.CaptureFixture[str]) -> None:
    dataset = str(built / "out/tiny.zarr")
    assert run(["verify", dataset]) == 0
    assert "3 scenes in 2 shards" in capsys.readouterr().out
    assert run(["info", dataset]) == 0
    text = capsys.readouterr().out
    for piece in ("tiny", "3 of 3", "3 × 4 × 1 × 64", "transport", "scenes/s"):
        assert piece in text
    assert run(["build", str(built / "tiny.yaml"), dataset]) == 0
    assert "nothing left to build, 2 were there; complete with 3 scenes" in capsys.readouterr().out


def test_build_and_show_say_what_to_do_next(
    built: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """In their last line, where everything is there; standard output has what a script reads."""
    config, dataset = str(built / "tiny.yaml"), str(built / "out/tiny.zarr")
    assert run(["build", config, dataset]) == 0
    last = capsys.readouterr().err.splitlines()[-1]
    assert last == f"next: datagen info {dataset}; datagen show {dataset} 0"
    assert run(["build", config, dataset, "--quiet"]) == 0
    assert "next:" not in capsys.readouterr().err
    assert run(["build", config, str(tmp_path / "part"), "--shards", "0"]) == 0
    said = capsys.readouterr()
    assert "other shards are missing" in said.out and "next:" not in said.err
    monkeypatch.setattr(pages, "show", lambda *_: [Path("overview.png")])
    assert run(["show", "a set", "0"]) == 0
    said = capsys.readouterr()
    assert said.out == "overview.png\n"
    assert said.err.splitlines()[-1].startswith("next: datagen preview 'a set'; README (Train on it; Track somebody)")
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    assert "\n## Train on it\n" in readme and "\n## Track somebody" in readme


def test_pages_and_pictures_are_drawn(built: Path, capsys: pytest.CaptureFixture[str]) -> None:
    page, sheet = built / "page.html", built / "sheet.png"
    assert run(["preview", str(built / "out/tiny.zarr"), "--out", str(page), "--scenes", "1"]) == 0
    assert capsys.readouterr().out.strip() == str(page) and "tiny" in page.read_text()
    assert run(["sheet", str(built / "tiny.yaml"), str(sheet), "--rooms", "2"]) == 0
    assert sheet.read_bytes()[:4] == b"\x89PNG"
    assert run(["sheet", str(built / "tiny.yaml"), str(sheet), "--rooms", "0"]) == 2
    assert "--rooms 0: " in capsys.readouterr().err


def test_two_workers_simulate_the_same_values(built: Path, tmp_path: Path) -> None:
    assert run(["build", str(built / "tiny.yaml"), str(tmp_path / "two"), "--workers", "2", "--quiet"]) == 0
    assert dataset_digest(built / "out/tiny.zarr") == dataset_digest(tmp_path / "two")


def test_scenes_simulated_again_are_those_stored(
    built: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    dataset = str(built / "out/tiny.zarr")
    assert run(["verify", dataset, "--deep", "--resimulate", "9"]) == 0
    assert capsys.readouterr().out.endswith("all as written; scenes simulated again: 0, 1, 2\n")
    assert run(["verify", dataset, "--resimulate", "-1"]) == 2 and "--resimulate': -1" in capsys.readouterr().err
    assert run(["digest", dataset]) == 0
    assert re.fullmatch(r"[0-9a-f]{64}\n", capsys.readouterr().out)

    shutil.copytree(dataset, tmp_path / "set")
    record = tmp_path / "set/build/shard-000001.json"
    reseal(record, lambda values: values["scenes"][0]["digests"].update(histogram="0" * 64))
    assert run(["verify", str(tmp_path / "set"), "--resimulate", "3"]) == 1
    assert "scene 2: histogram: damaged\n" in capsys.readouterr().out
    drawn = np.array(Scenes(dataset).read(2).arrays["histogram"]) + 9
    other = rewritten(Path(dataset), tmp_path / "other", 2, histogram=drawn)
    assert run(["verify", str(other), "--resimulate", "3"]) == 1
    assert "scene 2: simulated again, histogram differ\n" in capsys.readouterr().out
    reseal(other / "build/shard-000001.json", lambda values: values["made_by"].update(processor="another"))
    assert run(["verify", str(other), "--resimulate", "3"]) == 1
    assert "histogram differ (what it was made with differs: processor another and " in capsys.readouterr().out
    reseal(tmp_path / "set/dataset.json", lambda values: values["made_by"].update(datagen="9.9.9"))
    assert run(["verify", str(tmp_path / "set"), "--resimulate", "3"]) == 2
    assert "made by datagen 9.9.9, and this is" in capsys.readouterr().err
    (tmp_path / "set/data.zarr/depth/c/1/0/0").unlink()
    assert run(["verify", str(tmp_path / "set"), "--resimulate", "3"]) == 2
    assert "shard 1: data.zarr/depth/c/1/0/0: missing\n" in capsys.readouterr().out
    assert run(["verify", str(tmp_path / "set")]) == 1
    out, err = capsys.readouterr()
    assert "shard 1: data.zarr/depth/c/1/0/0: missing\n" in out
    assert err.startswith("datagen: ") and err.count("\n") == 1


def test_the_schema_in_the_repository_is_the_one_the_code_has(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["schema"]) == 0
    assert (ROOT / "configs/schema.json").read_text() == capsys.readouterr().out, (
        "the keys have changed since configs/schema.json: make generated"
    )


def test_help_is_quick_because_it_loads_nothing_heavy() -> None:
    """Beside the standard library `--help` imports click and this package's first modules: the only cost there is."""
    code = """
import sys
before = set(sys.modules)
from datagen.cli import run
assert run(["--help"]) == 0
print("loaded:", *sorted({name.partition(".")[0] for name in set(sys.modules) - before} - sys.stdlib_module_names))
"""
    printed = subprocess.check_output([sys.executable, "-c", code], text=True)
    assert "build" in printed and printed.splitlines()[-1] == "loaded: click datagen lazy_loader"


@pytest.mark.parametrize("command", [["device"], ["device", "tmf8820"], ["suite"]])
def test_lists_are_quick_because_they_load_configurations_alone(command: list[str]) -> None:
    code = f"""
import sys
from datagen.cli import run
assert run({command}) == 0
print("loaded:", *sorted({{"numba", "open3d", "scipy", "torch", "trimesh", "zarr"}} & set(sys.modules)))
"""
    printed = subprocess.check_output([sys.executable, "-c", code], text=True)
    assert len(printed.splitlines()) > 8 and printed.splitlines()[-1] == "loaded:"


def test_a_reader_that_leaves_early_is_no_error() -> None:
    pipe = subprocess.Popen(
        [sys.executable, "-m", "datagen", "schema"], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    assert pipe.stdout is not None and pipe.stderr is not None
    pipe.stdout.read(1)
    pipe.stdout.close()
    assert pipe.stderr.read() == ""
    pipe.wait(timeout=30)
    pipe.stderr.close()
