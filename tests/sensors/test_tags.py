"""Tags as their detectors publish them: poses in a camera's frame, or pixels; with a known map and without."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bags import STORE, T0, S, Said, cdr, header
from commands import locfuse
from landmark_drive import MAP, path_of
from numpy.typing import NDArray
from rosbags.typesys import get_types_from_msg
from wheel_bags import GEOMETRY, angles, joint_states, log_of

from locfuse.formats.robot import landmark_map
from locfuse.fusion import se2
from locfuse.fusion.data import ArrayStream, Ragged
from locfuse.fusion.sensors.landmark_messages import Looks, sighted

Array = NDArray[np.float64]
CAMERA = np.array([0.1, -0.05, math.radians(30.0)])  # on the base; turned, so that a forgotten mount shows
FX, CX = 400.0, 320.0
FRAME = "camera_optical"
METRE, BEARING = 0.03, math.radians(0.25)  # noise of places, and of what is seen in pixels
ARUCO, APRIL = "ros2_aruco_interfaces/msg/ArucoMarkers", "apriltag_msgs/msg/AprilTagDetectionArray"
ISAAC, VISION = "isaac_ros_apriltag_interfaces/msg/AprilTagDetectionArray", "vision_msgs/msg/Detection3DArray"
BUNDLED = "apriltag_ros/msg/AprilTagDetectionArray"
ARUCO_ROS, ARUCO_OPENCV = "aruco_msgs/msg/MarkerArray", "aruco_opencv_msgs/msg/ArucoDetection"
VISION_2D = "vision_msgs/msg/Detection2DArray"
POINT2 = "float64 x\nfloat64 y\n"
TEXTS = {
    ARUCO: "std_msgs/Header header\nint64[] marker_ids\ngeometry_msgs/Pose[] poses\n",
    "apriltag_msgs/msg/Point": POINT2,
    "apriltag_msgs/msg/AprilTagDetection": "string family\nint32 id\nint32 hamming\nfloat32 goodness\n"
    "float32 decision_margin\nPoint centre\nPoint[4] corners\nfloat64[9] homography\n",
    APRIL: "std_msgs/Header header\nAprilTagDetection[] detections\n",
    "isaac_ros_apriltag_interfaces/msg/AprilTagDetection": "string family\nint32 id\n"
    "geometry_msgs/PoseWithCovarianceStamped pose\n",
    ISAAC: "std_msgs/Header header\nAprilTagDetection[] detections\n",
    "apriltag_ros/msg/AprilTagDetection": "int32[] id\nfloat64[] size\n"
    "geometry_msgs/PoseWithCovarianceStamped pose\n",
    BUNDLED: "std_msgs/Header header\nAprilTagDetection[] detections\n",
    "vision_msgs/msg/BoundingBox3D": "geometry_msgs/Pose center\ngeometry_msgs/Vector3 size\n",
    "vision_msgs/msg/Detection3D": "std_msgs/Header header\nBoundingBox3D bbox\nstring id\n",
    VISION: "std_msgs/Header header\nDetection3D[] detections\n",
    "aruco_msgs/msg/Marker": "std_msgs/Header header\nuint32 id\ngeometry_msgs/PoseWithCovariance pose\n"
    "float64 confidence\n",
    ARUCO_ROS: "std_msgs/Header header\nMarker[] markers\n",
    "aruco_opencv_msgs/msg/MarkerPose": "int32 marker_id\ngeometry_msgs/Pose pose\n",
    ARUCO_OPENCV: "std_msgs/Header header\nMarkerPose[] markers\n",
    "vision_msgs/msg/Point2D": POINT2,
    "vision_msgs/msg/Pose2D": "Point2D position\nfloat64 theta\n",
    "vision_msgs/msg/BoundingBox2D": "Pose2D center\nfloat64 size_x\nfloat64 size_y\n",
    "vision_msgs/msg/Detection2D": "std_msgs/Header header\nBoundingBox2D bbox\nstring id\n",
    VISION_2D: "std_msgs/Header header\nDetection2D[] detections\n",
}
for _name, _text in TEXTS.items():
    if _name not in STORE.types:
        STORE.register(get_types_from_msg(_text, _name))


def aruco(stamp: dict[str, Any], seen: list[tuple[int, Array]]) -> bytes:
    return cdr(
        ARUCO, header=stamp, marker_ids=[k for k, _ in seen], poses=[{"position": _xyz(p)} for _, p in seen]
    )


def april(stamp: dict[str, Any], seen: list[tuple[int, Array]]) -> bytes:
    """The centre in the picture: x grows to the right. The noise is that of a bearing, the same all over it."""
    rng = np.random.default_rng([int(stamp["stamp"]["sec"]), int(stamp["stamp"]["nanosec"])])
    bearings = np.array([math.atan2(p[0], p[2]) for _, p in seen]) + BEARING * rng.normal(size=len(seen))
    tags = [
        {"id": k, "centre": {"x": CX + FX * math.tan(b), "y": 240.0}}
        for (k, _), b in zip(seen, bearings.tolist(), strict=True)
    ]
    return cdr(APRIL, header=stamp, detections=tags)


def isaac(stamp: dict[str, Any], seen: list[tuple[int, Array]]) -> bytes:
    tags = [{"id": k, "pose": {"pose": {"pose": {"position": _xyz(p)}}}} for k, p in seen]
    return cdr(ISAAC, header=stamp, detections=tags)


def bundled(stamp: dict[str, Any], seen: list[tuple[int, Array]]) -> bytes:
    """Lists of ids; a bundle of two tags stands where neither does."""
    tags = [([k], p) for k, p in seen]
    decoy = [(list(MAP)[:2], np.array([3.0, 0.0, 1.0]))]
    return cdr(
        BUNDLED,
        header=stamp,
        detections=[
            {"id": ids, "size": [0.1] * len(ids), "pose": {"pose": {"pose": {"position": _xyz(p)}}}}
            for ids, p in (*decoy, *tags)
        ],
    )


def vision(stamp: dict[str, Any], seen: list[tuple[int, Array]]) -> bytes:
    tags = [{"id": f"tag36h11:{k}", "bbox": {"center": {"position": _xyz(p)}}} for k, p in seen]
    return cdr(VISION, header=stamp, detections=tags)


def aruco_ros(stamp: dict[str, Any], seen: list[tuple[int, Array]]) -> bytes:
    markers = [{"id": k, "pose": {"pose": {"position": _xyz(p)}}} for k, p in seen]
    return cdr(ARUCO_ROS, header=stamp, markers=markers)


def aruco_opencv(stamp: dict[str, Any], seen: list[tuple[int, Array]]) -> bytes:
    return cdr(
        ARUCO_OPENCV, header=stamp, markers=[{"marker_id": k, "pose": {"position": _xyz(p)}} for k, p in seen]
    )


def _xyz(p: Array) -> dict[str, float]:
    return dict(zip("xyz", p.tolist(), strict=True))


def mount() -> Said:
    """/tf_static: the optical frame on the base, z ahead along CAMERA's yaw."""
    half = 0.5 * CAMERA[2]
    turn = np.array([0.0, 0.0, math.sin(half), math.cos(half)])
    q = _times(turn, np.array([-0.5, 0.5, -0.5, 0.5]))
    transform = {
        "header": header(T0, "base_link"),
        "child_frame_id": FRAME,
        "transform": {
            "translation": {"x": CAMERA[0], "y": CAMERA[1], "z": 0.3},
            "rotation": dict(zip("xyzw", q.tolist(), strict=True)),
        },
    }
    kind = "tf2_msgs/msg/TFMessage"
    return Said("/tf_static", kind, cdr(kind, transforms=[transform]), T0)


