"""A hidden letter found again by y-tal, from three exported scans; see docs/exports.md.

python tests/benchmarks/y_tal.py build OUT           # three scans of one scene, exported; with datagen and h5py
python tests/benchmarks/y_tal.py reconstruct OUT     # filtered backprojection; with y-tal, which needs numpy < 2
python tests/benchmarks/y_tal.py draw OUT            # what was found beside what is there, and how far it is off
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np

SCANS = {"confocal": (16, 16), "single": (1, 16), "exhaustive": (4, 12)}
"""Laser points and pixels along each side; confocal: the same."""
BARS = (((0.10, 0.22, 0.80), (0.50, 0.12, 0.02)), ((0.10, -0.04, 0.80), (0.12, 0.40, 0.02)))
"""Centre and size of the bars of a T, metres: x and y along the wall z = 0."""
HALF_M, STEP_M = 0.75, 0.025


def build(out: Path) -> None:
    """Simulate and export the scans. Time begins after the light that comes straight from the wall."""
    import trimesh

    import datagen as dg
    from datagen.formats import export

    letter = trimesh.util.concatenate([trimesh.creation.box(size).apply_translation(at) for at, size in BARS])
    wall = trimesh.creation.box((2.4, 2.4, 0.02)).apply_translation((0, 0, -0.01))
    parts = [dg.Part("wall", wall, dg.Lambertian(0.9), "relay_wall"), dg.Part("T", letter, dg.Lambertian(0.9))]
    front = dg.Rectangle.of((0, 0, 0), (1.2, 0, 0), (0, 1.2, 0))
    scene = dg.Scene.from_parts(parts, relay_wall=front, hidden_bounds=[(-0.7, -0.7, 0.4), (0.7, 0.7, 1.2)])
    eye, time = (1.5, 0.0, 1.5), dg.TimeAxis(bins=448, width_s=16e-12, start_s=2.4e-9, origin="wall")
    for name, (lasers, pixels) in SCANS.items():
        sensor = dg.Sensor.grid(eye, (0, 0, 0), (HALF_M, 0, 0), (0, HALF_M, 0), pixels, pixels)
        middles = dg.Sensor.grid(eye, (0, 0, 0), (HALF_M, 0, 0), (0, HALF_M, 0), lasers, lasers).pixels.mean(axis=1)
        pairing: Any = "confocal" if name == "confocal" else "exhaustive"
        capture = dg.Capture(dg.Laser(eye, middles), sensor, time, pairing)
        plain = {"transport": {"max_bounces": 3, "samples": 4096}}
        dg.build_from([scene], out / f"{name}.zarr", capture, fields=("transient",), settings=plain)
        export(out / f"{name}.zarr", out / name, "tal")


def reconstruct(out: Path) -> None:
    """Filtered backprojection of each scan, in slabs to fit into memory; f-k migration of the confocal one."""
    import tal
    import tal.reconstruct.fk

    for name in SCANS:
        data = tal.io.read_capture(str(out / name / "scene-000000.hdf5"))
        data.H = tal.reconstruct.filter_H(data, filter_name="pf", wl_mean=0.2, wl_sigma=0.15, progress=False)
        low, high = np.array([-0.5, -0.5, 0.5]), np.array([0.7, 0.7, 1.1])
        volume = tal.reconstruct.get_volume_min_max_resolution(low, high, STEP_M)
        slabs = [volume[:, :, k : k + 2] for k in range(0, volume.shape[2], 2)]
        found = [np.abs(tal.reconstruct.bp.solve(data, slab, progress=False)) for slab in slabs]
        np.savez(out / f"{name}.npz", found=np.concatenate(found, axis=2), volume=volume)
    migrated = tal.io.read_capture(str(out / "confocal" / "scene-000000.hdf5"))
    points, step_m = migrated.sensor_grid_xyz, migrated.delta_t / 2
    found = np.abs(tal.reconstruct.fk.solve(migrated))
    k, i, j = np.unravel_index(found.argmax(), found.shape)
    print(f"f-k migration: brightest at x {points[i, j, 0]:.2f}, y {points[i, j, 1]:.2f}, z {k * step_m:.3f} m")


def draw(out: Path) -> None:
    """One picture, front and from above; the middle of all voxels above half of the brightest."""
    from datagen.report.style import captioned, house_style, save_png

    text = (
        "Above: as seen from the wall; below: from above, with the wall at z = 0. Brightness is that of the "
        "brightest voxel along the line of sight; the cross is the middle of all voxels brighter than half of the "
        "brightest, and blue is where the letter is."
    )
    middle = np.average([at for at, _ in BARS], axis=0, weights=[size[0] * size[1] for _, size in BARS])
    middle[2] -= BARS[0][1][2] / 2
    with house_style():
        figure, grid = captioned([3.6], text, "A letter T, and three reconstructions of it by y-tal")
        panels = figure.add_subfigure(grid[0, 0]).subplots(2, 1 + len(SCANS), height_ratios=[2, 1])
        _draw_panels(panels, middle, out)
        save_png(figure, out / "found.png")


def _draw_panels(axes: Any, middle: Any, out: Path) -> None:
    """What is there in the first column, what each scan shows in the others."""
    for column, (name, (lasers, pixels)) in enumerate(SCANS.items(), 1):
        with np.load(out / f"{name}.npz") as file:
            found, volume = file["found"], file["volume"]
        bright = np.where(found > 0.5 * found.max(), found, 0.0)
        place = np.average(volume.reshape(-1, 3), axis=0, weights=bright.ravel())
        off = 100 * (place - middle)
        print(
            f"{name}: off by x {off[0]:.1f}, y {off[1]:.1f}, z {off[2]:.1f} cm; {np.linalg.norm(off):.1f} cm in all"
        )
        scan = f"{pixels}²" if name == "confocal" else f"{lasers}² × {pixels}²"
        axes[0, column].set_title(f"{name}\n{scan}: {np.linalg.norm(off):.1f} cm off", fontsize=9)
        for row, other in enumerate((1, 2)):
            low, high = volume[0, 0, 0] - STEP_M / 2, volume[-1, -1, -1] + STEP_M / 2
            extent = (low[0], high[0], low[other], high[other])
            axes[row, column].imshow(found.max(axis=3 - other).T, origin="lower", extent=extent, cmap="inferno")
            axes[row, column].plot(place[0], place[other], "x", color="white", ms=9, mew=2)
            for at, size in BARS:
                corner = np.array(at) - np.array(size) / 2
                box = {"xy": (corner[0], corner[other]), "width": size[0], "height": size[other]}
                _outline(axes[row, column], **box, fill=False, edgecolor="#4cc9f0")
                if column == 1:
                    _outline(axes[row, 0], **box, facecolor="#4cc9f0")
            axes[row, 0].set(xlim=extent[:2], ylim=extent[2:], aspect="equal")
            axes[row, 0].set_xlabel("x (m)")
            axes[row, 0].set_ylabel("y (m)" if other == 1 else "z (m)")
            axes[row, 0].plot(middle[0], middle[other], "x", color="#222222", ms=9, mew=2)
    for panel in axes.flat:
        panel.set_xticks([-0.4, 0.0, 0.4])
    axes[0, 0].set_title("what is there", fontsize=9)


def _outline(axes: Any, **how: Any) -> None:
    from matplotlib.patches import Rectangle

    axes.add_patch(Rectangle(**how))


if __name__ == "__main__":
    {"build": build, "reconstruct": reconstruct, "draw": draw}[sys.argv[1]](Path(sys.argv[2]))
