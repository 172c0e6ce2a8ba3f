"""Test the switchboard's promise on many random scenes, and count what is left out of them.

    python tests/benchmarks/promise_table.py --scenes 36

takes some seconds of one core for each scene, and prints the numbers of `docs/physics.md`. Ends with status 1 if a
scene differs by more than the tolerance, after naming it.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "effects"))

from promise import Outcome, run_case
from promise_cases import nearly_everything_skipped, nearly_nothing_skipped, random_case

from datagen.effects import EFFECTS


def effects_table(outcomes: Sequence[Outcome]) -> str:
    """Markdown: how often each effect that is decided was there, and how often it was left out."""
    lines = ["| effect | there | left out | |", "|---|---:|---:|---:|"]
    for row in EFFECTS:
        states = [outcome.states[row.name] for outcome in outcomes]
        there, gone = len(states) - states.count("absent"), states.count("off")
        if row.saves > 0:
            lines.append(f"| {row.title} | {there} | {gone} | {f'{gone / there:.0%}' if there else ''} |")
    return "\n".join(lines)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenes", type=int, default=40)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--samples", type=int, default=256)
    arguments = parser.parse_args()
    ends = [nearly_everything_skipped(arguments.samples), nearly_nothing_skipped(arguments.samples)]
    tolerance = ends[0].effects.tolerance
    outcomes = [run_case(config) for config in ends]
    outcomes += [run_case(random_case(index, arguments.seed, arguments.samples)) for index in range(arguments.scenes)]
    largest = [max(getattr(of, f"{what}_error") for of in outcomes) for what in ("transient", "histogram")]
    print("largest difference of transients {:.2g}, of histograms {:.2g}\n".format(*largest))
    print(effects_table(outcomes[len(ends) :]))
    broken = [problem for outcome in outcomes for problem in outcome.broken(tolerance)]
    print("\n".join(broken), end="\n" if broken else "")
    return 1 if broken else 0


if __name__ == "__main__":
    sys.exit(main())
