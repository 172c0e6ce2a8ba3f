"""Fig. 3, 5, 7 and 9 of the paper, for both estimators: how light spreads over the observed points, and envelopes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from datagen.detector import detector_for
from datagen.detector.irf import FWHM_PER_SIGMA
from datagen.paper.printed_paths import PrintedLookins, PrintedRoom, half_cube, leaving, lighting, ray_grid
from datagen.paper.runs import PEAKS_NS, SECONDARY, TIME_LABEL, Runs, Scheme, Simulation, colors_of, curve_window
from datagen.records import Scene, SinLobe
from datagen.records.arrays import Bools, Floats, Ints
from datagen.report.rooms import RoomPicture, draw_opened, normals_of
from datagen.report.style import FIELD_OF_VIEW, captioned, house_style

UNIT_M = 1e-3
_PANEL_IN = 2.2
_DECADES, _MOST_DECADES, _MARGIN_BELOW = 3.0, 12.0, 100.0
"""Decades of points' colours; most decades of an axis of envelopes; factor between its end and the lowest peak."""
_MOST_POINTS = 60_000
_UPRIGHT = 0.5
"""Largest vertical part of the normal of a wall."""


@dataclass(frozen=True)
class Points:
    """Observed points over the opened room: (n, 3) places, (n,) the triangle that each lies on, and (estimator, what,
    value of each) for every panel, row by row."""

    position: Floats
    face: NDArray[np.int32]
    panels: list[tuple[str, str, Floats]]


def light_figure(runs: Runs) -> Figure:
    """Fig. 3: inverse square, angular distribution, product; as printed above, radiometric below."""
    room, sparse = PrintedRoom.of(runs.scene, runs.capture, UNIT_M), runs.sizes.rays[0]
    seen = room.observed(room.lookins(0, ray_grid(sparse, "angles")), half_cube(runs.sizes.pixels))
    light, met = lighting(room, 0, seen), seen.face >= 0
    position, distance, lit = seen.position[met], light.distance[met], light.brdf[met] > 0
    span = (position - room.points.position[0]) / distance[:, None]
    one, spread = np.maximum(span @ room.points.normal[0], 0), (UNIT_M / distance) ** 2
    both = one * np.maximum(-np.einsum("nk,nk->n", span, seen.normal[met]), 0)
    panels = [
        ("as printed", "1/R²", spread), ("as printed", "cosφ", one), ("as printed", "cosφ / R²", one * spread),
        ("radiometric", "1/R²", spread), ("radiometric", "cosφ · cosφ′", both),
        ("radiometric", "irradiance ∝ cosφ cosφ′ / R²", both * spread),
    ]  # fmt: skip
    text = (
        "As Fig. 3 of Scholes & Leach (2024): the laser's light over the "
        f"{len(position):,} observed points of {sparse} × {sparse} lookins. Left the inverse square "
        "of the distance to the laser point (orange dot), in the middle the angular distribution there, right their "
        f"product; logarithmic over {_DECADES:g} decades below the brightest (the middle: linear). Points in shadow "
        f"({100 * float(1 - lit.mean()):.0f} %) are left out, as are ceiling and near walls in the picture. Below, "
        "radiometrically, a surface also receives by the cosine of its own tilt, which the printed equations leave "
        "out: surfaces that the light grazes darken."
    )
    with house_style():
        figure, grid = captioned([_PANEL_IN] * 2, text, columns=3)
        backdrop = _backdrop(runs)
        for k, (estimator, what, values) in enumerate(panels):
            axes = figure.add_subplot(grid[divmod(k, 3)])
            _paint(figure, axes, backdrop, position, seen.face[met], np.where(lit, values, 0), k % 3 == 1)
            axes.set_title(f"{estimator}:\n{what}")
    return figure


