"""The spine: scene spec → Scene → Capture → Transient → histogram → labels → Sample."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict
from functools import partial

import numpy as np
from numpy.typing import NDArray

from datagen.capture import capture_for
from datagen.config import DatasetConfig
from datagen.design.light import light_of, transport_effects
from datagen.design.scene_for import scene_for
from datagen.detector import Exposure, SamplerChoice, Spad, detect_and_choice, detector_for
from datagen.devices import zone_depth
from datagen.effects import EffectDecisions, decide_detector_effects
from datagen.errors import InputError
from datagen.evidence import evidence_image, light_in_sight
from datagen.evidence.image import representative_pairs
from datagen.evidence.own import UNKNOWN, Evidence, evidence_and_gain, evidence_parameters, evidence_tables
from datagen.evidence.presence import UNKNOWN as PRESENCE_UNKNOWN
from datagen.evidence.presence import Presence, presence_evidence, presence_parameters, presence_table
from datagen.labels import LABEL_FIELDS, make_labels
from datagen.labels.frame import scan_place
from datagen.labels.images import hidden_surface
from datagen.records import Capture, Sample, Scalar, Scene, TimeAxis, Transient
from datagen.records.arrays import Floats
from datagen.records.sample import SCAN_PLACE, geometry_fields
from datagen.seeding import Purpose, derived_seed
from datagen.transport.visibility.coincidence import set_apart
from datagen.transport.visibility.lines_of_sight import lit_points, seen_points
from datagen.transport.visibility.raycast import Raycaster

BACKGROUND_FIELDS = ("background_histogram", "background_transient")


def simulate_sample(config: DatasetConfig, index: int) -> Sample:
    """Scene number `index` of a dataset, from the room to the counts.

    A function of its arguments alone: every random stream is keyed by (`config.seed`, index, purpose).
    """
    seconds = dict[str, float]()
    with _timed(seconds, "scene"):
        scene = scene_for(config, index)
        capture = capture_for(config, scene, config.seed, index)
    return sample_of(config, index, scene, capture, seconds=seconds)


def sample_of(
    config: DatasetConfig, index: int, scene: Scene, capture: Capture, given: Floats | None = None, *,
    seconds: dict[str, float] | None = None,
) -> Sample:  # fmt: skip
    """Sample `index` of a scene and a capture, wherever these come from: light, counts, labels.

    given : (L, P, T) transient of another simulator, in place of ours. seconds : wall-clock seconds by stage so far,
    to which those of the stages here are added.
    """
    seed, seconds = config.seed, dict[str, float]() if seconds is None else seconds
    with _timed(seconds, "effects"):
        scene = set_apart(scene, capture).scene
        caster = Raycaster(scene)
        effects = EffectDecisions((), 0.0)
        if given is None:
            effects = transport_effects(config, scene, capture, index, caster)
    spad, exposure = detector_for(config.detector, seed, index, capture.time)
    with _timed(seconds, "transport"):
        if given is None:
            light = light_of(config, index, scene, capture, effects, spad, exposure, caster)
            transient = light.transient()
            if np.isnan(transient.laser_points).all():
                raise InputError("laser: its rays meet no surface of the scene; aim Laser.targets at the relay wall")
        else:
            stderr, overflow = np.full(given.shape, np.nan), np.zeros(given.shape[:2])
            lit = lit_points(caster, capture.laser)
            transient = Transient(capture.time, {"given": given}, {}, stderr, overflow, lit.position)
    total = transient.total
    with _timed(seconds, "effects"):
        effects += detector_effects(config, total, transient.time, spad, exposure)
    with _timed(seconds, "detector"):
        used, conditions, tolerance = effects.apply_detector(spad, exposure, config.detector.tolerance)
        detect_counts = partial(
            detect_and_choice, time=capture.time, spad=used, exposure=conditions, tolerance=tolerance,
            approximate=config.detector.approximate,
        )  # fmt: skip
        counts, sampler = detect_counts(total, seed=derived_seed(seed, index, Purpose.DETECTOR))
    measured = {"histogram": counts, "transient": total, "transient_stderr": transient.stderr}
    if given is None and any(field in BACKGROUND_FIELDS for field in config.store.fields):
        with _timed(seconds, "background"):
            empty = light.background().total
            empty_counts, _ = detect_counts(empty, seed=derived_seed(seed, index, Purpose.BACKGROUND))
        measured |= {"background_histogram": empty_counts, "background_transient": empty}
    has_evidence_image = "evidence" in config.store.fields
    with _timed(seconds, "labels"):
        surface = hidden_surface(scene, config.labels.rows, config.labels.columns) if has_evidence_image else None
    with _timed(seconds, "evidence"):
        # A transient that another simulator made is not split by object.
        parts = scene.objects if given is None else ()
        scan_pairs = representative_pairs(caster, scene, capture) if has_evidence_image else None
        in_sight = light_in_sight(light.scene, capture, light.accuracy, light.seed, caster) if parts else {}
        evidence, gain = evidence_and_gain(transient, used, conditions, parts, scan_pairs, in_sight)
        evidence = evidence if given is None else dict.fromkeys(scene.objects, UNKNOWN)
        image = {} if surface is None else {"evidence": evidence_image(caster, surface, capture, scan_pairs, gain)}
    presence = dict[str, Presence]()
    if "presence" in config.store.fields:
        with _timed(seconds, "presence"):
            presence = dict.fromkeys(scene.objects, PRESENCE_UNKNOWN)
            if given is None:
                presence = presence_evidence(
                    light.scene, capture, light.accuracy, used, conditions, seed=light.seed, transient=transient
                )
    with _timed(seconds, "labels"):
        wanted = [field for field in config.store.fields if field in LABEL_FIELDS]
        capacity = config.scene.most_objects()
        labels = make_labels(config.labels, scene, wanted, config.scene.object_classes(), capacity, surface)
        if "objects" in wanted:
            labels |= evidence_tables(tuple(evidence.values()), capacity)
        if "zone_depth" in config.store.fields:
            labels["zone_depth"] = zone_depth(scene, capture).astype(np.float32)
        if "presence" in config.store.fields:
            labels["object_presence"] = presence_table(tuple(presence.values()), capacity)
    arrays: dict[str, NDArray[np.generic]] = {
        name: values for name, values in measured.items() if name in config.store.fields
    }
    wall, view = (
        None if face is None else np.stack([face.center, face.right, face.up])
        for face in (scene.relay_wall, scene.hidden_view)
    )
    arrays |= labels | image | geometry_fields(
        lit_points(caster, capture.laser), capture.sensor.pixels, seen_points(caster, capture.sensor),
        capture.laser.position, capture.sensor.position, wall, view, scene.hidden_bounds,
    )  # fmt: skip
    parameters = _parameters(scene, spad, exposure, effects, sampler, transient, evidence, counts)
    return Sample(index, arrays, parameters | presence_parameters(presence), seconds)


def detector_effects(
    config: DatasetConfig, total: Floats, time: TimeAxis, spad: Spad, exposure: Exposure
) -> EffectDecisions:
    """The detector's effects that a transient calls for, each with its estimate."""
    return decide_detector_effects(total, time, spad, exposure, config.effects, config.detector.tolerance)


