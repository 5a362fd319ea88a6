"""Examination of a log: its sensors are compared with each other, before any filter runs.

No estimated pose is needed. Turns are compared over windows; the motion between scans is compared with that of the
wheels, and the truth with both. A finding names the setting that fixes it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence

import numpy as np
from msgspec.structs import replace

from locfuse.fusion.data import Array, Drive, Measurements, Stream, stretches
from locfuse.fusion.lines.scans import MAX_BEAMS, MAX_LINES
from locfuse.fusion.robot import Robot
from locfuse.fusion.sensors.registry import REGISTRY
from locfuse.fusion.streams import gap_limit
from locfuse.fusion.truth import heading_notes
from locfuse.fusion.wheels.odometry import BODY_READS
from locfuse.fusion.wheels.repairs import CAUGHT_UP, gaps_of

from .clocks import CLOCK, EQUAL, of_clocks, of_equal_stamps, of_uneven_stamps
from .compass import of_convention, of_iron, tilted
from .finding import Finding, Least
from .gyro import of_gyro, of_saturation
from .landmarks import of_landmarks
from .laser import BUMP, SLIPPING, laser_motion, of_laser, of_radius, of_slipping, of_sweep
from .laser_ranges import of_angles, of_beam_angles, of_limit, of_offset, of_range_unit, of_scatter, unreturned
from .points import of_points
from .positions import of_positions, with_fixes_as_truth
from .raw_data import PUBLISHERS, STUCK, UNSIGNED, of_publishers, of_signs, of_stuck_wheel, of_wheel_unit
from .start import of_start
from .steering import ZERO, of_steering
from .tracked_point import of_odometry
from .truth import SIZE, UNIT, metre, of_few, of_size, of_truth, of_wrong_kind, wheels_metre
from .turning import (
    LAG_STEP_S,
    MAX_LAG_S,
    MIRROR,
    Turnings,
    and_truth,
    clock_offset,
    far_by_scans,
    headings_of,
    of_ratio,
    of_track,
    of_turning,
    turnings,
)

MIN_DURATION_S = 5.0  # of a drive by which sensors are judged
MIN_READINGS = 10  # readings from which a sensor is judged
MAX_EMPTY_SHARE = 0.9  # largest share of readings without a measurement: with more a sensor is dead or misread
REASONS = {
    "repeat": "repeat the one before",
    "same_stamp": "share the stamp of another",
    "not_finite": "hold NaN, Inf or a quaternion of zeros",
    "zeros": "hold zeros in place of a value",
    "outside_wheels": "before the first or after the last of the wheels",
    "too_many_beams": f"with more beams than can be true (over {MAX_BEAMS})",
    "too_many_lines": f"with more walls than can be true (over {MAX_LINES})",
}
REPAIRED = {"spike", "other_joints"}
MIN_COVERED_SHARE = 0.5  # of the drive, by the times of a sensor
HOLE = "hole"  # code of the finding on a time in which nothing was recorded
# least motion in a hole: m, rad, share of the drive's distance; over a smaller one, wheel odometry is good enough
MIN_HOLE_M, MIN_HOLE_RAD, MIN_HOLE_SHARE = 0.3, math.radians(20.0), 0.05
# codes of findings that make all other checks wrong
MIXED = frozenset({EQUAL, PUBLISHERS, SLIPPING, STUCK, UNIT, UNSIGNED})
HELD = "held"  # code of the finding on counters that stood still while the robot drove far, and then caught up
CARRIED = "carried"  # code of the finding on a robot that moves while its wheels stand
# while the wheels stand, least motion of the truth: m, sigmas of its noise; least turn of the laser: rad
MIN_CARRIED_M, MIN_CARRIED_SIGMAS, MIN_CARRIED_RAD = 0.3, 6.0, math.radians(15.0)
BLIND = "blind"  # code of the finding on a sensor without measurements
CHECK_SENSOR = "Check the sensor and its driver, then record again"


def examine(
    drive: Drive, robot: Robot, streams: Mapping[str, Stream], least: Least | None = None
) -> list[Finding]:
    """Return all findings on a measured drive; `streams` are the raw readings by role.

    `least` is the smallest reported error of a scale or the track, set by a caller that tries the fixes. None:
    each check uses its own, larger limit.
    """
    far = any(_moved(drive, start)[0] > MIN_HOLE_M for start, _ in gaps(drive.wheels.t))
    codes = [HELD if far and CAUGHT_UP in repair else "repaired" for repair in drive.repairs]
    found = [Finding("wheels", code, repair) for code, repair in zip(codes, drive.repairs, strict=True)]
    if drive.truth is not None and "truth" in streams:
        found += [Finding("truth", "seen", note) for note in heading_notes(drive.truth, streams["truth"].msgtype)]
    found += _refused(drive)
    found += of_data(drive, robot, streams.__getitem__)
    if mixed := {f.code for f in found} & MIXED:  # with stuck or slipping wheels, the start is still known
        return [*found, *(_start(drive, robot) if mixed <= {STUCK, SLIPPING} else [])]
    for name, m in drive.measurements.items():
        found += _of_times(name, m.t, drive)
        found += [Finding(name, "seen", note) for note in m.notes]
        found += of_uneven_stamps(name, m.t)
    if "lrf" in drive.measurements:
        lrf = streams["lrf"], robot.settings("lrf")
        found += [*of_limit(*lrf), *of_scatter(*lrf), *of_offset(*lrf, least is not None)]
        found += of_beam_angles(lrf[0], drive, robot.settings("lrf"))
    by_sensor = turnings(drive)
    turning = of_steering(drive, robot, streams["wheels"]) or of_turning(drive, robot, by_sensor, streams)
    wrong_wheels = any(o.role == "wheels" and o.severe for o in turning)
    tilts = tilted(drive, robot, streams, by_wheels=not wrong_wheels, by_sensor=by_sensor)
    found += [*of_convention(drive, robot, streams), *tilts]
    found += [] if tilts else of_iron(drive, robot, streams)
    found += [o for o in turning if o.role not in {t.role for t in tilts}]
    if "lrf" in drive.measurements and not any(o.role in {"lrf", "wheels"} for o in turning):
        found += of_sweep(streams["lrf"], drive, robot, clock_offset("lrf", by_sensor))
    if wrong_wheels:  # other checks need correct wheels
        return [*found, *(_start(drive, robot) if any(o.code == ZERO for o in turning) else [])]
    wrong = of_wrong_kind(drive)
    found += wrong
    if wrong or any(o.code == MIRROR for o in turning):
        drive = replace(drive, truth=None)  # such a truth is not compared
    body, drive = of_odometry(drive, robot)
    found += body
    found += of_landmarks(drive, robot) or of_points(drive, robot)
    found += [*of_positions(drive, robot), *of_saturation(drive, robot, streams)]
    if "camera" in drive.measurements:
        from .pictures import of_calibration, of_handedness  # imported here since it needs OpenCV

        found += [*of_calibration(streams["camera"], robot.settings("camera")), *of_handedness(drive, robot)]
    found += of_carried(drive)
    sizes = scales(drive, robot, by_sensor, turning, least)
    if least is None:  # callers that try fixes compare clocks themselves
        clocks = of_clocks(drive, robot)
        late = any(o.severe and o.role in {"lrf", "wheels"} for o in clocks)  # walls at other times seem to turn
        sizes = [*(o for o in sizes if not (late and o.code == BUMP)), *clocks]
        sizes += unseen(drive) if sizes else []
    truth = [] if any(o.code == SIZE for o in sizes) else of_truth(_on_clocks(drive, robot, sizes), robot)
    return [*found, *sizes, *truth]


def _on_clocks(drive: Drive, robot: Robot, found: Sequence[Finding]) -> Drive:
    """Return the drive with its truth on the wheels' clock, if a finding has a time offset of one of both.

    All fixes of a log are set together, so the start must be that under the other clock.
    """
    fixes = dict(fix.split("=") for f in found if f.code == CLOCK for fix in f.fixes)
    clocks = ("truth", 1.0, robot.truth.time_offset), ("wheels", -1.0, robot.wheels.time_offset)
    named = ((f"{role}.time_offset", sign, now) for role, sign, now in clocks)
    later = [sign * (float(fixes[key]) - now) for key, sign, now in named if key in fixes]
    if drive.truth is None or not later:
        return drive
    return replace(drive, truth=replace(drive.truth, t=drive.truth.t + sum(later)))


def _start(drive: Drive, robot: Robot) -> list[Finding]:
    return [] if drive.truth is None or of_few(drive) else of_start(drive.truth, drive, robot)


def too_short(drive: Drive) -> str:
    """Return why the drive cannot judge sensors, "" if it is long enough."""
    seconds, way = float(drive.t[-1] - drive.t[0]), float(drive.wheels.driven(drive.wheels.t[-1]))
    if seconds >= MIN_DURATION_S:
        return ""
    words = f"the drive lasts {seconds:.1f} s ({way:.2f} m), too short to judge a sensor"
    return f"{words}: {MIN_DURATION_S:g} s are the least"


def scales(
    drive: Drive, robot: Robot, by_sensor: Turnings, turning: Sequence[Finding] = (), least: Least | None = None
) -> list[Finding]:
    """Return findings on distance scales and track width: the part of `examine` that needs no streams.

    Their fixes are computed to be set together: each is right only if the others are set too. `turning` are the
    findings of `of_turning`.
    """
    motion, far, turned = None, far_by_scans(drive.wheels.track, by_sensor), drive
    if far is not None and robot.wheels.radius is not None and robot.wheels.track is not None:
        wheels = drive.wheels.rerolled(drive.wheels.rolled, far[0] * drive.wheels.track)
        turned = replace(drive, wheels=wheels)  # by its turns the right walls are paired
    if not any(o.role == "lrf" for o in turning):
        motion = laser_motion(turned, robot, clock_offset("lrf", by_sensor))
    if motion is not None:
        t, wheels = turned.wheels.t, turned.wheels
        if far is not None and turned is not drive:
            motion = motion._replace(turns=1.0 / far[0], turns_sigma=far[1] / far[0] ** 2)
        if _straight(wheels.heading(t), wheels.driven(t) / motion.scale):
            motion = motion._replace(scale_sigma=math.inf)
    size = of_size(drive, motion)
    if size:
        drive = replace(drive, truth=None)  # nothing can be compared with such a truth
    factor, scaled = metre(with_fixes_as_truth(drive, robot), robot, least)
    if robot.wheels.is_of_driver:
        scaled = [replace(o, fixes=(f"wheels.scale={robot.wheels.scale * factor:.4g}",)) for o in scaled]
    by_truth = wheels_metre(drive) is not None
    radius = [] if by_truth else of_radius(motion, robot, least is not None)
    if radius and least is None:
        return [*size, *radius]  # the cause of both wrong track and wrong range scale
    track = of_track(drive, robot.wheels, by_sensor, motion, factor if least is None else 1.0, least)
    if track:
        scaled = [replace(o, fixes=o.fixes[:1]) for o in scaled]
    fits = and_truth(drive, by_sensor)
    ratio = [*of_ratio(drive, robot, fits, least), *of_gyro(drive, robot, fits, least)]
    return [*size, *radius, *scaled, *track, *ratio, *of_laser(motion, robot, factor, least, by_truth)]


def _refused(drive: Drive) -> list[Finding]:
    """Return findings that count unused readings by reason; repaired readings have findings of their own."""
    refused = {
        stream: _reasons({why: n for why, n in reasons.items() if why not in REPAIRED})
        for stream, reasons in drive.dropped.items()
    }
    return [Finding(s, "refused", f"readings that are not used: {words}") for s, words in refused.items() if words]


def _reasons(counts: Mapping[str, int]) -> str:
    """Return numbers of readings by reason as text: "3 repeat the one before, 1 share the stamp of another"."""
    return ", ".join(
        f"{n} {REASONS.get(why, why if '/' in why else why.replace('_', ' '))}" for why, n in counts.items()
    )


def _of_times(name: str, t: Array, drive: Drive) -> list[Finding]:
    """Return findings on gaps in a sensor's times (n,) [s], and if they leave out a large part of the drive."""
    found, missing, whole = [], gaps(t), float(drive.wheels.t[-1]) - float(drive.wheels.t[0])
    if missing:
        longest = max(end - start for start, end in missing)
        where = ", ".join(f"{start:.1f}-{end:.1f} s" for start, end in missing[:3])
        more = " ..." if len(missing) > 3 else ""
        found.append(Finding(name, "gap", f"{gaps_of(len(missing), longest)} ({where}{more})"))
    if len(t) >= MIN_READINGS and t[-1] - t[0] <= MIN_COVERED_SHARE * whole:
        when = f"{t[-1] - t[0]:.0f} s ({t[0]:.1f}-{t[-1]:.1f} s)"
        words = f"its readings cover {when} of the {whole:.0f} s of the drive: the rest is without it"
        found.append(Finding(name, "covers", words))
    return found


