"""The harm of docs/datasets.md: `python tests/benchmarks/harm_table.py [--kills 200] [--corruptions 500]`.

Exit status 1 where anything was lost, read wrong without a word, or ended in a traceback.
"""

from __future__ import annotations

import argparse
import os
import random
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "store"))
# As in the tests: read when numpy is loaded, which is later.
os.environ["OMP_NUM_THREADS"] = os.environ["OPENBLAS_NUM_THREADS"] = os.environ["MKL_NUM_THREADS"] = "1"

import harm
from kills import KILLED

HEAD = "| what | harmed | found before mending | lost | silent | tracebacks |\n|---|---|---|---|---|---|"


def rows(kills: int, corruptions: int, seed: int) -> Iterator[tuple[str, Callable[[Path], harm.Outcome]]]:
    """(name, function of an empty folder) of each row of the table."""
    each = kills // 8
    for mending, share in ((False, 2 * each), (True, kills - 6 * each)):
        named = "between two steps of " + ("mending a dataset" if mending else "a build")
        yield named, lambda folder, n=share, m=mending: harm.kills_between_steps(n, folder, m)
    for what in KILLED:
        rng = random.Random(f"{seed} {what}")
        yield f"{what} killed", lambda folder, w=what, r=rng: harm.kills_of_processes(w, each, folder, r)
    for number, kind in enumerate(harm.CORRUPTED):
        share = (corruptions + number) // len(harm.CORRUPTED)
        rng = random.Random(f"{seed} {kind}")
        yield f"{kind} corrupted", lambda folder, k=kind, n=share, r=rng: harm.corruptions(k, n, folder, r)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--kills", type=int, default=200)
    parser.add_argument("--corruptions", type=int, default=500)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", default="", help="only the rows whose name contains this")
    given = parser.parse_args()
    total = harm.Outcome()
    print(HEAD, flush=True)
    with harm.quietly():
        for what, done in rows(given.kills, given.corruptions, given.seed):
            if given.only not in what:
                continue
            with tempfile.TemporaryDirectory() as folder:
                outcome = done(Path(folder))
            total += outcome
            print(_row(what, outcome), flush=True)
    print(_row("all", total))
    return int(any(total[key] for key in ("lost", "silent", "traceback")))


def _row(what: str, outcome: harm.Outcome) -> str:
    return (
        f"| {what} | "
        + " | ".join(str(outcome[key]) for key in ("harmed", "found", "lost", "silent", "traceback"))
        + " |"
    )


if __name__ == "__main__":
    sys.exit(main())
