"""References as people have them: a file beside the log, two frames of /tf, mocap bodies, satellite fixes."""

import math
import tracemalloc
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest
from bags import Said, cdr, header
from commands import locfuse, refused, reported
from evo.core import metrics, sync
from evo.tools import file_interface
from hostile import sample, write as sample_write
from msgspec.structs import replace
from pose_streams import pose_stream
from present import present
from wheel_bags import custom, log_of, stamps

from locfuse.cli.analysis.choose import choose_truth
from locfuse.cli.analysis.robot_tables import make_robot
from locfuse.cli.analysis.topics import Choice
from locfuse.formats import inputs
from locfuse.formats.logs.clock import MadeStream
from locfuse.formats.logs.file_stream import read_file
from locfuse.formats.logs.log import open_log
from locfuse.formats.report.html import _strips
from locfuse.fusion.data import Array, LocfuseError, Stream
from locfuse.fusion.robot import TruthSettings
from locfuse.fusion.truth import heading_notes, read_truth

SAMPLE = "rounded_rectangle"
WHEELS = ("--sensors", "odometry", "--write", "json,tum,csv")


def error(log: Any, out: Path, *words: Any) -> float:
    done = reported("compare", log, "--no-advice", "-o", out, "--overwrite", *WHEELS, *words)
    return float(done.rows["odometry"]["position_rmse_m"])


@pytest.fixture(scope="module")
def own(tmp_path_factory: pytest.TempPathFactory) -> tuple[float, list[str]]:
    """The error by the truth in the log, and the lines of its truth.tum."""
    out = tmp_path_factory.mktemp("own") / "out"
    return error(SAMPLE, out), (out / "truth.tum").read_text().splitlines()


def test_the_truth_as_a_file_gives_what_the_truth_in_the_log_gives_and_what_evo_says(
    tmp_path: Path, own: tuple[float, list[str]]
) -> None:
    truth = tmp_path / "truth.tum"
    truth.write_text("\n".join(own[1]) + "\n")
    by_file = error(SAMPLE, tmp_path / "file", "--truth", truth)
    assert by_file == pytest.approx(own[0], abs=1e-9)
    reference = file_interface.read_tum_trajectory_file(str(truth))
    estimate = file_interface.read_tum_trajectory_file(str(tmp_path / "file" / "odometry.tum"))
    ape = metrics.APE(metrics.PoseRelation.translation_part)
    ape.process_data(sync.associate_trajectories(reference, estimate, max_diff=1e-6))
    assert by_file == pytest.approx(ape.get_statistic(metrics.StatisticsType.rmse), abs=1e-9)


def test_a_csv_of_poses_says_the_same_as_the_tum_file(tmp_path: Path, own: tuple[float, list[str]]) -> None:
    rows = [line.split() for line in own[1]]
    named = tmp_path / "truth.csv"
    heading = [2.0 * math.atan2(float(r[6]), float(r[7])) for r in rows]
    lines = [f"{r[0]},{r[1]},{r[2]},{h!r}" for r, h in zip(rows, heading, strict=True)]
    named.write_text("\n".join(("# t,x,y,theta", *lines)) + "\n")
    assert error(SAMPLE, tmp_path / "csv", "--truth", named) == pytest.approx(own[0], abs=1e-9)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("t,x,y\n1,2\n", "line 2 has 2 values, the first line names 3"),
        ("t,x,y\n1,2,north\n", "line 2: 'north' is no number"),
        ("x,y\n1,2\n", "names no column t"),
        ("t,a,b\n1,2,3\n", "x and y of poses, or id, range and bearing"),
        ("t,x,y\n", "holds no readings"),
        ("", "is empty"),
        ("t,x,y\n1,2,3\n", "another drive or, if both began together, another clock"),
    ],
)
def test_a_file_that_is_none_is_refused_in_one_line(text: str, says: str, tmp_path: Path) -> None:
    path = tmp_path / "truth.csv"
    path.write_text(text)
    refusal = refused("compare", SAMPLE, "--no-advice", "-o", tmp_path / "out", "--truth", path)
    assert says in refusal


TURN = np.linspace(0.0, 5.5, 200)


