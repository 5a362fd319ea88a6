"""Landmarks with ids: range and bearing to a known map, and what is wrong with a map."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bags import T0
from commands import locfuse
from landmark_drive import MAP, path_of
from mcap.reader import make_reader
from mcap.writer import Writer
from said import said
from textbook import numeric_jacobian, wrap
from wheel_bags import GEOMETRY, angles, joint_states, log_of

from locfuse.formats.robot import landmark_map
from locfuse.fusion.data import LocfuseError, Measurements
from locfuse.fusion.ekf.belief_arrays import JointBelief
from locfuse.fusion.sensors import points
from locfuse.fusion.sensors.landmarks import LandmarksModel, LandmarksSettings
from locfuse.fusion.sensors.points import predict

SIGMA_RANGE, SIGMA_BEARING, OFFSET = 0.05, math.radians(1.0), 0.08


def written(
    folder: Path,
    drift: float = 0.0,
    more: str = "",
    seed: int = 1,
    depth: bool = False,
    late: float = 0.0,
    seconds: float = 60.0,
    **changed: Any,
) -> tuple[Path, ...]:
    """Write a log whose wheels slip by `drift` of every turn, detections of the true path, truth and a map.

    `depth`: a camera that sees 60 degrees to either side and says depths; `late`: s by which the robot follows.
    """
    t, angle = angles(seconds)
    true = path_of(t, angle)
    slipping = angle + drift * np.stack((-(angle[:, 1] - angle[:, 0]), angle[:, 1] - angle[:, 0]), axis=-1) / 2
    log = log_of(folder / "x.mcap", joint_states(t - late, slipping))
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
            lines.append(f"{T0 // 10**9 + t[i]:.9f},{key},{float(r)!r},{float(b)!r}")
    (folder / "detections.csv").write_text("\n".join(lines) + "\n" + more)
    given = {**MAP, **{int(k[1:]): v for k, v in changed.items()}}
    rows = "".join(f"{key},{x},{y}\n" for key, (x, y) in given.items())
    (folder / "landmarks.csv").write_text(f"id,x,y\n{rows}")
    truth = "".join(
        f"{T0 // 10**9 + s:.9f},{x!r},{y!r},{th!r}\n" for s, (x, y, th) in zip(t, true.tolist(), strict=True)
    )
    (folder / "truth.csv").write_text(f"t,x,y,theta\n{truth}")
    return log, folder / "detections.csv", folder / "landmarks.csv", folder / "truth.csv"


def compared(files: tuple[Path, ...], *words: Any) -> tuple[dict[str, Any], str]:
    log, detections, given, truth = files
    sets = [f"landmarks.file={detections}", f"landmarks.map={given}", f"landmarks.sigma_range={SIGMA_RANGE}",
            f"landmarks.sigma_bearing_deg={math.degrees(SIGMA_BEARING)}"]  # fmt: skip
    typed = [word for key in sets for word in ("--set", key)]
    out = log.parent / "out"
    done = locfuse("compare", log, *GEOMETRY, *typed, "--truth", truth, "-v", "-o", out, "--overwrite", *words)
    assert done.exit_code == 0, done.stderr
    found: dict[str, Any] = json.loads((out / "report.json").read_text())
    return found, done.stderr


def test_landmarks_hold_a_robot_whose_wheels_drift_and_find_the_offset_of_the_ranges(tmp_path: Path) -> None:
    report, stderr = compared(written(tmp_path, drift=0.05))
    wheels, landmarks = (report["configurations"][name] for name in ("odometry", "landmarks"))
    assert wheels["position_rmse_m"] > 0.25
    assert landmarks["position_rmse_m"] < 0.06
    assert landmarks["heading_rmse_deg"] < 2.0
    assert 0.6 < landmarks["sensors"]["landmarks"]["nis"] < 1.6
    assert "swapped" not in stderr
    assert "from its place in the map" not in stderr


def test_anees_over_many_drives_is_one(tmp_path: Path) -> None:
    """Wheels that are exact but for the noise that is configured as small: only the landmarks' noise is drawn."""
    found = [
        compared(written(tmp_path, seed=seed), "--sensors", "landmarks", "--set", "wheels.noise=1e-9",
                 "--set", "start.sigma_xy=0.2", "--set", "start.sigma_theta_deg=5", "--write", "json")[0]
        for seed in range(4)
    ]  # fmt: skip
    nis = np.mean([r["configurations"]["landmarks"]["sensors"]["landmarks"]["nis"] for r in found])
    assert nis == pytest.approx(1.0, abs=0.12)  # 4 x 600 detections of two numbers


