"""The result of `calibrate`: values, rows of words, and robot.toml."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

import msgspec
import numpy as np

from locfuse.cli.analysis.load import Loaded, find_log, load
from locfuse.cli.analysis.settings import LogOptions, Progress, silent
from locfuse.fusion.chi_square import SIGMAS_95
from locfuse.fusion.data import Array, LocfuseError
from locfuse.fusion.robot import WheelSettings
from locfuse.fusion.sensors.iron import Iron, fit_iron
from locfuse.fusion.sensors.lrf import LrfSettings, laser_of
from locfuse.fusion.sensors.registry import REGISTRY
from locfuse.fusion.streams import MergedStream
from locfuse.fusion.wheels import calibrate_by_scans
from locfuse.fusion.wheels.calibrate import PAPER_PERIOD_S, WheelCalibration, calibrate_wheels
from locfuse.fusion.wheels.calibrate_by_gyro import GyroCalibration, calibrate_by_gyro
from locfuse.fusion.wheels.calibrate_by_scans import LaserCalibration, Motion
from locfuse.fusion.wheels.calibrate_tricycle import Reference, TricycleCalibration, calibrate_tricycle, of_truth
from locfuse.fusion.wheels.likelihood import Figure
from locfuse.fusion.wheels.motion_by_scans import match_scans
from locfuse.fusion.wheels.steered import is_tricycle, read_encoders

from .found import Found, Row, refuse_doubtful

USED = ("compass", "gyro", "lrf")  # sensors
FIELD = "sensor_msgs/msg/MagneticField"
ODOMETRY = "nav_msgs/msg/Odometry"
CALIBRATED = ("wheel scale", "radius", "track", "iron", "yaw")  # findings that calibrating sets right
MIN_LN_RATIO = 3.0  # ln of a likelihood ratio that is worth saying (20 to 1)
IRON_COLUMNS = {
    "hard_iron": "hard",
    "hard_iron_sigma": "hard_sigma",
    "soft_iron": "soft",
    "soft_iron_sigma": "soft_sigma",
}
DEFAULT = LogOptions()
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
    """Calibration by wheels and laser."""

    fit: LaserCalibration
    was: LrfSettings

    def mount(self) -> dict[str, Figure]:
        """Return the laser's mount and clock by the keys of [lrf], if the drives show them."""
        unit = np.array([1.0, 1.0, math.degrees(1.0), 1.0])
        offset = np.array([0.0, 0.0, 0.0, self.was.time_offset])
        values = (self.fit.parameters[3:] * unit + offset).tolist()
        half = (SIGMAS_95 * self.fit.sigmas[3:] * unit).tolist()
        found = zip(KEYS, values, half, strict=True)
        return {key: Figure(v, v - h, v + h) for key, v, h in found if math.isfinite(h)}

    def notes(self, settings: WheelSettings) -> list[str]:
        """Return notes: how much was seen, what it does not show, and which sensor defines the distance scale."""
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


