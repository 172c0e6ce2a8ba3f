"""A small part of the table of `benchmarks/harm_table.py`: builds are killed and files corrupted. Nothing may be
lost, read wrong without an error, or end in a traceback."""

from __future__ import annotations

import random
from collections.abc import Iterator
from pathlib import Path

import harm
import pytest


@pytest.fixture(autouse=True)
def quiet() -> Iterator[None]:
    with harm.quietly():
        yield


def check(outcome: harm.Outcome, harms: int) -> None:
    assert outcome["harmed"] >= harms
    assert not any(outcome[key] for key in ("lost", "silent", "traceback")), outcome


@pytest.mark.parametrize(
    ("mending", "number"),
    [(False, 7), (True, 2), *(pytest.param(mending, None, marks=pytest.mark.nightly) for mending in (False, True))],
)
def test_a_kill_between_any_two_steps_loses_nothing(tmp_path: Path, mending: bool, number: int | None) -> None:
    check(harm.kills_between_steps(number, tmp_path, mending), number or 50)


@pytest.mark.parametrize(
    ("mending", "number"),
    [(False, 3), *(pytest.param(mending, None, marks=pytest.mark.nightly) for mending in (False, True))],
)
def test_a_kill_of_a_build_of_sequences_loses_nothing(tmp_path: Path, mending: bool, number: int | None) -> None:
    check(harm.kills_between_steps(number, tmp_path, mending, harm.SHORT_SEQUENCES), number or 50)


@pytest.mark.parametrize(
    ("kind", "frames"),
    [("dataset.json", None), ("commit record", None), ("README.md", None), ("zarr.json", None),
     ("sharded field", None), ("sharded field", 3), ("small field", 3), ("coordinate", 3)],
)  # fmt: skip
def test_no_corruption_is_silent_or_lasts(tmp_path: Path, kind: str, frames: int | None) -> None:
    """Of scenes that are measured once, and of sequences (3 frames)."""
    check(harm.corruptions(kind, 1, tmp_path, random.Random(kind), frames), 1)
