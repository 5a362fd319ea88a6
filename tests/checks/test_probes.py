"""What a run's states say of mount and track: held to the turning of wheels, and to what was taken for likely."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from msgspec.structs import replace

from locfuse.cli.analysis.robot_tables import make_robot
from locfuse.fusion.checks.probes import beyond_prior, of_probe
from locfuse.fusion.data import Estimates
from locfuse.fusion.robot import Robot

TRACK_M = 0.6
SURE = 1e-4  # m, rad, relative: standard deviation of a state that is known well


def robot(**lrf: Any) -> Robot:
    return make_robot({"wheels": {"radius": 0.05, "track": TRACK_M}, "lrf": lrf})


def run(**states: tuple[float, ...]) -> Estimates:
    """The end of a laser's run with these states, all known well."""
    none = np.zeros(0)
    blocks = {name: np.array([values]) for name, values in states.items()}
    sigmas = {name: np.full_like(found, SURE) for name, found in blocks.items()}
    whole = Estimates("lrf", ("lrf",), none, np.zeros((0, 3)), np.zeros((0, 6)), {}, blocks=blocks)
    return replace(whole, block_sigmas=sigmas)


@pytest.mark.parametrize("longer", [-0.06, 0.0, 0.05])
@pytest.mark.parametrize("turns", [0.97, 1.08])
def test_the_track_alone_turns_the_robot_as_far_as_the_states_do(longer: float, turns: float) -> None:
    """Whatever the states make of the ways: a laser whose ranges are 5 % too long lengthens the wheels' too.

    The states turn the robot by ((1 + right) dr - (1 + left) dl - q (dr - dl)) / track.
    """
    right = left = longer
    found = list(of_probe(robot(), "lrf", run(wheels=(right, left, 1.0 + longer - turns)), False))
    assert [f.code for f in found] == ["track"]
    (fix,) = found[0].fixes
    rolled = 1.0  # m, of the right wheel against the left one
    by_states = turns * rolled / TRACK_M
    assert rolled / float(fix.partition("=")[2]) == pytest.approx(by_states, rel=1e-3)


def test_a_track_that_turns_the_robot_as_configured_is_no_finding() -> None:
    assert not list(of_probe(robot(), "lrf", run(wheels=(0.05, 0.05, 0.05)), False))


@pytest.mark.parametrize(
    ("state", "value", "settings", "beyond"),
    [
        ("lrf_yaw", math.radians(1.4), {}, False),
        ("lrf_yaw", math.radians(1.6), {}, True),
        ("lrf_yaw", math.radians(1.6), {"sigma_yaw_deg": 2.0}, False),
        ("lrf_yaw", math.radians(31.6), {"yaw_deg": 30.0}, True),
        ("lrf_x", 0.02, {}, False),
        ("lrf_x", 0.04, {}, True),
    ],
)
def test_a_mount_is_looked_for_again_where_it_is_found_beyond_three_of_its_prior_sigmas(
    state: str, value: float, settings: dict[str, float], beyond: bool
) -> None:
    assert beyond_prior(robot(**settings), "lrf", run(**{state: (value,)})) == beyond


def test_not_where_the_run_is_not_sure_of_it_and_not_for_a_sensor_without_a_mount() -> None:
    found = run(lrf_yaw=(math.radians(1.6),))
    vague = replace(found, block_sigmas={"lrf_yaw": np.array([[math.radians(0.5)]])})
    assert not beyond_prior(robot(), "lrf", vague)
    assert not beyond_prior(robot(), "compass", found)
