"""What a command imports, by package: python -m benchmarks.imports.

Runs commands on a sample log under `python -X importtime` and prints a markdown table: milliseconds that the
modules of a package take themselves, each the least of the rounds, and how many modules that are.
"""

from __future__ import annotations

import re
import subprocess
import sys
import tempfile
from collections.abc import Sequence

import click

LINE = re.compile(r"import time:\s+(\d+) \|\s+\d+ \|\s+(\S+)")
NAMED = ("locfuse", "numpy", "cv2", "rich", "rosbags", "click", "msgspec")  # the rest is "others"
LOG = "rounded_rectangle"


def imported(command: Sequence[str]) -> dict[str, float]:
    """Return the milliseconds that every module takes whose import a command of locfuse causes."""
    words = (sys.executable, "-X", "importtime", "-m", "locfuse.cli", *command)
    done = subprocess.run(words, check=True, capture_output=True, text=True)
    return {name: int(microseconds) / 1000.0 for microseconds, name in LINE.findall(done.stderr)}


def by_package(command: Sequence[str], rounds: int) -> dict[str, tuple[float, int]]:
    """Return milliseconds and modules of every package of NAMED, of the others, and of all."""
    least: dict[str, float] = {}
    for _ in range(rounds):
        for name, ms in imported(command).items():
            least[name] = min(ms, least.get(name, ms))
    found: dict[str, list[float]] = {name: [] for name in (*NAMED, "others")}
    for name, ms in least.items():
        package = name.partition(".")[0]
        found[package if package in NAMED else "others"].append(ms)
    rows = {name: (sum(ms), len(ms)) for name, ms in found.items()}
    return {**rows, "all": (sum(least.values()), len(least))}


@click.command()
@click.option("--rounds", default=8, show_default=True)
def main(rounds: int) -> None:
    """Print what `run`, `compare` and `info` import."""
    with tempfile.TemporaryDirectory() as folder:
        quiet = ("--no-advice", "--quiet", "--overwrite", "--write", "json", "--out", f"{folder}/out")
        commands = {
            "run --help": ("run", "--help"),
            "info": ("info", LOG),
            "run": ("run", LOG, *quiet),
            "compare": ("compare", LOG, *quiet),
        }
        columns = {name: by_package(command, rounds) for name, command in commands.items()}
    click.echo("| ms (modules) | " + " | ".join(f"`{name}`" for name in columns) + " |")
    click.echo("| --- |" + " ---: |" * len(columns))
    for package in (*NAMED, "others", "all"):
        cells = (f"{ms:.0f} ({n})" for ms, n in (column[package] for column in columns.values()))
        click.echo(f"| {package} | " + " | ".join(cells) + " |")


if __name__ == "__main__":
    main()
