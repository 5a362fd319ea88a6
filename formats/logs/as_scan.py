"""A laser's scans out of other messages: a level slice of a point cloud, the first echoes of a MultiEchoLaserScan.

Of a cloud those points count that lie 0.2 degrees below to 2.2 degrees above the level of the sensor: one or two
rings of a spinning laser (16 rings are 2 degrees apart), which the floor does not reach. Their directions are
sorted into half degrees, and of each the point nearest to its middle is the beam.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, cast

import numpy as np

from locfuse.formats.geometry import headings
from locfuse.fusion.data import Array, Column, Ragged

SCAN = "sensor_msgs/msg/LaserScan"
CLOUD = "sensor_msgs/msg/PointCloud2"
ECHOES = "sensor_msgs/msg/MultiEchoLaserScan"
FOXGLOVE = ("foxglove.LaserScan", "foxglove_msgs/msg/LaserScan")
FOXGLOVE_CLOUD = ("foxglove.PointCloud", "foxglove_msgs/msg/PointCloud")
OF_CLOUD = (
    *(f"fields.{name}" for name in ("name", "offset", "datatype")),
    *("height", "width", "point_step", "row_step", "is_bigendian", "data"),
)
LIKE_A_SCAN = ("angle_min", "angle_increment", "time_increment", "range_min", "range_max")
FIRST_ECHOES = ("ranges.echoes", "ranges.echoes.length")
OF_ECHOES = (*LIKE_A_SCAN, *FIRST_ECHOES)
TURN = tuple(f"pose.orientation.{axis}" for axis in "xyzw")
PLACE = tuple(f"pose.position.{axis}" for axis in "xyz")
OF_FOXGLOVE_CLOUD = (
    "point_stride",
    *(f"fields.{part}" for part in ("name", "offset", "type")),
    "data",
    *PLACE,
    *TURN,
)
OF_FOXGLOVE = ("start_angle", "end_angle", "ranges", *TURN)
BEAMS = 720
LOW_RAD, HIGH_RAD = np.radians((-0.2, 2.2))  # of a point above the sensor's level
NEAR_M, FAR_M = 0.3, 100.0  # m: nearer is the robot itself
DATATYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}  # sensor_msgs/PointField
PACKED = np.array([0, 2, 1, 4, 3, 6, 5, 7, 8])  # foxglove.PackedElementField's numeric type -> PointField's
OPTICAL = "_optical"  # a camera's frame: x right, y down, z ahead


def level_frame(frame_id: str) -> str:
    """Return the frame in which a scan lies: that of the camera's body for its optical frame."""
    return frame_id.replace(OPTICAL, "")


def echoes_as_scans(columns: Mapping[str, Column], fields: tuple[str, ...], frame_id: str) -> dict[str, Column]:
    """Return fields of LaserScans made of k MultiEchoLaserScans; `columns` are OF_ECHOES."""
    return {name: _first_echoes(columns) if name == "ranges" else columns[name] for name in fields}


def cloud_as_scans(columns: Mapping[str, Column], fields: tuple[str, ...], frame_id: str) -> dict[str, Column]:
    """Return fields of LaserScans made of k clouds in the frame `frame_id`; `columns` are OF_CLOUD."""
    n = len(cast("Array", columns["width"]))
    return _as_scans(n, lambda i: points(columns, i), fields, frame_id)


def _as_scans(n: int, cloud: Callable[[int], Array], fields: tuple[str, ...], frame_id: str) -> dict[str, Column]:
    """Return fields of LaserScans made of n clouds; `cloud` gives the points (m, 3) [m] of one of them."""
    step = 2.0 * np.pi / BEAMS
    fixed = {"angle_min": -np.pi + 0.5 * step, "angle_increment": step, "time_increment": 0.0}
    fixed |= {"range_min": NEAR_M, "range_max": FAR_M}
    made: dict[str, Column] = {name: np.full(n, value) for name, value in fixed.items()}
    if "ranges" in fields:
        ranges = [level_slice(cloud(i), OPTICAL in frame_id) for i in range(n)]
        values = np.concatenate([np.empty(0), *ranges]).astype(np.float32)
        made["ranges"] = Ragged(values, np.arange(n + 1) * BEAMS)
    return {name: made[name] for name in fields}


