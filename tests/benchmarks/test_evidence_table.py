"""The table of evidence says what a build would store."""

from __future__ import annotations

from benchmarks.evidence import found_in

from datagen.config import config_from_mapping
from datagen.pipeline import simulate_sample


def test_it_is_that_of_the_samples() -> None:
    config = config_from_mapping(
        {
            "scenes": 3,
            "scene": {"contents": [{"kind": "pillar"}, {"kind": "box", "count": 2}]},
            "capture": {"scan": {"rows": 1, "columns": 2}, "time": {"bins": 64, "bin_width_ps": 800}},
            "transport": {"target": 0.3},
        }
    )
    box, pillar, every = found_in(config, 2, 0.0)
    assert (every.kind, every.objects) == ("all objects", 6)
    assert (box.kind, box.objects, pillar.kind, pillar.objects) == ("box", 4, "pillar", 2)
    of = [simulate_sample(config, k).parameters["evidence.pillar.significance"] for k in range(2)]
    assert pillar.median == sum(map(float, of)) / 2
