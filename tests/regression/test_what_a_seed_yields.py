"""What a seed yields changes only together with the schema version.

    python tests/regression/test_what_a_seed_yields.py

renews `what_a_seed_yields.json`: once, after `SCHEMA_VERSION` of `datagen/store/schema.py` was raised.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from datagen.config import DatasetConfig, config_from_mapping
from datagen.pipeline import simulate_sample
from datagen.store.schema import SCHEMA_VERSION

KEPT = Path(__file__).with_suffix(".json").with_stem("what_a_seed_yields")
REMEDY = (
    "a seed yields something else than it did under schema version {version}. If that is meant: raise SCHEMA_VERSION "
    "in datagen/store/schema.py and say why there and in CHANGELOG.md, keep a small dataset of the version before in "
    "tests/regression/, and renew this file with `python tests/regression/test_what_a_seed_yields.py`"
)
LIBRARY = {"kind": "library", "classes": ["chair", "letter_a", "mannequin"]}
CASES: dict[str, dict[str, Any]] = {
    "ideal": {
        "scene": {"layout": {"kind": "l_corridor"}, "contents": [{"kind": "pillar"}, {"kind": "box"}]},
        "detector": {"mode": "ideal"},
        "transport": {"lookins": 256, "fov_samples": 1, "max_bounces": 4},
    },
    "free running": {
        "scene": {"layout": {"kind": "doorway_room"}, "contents": [LIBRARY]},
        "detector": {"mode": "free_running", "photons_per_pulse": 3.0e8},
        "transport": {"lookins": 256, "fov_samples": 1, "max_bounces": None},
    },
    "synchronous, to a target": {
        "scene": {"layout": {"kind": "t_corridor"}, "contents": [{"kind": "box", "count": {"choice": [1, 2]}}]},
        "capture": {"scan": {"kind": "random", "count": 4}},
        "detector": {"mode": "synchronous", "detector_class": "lab_si"},
        "transport": {"target": 0.2},
    },
}
SCENES = 2


def config_of(case: str) -> DatasetConfig:
    capture = {"scan": {"rows": 2, "columns": 2}, "time": {"bins": 64, "bin_width_ps": 800}}
    labels = {"labels": {"rows": 4, "columns": 6, "voxels": [4, 4, 4]}}
    store = {"store": {"fields": ["histogram", "transient", "depth", "occupancy"]}}
    return config_from_mapping({"seed": 5, "capture": capture} | labels | store | CASES[case])


def yielded(case: str) -> list[dict[str, Any]]:
    """Of each scene its parameters, and every field summed over all but its first axis."""
    samples = [simulate_sample(config_of(case), index) for index in range(SCENES)]
    return [
        dict(sample.parameters)
        | {f"sum of {name}": _sums(np.asarray(values, np.float64)) for name, values in sample.arrays.items()}
        for sample in samples
    ]


def _sums(values: np.ndarray) -> list[float]:
    sums: list[float] = np.nansum(values.reshape(len(values), -1), axis=1).tolist()
    return sums


def differences(then: dict[str, Any], now: dict[str, Any]) -> list[str]:
    """Names whose values differ: numbers by more than 1e-6, which is far above what another processor's rounding
    comes to, and far below what another draw does."""
    names = sorted(then.keys() ^ now.keys())
    for name in then.keys() & now.keys():
        if name.endswith(".reason"):
            # Words for people; a better one changes no data.
            continue
        a, b = then[name], now[name]
        number = not isinstance(a, (str, bool)) and not isinstance(b, (str, bool))
        same = np.allclose(a, b, rtol=1e-6, atol=1e-9 * np.max(np.abs(a))) if number else a == b
        if not same:
            names.append(f"{name}: {a} → {b}")
    return names


@pytest.mark.parametrize("case", CASES)
def test_a_seed_yields_what_it_did(case: str) -> None:
    kept = json.loads(KEPT.read_text())
    remedy = REMEDY.format(version=kept["schema_version"])
    assert kept["schema_version"] == SCHEMA_VERSION, f"the schema version was raised: renew {KEPT.name}"
    for index, (then, now) in enumerate(zip(kept["cases"][case], yielded(case), strict=True)):
        assert not (changed := differences(then, now)), f"{remedy}. {case}, scene {index}: {'; '.join(changed)}"


if __name__ == "__main__":
    cases = {case: json.loads(json.dumps(yielded(case), default=lambda value: value.item())) for case in CASES}
    text = json.dumps({"schema_version": SCHEMA_VERSION, "cases": cases}, indent=1, ensure_ascii=False)
    KEPT.write_text(text + "\n")
    print(f"{KEPT}: {len(text)} bytes")
