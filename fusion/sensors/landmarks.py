"""Landmarks with ids: range and bearing to points of a known map (tags, barcodes, reflectors).

With the detector at s = p + R(theta) m on the robot and the landmark l, d = l - s, a detection is

    range = |d| + offset + noise,    bearing = atan2(d_y, d_x) - theta - yaw + noise

(Thrun, Burgard and Fox 2005, 6.6.2). A detector's range is often off by a constant (the tag's face, the lens): the
offset is a state unless it is given. Every detection also says where its landmark stands; ids whose detections
place them elsewhere than the map does are named, and two that stand in each other's place are called swapped.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Mapping
from typing import Any, ClassVar, cast

import numpy as np
from numpy.typing import NDArray

from locfuse.fusion.chi_square import MAD, chi_square
from locfuse.fusion.data import Array, Colour, Component, Ints, LocfuseError, Measurements, Stream, plausible
from locfuse.fusion.mount import ASK_MOUNT
from locfuse.fusion.se2 import wrap, wrap_all
from locfuse.fusion.sensor import Ask, Belief, Bias, Block, Innovation, Model, Sensor, SensorSettings, WheelMotion

Point = tuple[float, float]
DETECTIONS = "locfuse/msg/Detections"
OFFSET = "range_offset"
MAX_SIGMA_M = 0.3  # m of the robot's position: beyond it a detection does not tell where its landmark stands
MIN_DETECTIONS = 8  # of one landmark before its place is judged
WRONG_SIGMAS = 3.0  # of one detection's place: the median of many is much better known than that
TOUCHING_M = 1e-3  # m: nearer than this a bearing has no direction


class LandmarksSettings(SensorSettings, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """[landmarks]."""

    file: str | None = None  # .csv beside the log: t, id, range [m], bearing [rad]
    map: str | dict[str, Point] | None = None  # .csv with id, x, y [m, map frame], or { "6" = [x, y] }
    x: float = 0.0  # m, detector on the base
    y: float = 0.0
    yaw_deg: float = 0.0
    sigma_range: float = 0.1  # m
    sigma_bearing_deg: float = 1.5
    range_offset: float | None = None  # m that ranges are too long; None: estimated
    sigma_range_offset: float = 0.05  # m: what an estimated offset may be at the start

    def __post_init__(self) -> None:
        """Refuse a detector without noise."""
        super().__post_init__()
        for key in ("sigma_bearing_deg", "sigma_range_offset"):
            if getattr(self, key) <= 0.0:
                raise ValueError(f"{key} = {getattr(self, key)}: no sensor is exact, it must be positive")

    @property
    def places(self) -> dict[int, Point]:
        """The map: id -> x, y [m]. Raises LocfuseError without one, or for an id that is no number."""
        if not isinstance(self.map, dict):
            raise LocfuseError(MISSING, role="landmarks")
        return {_id(key): place for key, place in self.map.items()}


MISSING = "landmarks.map is not set: a .csv with columns id, x, y; --set landmarks.map=landmarks.csv"


def _id(key: str) -> int:
    try:
        return int(key)
    except ValueError:
        raise LocfuseError(f"landmarks.map: id {key!r} is no whole number", role="landmarks") from None


class Landmarks(Sensor):
    """Reads detections of landmarks with ids."""

    name = "landmarks"
    Settings = LandmarksSettings
    components = (Component("range", "m"), Component("bearing", "deg", math.degrees(1.0)))
    states: ClassVar[Mapping[str, tuple[Component, ...]]] = {OFFSET: (Component("range offset", "m"),)}
    colour = Colour("#8f2f5a", "#ff9db5")
    noise_keys = ("sigma_range", "sigma_bearing_deg")
    bias = Bias("range_offset", 1.0, estimated=True)
    extra = True
    sees = "landmark"
    asks: ClassVar[Mapping[str, Ask]] = {
        "map": Ask(
            "landmarks.csv with columns id, x, y in m: not in this log. Where the landmarks stand", needed=True
        ),
        **dict.fromkeys(("x", "y", "yaw_deg"), Ask(f"m, m, degrees: {ASK_MOUNT}", blank=True)),
        "sigma_range": Ask("m: noise of one range"),
        "sigma_bearing_deg": Ask("degrees: noise of one bearing"),
    }
    reads: ClassVar[Mapping[str, tuple[str, ...]]] = {DETECTIONS: ("id", "range", "bearing")}

    def missing(self, settings: LandmarksSettings) -> str | None:
        """Return why nothing can be compared: no map says where the landmarks stand."""
        return MISSING if settings.map is None else None

    def mount(self, settings: LandmarksSettings) -> tuple[float, float, float]:
        """Return where the detector sits on the base: x [m], y [m], yaw [rad]."""
        return settings.x, settings.y, math.radians(settings.yaw_deg)

    def measure(
        self, stream: Stream, settings: LandmarksSettings, wheels: WheelMotion, epoch_ns: int
    ) -> Measurements:
        """Turn detections into z (m, 2) range [m], bearing [rad]; those of one instant are one reading."""
        columns = cast("dict[str, Array]", stream.columns(*self.reads[stream.msgtype]))
        ids: Ints = np.asarray(columns["id"]).astype(np.int64)
        z = np.stack([np.asarray(columns[name], np.float64) for name in ("range", "bearing")], axis=-1)
        dropped = dict(stream.dropped)
        keep = _usable(stream.t_ns, ids, z, settings.places, dropped)
        if len(ids) and not keep.any():
            raise LocfuseError(_nothing(stream.topic, ids, settings.places), role="landmarks")
        t_ns, ids, z = stream.t_ns[keep], ids[keep], z[keep]
        instants, first = np.unique(t_ns, return_index=True)
        sigma, turn = settings.sigma_range, math.radians(settings.sigma_bearing_deg)
        return Measurements(
            t=(instants - epoch_ns) * np.float64(1e-9) + settings.time_offset,
            first=np.append(first, len(ids)).astype(np.int64),
            z=np.stack((z[:, 0], wrap_all(z[:, 1])), axis=-1),
            R_unit=np.broadcast_to(np.diag([1.0, (turn / sigma) ** 2]), (len(ids), 2, 2)).copy(),
            scale=sigma,
            floor=np.zeros((2, 2)),
            extra={"id": ids.astype(np.float64)},
            dropped=dropped,
        )

    def model(self, settings: LandmarksSettings) -> Model:
        """Return the landmarks' side of a new run."""
        return LandmarksModel(settings)


