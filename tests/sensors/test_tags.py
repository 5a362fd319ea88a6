"""Tags as their detectors publish them: poses in a camera's frame, or pixels; with a known map and without."""

import math
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bags import STORE, T0, S, Said, build, cdr, header
from commands import locfuse, ok, refused
from landmark_drive import MAP, TF, TO_OPTICAL, compared, map_file, optical, seen_by, sets, slipping, truth_file
from mcap.writer import Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from wheel_bags import GEOMETRY, angles, joint_states, log_of, messages

from locfuse.formats.logs.log import open_log
from locfuse.formats.logs.transform_stream import named_as_tag, number_of
from locfuse.formats.messages.schema import Scalar, Structure, resolve
from locfuse.formats.robot import map_files
from locfuse.fusion.data import Array, ArrayStream, LocfuseError, Ragged
from locfuse.fusion.sensors.landmarks import NO_ID, Sighted, sighted

Make = Callable[[str, list[tuple[int, Array]]], dict[str, Any]]
ONE = {"camera": np.array([0.1, -0.05, math.radians(30.0)])}  # turned, so that a forgotten mount shows
TWO = {"front": np.array([0.2, 0.0, 0.0]), "rear": np.array([-0.3, 0.0, math.pi])}
FX, CX = 400.0, 320.0
ZOOM = {"camera": 1.0, "front": 1.0, "rear": 2.0}
METRE, BEARING = 0.03, math.radians(0.25)  # noise of places, and of what is seen in pixels
BEARINGS = f"landmarks.sigma_bearing_deg={math.degrees(BEARING)}"
ARUCO, APRIL = "ros2_aruco_interfaces/msg/ArucoMarkers", "apriltag_msgs/msg/AprilTagDetectionArray"
ISAAC, VISION = "isaac_ros_apriltag_interfaces/msg/AprilTagDetectionArray", "vision_msgs/msg/Detection3DArray"
BUNDLED = "apriltag_ros/msg/AprilTagDetectionArray"
ARUCO_ROS, ARUCO_OPENCV = "aruco_msgs/msg/MarkerArray", "aruco_opencv_msgs/msg/ArucoDetection"
HEAD, CAMERA_INFO = "std_msgs/Header header\n", "sensor_msgs/msg/CameraInfo"
TEXTS = {
    ARUCO: f"{HEAD}int64[] marker_ids\ngeometry_msgs/Pose[] poses\n",
    "apriltag_msgs/msg/Point": "float64 x\nfloat64 y\n",
    "apriltag_msgs/msg/AprilTagDetection": "string family\nint32 id\nint32 hamming\nfloat32 goodness\n"
    "float32 decision_margin\nPoint centre\nPoint[4] corners\nfloat64[9] homography\n",
    APRIL: f"{HEAD}AprilTagDetection[] detections\n",
    "isaac_ros_apriltag_interfaces/msg/AprilTagDetection": "string family\nint32 id\n"
    "geometry_msgs/PoseWithCovarianceStamped pose\n",
    ISAAC: f"{HEAD}AprilTagDetection[] detections\n",
    "apriltag_ros/msg/AprilTagDetection": "int32[] id\nfloat64[] size\n"
    "geometry_msgs/PoseWithCovarianceStamped pose\n",
    BUNDLED: f"{HEAD}AprilTagDetection[] detections\n",
    "vision_msgs/msg/BoundingBox3D": "geometry_msgs/Pose center\ngeometry_msgs/Vector3 size\n",
    "vision_msgs/msg/Detection3D": f"{HEAD}BoundingBox3D bbox\nstring id\n",
    VISION: f"{HEAD}Detection3D[] detections\n",
    "aruco_msgs/msg/Marker": f"{HEAD}uint32 id\ngeometry_msgs/PoseWithCovariance pose\nfloat64 confidence\n",
    ARUCO_ROS: f"{HEAD}Marker[] markers\n",
    "aruco_opencv_msgs/msg/MarkerPose": "int32 marker_id\ngeometry_msgs/Pose pose\n",
    ARUCO_OPENCV: f"{HEAD}MarkerPose[] markers\n",
}
for _name, _text in TEXTS.items():
    if _name not in STORE.types:
        STORE.register(get_types_from_msg(_text, _name))