def _times(a: Array, b: Array) -> Array:
    v, w = np.cross(a[:3], b[:3]) + a[3] * b[:3] + b[3] * a[:3], a[3] * b[3] - a[:3] @ b[:3]
    return np.append(v, w)


def camera_info() -> Said:
    kind = "sensor_msgs/msg/CameraInfo"
    k = [FX, 0.0, CX, 0.0, FX, 240.0, 0.0, 0.0, 1.0]
    return Said("/camera_info", kind, cdr(kind, header=header(T0, FRAME), k=k), T0)


def written(
    folder: Path, kind: str, make: Callable[..., bytes], *more: Said, slips: float = 0.05, noise: float = METRE
) -> tuple[Path, Path, Path]:
    """A drive whose wheels slip by a share of every turn, past tags; the log, the map and the truth."""
    t, angle = angles(60.0)
    true = path_of(t, angle)
    slip = slips * (angle[:, 1] - angle[:, 0]) / 2
    said = [mount(), *more, *joint_states(t, angle + np.stack((-slip, slip), axis=-1))]
    rng = np.random.default_rng(1)
    for i in range(5, len(t), 10):
        eye = se2.compose(true[i], CAMERA)
        seen = []
        for key, place in MAP.items():
            x, y, _ = se2.between(eye, np.array([*place, 0.0]))
            if x > 0.3 and abs(y) < 1.2 * x:
                seen.append((key, np.array([-y, -0.2, x]) + noise * rng.standard_normal(3)))
        ns = T0 + round(t[i] * S)
        said.append(Said("/tags", kind, make(header(ns, FRAME), seen), ns + 2_000_000))
    log = log_of(folder / "x.mcap", said)
    (folder / "map.csv").write_text(landmark_map.encode((k, x, y) for k, (x, y) in MAP.items()))
    rows = zip(t, true.tolist(), strict=True)
    truth = "".join(f"{T0 // S + s:.9f},{x!r},{y!r},{th!r}\n" for s, (x, y, th) in rows)
    (folder / "truth.csv").write_text(f"t,x,y,theta\n{truth}")
    return log, folder / "map.csv", folder / "truth.csv"


