"""examples/nlos_real_training.py at small size: scans of known plates, a letter found by its light, and a network."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import nlos_real_training
import numpy as np
import pytest
import torch

ROOT = Path(__file__).parents[2]
SCRIPT = ROOT / "examples" / "nlos_real_training.py"
REAL = ROOT.parent / "shared" / "real"
made: dict[str, Any] = vars(nlos_real_training)
real = pytest.mark.skipif(
    not all((REAL / made[name]).is_file() for name in ("IRF", "LETTER", "CHART")), reason="needs two real scans"
)
SIDE = 0.7
LETTER = made["Letter"](-0.03, -0.05, 0.4, 0.52, 0.09, 0.5, 0.0, 0.03)


@pytest.fixture(scope="module", autouse=True)
def one_thread() -> Iterator[None]:
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(threads)


@pytest.fixture(scope="module")
def response() -> np.ndarray:
    """A pulse as a laboratory's: a Gaussian peak of 48 ps with a tail, in bins of 8 ps, its peak in bin 500."""
    bins = np.arange(4500) - 500.0
    return 1e5 * np.where(
        bins < 0, np.exp(-(bins**2) / 13), 0.85 * np.exp(-(bins**2) / 13) + 0.15 * np.exp(-bins / 25)
    )


@pytest.fixture(scope="module")
def scan(response: np.ndarray) -> Any:
    """Counts of the letter, with direct light, floor and noise like those of the real S."""
    width, bins = made["FINE_S"], made["BINS"] * 4
    light = LETTER.arrivals(SIDE, bins, width)
    light *= 1500 / light.sum(axis=2).mean()
    light[..., 0] += 4e4
    coarse = response[500:3300].reshape(-1, 2).mean(axis=1)
    spread = np.fft.irfft(np.fft.rfft(light, 4096) * np.fft.rfft(coarse / coarse.sum(), 4096), 4096)[..., :bins]
    rng = np.random.default_rng(0)
    return made["Real"](rng.poisson(np.maximum(spread, 0) + 8).astype(float), SIDE)


def test_light_of_a_plate_arrives_at_twice_its_distance() -> None:
    """The points of the scan that the letter covers see its nearest part opposite them."""
    first = (LETTER.arrivals(SIDE, 512, made["FINE_S"]) > 0).argmax(axis=2)[made["outline_of"](LETTER, SIDE)]
    assert np.abs(first * made["FINE_S"] * 299_792_458.0 / 2 - LETTER.depth).max() < 0.015


def test_the_letter_is_found_by_its_light_and_by_classical_methods(
    scan: Any, response: np.ndarray, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(made["letter_of"].__globals__, "EVALUATIONS", 60)
    letter, explained = made["letter_of"](scan, response)
    truth = made["outline_of"](LETTER, SIDE)
    assert abs(letter.depth - LETTER.depth) < 0.01 and explained > 0.5
    assert made["overlap"](made["outline_of"](letter, SIDE), truth) > 0.6
    for mask, depth in made["classical"](scan, truth).values():
        assert made["overlap"](mask, truth) > 0.4
        assert abs(np.median(depth[mask]) * SIDE - LETTER.depth) < 0.02


def test_a_network_learns_silhouette_and_depth() -> None:
    """Of discs in volumes without noise."""
    rng = np.random.default_rng(0)
    y, x = np.mgrid[:32, :32]
    masks, layers = [], rng.integers(20, 40, 32)
    volumes = 0.1 * rng.random((32, len(made["METHODS"]), made["LAYERS"], 32, 32)).astype(np.float32)
    for volume, layer in zip(volumes, layers, strict=True):
        row, column, radius = rng.uniform(10, 22), rng.uniform(10, 22), rng.uniform(4, 9)
        masks.append((x - column) ** 2 + (y - row) ** 2 < radius**2)
        volume[:, layer, masks[-1]] += 0.9
    mask = np.stack(masks)
    depths = mask * np.asarray(made["layers"](1.0))[layers][:, None, None]
    some, middle = zip(*map(made["about_brightest"], volumes), strict=True)
    scans = made["Scans"](
        torch.tensor(middle, dtype=torch.float32), torch.from_numpy(np.stack(some)), volumes.max(axis=2),
        torch.from_numpy(mask).float(), torch.from_numpy(depths).float(),
    )  # fmt: skip
    network = made["trained"](scans, 0, 20)
    score, off = made["kept_back"](network, scans)
    assert score > 0.7 and off < 0.01
    found, depth = made["said"](network, volumes[0])
    assert made["overlap"](found, mask[0]) > 0.6 and abs(np.median(depth[found]) - depths[0].max()) < 0.02


def test_without_the_scans_the_script_says_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "argv", [str(SCRIPT), str(tmp_path), str(tmp_path / "picture.png")])
    made["main"]()
    assert "missing" in capsys.readouterr().out and not (tmp_path / "picture.png").exists()


@real
def test_the_real_letter_arrives_when_a_plate_at_its_place_would() -> None:
    """Point by point; the letter is the fit's, and its light is moved by whole bins until it fits best."""
    scan = made["Real"].read(REAL / made["LETTER"])
    pulse, before = scan.pulse(np.load(REAL / made["IRF"]).astype(float))
    letter = made["Letter"](-0.0317, -0.0560, 0.3883, 0.5259, 0.1149, 0.4963, 0.0049, 0.0332)
    bins, width = scan.fine.shape[2], made["FINE_S"]
    light = letter.arrivals(scan.side, bins, width)
    light = np.fft.irfft(np.fft.rfft(light, 2 * bins) * np.fft.rfft(pulse, 2 * bins), 2 * bins)
    light = light[..., before : before + bins]
    window = slice(round(2.9e-9 / width), round(5.5e-9 / width))
    moved = range(-8, 9)
    scores = np.stack([
        [np.corrcoef(a, b)[0, 1] for a, b in zip(np.roll(light, k, axis=2)[..., window].reshape(1024, -1),
                                               scan.fine[..., window].reshape(1024, -1), strict=True)]
        for k in moved
    ])  # fmt: skip
    shift = np.array(moved)[scores.argmax(axis=0)]
    assert abs(np.median(shift)) <= 1 and np.median(np.abs(shift)) <= 2
    # The floor is Poisson's: 1024 points of 100 bins, at the level 10⁻⁶ of a normal distribution.
    floor = scan.fine[..., -100:]
    assert floor.var(axis=2, ddof=1).mean() / floor.mean() == pytest.approx(1, abs=5 * np.sqrt(2 / (1024 * 99)))


@real
@pytest.mark.nightly
def test_the_tables_and_the_picture_of_the_real_scans(tmp_path: Path) -> None:
    found = made["compared"](REAL, 4, 2, 2, 1)
    # The plate of the S, by its light, and the chart, by its file's name; f-k finds both without learning.
    assert found.letter.depth == pytest.approx(0.497, abs=0.01) and found.explained > 0.8
    for name in found.scans:
        f_k = found.answers[name][made["FK"]]
        assert abs(found.depth_m(name, f_k) - found.plane_m(name)) < 0.02
    assert "| retroreflection |" in made["tables"](found)
    made["draw"](found, tmp_path / "picture.png")
    assert (tmp_path / "picture.png").stat().st_size > 10_000
