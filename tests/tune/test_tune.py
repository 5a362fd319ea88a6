"""Noise by likelihood: the tape against the filter itself, and tuning against the noise that was drawn."""

import json
import math
import re
import tomllib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import small_drive
from bags import real_log
from commands import locfuse, ok, refused, reported
from msgspec.structs import replace
from scipy.stats import norm
from trap_logs import recorded
from traps import elsewhere

from locfuse.cli.analysis.load import find_log, load
from locfuse.cli.analysis.settings import LogOptions
from locfuse.cli.session.tune import lasting_errors, tune_logs
from locfuse.fusion.data import Drive
from locfuse.fusion.fuse import fuse
from locfuse.fusion.robot import Robot
from locfuse.fusion.tune.tape import NoiseFactors, play, record
from locfuse.fusion.tune.tune import Tuned, TuneLog, tune


def told(factor: float = 1.0, **compass: float) -> Robot:
    """A robot whose every standard deviation is told `factor` times too large."""
    true = small_drive.robot(
        {"sigma_deg": factor, **compass},
        {"sigma_range": 0.02 * factor, "sigma_angle_deg": 0.25 * factor, "map": "grow"},
    )
    return replace(true, wheels=type(true.wheels)(radius=0.05, track=0.6, noise=small_drive.NOISE * factor**2))


def drawn(seed: int, robot: Robot, laps: float = 1.0, sensors: tuple[str, ...] = ("compass", "lrf")) -> Drive:
    """A drive with true noise, measured under what the robot was told."""
    drive = small_drive.drive(seed, robot, sensors, laps, scans=1.0, headings=3.0)
    factor = robot.wheels.noise / small_drive.NOISE
    motions = replace(drive.motions, Q=factor * drive.motions.Q)
    measurements = dict(drive.measurements)
    if "lrf" in measurements:  # R_unit was made for the sigma that was told
        m, walls = measurements["lrf"], robot.settings("lrf").sigma_range
        measurements["lrf"] = replace(m, R_unit=m.R_unit * (walls / 0.02) ** 2)
    untrue = replace(drive, truth_motions=None, truth_instant=None, truth=None)
    return replace(untrue, motions=motions, measurements=measurements)


def innovations_likelihood(drive: Drive, robot: Robot) -> float:
    """ln of the likelihood by the filter's own audit: every heading's innovation and its variance."""
    audit = fuse(drive, robot, ["compass"]).audits["compass"]
    assert (audit.verdict == 0).all()
    return float(norm.logpdf(audit.y[:, 0], scale=audit.sigma[:, 0]).sum())


@pytest.mark.parametrize("offset", [{"offset_deg": 0.0}, {}])
def test_a_tape_played_as_recorded_says_what_the_filter_said(offset: dict[str, float]) -> None:
    robot = told(**offset)
    drive = drawn(1, robot, sensors=("compass",))
    played = play(record(drive, robot, ["compass"]), NoiseFactors(np.ones(1), np.ones((1, 1)), {}))
    assert played.scores.sum() == pytest.approx(innovations_likelihood(drive, robot), rel=1e-9)
    assert played.numbers.sum() == len(drive.measurements["compass"].t)


def test_a_tape_played_with_other_noise_says_what_the_filter_would_say_with_it() -> None:
    """Heading by a compass with a known offset is linear: replaying and filtering again must agree."""
    robot = told(offset_deg=0.0)
    drive = drawn(2, robot, sensors=("compass",))
    tape = record(drive, robot, ["compass"])
    for wheels, compass in ((4.0, 1.0), (1.0, 4.0), (0.3, 2.0)):
        noise = NoiseFactors(np.array([1.0, wheels]), np.array([[1.0], [compass]]), {})
        m = drive.measurements["compass"]
        louder = replace(drive.motions, Q=wheels * drive.motions.Q)
        seen = {"compass": replace(m, scale=math.sqrt(compass) * m.scale)}
        other = replace(drive, motions=louder, measurements=seen)
        scores = play(tape, noise).scores.sum(axis=1)
        assert scores[0] == pytest.approx(innovations_likelihood(drive, robot), rel=1e-9)
        assert scores[1] == pytest.approx(innovations_likelihood(other, robot), rel=1e-9)


