"""Smoothing: what the whole drive, its end included, says of every instant (Rauch, Tung, Striebel 1965).

Backward through the filter's journal: undo each prediction; map lines leave where they were born, and dropped ones
return. Holds where the filter's gain is the optimal one: not for the frozen and the considered map.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from locfuse.fusion.ekf.belief_arrays import JointBelief
from locfuse.fusion.ekf.equations import eq5_x, eq6_noise, eq7_A
from locfuse.fusion.ekf.journal import Birth, Drop, Journal, Step
from locfuse.fusion.wheels.states import WHEELS

from . import se2
from .data import Array, Drive, Estimates, UsageError, upper_triangles
from .fuse import fuse
from .robot import Robot

SUFFIX = " smoothed"
NOT_OPTIMAL = ("first-scan", "consider")
RANK = 1e-12  # relative eigenvalue below which the wheels' noise has no extent


def check_optimal(robot: Robot, sensors: Sequence[str]) -> None:
    """Raise UsageError where these sensors' filter does not weigh optimally: smoothing assumes that it does."""
    if robot.preset == "paper":
        raise UsageError(
            "--smooth: the filter as printed in the paper has no optimal gain; leave --preset paper out"
        )
    for sensor in sensors:
        mode = getattr(robot.settings(sensor), "map", None)
        if mode in NOT_OPTIMAL:
            raise UsageError(
                f"--smooth: {sensor}.map = {mode} does not weigh optimally, and smoothing assumes that it does. "
                f"Use --set {sensor}.map=refine or grow"
            )


def fuse_and_smooth(
    drive: Drive, robot: Robot, sensors: Sequence[str], name: str | None = None
) -> tuple[Estimates, Estimates]:
    """Run the filter and the smoother: (filtered, smoothed). Raises UsageError where the gain is not optimal."""
    check_optimal(robot, sensors)
    journal = Journal()
    filtered = fuse(drive, robot, sensors, name, beliefs=(journal.pose, journal.joint))
    return filtered, smoothed(drive, filtered, journal)


def smoothed(drive: Drive, filtered: Estimates, journal: Journal) -> Estimates:
    """Return the smoothed estimates of a run that wrote `journal`. Map and audits stay the filter's."""
    back = Backward(drive, filtered, journal)
    back.run(journal)
    wheels = back.blocks.get(WHEELS)
    truth_pose, truth_P = between_instants(drive, filtered, back, None if wheels is None else wheels[-1])
    return replace(
        filtered,
        name=filtered.name + SUFFIX,
        pose=back.pose,
        triangles=upper_triangles(back.P),
        blocks=back.blocks,
        block_sigmas=back.block_sigmas,
        truth_pose=truth_pose,
        truth_P=truth_P,
        smoothed=True,
    )


def against(reference: Estimates, e: Estimates) -> dict[str, float]:
    """Return how far an estimate is from another one on the same instants, such as from the smoothed one."""
    apart = np.hypot(*(e.pose[:, :2] - reference.pose[:, :2]).T)
    turned = se2.wrap_all(e.pose[:, 2] - reference.pose[:, 2])
    return {
        "position_rmse_m": float(np.sqrt((apart**2).mean())),
        "position_max_m": float(apart.max()),
        "heading_rmse_deg": float(np.degrees(np.sqrt((turned**2).mean()))),
    }


