"""Which way round a camera's columns turn, and where column 0 looks, by the wheels and a known start."""

import math
import re
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest
from commands import locfuse
from laser_room import scan_stream
from lock_step import simulated
from msgspec.structs import replace
from numpy.typing import NDArray
from present import present
from rows import readings
from small_drive import drive as small_drive, robot as small_robot
from wheel_bags import on_circle

from locfuse.cli.analysis.robot_tables import make_robot
from locfuse.cli.session.session import load
from locfuse.fusion import se2
from locfuse.fusion.checks import laser_ranges
from locfuse.fusion.checks.compass import of_iron
from locfuse.fusion.checks.finding import Finding
from locfuse.fusion.checks.laser import of_sweep
from locfuse.fusion.checks.laser_ranges import of_angles, of_beam_angles, of_offset, of_scatter, ranges_offset
from locfuse.fusion.checks.pictures import MIRRORED_SHARE, of_handedness, of_rims, turning_along
from locfuse.fusion.checks.probes import beyond_prior, of_probe
from locfuse.fusion.data import Array, ArrayStream, Column, Drive, Estimates, Ragged, Truth
from locfuse.fusion.lines.scans import MAX_BEAMS, SCAN_FIELDS
from locfuse.fusion.robot import Robot
from locfuse.fusion.se2 import wrap_all
from locfuse.fusion.sensors.camera import CameraSettings
from locfuse.fusion.sensors.lrf import Lrf, LrfSettings
from locfuse.fusion.wheels.motion import Wheels
from locfuse.sample_logs.scenario import load as scenario_of
from locfuse.sample_logs.simulate import on_truth, write_log

LANDMARK = (1.0, 2.5)


@pytest.fixture(scope="module")
def healthy() -> tuple[Drive, Robot]:
    """A lap with bearings from the truth, 2 Hz, 0.5 degrees of noise."""
    drive, robot = simulated(5, sets=("camera.enabled=false",), robot_sets=("camera.landmark=[1.0,2.5]",))
    truth = drive.truth
    assert isinstance(truth, Truth)
    assert truth.theta is not None
    t, xy, theta = truth.t[::5], truth.xy[::5], truth.theta[::5]
    z = np.arctan2(LANDMARK[1] - xy[:, 1], LANDMARK[0] - xy[:, 0]) - theta
    z = wrap_all(z + np.radians(0.5) * np.random.default_rng(1).normal(size=len(z)))
    return replace(drive, measurements={"camera": readings(t, z[:, None], math.radians(0.5))}), robot


def mirrored(drive: Drive, zero_deg: float) -> Drive:
    """The same as a camera sees it whose columns turn the other way round, and whose column 0 looks elsewhere."""
    m = drive.measurements["camera"]
    z = wrap_all(math.radians(zero_deg) - m.z)
    return replace(drive, measurements={"camera": replace(m, z=z)})


def test_a_camera_as_configured_or_on_a_drive_without_turns_is_left_alone(healthy: tuple[Drive, Robot]) -> None:
    drive, robot = healthy
    assert of_handedness(drive, robot) == []
    assert present(turning_along(drive, robot)[0]) < 1.0 - MIRRORED_SHARE  # so no other handedness is tried
    few = replace(drive, measurements={"camera": drive.measurements["camera"].take(np.arange(8))})
    assert of_handedness(mirrored(few, 0.0), robot) == []


@pytest.mark.parametrize("zero_deg", [90.0, -150.0])
def test_a_known_start_gives_the_zero_of_a_mirrored_camera(healthy: tuple[Drive, Robot], zero_deg: float) -> None:
    """z = zero - column, configured as z = column: with both fixes the bearings are right again."""
    drive, robot = healthy
    (found,) = of_handedness(mirrored(drive, zero_deg), robot)
    assert found.fixes[0] == "camera.clockwise=true"
    assert float(found.fixes[1].partition("=")[2]) == pytest.approx(zero_deg, abs=3.0)
    (blind,) = of_handedness(mirrored(drive, zero_deg), replace(robot, start_given=False))
    assert (blind.severe, blind.fixes) == (True, ("camera.clockwise=true",))