def test_a_tape_with_a_map_says_nearly_what_the_filter_would_say_with_other_noise() -> None:
    """Only what is linearised differs; and lines, which the tape takes as unknown where they are born."""
    robot = told()
    drive = drawn(3, robot)
    tape = record(drive, robot, ["compass", "lrf"])
    louder = replace(drive, motions=replace(drive.motions, Q=2.0 * drive.motions.Q))
    as_told, more = play(tape, NoiseFactors(np.array([1.0, 2.0]), np.ones((2, 2)), {})).scores.sum(axis=1)
    factors = NoiseFactors(np.ones(1), np.ones((1, 2)), {})
    again = play(record(louder, robot, ["compass", "lrf"]), factors).scores.sum()
    assert more - as_told == pytest.approx(again - as_told, abs=0.2)
    assert abs(more - as_told) > 5.0


@pytest.fixture(scope="module")
def tuned() -> Callable[[float], Tuned]:
    """Tune two drives from figures `factor` times too large; the second is held out."""
    found: dict[float, Tuned] = {}

    def of(factor: float) -> Tuned:
        if factor not in found:
            robot = told(factor)
            both = ((5, math.inf), (6, -math.inf))
            trials = [TuneLog(f"drive {s}", drawn(s, robot), robot, until) for s, until in both]
            found[factor] = tune(trials, ["compass", "lrf"])
        return found[factor]

    return of


@pytest.mark.parametrize("factor", [0.1, 10.0])
def test_tuning_finds_the_noise_that_was_drawn(tuned: Callable[[float], Tuned], factor: float) -> None:
    found = tuned(factor)
    after = {row.key: row.after for row in found.rows}
    assert after["compass.sigma_deg"] == pytest.approx(1.0, rel=0.2)
    assert after["lrf.sigma_range"] == pytest.approx(0.02, rel=0.2)
    # of one drive: three standard errors of its logarithm
    wheels = next(row for row in found.rows if row.key == "wheels.noise")
    assert abs(math.log(wheels.after / small_drive.NOISE)) < 3.0 * wheels.error < 1.0
    assert all(row.identifiable for row in found.rows)


def test_tuning_arrives_at_the_same_noise_from_either_side(tuned: Callable[[float], Tuned]) -> None:
    for low, high in zip(tuned(0.1).rows, tuned(10.0).rows, strict=True):
        assert low.key == high.key
        assert low.after == pytest.approx(high.after, rel=0.05)


def test_a_straight_drive_says_that_rotation_noise_is_not_identifiable() -> None:
    robot = told()
    found = tune([TuneLog("straight", drawn(7, robot, laps=0.25), robot)], ["compass", "lrf"])
    assert any("rotation noise is not identifiable" in flag for flag in found.flags)
    both = tune([TuneLog("round", drawn(7, robot), robot)], ["compass", "lrf"])
    assert not any("rotation noise" in flag for flag in both.flags)


def test_noise_that_nothing_depends_on_is_left_as_it_was() -> None:
    """At rest the wheels say nothing of their noise."""
    robot = told(3.0)
    drive = drawn(8, robot, laps=0.25)
    motions = replace(drive.motions, u=0.0 * drive.motions.u, Q=0.0 * drive.motions.Q)
    m = drive.measurements["compass"]
    compass = replace(m, z=np.radians(np.random.default_rng(9).normal(size=m.z.shape)))
    still = replace(drive, motions=motions, measurements={"compass": compass})
    found = tune([TuneLog("rest", still, robot)], ["compass"])
    wheels, sigma = found.rows
    assert not wheels.identifiable
    assert wheels.after == wheels.before == pytest.approx(9.0 * small_drive.NOISE)
    assert sigma.after == pytest.approx(1.0, rel=0.3)
    assert any("wheels.noise is not identifiable" in flag for flag in found.flags)


