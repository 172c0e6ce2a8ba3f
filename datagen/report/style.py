"""How all pictures look: fonts, colours that colour-blind readers can tell apart, captions, the PNG writer.

Figures are made through matplotlib's objects with the Agg canvas: no window, no global figure. Settings of the caller
are neither used nor changed, so the same data give the same picture everywhere.
"""

from __future__ import annotations

import textwrap
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, BinaryIO

import matplotlib
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.gridspec import GridSpecFromSubplotSpec

from datagen.errors import InputError
from datagen.records import Scene
from datagen.records.checks import as_given
from datagen.store.files import replacing

WIDTH_IN = 8.0
"""Width of every picture, inches: 880 pixels, which pages of text show some 830 wide."""
SMALLEST_PT = 8.0
"""Size of the smallest letters, points: 11 pixels and more on such a page."""
DPI = 110
INK = "#222222"
_CAPTION_LETTERS, _TITLE_LETTERS = 112, 76
"""Letters of a line of a caption, and of a title, as many as `WIDTH_IN` has room for."""
NAME_LETTERS = 32
"""Most letters of a name in a legend."""
LASER = "#D55E00"
FIELD_OF_VIEW = "#332288"
EXPECTED = "#0072B2"
_RELAY_WALLS = ("#8DB4DE", "#5E8DC1", "#3E6D9F", "#6F9FB5")
# Okabe & Ito's palette, then Paul Tol's "muted", without the colours used for laser points, FoV and relay wall.
_OBJECTS = (
    "#E69F00", "#009E73", "#CC79A7", "#56B4E9", "#F0E442", "#882255", "#44AA99", "#999933", "#AA4499", "#117733",
)  # fmt: skip
_WALLS = ("#B4B4B8", "#9AA0A6", "#C8C4BC", "#868C94", "#D2D2D6")
_FLOOR, _CEILING = "#E6DDC8", "#C6D3DD"


@contextmanager
def house_style() -> Iterator[None]:
    """Matplotlib's own defaults with our fonts, whatever the user's settings are; restored afterwards."""
    defaults: dict[Any, Any] = {
        key: value for key, value in matplotlib.rcParamsDefault.items() if not key.startswith("backend")
    }
    ours: dict[Any, Any] = {
        "font.family": ["DejaVu Sans"],
        "font.size": 9.0,
        "axes.titlesize": 10.0,
        "axes.titleweight": "bold",
        "axes.titlelocation": "left",
        "axes.labelcolor": INK,
        "axes.edgecolor": "#666666",
        "axes.spines.top": False,
        "axes.spines.right": False,
        "legend.fontsize": SMALLEST_PT,
        "legend.frameon": False,
        "svg.hashsalt": "datagen",
    }
    with matplotlib.rc_context({**defaults, **ours}), warnings.catch_warnings():
        # A letter that the font lacks, as of Chinese names, is drawn as a box.
        warnings.filterwarnings("ignore", "Glyph .* missing from font", UserWarning)
        yield


def plain(text: str) -> str:
    """Text for matplotlib, which would read a formula between two dollar signs."""
    return text.replace("$", r"\$")


def short(name: str, letters: int = NAME_LETTERS) -> str:
    """A name as legends and titles show it: cut where it is long."""
    return plain(name if len(name) <= letters else f"{name[: letters - 1]}…")


def in_sigma(values: Mapping[str, float]) -> dict[str, str]:
    """Name → its significance as legends have it after the name, such as ", 12 σ"; two digits where it is less."""
    return {name: f", {sigma:.0f} σ" if sigma >= 10 else f", {sigma:.2g} σ" for name, sigma in values.items()}


