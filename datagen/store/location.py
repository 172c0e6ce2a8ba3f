"""The location of a dataset, a local folder or a prefix of an object store (`s3://bucket/name`), and reading from it.

A `Bucket` has those methods of a `pathlib.Path` that reading needs, so all readers take either. Credentials, region
and endpoint come from the environment alone (`AWS_ACCESS_KEY_ID`, `AWS_SECRET_ACCESS_KEY`, `AWS_REGION`,
`AWS_ENDPOINT_URL` …).
"""

from __future__ import annotations

import errno
import importlib
import io
import os
import re
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext, suppress
from dataclasses import dataclass
from functools import cache
from pathlib import Path, PurePosixPath
from typing import Any, TypeVar

from datagen import untrusted
from datagen.errors import CheckError, InputError
from datagen.records.checks import check_path

SCHEME = "s3://"
READ_BYTES = 2**20
"""Bytes that are read at a time, so that a large file need not fit into memory."""


@dataclass(frozen=True)
class Bucket:
    """An object, or a prefix of objects, of an object store; its address is `s3://bucket/key`."""

    bucket: str
    key: PurePosixPath

    def __str__(self) -> str:
        return f"{SCHEME}{self.bucket}/{self.key}"

    def __truediv__(self, name: str | PurePosixPath) -> Bucket:
        return Bucket(self.bucket, self.key / name)

    @property
    def name(self) -> str:
        """The last part of the address."""
        return self.key.name

    def resolve(self) -> Bucket:
        """The same address: an object store has no links."""
        return self

    def is_file(self) -> bool:
        """Whether there is an object of this address."""
        try:
            return self.size() >= 0
        except FileNotFoundError:
            return False

    def is_dir(self) -> bool:
        """Whether there is an object below this prefix."""
        return next(self._below(), None) is not None

    def size(self) -> int:
        """The size of the object in bytes; raises `FileNotFoundError`."""
        return int(self._requested("head", str(self.key))["size"])

    def chunks(self) -> tuple[int, Iterator[bytes]]:
        """Size in bytes, and content piece by piece, in one request; raises `FileNotFoundError`."""
        answer = self._requested("get", str(self.key))
        return int(answer.meta["size"]), (bytes(piece) for piece in self._guarded(answer))

    def read_bytes(self) -> bytes:
        """The content of the object; raises `FileNotFoundError`."""
        return b"".join(self.chunks()[1])

    def read_range(self, offset: int, size: int) -> bytes:
        """`size` bytes of the object from `offset` on."""
        return bytes(self._requested("get_range", str(self.key), start=offset, length=size)) if size > 0 else b""

    def glob(self, pattern: str) -> Iterator[Bucket]:
        """Objects directly below this prefix whose names match."""
        return (Bucket(self.bucket, key) for key in self._below() if key.match(pattern) and key.parent == self.key)

    def put(self, file: Path | bytes) -> None:
        """Upload a file, or some bytes. A large file is sent in parts, and the object appears when all are there."""
        self._requested("put", str(self.key), file)

    def put_first(self, file: Path) -> bool:
        """Upload a file unless there is an object of this address; returns whether it was uploaded. Of two processes
        one is the first, in a store that has conditional uploads; in any other both are."""
        try:
            self._requested("put", str(self.key), file, mode="create")
        except FileExistsError:
            return False
        except CheckError:
            self.put(file)
        return True

    def unlink(self, missing_ok: bool = False) -> None:
        """Remove the object; raises `FileNotFoundError` if it is missing and that is not allowed."""
        with suppress(FileNotFoundError) if missing_ok else nullcontext():
            self._requested("delete", str(self.key))

    def unlink_below(self) -> None:
        """Remove all objects below this prefix."""
        for key in [*self._below()]:
            Bucket(self.bucket, key).unlink(missing_ok=True)

    def _below(self) -> Iterator[PurePosixPath]:
        for batch in self._guarded(self._requested("list", f"{self.key}/")):
            yield from (PurePosixPath(entry["path"]) for entry in batch)

    def _requested(self, what: str, *arguments: Any, **options: Any) -> Any:
        """The answer of a function of obstore."""
        if _forked:
            raise CheckError(
                f"{self}: connections to object stores do not survive a fork; start workers anew, as by "
                "DataLoader(…, multiprocessing_context='spawn')"
            )
        store = _store_of(self.bucket)
        with self._one_line():
            return getattr(importlib.import_module("obstore"), what)(store, *arguments, **options)

    def _guarded(self, answer: Any) -> Iterator[Any]:
        """The items of an answer, which are requested one after the other."""
        with self._one_line():
            yield from answer

    @contextmanager
    def _one_line(self) -> Iterator[None]:
        """Turn errors of obstore into one line for the user: the first of its message, without credentials."""
        try:
            yield
        except FileNotFoundError:
            raise FileNotFoundError(errno.ENOENT, "no such object", str(self)) from None
        except Exception as error:
            if type(error).__name__ in ("AlreadyExistsError", "PreconditionError"):
                raise FileExistsError(errno.EEXIST, "there is such an object", str(self)) from None
            text = " ".join(str(error).strip().partition("\n")[0].split())[:300]
            raise CheckError(
                f"{self}: {text}; look at the address, the network and AWS_* in the environment"
            ) from None


