"""The accuracy of a transient: the error that is aimed at, or a number of paths."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeVar

from datagen.errors import InputError
from datagen.records.checks import check_flag, check_integer, check_number

T = TypeVar("T")

MAX_BOUNCES = 64
LIMITS = {"samples": (1, 2**31), "max_bounces": (1, MAX_BOUNCES)}
"""Count → smallest and largest value."""
TARGETS = (1e-4, 1.0)
"""Smallest and largest relative L2 error that a target may be."""
TARGET = 0.02
"""The target where neither a target nor a number of paths is given."""
PARTS_PER_TARGET = 2.5
"""Default of `part_target` in units of `target`: an object's light as accurate as the whole transient would cost
several times as much."""


@dataclass(frozen=True)
class Accuracy:
    """How accurately the light is simulated: to a `target`, or with so many `samples`.

    Attributes
    ----------
    target : relative L2 error of the whole transient that is aimed at, ‖error‖ / ‖truth‖ over all laser points,
        pixels and bins, 0.0001 … 1. The effort follows from a pilot run; `Transient.relative_error` is the error that
        is then claimed: an estimate, no bound. 0.02 if `samples` are not given either.
    samples : plain paths of each order for each pair of laser point and pixel, ≥ 1, instead of a target.
    max_bounces : highest number of bounces, 3 (the primary) … 64, or 1 and 2 with `direct`; None: paths go on until
        Russian roulette ends them, which leaves no light out on average.
    direct : also compute the direct return (1 and 2 bounces: the laser point, or a surface it lights, inside the
        FoV), which a gated measurement keeps out.
    secondary : whether light of four bounces is part of the transient, where `max_bounces` is 4 or more.
    part_target : with a target: relative L2 error of each object's own primary (parts of role `object`) that is aimed
        at, 0.0001 … 1; left out: 2.5 times the target, at most 1.
    faint_part : with a target: objects whose light, over all histograms together, is fewer photons per emitted photon
        than this need not meet `part_target`; ≥ 0.

    Raises
    ------
    InputError : a value outside of its range; a target beside samples.

    Examples
    --------
    >>> import datagen as dg
    >>> dg.Accuracy(target=0.05, max_bounces=4).each_part
    0.125
    >>> dg.Accuracy(samples=4096).target is None
    True
    """

    target: float | None = None
    samples: int | None = None
    max_bounces: int | None = 3
    direct: bool = False
    secondary: bool = True
    part_target: float | None = None
    faint_part: float = 0.0

    @property
    def each_part(self) -> float:
        """Relative L2 error of each object's own light that is aimed at, where a target is set."""
        assert self.target is not None
        return min(PARTS_PER_TARGET * self.target, 1.0) if self.part_target is None else self.part_target

    def __post_init__(self) -> None:
        for name, (low, high) in LIMITS.items():
            if getattr(self, name) is not None:
                check_integer("Accuracy", name, getattr(self, name), low, high)
        check_flag("Accuracy.direct", self.direct)
        check_flag(
            "Accuracy.secondary", self.secondary,
            remedy="the k strongest paths of the paper are datagen.paper.secondary(…, strongest=k)",
        )  # fmt: skip
        if self.max_bounces is not None and self.max_bounces < 3 and not self.direct:
            raise InputError(
                f"Accuracy.max_bounces = {self.max_bounces}: light of one and two bounces is direct light; set "
                "direct=True, or take 3 or more"
            )
        check_number("Accuracy", "faint_part", self.faint_part, 0.0, 1e30, "photons")
        for name in ("target", "part_target"):
            if getattr(self, name) is not None:
                check_number("Accuracy", name, getattr(self, name), *TARGETS, "a relative L2 error; 2 % is 0.02")
        if self.target is not None and self.samples is not None:
            raise InputError(
                f"Accuracy.samples = {self.samples!r}: given together with Accuracy.target = {self.target!r}; leave "
                "out one of them: a target decides the effort, samples fix it"
            )
        if self.samples is None and self.target is None:
            object.__setattr__(self, "target", TARGET)
        if self.part_target is not None and self.target is None:
            raise InputError(f"Accuracy.part_target = {self.part_target!r}: needs a target; set target, not samples")
