"""Datasets of scenes that a user made in Python, instead of scenes drawn from a configuration."""

from __future__ import annotations

import hashlib
import pickle
import tempfile
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any
from warnings import warn

import numpy as np
from numpy.typing import ArrayLike, NDArray

from datagen.building.build import BuildResult, build
from datagen.building.input_check import doubtful_scenes, parts_in_one_place
from datagen.config import DatasetConfig, config_from_mapping
from datagen.errors import InputError, InputWarning, shown
from datagen.labels.boxes import classes_in
from datagen.pipeline import BACKGROUND_FIELDS, SceneLight, Setup, sample_from, sample_of_setup
from datagen.records import Capture, Clock, Sample, Scene, Transient
from datagen.records.arrays import Floats
from datagen.records.checks import as_names, check_kind, check_seed
from datagen.transport.lines_of_sight import lit_points
from datagen.transport.sequences import captures_of


def build_from(
    scenes: Iterable[
        Scene | tuple[Scene, Capture] | tuple[Scene, Capture | Sequence[Capture], ArrayLike | Clock]
    ],
    path: str | Path, capture: Capture | Callable[[Scene], Capture] | None = None, *,
    fields: tuple[str, ...] | None = None, seed: int = 0, settings: Mapping[str, Any] | None = None, workers: int = 1,
    progress: bool = True,
) -> BuildResult:  # fmt: skip
    """Build a dataset of your own scenes: light, counts and labels as for a configured dataset, without YAML.

    Parameters
    ----------
    scenes : each is a `Scene`; or (`Scene`, `Capture`), with a capture of its own; or (`Scene`, `Capture`, transient)
        with a transient (L, P, T) of another simulator, in expected photons at the aperture per emitted photon.
        Counts and labels are then made for this transient; laser points and what pixels look at are where rays meet
        the scene, as always. Or (`Scene`, `Capture`, `Clock`), a sequence of frames in which parts move along their
        paths; all of a dataset have the same clock. Or (`Scene`, [`Capture`, …], `Clock`) with one capture for each
        frame, of a sensor that moves: arrays that say where laser and sensor are then have an axis of frames, also in
        scenes whose sensor stands.
    path : the folder of the dataset; the same call again resumes a build.
    capture : the capture of all scenes without one of their own, or a function of the scene that returns it. All
        captures of a dataset have one shape, one time axis and one pairing.
    fields : what to store; left out: histogram, transient, and depth if every scene has a `hidden_view`.
    seed : of the light's samples and of the counts; a sample is a function of (seed, its number, its scene).
    settings : further sections of a configuration as plain values, such as `{"transport": {"target": 0.05},
        "detector": {"cycles": 10**6}, "labels": {"rows": 32}, "name": "mine"}`.
    workers, progress : as for `build`.

    Raises
    ------
    InputError : no scenes, captures that differ in shape or times, captures of another number than there are frames,
        parts that move without a clock, clocks that differ, invalid settings, another dataset at `path`.
    CheckError : scenes failed (all others are there), or the disk refused.

    The dataset is read, verified and exported like any other; `show` and `preview` draw what is stored. Commands that
    would draw its rooms again, such as `export --format glb`, say that they cannot.

    A script that calls `build_from` needs `if __name__ == "__main__":`, as with all of Python's pools.

    Examples
    --------
    >>> import datagen as dg, tempfile, trimesh
    >>> wall = dg.Part("wall", trimesh.creation.box((0.1, 4, 3)), dg.Lambertian(0.8), "relay_wall")
    >>> def room(x):
    ...     ball = trimesh.creation.icosphere(2, 0.3).apply_translation((x, 1, 0))
    ...     return dg.Scene.from_parts([wall, dg.Part("ball", ball, dg.Lambertian(0.6))], parameters={"x_m": x})
    >>> laser = dg.Laser((3, -1, 0), [(0.05, 0, 0.2), (0.05, 0, -0.2)])
    >>> sensor = dg.Sensor.grid((3, -1, 0), (0.05, 0, 0), (0, 0.3, 0), (0, 0, 0.3), rows=1, columns=2)
    >>> capture = dg.Capture(laser, sensor, dg.TimeAxis(bins=64, width_s=4e-10, origin="wall"))
    >>> given = {"transport": {"target": 0.1}}
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     result = dg.build_from(map(room, (1.0, 1.5)), f"{folder}/mine", capture, settings=given, progress=False)
    ...     data = dg.TransientDataset(f"{folder}/mine", fields=("histogram",))
    ...     data.shape("histogram"), data.parameters("x_m").tolist()
    ((2, 2, 64), [1.0, 1.5])
    """
    if isinstance(scenes, Scene) or not isinstance(scenes, Iterable):
        raise InputError(f"scenes = {shown(scenes)}: a list of Scene is needed, or of (Scene, Capture)")
    check_seed(seed)
    if settings is not None:
        check_kind("settings", settings, Mapping, remedy="sections of a configuration")
    if fields is not None:
        fields = as_names("fields", fields, "such as ('histogram', 'depth')")
    given = [_checked_item(number, item, capture) for number, item in enumerate(scenes)]
    if not given:
        raise InputError("scenes: none given; a dataset needs at least one")
    config = _config(given, fields, seed, dict(settings or {}))
    pairs = [(item.scene, item.capture) for item in given]
    for warning in (*parts_in_one_place(pairs), *doubtful_scenes(pairs, config.transport.direct)):
        warn(warning, InputWarning, stacklevel=2)
    with tempfile.TemporaryDirectory(prefix="datagen-") as folder:
        # One file a scene: a worker reads only the scenes that it makes.
        for number, item in enumerate(given):
            (Path(folder) / str(number)).write_bytes(pickle.dumps(item))
        return build(config, path, workers, progress=progress, sample_function=GivenSamples(folder))