@pytest.mark.parametrize(
    ("name", "head", "row", "words"),
    [
        ("t.csv", "t,x,y,theta\n", "{t!r},{x!r},{y!r},{t!r}", ""),
        ("t.csv", "t,x,y,theta\n", "{t!r},{x!r},{y!r},{degrees!r}", "theta reaches 315: it looks like degrees"),
        ("t.tum", "", "{t} 1 2 0 0 0 {s} {c}", ""),
        ("t.tum", "", "{t} 1 2 0 {c} 0 0 {s}", "qw seems to come first"),
    ],
)
def test_headings_in_degrees_and_quaternions_that_begin_with_qw_are_refused(
    tmp_path: Path, name: str, head: str, row: str, words: str
) -> None:
    places = [
        {"t": t, "s": math.sin(t / 2), "c": math.cos(t / 2), "x": math.sin(t), "y": -math.cos(t)}
        | {"degrees": math.degrees(t)}
        for t in TURN.tolist()
    ]
    text = head + "".join(row.format(**place) + "\n" for place in places)
    if words:
        with pytest.raises(LocfuseError, match=words):
            streamed(tmp_path / name, text)
    else:
        assert len(streamed(tmp_path / name, text).t_ns) == len(TURN)


def test_a_tum_of_another_clock_is_refused_and_the_offset_that_it_names_fits(
    tmp_path: Path, own: tuple[float, list[str]]
) -> None:
    rows = [line.split() for line in own[1]]
    zero = float(rows[0][0])
    path = tmp_path / "gt.tum"
    path.write_text("".join(f"{float(r[0]) - zero:.9f} {' '.join(r[1:])}\n" for r in rows))
    refusal = refused("compare", SAMPLE, "--no-advice", "-o", tmp_path / "out", "--truth", path)
    offset = refusal.split("--set ")[1].strip()
    shifted = error(SAMPLE, tmp_path / "shifted", "--truth", path, "--set", offset)
    assert shifted == pytest.approx(own[0], rel=0.01)


T = np.arange(0.0, 10.0, 0.1)
PATH = np.stack((0.3 * T, np.sin(0.2 * T)), axis=-1)
BODIES = "mocap4r2_msgs/msg/RigidBodies"
BODIES_TEXT = """std_msgs/Header header
uint32 frame_number
mocap4r2_msgs/RigidBody[] rigidbodies
================================================================================
MSG: mocap4r2_msgs/RigidBody
string rigid_body_name
mocap4r2_msgs/Marker[] markers
geometry_msgs/Pose pose
================================================================================
MSG: mocap4r2_msgs/Marker
int8 id_type
int32 marker_index
string marker_name
geometry_msgs/Point translation
"""


def body(name: str, xy: Array, markers: int) -> dict[str, Any]:
    half = 0.5 * float(xy[0])  # its heading is its x
    pose = {"position": {"x": xy[0], "y": xy[1]}, "orientation": {"z": math.sin(half), "w": math.cos(half)}}
    return {"rigid_body_name": name, "pose": pose, "markers": [{"marker_name": "m"}] * markers}


def test_one_of_several_mocap_bodies_is_read_by_its_name(tmp_path: Path) -> None:
    """Bodies change places, carry markers, and are hidden now and then."""
    rows = []
    for i, xy in enumerate(PATH):
        bodies = [body("a cart", xy + 5.0, 2)] + ([body("robot", xy, i % 3)] if i % 7 else [])
        rows.append({"rigidbodies": bodies[:: (-1) ** i]})
    log = open_log([custom(tmp_path / "x.mcap", "/rigid_bodies", BODIES, BODIES_TEXT, T, rows)])
    stream = log.stream("/rigid_bodies")
    truth, dropped = read_truth(stream, TruthSettings(body="robot"), int(stream.t_ns[0]))
    seen = np.arange(len(T)) % 7 > 0
    np.testing.assert_allclose(truth.xy, PATH[seen], atol=1e-12)
    assert truth.theta is not None
    np.testing.assert_allclose(np.cos(truth.theta - PATH[seen, 0]), 1.0, atol=1e-12)
    assert dropped == {"other_bodies": int((~seen).sum())}
    with pytest.raises(LocfuseError, match=r"tracks a cart, robot\.(.|\n)*--set 'truth\.body=a cart'"):
        read_truth(stream, TruthSettings(), 0)


