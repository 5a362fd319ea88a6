"""The loop: one configuration over one drive. `state = advance(state, instant)`, and nothing looks ahead.

predict by the wheels  ->  every sensor due compares with the same prior  ->  correct once  ->  learn
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from locfuse.fusion.coast.stretches import AnyRecord, Stretches
from locfuse.fusion.ekf.belief_arrays import JointBelief
from locfuse.fusion.ekf.equations import predicted
from locfuse.fusion.ekf.map_frame import InMap, Pose, Triangle
from locfuse.fusion.ekf.robust import inflated
from locfuse.fusion.sensors.registry import REGISTRY
from locfuse.fusion.wheels.states import WHEELS, wheel_block, wheel_words

from .audit import MANY, Record
from .data import Array, Drive, Estimates, Measurements, matrices
from .instants import Due, Instants, Step
from .progress import say_done
from .robot import Robot, StartSettings
from .sensor import Block, Innovation, Model, Reading
from .track import Track

AT_ONCE = 4096  # stamps of the truth: what is needed on the way is many times larger than the result
Rows = list[Innovation | Reading]  # in the order in which they are corrected
MakeBelief = Callable[[Pose, Triangle, Sequence[Block]], JointBelief]  # at the start


def fuse(
    drive: Drive,
    robot: Robot,
    sensors: Sequence[str],
    name: str | None = None,
    listen: Mapping[str, NDArray[np.bool_]] | None = None,
    make: MakeBelief = JointBelief,
) -> Estimates:
    """Run the filter with these sensors. Raises LocfuseError where the drive lacks one of them.

    Readings that `listen` marks (sensor -> one flag per reading) are compared with the belief and audited, and
    teach their sensor what is its own (a map, an offset), but never move the pose: how well they are predicted
    is a judgement without truth. The belief that `make` makes may keep a journal of what happens (smooth, tape).
    """
    listen = listen or {}
    for sensor in (*sensors, *listen):
        if sensor not in drive.measurements:
            raise drive.lacks(sensor)
    run = Filter(robot, sensors, listen, make, {s: len(m.z) for s, m in drive.measurements.items()}, len(drive.t))
    stretches = run.stretches(drive)
    instants, k = Instants(drive, (*sensors, *listen)), 0
    while k < len(instants):
        instants.reached(k)
        last = run.coast(stretches, k)
        if last == k:
            run.advance(k, *instants.at(k), drive.measurements, predicted=stretches.left(k))
        k = max(last, k + 1)
    say_done(None)
    return run.estimates(drive, name or configuration_name(sensors, drive))


def configuration_name(sensors: Sequence[str], drive: Drive) -> str:
    """Return "odometry", one sensor's name, "all", or names joined by + in registry order."""
    present = [s for s in REGISTRY if s in drive.measurements]
    chosen = [s for s in REGISTRY if s in sensors]
    if not chosen:
        return "odometry"
    if chosen == present and len(present) > 1:
        return "all"
    return "+".join(chosen)


