"""Wheel odometry over a whole drive, with the covariance of the motion between any two update times.

The odometry error is a small rigid motion xi = (x, y, theta) in the frame of the odometry's origin, which moves
all later poses. In this form errors add, and the covariance of xi between two update times is the difference of
two sums. (Left-invariant error: Barfoot 2017, "State Estimation for Robotics", 7.3; in the plane its adjoint is
a lever arm.)

Between two key poses of the pose graph, which stay fixed, the error is a random walk of such motions in the frame
of the earlier key pose, and is known at both ends (a Brownian bridge). Each scan between two keys is matched with
both key scans. One forward and one backward pass over the scans smooths the error, for all spans at once (Rauch,
Tung and Striebel 1965).
"""

from __future__ import annotations

import msgspec
import numpy as np
from msgspec.structs import replace

from locfuse.fusion import se2
from locfuse.fusion.data import Array, Drive, Ints, Mask, Measurements, Motions, consecutive, spaced, totals
from locfuse.fusion.scan_matching.match import (
    Clouds,
    Columns,
    Matches,
    Targets,
    clouds_of,
    match,
    merged,
    sources_of,
)
from locfuse.fusion.scan_matching.neighbours import good

# m^2, rad^2 per metre driven and per radian turned: slips, uneven floors. The noise of the wheels alone is zero
# in some directions, and an error in these directions would be interpolated badly between key poses.
LEFT_OUT_VARIANCES = np.array([2e-4, 2e-4, np.radians(0.5) ** 2])


class Odometry(msgspec.Struct, frozen=True):
    """Wheel odometry at n update times: poses, and the covariance of each relative to the first."""

    pose: Array  # (n, 3) in the odometry's frame, theta not wrapped
    C: Array  # (n, 3, 3) covariance of xi since the first instant
    left_out: Array | None = None  # (3,) variances in C in addition to the wheels' noise, per metre and radian

    def path_length(self) -> Array:
        """Return the path length driven until each update time, (n,) [m]."""
        return totals(np.hypot(*np.diff(self.pose[:, :2], axis=0).T))

    def at(self, k: Ints) -> Odometry:
        """Return the odometry at the update times with indices k (m,)."""
        return Odometry(self.pose[k], self.C[k], self.left_out)

    def with_slip_noise(self) -> Odometry:
        """Add variance for slips and uneven floors (LEFT_OUT_VARIANCES), which wheel noise does not include."""
        u = se2.between(self.pose[:-1], self.pose[1:])
        more = np.cumsum(to_origin(self.pose[:-1], u, even_covariance(u, LEFT_OUT_VARIANCES)), axis=0)
        return replace(self, C=self.C + np.concatenate((np.zeros((1, 3, 3)), more)), left_out=LEFT_OUT_VARIANCES)

    def between(self, a: Ints, b: Ints) -> tuple[Array, Array]:
        """Return motions (m, 3) from update times a to b, (m,) each, and covariances of xi in the frames at a."""
        u = se2.between(self.pose[a], self.pose[b])
        return u, to_parent_frame(self.C[b] - self.C[a], se2.inverse(self.pose[a]))

    def grown(self, k: Ints, motions: Motions, wheels: Array | None) -> Odometry:
        """Return the odometry at the ends of m motions that begin at the update times k (m,).

        `wheels` are corrections of the wheel parameters, None without.
        """
        u = motions.corrected(wheels)
        pose = se2.compose(self.pose[k], u)
        Q = motions.Q if self.left_out is None else motions.Q + even_covariance(u, self.left_out)
        return Odometry(pose, self.C[k] + to_origin(self.pose[k], u, Q), self.left_out)


def odometry_of(drive: Drive, lag: float = 0.0, wheels: Array | None = None) -> Odometry:
    """Return the wheel odometry at the update times of the drive.

    `lag` [s] is added to the update times to convert them to the wheels' clock. `wheels` (3,): corrections of both
    wheel radii and the track.
    """
    motions = drive.motions
    if lag:
        t = np.clip(drive.t + lag, drive.wheels.t[0], drive.wheels.t[-1])
        motions = drive.wheels.between(np.append(t[:1], t[:-1]), t, motions.J.shape[2] > 0)
    u = motions.corrected(wheels)
    pose = se2.chain(u)
    return Odometry(pose[1:], np.cumsum(to_origin(pose[:-1], u, motions.Q), axis=0))


