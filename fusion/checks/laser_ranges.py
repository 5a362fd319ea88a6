"""Checks of a laser's raw ranges: noise, constant error, angles, missing returns."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from contextlib import suppress
from typing import Any, cast

import numpy as np

from locfuse.fusion.data import Array, Drive, Ints, LocfuseError, Measurements, Ragged, Stream
from locfuse.fusion.lines.points import understood
from locfuse.fusion.lines.scans import (
    MAX_BEAMS,
    MAX_SWEEP_PERIODS,
    equal_scans,
    limits,
    returns,
    scan_period,
    sweep_time,
)
from locfuse.fusion.sensors.lrf import Lrf, LrfSettings, laser_of
from locfuse.fusion.statistics import jackknife, robust
from locfuse.fusion.streams import take

from .finding import Finding
from .truth import UNIT

MIN_IN_TURN = 5  # least number of scans with the second most frequent first angle
SAMPLE_SCANS = 300
MIN_TRIPLES = 1000  # of neighbouring ranges, for an estimate of the noise
MAX_SCATTER = 1.4  # times sigma_range: more noise is reported
# quantiles of |x| for normal x, and their values in standard deviations, to recognise Gaussian noise
NORMAL_SHARES, NORMAL_SIZES = (0.1, 0.25, 0.5), (0.1257, 0.3186, 0.6745)
MAX_NOISE_M = 0.15  # m: more scatter is not noise of a laser
MAX_SIGMA_RATIO = 1.2  # largest ratio of the sigmas by these quantiles
OFFSET = "range offset"  # code of the finding
MAX_LIMIT_RATIO = 10.0  # of a range and range_max: walls in mm are 1000 times as far as in m, at 1 % of range_max
MAX_WALL_M = 100.0  # m: median distance of walls that no robot with a 2D laser has; 10 cm in mm
MIN_BEYOND_SHARE = 0.3  # of all ranges beyond range_max, that are no returns of a wrong limit
FIRST_SCANS = 3000  # first scans, of which SAMPLE_SCANS are taken evenly
HALF_SPAN_RAD = math.radians(20.0)  # from the middle beam to the two others
BENT_MPS = 0.1  # m of offset per s of a sweep, 1 sigma: walls look bent if the robot turns more often to one side
CHECKED_BEAMS = 16  # on either side of the middle one
MAX_OFF_WALL_M = 0.1  # m: largest distance of the beams in between from a straight wall
MIN_STRETCH_TRIPLES, STRETCH_COUNT = 200, 8  # in each stretch; stretches for the jackknife
# limits of a finding: m; standard errors, without and with a trial of its fix
MIN_OFFSET_M, SEVERE_OFFSET_M, OFFSET_SIGMAS, TRIED_SIGMAS = 0.02, 0.03, 5.0, 3.0
BEAM_ANGLES = "beam angles"  # code of the finding on the angle between beams
# its limits: relative error (places near corners take part, which adds up to 0.007); its standard errors
MIN_ANGLE_ERROR, ANGLE_SIGMAS = 0.015, 5.0
# turn during a sweep / angle of the sweep: it changes the angle between beams by this share
MAX_TURNED_SHARE = 0.002
SPAN_FIELDS = ("angle_min", "angle_max", "angle_increment", "ranges")
MIN_DEGREES = 8.0 * math.pi  # rad: of beams that cover more, the angles are in degrees
MAX_OFF_STEPS = 3.0  # increments: smaller differences are wrong counts of beams


def of_range_unit(m: Measurements, settings: LrfSettings) -> list[Finding]:
    """Return a finding if ranges are in mm: by the median distance of the walls."""
    median = float(np.median(m.z[:, 0])) if len(m.z) else 0.0
    if median < MAX_WALL_M:
        return []
    words = f"half of its walls are farther away than {median:.0f} m: its ranges look like mm"
    return [Finding("lrf", UNIT, words, (f"lrf.range_scale={0.001 * settings.range_scale:.4g}",), True)]


def driver(stream: Stream, own_beams: bool = True) -> list[Finding]:
    """Return findings on faults of a laser's driver, from the first scans of a stream.

    `own_beams`: whether the driver wrote the beams. Those of a slice of a cloud may have no point.
    """
    parts = list(_sample(stream, SAMPLE_SCANS))
    if not parts:
        return []
    column = {k: np.concatenate([np.asarray(p[k]) for p in parts]) for k in parts[0] if k != "ranges"}
    lengths = np.concatenate([cast("Ragged", p["ranges"]).lengths for p in parts])
    if not own_beams:
        return _angles(column, lengths)
    held = _unreturned(parts, 0.0)
    found = [Finding("lrf", "no return", f"ranges without a return: {held}")] if held else []
    return [
        *found,
        *_angles(column, lengths),
        *_sweep(column, lengths, stream),
        *_in_turn(column),
        *of_angles(stream),
    ]


def of_limit(stream: Stream, settings: LrfSettings) -> list[Finding]:
    """Return a finding if many ranges beyond the scans' range_max differ, as those of walls do."""
    parts = list(_sample(stream, SAMPLE_SCANS))
    if settings.range_max is not None or not parts:
        return []
    values, far = (np.concatenate(some) for some in zip(*map(_beside_limit, parts), strict=True))
    beyond = np.isfinite(values) & (values > far) & (values / MAX_LIMIT_RATIO < far)
    if beyond.sum() < MIN_BEYOND_SHARE * len(values) or len(np.unique(values[beyond])) < 0.1 * beyond.sum():
        return []
    words = (
        f"{beyond.mean():.0%} of its ranges are beyond its range_max, {np.median(far):g} m, and differ as walls do"
    )
    return [Finding("lrf", "range limit", words, (f"lrf.range_max={math.ceil(values[beyond].max())}",), True)]


