"""Where may a scan have been taken? Held against sight lines and shares written out."""

import math
from typing import Any

import numpy as np
import pytest
from interpreted import interpreted
from line_scene import scene

from locfuse.fusion import se2
from locfuse.fusion.data import Array
from locfuse.fusion.kernels import places
from locfuse.fusion.kernels.arrays import view
from locfuse.fusion.lines import extract
from locfuse.fusion.lines.extract import rows_in_base
from locfuse.fusion.map import place_search
from locfuse.fusion.map.line_map import LineMap
from locfuse.fusion.map.place_search import behind_walls, explained, hypotheses, seen_through, walls_of
from locfuse.fusion.map.scan import Scan

SEEDS = range(40)


def known_scene(seed: int) -> tuple[Scan, LineMap, Array, tuple[float, float, float]]:
    scan, lines, belief = scene(seed, False)
    lines.hits[:] = 9
    lines.hits[::7] = 1  # not seen often enough to count
    return scan, lines, lines.values(belief), belief.pose()


def hidden(point: Array, eye: Array, lines: LineMap, values: Array, both: bool) -> bool:
    """Whether a wall stands between eye and point: by the parameters of two lines that cross."""
    far = float(np.linalg.norm(point - eye))
    for j in np.flatnonzero(lines.hits >= 4):
        rho, beta = values[j]
        n, along = np.array([math.cos(beta), math.sin(beta)]), np.array([-math.sin(beta), math.cos(beta)])
        a, b = (lines.anchor[j] + rho * n + end * along for end in (lines.lo[j], lines.hi[j]))
        ahead = (point - eye) / max(far, 1e-12)
        facing = float(ahead @ n)
        if (abs(facing) if both else facing) <= 0.1:
            continue
        run = (b - a) / np.linalg.norm(b - a)
        s, w = np.linalg.solve(np.array([ahead, -run]).T, a - eye)
        if 0.0 < s < far - 0.3 and 0.2 < w < np.linalg.norm(b - a) - 0.2:
            return True
    return False


@pytest.mark.parametrize("both", [False, True])
def test_what_lies_behind_walls_is_what_sight_lines_say(both: bool) -> None:
    total = 0.0
    for seed in SEEDS:
        scan, lines, values, pose = known_scene(seed)
        shares = np.zeros(len(scan.z))
        for i, ((r, psi), (low, high)) in enumerate(zip(scan.z.tolist(), scan.ends.tolist(), strict=True)):
            for k in range(5):
                along = low + (k + 0.5) / 5 * (high - low)
                local = np.array([r * math.cos(psi), r * math.sin(psi), 0.0])
                local[:2] += along * np.array([-math.sin(psi), math.cos(psi)])
                point = se2.compose(np.array(pose), local)[:2]
                shares[i] += hidden(point, np.array(pose[:2]), lines, values, both) / 5
        np.testing.assert_allclose(behind_walls(scan, walls_of(lines, values), pose, both), shares, atol=1e-12)
        length = scan.ends[:, 1] - scan.ends[:, 0]
        expected = (shares * length).sum() / length.sum()
        assert seen_through(scan, walls_of(lines, values), pose, both) == pytest.approx(expected, abs=1e-12)
        total += shares.sum()
    assert total > 5.0


def test_what_a_place_explains_is_what_its_walls_overlap() -> None:
    seen = 0
    for seed in SEEDS:
        scan, lines, values, pose = known_scene(seed)
        known = np.flatnonzero(lines.hits >= 4)
        poses = np.array(pose) + np.random.default_rng(seed).normal(0.0, 0.2, (20, 3))
        found = explained(poses, scan, walls_of(lines, values), 2.0)
        for p, (x, y, theta) in enumerate(poses.tolist()):
            share = possible = total = 0.0
            count = 0
            for (r, psi), (low, high) in zip(scan.z.tolist(), scan.ends.tolist(), strict=True):
                same = whole = False
                for j in known:
                    rho, beta = values[j]
                    c, s = math.cos(beta), math.sin(beta)
                    away = (x - lines.anchor[j, 0], y - lines.anchor[j, 1])
                    apart = r - (rho - away[0] * c - away[1] * s)
                    along = away[1] * c - away[0] * s
                    if abs(se2.wrap(psi + theta - beta)) < math.radians(10.0) and abs(apart) < 0.5:
                        common = min(high + along, lines.hi[j]) - max(low + along, lines.lo[j])
                        same, whole = True, whole or common > 0.6 * (high - low)
                share, possible = share + whole * (high - low), possible + same * (high - low)
                total, count = total + high - low, count + whole
            assert (found[0][p], found[1][p]) == pytest.approx((share / total, possible / total), abs=1e-12)
            assert found[2][p] == count
            seen += count
    assert seen > 20


