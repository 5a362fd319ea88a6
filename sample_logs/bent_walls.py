"""Bent walls: every wall face deviates smoothly from its straight line, and the deviation is the truth.

All faces on one straight line share one smooth function, so that a wall goes on behind a doorway as it was bent
before it. Faces become chains of short segments, which rays meet exactly. Faces still meet at their corners.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from locfuse.fusion.data import Array

from .messages import Streams

PIECE = 0.6  # m, longest segment of a bent face
WAVES = np.geomspace(4.0, 40.0, 7)  # m, lengths of the waves that make up a deviation
REACH = 100.0  # m: a deviation keeps within its bow up to here

Deviation = Callable[[Array], Array]


def bent(faces: Array, bow: float, streams: Streams) -> Array:
    """Return straight faces (m, 4), parallel to the axes, as chains of short segments (k, 4) m.

    Args:
        faces: m, map frame.
        bow: m, how far a face may deviate from its line.
        streams: sources of chance; each line has its own.
    """
    if bow == 0.0 or not len(faces):
        return faces
    lines = _Lines(bow, streams)
    return np.concatenate([_chain(face, lines) for face in faces])


def deviation(bow: float, rng: np.random.Generator) -> Deviation:
    """Return a smooth function of the place along a line, bounded by `bow` within REACH [m to m]."""
    amplitude = np.sqrt(WAVES) * rng.standard_normal(len(WAVES))
    phase = rng.uniform(0, 2 * np.pi, len(WAVES))

    def waves(s: Array) -> Array:
        return np.asarray(np.sin(2 * np.pi * s[:, None] / WAVES + phase) @ amplitude)

    most = np.abs(waves(np.arange(-1.0, REACH, 0.1))).max()
    scale = bow * rng.uniform(0.5, 1.0) / most
    return lambda s: scale * waves(s)


class _Lines:
    """The deviation of every straight line, drawn on first use."""

    def __init__(self, bow: float, streams: Streams) -> None:
        self.bow = bow
        self.streams = streams
        self.known: dict[tuple[int, float], Deviation] = {}

    def off(self, axis: int, offset: float, s: Array) -> Array:
        """Return how far the line "coordinate `axis` = `offset`" is off at the places s (n,) along it, (n,) m."""
        key = axis, round(offset, 6)
        if key not in self.known:
            name = f"wall {'xy'[axis]} = {key[1]:.6f}"
            self.known[key] = deviation(self.bow, self.streams(name))
        return self.known[key](s)


def _chain(face: Array, lines: _Lines) -> Array:
    """Return one face as a chain of segments, (k, 4); its ends move with both lines that meet there."""
    across = 0 if face[0] == face[2] else 1  # the coordinate that is constant
    along = 1 - across
    offset, begin, end = float(face[across]), float(face[along]), float(face[along + 2])
    s = np.linspace(begin, end, max(1, int(np.ceil((end - begin) / PIECE))) + 1)
    points = np.empty((len(s), 2))
    points[:, across] = offset + lines.off(across, offset, s)
    points[:, along] = s
    for i, at in ((0, begin), (-1, end)):
        points[i, along] += lines.off(along, at, np.array([offset]))[0]
    return np.concatenate((points[:-1], points[1:]), axis=1)
