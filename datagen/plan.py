"""What a build would make, before it is begun."""

from __future__ import annotations

from datagen.config import DatasetConfig
from datagen.store import measurement_shape, schema_of
from datagen.store.card import readable


def plan_text(config: DatasetConfig) -> str:
    """Sizes and decisions of the dataset that `config` describes.

    Everything that a build would refuse is refused here too (`InputError`): a trial scene is generated, and its
    detector is drawn.
    """
    from datagen.detector import detector_for
    from datagen.pipeline import check_inputs

    check_inputs(config)
    schema = schema_of(config)
    lasers, pixels, bins = measurement_shape(config)
    axis = config.capture.time
    spad, exposure = detector_for(config.detector, config.seed, 0, axis.axis())
    accuracy = config.transport.accuracy()
    lines = [
        f"{config.name}: {config.description}".rstrip(": "),
        "",
        f"scenes       {config.scenes}, seed {config.seed}",
        f"capture      {config.capture.pairing}, {lasers} laser points × {pixels} pixels × {bins} bins of "
        f"{axis.bin_width_ps:g} ps",
        f"transport    {accuracy.lookins} lookins a laser point, {accuracy.fov_samples} FoV samples, up to "
        f"{accuracy.max_bounces} bounces, {accuracy.scramblings} scramblings",
        f"detector     {spad.mode}, PDE {spad.pde:.3g}, {exposure.cycles} cycles at "
        f"{exposure.repetition_rate_hz / 1e6:.3g} MHz (scene 0)",
        f"shards       {schema.shards} of {schema.scenes_per_shard} scenes: at most as many workers have work",
        f"memory       {readable(schema.scenes_per_shard * schema.bytes_per_scene)} for each worker's shard",
        "",
        f"{'field':18}{'one scene':22}{'dtype':9}{'decoded':>10}",
    ]
    for field in schema.fields:
        shape = " × ".join(map(str, field.shape))
        lines.append(f"{field.name:18}{shape:22}{field.dtype:9}{readable(config.scenes * field.bytes_per_scene):>10}")
    lines.append(f"{'all fields':49}{readable(config.scenes * schema.bytes_per_scene):>10}, before compression")
    return "\n".join(lines)
