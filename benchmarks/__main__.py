"""Speed as ratios against public packages: python -m benchmarks.

Generates its logs, runs every figure against its yardstick, taking turns, and prints a markdown table: medians,
the ratio's spread over the rounds, and the goal. CPU times of whole processes, wall times beside them: trust the
ratios. Run it from the repository's root. With LOCFUSE_DATA set, a recorded building is among them.
"""

from __future__ import annotations

import compileall
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import NamedTuple

import click

ROOT = Path(__file__).parent.parent
DATA = "LOCFUSE_DATA"  # where recorded logs are
Row = tuple[str, ...]
FAILED, UNKNOWN = ("failed", ""), ("", "", "no", "")
Command = tuple[str, ...]


class Cost(NamedTuple):
    """One run of one command."""

    cpu: float  # s, user and system, its children included
    wall: float  # s
    peak: float  # MB


def cost(command: Sequence[str]) -> Cost:
    """Run a command and return what it took. Raises RuntimeError with its last words where it fails."""
    begin = time.perf_counter()
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE) as process:
        assert process.stderr is not None
        words = process.stderr.read().decode(errors="replace").strip()
        _, status, usage = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode != 0:
        raise RuntimeError(f"{' '.join(command)}: exit {process.returncode}: {words[-400:]}")
    wall = time.perf_counter() - begin
    return Cost(usage.ru_utime + usage.ru_stime, wall, usage.ru_maxrss / 1024)


class Logs(NamedTuple):
    """The logs that figures are taken on."""

    minute: Path  # with pictures
    ten: Path  # ten minutes of compass and laser
    hour: Path
    building: Path | None = None  # a recorded one (aces), where LOCFUSE_DATA has it


class Figure(NamedTuple):
    """Two whole processes, ours and the yardstick, and the ratio of their CPU times that is the goal."""

    name: str
    goal: float
    ours: Command
    theirs: Command
    peak: float | None = None  # MB: our peak memory is a figure too


MINUTE = ("--minutes", "1", "--image-hz", "10")
TEN = ("--minutes", "10")
FROZEN = ("--set", "lrf.map=first-scan")


def module(name: str, *words: str | Path) -> Command:
    """Return the command that runs a module of this folder."""
    return (sys.executable, "-m", f"benchmarks.{name}", *map(str, words))


def locfuse(*words: str | Path) -> Command:
    """Return a command line of the product."""
    return (sys.executable, "-m", "locfuse.cli", *map(str, words))


def figures(logs: Logs, out: Path, length: str) -> list[Figure]:
    """Return what is measured in whole processes; `length` is that of the long log, in words."""
    advised = ("--write", "json", "--quiet", "--overwrite", "--no-smooth", "--out", out)
    how = (*advised, "--no-advice")  # how often advice fuses again depends on what looks wrong with the log
    stock, stock_minute = decoded(logs.hour), decoded(logs.minute)
    ours = module("decode", "ours", logs.hour)
    one = locfuse("run", logs.hour, *FROZEN, *how)
    five = locfuse("compare", logs.hour, *FROZEN, *how)
    recorded = (*five, "--rerun-save", f"{out}.rrd")
    pictures = locfuse("compare", logs.minute, *how)
    ten = locfuse("compare", logs.ten, *how)
    buildings = [] if logs.building is None else [of_building(logs.building, how)]
    return [
        Figure("60 s, 600 pictures: five configurations / stock", 1.40, pictures, stock_minute),
        Figure("60 s, 600 pictures: five configurations / one", 1.25, pictures, locfuse("run", logs.minute, *how)),
        Figure(f"{length}: one configuration, frozen map / stock", 0.35, one, stock),
        Figure(f"{length}: five configurations, frozen map / stock", 0.50, five, stock, peak=200.0),
        Figure(f"{length}: five configurations with a Rerun recording / without", 1.5, recorded, five, peak=340.0),
        Figure(
            f"{length}: five configurations with advice / without",
            3.0,
            locfuse("compare", logs.hour, *FROZEN, *advised),
            five,
        ),
        Figure(f"{length}: one configuration, `grow` / stock", 0.45, locfuse("run", logs.hour, *how), stock),
        Figure(f"{length}: reading and decoding / stock", 0.10, ours, stock),
        Figure(f"{length}: reading and decoding / rosbags", 0.35, ours, module("decode", "rosbags", logs.hour)),
        Figure(f"{length}: five configurations / one", 1.50, five, one),
        Figure("10 min, compass and laser: `compare`, `grow` / stock", 0.50, ten, decoded(logs.ten)),
        *buildings,
        Figure(
            "`locfuse --help` / `import click`", 1.50, locfuse("--help"), (sys.executable, "-c", "import click")
        ),
    ]


