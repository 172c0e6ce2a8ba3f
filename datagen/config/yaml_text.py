"""YAML text → plain values, safely: YAML 1.2 numbers (`1e6` is one), merge keys (`<<: *shared`), no repeated keys,
the line named in errors."""

from __future__ import annotations

import errno
import os
import re
from pathlib import Path
from typing import Any

import yaml

from datagen.errors import InputError, TooLargeError
from datagen.untrusted import NO_PLAIN_FILE, opened

MOST_CHARACTERS = 2**18
MOST_NODES = 100_000
"""Largest number of keys and values of a configuration, aliases written out."""

TEXT, MERGE = "tag:yaml.org,2002:str", "tag:yaml.org,2002:merge"


class _Loader(yaml.SafeLoader):
    """YAML's safe types, numbers as of YAML 1.2."""


_Loader.add_implicit_resolver(
    "tag:yaml.org,2002:float",
    re.compile(r"^[-+]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)[eE][-+]?[0-9]+$"),
    list("-+0123456789."),
)
# No key takes a date; without YAML's resolver of dates it stays text, and is refused with the message for text.
_Loader.yaml_implicit_resolvers = {
    first: [(t, r) for t, r in resolvers if t != "tag:yaml.org,2002:timestamp"]
    for first, resolvers in _Loader.yaml_implicit_resolvers.items()
}


def _check(node: Any, source: str) -> None:
    """Refuse keys that are no text or stand twice, which YAML allows, and a document whose aliases would make it
    larger than any configuration, or endless, once expanded."""
    sizes: dict[int, int] = {}

    def size(node: Any) -> int:
        if id(node) not in sizes:
            # A node that holds an alias of itself is endless.
            sizes[id(node)] = MOST_NODES
            below = node.value if isinstance(node, yaml.CollectionNode) else ()
            if isinstance(node, yaml.MappingNode):
                _check_keys([key for key, _ in below])
                below = [part for pair in below for part in pair]
            sizes[id(node)] = min(MOST_NODES, 1 + sum(size(part) for part in below))
        return sizes[id(node)]

    if node is not None and size(node) >= MOST_NODES:
        raise TooLargeError(
            f"{source}: aliases make it hold {MOST_NODES} values or more; write out what they stand for"
        )


def _check_keys(keys: list[Any]) -> None:
    seen: set[str] = set()
    for key in (key for key in keys if key.tag != MERGE):
        if key.tag != TEXT or key.value in seen:
            problem = "this key is not text" if key.tag != TEXT else f"key {key.value!r} stands twice"
            raise yaml.constructor.ConstructorError(None, None, problem, key.start_mark)
        seen.add(key.value)


def read_yaml(path: Path, remedy: str) -> dict[str, Any]:
    """The mapping that a file holds; raises `InputError` for a file that is missing, which `remedy` ends, or that is
    no UTF-8 text, and as `parse_yaml`."""
    try:
        with opened(path) as (size, file):
            if size > 4 * MOST_CHARACTERS:
                raise TooLargeError(f"{path}: more than {MOST_CHARACTERS} characters; shorten it")
            text = file.read().decode("utf-8")
    except FileNotFoundError:
        raise InputError(f"{path}: no such file; {remedy}") from None
    except (OSError, UnicodeDecodeError) as error:
        if os.path.isdir(path):
            raise InputError(f"{path}: is a directory; name a YAML file in it") from None
        why = NO_PLAIN_FILE if isinstance(error, OSError) and error.errno == errno.EINVAL else None
        raise InputError(f"{path}: {why or f'cannot be read as UTF-8 text ({error})'}; {remedy}") from None
    return parse_yaml(text, str(path))


def parse_yaml(text: str, source: str) -> dict[str, Any]:
    """The mapping that `text` holds; raises `InputError` naming `source`, line and column for anything else."""
    if len(text) > MOST_CHARACTERS:
        raise TooLargeError(f"{source}: more than {MOST_CHARACTERS} characters; shorten it")
    try:
        loader = _Loader(text)
        try:
            node = loader.get_single_node()
            _check(node, source)
            values = None if node is None else loader.construct_document(node)
        finally:
            loader.dispose()
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark
        where = f"line {mark.line + 1}, column {mark.column + 1}: " if mark else ""
        raise InputError(f"{source}: {where}broken YAML: {error.problem}") from None
    except RecursionError:
        raise TooLargeError(f"{source}: nested too deeply") from None
    except InputError:
        raise
    except (yaml.YAMLError, ValueError) as error:
        # Python refuses whole numbers of thousands of digits with a `ValueError`.
        raise InputError(f"{source}: broken YAML: {str(error).splitlines()[0]}") from None
    if not isinstance(values, dict):
        what = "nothing" if values is None else f"a {type(values).__name__}"
        raise InputError(f"{source}: a mapping of keys is needed at the top level, {what} found")
    return values
