"""Whose clock is off: sensors that see how the robot turned tell a lag better than wheels that slip."""

import math
from itertools import accumulate, combinations
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from msgspec.structs import replace
from present import present
from rows import readings

from locfuse.fusion import se2
from locfuse.fusion.checks import clocks
from locfuse.fusion.checks.lag import MAX_LAG_S, Lag, by_wheels, find_lag
from locfuse.fusion.data import Array, Drive, Estimates, Measurements, Motions, Truth
from locfuse.fusion.robot import Robot, StartSettings
from locfuse.fusion.sensors.registry import REGISTRY
from locfuse.fusion.wheels.calibrate import truth_sigma
from locfuse.fusion.wheels.motion import Wheels

T = np.arange(0.0, 90.0, 0.02)
SEEDS = range(12)


def turned(seed: int) -> tuple[Wheels, Array]:
    """Wheels of a robot with corners, and how it truly turned (n,) [rad]: they slip as the paper's do."""
    rng = np.random.default_rng(seed)
    rate = np.convolve(np.where(T % 12.0 < 3.0, 0.5, 0.0), np.ones(15) / 15.0, "same")  # rad/s
    by_wheels = np.cumsum(0.02 * rate)
    true = by_wheels + np.cumsum(rng.normal(0.0, np.sqrt(6.7e-4 * 0.02), len(T)))
    twist = np.zeros((len(T) - 1, 3))
    twist[:, 2] = np.diff(by_wheels)
    return Wheels.from_twists(T, twist, 0.6, 4e-4), true


def headings(true: Array, seed: int, rate: float, sigma_deg: float, late: float = 0.0) -> Measurements:
    """A sensor that sees the heading, dated `late` [s]."""
    t = np.arange(1.0, 89.0, 1.0 / rate)
    sigma = np.radians(sigma_deg)
    z = np.interp(t, T, true) + np.random.default_rng(900 + seed).normal(0.0, sigma, len(t))
    return readings(t + late, z[:, None], sigma)


def drive_of(wheels: Wheels, **seen: Measurements) -> Drive:
    """A drive of which only the sensors' turning and the wheels are asked."""
    t = np.arange(1.0, 89.0, 0.1)
    motions = Motions(np.zeros((len(t), 3)), np.zeros((len(t), 3, 3)), np.zeros((len(t), 6)))
    return Drive(0, t, motions, seen, {}, {}, wheels=wheels)


def test_a_late_clock_is_measured_by_the_sensor_that_sees_the_same_turning() -> None:
    errors, alone = [], []
    for seed in SEEDS:
        wheels, true = turned(seed)
        late, compass = headings(true, seed, 10.0, 0.05, late=0.12), headings(true, seed + 50, 20.0, 0.5)
        lags = clocks.differences(drive_of(wheels, compass=compass, gyro=late), Robot())
        ((clock,),) = clocks.wrong_clocks(lags, 4.0)
        assert (clock.name, set(clock.against)) == ("gyro", {"compass", "wheels"})
        errors.append(clock.offset + 0.12)
        alone.append(clocks.clock_lags({"gyro": late}, wheels)["gyro"].offset + 0.12)
    assert np.abs(errors).max() < 0.01
    assert np.std(alone) > 1.5 * np.std(errors)


def pairs(sigma: float = 0.004, **late: float) -> dict[tuple[str, str], Lag]:
    """What comparing every two clocks gives where some are late [s]."""
    return {(a, b): Lag(late[b] - late[a], 0.999, 0.99, sigma) for a, b in combinations(late, 2)}


@pytest.mark.parametrize(
    ("late", "off"),
    [
        ({"truth": 0.05, "compass": 0.0, "lrf": 0.0, "wheels": 0.0}, {"truth": -0.05}),
        ({"truth": 0.05, "lrf": 0.0, "wheels": 0.0}, {"truth": -0.05}),
        ({"truth": 0.0, "compass": 0.0, "lrf": 0.05, "wheels": 0.0}, {"lrf": -0.05}),
        ({"truth": 0.0, "compass": 0.0, "lrf": 0.0, "wheels": 0.05}, {"wheels": -0.05}),
        ({"compass": 0.05, "lrf": 0.05, "wheels": 0.0}, {"wheels": 0.05}),
        ({"compass": 0.2, "lrf": 0.2, "truth": 0.0, "wheels": 0.0}, {"compass": -0.2, "lrf": -0.2}),
        ({"truth": 0.4, "gyro": -0.18, "wheels": 0.0}, {"truth": -0.4, "gyro": 0.18}),
        ({"compass": 0.05, "wheels": 0.0}, {"compass": -0.05}),
        ({"compass": 0.0, "wheels": 0.05}, {"wheels": -0.05}),  # of two clocks, the late one
        ({"compass": 0.0, "lrf": 0.0, "wheels": 0.0}, {}),
        ({"compass": 0.008, "lrf": 0.0, "wheels": 0.0}, {}),  # two sigma are chance
    ],
)
def test_the_clock_that_the_others_outvote_is_off(late: dict[str, float], off: dict[str, float]) -> None:
    first = next(iter(clocks.wrong_clocks(pairs(**late), 4.0)), ())
    assert {clock.name: clock.offset for clock in first} == pytest.approx(off)


