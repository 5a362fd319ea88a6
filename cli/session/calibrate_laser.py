"""Wheels and laser mount from wheels and laser, without truth: what `calibrate` reads, and what it says of it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import msgspec
import numpy as np

from locfuse.cli.analysis.load import Loaded
from locfuse.cli.analysis.settings import Progress
from locfuse.fusion.data import Array, LocfuseError
from locfuse.fusion.robot import WheelSettings
from locfuse.fusion.sensors.lrf import LrfSettings, laser_of
from locfuse.fusion.wheels.calibrate_by_scans import NAMES, LaserCalibration, Motion, calibrate
from locfuse.fusion.wheels.likelihood import Figure
from locfuse.fusion.wheels.motion_by_scans import match_scans

SIGMAS_95 = 1.96  # standard deviations of a 95 % interval
KEYS = {"x": " [m]", "y": " [m]", "yaw_deg": " [deg]", "time_offset": " [s]"}
LACKING = {
    "scale": ("wheels: radius", "way"),
    "difference": ("wheels: ratio", "straight runs beside turns"),
    "track": ("wheels: track", "turns"),
    "x": ("lrf: x", "turns"),
    "y": ("lrf: y", "turns"),
    "yaw": ("lrf: yaw_deg", "straight runs"),
    "delay": ("lrf: time_offset", "changes of speed"),
}


class ByLaser(msgspec.Struct, frozen=True):
    """What wheels and laser say of each other."""

    fit: LaserCalibration
    was: LrfSettings

    @property
    def parameters(self) -> Array:
        """Of NAMES, (7,)."""
        return self.fit.parameters

    @property
    def sigmas(self) -> Array:
        """Of NAMES, (7,): NaN where the drives cannot tell."""
        return self.fit.sigmas

    def mount(self) -> dict[str, Figure]:
        """Return the laser's mount and clock by the keys of [lrf], those that the drives can tell."""
        unit = np.array([1.0, 1.0, math.degrees(1.0), 1.0])
        offset = np.array([0.0, 0.0, 0.0, self.was.time_offset])
        values = (self.fit.parameters[3:] * unit + offset).tolist()
        half = (SIGMAS_95 * self.fit.sigmas[3:] * unit).tolist()
        found = zip(KEYS, values, half, strict=True)
        return {key: Figure(v, v - h, v + h) for key, v, h in found if math.isfinite(h)}

    def mount_rows(self) -> list[tuple[str, Figure, str, float]]:
        """Return (key, figure, unit, what it was)."""
        return [(key, figure, KEYS[key], getattr(self.was, key)) for key, figure in self.mount().items()]

    def table(self) -> dict[str, float]:
        """Return the keys of [lrf] that are surely not what was set."""
        return {
            key: figure.value for key, figure, _, was in self.mount_rows() if not figure.low <= was <= figure.high
        }

    def notes(self, settings: WheelSettings) -> list[str]:
        """Return what a reader must know: how much was seen, what it cannot tell, and whose metre counts."""
        fit = self.fit
        notes = [
            f"laser: {fit.intervals} pieces of way by wheels and laser ({fit.way_m:.1f} m, "
            f"{math.degrees(fit.turned_rad):.0f} degrees); the laser's metre is taken for the right one "
            "(lrf.range_scale)"
        ]
        if fit.outliers:
            notes.append(f"laser: {fit.outliers} pieces do not fit the others (slip, or a wrong match): not used")
        untold = set(fit.untold())
        odometry = settings.radius is None or settings.track is None
        untold -= {"scale", "difference", "track"} if odometry else set()
        notes += [
            f"{what} cannot be told without {needs}; it is left as it is"
            for name, (what, needs) in LACKING.items()
            if name in untold
        ]
        if odometry:
            scale, _, track = (1.0 + fit.parameters[:3]).tolist()
            notes.append(
                f"wheels: the odometry measures {1.0 / scale:.3f} of the laser's distances (1 sigma "
                f"{_sigma(fit, 'scale')}) and {track / scale:.3f} of its turns ({_sigma(fit, 'track')})"
            )
        return notes


def _sigma(fit: LaserCalibration, name: str) -> str:
    sigma = float(fit.sigmas[NAMES.index(name)])
    return f"{sigma:.3f}" if math.isfinite(sigma) else "not told"


def by_laser(loaded: Sequence[Loaded], settings: WheelSettings, progress: Progress) -> ByLaser:
    """Compare wheels and laser of all logs that have both. Raises LocfuseError where none has, or none tells."""
    both = [one for one in loaded if has_both(one)]
    if not both:
        names = ", ".join(one.log.name for one in loaded)
        raise LocfuseError(f"no wheels and laser together in {names}", role="laser")
    progress("matching scans")
    return ByLaser(calibrate([motion_of_both(one) for one in both]), both[0].robot.settings("lrf"))


def has_both(one: Loaded) -> bool:
    """Return whether a log has wheels and a laser beside them."""
    return "lrf" in one.choice.topics and one.drive.wheels.matched is None  # else the motion is the laser's own


def motion_of_both(one: Loaded) -> Motion:
    """Return how the wheels and the laser of one log moved; the laser in a frame of its own."""
    lrf: Any = one.robot.settings("lrf")
    stream = one.log.stream(one.choice.topics["lrf"], one.robot.order)
    laser = laser_of(lrf)._replace(mount=np.zeros(3))
    found = match_scans(stream, laser).reading(WheelSettings(), lrf.time_offset)
    return Motion(one.drive.wheels, found.wheels, (found.epoch_ns - one.drive.epoch_ns) * 1e-9)