def test_depths_of_a_camera_are_told_from_distances_by_the_drive(tmp_path: Path) -> None:
    """The size of a tag in a picture says how far it is along the camera's axis: two thirds at 48 degrees."""
    files = written(tmp_path, depth=True)
    found, stderr = compared(files)
    fixed, _ = compared(files, "--set", "landmarks.range_depth=0")
    good, bad = (r["configurations"]["landmarks"] for r in (found, fixed))
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
    log, detections, given, truth = written(tmp_path, late=0.25)
    words = (
        "--set",
        f"landmarks.file={detections}",
        "--set",
        f"landmarks.map={given}",
        "--set",
        f"truth.topic={truth}",
    )
    done = locfuse("info", log, *GEOMETRY, *words)
    assert "wheels: stamps look 0.25 s early" in done.stdout
    assert "wheels.time_offset=0.25" in done.stdout
    assert "truth.time_offset" not in done.stdout
    done = locfuse("info", log, *GEOMETRY, "--set", f"truth.topic={truth}")  # nobody is there to say it
    assert "truth.time_offset=-0.25" in done.stdout


def test_two_swapped_landmarks_and_a_wrong_one_are_named(tmp_path: Path) -> None:
    swapped: dict[str, Any] = {"_6": MAP[7], "_7": MAP[6]}
    report, stderr = compared(written(tmp_path, **swapped))
    assert "ids 6 and 7 look swapped in the map" in stderr
    assert report["configurations"]["landmarks"]["position_rmse_m"] < 0.06
    _, stderr = compared(written(tmp_path, _9=(3.6, -1.0)))
    assert "id 9 is seen at (3.0" in stderr
    assert "0.6" in stderr.split("id 9 is seen at")[1].split("from its place")[0]
    assert "swapped" not in stderr


