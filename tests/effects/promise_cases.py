"""Random scenes, captures and detectors, from dim to bright, for the promise that `promise.py` tests."""

from __future__ import annotations

from typing import Any

import numpy as np

from datagen.config import DatasetConfig, config_from_mapping
from scene_library.layouts import LAYOUTS

SAMPLES = 256


def random_case(index: int, seed: int = 0, samples: int = SAMPLES) -> DatasetConfig:
    """Case `index`: a configuration of one scene, each part of it drawn from a range that spans what matters and what
    does not: bright and black walls, lobes and nearly none, clear air and fog, windows long and short, photons from
    hardly any to pile-up. The same index and seed give the same case."""
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(index,)))
    capture = _capture(rng)
    return config_from_mapping(
        {
            "name": f"case {index}",
            "seed": int(rng.integers(2**31)),
            "scenes": 1,
            "scene": _scene(rng),
            "capture": capture,
            "transport": {
                "samples": samples,
                "max_bounces": _one_of(rng, [3, 4, 5, 6, None]),
                "direct": bool(rng.random() < 0.5),
            },
            "detector": _detector(rng, array="field_of_view" in capture),
        }
    )


def nearly_everything_skipped(samples: int = SAMPLES) -> DatasetConfig:
    """A bright object before black walls, in clear enough air, seen by a slow detector in hardly any light."""
    dark: dict[str, Any] = {"albedo": 1e-5, "brdf": {"kind": "oren_nayar", "sigma_deg": 0.2}}
    return config_from_mapping(
        {
            "name": "nearly everything skipped",
            "scene": {
                "layout": {"kind": "l_corridor"},
                "contents": [{"kind": "box", "height_m": 1.4, "width_m": 0.9, "depth_m": 0.9, "albedo": 0.9}],
                "materials": {"walls": dark, "floor": dark, "ceiling": dark, "relay_wall": {"albedo": 0.03}},
                "attenuation_per_m": 1e-6,
            },
            "capture": {
                "scan": {"kind": "grid", "rows": 6, "columns": 6},
                "time": {"bins": 32, "bin_width_ps": 4000, "start_ns": 8.0},
            },
            "transport": {
                "samples": samples, "max_bounces": None, "direct": True,
            },
            "detector": {
                "mode": "free_running", "photons_per_pulse": 1e6, "cycles": 10000, "dark_count_rate_hz": 1e-4,
                "ambient_rate_hz": 1e-3, "dead_time_ns": 10, "repetition_rate_mhz": 1, "tdc_dnl": 1e-5,
            },
        }
    )  # fmt: skip


def nearly_nothing_skipped(samples: int = SAMPLES) -> DatasetConfig:
    """A bright, glossy, foggy room whose confocal pixels see the laser spot, and a detector at its limits."""
    shiny: dict[str, Any] = {"albedo": 0.85, "brdf": {"kind": "phong", "exponent": 8, "specular": 0.5}}
    return config_from_mapping(
        {
            "name": "nearly nothing skipped",
            "scene": {
                "layout": {"kind": "corridor_room"},
                "contents": [{"kind": "box", "albedo": 0.8}, {"kind": "pillar", "albedo": 0.8}],
                "materials": {"walls": shiny, "floor": shiny, "ceiling": shiny, "relay_wall": {"albedo": 0.9}},
                "attenuation_per_m": 0.02,
            },
            "capture": {
                "pairing": "exhaustive",
                "scan": {"kind": "grid", "rows": 3, "columns": 3},
                "field_of_view": {"rows": 3, "columns": 3},
                "time": {"bins": 256, "bin_width_ps": 200},
            },
            "transport": {
                "samples": 2 * samples, "max_bounces": None, "direct": True,
            },
            "detector": {
                "mode": "free_running", "photons_per_pulse": 1e7, "cycles": 10000, "dark_count_rate_hz": 1e4,
                "ambient_rate_hz": 1e6, "dead_time_ns": 60, "afterpulse_probability": 0.05, "counter_max": 60,
                "crosstalk_probability": 0.01, "array_columns": 3, "repetition_rate_mhz": 10, "pulse_fwhm_ps": 200,
                "gate": {"start_ns": 2.0, "width_ns": 40.0}, "tdc_dnl": 0.9,
            },
        }
    )  # fmt: skip


