"""Checks of maps of points with ids (radio anchors, landmarks) by the truth: where they stand, and their ranges.

The truth's positions and the readings of one point show its place, without the map. All places together show what
is wrong with the map: two ids exchanged, another frame, a mirrored axis, or one point that was moved.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from locfuse.fusion import se2
from locfuse.fusion.data import Array, Drive, Ints, Mask, Truth
from locfuse.fusion.robot import Robot
from locfuse.fusion.sensors.landmarks import mounts_of
from locfuse.fusion.sensors.points import PointsSettings
from locfuse.fusion.sensors.ranges import RangeFit, RangesSettings, anchor_beside
from locfuse.fusion.statistics import jackknife, robust, robust_sigma, robust_with_sigmas
from locfuse.fusion.truth import poses_at

from .finding import Finding

MAP, SAME = "map", "same value"  # codes of findings on a wrong map, on a point that repeats one value
SCALE = "range scale"  # code of the finding on ranges that are too long by a factor
MIN_READINGS, PARTS = 20, 8  # of one point; parts of the jackknife
MIN_MOVED_M = 0.3  # extent of the robot's path while a point repeats one value
MIN_OFF_M, SIGMAS = 0.15, 4.0  # m; standard errors: smallest error of a place and of one point's ranges
MIN_SCALE_ERROR, MAX_REST_SHARE = 0.03, 0.7  # smallest error of the range scale; residual spread with / without it
MAX_SPREAD_RATIO = 1.3  # of the residuals with an offset alone to those with another place, to call it an offset
COMMON_SIGMA_M = 0.02  # m, 1 sigma of the offset that all ranges share
MIN_YAW_RAD = math.radians(2.0)  # smallest error of a detector's direction
MAX_SAID = 3  # points in a message
MIN_SIZE_ERROR = 0.1  # smallest error of a map's size
MIN_FRAME_POINTS = 3  # points by which two frames are compared


class Place(NamedTuple):
    """Place of one point by the truth."""

    xy: Array  # (2,) m, the truth's frame
    sigma: float  # m
    offset: float = 0.0  # m by which its ranges are too long, if it stands where the map says
    offset_sigma: float = math.inf  # m, infinite if another place explains the ranges better


def of_points(drive: Drive, robot: Robot) -> list[Finding]:
    """Return findings on points that repeat one value, and on ranges and maps that the truth contradicts."""
    found = []
    for name in ("ranges", "landmarks"):
        if name in drive.measurements:
            repeats = _repeats(drive, robot, name)
            found += repeats or _of_map(drive, robot, name)
    return found


def _repeats(drive: Drive, robot: Robot, name: str) -> list[Finding]:
    """Return a finding on points whose readings stay the same while the robot drives."""
    m, settings = drive.measurements[name], robot.settings(name)
    t, ids = np.repeat(m.t, np.diff(m.first)), m.extra["id"]
    found = {}
    for one in np.unique(ids).tolist():
        rows = np.flatnonzero(ids == one)
        moved = drive.wheels.relative(np.full(len(rows), t[rows[0]]), t[rows])[:, :2]
        if len(rows) >= MIN_READINGS and not np.ptp(m.z[rows], axis=0).any() and np.ptp(moved) > MIN_MOVED_M:
            found[int(one)] = len(rows)
    if not found or len(found) == len(np.unique(ids)):
        return []
    words = " and ".join(f"all {n} readings of id {one} are the same" for one, n in found.items())
    return [Finding(name, SAME, f"{words}, while the robot drives", _ignoring(settings, name, [*found]))]


def _ignoring(settings: PointsSettings, name: str, ids: Sequence[int]) -> tuple[str, ...]:
    """Return the fix that leaves out these points too."""
    return (f"{name}.ignore=[{', '.join(map(str, sorted({*settings.ignore, *ids})))}]",)


def _of_map(drive: Drive, robot: Robot, name: str) -> list[Finding]:
    """Return the finding on the map, the scale of the ranges, or the direction of the detector, by the truth."""
    truth, settings = drive.truth, robot.settings(name)
    if truth is None or settings.grows:
        return []
    if isinstance(settings, RangesSettings):
        scale = _range_scale(drive, truth, settings)
        return scale or _compared(name, settings, _places_by_ranges(drive, truth, settings))
    seen = _places_seen(drive, truth, settings)
    if seen is None:
        return []
    places, yaw, yaw_sigma = seen
    if abs(yaw) > MIN_YAW_RAD + SIGMAS * yaw_sigma:
        turned = getattr(settings, "yaw_deg", 0.0) + math.degrees(yaw)
        sigma = f"1 sigma {math.degrees(yaw_sigma):.1f}°"
        words = f"by the truth its detector is turned by {turned:.1f}° ({sigma})"
        return [Finding(name, "yaw", words, (f"landmarks.yaw_deg={turned:.1f}",), True)]
    return _compared(name, settings, places)


def _at_truth(drive: Drive, truth: Truth, settings: PointsSettings) -> tuple[Array, Array, Mask]:
    """Return times (m,) [s] and ids (m,) of the rows inside the truth, and the mask (all rows,) of these rows."""
    m = drive.measurements[settings.table]
    t = np.repeat(m.t, np.diff(m.first))
    inside = truth.spans(t)
    return t[inside], m.extra["id"][inside], inside


def _range_scale(drive: Drive, truth: Truth, settings: RangesSettings) -> list[Finding]:
    """Return a finding if ranges are too long by a factor: their slope over the distances by the truth."""
    t, ids, inside = _at_truth(drive, truth, settings)
    if len(t) < MIN_READINGS:
        return []
    z, places = drive.measurements["ranges"].z[inside, 0], settings.places
    anchors = np.array([places[int(i)] for i in ids])
    distance = np.hypot(*(settings.detector(poses_at(truth, t)) - anchors).T)
    A = np.stack((distance, np.ones(len(t))), axis=-1)
    x, sigmas = robust_with_sigmas(A, z, PARTS)
    slope, sigma = float(x[0]), float(sigmas[0])
    before, after = z - distance, z - A @ x
    clearly = robust_sigma(after) < MAX_REST_SHARE * robust_sigma(before - np.median(before))
    if abs(slope - 1.0) < MIN_SCALE_ERROR + SIGMAS * sigma or not clearly:
        return []
    off = f"{abs(slope - 1.0):.1%} too {'long' if slope > 1.0 else 'short'}"
    words = f"its ranges are {off} by the truth (1 sigma {sigma:.1%}). No setting corrects that: scale the file"
    return [Finding("ranges", SCALE, words, (), True)]


def _places_by_ranges(drive: Drive, truth: Truth, settings: RangesSettings) -> dict[int, Place]:
    """Return the place of each anchor by its ranges from the truth's positions; an unclear place is left out.

    A place and an offset of the ranges are hard to tell apart, so all anchors have the same offset: the median of
    their own ones.
    """
    t, ids, inside = _at_truth(drive, truth, settings)
    z = drive.measurements["ranges"].z[inside, 0] - (settings.offset or 0.0)
    eye, found = settings.detector(poses_at(truth, t)), dict[int, Place]()
    rows_of = {one: np.flatnonzero(ids == one) for one in settings.places}
    rows_of = {one: rows for one, rows in rows_of.items() if len(rows) >= MIN_READINGS}

    def fits(longer: float, sigma: float) -> Iterator[tuple[int, Ints, RangeFit]]:
        for one, rows in rows_of.items():
            fit = anchor_beside(eye[rows], t[rows], z[rows] - longer, (settings.sigma, sigma), (math.inf,))
            if fit is not None:
                yield one, rows, fit

    offsets = [float(fit.values[-1]) for _, _, fit in fits(0.0, settings.searched_sigmas[1])]
    longer = float(np.median(offsets)) if offsets else 0.0
    for one, rows, fit in fits(longer, COMMON_SIGMA_M):
        away = z[rows] - np.hypot(*(eye[rows] - np.array(settings.places[one])).T)
        rest = z[rows] - longer - np.hypot(*(eye[rows] - fit.values[:2]).T)
        offset, spread = float(np.median(away)), robust_sigma(away - np.median(away))
        only = spread < MAX_SPREAD_RATIO * max(robust_sigma(rest), settings.sigma)
        sigma = math.sqrt(float(np.trace(fit.covariance[:2, :2])))
        found[one] = Place(fit.values[:2], sigma, offset, spread / math.sqrt(PARTS) if only else math.inf)
    return found


def _places_seen(
    drive: Drive, truth: Truth, settings: PointsSettings
) -> tuple[dict[int, Place], float, float] | None:
    """Fit each landmark's place, one offset of all ranges and one yaw error to the detections; None for few.

    Returns the places, the yaw error of the detector [rad] and its sigma.
    A detection at the distance r in the direction u, from the detector at e, is of a landmark at
    e + (r - offset) u + yaw r n, with n normal to u: the equation is linear. No map is needed.
    """
    m = drive.measurements["landmarks"]
    if m.z.shape[1] < 2 or truth.theta is None:
        return None
    t, ids, inside = _at_truth(drive, truth, settings)
    known = [one for one in settings.places if (ids == one).sum() >= MIN_READINGS]
    rows = np.flatnonzero(np.isin(ids, known))
    if not len(rows):
        return None
    mounts = mounts_of(m, (settings.x, settings.y, math.radians(getattr(settings, "yaw_deg", 0.0))))[inside][rows]
    eye, (bearing, far) = se2.compose(poses_at(truth, t[rows]), mounts), m.z[inside][rows].T
    ahead = eye[:, 2] + bearing
    u = np.stack((np.cos(ahead), np.sin(ahead)), axis=-1)
    n = np.stack((-u[:, 1], u[:, 0]), axis=-1)
    which = (ids[rows][:, None] == known).astype(np.float64)  # (k, landmarks)
    zero = np.zeros_like(which)
    along = (np.column_stack((which, zero, u[:, 0])), np.column_stack((zero, which, u[:, 1])))
    A = np.stack([np.column_stack((one, -far * n[:, i])) for i, one in enumerate(along)], axis=1)
    y = eye[:, :2] + far[:, None] * u

    def fitted(some: Ints) -> Array:
        return robust(A[some].reshape(-1, A.shape[-1]), y[some].ravel())[0]

    x, errors = fitted(np.arange(len(rows))), jackknife(fitted, len(rows), PARTS)
    sigmas, k = np.broadcast_to(errors, x.shape), len(known)
    places = {one: Place(x[[i, k + i]], float(np.hypot(sigmas[i], sigmas[k + i]))) for i, one in enumerate(known)}
    return places, float(x[-1]), float(sigmas[-1])


def _compared(name: str, settings: PointsSettings, seen: Mapping[int, Place]) -> list[Finding]:
    """Return a finding on wrong places in the map, or on anchors whose range offset differs from the others'."""
    ids = [*seen]
    a = np.array([settings.places[i] for i in ids]).reshape(-1, 2)
    b = np.array([seen[i].xy for i in ids]).reshape(-1, 2)
    limit = MIN_OFF_M + SIGMAS * np.array([seen[i].sigma for i in ids])
    # the ranges of an anchor that an offset explains do not contradict its place
    explained = np.array([math.isfinite(seen[i].offset_sigma) for i in ids], dtype=bool)
    off = np.flatnonzero((np.hypot(*(a - b).T) > limit) & ~explained)
    if 2 * len(off) >= len(ids) >= MIN_FRAME_POINTS and (how := _frame(a, b, limit)):
        return [Finding(name, MAP, how, (), True)]
    if len(off) > 1 and (places := _exchanged(a[off], b[off], limit[off])) is not None:
        swapped = ", ".join(f"{ids[off[i]]} stands where the map has {ids[off[j]]}" for i, j in enumerate(places))
        if len(off) == 2:
            swapped = " and ".join(str(ids[i]) for i in off)
        return [Finding(name, MAP, f"ids are exchanged in the map, by the truth: {swapped}", (), True)]
    words, wrong = list[str](), list[int]()
    offsets = {one: place.offset for one, place in seen.items() if math.isfinite(place.offset_sigma)}
    for i, one in enumerate(ids):
        others = [offset for other, offset in offsets.items() if other != one]
        longer, (x, y) = seen[one].offset - float(np.median(others or [seen[one].offset])), b[i].tolist()
        if abs(longer) > MIN_OFF_M + SIGMAS * seen[one].offset_sigma:
            by = f"{abs(longer):.2f} m {'longer' if longer > 0.0 else 'shorter'}"
            words.append(f"the ranges of id {one} are {by} than those of the others")
        elif i in off:
            away = f"{np.hypot(*(a[i] - b[i])):.2f} m (1 sigma {seen[one].sigma:.2f})"
            words.append(f"id {one} stands at ({x:.2f}, {y:.2f}) m, {away} from its place in the map")
        else:
            continue
        wrong.append(one)
    if not wrong:
        return []
    more = f", and {len(words) - MAX_SAID} more" if len(words) > MAX_SAID else ""
    said = f"by the truth {'; '.join(words[:MAX_SAID])}{more}"
    return [Finding(name, MAP, said, _ignoring(settings, name, wrong) if 2 * len(wrong) <= len(ids) else (), True)]


