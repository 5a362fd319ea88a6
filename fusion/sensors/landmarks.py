"""Landmarks with ids: range and bearing to tags, barcodes or reflectors on a given or an estimated map.

With the detector at s = p + R(theta) m on the robot and the landmark l, d = l - s, a detection is

    range = |d| + offset + noise,    bearing = atan2(d_y, d_x) - theta - yaw + noise

(Thrun, Burgard and Fox 2005, 6.6.2). The ranges often have a constant error (the tag's face, the lens): the offset
is a state unless it is configured. From the size of a tag, a camera measures the depth |d| cos(b) along its axis,
with the bearing b from this axis. A file may have depths or distances, so the depth share k is a state:

    range = |d| (1 - k (1 - cos b)) + offset + noise,    k = 0 for a distance, 1 for a depth

b is the measured bearing. Some detectors measure bearings only. A detection with a range implies a landmark
position. If the implied positions of an id differ from the map, the id is reported; if two ids are at each other's
position, they are reported as swapped.

Without a map (`map = "grow"`, or none is set) the landmarks' positions are states in the local frame. Each is
appended at the position of its first detection (Thrun, Burgard and Fox 2005, 10.3: EKF SLAM with known
correspondences).
"""

from __future__ import annotations

import math
import re
from collections import defaultdict
from collections.abc import Mapping, Sequence
from contextlib import suppress
from typing import Any, ClassVar, NamedTuple

import msgspec
import numpy as np

from locfuse.fusion.data import (
    Array,
    Colour,
    Component,
    Ints,
    LocfuseError,
    Measurements,
    Ragged,
    Stream,
    plausible,
)
from locfuse.fusion.kernels.ekf import Innovation
from locfuse.fusion.mount import ASK_MOUNT
from locfuse.fusion.se2 import direction, transform, wrap, wrap_all
from locfuse.fusion.sensor import NO_BLOCK, Ask, Belief, Bias, Block, Model, Sensor, WheelMotion, given_or_state
from locfuse.fusion.statistics import chi_square, clipped_rms, robust_sigma
from locfuse.fusion.streams import arrays, parts_of

from .points import (
    MIN_JUDGED,
    IdReadings,
    Point,
    PointsModel,
    PointsSettings,
    Row,
    by_instant,
    detector_at,
    predict,
    used,
)

# ---- messages of detectors as one table: message, id, range, bearing ----
#
# Detectors with a camera give positions in its optical frame (REP 103: x right, y down, z ahead), or only the
# pixel of a tag's centre. For a camera tilted down by the angle p, the point (x, y, z) is z cos p - y sin p ahead
# of the camera and -x to its left. Tags that are published as frames of /tf have the same axes.

DETECTIONS = "locfuse/msg/Detections"  # a file beside the log
TAGS = "locfuse/msg/TagFrames"  # frames of /tf: a row for each tag, in the camera's optical axes
LAST_NUMBER = re.compile(r"\d+(?=\D*$)")
NO_ID = -1
MAX_BEARING_RAD, MAX_BEYOND_SHARE = 4.0 * math.pi, 0.05  # with a larger share beyond this they are not radians
BUNDLE_ID = -(2**62)  # id of a detection that consists of several tags: it is not used


class Fields(NamedTuple):
    """Names of the message fields that hold ids and positions of detections."""

    ids: str
    x: str
    y: str = ""  # "": only x is given, in pixels
    z: str = ""
    bundled: str = ""  # number of ids of each detection, if it has a list of ids
    classes: str = ""  # field with the ids if `ids` holds no number in any message


def _at(ids: str, position: str, bundled: str = "") -> Fields:
    x, y, z = (f"{position}.{axis}" for axis in "xyz")
    return Fields(ids, x, y, z, bundled)


# vision_msgs: `detections.id` is empty unless a tracker set it; then the tag's id is the class of the first
# hypothesis. The field names depend on the release ("|": the first name that a message has).
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


