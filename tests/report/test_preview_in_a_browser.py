"""The preview's script in headless chromium, where there is one: no errors, the slider moves, filters filter."""

from __future__ import annotations

import base64
import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from handmade_rooms import l_corridor

from datagen.config import config_from_mapping
from datagen.config.labels import LabelsConfig
from datagen.labels import make_labels
from datagen.report.explorer import explorer, scene_data
from datagen.report.html import head
from datagen.report.labels import DRAWN, LabelImage
from datagen.report.replay import StoredScene

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
BEFORE = "<script>window.faults = []; window.onerror = message => { window.faults.push(message); };</script>"
AFTER = """<pre id="told"></pre><script>
const told = [], say = id => told.push(document.getElementById(id).textContent);
const moved = (id, value, kind) => {
  const it = document.getElementById(id); it.value = value; it.dispatchEvent(new Event(kind)); };
say("when"); moved("time", 3, "input"); say("when"); say("found"); moved("of_class", "chair", "change"); say("found");
const wall = document.getElementById("wall"), picture = wall.getContext("2d");
const drawn = (x, y, w, h) => [...picture.getImageData(x, y, w, h).data];
const light = (x, y) => drawn(x, y, 1, 1).slice(0, 3).reduce((a, b) => a + b);
told.push(String(drawn(0, 0, 60, 420).some(v => v) && drawn(90, 370, 340, 20).some(v => v)));
told.push(String(light(455, 20) > light(455, 180) && light(455, 180) > light(455, 350)));
say("where"); const box = wall.getBoundingClientRect(), zoom = box.width / 700;
wall.dispatchEvent(new PointerEvent("pointerdown", {clientX: box.left + 400 * zoom, clientY: box.top + 40 * zoom}));
say("where"); document.getElementById("gallery").children[1].click(); say("chosen");
say("objects"); told.push(String(document.querySelectorAll(".weak").length));
told.push(String(document.documentElement.scrollWidth <= window.innerWidth));
document.getElementById("told").textContent = told.join("|") + "|" + window.faults.join(";");
</script>"""


def scene(index: int, label: str, scanned: bool) -> dict[str, object]:
    corners = [0.0, 0, 0, 1, 0, 0, 0, 1, 1]
    curve = {"name": "all light", "color": "#222222", "values": "AAECAwQFBgcICQoLDA0ODw=="}
    scan = {"rows": 2, "columns": 2, "bins": 4, "decades": 4.0, "highest": 1e-9, "start_ns": 2.0, "width_ns": 0.5,
            "open": {"bin": 2, "place": [1, 0]}, "across": {"name": "right (m)", "ends": [-1.0, 1.0]},
            "up": {"name": "up (m)", "ends": [0.5, -1.5]}}  # fmt: skip
    return {
        "index": index, "layout": "l_corridor", "classes": [label], "error": 0.01 * index, "device": [0.0, 0, 1],
        "parts": [{"name": label, "role": "object", "color": "#E69F00", "corners": corners, "sigma": 0.5 + index}],
        "labels": [{"name": "depth", "rows": 1, "columns": 1, "size": [2, 1], "values": "AECA"}],
        "scan": {**scan, "curves": [curve]} if scanned else None,
    }  # fmt: skip


@pytest.mark.skipif(CHROMIUM is None, reason="needs chromium")
def test_it_loads_slides_and_filters(tmp_path: Path) -> None:
    """In a window as narrow as a telephone's."""
    scenes = [scene(0, "box <!--<script></script>", True), scene(7, "chair", False)]
    page = head("preview").replace("<style>", BEFORE + "<style>", 1) + explorer(scenes, 9) + AFTER + "</body></html>"
    (tmp_path / "page.html").write_text(page, encoding="utf-8")
    done = subprocess.run(
        [str(CHROMIUM), "--headless", "--no-sandbox", "--disable-gpu", f"--user-data-dir={tmp_path / 'profile'}",
         "--window-size=420,900", "--dump-dom", f"file://{tmp_path / 'page.html'}"],
        capture_output=True, text=True, timeout=240,
    )  # fmt: skip
    told = re.search(r'<pre id="told">(.*?)</pre>', done.stdout)
    assert told is not None, done.stderr
    before, after, all_shown, some_shown, axes, scale, opened, pointed, *others = told[1].split("|")
    assert (before, after) == ("3.00 – 3.50 ns", "3.50 – 4.00 ns")
    assert (all_shown, some_shown) == ("2 of 9 rooms shown", "1 of 9 rooms shown")
    chosen, objects, weak, fits, faults = others
    # Numbers beside and below the wall, and a scale from bright to dark at its right.
    assert (axes, scale) == ("true", "true")
    assert opened.startswith("at row 2, column 1 ") and pointed.startswith("at row 1, column 2 ")
    # One of the two is under 3 σ, in the gallery alone: the other is chosen.
    assert (objects, weak) == ("chair 7.5 σ", "1")
    assert (chosen, fits, faults) == ("Scene 7", "true", "")


def test_data_cannot_end_the_script() -> None:
    """Nor open a comment with a script in it, after which the page's own closing tag ends nothing."""
    page = explorer([scene(0, "</script> <!--<script>", False)], 1)
    assert page.count("</script>") == 1 and page.count("<script>") == 1 and "<!--" not in page


def test_a_room_s_values_say_what_its_objects_have_and_show_labels_as_the_pictures_do() -> None:
    """σ beside each object that has one; images as bytes of `LabelImage`."""
    room = l_corridor()
    depth = make_labels(LabelsConfig(rows=4, columns=6), room, ["depth"])
    sigma = {"evidence.box.significance": 98.0, "evidence.pillar.significance": float("nan")}
    data = scene_data(StoredScene(config_from_mapping({}), 0, depth, sigma), room, None, None)
    assert {part["name"]: part["sigma"] for part in data["parts"] if "sigma" in part} == {"box": 98.0}
    (label,) = data["labels"]
    shown = np.frombuffer(base64.b64decode(label["values"]), np.uint8).reshape(4, 6, 3)
    assert np.array_equal(shown, LabelImage.of(room, "depth", depth["depth"]).rgb)
    assert label["name"].startswith("Depth (m), ") and label["size"] == [3.0, 2.5]


SIZES = {"row": 4, "column": 6, "axis": 3, "voxel_depth": 3, "voxel_row": 4, "voxel_column": 6}


def test_every_label_is_an_image_even_where_it_is_empty() -> None:
    """White where there is nothing; a volume as it is seen along its depth."""
    for field, of in DRAWN.items():
        shape = tuple(SIZES[axis] for axis in of.dims)
        empty = np.full(shape, -1) if of.look.colors == "parts" else np.zeros(shape)
        image = LabelImage.of(l_corridor(), field, empty)
        assert image.rgb.shape == (4, 6, 3)
        if of.look.least is not None or of.look.colors in ("parts", "directions"):
            assert (image.rgb == 255).all(), field
        assert (image.low < image.high).all() and (of.is_volume or np.array_equal(image.low, -image.high))
