"""How wrong Poisson is: `python tests/benchmarks/pileup.py configs/demonstration_room.yaml`.

The bias of a Poisson detector (flux × cycles, no dead time) against the exact mean of a real one, over flux, with the
direct return in view and gated out.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from datagen.bench.measuring import markdown
from datagen.capture import capture_for
from datagen.config import DatasetConfig, load_config
from datagen.design.scene_for import scene_for
from datagen.detector import Exposure, Spad, detector_for, expected_histogram
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
    shape: Array, time: TimeAxis, direct_until_s: float, rate_hz: float = 10e6, fluxes: Sequence[float] = FLUXES
) -> Iterator[PileupRow]:
    """Bias of Poisson counting for a (bin,) transient whose direct return ends at `direct_until_s` on its time axis.

    The transient is scaled to each flux (events per cycle, direct return included); with the gate the light before
    `direct_until_s` is not seen, the laser being the same.
    """
    after = time.edges_s[:-1] >= direct_until_s
    seen = after & (shape > 1e-6 * shape[after].max())
    start, middle = float(time.edges_s[:-1][after][0]), time.centers_s[seen]
    for name, plain in DETECTORS.items():
        for gated in (False, True):
            spad = replace(plain, gate_start_s=start, gate_width_s=time.stop_s - start) if gated else plain
            for flux in fluxes:
                exposure = Exposure(rate_hz, 1, flux / float(shape.sum()))
                exact = expected_histogram(shape, time, spad, exposure)[seen]
                poisson = expected_histogram(shape, time, replace(spad, mode="ideal"), exposure)[seen]
                delay = middle @ poisson / poisson.sum() - middle @ exact / exact.sum()
                bias, worst = poisson.sum() / exact.sum() - 1, np.max(np.abs(poisson / exact - 1))
                yield PileupRow(name, gated, flux, float(bias), float(worst), float(delay) * 1e12)


def room_channel(config: DatasetConfig) -> tuple[Array, TimeAxis, float]:
    """Scene 0 of a configuration, its direct return simulated too: (bin,) transient, time axis, when that ends.

    Of all histograms the one with most light from the hidden scene.
    """
    scene = scene_for(config, 0)
    capture = capture_for(config, scene, config.seed, 0)
    accuracy = Accuracy(target=0.02, max_bounces=4, direct=True)
    seed = derived_seed(config.seed, 0, Purpose.TRANSPORT)
    transient = simulate(scene, capture, accuracy, seed=seed, split_parts=False)
    direct = transient.components["direct"]
    channel = np.unravel_index(np.argmax((transient.total - direct).sum(-1)), direct.shape[:2])
    last = np.flatnonzero(direct[channel] > 0)[-1]
    return transient.total[channel], capture.time, float(capture.time.edges_s[last + 1])


def main(config: DatasetConfig) -> None:
    """Print the bias of Poisson counting for a scene of a configuration, over flux and detectors."""
    transient, time, until_s = room_channel(config)
    rate_hz = detector_for(config.detector, config.seed, 0, time)[1].repetition_rate_hz
    direct = transient[time.edges_s[:-1] < until_s].sum() / transient.sum()
    print(f"{config.name}, scene 0: the direct return carries {100 * direct:.3g} % of the light\n")
    rows = [
        [row.detector, "gated out" if row.gated else "in view", f"{row.flux:g}", f"{100 * row.signal_bias:+.4g} %",
         f"{100 * row.worst_bias:.4g} %", f"{row.delay_ps:+.3g}"]
        for row in pileup_rows(transient, time, until_s, rate_hz)
    ]  # fmt: skip
    print(
        markdown(["detector", "direct return", "flux / cycle", "bias of signal", "worst bin", "delay (ps)"], rows, 2)
    )


if __name__ == "__main__":
    main(load_config(sys.argv[1]))
