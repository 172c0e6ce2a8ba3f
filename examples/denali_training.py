"""Which letter, how large, and where? A network reads it from one frame of a TMF8828 around a corner.

    python examples/denali_training.py docs/denali_training.png --dataset out/denali.zarr

builds the suite denali-1 (unless the folder is there), trains a small network on its split train, and prints how well
it finds class, height and place in the split test, also by the significance of the object, and from fewer scenes.
Then it trains on simulations that leave one effect of the sensor out, and tests on frames that have all of them.
Draws where plates are and are found, errors by significance, and what each effect costs.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from pathlib import Path

import numpy as np
import torch
from evidence_training import Array
from matplotlib.axes import Axes
from numpy.typing import NDArray
from torch import nn

import datagen as dg
from datagen.config import config_from_mapping
from datagen.config.yaml_text import parse_yaml
from datagen.detector import detector_for
from datagen.labels.frame import ViewFrame
from datagen.report.style import captioned, house_style, save_png
from datagen.scoring.single_objects import TITLES
from datagen.store import read_manifest
from datagen.suites.catalogue import find_suite

SUITE = "denali-1"
LATE = slice(60, None)
"""Bins that the network gets: after the peak of the wall's first return, before any plate's light."""
COMPONENTS = 64
"""Principal components of late light that the network gets. With half of them errors are alike, to 3 %."""
HIDDEN = 128
EPOCHS = 60
BATCH = 32
RATE = 2e-3
WEIGHTS = 1.0, 0.5, 0.3
"""Of place, height and class in the loss."""
BOUNDS = (0.0, 5.0, 10.0, 20.0, 40.0, np.inf)
"""Of the classes of significance in which errors are told."""
MATT_SCENES = 300
"""Scenes with matt plates, of which three in ten are tested; 4 minutes of one core."""
MEAN, NETWORK = "always the mean, or what is most frequent", "network"
COLORS = {MEAN: "#9A9A9A", NETWORK: "#0072B2"}
OWN = "#D55E00"
EACH = 3
"""Of the plates kept back every third is drawn."""


@dataclass(frozen=True)
class Plates:
    """The scenes of a split.

    scene : (n,) indices of the scenes. counts : (n, zone, bin) as stored, drawn with all effects, in the bins `LATE`.
    expected : effect that is left out → (n, zone, bin) expected counts in these bins.
    places : (n, 2) along right and depth, m. classes : (n,). heights : (n,) m. sigma : (n,).
    """

    scene: NDArray[np.int64]
    counts: torch.Tensor
    expected: dict[str, torch.Tensor]
    places: torch.Tensor
    classes: torch.Tensor
    heights: torch.Tensor
    sigma: Array

    def some(self, step: int) -> Plates:
        """Every `step`-th of the scenes, with all effects."""
        here = slice(None, None, step)
        return Plates(
            self.scene[here], self.counts[here], {WHOLE: self.expected[WHOLE][here]}, self.places[here],
            self.classes[here], self.heights[here], self.sigma[here],
        )  # fmt: skip


@dataclass(frozen=True)
class Measurement:
    """Light at the sensor (1, zone, bin), and what it is detected with."""

    light: Array
    spad: dg.Spad
    exposure: dg.Exposure


def half_maxima(pulse: dg.Pulse) -> Array:
    """When a pulse rises to half of its maximum, and when it has fallen to it, s."""
    samples = np.array(pulse.samples)
    top = int(samples.argmax())
    rise = np.interp(samples[top] / 2, samples[: top + 1], np.arange(top + 1))
    fall = np.interp(-samples[top] / 2, -samples[top:], np.arange(top, len(samples)))
    return pulse.start_s + pulse.width_s * (np.array([rise, fall]) + 0.5)


def without_tail(of: Measurement) -> Measurement:
    """With a Gaussian pulse that has the half maxima of the measured one."""
    pulse = of.exposure.pulse
    assert pulse is not None
    rise, fall = half_maxima(pulse)
    at = pulse.start_s + pulse.width_s * (np.arange(len(pulse.samples)) + 0.5)
    gauss = np.exp(-4 * np.log(2) * ((at - (rise + fall) / 2) / (fall - rise)) ** 2)
    return with_pulse(of, replace(pulse, samples=tuple(gauss.tolist())))


def without_length(of: Measurement) -> Measurement:
    """With a pulse that is as short as one sample of the measured one, in its middle."""
    pulse = of.exposure.pulse
    assert pulse is not None
    middle = float(half_maxima(pulse).mean())
    return with_pulse(of, dg.Pulse((1.0,), pulse.width_s, middle - pulse.width_s / 2))


def with_pulse(of: Measurement, pulse: dg.Pulse) -> Measurement:
    """With another pulse."""
    return replace(of, exposure=replace(of.exposure, pulse=pulse))


def without_floor(of: Measurement) -> Measurement:
    """Without dark counts and room light."""
    return replace(
        of, spad=replace(of.spad, dark_count_rate_hz=0.0), exposure=replace(of.exposure, ambient_rate_hz=0.0)
    )


def without_crosstalk(of: Measurement, share: float) -> Measurement:
    """Without the `share` of each zone's light that every other one has, too: light l became l + share (Σ l − l)."""
    zones = of.light.shape[1]
    everything = of.light.sum(axis=1, keepdims=True) / (1 + share * (zones - 1))
    return replace(of, light=np.maximum((of.light - share * everything) / (1 - share), 0.0))


