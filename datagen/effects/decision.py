"""One rule for all effects: what may be left out together without changing the answer by more than the tolerance."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Generic, Literal, TypeVar

Stage = Literal["transport", "detector"]
Kind = Literal["bound", "pilot", "forced", "absent"]
World = TypeVar("World")


@dataclass(frozen=True)
class Estimate:
    """How much leaving an effect out can change the answer.

    Attributes
    ----------
    value : relative change (L2) of the stage's answer; None where nothing bounds it.
    kind : `bound`: proven; `pilot`: measured with few samples, their error included.
    reason : one short sentence.
    allowed : False where another condition than the tolerance forbids to leave it out; `reason` names it.
    """

    value: float | None
    kind: Literal["bound", "pilot"]
    reason: str
    allowed: bool = True


@dataclass(frozen=True)
class Effect(Generic[World]):
    """One row of the table.

    Attributes
    ----------
    name : its key in the configuration's section `effects`.
    title : its name for people.
    needs : what must be there for it to act, in words; `present` asks whether it is.
    reference : where its physics and its estimate are from.
    saves : about the largest share of its stage's time that leaving it out can save: what decides who is asked first.
    present : whether there is anything to simulate.
    estimate : (world, names of the effects left out already) → how much leaving it out can change.
    without : the world with the effect not simulated.
    always : the world with the effect simulated even where that can change nothing; given the setting.
    cheapest : the world with the effect simulated as is cheapest there, the answer being the same.
    """

    name: str
    title: str
    stage: Stage
    needs: str
    reference: str
    saves: float
    present: Callable[[World], bool]
    estimate: Callable[[World, frozenset[str]], Estimate]
    without: Callable[[World], World]
    always: Callable[[World, str | int], World] = lambda world, setting: world
    cheapest: Callable[[World], World] = lambda world: world


@dataclass(frozen=True)
class Decision:
    """What was decided for one effect, and why.

    Attributes
    ----------
    setting : what the configuration says: auto, on, off (or a number of strongest paths).
    simulated : whether it is; an effect that is absent is not.
    estimate : how much leaving it out can change, relative L2; None where nobody asked, or nothing bounds it.
    kind : `bound` or `pilot`: where the estimate is from; `forced` by the setting; `absent`: nothing to simulate.
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
    rows: Iterable[Effect[World]], world: World, setting_of: Callable[[str], str | int], tolerance: float
) -> tuple[Decision, ...]:
    """Decide for the effects of one stage, in the order of the table.

    Those that save most are asked first; each is left out while what is left out changes the answer, together, by no
    more than `tolerance`: (1 + e₁)(1 + e₂) … − 1 ≤ tolerance, as one effect may act upon what another has changed.
    """
    rows = list(rows)
    made: dict[str, Decision] = {}
    spent = 0.0
    for row in sorted(rows, key=lambda r: -r.saves):
        setting = setting_of(row.name)
        gone = frozenset(name for name, decision in made.items() if not decision.simulated)
        allowance = max((1.0 + tolerance) / (1.0 + spent) - 1.0, 0.0)
        decision = _decided(row, world, setting, gone, allowance)
        if decision.left_out and decision.estimate is not None:
            spent = (1.0 + spent) * (1.0 + decision.estimate) - 1.0
        made[row.name] = decision
    return tuple(made[row.name] for row in rows)


def _decided(
    row: Effect[World], world: World, setting: str | int, gone: frozenset[str], allowance: float
) -> Decision:
    simulated = True
    value: float | None = None
    kind: Kind = "forced"
    if not row.present(world):
        simulated, value, kind, reason = False, 0.0, "absent", f"there is none: it needs {row.needs}"
    elif setting == "off":
        simulated, reason = False, "switched off"
    elif setting != "auto":
        reason = "switched on" if setting == "on" else f"switched on: {setting}"
    else:
        found = row.estimate(world, gone)
        simulated = not (found.allowed and found.value is not None and found.value <= allowance)
        value, kind, reason = found.value, found.kind, found.reason
    return Decision(row.name, row.stage, setting, simulated, value, kind, allowance, reason)
