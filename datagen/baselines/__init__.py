"""What a suite's scores are to be compared with: `datagen baseline`."""

from datagen.baselines.predict import BASELINES, write_baseline

__all__ = ["BASELINES", "write_baseline"]
