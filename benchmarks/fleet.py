"""Many logs: what `compare` over a fleet costs, and whether it survives being killed. python -m benchmarks.fleet.

rows      10 000 simulated results: memory of the tables and the page, size of the page
killed    a run that is killed at random times and started again, against one that is left alone
jobs      wall time with two jobs over that with one
overhead  CPU time per log over that of a bare `compare`, and that of the command itself
opening   share of a log with raw images that is read to open it
"""

from __future__ import annotations

import hashlib
import os
import random
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import click
import numpy as np

if not __package__:
    sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from benchmarks.process import cost

LOCFUSE = (sys.executable, "-m", "locfuse.cli")
LIGHT = ("camera.enabled=false", "path.legs=[{forward=1.5}, {turn_deg=180}, {forward=1.5}]")
QUIET = ("--write", "json,csv,html", "-q")


def simulated_report(rng: np.random.Generator, log: int, robot: int) -> dict[str, Any]:
    """Return a report.json as far as fleets read it: five configurations, figures around a robot's own error."""
    level = {"odometry": 0.5, "compass": 0.1, "lrf": 0.01, "camera": 0.06, "all": 0.01}
    own = np.exp(0.3 * np.random.default_rng(robot).standard_normal())
    rows = {}
    for name, error in level.items():
        rmse = float(error * own * np.exp(0.4 * rng.standard_normal()))
        sensors = (
            [name] if name not in {"odometry", "all"} else ["compass", "lrf", "camera"] if name == "all" else []
        )
        rows[name] = {
            "configuration": name,
            "smoothed": False,
            "rates_hz": {},
            "align": "none",
            "duration_s": 600.0,
            "anees": float(rng.chisquare(30) / 30),
            **{key: rmse * (1.0 + i) for i, key in enumerate(("position_rmse_m", "position_max_m", "x_rmse_m"))},
            **{f"figure_{i}": rmse for i in range(12)},
            "sensors": {s: {"accepted": 1000, "rejected": 3, "absent": 0, "nis": 1.0} for s in sensors},
        }
    effect = {"ln": float(rng.normal(1.0, 0.3)), "expected": 2.7}
    of_sensor = {"share": 0.3, "anees_without": 1.0, "anees_with": 1.2, "beside": []}
    day = datetime(2026, 1, 1, tzinfo=UTC) + timedelta(days=log // 20)
    return {
        "input": {
            "name": f"log_{log}",
            "size": 10_000_000,
            "identity": hashlib.sha256(str(log).encode()).hexdigest(),
            "sha256": None,
            "start": day.strftime("%Y-%m-%dT%H:%M:%SZ"),
            "losses": {},
        },
        "configurations": rows,
        "verdicts": {s: {"verdict": str(rng.choice(["helps", "hurts"]))} for s in ("compass", "lrf", "camera")},
        "credit": {
            "complete": False,
            "total_factor": 3.0,
            "sensors": {
                s: {**of_sensor, "credit": None, "alone": effect, "leave_one_out": effect}
                for s in ("compass", "lrf", "camera")
            },
        },
        "key": hashlib.sha256(f"key {log}".encode()).hexdigest(),
    }


def simulated_files(rows: int) -> dict[str, Any]:
    """Return the files over a fleet with so many rows, one log in 50 failed."""
    from locfuse.cli.session.summary import summarised
    from locfuse.formats.fleet.entry import Entry, slim
    from locfuse.formats.fleet.files import KINDS, summary_files
    from locfuse.fusion.sensors.registry import colours

    rng = np.random.default_rng(1)
    entries = []
    for log in range(rows // 5):
        robot = f"r{log % 100:02d}"
        if log % 50 == 7:
            entries.append(
                Entry(f"log_{log}", robot, "failed", f"log_{log}.mcap: not an MCAP file: it is a text file")
            )
        else:
            entries.append(Entry(f"log_{log}", robot, report=slim({"": simulated_report(rng, log, log % 100)})))
    return dict(summary_files(summarised(entries), entries, KINDS, colours()))


def write_logs(folder: Path, count: int, sets: Sequence[str] = LIGHT) -> list[Path]:
    """Simulate logs that differ."""
    folder.mkdir(parents=True, exist_ok=True)
    logs = [folder / f"log_{seed}x.mcap" for seed in range(count)]
    words = [w for s in sets for w in ("--set", s)]
    for seed, log in enumerate(logs):
        command = (*LOCFUSE, "simulate", "straight_runs", "-o", str(log), "--seed", str(seed), *words)
        subprocess.run(command, check=True, capture_output=True)
    return logs


def tables(folder: Path) -> dict[str, bytes]:
    """Return every file of a run: what two runs must have in common."""
    return {str(p.relative_to(folder)): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


def killed(logs: Sequence[Path], folder: Path, times: int, seed: int = 0) -> tuple[dict[str, bytes], int]:
    """Return the files of a run that was killed so often, then left to end, and how often it was hit."""
    rng = random.Random(seed)
    command = (*LOCFUSE, "fleet", *map(str, logs), "-o", str(folder), "--jobs", "2", *QUIET)
    hits = 0
    for _ in range(times):
        with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as process:
            time.sleep(rng.uniform(0.3, 3.0))
            hits += process.poll() is None
            process.send_signal(signal.SIGKILL)
    subprocess.run(command, check=True, capture_output=True)
    return tables(folder), hits


@click.group()
def main() -> None:
    """Measure compare over many logs."""


@main.command("rows")
@click.option("--count", default=10_000, show_default=True)
def rows_command(count: int) -> None:
    """Memory and size of the page."""
    files = simulated_files(count)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    sizes = ", ".join(f"{name} {len(content) / 1e6:.2f} MB" for name, content in files.items())
    click.echo(f"{count} rows: peak {peak:.0f} MB; {sizes}")


def _in_scratch(work: Callable[[Path], str]) -> None:
    scratch = Path(tempfile.mkdtemp(prefix="fleet-"))
    try:
        click.echo(work(scratch))
    finally:
        shutil.rmtree(scratch, ignore_errors=True)


@main.command("killed")
@click.option("--logs", "count", default=8, show_default=True)
@click.option("--times", default=20, show_default=True)
def killed_command(count: int, times: int) -> None:
    """A run that is killed again and again."""

    def work(scratch: Path) -> str:
        logs = write_logs(scratch / "logs", count)
        alone = (*LOCFUSE, "fleet", *map(str, logs), "-o", str(scratch / "alone"), *QUIET)
        subprocess.run(alone, check=True, capture_output=True)
        found, hits = killed(logs, scratch / "killed", times)
        same = found == tables(scratch / "alone")
        return (
            f"{count} logs, killed {hits} of {times} times while it ran: {'equal' if same else 'DIFFERENT'} files"
        )

    _in_scratch(work)


@main.command("jobs")
@click.option("--logs", "count", default=8, show_default=True)
@click.option("--minutes", default=20.0, show_default=True)
def jobs_command(count: int, minutes: float) -> None:
    """Two jobs against one, and one against a bare compare of each log."""

    def work(scratch: Path) -> str:
        logs = []
        for seed in range(count):
            logs.append(scratch / f"log_{seed}x.mcap")
            make = (sys.executable, "-m", "benchmarks.make_log", str(logs[-1]), "--minutes", str(minutes))
            subprocess.run((*make, "--seed", str(seed)), check=True, capture_output=True)
        words = ("--write", "json", "-q")
        one, two = (
            cost(
                (
                    *LOCFUSE,
                    "fleet",
                    *map(str, logs),
                    "-o",
                    str(scratch / f"j{jobs}"),
                    "--jobs",
                    str(jobs),
                    *words,
                )
            )
            for jobs in (1, 2)
        )
        bare = [
            cost((*LOCFUSE, "compare", str(log), "-o", str(scratch / "bare"), *words, "--no-advice"))
            for log in logs
        ]
        cpu = sum(b.cpu for b in bare)
        return (
            f"{count} logs of {minutes:g} min on {os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}: "
            f"--jobs 1 {one.wall:.1f} s, --jobs 2 {two.wall:.1f} s, ratio {two.wall / one.wall:.2f}; "
            f"CPU {one.cpu:.1f} s against {cpu:.1f} s of {count} bare compares: {one.cpu / cpu - 1.0:+.1%}"
        )

    _in_scratch(work)


@main.command("overhead")
@click.option("--logs", "count", default=10, show_default=True)
@click.option("--log", default="rounded_triangle", show_default=True, help="The drive that every log is.")
def overhead_command(count: int, log: str) -> None:
    """CPU time of a fleet over that of as many bare compares; what the command itself takes, by a second run."""

    def work(scratch: Path) -> str:
        from locfuse import sample_logs

        source = sample_logs.path(log) if log in sample_logs.names() else Path(log)
        logs = [scratch / f"log_{i}x.mcap" for i in range(count)]
        for place in logs:
            shutil.copy(source, place)
        words = ("--write", "json", "-q")
        bare = [
            cost((*LOCFUSE, "compare", str(one), "-o", str(scratch / "bare"), *words, "--no-advice")).cpu
            for one in logs
        ]
        fleet = (*LOCFUSE, "fleet", *map(str, logs), "-o", str(scratch / "fleet"), *words)
        first, second = cost(fleet).cpu, cost(fleet).cpu  # the second runs no job
        of_job = (first - second) / count
        mean = sum(bare) / count
        return (
            f"{count} logs, load {os.getloadavg()[0]:.1f}: CPU: a bare compare {mean:.2f} s, a job {of_job:.2f} s "
            f"({of_job / mean - 1.0:+.1%}), the command {second:.2f} s; together {first / sum(bare) - 1.0:+.1%}"
        )

    _in_scratch(work)


@main.command("opening")
@click.argument("log", type=click.Path(exists=True, dir_okay=False, path_type=Path))
def opening_command(log: Path) -> None:
    """Bytes read to open a log, such as: python -m benchmarks.make_log raw.mcap --raw-image-hz 10."""
    from locfuse.formats.container.file_bytes import FileBytes
    from locfuse.formats.container.losses import Losses
    from locfuse.formats.container.mcap_source import McapSource

    data = FileBytes(log, Losses())
    source = McapSource(data, data.losses)
    click.echo(
        f"{log}: {data.size / 1e6:.0f} MB, {len(source.channels)} channels, {data.read_bytes / 1e6:.2f} MB of it "
        f"read to open it: {data.read_bytes / data.size:.2%}"
    )


if __name__ == "__main__":
    main()
