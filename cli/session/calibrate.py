"""Calibration of wheels, laser mount and compass iron: values, rows of a table, and robot.toml."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from itertools import product
from typing import Any, ClassVar, NamedTuple, TypeVar

import numpy as np
from msgspec.structs import asdict, astuple, replace

from locfuse.cli.analysis.load import Loaded, Parts, load
from locfuse.cli.analysis.settings import LogOptions, Progress
from locfuse.formats.columns import nested
from locfuse.fusion.checks.turning import RATIO, SURE_RATIO, TRACK
from locfuse.fusion.data import Array, LocfuseError
from locfuse.fusion.robot import WheelSettings
from locfuse.fusion.sensors.lrf import laser_of
from locfuse.fusion.sensors.magnetic import FIELD, Iron, fit_iron
from locfuse.fusion.sensors.registry import REGISTRY
from locfuse.fusion.statistics import SIGMAS_95
from locfuse.fusion.streams import MergedStream
from locfuse.fusion.wheels.calibrate import PAPER_PERIOD_S, Figure, WheelCalibration, calibrate_wheels
from locfuse.fusion.wheels.calibrate_tricycle import (
    ReferenceMotion,
    TricycleCalibration,
    calibrate_tricycle,
    of_truth,
)
from locfuse.fusion.wheels.calibrate_without_truth import (
    GyroCalibration,
    LaserCalibration,
    ScanMotions,
    calibrate_by_gyro,
    calibrate_by_scans,
)
from locfuse.fusion.wheels.motion_by_scans import match_scans
from locfuse.fusion.wheels.odometry import ODOMETRY
from locfuse.fusion.wheels.steered import is_tricycle, read_encoders

from .found import Found, Row, refuse_doubtful

T = TypeVar("T")
SENSORS = ("compass", "gyro", "lrf")  # whose topics calibration uses
# codes of findings that calibration fixes
FIXED_CODES = ("wheel scale", "radius", RATIO, SURE_RATIO, TRACK, "iron", "yaw")
GEOMETRY = ("radius", "ratio", "track")
MIN_LN_RATIO = 3.0  # smallest ln of a likelihood ratio that is reported: 20 to 1
IRON_COLUMNS = {f"{kind}_iron{of}": f"{kind}{of}" for kind in ("hard", "soft") for of in ("", "_sigma")}
MOUNT = ("x", "y", "yaw_deg", "time_offset")
UNITS = {**dict.fromkeys(("radius", "track", "x", "y"), " [m]"), "yaw_deg": " [deg]", "time_offset": " [s]"}
LACKING_BY_TRUTH = {"radius": "straight runs", "ratio": "a truth with heading", "track": "turns on the spot"}
LACKING_BY_LASER = {
    "scale": ("wheels: radius", "way"),
    "difference": ("wheels: ratio", "straight runs beside turns"),
    "track": ("wheels: track", "turns"),
    "x": ("lrf: x", "turns"),
    "y": ("lrf: y", "turns"),
    "yaw": ("lrf: yaw_deg", "straight runs"),
    "delay": ("lrf: time_offset", "changes of speed"),
}


class Fitted(NamedTuple):
    """One estimated setting with its 95 % interval and its configured value."""

    key: str  # "wheels.radius"
    figure: Figure
    was: float | None = None  # as configured
    unit: str = ""
    stays: bool = False  # the configured value is kept, since the interval contains it


class Calibration(Found, frozen=True, kw_only=True):
    """All estimates of `calibrate` from the logs of one robot."""

    settings: WheelSettings  # as configured
    wheels: WheelCalibration | None = None  # by truth
    laser: LaserCalibration | None = None  # by scan matching, if truth cannot calibrate the wheels
    gyro: GyroCalibration | None = None  # used for ratio and track where its sigma is smaller
    iron: Iron | None = None
    tricycle: TricycleCalibration | None = None  # of traction and steering encoders

    command: ClassVar[str] = "calibrate"
    titles: ClassVar[Row] = ("setting", "found", "95 % interval", "was")

    def relative(self) -> tuple[Array, Array] | None:
        """Return relative changes (3,) of wheel scale, scale difference and track, and sigmas (3,); NaN: unknown.

        None if neither wheels nor laser nor gyro could be calibrated.
        """
        found = self.wheels or self.laser or self.gyro
        if found is None:
            return None
        parameters, sigmas = found.parameters[:3].copy(), found.sigmas[:3].copy()
        if self.gyro is not None:  # scaled by the wheel scale of the other calibration
            by_gyro = self.gyro.parameters * (1.0, 1.0, 1.0 + parameters[0])
            by_gyro[2] += parameters[0]
            better = ~(sigmas <= self.gyro.sigmas) & np.isfinite(self.gyro.sigmas)
            parameters, sigmas = np.where(better, by_gyro, parameters), np.where(better, self.gyro.sigmas, sigmas)
        return parameters, sigmas

    def geometry(self) -> dict[str, Figure]:
        """Return radius, ratio and track with 95 % intervals; settings that the logs do not show are left out."""
        old, found = self.settings, self.relative()
        if found is None or old.radius is None or old.track is None:
            return {}
        mean, difference, track = found[0].tolist()
        halves = zip(old.shares, (-0.5, 0.5), strict=True)
        left, right = (share * (1.0 + mean + half * difference) for share, half in halves)
        values = np.array([old.radius * 0.5 * (left + right), right / left, old.track * (1.0 + track)])
        return _figures(GEOMETRY, values, found[1] * values)

    def mount(self) -> dict[str, Figure]:
        """Return the laser's mount and time offset by key of [lrf], without values that the logs leave unknown."""
        if self.laser is None:
            return {}
        unit = np.array([1.0, 1.0, math.degrees(1.0), 1.0])
        offset = np.array([0.0, 0.0, 0.0, self._lrf().time_offset])
        return _figures(MOUNT, self.laser.parameters[3:] * unit + offset, self.laser.sigmas[3:] * unit)

    def _lrf(self) -> Any:
        return next(one for one in self.loaded if has_both(one)).robot.settings("lrf")

    def fitted(self) -> list[Fitted]:
        """Return all estimated settings of wheels and laser."""
        rows: list[Fitted] = []
        if (noise := self.wheels or self.gyro) is not None:
            rows.append(Fitted("wheels.noise", noise.k, self.settings.noise, " [m]"))
        configured = {"wheels": self.settings, "lrf": self.laser and self._lrf()}
        for table, figures in (("wheels", self.geometry()), ("lrf", self.mount())):
            for key, figure in figures.items():
                was = getattr(configured[table], key)
                stays = figure.low <= was <= figure.high
                rows.append(Fitted(f"{table}.{key}", figure, was, UNITS.get(key, ""), stays))
        if (tricycle := self.tricycle) is not None:
            rows += [Fitted(f"wheels.{k}", f, getattr(self.settings, k)) for k, f in tricycle.wheels.items()]
            rows += [Fitted(f"{tricycle.by}.{k}", f) for k, f in tricycle.mount.items()]
        return rows

    def tables(self) -> dict[str, dict[str, Any]]:
        """Return the estimates as tables of robot.toml.

        Wheel and laser settings whose 95 % interval contains the configured value are left out.
        """
        found: dict[str, Any] = {f.key: _short(f.figure.value) for f in self.fitted() if not f.stays}
        if self.iron is not None:
            shape = {"compass.hard_iron": self.iron.hard, "compass.soft_iron": self.iron.soft}
            found |= {key: [_short(v) for v in values.ravel().tolist()] for key, values in shape.items()}
        return nested(found)

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
                **_plain({**geometry, **self.mount()}),
                "pieces": laser.intervals,
                "way_m": laser.distance_m,
                "turned_deg": math.degrees(laser.turned_rad),
                "outliers": laser.outliers,
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
                **{key: getattr(iron, column).ravel().tolist() for key, column in IRON_COLUMNS.items()},
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
        """Return the table's rows as text: setting, value, interval, configured value."""
        shown = self.fitted()
        if self.wheels is not None:
            shown.append(Fitted(f"paper's delta ({PAPER_PERIOD_S:g} s)", self.wheels.delta))
        if (iron := self.iron) is not None:
            for name, axes in (("hard", ("x", "y")), ("soft", ("xx", "xy", "yx", "yy"))):
                values, sigmas = (getattr(iron, column).ravel() for column in (name, f"{name}_sigma"))
                shown += [Fitted(f"compass.{name}_iron {k}", f) for k, f in _figures(axes, values, sigmas).items()]
        return [
            (f"{key}{unit}", f"{f.value:.4g}", f"{f.low:.4g} .. {f.high:.4g}", "" if was is None else f"{was:.4g}")
            for key, f, was, unit, _ in shown
        ]


