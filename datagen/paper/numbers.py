"""All numbers of a reproduction as plain values for JSON."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

import numpy as np
from numpy.typing import NDArray

from datagen.paper.measures import PEAKS_NS, SECONDS
from datagen.paper.runs import Runs, Simulation
from datagen.paper.statements import Statement
from datagen.store.environment import processor
from datagen.store.files import finite

MADE_BY = "datagen reproduce"


def numbers(runs: Runs, statements: Sequence[Statement], command: str) -> dict[str, Any]:
    """Statements, levels, seconds and curves; what is not a number becomes null."""
    cases = {f"{kind}, {rays}, {scheme}": _case(case) for (kind, rays, scheme), case in runs.cases.items()}
    cases |= {f"as printed in metres, {rays}, all": _case(case) for rays, case in runs.in_metres.items()}
    cases |= {
        f"as printed, {runs.sparse}, all, {grid}, α₁ over {conserved}": _case(case)
        for (grid, conserved), case in runs.choices.items()
    }
    found = {
        "made_by": MADE_BY,
        "command": command,
        "processor": processor(),
        "config": runs.config.model_dump(mode="json"),
        "sizes": asdict(runs.sizes),
        "published": {"peaks_ns": PEAKS_NS, "seconds": {f"{r}, {s}": text for (r, s), text in SECONDS.items()}},
        "statements": [asdict(statement) for statement in statements],
        "cases": cases,
        "levels_as_printed_by_rays": {str(rays): asdict(level) for rays, level in runs.sweep.items()},
        "levels_radiometric_by_rays": {str(rays): asdict(level) for rays, level in runs.radiometric_levels.items()},
        "levels_radiometric_lengths_times_1_and_1000": [asdict(level) for level in runs.rescaled],
        "converged_relative_standard_error": runs.case("converged").relative_error,
        "time_ns": _six_digits(runs.time_ns),
    }
    return dict(finite(found))


def _case(case: Simulation) -> dict[str, Any]:
    curves = {**case.curves.parts, "secondary": case.secondary}
    return {
        "level": dict(case.level),
        "seconds": case.seconds,
        "processor_s": case.processor_s,
        "curves": {name: _six_digits(curve) for name, curve in curves.items()},
    }


def _six_digits(curve: NDArray[np.float64]) -> list[float]:
    return [float(f"{number:.6g}") for number in curve]