@dataclass(frozen=True)
class Given:
    """The input of one sample: a scene, its capture, its transient if another simulator made it (else None), the
    clock of a sequence (else None), and the captures of its frames if there is one for each (else None): `capture` is
    the first of them."""

    scene: Scene
    capture: Capture
    transient: Floats | None
    clock: Clock | None = None
    captures: tuple[Capture, ...] | None = None

    @property
    def digest(self) -> str:
        """Hex SHA-256 of scene, captures, transient and clock."""
        s, c = self.scene, self.capture
        values = (s.part_names, s.materials, s.roles, dict(s.parameters), s.attenuation_per_m, c.time, c.pairing)
        poses = [(name, pose.label, pose.axes.tolist()) for name, pose in sorted(s.poses.items())]
        faces = s.relay_wall, s.hidden_view
        views = [face and [v.tolist() for v in (face.center, face.right, face.up)] for face in faces]
        sights = [
            (one.illumination, one.sensor.aperture_radius_m, one.sensor.finite_aperture, one.sensor.crosstalk)
            for one in self.captures or (c,)
        ]
        hashed = hashlib.sha256(repr((values, poses, views, *sights)).encode())
        arrays: list[NDArray[Any] | None] = [s.vertices, s.triangles, s.face_part, s.hidden_bounds, self.transient]
        # With one capture for all frames the digest is that of the capture of a scene which stands.
        for one in self.captures or (c,):
            arrays += [one.laser.position, one.laser.targets, one.laser.weights, one.laser.cells]
            eye = one.sensor
            arrays += [eye.position, eye.pixels, eye.footprints, eye.glass, eye.delays_s]
        # Without paths the digest is that of scenes which stand.
        arrays += [array for _, p in sorted(s.paths.items()) for array in (p.times_s, p.places, p.headings_deg)]
        for array in arrays:
            hashed.update(b"-" if array is None else repr(array.shape).encode() + array.tobytes())
        if self.clock is not None:
            hashed.update(repr(self.clock).encode())
        return hashed.hexdigest()


@dataclass(frozen=True)
class GivenSamples:
    """The sample function of given scenes. `folder` has a pickled file for each scene, as long as the build lasts."""

    folder: str

    def __call__(self, config: DatasetConfig, index: int) -> Sample:
        """Sample number `index`."""
        item: Given = pickle.loads((Path(self.folder) / str(index)).read_bytes())
        captures = None
        if config.capture.motion is not None and item.clock is not None:
            captures = item.captures or captures_of(item.capture, item.clock.frames)
        setup = Setup.of(config, index, _with_digest(item), item.capture, clock=item.clock, captures=captures)
        if item.transient is None:
            return sample_of_setup(setup)
        return sample_from(setup, _imported_light(setup, item.transient))


def _imported_light(setup: Setup, transient: Floats) -> SceneLight:
    """The light of another simulator: not split by object, with an unknown error, and nothing outside the window."""
    unknown, nothing = np.full(transient.shape, np.nan), np.zeros(transient.shape[:2])
    lit = lit_points(setup.caster, setup.capture.laser).position
    return SceneLight(Transient(setup.capture.time, {"given": transient}, {}, unknown, nothing, lit))


