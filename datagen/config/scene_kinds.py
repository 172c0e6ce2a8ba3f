"""Settings that come in kinds: pick the member of a union by its key `kind`, and say which kinds there are.

A union of kinds has one more member that accepts nothing, to which everything unknown is sent, because a
discriminator itself cannot tell the value it refused::

    Content = Annotated[
        Annotated[Pillar, Tag(tag("pillar"))]
        | Annotated[Box, Tag(tag("box"))]
        | Annotated[Box, *unknown_kind("pillar", "box")],
        kind_of("pillar", "box"),
    ]
"""

from __future__ import annotations

import difflib
from typing import Any

from pydantic import BeforeValidator, Discriminator, Tag, WithJsonSchema

from datagen.config.base import tag

_UNKNOWN = "unknown kind"


def _kind(value: Any) -> Any:
    return value.get("kind") if isinstance(value, dict) else getattr(value, "kind", None)


def kind_of(*kinds: str, default: str | None = None) -> Discriminator:
    """A discriminator on the key `kind`; a mapping without it is of the kind `default`, if there is one."""

    def member(value: Any) -> str:
        kind = _kind(value)
        if kind is None and default is not None and isinstance(value, dict):
            kind = default
        return tag(kind if kind in kinds else _UNKNOWN)

    return Discriminator(member)


def unknown_kind(*kinds: str) -> tuple[BeforeValidator, WithJsonSchema, Tag]:
    """The annotations of the member that refuses: it names the kind found, the nearest known one, and all."""
    listed = ", ".join(kinds)

    def refuse(value: Any) -> Any:
        kind = _kind(value)
        if not isinstance(value, dict):
            raise ValueError(f"a mapping with the key kind is needed (kind: one of {listed})")
        if kind is None:
            raise ValueError(f"the key kind is missing; it must be one of {listed}")
        near = difflib.get_close_matches(str(kind), kinds, n=1)
        hint = f"did you mean {near[0]!r}? " if near else ""
        raise ValueError(f"kind = {kind!r} is unknown; {hint}It must be one of {listed}")

    return BeforeValidator(refuse), WithJsonSchema({"not": {}}), Tag(tag(_UNKNOWN))
