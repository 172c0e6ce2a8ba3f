"""How long a scene may take before a build gives it up."""

from __future__ import annotations

from datagen.config import DatasetConfig
from datagen.errors import InputError
from datagen.forecast.text import make_forecast

PILOTS_WORTH = 20.0
"""So many times the longest pilot: rooms differ, and machines are busy."""
AT_LEAST_S = 60.0


def scene_limit(asked: str, config: DatasetConfig) -> float:
    """Seconds: the number asked for, or of `forecast` what pilot scenes let expect, with much to spare: start of a
    worker, compiling included, and `PILOTS_WORTH` times the longest pilot.

    Raises `InputError` for anything else, and what a forecast raises.
    """
    if asked == "forecast":
        expected = make_forecast(config)
        return max(AT_LEAST_S, expected.startup_s + PILOTS_WORTH * expected.scene_s[2])
    try:
        return float(asked)
    except ValueError:
        raise InputError(f"--scene-seconds {asked}: must be a number of seconds, or forecast") from None
