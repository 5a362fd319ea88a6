"""The laser: Jacobians by finite differences, frames, deskewing, and what must not be matched."""

import math
from typing import Any

import numpy as np
import pytest
import rooms
from msgspec.structs import replace
from present import present
from textbook import move
from worlds import ROOM, World

from benchmarks import experiment
from benchmarks.accuracy import LOCK_STEP
from locfuse.cli.analysis.configurations import for_comparison, parse
from locfuse.cli.analysis.robot_tables import make_robot
from locfuse.fusion.checks.examine import examine
from locfuse.fusion.data import Array, ArrayStream, Drive, UsageError
from locfuse.fusion.ekf.belief_arrays import JointBelief
from locfuse.fusion.fuse import fuse
from locfuse.fusion.judge.evaluate import evaluate
from locfuse.fusion.map.line_map import LineMap
from locfuse.fusion.measure import measure
from locfuse.fusion.robot import Robot
from locfuse.fusion.sensors.sonar import Cone, Sonar, SonarSettings, likelier, nearest_echo
from locfuse.fusion.streams import merged
from locfuse.sample_logs import scenario as scenarios
from locfuse.sample_logs.simulate import in_memory

# two walls 0.2 m apart, seen one after the other through a doorway in a cross wall
PARALLEL = (
    *ROOM,
    (2.0, 0.0, 2.0, 2.4),
    (2.0, 3.6, 2.0, 6.0),
    (3.0, 2.0, 7.5, 2.0),
    (3.2, 1.8, 7.3, 1.8),
    (3.0, 4.4, 7.5, 4.4),
    (3.0, 4.6, 7.5, 4.6),
)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("mode", ["grow", "refine", "first-scan"])
def test_past_parallel_walls_and_through_a_doorway_no_line_is_matched_wrongly(mode: str, seed: int) -> None:
    """Drive from (0.6, 3) through the doorway at x = 2 between double walls; every match is checked in truth."""
    world = World(
        seconds=18.0,
        turning=0.0,
        start=(0.6, 3.0, 0.0),
        walls=PARALLEL,
        seed=seed,
        settings={"lrf": {"map": mode}},
        mount=(0.0, 0.0, 0.0),
    )
    drive, robot = world.measured()
    found = fuse(drive, robot, ["lrf"])
    audit, lrf = found.audits["lrf"], drive.measurements["lrf"]
    lines = {line.id: line for line in (*found.first_map, *found.final_map)}
    truth = world.pose(lrf.t)
    reading = np.searchsorted(lrf.first, audit.row, side="right") - 1
    wrong = 0
    kept = [k for k in np.flatnonzero(audit.verdict == 0) if int(audit.landmark[k]) in lines]
    assert len(kept) > 0.9 * (audit.verdict == 0).sum()  # the others' lines were joined with another or dropped
    for k in kept:
        line, (r, psi), pose = lines[int(audit.landmark[k])], lrf.z[audit.row[k]], truth[reading[k]]
        middle = lrf.extra["ends"][audit.row[k]].mean()
        a = psi + pose[2]
        x = pose[0] + r * math.cos(a) - middle * math.sin(a)
        y = pose[1] + r * math.sin(a) + middle * math.cos(a)
        # where the segment truly is, against the wall it was matched with: half the walls' distance is wrong
        wrong += abs(x * math.cos(line.beta) + y * math.sin(line.beta) - line.rho) > 0.1
    assert (audit.verdict == 0).sum() > 200
    assert wrong == 0
    assert (evaluate(found, drive).figures["position_max_m"] or math.inf) < 0.15


def test_the_mount_moves_lines_into_the_base_frame() -> None:
    """A laser yawed, shifted or upside-down sees the same walls from the base."""
    base = World(sigma_range=0.0, mount=(0.0, 0.0, 0.0), beams=361, seconds=2.0)
    turned = replace(base, mount=(0.2, -0.1, 0.4))
    poses = []
    for world in (base, turned):
        drive, _ = world.measured()
        lrf = drive.measurements["lrf"]
        z = lrf.z[lrf.first[5] : lrf.first[6]]
        poses.append({(round(float(r), 1), round(float(p), 1)) for r, p in z})
    assert len(poses[0] & poses[1]) >= 3


def test_a_round_room_leaves_the_pose_to_the_wheels_and_says_why() -> None:
    made = experiment.simulated("round_room", (*LOCK_STEP, "camera.enabled=false", "path.laps=0.3"), 3)
    drive, robot = made.measured()
    (note,) = drive.measurements["lrf"].notes
    assert "curved walls" in note
    found = {f.code: f.message for f in examine(drive, robot, made.streams) if f.role == "lrf"}
    assert "no line in" in found["blind"]
    assert "its settings do not fit" in found["blind"]  # its ranges are not empty
    assert found["seen"] == note
    np.testing.assert_allclose(fuse(drive, robot, ("lrf",)).pose, fuse(drive, robot, ()).pose, atol=1e-9)


