"""How far objects stand out of the noise in the first scenes of configurations, as a build stores it.

`python tests/benchmarks/evidence.py SCENES TARGET CONFIG…` prints the figures of docs/figures.md: of the first SCENES
scenes of each CONFIG, their light to an error of TARGET where the configured error is smaller, which is quicker.
"""

from __future__ import annotations

import sys

from datagen.bench.measuring import markdown
from datagen.config import DatasetConfig, load_config
from datagen.config.scene_layouts import NoLayout
from datagen.design.exposure import with_exposure_found
from datagen.pipeline import simulate_sample
from datagen.store.columns import Columns
from datagen.store.summaries import KindEvidence, evidence_by_kind


def found_in(config: DatasetConfig, scenes: int, target: float) -> list[KindEvidence]:
    """By kind of object, in the first scenes, and last of all objects together."""
    store = config.store.model_copy(update={"fields": ("histogram",), "histogram_dtype": "uint32"})
    coarser = None if config.transport.target is None else max(target, config.transport.target)
    transport = config.transport.model_copy(update={"target": coarser})
    lean = config.model_copy(update={"store": store, "transport": transport})
    found = Columns(simulate_sample(lean, index).parameters for index in range(scenes))
    return [*evidence_by_kind(found), *evidence_by_kind(found, "all objects")]


def main(scenes: int, target: float, configs: list[str]) -> None:
    """Print the significance of each kind of object."""
    rows = []
    for config in map(with_exposure_found, map(load_config, configs)):
        # A configuration of one scene is about that scene; others go on where they end.
        drawn = config.scenes > 1 and not isinstance(config.scene.layout, NoLayout)
        count = scenes if drawn else min(scenes, config.scenes)
        for kind in found_in(config.with_scenes(max(count, config.scenes)), count, target):
            shares = (f"{100 * share:.0f} %" for share in (kind.under_3, kind.under_1))
            objects = str(kind.objects), f"{kind.median:.3g}"
            rows.append([config.name, str(count), kind.kind, *objects, *shares, f"{kind.exposure_factor:.2g}"])
    head = ["configuration", "scenes", "kind", "objects", "median σ", "under 3 σ", "under 1 σ", "exposure for 90 %"]
    print(markdown(head, rows))


if __name__ == "__main__":
    main(int(sys.argv[1]), float(sys.argv[2]), sys.argv[3:])
