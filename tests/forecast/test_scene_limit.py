"""The time limit of a scene: the number given, or from pilot scenes."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from datagen.config import config_from_mapping
from datagen.errors import InputError
from datagen.forecast.text import AT_LEAST_S, PILOTS_WORTH, scene_limit


def test_the_limit_is_given_or_follows_the_longest_pilot(monkeypatch: pytest.MonkeyPatch) -> None:
    config = config_from_mapping({})
    assert scene_limit("2.5", config) == 2.5
    with pytest.raises(InputError, match="--scene-seconds soon: must be a number of seconds, or forecast"):
        scene_limit("soon", config)
    for longest, limit in ((0.01, AT_LEAST_S), (60.0, 5.0 + 60.0 * PILOTS_WORTH)):
        pilots = SimpleNamespace(startup_s=5.0, scene_s=(0.001, 0.002, longest))
        monkeypatch.setattr("datagen.forecast.text.make_forecast", lambda _, pilots=pilots: pilots)
        assert scene_limit("forecast", config) == limit
