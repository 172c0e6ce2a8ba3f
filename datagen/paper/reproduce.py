"""`datagen reproduce OUT`: the paper's figures by both estimators, what they took, and all their numbers."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import asdict
from html import escape
from pathlib import Path
from typing import Any

import numpy as np

from datagen.config import load_config
from datagen.errors import InputError
from datagen.paper.figures import envelope_figure, light_figure, lookins_figure
from datagen.paper.runs import FULL, PEAKS_NS, QUICK, Runs, Simulation, run_all
from datagen.records.arrays import Floats
from datagen.report.html import head, table
from datagen.report.style import save_png
from datagen.store.environment import processor
from datagen.store.files import check_writable, finite, json_bytes, read_json, write_atomically

MADE_BY, PAGE, NUMBERS = "datagen reproduce", "index.html", "numbers.json"
ROOM = Path(__file__).with_name("demonstration_room.yaml")
"""A copy of the configuration of the same name in `configs/`, which is not part of a wheel."""
PUBLISHED_SECONDS = {
    (10, "all"): "≈ 1 hour (paper, sec. 4)",
    (10, "strongest"): "< 30 s (paper, sec. 4)",
    (45, "all"): "3 h 34 min 16 s (notebook)",
    (45, "strongest"): "2 min 00 s (notebook)",
}
"""Rays a side and secondary scheme → computation time with 60 × 60 pixels, on the authors' GPU server."""


def reproduce(
    out: str | Path,
    config: str | Path | None = None,
    quick: bool = False,
    progress: Callable[[str], None] = lambda stage: None,
) -> Path:
    """Compute the paper's Fig. 3, 5, 7 and 9 by both estimators and write them with a page and all numbers.

    out : folder to make; an earlier reproduction in it is replaced, anything else refused.
    config : a configuration with one laser point and one pixel; default the paper's demonstration room.
    quick : few rays and pixels, for seconds instead of minutes.
    progress : called with the name of each stage as it begins.

    Returns
    -------
    The page's path.

    Raises
    ------
    InputError : for a folder that holds something else or cannot be written, a configuration that cannot be used, or
        a BRDF that the paper does not have. Nothing is written then.
    """
    folder, room = Path(out), load_config(ROOM if config is None else config)
    check_writable(folder)
    if folder.is_dir() and any(folder.iterdir()) and not _is_ours(folder):
        raise InputError(f"{out}: holds other files; name a new folder, or one of an earlier reproduction")
    command = f"{MADE_BY} {out}{'' if config is None else f' --config {config}'}{' --quick' if quick else ''}"
    runs = run_all(room, QUICK if quick else FULL, progress)
    progress("figures")
    figures = {
        "3": light_figure(runs), "5": lookins_figure(runs),
        "7": envelope_figure(runs, "all", "7"), "9": envelope_figure(runs, "strongest", "9"),
    }  # fmt: skip
    for number, figure in figures.items():
        save_png(figure, folder / f"figure_{number}.png")
    write_atomically(folder / PAGE, "\n".join(_page(runs, command, tuple(figures))).encode())
    write_atomically(folder / NUMBERS, json_bytes(_numbers(runs, command)))
    return folder / PAGE


def _is_ours(folder: Path) -> bool:
    try:
        return bool(read_json(folder / NUMBERS)["made_by"] == MADE_BY)
    except (InputError, KeyError, TypeError):
        return False


def _page(runs: Runs, command: str, figures: tuple[str, ...]) -> Iterator[str]:
    """The page's HTML, piece by piece."""
    pixels = runs.sizes.pixels
    yield head("The paper's figures, computed again")
    yield (
        "<p>Scholes &amp; Leach, <i>Path Tracing-Inspired Modeling of Non-Line-of-Sight SPAD Data</i>, Sensors "
        "24(20), 6522 (2024), computed again twice: <b>as printed</b>, by its Eq. 6 and Eq. 8 to the letter with "
        "lengths in millimetres, and with <b>radiometric</b> weights: the secondary by the paper's scheme, "
        "<code>datagen.paper.secondary</code>, whose seconds are given, the primary by "
        f"<code>datagen.simulate</code>, to {100 * runs.sizes.target:g} %. "
        f"Room: <code>{escape(runs.config.name)}</code>. Made by <code>{escape(command)}</code> on one core of "
        f"{escape(processor())}. All numbers: <code>{NUMBERS}</code>; what of the paper holds, and what its text "
        "leaves open: <code>docs/figures.md</code>.</p>"
    )
    for number in figures:
        yield f'<h2>Fig. {number}</h2><p><img alt="Fig. {number}, computed again" src="figure_{number}.png"></p>'
    yield "<h2>Peaks, levels and seconds</h2>"
    parts = list(runs.converged.curves.parts)
    head_row = ["", *(f"peak of {name}, ns" for name in parts), "secondary / primary", "s (processor)"]
    blank = "", ""
    rows = [["published, Fig. 7", *(f"{PEAKS_NS[name]:g}" if name in PEAKS_NS else "" for name in parts), *blank]]
    for (estimator, rays, scheme), case in runs.cases.items():
        counts = f"{rays}×{rays}×{pixels}×{pixels}, {scheme}" if rays else "simulate"
        # Light of a part that no ray of a coarse grid met was not measured; the converged primary misses no part.
        missing = "not measured: no ray met it" if estimator == "as printed" else "no light"
        peaks = [
            f"{peak_ns(curve, case.curves.time_ns):.1f}" if curve.any() else missing
            for curve in (case.curves.parts[name] for name in parts)
        ]
        level = "no primary"
        if case.level["primary"] > 0:
            level = f"{case.level['secondary'] / case.level['primary']:.3g}"
        published = PUBLISHED_SECONDS.get((rays, scheme), "") if pixels == 60 and estimator == "as printed" else ""
        took = f"{case.seconds:.2f} ({case.processor_s:.2f})" + f"; published: {published}" * bool(published)
        rows.append([f"{estimator}, {counts}", *peaks, level, took])
    yield table(head_row, rows)
    yield "</body></html>"


def peak_ns(curve: Floats, time_ns: Floats) -> float:
    """Time of the highest bin; NaN for no light."""
    return float(time_ns[int(np.argmax(curve))]) if curve.any() else float("nan")


def _numbers(runs: Runs, command: str) -> dict[str, Any]:
    """Levels, seconds and curves as plain values; what is not a number becomes null."""

    def six_digits(curve: Floats) -> list[float]:
        return [float(f"{number:.6g}") for number in curve]

    def plain(case: Simulation) -> dict[str, Any]:
        curves = {**case.curves.parts, "secondary": case.curves.orders["secondary"]}
        found = {"level": case.level, "seconds": case.seconds, "processor_s": case.processor_s}
        return {**found, "curves": {name: six_digits(curve) for name, curve in curves.items()}}

    found = {
        "made_by": MADE_BY,
        "command": command,
        "processor": processor(),
        "config": runs.config.model_dump(mode="json"),
        "sizes": asdict(runs.sizes),
        "published": {
            "peaks_ns": PEAKS_NS,
            "seconds": {f"{rays}, {scheme}": text for (rays, scheme), text in PUBLISHED_SECONDS.items()},
        },
        "cases": {", ".join(map(str, key)): plain(case) for key, case in runs.cases.items()},
        "time_ns": six_digits(runs.converged.curves.time_ns),
    }
    return dict(finite(found))
