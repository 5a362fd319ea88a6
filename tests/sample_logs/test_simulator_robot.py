"""The robot as physics: encoders, motor control, exact motion, and a loop closed on what it has been told."""

import itertools
import json
import math
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner, Result
from present import present

from locfuse.cli.commands.simulate import simulate
from locfuse.cli.session.simulate import localise
from locfuse.fusion.data import Array, LocfuseError, UsageError
from locfuse.sample_logs import scenario as load
from locfuse.sample_logs.paths import LegFollower, PathFollower, polygon, tour
from locfuse.sample_logs.robot import SimulatedRobot, Trail, decode, phases
from locfuse.sample_logs.scenario import Leg, Motor, Polygon, Room, Scenario, Tour, WheelsSpec
from locfuse.sample_logs.simulate import (
    EPOCH_NS,
    OBSTACLE_HEIGHT,
    Simulation,
    in_memory,
    on_truth,
    speed_stability,
)
from locfuse.sample_logs.table import Pose, RawMessage, streams
from locfuse.sample_logs.world import World, clearance

BLIND = ("camera.enabled=false", "lrf.enabled=false", "compass.enabled=false")
NO_CHANCE = Scenario(wheels=WheelsSpec(noise=0.0), motor=Motor(load=0.0, gain_error=(0.0, 0.0)))


def counts_of(angle: Array, slots: int = 500) -> tuple[int, int]:
    seen = decode(*phases(angle, slots))
    return int(seen.counts.sum()), int(seen.missed.sum())


def test_a_disc_of_500_slots_gives_2000_counts_a_turn_and_what_is_missed_is_reported() -> None:
    forward = np.linspace(0.0, 2 * math.pi, 20_001) + 1e-4
    assert counts_of(forward) == (2000, 0)
    assert counts_of(forward[::-1]) == (-2000, 0)
    two_counts_at_once = np.array([0.1, 2.1, 4.1, 4.2]) * 2 * math.pi / 2000
    seen = decode(*phases(two_counts_at_once, 500))
    assert seen.missed.tolist() == [True, True, False]
    assert seen.counts.tolist() == [0, 0, 0]


def test_the_decoder_agrees_with_counting_quarter_slots() -> None:
    rng = np.random.default_rng(1)
    angle = np.cumsum(rng.normal(0, 0.0008, 5000))  # to and fro, less than a count at a time
    quarters = np.floor(angle * 2000 / (2 * math.pi))
    counts = decode(*phases(angle, 500)).counts
    np.testing.assert_array_equal(np.cumsum(counts), (quarters - quarters[0])[1:])


def test_counts_never_leave_the_true_angle_and_one_read_too_seldom_says_so() -> None:
    robot = SimulatedRobot(Scenario(), (0.0, 0.0, 0.0), streams(3))
    rng = np.random.default_rng(3)
    for _ in range(300):
        robot.drive((float(rng.uniform(-10, 10)), float(rng.uniform(-10, 10))))
        for wheel in robot.wheels:
            assert 0 <= wheel.angle / wheel.rad_per_count - wheel.counts < 1.0 + 1e-9
    assert sum(wheel.missed for wheel in robot.wheels) == 0
    # At 10 rad/s a disc of 500 slots gives 3183 counts/s; 2000 looks a second see two or none at once.
    robot = SimulatedRobot(Scenario(wheels=WheelsSpec(sampling=2000.0)), (0.0, 0.0, 0.0), streams(3))
    for _ in range(300):
        robot.drive((10.0, -10.0))
    for wheel in robot.wheels:
        assert wheel.missed > 100
        assert abs(wheel.angle) / wheel.rad_per_count - abs(wheel.counts) > 2 * wheel.missed - 2


