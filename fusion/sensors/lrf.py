"""Laser range finder: lines (r, psi) of its scans in the base frame, which are matched with a line map.

The setting `map` has five modes. `first-scan`: the map of the first scan is frozen, as in the paper (eq. 14).
`consider`: the same, but its covariance is used (Schmidt-Kalman). `refine`: its lines are states. `grow`: new
lines are added too. `given`: localisation in the map of an earlier run, whose covariance is used.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import partial
from typing import TYPE_CHECKING, ClassVar, Literal, cast

import numpy as np

from locfuse.fusion.data import Array, Colour, Component, Mask, Measurements, Ragged, Stream, totals
from locfuse.fusion.lines.extract import LineSettings
from locfuse.fusion.lines.points import SCANS_PER_BLOCK, Longest, ScanPoints, left_out
from locfuse.fusion.lines.scans import (
    SCAN_FIELDS,
    Gathered,
    Laser,
    equal_scans,
    from_two_lasers,
    frozen,
    lines_in_base,
    repeats,
    too_many_beams,
    turns,
    wall_floor,
)
from locfuse.fusion.mount import ASK_MOUNT, Mount, MountedSettings, mount_states
from locfuse.fusion.sensor import Ask, Reversal, Sensor, WheelMotion
from locfuse.fusion.streams import seconds

if TYPE_CHECKING:
    from locfuse.fusion.map.tracker import AtlasTracker

ESTIMATING_MAPS = ("refine", "grow")  # maps whose lines are states: the mount can be estimated too
MAX_CURVED_SHARE = 0.05  # of all walls; a larger share gives a note
MapMode = Literal["first-scan", "consider", "refine", "grow", "given"]


class LrfSettings(MountedSettings, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Settings of [lrf] in robot.toml: the laser's mount, its noise and its map."""

    flipped: bool = False  # mounted upside-down: beams run clockwise seen from above
    sigma_range: float = 0.02  # m
    sigma_angle_deg: float = 0.25  # degrees, of a beam
    range_scale: float = 1.0  # true range = scale * reading + offset
    range_offset: float = 0.0  # m
    range_max: float | None = None  # m, readings beyond are not used; not set: that of the scans
    deskew: bool = True  # by time_increment and the wheels
    sweep: Literal["forward", "backward"] = "forward"  # backward: the last beam of a scan is taken first
    min_points: int = 6  # beams of a line
    min_length: float = 0.3  # m
    floor_range: float = 0.002  # m, least sigma of r, since walls are not exact planes
    floor_angle_deg: float = 0.05  # degrees, least sigma of psi
    walls: Literal["found", "flat"] = "found"  # found: both are raised to the observed unevenness of the walls
    map: MapMode = "grow"  # how its line map is made (docs/maps.md)
    map_topic: str | None = None  # nav_msgs/OccupancyGrid of the log, in which it localises (map = given)
    recover: bool = True  # whether to correct wheel slips, and to relocalise a robot that was carried away

    only_fused: ClassVar[frozenset[str]] = MountedSettings.only_fused | {"recover"}