def part_colors(scene: Scene) -> dict[str, str]:
    """Part name → colour: bright for objects, grey for the room, blue for the relay wall and clutter before it."""
    colors, objects, walls, relays = {}, 0, 0, 0
    for name, role in zip(scene.part_names, scene.roles, strict=True):
        if role == "relay_wall":
            colors[name] = _RELAY_WALLS[min(relays, 1) + max(relays - 1, 0) % (len(_RELAY_WALLS) - 1)]
            relays += 1
        elif role == "object":
            colors[name] = _OBJECTS[objects % len(_OBJECTS)]
            objects += 1
        elif "floor" in name or "ceiling" in name:
            colors[name] = _FLOOR if "floor" in name else _CEILING
        else:
            colors[name] = _WALLS[walls % len(_WALLS)]
            walls += 1
    return colors


def new_figure(height_in: float, arranged: bool = True) -> Figure:
    """An empty figure on an Agg canvas, as wide as all. `arranged`: axes are placed by their contents, which is slow
    for many."""
    figure = Figure(figsize=(WIDTH_IN, height_in), dpi=DPI, facecolor="white")
    if arranged:
        figure.set_layout_engine("constrained")
    FigureCanvasAgg(figure)
    return figure


def captioned(
    heights_in: Sequence[float], text: str, title: str = "", columns: int = 1, widths: Sequence[float] | None = None,
    arranged: bool = True,
) -> tuple[Figure, GridSpecFromSubplotSpec]:  # fmt: skip
    """A figure with a caption below it, and the grid of its rows and columns.

    The caption has the last row, and is the first of the figure's axes. arranged : as for `new_figure`.
    """
    lines = textwrap.wrap(text, width=_CAPTION_LETTERS)
    # Where axes are not placed by their contents, their lowest labels reach into the row of the caption.
    above_it = 0.0 if arranged else 0.35
    below = 0.17 * len(lines) + 0.12 + above_it
    height = sum(heights_in) + below + (0 if arranged else 0.6)
    figure = new_figure(height, arranged)
    # A grid within a row, so that titles and labels above take no space from the caption.
    outer = figure.add_gridspec(2, 1, height_ratios=[sum(heights_in), below], hspace=0)
    grid = outer[0].subgridspec(len(heights_in), columns, height_ratios=heights_in, width_ratios=widths)
    if not arranged:
        figure.subplots_adjust(bottom=0, top=1 - 0.6 / height)
    if title:
        titles = "\n".join(textwrap.wrap(title, width=_TITLE_LETTERS))
        figure.suptitle(plain(titles), fontweight="bold", y=None if arranged else 1 - 0.1 / height)
    caption = figure.add_subplot(outer[1])
    caption.set_axis_off()
    written = caption.text(
        0, 1 - above_it / below, plain("\n".join(lines)), va="top", fontsize=8.5, color="#444444", linespacing=1.35
    )
    # Its row is high enough; in the layout, long lines would take space from the pictures.
    written.set_in_layout(False)
    return figure, grid


def empty_note(axes: Axes, text: str) -> None:
    """Write in the middle of an axes why it is empty."""
    axes.text(0.5, 0.5, text, ha="center", va="center", transform=axes.transAxes, color="#777777", wrap=True)


def check_png(out: str | Path, argument: str = "out") -> Path:
    """`out` as a path; raises `InputError` for a name that is no PNG's, which calls it `argument`."""
    path = Path(out)
    if path.suffix.lower() != ".png":
        raise InputError(f"{as_given(argument, str(out))}: pictures are PNG files; name one such as sheet.png")
    return path


def save_png(figure: Figure, path: Path) -> Path:
    """Write the figure; the file depends on the picture alone (no time, no version). Returns `path`."""
    return _save(path, lambda file: figure.savefig(file, format="png", metadata={"Software": None}))


def save_gif(content: bytes, path: Path) -> Path:
    """Write the bytes of an animation. Returns `path`."""
    return _save(path, lambda file: file.write(content))


def _save(path: Path, write: Callable[[BinaryIO], object]) -> Path:
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with replacing(path) as file:
            write(file)
    except OSError as error:
        raise InputError(
            f"{path}: cannot be written ({error.strerror or error}); name another output folder"
        ) from None
    return path
