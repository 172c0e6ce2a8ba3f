"""What is drawn is distributed as it was declared, whether it is easy to place or not."""

from __future__ import annotations

import numpy as np
import pytest
from declared_draws import Draws, declared_spec, draws_of
from drawn_distributions import LEVEL, departures, p_values_of, redrawn_share
from random_specs import LAYOUTS
from scipy import stats

import datagen.scene.generate
from datagen.config import SceneConfig, config_from_mapping
from datagen.config.distributions import Choice, LogUniform, Normal, NormalShape, Uniform
from datagen.scene import generate_scene


@pytest.mark.parametrize("scenes", [12, pytest.param(100, marks=pytest.mark.nightly)])
def test_every_declared_parameter_of_every_layout(scenes: int) -> None:
    """KS and χ² over all parameters of all layouts, family-wise level 1e-3 (Holm). `drawn_distributions.py` does the
    same with every family of distributions for every parameter, and as many rooms as one has time for.
    """
    p_values: dict[str, float] = {}
    for number, kind in enumerate(LAYOUTS):
        own, rooms = p_values_of(kind, range(number % 4, number % 4 + 1), scenes=scenes, seed=21)
        assert redrawn_share(rooms) < 0.1
        p_values |= own
    assert len(p_values) > 400
    assert departures(p_values) == []


def test_every_number_of_a_scene_is_tested() -> None:
    """No parameter that is declared is left out: what the test looks at covers every range in the settings."""
    spec = declared_spec("doorway_room", 1)
    tested_names = set(draws_of(spec, [generate_scene(spec, 3, i) for i in range(30)]))
    assert {f"layout.{name}" for name in spec.layout.dimensions()} <= tested_names
    assert {"layout.turn", "layout.out_of_square_deg", "relay_wall.relief_m", "relay_wall.length_m"} <= tested_names
    for item in spec.contents:
        wanted = {"count", *(name for name in item.sizes if getattr(item, name) is not None)}
        wanted |= {"material", "tint"} if item.material else {"albedo"}
        wanted |= {f"brdf.{name}" for name in type(item.brdf).model_fields if name != "kind"}
        wanted |= {"class"} if item.kind in ("library", "mesh_folder") else set()
        assert {f"{item.name}.{name}" for name in wanted} <= tested_names


RNG = np.random.default_rng(0)
FAITHFUL = {
    "uniform": Draws(list(RNG.uniform(1, 3, 2000)), Uniform(uniform=(1, 3))),
    "log": Draws(list(np.exp(RNG.uniform(0, np.log(5), 2000))), LogUniform(log_uniform=(1, 5))),
    "normal": Draws(
        list(stats.truncnorm(-1, 2, 0, 1).rvs(2000, random_state=RNG)),
        Normal(normal=NormalShape(mean=0, std=1, low=-1, high=2)),
    ),
    "choice": Draws(list(RNG.choice([1.0, 4.0], 2000, p=[0.2, 0.8])), Choice(choice=(1, 4), weights=(1, 4))),
    "class": Draws(list(RNG.choice(["a", "b"], 2000)), {"a": 0.5, "b": 0.5}),
}
SKEWED = {
    "uniform": Draws(list(3 - 2 * RNG.random(2000) ** 1.2), Uniform(uniform=(1, 3))),
    "log": Draws(list(RNG.uniform(1, 5, 2000)), LogUniform(log_uniform=(1, 5))),
    "normal": Draws(list(RNG.uniform(-1, 2, 2000)), Normal(normal=NormalShape(mean=0, std=1, low=-1, high=2))),
    "choice": Draws(list(RNG.choice([1.0, 4.0], 2000, p=[0.3, 0.7])), Choice(choice=(1, 4), weights=(1, 4))),
    "class": Draws(["a"] * 2000, {"a": 0.5, "b": 0.5}),
    "stranger": Draws(["c", *"ab" * 1000], {"a": 0.5, "b": 0.5}),
}


def test_departures_are_noticed_and_nothing_else() -> None:
    assert departures({name: draws.p_value() for name, draws in FAITHFUL.items()}) == []
    skewed = {name: draws.p_value() for name, draws in SKEWED.items()}
    assert sorted(departures(skewed)) == sorted(SKEWED)


def _tight() -> SceneConfig:
    """A hidden part in which large boxes find a place now and then, and small ones nearly always."""
    layout = {"kind": "l_corridor", "relay_distance_m": 6, "room_length_m": 2.7, "room_width_m": 3.6}
    box = {"kind": "box", "count": 2, "width_m": {"choice": [0.3, 1.8]}, "depth_m": 0.8, "height_m": 0.5}
    return config_from_mapping({"scene": {"layout": layout, "contents": [box]}}).scene


def _large_share(scenes: int) -> tuple[float, float]:
    """p-value of "large as often as small", and the share of rooms given up."""
    rooms = [generate_scene(_tight(), 5, index).parameters for index in range(scenes)]
    large = sum(room[f"{name}.width_m"] > 1 for room in rooms for name in ("box", "box_2"))
    return stats.binomtest(large, 2 * scenes, 0.5).pvalue, float(np.mean([room["draws"] > 1 for room in rooms]))


def test_what_is_hard_to_place_is_drawn_as_often_as_declared(monkeypatch: pytest.MonkeyPatch) -> None:
    """Regression: a room that failed used to be drawn again with all its objects, so that large ones were rarer."""
    p_value, redrawn = _large_share(100)
    assert redrawn < 0.1
    assert p_value > LEVEL
    monkeypatch.setattr(datagen.scene.generate, "placings", lambda max_attempts, draw_number: 1)
    p_value, redrawn = _large_share(100)
    assert redrawn > 0.2
    assert p_value < LEVEL


def test_tries_leave_most_of_them_for_rooms_drawn_anew() -> None:
    for most in (1, 2, 7, 20, 200, 100_000):
        kept = [datagen.scene.generate.placings(most, number) for number in range(100)]
        assert kept[0] == max(1, most // 8)
        assert kept == sorted(kept, reverse=True)
        assert kept[-1] == 1
        assert sum(k - 1 for k in kept) <= most / 4
