"""Bad input: one line on standard error, exit status 2, no traceback, nothing left behind."""

from __future__ import annotations

import ast
import re
import sys
import warnings
from collections.abc import Iterator
from contextlib import nullcontext
from pathlib import Path

import click
import pytest
import trimesh

import datagen as dg
from datagen.building.input_check import check_inputs
from datagen.cli import cli, run
from datagen.config import load_config
from datagen.errors import InputError, InputWarning
from datagen.exit_status import guarded
from datagen.store import prepare

PACKAGE = Path(dg.__file__).parent
SMALL = """
scenes: 2
capture: {scan: {rows: 2, columns: 2}, time: {bins: 16}}
detector: {mode: ideal}
"""


CROWDED = (
    "scene: {max_attempts: 3, contents: ["
    + ", ".join(["{kind: box, width_m: 1.2, depth_m: 1.2, height_m: 1}"] * 12)
    + "]}"
)
"""A room that no draw can meet."""


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    Path("config.yaml").write_text(SMALL)
    return tmp_path


def refused(capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    """Run a command that must be refused; returns its one line."""
    before = snapshot(Path())
    assert run(arguments) == 2
    out, err = capsys.readouterr()
    assert out == "" and err.startswith("datagen: ") and err.count("\n") == 1, err
    assert snapshot(Path()) == before, "something was left behind"
    return err


def snapshot(folder: Path) -> dict[str, bytes]:
    return {str(path): path.read_bytes() if path.is_file() else b"" for path in folder.rglob("*")}


@pytest.mark.parametrize(
    ("text", "pieces"),
    [
        ("scene: {contents: [}", ["broken YAML", "line 1"]),
        ("sceens: 3", ["sceens", "unknown key", "did you mean 'scenes'"]),
        ("capture: {time: {bin_width_ns: 1}}", ["capture.time.bin_width_ns", "did you mean 'bin_width_ps'"]),
        ("scenes: many", ["scenes = 'many'", "integer"]),
        (CROWDED, ["scene"]),
        ("scenes: 0", ["scenes = 0", "greater than or equal to 1"]),
        ("scene: {contents: [{kind: mesh, path: nowhere.obj}]}", ["nowhere.obj", "no such file"]),
        ("scene: {contents: [{kind: mesh, path: noise.stl}]}", ["noise.stl"]),
        ("store: {scenes_per_shard: 6}", ["scenes_per_shard = 6", "power of two"]),
        ("store: {fields: [histogram, histogram]}", ["named twice"]),
    ],
)
def test_configurations(here: Path, capsys: pytest.CaptureFixture[str], text: str, pieces: list[str]) -> None:
    Path("bad.yaml").write_text(text)
    Path("noise.stl").write_bytes(bytes(range(256)))
    line = refused(capsys, "build", "bad.yaml", "out/set")
    for piece in pieces:
        assert piece in line


@pytest.mark.parametrize(
    ("arguments", "piece"),
    [
        (["build", "nothing.yaml", "out"], "nothing.yaml: no such file"),
        (["build", ".", "out"], "is a directory"),
        (["build", "config.yaml", "out", "--workers", "0"], "--workers 0: must be ≥ 1"),
        (["build", "config.yaml", "out", "--scenes", "-1"], "--scenes -1: must be ≥ 1"),
        (["build", "config.yaml", "out", "--workers", "1000000"], "--workers 1000000: must be ≥ 1 and ≤ 4096"),
        (["build", "config.yaml", ""], "OUT = '': names no folder"),
        (["build", "config.yaml", "out", "--scene-seconds", "nan"], "--scene-seconds nan"),
        (["build", "config.yaml", "out", "--scene-seconds", "soon"], "--scene-seconds soon"),
        (["build", "config.yaml", "out", "--scene-seconds", "1", "--engine", "dask"], "only local workers"),
        (["build", "config.yaml", "out", "--scheduler", "tcp://host:1"], "only --engine dask has a scheduler"),
        (
            ["build", "config.yaml", "out", "--engine", "dask", "--scheduler", "tls://127.0.0.1:1"],
            "tls://127.0.0.1:1",
        ),
        (["plan", "config.yaml", "--scenes", "-1"], "--scenes -1: must be ≥ 1"),
        (["plan", "config.yaml", "--workers", "0"], "--workers 0"),
        (["plan", "config.yaml", "--seconds", "nan"], "--seconds nan"),
        (["plan", "config.yaml", "--json", "nowhere/plan.json"], "no folder nowhere"),
        (["plan", "config.yaml", "--json", "."], "is a folder"),
        (["preview", "nothing", "--scenes", "-1"], "--scenes -1: must lie in 0 … 100"),
        (["sheet", "config.yaml", "out.xyz"], "OUT = 'out.xyz': pictures are PNG files"),
        (["sheet", "nan.yaml", "out.png"], "scene.contents[0].path"),
        (["sheet", "out.png"], "missing argument"),
        (["build", "config.yaml", "out", "--shards", "7"], "--shards 7"),
        (["build", "config.yaml", "out", "--engine", "spark"], "--engine spark: must be local or dask"),
        (["build", "config.yaml", "config.yaml"], "is a file, not a folder"),
        (["build", "config.yaml", "config.yaml/below/set"], "is a file, not a folder"),
        (["build", "config.yaml", "/proc/set"], "cannot be written"),
        (["build", "config.yaml", "."], "no dataset.json"),
        (["build", "config.yaml"], "missing argument 'OUT'"),
        (["build", "config.yaml", "out", "--wrokers", "2"], "--wrokers"),
        (["biuld", "config.yaml", "out"], "no such command 'biuld'"),
        (["verify", "nothing"], "no such dataset"),
        (["verify", "."], "is no dataset"),
        (["show", "nothing", "0"], "no such dataset"),
        (["show", "nothing", "first"], "'first' is not a valid integer"),
    ],
)
def test_arguments(here: Path, capsys: pytest.CaptureFixture[str], arguments: list[str], piece: str) -> None:
    Path("nan.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 nan 0\nf 1 2 3\n")
    Path("nan.yaml").write_text("scene: {contents: [{kind: mesh, path: nan.obj}]}")
    assert piece in refused(capsys, *arguments)


def whole_numbers() -> Iterator[tuple[str, str]]:
    """(command, name of an option or argument) of every whole number on the command line."""

    def commands(group: click.Group, prefix: str) -> Iterator[tuple[str, click.Command]]:
        for name in group.list_commands(click.Context(group)):
            command = group.get_command(click.Context(group), name)
            assert command is not None
            below = commands(command, f"{name} ") if isinstance(command, click.Group) else [(prefix + name, command)]
            yield from below

    for command, found in commands(cli, ""):
        for parameter in found.params:
            if isinstance(parameter.type, click.types.IntParamType):
                yield command, parameter.opts[-1]


BESIDE = {
    "plan": "config.yaml", "build": "config.yaml out", "verify": "set", "show": "set", "replay": "set",
    "preview": "set", "sheet": "config.yaml out.png", "suite": "letters-1 out", "import": "a.mat out",
    "baseline": "mean set out.npz", "bench accuracy": "config.yaml", "bench stages": "config.yaml",
    "export": "set out --format mat",
}  # fmt: skip
"""What else a command needs before it looks at its whole numbers."""
MEANT = {
    "show index 0", "replay scene 0", "bench accuracy --scene 0", "preview --scenes 0", "baseline --seed 0",
}  # fmt: skip
"""Whole numbers below 1 that mean something."""


def test_whole_numbers_that_mean_nothing_are_refused(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    prepare(here / "set", load_config("config.yaml"))
    names = [*whole_numbers()]
    assert len(names) > 12
    for command, name in names:
        for value in ("0", "-1"):
            if f"{command} {name} {value}" not in MEANT:
                given = [name, value] if name.startswith("-") else ["--", value]
                line = refused(capsys, *command.split(), *BESIDE[command].split(), *given).lower()
                assert name.removeprefix("--") in line and value in line, line


def option_words(source: str) -> Iterator[str]:
    """Texts of a module, but for docstrings, that have a word that looks like an option of a command."""
    tree = ast.parse(source)
    documents = {
        id(node.value)
        for node in ast.walk(tree)
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)
    }
    for node in ast.walk(tree):
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in documents:
            # A whole command may be named to anybody, and only a command that runs another one has its options alone.
            yield from re.findall(r"(?<!datagen )--[a-z][a-z-]*", re.sub(r"`[^`]*`", "", node.value))


def test_only_the_command_line_speaks_of_its_options() -> None:
    """Who calls a function in Python reads the name of its argument, `datagen.records.checks.as_given`."""
    found = {
        (str(path.relative_to(PACKAGE)), word)
        for path in PACKAGE.rglob("*.py")
        if path.name != "cli.py" and path.parent.name != "bench"
        for word in option_words(path.read_text(encoding="utf-8"))
    }
    git = {("store/environment.py", word) for word in ("--porcelain", "--untracked-files")}
    again = {("paper/reproduce.py", word) for word in ("--config", "--quick")}
    assert found == git | again | {("exit_status.py", "--help")}


def test_an_argument_is_named_as_its_user_writes_it(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(InputError, match=r"^scenes = 1\.5: must be ≥ 1"):
        load_config("config.yaml").with_scenes(1.5)  # type: ignore[arg-type]
    with pytest.raises(InputError, match=r"^workers = 0: must be"):
        dg.build(load_config("config.yaml"), "out", 0)
    with pytest.raises(InputError, match=r"^bin_width = 'wide': must be a time"):
        dg.import_captures("a.mat", "out", bin_width="wide")
    assert "--bin wide: must be a time" in refused(capsys, "import", "a.mat", "out", "--bin", "wide")

    # Somebody else's command has options of its own.
    @click.command()
    @click.option("--workers", type=int)
    def theirs(workers: int) -> None:
        dg.build(load_config("config.yaml"), "out", workers)

    assert guarded(theirs, ["--workers", "0"]) == 2
    assert capsys.readouterr().err.startswith("datagen: workers = 0: must be")


def test_an_engine_whose_package_is_missing_says_what_to_install(
    here: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    line = refused(capsys, "build", "config.yaml", "out", "--engine", "dask")
    assert "pip install nlos-datagen[cluster]" in line


def test_what_is_hardly_meant_is_warned_of_before_a_build(here: Path) -> None:
    trimesh.creation.box().submesh([range(10)], append=True).export("lidless.obj")
    trimesh.creation.box().export("box.obj")
    mesh = "{kind: mesh, height_m: 0.5, path: "
    for contents, fields, line in (
        ("", "depth", r"scene\.contents: no scene has an object"),
        ("{kind: box, count: 0}", "depth", r"scene\.contents: no scene has an object"),
        (f"{mesh}lidless.obj}}", "occupancy, sdf", r"\[0\].path = 'lidless.obj': .* in occupancy and sdf; close"),
        (f"{mesh}box.obj}}", "occupancy", None),
        (f"{mesh}lidless.obj}}", "depth", None),
    ):
        text = f"scenes: 1\nscene: {{contents: [{contents}]}}\nstore: {{fields: [histogram, {fields}]}}"
        Path("odd.yaml").write_text(text)
        with nullcontext() if line is None else pytest.warns(InputWarning, match=line):
            check_inputs(load_config("odd.yaml"))


def test_a_warning_is_a_line_too(capsys: pytest.CaptureFixture[str]) -> None:
    @click.command()
    def odd() -> None:
        warnings.warn("a lens\nof 20 m", InputWarning, stacklevel=1)

    with warnings.catch_warnings():
        warnings.simplefilter("always")
        assert guarded(odd, []) == 0
    assert capsys.readouterr().err == "datagen: warning: a lens of 20 m\n"


@pytest.mark.parametrize("arguments", [[], ["bench"]])
def test_a_group_alone_prints_its_help(capsys: pytest.CaptureFixture[str], arguments: list[str]) -> None:
    assert run(arguments) == 0
    out, err = capsys.readouterr()
    assert out.startswith("Usage: datagen") and "Commands:" in out and err == ""
