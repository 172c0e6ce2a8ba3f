"""Depth and silhouette of what hides behind a corner: a network trained on simulated scans, run on real ones.

    python examples/nlos_real_training.py FOLDER docs/nlos_real_training.png

FOLDER holds irf_lab_8ps.npy, the response of a laboratory's detector (confocal-diffuse-tomography, MIT), and
data_diffuse_s.mat and data_resolution_chart_40cm.mat (O'Toole, Lindell and Wetzstein, Nature 555, 338 (2018)).
Letters, digits, shapes and figures, diffuse and retroreflecting, are simulated before a wall; a network learns
silhouette and depth from their filtered backprojection and f-k volumes; and is run on the two real scans, beside
these two alone. Then it learns from simulations that leave one effect out. Prints the tables and draws them.
"""

from __future__ import annotations

import argparse
from concurrent.futures import Executor
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from pathlib import Path

import numpy as np
import scipy.optimize
import torch
import trimesh
from evidence_training import Array, framed
from fk import migrated
from numpy.typing import NDArray
from scipy.ndimage import gaussian_laplace, map_coordinates
from tof_plane_training import several
from torch import nn

import datagen as dg
from datagen.config.imported import ImportOptions
from datagen.formats.layouts import read_capture
from datagen.formats.recording import Stated
from datagen.reconstruction.backprojection import Scan, backprojected, whitened
from datagen.report.style import captioned, house_style, save_png
from datagen.transport.rays import Raycaster
from datagen.units import SPEED_OF_LIGHT_M_PER_S
from scene_library.objects.classes import build, classes_of

IRF, LETTER, CHART = "irf_lab_8ps.npy", "data_diffuse_s.mat", "data_resolution_chart_40cm.mat"
POINTS = 32
"""Points along each side of the scan; the real ones have 64, which are added up in fours. Halved, the strokes of the
real S are two points wide."""
BINS, BIN_S, STEPS = 128, 64e-12, 2
"""Bins, each 64 ps or 9.6 mm of depth, simulated in halves."""
WALLS_M = (0.4, 0.7)
"""Sides of the walls that are scanned, as the real ones."""
NEAR, FAR, LAYERS = 0.5, 1.4, 64
"""Depths of the volume, in sides of the wall. With half the layers, they are 2 cm apart before the larger wall."""
RATIOS = (0.65, 1.2)
"""Depths of the simulated objects, in sides of the wall."""
RETRO_SHARE = 0.4
SHAPES = classes_of(("shapes", "figures"))
DRAWS = 2
"""Draws of light level, pulse, floor and noise for each simulated scene. Halved, a network sees half the scans."""
LATE_COUNTS, FLOOR_COUNTS, LATE_OVER_DIRECT = (300.0, 10000.0), (3.0, 40.0), (0.01, 0.3)
"""Of hidden light a point, of floor a bin, and late light over direct: the real scans lie within."""
STRETCH = (1.0, 2.5)
"""The laboratory's response is stretched in time: the tail of the real scans' direct light is so much slower."""
DETECTED = (0.01, 0.3)
"""Detections in a laser period; unknown of the real scans."""
RETRO_HALF_WIDTH = 0.03
"""Half width of the lobe of retroreflecting objects, radians: the lobe of sheeting, 0.01, is narrower than points of
the wall, where few sampled paths meet it."""
FINE_S = 16e-12
"""Bins in which the letter's outline is fitted."""
START = (0.0, -0.05, 0.4, 0.5, 0.09, 0.51, 0.0, 0.0)
"""The letter that the fit begins with (`Letter`)."""
CORNERS = ((0.5, 0.5), (-0.5, 0.5), (-0.5, 0.0), (0.5, 0.0), (0.5, -0.5), (-0.5, -0.5))
"""Of the middle of the letter's five straight strokes, in widths and heights. Two arcs instead explain less of the
light of the real S."""
EVALUATIONS = 350
"""Of the fit's letters. Halved, its depth moves by a millimetre."""
BEFORE, AFTER = 20, 300
"""Bins of 8 ps before and after the peak of the laboratory's response. With half of the second, tails end 1.2 ns
after the peak, at a thousandth of it."""
CHANNELS = 32
"""Of each convolution. Halved, training takes half as long."""
ABOUT = 8
"""Layers before and behind the brightest one that the network gets. Halved, objects as deep as a tenth of the wall
are cut off."""
DEPTH_UNIT = 0.03
"""Of the network's depths, sides of the wall. Halved, silhouettes count less beside depths."""
DEPTH_WEIGHT = 0.1
"""Of a squared error of one such unit, beside the silhouette's loss. At 1 no silhouette is learnt in so short a
training."""
SHARES = np.linspace(0.05, 0.95, 37)
"""Of the brightest voxel, from which on a volume counts as seen. With a quarter as many, the best overlap of f-k is
lower by 0.01."""
CHART_M = 0.4
"""Depth of the real chart, after which its file is named."""
BACKPROJECTION, FK, NETWORK = "filtered backprojection", "f-k migration", "network"
METHODS = (BACKPROJECTION, FK)
EXACT = dg.Accuracy(target=0.2, max_bounces=3)
SAMPLED = dg.Accuracy(samples=128, max_bounces=3)