def test_of_what_gazebo_simulates_the_model_that_moves_is_the_robot(tmp_path: Path) -> None:
    """The ground and the walls are models too; the topic is a reference by its type. It has no stamps."""
    kind = "gazebo_msgs/msg/ModelStates"
    text = "string[] name\ngeometry_msgs/Pose[] pose\n"
    pose = [{"position": {"x": x, "y": y}, "orientation": {"w": 1.0}} for x, y in PATH]
    rows = [{"name": ["ground_plane", "robot"], "pose": [{"position": {"x": 9.0}}, one]} for one in pose]
    log = open_log([custom(tmp_path / "x.mcap", "/gazebo/model_states", kind, text, T, rows)])
    choice = Choice()
    choose_truth(log, make_robot({}), False, choice)
    assert (choice.of("truth"), choice.why["truth"]) == (("/gazebo/model_states",), "by its type")
    stream = log.stream("/gazebo/model_states")
    truth, _ = read_truth(stream, TruthSettings(), int(stream.t_ns[0]))
    np.testing.assert_allclose(truth.xy, PATH, atol=1e-12)
    with pytest.raises(LocfuseError, match="not cart"):
        read_truth(stream, TruthSettings(body="cart"), 0)


@pytest.mark.parametrize(("bends", "w"), [(0.2, 1.0), (0.2, 0.0), (0.0, 1.0)])
def test_one_heading_for_a_path_that_bends_is_none_and_one_turned_on_the_robot_is_set_right(
    tmp_path: Path, bends: float, w: float
) -> None:
    x, head = np.linspace(0.0, 2.0, 20).tolist(), "t,x,y,z,qx,qy,qz,qw\n"
    rows = "".join(f"{i},{v},{bends * v * v},0,0,0,0,{w}\n" for i, v in enumerate(x))
    truth, _ = read_truth(streamed(tmp_path / "t.csv", head + rows), TruthSettings(), 0)
    assert (truth.theta is None) == bool(bends)
    rows = "".join(f"{i},{i},0,0,0,0,{math.sin(0.05 * i)},{math.cos(0.05 * i)}\n" for i in range(9))
    truth, _ = read_truth(streamed(tmp_path / "t.csv", head + rows), TruthSettings(yaw_deg=90.0), 0)
    np.testing.assert_allclose(present(truth.theta), 0.1 * np.arange(9) - 0.5 * math.pi, atol=1e-9)


@pytest.mark.parametrize("w_first", [False, True])
def test_quaternions_of_a_log_that_begin_with_w_are_read(w_first: bool) -> None:
    turn = np.linspace(0.3, 4.0, 50)
    pose = np.column_stack((np.sin(turn), -np.cos(turn), turn))
    stream = pose_stream("/mocap", np.arange(50) * 10**8, pose)
    if w_first:
        names = [f"pose.orientation.{axis}" for axis in "wxyz"]
        moved = dict(zip(names[1:] + names[:1], [stream.data[name] for name in names], strict=True))
        stream = replace(stream, data={**stream.data, **moved})
    truth, _ = read_truth(cast("Stream", stream), TruthSettings(), 0)
    np.testing.assert_allclose(np.unwrap(present(truth.theta)), turn, atol=1e-9)
    assert truth.w_first == w_first


def test_poses_with_a_quaternion_of_zeros_are_not_used() -> None:
    turn = np.linspace(0.3, 4.0, 50)
    stream = pose_stream("/mocap", np.arange(50) * 10**8, np.column_stack((np.sin(turn), -np.cos(turn), turn)))
    for name in (f"pose.orientation.{axis}" for axis in "xyzw"):
        cast("Array", stream.data[name])[[7, 30]] = 0.0
    truth, dropped = read_truth(cast("Stream", stream), TruthSettings(), 0)
    np.testing.assert_allclose(np.unwrap(present(truth.theta)), np.delete(turn, [7, 30]), atol=1e-9)
    assert dropped["not_finite"] == 2


