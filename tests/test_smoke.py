"""`make smoke` passes, and fails where a value is loaded otherwise than it was made."""

from __future__ import annotations

import numpy as np
import pytest
from tools import smoke


def test_a_tiny_scene_goes_through_the_whole_house(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    assert smoke.main() == 0
    assert capsys.readouterr().out.startswith("smoke: 2 scenes, ")
    made = [smoke.simulated(smoke.config_from_mapping(smoke.CONFIG), index) for index in range(2)]
    others = [np.array(sample.arrays["histogram"]) + 1 for sample in made]
    monkeypatch.setattr(smoke, "loaded", lambda root: [{"histogram": of} for of in others])
    assert smoke.main() == 1
    assert "scene 1: histogram was loaded otherwise" in capsys.readouterr().err
