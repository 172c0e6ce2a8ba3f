"""What README and docs name exists: files, links, commands with options, make targets, names of datagen, tests."""

from __future__ import annotations

import ast
import importlib
import os
import re
import runpy
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any, get_args

import click
import numpy as np
import pytest
import yaml
from datasets import write_dataset

import datagen
from datagen.cli import cli
from datagen.config import DatasetConfig
from datagen.config.device import device_names
from datagen.config.scene_brdfs import BrdfSettings
from datagen.config.scene_layouts import AnyLayout
from datagen.records import Sample
from datagen.store import schema_of

pytestmark = pytest.mark.usefixtures("builds_here")

ROOT = Path(__file__).resolve().parents[1]
PAGES = [
    ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").glob("*.md")),
    *sorted((ROOT / ".github").glob("**/*.md")),
]  # fmt: skip
TEXTS = {page: page.read_text(encoding="utf-8") for page in PAGES}
FOLDERS = (ROOT, ROOT / "datagen", ROOT / "docs")
"""Where a path on a page may start, beside the page's own folder."""
FORBIDDEN = {"utils.py"}
"""Named only to say that there is no such file."""


def commands(text: str) -> list[str]:
    """Commands on a page: indented or fenced lines, and inline code, that begin with one of ours."""
    lines = re.findall(r"^ {4}(\S.*)$", text, re.MULTILINE)
    spans = re.findall(r"`([^`\n]+)`", re.sub(r"```.*?```", "", text, flags=re.DOTALL))
    return [re.sub(r"\s+#.*", "", piece) for piece in lines + spans]


def slug(heading: str) -> str:
    """The anchor that GitHub gives a heading."""
    return re.sub(r"[^\w\- ]", "", heading.strip().lower()).replace(" ", "-")


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_links_resolve(page: Path) -> None:
    for target in re.findall(r"\]\(([^)\s]+)\)", TEXTS[page]):
        if target.startswith("http"):
            continue
        name, _, anchor = target.partition("#")
        found = (page.parent / name).resolve() if name else page
        assert found.exists(), target
        if anchor:
            headings = re.findall(r"^#+ (.+)$", found.read_text(encoding="utf-8"), re.MULTILINE)
            assert anchor in map(slug, headings), target


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_files_and_folders_named_exist(page: Path) -> None:
    named = re.findall(
        r"(?<![\w/.])((?:[\w.]+/)*[\w.-]+\.(?:py|md|cff|toml)|(?:[\w.]+/)+[\w-]+\.(?:yaml|json|txt))", TEXTS[page]
    )
    folders = re.findall(r"`((?:\w+/)+)`", TEXTS[page])
    given = {name for name in named + folders if not name.startswith("out/")} - FORBIDDEN
    assert not {name for name in given if not _exists(name, page)}


def _exists(name: str, page: Path) -> bool:
    if "/" not in name and any(any((ROOT / top).rglob(name)) for top in ("datagen", "scene_library", "tests")):
        return True
    return any((folder / name).exists() for folder in (*FOLDERS, page.parent))


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_names_of_datagen_exist(page: Path) -> None:
    for name in set(re.findall(r"\bdg\.(\w+)", TEXTS[page])):
        assert hasattr(datagen, name), f"dg.{name}"
    for dotted in set(re.findall(r"(?<![\w/.-])datagen((?:\.[a-zA-Z_]\w*)+)", TEXTS[page])):
        thing, module = datagen, "datagen"
        for part in dotted[1:].split("."):
            module += f".{part}"
            thing = getattr(thing, part, None) or importlib.import_module(module)
    tests = set(re.findall(r"\btest_\w+(?![\w/.])", TEXTS[page]))
    known = "\n".join(path.read_text(encoding="utf-8") for path in ROOT.glob("tests/**/test_*.py") if tests)
    assert not {name for name in tests if f"def {name}(" not in known}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_commands_and_options_exist(page: Path) -> None:
    targets = re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE)
    for command in commands(TEXTS[page]):
        words = command.removeprefix("python -m ").split()
        if words[0] == "make" and len(words) > 1:
            assert words[1] in targets, command
        if words[0] != "datagen" or len(words) == 1:
            continue
        found: click.Command | None = cli
        while isinstance(found, click.Group) and (words := words[1:]) and not words[0].startswith("--"):
            found = found.get_command(click.Context(found), words[0])
            assert found is not None, command
        known = [
            option
            for parameter in getattr(found, "params", [])
            for option in (*parameter.opts, *parameter.secondary_opts)
        ]
        assert {word for word in words if word.startswith("--")} <= {*known, "--help", "--version"}, command