class Calibration(Found, frozen=True, kw_only=True):
    """The calibration of all logs."""

    settings: WheelSettings  # as they were
    wheels: WheelCalibration | None = None
    laser: ByLaser | None = None  # where no truth tells of the wheels
    gyro: GyroCalibration | None = None  # tells the track and the ratio where nothing else does as well
    iron: Iron | None = None
    tricycle: TricycleCalibration | None = None  # where two encoders are the wheels

    command: ClassVar[str] = "calibrate"
    titles: ClassVar[Row] = ("setting", "found", "95 % interval", "was")

    def relative(self) -> tuple[Array, Array] | None:
        """Return mean scale, scale difference and track (0: as configured), and sigmas (NaN: unknown), (3,)."""
        found = self.wheels or (self.laser and self.laser.fit) or self.gyro
        if found is None:
            return None
        parameters, sigmas = found.parameters[:3].copy(), found.sigmas[:3].copy()
        if self.gyro is not None:  # in the metre that the others found
            by_gyro = self.gyro.parameters * (1.0, 1.0, 1.0 + parameters[0])
            by_gyro[2] += parameters[0]
            better = ~(sigmas <= self.gyro.sigmas) & np.isfinite(self.gyro.sigmas)
            parameters, sigmas = np.where(better, by_gyro, parameters), np.where(better, self.gyro.sigmas, sigmas)
        return parameters, sigmas

    def geometry(self) -> dict[str, Figure]:
        """Return radius, ratio and track with their intervals, if the logs show them."""
        old, found = self.settings, self.relative()
        if found is None or old.radius is None or old.track is None:
            return {}
        parameters, sigmas = found
        mean, difference, track = parameters.tolist()
        left, right = mean - 0.5 * difference, mean + 0.5 * difference
        share_left, share_right = (s * (1.0 + p) for s, p in zip(old.shares, (left, right), strict=True))
        values = {
            "radius": old.radius * 0.5 * (share_left + share_right),
            "ratio": share_right / share_left,
            "track": old.track * (1.0 + track),
        }
        spread = dict(zip(values, (SIGMAS_95 * sigmas * np.array(list(values.values()))).tolist(), strict=True))
        return {
            key: Figure(value, value - spread[key], value + spread[key])
            for key, value in values.items()
            if math.isfinite(spread[key])
        }

    def tables(self) -> dict[str, dict[str, Any]]:
        """Return the results as robot.toml tables, without geometry that may be as configured."""
        noise = self.wheels or self.gyro
        of_wheels = {} if noise is None else {"noise": noise.k}
        found = {"wheels": of_wheels | _changed(self.geometry(), self.settings)}
        if self.laser is not None:
            found["lrf"] = _changed(self.laser.mount(), self.laser.was)
        if self.tricycle is not None:
            found |= {"wheels": self.tricycle.wheels, self.tricycle.by: self.tricycle.mount}
        tables: dict[str, dict[str, Any]] = {
            n: {key: _short(f.value) for key, f in figures.items()} for n, figures in found.items() if figures
        }
        if self.iron is not None:
            tables["compass"] = {
                "hard_iron": [_short(v) for v in self.iron.hard.tolist()],
                "soft_iron": [_short(v) for v in self.iron.soft.ravel().tolist()],
            }
        return tables

    def values(self) -> dict[str, Any]:
        """Return all results as plain values for --json: SI units, null for unknown ones."""
        geometry = self.geometry()
        found: dict[str, Any] = dict.fromkeys(("wheels", "laser", "gyro", "compass", "tricycle"))
        if (wheels := self.wheels) is not None:
            found["wheels"] = {
                **_plain({"noise_m": wheels.k, "delta": wheels.delta, **geometry}),
                "delta_period_s": PAPER_PERIOD_S,
                "ln_likelihood_noise_over_delta": wheels.prefers_k,
                "straight_pieces": wheels.pieces["straight"],
                "turn_pieces": wheels.pieces["turn"],
                "straight_m": wheels.straight_m,
                "turned_deg": math.degrees(wheels.turned_rad),
                "outliers": wheels.outliers,
            }
        if (laser := self.laser) is not None:
            found["laser"] = {
                **_plain({**geometry, **laser.mount()}),
                "pieces": laser.fit.intervals,
                "way_m": laser.fit.way_m,
                "turned_deg": math.degrees(laser.fit.turned_rad),
                "outliers": laser.fit.outliers,
            }
        if (gyro := self.gyro) is not None:
            found["gyro"] = {
                **_plain({"noise_m": gyro.k, **geometry}),
                "noise_by_window_m": {f"{length:g}": k for length, k in gyro.noise.items()},
                "time_offset_s": gyro.delay,
                "turned_deg": math.degrees(gyro.turned_rad),
                "windows": gyro.windows,
            }
        if (iron := self.iron) is not None:
            found["compass"] = {
                **{key: getattr(iron, which).ravel().tolist() for key, which in IRON_COLUMNS.items()},
                "strength": iron.strength,
                "scatter_deg": math.degrees(iron.scatter),
                "error_before_deg": iron.error_before_deg,
                "gap_deg": iron.gap_deg,
                "readings": iron.readings,
            }
        if (tricycle := self.tricycle) is not None:
            mount = {f"{tricycle.by}_{key}": figure for key, figure in tricycle.mount.items()}
            rest = {"rms_deg": math.degrees(tricycle.rms)} if tricycle.by == "gyro" else {"rms_m": tricycle.rms}
            found["tricycle"] = {**_plain({**tricycle.wheels, **mount}), "by": tricycle.by, **rest}
        return {**found, "robot": self.tables(), "notes": list(self.notes)}

    def rows(self) -> list[Row]:
        """Return (setting, value, interval, previous value) in words."""
        rows: list[Row] = []
        if (noise := self.wheels or self.gyro) is not None:
            rows.append(_row("wheels.noise [m]", noise.k, self.settings.noise))
        for key, figure in self.geometry().items():
            unit = "" if key == "ratio" else " [m]"
            rows.append(_row(f"wheels.{key}{unit}", figure, getattr(self.settings, key)))
        if self.laser is not None:
            of_laser, was = self.laser.mount().items(), self.laser.was
            rows += [_row(f"lrf.{key}{KEYS[key]}", figure, getattr(was, key)) for key, figure in of_laser]
        if self.wheels is not None:
            rows.append(_row(f"paper's delta ({PAPER_PERIOD_S:g} s)", self.wheels.delta, None))
        if self.tricycle is not None:
            of_wheels = self.tricycle.wheels.items()
            rows += [_row(f"wheels.{key}", f, getattr(self.settings, key)) for key, f in of_wheels]
            rows += [_row(f"{self.tricycle.by}.{key}", f, None) for key, f in self.tricycle.mount.items()]
        if self.iron is not None:
            rows += _iron_rows(self.iron)
        return rows


