"""Odometry by scan matching: every scan is matched with a key scan some decimetres back.

Consecutive scans give the velocity, which predicts the next pose. From there each scan is matched with its key
scan, so that errors add up from key to key and not from scan to scan. In directions without information (along a
corridor, or without walls) the velocity is kept, and P grows. The method is causal.

The state is the body's velocity (forward, left, turn), which decays slowly (Singer's model: Bar-Shalom, Li and
Kirubarajan 2001, 8.2.3). A pair of scans dt apart measures the twist m of v dt with the information H, which is
singular along a corridor and zero without a match. In information form the update needs no inverse of H:

    P^-1 <- P^-1 + dt^2 H,    P^-1 v <- P^-1 v + dt H m

The error of an uncorrected velocity lasts for seconds, so the errors of consecutive steps are correlated. From one
pair to the next the error is multiplied by A = P_after P_before^-1 and the decay, so that over many pairs the pose
error is that of independent steps with covariance dt^2 (P + M + M'), M = (1 - A)^-1 A P.
"""

from __future__ import annotations

from typing import NamedTuple, cast

import msgspec
import numpy as np
from numpy.typing import NDArray

from locfuse.fusion import se2
from locfuse.fusion.data import Array, Ints, LocfuseError, Stream, spaced, totals
from locfuse.fusion.lines.points import SCANS_PER_BLOCK, Longest, left_out
from locfuse.fusion.lines.scans import SCAN_FIELDS, Laser, equal_scans, points_in_base
from locfuse.fusion.robot import VIRTUAL_TRACK, WheelSettings
from locfuse.fusion.scan_matching.match import Clouds, Matches, Targets, few, match, overlap, sources_of
from locfuse.fusion.sensor import WheelMotion
from locfuse.fusion.streams import seconds

from .motion import Wheels
from .read import WheelReading

MAX_POINTS = 240  # points of a scan that are used: more neighbouring beams add no information
# the first pass, before scans are matched, assumes a robot at rest
STANDING = Wheels.from_twists(np.array([0.0, 1.0]), np.zeros((1, 3)), 1.0, 0.0)
SCANS_AT_ONCE = 400
MIN_PAIR_S = 0.15  # least time between two scans for a velocity: the motion in less is below the error of a match
# share of the prior's information used while matching; afterwards match and full prior are combined
PAIRING_PRIOR_SHARE = 0.1
# a key is used while its overlap with a scan is at least this share of its overlap with the first scan after it
MIN_SHARED_RATIO, MAX_KEY_SCANS = 0.8, 100
FLOOR = np.diag([1e-6, 1e-6, 1e-8])  # m^2, rad^2: least covariance, for two scans with one stamp
# initial turns tried after a bad match
TURNS_RAD = np.radians([-40.0, -28.0, -18.0, -10.0, 10.0, 18.0, 28.0, 40.0])
FIRST_PRIOR = np.diag([0.2**-2, 0.2**-2, np.radians(10.0) ** -2])  # information of such an initial guess
GOOD_INLIERS, TURN_GAIN = 0.8, 0.1
MIN_INLIERS, MIN_OVERLAP = 0.5, 0.2  # of an accepted match
REACH_M = 0.6  # largest distance between matched points
MIN_SEEN = 0.01  # least information along walls relative to that across: less is noise of the wall directions
INFORMATION_SHARE = 0.3  # factor on the matches' information: errors of neighbouring scans are correlated
USUAL_NOISE = WheelSettings().noise
NO_RETURNS = "no scan of {topic} sees enough to be matched with another"
# (m/s)^2, (m/s)^2, (rad/s)^2: prior variance of a robot's velocity
USUAL_VARIANCES = np.array([0.5, 0.3, 1.0]) ** 2
DECAY_S = np.array([4.0, 4.0, 1.0])  # s, decay times of the velocity: turns change fastest