class Lrf(Sensor):
    """The laser range finder: reads LaserScan."""

    name = "lrf"
    locates = True
    Settings = LrfSettings
    components = (Component("r", "m"), Component("psi", "deg", math.degrees(1.0)))
    states = mount_states("lrf")
    drawn = "segments"
    colour = Colour("#1a34b0", "#3a78de")
    noise_keys = ("sigma_range", "sigma_angle_deg")
    measures_by_sigma = True  # scans are split into lines by the noise
    scale_key = "range_scale"
    in_blocks = True
    heading_holds = True
    placed = True
    sees = "line"
    blind_is_severe = True
    unlikely = ("filter", "rear", "back", "b_scan", "tilt", "depth", "camera")
    asks: ClassVar[Mapping[str, Ask]] = {
        **dict.fromkeys(("x", "y", "yaw_deg"), Ask(f"m, m, degrees: {ASK_MOUNT}", blank=True)),
        "sigma_range": Ask("m: noise of one range, by the data sheet"),
    }
    reads: ClassVar[Mapping[str, tuple[str, ...]]] = {"sensor_msgs/msg/LaserScan": SCAN_FIELDS}

    def measure(self, stream: Stream, settings: LrfSettings, wheels: WheelMotion, epoch_ns: int) -> Measurements:
        """Extract the lines of every scan, in the base frame at the middle of the scan (deskewed)."""
        stamps = seconds(stream.t_ns, epoch_ns, settings.time_offset)
        read = partial(self._lines, stream, stamps, wheels)
        (t, found, same), laser, unseen = left_out(laser_of(settings).at_rate(stream.t_ns), read)
        first, z, R_unit, ends, sweep = found.in_order(len(t))
        gone = frozen(same, t, wheels)
        if gone.any():
            kept = np.repeat(~gone, np.diff(first))
            z, R_unit, ends, sweep = z[kept], R_unit[kept], ends[kept], sweep[kept]
            first, t = totals(np.diff(first)[~gone]), t[~gone]
        uneven = np.zeros(2)  # variances of r [m^2] and psi [rad^2] from uneven walls
        if settings.walls == "found":
            own = settings.sigma_range**2 * R_unit[:, 1, 1]
            uneven = np.square(wall_floor(t, first, z, own, wheels, sweep[:, 1]))
        floor = np.maximum(uneven, np.square((settings.floor_range, math.radians(settings.floor_angle_deg))))
        extra = {"ends": ends}
        if sweep.any():
            extra["shared"] = sweep
        if uneven.any():
            extra["uneven"] = np.broadcast_to(uneven, z.shape)  # m^2, rad^2
        unused = {"repeat": int(gone.sum()), "too_many_beams": found.giants, "too_many_lines": found.crowded}
        dropped = {**stream.dropped, **{reason: n for reason, n in unused.items() if n}}
        points = ScanPoints(stream, self.reads[stream.msgtype], stamps, laser, wheels, np.flatnonzero(~gone))
        notes, (offset, angle), walls = [*unseen], np.sqrt(uneven), found.curved + found.straight
        if offset > settings.floor_range or angle > math.radians(settings.floor_angle_deg):
            notes.append(
                f"walls are uneven: line noise is at least {1e3 * offset:.1f} mm and {math.degrees(angle):.2f}° "
                f"(for {1e3 * settings.floor_range:g} mm and {settings.floor_angle_deg:g}°: --set lrf.walls=flat)"
            )
        if found.curved > MAX_CURVED_SHARE * walls:
            notes.append(f"curved walls ({100 * found.curved / walls:.0f} % of the walls seen) are not used")
        return Measurements(
            t, first, z, R_unit, settings.sigma_range, np.diag(floor), extra, dropped, points, tuple(notes),
            two_sources=found.two_sources,
        )  # fmt: skip

    def _lines(
        self, stream: Stream, stamps: Array, wheels: WheelMotion, laser: Laser, longest: Longest
    ) -> tuple[Array, Gathered, Mask]:
        """Return scan times (n,) [s], the lines of the scans, and which scans are copies of the scan before (n,).

        `longest` collects the ranges of all scans.
        """
        t, found, same, before = stamps.copy(), Gathered(), np.zeros(len(stamps), bool), b""
        for rows, columns in stream.blocks(*self.reads[stream.msgtype], rows=SCANS_PER_BLOCK):
            found.giants += too_many_beams(columns)
            found.two_sources |= 0 in rows[:1] and from_two_lasers(columns)
            same[rows], before = repeats(cast("Ragged", columns["ranges"]), before, laser.lines.min_points)
            for group, scans in equal_scans(columns):
                longest.add(scans)
                at = rows[group]
                lines, t[at] = lines_in_base(scans, stamps[at], laser, wheels)
                found.add(at, lines)
        return t, found, same

    def heading(self, m: Measurements) -> tuple[Array, Array]:
        """Return times (n,) [s] and headings (n,) [rad, unwrapped, from 0] by scan-to-scan line matching."""
        return m.t, np.cumsum(turns(m.first, m.z, m.R[:, 1, 1]))

    def reversal(self, settings: LrfSettings, msgtype: str) -> Reversal:
        """Return the fix for a laser that turns opposite to the wheels: it is mounted upside-down."""
        return Reversal("the laser is mounted upside-down", {"flipped": not settings.flipped})

    def model(self, settings: LrfSettings) -> AtlasTracker:
        """Return the filter model of the laser for a new run."""
        from locfuse.fusion.map.tracker import AtlasTracker

        mount = Mount(self.name, settings, observable=settings.map in ESTIMATING_MAPS)
        return AtlasTracker(settings.map, settings.gate, settings.recover, mount)


def laser_of(settings: LrfSettings) -> Laser:
    """Return the `Laser` (mount, range correction, line extraction) with these settings."""
    return Laser(
        mount=np.array([settings.x, settings.y, math.radians(settings.yaw_deg)]),
        flipped=settings.flipped,
        scale=settings.range_scale,
        offset=settings.range_offset,
        range_max=settings.range_max,
        deskew=settings.deskew,
        backward=settings.sweep == "backward",
        lines=LineSettings(
            sigma_range=settings.sigma_range,
            sigma_angle=math.radians(settings.sigma_angle_deg),
            min_points=settings.min_points,
            min_length=settings.min_length,
        ),
    )
