"""A sample of the parsers' fuzzer: python -m benchmarks.fuzz_parsers --seconds 240 is the hour."""

from __future__ import annotations

import pytest

from benchmarks.fuzz_parsers import TARGETS, Target, fuzz, wrong


@pytest.mark.parametrize("name", TARGETS)
def test_a_parser_refuses_damaged_input_in_its_own_words(name: str) -> None:
    n, problems = fuzz(name, seed=1, seconds=0.3, save=None)
    assert problems == []
    assert n > 50


@pytest.mark.parametrize("name", TARGETS)
def test_every_input_that_the_fuzzer_starts_from_is_read(name: str) -> None:
    assert [wrong(TARGETS[name], data) for data in TARGETS[name].corpus] == [None] * len(TARGETS[name].corpus)


def test_the_fuzzer_sees_a_parser_that_breaks() -> None:
    broken = Target(lambda data: data[10**9], (b"a",), (b"a",), ())
    assert "IndexError" in str(wrong(broken, b"a"))