class _MatchedPath(msgspec.Struct):
    """Motion of n scans: for each scan the step (3,) from the one before, and its covariance."""

    t: Array  # (n,) s
    step: Array  # (n, 3) pose of each scan relative to the one before; [0] is zero
    P: Array  # (n, 3, 3) covariance of the step, in the frame of the scan before
    blind: Array  # (n,) of bool: no match; constant velocity was assumed


class MatchedScans(msgspec.Struct, frozen=True):
    """Path of a laser by scan matching, independent of the settings of wheels and clocks."""

    path: _MatchedPath
    epoch_ns: int  # the stream's first stamp
    dropped: dict[str, int]
    notes: tuple[str, ...]

    def reading(self, settings: WheelSettings, time_offset: float) -> WheelReading:
        """Convert the path to wheel odometry.

        The covariance of the matches is multiplied by `wheels.noise` over its default. The times are those of the
        laser plus `time_offset` [s].
        """
        begin = float(self.path.t[0])
        epoch_ns = self.epoch_ns + round((begin + time_offset + settings.time_offset) * 1e9)
        return WheelReading(_wheels(self.path, settings, begin), epoch_ns, dict(self.dropped), self.notes)


def match_scans(stream: Stream, laser: Laser) -> MatchedScans:
    """Return the path of a laser by scan matching. Raises LocfuseError if the scans cannot be matched."""
    if len(stream.t_ns) < 2:
        raise LocfuseError(f"{stream.topic} has {len(stream.t_ns)} scans; two are the least", role="wheels")
    scans = read_scans(stream, laser, STANDING)
    if scans.t[0] == scans.t[-1]:
        raise LocfuseError(f"the {len(scans.t)} scans of {stream.topic} have one stamp", role="wheels")
    path = _matched(scans)
    if scans.skewed:
        path = _matched(read_scans(stream, laser, _wheels(path, WheelSettings())))
    if path.blind[1:].all():
        raise LocfuseError(NO_RETURNS.format(topic=stream.topic), role="wheels")
    words = [f"the motion is matched from scan to scan of {stream.topic}"]
    if path.blind[1:].any():
        at = np.flatnonzero(path.blind[1:]) + 1
        words.append(
            f"{len(at)} of {len(path.t) - 1} scans match none before them "
            f"(first at {path.t[at[0]] - path.t[0]:.1f} s): constant velocity is assumed there"
        )
    return MatchedScans(path, int(stream.t_ns[0]), dict(stream.dropped), tuple(words))


def _wheels(path: _MatchedPath, settings: WheelSettings, begin: float = 0.0) -> Wheels:
    later = np.append(True, np.diff(path.t) > 0.0)  # of two scans with one stamp the first is used
    twist = se2.log(path.step[later][1:])
    return Wheels.from_matches(
        path.t[later] - begin,
        twist,
        path.P[later][1:] * (settings.noise / USUAL_NOISE),
        settings.track or VIRTUAL_TRACK,
        settings.noise,
    )


def _matched(scans: ThinnedScans) -> _MatchedPath:
    """Match all scans, in blocks of SCANS_AT_ONCE; each block begins with the last key of the block before."""
    n = len(scans.t)
    path = _MatchedPath(scans.t, np.zeros((n, 3)), np.zeros((n, 3, 3)), np.zeros(n, dtype=bool))
    velocity, begin = initial_velocity(), 0
    while begin < n - 1:
        rows = np.arange(begin, min(begin + SCANS_AT_ONCE, n))
        velocity, key = _block(scans, rows, velocity, path)
        begin = int(rows[key]) if rows[-1] < n - 1 else n
    return path