def without_pile_up(of: Measurement) -> Measurement:
    """With a detector that counts every photon."""
    return replace(of, spad=replace(of.spad, mode="ideal"))


WHOLE, NOISE = "nothing", "photon noise"
Effects = dict[str, Callable[[Measurement], Measurement]]


def effects(crosstalk: float) -> Effects:
    """Effect → the measurement without it."""
    return {
        WHOLE: lambda of: of,
        "the pulse's tail": without_tail,
        "the pulse's length": without_length,
        "pile-up": without_pile_up,
        "floor": without_floor,
        "crosstalk": partial(without_crosstalk, share=crosstalk),
    }


def read(path: Path, split: str, wanted: Effects) -> Plates:
    """The scenes of a split, and their expected counts without each effect that is wanted."""
    fields = (
        "histogram", "transient", "object_class", "object_box_center", "object_box_size", "object_significance",
    )  # fmt: skip
    data = dg.TransientDataset(path, fields, split=split)
    config = read_manifest(path).parsed_config()
    axis = config.capture.time.axis()
    rows, expected = [], {name: list[Array]() for name in wanted}
    for number, item in zip(data.scenes.tolist(), data, strict=True):
        given = Measurement(
            item["transient"].double().numpy(), *detector_for(config.detector, config.seed, number, axis)
        )
        for name, without in wanted.items():
            of = without(given)
            counts = dg.expected_histogram(of.light, axis, of.spad, of.exposure)
            expected[name].append(counts[0, :, LATE].astype(np.float32))
        box = item["object_box_center"][0], item["object_box_size"][0]
        rows.append((item["histogram"][0, :, LATE], item["object_class"][0], box[0][[0, 2]], box[1][2]))
    counts, classes, places, heights = (torch.stack(of) for of in zip(*rows, strict=True))
    sigma = np.array([float(item["object_significance"][0]) for item in data])
    stacked = {name: torch.from_numpy(np.stack(of)) for name, of in expected.items()}
    return Plates(np.asarray(data.scenes), counts, stacked, places, classes.long(), heights, sigma)