def foxglove_clouds_as_scans(
    columns: Mapping[str, Column], fields: tuple[str, ...], frame_id: str
) -> dict[str, Column]:
    """Return fields of LaserScans made of k of Foxglove's clouds, placed by their pose; OF_FOXGLOVE_CLOUD."""
    step = np.asarray(columns["point_stride"], np.float64)
    data = cast("list[bytes]", columns["data"])
    bytes_of = np.array([len(one) for one in data], np.float64)
    kinds = cast("Ragged", columns["fields.type"])
    known = (kinds.values >= 0) & (kinds.values < len(PACKED))
    packed = PACKED[np.where(known, kinds.values, 0).astype(np.int64)]
    flat = {"height": np.ones(len(step)), "width": bytes_of // np.maximum(step, 1.0), "row_step": bytes_of}
    cloud: dict[str, Column] = {**columns, **flat, "is_bigendian": np.zeros(len(step), bool), "point_step": step}
    cloud["fields.datatype"] = Ragged(packed, kinds.first)
    place, turn = (
        np.stack([np.asarray(columns[name], np.float64) for name in names], axis=-1) for names in (PLACE, TURN)
    )
    return _as_scans(len(step), lambda i: _moved(points(cloud, i), place[i], turn[i]), fields, frame_id)


def _moved(xyz: Array, place: Array, quaternion: Array) -> Array:
    """Return points (n, 3) [m] seen from where their frame has a place (3,) and a turn x, y, z, w (4,)."""
    axis, w = quaternion[:3], quaternion[3]
    norm = float(quaternion @ quaternion)
    if not 0.0 < norm < np.inf:  # no orientation: none is meant
        return xyz + np.nan_to_num(place)
    across = np.cross(axis, xyz)
    turned: Array = xyz + 2.0 / norm * (w * across + np.cross(axis, across))
    return turned + np.nan_to_num(place)


def foxglove_as_scans(columns: Mapping[str, Column], fields: tuple[str, ...], frame_id: str) -> dict[str, Column]:
    """Return fields of LaserScans made of k of Foxglove's, evenly spaced from start to end; turned by their pose.

    They say neither how long a scan takes nor which ranges are none: what is no number or not above zero.
    """
    start, end = (np.asarray(columns[name], np.float64) for name in ("start_angle", "end_angle"))
    ranges = cast("Ragged", columns["ranges"])
    beams = np.maximum(ranges.lengths - 1, 1)
    turn = headings(*(np.asarray(columns[name], np.float64) for name in TURN))
    made: dict[str, Column] = {
        "angle_min": start + np.where(np.isfinite(turn), turn, 0.0),
        "angle_increment": (end - start) / beams,
        **{name: np.zeros(len(start)) for name in ("time_increment", "range_min")},
        "range_max": np.full(len(start), FAR_M),
        "ranges": Ragged(ranges.values.astype(np.float32), ranges.first),
    }
    return {name: made[name] for name in fields}


def _first_echoes(columns: Mapping[str, Column]) -> Ragged:
    """Return the first echo of each beam, Inf where there is none."""
    echoes, lengths = cast("Ragged", columns["ranges.echoes"]), cast("Ragged", columns["ranges.echoes.length"])
    counts = lengths.values.astype(np.int64)
    first = np.cumsum(counts) - counts
    values = np.full(len(counts), np.inf, np.float32)
    values[counts > 0] = echoes.values[first[counts > 0]]
    return Ragged(values, lengths.first)


def points(columns: Mapping[str, Any], i: int) -> Array:
    """Return the points of cloud i, (n, 3) m in its frame; none where its fields do not say x, y and z."""
    nothing: Array = np.empty((0, 3))
    names, first = columns["fields.name"][i], columns["fields.offset"].first[i]
    if not {"x", "y", "z"} <= set(names):
        return nothing
    at = [names.index(axis) for axis in "xyz"]
    kinds = [DATATYPES.get(int(columns["fields.datatype"].values[first + k]), "") for k in at]
    offsets = [int(columns["fields.offset"].values[first + k]) for k in at]
    step, width, height, row = (int(columns[k][i]) for k in ("point_step", "width", "height", "row_step"))
    if (
        not all(kinds)
        or not 1 <= step <= len(columns["data"][i])  # one point at least, and no dtype of gigabytes
        or max(o + np.dtype(k).itemsize for o, k in zip(offsets, kinds, strict=True)) > step
    ):
        return nothing
    order = ">" if columns["is_bigendian"][i] else "<"
    layout = np.dtype(
        {"names": list("xyz"), "formats": [order + k for k in kinds], "offsets": offsets, "itemsize": step}
    )
    data = np.frombuffer(columns["data"][i], np.uint8)
    if height > 1 and row > width * step:  # rows that are padded
        data = data[: len(data) // row * row].reshape(-1, row)[:, : width * step].reshape(-1)
    cloud = np.frombuffer(data[: len(data) // step * step].tobytes(), layout)
    return np.stack([cloud[axis].astype(np.float64) for axis in "xyz"], axis=-1)


def level_slice(xyz: Array, optical: bool = False) -> Array:
    """Return the ranges (BEAMS,) [m] of points (n, 3) [m] about the sensor's level, Inf where there is none."""
    if optical:
        xyz = np.stack((xyz[:, 2], -xyz[:, 0], -xyz[:, 1]), axis=-1)
    ranges = np.full(BEAMS, np.inf)
    away = np.hypot(xyz[:, 0], xyz[:, 1])
    with np.errstate(invalid="ignore"):
        level = (xyz[:, 2] >= away * np.tan(LOW_RAD)) & (xyz[:, 2] <= away * np.tan(HIGH_RAD))
        seen = level & (away >= NEAR_M) & (away <= FAR_M)
    away, xyz = away[seen], xyz[seen]
    turned = (np.arctan2(xyz[:, 1], xyz[:, 0]) + np.pi) * (BEAMS / (2.0 * np.pi))
    beam = np.minimum(turned.astype(np.int64), BEAMS - 1)
    order = np.lexsort((away, np.abs(turned - beam - 0.5), beam))
    found, nearest = np.unique(beam[order], return_index=True)
    ranges[found] = away[order][nearest]
    return ranges
