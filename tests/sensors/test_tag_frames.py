"""Tags as frames of /tf: a camera's numbered children, seen at every detection, beside frames that are none."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bags import T0, S, Said, cdr, header
from commands import locfuse
from landmark_drive import MAP, path_of
from wheel_bags import GEOMETRY, angles, joint_states, log_of

from locfuse.formats.logs.log import open_log
from locfuse.formats.robot import landmark_map
from locfuse.formats.robot.tag_frames import named_as_tag, number_of
from locfuse.fusion import se2

KIND = "tf2_msgs/msg/TFMessage"
CAMERA = np.array([0.1, -0.05, math.radians(30.0)])  # on the base; turned, so that a forgotten mount shows
OPTICAL, BODY = "camera_color_optical_frame", "camera_link"
NOISE_M = 0.03
TO_OPTICAL = np.array([-0.5, 0.5, -0.5, 0.5])  # x, y, z, w: z ahead, x right


def frame(t_ns: int, parent: str, child: str, p: Iterable[float], q: Iterable[float] = (0, 0, 0, 1)) -> Any:
    return {
        "header": header(t_ns, parent),
        "child_frame_id": child,
        "transform": {
            "translation": dict(zip("xyz", map(float, p), strict=True)),
            "rotation": dict(zip("xyzw", map(float, q), strict=True)),
        },
    }


def tf(t_ns: int, *frames: Any, topic: str = "/tf") -> Said:
    return Said(topic, KIND, cdr(KIND, transforms=frames), t_ns + 2_000_000)


def mount(topic: str = "/tf_static") -> list[Said]:
    """base_link -> camera_link (turned left) -> its optical frame."""
    half = 0.5 * CAMERA[2]
    link = frame(T0, "base_link", BODY, (CAMERA[0], CAMERA[1], 0.3), (0, 0, math.sin(half), math.cos(half)))
    optical = frame(T0, BODY, OPTICAL, (0, 0, 0), TO_OPTICAL)
    said = [tf(T0, link, optical, topic=topic)]
    return said if topic == "/tf_static" else [*said, tf(T0 + S, link, optical, topic=topic)]


def drive(folder: Path, names: str = "tag_{}", camera: str = OPTICAL, *more: Said) -> tuple[Path, Path]:
    """A drive whose wheels slip in turns, past five tags; the log and the truth. Map: `known`."""
    t, angle = angles(60.0)
    true = path_of(t, angle)
    slip = 0.05 * (angle[:, 1] - angle[:, 0]) / 2
    said = [*more, *joint_states(t, angle + np.stack((-slip, slip), axis=-1))]
    rng = np.random.default_rng(1)
    for i in range(5, len(t), 10):
        eye = se2.compose(true[i], CAMERA)
        ns = T0 + round(t[i] * S)
        frames = []
        for key, place in MAP.items():
            x, y, _ = se2.between(eye, np.array([*place, 0.0]))
            if x > 0.3 and abs(y) < 1.2 * x:
                p = np.array([x, y, 0.2]) + NOISE_M * rng.standard_normal(3)  # ahead, left, up
                axes = (-p[1], -p[2], p[0]) if "optical" in camera else p
                frames.append(frame(ns, camera, names.format(key), axes, (0.5, 0.5, 0.5, 0.5)))
        if frames:
            said.append(tf(ns, *frames))
        if i % 50 == 5:  # a link of the robot that has a number, and one that moves
            arm = frame(ns, "base_link", "arm_2", (0.1, 0, 0.01 * i))
            eyes = frame(ns, camera, "imager_1", (0.01, 0, 0))
            said.append(tf(ns, arm, eyes))
    log = log_of(folder / "x.mcap", said)
    rows = zip(t, true.tolist(), strict=True)
    truth = "".join(f"{T0 // S + s:.9f},{x!r},{y!r},{th!r}\n" for s, (x, y, th) in rows)
    (folder / "truth.csv").write_text(f"t,x,y,theta\n{truth}")
    return log, folder / "truth.csv"


def known(folder: Path) -> Path:
    (folder / "map.csv").write_text(landmark_map.encode((k, x, y) for k, (x, y) in MAP.items()))
    return folder / "map.csv"


def compared(files: tuple[Path, Path], *words: Any) -> dict[str, Any]:
    out = files[0].parent / "out"
    given = ("--truth", files[1], "--no-advice", "-o", out, "--write", "json")
    done = locfuse("compare", files[0], *GEOMETRY, *given, "--overwrite", *words)
    assert done.exit_code == 0, done.stderr
    found: dict[str, Any] = json.loads((out / "report.json").read_text())["configurations"]
    return found


@pytest.mark.parametrize("names", ["tag_{}", "tag36h11:{}", "marker_{}", "robot1/aruco_{}"])
def test_tags_as_frames_hold_the_robot(names: str, tmp_path: Path) -> None:
    """By their names alone, the camera's place by /tf_static: only the map is told."""
    files = drive(tmp_path, names, OPTICAL, *mount())
    found = compared(files, "--set", f"landmarks.map={known(tmp_path)}")
    assert found["odometry"]["position_rmse_m"] > 0.25
    assert found["landmarks"]["position_rmse_m"] < 0.06
    assert found["landmarks"]["heading_rmse_deg"] < 0.5 * found["odometry"]["heading_rmse_deg"]


