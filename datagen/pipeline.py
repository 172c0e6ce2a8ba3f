"""The spine: configuration → Scene → Capture → light → counts → labels → Sample."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from datagen.capture import capture_for, sensor_way
from datagen.config import DatasetConfig
from datagen.design.light import Light, light_of, transport_effects
from datagen.design.scene_for import scene_for
from datagen.detector import Exposure, SamplerChoice, Spad, detect_and_choice, detector_for
from datagen.detector.carry_over import check_carry_over
from datagen.devices import zone_depth
from datagen.effects import EffectDecisions, decide_detector_effects
from datagen.effects.transport_effects import TRANSPORT_EFFECTS
from datagen.errors import InputError
from datagen.evidence import evidence_image, light_in_sight
from datagen.evidence.change import change_parameters, change_tables, changes_of
from datagen.evidence.image import ScanPairs, representative_pairs
from datagen.evidence.own import UNKNOWN, Evidence, evidence_and_gain, evidence_parameters, evidence_tables
from datagen.evidence.presence import UNKNOWN as PRESENCE_UNKNOWN
from datagen.evidence.presence import Presence, presence_against, presence_parameters, presence_table
from datagen.labels import LABEL_MAKERS, Truth
from datagen.labels.frame import scan_place
from datagen.labels.motion import motion_tables
from datagen.records import Capture, Clock, Sample, Scalar, Scene, SequenceLight, TimeAxis, Transient
from datagen.records.arrays import Floats, l2_norm
from datagen.records.label_fields import LABEL_FIELDS
from datagen.records.sample import OF_THE_ROOM, SCAN_PLACE, geometry_fields
from datagen.seeding import Purpose, derived_seed
from datagen.transport.coincidence import set_apart
from datagen.transport.lines_of_sight import lit_points, seen_points
from datagen.transport.rays import Raycaster

BACKGROUND_FIELDS = ("background_histogram", "background_transient")


@dataclass(frozen=True)
class Stage:
    """One stage of the way to a sample.

    fields : names of the arrays that it gives.
    parameters : names of the parameters that it gives, or what such names begin with.
    seconds : keys of `Sample.seconds` that are its own.
    """

    name: str
    fields: tuple[str, ...]
    parameters: tuple[str, ...]
    seconds: tuple[str, ...]


def _labels_of(*rooms: str) -> tuple[str, ...]:
    return tuple(of.name for of in LABEL_FIELDS if of.made_by.partition(".")[0] in rooms)


_TRANSPORT = tuple(f"effect.{effect.name}." for effect in TRANSPORT_EFFECTS)
STAGES = (
    Stage("room", OF_THE_ROOM, ("evidence.placed_anew",), ("scene",)),
    Stage(
        "capture",
        ("laser_position", "laser_points", "laser_normals", "sensor_position", "sensor_pixels", "sensor_points",
         "sensor_normals", "laser_time"),
        (*SCAN_PLACE, "capture."), (),
    ),
    Stage("detector", (), ("detector.", "exposure."), ()),
    Stage(
        "light", ("transient", "transient_stderr", "moving_transient", "background_transient"),
        ("transient.", "transport.", *_TRANSPORT), ("effects", "transport", "background"),
    ),
    Stage(
        "counts", ("histogram", "background_histogram"), ("histogram.", "sampler.", "effect."), ("detector",),
    ),
    Stage("evidence", _labels_of("evidence"), ("evidence.",), ("evidence", "presence")),
    Stage("labels", _labels_of("labels", "devices"), (), ("labels",)),
)  # fmt: skip
"""The stages in the order in which a sample is made; labels need the room alone."""


def stage_of_parameter(name: str) -> Stage:
    """The stage that gives a parameter; what no other stage names was drawn for the room."""
    return next((stage for stage in STAGES if name.startswith(stage.parameters)), STAGES[0])


def simulate_sample(config: DatasetConfig, index: int) -> Sample:
    """Scene number `index` of a dataset, from the room to the counts.

    A function of its arguments alone: every random stream is keyed by (`config.seed`, index, purpose).
    """
    seconds = dict[str, float]()
    with _timed(seconds, "scene"):
        scene = scene_for(config, index)
        capture = capture_for(config, scene, config.seed, index)
    return sample_of(config, index, scene, capture, seconds)


def sample_of(
    config: DatasetConfig, index: int, scene: Scene, capture: Capture, seconds: dict[str, float] | None = None
) -> Sample:
    """Sample `index` of a scene and a capture, wherever these come from. seconds : those of earlier stages."""
    return sample_of_setup(Setup.of(config, index, scene, capture, seconds))


def sample_of_setup(setup: Setup) -> Sample:
    """The sample of a setup: of a scene that is measured once, or of the frames of a sequence."""
    if setup.times is None:
        return sample_from(setup, simulated_light(setup))
    return sequence_from(setup, simulated_frames(setup))


def sample_from(setup: Setup, light: SceneLight) -> Sample:
    """The sample of a scene whose light is known, wherever this comes from: counts, labels and their parameters."""
    counts = counts_of(setup, light)
    arrays, detectability = labels_of(setup, light, counts)
    arrays |= _measured_fields(setup, light, counts) | _geometry(setup)
    return Sample(setup.index, arrays, _parameters(setup, light, counts) | detectability, setup.seconds)


@dataclass(frozen=True)
class FrameTimes:
    """When the frames of a sequence are measured, seconds since the first one began.

    points : (F, L) middle of the exposure of each laser point. middles : (F,) of each frame, which labels are made
    for. exposure_s : how long each laser point is measured.
    """

    points: Floats
    middles: Floats
    exposure_s: float

    @classmethod
    def of(cls, clock: Clock, capture: Capture, spad: Spad, exposure: Exposure) -> FrameTimes:
        """The times of a capture under an exposure. Raises `InputError` if the exposures do not fit into a frame, or
        are so short that each would take counts over from the one before."""
        # A flood lights all of its points at once, in whatever order a scan would.
        clock = replace(clock, order="together", columns=None) if capture.illumination == "flood" else clock
        points, exposure_s = capture.shape[0], exposure.cycles * exposure.period_s
        try:
            times = clock.times(points, exposure_s, exposure.repetition_rate_hz)
        except InputError as error:
            message = str(error).replace("Clock.", "sequence.").replace(" fits for each", " of detector.cycles fit")
            raise InputError(message) from None
        check_carry_over(spad, exposure)
        return cls(times, clock.middles(points, exposure_s), exposure_s)


@dataclass(frozen=True)
class Setup:
    """A scene and the device that measures it.

    scene : without surfaces of two parts in one place; of a sequence with its paths, as it is given.
    capture : of a sensor that moves, as it stands in the middle frame.
    caster : of the scene's triangles.
    seconds : wall-clock seconds by stage; every stage adds its own.
    times : of the frames of a sequence; None of a scene that is measured once.
    captures : one for each frame, of a dataset whose sensors move; None of one whose sensors stand.
    motion : what was drawn for the way of such a sensor.
    """

    config: DatasetConfig
    index: int
    scene: Scene
    capture: Capture
    caster: Raycaster
    spad: Spad
    exposure: Exposure
    seconds: dict[str, float]
    times: FrameTimes | None = None
    captures: tuple[Capture, ...] | None = None
    motion: Mapping[str, Scalar] = field(default_factory=dict)

    @classmethod
    def of(
        cls, config: DatasetConfig, index: int, scene: Scene, capture: Capture,
        seconds: dict[str, float] | None = None, clock: Clock | None = None,
        captures: Sequence[Capture] | None = None,
    ) -> Setup:  # fmt: skip
        """The setup of scene `index`, with the configured detector.

        capture : of a sensor that moves, as it stands.
        seconds : those of earlier stages. clock : of a sequence; left out: as configured.
        captures : one for each frame, where these are given; left out: the sensor moves as configured.

        Raises `InputError` as `FrameTimes.of` and `sensor_way` do.
        """
        seconds = dict[str, float]() if seconds is None else seconds
        with _timed(seconds, "effects"):
            apart = set_apart(scene, capture)
        spad, exposure = detector_for(config.detector, config.seed, index, capture.time)
        clock = config.clock if clock is None else clock
        if clock is None:
            return cls(config, index, apart.scene, capture, apart.caster, spad, exposure, seconds)
        times = FrameTimes.of(clock, capture, spad, exposure)
        setup = cls(config, index, scene, capture, apart.caster, spad, exposure, seconds, times)
        drawn: Mapping[str, Scalar] = {"kind": "given"}
        if captures is None:
            with _timed(seconds, "scene"):
                way = sensor_way(config, scene, capture, index, clock)
            if way is None:
                return setup
            captures, drawn = way.captures(capture, times.middles), way.parameters
        return replace(setup, capture=captures[len(captures) // 2], captures=tuple(captures), motion=drawn)

    def at(self, frame: int) -> Setup:
        """The setup of a frame of a sequence, as everything stands in the middle of that."""
        assert self.times is not None
        capture = self.capture if self.captures is None else self.captures[frame]
        with _timed(self.seconds, "effects"):
            apart = set_apart(self.scene.at(float(self.times.middles[frame])), capture)
        return replace(self, scene=apart.scene, capture=capture, caster=apart.caster, times=None, captures=None)

    @property
    def sensor_moves(self) -> bool:
        """Whether captures of two frames differ."""
        return self.captures is not None and any(one is not self.captures[0] for one in self.captures)

    @property
    def fields(self) -> tuple[str, ...]:
        """Names of the fields to be stored."""
        return self.config.store.fields

    def seed(self, purpose: Purpose) -> int:
        """The seed of the scene's random stream for a purpose."""
        return derived_seed(self.config.seed, self.index, purpose)


