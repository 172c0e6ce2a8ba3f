"""Distance and tilt of a plane from nine histograms of a TMF8820: trained on simulated frames, tested on real ones.

    python examples/tof_plane_training.py FOLDER docs/tof_plane_training.png

FOLDER holds tmf8820_plane.json.gz, a sweep of a real sensor before a plane that it faces
(cpsiff/SPAD-ICCP-Summer-School, part_2_active_SPADs/data/distance_data.json, MIT). The first and third quarter of the
distances from 0.1 to 0.4 m calibrate the device, from the data sheet's numbers; networks learn from simulated frames
of that device alone, and are tested on the second and fourth. Then they learn from simulations that leave one effect
out. Prints the tables and draws them.
"""

from __future__ import annotations

import argparse
import gzip
import json
from collections.abc import Callable, Mapping
from concurrent.futures import Executor, ProcessPoolExecutor, ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from pathlib import Path

import numpy as np
import torch
import trimesh
from evidence_training import Array
from matplotlib.ticker import LogLocator, NullFormatter
from numpy.typing import NDArray
from torch import nn

import datagen as dg
from datagen.devices import Device, Frames, calibrate
from datagen.devices.agreement import peak_positions
from datagen.devices.frames import fitted_and_tested
from datagen.report.style import captioned, house_style, save_png
from datagen.transport.flood import light_at_sensor

SWEEP = "tmf8820_plane.json.gz"
RANGE_M = (0.1, 0.4)
"""Distances that calibrate and that are tested."""
CALIBRATED_FROM_M = 0.15
"""Nearer frames do not calibrate: there parallax and the cover glass, which no device models, change the light."""
DRAWN_M = (0.04, 0.45)
"""Distances of simulated planes; wider than what is tested, since a network errs at the edges of what it saw."""
TILT_DEG = 30.0
ALBEDO = (0.15, 1.0)
ALBEDOS = 4
"""Albedos that each simulated plane is shown with. Halved, a network sees half as many frames."""
POINT = 0.03
"""Side of a zone that looks along its axis alone, in tangents: 23 rays of the beam. Halved, it is 6 rays, and its
brightness scatters by 10 %."""
CLOCK = slice(8, 72)
"""Bins that the network gets: from before the cover glass to 0.8 m."""
DATA_SHEET = Path(__file__).resolve().parents[1] / "examples" / "tmf8820_data_sheet.yaml"
"""The sensor before calibration: boxes of its SPADs, an even beam, bins of 94 ps, a Gaussian pulse."""
HIDDEN = 128
"""Neurons of a hidden layer. Halved, errors on simulated planes are a third larger."""
CHIP = "the chip's own"
PEAK = "peaks, with a line for each zone from the other half"
ALL = "calibrated on all frames, those tested among them"


@dataclass(frozen=True)
class Planes:
    """distance : (n,) along the sensor's axis, m. tilt : (n, 2) degrees by which the plane's right side and its top
    lean away. albedo : (n, ALBEDOS)."""

    distance: Array
    tilt: Array
    albedo: Array

    @classmethod
    def drawn(cls, count: int, seed: int) -> Planes:
        """Planes at random."""
        rng = np.random.default_rng(seed)
        turn, angle = rng.uniform(0, 2 * np.pi, count), rng.uniform(0, TILT_DEG, count)
        tilt = angle[:, None] * np.stack([np.cos(turn), np.sin(turn)], axis=1)
        return cls(rng.uniform(*DRAWN_M, count), tilt, rng.uniform(*ALBEDO, (count, ALBEDOS)))

    @property
    def answers(self) -> torch.Tensor:
        """(n · ALBEDOS, 3) what a network is to say: distance in m, tilt to the right and up in degrees."""
        each = np.concatenate([self.distance[:, None], self.tilt], axis=1)
        return torch.from_numpy(np.repeat(each, ALBEDOS, axis=0).astype(np.float32))