class Network(nn.Module):
    """Two hidden layers of 128 for the principal components of late light.

    Input are counts less the mean of such frames, in units of their noise: the wall's first return is alike in all of
    them. Components are those of the expected counts of training, which have no noise; their length says how bright
    the plate is, and their direction the rest.
    """

    def __init__(self, expected: torch.Tensor, plates: Plates, classes: int, seed: int) -> None:
        super().__init__()
        torch.manual_seed(seed)
        self.mean = expected.mean(dim=0)
        late = self.late(expected, self.mean)
        self.axes = torch.linalg.svd(late - late.mean(dim=0), full_matrices=False)[2][:COMPONENTS].T
        self.middle, self.spread = plates.places.mean(dim=0), plates.places.std(dim=0)
        self.sizes = plates.heights.unique()
        sizes = (self.axes.shape[1] + 1, HIDDEN, HIDDEN)
        hidden = [layer for a, b in pairwise(sizes) for layer in (nn.Linear(a, b), nn.ReLU(), nn.Dropout(0.1))]
        self.layers = nn.Sequential(*hidden, nn.Linear(HIDDEN, 2 + len(self.sizes) + classes))

    def late(self, counts: torch.Tensor, mean: torch.Tensor) -> torch.Tensor:
        """(n, zone · bin) of counts (n, zone, bin)."""
        return ((counts - mean) / (mean + 1).sqrt()).flatten(1)

    def forward(self, counts: torch.Tensor, mean: torch.Tensor | None = None) -> tuple[torch.Tensor, ...]:
        """(n, 2) places in m, (n, size) and (n, class) logits of counts (n, zone, bin).

        mean : (zone, bin) of the sensor's frames; left out, that of training.
        """
        found = self.late(counts, self.mean if mean is None else mean) @ self.axes
        length = found.norm(dim=1, keepdim=True)
        said = self.layers(torch.cat([found / (length + 3) * 8, length.log1p()], dim=1))
        ends = 2, 2 + len(self.sizes)
        return self.middle + self.spread * said[:, : ends[0]], said[:, ends[0] : ends[1]], said[:, ends[1] :]


def trained(plates: Plates, classes: int, seed: int, epochs: int, without: str = WHOLE) -> Network:
    """A network that sees another draw of the photon noise in each epoch.

    Counts are Poisson's about the exact mean. What `redraw_noise=True` draws has the same law, to a hundredth of its
    variance since a zone's diode is blind for a hundredth of the time, and takes 500 times as long.
    """
    expected = plates.expected[WHOLE if without == NOISE else without]
    network = Network(expected, plates, classes, seed)
    steps = -(-len(plates.scene) // BATCH) * epochs
    optimizer = torch.optim.AdamW(network.parameters(), weight_decay=1e-4)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimizer, RATE, total_steps=steps)
    size = torch.searchsorted(network.sizes, plates.heights.contiguous())
    for _ in range(epochs):
        for chosen in torch.randperm(len(plates.scene)).split(BATCH):
            counts = expected[chosen] if without == NOISE else torch.poisson(expected[chosen])
            place, sizes, names = network(counts)
            terms = (
                ((place - plates.places[chosen]) / network.spread).square().mean(),
                nn.functional.cross_entropy(sizes, size[chosen]),
                nn.functional.cross_entropy(names, plates.classes[chosen]),
            )
            loss = sum(weight * term for weight, term in zip(WEIGHTS, terms, strict=True))
            optimizer.zero_grad()
            loss.backward()
            optimizer.step()
            schedule.step()
    return network.eval()


Found = dict[str, Array]
"""Predictions as `datagen score` takes them: `scene`, `places`, `classes` and `heights`."""


def said(network: Network, test: Plates, centred: bool = False) -> Found:
    """What a network says of the stored counts, less the mean of training, or (`centred`) less their own."""
    with torch.no_grad():
        places, sizes, names = network(test.counts, test.counts.mean(dim=0) if centred else None)
    heights = network.sizes[sizes.argmax(dim=1)]
    return {"scene": test.scene, "places": places.double().numpy(), "classes": names.argmax(dim=1).numpy(),
            "heights": heights.double().numpy()}  # fmt: skip


def guessed(train: Plates, test: Plates) -> Found:
    """What can be said without a measurement: the mean place, and the class and height that are most frequent."""
    count = len(test.scene)
    return {"scene": test.scene, "places": np.tile(train.places.mean(dim=0).double().numpy(), (count, 1)),
            "classes": np.full(count, int(train.classes.mode().values)),
            "heights": np.full(count, float(train.heights.mode().values))}  # fmt: skip


def distances(found: Found, test: Plates) -> Array:
    """(n,) how far off places are, m."""
    return np.asarray(np.linalg.norm(found["places"] - test.places.double().numpy(), axis=1))


def wrong(found: Found, test: Plates) -> NDArray[np.bool_]:
    """(n,) whether the height is that of another size."""
    return np.asarray(np.abs(found["heights"] - test.heights.double().numpy()) > 1e-3)


