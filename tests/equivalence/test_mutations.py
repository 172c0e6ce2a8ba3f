"""The table of `tools/mutations.py` keeps up with the sources: each fault finds the text that it changes, and the
test that is about it exists."""

from __future__ import annotations

import pytest
from tools.mutations import BESIDE, MUTATIONS, ROOT, TESTS, Mutation


@pytest.mark.parametrize("mutation", MUTATIONS, ids=lambda mutation: mutation.name)
def test_a_mutation_finds_its_text_once_and_its_test(mutation: Mutation) -> None:
    source = (ROOT / mutation.path).read_text()
    mutated = mutation.mutated(source)
    assert mutated != source
    compile(mutated, mutation.module, "exec")
    file, _, function = mutation.law.partition("::")
    assert file in (*TESTS, *BESIDE)
    assert f"\ndef {function.partition('[')[0]}(" in (ROOT / file).read_text()


def test_names_are_different_and_files_exist() -> None:
    assert len({mutation.name for mutation in MUTATIONS}) == len(MUTATIONS)
    assert all((ROOT / file).is_file() for file in (*TESTS, *BESIDE))


def test_a_text_that_is_gone_or_came_twice_is_said() -> None:
    mutation = MUTATIONS[0]
    for source, times in (("", 0), (2 * mutation.before, 2)):
        with pytest.raises(ValueError, match=f"found {times} times"):
            mutation.mutated(source)