def _block(scans: ThinnedScans, rows: Ints, velocity: Velocity, path: _MatchedPath) -> tuple[Velocity, int]:
    """Match the scans `rows` (m,); return the velocity at the last key, and the index of this key in `rows`."""
    clouds = scans.clouds(rows)
    t = scans.t[rows]
    if not np.isfinite(clouds.normal[:, 0]).any():  # no surfaces: the velocity decays
        for row, span in zip(rows[1:].tolist(), np.diff(t).tolist(), strict=True):
            velocity = velocity.after(span)
            path.step[row], path.P[row] = se2.exp(velocity.v * span), velocity.spread(velocity, span)
            path.blind[row] = True
        return velocity, len(rows) - 1
    targets, sources = Targets(clouds), sources_of(clouds)
    ends = np.union1d(spaced((t, MIN_PAIR_S)), len(t) - 1)
    dt = np.diff(t[ends])
    velocities, spread, fits = _match_in_sequence(targets, sources, ends, dt, velocity)
    twists = np.stack([v.v for v in velocities])
    pair = np.searchsorted(ends, np.arange(1, len(t))) - 1  # index of the pair in which each later scan lies
    begun = se2.chain(se2.exp(twists * dt[:, None]))[pair]
    chain = se2.compose(begun, se2.exp(twists[pair] * (t[1:] - t[ends[pair]])[:, None]))
    chain = np.concatenate((np.zeros((1, 3)), chain))
    share = np.diff(t) / np.where(dt > 0.0, dt, 1.0)[pair]
    key = _keys(targets, sources, chain)
    _match_with_keys(targets, sources, chain, key, share[:, None, None] * np.array(spread)[pair], path, rows)
    path.blind[rows[1:]] = np.logical_not(fits)[pair]
    last = int(key[-1])
    return velocities[pair[last - 1]], (last or len(rows) - 1)


def _match_in_sequence(
    targets: Targets, sources: Clouds, ends: Ints, dt: Array, known: Velocity
) -> tuple[list[Velocity], Array, Array]:
    """Match each of the scans `ends` (n + 1,) with the one before, from the motion predicted by the velocity.

    Returns n velocities, covariances (n, 3, 3) of the steps, and which pairs match (n,). The matches are
    sequential, since in a corridor only the velocity so far resolves the motion along it.
    """
    found, spread, fits = [], [], []
    for k, span in enumerate(dt.tolist()):
        before = known.after(span)
        pair = _neighbours(targets, sources, ends[[k]], ends[[k + 1]], before, span)
        fits.append(bool(_fits(pair)[0]))
        information = INFORMATION_SHARE * constrained(pair.information)[0] if fits[-1] else np.zeros((3, 3))
        known = before.corrected(span, se2.log(pair.pose)[0], information)
        found.append(known)
        spread.append(known.spread(before, span))
    return found, np.array(spread), np.array(fits)


def _neighbours(targets: Targets, sources: Clouds, i: Ints, j: Ints, known: Velocity, dt: float) -> Matches:
    """Match scan j (1,) with scan i (1,), dt [s] earlier; if the match is bad, try turned initial poses."""
    guess = se2.exp(known.v * dt)[None]
    prior = inverse(known.P * dt * dt + FLOOR)[None]
    found = match(targets, i, sources, j, guess, PAIRING_PRIOR_SHARE * prior, REACH_M)
    if found.inliers[0] > GOOD_INLIERS and found.overlap[0] > MIN_OVERLAP:
        return found
    n = len(TURNS_RAD)
    guesses = guess + np.outer(TURNS_RAD, (0.0, 0.0, 1.0))
    weak = np.broadcast_to(FIRST_PRIOR, (n, 3, 3))
    turned = match(targets, i.repeat(n), sources, j.repeat(n), guesses, weak, REACH_M)
    score = turned.inliers * np.sqrt(turned.overlap)
    better = score.max() > found.inliers[0] * np.sqrt(found.overlap[0]) + TURN_GAIN
    return turned.take(np.array([int(score.argmax())])) if better else found


def _fits(found: Matches) -> Array:
    return np.asarray((found.inliers > MIN_INLIERS) & (found.overlap > MIN_OVERLAP))