def test_of_two_clocks_either_may_be_off_and_the_sensor_is_named_first() -> None:
    found = clocks.wrong_clocks(pairs(lrf=0.1, wheels=0.0), 4.0)
    assert [[(c.name, round(c.offset, 3)) for c in one] for one in found] == [[("lrf", -0.1)], [("wheels", 0.1)]]
    ((clock,),) = clocks.wrong_clocks(pairs(lrf=0.05, compass=0.0, wheels=0.0), 4.0)
    assert (
        clocks.clock_words(clock)
        == "stamps look 0.050 s late (1 sigma: 0.003 s) against the compass and the wheels"
    )


def test_slips_move_all_lags_alike_so_that_three_are_no_surer_than_one() -> None:
    """A mean of three independent lags of three sigma would be 5.2 sigma; one ground moved them all."""
    late = {(name, "wheels"): Lag(-0.012, 0.999, 0.99, 0.004) for name in ("compass", "lrf", "gyro")}
    assert not clocks.wrong_clocks(late, 4.0)
    later = {pair: lag._replace(offset=-0.03) for pair, lag in late.items()}
    ((clock,), *_) = clocks.wrong_clocks(later, 4.0)
    assert clock.name == "wheels"
    assert [clock.offset, clock.sigma] == pytest.approx([0.03, 0.004])


@pytest.mark.parametrize("late", [0.0, 0.02])
def test_the_sigma_of_a_lag_is_as_large_as_its_error(late: float) -> None:
    """Over seeds the error in sigmas has a mean square of about 1."""
    errors = []
    for seed in SEEDS:
        wheels, true = turned(seed)
        lag = clocks.clock_lags({"gyro": headings(true, seed, 10.0, 0.05, late)}, wheels)["gyro"]
        errors.append((lag.offset + late) / lag.sigma)
    assert 0.3 < np.mean(np.square(errors)) < 2.5


def test_slips_that_last_for_a_second_make_the_sigma_of_a_lag_larger() -> None:
    """Turning rates are wrong by 0.1 rad/s for about a second: windows that overlap less share this error."""
    errors, kept = [], math.exp(-0.02)
    for seed in range(60):
        wheels, true = turned(seed)
        slips = np.random.default_rng(seed + 500).normal(0.0, 0.1 * math.sqrt(1.0 - kept**2), len(T) - 1)
        rate = np.array([*accumulate(slips, lambda before, now: kept * before + now)])
        twist = wheels.twist + 0.02 * np.where(wheels.twist[:, 2:] > 2e-5, [[0.0, 0.0, 1.0]], 0.0) * rate[:, None]
        lags = clocks.clock_lags(
            {"gyro": headings(true, seed, 10.0, 0.05)}, Wheels.from_twists(T, twist, 0.6, 4e-4)
        )
        errors += [lag.offset / lag.sigma for lag in lags.values()]
    assert np.mean(np.square(errors)) < 1.8


def test_a_run_that_is_less_exact_than_the_scans_does_not_judge_the_laser(monkeypatch: pytest.MonkeyPatch) -> None:
    """The headings of the run are 0.03 s late and noisy; those of the scans are right."""
    wheels, true = turned(0)
    t, noise = np.arange(1.0, 89.0, 0.1), np.random.default_rng(1).normal(0.0, np.radians(0.5), len(T))
    turns = dict.fromkeys(("lrf", "gyro"), (t, np.interp(t, T, true)))
    monkeypatch.setattr(clocks, "headings", lambda _: turns)
    pose = np.column_stack((0.0 * T, 0.0 * T, np.interp(T - 0.03, T, true) + noise))
    run = cast("Any", SimpleNamespace(sensors=("lrf",), smoothed=False, lost=(), t=T, pose=pose))
    lag = clocks.differences(drive_of(wheels), Robot(), [run])["gyro", "lrf"]
    assert abs(lag.offset) < 0.003
    assert lag.sigma < 0.005


