"""What a build would make and how, before it is begun."""

from __future__ import annotations

from datagen.config import DatasetConfig
from datagen.store import schema_of
from datagen.store.card import readable

PILOT_LOOKINS = 256
"""Lookins of the pilot transient from which the detector's flux is estimated."""


def plan_text(config: DatasetConfig) -> str:
    """Sizes and decisions of the dataset that `config` describes.

    Everything that a build would refuse is refused here too (`InputError`). The detector's decision is taken on scene
    0, with a transient of `PILOT_LOOKINS` lookins; a build decides anew for every scene, with the whole transient.
    """
    from datagen.pipeline import check_inputs

    check_inputs(config)
    schema = schema_of(config)
    lasers, pixels, bins = config.capture.shape
    accuracy = config.transport.accuracy()
    bounces = "all orders" if accuracy.max_bounces is None else f"up to {accuracy.max_bounces} bounces"
    lines = [
        f"{config.name}: {config.description}".rstrip(": "),
        "",
        f"scenes       {config.scenes}, seed {config.seed}",
        f"capture      {config.capture.pairing}, {lasers} laser points × {pixels} pixels × {bins} bins of "
        f"{config.capture.time.bin_width_ps:g} ps",
        f"transport    {accuracy.lookins} lookins a laser point, {accuracy.fov_samples} FoV samples, {bounces}, "
        f"{accuracy.scramblings} scramblings",
        *_detector_lines(config),
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


def _detector_lines(config: DatasetConfig) -> list[str]:
    from datagen.capture import capture_for
    from datagen.detector import detector_for, plan_detector
    from datagen.records import Accuracy
    from datagen.scene import generate_scene
    from datagen.transport import simulate

    scene = generate_scene(config.scene, config.seed, 0)
    capture = capture_for(config, scene, config.seed, 0)
    full = config.transport.accuracy()
    few = Accuracy(min(full.lookins, PILOT_LOOKINS), 1, full.max_bounces, 1, full.direct)
    pilot = simulate(scene, capture, few, seed=0, split_parts=False)
    spad, exposure = detector_for(config.detector, config.seed, 0, capture.time)
    decided = plan_detector(
        pilot.total,
        capture.time,
        spad,
        exposure,
        tolerance=config.detector.tolerance,
        approximate=config.detector.approximate,
    )
    return [
        f"detector     {spad.mode}, PDE {spad.pde:.3g}, {exposure.cycles} cycles at "
        f"{exposure.repetition_rate_hz / 1e6:.3g} MHz (scene 0)",
        f"sampler      {decided.sampler}: {decided.reason}",
        f"             {decided.flux_per_cycle:.2g} events a cycle, {decided.detections:.2g} detections in the "
        "brightest histogram (scene 0, pilot transient)",
    ]