def grid(side: float) -> Array:
    """(row, column, 3) points of a scan on the wall x = 0; row 0 at the top, column 0 at the left of somebody who
    faces it, that is at +y."""
    # Each stands for 2 × 2 points of a real scan of 64 × 64.
    at = (np.arange(POINTS) / (POINTS - 1) - 0.5) * side * 62 / 63
    y, z = np.meshgrid(-at, -at)
    return np.stack([np.zeros_like(y), y, z], axis=-1)


def capture_of(side: float) -> dg.Capture:
    """The confocal scan of a wall."""
    points = grid(side).reshape(-1, 3)
    half = side / POINTS / 2
    corners = points[:, None] + half * np.array([[0, -1, -1], [0, 1, -1], [0, 1, 1], [0, -1, 1]])
    time = dg.TimeAxis(BINS * STEPS, BIN_S / STEPS, 0.0, "wall")
    place = (1.5, 2.5, 0.0)
    return dg.Capture(dg.Laser(place, points), dg.Sensor(place, corners), time, pairing="confocal")


def simulated(number: int, retro: bool) -> tuple[Array, NDArray[np.bool_], Array, float]:
    """One scene, by its number: light (row, column, bin), mask and depth (row, column), and the side of the wall.

    retro : whether every so many objects retroreflect; else all are diffuse.
    """
    rng = np.random.default_rng(number)
    side = float(rng.choice(WALLS_M))
    names = classes_of(("letters", "digits")) if rng.random() < 0.6 else SHAPES
    thing = build(str(rng.choice(names)), rng)
    # A quarter turn: plates have y across their thickness, and are to face the wall.
    vertices = thing.vertices[:, [1, 0, 2]] * (1, -1, 1)
    vertices -= (vertices.max(axis=0) + vertices.min(axis=0)) / 2
    vertices *= rng.uniform(0.4, 0.8) * side / np.ptp(vertices[:, 1:], axis=0).max()
    tilt = trimesh.transformations.euler_matrix(*rng.normal(0, np.radians([8, 4, 4])))[:3, :3]
    shift = [0, *rng.uniform(-0.12, 0.12, 2) * side]
    vertices = vertices @ tilt.T + shift
    vertices[:, 0] += rng.uniform(*RATIOS) * side - vertices[:, 0].min()
    mesh = trimesh.Trimesh(vertices, thing.triangles, process=False)
    retroreflects = rng.random() < RETRO_SHARE and retro
    material = dg.Retroreflector(0.8, half_width_rad=RETRO_HALF_WIDTH) if retroreflects else dg.Lambertian(0.8)
    wall = trimesh.creation.box(bounds=[(-0.05, -1, -1), (0, 1, 1)])
    hidden = dg.Part("hidden", mesh, material)
    scene = dg.Scene.from_parts([dg.Part("relay_wall", wall, dg.Lambertian(0.9), role="relay_wall"), hidden])
    light = dg.simulate(scene, capture_of(side), SAMPLED if retroreflects else EXACT, seed=number).total
    points = grid(side).reshape(-1, 3)
    hits = Raycaster(dg.Scene.from_parts([hidden])).closest(points, np.broadcast_to((1.0, 0.0, 0.0), points.shape))
    depth = np.where(hits.valid, hits.position[:, 0], 0.0).reshape(POINTS, POINTS)
    return light.reshape(POINTS, POINTS, -1), hits.valid.reshape(POINTS, POINTS), depth, side


@dataclass(frozen=True)
class Simulation:
    """What is left in. retro : retroreflecting objects. tail : the pulse's tail. pile_up, floor : of the detector."""

    retro: bool = True
    tail: bool = True
    pile_up: bool = True
    floor: bool = True


LEFT_OUT = {
    "nothing": Simulation(),
    "the pulse's tail": Simulation(tail=False),
    "pile-up": Simulation(pile_up=False),
    "floor": Simulation(floor=False),
    "retroreflection": Simulation(retro=False),
}
WHOLE = "nothing"


