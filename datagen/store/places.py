"""Where a dataset lies: a local folder, or below a prefix of an object store (`s3://bucket/name`).

A `Bucket` answers to what reading asks of a `pathlib.Path`, so that there is one way of reading. Credentials, region
and endpoint come from the environment alone (`AWS_ACCESS_KEY_ID`, `AWS_SECRET_ACCESS_KEY`, `AWS_REGION`,
`AWS_ENDPOINT_URL` …).
"""

from __future__ import annotations

import fnmatch
import importlib
import io
import os
import re
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path, PurePosixPath
from typing import Any, NamedTuple, TypeVar

from datagen.errors import CheckError, InputError

SCHEME = "s3://"


class Stat(NamedTuple):
    """What `stat` tells of an object."""

    st_size: int


@dataclass(frozen=True)
class Bucket:
    """An object, or a prefix of objects, of an object store.

    Attributes
    ----------
    bucket, key : its address is `s3://bucket/key`.
    """

    bucket: str
    key: PurePosixPath

    def __str__(self) -> str:
        return f"{SCHEME}{self.bucket}/{self.key}"

    def __truediv__(self, name: str | PurePosixPath) -> Bucket:
        return Bucket(self.bucket, self.key / name)

    @property
    def name(self) -> str:
        """The last part of its address."""
        return self.key.name

    def resolve(self) -> Bucket:
        """Itself: there are no links."""
        return self

    def exists(self) -> bool:
        """Whether there is such an object, or one below it."""
        return self.is_file() or self.is_dir()

    def is_file(self) -> bool:
        """Whether there is such an object."""
        return self._size() is not None

    def is_dir(self) -> bool:
        """Whether there is an object below it."""
        return next(self._below(), None) is not None

    def stat(self) -> Stat:
        """Its size in bytes; raises `FileNotFoundError`."""
        size = self._size()
        if size is None:
            raise FileNotFoundError(2, "no such object", str(self))
        return Stat(size)

    def read_bytes(self) -> bytes:
        """All of it; raises `FileNotFoundError`."""
        return self.sized()[1].read()

    def sized(self) -> tuple[int, io.BufferedReader]:
        """Its size in bytes, and a stream of them, for one request; raises `FileNotFoundError`."""
        answer = self._asked("get", str(self.key))
        return int(answer.meta["size"]), io.BufferedReader(_Body(self, answer))

    def open(self, mode: str = "rb") -> io.BytesIO:
        """The same as a file."""
        assert mode == "rb"
        return io.BytesIO(self.read_bytes())

    def read_range(self, offset: int, size: int) -> bytes:
        """So many bytes from there."""
        return bytes(self._asked("get_range", str(self.key), start=offset, length=size)) if size > 0 else b""

    def glob(self, pattern: str) -> Iterator[Bucket]:
        """Objects right below it whose names match."""
        depth = len(self.key.parts) + 1
        for key in self._below():
            if len(key.parts) == depth and fnmatch.fnmatch(key.name, pattern):
                yield Bucket(self.bucket, key)

    def write_bytes(self, content: bytes) -> None:
        """Put an object there: a reader sees it whole or not at all."""
        self._asked("put", str(self.key), content)

    def put(self, file: Path) -> None:
        """Put a file's bytes there; a large one goes in parts, and is there when all are."""
        self._asked("put", str(self.key), file)

    def unlink(self) -> None:
        """Remove the object, if it is there."""
        try:
            self._asked("delete", str(self.key))
        except FileNotFoundError:
            return

    def _size(self) -> int | None:
        try:
            return int(self._asked("head", str(self.key))["size"])
        except FileNotFoundError:
            return None

    def _below(self) -> Iterator[PurePosixPath]:
        try:
            for batch in self._asked("list", f"{self.key}/"):
                for found in batch:
                    yield PurePosixPath(found["path"])
        except Exception as error:
            raise self._refused(error) from None

    def _asked(self, what: str, *arguments: Any, **options: Any) -> Any:
        if _forked:
            raise CheckError(
                f"{self}: connections to object stores do not survive a fork; start workers anew, as by "
                "DataLoader(…, multiprocessing_context='spawn')"
            )
        store = _store_of(self.bucket)
        try:
            return getattr(importlib.import_module("obstore"), what)(store, *arguments, **options)
        except FileNotFoundError:
            raise FileNotFoundError(2, "no such object", str(self)) from None
        except Exception as error:
            raise self._refused(error) from None

    def _refused(self, error: Exception) -> Exception:
        """What to tell of an error of the store: its first line, which holds no credentials."""
        if isinstance(error, CheckError | InputError):
            return error
        text = " ".join(str(error).strip().partition("\n")[0].split())[:300]
        return CheckError(f"{self}: {text}; look at the address, the network and AWS_* in the environment")


class _Body(io.RawIOBase):
    """What the store answers, as it comes in."""

    def __init__(self, whose: Bucket, answer: Any) -> None:
        self._whose, self._chunks, self._left = whose, iter(answer), memoryview(b"")

    def readable(self) -> bool:
        return True

    def readinto(self, into: Any) -> int:
        try:
            while not self._left:
                self._left = memoryview(bytes(next(self._chunks)))
        except StopIteration:
            return 0
        except Exception as error:
            raise self._whose._refused(error) from None
        size = min(len(into), len(self._left))
        into[:size], self._left = self._left[:size], self._left[size:]
        return size


Place = Path | Bucket
AnyPlace = TypeVar("AnyPlace", Path, Bucket)


def place(path: str | Path | Bucket) -> Place:
    """The place that a path or an address names.

    Raises `InputError` for an address without bucket or name, with credentials, or of another scheme, and where the
    extra `s3` is not installed.
    """
    if isinstance(path, Path | Bucket):
        return path
    if not re.match(r"[a-z][a-z0-9+.-]*://", path):
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


_forked = False
"""Whether this process was forked from one that had connections: their threads are not here, and waiting for them
would never end."""


def _after_fork() -> None:
    global _forked
    _forked = _forked or _store_of.cache_info().currsize > 0


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_after_fork)


@cache
def _store_of(bucket: str) -> Any:
    """The connection of this process to a bucket."""
    made = importlib.import_module("obstore.store").S3Store
    try:
        return made(bucket, retry_config={"max_retries": 5}, client_options={"timeout": "60s"} | _allowed())
    except Exception as error:
        raise InputError(f"{SCHEME}{bucket}: {str(error).partition(chr(10))[0]}; look at AWS_*") from None


def _allowed() -> dict[str, Any]:
    """Plain HTTP where the endpoint that the environment names has it: that of one's own machine or network."""
    endpoint = os.environ.get("AWS_ENDPOINT_URL", os.environ.get("AWS_ENDPOINT", ""))
    return {"allow_http": True} if endpoint.startswith("http://") else {}
