"""Writing files of plain values in YAML, such as those of devices and materials."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from datagen.errors import InputError
from datagen.records.checks import check_path
from datagen.store.files import write_atomically


def check_yaml_path(path: str | Path, what: str, remedy: str) -> None:
    """Raise `InputError` unless a path ends in .yaml or .yml. what : the file, as messages call it. remedy : what to
    give in place of what is no path."""
    check_path("path", path, remedy)
    if Path(path).suffix not in (".yaml", ".yml"):
        raise InputError(f"{path}: {what} ends in .yaml; name it so")


def write_yaml(values: dict[str, Any], path: str | Path) -> None:
    """Write values to a file, with the folders above it; raises `InputError` where that cannot be."""
    import yaml

    path = Path(path)
    text = yaml.safe_dump(values, sort_keys=False, allow_unicode=True, default_flow_style=None, width=118)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_atomically(path, text.encode())
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error})") from None