def calibrated(logs: Sequence[Sequence[str]], how: LogOptions, progress: Progress) -> Calibration:
    """Read logs by command-line words, and calibrate what they allow."""
    loaded = [load(find_log(parts), how, progress, only=USED, aside=("lrf",)) for parts in logs]
    progress("calibrating")
    return calibrate_logs(loaded, progress, how)


def calibrate_logs(
    loaded: Sequence[Loaded], progress: Progress = silent, how: LogOptions = DEFAULT
) -> Calibration:
    """Calibrate what the logs of one robot allow. Raises LocfuseError where they allow nothing."""
    settings = _one_robot(loaded)
    if is_tricycle(loaded[0].stream("wheels")):
        return _tricycle(loaded, settings, progress, how)
    for one in loaded:
        refuse_doubtful(one, "what is calibrated now", CALIBRATED)
    notes: list[str] = []
    wheels = _try(lambda: _wheels(loaded), notes)
    laser = None if wheels is not None else _try(lambda: by_laser(loaded, settings, progress), notes)
    gyro = None if laser is not None else _try(lambda: _gyro(loaded, settings), notes)
    iron = _try(lambda: fit_iron(fields(loaded)), notes)
    if wheels is None and laser is None and gyro is None and iron is None:
        raise LocfuseError("; ".join(notes))
    if wheels is not None:
        notes += _wheel_notes(wheels, settings, gyro)
    if gyro is not None:
        notes += _gyro_notes(gyro, settings)
    if laser is not None:
        notes += laser.notes(settings)
    if iron is not None:
        notes.append(
            f"compass: iron bends the raw headings by {iron.error_before_deg:.1f} degrees (rms over a turn); the "
            f"field scatters by {math.degrees(iron.scatter):.2f} degrees about the fit"
        )
    found = Calibration(
        loaded=loaded, how=how, settings=settings, wheels=wheels, laser=laser, gyro=gyro, iron=iron
    )
    geometry = found.geometry()
    changed = _changed(geometry, settings)
    if kept := [key for key in geometry if key not in changed]:
        notes.append(f"wheels: {', '.join(kept)} left as set: inside the interval, so nothing speaks against it")
    return msgspec.structs.replace(found, notes=tuple(notes))


def fields(loaded: Sequence[Loaded]) -> Array:
    """Return the raw field readings (n, 2) of all logs. Raises LocfuseError if no log has any."""
    found = [np.zeros((0, 2))]
    for one in loaded:
        topic = one.choice.topics.get("compass")
        if topic is not None and one.log.topics[topic].msgtype == FIELD:
            columns = one.log.stream(topic, one.robot.order).columns("magnetic_field.x", "magnetic_field.y")
            found.append(np.stack([np.asarray(c, np.float64) for c in columns.values()], axis=-1))
    if len(found) == 1:
        raise LocfuseError("no log has a magnetometer (sensor_msgs/MagneticField)", role="compass")
    return np.concatenate(found)


def _one_robot(loaded: Sequence[Loaded]) -> WheelSettings:
    """Return the wheel settings; logs of robots with different wheels cannot be calibrated together."""
    first = loaded[0].robot.wheels
    if any(one.log.topics[one.choice.topics["wheels"]].msgtype == ODOMETRY for one in loaded):
        return msgspec.structs.replace(first, radius=None)  # an odometry has no wheels to correct
    for one in loaded[1:]:
        for key in ("radius", "ratio", "track"):
            a, b = getattr(first, key), getattr(one.robot.wheels, key)
            if a != b:
                raise LocfuseError(
                    f"wheels.{key} is {a} in {loaded[0].log.name} and {b} in {one.log.name}: these are different "
                    "robots;",
                    role="calibrate",
                    hint=f"give one with --set wheels.{key}=",
                )
    return first