def even_covariance(u: Array, variances: Array) -> Array:
    """Return covariances (n, 3, 3) that grow evenly along motions u (n, 3).

    `variances` (3,) of x, y, theta are per metre driven and per radian turned.
    """
    far = np.hypot(u[:, 0], u[:, 1]) + np.abs(u[:, 2])
    return far[:, None, None] * np.diag(variances)


def to_origin(start: Array, u: Array, Q: Array) -> Array:
    """Convert covariances Q (n, 3, 3) of motions to those of the odometry error xi at the odometry's origin.

    The motions are u (n, 3) from poses `start` (n, 3). Q is the covariance of each motion's (x, y, theta) in the
    frame of its start. A small rigid motion about the start moves the end by a lever arm, which is removed first.
    """
    return to_parent_frame(add_lever_arm(Q, u[:, 1], -u[:, 0]), start)


def to_parent_frame(C: Array, frame: Array) -> Array:
    """Convert covariances C (n, 3, 3) of xi from the frames `frame` (n, 3) to the parent of these frames."""
    return add_lever_arm(se2.turned_covariance(C, frame[:, 2]), frame[:, 1], -frame[:, 0])


def add_lever_arm(C: Array, x: Array, y: Array) -> Array:
    """Return covariances C (n, 3, 3) after adding the heading error times x (n,), y (n,) [m] to x and y."""
    return se2.propagated(se2.lever(x, y), C)


REST_P = np.diag([1e-9, 1e-9, 1e-9])  # m^2, rad^2: keeps covariances invertible while the robot is at rest
GAP_S = 0.09  # least time between two matched scans: matching more scans adds little accuracy
SCANS_AT_ONCE = 1024  # scans whose full points are in memory at once, before thinning
KEYS_AT_ONCE = 500  # keys in one search tree
REST_S = 1.0  # a robot at rest this long before and after a scan did not move: wheel stamps may be late
MAX_POINTS = 90  # matched points of one scan
# prior of a match, for directions that the walls do not constrain
PRIOR_INFORMATION = np.diag([0.1**-2, 0.1**-2, np.radians(4.0) ** -2])
REACH_M = 0.4
ROUND_COUNT = 2  # a scan that fits badly is matched again, from the pose interpolated between its neighbours
# process noise from scan to scan, even at rest: stamps are not exact
STEP_P = np.diag([0.002**2, 0.002**2, np.radians(0.1) ** 2])
KEY_INFORMATION = np.diag([1e10, 1e10, 1e12])  # 1/m^2, 1/rad^2: information of the next key


class Spans(Columns, frozen=True):
    """Key poses before and after each of n times, and the odometry from the key before to the time."""

    a: Ints  # (n,) index of the key before, at most the last but one
    b: Ints  # (n,) index of the key after
    inside: Mask  # (n, 1, 1) whether the time lies between keys a and b
    beyond: Mask  # (n, 1, 1) whether the time lies after the last key
    home: Array  # (n, 3) odometry's origin in the frame of key a
    u: Array  # (n, 3) odometry pose at the time, in the frame of key a
    C: Array  # (n, 3, 3) covariance of xi from key a to the time
    C_ab: Array  # (n, 3, 3) covariance of xi from key a to key b

    @classmethod
    def of(cls, odometry: Odometry, stamps: Odometry, k: Ints, keys: Ints) -> Spans:
        """Return for times with odometry `stamps` the keys before and after, and the odometry since the former."""
        a = np.clip(np.searchsorted(keys, k, side="right") - 1, 0, max(len(keys) - 2, 0))
        b = np.minimum(a + 1, len(keys) - 1)
        home = se2.inverse(odometry.pose[keys[a]])
        u = se2.compose(home, stamps.pose)
        C = to_parent_frame(stamps.C - odometry.C[keys[a]], home)
        C_ab = to_parent_frame(odometry.C[keys[b]] - odometry.C[keys[a]], home) + REST_P
        inside, beyond = (k >= keys[a]) & (k < keys[b]), k >= keys[b]
        return cls(a, b, inside[:, None, None], beyond[:, None, None], home, u, C, C_ab)

    @property
    def share(self) -> Array:
        """Share (n, 3, 3) of the odometry error from key a to key b that has accumulated at each time."""
        return np.where(self.inside, self.C @ np.linalg.inv(self.C_ab), np.where(self.beyond, np.eye(3), 0.0))


