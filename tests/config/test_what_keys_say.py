"""What the description of a key says of its value when it is left out is what it is then."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

import datagen as dg
from datagen.config import config_from_mapping, json_schema
from datagen.detector import detector_for

LEFT_OUT = re.compile(r"[Ll]eft out: ([\w.]+)")
WORDS = {"none": (0.0, None), "always": (None,), "all": ((), None, 0.0), "one": (None,), "counters": (None,)}


def described() -> Iterator[tuple[str, str, Any, str]]:
    """(section, key, default, text) of every key of a configuration."""
    schema = json_schema()
    for section, of in {"": schema, **schema["$defs"]}.items():
        for key, about in of.get("properties", {}).items():
            yield section, key, about.get("default"), " ".join(about.get("description", "").split())


def test_flags_say_their_default() -> None:
    """A flag whose text says when it is true is false otherwise, and the other way round."""
    flags = [(section, key, default, text) for section, key, default, text in described() if default in (True, False)]
    flags = [flag for flag in flags if isinstance(flag[2], bool)]
    assert len(flags) > 5
    for section, key, default, text in flags:
        said = re.search(r"^(?:.*\. )?(True|False) unless|left out: (true|false)", text)
        if said:
            assert (said[1] or said[2]).lower() == str(default).lower(), f"{section}.{key} = {default}: {text}"


def test_direct_light_is_what_its_text_says() -> None:
    (text,) = [text for section, key, _, text in described() if (section, key) == ("TransportConfig", "direct")]
    assert "true unless it is given" in text and "With a `capture.device` that lights all at once" in text
    for capture, transport, due in (
        ({}, {}, False),
        ({}, {"direct": True}, True),
        ({"device": "tmf8820"}, {}, True),
        ({"device": "tmf8820"}, {"direct": False}, False),
    ):
        assert config_from_mapping({"capture": capture, "transport": transport}).transport.direct is due


def test_numbers_of_the_detector_are_those_its_texts_say() -> None:
    spad = detector_for(config_from_mapping({"detector": {"mode": "free_running"}}).detector, seed=0, index=0)[0]
    compared = 0
    for section, key, default, text in described():
        said = LEFT_OUT.search(text)
        if section != "DetectorConfig" or default is not None or said is None:
            continue
        for unit, factor in (("_ns", 1e-9), ("_ps", 1e-12), ("", 1.0)):
            name = key.removesuffix(unit) + ("_s" if unit else "")
            if key.endswith(unit) and hasattr(spad, name):
                now, word = getattr(spad, name), said[1].rstrip(".")
                allowed = WORDS.get(word) or (pytest.approx(float(word) * factor),)
                assert now in allowed, f"detector.{key}: {now}, and its text says {word}"
                compared += 1
                break
    assert compared >= 8


def test_a_claimed_error_is_an_estimate_by_name() -> None:
    """The former name works, and warns."""
    from datagen.store.table import COLUMNS

    assert "estimate" in COLUMNS["transient.relative_error"] and "upper" not in " ".join(COLUMNS.values())
    time, light = dg.TimeAxis(bins=4, width_s=1e-9), np.ones((1, 1, 4))
    given: dict[str, Any] = {"time": time, "components": {"primary": light}, "parts": {}, "stderr": 0 * light}
    given |= {"overflow": np.zeros((1, 1)), "laser_points": np.zeros((1, 3))}
    assert dg.Transient(**given).claimed_error is None
    with pytest.warns(FutureWarning, match="its name is claimed_error"):
        made = dg.Transient(**given, error_bound=0.25)
    assert made.claimed_error == made.relative_error == dg.Transient(**given, claimed_error=0.25).claimed_error
    with pytest.warns(FutureWarning, match="its name is claimed_error"):
        assert made.error_bound == 0.25
