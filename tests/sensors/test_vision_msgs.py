"""Detections of vision_msgs, whose releases call one thing by several names, and of two detectors at once."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bags import T0, S, build, header
from mcap.writer import Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from locfuse.formats.logs.log import open_log
from locfuse.formats.messages.fields import resolve
from locfuse.formats.messages.schema import Scalar, Structure
from locfuse.fusion.data import LocfuseError
from locfuse.fusion.sensors.landmark_messages import NO_ID, Looks, Sighted, sighted

FX, CX = 400.0, 320.0
LOOKS = Looks(FX, CX, 0.0)
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
        **{
            f"Detection{d}D": "std_msgs/Header header\nvision_msgs/ObjectHypothesisWithPose[] results\n"
            f"vision_msgs/BoundingBox{d}D bbox\n{own}"
            for d in (2, 3)
        },
        **{
            f"Detection{d}DArray": f"std_msgs/Header header\nvision_msgs/Detection{d}D[] detections\n"
            for d in (2, 3)
        },
    }
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
    return sighted(open_log([tmp_path / "x.mcap"]).stream("/tags"), LOOKS)


RELEASES = pytest.mark.parametrize(
    ("results", "centre", "tracked"),
    [(NUMBERED, PLANE, False), (NAMED, PLANE, False), (NESTED, PLANE, False), (NESTED, POINTED, True)],
    ids=["ROS 1", "Foxy", "Galactic", "Humble"],
)


@RELEASES
def test_tags_in_the_picture_are_read_from_every_release(
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


@RELEASES
def test_tags_with_their_places_are_read_from_every_release(
    results: str, centre: str, tracked: bool, tmp_path: Path
) -> None:
    tags = [
        {"results": [hypothesis(results, tag)], "bbox": {"center": {"position": {"x": right, "z": ahead}}}}
        for tag, (right, ahead) in TAGS.items()
    ]
    found = seen(tmp_path, 3, release(results, centre, tracked), [tags, tags])
    assert found.ids.tolist() == [3, 12] * 2
    assert found.ranges is not None
    np.testing.assert_allclose(found.ranges, [math.hypot(*place) for place in TAGS.values()] * 2, atol=1e-12)


def test_an_id_of_a_tracker_comes_before_the_class(tmp_path: Path) -> None:
    tag = {"id": "7", "results": [hypothesis(NESTED, 3)], "bbox": {"center": {"position": {"z": 2.0}}}}
    assert seen(tmp_path, 3, release(NESTED, POINTED, True), [[tag]]).ids.tolist() == [7]


def test_objects_whose_classes_are_words_are_no_landmarks(tmp_path: Path) -> None:
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
