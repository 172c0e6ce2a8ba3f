"""Sequences: what a frame costs, whether energies and claims of changes hold, and the floor of changes.

    python tests/benchmarks/sequences.py claims --rooms 8      # true over claimed errors of changes
    python tests/benchmarks/sequences.py energies --rooms 5     # frames over the same scenes simulated by themselves
    python tests/benchmarks/sequences.py floors --rooms 6       # σ of changes, and their floor
    python tests/benchmarks/sequences.py speed --rooms 4        # seconds a frame over those of the first
    python tests/benchmarks/sequences.py claims --movers box glossy

Random rooms of five layouts with a pillar or a box that stands, and something that walks at 1 m/s: a box, a mesh of
the library, somebody in light or dark clothes, a glossy box, or two of them; 16 × 16 confocal points, 512 bins of
100 ps, 16 frames at 10 a second, 2 %.

The truth of a change is a run *of the difference* with another seed and elements and cells that are twelve times and
twice as fine; finer runs of each frame by itself would have pilots, and so errors, of their own. Energies are those
of the mover's own light, and of the light of all that stands less its shadow, over those of scenes that are simulated
by themselves to 0.3 %, of frames whose points all have one time.
"""

from __future__ import annotations

import argparse
import sys
import warnings
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any
from unittest import mock

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import numpy as np

import datagen as dg
from datagen.bench.measuring import machine, markdown, processor_seconds
from datagen.config import DatasetConfig, config_from_mapping
from datagen.errors import InputError
from datagen.pipeline import simulate_sample
from datagen.records import SequenceLight
from datagen.records.arrays import Floats, l2_norm
from datagen.transport import shared_light
from datagen.transport.sequences import light_of_sequence, times_of

WALK = {"kind": "walk", "speed_m_s": 1.0}
LAYOUTS = ("l_corridor", "t_corridor", "corridor_room", "doorway_room", "z_corridor")
CLOTHES = {"person light": "white_cotton", "person dark": "black_cotton"}
SIDE, TARGET = 16, 0.02
FINER, FINEST_SIDE = 12.0, 120
"""How much finer the elements of a reference are, and the most cells along a side that memory takes."""
FINE = dg.Accuracy(target=0.003)
"""Of the scenes by themselves that energies are held against."""
PAIRS = (2, 3, 7, 8, 12, 13)
"""Frames of three pairs."""


def contents(mover: str) -> list[dict[str, Any]]:
    """The contents of a room with a mover, which is called `mover`; of two, with `other`."""
    if mover in CLOTHES:
        one = {"kind": "library", "classes": ["mannequin"], "material": [CLOTHES[mover]]}
    elif mover == "mesh":
        one = {"kind": "library", "classes": ["chair", "vase", "floor_lamp"]}
    elif mover == "glossy":
        one = {"kind": "box", "albedo": 0.6, "brdf": {"kind": "phong", "specular": 0.6, "exponent": 30}}
    else:
        one = {"kind": "box", "albedo": {"uniform": [0.3, 0.9]}}
    found = [{**one, "name": "mover", "motion": WALK}, {"kind": "pillar"}]
    return [*found, {"kind": "box", "name": "other", "motion": WALK}] if mover == "two" else found


MOVERS = ("box", "mesh", *CLOTHES, "glossy", "two")


def config_of(mover: str, layout: str, order: str = "raster") -> DatasetConfig:
    """The configuration of rooms of a layout in which something walks."""
    return config_from_mapping({
        "name": "sequences", "seed": 640, "sequence": {"frames": 16, "rate_hz": 10, "order": order},
        "scene": {"layout": {"kind": layout}, "contents": contents(mover)},
        "capture": {"scan": {"rows": SIDE, "columns": SIDE}, "time": {"bins": 512, "bin_width_ps": 100}},
        "transport": {"target": TARGET}, "detector": {"cycles": 3900, "photons_per_pulse": 2.0e9},
        "store": {"fields": ["histogram", "transient", "objects"]},
    })  # fmt: skip