def at(p: Array) -> dict[str, Any]:
    """A place ahead, left and up (3,) in the axes of an optical frame."""
    return {"position": {"x": -p[1], "y": -p[2], "z": p[0]}}


def bundled(_: str, seen: list[tuple[int, Array]]) -> dict[str, Any]:
    """Lists of ids; a bundle of two tags stands where neither does."""
    tags = [(list(MAP)[:2], np.array([1.0, -3.0, 0.0])), *(([k], p) for k, p in seen)]
    poses = [{"id": ids, "size": [0.1] * len(ids), "pose": {"pose": {"pose": at(p)}}} for ids, p in tags]
    return {"detections": poses}


POSES: dict[str, Make] = {
    ARUCO: lambda _, seen: {"marker_ids": [k for k, _ in seen], "poses": [at(p) for _, p in seen]},
    ISAAC: lambda _, seen: {"detections": [{"id": k, "pose": {"pose": {"pose": at(p)}}} for k, p in seen]},
    VISION: lambda _, seen: {"detections": [{"id": f"tag36h11:{k}", "bbox": {"center": at(p)}} for k, p in seen]},
    BUNDLED: bundled,
    ARUCO_ROS: lambda _, seen: {"markers": [{"id": k, "pose": {"pose": at(p)}} for k, p in seen]},
    ARUCO_OPENCV: lambda _, seen: {"markers": [{"marker_id": k, "pose": at(p)} for k, p in seen]},
}


def april(rng: np.random.Generator) -> Make:
    """The centre in the picture: x grows to the right. The noise is that of a bearing, the same all over it."""

    def made(name: str, seen: list[tuple[int, Array]]) -> dict[str, Any]:
        bearings = [math.atan2(-p[1], p[0]) + BEARING * rng.normal() for _, p in seen]
        x = [CX + ZOOM[name] * FX * math.tan(b) for b in bearings]
        centres = ({"x": u, "y": 240.0} for u in x)
        return {"detections": [{"id": k, "centre": c} for (k, _), c in zip(seen, centres, strict=True)]}

    return made


def written(
    folder: Path,
    kind: str,
    make: Make,
    cameras: Mapping[str, Array] = ONE,
    noise: float = METRE,
    with_info: bool = True,
) -> tuple[Path, Path]:
    """A drive whose wheels slip past tags that cameras see; the log and the truth."""
    t, counted, true = slipping()
    said, rng = joint_states(t, counted), np.random.default_rng(1)
    for name, mount in cameras.items():
        said += optical(f"{name}_optical", mount)
        if kind == APRIL and with_info:
            info = {"k": [ZOOM[name] * FX, 0.0, CX, 0.0, ZOOM[name] * FX, 240.0, 0.0, 0.0, 1.0]}
            said += messages(f"/{name}/info", CAMERA_INFO, np.zeros(1), [info], f"{name}_optical")
        for i, seen in seen_by(true, mount, rng, noise):
            ns = T0 + round(t[i] * S)
            data = cdr(kind, header=header(ns, f"{name}_optical"), **make(name, seen))
            said.append(Said(f"/{name}/tags", kind, data, ns + 2_000_000))
    return log_of(folder / "x.mcap", said), truth_file(folder, t, true)


def assert_held(files: tuple[Path, Path]) -> None:
    """With the map the tags hold a robot whose wheels slip."""
    found, _ = compared(*files, *sets(f"landmarks.map={map_file(files[0].parent)}"))
    assert found["odometry"]["position_rmse_m"] > 0.25
    assert found["landmarks"]["position_rmse_m"] < 0.06
    assert found["landmarks"]["heading_rmse_deg"] < 0.5 * found["odometry"]["heading_rmse_deg"]


@pytest.mark.parametrize("kind", POSES)
def test_poses_of_tags_hold_the_robot(kind: str, tmp_path: Path) -> None:
    """By type alone, the camera's place by /tf_static: only the map is given."""
    assert_held(written(tmp_path, kind, POSES[kind]))


