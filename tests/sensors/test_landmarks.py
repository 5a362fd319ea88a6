"""Landmarks with ids: range and bearing to a known map, and what is wrong with a map."""

import math
import re
from pathlib import Path
from typing import Any

import landmark_drive
import numpy as np
import pytest
from bags import T0, S
from commands import locfuse, ok, refused
from landmark_drive import MAP, map_file, path_of, sets, slipping, truth_file
from present import present
from rewrite_log import rewritten
from rows import said
from textbook import numeric_jacobian, wrap
from wheel_bags import GEOMETRY, angles, custom, joint_states, log_of

import locfuse as package
from locfuse.formats.robot import map_files
from locfuse.fusion import se2
from locfuse.fusion.data import Array, LocfuseError, Measurements
from locfuse.fusion.ekf.belief_arrays import JointBelief
from locfuse.fusion.sensors import points
from locfuse.fusion.sensors.landmarks import LandmarksModel, LandmarksSettings
from locfuse.fusion.sensors.points import detector_at, predict
from locfuse.fusion.sensors.ranges import anchor_beside, start_among

SIGMA_RANGE, SIGMA_BEARING, OFFSET = 0.05, math.radians(1.0), 0.08


def written(
    folder: Path,
    share: float = 0.0,
    more: str = "",
    seed: int = 1,
    depth: bool = False,
    late: float = 0.0,
    seconds: float = 60.0,
    places: Any = MAP,
) -> tuple[Path, Path]:
    """Write a log whose wheels slip by a share of every turn, detections of the true path, a map and the truth.

    `depth`: a camera that sees 60 degrees to either side and says depths; `late`: s by which the robot follows.
    """
    t, counted, true = slipping(share, seconds)
    log = log_of(folder / "x.mcap", joint_states(t - late, counted))
    rng = np.random.default_rng(seed)
    lines = ["t,id,range,bearing"]
    for i in range(5, len(t), 10):
        for key in rng.choice(sorted(MAP), 2, replace=False).tolist():
            d = np.array(MAP[key]) - true[i, :2]
            b = wrap(math.atan2(d[1], d[0]) - true[i, 2])
            if depth and abs(b) > math.radians(60.0):
                continue
            r = np.hypot(*d) * (math.cos(b) if depth else 1.0) + OFFSET + SIGMA_RANGE * rng.standard_normal()
            b = wrap(b + SIGMA_BEARING * rng.standard_normal())
            lines.append(f"{T0 // S + t[i]:.9f},{key},{float(r)!r},{float(b)!r}")
    (folder / "detections.csv").write_text("\n".join(lines) + "\n" + more)
    map_file(folder, places)
    return log, truth_file(folder, t, true)


def files_of(folder: Path) -> tuple[str, ...]:
    return sets(f"landmarks.file={folder / 'detections.csv'}", f"landmarks.map={folder / 'landmarks.csv'}")


def compared(files: tuple[Path, Path], *words: Any) -> tuple[dict[str, Any], str]:
    noise = (f"landmarks.sigma_range={SIGMA_RANGE}", f"landmarks.sigma_bearing_deg={math.degrees(SIGMA_BEARING)}")
    return landmark_drive.compared(*files, *files_of(files[0].parent), *sets(*noise), *words)


def test_landmarks_hold_a_robot_whose_wheels_drift_and_find_the_offset_of_the_ranges(tmp_path: Path) -> None:
    rows, stderr = compared(written(tmp_path, 0.05))
    wheels, landmarks = (rows[name] for name in ("odometry", "landmarks"))
    assert wheels["position_rmse_m"] > 0.25
    assert landmarks["position_rmse_m"] < 0.06
    assert landmarks["heading_rmse_deg"] < 2.0
    assert 0.6 < landmarks["sensors"]["landmarks"]["nis"] < 1.6
    assert "swapped" not in stderr
    assert "from its place in the map" not in stderr


def test_anees_over_many_drives_is_one(tmp_path: Path) -> None:
    """Wheels that are exact but for the noise that is configured as small: only the landmarks' noise is drawn."""
    vague = sets("wheels.noise=1e-9", "start.sigma_xy=0.2", "start.sigma_theta_deg=5")
    words = (*vague, "--sensors", "landmarks", "--write", "json")
    found = [compared(written(tmp_path, seed=seed), *words)[0] for seed in range(4)]
    nis = np.mean([rows["landmarks"]["sensors"]["landmarks"]["nis"] for rows in found])
    assert nis == pytest.approx(1.0, abs=0.12)  # 4 x 600 detections of two numbers


