"""The plainest localisation, for closing the simulator's loop in tests: wheel angles summed along arcs."""

from __future__ import annotations

import math
from typing import Any

from locfuse.sample_logs.messages import Estimator, Pose, RawMessage


def dead_reckoning(tables: dict[str, dict[str, Any]]) -> Estimator:
    """Return an estimator for robot.toml tables that knows nothing but the wheels."""
    wheels, start = tables["wheels"], tables["start"]
    x, y, theta = start["x"], start["y"], math.radians(start["theta_deg"])
    last: list[float] = []

    def estimate(messages: list[RawMessage]) -> Pose:
        nonlocal x, y, theta
        for message in messages:
            if message.topic != wheels["topic"]:
                continue
            now = message.fields["position"].tolist()
            left, right = (wheels["radius"] * (b - a) for a, b in zip(last or now, now, strict=True))
            half = (right - left) / wheels["track"] / 2
            chord = (left + right) / 2 * (math.sin(half) / half if half else 1.0)
            x, y = x + chord * math.cos(theta + half), y + chord * math.sin(theta + half)
            theta += 2 * half
            last[:] = now
        return x, y, theta

    return estimate
