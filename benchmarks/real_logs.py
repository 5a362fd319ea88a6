"""Recorded logs in the folder LOCFUSE_DATA: path of each, and settings of its robot."""

import os
from pathlib import Path
from typing import Any

import click

DATA = "LOCFUSE_DATA"
PATHS = """
aces/aces.mcap brenner/brenner.mcap fr079/fr079.mcap mrclam/mrclam.mcap tricycle/tricycle.mcap warthog/warthog.mcap
halls/edmonton.mcap halls/freiburg-101.mcap bags/evo/nav2_turtlebot.mcap strangers/controller_twist.bag
strangers/marker_in_camera.bag strangers/odometry_in_tf.bag strangers/pimouse.bag strangers/setpoints.bag
strangers/sideways.bag strangers/world_frame_twist.bag strangers/laser_only strangers/standing_odometry
"""
FILES = {Path(path).stem: path for path in PATHS.split()} | {  # name -> path below the folder
    "turtlebot4": "turtlebot4/tb4_mcap.mcap",
    "turtlebot4 db3": "turtlebot4/db3",
    "uwb": "uwb/labyrinth_uwb.mcap",
}
KNOWN: dict[str, dict[str, Any]] = {  # name -> settings
    # its track is 0.155 m as measured, 0.173 m as calibrated
    "brenner": {
        "wheels.radius": 0.0199962,
        "truth.x": 0.03,
        "start.x": 1.87516,
        "start.y": 1.91334,
        "start.theta_deg": 213,
    },
    "uwb": {"wheels.radius": 1, "wheels.track": 0.157},
    "fr079": {"lrf.x": -0.04, "wheels.time_offset": 0.13},
}


def are_there() -> bool:
    return bool(os.environ.get(DATA))


def folder() -> Path:
    """Return the folder of real logs. Raises click.UsageError without one."""
    if not are_there():
        raise click.UsageError(f"{DATA} is not set: it names the folder of real logs")
    return Path(os.environ[DATA])
