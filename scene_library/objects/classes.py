"""The table of classes: name → builder, and groups of names to draw from.

Every public function of `furniture`, `household`, `figures` and `shapes` builds one class and gives it its name.
What a seed draws depends on their order: a new one goes to the end of its module.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from types import ModuleType

import numpy as np

from scene_library.objects import figures, furniture, household, shapes
from scene_library.objects.glyphs import GLYPHS, glyph
from scene_library.solids import Solid

Builder = Callable[[np.random.Generator], Solid]


def _glyph(character: str) -> Builder:
    def build_glyph(rng: np.random.Generator) -> Solid:
        height = rng.uniform(0.4, 1.0)
        width, stroke = rng.uniform(0.55, 0.8) * height, rng.uniform(0.12, 0.2) * height
        return glyph(character, width, height, stroke, rng.uniform(0.02, 0.08))

    return build_glyph


def _builders(module: ModuleType) -> dict[str, Builder]:
    """The public functions that a module defines, in the order in which they stand there."""
    return {
        name: value
        for name, value in vars(module).items()
        if not name.startswith("_") and getattr(value, "__module__", None) == module.__name__
    }


_FURNITURE, _HOUSEHOLD = _builders(furniture), _builders(household)
_FIGURES, _SHAPES = _builders(figures), _builders(shapes)
_LETTERS = {f"letter_{c}": _glyph(c) for c in GLYPHS if c.isalpha()}
_DIGITS = {f"digit_{c}": _glyph(c) for c in GLYPHS if c.isdigit()}

CLASSES: dict[str, Builder] = {**_FURNITURE, **_HOUSEHOLD, **_FIGURES, **_SHAPES, **_LETTERS, **_DIGITS}
"""Every class by name, in an order that never changes but at its end."""

GROUPS: dict[str, tuple[str, ...]] = {
    "furniture": tuple(_FURNITURE),
    "household": tuple(_HOUSEHOLD),
    "figures": tuple(_FIGURES),
    "shapes": tuple(_SHAPES),
    "letters": tuple(_LETTERS),
    "digits": tuple(_DIGITS),
}


def classes_of(names: Iterable[str]) -> tuple[str, ...]:
    """Class names for class and group names, each once. Raises `KeyError` with the first that is neither."""
    found: dict[str, None] = {}
    for name in names:
        if name in GROUPS:
            found.update(dict.fromkeys(GROUPS[name]))
        elif name in CLASSES:
            found[name] = None
        else:
            raise KeyError(name)
    return tuple(found)


def build(name: str, rng: np.random.Generator) -> Solid:
    """One object of a class, of natural size, with proportions drawn from `rng`."""
    return CLASSES[name](rng)
