"""Writes docs/api.md from the signatures and docstrings of the public names: `make docs`."""

from __future__ import annotations

import inspect
import re
import sys
from collections.abc import Callable
from functools import cached_property
from pathlib import Path
from typing import Any, get_args, get_origin

import numpy as np
import numpy.typing
from pydantic import BaseModel

import datagen

PAGE = Path(__file__).with_name("api.md")
STAGES = (
    "records",
    "config",
    "scene",
    "capture",
    "transport",
    "effects",
    "detector",
    "evidence",
    "design",
    "building",
    "importing",
    "loader",
    "suites",
    "scoring",
    "paper",
    "errors",
)
INTRODUCTION = """\
# API

Every public name of `datagen` (`import datagen as dg`), in the order of the stages. Written from the docstrings by
`make docs`; lengths are in metres, times in seconds, and arrays have the axes laser (L), pixel (P) and bin (T). Bad
input raises `InputError` with one line that names key, value, allowed range and remedy.
"""


def page() -> str:
    """The whole page: public names by stage, classes first."""
    named = {name: getattr(datagen, name) for name in datagen.__all__ if not name.startswith("_")}
    contents, sections = [INTRODUCTION], list[str]()
    for stage in STAGES:
        ours = sorted((not inspect.isclass(o), n) for n, o in named.items() if o.__module__.split(".")[1] == stage)
        contents.append(f"- `{stage}`: " + " · ".join(f"[{name}](#{name.lower()})" for _, name in ours))
        sections += [f"## `datagen.{stage}`\n", *(_entry(name, named.pop(name)) for _, name in ours)]
    if named:
        raise SystemExit(f"docs/make_api.py: {', '.join(named)} belong to none of the stages {', '.join(STAGES)}")
    return "\n".join([*contents, "", *sections])


def _entry(name: str, thing: Any) -> str:
    text = [f"### {name}\n", f"```python\n{_signature(name, thing)}\n```\n", _markdown(thing)]
    for key, value in vars(thing).items() if inspect.isclass(thing) else ():
        member = value.__func__ if isinstance(value, (classmethod, staticmethod)) else value
        written = member.func if isinstance(member, cached_property) else getattr(member, "fget", None) or member
        if key.startswith("_") or not inspect.isfunction(written):
            continue
        shown = f"{name}.{key}" if written is not member else _signature(f"{name}.{key}", getattr(thing, key))
        text += [f"```python\n{shown}\n```\n", _markdown(written)]
    return "\n".join(filter(None, text))


def _signature(name: str, thing: Callable[..., Any]) -> str:
    """`name(parameters) -> returned`, annotations as the source has them, on one line where it fits."""
    if inspect.isclass(thing) and issubclass(thing, BaseModel | Exception):
        return name  # the keys of a configuration stand in configs/schema.json
    signature = inspect.signature(thing)
    shown, keyword_only = list[str](), False
    for p in signature.parameters.values():
        if p.name == "self":
            continue
        keyword_only = keyword_only or p.kind is p.VAR_POSITIONAL
        if p.kind is p.KEYWORD_ONLY and not keyword_only:
            shown, keyword_only = [*shown, "*"], True
        stars = {p.VAR_POSITIONAL: "*", p.VAR_KEYWORD: "**"}.get(p.kind, "")
        default = "" if p.default is p.empty else f" = {getattr(p.default, '__name__', repr(p.default))}"
        shown.append(f"{stars}{p.name}: {written(p.annotation, thing)}{default.replace('<factory>', '…')}")
    returned = signature.return_annotation
    tail = ")" if inspect.isclass(thing) or returned is signature.empty else f") -> {written(returned, thing)}"
    line = f"{name}({', '.join(shown)}{tail}"
    return line if len(line) <= 110 else f"{name}(\n    " + ",\n    ".join(shown) + f",\n{tail}"


def written(annotation: str, thing: Any) -> str:
    """An annotation as the source has it, but names of kinds of arrays and choices written out."""

    def spelled(match: re.Match[str]) -> str:
        kind = getattr(sys.modules[thing.__module__], match[0], None)
        if match[0] in numpy.typing.__all__:
            return match[0]
        if get_origin(kind) is np.ndarray:
            number = get_args(get_args(kind)[1])[0]
            return f"NDArray[np.{(get_origin(number) or number).__name__}]"
        if get_origin(kind) is None:
            return match[0]
        return re.sub(r"\b(?:[a-z]\w*\.)+(?=[A-Z])", "", str(kind))

    return re.sub(r"(?<![\w.'\"])[A-Za-z_]\w*\b(?![.'\"])", spelled, annotation)


def _markdown(thing: Any) -> str:
    """A docstring of the house (NumPy style, fields as `name : meaning`, doctests) as Markdown."""
    text = inspect.getdoc(thing) or ""
    text = re.sub(r"^(\w+)\n-{3,}$", r"**\1**\n", text, flags=re.MULTILINE)
    text = re.sub(r"^(>>> .*(?:\n.+)*)", r"```python\n\1\n```", text, flags=re.MULTILINE)
    text = re.sub(r"^([A-Za-z_][\w, ]*) : |^(\w*Error)\n +", r"- `\1\2`: ", text, flags=re.MULTILINE)
    return text + "\n" if text else ""


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