def _beside_limit(scans: dict[str, Any]) -> tuple[Array, Array]:
    """Return all ranges of some scans [m], and the largest valid range of each."""
    ranges = cast("Ragged", scans["ranges"])
    values = ranges.values[ranges.first[0] : ranges.first[-1]].astype(np.float64)
    return values, np.repeat(limits(scans)[1], ranges.lengths)


def _sweep(column: dict[str, Array], lengths: Ints, stream: Stream) -> list[Finding]:
    """Return a finding if by time_increment a scan lasts longer than the time between scans."""
    i, period = int(np.argmax(column["time_increment"])), scan_period(stream.t_ns)
    each, beams = column["time_increment"][i : i + 1].astype(np.float64), int(lengths[i])
    lasts, used = float(each[0]) * (beams - 1), float(sweep_time(each, beams, period)[0])
    if not lasts > MAX_SWEEP_PERIODS * period:
        return []
    words = (
        f"by time_increment a scan lasts {lasts:.3g} s, but one comes every {period:.3g} s: read as {used:.3g} s"
    )
    return [Finding("lrf", "sweep", words)]


def of_angles(stream: Stream) -> list[Finding]:
    """Return a finding if angle_max contradicts angle_increment times the number of beams.

    The finding is severe if the beams would cover more than a full turn: then angle_increment, which locfuse uses,
    is wrong.
    """
    columns: Mapping[str, Any] | None = None
    with suppress(LocfuseError):  # scans without angle_max
        columns = next((columns for _, columns in stream.blocks(*SPAN_FIELDS, rows=SAMPLE_SCANS)), None)
    if columns is None:
        return []
    low, high, step = (np.asarray(columns[k], np.float64) for k in SPAN_FIELDS[:3])
    beams = cast("Ragged", columns["ranges"]).lengths
    by_ends, by_steps = np.abs(high - low), np.abs(step) * (beams - 1)
    if float(np.median(by_steps)) > MIN_DEGREES and len(by_steps):
        words = f"its beams cover {np.median(by_steps):.0f} rad: its angles look like degrees; write radians"
        return [Finding("lrf", "angle increment", words, severe=True)]
    wrong = (np.abs(by_steps - by_ends) > MAX_OFF_STEPS * np.abs(step)) & (by_ends > 0.0) & (beams > 1)
    if 2 * wrong.sum() <= len(wrong):
        return []
    i = int(np.flatnonzero(wrong)[0])
    ends, steps, last = math.degrees(by_ends[i]), math.degrees(by_steps[i]), int(beams[i]) - 1
    too_far = bool(by_steps[i] > 2.0 * math.pi + MAX_OFF_STEPS * abs(step[i]))
    more = " That is more than a whole turn, so it and all beam directions are wrong." if too_far else ""
    words = (
        f"angle_max - angle_min is {ends:.2f}°, but {last} times angle_increment is {steps:.2f}°; "
        f"angle_increment is used.{more} If angle_max is right, correct angle_increment in the driver: "
        f"{math.radians(ends / last):.6g} rad"
    )
    return [Finding("lrf", "angle increment", words, severe=too_far)]


