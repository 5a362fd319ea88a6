"""Definitions of message types for bags that carry none (rosbag2's sqlite3 storage before ROS 2 Iron)."""

from __future__ import annotations

HEADER = "std_msgs/Header header\n"
ROBOTS = {
    "irobot_create_msgs/msg/WheelTicks": HEADER + "int32 ticks_left\nint32 ticks_right\n",
    "irobot_create_msgs/msg/WheelVels": HEADER + "float32 velocity_left\nfloat32 velocity_right\n",
    "duckietown_msgs/msg/WheelEncoderStamped": HEADER + "int32 data\nuint16 resolution\nuint8 type\n",
    "irobot_create_msgs/msg/SlipStatus": HEADER + "bool is_slipping\n",
    "irobot_create_msgs/msg/KidnapStatus": HEADER + "bool is_kidnapped\n",
    "turtlebot3_msgs/msg/SensorState": (
        HEADER + "uint8 bumper\nfloat32 cliff\nfloat32 sonar\nfloat32 illumination\nuint8 led\nuint8 button\n"
        "bool torque\nint32 left_encoder\nint32 right_encoder\nfloat32 battery\n"
    ),
}
PARTS = (
    f"{'=' * 80}\nMSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id\n"
    f"{'=' * 80}\nMSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n"
)


def definition(msgtype: str) -> str | None:
    """Return the ros2msg text of a standard or common robot message type, None for an unknown one."""
    if msgtype in ROBOTS:
        return ROBOTS[msgtype] + PARTS
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.LATEST)
    if msgtype not in store.types:
        return None
    return str(store.generate_msgdef(msgtype, ros_version=2)[0])
