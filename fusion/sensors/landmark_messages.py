"""Messages of tag and barcode detectors as one table: message, id, range, bearing.

Detectors that look through a camera give positions in its optical frame (REP 103: x right, y down, z ahead), or
only where a tag's centre is in the picture. A camera that looks down by the angle p sees a point (x, y, z) ahead
by z cos p - y sin p, and left by -x. Tags as frames of /tf come along these axes too.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from contextlib import suppress
from typing import Any, NamedTuple, cast

import numpy as np

from locfuse.fusion.data import Array, Ints, LocfuseError, Ragged, Stream

DETECTIONS = "locfuse/msg/Detections"  # a file beside the log
TAGS = "locfuse/msg/TagFrames"  # frames of /tf: a row for each tag, in the camera's optical axes
LAST_NUMBER = re.compile(r"\d+(?=\D*$)")
NO_ID = -1
BUNDLE = -(2**62)  # of several tags that are one detection: left out


class Fields(NamedTuple):
    """Where the ids and places are in a message type."""

    ids: str
    x: str
    y: str = ""  # "": in pixels, x only
    z: str = ""
    bundled: str = ""  # how many ids each detection has, where it holds a list of them
    classes: str = ""  # where the ids are, if `ids` holds no number at all


def _at(ids: str, position: str, bundled: str = "") -> Fields:
    x, y, z = (f"{position}.{axis}" for axis in "xyz")
    return Fields(ids, x, y, z, bundled)


# vision_msgs: a detection's id is empty unless a tracker gave it one, and the tag's is then that of its first
# hypothesis; what either is called differs between its releases ("|": the first that a message has).
CLASS = "detections.results.hypothesis.class_id|detections.results.id"
OF_VISION = f"detections.id|{CLASS}"
BUNDLES = _at("detections.id", "detections.pose.pose.pose.position", "detections.id.length")
# Message type -> its fields.
POSES: Mapping[str, Fields] = {
    "ros2_aruco_interfaces/msg/ArucoMarkers": _at("marker_ids", "poses.position"),
    "aruco_msgs/msg/MarkerArray": _at("markers.id", "markers.pose.pose.position"),
    "aruco_opencv_msgs/msg/ArucoDetection": _at("markers.marker_id", "markers.pose.position"),
    "isaac_ros_apriltag_interfaces/msg/AprilTagDetectionArray": _at(
        "detections.id", "detections.pose.pose.pose.position"
    ),
    "apriltag_ros/msg/AprilTagDetectionArray": BUNDLES,
    "apriltags2_ros/msg/AprilTagDetectionArray": BUNDLES,
    "apriltags_ros/msg/AprilTagDetectionArray": _at("detections.id", "detections.pose.pose.position"),
    "vision_msgs/msg/Detection3DArray": _at(OF_VISION, "detections.bbox.center.position")._replace(classes=CLASS),
}
PIXELS: Mapping[str, Fields] = {
    "apriltag_msgs/msg/AprilTagDetectionArray": Fields("detections.id", "detections.centre.x"),
    "vision_msgs/msg/Detection2DArray": Fields(
        OF_VISION, "detections.bbox.center.position.x|detections.bbox.center.x", classes=CLASS
    ),
}
FIELDS: Mapping[str, Fields] = {**POSES, **PIXELS}
READS: Mapping[str, tuple[str, ...]] = {
    DETECTIONS: ("id", "range", "bearing"),
    TAGS: ("id", "x", "y", "z"),
    **{kind: tuple(field for field in fields[:-1] if field) for kind, fields in FIELDS.items()},
}


class Looks(NamedTuple):
    """The camera's view: focal length and middle of its picture [px], and downward tilt [rad]."""

    fx: float | None
    cx: float | None
    down: float


class Sighted(NamedTuple):
    """Detections; those of one message follow each other."""

    t_ns: Ints  # (m,)
    ids: Ints  # (m,) NO_ID: none that is a number
    ranges: Array | None  # (m,) m; None: the detector says bearings only
    bearings: Array  # (m,) rad, counter-clockwise


