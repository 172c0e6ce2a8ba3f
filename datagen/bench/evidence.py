"""How far objects stand out of the noise in the first scenes of configurations, as a build stores it."""

from __future__ import annotations

import click

from datagen.bench.measuring import markdown
from datagen.config import DatasetConfig, load_config
from datagen.pipeline import simulate_sample
from datagen.store.evidence_told import KindEvidence, evidence_by_kind


def found_in(config: DatasetConfig, scenes: int) -> list[KindEvidence]:
    """By kind of object, in the first scenes."""
    store = config.store.model_copy(update={"fields": ("histogram",)})
    lean = config.model_copy(update={"store": store})
    return evidence_by_kind(simulate_sample(lean, index).parameters for index in range(scenes))


@click.command()
@click.argument("configs", nargs=-1, required=True)
@click.option("--scenes", default=100, show_default=True, type=click.IntRange(1), help="Scenes of each.")
def main(configs: tuple[str, ...], scenes: int) -> None:
    """Print the significance of each kind of object in the first scenes of CONFIGS."""
    loaded = [load_config(config) for config in configs]
    rows = []
    for config in loaded:
        count = min(scenes, config.scenes)
        for kind in found_in(config, count):
            shares = (f"{100 * share:.0f} %" for share in (kind.under_3, kind.under_1))
            factor = f"{kind.exposure_factor:.2g}"
            rows.append(
                [config.name, str(count), kind.kind, str(kind.objects), f"{kind.median:.3g}", *shares, factor]
            )
    head = ["configuration", "scenes", "kind", "objects", "median σ", "under 3 σ", "under 1 σ", "exposure for 90 %"]
    click.echo(markdown(head, rows))