def test_the_trail_between_knots_is_the_circular_arc() -> None:
    trail = Trail(0.1, (1.0, 2.0, 0.5))
    trail.extend(np.array([[0.3, 0.0, 0.6]]))
    radius = 0.3 / 0.6
    for share in (0.0, 0.2, 0.7, 1.0):
        x, y, theta = trail.pose(np.array([0.1 * share]))[0]
        turned = 0.6 * share
        assert theta == pytest.approx(0.5 + turned)
        assert x == pytest.approx(1.0 + radius * (math.sin(0.5 + turned) - math.sin(0.5)), abs=1e-12)
        assert y == pytest.approx(2.0 - radius * (math.cos(0.5 + turned) - math.cos(0.5)), abs=1e-12)


def test_without_control_the_motors_do_not_hold_it() -> None:
    still = ("motor.kp=0", "motor.ki=0", "motor.kd=0", "motor.gain_error=[-0.08, 0.08]")
    scenario = load.load("rounded_rectangle", (*BLIND, *still, "control.estimator=truth"))
    _, _, outcome = in_memory(scenario, 1)
    assert speed_stability(outcome).worst > 0.05


def test_a_robot_without_chance_follows_the_path_within_centimetres() -> None:
    scenario = load.load("rounded_rectangle", (*BLIND, "wheels.noise=0"))
    _, _, outcome = in_memory(scenario, 1)
    path = polygon(Polygon()).pose[:, :2]
    off = np.array([np.hypot(*(path - p).T).min() for p in outcome.truth[::40, :2]])
    assert off.max() < 0.03
    assert outcome.way == pytest.approx(12 + 2 * math.pi * 0.6, abs=0.1)


def test_the_rounded_rectangle_of_the_default_room_starts_and_measures_as_designed() -> None:
    path = polygon(Polygon())
    assert path.start == pytest.approx((1.5, 1.5, 0.0))
    assert len(path.pose) == pytest.approx((12 + 2 * math.pi * 0.6) / 0.01, abs=5)
    assert path.curvature.max() == pytest.approx(1 / 0.6)


def test_corners_and_tours_that_do_not_fit_are_refused() -> None:
    with pytest.raises(LocfuseError, match=r"path.radius = 3.0 m does not fit: the edge after vertex 2"):
        polygon(Polygon(vertices=((0, 0), (9, 0), (9, 4), (0, 4)), radius=3.0))
    room = Room(size=(1.0, 1.0), plates=())
    plan = World(Scenario(room=room)).plan(OBSTACLE_HEIGHT)
    with pytest.raises(LocfuseError, match="no tour"):
        tour(Tour(), plan, room.size, np.random.default_rng(1))


@pytest.mark.parametrize("seed", range(10))
def test_random_tours_stay_clear_of_everything(seed: int) -> None:
    scenario = Scenario(path=Tour())
    plan = World(scenario).plan(OBSTACLE_HEIGHT)
    path = tour(Tour(), plan, (8.0, 6.0), np.random.default_rng(seed))
    assert clearance(plan, path.pose[:, :2]).min() > scenario.control.clearance
    assert 15 < len(path.pose) * 0.01 < 25
    gaps = np.hypot(*np.diff(path.pose[:, :2], axis=0).T)
    assert gaps.max() < 0.02  # in one piece


@pytest.mark.parametrize(
    ("leg", "expected"),
    [
        (Leg(forward=2.0, speed=0.3), (2.0, 0.0, 0.0)),
        (Leg(forward=-2.0, speed=0.6), (-2.0, 0.0, 0.0)),
        (Leg(turn_deg=360, speed=0.1), (0.0, 0.0, 2 * math.pi)),
        (Leg(turn_deg=-90, speed=0.6), (0.0, 0.0, -math.pi / 2)),
    ],
    ids=["straight", "backward", "full turn", "right turn"],
)
def test_a_leg_ends_where_it_was_asked_to(leg: Leg, expected: Pose) -> None:
    robot = SimulatedRobot(NO_CHANCE, (0.0, 0.0, 0.0), streams(1))
    follower = LegFollower((leg,), 0.6)
    while True:
        x, y, theta = robot.trail.knots()[-1].tolist()
        command = follower.command(robot.trail.end, (x, y, theta))
        if command is None:
            break
        half = 0.3 * command.omega
        for _ in range(5):
            robot.drive(((command.v - half) / 0.05, (command.v + half) / 0.05))
    assert robot.trail.knots()[-1] == pytest.approx(expected, abs=0.03)


