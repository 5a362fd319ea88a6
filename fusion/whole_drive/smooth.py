"""Smoothing: poses at all update times, estimated from the whole drive (Rauch, Tung, Striebel 1965).

There are two solvers. If a laser returned to places and the filter's map is inconsistent there, the pose graph
(whole_drive.pose_graph) closes these loops. Otherwise the backward pass below is more accurate: it uses every line
of every scan.

The backward pass processes the filter's events in reverse order: it smooths over each prediction, removes map
lines where they were added, and restores dropped lines. It requires the optimal gain, so it is not possible with
the map modes "first-scan" and "consider".
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np
from msgspec.structs import replace

from locfuse.fusion import se2
from locfuse.fusion.data import (
    LASER,
    Array,
    Drive,
    Estimates,
    Ints,
    LocfuseError,
    Motions,
    UsageError,
    upper_triangles,
)
from locfuse.fusion.ekf.equations import eq5_x, eq6_noise, eq7_A
from locfuse.fusion.ekf.events import (
    Added,
    Changed,
    Dropped,
    Events,
    FrameMoved,
    FrameTurned,
    Moved,
    Undone,
    VarianceAdded,
)
from locfuse.fusion.ekf.map_frame import map_covariance
from locfuse.fusion.fuse import fuse
from locfuse.fusion.mount import mount_blocks
from locfuse.fusion.robot import Robot
from locfuse.fusion.wheels.motion import WHEELS

from .pose_graph import Graph, may_have_loops, whole_drive

NOT_OPTIMAL = ("first-scan", "consider")
MAX_WALLS = 300  # of a given map: each is two states, and an update costs the square of their number
MIN_EIGENVALUE_SHARE = 1e-12  # relative eigenvalue below which the wheel noise counts as singular


def check_smoothing(robot: Robot, sensors: Sequence[str]) -> None:
    """Raise UsageError if a drive with these sensors cannot be smoothed (gain not optimal, too many walls)."""
    why = why_not_smoothed(robot, sensors)
    if why is not None:
        raise why


def why_not_smoothed(robot: Robot, sensors: Sequence[str]) -> UsageError | None:
    """Return the error that `check_smoothing` raises; None if a drive with these sensors can be smoothed."""
    if robot.preset == "paper":
        return UsageError(
            "--smooth: the filter as printed in the paper has no optimal gain; leave --preset paper out"
        )
    for sensor in sensors:
        mode = getattr(robot.settings(sensor), "map", None)
        if mode in NOT_OPTIMAL:
            fix = f"{sensor}.map=refine"
            return UsageError(
                f"--smooth: {sensor}.map = {mode} does not weigh optimally, and smoothing assumes that it does.",
                fixes=(fix,),
                hint=f"Use --set {fix} or grow",
            )
        if mode == "given" and len(robot.lines) > MAX_WALLS:
            return UsageError(
                f"--smooth: the given map has {len(robot.lines)} walls, and smoothing takes at most {MAX_WALLS}; "
                "leave --smooth out, or keep only the part of the map that the drive is in"
            )
    return None


def fuse_and_smooth(
    drive: Drive,
    robot: Robot,
    sensors: Sequence[str],
    name: str | None = None,
    known: Estimates | None = None,
) -> tuple[Estimates, Estimates]:
    """Run the filter and the smoother: (filtered, smoothed). Raises UsageError if the gain is not optimal.

    If `known`, the filter's run with its audits, is given, the graph needs no other run.
    """
    check_smoothing(robot, sensors)
    notes: tuple[str, ...] = ()
    if may_have_loops(drive, robot, sensors):
        # without events: they are large, and only the smoother needs them
        filtered = fuse(drive, robot, sensors, name) if known is None else known
        try:
            graph = whole_drive(drive, robot, sensors, filtered)
            if graph is not None and graph.is_needed(filtered):
                return filtered, with_graph(filtered, graph)
            notes = () if graph is None else graph.notes(used=False)
        except LocfuseError as no_solution:  # wrong settings, mostly: the filter's result tells which
            notes = (f"smoothing: no loop was closed: {no_solution}",)
    events = Events(backward=True)
    filtered = fuse(drive, robot, sensors, name, events=events)
    found = smoothed(drive, filtered, events)
    return filtered, replace(found, notes=(*found.notes, *notes))


def with_graph(filtered: Estimates, graph: Graph) -> Estimates:
    """Return the estimates with poses, map and laser mount of the graph; other states are those of the filter."""
    pose, P = graph.poses()
    truth_pose, truth_P = graph.at_truth()
    loops, loop_poses = graph.seen_again()
    return replace(
        filtered,
        pose=pose,
        triangles=upper_triangles(P),
        truth_pose=truth_pose,
        truth_P=truth_P,
        final_map=graph.walls(),
        blocks={**filtered.blocks, **mount_blocks(LASER, graph.mount, filtered.blocks)},
        lost=(),
        jumps=(),
        loops=loops,
        loop_poses=loop_poses,
        notes=(*filtered.notes, *graph.notes()),
        smoothed=True,
    )


def smoothed(drive: Drive, filtered: Estimates, events: Events) -> Estimates:
    """Run the backward pass over the recorded `events` of a filter run; map and audits stay the filter's."""
    back = Backward(drive, filtered, events)
    back.run(events)
    truth_pose, truth_P = drive.at_truth(partial(between_instants, drive, events, back))
    return replace(
        filtered,
        pose=back.pose,
        triangles=upper_triangles(map_covariance(back.frame, back.local, back.P)),
        blocks=back.blocks,
        block_sigmas=back.block_sigmas,
        truth_pose=truth_pose,
        truth_P=truth_P,
        jumps=(),
        smoothed=True,
    )


