"""Clouds, echoes and joints of ros2_control are read as scans and joint states; what was written is the oracle."""

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bags import T0, S, Said, cdr, header, write
from commands import locfuse, refused, reported
from wheel_bags import GEOMETRY, angles, custom, joint_states, log_of, pose_of

from locfuse.formats.logs.adapters import SLICE_BEAMS, level_slice, nearest_to_beams, sweep_of
from locfuse.formats.logs.log import open_log
from locfuse.fusion.data import Array, Ragged

CLOUD, ECHOES = "sensor_msgs/msg/PointCloud2", "sensor_msgs/msg/MultiEchoLaserScan"
LENGTH, WIDTH = 8.0, 6.0  # m of a room; its walls are the oracle
RINGS_RAD = np.radians(np.arange(-15.0, 16.0, 2.0))  # as of a laser of 16 rings
SPEED, RATE_HZ = 0.3, 10.0


def ranges(x: float, bearings: Array) -> Array:
    """How far the walls are from (x, 0) in the middle of the room, looking along its length."""
    with np.errstate(divide="ignore"):
        along = np.where(np.cos(bearings) > 0.0, LENGTH / 2 - x, LENGTH / 2 + x) / np.abs(np.cos(bearings))
        across = (WIDTH / 2 + np.where(np.sin(bearings) > 0.0, -0.5, 0.5)) / np.abs(np.sin(bearings))
    return np.minimum(along, across)


def seen(x: float) -> Array:
    """A cloud (n, 3) [m] of 16 rings from 0.5 m above the floor."""
    bearings = np.radians(np.arange(0.0, 360.0, 0.4))
    away = ranges(x, bearings)
    rings = []
    for elevation in RINGS_RAD:
        far = np.minimum(away, 0.5 / -math.tan(elevation)) if elevation < 0.0 else away  # the floor comes first
        rings.append(np.stack((far * np.cos(bearings), far * np.sin(bearings), far * math.tan(elevation)), -1))
    return np.concatenate(rings)


def cloud(
    ns: int, xyz: Array, frame: str = "velodyne", big: bool = False, kind: str = "f4", times: Any = None
) -> Said:
    """Points with an intensity between them, as drivers pad them; with `times`, each has its own."""
    order = ">" if big else "<"
    size = int(kind[1])
    offsets = [0, size, 2 * size]
    names, kinds = list("xyz"), [order + kind] * 3
    if times is not None:
        names, kinds, offsets = [*names, "t"], [*kinds, times.dtype.str], [*offsets, 3 * size + 4]
    layout = np.dtype({"names": names, "formats": kinds, "offsets": offsets, "itemsize": 3 * size + 12})
    data = np.zeros(len(xyz), layout)
    for i, axis in enumerate("xyz"):
        data[axis] = xyz[:, i]
    if times is not None:
        data["t"] = times
    datatype = {"u4": 6, "f4": 7, "f8": 8}
    fields = [
        {"name": name, "offset": o, "datatype": datatype[one[1:]], "count": 1}
        for name, o, one in zip(names, offsets, kinds, strict=True)
    ]
    fields.append({"name": "intensity", "offset": 3 * size, "datatype": 7, "count": 1})
    message = cdr(
        CLOUD,
        header=header(ns, frame),
        height=1,
        width=len(xyz),
        fields=fields,
        is_bigendian=int(big),
        point_step=layout.itemsize,
        row_step=layout.itemsize * len(xyz),
        data=np.frombuffer(data.tobytes(), np.uint8),
    )
    return Said("/velodyne_points", CLOUD, message, ns)


def stamps(n: int) -> list[int]:
    return [T0 + round(i / RATE_HZ * S) for i in range(n)]


def way_of(out: Path) -> Array:
    rows = np.loadtxt(out / "trajectory.tum")
    return rows[-1, 1:3] - rows[0, 1:3]


def test_a_cloud_of_rings_is_a_laser_that_says_how_the_robot_moved(tmp_path: Path) -> None:
    n = 41
    said = [cloud(ns, seen(SPEED * i / RATE_HZ)) for i, ns in enumerate(stamps(n))]
    log = write(tmp_path / "x.mcap", said)
    done = reported("run", log, "--no-advice", "--write", "json,tum")
    assert way_of(done.out) == pytest.approx([SPEED * (n - 1) / RATE_HZ, 0.0], abs=0.02)
    assert "matched from scan to scan of /velodyne_points:scan" in json.dumps(done.report)
    info = locfuse("info", log).stdout
    assert "/velodyne_points:scan" in info
    drafted = locfuse("init", log).stdout
    assert 'topic = "/velodyne_points:scan"' in drafted


