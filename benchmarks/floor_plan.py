"""A floor plan as an image and a YAML file for ROS map_server: an occupancy grid of walls and furniture."""

from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from locfuse.fusion.data import Array
from locfuse.sample_logs.table import Point
from locfuse.sample_logs.world import Plan

OCCUPIED, UNKNOWN, FREE = 0, 205, 254  # grey levels, as written by map_server
MARGIN = 0.5  # m around all segments and circles
SHIFT = 8  # bits of a pixel's fraction, so that ends of lines are not rounded to cells


class FloorPlan(NamedTuple):
    """An occupancy grid; its first row is the northernmost."""

    image: NDArray[np.uint8]  # (rows, columns)
    cell: float  # m
    origin: Point  # m, map frame: the lower left corner of the lower left cell


def floor_plan(plan: Plan, inside: Point, cell_m: float = 0.05) -> FloorPlan:
    """Return a plan as an occupancy grid; cells that are not connected with `inside` are unknown.

    Args:
        plan: segments and circles at one height, such as `scene.obstacles(0.25)`.
        inside: a free position, m, map frame.
        cell_m: size of a cell, m.
    """
    ends, radius = plan.segments.reshape(-1, 2), plan.circles[:, 2:]
    points = np.concatenate((ends, plan.circles[:, :2] - radius, plan.circles[:, :2] + radius))
    low = np.floor((points.min(axis=0) - MARGIN) / cell_m) * cell_m
    columns, rows = (np.ceil((points.max(axis=0) + MARGIN - low) / cell_m)).astype(int).tolist()
    grid = np.full((rows, columns), UNKNOWN, np.uint8)  # the first row is the southernmost

    def pixels(at: Array) -> list[list[int]]:
        found: list[list[int]] = np.round(((at - low) / cell_m - 0.5) * 2**SHIFT).astype(int).tolist()
        return found

    for a, b in zip(pixels(ends[::2]), pixels(ends[1::2]), strict=True):
        cv2.line(grid, a, b, OCCUPIED, shift=SHIFT)
    for centre, (r,) in zip(pixels(plan.circles[:, :2]), radius.tolist(), strict=True):
        cv2.circle(grid, centre, round(r / cell_m * 2**SHIFT), OCCUPIED, shift=SHIFT)
    x, y = np.floor((np.array(inside) - low) / cell_m).astype(int).tolist()
    cv2.floodFill(grid, None, (x, y), FREE)
    return FloorPlan(grid[::-1].copy(), cell_m, (float(low[0]), float(low[1])))


def write(plan: FloorPlan, path: Path) -> None:
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
