"""Dotted field paths ("header.stamp", "transforms.child_frame_id") and what of a message they mean."""

from __future__ import annotations

import difflib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from typing import NamedTuple

from .schema import FILLER, LengthCounts, Many, Node, Scalar, Structure, Text

STAMPS = ("header.stamp", "timestamp")  # the time of measurement: ROS, Foxglove
FRAMES = ("header.frame_id", "frame_id")


class FieldError(KeyError):
    """A field path that the message type does not have; the message is the reason in a few words."""


class Part(NamedTuple):
    """A field as it lies in the message: a stamp is two of them, seconds and nanoseconds."""

    path: str
    node: Node
    inside: bool  # in an array of structures: one value per element
    depth: int = 0  # in how many of them, one inside the other


LENGTH = "length"  # of each of the arrays that lie in an array: "echoes.ranges.length"
OR = "|"  # between the names that releases of a package gave to one field: "k|K"


def resolve(message: Structure, path: str) -> tuple[Part, ...]:
    """Find a field path in a message type, the first that it has of several. Raises FieldError naming the nearest.

    Arrays inside an array are one column end to end; the `.length` of arrays of numbers is where each ends.
    """
    *earlier, last = path.split(OR)
    for name in (path, *earlier) if earlier else ():  # a definition may call one field "a|b", however odd
        with suppress(FieldError):
            return _resolve(message, name)
    return _resolve(message, last)


def _resolve(message: Structure, path: str) -> tuple[Part, ...]:
    node: Node = message
    inside, depth = False, 0
    walked: list[str] = []
    for name in path.split("."):
        if name == LENGTH and inside and isinstance(node, Many) and not isinstance(node.element, Structure):
            return (Part(".".join(walked), LengthCounts(), inside=True),)
        if isinstance(node, Many) and isinstance(node.element, Structure):
            node, inside, depth = node.element, True, depth + 1
        if not isinstance(node, Structure):
            raise FieldError(f"{'.'.join(walked)} has no parts")
        if name not in node.fields:
            raise FieldError(_no_field(node, walked, name))
        node = node.fields[name]
        walked.append(name)
    if isinstance(node, Many) and isinstance(node.element, Structure) and node.element.is_time and not inside:
        node, inside = node.element, True
    if isinstance(node, Structure) and node.is_time:
        return tuple(Part(f"{path}.{name}", part, inside) for name, part in node.fields.items())
    if isinstance(node, Structure) or (isinstance(node, Many) and isinstance(node.element, Structure | Many)):
        raise FieldError(f"{path} is a structure: name a part of it")
    if isinstance(node, Many) and inside and not isinstance(node.element, Scalar | Text):
        raise FieldError(f"{path} is an array inside an array: it cannot be a column")
    return (Part(path, node, inside, depth),)


def _no_field(node: Structure, walked: list[str], name: str) -> str:
    near = difflib.get_close_matches(name, node.fields, 1)
    hint = f"did you mean {near[0]!r}?" if near else f"it has {', '.join(node.fields)}"
    return f"{'.'.join(walked) or node.name} has no field {name!r}; {hint}"


def paths(message: Structure) -> list[str]:
    """Return the path of every field of a message type that can be a column."""
    return list(_paths(message, "", inside=False))


def _paths(node: Node, path: str, *, inside: bool) -> Iterator[str]:
    if isinstance(node, Structure) and not node.is_time:
        for name, part in node.fields.items():
            if name != FILLER:
                yield from _paths(part, f"{path}.{name}" if path else name, inside=inside)
    elif not isinstance(node, Many):
        yield path
    elif not inside:
        if isinstance(node.element, Structure):
            yield from _paths(node.element, path, inside=True)
        elif not isinstance(node.element, Many):
            yield path


def stamp_path(message: Structure) -> str | None:
    """Return the field that dates the message, None where only the recording does."""
    return next((path for path in STAMPS if len(_resolved(message, path)) == 2), None)


def frame_path(message: Structure) -> str | None:
    """Return the field that names the frame of the message's values."""
    found = ((path, _resolved(message, path)) for path in FRAMES)
    return next((path for path, parts in found if parts and isinstance(parts[0].node, Text)), None)


def _resolved(message: Structure, path: str) -> tuple[Part, ...]:
    try:
        return resolve(message, path)
    except FieldError:
        return ()


# --- Kinds of column: what a field of a message holds, and what its readers expect of it
# A message type is only a name; the definition in the log is what the messages hold. Where the two disagree (a
# LaserScan whose `ranges` is one number), the field is refused in one line before anything is decoded.

