"""YAML: safe, strict, and errors that name the place."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from jsonschema import Draft202012Validator

from datagen.config import json_schema, load_config
from datagen.config.yaml_text import parse_yaml
from datagen.errors import InputError

CONFIGS = Path(__file__).resolve().parents[2] / "configs"


def test_numbers_are_those_of_yaml_1_2() -> None:
    for text in ("1e6", "1E+6", "1.0e6", "+1e6", "1000000.0"):
        assert parse_yaml(f"value: {text}", "x") == {"value": 1e6}


def test_merge_keys_stand_for_what_they_name() -> None:
    """Own keys go before merged ones, and the first mapping of a list before the next."""
    text = "x: &x {a: 1, b: 1}\ny: &y {b: 2, c: 2}\nz: {<<: [*x, *y], a: 3}\nw: {c: 4, <<: *y}\n"
    text += "u: {v: &v {<<: *x, b: 5}, <<: *v}"
    assert parse_yaml(text, "x")["z"] == {"a": 3, "b": 1, "c": 2}
    assert parse_yaml(text, "x")["w"] == {"b": 2, "c": 4}
    assert parse_yaml(text, "x")["u"] == {"v": {"a": 1, "b": 5}, "a": 1, "b": 5}


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("a: [1, 2", "line"),
        ("a: 1\na: 2", "stands twice"),
        ("- 1\n- 2", "a list found"),
        ("", "nothing found"),
        ("just words", "a str found"),
        ("1: 2", "is not text"),
        ("a: !!python/object/apply:os.system ['true']", "broken YAML"),
        ("\tb: 1", "line 1"),
        ("a: {<<: 3}", "line 1, column 9: broken YAML: expected a mapping"),
        ("a: &x {<<: *x}", "aliases make it hold"),
        ("x: &x {b: 1}\na: {<<: *x, b: 2, b: 3}", "stands twice"),
    ],
)
def test_broken_yaml_is_one_line_with_its_place(text: str, words: str, tmp_path: Path) -> None:
    path = tmp_path / "c.yaml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(InputError) as caught:
        load_config(path)
    source, message = str(caught.value).split(": ", 1)
    assert source == str(path) and words in message and "\n" not in message


def test_not_text_and_not_a_file(tmp_path: Path) -> None:
    (tmp_path / "b.yaml").write_bytes(b"\xff\xfe\x00a")
    for path, words in ((tmp_path / "b.yaml", "UTF-8"), (tmp_path, "directory"), (tmp_path / "none.yaml", "no such")):
        with pytest.raises(InputError, match=words):
            load_config(path)


def test_the_published_schema_accepts_and_refuses_what_the_program_does() -> None:
    """What editors check with `configs/schema.json`; that the program accepts ready configurations is tested where
    they are built."""
    Draft202012Validator.check_schema(json_schema())
    validator = Draft202012Validator(json_schema())
    for path in sorted(CONFIGS.glob("*.yaml")):
        values = parse_yaml(path.read_text(encoding="utf-8"), str(path))
        validator.validate(json.loads(json.dumps(values)))
    for bad in ({"scenes": 0}, {"capture": {"scan": {"rows": "x"}}}, {"unknown": 1}):
        assert not validator.is_valid(bad)