class OdometryErrors(Columns, frozen=True):
    """Odometry errors since the previous key, at the update times of the keys and of the scans between them.

    Sorted by key, then by time. The first row of every span is its key (zero error), the last row is the next key.
    """

    a: Ints  # (f,) index of the key before
    instant: Ints  # (f,) index of the update time
    xi: Array  # (f, 3) odometry error since the key, in the key's frame
    rest: Array  # (f, 3, 3) covariance of xi if both key poses were exact

    @classmethod
    def of_keys(cls, odometry: Odometry, keys: Ints, x: Array) -> OdometryErrors:
        """Return the odometry errors from each key to the next: poses x (m, 3) at update times `keys` (m,)."""
        a = np.arange(len(keys) - 1)
        whole = se2.between(odometry.pose[keys[:-1]], odometry.pose[keys[1:]])
        error = se2.compose(se2.between(x[:-1], x[1:]), se2.inverse(whole))
        error[:, 2] = se2.wrap_all(error[:, 2])
        both = np.stack((keys[:-1], keys[1:]), axis=1).ravel()
        xi = np.stack((np.zeros_like(error), error), axis=1).reshape(-1, 3)
        return cls(np.repeat(a, 2), both, xi, np.zeros((len(xi), 3, 3)))

    def at(self, odometry: Odometry, k: Ints, spans: Spans) -> tuple[Array, Array]:
        """Interpolate odometry errors: xi (n, 3) and covariances (n, 3, 3) for the times of `spans`.

        k (n,) is the last update time before each.
        """
        size = len(odometry.pose) + 1
        last = len(self.a) - 1
        f = np.searchsorted(self.a * size + self.instant, spans.a * size + k, side="right") - 1
        f, g = np.clip(f, 0, last), np.clip(f + 1, 0, last)
        origin = odometry.C[self.instant[np.searchsorted(self.a, spans.a)]]
        C_f = to_parent_frame(odometry.C[self.instant[f]] - origin, spans.home)
        C_fg = to_parent_frame(odometry.C[self.instant[g]] - origin, spans.home) - C_f + REST_P
        since = spans.C - C_f
        share = np.where(spans.inside, since @ np.linalg.inv(C_fg), 0.0)
        xi = self.xi[f] + np.einsum("nij,nj->ni", share, self.xi[g] - self.xi[f])
        nearer = np.clip(share[:, 2, 2], 0.0, 1.0)[:, None, None]  # errors of neighbouring scans are correlated
        rest = (1.0 - nearer) * self.rest[f] + nearer * self.rest[g] + since - share @ since
        return xi, rest


def bridged(
    odometry: Odometry,
    stamps: Odometry,
    k: Ints,
    keys: Ints,
    x: Array,
    P: Array,
    after: Array,
    errors: OdometryErrors,
) -> tuple[Array, Array]:
    """Interpolate poses (n, 3) and covariances (n, 3, 3) between key poses, at times with odometry `stamps` (n).

    `k` (n,) are the last update times before these times. `keys` (m,) are the update times of the key poses x (m,
    3), with covariances P (m, 3, 3) and cross covariances `after` (m - 1, 3, 3) with the next key pose. No time is
    before the first key; after the last key, only odometry is used.
    """
    spans = Spans.of(odometry, stamps, k, keys)
    xi, rest = errors.at(odometry, k, spans)
    pose = se2.compose(x[spans.a], se2.compose(xi, spans.u))
    return pose, _spread(x, P, after, spans, rest, pose)


