"""Motion from scans alone: every scan is matched with a key scan some decimetres back.

Two scans one after the other say how fast the robot is (velocity): where it will be. From there each scan is
matched with its key, so that errors add up from key to key and not from scan to scan. Where a match says nothing,
along a corridor or where nothing is in sight, the robot goes on as fast as before, and P says how little that is
worth. Nothing looks ahead.

The state is the body's velocity (forward, left, turn), which goes on and is slowly forgotten (Singer's model:
Bar-Shalom, Li and Kirubarajan 2001, 8.2.3). A pair of scans dt apart says of v dt the twist m with an
information H, which is singular along a corridor and zero where nothing matches: there the velocity before is the
best guess. In information form the update needs no inverse of H:

    P^-1 <- P^-1 + dt^2 H,    P^-1 v <- P^-1 v + dt H m

A velocity that nothing corrects is wrong by the same for seconds: its errors add up, and do not average out. From
one pair to the next the error goes on as A = P_after P_before^-1 times what is kept, so that over many pairs it
spreads as independent steps of covariance dt^2 (P + M + M') do, with M = (1 - A)^-1 A P.
"""

from __future__ import annotations

from typing import NamedTuple, cast

import msgspec
import numpy as np
from numpy.typing import NDArray

from locfuse.fusion import se2
from locfuse.fusion.data import Array, Ints, LocfuseError, Stream
from locfuse.fusion.lines.points import SCANS_PER_BLOCK, Longest, left_out
from locfuse.fusion.lines.scans import SCAN_FIELDS, Laser, equal_scans, points_in_base
from locfuse.fusion.robot import VIRTUAL_TRACK, WheelSettings
from locfuse.fusion.scan_matching.clouds import MAX_RANGE_M, Clouds
from locfuse.fusion.scan_matching.match import Matches, Targets, match, overlap, se2_difference, sources_of
from locfuse.fusion.sensor import WheelMotion

from .motion import Wheels
from .read import WheelReading

MAX_POINTS = 240  # of a scan: neighbouring beams say nothing new
# the motion of a robot of which nothing is known yet: none
STANDING = Wheels.from_twists(np.array([0.0, 1.0]), np.zeros((1, 3)), 1.0, 0.0)
SCANS_AT_ONCE = 400
MIN_PAIR_S = 0.15  # between the two scans that tell the speed: in less the robot moves less than a match errs
# of the prior's information while points are paired: it counts in full where the match is fused with it, once
PAIRING_PRIOR_SHARE = 0.1
# a key serves while a scan shares so much with it as its first scan does, both ways: fewer keys add up less error
MIN_SHARED_RATIO, MAX_KEY_SCANS = 0.8, 100
FIRST_PRIOR = np.diag([0.2**-2, 0.2**-2, np.radians(10.0) ** -2])  # of such a guess
FLOOR = np.diag([1e-6, 1e-6, 1e-8])  # m^2, rad^2: two scans of one instant
TURNS_RAD = np.radians([-40.0, -28.0, -18.0, -10.0, 10.0, 18.0, 28.0, 40.0])  # tried where a match fits badly
GOOD_INLIERS, TURN_GAIN = 0.8, 0.1
MIN_INLIERS, MIN_OVERLAP = 0.5, 0.2  # of a match that is believed
REACH_M = 0.6  # how far a point's partner may be at first
MIN_SEEN = 0.01  # of what is said across the walls: what is said along them is noise of their directions
TRUST = 0.3  # of the matches' information: neighbouring scans share errors that the matcher counts as their own
USUAL_NOISE = WheelSettings().noise
NO_RETURNS = "no scan of {topic} sees enough to be matched with another"
USUAL = np.array([0.5, 0.3, 1.0]) ** 2  # (m/s)^2, (m/s)^2, (rad/s)^2: of a robot of which nothing is known
FORGOTTEN_S = np.array([4.0, 4.0, 1.0])  # s after which a velocity says little: turns change fastest


class _Way(msgspec.Struct):
    """The motion of n scans: the step (3,) to each from the one before, and its covariance."""

    t: Array  # (n,) s
    step: Array  # (n, 3) pose of each scan seen from the one before; [0] is none
    P: Array  # (n, 3, 3) of a body's motion in the frame of the scan before
    blind: Array  # (n,) of bool: nothing matched; the velocity before was taken


