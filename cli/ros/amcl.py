"""Parameters of nav2's AMCL: odometry noise per step (alpha1-4), and the laser's beam model.

Motion (Probabilistic Robotics, table 5.6; nav2's differential model): a step that turns by r1, moves by s and
turns by r2 has the variances alpha1 r1^2 + alpha2 s^2 of a turn and alpha3 s^2 + alpha4 (r1^2 + r2^2) of the
distance. AMCL's variances grow with the square of a step, locfuse's with the distance: they are equal for one step
length. AMCL makes a step every update_min_d metres or update_min_a radians. With the wheels' variance k per metre
and the track L,

    straight on, s = update_min_d    2 k s / L^2 = 2 alpha2 s^2     k s / 2 = alpha3 s^2
    on the spot, r = update_min_a    k r / L     = alpha1 r^2       k L r / 4 = alpha4 r^2

Laser: likelihood field (table 6.3): a beam that ends at the distance d from the nearest wall has the density z_hit
N(d; 0, sigma_hit) + z_rand / z_max. Expectation maximisation finds the weights and sigma_hit, as in table 6.2. A
"short" beam ends in free space, before the first wall along the beam: it hit a person or furniture that the map
does not have. Wall and beam end are each rounded to a cell of the map, which adds cell^2 / 6 to the square of
sigma_hit.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from locfuse.formats.robot.ros_yaml import KEPT, Setting
from locfuse.fusion import se2
from locfuse.fusion.data import Array, Ints, MapLine
from locfuse.fusion.lines.points import ScanPoints
from locfuse.fusion.lines.scans import limits
from locfuse.fusion.mount import found_mount

from .found import FoundRobot, positive

MIN_D_M, MIN_A_RAD = 0.25, 0.2  # nav2's update_min_d and update_min_a
CELL_M = 0.05  # of a map by slam_toolbox or map_saver
MAX_SCANS, MAX_BEAMS = 150, 60  # scans of the drive, beams of a scan (AMCL's default max_beams)
FIELD = "likelihood_field"  # nav2's laser_model_type
NO_RANGE_M = 1e3  # a larger range_max means no limit


def settings(found: FoundRobot, there: Mapping[str, Any]) -> list[Setting]:
    """Return AMCL's parameters; `there`: parameters that the file has now, {} for a new file."""
    return [*_motion(found, there), *_laser(found, there)]


def _motion(found: FoundRobot, there: Mapping[str, Any]) -> Iterator[Setting]:
    d, a = positive(there, "update_min_d") or MIN_D_M, positive(there, "update_min_a") or MIN_A_RAD
    words = "alpha1 to alpha4 are for steps of this length"
    yield Setting("robot_model_type", "nav2_amcl::DifferentialMotionModel", "two wheels", KEPT)
    yield Setting("update_min_d", d, f"m: {words}", KEPT)
    yield Setting("update_min_a", a, f"rad: {words}", KEPT)
    wheels = found.loaded.drive.wheels
    k, track = wheels.noise, wheels.track
    if wheels.matched is not None:  # noise of wheels with the turning variance of scan matching over the drive
        way = float(np.abs(wheels.rolled).sum())
        k = float(wheels.matched[:, 2, 2].sum()) * track**2 / max(way, 1e-9)
    alphas = {
        "alpha1": (k / (track * a), f"turn by turn, steps of {a:g} rad"),
        "alpha2": (k / (track**2 * d), f"turn by way, steps of {d:g} m"),
        "alpha3": (k / (2.0 * d), f"way by way, steps of {d:g} m"),
        "alpha4": (k * track / (4.0 * a), f"way by turn, steps of {a:g} rad"),
    }
    for key, (value, what) in alphas.items():
        yield found.setting(key, value, what, "wheels.noise")


