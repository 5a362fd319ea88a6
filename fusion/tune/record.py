"""One run of the filter as a tape: what was accepted, matched and linearised stays, only the noise changes.

Played with other noise (tape_play), the tape is a linear Kalman filter on the deviations from the recorded run,
and its innovations have a likelihood (Schweppe 1965). New map lines start without knowledge, so that what they
were made from does not have to be told apart from what is measured later.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple, cast

import msgspec
import numpy as np
from msgspec import field
from msgspec.structs import replace

from locfuse.fusion import se2
from locfuse.fusion.data import Array, Drive, Ints, Measurements
from locfuse.fusion.ekf.belief_arrays import JointBelief
from locfuse.fusion.ekf.journal import in_map
from locfuse.fusion.ekf.map_frame import Pose, Triangle, by_frame
from locfuse.fusion.ekf.rows import stacked
from locfuse.fusion.fuse import Filter
from locfuse.fusion.instants import due_readings, steps_of
from locfuse.fusion.mount import exact
from locfuse.fusion.robot import Robot
from locfuse.fusion.sensor import Block, Innovation, Model, Reading

UNKNOWN_VARIANCE = 100.0  # variance of a new map line [m^2, rad^2]: nothing is known


class Move(NamedTuple):
    """Wheel motion: the deviation's lever, its noise, how wheel parameters enter."""

    instant: int
    lever: tuple[float, float]  # d(x, y)/dtheta [m]
    Q: Array  # (3, 3) map frame, for the recorded wheels.noise
    coupling: Array | None  # (3, p) by the wheel parameters
    turned: float  # rad
    driven: float  # m


class See(NamedTuple):
    """A correction by measurements with R = R_sigma + R_rest, of which R_sigma grows with the sensor's sigma^2."""

    instant: int
    y: Array  # (m,) recorded innovation
    columns: Ints  # (c,)
    H: Array  # (m, c)
    R_sigma: Array  # (m, m) for the recorded sigma
    R_rest: Array  # (m, m)
    sensor: Ints  # (m,) index of the sensor; -1 is none's (two lines are one wall) and is not scored
    step: Array  # (n,) what the recorded state moved by


class Change(NamedTuple):
    """Anything else: deviation <- T deviation + noise."""

    T: Array  # (n after, n before)
    noise: Array  # (n after, n after)


class Loosen(NamedTuple):
    """States became less certain."""

    columns: Ints  # (k,)
    variance: Array  # (k,)


class Swing(NamedTuple):
    """The map frame at `first` was corrected by (dx, dy), and its place follows its direction (map_frame)."""

    first: int
    dx: float  # m
    dy: float


class Tape(msgspec.Struct):
    """The recorded run."""

    sensors: tuple[str, ...]
    P0: Array  # (n, n)
    t: Array  # (instants,) s
    ops: list[Move | See | Change | Loosen | Swing] = field(default_factory=list)
    drifts: dict[str, tuple[Ints, Array]] = field(default_factory=dict)  # block -> columns, variance per s
    wheels: slice | None = None  # columns of the wheel parameters


def record(drive: Drive, robot: Robot, sensors: Sequence[str]) -> Tape:
    """Run the filter with these sensors and return its tape.

    Mounts are taken as configured: where one is a state it turns the R of lines, and what of R is sigma's is lost.
    """
    made: list[Taped] = []
    robot = replace(robot, sensors={name: exact(settings) for name, settings in robot.sensors.items()})

    def joint(pose: Pose, P: Triangle, blocks: Sequence[Block] = ()) -> Any:
        made.append(Taped(pose, P, blocks))
        return made[0]

    run = Filter(robot, sensors, make=joint)
    belief = made[0]
    names = tuple(run.models)
    tape = belief.begin_tape(names, drive.t)
    for i, s in enumerate(names):
        run.models[s] = cast("Model", Listed(run.models[s], i, belief))
    for k, (step, due) in enumerate(zip(steps_of(drive), due_readings(drive, names), strict=True)):
        belief.instant = k
        belief.owners.clear()
        run.advance(k, step, due, drive.measurements)
    return tape


class Listed:
    """A sensor's model that tells the tape which innovations are its own."""

    def __init__(self, model: Model, index: int, belief: Taped) -> None:
        self._model, self._index, self._belief = model, index, belief

    def __getattr__(self, name: str) -> Any:
        return getattr(self._model, name)

    def innovations(self, m: Measurements, i: int, belief: Any) -> list[Innovation]:
        """Compare as ever."""
        seen = list(self._model.innovations(m, i, belief))
        self._belief.owners |= {id(s): (self._index, of_sigma(m, s.row)) for s in seen if s.verdict == 0}
        return seen


def of_sigma(m: Measurements, row: int) -> Array:
    """Return the part (d, d) of a measurement's R that grows with the sensor's sigma^2: all but floor and rest."""
    R: Array = m.scale**2 * m.R_unit[row]
    rest = m.extra.get("rest")
    return R if rest is None else R - rest[row] * np.eye(len(R))