def _checked_item(number: int, item: object, capture: Capture | Callable[[Scene], Capture] | None) -> Given:
    """The input of sample `number`, from an item of `scenes`, after checks."""
    parts: Any = item if isinstance(item, tuple) else (item,)
    scene, own, last = (*parts, None, None)[:3] if 1 <= len(parts) <= 3 else (item, None, None)
    clock, transient = (last, None) if isinstance(last, Clock) else (None, last)
    if not isinstance(scene, Scene):
        raise InputError(f"scenes[{number}] = {shown(scene)}: a Scene is needed, or (Scene, Capture, …)")
    if scene.moving and clock is None:
        raise InputError(
            f"scenes[{number}]: {scene.moving[0]!r} moves, and nothing says when frames are measured; give (Scene, "
            "Capture, Clock), or the scene at a time, scene.at(time_s)"
        )
    if clock is not None and clock.frames < 2:
        raise InputError(f"scenes[{number}]: a clock of 1 frame; give the scene at a time, scene.at(time_s)")
    found = own if own is not None else capture(scene) if callable(capture) else capture
    if isinstance(found, Sequence) and clock is not None:
        captures = tuple(captures_of(found, clock.frames, f"scenes[{number}]: capture"))
        return Given(scene, captures[0], None, clock, captures)
    if isinstance(found, Sequence) and found and isinstance(found[0], Capture):
        raise InputError(
            f"scenes[{number}]: {len(found)} captures without a clock; one for each frame of a sequence is given as "
            "(Scene, [Capture, …], Clock)"
        )
    if not isinstance(found, Capture):
        raise InputError(
            f"scenes[{number}]: its capture = {shown(found)}: a Capture is needed; give (Scene, Capture), "
            "or one for all as capture="
        )
    if transient is None:
        return Given(scene, found, None, clock)
    values = np.asarray(transient)
    if values.shape != found.shape or values.dtype.kind not in "fiu" or not (values >= 0).all():
        raise InputError(
            f"scenes[{number}]: transient {values.dtype} {values.shape}, must be real numbers ≥ 0 of its capture's "
            f"shape {found.shape}"
        )
    return Given(scene, found, values.astype(np.float64))


def _with_digest(item: Given) -> Scene:
    """The scene with its digest as a parameter. Splits recognise a room by its parameters; without the digest, all
    scenes without parameters would count as one room."""
    digest = replace(item, transient=None).digest[:16]
    return replace(item.scene, parameters={**item.scene.parameters, "given.scene": digest})


def _config(given: list[Given], fields: tuple[str, ...] | None, seed: int, settings: dict[str, Any]) -> DatasetConfig:
    """The configuration that the dataset states: the digest of the scenes, and the capture of the first scene."""
    first = given[0].capture
    for number, item in enumerate(given):
        other = item.capture
        if (other.shape, other.time, other.pairing, other.illumination, len(other.laser.targets)) != (
            first.shape, first.time, first.pairing, first.illumination, len(first.laser.targets),
        ):  # fmt: skip
            raise InputError(
                f"scenes[{number}]: its capture has shape {other.shape}, {other.time}, the first {first.shape}, "
                f"{first.time}; all of a dataset have one shape, time axis, pairing and illumination"
            )
        if item.clock != given[0].clock:
            raise InputError(
                f"scenes[{number}]: its clock is {item.clock}, that of the first {given[0].clock}; all of a dataset "
                "have the same frames, or none"
            )
    for name in ("scene", "capture", "seed", "scenes", "sequence"):
        if name in settings:
            raise InputError(f"settings: {name!r} follows from the scenes and captures given; leave it out")
    labels = ("depth",) if all(item.scene.hidden_view for item in given) else ()
    fields = fields or ("histogram", "transient", *labels)
    if any(name in BACKGROUND_FIELDS for name in fields) and any(item.transient is not None for item in given):
        raise InputError("fields: a background is simulated, and a transient given tells nothing of it; leave it out")
    classes = {name for item in given for name in classes_in(item.scene)}
    layout = {
        "kind": "given",
        "digest": hashlib.sha256("".join(item.digest for item in given).encode()).hexdigest(),
        "classes": sorted(classes),
        "most_objects": max(1, *(len(item.scene.objects) for item in given)),
    }
    time, pixels = first.time, first.shape[1]
    capture: dict[str, Any] = {
        "pairing": first.pairing,
        "illumination": first.illumination,
        "scan": {"kind": "points", "points_m": first.laser.targets.tolist()},
        "field_of_view": {"aperture_radius_mm": first.sensor.aperture_radius_m * 1e3},
        "time": {"bins": int(time.bins), "bin_width_ps": time.width_s * 1e12, "origin": time.origin}
        | {"start_ns": time.start_s * 1e9},
    }
    if first.pairing == "exhaustive":
        capture["field_of_view"] |= {"rows": 1, "columns": pixels}
    store = settings.pop("store", {}) | {"fields": list(fields)}
    described = {"seed": seed, "scenes": len(given), "scene": {"layout": layout, "contents": []}, "store": store}
    if any(item.captures for item in given):
        capture["motion"] = {"kind": "given"}
    if (clock := given[0].clock) is not None:
        described["sequence"] = {"frames": clock.frames, "rate_hz": clock.rate_hz, "order": clock.order}
    return config_from_mapping(settings | described | {"capture": capture}, source="settings")
