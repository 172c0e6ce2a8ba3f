"""One rule for all effects: what may be left out together without changing the answer by more than the tolerance."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Generic, Literal, TypeVar

Stage = Literal["transport", "detector"]
Kind = Literal["bound", "trial", "always", "forced", "absent"]
Given = TypeVar("Given")


@dataclass(frozen=True)
class Change:
    """How much leaving an effect out can change the answer.

    Attributes
    ----------
    value : relative change (L2) of the stage's answer; None where nothing bounds it.
    kind : `bound`: proven; `trial`: measured with few samples, their error included.
    reason : one short sentence.
    """

    value: float | None
    kind: Literal["bound", "trial"]
    reason: str


@dataclass(frozen=True)
class Effect(Generic[Given]):
    """One row of the table. `Given` is what its stage works with: scene or detector, and the settings of both.

    Attributes
    ----------
    name : its key in the configuration's section `effects`.
    title : its name for people.
    needs : what must be there for it to act, in words; `present` asks whether it is.
    reference : where its physics is from, and how its change is known.
    saves : about the largest share of its stage's time that leaving it out can save; 0 where it saves none.
    present : whether there is anything to simulate.
    change : how much leaving it out can change the answer; or a sentence that says why it is never worth asking.
    without : what is given, with the effect not simulated.
    always : with the effect simulated even where that can change nothing; also given the setting.
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
    """What was decided for one effect, and why.

    Attributes
    ----------
    setting : what the configuration says: auto, on, off (or a number of strongest paths).
    estimate : `Change.value`; None where nobody asked, too.
    kind : of `Change`; or `always`: leaving it out saves nothing; `forced` by the setting; `absent`: there is none.
    allowance : what was left of the tolerance when it was this effect's turn.
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
        """Whether something that is there is not simulated."""
        return not self.simulated and self.kind != "absent"


def decide(
    rows: Iterable[Effect[Given]], given: Given, setting_of: Callable[[str], str | int], tolerance: float
) -> tuple[Decision, ...]:
    """Decide for the effects of one stage, in the order of the table.

    Those that save most are asked first; each is left out while what is left out changes the answer, together, by no
    more than `tolerance`: (1 + e₁)(1 + e₂) … − 1 ≤ tolerance, as one effect may act upon what another has changed.
    """
    rows = list(rows)
    made: dict[str, Decision] = {}
    spent = 0.0
    for row in sorted(rows, key=lambda r: -r.saves):
        allowance = max((1.0 + tolerance) / (1.0 + spent) - 1.0, 0.0)
        decision = _decided(row, given, setting_of(row.name), allowance)
        if decision.left_out and decision.estimate is not None:
            spent = (1.0 + spent) * (1.0 + decision.estimate) - 1.0
        made[row.name] = decision
    return tuple(made[row.name] for row in rows)


def _decided(row: Effect[Given], given: Given, setting: str | int, allowance: float) -> Decision:
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
        found = row.change(given)
        simulated = not (found.value is not None and found.value <= allowance)
        value, kind, reason = found.value, found.kind, found.reason
    return Decision(row.name, row.stage, setting, simulated, value, kind, allowance, reason)