def compared(files: tuple[Path, Path, Path], *words: Any) -> tuple[dict[str, Any], str]:
    log, given, truth = files
    known = () if any("grow" in str(word) for word in words) else ("--set", f"landmarks.map={given}")
    out = log.parent / "out"
    done = locfuse(
        "compare",
        log,
        "--no-advice",
        "-v",
        *GEOMETRY,
        *known,
        "--truth",
        truth,
        "-o",
        out,
        "--overwrite",
        "--write",
        "json,html",
        *words,
    )
    assert done.exit_code == 0, done.stderr
    return json.loads((out / "report.json").read_text())["configurations"], done.stderr


@pytest.mark.parametrize(
    ("kind", "make"),
    [
        (ARUCO, aruco),
        (ISAAC, isaac),
        (VISION, vision),
        (BUNDLED, bundled),
        (ARUCO_ROS, aruco_ros),
        (ARUCO_OPENCV, aruco_opencv),
    ],
)
def test_poses_of_tags_hold_the_robot(kind: str, make: Callable[..., bytes], tmp_path: Path) -> None:
    """By type alone, the camera's place by /tf_static: only the map is told."""
    found, _ = compared(written(tmp_path, kind, make))
    assert found["odometry"]["position_rmse_m"] > 0.25
    assert found["landmarks"]["position_rmse_m"] < 0.06
    assert found["landmarks"]["heading_rmse_deg"] < 0.5 * found["odometry"]["heading_rmse_deg"]


def test_pixels_of_tags_are_bearings_by_the_camera_info(tmp_path: Path) -> None:
    files = written(tmp_path, APRIL, april, camera_info(), noise=0.0)
    found, _ = compared(files, "--set", f"landmarks.sigma_bearing_deg={math.degrees(BEARING)}")
    assert found["landmarks"]["position_rmse_m"] < 0.3 * found["odometry"]["position_rmse_m"]
    assert "innovation of bearing" in (tmp_path / "out/report.html").read_text()


def test_pixels_without_a_camera_info_are_one_line_with_the_keys(tmp_path: Path) -> None:
    files = written(tmp_path, APRIL, april)
    done = locfuse(
        "run", files[0], "-v", *GEOMETRY, "--set", f"landmarks.map={files[1]}", "--sensors", "landmarks"
    )
    assert done.exit_code == 1
    assert "--set landmarks.fx=<px> --set landmarks.cx=<px>" in " ".join(done.stderr.split())