def lookins_figure(runs: Runs) -> Figure:
    """Fig. 5: BRDF, inverse square and field of view for the paper's two example lookins, for both estimators: of the
    nearest wall by cosφ, and of the pillar, where there is one, by |sinθ|."""
    scene = runs.scene
    walls = [k for k, role in enumerate(scene.roles) if role == "structure"]
    upright = np.abs(normals_of(scene.corners)[:, 2]) < _UPRIGHT
    wall = _example(runs, scene, lambda of: np.isin(of.part, walls) & upright[of.face])
    examples = [("nearest wall, B = cosφ", wall)]
    if "pillar" in scene.part_names:
        pillar = scene.part_names.index("pillar")
        materials = list(scene.materials)
        materials[pillar] = SinLobe(materials[pillar].albedo)
        room = replace(scene, materials=tuple(materials))
        examples.append(("pillar, B = |sinθ|", _example(runs, room, lambda of: of.part == pillar)))
    shown = [(where, *example) for where, example in examples if example is not None]
    text = (
        "As Fig. 5 of Scholes & Leach (2024): where a lookin (grey triangle) sends light. Left by its B alone, in "
        "the middle with the inverse square, right the observed points within the field of view (blue square), seen "
        f"from the sensor, with the final bounce; logarithmic over {_DECADES:g} decades (left: linear), each panel "
        "relative to its brightest point. As printed every camera pixel counts alike and surfaces receive whatever "
        "their tilt; radiometrically points receive by their own cosine. The paper names no lookins: these are, on "
        "the wall and on the pillar, the nearest to the laser point that light up the field of view."
    )
    with house_style():
        figure, grid = captioned([_PANEL_IN] * (2 * len(shown)), text, columns=3)
        backdrop = _backdrop(runs)
        for number, (where, lookin, points, in_view) in enumerate(shown):
            for k, (estimator, what, values) in enumerate(points.panels):
                axes = figure.add_subplot(grid[2 * number + k // 3, k % 3])
                if k % 3 == 2:
                    _close_up(figure, axes, runs, points.position[in_view], values)
                    axes.set_title(f"{estimator}:\n{what}")
                    continue
                _paint(figure, axes, backdrop, points.position, points.face, values, k % 3 == 0, lookin)
                first = f"({'ab'[number]}) {where}\n{estimator}: {what}"
                axes.set_title(first if k % 3 == 0 else f"{estimator}:\n{what}")
    return figure


def _example(
    runs: Runs, scene: Scene, wanted: Callable[[PrintedLookins], Bools]
) -> tuple[Floats, Points, Ints] | None:
    """The wanted lookin nearest to the laser point that sends light into the field of view, of the sparse grid's,
    else of the dense grid's: its place, what it sends to its observed points, and which of them are in view."""
    room, camera = PrintedRoom.of(scene, runs.capture, UNIT_M), half_cube(runs.sizes.pixels)
    for rays in runs.sizes.rays:
        lookins = room.lookins(0, ray_grid(rays, "angles"))
        rows = np.flatnonzero(wanted(lookins))
        for row in rows[np.argsort(lookins.distance[rows])]:
            lookin = lookins.take(slice(row, row + 1))
            points, in_view = _sent(room, lookin, camera)
            if len(in_view):
                return lookin.position[0], points, in_view
    return None


def _sent(room: PrintedRoom, lookin: PrintedLookins, camera: Floats) -> tuple[Points, Ints]:
    """What one lookin sends: without and with 1/R², and, for the points in view alone, with the last bounce."""
    seen = room.observed(lookin, camera)
    paths, point = leaving(room, lookin, seen, np.array([0]))
    met = np.flatnonzero(seen.face[0] >= 0)
    in_view = np.searchsorted(met, point)
    position, distance = seen.position[0, met], seen.distance[0, met]
    received = np.maximum(np.einsum("nk,nk->n", lookin.position - position, seen.normal[0, met]) / distance, 0)
    share, spread, final = seen.share[0, met], (UNIT_M / distance) ** 2, paths.energy
    # |sinθ| as a BRDF keeps Lambert's polar dependence, cosφ as one is constant: either way B · cosφ, or cosφ alone.
    cosine = camera[met, 2]
    lobe = share * cosine if room.sine[lookin.part[0]] else cosine
    gain = received[in_view] / np.where(share[in_view] > 0, share[in_view], 1.0) * lobe[in_view]
    panels = [
        ("as printed", "α B", share), ("as printed", "α B / R²", share * spread),
        ("as printed", "into the sensor", final), ("radiometric", "per solid angle", lobe),
        ("radiometric", "irradiance", lobe * spread * received), ("radiometric", "into the sensor", final * gain),
    ]  # fmt: skip
    return Points(position, seen.face[0, met], panels), in_view


def _backdrop(runs: Runs) -> RoomPicture:
    """The opened room in pale colours, with device, laser point and field of view."""
    pale = {"relay_wall": "#DDE4EC", "structure": "#ECECEC", "object": "#D9D9D9"}
    colors = {name: pale[role] for name, role in zip(runs.scene.part_names, runs.scene.roles, strict=True)}
    colors |= {name: color for name, color in (("box", "#D9C7E8"), ("pillar", "#F7D9B5")) if name in colors}
    points = PrintedRoom.of(runs.scene, runs.capture, UNIT_M).points.position[:1]
    return RoomPicture(replace(runs.scene, hidden_view=None), runs.capture, points, pixels=420, colors=colors)


def _paint(
    figure: Figure, axes: Axes, backdrop: RoomPicture, position: Floats, face: NDArray[np.int32], values: Floats,
    linear: bool, lookin: Floats | None = None,
) -> None:  # fmt: skip
    """Points over the opened room, coloured by value relative to the highest; those on removed walls left out."""
    draw_opened(axes, backdrop, arrows=False)
    camera, drawn, _ = backdrop.opened
    shown = np.flatnonzero(np.isin(face, drawn) & (values > 0))
    if not len(shown):
        return
    highest = float(values[values > 0].max()) if linear else float(np.quantile(values[shown], 0.999))
    shown = shown[:: max(1, len(shown) // _MOST_POINTS)]
    at = camera.project(position[shown])
    order = np.argsort(-at[:, 2])
    size = float(np.clip(25_000 / len(shown), 0.4, 9.0))
    _scatter(figure, axes, at[order], values[shown][order] / highest, linear, s=size, linewidths=0, zorder=6)
    if lookin is not None:
        x, y, _ = camera.project(lookin)
        axes.scatter(x, y, s=60, marker="^", color="#9A9A9A", edgecolors="black", linewidths=0.7, zorder=13)


def _close_up(figure: Figure, axes: Axes, runs: Runs, position: Floats, values: Floats) -> None:
    """The field of view in its own plane, seen from the sensor."""
    corners = runs.capture.sensor.pixels[0]
    right, up = corners[1] - corners[0], corners[3] - corners[0]
    middle = corners.mean(axis=0)
    # From the sensor's side: a frame whose normal points to it has right on the right.
    if np.cross(right, up) @ (runs.capture.sensor.position - middle) < 0:
        right = -right
    frame = np.stack([right / np.linalg.norm(right), up / np.linalg.norm(up)])
    at, square = ((places - middle) @ frame.T for places in (position, np.concatenate([corners, corners[:1]])))
    relative = values / (float(values.max(initial=0.0)) or 1.0)
    size = float(np.clip(6000 / max(len(at), 1), 3.0, 60.0))
    _scatter(figure, axes, at, relative, False, s=size, edgecolors="#888888", linewidths=0.2)
    axes.plot(square[:, 0], square[:, 1], color=FIELD_OF_VIEW, linewidth=1.8)
    axes.set_aspect("equal")
    axes.set(xlabel="right (m)", ylabel="up (m)")


def _scatter(figure: Figure, axes: Axes, at: Floats, relative: Floats, linear: bool, **style: Any) -> None:
    """Points coloured by value, as it is or over the decades below the brightest, with a colour bar."""
    color = np.clip(relative, 0, 1) if linear else np.clip(np.log10(np.maximum(relative, 1e-300)), -_DECADES, 0)
    low, high = (0.0, 1.0) if linear else (-_DECADES, 0.0)
    drawn = axes.scatter(at[:, 0], at[:, 1], c=color, cmap="inferno", vmin=low, vmax=high, **style)
    figure.colorbar(drawn, ax=axes, shrink=0.7, pad=0.01).set_label("relative" if linear else "log₁₀, relative")


def envelope_figure(runs: Runs, scheme: Scheme, number: str) -> Figure:
    """Fig. 7 and 9: envelopes by part, as printed above and radiometric below, sparse and dense side by side."""
    spad, exposure = detector_for(runs.config.detector, runs.config.seed, 0, runs.capture.time)
    sigma_ps = float(np.hypot(exposure.pulse_fwhm_s, spad.jitter_fwhm_s) / FWHM_PER_SIGMA * 1e12)
    what = "all secondary paths" if scheme == "all" else "the strongest secondary path of each lookin"
    text = (
        f"As Fig. {number} of Scholes & Leach (2024), with {what}: the likelihood envelope L(t) (black), and what of "
        "it comes by walls, roof and floor (blue, dashed), box (purple), pillar (orange), secondary bounce (red). "
        "Above: Eq. 6 and 8 as printed, lengths in millimetres. Below: radiometric weights, the secondary by as many "
        f"lookins and observed points, the primary by simulate, to {100 * runs.sizes.target:g} %, which does not "
        "depend on these counts; thin and pale simulate's own light, by all paths. Dotted lines: where the "
        f"paper's Fig. 7 has its peaks. A bin is {runs.capture.time.width_s * 1e12:g} ps wide; σ = {sigma_ps:.0f} ps."
    )
    pixels, window = runs.sizes.pixels, curve_window(runs.converged.curves)
    with house_style():
        figure, grid = captioned([3.2, 3.2], text, columns=2)
        for row, estimator in enumerate(("as printed", "radiometric")):
            cases = {rays: runs.cases[estimator, rays, scheme] for rays in runs.sizes.rays}  # type: ignore[index]
            peaks = [curve.max() for case in cases.values() for curve in _curves(case).values() if curve.any()] or [1]
            lowest = max(min(peaks) / _MARGIN_BELOW, max(peaks) * 10.0**-_MOST_DECADES)
            for column, (rays, case) in enumerate(cases.items()):
                axes = figure.add_subplot(grid[row, column])
                if estimator == "radiometric":
                    _draw(axes, runs.converged, thin=True)
                _draw(axes, case)
                colors = colors_of(case.curves)
                for name in colors.keys() & PEAKS_NS.keys():
                    axes.axvline(PEAKS_NS[name], color=colors[name], linewidth=0.9, linestyle=":", zorder=0)
                title = f"{estimator}, {rays} × {rays} × {pixels} × {pixels}"
                axes.set(title=title, yscale="log", ylim=(lowest, 4 * max(peaks)), xlim=window, xlabel=TIME_LABEL)
                unit = "as printed, mm⁻⁴" if row == 0 else "per emitted photon"
                axes.set_ylabel("" if column else f"L(t) per bin ({unit})")
                axes.grid(color="#E8E8E8", linewidth=0.6)
                if (row, column) == (0, 1):
                    axes.legend(loc="upper right")
    return figure


def _curves(case: Simulation) -> dict[str, Floats]:
    parts, secondary = case.curves.parts, case.curves.orders["secondary"]
    return {"total": np.sum([*parts.values(), secondary], axis=0), **parts, "secondary bounce": secondary}


def _draw(axes: Axes, case: Simulation, thin: bool = False) -> None:
    colors = {"total": "black", "secondary bounce": SECONDARY} | colors_of(case.curves)
    for place, (name, curve) in enumerate(_curves(case).items()):
        if not curve.any():
            continue
        width = 0.8 if thin else 2.4 if name == "total" else 1.4
        # The blue lies on the black where the room makes the total: dashed, as in the paper.
        line = (0, (4, 2)) if place == 1 and not thin else "-"
        axes.plot(
            case.curves.time_ns, np.where(curve > 0, curve, np.nan), color=colors[name], linewidth=width,
            linestyle=line, alpha=0.45 if thin else 1.0, label=None if thin else name.replace("_", " "),
        )  # fmt: skip
