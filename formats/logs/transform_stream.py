"""Topics derived from /tf: the pose of one frame in another, "/tf:odom:base_link", and tags seen by a camera.

A pair of frames becomes a geometry_msgs/TransformStamped topic, for example odometry that exists only in /tf, a
SLAM pose or a reference. Transforms between frames that are not neighbours are chained. The slower transforms are
interpolated to the times of the fastest one, as tf2 does: positions linearly, rotations along the shorter way.

If a detector publishes tags as child frames of its camera, they become the topic "/tf:camera_optical:tags".
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from graphlib import CycleError, TopologicalSorter
from typing import NamedTuple, cast

import numpy as np

from locfuse.formats.robot.transforms import (
    FIELDS,
    StaticTransforms,
    ancestors,
    as_lists,
    inverse_of,
    matrices_of,
    neighbours,
    path_between,
    quaternions_of,
)
from locfuse.fusion.data import Array, Column, Ints, LocfuseError, Mask, Ragged, interpolate
from locfuse.fusion.streams import MAX_DELAY_S

from . import clock as clocks

TRANSFORM = "geometry_msgs/msg/TransformStamped"
STAMP = "transforms.header.stamp|transforms.timestamp|timestamp"
TF_FIELDS = (STAMP, *FIELDS)
MAX_STILL_M = 1e-6  # m, and of quaternion components: smaller changes do not count as motion
NAMES = (*(f"transform.translation.{axis}" for axis in "xyz"), *(f"transform.rotation.{axis}" for axis in "xyzw"))


class FrameEdge(NamedTuple):
    """The transform of a frame in its parent frame over time."""

    parent: str
    child: str
    clock: clocks.RowTimes
    log_time: Ints  # (n,) ns
    stamp: Ints  # (n,) ns
    values: Array  # (n, 7) x, y, z [m], quaternion x, y, z, w

    @property
    def moves(self) -> bool:
        """Whether the transform changes."""
        return bool(np.ptp(self.values, axis=0).max() > MAX_STILL_M)


def pair_of(name: str) -> tuple[str, str, str] | None:
    """Return topic, parent and child of a name like "/tf:odom:base_link"; None for another name."""
    parts = name.split(":")
    return (parts[0], parts[1].lstrip("/"), parts[2].lstrip("/")) if len(parts) == 3 and all(parts) else None


def edges_of(
    log_time: Ints, columns: Mapping[str, Column], order: str, others: clocks.Others = lambda: None
) -> dict[tuple[str, str], FrameEdge]:
    """Return (parent, child) -> transforms over time, from the columns of a /tf topic with m messages.

    `log_time` (m,) [ns] is the recording time of each message. clock.settle chooses the times of the transforms
    from recording times and stamps.
    """
    columns = as_lists(columns)
    parents, children = (cast("list[tuple[str, ...]]", columns[name]) for name in FIELDS[:2])
    stamps = cast("Ragged", columns[STAMP])
    numbers = [cast("Ragged", columns[name]) for name in FIELDS[2:]]
    values = np.stack([column.values for column in numbers], axis=-1).astype(np.float64)
    places: dict[tuple[str, str], list[int]] = {}
    rows: dict[tuple[str, str], list[int]] = {}
    first = stamps.first.tolist()
    for row, (names, kids) in enumerate(zip(parents, children, strict=True)):
        for k, (parent, child) in enumerate(zip(names, kids, strict=False)):
            key = parent.lstrip("/"), child.lstrip("/")
            places.setdefault(key, []).append(first[row] + k)
            rows.setdefault(key, []).append(row)
    found = {}
    for key, at in places.items():
        good = np.isfinite(values[at]).all(axis=1) & (np.square(values[at, 3:]).sum(axis=1) > MAX_STILL_M)
        stamped, recorded = np.asarray(stamps.values)[at].astype(np.int64), log_time[rows[key]]
        if (np.diff(stamped) < 0).any():  # two publishers may send the same
            good &= ~_repeats(recorded, stamped, values[at])
        use = np.array(at)[good]
        if len(use):
            stamped, recorded = stamped[good], recorded[good]
            clock = clocks.settle(recorded, stamped, order, others)
            found[key] = FrameEdge(*key, clock, recorded, stamped, values[use])
    return found


def _repeats(recorded: Ints, stamped: Ints, values: Array) -> Mask:
    """Return flags (n,) of transforms with the stamp and values (n, 7) of one within MAX_DELAY_S before."""
    order = np.lexsort((recorded, *values.T, stamped))
    same = (np.diff(values[order], axis=0) == 0.0).all(axis=1) & (np.diff(stamped[order]) == 0)
    flags = np.zeros(len(stamped), bool)
    flags[order[1:]] = same & (np.diff(recorded[order]) < MAX_DELAY_S * 1e9) & (stamped[order[1:]] != 0)
    return flags


def frame_in(topic: str, edges: Sequence[FrameEdge], static: StaticTransforms) -> clocks.MadeStream:
    """Return the pose of one frame in another, "/tf:odom:base_link", as a stream of TransformStamped.

    Its times are those of the most frequent moving transform between both frames. Raises LocfuseError if there is
    no moving transform between them.
    """
    pair = pair_of(topic)
    assert pair is not None
    source, parent, child = pair
    path = _path(source, parent, child, edges, static)
    moving = [edge for edge, _ in path if isinstance(edge, FrameEdge)]
    if not moving:
        raise LocfuseError(f"{source}: {child} never moves in {parent}: both are on one rigid body")
    main = max(moving, key=lambda edge: (edge.moves, len(edge.stamp)))
    t_ns = main.clock.t_ns
    inside = np.ones(len(t_ns), dtype=bool)  # mask of times within the time spans of all other moving transforms
    for other in moving:
        if other is not main and other.moves:
            inside &= (t_ns >= other.clock.t_ns[0]) & (t_ns <= other.clock.t_ns[-1])
    outside, t_ns = int((~inside).sum()), t_ns[inside]
    T = np.broadcast_to(np.eye(4), (len(t_ns), 4, 4))
    for edge, backward in path:
        one = _at(edge, t_ns) if isinstance(edge, FrameEdge) else edge
        T = T @ (inverse_of(one) if backward else one)
    data = dict(zip(NAMES, (*T[:, :3, 3].T, *quaternions_of(T[:, :3, :3]).T), strict=True))
    dropped = {**main.clock.dropped, **({"outside_chain": outside} if outside else {})}
    delay_s = _delay_s(main.log_time, main.clock.t_ns if main.clock.on_stamps else main.stamp)
    return clocks.MadeStream(topic, TRANSFORM, t_ns, data, parent, dropped, clock=main.clock, delay_s=delay_s)


def _path(
    source: str, parent: str, child: str, edges: Sequence[FrameEdge], static: StaticTransforms
) -> list[tuple[FrameEdge | Array, bool]]:
    """Return the chain of transforms between two frames, as (transform, whether it is inverted).

    A constant transform is a (4, 4) matrix. Raises LocfuseError if no chain exists.
    """
    moving: list[tuple[str, str, FrameEdge | Array]] = [(e.parent, e.child, e) for e in edges]
    at = neighbours([*moving, *((e.parent, e.child, e.T_parent_child) for e in static.edges)])
    if missing := [frame for frame in (parent, child) if frame not in at]:
        have = ", ".join(sorted(at)[:12]) or "no frames"
        raise LocfuseError(f"{source} has no frame {missing[0]}; it has {have}")
    if (path := path_between(at, parent, child)) is None:
        raise LocfuseError(f"{source}: nothing connects the frames {parent} and {child}")
    return path


def _delay_s(log_time: Ints, stamp: Ints) -> float:
    """Return the median delay of recording after the stamps [s]."""
    return float(np.median(log_time - stamp)) * 1e-9


def _at(edge: FrameEdge, t_ns: Ints) -> Array:
    """Return the transforms (n, 4, 4) of an edge, interpolated at times t_ns (n,) within its span."""
    rows = edge.clock.rows
    values = edge.values if rows is None else edge.values[rows]
    last = np.append(np.diff(edge.clock.t_ns) > 0, True)  # of several transforms at one time, the last one is used
    at, values = edge.clock.t_ns[last], values[last].copy()
    signs = np.where((values[1:, 3:] * values[:-1, 3:]).sum(axis=1) < 0.0, -1.0, 1.0)
    values[1:, 3:] *= np.cumprod(signs)[:, None]  # q and -q are one rotation: interpolate along the shorter way
    zero = at[0]
    grid, times = (at - zero) * 1e-9, (t_ns - zero) * 1e-9
    return matrices_of(interpolate(times, grid, values))


def loop_in(edges: Sequence[FrameEdge]) -> tuple[str, ...]:
    """Return the frames of a loop (a frame that is its own ancestor), parent first; () without a loop."""
    tree = TopologicalSorter[str]()
    for edge in sorted(edges, key=lambda edge: edge.child):
        tree.add(edge.child, edge.parent)
    try:
        tree.prepare()
    except CycleError as found:
        return tuple(found.args[1])
    return ()


# --- Tags that /tf publishes as one transform camera -> tag per detection

TAGS = "locfuse/msg/TagFrames"  # id, x, y, z [m] in the camera's optical axes (REP 103: x right, y down, z ahead)
OF_CAMERA = "tags"  # the last part of "/tf:camera_optical:tags"
NUMBERED = re.compile(r"^(.*?)(\d+)$", re.DOTALL)
MAX_ID = 2**62
# the pattern must not match "stage"
TAG_NAME = re.compile(r"tags?(?![a-z])|marker|aruco|april|fiducial|landmark|beacon|\d+h\d+")
MIN_UPRIGHT_SHARE = 0.7  # vertical component of the z axis; above it, a frame has body axes (z up)


def number_of(frame: str) -> int | None:
    """Return the number at the end of a frame's name ("tag_3", "tag36h11:5"); None without one."""
    match = NUMBERED.match(frame)
    return int(match[2][-18:]) % MAX_ID if match else None


