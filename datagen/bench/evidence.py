"""How far objects stand out of the noise in the first scenes of configurations, as a build stores it."""

from __future__ import annotations

import click

from datagen.bench.measuring import markdown
from datagen.config import DatasetConfig, load_config
from datagen.config.scene_layouts import NoLayout
from datagen.design.exposure import with_exposure_found
from datagen.pipeline import simulate_sample
from datagen.store.summaries import KindEvidence, evidence_by_kind

EVERY = "all objects"


def found_in(config: DatasetConfig, scenes: int, target: float | None = None) -> list[KindEvidence]:
    """By kind of object, in the first scenes, and last of all objects together.

    target : error of the light, where a coarser one than the configured will do.
    """
    store = config.store.model_copy(update={"fields": ("histogram",), "histogram_dtype": "uint32"})
    transport = config.transport
    if target is not None and transport.target is not None:
        transport = transport.model_copy(update={"target": max(target, transport.target)})
    lean = config.model_copy(update={"store": store, "transport": transport})
    found = [simulate_sample(lean, index).parameters for index in range(scenes)]
    return [*evidence_by_kind(found), *evidence_by_kind(found, EVERY)]


@click.command()
@click.argument("configs", nargs=-1, required=True)
@click.option("--scenes", default=100, show_default=True, type=click.IntRange(1), help="Scenes of each.")
@click.option("--target", type=float, help="A coarser error of the light, such as 0.1, which is quicker.")
@click.option("--kinds/--no-kinds", default=True, help="A row for each kind of object.")
def main(configs: tuple[str, ...], scenes: int, target: float | None, kinds: bool) -> None:
    """Print the significance of each kind of object in the first scenes of CONFIGS."""
    loaded = [with_exposure_found(load_config(config)) for config in configs]
    rows = []
    for config in loaded:
        # A configuration of one scene is about that scene; others go on where they end.
        drawn = config.scenes > 1 and not isinstance(config.scene.layout, NoLayout)
        count = scenes if drawn else min(scenes, config.scenes)
        config = config.with_scenes(max(count, config.scenes))
        for kind in found_in(config, count, target)[0 if kinds else -1 :]:
            shares = (f"{100 * share:.0f} %" for share in (kind.under_3, kind.under_1))
            factor = f"{kind.exposure_factor:.2g}"
            rows.append(
                [config.name, str(count), kind.kind, str(kind.objects), f"{kind.median:.3g}", *shares, factor]
            )
    head = ["configuration", "scenes", "kind", "objects", "median σ", "under 3 σ", "under 1 σ", "exposure for 90 %"]
    click.echo(markdown(head, rows))