def of_scatter(stream: Stream, settings: LrfSettings) -> list[Finding]:
    """Return a finding if neighbouring ranges show more noise than configured, or no laser has the configured one.

    Ranges are compared directly, not with lines: if the noise is set too low, lines are split and fit well.
    """
    if settings.sigma_range > MAX_NOISE_M:
        words = f"sigma_range is {settings.sigma_range:g} m: no laser is so noisy"
        return [Finding("lrf", "noise", words, (f"lrf.sigma_range={LrfSettings().sigma_range:g}",))]
    sigma = ranges_sigma(stream, settings)
    if sigma is None or not scatter_more(sigma, settings.sigma_range):
        return []
    now = f"sigma_range is {settings.sigma_range:g} m"
    words = f"neighbouring ranges scatter by {sigma:.3f} m (1 sigma), and {now}"
    return [Finding("lrf", "noise", words, (f"lrf.sigma_range={sigma:.2g}",))]


def of_offset(stream: Stream, settings: LrfSettings, tried: bool = False) -> list[Finding]:
    """Return a finding if a constant error of the ranges makes straight walls look bent.

    If the caller tries the fix (`tried`), less evidence is enough.
    """
    found = ranges_offset(stream, settings)
    if found is None or abs(found[0]) < max(MIN_OFFSET_M, (TRIED_SIGMAS if tried else OFFSET_SIGMAS) * found[1]):
        return []
    add, sigma = found
    words = (
        f"straight walls look bent as if every range were {abs(add):.3f} m too {'short' if add > 0.0 else 'long'} "
        f"(1 sigma {sigma:.1g})"
    )
    fix = f"lrf.range_offset={settings.range_offset + add:z.3f}"
    return [Finding("lrf", OFFSET, words, (fix,), abs(add) > max(SEVERE_OFFSET_M, OFFSET_SIGMAS * sigma))]


def of_beam_angles(stream: Stream, drive: Drive, settings: LrfSettings) -> list[Finding]:
    """Return a finding if angle_increment makes straight walls look bent, in scans taken without turning.

    A relative error e of the angle a between beams adds -2 e a sin(a) r0 r2 / (r0 + r2) to the bend of a wall.
    That grows with the range, unlike the effect of a constant range error, so both are fitted together.
    """
    period, sampled = scan_period(stream.t_ns), []
    for _, scans in (part for columns in _sample(stream, FIRST_SCANS) for part in equal_scans(columns)):
        beams = scans["ranges"].shape[1]
        start = (scans["t_ns"] - drive.epoch_ns) * 1e-9 + settings.time_offset
        end = start + sweep_time(scans["time_increment"], beams, period)
        turn = np.abs(drive.wheels.heading(end) - drive.wheels.heading(start))
        straight = turn < MAX_TURNED_SHARE * beams * np.abs(scans["angle_increment"])
        sampled.append({name: column[straight] for name, column in scans.items()})
    laser = understood(laser_of(settings), sampled)
    parts = [bends for scans in sampled for bends in _bends(*returns(scans, laser)) if len(bends)]
    if sum(map(len, parts)) < MIN_TRIPLES or len(parts) < STRETCH_COUNT:
        return []
    error = float(_added(np.concatenate(parts))[1])
    every = jackknife(lambda some: _added(np.concatenate([parts[i] for i in some])), len(parts), STRETCH_COUNT)
    sigma = float(every[1])
    if not abs(error) > max(MIN_ANGLE_ERROR, ANGLE_SIGMAS * sigma):
        return []
    step = float(np.median(np.concatenate([np.abs(scans["angle_increment"]) for scans in sampled])))
    words = (
        f"straight walls look bent as if angle_increment, {step:.6g} rad, were {abs(error):.1%} too "
        f"{'small' if error > 0.0 else 'large'} (1 sigma {sigma:.1%}): correct it in the driver"
    )
    return [Finding("lrf", BEAM_ANGLES, words, severe=True)]


