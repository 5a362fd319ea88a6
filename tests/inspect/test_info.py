"""What a user reads of a log: facts held to the public reader, a page that fits, and no alarm without cause."""

import json
import re
import shlex
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bags import T0, S, Said, cdr, definition, drive, header, real_log, write
from commands import Done, locfuse, ok, refused
from laser_room import BEAMS, circle, scans_of
from mcap.reader import make_reader
from mcap.writer import Writer
from trap_logs import COMPASS, PICTURES, SCAN, TRUTH, WHEELS, Drive, recorded
from traps import ROLLED, decoded, field, gyro, imu, raw, short_metre, without_compass

import locfuse as api
from locfuse import sample_logs
from locfuse.cli.terminal.info_text import CORRECT, RECORD
from locfuse.formats.report.findings import void_reasons
from locfuse.formats.report.table import Column, of_words, terminal_lines

GEOMETRY = ("--set", "wheels.radius=0.05", "--set", "wheels.track=0.4")


def as_json(*words: Any) -> dict[str, Any]:
    found: dict[str, Any] = json.loads(locfuse("info", *words, "--json").stdout)
    return found


def section(done: Done, title: str) -> list[str]:
    """The lines below a title."""
    _, found, rest = done.stdout.partition(f"\n{title}\n")
    return rest.partition("\n\n")[0].splitlines() if found else []


@pytest.mark.parametrize("name", ["rounded_triangle", "disturbed"])  # the third: README.md
def test_nothing_is_odd_about_the_sample_logs(name: str) -> None:
    done = ok("info", name, "--check")
    assert section(done, "configurations") == [
        "  ready    odometry, compass, lrf, camera, all",
        "  no topic sonar, gps, gyro",
    ]
    assert section(done, "would spoil an estimate") == []
    worth = section(done, "worth knowing")
    if name == "disturbed":  # a motor beside the first corner turns the field
        assert "compass: iron near (6.1, 2.2) m" in worth.pop(0)
        assert all(line.startswith("    ") for line in worth)
    else:
        assert worth == []
    assert section(done, "next") == [f"  locfuse compare {name}"]


def test_topics_are_what_the_public_reader_counts() -> None:
    path = sample_logs.path("rounded_triangle")
    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    assert summary.statistics is not None
    counts = summary.statistics.channel_message_counts
    names = {c.topic: (summary.schemas[c.schema_id].name, counts[i]) for i, c in summary.channels.items()}
    found = as_json(path)
    assert {topic: (f["type"], f["messages"]) for topic, f in found["topics"].items()} == names
    assert found["messages"] == summary.statistics.message_count
    span = summary.statistics.message_end_time - summary.statistics.message_start_time
    assert found["duration_s"] == pytest.approx(span * 1e-9)
    assert found["topics"]["/scan"]["frame"] == "laser"


def test_rate_silence_delay_and_frame_of_a_topic(tmp_path: Path) -> None:
    """20 Hz, recorded 5 ms after the stamp, silent from 3 s to 5 s."""
    said = [m for m in drive(200) if not 3.0 <= (m.log_time - T0) / S < 5.0]
    facts = as_json(write(tmp_path / "x.mcap", said), *GEOMETRY)["topics"]
    wheels = facts["/joint_states"]
    assert wheels["rate_hz"] == pytest.approx(159 / 9.95)
    assert wheels["period_s"] == pytest.approx(0.05)
    assert wheels["longest_gap_s"] == pytest.approx(2.05)
    assert wheels["delay_s"] == pytest.approx(0.005)
    assert facts["/scan"]["frame"] == "laser"
    assert facts["/heading"]["delay_s"] is None


def test_every_key_of_the_json_stands_in_the_docs() -> None:
    page = (Path(__file__).parents[2] / "docs" / "bags.md").read_text(encoding="utf-8")
    keys = page.partition("### The JSON")[2].partition("\n#")[0]
    assert set(as_json("rounded_triangle")) == set(re.findall(r"^\| `([a-z_]+)` \|", keys, re.MULTILINE))