class Sighted(NamedTuple):
    """Detections of landmarks, m of them; the detections of one message are consecutive."""

    t_ns: Ints  # (m,)
    ids: Ints  # (m,) NO_ID: the id is missing or not a number
    ranges: Array | None  # (m,) m; None: the detector measures bearings only
    bearings: Array  # (m,) rad, counter-clockwise


def sighted(stream: Stream, optics: tuple[float | None, float | None], down: float) -> Sighted:
    """Return the landmark detections of a stream. Raises LocfuseError for pixels without a focal length.

    `optics` are the camera's focal length and image centre, both horizontal [px]; it is tilted `down` [rad].
    """
    if stream.msgtype == DETECTIONS:
        columns = arrays(stream, *READS[DETECTIONS])
        ranges: Array = np.asarray(columns["range"], np.float64)
        ids = np.asarray(columns["id"]).astype(np.int64)
        given = None if len(ranges) and np.isnan(ranges).all() else ranges
        return Sighted(stream.t_ns, ids, given, np.asarray(columns["bearing"], np.float64))
    if stream.msgtype == TAGS:
        ids, x, y, z = (np.asarray(column) for column in stream.columns(*READS[TAGS]).values())
        return _placed(stream.t_ns, ids.astype(np.int64), (x, y, z), down)
    fields = FIELDS[stream.msgtype]
    raw = stream.columns(*READS[stream.msgtype])
    row, ids = _first_ids(raw[fields.ids], raw[fields.bundled]) if fields.bundled else _ids(raw[fields.ids])
    if fields.classes and len(ids) and (ids == NO_ID).all():
        with suppress(LocfuseError):  # messages of a release without hypotheses have no ids
            row, ids = _ids(stream.columns(fields.classes)[fields.classes])
    alone = ids != BUNDLE_ID
    t_ns = stream.t_ns[row[alone]]
    x = _values(raw[fields.x], row, stream.topic)[alone]
    if stream.msgtype in PIXELS:
        fx, cx = optics
        if fx is None or cx is None:
            raise LocfuseError(
                f"{stream.topic} says where tags are in the picture, and no CameraInfo says how the camera looks.",
                role="landmarks",
                hint="Give its matrix: --set landmarks.fx=<px> --set landmarks.cx=<px>",
            )
        return Sighted(t_ns, ids[alone], None, np.arctan2(cx - x, fx))
    y, z = (_values(raw[name], row, stream.topic)[alone] for name in (fields.y, fields.z))
    return _placed(t_ns, ids[alone], (x, y, z), down)


def _placed(t_ns: Ints, ids: Ints, place: tuple[Array, Array, Array], down: float) -> Sighted:
    """Return detections from x, y, z (m,) [m] in optical axes of a camera that is tilted `down` [rad]."""
    x, y, z = place
    ahead = z * np.cos(down) - y * np.sin(down)
    return Sighted(t_ns, ids, np.hypot(x, ahead), np.arctan2(-x, ahead))


def _ids(column: Any) -> tuple[Ints, Ints]:
    """Return the message index and the id of each detection, (m,) each; the id of "tag36h11:5" is 5."""
    if isinstance(column, Ragged):
        rows = np.repeat(np.arange(len(column)), column.lengths)
        return rows, np.asarray(column.values[column.first[0] : column.first[-1]]).astype(np.int64)
    texts = [(row, text) for row, names in enumerate(column) for text in names]
    found = [LAST_NUMBER.search(text) for _, text in texts]
    ids = [int(match.group()) % 2**62 if match else NO_ID for match in found]
    return np.array([row for row, _ in texts], np.int64), np.array(ids, np.int64)


def _first_ids(ids: Any, counts: Any) -> tuple[Ints, Ints]:
    """Return the message index and the id of each detection, (m,) each; the id of a tag bundle is BUNDLE_ID."""
    n = counts.values[counts.first[0] : counts.first[-1]].astype(np.int64)
    values = ids.values[ids.first[0] : ids.first[-1]].astype(np.int64)
    out = np.where(n == 0, NO_ID, BUNDLE_ID)
    out[n == 1] = values[(np.cumsum(n) - n)[n == 1]]
    return np.repeat(np.arange(len(counts)), counts.lengths), out


