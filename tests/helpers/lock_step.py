"""Simulated drives in memory, every sensor at each step of 0.1 s as in the paper; no file, no camera."""

from collections.abc import Sequence

from benchmarks import experiment
from benchmarks.accuracy import LOCK_STEP
from locfuse.fusion.data import Drive
from locfuse.fusion.robot import Robot


def simulated(
    seed: int, scenario: str = "rounded_rectangle", sets: Sequence[str] = (), robot_sets: Sequence[str] = ()
) -> tuple[Drive, Robot]:
    """A drive, and the robot that its user would describe with `robot_sets` on top."""
    return experiment.simulated(scenario, (*LOCK_STEP, "camera.enabled=false", *sets), seed).measured(robot_sets)
