"""Many instants at once are what instant by instant is, whatever lies on the way."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from typing import Any

import hypothesis
import numpy as np
import pytest
from all_ways import advanced, assert_all_ways_agree, assert_same, assert_same_bits, instant_by_instant
from hypothesis import strategies as st
from msgspec.structs import replace
from worlds import World

from locfuse.fusion.coast.stretches import Stretches
from locfuse.fusion.core.form import form
from locfuse.fusion.core.room import Room
from locfuse.fusion.data import VERDICTS, Array, Drive, LocfuseError, MapLine, Measurements, Ragged
from locfuse.fusion.doctor.examine import REFUSALS
from locfuse.fusion.fuse import Filter, fuse
from locfuse.fusion.measure import measure
from locfuse.fusion.robot import Robot, StartSettings

DRIFTING = {"compass": {"offset_drift_deg": 0.2}}
KNOWN = {"compass": {"offset_deg": math.degrees(0.7)}}
FROZEN, REFINED, CONSIDERED, UNGUARDED = (
    {"lrf": {"map": "first-scan"}},
    {"lrf": {"map": "refine"}},
    {"lrf": {"map": "consider"}},
    {"lrf": {"recover": False}},
)
WHEELS = {"wheels": {"estimate": True}}
MODES = ["grow", "refine", "consider", "first-scan", "given"]
EXACT = {"lrf": {"sigma_x": 0.0, "sigma_y": 0.0, "sigma_yaw_deg": 0.0}}
AWAY, TURNED = np.array([0.8, 1.1]), np.array([0.0, 0.2])  # m, rad: walls that stand elsewhere
NARROW = {"lrf": {"gate": 0.6}, "compass": {"gate": 0.8}}


def drive_of(settings: Mapping[str, Any], **of_world: Any) -> tuple[Drive, Robot]:
    world = World(**{"seconds": 8.0, **of_world}, settings=dict(settings))
    robot = replace(world.robot(), start=StartSettings(x=1.5, y=1.5, sigma_xy=0.1, sigma_theta_deg=5.0))
    return measure(world.streams(), robot), robot


def with_lines(drive: Drive, change: Callable[[int, Array], Array]) -> Drive:
    """Return the drive with the lines (k, 2) of every scan i changed to `change(i, lines)`; some may go."""
    m = drive.measurements["lrf"]
    rows, z, counts = [], [], []
    for i in range(len(m.t)):
        at = np.arange(m.first[i], m.first[i + 1])
        kept = change(i, m.z[at].copy())[: len(at)]
        rows.append(at[: len(kept)])
        z.append(kept)
        counts.append(len(kept))
    chosen = np.concatenate(rows)
    extra = {name: column[chosen] for name, column in m.extra.items()}
    first = np.concatenate(([0], np.cumsum(counts)))
    changed = replace(m, first=first, z=np.concatenate(z), R_unit=m.R_unit[chosen], extra=extra)
    return replace(drive, measurements={**drive.measurements, "lrf": changed})


@pytest.mark.parametrize(
    "settings",
    [{}, KNOWN, DRIFTING, FROZEN, REFINED, CONSIDERED, UNGUARDED, EXACT, NARROW, WHEELS],
    ids=[
        "estimated",
        "known",
        "drifting",
        "frozen",
        "refined",
        "considered",
        "unguarded",
        "exact",
        "narrow",
        "wheels",
    ],
)
@pytest.mark.parametrize("sensors", [(), ("compass",), ("compass", "lrf"), ("lrf",)])
def test_a_drive_in_stretches_is_the_drive_instant_by_instant(
    settings: Mapping[str, Any], sensors: tuple[str, ...]
) -> None:
    drive, robot = drive_of(settings)
    assert_same(fuse(drive, robot, sensors), instant_by_instant(drive, robot, sensors))


def test_a_scan_that_fits_is_left_to_the_core() -> None:
    """The loop takes the first scan, with which the map begins, and those of a robot at rest that count."""
    for settings in ({}, FROZEN, REFINED, CONSIDERED, WHEELS):
        drive, robot = drive_of(settings, seconds=20.0)
        assert len(advanced(drive, robot, ["compass", "lrf"])) <= 3
    still, robot = drive_of({}, speed=0.0, turning=0.0)
    when, taken = still.instant["lrf"], advanced(still, robot, ["lrf"])
    counting = when[[2**k - 1 for k in range(len(when).bit_length())]].tolist()
    assert {*counting} <= {*taken} | {*when[-1:].tolist()}
    assert len(taken) <= len(counting) + 3  # and those that show a line beside


def test_a_robot_at_rest_and_one_without_a_map_are_the_same_to_both() -> None:
    drive, robot = drive_of({}, speed=0.0, turning=0.0)
    assert_all_ways_agree(drive, robot, ["compass", "lrf"])
    clutter = with_lines(
        drive, lambda i, lines: lines[: len(lines) - i % 3 // 2]
    )  # now and then a line is missing
    assert_all_ways_agree(clutter, robot, ["lrf"])
    drive = with_lines(drive_of({})[0], lambda i, lines: lines[:0])
    assert_same(fuse(drive, robot, ["compass", "lrf"]), instant_by_instant(drive, robot, ["compass", "lrf"]))


def test_a_robot_that_is_carried_off_in_the_middle_is_lost_and_found_as_scan_by_scan() -> None:
    """Its walls stand elsewhere from the 40th scan to the 70th: the guard says lost, and goes back to the core."""
    drive, robot = drive_of({}, seconds=14.0)

    def elsewhere(i: int, lines: Array) -> Array:
        return np.abs(lines + AWAY) if 40 <= i < 70 else lines

    carried = with_lines(drive, elsewhere)
    for sensors in (["lrf"], ["compass", "lrf"]):
        run = fuse(carried, robot, sensors)
        assert run.lost
        assert VERDICTS.index("lost") in run.audits["lrf"].verdict
        assert_same(run, instant_by_instant(carried, robot, sensors))


def test_errors_that_the_lines_of_a_scan_share_and_uneven_walls_are_the_same_to_both() -> None:
    drive, robot = drive_of({})
    m = drive.measurements["lrf"]
    rng = np.random.default_rng(3)
    shared = (0.004 * rng.standard_normal((len(m.z), 2, 4))).astype(np.float32)
    uneven = np.broadcast_to(np.array([4e-5, 3e-5]), m.z.shape)
    more: list[dict[str, Any]] = [{"shared": shared}, {"uneven": uneven}, {"shared": shared, "uneven": uneven}]
    for extra in more:
        drive.measurements["lrf"] = replace(m, extra={**m.extra, **extra})
        for sensors in (["lrf"], ["compass", "lrf"]):
            assert_same(fuse(drive, robot, sensors), instant_by_instant(drive, robot, sensors))


def test_more_lines_than_a_table_holds_are_taken_table_by_table(monkeypatch: pytest.MonkeyPatch) -> None:
    drive, robot = drive_of({})
    whole = fuse(drive, robot, ["compass", "lrf"])
    monkeypatch.setattr("locfuse.fusion.coast.scans.BLOCK", 7)
    assert_same(fuse(drive, robot, ["compass", "lrf"]), whole)


LANDMARK = (6.5, 5.0)  # m; the robot starts at (1.5, 1.5)
SEEN = ["nothing", "it", "it and another", "two that may be it", "another", "no number"]


def with_pictures(drive: Drive, robot: Robot, kinds: Sequence[str], seed: int = 0) -> Drive:
    """Return the drive with a picture at every third instant, whose candidates are of these kinds in turn."""
    settings: Any = robot.settings("camera")
    rng, when = np.random.default_rng(seed), np.arange(2, len(drive.t), 3)
    x, y, theta = World().pose(drive.t[when]).T
    bearings = np.arctan2(LANDMARK[1] - y, LANDMARK[0] - x) - theta + rng.normal(0.0, math.radians(0.3), len(when))
    z: list[float] = []
    counts: list[int] = []
    for i, b in enumerate(bearings.tolist()):
        others = {"it and another": [b + 2.0, b], "two that may be it": [b, b + 0.004], "another": [b - 1.0]}
        shown = {"nothing": [], "it": [b], "no number": [math.nan], **others}[kinds[i % len(kinds)]]
        z += shown
        counts.append(len(shown))
    R_unit = rng.uniform(1.0, 1.2, (len(z), 1, 1))
    sigma = math.radians(settings.sigma_deg)
    first = np.concatenate(([0], np.cumsum(counts, dtype=np.int64)))
    m = Measurements(drive.t[when], first, np.array(z).reshape(-1, 1), R_unit, sigma, np.zeros((1, 1)))
    return replace(
        drive, measurements={**drive.measurements, "camera": m}, instant={**drive.instant, "camera": when}
    )


MOUNTED = {"x": 0.1, "y": -0.05, "yaw_deg": 1.0, "sigma_x": 0.02, "sigma_y": 0.02, "sigma_yaw_deg": 2.0}
INSIDE = {"landmark": (1.5, 1.5)}  # where the robot starts
CAMERAS = [{}, MOUNTED, INSIDE, {"gate": 0.5}, {"sigma_yaw_deg": 1.0}]


@hypothesis.settings(deadline=None, max_examples=40)
@hypothesis.given(
    st.lists(st.sampled_from(SEEN), min_size=1, max_size=8),
    st.sampled_from(CAMERAS),
    st.sampled_from([("camera",), ("compass", "camera"), ("lrf", "camera"), ("compass", "lrf", "camera")]),
    st.sampled_from(["grow", "first-scan"]),
)
def test_pictures_are_the_same_in_stretches_instant_by_instant_and_in_both_forms(
    kinds: list[str], camera: dict[str, Any], sensors: tuple[str, ...], mode: str
) -> None:
    drive, robot = drive_of({"camera": {"landmark": LANDMARK, **camera}, "lrf": {"map": mode}}, seconds=3.0)
    drive = with_pictures(drive, robot, kinds)
    assert_all_ways_agree(drive, robot, sensors)


def test_of_the_candidates_of_a_picture_one_is_the_landmark_and_the_core_takes_them_all() -> None:
    """The verdicts are those of the kinds of pictures; the loop takes the first scan alone."""
    drive, robot = drive_of({"camera": {"landmark": LANDMARK}}, seconds=6.0)
    drive = with_pictures(drive, robot, SEEN)
    audit = fuse(drive, robot, ["compass", "lrf", "camera"]).audits["camera"]
    verdicts, landmarks = [VERDICTS[v] for v in audit.verdict.tolist()], audit.landmark.tolist()
    once = ["accepted", "unmatched", "accepted", "ambiguous", "ambiguous", "gate", "gate"]  # one NaN is refused
    for i in range(0, len(verdicts) - 6, 7):
        assert verdicts[i : i + 7] == once
        assert landmarks[i : i + 3] == [0, -1, 0]
        assert sorted(landmarks[i + 3 : i + 5]) == [-1, 0]
    assert len(advanced(drive, robot, ["compass", "lrf", "camera"])) <= 3


def test_two_pictures_at_one_instant_share_one_prior() -> None:
    drive, robot = drive_of({"camera": {"landmark": LANDMARK}})
    drive = with_pictures(drive, robot, ["it"])
    when = drive.instant["camera"].copy()
    when[10] = when[9]
    drive.instant["camera"] = when
    assert_same(fuse(drive, robot, ["camera"]), instant_by_instant(drive, robot, ["camera"]))


@cache
def own_map(seconds: float, speed: float) -> tuple[MapLine, ...]:
    """Return the map that such a drive makes."""
    drive, robot = drive_of({}, seconds=seconds, speed=speed)
    return tuple(fuse(drive, robot, ["compass", "lrf"]).final_map)


def test_a_given_map_is_left_to_the_core_and_stays_as_it_is() -> None:
    drive, robot = drive_of({"lrf": {"map": "given"}}, seconds=20.0)
    robot = replace(robot, lines=own_map(20.0, 0.3))
    assert len(advanced(drive, robot, ["compass", "lrf"])) <= 2
    run = fuse(drive, robot, ["compass", "lrf"])
    assert run.audits["lrf"].verdict.tolist().count(0) > 500
    for line, given in zip(run.final_map, robot.lines, strict=True):
        np.testing.assert_allclose((line.rho, line.beta), (given.rho, given.beta), atol=1e-12)
    assert_same(run, instant_by_instant(drive, robot, ["compass", "lrf"]))


KINDS = st.sampled_from(["as seen", "none", "one line", "NaN", "elsewhere", "turned"])


@hypothesis.settings(deadline=None, max_examples=40)
@hypothesis.given(st.lists(KINDS, min_size=12, max_size=12), st.sampled_from(MODES), st.booleans())
def test_whatever_scans_show_all_ways_agree(kinds: list[str], mode: str, wheels: bool) -> None:
    """The core in stretches, the loop, and the core interpreted, whose arrays are the same to the bit."""
    drive, robot = drive_of({"lrf": {"map": mode}, "wheels": {"estimate": wheels}}, seconds=2.4, speed=0.6)
    if mode == "given":
        robot = replace(robot, lines=own_map(2.4, 0.6))

    def change(i: int, lines: Array) -> Array:
        kind = kinds[i // 2 % len(kinds)]
        shown = {"none": lines[:0], "one line": lines[:1], "elsewhere": lines + AWAY, "NaN": lines * np.nan}
        return np.asarray({**shown, "turned": lines + TURNED}.get(kind, lines))

    changed = with_lines(drive, change)
    assert_all_ways_agree(changed, robot, ["compass", "lrf"])


def with_map(drive: Drive, walls: int, seed: int) -> Drive:
    """Return the drive whose first scan shows so many walls: its own, then others anywhere around."""
    m = drive.measurements["lrf"]
    rng, own = np.random.default_rng(seed), int(m.first[1])
    more = max(walls - own, 0)
    other = np.column_stack((rng.uniform(0.5, 40.0, more), rng.uniform(-math.pi, math.pi, more)))
    ends = np.sort(rng.uniform(-3.0, 3.0, (more, 2)), axis=1)
    rows = np.concatenate((np.arange(min(own, walls)), np.resize(np.arange(own), more), np.arange(own, len(m.z))))
    z, extra = m.z[rows].copy(), {name: column[rows] for name, column in m.extra.items()}
    z[own : own + more], extra["ends"][own : own + more] = other, ends
    first = m.first + walls - own
    first[0] = 0
    changed = replace(m, first=first, z=z, R_unit=m.R_unit[rows], extra=extra)
    return replace(drive, measurements={**drive.measurements, "lrf": changed})


@hypothesis.settings(deadline=None, max_examples=12)
@hypothesis.given(st.sampled_from([0, 1, 2, 50, 2000]), st.integers(0, 2**32 - 1), st.booleans())
def test_maps_of_none_to_two_thousand_walls_are_the_same_to_both_forms(walls: int, seed: int, grows: bool) -> None:
    """Frozen with any number of walls, which are no states then; growing with few."""
    mode = "grow" if grows and walls <= 50 else "first-scan"
    drive, robot = drive_of({"lrf": {"map": mode}}, seconds=1.2, speed=0.6)
    changed = with_map(drive, walls, seed)
    run = assert_all_ways_agree(changed, robot, ["compass", "lrf"])
    assert len(run.first_map) == (walls or changed.measurements["lrf"].first[2])


def saw_of(walls: int, beams: int, world: World) -> tuple[Drive, Robot]:
    """Return the drive of a world whose scans are a saw of so many walls, all around."""
    streams, angles = world.streams(), np.linspace(-math.pi, math.pi, beams, endpoint=False)
    scans = streams["lrf"]
    n, depth = len(scans.t_ns), 2400.0 / walls  # m
    saw = 20.0 + depth * np.abs((angles * 0.5 * walls / math.tau) % 1.0 - 0.5)
    data: dict[str, Any] = dict(scans.data)
    data |= {"angle_min": np.full(n, angles[0]), "angle_increment": np.full(n, math.tau / beams)}
    data["ranges"] = Ragged(np.tile(saw, n), np.arange(n + 1) * beams)
    robot = world.robot()
    return measure({**streams, "lrf": replace(scans, data=data)}, robot), robot


@pytest.mark.parametrize("beams", [1, 2, 100_000])
def test_scans_of_one_beam_and_of_a_hundred_thousand_are_fused_alike_by_both_forms(beams: int) -> None:
    """Nothing to see, and a saw of 400 walls."""
    drive, robot = saw_of(400, beams, World(seconds=0.3, speed=0.6, settings={"lrf": {"map": "first-scan"}}))
    run = fuse(drive, robot, ["compass", "lrf"])
    assert len(run.first_map) == (400 if beams > 2 else 0)
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr("locfuse.fusion.core.room._here", lambda source: Room.of(source, None))
        assert_same_bits(run, fuse(drive, robot, ["compass", "lrf"]))


def test_scans_of_more_walls_than_a_room_has_are_counted_and_not_used() -> None:
    """A correction by thousands of walls would take gigabytes."""
    drive, robot = saw_of(600, 100_000, World(seconds=0.3, speed=0.6))
    m = drive.measurements["lrf"]
    assert (m.absent, m.dropped) == (3, {"too_many_lines": 3})
    assert REFUSALS["too_many_lines"] == "with more walls than can be true (over 500)"
    assert fuse(drive, robot, ["compass", "lrf"]).first_map == []


def test_a_heading_beyond_its_gate_and_one_in_a_disturbed_field_correct_nothing() -> None:
    drive, robot = drive_of(KNOWN)
    m = drive.measurements["compass"]
    z, strength = m.z.copy(), m.extra["strength"].copy()
    z[[20, 41]] += 2.0
    strength[[30, 41]] = 3.0
    drive.measurements["compass"] = replace(m, z=z, extra={**m.extra, "strength": strength})
    run = fuse(drive, robot, ["compass"])
    verdicts = run.audits["compass"].verdict
    assert [VERDICTS[v] for v in verdicts[[20, 30, 41]]] == ["gate", "disturbed", "disturbed"]
    assert (np.delete(verdicts, [20, 30, 41]) == 0).all()
    assert_same(run, instant_by_instant(drive, robot, ["compass"]))


def test_two_headings_at_one_instant_share_one_prior() -> None:
    drive, robot = drive_of({})
    when = drive.instant["compass"].copy()
    when[25] = when[24]
    drive.instant["compass"] = when
    assert_same(fuse(drive, robot, ["compass"]), instant_by_instant(drive, robot, ["compass"]))


def test_a_heading_at_the_very_instant_of_a_scan_is_taken_with_it() -> None:
    drive, robot = drive_of({}, seconds=3.0)
    when, scans = drive.instant["compass"].copy(), drive.instant["lrf"]
    nearest = np.searchsorted(when, scans).clip(0, len(when) - 1)
    when[nearest] = scans
    assert (np.diff(when) >= 0).all()
    drive.instant["compass"] = when
    assert_same(fuse(drive, robot, ["compass", "lrf"]), instant_by_instant(drive, robot, ["compass", "lrf"]))


def test_what_the_core_does_not_know_is_left_to_the_loop() -> None:
    """Refused readings that are kept with more noise, readings that only listen."""
    drive, robot = drive_of({"compass": {"outliers": "inflate"}})
    assert_same(fuse(drive, robot, ["compass"]), instant_by_instant(drive, robot, ["compass"]))
    drive, robot = drive_of({})
    every = {"compass": np.ones(len(drive.measurements["compass"].z), np.bool_)}
    heard = fuse(drive, robot, ["lrf"], listen=every)
    np.testing.assert_array_equal(heard.pose, fuse(drive, robot, ["lrf"]).pose)


@pytest.mark.skipif(form().functions is None, reason="the core is not compiled")
@pytest.mark.parametrize("settings", [DRIFTING, FROZEN, REFINED, CONSIDERED, WHEELS])
def test_both_forms_of_the_core_give_the_same_to_the_bit(
    monkeypatch: pytest.MonkeyPatch, settings: Mapping[str, Any]
) -> None:
    drive, robot = drive_of(settings)
    compiled = fuse(drive, robot, ["compass", "lrf"])
    monkeypatch.setattr("locfuse.fusion.core.room._here", lambda source: Room.of(source, None))
    assert_same_bits(compiled, fuse(drive, robot, ["compass", "lrf"]))


def test_a_variance_that_rounding_ate_is_one_line() -> None:
    drive, robot = drive_of(KNOWN)
    m = drive.measurements["compass"]
    drive.measurements["compass"] = replace(m, R_unit=np.full_like(m.R_unit, -1.0))
    with pytest.raises(LocfuseError, match="span too many powers of ten"):
        fuse(drive, robot, ["compass"])


def test_stretches_end_where_a_scan_is_due() -> None:
    drive, robot = drive_of({})
    run = Filter(robot, ["compass", "lrf"])
    on = Stretches(drive, run.models, run.belief)
    scans = drive.instant["lrf"].tolist()
    assert on.until(0) == scans[0]
    assert on.until(scans[0] + 1) == scans[1]
    assert on.until(scans[-1] + 1) == len(drive.t)
