"""Speeds from another estimator (visual odometry, optical flow, radar, a second odometry).

The state holds no speed: the wheels' motion is the filter's input. So speeds are integrated to distance s and turn
a between two readings, and compared with the motion since a copy B of the pose at the previous reading (a "clone",
Roumeliotis and Burdick 2002). With d = (-)B (+) p, the present pose relative to B,

    s sinc(a / 2) = d_x cos(d_theta / 2) + d_y sin(d_theta / 2) + noise,    a = d_theta + noise

the chord of an arc. Sideways motion is not measured.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar, Literal

import numpy as np

from locfuse.fusion.data import Array, Colour, Component, Ints, LocfuseError, Measurements, Stream, plausible
from locfuse.fusion.kernels.ekf import Innovation
from locfuse.fusion.se2 import direction, wrap
from locfuse.fusion.sensor import Ask, Block, Model, PoseRows, Sensor, SensorSettings, WheelMotion
from locfuse.fusion.statistics import chi_square
from locfuse.fusion.streams import arrays, count_dropped, last_of_periods, seconds, summed
from locfuse.fusion.wheels.odometry import SPEED

from .pose import plane_covariance, seen_from

CLONE = "_twist_before"
VARIANCES = ("forward_variance", "turn_variance")  # of distance [m^2] and turn [rad^2] since the first reading
MIN_SIGMAS = (0.001, math.radians(0.02))  # m, rad: smallest standard deviations of one interval
WITH_COVARIANCE = ("nav_msgs/msg/Odometry", "geometry_msgs/msg/TwistWithCovarianceStamped")
FORWARD_TURN = (0, 5)  # indices of linear x and angular z in a covariance of ROS


class TwistSettings(SensorSettings, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Settings of [twist] in robot.toml."""

    covariance: Literal["message", "sigma"] = "message"  # "sigma": the keys below, whatever the messages claim
    sigma: float = 0.05  # m/s of one reading, if the messages have no covariance
    sigma_turn_deg: float = 2.0  # degrees per s, likewise
    sigma_scale: float = 0.02  # relative error of the scale, used as noise of each distance and turn
    period: float = 0.1  # s: readings are summed over this time, so a high rate does not slow down the filter

    positive: ClassVar[tuple[str, ...]] = (*SensorSettings.positive, "sigma_turn_deg")


class Twist(Sensor):
    """Sensor of speeds by another estimator: reads forward speeds and turning rates."""

    name = "twist"
    Settings = TwistSettings
    components = (Component("forward", "m"), Component("turn", "deg", math.degrees(1.0)))
    colour = Colour("#5d6b1e", "#b8f07a")
    noise_keys = ("sigma", "sigma_turn_deg")
    extra = True
    asked_only = "speeds may be those of the same wheels, or commands that were not measured"
    sees = "speed"
    asks: ClassVar[Mapping[str, Ask]] = {
        "sigma": Ask("m/s: where the messages say nothing"),
        "sigma_turn_deg": Ask("degrees per s: where the messages say nothing"),
    }
    reads: ClassVar[Mapping[str, tuple[str, ...]]] = {
        kind: (*fields, "twist.covariance") if kind in WITH_COVARIANCE else fields
        for kind, fields in SPEED.items()
    }

    def measure(self, stream: Stream, settings: TwistSettings, wheels: WheelMotion, epoch_ns: int) -> Measurements:
        """Integrate speeds to z (n, 2): distance [m] and turn [rad] since the first reading, one row per `period`.

        Raises LocfuseError if no message has a speed.
        """
        columns = arrays(stream, *self.reads[stream.msgtype])
        speeds = np.stack([np.asarray(columns[name], np.float64) for name in SPEED[stream.msgtype]], axis=-1)
        dropped = dict(stream.dropped)
        keep = _usable(speeds, stream, dropped)
        t = seconds(stream.t_ns[keep], epoch_ns, settings.time_offset)
        sigmas = np.array([settings.sigma, math.radians(settings.sigma_turn_deg)])
        own = np.broadcast_to(sigmas**2, (len(t), 2))
        P, known = plane_covariance(columns.get("twist.covariance"), keep, settings.covariance, own, FORWARD_TURN)
        travelled, piece = summed(t, speeds[keep])
        # the errors of two readings are independent: their step has the variance 0.5 (v + v') dt^2; gaps have none
        held = np.where(np.diff(piece) > 0, 0.0, np.diff(t))[:, None]
        variances, variance = np.diagonal(P, axis1=1, axis2=2), np.zeros_like(travelled)
        np.cumsum(0.5 * (variances[1:] + variances[:-1]) * held**2, axis=0, out=variance[1:])
        rows = last_of_periods(t, settings.period)
        n = len(rows)
        R = np.zeros((n, 2, 2))
        R[:, (0, 1), (0, 1)] = np.diff(variance[rows], axis=0, prepend=np.zeros((1, 2)))
        return Measurements(
            t=t[rows],
            first=np.arange(n + 1),
            z=travelled[rows],
            R_unit=R / settings.sigma**2,
            scale=settings.sigma,
            floor=np.diag([MIN_SIGMAS[0] ** 2, MIN_SIGMAS[1] ** 2]),
            extra={
                "piece": piece[rows].astype(np.float64),
                "forward_variance": variance[rows, 0],
                "turn_variance": variance[rows, 1],
                "has_covariance": known[rows].astype(np.float64),
            },
            dropped=dropped,
        )

    def heading(self, m: Measurements) -> tuple[Array, Array]:
        """Return times (n,) [s] and integrated turning rate (n,) [rad]: heading with unknown start and drift."""
        return m.t, m.z[:, 1]

    def model(self, settings: TwistSettings) -> Model:
        """Return the filter model of the speeds for a new run."""
        return TwistModel(settings)