NUMBER, TRUTH, TEXT, TIME, BYTES = "a number", "true or false", "a text", "a time", "bytes"
NUMBERS, TRUTHS, TEXTS, TIMES = "an array of numbers", "an array of true or false", "an array of texts", "times"
NINE = "9 numbers"
THIRTY_SIX = "36 numbers"

# message types that something reads; the fields of every other type may be what their definition says
READ_TYPES = frozenset(
    (
        "ackermann_msgs/msg/AckermannDrive",
        "apriltag_msgs/msg/AprilTagDetectionArray",
        "apriltag_ros/msg/AprilTagDetectionArray",
        "apriltags2_ros/msg/AprilTagDetectionArray",
        "apriltags_ros/msg/AprilTagDetectionArray",
        "aruco_msgs/msg/MarkerArray",
        "aruco_opencv_msgs/msg/ArucoDetection",
        "isaac_ros_apriltag_interfaces/msg/AprilTagDetectionArray",
        "ros2_aruco_interfaces/msg/ArucoMarkers",
        "sensor_msgs/msg/CameraInfo",
        "vision_msgs/msg/Detection2DArray",
        "vision_msgs/msg/Detection3DArray",
        "ackermann_msgs/msg/AckermannDriveStamped",
        "autoware_auto_vehicle_msgs/msg/VelocityReport",
        "autoware_vehicle_msgs/msg/VelocityReport",
        "control_msgs/msg/DynamicJointState",
        "duckietown_msgs/msg/Twist2DStamped",
        "duckietown_msgs/msg/WheelEncoderStamped",
        *(
            f"foxglove{dot}{name}"
            for dot in (".", "_msgs/msg/")
            for name in (
                *(
                    "CompressedImage",
                    "FrameTransform",
                    "FrameTransforms",
                    "JointStates",
                    "LaserScan",
                    "LocationFix",
                ),
                *("Odometry", "PointCloud", "PoseInFrame", "RawImage"),
            )
        ),
        "clearpath_platform_msgs/msg/Feedback",
        "gps_common/msg/GPSFix",
        "gps_msgs/msg/GPSFix",
        "jackal_msgs/msg/Feedback",
        "unitree_go/msg/SportModeState",
        "geometry_msgs/msg/Pose",
        "gazebo_msgs/msg/ModelStates",
        "gazebo_msgs/msg/LinkStates",
        "geometry_msgs/msg/PointStamped",
        "geometry_msgs/msg/Pose2D",
        "geometry_msgs/msg/PoseStamped",
        "geometry_msgs/msg/PoseWithCovarianceStamped",
        "geometry_msgs/msg/TransformStamped",
        "geometry_msgs/msg/Twist",
        "geometry_msgs/msg/TwistStamped",
        "geometry_msgs/msg/TwistWithCovarianceStamped",
        "irobot_create_msgs/msg/WheelTicks",
        "irobot_create_msgs/msg/WheelVels",
        "kobuki_msgs/msg/SensorState",
        "locfuse/msg/Detections",
        "locfuse/msg/Ranges",
        "locfuse/msg/TagFrames",
        "mocap4r2_msgs/msg/RigidBodies",
        "nav_msgs/msg/Odometry",
        "nav_msgs/msg/Path",
        "px4_msgs/msg/SensorCombined",
        "px4_msgs/msg/VehicleLocalPosition",
        "px4_msgs/msg/VehicleOdometry",
        "sensor_msgs/msg/CompressedImage",
        "sensor_msgs/msg/Image",
        "sensor_msgs/msg/Imu",
        "sensor_msgs/msg/JointState",
        "sensor_msgs/msg/LaserScan",
        "sensor_msgs/msg/MagneticField",
        "sensor_msgs/msg/MultiEchoLaserScan",
        "sensor_msgs/msg/NavSatFix",
        "sensor_msgs/msg/PointCloud2",
        "sensor_msgs/msg/Range",
        "std_msgs/msg/Float32",
        "std_msgs/msg/Float64",
        "std_msgs/msg/Int16",
        "std_msgs/msg/Int32",
        "std_msgs/msg/Int64",
        *(
            f"std_msgs/msg/{name}MultiArray"
            for name in ("Int16", "UInt16", "Int32", "UInt32", "Int64", "Float32", "Float64")
        ),
        "std_msgs/msg/String",
        "std_msgs/msg/UInt16",
        "std_msgs/msg/UInt32",
        "tf/msg/tfMessage",
        "tf2_msgs/msg/TFMessage",
        "turtlebot3_msgs/msg/SensorState",
        "turtlesim/msg/Pose",
        "vesc_msgs/msg/VescState",
        "vesc_msgs/msg/VescStateStamped",
    )
)
XY, XYZ, XYZW = ("x", "y"), ("x", "y", "z"), ("x", "y", "z", "w")
# dotted paths in these types that are read as one number
ONE_NUMBER = frozenset(
    (
        *(f"magnetic_field.{axis}" for axis in XYZ),
        *(f"angular_velocity.{axis}" for axis in XYZ),
        "linear_velocity.x", "point_stride",
        *(f"{at}orientation.{axis}" for at in ("", "pose.", "pose.pose.") for axis in XYZW),
        *(f"{at}position.{axis}" for at in ("", "pose.", "pose.pose.") for axis in XY),
        *(f"transform.translation.{axis}" for axis in XY),
        *(f"transform.rotation.{axis}" for axis in XYZW),
        *(f"point.{axis}" for axis in XY),
        *(f"{at}linear.x" for at in ("", "twist.", "twist.twist.")),
        *(f"{at}angular.z" for at in ("", "twist.", "twist.twist.")),
        *(f"{at}{part}" for at in ("", "drive.") for part in ("speed", "steering_angle")),
        "longitudinal_velocity", "heading_rate", "state.speed", "velocity_left", "velocity_right",
        "x", "y", "theta", "linear_velocity", "angular_velocity", "v", "omega",
        "angle_min", "angle_increment", "time_increment", "range_min", "range_max",
        "width", "height", "step", "start_angle", "end_angle",
        "field_of_view", "min_range", "max_range", "range",
        "status.status", "latitude", "longitude", "position_covariance_type",
        "ticks_left", "ticks_right", "left_encoder", "right_encoder",
    )
)  # fmt: skip
# what releases of a package call one field
CAMERA_MATRIX = "k|K"  # ROS 2, ROS 1
CENTRE_2D = "detections.bbox.center.position.x|detections.bbox.center.x"
CLASS = "detections.results.hypothesis.class_id|detections.results.id"
TRACK_OR_CLASS = f"detections.id|{CLASS}"
# dotted path in these types -> the kinds that its readers take
EXPECTED: Mapping[str, tuple[str, ...]] = {
    **dict.fromkeys(ONE_NUMBER, (NUMBER,)),
    "ranges": (NUMBERS,),
    "name": (TEXTS,),
    "rigidbodies.rigid_body_name": (TEXTS,),
    **{f"rigidbodies.pose.position.{axis}": (NUMBERS,) for axis in XY},
    **{f"rigidbodies.pose.orientation.{axis}": (NUMBERS,) for axis in XYZW},
    **{f"poses.pose.orientation.{axis}": (NUMBERS,) for axis in XYZW},
    **{
        f"{at}.{axis}": (NUMBERS,)
        for at in (
            "poses.position",
            "poses.pose.position",
            "markers.pose.position",
            "markers.pose.pose.position",
            "detections.pose.pose.pose.position",
            "detections.pose.pose.position",
            "detections.bbox.center.position",
            "detections.centre",
        )
        for axis in XYZ
    },
    CENTRE_2D: (NUMBERS,),
    TRACK_OR_CLASS: (NUMBERS, TEXTS),
    CLASS: (NUMBERS, TEXTS),
    "marker_ids": (NUMBERS,),
    "markers.id": (NUMBERS,),
    "markers.marker_id": (NUMBERS,),
    "detections.id": (NUMBERS, TEXTS),
    "detections.id.length": (NUMBERS,),
    "joint_names": (TEXTS,),
    "interface_values.interface_names": (TEXTS,),
    "interface_values.values": (NUMBERS,),
    "interface_values.values.length": (NUMBERS,),
    "ranges.echoes": (NUMBERS,),
    "ranges.echoes.length": (NUMBERS,),
    "fields.name": (TEXTS,),
    "fields.offset": (NUMBERS,),
    "fields.datatype": (NUMBERS,),
    "fields.type": (NUMBERS,),
    "joints.name": (TEXTS,),
    **{f"joints.{name}": (NUMBERS,) for name in ("position", "velocity", "effort")},
    "drivers.measured_travel": (NUMBERS,),
    "drivers.measured_velocity": (NUMBERS,),
    "pose_covariance": (THIRTY_SIX, NUMBERS),
    "velocity_covariance": (THIRTY_SIX, NUMBERS),
    "imu_state.quaternion": ("4 numbers",),
    CAMERA_MATRIX: (NINE,),
    "position": (NUMBERS,),
    "velocity": (NUMBERS,),
    "format": (TEXT,),
    "encoding": (TEXT,),
    "pose.covariance": (THIRTY_SIX,),
    "twist.covariance": (THIRTY_SIX,),
    "orientation_covariance": (NINE,),
    "angular_velocity_covariance": (NINE,),
    "position_covariance": (NINE, NUMBERS),  # JSON schemas do not fix the length
}
WHOLE_NUMBERS = ("Int16", "UInt16", "Int32", "UInt32", "Int64")
OF_TYPE: Mapping[tuple[str, str], tuple[str, ...]] = {
    **{(f"std_msgs/msg/{name}", "data"): (NUMBER,) for name in (*WHOLE_NUMBERS, "Float32", "Float64")},
    ("duckietown_msgs/msg/WheelEncoderStamped", "data"): (NUMBER,),
    **{("locfuse/msg/Detections", name): (NUMBER,) for name in ("id", "range", "bearing")},
    **{("locfuse/msg/Ranges", name): (NUMBER,) for name in ("id", "range")},
    **{("locfuse/msg/TagFrames", name): (NUMBER,) for name in ("id", *XYZ)},
    **{("sensor_msgs/msg/PointCloud2", name): (NUMBER,) for name in ("point_step", "row_step")},
    ("sensor_msgs/msg/PointCloud2", "is_bigendian"): (TRUTH,),
    ("sensor_msgs/msg/PointCloud2", "data"): (BYTES,),
    ("std_msgs/msg/String", "data"): (TEXT,),
    **{
        ("px4_msgs/msg/VehicleOdometry", name): (f"{n} numbers",)
        for name, n in (("position", 3), ("q", 4), ("velocity", 3), ("angular_velocity", 3))
    },
    ("px4_msgs/msg/VehicleOdometry", "velocity_frame"): (NUMBER,),
    **{("px4_msgs/msg/VehicleLocalPosition", name): (NUMBER,) for name in ("x", "y", "heading", "vx", "vy")},
    **{("px4_msgs/msg/SensorCombined", name): ("3 numbers",) for name in ("gyro_rad", "accelerometer_m_s2")},
    **{
        (f"gazebo_msgs/msg/{kind}States", f"pose.{part}"): (NUMBERS,)
        for kind in ("Model", "Link")
        for part in (*(f"position.{axis}" for axis in XY), *(f"orientation.{axis}" for axis in XYZW))
    },
    ("sensor_msgs/msg/CompressedImage", "data"): (BYTES,),
    ("sensor_msgs/msg/Image", "data"): (BYTES,),
    **{
        (f"foxglove{dot}{name}", "data"): (BYTES,)
        for dot in (".", "_msgs/msg/")
        for name in ("CompressedImage", "PointCloud", "RawImage")
    },
    ("unitree_go/msg/SportModeState", "position"): ("3 numbers",),
    **{(f"std_msgs/msg/{name}MultiArray", "data"): (NUMBERS,) for name in (*WHOLE_NUMBERS, "Float32", "Float64")},
}
TF = "transforms."  # one value for each transform of a message
TF_TEXTS = ("frame_id",)


