"""Does it matter to train with weights by evidence? A small network learns depth, with and without them.

    python examples/evidence_training.py docs/evidence_training.png

builds 2 100 scenes of a box before a wall, whose albedo is drawn over three and a half decades, so that a third of
the boxes have no evidence to speak of; trains a network with one hidden layer of 64 on 60 % of them; keeps of each
training the epoch that is best on the split val, where there is evidence; prints the error on the split test, which
chose nothing, by the significance of the box; and draws it with predictions beside truth and evidence.
"""

from __future__ import annotations

import argparse
import copy
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
import torch
from matplotlib.axes import Axes
from matplotlib.figure import SubFigure
from numpy.typing import NDArray
from torch.utils.data import DataLoader

import datagen as dg
from datagen.baselines.network import Normalized
from datagen.config import config_from_mapping
from datagen.report.style import captioned, house_style, save_png

Array = NDArray[np.float64]

SIDE = 16
LEAST = 3.0
BOUNDS = (0.0, 1.0, 3.0, 10.0, 30.0, np.inf)
"""Of the classes of significance in which errors are told."""
SHOWN = (0.3, 2.0, 7.0, 25.0, 150.0)
"""Of the scenes kept back those whose significance is nearest to these are drawn."""
DRAWS = 8
RECIPES = {
    "every box alike": torch.ones_like,
    "weighted by σ²/(9 + σ²)": lambda sigma: sigma**2 / (LEAST**2 + sigma**2),
    "only boxes over 3 σ": lambda sigma: (sigma >= LEAST).float(),
}
"""What a label counts for, by the significance of its object."""
BLIND = "the mean depth, whatever is measured"
COLORS = dict(zip((BLIND, *RECIPES), ("#9A9A9A", "#222222", "#0072B2", "#D55E00"), strict=True))


def configuration(scenes: int) -> dg.DatasetConfig:
    """A box at a place of its own in front of a wall, daylight, and 2 ms at each of 8 × 8 points."""
    place = {"relay_distance_m": 3.0, "wall_width_m": 1.6, "height_m": 1.8, "device_height_m": 1.0}
    screen = {"screen_to_wall_m": 1.6, "screen_offset_m": 0.2, "space_width_m": 1.6}
    box = {
        "kind": "box", "width_m": {"uniform": [0.5, 0.9]}, "depth_m": {"uniform": [0.2, 0.4]},
        "height_m": {"uniform": [0.5, 0.9]}, "elevation_m": {"uniform": [0.1, 0.8]},
        "rotation_deg": {"uniform": [-20, 20]}, "albedo": {"log_uniform": [0.0003, 0.9]},
    }  # fmt: skip
    return config_from_mapping(
        {
            "name": "boxes_by_evidence",
            "seed": 3,
            "scenes": scenes,
            "scene": {
                "layout": {"kind": "isolated_wall", **place, **screen},
                "contents": [box],
                "materials": {"relay_wall": {"albedo": 0.9}, "screen": {"material": ["matt_black_paint"]}},
            },
            "capture": {"scan": {"rows": 8, "columns": 8}, "time": {"bins": 128, "bin_width_ps": 150}},
            "transport": {"target": 0.05},
            "detector": {"cycles": 60000, "photons_per_pulse": 1.0e8, "ambient_rate_hz": 1.0e6},
            "labels": {"rows": SIDE, "columns": SIDE},
            "splits": {"train": 0.6, "val": 0.2, "test": 0.2},
            "store": {"fields": ["histogram", "transient", "depth", "evidence", "objects"]},
        }
    )


@dataclass(frozen=True)
class Scenes:
    """histograms : (draw, scene, laser, 1, bin) counts. depth, evidence : (scene, row, column). sigma : (scene,)."""

    histograms: torch.Tensor
    depth: torch.Tensor
    evidence: torch.Tensor
    sigma: torch.Tensor

    @property
    def box(self) -> torch.Tensor:
        """(scene, row, column): 1 on the pixels that show the box."""
        return (self.depth > 0).float()


def read(path: Path, split: str, draws: int) -> Scenes:
    """Scenes of a split, with so many draws of their noise."""
    fields = ("histogram", "depth", "evidence", "object_significance")
    data = dg.TransientDataset(path, fields, split=split, redraw_noise=True)
    drawn = [next(iter(DataLoader(data, batch_size=len(data), collate_fn=dg.collate))) for _ in range(draws)]
    first = drawn[0]
    histograms = torch.stack([batch["histogram"] for batch in drawn])
    return Scenes(histograms, first["depth"], first["evidence"], first["object_significance"][:, 0])