def looking(frame: str, x: float, yaw: float) -> Said:
    """/tf_static: an optical frame at x on the base whose z axis looks along yaw."""
    turn = np.array([0.0, 0.0, math.sin(yaw / 2), math.cos(yaw / 2)])
    q = dict(zip("xyzw", _times(turn, np.array([-0.5, 0.5, -0.5, 0.5])).tolist(), strict=True))
    transform = {"translation": {"x": x, "y": 0.0, "z": 0.3}, "rotation": q}
    kind = "tf2_msgs/msg/TFMessage"
    edge = {"header": header(T0, "base_link"), "child_frame_id": frame, "transform": transform}
    return Said("/tf_static", kind, cdr(kind, transforms=[edge]), T0)


def both_ways(folder: Path) -> tuple[Path, Path, Path]:
    """A drive past tags that are seen ahead and behind, by two cameras at the same instants."""
    _, given, truth = written(folder, ARUCO, aruco)
    t, angle = angles(60.0)
    true, rng = path_of(t, angle), np.random.default_rng(2)
    slip = 0.05 * (angle[:, 1] - angle[:, 0]) / 2
    said = list(joint_states(t, angle + np.stack((-slip, slip), axis=-1)))
    for name, x, yaw in (("front", 0.2, 0.0), ("rear", -0.3, math.pi)):
        said.append(looking(f"{name}_optical", x, yaw))
        for i in range(5, len(t), 10):
            eye, seen = se2.compose(true[i], np.array([x, 0.0, yaw])), []
            for key, place in MAP.items():
                ahead, left, _ = se2.between(eye, np.array([*place, 0.0]))
                if ahead > 0.3 and abs(left) < 1.2 * ahead:
                    seen.append((key, np.array([-left, -0.2, ahead]) + METRE * rng.standard_normal(3)))
            ns = T0 + round(t[i] * S)
            said.append(Said(f"/{name}/tags", ARUCO, aruco(header(ns, f"{name}_optical"), seen), ns + 2_000_000))
    return log_of(folder / "both.mcap", said), given, truth


def test_two_cameras_are_one_sensor_each_where_its_frame_sits(tmp_path: Path) -> None:
    files = both_ways(tmp_path)
    found, _ = compared(files)
    assert found["landmarks"]["position_rmse_m"] < 0.04
    seen = found["landmarks"]["sensors"]["landmarks"]["accepted"]
    alone, _ = compared(files, "--set", "landmarks.topic=/rear/tags")
    other, _ = compared(files, "--set", "landmarks.topic=/front/tags")
    parts = [run["landmarks"]["sensors"]["landmarks"]["accepted"] for run in (alone, other)]
    assert min(parts) > 50
    assert seen == pytest.approx(sum(parts), rel=0.02)
    wrong = "landmarks.mounts={'/front/tags'=[0.2,0,0], '/rear/tags'=[-0.3,0,0]}"
    turned, _ = compared(files, "--set", wrong)
    assert turned["landmarks"]["position_rmse_m"] > 3.0 * found["landmarks"]["position_rmse_m"]


def test_pictures_of_two_cameras_have_the_optics_of_their_own(tmp_path: Path) -> None:
    """Pixels are bearings by the CameraInfo of the frame; two cameras of different lenses."""
    t, angle = angles(60.0)
    true, said = path_of(t, angle), []
    slip = 0.05 * (angle[:, 1] - angle[:, 0]) / 2
    said += joint_states(t, angle + np.stack((-slip, slip), axis=-1))
    info = "sensor_msgs/msg/CameraInfo"
    for name, x, yaw, zoom in (("front", 0.2, 0.0, 1.0), ("rear", -0.3, math.pi, 2.0)):
        k = [zoom * FX, 0.0, CX, 0.0, zoom * FX, 240.0, 0.0, 0.0, 1.0]
        stamp = header(T0, f"{name}_optical")
        said += [looking(f"{name}_optical", x, yaw), Said(f"/{name}/info", info, cdr(info, header=stamp, k=k), T0)]
        for i in range(5, len(t), 10):
            eye, seen = se2.compose(true[i], np.array([x, 0.0, yaw])), []
            for key, place in MAP.items():
                ahead, left, _ = se2.between(eye, np.array([*place, 0.0]))
                if ahead > 0.3 and abs(left) < 1.2 * ahead:
                    seen.append({"id": key, "centre": {"x": CX - zoom * FX * left / ahead, "y": 240.0}})
            ns = T0 + round(t[i] * S)
            body = cdr(APRIL, header=header(ns, f"{name}_optical"), detections=seen)
            said.append(Said(f"/{name}/tags", APRIL, body, ns + 2_000_000))
    _, given, truth = written(tmp_path, ARUCO, aruco)
    files = log_of(tmp_path / "both.mcap", said), given, truth
    found, _ = compared(files, "--set", f"landmarks.sigma_bearing_deg={math.degrees(BEARING)}")
    assert found["landmarks"]["position_rmse_m"] < 0.03