def _values(column: Any, row: Ints, topic: str) -> Array:
    """Return the numbers of one field of all messages, one for each detection, (m,).

    `row` (m,) is the message of each detection. Raises LocfuseError if a message has not as many numbers as ids.
    """
    values = np.asarray(column.values[column.first[0] : column.first[-1]], np.float64)
    if not np.array_equal(np.bincount(row, minlength=len(column)), column.lengths):
        words = f"{topic} has {len(row)} ids and {len(values)} places: no way to tell which is whose"
        raise LocfuseError(words, role="landmarks")
    return values


LEVER = ("x", "y", "yaw")  # columns with the mount of each detection's camera, if there are several cameras
OFFSET, DEPTH = "range_offset", "range_depth"
SIGMA_DEPTH = 0.5  # prior sigma of k, whose true value is 0 or 1
MAX_DEPTH_SIGMA, MIN_DEPTH = 0.2, 0.5  # 1 sigma and value of k: limits for the note that ranges are depths
MAX_PLACE_NOTES = 20  # notes on landmarks with a wrong position in the map
WRONG_SIGMAS = 3.0  # sigmas of one detection's position; the median of many detections is much more exact
MIN_FIT = 50  # detections needed to evaluate poses

MIN_SHARE = 0.1  # least ratio range / distance: landmarks lie in front of a detector
ZEROS = 0.0, 0.0  # derivatives of a bearing by range offset and depth share
MAX_SIGMA_M = 0.3  # m, of the robot's position: above it, landmark positions are not stored