class Backward:
    """Backward pass of the smoother, from the last update time to the first.

    The state has the pose q in a local frame, and the pose G of this frame in the map. Without a growing map, or
    before its first scan, the frame is the map: G = 0. If a new frame begins at update time k, `local[k]` is in
    the new frame and `arrived[k]` in the frame before.
    """

    def __init__(self, drive: Drive, filtered: Estimates, events: Events) -> None:
        n = len(drive.t)
        self.local, self.frame = np.empty((n, 3)), np.zeros((n, 3))  # q and G
        self.P = np.zeros((n, 6, 6))  # of (q, G)
        self.arrived = np.zeros((n, 3))  # q at the end of the motion to k, before a change of frame
        self.arrived_P = np.zeros((n, 3, 6))  # covariance of `arrived` with itself and with G
        self.to_arrived = np.zeros((n, 3, 3))  # covariance of q at k (rows) with `arrived` at k + 1 (columns)
        self.blocks = {name: np.empty_like(v) for name, v in filtered.blocks.items()}
        self.block_sigmas = {name: np.empty_like(v) for name, v in filtered.blocks.items()}
        self._columns = {b: events.columns[b] for b in self.blocks}
        frames = [e.before for e in events.list if isinstance(e, Added) and e.frame]
        self._frame = frames[-1] if frames else None
        assert events.final is not None
        self._x, self._S = events.final.x.copy(), events.final.P.copy()
        self._G = self._x[self._of_frame].copy()  # smoothed G: constant until the frame moves
        self._to_G = np.eye(6)  # converts errors of (q, G) at an update time to errors about `_G`

    @property
    def pose(self) -> Array:
        """Return the smoothed poses in the map, (n, 3)."""
        return se2.compose(self.frame, self.local)

    def run(self, events: Events) -> None:
        """Process the events in reverse order, up to the motion from the first update time."""
        k = len(self.local) - 1
        self._note(k)
        for event in reversed(events.list):
            if isinstance(event, Moved):
                if k > 0:  # back to update time k - 1; `between_instants` needs the values at its end
                    self.arrived[k], self.arrived_P[k, :, :3] = self._x[:3], self._S[:3, :3]
                    if self._frame is not None:
                        self.arrived_P[k, :, 3:] = self._S[:3, self._of_frame] @ self._to_G[3:, 3:].T
                    k -= 1
                    self.to_arrived[k] = self._step(event.back)[:3, :3]
                    self._note(k)
            elif isinstance(event, Added):
                self._x, self._S = self._x[: event.before], self._S[: event.before, : event.before]
                self._frame = None if event.frame else self._frame
            elif isinstance(event, FrameTurned):
                self._step(event.back)
                self._to_G[3, 5] -= event.dy
                self._to_G[4, 5] += event.dx
            elif isinstance(event, FrameMoved):
                self._G, self._to_G = self._x[self._of_frame].copy(), np.eye(6)
            elif isinstance(event, Dropped):
                self._restore(event.back)
            elif isinstance(event, Changed | VarianceAdded):
                self._step(event.back)

    @property
    def _of_frame(self) -> slice:
        first = self._frame or 0
        return slice(first, first + 3)

    def _step(self, step: Undone | None) -> Array:
        assert step is not None
        rows, G, S = step.rows, step.G, self._S
        cross: Array = G @ S
        own = cross @ G.T + step.D
        self._x[rows] = step.c + G @ self._x
        S[rows, :] = cross
        S[:, rows] = cross.T
        S[np.ix_(rows, rows)] = 0.5 * (own + own.T)
        return cross

    def _restore(self, drop: Undone | None) -> None:
        assert drop is not None
        n = len(self._x) + len(drop.rows)
        stay = np.setdiff1d(np.arange(n), drop.rows)
        cross = drop.G @ self._S
        x, S = np.empty(n), np.empty((n, n))
        x[stay], x[drop.rows] = self._x, drop.c + drop.G @ self._x
        S[np.ix_(stay, stay)] = self._S
        S[np.ix_(drop.rows, stay)], S[np.ix_(stay, drop.rows)] = cross, cross.T
        S[np.ix_(drop.rows, drop.rows)] = cross @ drop.G.T + drop.D
        self._x, self._S = x, S

    def _note(self, k: int) -> None:
        x, S = self._x, self._S
        self.local[k], self.P[k, :3, :3] = x[:3], S[:3, :3]
        if self._frame is not None:
            at = [0, 1, 2, *range(self._frame, self._frame + 3)]
            self.frame[k], self.P[k] = self._G, self._to_G @ S[np.ix_(at, at)] @ self._to_G.T
        for name, column in self._columns.items():
            where = slice(column, column + self.blocks[name].shape[1])
            self.blocks[name][k] = self._x[where]
            self.block_sigmas[name][k] = np.sqrt(np.maximum(np.diagonal(self._S)[where], 0.0))


