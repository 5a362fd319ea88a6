"""Omni-directional camera: the bearing of one red vertical landmark whose place in the map is known.

The paper uses the landmark's column as the robot's orientation, which is correct only for a landmark far away.
Here the measured bearing is compared with the predicted one; `bearing = "absolute"` gives the paper's version.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping
from operator import attrgetter
from typing import Any, ClassVar, Literal, NamedTuple

import numpy as np
from msgspec.structs import astuple

from locfuse.fusion.camera.optics import FIELDS, bearing
from locfuse.fusion.data import Array, Colour, Component, Ints, LocfuseError, Measurements, RowVerdict, Stream
from locfuse.fusion.kernels.ekf import Innovation
from locfuse.fusion.mount import ASK_MOUNT, Mount, MountedSettings, mount_states
from locfuse.fusion.se2 import sight, transform, wrap, wrap_all
from locfuse.fusion.sensor import NO_BLOCK, NO_COLUMNS, Ask, Belief, Bias, Block, Model, Sensor, WheelMotion
from locfuse.fusion.statistics import chi_square, clipped_rms
from locfuse.fusion.streams import seconds

Point = tuple[float, float]
MIN_DISTANCE_M = 0.05  # m: nearer than this the camera is inside the landmark
H_ORIENTATION = ((0.0, 0.0, 1.0),)  # the camera's row of eq. 13, as printed
MAX_PANORAMA_COLUMNS, MAX_PANORAMA_ROWS = 3600, 8192  # size of a panorama, so that its tables need below 250 MB
MIN_CANDIDATE_MARGIN = 9.0  # squared sigmas by which the second-best candidate must fit worse: odds of 90 to 1


class CameraSettings(MountedSettings, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Settings of [camera] in robot.toml: landmark position, panorama calibration and limits of the colour red."""

    landmark: Point | None = None  # m, map frame; without it the camera cannot be used
    centre: Point | None = None  # px, where the mirror's axis meets the picture; not set: its middle
    inner: float | None = None  # px, radius below which the robot sees itself; not set: outer / 4
    outer: float | None = None  # px, radius of the mirror's rim; not set: to the picture's nearest edge
    width: int = 720  # columns of the panorama
    zero_deg: float = 0.0  # bearing of column 0 (straight down in the picture)
    clockwise: bool = False  # columns turn clockwise in the world, seen from above
    sigma_deg: float = 0.3  # of a bearing, in addition to the error by the pixel size
    chain: Literal["fast", "paper", "printed"] = "fast"  # printed: eq. (1) with its misprints
    bearing: Literal["relative", "absolute"] = "relative"  # absolute: the paper's orientation
    red_ratio: float = 0.4  # red is R - max(G, B) >= red_ratio R
    red_min: float = 30.0  # and >= red_min grey levels
    swapped: bool = False  # red and blue are exchanged: the driver names the encoding rgb, but writes bgr
    min_length: float = 12.0  # px along the radius
    min_slender: float = 1.5  # length over width

    def __post_init__(self) -> None:
        """Raise ValueError if a number is not finite or out of its range."""
        super().__post_init__()
        numbers = [v for v in astuple(self) if isinstance(v, tuple | float)]
        if not np.isfinite(np.hstack(numbers)).all():
            raise ValueError("camera: every number must be finite")
        if not 36 <= self.width <= MAX_PANORAMA_COLUMNS:
            raise ValueError(f"camera.width = {self.width}, must be within 36..{MAX_PANORAMA_COLUMNS} columns")
        inner = self.inner or 0.0
        if inner < 0.0 or (self.outer is not None and self.outer <= inner):
            raise ValueError(f"camera: outer = {self.outer} px must exceed inner = {self.inner} px, both positive")
        if (self.outer or 0.0) > MAX_PANORAMA_ROWS or inner > MAX_PANORAMA_ROWS:
            raise ValueError(f"camera: inner and outer must be at most {MAX_PANORAMA_ROWS} px")
        if self.bearing == "absolute" and (self.sigma_x or self.sigma_y or self.sigma_yaw_deg):
            raise ValueError("camera.bearing = absolute knows no mount: sigma_x, sigma_y, sigma_yaw_deg must be 0")