@pytest.mark.parametrize(("cameras", "left"), [(ONE, 0.3), (TWO, 0.12)])
def test_pixels_are_bearings_by_their_own_camera(cameras: dict[str, Array], left: float, tmp_path: Path) -> None:
    files = written(tmp_path, APRIL, april(np.random.default_rng(4)), cameras, 0.0)
    words = (*sets(BEARINGS, f"landmarks.map={map_file(tmp_path)}"), "-o", tmp_path / "out")
    found, _ = compared(*files, *words)
    assert found["landmarks"]["position_rmse_m"] < left * found["odometry"]["position_rmse_m"]
    assert "innovation of bearing" in (tmp_path / "out/report.html").read_text()


def test_pixels_without_a_camera_info_are_one_line_with_the_keys(tmp_path: Path) -> None:
    log, _ = written(tmp_path, APRIL, april(np.random.default_rng(4)), with_info=False)
    words = ("-v", *GEOMETRY, *sets(f"landmarks.map={map_file(tmp_path)}"), "--sensors", "landmarks")
    assert "--set landmarks.fx=<px> --set landmarks.cx=<px>" in refused("run", log, *words)


def test_two_cameras_are_one_sensor_each_where_its_frame_sits(tmp_path: Path) -> None:
    files = written(tmp_path, ARUCO, POSES[ARUCO], TWO)
    known = f"landmarks.map={map_file(tmp_path)}"
    wrong = "landmarks.mounts={'/front/tags'=[0.2,0,0], '/rear/tags'=[-0.3,0,0]}"
    both, rear, front, turned = (
        compared(*files, *sets(known, *more))[0]["landmarks"]
        for more in ((), ("landmarks.topic=/rear/tags",), ("landmarks.topic=/front/tags",), (wrong,))
    )
    assert both["position_rmse_m"] < 0.04
    seen, *parts = (run["sensors"]["landmarks"]["accepted"] for run in (both, rear, front))
    assert min(parts) > 50
    assert seen == pytest.approx(sum(parts), rel=0.02)
    assert turned["position_rmse_m"] > 3.0 * both["position_rmse_m"]


def test_an_unknown_map_is_made_saved_and_used(tmp_path: Path) -> None:
    """Places are states: the robot is held by what it has seen itself, and the map that is left is true."""
    files = written(tmp_path, ARUCO, POSES[ARUCO])
    grow = sets("landmarks.map=grow", "landmarks.range_offset=0")
    found, _ = compared(*files, *grow)
    assert found["landmarks"]["position_rmse_m"] < 0.1
    assert found["landmarks"]["anees"] < 2.0
    made = tmp_path / "made.csv"
    words = ("--sensors", "landmarks", "--save-map", made, "-o", tmp_path / "run")
    ok("run", files[0], "-v", "--no-advice", *GEOMETRY, *grow, *words)
    places = map_files.read_landmarks(made)
    assert {int(k) for k in places} == set(MAP)
    for key, place in places.items():
        assert np.hypot(*(np.array(place) - MAP[int(key)])) < 0.15
    again, _ = compared(*files, *sets(f"landmarks.map={made}"))
    assert again["landmarks"]["position_rmse_m"] < 0.15


def test_bearings_alone_make_no_map_and_stop_no_other_sensor(tmp_path: Path) -> None:
    _, said = compared(*written(tmp_path, APRIL, april(np.random.default_rng(4))))
    assert "not used: landmarks: /camera/tags says bearings only, and a map is made of ranges" in said
    assert "--set landmarks.map=landmarks.csv" in said


def test_a_camera_that_looks_down_sees_further_than_the_floor() -> None:
    """A point 2 m ahead and 1 m below a camera that looks down by 20 degrees."""
    down = math.radians(20.0)
    z, y = 2.0 * math.cos(down) + 1.0 * math.sin(down), -2.0 * math.sin(down) + 1.0 * math.cos(down)
    values = {"marker_ids": 7, "poses.position.x": -0.5, "poses.position.y": y, "poses.position.z": z}
    data: dict[str, Any] = {name: Ragged(np.array([value]), np.array([0, 1])) for name, value in values.items()}
    found = sighted(ArrayStream("/tags", ARUCO, np.array([T0]), data), (None, None), down)
    assert found.ranges is not None
    assert found.ranges[0] == pytest.approx(math.hypot(2.0, 0.5))
    assert found.bearings[0] == pytest.approx(math.atan2(0.5, 2.0))


