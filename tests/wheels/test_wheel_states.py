"""Wheels as states: what they mean by finite differences, and what a drive can and cannot tell of them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from lock_step import simulated
from textbook import numeric_jacobian

from locfuse.formats.report.findings import notes_of
from locfuse.fusion.data import Estimates
from locfuse.fusion.fuse import fuse
from locfuse.fusion.wheels.motion import Wheels
from locfuse.fusion.wheels.states import derivative, geometry


def test_geometry_s_derivative_equals_finite_differences() -> None:
    for x in ([0.0, 0.0, 0.0], [0.05, -0.02, 0.3], [-0.1, 0.03, -0.2]):
        np.testing.assert_allclose(derivative(np.array(x)), numeric_jacobian(geometry, np.array(x)), atol=1e-8)


def test_states_mean_what_wheels_of_that_geometry_do() -> None:
    """Told track 0.5, really 0.6, wheels 4 % larger: the linear motion is the true one."""
    rng = np.random.default_rng(0)
    t = np.arange(50) * np.float64(0.02)
    left, right = np.cumsum(rng.uniform(0.0, 0.01, (2, 50)), axis=1)
    x = np.array([0.04, 0.04, 1.04 * (1.0 - 0.5 / 0.6)])
    told = Wheels.from_wheels(t, left, right, 0.5, 1e-4).between(t[:-1], t[1:], parameters=True)
    real = Wheels.from_wheels(t, 1.04 * left, 1.04 * right, 0.6, 1e-4).between(t[:-1], t[1:])
    np.testing.assert_allclose(told.u + told.J @ x, real.u, atol=2e-6)
    np.testing.assert_allclose(geometry(x), [0.04, 0.0, 0.2], atol=1e-12)


def drive(sensors: Sequence[str], *sets: str) -> Estimates:
    found, robot = simulated(1000, robot_sets=("wheels.estimate=true", *sets))
    return fuse(found, robot, sensors)


@pytest.mark.parametrize("told", [0.5, 0.72])
def test_a_wrong_track_is_found(told: float) -> None:
    (words,) = [n for n in drive(["lrf"], f"wheels.track={told}").notes if n.startswith("wheels")]
    track, sigma = (float(w.rstrip(")")) for w in words.split("track ")[1].split(" (1 sigma: "))
    assert track == pytest.approx(0.6, abs=3 * sigma)
    assert sigma < 0.02


def test_wheels_told_10_percent_too_small_leave_the_metre_in_doubt() -> None:
    (words,) = [n for n in drive(["lrf"], "wheels.radius=0.045").notes if "not identifiable" in n]
    assert "larger than configured" in words
    scale = float(words.split("lrf.range_scale should be ")[1].split()[0])
    assert scale == pytest.approx(0.9, abs=0.03)  # the prior of 2 % holds back a little


def test_a_compass_sees_neither_radius_nor_track_but_their_quotient() -> None:
    compass, wheels = drive(["compass"]).notes, drive([]).notes
    assert any("not identifiable from compass: only track over radius is" in n for n in compass)
    assert any("not identifiable from wheels alone" in n for n in wheels)


def test_what_several_configurations_say_is_said_once() -> None:
    runs = {"odometry": {"notes": []}, "lrf": {"notes": ["lrf: slipped"]}, "all": {"notes": ["lrf: slipped"]}}
    assert notes_of({"notes": ["clock"], "configurations": runs}) == ["clock", "lrf: slipped (the same in all)"]
    assert notes_of({"notes": [], "configurations": {"all": runs["all"]}}) == ["lrf: slipped"]


def test_where_notes_differ_in_numbers_those_of_every_configuration_and_stream_are_shown() -> None:
    places = "lrf: {} submaps, {} revisited places"
    runs = {
        "lrf": {"notes": [places.format(9, 19), "lrf: 29 slips", "lrf: 30 slips"]},
        "lrf@2Hz": {"notes": [places.format(9, 5), "lrf: 29 slips", "lrf: 4 slips"]},
        "all": {"notes": [places.format(8, 5), "lrf: 29 slips"]},
    }
    log = ["lrf: 0.05 s late (3%)", "compass: 0.12 s late (3%)", "3 readings share a stamp"]
    assert notes_of({"notes": log, "configurations": runs}) == [
        "lrf, compass: 0.05 (compass: 0.12) s late (3%)",
        "3 readings share a stamp",
        "lrf: 9 (all: 8) submaps, 19 (lrf@2Hz, all: 5) revisited places",
        "lrf: 29 slips (the same in lrf@2Hz, all)",
        "lrf: 30 (lrf@2Hz: 4) slips",
    ]