class Predictor:
    """One hidden layer of 64, for log(1 + counts) less their mean over the training scenes; depth in metres."""

    def __init__(self, train: Scenes, seed: int) -> None:
        self.model, self.depth = Normalized(train.histograms[0], SIDE * SIDE, seed), mean_depth(train)

    def __call__(self, counts: torch.Tensor) -> torch.Tensor:
        """(scene, row, column) of histograms (scene, laser, 1, bin)."""
        return self.depth + self.model(counts).unflatten(1, (SIDE, SIDE))


def mean_depth(train: Scenes) -> float:
    """Over all pixels that show a box."""
    return float(train.depth.sum() / train.box.sum())


def trained(recipe: str, train: Scenes, val: Scenes, seed: int, epochs: int) -> Predictor:
    """Each epoch sees another draw of the noise; the loss is the weighted mean square error on pixels of the box. Of
    all epochs that is kept whose error is least in scenes of `val` with evidence, for every recipe alike."""
    predictor = Predictor(train, seed)
    weight = RECIPES[recipe](train.sigma)[:, None, None] * train.box
    weight /= weight.mean()
    optimizer = torch.optim.Adam(predictor.model.parameters(), lr=3e-3)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, epochs)
    least, kept = np.inf, predictor.model.state_dict()
    for epoch in range(epochs):
        counts = train.histograms[epoch % len(train.histograms)]
        for chosen in torch.randperm(len(weight)).split(32):
            loss = (weight[chosen] * (predictor(counts[chosen]) - train.depth[chosen]) ** 2).mean()
            optimizer.zero_grad()
            loss.backward()
            optimizer.step()
        schedule.step()
        error = square_error(found_in(predictor, val), val)[val.sigma.numpy() >= LEAST].mean()
        if error < least:
            least, kept = error, copy.deepcopy(predictor.model.state_dict())
    predictor.model.load_state_dict(kept)
    return predictor


def found_in(predictor: Predictor, scenes: Scenes) -> torch.Tensor:
    """(scene, row, column) depth from the first draw of counts."""
    with torch.no_grad():
        return predictor(scenes.histograms[0])


def square_error(found: torch.Tensor, scenes: Scenes) -> Array:
    """(scene,) mean square error of depth in m² on the pixels of the box."""
    square = ((found - scenes.depth) ** 2 * scenes.box).sum((1, 2)) / scenes.box.sum((1, 2)).clamp(min=1)
    return np.asarray(square.double().numpy())


