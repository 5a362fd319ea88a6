"""Points with ids (landmarks, radio anchors): shared settings, filter models, and selection of readings."""

from __future__ import annotations

import math
from collections import defaultdict
from typing import Any, ClassVar, NamedTuple

import numpy as np

from locfuse.fusion.data import Array, Ints, LocfuseError, Mask, Measurements, RowVerdict
from locfuse.fusion.kernels.ekf import Innovation
from locfuse.fusion.se2 import direction, in_other_frame, sight, transform
from locfuse.fusion.sensor import NO_COLUMNS, Model, ModelResults, SensorSettings
from locfuse.fusion.statistics import clipped_rms
from locfuse.fusion.streams import count_dropped, seconds

Point = tuple[float, float]
Row = tuple[float, float, float]
MIN_DISTANCE_M = 1e-3  # m: nearer than this a bearing has no direction
GROW = "grow"
MIN_SEEN = 3  # readings of an id from which its point is added to an estimated map
MAX_POINTS = 300  # in an estimated map: each reading costs the square of their number, 0.2 ms at 300
MAX_NAMED = 8  # ids in a message
MIN_JUDGED = 8  # readings of one id before its place is judged
MAX_LISTED = 20  # ids in a note


class PointsSettings(SensorSettings, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Settings shared by the sensors that measure points with ids."""

    table: ClassVar[str]  # its table in robot.toml
    what: ClassVar[str]  # what the points are, as a plural
    they: ClassVar[str]  # subject of sentences in notes, such as "the ranges"

    file: str | None = None  # .csv beside the log; its first line names the columns t, id and the measured values
    map: str | dict[str, Point] | None = None  # .csv of id, x, y [m], or {"6" = [x, y]}; None, "grow": estimated
    ignore: tuple[int, ...] = ()  # ids that are not in the map, such as other robots
    x: float = 0.0  # m, detector on the base
    y: float = 0.0  # m, likewise

    @property
    def grows(self) -> bool:
        """Whether the map is estimated: the points' positions are states of the filter."""
        return self.map is None or self.map == GROW

    @property
    def places(self) -> dict[int, Point]:
        """Position of each point, id -> x, y [m]. Raises LocfuseError for an unread map or a wrong id."""
        if self.grows:
            return {}
        if not isinstance(self.map, dict):
            raise LocfuseError(f"{self.table}.map = {self.map} was not read", role=self.table)
        return {self._id(key): place for key, place in self.map.items()}

    def detector(self, poses: Array) -> Array:
        """Return the detector's positions (n, 2) [m] for robot poses (n, 3).

        Headings, which may be NaN, are used only if the detector is mounted off the base (x or y is not 0).
        """
        if self.x == self.y == 0.0:
            return poses[:, :2]
        return transform(poses, np.array([self.x, self.y]))

    def _id(self, key: str) -> int:
        try:
            return int(key)
        except ValueError:
            raise LocfuseError(f"{self.table}.map: id {key!r} is no whole number", role=self.table) from None


class IdReadings(NamedTuple):
    """Readings (n,) of points with ids, of one stream."""

    topic: str
    t_ns: Ints
    ids: Ints
    detector: Ints  # index of the detector, if there are several
    valid: Mask  # whether the numbers of a reading can be measurements


def used(seen: IdReadings, settings: PointsSettings, dropped: dict[str, int]) -> tuple[Mask, list[str]]:
    """Return which readings (n,) are used, and notes on the map; count the others in `dropped` by reason.

    Valid readings of ids in the map are used; if the map is estimated, those of ids that are often seen. Two
    readings of one id by one detector at one time are both left out: a reflection, or two points with one id.
    Raises LocfuseError if there are none.
    """
    ids, valid = seen.ids, seen.valid
    unwanted = np.isin(ids, settings.ignore)
    numbered = (ids >= 0) & ~unwanted
    known = numbered if settings.grows else numbered & np.isin(ids, list(settings.places))
    triples = np.stack((seen.t_ns, ids, seen.detector), axis=-1)
    _, place, counts = np.unique(triples, axis=0, return_inverse=True, return_counts=True)
    twice = counts[place.reshape(-1)] > 1 if len(ids) else np.zeros(0, dtype=bool)
    count_dropped(dropped, nan_or_not_positive=~valid)
    count_dropped(dropped, no_id=valid & (ids < 0), ignored=valid & unwanted)
    count_dropped(dropped, not_in_map=valid & numbered & ~known, same_id=valid & known & twice)
    keep: Mask = valid & known & ~twice
    if len(ids) and not keep.any():
        found = ", ".join(map(str, sorted(set(ids.tolist()))[:MAX_NAMED]))
        have = ", ".join(map(str, sorted(settings.places)[:MAX_NAMED])) or "none"
        of_map = "" if settings.grows else f" of the map's {settings.what}; the map has {have}"
        raise LocfuseError(f"{seen.topic} has no usable reading{of_map}: it sees ids {found}", role=settings.table)
    if not settings.grows:
        return keep, []
    keep, left_out = _often_seen(seen, keep, settings, dropped)
    if settings.map is not None:
        return keep, left_out
    no_map = (
        f"no {settings.table}.map is set: where the {settings.what} stand is estimated (grow); with --set "
        f"{settings.table}.map=FILE, a .csv of id, x, y, {settings.they} also say where the robot is in the room"
    )
    return keep, [no_map, *left_out]


def _often_seen(
    seen: IdReadings, keep: Mask, settings: PointsSettings, dropped: dict[str, int]
) -> tuple[Mask, list[str]]:
    """Return which readings (n,) belong to frequently seen points, and notes on the ids left out.

    Every point is two states. An id that is seen once or twice (false detections, ids of a tracker) adds no
    information about the robot's pose. At most MAX_POINTS ids are used, the most frequent ones.
    """
    names, which, counts = np.unique(seen.ids[keep], return_inverse=True, return_counts=True)
    often = counts >= MIN_SEEN
    if len(names) and not often.any():
        few = f"none of its {len(names)} ids is seen {MIN_SEEN} times"
        raise LocfuseError(f"{seen.topic}: {few}, as a map of {settings.what} needs", role=settings.table)
    most = np.zeros(len(names), dtype=bool)
    most[np.argsort(-counts, kind="stable")[:MAX_POINTS]] = True
    taken, words = keep.copy(), []
    taken[keep] = (often & most)[which.reshape(-1)]
    for reason, out, why in (
        ("seen_rarely", ~often, f"seen less than {MIN_SEEN} times"),
        ("too_many_ids", often & ~most, f"beyond the {MAX_POINTS} seen most often, the cap of a map"),
    ):
        count_dropped(dropped, **{reason: counts[out]})
        if out.any():
            words.append(f"{out.sum()} of {len(names)} ids are not placed in the map: {why}")
    return taken, words


def by_instant(t_ns: Ints, epoch_ns: int, time_offset: float) -> tuple[Array, Ints]:
    """Return the distinct times (k,) [s] of sorted readings, and the first row of each time (k + 1,)."""
    instants, first = np.unique(t_ns, return_index=True)
    t = seconds(instants, epoch_ns, time_offset)
    return t, np.append(first, len(t_ns)).astype(np.int64)


def detector_at(pose: Row, mount: Row) -> Point:
    """Return the detector's position (x, y) [m] in the map, for a robot pose (x [m], y [m], theta [rad])."""
    c, s = direction(pose[2])
    return pose[0] + c * mount[0] - s * mount[1], pose[1] + s * mount[0] + c * mount[1]


def spread_in_other_frame(z: Array, poses: Array) -> float | None:
    """Return the clipped rms [m] of the residuals of `in_other_frame`; None for too few positions."""
    A, y = in_other_frame(z, poses)
    if len(y) <= A.shape[1]:
        return None
    x, *_ = np.linalg.lstsq(A, y, rcond=None)
    return clipped_rms(np.abs(y - A @ x))


def predict(pose: Row, place: Point, mount: Row) -> tuple[Point, tuple[Row, Row]] | None:
    """Return the predicted (range [m], bearing [rad]) of a point, and derivatives by x, y, theta.

    Thrun, Burgard and Fox 2005, 6.6.2.
    """
    seen = sight(pose, place, mount, MIN_DISTANCE_M)
    if seen is None:
        return None
    bearing, distance, by_pose, (by_lever_x, by_lever_y, _) = seen
    turned = -distance * (mount[0] * by_lever_x + mount[1] * by_lever_y)
    by_range = by_pose[1] * distance, -by_pose[0] * distance, turned
    return (distance, bearing), (by_range, by_pose)


class PointsModel(Model):
    """Filter model of points with ids: their places are given, or they are states in a local frame (`joint`).

    The local frame of a map that grows has an unknown origin and direction.
    """

    def __init__(self, settings: PointsSettings, gate: float) -> None:
        """`gate` is the threshold that is recorded with the first reading of a point."""
        self.joint = self.local = self.maps = settings.grows
        self.places = settings.places
        self._what, self._table, self._gate = settings.what, settings.table, gate
        self._known: dict[int, int] = {}  # id of an estimated point -> readings
        self._refused: dict[int, int] = defaultdict(int)

    def compared(
        self, m: Measurements, row: int, point: int, place: Point, at: tuple[int, ...], belief: Any
    ) -> Innovation | None:
        """Return the innovation of one reading; `at` holds the state columns of an estimated position."""
        raise NotImplementedError

    def begins_map(self, m: Measurements, i: int) -> bool:
        """Return whether reading i is the first with points: the local frame begins there."""
        return not self._known and len(rows_of(m, i)) > 0

    def innovations(self, m: Measurements, i: int, belief: Any) -> list[Innovation]:
        """Return the innovations of all points in reading i; the verdict on a new point is "new"."""
        ids, found = m.plain["id"], []
        for row in rows_of(m, i):
            point = int(ids[row])
            if not self.joint:
                seen = self.compared(m, row, point, self.places[point], NO_COLUMNS, belief)
            elif point in self._known:
                column = belief.column(state_of(point, self._table))
                place = belief.value(column), belief.value(column + 1)
                seen = self.compared(m, row, point, place, (column, column + 1), belief)
            else:
                seen = Innovation.unpredicted(row, RowVerdict.NEW, m.z.shape[1], self._gate)
            if seen is not None:
                found.append(seen)
                self._refused[point] += seen.verdict not in (RowVerdict.ACCEPTED, RowVerdict.NEW)
        return found

    def learn(self, m: Measurements, i: int, belief: Any) -> None:
        """Append the points seen for the first time in reading i to the state of a map that grows."""
        for row in rows_of(m, i) if self.joint else ():
            point = int(m.plain["id"][row])
            if point not in self._known:
                belief.own_point(state_of(point, self._table), self.append(m, row, belief))
            self._known[point] = self._known.get(point, 0) + 1

    def append(self, m: Measurements, row: int, belief: Any) -> int:
        """Append a point's position, computed from one reading, to the state; return its first column."""
        raise NotImplementedError

    def results(self, belief: Any) -> ModelResults:
        """Return id and place [m, map frame] of every point of an estimated map."""
        G = belief.frame_pose() or (0.0, 0.0, 0.0)
        c, s = math.cos(G[2]), math.sin(G[2])
        found = []
        for point in sorted(self._known):
            _, (x, y) = belief.block(state_of(point, self._table))
            found.append((point, float(G[0] + c * x - s * y), float(G[1] + s * x + c * y)))
        return ModelResults(points=found)

    def map_notes(self, units: str) -> list[str]:
        """Return notes on the map: number of points, rarely seen points, and points that move."""
        rare = [str(point) for point, n in sorted(self._known.items()) if n < MIN_SEEN]
        words = f"a map of {len(self._known)} {self._what} was made"
        more = f" and {len(rare) - MAX_LISTED} more" if len(rare) > MAX_LISTED else ""
        rarely = f"; seen less than {MIN_SEEN} times: {', '.join(rare[:MAX_LISTED])}{more}" if rare else ""
        moving = [k for k, n in sorted(self._known.items()) if n >= MIN_JUDGED and 2 * self._refused[k] > n]
        if not moving:
            return [words + rarely]
        if len(moving) > MAX_LISTED:
            many = f"{len(moving)} of {len(self._known)} {self._what} do not stand still"
            return [words + rarely, f"{many}: {units}"]
        ids = ", ".join(map(str, moving))
        stand = f"ids {ids} do not stand still" if len(moving) > 1 else f"id {ids} does not stand still"
        fix = f"leave out with {self._table}.ignore=[{ids}]"
        return [words + rarely, f"{stand}, or several {self._what} share it: {fix}"]


def rows_of(m: Measurements, i: int) -> range:
    """Return the rows of Measurements.z that belong to reading i."""
    first = m.plain["first"]
    return range(first[i], first[i + 1])


def state_of(point: int, table: str) -> str:
    """Return the name of a point's state block (x, y)."""
    return f"_{table}_{point}"