# --- sonar: echoes of the laser's walls, against ray casting and finite differences

RNG = np.random.default_rng(3)
Segment = tuple[tuple[float, float], tuple[float, float]]
SQUARE: list[Segment] = [((0, 0), (4, 0)), ((4, 0), (4, 3)), ((4, 3), (0, 3)), ((0, 3), (0, 0))]


def map_of(segments: list[Segment], inside: tuple[float, float] = (2.0, 1.5)) -> LineMap:
    """A line map of segments, their normals pointing from `inside` into the wall, anchored at their middles."""
    lines = LineMap()
    for a, b in segments:
        p, q = np.array(a, float), np.array(b, float)
        middle, half = 0.5 * (p + q), 0.5 * float(np.hypot(*(q - p)))
        beta = math.atan2(*((q - p) * (1, -1))) if half else 0.0
        n = np.array([math.cos(beta), math.sin(beta)])
        if n @ (middle - inside) < 0:
            beta += math.pi
        lines.append(middle, np.array([0.0, beta]), np.diag([1e-6, 1e-6]), -1, (-half, half), 1)
    return lines


def belief_at(pose: tuple[float, float, float], sigma: float = 1e-3) -> JointBelief:
    return JointBelief(pose, (sigma**2, 0.0, 0.0, sigma**2, 0.0, sigma**2))


def test_an_echo_is_the_nearest_thing_that_rays_meet_or_none() -> None:
    lines, answered, silent = map_of(SQUARE), 0, 0
    walls = np.array([(*a, *b) for a, b in SQUARE], float)
    for _ in range(120):
        pose = (RNG.uniform(0.3, 3.7), RNG.uniform(0.3, 2.7), RNG.uniform(-4, 4))
        mount = (RNG.uniform(-0.1, 0.1), RNG.uniform(-0.1, 0.1), RNG.uniform(-2, 2))
        at = move(np.array(pose), np.array(mount))
        half = math.radians(12.0)
        echo = nearest_echo(lines, belief_at(pose), Cone(*mount, half, 0.0), 1e-6)
        seen = float(rooms.scan(walls, at, np.linspace(-half, half, 4001)).min())
        if echo is not None:
            assert echo.distance == pytest.approx(seen, abs=1e-5)
            answered += 1
        else:  # whatever is nearest is met on a slant: no wall's foot point lies in the cone at that distance
            feet = [abs(at[1]), abs(4 - at[0]), abs(3 - at[1]), abs(at[0])]
            assert min(abs(seen - f) for f in feet) > 1e-7
            silent += 1
    assert answered > 20
    assert silent > 20


def test_a_nearer_thing_in_the_cone_silences_the_wall_behind() -> None:
    post: list[Segment] = [((2.9, 1.45), (3.1, 1.65))]
    belief = belief_at((2.0, 1.5, 0.0))
    cone = Cone(0.0, 0.0, 0.0, math.radians(10.0), 0.0)
    free = present(nearest_echo(map_of(SQUARE), belief, cone, 0.02))
    assert free.distance == pytest.approx(2.0)
    assert nearest_echo(map_of(SQUARE + post), belief, cone, 0.02) is None


@pytest.mark.parametrize("frozen", [True, False])
@pytest.mark.parametrize("heading", [0.1, 0.1 - math.pi / 2.0])  # towards the wall along x, and along y
def test_the_jacobian_agrees_with_finite_differences(frozen: bool, heading: float) -> None:
    lines = map_of(SQUARE)
    start = (1.2, 1.1, heading)
    cone = Cone(0.2, -0.15, 1.5, math.radians(15.0), math.radians(3.0))
    belief: Any = belief_at(start)
    if not frozen:
        belief = JointBelief(start, (1e-6, 0.0, 0.0, 1e-6, 0.0, 1e-6), [])
        for j in range(len(lines)):
            lines.column[j] = belief.augment(lines.value[j], np.zeros((2, 3)), np.eye(2) * 1e-6)

    def distance(dx: Array) -> float:
        if frozen:
            moved: Any = belief_at((start[0] + dx[0], start[1] + dx[1], start[2] + dx[2]))
        else:
            moved = belief
            moved.state[:] = np.concatenate((start, *lines.value)) + dx
        echo = present(nearest_echo(lines, moved, cone, 0.02))
        return echo.distance

    n = 3 if frozen else 3 + 2 * len(lines)
    echo = present(nearest_echo(lines, belief, cone, 0.02))
    H = np.zeros(n)
    H[:3] = echo.H[0]
    if not frozen:
        H[list(echo.columns)] = echo.H_block[0]
        assert echo.map_variance == 0.0
    for k in range(n):
        step = np.zeros(n)
        step[k] = 1e-6
        assert (distance(step) - distance(-step)) / 2e-6 == pytest.approx(H[k], abs=1e-6)


