"""Every ready configuration is built, verified and read, with fewer laser points, pixels and rays."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from small_configs import READY, geometry_digests, made_as_pinned, pinned, reduced

import datagen as dg
from datagen.config import load_config
from datagen.store import verify
from datagen.store.verify import dataset_digest


def test_there_are_at_least_eight() -> None:
    assert len(READY) >= 8
    configs = [load_config(path) for path in READY]
    kinds = {(config.capture.pairing, config.capture.scan.kind) for config in configs}
    assert {("confocal", "grid"), ("confocal", "subset"), ("exhaustive", "grid"), ("exhaustive", "points")} <= kinds
    assert any(config.capture.illumination == "flood" and config.transport.direct for config in configs)
    assert any(config.scene.layout.relay_wall.kind != "flat" for config in configs)
    assert any({"shaded", "objects"} <= set(config.store.fields) for config in configs)


@pytest.mark.parametrize("path", READY, ids=lambda path: path.stem)
def test_every_ready_configuration_is_built(path: Path, tmp_path: Path) -> None:
    config = reduced(load_config(path))
    result = dg.build(config, tmp_path / "set", progress=False)
    assert result.complete
    assert verify(tmp_path / "set").problems == ()
    data = dg.TransientDataset(str(tmp_path / "set"), fields=("histogram",))
    counts = np.asarray(data[0]["histogram"])
    assert counts.shape == config.histogram_shape
    assert counts.sum() > 0
    if made_as_pinned():
        remedy = "if a seed is meant to yield something else, renew tests/small_configs.json (`make digests`)"
        assert dataset_digest(tmp_path / "set") == pinned()["values"][path.stem], remedy


@pytest.mark.skipif(not made_as_pinned(), reason="other versions than those of constraints.txt, or no x86-64")
@pytest.mark.parametrize("path", READY, ids=lambda path: path.stem)
def test_rooms_scans_and_pixels_are_those_of_every_x86_64(path: Path) -> None:
    assert geometry_digests(load_config(path)) == pinned()["geometry"][path.stem]
