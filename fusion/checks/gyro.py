"""Gyro checks: scale and bias by headings of the truth or another sensor, noise, and rates beyond its range."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from locfuse.fusion.data import Array, Drive, Stream, changes
from locfuse.fusion.robot import Robot
from locfuse.fusion.sensors.gyro import Rest, rests, up_rate
from locfuse.fusion.sensors.registry import REGISTRY
from locfuse.fusion.statistics import part_of, robust_sigma, robust_with_sigmas
from locfuse.fusion.streams import arrays, seconds

from .finding import Finding, Least
from .turning import MIN_RMS_TURN_RAD, MIN_WINDOWS, Turning, headings_of, source_words, true_headings

SCALE, ERRORS = "gyro scale", (Least(0.02, 4.0), Least(0.01, 3.0))  # smallest error: reported, tried
BIAS, SATURATED = "gyro bias", "saturated"  # codes of findings on a bias that moves, on rates beyond the range
WINDOW_S, PART_COUNT = 3.0, 8  # s over which turns are compared; parts of the drive, with a bias each
MIN_IN_PART = 10  # windows in a part
STRETCHES = 8  # parts of the jackknife
MIN_BIAS_DEG, BIAS_SIGMAS = 0.1, 4.0  # degrees/s; standard errors: smallest bias, and change of it, reported
SEVERE_BIAS_RATIO = 3.0  # least ratio of the change of a bias to the smallest one, to be severe
MIN_DRIFT_RATIO = 3.0  # least ratio of the observed drift of a bias to the configured one
MIN_CLIPPED, MIN_CLIPPED_SHARE = 20, 0.005  # readings with the largest rate; share of all
MIN_CLIPPED_RATIO = 1.15  # (wheels' rate / gyro's rate) of these readings to that of other turns
RATE_SPAN_S = 0.1  # s before and after a reading, for the turning rate of the wheels
NOISE = "gyro noise"  # code of the finding on the noise at standstill
MIN_REST_READINGS, MIN_NOISE_RATIO = 20, 3.0  # of one standstill; least ratio of observed to configured noise


def of_gyro(
    drive: Drive, robot: Robot, by_sensor: Mapping[str, Turning], least: Least | None = None
) -> list[Finding]:
    """Return findings if a gyro's scale or set bias is wrong, or its bias moves, by the truth or another sensor.

    A set bias is also compared with that at standstill. `by_sensor` may have a fit of the truth. Each part of the
    drive has a bias of its own.
    """
    if at_rest := _given_bias_at_rest(drive, robot):
        return at_rest
    known = headings_of(drive) | true_headings(drive)
    # wheels that slip often do not explain turns, but a truth is exact
    name = next((n for n in ("truth", "lrf", "compass") if n in known and (n in by_sensor or n == "truth")), None)
    if name is None or "gyro" not in known or ("gyro" not in by_sensor and name != "truth"):
        return []
    both = name in by_sensor and "gyro" in by_sensor
    t, own_t = (known[n].t + (by_sensor[n].offset if both else 0.0) for n in (name, "gyro"))
    heading, own = known[name].angle, known["gyro"].angle
    start = own_t[(own_t >= t[0]) & (own_t + WINDOW_S <= min(t[-1], own_t[-1]))]
    if (gaps := known[name].without_lines) is not None:
        start = start[changes(start, WINDOW_S, t, gaps) == 0.0]
    if len(start) < MIN_WINDOWS:
        return []
    turned, seen = changes(start, WINDOW_S, own_t, own), changes(start, WINDOW_S, t, heading)
    part = part_of(start, PART_COUNT)
    A = np.column_stack((turned, np.eye(PART_COUNT)[part]))
    x, sigmas = robust_with_sigmas(A, seen, STRETCHES)
    scale, sigma = float(x[0]), float(sigmas[0])
    tried, least = least is not None, ERRORS[least is not None]
    if (
        min(turned.std(), seen.std()) >= MIN_RMS_TURN_RAD
        and abs(scale - 1.0) >= least.error + least.sigmas * sigma
    ):
        far = f"{abs(1.0 / scale - 1.0):.1%} too {'far' if scale < 1.0 else 'little'}"
        words = f"it turns {far} by the headings of {source_words(name)} (1 sigma {sigma:.1%})"
        fix = f"gyro.scale={float(robot.settings('gyro').scale) * scale:.4g}"
        return [Finding("gyro", SCALE, words, (fix,))]
    full = np.bincount(part, minlength=PART_COUNT) >= MIN_IN_PART
    bias, duration = np.degrees(-x[1:][full]) / WINDOW_S, float(start[-1] - start[0])
    return _of_bias(bias, seen - A @ x, duration, robot, name, tried)


def _of_bias(bias: Array, rest: Array, duration: float, robot: Robot, name: str, tried: bool) -> list[Finding]:
    """Return a finding if the bias (k,) [degrees/s] moves from part to part of a drive of `duration` [s].

    `rest` (n,) are the residuals [rad] of turns over WINDOW_S. If the caller tries fixes (`tried`), a constant
    bias by the truth is one, although the filter estimates it on every drive.
    """
    length, steps, settings = duration / PART_COUNT, np.diff(bias), robot.settings("gyro")
    sigma = math.degrees(robust_sigma(rest)) / WINDOW_S / math.sqrt(max(length / WINDOW_S, 1.0))
    least = MIN_BIAS_DEG + BIAS_SIGMAS * sigma
    if len(steps) == 0:
        return []
    usual = float(np.median(bias))
    wrong = _of_given_bias(settings.bias_deg, usual, sigma, f"by the headings of {source_words(name)}")
    if wrong and abs(usual - settings.bias_deg) > np.ptp(bias):  # else it moves
        return wrong
    if float(np.ptp(bias)) < least:
        if not tried or name != "truth" or settings.bias_deg is not None or abs(usual) < least:
            return []
        words = f"its bias is estimated on every drive; by the truth it is {usual:.2f} degrees/s"
        return [Finding("gyro", BIAS, f"{words} (1 sigma {sigma:.1g})", (f"gyro.bias_deg={usual:.3f}",))]
    drift = float(np.sqrt(np.square(steps).mean() / length))
    if drift < MIN_DRIFT_RATIO * settings.bias_drift_deg:
        return []
    moves = f"its bias moves by {np.ptp(bias):.2g} degrees/s during the drive (1 sigma {sigma:.1g})"
    words = f"{moves}, by the headings of {source_words(name)}"
    severe = float(np.ptp(bias)) > SEVERE_BIAS_RATIO * least
    return [Finding("gyro", BIAS, words, (f"gyro.bias_drift_deg={drift:.2g}",), severe)]


def _given_bias_at_rest(drive: Drive, robot: Robot) -> list[Finding]:
    """Return a finding if the bias that is set differs from the one at standstill, which needs no other sensor."""
    m = drive.measurements.get("gyro")
    if m is None or "rest_begin" not in m.extra:
        return []
    settings = robot.settings("gyro")
    begin, end, turned = (float(m.extra[f"rest_{part}"][0]) for part in Rest._fields)
    sigma = settings.sigma_deg / math.sqrt(end - begin)
    return _of_given_bias(settings.bias_deg, math.degrees(turned) / (end - begin), sigma, "at standstill")


def _of_given_bias(given: float | None, bias: float, sigma: float, by: str) -> list[Finding]:
    """Return a finding if a bias [degrees/s] that is set differs from the observed one."""
    if given is None or abs(bias - given) < MIN_BIAS_DEG + BIAS_SIGMAS * sigma:
        return []
    words = f"{by} its bias is {bias:.2f} degrees/s (1 sigma {sigma:.1g}), configured {given:g}"
    return [Finding("gyro", BIAS, words, (f"gyro.bias_deg={bias:.3f}",))]


def of_saturation(drive: Drive, robot: Robot, streams: Mapping[str, Stream]) -> list[Finding]:
    """Return a finding if a gyro often reads its largest rate while the wheels turn faster."""
    if "gyro" not in drive.measurements:
        return []
    stream, settings = streams["gyro"], robot.settings("gyro")
    rate = np.abs(up_rate(arrays(stream, *REGISTRY["gyro"].reads[stream.msgtype]), settings, stream.topic))
    t = seconds(stream.t_ns, drive.epoch_ns, settings.time_offset)
    by_wheels = np.abs(drive.wheels.heading(t + RATE_SPAN_S) - drive.wheels.heading(t - RATE_SPAN_S))
    by_wheels /= 2.0 * RATE_SPAN_S
    most = float(np.max(rate, initial=0.0, where=np.isfinite(rate)))
    largest = rate >= most * (1.0 - 1e-9)
    others = ~largest & (rate > 0.5 * most)
    if largest.sum() < max(MIN_CLIPPED, MIN_CLIPPED_SHARE * len(rate)) or not others.any() or not most:
        return []
    # wheels that skid turn farther than the robot, at all rates
    if np.median(by_wheels[largest]) / most < MIN_CLIPPED_RATIO * np.median(by_wheels[others] / rate[others]):
        return []
    share = f"{largest.mean():.1%} of its readings are {most:.3g} rad/s, the largest"
    words = f"{share}, while the wheels turn faster: set a larger range in its driver"
    return [Finding("gyro", SATURATED, words, (), True)]


def of_rest_noise(drive: Drive, robot: Robot) -> list[Finding]:
    """Return a finding if a gyro's turns scatter at standstill by more than its configured angle random walk."""
    m = drive.measurements.get("gyro")
    if m is None or len(m.t) < MIN_REST_READINGS:
        return []
    where = drive.wheels.relative(np.full(len(m.t), m.t[0]), m.t)
    turns = [
        np.diff(m.z[a : b + 1, 0]) / np.sqrt(np.diff(m.t[a : b + 1]))
        for a, b in rests(where, m.extra["piece"].astype(np.int64))
        if b - a >= MIN_REST_READINGS
    ]
    if not turns:
        return []
    sigma = math.degrees(robust_sigma(np.concatenate([one - np.median(one) for one in turns])))
    now = robot.settings("gyro").sigma_deg
    if sigma < MIN_NOISE_RATIO * now:
        return []
    words = f"at standstill its turns scatter by {sigma:.2g} degrees per sqrt(s) (1 sigma), configured {now:g}"
    return [Finding("gyro", NOISE, words, (f"gyro.sigma_deg={sigma:.2g}",))]
