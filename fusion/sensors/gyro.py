"""Gyro: the robot's turn between two readings; its bias is a state of the filter.

A gyro measures only the change of the heading. So the filter keeps a copy of the heading at the gyro's previous
reading (a "clone", Roumeliotis and Burdick 2002), and the measurement is

    z = theta - theta_before + bias dt + noise,    H = [0 0 1 | -1 dt]

The copy is correlated with all other states, so corrections by other sensors in between are counted exactly once.
The gain depends on the wheels' noise in this interval, var(theta - theta_before) = Q_theta: without other sensors
it is K = Q_theta / (Q_theta + r).

The bias is measured in the standstill that shows it best, bias = turn / time with variance sigma^2 / time, and
used from the start of the drive. If the filter estimated it only when the robot stops, the accumulated heading
error would be corrected in one step. This may be tens of degrees (a minute at 1 deg/s), and the linearisation
would fail. The gyro's readings in that standstill are not used again.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Any, ClassVar, Literal, NamedTuple

import numpy as np

from locfuse.fusion.data import Array, Colour, Component, Ints, LocfuseError, Measurements, RowVerdict, Stream
from locfuse.fusion.kernels.ekf import Innovation
from locfuse.fusion.mount import BARE_NUMBERS, NOT_ON_BODY
from locfuse.fusion.se2 import rotation_3d
from locfuse.fusion.sensor import Block, Matrix, Model, Sensor, SensorSettings, WheelMotion, given_or_state
from locfuse.fusion.statistics import chi_square
from locfuse.fusion.streams import arrays, count_dropped, last_of_periods, seconds, stuck, summed

MAX_REST_ROLLED_M, MAX_REST_TURNED_RAD = 0.001, math.radians(0.1)  # in a standstill: encoders flicker by a tick
MAX_BIAS_SIGMAS = 4.0  # prior sigmas: with a larger bias at rest, the robot was turned by hand
BEFORE, BIAS = "_gyro_before", "gyro_bias"
H_TURN = ((0.0, 0.0, 1.0),)
H_BEFORE: Matrix = ((-1.0,),)
MIN_TURN_RAD = math.radians(20.0)  # least rms of the wheels' turns about their mean, to test the gyro
MIN_TURN_CORRELATION = 0.8  # least correlation of gyro and wheels for a test of the ratio of their turns
RATE_TOPICS = ("gyro", "yaw_rate", "yawrate", "turn_rate", "angular_velocity")  # topics of bare turning rates
UPSIDE_DOWN_GYRO = "gyro.roll_deg=180"  # the fix of a gyro that turns against the wheels
WRONG_SCALE = 2.0  # a factor that no wheel geometry explains


class GyroSettings(SensorSettings, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Settings of [gyro] in robot.toml."""

    # no reading is rejected: if gyro and wheels measure different turns, a wheel slipped
    gate: float = 1.0
    field: str | None = None  # field with the turning rate in a message of any type, such as "state.yaw_rate"
    unit: Literal["rad", "deg"] = "rad"  # of the angular velocity, per second
    roll_deg: float = 0.0  # mount of the IMU on the base
    pitch_deg: float = 0.0  # degrees, likewise
    period: float = 0.1  # s: readings are summed up to this, so that their rate costs nothing in the filter
    sigma_deg: float = 0.05  # angle random walk, degrees per sqrt(s)
    scale: float = 1.0  # true turn / measured turn: rates are multiplied by it
    sigma_scale: float = 0.005  # relative error of the gyro's scale, taken as noise of every turn
    bias_deg: float | None = None  # degrees per s; not set: estimated from the drive
    sigma_bias_deg: float = 1.0  # 1 sigma of an estimated bias at the start, degrees per s
    bias_drift_deg: float = 0.002  # random walk of the bias, degrees per s per sqrt(s)


