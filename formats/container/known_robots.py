"""What drivers of small robots, receivers, motion capture and Gazebo publish."""

from __future__ import annotations

from .known_parts import DIVIDER, HEADER, POSE, TWIST

INTERFACES = f"{DIVIDER}\nMSG: control_msgs/InterfaceValue\nstring[] interface_names\nfloat64[] values\n"
BODIES = (
    f"{DIVIDER}\nMSG: mocap4r2_msgs/RigidBody\nstring rigid_body_name\nmocap4r2_msgs/Marker[] markers\n"
    f"geometry_msgs/Pose pose\n{DIVIDER}\nMSG: mocap4r2_msgs/Marker\nint8 id_type\nint32 marker_index\n"
    f"string marker_name\ngeometry_msgs/Point translation\n{POSE}"
)
STATES = f"string[] name\ngeometry_msgs/Pose[] pose\ngeometry_msgs/Twist[] twist\n{POSE}{TWIST}"
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
# message type -> its text
TYPES: dict[str, str] = {
    "gazebo_msgs/msg/ModelStates": STATES,
    "gazebo_msgs/msg/LinkStates": STATES,
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
# types that changed often -> their texts, the newest first: a message has to be as long as its text says
LAID_OUT: dict[str, tuple[str, ...]] = {
    "mocap4r2_msgs/msg/RigidBodies": (
        HEADER + "uint32 frame_number\nmocap4r2_msgs/RigidBody[] rigidbodies\n" + BODIES,
    ),
}
