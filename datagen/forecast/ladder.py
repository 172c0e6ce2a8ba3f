"""The ladder: one scene simulated with rising effort, and what its rungs say of full effort. Arithmetic only.

Neither seconds nor error of the transport are a straight line in effort. Field-of-view points are drawn for each
lookin until there are enough of them to share, visibility is proved rather than asked once there are enough
connections, histograms cost the same whatever falls into them: from a quarter of the lookins to all of them, twenty
scenes of seven ready configurations took 1.5 to 3.6 times as long. A straight line through 1/64 and 1/16 of the
lookins was up to 3.5 times too high. No model foresees that, so one scene is run with full effort wherever the budget
allows, and the others, run with less, are scaled by what it showed: seconds at full effort over those at a sixteenth
lay within 20 % of each other for scenes of one configuration. Only what is out of reach is extrapolated.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

CONVERGENCE = (0.3, 0.8)
"""Bounds of p in error ∝ effort⁻ᵖ: ½ for independent samples, more for quasi-random ones once they fill the scene."""
STEEPENING = 0.1
"""By how much p grows with each factor of 4 in effort: 0.0 … 0.2 in ten rooms, from 16 to 65 536 lookins."""


@dataclass(frozen=True)
class Pilot:
    """One scene, simulated and encoded once.

    Attributes
    ----------
    effort : share of the configured lookins (or of the paths that the configured target takes: effort ∝ target⁻²).
    seconds : stage → wall-clock seconds. processor_s : of all stages together.
    error : estimated relative L2 error of its transient.
    stored : field → bytes on disk, and "records" → its share of the commit record.
    """

    index: int
    effort: float
    seconds: Mapping[str, float]
    processor_s: float
    error: float
    stored: Mapping[str, int]

    @property
    def total_s(self) -> float:
        return sum(self.seconds.values())

    @property
    def transport_s(self) -> float:
        return self.seconds.get("transport", 0.0)


@dataclass(frozen=True)
class Ladder:
    """rungs : the same scene with rising effort, at least one."""

    rungs: tuple[Pilot, ...]

    @property
    def top(self) -> Pilot:
        return self.rungs[-1]

    def at(self, effort: float) -> Pilot:
        """The rung with exactly this effort."""
        return next(rung for rung in self.rungs if rung.effort == effort)

    def transport_s(self, effort: float) -> float:
        """Seconds of the transport with the effort of the top rung, or more.

        Beyond the top the geometric mean of the straight line through the two highest rungs, which is too high where
        something saturates, and of the power law, which is too low where much of the time does not grow.
        """
        growth, step = self._growth()
        power = (effort / self.top.effort) ** min(math.log(growth) / math.log(step), 1.0)
        return math.sqrt(self._line_s(effort) * self.top.transport_s * power)

    def _line_s(self, effort: float) -> float:
        growth, step = self._growth()
        slope = min((1.0 - 1.0 / growth) / (1.0 - 1.0 / step), 1.0)
        return self.top.transport_s * (1.0 + slope * (effort / self.top.effort - 1.0))

    def _growth(self) -> tuple[float, float]:
        """How many times the seconds, and how many times the effort, of the rung before the top has. Of one rung
        alone everything is taken to grow with effort."""
        low = self.rungs[-2] if len(self.rungs) > 1 else None
        if low is None or low.transport_s <= 0.0:
            return 2.0, 2.0
        return max(self.top.transport_s / low.transport_s, 1.0), self.top.effort / low.effort

    def scene_s(self, effort: float) -> float:
        """Seconds of all stages with this effort; only the transport's depend on it."""
        return self.top.total_s - self.top.transport_s + self.transport_s(effort)

    def most_s(self, effort: float) -> float:
        """Seconds of all stages by the straight line, so that what they cost is no surprise."""
        return self.top.total_s - self.top.transport_s + self._line_s(effort)

    def slower(self, effort: float) -> float:
        """Transport seconds at full effort over those at a rung's."""
        taken = self.at(effort).transport_s
        return self.transport_s(1.0) / taken if taken > 0 else 1.0

    def at_full(self, error: float, effort: float, targeted: bool) -> float:
        """The error at full effort of a scene that had `error` at a rung's effort.

        targeted : errors are what was asked for, ∝ effort^−½; else what is scaled is noise over signal.
        """
        if targeted:
            return float(error * effort**0.5)
        return _from_odds(_odds(error) * self._odds_left(effort))

    def _odds_left(self, effort: float) -> float:
        """Noise over signal at full effort over that at a rung's: as measured, then as effort^(−2p)."""
        if not self._tells(effort):
            return effort
        measured = _odds(self.top.error) / _odds(self.at(effort).error)
        return float(measured * self.top.effort ** (2 * self._convergence()))

    def _tells(self, effort: float) -> bool:
        return all(0 < pilot.error < 1 for pilot in (self.top, self.at(effort)))

    def _convergence(self) -> float:
        """p of error ∝ effort⁻ᵖ from the top on: what it was between the two highest rungs (½ where nothing tells),
        and its growth, averaged over the way."""
        if len(self.rungs) < 2 or not self._tells(self.rungs[-2].effort):
            return 0.5
        low, high = self.rungs[-2:]
        power = 0.5 * math.log(_odds(low.error) / _odds(high.error)) / math.log(high.effort / low.effort)
        power += STEEPENING * (1 - math.log(high.effort) / math.log(4)) / 2
        return min(max(power, CONVERGENCE[0]), CONVERGENCE[1])

    def larger(self, name: str, effort: float) -> float:
        """Bytes of a field at full effort over those at a rung's; beyond the top they grow with its logarithm."""
        size = self.at(effort).stored[name]
        full = float(self.top.stored[name])
        if self.top.effort < 1.0 and len(self.rungs) > 1:
            low, high = self.rungs[-2:]
            further = -math.log(high.effort) / math.log(high.effort / low.effort)
            full += max(0.0, (high.stored[name] - low.stored[name]) * further)
        return full / size if size > 0 else 1.0


def _odds(error: float) -> float:
    """Noise over signal, both squared norms: the norm that an estimated error is relative to holds the noise too."""
    return error**2 / max(1.0 - error**2, 1e-6)


def _from_odds(odds: float) -> float:
    return math.sqrt(odds / (1.0 + odds))