def gaps(t: Array) -> list[tuple[float, float]]:
    """Return the gaps (start, end) [s] in times (n,)."""
    dt = np.diff(t)
    if len(dt) < 2:
        return []
    long = np.flatnonzero(dt > gap_limit(t))
    return [(float(t[i]), float(t[i + 1])) for i in long]


def holes(drive: Drive) -> list[tuple[float, float]]:
    """Return the times (start, end) [s] in which no stream has a reading and the robot drove on."""
    wheels, others = drive.wheels, [m.t for m in drive.measurements.values()]
    t = np.concatenate([np.zeros(0), *others, *([] if drive.truth is None else [drive.truth.t])])
    found, least = [], max(MIN_HOLE_M, MIN_HOLE_SHARE * float(wheels.driven(wheels.t[-1])))
    for start, end in gaps(wheels.t):
        edges = np.array([start, *np.sort(t[(t > start) & (t < end)]), end])
        i = int(np.argmax(np.diff(edges)))
        way, turn = _moved(drive, start)
        if edges[i + 1] - edges[i] > gap_limit(wheels.t) and (way > least or turn > MIN_HOLE_RAD):
            found.append((float(edges[i]), float(edges[i + 1])))
    return found


def _moved(drive: Drive, t: float) -> tuple[float, float]:
    """Return the way [m] and the turn [rad] of the wheel interval at a time [s]."""
    ahead, left, turn = drive.wheels.twist[drive.wheels.at(np.array(t))[0]].tolist()
    return math.hypot(ahead, left), abs(turn)