def test_where_sensors_sit_and_who_says_so(tmp_path: Path) -> None:
    tour = Drive()
    for key in ("x", "y", "yaw_deg"):
        del tour.tables["lrf"][key]
    by_tf = as_json(tour.record(tmp_path / "tf.mcap"))["extrinsics"]["lrf"]
    assert by_tf["by"] == "/tf_static"
    assert by_tf["x"] == pytest.approx(0.2)
    assert as_json("rounded_triangle")["extrinsics"]["lrf"]["by"] == "settings"
    tour.drop("/tf_static")
    assert as_json(tour.record(tmp_path / "none.mcap"))["extrinsics"]["lrf"]["by"] == "nobody"


def test_why_a_topic_was_chosen(tmp_path: Path) -> None:
    roles = as_json(write(tmp_path / "x.mcap", drive(100)), *GEOMETRY, "--set", "lrf.topic=/scan")["roles"]
    assert roles["wheels"] == {"topics": ["/joint_states"], "why": "the only topic of its type"}
    assert roles["lrf"]["why"] == "named in the settings"


@pytest.mark.parametrize("width", [80, 120])
def test_no_line_is_wider_than_the_screen(width: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Long topics, long types, every column in use, long findings."""
    monkeypatch.setenv("COLUMNS", str(width))
    long = "/robot_one/front_left/laser/scan_filtered"
    said = [m._replace(topic=long) if m.topic == "/scan" else m for m in drive(200)]
    said = [m for m in said if not 3.0 <= (m.log_time - T0) / S < 5.0]
    done = locfuse("info", write(tmp_path / "x.mcap", said), *GEOMETRY)
    body = done.stdout.partition("\nnext\n")[0].splitlines()
    assert max(map(len, body)) <= width
    rows = body[2 : body.index("") + 5]
    assert [row.split()[0][:6] for row in rows[1:4]] == ["/headi", "/joint", "/robot"]
    assert ("std_msgs/" in rows[1]) == (width == 120)


def test_in_a_pipe_every_finding_is_one_line(tmp_path: Path) -> None:
    done = locfuse("info", write(tmp_path / "x.mcap", drive(100)))
    for title in ("would spoil an estimate", "worth knowing"):
        for line in section(done, title):
            assert re.match(r"  [a-z/_]+: |    fix: ", line)


def test_a_table_keeps_its_first_column_and_the_ends_of_long_words() -> None:
    names, kinds = ("/a/very/long/topic/name/with/many/parts", "/b"), ("package/LongTypeName", "p/T")
    columns = (
        Column("topic", "topic", kind="text"),
        Column("type", "type", kind="text", shorter=lambda kind: kind.rpartition("/")[2]),
        Column("x", "x", rank=1),
    )
    table = of_words(columns, zip(names, kinds, ("1", "2"), strict=True))
    assert terminal_lines(table, None)[1].split() == [names[0], kinds[0], "1"]
    for width in range(30, 80):
        lines = terminal_lines(table, width)
        assert max(map(len, lines)) <= width
        assert lines[1].split()[0].startswith("/a/v")
        assert lines[1].split()[0].endswith("rts")
    assert terminal_lines(of_words(columns[:1], [("",)]), 80) == []


def test_what_is_missing_of_the_wheels_is_told_with_what_to_do(tmp_path: Path) -> None:
    path = write(tmp_path / "x.mcap", [m for m in drive(100) if m.topic != "/scan"])
    done = ok("info", path)
    assert locfuse("info", path, "--check").exit_code == 3
    assert "these are unknown: radius, track" in section(done, "would spoil an estimate")[0]
    assert section(done, "next") == [f"  locfuse init {path} > robot.toml"]
    configurations = as_json(path)["configurations"]
    assert "these are unknown: radius, track" in configurations["odometry"]
    assert as_json(path, *GEOMETRY)["configurations"]["odometry"] is None


def test_the_next_command_is_one_that_cures(tmp_path: Path) -> None:
    path = Drive().record(tmp_path / "x.mcap")
    first = locfuse("info", path, "--set", "wheels.track=0.5", "--set", "lrf.gate=0.99", "--check", "--no-advice")
    assert first.exit_code == 3
    (command,) = section(first, "next")
    words = shlex.split(command)
    assert "wheels.track=0.5" not in words
    assert "lrf.gate=0.99" in words
    again = ok(*words[1:], "--check", "--no-advice")
    (compare,) = section(again, "next")
    assert shlex.split(compare)[:2] == ["locfuse", "compare"]


def test_of_two_ways_to_set_a_distance_none_is_called_the_fix(tmp_path: Path) -> None:
    """As `compare`, which offers neither; with truth it is known who is right."""
    log = recorded(tmp_path, short_metre)
    assert "fix: --set lrf.range_scale=1.1" in locfuse("info", log).stdout
    alone = locfuse("info", log, "--set", "truth.topic=none").stdout
    (line,) = (x for x in alone.splitlines() if x.startswith("  lrf: it measures"))
    assert "If the wheels are right, set lrf.range_scale=1.1" in line
    assert "if lrf is, wheels.radius=0.04" in line
    assert "fix: --set lrf.range_scale" not in alone
    assert "\nrange_scale = 1.1" in locfuse("init", log).stdout
    robot = tmp_path / "robot.toml"
    told = locfuse("init", log, "--set", "truth.topic=none", "-o", robot).stderr
    assert "still wrong: lrf: it measures 9." in told
    assert "next: locfuse compare" in told
    alone = robot.read_text()
    assert "\n# range_scale = 1.1" in alone
    assert "\nrange_scale" not in alone
    assert "wheels.radius=0.04" in alone


def test_a_run_that_is_lost_is_said_by_info_as_by_compare(tmp_path: Path) -> None:
    log = Drive().record(tmp_path / "x.mcap")
    tried = as_json(log, "--set", "lrf.yaw_deg=90", "--check")["tried"]
    lost = [v for v in tried["validity"] if v["void"] and v["code"] == "lost"]
    assert lost
    assert all({"lrf", "all"} & set(v["configurations"]) for v in lost)
    assert void_reasons(tried)
    assert "the best is the compass" in tried["headline"]
    assert "lost for" in tried["headline"]


def test_a_dead_encoder_is_named_though_nothing_cures_it(tmp_path: Path) -> None:
    dead = field(WHEELS, position=lambda p: np.array([p[0], 1.0]))
    done = locfuse("info", recorded(tmp_path, dead), "--check")
    assert done.exit_code == 3
    assert re.search(r"right wheel stands still from 0.0 s to [\d.]+ s, while the other one rolls", done.stdout)
    assert "fix:" not in done.stdout


def test_pictures_that_are_grey_or_show_nothing_red_are_named(tmp_path: Path) -> None:
    tour = Drive(pictures=True)
    raw(tour, "mono8", lambda p: np.ascontiguousarray(p[..., 0]))
    done = locfuse("info", tour.record(tmp_path / "x.mcap"), "--check", "--no-advice")
    assert done.exit_code == 3
    assert "are grey (mono): red needs colour" in section(done, "would spoil an estimate")[0]
    tour = Drive(pictures=True)
    tour.tables["camera"]["red_ratio"] = 0.99
    done = locfuse("info", tour.record(tmp_path / "red.mcap"), "--check", "--no-advice")
    assert done.exit_code == 3
    assert "nothing red and upright in 22 of 22 pictures" in done.stdout


def test_a_sensor_on_a_sleeping_topic_and_a_type_nobody_reads(tmp_path: Path) -> None:
    said = [*drive(100), Said("/odd", "std_msgs/msg/Empty", b"", T0 + S)]
    done = locfuse("info", write(tmp_path / "x.mcap", said), *GEOMETRY)
    assert re.search(r"^/odd +std_msgs/Empty +1", done.stdout, re.MULTILINE)


def test_damage_is_a_finding_and_a_3_without_being_asked(tmp_path: Path) -> None:
    path = write(tmp_path / "x.mcap", drive(400), chunk_size=4000)
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    done = locfuse("info", path, *GEOMETRY)
    assert done.exit_code == 3
    assert section(done, "would spoil an estimate")[0].startswith("  file: ")
    (command,) = section(done, "next")
    fixed = tmp_path / "recovered.mcap"
    assert command.strip() == f"locfuse recover {path} -o {fixed.name}"
    assert locfuse("recover", path, "-o", fixed).exit_code == 3
    assert section(ok("info", fixed, *GEOMETRY), "next")[0].startswith(
        "  locfuse compare "
    )  # nothing is lost there


def test_where_no_setting_helps_the_next_step_is_to_record(tmp_path: Path) -> None:
    made = Drive()
    made.messages = []
    done = ok("info", made.record(tmp_path / "x.mcap"))
    assert section(done, "next") == [f"  {RECORD}"]
    assert len(section(done, "would spoil an estimate")) == 1


@pytest.mark.parametrize(
    ("word", "said"),
    [
        ("truth.topic=/joint_states", "accepted"),
        ("wheels.left=right_wheel_joint", "both name 'right_wheel_joint'"),
        ("wheels.topic=/ground_truth/pose", "is also the robot's motion"),
        ("start.at=99", "the drive ends at 30.4 s"),
    ],
)
def test_settings_that_contradict_are_named_in_one_line(tmp_path: Path, word: str, said: str) -> None:
    log = Drive().record(tmp_path / "x.mcap")
    words = ("--set", word)
    done = ok("info", log, *words)
    (line,) = (x for x in section(done, "would spoil an estimate") if not x.startswith("    fix: "))
    assert said in line
    by_fix = "--set truth.topic=none" in section(done, "next")[0]
    assert by_fix or section(done, "next") == [f"  {CORRECT}"]
    stopped = locfuse("compare", log, *words, "-o", tmp_path / "out")
    assert (stopped.exit_code, stopped.stderr.count("\n")) == (1, 1)


def test_a_log_in_which_nothing_locates_is_not_sent_to_a_reference(tmp_path: Path) -> None:
    made = Drive()
    poses = [m._replace(topic="/rig/pose") for m in made.on(TRUTH)]
    for role, topic in (("truth", TRUTH), ("lrf", SCAN), ("compass", COMPASS)):
        made.drop(topic)
        made.tables.pop(role, None)
    done = ok("compare", made.record(tmp_path / "x.mcap"), "-v", "-o", tmp_path / "out", "--write", "json")
    assert "--set truth.topic=/TOPIC" in done.stdout
    assert "--reference" not in done.stdout + done.stderr
    made.add(poses)  # a topic that may hold it is named
    done = ok("compare", made.record(tmp_path / "poses.mcap"), "-o", tmp_path / "poses")
    assert "Try: --set truth.topic=/rig/pose, if it holds the true poses" in done.stdout


@pytest.mark.parametrize(
    ("text", "why"),
    [
        (b"[wheels]\nradius = 0.05\n[whe", "not valid TOML"),
        (b"[wheels]\nradius = '\xff'", r"not UTF-8 text \(byte 19\)"),
        (b"[wheels]\nradius = 'five'", "wheels.radius = 'five'"),
    ],
)
def test_damaged_settings_in_a_log_are_named_and_files_replace_them(tmp_path: Path, text: bytes, why: str) -> None:
    path = write(tmp_path / "x.mcap", drive(100), attachments={"robot.toml": text})
    assert re.search(
        rf"its settings .* cannot be read: {why}", section(locfuse("info", path), "would spoil an estimate")[0]
    )
    file = tmp_path / "robot.toml"
    assert locfuse("init", path, "-o", file, *GEOMETRY).exit_code == 3
    assert "cannot be read" not in locfuse("info", path, "--robot", file).stdout


def test_strict_takes_a_refused_reading_for_a_loss(tmp_path: Path) -> None:
    said = drive(100)
    path = write(tmp_path / "x.mcap", [*said, said[0]._replace(log_time=said[0].log_time + 1)])
    assert locfuse("info", path, *GEOMETRY).exit_code == 0
    assert locfuse("info", path, *GEOMETRY, "--strict").exit_code == 3


def test_missing_wheels_are_said_and_a_reference_that_nobody_named_is_asked_for(tmp_path: Path) -> None:
    said = [m for m in drive(50) if m.topic == "/heading"]
    done = locfuse("info", write(tmp_path / "x.mcap", said), "--check")
    assert done.exit_code == 3
    (words,) = section(done, "would spoil an estimate")
    assert "x has no wheels, no odometry (nor one in /tf), no laser, no poses and no speeds" in words
    assert section(done, "next") == [f"  {RECORD}"]
    pose = cdr("geometry_msgs/msg/PoseStamped", header=header(T0))
    poses = [Said("/robot_1/pose", "geometry_msgs/msg/PoseStamped", pose, T0 + i * S) for i in range(5)]
    said = [*drive(100), *poses]
    done = locfuse("info", write(tmp_path / "x.mcap", said), *GEOMETRY)
    assert "--set truth.topic=/robot_1/pose" in "\n".join(section(done, "worth knowing"))


def test_preview_writes_four_pictures_of_a_few_messages(tmp_path: Path) -> None:
    done = locfuse("info", "rounded_triangle", "--preview", tmp_path / "p")
    files = sorted(p.name for p in (tmp_path / "p").iterdir())
    assert {name.partition("-")[2] for name in files} == {"raw.png", "mask.png", "panorama.png", "detection.png"}
    assert len(files) == 16
    shown = section(done, "pictures")
    assert len(shown) == 4
    assert re.fullmatch(r".*/000000-\*\.png: something red at -?[\d.]+ deg", shown[0])


def test_preview_needs_no_landmark_and_says_which_pictures_there_are(tmp_path: Path) -> None:
    tour = Drive(pictures=True)
    del tour.tables["camera"]
    path = tour.record(tmp_path / "one.mcap")
    assert "camera.landmark is not set" in locfuse("info", path).stdout
    assert locfuse("info", path, "--preview", tmp_path / "p").exit_code == 0
    picture = decoded(tour.on(PICTURES)[0])
    assert (tmp_path / "p" / "000000-raw.png").stat().st_size > 0
    assert picture.shape == (240, 240, 3)
    tour.add([m._replace(topic="/other/compressed") for m in tour.on(PICTURES)])
    refusal = refused("info", tour.record(tmp_path / "two.mcap"), "--preview", tmp_path / "p")
    assert "has 2 topics of pictures; choose one with --set camera.topic=" in refusal
    none = locfuse("info", write(tmp_path / "none.mcap", drive(20)), "--preview", tmp_path / "p")
    assert "no topic of none holds pictures" in none.stderr


def test_short_logs_are_not_judged(tmp_path: Path) -> None:
    """A second: nothing can be dead, late or wrong yet."""
    tour = Drive()
    tour.messages = tour.messages[:50]
    assert section(locfuse("info", tour.record(tmp_path / "x.mcap")), "would spoil an estimate") == []


def test_of_a_real_arena_the_next_command_sets_what_helps() -> None:
    """Track, both metres, laser's clock, start: all wrong by default, found in one round."""
    log = real_log("brenner/brenner.mcap")
    configured = ("--set", "wheels.radius=0.0199962", "--set", "wheels.track=0.155")
    first = locfuse("info", log, *configured)
    checked = locfuse("info", log, *configured, "--check", "--json")
    assert checked.exit_code == 3
    found = json.loads(checked.stdout)
    cures = dict(cure.split("=") for o in found["findings"] if o["severe"] for cure in o["fixes"])
    assert float(cures["lrf.time_offset"]) == pytest.approx(-0.45, abs=0.05)
    # whose metre is right is a matter of words: both together make the laser's the truth's
    assert 1.0 / float(cures["lrf.range_scale"]) == pytest.approx(0.886, abs=0.02)
    assert float(cures["start.x"]) == pytest.approx(1.875, abs=0.05)
    assert float(cures["start.theta_deg"]) == pytest.approx(-147, abs=3)
    (command,) = section(first, "next")
    again = locfuse(*shlex.split(command)[1:], "--check")
    assert section(again, "would spoil an estimate") == []
    (compare,) = section(again, "next")
    assert shlex.split(compare)[:2] == ["locfuse", "compare"]


def test_a_real_corridor_whose_odometry_is_late_against_all_else() -> None:
    found = as_json(real_log("fr079/fr079.mcap"), "--set", "lrf.x=-0.04")
    (late,) = [o for o in found["findings"] if o["code"] == "lag"]
    assert late["role"] == "wheels"
    assert float(late["fixes"][0].removeprefix("wheels.time_offset=")) == pytest.approx(0.13, abs=0.02)
    assert any("while its velocity says reverse" in o["message"] for o in found["findings"])


def test_a_real_turtlebot_as_ros2_records_it() -> None:
    found = as_json(real_log("turtlebot4"))
    mount = found["extrinsics"]["lrf"]
    assert mount["by"] == "/tf_static"
    assert mount["yaw_deg"] == pytest.approx(90.0, abs=0.1)
    words = [o["message"] for o in found["findings"]]
    assert any(w.startswith("21 frames have a faulty or second transform") for w in words)
    assert any(w.startswith("ranges without a return: 23% inf") for w in words)
    assert [o["code"] for o in found["findings"] if o["severe"]] == ["sweep", "lag"]


# --- two publishers on one topic are named, with the numbers: by their channels, or by the angles of their scans

ODOMETRY = "nav_msgs/msg/Odometry"


def odometry(i: int, x: float) -> bytes:
    pose = {"position": {"x": x, "y": 0.0, "z": 0.0}, "orientation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}}
    return cdr(ODOMETRY, header=header(T0 + i * S // 20, "odom"), pose={"pose": pose})


def log(path: Path, writes: list[tuple[int, int, float]], beside: str = "") -> Path:
    """Messages of /odom as (channel, number, x), at 20 Hz; with a name `beside`, as many of that type on /odom."""
    with path.open("wb") as file:
        writer: Any = Writer(file)
        writer.start()
        schema = writer.register_schema(ODOMETRY, "ros2msg", definition(ODOMETRY))
        idents = [writer.register_channel("/odom", "cdr", schema, {"node": name}) for name in ("a", "b")]
        for channel, i, x in writes:
            writer.add_message(idents[channel], T0 + i * S // 20, odometry(i, x), T0 + i * S // 20, i)
        if beside:
            other = writer.register_channel(
                "/odom", "cdr", writer.register_schema(beside, "ros2msg", b"float64 data")
            )
            for _, i, x in writes:
                writer.add_message(other, T0 + i * S // 20 + 1, cdr(beside, data=x), T0 + i * S // 20 + 1, i)
        writer.finish()
    return path


def found(path: Path) -> list[dict[str, Any]]:
    report = json.loads(locfuse("info", path, "--json").stdout)
    return [f for f in report["findings"] if f["code"] in {"publishers", "scan angles"}]


def test_two_odometries_in_turn_on_one_topic_would_spoil_an_estimate(tmp_path: Path) -> None:
    jumping = [(i, 0.05 * i + 3.0 * (i % 2)) for i in range(100)]
    (finding,) = found(log(tmp_path / "two.mcap", [(i % 2, i, x) for i, x in jumping]))
    assert (finding["role"], finding["severe"]) == ("wheels", True)
    assert "/odom mixes two publishers (50 and 50 messages in turn)" in finding["message"]
    assert "record each on a topic of its own" in finding["message"]
    of_one_channel = as_json(log(tmp_path / "one.mcap", [(0, i, x) for i, x in jumping]))
    (finding,) = [f for f in of_one_channel["findings"] if f["severe"]]
    assert "/odom: its poses jump to and fro between two paths: two publishers" in finding["message"]


def test_a_topic_of_two_types_is_read_as_one_and_the_other_is_counted(tmp_path: Path) -> None:
    said = as_json(log(tmp_path / "two.mcap", [(0, i, 0.05 * i) for i in range(100)], "std_msgs/msg/Float64"))
    assert said["messages"] == 200
    words = [f["message"] for f in said["findings"] if f["role"] == "wheels"]
    assert "readings that are not used: 100 of std_msgs/msg/Float64" in words
    assert not any("two publishers" in one for one in words)


def test_an_arm_that_publishes_on_the_topic_of_the_wheels_is_no_second_publisher_of_them(tmp_path: Path) -> None:
    joints = "sensor_msgs/msg/JointState"
    with (tmp_path / "x.mcap").open("wb") as file:
        writer: Any = Writer(file)
        writer.start()
        schema = writer.register_schema(joints, "ros2msg", definition(joints))
        base, arm = (writer.register_channel("/joint_states", "cdr", schema, {"node": name}) for name in "ab")
        for i in range(400):
            names = ["arm_joint"] if i % 2 else ["left_wheel_joint", "right_wheel_joint"]
            data = cdr(joints, header=header(T0 + i * S // 40), name=names, position=[0.1 * i] * len(names))
            writer.add_message(arm if i % 2 else base, T0 + i * S // 40, data, T0 + i * S // 40)
        writer.finish()
    said = locfuse("info", tmp_path / "x.mcap", "--set", "wheels.radius=0.05", "--set", "wheels.track=0.3").stdout
    assert "200 of 400 messages are of other joints" in said
    assert "two publishers" not in said


@pytest.mark.parametrize(
    "channels",
    [lambda i: [int(i >= 50)], lambda i: [0, 1], lambda i: [0]],
    ids=["started again", "recorded twice", "one"],
)
def test_a_publisher_that_starts_again_or_is_recorded_twice_is_one(tmp_path: Path, channels: Any) -> None:
    writes = [(channel, i, 0.05 * i) for i in range(100) for channel in channels(i)]
    assert found(log(tmp_path / "one.mcap", writes)) == []


AT_BACK = np.float32(-np.pi).tobytes()
LATER = np.float32(-np.pi + 4.0 * np.pi / BEAMS).tobytes()
LASERS: dict[str, tuple[Callable[[Said], Said], float, tuple[str, ...]]] = {  # of every other scan
    "two frames": (
        lambda m: m._replace(data=m.data.replace(b"laser", b"front", 1)),
        0.0,
        ("/scan mixes messages of two frames in turn",),
    ),
    "one frame, the second looks back": (
        lambda m: m,
        np.pi,
        ("/scan has scans that are like the one before the last, not like the last",),
    ),
    "two first angles": (
        lambda m: m._replace(data=m.data.replace(AT_BACK, LATER, 1)),
        0.0,
        ("30 scans at -180°", "30 scans at -174°"),
    ),
}


@pytest.mark.parametrize("what", LASERS)
def test_two_lasers_in_turn_on_one_topic_are_named(what: str, tmp_path: Path) -> None:
    """One that looks back sees at each place what the other would see half a turn later."""
    change, turn, words = LASERS[what]
    t, poses = circle()
    one, other = scans_of(t, poses), [change(m) for m in scans_of(t, poses + np.array([0.0, 0.0, turn]))]
    assert found(write(tmp_path / "one.mcap", one)) == []
    mixed = [(other if (i % 2) != (what == "two first angles") else one)[i] for i in range(len(one))]
    (finding,) = found(write(tmp_path / "two.mcap", mixed))
    assert finding["role"] == "lrf"
    assert finding["severe"] or what == "two first angles"
    for part in words:
        assert part in finding["message"]


# --- an IMU is bolted to the robot once: what turns its gyro turns its compass


def test_roll_and_pitch_given_for_one_hold_for_the_other_in_the_same_frame(tmp_path: Path) -> None:
    log = recorded(tmp_path, partial(imu, R=ROLLED, orientation=True), without_compass)
    for given, other in (("gyro", "compass"), ("compass", "gyro")):
        robot = api.load(log, sets={f"{given}.roll_deg": 90.0}).robot
        assert robot.settings(other).roll_deg == 90.0
    robot = api.load(log, sets={"gyro.roll_deg": 90.0, "compass.roll_deg": 5.0}).robot
    assert (robot.settings("gyro").roll_deg, robot.settings("compass").roll_deg) == (90.0, 5.0)
    robot = api.load(recorded(tmp_path, gyro(ROLLED)), sets={"gyro.roll_deg": 90.0}).robot
    assert robot.settings("compass").roll_deg == 0.0