def constrained(information: Array) -> Array:
    """Return the information (p, 3, 3) without directions that the walls hardly constrain.

    In a corridor, the noise of the wall directions would otherwise count as information that there is no motion.
    """
    across = information[:, :2, 2]
    of_turn = across[:, :, None] * across[:, None, :] / np.maximum(information[:, 2, 2], 1e-9)[:, None, None]
    place = information[:, :2, :2] - of_turn
    values, vectors = np.linalg.eigh(place)
    d = np.concatenate((vectors[:, :, 0], np.zeros((len(place), 1))), axis=1)  # direction of least information
    Hd = np.einsum("nij,nj->ni", information, d)
    about = np.maximum(np.einsum("ni,ni->n", Hd, d), 1e-12)
    without = information - Hd[:, :, None] * Hd[:, None, :] / about[:, None, None]
    return np.asarray(np.where((values[:, 0] < MIN_SEEN * values[:, 1])[:, None, None], without, information))


def _keys(targets: Targets, sources: Clouds, chain: Array) -> Ints:
    """Return the index of the key scan of each scan (m,): the last key with enough overlap.

    The overlap of two scans is the share of points of each that lie on the other, multiplied: a laser that looks
    forward sees all points of a later scan already in an earlier one, but not conversely.
    """
    key, at, most = np.zeros(len(chain), dtype=np.int64), 0, 0.0
    for k in range(1, len(chain)):
        key[k] = at
        i, j = np.array([at, k]), np.array([k, at])
        shared = float(overlap(targets, i, sources, j, se2.between(chain[i], chain[j]), REACH_M / 2.0).prod())
        most = shared if k == at + 1 else most
        if shared < MIN_SHARED_RATIO * most or k - at >= MAX_KEY_SCANS:
            at = k
    return key


def _match_with_keys(
    targets: Targets, sources: Clouds, chain: Array, key: Ints, spread: Array, path: _MatchedPath, rows: Ints
) -> None:
    """Match every scan with its key scan, and store the steps from scan to scan in `path`."""
    later = np.arange(1, len(rows))
    mine = key[later]
    guess = se2.between(chain[mine], chain[later])
    total = totals(se2.turned_covariance(spread, chain[:-1, 2]))
    P = se2.turned_covariance(total[later] - total[mine], -chain[mine, 2]) + FLOOR
    found = match(targets, mine, sources, later, guess, PAIRING_PRIOR_SHARE * inverse(P), REACH_M / 2.0)
    pose, C = _updated(guess, inverse(P), found)
    of_key = np.concatenate((np.zeros((1, 3)), pose))  # pose of each scan relative to its key
    same = key[:-1] == mine  # the scan before has the same key
    start = np.where((same & (later - 1 != mine))[:, None], of_key[:-1], 0.0)
    path.step[rows[1:]] = se2.between(start, pose)
    # the covariance of a step is that of the key's last match, divided by the key's number of steps
    _, at, counts = np.unique(mine, return_inverse=True, return_counts=True)
    last = np.cumsum(counts) - 1
    path.P[rows[1:]] = se2.turned_covariance((C[last] / counts[:, None, None])[at], -start[:, 2])


def _updated(guess: Array, prior: Array, found: Matches) -> tuple[Array, Array]:
    """Return poses (p, 3) and covariances (p, 3, 3) after combining the prior with the scan matches."""
    full = np.where(_fits(found)[:, None, None], constrained(found.information), 0.0)
    off = se2.difference(found.pose, guess)
    step = np.linalg.solve(prior + full, (full @ off[:, :, None]))[:, :, 0]
    return guess + step, inverse(prior + INFORMATION_SHARE * full)


# ---- constant velocity ----


def inverse(P: Array) -> Array:
    """Return the inverse of matrices (..., n, n)."""
    return np.asarray(np.linalg.inv(P), np.float64)


