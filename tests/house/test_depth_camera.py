"""A depth camera as a laser (LOCFUSE_DATA/strangers): what its lines need."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

import locfuse

DATA = os.environ.get("LOCFUSE_DATA")
pytestmark = pytest.mark.skipif(not DATA, reason="LOCFUSE_DATA is not set: no real logs to try")
LOG = Path(DATA or "") / "strangers" / "odometry_in_tf.bag"


def test_of_a_depth_camera_a_floor_of_its_lines_is_advised_and_takes_more_of_them() -> None:
    """Its neighbouring beams are wrong alike, so that the mean of many is no better than one."""
    log = locfuse.load(LOG)
    fixes = dict(fix.partition("=")[::2] for fix in log.compare().report["fixes"])
    assert fixes.keys() == {"lrf.floor_range", "lrf.floor_angle_deg"}
    before, after = (
        session.run("lrf", advice=False).report["configurations"]["lrf"]["sensors"]["lrf"]
        for session in (log, log.with_settings({key: float(value) for key, value in fixes.items()}))
    )
    assert after["accepted"] > 1.25 * before["accepted"]
    assert after["rejected"] < 0.7 * before["rejected"]
