"""Datasets for torch. Only this package, `building/on_the_fly.py` and `baselines` import torch.

data = TransientDataset("out/rooms.zarr", fields=("histogram", "depth"), redraw_noise=True)
loader = DataLoader(data, batch_size=16, sampler=EpochSampler(data, seed=0), num_workers=2)
for epoch in range(10):  # each epoch in another order, and with other noise
    for batch in loader:
        batch["histogram"]          # (16, laser, pixel, bin) float32
"""

from datagen.loader.batch import collate
from datagen.loader.dataset import TransientDataset
from datagen.loader.events import dense
from datagen.loader.sampler import EpochSampler

__all__ = ["EpochSampler", "TransientDataset", "collate", "dense"]
