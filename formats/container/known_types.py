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
ROBOTS = {
    "control_msgs/msg/DynamicJointState": (
        HEADER + "string[] joint_names\ncontrol_msgs/InterfaceValue[] interface_values\n" + INTERFACES
    ),
    "irobot_create_msgs/msg/WheelTicks": HEADER + "int32 ticks_left\nint32 ticks_right\n",
    "irobot_create_msgs/msg/WheelVels": HEADER + "float32 velocity_left\nfloat32 velocity_right\n",
    "duckietown_msgs/msg/WheelEncoderStamped": HEADER + "int32 data\nuint16 resolution\nuint8 type\n",
    "irobot_create_msgs/msg/SlipStatus": HEADER + "bool is_slipping\n",
    "irobot_create_msgs/msg/KidnapStatus": HEADER + "bool is_kidnapped\n",
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