def of_holes(drive: Drive, found: Sequence[tuple[float, float]]) -> list[Finding]:
    """Return a finding on the `holes` of a drive, times (start, end) [s] without any reading; [] without holes."""
    if not found:
        return []
    when = " and ".join(f"from {start:.1f} s to {end:.1f} s" for start, end in found[:3])
    more = f" and {len(found) - 3} times more" if len(found) > 3 else ""
    way, turn = np.sum([_moved(drive, start) for start, _ in found], axis=0).tolist()
    words = (
        f"nothing was recorded {when}{more}, while the robot drove on: by the wheels before and after it may have "
        f"moved {way:.1f} m and turned {math.degrees(turn):.0f}°. What is estimated across that is a guess, by "
        "which no sensor is judged"
    )
    begin, end = longest_part(drive, found)
    if (float(drive.t[-1]) if end is None else end) - (begin or 0.0) >= MIN_DURATION_S:
        words += judge_words(begin, end)
    return [Finding("log", HOLE, words, severe=True)]


def longest_part(drive: Drive, found: Sequence[tuple[float, float]]) -> tuple[float | None, float | None]:
    """Return begin and end [s] of the longest part of the drive between the holes `found`, (begin, end) [s] each.

    Begin is None if the part starts with the drive; end is None if it ends with the drive. Another part is chosen
    only if it is more than twice as long as the first part, since only the first part has a known start pose.
    """
    ends = [float(drive.t[0]), *(t for hole in found for t in hole), float(drive.t[-1])]
    spans = [(b - a) * (1.0 if i else 2.0) for i, (a, b) in enumerate(zip(ends[::2], ends[1::2], strict=True))]
    i = int(np.argmax(spans))
    return None if i == 0 else ends[2 * i], None if i == len(found) else ends[2 * i + 1]


