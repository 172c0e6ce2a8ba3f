"""The envelopes by part and by number of bounces, for odd scenes and scans."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import datagen as dg
from datagen.config import DatasetConfig, config_from_mapping
from datagen.paper.runs import ComponentCurves, component_curves


def configured(capture: dict[str, Any], detector: dict[str, Any] | None = None, **scene: Any) -> DatasetConfig:
    return config_from_mapping(
        {"seed": 4, "scene": scene, "capture": capture, "detector": detector or {}, "transport": {"target": 0.3}}
    )


def curves_of(config: DatasetConfig, bounces: int = 4, **accuracy: Any) -> ComponentCurves:
    scene = dg.generate_scene(config.scene, config.seed, 0)
    capture = dg.capture_for(config, scene)
    wanted = dg.Accuracy(target=0.05, max_bounces=bounces, **accuracy)
    return component_curves(config, scene, capture, dg.simulate(scene, capture, wanted, seed=1))


def test_the_curves_add_up_to_the_total() -> None:
    curves = curves_of(configured({"scan": {"rows": 2, "columns": 2}}, {"pde": 0.5}), bounces=5, direct=True)
    assert set(curves.orders) == {"secondary", "higher", "direct"}
    total = sum(curves.parts.values()) + sum(curves.orders.values())
    np.testing.assert_allclose(curves.total, total, rtol=1e-9, atol=curves.total.max() * 1e-12)


def test_both_origins_give_the_same_clock() -> None:
    """Counted from the laser point, the two origins differ by the sensor's leg alone, within a bin."""
    peaks = []
    shared = {"scan": {"kind": "points", "points_m": [[0.2, 0.3]]}}
    sharp = {"pulse_fwhm_ps": 0, "jitter_fwhm_ps": 0}
    for origin in ("wall", "source"):
        config = configured({**shared, "time": {"bins": 1024, "bin_width_ps": 100, "origin": origin}}, sharp)
        curves = curves_of(config)
        peaks.append(float((curves.time_ns * curves.total).sum() / curves.total.sum()))
        scene = dg.generate_scene(config.scene, config.seed, 0)
        capture = dg.capture_for(config, scene)
    leg_ns = np.linalg.norm(capture.laser.targets[0] - capture.sensor.position) / 0.299792458
    assert peaks[1] - peaks[0] == pytest.approx(leg_ns, abs=0.15)


def test_efficiency_and_pulse_act_as_they_should() -> None:
    scan = {"scan": {"rows": 1, "columns": 1}, "time": {"bins": 1024}}
    sharp = curves_of(configured(scan, {"pde": 1, "pulse_fwhm_ps": 0, "jitter_fwhm_ps": 0}))
    broad = curves_of(configured(scan, {"pde": 0.25, "pulse_fwhm_ps": 1500, "jitter_fwhm_ps": 800}))
    assert broad.total.sum() == pytest.approx(0.25 * sharp.total.sum(), rel=1e-6, abs=0)
    moments = []
    for curves in (sharp, broad):
        mean = np.average(curves.time_ns, weights=curves.total)
        moments.append((mean, np.average((curves.time_ns - mean) ** 2, weights=curves.total)))
    assert moments[1][0] == pytest.approx(moments[0][0], abs=1e-3)
    added = (1.5**2 + 0.8**2) / (8 * np.log(2))
    assert moments[1][1] - moments[0][1] == pytest.approx(added, rel=0.02, abs=0)
