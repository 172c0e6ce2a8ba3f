"""Examples run as their commands do."""

from __future__ import annotations

import runpy
import sys
from pathlib import Path
from typing import Any

import pytest
import torch

from datagen.config import DatasetConfig, config_from_mapping
from datagen.config.yaml_text import parse_yaml

QUICKSTART = Path(__file__).resolve().parents[1] / "configs/quickstart.yaml"


def small_quickstart() -> DatasetConfig:
    """The rooms of quickstart, quick to build: a quarter of the scan's points, and noisy light."""
    values = parse_yaml(QUICKSTART.read_text(encoding="utf-8"), "quickstart")
    values["capture"]["scan"] |= {"rows": 8, "columns": 8}
    values["transport"] = {"samples": 64}
    return config_from_mapping(values)


def run_example(script: Path, *arguments: object) -> dict[str, Any]:
    """The names of a script whose `main` was run with these arguments, as `python SCRIPT ARGUMENTS` does. The number
    of torch's threads is what it was."""
    threads = torch.get_num_threads()
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(script.parent))
        patch.setattr(sys, "argv", [str(script), *map(str, arguments)])
        try:
            made = runpy.run_path(str(script))
            made["main"]()
        finally:
            torch.set_num_threads(threads)
    return made
