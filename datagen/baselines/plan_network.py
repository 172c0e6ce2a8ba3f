"""A small network that says where somebody is in each frame of a sequence, from floor plans."""

from __future__ import annotations

import math

import numpy as np
import torch
from torch import nn

from datagen.baselines.walks import PLANS, VOXELS, Walks
from datagen.records.arrays import Floats, Ints

WIDTH = 16
REACHES = (1, 2, 4, 2, 1)
"""Channels of a layer, and the distances in voxels of the places that each layer looks at."""
EPOCHS = 30
BATCH = 8
RATE = 4e-3
"""Epochs, sequences a batch, and the largest learning rate. Any other value gives another baseline, whose scores are
not comparable."""
SIGMAS = 4.0
"""Plans are divided by it: an object stands out of the noise by some of these."""
SPEED_WEIGHT = 0.2
"""Weight of a metre a second of velocity beside a metre of place."""


class PlanNetwork(nn.Module):
    """Convolutions over (frame, depth, column), and at each frame the mean place under a softmax over the plan."""

    def __init__(self) -> None:
        super().__init__()
        layers: list[nn.Module] = []
        channels = len(PLANS) + 2
        for step in REACHES:
            layers.append(nn.Conv3d(channels, WIDTH, 3, padding=(1, step, step), dilation=(1, step, step)))
            layers += [nn.GroupNorm(4, WIDTH), nn.ReLU()]
            channels = WIDTH
        self.body, self.head = nn.Sequential(*layers), nn.Conv3d(WIDTH, 3, 1)
        depth, column = ((torch.arange(n) + 0.5) / n for n in (VOXELS[0], VOXELS[2]))
        self.places: torch.Tensor
        self.register_buffer("places", torch.stack(torch.meshgrid(column, depth, indexing="xy")))

    def forward(self, plans: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """(N, F, 2) place along right and depth as shares of the plan, and velocity in m/s.

        plans : (N, plan, F, depth, column).
        """
        count, _, frames, *size = plans.shape
        where = self.places[None, :, None].expand(count, 2, frames, *size)
        found = self.head(self.body(torch.cat([plans / SIGMAS, where], dim=1)))
        chance = found[:, 0].flatten(2).softmax(dim=-1).view(count, 1, frames, *size)
        place, velocity = ((chance * of).sum(dim=(3, 4)).transpose(1, 2) for of in (where, found[:, 1:]))
        return place, velocity


def learnt_ways(train: Walks, wanted: Walks, seed: int, epochs: int = EPOCHS) -> tuple[Floats, Floats]:
    """Places and velocities (N, F, 2) along right and depth of the label frame, metres and metres a second, by a
    network that is trained on other walks."""
    model = trained_network(train, seed, epochs)
    with torch.no_grad():
        found = [model(_plans(wanted, chosen)) for chosen in np.array_split(np.arange(len(wanted.scene)), 16)]
    place, velocity = (torch.cat(parts).double().numpy() for parts in zip(*found, strict=True))
    return wanted.metres(place), velocity


def trained_network(walks: Walks, seed: int, epochs: int = EPOCHS) -> PlanNetwork:
    """A trained network. At each step half of the sequences are mirrored, and half run backwards: both may happen."""
    torch.manual_seed(seed)
    model = PlanNetwork()
    batches = math.ceil(len(walks.scene) / BATCH)
    optimizer = torch.optim.Adam(model.parameters())
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimizer, RATE, total_steps=epochs * batches)
    shares, span = torch.from_numpy(walks.shares).float(), torch.from_numpy(walks.high - walks.low).float()
    speeds = torch.from_numpy(walks.velocities[..., [0, 2]]).float()
    for _ in range(epochs):
        for chosen in torch.randperm(len(shares)).split(BATCH):
            plans, place, speed = _mirror_or_reverse(_plans(walks, chosen.numpy()), shares[chosen], speeds[chosen])
            found, velocity = model(plans)
            off = ((found - place) * span[chosen, None]).square().sum(dim=-1)
            faster = (velocity - speed).square().sum(dim=-1)
            # Distances, and not their squares: a few walks that cannot be found do not decide.
            loss = (off + 1e-3).sqrt().mean() + SPEED_WEIGHT * (faster + 1e-2).sqrt().mean()
            optimizer.zero_grad()
            loss.backward()
            optimizer.step()
            schedule.step()
    return model


def _plans(walks: Walks, chosen: Ints) -> torch.Tensor:
    """(n, plan, F, depth, column) plans of some walks."""
    return torch.from_numpy(walks.plans[chosen]).transpose(1, 2)


def _mirror_or_reverse(
    plans: torch.Tensor, place: torch.Tensor, speed: torch.Tensor
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Plans (n, plan, F, depth, column), places and velocities (n, F, 2), maybe mirrored, and maybe from the last
    frame to the first."""
    mirrored, backward = torch.rand(2).lt(0.5).tolist()
    if mirrored:
        sign = torch.tensor([-1.0, 1.0])
        plans, place, speed = plans.flip(-1), place * sign + torch.tensor([1.0, 0.0]), speed * sign
    if backward:
        plans, place, speed = plans.flip(2), place.flip(1), -speed.flip(1)
    return plans, place, speed