def compare(scenes: int, epochs: int, seeds: int) -> tuple[dict[str, Array], dict[str, Array], Scenes]:
    """Recipe → (seed, scene) square errors on scenes of the split test; recipe → predictions of the first seed."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "boxes.zarr")
        dg.build(configuration(scenes), path, progress=False)
        train, val, kept = read(path, "train", DRAWS), read(path, "val", 1), read(path, "test", 1)
    found = {BLIND: square_error(torch.full_like(kept.depth, mean_depth(train)), kept)[None]}
    pictures = {}
    for recipe in RECIPES:
        each = [found_in(trained(recipe, train, val, seed, epochs), kept) for seed in range(seeds)]
        found[recipe] = np.stack([square_error(of, kept) for of in each])
        pictures[recipe] = each[0].numpy()
    return found, pictures, kept


def by_class(square: Array, sigma: Array) -> tuple[Array, Array]:
    """(class,) root mean square over scenes and seeds, and its standard deviation between seeds, m."""
    here = [(sigma >= low) & (sigma < high) for low, high in pairwise(BOUNDS)]
    each = np.array([[np.sqrt(of[some].mean()) if some.any() else np.nan for some in here] for of in square])
    return np.sqrt((each**2).mean(axis=0)), each.std(axis=0, ddof=min(len(each) - 1, 1))


def table(found: Mapping[str, Array], sigma: Array) -> str:
    """Recipe → error on scenes kept back, by the significance of their box."""
    names = [f"{low:g} to {high:g} σ" for low, high in pairwise(BOUNDS[:-1])]
    counts = np.histogram(sigma, BOUNDS)[0]
    lines = ["| error of depth (mm) | " + " | ".join([*names, f"over {BOUNDS[-2]:g} σ"]) + " |"]
    lines += ["|---|" + "---:|" * len(counts), "| scenes kept back | " + " | ".join(map(str, counts)) + " |"]
    for recipe, square in found.items():
        cells = (
            f"{1e3 * mean:.0f}{f' ± {1e3 * off:.0f}' if len(square) > 1 else ''}"
            for mean, off in zip(*by_class(square, sigma), strict=True)
        )
        lines.append(f"| {recipe} | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def draw(found: Mapping[str, Array], pictures: Mapping[str, Array], kept: Scenes, out: Path) -> None:
    """Error against significance, and for a few scenes predictions beside truth and evidence."""
    sigma = kept.sigma.double().numpy()
    text = (
        "Above: root mean square error of depth on the pixels of the box, in scenes of the split test, by the "
        "significance of the box (bars: between seeds). Below: five of these scenes, from no evidence to much; "
        "truth, two networks (shown where the box is; they were trained there alone), and the expected detections "
        "from each pixel (sides that the view does not see are not in it)."
    )
    with house_style():
        figure, grid = captioned([2.4, 5.2], text, "Depth of a hidden box, learnt with and without its evidence")
        axes = figure.add_subplot(grid[0, 0])
        for recipe, square in found.items():
            mean, off = by_class(square, sigma)
            axes.errorbar(range(len(mean)), 1e3 * mean, 1e3 * off, label=recipe, color=COLORS[recipe], capsize=3)
        names = ["< 1", "1 to 3", "3 to 10", "10 to 30", "> 30"]
        axes.set_xticks(range(len(names)), names)
        axes.set(xlabel="significance of the box (σ)", ylabel="error of depth (mm)", ylim=(0, None))
        axes.legend(loc="lower left")
        _draw_scenes(figure.add_subfigure(grid[1, 0]), pictures, kept, sigma)
        save_png(figure, out)


def _draw_scenes(below: SubFigure, pictures: Mapping[str, Array], kept: Scenes, sigma: Array) -> None:
    """Truth, predictions and evidence of a few scenes, a column a scene."""
    chosen = [int(np.abs(np.log(sigma.clip(1e-3) / level)).argmin()) for level in SHOWN]
    first, second = list(RECIPES)[:2]
    lines = {
        "truth": kept.depth.numpy(),
        "every\nbox alike": pictures[first],
        "weighted by\nσ²/(9 + σ²)": pictures[second],
        "evidence,\nits sum below": np.log10(kept.evidence.numpy().clip(1e-2)),
    }
    depths = {"cmap": "viridis_r", "vmin": 0, "vmax": float(kept.depth.max())}
    panels = below.subplots(len(lines), len(chosen))
    for row, (name, images) in zip(panels, lines.items(), strict=True):
        style = {"cmap": "magma", "vmin": -2, "vmax": 2} if name.startswith("evidence") else depths
        for panel, scene in zip(row, chosen, strict=True):
            shown = panel.imshow(np.where(kept.box[scene].numpy() > 0, images[scene], np.nan), **style)
            framed(panel)
        row[0].set_ylabel(name)
        if name.startswith("evidence"):
            scale = below.colorbar(shown, ax=list(row), label="detections")
            scale.set_ticks([-2, 0, 2], labels=["0.01", "1", "100"])
    below.colorbar(panels[0, 0].images[0], ax=panels[:-1].ravel().tolist(), label="depth (m)")
    for panel, scene in zip(panels[0], chosen, strict=True):
        panel.set_title(f"{_short(sigma[scene])} σ", loc="center")
    for panel, scene in zip(panels[-1], chosen, strict=True):
        panel.set_xlabel(_short(float(kept.evidence[scene].sum())))


def _short(value: float) -> str:
    return f"{value:,.0f}" if value >= 10 else f"{value:.2g}"


def framed(panel: Axes) -> None:
    """A picture has a frame and no ticks."""
    panel.set(xticks=[], yticks=[])
    panel.spines[["top", "right"]].set_visible(True)


def main() -> None:
    """Print the table and draw the picture."""
    arguments = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    arguments.add_argument("out", type=Path)
    for name, default in (("scenes", 2100), ("epochs", 30), ("seeds", 4)):
        arguments.add_argument(f"--{name}", type=int, default=default)
    asked = arguments.parse_args()
    torch.set_num_threads(1)
    found, pictures, kept = compare(asked.scenes, asked.epochs, asked.seeds)
    print(table(found, kept.sigma.double().numpy()))
    draw(found, pictures, kept, asked.out)


if __name__ == "__main__":
    main()