def _figures(keys: Sequence[str], values: Array, sigmas: Array) -> dict[str, Figure]:
    """Return key -> value with its 95 % interval; keys whose sigma is infinite or NaN are left out."""
    found = zip(keys, values.tolist(), (SIGMAS_95 * sigmas).tolist(), strict=True)
    return {key: Figure(value, value - half, value + half) for key, value, half in found if math.isfinite(half)}


def _short(value: float) -> float:
    """Return a number rounded to six digits, for robot.toml."""
    return float(f"{value:.6g}")


def _plain(figures: Mapping[str, Figure]) -> dict[str, dict[str, float]]:
    return {name: asdict(figure) for name, figure in figures.items()}


def calibrated(logs: Sequence[Parts], how: LogOptions, progress: Progress) -> Calibration:
    """Load the logs given as command-line words, and calibrate wheels, laser mount and compass iron from them."""
    loaded = [load(parts, how, progress, only=SENSORS, aside=("lrf",)) for parts in logs]
    progress("calibrating")
    return calibrate_logs(loaded, progress)


def calibrate_logs(loaded: Sequence[Loaded], progress: Progress) -> Calibration:
    """Estimate wheel settings, laser mount and compass iron from the logs of one robot, if they are observable.

    Raises LocfuseError if nothing can be estimated, a log has a severe fault, or the wheel settings differ.
    """
    settings = _one_robot(loaded)
    if is_tricycle(loaded[0].stream("wheels")):
        return _tricycle(loaded, settings, progress)
    for one in loaded:
        refuse_doubtful(one, "what is calibrated now", FIXED_CODES)
    notes: list[str] = []

    def attempt(find: Callable[[], T]) -> T | None:
        try:
            return find()
        except LocfuseError as problem:
            notes.append(str(problem))
            return None

    wheels = attempt(lambda: _wheels(loaded))
    laser = None if wheels else attempt(lambda: _by_laser(loaded, progress))
    gyro = None if laser else attempt(lambda: _gyro(loaded, settings))
    iron = attempt(lambda: fit_iron(_fields(loaded)))
    if not (wheels or laser or gyro or iron):
        raise LocfuseError("; ".join(notes))
    notes += _wheel_notes(wheels, settings, by_gyro=gyro is not None) if wheels else []
    notes += _gyro_notes(gyro, settings) if gyro else []
    notes += _laser_notes(laser, settings) if laser else []
    if iron:
        notes.append(
            f"compass: iron bends the raw headings by {iron.error_before_deg:.1f} degrees (rms over a turn); the "
            f"field scatters by {math.degrees(iron.scatter):.2f} degrees about the fit"
        )
    found = Calibration(loaded=loaded, settings=settings, wheels=wheels, laser=laser, gyro=gyro, iron=iron)
    stays = [f.key.removeprefix("wheels.") for f in found.fitted() if f.stays and f.key.startswith("wheels.")]
    if stays:
        notes.append(f"wheels: {', '.join(stays)} left as set: inside the interval, so nothing speaks against it")
    return replace(found, notes=tuple(notes))