@pytest.mark.parametrize("name", ["configuration_keys", "materials"])
def test_generated_pages_are_current(name: str) -> None:
    page = runpy.run_path(str(ROOT / f"docs/make_{name}.py"))["page"]()
    assert page == TEXTS[ROOT / f"docs/{name}.md"], "the sources have changed since: make generated"


def kinds(union: object) -> set[str]:
    """Kinds among which a key of the configuration chooses."""
    models = get_args(get_args(union)[0])
    return {model.model_fields["kind"].default for model in models if model.is_offered}


@pytest.mark.parametrize(
    ("page", "names"),
    [("configuration", kinds(AnyLayout) | kinds(BrdfSettings)), ("devices", set(device_names()))],
)
def test_a_page_names_all_that_can_be_chosen(page: str, names: set[str]) -> None:
    assert {name for name in names if f"`{name}`" not in TEXTS[ROOT / f"docs/{page}.md"]} == set()


def test_contributing_names_what_its_files_have() -> None:
    """In the table of what is new, each class or table in capitals is in one of the row's files."""
    section = TEXTS[ROOT / "CONTRIBUTING.md"].split("## Something new")[1].split("\n## ")[0]
    rows = re.findall(r"^\| .* \|$", section, re.MULTILINE)
    assert len(rows) > 8
    for row in rows:
        names = re.findall(r"`([\w./]+)`", row)
        files = [folder / name for name in names for folder in FOLDERS if (folder / name).is_file()]
        files += [path for name in names for path in (ROOT / "datagen").glob(f"**/{name}") if "/" not in name]
        text = "\n".join(path.read_text(encoding="utf-8") for path in files)
        capital = [name for name in names if re.fullmatch(r"[A-Z]\w+", name)]
        assert [name for name in capital if not re.search(rf"\b{name}\b", text)] == [], row


def undocumented(tree: ast.Module | ast.ClassDef, where: str) -> Iterator[str]:
    """Public functions, classes, methods and properties without a docstring, and modules."""
    if isinstance(tree, ast.Module) and ast.get_docstring(tree) is None:
        yield where
    for node in tree.body:
        if not isinstance(node, ast.FunctionDef | ast.ClassDef) or node.name.startswith("_"):
            continue
        if ast.get_docstring(node) is None:
            yield f"{where}:{node.lineno} {node.name}"
        if isinstance(node, ast.ClassDef):
            yield from undocumented(node, where)


def test_public_names_have_docstrings() -> None:
    trees = {path: ast.parse(path.read_text(encoding="utf-8")) for path in (ROOT / "datagen").rglob("*.py")}
    assert not [name for path, tree in trees.items() for name in undocumented(tree, str(path.relative_to(ROOT)))]