Location = Path | Bucket
AnyLocation = TypeVar("AnyLocation", Path, Bucket)


def location_of(path: str | Path | Bucket) -> Location:
    """The location that a path or an address names.

    Raises `InputError` for an address without bucket or name, with credentials, or of another scheme than s3, and if
    the extra `s3` is not installed.
    """
    if isinstance(path, Bucket):
        return path
    check_path("path", path, "name the folder of a dataset, or s3://bucket/name")
    if isinstance(path, os.PathLike) or not re.match(r"[a-z][a-z0-9+.-]*://", path):
        return Path(path)
    named = re.fullmatch(r"s3://([a-z0-9][a-z0-9.-]{1,62})/((?:[\w.=+ -]+/)*[\w.=+ -]+)/?", path)
    if named is None or any(part in (".", "..") for part in named[2].split("/")):
        hidden = re.sub(r"//[^/]*@", "//…@", path)
        raise InputError(f"{hidden}: must be s3://bucket/name; credentials come from the environment (AWS_*)")
    try:
        importlib.import_module("obstore")
    except ImportError:
        raise InputError(f"{path}: the package obstore is not installed; pip install nlos-datagen[s3]") from None
    return Bucket(named[1], PurePosixPath(named[2]))


@contextmanager
def opened(path: Location) -> Iterator[tuple[int, io.BufferedReader | io.BytesIO]]:
    """Size and content of a plain file, or of an object. Raises `OSError` if there is none (errno EINVAL: it is no
    plain file), and `CheckError` if this process has too many files open."""
    if isinstance(path, Bucket):
        content = path.read_bytes()
        yield len(content), io.BytesIO(content)
        return
    with untrusted.opened(path) as found:
        yield found


@contextmanager
def sized_chunks(path: Location) -> Iterator[tuple[int, Iterator[bytes]]]:
    """Size of a file or object, and its content piece by piece: a caller can refuse it by its size before reading.
    Raises as `opened` does."""
    if isinstance(path, Bucket):
        yield path.chunks()
        return
    with opened(path) as (size, file):
        yield size, iter(lambda: file.read(READ_BYTES), b"")


def size_of(path: Location) -> int:
    """Bytes of a file or object; raises as `opened` does."""
    if isinstance(path, Bucket):
        return path.size()
    with opened(path) as (size, _):
        return size


def read_range(path: Location, offset: int, size: int) -> bytes:
    """`size` bytes from `offset` on, or fewer if the file ends before; raises as `opened` does. Each call opens the
    file, which takes some 10 µs: readers that kept files open would reach the limit of open files."""
    if isinstance(path, Bucket):
        return path.read_range(offset, size)
    with opened(path) as (_, file):
        return os.pread(file.fileno(), size, offset)


_forked = False
"""Whether this process was forked from a process with connections. The threads of these connections do not exist in
this process, so a request would wait forever."""


def _after_fork() -> None:
    global _forked
    _forked = _forked or _store_of.cache_info().currsize > 0


os.register_at_fork(after_in_child=_after_fork)


@cache
def _store_of(bucket: str) -> Any:
    """The connection of this process to a bucket; by plain HTTP if the environment names an endpoint with it, such as
    one on this machine."""
    made = importlib.import_module("obstore.store").S3Store
    endpoint = os.environ.get("AWS_ENDPOINT_URL", os.environ.get("AWS_ENDPOINT", ""))
    options = {"timeout": "60s"} | ({"allow_http": True} if endpoint.startswith("http://") else {})
    try:
        return made(bucket, retry_config={"max_retries": 5}, client_options=options)
    except Exception as error:
        raise InputError(f"{SCHEME}{bucket}: {str(error).partition(chr(10))[0]}; look at AWS_*") from None
