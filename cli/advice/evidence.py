"""Faults of a log under some settings, and candidate fixes for them.

A wrong clock, mount, scale or direction looks like an offset or noise. So offsets and noise are judged only after
these are right.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterator, Sequence
from functools import cached_property, partial

import numpy as np
from msgspec.structs import replace

from locfuse.fusion.checks import positions, probes
from locfuse.fusion.checks.clocks import (
    CLOCK,
    MIN_LAG_S,
    SEVERE_LAG_S,
    UNEVEN,
    Clock,
    clock_words,
    differences,
    offset_of,
    rival_of,
    rival_words,
    start_kept,
    wrong_clocks,
)
from locfuse.fusion.checks.compass import ROOM, of_moving_offset
from locfuse.fusion.checks.examine import CARRIED, HELD, scales
from locfuse.fusion.checks.finding import Finding, Least
from locfuse.fusion.checks.gyro import SATURATED, of_rest_noise
from locfuse.fusion.checks.lag import SAID_SIGMAS, Lag
from locfuse.fusion.checks.landmarks import CLOCKWISE
from locfuse.fusion.checks.laser import BUMP, OPEN_SCALE, UNSWEPT
from locfuse.fusion.checks.laser_ranges import BEAM_ANGLES, OFFSET
from locfuse.fusion.checks.pictures import MIRRORED_SHARE, RIMS, turning_along
from locfuse.fusion.checks.points import MAP, SCALE as RANGE_SCALE
from locfuse.fusion.checks.slip import of_spins
from locfuse.fusion.checks.start import START, start_by_path, start_by_shape
from locfuse.fusion.checks.steering import ZERO
from locfuse.fusion.checks.tracked_point import AHEAD, CREEP, POINT, YAW, of_point, swing
from locfuse.fusion.checks.tried import ESTIMATED, Candidate, Fixes, by_key, keys, together
from locfuse.fusion.checks.truth import AXES, COPY, MOVED, OTHER, SIZE, STEP, UNIT, WHEEL_SCALE, of_truth, of_ways
from locfuse.fusion.checks.turning import MIRROR, RATIO, SURE_RATIO, SWAPPED, TRACK, exchanged, turnings
from locfuse.fusion.data import BASES, LASER
from locfuse.fusion.judge.consistency import Consistency, NoiseEvidence, biased_against
from locfuse.fusion.judge.innovations import compare_readings
from locfuse.fusion.sensors.registry import REGISTRY
from locfuse.fusion.truth import body_poses

from .judged import UNREMARKABLE, NoiseFindings, as_fixes

TRIED_SIGMAS = 2.5  # standard deviations of a time lag: a larger lag is tried
MIN_AGAIN_S = 0.005  # smallest lag to fix, after an earlier fix has set a time offset
MIN_SPREAD_S = 0.003  # sigma of a lag above which neighbouring values are tried too
MIN_TURNED_DEG = 10.0  # degrees: a start that is turned by less is not tried
CAMERA_LAGS_S = (-0.2, -0.1, 0.1, 0.2)
SUSPICIOUS_SCALE = Least(0.005, 2.5)  # least scale error that is suspicious without other findings


# codes of findings with a measured value: by truth, magnetic field, stamps or straight walls
MEASURED = (UNEVEN, OFFSET, WHEEL_SCALE, POINT, YAW, "iron", ROOM, CREEP, RIMS, "yaw")
TRUTH_NOISE = ("truth", "noise")  # role and code
MAX_SITS_SHARE = 0.5  # largest difference of two distances of an odometry's body, as a share of one
MAX_SCAN_PERIOD_S = 0.4  # with a longer one the laser's path follows the wheels between scans
KEYLESS = {
    OPEN_SCALE,
    CREEP,
    BUMP,
    BEAM_ANGLES,
    UNSWEPT,
    SWAPPED,
    UNEVEN,
    CLOCKWISE,
    MAP,
    positions.PATH,
    positions.SPEEDS,
    RANGE_SCALE,
    SATURATED,
    HELD,
    ZERO,
}  # findings that are named although no setting fixes them
BY_SHAPE = {("wheels", SWAPPED), ("wheels", "mirrored"), ("wheels", AHEAD)}  # judged after alignment


class Evidence(NoiseFindings):
    """One log compared under some settings, with its findings and candidate fixes."""

    def suspicious(self) -> bool:
        """Return whether anything looks wrong; if not, no fix is tried."""
        noise = any(f.verdict not in UNREMARKABLE for f in self.consistency.values())
        lost = any(e.lost for e in self.compared.estimates)
        drive, robot = self.loaded.drive, self.loaded.robot
        return bool(
            noise
            or self.overconfident
            or lost
            or self.wrong
            or self._worse_than_odometry()
            or self._mounts_found
            or self._other_mounts
            or self._distances
            or self._biases_again
            or self._slips_unusually
            or self._ranges_scatter
            or self._spins
            or scales(drive, robot, turnings(drive), least=SUSPICIOUS_SCALE)
            or self._walls_bend
            or any(f.severe or f.code in {AHEAD, STEP} for f in self.doctor)
        )

    def classes(self) -> Sequence[Sequence[Callable[[], Sequence[Candidate]]]]:
        """Return the classes of faults in the order in which they are searched.

        A class is a list of functions; each returns the candidate fixes of one kind of fault. A class is searched
        only if the earlier classes have no severe finding that is still open.
        """
        return (
            (self.truth,),
            (self.start, self.sense, self.clocks, self.other_clocks, self.geometry, self.start_at_last),
            (
                self.offsets,
                self.claims,
                self.slips,
                *(partial(self.unspoilt, f) for f in (self.noise, self.unexplained)),
            ),
        )

    def unspoilt(self, find: Callable[[], list[Candidate]]) -> list[Candidate]:
        """Return the candidates of `find` without those that a fault without a setting explains.

        Scattering stamps of one sensor can look like noise of another sensor, whose stamps are even. Errors by
        wheels that creep sideways show no noise.
        """
        uneven, creeps = ({f.role for f in self.doctor if f.code == code} for code in (UNEVEN, CREEP))
        found = [c for c in find() if not creeps or c.measured or not c.offer]
        return [c for c in found if not uneven or c.finding.role in uneven or c.finding.role not in REGISTRY]

    def _worse_than_odometry(self) -> bool:
        errors = {e.name: e.figures.get("position_rmse_m") for e in self.compared.evaluations}
        base = next((errors[n] for n in BASES if n in errors), None)
        if base is not None:
            return any(e is not None and e > base for e in errors.values())
        return any(s.high < 0.0 for s in self.compared.scores)

    def truth(self) -> list[Candidate]:
        """Return findings that make errors invalid: a truth that steps or is mirrored, a robot that is carried."""
        void = {STEP, MOVED, COPY, MIRROR, UNIT, AXES, SIZE, OTHER, CARRIED}
        return [self._candidate(f, ()) for f in self.doctor if f.code in void]

    def start(self) -> list[Candidate]:
        """Return the finding on a wrong start, which is fixed first since it affects every error."""
        found, truth = (f for f in self.doctor if f.code == START and f.fixes), self.loaded.drive.truth
        by_shape = () if truth is None else start_by_shape(truth, self.loaded.drive)
        by_path = tuple(f.fixes for f in self._start_by_path)
        ways = ((f, by_path or tuple(filter(None, (f.fixes, by_shape)))) for f in found)
        candidates = [replace(self._start(f, either), offer=not f.severe) for f, either in ways]
        if candidates or not by_shape or any(fix.startswith("start.") for fix in self.fixes):
            return candidates
        # wheels that slip hide how the path of positions is turned: only a trial shows it
        theta = float(by_shape[-1].partition("=")[2])
        turned = abs(math.remainder(theta - self.loaded.robot.start.theta_deg, 360.0))
        if turned < MIN_TURNED_DEG or not self.loaded.robot.start_given:
            return []
        words = f"by the shape of its first metres the start is turned by {turned:.0f}°"
        return [self._candidate(Finding("truth", START, words), (by_shape,), True)]

    def _start(self, finding: Finding, ways: tuple[Fixes, ...]) -> Candidate:
        known = self.trial.configurations
        drifting = tuple(n for n, c in known.items() if not any(REGISTRY[s].locates for s in c.sensors))
        return replace(self._candidate(finding, ways), measured=True, drifting=drifting)

    @cached_property
    def _start_by_path(self) -> list[Finding]:
        """Findings on the start by the whole path of the laser, if the truth's first readings are less exact."""
        drive, robot = self.loaded.drive, self.loaded.robot
        if drive.truth is None or not self._starts_in_map:
            return []
        paths = ((e.truth_pose, e.truth_P) for e in self.runs_alone(LASER))
        found = (
            start_by_path(drive.truth, x, P, drive, robot) for x, P in paths if x is not None and P is not None
        )
        return [f for f in found if f is not None]

    def start_at_last(self) -> list[Candidate]:
        """Return the finding on a start that only the laser's whole path shows, on clocks and points set right."""
        return [self._start(f, (f.fixes,)) for f in self._start_by_path]

    def sense(self) -> list[Candidate]:
        """Return the finding on wheels that turn the wrong way, by a trial, if no sensor measures turns."""
        drive, robot = self.loaded.drive, self.loaded.robot
        by = [s for s in drive.measurements if REGISTRY[s].locates and self._verdict(s) not in UNREMARKABLE]
        if not by or drive.truth is not None or turnings(drive):
            return []
        finding = exchanged(drive, robot, {}, by, self.loaded.stream("wheels"))
        return [self._candidate(finding, (finding.fixes,), True)]

    @cached_property
    def _lags(self) -> dict[tuple[str, str], Lag]:
        """Time lags of pairs of clocks."""
        return differences(self.loaded.drive, self.loaded.robot, self.compared.estimates)

    @cached_property
    def wrong(self) -> list[tuple[Clock, ...]]:
        """Sets of wrong clocks that each explain the time lags between sensors, the best explanation first."""
        found = self._lags
        again = any(".time_offset=" in fix for fix in self.fixes)
        return wrong_clocks(found, TRIED_SIGMAS, MIN_AGAIN_S if again else MIN_LAG_S)

    def clocks(self) -> list[Candidate]:
        """Return candidate time offsets that best explain lags between sensors, and guesses for the camera."""
        return [*self._late(self.wrong[:1]), *self._late_pictures()]

    def other_clocks(self) -> list[Candidate]:
        """Return candidate time offsets by all but the best explanation of the lags between sensors.

        Sensors with a wrong clock in the best explanation are left out: `clocks` has their candidates.
        """
        first = {clock.name for clocks in self.wrong[:1] for clock in clocks}
        return self._late(self.wrong[1:], first)

    def _late(self, explanations: Sequence[Sequence[Clock]], others: Collection[str] = ()) -> list[Candidate]:
        """Return candidate time offsets of the clocks in these explanations, but of `others`."""
        found: dict[str, Candidate] = {}
        by_truth = self.loaded.drive.truth is not None
        for clock in (clock for clocks in explanations for clock in clocks):
            if clock.name in found or clock.name in others or not self.judges(clock.name):
                continue  # no run uses this sensor
            sure = abs(clock.offset) > SAID_SIGMAS * clock.sigma
            rival = rival_words(rival_of(self.wrong), self.loaded.robot) if clock in self.wrong[0] else ""
            words = f"{clock_words(clock)}{rival}"
            finding = Finding(clock.name, CLOCK, words, (), sure and abs(clock.offset) > SEVERE_LAG_S)
            bumps = self._bumped and not finding.severe  # steps in headings, which look like small lags
            if not by_truth and (bumps or (clock.offset > 0.0 and not sure)):  # latency makes stamps late
                continue
            steps = (0.0, -1.0, 1.0) if clock.sigma > MIN_SPREAD_S else (0.0,)
            drive, robot = self.loaded.drive, self.loaded.robot
            ways = tuple(self._with_start((offset_of(clock, robot, 3, n),)) for n in steps)
            measured = ways[0][1:]  # the start pose, if `_with_start` added it
            if clock.name == "wheels" and not measured and (start := start_kept(clock.offset, drive, robot)):
                ways = ((*ways[0], *start), *ways)
            if clock.name == positions.GPS:
                ways = (*ways, self._with_antenna(ways[0]))
            one = self._candidate(finding, ways, not finding.severe)
            proven = finding.severe and len(clock.against) > 1
            shape = by_truth and clock.name in {LASER, "truth"}
            found[clock.name] = replace(one, measured=sure, proven=proven, by_shape=shape)
        return [*found.values()]

    def _with_start(self, fixes: Fixes) -> Fixes:
        """Add the start pose by truth under a new time offset, if an earlier fix has set the start pose."""
        if not any(fix.startswith("start.") for fix in self.fixes):
            return fixes
        loaded = self.trial.under(together(self.fixes, fixes))
        if loaded is None or (truth := loaded.drive.truth) is None:
            return fixes
        found = (f.fixes for f in of_truth(loaded.drive, loaded.robot) if f.code == START)
        return together(fixes, next(found, start_by_shape(truth, loaded.drive)))

    def _with_antenna(self, fixes: Fixes) -> Fixes:
        """Add the position of a GPS antenna under a new time offset: a late clock looks like another position."""
        loaded = self.trial.under(together(self.fixes, fixes))
        found = None if loaded is None else positions.of_antenna(loaded.drive, loaded.robot, ())
        return fixes if found is None else together(fixes, found[0].fixes)

    def _late_pictures(self) -> Iterator[Candidate]:
        """Yield time offsets to try for an inconsistent camera, and the fix of a constant bearing error.

        Without truth bearings do not show a lag directly, so these are guesses, made only without a severe camera
        finding.
        """
        verdict = self.consistency.get("camera")
        if ("camera", "truth") in self._lags:
            return  # measured
        if any(f.role == "camera" and f.severe and f.fixes for f in self.doctor) or verdict is None:
            return
        if verdict.verdict in {*UNREMARKABLE, "overstated"} or not self.judges("camera"):
            return
        now = float(self.loaded.robot.settings("camera").time_offset)
        ways = tuple((f"camera.time_offset={now + step:z.3f}",) for step in CAMERA_LAGS_S)
        yield self._candidate(Finding("camera", CLOCK, f"{verdict.words}; its clock explains that"), ways, True)
        if constant := self.constant(verdict):
            yield self._candidate(Finding("camera", verdict.verdict, verdict.words), constant, True)

    def geometry(self) -> list[Candidate]:
        """Return candidate fixes of mounts, scales and directions, from compared sensors or from filter states."""
        # distances that differ look like a wrong mount; a laser that was bumped has no single mount
        no_mount = self._open_scale or self._distances or self._bumped
        probed = [*self._points(), *(() if no_mount else self._probed())]
        named = {(f.role, f.code) for f in probed}
        mounts = [] if no_mount else self._mounts_found
        found = [*probed, *(f for f in mounts if (f.role, f.code) not in named)]
        # The sigma of a state is valid only in a consistent or underconfident run. Without truth, a mount state
        # also absorbs errors of the wheels. Sideways motion looks like yaw, another centre of turns like x, and
        # wrong scales look like y. The runs of `_probed` also estimate the scales, so their y is the mount's own.
        by_truth = self.loaded.drive.truth is not None
        fine = {f.role for f in found if self._verdict(f.role) in {*UNREMARKABLE, "overstated"}}
        confirmed = [] if by_truth else [f for f in probed if f.role in fine and keys(f.fixes) == {f"{f.role}.y"}]
        seen = [self._unless_open(f) for f in self.doctor if f.code not in {CLOCK, START}]
        # a sensor whose readings are all rejected gets no candidate
        known = [self._seen(f) for f in seen if (f.fixes or f.code in KEYLESS) and self.judges(f.role)]
        sharper = [
            replace(
                self._candidate(f, (f.fixes,), True),
                measured=(f.role in fine and (by_truth or f.code != probes.MOUNT)) or f in confirmed,
                proven=f in confirmed,
            )
            for f in found
            if f.fixes
        ]
        scales = [] if self._open_scale else [self._unless_open(f) for f in self._distances]
        if any(f.code == OPEN_SCALE and not f.fixes for f in scales):
            scales = scales[:1]  # no fix of wheels: equal scales improve predictions even if both are wrong
        open_ = [self._candidate(f, ()) for f in found if not f.fixes]
        ways = [self._candidate(f, (f.fixes,) if f.fixes else ()) for f in scales]
        return [*known, *self._antenna(), *sharper, *open_, *ways]

    def _seen(self, finding: Finding) -> Candidate:
        """Return the candidate for a finding of `doctor`, with variants of its fix."""
        measured = finding.code in MEASURED and (finding.severe or finding.code != OFFSET)
        proven = finding.code == SURE_RATIO
        measured = measured or proven or (finding.code == AHEAD and self._sits_as_far_back(finding))
        measured = measured or (finding.code == TRACK and finding.severe)  # turns beyond what slip explains
        ways = [finding.fixes] if finding.fixes else []
        if finding.code == WHEEL_SCALE and len(finding.fixes) > 1:
            ways.append(finding.fixes[:1])  # the radius alone, without the track
        if keys(finding.fixes) & {"wheels.scale", "wheels.turn_scale"}:
            ways.append(ESTIMATED)
        ways += self._with_camera_offset(finding)
        offer = not (finding.severe or measured or finding.code in {RATIO, HELD, AHEAD})
        one = self._candidate(finding, tuple(ways), offer)
        if one.key == TRUTH_NOISE and self.overconfident:
            # it changes no pose, and the truth alone shows it: what then is underconfident was so before
            return replace(one, measured=True, proven=True, minor=one.judges, offer=False)
        return replace(one, measured=measured, proven=proven, by_shape=one.key in BY_SHAPE)

    def _sits_as_far_back(self, finding: Finding) -> bool:
        """Return whether a sensor's estimated mount is as far back as an odometry's body seems to be ahead."""
        robot = self.loaded.robot
        ahead = float(by_key(finding.fixes)["wheels.x"]) - robot.wheels.x
        runs = ((e.sensors[0], e.blocks.get(f"{e.sensors[0]}_x")) for e in self.runs_alone())
        moved = (float(x[-1, 0]) - robot.settings(name).x for name, x in runs if x is not None)
        return any(abs(back + ahead) < MAX_SITS_SHARE * abs(ahead) for back in moved)

    def slips(self) -> list[Candidate]:
        """Return the candidate fix of wheels.noise, if turns show slip and the distance scale is certain."""
        certain = not (self._open_scale or self._distances)
        return [self._wheel_noise()] if certain and self._slips_unusually else []

    @cached_property
    def _distances(self) -> list[Finding]:
        """Findings on different path lengths by laser and wheels, in a log without truth."""
        drive, robot = self.loaded.drive, self.loaded.robot
        if drive.truth is not None or drive.wheels.matched is not None:
            return []
        return [f for e in self.runs_alone(LASER) for f in of_ways(drive, robot, e)]

    def _with_camera_offset(self, finding: Finding) -> tuple[Fixes, ...]:
        """Combine the fix of a mirrored picture or displaced picture circle with the camera's new zero direction.

        The zero direction is measured against a run of another sensor, since wheels with a wrong track give wrong
        headings. Returns () if it cannot be measured.
        """
        run = self._reference("camera") if finding.code in {"mirrored", RIMS} else None
        loaded = None if run is None else self.trial.under(together(self.fixes, finding.fixes))
        if run is None or loaded is None:
            return ()
        found = compare_readings(loaded.drive, loaded.robot, run, "camera")
        if found is None or found.bias is None:
            return ()
        fix_values = biased_against("camera", loaded.robot.settings("camera"), found).fix_values
        return (together(finding.fixes, as_fixes(fix_values)),)

    @property
    def _bumped(self) -> bool:
        """Whether the laser's direction on the robot changes during the drive."""
        return any(f.code == BUMP for f in self.doctor)

    @property
    def _open_scale(self) -> bool:
        """Whether laser and wheels differ in distance scale and no sensor shows which is wrong."""
        return any(f.severe and not self._unless_open(f).fixes for f in self.doctor if f.code == OPEN_SCALE)

    def _unless_open(self, finding: Finding) -> Finding:
        """Return the finding, or a copy without its fix if nothing in the log shows whether the fix is right.

        Only one finding can lose its fix: that laser and wheels differ in distance scale. A sensor that measures
        more than heading may decide which of both is wrong. Predictions cannot decide: they are best with equal
        scales of laser and wheels, even if both are wrong.
        """
        known = self.loaded.drive.measurements
        few = np.arange(2)  # readings: enough to see whether a sensor measures heading
        if finding.code != OPEN_SCALE or any(REGISTRY[s].heading(m.take(few)) is None for s, m in known.items()):
            return finding  # a sensor that measures more than heading may decide
        return replace(finding, fixes=(), message=f"{finding.message}. Nothing in this log says which")

    def _points(self) -> Iterator[Finding]:
        """Yield a finding if the run with all sensors shows another tracked point of the truth than configured."""
        truth = self.loaded.drive.truth
        for e in self.compared.estimates:
            if truth is not None and e.name == self._all() and e.truth_pose is not None and not e.lost:
                yield from of_point(truth, swing(truth, self.loaded.drive, e.truth_pose[:, :2]))

    def _antenna(self) -> list[Candidate]:
        """Return the candidate for position or clock of a GPS antenna, measured by the runs without GPS."""
        if not self._using(positions.GPS):
            return []
        runs = [e for e in self.compared.estimates if positions.GPS not in e.sensors and not e.lost]
        if (found := positions.of_antenna(self.loaded.drive, self.loaded.robot, runs)) is None:
            return []
        finding, ways = found[0], tuple(filter(None, (found[0].fixes, found[1])))
        return [self._candidate(finding, ways, not finding.severe)]

    def _probed(self) -> Iterator[Finding]:
        """Yield findings on mounts and track from runs that estimate them, and on the size of the laser's path."""
        drive, robot = self.loaded.drive, self.loaded.robot
        for sensor in filter(self._using, drive.measurements):
            if sensor == LASER and drive.wheels.matched is not None:
                continue  # with motion by scan matching the mount is not observable
            probe = probes.probe_of(robot, sensor)
            if not probe or not REGISTRY[sensor].placed:
                continue
            if not self._looks_wrong(sensor) and sensor not in self._other_mounts:
                continue
            run = self.trial.run((*self.fixes, *probe), self._alone(sensor))
            if run is not None and not run.lost:
                yield from probes.of_probe(robot, sensor, run, drive.truth is not None)
        for e in self.runs_alone(LASER):
            if self._looks_wrong(LASER):
                yield from probes.of_scale(robot, e, drive)

    @cached_property
    def _mounts_found(self) -> list[Finding]:
        """Findings on mounts that the run with this sensor alone estimates differently than configured."""
        robot, judged = self.loaded.robot, self.loaded.drive.truth is not None
        return [f for e in self.runs_alone() for f in probes.of_mount(robot, e.sensors[0], e, judged)]

    @cached_property
    def _other_mounts(self) -> set[str]:
        """Sensors whose estimated mount differs from the configured one; always empty with truth."""
        if self.loaded.drive.truth is not None:
            return set()  # errors to the truth judge the mount instead
        far = {e.sensors[0] for e in self.runs_alone() if probes.beyond_prior(self.loaded.robot, e.sensors[0], e)}
        return far | {f.role for f in self._mounts_found if f.code == probes.MOUNT}

    def offsets(self) -> list[Candidate]:
        """Return candidate fixes of constant errors: compass and camera offsets, or a mirrored camera."""
        drive, robot = self.loaded.drive, self.loaded.robot
        with_all = [e for e in self.compared.estimates if e.name == self._all() and drive.truth is not None]
        constant = [f for e in with_all for f in probes.of_offsets(robot, e)]
        found = [self._candidate(f, (f.fixes,), True) for f in constant]
        for sensor, again in self._biases_again.items():
            one = self._candidate(Finding(sensor, "biased", again.words), (as_fixes(again.fix_values),), True)
            found.append(replace(one, measured=True))
        if self._using(positions.GPS):
            found += [self._candidate(f, (f.fixes,), True) for f in positions.of_east(drive, robot)]
        start = self._start_heading()
        found += start
        for sensor, verdict in self.consistency.items():
            either = sensor == "compass" and any(not c.alternatives for c in start)  # compass offset or start
            options = [] if either else list(self.constant(verdict))
            wrong = {"biased", "outliers", "contradicts", "understated"}
            if sensor == "camera" and verdict.verdict in wrong:
                share, _ = turning_along(drive, robot)
                turned = not robot.settings("camera").clockwise
                if share is None or share > 1.0 - MIRRORED_SHARE:  # turns do not show that it is not mirrored
                    options.append((f"camera.clockwise={str(turned).lower()}",))
            if options:
                finding = Finding(sensor, verdict.verdict, verdict.words)
                found.append(self._candidate(finding, tuple(options)))
        return found

    def claims(self) -> list[Candidate]:
        """Return candidate sigmas of sensors of positions that are less exact, by the truth, than they claim.

        Also that of a gyro by its noise at standstill, and the drift of a compass offset.
        """
        drive, robot = self.loaded.drive, self.loaded.robot
        whole = self.trial.whole_under(self.fixes) or self.loaded
        found = [
            *positions.of_claims(whole.drive, robot),
            *of_rest_noise(drive, robot),
            *of_moving_offset(drive, robot, next(iter(self.runs_alone(LASER)), None)),
        ]
        return [self._candidate(f, (f.fixes,)) for f in found if self.judges(f.role)]

    def _start_heading(self) -> list[Candidate]:
        """Return a finding if configured start heading and configured compass offset disagree.

        The finding has a fix only if a sensor locates the robot in the map; else start or compass may be wrong.
        """
        verdict, robot = self.consistency.get("compass"), self.loaded.robot
        offset = robot.settings("compass").offset_deg
        if verdict is None or offset is None or self.loaded.drive.truth is not None or not robot.start_given:
            return []
        if verdict.verdict != "biased" or robot.start.sigma_theta_deg:
            return []
        off = math.remainder(verdict.fix_values["compass.offset_deg"] - offset, 360.0)
        words = f"the compass, whose offset is configured, shows another heading at the start: {off:+.1f}°"
        fixes = (f"start.theta_deg={robot.start.theta_deg + off:.1f}",)
        models = {s: REGISTRY[s].model(robot.settings(s)) for s in self.loaded.drive.measurements}
        if any(REGISTRY[s].locates and not model.local for s, model in models.items()):
            return [self._candidate(Finding("start", "heading", words), (fixes,), True)]
        either = f"compass.offset_deg={verdict.fix_values['compass.offset_deg']:g} or {fixes[0]}"
        message = f"{words}. Nothing in this log says which: {either}"
        return [self._candidate(Finding("start", "heading", message), ())]

    @cached_property
    def _biases_again(self) -> dict[str, Consistency]:
        """Verdicts "biased" on offsets set by an earlier fix: a later fix may have changed them."""
        keys = [fix.partition("=")[0] for fix in self.fixes]
        biases = {s: REGISTRY[s].bias for s in self.consistency}
        fixed = [s for s, b in biases.items() if b is not None and f"{s}.{b.key}" in keys[:-1]]
        if not fixed:
            return {}
        found_noise = NoiseEvidence(self.compared.runs, self.loaded.robot, self.overconfident)
        found = {s: found_noise.bias(s) for s in fixed if self._verdict(s) != "biased"}
        return {s: verdict for s, verdict in found.items() if verdict is not None}

    def unexplained(self) -> list[Candidate]:
        """Return findings on unusual residuals that no setting is known to fix."""
        unusual = [
            Finding(sensor, verdict.verdict, verdict.words)
            for sensor, verdict in self.consistency.items()
            if verdict.verdict not in UNREMARKABLE and not verdict.fix_values
        ]
        return [self._candidate(finding, ()) for finding in (*self._spins, *unusual)]

    @cached_property
    def _spins(self) -> list[Finding]:
        """Findings on times when both wheels slipped, shown by truth, or without it by the laser's path."""
        drive = self.loaded.drive
        if drive.truth is not None and drive.truth.theta is not None:
            return of_spins(drive, drive.truth.t, body_poses(drive.truth, drive.truth.t), "truth")
        scans = drive.measurements.get(LASER)
        if scans is None or len(scans.t) < 2 or np.median(np.diff(scans.t, append=np.inf)) > MAX_SCAN_PERIOD_S:
            return []
        turns = ((e, [j.t for j in e.jumps if j.step[2]]) for e in self.runs_alone(LASER))
        return [f for e, turned in turns for f in of_spins(drive, e.t, e.pose, "laser's path", turned)]
