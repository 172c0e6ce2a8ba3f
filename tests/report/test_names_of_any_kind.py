"""Names with markup, in any script and of any length: shown as they are on pages, in pictures and on cards."""

from __future__ import annotations

import re
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
import trimesh

import datagen as dg
from datagen.config import config_from_mapping
from datagen.report.contact_sheet import contact_sheet, label_sheet
from datagen.report.pages import show
from datagen.report.preview import preview
from datagen.store import verify

pytestmark = pytest.mark.usefixtures("builds_here", "coarse")

MARKUP = "<script>alert(1)</script><!--<b onclick='x'>&amp; \"$\\frac$ `|` *_x_* [a](b) 漢字 é"
TEXTS = {
    "name": MARKUP, "description": f"{MARKUP}\n\nSee <https://example.org> and *more*.",
    "part": f"p {MARKUP}", "class": MARKUP, "parameter": MARKUP,
}  # fmt: skip


class Tags(HTMLParser):
    """The tags of a page, their attributes, and its text."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.tags, self.attributes, self.text = set[str](), set[str](), ""
        self.feed(page)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.add(tag)
        self.attributes |= {name for name, _ in attrs}

    def handle_data(self, data: str) -> None:
        self.text += data


def room(x: float) -> dg.Scene:
    wall = trimesh.creation.box((0.1, 4, 3)).apply_translation((-0.05, 0, 0))
    front = dg.Rectangle.of((0, 0, 0), (0, 1, 0), (0, 0, 1))
    parts = [dg.Part("wall", wall, dg.Lambertian(0.8), "relay_wall")]
    for number, name in enumerate((TEXTS["part"], "y" * 100)):
        box = trimesh.creation.box((0.4, 0.4, 0.4)).apply_translation((x, 0.5 * number, 0))
        parts.append(dg.Part(name, box, dg.Lambertian(0.6), pose=dg.Pose.upright(TEXTS["class"])))
    return dg.Scene.from_parts(
        parts, relay_wall=front, hidden_view=front, parameters={TEXTS["parameter"]: x, "said": MARKUP}
    )


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two scenes whose light comes from elsewhere."""
    laser = dg.Laser((3, -1, 0), [(0, 0, 0.2), (0, 0, -0.2)])
    sensor = dg.Sensor.grid((3, -1, 0), (0, 0, 0), (0, 0.3, 0), (0, 0, 0.3), rows=1, columns=2)
    capture = dg.Capture(laser, sensor, dg.TimeAxis(32, 1e-9, origin="wall"))
    light = np.full(capture.shape, 1e-11)
    path = tmp_path_factory.mktemp("markup") / "set"
    dg.build_from(
        [(room(0.8), capture, light), (room(1.2), capture, 2 * light)], path, progress=False,
        fields=("histogram", "depth", "part_id", "objects"),
        settings={"name": TEXTS["name"], "description": TEXTS["description"], "labels": {"rows": 8, "columns": 8}},
    )  # fmt: skip
    return path


def test_a_page_and_pictures_show_names_as_text(dataset: Path, tmp_path: Path) -> None:
    """Without a warning, such as of letters that the font of the pictures lacks."""
    page = Tags(preview(dataset, tmp_path / "page.html").read_text(encoding="utf-8"))
    assert len(show(dataset, 0, tmp_path / "shown")) == 3
    assert not page.tags & {"script", "b", "a"} and not {name for name in page.attributes if name.startswith("on")}
    for name, text in TEXTS.items():
        assert text in page.text, name


def test_a_card_shows_names_as_text(dataset: Path) -> None:
    """No tag, no table cell, no code begins or ends within a name; Markdown of the description stays Markdown."""
    card = (dataset / "README.md").read_text(encoding="utf-8").split("\n---\n", 1)[1]
    outside_code = re.sub(r"(?<!\\)`[^`\n]*`", "", card)
    assert not re.search(r"<(?!https://example\.org>)", outside_code)
    assert "See <https://example.org> and *more*." in card
    (heading,) = [line for line in card.splitlines() if line.startswith("# ")]
    assert r"\*_x_\* \[a\](b) 漢字" in heading
    rows = [line for line in card.splitlines() if line.startswith("|") and "alert" in line]
    assert rows and all(len(re.split(r"(?<!\\)\|", row)) == 6 for row in rows)
    assert verify(dataset).problems == ()


def test_a_sheet_of_a_configuration_with_any_name(tmp_path: Path) -> None:
    config = config_from_mapping({"name": f"{MARKUP}\n$x"[:100]})
    for draw in (contact_sheet, label_sheet):
        assert draw([config, config], 2, tmp_path / "sheet.png").is_file()


def test_a_name_that_no_list_can_hold_is_refused() -> None:
    box = trimesh.creation.box((1, 1, 1))
    for name in ("", "two\nlines", "x" * 101, "a,b", "_hidden", "\x1b[31m"):
        with pytest.raises(dg.InputError, match=r"^Part\.name = .*: must [^\n]*; [^\n]*$"):
            dg.Part(name, box, dg.Lambertian(0.5))
    with pytest.raises(dg.InputError, match=r"Pose\.label = .* 1 … 100 printable characters"):
        dg.Pose.upright("two\nlines")
    with pytest.raises(dg.InputError, match=r"Scene\.parameters: name = .* 1 … 100 printable characters"):
        dg.Scene.from_parts([dg.Part("box", box, dg.Lambertian(0.5))], parameters={"two\nlines": 1})