def test_depths_of_a_camera_are_told_from_distances_by_the_drive(tmp_path: Path) -> None:
    """The size of a tag in a picture says how far it is along the camera's axis: two thirds at 48 degrees."""
    files = written(tmp_path, depth=True)
    found, stderr = compared(files)
    fixed, _ = compared(files, "--set", "landmarks.range_depth=0")
    good, bad = (rows["landmarks"] for rows in (found, fixed))
    assert "its ranges are depths along its axis, not distances" in stderr
    share = float(stderr.split("not distances: ")[1].split(" ")[0])
    assert share == pytest.approx(1.0, abs=0.1)
    assert good["position_rmse_m"] < 0.05
    assert 0.6 < good["sensors"]["landmarks"]["nis"] < 1.4
    assert bad["position_rmse_m"] > 2.0 * good["position_rmse_m"]
    _, stderr = compared(written(tmp_path))  # distances are said to be nothing else
    assert "depths" not in stderr


def test_landmarks_that_agree_with_the_truths_clock_say_that_the_wheels_are_early(tmp_path: Path) -> None:
    """A robot follows its commands late: it is not the truth that is late, as it would look beside the wheels."""
    log, truth = written(tmp_path, late=0.25)
    done = locfuse("info", log, *GEOMETRY, *files_of(tmp_path), *sets(f"truth.topic={truth}"))
    assert "wheels: stamps look 0.25 s early" in done.stdout
    assert "wheels.time_offset=0.25" in done.stdout
    assert "truth.time_offset" not in done.stdout
    done = locfuse("info", log, *GEOMETRY, *sets(f"truth.topic={truth}"))  # nobody is there to say it
    assert "truth.time_offset=-0.25" in done.stdout


def test_two_swapped_landmarks_and_a_wrong_one_are_named(tmp_path: Path) -> None:
    swapped = {**MAP, 6: MAP[7], 7: MAP[6]}
    rows, stderr = compared(written(tmp_path, places=swapped))
    assert "ids 6 and 7 look swapped in the map" in stderr
    assert rows["landmarks"]["position_rmse_m"] < 0.06
    _, stderr = compared(written(tmp_path, places={**MAP, 9: (3.6, -1.0)}))
    assert "id 9 is seen at (3.0" in stderr
    assert "0.6" in stderr.split("id 9 is seen at")[1].split("from its place")[0]
    assert "swapped" not in stderr