def light_of(device: Device, plane: tuple[float, float, float]) -> Array:
    """(zones, bins) photons for each emitted one from a white plane (distance, tilt to the right, tilt up)."""
    distance, right, up = plane
    angle = np.hypot(right, up)
    slab = trimesh.creation.box((0.02, 9, 9), trimesh.transformations.translation_matrix((0.01, 0, 0)))
    if angle > 0:
        # The sensor looks along x with z up: a turn about z takes the right side away from it, one about y the top.
        axis = (0, up / angle, right / angle)
        slab.apply_transform(trimesh.transformations.rotation_matrix(np.radians(angle), axis))
    slab.apply_translation((distance, 0, 0))
    scene = dg.Scene.from_parts([dg.Part("plane", slab, dg.Lambertian(1.0), role="relay_wall")])
    capture = device.at((0, 0, 0), (1, 0, 0))[0]
    accuracy = dg.Accuracy(samples=1, max_bounces=1, direct=True)
    return dg.simulate(scene, capture, accuracy).total[0]


def several(workers: int) -> Executor:
    """Processes that work at the same time, one torch thread each; for one worker, this process."""
    kind = ProcessPoolExecutor if workers > 1 else ThreadPoolExecutor
    return kind(workers, initializer=torch.set_num_threads, initargs=(1,))


def changed(device: Device, section: str, **numbers: object) -> Device:
    """The device with other numbers in one of its sections."""
    return device.model_copy(update={section: getattr(device, section).model_copy(update=numbers)})


def glass_of(device: Device) -> Array:
    """(zones, bins) light that the cover glass sends back, which is there without a plane."""
    facing = (RANGE_M[1], 0.0, 0.0)
    return light_of(device, facing) - light_of(changed(device, "zones", glass=()), facing)


def bare(device: Device) -> Device:
    """The device without what a sensor does to the light of all its zones: crosstalk, delays, and the cover glass."""
    return changed(device, "zones", crosstalk=0.0, delays_ps=(), glass=())


def counts_of(device: Device, glass: Array, albedo: Array, light: Array) -> Array:
    """(albedo, zones, device's bins) expected counts before a plane whose light in the bare device, with albedo 1, is
    `light` (zones, bins)."""
    capture = device.at((0, 0, 0), (1, 0, 0))[0]
    mixed = np.maximum(glass, 0.0) + albedo[:, None, None] * light_at_sensor(light[None], capture)
    return dg.expected_histogram(mixed, device.axis, device.spad, device.exposure).astype(np.float32)


def simulated(devices: Mapping[str, Device], planes: Planes, workers: int) -> dict[str, torch.Tensor]:
    """Name → (n · ALBEDOS, zones, bins) expected counts; devices with the same optics share the light."""
    each = list(zip(planes.distance, *planes.tilt.T, strict=True))
    lights: dict[str, list[Array]] = {}
    found = {}
    with several(workers) as pool:
        for name, device in devices.items():
            key = bare(device).zones.model_dump_json() + device.time.model_dump_json()
            if key not in lights:
                # Few lights are kept at once: only the first device's is used again.
                lights = dict(list(lights.items())[:1])
                lights[key] = list(pool.map(partial(light_of, bare(device)), each, chunksize=16))
            counted = partial(counts_of, device, glass_of(device))
            counts = pool.map(counted, planes.albedo, lights[key], chunksize=16)
            found[name] = torch.from_numpy(np.concatenate(list(counts)))
    return found


def without_tail(device: Device) -> Device:
    """A Gaussian pulse with the half maxima of the measured one."""
    samples = np.array(device.pulse.samples)
    step = device.pulse.sample_ps or 0.0
    top = int(samples.argmax())
    half = samples[top] / 2
    rise = np.interp(half, samples[: top + 1], np.arange(top + 1))
    fall = np.interp(-half, -samples[top:], np.arange(top, len(samples)))
    sigma = (fall - rise) / (2 * np.sqrt(2 * np.log(2)))
    gauss = np.exp(-(((np.arange(len(samples)) - (rise + fall) / 2) / sigma) ** 2) / 2)
    return changed(device, "pulse", samples=tuple(gauss.tolist()), sample_ps=step)


def with_zones(device: Device, side: float | None) -> Device:
    """Zones that look at sharp boxes as in the data sheet, or, with a side, along their axes alone. A plane at 0.3 m
    is as bright as before in each of them."""
    boxes = dg.device(DATA_SHEET).zones.boxes
    if side is not None:
        boxes = tuple((x, y, side, side) for x, y, _, _ in device.zones.boxes)
    other = changed(device, "zones", boxes=boxes, blur=0.0, glass=())
    facing = (0.3, 0.0, 0.0)
    before, after = (light_of(bare(of), facing).sum(axis=1) for of in (device, other))
    gains = tuple((np.array(device.zones.gains) * before / after).tolist())
    return changed(other, "zones", gains=gains, glass=device.zones.glass)


