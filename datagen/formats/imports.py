"""Captures of other programs and of laboratories as a dataset, a scene for each file: `datagen import`."""

from __future__ import annotations

import os
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal, cast
from warnings import warn

import numpy as np

from datagen.building.build import BuildResult, build
from datagen.config import DatasetConfig
from datagen.config.capture import TimeConfig
from datagen.config.imported import ImportedFile, ImportOptions
from datagen.config.scene_layouts import ImportedCaptures
from datagen.errors import InputError, InputWarning
from datagen.formats.frames import (
    LARGEST_COUNTS,
    config_of_frames,
    dtype_of_counts,
    imported_config,
    sample_of_frame,
    scene_of_files,
)
from datagen.formats.layouts import read_mat
from datagen.formats.recording import Recording, metres_of, numbers_in, seconds_of
from datagen.formats.tal import read_tal
from datagen.records import Sample, Scalar, TimeAxis
from datagen.records.checks import as_given, as_paths, check_choice, check_number, check_path, option
from datagen.store.files import sha256_of
from datagen.untrusted import why_no_file

FORMATS = ("tal", "mat", "frames")
FIELDS = ("histogram", "transient")
AXES = ("xyt", "yxt", "txy", "tyx")
_WIDEST_SCAN_M = 100.0
"""Extent of a scan above which its unit is doubted: millimetres or centimetres make a scan of a wall larger."""
_BY_SUFFIX = {".hdf5": "tal", ".h5": "tal", ".hdf": "tal", ".mat": "mat", ".json": "frames",
              ".gz": "frames", ".npz": "frames", ".npy": "frames"}  # fmt: skip


def import_captures(
    files: str | Path | Sequence[str | Path], path: str | Path, *, format: str | None = None,
    bin_width: float | str | None = None, wall: float | str | tuple[float, float] | None = None,
    tof: str | Path | None = None, axes: str | None = None, bins: int | None = None, field: str | None = None,
    device: str | Path | None = None, name: str = "imported", description: str = "", license: str = "",
    settings: Mapping[str, Any] | None = None, workers: int = 1, progress: bool = True,
) -> BuildResult:  # fmt: skip
    """Make a dataset of captures from a laboratory, another program, or a sensor of zones: a scene for each file, or
    for each frame of the sensor.

    The dataset is read, verified and exported like a simulated one, but has no labels, because the hidden part is
    unknown. Points keep the frame of their file; a grid is stored row by row from the top left, as in simulated
    datasets. Frames of a sensor have the fields, the time axis and the detector of a simulated dataset of the same
    device, so one loader and one network take both; positions are those of each frame's pose, or in the sensor's own
    frame where the file has none.

    Parameters
    ----------
    files : files of y-tal (HDF5), or of MATLAB in the formats that docs/exports.md lists; all of one shape, time axis
        and pairing. Or frames as `read_frames` takes them, of one device.
    path : the folder of the dataset; the same call again resumes.
    format : "tal", "mat" or "frames"; left out: from each file's suffix.
    bin_width, wall : width of a time bin (seconds, or a text such as "4ps") and size of the scanned grid from its
        first to its last point (metres, width and height, or "2m"), if a file does not state them.
    tof : file with `tofgrid`, for a MATLAB `meas` without it; "none": its times count from the wall already.
    axes : order of the axes of a MATLAB grid, such as "txy", if it is not the usual order of its variable.
    bins : number of time bins to keep, from the first one on; for example as many as a simulated dataset has.
    field : "histogram" (counts) or "transient" (anything else); left out: histogram if all values are whole numbers.
    device : what recorded frames: a name of the catalogue, or a device file.
    name, description, license : as in a configuration; the dataset's cards show them.
    settings : sections `detector` (from which `redraw_noise` takes the detector), `effects`, `splits`, `store`.
    workers, progress : as for `build`.

    Raises
    ------
    InputError : a file that is damaged, of another kind, or lacks something that no option states; values that are
        negative or not finite; files that differ in shape or times; another dataset at `path`. Nothing has been made
        then.

    Examples
    --------
    >>> import datagen as dg, numpy as np, scipy.io, tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     counts = np.random.default_rng(0).poisson(1.0, (8, 8, 64)).astype(np.uint16)
    ...     scipy.io.savemat(f"{folder}/letter.mat", {"rect_data": counts, "width": 0.35})
    ...     result = dg.import_captures(f"{folder}/letter.mat", f"{folder}/real", bin_width="4ps", progress=False)
    ...     data = dg.TransientDataset(f"{folder}/real", ("histogram", "laser_points"))
    ...     data.shape("histogram"), data[0]["laser_points"][0].tolist()
    ((64, 1, 64), [-0.35, 0.35, 0.0])
    """
    check_path("path", path, "name the folder to make")
    if format is not None and (not isinstance(format, str) or format not in FORMATS):
        raise InputError(f"{as_given('format', format)}: must be one of {', '.join(FORMATS)}")
    if field is not None:
        check_choice(option("field"), field, FIELDS)
    options, delays = _options(bin_width, wall, tof, axes, bins)
    paths = _paths(files)
    named = {"name": name, "description": description, "license": license}
    if {format or _format_of(file) for file in paths} == {"frames"}:
        if (options, field) != (ImportOptions(), None):
            raise InputError(
                f"{paths[0]}: frames of a sensor are counts on its own time axis; leave "
                f"{', '.join(map(option, ('bin_width', 'wall', 'tof', 'axes', 'bins')))} and {option('field')} out"
            )
        config = config_of_frames(paths, device, dict(settings or {}), named)
    else:
        if device is not None:
            raise InputError(
                f"{as_given('device', device)}: {paths[0].name} holds no frames of a sensor; leave it out"
            )
        given = [_summary(file, format, options, delays) for file in paths]
        config = _config(given, field, options, dict(settings or {}), named)
    samples = ImportedSamples(tuple(str(file.resolve()) for file in paths), None if delays is None else str(delays))
    return build(config, path, workers, progress=progress, sample_function=samples)


