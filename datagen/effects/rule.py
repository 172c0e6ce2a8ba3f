"""The rule by which effects are left out: together they may change the result by no more than the tolerance."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any, Generic, Literal, TypeVar

Kind = Literal["bound", "trial", "always", "forced", "absent"]
Given = TypeVar("Given")
Reduced = TypeVar("Reduced")


@dataclass(frozen=True)
class Change:
    """The change of the result if an effect is left out.

    value : an upper estimate of the relative L2 change of the stage's result; None if there is no such estimate.
    kind : `bound` if the value is proven; `trial` if it was measured with few samples, and includes their error.
    reason : one short sentence.
    """

    value: float | None
    kind: Literal["bound", "trial"]
    reason: str


@dataclass(frozen=True)
class Effect(Generic[Given, Reduced]):
    """One row of the table of effects. `Given` is what its decision rests on, `Transport` or `Detection`; `Reduced`
    is what it is left out of, `Transport` or `Detector`.

    name : key of the effect in the configuration's section `effects`.
    title : name of the effect for people.
    present : whether there is anything to simulate.
    without : what is simulated without the effect.
    change : the change if it is left out; None for an effect that `auto` always simulates.
    saves : about the largest share of its stage's time that leaving it out can save; 0 if it saves none.
    always : what is simulated with the effect switched on by the setting, the second argument.
    """

    name: str
    title: str
    present: Callable[[Given], bool]
    without: Callable[[Reduced], Reduced]
    change: Callable[[Given], Change] | None = None
    saves: float = 0.0
    always: Callable[[Reduced, str], Reduced] = lambda given, setting: given


@dataclass(frozen=True)
class Decision:
    """The decision on one effect, and its reason.

    Attributes
    ----------
    setting : setting of the configuration: auto, on or off.
    simulated : whether the effect is simulated.
    estimate : `Change.value`; None also if the change was not estimated.
    kind : that of `Change`; or `always` if leaving it out saves nothing, `forced` if the setting decides, `absent` if
        there is nothing to simulate.
    allowance : the part of the tolerance that earlier decisions had left for this one.
    """

    effect: str
    setting: str
    simulated: bool
    estimate: float | None
    kind: Kind
    allowance: float
    reason: str

    @property
    def left_out(self) -> bool:
        """Whether the effect is present but not simulated."""
        return not self.simulated and self.kind != "absent"


def decide(
    rows: Iterable[Effect[Given, Any]], given: Given, setting_of: Callable[[str], str], tolerance: float
) -> tuple[Decision, ...]:
    """The decisions on the effects of one stage, in the order of the table.

    Effects that save most time are decided first. An effect is left out if all effects left out so far change the
    result together by no more than `tolerance`: (1 + e₁)(1 + e₂) … − 1 ≤ tolerance, as one effect may act on what
    another has changed.
    """
    rows = list(rows)
    decisions: dict[str, Decision] = {}
    left_out = 0.0
    for row in sorted(rows, key=lambda r: -r.saves):
        allowance = max((1.0 + tolerance) / (1.0 + left_out) - 1.0, 0.0)
        decision = _decision(row, given, setting_of(row.name), allowance)
        if decision.left_out and decision.estimate is not None:
            left_out = (1.0 + left_out) * (1.0 + decision.estimate) - 1.0
        decisions[row.name] = decision
    return tuple(decisions[row.name] for row in rows)


def _decision(row: Effect[Given, Any], given: Given, setting: str, allowance: float) -> Decision:
    """The decision on one effect, which may change the result by `allowance`."""
    if not row.present(given):
        return Decision(row.name, setting, False, 0.0, "absent", allowance, "there is none")
    if setting != "auto":
        return Decision(row.name, setting, setting != "off", None, "forced", allowance, f"switched: {setting}")
    if row.change is None:
        return Decision(row.name, setting, True, None, "always", allowance, "leaving it out saves nothing")
    change = row.change(given)
    simulated = change.value is None or change.value > allowance
    return Decision(row.name, setting, simulated, change.value, change.kind, allowance, change.reason)