def test_ids_without_an_entry_and_two_tags_of_one_id_are_counted_and_the_rest_is_used(tmp_path: Path) -> None:
    twice = "".join(f"{T0 // 10**9 + 3.001:.9f},8,{r},0.1\n" for r in (1.0, 2.0))
    report, stderr = compared(written(tmp_path, more=f"{twice}{T0 // 10**9 + 4}.0,3,1.0,0.0\n"))
    assert "2 same id" in stderr
    assert "1 not in map" in stderr
    assert report["configurations"]["landmarks"]["position_rmse_m"] < 0.06


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
        landmark_map.read(path)
    assert says in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("sets", "says"),
    [
        (("landmarks.file=nowhere.csv", "landmarks.map=landmarks.csv"), "no such file: nowhere.csv"),
        (("landmarks.file=detections.csv", "landmarks.map=nowhere.csv"), "no such file: nowhere.csv"),
        (("landmarks.file=detections.csv", 'landmarks.map={ "99" = [0.0, 1.0] }'), "the map has 99"),
    ],
)
def test_what_is_missing_is_said_in_one_line(
    sets: tuple[str, ...], says: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    log, *_ = written(tmp_path)
    monkeypatch.chdir(tmp_path)
    words = [word for key in sets for word in ("--set", key)]
    done = locfuse("run", log, *GEOMETRY, "--sensors", "landmarks", *words, "-o", tmp_path / "out")
    assert done.exit_code == 1
    assert says in done.stderr
    assert len(done.stderr.splitlines()) == 1


def test_info_finds_the_file_and_init_writes_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    log, *_ = written(tmp_path)
    monkeypatch.chdir(tmp_path)
    words = (*GEOMETRY, "--set", "landmarks.file=detections.csv", "--set", "landmarks.map=landmarks.csv")
    said = locfuse("info", log, *words).stdout
    assert "detections.csv, named in the settings" in said
    assert "ready    odometry, landmarks" in said
    (tmp_path / "robot.toml").write_text(locfuse("init", log, *words).stdout)
    done = locfuse("compare", log, "--robot", "robot.toml", "-o", "out")
    assert done.exit_code == 0, done.stderr
    assert "landmarks" in done.stdout


def test_a_landmark_at_the_detector_has_no_bearing() -> None:
    assert predict((1.4, 0.8, 0.0), (1.4, 0.8), (0.0, 0.0, 0.0)) is None


PLACE, MOUNT = (2.0, 1.5), (0.2, -0.1, 0.3)


def detected(bearing: float, distance: float) -> Measurements:
    R = np.array([[[4e-4, 1e-4], [1e-4, 1e-2]]])
    return Measurements(
        np.zeros(1),
        np.arange(2),
        np.array([[bearing, distance]]),
        R,
        1.0,
        np.zeros((2, 2)),
        {"id": np.array([7.0])},
    )


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
    (seen,) = model.innovations(detected(0.4, 2.0), 0, belief)

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


def grown(tmp_path: Path, detections: list[tuple[float, int]], *words: str, jump: float = 0.0) -> Any:
    """Run a drive of 10 s with detections (s, id) of unmapped landmarks; `jump`: rad in odd seconds."""
    log = written(tmp_path, seconds=10.0)[0]
    rows = "".join(
        f"{T0 // 10**9 + t:.6f},{key},{2 + key % 5},{key % 20 / 10 - 1 + int(t) % 2 * jump}\n"
        for t, key in detections
    )
    (tmp_path / "many.csv").write_text(f"t,id,range,bearing\n{rows}")
    file = ("--set", f"landmarks.file={tmp_path / 'many.csv'}")
    return locfuse("run", log, *GEOMETRY, *file, "--sensors", "landmarks", "-v", "-o", tmp_path / "o", *words)


def test_of_more_ids_than_the_cap_those_seen_most_often_are_placed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
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


def with_robot(files: tuple[Path, ...], folder: Path, lines: str) -> Path:
    """A copy of the log of `files` in a folder of its own that says a robot.toml of its own."""
    folder.mkdir()
    with files[0].open("rb") as source, (folder / "log.mcap").open("wb") as sink:
        writer: Any = Writer(sink)
        writer.start()
        channels: dict[int, int] = {}
        for schema, channel, message in make_reader(source).iter_messages():
            assert schema is not None
            if channel.id not in channels:
                kind = writer.register_schema(schema.name, schema.encoding, schema.data)
                channels[channel.id] = writer.register_channel(channel.topic, channel.message_encoding, kind)
            writer.add_message(channels[channel.id], message.log_time, message.data, message.publish_time)
        writer.add_attachment(0, 0, "robot.toml", "application/toml", lines.encode())
        writer.finish()
    return folder / "log.mcap"


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
    log = with_robot(written(tmp_path), tmp_path / "sent", lines.replace("{}", str(tmp_path)))
    (tmp_path / "sent" / "link").symlink_to(tmp_path, target_is_directory=True)
    words = ("run", log, *GEOMETRY, "--sensors", "odometry", "--no-advice", "-o", tmp_path / "out")
    done = locfuse(*words)
    assert done.exit_code == 1
    assert f"attachment robot.toml: {key} names the file" in done.stderr
    assert f"give {key} in a file of your own: --robot FILE" in done.stderr
    assert len(done.stderr.splitlines()) == 1
    done = locfuse(*words, "--set", f"{key}={tmp_path / file}")
    assert done.exit_code == 0, done.stderr


def test_a_log_names_files_in_its_own_folder_wherever_the_reader_is(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    files = written(tmp_path)
    log = with_robot(files, tmp_path / "sent", "[landmarks]\nfile = 'seen/d.csv'\nmap = 'm.csv'\n")
    (tmp_path / "sent" / "seen").mkdir()
    (tmp_path / "sent" / "seen" / "d.csv").write_bytes(files[1].read_bytes())
    (tmp_path / "sent" / "m.csv").write_bytes(files[2].read_bytes())
    for folder, place in ((tmp_path, log), (log.parent, log.name)):
        monkeypatch.chdir(folder)
        out = tmp_path / f"of_{folder.name}"
        done = locfuse("run", place, *GEOMETRY, "--sensors", "landmarks", "--no-advice", "-o", out)
        assert done.exit_code == 0, done.stderr
