"""Ranges to anchors with ids (ultra-wideband radio, ultrasound beacons), their map known or to be made.

With the antenna at s = p + R(theta) m on the robot and an anchor a,

    range = |s - a| + offset + noise

(Thrun, Burgard and Fox 2005, 6.6.2, without its bearing). Radios measure some centimetres too far: the offset is
a state unless it is given. A range is not linear in the position: with the variance v of the bearing under which
the anchor is seen, it is |s - a| v / 2 longer than that of the mean position, and half the square of that is more
variance (second-order filter: Bar-Shalom, Li and Kirubarajan 2001, 10.3.2).

With a known map the ranges also give the start of the drive, where [start] is not set. Without a map the anchors'
places are states; one range gives no place, so the first stretch of the drive is used for it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, ClassVar, cast

import numpy as np

from locfuse.fusion import se2
from locfuse.fusion.chi_square import chi_square
from locfuse.fusion.data import (
    Array,
    Colour,
    Component,
    Ints,
    LocfuseError,
    Measurements,
    Stream,
    plausible,
)
from locfuse.fusion.kernels.ekf import Innovation
from locfuse.fusion.mount import ASK_MOUNT
from locfuse.fusion.sensor import (
    NO_BLOCK,
    Ask,
    Bias,
    Block,
    FoundStart,
    Model,
    Sensor,
    WheelMotion,
)
from locfuse.fusion.streams import count_dropped

from .points import (
    GrowingPoints,
    Point,
    PointsModel,
    PointsSettings,
    by_instant,
    detector_at,
    nothing_usable,
    often_seen,
    predict,
    usable,
)
from .trilateration import anchor_beside, start_among

RANGES = "locfuse/msg/Ranges"  # a file beside the log, or two fields of a topic
OFFSET = "range_offset_of_anchors"
AHEAD, LEFT, SPREAD = "anchor_ahead", "anchor_left", "anchor_sigma"
REUSED_SIGMA_FACTOR = 3.0  # x the sigma of a place or start that the filter's own ranges gave: they are used again
MIN_SPREAD_M = 0.1
EXACT_M = 1e-6  # of an offset that is given
NO_MAP_NOTE = (
    "no ranges.map is set: where the anchors stand is estimated (grow); with --set ranges.map=FILE, a .csv of "
    "id, x, y, the ranges also say where the robot is in the room"
)


class RangesSettings(PointsSettings, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """[ranges]."""

    table: ClassVar[str] = "ranges"
    what: ClassVar[str] = "anchors"

    fields: tuple[str, str] | None = None  # of the topic's messages: which hold id and range [m]
    sigma: float = 0.1  # m
    offset: float | None = None  # m that ranges are too long; not set: estimated
    sigma_offset: float = 0.2  # m: what an estimated offset may be at the start

    positive: ClassVar[tuple[str, ...]] = (*PointsSettings.positive, "sigma_offset")

    @property
    def searched_sigmas(self) -> tuple[float, float]:
        """Standard deviations of a range and of the offset [m] during the search for a start or a place."""
        return self.sigma, EXACT_M if self.offset is not None else self.sigma_offset

    def detector(self, rel: Array) -> Array:
        """Return the antenna's places (n, 2) [m] on a robot at poses (n, 3)."""
        return se2.compose(rel, np.array([self.x, self.y, 0.0]))[:, :2]


