"""A pose that is known later than the wheels begin: the drive is laid so that it has this pose at that moment."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from commands import locfuse
from mcap.reader import make_reader
from mcap.writer import Writer

import locfuse as api
from locfuse import sample_logs
from locfuse.fusion.data import LocfuseError

SAMPLE = "rounded_rectangle"
POSE = {"start.x": 3.0, "start.y": -2.0, "start.theta_deg": 50.0}


def late(target: Path, topic: str, seconds: float) -> Path:
    """The sample log without its own robot's start and without a topic's first seconds."""
    with sample_logs.path(SAMPLE).open("rb") as source, target.open("wb") as sink:
        reader = make_reader(source)
        writer: Any = Writer(sink)
        writer.start()
        channels: dict[int, int] = {}
        begin = None
        for schema, channel, message in reader.iter_messages():
            assert schema is not None
            begin = begin or message.log_time
            if channel.id not in channels:
                ident = writer.register_schema(schema.name, schema.encoding, schema.data)
                channels[channel.id] = writer.register_channel(channel.topic, channel.message_encoding, ident)
            if channel.topic != topic or message.log_time - begin > seconds * 1e9:
                writer.add_message(
                    channels[channel.id], message.log_time, message.data, message.publish_time, message.sequence
                )
        for attachment in reader.iter_attachments():
            text = attachment.data.decode().replace("[start]", "[start]\nsigma_xy = 0.0")
            writer.add_attachment(0, 0, attachment.name, attachment.media_type, text.encode())
        writer.finish()
    return target


def odometry(at: float | str, **more: float) -> Any:
    return api.load(SAMPLE, sets={**POSE, "start.at": at, **more}).run("odometry", advice=False)


def test_the_drive_has_the_given_pose_at_the_given_moment() -> None:
    found = odometry(10.0).estimates["odometry"]
    x, y, theta = (np.interp(10.0, found.t, np.unwrap(column)) for column in found.pose.T)
    assert (x, y) == pytest.approx((3.0, -2.0), abs=0.02)  # 0.4 m/s between two instants
    assert math.remainder(theta - math.radians(50.0), 2.0 * math.pi) == pytest.approx(0.0, abs=0.01)


def test_the_first_scan_is_such_a_moment(tmp_path: Path) -> None:
    log = late(tmp_path / "late.mcap", "/scan", 7.0)
    session = api.load(log, sets={**POSE, "start.at": "scan"})
    first = float(session.drive.measurements["lrf"].t[0])
    assert 7.0 < first < 7.5
    by_seconds = api.load(log, sets={**POSE, "start.at": first})
    assert session.robot.start == by_seconds.robot.start
    assert any("the pose is that at 7." in note for note in session.notes)


def test_what_the_wheels_are_uncertain_by_until_then_adds_to_the_start() -> None:
    """By the wheels' own noise: the heading's variance of a way there is that of the way back."""
    start = odometry(10.0, **{"start.sigma_theta_deg": 1.0}).robot.start
    plain = api.load(SAMPLE).run("odometry", advice=False).estimates["odometry"]
    of_wheels = math.degrees(math.sqrt(np.interp(10.0, plain.t, plain.triangles[:, 5])))
    assert of_wheels > 1.0
    assert start.sigma_theta_deg == pytest.approx(math.hypot(1.0, of_wheels), rel=0.02)
    back = float(
        np.hypot(*(np.array([np.interp(10.0, plain.t, plain.pose[:, i]) for i in (0, 1)]) - plain.pose[0, :2]))
    )
    assert start.sigma_xy > math.radians(1.0) * back / math.sqrt(2.0)  # the lever of the degree alone


def test_a_truth_that_begins_later_gives_the_start_of_its_moment(tmp_path: Path) -> None:
    """What `info` prints, obeyed, lays the drive on the truth where the truth begins."""
    log = late(tmp_path / "late.mcap", "/ground_truth/pose", 12.0)
    wrong = ("--set", "start.x=0", "--set", "start.y=0", "--set", "start.theta_deg=90")
    report = json.loads(locfuse("info", log, *wrong, "--json").stdout)
    (finding,) = (f for f in report["findings"] if f["code"] == "start")
    fixes = dict(fix.split("=") for fix in finding["fixes"])
    assert 12.0 < float(fixes["start.at"]) < 12.2
    session = api.load(log, sets={key: float(value) for key, value in fixes.items()})
    truth = session.drive.truth
    assert truth is not None
    found = session.run("odometry", advice=False).estimates["odometry"]
    there = [np.interp(truth.t[0], found.t, found.pose[:, axis]) for axis in (0, 1)]
    assert there == pytest.approx(truth.xy[0].tolist(), abs=0.06)


@pytest.mark.parametrize(
    ("at", "says"),
    [
        (1e4, "start.at = 10000: the drive ends at 54.8 s"),
        (-1, "start.at = -1: must be a number >= 0.0"),
        ("noon", "start.at = 'noon': must be a number >= 0.0, or 'scan'"),
    ],
)
def test_a_moment_outside_the_drive_is_one_line(at: Any, says: str) -> None:
    with pytest.raises(LocfuseError, match=says.replace(".", r"\.")):
        api.load(SAMPLE, sets={"start.at": at})


def test_a_log_without_scans_has_no_first_one(tmp_path: Path) -> None:
    log = late(tmp_path / "blind.mcap", "/scan", 1e9)
    with pytest.raises(LocfuseError, match=r'start\.at = "scan": no scan lies within the drive'):
        api.load(log, sets={"start.at": "scan"})