def _laser(found: FoundRobot, there: Mapping[str, Any]) -> Iterator[Setting]:
    if not found.has("lrf"):
        yield Setting("sigma_hit, z_hit, z_rand, laser_max_range", None, "this log has no laser")
        return
    topic = found.topic("lrf")[0]
    yield Setting("scan_topic", topic, f"{topic} in the log", KEPT)
    points, origins, none, reach = beams_in_map(found)
    yield Setting("laser_max_range", reach, f"m: the farthest that {topic} measures")
    model = fit_beams(origins, points, found.estimates.final_map, none, reach)
    if model is None:
        yield Setting("sigma_hit, z_hit, z_rand", None, "the map has no walls, or the scans have too few beams")
        return
    kind = there.get("laser_model_type", FIELD)
    given = "the given map" if found.robot.lines else "the map of this drive"
    of = f"{model.beams} beams beside {given}"
    sigma = math.hypot(model.sigma, CELL_M / math.sqrt(6.0))
    yield Setting("laser_model_type", FIELD, "nav2's default", KEPT)
    yield Setting("sigma_hit", sigma, f"m: {model.sigma:.4f} ± {model.spread:.1g} and cells of {CELL_M:g} m; {of}")
    total = 1.0 if kind == "beam" else model.hit + model.random + model.short  # likelihood_field has no z_short
    random = model.random if kind == "beam" else model.random + model.short
    yield Setting("z_hit", model.hit / total, f"share that ends at a wall; {of}")
    yield Setting("z_rand", random / total, f"share that ends elsewhere; {of}")
    only = "" if kind == "beam" else "; the beam model alone uses it"
    yield Setting("z_short", model.short, f"share that ends before its wall{only}")
    yield Setting("z_max", model.none, f"share without a return{only}")
    if model.decay is not None:
        yield Setting("lambda_short", model.decay, f"1/m of those that end too early{only}")