def judge_words(begin: float | None, end: float | None) -> str:
    """Return the command that judges the drive from `begin` to `end` [s], as the end of a message."""
    part = "".join(f" {o} {t:.1f}" for o, t in (("--from", begin), ("--to", end)) if t is not None)
    return f". To judge a part: locfuse compare LOG{part}"


def of_carried(drive: Drive) -> list[Finding]:
    """Return a finding on times in which the wheels stand still, but the truth moves or the laser turns.

    They must move farther than the wheels do at any shift of these times by up to MAX_LAG_S, since clocks differ.
    """
    if drive.wheels.matched is not None:
        return []
    wheels, truth, laser, found = drive.wheels, drive.truth, headings_of(drive).get("lrf"), []
    limits = np.outer(np.diff(wheels.t), (MAX_SPEED_MPS, MAX_SPEED_MPS, MAX_RATE_RADPS))
    lags = np.arange(-MAX_LAG_S, MAX_LAG_S + 0.5 * LAG_STEP_S, LAG_STEP_S)
    for first, last in stretches((np.abs(wheels.twist) <= limits).all(axis=1)):
        begin, end = span = float(wheels.t[first]), float(wheels.t[last + 1])
        rolled, shown = wheels.relative(begin + lags, end + lags), []
        if truth is not None and np.diff(rows := np.searchsorted(truth.t, span))[0] > MIN_READINGS:
            xy = truth.xy[slice(*rows)]
            noise = math.sqrt(0.5 * float((np.diff(xy, axis=0) ** 2).sum(axis=1).mean()))
            moved, least = float(np.hypot(*(xy[-1] - xy[0]))), float(np.hypot(*rolled[:, :2].T).max())
            if moved > least + max(MIN_CARRIED_M, MIN_CARRIED_SIGMAS * max(noise, truth.sigma)):
                shown.append(f"the truth moves {moved:.1f} m")
        if laser is not None and np.diff(rows := np.searchsorted(laser.t, span))[0] > MIN_READINGS:
            turn = abs(float(laser.angle[rows[1] - 1] - laser.angle[rows[0]]))
            if turn > float(np.abs(rolled[:, 2]).max()) + MIN_CARRIED_RAD:
                shown.append(f"the laser turns {math.degrees(turn):.0f}°")
        if shown:
            found.append((begin, end, " and ".join(shown)))
    if not found:
        return []
    begin, end, shown_by = found[0]
    when = f"from {begin:.1f} s to {end:.1f} s" + (f" (the first of {len(found)} times)" if found[1:] else "")
    words = f"they stand still {when}, while {shown_by}: the robot was carried, or their driver stopped"
    words += judge_words(*longest_part(drive, [(begin, end) for begin, end, _ in found]))
    return [Finding("wheels", CARRIED, words, severe=True)]


