"""The examples in the docstrings of the public names, run."""

from __future__ import annotations

import doctest
from pathlib import Path

import pytest

import datagen

pytestmark = pytest.mark.usefixtures("builds_here")

EXAMPLES = {
    name: tests
    for name in datagen.__all__
    if getattr(getattr(datagen, name), "__doc__", None)
    and (
        tests := [
            test
            for test in doctest.DocTestFinder(recurse=False).find(getattr(datagen, name), name, globs={})
            if test.examples
        ]
    )
}


@pytest.mark.parametrize("name", EXAMPLES)
def test_examples_give_what_they_say(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """From the repository's root, as a reader would; what they write is in temporary folders."""
    monkeypatch.chdir(Path(__file__).parents[1])
    for test in EXAMPLES[name]:
        printed: list[str] = []
        runner = doctest.DocTestRunner(optionflags=doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE)
        assert runner.run(test, out=printed.append).failed == 0, "".join(printed)