@dataclass(frozen=True)
class Results:
    """What was found in the split test, by seed.

    network : with all effects. matt : the same networks for plates that scatter evenly. fewer : number of scenes
    trained on → found. without : effect → found, and centred : effect → found where frames are centred by their own
    mean.
    """

    guess: Found
    network: list[Found]
    matt: list[Found]
    fewer: dict[int, list[Found]]
    without: dict[str, list[Found]]
    centred: dict[str, list[Found]]


def build_matt(path: Path, workers: int) -> None:
    """Scenes of the suite with plates that scatter evenly in place of sheeting."""
    values = parse_yaml(find_suite(SUITE).path.read_text(encoding="utf-8"), SUITE)
    values |= {"name": "denali_matt", "scenes": MATT_SCENES}
    values["scene"]["contents"][0]["brdf"] = {"kind": "lambertian"}
    dg.build(config_from_mapping(values), path, workers)


def compared(path: Path, matt: Path, wanted: Effects, epochs: int, seeds: int) -> tuple[Results, Plates]:
    """Train and test everything."""
    all_of_them = {WHOLE: wanted[WHOLE]}
    train, test, others = (
        read(path, "train", wanted),
        read(path, "test", all_of_them),
        read(matt, "test", all_of_them),
    )
    classes = len(dg.TransientDataset(path, ("object_class",)).classes)
    results = Results(guessed(train, test), [], [], {}, {}, {})
    for step in (4, 2):
        some = train.some(step)
        results.fewer[len(some.scene)] = [said(trained(some, classes, seed, epochs), test) for seed in range(seeds)]
    for name in (*wanted, NOISE):
        began = time.process_time()
        networks = [trained(train, classes, seed, epochs, name) for seed in range(seeds)]
        results.without[name] = [said(network, test) for network in networks]
        results.centred[name] = [said(network, test, centred=True) for network in networks]
        if name == WHOLE:
            results.network.extend(results.without[name])
            results.matt.extend(said(network, others) for network in networks)
        print(f"without {name}: {time.process_time() - began:.0f} s of one core", flush=True)
    return results, test


def classes_of(sigma: Array) -> list[tuple[str, NDArray[np.bool_]]]:
    """Name of each class of significance, and which scenes are in it; of those with scenes."""
    names = [f"{low:g} to {high:g} σ" for low, high in pairwise(BOUNDS[:-1])] + [f"over {BOUNDS[-2]:g} σ"]
    each = [
        (name, (sigma >= low) & (sigma < high)) for name, (low, high) in zip(names, pairwise(BOUNDS), strict=True)
    ]
    return [(name, some) for name, some in each if some.any()]


def rms(values: Array) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(np.square(values))))


def spread(values: list[float]) -> str:
    """Mean ± standard deviation between seeds, in percent or centimetres."""
    off = f" ± {100 * np.std(values, ddof=1):.1f}" if len(values) > 1 else ""
    return f"{100 * np.mean(values):.1f}{off}"


def scored(path: Path, found: list[Found]) -> list[str]:
    """Cells of a table: the metrics of `datagen score`, lengths in cm and shares in percent."""
    each = [dg.score(path, one).all for one in found]
    return [spread([of[name] for of in each]) for name in TITLES]


