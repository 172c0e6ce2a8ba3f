"""Prints the hard cases that docs/figures.md names: `python tests/stability/hard_case_table.py`.

Every case is measured anew; the tests hold the same numbers against their limits.
"""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from hard_case_cells import CELLS
from hard_case_counts import COUNTS
from hard_case_light import LIGHT

HEAD = "| case | naively | here | truth |\n|---|---|---|---|"


def main() -> None:
    print(HEAD, flush=True)
    for case in (*LIGHT, *CELLS, *COUNTS):
        print(case().row(), flush=True)


if __name__ == "__main__":
    main()
