"""The example of DENALI's task: effects that it leaves out, and a network on made-up plates."""

from __future__ import annotations

import re
import runpy
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from datasets import write_dataset
from example_runs import run_example
from PIL import Image

import datagen as dg
from datagen.suites.catalogue import find_suite
from datagen.transport.flood import light_at_sensor

pytestmark = pytest.mark.usefixtures("builds_here")

SCRIPT = Path(__file__).parents[2] / "examples" / "denali_training.py"


@pytest.fixture(scope="module")
def made() -> dict[str, Any]:
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(SCRIPT.parent))
        return runpy.run_path(str(SCRIPT))


@pytest.fixture(scope="module")
def measured(made: dict[str, Any]) -> Any:
    """Light of 6 zones, and what the suite detects it with."""
    from datagen.detector import detector_for

    config = find_suite("denali-1").config
    light = np.random.default_rng(1).gamma(0.2, 1e-12, (1, 64, 1024))
    return made["Measurement"](light, *detector_for(config.detector, 1, 0, config.capture.time.axis()))


def test_what_is_left_out_is_gone_and_nothing_else(made: dict[str, Any], measured: Any) -> None:
    of = {name: without(measured) for name, without in made["effects"](0.0098).items()}
    assert of["nothing"] is measured
    assert of["pile-up"] == replace(measured, spad=replace(measured.spad, mode="ideal"))
    floor = of["floor"]
    assert (floor.spad.dark_count_rate_hz, floor.exposure.ambient_rate_hz) == (0, 0)
    assert measured.spad.dark_count_rate_hz > 0 and measured.exposure.ambient_rate_hz > 0
    full, gauss, short = (of[name].exposure.pulse for name in ("nothing", "the pulse's tail", "the pulse's length"))
    rise, fall = made["half_maxima"](full)
    np.testing.assert_allclose(made["half_maxima"](gauss), (rise, fall), atol=2e-12)
    # Of the measured pulse a sixtieth comes later than 1 ns after its middle; of the Gaussian nothing.
    late = [
        np.array(p.samples)[p.start_s + p.width_s * np.arange(len(p.samples)) > 1e-9].sum() for p in (full, gauss)
    ]
    assert late[0] > 0.015 and late[1] < 1e-9
    assert short.samples == (1.0,) and short.start_s + short.width_s / 2 == pytest.approx((rise + fall) / 2)
    for name in ("the pulse's tail", "the pulse's length"):
        assert of[name].spad is measured.spad and of[name].light is measured.light


def test_crosstalk_is_taken_out_of_the_light(made: dict[str, Any], measured: Any) -> None:
    capture = dg.capture_for(
        find_suite("denali-1").config, dg.generate_scene(find_suite("denali-1").config.scene, 1, 0)
    )
    assert capture.sensor.crosstalk == find_suite("denali-1").config.capture.device.zones.crosstalk  # type: ignore[union-attr]
    mixed = light_at_sensor(measured.light, capture)
    bare = made["without_crosstalk"](replace(measured, light=mixed), capture.sensor.crosstalk)
    np.testing.assert_allclose(bare.light, measured.light, rtol=1e-9, atol=1e-20)
    assert np.abs(mixed - measured.light).max() > 1e-13


def plates(made: dict[str, Any], count: int, seed: int) -> Any:
    """Light of a plate comes later the farther it is, in zones of its side; it is brighter if the plate is large."""
    rng = np.random.default_rng(seed)
    places, tall = rng.uniform([-0.15, 0.3], [0.15, 0.6], (count, 2)), rng.integers(0, 2, count)
    zone, bins = np.arange(8), np.arange(68)
    in_time = np.exp(-(((bins - 100 * places[:, 1:]) / 3) ** 2))
    in_zones = np.exp(-(((zone - 3.5 - 20 * places[:, :1]) / 2) ** 2))
    light = (20 + 60 * tall)[:, None, None] * in_zones[:, :, None] * in_time[:, None]
    expected = torch.from_numpy((15 + light).astype(np.float32))
    generator = torch.Generator().manual_seed(seed)
    return made["Plates"](
        np.arange(count), torch.poisson(expected, generator), {"nothing": expected},
        torch.from_numpy(places).float(), torch.from_numpy(rng.integers(0, 3, count)),
        torch.from_numpy(0.1 + 0.1 * tall).float(), np.full(count, 20.0),
    )  # fmt: skip


def test_the_network_learns_place_and_height_and_no_class_that_light_does_not_show(made: dict[str, Any]) -> None:
    train, test = plates(made, 200, 1), plates(made, 200, 2)
    found = made["said"](made["trained"](train, 3, 0, 30), test)
    blind = made["distances"](made["guessed"](train, test), test)
    assert made["rms"](made["distances"](found, test)) < 0.2 * made["rms"](blind)
    assert made["wrong"](found, test).mean() < 0.05
    assert (found["classes"] == test.classes.numpy()).mean() < 0.5
    # Another floor is seen as light of a plate, unless frames are compared with the mean of their own sensor.
    brighter = replace(test, counts=test.counts + 15)
    as_is, centred = (made["said"](made["trained"](train, 3, 0, 30), brighter, centred=c) for c in (False, True))
    assert made["rms"](made["distances"](centred, test)) < 0.5 * made["rms"](made["distances"](as_is, test))


def test_the_example_prints_scores_and_draws(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its figures are those of `datagen score`."""
    config = find_suite("denali-1").config
    coarse = config.model_copy(update={"transport": config.transport.model_copy(update={"samples": 2}), "scenes": 20})
    suite = write_dataset(coarse, tmp_path / "suite.zarr")
    run_example(SCRIPT, tmp_path / "picture.png", "--dataset", suite, "--matt", suite, "--epochs", 1, "--seeds", 2)
    lines = capsys.readouterr().out.splitlines()
    rows = {cells[1].strip(): [cell.strip() for cell in cells[2:-1]] for x in lines if len(cells := x.split("|")) > 5}
    data = dg.TransientDataset(suite, ("object_box_center",), split="train")
    mean = np.mean([item["object_box_center"][0, [0, 2]].double().numpy() for item in data], axis=0)  # type: ignore[attr-defined]
    test = dg.TransientDataset(suite, ("object_box_center",), split="test").scenes
    scores = dg.score(suite, {"scene": test, "places": np.tile(mean, (len(test), 1))}).all
    due = [f"{100 * scores[name]:.1f}" for name in ("place_rms_m", "place_median_m", "place_p90_m")]
    assert rows["always the mean, or what is most frequent"][:3] == due
    assert {"network, 12 scenes", "network, 3 scenes", "floor", "photon noise"} <= rows.keys()
    # Networks that were tested on the same scenes twice found the same twice.
    assert rows["network, 12 scenes"] == rows["network, tested on 6 matt plates"]
    assert all(re.fullmatch(r"\d+\.\d ± \d+\.\d", cell) for cell in rows["nothing"])
    with Image.open(tmp_path / "picture.png") as picture:
        assert picture.width == 880
