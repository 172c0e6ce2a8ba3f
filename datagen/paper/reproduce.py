"""`datagen reproduce OUT`: everything into one folder, or nothing."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from datagen.config import load_config
from datagen.errors import InputError
from datagen.paper.envelope_figures import envelope_figure
from datagen.paper.lookin_balance import lookin_balance
from datagen.paper.numbers import MADE_BY, numbers
from datagen.paper.page import page
from datagen.paper.room_figures import light_figure, lookins_figure
from datagen.paper.room_samples import example_lookins, lit_points
from datagen.paper.runs import FULL, QUICK, ROOM_UNIT_M, Progress, run_all
from datagen.paper.statements import statements_of
from datagen.report.style import save_png
from datagen.store.files import PARTIAL, json_bytes, read_json

PAGE, NUMBERS = "index.html", "numbers.json"
ROOM = Path(__file__).with_name("demonstration_room.yaml")
"""The configuration of the same name in `configs/`, which a wheel does not carry."""


def reproduce(
    out: str | Path, config: str | Path | None = None, quick: bool = False, progress: Progress = lambda stage: None
) -> Path:
    """Compute the paper's Fig. 3, 5, 7 and 9 by both estimators and write them with a page and all numbers.

    Parameters
    ----------
    out : folder to make; an earlier reproduction in it is replaced, anything else refused.
    config : a configuration with one laser point and one pixel; default the paper's demonstration room.
    quick : few rays and pixels, seconds instead of minutes: to see how it works.
    progress : called with the name of each stage as it begins.

    Returns
    -------
    The page's path.

    Raises
    ------
    InputError : for a folder that holds something else or cannot be written, a configuration that cannot be used, or
        a BRDF that the paper does not have. Nothing is left behind then.
    """
    room = load_config(ROOM if config is None else config)
    command = f"datagen reproduce {out}{'' if config is None else f' --config {config}'}{' --quick' if quick else ''}"
    with _written_at_once(Path(out)) as folder:
        runs = run_all(room, QUICK if quick else FULL, progress)
        balance = lookin_balance(runs.scene, runs.capture, runs.sparse, runs.sizes.pixels, ROOM_UNIT_M)
        statements = statements_of(runs, balance)
        progress("figures")
        points, examples = lit_points(runs), example_lookins(runs)
        images = {number: f"figure_{number}.png" for number in ("3", "5", "7", "9")}
        save_png(light_figure(runs, points), folder / images["3"])
        save_png(lookins_figure(runs, examples), folder / images["5"])
        save_png(envelope_figure(runs, "all", "7"), folder / images["7"])
        save_png(envelope_figure(runs, "strongest", "9"), folder / images["9"])
        (folder / NUMBERS).write_bytes(json_bytes(numbers(runs, statements, command)))
        html = "\n".join(page(runs, statements, points, examples, images, command))
        (folder / PAGE).write_text(html, encoding="utf-8")
    return Path(out) / PAGE


@contextmanager
def _written_at_once(out: Path) -> Iterator[Path]:
    """A folder beside `out` that takes its place at the end; gone, with all folders made for it, on any failure."""
    if out.exists() and not out.is_dir():
        raise InputError(f"{out}: is a file; name a folder to write")
    if out.is_dir() and any(out.iterdir()) and not _is_ours(out):
        raise InputError(f"{out}: holds other files; name a new folder, or one of an earlier reproduction")
    place = out.resolve()
    parent = place.parent
    made = [folder for folder in (parent, *parent.parents) if not folder.exists()]
    partial: Path | None = None
    try:
        try:
            parent.mkdir(parents=True, exist_ok=True)
            partial = parent / f".{place.name}.{os.getpid()}{PARTIAL}"
            partial.mkdir()
        except OSError as error:
            raise InputError(f"{out}: cannot be written ({error.strerror or error}); name another folder") from None
        yield partial
        if place.is_dir():
            shutil.rmtree(place)
        partial.replace(place)
    except BaseException:
        if partial is not None:
            shutil.rmtree(partial, ignore_errors=True)
        for folder in made:
            with suppress(OSError):
                folder.rmdir()
        raise


def _is_ours(folder: Path) -> bool:
    try:
        return bool(read_json(folder / NUMBERS)["made_by"] == MADE_BY)
    except (InputError, KeyError, TypeError):
        return False
