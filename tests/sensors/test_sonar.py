"""Sonar: echoes of the laser's walls, against ray casting and finite differences."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from locfuse.cli.analysis.configurations import for_comparison, parse
from locfuse.cli.analysis.robot_tables import make_robot
from locfuse.fusion.data import ArrayStream, Drive, UsageError
from locfuse.fusion.ekf.belief_arrays import JointBelief
from locfuse.fusion.fuse import fuse
from locfuse.fusion.judge.evaluate import evaluate
from locfuse.fusion.map.line_map import LineMap
from locfuse.fusion.map.sonar_echo import Cone, Echo, nearest_echo
from locfuse.fusion.measure import measure
from locfuse.fusion.robot import Robot
from locfuse.fusion.sensors.sonar import Sonar, SonarSettings, likelier
from locfuse.fusion.streams import merged
from locfuse.sample_logs import load as scenarios
from locfuse.sample_logs.record import in_memory

Array = NDArray[np.float64]
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


def cast(segments: list[Segment], at: Array, half: float) -> float:
    """Distance to the nearest point of any segment within a cone, by many rays."""
    angle = at[2] + np.linspace(-half, half, 4001)
    dx, dy = np.cos(angle), np.sin(angle)
    nearest = math.inf
    for (ax, ay), (bx, by) in segments:
        ex, ey, rx, ry = bx - ax, by - ay, ax - at[0], ay - at[1]
        with np.errstate(divide="ignore", invalid="ignore"):
            cross = dx * ey - dy * ex
            along, share = (rx * ey - ry * ex) / cross, (rx * dy - ry * dx) / cross
        met = along[(along > 0) & (share >= 0) & (share <= 1)]
        nearest = min(nearest, float(met.min(initial=math.inf)))
    return nearest


def belief_at(pose: tuple[float, float, float], sigma: float = 1e-3) -> JointBelief:
    return JointBelief(pose, (sigma**2, 0.0, 0.0, sigma**2, 0.0, sigma**2))


def test_an_echo_is_the_nearest_thing_that_rays_meet_or_none() -> None:
    lines, answered, silent = map_of(SQUARE), 0, 0
    for _ in range(120):
        pose = (RNG.uniform(0.3, 3.7), RNG.uniform(0.3, 2.7), RNG.uniform(-4, 4))
        mount = (RNG.uniform(-0.1, 0.1), RNG.uniform(-0.1, 0.1), RNG.uniform(-2, 2))
        c, s = math.cos(pose[2]), math.sin(pose[2])
        at = np.array(
            [pose[0] + c * mount[0] - s * mount[1], pose[1] + s * mount[0] + c * mount[1], pose[2] + mount[2]]
        )
        half = math.radians(12.0)
        echo = nearest_echo(lines, belief_at(pose), Cone(*mount, half, 0.0), 1e-6)
        seen = cast(SQUARE, at, half)
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
    free = nearest_echo(map_of(SQUARE), belief, cone, 0.02)
    assert free is not None
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
        echo = nearest_echo(lines, moved, cone, 0.02)
        assert echo is not None
        return echo.distance

    n = 3 if frozen else 3 + 2 * len(lines)
    echo = nearest_echo(lines, belief, cone, 0.02)
    assert echo is not None
    H = np.zeros(n)
    H[:3] = echo.H[0]
    if not frozen:
        H[list(echo.columns)] = echo.H_block[0]
        assert echo.map_variance == 0.0
    for k in range(n):
        step = np.zeros(n)
        step[k] = 1e-6
        assert (distance(step) - distance(-step)) / 2e-6 == pytest.approx(H[k], abs=1e-6)


def walls(*of: tuple[float, float, float, float]) -> LineMap:
    """Lines through a point (x, 0) with a direction beta of their normal, from `low` to `high` along them."""
    lines = LineMap()
    for x, beta, low, high in of:
        lines.append(np.array([x, 0.0]), np.array([0.0, beta]), np.diag([1e-6, 1e-6]), -1, (low, high), 1)
    return lines


def heard(
    lines: LineMap, half: float = 0.2, sigma: float = 0.1, pose: tuple[float, float, float] = (0.0, 0.0, 0.0)
) -> Echo | None:
    return nearest_echo(lines, belief_at(pose), Cone(0.0, 0.0, 0.0, half, 0.0), sigma)


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
    data = {
        "field_of_view": np.full(n, 0.35, np.float32),
        "min_range": np.full(n, 0.03, np.float32),
        "max_range": np.full(n, 4.0, np.float32),
        "range": np.array(values, np.float32),
    }
    return ArrayStream(topic, "sensor_msgs/msg/Range", np.arange(n) * 10**8, dict(data))


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
    roles = {
        "wheels": streams["/joint_states"],
        "sonar": merged([streams[t] for t in sorted(streams) if "sonar" in t]),
    }
    drive = measure(roles, robot, {"lrf": "no topic"})
    assert "lrf" in drive.absent["sonar"]
    assert "sonar" not in drive.measurements


def test_a_sonar_that_only_listens_teaches_the_map_nothing(toured: tuple[Drive, Robot]) -> None:
    drive, robot = toured
    listening = {"sonar": np.ones(len(drive.measurements["sonar"].t), dtype=bool)}
    plain, heard = fuse(drive, robot, ("lrf",)), fuse(drive, robot, ("lrf",), listen=listening)
    np.testing.assert_array_equal(plain.pose, heard.pose)
    assert len(heard.audits["sonar"].nis) > 500