def named_as_tag(frame: str) -> bool:
    """Return whether a frame has a name that is typical of a tag, with a number at its end."""
    name = frame.rpartition("/")[2].lower()
    return number_of(name) is not None and TAG_NAME.search(name) is not None


def in_optical_axes(p: Array, frame: str, transforms: StaticTransforms) -> Array:
    """Return positions (n, 3) [m] in a camera's frame as positions in optical axes (x right, y down, z ahead).

    The frame has optical axes if its name contains "optical", else if its z axis is not upright in its root frame.
    If it has no root frame: if more positions have z > 0 than x > 0.
    """
    above = ancestors(transforms, frame)
    if "optical" in frame.lower():
        optical = True
    elif above:
        optical = abs(float(above[-1][1][2, 2])) < MIN_UPRIGHT_SHARE
    else:
        optical = bool((p[:, 2] > 0.0).mean() > (p[:, 0] > 0.0).mean()) if len(p) else True
    return p if optical else np.stack((-p[:, 1], -p[:, 2], p[:, 0]), axis=-1)


def tags_in(topic: str, order: str, edges: Sequence[FrameEdge], static: StaticTransforms) -> clocks.MadeStream:
    """Return the tags seen by a camera as a stream, one row per sighting: id, and x, y, z [m] in optical axes.

    A transform exactly equal to the previous one of its tag is not a new sighting, and is dropped.
    """
    camera = edges[0].parent
    recorded, stamps = (np.concatenate([getattr(e, name) for e in edges]) for name in ("log_time", "stamp"))
    ids = np.concatenate([np.full(len(e.stamp), number_of(e.child)) for e in edges])
    places = in_optical_axes(np.concatenate([e.values for e in edges])[:, :3], camera, static)
    first = np.zeros(1, bool)
    repeated = np.concatenate([np.append(first, (np.diff(e.values, axis=0) == 0).all(axis=1)) for e in edges])
    by_record = np.argsort(recorded, kind="stable")
    by_record = by_record[~repeated[by_record]]
    clock = clocks.settle(recorded[by_record], stamps[by_record], order)
    rows = by_record if clock.rows is None else by_record[clock.rows]
    data = {"id": ids[rows].astype(np.int64), **dict(zip("xyz", places[rows].T, strict=True))}
    dropped = {**clock.dropped, **({"repeat": int(repeated.sum())} if repeated.any() else {})}
    delay_s = _delay_s(recorded, stamps)
    return clocks.MadeStream(topic, TAGS, clock.t_ns, data, camera, dropped, clock=clock, delay_s=delay_s)


def tags_of(edges: Mapping[tuple[str, str], FrameEdge], camera: str) -> list[FrameEdge]:
    """Return the transforms of tags in a camera frame: those of frames whose name ends in a number.

    If some of these names are typical of tags ("tag_3"), only these are returned. Frames that never move relative
    to the camera are parts of the robot and are left out.
    """
    found = [
        edge
        for (parent, child), edge in edges.items()
        if parent == camera and number_of(child) is not None and (edge.moves or len(edge.stamp) == 1)
    ]
    return [edge for edge in found if named_as_tag(edge.child)] or found
