"""Topics converted to a usual type (a LaserScan from a point cloud), and message types that are not read."""

from __future__ import annotations

import re

from locfuse.formats.logs import adapters
from locfuse.formats.logs.log import Log
from locfuse.formats.logs.transform_stream import OF_CAMERA, named_as_tag, tags_of
from locfuse.formats.robot.transforms import ancestors
from locfuse.fusion.robot import Robot
from locfuse.fusion.sensors.landmarks import POSES
from locfuse.fusion.sensors.registry import REGISTRY

from .mounts import CAMERA_INFO, is_base, is_fixed, last_word
from .topics import filled

LIVOX = "points in Livox' own format; record PointCloud2 instead (xfer_format = 0 in its launch file)"
RAW_PACKETS = "packets of the sensor as they came; record the PointCloud2 that its driver makes of them"
VESC = (
    "revolutions of the motor (erpm): --set wheels.topic={topic} --set wheels.erpm_per_mps=<erpm> "
    "(speed_to_erpm_gain of vesc.yaml) uses them, or record the /odom of vesc_to_odom"
)
RECEIVER_WORDS = "words of the receiver; record the NavSatFix that its driver makes of them (/fix)"
STEERING_ANGLE = "an angle alone; beside it a speed is needed (VelocityReport)"
LEG_STATE = "the state of the legs; record the odometry that the robot makes of it"
# role -> message type -> content of its messages, and a topic to record instead
NOT_READ: dict[str, dict[str, str]] = {
    "lrf": {
        "livox_ros_driver/msg/CustomMsg": LIVOX,
        "livox_ros_driver2/msg/CustomMsg": LIVOX,
        "livox_interfaces/msg/CustomMsg": LIVOX,
        "velodyne_msgs/msg/VelodyneScan": RAW_PACKETS,
        "ouster_ros/msg/PacketMsg": RAW_PACKETS,
        "ouster_sensor_msgs/msg/PacketMsg": RAW_PACKETS,
        "pandar_msgs/msg/PandarScan": RAW_PACKETS,
        "rslidar_msg/msg/RslidarPacket": RAW_PACKETS,
    },
    "gps": {"ublox_msgs/msg/NavPVT": RECEIVER_WORDS, "nmea_msgs/msg/Sentence": RECEIVER_WORDS},
    "wheels": {
        "vesc_msgs/msg/VescStateStamped": VESC,
        "vesc_msgs/msg/VescState": VESC,
        "autoware_vehicle_msgs/msg/SteeringReport": STEERING_ANGLE,
        "autoware_auto_vehicle_msgs/msg/SteeringReport": STEERING_ANGLE,
        "unitree_go/msg/LowState": LEG_STATE,
        "unitree_legged_msgs/msg/HighState": LEG_STATE,
    },
}
LASER_NAME = re.compile("velodyne|lidar|ouster|hesai|rslidar|laser|points_raw|livox|scan")  # in topic names
SLAM_FRAME = "camera_init"  # fixed in the world, like map; a cloud in such a frame is a map, not a sensor reading
MIN_CLOUDS = 5  # messages of a cloud topic: fewer are a map
MIN_TAGS = 2  # least number of tag frames below a camera: one alone may be another object
CAMERA_NAME = re.compile("camera|cam_|_cam|optical|webcam|realsense|kinect|oak|zed|rgb")  # in frame names


def not_read(log: Log, role: str) -> str:
    """Return a sentence on the first topic of a role with an unsupported message type; "" without one."""
    kinds = NOT_READ.get(role, {})
    for topic, info in sorted(log.topics.items()):
        if info.msgtype in kinds and info.count:
            msgtype = info.msgtype.replace("/msg/", "/")
            return f"{topic} ({msgtype}) holds {kinds[info.msgtype].format(topic=topic)}"
    return ""


def offer_presented(log: Log) -> None:
    """Add converted topics, such as "/points:scan", for roles without a usual one; of clouds the likeliest."""
    found: list[str] = []
    if not filled(log, adapters.SCAN):
        found += filled(log, *adapters.FOXGLOVE) or filled(log, adapters.ECHOES) or _clouds(log)[:1]
    if not filled(log, adapters.JOINTS):
        found += (
            filled(log, adapters.DYNAMIC)
            or filled(log, *adapters.FOXGLOVE_JOINTS)
            or filled(log, *adapters.FEEDBACK)
        )
    if not filled(log, adapters.ODOMETRY):
        one_by_one = (
            filled(log, kind)[:1]
            for kind in (adapters.VEHICLE_ODOMETRY, adapters.LOCAL_POSITION, adapters.SPORT_STATE)
        )
        found += filled(log, *adapters.FOXGLOVE_ODOMETRY) or next(filter(None, one_by_one), [])
    if not filled(log, adapters.IMU):
        found += filled(log, adapters.SENSOR_COMBINED)[:1]
    for topic in found:
        if (name := adapters.presented_name(topic, log.topics[topic].msgtype)) is not None:
            log.find(name)


def _clouds(log: Log) -> list[str]:
    """Return point cloud topics in sensor frames: names of lasers first, then by falling message count."""
    clouds = [
        t for t in filled(log, adapters.CLOUD, *adapters.FOXGLOVE_CLOUD) if log.topics[t].count >= MIN_CLOUDS
    ]
    frames = {t: log.stream(t).frame_id for t in clouds}
    clouds = [t for t in clouds if not (is_fixed(frames[t]) or last_word(frames[t]) == SLAM_FRAME)]
    return sorted(clouds, key=lambda t: (not LASER_NAME.search(t.lower()), -log.topics[t].count, t))


def offer_tags(log: Log, robot: Robot) -> None:
    """Add a topic with tags for each camera of the robot that sees tags by /tf: "/tf:camera_optical:tags".

    A frame is a tag if its name has a word for tags and ends in a number, and if it moves in the frame of a camera
    on the robot, beside other tags. Nothing is added if the log has a topic of poses, or the settings name one.
    Reading /tf takes time, so call this only if landmarks are needed.
    Raises LocfuseError if the frames form a loop.
    """
    settings = robot.settings("landmarks")
    if settings.topic or settings.file or filled(log, *POSES):
        return
    for topic in log.transform_topics:
        edges = log.frames(topic)
        for frame in sorted({parent for parent, child in edges if named_as_tag(child)}):
            tags = sum(named_as_tag(edge.child) for edge in tags_of(edges, frame))
            if tags >= MIN_TAGS and _is_camera_on_robot(log, frame):
                log.find(f"{topic}:{frame}:{OF_CAMERA}")


def _is_camera_on_robot(log: Log, frame: str) -> bool:
    """Return whether a frame is on the robot (not in map, world, odom), and has a camera's name or pictures."""
    above = [parent for parent, _ in ancestors(log.all_mounts(), frame)]
    if any(map(is_fixed, above)) and not any(map(is_base, above)):
        return False
    pictures = filled(log, *REGISTRY["camera"].reads, CAMERA_INFO)
    named = CAMERA_NAME.search(frame.lower()) is not None
    return named or any(log.stream(t).frame_id.lstrip("/") == frame for t in pictures)