WHOLE, NOISE = "nothing", "photon noise"
LEFT_OUT: dict[str, Callable[[Device], Device]] = {
    WHOLE: lambda device: device,
    "the pulse's tail": without_tail,
    "pile-up": lambda device: changed(device, "counting", mode="ideal"),
    "floor": lambda device: changed(device, "counting", dark_count_rate_hz=0.0),
    "cover glass": lambda device: changed(device, "zones", glass=()),
    NOISE: lambda device: device,
    "footprints (data sheet's boxes)": lambda device: with_zones(device, None),
    "footprints (zones' axes alone)": lambda device: with_zones(device, POINT),
    "zones' delays": lambda device: changed(device, "zones", delays_ps=()),
    "crosstalk": lambda device: changed(device, "zones", crosstalk=0.0),
}
"""Effect → the device without it."""


def shapes(counts: torch.Tensor) -> torch.Tensor:
    """(n, zones · bins) of counts (n, zones, bins): each histogram over its sum, so that brightness says nothing."""
    some = counts[..., CLOCK]
    return (some / some.sum(dim=-1, keepdim=True)).flatten(1)


class Predictor(nn.Module):
    """Two hidden layers of 128 for the shapes of nine histograms."""

    def __init__(self, counts: torch.Tensor, answers: torch.Tensor, seed: int) -> None:
        super().__init__()
        torch.manual_seed(seed)
        given = shapes(counts)
        self.mean, self.scale = given.mean(dim=0), given.std()
        self.middle, self.spread = answers.mean(dim=0), answers.std(dim=0)
        sizes = (given.shape[1], HIDDEN, HIDDEN)
        hidden = [layer for a, b in pairwise(sizes) for layer in (nn.Linear(a, b), nn.ReLU())]
        self.layers = nn.Sequential(*hidden, nn.Linear(HIDDEN, 3))

    def forward(self, counts: torch.Tensor) -> torch.Tensor:
        """(n, 3) distance in m, tilt to the right and up in degrees."""
        return self.middle + self.spread * self.layers((shapes(counts) - self.mean) / self.scale)


def trained(counts: torch.Tensor, answers: torch.Tensor, seed: int, epochs: int, noise: bool = True) -> Predictor:
    """A network that sees each epoch another draw of the photon noise.

    The noise is Poisson's with the exact mean: to draw the detections one by one, as `detect` does under a dead time,
    takes 100 times as long, and the real sensor's noise is two to three times Poisson's anyway.
    """
    network = Predictor(counts, answers, seed)
    optimizer = torch.optim.Adam(network.parameters(), lr=2e-3)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, epochs)
    for _ in range(epochs):
        for chosen in torch.randperm(len(answers)).split(64):
            drawn = torch.poisson(counts[chosen]) if noise else counts[chosen]
            loss = ((network(drawn) - answers[chosen]) / network.spread).square().mean()
            optimizer.zero_grad()
            loss.backward()
            optimizer.step()
        schedule.step()
    return network


def said(network: Predictor, counts: Array | torch.Tensor) -> Array:
    """(n, 3) what a network says of histograms (n, zones, bins)."""
    with torch.no_grad():
        return network(torch.as_tensor(counts).float()).double().numpy()


@dataclass(frozen=True)
class Sweep:
    """The real frames. frames : all. chip : (n, zones) the sensor's own depths, m. told, tested : (m,) numbers of the
    frames that calibrate, and of those that are tested."""

    frames: Frames
    chip: Array
    told: NDArray[np.int64]
    tested: NDArray[np.int64]

    @classmethod
    def read(cls, path: Path) -> Sweep:
        """The second and fourth quarter of a file's frames from 0.1 to 0.4 m test; the others calibrate."""
        frames = dg.read_frames(path)
        listed = json.loads(gzip.decompress(path.read_bytes()))
        chip = 1e-3 * np.array([frame["distances"][0]["depths_1"] for frame in listed], np.float64)
        z = distances(frames)
        order = np.argsort(z, kind="stable")
        order = order[(z[order] >= RANGE_M[0] - 1e-9) & (z[order] <= RANGE_M[1] + 1e-9)]
        told, tested = fitted_and_tested(len(order))
        return cls(frames, chip, order[told], order[tested])

    @property
    def truth(self) -> Array:
        """(m,) distances of the tested frames, m."""
        return distances(self.frames)[self.tested]