def test_the_path_follower_is_not_confused_where_the_path_crosses_itself() -> None:
    eight = Polygon(vertices=((0, 0), (4, 3), (4, 0), (0, 3)), radius=0.3)
    follower = PathFollower(polygon(eight), 0.3)
    visited = []
    for x, y, theta in polygon(eight).pose[::3].tolist():
        follower.command(0.0, (x, y, theta))
        visited.append(follower.at)
    assert np.diff(visited).max() <= 4


class Listener:
    """A localisation by odometry that remembers what it was told at each call."""

    def __init__(self, tables: dict[str, dict[str, object]]) -> None:
        reckon = present(localise("odometry")(tables))
        self.reckon = reckon
        self.heard: list[list[RawMessage]] = []

    def __call__(self, messages: list[RawMessage]) -> Pose:
        self.heard.append(messages)
        return self.reckon(messages)


def test_the_loop_is_causal_and_hands_out_every_message_once() -> None:
    simulation = Simulation(load.load("tour", ("camera.rate=0.5", "path.length=3")), 1)
    listener = Listener(simulation.robot_tables)
    emitted: list[RawMessage] = []
    simulation.run(listener, emitted.append)
    for call, messages in enumerate(listener.heard):
        now = EPOCH_NS + round(call * 0.1 * 1e9)
        assert all(now - 100_000_000 < m.log_ns <= now for m in messages)
    told = [m for messages in listener.heard for m in messages]
    without_statics = emitted[1:]
    assert [id(m) for m in told] == [id(m) for m in without_statics[: len(told)]]
    assert all(a.log_ns <= b.log_ns for a, b in itertools.pairwise(emitted))
    for message in emitted:
        assert message.stamp_ns <= message.log_ns
        if message.topic == "/scan":
            assert message.log_ns - message.stamp_ns > 25_000_000  # the last ray has returned


def test_a_scan_is_cast_from_where_the_robot_is_at_each_ray() -> None:
    """Driving at the wall x = 8 without noise: every ray's range is that of its own instant."""
    calm = ("lrf.sigma_range=0", "lrf.sigma_angle_deg=0", "lrf.lost=0", "wheels.noise=0", "room.plates=[]")
    scenario = load.load("rounded_rectangle", (*calm, "camera.enabled=false", "landmark.bottom=1.0"))
    data, _, outcome = in_memory(scenario, 1)
    scan = data["/scan"]
    i = 60  # about 6 s: on the first straight, at full speed
    ranges = scan.data["ranges"][i]
    t = (scan.t_ns[i] - EPOCH_NS) * 1e-9 + np.arange(181) * 0.025 / 180
    x, y, theta = (np.interp(t, outcome.truth_t, outcome.truth[:, k]) for k in range(3))
    angle = theta + np.radians(np.arange(181) - 90.0)
    to_wall = (8.0 - x - 0.2 * np.cos(theta)) / np.cos(angle)
    ahead = slice(76, 110)  # the others meet the side walls
    np.testing.assert_allclose(ranges[ahead], to_wall[ahead], atol=2e-6)
    frozen = (8.0 - x[0] - 0.2 * np.cos(theta[0])) / np.cos(theta[0] + np.radians(np.arange(181) - 90.0))
    assert np.abs(ranges[ahead] - frozen[ahead]).max() > 0.003  # 0.3 m/s for 15 ms
    assert np.ptp(y[ahead]) < 0.01


def test_a_robot_at_a_wall_and_a_drive_that_never_ends_are_stopped() -> None:
    scenario = load.load("disturbed", BLIND)
    with pytest.raises(LocfuseError, match=r"the robot hits something after 5\d.\d s: at \(2.\d\d, 0.\d\d\)"):
        in_memory(scenario, 1, localise("odometry"))
    scenario = load.load("rounded_rectangle", (*BLIND, "control.time_limit=5"))
    with pytest.raises(LocfuseError, match=r"control\.time_limit = 5 s"):
        in_memory(scenario, 1)


