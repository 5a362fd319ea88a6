"""Many logs: what `compare` over a fleet costs, and whether it survives being killed. python -m benchmarks.fleet.

rows      10 000 simulated results: memory of the tables and the page, size of the page
killed    a run that is killed at random times and started again, against one that is left alone
jobs      wall time with two jobs over that with one
overhead  CPU time per log over that of a bare `compare`, and that of the command itself
cluster   two workers of which one is killed, against a run on this machine; needs locfuse[cluster]
"""

from __future__ import annotations

import hashlib
import os
import random
import resource
import shutil
import signal
import subprocess
import tempfile
import time
from collections.abc import Callable, Sequence
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import click
import numpy as np

from benchmarks.figures import locfuse, module
from benchmarks.process import Cost, cost
from locfuse import sample_logs

LOCFUSE = locfuse()
LIGHT = ("camera.enabled=false", "path.legs=[{forward=1.5}, {turn_deg=180}, {forward=1.5}]")
QUIET = ("--write", "json,csv,html", "-q")
TIMES_KILLED = 20
BROKEN = {"text.mcap": b"no log at all\n", "empty.mcap": b"", "noise.mcap": bytes(range(256)) * 100}


def simulated_report(rng: np.random.Generator, log: int, robot: int) -> dict[str, Any]:
    """Return a report.json as far as fleets read it: five configurations, figures around a robot's own error."""
    sensors = ("compass", "lrf", "camera")
    level = {"odometry": 0.5, "compass": 0.1, "lrf": 0.01, "camera": 0.06, "all": 0.01}
    used = {"odometry": (), "all": sensors, **{s: (s,) for s in sensors}}
    own = np.exp(0.3 * np.random.default_rng(robot).standard_normal())
    rows = {}
    for name, error in level.items():
        rmse = float(error * own * np.exp(0.4 * rng.standard_normal()))
        rows[name] = {
            "configuration": name,
            "smoothed": False,
            "rates_hz": {},
            "align": "none",
            "duration_s": 600.0,
            "anees": float(rng.chisquare(30) / 30),
            **{key: rmse * (1.0 + i) for i, key in enumerate(("position_rmse_m", "position_max_m", "x_rmse_m"))},
            **{f"figure_{i}": rmse for i in range(12)},
            "sensors": {s: {"accepted": 1000, "rejected": 3, "absent": 0, "nis": 1.0} for s in used[name]},
        }
    effect = {"ln": float(rng.normal(1.0, 0.3)), "expected": 2.7}
    of_sensor: dict[str, Any] = {"share": 0.3, "anees_without": 1.0, "anees_with": 1.2, "beside": []}
    of_sensor |= {"credit": None, "alone": effect, "leave_one_out": effect}
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
        "verdicts": {s: {"verdict": str(rng.choice(["helps", "hurts"]))} for s in sensors},
        "credit": {
            "complete": False,
            "total_factor": 3.0,
            "sensors": dict.fromkeys(sensors, of_sensor),
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


def compares(logs: Sequence[Path], out: Path) -> float:
    """Return the CPU time [s] of a bare `compare` of each log."""
    words = ("--write", "json", "-q", "--no-advice", "-o", str(out))
    return sum(cost((*LOCFUSE, "compare", str(log), *words)).cpu for log in logs)


def fleet(logs: Sequence[Path], out: Path, *words: str) -> Cost:
    """Return what a fleet costs."""
    return cost((*LOCFUSE, "fleet", *map(str, logs), "-o", str(out), "--write", "json", "-q", *words))


@click.group()
def main() -> None:
    """Measure compare over many logs."""


def measured(default: int) -> Callable[[Callable[..., str]], click.Command]:
    """Return a decorator: a function of a scratch folder and a number of logs becomes a command."""

    def command(work: Callable[..., str]) -> click.Command:
        def run(count: int) -> None:
            with tempfile.TemporaryDirectory(prefix="fleet-", ignore_cleanup_errors=True) as scratch:
                click.echo(work(Path(scratch), count))

        option = click.Option(("--logs", "--count", "count"), default=default, show_default=True)
        made = click.Command(
            work.__name__.removesuffix("_command"), callback=run, params=[option], help=work.__doc__
        )
        main.add_command(made)
        return made

    return command


@measured(10_000)
def rows_command(_scratch: Path, count: int) -> str:
    """Measure memory and size of the page of so many simulated rows."""
    files = simulated_files(count)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    sizes = ", ".join(f"{name} {len(content) / 1e6:.2f} MB" for name, content in files.items())
    return f"{count} rows: peak {peak:.0f} MB; {sizes}"


@measured(8)
def killed_command(scratch: Path, count: int) -> str:
    """Compare the files of a run that is killed twenty times with those of one that is left alone."""
    logs = write_logs(scratch / "logs", count)
    subprocess.run(
        (*LOCFUSE, "fleet", *map(str, logs), "-o", str(scratch / "alone"), *QUIET), check=True, capture_output=True
    )
    found, hits = killed(logs, scratch / "killed", TIMES_KILLED)
    same = "equal" if found == tables(scratch / "alone") else "DIFFERENT"
    return f"{count} logs, killed {hits} of {TIMES_KILLED} times while it ran: {same} files"


@measured(8)
def jobs_command(scratch: Path, count: int) -> str:
    """Measure two jobs against one, and one against a bare compare of each log, of 20 minutes each."""
    logs = [scratch / f"log_{seed}x.mcap" for seed in range(count)]
    for seed, log in enumerate(logs):
        subprocess.run(
            module("make_log", log, "--minutes", "20", "--seed", str(seed)), check=True, capture_output=True
        )
    one, two = (fleet(logs, scratch / f"j{jobs}", "--jobs", str(jobs)) for jobs in (1, 2))
    cpu = compares(logs, scratch / "bare")
    return (
        f"{count} logs on {os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}: --jobs 1 {one.wall:.1f} s, "
        f"--jobs 2 {two.wall:.1f} s, ratio {two.wall / one.wall:.2f}; CPU {one.cpu:.1f} s against {cpu:.1f} s of "
        f"{count} bare compares: {one.cpu / cpu - 1.0:+.1%}"
    )


@measured(10)
def overhead_command(scratch: Path, count: int) -> str:
    """Measure the CPU time of a job over that of a bare compare, and that of the command by a second run."""
    logs = [scratch / f"log_{i}x.mcap" for i in range(count)]
    for place in logs:
        shutil.copy(sample_logs.path("rounded_triangle"), place)
    bare = compares(logs, scratch / "bare") / count
    first, second = (fleet(logs, scratch / "fleet").cpu for _ in range(2))  # the second runs no job
    of_job = (first - second) / count
    return (
        f"{count} logs, load {os.getloadavg()[0]:.1f}: CPU: a bare compare {bare:.2f} s, a job {of_job:.2f} s "
        f"({of_job / bare - 1.0:+.1%}), the command {second:.2f} s; together {first / (bare * count) - 1.0:+.1%}"
    )


@measured(60)
def cluster_command(scratch: Path, count: int) -> str:
    """Compare the files of two Dask workers, one of which is killed, with those made on this machine."""
    from distributed import LocalCluster

    logs = write_logs(scratch / "logs", count)
    logs += [logs[0].with_name(name) for name in BROKEN]
    for log in logs[count:]:
        log.write_bytes(BROKEN[log.name])
    options: dict[str, Any] = {"host": "127.0.0.1", "dashboard_address": None, "threads_per_worker": 1}
    command = (*LOCFUSE, "fleet", *map(str, logs), *QUIET, "-o")
    here = subprocess.run((*command, str(scratch / "here")), capture_output=True, check=False).returncode
    cluster_of: Any = LocalCluster  # untyped
    with cluster_of(n_workers=2, **options) as cluster:
        there = (*command, str(scratch / "there"), "--cluster", cluster.scheduler_address)
        with subprocess.Popen(there, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as run:
            while run.poll() is None and len(list((scratch / "there").glob("*/report.json"))) < count // 3:
                time.sleep(0.1)
            os.kill(next(iter(cluster.workers.values())).pid, signal.SIGKILL)
            code = run.wait()
    same = "equal" if tables(scratch / "here") == tables(scratch / "there") else "DIFFERENT"
    return f"{len(logs)} logs, {len(BROKEN)} broken, a worker killed: exit {here} and {code}, {same} files"


if __name__ == "__main__":
    main()