def _spread(x: Array, P: Array, after: Array, spans: Spans, rest: Array, pose: Array) -> Array:
    """Return covariances (n, 3, 3) of poses (x, y, theta), from those of both key poses and of the odometry."""
    a, b = spans.a, spans.b
    arm = x[b, :2] - x[a, :2]
    P_a = P[a]
    P_b = add_lever_arm(P[b], arm[:, 1], -arm[:, 0])
    cross = after[np.minimum(a, max(len(after) - 1, 0))] if len(after) else np.zeros_like(P_a)
    cross = cross @ se2.lever(arm[:, 1], -arm[:, 0]).transpose(0, 2, 1)
    only_one = (a == b)[:, None, None]
    cross = np.where(only_one, P_a, cross)
    turn = se2.rotation(x[a, 2])
    S = se2.propagated(turn, spans.share)
    own = np.eye(3) - S
    out = se2.propagated(own, P_a) + se2.propagated(S, P_b)
    mixed = own @ cross @ S.transpose(0, 2, 1)
    out += mixed + mixed.transpose(0, 2, 1) + se2.propagated(turn, rest)
    lever = pose[:, :2] - x[a, :2]
    out = add_lever_arm(out, -lever[:, 1], lever[:, 0])
    return se2.symmetric(out)


def errors_at_scans(
    odometry: Odometry, drive: Drive, sensor: str, readings: Ints, clouds: Clouds, x: Array
) -> OdometryErrors:
    """Return the odometry errors at the scans between the key scans `readings` (m,) with poses x (m, 3).

    `clouds` are the points of the key scans.
    """
    m, instants = drive.measurements[sensor], drive.instant[sensor]
    keys = instants[readings]
    key_errors = OdometryErrors.of_keys(odometry, keys, x)
    chosen = moving_scans(odometry, drive.t, instants, readings)
    if not len(chosen):
        return key_errors
    k = instants[chosen]
    spans = Spans.of(odometry, odometry.at(k), k, keys)
    sources = points_of(m, chosen)
    xi, information = np.zeros((len(k), 3)), np.zeros((len(k), 3, 3))
    errors, pending = key_errors, np.arange(len(k))
    for _ in range(ROUND_COUNT):
        guess = errors.at(odometry, k[pending], spans.take(pending))[0]
        u = spans.u[pending]
        found = matched(clouds, x, spans.a[pending], sources, pending, se2.compose(guess, u))
        xi[pending], information[pending] = as_errors(found, u, guess)
        errors = smoothed(odometry, key_errors, spans.a, k, xi, information)
        pending = np.flatnonzero(information[:, 2, 2] == 0.0)
        if not len(pending):
            break
    return errors


def moving_scans(odometry: Odometry, t: Array, instants: Ints, readings: Ints) -> Ints:
    """Return indices of the scans between the first and last key scan during which the robot moved.

    t (N,) are all update times [s]. The robot moved if the wheels turned within REST_S of the scan.
    """
    distance, turned = odometry.path_length(), totals(np.abs(np.diff(odometry.pose[:, 2])))
    before = np.searchsorted(t, t[instants] - REST_S)
    after = np.searchsorted(t, t[instants] + REST_S, side="right") - 1
    moved = (distance[after] > distance[before]) | (turned[after] > turned[before])
    moved[readings], moved[: readings[0]], moved[readings[-1] :] = False, False, False
    chosen = np.flatnonzero(moved)
    return chosen[spaced((t[instants[chosen]], GAP_S))]


def points_of(m: Measurements, chosen: Ints) -> Clouds:
    """Return at most MAX_POINTS points of each chosen scan, for matching; read in parts to save memory."""
    cuts = np.arange(SCANS_AT_ONCE, len(chosen), SCANS_AT_ONCE)
    parts = [sources_of(clouds_of(m, part), MAX_POINTS) for part in np.split(chosen, cuts)]
    counts = np.concatenate([np.diff(part.first) for part in parts])
    first = totals(counts)
    xy, normal = (np.concatenate(column) for column in zip(*((p.xy, p.normal) for p in parts), strict=True))
    return Clouds(first, xy, normal)