def ranges_offset(stream: Stream, settings: LrfSettings) -> tuple[float, float] | None:
    """Return the range offset [m] that makes walls straight, and its sigma; None with too few walls.

    Three beams an angle a apart hit a straight wall if r1 = 2 cos(a) r0 r2 / (r0 + r2). An offset changes the
    difference of both sides by 1 - 2 cos(a) (r0^2 + r2^2) / (r0 + r2)^2 times the offset; a scale error does not.
    """
    sampled = [scans for columns in _sample(stream, FIRST_SCANS) for _, scans in equal_scans(columns)]
    laser, add = understood(laser_of(settings), sampled), 0.0
    for _ in range(2):  # linearised at 0, then at the first solution
        other = laser._replace(offset=laser.offset + add)
        parts = [bends for scans in sampled for bends in _bends(*returns(scans, other))]
        if len(parts) < STRETCH_COUNT:
            return None
        if min(some.sum() for some in np.array_split([*map(len, parts)], STRETCH_COUNT)) < MIN_STRETCH_TRIPLES:
            return None
        more = float(_added(np.concatenate(parts)[:, :2])[0])
        add += more
        if abs(more) < MIN_OFFSET_M:
            break
    every = [bends[:, :2] for bends in parts]
    sigma = jackknife(lambda some: _added(np.concatenate([every[i] for i in some])), len(every), STRETCH_COUNT)
    sweep = [np.abs(scans["time_increment"]) * scans["ranges"].shape[1] for scans in sampled]
    return add, math.hypot(float(sigma[0]), BENT_MPS * float(np.median(np.concatenate(sweep))))


