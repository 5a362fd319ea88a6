"""Straight runs and turns on the spot, found in wheel motion: pieces of a drive whose errors have closed forms."""

from __future__ import annotations

import math

import msgspec
import numpy as np

from locfuse.fusion.data import Array, Ints

from .motion import Wheels

STRAIGHT, TURN = 0, 1
KINDS = ("straight", "turn")
WINDOW_S = 0.3  # s over which the motion is looked at
STANDSTILL_MPS = 0.01  # m/s at the rim: below, nothing moves
MAX_OTHER_SHARE = 0.2  # at most this share of the rim's motion may be of the other kind
MAX_BEND_RAD_PER_M = 0.7  # rad/m: a straight run may wobble, but not turn more than that
MIN_RUNS = (0.5, math.radians(45.0))  # m, rad: shorter runs are not used


class Runs(msgspec.Struct, frozen=True):
    """Stretches of one kind of motion in one direction, n of them."""

    kind: Ints  # (n,) STRAIGHT or TURN
    start: Array  # (n,) s
    end: Array  # (n,) s


def find_runs(wheels: Wheels) -> Runs:
    """Return the straight runs and turns on the spot of a drive, in time order."""
    label = _labels(wheels)
    edges = np.flatnonzero(np.diff(label, prepend=0, append=0))
    found = []
    for a, b in zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True):
        if label[a] == 0:
            continue
        kind = STRAIGHT if abs(label[a]) == 1 else TURN
        if abs(float(wheels.twist[a:b, (0, 2)[kind]].sum())) >= MIN_RUNS[kind]:
            found.append((kind, float(wheels.t[a]), float(wheels.t[b])))
    kinds, starts, ends = zip(*found, strict=True) if found else ((), (), ())
    return Runs(np.array(kinds, np.int64), np.array(starts, float), np.array(ends, float))


def _labels(wheels: Wheels) -> Ints:
    """Label every wheel interval: +-1 straight forward or backward, +-2 turning left or right, 0 anything else."""
    middle = 0.5 * (wheels.t[1:] + wheels.t[:-1])
    way = np.concatenate((np.zeros((1, 2)), np.cumsum(wheels.twist[:, [0, 2]], axis=0)))
    before, after = (
        np.stack([np.interp(middle + h, wheels.t, column) for column in way.T], axis=-1)
        for h in (-0.5 * WINDOW_S, 0.5 * WINDOW_S)
    )
    ds, turn = (after - before).T
    rim = 0.5 * wheels.track * turn
    moving = np.abs(ds) + np.abs(rim) > STANDSTILL_MPS * WINDOW_S
    straight = (np.abs(rim) <= MAX_OTHER_SHARE * np.abs(ds)) & (np.abs(turn) <= MAX_BEND_RAD_PER_M * np.abs(ds))
    label = np.where(straight, np.sign(ds), 0.0)
    label = np.where(np.abs(ds) <= MAX_OTHER_SHARE * np.abs(rim), 2.0 * np.sign(rim), label)
    return np.where(moving, label, 0.0).astype(np.int64)


def cut_runs(runs: Runs, wheels: Wheels, stamps: Array, least: tuple[float, float]) -> tuple[Ints, Ints, Ints]:
    """Cut runs at `stamps` (m,) [s] into equal pieces of about `least` (m, rad), or leave them whole.

    Returns (kind, first stamp, last stamp) of each piece, (k,) each; pieces follow each other and do not overlap.
    """
    rolled = np.concatenate((np.zeros((1, 2)), np.cumsum(np.abs(wheels.twist[:, [0, 2]]), axis=0)))
    way = [np.interp(stamps, wheels.t, column) for column in rolled.T]
    pieces = [np.zeros((0, 3), np.int64)]
    for kind, start, end in zip(runs.kind.tolist(), runs.start.tolist(), runs.end.tolist(), strict=True):
        a, b = np.searchsorted(stamps, start).item(), np.searchsorted(stamps, end, side="right").item() - 1
        if a >= b or (total := float(way[kind][b] - way[kind][a])) < 0.5 * MIN_RUNS[kind]:
            continue
        cuts = np.linspace(way[kind][a], way[kind][b], max(1, int(total / least[kind])) + 1)
        at = np.unique(np.clip(np.searchsorted(way[kind], cuts), a, b))
        pieces.append(np.stack((np.full(len(at) - 1, kind), at[:-1], at[1:]), axis=-1))
    kinds, first, last = np.concatenate(pieces).T
    return kinds, first, last
