"""Files of materials by name, each with the keys that a surface of a configuration has: what captures tell of
surfaces becomes a part of scenes."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from datagen.config.base import from_plain
from datagen.config.scene_materials import SurfaceMaterial
from datagen.config.yaml_text import read_yaml
from datagen.devices.yaml_files import check_yaml_path, write_yaml
from datagen.errors import InputError
from datagen.records import Lambertian, Material, MeasuredByAngle
from datagen.records.checks import check_kind, check_path

_NAME = "name a file of materials, .yaml, as `write_materials` writes it"
WAVELENGTH_NM = 940.0
"""Wavelength at which named materials of the catalogue are taken in a file: that of sensors of zones."""


def write_materials(materials: Mapping[str, Material], path: str | Path) -> None:
    """Write materials by name (`Comparison.materials`) to a file, .yaml: under each name `albedo` and `brdf`, as a
    configuration has them under `scene.materials` and for each object.

    Raises `InputError` for materials other than Lambertian and MeasuredByAngle, and where it cannot be written.
    """
    check_kind("materials", materials, Mapping, remedy="such as compare(…).materials")
    check_materials_file(path)
    values = dict[str, Any]()
    for name, material in materials.items():
        if isinstance(material, MeasuredByAngle):
            table = [float(f"{value:.4g}") for value in material.reflectance]
            brdf: dict[str, Any] = {"kind": "measured_by_angle", "reflectance": table}
        elif isinstance(material, Lambertian):
            brdf = {"kind": "lambertian"}
        else:
            raise InputError(f"materials: {name}: {type(material).__name__}; give Lambertian or MeasuredByAngle")
        values[name] = {"albedo": float(f"{material.albedo:.4g}"), "brdf": brdf}
    write_yaml(values, path)


def check_materials_file(path: str | Path) -> None:
    """Raise `InputError` unless a path ends as a file of materials does, before the work that leads to it."""
    check_yaml_path(path, "a file of materials", _NAME)


def read_materials(path: str | Path) -> dict[str, Material]:
    """Name → material of a file that `write_materials` or you wrote: any `brdf` of a configuration, with numbers
    (distributions are drawn once).

    Raises `InputError` for a file that is missing or damaged, with the key that is wrong.
    """
    check_path("path", path, _NAME)
    values = read_yaml(Path(path), _NAME)
    surfaces = {
        str(name): from_plain(SurfaceMaterial, of, f"{path}: {name}", Path(path).parent)
        for name, of in values.items()
    }
    rng = np.random.default_rng(0)
    return {name: surface.draw_material(WAVELENGTH_NM, rng)[0] for name, surface in surfaces.items()}
