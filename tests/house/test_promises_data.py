"""The promise about bad data, failure by failure: failing sensors, lying wheels, robots that are carried off."""

from __future__ import annotations

import functools
import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bags import T0, Said, cdr, header, write
from commands import Done, locfuse, ok
from mcap.reader import make_reader
from msgspec.structs import replace
from numpy.typing import NDArray
from wheel_bags import GEOMETRY, angles, joint_states, log_of
from worlds import World

from locfuse.cli.analysis.load import load
from locfuse.cli.analysis.settings import LogOptions
from locfuse.fusion.fuse import fuse
from locfuse.fusion.judge.evaluate import evaluate
from locfuse.fusion.measure import measure

Array = NDArray[np.float64]
PLAIN = LogOptions(None, (), None, strict=False, quiet=True)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("simulated")


@functools.cache
def simulated(folder: Path, fault: str = "", scenario: str = "rounded_rectangle") -> Path:
    """A drive of a minute with compass and laser, and one fault."""
    path = folder / f"{len(list(folder.iterdir()))}.mcap"
    sets = ["--set", "camera.enabled=false", *(("--set", f"faults=[{{{fault}}}]") if fault else ())]
    ok("simulate", scenario, "-o", path, *sets)
    return path


def run(path: Path, *words: str) -> tuple[Done, Array, dict[str, Any]]:
    """Run and hold every row to: finite, P positive, time never backward."""
    out = path.parent / f"{path.stem}-out"
    done = locfuse("run", path, "--no-advice", "--no-smooth", "--write", "all", "-v", "-o", out, *words)
    assert done.exit_code in {0, 3}, done.stderr
    rows = np.loadtxt(out / "trajectory.csv", delimiter=",", skiprows=1)
    P = rows[:, [4, 5, 6, 5, 7, 8, 6, 8, 9]].reshape(-1, 3, 3)
    assert np.isfinite(rows).all()
    assert (np.linalg.eigvalsh(P) >= -1e-12).all()
    assert (np.diff(rows[:, 0]) >= 0).all()
    return done, rows, json.loads((out / "run.json").read_text())


def without(path: Path, copy: Path, topic: str, start: float, end: float) -> Path:
    """The log without the messages of a topic in an interval [s]."""
    with path.open("rb") as file:
        reader = make_reader(file)
        every = [(s, c, m) for s, c, m in reader.iter_messages() if s is not None]
        attachments = {a.name: a.data for a in reader.iter_attachments()}
    begin = every[0][2].log_time
    said = [
        Said(c.topic, s.name, m.data, m.log_time, m.sequence)
        for s, c, m in every
        if c.topic != topic or not start <= (m.log_time - begin) * 1e-9 < end
    ]
    return write(copy, said, attachments=attachments)


@pytest.mark.parametrize(
    ("name", "start", "end"), [("drops out", 15.0, 25.0), ("starts late", -1.0, 8.0), ("ends early", 40.0, 99.0)]
)
def test_a_sensor_that_drops_out_starts_late_or_ends_early_is_as_if_masked_there(
    folder: Path, name: str, start: float, end: float
) -> None:
    clean = simulated(folder)
    cut = without(clean, folder / f"{name}.mcap", "/scan", start, end)
    whole, gap = load([clean], PLAIN), load([cut], PLAIN)
    scans = whole.drive.measurements["lrf"]
    keep = np.flatnonzero(np.isin(scans.t.round(6), gap.drive.measurements["lrf"].t.round(6)))
    assert len(scans.t) - len(keep) > 70
    masked = replace(
        whole.drive,
        measurements={**whole.drive.measurements, "lrf": scans.take(keep)},
        instant={**whole.drive.instant, "lrf": whole.drive.instant["lrf"][keep]},
    )
    a, b = fuse(gap.drive, gap.robot, ["lrf"]), fuse(masked, gap.robot, ["lrf"])
    np.testing.assert_allclose(a.pose, b.pose[np.isin(b.t, a.t)], atol=1e-6)
    silent = (a.t > start + 0.2) & (a.t < end)
    assert (np.diff(a.P[silent, 2, 2]) >= 0.0).all()  # nothing is seen: P grows
    if name == "drops out":
        assert re.search("lrf: a gap of 10.1 s", locfuse("info", cut).stdout)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_nan_or_inf_anywhere_is_skipped_and_counted(folder: Path, value: float) -> None:
    t, angle = angles(10.0)
    said = list(joint_states(t, angle))
    bad = np.full(2, value)
    for i, ns in enumerate(range(T0, T0 + 10 * 10**9, 2 * 10**8)):
        odd = i % 5 == 2
        v = value if odd else 0.02 * i  # of the heading, the truth's x and some ranges
        ranges = np.linspace(1.0, 2.0, 90)
        ranges[10:20] = v
        said += [
            *[Said("/joint_states", "sensor_msgs/msg/JointState", joint(ns + 10**6, bad), ns + 10**6)][: int(odd)],
            Said("/scan", "sensor_msgs/msg/LaserScan", cdr(
                "sensor_msgs/msg/LaserScan", header=header(ns, "laser"), angle_min=-1.5,
                angle_increment=v if i == 12 else 0.03, range_max=30.0, ranges=ranges.astype(np.float32)), ns),
            Said("/heading", "std_msgs/msg/Float64", cdr("std_msgs/msg/Float64", data=v), ns),
            Said("/ground_truth", "geometry_msgs/msg/PoseStamped", cdr(
                "geometry_msgs/msg/PoseStamped", header=header(ns),
                pose={"position": {"x": v}, "orientation": {"w": 1.0}}), ns),
        ]  # fmt: skip
    path = log_of(folder / "nan.mcap", said)
    with np.errstate(all="ignore"):  # as the program does for its user
        _, _, report = run(path, *GEOMETRY)
    dropped = report["input"]["dropped"]
    for stream in ("wheels", "compass", "truth"):
        assert sum(dropped.get(stream, {}).values()) >= 5, (stream, dropped)