@pytest.mark.parametrize("kind", ["f4", "f8"])
@pytest.mark.parametrize("big", [False, True])
def test_every_beam_of_the_slice_is_the_wall_at_its_bearing(kind: str, big: bool, tmp_path: Path) -> None:
    log = open_log([write(tmp_path / "x.mcap", [cloud(T0, seen(0.0), big=big, kind=kind)])])
    (stream,) = (log.stream("/velodyne_points:scan"),)
    columns: Any = stream.columns("angle_min", "angle_increment", "ranges")
    bearings = columns["angle_min"][0] + columns["angle_increment"][0] * np.arange(SLICE_BEAMS)
    off = np.radians(0.25)  # a beam stands for half a degree
    expected = np.stack([ranges(0.0, bearings + d) for d in np.linspace(-off, off, 11)])
    found = columns["ranges"][0]
    assert (found >= expected.min(axis=0) - 1e-4).all()
    assert (found <= expected.max(axis=0) + 1e-4).all()


@pytest.mark.parametrize("way", [1, -1])
@pytest.mark.parametrize("told", ["s, stamped at the end", "ns, stamped at the start", "s, dates"])
def test_beams_of_a_spinning_laser_have_the_times_of_their_points(told: str, way: int, tmp_path: Path) -> None:
    lasts, begins_at = 0.1, math.radians(40.0)
    share = np.arange(1800) / 1800
    bearings = begins_at + way * 2.0 * math.pi * share
    away = ranges(0.0, bearings)
    xyz = np.stack((away * np.cos(bearings), away * np.sin(bearings), np.zeros(1800)), -1)
    begin = T0 * 1e-9  # s, when the first point was measured
    ns, times = {
        "s, stamped at the end": (T0 + round(lasts * S), lasts * (share - 1.0)),
        "ns, stamped at the start": (T0, (lasts * share * S).astype(np.uint32)),
        "s, dates": (T0 + round(0.5 * lasts * S), begin + lasts * share),
    }[told]
    log = open_log([write(tmp_path / "x.mcap", [cloud(ns, xyz, times=times)])])
    stream = log.stream("/velodyne_points:scan")
    scan: Any = stream.columns("angle_min", "angle_increment", "time_increment", "ranges")
    beams = np.arange(SLICE_BEAMS)
    at = stream.t_ns[0] * 1e-9 + beams * scan["time_increment"][0] - begin
    angles = scan["angle_min"][0] + beams * scan["angle_increment"][0]
    expected = (way * (angles - begins_at) / (2.0 * math.pi) % 1.0) * lasts
    assert at == pytest.approx(expected, abs=lasts / SLICE_BEAMS)
    assert scan["ranges"][0] == pytest.approx(ranges(0.0, angles), rel=0.01)


def test_points_in_a_pattern_have_the_time_of_their_middle() -> None:
    rng = np.random.default_rng(0)
    t = rng.uniform(2.0, 2.1, 500)
    *_, each, begin = sweep_of(rng.uniform(0.0, SLICE_BEAMS, 500), t)
    assert each == 0.0
    assert begin == pytest.approx(2.05, abs=0.01)


def test_of_a_picture_of_depth_the_axis_ahead_is_the_third() -> None:
    cloud = np.array([[0.0, 0.0, 3.0, np.nan], [1.0, -0.05, 2.0, np.nan]])  # x right, y down, z ahead
    ahead = nearest_to_beams(*level_slice(cloud, optical=True)[:2])
    beams = -math.pi + (np.arange(SLICE_BEAMS) + 0.5) * 2 * math.pi / SLICE_BEAMS
    hit = np.flatnonzero(np.isfinite(ahead))
    assert beams[hit] == pytest.approx([math.atan2(-1.0, 2.0), 0.0], abs=np.radians(0.26))
    assert ahead[hit] == pytest.approx([math.hypot(1.0, 2.0), 3.0])


def test_a_cloud_that_is_a_map_is_no_laser(tmp_path: Path) -> None:
    said = [cloud(ns, seen(0.0), frame="map") for ns in stamps(10)]
    refusal = refused("run", write(tmp_path / "x.mcap", said), "-o", tmp_path / "out")
    assert "the robot's motion is unknown" in refusal


