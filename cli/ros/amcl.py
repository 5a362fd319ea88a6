"""Parameters of nav2's AMCL: odometry noise per step (alpha1-4), and the laser's beam model.

Motion (Probabilistic Robotics, table 5.6; nav2's differential model): a step that turns by r1, moves by s and
turns by r2 has the variances alpha1 r1^2 + alpha2 s^2 of a turn and alpha3 s^2 + alpha4 (r1^2 + r2^2) of the
distance. AMCL's variances grow with the square of a step, locfuse's with the distance: they are equal for one step
length. AMCL makes a step every update_min_d metres or update_min_a radians. With the wheels' variance k per metre
and the track L,

    straight on, s = update_min_d    2 k s / L^2 = 2 alpha2 s^2     k s / 2 = alpha3 s^2
    on the spot, r = update_min_a    k r / L     = alpha1 r^2       k L r / 4 = alpha4 r^2

Laser: fusion.map.beam_model (tables 6.2 and 6.3). Wall and beam end are each rounded to a cell of the map, which
adds cell^2 / 6 to the square of sigma_hit.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from locfuse.formats.robot.ros_yaml import KEPT, Setting
from locfuse.fusion import se2
from locfuse.fusion.data import Array, Ints
from locfuse.fusion.lines.points import ScanPoints
from locfuse.fusion.lines.scans import limits
from locfuse.fusion.map.beam_model import fit_beams
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