def test_headings_that_flip_by_half_a_turn_are_turned_back() -> None:
    turn = np.linspace(0.3, 4.0, 900)
    pose = np.column_stack((np.sin(turn), -np.cos(turn), turn))
    pose[:, 2] += math.pi * np.isin(np.arange(900) // 150, (1, 3))  # 300 of 900 readings, four flips
    stream = pose_stream("/mocap", np.arange(900) * 10**7, pose)
    truth, _ = read_truth(cast("Stream", stream), TruthSettings(), 0)
    np.testing.assert_allclose(np.unwrap(present(truth.theta)), turn, atol=1e-9)
    assert truth.turned == 300
    assert "300 readings are turned back" in heading_notes(truth, stream.msgtype)[0]


def test_satellite_fixes_are_metres_east_and_north_turned_into_the_map(tmp_path: Path) -> None:
    """A minute of latitude at 45 degrees is 1852.3 m on WGS 84: the meridian radius times pi / 10800."""
    kind = "sensor_msgs/msg/NavSatFix"
    said = [
        Said("/fix", kind, cdr(kind, header=header(ns), latitude=45.0 + i / 60.0, longitude=9.0), ns)
        for i, ns in enumerate(stamps(T[:3]))
    ]
    stream = open_log([log_of(tmp_path / "x.mcap", said)]).stream("/fix")
    truth, _ = read_truth(stream, TruthSettings(origin=(45.0, 9.0), east_deg=90.0), 0)
    e2 = 0.00669437999014
    meridian = 6378137.0 * (1 - e2) / (1 - e2 * math.sin(math.radians(45.0)) ** 2) ** 1.5
    assert truth.theta is None
    np.testing.assert_allclose(truth.xy[1], [-meridian * math.pi / 10800, 0.0], rtol=2e-4, atol=0.01)


def test_a_truth_file_with_times_in_whole_seconds_judges_no_sensor(
    tmp_path: Path, own: tuple[float, list[str]]
) -> None:
    rows = [line.partition(" ") for line in own[1]]
    (tmp_path / "truth.tum").write_text("".join(f"{t.partition('.')[0]} {pose}\n" for t, _, pose in rows))
    done = locfuse("info", SAMPLE, "--check", "--no-advice", "--truth", tmp_path / "truth.tum")
    assert done.exit_code == 3
    assert f"of {len(rows)} rows have the time of the row before" in done.stdout


def streamed(path: Path, text: str | bytes) -> MadeStream:
    path.write_bytes(text.encode() if isinstance(text, str) else text)
    return read_file(str(path))


def test_zeros_of_a_tracker_that_lost_its_marker_are_no_poses_and_a_start_at_zero_is_one(tmp_path: Path) -> None:
    x = [0.0, 0.0, 0.01, *np.arange(0.1, 3.0, 0.1), 0.0, 0.0, 3.0, 3.1]
    rows = "".join(f"{1e9 + 0.1 * i:.1f},{v},0\n" for i, v in enumerate(x))
    truth, dropped = read_truth(streamed(tmp_path / "t.csv", f"t,x,y\n{rows}"), TruthSettings(), 0)
    assert dropped == {"zeros": 2}
    assert truth.xy[:, 0].tolist() == [v for i, v in enumerate(x) if v or i < 2]


@pytest.mark.parametrize(
    ("word", "t_ns"),
    [
        ("1.5", 1_500_000_000),
        (" -0.25", -250_000_000),
        ("1700000000.123456789", 1_700_000_000_123_456_789),
        ("1700000000123456789", 1_700_000_000_123_456_789),
        ("1.7e9", 1_700_000_000_000_000_000),
        ("1700000000.9999999999", 1_700_000_000_999_999_999),
        ("0" * 5000 + "1", 1_000_000_000),  # more digits than int() takes
        (".5", 500_000_000),
    ],
)
def test_a_time_is_read_to_its_last_nanosecond(tmp_path: Path, word: str, t_ns: int) -> None:
    assert streamed(tmp_path / "a.csv", f"t,x,y\n{word},1,2\n").t_ns.tolist() == [t_ns]
    assert streamed(tmp_path / "a.tum", f"{word.strip()} 1 2 0 0 0 0 1\n").t_ns.tolist() == [t_ns]


@pytest.mark.parametrize(
    "word", ["nan", "inf", "1e400", "5e9", "5e18", "-5e18", "1_0.5", "1e-99999999999999999999", "", "now"]
)
def test_what_is_no_time_is_refused_with_its_line(tmp_path: Path, word: str) -> None:
    with pytest.raises(LocfuseError, match=r"a\.csv: line 3: .* is no (time|number)$"):
        streamed(tmp_path / "a.csv", f"t,x,y\n1,1,2\n{word},1,2\n")


@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
def test_a_table_with_any_ends_of_lines_is_the_same(tmp_path: Path, end: str) -> None:
    found = streamed(tmp_path / "a.csv", end.join(("t,x,y", "1,2,3", "2,4,5", "")))
    assert found.t_ns.tolist() == [10**9, 2 * 10**9]
    assert found.columns("point.y")["point.y"].tolist() == [3.0, 5.0]  # type: ignore[union-attr]


def test_a_table_of_one_endless_word_is_refused_in_one_line(tmp_path: Path) -> None:
    with pytest.raises(LocfuseError, match=r"a\.csv: line 2: no \.csv: field larger than field limit"):
        streamed(tmp_path / "a.csv", "t,x,y\n" + "1" * 200_000 + ",2,3\n")


@pytest.mark.parametrize("word", ["1.5", "nan", "inf", "1e30", "9007199254740992"])
def test_a_landmark_has_a_whole_number(tmp_path: Path, word: str) -> None:
    table = "t,id,range,bearing\n1,7,2,0\n2,{},2,0\n"
    assert streamed(tmp_path / "a.csv", table.format("8.0")).columns("id")["id"].tolist() == [7, 8]  # type: ignore[union-attr]
    with pytest.raises(LocfuseError, match=r"a\.csv: line 3: .* is no id"):
        streamed(tmp_path / "a.csv", table.format(word))


def test_names_of_columns_do_nothing_but_stand_there(tmp_path: Path) -> None:
    with pytest.raises(LocfuseError) as problem:
        streamed(tmp_path / "a.csv", b"a\x1b[2J\xe2\x80\xa8b,\x85\n1,2\n")
    assert str(problem.value).endswith(r"it has a\x1b[2j\u2028b, " + "\N{REPLACEMENT CHARACTER}")


def test_an_endless_heading_is_no_heading(tmp_path: Path) -> None:
    found = streamed(tmp_path / "a.csv", "t,x,y,theta\n1,1,1,inf\n2,1,1,0\n")
    w = np.asarray(found.columns("pose.pose.orientation.w")["pose.pose.orientation.w"])
    assert np.isnan(w).tolist() == [True, False]


def test_a_small_file_takes_little_memory_however_much_may_be_read(tmp_path: Path) -> None:
    small = tmp_path / "a.csv"
    small.write_text("t,x,y\n1,2,3\n")
    tracemalloc.start()
    try:
        assert inputs.read_small(small, 1 << 34) == b"t,x,y\n1,2,3\n"
        assert tracemalloc.get_traced_memory()[1] < 1 << 20
    finally:
        tracemalloc.stop()


def test_a_place_beyond_the_solar_system_was_never_measured(tmp_path: Path) -> None:
    log = sample_write(tmp_path / "a.mcap", seconds=1.5)
    begin = sample()[0][0].log_time
    where = [1e300 if i % 2 else 1.0 + 0.01 * i for i in range(16)]
    rows = [f"{(begin + i * 10**8) / 1e9:.3f},{x},1,0" for i, x in enumerate(where)]
    truth = tmp_path / "t.csv"
    truth.write_text("\n".join(("t,x,y,theta", *rows)))
    done = reported("compare", log, "--no-advice", "--align", "origin", "--truth", truth)
    assert done.report["input"]["dropped"]["truth"] == {"not_finite": 8}
    assert done.rows["odometry"]["position_rmse_m"] < 1e3


def test_a_landmark_beyond_the_solar_system_was_never_seen(tmp_path: Path) -> None:
    log = sample_write(tmp_path / "a.mcap", seconds=1.5)
    begin = sample()[0][0].log_time
    (tmp_path / "m.csv").write_text("id,x,y\n1,3,0\n")
    seen = [f"{(begin + i * 10**8) / 1e9:.3f},1,{2.0 if i < 8 else 1e300},0" for i in range(16)]
    (tmp_path / "d.csv").write_text("\n".join(("t,id,range,bearing", *seen)))
    files = (f"landmarks.map={tmp_path / 'm.csv'}", f"landmarks.file={tmp_path / 'd.csv'}")
    done = locfuse("run", log, "-o", tmp_path / "o", "--set", files[0], "--set", files[1])
    assert done.exit_code == 3, done.stderr  # half of the readings is a loss
    assert "landmarks: 8 of 16 readings refused (8 nan or not positive)" in done.stderr


def test_an_effect_without_a_number_has_no_strip() -> None:
    effect = {"low": 0.5, "high": 2.0, "factor": 1.0}
    rest = {"credit": None, "leave_one_out": None}
    sensors = {"a": {"alone": effect, **rest}, "b": {"alone": {**effect, "high": None}, **rest}}
    verdicts = {key: {"verdict": "helps"} for key in sensors}
    assert set(_strips({"credit": {"sensors": sensors}, "verdicts": verdicts})) == {"a"}