class Camera(Sensor):
    """The camera: reads CompressedImage (JPEG, PNG) and Image (rgb8, bgr8, rgba8, bgra8)."""

    name = "camera"
    locates = True
    Settings = CameraSettings
    components = (Component("bearing", "deg", math.degrees(1.0)),)
    states = mount_states("camera")
    drawn = "bearing"
    colour = Colour("#2aa090", "#74f0a4")
    noise_keys = ("sigma_deg",)
    bias = Bias("zero_deg", -1.0, sigma="sigma_yaw_deg")
    in_blocks = True  # pictures are never all in memory
    costly = True  # decoding every picture takes longer than all the rest
    asks: ClassVar[Mapping[str, Ask]] = {
        "landmark": Ask(
            "[x, y] in m, map frame: not in this log. Where the red landmark stands; "
            "`locfuse info LOG --preview DIR` shows what the camera takes for it",
            needed=True,
        ),
        **dict.fromkeys(("x", "y", "yaw_deg"), Ask(f"m, m, degrees: {ASK_MOUNT}", blank=True)),
        "centre": Ask("[column, row] in px: where the mirror's axis meets the picture; left out, its middle"),
        "outer": Ask("px: radius of the mirror's rim; left out, to the picture's nearest edge"),
    }
    guesses: ClassVar[Mapping[str, str]] = {
        "zero_deg": "guess: bearing at which column 0 (straight down in the picture) looks",
        "clockwise": "guess: columns turn counter-clockwise in the world, seen from above",
    }
    reads: ClassVar[Mapping[str, tuple[str, ...]]] = FIELDS

    def missing(self, settings: CameraSettings) -> str | None:
        """Return the message that camera.landmark is not set, or None."""
        if settings.landmark is not None:
            return None
        return (
            "camera.landmark is not set. Look at the pictures with: locfuse info LOG --preview DIR, "
            "then --set camera.landmark=[X,Y]"
        )

    def landmark(self, settings: CameraSettings) -> Point | None:
        """Return the position of the red landmark, (x, y) [m, map frame]; None if not set."""
        return settings.landmark

    def misfit(self, m: Measurements, settings: CameraSettings, poses: Array) -> float | None:
        """Return the spread [rad] of the bearings of the largest candidates about poses (n, 3), without a mean."""
        seen = np.flatnonzero(np.diff(m.first) > 0)
        if settings.landmark is None or not len(seen) or not np.isfinite(poses).all():
            return None
        pose = poses[seen]
        at = np.array(settings.landmark) - transform(pose, np.array([settings.x, settings.y]))
        off = wrap_all(m.z[m.first[seen], 0] - np.arctan2(at[:, 1], at[:, 0]) + pose[:, 2])
        middle = np.angle(np.exp(1.0j * off).mean())
        return clipped_rms(wrap_all(off - middle))

    def measure(
        self, stream: Stream, settings: CameraSettings, wheels: WheelMotion, epoch_ns: int
    ) -> Measurements:
        """Measure bearings z (m, 1) [rad, camera frame] of the red candidates in each picture, largest first.

        Only pictures of the most frequent size are used, since the calibration is for one size. Raises
        LocfuseError if no landmark is set.
        """
        missing = self.missing(settings)
        if missing:
            raise LocfuseError(f"{stream.topic}: {missing}")
        return _collect(look(stream, detector(settings)), settings, epoch_ns)

    def again(self, before: Measurements, settings: CameraSettings, epoch_ns: int) -> Measurements | None:
        """Return the result of `measure` from stored detections; None if the detector's settings changed.

        Stored detections remain valid if only the clock, the direction of column 0 or sigma changes.
        """
        seen = before.seen
        if (
            self.missing(settings)
            or not isinstance(seen, SeenLandmarks)
            or not seen.by.looks_like(detector(settings))
        ):
            return None
        return _collect(seen, settings, epoch_ns)

    def model(self, settings: CameraSettings) -> Model:
        """Return the filter model of the camera for a new run."""
        missing = self.missing(settings)
        if missing or settings.landmark is None:
            raise LocfuseError(f"camera: {missing}")
        if settings.bearing == "absolute":
            return OrientationModel(settings, settings.landmark)
        return BearingModel(settings, settings.landmark)


