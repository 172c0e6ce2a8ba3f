"""What a laser point's counts take over from the point before: nothing in this model, where all histograms are drawn
independently. The bound below says how much is left out."""

from __future__ import annotations

from datagen.detector.spad import Exposure, Spad
from datagen.errors import InputError

MOST_CARRIED = 1e-2
"""Largest share of a histogram's counts that may be left out: counting noise is 3 % or more of a histogram."""


def share_carried_over(spad: Spad, exposure: Exposure) -> float:
    """A bound of the share of counts that the end of the exposure before may add or remove: its last dead time, and
    afterpulses of its last release times, over the exposure. 0 for a detector that is armed afresh at each pulse, or
    counts everything."""
    if spad.mode != "free_running":
        return 0.0
    released = sum(spad.afterpulse_times_s) if spad.afterpulse_probability > 0 else 0.0
    return (spad.dead_time_s + released) / (exposure.cycles * exposure.period_s)


def check_carry_over(spad: Spad, exposure: Exposure) -> None:
    """Raise `InputError` if exposures are so short that what one leaves to the next one matters."""
    share = share_carried_over(spad, exposure)
    if share > MOST_CARRIED:
        dwell_s = exposure.cycles * exposure.period_s
        raise InputError(
            f"detector.cycles = {exposure.cycles}: in a sequence exposures of {1e6 * dwell_s:.4g} µs follow one "
            f"another, and dead time and afterpulses of each could change {share:.2g} of the next one's counts. This "
            f"is not modelled, and at most {MOST_CARRIED:g} is left out; take {share / MOST_CARRIED:.3g} × the "
            "cycles, or mode synchronous or ideal"
        )