def between_instants(
    drive: Drive, events: Events, back: Backward, k: Ints, motions: Motions
) -> tuple[Array, Array]:
    """Return smoothed poses (q, 3) and covariances (q, 3, 3) after motions (q) from the update times k (q,).

    Between two update times the odometry error is interpolated (a Brownian bridge): the motion up to the stamp has
    the same share of the interval's error as of its noise. Everything is linearised in the local frame about the
    filter's poses: the sideways noise is micrometres, and another linearisation would have larger errors. The
    result is converted to the map frame.
    """
    after = np.minimum(k + 1, len(drive.t) - 1)
    states = back.blocks.get(WHEELS)
    wheels = None if states is None else states[-1]  # their variance is negligible over a part of an interval
    u, v = motions.corrected(wheels), drive.motions.corrected(wheels)[after]
    assert events.final is not None
    starts = [event.start for event in events.list if isinstance(event, Moved)]
    start = np.array([*starts[1:], events.final.x[:3]])[k]  # start of every motion, and the end of the last
    at, end = eq5_x(start, u), eq5_x(start, v)
    to_at, to_end, on = eq7_A(start, at), eq7_A(start, end), eq7_A(at, end)
    turn = se2.rotation(start[:, 2])
    Q = eq6_noise(turn, motions.Q)
    whole = eq6_noise(turn, drive.motions.Q[after])
    share = Q @ on.transpose(0, 2, 1) @ np.linalg.pinv(whole, rcond=MIN_EIGENVALUE_SHARE, hermitian=True)
    share[k == after] = 0.0
    near = to_at - share @ to_end
    out = at + _apply(near, back.local[k] - start) + _apply(share, back.arrived[after] - end)
    cross = near @ back.to_arrived[k] @ share.transpose(0, 2, 1)
    P = back.P[k]  # covariance of (q, G) at k; below it becomes that of (`out`, G)
    to_frame = near @ P[:, :3, 3:] + share @ back.arrived_P[after, :, 3:]
    own = near @ P[:, :3, :3] @ near.transpose(0, 2, 1)
    own += share @ back.arrived_P[after, :, :3] @ share.transpose(0, 2, 1)
    own += cross + cross.transpose(0, 2, 1) + Q - share @ on @ Q
    P[:, :3, :3], P[:, :3, 3:], P[:, 3:, :3] = own, to_frame, to_frame.transpose(0, 2, 1)
    return se2.compose(back.frame[k], out), map_covariance(back.frame[k], out, P)


def _apply(M: Array, x: Array) -> Array:
    """Return M x for matrices M (n, 3, 3) and vectors x (n, 3)."""
    return np.asarray(np.einsum("nij,nj->ni", M, x))