class Filter:
    """The filter of one configuration: a belief, one model per sensor, and the record of what happened."""

    def __init__(
        self,
        robot: Robot,
        sensors: Sequence[str],
        listen: Mapping[str, NDArray[np.bool_]] | None = None,
        make: MakeBelief = JointBelief,
        rows: Mapping[str, int] | None = None,
        instants: int = MANY,
    ) -> None:
        """`rows`: how many measurements of each sensor will come, where that is known; `instants` likewise."""
        self._sensors = tuple(s for s in REGISTRY if s in sensors)
        self._wheels = robot.wheels
        self._inflates = {s for s in REGISTRY if s in sensors and robot.settings(s).outliers == "inflate"}
        self._listens = {s: flags.tolist() for s, flags in (listen or {}).items()}
        self.models: dict[str, Model] = {
            s: REGISTRY[s].model(robot.settings(s)) for s in REGISTRY if s in sensors or s in self._listens
        }
        self.belief = _begin(robot, list(self.models.values()), make)
        # what one reading says hangs together by these states: how well it fits as a whole is noted
        self._joint = any(model.joint for model in self.models.values())
        self._in_map: JointBelief | InMap = self.belief  # the belief as it is seen from the map
        self._rolling = [m for m in self.models.values() if type(m).rolled is not Model.rolled]
        mapping = [s for s in self._sensors if self.models[s].maps]
        self._leads = [s for s in mapping if self.models[s].leads]
        self._may_begin = self._leads or mapping  # frames: a leader whenever it likes, else the first of all
        for model in self.models.values():
            model.begin(robot.lines, self.belief)
        for s, model in self.models.items():
            # a sensor that is used must not read what only listens
            model.meet({o: other for o, other in self.models.items() if o in sensors or s not in sensors})
        self._records: dict[str, AnyRecord] = {s: Record((rows or {}).get(s, MANY)) for s in self.models}
        fixed = [b.name for m in self.models.values() for b in m.blocks() if not b.name.startswith("_")]
        if robot.wheels.estimate:
            fixed.append(WHEELS)
        self._track = Track(self.belief, fixed, instants)

    def advance(
        self,
        k: int,
        step: Step,
        due: Sequence[Due],
        measurements: Mapping[str, Measurements],
        predicted: bool = False,
    ) -> None:
        """Take the belief to instant k and correct it by every reading (sensor, i) that is due there.

        `predicted`: it is there already.
        """
        self._move(None if predicted else step, due, measurements)
        belief, in_map, models = self.belief, self._in_map, self.models
        accepted: list[Innovation | Reading] = []
        heard: list[Innovation] = []
        several: list[tuple[str, Rows]] = []  # of one reading, where they are corrected together
        for sensor, i in due:
            model = models[sensor]
            seen = model.innovations(measurements[sensor], i, belief if model.local else in_map)
            if sensor in self._inflates:
                seen = [inflated(innovation) for innovation in seen]
            self._records[sensor].add(k, seen)
            taken, rows = _accepted(seen)
            if sensor not in self._listens or not self._listens[sensor][i]:
                whole = self._joint and rows > 1
                at = 0 if whole and not several else len(accepted)
                accepted[at:at] = taken
                if whole:
                    several.append((sensor, taken))
            elif models[sensor].teaches:
                heard += [innovation for innovation in seen if innovation.verdict == 0]
        if heard:
            belief.listen(heard)
        if accepted:
            self._correct_whole(accepted, several) if several else belief.correct(accepted)
        for sensor, i in due:
            model = models[sensor]
            model.learn(measurements[sensor], i, belief if model.local else in_map)
        if self._leads:
            self._turn_pages()
        self._track.note(self.belief)

    def _turn_pages(self) -> None:
        """Let every sensor whose map is full begin the next one here."""
        for sensor in self._leads:
            if self.models[sensor].turn_page(self.belief):
                self._follow_frame()

    def stretches(self, drive: Drive) -> Stretches:
        """Return where the core may take many instants of a drive at once."""
        found = Stretches(drive, self.models, self.belief, (*self._inflates, *self._listens))
        self._records |= found.records()
        return found

    def coast(self, on: Stretches, k: int) -> int:
        """Take the belief from instant k as far as the core goes; return the instant that is next."""
        last = on.until(k) if self.belief.plain else k
        if last <= k:
            return k
        stop = on.coast(self.belief, k, last, self._track)
        for model in self._rolling:
            if not on.takes(model):
                model.rolled(stop.rolled)
        if stop.finish:
            on.finish(self.belief)
            self._turn_pages()
            self._track.note(self.belief)
        return stop.instant + stop.finish

    def _correct_whole(self, accepted: Rows, several: list[tuple[str, Rows]]) -> None:
        """Correct once by all that was accepted, and note how well readings of several rows fit as a whole.

        The first of these stands first in the equation: whitened, its rows are what they would be alone.
        """
        (sensor, first), *others = several
        joint = [(name, self.belief.joint_nis(seen)) for name, seen in others]
        self.belief.correct(accepted)
        joint.insert(0, (sensor, self.belief.nis_of_first(sum([s.numbers for s in first]))))
        for name, nis in joint:
            self._records[name].joint.extend(nis)

    def _move(self, step: Step | None, due: Sequence[Due], measurements: Mapping[str, Measurements]) -> None:
        """Predict, tell models that ask how far the wheels rolled, and begin a frame where a map begins."""
        if step is not None:
            self.belief.predict(*step)
            for model in self._rolling:
                model.rolled(step.u)
        for sensor, i in due:
            if sensor in self._may_begin and self.models[sensor].begins_map(measurements[sensor], i):
                self._begin_frame()
                self._may_begin = self._leads

    def pose(self) -> Pose:
        """Return the pose (x, y, theta) in the map [m, m, rad], theta not wrapped."""
        return self._in_map.pose()

    def _seen_by(self, model: Model) -> JointBelief | InMap:
        return self.belief if model.local else self._in_map

    def _begin_frame(self) -> None:
        """Let a map of a sensor's own begin in a local frame (fusion.ekf.map_frame)."""
        self.belief.begin_frame()
        self._follow_frame()

    def _follow_frame(self) -> None:
        """See the pose in the map through the local frame, once there is one."""
        if self.belief.frame is not None:
            self._in_map = InMap(self.belief)

    def estimates(self, drive: Drive, name: str) -> Estimates:
        """Return everything recorded, with predictions at the truth's stamps beside it."""
        pose, triangles = self._track.recorded()
        blocks, variances = self._track.blocks(), self._track.blocks(variances=True)
        maps = [m.lines(self._seen_by(m)) for m in self.models.values()]
        truth_pose, truth_P = _at_truth(drive, pose, triangles, blocks.get(WHEELS))
        loops = [loop for m in self.models.values() for loop in m.closed_loops()]
        return Estimates(
            configuration=name,
            sensors=self._sensors,
            t=drive.t,
            pose=pose,
            triangles=triangles,
            audits={s: record.audit() for s, record in self._records.items()},
            blocks=blocks,
            block_sigmas={name: np.sqrt(np.maximum(v, 0.0)) for name, v in variances.items()},
            first_map=[line for first, _ in maps for line in first],
            final_map=[line for _, final in maps for line in final],
            points=[point for m in self.models.values() for point in m.points(self._seen_by(m))],
            truth_pose=truth_pose,
            truth_P=truth_P,
            notes=tuple(self._notes()),
            slips=sum(m.slips() for m in self.models.values()),
            lost=tuple(
                (a, min(b, float(drive.t[-1]))) for m in self.models.values() for a, b in m.lost_intervals()
            ),
            loops=np.array([(loop.then, loop.now) for loop in loops]).reshape(-1, 2),
            loop_poses=np.array([loop.pose for loop in loops]).reshape(-1, 3),
        )

    def _notes(self) -> Iterator[str]:
        """Say what this run found: its wheels, and what every sensor has to say."""
        belief = self.belief
        if self._wheels.estimate:
            column, x = belief.block(WHEELS)
            P = belief.covariance[column : column + len(x), column : column + len(x)]
            metric = {s: REGISTRY[s].scale_key for s in self._sensors if REGISTRY[s].measures_metres}
            yield from (f"wheels: {words}" for words in wheel_words(self._wheels, x, P, self._sensors, metric))
        for name, model in self.models.items():
            yield from (f"{name}: {words}" for words in model.notes(self._seen_by(model)))


