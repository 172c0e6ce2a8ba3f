"""How well is the depth of hidden rooms learnt, as an image? And what does its error say?

    python examples/depth_training.py docs/depth_training.png

builds 2048 rooms of configs/quickstart.yaml, trains five convolutions on the depth of 80 % of them, prints the root
mean square error in the rooms kept back after each epoch, and draws it with predictions beside truth. Beside it is
what truth itself has if it is shifted by a few columns: edges are most of this error. `--dataset FOLDER` keeps the
rooms, or goes on with those that are there; `--seed` is that of the first weights and of the order of the rooms.
"""

from __future__ import annotations

import argparse
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from evidence_training import Array, framed
from torch import nn
from torch.utils.data import DataLoader

import datagen as dg
from datagen.report.style import captioned, house_style, save_png

ROOT = Path(__file__).resolve().parents[1]
BATCH = 8
WIDTH = 48
RATE = 2e-3
"""Rooms a batch, channels of a layer, and the learning rate."""
SHIFTS = (1, 4)
"""Columns by which truth is shifted, to see what that does to the error."""
QUANTILES = (0.1, 0.3, 0.5, 0.7, 0.9)
"""Of the scenes kept back, in the order of their error, those that are drawn."""


@dataclass(frozen=True)
class Learnt:
    """errors : (epoch,) root mean square error of depth in scenes kept back, m; always : that of the mean depth, one
    number for all; blind : that of the mean depth image.
    fitted : the error in the scenes trained on, at the end.
    truth, predicted : (scene, row, column) of scenes kept back, m; mean : (row, column) of scenes trained on.
    trained_on : number of scenes.
    """

    errors: Array
    always: float
    blind: float
    fitted: float
    truth: Array
    predicted: Array
    mean: Array
    trained_on: int


class DepthNetwork(nn.Module):
    """A backprojection (depth, row, column) → depth (2 rows, 2 columns), metres; slices are the channels."""

    def __init__(self, mean: float) -> None:
        super().__init__()
        layers: list[nn.Module] = []
        for step in (1, 2, 4, 8, 1):
            layers += [nn.LazyConv2d(WIDTH, 3, padding=step, dilation=step), nn.GroupNorm(8, WIDTH), nn.ReLU()]
        self.body = nn.Sequential(*layers, nn.LazyConv2d(4, 1), nn.PixelShuffle(2), nn.Flatten(1, 2))
        self.mean = mean

    def forward(self, volume: torch.Tensor) -> torch.Tensor:
        """(N, 64, 64) depth, metres."""
        found: torch.Tensor = self.mean + self.body(volume)
        return found


def learnt(path: Path, epochs: int, seed: int = 0) -> Learnt:
    """Train on the split train of a dataset; prints the error in the split test after each epoch."""
    torch.manual_seed(seed)
    train, test = (
        dg.TransientDataset(path, split=split, representation="volume", redraw_noise=split == "train")
        for split in ("train", "test")
    )
    loader = DataLoader(train, batch_size=BATCH, shuffle=True, collate_fn=dg.collate)
    unseen = next(iter(DataLoader(test, batch_size=len(test), collate_fn=dg.collate)))
    depth, volume = unseen["depth"], unseen["volume"]
    model = DepthNetwork(train.stats["depth"]["mean"])
    model(volume[:1])
    optimizer = torch.optim.Adam(model.parameters(), lr=RATE)
    errors = []
    for epoch in range(epochs):
        for batch in loader:
            loss = (model(batch["volume"]) - batch["depth"]).square().mean()
            optimizer.zero_grad()
            loss.backward()  # type: ignore[no-untyped-call]
            optimizer.step()
        with torch.no_grad():
            predicted = model(volume)
        errors.append(float((predicted - depth).square().mean().sqrt()))
        print(f"epoch {epoch + 1:3}  {errors[-1]:.3f} m", flush=True)
    with torch.no_grad():
        off = torch.cat([model(batch["volume"]) - batch["depth"] for batch in loader])
    labels = dg.TransientDataset(path, ("depth",), split="train")
    image = np.mean([labels[k]["depth"].numpy() for k in range(len(labels))], axis=0)
    truth = depth.double().numpy()
    return Learnt(
        np.array(errors), rms(model.mean - truth), rms(image - truth), float(off.square().mean().sqrt()), truth,
        predicted.double().numpy(), np.asarray(image), len(train),
    )  # fmt: skip


