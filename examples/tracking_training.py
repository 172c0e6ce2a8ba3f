"""Can somebody be tracked around the corner? A network learns it on the suite tracking-1.

    python examples/tracking_training.py docs/tracking_training.png --dataset out/tracking.zarr

builds the suite (unless the folder is there), trains the baseline `network` on its split train, and prints how far it
is off in each frame of the split test, which has other rooms. Beside it stand four others: always the mean place of
the walkers trained on; the mean of those on the same side of the opening, which somebody would have to tell; the same
network for single frames, which sees neither what changes nor how; and a Kalman filter, which learns nothing but one
number. It draws ways of walkers in a few rooms, and the errors of all but the second.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Mapping
from itertools import pairwise
from pathlib import Path

import numpy as np
import torch
from evidence_training import Array
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.gridspec import SubplotSpec
from numpy.typing import NDArray

import datagen as dg
from datagen.baselines.plan_network import EPOCHS, learnt_ways
from datagen.baselines.tracking import kalman_ways
from datagen.baselines.walks import Walks, read_walks
from datagen.labels.frame import ViewFrame
from datagen.records import Rectangle
from datagen.report.style import captioned, house_style, save_png
from datagen.suites.catalogue import find_suite

SUITE = "tracking-1"
NEAR_M = 0.25
BOUNDS = (0.0, 5.0, 10.0, 20.0, np.inf)
"""Of the classes of significance of a change in which errors are told."""
MEAN, SIDE = "always the mean", "mean of its side, told"
SINGLE, KALMAN, NETWORK = "network, single frames", "Kalman filter", "network"
COLORS = {MEAN: "#9A9A9A", SINGLE: "#CC79A7", KALMAN: "#E69F00", NETWORK: "#0072B2"}
TRUTH = "#222222"
QUANTILES = (0.1, 0.5, 0.75, 0.9)
"""Of the sequences kept back, in the order of the network's error, those that are drawn."""


def ways(path: Path, test: Walks, seed: int, epochs: int) -> dict[str, Array]:
    """Method → (N, F, 3) places that it finds in the split test; prints what each takes."""
    train = read_walks(path, "train")
    found = {MEAN: np.broadcast_to(train.centers.mean(axis=(0, 1)), test.centers.shape)}
    found[SIDE] = mean_of_side(train, test)
    singles = [read_walks(path, split, minus="scan").apart for split in ("train", "test")]
    for name, find in (
        (SINGLE, lambda: learnt_ways(singles[0], singles[1], seed, epochs)),
        (KALMAN, lambda: kalman_ways(train, test)),
        (NETWORK, lambda: learnt_ways(train, test, seed, epochs)),
    ):
        began = time.process_time()
        places, _ = find()
        found[name] = train.at_mean_height(places.reshape(*test.centers.shape[:2], 2))
        print(f"{name}: {time.process_time() - began:.0f} s of one core")
    return found


def mean_of_side(train: Walks, test: Walks) -> Array:
    """(N, F, 3) the mean place of the walkers of training to the left, or to the right, of the opening, whichever is
    the side of the walker."""
    left = [np.median(of.centers[..., 0], axis=1) < 0 for of in (train, test)]
    means = [train.centers[left[0] == side].mean(axis=(0, 1)) for side in (False, True)]
    return np.broadcast_to(np.array(means)[left[1].astype(int), None], test.centers.shape)


def errors_of(found: Mapping[str, Array], test: Walks) -> dict[str, Array]:
    """Method → (N, F) distance from the middle of the walker's box, m."""
    return {name: np.linalg.norm(places - test.centers, axis=-1) for name, places in found.items()}


def classes(sigma: Array) -> list[tuple[str, NDArray[np.bool_]]]:
    """Name of each class of significance, and which sequences are in it."""
    names = [f"{low:g} to {high:g} σ" for low, high in pairwise(BOUNDS[:-1])] + [f"over {BOUNDS[-2]:g} σ"]
    return [
        (name, (sigma >= low) & (sigma < high)) for name, (low, high) in zip(names, pairwise(BOUNDS), strict=True)
    ]