def _exchanged(a: Array, b: Array, limit: Array) -> Ints | None:
    """Return for each observed place b (n, 2) the point of the map a (n, 2) that stands there; None if unclear."""
    apart = np.hypot(*(b[:, None] - a[None]).transpose(2, 0, 1))
    nearest: Ints = np.argmin(apart, axis=1)
    fits = (apart.min(axis=1) < limit).all() and len(set(nearest.tolist())) == len(a)
    return nearest if fits else None


def _frame(a: Array, b: Array, limit: Array) -> str:
    """Return how the map a (n, 2) lies against observed places b (n, 2), if a common motion explains these."""
    there = b @ (1.0, 1.0j)
    for mirrored in (False, True):
        here = a @ (1.0, -1.0j if mirrored else 1.0j)
        turn, shift = robust(np.stack((here, np.ones(len(a))), axis=-1), there)[0].tolist()
        size = abs(turn) or 1.0
        scaled = abs(size - 1.0) > MIN_SIZE_ERROR
        turn /= 1.0 if scaled else size
        shift = complex(np.median((there - turn * here).real), np.median((there - turn * here).imag))
        if (np.abs(there - turn * here - shift) < limit).all():
            angle = math.degrees(math.atan2(turn.imag, turn.real))
            how = "mirrored (an axis has the other sign, or x and y are exchanged), and " if mirrored else ""
            how = f"{1.0 / size:.3g} times as large, {how}" if scaled else how
            moved = f"turned by {angle:.0f}° and shifted by ({shift.real:.2f}, {shift.imag:.2f}) m"
            return f"by the truth its map is {how}{moved}: write both in one frame, in metres"
    return ""
