"""The content of a recording as values, without Rerun."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from functools import cached_property
from typing import Literal, NamedTuple

import msgspec
import numpy as np
from msgspec import field
from numpy.typing import NDArray

from locfuse.formats.geometry import wall
from locfuse.formats.thin import MAX_CURVE_POINTS, MAX_SCANS
from locfuse.fusion.data import VERDICTS, Array, Component, Drive, Estimates, Evaluation, Event, Ints

Rgb = tuple[int, int, int]
Floats = NDArray[np.float32]  # of what is only drawn
GREY: Rgb = (148, 151, 156)
MATCHED, REJECTED, NEW = "matched", "rejected", "new"  # groups of verdicts that share a colour
GROUP = {"accepted": MATCHED, "repeated": MATCHED, "new": NEW}  # verdict -> group, REJECTED for the others
GROUP_OF = tuple(GROUP.get(v, REJECTED) for v in VERDICTS)
NO_LIMIT = 2**62


class SensorLook(msgspec.Struct, frozen=True):
    """The style and name of one sensor's measurements."""

    components: tuple[Component, ...]  # of its innovation
    bounds: tuple[float, float]  # of the NIS: 95 % of consistent measurements lie between
    kind: Literal["segments", "bearing", "heading", ""] = ""  # what it looks like on the map
    mount: tuple[float, float, float] = (0.0, 0.0, 0.0)  # m, m, rad on the base
    landmark: tuple[float, float] | None = None  # m, map: what a bearing points at


class DrawnScans(NamedTuple):
    """Some scans as points in the base frame, each deskewed to its instant."""

    t: Array  # (s,) s since Drive.epoch_ns
    counts: Ints  # (s,) points of each scan
    xy: Floats  # (sum of counts, 2) m


class Picture(NamedTuple):
    """One image of the log with its detections."""

    t: float  # s since Drive.epoch_ns
    omni: bytes  # JPEG or PNG
    omni_type: str  # its media type
    panorama: bytes  # JPEG, the floor at the bottom
    rays: Array  # (k, 2, 2) px in `omni`: inner and outer end of the ray through each thing found
    columns: Array  # (k,) px in the panorama
    verdicts: tuple[str, ...]  # (k,) group of each: matched, rejected, new


class RawTopic(NamedTuple):
    """Numbers of one topic as in the log."""

    topic: str
    t: Array  # (n,) s since Drive.epoch_ns
    fields: Mapping[str, Array]  # name -> (n,)


class RerunScene(msgspec.Struct, frozen=True, dict=True):
    """A drive, its configurations, and the sensors' measurements."""

    name: str  # of the log
    drive: Drive
    estimates: Sequence[Estimates]
    evaluations: Mapping[str, Evaluation]  # by configuration
    sights: Mapping[str, SensorLook] = field(default_factory=dict)  # by sensor
    track: float = 0.3  # m, size of the robot on the map
    table: str = ""  # the result table, Markdown
    scans: DrawnScans | None = None
    pictures: Iterable[Picture] = ()
    picture_rows: int | None = None  # px, height of the panoramas; None without pictures
    raw: Sequence[RawTopic] = ()
    full: bool = False  # nothing is left out of a long log
    palette: Mapping[str, Rgb] = field(default_factory=dict)  # by configuration
    events: Sequence[Event] = ()  # what happened when, in order of time
    thinned: Mapping[str, Drive] = field(default_factory=dict)  # configurations that saw fewer readings

    @property
    def max_points(self) -> int:
        """The most points of a curve that are drawn."""
        return NO_LIMIT if self.full else MAX_CURVE_POINTS

    @property
    def max_scans(self) -> int:
        """The most scans, or readings of another sensor on the map, that are drawn."""
        return NO_LIMIT if self.full else MAX_SCANS

    @property
    def best(self) -> Estimates:
        """The configuration with the most sensors: its map, scan and matches are shown from the start."""
        return max(self.estimates, key=lambda e: len(e.sensors))

    @cached_property
    def extent(self) -> tuple[Array, Array]:
        """Least and greatest corner (2,) [m] of truth, the best path, its walls, and the landmarks."""
        parts: list[Array] = [self.best.pose[:, :2]]
        if self.drive.truth is not None and len(self.drive.truth.xy):
            parts.append(self.drive.truth.xy)
        parts += [wall(line) for line in self.best.final_map if line.hits > 1]
        parts += [np.array([s.landmark]) for s in self.sights.values() if s.landmark is not None]
        points = np.concatenate(parts)
        return points.min(axis=0), points.max(axis=0)

    def colour(self, configuration: str) -> Rgb:
        """Return the colour of a configuration."""
        return self.palette.get(configuration, GREY)

    def seen_by(self, configuration: str) -> Drive:
        """Return the drive with the readings that a configuration used, to which its audit refers."""
        return self.thinned.get(configuration, self.drive)
