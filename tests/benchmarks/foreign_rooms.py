"""Seconds and errors in rooms with meshes that are not ours, and in ready configurations that take long.

`python tests/benchmarks/foreign_rooms.py [FOLDER]` prints two tables, some minutes each. The closed room of 4 × 3 ×
2.5 m holds two open meshes of some thousand triangles: a part of a dented ball and a torus that is cut open, or
`spot.obj` and `teapot.obj` of a folder. An error is that of the whole transient against a run of another seed to a
quarter of the target.
"""

from __future__ import annotations

import statistics
import sys
from functools import partial
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import numpy as np
import trimesh
from benchmarks.other_renderers import grid_points

from datagen.bench.measuring import machine, markdown, percent, processor_seconds
from datagen.config import load_config
from datagen.pipeline import simulate_sample
from datagen.records import Accuracy, Capture, Lambertian, Laser, Part, Rectangle, Scene, Sensor, TimeAxis
from datagen.records.arrays import l2_norm
from datagen.transport import simulate

CONFIGS = Path(__file__).parents[2] / "configs"
REPEATS, TARGET, FINER = 3, 0.02, 4
SIZE_M = np.array([4.0, 3.0, 2.5])
DEVICE = (3.6, -1.2, 1.3)
SCANNED = Rectangle.of((0.0, 0.0, 1.25), (0.0, 0.7, 0.0), (0.0, 0.0, 0.7))
ASKED_S = {
    "16 × 16 confocal, 3 bounces": 0.6,
    "8 × 8 confocal, 3 + 4 bounces": 1.2,
    "3 × 3 × 8 × 8, 3 + 4 bounces": 4.0,
}
"""What is simulated, and the processor seconds that it should take at most."""
READY = {"rough_relay_walls": range(9001, 9005), "spad_array": range(9001, 9005), "confocal_scan": range(9001, 9011)}


def open_meshes(folder: Path | None) -> list[trimesh.Trimesh]:
    """Two open meshes about the origin, 0.6 m large."""
    if folder is not None:
        found = [trimesh.load(folder / name, force="mesh", process=False) for name in ("spot.obj", "teapot.obj")]
    else:
        ball, torus = trimesh.creation.icosphere(5), trimesh.creation.torus(1.0, 0.4, 64, 48)
        ball.vertices *= 1.0 + 0.1 * np.sin(9.0 * ball.vertices[:, :1]) * np.sin(7.0 * ball.vertices[:, 1:2])
        for mesh, kept in ((ball, ball.triangles_center[:, 2] > -0.3), (torus, torus.triangles_center[:, 0] > -0.5)):
            mesh.update_faces(kept)
        found = [ball, torus]
    for mesh in found:
        mesh.apply_translation(-mesh.bounds.mean(axis=0))
        mesh.apply_scale(0.6 / np.ptp(mesh.bounds, axis=0).max())
    return found


def room(meshes: list[trimesh.Trimesh]) -> Scene:
    """A closed room with the meshes in it, all of it matt."""
    middle, (x, y, z) = SIZE_M * [0.5, 0.0, 0.5], np.diag(SIZE_M / 2)

    def wall(at: np.ndarray, right: np.ndarray, up: np.ndarray) -> trimesh.Trimesh:
        corners = [at - right - up, at + right - up, at + right + up, at - right + up]
        return trimesh.Trimesh(corners, [[0, 1, 2], [0, 2, 3]], process=False)

    parts = [Part("relay_wall", wall(middle - x, y, z), Lambertian(0.7), "relay_wall")]
    for k, (at, right, up) in enumerate(((x, y, z), (y, x, z), (-y, x, z), (z, x, y), (-z, x, y))):
        parts.append(Part(f"wall {k}", wall(middle + at, right, up), Lambertian(0.5), "structure"))
    for k, (mesh, place) in enumerate(zip(meshes, ((1.6, 0.6, 0.5), (2.2, -0.5, 0.9)), strict=True)):
        parts.append(Part(f"mesh {k}", mesh.copy().apply_translation(place), Lambertian(0.6)))
    return Scene.from_parts(parts)


def captures() -> list[tuple[Capture, int]]:
    """The captures of `ASKED_S`, confocal with pixels of 2 cm, exhaustive with pixels of 20 cm; and their bounces."""
    axis, corners = TimeAxis(512, 1e-10, 0.0, "wall"), np.array([[0, -1, -1], [0, 1, -1], [0, 1, 1], [0, -1, 1]])

    def confocal(side: int) -> Capture:
        points = grid_points(SCANNED, side, side)
        return Capture(Laser(DEVICE, points), Sensor(DEVICE, points[:, None] + 0.01 * corners), axis, "confocal")

    pixels = grid_points(SCANNED, 8, 8)[:, None] + 0.1 * corners
    exhaustive = Capture(Laser(DEVICE, grid_points(SCANNED, 3, 3)), Sensor(DEVICE, pixels), axis)
    return [(confocal(16), 3), (confocal(8), 4), (exhaustive, 4)]


def rooms_table(folder: Path | None) -> str:
    """Processor seconds and error of each capture of the room."""
    scene, rows = room(open_meshes(folder)), []
    for (name, asked_s), (capture, bounces) in zip(ASKED_S.items(), captures(), strict=True):
        accuracy = Accuracy(target=TARGET, max_bounces=bounces)
        call = partial(simulate, scene, capture, accuracy)
        call(0)  # which may compile kernels
        runs = [processor_seconds(partial(call, seed)) for seed in range(1, REPEATS + 1)]
        truth = simulate(scene, capture, Accuracy(target=TARGET / FINER, max_bounces=bounces), seed=99).total
        errors = [l2_norm(run.total - truth) / l2_norm(truth) for run, _ in runs]
        claims = [run.relative_error for run, _ in runs]
        way = ", ".join(f"{component} {way}" for component, way in runs[0][0].spend.way.items())
        seconds = statistics.median(seconds for _, seconds in runs)
        rows.append([name, f"{asked_s:g}", f"{seconds:.2g}", percent(max(errors)), percent(max(claims)), way])
    return markdown(["scan", "asked s", "s (median)", "error (worst)", "claimed", "way"], rows, words=1)


def ready_table(scenes: dict[str, range]) -> str:
    """Processor seconds a scene of ready configurations, the whole chain."""
    rows = []
    for name, indices in scenes.items():
        config = load_config(CONFIGS / f"{name}.yaml")
        simulate_sample(config, indices[0])
        seconds = [processor_seconds(partial(simulate_sample, config, index))[1] for index in indices]
        middle, high = statistics.median(seconds), float(np.quantile(seconds, 0.95))
        rows.append([name, str(len(seconds)), f"{middle:.2g}", f"{high:.2g}", f"{max(seconds):.2g}"])
    return markdown(["configuration", "scenes", "s (median)", "95th", "worst"], rows, words=1)


def main() -> None:
    """Both tables."""
    folder = Path(sys.argv[1]) if len(sys.argv) > 1 else None
    print(f"{machine()}\n\n{rooms_table(folder)}\n\n{ready_table(READY)}")


if __name__ == "__main__":
    main()
