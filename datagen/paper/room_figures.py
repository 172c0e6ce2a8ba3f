"""Fig. 3 and 5 of the paper: how light spreads over the observed points, for both estimators."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from datagen.paper.room_samples import FromLookin, Lit
from datagen.paper.runs import Runs
from datagen.report.room_plots import RoomPicture, draw_opened
from datagen.report.style import FIELD_OF_VIEW, captioned, house_style

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_WIDTH_IN = 13.0
_PANEL_IN = 3.4
_DECADES = 3.0
_MOST_POINTS = 60_000
_COLORS = "inferno"


def light_figure(runs: Runs, points: Lit) -> Figure:
    """Fig. 3: inverse square, angular distribution, product; as printed above, radiometric below."""
    shadowed = 100 * float(1 - points.lit.mean())
    text = (
        "As Fig. 3 of Scholes & Leach (2024): the laser's light over the "
        f"{len(points.position):,} observed points of {runs.sparse} × {runs.sparse} lookins. Left the inverse square "
        "of the distance to the laser point (orange dot), in the middle the angular distribution there, right their "
        f"product; logarithmic over {_DECADES:g} decades below the brightest (the middle: linear). Points in shadow "
        f"({shadowed:.0f} %) are left out, as are ceiling and near walls in the picture. Below, radiometrically, a "
        "surface also receives by the cosine of its own tilt, which the printed equations leave out: surfaces that "
        "the light grazes darken."
    )
    with house_style():
        figure, grid = captioned(_WIDTH_IN, [_PANEL_IN] * 2, text, columns=3)
        backdrop = _backdrop(runs)
        for row, (estimator, three) in enumerate(points.panels.items()):
            for column, (name, values) in enumerate(three):
                axes = figure.add_subplot(grid[row, column])
                lit = np.where(points.lit, values, 0)
                _paint(figure, axes, backdrop, points.position, points.face, lit, column == 1)
                axes.set_title(f"{estimator}: {name}")
    return figure


def lookins_figure(runs: Runs, examples: list[FromLookin]) -> Figure:
    """Fig. 5: BRDF, inverse square and field of view for the example lookins, for both estimators."""
    text = (
        "As Fig. 5 of Scholes & Leach (2024): where a lookin (grey triangle) sends light. Left by its B alone, in "
        "the middle with the inverse square, right the observed points within the field of view (blue square), seen "
        f"from the sensor, with the final bounce; logarithmic over {_DECADES:g} decades (left: linear), each panel "
        "relative to its brightest point. As printed every camera pixel counts alike and surfaces receive whatever "
        "their tilt; radiometrically points receive by their own cosine. The paper names no lookins: these are, on "
        "the wall and on the pillar, the nearest to the laser point that light up the field of view."
    )
    with house_style():
        figure, grid = captioned(_WIDTH_IN, [_PANEL_IN] * (2 * len(examples)), text, columns=3)
        backdrop = _backdrop(runs)
        for k, example in enumerate(examples):
            for line, (estimator, panels) in enumerate(example.panels.items()):
                row, places = 2 * k + line, (example.position, example.face)
                for column, (name, values) in enumerate(panels):
                    axes = figure.add_subplot(grid[row, column])
                    if column == 2:
                        _close_up(figure, axes, runs, example, values)
                        axes.set_title(f"{estimator}: {name}")
                        continue
                    _paint(figure, axes, backdrop, *places, values, column == 0, lookin=example.lookin)
                    axes.set_title(f"({'ab'[k]}) {estimator}: {name}" + (f"; {example.where}" * (not column)))
    return figure


def _backdrop(runs: Runs) -> RoomPicture:
    """The opened room in pale colours, with device, laser point and field of view."""
    pale = {"relay_wall": "#DDE4EC", "structure": "#ECECEC", "object": "#D9D9D9"}
    colors = {name: pale[role] for name, role in zip(runs.scene.part_names, runs.scene.roles, strict=True)}
    colors |= {name: color for name, color in (("box", "#D9C7E8"), ("pillar", "#F7D9B5")) if name in colors}
    room = replace(runs.scene, hidden_view=None)
    return RoomPicture(room, runs.capture, runs.laser_point[None], pixels=420, colors=colors)


def _paint(
    figure: Figure,
    axes: Axes,
    backdrop: RoomPicture,
    position: NDArray[np.float64],
    face: NDArray[np.int32],
    values: NDArray[np.float64],
    linear: bool,
    lookin: NDArray[np.float64] | None = None,
) -> None:
    """Points over the opened room, coloured by value relative to the highest; those on removed walls left out."""
    draw_opened(axes, backdrop, arrows=False)
    camera, cut, _ = backdrop.opened
    shown = np.flatnonzero(np.isin(face, cut.faces) & (values > 0))
    if not len(shown):
        return
    highest = float(values[values > 0].max()) if linear else float(np.quantile(values[shown], 0.999))
    shown = shown[:: max(1, len(shown) // _MOST_POINTS)]
    at = camera.project(position[shown])
    order = np.argsort(-at[:, 2])
    size = float(np.clip(25_000 / len(shown), 0.4, 9.0))
    relative = values[shown][order] / highest
    _scatter(figure, axes, at[order], relative, linear, s=size, linewidths=0, zorder=6)
    if lookin is not None:
        here = camera.project(lookin)
        axes.scatter(
            here[0], here[1], s=60, marker="^", color="#9A9A9A", edgecolors="black", linewidths=0.7, zorder=13
        )


def _close_up(figure: Figure, axes: Axes, runs: Runs, example: FromLookin, values: NDArray[np.float64]) -> None:
    """The field of view in its own plane, seen from the sensor."""
    corners = runs.capture.sensor.pixels[0]
    right, up = corners[1] - corners[0], corners[3] - corners[0]
    middle = corners.mean(axis=0)
    # From the sensor's side: a frame whose normal points to it has right on the right.
    if np.cross(right, up) @ (runs.capture.sensor.position - middle) < 0:
        right = -right
    frame = np.stack([right / np.linalg.norm(right), up / np.linalg.norm(up)])
    at = (example.position[example.in_view] - middle) @ frame.T
    square = (np.concatenate([corners, corners[:1]]) - middle) @ frame.T
    highest = float(values.max(initial=0.0))
    relative = values / highest if highest > 0 else np.zeros(len(values))
    size = float(np.clip(6000 / max(len(at), 1), 3.0, 60.0))
    _scatter(figure, axes, at, relative, False, s=size, edgecolors="#888888", linewidths=0.2)
    axes.plot(square[:, 0], square[:, 1], color=FIELD_OF_VIEW, linewidth=1.8)
    axes.set_aspect("equal")
    axes.set(xlabel="right (m)", ylabel="up (m)")


def _scatter(
    figure: Figure, axes: Axes, at: NDArray[np.float64], relative: NDArray[np.float64], linear: bool, **style: Any
) -> None:
    """Points coloured by value, as it is or over the decades below the brightest, with a colour bar."""
    color = np.clip(relative, 0, 1) if linear else np.clip(np.log10(np.maximum(relative, 1e-300)), -_DECADES, 0)
    limits = (0.0, 1.0) if linear else (-_DECADES, 0.0)
    drawn = axes.scatter(at[:, 0], at[:, 1], c=color, cmap=_COLORS, vmin=limits[0], vmax=limits[1], **style)
    figure.colorbar(drawn, ax=axes, shrink=0.7, pad=0.01).set_label("relative" if linear else "log₁₀, relative")
