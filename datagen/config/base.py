"""What all configuration models share: they are frozen and strict, and an error is one line that names the key."""

from __future__ import annotations

import difflib
import json
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, ClassVar, Self, TypeVar

import pydantic
from pydantic import BaseModel, ConfigDict, SerializerFunctionWrapHandler, ValidationInfo, model_validator

from datagen.errors import InputError, shown

Model = TypeVar("Model", bound=BaseModel)


class Settings(BaseModel):
    """A frozen section of the configuration; unknown keys and values of another type are refused.

    Raises `InputError`, one line, where it is made of values that are not allowed.
    """

    model_config = ConfigDict(
        frozen=True, extra="forbid", strict=True, allow_inf_nan=False, use_attribute_docstrings=True,
        validate_default=True,
    )  # fmt: skip

    is_offered: ClassVar[bool] = True
    """Whether error messages list this kind among those to choose from; False for kinds that only datagen writes."""

    def __init__(self, /, **values: Any) -> None:
        try:
            super().__init__(**values)
        except pydantic.ValidationError as error:
            raise _input_error(type(self).__name__, error, type(self)) from None

    # As pydantic marks its own: a section inside another one is then made without it, and what is wrong there becomes
    # an error of the outer section, with the whole path of the key.
    __init__.__pydantic_base_init__ = True  # type: ignore[attr-defined]

    def _check(self) -> None:
        """Raise `ValueError` where keys contradict each other."""

    @model_validator(mode="after")
    def _checked(self) -> Self:
        self._check()
        return self

    def changed(self) -> list[str]:
        """The keys whose value is not the default.

        Keys that exclude each other are compared by this: a dataset's own configuration has every key, and must be
        readable again.
        """
        return [key for key, field in type(self).model_fields.items() if getattr(self, key) != field.default]

    def _only_one_of(self, key: str, *others: str) -> None:
        """Raise `ValueError` where a key is given together with one of the others."""
        changed = self.changed()
        for other in others:
            if key in changed and other in changed:
                raise ValueError(f"{key} and {other} are both given, and only one of them can hold; leave one out")


def without_unset(settings: Settings, plain: SerializerFunctionWrapHandler, *keys: str) -> dict[str, Any]:
    """The plain values of settings without those of `keys` that are None. Keys that datasets of format 1 lack are
    left out of their settings where they are not set, so that these settings, and the fingerprint, stay as they
    were."""
    values: dict[str, Any] = plain(settings)
    return {key: value for key, value in values.items() if key not in keys or value is not None}


def from_plain(model: type[Model], values: Any, source: str, base_directory: str | Path, **context: Any) -> Model:
    """The model of plain values, as YAML gives them; raises `InputError` that begins with `source`.

    base_directory : where relative paths start. context : further entries of the validation context.
    """
    try:
        # JSON mode: strict about types, yet a list may stand for a tuple.
        return model.model_validate_json(json.dumps(values), context={"base_directory": base_directory, **context})
    except pydantic.ValidationError as error:
        raise _input_error(source, error, model) from None
    except (TypeError, ValueError) as error:
        raise InputError(f"{source}: holds a value that is no text, number, list or mapping ({error})") from None


def folder_of(info: ValidationInfo) -> Path:
    """The configuration's folder (validation context), at which relative paths start."""
    return Path((info.context or {}).get("base_directory") or ".")


def is_stored(info: ValidationInfo) -> bool:
    """Whether the settings are those that a dataset stores. They may be anybody's, and have the values of the files
    that they were read from; mesh files alone they name by their paths."""
    return not (info.context or {}).get("look_for_files", True)


def named_file(info: ValidationInfo, path: str) -> Path:
    """The file that a setting names, whose values take the setting's place. Raises `ValueError` in stored settings:
    their paths may lead anywhere."""
    if is_stored(info):
        raise ValueError(f"{path!r}: a path, where a dataset has the values of the file; build the dataset anew")
    return folder_of(info) / path