def _bends(ranges: Array, angles: Array) -> Iterator[Array]:
    """Yield for each scan (n, 3): bends of walls [m], and their derivatives by a range offset and by angles.

    `ranges` (k, b) [m] has one row per scan; n is the number of places on walls. The second derivative is by a
    relative error of the angle between beams; both have the sign of a correction.
    """
    if not len(ranges) or ranges.shape[1] < 2:
        return
    step = float(np.abs(np.diff(angles, axis=-1)).mean())
    k = round(HALF_SPAN_RAD / step) if step > 0.0 else 0
    if k < 2 or ranges.shape[1] <= 2 * k:
        return
    a = k * step
    before, here, after = ranges[:, : -2 * k], ranges[:, k:-k], ranges[:, 2 * k :]
    one_wall = np.isfinite(before + here + after)
    # all beams between the outer two lie near the line through their end points
    for j in range(1, 2 * k, max(1, k // CHECKED_BEAMS)):
        chord = before * math.sin(j * step) + after * math.sin(2.0 * a - j * step)
        wall = before * after * math.sin(2.0 * a) / chord
        one_wall &= ~(np.abs(ranges[:, j : j - 2 * k] - wall) > MAX_OFF_WALL_M)
    bend = _bend(before, here, after, math.cos(a))
    # by the beams next to the outer two, whose noise is independent of the bend's (instrumental variables)
    left, right = ranges[:, 1 : 1 - 2 * k], ranges[:, 2 * k - 1 : -1]
    slope = 1.0 - 2.0 * math.cos(a) * (np.square(left) + np.square(right)) / np.square(left + right)
    one_wall &= np.isfinite(slope)
    wider = 2.0 * a * math.sin(a) * left * right / (left + right)
    for row, on in enumerate(one_wall):
        yield np.stack((bend[row, on], slope[row, on], wider[row, on]), axis=-1)


def _added(bends: Array) -> Array:
    """Return the k corrections that make bends (n, 1 + k) of `_bends` zero, by robust least squares."""
    return -robust(bends[:, 1:], bends[:, 0])[0]


def scatter_more(shown: float | None, sigma: float) -> bool:
    """Return whether the observed range noise `shown` [m] is clearly larger than `sigma` [m]."""
    return shown is not None and MAX_SCATTER * sigma < shown < MAX_NOISE_M


def ranges_sigma(stream: Stream, settings: LrfSettings) -> float | None:
    """Return the noise of one range [m] by neighbouring ranges on walls; None if it is not Gaussian."""
    found = [scatter(columns) for columns in _sample(stream, SAMPLE_SCANS)]
    each = np.abs(np.concatenate(found)) if found else np.empty(0)
    if len(each) < MIN_TRIPLES:
        return None
    sigmas = settings.range_scale * np.quantile(each, NORMAL_SHARES) / NORMAL_SIZES
    sigma = float(sigmas.min())
    return sigma if sigmas.max() <= MAX_SIGMA_RATIO * sigma else None


def scatter(columns: dict[str, Any]) -> Array:
    """Return residuals [m] of three neighbouring ranges on a wall, scaled to the noise of one range.

    Beams an angle a apart hit a straight wall if 1 / r0 + 1 / r2 = 2 cos(a) / r1. Corners and clutter have much
    larger residuals.
    """
    ranges = cast("Ragged", columns["ranges"])
    lengths = ranges.lengths
    r = ranges.values[ranges.first[0] : ranges.first[-1]].astype(np.float64)
    scan = np.repeat(np.arange(len(lengths)), lengths)
    low, far, step = (c[scan] for c in (*limits(columns), np.asarray(columns["angle_increment"], np.float64)))
    seen = (r >= low) & (r < far)  # False for NaN and Inf
    at = np.flatnonzero(seen[:-2] & seen[1:-1] & seen[2:] & (scan[:-2] == scan[2:])) + 1
    before, here, after, cos = r[at - 1], r[at], r[at + 1], np.cos(step[at])
    by = 2.0 * cos * np.square(np.stack((before, after)) / (before + after))  # derivatives by `after`, `before`
    return np.asarray(_bend(before, here, after, cos) / np.sqrt(1.0 + np.square(by).sum(axis=0)))


def _bend(before: Array, here: Array, after: Array, cos: Array | float) -> Array:
    """Return range `here` [m] minus the range to the line through the other two ends; cos: of the beam spacing."""
    return here - 2.0 * cos * before * after / (before + after)


def _sample(stream: Stream, last: int) -> Iterator[dict[str, Any]]:
    """Yield columns of scans, evenly sampled from the first `last` scans.

    Scans with more than MAX_BEAMS beams are left out.
    """
    every, seen = max(1, min(len(stream.t_ns), last) // SAMPLE_SCANS), 0
    for rows, columns in stream.blocks(*Lrf.reads[stream.msgtype], rows=SAMPLE_SCANS):
        ranges = cast("Ragged", columns["ranges"])
        use = np.flatnonzero(((seen + np.arange(len(rows))) % every == 0) & (ranges.lengths <= MAX_BEAMS))
        if len(use):
            yield {name: take(column, use) for name, column in columns.items()} | {"t_ns": stream.t_ns[rows[use]]}
        seen += len(rows)
        if seen >= last:
            return


def unreturned(stream: Stream, least: float) -> str:
    """Return the shares of ranges without a return in words; "" if together they are not above `least`."""
    return _unreturned(list(_sample(stream, SAMPLE_SCANS)), least)


def _unreturned(parts: list[dict[str, Any]], least: float) -> str:
    if not parts:
        return ""
    values, far = (np.concatenate(some) for some in zip(*map(_beside_limit, parts), strict=True))
    if not len(values):
        return ""
    beyond = (values > far) & np.isfinite(values)
    beside = {"inf": np.isinf(values), "NaN": np.isnan(values), "zero": values == 0.0, "beyond range_max": beyond}
    shares = {name: found.mean() for name, found in beside.items()}
    if beyond.any() and np.median(values[beyond] / far[beyond]) > MAX_LIMIT_RATIO:
        shares["far beyond range_max, as in mm"] = shares.pop("beyond range_max")
    if sum(shares.values()) <= least:
        return ""
    return ", ".join(f"{share:.0%} {how}" for how, share in shares.items() if share >= 0.005)


def _in_turn(column: dict[str, Array]) -> list[Finding]:
    """Return a finding if scans alternate between two first angles.

    They come from two lasers on one topic, or from one laser that sends a revolution in parts.
    """
    angles, which, counts = np.unique(column["angle_min"].round(3), return_inverse=True, return_counts=True)
    if len(angles) < 2:
        return []
    a, b = np.argsort(-counts)[:2].tolist()
    changes = int((np.diff(which[np.isin(which, (a, b))]) != 0).sum())
    if counts[b] < MIN_IN_TURN or changes < counts[b]:
        return []
    parts = " and ".join(f"{counts[k]} scans at {math.degrees(angles[k]):.0f}°" for k in (a, b))
    words = (
        f"angle_min changes in turn ({parts}): two publishers on one topic? Record each laser on a topic of its "
        "own. If one laser sends each turn in parts, nothing is wrong"
    )
    return [Finding("lrf", "scan angles", words)]


def _angles(column: dict[str, Array], lengths: Array) -> list[Finding]:
    found = []
    if (column["angle_increment"] < 0.0).any():
        found.append(Finding("lrf", "clockwise", "its angles decrease: it scans clockwise (read correctly)"))
    if len(np.unique(lengths)) > 1:
        words = f"its scans have {int(lengths.min())} to {int(lengths.max())} beams; each is read with its own"
        found.append(Finding("lrf", "beams", words))
    if (column["time_increment"] < 0.0).any():
        words = "time_increment is negative: its size is used, and lrf.sweep is the order of the beams"
        found.append(Finding("lrf", "sweep sign", words))
    elif not (column["time_increment"] > 0.0).any():
        words = "time_increment is 0: points are not corrected for the motion during a scan"
        found.append(Finding("lrf", "not deskewed", words))
    return found
