"""Tune the noise on one log, judge by another, and fail where that makes the robot worse: a nightly job.

    python examples/tune_and_gate.py rounded_triangle rounded_rectangle --sensors compass

Exit codes as those of locfuse: 0 the tuned settings are kept, 4 a gate failed.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
from pathlib import Path

import locfuse

GATES = {"position_rmse_m": 1.05, "heading_rmse_deg": 1.05}  # figure -> how much larger it may become
MAX_ANEES = 3.0  # 1 is right; an overconfident filter has more


def main() -> int:
    """Tune, judge, and say which gate failed."""
    words = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    words.add_argument("tune_on", help="a log of the robot; no truth is needed")
    words.add_argument("judge_by", help="another log of the same robot, with truth")
    words.add_argument("--sensors", default="all", help="what to tune and to judge, such as compass,lrf")
    words.add_argument("-o", "--out", type=Path, default=Path("tuned.toml"))
    asked = words.parse_args()
    tune = ["tune", asked.tune_on, "--sensors", asked.sensors, "-o", str(asked.out), "--overwrite", "-q"]
    subprocess.run([sys.executable, "-m", "locfuse", *tune], check=True, stdout=subprocess.DEVNULL)
    before = figures(asked.judge_by, asked.sensors, None)
    after = figures(asked.judge_by, asked.sensors, asked.out)
    failed = 0
    for figure in (*GATES, "anees"):
        limit = MAX_ANEES if figure == "anees" else before[figure] * GATES[figure]
        verdict = "ok" if after[figure] <= limit else "FAILED"
        failed += verdict == "FAILED"
        print(f"{figure}: {before[figure]:.3f} before, {after[figure]:.3f} after, limit {limit:.3f}: {verdict}")
    return 4 if failed else 0


def figures(log: str, sensors: str, robot: Path | None) -> dict[str, float]:
    """Return the figures of one configuration on a log with truth."""
    run = locfuse.load(log, robot=robot).run(sensors, advice=False)
    (judged,) = run.evaluations.values()
    return {name: value for name, value in judged.figures.items() if value is not None}


if __name__ == "__main__":
    sys.exit(main())