def _one_of(rng: np.random.Generator, choices: list[Any]) -> Any:
    return choices[int(rng.integers(len(choices)))]


def _log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    return float(low * (high / low) ** rng.random())


def _scene(rng: np.random.Generator) -> dict[str, Any]:
    brightness = _one_of(rng, ["bright", "bright", "dim", "black"])
    low, high = {"bright": (0.4, 0.95), "dim": (0.02, 0.2), "black": (1e-4, 3e-3)}[brightness]

    def surface() -> dict[str, Any]:
        return {"albedo": float(rng.uniform(low, high)), "brdf": _brdf(rng)}

    objects = [
        {"kind": _one_of(rng, ["box", "pillar"]), "albedo": float(rng.uniform(0.1, 0.95)), "brdf": _brdf(rng)}
        for _ in range(int(rng.integers(1, 4)))
    ]
    return {
        "layout": {"kind": _one_of(rng, [*LAYOUTS])},
        "contents": objects,
        "materials": {
            "relay_wall": {"albedo": float(rng.uniform(0.3, 0.95)), "brdf": _brdf(rng, at_wall=True)},
            **{name: surface() for name in ("walls", "floor", "ceiling", "screen")},
        },
        "attenuation_per_m": _one_of(rng, [0.0, 0.0, _log_uniform(rng, 1e-6, 1e-1)]),
    }


def _brdf(rng: np.random.Generator, at_wall: bool = False) -> dict[str, Any]:
    """Most surfaces are Lambertian, or nearly; the others have a lobe."""
    kind = _one_of(rng, ["lambertian"] * 7 + ["oren_nayar"] * 2 + ([] if at_wall else ["phong", "ggx", "sin_lobe"]))
    if kind == "oren_nayar":
        return {"kind": kind, "sigma_deg": _log_uniform(rng, 0.1, 40.0)}
    if kind == "phong":
        return {"kind": kind, "exponent": float(rng.uniform(1, 40)), "specular": _log_uniform(rng, 1e-4, 1.0)}
    if kind == "ggx":
        return {"kind": kind, "roughness": float(rng.uniform(0.3, 1.0))}
    return {"kind": kind}


def _capture(rng: np.random.Generator) -> dict[str, Any]:
    bins, width_ps = _one_of(rng, [(256, 200), (128, 400), (256, 100), (48, 2000), (24, 4000)])
    time = {
        "bins": bins,
        "bin_width_ps": width_ps,
        "start_ns": _one_of(rng, [0.0, 0.0, 3.0]),
        "origin": "wall",
    }
    if rng.random() < 0.5:
        return {"scan": {"kind": "grid", "rows": 6, "columns": 6}, "time": time}
    return {
        "pairing": "exhaustive",
        "scan": {"kind": "grid", "rows": 3, "columns": 3},
        "field_of_view": {"rows": 3, "columns": 4},
        "time": time,
    }


def _detector(rng: np.random.Generator, array: bool) -> dict[str, Any]:
    settings: dict[str, Any] = {
        "detector_class": "any",
        "mode": _one_of(rng, ["ideal", "synchronous", "free_running", "free_running"]),
        "photons_per_pulse": _log_uniform(rng, 1e2, 1e9),
        "cycles": float(_one_of(rng, [100, 1000, 10000])),
        "ambient_rate_hz": _one_of(rng, [0.0, _log_uniform(rng, 1e-2, 1e6)]),
        "pulse_fwhm_ps": _one_of(rng, [0.0, 50.0, 300.0]),
        "counter_max": _one_of(rng, [None, 30, 255, 65535]),
        "approximate": True,
    }
    if rng.random() < 0.4:
        settings["gate"] = {"start_ns": _one_of(rng, [3.0, 8.0]), "width_ns": _one_of(rng, [10.0, 20.0])}
    if rng.random() < 0.5:
        settings["afterpulse_probability"] = _log_uniform(rng, 1e-6, 0.1)
    # One pixel alone has no neighbours to share its avalanches with.
    crosstalk = _log_uniform(rng, 1e-6, 0.02) if rng.random() < 0.5 else 1e-3
    settings["tdc_dnl"] = _one_of(rng, [0.0, 0.0, _log_uniform(rng, 1e-6, 0.5)])
    if array:
        return settings | {"crosstalk_probability": crosstalk, "array_columns": 4}
    return settings | {"crosstalk_probability": 0.0}
