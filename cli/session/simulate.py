"""Simulated drives: a scenario with locfuse's localisation in its control loop, recorded as a log.

A scan arrives later than a compass reading taken during the scan. So the filter runs MAX_LATENCY_S behind the
newest wheel reading, where all readings are in order, and the wheels predict the pose from there to now.
"""

from __future__ import annotations

import tempfile
import weakref
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from locfuse.cli.analysis.robot_tables import make_robot
from locfuse.cli.analysis.settings import PathLike, Progress, Sets, path_of, set_words, silent
from locfuse.formats.whole_files import may_replace, scratch_prefix
from locfuse.fusion import se2
from locfuse.fusion.data import LocfuseError, Measurements, UsageError
from locfuse.fusion.fuse import Filter, step_between
from locfuse.fusion.robot import Robot
from locfuse.fusion.sensors.registry import REGISTRY
from locfuse.fusion.wheels.motion import Wheels

from .python_words import speaks_python
from .session import Session, load

if TYPE_CHECKING:
    from locfuse.sample_logs.scenario import Scenario
    from locfuse.sample_logs.simulate import Localise, Outcome
    from locfuse.sample_logs.table import Estimator, RawMessage


@speaks_python
def simulate(
    scenario: PathLike,
    out: PathLike | None = None,
    *,
    seed: int | None = None,
    sets: Sets | None = None,
    overwrite: bool = False,
    progress: Progress = silent,
) -> Session:
    """Simulate a scenario, record it as an MCAP log with known truth, and load this log.

    Args:
        scenario: a TOML file, or the name of a shipped scenario such as "rounded_rectangle".
        out: the log to write (.mcap). None writes a temporary file, deleted with the session's log.
        seed: seed of all random numbers; None is the scenario's own.
        sets: single keys of the scenario: {"compass.noise_deg": 0.1, "control.estimator": "all"}.
        overwrite: replace an existing file.
        progress: called with the name of every step, such as `print`.

    Raises:
        LocfuseError: no such scenario, an unknown key, or an existing file.
    """
    from locfuse.sample_logs import scenario as scenarios

    chosen = scenarios.load(str(scenario), set_words(sets))
    seed = chosen.seed if seed is None else seed
    if seed < 0:
        raise UsageError(f"seed = {seed}: it must be 0 or more")
    with ExitStack() as until:  # keeps a temporary file while the log is in use
        if out is None:
            folder = until.enter_context(tempfile.TemporaryDirectory(prefix=scratch_prefix()))
            path = Path(folder) / f"{Path(scenario).stem}.mcap"
        else:
            path = path_of(out)
            may_replace(path, overwrite)
        progress("driving")
        drive(chosen, seed, path)
        session = load(path, progress=progress)
        weakref.finalize(session.log, until.pop_all().close)
    return session


def drive(scenario: Scenario, seed: int, out: Path) -> Outcome:
    """Simulate a scenario and write its log. Raises LocfuseError if the file cannot be written."""
    from locfuse.sample_logs.simulate import write_log

    return write_log(scenario, seed, localise(scenario.control.estimator), out)


def localise(word: str) -> Localise:
    """Return a function that builds the robot's estimator from the tables of robot.toml.

    `word` is the choice of the estimator: "truth", "odometry", "all", or sensor names joined by "+" or ",".
    """
    from locfuse.sample_logs.simulate import on_truth

    def build(tables: dict[str, dict[str, Any]]) -> Estimator | None:
        carried = tuple(name for name in REGISTRY if name in tables)
        asked = {"odometry": [], "all": list(carried)}.get(word, word.replace("+", ",").split(","))
        for name in asked:
            if name not in carried:
                known = ", ".join(("truth", "odometry", *carried, "all"))
                raise UsageError(f"control.estimator = {word}: this robot has no {name}; choose from {known}")
        sensors = tuple(name for name in carried if name in asked)
        return Localiser(make_robot({name: tables[name] for name in ("wheels", "start", *sensors)}), sensors)

    return on_truth if word == "truth" else build