@pytest.mark.parametrize("step", [0, 8, 2**32 - 1])
def test_a_cloud_whose_fields_lie_outside_its_points_gives_no_beam(step: int, tmp_path: Path) -> None:
    message = cdr(
        CLOUD,
        header=header(T0, "velodyne"),
        height=1,
        width=2,
        fields=[{"name": n, "offset": 4 * i, "datatype": 7, "count": 1} for i, n in enumerate("xyz")],
        point_step=step,
        row_step=16,
        data=np.zeros(16, np.uint8),
    )
    log = open_log([write(tmp_path / "x.mcap", [Said("/points", CLOUD, message, T0)])])
    columns: Any = log.stream("/points:scan").columns("ranges")
    assert np.isinf(columns["ranges"][0]).all()


def test_the_first_echo_of_a_beam_counts_and_none_is_no_return(tmp_path: Path) -> None:
    beams = [[1.5, 4.0], [], [2.5], [3.0, 3.5, 9.0]]
    rows = [beams, [[7.0], [8.0], [], []]]  # of another pattern
    said = [
        Said(
            "/laser",
            ECHOES,
            cdr(
                ECHOES,
                header=header(ns, "laser"),
                angle_min=-0.1,
                angle_increment=0.05,
                range_max=30.0,
                ranges=[{"echoes": e} for e in row],
            ),
            ns,
        )
        for ns, row in zip(stamps(2), rows, strict=True)
    ]
    log = open_log([write(tmp_path / "x.mcap", said)])
    columns: Any = log.stream("/laser:scan").columns("ranges", "angle_min")
    assert columns["ranges"][0].tolist() == [1.5, math.inf, 2.5, 3.0]
    assert columns["ranges"][1].tolist() == [7.0, 8.0, math.inf, math.inf]
    assert columns["angle_min"] == pytest.approx(-0.1)
    assert [len(r) for _, c in log.stream("/laser:scan").blocks("ranges") for r in [c["ranges"]]] == [2]
    locfuse("info", write(tmp_path / "y.mcap", said))  # is read as lrf's
    assert json.loads(locfuse("info", tmp_path / "y.mcap", "--json").stdout)["roles"]["lrf"]["topics"] == [
        "/laser:scan"
    ]


DYNAMIC = "control_msgs/msg/DynamicJointState"
DYNAMIC_TEXT = (
    "std_msgs/Header header\nstring[] joint_names\ncontrol_msgs/InterfaceValue[] interface_values\n"
    f"{'=' * 80}\nMSG: control_msgs/InterfaceValue\nstring[] interface_names\nfloat64[] values\n"
)


def dynamic(path: Path, t: Array, angle: Array) -> Path:
    """Messages of two wheels and a gripper whose interfaces differ in number and order."""
    names = ["left_wheel_joint", "gripper", "right_wheel_joint"]
    rows = [
        {
            "joint_names": names,
            "interface_values": [
                {"interface_names": ["velocity", "position"], "values": [9.0, left]},
                {"interface_names": ["effort"] * (i % 2), "values": [1.0] * (i % 2)},
                {"interface_names": ["position"], "values": [right]},
            ],
        }
        for i, (left, right) in enumerate(angle.tolist())
    ]
    return custom(path, "/dynamic_joint_states", DYNAMIC, DYNAMIC_TEXT, t, rows)


def test_joints_of_ros2_control_drive_as_joint_states_do(tmp_path: Path) -> None:
    t, angle = angles()
    log = dynamic(tmp_path / "x.mcap", t, angle)
    done = reported("run", log, "--no-advice", "--write", "json,tum", *GEOMETRY)
    rows = np.loadtxt(done.out / "trajectory.tum")
    assert rows[-1, 1:3] == pytest.approx(pose_of(angle)[:2], abs=1e-9)
    assert "/dynamic_joint_states:joints" in json.dumps(done.report)
    columns: Any = open_log([log]).stream("/dynamic_joint_states:joints").columns("name", "position", "velocity")
    assert columns["name"][1] == ("left_wheel_joint", "gripper", "right_wheel_joint")
    position: Ragged = columns["position"]
    np.testing.assert_array_equal(position[1], [angle[1, 0], np.nan, angle[1, 1]])
    np.testing.assert_array_equal(columns["velocity"][0], [9.0, np.nan, np.nan])


def test_joint_states_are_taken_before_joints_of_ros2_control(tmp_path: Path) -> None:
    """Of two files of one folder, recorded at the same time."""
    t, angle = angles()
    log_of(tmp_path / "bag_0.mcap", joint_states(t, angle))
    dynamic(tmp_path / "bag_1.mcap", t, angle)
    both = json.loads(locfuse("info", tmp_path, "--json").stdout)
    assert both["roles"]["wheels"]["topics"] == ["/joint_states"]
