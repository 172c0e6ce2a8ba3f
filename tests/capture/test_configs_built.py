"""Every ready configuration is built, verified and read, with fewer laser points, pixels and rays."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from small_configs import READY, reduced

import datagen as dg
from datagen.config import load_config
from datagen.store import read_manifest, verify

pytestmark = pytest.mark.usefixtures("builds_here")


@pytest.mark.parametrize("path", READY, ids=lambda path: path.stem)
def test_every_ready_configuration_is_built(path: Path, tmp_path: Path) -> None:
    config = reduced(load_config(path))
    result = dg.build(config, tmp_path / "set", progress=False)
    assert result.complete
    assert verify(tmp_path / "set").problems == ()
    data = dg.TransientDataset(str(tmp_path / "set"), fields=("histogram",))
    counts = np.asarray(data[0]["histogram"])
    frames = () if config.sequence is None else (config.sequence.frames,)
    assert counts.shape == (*frames, *config.histogram_shape)
    assert counts.sum() > 0
    # What a dataset states of its configuration is all of it: its scenes can be made again.
    stored = read_manifest(tmp_path / "set").parsed_config()
    assert stored == config and stored.fingerprint() == config.fingerprint()