class Gyro(Sensor):
    """The gyro: reads an IMU's angular velocity, or a turning rate as a bare number."""

    name = "gyro"
    Settings = GyroSettings
    components = (Component("turn", "deg", math.degrees(1.0)),)
    states: ClassVar[Mapping[str, tuple[Component, ...]]] = {
        BIAS: (Component("gyro bias", "deg/s", math.degrees(1.0)),)
    }
    colour = Colour("#8c6a00", "#d2b13a")
    noise_keys = ("sigma_deg",)
    unlikely = (*NOT_ON_BODY, "raw")
    second_best = BARE_NUMBERS
    extra = True  # most bags have an IMU: an unusable one must not stop the other sensors
    guesses: ClassVar[Mapping[str, str]] = {"unit": "guess: radians per second, as REP 103 wants"}
    reads: ClassVar[Mapping[str, tuple[str, ...]]] = {
        "sensor_msgs/msg/Imu": (*(f"angular_velocity.{axis}" for axis in "xyz"), "angular_velocity_covariance"),
        **dict.fromkeys(BARE_NUMBERS, ("data",)),
    }
    named: ClassVar[Mapping[str, tuple[str, ...]]] = dict.fromkeys(BARE_NUMBERS, RATE_TOPICS)

    def carries(self, stream: Stream) -> bool:
        """Return whether a topic holds angular velocities that are not all zero."""
        columns = arrays(stream, *self.reads[stream.msgtype])
        try:
            up_rate(columns, GyroSettings(), stream.topic)
        except LocfuseError:
            return False
        return True

    def measure(self, stream: Stream, settings: GyroSettings, wheels: WheelMotion, epoch_ns: int) -> Measurements:
        """Integrate turning rates to angles z (n, 1) [rad] since the first reading, one row for each `period`.

        Raises LocfuseError without angular velocity, or if it contradicts the wheels.
        """
        columns = arrays(stream, *self.reads[stream.msgtype])
        rate = up_rate(columns, settings, stream.topic)
        t = seconds(stream.t_ns, epoch_ns, settings.time_offset)
        good = np.isfinite(rate)
        held = np.zeros(len(rate), dtype=bool)
        if good.any() and np.ptp(rate[good]) > 0.0:  # else `_check_against` says why
            held[good] = stuck(rate[good], rate[good], t[good], wheels.heading)
        dropped = dict(stream.dropped)
        count_dropped(dropped, not_finite=~good, stuck=held)
        good &= ~held
        t, rate = t[good], rate[good]
        angle, piece = summed(t, rate)
        keep = last_of_periods(t, settings.period)
        _check_against(t[keep], angle[keep], piece[keep], wheels, stream.topic)
        n = len(keep)
        return Measurements(
            t=t[keep],
            first=np.arange(n + 1),
            z=angle[keep, None],
            R_unit=np.diff(t[keep], prepend=t[keep[:1]]).reshape(n, 1, 1),
            scale=math.radians(settings.sigma_deg),
            floor=np.zeros((1, 1)),
            extra={
                "piece": piece[keep].astype(np.float64),
                **_rest_of(t[keep], angle[keep], piece[keep], wheels, settings),
            },
            dropped=dropped,
        )

    def heading(self, m: Measurements) -> tuple[Array, Array]:
        """Return times (n,) [s] and gyro headings (n,) [rad, unwrapped]; constant and drift are unknown."""
        return m.t, m.z[:, 0]

    def model(self, settings: GyroSettings) -> Model:
        """Return the filter model of the gyro for a new run."""
        return GyroModel(settings)


class Rest(NamedTuple):
    """Standstill: interval without wheel motion. The gyro's turn in it, divided by the time, is the bias."""

    begin: float  # s
    end: float
    turned: float  # rad, by the gyro less the wheels