class MatchedScans(msgspec.Struct, frozen=True):
    """The path of a laser by its scans alone, independent of the settings of wheels and clocks."""

    way: _Way
    epoch_ns: int  # the stream's first stamp
    dropped: dict[str, int]
    notes: tuple[str, ...]

    def reading(self, settings: WheelSettings, time_offset: float) -> WheelReading:
        """Return the path as the motion of wheels.

        `wheels.noise` scales the covariance of the matches: its default leaves it as it was found. The times are
        those of the laser, `time_offset` [s] applied.
        """
        begin = float(self.way.t[0])
        epoch_ns = self.epoch_ns + round((begin + time_offset + settings.time_offset) * 1e9)
        return WheelReading(_wheels(self.way, settings, begin), epoch_ns, dict(self.dropped), self.notes)


def match_scans(stream: Stream, laser: Laser) -> MatchedScans:
    """Return the motion by the scans of a laser alone. Raises LocfuseError if they cannot be matched."""
    if len(stream.t_ns) < 2:
        raise LocfuseError(f"{stream.topic} has {len(stream.t_ns)} scans; two are the least", role="wheels")
    scans = read_scans(stream, laser, STANDING)
    if scans.t[0] == scans.t[-1]:
        raise LocfuseError(f"the {len(scans.t)} scans of {stream.topic} have one stamp", role="wheels")
    way = _matched(scans)
    if scans.skewed:
        way = _matched(read_scans(stream, laser, _wheels(way, WheelSettings())))
    if way.blind[1:].all():
        raise LocfuseError(NO_RETURNS.format(topic=stream.topic), role="wheels")
    return MatchedScans(way, int(stream.t_ns[0]), dict(stream.dropped), _notes(stream, way))


def _notes(stream: Stream, way: _Way) -> tuple[str, ...]:
    words = [f"the motion is matched from scan to scan of {stream.topic}"]
    blind = way.blind[1:]
    if blind.any():
        at = np.flatnonzero(blind) + 1
        words.append(
            f"{len(at)} of {len(blind)} scans match none before them (first at {way.t[at[0]] - way.t[0]:.1f} s): "
            "constant velocity is assumed there"
        )
    return tuple(words)


def _wheels(way: _Way, settings: WheelSettings, begin: float = 0.0) -> Wheels:
    later = np.append(True, np.diff(way.t) > 0.0)  # of two scans of one stamp the first counts
    twist = se2.log(way.step[later][1:])
    return Wheels.from_matches(
        way.t[later] - begin,
        twist,
        way.P[later][1:] * (settings.noise / USUAL_NOISE),
        settings.track or VIRTUAL_TRACK,
        settings.noise,
    )


def _matched(scans: Scans) -> _Way:
    """Match all scans, some hundreds at once: a block begins with the last key of the block before."""
    n = len(scans.t)
    way = _Way(scans.t, np.zeros((n, 3)), np.zeros((n, 3, 3)), np.zeros(n, dtype=bool))
    velocity, begin = standing(), 0
    while begin < n - 1:
        rows = np.arange(begin, min(begin + SCANS_AT_ONCE, n))
        velocity, key = _block(scans, rows, velocity, way)
        begin = int(rows[key]) if rows[-1] < n - 1 else n
    return way


def _block(scans: Scans, rows: Ints, velocity: Velocity, way: _Way) -> tuple[Velocity, int]:
    """Match the scans at these rows (m,); return the velocity at the last key, and its position among them."""
    clouds = scans.clouds(rows)
    if not np.isfinite(clouds.normal[:, 0]).any():
        found, keys = _expected(velocity, scans.t[rows], way, rows)
        return found, keys
    targets, sources = Targets(clouds), sources_of(clouds)
    t = scans.t[rows]
    ends = _apart(t)
    dt = np.diff(t[ends])
    velocities, spread, fits = _followed(targets, sources, ends, dt, velocity)
    twists = np.stack([v.v for v in velocities])
    pair = np.searchsorted(ends, np.arange(1, len(t))) - 1  # of each later scan, that which it lies in
    begun = se2.chain(se2.exp(twists * dt[:, None]))[pair]
    chain = se2.compose(begun, se2.exp(twists[pair] * (t[1:] - t[ends[pair]])[:, None]))
    chain = np.concatenate((np.zeros((1, 3)), chain))
    share = np.diff(t) / np.where(dt > 0.0, dt, 1.0)[pair]
    key = _keys(targets, sources, chain)
    _to_keys(targets, sources, chain, key, share[:, None, None] * np.array(spread)[pair], way, rows)
    way.blind[rows[1:]] = np.logical_not(fits)[pair]
    last = int(key[-1])
    return velocities[pair[last - 1]], (last or len(rows) - 1)