def distances(frames: Frames) -> Array:
    """(n,) m."""
    assert frames.distances_m is not None
    return frames.distances_m


def classical(sweep: Sweep) -> dict[str, Array]:
    """Name → (m,) distance of the tested frames, m, as the sensor gives it and by peaks: medians over the zones."""
    fitted = sweep.told[distances(sweep.frames)[sweep.told] >= CALIBRATED_FROM_M]
    truth = distances(sweep.frames)[fitted]
    chip = sweep.chip
    peaks = peak_positions(sweep.frames.histograms)
    lines = [np.polyfit(peaks[fitted, zone], truth, 1) for zone in range(peaks.shape[1])]
    by_peak = np.stack([np.polyval(line, peaks[:, zone]) for zone, line in enumerate(lines)], axis=1)
    level = chip - np.median(chip[fitted] - truth[:, None], axis=0)
    each = {CHIP: chip, "the chip's, less each zone's error in the other half": level, PEAK: by_peak}
    return {name: np.median(of[sweep.tested], axis=1) for name, of in each.items()}


def errors_mm(found: Array, truth: Array) -> str:
    """Cells of a table: median of |error|, its 90th percentile, the largest, and the median error."""
    off = 1e3 * (found - truth)
    size = np.abs(off)
    return f"{np.median(size):.2f} | {np.percentile(size, 90):.2f} | {size.max():.2f} | {np.median(off):+.2f}"


@dataclass(frozen=True)
class Found:
    """truth : (m,) m. answers : name → (m,) distances by other means. networks : effect left out → (seed, m, 3) what
    networks say. unseen : (distance, tilt) median errors on simulated planes, m and degrees."""

    truth: Array
    answers: dict[str, Array]
    networks: dict[str, Array]
    unseen: tuple[float, float]

    def median_mm(self, name: str) -> Array:
        """(seed,) median |error| of distance, mm."""
        return 1e3 * np.median(np.abs(self.networks[name][..., 0] - self.truth), axis=1)


