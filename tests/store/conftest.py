"""Datasets of `fake_samples`, made once for all tests of a process."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
from fake_samples import build_fakes, small_config


@pytest.fixture(scope="session")
def pristine(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The dataset of an uninterrupted build with one worker, of `small_config` unless a test names another. Tests
    must not change it."""
    root = tmp_path_factory.mktemp("pristine") / "set"
    result = build_fakes(getattr(request, "param", small_config)(), root)
    assert (result.built, result.kept, result.complete) == (3, 0, True)
    return root


@pytest.fixture
def dataset(pristine: Path, tmp_path: Path) -> Path:
    """A copy of that dataset, which a test may damage."""
    return shutil.copytree(pristine, tmp_path / "set")
