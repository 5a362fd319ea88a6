"""Camera checks on a few pictures: readability, red landmark, direction of the columns, mirror circles."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from locfuse.fusion import se2
from locfuse.fusion.data import Array, Drive, Stream
from locfuse.fusion.robot import Robot
from locfuse.fusion.se2 import wrap, wrap_all
from locfuse.fusion.sensors.camera import MIN_DISTANCE_M, CameraSettings, detector

from .finding import Finding

if TYPE_CHECKING:
    from locfuse.fusion.camera.images import Picture

SAMPLE_PICTURES = 24  # decoding all would take long
MAX_BAD_SHARE = 0.5  # share of the pictures
MIN_TURN_RAD, MAX_TURN_RAD = math.radians(4.0), math.radians(90.0)  # between two pictures that are compared
MIN_WHOLE_TURN_RAD = math.pi  # smallest sum of the robot's turns
MIRRORED_SHARE = 0.8  # least share of the turns in which the bearing turned in the robot's direction
START_WAY_M, MIN_BEARINGS = 2.0, 3  # m after the start in which wheel odometry is used; pictures needed there
MIN_ZERO_RAD = math.radians(5.0)
PROBLEMS = {
    "no_colour": "are grey (mono): red needs colour",
    "unreadable": "cannot be decoded: truncated, or neither JPEG nor PNG",
    "not_whole": "are damaged inside",
    "too_large": "claim more pixels than can be held",
    "too_short": "hold less data than their size says",
    "unknown_encoding": "are of an encoding that is not read (rgb8, bgr8, rgba8, bgra8 are)",
}


def of_pictures(stream: Stream, settings: CameraSettings) -> list[Finding]:
    """Return findings on pictures of a stream, from an evenly spread sample."""
    decoded = _sampled(stream)
    found, total = [], len(decoded)
    for why, n in Counter(one for one in decoded if isinstance(one, str)).items():
        words = f"{n} of {total} pictures looked at {PROBLEMS[why]}"
        found.append(Finding("camera", "pictures", words, (), n > MAX_BAD_SHARE * total))
    pictures = [one for one in decoded if not isinstance(one, str)]
    sizes = Counter((p.shape[1], p.shape[0]) for p in pictures)
    if len(sizes) > 1:
        listed = ", ".join(f"{w} x {h} ({n})" for (w, h), n in sizes.most_common())
        found.append(Finding("camera", "pictures", f"they change size: {listed}; only the usual size is used"))
    usual = max(sizes, key=lambda size: (sizes[size], size), default=None)
    pictures = [p for p in pictures if (p.shape[1], p.shape[0]) == usual]
    return [*found, *_red(pictures, settings), *of_rims(pictures, settings)]


def _sampled(stream: Stream) -> list[Picture | str]:
    """Return an evenly spread sample of a stream's pictures, or the reason for each unusable one."""
    from locfuse.fusion.camera.images import decode, messages  # needs OpenCV

    wanted = set(range(0, len(stream.t_ns), max(1, len(stream.t_ns) // SAMPLE_PICTURES)))
    return [decode(message) for block in messages(stream) for row, message in block if row in wanted]


def of_calibration(stream: Stream, settings: CameraSettings) -> list[Finding]:
    """Return a finding with the mirror's circles, for a camera without a configured centre."""
    if settings.centre is not None:
        return []
    pictures = [p for p in _sampled(stream) if not isinstance(p, str)]
    return of_rims([p for p in pictures if p.shape == pictures[0].shape], settings)


def _red(pictures: list[Picture], settings: CameraSettings) -> list[Finding]:
    """Return a finding if most pictures show no red upright object, or if red and blue are exchanged."""
    if settings.landmark is None or not pictures:
        return []
    find, n = detector(settings), len(pictures)
    shows = sum(bool(find.find(p).candidates) for p in pictures)
    if shows > (1.0 - MAX_BAD_SHARE) * n:
        return []
    exchanged = sum(bool(find.find(np.ascontiguousarray(p[..., ::-1])).candidates) for p in pictures)
    if exchanged > max(shows, MAX_BAD_SHARE * n):
        words = f"{exchanged} of {n} pictures show something upright in blue, {shows} in red: rgb is taken for bgr"
        fix = f"camera.swapped={str(not settings.swapped).lower()}"
        return [Finding("camera", "swapped", words, (fix,), True)]
    words = (
        f"nothing red and upright in {n - shows} of {n} pictures: --preview shows what counts as red, and where"
    )
    return [Finding("camera", "blind", words, (), shows == 0)]


def of_handedness(drive: Drive, robot: Robot) -> list[Finding]:
    """Return a finding if pictures are mirrored: the landmark's bearing turns in the same direction as the robot.

    It should turn opposite to the robot. With a known start, camera.zero_deg is fixed too.
    """
    settings = robot.settings("camera")
    t, z = _alone(drive)
    share, whole = turning_along(drive, robot)
    if share is None or share < MIRRORED_SHARE:
        return []
    words = (
        f"the landmark turns with the robot, not against it, in {share:.0%} of {math.degrees(whole):.0f} degrees: "
        "the columns of the picture turn the other way round"
    )
    fixes = [f"camera.clockwise={str(not settings.clockwise).lower()}"]
    zero = _zero(drive, robot, t, wrap_all(2.0 * math.radians(settings.zero_deg) - z))
    if zero is not None and abs(zero) > MIN_ZERO_RAD:
        degrees = math.degrees(wrap(zero + math.radians(settings.zero_deg)))
        fixes.append(f"camera.zero_deg={degrees:.0f}")
    return [Finding("camera", "mirrored", words, tuple(fixes), True)]


def turning_along(drive: Drive, robot: Robot) -> tuple[float | None, float]:
    """Return the share of turns with a bearing change of equal sign, and the sum of all turns [rad].

    The share is None without a landmark, or if the robot hardly turned.
    """
    t, z = _alone(drive)
    if robot.settings("camera").landmark is None or len(t) < 2:
        return None, 0.0
    turn, change = np.diff(drive.wheels.heading(t)), wrap_all(np.diff(z))
    clear = (np.abs(turn) > MIN_TURN_RAD) & (np.abs(turn) < MAX_TURN_RAD)
    turn, change = turn[clear], change[clear]
    whole = float(np.abs(turn).sum())
    along = np.abs(wrap_all(change - turn)) < np.abs(wrap_all(change + turn))
    return (float(np.abs(turn[along]).sum()) / whole if whole >= MIN_WHOLE_TURN_RAD else None), whole


def _alone(drive: Drive) -> tuple[Array, Array]:
    """Return times (n,) [s] and bearings (n,) [rad] of pictures with exactly one landmark candidate."""
    m = drive.measurements.get("camera")
    if m is None:
        return np.zeros(0), np.zeros(0)
    one = np.flatnonzero(np.diff(m.first) == 1)
    return m.t[one], m.z[m.first[one], 0]


def _zero(drive: Drive, robot: Robot, t: Array, z: Array) -> float | None:
    """Return the mean error of bearings z (n,) [rad] at t (n,) [s] near the known start; None if unknown."""
    settings, start = robot.settings("camera"), robot.start
    near = drive.wheels.driven(t) < START_WAY_M
    early = t[near]
    if not robot.start_given or len(early) < MIN_BEARINGS:
        return None
    poses = se2.compose(np.array(start.pose), drive.wheels.at(early)[2])
    seen = [se2.sight(tuple(p), settings.landmark, settings.mount, MIN_DISTANCE_M) for p in poses.tolist()]
    lacks = [se2.wrap(s[0]) - b for s, b in zip(seen, z[near].tolist(), strict=True) if s is not None]
    if len(lacks) < MIN_BEARINGS:
        return None
    middle = math.atan2(float(np.sin(lacks).mean()), float(np.cos(lacks).mean()))
    return middle + float(np.median(wrap_all(np.array(lacks) - middle)))


RIMS = "rims"  # code of the finding
RAY_COUNT = 240
MIN_PICTURES = 4
MIN_STEP_SHARE = 0.15  # of the brightest grey level: step in brightness at a rim
MIN_ON_CIRCLE_SHARE = 0.7  # of the rays, for a circle
MAX_REST_SHARE, MIN_REST_PX = 0.01, 1.0  # of the radius, px: largest distance of a step from the circle
MAX_INNER_SHARE = 0.6  # of the rim's radius
MIN_ERROR_PX = 1.5  # px: smaller errors of the calibration are not reported


class Circle(NamedTuple):
    """A circle in a picture, px."""

    x: float
    y: float
    radius: float


def of_rims(pictures: Sequence[Picture], settings: CameraSettings) -> list[Finding]:
    """Return a finding if the mirror's circles in the pictures are clear and differ from the configured ones."""
    if len(pictures) < MIN_PICTURES:
        return []
    grey = np.mean([p.astype(np.float32).mean(axis=2) for p in pictures], axis=0)
    height, width = grey.shape
    rim = _circle(grey, Circle(0.5 * (width - 1), 0.5 * (height - 1), 0.5 * np.hypot(width, height)), inward=True)
    if rim is None:
        return []
    inner = _circle(grey, rim._replace(radius=MAX_INNER_SHARE * rim.radius), inward=False)
    now = detector(settings).optics((height, width))
    found = {"centre": f"[{rim.x:.1f}, {rim.y:.1f}]", "outer": f"{rim.radius:.0f}"}
    off = [np.hypot(rim.x - now.x_c, rim.y - now.y_c), abs(rim.radius - now.outer)]
    if inner is not None:
        found["inner"] = f"{inner.radius:.0f}"
        off.append(abs(inner.radius - now.inner))
    if max(off) < MIN_ERROR_PX:
        return []
    words = (
        f"the mirror's rim is a circle about ({rim.x:.1f}, {rim.y:.1f}) px of radius {rim.radius:.0f} px, "
        f"configured are ({now.x_c:.1f}, {now.y_c:.1f}) px and {now.outer:.0f} px"
    )
    return [Finding("camera", RIMS, words, tuple(f"camera.{key}={value}" for key, value in found.items()))]


def _circle(grey: Array, within: Circle, inward: bool) -> Circle | None:
    """Fit a circle to brightness steps in the disc `within`; None if too few rays agree.

    One step is taken on each ray: the first one from the rim if `inward`, else the first one from the centre.
    """
    angle = np.arange(RAY_COUNT) * (2.0 * np.pi / RAY_COUNT)
    r = np.arange(2.0, within.radius)
    x, y = (c + np.outer(w, r) for c, w in ((within.x, np.cos(angle)), (within.y, np.sin(angle))))
    column, row = np.rint(x).astype(int), np.rint(y).astype(int)
    inside = (column >= 0) & (column < grey.shape[1]) & (row >= 0) & (row < grey.shape[0])
    seen = np.where(inside, grey[row.clip(0, grey.shape[0] - 1), column.clip(0, grey.shape[1] - 1)], np.nan)
    steps = np.abs(seen[:, 3:] - seen[:, :-3]) > MIN_STEP_SHARE * float(grey.max())
    steps = steps[:, ::-1] if inward else steps
    first = steps.argmax(axis=1)
    rays = np.flatnonzero(steps.any(axis=1))
    at = (steps.shape[1] - 1 - first if inward else first)[rays]
    # the steepest pixel of the step
    near = np.clip(at[:, None] + np.arange(-3, 4), 0, seen.shape[1] - 4)
    slope = np.nan_to_num(np.abs(seen[rays[:, None], near + 2] - seen[rays[:, None], near + 1]))
    best = near[np.arange(len(rays)), slope.argmax(axis=1)] + 1.5
    reach, towards = 2.0 + best, angle[rays]
    points = np.stack((within.x + reach * np.cos(towards), within.y + reach * np.sin(towards)))
    keep = np.ones(len(rays), dtype=bool)
    for _ in range(5):
        if keep.sum() < MIN_ON_CIRCLE_SHARE * RAY_COUNT:
            return None
        px, py = points[:, keep]
        (a, b, c), *_ = np.linalg.lstsq(np.stack((px, py, np.ones_like(px)), axis=-1), px**2 + py**2, rcond=None)
        found = Circle(0.5 * float(a), 0.5 * float(b), float(np.sqrt(c + 0.25 * (a * a + b * b))))
        rest = np.abs(np.hypot(points[0] - found.x, points[1] - found.y) - found.radius)
        keep = rest < max(MIN_REST_PX, MAX_REST_SHARE * found.radius, 2.0 * float(np.median(rest)))
    return found if (rest < max(MIN_REST_PX, MAX_REST_SHARE * found.radius)).mean() > MIN_ON_CIRCLE_SHARE else None
