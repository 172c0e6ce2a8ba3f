"""The likelihood envelope of one pixel, split by part of the room and by number of bounces.

As Fig. 7 of Scholes & Leach, Sensors 24, 6522 (2024), plots it::

    python -m datagen.report.components configs/demonstration_room.yaml figure_7.png
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import cycle
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
import numpy as np
from numpy.typing import NDArray

from datagen.capture import capture_for
from datagen.config import DatasetConfig, load_config
from datagen.detector import detector_for
from datagen.detector.irf import Kernel, response_kernel, spread
from datagen.exit_status import guarded
from datagen.records import Capture, Scene, TimeAxis, Transient
from datagen.report.style import INK, captioned, empty_note, house_style, save_png
from datagen.report.time_plots import busy_window, clear_channel
from datagen.scene import generate_scene
from datagen.seeding import Purpose, derived_seed
from datagen.transport import simulate
from datagen.units import time_from_path

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Curve = NDArray[np.float64]

LEAST_BOUNCES = 5
"""The picture shows primary, secondary, and at least one order more."""
ROOM, SECONDARY = "#1F5FB4", "#D62728"
_PAPER_COLORS = {"box": "#7B3FA0", "pillar": "#E8820C"}
_OTHER_COLORS = ("#1B9E77", "#C51B7D", "#8C6D31", "#35978F", "#E6AB02", "#666666")
_ORDER_STYLES = {"secondary": (SECONDARY, "-"), "higher": ("#7F7F7F", "--"), "direct": ("#444444", ":")}
_DECADES = 5.0
_WIDTH_IN = 9.0
TIME_LABEL = "time since the light reached the laser point (ns)"


@dataclass(frozen=True)
class ComponentCurves:
    """What one pixel would see in the limit of infinite exposure: events per emitted photon and bin.

    time_ns : (bin,) middles of the bins, since the light reached the laser point.
    parts : the primary by part, objects one by one, all surfaces of the room together.
    orders : the other components, `secondary`, `higher`, `direct`.
    total : their sum, all (bin,).
    channel : laser point and pixel shown.
    """

    time_ns: Curve
    parts: dict[str, Curve]
    orders: dict[str, Curve]
    total: Curve
    channel: tuple[int, int]


def component_curves(
    config: DatasetConfig, scene: Scene, capture: Capture, transient: Transient, index: int = 0
) -> ComponentCurves:
    """Likelihood envelopes L(t) = q · (transient ⊛ IRF) of the channel where the objects stand out most.

    q is the detection efficiency and the IRF the laser pulse with the detector's jitter, as `config.detector` gives
    them for scene `index` (the paper's L(t); light beyond the time window is left out). The transient must
    hold the split by part.
    """
    laser, pixel = clear_channel(scene, transient)
    spad, exposure = detector_for(config.detector, config.seed, index, capture.time)
    width = capture.time.width_s
    pulse = response_kernel(width, exposure.pulse_fwhm_s, spad.jitter_tail_s, spad.jitter_tail_fraction)
    kernels = (pulse, response_kernel(width, spad.jitter_fwhm_s))

    def seen(transients: NDArray[np.float64]) -> Curve:
        return spad.pde * _convolved(transients[laser, pixel], kernels)

    objects = [name for name, role in zip(scene.part_names, scene.roles, strict=True) if role == "object"]
    room = [name for name in scene.part_names if name not in objects]
    parts = {_room_label(room): np.sum([seen(transient.parts[name]) for name in room], axis=0)} if room else {}
    parts |= {name: seen(transient.parts[name]) for name in objects}
    orders = {name: seen(values) for name, values in transient.components.items() if name != "primary"}
    times = capture.time.centers_s - _emission_leg_s(capture, transient, laser)
    return ComponentCurves(times * 1e9, parts, orders, seen(transient.total), (laser, pixel))


def colors_of(curves: ComponentCurves) -> dict[str, str]:
    """Part → colour as in the paper's Fig. 7: the room blue, a box purple, a pillar orange; others from a palette."""
    room, *others = curves.parts
    spare = cycle(_OTHER_COLORS)
    return {room: ROOM} | {name: _PAPER_COLORS.get(name) or next(spare) for name in others}


def curve_window(curves: ComponentCurves) -> tuple[float, float]:
    """Nanoseconds between which there is light."""
    time = curves.time_ns
    step = float(time[1] - time[0]) if len(time) > 1 else 1.0
    return busy_window(curves.total, TimeAxis(len(time), step * 1e-9, float(time[0] - step / 2) * 1e-9))


def draw_components(curves: ComponentCurves, title: str, text: str) -> Figure:
    """The curves on a logarithmic axis: total black, room blue, objects in colours, secondary red, higher dashed."""
    with house_style():
        figure, grid = captioned(_WIDTH_IN, [5.2], text)
        axes = figure.add_subplot(grid[0])
        axes.set_title(title)
        axes.set(xlabel=TIME_LABEL, ylabel="likelihood per emitted photon")
        highest = float(curves.total.max())
        if highest <= 0:
            empty_note(axes, "no light arrives within the time window")
            return figure
        lines = [("all paths", curves.total, INK, "-")]
        colors = colors_of(curves)
        lines += [(f"primary: {name}", curve, colors[name], "-") for name, curve in curves.parts.items()]
        lines += [(name, curve, *_ORDER_STYLES[name]) for name, curve in curves.orders.items()]
        for place, (name, curve, color, line) in enumerate(lines):
            label, width = name.replace("_", " "), 1.5 if place else 2.6
            axes.plot(curves.time_ns, curve, color=color, linestyle=line, linewidth=width, label=label)
        axes.set(yscale="log", ylim=(highest * 10.0**-_DECADES, highest * 3), xlim=curve_window(curves))
        axes.grid(color="#E4E4E4", linewidth=0.6)
        axes.legend(loc="upper right")
    return figure


def components_picture(config: DatasetConfig, out: Path, index: int = 0) -> Path:
    """Simulate scene `index` of a configuration with at least five bounces and write the picture. Returns `out`.

    Raises `InputError` for a scene that cannot be made or a file that cannot be written.
    """
    scene = generate_scene(config.scene, config.seed, index)
    capture = capture_for(config, scene, config.seed, index)
    asked = config.transport.accuracy()
    bounces = None if asked.max_bounces is None else max(asked.max_bounces, LEAST_BOUNCES)
    seed = derived_seed(config.seed, index, Purpose.TRANSPORT)
    transient = simulate(scene, capture, replace(asked, max_bounces=bounces), seed=seed)
    curves = component_curves(config, scene, capture, transient, index)
    return save_png(
        draw_components(curves, f"{config.name}, scene {index}", _text(curves, bounces, asked.lookins)), out
    )


def _convolved(values: Curve, kernels: tuple[Kernel, ...]) -> Curve:
    """The same bins after convolution; what is carried beyond either end is dropped."""
    for kernel in kernels:
        values = spread(values, kernel)[kernel.before : kernel.before + len(values)]
    return values


def _emission_leg_s(capture: Capture, transient: Transient, laser: int) -> float:
    """How long after the clock's start the light reaches the laser point."""
    point = transient.laser_points[laser]
    if capture.time.origin == "wall" or not np.isfinite(point).all():
        return 0.0
    return time_from_path(float(np.linalg.norm(point - capture.laser.position)))


def _room_label(names: list[str]) -> str:
    """`walls, floor, ceiling`: the relay wall sends nothing back to itself, so it is not named where it is flat."""
    others = [name for name in names if name != "relay_wall"]
    return ", ".join(others or names)


def _text(curves: ComponentCurves, bounces: int | None, lookins: int) -> str:
    laser, pixel = curves.channel
    peaks = ", ".join(
        f"{name.replace('_', ' ')} {curves.time_ns[int(np.argmax(curve))]:.1f} ns"
        for name, curve in (curves.parts | curves.orders).items()
        if curve.any()
    )
    primary = sum(float(curve.sum()) for curve in curves.parts.values())
    secondary = curves.orders.get("secondary")
    share = (
        ""
        if secondary is None or primary <= 0
        else f" Secondary over primary energy: {secondary.sum() / primary:.2f}."
    )
    orders = "all orders" if bounces is None else f"up to {bounces} bounces"
    return (
        f"Laser point {laser}, pixel {pixel}; {lookins} lookins, {orders}; convolved with laser pulse and jitter, "
        f"times the detection efficiency. Peaks: {peaks}.{share}"
    )


@click.command()
@click.argument("config")
@click.argument("out", type=click.Path(path_type=Path))
@click.argument("index", type=click.IntRange(min=0), default=0)
def main(**arguments: Any) -> None:
    """Draw the components of scene INDEX (0) of CONFIG into the PNG file OUT."""
    click.echo(components_picture(load_config(arguments["config"]), arguments["out"], arguments["index"]))


if __name__ == "__main__":
    raise SystemExit(guarded(main))
