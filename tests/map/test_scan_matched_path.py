"""A map is left where scans along the path say: the chain of matches, and what the pose and the mount learn."""

import math
from dataclasses import dataclass, field

import numpy as np
import pytest
import rooms

from locfuse.fusion import se2
from locfuse.fusion.data import Array, Ints, Measurements, Points
from locfuse.fusion.ekf.belief_arrays import JointBelief
from locfuse.fusion.map import small_maps
from locfuse.fusion.map.small_maps import DRIFT_RAD_PER_M, MIN_KEYS, ScanMatchedPath, compared, end_pose
from locfuse.fusion.mount import Mount
from locfuse.fusion.scan_matching.neighbours import MATCH_WIDTH, key_scans
from locfuse.fusion.scan_matching.solve import Edges
from locfuse.fusion.sensors.lrf import LrfSettings

MATCHED = np.diag([1.0 / 0.02**2, 1.0 / 0.02**2, 1.0 / math.radians(0.3) ** 2])
CORNERS = np.array([(-4.0, -3.0), (6.0, -3.0), (6.0, 5.0), (4.0, 5.0), (4.0, 7.0), (-4.0, 7.0)])  # m
ROOM = rooms.ring(CORNERS)


def keys_along(path: Array, rng: np.random.Generator) -> tuple[Array, Edges]:
    """Return keys at poses (n, 3) whose matches with the next and the one after it have the noise they claim."""
    n = len(path)
    i = np.concatenate((np.arange(n - 1), np.arange(n - 2)))
    j = np.concatenate((np.arange(1, n), np.arange(2, n)))
    noise = rng.normal(size=(len(i), 3)) @ np.linalg.cholesky(np.linalg.inv(MATCHED)).T
    pose = se2.between(path[i], path[j]) + noise
    return pose[: n - 1], Edges.of(i, j, pose, np.tile(MATCHED, (len(i), 1, 1)), MATCH_WIDTH)


def arc(n: int) -> Array:
    return se2.chain(np.tile((0.5, 0.0, 0.1), (n - 1, 1)))


def test_the_covariance_of_a_chain_covers_its_error_and_a_heading_that_drifts() -> None:
    path = arc(30)
    rng = np.random.default_rng(2)
    drives = [end_pose(*keys_along(path, rng)) for _ in range(60)]
    errors = np.array([z for z, _ in drives]) - se2.between(path[0], path[29])
    claimed = drives[-1][1]
    nees = float(np.mean([e @ np.linalg.solve(claimed, e) for e in errors])) / 3.0
    assert 0.1 < nees < 1.0
    assert claimed[2, 2] > errors[:, 2].var() + 0.9 * (DRIFT_RAD_PER_M * 14.5) ** 2


def test_a_false_match_is_left_out_by_the_others() -> None:
    path = arc(20)
    keys = keys_along(path, np.random.default_rng(3))
    honest, _ = end_pose(*keys)
    wrong = 19 + 9  # the match of key 9 with key 11
    keys[1].z[wrong] += (0.3, -0.4, math.radians(15.0))
    z, _ = end_pose(*keys)
    np.testing.assert_allclose(z, honest, atol=0.06)


@pytest.mark.parametrize("yaw_deg", [0.0, 2.0])
def test_a_chain_is_compared_by_the_mount_that_the_scans_were_told(yaw_deg: float) -> None:
    """The laser sits elsewhere than told: scans put into a base by the wrong mount see another path of it."""
    mount = Mount("lrf", LrfSettings(x=0.2, y=0.05, yaw_deg=3.0), observable=True)
    belief = JointBelief((5.0, 1.0, 0.4), (0.01, 0.0, 0.0, 0.01, 0.0, 0.01), mount.blocks())
    sits = np.array((0.23, 0.04, math.radians(3.0 + yaw_deg)))
    for column, value in zip(mount.columns(belief), sits, strict=True):
        belief.state[column] = value
    origin, told_mount = np.array((1.0, -2.0, -0.3)), np.array(mount.configured)
    laser = se2.between(se2.compose(origin, sits), se2.compose(np.array(belief.pose()), sits))
    z = se2.compose(se2.compose(told_mount, laser), se2.inverse(told_mount))
    equation = compared(z, np.eye(3), origin, np.zeros(3), mount, belief)
    np.testing.assert_allclose(equation.y, 0.0, atol=1e-12)
    assert equation.H.shape == (3, 6)
    turned = equation.H[:2, 5]  # by the laser's yaw the path is turned about the base
    assert np.hypot(*turned) == pytest.approx(np.hypot(*z[:2]), rel=0.05)