def test_info_finds_tags_and_init_asks_for_their_map(tmp_path: Path) -> None:
    files = written(tmp_path, ARUCO, aruco)
    said = " ".join(locfuse("info", files[0], *GEOMETRY).stdout.split())
    assert "ready odometry, landmarks" in said
    assert "no landmarks.map is set: where the landmarks stand is estimated (grow)" in said
    table = locfuse("init", files[0], *GEOMETRY).stdout.partition("[landmarks]")[2].partition("\n[")[0]
    assert 'topic = "/tags"' in table
    assert "# map =" in table


def test_an_unknown_map_is_made_saved_and_used(tmp_path: Path) -> None:
    """Places are states: the robot is held by what it has seen itself, and the map that is left is true."""
    files = written(tmp_path, ARUCO, aruco)
    grow = ("--set", "landmarks.map=grow", "--set", "landmarks.range_offset=0")
    found, _ = compared(files, *grow)
    assert found["landmarks"]["position_rmse_m"] < 0.1
    assert found["landmarks"]["anees"] < 2.0
    made = tmp_path / "made.csv"
    words = ("--sensors", "landmarks", "--save-map", made, "-o", tmp_path / "run")
    done = locfuse("run", files[0], "-v", *GEOMETRY, *grow, *words)
    assert done.exit_code == 0, done.stderr
    places = landmark_map.read(made)
    assert {int(k) for k in places} == set(MAP)
    for key, place in places.items():
        assert np.hypot(*(np.array(place) - MAP[int(key)])) < 0.15
    again, _ = compared((files[0], made, files[2]))
    assert again["landmarks"]["position_rmse_m"] < 0.15


def test_bearings_alone_make_no_map_and_stop_no_other_sensor(tmp_path: Path) -> None:
    log, *_ = written(tmp_path, APRIL, april, camera_info())
    done = locfuse("compare", log, *GEOMETRY, "-v", "--no-advice", "--write", "json", "-o", tmp_path / "out")
    assert done.exit_code == 0, done.stderr
    said = " ".join(done.stderr.split())
    assert "absent: landmarks: /tags says bearings only, and a map is made of ranges" in said
    assert "--set landmarks.map=landmarks.csv" in said


def test_a_camera_that_looks_down_sees_further_than_the_floor() -> None:
    """A point 2 m ahead and 1 m below a camera that looks down by 20 degrees."""
    down = math.radians(20.0)
    z, y = 2.0 * math.cos(down) + 1.0 * math.sin(down), -2.0 * math.sin(down) + 1.0 * math.cos(down)
    one = np.array([0, 1])
    data: dict[str, Any] = {
        "marker_ids": Ragged(np.array([7]), one),
        "poses.position.x": Ragged(np.array([-0.5]), one),
        "poses.position.y": Ragged(np.array([y]), one),
        "poses.position.z": Ragged(np.array([z]), one),
    }
    found = sighted(ArrayStream("/tags", ARUCO, np.array([T0]), data), Looks(None, None, down))
    assert found.ranges is not None
    assert found.ranges[0] == pytest.approx(math.hypot(2.0, 0.5))
    assert found.bearings[0] == pytest.approx(math.atan2(0.5, 2.0))
