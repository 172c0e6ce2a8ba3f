"""The comparison of examples/evidence_training.py: small, and on labels of which it is known what they rest on."""

from __future__ import annotations

import runpy
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

SCRIPT = Path(__file__).parents[2] / "examples" / "evidence_training.py"
made: dict[str, Any] = runpy.run_path(str(SCRIPT))
PLAIN, WEIGHTED, OVER = made["RECIPES"]


def scenes(count: int, seed: int) -> Any:
    """The depth of a box is the bin of its light; of one in two there is no light, and the depth is anything."""
    rng = np.random.default_rng(seed)
    depth = rng.uniform(0.2, 1.4, count)
    seen = np.arange(count) % 2 == 0
    light = 40 * np.exp(-(((np.arange(16) - 10 * depth[:, None]) / 1.5) ** 2)) * seen[:, None]
    counts = torch.from_numpy(rng.poisson(1 + light[:, None, None, :], (count, 4, 1, 16)).astype(np.float32))
    image = torch.zeros(count, 16, 16)
    image[:, 4:12, 4:12] = torch.from_numpy(depth.astype(np.float32))[:, None, None]
    sigma = torch.from_numpy(np.where(seen, 30.0, 0.01).astype(np.float32))
    return made["Scenes"](counts[None], image, torch.zeros_like(image), sigma)


def test_labels_without_light_cost_a_network_that_believes_them() -> None:
    train, val, kept = scenes(96, 1), scenes(100, 3), scenes(400, 2)
    seen = kept.sigma.numpy() > 3
    errors = {}
    for recipe in (PLAIN, WEIGHTED, OVER):
        networks = [made["trained"](recipe, train, val, seed, 40) for seed in range(2)]
        found = [made["found_in"](network, kept) for network in networks]
        errors[recipe] = np.mean([made["square_error"](of, kept)[seen].mean() for of in found])
    blind = made["square_error"](torch.full_like(kept.depth, made["mean_depth"](train)), kept)
    assert errors[WEIGHTED] < 0.2 * blind[seen].mean()
    assert errors[WEIGHTED] < 0.9 * errors[PLAIN] and errors[OVER] < 0.9 * errors[PLAIN]
    # Without light no network can know the depth.
    assert blind[~seen].mean() == pytest.approx(1.2**2 / 12, rel=0.2)


def test_the_command_prints_a_table_and_draws(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    threads = torch.get_num_threads()
    out = tmp_path / "picture.png"
    monkeypatch.setattr(sys, "argv", [str(SCRIPT), str(out), "--scenes", "14", "--epochs", "1", "--seeds", "2"])
    try:
        made["main"]()
    finally:
        torch.set_num_threads(threads)
    rows = capsys.readouterr().out.splitlines()
    assert len(rows) == 7 and "| scenes kept back | " in rows[2]
    # Two of each ten, and of what is left over.
    assert 2 <= sum(int(cell) for cell in rows[2].split("|")[2:-1]) <= 4
    assert out.stat().st_size > 10_000
