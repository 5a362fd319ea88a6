"""A nav_msgs/Path as poses over time: its last message, each pose at its own stamp."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest
from bags import Said, cdr, header, write
from commands import locfuse
from numpy.typing import NDArray
from wheel_bags import odometry, stamps, turned

from locfuse.formats.logs.log import open_log
from locfuse.fusion.data import LocfuseError

Array = NDArray[np.float64]
PATH = "nav_msgs/msg/Path"
T = np.arange(0.0, 10.01, 0.1)
POSES = np.stack((2.0 * np.sin(0.2 * T), 2.0 * (1.0 - np.cos(0.2 * T)), 0.2 * T), axis=-1)


def path(times: Array, poses: Array, at: int, planned: bool = False) -> Said:
    """A message on /slam/path that holds poses (n, 3) [m, rad]; of a plan all have its own stamp."""
    own = [at] * len(times) if planned else stamps(times)
    held = [
        {"header": header(ns, "map"), "pose": {"position": {"x": x, "y": y}, "orientation": turned(theta)}}
        for ns, (x, y, theta) in zip(own, poses.tolist(), strict=True)
    ]
    return Said("/slam/path", PATH, cdr(PATH, header=header(at, "map"), poses=held), at)


def growing() -> list[Said]:
    """A way that is drawn again every second, wrong until the last message corrects it all."""
    wrong = POSES + np.array([0.3, -0.1, 0.05])
    at = stamps(T)
    early = [path(T[:i:5], wrong[:i:5], at[i]) for i in range(10, 101, 10)]
    return [*early, path(T[::5], POSES[::5], at[-1] + 1)]


def test_the_last_message_says_the_whole_way_at_the_stamps_of_its_poses(tmp_path: Path) -> None:
    log = open_log([write(tmp_path / "x.mcap", growing())])
    stream = log.stream("/slam/path:poses")
    assert stream.msgtype == "geometry_msgs/msg/PoseStamped"
    assert stream.frame_id == "map"
    assert stream.t_ns.tolist() == stamps(T[::5])
    x, w = (np.asarray(c) for c in stream.columns("pose.position.x", "pose.orientation.w").values())
    assert x == pytest.approx(POSES[::5, 0])
    assert w == pytest.approx(np.cos(POSES[::5, 2] / 2))


def test_a_path_is_judged_as_an_estimate_and_judges_as_truth(tmp_path: Path) -> None:
    log = write(tmp_path / "x.mcap", sorted([*odometry(T, POSES), *growing()], key=lambda m: m.log_time))
    out = tmp_path / "out"
    named = ("--set", "truth.topic=/slam/path", "--estimate", "slam=/slam/path", "--no-advice", "--write", "json")
    done = locfuse("compare", log, *named, "-o", out)
    assert done.exit_code == 0, done.stderr
    rows = json.loads((out / "report.json").read_text())["configurations"]
    assert rows["slam"]["position_rmse_m"] == pytest.approx(0.0, abs=1e-9)
    assert rows["odometry"]["position_rmse_m"] == pytest.approx(0.0, abs=1e-3)
    assert rows["odometry"]["heading_rmse_deg"] == pytest.approx(0.0, abs=math.degrees(1e-3))


@pytest.mark.parametrize("n", [0, 1, 20], ids=["empty", "one pose", "all of one time"])
def test_a_plan_is_no_way_that_was_driven(n: int, tmp_path: Path) -> None:
    at = stamps(T)
    plans = [path(T[:n], POSES[:n], at[i], planned=True) for i in (0, 50)]
    log = open_log([write(tmp_path / "x.mcap", plans)])
    with pytest.raises(LocfuseError, match=f"/slam/path: the {n} poses of its last message have no times"):
        log.stream("/slam/path:poses")
