"""Writing files atomically, checksums of files, and reading files that may be damaged or hostile."""

from __future__ import annotations

import contextlib
import errno
import functools
import hashlib
import json
import math
import os
import re
import secrets
import tempfile
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any, BinaryIO, TypeVar

import pydantic

from datagen.errors import InputError
from datagen.locks import try_lock
from datagen.store.location import Location, size_of, sized_chunks

PARTIAL = ".partial"
"""Suffix of a file that is being written. A file with this suffix that nobody has locked may be deleted."""
JSON_BYTES = 64 * 2**20
"""A larger JSON file was not written by datagen: a record has 256 scenes of 10 kB at most."""
_SEAL = re.compile(rb',\n  "checksum": "([0-9a-f]{64})"\n\}\n\Z')

_NOTHING = errno.ENOENT, errno.ENOTDIR, errno.ELOOP
"""Errors of opening a file that is missing, lies below a file, or is a link that leads nowhere."""
_NOT_PLAIN = errno.EINVAL, errno.ENXIO
"""Errors of opening a folder, a pipe or a socket as a file."""

T = TypeVar("T")


def write_atomically(path: Path, content: bytes) -> None:
    """Write a file: readers see old or new content, even after a crash."""
    with replacing(path) as file:
        file.write(content)


def write_first(path: Path, content: bytes) -> bool:
    """Write a file unless there is one; returns whether it was written. Of several processes one is the first."""
    try:
        with replacing(path, _be_first) as file:
            file.write(content)
    except FileExistsError:
        return False
    return True


def _be_first(partial: Path, path: Path) -> None:
    """Give a file its name. Raises `FileExistsError` if there is one of that name."""
    try:
        os.link(partial, path)
    except FileExistsError:
        raise
    except OSError:
        # On a file system where a file has one name only, an empty file claims it.
        os.close(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o644))
        partial.replace(path)
    partial.unlink(missing_ok=True)


@contextlib.contextmanager
def replacing(path: Path, take_place: Callable[[Path, Path], object] = Path.replace) -> Iterator[BinaryIO]:
    """A new file beside `path`, which is synced and takes its place, by `take_place`, at the end of the block."""
    # Processes of several machines or containers may have one number.
    partial = path.with_name(f"{path.name}.{os.getpid()}-{secrets.token_hex(4)}{PARTIAL}")
    try:
        with _new_locked(partial) as file:
            yield file
            file.flush()
            os.fsync(file.fileno())
            take_place(partial, path)
    except BaseException:
        partial.unlink(missing_ok=True)
        raise
    _sync_folder(path.parent)


def move(source: Path, path: Path) -> None:
    """Let a file that is written and synced take the place of another one. One that is gone was moved before."""
    with contextlib.suppress(FileNotFoundError):
        path.parent.mkdir(parents=True, exist_ok=True)
        source.replace(path)
        _sync_folder(path.parent)


def _sync_folder(folder: Path) -> None:
    """Without this a file may lose its new name in a power cut. Not all file systems support it."""
    with contextlib.suppress(OSError):
        handle = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)


def _new_locked(partial: Path) -> BinaryIO:
    """A new file that is locked, so that `clear_partials` of another build leaves it alone."""
    while True:
        # What stands there may be a link to another file, which must not be overwritten.
        partial.unlink(missing_ok=True)
        file = partial.open("xb")
        if try_lock(file.fileno(), otherwise=True) and os.fstat(file.fileno()).st_nlink > 0:
            return file
        file.close()


def clear_partials(folder: Path) -> None:
    """Remove the half-written files that killed builds left in a folder; those of running builds are locked."""
    for partial in folder.glob(f"*{PARTIAL}"):
        with contextlib.suppress(OSError):
            handle = os.open(partial, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK)
            try:
                if try_lock(handle, otherwise=False):
                    partial.unlink()
            finally:
                os.close(handle)


def bytes_below(folder: Path) -> int:
    """The size in bytes of all files below a folder."""
    return sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())


def write_if_changed(path: Path, content: bytes) -> None:
    """`write_atomically`, unless the file has exactly this content already."""
    if not holds(path, content):
        write_atomically(path, content)


def holds(path: Location, content: bytes) -> bool:
    """Whether a file exists and has exactly this content. A file of another size is not read."""
    return difference(path, hashlib.sha256(content).hexdigest(), len(content)) is None


def json_bytes(value: Any) -> bytes:
    """A value as the JSON that files of a dataset hold: keys in the order given, floats that round-trip, a final
    newline. A dataclass becomes a mapping of its fields."""
    return (json.dumps(value, indent=2, ensure_ascii=False, default=vars) + "\n").encode()


