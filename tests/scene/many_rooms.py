"""Draw rooms from very many random settings and hold each against every law.

    python tests/scene/many_rooms.py --specs 10000

takes hours for all layouts on one core; `--layout` and `--first` split the work. Ends with status 1 on a violation.
"""

from __future__ import annotations

import argparse
import sys
import time

import numpy as np
from random_specs import LAYOUTS, random_spec
from room_laws import assert_room_laws, object_names

from datagen.errors import InputError
from datagen.scene import generate_scene


def check_rooms(kind: str, specs: range, seed: int) -> tuple[int, float, float]:
    """(rooms drawn, smallest share of sight lines to an object, generation CPU seconds); raises on a violation.

    Settings that ask for too much are counted out, and must say so with a remedy.
    """
    met, least_seen, seconds = 0, 1.0, 0.0
    for number in specs:
        rng = np.random.default_rng([seed, number])
        spec = random_spec(rng, kind)
        start = time.process_time()
        try:
            scene = generate_scene(spec, seed=seed, index=number)
        except InputError as error:
            assert "no room met the constraints" in str(error)
            assert "lower" in str(error) or "raise" in str(error)
            continue
        finally:
            seconds += time.process_time() - start
        try:
            assert_room_laws(scene, rng)
        except AssertionError as error:
            raise AssertionError(f"{kind}, settings {seed}/{number}: {error}") from error
        met += 1
        least_seen = min([least_seen, *(float(scene.parameters[f"{n}.seen_fraction"]) for n in object_names(scene))])
    return met, least_seen, seconds


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--specs", type=int, default=10_000, help="random settings for each layout")
    parser.add_argument("--first", type=int, default=0, help="number of the first one")
    parser.add_argument("--layout", choices=LAYOUTS, action="append", help="only this layout; may be repeated")
    arguments = parser.parse_args()
    status = 0
    for kind in arguments.layout or LAYOUTS:
        try:
            met, seen, seconds = check_rooms(kind, range(arguments.first, arguments.first + arguments.specs), seed=99)
        except AssertionError as violation:
            print(violation)
            status = 1
            continue
        rate = arguments.specs / seconds
        print(
            f"{kind:18s} {met} of {arguments.specs} settings gave lawful rooms, the others their reason; "
            f"{rate:.0f} scenes/s; least seen {seen:.3f}",
            flush=True,
        )
    return status


if __name__ == "__main__":
    sys.exit(main())
