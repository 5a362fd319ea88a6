"""Ranges to anchors with ids (ultra-wideband radio, ultrasound beacons) on a given or an estimated map.

With the antenna at s = p + R(theta) m on the robot and an anchor a,

    range = |s - a| + offset + noise

(Thrun, Burgard and Fox 2005, 6.6.2, without its bearing). Radios measure some centimetres too far: the offset is
a state unless it is configured. A range is not linear in the position. Let v be the variance of the bearing to the
anchor. Then the mean range is b = |s - a| v / 2 longer than the range from the mean position, and b^2 / 2 is added
to the variance (second-order filter: Bar-Shalom, Li and Kirubarajan 2001, 10.3.2).

With a known map the ranges also give the start of the drive, where [start] is not set. Without a map the anchors'
positions are states, initialised by the ranges from the first part of the drive.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any, ClassVar, NamedTuple

import numpy as np

from locfuse.fusion import se2
from locfuse.fusion.data import Array, Colour, Component, Ints, LocfuseError, Measurements, Stream, plausible
from locfuse.fusion.kernels.ekf import Innovation
from locfuse.fusion.mount import ASK_MOUNT
from locfuse.fusion.sensor import Ask, Bias, Block, FoundStart, Model, Sensor, WheelMotion, given_or_state
from locfuse.fusion.statistics import chi_square, clipped_rms, robust_sigma
from locfuse.fusion.streams import arrays, count_dropped, seconds

from .points import IdReadings, Point, PointsModel, PointsSettings, by_instant, detector_at, predict, used

STRETCHES_S = (5.0, 10.0, 20.0, 40.0, 80.0)  # initial parts of the drive: the shortest unambiguous one is used
MIN_ROWS = 8
MAX_FIT_ROUNDS = 60  # of the refinement, at most
SAME_DIGITS = 3  # decimals of m and rad in which two equal solutions agree
CAUCHY_SIGMAS = 2.0  # residuals from which a range counts for less
CLEARLY_BETTER = 8.0  # least difference in cost (half a chi-square) of other solutions to the best one
APART_M, APART_RAD = 0.3, math.radians(20.0)  # solutions further apart are different ones
MAX_SIGMA_M, MAX_SIGMA_RAD = 0.5, math.radians(15.0)  # largest sigmas of an accepted solution
GRID_PLACES, GRID_DIRECTIONS = 5, 12  # first guesses: positions along each side of the anchors' box, headings
HEADING_ENTRY = slice(2, -1)  # the heading in a guess, between position and offset; empty if there is none
Predict = Callable[[Array], tuple[Array, Array]]  # guesses (s, k) -> ranges (s, n), derivatives (s, n, k)
RANGES = "locfuse/msg/Ranges"  # a file beside the log, or two fields of a topic
OFFSET = "range_offset_of_anchors"
AHEAD, LEFT, SPREAD = "anchor_ahead", "anchor_left", "anchor_sigma"
REUSED_SIGMA_FACTOR = 3.0  # on the sigma of a start or anchor by ranges: the filter uses these ranges too
MIN_SPREAD_M = 0.1
UNITS = {150.0: "mm", 15.0: "cm", 2.5: "feet"}  # by how many times values are larger than possible in metres
MIN_MOVED_M = 0.5  # least motion of the robot, to know the unit of its ranges
EXACT_M = 1e-6  # sigma of a given offset


class RangeFit(NamedTuple):
    """Least-squares fit of positions (and perhaps a heading) to ranges."""

    values: Array  # (k,) x, y [m], perhaps theta [rad]; last the offset of the ranges [m]
    covariance: Array  # (k, k)


def start_among(
    anchors: Array, seen: Array, t: Array, ranges: Array, sigmas: tuple[float, float]
) -> RangeFit | None:
    """Return the robot's pose (x, y, theta) at the first range and the range offset; None if ambiguous.

    For each of n ranges: the anchor's position `anchors` (n, 2) [m, map frame], the antenna's position `seen` (n,
    2) [m] by the wheels, in the frame of the robot at the first range, the time t (n,) [s] and the range (n,) [m].
    `sigmas` [m] are those of a range and of the offset.
    """
    low, high = anchors.min(axis=0), anchors.max(axis=0)
    margin = 0.25 * float(np.hypot(*(high - low)))
    x, y = (np.linspace(a - margin, b + margin, GRID_PLACES) for a, b in zip(low, high, strict=True))
    turns = np.arange(GRID_DIRECTIONS) * (2.0 * np.pi / GRID_DIRECTIONS)
    guesses = np.stack([g.ravel() for g in np.meshgrid(x, y, turns, [0.0], indexing="ij")], axis=-1)
    return _shortest_fit(anchors, seen, guesses, t, ranges, sigmas)


def anchor_beside(
    seen: Array,
    t: Array,
    ranges: Array,
    sigmas: tuple[float, float],
    stretches: Sequence[float] = STRETCHES_S,
) -> RangeFit | None:
    """Fit an anchor's position and the range offset to ranges (n,) [m]; None if the fit is ambiguous.

    The position is in the frame of the antenna positions `seen` (n, 2) [m] at times t (n,) [s]; `sigmas` [m] are
    those of a range and of the offset. The first of the `stretches` [s] with an unambiguous fit is used.
    """
    turns = np.arange(GRID_DIRECTIONS) * (2.0 * np.pi / GRID_DIRECTIONS)
    around = seen[0] + ranges[0] * np.stack((np.cos(turns), np.sin(turns)), axis=-1)
    guesses = np.column_stack((around, np.zeros(GRID_DIRECTIONS)))
    return _shortest_fit(np.zeros_like(seen), -seen, guesses, t, ranges, sigmas, stretches)


def _predicted(v: Array, anchors: Array, seen: Array) -> tuple[Array, Array]:
    """Return ranges (s, n) [m] and derivatives (s, n, k) for guesses (s, k): position, heading, offset."""
    turns = v.shape[1] == 4
    c, s = (np.cos(v[:, 2:3]), np.sin(v[:, 2:3])) if turns else (np.ones((1, 1)), np.zeros((1, 1)))
    ahead, left = c * seen[:, 0] - s * seen[:, 1], s * seen[:, 0] + c * seen[:, 1]
    dx, dy = v[:, 0:1] + ahead - anchors[:, 0], v[:, 1:2] + left - anchors[:, 1]
    h = np.maximum(np.hypot(dx, dy), 1e-6)
    by_turn = ((dy * ahead - dx * left) / h,) if turns else ()
    return h + v[:, -1:], np.stack((dx / h, dy / h, *by_turn, np.ones_like(h)), axis=-1)


def _shortest_fit(
    anchors: Array,
    seen: Array,
    guesses: Array,
    t: Array,
    ranges: Array,
    sigmas: tuple[float, float],
    stretches: Sequence[float] = STRETCHES_S,
) -> RangeFit | None:
    """Fit longer and longer initial parts of the drive; return the first unambiguous fit, else None."""
    tried = 0
    for length in stretches:
        n = int(np.searchsorted(t, t[0] + length, side="right"))
        if n < MIN_ROWS or n == tried:
            continue
        tried = n
        predict = partial(_predicted, anchors=anchors[:n], seen=seen[:n])
        answer = _unambiguous(predict, guesses, ranges[:n], sigmas)
        if answer is not None:
            return answer
    return None


def _unambiguous(predict: Predict, guesses: Array, ranges: Array, sigmas: tuple[float, float]) -> RangeFit | None:
    """Return the best fit if its sigmas are small and every distant solution costs clearly more; else None."""
    values, costs, scatter = _refined(predict, guesses, ranges, sigmas)
    best = values[np.argmin(costs)]
    _, J = predict(best[None])
    information = np.einsum("nj,nk->jk", J[0], J[0]) / max(sigmas[0], scatter) ** 2
    information[-1, -1] += 1.0 / sigmas[1] ** 2
    if np.linalg.cond(information) > 1e12:
        return None
    covariance: Array = np.linalg.inv(information)
    sigma = np.sqrt(np.diag(covariance))
    if np.hypot(sigma[0], sigma[1]) > MAX_SIGMA_M or (sigma[HEADING_ENTRY] > MAX_SIGMA_RAD).any():
        return None
    elsewhere = np.hypot(*(values[:, :2] - best[:2]).T) > APART_M
    elsewhere |= (np.abs(se2.wrap_all(values[:, HEADING_ENTRY] - best[HEADING_ENTRY])) > APART_RAD).any(axis=1)
    rival = costs[elsewhere].min(initial=np.inf)
    return RangeFit(best, covariance) if rival - costs.min() > CLEARLY_BETTER else None


def _refined(
    predict: Predict, guesses: Array, ranges: Array, sigmas: tuple[float, float]
) -> tuple[Array, Array, float]:
    """Return refined guesses (s, k), their costs (s,), and the robust residual spread [m] of the best guess.

    Residuals are divided by that spread where it exceeds the sigma (wheels drift).
    """
    sigma, x = sigmas[0], guesses
    for _ in range(2):  # with the ranges' sigma, then with the scatter that was found
        x, costs = _descended(predict, x, ranges, (sigma, sigmas[1]))
        h, _ = predict(x[np.argmin(costs)][None])
        scatter = robust_sigma(ranges - h[0])
        sigma = max(sigmas[0], scatter)
        x[:, HEADING_ENTRY] = se2.wrap_all(x[:, HEADING_ENTRY])
        _, first = np.unique(np.round(x, SAME_DIGITS), axis=0, return_index=True)
        x, costs = x[first], costs[first]  # most guesses reach the same few solutions
    return x, costs, scatter


def _descended(predict: Predict, x: Array, ranges: Array, sigmas: tuple[float, float]) -> tuple[Array, Array]:
    """Return guesses (s, k) refined by at most MAX_FIT_ROUNDS Levenberg-Marquardt steps, and their costs (s,)."""
    damping = np.full(len(x), 1e-2)
    cost, A, g = _normal(predict, x, ranges, sigmas)
    diagonal = np.arange(x.shape[1])
    for _ in range(MAX_FIT_ROUNDS):
        damped = A.copy()
        damped[:, diagonal, diagonal] *= 1.0 + damping[:, None]
        damped[:, diagonal, diagonal] += 1e-9
        tried = x + np.linalg.solve(damped, g[:, :, None])[:, :, 0]
        cost_there, A_there, g_there = _normal(predict, tried, ranges, sigmas)
        better = cost_there < cost
        if not better.any():
            break
        x = np.where(better[:, None], tried, x)
        cost = np.where(better, cost_there, cost)
        A, g = np.where(better[:, None, None], A_there, A), np.where(better[:, None], g_there, g)
        damping = np.clip(np.where(better, damping / 3.0, damping * 4.0), 1e-6, 1e6)
    return x, cost


def _normal(predict: Predict, x: Array, ranges: Array, sigmas: tuple[float, float]) -> tuple[Array, Array, Array]:
    """Return the robust cost (s,) of guesses x (s, k), and its normal equations A (s, k, k), g (s, k)."""
    h, J = predict(x)
    e = (ranges - h) / sigmas[0]
    square = np.square(e / CAUCHY_SIGMAS)
    cost = 0.5 * (CAUCHY_SIGMAS**2 * np.log1p(square).sum(axis=1) + np.square(x[:, -1] / sigmas[1]))
    weight = 1.0 / (1.0 + square)
    A = np.einsum("sn,snj,snk->sjk", weight, J, J) / sigmas[0] ** 2
    g = np.einsum("sn,snj->sj", weight * e, J) / sigmas[0]
    A[:, -1, -1] += 1.0 / sigmas[1] ** 2
    g[:, -1] -= x[:, -1] / sigmas[1] ** 2
    return cost, A, g


class RangesSettings(PointsSettings, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Settings of [ranges] in robot.toml."""

    table: ClassVar[str] = "ranges"
    what: ClassVar[str] = "anchors"
    they: ClassVar[str] = "the ranges"

    fields: tuple[str, str] | None = None  # fields with id and range [m] in the topic's messages
    sigma: float = 0.1  # m
    offset: float | None = None  # m by which ranges are too long; not set: estimated
    sigma_offset: float = 0.2  # m, 1 sigma of an estimated offset at the start

    positive: ClassVar[tuple[str, ...]] = (*PointsSettings.positive, "sigma_offset")

    @property
    def searched_sigmas(self) -> tuple[float, float]:
        """Standard deviations (range, range offset) [m] for the search of a start pose or an anchor position."""
        return self.sigma, EXACT_M if self.offset is not None else self.sigma_offset