def sighted(stream: Stream, looks: Looks) -> Sighted:
    """Return the detections of a topic or file. Raises LocfuseError for pixels without a focal length."""
    if stream.msgtype == DETECTIONS:
        columns = cast("dict[str, Array]", stream.columns(*READS[DETECTIONS]))
        ranges: Array = np.asarray(columns["range"], np.float64)
        ids = np.asarray(columns["id"]).astype(np.int64)
        told = None if len(ranges) and np.isnan(ranges).all() else ranges
        return Sighted(stream.t_ns, ids, told, np.asarray(columns["bearing"], np.float64))
    if stream.msgtype == TAGS:
        ids, x, y, z = (np.asarray(column) for column in stream.columns(*READS[TAGS]).values())
        return _placed(stream.t_ns, ids.astype(np.int64), (x, y, z), looks)
    fields = FIELDS[stream.msgtype]
    raw = stream.columns(*READS[stream.msgtype])
    row, ids = _first_ids(raw[fields.ids], raw[fields.bundled]) if fields.bundled else _ids(raw[fields.ids])
    if fields.classes and len(ids) and (ids == NO_ID).all():
        with suppress(LocfuseError):  # of releases without hypotheses: the ids are none
            row, ids = _ids(stream.columns(fields.classes)[fields.classes])
    alone = ids != BUNDLE
    t_ns = stream.t_ns[row[alone]]
    x = _values(raw[fields.x], row, stream.topic)[alone]
    if stream.msgtype in PIXELS:
        if looks.fx is None or looks.cx is None:
            raise LocfuseError(
                f"{stream.topic} says where tags are in the picture, and no CameraInfo says how the camera looks.",
                role="landmarks",
                hint="Give its matrix: --set landmarks.fx=<px> --set landmarks.cx=<px>",
            )
        return Sighted(t_ns, ids[alone], None, np.arctan2(looks.cx - x, looks.fx))
    y, z = (_values(raw[name], row, stream.topic)[alone] for name in (fields.y, fields.z))
    return _placed(t_ns, ids[alone], (x, y, z), looks)


def _placed(t_ns: Ints, ids: Ints, place: tuple[Array, Array, Array], looks: Looks) -> Sighted:
    """Return range and bearing of places x, y, z (m,) [m] in optical axes."""
    x, y, z = place
    ahead = z * np.cos(looks.down) - y * np.sin(looks.down)
    return Sighted(t_ns, ids, np.hypot(x, ahead), np.arctan2(-x, ahead))


def _ids(column: Any) -> tuple[Ints, Ints]:
    """Return the message of each detection and its id; of a text like "tag36h11:5" the id is the last number."""
    if isinstance(column, Ragged):
        rows = np.repeat(np.arange(len(column)), column.lengths)
        return rows, np.asarray(column.values[column.first[0] : column.first[-1]]).astype(np.int64)
    texts = [(row, text) for row, names in enumerate(column) for text in names]
    found = [LAST_NUMBER.search(text) for _, text in texts]
    ids = [int(match.group()) % 2**62 if match else NO_ID for match in found]
    return np.array([row for row, _ in texts], np.int64), np.array(ids, np.int64)


def _first_ids(ids: Any, counts: Any) -> tuple[Ints, Ints]:
    """Return the message of each detection and its id, BUNDLE where several tags are one detection."""
    n = counts.values[counts.first[0] : counts.first[-1]].astype(np.int64)
    values = ids.values[ids.first[0] : ids.first[-1]].astype(np.int64)
    out = np.where(n == 0, NO_ID, BUNDLE)
    out[n == 1] = values[(np.cumsum(n) - n)[n == 1]]
    return np.repeat(np.arange(len(counts)), counts.lengths), out


def _values(column: Any, row: Ints, topic: str) -> Array:
    """Return numbers, one per detection; `row` (n,) is the message of each of their ids."""
    values = np.asarray(column.values[column.first[0] : column.first[-1]], np.float64)
    if not np.array_equal(np.bincount(row, minlength=len(column)), column.lengths):
        raise LocfuseError(
            f"{topic} has {len(row)} ids and {len(values)} places: no way to tell which is whose", role="landmarks"
        )
    return values
