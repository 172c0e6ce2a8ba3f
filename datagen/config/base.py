"""What all configuration models share: frozen, strict, and errors of one line that name the key."""

from __future__ import annotations

import difflib
from collections.abc import Iterable
from typing import TYPE_CHECKING, Any, cast

import pydantic
from pydantic import BaseModel, ConfigDict

from datagen.errors import InputError

if TYPE_CHECKING:
    from pydantic._internal._model_construction import ModelMetaclass
else:
    # Its own name is pydantic's affair.
    ModelMetaclass = type(BaseModel)


class _ToldInALine(ModelMetaclass):
    """Makes models: what is wrong with one made in Python is told as of one read from a file. A model within another
    is made by pydantic itself, and its errors belong to that one."""

    def __call__(cls, *values: Any, **named: Any) -> Any:
        """The model of these values; raises `InputError`, one line, for what is none."""
        if values:
            raise InputError(f"{cls.__name__}: takes keys by name, as in {cls.__name__}(key=value)")
        try:
            return super().__call__(**named)
        except pydantic.ValidationError as error:
            raise_input_error(cls.__name__, error, cast(type[BaseModel], cls))
            raise


class Settings(BaseModel, metaclass=_ToldInALine):
    """A frozen section of the configuration; unknown keys and values of another type are refused.

    Raises `InputError`, one line, where it is made of values that are not allowed.
    """

    model_config = ConfigDict(
        frozen=True, extra="forbid", strict=True, allow_inf_nan=False, use_attribute_docstrings=True,
        validate_default=True,
    )  # fmt: skip


def raise_input_error(source: str, error: pydantic.ValidationError, model: type[BaseModel]) -> None:
    """Raise `InputError` for the first problem in `error`: source, key, value, what is allowed."""
    details = error.errors(include_url=False)
    # An unknown key is often the cause of a missing one, so it is named first.
    details.sort(key=lambda d: d["type"] != "extra_forbidden")
    first = details[0]
    key = _dotted(first["loc"])
    more = f" (and {len(details) - 1} more)" if len(details) > 1 else ""
    raise InputError(f"{source}: {_explain(key, first, model)}{more}") from None


def _explain(key: str, detail: Any, model: type[BaseModel]) -> str:
    kind, value, context = detail["type"], detail["input"], detail.get("ctx", {})
    if kind == "extra_forbidden":
        parent, _, name = key.rpartition(".")
        known = _known_keys(model, detail["loc"][:-1])
        hint = near_hint(name, known, 0.5).rstrip() or f"known keys: {', '.join(sorted(known))}"
        return f"{key}: unknown key{f' in {parent!r}' if parent else ''}; {hint}"
    if kind == "missing":
        return f"{key}: missing; this key is required"
    if kind == "value_error" and "error" in context:
        return f"{key + ': ' if key else ''}{context['error']}"
    message = str(detail["msg"])
    shown = repr(value) if isinstance(value, (str, int, float, bool, type(None))) else f"a {_yaml_name(value)}"
    return f"{key} = {shown}: {message[:1].lower()}{message[1:]}"


def near_hint(name: str, known: Iterable[str], cutoff: float = 0.6) -> str:
    """`did you mean '…'? `, or nothing where none of the known names is like it."""
    near = difflib.get_close_matches(name, [*known], n=1, cutoff=cutoff)
    return f"did you mean {near[0]!r}? " if near else ""


def _yaml_name(value: object) -> str:
    return "mapping" if isinstance(value, dict) else "list" if isinstance(value, list) else type(value).__name__


def _dotted(loc: Iterable[int | str]) -> str:
    """The YAML path of a pydantic location: tags of unions are left out, list positions stay."""
    tags = {f"<{name}>" for name in TAGS}
    text = ""
    for part in loc:
        if isinstance(part, str) and (part in tags or part.startswith("function-")):
            continue
        text += f"[{part}]" if isinstance(part, int) else f".{part}" if text else str(part)
    return text


TAGS: set[str] = set()
"""Names of union members, registered by `tag`, which pydantic puts into locations although no YAML key has them."""


def tag(name: str) -> str:
    """A union tag that error messages leave out of the key's path."""
    TAGS.add(name)
    return f"<{name}>"


def _known_keys(model: type[BaseModel], loc: tuple[int | str, ...]) -> list[str]:
    """The keys allowed where `loc` points; a tag in `loc` picks the member of a union by its class name."""
    current: set[type[BaseModel]] = {model}
    for part in loc:
        if isinstance(part, int):
            continue
        if part.startswith("<"):
            current = {m for m in current if tag_of(m) == part.strip("<>")} or current
            continue
        current = {m for c in current if part in c.model_fields for m in _models_in(c.model_fields[part].annotation)}
    return sorted({f for m in current for f in m.model_fields})


def tag_of(model: type[BaseModel]) -> str:
    """The tag of a union member: the default of its `kind` field, or its class name in lower case."""
    kind = model.model_fields.get("kind")
    return str(kind.default) if kind is not None else model.__name__.lower()


def _models_in(annotation: Any) -> set[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return {annotation}
    return {m for argument in getattr(annotation, "__args__", ()) for m in _models_in(argument)}
