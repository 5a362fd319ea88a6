"""Speed relative to public packages: python -m benchmarks.

It generates its logs, and runs pairs of commands: one of locfuse, and one to compare with. In each round every
command runs once. A markdown table has the median CPU times of whole processes, their ratio with its spread over
the rounds, the goal, and the wall times. The ratios are more reliable than the times. Run it from the repository's
root. If LOCFUSE_DATA is set, a recorded building is measured too.
"""

import compileall
import os
import statistics
import subprocess
import sys
import time
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import NamedTuple

import click

from benchmarks import experiment
from benchmarks.real_logs import FILES, are_there, folder as real_folder

ROOT = Path(__file__).parent.parent
Command = tuple[str, ...]


class Cost(NamedTuple):
    """CPU time, wall time and peak memory of one run of a command."""

    cpu: float  # s, user and system, its children included
    wall: float  # s
    peak: float  # MB


def cost(command: Sequence[str]) -> Cost:
    """Run a command and return its cost. Raises RuntimeError with its last output if it fails."""
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


class Figure(NamedTuple):
    """Command of locfuse, command to compare with, and the largest wanted ratio of their CPU times."""

    name: str
    goal: float
    ours: Command
    theirs: Command
    peak: float | None = None  # MB: largest wanted peak memory of our command; None: it is not printed


FROZEN = ("--set", "lrf.map=first-scan")


def module(name: str, *words: str | Path) -> Command:
    return (sys.executable, "-m", f"benchmarks.{name}", *map(str, words))


def locfuse(*words: str | Path) -> Command:
    return (sys.executable, "-m", "locfuse", *map(str, words))


def figures(logs: Sequence[Path], out: Path, minutes: float) -> list[Figure]:
    """Return the pairs of commands to measure, on a log with pictures, one of ten minutes and a long one."""
    minute, ten, hour = logs
    length = "1 h" if minutes == 60 else f"{minutes:g} min"
    advised = ("--write", "json", "--quiet", "--overwrite", "--no-smooth", "--out", out)
    how = (*advised, "--no-advice")  # with advice, the number of filter runs depends on the faults of the log

    def ours(command: str, log: Path, *words: str) -> Command:
        return locfuse(command, log, *words, *how)

    def stock(log: Path) -> Command:
        return module("decode", "stock", log)

    one, five, pictures = ours("run", hour, *FROZEN), ours("compare", hour, *FROZEN), ours("compare", minute)
    with_advice, recorded = locfuse("compare", hour, *FROZEN, *advised), (*five, "--rerun-save", f"{out}.rrd")
    only_click = (sys.executable, "-c", "import click")
    decoded, by_rosbags = (module("decode", reader, hour) for reader in ("ours", "rosbags"))
    found = [
        Figure("60 s, 600 pictures: five configurations / stock", 1.40, pictures, stock(minute)),
        Figure("60 s, 600 pictures: five configurations / one", 1.25, pictures, ours("run", minute)),
        Figure(f"{length}: one configuration, frozen map / stock", 0.35, one, stock(hour)),
        Figure(f"{length}: five configurations, frozen map / stock", 0.50, five, stock(hour), 200.0),
        Figure(f"{length}: five configurations with a Rerun recording / without", 1.5, recorded, five, 340.0),
        Figure(f"{length}: five configurations with advice / without", 3.0, with_advice, five),
        Figure(f"{length}: one configuration, `grow` / stock", 0.45, ours("run", hour), stock(hour)),
        Figure(f"{length}: reading and decoding / stock", 0.10, decoded, stock(hour)),
        Figure(f"{length}: reading and decoding / rosbags", 0.35, decoded, by_rosbags),
        Figure(f"{length}: five configurations / one", 1.50, five, one),
        Figure("10 min, compass and laser: `compare`, `grow` / stock", 0.50, ours("compare", ten), stock(ten)),
        Figure("`locfuse --help` / `import click`", 1.50, locfuse("--help"), only_click),
    ]
    if are_there():
        aces = real_folder() / FILES["aces"]
        found.append(Figure("aces, a building: `compare` / stock", 15.0, ours("compare", aces), stock(aces)))
    return found


