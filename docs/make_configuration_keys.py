"""Writes docs/configuration_keys.md from the configuration models and the table of labels: `make generated`."""

from __future__ import annotations

import inspect
from collections.abc import Iterator
from pathlib import Path
from types import UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin

import numpy as np
import numpy.typing
import yaml
from pydantic import AfterValidator
from pydantic.fields import FieldInfo

import datagen
from datagen.config.base import Settings
from datagen.records.label_fields import LABEL_FIELDS

PAGE = Path(__file__).with_name("configuration_keys.md")
INTRODUCTION = """\
# Configuration keys

Every key of a configuration, from the whole (`DatasetConfig`) to its sections, and the [labels](#labels) that
`store.fields` may name. `make generated` makes this page of the configuration models; how to use the keys:
[configuration](configuration.md).

*number or distribution*: a number, or `{uniform: [low, high]}`, `{log_uniform: [low, high]}`,
`{normal: {mean, std, low, high}}` or `{choice: [values], weights: [weights]}`, drawn anew for every scene; *allowed*
then holds for every value that can be drawn. A unit is part of a key's name.
"""
LABELS = """\
## Labels

The arrays of ground truth for each name in `store.fields`: axes of one scene, type, unit, meaning.

| `store.fields` | array | axes | type | unit | meaning |
|---|---|---|---|---|---|"""
UNITS = {
    "_per_m": "1/m", "_mhz": "MHz", "_deg": "°", "_hz": "Hz", "_mm": "mm", "_nm": "nm", "_ns": "ns", "_ps": "ps",
    "_s": "s", "_m": "m",
}  # fmt: skip
"""Ending of a key → its unit, the longest endings first."""
CHECKED = {
    "_whole": "whole, ≥ 0",
    "_known_classes": "classes or groups of the library",
    "_known_materials": "materials of the catalogue",
    "checked_wavelength_nm": "≥ 532, ≤ 1550",
    "_existing_file": "a file",
    "_is_table": "2 to 64 numbers ≥ 0, not all 0",
    "_existing_folder": "a folder with meshes",
}
"""Validator of `datagen.config` → what it allows, in words."""


def page() -> str:
    """The whole page."""
    places = _places()
    return "\n".join([INTRODUCTION, *(_keys(model, places) for model in places), _labels()])


def _labels() -> str:
    """The section of the arrays of labels."""
    rows = [
        f"| `{of.label}` | `{of.name}` | {', '.join(of.dims)} | {of.dtype} | {of.unit} | {of.meaning} |"
        for of in LABEL_FIELDS
    ]
    return "\n".join([LABELS, *rows, ""])


def _places() -> dict[type[Settings], str]:
    """Every model of the configuration → the key that it is first met at, sections first and bases before what
    inherits them."""
    found: dict[type[Settings], str] = {}
    waiting = [(datagen.DatasetConfig, "")]
    for model, place in waiting:  # grows as it goes
        bases = [base for base in model.__mro__ if issubclass(base, Settings) and not base.__name__.startswith("_")]
        for one in reversed(bases[: bases.index(Settings)]):
            found.setdefault(one, place)
        for name, field in model.model_fields.items():
            inner = [(one, f"{place}.{name}".lstrip(".")) for one in _models(field.annotation)]
            waiting += [(one, where) for one, where in inner if one not in {known for known, _ in waiting}]
    return found


def _models(annotation: Any) -> Iterator[Any]:
    """The configuration models in a type."""
    if isinstance(annotation, type) and issubclass(annotation, Settings):
        yield annotation
    for inner in get_args(annotation):
        yield from _models(inner)


def _keys(model: type[Settings], places: dict[type[Settings], str]) -> str:
    """The section of one configuration model: where it stands, what it inherits, and a table of its own keys."""
    stands = f"`{places[model]}`" if places[model] else "The whole file"
    if model.__module__.endswith(".distributions"):
        stands = "A number that may be a distribution"
    if kind := _kind(model):
        stands += f", `kind: {kind}`"
    bases = [base for base in model.__bases__ if base in places]
    inherited = "".join(f" Also all keys of {_link(base)}." for base in bases)
    of_bases = {name: field for base in bases for name, field in base.model_fields.items()}
    rows = []
    for name, field in model.model_fields.items():
        if (name == "kind" and kind) or repr(of_bases.get(name)) == repr(field):
            continue
        unit = next((unit for ending, unit in UNITS.items() if name.endswith(ending)), "")
        allowed = ", ".join(dict.fromkeys(filter(None, _allowed(field.annotation, field.metadata))))
        meaning = " ".join((field.description or of_bases.get(name, field).description or "").split())
        cells = (
            f"`{name}`",
            _type(field.annotation, field.metadata),
            unit,
            _default(field.get_default(call_default_factory=True)),
            allowed,
        )
        rows.append(f"| {' | '.join((*cells, meaning))} |\n")
    head = "| key | type | unit | default | allowed | meaning |\n| --- | --- | --- | --- | --- | --- |\n"
    text = " ".join((inspect.getdoc(model) or "").split())
    return f"## Keys of {model.__name__}\n\n{stands}. {text}{inherited}\n" + (
        f"\n{head}{''.join(rows)}" if rows else ""
    )


