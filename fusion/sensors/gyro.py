"""Gyro: how far the robot turned between two instants, with a bias that is a state.

A gyro says nothing about a heading, only about its change. So the filter keeps a copy of the heading as it was at
the gyro's last reading (a "clone", Roumeliotis and Burdick 2002), and the reading is

    z = theta - theta_before + bias dt + noise,    H = [0 0 1 | -1 dt]

The copy carries its correlation with everything, so what other sensors corrected in between is neither lost nor
counted twice, and the wheels' noise of just this interval decides how much the gyro is believed: between two
readings var(theta - theta_before) is what the wheels' turn may be wrong by. With nothing in between this is the
gain K = Q_theta / (Q_theta + r) on the difference of both turns.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, ClassVar, Literal, cast

import numpy as np

from locfuse.fusion.chi_square import chi_square
from locfuse.fusion.data import Array, Colour, Component, Ints, LocfuseError, Measurements, Stream
from locfuse.fusion.mount import rotation
from locfuse.fusion.sensor import Block, Innovation, Model, Sensor, SensorSettings, WheelMotion
from locfuse.fusion.streams import gap_limit

BEFORE, BIAS = "_gyro_before", "gyro_bias"
H_TURN = ((0.0, 0.0, 1.0),)
MIN_TURN_RAD = math.radians(20.0)  # rms of the wheels' turn about its mean, before the gyro is held against it
AGREES = 0.8  # correlation from which gyro and wheels speak of the same turning
SAYS_SO = ("gyro", "yaw_rate", "yawrate", "turn_rate", "angular_velocity")  # topics of bare turning rates
WRONG_SCALE = 2.0  # a factor that no wheel geometry explains


class GyroSettings(SensorSettings, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """[gyro]."""

    # a turn that the wheels did not see is a slip: the gyro is the one to believe
    gate: float = 1.0
    field: str | None = None  # of a message of any type: the number that is the turning rate, "state.yaw_rate"
    unit: Literal["rad", "deg"] = "rad"  # of the angular velocity, per second
    roll_deg: float = 0.0  # mount of the IMU on the base
    pitch_deg: float = 0.0
    period: float = 0.1  # s: readings are summed up to this, so that their rate costs nothing in the filter
    sigma_deg: float = 0.05  # angle random walk, degrees per sqrt(s)
    sigma_scale: float = 0.005  # relative error of the gyro's scale, taken as noise of every turn
    bias_deg: float | None = None  # degrees per s; None: estimated from the drive
    sigma_bias_deg: float = 1.0  # what an estimated bias may be at the start
    bias_drift_deg: float = 0.002  # its random walk, degrees per s per sqrt(s)


class Gyro(Sensor):
    """Reads an IMU's angular velocity, or a turning rate that is a bare number."""

    name = "gyro"
    Settings = GyroSettings
    components = (Component("turn", "deg", math.degrees(1.0)),)
    states: ClassVar[Mapping[str, tuple[Component, ...]]] = {
        BIAS: (Component("gyro bias", "deg/s", math.degrees(1.0)),)
    }
    colour = Colour("#8c6a00", "#d2b13a")
    noise_keys = ("sigma_deg",)
    extra = True  # most bags have an IMU: one that is of no use must not stop the others
    guesses: ClassVar[Mapping[str, str]] = {"unit": "guess: radians per second, as REP 103 wants"}
    reads: ClassVar[Mapping[str, tuple[str, ...]]] = {
        "sensor_msgs/msg/Imu": (
            "angular_velocity.x",
            "angular_velocity.y",
            "angular_velocity.z",
            "angular_velocity_covariance",
        ),
        "std_msgs/msg/Float64": ("data",),
        "std_msgs/msg/Float32": ("data",),
    }
    named: ClassVar[Mapping[str, tuple[str, ...]]] = {
        "std_msgs/msg/Float64": SAYS_SO,
        "std_msgs/msg/Float32": SAYS_SO,
    }

    def carries(self, stream: Stream) -> bool:
        """Return whether a topic says an angular velocity at all."""
        columns = cast("dict[str, Array]", stream.columns(*self.reads[stream.msgtype]))
        try:
            up_rate(columns, GyroSettings(), stream.topic)
        except LocfuseError:
            return False
        return True

    def measure(self, stream: Stream, settings: GyroSettings, wheels: WheelMotion, epoch_ns: int) -> Measurements:
        """Sum readings up to angles turned since the first one: z (n, 1) [rad], one row every `period`.

        Raises LocfuseError where there is no angular velocity, or where it and the wheels cannot both be right.
        """
        columns = cast("dict[str, Array]", stream.columns(*self.reads[stream.msgtype]))
        rate = up_rate(columns, settings, stream.topic)
        t: Array = (stream.t_ns - epoch_ns) * np.float64(1e-9) + settings.time_offset
        good = np.isfinite(rate)
        dropped = dict(stream.dropped)
        if not good.all():
            dropped["not_finite"] = dropped.get("not_finite", 0) + int((~good).sum())
        t, rate = t[good], rate[good]
        angle, piece = _summed(t, rate)
        keep = _one_each(t, settings.period)
        _check_against(t[keep], angle[keep], piece[keep], wheels, stream.topic, settings)
        n = len(keep)
        return Measurements(
            t=t[keep],
            first=np.arange(n + 1),
            z=angle[keep, None],
            R_unit=np.diff(t[keep], prepend=t[keep[:1]]).reshape(n, 1, 1),
            scale=math.radians(settings.sigma_deg),
            floor=np.zeros((1, 1)),
            extra={"piece": piece[keep].astype(np.float64)},
            dropped=dropped,
        )

    def heading(self, m: Measurements) -> tuple[Array, Array]:
        """Return times (n,) and headings (n,) [rad, unwrapped, up to a constant and a drift] by the gyro alone."""
        return m.t, m.z[:, 0]

    def model(self, settings: GyroSettings) -> Model:
        """Return the gyro's side of a new run."""
        return GyroModel(settings)