def test_a_clock_that_only_a_run_of_the_laser_can_judge_gets_no_fix() -> None:
    wheels, true = turned(0)
    truth = Truth("/truth", T + 0.3, np.zeros((len(T), 2)), se2.wrap_all(true))
    alone = replace(drive_of(wheels), truth=truth)
    beside = replace(drive_of(wheels, lrf=readings(T[:3], np.zeros((3, 2)), 0.01)), truth=truth)
    robot = replace(Robot(), sensors={"lrf": REGISTRY["lrf"].Settings()})
    (found,), (open_,) = clocks.of_clocks(alone, robot), clocks.of_clocks(beside, robot)
    assert (found.role, found.severe, open_.role, open_.severe) == ("truth", True, "truth", True)
    assert float(found.fixes[0].removeprefix("truth.time_offset=")) == pytest.approx(-0.3, abs=0.03)
    assert open_.fixes == ()
    assert open_.message.endswith("To find out which: locfuse compare")


def a_run(wheels: Wheels, true: Array, seed: int, late: float) -> tuple[Drive, Truth, Estimates]:
    """A laser's run at 10 Hz whose heading is that of `late` [s] before, with errors of 0.1 degrees."""
    t = np.arange(1.0, 89.0, 0.1)
    errors = np.random.default_rng(700 + seed).normal(0.0, np.radians(0.1), len(t))
    pose = np.zeros((len(t), 3))
    pose[:, 2] = np.interp(t - late, T, true) + errors
    none = np.zeros((len(t), 6))
    motions = Motions(pose, np.zeros((len(t), 3, 3)), none)
    drive = Drive(0, t, motions, {}, {"lrf": np.arange(len(t))}, {}, wheels=wheels)
    truth = Truth("/truth", T, np.zeros((len(T), 2)), se2.wrap_all(true))
    return drive, truth, Estimates("lrf", ("lrf",), t, pose, none, {})


@pytest.mark.parametrize("late", [0.0, 0.02])
def test_a_run_whose_map_holds_the_heading_tells_its_clock_by_the_truth(late: float) -> None:
    """As far off as its sigma says, and within 1.5 ms."""
    errors, sigmas = [], []
    for seed in SEEDS:
        drive, truth, run = a_run(*turned(seed), seed, late)
        lag = present(clocks.lag_of_run(drive, truth, run))
        errors.append(lag.offset + late)
        sigmas.append(lag.sigma)
    assert np.abs(errors).max() < 0.0015
    assert max(sigmas) < 0.001
    assert clocks.lag_of_run(drive, None, run) is None
    assert clocks.lag_of_run(drive, replace(truth, theta=None), run) is None
    assert 0.2 < np.mean(np.square(np.array(errors) / sigmas)) < 2.5


@pytest.mark.parametrize("iron_deg", [0.0, 1.0])
def test_a_compass_tells_its_clock_beside_the_truth_far_better_than_beside_wheels(iron_deg: float) -> None:
    """Bound: noise / (rms of the rate * sqrt(readings)), 2.7 ms here; iron adds a heading's own error to it."""
    errors, sigmas, beside_wheels = [], [], []
    for seed in SEEDS:
        wheels, true = turned(seed)
        compass = headings(true, seed, 10.0, 1.0, late=0.03)
        iron = np.radians(iron_deg) * np.sin(np.interp(compass.t - 0.03, T, true) + seed)
        compass = replace(compass, z=compass.z + iron[:, None])
        drive = replace(a_run(wheels, true, seed, 0.0)[0], measurements={"compass": compass})
        truth = Truth("/truth", T, np.zeros((len(T), 2)), se2.wrap_all(true))
        lag = clocks.lags_by_truth(drive, truth)["compass"]
        errors.append(lag.offset + 0.03)
        sigmas.append(lag.sigma)
        beside_wheels.append(clocks.clock_lags(drive.measurements, wheels)["compass"].sigma)
    assert np.abs(errors).max() < 0.008
    assert 4.0 * max(sigmas) < min(beside_wheels)
    assert 0.3 < np.mean(np.square(np.array(errors) / sigmas)) < 2.5


@pytest.mark.parametrize("offset", [0.2, -0.2])
def test_another_clock_of_wheels_does_not_turn_the_path_of_a_robot_that_moves_at_the_start(offset: float) -> None:
    twist = np.tile([0.5 * 0.02, 0.0, 0.8 * 0.02], (len(T) - 1, 1))  # m, rad: a circle from the start on
    robot = replace(Robot(), start=StartSettings(x=1.0, y=2.0, theta_deg=90.0), start_given=True)
    kept = clocks.start_kept(offset, drive_of(Wheels.from_twists(T, twist, 0.6, 4e-4)), robot)
    fixes = dict(fix.split("=") for fix in kept)
    turn, r = 0.8 * offset, 0.5 / 0.8  # rad; m, of the circle about (1 - r, 2)
    assert float(fixes["start.theta_deg"]) == pytest.approx(90.0 + np.degrees(turn), abs=0.1)
    assert float(fixes["start.x"]) == pytest.approx(1.0 - r + r * np.cos(turn), abs=0.002)
    assert float(fixes["start.y"]) == pytest.approx(2.0 + r * np.sin(turn), abs=0.002)


