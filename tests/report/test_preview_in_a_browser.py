"""The preview's script in headless chromium, where there is one: no errors, the slider moves, filters filter."""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path

import pytest

from datagen.report.explorer import explorer
from datagen.report.html import head

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
BEFORE = "<script>window.faults = []; window.onerror = message => { window.faults.push(message); };</script>"
AFTER = """<pre id="told"></pre><script>
const told = [], say = id => told.push(document.getElementById(id).textContent);
const moved = (id, value, kind) => {
  const it = document.getElementById(id); it.value = value; it.dispatchEvent(new Event(kind)); };
say("when"); moved("time", 3, "input"); say("when"); say("found"); moved("of_class", "chair", "change"); say("found");
document.getElementById("gallery").children[1].click(); say("chosen");
say("objects"); told.push(String(document.querySelectorAll(".weak").length));
told.push(String(document.documentElement.scrollWidth <= window.innerWidth));
document.getElementById("told").textContent = told.join("|") + "|" + window.faults.join(";");
</script>"""


def scene(index: int, label: str, scanned: bool) -> dict[str, object]:
    corners = [0.0, 0, 0, 1, 0, 0, 0, 1, 1]
    curve = {"name": "all light", "color": "#222222", "values": "AAECAwQFBgcICQoLDA0ODw=="}
    scan = {"rows": 2, "columns": 2, "bins": 4, "decades": 4.0, "highest": 1e-9, "start_ns": 2.0, "width_ns": 0.5}
    return {
        "index": index, "layout": "l_corridor", "classes": [label], "error": 0.01 * index, "device": [0.0, 0, 1],
        "parts": [{"name": label, "role": "object", "color": "#E69F00", "corners": corners, "sigma": 0.5 + index}],
        "labels": [{"name": "depth", "rows": 2, "columns": 2, "bands": 1, "size": [2, 1], "values": "AECA/w=="}],
        "scan": {**scan, "curves": [curve]} if scanned else None,
    }  # fmt: skip


@pytest.mark.skipif(CHROMIUM is None, reason="needs chromium")
@pytest.mark.parametrize("width", [420, 1200])
def test_it_loads_slides_and_filters(tmp_path: Path, width: int) -> None:
    scenes = [scene(0, "box </script>", True), scene(7, "chair", False)]
    page = head("preview").replace("<style>", BEFORE + "<style>", 1) + explorer(scenes) + AFTER + "</body></html>"
    (tmp_path / "page.html").write_text(page, encoding="utf-8")
    done = subprocess.run(
        [str(CHROMIUM), "--headless", "--no-sandbox", "--disable-gpu", f"--user-data-dir={tmp_path / 'profile'}",
         f"--window-size={width},900", "--dump-dom", f"file://{tmp_path / 'page.html'}"],
        capture_output=True, text=True, timeout=240,
    )  # fmt: skip
    told = re.search(r'<pre id="told">(.*?)</pre>', done.stdout)
    assert told is not None, done.stderr
    before, after, all_shown, some_shown, chosen, objects, weak, fits, faults = told[1].split("|")
    assert (before, after) == ("2.50 – 3.00 ns", "3.50 – 4.00 ns")
    assert (all_shown, some_shown) == ("2 of 2 rooms shown", "1 of 2 rooms shown")
    # One of the two is under 3 σ, in the gallery alone: the other is chosen.
    assert (objects, weak) == ("chair 7.5 σ", "1")
    assert (chosen, fits, faults) == ("Scene 7", "true", "")


def test_data_cannot_end_the_script() -> None:
    assert explorer([scene(0, "</script>", False)]).count("</script>") == 1
