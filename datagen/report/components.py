"""The likelihood envelope of one pixel, split by part of the room and by number of bounces.

As Fig. 7 of Scholes & Leach, Sensors 24, 6522 (2024), plots it::

    python -m datagen.report.components configs/demonstration_room.yaml figure_7.png
"""

from __future__ import annotations

from dataclasses import dataclass, replace
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
from datagen.report.style import INK, caption, caption_height, empty_note, house_style, new_figure, save_png
from datagen.report.transient_plots import busy_window, clear_channel
from datagen.scene import generate_scene
from datagen.seeding import Purpose, derived_seed
from datagen.transport import simulate
from datagen.units import time_from_path

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Curve = NDArray[np.float64]

LEAST_BOUNCES = 5
"""The picture shows primary, secondary, and at least one order more."""
_ROOM_COLOR = "#0072B2"
_OBJECT_COLORS = ("#7B3FA0", "#E08214", "#1B9E77", "#C51B7D", "#8C6D31", "#35978F")
"""The paper's purple box and orange pillar first."""
_ORDER_STYLES = {
    "secondary": ("#D62728", "-"),
    "higher": ("#7F7F7F", "--"),
    "direct": ("#444444", ":"),
}
_DECADES = 5.0
_WIDTH_IN = 9.0


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


def draw_components(curves: ComponentCurves, title: str, text: str) -> Figure:
    """The curves on a logarithmic axis: total black, room blue, objects in colours, secondary red, higher dashed."""
    height = caption_height(_WIDTH_IN, text)
    with house_style():
        figure = new_figure(_WIDTH_IN, 5.2 + height)
        axes, below = figure.subplots(2, 1, height_ratios=(5.2, height))
        axes.set_title(title)
        axes.set(xlabel="time since the light reached the laser point (ns)", ylabel="likelihood per emitted photon")
        highest = float(curves.total.max())
        if highest > 0:
            times = curves.time_ns
            axes.plot(times, curves.total, color=INK, linewidth=2.6, label="all paths")
            for color, (name, curve) in zip(_part_colors(curves), curves.parts.items(), strict=True):
                axes.plot(times, curve, color=color, linewidth=1.5, label=f"primary: {name.replace('_', ' ')}")
            for name, curve in curves.orders.items():
                color, line = _ORDER_STYLES[name]
                axes.plot(times, curve, color=color, linestyle=line, linewidth=1.5, label=name)
            axes.set_yscale("log")
            axes.set_ylim(highest * 10.0**-_DECADES, highest * 3)
            half = (times[1] - times[0]) / 2 if len(times) > 1 else 0.5
            axis = TimeAxis(len(times), 2e-9 * half, (times[0] - half) * 1e-9)
            axes.set_xlim(*busy_window(curves.total, axis))
            axes.grid(color="#E4E4E4", linewidth=0.6)
            axes.legend(loc="upper right")
        else:
            empty_note(axes, "no light arrives within the time window")
        caption(figure, below, text)
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


def _part_colors(curves: ComponentCurves) -> list[str]:
    others = len(curves.parts) - 1
    return [_ROOM_COLOR, *(_OBJECT_COLORS[k % len(_OBJECT_COLORS)] for k in range(others))][: len(curves.parts)]


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
