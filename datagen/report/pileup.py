"""How wrong Poisson is: `python -m datagen.report.pileup configs/demonstration_room.yaml`.

The bias of a Poisson detector (flux × cycles, no dead time) against the exact mean of a real one, over flux, with the
direct return in view and gated out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import click
import numpy as np
from numpy.typing import ArrayLike, NDArray

from datagen.capture import capture_for
from datagen.config import DatasetConfig, load_config
from datagen.design.scene_for import scene_for
from datagen.detector import Exposure, Spad, detector_for, expected_histogram
from datagen.errors import InputError
from datagen.exit_status import guarded
from datagen.records import Accuracy, TimeAxis
from datagen.seeding import Purpose, derived_seed
from datagen.transport import simulate

Array = NDArray[np.float64]

FLUXES = (1e-3, 1e-2, 0.05, 0.1, 0.3, 1.0, 4.0)
"""Events per cycle of the whole transient, as it would be without a gate."""

DETECTORS: dict[str, Spad] = {
    "synchronous, one a cycle": Spad(pde=1.0, mode="synchronous", dead_time_s=1e-3),
    "synchronous, 10 ns dead time": Spad(pde=1.0, mode="synchronous", dead_time_s=10e-9),
    "free running, 50 ns dead time": Spad(pde=1.0, dead_time_s=50e-9),
}
_LOOKINS = 16_384


@dataclass(frozen=True)
class PileupRow:
    """Biases of one detector at one flux.

    signal_bias : relative bias of the total of the bins after the direct return, Poisson over exact − 1.
    worst_bias : the same of the worst of these bins.
    delay_ps : how much too late Poisson puts the mean arrival of these counts.
    """

    detector: str
    gated: bool
    flux: float
    signal_bias: float
    worst_bias: float
    delay_ps: float


def pileup_rows(
    transient: ArrayLike,
    time: TimeAxis,
    direct_until_s: float,
    repetition_rate_hz: float = 10e6,
    fluxes: Sequence[float] = FLUXES,
) -> list[PileupRow]:
    """Bias of Poisson counting for a (bin,) transient whose direct return ends at `direct_until_s` on its time axis.

    The transient is scaled to each flux (events per cycle, direct return included); with the gate the light before
    `direct_until_s` is not seen, the laser being the same.
    """
    shape = np.asarray(transient, np.float64)
    after = time.edges_s[:-1] >= direct_until_s
    if shape.ndim != 1 or not shape.sum() > 0:
        raise InputError("pileup: a transient of shape (bin,) with some light in it is needed")
    if not after.any() or not shape[after].sum() > 0:
        raise InputError(
            f"pileup: direct_until_s = {direct_until_s:g}: nothing arrives after it on the time axis, "
            f"{time.start_s:g} … {time.stop_s:g} s"
        )
    seen = after & (shape > 1e-6 * shape[after].max())
    rows = []
    for name, plain in DETECTORS.items():
        for gated in (False, True):
            spad = plain
            if gated:
                start = float(time.edges_s[:-1][after][0])
                spad = replace(plain, gate_start_s=start, gate_width_s=time.stop_s - start)
            for flux in fluxes:
                exposure = Exposure(repetition_rate_hz, 1, flux / float(shape.sum()))
                exact = expected_histogram(shape, time, spad, exposure)[seen]
                poisson = expected_histogram(shape, time, replace(spad, mode="ideal"), exposure)[seen]
                middle = time.centers_s[seen]
                delay = middle @ poisson / poisson.sum() - middle @ exact / exact.sum()
                bias, worst = poisson.sum() / exact.sum() - 1, np.max(np.abs(poisson / exact - 1))
                rows.append(PileupRow(name, gated, flux, float(bias), float(worst), float(delay) * 1e12))
    return rows


def table(rows: Sequence[PileupRow]) -> str:
    """Markdown, a line for each row."""
    cells = []
    for row in rows:
        view, delay = "gated out" if row.gated else "in view", _three_digits(row.delay_ps, "+")
        signal, worst = _three_digits(100 * row.signal_bias, "+"), _three_digits(100 * row.worst_bias)
        cells.append([row.detector, view, f"{row.flux:g}", f"{signal} %", f"{worst} %", delay])
    head = ["detector", "direct return", "flux / cycle", "bias of signal", "worst bin", "delay (ps)"]
    return "\n".join(f"| {' | '.join(line)} |" for line in (head, ["---"] * 2 + ["---:"] * 4, *cells))


def _three_digits(value: float, sign: str = "") -> str:
    """Three significant digits, never with an exponent for large numbers."""
    return f"{value:{sign}.3g}" if abs(value) < 999.5 else f"{value:{sign}.0f}"


def room_channel(config: DatasetConfig, index: int = 0) -> tuple[Array, TimeAxis, float]:
    """Scene `index` of a configuration, its direct return simulated too: (bin,) transient, time axis, when that ends.

    Of all histograms the one with most light from the hidden scene. Raises `InputError` where no direct return is
    seen, or nothing after it.
    """
    scene = scene_for(config, index)
    capture = capture_for(config, scene, config.seed, index)
    accuracy = Accuracy(min(config.transport.lookins, _LOOKINS), max_bounces=4, direct=True)
    seed = derived_seed(config.seed, index, Purpose.TRANSPORT)
    transient = simulate(scene, capture, accuracy, seed=seed, split_parts=False)
    direct = transient.components["direct"]
    channel = np.unravel_index(np.argmax((transient.total - direct).sum(-1)), direct.shape[:2])
    lit = np.flatnonzero(direct[channel] > 0)
    if len(lit) == 0:
        raise InputError(
            f"{config.name}, scene {index}: no direct return falls into the time window; let the field of view see a "
            "laser point (pairing exhaustive or confocal) and the time axis begin before it"
        )
    return transient.total[channel], capture.time, float(capture.time.edges_s[lit[-1] + 1])


@click.command()
@click.argument("config", type=click.Path(path_type=Path))
@click.option("--index", default=0, show_default=True, help="Which scene of the configuration.")
def main(config: Path, index: int) -> None:
    """Print the bias of Poisson counting for a scene of CONFIG, over flux and detectors."""
    settings = load_config(config)
    transient, time, direct_until_s = room_channel(settings, index)
    rate_hz = detector_for(settings.detector, settings.seed, index, time)[1].repetition_rate_hz
    direct = transient[time.edges_s[:-1] < direct_until_s].sum() / transient.sum()
    click.echo(f"{settings.name}, scene {index}: the direct return carries {100 * direct:.3g} % of the light\n")
    click.echo(table(pileup_rows(transient, time, direct_until_s, rate_hz)))


if __name__ == "__main__":
    raise SystemExit(guarded(main))
