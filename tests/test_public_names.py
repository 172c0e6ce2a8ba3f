"""Every name that a reader of README, of a page or of a public signature meets can be imported from `datagen`."""

from __future__ import annotations

import ast
import builtins
import collections.abc
import inspect
import re
import runpy
import shutil
import subprocess
import sys
import typing
import zipfile
from collections.abc import Iterator
from functools import cached_property
from pathlib import Path

import pytest

import datagen

ROOT = Path(__file__).resolve().parents[1]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
PYTHON = [
    (page.name, number, text)
    for page in PAGES
    for number, text in enumerate(re.findall(r"^```python\n(.*?)^```", page.read_text(encoding="utf-8"), re.M | re.S))
]
ELSEWHERE = {*vars(builtins), *collections.abc.__all__, *typing.__all__, "NDArray", "ArrayLike", "DTypeLike", "Path"}
"""Names that a Python programmer finds without us: of the language, of numpy's typing, of pathlib."""
WRITTEN = runpy.run_path(str(ROOT / "docs/docstrings.py"))["spelled"]
"""An annotation as the page of the API has it."""


def annotations(thing: object) -> Iterator[tuple[str, object]]:
    """Every annotation of a public function, or of the fields, methods and properties of a public class."""
    if inspect.isclass(thing):
        own = {} if hasattr(thing, "model_fields") else vars(thing).get("__annotations__", {})
        yield from ((kind, thing) for name, kind in own.items() if not name.startswith("_"))
        for name, value in vars(thing).items():
            member = value.__func__ if isinstance(value, classmethod | staticmethod) else value
            member = member.func if isinstance(member, cached_property) else getattr(member, "fget", None) or member
            own_init = name == "__init__" and not hasattr(thing, "__dataclass_fields__")
            if inspect.isfunction(member) and (not name.startswith("_") or own_init):
                yield from annotations(member)
    elif inspect.isfunction(thing):
        yield from ((kind, thing) for kind in thing.__annotations__.values())


@pytest.mark.parametrize("name", [name for name in datagen.__all__ if not name.startswith("_")])
def test_types_of_public_signatures_are_public(name: str) -> None:
    for kind, thing in annotations(getattr(datagen, name)):
        assert isinstance(kind, str), f"{name}: {kind} is evaluated, others are as the source has them"
        if kind.startswith("ClassVar"):
            continue
        for word in re.findall(r"(?<![\w.'\"])[A-Za-z_]\w*\b(?!['\"])", WRITTEN(kind, thing.__module__)):
            assert word in ELSEWHERE or word in ("np", "torch", "trimesh") or hasattr(datagen, word), (name, kind)


@pytest.mark.parametrize(("page", "number", "text"), PYTHON, ids=lambda value: str(value)[:20])
def test_examples_use_names_that_exist(page: str, number: int, text: str) -> None:
    """README's examples are run by tests/cli/test_readme.py; of all pages' the names, and keywords, are looked up."""
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id == "dg":
            assert node.attr in datagen.__all__, f"dg.{node.attr}"
        if isinstance(node, ast.ImportFrom) and node.module == "datagen":
            assert {alias.name for alias in node.names} <= set(datagen.__all__)
        called = getattr(node, "func", None)
        if isinstance(node, ast.Call) and isinstance(called, ast.Attribute) and ast.unparse(called.value) == "dg":
            known = inspect.signature(getattr(datagen, called.attr)).parameters
            assert {keyword.arg for keyword in node.keywords} <= {*known}, ast.unparse(node)


def test_every_public_name_is_there() -> None:
    assert sorted(set(datagen.__all__)) == sorted(datagen.__all__) == dir(datagen)
    assert all(getattr(datagen, name) is not None for name in datagen.__all__)
    with pytest.raises(AttributeError, match="EpochSampler_"):
        datagen.EpochSampler_  # noqa: B018


def test_type_checkers_find_an_editable_install(tmp_path: Path) -> None:
    """They read the paths in .pth files and run no import hooks."""
    pytest.importorskip("setuptools", minversion="77", reason="setuptools is not installed, which builds the package")
    for name in ("pyproject.toml", "README.md", "LICENSE", "datagen/_version.py", "scene_library/__init__.py"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        shutil.copy(ROOT / name, tmp_path / name)
    command = "from setuptools.build_meta import build_editable; print(build_editable('.'))"
    done = subprocess.run([sys.executable, "-c", command], cwd=tmp_path, capture_output=True, text=True, check=True)
    with zipfile.ZipFile(tmp_path / done.stdout.split()[-1]) as wheel:
        (written,) = (name for name in wheel.namelist() if ".dist-info/" not in name)
        assert wheel.read(written).decode().strip() == str(tmp_path)
