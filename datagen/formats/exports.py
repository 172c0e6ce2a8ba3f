"""Scenes of a dataset in the formats of other programs: `datagen export`."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path

from datagen.errors import CheckError, InputError
from datagen.formats.glb import write_stored_glb
from datagen.formats.hub import write_hub
from datagen.formats.matlab import write_mat
from datagen.formats.plain import write_h5, write_npz
from datagen.formats.recording import QUANTITIES
from datagen.formats.tal import write_tal
from datagen.records.checks import as_given, numbers_of, option
from datagen.store.files import PARTIAL, check_writable
from datagen.store.manifest import Manifest
from datagen.store.scenes import SceneContent, Scenes

FORMATS = ("tal", "mat", "npz", "h5", "glb", "hub")
_ENDINGS = {"tal": "hdf5"}
_MEASURED = ("tal", "mat")
_OF_A_FRAME = (*_MEASURED, "glb")
"""Formats whose files hold one measurement."""
_WRITERS: dict[str, Callable[..., None]] = {
    "tal": write_tal, "mat": write_mat, "npz": write_npz, "h5": write_h5, "glb": write_stored_glb,
}  # fmt: skip


def export(
    dataset: str | Path, out: str | Path, format: str, scenes: str | Sequence[int] | None = None,
    field: str | None = None, frame: int | None = None,
) -> list[Path]:  # fmt: skip
    """Write scenes of a dataset as files of another format, one file for each scene; returns their paths.

    dataset, out : the dataset, and the folder for the files `scene-000003.…` (made if it is missing).
    format : `tal`, `mat`, `npz`, `h5`, `glb`, or `hub`: the whole dataset as a folder for the Hugging Face Hub.
    scenes : indices, or a text such as `"0,3-5"`; left out: all scenes that could be made.
    field : for `tal` and `mat`: "histogram", "transient", or one of the background; left out: the first of
        `QUANTITIES` that the dataset has.
    frame : for `tal`, `mat` and `glb` of sequences, which have a file for each frame, `scene-000003-frame-00012.…`:
        this frame only. Files of `npz` and `h5` have all frames.

    Raises
    ------
    InputError : unknown format or scene, no dataset, a scan that the format cannot hold, or h5py missing.
    CheckError : values are missing or damaged, or the disk refused.
    """
    if format not in FORMATS:
        raise InputError(f"{as_given('format', format)}: must be one of {', '.join(FORMATS)}")
    if field is not None and (format not in _MEASURED or field not in QUANTITIES):
        raise InputError(
            f"{as_given('field', field)}: must be one of {', '.join(QUANTITIES)}, with {option('format')} tal or mat"
        )
    root, target = Scenes(dataset), Path(out)
    frames = _frames(root.manifest, format, frame)
    check_writable(target)
    try:
        if format == "hub":
            if scenes is not None:
                raise InputError(f"{option('scenes')}: a folder for the Hub has all of them; leave it out")
            return write_hub(root, target)
        asked = scenes if scenes is None or isinstance(scenes, str) else ",".join(map(str, scenes))
        wanted = root.made() if asked is None else numbers_of("scenes", asked, root.manifest.schema.scenes)
        target.mkdir(parents=True, exist_ok=True)
        write, ending, written = _WRITERS[format], _ENDINGS.get(format, format), []
        for scene in _with_frames(map(root.read, wanted), frames):
            of_frame = "" if scene.frame is None else f"-frame-{scene.frame:05d}"
            path = target / f"scene-{scene.index:06d}{of_frame}.{ending}"
            # The ending stays last in the name, because writers choose the format by it.
            unfinished = path.with_name(f"{path.stem}{PARTIAL}.{ending}")
            try:
                write(scene, unfinished, *([field] if format in _MEASURED else []))
                unfinished.replace(path)
            finally:
                unfinished.unlink(missing_ok=True)
            written.append(path)
    except OSError as error:
        raise CheckError(f"{error.filename or target}: {error.strerror or error}") from None
    return written


def _frames(manifest: Manifest, format: str, frame: int | None) -> Sequence[int] | None:
    """The frames that have files of their own; None where a file holds a whole scene."""
    if manifest.frames is None or format not in _OF_A_FRAME:
        if frame is not None:
            why = "files of this format hold all frames" if manifest.frames else "this dataset has no sequences"
            raise InputError(f"{as_given('frame', frame)}: {why}; leave it out")
        return None
    if frame is None:
        return range(manifest.frames)
    if isinstance(frame, bool) or not isinstance(frame, int) or not 0 <= frame < manifest.frames:
        raise InputError(f"{as_given('frame', frame)}: must be one of 0 … {manifest.frames - 1}")
    return [frame]


def _with_frames(scenes: Iterable[SceneContent], frames: Sequence[int] | None) -> Iterator[SceneContent]:
    for scene in scenes:
        yield from [scene] if frames is None else map(scene.at_frame, frames)