def rooms(mover: str, count: int, order: str = "raster") -> Iterator[tuple[str, DatasetConfig, int]]:
    """Name, configuration and number of `count` rooms in which the mover finds a way; each of another layout than the
    one before."""
    found = number = 0
    while found < count and number < 4 * count:
        layout = LAYOUTS[number % len(LAYOUTS)]
        config = config_of(mover, layout, order)
        try:
            dg.scene_for(config, number)
        except InputError as error:
            print(f"{mover}, {layout} {number}: {str(error)[:90]}", file=sys.stderr)
        else:
            yield f"{layout} {number}", config, number
            found += 1
        number += 1


def room_of(config: DatasetConfig, number: int) -> tuple[dg.Scene, dg.Capture]:
    scene = dg.scene_for(config, number)
    return scene, dg.capture_for(config, scene, config.seed, number)


def fine_moving_light(
    scene: dg.Scene, capture: dg.Capture, times: Floats, accuracy: dg.Accuracy, like: SequenceLight
) -> Floats:
    """What moves of the light (F, L, P, T), from elements that are `FINER` times as fine, and another seed."""
    effort = shared_light._effort

    def finer(*given: Any) -> shared_light.Effort:
        own = effort(*given)
        side = min(2 * own.side, FINEST_SIDE)
        return shared_light.Effort([delta / FINER for delta in own.delta], own.error / FINER**0.7, side)

    static = shared_light.static_of(scene, capture, times[None], accuracy, TARGET, 77)
    assert static is not None
    with mock.patch.object(shared_light, "_effort", finer):
        return shared_light.moving_light(static).light.reshape(like.moving.shape)


def claims(movers: Sequence[str], count: int) -> Iterator[str]:
    """True over claimed errors of changes."""
    rows, every = [], list[float]()
    for mover in movers:
        own, noise, of_rooms = list[float](), list[float](), 0
        for name, config, number in rooms(mover, count):
            scene, capture = room_of(config, number)
            assert config.clock is not None
            every_time, exposure_s = times_of(capture, config.clock, None)
            times, accuracy = every_time[list(PAIRS)], config.transport.accuracy()
            light = light_of_sequence(scene, [capture] * len(PAIRS), times, exposure_s, accuracy, 1)
            if light.samplers["primary"] != "shared cuts":
                yield f"{mover}, {name}: {light.samplers['primary']}"
                continue
            true = fine_moving_light(scene, capture, times, accuracy, light)
            of_rooms += 1
            for k in range(1, len(PAIRS), 2):
                due = true[k] - true[k - 1]
                if l2_norm(due) == 0:
                    continue
                own.append(l2_norm(light.change(k) - due) / light.change_errors[k])
                noise.append(l2_norm(light.change(k) - due) / l2_norm(due))
            yield f"{mover}, {name}: {', '.join(f'{ratio:.2f}' for ratio in own[-3:])}"
        every += own
        rows.append(_claims_row(mover, of_rooms, own, noise))
    rows.append(_claims_row("all", len(movers) * count, every, [np.nan]))
    yield markdown(["mover", "rooms", "changes", "true/claimed: median", "95 %", "largest", "true/change"], rows)


def _claims_row(name: str, of_rooms: int, ratios: Sequence[float], noise: Sequence[float]) -> list[str]:
    if not ratios:
        return [name, str(of_rooms), "0", *["–"] * 4]
    middle, most = np.quantile(ratios, [0.5, 0.95])
    of_change = "" if np.isnan(noise).all() else f"{np.median(noise):.3f}"
    return [name, str(of_rooms), str(len(ratios)), f"{middle:.2f}", f"{most:.2f}", f"{max(ratios):.2f}", of_change]