def _fields(loaded: Sequence[Loaded]) -> Array:
    """Return the raw magnetometer readings x, y (n, 2) of all logs. Raises LocfuseError if no log has any."""
    found = []
    for one in loaded:
        topic = one.choice.topics.get("compass")
        if topic is not None and one.log.topics[topic].msgtype == FIELD:
            columns = one.log.stream(topic, one.robot.order).columns("magnetic_field.x", "magnetic_field.y")
            found.append(np.stack([np.asarray(c, np.float64) for c in columns.values()], axis=-1))
    if not found:
        raise LocfuseError("no log has a magnetometer (sensor_msgs/MagneticField)", role="compass")
    return np.concatenate(found)


def _one_robot(loaded: Sequence[Loaded]) -> WheelSettings:
    """Return the wheel settings shared by all logs. Raises LocfuseError if they differ."""
    first = loaded[0].robot.wheels
    if any(one.log.topics[one.choice.topics["wheels"]].msgtype == ODOMETRY for one in loaded):
        return replace(first, radius=None)  # a robot with an odometry topic has no wheel radius to correct
    for one, key in product(loaded[1:], GEOMETRY):
        a, b = getattr(first, key), getattr(one.robot.wheels, key)
        if a != b:
            words = f"wheels.{key} is {a} in {loaded[0].log.name} and {b} in {one.log.name}: different robots;"
            raise LocfuseError(words, role="calibrate", hint=f"give one with --set wheels.{key}=")
    return first