NO_DECISIONS = EffectDecisions((), 0.0)


@dataclass(frozen=True)
class SceneLight:
    """The light of a scene, from whichever simulator.

    transient : the light to be detected. An object that its `parts` lack has an unknown evidence.
    effects : decisions on the effects of the transport.
    background : (L, P, T) the light of the scene without its objects; None if it is not stored, or not known.
    in_sight : object in plain sight → (L, P, T) its light that is not in the transient's `parts`.
    without : (object, transient of the scene without it), which is simulated as it is read. An object that is not
        there has an unknown presence.
    """

    transient: Transient
    effects: EffectDecisions = NO_DECISIONS
    background: Floats | None = None
    in_sight: Mapping[str, Floats] = field(default_factory=dict)
    without: Iterable[tuple[str, Transient]] = ()


def simulated_light(setup: Setup) -> SceneLight:
    """The light of a scene, by our own transport. Raises `InputError` if no laser ray meets a surface."""
    config, scene, capture, caster = setup.config, setup.scene, setup.capture, setup.caster
    with _timed(setup.seconds, "effects"):
        effects = transport_effects(config, scene, capture, setup.index, caster)
    with _timed(setup.seconds, "transport"):
        light = light_of(config, setup.index, scene, capture, effects, setup.spad, setup.exposure, caster)
        transient = light.transient()
        if np.isnan(transient.laser_points).all():
            raise InputError("laser: its rays meet no surface of the scene; aim Laser.targets at the relay wall")
    background = None
    if any(name in BACKGROUND_FIELDS for name in setup.fields):
        with _timed(setup.seconds, "background"):
            background = light.background().total
    with _timed(setup.seconds, "evidence"):
        in_sight = light_in_sight(light.scene, capture, light.accuracy, light.seed, caster) if scene.objects else {}
    without = ((name, light.without(name)) for name in scene.objects)
    return SceneLight(transient, effects, background, in_sight, without)