class Ranges(Sensor):
    """Reads ranges to anchors with ids."""

    name = "ranges"
    locates = True
    Settings = RangesSettings
    components = (Component("range", "m"),)
    states: ClassVar[Mapping[str, tuple[Component, ...]]] = {OFFSET: (Component("range offset", "m"),)}
    colour = Colour("#7a5195", "#c59bdd")
    noise_keys = ("sigma",)
    bias = Bias("offset", 1.0, estimated=True)
    extra = True
    sees = "range"
    asks: ClassVar[Mapping[str, Ask]] = {
        "map": Ask("anchors.csv with columns id, x, y in m: where the anchors stand. Else estimated", blank=True),
        **dict.fromkeys(("x", "y"), Ask(f"m: {ASK_MOUNT}", blank=True)),
        "sigma": Ask("m: noise of one range"),
    }
    reads: ClassVar[Mapping[str, tuple[str, ...]]] = {RANGES: ("id", "range")}

    def measure(
        self, stream: Stream, settings: RangesSettings, wheels: WheelMotion, epoch_ns: int
    ) -> Measurements:
        """Turn ranges into z (m, 1) [m]; one instant is one reading."""
        columns = cast("dict[str, Array]", stream.columns(*self.reads[RANGES]))
        ids, z = np.asarray(columns["id"]).astype(np.int64), np.asarray(columns["range"], np.float64)
        dropped = dict(stream.dropped)
        keep = usable(stream.t_ns, ids, np.zeros_like(ids), plausible(z) & (z > 0.0), settings, dropped)
        if len(ids) and not keep.any():
            raise nothing_usable(stream.topic, ids, settings)
        notes, extra = list[str](), dict[str, Array]()
        if settings.grows:
            keep, notes = often_seen(ids, keep, stream.topic, settings, dropped)
            t = (stream.t_ns - epoch_ns) * np.float64(1e-9) + settings.time_offset
            guesses, unclear = _places_of(t, ids, z, keep, settings, wheels)
            count_dropped(dropped, "place_unknown", int((keep & np.isnan(guesses[:, 0])).sum()))
            keep &= ~np.isnan(guesses[:, 0])
            if not keep.any():
                raise LocfuseError(
                    f"{stream.topic}: this drive does not tell where its anchors stand.",
                    role="ranges",
                    fixes=("ranges.map=anchors.csv",),
                    hint="Give their map, a .csv of id, x, y: --set ranges.map=anchors.csv",
                )
            notes = [*([NO_MAP_NOTE] if settings.map is None else []), *notes, *unclear]
            extra = dict(zip((AHEAD, LEFT, SPREAD), guesses[keep].T, strict=True))
        t, first = by_instant(stream.t_ns[keep], epoch_ns, settings.time_offset)
        n = int(keep.sum())
        return Measurements(
            t=t,
            first=first,
            z=z[keep, None],
            R_unit=np.ones((n, 1, 1)),
            scale=settings.sigma,
            floor=np.zeros((1, 1)),
            extra={"id": ids[keep].astype(np.float64), **extra},
            dropped=dropped,
            notes=tuple(notes),
        )

    def start(self, m: Measurements, settings: RangesSettings, wheels: WheelMotion) -> FoundStart | None:
        """Return the start of the drive by known anchors. Raises LocfuseError if it is ambiguous."""
        if settings.grows or not len(m.z):
            return None
        places, t = settings.places, np.repeat(m.t, np.diff(m.first))
        anchors = np.array([places[int(i)] for i in m.extra["id"]])
        rel = wheels.relative(np.full(len(t), t[0]), t)
        ranges = m.z[:, 0] - (settings.offset or 0.0)
        found = start_among(anchors, settings.detector(rel), t, ranges, settings.searched_sigmas)
        if found is None:
            raise LocfuseError(
                "the ranges do not tell where the drive begins (too few anchors, or it goes straight).",
                role="ranges",
                hint="Set [start] x, y, theta_deg",
            )
        back = wheels.relative(t[:1], np.zeros(1))[0]
        pose = se2.compose(found.values[:3], back)
        sigma = REUSED_SIGMA_FACTOR * np.sqrt(np.diag(found.covariance))
        return FoundStart(pose, max(float(sigma[:2].max()), MIN_SPREAD_M), float(sigma[2]))

    def model(self, settings: RangesSettings) -> Model:
        """Return the ranges' model for a new run."""
        return GrowingRanges(settings) if settings.grows else RangesModel(settings)


