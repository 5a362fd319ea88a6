"""Fixes, turns, echoes and detections in stretches: what instant by instant gives, in both forms of the core."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from typing import Any

import hypothesis
import numpy as np
import pytest
from all_ways import advanced, assert_all_ways_agree, assert_same_bits
from hypothesis import strategies as st
from msgspec.structs import replace
from worlds import World, cast

from locfuse.fusion.core.room import Room
from locfuse.fusion.data import VERDICTS, Array, Drive, Ints, LocfuseError, Measurements
from locfuse.fusion.fuse import fuse
from locfuse.fusion.measure import measure
from locfuse.fusion.robot import Robot, StartSettings

MARKS = {3: (6.5, 5.0), 4: (0.5, 5.5), 8: (7.5, 0.5)}  # m
KINDS = ("as seen", "nothing", "no number", "far off", "two at once")
MAP = {str(key): place for key, place in MARKS.items()}


def described(settings: Mapping[str, Any], seconds: float) -> tuple[World, Robot]:
    world = World(seconds=seconds, settings={"landmarks": {"map": MAP}, **settings})
    return world, replace(world.robot(), start=StartSettings(x=1.5, y=1.5, sigma_xy=0.1, sigma_theta_deg=5.0))


def drive_of(
    settings: Mapping[str, Any], kinds: Sequence[str] = ("as seen",), seconds: float = 4.0, seed: int = 0
) -> tuple[Drive, Robot]:
    """A drive with readings of all six sensors, which are of these kinds in turn."""
    world, robot = described(settings, seconds)
    drive = measure(world.streams(), robot)
    rng = np.random.default_rng(seed)
    made = {
        "gps": fixes(drive, world, np.arange(1, len(drive.t), 4), rng),
        "gyro": turns(drive, world, np.arange(0, len(drive.t), 3), rng),
        "sonar": echoes(drive, world, np.arange(2, len(drive.t), 3), rng),
        "landmarks": detections(drive, world, np.arange(3, len(drive.t), 5), rng),
        "pose": estimates(drive, world, np.arange(1, len(drive.t), 5), rng, settings == DRIFTING),
        "twist": speeds(drive, world, np.arange(0, len(drive.t), 4), rng),
    }
    if robot.settings("landmarks").topics:
        made["landmarks"] = by_two_cameras(*made["landmarks"])
    changed = {s: (damaged(m, kinds, s), when) for s, (m, when) in made.items()}
    return replace(
        drive,
        measurements={**drive.measurements, **{s: m for s, (m, _) in changed.items()}},
        instant={**drive.instant, **{s: doubled(when, s, kinds) for s, (_, when) in changed.items()}},
    ), robot


def damaged(m: Measurements, kinds: Sequence[str], sensor: str) -> Measurements:
    """Readings of a kind in turn; one without a row is none of those that always have one."""
    z, first, extra = m.z.copy(), m.first, dict(m.extra)
    kind = [kinds[i % len(kinds)] for i in range(len(m.t))]
    rows = np.repeat(np.arange(len(m.t)), np.diff(first))
    if sensor != "pose":  # none is measured that is no number
        z[[k for k, i in enumerate(rows) if kind[i] == "no number"]] = math.nan
    z[[k for k, i in enumerate(rows) if kind[i] == "far off"]] += 3.0
    R_unit = m.R_unit
    if sensor in ("sonar", "landmarks"):
        stay = np.array([kind[i] != "nothing" for i in rows], bool)
        counts = np.bincount(rows[stay], minlength=len(m.t))
        first = np.concatenate(([0], np.cumsum(counts, dtype=np.int64)))
        z, R_unit, extra = z[stay], R_unit[stay], {name: column[stay] for name, column in extra.items()}
    if sensor in ("gyro", "twist"):
        extra["piece"] = np.cumsum([k == "nothing" for k in kind]).astype(np.float64)
    return replace(m, z=z, first=first, R_unit=R_unit, extra=extra)


def doubled(when: Ints, sensor: str, kinds: Sequence[str]) -> Ints:
    """Let two readings come at one instant, of sensors that can."""
    when = when.copy()
    if "two at once" in kinds and sensor not in ("gyro", "twist") and len(when) > 5:
        when[5] = when[4]
    return when


def readings(drive: Drive, when: Ints, z: Array, sigma: float, **of: Any) -> tuple[Measurements, Ints]:
    n, d = z.shape
    first = of.pop("first", np.arange(n + 1))
    shares = np.linspace(1.0, 1.5, n)[:, None, None] * (np.eye(d) + 0.1 * (np.ones((d, d)) - np.eye(d)))
    return Measurements(drive.t[when], first, z, shares, sigma, np.zeros((d, d)), extra=of), when


def fixes(drive: Drive, world: World, when: Ints, rng: np.random.Generator) -> tuple[Measurements, Ints]:
    """East lies at 25 degrees, and the map's origin is the earth's."""
    at, e = world.pose(drive.t[when])[:, :2], math.radians(25.0)
    c, s = math.cos(e), math.sin(e)
    z = at @ np.array([[c, -s], [s, c]]) + rng.normal(0.0, 0.05, at.shape)
    return readings(drive, when, z, 0.05)


def turns(drive: Drive, world: World, when: Ints, rng: np.random.Generator) -> tuple[Measurements, Ints]:
    z = world.pose(drive.t[when])[:, 2:] + 0.01 * drive.t[when][:, None] + rng.normal(0.0, 1e-3, (len(when), 1))
    return readings(drive, when, z, 0.002, piece=np.zeros(len(when)))


def estimates(
    drive: Drive, world: World, when: Ints, rng: np.random.Generator, drifts: bool
) -> tuple[Measurements, Ints]:
    """Poses of a source in the map, whose errors in x, y and heading belong together."""
    root = np.array([[0.03, 0.0, 0.0], [0.01, 0.02, 0.0], [0.005, -0.004, 0.01]])
    z = world.pose(drive.t[when]) + rng.normal(size=(len(when), 3)) @ root.T
    m, _ = readings(drive, when, z, 1.0, drifts=np.full(len(when), float(drifts)), told=np.ones(len(when)))
    floor = np.diag([1e-6, 1e-6, 1e-8])
    return replace(m, R_unit=np.broadcast_to(root @ root.T, (len(when), 3, 3)).copy(), floor=floor), when


def speeds(drive: Drive, world: World, when: Ints, rng: np.random.Generator) -> tuple[Measurements, Ints]:
    """Way and turn since the beginning; after two thirds there was a gap."""
    poses, n = world.pose(drive.t[when]), len(when)
    way = np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(poses[:, :2], axis=0).T))))
    z = np.column_stack((way, poses[:, 2])) + rng.normal(0.0, 1e-3, (n, 2))
    summed = {name: 1e-4 * np.arange(n) for name in ("forward_variance", "turn_variance")}
    piece = (np.arange(n) > 2 * n // 3).astype(float)
    m, _ = readings(drive, when, z, 0.02, piece=piece, told=np.zeros(n), **summed)
    return replace(m, floor=np.diag([1e-6, 1e-7])), when


def echoes(drive: Drive, world: World, when: Ints, rng: np.random.Generator) -> tuple[Measurements, Ints]:
    """The nearest thing that any ray of the cone meets."""
    walls, yaw = np.array(world.walls, float), rng.choice([0.0, 1.5, -1.5], len(when))
    beams = np.linspace(-0.2, 0.2, 41)
    poses = world.pose(drive.t[when])
    z = [cast(p[:2], p[2] + a + beams, walls).min() for p, a in zip(poses, yaw, strict=True)]
    noisy = np.array(z)[:, None] + rng.normal(0.0, 0.02, (len(when), 1))
    zero = np.zeros(len(when))
    return readings(drive, when, noisy, 0.03, x=zero, y=zero, yaw=yaw, half=np.full(len(when), 0.2))


def detections(drive: Drive, world: World, when: Ints, rng: np.random.Generator) -> tuple[Measurements, Ints]:
    """One, two or three landmarks in turn."""
    z, ids, counts = [], [], []
    for i, (x, y, theta) in enumerate(world.pose(drive.t[when])):
        shown = list(MARKS)[: 1 + i % 3]
        for key in shown:
            dx, dy = MARKS[key][0] - x, MARKS[key][1] - y
            z.append((math.atan2(dy, dx) - theta, math.hypot(dx, dy)))
            ids.append(key)
        counts.append(len(shown))
    noisy = np.array(z) + rng.normal(0.0, 1.0, (len(z), 2)) * (0.01, 0.05)
    noisy[:, 0] = np.remainder(noisy[:, 0] + math.pi, math.tau) - math.pi
    m, _ = readings(drive, when, noisy, 0.02, id=np.array(ids, float))
    return replace(m, t=drive.t[when], first=np.concatenate(([0], np.cumsum(counts)))), when


def by_two_cameras(m: Measurements, when: Ints) -> tuple[Measurements, Ints]:
    """Every other detection is of a camera that sits elsewhere; its own place is a little wrong."""
    second = (np.arange(len(m.z)) % 2).astype(np.float64)
    levers = {"x": 0.02 * second, "y": -0.01 * second, "yaw": 0.005 * second}
    return replace(m, extra={**m.extra, **levers}), when


GROWN = {"landmarks": {"map": "grow"}}
CAMERAS = {"landmarks": {"map": MAP, "topics": ("/front", "/rear")}}
GROWN_BY_CAMERAS = {"landmarks": {"map": "grow", "topics": ("/front", "/rear")}}
TIED = {"gps": {"east_deg": 25.0, "x": 0.01, "y": -0.02}}
GIVEN = {
    "gps": {"east_deg": 25.0, "origin": (49.0, 11.0)},
    "gyro": {"bias_deg": 0.5},
    "landmarks": {"map": MAP, "range_offset": 0.0, "range_depth": 0.02, "x": 0.02, "yaw_deg": 0.3},
}
FROM_FILE = {"landmarks": {"map": MAP, "file": "there.csv"}}
NARROW = {name: {"gate": 0.6} for name in ("gps", "sonar")} | {"landmarks": {"map": MAP, "gate": 0.6}}
FROZEN = {"lrf": {"map": "first-scan"}}
GROWN_FROZEN = {**GROWN, **FROZEN}
IN_MAP = {"pose": {"frame": "map"}}
DRIFTING = {"pose": {"frame": "drift", "sigma_drift": 0.5, "sigma_drift_deg": 20.0}, "twist": {"sigma_scale": 0.1}}
SETTINGS = [
    {}, CAMERAS, GROWN_BY_CAMERAS, TIED, GIVEN, GROWN, FROM_FILE, NARROW, FROZEN, GROWN_FROZEN, IN_MAP, DRIFTING,
]  # fmt: skip
EVERY = ("compass", "lrf", "sonar", "gps", "gyro", "landmarks")
TOGETHER = [
    ("gps",), ("gyro",), ("landmarks",), ("lrf", "sonar"), ("gps", "gyro"), ("gyro", "landmarks"),
    ("compass", "lrf", "landmarks"), EVERY, ("pose",), ("twist",), ("compass", "lrf", "pose", "twist"),
    ("gps", "gyro", "pose"),
]  # fmt: skip


@pytest.mark.parametrize("sensors", TOGETHER, ids="+".join)
@pytest.mark.parametrize("settings", SETTINGS)
def test_readings_are_the_same_in_stretches_instant_by_instant_and_in_both_forms(
    settings: Mapping[str, Any], sensors: tuple[str, ...]
) -> None:
    drive, robot = drive_of(settings)
    run = assert_all_ways_agree(drive, robot, sensors)
    for s in sensors:
        assert (run.audits[s].verdict == 0).sum() > 5, s


@hypothesis.settings(deadline=None, max_examples=60)
@hypothesis.given(
    st.lists(st.sampled_from(KINDS), min_size=1, max_size=6),
    st.sampled_from(SETTINGS),
    st.sampled_from(TOGETHER),
    st.integers(0, 2**32 - 1),
)
def test_whatever_is_read_all_ways_agree(
    kinds: list[str], settings: Mapping[str, Any], sensors: tuple[str, ...], seed: int
) -> None:
    assert_all_ways_agree(*drive_of(settings, kinds, 2.4, seed), sensors)


def test_the_core_takes_all_but_the_first_readings() -> None:
    """The loop takes what begins something: a map, landmarks, a kept heading, and fixes until east is known."""
    drive, robot = drive_of(TIED)
    assert len(advanced(drive, robot, EVERY)) <= 5
    drive, robot = drive_of({**GROWN, **TIED})
    assert len(advanced(drive, robot, EVERY)) <= 8
    for settings in ({}, IN_MAP, DRIFTING):
        drive, robot = drive_of(settings)
        assert len(advanced(drive, robot, ["pose", "twist"])) == (1 if settings == IN_MAP else 2)
    drive, robot = drive_of({}, seconds=20.0)
    fixes_seen = len(drive.measurements["gps"].t)
    assert len(advanced(drive, robot, ["gps"])) < 0.7 * fixes_seen
    (words,) = fuse(drive, robot, ["gps"]).notes
    east, sigma = map(float, re.findall(r"(\d+\.\d)", words))
    assert abs(east - 25.0) < 3.0 * sigma < 20.0


def test_of_a_reading_of_more_detections_than_there_is_room_for_the_loop_takes_care(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    drive, robot = drive_of({})
    monkeypatch.setattr("locfuse.fusion.sensors.landmarks.MOST_AT_ONCE", 2)
    assert len(advanced(drive, robot, ["landmarks"])) == len(drive.measurements["landmarks"].t)
    assert_all_ways_agree(drive, robot, ["landmarks"])


def test_a_turn_within_the_rest_that_gave_the_bias_is_not_used_again() -> None:
    drive, robot = drive_of({})
    m = drive.measurements["gyro"]
    rest = {"rest_begin": m.t[4], "rest_end": m.t[9], "rest_turned": 0.01 * (m.t[9] - m.t[4])}
    extra = {**m.extra, **{name: np.full(len(m.t), value) for name, value in rest.items()}}
    drive.measurements["gyro"] = replace(m, extra=extra)
    run = assert_all_ways_agree(drive, robot, ["gyro"])
    assert np.flatnonzero(run.audits["gyro"].verdict == VERDICTS.index("repeated")).tolist() == [4, 5, 6, 7, 8]


def test_what_listens_or_keeps_outliers_is_left_to_the_loop() -> None:
    drive, robot = drive_of({"gps": {"outliers": "inflate", "east_deg": 25.0}}, ("as seen", "far off"))
    assert_all_ways_agree(drive, robot, ["gps", "gyro"])
    every = {"landmarks": np.ones(len(drive.measurements["landmarks"].t), np.bool_)}
    heard = fuse(drive, robot, ["lrf"], listen=every)
    np.testing.assert_array_equal(heard.pose, fuse(drive, robot, ["lrf"]).pose)


@pytest.mark.parametrize("sensors", TOGETHER, ids="+".join)
@pytest.mark.parametrize("settings", [{}, GROWN])
def test_a_start_known_to_a_hundred_kilometres_is_fused_or_refused_in_one_line(
    settings: Mapping[str, Any], sensors: tuple[str, ...]
) -> None:
    """Rounding may eat a variance; then both forms say so."""
    drive, robot = drive_of(settings)
    lost = replace(robot, start=StartSettings(x=1.5, y=1.5, sigma_xy=1e5, sigma_theta_deg=3600.0))
    try:
        run = fuse(drive, lost, sensors)
    except LocfuseError as e:
        assert "powers of ten" in str(e)  # noqa: PT017
        return
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr("locfuse.fusion.core.room._here", lambda source: Room.of(source, None))
        assert_same_bits(run, fuse(drive, lost, sensors))


@pytest.mark.parametrize("variance", [math.inf, math.nan])
def test_what_has_no_finite_variance_is_refused(variance: float) -> None:
    drive, robot = drive_of(TIED)
    for s in ("gps", "gyro", "landmarks", "sonar"):
        m = drive.measurements[s]
        R = m.R_unit.copy()
        R[len(R) // 2 :] = np.diag(np.full(R.shape[1], variance))
        drive.measurements[s] = replace(m, R_unit=R)
    with np.errstate(invalid="ignore"):  # inf times a correlation of 0
        run = assert_all_ways_agree(drive, robot, EVERY)
    for s in ("gps", "landmarks"):
        verdicts = run.audits[s].verdict
        assert (verdicts[len(verdicts) // 2 + 1 :] == VERDICTS.index("gate")).all(), s
