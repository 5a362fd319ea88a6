"""Random damage to logs and robots, held to the promise (benchmarks/fuzz_cases.py): a hundred cases.

`python -m benchmarks.fuzz --cases 10000` is the whole of it, for a change of what reads logs.
"""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]


def test_no_random_damage_breaks_the_promise(tmp_path: Path) -> None:
    environment = {k: v for k, v in os.environ.items() if k != "LOCFUSE_DATA"}  # real logs take longer
    done = subprocess.run(
        [sys.executable, "-m", "benchmarks.fuzz", "--cases", "100", "--keep", str(tmp_path)],
        cwd=ROOT,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr[-2000:]
    assert "100 cases, 0 failed" in done.stdout