class Ranges(Sensor):
    """The range sensor: reads ranges to anchors with ids."""

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
        """Return ranges z (m, 1) [m] with anchor ids as measurements; ranges with equal stamps are one reading."""
        columns = arrays(stream, *self.reads[RANGES])
        ids, z = np.asarray(columns["id"]).astype(np.int64), np.asarray(columns["range"], np.float64)
        dropped = dict(stream.dropped)
        valid = np.asarray(plausible(z) & (z > 0.0))
        seen = IdReadings(stream.topic, stream.t_ns, ids, np.zeros_like(ids), valid)
        (keep, notes), extra = used(seen, settings, dropped), dict[str, Array]()
        if settings.grows:
            t = seconds(stream.t_ns, epoch_ns, settings.time_offset)
            guesses, unclear = _places_of(t, ids, z, keep, settings, wheels)
            count_dropped(dropped, place_unknown=keep & np.isnan(guesses[:, 0]))
            keep &= ~np.isnan(guesses[:, 0])
            if not keep.any():
                raise LocfuseError(
                    f"{stream.topic}: this drive does not tell where its anchors stand.",
                    role="ranges",
                    fixes=("ranges.map=anchors.csv",),
                    hint="Give their map, a .csv of id, x, y: --set ranges.map=anchors.csv",
                )
            notes += unclear
            extra = dict(zip((AHEAD, LEFT, SPREAD), guesses[keep].T, strict=True))
        t, first = by_instant(stream.t_ns[keep], epoch_ns, settings.time_offset)
        _refuse_other_units(stream.topic, np.repeat(t, np.diff(first)), ids[keep], z[keep], settings, wheels)
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
        """Return the robot's start pose from ranges to known anchors. Raises LocfuseError if it is ambiguous."""
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

    def misfit(self, m: Measurements, settings: RangesSettings, poses: Array) -> float | None:
        """Return the spread [m] of range errors, each anchor's median apart; None for an estimated map."""
        ids = m.extra["id"]
        if settings.grows or not len(ids):
            return None
        places = settings.places
        anchors = np.array([places[int(i)] for i in ids])
        eye = settings.detector(np.repeat(poses, np.diff(m.first), axis=0))
        off = m.z[:, 0] - np.hypot(*(eye - anchors).T)
        for one in np.unique(ids):
            off[ids == one] -= np.median(off[ids == one])
        return clipped_rms(off)

    def model(self, settings: RangesSettings) -> Model:
        """Return the filter model of the ranges for a new run."""
        return RangesModel(settings)


