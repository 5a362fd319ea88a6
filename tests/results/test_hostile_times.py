"""Exports of logs whose recording clock is none of ROS' times."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from commands import locfuse
from hostile import Put, write
from mcap.reader import make_reader
from msgspec.structs import replace

import locfuse as api
from locfuse.formats.results.mcap_export import Export
from locfuse.fusion.data import LocfuseError, Truth
from locfuse.fusion.fuse import fuse


def test_a_recording_clock_below_zero_is_written_as_zero(tmp_path: Path) -> None:
    """A sixth of the messages were recorded at log time 2: the clock comes out below zero at the start."""
    n = 0

    def some(put: Put) -> Put:
        nonlocal n
        n += 1
        return put._replace(log_time=2) if n % 6 == 0 else put

    log = write(tmp_path / "f.mcap", some)
    done = locfuse("run", log, "-o", tmp_path / "o", "--export", "mcap")
    assert done.exit_code in {0, 3}, done.stderr
    with (tmp_path / "o" / "estimates.mcap").open("rb") as file:
        times = [m.log_time for _, _, m in make_reader(file, validate_crcs=True).iter_messages()]
    assert times
    assert min(times) >= 0


def test_a_clock_that_starts_at_zero_a_second_after_the_stamps_is_exported(tmp_path: Path) -> None:
    first: list[int] = []

    def simulated(put: Put) -> Put:
        first.append(put.log_time)
        return put._replace(log_time=max(put.log_time - first[0] - 10**9, 0))

    log = write(tmp_path / "f.mcap", simulated)
    done = locfuse("run", log, "-o", tmp_path / "o", "--export", "mcap")
    assert done.exit_code in {0, 3}, done.stderr
    assert (tmp_path / "o" / "estimates.mcap").exists()


def test_times_that_no_ros_stamp_holds_are_refused_in_one_line(tmp_path: Path) -> None:
    log = write(tmp_path / "f.mcap", lambda put: put._replace(log_time=put.log_time + 10**18))
    done = locfuse("run", log, "-o", tmp_path / "o", "--order", "recorded", "--export", "mcap")
    assert done.exit_code == 1
    assert "January 2038" in done.stderr.splitlines()[-1]
    assert not (tmp_path / "o").exists()
    assert locfuse("run", log, "-o", tmp_path / "o", "--order", "recorded").exit_code in {0, 3}


@pytest.mark.parametrize(("shift_s", "does"), [(5e8, "ends"), (-5e9, "begins")])
def test_so_are_those_of_a_truth(tmp_path: Path, shift_s: float, does: str) -> None:
    session = api.load("rounded_rectangle", between=(0.0, 2.0))
    drive = session.drive
    t = drive.t.copy()
    t[-1 if does == "ends" else 0] += shift_s
    truth = Truth("/truth", t, np.zeros((len(drive.t), 2)), None)
    moved = replace(drive, truth=truth, epoch_ns=1_700_000_000 * 10**9)
    export = Export(moved, [fuse(drive, session.robot, [])], np.zeros((len(drive.t), 3)), b"")
    with pytest.raises(
        LocfuseError, match=f"the truth {does} .* after 1970, and a ROS stamp ends in January 2038"
    ):
        export.write(tmp_path / "out.mcap")
    assert not (tmp_path / "out.mcap").exists()