def test_the_command_writes_a_robot_that_the_next_command_takes(tmp_path: Path) -> None:
    out = tmp_path / "tuned.toml"
    start = ("--set", "compass.sigma_deg=30")
    done = ok("tune", "rounded_rectangle", "--sensors", "compass", *start, "-o", out, "--json", "-q")
    report = json.loads(done.stdout)
    sigma = report["noise"]["compass.sigma_deg"]
    assert sigma["before"] == 30.0
    assert 0.4 < sigma["low"] < sigma["after"] < sigma["high"] < 2.0  # white 0.5, iron 1 degree
    likelihood = report["ln_likelihood_per_number"]["held_out"]
    assert likelihood["after"] > likelihood["before"]
    assert tomllib.loads(out.read_text())["compass"]["sigma_deg"] == pytest.approx(sigma["after"], rel=1e-3)
    ok("run", "rounded_rectangle", "--to", 5, "--no-advice", "--robot", out, "-o", tmp_path / "run")
    assert "--overwrite" in refused("tune", "rounded_rectangle", "-o", out, code=2)


def test_errors_that_last_are_named_because_no_sigma_describes_them() -> None:
    loaded = load(find_log(["rounded_rectangle"]), LogOptions(quiet=True), only=("compass", "lrf"))
    trial = TuneLog("drive", loaded.drive, loaded.robot)
    found = lasting_errors([trial])
    assert list(found) == [("drive", "compass")]  # iron
    assert found["drive", "compass"].startswith("errors of")
    alone = replace(loaded.drive, measurements={"lrf": loaded.drive.measurements["lrf"]})
    assert lasting_errors([trial._replace(drive=alone)]) == {}


def test_a_sensor_whose_errors_last_does_not_spoil_the_noise_of_the_others() -> None:
    """With the compass's white noise alone, all sensors would have three times the error."""
    how = LogOptions(quiet=True, end=20.0)
    found = tune_logs([find_log(["rounded_rectangle"])], [], ("compass", "lrf"), False, how, lambda what: None)
    assert not found.refused
    assert set(found.tables()) == {"wheels", "lrf"}
    assert found.tables()["lrf"]["sigma_range"] == pytest.approx(0.03, rel=0.1)
    assert any("compass: errors of" in note and "left as it was" in note for note in found.notes)


def test_a_log_is_judged_as_run_would_fuse_it_whatever_the_likelihood_needs(tmp_path: Path) -> None:
    """Two centimetres of a wall's ranges set to ten: lines are cut elsewhere, and that is part of the error."""
    log = tmp_path / "short.mcap"
    locfuse("simulate", "rounded_rectangle", "-o", log, "--set", "path.laps=0.1", "--set", "camera.enabled=false")
    start = ("--set", "lrf.sigma_range=0.1", "--sensors", "compass,lrf")
    done = locfuse("tune", log, *start, "-o", tmp_path / "tuned.toml", "--json", "-q")
    (judged,) = json.loads(done.stdout)["logs"]
    errors = {}
    for when, words in (("before", start[:2]), ("after", ("--robot", tmp_path / "tuned.toml"))):
        (ran_as,) = reported("run", log, "--no-advice", "--no-smooth", *words, *start[2:]).rows.values()
        errors[when] = ran_as["position_rmse_m"]
    assert judged["before"]["position_rmse_m"] == pytest.approx(errors["before"], rel=1e-4)
    assert judged["after"]["position_rmse_m"] == pytest.approx(errors["after"], rel=1e-4)


def test_a_log_that_starts_elsewhere_is_judged_by_the_shape_of_its_path(tmp_path: Path) -> None:
    done = locfuse("tune", recorded(tmp_path, elsewhere), "--sensors", "compass", "-q")
    (line,) = (line for line in done.stdout.splitlines() if "position error of the path's shape, log" in line)
    metres = [float(word) for word in re.findall(r"(\d+\.\d+) m\b", line)]
    assert metres
    assert max(metres) < 1.0  # the truth starts 3.26 m away


def test_a_log_whose_laser_is_late_is_not_tuned_and_the_fix_is_named(tmp_path: Path) -> None:
    """A real arena: no noise makes up for a clock, and found noise would hide it."""
    out, words = tmp_path / "tuned.toml", [str(real_log("brenner/brenner.mcap"))]
    for setting in ("wheels.radius=0.0199962", "wheels.track=0.155", "lrf.range_scale=1.118"):
        words += ["--set", setting]
    refusal = refused("tune", *words, "-o", out)
    assert not out.exists()
    assert "noise found now would cover that up. Set it first: --set " in refusal
