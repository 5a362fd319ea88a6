"""A sensor is one file and one line of the registry: everything else follows by itself.

The beacon of tests/helpers/beacon.py is registered, a log is written that carries it, and nothing else is touched.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import beacon
import numpy as np
import pytest
import recordings
from commands import locfuse
from trap_logs import TRUTH, Drive, numbers

from locfuse.fusion.sensors.registry import REGISTRY

PLACE = (4.0, 1.5)
NOISE = 0.05  # m
TOO_MUCH = 0.4  # m: what the radio measures too much, of which nobody was told


@pytest.fixture(scope="module", autouse=True)
def registered() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(REGISTRY, "beacon", beacon.Beacon())
        yield


def write(path: Path, error: float = 0.0) -> Path:
    """Write a short drive that a beacon measured too, `error` [m] too far."""
    drive = Drive()
    truth = drive.on(TRUTH)
    at = np.array([[m.fields["pose.position.x"], m.fields["pose.position.y"]] for m in truth])
    ranges = np.hypot(*(at - PLACE).T) + error + NOISE * np.random.default_rng(3).standard_normal(len(at))
    drive.add(numbers("/beacon/range", "Float32", truth, ranges.tolist()))
    return drive.record(path)


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write(tmp_path_factory.mktemp("beacon") / "beacon.mcap")


SET = ("--set", f"beacon.place=[{PLACE[0]}, {PLACE[1]}]")


@pytest.fixture(scope="module")
def compared(log: Path) -> Path:
    out = log.parent / "out"
    words = ("--sensors", "odometry", "--sensors", "beacon", "--sensors", "all")
    done = locfuse("compare", log, *SET, "-o", out, "--rerun-save", log.parent / "beacon.rrd", *words)
    assert done.exit_code == 0, done.stderr
    (log.parent / "stdout.txt").write_text(done.stdout)
    return out


def test_info_says_what_reads_it_and_what_it_lacks(log: Path) -> None:
    done = locfuse("info", log)
    assert "not yet  beacon: beacon.place is not set" in done.stdout
    known = json.loads(locfuse("info", log, "--json", *SET).stdout)
    assert known["roles"]["beacon"]["topics"] == ["/beacon/range"]
    assert known["configurations"]["beacon"] is None


def test_init_asks_for_its_place(log: Path) -> None:
    done = locfuse("init", log)
    table = done.stdout.partition("[beacon]")[2].partition("\n[")[0]
    assert 'topic = "/beacon/range"' in table
    assert "Where the beacon stands" in table
    assert "beacon.place" in done.stderr


def test_compare_lists_it_and_it_helps(compared: Path) -> None:
    rows = (compared.parent / "stdout.txt").read_text().splitlines()
    assert any(row.split()[:1] == ["beacon"] for row in rows)
    assert any(row.split()[:2] == ["all", "beacon"] for row in rows)
    report = json.loads((compared / "report.json").read_text())
    alone, without = (report["configurations"][name] for name in ("beacon", "odometry"))
    assert alone["sensors"]["beacon"]["accepted"] > 50
    assert alone["position_rmse_m"] < without["position_rmse_m"]


def test_run_writes_what_became_of_it(log: Path, tmp_path: Path) -> None:
    audit = tmp_path / "audit.csv"
    done = locfuse("run", log, *SET, "--sensors", "beacon", "-o", tmp_path / "out", "--audit", audit)
    assert done.exit_code == 0, done.stderr
    assert "beacon" in done.stdout
    header, *rows = audit.read_text().splitlines()
    assert sum("beacon" in row for row in rows) > 50
    assert len(rows[0].split(",")) == len(header.split(","))


def test_report_and_figures_name_it_with_its_unit(compared: Path) -> None:
    page = (compared / "report.html").read_text()
    assert "beacon: innovation of range" in page
    assert "beacon range, m" in page
    assert REGISTRY["beacon"].colour.light in page
    assert "beacon" in (compared / "report.md").read_text()


def test_a_recording_names_it_with_its_unit(compared: Path) -> None:
    path = compared.parent / "beacon.rrd"
    drawn = recordings.read(path)
    assert "innovation/beacon/range/beacon" in drawn
    assert "nis/beacon/beacon" in drawn
    assert any(name.startswith("raw/beacon/range") for name in drawn)
    assert any(name.endswith("landmark/beacon") for name in drawn)
    names = [str(v) for e in recordings.read_blueprint(path).values() for v in e.static.values()]
    assert any("beacon range [m]" in name for name in names)


def test_a_constant_error_is_named_with_the_key_that_takes_it_out(tmp_path: Path) -> None:
    """In metres: nothing is wrapped as an angle would be."""
    log, out = write(tmp_path / "far.mcap", TOO_MUCH), tmp_path / "out"
    done = locfuse("compare", log, *SET, "--set", "beacon.gate=1", "-o", out, "--write", "json")
    assert done.exit_code == 0, done.stderr
    said = next(line for line in done.stdout.splitlines() if line.startswith("beacon: "))
    assert "on average" in said
    assert said.endswith(f"--set beacon.offset={TOO_MUCH}")


def test_words_of_sensors_know_it(log: Path) -> None:
    done = locfuse("run", log, "--sensors", "bacon")
    assert done.exit_code == 2
    assert "beacon" in done.stderr
    done = locfuse("run", log, "--sensors", "beacon")
    assert done.exit_code == 1
    assert "--set beacon.place" in done.stderr
