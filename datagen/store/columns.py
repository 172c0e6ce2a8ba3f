"""The parameters of many scenes in little memory: of each name its values, in no order."""

from __future__ import annotations

from array import array
from collections import Counter
from collections.abc import Iterable, Mapping

import numpy as np

from datagen.records import Scalar
from datagen.records.arrays import Floats

FEW = 12
"""Up to so many different values are counted. Of more, numbers take 8 bytes each, and texts are not kept: nothing
that is said of a dataset lists more words."""


class Column:
    """The values of one parameter, of the scenes that have it.

    kinds : the types of the values.
    few : (type, value) → how many scenes have it; None if there are more than `FEW` different ones.
    """

    def __init__(self) -> None:
        self.kinds = set[type]()
        self.few: Counter[tuple[type, Scalar]] | None = Counter()
        self._many = array("d")

    def add(self, value: Scalar) -> None:
        """Take in the value of another scene."""
        kind = type(value)
        self.kinds.add(kind)
        if self.few is None:
            if not isinstance(value, str):
                self._many.append(value)
            return
        self.few[kind, value] += 1
        if len(self.few) > FEW:
            self._many, self.few = self._counted(self.few), None

    @property
    def is_text(self) -> bool:
        """Whether any value is a text."""
        return str in self.kinds

    @property
    def is_number(self) -> bool:
        """Whether all values are numbers; true and false are none."""
        return self.kinds <= {int, float}

    @property
    def words(self) -> Counter[str]:
        """Value, as text → how many scenes have it; empty for more than `FEW` different values."""
        words = Counter[str]()
        for (_, value), count in (self.few or {}).items():
            words[str(value)] += count
        return words

    @property
    def numbers(self) -> Floats:
        """(n,) the values as numbers. Raises `ValueError` if any is a text."""
        if self.is_text:
            raise ValueError("a text in place of a number")
        return np.array(self._many if self.few is None else self._counted(self.few))

    @staticmethod
    def _counted(few: Mapping[tuple[type, Scalar], int]) -> array[float]:
        """The numbers that are counted, one after the other."""
        numbers = array("d")
        for (_, value), count in few.items():
            if not isinstance(value, str):
                numbers.extend([float(value)] * count)
        return numbers


class Columns(dict[str, Column]):
    """Name → its column, in the order in which names come first; of `scenes`, the parameters of each."""

    def __init__(self, scenes: Iterable[Mapping[str, Scalar]] = ()) -> None:
        super().__init__()
        for parameters in scenes:
            self.add(parameters)

    def add(self, parameters: Mapping[str, Scalar]) -> None:
        """Take in another scene."""
        for name, value in parameters.items():
            column = self.get(name)
            if column is None:
                column = self[name] = Column()
            column.add(value)

    def numbers(self, name: str) -> Floats:
        """(n,) the numbers of a name; none if no scene has it. Raises `ValueError` if any value is a text."""
        return self[name].numbers if name in self else np.empty(0)
