"""Points with ids (landmarks, radio anchors): their map, and which readings of them can be used."""

from __future__ import annotations

import math
from collections import defaultdict
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from locfuse.fusion.data import Array, Ints, LocfuseError, Measurements
from locfuse.fusion.sensor import Model, SensorSettings
from locfuse.fusion.streams import count_dropped

from .landmark_geometry import Point

GROW = "grow"
MIN_SEEN = 3  # readings of an id from which its point is placed in a map that is made
MAX_POINTS = 300  # in a map that is made: each reading costs the square of their number, 0.2 ms at 300
MAX_NAMED = 8  # ids in a message
MIN_JUDGED = 8  # readings of one id before its place is judged
MAX_LISTED = 20  # ids in a note


class PointsSettings(SensorSettings, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Keys of a sensor that sees points with ids."""

    table: ClassVar[str]  # its table in robot.toml
    what: ClassVar[str]  # what the points are, as a plural

    file: str | None = None  # .csv beside the log, whose first line names t, id and what is measured
    map: str | dict[str, Point] | None = None  # .csv of id, x, y [m], or {"6" = [x, y]}; None, "grow": made
    ignore: tuple[int, ...] = ()  # ids that are not in the map, such as other robots
    x: float = 0.0  # m, detector on the base
    y: float = 0.0  # m, likewise

    @property
    def grows(self) -> bool:
        """Whether the places of the points are unknown, and states of the filter."""
        return self.map is None or self.map == GROW

    @property
    def places(self) -> dict[int, Point]:
        """The map: id -> x, y [m]. Raises LocfuseError without one, or for an id that is no number."""
        if self.grows:
            return {}
        if not isinstance(self.map, dict):
            raise LocfuseError(f"{self.table}.map = {self.map} was not read", role=self.table)
        return {self._id(key): place for key, place in self.map.items()}

    def _id(self, key: str) -> int:
        try:
            return int(key)
        except ValueError:
            raise LocfuseError(f"{self.table}.map: id {key!r} is no whole number", role=self.table) from None


def usable(
    t_ns: Ints,
    ids: Ints,
    detector: Ints,
    valid: NDArray[np.bool_],
    settings: PointsSettings,
    dropped: dict[str, int],
) -> NDArray[np.bool_]:
    """Return which readings (n,) are numbers (`valid`), in the map, and the only one of their id; count the rest.

    Two readings of one id by one detector at one instant are two points with one id, or a reflection: neither is
    used.
    """
    unwanted = np.isin(ids, settings.ignore)
    numbered = (ids >= 0) & ~unwanted
    known = numbered if settings.grows else numbered & np.isin(ids, list(settings.places))
    triples = np.stack((t_ns, ids, detector), axis=-1)
    _, place, counts = np.unique(triples, axis=0, return_inverse=True, return_counts=True)
    twice = counts[place.reshape(-1)] > 1 if len(ids) else np.zeros(0, dtype=bool)
    for reason, out in (
        ("not_finite", ~valid),
        ("no_id", valid & (ids < 0)),
        ("ignored", valid & unwanted),
        ("not_in_map", valid & numbered & ~known),
        ("same_id", valid & known & twice),
    ):
        count_dropped(dropped, reason, int(out.sum()))
    keep: NDArray[np.bool_] = valid & known & ~twice
    return keep


def nothing_usable(topic: str, ids: Ints, settings: PointsSettings) -> LocfuseError:
    """Return the error of readings of which none can be used."""
    seen = ", ".join(map(str, sorted(set(ids.tolist()))[:MAX_NAMED]))
    have = ", ".join(map(str, sorted(settings.places)[:MAX_NAMED])) or "none"
    of_map = "" if settings.grows else f" of the map's {settings.what}; the map has {have}"
    return LocfuseError(f"{topic} has no usable reading{of_map}: it sees ids {seen}", role=settings.table)


def often_seen(
    ids: Ints, keep: NDArray[np.bool_], topic: str, settings: PointsSettings, dropped: dict[str, int]
) -> tuple[NDArray[np.bool_], list[str]]:
    """Return which readings (n,) are of points to be placed, and in words how many ids are left out.

    Every point is two states. An id that is seen once or twice (a tracker that counts up, false detections) adds
    no information about the robot's pose, and of more ids than MAX_POINTS those seen most often are taken.
    """
    names, which, counts = np.unique(ids[keep], return_inverse=True, return_counts=True)
    often = counts >= MIN_SEEN
    if len(names) and not often.any():
        raise LocfuseError(
            f"{topic}: none of its {len(names)} ids is seen {MIN_SEEN} times, as a map of {settings.what} needs",
            role=settings.table,
        )
    most = np.zeros(len(names), dtype=bool)
    most[np.argsort(-counts, kind="stable")[:MAX_POINTS]] = True
    taken, words = keep.copy(), []
    taken[keep] = (often & most)[which.reshape(-1)]
    for reason, out, why in (
        ("seen_rarely", ~often, f"seen less than {MIN_SEEN} times"),
        ("too_many_ids", often & ~most, f"beyond the {MAX_POINTS} seen most often, the cap of a map"),
    ):
        count_dropped(dropped, reason, int(counts[out].sum()))
        if out.any():
            words.append(f"{out.sum()} of {len(names)} ids are not placed in the map: {why}")
    return taken, words


def by_instant(t_ns: Ints, epoch_ns: int, time_offset: float) -> tuple[Array, Ints]:
    """Return the times (k,) [s] of readings that share an instant, and where the rows of each begin, (k + 1,)."""
    instants, first = np.unique(t_ns, return_index=True)
    t: Array = (instants - epoch_ns) * np.float64(1e-9) + time_offset
    return t, np.append(first, len(t_ns)).astype(np.int64)


class GrowingPoints(Model):
    """A model whose points are states in the local frame: no known place is seen, nor north."""

    joint = True
    local = True
    maps = True

    def __init__(self, what: str, table: str) -> None:
        self._what, self._table = what, table
        self._known: dict[int, int] = {}  # id -> readings
        self._refused: dict[int, int] = defaultdict(int)

    def begins_map(self, m: Measurements, i: int) -> bool:
        """Return whether these are the first readings, with which a local frame can begin."""
        return not self._known and len(rows_of(m, i)) > 0

    def points(self, belief: Any) -> list[tuple[int, float, float]]:
        """Return id and place [m, map frame] of every point, as the run ended."""
        G = belief.frame_pose() or (0.0, 0.0, 0.0)
        c, s = math.cos(G[2]), math.sin(G[2])
        found = []
        for point in sorted(self._known):
            _, (x, y) = belief.block(state_of(point, self._table))
            found.append((point, float(G[0] + c * x - s * y), float(G[1] + s * x + c * y)))
        return found

    def map_notes(self, units: str) -> list[str]:
        """Say how many points the map has, which were seen too rarely to be in it for sure, and which move."""
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
    """Return the rows of reading i."""
    first = m.plain["first"]
    return range(first[i], first[i + 1])


def state_of(point: int, table: str) -> str:
    """Return the name of the two states that are a point's place."""
    return f"_{table}_{point}"
