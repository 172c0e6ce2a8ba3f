"""A small network: one hidden layer between all bins and all pixels."""

from __future__ import annotations

import copy
from collections.abc import Callable
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from datagen.baselines.scenes import SuiteScenes
from datagen.records.arrays import Bools, Floats

HIDDEN = 64
EPOCHS = 40
BATCH = 32
RATE = 3e-3
"""Units of the hidden layer, epochs, scenes a batch, and learning rate. Any other value, such as half, gives another
baseline, whose scores are not comparable."""
THRESHOLDS = np.linspace(0.05, 0.95, 19)
"""Candidates for the probability above which a pixel (or voxel) counts as an object. The candidate is chosen whose
silhouettes (or volumes) overlap best in the split val."""


def small_network(outputs: int) -> torch.nn.Sequential:
    """A network from histograms (scene, laser, pixel, bin) to (scene, outputs)."""
    layers = (
        torch.nn.LazyLinear(HIDDEN),
        torch.nn.LayerNorm(HIDDEN),
        torch.nn.ReLU(),
        torch.nn.Linear(HIDDEN, outputs),
    )
    return torch.nn.Sequential(torch.nn.Flatten(), *layers)


class Normalized(torch.nn.Module):
    """A network whose input is log(1 + counts), centred and scaled as over the training scenes."""

    def __init__(self, train: torch.Tensor, outputs: int, seed: int) -> None:
        super().__init__()
        torch.manual_seed(seed)
        self.network = small_network(outputs)
        counts = torch.log1p(train)
        self.mean, self.spread = counts.mean(dim=0), counts.std()
        self(train[:1])

    def forward(self, counts: torch.Tensor) -> torch.Tensor:
        """(scene, outputs) of histograms (scene, laser, pixel, bin)."""
        return torch.as_tensor(self.network((torch.log1p(counts) - self.mean) / self.spread))


def predictions_of(train: SuiteScenes, val: SuiteScenes, wanted: SuiteScenes, seed: int) -> dict[str, NDArray[Any]]:
    """`depth`, `mask` and `occupancy` of the scenes `wanted`, from three networks that are trained in the same way.

    The first learns depth minus its mean over the training scenes, at pixels of objects only; the others learn the
    probability that a pixel or a voxel shows an object. Of each network the epoch with the least loss in the split
    val is taken.
    """
    mean = float(train.depth[train.mask].mean())
    depth = _trained_network(train, val, lambda scenes: (scenes.depth - mean, scenes.mask), seed)
    found: dict[str, NDArray[Any]] = {
        "depth": np.maximum(mean + _outputs(depth, wanted.histogram), 0.0).reshape(wanted.depth.shape)
    }
    for name in ("mask", "occupancy"):
        model = _trained_network(train, val, lambda scenes, name=name: (getattr(scenes, name), None), seed)  # type: ignore[misc]
        least = best_threshold(_outputs(model, val.histogram), getattr(val, name).reshape(len(val.scene), -1))
        found[name] = (_outputs(model, wanted.histogram) > least).reshape(getattr(wanted, name).shape)
    return found


def _trained_network(
    train: SuiteScenes, val: SuiteScenes, due: Callable[[SuiteScenes], tuple[NDArray[Any], Bools | None]], seed: int
) -> Normalized:
    """A trained network.

    due : returns, for scenes, the targets (scene, …) and the places at which the squared error counts. If the places
        are None, the targets are 0 or 1 at all places, and the network learns their log odds.
    """
    counts, unseen = torch.from_numpy(train.histogram), torch.from_numpy(val.histogram)
    (target, weight), (val_target, val_weight) = (_flat(*due(scenes)) for scenes in (train, val))
    model = Normalized(counts, target.shape[1], seed)
    optimizer = torch.optim.Adam(model.parameters(), lr=RATE)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, EPOCHS)
    least, best = float("inf"), copy.deepcopy(model.state_dict())
    for _ in range(EPOCHS):
        for chosen in torch.randperm(len(counts)).split(BATCH):
            loss = _loss(model(counts[chosen]), target[chosen], None if weight is None else weight[chosen])
            optimizer.zero_grad()
            loss.backward()
            optimizer.step()
        schedule.step()
        with torch.no_grad():
            off = float(_loss(model(unseen), val_target, val_weight))
        if off < least:
            least, best = off, copy.deepcopy(model.state_dict())
    model.load_state_dict(best)
    return model


def _flat(target: NDArray[Any], weight: Bools | None) -> tuple[torch.Tensor, torch.Tensor | None]:
    values = torch.from_numpy(target.astype(np.float32)).flatten(1)
    return values, None if weight is None else torch.from_numpy(weight.astype(np.float32)).flatten(1)


def _loss(out: torch.Tensor, due: torch.Tensor, weight: torch.Tensor | None) -> torch.Tensor:
    if weight is None:
        return torch.nn.functional.binary_cross_entropy_with_logits(out, due)
    return (weight * (out - due) ** 2).sum() / weight.sum().clamp(min=1)


def _outputs(model: Normalized, histogram: NDArray[np.float32]) -> Floats:
    with torch.no_grad():
        return np.asarray(model(torch.from_numpy(histogram)).double().numpy())


def best_threshold(odds: Floats, there: Bools) -> float:
    """The log odds, out of those of `THRESHOLDS`, above which `odds` (scene, place) overlaps best with `there`."""
    levels = np.log(THRESHOLDS / (1 - THRESHOLDS))
    overlaps = []
    for level in levels:
        found = odds > level
        overlaps.append(np.mean((found & there).sum(axis=1) / np.maximum((found | there).sum(axis=1), 1)))
    return float(levels[int(np.argmax(overlaps))])
