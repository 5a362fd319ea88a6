"""The filter of the paper: runs one configuration over one drive, forward in time.

`Filter.advance` is one cycle: predict by the wheels, compare all readings of this time with the same prior, apply
the gate, correct once, update the models, record.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from locfuse.fusion.ekf.belief_arrays import JointBelief
from locfuse.fusion.ekf.equations import predicted
from locfuse.fusion.ekf.events import Before, Events
from locfuse.fusion.ekf.map_frame import InMap, Pose
from locfuse.fusion.ekf.record import FIRST_CAPACITY, Record, Track
from locfuse.fusion.kernels.arrays import view
from locfuse.fusion.kernels.ekf import Innovation, State, Steps
from locfuse.fusion.kernels.sight import SightLines
from locfuse.fusion.sensors.registry import REGISTRY
from locfuse.fusion.wheels.motion import WHEELS, Wheels, wheel_block, wheel_words

from .data import BY_SCANS, ODOMETRY, Array, Drive, Estimates, Ints, Measurements, Motions, RowVerdict, matrices
from .progress import report_progress
from .robot import Robot
from .sensor import Model

BLOCK_INSTANTS = 256
Due = tuple[str, int]  # sensor, reading
STAMPS_AT_ONCE = 4096  # stamps of the truth in one step, to limit memory
Passed = tuple[Sequence[Innovation | SightLines], int]  # accepted innovations of a reading, their number of rows
Fit = tuple[Record, int, float]  # for one reading: record of its sensor, degrees of freedom, joint NIS


def fuse(
    drive: Drive,
    robot: Robot,
    sensors: Sequence[str],
    name: str | None = None,
    listen: Mapping[str, NDArray[np.bool_]] | None = None,
    events: Events | None = None,
) -> Estimates:
    """Run the filter with these sensors. Raises LocfuseError if the drive lacks one of them.

    `listen` (sensor -> one flag per reading) marks readings that never correct the pose. They are compared with
    the belief, recorded, and update only the states and the map of their own sensor. How well the filter predicts
    them is evidence without truth. Changes of the state are recorded in `events` (fusion.ekf.events).
    """
    listen = listen or {}
    for sensor in (*sensors, *listen):
        if sensor not in drive.measurements:
            raise drive.lacks(sensor)
    rows = {s: len(m.z) for s, m in drive.measurements.items()}
    run = Filter(robot, sensors, listen, rows, len(drive.t), events)
    steps, end = steps_of(drive), float(drive.t[-1]) or 1.0
    for k, due in enumerate(due_readings(drive, (*sensors, *listen))):
        if not k % BLOCK_INSTANTS:
            report_progress(float(drive.t[k]) / end)
        run.advance(k, steps, due, drive.measurements)
    report_progress(None)
    if events is not None:
        events.final = Before(run.belief.state.copy(), run.belief.covariance.copy())
    return run.estimates(drive, name or configuration_name(sensors, drive))


def configuration_name(sensors: Sequence[str], drive: Drive) -> str:
    """Return the name of a set of sensors: "odometry", "scan matching", "lrf", "compass+lrf", or "all"."""
    present = [s for s in REGISTRY if s in drive.measurements]
    chosen = [s for s in REGISTRY if s in sensors]
    if not chosen:
        return ODOMETRY if drive.wheels.matched is None else BY_SCANS
    if chosen == present and len(present) > 1:
        return "all"
    return "+".join(chosen)


class Filter:
    """Filter of one configuration: its belief, one model for each sensor, and its record."""

    def __init__(
        self,
        robot: Robot,
        sensors: Sequence[str],
        listen: Mapping[str, NDArray[np.bool_]] | None = None,
        rows: Mapping[str, int] | None = None,
        instants: int = FIRST_CAPACITY,
        events: Events | None = None,
    ) -> None:
        """`rows`: number of measurements of each sensor; `instants`: number of update times (both if known)."""
        self._sensors = tuple(s for s in REGISTRY if s in sensors)
        self._wheels = robot.wheels
        self._inflates = {s for s in REGISTRY if s in sensors and robot.settings(s).outliers == "inflate"}
        self._listens = {s: flags.tolist() for s, flags in (listen or {}).items()}
        modelled = [s for s in REGISTRY if s in sensors or s in self._listens]
        self.models: dict[str, Model] = {s: REGISTRY[s].model(robot.settings(s)) for s in modelled}
        self.belief = _begin(robot, list(self.models.values()))
        # these states correlate the innovations of one reading, so their joint NIS is recorded
        self._joint = any(model.joint for model in self.models.values())
        in_map = InMap(self.belief)
        # belief as each model sees it: with the pose in the local frame, or in the map
        self._views = {s: self.belief if model.local else in_map for s, model in self.models.items()}
        self._rolling = [m for m in self.models.values() if type(m).rolled is not Model.rolled]
        self._learning = {s for s, m in self.models.items() if type(m).learn is not Model.learn}
        mapping = [s for s in self._sensors if self.models[s].maps]
        self._leads = [s for s in mapping if self.models[s].leads]
        self._may_begin = self._leads or mapping  # sensors that may begin a local frame
        if events is not None:
            self.belief.note_events(events)
        for model in self.models.values():
            model.begin(robot.lines, self.belief)
        for s, model in self.models.items():
            # a sensor that corrects the pose must not use the map of a sensor that only listens
            model.meet({o: other for o, other in self.models.items() if o in sensors or s not in sensors})
        self._records = {s: Record((rows or {}).get(s, FIRST_CAPACITY)) for s in self.models}
        fixed = [b.name for m in self.models.values() for b in m.blocks() if not b.name.startswith("_")]
        if robot.wheels.estimate:
            fixed.append(WHEELS)
        self._track = Track(self.belief, fixed, instants)

    def advance(self, k: int, steps: Steps, due: Sequence[Due], measurements: Mapping[str, Measurements]) -> None:
        """Predict to update time k and correct by all readings (sensor, i) of this time."""
        belief = self.belief
        belief.predict(steps, k)  # eq. 5-7
        for model in self._rolling:
            model.rolled(steps.of(k))
        if due:
            self._begin_frame(due, measurements)  # if a sensor begins a map
            belief.begin()  # collect equations of this update time
            passed = [self._compare(k, s, i, measurements[s]) for s, i in due]  # eq. 13, 17, 18, and the gate
            fits = self._queue(due, passed)
            belief.correct()  # eq. 10-12, once
            for n, (record, numbers, nis) in enumerate(fits):  # the joint NIS of the first fit is known only now
                record.joint.extend((nis if n else belief.fit(numbers), numbers))
            for sensor, i in due:
                if sensor in self._learning:  # maps and clones
                    self.models[sensor].learn(measurements[sensor], i, self._views[sensor])
            for sensor in self._leads:
                self.models[sensor].begin_next_map(belief)
        self._track.note(belief)

    def _compare(self, k: int, sensor: str, i: int, m: Measurements) -> Passed:
        """Compute and record the innovations of reading i; return the accepted ones and the number of rows."""
        model = self.models[sensor]
        seen = model.innovations(m, i, self._views[sensor])
        if sensor in self._inflates and not isinstance(seen, SightLines):
            for innovation in seen:
                inflate(innovation, self.belief)
        self._records[sensor].add(k, seen)
        if isinstance(seen, SightLines):
            return (seen,), seen.accepted
        ones = [innovation for innovation in seen if innovation.verdict == 0]
        return ones, len(ones)

    def _queue(self, due: Sequence[Due], passed: Sequence[Passed]) -> list[Fit]:
        """Queue the accepted innovations; those of listening sensors correct only the states of the sensor itself.

        If models add states during the drive, return the joint NIS of readings with several rows. The first of
        these readings comes first in the equation, so that its whitened rows do not depend on other readings.
        """
        belief, fits = self.belief, list[Fit]()
        listened: list[Innovation | SightLines] = []
        order = list(range(len(due)))
        for n, (_, rows) in enumerate(passed):
            if self._joint and rows > 1:
                order.insert(0, order.pop(n))
                break
        for n in order:
            (sensor, i), (ones, rows), begin = due[n], passed[n], belief.queued
            if sensor in self._listens and self._listens[sensor][i]:
                if rows and self.models[sensor].teaches:
                    listened += ones
                continue
            for one in ones:
                belief.queue(one, sensor)
            if self._joint and rows > 1:
                nis = belief.fit_of(begin, belief.queued) if fits else math.nan
                fits.append((self._records[sensor], belief.queued - begin, nis))
        if listened:
            belief.listen(listened)
        return fits

    def _begin_frame(self, due: Sequence[Due], measurements: Mapping[str, Measurements]) -> None:
        """Begin a local frame (fusion.ekf.map_frame) at the first reading of a sensor that builds a map."""
        for sensor, i in due if self._may_begin else ():
            if sensor in self._may_begin and self.models[sensor].begins_map(measurements[sensor], i):
                self.belief.begin_frame()
                self._may_begin = self._leads

    def pose(self) -> Pose:
        """Return the pose in the map: x [m], y [m], theta [rad, not wrapped]."""
        return self.belief.pose_in_map()

    def estimates(self, drive: Drive, name: str) -> Estimates:
        """Return the estimates of the run, including predictions at the truth's stamps."""
        pose, triangles = self._track.recorded()
        blocks, variances = self._track.blocks(), self._track.blocks(variances=True)
        results = [m.results(self._views[s]) for s, m in self.models.items()]
        truth_pose, truth_P = _at_truth(drive, pose, triangles, blocks.get(WHEELS))
        loops = [loop for found in results for loop in found.loops]
        return Estimates(
            configuration=name,
            sensors=self._sensors,
            t=drive.t,
            pose=pose,
            triangles=triangles,
            audits={s: record.audit() for s, record in self._records.items()},
            blocks=blocks,
            block_sigmas={name: np.sqrt(np.maximum(v, 0.0)) for name, v in variances.items()},
            first_map=[line for found in results for line in found.first_map],
            final_map=[line for found in results for line in found.final_map],
            points=[point for found in results for point in found.points],
            truth_pose=truth_pose,
            truth_P=truth_P,
            notes=tuple(self._notes()),
            jumps=tuple(sorted(jump for found in results for jump in found.jumps)),
            lost=tuple((a, min(b, float(drive.t[-1]))) for found in results for a, b in found.lost),
            loops=np.array([(loop.then, loop.now) for loop in loops]).reshape(-1, 2),
            loop_poses=np.array([loop.pose for loop in loops]).reshape(-1, 3),
        )

    def _notes(self) -> Iterator[str]:
        """Yield notes on the run: estimated wheel parameters, and the notes of every sensor."""
        belief = self.belief
        if self._wheels.estimate:
            column, x = belief.block(WHEELS)
            P = belief.covariance[column : column + len(x), column : column + len(x)]
            # sensors that measure lengths show the scale of the wheels
            lengths = [s for s in self._sensors if any(c.unit == "m" for c in REGISTRY[s].components)]
            metric = {s: REGISTRY[s].scale_key for s in lengths}
            yield from (f"wheels: {words}" for words in wheel_words(self._wheels, x, P, self._sensors, metric))
        for name, model in self.models.items():
            yield from (f"{name}: {words}" for words in model.notes(self._views[name]))