@pytest.mark.parametrize(("distance", "sigma"), [(2.0, 0.03), (0.5, 0.1), (0.12, 0.1), (0.08, 0.1), (1e-3, 0.1)])
def test_an_echo_is_refused_from_where_clutter_is_as_likely(distance: float, sigma: float) -> None:
    """A quarter of the echoes come from what the map lacks, anywhere before the wall."""

    def of_the_wall(nis: float) -> float:
        return 0.75 * math.exp(-0.5 * nis) / (math.sqrt(2.0 * math.pi) * sigma)

    clutter, nis = 0.25 / distance, likelier(distance, sigma)
    if of_the_wall(0.0) < clutter:
        assert nis == 0.0
    else:
        assert of_the_wall(nis) == pytest.approx(clutter)


def ranges(values: Any, topic: str = "/sonar") -> ArrayStream:
    n = len(values)
    told: dict[str, Any] = {"field_of_view": 0.35, "min_range": 0.03, "max_range": 4.0, "range": np.array(values)}
    data: dict[str, Any] = {name: np.broadcast_to(np.float32(value), n) for name, value in told.items()}
    return ArrayStream(topic, "sensor_msgs/msg/Range", np.arange(n) * 10**8, data)


def test_no_echo_is_no_measurement_in_every_drivers_way_of_saying_it() -> None:
    stream = ranges([1.0, math.inf, 4.0, 0.03, -math.inf, math.nan, 2.0, 5.0, 0.0])
    m = Sonar().measure(stream, SonarSettings(), None, 0)  # type: ignore[arg-type]  # asks the wheels nothing
    assert m.z[:, 0].tolist() == [1.0, 2.0]
    assert len(m.t) == 8
    assert m.absent == 6
    assert m.dropped == {"not_finite": 1}


SONARS = ("camera.enabled=false", "compass.enabled=false", "gps.enabled=false")


@pytest.fixture(scope="module")
def toured() -> tuple[Drive, Robot]:
    return tour(2)


def tour(seed: int) -> tuple[Drive, Robot]:
    scenario = scenarios.load("extras", SONARS)
    streams, tables, _ = in_memory(scenario, seed)
    mounts = {f"/sonar/{s.name}": [s.x, s.y, s.yaw_deg] for s in scenario.sonar}
    robot = make_robot({**tables, "sonar": {"mounts": mounts, "sigma": 0.02}})
    roles = {
        "wheels": streams["/joint_states"],
        "truth": streams["/ground_truth/pose"],
        "lrf": streams["/scan"],
        "sonar": merged([streams[topic] for topic in mounts]),
    }
    return measure(roles, robot), robot


def test_echoes_fit_the_laser_map_of_a_simulated_tour(toured: tuple[Drive, Robot]) -> None:
    drive, robot = toured
    e = fuse(drive, robot, ("lrf", "sonar"))
    figures = evaluate(e, drive).sensors["sonar"]
    assert figures.accepted > 250
    assert figures.verdicts.get("gate", 0) < 0.2 * figures.accepted
    assert figures.nis is not None
    assert 0.7 < figures.nis < 1.5


def test_sonars_hold_the_robot_where_the_laser_sees_it_seldom(toured: tuple[Drive, Robot]) -> None:
    """In the median: with a scan in ten seconds an echo can be matched with a wrong wall."""
    ratios = []
    for drive, robot in (toured, *map(tour, (3, 4, 5))):
        rare = [parse(words, drive).fuse(drive, robot)[0] for words in ("lrf@0.1Hz", "lrf@0.1Hz,sonar")]
        alone, helped = (evaluate(e, drive).figures["position_rmse_m"] for e in rare)
        assert alone is not None
        assert helped is not None
        ratios.append(helped / alone)
    assert np.median(ratios) < 0.8


def test_a_sonar_is_compared_beside_the_laser_and_never_alone(toured: tuple[Drive, Robot]) -> None:
    drive, _ = toured
    assert [c.name for c in for_comparison((), drive)] == ["odometry", "lrf", "all"]
    with pytest.raises(UsageError, match="--sensors lrf,sonar"):
        parse("sonar", drive)


def test_without_a_laser_there_is_no_sonar_and_the_reason_is_given(toured: tuple[Drive, Robot]) -> None:
    _, robot = toured
    streams, *_ = in_memory(scenarios.load("extras", (*SONARS, "lrf.enabled=false", "path.length=4")), 2)
    sonar = merged([streams[t] for t in sorted(streams) if "sonar" in t])
    drive = measure({"wheels": streams["/joint_states"], "sonar": sonar}, robot, {"lrf": "no topic"})
    assert "lrf" in drive.absent["sonar"]
    assert "sonar" not in drive.measurements
