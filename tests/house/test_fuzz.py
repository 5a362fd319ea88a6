"""Random damage to logs and robots, and to what a drive is located by, held to the promise.

`python -m benchmarks.fuzz --cases 10000` is the whole of it, for a change of what reads logs.
"""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


@pytest.mark.parametrize(
    ("cases", "words"),
    [
        (60, ()),
        (20, ("--directed", "--deeds", "map_pictures,line_maps,detection_files,odd_numbers")),
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