class LandmarksSettings(PointsSettings, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Settings of [landmarks] in robot.toml."""

    table: ClassVar[str] = "landmarks"
    what: ClassVar[str] = "landmarks"
    they: ClassVar[str] = "they"

    topics: tuple[str, ...] = ()  # for several cameras: the topic of each
    # topic -> x, y [m], yaw, down [deg]
    mounts: dict[str, tuple[float, ...]] = msgspec.field(default_factory=dict)
    optics: dict[str, tuple[float, float]] = msgspec.field(default_factory=dict)  # topic -> fx, cx [px]
    yaw_deg: float = 0.0  # degrees, of its mount
    pitch_deg: float = 0.0  # degrees by which the camera is tilted down
    fx: float | None = None  # px, focal length for tags given in pixels; not set: from the log's CameraInfo
    cx: float | None = None  # px, column of the picture's centre
    sigma_range: float = 0.1  # m
    sigma_bearing_deg: float = 1.5
    range_offset: float | None = None  # m by which ranges are too long; not set: estimated
    sigma_range_offset: float = 0.05  # m, 1 sigma of an estimated offset at the start
    range_depth: float | None = None  # 0: ranges are distances, 1: depths along the axis; not set: estimated

    positive: ClassVar[tuple[str, ...]] = (*PointsSettings.positive, "sigma_bearing_deg", "sigma_range_offset")


class Landmarks(Sensor):
    """The landmark detector: reads detections of landmarks with ids."""

    name = "landmarks"
    locates = True
    Settings = LandmarksSettings
    components = (Component("bearing", "deg", math.degrees(1.0)), Component("range", "m"))
    states: ClassVar[Mapping[str, tuple[Component, ...]]] = {
        OFFSET: (Component("range offset", "m"),),
        DEPTH: (Component("share of depth in the ranges", "%", 100.0),),
    }
    colour = Colour("#8f2f5a", "#ff9db5")
    noise_keys = ("sigma_bearing_deg", "sigma_range")
    bias = Bias("yaw_deg", -1.0)
    extra = True
    several_frames = True
    sees = "landmark"
    # detectors that publish tags in pixels often publish their positions in another message, which is preferred
    second_best = tuple(PIXELS)
    asks: ClassVar[Mapping[str, Ask]] = {
        "map": Ask(
            "landmarks.csv with columns id, x, y in m: where the landmarks stand. Without it they are estimated",
            blank=True,
        ),
        **dict.fromkeys(("x", "y", "yaw_deg"), Ask(f"m, m, degrees: {ASK_MOUNT}", blank=True)),
        "sigma_range": Ask("m: noise of one range"),
        "sigma_bearing_deg": Ask("degrees: noise of one bearing"),
    }
    reads: ClassVar[Mapping[str, tuple[str, ...]]] = READS

    def concerns(self, key: str, msgtype: str) -> bool:
        """Return whether a setting applies to a message type: range settings do not apply to pixels."""
        of_ranges = {"sigma_range", "range_offset", "sigma_range_offset", "range_depth"}
        return msgtype not in PIXELS or key not in of_ranges

    def measure(
        self, stream: Stream, settings: LandmarksSettings, wheels: WheelMotion, epoch_ns: int
    ) -> Measurements:
        """Measure z (m, 2) = (bearing [rad], range [m]) or (m, 1); detections with one stamp form one reading."""
        seen, camera = _seen(stream, settings)
        if settings.grows and seen.ranges is None:
            raise LocfuseError(
                f"{stream.topic} says bearings only, and a map is made of ranges: name one with columns id, x, y",
                role="landmarks",
                fixes=("landmarks.map=landmarks.csv",),
                hint="--set landmarks.map=landmarks.csv",
            )
        dropped = dict(stream.dropped)
        valid = np.asarray(plausible(seen.bearings))
        beyond = np.abs(seen.bearings[valid]) > MAX_BEARING_RAD
        if beyond.sum() > MAX_BEYOND_SHARE * len(beyond):
            most = float(np.abs(seen.bearings[valid]).max())
            words = f"the bearings of {stream.topic} reach {most:.0f}: they look like degrees. Write radians"
            raise LocfuseError(words, role="landmarks")
        if seen.ranges is not None:
            valid = valid & plausible(seen.ranges) & (seen.ranges > 0.0)
        keep, notes = used(IdReadings(stream.topic, seen.t_ns, seen.ids, camera, valid), settings, dropped)
        ids, parts = seen.ids[keep], [wrap_all(seen.bearings[keep])]
        turn = math.radians(settings.sigma_bearing_deg)
        sigmas = np.array([turn, settings.sigma_range])
        if seen.ranges is not None:
            parts.append(seen.ranges[keep])
        d = len(parts)
        t, first = by_instant(seen.t_ns[keep], epoch_ns, settings.time_offset)
        return Measurements(
            t=t,
            first=first,
            z=np.stack(parts, axis=-1),
            R_unit=np.broadcast_to(np.diag((sigmas[:d] / turn) ** 2), (len(ids), d, d)).copy(),
            scale=turn,
            floor=np.zeros((d, d)),
            extra={"id": ids.astype(np.float64), **_levers(parts_of(stream), camera[keep], settings)},
            dropped=dropped,
            notes=tuple(notes),
        )

    def misfit(self, m: Measurements, settings: LandmarksSettings, poses: Array) -> float | None:
        """Return the spread [rad] of bearing errors at poses (n, 3); None for an estimated map or few bearings."""
        if settings.grows:
            return None
        places = settings.places
        pose = np.repeat(poses, np.diff(m.first), axis=0)
        seen_from = transform(pose, mounts_of(m, self.mount(settings))[:, :2])
        at = np.array([places[int(i)] for i in m.extra["id"]]).reshape(-1, 2) - seen_from
        turned = pose[:, 2] + mounts_of(m, (0.0, 0.0, 0.0))[:, 2]  # one camera: its yaw does not change the spread
        off = wrap_all(m.z[:, 0] - np.arctan2(at[:, 1], at[:, 0]) + turned)
        off = wrap_all(off - np.median(off))
        return clipped_rms(off) if len(off) >= MIN_FIT else None

    def model(self, settings: LandmarksSettings) -> Model:
        """Return the filter model of the landmarks for a new run."""
        return LandmarksModel(settings)


def _seen(stream: Stream, settings: LandmarksSettings) -> tuple[Sighted, Ints]:
    """Return the detections of all cameras in time order, and the camera index of each (m,)."""
    found = []
    for part in parts_of(stream):
        _, _, _, *down = (*settings.mounts.get(part.topic, (0.0, 0.0, 0.0)), settings.pitch_deg)
        optics = settings.optics.get(part.topic, (settings.fx, settings.cx))
        found.append(sighted(part, optics, math.radians(down[0])))
    if len(found) == 1:
        return found[0], np.zeros(len(found[0].ids), np.int64)
    if any(seen.ranges is None for seen in found) and any(seen.ranges is not None for seen in found):
        raise LocfuseError(f"{stream.topic}: some say bearings only, and are not one sensor", role="landmarks")
    camera = np.repeat(np.arange(len(found)), [len(seen.ids) for seen in found])
    t_ns, ids, bearings = (np.concatenate([seen[i] for seen in found]) for i in (0, 1, 3))
    order = np.argsort(t_ns, kind="stable")
    ranges = None if found[0].ranges is None else np.concatenate([s.ranges for s in found if s.ranges is not None])
    sorted_ranges = None if ranges is None else ranges[order]
    return Sighted(t_ns[order], ids[order], sorted_ranges, bearings[order]), camera[order]


def _levers(parts: Sequence[Stream], camera: Ints, settings: LandmarksSettings) -> dict[str, Array]:
    """Return the mount of each detection's camera: x, y [m], yaw [rad], (m,) each; {} for one camera."""
    if len(parts) < 2:
        return {}
    usual = settings.x, settings.y, settings.yaw_deg
    mounts = np.array([settings.mounts.get(part.topic, usual)[:3] for part in parts]) * (1.0, 1.0, math.pi / 180.0)
    return dict(zip(LEVER, mounts[camera].T, strict=True))


def mounts_of(m: Measurements, usual: tuple[float, float, float]) -> Array:
    """Return the detector's mount for each row, (m, 3): x, y [m], yaw [rad]; `usual` if there is one detector."""
    if LEVER[0] not in m.extra:
        return np.tile(np.array(usual, np.float64), (len(m.z), 1))
    return np.stack([m.extra[name] for name in LEVER], axis=-1)


class Ranging(NamedTuple):
    """Range model: measured range = distance (1 - k short) + offset, with short = 1 - cos(bearing).

    The offset [m] and the depth share k are given or estimated.
    """

    offset: float  # m
    depth: float  # k
    columns: tuple[int, ...]  # of the states among offset and k, in this order
    free: tuple[bool, bool]  # whether offset and k are states

    def share(self, short: float) -> float:
        """Return the ratio measured range / true distance, with `short` = 1 - cos(bearing)."""
        return max(1.0 - self.depth * short, MIN_SHARE)

    def derivative(self, short: float, distance: float) -> tuple[float, ...]:
        """Return the derivatives of a measured range by offset and k, for those of the two that are states."""
        of_offset = (1.0,) if self.free[0] else ()
        return (*of_offset, -short * distance) if self.free[1] else of_offset


class LandmarksModel(PointsModel):
    """Model of range and bearing from the detector to a landmark."""

    def __init__(self, settings: LandmarksSettings) -> None:
        self.thresholds = [0.0, *(chi_square(settings.gate, d) for d in (1, 2))]  # by size of z
        super().__init__(settings, self.thresholds[2])
        self.mount = settings.x, settings.y, math.radians(settings.yaw_deg)
        self.given = settings.range_offset
        self.prior = settings.sigma_range_offset
        given = settings.file is None or settings.range_depth is not None  # k is unknown only for a file
        self.depth = (settings.range_depth or 0.0) if given else None
        self.sigmas = math.radians(settings.sigma_bearing_deg), settings.sigma_range
        self._seen_at: dict[int, list[tuple[float, float, float]]] = defaultdict(list)  # id -> x, y, sigma [m]

    def blocks(self) -> list[Block]:
        """Return the state blocks of range offset and depth share k, without those that are given."""
        free = {OFFSET: self.prior} if self.given is None else {}
        free |= {DEPTH: SIGMA_DEPTH} if self.depth is None else {}
        return [Block(name, np.zeros(1), np.array([[s**2]]), np.zeros(1)) for name, s in free.items()]

    def innovations(self, m: Measurements, i: int, belief: Belief) -> list[Innovation]:
        """Return the innovations of reading i; note where its detections see the landmarks of a given map."""
        found = super().innovations(m, i, belief)
        if self.joint or not found or m.z.shape[1] == 1:
            return found
        sigma = math.sqrt(max(belief.variance((1.0, 0.0, 0.0)), belief.variance((0.0, 1.0, 0.0))))  # m
        if sigma <= MAX_SIGMA_M:
            pose, ranging, z = belief.pose(), self._ranging(belief), m.plain["z"]
            for seen in found:
                angle, distance = z[seen.row, 0], z[seen.row, 1]
                distance = (distance - ranging.offset) / ranging.share(1.0 - math.cos(angle))
                mount = self._mount_of(m, seen.row)
                (x, y), (c, s) = detector_at(pose, mount), direction(pose[2] + mount[2] + angle)
                spread = math.hypot(sigma, self.sigmas[1], distance * self.sigmas[0])
                place = x + distance * c, y + distance * s, spread
                if math.isfinite(sum(place)):
                    self._seen_at[seen.landmark].append(place)
        return found

    def compared(
        self, m: Measurements, row: int, landmark: int, place: Point, at: tuple[int, ...], belief: Belief
    ) -> Innovation | None:
        """Return the innovation of the detection in row `row`; None if the landmark is too near the detector.

        `place` is the landmark's position [m]. If it is estimated, `at` holds its state columns, else nothing.
        """
        predicted, ranging = predict(belief.pose(), place, self._mount_of(m, row)), self._ranging(belief)
        if predicted is None:
            return None
        (distance, bearing), (by_range, by_bearing) = predicted
        z, R = m.plain["z"], m.plain["R"]
        # a bearing is not linear in the position: second-order variance (sigma_position / distance)^4
        bearing_variance = belief.variance((by_bearing[0], by_bearing[1], 0.0))
        off, r = wrap(z[row, 0] - bearing), R[row, 0, 0] + bearing_variance * bearing_variance
        # the derivative by the landmark's position is minus that by the robot's
        beside: tuple[float, ...] = (-by_bearing[0], -by_bearing[1]) if at else ()
        if z.shape[1] == 1:
            H_block = (beside,) if at else NO_BLOCK
            seen = belief.compare(row, (off,), (by_bearing,), ((r,),), self.thresholds[1], at, H_block)
            seen.landmark = landmark
            return seen
        short = 1.0 - math.cos(z[row, 0])
        share, more, columns = ranging.share(short), ranging.derivative(short, distance), at + ranging.columns
        y = off, z[row, 1] - share * distance - ranging.offset
        noise = (r, R[row, 0, 1]), (R[row, 1, 0], R[row, 1, 1])
        ahead, across, turned = share * by_range[0], share * by_range[1], share * by_range[2]
        H_block = NO_BLOCK
        if columns:
            H_block = (beside + ZEROS[: len(more)], (-ahead, -across, *more) if at else more)
        H = by_bearing, (ahead, across, turned)
        seen = belief.compare(row, y, H, noise, self.thresholds[2], columns, H_block)
        seen.landmark = landmark
        return seen

    def _ranging(self, belief: Belief) -> Ranging:
        """Return the range model with the present estimates of offset and depth share."""
        offset, of_offset = given_or_state(self.given, OFFSET, belief)
        depth, of_depth = given_or_state(self.depth, DEPTH, belief)
        return Ranging(offset, depth, of_offset + of_depth, (bool(of_offset), bool(of_depth)))

    def _mount_of(self, m: Measurements, row: int) -> Row:
        """Return the detector's mount (x [m], y [m], yaw [rad]) for a row."""
        if LEVER[0] not in m.extra:
            return self.mount
        x, y, yaw = (m.plain[name][row] for name in LEVER)
        return x, y, yaw

    def notes(self, belief: Any) -> list[str]:
        """Return notes on depths, on an estimated map and landmarks that move, or on errors of a given map."""
        if self.joint:
            made, *moving = self.map_notes("are the ranges in m and the bearings in rad?")
            return [made, *self._depth_notes(belief), *moving]
        seen = {key: np.array(rows) for key, rows in self._seen_at.items()}
        return [*self._depth_notes(belief), *wrong_places(self.places, seen)]

    def _depth_notes(self, belief: Any) -> list[str]:
        """Return a note if the ranges are depths along the camera's axis instead of distances."""
        if self.depth is not None:
            return []
        column, now = belief.block(DEPTH)
        share, sigma = float(now[0]), math.sqrt(max(float(belief.covariance[column, column]), 0.0))
        if sigma > MAX_DEPTH_SIGMA or share < MIN_DEPTH:
            return []
        return [
            f"its ranges are depths along its axis, not distances: {share:.2f} of that (1 sigma: {sigma:.2g}; "
            "landmarks.range_depth=1)"
        ]

    def append(self, m: Measurements, row: int, belief: Any) -> int:
        """Append l = s + r (cos, sin)(theta + yaw + bearing), a landmark's position, to the state."""
        (angle, distance), mount = m.z[row].tolist(), self._mount_of(m, row)
        ranging, short = self._ranging(belief), 1.0 - math.cos(angle)
        x, y = detector_at(belief.pose(), mount)
        share = ranging.share(short)
        r, (c, s) = (distance - ranging.offset) / share, direction(belief.theta + mount[2] + angle)
        by_turn = [[belief.y - y - r * s], [x - belief.x + r * c]]  # by theta: detector and ray turn together
        by_range = np.array([[c], [s]]) / share
        # r = (range - offset) / share: signs are opposite to those of the range
        by_states = [-v * by_range for v in ranging.derivative(short, r)]
        G = np.hstack((np.eye(2), by_turn, *by_states))
        J = np.hstack(([[-r * s], [r * c]], by_range))
        noise = J @ m.R[row] @ J.T
        column: int = belief.augment(np.array([x + r * c, y + r * s]), G, noise, ranging.columns)
        return column


def wrong_places(places: Mapping[int, Point], seen_at: Mapping[int, Array]) -> list[str]:
    """Return notes on landmarks whose positions in the map contradict their detections (n, 3).

    A detection has x, y and their standard deviation [m]. A landmark is wrong if the median of its detections
    differs from the map by more than WRONG_SIGMAS of one detection. Two wrong landmarks are swapped if the median
    of each agrees with the map position of the other one.
    """
    median = {key: np.median(rows, axis=0) for key, rows in seen_at.items() if len(rows) >= MIN_JUDGED}
    scatter = {key: max(map(robust_sigma, (seen_at[key] - v)[:, :2].T)) for key, v in median.items()}
    reach = {key: WRONG_SIGMAS * max(float(v[2]), scatter[key]) for key, v in median.items()}

    def away(key: int, entry: int) -> float:
        return math.hypot(median[key][0] - places[entry][0], median[key][1] - places[entry][1])

    wrong = sorted(key for key in median if away(key, key) > reach[key])
    if len(wrong) > 2 and 2 * len(wrong) > len(median):
        return [f"{len(wrong)} of {len(median)} landmarks are seen elsewhere than in the map: is [start] right?"]
    words, paired = [], set[int]()
    for a in wrong:
        for b in wrong:
            if a < b and away(a, b) < reach[a] and away(b, a) < reach[b]:
                words.append(f"ids {a} and {b} look swapped in the map: each is seen where the other should stand")
                paired |= {a, b}
    for key in wrong:
        if key not in paired:
            x, y, _ = median[key]
            words.append(
                f"id {key} is seen at ({x:.2f}, {y:.2f}) m, {away(key, key):.2f} m from its place in the map "
                f"({len(seen_at[key])} detections)"
            )
    left = len(words) - MAX_PLACE_NOTES
    return [*words[:MAX_PLACE_NOTES], f"{left} more notes of this kind"] if left > 0 else words
