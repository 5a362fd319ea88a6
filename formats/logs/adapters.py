"""Adapters: convert messages of one type to another type, such as a point cloud to a laser scan.

The entry of an adapter in PRESENTED names its source fields. Arguments: the columns of these fields for k
messages, the wanted fields of the target type, and the frame of the messages. Result: at least the wanted columns.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple, cast

import numpy as np

from locfuse.formats.geometry import quaternions
from locfuse.fusion.data import Array, Column, Ints, Ragged, totals
from locfuse.fusion.se2 import rotated_3d, yaw as yaw_of

Columns = Mapping[str, Column]
Adapter = Callable[[Columns, tuple[str, ...], str], dict[str, Column]]


def _numbers(column: Column) -> Array:
    return np.asarray(cast("Array", column), np.float64)


def _ragged(columns: Columns, name: str) -> Ragged:
    return cast("Ragged", columns[name])


def _stacked(columns: Columns, names: tuple[str, ...]) -> Array:
    return np.stack([_numbers(columns[name]) for name in names], axis=-1)


def _axes(before: str, axes: str) -> tuple[str, ...]:
    return tuple(f"{before}.{axis}" for axis in axes)


# --- Joints

JOINTS = "sensor_msgs/msg/JointState"
DYNAMIC = "control_msgs/msg/DynamicJointState"
INTERFACES, VALUES = "interface_values.interface_names", "interface_values.values"
OF_DYNAMIC = ("joint_names", INTERFACES, VALUES, f"{VALUES}.length")
FOXGLOVE_JOINTS = ("foxglove.JointStates", "foxglove_msgs/msg/JointStates")
OF_FOXGLOVE_JOINTS = ("joints.name", "joints.position", "joints.velocity", "joints.effort")
# Motor feedback of Clearpath's Jackal: left, right; wheel angle [rad] and rate [rad/s].
FEEDBACK = ("jackal_msgs/msg/Feedback", "clearpath_platform_msgs/msg/Feedback")
OF_FEEDBACK = ("drivers.measured_travel", "drivers.measured_velocity")
DRIVERS = ("left_wheel", "right_wheel")


def as_joints(columns: Columns, fields: tuple[str, ...], frame_id: str) -> dict[str, Column]:
    """Convert DynamicJointState columns to JointState; missing values are NaN."""
    names, interfaces = (cast("list[tuple[str, ...]]", columns[key]) for key in ("joint_names", INTERFACES))
    values, lengths = _ragged(columns, VALUES), _ragged(columns, f"{VALUES}.length")
    first = totals([len(row) for row in names], np.int64)
    made = {field: [np.empty(0)] for field in fields if field != "name"}
    places: dict[tuple[object, ...], Ints] = {}  # joints, names and numbers of their values, field -> places
    for i, row in enumerate(names):
        numbers = np.append(values[i].astype(np.float64), np.nan)  # at place -1: missing
        for field, pieces in made.items():
            key = (row, interfaces[i], lengths[i].tobytes(), field)
            if key not in places:
                places[key] = _places(len(row), interfaces[i], lengths[i], field)
            pieces.append(numbers[places[key]])
    return {"name": names, **{field: Ragged(np.concatenate(pieces), first) for field, pieces in made.items()}}


def joints_of_foxglove(columns: Columns, fields: tuple[str, ...], frame_id: str) -> dict[str, Column]:
    """Convert Foxglove JointStates columns to sensor_msgs/JointState."""
    return {name: columns[f"joints.{name}"] for name in fields}


def joints_of_feedback(columns: Columns, fields: tuple[str, ...], frame_id: str) -> dict[str, Column]:
    """Convert Jackal motor Feedback columns to JointState; without exactly two motors, names are empty."""
    travel, rate = (_ragged(columns, name) for name in OF_FEEDBACK)
    names = [DRIVERS if n == len(DRIVERS) else ("",) * n for n in travel.lengths.tolist()]
    return {"position": travel, "velocity": rate, "name": names}


def _places(joints: int, interfaces: tuple[str, ...], lengths: Ints, field: str) -> Ints:
    """Return for each joint the index (joints,) of its `field` in the value list of a message; -1 if missing.

    `interfaces`: the name of each value in the list. `lengths`: the number of values of each joint.
    """
    at = np.full(joints, -1)
    if len(interfaces) != lengths.sum() or len(lengths) != joints:
        return at
    begin = np.cumsum(lengths) - lengths
    for j, (first, n) in enumerate(zip(begin.tolist(), lengths.tolist(), strict=True)):
        own = interfaces[first : first + n]
        if field in own:
            at[j] = first + own.index(field)
    return at


# --- Odometry and IMU. Axes of PX4: world north, east, down; body forward, right, down. Axes of ROS (REP 103):
# world east, north, up; body forward, left, up. Heading in ROS = pi / 2 - yaw of PX4.

ODOMETRY, IMU = "nav_msgs/msg/Odometry", "sensor_msgs/msg/Imu"
FOXGLOVE_ODOMETRY = ("foxglove.Odometry", "foxglove_msgs/msg/Odometry")
SPORT_STATE = "unitree_go/msg/SportModeState"  # of Unitree's legged robots
PLANE_POSE = (*_axes("pose.position", "xy"), *_axes("pose.orientation", "xyzw"))
SPEEDS = ("linear_velocity.x", "angular_velocity.z")  # in the body frame
COVARIANCES = ("pose_covariance", "velocity_covariance")
OF_FOXGLOVE_ODOMETRY = (*PLANE_POSE, *SPEEDS, *COVARIANCES)
OF_SPORT_STATE = ("position", "imu_state.quaternion")
VEHICLE_ODOMETRY = "px4_msgs/msg/VehicleOdometry"
LOCAL_POSITION = "px4_msgs/msg/VehicleLocalPosition"
SENSOR_COMBINED = "px4_msgs/msg/SensorCombined"
OF_ODOMETRY = ("position", "q", "velocity_frame", "velocity", "angular_velocity")
OF_POSITION = ("x", "y", "heading", "vx", "vy")
OF_SENSOR = ("gyro_rad", "accelerometer_m_s2")
BODY_FRAME = 3  # value of velocity_frame for the body frame: forward, right, down


def _odometry(x: Array, y: Array, q: Array, ahead: Array, rate: Array) -> dict[str, Column]:
    """Return Odometry columns with zero covariances; x, y [m], speed [m/s], yaw rate [rad/s] (k,), q (k, 4)."""
    return {
        "pose.pose.position.x": x,
        "pose.pose.position.y": y,
        **dict(zip(_axes("pose.pose.orientation", "xyzw"), q.T, strict=True)),
        "twist.twist.linear.x": ahead,
        "twist.twist.angular.z": rate,
        **{f"{part}.covariance": np.zeros((len(x), 36)) for part in ("pose", "twist")},
    }


def odometry_of_foxglove(columns: Columns, fields: tuple[str, ...], frame_id: str) -> dict[str, Column]:
    """Convert Foxglove Odometry columns to nav_msgs/Odometry; missing velocities become 0."""
    x, y, *q = (_numbers(columns[name]) for name in PLANE_POSE)
    speeds = (np.nan_to_num(_numbers(columns[name]), nan=0.0) for name in SPEEDS)
    made = _odometry(x, y, np.stack(q, axis=-1), *speeds)
    for part, name in zip(("pose", "twist"), COVARIANCES, strict=True):
        made[f"{part}.covariance"] = _six_by_six(columns[name])
    return made


def odometry_of_sport_state(columns: Columns, fields: tuple[str, ...], frame_id: str) -> dict[str, Column]:
    """Convert Unitree SportModeState columns to Odometry: poses, with zero velocities."""
    place, wxyz = (_numbers(columns[name]) for name in OF_SPORT_STATE)
    still = np.zeros(len(place))
    return _odometry(place[:, 0], place[:, 1], np.roll(wxyz, -1, axis=1), still, still)


def _six_by_six(column: Column) -> Array:
    """Return covariances as (n, 36); one of another length becomes zeros."""
    if not isinstance(column, Ragged):
        return _numbers(column).reshape(-1, 36)
    matrix = np.zeros((len(column), 36))
    whole = column.lengths == matrix.shape[1]
    matrix[whole] = column.values[column.first[:-1][whole][:, None] + np.arange(36)]
    return matrix


def odometry_of_vehicle(columns: Columns, fields: tuple[str, ...], frame_id: str) -> dict[str, Column]:
    """Convert PX4 VehicleOdometry columns to Odometry in ROS axes."""
    place, q, velocity, rates = (_numbers(columns[k]) for k in ("position", "q", "velocity", "angular_velocity"))
    w, x, y, z = q.T
    yaw = yaw_of(x, y, z, w)
    along = velocity[:, 0] * np.cos(yaw) + velocity[:, 1] * np.sin(yaw)
    ahead = np.where(_numbers(columns["velocity_frame"]) == BODY_FRAME, velocity[:, 0], along)
    return _odometry(place[:, 1], place[:, 0], quaternions(0.5 * np.pi - yaw), ahead, -rates[:, 2])


def odometry_of_position(columns: Columns, fields: tuple[str, ...], frame_id: str) -> dict[str, Column]:
    """Convert PX4 VehicleLocalPosition columns to Odometry in ROS axes, with zero yaw rate."""
    north, east, yaw, vx, vy = (_numbers(columns[name]) for name in OF_POSITION)
    ahead = vx * np.cos(yaw) + vy * np.sin(yaw)
    return _odometry(east, north, quaternions(0.5 * np.pi - yaw), ahead, np.zeros(len(yaw)))


def imu_of_sensor(columns: Columns, fields: tuple[str, ...], frame_id: str) -> dict[str, Column]:
    """Convert PX4 SensorCombined columns to Imu in ROS axes, without orientation."""
    rates, accelerations = (_numbers(columns[name]) * (1.0, -1.0, -1.0) for name in OF_SENSOR)
    none = np.zeros((len(rates), 9))
    return {
        "angular_velocity_covariance": none,
        "linear_acceleration_covariance": none,
        "orientation_covariance": np.where(np.arange(9) == 0, -1.0, none),
        **dict(zip(_axes("angular_velocity", "xyz"), rates.T, strict=True)),
        **dict(zip(_axes("linear_acceleration", "xyz"), accelerations.T, strict=True)),
        **dict.fromkeys(_axes("orientation", "xyzw"), np.zeros(len(rates))),
    }


# --- Laser scans: a level slice of a point cloud, the first echoes of a MultiEchoLaserScan.
# The slice has the points of a cloud from 0.2 degrees below to 2.2 degrees above the sensor's level: one or two
# rings of a spinning laser (16 rings are 2 degrees apart), without the floor. Each beam is half a degree wide; its
# range is that of the point nearest to its middle.

SCAN = "sensor_msgs/msg/LaserScan"
CLOUD = "sensor_msgs/msg/PointCloud2"
ECHOES = "sensor_msgs/msg/MultiEchoLaserScan"
FOXGLOVE = ("foxglove.LaserScan", "foxglove_msgs/msg/LaserScan")
FOXGLOVE_CLOUD = ("foxglove.PointCloud", "foxglove_msgs/msg/PointCloud")
OF_CLOUD = (
    *("fields.name", "fields.offset", "fields.datatype"),
    *("height", "width", "point_step", "row_step", "is_bigendian", "data"),
)
LIKE_A_SCAN = ("angle_min", "angle_max", "angle_increment", "time_increment", "range_min", "range_max")
OF_ECHOES = (*LIKE_A_SCAN, "ranges.echoes", "ranges.echoes.length")
TURN, PLACE = _axes("pose.orientation", "xyzw"), _axes("pose.position", "xyz")
OF_FOXGLOVE_CLOUD = ("point_stride", "fields.name", "fields.offset", "fields.type", "data", *PLACE, *TURN)
OF_FOXGLOVE = ("start_angle", "end_angle", "ranges", *TURN)
SLICE_BEAMS = 720
LOW_RAD, HIGH_RAD = np.radians((-0.2, 2.2))  # elevation limits of the slice
NEAR_M, FAR_M = 0.3, 100.0  # m: limits of the range; nearer points are on the robot itself
DATATYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}  # sensor_msgs/PointField
PACKED = np.array([0, 2, 1, 4, 3, 6, 5, 7, 8])  # foxglove.PackedElementField's numeric type -> PointField's
# time of a point: since the header stamp (Velodyne, Ouster), or its date (Hesai, Livox, RoboSense)
TIME_FIELDS = ("time", "t", "timestamp", "time_stamp", "offset_time")
BEGIN = "begin"  # column beside those of a LaserScan
MIN_TIMED, MAX_UNEVEN_BEAMS = 20, 4.0  # points that show a sweep; 2 degrees, as large as one packet of points
OPTICAL = "_optical"  # a camera's frame: x right, y down, z ahead


def echoes_as_scans(columns: Columns, fields: tuple[str, ...], frame_id: str) -> dict[str, Column]:
    """Convert MultiEchoLaserScan columns to LaserScan: the first echo of each beam.

    The range of a beam without an echo is Inf.
    """
    echoes, lengths = _ragged(columns, "ranges.echoes"), _ragged(columns, "ranges.echoes.length")
    counts = lengths.values.astype(np.int64)
    first = np.cumsum(counts) - counts
    values = np.full(len(counts), np.inf, np.float32)
    values[counts > 0] = echoes.values[first[counts > 0]]
    return {**columns, "ranges": Ragged(values, lengths.first)}


def cloud_as_scans(columns: Columns, fields: tuple[str, ...], frame_id: str) -> dict[str, Column]:
    """Convert PointCloud2 columns to LaserScan: a level slice of each cloud."""
    n = len(cast("Array", columns["width"]))
    return _as_scans(n, lambda i: points(columns, i), frame_id)


def _as_scans(n: int, cloud: Callable[[int], Array], frame_id: str) -> dict[str, Column]:
    """Return LaserScan columns of n clouds, and in the column BEGIN the times [s] of their first beams.

    `cloud(i)` returns the points (m, 4) of cloud i: x, y, z [m], time. Beams are in the order of the sweep.
    """
    ranges, sweeps = [np.empty(0)], np.empty((n, 4))
    for i in range(n):
        away, beam, t = level_slice(cloud(i), OPTICAL in frame_id)
        first, way, *sweeps[i, 2:] = sweep_of(beam, t)
        sweeps[i, :2] = first, way
        ranges.append(np.roll(nearest_to_beams(away, beam), -first if way > 0 else -first - 1)[::way])
    first_beam, ways, each, begin = sweeps.T
    step = 2.0 * np.pi / SLICE_BEAMS
    start = -np.pi + (first_beam + 0.5) * step
    made = start, start + ways * (2.0 * np.pi - step), ways * step, each, np.full(n, NEAR_M), np.full(n, FAR_M)
    rows = Ragged(np.concatenate(ranges).astype(np.float32), np.arange(n + 1) * SLICE_BEAMS)
    return {**dict(zip(LIKE_A_SCAN, made, strict=True)), "ranges": rows, BEGIN: begin}


def foxglove_clouds_as_scans(columns: Columns, fields: tuple[str, ...], frame_id: str) -> dict[str, Column]:
    """Convert Foxglove PointCloud columns to LaserScan; points are transformed by each cloud's pose."""
    step, kinds = _numbers(columns["point_stride"]), _ragged(columns, "fields.type")
    bytes_of = np.array([len(one) for one in cast("list[bytes]", columns["data"])], np.float64)
    known = (kinds.values >= 0) & (kinds.values < len(PACKED))
    packed = PACKED[np.where(known, kinds.values, 0).astype(np.int64)]
    cloud: dict[str, Column] = {
        **columns,
        "height": np.ones(len(step)),
        "width": bytes_of // np.maximum(step, 1.0),
        "row_step": bytes_of,
        "is_bigendian": np.zeros(len(step), bool),
        "point_step": step,
        "fields.datatype": Ragged(packed, kinds.first),
    }
    place, turn = np.nan_to_num(_stacked(columns, PLACE)), _stacked(columns, TURN)
    squares = np.square(turn).sum(axis=1)
    turn[~((squares > 0.0) & (squares < np.inf))] = 0.0, 0.0, 0.0, 1.0  # an invalid rotation is left out

    def posed(i: int) -> Array:
        xyzt = points(cloud, i)
        xyzt[:, :3] = rotated_3d(turn[i : i + 1], xyzt[:, :3]) + place[i]
        return xyzt

    return _as_scans(len(step), posed, frame_id)


