"""Draw rooms from very many random settings and hold each against every law.

    python tests/benchmarks/many_rooms.py --specs 10000

takes about ten minutes of one core for each layout; `--layout` and `--first` split the work. Prints one row of a
table for each layout. Ends with status 1 on a violation, after naming every one of them.
"""

from __future__ import annotations

import argparse
import sys
import time
from dataclasses import dataclass, field
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "scene"))

import numpy as np
from random_specs import random_spec
from room_laws import assert_as_declared, assert_moved_devices, assert_room_laws, object_names

from datagen.errors import InputError
from datagen.scene import generate_scene
from scene_library.layouts import LAYOUTS

REMEDIES = ("lower", "raise", "change", "enlarge", "widen", "remove", "set its placement")
MOVED_EVERY = 4
"""In one of so many rooms laser and sensor are moved too."""


@dataclass
class Tally:
    """What came of the settings of one layout.

    rooms, objects : how many. refused : settings without a room, each with its reason. redrawn : rooms before which
    another one was given up. moved : captures with laser and sensor elsewhere that were accepted.
    least_seen : smallest share of sight lines from the relay wall to an object. seconds : CPU time of generation.
    """

    rooms: int = 0
    objects: int = 0
    refused: int = 0
    redrawn: int = 0
    moved: int = 0
    least_seen: float = 1.0
    seconds: float = 0.0
    violations: list[str] = field(default_factory=list)

    def row(self, kind: str) -> str:
        rate = (self.rooms + self.refused) / max(self.seconds, 1e-9)
        counts = f"{self.rooms} | {self.objects} | {self.refused} | {self.redrawn} | {self.moved}"
        return f"| {kind} | {counts} | {self.least_seen:.3f} | {rate:.0f} | {len(self.violations)} |"


HEADER = (
    "| layout | rooms | objects | refused with a reason | redrawn | devices moved | least seen | settings/s | "
    "violations |\n|---|---:|---:|---:|---:|---:|---:|---:|---:|"
)


def check_rooms(kind: str, specs: range, seed: int) -> Tally:
    """Draw a room for each of the random settings numbered `specs` and hold it against the laws.

    Settings that ask for too much are counted out, and must say so in one line with a remedy.
    """
    tally = Tally()
    for number in specs:
        rng = np.random.default_rng([seed, number])
        spec = random_spec(rng, kind)
        start = time.process_time()
        try:
            scene = generate_scene(spec, seed=seed, index=number)
        except InputError as error:
            scene, message = None, str(error)
        tally.seconds += time.process_time() - start
        try:
            if scene is None:
                assert f"scene {number} (seed {seed}): no room met the constraints" in message, message
                assert any(word in message for word in REMEDIES), message
                assert "\n" not in message
                tally.refused += 1
                continue
            assert_room_laws(scene, rng, spec.clearance_m)
            assert_as_declared(spec, scene)
            if number % MOVED_EVERY == 0:
                tally.moved += assert_moved_devices(scene, rng)
        except AssertionError as error:
            tally.violations.append(f"{kind}, settings {seed}/{number}: {error}")
        tally.rooms += 1
        tally.objects += scene.parameters["objects"]
        tally.redrawn += scene.parameters["draws"] > 1
        seen = [float(scene.parameters[f"{name}.seen_fraction"]) for name in object_names(scene)]
        tally.least_seen = min([tally.least_seen, *seen])
    return tally


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--specs", type=int, default=10_000, help="random settings for each layout")
    parser.add_argument("--first", type=int, default=0, help="number of the first one")
    parser.add_argument("--seed", type=int, default=99)
    parser.add_argument("--layout", choices=LAYOUTS, action="append", help="only this layout; may be repeated")
    arguments = parser.parse_args()
    violations: list[str] = []
    print(HEADER, flush=True)
    for kind in arguments.layout or LAYOUTS:
        numbers = range(arguments.first, arguments.first + arguments.specs)
        tally = check_rooms(kind, numbers, arguments.seed)
        print(tally.row(kind), flush=True)
        violations += tally.violations
    print("\n".join(violations), end="\n" if violations else "")
    return 1 if violations else 0


if __name__ == "__main__":
    sys.exit(main())
