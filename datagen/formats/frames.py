"""The configuration of an imported dataset, and frames of a sensor of zones as samples: the fields of a simulated
dataset of the same device."""

from __future__ import annotations

import json
import time
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from datagen.capture.device_optics import capture_at
from datagen.config import DatasetConfig, config_from_mapping
from datagen.config.imported import ImportedFile, ImportOptions
from datagen.devices import Device, Frames, device, read_frames, recorded_by, without_reference
from datagen.devices.frames import all_whole
from datagen.devices.zone_order import in_device_order
from datagen.errors import InputError
from datagen.formats.denali import denali_labels, read_places
from datagen.records import OnSurfaces, Sample, Scalar
from datagen.records.checks import as_given
from datagen.records.sample import geometry_fields
from datagen.store.files import sha256_of

SETTINGS = ("detector", "effects", "splits", "store")
LARGEST_COUNTS = {"uint16": 2**16 - 1, "uint32": 2**32 - 1}


def imported_config(
    files: Sequence[ImportedFile], capture: dict[str, Any], stored: dict[str, Any], settings: dict[str, Any],
    named: dict[str, Any], *, options: ImportOptions | None = None, detector_is_known: bool = True,
) -> DatasetConfig:  # fmt: skip
    """The configuration of a dataset of `files`: what is `stored` goes beside the user's own section `store`. Raises
    `InputError` for a section of `settings` that an import does not take."""
    for key in settings:
        if key not in SETTINGS:
            raise InputError(f"settings: {key!r} is not for an import; there are {', '.join(SETTINGS)}")
    layout = {
        "kind": "imported", "files": [file.model_dump(mode="json") for file in files],
        "options": (options or ImportOptions()).model_dump(mode="json"), "detector_is_known": detector_is_known,
    }  # fmt: skip
    whole = settings | named | {
        "scenes": sum(file.frames or 1 for file in files),
        "scene": {"layout": layout, "contents": []},
        "capture": capture,
        "store": {**settings.get("store", {}), **stored},
    }  # fmt: skip
    return config_from_mapping(json.loads(json.dumps(whole, default=str)), source="import")


def dtype_of_counts(most: float) -> str | None:
    """The narrowest dtype of histograms that holds counts up to `most`; None if none does."""
    return next((dtype for dtype, limit in LARGEST_COUNTS.items() if most <= limit), None)


def config_of_frames(
    paths: Sequence[Path], name: str | Path | None, places: Path | None, settings: dict[str, Any],
    named: dict[str, Any],
) -> DatasetConfig:  # fmt: skip
    """The configuration of a dataset of frames: the files' digests and labels, and the device that recorded them.
    `places` is the file with the places of what is hidden, if there is one.

    Raises `InputError` where no device is named, and for frames that are damaged or have other zones or bins.
    """
    if name is None:
        raise InputError(
            f"{paths[0]}: frames do not say what recorded them; name it: {as_given('device', 'tmf8820')}"
        )
    sensor = device(name)
    # A scan has a histogram for each laser point.
    lasers, pixels, _ = sensor.at_pose(np.eye(4))[0].shape
    files, most, posed = list[ImportedFile](), 0.0, list[bool]()
    known = None if places is None else read_places(places)
    for path in paths:
        read = read_frames(path)
        frames = recorded_by(path, read, sensor, lasers * pixels)
        posed.append(frames.poses is not None)
        if posed[-1] != posed[0]:
            has, none = (paths[0], path) if posed[0] else (path, paths[0])
            raise InputError(
                f"{has} has poses and {none} none, so that positions would be in two frames; import them apart"
            )
        if not all_whole(frames.histograms):
            raise InputError(
                f"{path}: hists holds fractions, which are no counts; multiply hists (and ambient) by what the "
                "sensor divided by, such as the number of its SPADs in use, and round"
            )
        most = max(most, float(frames.histograms.max()))
        files.append(
            ImportedFile(
                name=path.name, sha256=sha256_of(path), format="frames", frames=len(frames),
                taken=_taken_text(read, sensor), labels=denali_labels(path, known),
            )
        )  # fmt: skip
    dtype = dtype_of_counts(most)
    if dtype is None:
        raise InputError(f"{paths[0]}: counts up to {most:g}, at most {LARGEST_COUNTS['uint32']} are stored")
    capture = {"device": json.loads(sensor.model_dump_json(exclude_defaults=True))}
    return imported_config(files, capture, {"fields": ["histogram"], "histogram_dtype": dtype}, settings, named)


def _taken_text(frames: Frames, sensor: Device) -> str:
    """What is taken for the axes, units, time zero and places of a file of frames, in one line."""
    order = frames.zone_order if isinstance(frames.zone_order, str) else "listed by number"
    order = "the order of the device" if frames.zone_order is None else order
    places = "the sensor as its own frame" if frames.poses is None else "poses in m"
    return (
        f"frames of {sensor.name}; hists (frame, zone, bin); zones in {order}; bins of "
        f"{sensor.time.bin_width_ps:g} ps of the device, counted from the laser; {places}"
    )


def scene_of_files(files: Sequence[ImportedFile], index: int) -> tuple[int, int]:
    """The number of the file that a scene is in, and the number of the scene in it."""
    for number, file in enumerate(files):
        if index < (file.frames or 1):
            return number, index
        index -= file.frames or 1
    raise IndexError(index)


@lru_cache(maxsize=1)
def _frames(path: Path, sha256: str, zones: int) -> Frames:
    return without_reference(read_frames(path), zones)


def sample_of_frame(config: DatasetConfig, index: int, path: Path, file: ImportedFile, frame: int) -> Sample:
    """The sample of one frame: its counts, and where the device stood."""
    began = time.perf_counter()
    lasers, pixels, _ = config.histogram_shape
    frames, sensor = _frames(path, file.sha256, lasers * pixels), config.capture.device
    assert sensor is not None
    (counts,) = in_device_order(frames.some(np.array([frame])), sensor.zones).histograms
    counts = counts.reshape(config.histogram_shape).astype(config.store.histogram_dtype)
    pose = np.eye(4) if frames.poses is None else frames.poses[frame]
    place, forward, up = pose[:3, 3], pose[:3, 2], pose[:3, 1]
    capture = capture_at(sensor, place, place + forward, up)
    parameters: dict[str, Scalar] = {
        "capture.file": file.name,
        "capture.frame": frame,
        "capture.pose_is_known": frames.poses is not None,
        "imported.format": file.format,
        "imported.sha256": file.sha256,
        "histogram.counts": int(counts.sum(dtype=np.int64)),
    }
    parameters |= file.labels or {}
    if frames.distances_m is not None:
        parameters["capture.distance_m"] = float(frames.distances_m[frame])
    lit, seen = (OnSurfaces.unknown(len(of)) for of in (capture.laser.targets, capture.sensor.pixels))
    places = geometry_fields(lit, capture.sensor.pixels, seen, capture.laser.position, capture.sensor.position)
    return Sample(index, {"histogram": counts, **places}, parameters, {"read": time.perf_counter() - began})
