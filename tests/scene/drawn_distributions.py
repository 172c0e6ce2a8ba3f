"""Draw very many rooms and test whether every number in them is distributed as it was declared.

    python tests/scene/drawn_distributions.py --scenes 10000

Kolmogorov–Smirnov for continuous distributions, χ² for choices, counts, classes and materials; over all parameters of
all layouts together Holm's step-down holds the family-wise level. Ends with status 1 when one departs.

`redrawn` is the share of scenes for which a whole room was given up and drawn again. Only these can differ from what
was declared, so it bounds the total variation distance between the two.
"""

from __future__ import annotations

import argparse
import sys

import numpy as np
from declared_draws import FAMILIES, declared_spec, draws_of
from random_specs import LAYOUTS

from datagen.records import Scene
from datagen.scene import generate_scene

LEVEL = 1e-3


def p_values_of(kind: str, families: range, scenes: int, seed: int) -> tuple[dict[str, float], list[Scene]]:
    """p-value of every parameter under every family of distributions, each with `scenes` rooms; and the rooms."""
    p_values: dict[str, float] = {}
    rooms: list[Scene] = []
    for family in families:
        spec = declared_spec(kind, family)
        drawn = [generate_scene(spec, seed + family, index) for index in range(scenes)]
        p_values |= {f"{kind}/{family}/{name}": d.p_value() for name, d in draws_of(spec, drawn).items()}
        rooms += drawn
    return p_values, rooms


def departures(p_values: dict[str, float], level: float = LEVEL) -> list[str]:
    """Names refused at a family-wise level (Holm 1979)."""
    refused = []
    for rank, name in enumerate(sorted(p_values, key=p_values.__getitem__)):
        if p_values[name] > level / (len(p_values) - rank):
            break
        refused.append(name)
    return refused


def redrawn_share(rooms: list[Scene]) -> float:
    return float(np.mean([room.parameters["draws"] > 1 for room in rooms]))


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenes", type=int, default=10_000, help="rooms for each layout")
    parser.add_argument("--seed", type=int, default=7)
    parser.add_argument("--layout", choices=LAYOUTS, action="append", help="only this layout; may be repeated")
    arguments = parser.parse_args()
    everything: dict[str, float] = {}
    print("| layout | rooms | parameters tested | smallest p | redrawn |\n|---|---:|---:|---:|---:|", flush=True)
    for kind in arguments.layout or LAYOUTS:
        p_values, rooms = p_values_of(kind, range(FAMILIES), arguments.scenes // FAMILIES, arguments.seed)
        everything |= p_values
        row = f"{len(rooms)} | {len(p_values)} | {min(p_values.values()):.1e} | {redrawn_share(rooms):.2%}"
        print(f"| {kind} | {row} |", flush=True)
    refused = departures(everything)
    told = ", ".join(f"{name} (p = {everything[name]:.1e})" for name in refused) or "none departs"
    print(f"{len(everything)} tests at the family-wise level {LEVEL:g} (Holm): {told}")
    return 1 if refused else 0


if __name__ == "__main__":
    sys.exit(main())
