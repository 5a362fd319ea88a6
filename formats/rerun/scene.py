"""The content of a Rerun recording as values, without importing Rerun."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from functools import cached_property
from typing import Literal, NamedTuple

import msgspec
import numpy as np
from numpy.typing import NDArray

from locfuse.formats.geometry import MAX_CURVE_POINTS, MAX_SCANS, walls
from locfuse.fusion.data import VERDICTS, Array, Component, Drive, Estimates, Evaluation, Event, Ints

Rgb = tuple[int, int, int]
Floats = NDArray[np.float32]  # values that are only drawn
GREY: Rgb = (148, 151, 156)
MATCHED, REJECTED, NEW = "matched", "rejected", "new"  # groups of verdicts that share a colour
GROUP = {"accepted": MATCHED, "repeated": MATCHED, "new": NEW}  # verdict -> group; all other verdicts: REJECTED
GROUP_OF = tuple(GROUP.get(v, REJECTED) for v in VERDICTS)
NO_LIMIT = 2**62


class SensorLook(msgspec.Struct, frozen=True):
    """How a sensor's measurements are drawn: components, NIS bounds, shape and mount."""

    components: tuple[Component, ...]  # of its innovation
    bounds: tuple[float, float]  # 95 % interval of the NIS of consistent measurements
    kind: Literal["segments", "bearing", "heading", ""] = ""  # shape on the map
    mount: tuple[float, float, float] = (0.0, 0.0, 0.0)  # x, y [m], yaw [rad] in the base frame
    landmark: tuple[float, float] | None = None  # m, map frame: target of a bearing
    places: Sequence[tuple[float, float]] = ()  # m, map frame: targets of bearings and ranges


class DrawnScans(NamedTuple):
    """Scans as points in the base frame, deskewed to one time per scan."""

    t: Array  # (s,) s since Drive.epoch_ns
    counts: Ints  # (s,) points of each scan
    xy: Floats  # (sum of counts, 2) m


class Picture(NamedTuple):
    """One image of the log with its detections."""

    t: float  # s since Drive.epoch_ns
    omni: bytes  # JPEG or PNG
    omni_type: str  # media type of `omni`
    panorama: bytes  # JPEG, the floor at the bottom
    rays: Array  # (k, 2, 2) px in `omni`: inner and outer end of each detection's ray
    columns: Array  # (k,) px in the panorama
    verdicts: tuple[str, ...]  # (k,) group of each detection: matched, rejected, new


class RawTopic(NamedTuple):
    """Numeric fields of one topic as recorded."""

    topic: str
    t: Array  # (n,) s since Drive.epoch_ns
    fields: Mapping[str, Array]  # name -> (n,)


class RerunScene(msgspec.Struct, frozen=True, dict=True):
    """The content of a recording: drive, configurations and measurements."""

    name: str  # of the log
    drive: Drive
    estimates: Sequence[Estimates]
    evaluations: Mapping[str, Evaluation]  # by configuration
    sights: Mapping[str, SensorLook] = {}  # by sensor
    track: float = 0.3  # m, size of the robot on the map
    table: str = ""  # the result table, Markdown
    scans: DrawnScans | None = None
    pictures: Iterable[Picture] = ()
    picture_rows: int | None = None  # px, height of the panoramas; None without pictures
    raw: Sequence[RawTopic] = ()
    full: bool = False  # whether long logs are drawn without thinning
    palette: Mapping[str, Rgb] = {}  # by configuration
    events: Sequence[Event] = ()  # in order of time
    thinned: Mapping[str, Drive] = {}  # configuration with reduced rates -> its drive

    @property
    def max_points(self) -> int:
        """Maximum number of points per curve."""
        return NO_LIMIT if self.full else MAX_CURVE_POINTS

    @property
    def max_scans(self) -> int:
        """Maximum number of scans or other readings on the map."""
        return NO_LIMIT if self.full else MAX_SCANS

    @property
    def best(self) -> Estimates:
        """The configuration with most sensors, whose map, scans and matches are visible at first."""
        return max(self.estimates, key=lambda e: len(e.sensors))

    @cached_property
    def landmarks(self) -> list[tuple[float, float]]:
        """Positions [m, map frame] of landmarks and anchors, given or estimated."""
        given = (place for sight in self.sights.values() for place in sight.places)
        return list(dict.fromkeys([*given, *((float(x), float(y)) for _, x, y in self.best.points)]))

    @cached_property
    def extent(self) -> tuple[Array, Array]:
        """Lower and upper corner (2,) [m, map frame] of the box around all that is drawn at first.

        This is the truth, and the path, walls (with more than one hit) and landmarks of the best configuration.
        """
        parts: list[Array] = [self.best.pose[:, :2]]
        if self.drive.truth is not None and len(self.drive.truth.xy):
            parts.append(self.drive.truth.xy)
        parts.append(walls([line for line in self.best.final_map if line.hits > 1]).reshape(-1, 2))
        parts += [np.array([place]) for place in self.landmarks]
        points = np.concatenate(parts)
        return points.min(axis=0), points.max(axis=0)

    def colour(self, configuration: str) -> Rgb:
        """Return the colour of a configuration."""
        return self.palette.get(configuration, GREY)

    def seen_by(self, configuration: str) -> Drive:
        """Return the drive to which a configuration's audit refers: the thinned one if its rates are reduced."""
        return self.thinned.get(configuration, self.drive)
