"""Configurations with random mistakes: each is either read, or refused in one line."""

from __future__ import annotations

import copy
from pathlib import Path
from typing import Any

from fuzz_profile import fuzzed, st

from datagen.building.input_check import check_inputs
from datagen.config import config_from_mapping
from datagen.config.yaml_text import parse_yaml
from datagen.errors import InputError

CONFIGS = Path(__file__).resolve().parents[2] / "configs"
READY = [
    parse_yaml(path.read_text(encoding="utf-8"), str(path))
    for path in sorted(CONFIGS.glob("*.yaml"))
    if "mesh" not in path.stem
]

wrong_values = st.one_of(
    st.none(),
    st.booleans(),
    st.sampled_from(["", "x", "uniform", "l_corridor", "free_running", [], {}, [[]], {"uniform": [1, 0]}]),
    st.sampled_from([{"uniform": [0, 1]}, {"choice": [1, "a"]}, {"uniform": 3}, {"normal": [0, -1]}, [1, 2, 3]]),
    st.integers(-3, 3),
    st.sampled_from([-1e300, -0.5, 0.0, 1e-300, 0.5, 1e6, 1e300, 2**31, 2**63, 10**30]),
)


def places(value: Any, at: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    """Paths of all keys and list entries."""
    items = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    return [p for k, v in items for p in ((*at, k), *places(v, (*at, k)))]


@st.composite
def mutated(draw: st.DrawFn) -> dict[str, Any]:
    """A ready configuration with one to three keys changed, removed, renamed, doubled or exchanged."""
    config = copy.deepcopy(draw(st.sampled_from(READY)))
    for _ in range(draw(st.integers(1, 3))):
        *way, last = draw(st.sampled_from(places(config)))
        parent: Any = config
        for key in way:
            parent = parent[key]
        change = draw(st.sampled_from(["set", "set", "set", "remove", "rename", "scale", "graft"]))
        if change == "set":
            parent[last] = copy.deepcopy(draw(wrong_values))
        elif change == "scale" and isinstance(parent[last], (int, float)):
            parent[last] *= draw(st.sampled_from([-1, 0, 1e-9, 0.5, 7, 1e9]))
        elif change == "graft":
            other = draw(st.sampled_from(READY))
            *far, end = draw(st.sampled_from(places(other)))
            value: Any = other
            for key in (*far, end):
                value = value[key]
            parent[last] = copy.deepcopy(value)
        elif change == "remove":
            del parent[last]
        elif change == "rename" and isinstance(parent, dict):
            parent[str(last) + "_"] = parent.pop(last)
        if not places(config):
            break
    return config


def refusal(call: Any, *arguments: Any) -> InputError | None:
    """None for success. Whatever else is raised fails the test."""
    try:
        call(*arguments)
    except InputError as error:
        assert str(error) and "\n" not in str(error), f"not one line: {error}"
        return error
    return None


@fuzzed(150, 3000, mutated())
def test_mistakes_are_told_in_one_line(values: dict[str, Any]) -> None:
    refusal(config_from_mapping, values, "config.yaml")


@fuzzed(12, 150, mutated())
def test_what_is_read_can_be_checked_against_a_scene(values: dict[str, Any]) -> None:
    """`plan` and `build` begin with `check_inputs`: a trial room, its capture, its detector."""
    if refusal(config_from_mapping, values, "config.yaml") is None:
        config = config_from_mapping(values, "config.yaml")
        lasers, pixels, bins = config.capture.shape
        if lasers * pixels * bins < 10**7:
            refusal(check_inputs, config)