def _usable(
    t_ns: Ints, ids: Ints, z: Array, places: Mapping[int, Point], dropped: dict[str, int]
) -> NDArray[np.bool_]:
    """Return which detections (n,) are numbers, of the map, and the only one of their id; count the others.

    Two detections of one id at one instant are two tags with one id, or a reflection: neither is used.
    """
    finite = plausible(z).all(axis=1) & (z[:, 0] > 0.0)
    known = np.isin(ids, list(places))
    pairs = np.stack((t_ns, ids), axis=-1)
    _, place, counts = np.unique(pairs, axis=0, return_inverse=True, return_counts=True)
    twice = counts[place.reshape(-1)] > 1
    for reason, out in (
        ("not_finite", ~finite),
        ("not_in_map", finite & ~known),
        ("same_id", finite & known & twice),
    ):
        if out.any():
            dropped[reason] = dropped.get(reason, 0) + int(out.sum())
    return np.asarray(finite & known & ~twice)


def _nothing(topic: str, ids: Ints, places: Mapping[int, Point]) -> str:
    seen, have = (", ".join(map(str, sorted(values)[:8])) for values in (set(ids.tolist()), places))
    return f"{topic} detects no landmark of the map: it sees ids {seen}; the map has {have or 'none'}"


class LandmarksModel(Model):
    """range = |d| + offset, bearing = atan2(d) - theta - yaw; d from the detector to the landmark, in the map."""

    settled = True

    def __init__(self, settings: LandmarksSettings) -> None:
        self.places = settings.places
        self.mount = settings.x, settings.y, math.radians(settings.yaw_deg)
        self.threshold = chi_square(settings.gate, 2)
        self.given = settings.range_offset
        self.prior = settings.sigma_range_offset
        self.sigmas = settings.sigma_range, math.radians(settings.sigma_bearing_deg)
        self._seen_at: dict[int, list[tuple[float, float, float]]] = defaultdict(list)  # id -> x, y, sigma [m]

    def blocks(self) -> list[Block]:
        """Return the ranges' offset where it is not given."""
        if self.given is not None:
            return []
        return [Block(OFFSET, np.zeros(1), np.array([[self.prior**2]]), np.zeros(1))]

    def innovations(self, m: Measurements, i: int, belief: Belief) -> list[Innovation]:
        """Compare the detections of one instant with the belief."""
        offset, columns, H_block = self._offset(belief)
        found = []
        for row in range(int(m.first[i]), int(m.first[i + 1])):
            landmark, (z0, z1) = int(m.extra["id"][row]), m.z[row].tolist()
            predicted = predict((belief.x, belief.y, belief.theta), self.places[landmark], self.mount)
            if predicted is None:
                continue
            (distance, bearing), H = predicted
            bend = belief.spread(((H[1][0], H[1][1], 0.0),))[0][0]
            (r0, _), (_, r1) = m.R[row].tolist()
            # a bearing is not linear in the position: second-order variance (sigma_position / distance)^4
            R = ((r0, 0.0), (0.0, r1 + bend * bend))
            y = (z0 - distance - offset, wrap(z1 - bearing))
            self._note_place(landmark, z0 - offset, z1, belief)
            found.append(
                Innovation.of(
                    row, y, H, R, belief, self.threshold, columns=columns, H_block=H_block, landmark=landmark
                )
            )
        return found

    def _offset(self, belief: Belief) -> tuple[float, tuple[int, ...], tuple[tuple[float, ...], ...]]:
        if self.given is not None:
            return self.given, (), ()
        column, now = belief.block(OFFSET)
        return float(now[0]), (column,), ((1.0,), (0.0,))

    def _note_place(self, landmark: int, distance: float, bearing: float, belief: Belief) -> None:
        """Keep where a detection places its landmark, where the robot's own place is known."""
        spread = belief.spread(((1.0, 0.0, 0.0), (0.0, 1.0, 0.0)))
        sigma = math.sqrt(max(spread[0][0], spread[1][1]))
        if sigma > MAX_SIGMA_M:
            return
        x, y = detector_at((belief.x, belief.y, belief.theta), self.mount)
        direction = belief.theta + self.mount[2] + bearing
        own = math.hypot(sigma, self.sigmas[0], distance * self.sigmas[1])
        place = x + distance * math.cos(direction), y + distance * math.sin(direction)
        self._seen_at[landmark].append((*place, own))

    def notes(self, belief: Any) -> list[str]:
        """Say which landmarks stand elsewhere than the map says, and which two stand in each other's place."""
        return wrong_places(self.places, {key: np.array(rows) for key, rows in self._seen_at.items()})