def joint(ns: int, position: Array) -> bytes:
    names = ["left_wheel", "right_wheel"]
    return cdr("sensor_msgs/msg/JointState", header=header(ns), name=names, position=position)


def test_kidnapping_is_marked_and_never_confident_and_wrong(folder: Path) -> None:
    path = simulated(folder, scenario="kidnapped")  # lifted at 20 s, put down at 22 s
    loaded = load([path], PLAIN)
    found = fuse(loaded.drive, loaded.robot, ["compass", "lrf"])
    ((start, end),) = found.lost
    assert 19.5 <= start <= 22.5  # dated back to the last scan that fitted
    judged = evaluate(found, loaded.drive)
    error = np.hypot(*judged.deviation.T)
    known = (judged.t < start) | (judged.t > end)
    assert error[known].max() < 0.05
    away = (judged.t > 22.0) & (judged.t < end)
    sigma = np.sqrt(judged.sigma[away, 0] ** 2 + judged.sigma[away, 1] ** 2)
    assert (error[away] < 3.0 * sigma).all()
    done, _, report = run(path)
    assert "lost from" in done.stderr
    assert report["configurations"]["all"]["lost"] == [[start, end]]


@pytest.fixture(scope="module")
def disturbed(folder: Path) -> Path:
    out = folder / "disturbed"
    ok("compare", "disturbed", "--no-advice", "-o", out, "--write", "json,html")
    return out


def test_a_magnetic_disturbance_makes_the_compass_at_most_a_tenth_worse_than_odometry(disturbed: Path) -> None:
    found = json.loads((disturbed / "report.json").read_text())["configurations"]
    assert found["compass"]["position_rmse_m"] <= 1.1 * found["odometry"]["position_rmse_m"]
    assert found["all"]["sensors"]["compass"]["rejected"] > 50


def test_wheel_slip_people_a_wrong_red_object_and_a_hidden_landmark_are_gated_counted_and_shown(
    disturbed: Path,
) -> None:
    found = json.loads((disturbed / "report.json").read_text())["configurations"]
    assert found["all"]["position_rmse_m"] < 0.02
    assert found["lrf"]["sensors"]["lrf"]["rejected"] > 0  # people
    camera = found["camera"]["sensors"]["camera"]
    assert camera["rejected"] > 10  # the wrong one
    assert camera["absent"] > 0  # the hidden one
    page = (disturbed / "report.html").read_text()
    for count in (found["lrf"]["sensors"]["lrf"]["rejected"], camera["rejected"]):
        assert str(count) in page


def test_one_corridor_corrects_only_the_observable_directions() -> None:
    """Between parallel walls along x nothing says how far along the robot is: P_xx must keep growing."""
    corridor = ((-50, 0, 50, 0), (50, 2, -50, 2))
    world = World(seconds=15, turning=0.0, start=(0.0, 1.0, 0.0), walls=corridor, mount=(0.0, 0.0, 0.0))
    robot = world.robot()
    drive = measure(world.streams(), robot)
    alone, lrf = fuse(drive, robot, []), fuse(drive, robot, ["lrf"])
    assert lrf.P[-1, 0, 0] == pytest.approx(alone.P[-1, 0, 0], rel=0.05)
    assert lrf.P[-1, 1, 1] < 0.01 * alone.P[-1, 1, 1]


def test_a_driver_that_stamps_whole_seconds_gives_many_readings_one_instant_and_no_traceback(folder: Path) -> None:
    with simulated(folder).open("rb") as file:
        reader = make_reader(file)
        every = [(s, c, m) for s, c, m in reader.iter_messages() if s is not None]
        attachments = {a.name: a.data for a in reader.iter_attachments()}
    whole = [
        Said(c.topic, s.name, m.data[:8] + bytes(4) + m.data[12:] if c.topic == "/compass" else m.data, m.log_time)
        for s, c, m in every
    ]
    for sensors in ("compass", "all"):
        run(write(folder / "seconds.mcap", whole, attachments=attachments), "--sensors", sensors)
    done = locfuse("compare", folder / "seconds.mcap", "--no-advice", "--write", "json", "-o", folder / "seconds")
    assert done.exit_code in {0, 3}, done.stderr
