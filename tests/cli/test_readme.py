"""What the README shows, run: its training example, its configuration, its simulation example."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
import trimesh

import datagen
from datagen.config import config_from_mapping, load_config
from datagen.config.yaml_text import parse_yaml

ROOT = Path(__file__).resolve().parents[2]
README = (ROOT / "README.md").read_text(encoding="utf-8")


def blocks(language: str) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```", README, re.DOTALL | re.MULTILINE)


def test_training_example_lowers_its_loss(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys) -> None:
    """The example as printed, on a small build of the quickstart configuration."""
    values = parse_yaml((ROOT / "configs/quickstart.yaml").read_text(encoding="utf-8"), "quickstart")
    values["scenes"] = 12
    values["transport"] = {"lookins": 64, "fov_samples": 1}
    datagen.build(config_from_mapping(values), tmp_path / "out/quickstart.zarr", progress=False)
    monkeypatch.chdir(tmp_path)
    import torch

    torch.manual_seed(0)
    example = next(block for block in blocks("python") if "DataLoader" in block)
    exec(compile(example, "README.md", "exec"), {})
    losses = [float(line.split()[1]) for line in capsys.readouterr().out.splitlines() if re.match(r"\d+ \d", line)]
    assert len(losses) == 8
    assert losses[-1] < 0.7 * losses[0]


def test_simulation_example_runs(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(ROOT)
    example = next(block for block in blocks("python") if "generate_scene" in block)
    names: dict[str, object] = {}
    exec(compile(example.replace("lookins=4096", "lookins=128"), "README.md", "exec"), names)
    counts = names["counts"]
    assert isinstance(counts, np.ndarray)
    assert counts.shape == (256, 1, 512)
    assert counts.sum() > 0


def test_configuration_example_is_one(tmp_path: Path) -> None:
    trimesh.creation.icosphere(subdivisions=1).export(tmp_path / "spot.obj")
    (tmp_path / "spots.yaml").write_text(blocks("yaml")[0], encoding="utf-8")
    config = load_config(tmp_path / "spots.yaml")
    assert config.transport.max_bounces == 4
    assert datagen.generate_scene(config.scene, seed=3, index=0).roles.count("object") == 2


def test_public_names_are_importable() -> None:
    for name in datagen.__all__:
        assert getattr(datagen, name) is not None
