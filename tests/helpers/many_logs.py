"""Many logs for tests: simulated ones, their results without a filter, and a run that is killed."""

import hashlib
import random
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np

import locfuse
from locfuse.cli.session.summary import summarised
from locfuse.formats.report.fleet import KINDS, Entry, slim, summary_files
from locfuse.fusion.sensors.registry import colours

LIGHT = ("camera.enabled=false", "lrf.enabled=false")
THERE_AND_BACK = "path.legs=[{forward=1.5}, {turn_deg=180}, {forward=1.5}]"
QUIET = ("--write", "json,csv,html", "-q")


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
        "credit": {"complete": False, "total_factor": 3.0, "sensors": dict.fromkeys(sensors, of_sensor)},
        "key": hashlib.sha256(f"key {log}".encode()).hexdigest(),
    }


def simulated_files(rows: int) -> dict[str, Any]:
    """Return the files over a fleet with so many rows, one log in 50 failed."""
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


def write_logs(folder: Path, names: Sequence[str], sets: Sequence[str]) -> list[Path]:
    """Simulate short drives that differ, each named."""
    folder.mkdir(parents=True, exist_ok=True)
    logs = [folder / f"{name}.mcap" for name in names]
    for seed, log in enumerate(logs):
        locfuse.simulate("straight_runs", log, seed=seed, sets=sets)
    return logs


def tables(folder: Path) -> dict[str, bytes]:
    """Return every file of a run: what two runs must have in common."""
    return {str(p.relative_to(folder)): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


def killed(logs: Sequence[Path], folder: Path, times: int, seed: int = 0) -> tuple[dict[str, bytes], int]:
    """Return the files of a run that was killed so often, then left to end, and how often it was hit."""
    rng = random.Random(seed)
    command = (sys.executable, "-m", "locfuse", "fleet", *map(str, logs), "-o", str(folder), "--jobs", "2", *QUIET)
    hits = 0
    for _ in range(times):
        with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as process:
            time.sleep(rng.uniform(0.3, 3.0))
            hits += process.poll() is None
            process.send_signal(signal.SIGKILL)
    subprocess.run(command, check=True, capture_output=True)
    return tables(folder), hits
