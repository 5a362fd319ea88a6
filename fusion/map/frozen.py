"""A small map that was left: its lines as they were known then."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from locfuse.fusion import se2
from locfuse.fusion.data import Array
from locfuse.fusion.ekf.belief_arrays import JointBelief

from .line_map import LineMap
from .scan import Scan
from .way import Way


class FrozenMap(NamedTuple):
    """A map in the frame of its anchor."""

    anchor: int  # in the graph
    lines: LineMap  # none of them is a state
    way: Way
    box: tuple[Array, Array]  # (2,) m: what the lines and the way lie within
    origin: Array  # (3,) where it began, the anchor's own place but for a first map that is the map frame's
    joint: Array  # (2J, 2J) covariance of rho and beta of all lines, line by line


def frozen(lines: LineMap, belief: JointBelief) -> LineMap:
    """Return a copy of the lines whose values and covariances are their own."""
    n = len(lines)
    return LineMap(
        lines.ids.copy(),
        lines.anchor.copy(),
        lines.lo.copy(),
        lines.hi.copy(),
        lines.hits.copy(),
        np.full(n, -1, np.int64),
        np.array(lines.values(belief)),
        np.array(lines.covariances(belief)),
        lines.seen.copy(),
        lines.born.copy(),
        lines.next_id,
    )


def thaw(kept: LineMap, lines: LineMap, first_column: int) -> None:
    """Let `lines` be those that were kept, as states from a column on; its own ids go on."""
    for name in ("ids", "anchor", "lo", "hi", "hits", "value", "P"):
        setattr(lines, name, getattr(kept, name).copy())
    lines.column = first_column + 2 * np.arange(len(kept))


def joint_covariance(lines: LineMap, belief: JointBelief) -> Array:
    """Return the covariance (2J, 2J) of rho and beta of all lines."""
    at = lines.states(np.s_[:])
    P: Array = belief.covariance[np.ix_(at, at)]
    return P


def box_of(lines: LineMap, values: Array, way: Way) -> tuple[Array, Array]:
    """Return the least and the greatest x, y of lines and way, (2,) each [m]."""
    points = np.vstack((ends_of(lines, values).reshape(-1, 2), *[sight.pose[None, :2] for sight in way.sights]))
    return points.min(axis=0), points.max(axis=0)


def ends_of(lines: LineMap, values: Array) -> Array:
    """Return both ends of every line, (J, 2, 2) [m]; values (J, 2) are rho and beta about the anchors."""
    n = np.stack((np.cos(values[:, 1]), np.sin(values[:, 1])), axis=-1)
    tangent = np.stack((-n[:, 1], n[:, 0]), axis=-1)
    foot = lines.anchor + values[:, :1] * n
    return np.stack((foot + lines.lo[:, None] * tangent, foot + lines.hi[:, None] * tangent), axis=1)


def as_scan(lines: LineMap, values: Array, P: Array, least_hits: int) -> Scan:
    """Return a map as one scan from the origin of its frame: (rho, beta) there, with the ends along each line."""
    at = np.flatnonzero(lines.hits >= least_hits)
    c, s = np.cos(values[at, 1]), np.sin(values[at, 1])
    ax, ay = lines.anchor[at].T
    along = ay * c - ax * s
    z = np.stack((values[at, 0] + ax * c + ay * s, se2.wrap_all(values[at, 1])), axis=-1)
    G = np.zeros((len(at), 2, 2))
    G[:, 0, 0] = G[:, 1, 1] = 1.0
    G[:, 0, 1] = along
    R = G @ P[at] @ G.transpose(0, 2, 1)
    ends = np.stack((lines.lo[at] + along, lines.hi[at] + along), axis=-1)
    return Scan.of(z, R, ends)
