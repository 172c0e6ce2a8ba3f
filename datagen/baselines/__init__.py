"""Baselines, with which the scores on a suite can be compared: `datagen baseline`."""

from datagen.baselines.predict import BASELINES, write_baseline

__all__ = ["BASELINES", "write_baseline"]
