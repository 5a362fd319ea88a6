"""Numbers inside messages of any type, and bags without definitions recorded under older ROS releases."""

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bags import T0, Said, build, cdr, database, header
from commands import locfuse, ok, refused
from rosbags.typesys import Stores, get_typestore
from wheel_bags import GEOMETRY, RADIUS, TRACK, angles, joint_states, log_of, stamps

from locfuse.formats.logs.log import open_log

VECTOR = "geometry_msgs/msg/Vector3Stamped"
RANGE = "sensor_msgs/msg/Range"


def log_with_vector(path: Path) -> Path:
    """Vector3Stamped as a driver may misuse it: x is a compass heading in degrees, y a yaw rate in degrees/s."""
    t, angle = angles(30.0)
    theta = (angle[:, 1] - angle[:, 0]) * RADIUS / TRACK
    rate = np.gradient(theta, t)
    said = [
        Said(
            "/ahrs",
            VECTOR,
            cdr(
                VECTOR, header=header(ns), vector={"x": math.degrees(math.pi / 2 - th) % 360, "y": math.degrees(w)}
            ),
            ns,
        )
        for ns, th, w in list(zip(stamps(t), theta, rate, strict=True))[::5]
    ]
    return log_of(path, joint_states(t, angle), said)


def test_a_number_of_any_message_is_a_compass_or_a_gyro(tmp_path: Path) -> None:
    log = log_with_vector(tmp_path / "x.mcap")
    compass = (
        "compass.topic=/ahrs",
        "compass.field=vector.x",
        "compass.unit=deg",
        "compass.convention=compass_rad",
    )
    gyro = ("gyro.topic=/ahrs", "gyro.field=vector.y", "gyro.unit=deg")
    sets = [word for key in (*compass, *gyro) for word in ("--set", key)]
    done = ok("compare", log, "--no-advice", *GEOMETRY, *sets, "-o", tmp_path / "out", "--json")
    report: dict[str, Any] = json.loads(done.stdout)["configurations"]
    assert {"compass", "gyro", "all"} <= report.keys()
    for name in ("compass", "gyro"):
        figures = report[name]["sensors"][name]
        assert figures["rejected"] == 0
        assert figures["nis"] < 0.5  # the numbers are exact: far fewer than the noise that is assumed
    info = locfuse("info", log, *GEOMETRY, *sets).stdout
    assert "/ahrs:vector.x" in info


@pytest.mark.parametrize(
    ("field", "says"),
    [
        ("vector.w", "vector has no field 'w'"),
        ("header.frame_id", "is a text, not a number"),
        ("vector", "structure"),
    ],
)
def test_a_field_that_is_no_number_is_refused_in_one_line(field: str, says: str, tmp_path: Path) -> None:
    log = log_with_vector(tmp_path / "x.mcap")
    words = ("--set", "compass.topic=/ahrs", "--set", f"compass.field={field}")
    refusal = refused("run", log, *GEOMETRY, *words, "-o", tmp_path / "out")
    assert says in refusal


@pytest.mark.parametrize("release", [Stores.ROS2_FOXY, Stores.ROS2_HUMBLE, Stores.ROS2_JAZZY, Stores.LATEST])
def test_ranges_of_every_ros_release_are_read_in_bags_without_definitions(release: Stores, tmp_path: Path) -> None:
    store = get_typestore(release)
    rows = [
        {"header": header(T0 + i * 10**8, "s" * (i % 3)), "max_range": 4.0, "range": 0.5 + 0.25 * i}
        for i in range(8)
    ]
    messages = [bytes(store.serialize_cdr(build(RANGE, store, **row), RANGE)) for row in rows]
    stream = open_log([database(tmp_path / "x.db3", "/sonar", RANGE, messages)]).stream("/sonar")
    values = stream.columns("range", "max_range")
    np.testing.assert_array_equal(values["range"], 0.5 + 0.25 * np.arange(8))
    np.testing.assert_array_equal(values["max_range"], np.full(8, 4.0))
    assert dict(stream.dropped) == {}