def _refuse_other_units(
    topic: str, t: Array, ids: Ints, z: Array, settings: RangesSettings, wheels: WheelMotion
) -> None:
    """Raise LocfuseError if ranges z (n,), or the map, are not in metres.

    A range changes at most as far as the robot moves, and two anchors stand at most as far apart as the sum of
    their ranges.
    """
    ways = []
    for one in np.unique(ids):
        rows = np.flatnonzero(ids == one)
        moved = wheels.relative(np.full(len(rows), t[rows[0]]), t[rows])[:, :2]
        ways.append((float(np.ptp(z[rows])), 2.0 * float(np.hypot(*moved.T).max())))
    most = [change / far for change, far in ways if far > MIN_MOVED_M]
    unit = _unit(float(np.median(most))) if most else None
    if unit is not None:
        words = f"ranges change {np.median(most):.0f} times as much as the robot moves: they look like {unit}"
        raise LocfuseError(f"{topic}: {words}. Write metres", role="ranges")
    places = np.array([settings.places[int(i)] for i in ids]) if not settings.grows else np.zeros((0, 2))
    apart = np.hypot(*np.diff(places, axis=0).T)[np.diff(ids) != 0] if len(places) else np.zeros(0)
    sums = (z[1:] + z[:-1])[np.diff(ids) != 0]
    unit = _unit(float(np.median(apart / sums))) if len(apart) >= MIN_ROWS else None
    if unit is not None:
        words = f"its anchors stand {np.median(apart / sums):.0f} times as far apart as the ranges allow"
        raise LocfuseError(f"ranges.map: {words}: it looks like {unit}. Write metres", role="ranges")


