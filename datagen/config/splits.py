"""The section `splits`: scenes for training, validation and test, and scenes held out by what they show."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from datagen.config.base import Settings, check_known
from datagen.config.scene_contents import Name
from datagen.errors import InputError

BY_SHARE = ("train", "val", "test")
"""Splits that get scenes at random, each its share."""

Share = Annotated[float, Field(ge=0, le=1)]
Names = tuple[Annotated[str, Field(min_length=1)], ...]
Range = tuple[Share, Share] | None


class HeldOut(Settings):
    """A split with all scenes that meet every key given; no other split has them."""

    name: Name
    """The split's name."""
    classes: Names = ()
    """Classes of objects; an object of any of them is enough."""
    layouts: Names = ()
    """Kinds of layout, or `left` and `right` for the side to which it turns."""
    materials: Names = ()
    """Materials of the catalogue, on any surface."""
    files: Names = ()
    """Mesh files, as `path` names them; for a file of a folder, followed by the way from there."""
    along: Range = None
    """Range of an object's `along`: its place in the hidden part."""
    across: Range = None
    """Range of an object's `across`; with `along`, one object must lie in both ranges."""

    def _check(self) -> None:
        if self.name in BY_SHARE:
            raise ValueError(f"name = {self.name!r}: is dealt out by share; choose another name")
        if not (self.classes or self.layouts or self.materials or self.files or self.along or self.across):
            raise ValueError(f"{self.name}: says nothing; name classes, layouts, materials, files, along or across")
        for key, bounds in (("along", self.along), ("across", self.across)):
            if bounds is not None and bounds[0] > bounds[1]:
                raise ValueError(f"{key} = {list(bounds)}: the first must not exceed the second")


class SplitsConfig(Settings):
    """Which scenes are in which split. May be changed at any time: no sample depends on it."""

    train: Share = 0.8
    """Share of the scenes that are not held out."""
    val: Share = 0.1
    test: Share = 0.1
    held_out: Annotated[tuple[HeldOut, ...], Field(max_length=100)] = ()
    """Splits by what a scene shows; a scene belongs to the first split whose keys it meets."""

    def _check(self) -> None:
        if abs(sum(self.shares) - 1) > 1e-6:
            raise ValueError(f"train, val, test = {', '.join(map(str, self.shares))}: must add up to 1")
        names = [rule.name for rule in self.held_out]
        if len(set(names)) < len(names):
            raise ValueError(f"held_out: a split is named twice ({', '.join(names)})")

    def with_shares(self, shares: tuple[float, float, float]) -> SplitsConfig:
        """These splits with other shares of train, val and test. Raises `InputError` unless they add up to 1."""
        try:
            by_name = dict(zip(BY_SHARE, map(float, shares), strict=True))
            return type(self).model_validate(self.model_dump() | by_name)
        except (TypeError, ValueError):
            raise InputError(
                f"fractions = {shares}: must be three numbers ≥ 0 (train, val, test) that add up to 1"
            ) from None

    @property
    def shares(self) -> tuple[float, float, float]:
        """Shares of train, val and test."""
        return self.train, self.val, self.test

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all splits."""
        return (*BY_SHARE, *(rule.name for rule in self.held_out))

    def check_classes(self, known: tuple[str, ...]) -> None:
        """Raise `ValueError` for a class that no object can have."""
        for rule in self.held_out:
            for name in rule.classes:
                check_known(name, known, f"a class of scene.contents (splits.held_out {rule.name})")
