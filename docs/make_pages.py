"""Hooks by which MkDocs makes pages of the whole repository: `make docs`.

Links on the pages are relative to the files in the repository, so that they work there, too. README and the pages
beside it join those of `docs/`; whatever else a page links to is copied into the site.
"""

from __future__ import annotations

import base64
import posixpath
import re
from collections.abc import Iterator
from inspect import isclass
from pathlib import Path
from typing import Any

import nbformat
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.exceptions import PluginError
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

import datagen

ROOT = Path(__file__).resolve().parents[1]
BESIDE = ("README.md", "CONTRIBUTING.md", "CHANGELOG.md")
STAGES = (
    "records", "config", "scene", "capture", "transport", "effects", "detector", "evidence", "devices", "design",
    "building", "formats", "loader", "suites", "scoring", "paper", "errors",
)  # fmt: skip
INTRODUCTION = """\
# Python API

Every public name of `datagen` (`import datagen as dg`), in the order of the stages. Lengths are in metres, times in
seconds, and arrays have the axes laser (L), pixel (P) and bin (T). Bad input raises
`dg.InputError` with one line that names key, value, allowed range and remedy. Keys of
configurations are on [a page of their own](configuration_keys.md).
"""


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the pages that are not in `docs/`, and the files that pages link to."""
    for name in BESIDE:
        text = (ROOT / name).read_text(encoding="utf-8")
        files.append(File.generated(config, _place(name), content=text))
    files.append(File.generated(config, "api.md", content=api()))
    for path in sorted((ROOT / "docs/tutorials").glob("*.ipynb")):
        if not (ROOT / config.extra["tutorials"] / path.name).is_file():
            raise PluginError(
                f"{path.name} was not run: python docs/run_tutorials.py docs/tutorials/*.ipynb out/tutorials"
            )
        for uri, content in tutorial(ROOT / config.extra["tutorials"] / path.name):
            files.append(File.generated(config, uri, content=content))
    for page in list(files.documentation_pages()):
        for name in _linked(page.content_string, _home(page.src_uri)):
            if files.get_file_from_path(_place(name)) is None:
                files.append(File.generated(config, _place(name), abs_src_path=str(ROOT / name)))
    return files


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Links of the repository as the site has them, and names of datagen as links to the API."""
    here = page.file.src_uri

    def moved(match: re.Match[str]) -> str:
        name, anchor = _in_repository(match[1], _home(here)), match[2] or ""
        if name is None:
            return match[0]
        return f"]({posixpath.relpath(_place(name), posixpath.dirname(here))}{anchor})"

    def named(match: re.Match[str]) -> str:
        thing = getattr(datagen, match[2], None)
        return f"[{match[1]}][{_path(thing)}]" if thing and thing.__module__.startswith("datagen.") else match[0]

    # Every second piece is a block of code.
    pieces = re.split(r"(^```.*?^```$)", markdown, flags=re.MULTILINE | re.DOTALL)
    pieces[::2] = [re.sub(r"(?<!\[)(`dg\.(\w+)(?:\([^`\n]*\))?`)(?!\])", named, piece) for piece in pieces[::2]]
    return re.sub(r"\]\(([^)\s#]+)(#[^)\s]*)?\)", moved, "".join(pieces))


def _path(thing: Any) -> str:
    """Where a public thing is defined, by which mkdocstrings finds it and its place on the page."""
    return f"{thing.__module__}.{thing.__qualname__}"


def _home(uri: str) -> str:
    """The folder of the repository that the links of a page start from."""
    return "" if uri in map(_place, BESIDE) else posixpath.join("docs", posixpath.dirname(uri))


def _in_repository(link: str, home: str) -> str | None:
    """The file of the repository that a relative link leads to, None if there is none."""
    name = posixpath.normpath(posixpath.join(home, link))
    return name if (ROOT / name).is_file() else None


def _linked(text: str, home: str) -> Iterator[str]:
    """Files of the repository that a page links to."""
    links = re.findall(r"\]\(([^)\s#]+)(?:#[^)\s]*)?\)", text)
    yield from dict.fromkeys(name for link in links if (name := _in_repository(link, home)))


def _place(name: str) -> str:
    """Where the site has a file of the repository."""
    if name == "README.md":
        return "index.md"
    place = name.removeprefix("docs/").lstrip(".")
    return place.removesuffix(".ipynb") + ".md" if place.endswith(".ipynb") else place


def api() -> str:
    """The page of all public names by stage, classes first; mkdocstrings puts their docstrings in."""
    named = {name: getattr(datagen, name) for name in datagen.__all__ if not name.startswith("_")}
    text = [INTRODUCTION]
    for stage in STAGES:
        ours = [name for name, thing in named.items() if thing.__module__.split(".")[1] == stage]
        text.append(f"## {stage.capitalize()}\n")
        text += [
            f"::: {_path(named.pop(name))}\n"
            for name in sorted(ours, key=lambda name: (not isclass(named[name]), name))
        ]
    if named:
        raise SystemExit(f"docs/make_pages.py: {', '.join(named)} belong to none of the stages {', '.join(STAGES)}")
    return "\n".join(text)


def tutorial(path: Path) -> Iterator[tuple[str, str | bytes]]:
    """The page of a notebook that was run, and the pictures that its cells drew, with their places in the site."""
    title, *cells = nbformat.read(path, as_version=4).cells
    text = [title.source, f'<a href="{path.name}" download>This page as a notebook</a>']
    for number, cell in enumerate(cells):
        text.append(cell.source if cell.cell_type == "markdown" else f"```python\n{cell.source}\n```")
        for output in cell.get("outputs", ()):
            data = output.get("data", {})
            kind = next((kind for kind in ("png", "gif") if f"image/{kind}" in data), None)
            if kind:
                uri = f"tutorials/{path.stem}_{number}.{kind}"
                yield uri, base64.b64decode(data[f"image/{kind}"])
                text.append(f"![Drawn by the code above]({posixpath.basename(uri)})")
            elif output.get("name") == "stdout":
                text.append(f"```text\n{_without_colors(output.text)}\n```")
    yield f"tutorials/{path.stem}.md", "\n\n".join(text) + "\n"


def _without_colors(printed: str) -> str:
    """What a terminal shows, without the codes of its colours."""
    return re.sub(r"\x1b\[[0-9;]*m|\r", "", printed).strip()