def _unit(times: float) -> str | None:
    """Return the likely unit, such as "mm", of ranges `times` as large as is possible in metres; None: metres."""
    return next((unit for least, unit in UNITS.items() if times > least), None)


def _places_of(
    t: Array, ids: Ints, z: Array, keep: Any, settings: RangesSettings, wheels: WheelMotion
) -> tuple[Array, list[str]]:
    """Return the estimated anchor of each range, in the robot's frame: (n, 3) x, y, sigma [m]; and notes.

    If an anchor's position is ambiguous, its rows are NaN and a note lists it.
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
    """Model of the range from the antenna s to an anchor a: |s - a| + offset."""

    def __init__(self, settings: RangesSettings) -> None:
        self.threshold = chi_square(settings.gate, 1)
        super().__init__(settings, self.threshold)
        self.mount = settings.x, settings.y, 0.0
        self.given = settings.offset
        self.prior = settings.sigma_offset

    def blocks(self) -> list[Block]:
        """Return the state block of the range offset; empty if the offset is given."""
        if self.given is not None:
            return []
        return [Block(OFFSET, np.zeros(1), np.array([[self.prior**2]]), np.zeros(1))]

    def compared(
        self, m: Measurements, row: int, anchor: int, place: Point, at: tuple[int, ...], belief: Any
    ) -> Innovation | None:
        """Return the innovation of one range to an anchor at `place`; None if no range can be predicted.

        `at` are the state columns of an estimated anchor position, () for an anchor with a given one.
        """
        predicted = predict(belief.pose(), place, self.mount)
        if predicted is None:
            return None
        (distance, _), (by_range, by_bearing) = predicted
        z, variances = m.scalars
        longer = 0.5 * distance * belief.variance((by_bearing[0], by_bearing[1], 0.0))
        offset, of_offset = given_or_state(self.given, OFFSET, belief)
        columns = at + of_offset
        # the derivative by the anchor's position is minus that by the robot's
        of_place = (-by_range[0], -by_range[1]) if at else ()
        H_block = ((*of_place, *(1.0,) * len(of_offset)),) if columns else ()
        y, R = z[row] - distance - longer - offset, variances[row] + 2.0 * longer * longer
        seen: Innovation = belief.compare(row, (y,), (by_range,), ((R,),), self.threshold, columns, H_block)
        seen.landmark = anchor
        return seen

    def append(self, m: Measurements, row: int, belief: Any) -> int:
        """Append an anchor's position a = p + R(theta) g to the state, with g relative to the robot."""
        ahead, left, sigma = (m.plain[name][row] for name in (AHEAD, LEFT, SPREAD))
        x, y = detector_at(belief.pose(), (ahead, left, 0.0))
        G = np.array([[1.0, 0.0, belief.y - y], [0.0, 1.0, x - belief.x]])
        column: int = belief.augment(np.array([x, y]), G, sigma**2 * np.eye(2))
        return column

    def notes(self, belief: Any) -> list[str]:
        """Return notes on the map: the number of anchors, rarely seen anchors, and anchors that move."""
        return self.map_notes("are the ranges in m?") if self.joint else []