@dataclass(frozen=True)
class ImportedSamples:
    """The sample function of an import. Workers read each file again, with the options of the configuration.

    files : path of each scene's file. delays : path of the file with `tofgrid`, if any.
    """

    files: tuple[str, ...]
    delays: str | None

    def __call__(self, config: DatasetConfig, index: int) -> Sample:
        """Sample number `index`."""
        began, layout = time.perf_counter(), config.scene.layout
        assert isinstance(layout, ImportedCaptures)
        number, frame = scene_of_files(layout.files, index)
        file, delays = layout.files[number], None if self.delays is None else Path(self.delays)
        path = Path(self.files[number])
        if sha256_of(path) != file.sha256:
            raise InputError(f"{path}: has changed since the import began; import it again")
        if file.format == "frames":
            return sample_of_frame(config, index, path, file, frame)
        recording = _recording(path, file.format, layout.options, delays)
        field = config.store.fields[0]
        dtype = config.store.histogram_dtype if field == "histogram" else "float32"
        # In order first: then what was read is let go before the stored values are made.
        recording = recording.in_order()
        recording = replace(recording, values=recording.values.astype(dtype, copy=False))
        total = recording.values.sum(dtype=np.float64)
        parameters: dict[str, Scalar] = {
            "capture.file": file.name,
            "imported.format": file.format,
            "imported.sha256": file.sha256,
            **({"histogram.counts": int(total)} if field == "histogram" else {"transient.energy": float(total)}),
        }
        arrays = {field: recording.values, **recording.geometry()}
        return Sample(index, arrays, parameters, {"read": time.perf_counter() - began})


@dataclass(frozen=True)
class _Summary:
    """The properties of a capture from which the configuration follows.

    shape : (L, P, T) of its values. paired : whether it is confocal. whole : whether all values are whole numbers.
    most : the largest value.
    """

    file: ImportedFile
    shape: tuple[int, ...]
    paired: bool
    time: TimeAxis
    whole: bool
    most: float

    def __str__(self) -> str:
        time, pairing = self.time, "confocal" if self.paired else "exhaustive"
        return f"{self.shape} {pairing}, {time.width_s * 1e12:g} ps from {time.start_s * 1e9:g} ns ({time.origin})"


def _paths(files: str | Path | Sequence[str | Path]) -> list[Path]:
    listed = as_paths("files", files, "name files of captures")
    if not listed:
        raise InputError("files: none given; name at least one capture")
    for file in listed:
        if (why := why_no_file(file)) is not None:
            raise InputError(f"{file}: {why}{'; name the files in it' if os.path.isdir(file) else ''}")
    return listed


def _options(
    bin_width: object, wall: object, tof: str | Path | None, axes: str | None, bins: int | None
) -> tuple[ImportOptions, Path | None]:
    """The options as the dataset states them, and the file with `tofgrid`, if it is a file of its own."""
    width_s = seconds_of(bin_width) if isinstance(bin_width, str) else bin_width
    if width_s is not None:
        check_number("import", "bin_width", width_s, 1e-16, 1e-3, "seconds, or a text such as '4ps'")
    size = metres_of(wall) if isinstance(wall, str) else wall
    size = size if size is None or isinstance(size, tuple | list) else (size, size)
    if size is not None:
        if len(size) != 2:
            raise InputError(f"import.wall = {size}: one size, or width and height, are needed")
        for value in size:
            check_number("import", "wall", value, 1e-6, 1e5, "metres, or a text such as '2m'")
    if axes is not None:
        check_choice(option("axes"), axes, AXES)
    if bins is not None and (not isinstance(bins, int) or isinstance(bins, bool) or not 1 <= bins <= 1_000_000):
        raise InputError(f"{as_given('bins', bins)}: must be an integer in 1 … 1000000")
    stated: ImportedFile | Literal["none"] | None = None if tof is None else "none"
    delays = None
    if tof is not None and not (isinstance(tof, str) and tof == "none"):
        check_path("tof", tof, "name the file with tofgrid, or none")
        delays = Path(tof)
        if (why := why_no_file(delays)) is not None:
            raise InputError(f"{as_given('tof', tof)}: {why}; name the one with tofgrid, or none")
        stated = ImportedFile(name=delays.name, sha256=sha256_of(delays), format="mat")
        delays = delays.resolve()
    return ImportOptions(
        bin_width_ps=None if width_s is None else float(f"{float(cast(float, width_s)) * 1e12:.12g}"),
        wall_m=None if size is None else (float(size[0]), float(size[1])), axes=cast(Any, axes), delays=stated,
        bins=bins,
    ), delays  # fmt: skip


