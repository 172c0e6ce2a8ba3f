"""How mkdocstrings reads the docstrings and signatures of datagen: an extension of griffe.

The house writes `name : meaning` where numpydoc has the type after the colon, since signatures have the types, and
`Returns` without one. Kinds of arrays have short names in the sources (`Floats`), which readers cannot import.
"""

from __future__ import annotations

import ast
import importlib
import re
from typing import Annotated, Any, get_args, get_origin

import griffe
import numpy as np
import numpy.typing

import datagen

PUBLIC = {getattr(datagen, name).__module__ for name in datagen.__all__ if not name.startswith("_")}
"""The modules whose signatures are shown."""


class House(griffe.Extension):
    """Docstrings as numpydoc has them, and annotations whose names a reader can import."""

    def on_object(self, *, obj: griffe.Object, **kwargs: Any) -> None:
        """Called once for each module, class, function and attribute."""
        if obj.module.path not in PUBLIC:
            return
        if isinstance(obj, griffe.Function):
            for parameter in obj.parameters:
                parameter.annotation = _spelled(parameter.annotation, obj.module)
            obj.returns = _spelled(obj.returns, obj.module)
        elif isinstance(obj, griffe.Attribute):
            obj.annotation = _spelled(obj.annotation, obj.module)
        if obj.docstring:
            returned = getattr(obj, "returns", None) or getattr(obj, "annotation", None)
            obj.docstring.value = numpydoc(obj.docstring.value, str(returned or ""))


def numpydoc(text: str, returned: str) -> str:
    """A docstring of the house as numpydoc has it, with the type `returned` before what is said of it."""
    text = re.sub(r"^(\*{0,2}[A-Za-z_][\w, *]*) : (.*)$", r"\1\n    \2", text, flags=re.MULTILINE)
    return re.sub(
        r"(?<=^Returns\n-------\n)((?:(?!\n\n).)+)",
        lambda found: f"{returned}\n    " + found[1].replace("\n", "\n    "),
        text,
        flags=re.MULTILINE | re.DOTALL,
    )


def _spelled(annotation: Any, module: griffe.Module) -> Any:
    """An annotation of griffe with the names of kinds of arrays and choices written out."""
    if annotation is None or (text := spelled(str(annotation), module.path)) == str(annotation):
        return annotation
    return griffe.safe_get_annotation(ast.parse(text, mode="eval").body, parent=module)


def spelled(annotation: str, module: str) -> str:
    """An annotation as the source has it, but names of kinds of arrays and choices written out."""
    names = vars(importlib.import_module(module))

    def written_out(match: re.Match[str]) -> str:
        kind = names.get(match[0])
        if match[0] in numpy.typing.__all__:
            return match[0]
        if get_origin(kind) is np.ndarray:
            number = get_args(get_args(kind)[1])[0]
            return f"NDArray[np.{(get_origin(number) or number).__name__}]"
        if get_origin(kind) in (None, Annotated):
            return match[0]
        return re.sub(r"\b(?:[a-z]\w*\.)+(?=[A-Z])", "", str(kind))

    return re.sub(r"(?<![\w.'\"])[A-Za-z_]\w*\b(?![.'\"])", written_out, annotation)
