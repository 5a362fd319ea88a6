"""Topics read as another type (scans from clouds, PX4, tags in /tf ...), and types that are not read at all."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

from locfuse.formats.logs.adapters import (
    CLOUD,
    DYNAMIC,
    ECHOES,
    FEEDBACK,
    FOXGLOVE,
    FOXGLOVE_CLOUD,
    FOXGLOVE_JOINTS,
    FOXGLOVE_ODOMETRY,
    IMU,
    JOINTS,
    LOCAL_POSITION,
    ODOMETRY,
    SCAN,
    SENSOR_COMBINED,
    SPORT_STATE,
    VEHICLE_ODOMETRY,
    presented_name,
)
from locfuse.formats.logs.transform_stream import tags_of
from locfuse.formats.robot.tag_frames import OF_CAMERA, ancestors, named_as_tag
from locfuse.formats.robot.transforms import StaticTransforms
from locfuse.fusion.robot import Robot
from locfuse.fusion.sensors.landmarks import POSES
from locfuse.fusion.sensors.registry import REGISTRY

from .mounts import BASE_FRAMES, CAMERA_INFO, last_word
from .topics import filled

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
LASERS = re.compile("velodyne|lidar|ouster|hesai|rslidar|laser|points_raw|livox|scan")  # in names of topics
STILL_FRAMES = ("map", "odom", "world", "earth", "camera_init")  # clouds in them are maps, or were moved there
MIN_CLOUDS = 5  # of a topic: fewer are maps
MIN_TAGS = 2  # frames of tags: one may be anything
CAMERAS = re.compile("camera|cam_|_cam|optical|webcam|realsense|kinect|oak|zed|rgb")  # in names of frames
ROOM_FRAMES = ("map", "world", "earth", "odom")  # a camera that hangs there is not on the robot


def not_read(log: Log, role: str) -> str:
    """Return a sentence with a role's topics whose message types are not read; "" without any."""
    kinds = NOT_READ.get(role, {})
    found = [
        f"{topic} ({info.msgtype.replace('/msg/', '/')}) holds {kinds[info.msgtype].format(topic=topic)}"
        for topic, info in sorted(log.topics.items())
        if info.msgtype in kinds and info.count
    ]
    return found[0] if found else ""


def offer_presented(log: Log) -> None:
    """Add topics of usual types if the log lacks them, named after their source: "/points:scan".

    Of a laser's scans of Foxglove's kind and of its echoes all are offered, of clouds the likeliest one.
    """
    found: list[str] = []
    if not filled(log, SCAN):
        found += filled(log, *FOXGLOVE) or filled(log, ECHOES) or _clouds(log)[:1]
    if not filled(log, JOINTS):
        found += filled(log, DYNAMIC) or filled(log, *FOXGLOVE_JOINTS) or filled(log, *FEEDBACK)
    if not filled(log, ODOMETRY):
        one_by_one = (filled(log, kind)[:1] for kind in (VEHICLE_ODOMETRY, LOCAL_POSITION, SPORT_STATE))
        found += filled(log, *FOXGLOVE_ODOMETRY) or next(filter(None, one_by_one), [])
    if not filled(log, IMU):
        found += filled(log, SENSOR_COMBINED)[:1]
    for topic in found:
        if (name := presented_name(topic, log.topics[topic].msgtype)) is not None:
            log.find(name)


def _clouds(log: Log) -> list[str]:
    """Return topics of clouds that a sensor sees, those of lasers first, then the busiest."""
    clouds = [t for t in filled(log, CLOUD, *FOXGLOVE_CLOUD) if log.topics[t].count >= MIN_CLOUDS]
    clouds = [t for t in clouds if log.stream(t).frame_id.rpartition("/")[2] not in STILL_FRAMES]
    return sorted(clouds, key=lambda t: (not LASERS.search(t.lower()), -log.topics[t].count, t))


def offer_tags(log: Log, robot: Robot) -> None:
    """Add a topic of the tags seen by each camera of the robot, "/tf:camera_optical:tags", if /tf has any.

    A frame is a tag where its name has a word for tags and ends in a number, its parent is a camera of the robot,
    it moves there, and there are several. Where a detector publishes poses too, or the settings name a topic,
    nothing is made.
    Reading /tf takes time: for callers who need landmarks. Raises LocfuseError where its frames form a loop.
    """
    settings = robot.settings("landmarks")
    if settings.topic or settings.file or filled(log, *POSES):
        return
    for topic in log.transform_topics:
        for camera in _cameras(log, topic):
            log.find(f"{topic}:{camera}:{OF_CAMERA}")


def _cameras(log: Log, topic: str) -> list[str]:
    """Return the frames of the robot's cameras that see several tags, by name."""
    edges = log.frames(topic)
    parents = sorted({parent for parent, child in edges if named_as_tag(child)})
    several = [p for p in parents if sum(named_as_tag(edge.child) for edge in tags_of(edges, p)) >= MIN_TAGS]
    if not several:
        return []
    transforms = log.all_mounts()
    return [frame for frame in several if _on_robot(frame, transforms) and _is_camera(log, frame)]


def _on_robot(frame: str, transforms: StaticTransforms) -> bool:
    """Return whether a frame may be on the robot: none of its parents is a frame of the room."""
    above = [last_word(parent) for parent, _ in ancestors(transforms, frame)]
    return any(parent in BASE_FRAMES for parent in above) or not any(parent in ROOM_FRAMES for parent in above)


def _is_camera(log: Log, frame: str) -> bool:
    """Return whether a frame has a camera's name, or is the frame of pictures."""
    if CAMERAS.search(frame.lower()):
        return True
    pictures = filled(log, *REGISTRY["camera"].reads, CAMERA_INFO)
    return any(log.stream(t).frame_id.lstrip("/") == frame for t in pictures)