def test_only_the_first_metres_give_the_zero_near_the_start(healthy: tuple[Drive, Robot]) -> None:
    """Fifty small circles by wheels that turn 0.5 percent too far: in the end their heading is 90 degrees off."""
    drive, robot = healthy
    t = np.arange(0.0, 785.0, 0.1)
    turn, radius = 0.4 * t, 0.25
    wheels = Wheels.from_twists(t, np.diff([radius * turn, 0.0 * t, 1.005 * turn], axis=1).T, 0.4, 4e-4)
    pose = se2.compose(np.array(robot.start.pose), on_circle(turn, radius))[::5]
    z = np.arctan2(LANDMARK[1] - pose[:, 1], LANDMARK[0] - pose[:, 0]) - pose[:, 2]
    seen = readings(t[::5], wrap_all(z)[:, None], math.radians(0.5))
    circles = replace(drive, wheels=wheels, measurements={"camera": seen})
    (found,) = of_handedness(mirrored(circles, 25.0), robot)
    assert float(found.fixes[1].partition("=")[2]) == pytest.approx(25.0, abs=3.0)


# --- iron about a magnetometer, simulated: on the robot it is a setting, in the room it is a place

CLEAN = ("compass.hard_iron=[0, 0]", "compass.soft_iron=[1, 1, 0]", "camera.enabled=false", "lrf.enabled=false")
CABINET = 'faults=[{kind="magnetic", x=4.0, y=5.4, strength=4e-6, axis_deg=20}]'


def found(folder: Path, *sets: str, robot: tuple[str, ...] = ()) -> list[Finding]:
    log = folder / f"{len(robot)}.mcap"
    write_log(scenario_of("rounded_rectangle", (*CLEAN, *sets)), 3000, on_truth, log)
    loaded = load(log, sets=robot).loaded
    return of_iron(loaded.drive, loaded.robot, {"compass": loaded.stream("compass")})


@pytest.mark.parametrize(
    ("iron", "axis"), [("hard_iron=[2.8e-6, 0]", (2.8e-6, 0.0)), ("soft_iron=[1.1, 0.9, 0]", (0.9 / 1.1, 0.0))]
)
def test_iron_on_the_robot_is_measured_and_is_no_finding_once_it_is_set(
    iron: str, axis: tuple[float, float], tmp_path: Path
) -> None:
    """A magnet by 14 % of the field; steel: 10 % longer along one axis and shorter along the other."""
    (one,) = found(tmp_path, f"compass.{iron}")
    (fix,) = one.fixes
    key, _, value = fix.partition("=")
    assert (one.code, key) == ("iron", f"compass.{iron.partition('=')[0]}")
    assert one.severe or iron.startswith("soft")
    values = [float(v) for v in value.strip("[]").split(",")]
    seen = values if len(values) == 2 else (values[0] / values[3], values[1])
    assert seen == pytest.approx(axis, rel=0.05, abs=2e-7 if len(values) == 2 else 0.02)
    assert found(tmp_path, f"compass.{iron}", robot=(fix,)) == []


def test_a_steel_cabinet_is_named_with_its_place(tmp_path: Path) -> None:
    (one,) = found(tmp_path, CABINET)
    assert one.code == "iron in the room"
    assert not one.severe
    x, y = (float(v) for v in one.message.partition("(")[2].partition(")")[0].split(","))
    assert np.hypot(x - 4.0, y - 5.4) < 2.0


# --- the noise that ranges show by themselves, held to walls in closed form with noise that was drawn

BEAMS, SCANS = 360, 30
SCAN = "sensor_msgs/msg/LaserScan"
ANGLES = np.arange(BEAMS) * (2.0 * np.pi / BEAMS) - np.pi
NORMALS, DISTANCES = np.radians([0.0, 90.0, 180.0, 270.0]) + 0.2, np.array([2.5, 1.5, 3.0, 2.0])


def room(angles: NDArray[np.floating[Any]] = ANGLES) -> Array:
    """The ranges (SCANS, BEAMS) of a closed room: to the nearest of four walls."""
    cos = np.cos(angles[:, None] - NORMALS)
    return np.tile(np.where(cos > 1e-3, DISTANCES / np.maximum(cos, 1e-3), np.inf).min(axis=1), (SCANS, 1))


def said(ranges: Array, **settings: Any) -> float | None:
    """The sigma that is suggested, None where nothing is said."""
    found = of_scatter(scan_stream(range(len(ranges)), ranges), LrfSettings(**settings))
    return float(found[0].fixes[0].removeprefix("lrf.sigma_range=")) if found else None


def noise(sigma: float) -> Array:
    return sigma * np.random.default_rng(3).normal(size=(SCANS, BEAMS))