class GyroModel(Model):
    """Turn since the reading before: z_i - z_before = theta - theta_before + bias dt + noise."""

    local = True  # both headings are in the local frame

    def __init__(self, settings: GyroSettings) -> None:
        self.settings = settings
        self.threshold = chi_square(settings.gate, 1)
        self.given = None if settings.bias_deg is None else math.radians(settings.bias_deg)
        self._last: int | None = None  # reading at which the heading was cloned
        self.rest: Rest | None = None  # by which the bias was set

    def blocks(self) -> list[Block]:
        """Return the state blocks: heading at the previous reading and, unless it is given, gyro bias."""
        before = Block(BEFORE, np.zeros(1), np.zeros((1, 1)), np.zeros(1))
        if self.given is not None:
            return [before]
        variance = math.radians(self.settings.sigma_bias_deg) ** 2
        drift = math.radians(self.settings.bias_drift_deg) ** 2
        return [before, Block(BIAS, np.zeros(1), np.array([[variance]]), np.array([drift]))]

    def innovations(self, m: Measurements, i: int, belief: Any) -> list[Innovation]:
        """Return the innovation of the gyro's turn since the reading before; [] at the first reading."""
        last, columns_of = self._last, m.plain
        if last is None or columns_of["piece"][i] != columns_of["piece"][last]:
            return []
        t, angle = columns_of["t"], m.scalars[0]
        before, now = t[last], t[i]
        if self.rest is not None and self.rest.begin <= before and now <= self.rest.end:
            return [Innovation.unpredicted(i, RowVerdict.REPEATED, 1, self.threshold)]  # already used for the bias
        dt, turned = now - before, angle[i] - angle[last]
        column = belief.column(BEFORE)
        bias, at = given_or_state(self.given, BIAS, belief)
        H_block = ((-1.0, dt),) if at else H_BEFORE
        y = turned - bias * dt - (belief.theta - belief.value(column))
        by_scale = self.settings.sigma_scale * turned
        r = m.scale * m.scale * dt + by_scale * by_scale  # inf for a damaged rate: rejected
        return [belief.compare(i, (y,), H_TURN, ((r,),), self.threshold, (column, *at), H_block)]

    def _begin(self, m: Measurements, i: int, belief: Any) -> None:
        """Set the bias to that measured during a standstill; called once, at the first reading."""
        if "rest_begin" not in m.extra or self.given is not None:
            return
        self.rest = Rest(*(float(m.extra[f"rest_{name}"][0]) for name in Rest._fields))
        at, now = belief.block(BIAS)
        span = self.rest.end - self.rest.begin
        apart = abs(0.5 * (self.rest.begin + self.rest.end) - float(m.t[i]))
        r = m.scale**2 / span + math.radians(self.settings.bias_drift_deg) ** 2 * apart
        y = self.rest.turned / span - float(now[0])
        belief.know((y,), ((r,),), (at,), ((1.0,),))

    def notes(self, belief: Any) -> list[str]:
        """Return a note with the bias measured during a standstill and the time of that standstill."""
        if self.rest is None:
            return []
        span = self.rest.end - self.rest.begin
        rate = math.degrees(self.rest.turned / span)
        return [f"bias at rest: {rate:.3f}°/s over {span:.1f} s, from {max(self.rest.begin, 0.0):.1f} s on"]

    def learn(self, m: Measurements, i: int, belief: Any) -> None:
        """Copy the present heading into the state "heading at the reading before"."""
        if self._last is None:
            self._begin(m, i, belief)
        belief.clone_heading(belief.column(BEFORE))
        self._last = i