def test_physics_page_simulates(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(ROOT)
    example = re.findall(r"^```python\n(.*?)^```", TEXTS[ROOT / "docs/physics.md"], re.DOTALL | re.MULTILINE)[0]
    names: dict[str, object] = {}
    exec(compile(example.replace("target=0.02", "target=0.2"), "docs/physics.md", "exec"), names)
    assert getattr(names["counts"], "shape", None) == (256, 1, 512)


@pytest.fixture(scope="module")
def quickstart(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with configs/quickstart.yaml, but for its accuracy, and a dataset of its shape that took no light."""
    folder = tmp_path_factory.mktemp("datasets")
    text = (ROOT / "configs/quickstart.yaml").read_text(encoding="utf-8")
    (folder / "configs").mkdir()
    (folder / "configs/quickstart.yaml").write_text(text.replace("target: 0.02", "target: 0.3"), encoding="utf-8")
    rng = np.random.default_rng(0)

    def made_up(config: DatasetConfig, index: int) -> Sample:
        fields = schema_of(config).fields
        arrays = {field.name: rng.poisson(0.05, field.shape).astype(field.dtype) for field in fields}
        arrays["hidden_view"], arrays["relay_wall"] = (np.diag([2.0, 1, 1])[[2, 0, 1]] for _ in range(2))
        return Sample(index, arrays, {"transient.relative_error": 0.02, "index": index}, {})

    config = datagen.load_config(folder / "configs/quickstart.yaml").with_scenes(20)
    write_dataset(config, folder / "out/quickstart.zarr", made_up)
    return folder


def test_datasets_page_runs_on_its_own_dataset(quickstart: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its examples one after the other, as in a notebook."""
    monkeypatch.chdir(quickstart)
    page = ROOT / "docs/datasets.md"
    examples = re.findall(r"^```python\n(.*?)^```", TEXTS[page], re.DOTALL | re.MULTILINE)
    assert len(examples) >= 6
    names: dict[str, Any] = {}
    for number, example in enumerate(examples):
        exec(compile(example, f"docs/datasets.md, example {number}", "exec"), names)
    path, last = names["path"], names["batch"]["scene"]
    stored = datagen.collate([datagen.TransientDataset(path)[int(scene)] for scene in last])
    assert names["histograms"].equal(stored["histogram"]) and names["rooms"].histogram.shape == (20, 256, 1, 512)
    assert names["crop"].shape("histogram") == (64, 1, 256) and names["few"].shape("histogram") == (3, 1, 512)
    assert names["volumes"].shape("volume") == (32, 32, 32) and names["item"]["depth"].any()
    assert len(names["errors"]) == len(names["train"]) and callable(names["predict"])


def test_versions_agree() -> None:
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    assert {"cff-version", "message", "title", "authors", "version", "date-released"} <= set(citation)
    assert citation["version"] == datagen.__version__
    assert citation["references"][0]["doi"] == "10.3390/s24206522"
    heading = f"## [{datagen.__version__}] - {citation['date-released']}"
    assert heading in (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")


def test_each_section_of_figures_names_the_version_that_was_measured() -> None:
    """One that is released, or the next."""
    released = re.findall(
        r"^## \[(\d+\.\d+\.\d+)\]", (ROOT / "CHANGELOG.md").read_text(encoding="utf-8"), re.MULTILINE
    )
    major, minor = (int(number) for number in released[0].split(".")[:2])
    known = {*released, f"{major}.{minor + 1}.0"}
    _, *sections = re.split(r"^## ", (ROOT / "docs/figures.md").read_text(encoding="utf-8"), flags=re.MULTILINE)
    assert len(sections) > 8
    for section in sections:
        heading, _, text = section.partition("\n")
        versions = re.findall(r"[Mm]easured with (\d+\.\d+\.\d+)", text)
        assert versions or heading == "Hard cases", f"{heading}: measured with which version?"
        assert set(versions) <= known, heading


IMPORTED = """
import runpy, sys
from pathlib import Path
tests, *scripts = map(Path, sys.argv[1:])
path = sys.path[1:]
for script in scripts:
    sys.path[:], sys.argv = [str(script.parent), *path], [str(script)]
    for name, module in list(sys.modules.items()):
        if str(getattr(module, "__file__", None) or "").startswith(f"{tests}/"):
            del sys.modules[name]
    try:
        runpy.run_path(str(script), run_name="imported")
    except ImportError as error:
        sys.exit(f"{script}: {error}")
"""
"""Imports scripts one after the other, each with nothing on the path but its own folder."""


def test_scripts_find_what_they_import() -> None:
    """As `python tests/…/script.py` does, where pytest puts no folder of tests on the path."""
    sources = {path: path.read_text(encoding="utf-8") for path in sorted((ROOT / "tests").rglob("*.py"))}
    scripts = [path for path, text in sources.items() if "\nif __name__ ==" in text]
    assert len(scripts) > 15
    command = [sys.executable, "-c", IMPORTED, str(ROOT / "tests"), *map(str, scripts)]
    done = subprocess.run(command, capture_output=True, text=True, check=False, env=os.environ | {"PYTHONPATH": ""})
    assert done.returncode == 0, done.stderr