def _begin(robot: Robot, models: Sequence[Model]) -> JointBelief:
    """Return the initial belief: start pose, state blocks of the models, and wheel parameters if estimated."""
    blocks = [block for model in models for block in model.blocks()]
    xx, yy, tt = robot.start.variances
    start = robot.start.pose, (xx, 0.0, 0.0, yy, 0.0, tt)
    if not robot.wheels.estimate:
        return JointBelief(*start, blocks)
    belief = JointBelief(*start, [*blocks, wheel_block(robot.wheels)])
    belief.drive_with(WHEELS)
    return belief


def _at_truth(
    drive: Drive, pose: Array, triangles: Array, wheels: Array | None
) -> tuple[Array | None, Array | None]:
    """Return poses (q, 3) and covariances (q, 3, 3), predicted at the truth's stamps (Drive.at_truth)."""

    def predict(instant: Ints, motions: Motions) -> tuple[Array, Array]:
        out, spread = np.empty((len(instant), 3)), np.empty((len(instant), 3, 3))
        for at in (slice(a, a + STAMPS_AT_ONCE) for a in range(0, len(instant), STAMPS_AT_ONCE)):
            k, u = instant[at], motions.u[at]
            if wheels is not None:
                u = u + np.einsum("nij,nj->ni", motions.J[at], wheels[k])
            out[at], spread[at] = predicted(pose[k], matrices(triangles[k]), u, motions.Q[at])
        return out, spread

    return drive.at_truth(predict)


