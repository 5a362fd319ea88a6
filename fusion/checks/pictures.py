"""Camera checks: can its pictures be used, do they show red, and in which direction do their columns turn?

A few pictures are looked at: decoding all takes long.
"""

from __future__ import annotations

import math
from collections import Counter

import numpy as np

from locfuse.fusion import se2
from locfuse.fusion.camera.bearing import predict_bearing
from locfuse.fusion.camera.images import Picture, decode, messages
from locfuse.fusion.data import Array, Drive, Stream
from locfuse.fusion.robot import Robot
from locfuse.fusion.se2 import wrap, wrap_all
from locfuse.fusion.sensors.camera import CameraSettings, detector

from .finding import Finding
from .rims import of_rims

SAMPLE_PICTURES = 24  # looked at
MAX_BAD_SHARE = 0.5  # share of the pictures
MIN_TURN_RAD, MAX_TURN_RAD = math.radians(4.0), math.radians(90.0)  # between two pictures that are compared
MIN_WHOLE_TURN_RAD = math.pi  # what the robot must have turned in all
MIRRORED_SHARE = 0.8  # of what it turned: the bearing went with it, not against it
START_WAY_M, MIN_BEARINGS = 2.0, 3  # m that wheels alone carry the start's pose, and pictures on it
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
    """Return what is unusual about some pictures of a stream, evenly spread."""
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
    """Return some pictures of a stream, evenly spread, or why one cannot be used."""
    wanted = set(range(0, len(stream.t_ns), max(1, len(stream.t_ns) // SAMPLE_PICTURES)))
    return [decode(message) for block in messages(stream) for row, message in block if row in wanted]


def of_calibration(stream: Stream, settings: CameraSettings) -> list[Finding]:
    """Return where the mirror's circles lie, for a camera whose calibration is not configured."""
    if settings.centre is not None:
        return []
    pictures = [p for p in _sampled(stream) if not isinstance(p, str)]
    return of_rims([p for p in pictures if p.shape == pictures[0].shape], settings)


def _red(pictures: list[Picture], settings: CameraSettings) -> list[Finding]:
    """Report if hardly any picture shows something red and upright, unless its colours are exchanged."""
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
    """Report if the columns turn the other way: then the landmark turns with the robot.

    It must go against them, but for what the robot drives in the meantime. A known start gives the zero too.
    """
    settings = robot.settings("camera")
    t, z = _alone(drive)
    if settings.landmark is None or len(t) < 2:
        return []
    turn, change = np.diff(drive.wheels.heading(t)), wrap_all(np.diff(z))
    clear = (np.abs(turn) > MIN_TURN_RAD) & (np.abs(turn) < MAX_TURN_RAD)
    turn, change = turn[clear], change[clear]
    whole = float(np.abs(turn).sum())
    along = np.abs(wrap_all(change - turn)) < np.abs(wrap_all(change + turn))
    share = float(np.abs(turn[along]).sum()) / max(whole, 1e-9)
    if whole < MIN_WHOLE_TURN_RAD or share < MIRRORED_SHARE:
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


def _alone(drive: Drive) -> tuple[Array, Array]:
    """Return times (n,) [s] and bearings (n,) [rad] of pictures that show one candidate for the landmark."""
    m = drive.measurements.get("camera")
    if m is None:
        return np.zeros(0), np.zeros(0)
    one = np.flatnonzero(np.diff(m.first) == 1)
    return m.t[one], m.z[m.first[one], 0]


def _zero(drive: Drive, robot: Robot, t: Array, z: Array) -> float | None:
    """Return the offset of bearings z (n,) at t (n,) from those expected on the first metres; None if unknown."""
    settings, start = robot.settings("camera"), robot.start
    near = drive.wheels.driven(t) < START_WAY_M
    early = t[near]
    if not robot.start_given or len(early) < MIN_BEARINGS:
        return None
    x, y, yaw = settings.mount
    poses = se2.compose(np.array(start.pose), drive.wheels.at(early)[2])
    seen = [predict_bearing(tuple(p), settings.landmark, (x, y), yaw) for p in poses.tolist()]
    lacks = [s[0] - b for s, b in zip(seen, z[near].tolist(), strict=True) if s is not None]
    if len(lacks) < MIN_BEARINGS:
        return None
    middle = math.atan2(float(np.sin(lacks).mean()), float(np.cos(lacks).mean()))
    return middle + float(np.median(wrap_all(np.array(lacks) - middle)))