@pytest.mark.parametrize("sigma", [0.01, 0.03, 0.05])
def test_a_noise_that_is_set_too_low_is_named_with_the_one_that_was_drawn(sigma: float) -> None:
    assert said(room() + noise(sigma), sigma_range=sigma / 2.0) == pytest.approx(sigma, rel=0.12)


def test_a_noise_that_is_right_or_too_high_walls_without_noise_and_clutter_are_not_mentioned() -> None:
    assert [said(room() + noise(0.03), sigma_range=sigma) for sigma in (0.03, 0.05)] == [None, None]
    assert said(room(), sigma_range=1e-6) is None
    assert said(np.round(room() / 0.05) * 0.05, sigma_range=0.005) is None
    rng = np.random.default_rng(4)
    leaves = np.minimum(rng.exponential(0.3, (SCANS, BEAMS)), 1.0)
    some = rng.random((SCANS, BEAMS)) < 0.3
    assert said(room() - leaves, sigma_range=0.01) is None
    assert said(room() + noise(0.005) - some * leaves, sigma_range=0.001) is None


def test_a_noise_that_no_laser_has_is_named() -> None:
    assert said(np.full((3, 4), 2.0), sigma_range=0.5) == LrfSettings().sigma_range


@pytest.mark.parametrize(("sigma", "more"), [(0.02, True), (0.028, False), (0.04, False)])
def test_a_smaller_sigma_is_contradicted_by_the_ranges(sigma: float, more: bool) -> None:
    seen = laser_ranges.ranges_sigma(scan_stream(range(SCANS), room() + noise(0.03)), LrfSettings())
    assert laser_ranges.scatter_more(seen, sigma) == more


@pytest.mark.parametrize(("error", "scale"), [(0.05, 1.0), (-0.03, 1.0), (0.0, 1.0), (0.0, 1.05), (0.04, 0.97)])
def test_walls_tell_a_constant_error_of_the_ranges_whatever_their_scale(error: float, scale: float) -> None:
    found = present(ranges_offset(scan_stream(range(SCANS), scale * room() + error + noise(0.01)), LrfSettings()))
    add, sigma = found
    assert add == pytest.approx(-error, abs=0.006)  # what is near a corner takes part
    assert sigma < 0.004


@pytest.mark.parametrize("wider", [0.03, -0.03, 0.004, 0.0])
@pytest.mark.parametrize("error", [0.0, 0.05])
def test_walls_tell_a_wrong_angle_between_beams_beside_a_wrong_range(wider: float, error: float) -> None:
    true = -np.pi + (1.0 + wider) * (ANGLES + np.pi)
    stream = scan_stream(range(SCANS), room(true) + error + noise(0.01))
    found = of_beam_angles(stream, replace(small_drive(5, small_robot()), epoch_ns=0), LrfSettings())
    assert [f.severe for f in found] == [True] * (abs(wider) > 0.01)
    for one in found:
        size, sense = present(re.search(r"were (.+)% too (small|large)", one.message)).groups()
        assert float(size) == pytest.approx(100.0 * abs(wider), abs=0.8)  # what is near a corner takes part
        assert sense == ("small" if wider > 0.0 else "large")


def test_a_constant_error_is_named_with_what_to_add_to_the_configured_offset() -> None:
    stream = scan_stream(range(SCANS), room() + 0.05 + noise(0.01))
    (one,) = of_offset(stream, LrfSettings(range_offset=0.02))
    key, _, value = one.fixes[0].partition("=")
    assert (key, one.severe) == ("lrf.range_offset", True)
    assert float(value) == pytest.approx(-0.05, abs=0.006)
    assert of_offset(stream, LrfSettings(range_offset=-0.05)) == []
    round_room = scan_stream(range(SCANS), np.full((SCANS, BEAMS), 3.0) + noise(0.01))
    assert of_offset(round_room, LrfSettings()) == []


def test_info_names_the_noise_of_a_recorded_laser() -> None:
    """The sample's is 0.03 m."""
    told = locfuse("info", "rounded_triangle", "--set", "lrf.sigma_range=0.01")
    assert "fix: --set lrf.sigma_range=0.034" in told.stdout
    assert "scatter" not in locfuse("info", "rounded_triangle").stdout