def pulse_of(response: Array, stretch: float, tail: bool) -> dg.Pulse:
    """The laboratory's response (bins of 8 ps), longer by a factor, its peak at time 0; or, without its tail, a
    Gaussian of its width at half maximum."""
    top = int(response.argmax())
    some = np.maximum(response[top - BEFORE : top + AFTER] - np.median(response[: top - BEFORE]), 0.0)
    if not tail:
        half = np.flatnonzero(some >= some.max() / 2)
        sigma = (half[-1] - half[0] + 1) / 2.355
        some = np.exp(-(((np.arange(len(some)) - BEFORE) / sigma) ** 2) / 2)
    width = 8e-12 * stretch
    return dg.Pulse(some, width, -(BEFORE + 0.5) * width)


def counts_of(light: Array, response: Array, parts: Simulation, seed: int) -> Array:
    """(row, column, bin) counts of one scan with a drawn light level, pulse, floor, and direct light."""
    rng = np.random.default_rng(seed)
    late, floor, over, stretch, detected = (
        float(np.exp(rng.uniform(*np.log(bounds))))
        for bounds in (LATE_COUNTS, FLOOR_COUNTS, LATE_OVER_DIRECT, STRETCH, DETECTED)
    )
    time = dg.TimeAxis(BINS * STEPS, BIN_S / STEPS, 0.0, "wall")
    level = light.reshape(POINTS * POINTS, 1, -1) / light.sum() * POINTS**2
    # The wall itself, at time 0, is brighter to one side, where the laser stands.
    slope = np.exp(rng.uniform(-0.6, 0.6, 2) @ np.indices((POINTS, POINTS)).reshape(2, -1) / (POINTS / 2))
    level[:, 0, 0] += slope / slope.mean() / over
    # In a period `detected` photons of all, late ones among them with the share 1 / (1 + 1 / over).
    cycles = max(round(late * (1 + 1 / over) / detected), 1)
    rate = 1e7
    spad = dg.Spad(
        pde=1.0,
        dark_count_rate_hz=floor / (cycles * BIN_S) if parts.floor else 0.0,
        dead_time_s=80e-9,
        mode="synchronous" if parts.pile_up else "ideal",
        bins_merged=STEPS,
    )
    exposure = dg.Exposure(rate, cycles, late / cycles, pulse=pulse_of(response, stretch, parts.tail))
    mean = dg.expected_histogram(level, time, spad, exposure).reshape(POINTS, POINTS, BINS)
    return rng.poisson(mean).astype(np.float64)


def volumes_of(counts: Array, side: float) -> NDArray[np.float32]:
    """(method, LAYERS, row, column) roots of both `METHODS`, each over its largest value."""
    volumes = np.stack([backprojection(counts, side), fk(counts, side)])
    return np.sqrt(volumes / volumes.max(axis=(1, 2, 3), keepdims=True)).astype(np.float32)


def fk(counts: Array, side: float) -> Array:
    """(LAYERS, row, column) f-k migration, at depths in sides of the wall."""
    time = dg.TimeAxis(BINS, BIN_S, 0.0, "wall")
    across = side * 62 / 63
    volume, depths = migrated(counts, across, across, time)
    place = np.interp(layers(side), depths, np.arange(len(depths)))
    at = np.stack(np.meshgrid(place, np.arange(POINTS), np.arange(POINTS), indexing="ij"))
    return np.maximum(map_coordinates(volume, at, order=1), 0.0)


def about_brightest(volumes: NDArray[np.float32]) -> tuple[NDArray[np.float32], float]:
    """(method · (2 · ABOUT + 1), row, column) layers of both volumes about the brightest one of f-k migration, and
    its depth in sides of the wall."""
    middle = int((volumes[METHODS.index(FK)] ** 4).sum(axis=(1, 2)).argmax())
    padded = np.pad(volumes, ((0, 0), (ABOUT, ABOUT), (0, 0), (0, 0)), mode="edge")
    return padded[:, middle : middle + 2 * ABOUT + 1].reshape(-1, POINTS, POINTS), float(layers(1.0)[middle])


def layers(side: float) -> Array:
    """(LAYERS,) depths of the layers, metres."""
    return np.linspace(NEAR, FAR, LAYERS) * side