def test_a_mount_that_is_exact_leaves_the_derivative_of_a_path() -> None:
    belief = JointBelief((5.0, 1.0, 0.4), (0.01, 0.0, 0.0, 0.01, 0.0, 0.01), ())
    origin = np.array((1.0, -2.0, -0.3))
    equation = compared(np.zeros(3), np.eye(3), origin, np.zeros(3), None, belief)
    np.testing.assert_allclose(equation.H, se2.between_jacobians(origin, np.array(belief.pose()))[1], atol=1e-8)


@dataclass(frozen=True, eq=False)
class InRoom:
    """A laser at the base in ROOM: beams all round, 1 cm of noise; the wheels say what they are told to."""

    path: Array  # (n, 3) where it was, a reading a second
    wheels: Array  # (n, 3) where the wheels say it was
    mount: Array = field(default_factory=lambda: np.zeros(3))

    def take(self, readings: Ints) -> Points:
        return InRoom(self.path[readings], self.wheels[readings])

    def mounted(self, mount: Array) -> Points:
        return InRoom(self.path, self.wheels, mount)

    def moved(self, t_from: Array, t_to: Array) -> Array:
        return se2.between(self.wheels[np.rint(t_from).astype(int)], self.wheels[np.rint(t_to).astype(int)])

    def read(self, readings: Ints) -> list[Array]:
        return [seen_in_room(self.path[i], np.random.default_rng(i)) for i in readings.tolist()]


@dataclass(frozen=True, eq=False)
class Outside(InRoom):
    """Two echoes a scan, of nothing that has a surface."""

    def read(self, readings: Ints) -> list[Array]:
        return [np.array(((3.0, 1.0), (-2.0, 5.0))) for _ in readings]


def seen_in_room(pose: Array, rng: np.random.Generator) -> Array:
    bearing = np.linspace(-math.pi, math.pi, 360, endpoint=False)
    r = rooms.scan(ROOM, pose, bearing) + rng.normal(0.0, 0.01, 360)
    return np.asarray(r[:, None] * np.stack((np.cos(bearing), np.sin(bearing)), axis=-1))


def measured(points: InRoom) -> Measurements:
    n, none = len(points.path), np.zeros((0, 2, 2))
    t, first = np.arange(n, dtype=np.float64), np.zeros(n + 1, np.int64)
    return Measurements(t, first, none[:, 0], none, 0.01, np.zeros((2, 2)), points=points)


def tour() -> Array:
    return se2.chain(np.tile((0.1, 0.0, math.radians(2.0)), (90, 1)))


def test_keys_are_matched_within_centimetres_and_a_slip_of_the_wheels_is_found() -> None:
    path = tour()
    wheels = path.copy()
    wheels[40:] = se2.chained(
        se2.compose(wheels[39], np.array((0.1, 0.0, math.radians(17.0)))),  # the robot turned by 2 degrees only
        se2.between(path[40:-1], path[41:]),
    )[np.r_[0, : len(path) - 41]]
    m = measured(InRoom(path, wheels))
    keys = key_scans(m)
    assert key_scans(m) is keys
    assert len(keys.readings) >= 15
    assert len(keys.matches) > 2 * len(keys.readings)
    e = keys.matches.z - se2.between(path[keys.readings[keys.matches.i]], path[keys.readings[keys.matches.j]])
    assert np.abs(e[:, :2]).max() < 0.02
    assert np.degrees(np.abs(se2.wrap_all(e[:, 2]))).max() < 0.3


def followed(m: Measurements, poses: Array, begin: int = 0) -> ScanMatchedPath:
    """Return a path through a map on which the filter had the robot at poses (n, 3) from a reading on."""
    along = ScanMatchedPath(m, begin, poses[0].tolist())
    for reading, pose in enumerate(poses[1:].tolist(), begin + 1):
        along.add(reading, pose)
    return along


