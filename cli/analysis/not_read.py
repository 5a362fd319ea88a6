"""Common message types that are not read, and what to record instead."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from locfuse.formats.logs.log import Log

LIVOX = "points in Livox' own format; record PointCloud2 instead (xfer_format = 0 in its launch file)"
PACKETS = "packets of the sensor as they came; record the PointCloud2 that its driver makes of them"
VESC = (
    "revolutions of the motor (erpm): --set wheels.topic={topic} --set wheels.erpm_per_mps=<erpm> "
    "(speed_to_erpm_gain of vesc.yaml) uses them, or record the /odom of vesc_to_odom"
)
FIXES = "words of the receiver; record the NavSatFix that its driver makes of them (/fix)"
STEER = "an angle alone; beside it a speed is needed (VelocityReport)"
LEGS = "the state of the legs; record the odometry that the robot makes of it"
# role -> message type -> what it holds, and what to record instead
NOT_READ: dict[str, dict[str, str]] = {
    "lrf": {
        "livox_ros_driver/msg/CustomMsg": LIVOX,
        "livox_ros_driver2/msg/CustomMsg": LIVOX,
        "livox_interfaces/msg/CustomMsg": LIVOX,
        "velodyne_msgs/msg/VelodyneScan": PACKETS,
        "ouster_ros/msg/PacketMsg": PACKETS,
        "ouster_sensor_msgs/msg/PacketMsg": PACKETS,
        "pandar_msgs/msg/PandarScan": PACKETS,
        "rslidar_msg/msg/RslidarPacket": PACKETS,
    },
    "gps": {
        **dict.fromkeys(("ublox_msgs/msg/NavPVT", "nmea_msgs/msg/Sentence"), FIXES),
    },
    "wheels": {
        "vesc_msgs/msg/VescStateStamped": VESC,
        "vesc_msgs/msg/VescState": VESC,
        "autoware_vehicle_msgs/msg/SteeringReport": STEER,
        "autoware_auto_vehicle_msgs/msg/SteeringReport": STEER,
        "unitree_go/msg/LowState": LEGS,
        "unitree_legged_msgs/msg/HighState": LEGS,
    },
}


def not_read(log: Log, role: str) -> str:
    """Return a log's topics for a role in types that are not read, in words; "" without any."""
    kinds = NOT_READ.get(role, {})
    found = [
        f"{topic} ({info.msgtype.replace('/msg/', '/')}) holds {kinds[info.msgtype].format(topic=topic)}"
        for topic, info in sorted(log.topics.items())
        if info.msgtype in kinds and info.count
    ]
    return found[0] if found else ""