def test_a_hypothesis_lays_both_walls_onto_theirs_and_shares_what_their_angles_miss() -> None:
    """Place by the two equations n.(p - a) = rho - r, heading by the mean of what either wall says."""
    lines = LineMap()
    walls = [(2.9, 0.4, 0.1, 0.3), (0.2, 2.1, 1.4, -0.2), (-3.0, 0.6, 2.5, 0.5)]  # anchor, beta, rho
    for x, y, beta, rho in walls:
        lines.append(np.array([x, y]), np.array([rho, beta]), np.eye(2) * 1e-6, -1, (-2.0, 2.0), 0)
    lines.hits[:] = 9
    theta, noise = 0.7, np.array([0.02, -0.03, 0.01])
    z = np.column_stack(([2.0, 1.7, 2.2], lines.value[:, 1] - theta + noise))
    scan = Scan.of(z, np.tile(1e-6 * np.eye(2), (3, 1, 1)), np.tile((-1.0, 1.0), (3, 1)))
    poses = hypotheses(scan, walls_of(lines, lines.value))
    n = np.column_stack((np.cos(lines.value[:, 1]), np.sin(lines.value[:, 1])))
    distance = lines.value[:, 0] + (n * lines.anchor).sum(axis=1) - z[:, 0]
    for a, b in ((0, 1), (0, 2), (1, 2)):
        place = np.linalg.solve(n[[a, b]], distance[[a, b]])
        expected = [*place, theta - 0.5 * (noise[a] + noise[b])]
        assert np.abs(poses - expected).max(axis=1).min() < 1e-12


def test_every_two_seen_walls_lie_on_every_two_known_ones_at_their_angle() -> None:
    """Within five degrees; of two walls that differ by less than 25 nothing is made."""
    total = 0
    for seed in SEEDS:
        scan, lines, values, _ = known_scene(seed)
        psi, beta, count = scan.z[:, 1], values[:, 1], 0
        longest = np.argsort(-(scan.ends[:, 1] - scan.ends[:, 0]), kind="stable")[:5]
        for i, a in enumerate(longest):
            for b in longest[i + 1 :]:
                if abs(math.sin(psi[b] - psi[a])) >= math.sin(math.radians(25.0)):
                    apart = beta[None, :] - beta[:, None] - (psi[b] - psi[a])
                    count += int((np.abs(se2.wrap_all(apart)) < math.radians(5.0)).sum())
        assert len(hypotheses(scan, walls_of(lines, values, np.arange(len(lines))))) == count
        total += count
    assert total > 200


def test_the_interpreted_kernel_agrees(monkeypatch: pytest.MonkeyPatch) -> None:
    for seed in SEEDS:
        scan, lines, values, pose = known_scene(seed)

        def everything() -> list[Any]:
            walls = walls_of(lines, values)  # noqa: B023
            poses = hypotheses(scan, walls)  # noqa: B023
            found = poses, behind_walls(scan, walls, pose, True)  # noqa: B023
            scan_in_base = rows_in_base(scan.rows, 0.3, -0.2, 0.7)  # noqa: B023
            return [*found, scan_in_base, *explained(poses, scan, walls)]  # noqa: B023

        one = everything()
        with monkeypatch.context() as patch:
            for user in (place_search, extract):
                patch.setattr(user, "places", interpreted("places"))
            for a, b in zip(everything(), one, strict=True):
                np.testing.assert_allclose(a, b, rtol=1e-9, atol=1e-9)