class GyroModel(Model):
    """z_i - z_before = theta - theta_before + bias dt + noise."""

    local = True  # both headings are of one frame

    def __init__(self, settings: GyroSettings) -> None:
        self.settings = settings
        self.threshold = chi_square(settings.gate, 1)
        self.given = None if settings.bias_deg is None else math.radians(settings.bias_deg)
        self._last: int | None = None  # reading whose heading is kept

    def blocks(self) -> list[Block]:
        """Return the kept heading, and the bias where it is not given."""
        before = Block(BEFORE, np.zeros(1), np.zeros((1, 1)), np.zeros(1))
        if self.given is not None:
            return [before]
        variance = math.radians(self.settings.sigma_bias_deg) ** 2
        drift = math.radians(self.settings.bias_drift_deg) ** 2
        return [before, Block(BIAS, np.zeros(1), np.array([[variance]]), np.array([drift]))]

    def innovations(self, m: Measurements, i: int, belief: Any) -> list[Innovation]:
        """Compare the turn since the last reading with the belief; the first, and one after a gap, only begins."""
        last = self._last
        if last is None or m.extra["piece"][i] != m.extra["piece"][last]:
            return []
        dt, turned = float(m.t[i] - m.t[last]), float(m.z[i, 0] - m.z[last, 0])
        column, before = belief.block(BEFORE)
        columns: tuple[int, ...] = (column,)
        H_block: tuple[tuple[float, ...], ...] = ((-1.0,),)
        bias = self.given
        if bias is None:
            at, now = belief.block(BIAS)
            columns, H_block, bias = (column, at), ((-1.0, dt),), float(now[0])
        y = turned - bias * dt - (belief.theta - float(before[0]))
        r = m.scale**2 * dt + (self.settings.sigma_scale * turned) ** 2
        return [Innovation.of(i, (y,), H_TURN, ((r,),), belief, self.threshold, columns=columns, H_block=H_block)]

    def learn(self, m: Measurements, i: int, belief: Any) -> None:
        """Keep the heading as it is now."""
        column, _ = belief.block(BEFORE)
        belief.clone_heading(column)
        self._last = i