def _input_error(source: str, error: pydantic.ValidationError, model: type[BaseModel]) -> InputError:
    """The first problem in `error`: source, key, value, what is allowed."""
    details = error.errors(include_url=False)
    # An unknown key is often the cause of a missing one, so it is named first.
    details.sort(key=lambda d: d["type"] != "extra_forbidden")
    more = f" (and {len(details) - 1} more)" if len(details) > 1 else ""
    return InputError(f"{source}: {_explain(details[0], model)}{more}")


def _explain(detail: Any, model: type[BaseModel]) -> str:
    problem, value, context, location = detail["type"], detail["input"], detail.get("ctx", {}), detail["loc"]
    # A key that no model has stands at the end of its own location.
    key, models = _place_of(location[:-1] if problem == "extra_forbidden" else location, model)
    kinds = [tag_of(one) for one in models if issubclass(one, Settings) and one.is_offered]
    match problem:
        case "extra_forbidden":
            known = sorted({name for one in models for name in one.model_fields})
            hint = near_hint(location[-1], known, cutoff=0.5) or f"known keys: {', '.join(known)}"
            return f"{key and f'{key}.'}{location[-1]}: unknown key; {hint}"
        case "missing":
            return f"{key}: missing; this key is required"
        case "union_tag_invalid":
            kind = context["tag"]
            hint = near_hint(kind, kinds, f"it must be one of {', '.join(kinds)}")
            return f"{key}: kind = {shown(kind)} is unknown; {hint}"
        case "value_error":
            return f"{key and f'{key}: '}{context['error']}"
        case "dict_type" | "model_type" | "model_attributes_type" | "union_tag_not_found":
            with_kind = f" with the key kind, one of {', '.join(kinds)}" if len(kinds) > 1 else ""
            message = f"a mapping is needed{with_kind}"
        case _:
            message = detail["msg"][:1].lower() + detail["msg"][1:]
    return f"{key} = {'a mapping' if isinstance(value, dict) else shown(value)}: {message}"


def near_hint(name: str, known: Iterable[str], then: str = "", cutoff: float = 0.6) -> str:
    """`did you mean '…'?` with the known name that is most alike, and `then` as a sentence after it; only `then`, as
    the rest of a sentence, where none is alike."""
    near = difflib.get_close_matches(name, [*known], n=1, cutoff=cutoff)
    return f"did you mean {near[0]!r}? {then[:1].upper()}{then[1:]}".rstrip() if near else then


def check_known(name: str, known: Iterable[str], what: str, groups: Iterable[str] = ()) -> None:
    """Raise `ValueError` for a name that is neither known nor a group of such names.

    what : what the name is not, such as "a material". The message has the name that is most alike; if there is none,
    all groups, or all that is known.
    """
    if name not in known and name not in groups:
        listed = f"there are {', '.join(groups or known)}"
        raise ValueError(f"{name!r} is not {what}; {near_hint(name, [*groups, *known], cutoff=0.4) or listed}")


def _place_of(location: Sequence[int | str], model: type[BaseModel]) -> tuple[str, list[type[BaseModel]]]:
    """The YAML path of a pydantic location, and the models that a mapping there may stand for.

    pydantic names the member of a union in its locations, too: no key of YAML, but it says which model is meant.
    """
    path, models = "", [model]
    for part in location:
        if isinstance(part, int):
            path += f"[{part}]"
            continue
        fields = [one.model_fields[part] for one in models if part in one.model_fields]
        if fields:
            path += f".{part}" if path else part
            models = [inner for field in fields for inner in _models_in(field.annotation)]
        else:
            models = [one for one in models if tag_of(one) == part] or models
    return path, models


def tag_of(model: type[BaseModel]) -> str:
    """What tells a model from the others of a union: the default of its key `kind`, or the name of its class."""
    kind = model.model_fields.get("kind")
    return model.__name__ if kind is None else str(kind.default)


def _models_in(annotation: Any) -> list[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [model for argument in getattr(annotation, "__args__", ()) for model in _models_in(argument)]