def _wheels(loaded: Sequence[Loaded]) -> WheelCalibration:
    drives = [one.drive for one in loaded if one.drive.truth is not None]
    if not drives:
        names = ", ".join(one.log.name for one in loaded)
        raise LocfuseError(
            f"no truth in {names} to compare the wheels with",
            role="wheels",
            hint="(--set truth.topic=/TOPIC names it)",
        )
    return calibrate_wheels(drives)


def _tricycle(
    loaded: Sequence[Loaded], settings: WheelSettings, progress: Progress, how: LogOptions
) -> Calibration:
    """Calibrate the encoders of a steered wheel by the truth of one drive, else its laser, else its gyro."""
    one, stream = loaded[0], loaded[0].stream("wheels")
    reference = None if len(loaded) > 1 else _reference(one, progress)
    if reference is None or not isinstance(stream, MergedStream):
        raise LocfuseError(
            "a steered tricycle is calibrated by one log with truth, laser or gyro",
            role="calibrate",
            hint="(--set truth.topic=/TOPIC names a truth)",
        )
    encoders = read_encoders(stream, settings)
    shift = (encoders.zero_ns - one.drive.epoch_ns) * 1e-9 + settings.time_offset
    found = calibrate_tricycle(encoders, settings, reference, shift)
    if found.by == "lrf":  # what is not surely another mount or clock is left as it was set
        was = one.robot.settings("lrf")
        late = Figure(*(v + was.time_offset for v in msgspec.structs.astuple(found.mount["time_offset"])))
        found = msgspec.structs.replace(found, mount=_changed({**found.mount, "time_offset": late}, was))
    left = {
        "truth": f"fitted to the whole path, they leave {found.rms:.3f} m (rms)",
        "lrf": f"fitted to the laser's way over a second, they leave {found.rms:.3f} m (rms)",
        "gyro": f"fitted to the gyro's turns over a second, they leave {math.degrees(found.rms):.2f} degrees "
        "(rms); a gyro knows no lengths: the radius is left as it was set",
    }
    notes = (f"tricycle: {', '.join((*found.wheels, *found.mount))}: {left[found.by]}",)
    return Calibration(loaded=loaded, how=how, settings=settings, notes=notes, tricycle=found)


def _reference(one: Loaded, progress: Progress) -> Reference | None:
    """Return the reference for the encoders of a tricycle; None if the log has none."""
    if one.drive.truth is not None:
        return of_truth(one.drive.truth)
    if has_both(one):
        progress("matching scans")
        motion = motion_of_both(one)
        return Reference("lrf", motion.laser.t + motion.delay, motion.laser.pose)
    m = one.drive.measurements.get("gyro")
    if m is None or len(m.t) < 2:
        return None
    t, heading = REGISTRY["gyro"].heading(m) or (np.zeros(0), np.zeros(0))
    return Reference("gyro", t, np.column_stack((np.zeros((len(t), 2)), heading)))


def _gyro(loaded: Sequence[Loaded], settings: WheelSettings) -> GyroCalibration:
    sensor, drives = REGISTRY["gyro"], []
    for one in loaded:
        m = one.drive.measurements.get("gyro")
        heading = None if m is None or len(m.t) < 2 else sensor.heading(m)
        if heading is not None:
            drives.append((one.drive.wheels, *heading))
    if not drives or settings.radius is None:
        raise LocfuseError("no log has a gyro beside wheels whose radius and track are set", role="gyro")
    told = loaded[0].robot.settings("gyro")
    return calibrate_by_gyro(drives, told.sigma_scale, math.radians(told.sigma_deg))


def _gyro_notes(found: GyroCalibration, settings: WheelSettings) -> list[str]:
    by_window = ", ".join(f"{k:.2g} m over {length:g} s" for length, k in found.noise.items())
    track = (settings.track or 0.0) + 2.0 * found.slides
    skids = (
        f"wheels: the robot turns as if its wheels were {track:.2f} m apart: they slide by {found.slides:.2f} m "
        "per radian of turn. A gyro does not see what both sides slide in the same direction: wheels.noise "
        "assumes from zero to twice that"
    )
    return [
        *([skids] if found.slides else []),
        f"gyro: {found.windows} windows, {math.degrees(found.turned_rad):.0f} degrees, its clock shifted by "
        f"{found.delay:+.2f} s; it knows no lengths: the radius is left as it was set",
        f"wheels: noise by the length of the window: {by_window}; that of the longest is written",
    ]


def _try(find: Any, notes: list[str]) -> Any:
    """Return the result of `find`, or note why it failed."""
    try:
        return find()
    except LocfuseError as problem:
        notes.append(str(problem))
        return None