def up_rate(columns: dict[str, Array], settings: GyroSettings, topic: str) -> Array:
    """Return the turning rates (n,) [rad/s] about the robot's vertical axis."""
    factor = settings.scale * (math.radians(1.0) if settings.unit == "deg" else 1.0)
    if "data" in columns:  # a bare number is the rate itself
        return factor * np.asarray(columns["data"], dtype=np.float64)
    omega = np.column_stack([columns[f"angular_velocity.{a}"] for a in "xyz"])
    covariance = columns["angular_velocity_covariance"]
    if len(omega) and (covariance[:, 0] == -1.0).all():
        raise LocfuseError(
            f"{topic} carries no angular velocity (angular_velocity_covariance[0] is -1)", role="gyro"
        )
    finite = omega[np.isfinite(omega).all(axis=1)]
    if not finite.any():
        says = "says 0" if len(finite) or not len(omega) else "has no finite angular velocity"
        raise LocfuseError(f"{topic} {says} in all {len(omega)} messages: no gyro writes there", role="gyro")
    return np.asarray(factor * (omega @ rotation_3d(settings.roll_deg, settings.pitch_deg, 0.0)[2]))


def _rest_of(t: Array, angle: Array, piece: Ints, wheels: WheelMotion, settings: GyroSettings) -> dict[str, Array]:
    """Return begin, end and gyro turn of the standstill that shows the gyro's bias best; {} without one.

    Each value is a constant column (n,), named `rest_begin` and so on. The standstill has the smallest variance of
    the bias at the drive's start: sigma^2 / time + bias_drift^2 * delay.
    """
    if len(t) < 2:
        return {}
    where = wheels.relative(np.broadcast_to(t[:1], t.shape), t)
    sigma, drift = math.radians(settings.sigma_deg), math.radians(settings.bias_drift_deg)
    prior = math.radians(settings.sigma_bias_deg)
    least, best = math.inf, None
    for a, b in rests(where, piece):
        span, turned = float(t[b] - t[a]), float(angle[b] - angle[a] - (where[b, 2] - where[a, 2]))
        variance = sigma**2 / span + drift**2 * (0.5 * float(t[a] + t[b]) - float(t[0]))
        if variance < least and abs(turned / span) < MAX_BIAS_SIGMAS * math.hypot(prior, math.sqrt(variance)):
            least, best = variance, Rest(float(t[a]), float(t[b]), turned)
    if best is None:
        return {}
    return {f"rest_{name}": np.full(len(t), value) for name, value in best._asdict().items()}


def rests(where: Array, piece: Ints) -> Iterator[tuple[int, int]]:
    """Yield (first, last) reading of every standstill, where the wheels' poses (n, 3) do not change."""
    poses, a = where.tolist(), 0
    for i, (x, y, theta) in enumerate(poses):
        x0, y0, theta0 = poses[a]
        far = math.hypot(x - x0, y - y0) > MAX_REST_ROLLED_M or abs(theta - theta0) > MAX_REST_TURNED_RAD
        if far or piece[i] != piece[a]:
            if i - a > 2:
                yield a, i - 1
            a = i
    if len(poses) - a > 2:
        yield a, len(poses) - 1


def _check_against(t: Array, angle: Array, piece: Ints, wheels: WheelMotion, topic: str) -> None:
    """Raise LocfuseError if the gyro's turns have another sign or unit than the wheels' turns."""
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
    correlation = abs(float(np.corrcoef(own, theirs)[0, 1]))
    if correlation < MIN_TURN_CORRELATION or 1.0 / WRONG_SCALE < slope < WRONG_SCALE:
        return
    turns = f"{topic} turns {slope:.3g} times as far as the wheels;"
    if 30.0 < slope < 115.0:
        fix = "gyro.unit=deg"
        raise LocfuseError(f"{turns} it is in degrees:", role="gyro", fixes=(fix,), hint=f"--set {fix}")
    if slope > 0:
        scale = f"or, if the wheels are right, --set gyro.scale={1.0 / slope:.3g}"
        raise LocfuseError(turns, role="gyro", hint=f"check wheels.radius, wheels.track and gyro.unit; {scale}")
    fix = UPSIDE_DOWN_GYRO
    hint = f"--set {fix}; or both wheels are mirrored (wheels.mirrored=both)"
    raise LocfuseError(f"{turns} is it upside-down?", role="gyro", fixes=(fix,), hint=hint)