def foxglove_as_scans(columns: Columns, fields: tuple[str, ...], frame_id: str) -> dict[str, Column]:
    """Convert Foxglove LaserScan columns to sensor_msgs/LaserScan, with angles rotated by each scan's pose.

    Beams are evenly spaced from start to end. Foxglove's scans have no time_increment (0 here) and no range limits
    (0 and FAR_M here).
    """
    start, end = _numbers(columns["start_angle"]), _numbers(columns["end_angle"])
    ranges, turn = _ragged(columns, "ranges"), yaw_of(*_stacked(columns, TURN).T)
    turned = np.where(np.isfinite(turn), turn, 0.0)
    return {
        "angle_min": start + turned,
        "angle_max": end + turned,
        "angle_increment": (end - start) / np.maximum(ranges.lengths - 1, 1),
        **dict.fromkeys(("time_increment", "range_min"), np.zeros(len(start))),
        "range_max": np.full(len(start), FAR_M),
        "ranges": Ragged(ranges.values.astype(np.float32), ranges.first),
    }


def points(columns: Mapping[str, Any], i: int) -> Array:
    """Return the points of cloud i, (n, 4): x, y, z [m] in its frame, and their times in the unit of the cloud.

    Without a field of TIME_FIELDS the times are NaN. The result is (0, 4) without valid fields x, y and z.
    """
    nothing: Array = np.empty((0, 4))
    names, first = columns["fields.name"][i], columns["fields.offset"].first[i]
    if not {"x", "y", "z"} <= set(names):
        return nothing
    kind_of = [DATATYPES.get(int(k), "") for k in columns["fields.datatype"][i]]
    timed = [name for name in TIME_FIELDS if name in names and kind_of[names.index(name)]][:1]
    at = [names.index(axis) for axis in ("x", "y", "z", *timed)]
    kinds = [kind_of[k] for k in at]
    offsets = [int(columns["fields.offset"].values[first + k]) for k in at]
    step, width, height, row = (int(columns[k][i]) for k in ("point_step", "width", "height", "row_step"))
    if (
        not all(kinds)
        or not 1 <= step <= len(columns["data"][i])  # at least one point, and no dtype of gigabytes
        or max(o + np.dtype(k).itemsize for o, k in zip(offsets, kinds, strict=True)) > step
    ):
        return nothing
    order = ">" if columns["is_bigendian"][i] else "<"
    formats = [order + k for k in kinds]
    layout = np.dtype({"names": list("xyzt"[: len(at)]), "formats": formats, "offsets": offsets, "itemsize": step})
    data = np.frombuffer(columns["data"][i], np.uint8)
    if height > 1 and row > width * step:  # padded rows
        data = data[: len(data) // row * row].reshape(-1, row)[:, : width * step].reshape(-1)
    cloud = np.frombuffer(data[: len(data) // step * step].tobytes(), layout)
    found: Array = np.full((len(cloud), 4), np.nan)
    for k, name in enumerate(layout.names or ()):
        found[:, k] = cloud[name]
    return found


def level_slice(xyzt: Array, optical: bool = False) -> tuple[Array, Array, Array]:
    """Return the distance [m], the bearing [beams] and the time of each point (k,) in the level slice of a cloud.

    `xyzt` (n, 4) are x, y, z [m] and time. The bearing grows counter-clockwise from 0 behind the sensor.
    """
    x, y, z, t = xyzt.T
    if optical:
        x, y, z = z, -x, -y
    away = np.hypot(x, y)
    with np.errstate(invalid="ignore"):
        level = (z >= away * np.tan(LOW_RAD)) & (z <= away * np.tan(HIGH_RAD))
        seen = level & (away >= NEAR_M) & (away <= FAR_M)
    return away[seen], (np.arctan2(y, x)[seen] + np.pi) * (SLICE_BEAMS / (2.0 * np.pi)), t[seen]


def nearest_to_beams(away: Array, bearing: Array) -> Array:
    """Return the ranges (SLICE_BEAMS,) [m] of the points (k,) that `level_slice` returns; Inf: no point."""
    ranges = np.full(SLICE_BEAMS, np.inf)
    beam = np.minimum(bearing.astype(np.int64), SLICE_BEAMS - 1)
    order = np.lexsort((away, np.abs(bearing - beam - 0.5), beam))
    found, nearest = np.unique(beam[order], return_index=True)
    ranges[found] = away[order][nearest]
    return ranges


def sweep_of(bearing: Array, t: Array) -> tuple[int, int, float, float]:
    """Return a spinning laser's first beam, direction, time between two beams [s] and time of the first beam [s].

    `bearing` [beams] and t (k,) are those of points, t in s, ms, us or ns: of these, the largest unit with which a
    cloud lasts at most 1 s. The direction is 1 counter-clockwise, else -1. If the points do not turn evenly (as of
    a laser with a pattern), the time between beams is 0, and that of the first the median; NaN without times.
    """
    span = float(np.ptp(t)) if len(t) >= MIN_TIMED else 0.0
    if not 0.0 < span < np.inf:  # NaN too
        return 0, 1, 0.0, np.nan
    unit = 10.0 ** (-3 * max(0, int(np.ceil(np.log10(span) / 3))))
    order = np.argsort(t, kind="stable")
    since, turned = (t[order] - t[order[0]]) * unit, np.unwrap(bearing[order], period=SLICE_BEAMS)
    rate, begin = np.polyfit(since, turned, 1).tolist()
    if rate == 0.0 or np.median(np.abs(turned - begin - rate * since)) > MAX_UNEVEN_BEAMS:
        return 0, 1, 0.0, float(np.median(t)) * unit
    return int(begin // 1) % SLICE_BEAMS, 1 if rate > 0.0 else -1, 1.0 / abs(rate), float(t[order[0]]) * unit


OF_CLOUDS = (cloud_as_scans, foxglove_clouds_as_scans)

# --- The table of adapters

PATH, POSE = "nav_msgs/msg/Path", "geometry_msgs/msg/PoseStamped"
OF_PATH = ("poses.header.stamp", *_axes("poses.pose.position", "xy"), *_axes("poses.pose.orientation", "xyzw"))


class Presented(NamedTuple):
    """Adapter that lets a topic of one message type be read as a topic of the type `msgtype`."""

    msgtype: str  # target type
    suffix: str  # name of the adapted topic: "/source:suffix"
    fields: tuple[str, ...]  # source fields that the adapter needs
    make: Adapter | None  # None for a Path: its rows come from its last message alone (stream.path_in)
    frame: Callable[[str], str] = str


PRESENTED: Mapping[str, Presented] = {
    CLOUD: Presented(SCAN, "scan", OF_CLOUD, cloud_as_scans, frame=lambda name: name.replace(OPTICAL, "")),
    ECHOES: Presented(SCAN, "scan", OF_ECHOES, echoes_as_scans),
    **dict.fromkeys(FOXGLOVE, Presented(SCAN, "scan", OF_FOXGLOVE, foxglove_as_scans)),
    **dict.fromkeys(FOXGLOVE_CLOUD, Presented(SCAN, "scan", OF_FOXGLOVE_CLOUD, foxglove_clouds_as_scans)),
    **dict.fromkeys(
        FOXGLOVE_ODOMETRY, Presented(ODOMETRY, "odometry", OF_FOXGLOVE_ODOMETRY, odometry_of_foxglove)
    ),
    SPORT_STATE: Presented(ODOMETRY, "odometry", OF_SPORT_STATE, odometry_of_sport_state, frame=lambda _: "odom"),
    **dict.fromkeys(FOXGLOVE_JOINTS, Presented(JOINTS, "joints", OF_FOXGLOVE_JOINTS, joints_of_foxglove)),
    **dict.fromkeys(FEEDBACK, Presented(JOINTS, "joints", OF_FEEDBACK, joints_of_feedback)),
    VEHICLE_ODOMETRY: Presented(ODOMETRY, "odometry", OF_ODOMETRY, odometry_of_vehicle, frame=lambda _: "odom"),
    LOCAL_POSITION: Presented(ODOMETRY, "odometry", OF_POSITION, odometry_of_position, frame=lambda _: "odom"),
    SENSOR_COMBINED: Presented(IMU, "imu", OF_SENSOR, imu_of_sensor),
    PATH: Presented(POSE, "poses", OF_PATH, None),
    DYNAMIC: Presented(JOINTS, "joints", OF_DYNAMIC, as_joints),
}


def presented_name(name: str, msgtype: str) -> str | None:
    """Return the name of the adapted topic, "TOPIC:SUFFIX"; None for a message type without an adapter."""
    kind = PRESENTED.get(msgtype)
    return f"{name}:{kind.suffix}" if kind is not None else None