def of_data(drive: Drive, robot: Robot, stream: Callable[[str], Stream]) -> list[Finding]:
    """Return findings on data that no estimate can use: dead sensors, two publishers, stamps that stand still.

    `stream` returns the raw readings of a role, of which columns are read only for a role with a finding.
    """
    found = []
    if drive.wheels.matched is None:
        wheels = stream("wheels")
        found += of_publishers("wheels", wheels)
        counted = wheels.msgtype not in BODY_READS
        stuck = of_stuck_wheel(drive) if counted else []
        found += stuck or of_wheel_unit(drive, robot, wheels.msgtype) or (of_signs(drive) if counted else [])
    for name, m in drive.measurements.items():
        found += of_publishers(name, stream(name), m.two_sources)
        found += of_range_unit(m, robot.settings("lrf")) if name == "lrf" else []
        found += blind(name, m, float(robot.settings(name).time_offset), stream)
    found += of_equal_stamps(drive, stream)
    return found or of_slipping(drive, robot, stream)


def blind(name: str, m: Measurements, time_offset: float, stream: Callable[[str], Stream]) -> list[Finding]:
    """Return a finding on a sensor with hardly any measurements: what its data hold, and what to do."""
    n, unused = len(m.t), sum(m.dropped.values())
    if n >= MIN_READINGS:
        if m.absent <= MAX_EMPTY_SHARE * n:
            return []
        held = unreturned(stream(name), MAX_EMPTY_SHARE) if name == "lrf" else ""
        why = f"its ranges are {held}. {CHECK_SENSOR}" if held else "it is dead, or its settings do not fit"
        why = next((f.message for f in of_angles(stream(name)) if f.severe), why) if name == "lrf" else why
        words = f"no {REGISTRY[name].sees} in {m.absent} of {n} readings: {why}"
        return [Finding(name, BLIND, words, severe=REGISTRY[name].blind_is_severe)]
    total = len(stream(name).t_ns) if unused else 0
    if unused <= MAX_EMPTY_SHARE * total:
        return []
    words = f"{n or 'none'} of {total} readings can be used: {_reasons(m.dropped)}"
    late = max(m.dropped, key=lambda why: m.dropped[why]) == "outside_wheels"
    check = f"Check its clock and {name}.time_offset (now {time_offset:g} s)" if late else CHECK_SENSOR
    return [Finding(name, BLIND, f"{words}. {check}", severe=True)]