def test_a_line_of_a_turned_laser_is_the_same_line_from_the_base() -> None:
    """Both of its ends, put into the base by the mount; a line that is no number stays none."""
    rng = np.random.default_rng(2)
    rest = np.tile([1e-4, 0.0, 1e-6, -1.0, 1.6], (50, 1))
    rows = np.column_stack((rng.uniform(0.05, 2.0, 50), rng.uniform(-3, 3, 50), rest))
    rows[7, 1], rows[8, 1] = math.nan, math.inf
    x, y, yaw = mount = (0.3, -0.2, 0.7)
    out = np.empty_like(rows)
    places.into_base(view(rows), len(rows), x, y, yaw, view(out))
    assert np.isnan(out[[7, 8]]).all()
    behind = 0
    for k in np.delete(np.arange(50), [7, 8]):
        ends = np.array([point_on(rows[k], side) for side in (5, 6)])
        theirs = se2.transform(np.array(mount), ends)
        ours = np.array([point_on(out[k], side) for side in (5, 6)])
        if np.abs(ours - theirs).max() > 1e-9:  # a line that the base sees from behind has its ends exchanged
            ours, behind = ours[::-1], behind + 1
        np.testing.assert_allclose(ours, theirs, atol=1e-9)
        assert out[k, 0] >= 0.0
        assert out[k, 5] <= out[k, 6]
    assert behind > 1


def point_on(row: Array, end: int) -> Array:
    """One end (2,) of a line (r, psi, ..., both ends along it)."""
    n = np.array([math.cos(row[1]), math.sin(row[1])])
    return np.asarray(row[0] * n + row[end] * np.array([-n[1], n[0]]))


def test_the_noise_of_a_line_seen_from_the_base_is_that_of_finite_differences() -> None:
    """Its covariance, and unit errors that lines share: their outer product is a covariance too."""
    rng = np.random.default_rng(3)
    mount, parts = (0.3, -0.2, 0.7), 2
    shared = rng.normal(0.0, 0.01, (40, 2, parts))
    R = shared @ shared.transpose(0, 2, 1)
    z = np.column_stack((rng.uniform(0.05, 1.0, 40), rng.uniform(-3.0, 3.0, 40)))
    rows = np.column_stack((z, R[:, 0, 0], R[:, 0, 1], R[:, 1, 1], np.tile([-1.0, 1.0], (40, 1))))
    out, G = np.empty_like(rows), np.empty((40, 2, parts))
    places.into_base(view(rows), 40, *mount, view(out))
    places.shares_into_base(view(rows), 40, *mount, view(shared), view(G))
    turned = 0
    for k in range(40):
        side = from_base(z[k], mount)[2]
        J = np.column_stack(
            [
                (np.array(from_base(z[k] + d, mount, side)) - from_base(z[k] - d, mount, side))[:2] / 2e-6
                for d in 1e-6 * np.eye(2)
            ]
        )
        np.testing.assert_allclose([[out[k, 2], out[k, 3]], [out[k, 3], out[k, 4]]], J @ R[k] @ J.T, atol=1e-9)
        np.testing.assert_allclose(G[k], J @ shared[k], atol=1e-9)
        turned += side < 0.0
    assert turned > 1


def from_base(
    z: Array, mount: tuple[float, float, float], side: float | None = None
) -> tuple[float, float, float]:
    """(r, psi) from the base of a line that is (r, psi) from a mount, and on which side of it the base stands."""
    psi = z[1] + mount[2]
    r = float(z[0] + mount[0] * math.cos(psi) + mount[1] * math.sin(psi))
    side = side or math.copysign(1.0, r)
    return side * r, psi, side


def test_from_one_mount_to_another_leads_what_undoes_the_one_and_does_the_other() -> None:
    told, place, out = np.array([0.3, -0.2, 0.7]), np.array([0.35, -0.1, -0.9]), np.empty(3)
    places.moved(view(place), view(told), view(out))
    np.testing.assert_allclose(se2.compose(out, told), place, atol=1e-12)