class Predictor(nn.Module):
    """Four convolutions over layers of both volumes, which are channels: silhouette and depth."""

    def __init__(self, seed: int) -> None:
        super().__init__()
        torch.manual_seed(seed)
        steps: list[nn.Module] = []
        width = len(METHODS) * (2 * ABOUT + 1)
        for dilation in (1, 2, 4, 1):
            steps += [nn.Conv2d(width, CHANNELS, 3, padding=dilation, dilation=dilation)]
            steps += [nn.GroupNorm(8, CHANNELS), nn.ReLU()]
            width = CHANNELS
        self.layers = nn.Sequential(*steps, nn.Conv2d(width, 2, 1))

    def forward(self, volume: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """(n, row, column) logit of the silhouette, and depth behind the middle layer in sides of the wall."""
        logit, depth = self.layers(volume).unbind(dim=1)
        return logit, DEPTH_UNIT * depth


@dataclass(frozen=True)
class Scans:
    """volume : (n, layers of both methods, row, column) about the brightest layer, whose depth is `middle` (n,).
    brightness : (n, method, row, column) of the brightest of all layers, over the brightest voxel. mask, depth : (n,
    row, column). Depths are in sides of the wall."""

    middle: torch.Tensor
    volume: torch.Tensor
    brightness: Array
    mask: torch.Tensor
    depth: torch.Tensor


def trained(scans: Scans, seed: int, epochs: int) -> Predictor:
    """A network that sees each scan mirrored and turned at random."""
    network = Predictor(seed)
    optimizer = torch.optim.Adam(network.parameters(), lr=3e-3)
    steps = epochs * -(-len(scans.mask) // 16)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimizer, 3e-3, total_steps=steps)
    behind = scans.depth - scans.middle[:, None, None]
    for _ in range(epochs):
        for chosen in torch.randperm(len(scans.mask)).split(16):
            turns, mirror = int(torch.randint(4, ())), bool(torch.randint(2, ()))
            volume, mask, depth = (
                torch.rot90(part.flip(-1) if mirror else part, turns, (-2, -1))
                for part in (scans.volume[chosen], scans.mask[chosen], behind[chosen])
            )
            logit, found = network(volume)
            shape = nn.functional.binary_cross_entropy_with_logits(logit, mask) + missed(logit, mask)
            off = (((found - depth) / DEPTH_UNIT * mask) ** 2).sum() / mask.sum()
            optimizer.zero_grad()
            (shape + DEPTH_WEIGHT * off).backward()
            optimizer.step()
            schedule.step()
    return network


def missed(logit: torch.Tensor, mask: torch.Tensor) -> torch.Tensor:
    """One less the Dice coefficient of soft silhouettes (n, row, column), mean over n. Each object counts alike,
    however small; and it is overlap, rather than the share of right points, which cross entropy alone optimizes."""
    soft = torch.sigmoid(logit)
    both, each = (soft * mask).sum((1, 2)), soft.sum((1, 2)) + mask.sum((1, 2))
    # One point more in both, as a scan may hold no silhouette.
    return (1 - (2 * both + 1) / (each + 1)).mean()


def said(network: Predictor, volumes: NDArray[np.float32]) -> tuple[NDArray[np.bool_], Array]:
    """(row, column) silhouette, and depth in sides of the wall, of one scan's volumes."""
    some, middle = about_brightest(volumes)
    with torch.no_grad():
        logit, depth = network(torch.from_numpy(some)[None])
    return logit[0].numpy() > 0, middle + depth[0].double().numpy()


def overlap(found: NDArray[np.bool_], truth: NDArray[np.bool_]) -> float:
    """Intersection over union."""
    return float((found & truth).sum() / (found | truth).sum())


@dataclass(frozen=True)
class Letter:
    """An S-shaped plate before the wall, as somebody sees it who faces the wall: mirrored.

    right, up : its middle, m. width, height, stroke : m. depth : of its middle, m. lean_right, lean_up : by how much
    deeper it is a metre further right, or up.
    """

    right: float
    up: float
    width: float
    height: float
    stroke: float
    depth: float
    lean_right: float
    lean_up: float

    def cover(self, right: Array, up: Array, cell: float) -> Array:
        """How much of cells at (right, up) the letter covers, 0 to 1."""
        x, y = np.array(CORNERS).T
        x, y = self.right - x * (self.width - self.stroke), self.up + y * (self.height - self.stroke)
        away = np.full(right.shape, np.inf)
        for ends in zip(pairwise(x), pairwise(y), strict=True):
            # Out of the line between both ends, the further of across and up, as strokes have square ends.
            out = [np.maximum(min(e) - at, at - max(e)) for e, at in zip(ends, (right, up), strict=True)]
            away = np.minimum(away, np.maximum(np.maximum(*out), 0.0))
        return np.clip((self.stroke / 2 - away) / cell + 0.5, 0.0, 1.0)

    def depth_at(self, right: Array, up: Array) -> Array:
        """Depth of the plate's plane, m."""
        return self.depth + self.lean_right * (right - self.right) + self.lean_up * (up - self.up)

    def arrivals(self, side: float, bins: int, bin_s: float) -> Array:
        """(row, column, bin) light of three bounces at each point of the scan, without a pulse, in any unit: each
        cell dA of a diffuse plate gives cos⁴ / r⁴ dA, 2 r / c after the wall is lit."""
        cell = side / 48
        at = (np.arange(48) + 0.5) * cell - side / 2
        right, up = (of.ravel() for of in np.meshgrid(at, at))
        cover = self.cover(right, up, cell)
        right, up, cover = right[cover > 0], up[cover > 0], cover[cover > 0]
        depth = self.depth_at(right, up)
        points = grid(side).reshape(-1, 3)
        away = np.sqrt((points[:, 1:2] + right) ** 2 + (points[:, 2:] - up) ** 2 + depth**2)
        light = cover * depth**4 / away**8
        place = 2 * away / (SPEED_OF_LIGHT_M_PER_S * bin_s)
        whole = np.minimum(place.astype(np.int64), bins - 2)
        row = np.arange(len(points))[:, None] * bins
        share = place - whole
        flat = np.bincount((row + whole).ravel(), (light * (1 - share)).ravel(), len(points) * bins)
        flat += np.bincount((row + whole + 1).ravel(), (light * share).ravel(), len(points) * bins)
        return flat.reshape(POINTS, POINTS, bins)


@dataclass(frozen=True)
class Real:
    """A real scan. fine : (row, column, bin) counts of 2 × 2 points each, bins of `FINE_S`. side : of the wall, m."""

    fine: Array
    side: float

    @classmethod
    def read(cls, path: Path) -> Real:
        """A scan of 64 × 64 points and 2048 bins of 4 ps."""
        captured, _ = read_capture(path, "mat", Stated(ImportOptions(bin_width_ps=4.0)))
        recording = captured.first
        counts = recording.values.reshape(POINTS, 2, POINTS, 2, -1, round(FINE_S / 4e-12)).sum(axis=(1, 3, 5))
        return cls(counts.astype(np.float64), float(np.ptp(recording.laser_points[:, 0])))

    @property
    def counts(self) -> Array:
        """(row, column, bin) in the network's bins."""
        return self.fine.reshape(POINTS, POINTS, BINS, -1).sum(axis=3)

    def pulse(self, response: Array) -> tuple[Array, int]:
        """The pulse in bins of `FINE_S`, and which of them is its peak: what follows the peak is the scan's own
        direct light, which the file begins with; what comes before it is the laboratory's response."""
        floor = self.fine[..., -100:].mean()
        tail = self.fine.mean(axis=(0, 1))[: round(2.4e-9 / FINE_S)] - floor
        top, each = int(response.argmax()), round(FINE_S / 8e-12)
        before = 6
        rise = response[top - before * each : top].reshape(before, each).mean(axis=1) / response[top]
        return np.concatenate([rise * tail[0], np.maximum(tail, 0.0)]), before


def letter_of(scan: Real, response: Array) -> tuple[Letter, float]:
    """The S whose light of three bounces explains a scan best (least squares, with a floor and the direct light's
    tail), and the share of the variance over the scan that it explains."""
    pulse, before = scan.pulse(response)
    bins = scan.fine.shape[2]
    window = slice(round(2.9e-9 / FINE_S), round(5.5e-9 / FINE_S))
    seconds = (np.arange(bins) + 0.5) * FINE_S
    direct = scan.fine[..., :40].sum(axis=2)
    fading = (direct / direct.mean())[..., None] * np.exp(-seconds / 1e-9)
    measured = scan.fine[..., window].ravel()
    spectrum = np.fft.rfft(pulse, 2 * bins)

    def fitted(values: Array) -> tuple[Array, Array]:
        light = Letter(*values).arrivals(scan.side, bins, FINE_S)
        spread = np.fft.irfft(np.fft.rfft(light, 2 * bins) * spectrum, 2 * bins)[..., before : before + bins]
        columns = [part[..., window].ravel() for part in (spread, np.ones_like(fading), fading)]
        design = np.stack(columns, axis=1)
        return design, np.linalg.lstsq(design, measured, rcond=None)[0]

    def misfit(values: Array) -> float:
        if min(values[2:5]) < 0.02 or values[4] > 0.4 * values[3] or values[5] < 0.2:
            return float("inf")
        design, factors = fitted(values)
        return float(((design @ factors - measured) ** 2).mean())

    start = np.array(START)
    simplex = np.concatenate([start[None], start + np.diag([0.03, 0.03, 0.05, 0.05, 0.02, 0.015, 0.05, 0.05])])
    options = {"initial_simplex": simplex, "maxfev": EVALUATIONS, "xatol": 2e-4, "fatol": 1e-6}
    found = scipy.optimize.minimize(misfit, start, method="Nelder-Mead", options=options)
    return Letter(*found.x.tolist()), 1 - found.fun / float(measured.var())


def scans_of(
    scenes: list[tuple[Array, NDArray[np.bool_], Array, float]], response: Array, parts: Simulation, draws: int,
    first: int, pool: Executor,
) -> Scans:  # fmt: skip
    """Each scene, drawn several times; `first` is the seed of the first."""
    repeated = [scene for scene in scenes for _ in range(draws)]
    light, mask, depth, side = zip(*repeated, strict=True)
    make = partial(drawn_volumes, response, parts)
    volumes = list(pool.map(make, light, side, range(first, first + len(repeated)), chunksize=8))
    relative = np.stack([d / s for d, s in zip(depth, side, strict=True)])
    some, middle = zip(*map(about_brightest, volumes), strict=True)
    return Scans(
        torch.tensor(middle, dtype=torch.float32), torch.from_numpy(np.stack(some)),
        np.stack([volume.max(axis=1) for volume in volumes]).astype(np.float64) ** 2,
        torch.from_numpy(np.stack(mask)).float(), torch.from_numpy(relative.astype(np.float32)),
    )  # fmt: skip


def drawn_volumes(response: Array, parts: Simulation, light: Array, side: float, seed: int) -> NDArray[np.float32]:
    """The volumes of one draw of a simulated scene."""
    return volumes_of(counts_of(light, response, parts, seed), side)


def backprojection(counts: Array, side: float) -> Array:
    """(LAYERS, row, column) filtered backprojection."""
    points = grid(side).reshape(-1, 3)
    places = np.broadcast_to(grid(side), (LAYERS, POINTS, POINTS, 3)) + layers(side)[:, None, None, None] * (1, 0, 0)
    every = np.arange(len(points))
    signal = whitened(counts.reshape(len(points), -1))
    scan = Scan(signal, points, points, every, every, np.zeros(len(points)), BIN_S * SPEED_OF_LIGHT_M_PER_S)
    total = backprojected(scan, places.reshape(-1, 3)).reshape(LAYERS, POINTS, POINTS)
    return np.maximum(-gaussian_laplace(total, 1.0), 0.0)


def read_off(volume: Array, side: float, share: float) -> tuple[NDArray[np.bool_], Array]:
    """(row, column) where a volume's brightest layer has this share of the brightest voxel, and that layer's depth in
    sides of the wall."""
    bright = volume.max(axis=0)
    return bright >= share * bright.max(), layers(side)[volume.argmax(axis=0)] / side


def overlap_at(share: float, brightness: Array, truth: NDArray[np.bool_]) -> float:
    """Mean overlap of silhouettes that are as bright as that, (n, row, column)."""
    return float(np.mean([overlap(each >= share, mask) for each, mask in zip(brightness, truth, strict=True)]))


def best_share(brightness: Array, truth: NDArray[np.bool_]) -> float:
    """Of `SHARES`, the one with the largest mean overlap over scans (n, row, column)."""
    return float(SHARES[np.argmax([overlap_at(share, brightness, truth) for share in SHARES])])


def classical(scan: Real, truth: NDArray[np.bool_] | None) -> dict[str, tuple[NDArray[np.bool_], Array]]:
    """Method → silhouette and depth; the brightness that counts as silhouette is the one with the largest overlap
    with the truth, or half of the largest where there is none."""
    found = {}
    for method, volume in zip(METHODS, volumes_of(scan.counts, scan.side).astype(np.float64) ** 2, strict=True):
        share = 0.5 if truth is None else best_share(volume.max(axis=0)[None], truth[None])
        found[method] = read_off(volume, scan.side, share)
    return found


Answer = tuple[NDArray[np.bool_], Array]
"""Silhouette (row, column), and depth (row, column) in sides of the wall."""


@dataclass(frozen=True)
class Found:
    """What was found of the real S and the real chart.

    letter, explained : the S as its light tells, and the share of the variance that it explains. outline : (row,
    column). scans : name → scan. answers : name of a scan → method → answer. networks : effect left out → name of a
    scan → an answer for each seed. shares : method → brightness that counts as silhouette, best on the simulated
    scenes trained on. common : scan → method → answer with that brightness. unseen : method → overlap on simulated
    scenes kept back, for each seed. unseen_depth : the network's median error there, sides of the wall.
    """

    letter: Letter
    explained: float
    outline: NDArray[np.bool_]
    scans: dict[str, Real]
    answers: dict[str, dict[str, Answer]]
    networks: dict[str, dict[str, list[Answer]]]
    shares: dict[str, float]
    common: dict[str, dict[str, Answer]]
    unseen: dict[str, list[float]]
    unseen_depth: float

    def plane_m(self, name: str) -> float:
        """Depth of the plate in a scan: the S's from the fit, the chart's as its file is named."""
        return self.letter.depth if name == LETTER else CHART_M

    def depth_m(self, name: str, answer: Answer) -> float:
        """Median depth of an answer's silhouette, m; NaN where it has none."""
        mask, depth = answer
        return float(np.median(depth[mask])) * self.scans[name].side if mask.any() else float("nan")


def outline_of(letter: Letter, side: float) -> NDArray[np.bool_]:
    """(row, column) points of the scan that the letter covers by half and more."""
    points = grid(side)
    return letter.cover(-points[..., 1], points[..., 2], side / POINTS) >= 0.5


def kept_back(network: Predictor, scans: Scans) -> tuple[float, float]:
    """Mean overlap, and median error of the median depth, on scenes not trained on."""
    with torch.no_grad():
        logit, depth = network(scans.volume)
    truth, mask = scans.mask.numpy() > 0, logit.numpy() > 0
    off = (depth + scans.middle[:, None, None] - scans.depth).double().numpy()
    each = [abs(np.median(error[where])) for error, where in zip(off, truth, strict=True) if where.any()]
    return float(np.mean([overlap(m, t) for m, t in zip(mask, truth, strict=True)])), float(np.median(each))


def compared(folder: Path, scenes: int, epochs: int, seeds: int, workers: int) -> Found:
    """Simulate, train, and run on the real scans."""
    response = np.load(folder / IRF).astype(np.float64)
    scans = {name: Real.read(folder / name) for name in (LETTER, CHART)}
    letter, explained = letter_of(scans[LETTER], response)
    outline = outline_of(letter, scans[LETTER].side)
    answers = {name: classical(scan, outline if name == LETTER else None) for name, scan in scans.items()}
    volumes = {name: volumes_of(scan.counts, scan.side) for name, scan in scans.items()}
    networks: dict[str, dict[str, list[Answer]]] = {}
    shares: dict[str, float] = {}
    unseen: dict[str, list[float]] = {}
    unseen_depth = float("nan")
    with several(workers) as pool:
        kept = list(pool.map(partial(simulated, retro=True), range(scenes, scenes + max(scenes // 4, 1))))
        simulations = {
            retro: list(pool.map(partial(simulated, retro=retro), range(scenes))) for retro in (True, False)
        }
        for name, parts in LEFT_OUT.items():
            given = scans_of(simulations[parts.retro], response, parts, DRAWS, 0, pool)
            each = list(pool.map(partial(trained, given, epochs=epochs), range(seeds)))
            networks[name] = {of: [said(network, volume) for network in each] for of, volume in volumes.items()}
            if name == WHOLE:
                new = scans_of(kept, response, parts, 1, DRAWS * scenes, pool)
                for i, method in enumerate(METHODS):
                    shares[method] = best_share(given.brightness[:, i], given.mask.numpy() > 0)
                    unseen[method] = [overlap_at(shares[method], new.brightness[:, i], new.mask.numpy() > 0)]
                scores = [kept_back(network, new) for network in each]
                unseen[NETWORK] = [score for score, _ in scores]
                unseen_depth = float(np.mean([off for _, off in scores]))
    common = {
        name: {
            method: read_off(volumes[name][i].astype(np.float64) ** 2, scan.side, shares[method])
            for i, method in enumerate(METHODS)
        }
        for name, scan in scans.items()
    }
    return Found(letter, explained, outline, scans, answers, networks, shares, common, unseen, unseen_depth)


def tables(found: Found) -> str:
    """Two tables: depth and overlap by method, and what it costs to leave an effect out of the simulation."""
    lines = [
        f"the S by its light: {found.letter} (m), {100 * found.explained:.0f} % of the variance",
        f"simulated scenes kept back: depth {100 * found.unseen_depth:.1f} % of the side",
        "thresholds of the simulated scenes: " + ", ".join(f"{m} {share:.2f}" for m, share in found.shares.items()),
        "",
        "| | simulated, kept back: overlap | S: overlap | S: depth (m) | chart: depth (m) |",
        "|---|---:|---:|---:|---:|",
        f"| truth | 1 | 1 | {found.plane_m(LETTER):.3f} | {found.plane_m(CHART):.3f} |",
    ]
    for method in METHODS:
        for title, of, unseen in (
            (f"{method}, threshold of simulated scenes", found.common, f"{found.unseen[method][0]:.2f}"),
            (f"{method}, threshold chosen with the S's outline (chart: half)", found.answers, ""),
        ):
            letter, chart = (of[name][method] for name in (LETTER, CHART))
            depths = f"{found.depth_m(LETTER, letter):.3f} | {found.depth_m(CHART, chart):.3f}"
            lines.append(f"| {title} | {unseen} | {overlap(letter[0], found.outline):.2f} | {depths} |")
    network = found.unseen[NETWORK]
    lines.append(_row(found, f"{NETWORK} | {np.mean(network):.2f} ± {np.std(network):.2f}", WHOLE))
    lines += [
        "",
        "| left out of the simulation | S: overlap | S: depth (m) | chart: depth (m) |",
        "|---|---:|---:|---:|",
    ]
    lines += [_row(found, name, name) for name in LEFT_OUT]
    return "\n".join(lines)


def _row(found: Found, title: str, left_out: str) -> str:
    """Mean ± standard deviation over the seeds."""
    answers = found.networks[left_out]
    columns = [[overlap(mask, found.outline) for mask, _ in answers[LETTER]]]
    columns += [[found.depth_m(name, each) for each in answers[name]] for name in (LETTER, CHART)]
    cells = (f"{np.mean(of):.{n}f} ± {np.std(of):.{n}f}" for of, n in zip(columns, (2, 3, 3), strict=True))
    return f"| {title} | " + " | ".join(cells) + " |"


def draw(found: Found, out: Path) -> None:
    """Truth and answers for both scans."""
    text = (
        "Depth where a method sees something, of two real scans (O'Toole et al. 2018), as somebody sees it who faces "
        "the wall: letters are mirrored. Above each: its median, and the overlap with the outline, the S-shaped "
        "plate whose light explains the scan best. What is seen is what is bright enough: for the S as bright as "
        "gives the largest overlap, for the chart half of the brightest; networks decide themselves. Diffuse alone: "
        "trained on simulations without retroreflection."
    )
    names = {LETTER: "diffuse S", CHART: "retroreflecting chart"}
    with house_style():
        title = "Behind a corner: a network trained on simulated scans, run on real ones"
        figure, grid_ = captioned([5.4], text, title)
        panels = figure.add_subfigure(grid_[0, 0]).subplots(len(names), len(METHODS) + 2)
        for row, (name, label) in enumerate(names.items()):
            answers = {**found.answers[name], NETWORK: found.networks[WHOLE][name][0]}
            answers["network, diffuse alone"] = found.networks["retroreflection"][name][0]
            middle = found.plane_m(name)
            for panel, (method, (mask, depth)) in zip(panels[row], answers.items(), strict=True):
                off = np.where(mask, 100 * (depth * found.scans[name].side - middle), np.nan)
                shown = panel.imshow(off, cmap="viridis_r", vmin=-2, vmax=2)
                if name == LETTER:
                    panel.contour(found.outline, [0.5], colors="#D55E00", linewidths=0.8)
                framed(panel)
                score = f", {overlap(mask, found.outline):.2f}" if name == LETTER else ""
                above = f"{method}\n" if row == 0 else ""
                panel.set_title(f"{above}{found.depth_m(name, (mask, depth)):.3f} m{score}", fontsize=9)
            panels[row, 0].set_ylabel(f"{label},\nat {middle:.3f} m")
        place = {"ax": panels.ravel().tolist(), "location": "bottom", "shrink": 0.5, "aspect": 40}
        panels[0, 0].figure.colorbar(shown, **place, extend="both", label="behind the plate (cm)")
        save_png(figure, out)


def main() -> None:
    """Print the tables and draw the picture."""
    arguments = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    arguments.add_argument("folder", type=Path)
    arguments.add_argument("out", type=Path)
    for name, default in (("scenes", 160), ("epochs", 32), ("seeds", 3), ("workers", 2)):
        arguments.add_argument(f"--{name}", type=int, default=default)
    asked = arguments.parse_args()
    missing = [name for name in (IRF, LETTER, CHART) if not (asked.folder / name).is_file()]
    if missing:
        print(f"{asked.folder}: {', '.join(missing)} missing; nothing is trained. The head of this script says where "
              "the files come from")  # fmt: skip
        return
    found = compared(asked.folder, asked.scenes, asked.epochs, asked.seeds, asked.workers)
    print(tables(found))
    draw(found, asked.out)


if __name__ == "__main__":
    main()