def compared(sweep: Sweep, planes: int, epochs: int, seeds: int, workers: int) -> Found:
    """Calibrate, simulate, train, test."""
    sheet = dg.device(DATA_SHEET)
    half = calibrate(sweep.frames.some(sweep.told), sheet, held_out=False, nearest_m=CALIBRATED_FROM_M)
    everything = calibrate(sweep.frames, sheet, held_out=False, nearest_m=CALIBRATED_FROM_M)
    devices = {name: without(half.device) for name, without in LEFT_OUT.items()} | {ALL: everything.device}
    drawn = Planes.drawn(planes, 0)
    counts = simulated(devices, drawn, workers)
    real = sweep.frames.histograms[sweep.tested]
    answers = drawn.answers
    networks = {}
    kept = Planes.drawn(max(planes // 8, 2), 1)
    fresh = simulated({WHOLE: half.device}, kept, workers)[WHOLE]
    unseen = (np.nan, np.nan)
    with several(workers) as pool:
        for name, given in counts.items():
            one = partial(trained, given, answers, epochs=epochs, noise=name != NOISE)
            each = list(pool.map(one, range(seeds)))
            # The device's aperture lies this far behind the point that the sweep's distances count from.
            behind = 1e-3 * (everything if name == ALL else half).fitted["distance offset, mm"].value
            networks[name] = np.stack([said(network, real) for network in each]) - np.array([behind, 0.0, 0.0])
            if name == WHOLE:
                off = said(each[0], torch.poisson(fresh)) - kept.answers.double().numpy()
                unseen = float(np.median(np.abs(off[:, 0]))), float(np.median(np.hypot(off[:, 1], off[:, 2])))
    return Found(sweep.truth, classical(sweep), networks, unseen)


def tables(found: Found) -> str:
    """Two tables: the network beside other answers, and what it costs to leave an effect out of the simulation."""
    truth = found.truth
    lines = [
        f"| {len(truth)} real distances, {truth.min():.3f} to {truth.max():.3f} m | median error (mm) | "
        "90th percentile | largest | median, with its sign |",
        "|---|---:|---:|---:|---:|",
    ]
    lines += [f"| {name} | {errors_mm(of, truth)} |" for name, of in found.answers.items()]
    for name, title in ((WHOLE, "network, device calibrated on the other half"), (ALL, f"network, device {ALL}")):
        lines.append(f"| {title} | {errors_mm(found.networks[name][0, :, 0], truth)} |")
    tilt = np.hypot(*found.networks[WHOLE][0, :, 1:].T)
    lines += [
        "",
        f"tilt found where it is 0: median {np.median(tilt):.2f}°, largest {tilt.max():.2f}°",
        f"simulated planes not trained on: distance {1e3 * found.unseen[0]:.2f} mm, tilt {found.unseen[1]:.2f}°",
        "",
        "| left out of the simulation | median error (mm) | times | median, with its sign | tilt found (degrees) |",
        "|---|---:|---:|---:|---:|",
    ]
    whole = found.median_mm(WHOLE).mean()
    for name in LEFT_OUT:
        each, said_ = found.median_mm(name), found.networks[name]
        off = np.median(1e3 * (said_[..., 0] - truth))
        tilt = np.median(np.hypot(said_[..., 1], said_[..., 2]))
        spread = each.std(ddof=min(len(each) - 1, 1))
        lines.append(
            f"| {name} | {each.mean():.2f} ± {spread:.2f} | {each.mean() / whole:.1f} | {off:+.2f} | {tilt:.2f} |"
        )
    return "\n".join(lines)


def draw(found: Found, out: Path) -> None:
    """Errors over distance, and what each effect costs."""
    text = (
        "Above: error of the distance to a real plane, at distances that calibrated nothing; the network saw "
        "simulated frames alone. Below: median error over these distances of networks that learnt from simulations "
        "without one effect of the sensor."
    )
    with house_style():
        title = "A plane's distance to a real TMF8820, learnt from simulated frames alone"
        figure, grid = captioned([2.9, 2.9], text, title)
        axes = figure.add_subplot(grid[0, 0])
        shown = {**found.answers, "network": found.networks[WHOLE][0, :, 0]}
        for (name, of), color in zip(shown.items(), ("#9A9A9A", "#222222", "#0072B2", "#D55E00"), strict=True):
            axes.plot(found.truth, (1e3 * np.abs(of - found.truth)).clip(0.01), ".", color=color, label=name)
        axes.set(xlabel="true distance (m)", ylabel="|error| (mm)", yscale="log", ylim=(0.008, 30))
        axes.yaxis.set_major_formatter("{x:g}")
        axes.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=2, columnspacing=2)
        axes = figure.add_subplot(grid[1, 0])
        names = list(LEFT_OUT)[::-1]
        mean = {"color": "#9A9A9A", "lw": 0.8, "label": "mean with all effects"}
        axes.axvline(found.median_mm(WHOLE).mean(), **mean)
        for row, name in enumerate(names):
            each = found.median_mm(name)
            color, what = ("#D55E00", "with all effects") if name == WHOLE else ("#0072B2", "without one")
            label = f"a training {what}" if name in (names[0], WHOLE) else None
            axes.plot(each, np.full(len(each), row), "o", color=color, alpha=0.7, label=label)
        axes.set_yticks(range(len(names)), names)
        axes.set(xlabel="median |error| (mm)", xscale="log", title="left out of the simulation")
        axes.legend(loc="lower right", bbox_to_anchor=(1.0, 0.05))
        axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        axes.xaxis.set_major_formatter("{x:g}")
        axes.xaxis.set_minor_formatter(NullFormatter())
        save_png(figure, out)


def main() -> None:
    """Print the tables and draw the picture."""
    arguments = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    arguments.add_argument("folder", type=Path)
    arguments.add_argument("out", type=Path)
    for name, default in (("planes", 600), ("epochs", 60), ("seeds", 3), ("workers", 2)):
        arguments.add_argument(f"--{name}", type=int, default=default)
    asked = arguments.parse_args()
    path = asked.folder / SWEEP
    if not path.is_file():
        print(f"{path}: no such file; nothing is trained. The head of this script says where the sweep comes from")
        return
    found = compared(Sweep.read(path), asked.planes, asked.epochs, asked.seeds, asked.workers)
    print(tables(found))
    draw(found, asked.out)


if __name__ == "__main__":
    main()