def test_the_start_stays_where_the_robot_stands_or_nothing_says_where_the_path_lies() -> None:
    given = replace(Robot(), start_given=True)
    twist = np.zeros((len(T) - 1, 3))
    twist[50:, 2] = 0.01
    stands, turns = Wheels.from_twists(T, twist, 0.6, 4e-4), Wheels.from_twists(T[50:], twist[50:], 0.6, 4e-4)
    assert clocks.start_kept(0.2, drive_of(stands), given) == ()
    assert clocks.start_kept(0.2, drive_of(turns), given) != ()
    assert clocks.start_kept(0.2, drive_of(turns), Robot()) == ()
    assert clocks.start_kept(0.2, drive_of(turns), replace(given, start=StartSettings(at=3.0))) == ()


# --- a sensor's clock against the wheels': the lag that was put in is found, by wheels that slip too

STAMPS = np.arange(0.0, 120.0, 0.02)
TURNED = np.cumsum(0.02 * np.sin(0.9 * STAMPS) * np.cos(0.13 * STAMPS))  # rad


def wheels(turned: Array = TURNED) -> Wheels:
    twist = np.zeros((len(STAMPS) - 1, 3))
    twist[:, 2] = np.diff(turned)
    return Wheels.from_twists(STAMPS, twist, 0.3, 1e-4)


@pytest.mark.parametrize("lag", [-1.32, -0.13, -0.004, 0.0, 0.0371, 0.9])
def test_the_lag_that_was_put_in_is_found(lag: float) -> None:
    rng = np.random.default_rng(0)
    t = np.arange(3.0, 117.0, 0.1)
    heading = np.interp(t + lag, STAMPS, TURNED) + rng.normal(0.0, 0.002, len(t)) + 0.7
    found = present(find_lag(t, heading, by_wheels(wheels())))
    assert found.offset == pytest.approx(lag, abs=0.005)
    assert found.correlation > 0.999
    assert found.without <= found.correlation + 1e-6


def test_a_lag_beyond_the_longest_a_drive_that_hardly_turns_and_rare_readings_tell_none() -> None:
    t = np.arange(4.0, 115.0, 0.1)
    assert find_lag(t, np.interp(t + MAX_LAG_S + 0.3, STAMPS, TURNED), by_wheels(wheels())) is None
    t = np.arange(3.0, 117.0, 0.1)
    assert find_lag(t, np.interp(t, STAMPS, 0.001 * TURNED), by_wheels(wheels())) is None
    t = np.arange(3.0, 117.0, 2.5)
    heading = np.interp(t, STAMPS, TURNED) + np.random.default_rng(0).normal(0.0, 0.3, len(t))
    assert find_lag(t, heading, by_wheels(wheels())) is None


def steered(seed: int, gain: float) -> tuple[Array, Array]:
    """Headings by the wheels and in truth of a robot with corners every 7 s, which turns its slips back."""
    rng = np.random.default_rng(seed)
    corner = np.where(STAMPS % 7.0 < 3.0, 0.5, 0.0) * np.sign(np.sin(0.3 * STAMPS))  # rad/s
    slips = rng.normal(0.0, np.sqrt(6.7e-4 * 0.02), len(STAMPS))  # rad, white: the paper's robot at 0.3 m/s
    rate, off, turned = 0.0, 0.0, np.zeros(len(STAMPS))
    for i in range(1, len(STAMPS)):
        rate += 0.02 / 0.12 * (corner[i] - gain * off - rate)
        off += 0.02 * (rate - corner[i]) + slips[i]
        turned[i] = turned[i - 1] + 0.02 * rate
    return turned, turned + np.cumsum(slips)


@pytest.mark.parametrize("gain", [0.0, 0.75])
def test_wheels_that_slip_tell_the_lag_whoever_steers(gain: float) -> None:
    t = np.arange(3.0, 117.0, 0.1)
    offsets = []
    for seed in range(40):
        rolled, true = steered(seed, gain)
        lag = present(find_lag(t, np.interp(t, STAMPS, true), by_wheels(wheels(rolled))))
        offsets.append(lag.offset)
    assert abs(np.mean(offsets)) < 0.0025
    assert np.std(offsets) < 0.0065