class Taped(JointBelief):
    """A belief that writes down what happens to it."""

    instant: int
    owners: dict[int, tuple[int, Array]]  # id of this instant's innovation -> its sensor, its R by sigma
    tape: Tape

    def begin_tape(self, sensors: tuple[str, ...], t: Array) -> Tape:
        """Begin with the state as it is."""
        self.instant, self.owners = 0, {}
        self.tape = Tape(sensors, self.covariance.copy(), t, wheels=self._motion_block)
        names = {where.start: name for name, where in self._slices.items()}
        self.tape.drifts = {names[int(c[0])]: (c, drift) for c, drift in self._drift}
        return self.tape

    def predict(self, u: Sequence[float], Q: Sequence[float], dt: float = 0.0, J: Array | None = None) -> None:
        """Predict as ever, and write down the motion."""
        x, y, theta = self.state[:3].tolist()
        super().predict(u, Q, dt, J)
        coupling = None if self._motion_block is None or J is None else se2.rotation(np.array(theta)) @ J
        lever = (y - float(self.state[1]), float(self.state[0]) - x)
        turned, driven = float(self.state[2]) - theta, float(np.hypot(*lever))
        self.tape.ops.append(Move(self.instant, lever, in_map(Q, theta), coupling, turned, driven))

    def correct(self, seen: Sequence[Innovation | Reading]) -> None:
        """Correct as ever, and write down what was seen and how far it moved the state."""
        if not seen:
            return
        rows = [s for s in seen if isinstance(s, Innovation)]  # all of them: Listed makes lists
        before, swings = self.state.copy(), len(self.tape.ops)
        super().correct(seen)
        swung = self.tape.ops[swings:]
        del self.tape.ops[swings:]
        y, columns, H, R = stacked(rows)
        R_sigma, sensor = np.zeros_like(R), np.full(len(y), -1)
        k = 0
        for s in rows:
            at = slice(k, k + len(s.y))
            if s.row >= 0:
                sensor[at], R_sigma[at, at] = self._owned(s, R[at, at])
            k = at.stop
        self.tape.ops.append(See(self.instant, y, columns, H, R_sigma, R - R_sigma, sensor, self.state - before))
        self.tape.ops += swung

    def _owned(self, s: Innovation, R: Array) -> tuple[int, Array]:
        index, of_its_sigma = self.owners[id(s)]
        own = R - np.array(s.shared) @ np.array(s.shared).T if s.shared else R
        if len(R) == 2 and own[0, 1] * of_its_sigma[0, 1] < 0.0:
            # the line was read as (-r, psi + pi)
            of_its_sigma = of_its_sigma * np.array(((1.0, -1.0), (-1.0, 1.0)))
        told = (np.diagonal(R) >= 0.999 * np.diagonal(of_its_sigma)).all()
        return index, of_its_sigma if told else R  # a model that weighs by less than R: all of it is its sigma's

    def augment(self, values: Array, G: Array, noise: Array, columns: Sequence[int] = ()) -> int:
        """Append as ever; on the tape nothing is known of what is new."""
        n, k = self.n, len(values)
        column = super().augment(values, G, noise, columns)
        self._note(np.eye(n + k, n), np.diag(np.concatenate((np.zeros(n), np.full(k, UNKNOWN_VARIANCE)))))
        return column

    def _clone_pose(self) -> int:
        """Append the map frame as ever: on the tape too it is what the pose was."""
        n = self.n
        column = super()._clone_pose()
        T = np.eye(n + 3, n)
        T[n:, :3] = np.eye(3)
        self.tape.ops[-1] = Change(T, np.zeros((n + 3, n + 3)))
        return column

    def _forget_pose(self, first: bool) -> None:
        """Begin the local frame as ever."""
        super()._forget_pose(first)
        T = np.eye(self.n)
        T[:3] = 0.0
        self._note(T)

    def _swing(self, dx: float, dy: float) -> None:
        """Swing as ever."""
        super()._swing(dx, dy)
        self.tape.ops.append(Swing(self.frame or 0, dx, dy))

    def loosen(self, columns: Ints, variance: Array) -> None:
        """Loosen as ever."""
        super().loosen(columns, variance)
        self.tape.ops.append(Loosen(columns, variance))

    def remove(self, columns: Ints) -> None:
        """Drop as ever."""
        T = np.delete(np.eye(self.n), columns, axis=0)
        super().remove(columns)
        self._note(T)

    def _shift(self, turn: float, xy: float, theta: float) -> None:
        super()._shift(turn, xy, theta)
        self._note(np.eye(self.n), self._of_pose(xy, theta))

    def _place(self, pose: Pose, xy: float, theta: float) -> None:
        super()._place(pose, xy, theta)
        T = np.eye(self.n)
        T[:3] = 0.0
        self._note(T, self._of_pose(xy, theta))

    def clone_heading(self, column: int, behind: float = 0.0) -> None:
        """Clone as ever."""
        super().clone_heading(column, behind)
        T = np.eye(self.n)
        T[column] = T[2]
        self._note(T)

    def clone_pose(self, column: int, behind: Array | None = None) -> None:
        """Clone as ever."""
        pose = self.state[:3].copy()
        super().clone_pose(column, behind)
        T = np.eye(self.n)
        T[column : column + 3] = 0.0
        J = np.eye(3) if behind is None else by_frame(pose[None], behind[None])[0]
        T[column : column + 3, :3] = J
        self._note(T)

    def transform(self, columns: Ints, values: Array, G: Array) -> None:
        """Transform as ever."""
        super().transform(columns, values, G)
        T = np.eye(self.n)
        T[np.ix_(columns, columns)] = G
        self._note(T)

    def _of_pose(self, xy: float, theta: float) -> Array:
        return np.diag(np.concatenate(((xy, xy, theta), np.zeros(self.n - 3))))

    def _note(self, T: Array, noise: Array | None = None) -> None:
        self.tape.ops.append(Change(T, np.zeros((len(T), len(T))) if noise is None else noise))
