"""Random damage to logs and robots, and to what a drive is located by, held to the promise.

`python -m benchmarks.fuzz --cases 10000` is the whole of it, for a change of what reads logs.
"""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from benchmarks.fuzz_parsers import PARSERS, corpus, fuzz_parser, wrong

ROOT = Path(__file__).parents[2]


@pytest.mark.parametrize(
    ("cases", "words"),
    [
        (30, ()),
        (20, ("--directed", "--deeds", "map_pictures,line_maps,detection_files,odd_values")),
    ],
)
def test_no_random_damage_breaks_the_promise(tmp_path: Path, cases: int, words: tuple[str, ...]) -> None:
    environment = {k: v for k, v in os.environ.items() if k != "LOCFUSE_DATA"}  # real logs take longer
    done = subprocess.run(
        [sys.executable, "-m", "benchmarks.fuzz", "--cases", f"{cases}", *words, "--keep", str(tmp_path)],
        cwd=ROOT,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr[-2000:]
    assert f"{cases} cases, 0 failed" in done.stdout
    assert all(f"{deed} " in done.stdout for word in words[2:] for deed in word.split(","))


# --- a sample of the parsers' fuzzer: python -m benchmarks.fuzz --parsers 240 is the hour


@pytest.mark.parametrize("name", PARSERS)
def test_a_parser_refuses_damaged_input_in_its_own_words(name: str) -> None:
    n, problems = fuzz_parser(name, seed=1, seconds=0.3)
    assert problems == {}
    assert n > 50


@pytest.mark.parametrize("name", PARSERS)
def test_every_input_that_the_fuzzer_starts_from_is_read(name: str) -> None:
    assert [wrong(PARSERS[name], data) for data in corpus(name)] == [""] * len(corpus(name))


def test_the_fuzzer_sees_a_parser_that_breaks() -> None:
    assert "IndexError" in wrong(lambda data: data[10**9], b"a")