# --- tags as frames of /tf: a camera's numbered children, seen at every detection, beside frames that are none

CAMERA = np.array([0.1, -0.05, math.radians(30.0)])  # on the base; turned, so that a forgotten mount shows
OPTICAL, BODY = "camera_color_optical_frame", "camera_link"


def frame(t_ns: int, parent: str, child: str, p: Iterable[float], q: Iterable[float] = (0, 0, 0, 1)) -> Any:
    place, turn = (dict(zip("xyzw", map(float, values), strict=False)) for values in (p, q))
    found = {"header": header(t_ns, parent), "child_frame_id": child}
    return {**found, "transform": {"translation": place, "rotation": turn}}


def tf(t_ns: int, *frames: Any, topic: str = "/tf") -> Said:
    return Said(topic, TF, cdr(TF, transforms=frames), t_ns + 2_000_000)


def mount(topic: str = "/tf_static") -> list[Said]:
    """base_link -> camera_link (turned left) -> its optical frame."""
    half = 0.5 * CAMERA[2]
    link = frame(T0, "base_link", BODY, (CAMERA[0], CAMERA[1], 0.3), (0, 0, math.sin(half), math.cos(half)))
    optical = frame(T0, BODY, OPTICAL, (0, 0, 0), TO_OPTICAL)
    return [tf(T0 + i * S, link, optical, topic=topic) for i in range(1 if topic == "/tf_static" else 2)]


def drive(folder: Path, names: str = "tag_{}", camera: str = OPTICAL, *more: Said) -> tuple[Path, Path]:
    """A drive whose wheels slip in turns, past five tags; the log and the truth."""
    t, counted, true = slipping()
    said = [*(more or mount()), *joint_states(t, counted)]
    for i, seen in seen_by(true, CAMERA, np.random.default_rng(1), 0.03):
        ns = T0 + round(t[i] * S)
        axes = [(key, (-p[1], -p[2], p[0]) if "optical" in camera else p) for key, p in seen]
        frames = [frame(ns, camera, names.format(key), p, (0.5, 0.5, 0.5, 0.5)) for key, p in axes]
        said += [tf(ns, *frames)] if frames else []
        if i % 50 == 5:  # a link of the robot that has a number, and one that moves
            arm = frame(ns, "base_link", "arm_2", (0.1, 0, 0.01 * i))
            said.append(tf(ns, arm, frame(ns, camera, "imager_1", (0.01, 0, 0))))
    return log_of(folder / "x.mcap", said), truth_file(folder, t, true)


@pytest.mark.parametrize("names", ["tag_{}", "tag36h11:{}", "marker_{}", "robot1/aruco_{}", "as ROS 1"])
def test_tags_as_frames_hold_the_robot(names: str, tmp_path: Path) -> None:
    """By their names alone; the camera's place by /tf_static, or by /tf and with x ahead, as ROS 1 writes it."""
    assert_held(drive(tmp_path, "tag_{}", BODY, *mount("/tf")) if " " in names else drive(tmp_path, names))


def test_info_finds_the_tags_and_init_writes_them_with_their_camera(tmp_path: Path) -> None:
    log, _ = drive(tmp_path)
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