def _accepted(seen: Sequence[Innovation]) -> tuple[Rows, int]:
    """Return what corrects the filter, and how many rows that is."""
    if isinstance(seen, Reading):
        return [seen] if seen.accepted else [], seen.accepted
    taken: Rows = [innovation for innovation in seen if innovation.verdict == 0]
    return taken, len(taken)


def _begin(robot: Robot, models: Sequence[Model], make: MakeBelief) -> JointBelief:
    """Return the belief at the start."""
    blocks = [block for model in models for block in model.blocks()]
    if not robot.wheels.estimate:
        return make(*_start(robot.start), blocks)
    belief = make(*_start(robot.start), [*blocks, wheel_block(robot.wheels)])
    belief.drive_with(WHEELS)
    return belief


def _start(start: StartSettings) -> tuple[tuple[float, float, float], Triangle]:
    xx, yy, tt = start.variances
    return start.pose, (xx, 0.0, 0.0, yy, 0.0, tt)


def _at_truth(
    drive: Drive, pose: Array, triangles: Array, wheels: Array | None
) -> tuple[Array | None, Array | None]:
    """Predict pose and covariance at the truth's stamps; NaN outside the drive. Never fed back."""
    if drive.truth_motions is None or drive.truth_instant is None:
        return None, None
    n, motions = len(drive.truth_instant), drive.truth_motions
    out, spread = np.empty((n, 3)), np.empty((n, 3, 3))
    for at in (slice(a, a + AT_ONCE) for a in range(0, n, AT_ONCE)):
        k = np.maximum(drive.truth_instant[at], 0)
        u = motions.u[at]
        if wheels is not None:
            u = u + np.einsum("nij,nj->ni", motions.J[at], wheels[k])
        out[at], spread[at] = predicted(pose[k], matrices(triangles[k]), u, motions.Q[at])
    outside = drive.truth_instant < 0
    out[outside], spread[outside] = np.nan, np.nan
    return out, spread