class Backward:
    """The backward pass: the smoothed state from the last instant to the first."""

    def __init__(self, drive: Drive, filtered: Estimates, journal: Journal) -> None:
        n = len(drive.t)
        self.pose, self.P = np.empty((n, 3)), np.empty((n, 3, 3))
        self.arrived, self.arrived_P = np.zeros((n, 3)), np.zeros((n, 3, 3))  # as the motion ended: before a shift
        self.ahead = np.zeros((n, 3, 3))  # covariance of the pose at k (rows) and as it arrived at k + 1 (columns)
        self.blocks = {name: np.empty_like(v) for name, v in filtered.blocks.items()}
        self.block_sigmas = {name: np.empty_like(v) for name, v in filtered.blocks.items()}
        belief = journal.belief
        joint = isinstance(belief, JointBelief)
        self._columns = {b: belief.block(b)[0] for b in self.blocks} if joint and belief is not None else {}
        self._x, self._S = journal.final()

    def run(self, journal: Journal) -> None:
        """Go through the journal from its end; what lies before the first instant is left."""
        k = len(self.pose) - 1
        self._note(k)
        for event in reversed(journal.events):
            if isinstance(event, Birth):
                self._x, self._S = self._x[: event.before], self._S[: event.before, : event.before]
            elif isinstance(event, Drop):
                self._restore(event)
            elif not event.instant:
                self._step(event)
            elif k > 0:
                self.arrived[k], self.arrived_P[k] = self._x[:3], self._S[:3, :3]
                self.ahead[k - 1] = self._step(event)[:3, :3]
                k -= 1
                self._note(k)

    def _step(self, step: Step) -> Array:
        rows, G, S = step.rows, step.G, self._S
        cross: Array = G @ S
        own = cross @ G.T + step.D
        self._x[rows] = step.c + G @ self._x
        S[rows, :] = cross
        S[:, rows] = cross.T
        S[np.ix_(rows, rows)] = 0.5 * (own + own.T)
        return cross

    def _restore(self, drop: Drop) -> None:
        n = len(self._x) + len(drop.columns)
        stay = np.setdiff1d(np.arange(n), drop.columns)
        cross = drop.G @ self._S
        x, S = np.empty(n), np.empty((n, n))
        x[stay], x[drop.columns] = self._x, drop.c + drop.G @ self._x
        S[np.ix_(stay, stay)] = self._S
        S[np.ix_(drop.columns, stay)], S[np.ix_(stay, drop.columns)] = cross, cross.T
        S[np.ix_(drop.columns, drop.columns)] = cross @ drop.G.T + drop.D
        self._x, self._S = x, S

    def _note(self, k: int) -> None:
        self.pose[k], self.P[k] = self._x[:3], self._S[:3, :3]
        for name, column in self._columns.items():
            where = slice(column, column + self.blocks[name].shape[1])
            self.blocks[name][k] = self._x[where]
            self.block_sigmas[name][k] = np.sqrt(np.maximum(np.diagonal(self._S)[where], 0.0))


def between_instants(
    drive: Drive, filtered: Estimates, back: Backward, wheels: Array | None
) -> tuple[Array | None, Array | None]:
    """Return smoothed poses (q, 3) and covariances at the truth's stamps; NaN outside the drive.

    A stamp lies on a bridge between two smoothed instants: what the wheels said on the way there, plus the share
    of what they missed over the whole interval that their noise assigns to the part before the stamp. All about
    the filter's own poses, since across the wheels' direction the noise is micrometres and bending is not.
    """
    if drive.truth_motions is None or drive.truth_instant is None:
        return None, None
    k = np.maximum(drive.truth_instant, 0)
    after = np.minimum(k + 1, len(drive.t) - 1)
    u, v = drive.truth_motions.u, drive.motions.u[after]
    if wheels is not None:  # their covariance is left out: over a part of an interval it is nothing
        u, v = u + drive.truth_motions.J @ wheels, v + drive.motions.J[after] @ wheels
    start = filtered.pose[k]
    at, end = eq5_x(start, u), eq5_x(start, v)
    to_at, to_end, on = eq7_A(start, at), eq7_A(start, end), eq7_A(at, end)
    turn = se2.rotation(start[:, 2])
    Q = eq6_noise(turn, drive.truth_motions.Q)
    whole = eq6_noise(turn, drive.motions.Q[after])
    share = Q @ on.transpose(0, 2, 1) @ np.linalg.pinv(whole, rcond=RANK, hermitian=True)
    share[k == after] = 0.0
    near = to_at - share @ to_end
    moved, moved_end = back.pose[k] - start, back.arrived[after] - end
    out = at + _apply(near, moved) + _apply(share, moved_end)
    cross = near @ back.ahead[k] @ share.transpose(0, 2, 1)
    P = near @ back.P[k] @ near.transpose(0, 2, 1) + share @ back.arrived_P[after] @ share.transpose(0, 2, 1)
    P += cross + cross.transpose(0, 2, 1) + Q - share @ on @ Q
    outside = drive.truth_instant < 0
    out[outside], P[outside] = np.nan, np.nan
    return out, P


def _apply(M: Array, x: Array) -> Array:
    """Matrix (n, 3, 3) times vector (n, 3)."""
    product: Array = np.einsum("nij,nj->ni", M, x)
    return product