def _wheels(loaded: Sequence[Loaded]) -> WheelCalibration:
    drives = [one.drive for one in loaded if one.drive.truth is not None]
    if not drives:
        names = ", ".join(one.log.name for one in loaded)
        hint = "(--set truth.topic=/TOPIC names it)"
        raise LocfuseError(f"no truth in {names} to compare the wheels with", role="wheels", hint=hint)
    return calibrate_wheels(drives)


def _wheel_notes(found: WheelCalibration, settings: WheelSettings, by_gyro: bool) -> list[str]:
    degrees = f"{math.degrees(found.turned_rad):.0f} degrees"
    pieces = {"straight": f"straight runs ({found.straight_m:.1f} m)", "turn": f"turns on the spot ({degrees})"}
    used = (f"{n} pieces of {what}" for kind, what in pieces.items() if (n := found.pieces[kind]))
    notes = [f"wheels: {', '.join(used)}"]
    if found.outliers:
        words = "pieces do not fit the others (slip, or a jump of the truth): not used"
        notes.append(f"wheels: {found.outliers} {words}")
    for (name, lacking), sigma in zip(LACKING_BY_TRUTH.items(), found.sigmas.tolist(), strict=True):
        known = math.isfinite(sigma) or (by_gyro and name != "radius")
        if settings.radius is not None and not known:
            notes.append(f"wheels: {name} cannot be estimated without {lacking}; it is taken as given")
    if abs(found.prefers_k) > MIN_LN_RATIO:
        better, worse = ("noise per metre", "the paper's delta")[:: 1 if found.prefers_k > 0 else -1]
        ratio = f"ln of the likelihoods' ratio: {abs(found.prefers_k):.1f}"
        notes.append(f"wheels: {better} explains these drives better than {worse} ({ratio})")
    return notes


def _tricycle(loaded: Sequence[Loaded], settings: WheelSettings, progress: Progress) -> Calibration:
    """Calibrate a tricycle's traction and steering encoders by one log: its truth, else laser, else gyro."""
    one, stream = loaded[0], loaded[0].stream("wheels")
    reference = None if len(loaded) > 1 else _reference(one, progress)
    if reference is None or not isinstance(stream, MergedStream):
        words = "a steered tricycle is calibrated by one log with truth, laser or gyro"
        raise LocfuseError(words, role="calibrate", hint="(--set truth.topic=/TOPIC names a truth)")
    encoders = read_encoders(stream, settings)
    shift = (encoders.zero_ns - one.drive.epoch_ns) * 1e-9 + settings.time_offset
    found = calibrate_tricycle(encoders, settings, reference, shift)
    if found.by == "lrf":  # leave out values whose interval has the configured one
        was = one.robot.settings("lrf")
        late = Figure(*(v + was.time_offset for v in astuple(found.mount["time_offset"])))
        mount = {**found.mount, "time_offset": late}
        found = replace(found, mount={k: f for k, f in mount.items() if not f.low <= getattr(was, k) <= f.high})
    left = {
        "truth": f"fitted to the path{found.left_out}, they leave {found.rms:.3f} m (rms)",
        "lrf": f"fitted to the laser's way over a second, they leave {found.rms:.3f} m (rms)",
        "gyro": f"fitted to the gyro's turns over a second, they leave {math.degrees(found.rms):.2f} degrees "
        "(rms); a gyro knows no lengths: the radius is left as it was set",
    }
    notes = (f"tricycle: {', '.join((*found.wheels, *found.mount))}: {left[found.by]}",)
    return Calibration(loaded=loaded, settings=settings, notes=notes, tricycle=found)


def _reference(one: Loaded, progress: Progress) -> ReferenceMotion | None:
    """Return the reference path for a tricycle's encoders: truth, else laser, else gyro; None without one."""
    if one.drive.truth is not None:
        return of_truth(one.drive.truth)
    if has_both(one):
        progress("matching scans")
        motion = motion_of_both(one)
        return ReferenceMotion("lrf", motion.laser.t + motion.delay, motion.laser.pose)
    if (turned := _turned_by_gyro(one)) is None:
        return None
    t, heading = turned
    return ReferenceMotion("gyro", t, np.column_stack((np.zeros((len(t), 2)), heading)))