def detector(settings: CameraSettings) -> Any:
    """Return the `fusion.camera.detect.Detector` with these settings."""
    from locfuse.fusion.camera.detect import Detector
    from locfuse.fusion.camera.panorama import Red

    return Detector(
        chain=settings.chain,
        red=Red(settings.red_ratio, settings.red_min, settings.min_length, settings.min_slender),
        centre=settings.centre,
        inner=settings.inner,
        outer=settings.outer,
        width=settings.width,
        zero=math.radians(settings.zero_deg),
        clockwise=settings.clockwise,
        swapped=settings.swapped,
    )


class SeenLandmarks(NamedTuple):
    """Landmark candidates in the pictures of a log, before time offset and mount are applied."""

    by: Any  # the Detector that was used
    shape: tuple[int, int]  # px, height and width of the n pictures
    t_ns: Ints  # (n,)
    first: Ints  # (n + 1,) picture i has the candidates first[i]:first[i + 1]
    candidates: Array  # (m, 6), columns as in `fusion.camera.panorama.Candidate`
    dropped: dict[str, int]


def look(stream: Stream, by: Any) -> SeenLandmarks:
    """Detect landmark candidates in all pictures of a stream that have the most frequent size."""
    from locfuse.fusion.camera.detect import Detection, detections

    found: list[tuple[int, Detection]] = []
    dropped = Counter(stream.dropped)
    for row, seen in detections(stream, by):
        if isinstance(seen, str):
            dropped[seen] += 1
        else:
            found.append((row, seen))
    sizes = Counter(seen.shape for _, seen in found)
    usual = max(sizes, key=lambda size: (sizes[size], size), default=(1, 1))
    if len(sizes) > 1:
        dropped["other_size"] += len(found) - sizes[usual]
        found = [(row, seen) for row, seen in found if seen.shape == usual]
    return SeenLandmarks(
        by,
        usual,
        stream.t_ns[np.array([row for row, _ in found], np.int64)],
        np.concatenate(([0], np.cumsum([len(seen.candidates) for _, seen in found], dtype=np.int64))),
        np.array([c for _, seen in found for c in seen.candidates], np.float64).reshape(-1, 6),
        dict(dropped),
    )


def _collect(seen: SeenLandmarks, settings: CameraSettings, epoch_ns: int) -> Measurements:
    theta, explained, pixels, length, width, _ = seen.candidates.T.copy()
    sigma = math.radians(settings.sigma_deg)
    # the paper's var(gamma) has no term for the pixels
    rest = np.zeros(len(theta)) if settings.bearing == "absolute" else explained
    return Measurements(
        t=seconds(seen.t_ns, epoch_ns, settings.time_offset),
        first=seen.first,
        z=bearing(theta, detector(settings).optics(seen.shape)).reshape(-1, 1),
        R_unit=(1.0 + rest / sigma**2).reshape(-1, 1, 1),
        scale=sigma,
        floor=np.zeros((1, 1)),
        extra={
            "rest": rest,  # rad^2, variance by the pixel size, added to sigma^2
            "pixels": pixels,
            "length": length,  # px
            "width": width,  # rad
        },
        dropped=dict(seen.dropped),
        seen=seen,
    )


