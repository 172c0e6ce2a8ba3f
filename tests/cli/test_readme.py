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

pytestmark = pytest.mark.usefixtures("builds_here")

ROOT = Path(__file__).resolve().parents[2]
README = (ROOT / "README.md").read_text(encoding="utf-8")


def blocks(language: str) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```", README, re.DOTALL | re.MULTILINE)


@pytest.fixture(scope="module")
def beside_a_quickstart(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder as `make demo` leaves it: configurations and out/quickstart.zarr, with fewer scenes, laser points and
    rays."""
    folder = tmp_path_factory.mktemp("readme")
    (folder / "configs").symlink_to(ROOT / "configs")
    values = parse_yaml((ROOT / "configs/quickstart.yaml").read_text(encoding="utf-8"), "quickstart")
    values["scenes"] = 12
    values["capture"]["scan"] |= {"rows": 8, "columns": 8}
    values["transport"] = {"samples": 64}
    datagen.build(config_from_mapping(values), folder / "out/quickstart.zarr", progress=False)
    return folder


@pytest.mark.parametrize("number", range(len(blocks("python"))))
def test_python_examples_run_as_printed(
    number: int, beside_a_quickstart: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """With a wider target where an example names one. One that prints its errors learns the few rooms there are."""
    import torch

    torch.manual_seed(0)
    monkeypatch.chdir(beside_a_quickstart)
    names: dict[str, object] = {}
    example = re.sub(r"(?<=target=)[\d.]+", "0.3", blocks("python")[number])
    exec(compile(example, f"README.md, example {number}", "exec"), names)
    if "counts" in names:
        assert np.sum(names["counts"]) > 0  # type: ignore[call-overload]
    said = [line for line in capsys.readouterr().out.splitlines() if line.endswith(" m")]
    if "DataLoader" in example:
        assert len(said) == 1 + 16 and "nan" not in "".join(said)
        distance, found = names["distance"], names["found"]
        rooms = datagen.collate(names["train"].__getitems__(range(len(names["train"]))))  # type: ignore[attr-defined, arg-type]
        mean = rooms["object_box_center"][..., [2, 0]].mean(dim=0)
        with torch.no_grad():
            left = distance(found(rooms), rooms).mean()  # type: ignore[operator]
        assert left < 0.8 * distance(mean, rooms).mean()  # type: ignore[operator]


def test_configuration_example_is_one(tmp_path: Path) -> None:
    trimesh.creation.icosphere(subdivisions=1).export(tmp_path / "spot.obj")
    (tmp_path / "spots.yaml").write_text(blocks("yaml")[0], encoding="utf-8")
    config = load_config(tmp_path / "spots.yaml")
    assert (config.transport.target, config.transport.max_bounces) == (0.02, 4)
    assert datagen.generate_scene(config.scene, seed=3, index=0).roles.count("object") == 2