@dataclass(frozen=True)
class LightOfFrames:
    """The light of a sequence.

    frames : the light to be detected.
    lit : the arguments of the transport that gave it. effects : decisions on the transport's effects.
    background : (L, P, T) the light of the scene without its objects, the same in all frames; (F, L, P, T) of a
        sensor that moves; None if it is not stored.
    """

    frames: SequenceLight
    lit: Light
    effects: EffectDecisions
    background: Floats | None = None

    def at_once(self) -> SceneLight:
        """The light of all frames as that of one scan, in which each laser point comes in each frame: (F · L, P, T).
        No light is below 0 in it, as counts are drawn from it."""
        light, rest = self.frames, self.frames.moving.shape[2:]
        total = np.maximum(light.static + light.moving, 0.0)
        errors = {name: error[~np.isnan(error)] for name, error in light.part_errors.items()}
        transient = Transient(
            light.time, {"all": total.reshape(-1, *rest)}, {}, light.stderr.reshape(-1, *rest),
            light.overflow.reshape(-1, rest[0]), light.laser_points.reshape(-1, 3), light.seconds,
            _error_of_all(light), None if light.met_target is None else bool(light.met_target.all()),
            {name: float(error.max()) for name, error in errors.items() if error.size}, light.samplers, light.rays,
        )  # fmt: skip
        background = self.background
        if background is not None:
            background = np.broadcast_to(background, (light.frames, *light.static.shape)).reshape(-1, *rest)
        return SceneLight(transient, self.effects, background)