def up_rate(columns: dict[str, Array], settings: GyroSettings, topic: str) -> Array:
    """Turning rate about the robot's vertical axis (n,) [rad/s]: the mount's row of up times the three rates."""
    if "data" in columns:  # a bare number is the rate itself
        bare = np.asarray(columns["data"], dtype=np.float64)
        return np.radians(bare) if settings.unit == "deg" else bare
    omega = np.stack([columns[f"angular_velocity.{a}"] for a in "xyz"], axis=-1)
    covariance = columns["angular_velocity_covariance"]
    if len(omega) and (covariance[:, 0] == -1.0).all():
        raise LocfuseError(
            f"{topic} carries no angular velocity (angular_velocity_covariance[0] is -1)", role="gyro"
        )
    finite = omega[np.isfinite(omega).all(axis=1)]
    if not finite.any():
        raise LocfuseError(f"{topic} says 0 in all {len(omega)} messages: no gyro writes there", role="gyro")
    rate: Array = omega @ rotation(settings.roll_deg, settings.pitch_deg, 0.0)[2]
    return np.radians(rate) if settings.unit == "deg" else rate


def _summed(t: Array, rate: Array) -> tuple[Array, Ints]:
    """Return the angle turned since the first reading (n,), by trapezoids, and how many gaps came before (n,)."""
    dt = np.diff(t)
    if not len(dt):
        return np.zeros(len(t)), np.zeros(len(t), dtype=np.int64)
    gap = dt > gap_limit(t)  # over a longer silence the turn is not known
    steps = np.where(gap, 0.0, 0.5 * (rate[1:] + rate[:-1]) * dt)
    return np.concatenate(([0.0], np.cumsum(steps))), np.concatenate(([0], np.cumsum(gap)))


def _one_each(t: Array, period: float) -> Ints:
    """Return the last reading of every period, at strictly increasing times."""
    if not len(t):
        return np.zeros(0, dtype=np.int64)
    cell = np.floor(t / period) if period > 0.0 else t
    return np.flatnonzero(np.append(np.diff(cell) > 0, True))


def _check_against(
    t: Array, angle: Array, piece: Ints, wheels: WheelMotion, topic: str, settings: GyroSettings
) -> None:
    """Raise LocfuseError where both turn alike but in opposite senses, or by amounts that are other units."""
    if len(t) < 20:
        return
    own = np.diff(angle)[np.diff(piece) == 0]
    theirs = wheels.relative(t[:-1], t[1:])[np.diff(piece) == 0, 2]
    if len(own) < 20 or math.sqrt(float(theirs.var()) * len(theirs)) < MIN_TURN_RAD:
        return
    if not own.any():
        raise LocfuseError(
            f"{topic} never turns about the robot's vertical axis while the wheels turn it: it is mounted "
            "on its side (gyro.roll_deg, gyro.pitch_deg), or dead",
            role="gyro",
        )
    slope = float(np.cov(own, theirs)[0, 1] / theirs.var(ddof=1))
    if abs(float(np.corrcoef(own, theirs)[0, 1])) < AGREES or 1.0 / WRONG_SCALE < slope < WRONG_SCALE:
        return
    turns = f"{topic} turns {slope:.3g} times as far as the wheels;"
    if 30.0 < slope < 115.0:
        fix = "gyro.unit=deg"
        raise LocfuseError(f"{turns} it is in degrees:", role="gyro", fixes=(fix,), hint=f"--set {fix}")
    if slope > 0:
        raise LocfuseError(turns, role="gyro", hint="check wheels.radius and wheels.track, and gyro.unit")
    fix = "gyro.roll_deg=180"
    hint = f"--set {fix}; or both wheels are mirrored (wheels.mirrored=both)"
    raise LocfuseError(f"{turns} is it upside-down?", role="gyro", fixes=(fix,), hint=hint)
