"""Sensors beside the laser in the graph: a GPS and a compass hold a drive that closes no loop."""

from functools import cache

import numpy as np
from msgspec.structs import replace
from ring_drive import ring_drive, robot

from locfuse.fusion import se2
from locfuse.fusion.data import Array, Drive, Measurements
from locfuse.fusion.robot import Robot
from locfuse.fusion.sensors.compass import CompassSettings
from locfuse.fusion.sensors.gps import GpsSettings
from locfuse.fusion.whole_drive.odometry import odometry_of
from locfuse.fusion.whole_drive.others import Others
from locfuse.fusion.whole_drive.pose_graph import Graph, whole_drive

OFFSET_RAD, GPS_M, COMPASS_RAD = 0.4, 0.05, np.radians(1.0)


def described() -> Robot:
    """A robot whose GPS knows where the map lies, and whose compass does not know its offset."""
    sensors = {
        **robot().sensors,
        "gps": GpsSettings(sigma=GPS_M, origin=(50.0, 8.0), east_deg=0.0),
        "compass": CompassSettings(sigma_deg=float(np.degrees(COMPASS_RAD))),
    }
    return replace(robot(), sensors=sensors)


def readings(t: Array, z: Array, sigma: float) -> Measurements:
    n, d = z.shape
    R_unit = np.broadcast_to(np.eye(d), (n, d, d)).copy()
    more = {"strength": np.ones(n), "rest": np.zeros(n)} if d == 1 else {}
    return Measurements(t, np.arange(n + 1), z, R_unit, sigma, np.zeros((d, d)), more)


@cache
def drive() -> tuple[Drive, Array]:
    """Three quarters of the ring: no place is seen twice."""
    plain, truth = ring_drive(4, laps=0.75)
    rng = np.random.default_rng(1)
    at = np.arange(0, len(plain.t), 20)
    gps = truth[at, :2] + GPS_M * rng.normal(size=(len(at), 2))
    compass = se2.wrap_all(truth[at, 2:] + OFFSET_RAD + COMPASS_RAD * rng.normal(size=(len(at), 1)))
    more = {"gps": readings(plain.t[at], gps, GPS_M), "compass": readings(plain.t[at], compass, COMPASS_RAD)}
    instants = {**plain.instant, "gps": at, "compass": at}
    return replace(plain, measurements={**plain.measurements, **more}, instant=instants), truth


@cache
def solved(*sensors: str) -> Graph:
    graph = whole_drive(drive()[0], described(), sensors)
    assert graph is not None
    return graph


def error(graph: Graph) -> Array:
    e = graph.poses()[0] - drive()[1]
    e[:, 2] = se2.wrap_all(e[:, 2])
    return e


def rmse(graph: Graph) -> float:
    return float(np.sqrt((error(graph)[:, :2] ** 2).sum(axis=1).mean()))


def test_a_gps_holds_a_drive_without_loops() -> None:
    alone, held = solved("lrf"), solved("lrf", "gps")
    assert not len(held.closures)
    assert rmse(held) < 0.06
    assert rmse(held) < rmse(alone)
    end = -1
    assert held.poses()[1][end, 0, 0] < 0.25 * alone.poses()[1][end, 0, 0], "a GPS must narrow what is claimed"


def test_a_compass_tells_headings_and_its_own_offset() -> None:
    alone, held = solved("lrf"), solved("lrf", "compass")
    assert np.degrees(np.sqrt((error(held)[:, 2] ** 2).mean())) < 0.6
    assert held.poses()[1][-1, 2, 2] < alone.poses()[1][-1, 2, 2]


def test_what_a_sensor_adds_pulls_the_poses_towards_its_readings() -> None:
    """A step along the right side of its normal equations lessens the weighed squares, written out anew here."""
    log, truth = drive()
    odometry = odometry_of(log)
    keys = log.instant["lrf"][::8]
    x = truth[keys] + np.random.default_rng(2).normal(size=(len(keys), 3)) * (0.02, 0.02, 0.005)

    def cost(at: Array) -> float:
        gps, R = log.measurements["gps"], GPS_M**2
        total = 0.0
        for i, instant in enumerate(log.instant["gps"].tolist()):
            key = int(np.searchsorted(keys, instant, side="right")) - 1
            u, _ = odometry.between(keys[[key]], np.array([instant]))
            pose = se2.compose(at[key], u[0])
            total += float(((gps.z[i] - pose[:2]) ** 2).sum()) / R
        return total

    rows = Others(log, described(), ["gps"], odometry, keys).rows(x)
    H, g = np.zeros((3 * len(x), 3 * len(x))), np.zeros(3 * len(x))
    for block in rows:
        for columns, h, right in zip(block.at, block.H, block.g, strict=True):
            H[np.ix_(columns, columns)] += h
            g[columns] += right
    step = np.zeros(3 * len(x))
    step[3 * 5 : 3 * 5 + 3] = np.linalg.solve(H[15:18, 15:18] + 1e-3 * np.eye(3), g[15:18])
    assert cost(x + 0.5 * step.reshape(-1, 3)) < cost(x)
    assert (np.linalg.eigvalsh(H) > -1e-6 * np.abs(H).max()).all()