def test_a_frame_that_is_published_again_was_not_seen_again(tmp_path: Path) -> None:
    frames = [frame(T0 + i * S, OPTICAL, "tag_3", (0.0, 0.0, 1.0 + i // 3)) for i in range(9)]
    log = log_of(tmp_path / "x.mcap", [tf(T0 + i * S, one) for i, one in enumerate(frames)])
    stream = open_log([log]).stream(f"/tf:{OPTICAL}:tags")
    assert stream.columns("id", "z")["z"] == pytest.approx([1.0, 2.0, 3.0])
    assert dict(stream.dropped) == {"repeat": 6}
    assert (stream.t_ns - T0).tolist() == [0, 3 * S, 6 * S]


@pytest.mark.parametrize(
    ("parent", "children", "speed"),
    [
        ("base_link", ("tag_1", "tag_2"), 0.1),  # no camera
        (OPTICAL, ("imager_1", "imager_2"), 0.1),  # links
        (OPTICAL, ("tag_1",), 0.1),  # a single one may be anything
        (OPTICAL, ("tag", "marker"), 0.1),  # no number
        ("ceiling_camera", ("tag_1", "tag_2"), 0.1),  # a camera in the room, by /tf_static
        (OPTICAL, ("tag_1", "tag_2"), 0.0),  # calibration targets on the robot never move in the camera
    ],
)
def test_other_frames_are_no_tags(parent: str, children: tuple[str, ...], speed: float, tmp_path: Path) -> None:
    seen = [
        tf(ns, *(frame(ns, parent, c, (speed * i, k, 1)) for k, c in enumerate(children)))
        for i, ns in enumerate(range(T0, T0 + 5 * S, S // 10))
    ]
    room = tf(T0, frame(T0, "world", "ceiling_camera", (0, 0, 3)), topic="/tf_static")
    log = log_of(tmp_path / "x.mcap", [room, *mount(), *joint_states(*angles(10.0)), *seen])
    assert ":tags" not in locfuse("info", log, *GEOMETRY).stdout
    words = (*sets("landmarks.map=grow"), "--sensors", "landmarks", "-o", tmp_path / "o")
    assert locfuse("run", log, *GEOMETRY, *words).exit_code == 1


def test_numbers_of_frames() -> None:
    names = ("tag_3", "tag36h11:5", "ar_marker_12", "camera", "tag_3_link")
    assert [number_of(name) for name in names] == [3, 5, 12, None, None]
    assert not any(map(named_as_tag, ("stage/camera_2", "stage_2", "tag", "arm_2")))
    assert all(map(named_as_tag, ("apriltag3", "36h11:5", "robot/tags_2", "AR_marker_1")))


# --- detections of vision_msgs, whose releases call one thing by several names, and of two detectors at once

LOOKS = (FX, CX), 0.0
NUMBERED = "int64 id\nfloat64 score\n"  # ROS 1
NAMED = "string id\nfloat64 score\n"  # ROS 2, to Foxy
NESTED = "vision_msgs/ObjectHypothesis hypothesis\n"  # since Galactic
HYPOTHESIS = "string class_id\nfloat64 score\n"
PLANE, POINTED = "geometry_msgs/Pose2D center\n", "vision_msgs/Pose2D center\n"  # to Galactic, since Humble
TAGS = {3: (-1.0, 2.0), 12: (0.5, 4.0)}  # id -> to the right and ahead of the camera, m


def release(results: str, centre: str, tracked: bool) -> Any:
    """The types of one release, in a store of their own."""
    store = get_typestore(Stores.ROS2_HUMBLE)
    own = "string id\n" if tracked else ""
    types = {
        "ObjectHypothesis": HYPOTHESIS,
        "ObjectHypothesisWithPose": results,
        "Point2D": "float64 x\nfloat64 y\n",
        "Pose2D": "vision_msgs/Point2D position\nfloat64 theta\n",
        "BoundingBox2D": f"{centre}float64 size_x\nfloat64 size_y\n",
        "BoundingBox3D": "geometry_msgs/Pose center\ngeometry_msgs/Vector3 size\n",
    }
    for d in (2, 3):
        found = f"{HEAD}vision_msgs/ObjectHypothesisWithPose[] results\n"
        types[f"Detection{d}D"] = f"{found}vision_msgs/BoundingBox{d}D bbox\n{own}"
        types[f"Detection{d}DArray"] = f"{HEAD}vision_msgs/Detection{d}D[] detections\n"
    for name in types:
        store.types.pop(f"vision_msgs/msg/{name}", None)
        store.fielddefs.pop(f"vision_msgs/msg/{name}", None)
    for name, text in types.items():
        store.register(get_types_from_msg(text, f"vision_msgs/msg/{name}"))
    return store


def hypothesis(results: str, tag: int) -> dict[str, Any]:
    if results == NESTED:
        return {"hypothesis": {"class_id": f"tag36h11:{tag}"}}
    return {"id": tag if results == NUMBERED else str(tag)}


def seen(tmp_path: Path, d: int, store: Any, detections: list[list[dict[str, Any]]]) -> Sighted:
    """What is read of messages with these detections, one message a second."""
    kind = f"vision_msgs/msg/Detection{d}DArray"
    with (tmp_path / "x.mcap").open("wb") as file:
        writer: Any = Writer(file)
        writer.start()
        text = store.generate_msgdef(kind, ros_version=2)[0].encode()
        channel = writer.register_channel("/tags", "cdr", writer.register_schema(kind, "ros2msg", text))
        for i, found in enumerate(detections):
            at = T0 + i * S
            message = build(kind, store, header=header(at, "camera"), detections=found)
            writer.add_message(channel, at, bytes(store.serialize_cdr(message, kind)), at)
        writer.finish()
    return sighted(open_log([tmp_path / "x.mcap"]).stream("/tags"), *LOOKS)


RELEASES = pytest.mark.parametrize(
    ("results", "centre", "tracked"),
    [(NUMBERED, PLANE, False), (NAMED, PLANE, False), (NESTED, PLANE, False), (NESTED, POINTED, True)],
    ids=["ROS 1", "Foxy", "Galactic", "Humble"],
)


@RELEASES
def test_tags_in_pictures_and_with_places_of_every_release(
    results: str, centre: str, tracked: bool, tmp_path: Path
) -> None:
    """A point to the right of the middle of the picture has a negative bearing: -atan2(right, ahead)."""
    boxes = []
    for tag, (right, ahead) in TAGS.items():
        u = CX + FX * right / ahead
        middle = {"position": {"x": u}} if centre == POINTED else {"x": u}
        boxes.append({"results": [hypothesis(results, tag)], "bbox": {"center": middle}})
    found = seen(tmp_path, 2, release(results, centre, tracked), [boxes, boxes[1:], []])
    assert found.ids.tolist() == [3, 12, 12]
    assert ((found.t_ns - T0) // S).tolist() == [0, 0, 1]
    bearings = [-math.atan2(*TAGS[tag]) for tag in (3, 12, 12)]
    np.testing.assert_allclose(found.bearings, bearings, atol=1e-12)
    assert found.ranges is None
    tags = [
        {"results": [hypothesis(results, tag)], "bbox": {"center": {"position": {"x": right, "z": ahead}}}}
        for tag, (right, ahead) in TAGS.items()
    ]
    found = seen(tmp_path, 3, release(results, centre, tracked), [tags, tags])
    assert found.ids.tolist() == [3, 12] * 2
    assert found.ranges is not None
    np.testing.assert_allclose(found.ranges, [math.hypot(*place) for place in TAGS.values()] * 2, atol=1e-12)


def test_an_id_of_a_tracker_comes_before_the_class_and_words_are_no_landmarks(tmp_path: Path) -> None:
    tag = {"id": "7", "results": [hypothesis(NESTED, 3)], "bbox": {"center": {"position": {"z": 2.0}}}}
    assert seen(tmp_path, 3, release(NESTED, POINTED, True), [[tag]]).ids.tolist() == [7]
    chair = {"results": [{"hypothesis": {"class_id": "chair"}}], "bbox": {"center": {"position": {"z": 2.0}}}}
    assert seen(tmp_path, 3, release(NESTED, POINTED, True), [[chair]]).ids.tolist() == [NO_ID]


def test_a_field_whose_own_name_holds_the_bar_between_names_is_still_found() -> None:
    message = Structure("odd", {"a|b": Scalar("f8", 8), "b": Scalar("i4", 4), "c|": Scalar("u1", 1)})
    assert [resolve(message, path)[0].path for path in ("a|b", "c|", "x|b")] == ["a|b", "c|", "b"]


def test_a_detector_in_doubt_is_refused(tmp_path: Path) -> None:
    """Two hypotheses of one detection and none of the next: as many ids as places, and none is anybody's."""
    doubt = {"results": [hypothesis(NAMED, 1), hypothesis(NAMED, 2)], "bbox": {"center": {"x": 300.0}}}
    found = {"results": [hypothesis(NAMED, 1)], "bbox": {"center": {"x": 300.0}}}
    nothing: dict[str, Any] = {"results": [], "bbox": {"center": {"x": 310.0}}}
    with pytest.raises(LocfuseError, match="3 ids and 3 places: no way to tell which is whose"):
        seen(tmp_path, 2, release(NAMED, PLANE, False), [[doubt], [found, nothing]])