def test_scans_of_more_beams_than_a_laser_has_are_not_looked_at() -> None:
    """38 of 40 scans have a million beams: a log of 0.2 MB, and 1.7 GiB where they all are put together."""
    lengths = np.full(40, MAX_BEAMS + 1)
    lengths[[3, 7]] = 5
    values = np.broadcast_to(np.float32(1.0), (int(lengths.sum()),))
    columns: dict[str, Any] = {name: np.zeros(40, np.float32) for name in Lrf.reads[SCAN] if name != "ranges"}
    columns["ranges"] = Ragged(values, np.append(0, np.cumsum(lengths)))
    columns["angle_min"] = np.arange(40)

    class Stream:
        msgtype = SCAN
        t_ns = np.arange(40)

        def blocks(self, *_: str, rows: int) -> Any:
            yield np.arange(40), columns

    (kept,) = laser_ranges._sample(cast("Any", Stream()), laser_ranges.SAMPLE_SCANS)
    assert kept["angle_min"].tolist() == [3, 7]
    assert kept["ranges"].lengths.tolist() == [5, 5]
    assert {len(v) for k, v in kept.items() if k != "ranges"} == {2}


# --- the circles of an omni picture are found where they were drawn, and nowhere else

SIZE_PX = 320


def pictures(centre: tuple[float, float], inner: float, outer: float) -> list[NDArray[np.uint8]]:
    """Return noisy pictures: dark without and in the middle, between them a scene that changes."""
    rng = np.random.default_rng(7)
    y, x = np.mgrid[:SIZE_PX, :SIZE_PX]
    r = np.hypot(x - centre[0], y - centre[1])
    ring = (r >= inner) & (r <= outer)
    made = []
    for _ in range(6):
        scene = 120.0 + 60.0 * np.sin(np.arctan2(y - centre[1], x - centre[0]) * 3.0 + rng.uniform(0.0, 6.0))
        grey = np.where(ring, scene, 12.0) + rng.normal(0.0, 3.0, r.shape)
        made.append(np.repeat(np.clip(grey, 0, 255).astype(np.uint8)[:, :, None], 3, axis=2))
    return made


def test_both_circles_are_found_to_a_pixel_and_what_fits_or_shows_none_says_nothing() -> None:
    (finding,) = of_rims(pictures((166.4, 153.7), 40.0, 140.0), CameraSettings())
    values = dict(fix.removeprefix("camera.").split("=") for fix in finding.fixes)
    x, y = (float(v) for v in values["centre"].strip("[]").split(","))
    assert (x, y) == pytest.approx((166.4, 153.7), abs=0.5)
    assert float(values["outer"]) == pytest.approx(140.0, abs=1.0)
    assert float(values["inner"]) == pytest.approx(40.0, abs=1.0)
    right = CameraSettings(centre=(166.4, 153.7), inner=40.0, outer=140.0)
    assert of_rims(pictures((166.4, 153.7), 40.0, 140.0), right) == []
    rng = np.random.default_rng(3)
    noise = [rng.integers(0, 255, (SIZE_PX, SIZE_PX, 3), np.uint8) for _ in range(6)]
    assert of_rims(noise, CameraSettings()) == []
    stripes = np.zeros((SIZE_PX, SIZE_PX, 3), np.uint8)
    stripes[:, 60:260] = 200
    assert of_rims([stripes] * 6, CameraSettings()) == []


# --- what a run's states say of mount and track: held to the turning of wheels, and to what was taken for likely

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


def test_a_track_far_outside_its_prior_is_a_slip_unless_the_truth_can_judge_it() -> None:
    """On a real log one slip made the state 0.56: the advised track was twice the true one."""
    found = [list(of_probe(robot(), "lrf", run(wheels=(0.0, 0.0, 0.56)), by_truth)) for by_truth in (False, True)]
    assert [len(f) for f in found] == [0, 1]
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
    found = run(**{state: (value,)})
    assert beyond_prior(robot(**settings), "lrf", found) == beyond
    assert not beyond_prior(robot(**settings), "compass", found)  # it has no mount
    vague = replace(found, block_sigmas={state: np.array([[value / 3.0]])})
    assert not beyond_prior(robot(**settings), "lrf", vague)


# --- angle_max, which nothing uses, beside angle_increment, which gives every beam its direction


def test_ranges_in_mm_beside_a_range_max_in_m_are_named() -> None:
    stream = scan_stream(range(5), np.full((5, 360), 1.5e3))
    assert laser_ranges.unreturned(stream, 0.0) == "100% far beyond range_max, as in mm"


