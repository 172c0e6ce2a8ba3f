"""Baselines: methods whose scores on a suite others can be compared with: `datagen baseline`."""

from datagen.baselines.predict import BASELINES, write_baseline

__all__ = ["BASELINES", "write_baseline"]
