"""A real robot among barcodes (LOCFUSE_DATA/mrclam): what it reaches, what could be, and what advice says."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple, cast

import numpy as np
import pytest
from numpy.typing import NDArray

import locfuse
from locfuse.formats.logs.log import open_log

DATA = os.environ.get("LOCFUSE_DATA")
pytestmark = pytest.mark.skipif(not DATA, reason="LOCFUSE_DATA is not set: no real logs to try")
FOLDER = Path(DATA or "") / "mrclam"
LOG = FOLDER / "mrclam.mcap"
LAG_S = 0.19  # by which the robot follows its commands late
START = {"start.x": 1.426, "start.y": -3.905, "start.theta_deg": 134.8}
SETS: Mapping[str, Any] = {
    **START,
    "landmarks.file": str(FOLDER / "detections.csv"),
    "landmarks.map": str(FOLDER / "landmarks.csv"),
}
TRUTH = {"truth.sigma": 0.002, "truth.sigma_theta_deg": 0.16}

Array = NDArray[np.float64]


def test_a_given_map_of_barcodes_gives_the_figures_of_the_docs() -> None:
    session = locfuse.load(LOG, sets={**SETS, **TRUTH, "wheels.time_offset": LAG_S})
    found = session.run("landmarks", advice=False, smooth=True).report["configurations"]
    filtered, smoothed = found["landmarks"], found["landmarks-smoothed"]
    assert (filtered["position_rmse_m"], filtered["heading_rmse_deg"]) == pytest.approx((0.150, 6.03), rel=0.02)
    assert (smoothed["position_rmse_m"], smoothed["heading_rmse_deg"]) == pytest.approx((0.088, 3.70), rel=0.02)


class Commands(NamedTuple):
    """What the robot was told, and where it was; times since the first command."""

    t: Array  # (n,) s
    way: Array  # (n,) m, as commanded
    turned: Array  # (n,) rad
    truth: tuple[Array, Array, Array, Array]  # t, x, y, theta
    seen: Array  # (k,) s: instants of detections of landmarks

    def at(self, t: Array) -> Array:
        """Return true poses (..., 3)."""
        known, *numbers = self.truth
        return np.stack([np.interp(t, known, v) for v in numbers], axis=-1)


def commands() -> Commands:
    log = open_log([LOG])
    odom, truth = log.stream("/odom"), log.stream("/ground_truth/pose")
    told = cast("dict[str, Array]", odom.columns("twist.twist.linear.x", "twist.twist.angular.z"))
    pose = cast(
        "dict[str, Array]",
        truth.columns("pose.position.x", "pose.position.y", "pose.orientation.z", "pose.orientation.w"),
    )
    x, y, z, w = pose.values()
    zero = odom.t_ns[0] * 1e-9
    t = odom.t_ns * 1e-9 - zero
    way, turned = (np.append(0.0, np.cumsum(v[:-1] * np.diff(t))) for v in told.values())
    rows = np.genfromtxt(FOLDER / "detections.csv", delimiter=",", skip_header=1)
    known = np.genfromtxt(FOLDER / "landmarks.csv", delimiter=",", skip_header=1)[:, 0]
    seen = np.unique(rows[np.isin(rows[:, 1], known), 0]) - zero
    return Commands(t, way, turned, (truth.t_ns * 1e-9 - zero, x, y, np.unwrap(2.0 * np.arctan2(z, w))), seen)


def reckoned(log: Commands, gains: tuple[float, float], closed: bool) -> tuple[float, float]:
    """Return rms errors [m, degrees] of a robot that is at its true pose at every detection.

    In between it is driven by its commands times two gains (way, turn); `closed`: the errors at the end of every
    stretch are spread over its turning and its way, as only who knows the next detection can do.
    """
    first, last = 1.0, float(log.truth[0][-1]) - 1.0
    ends = np.concatenate(([first], log.seen[(log.seen > first) & (log.seen < last)], [last]))
    off = []
    for begin, end in zip(ends[:-1].tolist(), ends[1:].tolist(), strict=True):
        t = np.append(np.arange(begin, end, 0.05), end)
        way, turned = (g * np.interp(t - LAG_S, log.t, v) for g, v in zip(gains, log[1:3], strict=True))
        real = log.at(t)
        theta = real[0, 2] + turned - turned[0]
        if closed:
            theta += _share(np.abs(np.diff(turned)) + 1e-3 * np.diff(t)) * (real[-1, 2] - theta[-1])
        middle = 0.5 * (theta[1:] + theta[:-1])
        steps = np.diff(way)[:, None] * np.stack((np.cos(middle), np.sin(middle)), axis=-1)
        place = real[0, :2] + np.vstack((np.zeros(2), np.cumsum(steps, axis=0)))
        if closed:
            place += _share(np.diff(way) + 1e-4 * np.diff(t))[:, None] * (real[-1, :2] - place[-1])
        off.append(np.column_stack((place, theta))[:-1] - real[:-1])
    dx, dy, turn = np.concatenate(off).T
    return float(np.sqrt((dx**2 + dy**2).mean())), float(np.degrees(np.sqrt((turn**2).mean())))


def _share(parts: Array) -> Array:
    done = np.append(0.0, np.cumsum(parts))
    share: Array = done / done[-1]
    return share


@pytest.mark.parametrize(
    ("gains", "closed", "bound"),
    [
        ((1.0, 1.0), False, (0.097, 5.1)),
        ((0.94, 0.89), False, (0.100, 3.8)),
        ((1.0, 1.0), True, (0.050, 2.6)),
    ],
)
def test_the_commands_of_this_log_bound_what_any_estimator_can_reach(
    gains: tuple[float, float], closed: bool, bound: tuple[float, float]
) -> None:
    """The goals of 0.10 m and 3 degrees lie at or below what perfect detections would give."""
    assert reckoned(commands(), gains, closed) == pytest.approx(bound, rel=0.02)


def test_without_truth_less_noise_of_the_landmarks_is_only_advised_with_more_of_the_wheels() -> None:
    """The landmarks' sigma is set too high, which hides that wheels that only hear commands slip more."""
    asked = locfuse.load(LOG, sets={**SETS, "truth.topic": "none"}).compare()
    values = {key: float(value) for key, _, value in (fix.partition("=") for fix in asked.report["fixes"])}
    assert values.keys() == {"landmarks.sigma_bearing_deg", "landmarks.sigma_range", "wheels.noise"}
    judged = locfuse.load(LOG, sets={**SETS, **TRUTH})
    before, after, sensor_only = (
        judged.with_settings(sets).run("landmarks", advice=False).report["configurations"]["landmarks"]["anees"]
        for sets in ({}, values, {k: v for k, v in values.items() if k != "wheels.noise"})
    )
    assert after < before < sensor_only


# --- a depth camera as a laser (LOCFUSE_DATA/strangers): what its lines need


DEPTH_LOG = Path(DATA or "") / "strangers" / "odometry_in_tf.bag"


def test_of_a_depth_camera_a_floor_of_its_lines_is_advised_and_takes_more_of_them() -> None:
    """Its neighbouring beams are wrong alike, so that the mean of many is no better than one."""
    log = locfuse.load(DEPTH_LOG)
    fixes = dict(fix.partition("=")[::2] for fix in log.compare().report["fixes"])
    assert fixes.keys() == {"lrf.floor_range", "lrf.floor_angle_deg"}
    before, after = (
        session.run("lrf", advice=False).report["configurations"]["lrf"]["sensors"]["lrf"]
        for session in (log, log.with_settings({key: float(value) for key, value in fixes.items()}))
    )
    assert after["accepted"] > 1.25 * before["accepted"]
    assert after["rejected"] < 0.7 * before["rejected"]