def tables(path: Path, matt: Path, results: Results, test: Plates) -> str:
    """Three tables: beside other answers, by significance, and without one effect."""
    head = ["place: RMS (cm)", "median", "90 %", "class (%)", "height (%)"]
    counted = len(dg.TransientDataset(path, ("histogram",), split="train"))
    rows = {MEAN: [results.guess]} | {f"{NETWORK}, {n} scenes": of for n, of in results.fewer.items()}
    rows |= {f"{NETWORK}, {counted} scenes": results.network}
    lines = [f"| {len(test.scene)} scenes kept back | " + " | ".join(head) + " |", "|---|" + "---:|" * len(head)]
    lines += [f"| {name} | " + " | ".join(scored(path, of)) + " |" for name, of in rows.items()]
    lines.append(
        f"| {NETWORK}, tested on {len(results.matt[0]['scene'])} matt plates | "
        + " | ".join(scored(matt, results.matt))
        + " |"
    )
    of = classes_of(test.sigma)
    lines += [
        "",
        "| | " + " | ".join(f"{name} ({some.sum()})" for name, some in of) + " |",
        "|---|" + "---:|" * len(of),
    ]
    for title, measure in (("place: RMS (cm)", distances), ("height wrong (%)", wrong)):
        for name, found in ((MEAN, [results.guess]), (NETWORK, results.network)):
            cells = [spread([_summary(measure(one, test)[some]) for one in found]) for _, some in of]
            lines.append(f"| {title}, {name} | " + " | ".join(cells) + " |")
    lines += ["", "| left out of the simulation | " + " | ".join([*head[:1], *head[3:], "place, own mean (cm)",
              "height, own mean (%)"]) + " |", "|---|" + "---:|" * 5]  # fmt: skip
    for name, found in results.without.items():
        cells, centred = scored(path, found), scored(path, results.centred[name])
        lines.append(f"| {name} | " + " | ".join([cells[0], *cells[3:], centred[0], centred[4]]) + " |")
    return "\n".join(lines)


def _summary(values: Array | NDArray[np.bool_]) -> float:
    return float(values.mean()) if values.dtype == bool else rms(np.asarray(values, np.float64))


def draw(results: Results, test: Plates, out: Path) -> None:
    """The bench, places found, errors by significance, and what each effect costs."""
    text = (
        "Above left: the bench from above; the sensor lights and sees the wall alone, and plates stand in the "
        f"dashed square. Above right: that square, with every third of the {len(test.scene)} plates that no "
        "training saw; a line leads from where a plate is (dot) to where the network finds it. Below left: "
        "distance between the two, by how far the plate's light stands out of the noise of one frame (σ). Below "
        "right: networks trained on a simulation that lacks one effect, tested on frames that have all; a mark is "
        "a training with another seed."
    )
    with house_style():
        title = "Where is the plate? One frame of a simulated TMF8828 around the corner"
        figure, grid = captioned([3.1, 2.9], text, title, 2, [1, 1.25])
        _draw_bench(figure.add_subplot(grid[0, 0]), test)
        _draw_places(figure.add_subplot(grid[0, 1]), results.network[0], test)
        _draw_by_sigma(figure.add_subplot(grid[1, 0]), results, test)
        _draw_effects(figure.add_subplot(grid[1, 1]), results, test)
        save_png(figure, out)


def _draw_bench(panel: Axes, test: Plates) -> None:
    config = find_suite(SUITE).config
    scene = dg.generate_scene(config.scene, config.seed, 0)
    capture = dg.capture_for(config, scene, config.seed, 0)
    frame, part = ViewFrame.of(scene), scene.part_names.index
    for name, color, label in (("relay_wall", "#5E8DC1", "relay wall"), ("screen", "#222222", "partition")):
        ends = frame.to_view(scene.corners[scene.face_part == part(name)].reshape(-1, 3))
        panel.plot(ends[:, 0], ends[:, 2], color=color, linewidth=3, label=label)
    device = frame.to_view(capture.sensor.position)
    # Directions of the outermost corners of all zones, to where they meet the plane of the wall.
    ways = frame.to_view(capture.sensor.pixels.reshape(-1, 3)) - device
    slopes = ways[:, 0] / ways[:, 2]
    ends = device[0] - np.array([slopes.min(), slopes.max()]) * device[2]
    panel.fill([device[0], *ends], [device[2], 0, 0], color="#E69F00", alpha=0.25, linewidth=0, label="field of view")
    panel.plot(device[0], device[2], "s", color="#222222", label="sensor")
    (left, near), (right, far) = test.places.numpy().min(axis=0), test.places.numpy().max(axis=0)
    panel.plot([left, right, right, left, left], [near, near, far, far, near], "--", color="#0072B2", label="plates")
    panel.plot([left, left + 0.2], [far + 0.12] * 2, color="#222222", linewidth=1)
    panel.text(left + 0.1, far + 0.13, "20 cm", ha="center", va="top", fontsize=8)
    panel.set_aspect("equal")
    panel.set(xticks=[], yticks=[], ylim=(far + 0.2, -0.03))
    panel.spines[:].set_visible(False)
    panel.legend(loc="upper center", bbox_to_anchor=(0.5, 0.02), ncols=3, fontsize=8, columnspacing=1)


