"""Topics of a log that are read as another type: scans of clouds, joints of ros2_control, PX4's, Foxglove's."""

from __future__ import annotations

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

from .topics import of_type

if TYPE_CHECKING:
    from locfuse.formats.logs.log import Log

LASERS = ("velodyne", "lidar", "ouster", "hesai", "rslidar", "laser", "points_raw", "livox", "scan")
STILL_FRAMES = ("map", "odom", "world", "earth", "camera_init")  # clouds in them are maps, or were moved there
MIN_CLOUDS = 5  # of a topic: fewer are maps


def offer_presented(log: Log) -> None:
    """Make topics of the usual types where the log holds none: each is called after its source, "/points:scan".

    Of a laser's scans of Foxglove's kind and of its echoes all are offered, of clouds the likeliest one.
    """
    if not _filled(log, SCAN):
        for topic in _filled(log, *FOXGLOVE) or _filled(log, ECHOES) or _clouds(log)[:1]:
            _present(log, topic)
    if not _filled(log, JOINTS):
        for topic in _filled(log, DYNAMIC) or _filled(log, *FOXGLOVE_JOINTS) or _filled(log, *FEEDBACK):
            _present(log, topic)
    if not _filled(log, ODOMETRY):
        for topic in (
            _filled(log, *FOXGLOVE_ODOMETRY)
            or _filled(log, VEHICLE_ODOMETRY)[:1]
            or _filled(log, LOCAL_POSITION)[:1]
            or _filled(log, SPORT_STATE)[:1]
        ):
            _present(log, topic)
    if not _filled(log, IMU):
        for topic in _filled(log, SENSOR_COMBINED)[:1]:
            _present(log, topic)


def _present(log: Log, topic: str) -> None:
    name = presented_name(topic, log.topics[topic].msgtype)
    if name is not None:
        log.find(name)


def _filled(log: Log, *msgtypes: str) -> list[str]:
    return [t for t in of_type(log, msgtypes) if log.topics[t].count]


def _clouds(log: Log) -> list[str]:
    """Return topics of clouds that a sensor sees, those of lasers first, then the busiest."""
    clouds = [t for t in _filled(log, CLOUD, *FOXGLOVE_CLOUD) if log.topics[t].count >= MIN_CLOUDS]
    clouds = [t for t in clouds if log.stream(t).frame_id.rpartition("/")[2] not in STILL_FRAMES]
    return sorted(clouds, key=lambda t: (not any(w in t.lower() for w in LASERS), -log.topics[t].count, t))
