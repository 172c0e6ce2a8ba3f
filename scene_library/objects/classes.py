"""The table of classes: name → builder, and groups of names to draw from."""

from __future__ import annotations

from collections.abc import Callable, Iterable

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


def _named(*builders: Builder) -> dict[str, Builder]:
    return {getattr(builder, "__name__", ""): builder for builder in builders}


_FURNITURE = _named(
    furniture.chair,
    furniture.stool,
    furniture.armchair,
    furniture.sofa,
    furniture.table,
    furniture.round_table,
    furniture.desk,
    furniture.bed,
    furniture.shelf,
    furniture.cabinet,
    furniture.wardrobe,
    furniture.coat_stand,
    furniture.floor_lamp,
    furniture.pendant_lamp,
    furniture.monitor,
    furniture.whiteboard,
    furniture.beanbag,
)
_HOUSEHOLD = _named(
    household.plant,
    household.tree,
    household.waste_bin,
    household.wheelie_bin,
    household.vase,
    household.bottle,
    household.suitcase,
    household.carton,
    household.ladder,
    household.traffic_cone,
    household.barrel,
    household.fire_extinguisher,
    household.tyre,
    household.bicycle,
    household.stairs,
    household.radiator,
)
_FIGURES = _named(figures.mannequin, figures.child, figures.seated_person, figures.dog)
_SHAPES = _named(
    shapes.sphere,
    shapes.egg,
    shapes.cube,
    shapes.pyramid,
    shapes.cone,
    shapes.column,
    shapes.ring,
    shapes.disc,
    shapes.panel,
    shapes.star,
    shapes.arrow,
    shapes.cross,
    shapes.frame,
    shapes.resolution_bars,
)
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
