"""Simulated drives in memory, every sensor at each step of 0.1 s as in the paper; no file, no camera."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import Any, cast

from locfuse.cli.analysis.robot_tables import make_robot
from locfuse.formats.robot import robot_toml
from locfuse.fusion.data import ArrayStream, Drive, Stream
from locfuse.fusion.measure import measure
from locfuse.fusion.robot import Robot
from locfuse.fusion.sensors.registry import REGISTRY
from locfuse.sample_logs.load import load
from locfuse.sample_logs.record import in_memory

LOCK_STEP = (
    "camera.enabled=false",
    "compass.rate=10",
    "compass.phase=0.05",
    "compass.noise_deg=0.1",
    "compass.sigma_deg=0.1",
    "compass.hard_iron=[0, 0]",
    "compass.soft_iron=[1, 1, 0]",
    "lrf.phase=0.05",
    "lrf.duration=1e-6",
    "truth.rate=10",
    "truth.phase=0.050001",
)


@lru_cache(16)  # many tests fuse the same few drives, as their robot's user would describe it or otherwise
def driven(seed: int, scenario: str, sets: tuple[str, ...]) -> tuple[dict[str, ArrayStream], dict[str, Any]]:
    """A drive's streams by topic, and the tables of its robot.toml."""
    topics, tables, _ = in_memory(load(scenario, (*LOCK_STEP, *sets)), seed)
    return topics, tables


def simulated(
    seed: int, scenario: str = "rounded_rectangle", sets: Sequence[str] = (), robot_sets: Sequence[str] = ()
) -> tuple[Drive, Robot]:
    """A drive, and the robot that its user would describe with `robot_sets` on top."""
    topics, tables = driven(seed, scenario, tuple(sets))
    robot = make_robot(robot_toml.layered(tables, robot_toml.apply_sets(robot_sets)))
    roles = ("wheels", "truth", *REGISTRY)
    streams = {r: topics[tables[r]["topic"]] for r in roles if r in tables}
    return measure(cast("dict[str, Stream]", streams), robot), robot
