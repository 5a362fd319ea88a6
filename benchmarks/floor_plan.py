"""A floor plan as an image and a YAML file for ROS map_server: an occupancy grid of static things."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from locfuse.fusion.data import Array
from locfuse.sample_logs.table import Point
from locfuse.sample_logs.world import Plan

OCCUPIED, UNKNOWN, FREE = 0, 205, 254  # grey levels that map_server writes itself
MARGIN = 0.5  # m around everything


class FloorPlan(NamedTuple):
    """An occupancy grid; its first row is the northernmost."""

    image: NDArray[np.uint8]  # (rows, columns)
    cell: float  # m
    origin: Point  # m, map frame: the lower left corner of the lower left cell


def floor_plan(plan: Plan, inside: Point, cell_m: float = 0.05) -> FloorPlan:
    """Return static things as an occupancy grid; cells not connected with `inside` are unknown.

    Args:
        plan: segments and circles at one height, such as `scene.obstacles(0.25)`.
        inside: m, map frame: a free place.
        cell_m: m.
    """
    points = np.concatenate((_on_segments(plan.segments, cell_m), _on_circles(plan.circles, cell_m)))
    low = np.floor((points.min(axis=0) - MARGIN) / cell_m) * cell_m
    columns, rows = (np.ceil((points.max(axis=0) + MARGIN - low) / cell_m)).astype(int).tolist()
    grid = np.full((rows, columns), UNKNOWN, np.uint8)  # the first row is the southernmost
    i, j = np.floor((points - low) / cell_m).astype(int).T
    grid[j, i] = OCCUPIED
    x, y = np.floor((np.array(inside) - low) / cell_m).astype(int).tolist()
    cv2.floodFill(grid, None, (x, y), FREE)
    return FloorPlan(grid[::-1].copy(), cell_m, (float(low[0]), float(low[1])))


def write(plan: FloorPlan, path: Path) -> None:
    """Write `path`.pgm and `path`.yaml."""
    rows, columns = plan.image.shape
    image = path.with_suffix(".pgm")
    image.write_bytes(f"P5\n{columns} {rows}\n255\n".encode() + plan.image.tobytes())
    x, y = plan.origin
    path.with_suffix(".yaml").write_text(
        f"image: {image.name}\n"
        "mode: trinary\n"
        f"resolution: {plan.cell:g}\n"
        f"origin: [{x:.6g}, {y:.6g}, 0]\n"
        "negate: 0\n"
        "occupied_thresh: 0.65\n"
        "free_thresh: 0.25\n"
    )


def _on_segments(segments: Array, cell: float) -> Array:
    """Return points on segments, dense enough that a flood fill cannot pass between them."""
    found = [np.zeros((0, 2))]
    for x1, y1, x2, y2 in segments:
        n = int(np.ceil(max(abs(x2 - x1), abs(y2 - y1)) / (cell / 4))) + 1
        found.append(np.linspace((x1, y1), (x2, y2), n))
    return np.concatenate(found)


def _on_circles(circles: Array, cell: float) -> Array:
    """Return points on circles."""
    found = [np.zeros((0, 2))]
    for x, y, radius in circles:
        angle = np.linspace(0, 2 * np.pi, max(8, int(np.ceil(2 * np.pi * radius / (cell / 4)))))
        found.append(np.stack((x + radius * np.cos(angle), y + radius * np.sin(angle)), axis=-1))
    return np.concatenate(found)