def _wheel_notes(
    found: WheelCalibration, settings: WheelSettings, gyro: GyroCalibration | None = None
) -> list[str]:
    pieces = ", ".join(
        f"{n} pieces of {what}"
        for n, what in (
            (found.pieces["straight"], f"straight runs ({found.straight_m:.1f} m)"),
            (found.pieces["turn"], f"turns on the spot ({math.degrees(found.turned_rad):.0f} degrees)"),
        )
        if n
    )
    notes = [f"wheels: {pieces}"]
    if found.outliers:
        notes.append(
            f"wheels: {found.outliers} pieces do not fit the others (slip, or a jump of the truth): not used"
        )
    if settings.radius is not None:
        by_gyro = () if gyro is None else ("ratio", "track")
        sigmas = zip(("radius", "ratio", "track"), found.sigmas.tolist(), strict=True)
        untold = [n for n, s in sigmas if math.isnan(s) and n not in by_gyro]
        lacking = {"radius": "straight runs", "ratio": "a truth with heading", "track": "turns on the spot"}
        notes += [
            f"wheels: {name} cannot be told without {lacking[name]}; it is taken as given" for name in untold
        ]
    if abs(found.prefers_k) > MIN_LN_RATIO:
        better, worse = ("noise per metre", "the paper's delta")[:: 1 if found.prefers_k > 0 else -1]
        notes.append(
            f"wheels: {better} explains these drives better than {worse} "
            f"(ln of the likelihoods' ratio: {abs(found.prefers_k):.1f})"
        )
    return notes


def _iron_rows(iron: Iron) -> list[Row]:
    rows = []
    for name, values, sigmas in (("hard", iron.hard, iron.hard_sigma), ("soft", iron.soft, iron.soft_sigma)):
        where = ("x", "y") if name == "hard" else ("xx", "xy", "yx", "yy")
        for axis, value, sigma in zip(where, values.ravel().tolist(), sigmas.ravel().tolist(), strict=True):
            figure = Figure(value, value - SIGMAS_95 * sigma, value + SIGMAS_95 * sigma)
            rows.append(_row(f"compass.{name}_iron {axis}", figure, None))
    return rows


def _row(name: str, figure: Figure, was: float | None) -> Row:
    interval = f"{figure.low:.4g} .. {figure.high:.4g}"
    return name, f"{figure.value:.4g}", interval, "" if was is None else f"{was:.4g}"


def _changed(figures: Mapping[str, Figure], was: Any) -> dict[str, Figure]:
    """Return the figures whose interval excludes the configured value; the others should stay as configured."""
    return {key: f for key, f in figures.items() if not f.low <= getattr(was, key) <= f.high}


def _short(value: float) -> float:
    """Return a number with six digits, since more is noise."""
    return float(f"{value:.6g}")


def _plain(figures: Mapping[str, Figure]) -> dict[str, dict[str, float]]:
    return {name: msgspec.structs.asdict(figure) for name, figure in figures.items()}


def _sigma(fit: LaserCalibration, name: str) -> str:
    sigma = float(fit.sigmas[calibrate_by_scans.NAMES.index(name)])
    return f"{sigma:.3f}" if math.isfinite(sigma) else "not told"


def by_laser(loaded: Sequence[Loaded], settings: WheelSettings, progress: Progress) -> ByLaser:
    """Compare wheels and laser of all logs with both. Raises LocfuseError if none has both or shows enough."""
    both = [one for one in loaded if has_both(one)]
    if not both:
        names = ", ".join(one.log.name for one in loaded)
        raise LocfuseError(f"no wheels and laser together in {names}", role="laser")
    progress("matching scans")
    return ByLaser(
        calibrate_by_scans.calibrate([motion_of_both(one) for one in both]), both[0].robot.settings("lrf")
    )


def has_both(one: Loaded) -> bool:
    """Return whether a log has wheels and a laser."""
    return "lrf" in one.choice.topics and one.drive.wheels.matched is None  # else the motion is the laser's own


def motion_of_both(one: Loaded) -> Motion:
    """Return the motion of wheels and laser in one log, the laser's in its own frame."""
    lrf: Any = one.robot.settings("lrf")
    stream = one.log.stream(one.choice.topics["lrf"], one.robot.order)
    laser = laser_of(lrf)._replace(mount=np.zeros(3))
    found = match_scans(stream, laser).reading(WheelSettings(), lrf.time_offset)
    return Motion(one.drive.wheels, found.wheels, (found.epoch_ns - one.drive.epoch_ns) * 1e-9)