LAP_S = 52.5  # s
LONG = (
    *("control.estimator=truth", "control.wait=0", "control.time_limit=1e6", "truth.rate=10"),
    *("lrf.beams=361", "compass.hard_iron=[0, 0]", "compass.soft_iron=[1, 1, 0]"),
)


def make_log(path: Path, minutes: float, camera: str = "camera.enabled=false") -> Path:
    """Simulate laps of the rounded rectangle, steered on the true pose, unless the log exists."""
    sets = [word for key in (*LONG, camera, f"path.laps={60.0 * minutes / LAP_S}") for word in ("--set", key)]
    if not path.exists():
        command = locfuse("simulate", "rounded_rectangle", "--seed", "0", "-o", path, *sets)
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    return path


def in_turns(commands: Iterable[Command], rounds: int) -> dict[Command, list[Cost]]:
    """Run each command once per round, so that a slow phase of the machine affects all of them."""
    costs: dict[Command, list[Cost]] = {command: [] for command in commands}
    for i in range(rounds):
        for command, seen in costs.items():
            click.echo(f"round {i + 1}: {' '.join(command[2:6])}", err=True)
            seen.append(cost(command))
    return costs


def ratio_row(figure: Figure, ours: list[Cost], theirs: list[Cost]) -> Sequence[str]:
    """Return the table's row with CPU times, their ratio and its spread, and whether the goal is met."""
    ratios = [a.cpu / b.cpu for a, b in zip(ours, theirs, strict=True)]
    ratio = statistics.median(ratios)
    wall = " / ".join(f"{statistics.median(c.wall for c in seen):.2f}" for seen in (ours, theirs))
    cpu = (f"{statistics.median(c.cpu for c in seen):.2f} s" for seen in (ours, theirs))
    spread = f"{ratio:.3g} ({min(ratios):.3g}-{max(ratios):.3g})"
    return (figure.name, *cpu, spread, f"≤ {figure.goal:g}", "yes" if ratio <= figure.goal else "no", f"{wall} s")


def memory_row(name: str, goal: float, seen: list[Cost]) -> Sequence[str]:
    """Return the table's row with the peak memory of a command [MB]."""
    peak = statistics.median(c.peak for c in seen)
    return (name, f"{peak:.0f} MB", "", "", f"≤ {goal:g} MB", "yes" if peak <= goal else "no", "")


@click.command()
@click.option("--rounds", default=5, show_default=True)
@click.option("--minutes", default=60.0, show_default=True, help="Length of the long log.")
@click.option("--only", default="", help="Only figures whose name holds this.")
@click.option("--folder", type=click.Path(file_okay=False, path_type=Path), help="Where the logs are kept.")
def main(rounds: int, minutes: float, only: str, folder: Path | None) -> None:
    """Measure the product's speed against public packages and print a markdown table."""
    compileall.compile_dir(ROOT, quiet=2)  # as pip does at installation, so that no measured process compiles
    place = folder or experiment.scratch()
    place.mkdir(parents=True, exist_ok=True)
    logs = [
        make_log(place / "minute.mcap", 1, "camera.rate=10"),
        make_log(place / "ten.mcap", 10),
        make_log(place / f"{minutes:g}_minutes.mcap", minutes),
    ]
    wanted = [f for f in figures(logs, experiment.scratch() / "out", minutes) if only in f.name]
    costs = in_turns([c for f in wanted for c in (f.ours, f.theirs)], rounds)
    rows = [ratio_row(f, costs[f.ours], costs[f.theirs]) for f in wanted]
    rows += [memory_row(f"peak memory, {f.name}", f.peak, costs[f.ours]) for f in wanted if f.peak]
    head = ("figure", "ours", "yardstick", "ratio (min-max)", "goal", "met", "wall")
    click.echo("\n".join(experiment.table(head, rows)))
    decoded = module("decode", "ours", logs[-1])
    said = subprocess.run(decoded, check=True, capture_output=True, text=True).stdout
    click.echo(f"\nThe long log: {said.strip()}.")


if __name__ == "__main__":
    main()
