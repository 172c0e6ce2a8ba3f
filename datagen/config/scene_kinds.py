"""Settings that come in kinds: the member of a union is picked by its key `kind`, and what is no kind is refused."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, get_args

from pydantic import BaseModel, GetCoreSchemaHandler
from pydantic_core import CoreSchema, core_schema

from datagen.config.base import near_hint, tag, tag_of

_UNKNOWN = tag("unknown kind")


def kinds_of(union: Any) -> dict[str, type[BaseModel]]:
    """Kind → model of a union of models, each of which has its kind as the default of its key `kind`."""
    return {tag_of(model): model for model in get_args(union)}


@dataclass(frozen=True)
class ByKind:
    """Annotation of a union of models: `Annotated[Pillar | Box, ByKind()]`. `default` is the kind of a mapping
    without the key, or None where the key is required. `unlisted` kinds are not offered to who writes a file."""

    default: str | None = None
    unlisted: tuple[str, ...] = ()

    def __get_pydantic_core_schema__(self, union: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        """A union tagged by `kind`.

        Everything unknown is sent to one more member, which accepts nothing: a discriminator cannot tell the value
        that it refused.
        """
        models = kinds_of(union)
        kinds = [*models]

        def member(value: Any) -> str:
            kind = _kind(value)
            if kind is None and isinstance(value, dict):
                kind = self.default
            return tag(kind) if kind in kinds else _UNKNOWN

        def refuse(value: Any) -> Any:
            raise ValueError(_refusal(value, [kind for kind in kinds if kind not in self.unlisted]))

        choices = {tag(kind): handler.generate_schema(model) for kind, model in models.items()}
        refusing = core_schema.no_info_plain_validator_function(
            refuse, metadata={"pydantic_js_functions": [lambda *_: {"not": {}}]}
        )
        return core_schema.tagged_union_schema({**choices, _UNKNOWN: refusing}, discriminator=member)


def _kind(value: Any) -> Any:
    return value.get("kind") if isinstance(value, dict) else getattr(value, "kind", None)


def _refusal(value: Any, kinds: list[str]) -> str:
    """What is wrong with a value of no known kind: the kind found, the nearest known one, and all."""
    kind, listed = _kind(value), ", ".join(kinds)
    if not isinstance(value, dict):
        return f"a mapping with the key kind is needed (kind: one of {listed})"
    if kind is None:
        return f"the key kind is missing; it must be one of {listed}"
    return f"kind = {kind!r} is unknown; {near_hint(str(kind), kinds)}It must be one of {listed}"