def _kind(model: type[Settings]) -> str:
    """The one kind that a model is of, if it is one of several that the key `kind` tells apart."""
    choices = get_args(model.model_fields["kind"].annotation) if "kind" in model.model_fields else ()
    return str(choices[0]) if len(choices) == 1 else ""


def _link(model: type[Settings]) -> str:
    shown = f"`{_kind(model)}`" if _kind(model) else model.__name__
    return f"[{shown}](#keys-of-{model.__name__.lower()})"


def _type(kind: Any, metadata: list[Any] | tuple[Any, ...] = ()) -> str:
    """A type in the words of a YAML file."""
    origin, inner = get_origin(kind), get_args(kind)
    if getattr(kind, "__name__", "") in ("float", "int", "str", "bool"):
        return {"float": "number", "int": "whole number", "str": "text", "bool": "true or false"}[kind.__name__]
    if origin is Annotated:
        return _type(inner[0], inner[1:])
    if origin is Literal:
        return "one of" if len(inner) > 1 else "constant"
    if origin is tuple:
        return f"list: {_type(inner[0])}" if inner[-1] is ... else f"list of {len(inner)}: {_type(inner[0])}"
    if origin is dict:
        return f"mapping of {_type(inner[0])} to {_type(inner[1])}"
    if origin in (Union, UnionType):
        if any(getattr(rule, "custom_error_type", "") == "distribution" for rule in metadata):
            return "number or distribution"
        return " or ".join(dict.fromkeys(_type(one) for one in inner))
    if kind is type(None):
        return "null"
    return _link(kind)


def _allowed(kind: Any, metadata: list[Any] | tuple[Any, ...] = ()) -> Iterator[str]:
    """What values a key may have, in the order of the annotation: choices, bounds, lengths, patterns, validators."""
    inner = get_args(kind)
    if get_origin(kind) is Annotated:
        yield from _allowed(inner[0], inner[1:])
    elif get_origin(kind) is Literal:
        yield ", ".join(f"`{one}`" for one in inner)
    elif not any(getattr(rule, "custom_error_type", "") == "distribution" for rule in metadata):
        for one in inner:
            yield from _allowed(one)
    for rule in metadata:
        if isinstance(rule, FieldInfo):
            yield from _allowed(None, rule.metadata)
        elif isinstance(rule, AfterValidator):
            given = inspect.getclosurevars(rule.func).nonlocals
            if "low" in given:
                yield f"{'>' if given['open_low'] else '≥'} {_number(given['low'])}" if given["low"] > -np.inf else ""
                yield f"≤ {_number(given['high'])}" if given["high"] < np.inf else ""
            else:
                yield CHECKED[rule.func.__name__]
        else:
            for name, text in (("ge", "≥"), ("gt", ">"), ("le", "≤"), ("lt", "<")):
                if (bound := getattr(rule, name, None)) is not None:
                    yield f"{text} {_number(bound)}"
            if (fewest := getattr(rule, "min_length", None)) is not None:
                yield f"length ≥ {fewest}"
            if (most := getattr(rule, "max_length", None)) is not None:
                yield f"length ≤ {most}"
            if (pattern := getattr(rule, "pattern", None)) is not None:
                yield f"matches `{pattern}`"


def _number(bound: float) -> str:
    """A bound, large powers of two as such."""
    power = int(bound).bit_length() - 1 if bound >= 2**15 else 0
    return f"2^{power}" if power and bound == 2**power else f"{bound:g}"


def _default(value: Any) -> str:
    """A default as YAML writes it."""

    def plain(value: Any) -> Any:
        if isinstance(value, Settings):
            fields = type(value).model_fields
            given = ((name, getattr(value, name)) for name in fields)
            return {k: plain(v) for k, v in given if k == "kind" or v != fields[k].get_default()}
        return [plain(one) for one in value] if isinstance(value, tuple) else value

    if repr(value) == "PydanticUndefined":
        return "required"
    if plain(value) == {}:
        return "its defaults"
    written = yaml.safe_dump(plain(value), default_flow_style=True, width=10_000, allow_unicode=True)
    return f"`{written.removesuffix(chr(10)).removesuffix('...').strip()}`"


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