def detector_at(pose: tuple[float, float, float], mount: tuple[float, float, float]) -> Point:
    """Return where the detector is in the map, of a robot at a pose x, y [m], theta [rad]."""
    c, s = math.cos(pose[2]), math.sin(pose[2])
    return pose[0] + c * mount[0] - s * mount[1], pose[1] + s * mount[0] + c * mount[1]


def predict(
    pose: tuple[float, float, float], place: Point, mount: tuple[float, float, float]
) -> tuple[Point, tuple[tuple[float, float, float], tuple[float, float, float]]] | None:
    """Return (range [m], bearing [rad]) of a landmark, and their derivatives by the robot's x, y, theta."""
    x, y = detector_at(pose, mount)
    dx, dy = place[0] - x, place[1] - y
    r = math.hypot(dx, dy)
    if r < TOUCHING_M:
        return None
    # the detector moves by (ax, ay) per radian that the robot turns
    ax, ay = pose[1] - y, x - pose[0]
    q = r * r
    by_range = (-dx / r, -dy / r, -(dx * ax + dy * ay) / r)
    by_bearing = (dy / q, -dx / q, (dy * ax - dx * ay) / q - 1.0)
    return (r, math.atan2(dy, dx) - pose[2] - mount[2]), (by_range, by_bearing)


def wrong_places(places: Mapping[int, Point], seen_at: Mapping[int, Array]) -> list[str]:
    """Return in words which landmarks stand elsewhere than in the map, by where detections (n, 3) place them.

    A row is x, y and its standard deviation [m]. A landmark is wrong where the median lies further from its entry
    than WRONG_SIGMAS of one detection, and two such are swapped where each lies that near the other's entry.
    """
    median = {key: np.median(rows, axis=0) for key, rows in seen_at.items() if len(rows) >= MIN_DETECTIONS}
    reach = {key: WRONG_SIGMAS * max(float(v[2]), _scatter(seen_at[key])) for key, v in median.items()}

    def away(key: int, entry: int) -> float:
        return math.hypot(median[key][0] - places[entry][0], median[key][1] - places[entry][1])

    wrong = sorted(key for key in median if away(key, key) > reach[key])
    if len(wrong) > 2 and 2 * len(wrong) > len(median):
        return [f"{len(wrong)} of {len(median)} landmarks are seen elsewhere than in the map: is [start] right?"]
    words, paired = [], set[int]()
    for a in wrong:
        for b in wrong:
            if a < b and away(a, b) < reach[a] and away(b, a) < reach[b]:
                words.append(f"ids {a} and {b} look swapped in the map: each is seen where the other should stand")
                paired |= {a, b}
    for key in wrong:
        if key not in paired:
            x, y, _ = median[key]
            words.append(
                f"id {key} is seen at ({x:.2f}, {y:.2f}) m, {away(key, key):.2f} m from its place in the map "
                f"({len(seen_at[key])} detections)"
            )
    return words


def _scatter(rows: Array) -> float:
    """Return the robust standard deviation per axis of places (n, 3) [m]."""
    return float(np.median(np.abs(rows[:, :2] - np.median(rows[:, :2], axis=0)), axis=0).max()) / MAD