def simulated_frames(setup: Setup) -> LightOfFrames:
    """The light of a sequence, by our own transport. Raises `InputError` if no laser ray meets a surface."""
    config, scene, capture, times = setup.config, setup.scene, setup.capture, setup.times
    assert times is not None
    frames = len(times.middles)
    with _timed(setup.seconds, "effects"):
        # All frames have the same effects, decided in the middle one: others would be a change of the light.
        effects = transport_effects(config, scene.at(times.middles[frames // 2]), capture, setup.index)
    with _timed(setup.seconds, "transport"):
        lit = light_of(
            config, setup.index, scene, capture, effects, setup.spad, setup.exposure, frames=frames
        )  # fmt: skip
        lit = replace(lit, captures=setup.captures)
        light = lit.frames(times.points, times.exposure_s, apart="moving_transient" in setup.fields)
        if np.isnan(light.laser_points).all():
            raise InputError("laser: its rays meet no surface of the scene; aim Laser.targets at the relay wall")
    background = None
    if any(name in BACKGROUND_FIELDS for name in setup.fields):
        with _timed(setup.seconds, "background"):
            empty = lit.scene.at(0.0)
            each = [
                replace(lit, scene=set_apart(empty, one).scene, capture=one).background().total
                for one in (setup.captures if setup.captures and setup.sensor_moves else (capture,))
            ]
            background = np.array(each) if setup.sensor_moves else each[0]
    return LightOfFrames(light, lit, effects, background)


def _error_of_all(light: SequenceLight) -> float:
    """Relative L2 error of the light of all frames together, as claimed; NaN where that of any frame is not known."""
    norms = np.array([l2_norm(light.total(frame)) for frame in range(light.frames)])
    norm = l2_norm(norms)
    return l2_norm(light.relative_error * norms) / norm if norm > 0 else 0.0


def _change_error(light: SequenceLight) -> float:
    """Relative L2 error of the changes of all frames together, as claimed; NaN where nothing changes, or where less
    is known of the changes than that there are any."""
    changed = np.array([l2_norm(light.change(frame)) for frame in range(1, light.frames)])
    error = l2_norm(light.change_errors)
    # The changes that are measured have noise, whose share is taken off their norm.
    known = l2_norm(changed) ** 2 - error**2
    return error / known**0.5 if known > 0 else float("nan")


def _share_below_zero(light: SequenceLight) -> float:
    """Light below 0, of which counts are drawn as of 0, over the light that moving parts block: it is below 0 where
    what they block is not known well enough. 0 where it is nowhere, or where frames share no light."""
    if light.blocked is None:
        return 0.0
    clipped = -sum(float(np.minimum(light.total(frame), 0.0).sum()) for frame in range(light.frames))
    blocked = float(light.blocked.sum())
    return clipped / blocked if blocked > 0 else 0.0


@dataclass(frozen=True)
class Counts:
    """The counts of a scene, or of all frames of a sequence as of one scan.

    histogram : (L, P, T) detections.
    background : those of the scene without its objects; None without that light.
    spad, exposure : the detector that counted, without the effects that were left out.
    effects : decisions on all effects, those of the transport included.
    """

    histogram: NDArray[np.integer]
    background: NDArray[np.integer] | None
    spad: Spad
    exposure: Exposure
    effects: EffectDecisions
    sampler: SamplerChoice


def counts_of(setup: Setup, light: SceneLight) -> Counts:
    """The light, detected."""
    config, total, time = setup.config, light.transient.total, light.transient.time
    with _timed(setup.seconds, "effects"):
        effects = light.effects + detector_effects(config, total, time, setup.spad, setup.exposure)
    with _timed(setup.seconds, "detector"):
        spad, exposure, tolerance = effects.apply_detector(setup.spad, setup.exposure, config.detector.tolerance)
        detect_counts = partial(
            detect_and_choice, time=time, spad=spad, exposure=exposure, tolerance=tolerance,
            approximate=config.detector.approximate,
        )  # fmt: skip
        histogram, sampler = detect_counts(total, seed=setup.seed(Purpose.DETECTOR))
    background = None
    if light.background is not None:
        with _timed(setup.seconds, "background"):
            background, _ = detect_counts(light.background, seed=setup.seed(Purpose.BACKGROUND))
    return Counts(histogram, background, spad, exposure, effects, sampler)


@dataclass(frozen=True)
class Known:
    """What labels are made of: a scene, its light, and its counts. What several of them need is found once."""

    setup: Setup
    light: SceneLight
    counts: Counts

    @cached_property
    def truth(self) -> Truth:
        """Of labels that need the scene alone."""
        config = self.setup.config
        return Truth(config.labels, self.setup.scene, config.scene.object_classes(), config.scene.most_objects())

    @cached_property
    def pairs(self) -> ScanPairs | None:
        """The pairs of laser points and pixels of the evidence image; None where it is not stored."""
        wanted = "evidence" in self.setup.fields
        return representative_pairs(self.setup.caster, self.setup.scene, self.setup.capture) if wanted else None

    @cached_property
    def evidence_and_gain(self) -> tuple[dict[str, Evidence], Floats]:
        """The evidence of each object, and the gain of the evidence image."""
        scene, light, counts = self.setup.scene, self.light, self.counts
        split = [name for name in scene.objects if name in light.transient.parts]
        known, gain = evidence_and_gain(
            light.transient, counts.spad, counts.exposure, split, self.pairs, light.in_sight
        )
        return {name: known.get(name, UNKNOWN) for name in scene.objects}, gain

    @cached_property
    def presence(self) -> dict[str, Presence]:
        """The presence of each object; empty where it is not stored."""
        if "presence" not in self.setup.fields:
            return {}
        light, counts = self.light, self.counts
        compared = presence_against(light.transient, light.without, counts.spad, counts.exposure)
        return {name: compared.get(name, PRESENCE_UNKNOWN) for name in self.setup.scene.objects}

    def evidence_image(self) -> dict[str, NDArray[np.generic]]:
        """The label `evidence`."""
        (_, gain), setup = self.evidence_and_gain, self.setup
        return {"evidence": evidence_image(setup.caster, self.truth.surface, setup.capture, self.pairs, gain)}

    def objects(self) -> dict[str, NDArray[np.generic]]:
        """The label `objects`: boxes, and how well each can be detected."""
        evidence, _ = self.evidence_and_gain
        return self.truth.objects() | evidence_tables(
            tuple(evidence.values()), self.setup.config.scene.most_objects()
        )

    def presence_table(self) -> dict[str, NDArray[np.generic]]:
        """The label `presence`."""
        rows = self.setup.config.scene.most_objects()
        return {"object_presence": presence_table(tuple(self.presence.values()), rows)}

    def zone_depth(self) -> dict[str, NDArray[np.generic]]:
        """The label `zone_depth`."""
        return {"zone_depth": zone_depth(self.setup.scene, self.setup.capture).astype(np.float32)}


def _of_truth(make: Callable[[Truth], dict[str, Any]]) -> Callable[[Known], dict[str, NDArray[np.generic]]]:
    return lambda known: make(known.truth)


MAKERS: dict[str, tuple[str, Callable[[Known], dict[str, NDArray[np.generic]]]]] = {
    "evidence": ("evidence", Known.evidence_image),
    "presence": ("presence", Known.presence_table),
    **{name: ("labels", _of_truth(make)) for name, make in LABEL_MAKERS.items()},
    "objects": ("labels", Known.objects),
    "zone_depth": ("labels", Known.zone_depth),
}
"""Label → the key of `Sample.seconds` that its time is added to, and what makes its arrays."""


def labels_of(
    setup: Setup, light: SceneLight, counts: Counts
) -> tuple[dict[str, NDArray[np.generic]], dict[str, Scalar]]:
    """Field → what is to be learned about the scene; and how well its objects can be detected, as parameters."""
    known, arrays = Known(setup, light, counts), dict[str, NDArray[np.generic]]()
    with _timed(setup.seconds, "evidence"):
        evidence, _ = known.evidence_and_gain
    for name, (stage, make) in MAKERS.items():
        if name in setup.fields:
            with _timed(setup.seconds, stage):
                arrays |= make(known)
    return arrays, evidence_parameters(evidence) | presence_parameters(known.presence)


def sequence_from(setup: Setup, light: LightOfFrames) -> Sample:
    """The sample of a sequence whose light is known: counts, labels of each frame and their parameters."""
    assert setup.times is not None
    at_once, frames = light.at_once(), light.frames.frames
    counts = counts_of(setup, at_once)
    arrays, detectability = labels_of_frames(setup, light, counts)
    for name, values in _measured_fields(setup, at_once, counts).items():
        arrays[name] = values.reshape(frames, -1, *values.shape[1:])
    if "transient" in arrays:
        # Light keeps its sign: what is clipped would be a bias of the changes.
        arrays["transient"] = light.frames.static + light.frames.moving
    if "moving_transient" in setup.fields:
        arrays["moving_transient"] = light.frames.moving
    if setup.captures is None:
        arrays |= _geometry(setup)
    arrays["laser_time"] = setup.times.points
    changing = {
        "transient.change_error": _change_error(light.frames),
        "transient.clipped": _share_below_zero(light.frames),
    }
    parameters = _parameters(setup, at_once, counts) | changing | detectability
    return Sample(setup.index, arrays, parameters, setup.seconds)


def labels_of_frames(
    setup: Setup, light: LightOfFrames, counts: Counts
) -> tuple[dict[str, NDArray[np.generic]], dict[str, Scalar]]:
    """As `labels_of`, for the frames of a sequence: each has the labels of its middle, and parameters are the medians
    over the frames. Of a sensor that moves with the geometry, whose places of the device have an axis of frames."""
    assert setup.times is not None
    times, frames, scene = setup.times, light.frames, setup.scene
    without = list[tuple[str, SequenceLight]]()
    if "presence" in setup.fields:
        with _timed(setup.seconds, "presence"):
            without = [
                (name, light.lit.frames_without(name, times.points, times.exposure_s)) for name in scene.objects
            ]
    every, evidence = list[dict[str, NDArray[np.generic]]](), list[dict[str, Scalar]]()
    for frame in range(frames.frames):
        at, one = setup.at(frame), frames.frame(frame)
        with _timed(setup.seconds, "evidence"):
            whole = replace(one, components={"all": np.maximum(one.total, 0.0)})
            lit, accuracy = light.effects.apply_transport(at.scene, at.capture, light.lit.accuracy)
            in_sight = light_in_sight(lit, at.capture, accuracy, light.lit.seed, at.caster) if scene.objects else {}
        others = [(name, other.frame(frame)) for name, other in without]
        found, known = labels_of(at, SceneLight(whole, light.effects, None, in_sight, others), counts)
        every.append(found if setup.captures is None else found | _geometry(at))
        evidence.append(known)
    arrays = {
        name: every[0][name] if name in _SAME_IN_FRAMES else np.stack([of[name] for of in every])
        for name in every[0]
    }  # fmt: skip
    medians: dict[str, Scalar] = {
        name: float(np.median([float(of[name]) for of in evidence])) for name in evidence[0]
    }
    with _timed(setup.seconds, "evidence"):
        changes = changes_of(scene, frames, counts.spad, counts.exposure, setup.sensor_moves)
    if "objects" in setup.fields:
        rows = setup.config.scene.most_objects()
        arrays |= change_tables(changes, rows, frames.frames)
        with _timed(setup.seconds, "labels"):
            arrays |= motion_tables(scene, times.middles, rows)
    return arrays, medians | change_parameters(changes, scene.moving)


_SAME_IN_FRAMES = {*OF_THE_ROOM, *(of.name for of in LABEL_FIELDS if of.over_frames == "same")}


def _measured_fields(setup: Setup, light: SceneLight, counts: Counts) -> dict[str, NDArray[np.generic]]:
    """Field → counts, or the light that they are drawn from, of those fields that are stored."""
    measured: dict[str, NDArray[np.generic] | None] = {
        "histogram": counts.histogram,
        "transient": light.transient.total,
        "transient_stderr": light.transient.stderr,
        "background_histogram": counts.background,
        "background_transient": light.background,
    }
    return {name: values for name, values in measured.items() if values is not None and name in setup.fields}


def _geometry(setup: Setup) -> dict[str, Floats]:
    """Field → where laser, sensor, relay wall and hidden view are."""
    scene, laser, sensor = setup.scene, setup.capture.laser, setup.capture.sensor
    wall, view = (
        None if face is None else np.stack([face.center, face.right, face.up])
        for face in (scene.relay_wall, scene.hidden_view)
    )
    return geometry_fields(
        lit_points(setup.caster, laser), sensor.pixels, seen_points(setup.caster, sensor), laser.position,
        sensor.position, wall, view, scene.hidden_bounds,
    )  # fmt: skip


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


def _parameters(setup: Setup, light: SceneLight, counts: Counts) -> dict[str, Scalar]:
    """The scalars of a sample, but for those of detectability: drawn numbers, decisions, errors, effort."""
    scene, transient = setup.scene, light.transient
    inside, outside = float(transient.total.sum()), float(transient.overflow.sum())
    # The position of the scan on the label images.
    place = None if scene.hidden_view is None else scan_place(scene.hidden_view, transient.laser_points)
    return {
        **scene.parameters,
        "scene.part_names": ",".join(scene.part_names),
        **({} if place is None else dict(zip(SCAN_PLACE, place, strict=True))),
        **_scalars("capture.motion", setup.motion),
        **_scalars("detector", asdict(setup.spad)),
        **_scalars("exposure", asdict(setup.exposure)),
        **counts.effects.parameters(),
        **_scalars("sampler", counts.sampler.parameters()),
        "transient.energy": inside,
        "transient.overflow": outside / (inside + outside) if inside + outside > 0 else 0.0,
        "transient.relative_error": transient.relative_error,
        **({} if transient.met_target is None else {"transient.target_met": transient.met_target}),
        **_scalars("transient.part_error", transient.part_errors),
        **_scalars("transport.sampler", transient.samplers),
        **_scalars("transport.rays", transient.rays),
        "histogram.counts": int(counts.histogram.sum()),
    }


def _scalars(prefix: str, values: Mapping[str, object]) -> dict[str, Scalar]:
    """Those values that a table can hold, by dotted name."""
    return {f"{prefix}.{name}": value for name, value in values.items() if isinstance(value, Scalar)}
