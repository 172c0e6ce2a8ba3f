"""The pages are built strictly, of tutorials that were run, and a browser shows them on a desk and on a telephone."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
import threading
from collections.abc import Iterator
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).resolve().parents[1]
TUTORIALS = sorted((ROOT / "docs/tutorials").glob("*.ipynb"))
CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
WIDTHS = (390, 1280)
LOOK = """<!doctype html><body><script>
const pages = PAGES, found = [];
const look = (page, width) => new Promise(done => {
  const frame = document.createElement("iframe");
  frame.style = `border: 0; width: ${width}px; height: 900px`;
  frame.onload = () => setTimeout(() => {
    const inside = frame.contentDocument, images = [...inside.images];
    const {scrollWidth, clientWidth} = inside.documentElement;
    found.push({page, width, wide: scrollWidth - clientWidth, words: inside.body.innerText.length,
                broken: images.filter(one => one.complete && !one.naturalWidth).map(one => one.src),
                elsewhere: frame.contentWindow.performance.getEntriesByType("resource").map(one => one.name)
                           .filter(name => !name.startsWith(location.origin))});
    frame.remove(); done();
  }, 50);
  frame.src = page; document.body.append(frame);
});
(async () => { for (const page of pages) for (const width of WIDTHS) await look(page, width);
               await fetch("/found", {method: "POST", body: JSON.stringify(found)}); })();
</script>"""
"""Opens each page in a frame of each width, and sends what it sees back to the server."""


def cells_of(notebook: Path) -> list[dict[str, Any]]:
    cells = json.loads(notebook.read_text(encoding="utf-8"))["cells"]
    return [cell | {"text": "".join(cell["source"])} for cell in cells]


@pytest.mark.parametrize("notebook", TUTORIALS, ids=lambda path: path.stem)
def test_a_tutorial_is_stored_without_outputs_and_each_step_teaches(notebook: Path) -> None:
    cells = cells_of(notebook)
    assert len(TUTORIALS) == 4 and cells[0]["text"].startswith("# ")
    for before, cell, after in zip(cells, cells[1:], [*cells[2:], {}], strict=False):
        if cell["cell_type"] == "code":
            assert cell["outputs"] == [] and cell["execution_count"] is None
            assert "**What you learn:**" in before["text"] and "**Try next:**" in after["text"]


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of the pages, of tutorials that have just been run."""
    folder = tmp_path_factory.mktemp("pages")
    for command in (
        ["docs/run_tutorials.py", *map(str, TUTORIALS), str(folder / "tutorials")],
        ["-m", "mkdocs", "build", "--quiet", "--strict", "--site-dir", str(folder / "site")],
    ):
        given = os.environ | {"TUTORIALS": str(folder / "tutorials"), "NO_MKDOCS_2_WARNING": "1"}
        done = subprocess.run([sys.executable, *command], cwd=ROOT, env=given, capture_output=True, text=True)
        assert done.returncode == 0, done.stdout + done.stderr
    return folder / "site"


def pages_of(site: Path) -> list[str]:
    return [path.relative_to(site).as_posix() for path in sorted(site.rglob("*.html")) if path.name != "404.html"]


@pytest.mark.parametrize("notebook", TUTORIALS, ids=lambda path: path.stem)
def test_a_tutorial_draws_in_each_step(site: Path, notebook: Path) -> None:
    steps = sum(cell["cell_type"] == "code" for cell in cells_of(notebook))
    pictures = [path.name for path in (site / "tutorials").glob(f"{notebook.stem}_*")]
    page = (site / f"tutorials/{notebook.stem}.html").read_text(encoding="utf-8")
    assert len(pictures) == steps and all(name in page for name in pictures)
    assert (site / f"tutorials/{notebook.name}").read_bytes() == notebook.read_bytes()


def test_pages_are_those_of_the_repository(site: Path) -> None:
    """All of `docs/`, README and the pages beside it, whatever they link to, and every public name."""
    import datagen

    made = {"index.html", "api.html", "CONTRIBUTING.html", "CHANGELOG.html"}
    made |= {f"{path.stem}.html" for path in (ROOT / "docs").glob("*.md")}
    made |= {f"tutorials/{path.stem}.html" for path in TUTORIALS}
    assert set(pages_of(site)) == made
    api = (site / "api.html").read_text(encoding="utf-8")
    for name in datagen.__all__:
        thing = getattr(datagen, name)
        assert name.startswith("_") or f'id="{thing.__module__}.{name}"' in api, name
    assert "NDArray" in api and "Floats" not in api
    for page in made:
        for target in re.findall(r'(?:href|src)="([^"#?]+)', (site / page).read_text(encoding="utf-8")):
            if not re.match(r"https?:|data:", target):
                assert (site / page).parent.joinpath(target).exists(), (page, target)


@pytest.fixture
def server(site: Path) -> Iterator[tuple[str, list[Any]]]:
    """The address of the pages, and what is sent there."""
    found: list[Any] = []

    class Handler(SimpleHTTPRequestHandler):
        def do_POST(self) -> None:
            found.extend(json.loads(self.rfile.read(int(self.headers["Content-Length"]))))
            self.send_response(204)
            self.end_headers()

        def log_message(self, *args: Any) -> None: ...

    with ThreadingHTTPServer(("127.0.0.1", 0), partial(Handler, directory=str(site))) as serving:
        threading.Thread(target=serving.serve_forever, daemon=True).start()
        yield f"http://127.0.0.1:{serving.server_port}", found
        serving.shutdown()


def browse(address: str, profile: Path) -> str:
    """The page as a browser has it after ten seconds of the page's own clock."""
    done = subprocess.run(
        [str(CHROMIUM), "--headless", "--no-sandbox", "--disable-gpu", f"--user-data-dir={profile}",
         "--virtual-time-budget=10000", "--dump-dom", address],
        capture_output=True, text=True, timeout=240,
    )  # fmt: skip
    return done.stdout


@pytest.mark.skipif(CHROMIUM is None, reason="needs chromium")
def test_pages_fit_a_desk_and_a_telephone(site: Path, server: tuple[str, list[Any]], tmp_path: Path) -> None:
    """Nothing is wider than the window, pictures load, and nothing comes from elsewhere."""
    address, found = server
    look = LOOK.replace("PAGES", json.dumps(pages_of(site))).replace("WIDTHS", json.dumps(WIDTHS))
    (site / "look.htm").write_text(look, encoding="utf-8")
    browse(f"{address}/look.htm", tmp_path)
    assert len(found) == len(WIDTHS) * len(pages_of(site))
    assert [one for one in found if one["wide"] > 0 or one["broken"] or one["elsewhere"] or one["words"] < 100] == []


@pytest.mark.skipif(CHROMIUM is None, reason="needs chromium")
def test_the_search_finds_also_without_a_server(site: Path, tmp_path: Path) -> None:
    shown = browse(f"file://{site}/index.html?q=dead+time", tmp_path)
    results = re.findall(r'<a href="([^"]+)" class="md-search-result__link"', shown)
    assert any("physics.html" in link for link in results) and any("api.html" in link for link in results)
