"""Seconds a scene of every device: in a default room, before the relay wall, and before an object; in full.

    python tests/benchmarks/devices.py [--scenes 8] [DEVICE …]
    python tests/benchmarks/devices.py --windows       # windows that end before, at and after the first light

A scene is all that a build makes of one, in processor seconds of one core, with the default accuracy target. In the
scenes counted as outside 90 % of the light or more misses the device's time axis; to find none has to end, too.

Windows are those of scans and floods in default rooms, cut off at a bin: seconds of the light alone, its shadow rays,
and the error claimed, in percent of the light that falls into the window; none where it is
known that none does, and not known where none was met.
"""

from __future__ import annotations

import argparse
import math
import statistics
import time
import warnings
from collections.abc import Sequence
from dataclasses import replace

import datagen as dg
from datagen.bench.measuring import machine, markdown
from datagen.config import config_from_mapping
from datagen.devices import device_names
from datagen.errors import InputWarning
from datagen.pipeline import simulate_sample
from datagen.store.summaries import MISSED

PLACES = {"default room": {}, "before an object": {"at_objects": {}}}
HEADER = ["device", *(f"{place}, {what}" for place in PLACES for what in ("median s", "longest s", "outside"))]


def measured(name: str, scenes: int) -> list[str]:
    """The cells of a device: its name, and seconds and scenes outside of its window, in each place."""
    row = [f"`{name}`"]
    for place in PLACES.values():
        config = config_from_mapping({"seed": 4, "capture": {"device": name} | place})
        if place and config.capture.illumination != "flood":
            # A device that scans has its light on the relay wall.
            row += ["–", "–", "–"]
            continue
        simulate_sample(config, 0)
        seconds, outside = [], 0
        for index in range(scenes):
            began = time.process_time()
            sample = simulate_sample(config, index)
            seconds.append(time.process_time() - began)
            outside += bool(sample.parameters["transient.overflow"] >= MISSED)
        row += [f"{statistics.median(seconds):.2g}", f"{max(seconds):.2g}", f"{outside} of {scenes}"]
    return row


WINDOWS = {"ends before": -2, "has the first bin": 1, "two": 2, "eight": 8, "all": 0}
"""Bins of a window from the first with light on, by what it has; all where there is no number."""
CAPTURES: dict[str, dict[str, str]] = {"scan, 16 × 16": {}, "`phone_dots`": {"device": "phone_dots"}}
"""What is cut off, by its name."""


def of_windows(name: str, scenes: int) -> list[list[str]]:
    """Rows of a capture: what the window has, median and longest seconds, million rays, errors claimed."""
    config = config_from_mapping({"seed": 4, "capture": CAPTURES[name]})
    rows = {what: list[tuple[float, float, float]]() for what in WINDOWS}
    for index in range(scenes):
        scene = dg.scene_for(config, index)
        capture, accuracy = dg.capture_for(config, scene, config.seed, index), dg.Accuracy(target=0.02, max_bounces=3)
        lit = dg.simulate(scene, capture, accuracy, seed=index).total.any(axis=(0, 1))
        for what, more in WINDOWS.items():
            bins = max(int(lit.argmax()) + more, 1) if more else len(lit)
            cut = replace(capture, time=replace(capture.time, bins=bins))
            began = time.process_time()
            with warnings.catch_warnings(action="ignore", category=InputWarning):
                found = dg.simulate(scene, cut, accuracy, seed=index)
            rows[what].append((time.process_time() - began, sum(found.rays.values()) / 1e6, found.relative_error))
    cells = []
    for what, of in rows.items():
        seconds, rays, errors = (list(values) for values in zip(*of, strict=True))
        known = [100 * error for error in errors if error > 0]
        told = [f"{min(known):.2g} … {max(known):.2g}"] if known else []
        told += [f"{errors.count(0.0)} none"] if 0.0 in errors else []
        told += [f"{sum(map(math.isnan, errors))} not known"] if any(map(math.isnan, errors)) else []
        cells.append(
            [name, what, *(f"{of(values):.2g}" for of, values in
             ((statistics.median, seconds), (max, seconds), (statistics.median, rays))), ", ".join(told)]
        )  # fmt: skip
    return cells


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("devices", nargs="*", default=device_names())
    parser.add_argument("--scenes", type=int, default=8)
    parser.add_argument("--windows", action="store_true")
    given = parser.parse_args(arguments)
    print(machine(), "\n")
    if given.windows:
        header = ["capture", "window", "median s", "longest s", "million rays", "claimed, %"]
        print(markdown(header, [row for name in CAPTURES for row in of_windows(name, given.scenes)]))
        return
    # Row by row: all devices take minutes.
    print(markdown(HEADER, []))
    for name in given.devices:
        print(markdown(HEADER, [measured(name, given.scenes)]).splitlines()[-1], flush=True)


if __name__ == "__main__":
    main()
