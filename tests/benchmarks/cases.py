"""Cases of a benchmark: kept in a file so that it can be stopped and continued, and counted with an interval."""

from __future__ import annotations

import json
from collections.abc import Callable, Hashable, Iterable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from scipy import stats

T = TypeVar("T")
Key = TypeVar("Key", bound=Hashable)


def continued(
    file: Path,
    kind: type[T],
    key: Callable[[T], Key],
    measure: Callable[[list[Key]], list[T]],
    jobs: Iterable[Sequence[Key]],
) -> list[T]:
    """All cases of a benchmark: those in a JSON file, and those that are missing there, which are measured.

    kind : the record of a case. key : identity of a case. jobs : keys that are measured together; `measure` gets
    those of a job that are missing. Each job's cases are written at once, so that a benchmark can be stopped and
    continued.
    """
    file.parent.mkdir(parents=True, exist_ok=True)
    stored: list[dict[str, Any]] = json.loads(file.read_text()) if file.exists() else []
    # Files of older versions have more fields.
    found = [kind(**{name: one[name] for name in kind.__dataclass_fields__}) for one in stored]  # type: ignore[attr-defined]
    done = {key(one) for one in found}
    for keys in jobs:
        missing = [one for one in keys if one not in done]
        if missing:
            found += measure(missing)
            content: list[dict[str, Any]] = [asdict(one) for one in found]  # type: ignore[call-overload]
            file.write_text(json.dumps(content, indent=1))
    return found


KEPT = ("within", "exact 95 % interval", "true / asked: median", "95th", "worst")
"""Headings of the cells of `promises_kept`."""


def promises_kept(shares: Sequence[float], within: Sequence[bool]) -> list[str]:
    """Cells of a table: the share of cases whose error is within the one asked for, with Clopper and Pearson's
    interval; median, 95th percentile and maximum of the true error over the one asked for."""
    interval = stats.binomtest(sum(within), len(within)).proportion_ci(0.95, "exact")
    spread = np.median(shares), np.quantile(shares, 0.95), np.max(shares)
    kept = f"{sum(within) / len(within):.1%}", f"{interval.low:.1%} … {interval.high:.1%}"
    return [*kept, *(f"{x:.2f}" for x in spread)]