def _apart(t: Array) -> Ints:
    """Return the first of scans (m,), of the others those MIN_PAIR_S [s] after the one before, and the last."""
    chosen = [0]
    for k in range(1, len(t)):
        if k == len(t) - 1 or t[k] - t[chosen[-1]] >= MIN_PAIR_S:
            chosen.append(k)
    return np.array(chosen)


def _expected(velocity: Velocity, t: Array, way: _Way, rows: Ints) -> tuple[Velocity, int]:
    """Continue the motion through scans (m,) without lines."""
    for row, span in zip(rows[1:].tolist(), np.diff(t).tolist(), strict=True):
        velocity = velocity.after(span)
        way.step[row], way.P[row] = se2.exp(velocity.v * span), velocity.spread(velocity, span)
        way.blind[row] = True
    return velocity, len(rows) - 1


def _followed(
    targets: Targets, sources: Clouds, ends: Ints, dt: Array, known: Velocity
) -> tuple[list[Velocity], Array, Array]:
    """Match each of these scans (n + 1,) with the one before, starting from the predicted motion.

    Returns the n velocities found, the covariances (n, 3, 3) of the steps, and which pairs match (n,). One after
    the other: two scans of a corridor match nearly as well half a step too short, and only the velocity so far
    says which it is.
    """
    found, spread, fits = [], [], []
    for k, span in enumerate(dt.tolist()):
        before = known.after(span)
        pair = _neighbours(targets, sources, ends[[k]], ends[[k + 1]], before, span)
        fits.append(bool(_fits(pair)[0]))
        known = before.corrected(span, se2.log(pair.pose)[0], _believed(pair)[0])
        found.append(known)
        spread.append(known.spread(before, span))
    return found, np.array(spread), np.array(fits)


def _neighbours(targets: Targets, sources: Clouds, i: Ints, j: Ints, known: Velocity, dt: float) -> Matches:
    """Match scan j (1,) with scan i, dt [s] before; if that fits badly, try turned starts."""
    guess = se2.exp(known.v * dt)[None]
    prior = inverse(known.P * dt * dt + FLOOR)[None]
    found = match(targets, i, sources, j, guess, PAIRING_PRIOR_SHARE * prior, REACH_M)
    if found.inliers[0] > GOOD_INLIERS and found.overlap[0] > MIN_OVERLAP:
        return found
    n = len(TURNS_RAD)
    guesses = guess + np.outer(TURNS_RAD, (0.0, 0.0, 1.0))
    turned = match(
        targets, i.repeat(n), sources, j.repeat(n), guesses, np.broadcast_to(FIRST_PRIOR, (n, 3, 3)), REACH_M
    )
    score = turned.inliers * np.sqrt(turned.overlap)
    better = score.max() > found.inliers[0] * np.sqrt(found.overlap[0]) + TURN_GAIN
    return turned.take(np.array([int(score.argmax())])) if better else found


def _fits(found: Matches) -> Array:
    return np.asarray((found.inliers > MIN_INLIERS) & (found.overlap > MIN_OVERLAP))


def _believed(found: Matches) -> Array:
    """Return the information (p, 3, 3) of the matches, 0 for those that do not fit."""
    return np.asarray(np.where(_fits(found)[:, None, None], TRUST * seen(found.information), 0.0))


