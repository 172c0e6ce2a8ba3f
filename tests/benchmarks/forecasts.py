"""Whether a plan comes true: pilots of each configuration, then its first scenes made as a worker does.

`python tests/benchmarks/forecasts.py SCENES SECONDS CONFIG…` prints the figures of docs/figures.md: pilots of SECONDS
processor seconds, then SCENES scenes. Only one of the pilots, which are spread over the dataset, is among those.
Processor seconds of pilots and scenes alike, because the clock of a busy machine says little; what a worker's start
takes is left out.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from datasets import write_dataset

from datagen.bench.measuring import machine, markdown, processor_seconds
from datagen.config import DatasetConfig, load_config
from datagen.forecast.forecast import Outcome, forecast, outcomes
from datagen.forecast.pilots import run_pilots
from datagen.forecast.text import quantity
from datagen.store import committed, read_manifest, schema_of


def row(config: DatasetConfig, scenes: int, seconds: float) -> list[str]:
    """Predicted → actual (actual over predicted) of a configuration's first scenes."""
    few = config.with_scenes(min(scenes, config.scenes))
    expected = forecast(schema_of(few), run_pilots(config, seconds), startup_s=0.0, workers=1, cores=1)
    with tempfile.TemporaryDirectory() as folder:
        root, taken_s = processor_seconds(lambda: write_dataset(few, Path(folder) / "set"))
        _, *others = outcomes(expected, committed(root, read_manifest(root)), root)
    shown = [Outcome("seconds per scene", "s", expected.processor_s, taken_s / few.scenes), *others]
    pilots = str(expected.pilots) if expected.effort == 1.0 else f"1 of {expected.effort:.2g} effort"
    cells = (f"{quantity(of.predicted, of.unit)} → {quantity(of.actual, of.unit)} ({of.ratio:.2f})" for of in shown)
    return [config.name, str(few.scenes), pilots, *cells]


def main(scenes: int, seconds: float, configs: list[str]) -> None:
    """Forecast and build a few scenes of every configuration."""
    rows = [row(load_config(config), scenes, seconds) for config in configs]
    print(f"Processor seconds; {machine()}\n")
    head = ["configuration", "scenes", "pilots", "seconds per scene", "relative error", "bytes per scene"]
    print(markdown(head, rows))


if __name__ == "__main__":
    main(int(sys.argv[1]), float(sys.argv[2]), sys.argv[3:])