# ---- quantities that a drive does not determine with any sensor, and the manoeuvre that would ----
#
# If all turns have one direction, errors of a clock, a mount and the track cannot be separated. Straight paths
# show the distance scale, standstill shows a gyro's bias.

MIN_TURN_RAD = math.radians(90.0)  # sum of turns, to the left and to the right
MAX_BEND_RAD, MIN_STRAIGHT_M = math.radians(5.0), 1.0  # of a straight path
MAX_SPEED_MPS, MAX_RATE_RADPS, MIN_STAND_S = 0.005, 0.005, 5.0  # of standstill


def unseen(drive: Drive) -> list[Finding]:
    """Return findings on quantities that this drive's motion does not determine."""
    t, found = drive.wheels.t, []
    heading, way = drive.wheels.heading(t), drive.wheels.driven(t)
    period, turns = np.diff(t), np.diff(heading)
    left, right = float(turns[turns > 0.0].sum()), float(-turns[turns < 0.0].sum())
    if min(left, right) < MIN_TURN_RAD:
        turned = f"turns {math.degrees(left):.0f}° to the left and {math.degrees(right):.0f}° to the right"
        apart = "a late clock, a mount and the track cannot be told apart. Turn on the spot, once each way"
        found.append(f"the robot {turned}: {apart}")
    found.append(_straight(heading, way))
    still = (np.diff(way) <= MAX_SPEED_MPS * period) & (np.abs(turns) <= MAX_RATE_RADPS * period)
    longest = max((float(t[last + 1] - t[first]) for first, last in stretches(still)), default=0.0)
    if "gyro" in drive.measurements and longest < MIN_STAND_S:
        words = f"it stands for {longest:.1f} s at most, which tells no offset of the gyro. Stand for 5 s first"
        found.append(words)
    return [Finding("wheels", "unseen", words) for words in found if words]


def _straight(heading: Array, way: Array) -> str:
    """Return a note if no metre of the path length `way` (n,) [m] is straight, else ""."""
    begin = way[way + MIN_STRAIGHT_M <= way[-1]]
    ahead = [np.interp(begin + part * MIN_STRAIGHT_M, way, heading) for part in (0.0, 0.25, 0.5, 0.75, 1.0)]
    if (np.ptp(ahead, axis=0) <= MAX_BEND_RAD).any():
        return ""
    return "no metre of its way is straight, which tells no distance scale. Drive 3 m straight along a tape"
