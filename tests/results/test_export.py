"""--export, read back by others (mcap-ros2-support, rosbags, Rerun, evo) and held to trajectory.tum and .csv."""

import json
import re
import subprocess
import sys
import warnings
from collections import Counter
from collections.abc import Callable
from operator import attrgetter
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np
import pytest
from bags import S, drive, real_log, write
from commands import locfuse, ok, refused
from hostile import Put, write as sample_write
from mcap.reader import NonSeekingReader, make_reader
from mcap_ros2.decoder import DecoderFactory
from msgspec.structs import replace
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

import locfuse as api
from locfuse import sample_logs
from locfuse.formats.container.file_bytes import FileBytes, Losses
from locfuse.formats.container.mcap_source import McapSource
from locfuse.formats.results.mcap_export import Export, ros_name
from locfuse.fusion.data import Array, LocfuseError, Truth
from locfuse.fusion.fuse import fuse

LOG = "rounded_rectangle"
ROBOT = {"robot.toml": b"[wheels]\nradius = 0.05\ntrack = 0.4\n"}
Topics = dict[str, list[tuple[Any, int]]]
LAST_BIT = 3e-16  # NumPy's sine against that of the C library


@pytest.fixture(scope="module")
def ran(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("run")
    words = ("--no-advice", "--no-smooth", "--write", "all", "--export", "mcap,log,kitti,tum-cov", "-q")
    ok("run", LOG, *words, "-o", out)
    return out


@pytest.fixture(scope="module")
def topics(ran: Path) -> Topics:
    return decoded(ran / "estimates.mcap")


def decoded(path: Path) -> Topics:
    """(message, log time) by topic, as mcap-ros2-support reads them by the schemas in the file."""
    found: Topics = {}
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        for _, channel, raw, message in reader.iter_decoded_messages():
            found.setdefault(channel.topic, []).append((message, raw.log_time))
    return found


def stamp(message: Any) -> int:
    return int(message.header.stamp.sec) * S + int(message.header.stamp.nanosec)


def table(path: Path, **options: Any) -> Array:
    return np.loadtxt(path, ndmin=2, **options)


def seven(pose: Any) -> list[float]:
    p, q = (
        getattr(pose, a, None) or getattr(pose, b)
        for a, b in (("position", "translation"), ("orientation", "rotation"))
    )
    return [p.x, p.y, p.z, q.x, q.y, q.z, q.w]


def stamps_of(path: Path) -> list[int]:
    """The first column of a text, exact."""
    words = [re.split("[ ,]", line)[0] for line in path.read_text().splitlines() if line[0].isdigit()]
    return [int(w.replace(".", "")) for w in words]


def test_odometry_is_the_trajectory_with_its_covariances(ran: Path, topics: Topics) -> None:
    messages = [m for m, _ in topics["/locfuse/all/odometry"]]
    assert [stamp(m) for m in messages] == stamps_of(ran / "trajectory.tum")
    wanted = table(ran / "trajectory.tum")[:, 1:]
    np.testing.assert_allclose([seven(m.pose.pose) for m in messages], wanted, rtol=0, atol=LAST_BIT)
    P = np.array([m.pose.covariance for m in messages]).reshape(-1, 6, 6)
    csv = table(ran / "trajectory.csv", delimiter=",", skiprows=1)
    for column, (i, j) in enumerate(((0, 0), (0, 1), (0, 5), (1, 1), (1, 5), (5, 5)), start=4):
        np.testing.assert_array_equal(P[:, i, j], csv[:, column])
        np.testing.assert_array_equal(P[:, j, i], csv[:, column])
    assert np.count_nonzero(P[-1]) == 9
    assert {(m.header.frame_id, m.child_frame_id) for m in messages} == {("map", "all/base_link")}


def test_the_twist_is_what_the_wheels_did(topics: Topics) -> None:
    """Held to the truth's own motion, of 0.3 m/s at most, over quarters of a second."""
    odometry = [m for m, _ in topics["/locfuse/all/odometry"]]
    t = np.array([stamp(m) for m in odometry]) / S
    v, w = (
        np.array(x)
        for x in zip(*((m.twist.twist.linear.x, m.twist.twist.angular.z) for m in odometry), strict=True)
    )
    truth = np.array([[stamp(m) / S, *seven(m.pose)[:2]] for m, _ in topics["/ground_truth/pose"]])
    speed = np.hypot(*np.diff(truth[::12, 1:], axis=0).T) / np.diff(truth[::12, 0])
    middle = 0.5 * (truth[::12, 0][1:] + truth[::12, 0][:-1])
    assert np.abs(np.interp(middle, t, v) - speed).max() < 0.1
    assert np.abs(w).max() < 2.0


def test_path_tf_and_truth_say_the_same(ran: Path, topics: Topics) -> None:
    tum = dict(zip(stamps_of(ran / "trajectory.tum"), table(ran / "trajectory.tum")[:, 1:], strict=True))
    ((path, at),) = topics["/locfuse/all/path"]
    assert at == min(tum)
    assert len(path.poses) == 2000
    assert {min(tum), max(tum)} <= {stamp(p) for p in path.poses}
    for p in path.poses:
        np.testing.assert_allclose(seven(p.pose), tum[stamp(p)], rtol=0, atol=LAST_BIT)
    edges = [one for m, _ in topics["/tf"] for one in m.transforms]
    assert Counter(e.child_frame_id for e in edges) == {"all/base_link": len(tum), "base_link": len(tum)}
    wanted = [tum[stamp(e)] for e in edges]
    np.testing.assert_allclose([seven(e.transform) for e in edges], wanted, rtol=0, atol=LAST_BIT)
    for (pose, _), (again, _) in zip(topics["/ground_truth/pose"], topics["/locfuse/truth/pose"], strict=True):
        assert stamp(pose) == stamp(again)
        same, other = np.array(seven(again.pose)), np.array(seven(pose.pose))
        other[3:] *= np.sign(same[6] * other[6])  # q and -q are one rotation
        np.testing.assert_allclose(same, other, atol=1e-12)


def test_the_logs_own_messages_are_copied_with_bytes_and_times(ran: Path) -> None:
    def raw(path: Path) -> Counter[Any]:
        with path.open("rb") as file:
            every = make_reader(file, validate_crcs=True).iter_messages()
            return Counter(
                (c.topic, s.name, s.data, c.message_encoding, m.log_time, m.sequence, m.data)
                for s, c, m in every
                if s
            )

    original, copied = raw(sample_logs.path(LOG)), raw(ran / "estimates.mcap")
    assert original <= copied
    assert {topic for topic, *_ in copied - original} == {
        "/tf",
        *(f"/locfuse/{t}" for t in ("all/odometry", "all/path", "truth/pose", "truth/path")),
    }


def test_a_copy_of_the_log_runs_to_the_same_trajectory(ran: Path, tmp_path: Path) -> None:
    ok("run", ran / "estimates.mcap", "--no-advice", "-o", tmp_path, "--write", "tum")
    assert (tmp_path / "trajectory.tum").read_bytes() == (ran / "trajectory.tum").read_bytes()


def test_the_file_is_sound_to_every_reader(ran: Path) -> None:
    path = ran / "estimates.mcap"
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        summary = reader.get_summary()
        times = [m.log_time for _, _, m in reader.iter_messages()]
        assert reader.get_header().profile == "ros2"
    assert summary is not None
    assert summary.statistics is not None
    assert summary.statistics.message_count == len(times)
    assert times == sorted(times)
    assert (summary.statistics.message_start_time, summary.statistics.message_end_time) == (times[0], times[-1])
    with path.open("rb") as file:  # without the summary, every checksum looked at
        assert sum(1 for _ in NonSeekingReader(file, validate_crcs=True).iter_messages()) == len(times)
    with AnyReader([path]) as bag:
        assert sum(1 for c, _, raw in bag.messages() if bag.deserialize(raw, c.msgtype)) == len(times)
    losses = Losses()
    assert McapSource(FileBytes(path, losses)).checked
    assert not losses
    rerun = Path(sys.executable).parent / "rerun"
    checked = subprocess.run([rerun, "mcap", "check", path], capture_output=True, text=True, check=False)
    assert checked.returncode == 0, checked.stderr


def test_the_same_run_gives_the_same_bytes(ran: Path, tmp_path: Path) -> None:
    words = ("--no-advice", "--no-smooth", "--write", "all", "--export", "mcap,log,kitti,tum-cov", "-q")
    locfuse("run", LOG, *words, "-o", tmp_path)
    for path in ran.iterdir():
        assert (tmp_path / path.name).read_bytes() == path.read_bytes(), path.name


def test_kitti_and_tum_are_the_same_trajectory_and_covariances_name_their_columns(ran: Path) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        from evo.tools import file_interface

        tum = file_interface.read_tum_trajectory_file(str(ran / "trajectory.tum"))
        kitti = file_interface.read_kitti_poses_file(str(ran / "trajectory_kitti.txt"))
    np.testing.assert_allclose(kitti.poses_se3, tum.poses_se3, atol=1e-12)
    assert stamps_of(ran / "trajectory_kitti_times.txt") == stamps_of(ran / "trajectory.tum")
    header, *lines = (ran / "trajectory_cov.tum").read_text().splitlines()
    names = header.split("triangle: ")[1].split()
    assert len(names) == 21
    rows = np.array([line.split() for line in lines], np.float64)
    np.testing.assert_array_equal(rows[:, :8], table(ran / "trajectory.tum"))
    csv = table(ran / "trajectory.csv", delimiter=",", skiprows=1)
    shown = ("P_x_x", "P_x_y", "P_x_yaw", "P_y_y", "P_y_yaw", "P_yaw_yaw")
    for column, name in enumerate(shown, start=4):
        np.testing.assert_array_equal(rows[:, 8 + names.index(name)], csv[:, column])
    others = [8 + i for i, name in enumerate(names) if name not in shown]
    assert not rows[:, others].any()


def test_compare_exports_every_configuration_under_a_name_that_ros_allows(tmp_path: Path) -> None:
    sets = [w for s in ("odometry", "compass,lrf", "lrf@2Hz") for w in ("--sensors", s)]
    words = ("--write", "tum,json", "--export", "mcap,csv,kitti", "--no-advice", "-q", "--to", 8)
    ok("compare", LOG, *sets, *words, "-o", tmp_path)
    topics = decoded(tmp_path / "estimates.mcap")
    for name in json.loads((tmp_path / "report.json").read_text())["configurations"]:
        messages = [m for m, _ in topics[f"/locfuse/{ros_name(name)}/odometry"]]
        np.testing.assert_array_equal(
            [seven(m.pose.pose) for m in messages], table(tmp_path / f"{name}.tum")[:, 1:]
        )
        assert (tmp_path / f"{name}.csv").exists()
        assert (tmp_path / f"{name}_kitti.txt").exists()
    assert all(re.fullmatch(r"(/[A-Za-z_][A-Za-z0-9_]*)+", topic) for topic in topics)
    assert f"/locfuse/{ros_name('compass+lrf')}/odometry" in topics
    layouts_name_what_is_there(tmp_path, topics, 4, 1)  # one of them smoothed


def layouts_name_what_is_there(folder: Path, topics: Topics, results: int, truth: int) -> None:
    """Every topic and field of both layouts is in the file, and no result is missing."""
    layout = json.loads((folder / "estimates.foxglove.json").read_text())
    panels = layout["configById"]
    assert set(re.findall(r'"(?:first|second)": "([^"]+)"', json.dumps(layout["layout"]))) == set(panels)
    assert set(panels.pop("3D!map")["topics"]) == {name for name in topics if name.startswith("/locfuse/")}
    shown = [line["value"].split(".", 1) for panel in panels.values() for line in panel["paths"]]
    assert len(shown) == 3 * results + 2 * truth  # x, y, turn rate
    curves = list(ET.parse(folder / "estimates.plotjuggler.xml").iter("curve"))
    assert len(curves) == len(shown) + results + truth  # and x against y
    for curve in curves:
        for series in (
            [curve.get("curve_x"), curve.get("curve_y")] if curve.get("curve_x") else [curve.get("name")]
        ):
            (topic,) = (name for name in topics if str(series).startswith(f"{name}/"))
            shown.append([topic, str(series).removeprefix(f"{topic}/").replace("/", ".")])
    assert all(isinstance(attrgetter(path)(topics[topic][0][0]), float) for topic, path in shown)


def test_a_frame_has_one_parent_where_the_log_has_a_tf_of_its_own(tmp_path: Path) -> None:
    bag = real_log("turtlebot4")
    words = ("--no-advice", "--no-smooth", "--export", "log", "--write", "json", "-q")
    ok("run", bag, *words, "-o", tmp_path)
    parents: dict[str, set[str]] = {}
    for topic, messages in decoded(tmp_path / "estimates.mcap").items():
        for m, _ in messages if topic == "/tf" else ():
            for edge in m.transforms:
                parents.setdefault(edge.child_frame_id, set()).add(edge.header.frame_id)
    assert parents["lrf/base_link"] == {"map"}
    assert all(len(one) == 1 for one in parents.values())


def test_a_sqlite3_bag_is_copied_too(tmp_path: Path) -> None:
    bag = real_log("turtlebot4/db3")
    words = ("--sensors", "odometry", "--no-advice", "--export", "log", "--write", "json", "-q")
    ok("run", bag, *words, "-o", tmp_path)
    store = get_typestore(Stores.ROS2_HUMBLE)  # such bags hold no definitions, copies of them do
    with AnyReader([bag], default_typestore=store) as original, AnyReader([tmp_path / "estimates.mcap"]) as copy:
        wanted = Counter((c.topic, t, bytes(raw)) for c, t, raw in original.messages())
        assert wanted <= Counter((c.topic, t, bytes(raw)) for c, t, raw in copy.messages())


def test_messages_are_recorded_in_the_logs_clock_where_it_keeps_two(tmp_path: Path) -> None:
    bag = real_log("bags/evo/nav2_turtlebot.mcap")
    ok("run", bag, "--no-advice", "-o", tmp_path, "--export", "mcap,log", "--write", "tum,json", "-q")
    topics = decoded(tmp_path / "estimates.mcap")
    ours, theirs = topics["/locfuse/odometry/odometry"], topics["/odom"]
    assert [stamp(m) for m, _ in ours] == stamps_of(tmp_path / "trajectory.tum")
    assert abs(ours[0][1] - theirs[0][1]) < S
    assert abs(ours[-1][1] - theirs[-1][1]) < S


@pytest.mark.parametrize(("word", "estimates"), [("--no-smooth", 1), ("--smooth", 2)])
def test_without_truth_or_with_a_smoothed_estimate(tmp_path: Path, word: str, estimates: int) -> None:
    log = write(tmp_path / "x.mcap", drive(100), attachments=ROBOT)
    ok("run", log, "--no-advice", "-o", tmp_path / "out", "--export", "mcap,tum-cov", word)
    topics = decoded(tmp_path / "out" / "estimates.mcap")
    assert len([t for t in topics if t.endswith("/odometry")]) == estimates
    assert not any("truth" in t for t in topics)
    layouts_name_what_is_there(tmp_path / "out", topics, estimates, 0)


# --- exports of logs whose recording clock is none of ROS' times


@pytest.mark.parametrize(
    "clock",
    [lambda n, ns, first: 2 if n % 6 == 0 else ns, lambda n, ns, first: max(ns - first - S, 0)],
    ids=["a sixth at log time 2", "from zero a second after the stamps"],
)
def test_a_recording_clock_below_zero_is_written_as_zero(clock: Callable[..., int], tmp_path: Path) -> None:
    seen: list[int] = []

    def changed(put: Put) -> Put:
        seen.append(put.log_time)
        return put._replace(log_time=clock(len(seen), put.log_time, seen[0]))

    log = sample_write(tmp_path / "f.mcap", changed)
    done = locfuse("run", log, "--no-advice", "-o", tmp_path / "o", "--export", "mcap")
    assert done.exit_code in {0, 3}, done.stderr
    with (tmp_path / "o" / "estimates.mcap").open("rb") as file:
        times = [m.log_time for _, _, m in make_reader(file, validate_crcs=True).iter_messages()]
    assert times
    assert min(times) >= 0


def test_times_that_no_ros_stamp_holds_are_refused_in_one_line(tmp_path: Path) -> None:
    log = sample_write(tmp_path / "f.mcap", lambda put: put._replace(log_time=put.log_time + 10**18))
    words = ("run", log, "--no-advice", "-o", tmp_path / "o", "--order", "recorded")
    assert "January 2038" in refused(*words, "--export", "mcap")
    assert not (tmp_path / "o").exists()
    assert locfuse(*words).exit_code in {0, 3}


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
