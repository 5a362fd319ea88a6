"""A drive round a ring of corridors, scanned by a ray caster of its own: no code of the product but its values."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import rooms

from locfuse.fusion import se2
from locfuse.fusion.data import Array, Drive, Ints, Measurements
from locfuse.fusion.measure import cut
from locfuse.fusion.robot import Robot
from locfuse.fusion.sensors.registry import REGISTRY
from locfuse.fusion.wheels.motion import Wheels

BEAMS, RANGE_M, NOISE_M = 120, 9.0, 0.01
STEP_S, SPEED_M_S, SCAN_S = 0.1, 0.5, 0.4
LENGTH, WIDTH, CORRIDOR = 16.0, 8.0, 2.0  # m, of the corridors' middle lines, and between their walls


def box(x0: float, y0: float, x1: float, y1: float) -> list[tuple[float, float, float, float]]:
    return [(x0, y0, x1, y0), (x1, y0, x1, y1), (x1, y1, x0, y1), (x0, y1, x0, y0)]


def walls(alike: bool) -> Array:
    """The ring's walls (k, 4), with lockers along them; `alike`: the same ones on opposite sides."""
    h = CORRIDOR / 2.0
    found = box(-h, -h, LENGTH + h, WIDTH + h) + box(h, h, LENGTH - h, WIDTH - h)
    lockers = [(2.0, -h, 0.9), (5.5, -h, 0.5), (7.0, h - 0.4, 0.7), (11.0, -h, 1.3), (13.5, h - 0.4, 0.5)]
    others = [(3.5, 0.6), (9.0, 1.4), (12.4, 0.4)]
    for x, y, w in lockers:
        found += box(x, y, x + w, y + 0.4)
        if alike:  # turned by half a turn about the middle of the ring
            found += box(LENGTH - x - w, WIDTH - y - 0.4, LENGTH - x, WIDTH - y)
    if not alike:
        for x, w in others:
            found += box(x, WIDTH + h - 0.4, x + w, WIDTH + h)
        found += box(-h, 3.0, -h + 0.4, 4.1) + box(LENGTH + h - 0.3, 4.5, LENGTH + h, 5.0)
    return np.array(found)


def path(laps: float) -> tuple[Array, Array]:
    """Stamps (n,) and true poses (n, 3) round the ring, counter-clockwise, turning on the spot at the corners."""
    poses = [np.zeros(3)]
    corners = [(LENGTH, 0.0), (LENGTH, WIDTH), (0.0, WIDTH), (0.0, 0.0)]
    sides = round(4 * laps)
    for k in range(sides):
        goal, now = np.array(corners[k % 4]), poses[-1]
        n = int(np.hypot(*(goal - now[:2])) / (SPEED_M_S * STEP_S))
        poses += [np.append(now[:2] + (goal - now[:2]) * s / n, now[2]) for s in range(1, n + 1)]
        if k + 1 < sides:
            poses += [poses[-1] + np.array([0.0, 0.0, np.pi / 40.0]) * s for s in range(1, 21)]
    found = np.array(poses)
    return np.arange(len(found)) * np.float64(STEP_S), found


def scan(pose: Array, segments: Array, rng: np.random.Generator) -> Array:
    """What the laser sees from a pose, (k, 2) in its own frame."""
    angle = np.linspace(-np.pi, np.pi, BEAMS, endpoint=False)
    ranges = rooms.scan(segments, pose, angle) + NOISE_M * rng.normal(size=BEAMS)
    seen = ranges < RANGE_M
    r, angle = ranges[seen], angle[seen]
    return np.stack((r * np.cos(angle), r * np.sin(angle)), axis=-1)


@dataclass(frozen=True, eq=False)
class Held:
    """Points in memory, of a robot whose wheels say nothing here."""

    scans: list[Array]  # in the laser's frame
    mount: Array = field(default_factory=lambda: np.zeros(3))

    def take(self, readings: Ints) -> Held:
        return Held([self.scans[i] for i in readings.tolist()], self.mount)

    def mounted(self, mount: Array) -> Held:
        return Held(self.scans, mount)

    def moved(self, t_from: Array, t_to: Array) -> Array:
        return np.zeros((len(t_to), 3))

    def read(self, readings: Ints) -> list[Array]:
        seen = [self.scans[i] for i in readings.tolist()]
        return [se2.transform(np.broadcast_to(self.mount, (len(p), 3)), p) for p in seen]


def ring_drive(
    seed: int, laps: float = 2.25, alike: bool = False, drift: float = 0.004, mount: Array | None = None
) -> tuple[Drive, Array]:
    """Return a drive and its true poses at the drive's instants; the wheels' turns drift by `drift` [rad/m].

    `mount` (3,) is where the laser truly sits, if not at the axle, where it is configured.
    """
    sits = np.zeros(3) if mount is None else mount
    rng = np.random.default_rng(seed)
    t, truth = path(laps)
    motion = se2.between(truth[:-1], truth[1:])
    twist = se2.log(motion)
    twist[:, 2] += drift * np.abs(twist[:, 0]) + 0.01 * np.sqrt(np.abs(twist[:, 0])) * rng.normal(size=len(twist))
    twist[:, 0] *= 1.01
    segments, every = walls(alike), int(SCAN_S / STEP_S)
    at = np.arange(0, len(t), every)
    scans = [scan(se2.compose(truth[k], sits), segments, rng) for k in at]
    nothing = np.zeros(len(at) + 1, np.int64)
    m = Measurements(
        t[at],
        nothing,
        np.zeros((0, 2)),
        np.zeros((0, 2, 2)),
        0.02,
        np.eye(2) * 1e-6,
        {"ends": np.zeros((0, 2))},
        {},
        Held(scans),
    )
    wheels, measured = Wheels.from_twists(t, twist, 0.3, 4e-4), {"lrf": m}
    drive = Drive(
        epoch_ns=0, measurements=measured, absent={}, wheels=wheels, **cut(wheels, Robot(), measured, None)
    )
    k = np.searchsorted(t, drive.t - 1e-9)
    return drive, truth[k]


def robot() -> Robot:
    return Robot(sensors={name: sensor.Settings() for name, sensor in REGISTRY.items()})