def _turned_by_gyro(one: Loaded) -> tuple[Array, Array] | None:
    """Return times (n,) [s] and integrated gyro headings (n,) [rad]; None with fewer than two gyro readings."""
    m = one.drive.measurements.get("gyro")
    return None if m is None or len(m.t) < 2 else REGISTRY["gyro"].heading(m)


def _gyro(loaded: Sequence[Loaded], settings: WheelSettings) -> GyroCalibration:
    turned = ((one.drive.wheels, _turned_by_gyro(one)) for one in loaded)
    drives = [(wheels, *heading) for wheels, heading in turned if heading is not None]
    if not drives or settings.radius is None:
        raise LocfuseError("no log has a gyro beside wheels whose radius and track are set", role="gyro")
    gyro = loaded[0].robot.settings("gyro")
    return calibrate_by_gyro(drives, gyro.sigma_scale, math.radians(gyro.sigma_deg))


def _gyro_notes(found: GyroCalibration, settings: WheelSettings) -> list[str]:
    by_window = ", ".join(f"{k:.2g} m over {length:g} s" for length, k in found.noise.items())
    track = (settings.track or 0.0) + 2.0 * found.slides
    notes = [
        f"wheels: the robot turns as if its wheels were {track:.2f} m apart: they slide by {found.slides:.2f} m "
        "per radian of turn. A gyro does not see what both sides slide in the same direction: wheels.noise "
        "assumes from zero to twice that",
        f"gyro: {found.windows} windows, {math.degrees(found.turned_rad):.0f} degrees, its clock shifted by "
        f"{found.delay:+.2f} s; it knows no lengths: the radius is left as it was set",
        f"wheels: noise by the length of the window: {by_window}; that of the longest is written",
    ]
    return notes if found.slides else notes[1:]


def _by_laser(loaded: Sequence[Loaded], progress: Progress) -> LaserCalibration:
    """Calibrate wheels and laser mount by scan matching. Raises LocfuseError if the logs show too little."""
    both = [one for one in loaded if has_both(one)]
    if not both:
        names = ", ".join(one.log.name for one in loaded)
        raise LocfuseError(f"no wheels and laser together in {names}", role="laser")
    progress("matching scans")
    return calibrate_by_scans([motion_of_both(one) for one in both])


def _laser_notes(fit: LaserCalibration, settings: WheelSettings) -> list[str]:
    """Return notes on a calibration by laser: the data used, settings not estimated, and an odometry's scale."""
    notes = [
        f"laser: {fit.intervals} pieces of way by wheels and laser ({fit.distance_m:.1f} m, "
        f"{math.degrees(fit.turned_rad):.0f} degrees); the laser's metre is taken for the right one "
        "(lrf.range_scale)"
    ]
    if fit.outliers:
        notes.append(f"laser: {fit.outliers} pieces do not fit the others (slip, or a wrong match): not used")
    odometry = settings.radius is None or settings.track is None
    undetermined = set(fit.undetermined()) - ({"scale", "difference", "track"} if odometry else set())
    for name, (what, needs) in LACKING_BY_LASER.items():
        if name in undetermined:
            notes.append(f"{what} cannot be estimated without {needs}; it is left as it is")
    if odometry:
        scale, _, track = (1.0 + fit.parameters[:3]).tolist()
        of_scale, _, of_track = (f"{s:.3f}" if math.isfinite(s) else "unknown" for s in fit.sigmas[:3].tolist())
        notes.append(
            f"wheels: the odometry measures {1.0 / scale:.3f} of the laser's distances (1 sigma {of_scale}) and "
            f"{track / scale:.3f} of its turns ({of_track})"
        )
    return notes


def has_both(one: Loaded) -> bool:
    """Return whether a log has a laser, and a wheel motion that was not computed from the laser's scans."""
    return "lrf" in one.choice.topics and one.drive.wheels.matched is None


def motion_of_both(one: Loaded) -> ScanMotions:
    """Return two motions of one log: by the wheels (base frame), and by matching laser scans (laser frame)."""
    lrf: Any = one.robot.settings("lrf")
    laser = laser_of(lrf)._replace(mount=np.zeros(3))
    stream = one.log.stream(one.choice.topics["lrf"], one.robot.order)
    found = match_scans(stream, laser).reading(WheelSettings(), lrf.time_offset)
    return ScanMotions(one.drive.wheels, found.wheels, (found.epoch_ns - one.drive.epoch_ns) * 1e-9)
