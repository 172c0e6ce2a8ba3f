"""Test the switchboard's promise on many random scenes, and measure the time that decisions save.

    python tests/effects/promise_table.py --scenes 40

takes about ten seconds of one core for each scene. Prints the tables of `docs/physics.md`. Ends with status 1 if a
scene differs by more than the tolerance, after naming it.
"""

from __future__ import annotations

import argparse
import statistics
import sys
from collections.abc import Sequence

from promise import Outcome, run_case
from promise_cases import nearly_everything_skipped, nearly_nothing_skipped, random_case

from datagen.effects import EFFECTS

STAGES = ("transport", "detector")


def savings_table(outcomes: Sequence[Outcome], tolerance: float) -> str:
    """Markdown: seconds as decided over seconds with everything on, and what it cost in error, by stage."""
    lines = [
        "| stage | seconds, as decided / everything on: median | mean | range | largest difference | tolerance |",
        "|---|---:|---:|---:|---:|---:|",
    ]
    for stage in STAGES:
        ratios = [ratio(outcome, stage) for outcome in outcomes if stage in outcome.seconds]
        errors = [o.transient_error if stage == "transport" else o.histogram_error for o in outcomes]
        lines.append(
            f"| {stage} | {statistics.median(ratios):.2f} | {statistics.mean(ratios):.2f} | "
            f"{min(ratios):.2f} … {max(ratios):.2f} | {max(errors):.2g} | {tolerance:g} |"
        )
    return "\n".join(lines)


def named_table(outcomes: Sequence[Outcome]) -> str:
    """Markdown: single scenes, the ends of the range."""
    lines = ["| scene | left out | simulated | transport | detector |", "|---|---:|---:|---:|---:|"]
    for outcome in outcomes:
        states = list(outcome.states.values())
        found = " | ".join(f"{ratio(outcome, stage):.2f}" if stage in outcome.seconds else "" for stage in STAGES)
        lines.append(f"| {outcome.name} | {states.count('off')} | {states.count('on')} | {found} |")
    return "\n".join(lines)


def effects_table(outcomes: Sequence[Outcome]) -> str:
    """Markdown: how often each effect that is decided was there, and how often it was left out."""
    lines = ["| effect | there | left out | |", "|---|---:|---:|---:|"]
    for row in EFFECTS:
        states = [outcome.states[row.name] for outcome in outcomes]
        there, gone = len(states) - states.count("absent"), states.count("off")
        if row.saves > 0:
            lines.append(f"| {row.title} | {there} | {gone} | {f'{gone / there:.0%}' if there else ''} |")
    return "\n".join(lines)


def ratio(outcome: Outcome, stage: str) -> float:
    decided, full = outcome.seconds[stage]
    return decided / full


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenes", type=int, default=40)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--lookins", type=int, default=2048)
    parser.add_argument(
        "--times", type=int, default=3, help="measurements of each transport; ten times so many of each detection"
    )
    arguments = parser.parse_args()
    ends = [nearly_everything_skipped(arguments.lookins), nearly_nothing_skipped(arguments.lookins)]
    tolerance = ends[0].effects.tolerance
    named = [run_case(config, arguments.times) for config in ends]
    outcomes = [
        run_case(random_case(index, arguments.seed, arguments.lookins), arguments.times)
        for index in range(arguments.scenes)
    ]
    print(savings_table(outcomes, tolerance), named_table(named), effects_table(outcomes), sep="\n\n")
    broken = [problem for outcome in named + outcomes for problem in outcome.broken(tolerance)]
    print("\n".join(broken), end="\n" if broken else "")
    return 1 if broken else 0


if __name__ == "__main__":
    sys.exit(main())