def table(errors: Mapping[str, Array], sigma: Array) -> str:
    """Errors of all frames, and their median by the significance of the change."""
    of = classes(sigma)
    counts = ", ".join(f"{some.sum()} of {name}" for name, some in of)
    lines = [
        f"{len(sigma)} sequences kept back: {counts}",
        "| distance (m) | median | 90 % | within 25 cm | " + " | ".join(f"median, {name}" for name, _ in of) + " |",
        "|---|" + "---:|" * (3 + len(of)),
    ]
    for name, off in errors.items():
        cells = [f"{np.median(off):.2f}", f"{np.quantile(off, 0.9):.2f}", f"{np.mean(off <= NEAR_M):.0%}"]
        cells += [f"{np.median(off[some]):.2f}" if some.any() else "" for _, some in of]
        lines.append(f"| {name} | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def draw(path: Path, found: Mapping[str, Array], test: Walks, out: Path) -> None:
    """Ways in the floor plans of a few rooms, and errors by time and by significance."""
    errors = {name: off for name, off in errors_of(found, test).items() if name in COLORS}
    each = np.median(errors[NETWORK], axis=1)
    order = np.argsort(each)
    chosen = [int(order[round(level * (len(order) - 1))]) for level in QUANTILES]
    text = (
        "Above: floor plans of four rooms that no training saw, at the 10th, 50th, 75th and 90th percentile of the "
        "network's error, which stands above each (median over the frames). Only the relay wall is measured; the "
        f"device does not see the walker. A point is a frame, one every {test.step_s:g} s. Below: distance from the "
        f"middle of the walker's box to the place found, over all {len(each)} sequences kept back; σ says how far "
        "the change from one frame to the next stands out of the noise."
    )
    with house_style():
        figure, grid = captioned([2.6, 2.5], text, "Somebody walks behind the corner", 2)
        _draw_rooms(figure, grid[0, :], path, found, test, chosen, each)
        _draw_by_time(figure.add_subplot(grid[1, 0]), errors, test.step_s)
        _draw_by_sigma(figure.add_subplot(grid[1, 1]), errors, test.sigma)
        save_png(figure, out)


def _draw_rooms(
    figure: Figure, place: SubplotSpec, path: Path, found: Mapping[str, Array], test: Walks, chosen: list[int],
    each: Array,
) -> None:  # fmt: skip
    data = dg.TransientDataset(path, ("hidden_view", "laser_points"), split="test")
    above = figure.add_subfigure(place)
    panels = above.subplots(1, len(chosen))
    for panel, number in zip(panels, chosen, strict=True):
        item = {name: np.asarray(values, np.float64) for name, values in data[number].items()}
        scan = ViewFrame.about(Rectangle(*item["hidden_view"])).to_view(item["laser_points"])
        (left, near), (right, far) = test.low[number], test.high[number]
        panel.plot([left, left, right, right], [near, far, far, near], color="#B4B4B8", linewidth=1.5, label="walls")
        panel.plot([left, right], [near, near], color="#5E8DC1", linewidth=3, label="relay wall")
        panel.plot(scan[:, 0], scan[:, 2], "|", color="#D55E00", markersize=6, label="laser points")
        panel.plot(*test.centers[number][:, [0, 2]].T, ".-", color=TRUTH, linewidth=1.5, label="true way")
        for name in (KALMAN, NETWORK):
            panel.plot(*found[name][number][:, [0, 2]].T, ".-", color=COLORS[name], linewidth=1, label=name)
            panel.plot(*found[name][number][0, [0, 2]], "s", color=COLORS[name], markersize=4)
        panel.plot(*test.centers[number][0, [0, 2]], "s", color=TRUTH, markersize=4, label="first frame (a square)")
        panel.set_aspect("equal", anchor="S")
        panel.set(xticks=[], yticks=[], xlim=(left - 0.2, right + 0.2), ylim=(near - 0.6, far + 0.2))
        panel.spines[:].set_visible(False)
        panel.set_title(f"{each[number]:.2f} m, {test.sigma[number]:.0f} σ", loc="center", fontsize=9)
    panels[0].plot([-1, 0], [-0.4, -0.4], color=TRUTH, linewidth=1)
    panels[0].text(0.1, -0.4, "1 m", va="center", fontsize=8)
    handles, labels = panels[-1].get_legend_handles_labels()
    above.legend(handles, labels, loc="outside lower center", ncols=4)


def _draw_by_time(panel: Axes, errors: Mapping[str, Array], step_s: float) -> None:
    for name, off in errors.items():
        at = step_s * (np.arange(off.shape[1]) + 0.5)
        panel.plot(at, np.median(off, axis=0), color=COLORS[name], label=name)
        panel.plot(at, np.quantile(off, 0.9, axis=0), "--", color=COLORS[name], linewidth=1)
    panel.plot([], [], "--", color="#666666", linewidth=1, label="90 % of the sequences")
    panel.set(xlabel="time (s)", ylabel="distance (m), median", ylim=(0, None))
    panel.set_ylim(0, 1.45 * panel.get_ylim()[1])
    panel.legend(loc="upper center", ncols=2, columnspacing=1, handlelength=1.5)


def _draw_by_sigma(panel: Axes, errors: Mapping[str, Array], sigma: Array) -> None:
    of = [(name, some) for name, some in classes(sigma) if some.any()]
    for name, off in errors.items():
        panel.plot([np.median(off[some]) for _, some in of], "o-", color=COLORS[name], markersize=4)
    names = [f"{name.replace(' σ', '')}\n({some.sum()})" for name, some in of]
    panel.set_xticks(range(len(of)), names)
    panel.set(xlabel="σ of the change (number of sequences)", ylabel="distance (m), median", ylim=(0, None))


def main() -> None:
    """Print the errors and draw the picture."""
    arguments = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    arguments.add_argument("out", type=Path)
    arguments.add_argument("--dataset", type=Path)
    for name, default in (("epochs", EPOCHS), ("workers", 2), ("seed", 0)):
        arguments.add_argument(f"--{name}", type=int, default=default)
    asked = arguments.parse_args()
    torch.set_num_threads(1)
    with tempfile.TemporaryDirectory() as folder:
        path = asked.dataset or Path(folder, "tracking.zarr")
        if not path.exists():
            dg.build(find_suite(SUITE).config, path, asked.workers)
        test = read_walks(path, "test")
        found = ways(path, test, asked.seed, asked.epochs)
        print(table(errors_of(found, test), test.sigma))
        draw(path, found, test, asked.out)


if __name__ == "__main__":
    main()
