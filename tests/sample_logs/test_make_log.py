"""The generator of timing logs writes what a public reader finds sensible."""

from __future__ import annotations

import math
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rooms import box, ranges

SCRIPT = Path(__file__).parents[2] / "benchmarks" / "make_log.py"
FIVE_SECONDS = ("--minutes", str(5 / 60), "--image-hz", "2", "--beams", "181", "--walls", "4", "--sweep", "0.05")


def generate(path: Path, *options: str) -> Path:
    subprocess.run([sys.executable, str(SCRIPT), str(path), *options], check=True, capture_output=True)
    return path


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return generate(tmp_path_factory.mktemp("logs") / "five_seconds.mcap", *FIVE_SECONDS)


@pytest.fixture(scope="module")
def messages(log: Path) -> dict[str, list[Any]]:
    found: dict[str, list[Any]] = {}
    with log.open("rb") as file:
        for _, channel, _, message in make_reader(
            file, decoder_factories=[DecoderFactory()]
        ).iter_decoded_messages():
            found.setdefault(channel.topic, []).append(message)
    return found


def seconds(message: Any) -> float:
    return float(message.header.stamp.sec - 1_700_000_000 + message.header.stamp.nanosec * 1e-9)


def pose(message: Any) -> tuple[float, float, float]:
    p, q = message.pose.position, message.pose.orientation
    return p.x, p.y, 2 * math.atan2(q.z, q.w)


def test_every_topic_has_its_rate_times_five_seconds(messages: dict[str, list[Any]]) -> None:
    counts = {topic: len(found) for topic, found in messages.items()}
    assert counts == {
        "/joint_states": 250,
        "/magnetic_field": 100,
        "/scan": 50,
        "/ground_truth": 50,
        "/omni/image/compressed": 10,
    }
    for topic, found in messages.items():
        stamps = [seconds(m) for m in found]
        assert stamps == pytest.approx([i * 5.0 / counts[topic] for i in range(counts[topic])], abs=1e-9)


def test_scans_show_the_room_from_where_the_truth_says(messages: dict[str, list[Any]]) -> None:
    room = box(0.0, 0.0, 10.0, 8.0)
    truth = np.array([pose(m) for m in messages["/ground_truth"]])
    for k in (0, 20, 48):
        scan = messages["/scan"][k]
        beams = np.arange(len(scan.ranges))
        share = beams[:, None] * scan.time_increment / 0.1  # truth comes every 0.1 s, with the scans
        at = truth[k] + share * (truth[k + 1] - truth[k])
        angle = scan.angle_min + beams * scan.angle_increment + at[:, 2]
        residual = np.array(scan.ranges) - ranges(room, at[:, :2], angle)
        assert np.median(residual) == pytest.approx(0.0, abs=0.01)
        assert np.std(residual) == pytest.approx(0.03, abs=0.012)


def test_the_landmark_is_a_red_bar_at_its_bearing(messages: dict[str, list[Any]], log: Path) -> None:
    with log.open("rb") as file:
        robot = tomllib.loads(next(make_reader(file).iter_attachments()).data.decode())
    x, y, theta = pose(messages["/ground_truth"][0])
    image = cv2.imdecode(np.frombuffer(messages["/omni/image/compressed"][0].data, np.uint8), cv2.IMREAD_COLOR)
    assert image is not None
    assert image.shape == (480, 640, 3)
    blue, green, red = (image[..., i].astype(int) for i in range(3))
    v, u = np.nonzero(red - np.maximum(blue, green) > 60)
    centre, landmark = robot["camera"]["centre"], robot["camera"]["landmark"]
    bearing = math.atan2(u.mean() - centre[0], v.mean() - centre[1])
    expected = math.atan2(landmark[1] - y, landmark[0] - x) - theta
    assert math.remainder(bearing - expected, 2 * math.pi) == pytest.approx(0.0, abs=0.02)


def test_the_seed_decides_every_byte(tmp_path: Path, log: Path) -> None:
    assert generate(tmp_path / "again.mcap", *FIVE_SECONDS).read_bytes() == log.read_bytes()
    assert generate(tmp_path / "other.mcap", *FIVE_SECONDS, "--seed", "1").read_bytes() != log.read_bytes()