# --- scenarios, and the command that drives them


def run(*arguments: str) -> Result:
    return CliRunner().invoke(simulate, list(arguments))


CREEP = 'faults=[{kind="creep", ratio=0.02}]'  # whose other keys are left out


@pytest.mark.parametrize(("name", "sets"), [*((name, ()) for name in load.names()), ("tour", (CREEP,))])
def test_a_scenario_says_what_it_is_and_survives_writing(name: str, sets: tuple[str, ...], tmp_path: Path) -> None:
    scenario = load.load(name, sets)
    assert 20 < len(scenario.title) < 120
    copy = tmp_path / "copy.toml"
    copy.write_text(load.dumps(scenario))
    assert load.load(str(copy)) == scenario


def test_the_same_seed_gives_the_same_drive_in_one_simulation_too() -> None:
    scenario = load.load("tour", (*BLIND, "path.length=3"))
    first, again, other = (in_memory(scenario, seed)[2].truth for seed in (1, 1, 2))
    np.testing.assert_array_equal(first, again)
    assert not np.array_equal(first[0], other[0])
    simulation = Simulation(load.load("tour", (*BLIND, "path.length=3")), 1)
    first, again = (simulation.run(None, lambda message: None).truth for _ in range(2))
    np.testing.assert_array_equal(first, again)


def test_sources_of_chance_are_independent_of_each_other() -> None:
    a, b, again = (streams(5)(name).standard_normal(1000) for name in ("lrf", "compass", "lrf"))
    np.testing.assert_array_equal(a, again)
    assert abs((a * b).mean()) < 0.12


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[wheels]\ntrak = 0.5", "no key trak in wheels; did you mean track?"),
        ("[rom]\nsize = [3, 4]", "no key rom in a scenario; did you mean room?"),
        ("[[faults]]\nkind = 'slipp'", "no kind slipp of faults[0]; did you mean slip?"),
        ("[[faults]]\nkind = 'slip'\nweel = 'left'", "no key weel in faults[0]; did you mean wheel?"),
        ("[path]\nkind = 'tour'\nradus = 1", "no key radus in path; did you mean radius?"),
        ("[[sonar]]\nname = 'a'\nx = 1\nsigm = 1", "no key sigm in sonar[0]; did you mean sigma?"),
        ("[lrf]\nrate = 0", "expected `float` > 0.0 - at `lrf.rate`"),
        ("[lrf]\nrate = 'fast'", "expected `float`, got `str` - at `lrf.rate`"),
        ("[lrf\n", "is not TOML"),
        ("\xff\xfe\x00", "cannot be read as a scenario"),
        ("base = 'rounded_rectangel'", "did you mean rounded_rectangle?"),
        ("base = 'hall'\n[building]\nspaces = [{name = 'a', aera = [0, 0, 1, 1]}]", "did you mean area?"),
        ("base = 'hall'\n[building]\npeople = [{path = [[1, 2]]}]", "at least two points"),
        ("base = 'office'\n[camera]\nenabled = true", "set camera.enabled = false"),
        (
            "[[faults]]\nkind = 'magnetic'\nx = 1\ny = 1\nstrength = 1\nstart = 5\nend = 4",
            "end = 4 must come after",
        ),
        ("[[faults]]\nkind = 'people'\npath = [[1, 1], [2, 2]]", "a walk needs an `end`"),
        ("[[faults]]\nkind = 'kidnap'\nx = 1\ny = 1", "a kidnapping needs an `end`"),
        ("[[faults]]\nkind = 'slip'\nwheel = 'left'\nratio = 1.5", "`float` <= 1.0 - at `faults[0].ratio`"),
    ],
)
def test_a_scenario_that_does_not_fit_is_refused_by_its_key(text: str, message: str, tmp_path: Path) -> None:
    file = tmp_path / "mine.toml"
    file.write_bytes(text.encode("latin-1"))
    with pytest.raises(LocfuseError) as error:
        load.load(str(file))
    assert message in str(error.value)
    assert "\n" not in str(error.value)


