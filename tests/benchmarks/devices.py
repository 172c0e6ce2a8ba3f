"""Seconds a scene of every device: in a default room, before the relay wall, and before an object; in full.

    python tests/benchmarks/devices.py [--scenes 8] [DEVICE …]

A scene is all that a build makes of one, in processor seconds of one core, with the default accuracy target. In the
scenes counted as outside 90 % of the light or more misses the device's time axis; to find none has to end, too.
"""

from __future__ import annotations

import argparse
import statistics
import time
from collections.abc import Sequence

from datagen.bench.measuring import machine, markdown
from datagen.config import config_from_mapping
from datagen.devices import device_names
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


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("devices", nargs="*", default=device_names())
    parser.add_argument("--scenes", type=int, default=8)
    given = parser.parse_args(arguments)
    print(machine(), "\n")
    # Row by row: all devices take minutes.
    print(markdown(HEADER, []))
    for name in given.devices:
        print(markdown(HEADER, [measured(name, given.scenes)]).splitlines()[-1], flush=True)


if __name__ == "__main__":
    main()
