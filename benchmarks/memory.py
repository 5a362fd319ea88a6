"""Peak memory on a long log: python -m benchmarks.memory --megabytes 1000 (goal: at most 250 MB).

Generates a log of about that size with benchmarks/make_log.py (wheels, compass, laser, truth, pictures) and runs
`locfuse run` and `locfuse compare` over it. Needs the size on disk.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from pathlib import Path

import click

from benchmarks.process import cost

GOAL = 250.0  # MB
PER_MINUTE = 42.0  # MB of log with the options below
OPTIONS = ("--image-hz", "10", "--beams", "1081", "--scan-hz", "25", "--compression", "none")


@click.command()
@click.option("--megabytes", default=1000.0, show_default=True)
@click.option("--folder", type=click.Path(file_okay=False, path_type=Path), help="Where the log is made.")
def main(megabytes: float, folder: Path | None) -> None:
    """Print size of the log, peak memory and time of either command; exit 1 over the goal."""
    with tempfile.TemporaryDirectory(dir=folder) as temporary:
        log = Path(temporary) / "long.mcap"
        minutes = ("--minutes", f"{megabytes / PER_MINUTE:g}")
        subprocess.run([sys.executable, "-m", "benchmarks.make_log", str(log), *minutes, *OPTIONS], check=True)
        size = log.stat().st_size / 1e6
        worst = 0.0
        for command in ("run", "compare"):
            spent = cost([sys.executable, "-m", "locfuse.cli", command, str(log), "-o", f"{temporary}/{command}"])
            worst = max(worst, spent.peak)
            click.echo(f"{command}: log {size:.0f} MB, peak {spent.peak:.0f} MB, CPU {spent.cpu:.1f} s")
    raise SystemExit(1 if worst > GOAL else 0)


if __name__ == "__main__":
    main()