def test_settings_take_toml_values_or_plain_text_and_reach_defaults() -> None:
    changes = ("control.speed=0.2", "landmark.top=1.2", "camera.clockwise=true", "control.estimator=truth")
    scenario = load.load("rounded_rectangle", changes)
    assert scenario.control.speed == 0.2
    assert scenario.landmark.top == 1.2
    assert scenario.landmark.x == 7.9
    assert scenario.camera.clockwise
    assert scenario.control.estimator == "truth"


@pytest.mark.parametrize("setting", ["control.speeed=0.2", "control.speed=fast", "control", "=3"])
def test_a_setting_that_does_not_fit_is_the_command_lines_fault(setting: str) -> None:
    with pytest.raises(UsageError):
        load.load("rounded_rectangle", (setting,))


def test_a_table_of_another_kind_replaces_the_old_one() -> None:
    old = {"path": {"kind": "polygon", "radius": 0.6}, "lrf": {"x": 0.1}}
    assert load.merge(old, {"path": {"kind": "tour"}, "lrf": {"y": 0.2}}) == {
        "path": {"kind": "tour"},
        "lrf": {"x": 0.1, "y": 0.2},
    }


def test_a_file_beats_a_shipped_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "tour").write_text("title = 'mine, all mine'")
    monkeypatch.chdir(tmp_path)
    assert load.load("tour").title == "mine, all mine"


def test_list_names_every_scenario_and_show_prints_a_complete_one(tmp_path: Path) -> None:
    lines = run("--list").output.splitlines()
    assert [line.split()[0] for line in lines] == load.names()
    assert all(len(line.split()) > 3 for line in lines)
    file = tmp_path / "mine.toml"
    file.write_text(run("disturbed", "--show", "--set", "lrf.rate=5").output)
    scenario = load.load(str(file))
    assert scenario.lrf.rate == 5
    assert len(scenario.faults) == len(load.load("disturbed").faults)


def test_a_drive_is_recorded_and_summed_up_as_json(tmp_path: Path) -> None:
    log = tmp_path / "drive.mcap"
    options = [text for setting in ("path.length=2", "camera.rate=0.5") for text in ("--set", setting)]
    result = run("tour", "-o", str(log), "--seed", "4", "--json", *options)
    assert result.exit_code == 0, result.output
    facts = json.loads(result.output)
    assert facts["seed"] == 4
    assert facts["duration_s"] > 5
    assert log.stat().st_size > 10_000


def test_an_existing_file_is_only_replaced_when_asked(tmp_path: Path) -> None:
    log = tmp_path / "drive.mcap"
    log.write_bytes(b"my only bag")
    result = run("tour", "-o", str(log))
    assert isinstance(result.exception, UsageError)
    assert "--overwrite" in str(result.exception)
    assert log.read_bytes() == b"my only bag"


@pytest.mark.parametrize("arguments", [(), ("tour",), ("nowhere", "-o", "x.mcap")])
def test_a_command_line_that_says_too_little_is_refused(arguments: tuple[str, ...]) -> None:
    assert isinstance(run(*arguments).exception, UsageError)


def test_the_robot_can_steer_on_the_truth_on_odometry_or_on_the_filter() -> None:
    """Fig. 14: with the EKF in the loop the robot comes back to its start, on odometry it does not."""
    ends = {}
    for word in ("odometry", "compass+lrf", "truth"):
        sets = ("camera.enabled=false", "lrf.rate=2") if "lrf" in word else BLIND
        _, _, outcome = in_memory(load.load("rounded_rectangle", sets), 1, localise(word))
        ends[word] = float(np.hypot(*(outcome.truth[-1, :2] - (1.5, 1.5))))
    assert ends["odometry"] > 0.5
    assert ends["compass+lrf"] < 0.25
    assert ends["truth"] < 0.15
    assert localise("truth") is on_truth


def test_steering_on_a_sensor_the_robot_lacks_is_refused() -> None:
    tables = Simulation(Scenario(), 1).robot_tables
    with pytest.raises(UsageError, match="this robot has no sonar; choose from truth, odometry, compass"):
        localise("sonar")(tables)
