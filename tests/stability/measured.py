"""A hard case as measured: the result of the obvious formula, ours, and the truth."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class HardCase:
    """`naive` and `ours` are numbers that the texts beside them explain; `ours` must not exceed `allowed`."""

    name: str
    naive_way: str
    naive: float
    our_way: str
    ours: float
    truth: str
    allowed: float

    def row(self) -> str:
        naive, ours = f"{self.naive_way}: **{self.naive:.2g}**", f"{self.our_way}: **{self.ours:.2g}**"
        return f"| {' | '.join((self.name, naive, ours, self.truth))} |"
