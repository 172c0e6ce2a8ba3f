"""Declared distributions are the ones drawn; a range that cannot be is refused with the reason."""

from __future__ import annotations

import json

import numpy as np
import pytest
from scipy import stats

from datagen.config import DatasetConfig, config_from_mapping
from datagen.config.distributions import draw, support
from datagen.errors import InputError


def height(value: object) -> object:
    """The box's height of a configuration that declares `value` for it."""
    contents = [{"kind": "box", "height_m": value}]
    return config_from_mapping({"scene": {"contents": contents}}).scene.contents[0].height_m  # type: ignore[union-attr]


@pytest.mark.parametrize(
    ("declared", "law"),
    [
        ({"uniform": [0.3, 1.1]}, stats.uniform(0.3, 0.8)),
        ({"log_uniform": [0.1, 1.5]}, stats.loguniform(0.1, 1.5)),
        (
            {"normal": {"mean": 0.8, "std": 0.3, "low": 0.5, "high": 1.6}},
            stats.truncnorm((0.5 - 0.8) / 0.3, (1.6 - 0.8) / 0.3, 0.8, 0.3),
        ),
    ],
)
def test_continuous_draws_follow_the_declared_law(declared: dict, law: object) -> None:
    """Kolmogorov–Smirnov on 5000 draws, level 10⁻³ over the three laws."""
    distribution = height(declared)
    rng = np.random.default_rng(5)
    values = [draw(distribution, rng) for _ in range(5_000)]  # type: ignore[arg-type]
    assert stats.kstest(values, law.cdf).pvalue > 1e-3 / 3  # type: ignore[attr-defined]
    low, high = support(distribution)  # type: ignore[arg-type]
    assert low <= min(values) <= max(values) <= high


def test_choice_follows_its_weights_and_a_constant_draws_nothing() -> None:
    distribution = height({"choice": [0.2, 0.5, 0.9], "weights": [2, 0, 1]})
    rng = np.random.default_rng(5)
    values = np.array([draw(distribution, rng) for _ in range(9000)])  # type: ignore[arg-type]
    assert stats.chisquare([np.sum(values == 0.2), np.sum(values == 0.9)], [6000, 3000]).pvalue > 1e-3
    assert not (values == 0.5).any()
    before = rng.bit_generator.state
    assert draw(height(0.7), rng) == 0.7  # type: ignore[arg-type]
    assert rng.bit_generator.state == before


@pytest.mark.parametrize(
    ("value", "words"),
    [
        ({"uniform": [1.0, 0.5]}, "upside down"),
        ({"log_uniform": [0.0, 1.0]}, "must be > 0"),
        ({"normal": {"mean": 0.5, "std": 0.0, "low": 0, "high": 1}}, "greater than 0"),
        ({"choice": [0.5], "weights": [1, 2]}, "1 weights"),
        ({"uniform": [-1.0, 0.5]}, "must be > 0"),
        ({"unifrm": [0.5, 1.0]}, "uniform"),
        ({"uniform": [0.5]}, "height_m.uniform"),
        ("tall", "a number is needed"),
        (True, "a number is needed"),
    ],
)
def test_what_cannot_be_drawn_is_refused_in_one_line(value: object, words: str) -> None:
    with pytest.raises(InputError) as caught:
        height(value)
    message = str(caught.value)
    assert "scene.contents[0].height_m" in message and words in message.lower() and "\n" not in message


def test_a_configuration_survives_its_own_dump_and_has_a_fingerprint() -> None:
    box = {"kind": "box", "height_m": {"log_uniform": [0.1, 1.5]}, "material": ["pine_wood"], "distance_m": 1.0}
    scene = {
        "layout": {"kind": "isolated_wall", "place": "in_front"}, "contents": [box],
        "materials": {"walls": {"material": ["concrete"]}},
    }  # fmt: skip
    config = config_from_mapping({"scene": scene, "transport": {"target": 0.1}})
    for again in (
        config_from_mapping(json.loads(config.model_dump_json())),
        DatasetConfig.model_validate_json(config.model_dump_json()),
    ):
        assert again == config and again.fingerprint() == config.fingerprint()
    base = config_from_mapping({})
    other = config_from_mapping({"name": "other", "description": "words", "scenes": 7})
    assert other.fingerprint() == base.fingerprint()
    assert config_from_mapping({"seed": 1}).fingerprint() != base.fingerprint()
    assert config_from_mapping({"transport": {"samples": 999}}).fingerprint() != base.fingerprint()
