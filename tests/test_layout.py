"""The layout is the physics: imports run down the list of `ROOMS`, and no two files import each other."""

from __future__ import annotations

import ast
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
ROOMS = """
cli
bench scoring
paper formats suites
report building
pipeline baselines
design loader
effects evidence reconstruction devices
scene capture labels transport detector store
config
records
seeding units exit_status untrusted scene_library
errors locks _version compiled
"""
"""What stands on one line never imports its neighbours, and only what stands below."""


def imported(source: str, modules: set[str]) -> set[str]:
    """Every import of the two packages, in functions and for type checkers too."""
    names = set()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            package = f"{node.module}" if node.level == 0 else "relative"
            below = {f"{package}.{alias.name}" for alias in node.names}
            names |= below & modules or {package}
    return {name for name in names if name.split(".")[0] in ("datagen", "scene_library", "relative")}


def room(module: str) -> str:
    return module.removeprefix("datagen.").split(".")[0]


def faults(sources: dict[str, str], lines: list[list[str]]) -> list[str]:
    """What breaks the rule among modules, given by name and source."""
    depth = {name: number for number, names in enumerate(lines) for name in names}
    graph = {name: imported(source, set(sources)) for name, source in sources.items()}
    found = []
    for name, below in graph.items():
        for other in sorted(below):
            if room(name) != room(other) and depth.get(room(name), len(lines)) >= depth.get(room(other), -1):
                found.append(f"{name} imports {other}, which is no line below it")
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        found.append("a circle: " + " ← ".join(error.args[1]))
    return found


def test_imports_run_downward_and_never_in_a_circle() -> None:
    files = [path for top in ("datagen", "scene_library") for path in (ROOT / top).rglob("*.py")]
    sources = {}
    for path in files:
        parts = path.relative_to(ROOT).with_suffix("").parts
        sources[".".join(parts).removesuffix(".__init__")] = path.read_text(encoding="utf-8")
    # The public face names everything, and may be imported by `python -m datagen` alone.
    del sources["datagen"], sources["datagen.__main__"]
    lines = [line.split() for line in ROOMS.split("\n") if line]
    assert faults(sources, lines) == []
    assert {room(name) for name in sources} == set(ROOMS.split()), "rooms that are not in the list"


def test_scripts_and_tests_stand_apart() -> None:
    """What somebody starts by hand is in `tests/benchmarks/` (it prints a table) or `tests/tools/`, no test is."""
    tests = ROOT / "tests"
    sources = {path.relative_to(tests): path.read_text(encoding="utf-8") for path in tests.rglob("*.py")}
    by_hand = {str(path) for path, text in sources.items() if f"python tests/{path}" in text}
    apart = {str(path) for path in sources if path.parts[0] in ("benchmarks", "tools")}
    assert len(by_hand) > 15 and by_hand <= apart
    assert not [path for path in apart if Path(path).name.startswith("test_")]


def test_contributing_shows_the_same_list() -> None:
    shown = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8").replace(" · ", " ")
    assert ROOMS.strip().replace("\n", "\n" + " " * 4) in shown
