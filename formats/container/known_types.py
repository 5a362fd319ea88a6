"""Definitions of message types for bags that carry none (rosbag2's sqlite3 storage before ROS 2 Iron)."""

from __future__ import annotations

from typing import Any

ALIGNMENT = 4  # bytes: a message may be padded at its end
HEADER = "std_msgs/Header header\n"
DIVIDER = "=" * 80
ACKERMANN = (
    f"{DIVIDER}\nMSG: ackermann_msgs/AckermannDrive\nfloat32 steering_angle\nfloat32 steering_angle_velocity\n"
    "float32 speed\nfloat32 acceleration\nfloat32 jerk\n"
)
INTERFACES = f"{DIVIDER}\nMSG: control_msgs/InterfaceValue\nstring[] interface_names\nfloat64[] values\n"
VELOCITY = HEADER + "float32 longitudinal_velocity\nfloat32 lateral_velocity\nfloat32 heading_rate\n"
POSE = (
    f"{DIVIDER}\nMSG: geometry_msgs/Pose\ngeometry_msgs/Point position\ngeometry_msgs/Quaternion orientation\n"
    f"{DIVIDER}\nMSG: geometry_msgs/Point\nfloat64 x\nfloat64 y\nfloat64 z\n"
    f"{DIVIDER}\nMSG: geometry_msgs/Quaternion\nfloat64 x\nfloat64 y\nfloat64 z\nfloat64 w\n"
)
TAG = (
    f"{DIVIDER}\nMSG: apriltag_msgs/AprilTagDetection\nstring family\nint32 id\nint32 hamming\nfloat32 goodness\n"
    "float32 decision_margin\napriltag_msgs/Point centre\napriltag_msgs/Point[4] corners\nfloat64[9] homography\n"
    f"{DIVIDER}\nMSG: apriltag_msgs/Point\nfloat64 x\nfloat64 y\n"
)
FIX = "".join(
    f"float64 {name}\n"
    for name in (
        *("latitude", "longitude", "altitude", "track", "speed", "climb", "pitch", "roll", "dip", "time"),
        *("gdop", "pdop", "hdop", "vdop", "tdop", "err", "err_horz", "err_vert", "err_track", "err_speed"),
        *("err_climb", "err_time", "err_pitch", "err_roll", "err_dip"),
    )
)
STATUS = (
    f"{DIVIDER}\nMSG: gps_msgs/GPSStatus\n{HEADER}uint16 satellites_used\nint32[] satellite_used_prn\n"
    "uint16 satellites_visible\nint32[] satellite_visible_prn\nint32[] satellite_visible_z\n"
    "int32[] satellite_visible_azimuth\nint32[] satellite_visible_snr\nint16 status\nuint16 motion_source\n"
    "uint16 orientation_source\nuint16 position_source\n"
)
ROBOTS = {
    "autoware_auto_vehicle_msgs/msg/VelocityReport": VELOCITY,
    "autoware_vehicle_msgs/msg/VelocityReport": VELOCITY,
    "apriltag_msgs/msg/AprilTagDetectionArray": HEADER + "apriltag_msgs/AprilTagDetection[] detections\n" + TAG,
    "ros2_aruco_interfaces/msg/ArucoMarkers": HEADER + "int64[] marker_ids\ngeometry_msgs/Pose[] poses\n" + POSE,
    "gps_msgs/msg/GPSFix": (
        f"{HEADER}gps_msgs/GPSStatus status\n{FIX}float64[9] position_covariance\n"
        f"uint8 position_covariance_type\n{STATUS}"
    ),
    "control_msgs/msg/DynamicJointState": (
        HEADER + "string[] joint_names\ncontrol_msgs/InterfaceValue[] interface_values\n" + INTERFACES
    ),
    "irobot_create_msgs/msg/WheelTicks": HEADER + "int32 ticks_left\nint32 ticks_right\n",
    "irobot_create_msgs/msg/WheelVels": HEADER + "float32 velocity_left\nfloat32 velocity_right\n",
    "duckietown_msgs/msg/WheelEncoderStamped": HEADER + "int32 data\nuint16 resolution\nuint8 type\n",
    "irobot_create_msgs/msg/SlipStatus": HEADER + "bool is_slipping\n",
    "irobot_create_msgs/msg/KidnapStatus": HEADER + "bool is_kidnapped\n",
    "ackermann_msgs/msg/AckermannDrive": ACKERMANN.partition("Drive\n")[2],
    "ackermann_msgs/msg/AckermannDriveStamped": HEADER + "ackermann_msgs/AckermannDrive drive\n" + ACKERMANN,
    "kobuki_msgs/msg/SensorState": (
        HEADER + "uint16 time_stamp\nuint8 bumper\nuint8 wheel_drop\nuint8 cliff\nuint16 left_encoder\n"
        "uint16 right_encoder\nint8 left_pwm\nint8 right_pwm\nuint8 buttons\nuint8 charger\nuint8 battery\n"
        "uint16[] bottom\nuint8[] current\nuint8 over_current\nuint16 digital_input\nuint16[] analog_input\n"
    ),
    "turtlesim/msg/Pose": (
        "float32 x\nfloat32 y\nfloat32 theta\nfloat32 linear_velocity\nfloat32 angular_velocity\n"
    ),
    "turtlebot3_msgs/msg/SensorState": (
        HEADER + "uint8 bumper\nfloat32 cliff\nfloat32 sonar\nfloat32 illumination\nuint8 led\nuint8 button\n"
        "bool torque\nint32 left_encoder\nint32 right_encoder\nfloat32 battery\n"
    ),
}
PARTS = (
    f"{DIVIDER}\nMSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id\n"
    f"{DIVIDER}\nMSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n"
)


RELEASES = ("LATEST", "ROS2_HUMBLE", "ROS2_FOXY")  # definitions of a type may differ between them
MAX_SAMPLE = 1 << 16  # bytes of a message that is tried: of bigger types the definition never changed


def definition(msgtype: str, sample: bytes = b"") -> str | None:
    """Return the ros2msg text of a standard or common robot message type, None for an unknown one.

    Some types gained fields from one ROS release to the next (sensor_msgs/Range its variance). Of several
    definitions the newest is returned under which `sample`, a message of the bag, is as long as it is.
    """
    if msgtype in ROBOTS:
        return ROBOTS[msgtype] + PARTS
    known = _definitions(msgtype)
    if len(known) < 2 or not sample or len(sample) > MAX_SAMPLE:
        return next(iter(known), None)
    return next((text for text, store in known.items() if _fits(store, msgtype, sample)), next(iter(known)))


def _definitions(msgtype: str) -> dict[str, Any]:
    """Return the different definitions of a type over the ROS releases, the newest first, with their stores."""
    from rosbags.typesys import Stores, get_typestore

    found: dict[str, Any] = {}
    for release in RELEASES:
        store = get_typestore(Stores[release])
        if msgtype in store.types:
            found.setdefault(str(store.generate_msgdef(msgtype, ros_version=2)[0]), store)
    return found


def _fits(store: Any, msgtype: str, sample: bytes) -> bool:
    """Return whether a message of this definition, read and written again, has the bytes' length."""
    try:
        message = store.deserialize_cdr(sample, msgtype)
        written = len(store.serialize_cdr(message, msgtype, little_endian=sample[1:2] == b"\x01"))
    except Exception:
        return False
    return abs(len(sample) - written) < ALIGNMENT