def _draw_places(panel: Axes, found: Found, test: Plates) -> None:
    true = 100 * test.places.double().numpy()
    ends = np.stack([true, 100 * found["places"]])
    shown = np.arange(0, len(true), EACH)
    for name, color, low, high in (
        ("under 10 σ", "#CC79A7", 0, 10), ("10 to 20 σ", "#E69F00", 10, 20), ("over 20 σ", "#0072B2", 20, np.inf)
    ):  # fmt: skip
        some = shown[(test.sigma[shown] >= low) & (test.sigma[shown] < high)]
        panel.plot(ends[:, some, 0], ends[:, some, 1], color=color, linewidth=1, alpha=0.8)
        panel.plot(*true[some].T, "o", color=color, markersize=4, label=name)
    panel.set_aspect("equal")
    panel.set(xlabel="along the wall (cm)", ylabel="from the wall (cm)")
    panel.invert_yaxis()
    panel.legend(loc="center left", bbox_to_anchor=(1.0, 0.5))


def _draw_by_sigma(panel: Axes, results: Results, test: Plates) -> None:
    of = classes_of(test.sigma)
    for name, found in ((MEAN, [results.guess]), (NETWORK, results.network)):
        each = np.array([[100 * rms(distances(one, test)[some]) for _, some in of] for one in found])
        panel.plot(each.mean(axis=0), "o-", color=COLORS[name], markersize=4, label=name.split(",")[0])
    panel.set_xticks(range(len(of)), [f"{name.replace(' σ', '')}\n({some.sum()})" for name, some in of], fontsize=8)
    panel.set(xlabel="σ of the plate (scenes)", ylabel="distance, RMS (cm)", ylim=(0, None))
    panel.legend(loc="best")


def _draw_effects(panel: Axes, results: Results, test: Plates) -> None:
    names = list(results.without)[::-1]
    kinds = (
        (results.without, COLORS[NETWORK], 0.12, "beside the mean frame of training"),
        (results.centred, OWN, -0.12, "beside the mean frame of the tested sensor"),
    )
    for found, color, shift, label in kinds:
        for row, name in enumerate(names):
            each = [100 * rms(distances(one, test)) for one in found[name]]
            panel.plot(each, np.full(len(each), row + shift), "o", color=color, markersize=4, label=label)
            label = "_"
    blind = 100 * rms(distances(results.guess, test))
    panel.plot([blind, blind], [-0.6, len(names) - 0.4], "--", color=COLORS[MEAN], label="always the mean")
    panel.set_yticks(range(len(names)), names)
    panel.set(xlabel="distance, RMS (cm)", xlim=(0, None), ylim=(-0.6, len(names) + 1.6))
    panel.set_title("left out of the simulation", loc="center", fontsize=9)
    panel.legend(loc="upper left")


def main() -> None:
    """Print the tables and draw the picture."""
    arguments = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    arguments.add_argument("out", type=Path)
    arguments.add_argument("--dataset", type=Path)
    arguments.add_argument("--matt", type=Path)
    for name, default in (("epochs", EPOCHS), ("seeds", 3), ("workers", 2)):
        arguments.add_argument(f"--{name}", type=int, default=default)
    asked = arguments.parse_args()
    torch.set_num_threads(1)
    config = find_suite(SUITE).config
    assert config.capture.device is not None
    with tempfile.TemporaryDirectory() as folder:
        path = asked.dataset or Path(folder, "denali.zarr")
        if not path.exists():
            dg.build(config, path, asked.workers)
        matt = asked.matt or Path(folder, "matt.zarr")
        if not matt.exists():
            build_matt(matt, asked.workers)
        wanted = effects(config.capture.device.zones.crosstalk)
        results, test = compared(path, matt, wanted, asked.epochs, asked.seeds)
        print(tables(path, matt, results, test))
        draw(results, test, asked.out)


if __name__ == "__main__":
    main()
