"""What proofs of clear sight save: `datagen bench occlusion [CONFIG …]`.

Processor seconds of `simulate` with every connection asked by a shadow ray (`on`), with proofs and rays for what they
leave (`auto`, the same transient), and with none asked (`off`: the most that any proof could save, but light passes
through occluders); and the share of connections proven.
"""

from __future__ import annotations

import statistics
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import click
import numpy as np
import trimesh

from datagen.bench.peers import grid_points, point_capture
from datagen.bench.problems import DEVICE, WALL, room_with_sphere, tessellated_room
from datagen.capture import capture_for
from datagen.config import load_config
from datagen.exit_status import guarded
from datagen.records import Accuracy, Capture, Lambertian, Laser, Part, Rectangle, Scene, Sensor, TimeAxis
from datagen.scene import generate_scene
from datagen.store.environment import cores, processor
from datagen.transport import simulate
from datagen.units import time_from_path

Way = Literal["on", "auto", "off"]
WAYS: tuple[Way, ...] = ("on", "auto", "off")


@dataclass(frozen=True)
class Case:
    title: str
    scene: Scene
    capture: Capture
    accuracy: Accuracy


@dataclass(frozen=True)
class Row:
    """seconds : median processor seconds by way. proven : share of connections. difference : ‖auto − on‖ / ‖on‖.
    added : energy of `off` over that of `on`, less one."""

    title: str
    triangles: int
    seconds: dict[Way, float]
    proven: float
    difference: float
    added: float


def from_config(path: str) -> Case:
    """The first scene of a configuration, at its own accuracy."""
    config = load_config(path)
    scene = generate_scene(config.scene, config.seed, 0)
    return Case(Path(path).stem, scene, capture_for(config, scene), config.transport.accuracy())


def own_cases() -> list[Case]:
    """A scan by all pixels, a room with a mesh, and nothing but a plate before a wall."""
    axis = TimeAxis(512, time_from_path(20.0 / 512), 0.0, "wall")
    laser = Laser(DEVICE, np.array([[0, -0.8, 1.4]]))
    room = tessellated_room(24)
    sixteen = Sensor.grid(DEVICE, WALL.center, WALL.right, WALL.up, 16, 16)
    four = Sensor.grid(DEVICE, WALL.center, WALL.right, WALL.up, 4, 4)
    scan = Rectangle.of((0, 0, 0), (0, 0.35, 0), (0, 0, 0.35))
    plate = Rectangle.of((1.0, 0, 0), (0, -0.25, 0), (0, 0, 0.25))
    points = grid_points(scan, 16, 16)
    bare = Scene.from_parts([_part("wall", scan), _part("plate", plate)])
    short = TimeAxis(300, time_from_path(0.003), time_from_path(1.95), "wall")
    at_plate = point_capture(scan, points, np.array([0.5, 0.0, 0.0]), points, short, confocal=True)
    return [
        Case("room, 16 × 16 pixels", room, Capture(laser, sixteen, axis), Accuracy(4096, 1, 4, 2)),
        Case(
            "room with a mesh, 4 × 4", room_with_sphere(70_000), Capture(laser, four, axis), Accuracy(65_536, 4, 4, 4)
        ),
        Case("bare plate, 16 × 16 confocal", bare, at_plate, Accuracy(2048, 1, 3, 1)),
    ]


def measure(case: Case, repeats: int) -> Row:
    """Run a case each way in turn, `repeats` times after once for compilation."""
    seconds: dict[Way, list[float]] = {way: [] for way in WAYS}
    found = {}
    for repeat in range(repeats + 1):
        for way in WAYS:
            began = time.process_time()
            accuracy = replace(case.accuracy, occlusion=way)
            found[way] = simulate(case.scene, case.capture, accuracy, 1, split_parts=False)
            if repeat:
                seconds[way].append(time.process_time() - began)
    asked, proven, off = (found[way].total for way in WAYS)
    rays = found["auto"].rays
    return Row(
        case.title,
        len(case.scene.triangles),
        {way: statistics.median(times) for way, times in seconds.items()},
        rays["proven"] / max(1, rays["proven"] + rays["asked"]),
        float(np.linalg.norm(proven - asked) / np.linalg.norm(asked)),
        float(off.sum() / asked.sum() - 1),
    )


HEAD = """| scene | triangles | proven | all asked | proofs | none asked | proofs / asked | auto − on | off: light |
|---|---:|---:|---:|---:|---:|---:|---:|---:|"""


def line(row: Row) -> str:
    """A row of the table under `HEAD`, in markdown."""
    on, auto, off = (row.seconds[way] for way in WAYS)
    cells = [
        row.title, str(row.triangles), f"{row.proven:.0%}", f"{on:.3f} s", f"{auto:.3f} s", f"{off:.3f} s",
        f"{auto / on:.2f}", f"{row.difference:.0e}", f"{row.added:+.2%}",
    ]  # fmt: skip
    return f"| {' | '.join(cells)} |"


def _part(name: str, surface: Rectangle) -> Part:
    mesh = trimesh.Trimesh(surface.corners, [[0, 1, 2], [0, 2, 3]], process=False)
    return Part(name, mesh, Lambertian(0.7), "structure" if name == "wall" else "object")


@click.command()
@click.argument("configs", nargs=-1)
@click.option("--repeats", default=3, show_default=True, type=click.IntRange(1), help="Runs behind each median.")
def main(configs: tuple[str, ...], repeats: int) -> None:
    """Print what proofs of clear sight save, for the first scene of each of CONFIGS and three rooms of our own."""
    click.echo(f"Processor seconds, medians of {repeats}; {processor()}, {cores()} cores\n")
    cases = [from_config(path) for path in configs] + own_cases()
    click.echo(HEAD)
    for case in cases:
        click.echo(line(measure(case, repeats)))


if __name__ == "__main__":
    raise SystemExit(guarded(main))