def inflate(seen: Innovation, state: State) -> None:
    """Accept a rejected innovation of one number, with R increased until its NIS equals the gate.

    For a sensor with heavy-tailed errors, this keeps information that a rejection would lose; it is the weight of
    Huber's estimator at this innovation. Other innovations are not changed.
    """
    far = seen.verdict == RowVerdict.GATE and math.isfinite(seen.nis)
    if not far or seen.numbers != 1 or seen.threshold <= 0.0:
        return
    needed = seen.y[0] ** 2 / seen.threshold
    state.add_row_noise(seen.first, needed - seen.sigma[0] ** 2)
    seen.verdict, seen.nis, seen.sigma = 0, seen.threshold, (math.sqrt(needed),)


# ---- input of the loop at each update time: the motion to this time, and its readings ----
#
# Readings become Python values in blocks of BLOCK_INSTANTS, to save memory.


def steps_of(drive: Drive) -> Steps:
    """Return the wheel motions of a drive as `Steps`; step k ends at update time k."""
    return _steps(drive.motions, np.diff(drive.t, prepend=drive.t[:1]))


def step_between(wheels: Wheels, t_from: float, t_to: float, parameters: bool = False) -> Steps:
    """Return the wheel motion from t_from to t_to [s] as `Steps` with one step."""
    motions = wheels.between(np.array([t_from]), np.array([t_to]), parameters)
    return _steps(motions, np.array([t_to - t_from]))


def _steps(motions: Motions, dt: Array) -> Steps:
    n = len(dt)
    Q, J = motions.Q.reshape(n, 9), motions.J.reshape(n, 3 * motions.J.shape[2])
    return Steps(view(motions.u), view(Q), view(dt), view(J))


def due_readings(drive: Drive, sensors: Sequence[str]) -> Iterator[list[Due]]:
    """Yield for every update time its readings (sensor, i), in registry order."""
    owners = {s: drive.instant[s] for s in REGISTRY if s in sensors}
    for begin in range(0, len(drive.t), BLOCK_INSTANTS):
        end = min(begin + BLOCK_INSTANTS, len(drive.t))
        due: list[list[Due]] = [[] for _ in range(end - begin)]
        for sensor, instant in owners.items():
            first, last = np.searchsorted(instant, (begin, end)).tolist()
            for i, k in enumerate((instant[first:last] - begin).tolist(), first):
                due[k].append((sensor, i))
        yield from due