def _usable(speeds: Array, stream: Stream, dropped: dict[str, int]) -> Ints:
    """Return the rows (k,) with finite speeds and a new stamp; count the others by reason."""
    finite = plausible(speeds).all(axis=1)
    later = np.diff(stream.t_ns, append=np.iinfo(np.int64).max) > 0
    count_dropped(dropped, not_finite=~finite, repeat=finite & ~later)
    keep = np.flatnonzero(finite & later)
    if not len(keep):
        raise LocfuseError(f"{stream.topic} has no usable speed in {len(speeds)} messages", role="twist")
    if len(keep) > 2 and not speeds[keep].any():
        raise LocfuseError(
            f"{stream.topic} says 0 in all {len(keep)} messages: no sensor measures it", role="twist"
        )
    return keep


class TwistModel(Model):
    """Model of distance and turn since the previous reading, in the local frame."""

    local = True

    def __init__(self, settings: TwistSettings) -> None:
        self.scale = settings.sigma_scale**2
        self.threshold = chi_square(settings.gate, 2)
        self._last: int | None = None  # reading at which the pose was cloned

    def blocks(self) -> list[Block]:
        """Return the state block of the cloned pose (the pose at the previous reading)."""
        return [Block(CLONE, np.zeros(3), np.zeros((3, 3)), np.zeros(3))]

    def innovations(self, m: Measurements, i: int, belief: Any) -> list[Innovation]:
        """Return the innovation of distance and turn since the previous reading; [] at the first reading."""
        last = self._last
        if last is None or m.plain["piece"][i] != m.plain["piece"][last]:
            return []
        z = m.plain["z"]
        distance, turn = z[i, 0] - z[last, 0], z[i, 1] - z[last, 1]
        column = belief.column(CLONE)
        columns = column, column + 1, column + 2
        (along, turned), by_kept, by_pose = chord(tuple(map(belief.value, columns)), belief.pose())
        y = chord_length(distance, turn) - along, wrap(turn - turned)
        R = (self._variance(m, 0, distance, last, i), 0.0), (0.0, self._variance(m, 1, turn, last, i))
        return [belief.compare(i, y, by_pose, R, self.threshold, columns, by_kept)]

    def _variance(self, m: Measurements, of: int, value: float, last: int, i: int) -> float:
        """Return the variance of the distance [m^2] or the turn [rad^2] between the readings `last` and i.

        `of` is 0 for the distance, 1 for the turn. `value` is the measured distance [m] or turn [rad].
        """
        variance = m.plain[VARIANCES[of]]
        return float(variance[i] - variance[last] + self.scale * value * value + m.floor.item(of, of))

    def learn(self, m: Measurements, i: int, belief: Any) -> None:
        """Copy the present pose into the cloned pose, since the next distance and turn are measured from here."""
        belief.clone_pose(belief.column(CLONE))
        self._last = i


def chord(kept: Sequence[float], pose: Sequence[float]) -> tuple[tuple[float, float], PoseRows, PoseRows]:
    """Return distance along the mean heading [m] and turn [rad] from pose `kept` to `pose`, and both derivatives.

    Each derivative (2, 3) is by one of the poses.
    """
    (x, y, turn), by_kept, by_pose = seen_from(kept, pose)
    c, s = direction(0.5 * turn)
    bent = 0.5 * (y * c - x * s)
    along_kept, along_pose = (
        (c * ahead[0] + s * left[0], c * ahead[1] + s * left[1], c * ahead[2] + s * left[2] + bent * turned[2])
        for ahead, left, turned in (by_kept, by_pose)
    )
    return (x * c + y * s, turn), (along_kept, by_kept[2]), (along_pose, by_pose[2])


def chord_length(arc: float, turn: float) -> float:
    """Return the chord s sinc(a / 2) [m] of an arc of length s [m] and turn a [rad]."""
    half = 0.5 * turn
    return arc * direction(half)[1] / half if half else arc
