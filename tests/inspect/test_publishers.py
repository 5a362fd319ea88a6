"""Two publishers on one topic are named, with the numbers: by their channels, or by the angles of their scans."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bags import T0, S, cdr, definition, header
from commands import locfuse
from laser_room import circle, scans_of
from mcap.writer import Writer

ODOMETRY = "nav_msgs/msg/Odometry"


def odometry(i: int, x: float) -> bytes:
    pose = {"position": {"x": x, "y": 0.0, "z": 0.0}, "orientation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}}
    return cdr(ODOMETRY, header=header(T0 + i * S // 20, "odom"), pose={"pose": pose})


def log(path: Path, writes: list[tuple[int, int, float]]) -> Path:
    """Messages of /odom as (channel, number, x), at 20 Hz."""
    with path.open("wb") as file:
        writer: Any = Writer(file)
        writer.start()
        schema = writer.register_schema(ODOMETRY, "ros2msg", definition(ODOMETRY))
        idents = [writer.register_channel("/odom", "cdr", schema, {"node": name}) for name in ("a", "b")]
        for channel, i, x in writes:
            writer.add_message(idents[channel], T0 + i * S // 20, odometry(i, x), T0 + i * S // 20, i)
        writer.finish()
    return path


def found(path: Path) -> list[dict[str, Any]]:
    report = json.loads(locfuse("info", path, "--json").stdout)
    return [f for f in report["findings"] if f["code"] in {"publishers", "scan angles"}]


def test_two_odometries_in_turn_on_one_topic_would_spoil_an_estimate(tmp_path: Path) -> None:
    writes = [(i % 2, i, 0.05 * i + 3.0 * (i % 2)) for i in range(100)]
    (finding,) = found(log(tmp_path / "two.mcap", writes))
    assert (finding["role"], finding["severe"]) == ("wheels", True)
    assert "/odom mixes two publishers (50 and 50 messages in turn)" in finding["message"]
    assert "record each on a topic of its own" in finding["message"]


@pytest.mark.parametrize("kind", ["started again", "recorded twice", "one"])
def test_a_publisher_that_starts_again_or_is_recorded_twice_is_one(tmp_path: Path, kind: str) -> None:
    writes = {
        "started again": [(int(i >= 50), i, 0.05 * i) for i in range(100)],
        "recorded twice": [(c, i, 0.05 * i) for i in range(100) for c in (0, 1)],
        "one": [(0, i, 0.05 * i) for i in range(100)],
    }[kind]
    assert found(log(tmp_path / "one.mcap", writes)) == []


def test_scans_that_begin_at_two_angles_in_turn_are_named(tmp_path: Path) -> None:
    from bags import write
    from laser_room import BEAMS

    t, poses = circle()
    said = scans_of(t, poses)
    assert found(write(tmp_path / "one.mcap", said)) == []
    other = np.float32(-np.pi).tobytes()
    changed = [
        m
        if i % 2
        else m._replace(data=m.data.replace(other, np.float32(-np.pi + 4.0 * np.pi / BEAMS).tobytes(), 1))
        for i, m in enumerate(said)
    ]
    (finding,) = found(write(tmp_path / "two.mcap", changed))
    assert finding["role"] == "lrf"
    assert "30 scans at -180°" in finding["message"]
    assert "30 scans at -174°" in finding["message"]
