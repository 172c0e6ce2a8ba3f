"""The table beside other renderers, at a tiny size; what it rests on is held against known answers."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from benchmarks import peer_cases, peers
from benchmarks.peers import seconds_at

from datagen.exit_status import guarded


def test_peers(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr(peers, "CASES", {"plate": lambda: peer_cases.bare_plate(2, 200)})
    monkeypatch.setattr(peer_cases, "missing_for_mitransient", lambda: "not asked for")
    assert guarded(peers.main, [str(tmp_path), "--repeats", "1"]) == 0
    printed = capsys.readouterr().out
    rows = [line.split("|")[1:-1] for line in printed.splitlines() if line.startswith("| ")]
    errors = [float(row[3].split()[0]) for row in rows[2:]]
    assert errors[0] > errors[3] and errors[4] > errors[6] and errors[7] > errors[10]
    assert (tmp_path / "peers.md").read_text() in printed
    assert (tmp_path / "peers_plate.png").read_bytes()[:4] == b"\x89PNG"


def test_errors_of_a_case() -> None:
    """A total 10 % off, an object 30 % off, late light 20 % off."""
    truth = np.ones((2, 3, 8))
    result = truth * np.array([1.0, 1.3])[:, None, None]
    result[0, :, 4:] = 1.2
    case = peer_cases.Case("", 1, 0.1, (), late=4)
    assert list(case.errors(result, truth).values()) == pytest.approx([0.1, 0.3, 0.2])


def test_seconds_to_an_error_follow_the_measured_line() -> None:
    rows = [(1.0, 0.08), (4.0, 0.04), (16.0, 0.02)]
    assert seconds_at(rows, 0.1) == (1.0, True)
    assert seconds_at(rows, 0.04 / math.sqrt(2)) == (pytest.approx(8.0), True)
    assert seconds_at(rows, 0.01) == (pytest.approx(64.0), False)
    # A contender that takes an error is judged by its run to that error.
    runs = [peers.Run(seconds, {"": error}) for seconds, error in ((1.0, 0.01), (3.0, 0.004))]
    contender = peer_cases.Contender("", "", lambda n, seed: np.zeros(1), (10, 50), np.zeros(1), takes_error=True)
    assert peers.seconds_to_target(contender, runs, 0.02) == (3.0, True)


def test_a_case_that_does_not_exist_is_bad_input(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert guarded(peers.main, [str(tmp_path / "out"), "--only", "nothing"]) == 2
    err = capsys.readouterr().err
    assert "--only nothing" in err and err.count("\n") == 1 and not (tmp_path / "out").exists()