def energies(movers: Sequence[str], count: int, frames: int = 4) -> Iterator[str]:
    """Energies of frames over those of the same scenes simulated by themselves."""
    rows = []
    for mover in movers:
        own, rest = list[float](), list[float]()
        for name, config, number in rooms(mover, count, "together"):
            scene, capture = room_of(config, number)
            assert config.clock is not None
            every, exposure_s = times_of(capture, config.clock, 1e-6)
            times, accuracy = every[:: 16 // frames], config.transport.accuracy()
            light = light_of_sequence(scene, [capture] * len(times), times, exposure_s, accuracy, 1)
            for f, at in enumerate(times[:, 0]):
                due = dg.simulate(scene.at(float(at)), capture, FINE, 100 + f)
                moves, everything = [*scene.moving], due.total.sum()
                brought = sum(light.parts[name][f].sum() for name in moves)
                wanted = sum(due.parts[name].sum() for name in moves)
                if wanted > 0:
                    own.append(brought / wanted)
                rest.append((light.total(f).sum() - brought) / (everything - wanted))
            yield f"{mover}, {name}: own {np.mean(own[-frames:]):.4f}, rest {np.mean(rest[-frames:]):.4f}"
        rows.append([mover, str(len(rest)), _mean(own), _mean(rest)])
    yield markdown(["mover", "frames", "own light", "all else with its shadow"], rows)


def _mean(ratios: Sequence[float]) -> str:
    if len(ratios) < 2:
        return "–"
    return f"{np.mean(ratios):.4f} ± {np.std(ratios, ddof=1) / len(ratios) ** 0.5:.4f}"


def floors(movers: Sequence[str], count: int) -> Iterator[str]:
    """σ of changes and their floor, at 7.5 mW: medians over the frames of whole sequences."""
    rows = []
    for mover in movers:
        found = list[tuple[float, float]]()
        for name, config, number in rooms(mover, count):
            of = simulate_sample(config, number).parameters
            some = [(of[f"evidence.{m}.change"], of[f"evidence.{m}.change_floor"]) for m in ("mover", "other")
                    if f"evidence.{m}.change" in of]  # fmt: skip
            found += [(float(a), float(b)) for a, b in some]
            yield f"{mover}, {name}: {', '.join(f'{a:.2f} σ, floor {b:.2f}' for a, b in some)}"
        change, floor = np.array(found).T
        kept = (floor < np.maximum(0.5, 0.1 * change)).mean()
        rows.append([
            mover, str(len(found)), f"{np.median(change):.1f} ({change.min():.1f} … {change.max():.1f})",
            f"{np.median(floor):.2f} ({floor.min():.2f} … {floor.max():.2f})", f"{100 * kept:.0f} %",
        ])  # fmt: skip
    yield markdown(["mover", "sequences", "change, σ", "floor, σ", "below 0.5 σ or a tenth"], rows)


def speed(movers: Sequence[str], count: int) -> Iterator[str]:
    """Processor seconds of the first frame, and of each further one; medians of three runs."""
    rows = []
    for mover in movers:
        ratios, each = list[float](), list[float]()
        for name, config, number in rooms(mover, count):
            scene, capture = room_of(config, number)
            assert config.clock is not None
            accuracy, (times, exposure_s) = config.transport.accuracy(), times_of(capture, config.clock, None)
            of_runs = list[tuple[float, float]]()
            for seed in range(4):
                alone, every = (
                    processor_seconds(
                        partial(light_of_sequence, scene, [capture] * len(some), some, exposure_s, accuracy, seed)
                    )[1]
                    for some in (times[:1], times)
                )
                of_runs.append((alone, (every - alone) / (len(times) - 1)))
            # The first run compiles.
            first, more = np.median(of_runs[1:], axis=0)
            ratios.append(more / first)
            each.append(more)
            yield f"{mover}, {name}: {first:.3f} s, {more:.3f} s a frame, {more / first:.2f}"
        cells = f"{np.median(each):.3f}", f"{np.median(ratios):.2f}", f"{max(ratios):.2f}"
        rows.append([mover, str(len(each)), *cells])
    yield markdown(["mover", "rooms", "s a further frame", "over the first", "largest"], rows)


WHAT = {"claims": claims, "energies": energies, "floors": floors, "speed": speed}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("what", choices=WHAT)
    parser.add_argument("--rooms", type=int, default=4, help="rooms of each mover")
    parser.add_argument("--movers", nargs="+", choices=MOVERS, default=list(MOVERS))
    asked = parser.parse_args()
    print(machine(), flush=True)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for line in WHAT[asked.what](asked.movers, asked.rooms):
            print(line, flush=True)


if __name__ == "__main__":
    main()
