"""Wheel parameters as filter states (`wheels.estimate`): radius, ratio and track.

The motion is linear in the states a, b, q: the left and right wheel roll (1 + a) and (1 + b) times the configured
distance, and a difference of distances turns the robot by (1 + s - q) / track, where s is the mean of a and b.
Reports give radius, ratio and track: if the configured track is 15 % too small, q is 13 %.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from locfuse.fusion.data import Array, Component
from locfuse.fusion.robot import WheelSettings
from locfuse.fusion.sensor import Block

WHEELS = "wheels"
WHEEL_STATES: dict[str, Sequence[Component]] = {
    WHEELS: (
        Component("left wheel's scale", "%", 100.0),
        Component("right wheel's scale", "%", 100.0),
        Component("track, to first order", "%", 100.0),
    )
}
MAX_PRIOR_SHARE = 0.7  # a state with a larger share of its prior standard deviation is not identifiable
MAX_PRIOR_SIGMAS = 2.0  # prior standard deviations beyond which the distance scales of wheels and sensors differ


def wheel_block(wheels: WheelSettings) -> Block:
    """Return the wheel states with their prior: corrections of left wheel, right wheel and track, initially 0."""
    variance = np.array([wheels.sigma_scale, wheels.sigma_scale, wheels.sigma_track]) ** 2
    return Block(WHEELS, np.zeros(3), np.diag(variance), np.zeros(3))


def geometry(x: Array) -> Array:
    """Return the relative corrections (3,) of radius, ratio right / left, and track, for states x (3,)."""
    s, q = 0.5 * (x[0] + x[1]), x[2]
    return np.array([s, (1.0 + x[1]) / (1.0 + x[0]) - 1.0, (1.0 + s) / (1.0 + s - q) - 1.0])


def derivative(x: Array) -> Array:
    """Return the derivative (3, 3) of `geometry` by the states x (3,)."""
    a, b, q = x.tolist()
    s = 0.5 * (a + b)
    by_scale, by_turn = -0.5 * q / (1.0 + s - q) ** 2, (1.0 + s) / (1.0 + s - q) ** 2
    return np.array(
        [[0.5, 0.5, 0.0], [-(1.0 + b) / (1.0 + a) ** 2, 1.0 / (1.0 + a), 0.0], [by_scale, by_scale, by_turn]]
    )


def wheel_words(
    settings: WheelSettings, x: Array, P: Array, sensors: Sequence[str], metric: Mapping[str, str | None]
) -> list[str]:
    """Return notes for the user on the estimated wheel states x (3,) with covariance P (3, 3).

    `metric` maps each sensor that measures distances to the setting of its distance scale, or None.
    """
    found, G = geometry(x), derivative(x)
    sigma = np.sqrt(np.maximum(np.diagonal(G @ P @ G.T), 0.0))
    prior = settings.sigma_scale / math.sqrt(2.0)  # of the radius, the mean of both
    parts = []
    for key, change, s in zip(("radius", "ratio", "track"), found.tolist(), sigma.tolist(), strict=True):
        value = getattr(settings, key)
        if value is None:
            parts.append(f"{key} {100.0 * change:+.2f} % (1 sigma: {100.0 * s:.2f} %)")
        else:
            parts.append(f"{key} {value * (1.0 + change):.4g} (1 sigma: {value * s:.2g})")
    words = [f"found {', '.join(parts)}"]
    if sigma[0] > MAX_PRIOR_SHARE * prior:
        quotient = G[2] / (1.0 + found[2]) - G[0] / (1.0 + found[0])  # derivative of ln(track / radius)
        seen = math.sqrt(float(quotient @ P @ quotient)) < MAX_PRIOR_SHARE * settings.sigma_track
        tail = ": only track over radius is" if seen else ""
        words.append(f"radius and track are not identifiable from {' and '.join(sensors) or 'wheels alone'}{tail}")
    elif sigma[2] > MAX_PRIOR_SHARE * settings.sigma_track:
        words.append("the track is not identifiable: the robot hardly turned")
    elif abs(found[0]) > MAX_PRIOR_SIGMAS * prior:
        words += _scale_words(settings, found, prior, metric)
    return words


def _scale_words(
    settings: WheelSettings, found: Array, prior: float, metric: Mapping[str, str | None]
) -> list[str]:
    """Return notes for the user on the distance scale of wheels relative to sensors; [] if `metric` is empty.

    Only the ratio is observed, so a note cannot name which of the two is wrong. `found` (3,) are the relative
    corrections of radius, ratio and track. `metric` maps each sensor that measures distances to the setting of its
    distance scale, or None.
    """
    if not metric:
        return []
    scale, _, track = found.tolist()
    words = (
        f"by the distance scale of {' and '.join(metric)} the wheels are {100.0 * abs(scale):.1f} % "
        f"{'larger' if scale > 0 else 'smaller'} than configured, and {100.0 * prior:.1f} % was expected. "
    )
    keys = [f"{sensor}.{key}" for sensor, key in metric.items() if key]
    if len(metric) > 1 or not keys:
        return [words + "One of the two is wrong, and which is not identifiable here"]
    track_words = f", the track is {settings.track * (1.0 + track) / (1.0 + scale):.4g}" if settings.track else ""
    return [
        words + f"Which is wrong is not identifiable from them: if the radius is right, {keys[0]} should be "
        f"{1.0 / (1.0 + scale):.4g} times what it is{track_words}; if {keys[0]} is right, the figures above hold"
    ]