class BearingModel(Model):
    """z = wrap(atan2(dy, dx) - theta - yaw) + noise, (dx, dy) from the camera to the landmark."""

    def __init__(self, settings: CameraSettings, landmark: Point) -> None:
        self.landmark = landmark
        self.mount = Mount("camera", settings)
        self.threshold = chi_square(settings.gate, 1)

    def blocks(self) -> list[Block]:
        """Return the state block of the camera's mount; empty if the mount is known exactly."""
        return self.mount.blocks()

    def notes(self, belief: Any) -> list[str]:
        """Return a note with the estimated mount of the camera."""
        return self.mount.words(belief)

    def innovations(self, m: Measurements, i: int, belief: Belief) -> list[Innovation]:
        """Return the innovations of all candidates in picture i; at most one is accepted as the landmark.

        Two that fit about equally well are ambiguous, and neither is used.
        """
        first, last = m.plain["first"][i], m.plain["first"][i + 1]
        seen = sight(belief.pose(), self.landmark, self.mount.now(belief), MIN_DISTANCE_M)
        if seen is None or first == last:
            return []
        bearing, _, H, by_mount = seen
        columns, H_block = NO_COLUMNS, NO_BLOCK
        if self.mount.free:
            columns, H_block = self.mount.columns(belief), self.mount.rows((by_mount,))
        # the bearing is not linear in the position: second-order variance (sigma_position / distance)^4
        bearing_variance = belief.variance((H[0], H[1], 0.0))
        z, variances = m.scalars
        judged = []
        for row in range(first, last):
            y, R = wrap(z[row] - bearing), ((variances[row] + bearing_variance * bearing_variance,),)
            judged.append(belief.compare(row, (y,), (H,), R, self.threshold, columns, H_block))
        return choose(judged)


class OrientationModel(Model):
    """The paper's camera model: z is the robot's heading theta, H = [0 0 1].

    The landmark's direction is computed once, from the belief at the first picture. The largest candidate counts
    as the landmark.
    """

    def __init__(self, settings: CameraSettings, landmark: Point) -> None:
        self.landmark = landmark
        self.yaw = math.radians(settings.yaw_deg)
        self.threshold = chi_square(settings.gate, 1)
        self.direction: float | None = None  # rad, map frame

    def innovations(self, m: Measurements, i: int, belief: Belief) -> list[Innovation]:
        """Return the innovation of the heading computed from the largest candidate of picture i."""
        if self.direction is None:
            self.direction = math.atan2(self.landmark[1] - belief.y, self.landmark[0] - belief.x)
        row = m.plain["first"][i]
        if row == m.plain["first"][i + 1]:
            return []
        z, variances = m.scalars
        y = wrap(self.direction - (z[row] + self.yaw) - belief.theta)  # gamma_k of eq. 16 less theta
        return choose([belief.compare(row, (y,), H_ORIENTATION, ((variances[row],),), self.threshold)])


def choose(judged: list[Innovation]) -> list[Innovation]:
    """Set the verdict of every candidate of one picture and sort them by NIS; at most one is accepted.

    Accepted: the smallest NIS, if it is within the gate and every other NIS within the gate is larger by at least
    MIN_CANDIDATE_MARGIN.
    """
    by_nis = attrgetter("nis")
    best = min(judged, key=by_nis)
    gate, others = best.threshold, [s for s in judged if s is not best]
    best.verdict = RowVerdict.ACCEPTED if best.nis <= gate else RowVerdict.GATE
    second = min(others, key=by_nis).nis if others else math.inf
    if best.verdict == RowVerdict.ACCEPTED and second <= min(gate, best.nis + MIN_CANDIDATE_MARGIN):
        best.verdict = RowVerdict.AMBIGUOUS
    best.landmark = 0
    unsure = best.verdict == RowVerdict.AMBIGUOUS
    for s in others:
        s.verdict = RowVerdict.AMBIGUOUS if unsure and s.nis <= gate else RowVerdict.UNMATCHED
    return [best, *others]
