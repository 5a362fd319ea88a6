"""Tags that a detector publishes as frames of /tf: which frame of a log is a camera that sees several."""

from __future__ import annotations

from typing import TYPE_CHECKING

from locfuse.formats.logs.transform_stream import tags_of
from locfuse.formats.robot.tag_frames import OF_CAMERA, ancestors, named_as_tag
from locfuse.formats.robot.transforms import StaticTransforms
from locfuse.fusion.robot import Robot
from locfuse.fusion.sensors.landmark_messages import POSES
from locfuse.fusion.sensors.registry import REGISTRY

from .mounts import BASE_FRAMES, CAMERA_INFO, last_word
from .topics import of_type

if TYPE_CHECKING:
    from locfuse.formats.logs.log import Log

MIN_TAGS = 2  # frames of tags: one may be anything
CAMERA_WORDS = ("camera", "cam_", "_cam", "optical", "webcam", "realsense", "kinect", "oak", "zed", "rgb")
ROOM_FRAMES = ("map", "world", "earth", "odom")  # a camera that hangs there is not on the robot


def offer_tags(log: Log, robot: Robot) -> None:
    """Make a topic of the tags that each camera of the robot saw, "/tf:camera_optical:tags", where /tf has any.

    A frame is a tag where its name says so and ends in a number, its parent is a camera of the robot, it moves
    there, and there are several. Detectors that publish poses besides are read themselves, and what the settings
    name is: nothing is made then.
    Reading /tf takes time: for callers who need landmarks. Raises LocfuseError where its frames form a loop.
    """
    settings = robot.settings("landmarks")
    if settings.topic or settings.file or any(log.topics[t].count for t in of_type(log, POSES)):
        return
    for topic in log.transform_topics:
        for camera in _cameras(log, topic):
            log.find(f"{topic}:{camera}:{OF_CAMERA}")


def _cameras(log: Log, topic: str) -> list[str]:
    """Return the cameras of the robot in which several frames are tags, by name."""
    edges = log.frames(topic)
    parents = sorted({parent for parent, child in edges if named_as_tag(child)})
    several = [p for p in parents if sum(named_as_tag(edge.child) for edge in tags_of(edges, p)) >= MIN_TAGS]
    if not several:
        return []
    transforms = log.all_mounts()
    return [frame for frame in several if _on_robot(frame, transforms) and _is_camera(log, frame)]


def _on_robot(frame: str, transforms: StaticTransforms) -> bool:
    """Return whether nothing says that a frame stands in the room."""
    above = [last_word(parent) for parent, _ in ancestors(transforms, frame)]
    return any(parent in BASE_FRAMES for parent in above) or not any(parent in ROOM_FRAMES for parent in above)


def _is_camera(log: Log, frame: str) -> bool:
    """Return whether a frame is called like a camera, or pictures are taken in it."""
    if any(word in frame.lower() for word in CAMERA_WORDS):
        return True
    pictures = [t for t in of_type(log, (*REGISTRY["camera"].reads, CAMERA_INFO)) if log.topics[t].count]
    return any(log.stream(t).frame_id.lstrip("/") == frame for t in pictures)