def seen(information: Array) -> Array:
    """Return the information (p, 3, 3) without directions that the walls hardly constrain.

    The noise of the walls' directions passes for information along a corridor, about no motion at all.
    """
    across = information[:, :2, 2]
    place = (
        information[:, :2, :2]
        - across[:, :, None] * across[:, None, :] / np.maximum(information[:, 2, 2], 1e-9)[:, None, None]
    )
    values, vectors = np.linalg.eigh(place)
    d = np.concatenate((vectors[:, :, 0], np.zeros((len(place), 1))), axis=1)  # where least is said
    Hd = np.einsum("nij,nj->ni", information, d)
    about = np.maximum(np.einsum("ni,ni->n", Hd, d), 1e-12)
    without = information - Hd[:, :, None] * Hd[:, None, :] / about[:, None, None]
    return np.asarray(np.where((values[:, 0] < MIN_SEEN * values[:, 1])[:, None, None], without, information))


def _keys(targets: Targets, sources: Clouds, chain: Array) -> Ints:
    """Return the key scan of each scan (m,): the last key that still shares most of its view."""
    key, at, most = np.zeros(len(chain), dtype=np.int64), 0, 0.0
    for k in range(1, len(chain)):
        key[k] = at
        shared = _shared(targets, sources, chain, at, k)
        most = shared if k == at + 1 else most
        if shared < MIN_SHARED_RATIO * most or k - at >= MAX_KEY_SCANS:
            at = k
    return key


def _shared(targets: Targets, sources: Clouds, chain: Array, a: int, b: int) -> float:
    """Return the shares of two scans that the other one sees, multiplied.

    A laser that looks ahead sees all of a later scan in an earlier one, and not the walls that it has passed.
    """
    i, j = np.array([a, b]), np.array([b, a])
    pose = se2.between(chain[i], chain[j])
    return float(overlap(targets, i, sources, j, pose, REACH_M / 2.0).prod())


def _to_keys(
    targets: Targets, sources: Clouds, chain: Array, key: Ints, spread: Array, way: _Way, rows: Ints
) -> None:
    """Match every scan with its key, and store the steps from scan to scan."""
    later = np.arange(1, len(rows))
    mine = key[later]
    guess = se2.between(chain[mine], chain[later])
    total = np.concatenate((np.zeros((1, 3, 3)), np.cumsum(_turned(spread, chain[:-1, 2]), axis=0)))
    P = _turned(total[later] - total[mine], -chain[mine, 2]) + FLOOR
    found = match(targets, mine, sources, later, guess, PAIRING_PRIOR_SHARE * inverse(P), REACH_M / 2.0)
    pose, C = _updated(guess, inverse(P), found)
    of_key = np.concatenate((np.zeros((1, 3)), pose))  # of each scan, seen from its key
    same = key[:-1] == mine  # the scan before has the same key
    start = np.where((same & (later - 1 != mine))[:, None], of_key[:-1], 0.0)
    way.step[rows[1:]] = se2.between(start, pose)
    way.P[rows[1:]] = _spread_evenly(C, mine, start)


def _updated(guess: Array, prior: Array, found: Matches) -> tuple[Array, Array]:
    """Return poses (p, 3) and covariances (p, 3, 3) after combining a prior guess with scan matches."""
    full = np.where(_fits(found)[:, None, None], seen(found.information), 0.0)
    off = se2_difference(found.pose, guess)
    step = np.linalg.solve(prior + full, (full @ off[:, :, None]))[:, :, 0]
    return guess + step, inverse(prior + TRUST * full)


def _spread_evenly(C: Array, key: Ints, start: Array) -> Array:
    """Return a covariance for each step: the covariance of a key's last match, divided over the key's steps.

    The errors of the scans in between are not the steps': a scan is matched with its key, not with the one before.
    """
    _, at, counts = np.unique(key, return_inverse=True, return_counts=True)
    last = np.cumsum(counts) - 1
    return np.asarray(_turned((C[last] / counts[:, None, None])[at], -start[:, 2]))


def _turned(P: Array, theta: Array) -> Array:
    """Return covariances (n, 3, 3) in frames turned by theta (n,) [rad]."""
    R = se2.rotation(theta)
    return np.asarray(R @ P @ R.transpose(0, 2, 1))


# ---- constant velocity ----


def inverse(P: Array) -> Array:
    """Return the inverse of matrices (..., n, n)."""
    return np.asarray(np.linalg.inv(P), np.float64)