def test_a_camera_frame_whose_z_axis_is_up_and_that_only_tf_places(tmp_path: Path) -> None:
    """As ROS 1 writes it: x ahead, the mount on /tf."""
    files = drive(tmp_path, "tag_{}", BODY, *mount("/tf"))
    found = compared(files, "--set", f"landmarks.map={known(tmp_path)}")
    assert found["landmarks"]["position_rmse_m"] < 0.06


def test_info_finds_the_tags_and_init_writes_them_with_their_camera(tmp_path: Path) -> None:
    log, _ = drive(tmp_path, "tag_{}", OPTICAL, *mount())
    said = " ".join(locfuse("info", log, *GEOMETRY).stdout.split())
    assert f"/tf:{OPTICAL}:tags" in said
    assert "no landmarks.map is set: where the landmarks stand is estimated (grow)" in said
    table = locfuse("init", log, *GEOMETRY).stdout.partition("[landmarks]")[2].partition("\n[")[0]
    assert f'topic = "/tf:{OPTICAL}:tags"' in table
    assert "# map =" in table
    again = locfuse("init", log, *GEOMETRY, "--set", "landmarks.map=grow").stdout
    table = again.partition("[landmarks]")[2].partition("\n[")[0]
    assert "\nyaw_deg = 30.0\n" in table
    assert "\nx = 0.1\n" in table


def test_a_map_of_the_tags_is_made_where_nobody_knows_it(tmp_path: Path) -> None:
    files = drive(tmp_path, "tag_{}", OPTICAL, *mount())
    found = compared(files, "--set", "landmarks.map=grow", "--set", "landmarks.range_offset=0")
    assert found["landmarks"]["position_rmse_m"] < 0.1


def test_a_frame_that_is_published_again_was_not_seen_again(tmp_path: Path) -> None:
    frames = [frame(T0 + i * S, OPTICAL, "tag_3", (0.0, 0.0, 1.0 + i // 3)) for i in range(9)]
    log = log_of(tmp_path / "x.mcap", [tf(T0 + i * S, one) for i, one in enumerate(frames)])
    stream = open_log([log]).stream(f"/tf:{OPTICAL}:tags")
    assert stream.columns("id", "z")["z"] == pytest.approx([1.0, 2.0, 3.0])
    assert dict(stream.dropped) == {"repeat": 6}
    assert (stream.t_ns - T0).tolist() == [0, 3 * S, 6 * S]


@pytest.mark.parametrize(
    ("parent", "children"),
    [
        ("base_link", ("tag_1", "tag_2")),  # no camera
        (OPTICAL, ("imager_1", "imager_2")),  # links
        (OPTICAL, ("tag_1",)),  # a single one may be anything
        (OPTICAL, ("tag", "marker")),  # no number
        ("ceiling_camera", ("tag_1", "tag_2")),  # a camera in the room, by /tf_static
    ],
)
def test_other_frames_are_no_tags(parent: str, children: tuple[str, ...], tmp_path: Path) -> None:
    moving = [
        tf(
            T0 + i * S // 10,
            *(frame(T0 + i * S // 10, parent, c, (0.1 * i, k, 1)) for k, c in enumerate(children)),
        )
        for i in range(50)
    ]
    room = tf(T0, frame(T0, "world", "ceiling_camera", (0, 0, 3)), topic="/tf_static")
    t, angle = angles(10.0)
    log = log_of(tmp_path / "x.mcap", [room, *mount(), *joint_states(t, angle), *moving])
    assert ":tags" not in locfuse("info", log, *GEOMETRY).stdout
    done = locfuse(
        "run", log, *GEOMETRY, "--set", "landmarks.map=grow", "--sensors", "landmarks", "-o", tmp_path / "o"
    )
    assert done.exit_code == 1


def test_tags_that_never_move_in_the_camera_are_no_tags(tmp_path: Path) -> None:
    """Calibration targets on the robot."""
    still = [
        tf(T0 + i * S, *(frame(T0 + i * S, OPTICAL, f"tag_{k}", (k, 0, 1)) for k in (1, 2))) for i in range(9)
    ]
    t, angle = angles(10.0)
    log = log_of(tmp_path / "x.mcap", [*mount(), *joint_states(t, angle), *still])
    assert ":tags" not in locfuse("info", log, *GEOMETRY).stdout


def test_numbers_of_frames() -> None:
    assert [number_of(name) for name in ("tag_3", "tag36h11:5", "ar_marker_12", "camera", "tag_3_link")] == [
        3,
        5,
        12,
        None,
        None,
    ]
    assert not any(map(named_as_tag, ("stage/camera_2", "stage_2", "tag", "arm_2")))
    assert all(map(named_as_tag, ("apriltag3", "36h11:5", "robot/tags_2", "AR_marker_1")))
