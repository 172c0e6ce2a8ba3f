"""README's training example, run as printed there: how far off are pillar and box, in which rooms, and at what σ?

    python examples/readme_training.py docs/readme_training.png

builds 2048 rooms of configs/quickstart.yaml, runs the lines of README on them, prints how far the places that are
found lie from the objects in the rooms kept back, by their detectability σ, and draws this with floor plans of some
rooms. `--scenes 512` is what README's own command builds; `--dataset FOLDER` keeps the rooms, or goes on with those
that are there; `--seeds 3` trains three times, from other first weights and in another order of the rooms, prints all
three and draws the first.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import re
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import torch
from evidence_training import Array
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.gridspec import SubplotSpec

import datagen as dg
from datagen.report.style import captioned, house_style, save_png

ROOT = Path(__file__).resolve().parents[1]
OBJECTS = ("pillar", "box")
COLORS = ("#E69F00", "#009E73")
TRUTH, MEAN, MAP = "#222222", "#9A9A9A", "#0072B2"
NEAR_M = 0.25
BOUNDS = (0.0, 5.0, 15.0, 50.0, np.inf)
"""Of the classes of detectability in which distances are told."""
QUANTILES = (0.1, 0.3, 0.5, 0.7, 0.9)
"""Of the rooms kept back, in the order of their distance, those that are drawn."""


@dataclass(frozen=True)
class Learnt:
    """What README's lines find in N rooms kept back; objects are those of `OBJECTS`.

    epochs : (epoch, object) median distance from the middle of an object, metres, as printed; always : (object,) that
        of the mean place.
    places, truth : (N, object, 2) depth and right in the label frame, metres.
    mean : (object, 2) mean place.
    maps : (N, object, depth, column) chance of each place of the floor plan.
    low, high : (N, 2) corners of the floor plan, depth and right, metres.
    sigma : (N, object) detectability of the objects in the data.
    fitted : (object,) median distance in the rooms trained on, of which there are `trained_on`.
    """

    epochs: Array
    always: Array
    places: Array
    truth: Array
    mean: Array
    maps: Array
    low: Array
    high: Array
    sigma: Array
    fitted: Array
    trained_on: int

    @property
    def distance(self) -> Array:
        """(N, object) of the place that is found from the middle of the object, metres."""
        return np.asarray(np.linalg.norm(self.places - self.truth, axis=-1))


def example(path: Path, epochs: int) -> str:
    """The training example of README, for another dataset and another number of epochs."""
    blocks = re.findall(r"^```python\n(.*?)^```", (ROOT / "README.md").read_text(encoding="utf-8"), re.M | re.S)
    code = next((block for block in blocks if "DataLoader" in block), "")
    for old, new in (('"out/quickstart.zarr"', repr(str(path))), ("range(16)", f"range({epochs})")):
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
    always, *medians = ([float(word) for word in re.findall(r"(\S+) m\b", line)] for line in said(printed))
    unseen, loader, test = names["unseen"], names["loader"], names["test"]
    with torch.no_grad():
        fitted = torch.cat([names["distance"](names["found"](batch), batch) for batch in loader]).median(dim=0).values
        places = names["found"](unseen).double().numpy()
        maps = names["model"](unseen["volume"].transpose(1, 2)).double().numpy()
    low, high = unseen["volume_bounds"][:, :, [2, 0]].double().numpy().swapaxes(0, 1)
    return Learnt(
        np.array(medians), np.array(always), places, unseen["object_box_center"][..., [2, 0]].double().numpy(),
        names["mean"].double().numpy(), maps.reshape(*maps.shape[:2], 32, 32), low, high,
        np.stack([test.parameters(f"evidence.{name}.significance").astype(np.float64) for name in OBJECTS], axis=1),
        fitted.double().numpy(), len(names["train"]),
    )  # fmt: skip


def said(printed: io.StringIO) -> list[str]:
    """The lines that were printed."""
    return printed.getvalue().splitlines()


def table(found: Learnt) -> str:
    """Distances in the rooms kept back, a line an object, and their median by detectability."""
    classes = [f"{low:g} to {high:g} σ" for low, high in pairwise(BOUNDS[:-1])] + [f"over {BOUNDS[-2]:g} σ"]
    lines = [
        f"| distance (m), {len(found.truth)} rooms kept back | median | 90 % | within 25 cm | always the mean | "
        "in rooms trained on | " + " | ".join(f"median, {name} (objects)" for name in classes) + " |",
        "|---|" + "---:|" * (5 + len(classes)),
    ]
    off = found.distance
    for k, name in enumerate(OBJECTS):
        cells = [f"{np.median(off[:, k]):.2f}", f"{np.quantile(off[:, k], 0.9):.2f}"]
        cells += [f"{np.mean(off[:, k] <= NEAR_M):.0%}", f"{found.always[k]:.2f}", f"{found.fitted[k]:.2f}"]
        for low, high in pairwise(BOUNDS):
            some = (found.sigma[:, k] >= low) & (found.sigma[:, k] < high)
            cells.append(f"{np.median(off[some, k]):.2f} ({some.sum()})" if some.any() else "")
        lines.append(f"| {name} | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def draw(found: Learnt, out: Path) -> None:
    """Floor plans of a few rooms; distances by epoch, how many are within which, and by detectability."""
    each = found.distance.mean(axis=1)
    order = np.argsort(each)
    chosen = [int(order[round(level * (len(order) - 1))]) for level in QUANTILES]
    text = (
        f"README's example on {found.trained_on} rooms of quickstart. Above: the hidden part of five rooms that no "
        "training saw, from above, at the 10th, 30th, 50th, 70th and 90th percentile of the mean distance of the two "
        "objects, which stands above each; blue is where the network takes one of them to be. Only a part of the "
        "relay wall beside what is drawn is measured. Below: distances from the middle of the object's box, all "
        f"{len(each)} rooms kept back."
    )
    with house_style():
        figure, grid = captioned([2.1, 2.4], text, "Where do pillar and box stand? README's example", 3)
        _draw_rooms(figure, grid[0, :], found, chosen, each)
        by_epoch, by_share, by_sigma = (figure.add_subplot(grid[1, k]) for k in range(3))
        for k, color in enumerate(COLORS):
            by_epoch.axhline(found.always[k], color=MEAN, linewidth=1)
            by_epoch.plot(range(1, len(found.epochs) + 1), found.epochs[:, k], color=color)
            _draw_shares(by_share, np.linalg.norm(found.mean[k] - found.truth[:, k], axis=1), MEAN)
            _draw_shares(by_share, found.distance[:, k], color)
            by_sigma.plot(found.sigma[:, k], found.distance[:, k], ".", color=color, markersize=4)
        by_epoch.set(xlabel="epoch", ylabel="distance (m), median", ylim=(0, None))
        by_epoch.xaxis.get_major_locator().set_params(integer=True)
        by_share.set(xlabel="distance (m)", ylabel="rooms within it (%)", xlim=(0, 2), ylim=(0, 100))
        by_sigma.set(xlabel="σ of the object", ylabel="distance (m)", xscale="log", ylim=(0, None))
        by_sigma.xaxis.set_major_formatter("{x:g}")
        save_png(figure, out)


def _draw_shares(panel: Axes, off: Array, color: str) -> None:
    panel.plot(np.sort(off), 100 * (np.arange(len(off)) + 1) / len(off), color=color)


def _draw_rooms(figure: Figure, place: SubplotSpec, found: Learnt, chosen: Sequence[int], each: Array) -> None:
    above = figure.add_subfigure(place)
    # All rooms on the same scale, with the relay wall at the same height.
    size = (found.high - found.low)[chosen].max(axis=0)
    for panel, number in zip(above.subplots(1, len(chosen)), chosen, strict=True):
        (near, left), (far, right) = found.low[number], found.high[number]
        # What the network holds for likely of either object, each on its own scale.
        likely = (found.maps[number] / found.maps[number].max(axis=(1, 2), keepdims=True)).max(axis=0)
        panel.imshow(likely, extent=(left, right, near, far), origin="lower", cmap="Blues", vmax=1.6)
        panel.plot([left, right], [near, near], color="#5E8DC1", linewidth=3, label="relay wall")
        for k, (name, color) in enumerate(zip(OBJECTS, COLORS, strict=True)):
            (there, at), (depth, across) = found.truth[number, k], found.places[number, k]
            panel.plot([at, across], [there, depth], color=color, linewidth=1)
            panel.plot(at, there, "s", color=color, markersize=8, label=name)
            panel.plot(across, depth, "X", color=color, markeredgecolor=TRUTH, markersize=8, label=f"{name}, found")
        middle = (left + right) / 2
        panel.set(xticks=[], yticks=[], xlim=(middle - size[1] / 2, middle + size[1] / 2))
        panel.set_ylim(near - 0.05, near + size[0])
        panel.spines[:].set_visible(False)
        panel.set_title(f"{each[number]:.2f} m", loc="center", fontsize=9)
    panel.plot([], [], color=MEAN, label="always their mean")
    handles, labels = panel.get_legend_handles_labels()
    above.legend(handles, labels, loc="outside lower center", ncols=6, columnspacing=1.5)


def main() -> None:
    """Print the distances and draw the picture."""
    arguments = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    arguments.add_argument("out", type=Path)
    arguments.add_argument("--dataset", type=Path)
    for name, default in (("scenes", 2048), ("epochs", 16), ("workers", 2), ("seeds", 1)):
        arguments.add_argument(f"--{name}", type=int, default=default)
    asked = arguments.parse_args()
    torch.set_num_threads(1)
    config = dg.load_config(ROOT / "configs/quickstart.yaml")
    with tempfile.TemporaryDirectory() as folder:
        path = asked.dataset or Path(folder, "quickstart.zarr")
        dg.build(config, path, asked.workers, scenes=asked.scenes)
        for seed in range(asked.seeds):
            began = time.process_time()
            found = learnt(path, asked.epochs, seed)
            print(f"seed {seed}: {found.trained_on} rooms, {time.process_time() - began:.0f} s of one core")
            print(table(found), flush=True)
            if seed == 0:
                draw(found, asked.out)


if __name__ == "__main__":
    main()
