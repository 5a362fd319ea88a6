"""Sonar: the nearest echo in a cone, held against the laser's line map.

A smooth wall sends sound back only where it stands square to a ray of the cone. So an echo is the distance to a
wall whose foot point lies within the cone and on the wall; nothing else that the map knows may stand nearer.
What the map lacks answers too, from anywhere before the wall: an echo counts as the wall's only where that is the
likelier story.

With the sonar at p and the wall n.(q - a) = rho it is C = rho - n.(p - a) (paper eq. 17 without its sign).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, ClassVar, cast

import msgspec
import numpy as np
from msgspec.structs import replace

from locfuse.fusion.chi_square import chi_square
from locfuse.fusion.core import echoes as core
from locfuse.fusion.core import tables
from locfuse.fusion.core.room import Room
from locfuse.fusion.data import VERDICTS, Array, Colour, Component, Ints, Measurements, Stream
from locfuse.fusion.linemap.sonar_echo import Cone, Echo, nearest_echo
from locfuse.fusion.mount import ASK_MOUNT
from locfuse.fusion.sensor import (
    GATE,
    Ask,
    Columns,
    Innovation,
    Model,
    Sensor,
    SensorSettings,
    WheelMotion,
    untold,
)
from locfuse.fusion.streams import MergedStream, count_dropped

UNMATCHED = VERDICTS.index("unmatched")
Mount = tuple[float, float, float]


class SonarSettings(SensorSettings, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """[sonar]: one or several rangers, which are one sensor."""

    topics: tuple[str, ...] = ()  # none: all topics of the type
    mounts: dict[str, Mount] = msgspec.field(default_factory=dict)  # topic -> x [m], y [m], yaw [deg] on the base
    sigma: float = 0.03  # m
    widen_deg: float = 3.0  # walls count that stand square this far outside the cone: no heading is exact


class Sonar(Sensor):
    """Reads Range."""

    name = "sonar"
    locates = True
    Settings = SonarSettings
    components = (Component("distance", "m"),)
    colour = Colour("#a93fc6", "#ec92fd")
    noise_keys = ("sigma",)
    extra = True
    several = True
    needs: ClassVar[Mapping[str, str]] = {"lrf": "held against the map of lrf"}
    placed = True
    sees = "echo"
    asks: ClassVar[Mapping[str, Ask]] = {
        "mounts": Ask(f'{{ "/topic" = [m, m, degrees] }}: {ASK_MOUNT}', blank=True)
    }
    reads: ClassVar[Mapping[str, tuple[str, ...]]] = {
        "sensor_msgs/msg/Range": ("field_of_view", "min_range", "max_range", "range"),
    }

    def measure(self, stream: Stream, settings: SonarSettings, wheels: WheelMotion, epoch_ns: int) -> Measurements:
        """Turn readings into distances z (m, 1) [m]; a reading without an echo has no row."""
        columns = cast("dict[str, Array]", stream.columns(*self.reads[stream.msgtype]))
        distance = columns["range"].astype(np.float64)
        t: Array = (stream.t_ns - epoch_ns) * np.float64(1e-9) + settings.time_offset
        known = ~np.isnan(distance)
        dropped = dict(stream.dropped)
        count_dropped(dropped, "not_finite", int((~known).sum()))
        # at either end of the range nothing was measured (REP 117 says inf, old drivers say max_range)
        echo = (distance > columns["min_range"]) & (distance < columns["max_range"]) & np.isfinite(distance)
        rows = np.flatnonzero(known & echo)
        mounts = _mounts(stream, settings)[rows]
        return Measurements(
            t=t[known],
            first=np.concatenate(([0], np.cumsum(echo[known], dtype=np.int64))),
            z=distance[rows, None],
            R_unit=np.ones((len(rows), 1, 1)),
            scale=settings.sigma,
            floor=np.zeros((1, 1)),
            extra={
                "x": mounts[:, 0],
                "y": mounts[:, 1],
                "yaw": np.radians(mounts[:, 2]),
                "half": 0.5 * columns["field_of_view"].astype(np.float64)[rows],
            },
            dropped=dropped,
        )

    def model(self, settings: SonarSettings) -> Model:
        """Return the sonars' side of a new run."""
        return SonarModel(settings)


