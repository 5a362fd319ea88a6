"""A seventh sensor in one file: the range to a radio beacon, a bare number on a topic named after it."""

import math
from collections.abc import Mapping
from typing import ClassVar, cast

import numpy as np

from locfuse.fusion.data import Array, Colour, Component, LocfuseError, Measurements, Stream
from locfuse.fusion.kernels.ekf import Innovation
from locfuse.fusion.sensor import Ask, Belief, Bias, Model, Sensor, SensorSettings, WheelMotion
from locfuse.fusion.statistics import chi_square

Point = tuple[float, float]


class BeaconSettings(SensorSettings, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """[beacon]."""

    place: Point | None = None  # m, map frame
    sigma: float = 0.05  # m
    offset: float = 0.0  # m, what the radio measures too much


class Beacon(Sensor):
    """Reads Float32."""

    name = "beacon"
    Settings = BeaconSettings
    reads: ClassVar[Mapping[str, tuple[str, ...]]] = {"std_msgs/msg/Float32": ("data",)}
    named: ClassVar[Mapping[str, tuple[str, ...]]] = {"std_msgs/msg/Float32": ("beacon",)}
    components = (Component("range", "m"),)
    colour = Colour("#5b7c99", "#9fc0dd")
    noise_keys = ("sigma",)
    bias = Bias("offset", 1.0)
    sees = "range"
    asks: ClassVar[Mapping[str, Ask]] = {
        "place": Ask("m, map frame: not in this log. Where the beacon stands", needed=True),
        "sigma": Ask("m: noise of one range"),
    }

    def missing(self, settings: BeaconSettings) -> str | None:
        """Nothing can be compared with a beacon that may stand anywhere."""
        return None if settings.place else "beacon.place is not set: --set beacon.place=[X,Y]"

    def landmark(self, settings: BeaconSettings) -> Point | None:
        """Where the beacon stands, (x, y) [m]."""
        return settings.place

    def measure(
        self, stream: Stream, settings: BeaconSettings, wheels: WheelMotion, epoch_ns: int
    ) -> Measurements:
        """Ranges z (n, 1) [m]."""
        z = cast("dict[str, Array]", stream.columns("data"))["data"].astype(np.float64)
        good = np.isfinite(z)
        n = int(good.sum())
        t = (stream.t_ns - epoch_ns) * np.float64(1e-9) + settings.time_offset
        return Measurements(
            t=t[good],
            first=np.arange(n + 1),
            z=z[good, None] - settings.offset,
            R_unit=np.ones((n, 1, 1)),
            scale=settings.sigma,
            floor=np.zeros((1, 1)),
            dropped=dict(stream.dropped),
        )

    def model(self, settings: BeaconSettings) -> Model:
        """Return the beacon's side of a run."""
        if settings.place is None:
            raise LocfuseError(f"beacon: {self.missing(settings)}")
        return BeaconModel(settings.place, chi_square(settings.gate, 1))


class BeaconModel(Model):
    """z = |p - place| + noise."""

    def __init__(self, place: Point, threshold: float) -> None:
        self.place, self.threshold = place, threshold

    def innovations(self, m: Measurements, i: int, belief: Belief) -> list[Innovation]:
        """Compare one range with the belief."""
        dx, dy = belief.x - self.place[0], belief.y - self.place[1]
        h = math.hypot(dx, dy)
        if h == 0.0:
            return []
        z, variances = m.scalars
        H = ((dx / h, dy / h, 0.0),)
        y, R = (z[i] - h,), ((variances[i],),)
        seen = belief.compare(i, y, H, R, self.threshold)
        seen.landmark = 0
        return [seen]
