"""The spine: scene spec → Scene → Capture → Transient → histogram → labels → Sample."""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict
from functools import partial
from itertools import islice
from warnings import warn

import numpy as np
from numpy.typing import NDArray

from datagen.capture import capture_for
from datagen.config import DatasetConfig
from datagen.config.distributions import largest_count
from datagen.design.light import light_of, transport_effects
from datagen.design.scene_for import scene_for
from datagen.detector import Exposure, SamplerChoice, Spad, choose_sampler, detect_and_choice, detector_for
from datagen.devices import share_of_late_zones, zone_depth
from datagen.effects import EffectDecisions, decide_detector_effects
from datagen.errors import InputError, InputWarning
from datagen.evidence import evidence_image, light_in_sight
from datagen.evidence.image import representative_pairs
from datagen.evidence.own import UNKNOWN, Evidence, evidence_and_gain, evidence_parameters, evidence_tables
from datagen.evidence.presence import UNKNOWN as PRESENCE_UNKNOWN
from datagen.evidence.presence import Presence, presence_evidence, presence_parameters, presence_table
from datagen.labels import MADE_HERE, make_labels
from datagen.labels.frame import scan_place
from datagen.labels.images import hidden_surface
from datagen.labels.solids import LARGEST_HOLE_SHARE, open_share
from datagen.labels.triangles import open3d_for_labels
from datagen.records import Capture, Sample, Scalar, Scene, TimeAxis, Transient
from datagen.records.arrays import Floats
from datagen.records.label_fields import LABEL_FIELDS
from datagen.records.sample import SCAN_PLACE, geometry_fields
from datagen.scene import check_scene_config, meshes_named
from datagen.seeding import Purpose, derived_seed
from datagen.transport.visibility.coincidence import set_apart
from datagen.transport.visibility.lines_of_sight import lit_points, seen_points
from datagen.transport.visibility.raycast import Raycaster
from datagen.units import path_from_time

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
        wanted = [field for field in config.store.fields if field in MADE_HERE]
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


SCENES_TRIED = 16
"""Scenes that are generated before a build, without light, to find a configuration that cannot be simulated. With
half as many, one that fails in one scene of ten would pass 43 % of the time instead of 19 %."""
LIT_SCENES_TRIED = 4
"""The same where scenes are accepted by their light, which takes seconds for each: half as many find less, sooner."""


LATE_SCENES = 0.25
"""Share of the scenes tried in which most zones may look beyond the end of the time axis. Halved, sensors that look
into large rooms on purpose are warned of, too."""


def check_inputs(config: DatasetConfig) -> None:
    """Raise `InputError` for what can be found wrong before a dataset is begun: mesh files, a room that cannot be
    furnished or a capture that does not fit it (the first `SCENES_TRIED` scenes are generated), an impossible
    detector, labels without Open3D. Warn of what is possible but most likely not meant: no objects, volumes of meshes
    with holes, bent faces of meshes, parts in one place, and zones whose light arrives after the time axis ends.
    """
    check_scene_config(config.scene)
    if any((of.is_image or of.is_volume) and of.label in config.store.fields for of in LABEL_FIELDS):
        # Labels come last in a scene: without this the light of all scenes would be made in vain.
        open3d_for_labels()
    most = LIT_SCENES_TRIED if config.scene.asks_for_evidence else SCENES_TRIED
    tried = [_tried(config, index) for index in range(min(config.scenes, most))]
    capture = tried[0][1]
    spad, exposure = detector_for(config.detector, config.seed, 0, capture.time)
    dark = np.zeros((1, *capture.shape[1:]))
    tolerance, approximate = config.detector.tolerance, config.detector.approximate
    choose_sampler(dark, capture.time, spad, exposure, tolerance=tolerance, approximate=approximate)
    for warning in (*_most_likely_not_meant(config), *parts_in_one_place(tried), *_too_late(config, tried)):
        warn(warning, InputWarning, stacklevel=3)


def _most_likely_not_meant(config: DatasetConfig) -> Iterator[str]:
    """A warning for each thing that is possible and most likely not meant: no objects; meshes with holes or bent
    faces."""
    if not any(largest_count(item.count) for item in config.scene.contents):
        yield (
            "scene.contents: no scene has an object, so nothing is hidden and labels are empty; list some, or leave "
            "the key out for a pillar and a box"
        )
    volumes = [of.name for of in LABEL_FIELDS if of.is_volume and of.label in config.store.fields]
    meshes = list(meshes_named(config.scene))
    for where, _, doubt in meshes:
        if doubt:
            yield f"{where}: {doubt}"
    closed = meshes if volumes else ()
    holed = [where for where, of, _ in closed if open_share(of.vertices[of.triangles]) > LARGEST_HOLE_SHARE]
    if holed:
        more = f" and {len(holed) - 1} more" if len(holed) > 1 else ""
        yield (
            f"{holed[0]}{more}: the mesh is not closed, so it has no inside: only its surface is in "
            f"{' and '.join(volumes)}; close it in a mesh editor, or leave the field out (store.fields)"
        )


def parts_in_one_place(scenes: Iterable[tuple[Scene, Capture]]) -> Iterator[str]:
    """A warning if parts of one of the first `SCENES_TRIED` scenes lie in one place."""
    for index, (scene, capture) in enumerate(islice(scenes, SCENES_TRIED)):
        warning = set_apart(scene, capture).warning
        if warning:
            yield f"scene {index}: {warning}"
            return


def _too_late(config: DatasetConfig, tried: Sequence[tuple[Scene, Capture]]) -> Iterator[str]:
    """A warning if in many of the scenes tried most zones get their direct light after the time axis ends."""
    if not config.transport.direct or config.capture.time.origin != "source":
        return
    late = sum(share_of_late_zones(scene, capture) > 0.5 for scene, capture in tried)
    if late > LATE_SCENES * len(tried):
        reach_m = float(path_from_time(config.capture.time.axis().stop_s)) / 2
        yield (
            f"capture: in {late} of {len(tried)} scenes most zones see things farther away than the time axis "
            f"reaches ({reach_m:.2g} m), so their histograms are empty; bring the device nearer "
            "(at_objects.distance_m, layout.relay_distance_m), or take more bins"
        )


def _tried(config: DatasetConfig, index: int) -> tuple[Scene, Capture]:
    """Scene `index`, generated without light, and its capture; an `InputError` names any scene but the first."""
    scene = scene_for(config, index)
    try:
        return scene, capture_for(config, scene, config.seed, index)
    except InputError as error:
        if index == 0:
            raise
        raise InputError(f"scene {index} (seed {config.seed}): {error}") from None


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
