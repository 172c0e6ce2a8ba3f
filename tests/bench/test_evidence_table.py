"""The table of evidence says what a build would store."""

from __future__ import annotations

from pathlib import Path

from click.testing import CliRunner

from datagen.bench.evidence import found_in, main
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
    box, pillar, every = found_in(config, 2)
    assert (every.kind, every.objects) == ("all objects", 6)
    assert (box.kind, box.objects, pillar.kind, pillar.objects) == ("box", 4, "pillar", 2)
    of = [simulate_sample(config, k).parameters["evidence.pillar.significance"] for k in range(2)]
    assert pillar.median == sum(map(float, of)) / 2


def test_scenes_go_on_where_the_configuration_ends(tmp_path: Path) -> None:
    (tmp_path / "few.yaml").write_text(
        "{name: few, scenes: 2, scene: {contents: [{kind: box}]}, transport: {target: 0.3},"
        " capture: {scan: {rows: 1, columns: 2}, time: {bins: 64, bin_width_ps: 800}}}"
    )
    told = CliRunner().invoke(
        main, [str(tmp_path / "few.yaml"), "--scenes", "5", "--no-kinds"], catch_exceptions=False
    )
    assert "| few | 5 | all objects | 5 |" in told.output