def kind_of(parts: Sequence[Part]) -> str:
    """Return what a resolved field holds in one message: the kind of its column."""
    first = parts[0]
    if len(parts) == 2:
        return TIMES if first.inside else TIME
    node, many = first.node, first.inside
    if isinstance(node, LengthCounts):
        return NUMBERS
    if isinstance(node, Many):
        if isinstance(node.element, Scalar) and node.element.dtype == "u1" and node.count is None and not many:
            return BYTES
        if isinstance(node.element, Scalar) and node.element.dtype != "?" and node.count is not None and not many:
            return f"{node.count} numbers"
        node, many = node.element, True
    if isinstance(node, Text):
        return TEXTS if many else TEXT
    if isinstance(node, Scalar) and node.dtype == "?":
        return TRUTHS if many else TRUTH
    return NUMBERS if many else NUMBER


def expected(msgtype: str, path: str) -> tuple[str, ...]:
    """Return the kinds of column that the readers of this field of this type take; none without readers."""
    if path in STAMPS:
        return (TIME,)
    if msgtype not in READ_TYPES:
        return ()
    if path.startswith(("transforms.header.stamp", "poses.header.stamp")):
        return (TIMES, TIME)
    if path.startswith(TF) and OR in path:
        return (TEXTS, TEXT) if path.endswith(TF_TEXTS) else (NUMBERS, NUMBER)
    if path.startswith(TF):
        return (TEXTS,) if path.endswith(TF_TEXTS) else (NUMBERS,) if path.rpartition(".")[2] in XYZW else ()
    return OF_TYPE.get((msgtype, path)) or EXPECTED.get(path, ())


def check_kind(msgtype: str, path: str, parts: Sequence[Part]) -> None:
    """Raise FieldError where a field is of a kind that its readers cannot take."""
    found, accepted = kind_of(parts), expected(msgtype, path)
    if accepted and found not in accepted:
        raise FieldError(f"{path} is {found} by its definition; accepted: {' or '.join(accepted)}")