@contextmanager
def _timed(seconds: dict[str, float], stage: str) -> Iterator[None]:
    """Add the wall-clock seconds of the `with` block to those of a stage."""
    start = time.perf_counter()
    yield
    seconds[stage] = seconds.get(stage, 0.0) + time.perf_counter() - start


def _parameters(
    scene: Scene, spad: Spad, exposure: Exposure, effects: EffectDecisions, sampler: SamplerChoice,
    transient: Transient, evidence: Mapping[str, Evidence], counts: NDArray[np.integer],
) -> dict[str, Scalar]:  # fmt: skip
    inside, outside = float(transient.total.sum()), float(transient.overflow.sum())
    # The position of the scan on the label images.
    place = None if scene.hidden_view is None else scan_place(scene.hidden_view, transient.laser_points)
    return {
        **scene.parameters,
        "scene.part_names": ",".join(scene.part_names),
        **({} if place is None else dict(zip(SCAN_PLACE, place, strict=True))),
        **_scalars("detector", asdict(spad)),
        **_scalars("exposure", asdict(exposure)),
        **effects.parameters(),
        **_scalars("sampler", sampler.parameters()),
        "transient.energy": inside,
        "transient.overflow": outside / (inside + outside) if inside + outside > 0 else 0.0,
        "transient.relative_error": transient.relative_error,
        **({} if transient.met_target is None else {"transient.target_met": transient.met_target}),
        **_scalars("transient.part_error", transient.part_errors),
        **({} if transient.spend is None else _scalars("transport.spend", transient.spend.parameters())),
        **evidence_parameters(evidence),
        "histogram.counts": int(counts.sum()),
    }


def _scalars(prefix: str, values: Mapping[str, object]) -> dict[str, Scalar]:
    """Those values that a table can hold, by dotted name."""
    return {f"{prefix}.{name}": value for name, value in values.items() if isinstance(value, Scalar)}
