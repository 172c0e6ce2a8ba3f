"""HDF5 through h5py, which is installed only where somebody exports to it."""

from __future__ import annotations

import importlib
import importlib.util
from typing import Any

from datagen.errors import InputError


def h5py() -> Any:
    """The package, or `InputError` with the way to get it."""
    if importlib.util.find_spec("h5py") is None:
        raise InputError("this format is HDF5, and h5py is not installed; pip install nlos-datagen[export]")
    return importlib.import_module("h5py")