def _mounts(stream: Stream, settings: SonarSettings) -> Array:
    """Return where the sonar of every row sits, (n, 3) m, m, degrees; on the base's origin where nobody says."""
    parts = stream.parts if isinstance(stream, MergedStream) else (stream,)
    source: Ints = (
        stream.source if isinstance(stream, MergedStream) else np.zeros(len(stream.t_ns), dtype=np.int64)
    )
    table = np.array([settings.mounts.get(part.topic, (0.0, 0.0, 0.0)) for part in parts])
    places: Array = table[source]
    return places


class SonarModel(Model):
    """z = C + noise for the wall that must have answered."""

    teaches = False
    local = True

    def __init__(self, settings: SonarSettings) -> None:
        self.threshold = chi_square(settings.gate, 1)
        self.widen = math.radians(settings.widen_deg)
        self._laser: Any = None  # the model whose line map is read

    def meet(self, others: Mapping[str, Model]) -> None:
        """Read the map of the laser that runs in the same filter; without one there is nothing to compare with."""
        self._laser = others.get("lrf")

    def columns(self, m: Measurements, when: Ints) -> Columns | None:
        """Return all echoes for the core, where a laser's map is there to be read."""
        return None if self._laser is None else EchoColumns(self, self._laser, m, when)

    def innovations(self, m: Measurements, i: int, belief: Any) -> list[Innovation]:
        """Compare one echo with the wall that should have answered."""
        row = int(m.first[i])
        lines = None if self._laser is None else self._laser.map
        if row == int(m.first[i + 1]) or lines is None or len(lines) == 0:
            return []
        x, y, yaw, half = (float(m.extra[key][row]) for key in ("x", "y", "yaw", "half"))
        cone = Cone(x, y, yaw, half, self.widen)
        z, variances = m.scalars
        echo = nearest_echo(lines, belief, cone, math.sqrt(variances[row]))
        if echo is None:
            return [Innovation.unpredicted(row, UNMATCHED, 1, self.threshold)]
        return [self._judge(row, z[row] - echo.distance, variances[row], echo, belief)]

    def _judge(self, row: int, y: float, r: float, echo: Echo, belief: Any) -> Innovation:
        R = ((r + echo.map_variance,),)
        seen = Innovation.of(
            row,
            (y,),
            echo.H,
            R,
            belief,
            self.threshold,
            columns=echo.columns,
            H_block=echo.H_block,
            landmark=echo.line,
        )
        likelier = Room.here(core).functions.likelier(echo.distance, seen.sigma[0])
        threshold = min(self.threshold, likelier)
        return replace(seen, threshold=threshold, verdict=0 if seen.nis <= threshold else GATE)


class EchoColumns(Columns):
    """All echoes for the core, which reads the laser's map: one without walls answers nothing."""

    kind = "echoes"

    def __init__(self, model: SonarModel, laser: Model, m: Measurements, when: Ints) -> None:
        self.reads, self.when, self.first = laser, when, np.ascontiguousarray(m.first, np.intp)
        self._of = np.ascontiguousarray(m.z[:, 0]), np.ascontiguousarray(m.covariances(slice(None))[:, 0, 0])
        self._cones = np.column_stack([m.extra[key] for key in ("x", "y", "yaw", "half")])
        self._judged = model.threshold, float(GATE), float(UNMATCHED)
        self._widen = model.widen
        self.told, self.joint = untold(len(m.z), 1), np.zeros((0, 2))

    def table(self, belief: Any) -> Any:
        """Return the echoes."""
        return Room.here(tables).on_arrays.Echoes(
            self.when, self.first, *self._of, self._cones, self._widen, self.told, *self._judged, len(self.when), 0
        )
