"""The bearing of a known landmark as a function of the pose, right and as printed."""

from __future__ import annotations

from locfuse.fusion.se2 import sight, wrap

Point = tuple[float, float]
Row = tuple[float, float, float]
MIN_DISTANCE_M = 0.05  # m: nearer than this the camera is inside the landmark
H_ORIENTATION: Row = (0.0, 0.0, 1.0)  # the camera's row of eq. 13, as printed


def paper_orientation(direction: float, bearing: float) -> float:
    """gamma_k of eq. 16 [rad]: the landmark's direction in the map minus its bearing in the base frame."""
    return direction - bearing


def predict_bearing(
    pose: tuple[float, float, float], landmark: Point, lever: Point, yaw: float
) -> tuple[float, Row] | None:
    """Return h(x) [rad] and its row H (x, y, theta) for a camera at `lever`, `yaw` on the base.

    None where the camera is inside the landmark.
    """
    seen = sight(pose, landmark, (*lever, yaw), MIN_DISTANCE_M)
    return None if seen is None else (wrap(seen[0]), seen[2])
