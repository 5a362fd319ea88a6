"""The whole drive: loops are closed where a place is seen again, and nowhere else."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest
from ring_drive import WIDTH, ring_drive, robot

from locfuse.fusion import se2
from locfuse.fusion.data import Array, Drive, Estimates
from locfuse.fusion.whole_drive import closures
from locfuse.fusion.whole_drive.between import Fixes, bridged
from locfuse.fusion.whole_drive.closures import recognised
from locfuse.fusion.whole_drive.odometry import Odometry, odometry_of
from locfuse.fusion.whole_drive.pose_graph import Graph, wheels_share, whole_drive


@cache
def solved(alike: bool = False) -> tuple[Drive, Array, Graph]:
    drive, truth = ring_drive(3, alike=alike)
    graph = whole_drive(drive, robot(), ["lrf"])
    assert graph is not None
    return drive, truth, graph


def worst(pose: Array, truth: Array) -> float:
    return float(np.hypot(*(pose - truth)[:, :2].T).max())


def test_a_ring_driven_twice_is_closed_and_straight() -> None:
    drive, truth, graph = solved()
    pose, P = graph.poses()
    assert worst(odometry_of(drive).pose, truth) > 1.5, "the wheels alone are good: the test shows nothing"
    assert worst(pose, truth) < 0.12
    assert len(graph.closures) >= 3
    assert "closed" in graph.notes()[0]
    assert (np.linalg.eigvalsh(P) > 0.0).all()


def test_a_loop_joins_two_times_at_which_the_robot_was_at_one_place() -> None:
    drive, truth, graph = solved()
    then, now = np.searchsorted(drive.t, graph.seen_again()[0]).T
    assert len(now) == len(graph.closures)
    assert (drive.t[now] - drive.t[then] > 10.0).all(), "that is no return"
    assert np.hypot(*(truth[now] - truth[then])[:, :2].T).max() < WIDTH, "that is another corridor"
    assert (np.diff(now) >= 0).all()


def test_the_claimed_covariance_covers_the_error() -> None:
    _, truth, graph = solved()
    pose, P = graph.poses()
    e = pose - truth
    e[:, 2] = se2.wrap_all(e[:, 2])
    later = slice(50, None)  # the start is known
    nees = np.einsum("ni,nij,nj->n", e[later], np.linalg.inv(P[later]), e[later])
    assert nees.mean() / 3.0 < 2.0


@pytest.mark.parametrize("alike", [False, True])
def test_no_closure_joins_two_places(alike: bool) -> None:
    """The ring with the same lockers on opposite sides looks the same from half a ring on."""
    _, truth, graph = solved(alike)
    e = graph.closures
    at = truth[graph.keys]
    apart = se2.between(e.z, se2.between(at[e.i], at[e.j]))
    assert np.hypot(apart[:, 0], apart[:, 1]).max(initial=0.0) < 0.15
    assert worst(graph.poses()[0], truth) < 0.2


def test_the_same_bytes_twice() -> None:
    _, _, graph = solved()
    drive, _ = ring_drive(3)
    again = whole_drive(drive, robot(), ["lrf"])
    assert again is not None
    for one, other in zip(graph.poses(), again.poses(), strict=True):
        assert one.tobytes() == other.tobytes()


def having_recognised(drive: Drive, truth: Array, *places: tuple[float, float], wrong: Any = 0.0) -> Estimates:
    """A run of the filter that recognised places, (then, now) [s] each, as they are or `wrong` by a pose."""
    then, now = np.searchsorted(drive.t, np.array(places).reshape(-1, 2)).T
    poses = se2.between(truth[then], truth[now]) + wrong
    found = drive.t[np.column_stack((then, now))]
    return Estimates("lrf", ("lrf",), drive.t, truth, np.zeros((len(truth), 6)), {}, loops=found, loop_poses=poses)


def returns(drive: Drive, truth: Array) -> list[tuple[float, float]]:
    """Some times (then, now) [s] at which the robot was at one place, one round of the ring apart."""
    k = np.arange(0, len(drive.t), 40)
    apart = np.hypot(*(truth[k, None, :2] - truth[None, k, :2]).transpose(2, 0, 1))
    i, j = np.nonzero((apart < 0.5) & (drive.t[k] - drive.t[k][:, None] > 20.0))
    return list(zip(drive.t[k[i]].tolist(), drive.t[k[j]].tolist(), strict=True))[:4]


def test_a_place_that_the_filter_recognised_lies_between_keys_where_the_truth_has_it() -> None:
    drive, truth, graph = solved()
    places = returns(drive, truth)
    edges = recognised(having_recognised(drive, truth, *places), odometry_of(drive), graph.keys)
    assert len(edges) == len(places) > 2
    at = truth[graph.keys]
    off = se2.between(edges.z, se2.between(at[edges.i], at[edges.j]))
    assert np.abs(off[:, :2]).max() < 0.05  # the wheels err over less than half a key's way
    assert np.abs(se2.wrap_all(off[:, 2])).max() < np.radians(2.0)


def test_without_a_search_what_the_filter_recognised_is_closed(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """After a long loop every window is too wide, as here, where a window is soon called wide."""
    monkeypatch.setattr(closures, "MAX_SEARCHES", 0)
    monkeypatch.setattr(closures, "NARROW_M", 0.05)
    monkeypatch.setattr(closures, "SIGMA_M", 0.02)
    drive, truth, _ = solved()
    lone = whole_drive(drive, robot(), ["lrf"])
    known = whole_drive(drive, robot(), ["lrf"], having_recognised(drive, truth, *returns(drive, truth)))
    assert lone is not None
    assert known is not None
    assert len(lone.closures) == 0
    assert worst(lone.poses()[0], truth) > 0.5
    assert len(known.closures) >= 3
    assert worst(known.poses()[0], truth) < 0.12


@pytest.mark.parametrize("wrong", [(6.0, 0.0, 0.0), (0.0, 0.0, np.pi), (0.0, -3.0, 0.4)])
def test_a_place_that_was_recognised_wrongly_bends_nothing(wrong: tuple[float, float, float]) -> None:
    drive, truth, graph = solved()
    misled = having_recognised(drive, truth, *returns(drive, truth), wrong=np.array(wrong))
    found = whole_drive(drive, robot(), ["lrf"], misled)
    assert found is not None
    assert worst(found.poses()[0], truth) < 0.12
    assert len(found.closures) >= 0.5 * len(graph.closures)


def test_a_drive_without_a_loop_closes_none_and_says_so() -> None:
    drive, _ = ring_drive(4, laps=0.75)
    graph = whole_drive(drive, robot(), ["lrf"])
    assert graph is not None
    assert not len(graph.closures)


def test_without_a_laser_or_with_a_given_map_there_is_no_graph() -> None:
    drive, _, _ = solved()
    assert whole_drive(drive, robot(), []) is None


def test_between_key_poses_the_way_leads_from_one_to_the_other() -> None:
    drive, truth, _ = solved()
    odometry = odometry_of(drive)
    keys = np.arange(0, len(drive.t), 25)
    P = np.tile(np.diag([1e-4, 1e-4, 1e-5]), (len(keys), 1, 1))
    fixes = Fixes.of_keys(odometry, keys, truth[keys])
    pose, out = bridged(odometry, odometry, np.arange(len(drive.t)), keys, truth[keys], P, 0.5 * P[1:], fixes)
    np.testing.assert_allclose(pose[keys], truth[keys], atol=1e-6)
    np.testing.assert_allclose(out[keys[:-1]], P[:-1], atol=1e-7)
    assert worst(pose, truth) < 0.05
    middle = (keys[:-1] + keys[1:]) // 2
    moving = np.hypot(*(truth[keys[1:]] - truth[keys[:-1]])[:, :2].T) > 0.3
    assert (out[middle, 0, 0] + out[middle, 1, 1] > 2e-4)[moving].all(), "between two keys less is known"


def test_turning_both_keys_turns_what_lies_between() -> None:
    drive, truth, _ = solved()
    odometry = odometry_of(drive)
    keys = np.arange(0, len(drive.t), 25)
    P = np.tile(np.eye(3) * 1e-4, (len(keys), 1, 1))
    k = np.arange(len(drive.t))
    G = np.array([3.0, -1.0, 2.0])
    fixes = Fixes.of_keys(odometry, keys, truth[keys])
    plain, _ = bridged(odometry, odometry, k, keys, truth[keys], P, P[1:], fixes)
    turned, _ = bridged(odometry, odometry, k, keys, se2.compose(G, truth[keys]), P, P[1:], fixes)
    np.testing.assert_allclose(turned, se2.compose(G, plain), atol=1e-9)


def test_scans_tell_how_much_of_their_noise_the_wheels_have() -> None:
    rng = np.random.default_rng(3)
    n, claimed, real = 400, np.radians(5.0), np.radians(0.5)
    turns = np.column_stack((np.full(n, 0.5), np.zeros(n), rng.normal(0.0, 0.1, n)))
    variances = np.cumsum(np.tile(np.diag([1e-4, 1e-4, claimed**2]), (n + 1, 1, 1)), axis=0)
    way = Odometry(np.vstack((np.zeros(3), np.cumsum(turns, axis=0))), variances)
    seen = way.pose.copy()
    seen[1:, 2] += np.cumsum(rng.normal(0.0, real, n))
    share = wheels_share(way, np.arange(n + 1), seen)
    assert share == pytest.approx((real / claimed) ** 2, rel=0.2)
    np.testing.assert_allclose(way.scaled(share).C[-1], share * way.C[-1])