def beams_in_map(found: FoundRobot) -> tuple[Array, Array, int, float]:
    """Return beam ends and origins (n, 2) in the map [m], number of beams without return, and range limit [m]."""
    drive = found.loaded.drive
    m = drive.measurements["lrf"]
    assert isinstance(m.points, ScanPoints)
    some = np.unique(np.linspace(0, len(m.t) - 1, MAX_SCANS).astype(np.int64))
    poses = found.estimates.pose[drive.instant["lrf"][some]]
    ends, origins, none = [], [], 0
    points = m.points.mounted(found_mount("lrf", m.points.mount, found.estimates.blocks))
    beams, farthest = _sizes(points, points.rows[some])
    reach = 0.0
    for pose, seen, count in zip(poses, points.read(some), beams, strict=True):
        step = max(1, count // MAX_BEAMS)
        none += max(0, count - len(seen)) // step
        few = seen[::step]
        ends.append(np.asarray(se2.transform(pose, few)))
        origins.append(np.repeat(np.asarray(se2.transform(pose, points.mount[None, :2])), len(few), axis=0))
        reach = max(reach, float(np.hypot(*(few - points.mount[:2]).T).max(initial=0.0)))
    return np.concatenate(ends), np.concatenate(origins), none, farthest if 0.0 < farthest < NO_RANGE_M else reach


def _sizes(points: ScanPoints, rows: Ints) -> tuple[list[int], float]:
    """Return the number of beams in each of these scans, and the laser's maximal range [m]."""
    found: dict[int, int] = {}
    farthest = 0.0
    wanted = set(rows.tolist())
    for at, columns in points.stream.blocks("ranges", "range_min", "range_max"):
        lengths: Any = columns["ranges"]
        farthest = max(farthest, float(limits(columns)[1].max(initial=0.0)))
        found |= {row: len(lengths[i]) for i, row in enumerate(at.tolist()) if row in wanted}
    own = points.laser.range_max
    return [found.get(row, 0) for row in rows.tolist()], own if own is not None else farthest


MAX_STEPS = 200  # of expectation maximisation
MIN_STEP_M = 1e-6  # m
BEGIN_SIGMA_M, BEGIN_HIT = 0.1, 0.8
MIN_SIGMA_M, MIN_RANDOM = 1e-3, 0.01  # least values: with z_rand = 0 one beam could give a particle the weight 0
SHORT_SIGMAS = 3.0  # a short beam ends at least this far before its wall
POINTS_AT_ONCE = 4096
MIN_BEAMS = 200


class BeamModel(NamedTuple):
    """Shares of hit, short, missing and random beams, and the standard deviation of hits from walls."""

    sigma: float  # m
    spread: float  # m, standard deviation of `sigma`
    hit: float  # shares of all beams; the four shares add up to 1
    short: float
    none: float  # share of beams without a return
    random: float
    decay: float | None  # 1/m: exponential decay of short beams (table 6.2: lambda_short)
    beams: int


def fit_beams(
    origins: Array, points: Array, lines: Sequence[MapLine], none: int, reach: float
) -> BeamModel | None:
    """Fit the beam model to points (n, 2) of beams from origins (n, 2) in the map [m]; None with too few points.

    `none` is the number of beams without a return, `reach` the laser's range [m].
    """
    if len(points) < MIN_BEAMS or not lines:
        return None
    d, expected = _beside_walls(origins, points, lines)
    hit, sigma = _mixture(d, reach)
    hits = _hits(d, hit, sigma, reach)
    seen = np.hypot(*(points - origins).T)
    short = (hits < 0.5) & (seen < expected - SHORT_SIGMAS * sigma) & np.isfinite(expected)
    total = len(points) + none
    of_short = float(short.sum()) / total
    of_hit = min(hit * len(points) / total, 1.0 - MIN_RANDOM)
    random = max(1.0 - of_hit - of_short - none / total, MIN_RANDOM)
    decay = float(short.sum() / seen[short].sum()) if short.any() else None
    shares = np.array([of_hit, of_short, none / total, random]) / (of_hit + of_short + none / total + random)
    of_hit, of_short, of_none, random = shares.tolist()
    spread = sigma / float(np.sqrt(2.0 * hits.sum()))
    return BeamModel(sigma, spread, of_hit, of_short, of_none, random, decay, total)


def _mixture(d: Array, reach: float) -> tuple[float, float]:
    """Fit z_hit and sigma_hit [m] to distances d (n,) [m] from the nearest wall."""
    hit, sigma = BEGIN_HIT, BEGIN_SIGMA_M
    for _ in range(MAX_STEPS):
        share = _hits(d, hit, sigma, reach)
        before, hit = sigma, float(share.mean())
        sigma = max(float(np.sqrt((share * d**2).sum() / max(share.sum(), 1e-12))), MIN_SIGMA_M)
        if abs(sigma - before) < MIN_STEP_M:
            break
    return hit, sigma


def _hits(d: Array, hit: float, sigma: float, reach: float) -> Array:
    """Return the probability (n,) that each point, d (n,) [m] from the nearest wall, lies on a wall."""
    near = hit * np.exp(-0.5 * (d / sigma) ** 2) / (np.sqrt(2.0 * np.pi) * sigma)
    return np.asarray(near / (near + (1.0 - hit) / reach + 1e-300))


def _beside_walls(origins: Array, points: Array, lines: Sequence[MapLine]) -> tuple[Array, Array]:
    """Return for each point (n, 2) the distance to the nearest wall and the range to the first wall on its beam.

    The range is measured from the beam's origin (n, 2), and inf if the beam meets no wall; all in m.
    """
    rho, beta = np.array([line.rho for line in lines]), np.array([line.beta for line in lines])
    low, high = np.array([line.ends for line in lines]).T
    c, s = np.cos(beta), np.sin(beta)
    nearest, first = [], []
    for begin in range(0, len(points), POINTS_AT_ONCE):
        (x, y), (x0, y0) = (xy[begin : begin + POINTS_AT_ONCE].T[..., None] for xy in (points, origins))
        off, along = x * c + y * s - rho, y * c - x * s
        nearest.append(np.hypot(off, np.maximum(np.maximum(low - along, along - high), 0.0)).min(axis=1))
        dx, dy = x - x0, y - y0
        with np.errstate(divide="ignore", invalid="ignore"):
            share = (rho - x0 * c - y0 * s) / (dx * c + dy * s)  # of the way to the point
            along = (y0 + share * dy) * c - (x0 + share * dx) * s
            hits = (share > 0.0) & (low <= along) & (along <= high)
            first.append(np.where(hits, share * np.hypot(dx, dy), np.inf).min(axis=1))
    return np.concatenate(nearest), np.concatenate(first)