def _places_of(
    t: Array, ids: Ints, z: Array, keep: Any, settings: RangesSettings, wheels: WheelMotion
) -> tuple[Array, list[str]]:
    """Return the anchor's place for every range (n,), relative to the robot then: ahead, left, sigma (n, 3) [m].

    NaN, and a note, where this drive does not show the place.
    """
    found, words = np.full((len(t), 3), np.nan), list[str]()
    for anchor in np.unique(ids[keep]).tolist():
        rows = np.flatnonzero(keep & (ids == anchor))
        rel = wheels.relative(np.full(len(rows), t[rows[0]]), t[rows])
        ranges = z[rows] - (settings.offset or 0.0)
        answer = anchor_beside(settings.detector(rel), t[rows], ranges, settings.searched_sigmas)
        if answer is None:
            words.append(f"id {anchor}: the drive does not tell where it stands; give ranges.map")
            continue
        sigma = REUSED_SIGMA_FACTOR * math.sqrt(float(np.diag(answer.covariance)[:2].max()))
        found[rows, :2] = se2.rotated(-rel[:, 2], answer.values[:2] - rel[:, :2])
        found[rows, 2] = max(sigma, MIN_SPREAD_M)
    return found, words


class RangesModel(PointsModel):
    """Range as above; |s - a| from the antenna to the anchor, in the map."""

    def __init__(self, settings: RangesSettings) -> None:
        self.places = settings.places
        self.mount = settings.x, settings.y, 0.0
        self.threshold = chi_square(settings.gate, 1)
        self.given = settings.offset
        self.prior = settings.sigma_offset

    def blocks(self) -> list[Block]:
        """Return the ranges' offset, if it is not given."""
        if self.given is not None:
            return []
        return [Block(OFFSET, np.zeros(1), np.array([[self.prior**2]]), np.zeros(1))]

    def compared(
        self, m: Measurements, row: int, anchor: int, place: Point, at: tuple[int, ...], belief: Any
    ) -> Innovation | None:
        """Compare one range with an anchor's place, whose state columns are `at` if it is a state."""
        predicted = predict(belief.pose(), place, self.mount)
        if predicted is None:
            return None
        (distance, _), (by_range, by_bearing) = predicted
        z, variances = m.scalars
        longer = 0.5 * distance * belief.variance((by_bearing[0], by_bearing[1], 0.0))
        offset, columns = self.given or 0.0, at
        of_offset: tuple[float, ...] = ()
        if self.given is None:
            column = belief.column(OFFSET)
            offset, columns, of_offset = belief.value(column), (*at, column), (1.0,)
        # a place changes the range as the robot does, the other way
        of_place = (-by_range[0], -by_range[1]) if at else ()
        H_block = ((*of_place, *of_offset),) if columns else NO_BLOCK
        y, R = z[row] - distance - longer - offset, variances[row] + 2.0 * longer * longer
        seen: Innovation = belief.compare(row, (y,), (by_range,), ((R,),), self.threshold, columns, H_block)
        seen.landmark = anchor
        return seen


class GrowingRanges(GrowingPoints, RangesModel):
    """The same with anchors as states, in the local frame."""

    def __init__(self, settings: RangesSettings) -> None:
        RangesModel.__init__(self, settings)
        GrowingPoints.__init__(self, settings.what, settings.table, self.threshold)

    def append(self, m: Measurements, row: int, belief: Any) -> int:
        """Append the place a = p + R(theta) g, with g the anchor's place relative to the robot by the wheels."""
        ahead, left, sigma = (m.plain[name][row] for name in (AHEAD, LEFT, SPREAD))
        x, y = detector_at(belief.pose(), (ahead, left, 0.0))
        G = np.array([[1.0, 0.0, belief.y - y], [0.0, 1.0, x - belief.x]])
        column: int = belief.augment(np.array([x, y]), G, sigma**2 * np.eye(2))
        return column

    def notes(self, belief: Any) -> list[str]:
        """Return notes: how many anchors the map has."""
        return self.map_notes("are the ranges in m?")
