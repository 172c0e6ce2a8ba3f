"""README's training example, run as printed there with more scenes and epochs: does it learn?

    python examples/readme_training.py docs/readme_training.png

builds 2048 scenes of configs/quickstart.yaml, runs the lines of README on them for 8 epochs, prints the error of
depth on the scenes kept back after each, and draws it with predictions beside truth. `--dataset FOLDER` keeps the
scenes, or goes on with those that are there; `--seed` is that of the network's first weights and of the rooms' order.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import re
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from evidence_training import Array, framed

import datagen as dg
from datagen.report.style import captioned, house_style, save_png

ROOT = Path(__file__).resolve().parents[1]
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


def example(path: Path, epochs: int) -> str:
    """The training example of README, for another dataset and another number of epochs."""
    blocks = re.findall(r"^```python\n(.*?)^```", (ROOT / "README.md").read_text(encoding="utf-8"), re.M | re.S)
    code = next((block for block in blocks if "DataLoader" in block), "")
    for old, new in (('"out/quickstart.zarr"', repr(str(path))), ("range(8)", f"range({epochs})")):
        assert code.count(old) == 1, f"README's example has no {old} any more"
        code = code.replace(old, new)
    return code


def learnt(path: Path, epochs: int, seed: int = 0) -> Learnt:
    """Run the example on a dataset."""
    names: dict[str, Any] = {}
    printed = io.StringIO()
    torch.manual_seed(seed)
    with contextlib.redirect_stdout(printed):
        exec(compile(example(path, epochs), "README.md", "exec"), names)
    always, *errors = (float(line.split()[-2]) for line in printed.getvalue().splitlines())
    train = dg.TransientDataset(path, ("depth",), split="train")
    mean = np.mean([item["depth"].numpy() for item in train], axis=0)  # type: ignore[attr-defined]
    truth = names["unseen"]["depth"].double().numpy()
    with torch.no_grad():
        off = [names["mean"] + names["model"](batch["volume"]) - batch["depth"] for batch in names["loader"]]
        predicted = (names["mean"] + names["model"](names["unseen"]["volume"])).double().numpy()
    blind = float(np.sqrt(np.mean((mean - truth) ** 2)))
    fitted = float(torch.cat(off).square().mean().sqrt())
    return Learnt(np.array(errors), always, blind, fitted, truth, predicted, np.asarray(mean), len(train))


def draw(found: Learnt, out: Path) -> None:
    """The curve, and predictions beside truth."""
    each = np.sqrt(((found.predicted - found.truth) ** 2).mean(axis=(1, 2)))
    order = np.argsort(each)
    chosen = [int(order[round(level * (len(order) - 1))]) for level in QUANTILES]
    text = (
        f"README's example on {found.trained_on} rooms of quickstart. Left: root mean square error of depth over all "
        f"pixels of {len(each)} rooms kept back, after each epoch. Right: five of these, at the 10th to 90th "
        "percentile of their error, which stands above; the mean depth of the rooms trained on is what can be said "
        "without a measurement."
    )
    with house_style():
        figure, grid = captioned(12, [4.2], text, "Depth of hidden rooms, learnt by README's example", 2, [1, 1.5])
        axes = figure.add_subplot(grid[0, 0])
        axes.axhline(found.blind, color="#9A9A9A", label="mean depth of the rooms trained on")
        axes.plot(range(1, len(found.errors) + 1), found.errors, color="#0072B2", label="README's network")
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
    for epoch, error in enumerate(found.errors, 1):
        print(f"epoch {epoch:3}  {error:.3f} m")
    print(f"in rooms trained on {found.fitted:.3f} m")
    print(f"always the mean depth {found.always:.3f} m")
    print(f"mean depth image {found.blind:.3f} m")
    draw(found, asked.out)


if __name__ == "__main__":
    main()