def test_readings_from_either_side_of_a_gap_are_not_compared() -> None:
    t = np.concatenate((np.arange(3.0, 50.0, 0.1), np.arange(70.0, 117.0, 0.1)))
    heading = np.interp(t - 0.2, STAMPS, TURNED) + np.where(t > 60.0, 2.0, 0.0)
    found = present(find_lag(t, heading, by_wheels(wheels())))
    assert found.offset == pytest.approx(-0.2, abs=0.002)


def test_stamps_that_scatter_about_an_even_period_are_named_with_their_sigma() -> None:
    rng = np.random.default_rng(1)
    even = 0.1 * np.arange(600.0)
    (found,) = clocks.of_uneven_stamps("lrf", np.sort(even + rng.normal(0.0, 0.03, 600)))
    assert found.role == "lrf"
    assert not found.fixes
    sigma = float(found.message.split(" s ")[0].removeprefix("stamps scatter by "))
    assert sigma == pytest.approx(0.03, abs=0.003)
    varying = np.cumsum(rng.normal(0.1, 0.03, 600).clip(0.01))
    dropped = even[rng.random(600) > 0.2]
    alternating = even[np.arange(600) % 3 > 0][:399]  # every third one is not recorded
    slight = even + rng.normal(0.0, 0.005, 600)
    for t in (even, varying, dropped, alternating, slight, even[:20]):
        assert not any(clocks.of_uneven_stamps("lrf", t))


@pytest.mark.parametrize(("stops", "known"), [(range(5, 80, 8), True), ([35], False)], ids=["often", "once"])
def test_a_lag_by_speeds_is_known_only_if_every_part_of_the_drive_shows_it(stops: list[int], known: bool) -> None:
    """A truth of points, 0.2 s late, of a robot that stops for 2 s; its speed is else noise to either."""
    t = np.arange(0.0, 80.0, 0.1)
    speed = np.where(np.any([(t > stop) & (t < stop + 2.0) for stop in stops], axis=0), 0.0, 0.3)
    ours, theirs = np.random.default_rng(3).normal(0.0, 0.03, (2, len(t)))
    wheels = Wheels.from_twists(t, 0.1 * np.outer((speed + ours)[1:], [1.0, 0.0, 0.0]), 0.5, 0.0)
    xy = np.outer(0.1 * np.cumsum(np.interp(t - 0.2, t, speed) + theirs), [1.0, 0.0])
    drive = cast("Drive", SimpleNamespace(wheels=wheels))
    found = present(clocks.way_lag(Truth("/truth", t, xy, None), drive))
    assert found.offset == pytest.approx(-0.2, abs=0.05)
    assert (found.spread < 0.05) == known


def test_a_late_truth_that_moves_while_the_wheels_stand_is_not_noisy() -> None:
    """Stop and go, 4 s each: a truth that is 1 s late moves in the first second of every stop."""
    twist = np.zeros((len(T) - 1, 3))
    twist[:, 0] = np.where(T[1:] % 8.0 < 4.0, 0.02 * 0.3, 0.0)
    wheels, late = Wheels.from_twists(T, twist, 0.6, 4e-4), T[50::5]
    x = np.interp(late - 1.0, T[1:], np.cumsum(twist[:, 0]))
    x += np.random.default_rng(1).normal(0.0, 0.001, len(late))
    truth = Truth("/truth", late, np.stack((x, np.zeros(len(x))), axis=-1), None)
    assert truth_sigma(truth, wheels).xy < 0.002


@pytest.mark.parametrize("late", [-31.0, 2.0, 20.0])
@pytest.mark.parametrize("headings", [True, False])
def test_a_truth_on_its_own_clock_is_found_if_the_drive_never_repeats_itself(late: float, headings: bool) -> None:
    rng = np.random.default_rng(4)
    twist = 0.02 * np.repeat(np.abs(rng.normal(0.0, 0.3, (59, 3))), 75, axis=0)
    twist[:, 1] = 0.0
    t = T[: len(twist) + 1]
    wheels = Wheels.from_twists(t, twist, 0.6, 4e-4)
    truth = Truth("/truth", t[::5] + late, wheels.pose[::5, :2], wheels.pose[::5, 2] if headings else None)
    assert present(clocks.far_lag(truth.t, truth.xy, truth.theta, wheels)).offset == pytest.approx(-late, abs=0.1)
    again, true = turned(0)  # it repeats itself
    assert clocks.far_lag(T + 20.0, again.pose[:, :2], se2.wrap_all(true), again) is None