def test_ids_without_an_entry_and_two_tags_of_one_id_are_counted_and_the_rest_is_used(tmp_path: Path) -> None:
    twice = "".join(f"{T0 // S + 3.001:.9f},8,{r},0.1\n" for r in (1.0, 2.0))
    rows, stderr = compared(written(tmp_path, more=f"{twice}{T0 // S + 4}.0,3,1.0,0.0\n"))
    assert "2 same id" in stderr
    assert "1 not in map" in stderr
    assert rows["landmarks"]["position_rmse_m"] < 0.06


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("id,x,y\n6,1,2\n6,2,3\n", "id 6 occurs twice (lines 2 and 3)"),
        ("id,x\n6,1\n", "names no column y"),
        ("id,x,y\nsix,1,2\n", "line 2 is not id, x, y: 'six,1,2'"),
        ("id,x,y\n6,nan,2\n", "x and y must be finite"),
        ("id,x,y\n6,1,2\n7,1e300,2\n", "line 3: a landmark stands somewhere: x and y must be finite"),
        ("id,x,y\n", "holds no landmarks"),
        (f"id,x,y\n{'1' * 200_000},2,3\n", "line 2: no .csv: field larger than field limit"),
    ],
)
def test_a_map_that_is_none_is_refused_in_one_line(text: str, says: str, tmp_path: Path) -> None:
    path = tmp_path / "landmarks.csv"
    path.write_text(text)
    with pytest.raises(LocfuseError, match="landmarks") as error:
        map_files.read_landmarks(path)
    assert says in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("keys", "says"),
    [
        (("landmarks.file=nowhere.csv", "landmarks.map=landmarks.csv"), "no such file: nowhere.csv"),
        (("landmarks.file=detections.csv", "landmarks.map=nowhere.csv"), "no such file: nowhere.csv"),
        (("landmarks.file=detections.csv", 'landmarks.map={ "99" = [0.0, 1.0] }'), "the map has 99"),
    ],
)
def test_what_is_missing_is_said_in_one_line(
    keys: tuple[str, ...], says: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    log, *_ = written(tmp_path)
    monkeypatch.chdir(tmp_path)
    assert says in refused("run", log, *GEOMETRY, "--sensors", "landmarks", *sets(*keys), "-o", tmp_path / "out")


def test_bearings_in_degrees_are_refused(tmp_path: Path) -> None:
    log, _ = written(tmp_path)
    head, *lines = (tmp_path / "detections.csv").read_text().splitlines()
    rows = (line.rsplit(",", 1) for line in lines)
    degrees = "\n".join([head, *(f"{start},{math.degrees(float(bearing))}" for start, bearing in rows)])
    (tmp_path / "detections.csv").write_text(degrees)
    says = refused("run", log, *GEOMETRY, "--sensors", "landmarks", *files_of(tmp_path), "-o", tmp_path / "out")
    assert re.search(r"the bearings of \S*detections.csv reach 180: they look like degrees. Write radians", says)


def test_info_finds_the_file_and_init_writes_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    log, *_ = written(tmp_path)
    monkeypatch.chdir(tmp_path)
    words = (*GEOMETRY, *sets("landmarks.file=detections.csv", "landmarks.map=landmarks.csv"))
    said = locfuse("info", log, *words).stdout
    assert "detections.csv, named in the settings" in said
    assert "ready    odometry, landmarks" in said
    (tmp_path / "robot.toml").write_text(locfuse("init", log, *words).stdout)
    done = ok("compare", log, "--no-advice", "--robot", "robot.toml", "-o", "out")
    assert "landmarks" in done.stdout


def test_the_detector_is_at_its_mount_and_a_landmark_there_has_no_bearing() -> None:
    pose, mount = (1.4, 0.8, 0.7), (0.2, -0.1, 0.3)
    at = detector_at(pose, mount)
    assert at == pytest.approx(se2.transform(np.array(pose), np.array(mount[:2])))
    assert predict(pose, at, mount) is None


PLACE, MOUNT = (2.0, 1.5), (0.2, -0.1, 0.3)


def model_at(pose: tuple[float, float, float], sigma: float) -> tuple[LandmarksModel, JointBelief]:
    """A detector whose offset and share of depth are states, on a robot whose place is known to `sigma` [m]."""
    settings = LandmarksSettings(map={"7": PLACE}, file="seen.csv", x=0.2, y=-0.1, yaw_deg=math.degrees(0.3))
    model = LandmarksModel(settings)
    belief = JointBelief(pose, (sigma**2, 0.0, 0.0, 0.5 * sigma**2, 0.0, 1e-4), model.blocks())
    belief.transform(np.array([3, 4]), np.array([0.04, 0.25]), np.eye(2))
    return model, belief


def test_a_range_is_the_distance_less_its_share_of_depth_and_with_an_offset() -> None:
    pose = (0.3, -0.2, 0.4)
    model, belief = model_at(pose, 0.1)
    noise, ids = np.array([[[4e-4, 1e-4], [1e-4, 1e-2]]]), {"id": np.array([7.0])}
    one = Measurements(np.zeros(1), np.arange(2), np.array([[0.4, 2.0]]), noise, 1.0, np.zeros((2, 2)), ids)
    (seen,) = model.innovations(one, 0, belief)

    def h(x: Any) -> Any:
        turn = complex(math.cos(x[2]), math.sin(x[2]))
        d = complex(*PLACE) - complex(x[0], x[1]) - complex(*MOUNT[:2]) * turn
        angle = math.atan2(d.imag, d.real) - x[2] - MOUNT[2]
        return np.array([angle, abs(d) * (1.0 - x[4] * (1.0 - math.cos(0.4))) + x[3]])

    x = np.array([*pose, 0.04, 0.25])
    np.testing.assert_allclose(seen.y, np.array([0.4, 2.0]) - h(x), atol=1e-12)
    H = numeric_jacobian(h, x)
    columns, by_states, R = said(seen, belief)
    np.testing.assert_allclose(by_states, H, atol=1e-8)
    bend = H[0, :2] @ np.diag([0.01, 0.005]) @ H[0, :2]  # the bearing's own variance by the place, to second order
    np.testing.assert_allclose(R, np.array([[4e-4 + bend**2, 1e-4], [1e-4, 1e-2]]), rtol=1e-7)
    assert columns == (3, 4)


def grown(tmp_path: Path, detections: list[tuple[float, int]]) -> Any:
    """Run a drive of 10 s with detections (s, id) of unmapped landmarks."""
    log = written(tmp_path, seconds=10.0)[0]
    rows = "".join(f"{T0 // S + t:.6f},{key},{2 + key % 5},{key % 20 / 10 - 1}\n" for t, key in detections)
    (tmp_path / "many.csv").write_text(f"t,id,range,bearing\n{rows}")
    words = (*GEOMETRY, *sets(f"landmarks.file={tmp_path / 'many.csv'}"), "--sensors", "landmarks", "-v")
    return locfuse("run", log, "--no-advice", *words, "-o", tmp_path / "o")


def test_of_too_many_ids_the_most_frequent_are_placed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(points, "MAX_POINTS", 3)
    done = grown(tmp_path, sorted((0.5 + k, key) for key in range(6) for k in range(3 + (key >= 3))))
    told = " ".join(done.stderr.split())
    assert "3 of 6 ids are not placed in the map: beyond the 3 seen most often" in told
    assert "a map of 3 landmarks was made" in told


def test_a_tracker_that_counts_up_is_refused_in_one_line(tmp_path: Path) -> None:
    done = grown(tmp_path, [(k * 9.0 / 5000, k) for k in range(5000)])
    assert done.exit_code == 1
    assert "none of its 5000 ids is seen 3 times" in done.stderr
    assert len(done.stderr.splitlines()) == 1


def with_robot(log: Path, folder: Path, lines: str) -> Path:
    """A copy of a log in a folder of its own that says a robot.toml of its own."""
    folder.mkdir()
    return rewritten(folder / "log.mcap", source=log, robot=lines)


@pytest.mark.parametrize(
    ("lines", "key", "file"),
    [
        ("[landmarks]\nfile = '{}/detections.csv'", "landmarks.file", "detections.csv"),
        ("[landmarks]\nfile = '../detections.csv'", "landmarks.file", "detections.csv"),
        ("[landmarks]\nfile = '~/detections.csv'", "landmarks.file", "detections.csv"),
        ("[landmarks]\nfile = 'link/detections.csv'", "landmarks.file", "detections.csv"),
        ('[landmarks]\nfile = "\\u0000.csv"', "landmarks.file", "detections.csv"),
        ("[landmarks]\nmap = '{}/landmarks.csv'", "landmarks.map", "landmarks.csv"),
        ("[truth]\ntopic = '{}/truth.csv'", "truth.topic", "truth.csv"),
    ],
)
def test_a_log_names_no_file_outside_its_own_folder(tmp_path: Path, lines: str, key: str, file: str) -> None:
    log = with_robot(written(tmp_path, seconds=10.0)[0], tmp_path / "sent", lines.replace("{}", str(tmp_path)))
    (tmp_path / "sent" / "link").symlink_to(tmp_path, target_is_directory=True)
    words = ("run", log, *GEOMETRY, "--sensors", "odometry", "--no-advice", "-o", tmp_path / "out")
    refusal = refused(*words)
    assert f"attachment robot.toml: {key} names the file" in refusal
    assert f"give {key} in a file of your own: --robot FILE" in refusal
    ok(*words, *sets(f"{key}={tmp_path / file}"))


def test_a_log_names_files_in_its_own_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    settings = "[landmarks]\nfile = 'seen/d.csv'\nmap = 'm.csv'\n"
    log = with_robot(written(tmp_path, seconds=10.0)[0], tmp_path / "sent", settings)
    (log.parent / "seen").mkdir()
    (tmp_path / "detections.csv").rename(log.parent / "seen" / "d.csv")
    (tmp_path / "landmarks.csv").rename(log.parent / "m.csv")
    for folder, place in ((tmp_path, log), (log.parent, log.name)):
        monkeypatch.chdir(folder)
        out = tmp_path / f"of_{folder.name}"
        ok("run", place, *GEOMETRY, "--sensors", "landmarks", "--no-advice", "-o", out)


# --- ranges to anchors with ids: a map that is given or made, a start that nobody gave, and what is refused

ANCHORS = {1: (3.5, 3.0), 2: (-2.0, 3.2), 3: (-1.5, -2.5), 4: (3.0, -2.0)}
SIGMA, TOO_LONG = 0.05, 0.09
START = (0.7, -0.4, math.radians(130.0))


def moved(poses: Array) -> Array:
    """The path (n, 3) of a robot that begins at START instead of at 0."""
    return np.asarray(se2.compose(np.broadcast_to(np.array(START), poses.shape), poses))


def by_ranges(
    folder: Path,
    *words: str,
    seed: int = 1,
    anchors: Any = ANCHORS,
    far: float = 0.0,
    turns: bool = True,
    code: int = 0,
    seconds: float = 60.0,
    times: float = 1.0,
) -> tuple[dict[str, Any], str]:
    """Compare a log with its truth, ranges to one anchor every 0.1 s and a map.

    `far`: share of ranges that come 1.5 m too long, by way of a wall. All are written `times` as long.
    """
    t, angle = angles(seconds)
    if not turns:
        angle = np.repeat(angle[:, :1], 2, axis=1)
    true, rng = moved(path_of(angle)), np.random.default_rng(seed)
    lines = ["t,id,range"]
    for n, i in enumerate(range(5, len(t), 5)):
        key = sorted(anchors)[n % len(anchors)]
        r = float(np.hypot(*(true[i, :2] - anchors[key]))) + TOO_LONG + SIGMA * rng.standard_normal()
        lines.append(f"{T0 // S + t[i]:.9f},{key},{times * (r + 1.5 * (rng.random() < far))!r}")
    (folder / "ranges.csv").write_text("\n".join(lines) + "\n")
    log, given = log_of(folder / "x.mcap", joint_states(t, angle)), map_file(folder, anchors)
    own = sets(f"ranges.file={folder / 'ranges.csv'}", f"ranges.map={given}", f"ranges.sigma={SIGMA}")
    return landmark_drive.compared(log, truth_file(folder, t, true), *own, *words, code=code)


def test_ranges_tell_where_a_drive_begins_if_nobody_does_and_hold_it_there(tmp_path: Path) -> None:
    rows, stderr = by_ranges(tmp_path)
    assert "the drive begins at x 0.7" in stderr
    assert "found by its map" in stderr
    assert rows["ranges"]["position_rmse_m"] < 0.03
    assert rows["ranges"]["heading_rmse_deg"] < 5.0  # nobody gave the first
    assert 0.85 < rows["ranges"]["sensors"]["ranges"]["nis"] < 1.15
    x, y, theta = START
    given = sets(f"start.x={x}", f"start.y={y}", f"start.theta_deg={math.degrees(theta)}")
    assert "found by its map" not in by_ranges(tmp_path, *given)[1]


def test_over_many_drives_the_error_is_as_large_as_the_covariance_says(tmp_path: Path) -> None:
    words = (*sets("wheels.noise=1e-6"), "--sensors", "ranges")
    anees = [by_ranges(tmp_path, *words, seed=seed)[0]["ranges"]["anees"] for seed in range(4)]
    assert 0.5 < np.mean(anees) < 1.6


@pytest.mark.parametrize(
    ("times", "words"),
    [
        (1000.0, "times as much as the robot moves: they look like mm. Write metres"),
        (0.01, "as far apart as the ranges allow: it looks like cm. Write metres"),
    ],
)
def test_ranges_or_a_map_in_another_unit_are_refused(tmp_path: Path, times: float, words: str) -> None:
    rows, stderr = by_ranges(tmp_path, times=times, code=3, seconds=25.0)
    assert "ranges" not in rows
    assert words in stderr


def test_ranges_by_way_of_a_wall_are_refused(tmp_path: Path) -> None:
    rows, _ = by_ranges(tmp_path, far=0.15)
    assert rows["ranges"]["position_rmse_m"] < 0.05
    assert 0.1 < rows["ranges"]["sensors"]["ranges"]["rejected"] / 600 < 0.2


@pytest.mark.parametrize(
    ("anchors", "turns"), [({1: (3.5, 3.0), 2: (3.5, 0.5)}, False), ({1: (3.5, 3.0)}, True)], ids=["mirror", "one"]
)
def test_a_start_that_the_ranges_do_not_tell_is_not_invented(tmp_path: Path, anchors: Any, turns: bool) -> None:
    rows, stderr = by_ranges(tmp_path, anchors=anchors, turns=turns, code=3, seconds=25.0)
    assert "ranges" not in rows
    assert "the ranges do not tell where the drive begins" in stderr
    assert "Set [start] x, y, theta_deg" in stderr


def test_without_a_map_the_anchors_are_found_beside_the_drive(tmp_path: Path) -> None:
    by_ranges(tmp_path, "--sensors", "odometry")
    own = sets(f"ranges.file={tmp_path / 'ranges.csv'}", "ranges.map=grow", f"ranges.sigma={SIGMA}")
    words = ("--sensors", "ranges", "--save-map", tmp_path / "found.csv", "-o", tmp_path / "run")
    ok("run", tmp_path / "x.mcap", "--no-advice", *GEOMETRY, *own, *words)
    found = map_files.read_landmarks(tmp_path / "found.csv")
    for key, place in ANCHORS.items():  # in the frame of the start
        expected = se2.transform(se2.inverse(np.array(START)), np.array(place))
        assert np.hypot(*(np.array(found[str(key)]) - expected)) < 0.25


def test_where_an_anchor_stands_a_straight_drive_does_not_tell(tmp_path: Path) -> None:
    _, stderr = by_ranges(tmp_path, *sets("ranges.map=grow"), turns=False, code=3)
    assert "this drive does not tell where its anchors stand" in stderr
    assert "--set ranges.map=anchors.csv" in stderr


LIST = "std_msgs/Header header\nuint16[] id\nfloat32[] dis"
ONE = "std_msgs/Header header\nuint16 id\nfloat32 dis"


@pytest.mark.parametrize(("text", "many"), [(ONE, False), (LIST, True)])
def test_any_message_with_an_id_and_a_range_can_be_read(tmp_path: Path, text: str, many: bool) -> None:
    t = np.arange(5.0)
    one: list[dict[str, Any]] = [{"id": i, "dis": i + 0.5} for i in range(5)]
    lists: list[dict[str, Any]] = [{"id": [i, 7], "dis": [i + 0.5, 2.0]} for i in range(5)]
    log = package.open_log(custom(tmp_path / "c.mcap", "/uwb", "my_msgs/msg/Uwb", text, t, lists if many else one))
    assert log.find("/uwb:id,dis") is not None
    stream = log.stream("/uwb:id,dis")
    columns = stream.columns("id", "range")
    assert stream.msgtype == "locfuse/msg/Ranges"
    assert len(stream.t_ns) == (10 if many else 5)
    assert np.asarray(columns["id"]).tolist() == ([0, 7, 1, 7, 2, 7, 3, 7, 4, 7] if many else [0, 1, 2, 3, 4])
    assert np.asarray(columns["range"])[0] == 0.5


@pytest.mark.parametrize(
    ("fields", "words"),
    [
        ("id,nothing", "nothing"),
        ("id,header.frame_id", "header.frame_id is a text, not a number"),
        ("id,dis,id", "one field, or those of id and range"),
    ],
)
def test_fields_that_are_no_ids_and_ranges_are_one_line(tmp_path: Path, fields: str, words: str) -> None:
    rows: list[dict[str, Any]] = [{"id": 1, "dis": 1.0}]
    log = package.open_log(custom(tmp_path / "c.mcap", "/uwb", "my_msgs/msg/Uwb", ONE, np.zeros(1), rows))
    with pytest.raises(package.LocfuseError) as error:
        log.find(f"/uwb:{fields}")
    assert words in str(error.value)
    assert "\n" not in str(error.value)


def test_the_labyrinth_is_driven_from_an_unknown_start() -> None:
    """Real ranges of ultra-wideband radio, 7 to 15 cm too long; truth to about 1 cm."""
    table = {row["configuration"]: row for row in package.load("labyrinth").compare().table()}
    assert table["ranges"]["position_rmse_m"] < 0.10
    assert 0.7 < table["ranges"]["anees"] < 1.5


def test_start_and_anchors_are_exact_where_the_ranges_are() -> None:
    t, angle = angles(20.0)
    rel = path_of(angle)[::10]
    true, ids = moved(rel), np.arange(len(rel)) % 4 + 1
    at = np.array([ANCHORS[int(i)] for i in ids])
    ranges = np.hypot(*(true[:, :2] - at).T) + TOO_LONG
    found = present(start_among(at, rel[:, :2], t[::10], ranges, (0.05, 0.2)))
    assert found.values == pytest.approx([*START, TOO_LONG], abs=2e-3)
    ranges = np.hypot(*(rel[:, :2] - ANCHORS[1]).T)
    found = present(anchor_beside(rel[:, :2], t[::10], ranges, (0.05, 0.2)))
    assert found.values == pytest.approx([*ANCHORS[1], 0.0], abs=1e-3)
