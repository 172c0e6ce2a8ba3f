"""Datasets of one hidden point, for exports and imports."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from datasets import write_dataset
from point_target import config_of, point_sample


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str, str], Path]:
    folder, there = tmp_path_factory.mktemp("datasets"), dict[tuple[str, str], Path]()

    def of(scan: str, origin: str = "wall") -> Path:
        key = scan, origin
        if key not in there:
            there[key] = write_dataset(config_of(scan, origin), folder / f"{scan}-{origin}.zarr", point_sample)
        return there[key]

    return of