def rms(off: Array) -> float:
    """Root of the mean square."""
    return float(np.sqrt(np.mean(off**2)))


def shifted(images: Array, columns: int) -> Array:
    """(…, row, column) images, moved to the right; the first column is repeated."""
    return np.concatenate([np.repeat(images[..., :1], columns, axis=-1), images[..., :-columns]], axis=-1)


def draw(found: Learnt, out: Path) -> None:
    """The curve, and predictions beside truth."""
    each = np.sqrt(((found.predicted - found.truth) ** 2).mean(axis=(1, 2)))
    order = np.argsort(each)
    chosen = [int(order[round(level * (len(order) - 1))]) for level in QUANTILES]
    text = (
        f"Five convolutions trained on {found.trained_on} rooms of quickstart. Left: root mean square error of depth "
        f"over all pixels of {len(each)} rooms kept back, after each epoch. Right: five of them, at 10th to 90th "
        "percentile of their error, which stands above; the mean depth of the rooms trained on is what can be said "
        "without a measurement. Truth shifted by one of 64 columns has "
        f"{rms(shifted(found.truth, 1) - found.truth):.2f} m."
    )
    with house_style():
        figure, grid = captioned([2.8], text, "Depth of hidden rooms", 2, [1, 1.7])
        axes = figure.add_subplot(grid[0, 0])
        axes.axhline(found.blind, color="#9A9A9A", label="mean depth image")
        axes.plot(range(1, len(found.errors) + 1), found.errors, color="#0072B2", label="network")
        axes.set(xlabel="epoch", ylabel="error of depth (m)", ylim=(0, None))
        axes.xaxis.get_major_locator().set_params(integer=True)
        axes.legend(loc="lower left")
        right = figure.add_subfigure(grid[0, 1])
        rows = {
            "truth": found.truth,
            "predicted": found.predicted,
            "mean": np.broadcast_to(found.mean, found.truth.shape),
        }
        for line, (name, images) in enumerate(rows.items()):
            for column, scene in enumerate(chosen):
                panel = right.add_subplot(len(rows), len(chosen), line * len(chosen) + column + 1)
                panel.imshow(images[scene], cmap="viridis_r", vmin=0, vmax=float(found.truth[chosen].max()))
                framed(panel)
                if line == 0:
                    panel.set_title(f"{each[scene]:.2f} m")
                if column == 0:
                    panel.set_ylabel(name)
        save_png(figure, out)


def main() -> None:
    """Print the errors and draw the picture."""
    arguments = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    arguments.add_argument("out", type=Path)
    arguments.add_argument("--dataset", type=Path)
    for name, default in (("scenes", 2048), ("epochs", 8), ("workers", 2), ("seed", 0)):
        arguments.add_argument(f"--{name}", type=int, default=default)
    asked = arguments.parse_args()
    torch.set_num_threads(1)
    config = dg.load_config(ROOT / "configs/quickstart.yaml")
    with tempfile.TemporaryDirectory() as folder:
        path = asked.dataset or Path(folder, "quickstart.zarr")
        dg.build(config, path, asked.workers, scenes=asked.scenes)
        found = learnt(path, asked.epochs, asked.seed)
    print(f"in rooms trained on {found.fitted:.3f} m")
    print(f"always the mean depth {found.always:.3f} m")
    print(f"mean depth image {found.blind:.3f} m")
    for columns in SHIFTS:
        print(f"truth shifted by {columns} of 64 columns {rms(shifted(found.truth, columns) - found.truth):.3f} m")
    draw(found, asked.out)


if __name__ == "__main__":
    main()
