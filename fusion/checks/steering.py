"""Steering check: size and steering of a tricycle compared with the truth."""

from __future__ import annotations

import math
from contextlib import suppress

import numpy as np

from locfuse.fusion import se2
from locfuse.fusion.data import Drive, LocfuseError, Stream, Truth, changes
from locfuse.fusion.robot import Robot, WheelSettings
from locfuse.fusion.statistics import robust
from locfuse.fusion.streams import MergedStream
from locfuse.fusion.wheels.calibrate_tricycle import calibrate_tricycle, nominal, of_truth
from locfuse.fusion.wheels.motion import Wheels
from locfuse.fusion.wheels.steered import is_tricycle, read_encoders

from .finding import Finding
from .turning import MIRROR

STEERING = "steering"  # code of the finding
ZERO = "zero"  # code of the finding on a zero that moves
WINDOW_S, PARTS, MIN_WINDOWS = 1.0, 4, 20  # s; parts of the drive with a zero each, and least windows of one
MIN_MOVED_ZERO_DEG = 5.0  # between two parts: less is slip
MAX_ZERO_RAD = 0.05  # largest change of the zero by a mirrored truth; of a counter that turns round it changes
MIN_MISFIT_SHARE, MIN_MISFIT_M = 2.5, 0.5  # of the configured path to the truth, by that of the best one; m


def of_steering(drive: Drive, robot: Robot, stream: Stream) -> list[Finding]:
    """Return a finding if another size and steering of a tricycle fit the truth far better than the configured."""
    truth, settings = drive.truth, robot.wheels
    if truth is None or truth.theta is None or not isinstance(stream, MergedStream) or not is_tricycle(stream):
        return []
    misfit = _misfit(drive, truth)
    found = None
    if misfit > MIN_MISFIT_M:
        shift = (int(stream.parts[0].t_ns[0]) - drive.epoch_ns) * 1e-9 + settings.time_offset
        unknown = WheelSettings(ticks_per_revolution=settings.ticks_per_revolution, rollover=settings.rollover)
        with suppress(LocfuseError):
            start = nominal(stream, unknown, of_truth(truth), shift)
            found = calibrate_tricycle(read_encoders(stream, start), start, of_truth(truth), shift)
    if found is None or found.breaks or misfit < MIN_MISFIT_SHARE * found.rms:
        return _of_zero(drive.wheels, truth, settings.wheelbase or 1.0)
    values = {key: figure.value for key, figure in found.wheels.items()}
    now = settings.servo_gain or 1.0
    same_zero = abs(values["servo_offset"] - settings.servo_offset) < MAX_ZERO_RAD * abs(now)
    if values["servo_gain"] * now < 0.0 and same_zero:
        words = (
            "it is a mirror image of the drive: one of its axes points the other way; or the steering does "
            f"(wheels.servo_gain={values['servo_gain']:.5g})"
        )
        return [Finding("truth", MIRROR, words, (), True)]
    words = (
        f"the truth leaves {misfit:.1f} m (rms) to the path by the configured size and steering of the tricycle, "
        f"and {found.rms:.2f} m to that by others"
    )
    fixes = [f"wheels.{key}={value:.5g}" for key, value in values.items()]
    fixes += [f"truth.{key}={figure.value:.3f}" for key, figure in found.mount.items()]
    return [Finding("wheels", STEERING, words, tuple(fixes), True)]


def _of_zero(wheels: Wheels, truth: Truth, wheelbase: float) -> list[Finding]:
    """Return a finding if the steering's zero moves: the turns that wheels lack, per distance, change."""
    start = truth.t[(truth.t >= wheels.t[0]) & (truth.t + WINDOW_S <= min(wheels.t[-1], truth.t[-1]))]
    if len(start) < PARTS * MIN_WINDOWS or truth.theta is None:
        return []
    moved = wheels.relative(start, start + WINDOW_S)
    lacking = changes(start, WINDOW_S, truth.t, np.unwrap(truth.theta)) - moved[:, 2]
    rows = np.array_split(np.arange(len(start)), PARTS)
    zeros = [math.degrees(float(robust(moved[some, :1] / wheelbase, lacking[some])[0][0])) for some in rows]
    if max(zeros) - min(zeros) < MIN_MOVED_ZERO_DEG:
        return []
    when = [f"{zero:z.1f}° from {start[some[0]]:.0f} s on" for zero, some in zip(zeros, rows, strict=True)]
    words = f"by the truth the zero of the steering moves: it is off by {', '.join(when)}; check its encoder"
    return [Finding("wheels", ZERO, words, severe=True)]


def _misfit(drive: Drive, truth: Truth) -> float:
    """Return the rms [m] of the truth to the path by the wheels, after rigid alignment."""
    rows = (truth.t >= drive.wheels.t[0]) & (truth.t <= drive.wheels.t[-1])
    pose = drive.wheels.at(truth.t[rows])[2]
    point = np.broadcast_to([*truth.point, 0.0], pose.shape)
    seen, own = truth.xy[rows], se2.compose(pose, point)[:, :2]
    if not len(seen):
        return 0.0
    return math.sqrt(float(np.square(se2.off_laid_on(own, seen)).sum(axis=1).mean()))
