"""Two scans at one instant, as coarse stamps give: no traceback, and no line by another scan's verdict."""

from __future__ import annotations

import json
import struct
from pathlib import Path

from commands import locfuse
from hostile import Put, write

COARSE_NS = 200_000_000  # twice the laser's period


def coarsely_stamped(put: Put) -> Put:
    if put.topic != "/scan":
        return put
    data = bytearray(put.data)
    seconds, nanoseconds = struct.unpack_from("<iI", data, 4)
    struct.pack_into("<iI", data, 4, seconds, nanoseconds // COARSE_NS * COARSE_NS)
    return put._replace(data=bytes(data))


def test_pairs_of_scans_are_fused_and_the_error_stays_that_of_single_ones(tmp_path: Path) -> None:
    rmse = {}
    for name, change in (("single", lambda put: put), ("pairs", coarsely_stamped)):
        log = write(tmp_path / f"{name}.mcap", change, seconds=40.0)
        done = locfuse("run", log, "-o", tmp_path / name, "--sensors", "lrf", "--no-smooth", "--write", "json")
        assert done.exit_code == 0, done.stderr
        report = json.loads((tmp_path / name / "run.json").read_bytes())
        (found,) = report["configurations"].values()
        rmse[name] = found["position_rmse_m"]
    assert rmse["pairs"] < 3.0 * rmse["single"] + 0.02
