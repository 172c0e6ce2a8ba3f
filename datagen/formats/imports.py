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
from datagen.building.progress import Progress
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
from datagen.formats.layouts import read_capture
from datagen.formats.recording import Captured, Stated, metres_of, numbers_in, seconds_of
from datagen.records import Sample, Scalar, TimeAxis
from datagen.records.checks import as_given, as_paths, check_choice, check_number, check_path, option
from datagen.store.files import sha256_of
from datagen.untrusted import why_no_file

FORMATS = ("tal", "mat", "numpy", "frames")
FIELDS = ("histogram", "transient")
_WIDEST_SCAN_M = 100.0
"""Extent of a scan above which its unit is doubted: millimetres or centimetres make a scan of a wall larger."""
_BY_SUFFIX = {".hdf5": "tal", ".h5": "tal", ".hdf": "tal", ".mat": "mat", ".json": "frames",
              ".gz": "frames", ".npz": "numpy", ".npy": "numpy"}  # fmt: skip
_SCAN_OPTIONS = ("bin_width", "wall", "tof", "axes", "bins", "variable", "laser", "points", "start")


def import_captures(
    files: str | Path | Sequence[str | Path], path: str | Path, *, format: str | None = None,
    bin_width: float | str | None = None, wall: float | str | tuple[float, float] | None = None,
    tof: str | Path | None = None, axes: str | None = None, bins: int | None = None, field: str | None = None,
    variable: str | None = None, laser: str | tuple[float, float, float] | None = None,
    points: str | Path | None = None, start: float | str | None = None, device: str | Path | None = None,
    places: str | Path | None = None, name: str = "imported", description: str = "", license: str = "",
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
    files : files of y-tal, of MATLAB, HDF5 or NumPy in the layouts that docs/exports.md lists; all of one shape, time
        axis and pairing. Or frames as `read_frames` takes them, of one device.
    path : the folder of the dataset; the same call again resumes.
    format : "tal" (HDF5), "mat", "numpy" or "frames"; left out: from each file's suffix, and frames where a device is
        named.
    bin_width, wall : width of a time bin (seconds, or a text such as "4ps" or, as path of light, "3mm") and size of
        the scanned grid from its first to its last point (metres, width and height, or "2m"), if a file does not
        state them.
    tof : file with `tofgrid`, for a `meas` without it; "none": its times count from the wall already.
    axes : order of the axes of a grid, such as "txy", if it is not the usual order of its variable; also f (frames,
        each a scene) and c (channels, which are added up).
    bins : number of time bins to keep, from the first one on; for example as many as a simulated dataset has.
    field : "histogram" (counts) or "transient" (anything else); left out: histogram if all values are whole numbers.
    variable : the array of a grid, in a file of no layout that is known.
    laser : "confocal", or the one laser point of a grid as (x, y, z), metres in the frame of the wall, or "0.1,0,0".
    points : file of MATLAB with the places of the points of a grid: `grid_points` or `pos` (y, x, 3), or `z_offset`
        (y, x) with `width`, metres.
    start : time at which the first bin begins (seconds, or a text as for `bin_width`), if a file does not state it.
    device : what recorded frames: a name of the catalogue, or a device file.
    places : file with the places of what is hidden, `tag1_positions.json` of DENALI.
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
    stated = _stated_by(bin_width, wall, tof, axes, bins, variable, laser, points, start)
    paths = _paths(files)
    named = {"name": name, "description": description, "license": license}
    if {_format_of(file, format, device) for file in paths} == {"frames"}:
        if (stated, field) != (Stated(), None):
            raise InputError(
                f"{paths[0]}: frames of a sensor are counts on its own time axis; leave "
                f"{', '.join(map(option, _SCAN_OPTIONS))} and {option('field')} out"
            )
        known = None if places is None else _named_file("places", places, "the places of what is hidden")
        config = config_of_frames(paths, device, known, dict(settings or {}), named)
    else:
        for argument, value in (("device", device), ("places", places)):
            if value is not None:
                raise InputError(
                    f"{as_given(argument, value)}: {paths[0].name} holds no frames of a sensor; leave it out"
                )
        given = [_summary(file, _format_of(file, format, device), stated) for file in paths]
        config = _config(given, field, stated.options, dict(settings or {}), named)
    samples = ImportedSamples(
        tuple(str(file.resolve()) for file in paths), *(None if of is None else str(of) for of in stated.files)
    )
    result = build(config, path, workers, progress=progress, sample_function=samples)
    if progress:
        layout = config.scene.layout
        assert isinstance(layout, ImportedCaptures)
        for taken in dict.fromkeys(file.taken for file in layout.files):
            Progress(True).say(f"taken: {taken}")
    return result


@dataclass(frozen=True)
class ImportedSamples:
    """The sample function of an import. Workers read each file again, with the options of the configuration.

    files : path of each file. delays, points : paths of the files with `tofgrid` and with places, if any.
    """

    files: tuple[str, ...]
    delays: str | None = None
    points: str | None = None

    def __call__(self, config: DatasetConfig, index: int) -> Sample:
        """Sample number `index`."""
        began, layout = time.perf_counter(), config.scene.layout
        assert isinstance(layout, ImportedCaptures)
        number, frame = scene_of_files(layout.files, index)
        file, path = layout.files[number], Path(self.files[number])
        if sha256_of(path) != file.sha256:
            raise InputError(f"{path}: has changed since the import began; import it again")
        if file.format == "frames":
            return sample_of_frame(config, index, path, file, frame)
        stated = Stated(layout.options, *(None if of is None else Path(of) for of in (self.delays, self.points)))
        if file.frames is None:
            recording = _capture_of_file(path, file.format, stated)[0].first
        else:
            recording = _many_frames(path, file.format, stated, file.sha256).frame(frame)
        field = config.store.fields[0]
        dtype = config.store.histogram_dtype if field == "histogram" else "float32"
        # In order first: then what was read is let go before the stored values are made.
        recording = recording.in_order()
        recording = replace(recording, values=recording.values.astype(dtype, copy=False))
        total = recording.values.sum(dtype=np.float64)
        parameters: dict[str, Scalar] = {
            "capture.file": file.name,
            **({} if file.frames is None else {"capture.frame": frame}),
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


def _stated_by(
    bin_width: object, wall: object, tof: str | Path | None, axes: str | None, bins: int | None, variable: str | None,
    laser: object, points: str | Path | None, start: object,
) -> Stated:  # fmt: skip
    """What the options state, checked, as the dataset keeps it."""
    if axes is not None and not (
        isinstance(axes, str) and {"y", "x", "t"} <= {*axes} <= {*"fyxtc"} and len({*axes}) == len(axes)
    ):
        raise InputError(
            f"{as_given('axes', axes)}: must have y, x and t once each, and f (frames) or c (channels), such as txy"
        )
    if bins is not None and (not isinstance(bins, int) or isinstance(bins, bool) or not 1 <= bins <= 1_000_000):
        raise InputError(f"{as_given('bins', bins)}: must be an integer in 1 … 1000000")
    if variable is not None and not (isinstance(variable, str) and 1 <= len(variable) <= 200):
        raise InputError(f"{as_given('variable', variable)}: must be the name of an array in the file")
    subtracted = isinstance(tof, str) and tof == "none"
    delays = None if tof is None or subtracted else _named_file("tof", tof, "tofgrid", ", or none")
    places = None if points is None else _named_file("points", points, "grid_points, pos or z_offset")
    width_s, start_s = _seconds("bin_width", bin_width, 1e-16), _seconds("start", start, 0.0)
    options = ImportOptions(
        bin_width_ps=None if width_s is None else float(f"{width_s * 1e12:.12g}"),
        wall_m=_wall_m(wall), axes=axes, delays="none" if subtracted else _stated_file(delays), bins=bins,
        variable=variable, laser=_laser_m(laser), points=_stated_file(places),
        start_ns=None if start_s is None else float(f"{start_s * 1e9:.12g}"),
    )  # fmt: skip
    return Stated(options, delays, places)


def _seconds(name: str, value: object, least: float) -> float | None:
    """Seconds of an option that is a number or a text; None if it is left out."""
    seconds = seconds_of(name, value) if isinstance(value, str) else value
    if seconds is None:
        return None
    check_number("import", name, seconds, least, 1e-3, "seconds, or a text such as '4ps'")
    return float(cast(float, seconds))


def _wall_m(wall: object) -> tuple[float, float] | None:
    size = metres_of(wall) if isinstance(wall, str) else wall
    size = size if size is None or isinstance(size, tuple | list) else (size, size)
    if size is None:
        return None
    if len(size) != 2:
        raise InputError(f"import.wall = {size}: one size, or width and height, are needed")
    for value in size:
        check_number("import", "wall", value, 1e-6, 1e5, "metres, or a text such as '2m'")
    return float(cast(float, size[0])), float(cast(float, size[1]))


def _laser_m(laser: object) -> Literal["confocal"] | tuple[float, float, float] | None:
    if laser is None:
        return None
    if isinstance(laser, str) and laser == "confocal":
        return "confocal"
    try:
        x, y, z = (float(value) for value in (laser.split(",") if isinstance(laser, str) else cast(Any, laser)))
    except (TypeError, ValueError):
        x = y = z = float("nan")
    if not all(abs(value) <= 1e4 for value in (x, y, z)):
        raise InputError(
            f"{as_given('laser', laser)}: must be confocal, or the place of the one laser point as x,y,z, metres in "
            "the frame of the wall, such as 0.1,0,0"
        )
    return x, y, z


def _named_file(argument: str, path: str | Path, what: str, more: str = "") -> Path:
    """The whole path of a file that an option names; raises `InputError` where there is none."""
    check_path(argument, path, f"name the file with {what}{more}")
    if (why := why_no_file(Path(path))) is not None:
        raise InputError(f"{as_given(argument, path)}: {why}; name the one with {what}{more}")
    return Path(path).resolve()


def _stated_file(path: Path | None) -> ImportedFile | None:
    return None if path is None else ImportedFile(name=path.name, sha256=sha256_of(path), format="mat")


def _summary(path: Path, form: str, stated: Stated) -> _Summary:
    """The summary of one file. The whole file is read."""
    if form == "frames":
        raise InputError(f"{path}: frames of a sensor and captures of scans make two datasets; import them apart")
    captured, layout = _capture_of_file(path, form, stated)
    recording, frames = captured.first, captured.frames
    file = ImportedFile(
        name=path.name, sha256=sha256_of(path), format=cast(Literal["tal", "mat", "numpy"], form),
        frames=None if frames is None else len(frames), taken=captured.sentence(layout),
    )  # fmt: skip
    whole, most = numbers_in(path, captured.values)
    across = float(np.linalg.norm(np.ptp(np.concatenate([recording.laser_points, recording.seen_points]), axis=0)))
    if across > _WIDEST_SCAN_M:
        warn(f"{path}: its points are {across:.4g} m apart; are they in metres?", InputWarning, stacklevel=4)
    return _Summary(file, recording.values.shape, recording.paired, recording.time, whole, most)


def _format_of(path: Path, format: str | None, device: object) -> str:
    """The format of a file, as named or by its suffix; arrays of NumPy are frames where a device is named."""
    form = format or _BY_SUFFIX.get(path.suffix.lower())
    if form is None:
        raise InputError(f"{path}: its suffix says no format; say {option('format')}, one of {', '.join(FORMATS)}")
    return "frames" if form == "numpy" and format is None and device is not None else form


def _capture_of_file(path: Path, format: str, stated: Stated) -> tuple[Captured, str]:
    """What one file holds, with the first bins only if the options say so, and the name of its layout."""
    captured, layout = read_capture(path, format, stated)
    there = captured.first.time.bins
    bins = there if stated.options.bins is None else stated.options.bins
    if bins > there:
        raise InputError(f"{path}: has {there} bins, {as_given('bins', bins)} asks for more")
    return captured.with_bins(bins), layout


_last: tuple[tuple[Path, str], Captured] | None = None


def _many_frames(path: Path, format: str, stated: Stated, sha256: str) -> Captured:
    """What one file of many frames holds; the last one read is kept, since its other frames are asked for next."""
    global _last
    if _last is None or _last[0] != (path, sha256 + stated.options.model_dump_json()):
        _last = None
        _last = (path, sha256 + stated.options.model_dump_json()), _capture_of_file(path, format, stated)[0]
    return _last[1]


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
        [one.file for one in given], capture, _store_section(given, field), settings, named, options=options,
        detector_is_known="detector" in settings,
    )  # fmt: skip


def _store_section(given: list[_Summary], field: str | None) -> dict[str, Any]:
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