class Velocity(NamedTuple):
    """Body velocity (3,) [m/s, m/s, rad/s] with its covariance (3, 3)."""

    v: Array
    P: Array

    def after(self, dt: float) -> Velocity:
        """Predict the velocity dt [s] later."""
        kept = np.exp(-dt / DECAY_S)
        return Velocity(kept * self.v, self.P * np.outer(kept, kept) + np.diag((1.0 - kept**2) * USUAL_VARIANCES))

    def corrected(self, dt: float, twist: Array, information: Array) -> Velocity:
        """Correct the velocity by a motion `twist` (3,) over dt [s] with information (3, 3)."""
        prior = inverse(self.P)
        P = inverse(prior + dt * dt * information)
        return Velocity(P @ (prior @ self.v + dt * (information @ twist)), se2.symmetric(P))

    def spread(self, before: Velocity, dt: float) -> Array:
        """Return the covariance (3, 3) of the motion over dt [s] that ended with this velocity.

        `before` is the same velocity as predicted, before its correction.
        """
        if dt == 0.0:  # two scans with one stamp: no motion, and A is 1
            return np.zeros((3, 3))
        A = self.P @ inverse(before.P) * np.exp(-dt / DECAY_S)
        M = np.linalg.solve(np.eye(3) - A, A @ self.P)
        values, vectors = np.linalg.eigh(dt * dt * (self.P + M + M.T))
        return np.asarray((vectors * np.maximum(values, 0.0)) @ vectors.T)


def initial_velocity() -> Velocity:
    """Return the velocity before the first scan: at rest, since most recordings start before the robot moves."""
    return Velocity(np.zeros(3), 0.25 * np.diag(USUAL_VARIANCES))


# ---- the scans of a whole log as thinned points in the base frame, and the surfaces of some at a time ----


class ThinnedScans(msgspec.Struct, frozen=True):
    """All scans of a log in time order, as thinned points in the base frame."""

    t: Array  # (n,) s since the stream's first stamp: the times to which the scans are deskewed
    points: list[NDArray[np.float32]]  # n of (k, 2) [m], in the order of the beams
    origin: Array  # (2,) m, position of the laser on the base
    skewed: bool  # whether any scan has a duration

    def clouds(self, rows: Ints) -> Clouds:
        """Return point clouds of the scans `rows` (m,)."""
        return Clouds.of_scans([self.points[row].astype(np.float64) for row in rows.tolist()], self.origin)


def read_scans(stream: Stream, laser: Laser, wheels: WheelMotion) -> ThinnedScans:
    """Read the scans of a stream; `wheels` gives the robot's motion during each scan.

    A range that stands for "no return" is found and left out, unless `laser` has a configured longest range.
    """
    timed = laser.at_rate(stream.t_ns)
    return left_out(timed, lambda understood, longest: _read(stream, understood, wheels, longest))[0]


def _read(stream: Stream, laser: Laser, wheels: WheelMotion, longest: Longest) -> ThinnedScans:
    """Read the scans of a stream; `longest` collects the ranges of all scans."""
    stamps = seconds(stream.t_ns, stream.t_ns[0])
    t = stamps.copy()
    points: list[NDArray[np.float32]] = [np.zeros((0, 2), np.float32)] * len(t)
    skewed = False
    for rows, columns in stream.blocks(*SCAN_FIELDS, rows=SCANS_PER_BLOCK):
        skewed |= bool(np.any(cast("Array", columns["time_increment"]) != 0.0)) and laser.deskew
        for group, scans in equal_scans(columns):
            longest.add(scans)
            at = rows[group]
            xy, t[at] = points_in_base(scans, stamps[at], laser, wheels)
            for row, p in zip(at.tolist(), xy, strict=True):
                points[row] = few(p, laser.mount[:2], MAX_POINTS).astype(np.float32)
    # scans of different durations overlap
    return ThinnedScans(np.maximum.accumulate(t), points, laser.mount[:2], skewed)