MAX_LATENCY_S = 0.15  # s: longer than any sensor's latency in the scenarios
WHEEL_MEMORY_S = 4.0  # s of wheel readings that are kept


class Localiser:
    """Localisation in the control loop: a filter that runs MAX_LATENCY_S behind the newest wheel reading."""

    def __init__(self, robot: Robot, sensors: Sequence[str]) -> None:
        self.robot = robot
        self.filter = Filter(robot, sensors)
        self._role = {robot.settings(s).topic: s for s in sensors}
        self._wheel_t: list[float] = []
        self._rolled: list[tuple[float, float]] = []
        self._waiting: list[tuple[str, RawMessage]] = []
        self._epoch_ns = 0
        self._at = 0.0  # s: the time that the filter has reached
        if robot.start.at:
            words = "while a robot drives, its later pose is unknown; remove start.at"
            raise LocfuseError(f"start.at is for recorded logs: {words}")
        self._pose = np.array(robot.start.pose)

    def __call__(self, messages: list[RawMessage]) -> tuple[float, float, float]:
        """Add new messages and return the pose at the newest wheel reading."""
        for message in messages:
            if message.topic == self.robot.wheels.topic:
                self._add_rolled(message)
            elif message.topic in self._role:
                self._waiting.append((self._role[message.topic], message))
        if len(self._wheel_t) >= 2:
            settings, (left, right) = self.robot.wheels, np.array(self._rolled).T
            t = np.array(self._wheel_t)
            wheels = Wheels.from_wheels(t, left, right, settings.track or 1.0, settings.noise)
            self._correct(wheels)
            now = wheels.relative(np.array([self._at]), wheels.t[-1:])[0]
            self._pose = se2.compose(np.array(self.filter.pose()), now)
            while self._wheel_t[0] < min(t[-1] - WHEEL_MEMORY_S, self._at - WHEEL_MEMORY_S / 2):
                self._wheel_t.pop(0)
                self._rolled.pop(0)
        x, y, theta = self._pose.tolist()
        return x, y, theta

    def _add_rolled(self, message: RawMessage) -> None:
        """Append the distances [m] rolled by both wheels, radius x joint angle, of a later joint message."""
        if not self._wheel_t:
            self._epoch_ns = message.stamp_ns
        t = (message.stamp_ns - self._epoch_ns) * 1e-9
        if self._wheel_t and t <= self._wheel_t[-1]:
            return
        settings, names = self.robot.wheels, list(message.fields["name"])
        angle = dict(zip(names, np.asarray(message.fields["position"]).tolist(), strict=True))
        radius, (left, right) = settings.radius or 0.0, settings.shares
        self._wheel_t.append(t)
        self._rolled.append((radius * left * angle[settings.left], radius * right * angle[settings.right]))

    def _correct(self, wheels: Wheels) -> None:
        """Advance the filter through all readings older than MAX_LATENCY_S, in time order."""
        from locfuse.sample_logs.simulate import stream_of

        def measured_by(sensor: str, message: RawMessage) -> Measurements:
            settings = self.robot.settings(sensor)
            return REGISTRY[sensor].measure(stream_of([message]), settings, wheels, self._epoch_ns)

        horizon = wheels.t[-1] - MAX_LATENCY_S
        measured = [(measured_by(s, message), s, message) for s, message in self._waiting]
        ready = [(m, s) for m, s, _ in measured if len(m.t) and self._at <= m.t[0] <= horizon]
        self._waiting = [(s, message) for m, s, message in measured if len(m.t) and m.t[0] > horizon]
        for t in sorted({float(m.t[0]) for m, _ in ready}):
            step = step_between(wheels, self._at, t, self.robot.wheels.estimate)
            due = {s: m for m, s in ready if m.t[0] == t}
            self.filter.advance(0, step, [(s, 0) for s in due], due)
            self._at = t