class Velocity(NamedTuple):
    """A velocity (3,) [m/s, m/s, rad/s] with its covariance (3, 3)."""

    v: Array
    P: Array

    def after(self, dt: float) -> Velocity:
        """Return the prediction of the velocity dt [s] later."""
        kept = np.exp(-dt / FORGOTTEN_S)
        return Velocity(kept * self.v, self.P * np.outer(kept, kept) + np.diag((1.0 - kept**2) * USUAL))

    def corrected(self, dt: float, twist: Array, information: Array) -> Velocity:
        """Return the velocity corrected by a motion (3,) over dt [s] with this information (3, 3)."""
        prior = inverse(self.P)
        P = inverse(prior + dt * dt * information)
        return Velocity(P @ (prior @ self.v + dt * (information @ twist)), 0.5 * (P + P.T))

    def spread(self, before: Velocity, dt: float) -> Array:
        """Return the covariance (3, 3) of a step of dt [s]; `before` is the velocity's prediction."""
        if dt == 0.0:  # two scans of one stamp: no time to move, and A is 1
            return np.zeros((3, 3))
        A = self.P @ inverse(before.P) * np.exp(-dt / FORGOTTEN_S)
        M = np.linalg.solve(np.eye(3) - A, A @ self.P)
        values, vectors = np.linalg.eigh(dt * dt * (self.P + M + M.T))
        out: Array = (vectors * np.maximum(values, 0.0)) @ vectors.T
        return out


def standing() -> Velocity:
    """Return the prior before the first scan: at rest, since a recording starts before the robot does."""
    return Velocity(np.zeros(3), 0.25 * np.diag(USUAL))


# ---- the scans of a whole log as thinned points in the base frame, and the surfaces of some at a time ----


class Scans(msgspec.Struct, frozen=True):
    """All scans of a log in time order: their points in the base frame, evenly thinned."""

    t: Array  # (n,) s since the stream's first stamp: the instants to which they are deskewed
    points: list[NDArray[np.float32]]  # n of (k, 2) [m], in the order of the beams: an hour of them fits in memory
    origin: Array  # (2,) m, the laser on the base
    skewed: bool  # whether any scan takes time

    def clouds(self, rows: Ints) -> Clouds:
        """Return the points and surfaces of some scans."""
        return Clouds.of_scans([self.points[row].astype(np.float64) for row in rows.tolist()], self.origin)


def read_scans(stream: Stream, laser: Laser, wheels: WheelMotion) -> Scans:
    """Return the scans of a stream; `wheels` gives the robot's motion during each.

    A range that the driver writes where nothing came back is left out, unless `laser` says how far it sees.
    """
    return left_out(laser, lambda understood, longest: _read(stream, understood, wheels, longest))[0]


def _read(stream: Stream, laser: Laser, wheels: WheelMotion, longest: Longest) -> Scans:
    """Return the scans of a stream; `longest` counts all of its ranges."""
    stamps: Array = (stream.t_ns - stream.t_ns[0]) * np.float64(1e-9)
    t = stamps.copy()
    points: list[NDArray[np.float32]] = [np.zeros((0, 2), np.float32)] * len(t)
    skewed = False
    for rows, columns in stream.blocks(*SCAN_FIELDS, rows=SCANS_PER_BLOCK):
        skewed |= bool(np.any(cast("Array", columns["time_increment"]) > 0.0)) and laser.deskew
        for group, scans in equal_scans(columns):
            longest.add(scans)
            at = rows[group]
            xy, t[at] = points_in_base(scans, stamps[at], laser, wheels)
            for row, p in zip(at.tolist(), xy, strict=True):
                points[row] = _thinned(p, laser.mount[:2]).astype(np.float32)
    return Scans(np.maximum.accumulate(t), points, laser.mount[:2], skewed)  # sweeps of different lengths overlap


def _thinned(points: Array, origin: Array) -> Array:
    """Return the points (k, 2) that are near enough to be useful, evenly thinned."""
    near = points[np.hypot(*(points - origin).T) < MAX_RANGE_M]  # False for NaN: no return
    thinned: Array = near[:: max(1, -(-len(near) // MAX_POINTS))]
    return thinned
