"""What cars, drones and legged robots publish: Ackermann commands, speeds, PX4, Unitree."""

from __future__ import annotations

from .known_parts import DIVIDER, HEADER

ACKERMANN = (
    f"{DIVIDER}\nMSG: ackermann_msgs/AckermannDrive\nfloat32 steering_angle\nfloat32 steering_angle_velocity\n"
    "float32 speed\nfloat32 acceleration\nfloat32 jerk\n"
)
VELOCITY = HEADER + "float32 longitudinal_velocity\nfloat32 lateral_velocity\nfloat32 heading_rate\n"
MODE = (
    "unitree_go/TimeSpec stamp\nuint32 error_code\nunitree_go/IMUState imu_state\nuint8 mode\nfloat32 progress\n"
    "uint8 gait_type\nfloat32 foot_raise_height\nfloat32[3] position\nfloat32 body_height\nfloat32[3] velocity\n"
    "float32 yaw_speed\nfloat32[4] range_obstacle\nint16[4] foot_force\nfloat32[12] foot_position_body\n"
    f"float32[12] foot_speed_body\n{DIVIDER}\nMSG: unitree_go/TimeSpec\nint32 sec\nuint32 nanosec\n"
    f"{DIVIDER}\nMSG: unitree_go/IMUState\nfloat32[4] quaternion\nfloat32[3] gyroscope\n"
    "float32[3] accelerometer\nfloat32[3] rpy\nint8 temperature\n"
)
VEHICLE = (
    "uint64 timestamp\nuint64 timestamp_sample\nuint8 pose_frame\nfloat32[3] position\nfloat32[4] q\n"
    "uint8 velocity_frame\nfloat32[3] velocity\nfloat32[3] angular_velocity\nfloat32[3] position_variance\n"
    "float32[3] orientation_variance\nfloat32[3] velocity_variance\nuint8 reset_counter\nint8 quality\n"
)
# PX4 1.12 and later: up to the heading all are alike
TO_HEADING = (
    "uint64 timestamp\nuint64 timestamp_sample\nbool xy_valid\nbool z_valid\nbool v_xy_valid\nbool v_z_valid\n"
    "float32 x\nfloat32 y\nfloat32 z\nfloat32[2] delta_xy\nuint8 xy_reset_counter\nfloat32 delta_z\n"
    "uint8 z_reset_counter\nfloat32 vx\nfloat32 vy\nfloat32 vz\nfloat32 z_deriv\nfloat32[2] delta_vxy\n"
    "uint8 vxy_reset_counter\nfloat32 delta_vz\nuint8 vz_reset_counter\nfloat32 ax\nfloat32 ay\nfloat32 az\n"
    "float32 heading\n"
)
RESET = "float32 delta_heading\nuint8 heading_reset_counter\nbool heading_good_for_control\n"
REFERENCE = (
    "bool xy_global\nbool z_global\nuint64 ref_timestamp\nfloat64 ref_lat\nfloat64 ref_lon\nfloat32 ref_alt\n"
)
SIGMAS = (
    "uint8 dist_bottom_sensor_bitfield\nfloat32 eph\nfloat32 epv\nfloat32 evh\nfloat32 evv\nbool dead_reckoning\n"
    "float32 vxy_max\nfloat32 vz_max\nfloat32 hagl_min\n"
)
BOTTOM = (
    "bool dist_bottom_valid\nfloat32 dist_bottom\nfloat32 dist_bottom_var\nfloat32 delta_dist_bottom\n"
    "uint8 dist_bottom_reset_counter\n"
)
NEWER = (
    f"{TO_HEADING}float32 heading_var\nfloat32 unaided_heading\n{RESET}"
    f"float32 tilt_var\n{REFERENCE}{BOTTOM}{SIGMAS}"
)
LOCAL = (
    f"{NEWER}float32 hagl_max_z\nfloat32 hagl_max_xy\n",
    f"{NEWER}float32 hagl_max\n",
    f"{TO_HEADING}float32 unaided_heading\n{RESET}{REFERENCE}float32 dist_bottom\nbool dist_bottom_valid\n"
    f"{SIGMAS}float32 hagl_max\n",
)
GYRO_AND_ACCELEROMETER = (
    "uint64 timestamp\nfloat32[3] gyro_rad\nuint32 gyro_integral_dt\nint32 accelerometer_timestamp_relative\n"
    "float32[3] accelerometer_m_s2\nuint32 accelerometer_integral_dt\nuint8 accelerometer_clipping\n"
)
VESC = "".join(
    f"float64 {name}\n"
    for name in (
        *("temp_fet", "temp_motor", "current_motor", "current_input", "avg_id", "avg_iq", "duty_cycle", "speed"),
        *("voltage_input", "charge_drawn", "charge_regen", "energy_drawn", "energy_regen"),
    )
) + (
    "int32 displacement\nint32 distance_traveled\nint32 fault_code\nfloat64 pid_pos_now\nint32 controller_id\n"
    "float64 ntc_temp_mos1\nfloat64 ntc_temp_mos2\nfloat64 ntc_temp_mos3\nfloat64 avg_vd\nfloat64 avg_vq\n"
)
# message type -> its text
TYPES: dict[str, str] = {
    "autoware_auto_vehicle_msgs/msg/VelocityReport": VELOCITY,
    "autoware_vehicle_msgs/msg/VelocityReport": VELOCITY,
    "ackermann_msgs/msg/AckermannDrive": ACKERMANN.partition("Drive\n")[2],
    "ackermann_msgs/msg/AckermannDriveStamped": HEADER + "ackermann_msgs/AckermannDrive drive\n" + ACKERMANN,
}
# types that changed often -> their texts, the newest first: a message has to be as long as its text says
LAID_OUT: dict[str, tuple[str, ...]] = {
    "px4_msgs/msg/VehicleOdometry": (VEHICLE,),
    "px4_msgs/msg/VehicleLocalPosition": LOCAL,
    "px4_msgs/msg/SensorCombined": (
        f"{GYRO_AND_ACCELEROMETER}uint8 gyro_clipping\nuint8 accel_calibration_count\n"
        "uint8 gyro_calibration_count\n",
        GYRO_AND_ACCELEROMETER,
    ),
    "unitree_go/msg/SportModeState": (MODE,),
    "vesc_msgs/msg/VescState": (VESC,),
    "vesc_msgs/msg/VescStateStamped": (
        f"{HEADER}vesc_msgs/VescState state\n{DIVIDER}\nMSG: vesc_msgs/VescState\n{VESC}",
    ),
}
