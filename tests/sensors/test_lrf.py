"""The laser: Jacobians by finite differences, frames, deskewing, and what must not be matched."""

from __future__ import annotations

import math

import numpy as np
import pytest
from lock_step import simulated
from msgspec.structs import replace
from textbook import numeric_jacobian
from worlds import ROOM, World

from locfuse.fusion.checks.examine import blind
from locfuse.fusion.data import MapLine
from locfuse.fusion.ekf.belief_arrays import JointBelief
from locfuse.fusion.fuse import fuse
from locfuse.fusion.judge.evaluate import evaluate
from locfuse.fusion.map.line_map import LineMap
from locfuse.fusion.measure import measure


def test_map_lines_are_reported_about_the_origin() -> None:
    belief = JointBelief((0.0, 0.0, 0.0), (0.0,) * 6)
    lines = LineMap()
    P = np.array([[1e-4, 2e-5], [2e-5, 1e-5]])
    lines.append(np.array([3.0, 4.0]), np.array([0.1, 0.5]), P, -1, (-1.0, 2.0), 0)
    line: MapLine = lines.lines(belief)[0]
    n, tangent = np.array([math.cos(0.5), math.sin(0.5)]), np.array([-math.sin(0.5), math.cos(0.5)])
    assert line.rho == pytest.approx(0.1 + n @ [3.0, 4.0])
    assert line.ends == pytest.approx((tangent @ [3.0, 4.0] - 1.0, tangent @ [3.0, 4.0] + 2.0))
    G = numeric_jacobian(
        lambda v: np.array([v[0] + np.array([math.cos(v[1]), math.sin(v[1])]) @ [3.0, 4.0], v[1]]),
        np.array([0.1, 0.5]),
    )
    np.testing.assert_allclose(line.P, G @ P @ G.T, atol=1e-9)


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
    robot = world.robot()
    drive = measure(world.streams(), robot)
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
        robot = world.robot()
        drive = measure(world.streams(), robot)
        lrf = drive.measurements["lrf"]
        z = lrf.z[lrf.first[5] : lrf.first[6]]
        poses.append({(round(float(r), 1), round(float(p), 1)) for r, p in z})
    assert len(poses[0] & poses[1]) >= 3


def test_a_round_room_leaves_the_pose_to_the_wheels_and_says_why() -> None:
    drive, robot = simulated(3, "round_room", ("path.laps=0.3",))
    (note,) = drive.measurements["lrf"].notes
    assert "curved walls" in note
    dead, why = blind("lrf", drive.measurements["lrf"])
    assert "no line in" in dead.message
    assert why.message == note
    np.testing.assert_allclose(fuse(drive, robot, ("lrf",)).pose, fuse(drive, robot, ()).pose, atol=1e-9)