def finite(value: Any) -> Any:
    """The value with None instead of NaN and infinity, which JSON does not have."""
    if isinstance(value, dict):
        return {key: finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [finite(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def sealed_bytes(values: dict[str, Any]) -> bytes:
    """`json_bytes` with `checksum` as the last key: the SHA-256 of the file without that key."""
    body = json_bytes(values)
    return body[:-3] + f',\n  "checksum": "{hashlib.sha256(body).hexdigest()}"\n}}\n'.encode()


def is_intact(content: bytes) -> bool:
    """Whether a file's content ends in the checksum of the rest."""
    seal = _SEAL.search(content, max(0, len(content) - 100))
    return seal is not None and hashlib.sha256(content[: seal.start()] + b"\n}\n").hexdigest().encode() == seal[1]


def read_whole(path: Location) -> bytes:
    """The content of a JSON file of a dataset; raises `InputError` if it is missing, no plain file, or too large."""
    content = read_if_there(path)
    if content is None:
        raise InputError(f"{path}: missing, or not a plain file")
    return content


def read_if_there(path: Location) -> bytes | None:
    """The content of a JSON file of a dataset, or None if it is missing; raises `InputError` if it is no plain file,
    cannot be read, or is larger than `JSON_BYTES`."""
    try:
        with sized_chunks(path) as (size, chunks):
            content = b"".join(chunks) if size <= JSON_BYTES else None
    except OSError as error:
        if error.errno in _NOTHING:
            return None
        if error.errno in _NOT_PLAIN:
            raise InputError(f"{path}: missing, or not a plain file") from None
        raise InputError(f"{path}: cannot be read ({error.strerror or error})") from None
    if content is None:
        raise InputError(f"{path}: larger than {JSON_BYTES // 2**20} MiB, which datagen never writes")
    return content


def read_json(path: Location) -> Any:
    """The value of a JSON file; raises `InputError`, which names the file, if it is no JSON."""
    return parsed_json(path, read_whole(path), Any)


@functools.cache
def _adapter(kind: Any) -> pydantic.TypeAdapter[Any]:
    """The validator of a type. It is cached, because making one takes pydantic some milliseconds."""
    return pydantic.TypeAdapter(kind)


def parsed_json(path: Location, content: bytes, kind: type[T]) -> T:
    """The JSON `content` of a file as a value of type `kind`; raises `InputError`, one line, for anything else."""
    try:
        value: T = _adapter(kind).validate_json(content, strict=True)  # type: ignore[arg-type]
        return value
    except pydantic.ValidationError as error:
        first = error.errors(include_url=False, include_input=False, include_context=False)[0]
        where = ".".join(map(str, first["loc"]))
        raise InputError(f"{path}: is not as datagen writes it ({where and where + ': '}{first['msg']})") from None


def own_path(root: Path, name: str) -> Path:
    """`root / name`, for a file that will be written or deleted. Raises `InputError` if a part of `name` is a
    symbolic link, which may lead out of the dataset; `root` itself may be one."""
    path = root
    for part in Path(name).parts:
        path = path / part
        if path.is_symlink():
            raise InputError(
                f"{path}: is a symbolic link, and a build writes in its own folder alone; put a folder or file there"
            )
    return path


def sha256_of(path: Location) -> str:
    """Hex SHA-256 of a file's bytes."""
    with sized_chunks(path) as (_, chunks):
        return _sha256(chunks)


def _sha256(chunks: Iterable[bytes]) -> str:
    whole = hashlib.sha256()
    for chunk in chunks:
        whole.update(chunk)
    return whole.hexdigest()


def difference(path: Location, sha256: str | None, due_bytes: int | None = None) -> str | None:
    """A sentence on how a file differs from the content that was written, or None if it does not differ.

    sha256 : of the content that was written; None: only sizes are compared.
    due_bytes : size of the content that was written. A file of another size is not read; without `due_bytes` a file
        larger than `JSON_BYTES` is not read.
    """
    try:
        if sha256 is None:
            size, same = size_of(path), True
        else:
            with sized_chunks(path) as (size, chunks):
                is_read = size == due_bytes if due_bytes is not None else size <= JSON_BYTES
                same = is_read and _sha256(chunks) == sha256
    except OSError as error:
        if error.errno in _NOTHING + _NOT_PLAIN:
            return "missing"
        raise
    if due_bytes is not None and size != due_bytes:
        return f"{size} bytes, {due_bytes} were written"
    return None if same else "its bytes have changed since they were written (SHA-256 differs)"


def check_writable(path: Path, by: str = "") -> None:
    """Raise `InputError` unless the folder `path` exists or can be made, and files can be made in it.

    by : how to name another folder, such as " with --out".
    """
    try:
        os.lstat(path)
    except (FileNotFoundError, NotADirectoryError):
        pass
    except OSError as error:
        # A name that is too long for the file system, or a folder that may not be looked into.
        raise InputError(f"output {path}: {error.strerror}; name another folder{by}") from None
    existing = path
    while not os.path.lexists(existing) and existing != existing.parent:
        existing = existing.parent
    if not existing.is_dir():
        what = "is a file" if existing == path else f"cannot be made: {existing} is a file"
        raise InputError(f"output {path}: {what}, not a folder; name a new folder, or a dataset to resume")
    try:
        # Permission bits are not reliable on every file system, so a file is made; it has no name and leaves no
        # trace. On file systems without such files another build takes it for the rest of a first file (`is_fresh`).
        with tempfile.TemporaryFile(prefix="dataset.json.", suffix=PARTIAL, dir=existing):
            pass
    except OSError as error:
        reason = error.strerror or type(error).__name__
        raise InputError(
            f"output {path}: {existing} cannot be written ({reason}); name a folder that you may write to{by}"
        ) from None