def matched(clouds: Clouds, x: Array, a: Ints, sources: Clouds, j: Ints, guess: Array) -> Matches:
    """Match scans j (n,) with the key scans a (n,) and a + 1 together, starting from the poses `guess` (n, 3).

    `a` must be sorted. Keys are processed in groups: one search tree of all keys would take hundreds of MB.
    """
    prior, parts = np.broadcast_to(PRIOR_INFORMATION, (len(a), 3, 3)), []
    for at in consecutive(a // KEYS_AT_ONCE):
        keys = np.arange(a[at[0]], a[at[-1]] + 1)
        poses = [np.vstack((np.zeros(3), step)) for step in se2.between(x[keys], x[keys + 1])]
        targets = Targets(merged(clouds, [np.array([k, k + 1]) for k in keys.tolist()], poses))
        parts.append(match(targets, a[at] - keys[0], sources, j[at], guess[at], prior[at], REACH_M))
    return Matches.joined(*parts)


def as_errors(found: Matches, u: Array, guess: Array) -> tuple[Array, Array]:
    """Return errors xi (n, 3) of odometry u (n, 3) since a key pose, by scan matches, and inverse covariances.

    `guess` (n, 3) are the expected errors. The information (n, 3, 3) is 0 for a bad match.
    """
    xi = se2.compose(found.alone, se2.inverse(u))
    xi[:, 2] = guess[:, 2] + se2.wrap_all(xi[:, 2] - guess[:, 2])
    L = se2.lever(-u[:, 1], u[:, 0])
    return xi, np.where(good(found)[:, None, None], L.transpose(0, 2, 1) @ found.information @ L, 0.0)


def smoothed(
    odometry: Odometry, key_errors: OdometryErrors, a: Ints, k: Ints, xi: Array, information: Array
) -> OdometryErrors:
    """Smooth the odometry errors along each span between two keys; return them at the keys and at the scans.

    `key_errors` are the known errors at the keys. Scan i has update time k[i] and follows key a[i]. xi (n, 3) with
    `information` (n, 3, 3) are the errors measured by the scans.
    """
    order = np.lexsort((np.concatenate((key_errors.instant, k)), np.concatenate((key_errors.a, a))))
    a, k = np.concatenate((key_errors.a, a))[order], np.concatenate((key_errors.instant, k))[order]
    z = np.concatenate((key_errors.xi, xi))[order]
    L = np.concatenate((np.broadcast_to(KEY_INFORMATION, (len(key_errors.a), 3, 3)), information))[order]
    starts = np.flatnonzero(np.diff(a, prepend=-1))
    home = se2.inverse(odometry.pose[k[starts]])[np.searchsorted(a[starts], a)]
    Q = to_parent_frame(np.diff(odometry.C[k], axis=0, prepend=odometry.C[k[:1]]), home) + STEP_P
    lengths = np.diff(np.append(starts, len(a)))
    mean, V = z.copy(), np.zeros((len(a), 3, 3))
    for step in range(1, int(lengths.max())):
        at = starts[lengths > step] + step
        predicted = V[at - 1] + Q[at]
        V[at] = se2.symmetric(np.linalg.solve(np.eye(3) + predicted @ L[at], predicted))
        gain = V[at] @ L[at]
        mean[at] = mean[at - 1] + np.einsum("nij,nj->ni", gain, z[at] - mean[at - 1])
    for step in range(int(lengths.max()) - 2, 0, -1):
        at = starts[lengths > step + 1] + step
        predicted = V[at] + Q[at + 1]
        G = V[at] @ np.linalg.inv(predicted)
        mean[at] += np.einsum("nij,nj->ni", G, mean[at + 1] - mean[at])
        V[at] = se2.symmetric(V[at] + se2.propagated(G, V[at + 1] - predicted))
    return OdometryErrors(a, k, mean, V)
