"""Random damage to logs and robots, held to the promise (benchmarks/fuzz_cases.py): a few hundred cases."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]


def test_no_random_damage_breaks_the_promise(tmp_path: Path) -> None:
    environment = {k: v for k, v in os.environ.items() if k != "LOCFUSE_DATA"}  # real logs take longer
    done = subprocess.run(
        [sys.executable, "-m", "benchmarks.fuzz", "--cases", "300", "--keep", str(tmp_path)],
        cwd=ROOT,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr[-2000:]
    assert "300 cases, 0 failed" in done.stdout
