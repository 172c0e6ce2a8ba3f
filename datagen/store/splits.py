"""The split of each scene: a held-out split that the configuration defines by what scenes show, or a fixed random
draw of train, val and test."""

from __future__ import annotations

from array import array
from collections.abc import Iterable, Mapping

import numpy as np

from datagen.config.splits import BY_SHARE, HeldOut, SplitsConfig
from datagen.records import Scalar
from datagen.records.arrays import Floats
from datagen.seeding import Purpose, seed_sequence

Parameters = Mapping[str, Scalar]
NOT_OF_THE_ROOM = (
    "attempts", "draws", "scene.", "capture.", "detector.", "exposure.", "effect.", "sampler.",
    "transient.", "transport.", "histogram.", "stats.", "evidence.",
)  # fmt: skip
"""Prefixes of parameters that do not describe the room: two scenes that differ in these alone show the same room."""
_BLOCK = 10
"""Ten rooms in a row have their random numbers in ten different tenths of 0 … 1, so that small datasets have all
splits, too."""


def splits_of(scenes: Iterable[Parameters | None], splits: SplitsConfig) -> list[str | None]:
    """The split of every scene, from its parameters; None for a scene without parameters, which could not be made."""
    dealing = Dealing(splits)
    for parameters in scenes:
        dealing.add(parameters)
    return dealing.splits()


class Dealing:
    """Deals scenes, one after the other, to the splits.

    The random draw of a room depends only on the index of the first scene that shows it. So no room is in two splits,
    and a room keeps its split when the dataset grows.
    """

    def __init__(self, splits: SplitsConfig) -> None:
        self._splits = splits
        # Hashes in place of the rooms, which take kilobytes each: of a million rooms, two have the same hash, and
        # then the same draw, once in 30 million datasets.
        self._rooms = array("q")
        self._held_out = list[str | None]()

    def add(self, parameters: Parameters | None) -> None:
        """Take in the next scene; None if it could not be made."""
        index = len(self._rooms)
        self._rooms.append(hash(_room(parameters) if parameters else index))
        if parameters is None:
            self._held_out.append(None)
        else:
            self._held_out.append(next((rule.name for rule in self._splits.held_out if _shows(parameters, rule)), ""))

    def splits(self) -> list[str | None]:
        """The split of every scene; None where it could not be made."""
        _, first, room = np.unique(np.array(self._rooms), return_index=True, return_inverse=True)
        share = _shares(len(self._rooms))[first[room]]
        ends = np.cumsum(self._splits.shares)[:-1] - 1e-9
        dealt = np.searchsorted(ends, share, side="right").tolist()
        return [
            None if shown is None else shown or BY_SHARE[number]
            for shown, number in zip(self._held_out, dealt, strict=True)
        ]


def _room(parameters: Parameters) -> tuple[tuple[str, Scalar], ...]:
    """The parameters that distinguish a room from others; all parameters if none describes a room."""
    own = tuple(item for item in parameters.items() if not item[0].startswith(NOT_OF_THE_ROOM))
    return tuple(sorted(own or parameters.items()))


def _shares(scenes: int) -> Floats:
    """(scenes,) random numbers in 0 … 1; of ten in a row one lies in each tenth. The first numbers do not depend on
    `scenes`, so a dataset that grows keeps them."""
    blocks = -(-scenes // _BLOCK)
    drawn = np.random.Philox(seed_sequence(0, 0, Purpose.LOADER, part=2)).random_raw(blocks * 2 * _BLOCK)
    keys, within = np.moveaxis(drawn.reshape(blocks, 2, _BLOCK), 1, 0)
    order = np.argsort(np.argsort(keys, axis=1), axis=1)
    return np.asarray((order + within / 2.0**64) / _BLOCK).ravel()[:scenes]


def _shows(parameters: Parameters, rule: HeldOut) -> bool:
    """Whether a scene fulfils all conditions of a rule."""
    where = (
        (rule.classes, _values(parameters, ".class")),
        (rule.layouts, {parameters.get("layout.kind"), parameters.get("layout.turn")}),
        (rule.materials, _values(parameters, ".material")),
        (rule.files, _values(parameters, ".file")),
    )
    if any(wanted and not found.intersection(wanted) for wanted, found in where):
        return False
    return not (rule.along or rule.across) or any(
        _within(parameters[name], rule.along) and _within(parameters.get(f"{name[:-6]}.across", -1.0), rule.across)
        for name in parameters
        if name.endswith(".along")
    )


def _values(parameters: Parameters, suffix: str) -> set[Scalar | None]:
    return {value for name, value in parameters.items() if name.endswith(suffix)}


def _within(value: Scalar, bounds: tuple[float, float] | None) -> bool:
    return bounds is None or (isinstance(value, float | int) and bounds[0] <= value <= bounds[1])