def _summary(path: Path, format: str | None, options: ImportOptions, delays: Path | None) -> _Summary:
    """The summary of one file. The whole file is read."""
    form = format or _format_of(path)
    if form == "frames":
        raise InputError(f"{path}: frames of a sensor and captures of scans make two datasets; import them apart")
    file = ImportedFile(name=path.name, sha256=sha256_of(path), format=cast(Literal["tal", "mat"], form))
    recording = _recording(path, form, options, delays)
    whole, most = numbers_in(path, recording.values)
    across = float(np.linalg.norm(np.ptp(np.concatenate([recording.laser_points, recording.seen_points]), axis=0)))
    if across > _WIDEST_SCAN_M:
        warn(f"{path}: its points are {across:.4g} m apart; are they in metres?", InputWarning, stacklevel=4)
    return _Summary(file, recording.values.shape, recording.paired, recording.time, whole, most)


def _format_of(path: Path) -> str:
    form = _BY_SUFFIX.get(path.suffix.lower())
    if form is None:
        raise InputError(f"{path}: its suffix says no format; say {option('format')}, one of {', '.join(FORMATS)}")
    return form


def _recording(path: Path, format: str, options: ImportOptions, delays: Path | None) -> Recording:
    """The recording in one file, with the first bins only if the options say so."""
    recording = read_tal(path, options) if format == "tal" else read_mat(path, options, delays)
    bins = recording.time.bins if options.bins is None else options.bins
    if bins > recording.time.bins:
        raise InputError(f"{path}: has {recording.time.bins} bins, {as_given('bins', bins)} asks for more")
    return replace(recording, values=recording.values[..., :bins], time=replace(recording.time, bins=bins))


def _config(
    given: list[_Summary], field: str | None, options: ImportOptions, settings: dict[str, Any], named: dict[str, Any]
) -> DatasetConfig:
    """The configuration that the dataset states: the digests of the files, and the scan of the first file."""
    first = given[0]
    for other in given:
        if (other.shape, other.paired, other.time) != (first.shape, first.paired, first.time):
            shorter = min(other.time.bins, first.time.bins)
            times = {replace(capture.time, bins=shorter) for capture in (first, other)}
            only_bins = (other.shape[:2], other.paired, len(times)) == (first.shape[:2], first.paired, 1)
            remedy = f"take {as_given('bins', shorter)} of all" if only_bins else "import them into several"
            raise InputError(
                f"{other.file.name}: {other}, {first.file.name}: {first}; all of a dataset have one "
                f"shape, time axis and pairing: {remedy}"
            )
    lasers, pixels, _ = first.shape
    view = {} if first.paired else {"rows": 1, "columns": pixels}
    capture = {
        "pairing": "confocal" if first.paired else "exhaustive",
        "scan": {"kind": "imported", "count": lasers},
        "field_of_view": view,
        "time": TimeConfig.of(first.time).model_dump(mode="json"),
    }
    return imported_config(
        [one.file for one in given], capture, _stored(given, field), settings, named, options=options,
        detector_is_known="detector" in settings,
    )  # fmt: skip


def _stored(given: list[_Summary], field: str | None) -> dict[str, Any]:
    """The section `store`: a histogram if all values are whole numbers that fit into its dtype, else a transient."""
    fraction = next((capture for capture in given if not capture.whole), None)
    most = max(given, key=lambda capture: capture.most)
    if field == "histogram" and fraction is not None:
        raise InputError(
            f"{fraction.file.name}: holds fractions, which are no counts; leave "
            f"{as_given('field', 'histogram')} out, or round them"
        )
    if field is None and fraction is not None and any(capture.whole and capture.most > 0 for capture in given):
        counts = next(capture for capture in given if capture.whole and capture.most > 0)
        raise InputError(
            f"{fraction.file.name} holds fractions and {counts.file.name} whole numbers; import them into two "
            f"datasets, or all with {as_given('field', 'transient')}"
        )
    if field == "transient" or fraction is not None:
        if most.most > float(np.finfo(np.float32).max):
            raise InputError(f"{most.file.name}: holds {most.most:g}, more than a float32 can")
        return {"fields": ["transient"]}
    dtype = dtype_of_counts(most.most)
    if dtype is None:
        raise InputError(
            f"{most.file.name}: counts up to {most.most:g}, at most {LARGEST_COUNTS['uint32']} are stored; take "
            f"{as_given('field', 'transient')}"
        )
    return {"fields": ["histogram"], "histogram_dtype": dtype}