def of_building(log: Path, how: Sequence[str | Path]) -> Figure:
    """Return what comparing a recorded building costs."""
    return Figure(f"{log.stem}, a building: `compare` / stock", 15.0, locfuse("compare", log, *how), decoded(log))


def decoded(log: Path) -> Command:
    """Return the yardstick of a log."""
    return module("decode", "stock", log)


def logs(folder: Path, minutes: float) -> Logs:
    """Generate the logs where they are not there yet."""
    aces = Path(os.environ.get(DATA, "")) / "aces" / "aces.mcap"
    long = folder / f"{minutes:g}_minutes.mcap"
    found = Logs(folder / "minute.mcap", folder / "10_minutes.mcap", long, aces if aces.is_file() else None)
    for path, options in ((found.minute, MINUTE), (found.ten, TEN), (long, ("--minutes", str(minutes)))):
        if not path.exists():
            subprocess.run(module("make_log", path, *options), check=True)
    return found


def in_turns(commands: Iterable[Command], rounds: int) -> dict[Command, list[Cost]]:
    """Run every command once per round, so that a slow minute of the machine hits all of them.

    A command that fails says why on stderr, and has no costs.
    """
    costs: dict[Command, list[Cost]] = {command: [] for command in commands}
    failed: set[Command] = set()
    for i in range(rounds):
        for command in [c for c in costs if c not in failed]:
            click.echo(f"round {i + 1}: {' '.join(command[2:6])}", err=True)
            try:
                costs[command].append(cost(command))
            except RuntimeError as e:
                click.echo(str(e), err=True)
                failed.add(command)
    return {command: [] if command in failed else seen for command, seen in costs.items()}


def process_row(figure: Figure, costs: dict[Command, list[Cost]]) -> Row:
    """Return one line of the table."""
    ours, theirs = costs[figure.ours], costs[figure.theirs]
    if not ours or not theirs:
        return (figure.name, *FAILED, *UNKNOWN)
    ratios = [a.cpu / b.cpu for a, b in zip(ours, theirs, strict=True)]
    wall = " / ".join(f"{statistics.median(c.wall for c in seen):.2f}" for seen in (ours, theirs))
    cpu = (f"{statistics.median(c.cpu for c in seen):.2f} s" for seen in (ours, theirs))
    return (figure.name, *cpu, *judged(ratios, figure.goal), f"{wall} s")


def memory_row(name: str, goal: float, seen: list[Cost]) -> Row:
    """Return the line of the table that says how much memory a command held at most, MB."""
    if not seen:
        return (name, *FAILED, *UNKNOWN)
    peak = statistics.median(c.peak for c in seen)
    return (name, f"{peak:.0f} MB", "", "", f"≤ {goal:g} MB", "yes" if peak <= goal else "no", "")


def judged(ratios: list[float], goal: float) -> Row:
    """Return median and spread of a ratio, the goal, and whether it is met."""
    middle = statistics.median(ratios)
    return f"{middle:.3g} ({min(ratios):.3g}-{max(ratios):.3g})", f"≤ {goal:g}", "yes" if middle <= goal else "no"


def table(rows: list[Row]) -> str:
    """Return the rows as markdown."""
    head = ("figure", "ours", "yardstick", "ratio (min-max)", "goal", "met", "wall")
    lines = [head, tuple("---" for _ in head), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


@click.command()
@click.option("--rounds", default=5, show_default=True)
@click.option("--minutes", default=60.0, show_default=True, help="Length of the long log.")
@click.option("--only", default="", help="Only figures whose name holds this.")
@click.option("--folder", type=click.Path(file_okay=False, path_type=Path), help="Where the logs are kept.")
def main(rounds: int, minutes: float, only: str, folder: Path | None) -> None:
    """Measure the product's speed against public packages and print a markdown table."""
    compileall.compile_dir(ROOT, quiet=2)  # as pip does when it installs: no process compiles
    with tempfile.TemporaryDirectory() as temporary:
        place = folder or Path(temporary)
        place.mkdir(parents=True, exist_ok=True)
        on = logs(place, minutes)
        length = "1 h" if minutes == 60 else f"{minutes:g} min"
        every = figures(on, Path(temporary) / "out", length)
        wanted = [f for f in every if only in f.name]
        costs = in_turns([c for f in wanted for c in (f.ours, f.theirs)], rounds)
        rows = [process_row(f, costs) for f in wanted]
        rows += [memory_row(f"peak memory, {f.name}", f.peak, costs[f.ours]) for f in wanted if f.peak]
        click.echo(table(rows))
        said = subprocess.run(module("decode", "ours", on.hour), check=True, capture_output=True, text=True).stdout
        click.echo(f"\nThe long log: {said.strip()}.")


if __name__ == "__main__":
    main()
