"""The rule by which effects are left out: together they may change the result by no more than the tolerance."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Generic, Literal, TypeVar

Stage = Literal["transport", "detector"]
Kind = Literal["bound", "trial", "always", "forced", "absent"]
Given = TypeVar("Given")


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
class Effect(Generic[Given]):
    """One row of the table of effects. `Given` is the input of its stage: `SceneFigures` or `Detection`.

    name : key of the effect in the configuration's section `effects`.
    title : name of the effect for people.
    needs : what makes the effect present, in words.
    reference : source of its physics, and of the estimate of its change.
    saves : about the largest share of its stage's time that leaving it out can save; 0 if it saves none.
    present : whether there is anything to simulate.
    change : the change if it is left out; or a sentence that says why it is always simulated under `auto`.
    without : the input of the stage without the effect.
    always : the input of the stage with the effect switched on by the setting, the second argument.
    """

    name: str
    title: str
    stage: Stage
    needs: str
    reference: str
    saves: float
    present: Callable[[Given], bool]
    change: Callable[[Given], Change] | str
    without: Callable[[Given], Given]
    always: Callable[[Given, str | int], Given] = lambda given, setting: given


@dataclass(frozen=True)
class Decision:
    """The decision on one effect, and its reason.

    Attributes
    ----------
    setting : setting of the configuration: auto, on, off (or a number of strongest paths).
    simulated : whether the effect is simulated.
    estimate : `Change.value`; None also if the change was not estimated.
    kind : that of `Change`; or `always` if leaving it out saves nothing, `forced` if the setting decides, `absent` if
        there is nothing to simulate.
    allowance : the part of the tolerance that earlier decisions had left for this one.
    """

    effect: str
    stage: Stage
    setting: str | int
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
    rows: Iterable[Effect[Given]], given: Given, setting_of: Callable[[str], str | int], tolerance: float
) -> tuple[Decision, ...]:
    """The decisions on the effects of one stage, in the order of the table.

    Effects that save most time are decided first. An effect is left out if all effects left out so far change the
    result together by no more than `tolerance`: (1 + e₁)(1 + e₂) … − 1 ≤ tolerance, as one effect may act on what
    another has changed.
    """
    rows = list(rows)
    decisions: dict[str, Decision] = {}
    spent = 0.0
    for row in sorted(rows, key=lambda r: -r.saves):
        allowance = max((1.0 + tolerance) / (1.0 + spent) - 1.0, 0.0)
        decision = _decided(row, given, setting_of(row.name), allowance)
        if decision.left_out and decision.estimate is not None:
            spent = (1.0 + spent) * (1.0 + decision.estimate) - 1.0
        decisions[row.name] = decision
    return tuple(decisions[row.name] for row in rows)


def _decided(row: Effect[Given], given: Given, setting: str | int, allowance: float) -> Decision:
    """The decision on one effect, which may change the result by `allowance`."""
    simulated = True
    value: float | None = None
    kind: Kind = "forced"
    if not row.present(given):
        simulated, value, kind, reason = False, 0.0, "absent", f"there is none: it needs {row.needs}"
    elif setting == "off":
        simulated, reason = False, "switched off"
    elif setting != "auto":
        reason = "switched on" if setting == "on" else f"switched on: {setting}"
    elif isinstance(row.change, str):
        kind, reason = "always", row.change
    else:
        change = row.change(given)
        simulated = not (change.value is not None and change.value <= allowance)
        value, kind, reason = change.value, change.kind, change.reason
    return Decision(row.name, row.stage, setting, simulated, value, kind, allowance, reason)