def spanned(beams: int, span_deg: float, step_deg: float) -> ArrayStream:
    """Five scans of `beams` ranges whose angle_max says `span_deg`, and whose angle_increment says `step_deg`."""
    data: dict[str, Column] = {
        "angle_min": np.full(5, -math.pi),
        "angle_max": np.full(5, -math.pi + math.radians(span_deg)),
        "angle_increment": np.full(5, math.radians(step_deg)),
        "ranges": Ragged(np.ones(5 * beams), beams * np.arange(6)),
    }
    return ArrayStream("/scan", "sensor_msgs/msg/LaserScan", np.arange(5), data)


BEAM_SPANS = [(361, 180, 0.5), (360, 180, 0.5), (362, 180, 0.5), (360, -180, -0.5), (360, 0, 1)]
BEAM_SPANS += [(1, 1, 1), (0, 1, 1)]


@pytest.mark.parametrize(("beams", "span", "step"), BEAM_SPANS)
def test_an_angle_max_off_by_a_beam_or_not_filled_in_is_no_finding(beams: int, span: float, step: float) -> None:
    assert of_angles(spanned(beams, span, step)) == []


def test_angles_that_contradict_each_other_are_severe_where_they_make_more_than_a_whole_turn() -> None:
    (half,) = of_angles(spanned(361, 180.0, 0.51))
    assert not half.severe
    assert "angle_max - angle_min is 180.00°, but 360 times angle_increment is 183.60°" in half.message
    assert f"{math.radians(0.5):.6g} rad" in half.message
    (whole,) = of_angles(spanned(720, 359.5, 0.51))
    assert whole.severe
    assert "more than a whole turn" in whole.message


# --- the order of the beams of a laser that needs a tenth of a second for a scan


@pytest.fixture(scope="module")
def sweeping(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A lap with a laser that turns once in 0.15 s."""
    log = tmp_path_factory.mktemp("sweeping") / "log.mcap"
    sets = ("lrf.duration=0.15", "lrf.rate=6.0", "camera.enabled=false")
    write_log(scenario_of("rounded_triangle", sets), 3000, on_truth, log)
    return log


@pytest.mark.parametrize("said", ["forward", "backward"])
@pytest.mark.parametrize("taken", ["forward", "backward"])
def test_a_laser_that_takes_its_beams_in_the_other_order_is_found(sweeping: Path, said: str, taken: str) -> None:
    """The driver may hand over the beams from the last to the first, each with its own direction."""
    loaded = load(sweeping, sets=(f"lrf.sweep={said}",)).loaded
    stream = loaded.stream("lrf")
    if taken == "backward":
        columns = stream.columns(*SCAN_FIELDS)
        ranges = columns["ranges"]
        assert isinstance(ranges, Ragged)
        rows = [ranges[i][::-1] for i in range(len(ranges))]
        directions = {name: -np.asarray(columns[name]) for name in ("angle_min", "angle_increment")}
        data = {**columns, **directions, "ranges": Ragged(np.concatenate(rows), ranges.first)}
        stream = ArrayStream(stream.topic, stream.msgtype, stream.t_ns, data)
    found = of_sweep(stream, loaded.drive, loaded.robot, 0.0)
    assert [f.fixes for f in found] == ([(f"lrf.sweep={taken}",)] if said != taken else [])


@pytest.mark.parametrize("duration", [0.001, 0.15])
def test_scans_without_a_time_between_beams_are_named_if_they_take_time(tmp_path: Path, duration: float) -> None:
    sets = (f"lrf.duration={duration}", "lrf.rate=6.0", "camera.enabled=false")
    write_log(scenario_of("rounded_triangle", sets), 3000, on_truth, tmp_path / "log.mcap")
    loaded = load(tmp_path / "log.mcap").loaded
    stream = loaded.stream("lrf")
    columns = stream.columns(*SCAN_FIELDS)
    columns["time_increment"] = np.zeros(len(stream.t_ns))
    stream = ArrayStream(stream.topic, stream.msgtype, stream.t_ns, columns)
    found = of_sweep(stream, loaded.drive, loaded.robot, 0.0)
    assert [(f.code, f.severe, f.fixes) for f in found] == [("unswept", True, ())] * (duration > 0.1)
    assert all("if a scan takes 0.17 s (forward)" in f.message for f in found)