def at(pose: Array, sigma_m: float, sigma_deg: float) -> JointBelief:
    v = sigma_m**2
    return JointBelief(tuple(pose.tolist()), (v, 0.0, 0.0, v, 0.0, math.radians(sigma_deg) ** 2), ())


@pytest.mark.parametrize(("begin", "end"), [(0, 80), (3, 77), (7, 83)])
def test_a_pose_that_drifted_is_put_back_from_wherever_the_map_began_and_ends(begin: int, end: int) -> None:
    """Few readings are key scans: up to the first and from the last one the filter tells the path."""
    path = tour()
    m = measured(InRoom(path, path))
    drifted = se2.chain(np.tile((0.101, -0.0005, math.radians(2.04)), (90, 1)))
    along = followed(m, drifted[begin : end + 1], begin)
    belief = at(drifted[end], 0.2, 4.0)
    off = se2.between(drifted[begin], drifted[end]) - se2.between(path[begin], path[end])
    along.end(None, belief)
    e = se2.between(drifted[begin], np.array(belief.pose())) - se2.between(path[begin], path[end])
    assert np.hypot(off[0], off[1]) > 0.1
    assert np.hypot(e[0], e[1]) < 0.05
    assert math.degrees(abs(off[2])) > 2.5
    assert math.degrees(abs(e[2])) < 1.0
    assert e @ np.linalg.solve(belief.matrix(), e) < 11.3


def test_a_pose_that_claimed_too_much_claims_less() -> None:
    path = tour()
    m = measured(InRoom(path, path))
    last = int(key_scans(m).readings[-1])
    drifted = path.copy()
    drifted[last] = se2.compose(path[last], np.array((0.1, -0.05, math.radians(3.0))))
    sure = at(drifted[last], 0.001, 0.1)
    followed(m, drifted[: last + 1]).end(None, sure)
    assert math.degrees(math.sqrt(sure.matrix()[2, 2])) > 0.2


def test_a_path_of_too_many_few_or_no_points_is_left_as_it_is(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    path = tour()
    m = measured(InRoom(path, path))
    belief = at(np.zeros(3), 0.1, 6.0)
    followed(Measurements(m.t, m.first, m.z, m.R_unit, m.scale, m.floor), path).end(None, belief)
    followed(m, path[: int(key_scans(m).readings[MIN_KEYS - 1]) + 1]).end(None, belief)
    ScanMatchedPath(m, 1, path[1]).end(None, belief)  # none
    monkeypatch.setattr(small_maps, "MAX_KEYS", 5)
    followed(m, path).end(None, belief)
    assert belief.pose() == (0.0, 0.0, 0.0)


def test_a_turn_that_the_wheels_missed_between_two_keys_is_told_by_the_scans_between() -> None:
    """The robot turned by 40 degrees on the spot, scan by scan, and its wheels only slipped."""
    ahead, spin = np.array((0.1, 0.0, 0.0)), np.array((0.0, 0.0, math.radians(5.0)))
    path = se2.chain(np.vstack([*[ahead] * 23, *[spin] * 8, *[ahead] * 20]))
    wheels = se2.chain(np.vstack([*[ahead] * 23, *[spin * 0.3] * 8, *[ahead] * 20]))
    m = measured(InRoom(path, wheels))
    keys = key_scans(m)
    e = keys.steps - se2.between(path[keys.readings[:-1]], path[keys.readings[1:]])
    assert np.degrees(np.abs(se2.wrap_all(e[:, 2]))).max() < 0.3
    assert np.abs(e[:, :2]).max() < 0.03


def test_scans_without_any_surface_tell_nothing_and_do_no_harm() -> None:
    """A square far out of reach: the wheels alone tell the path."""
    path = tour()
    m = measured(Outside(path, path))
    keys = key_scans(m)
    assert not len(keys.matches)
    by_path = se2.between(path[keys.readings[:-1]], path[keys.readings[1:]])
    np.testing.assert_allclose(keys.steps, by_path, atol=1e-9)
