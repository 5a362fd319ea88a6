"""Trajectories as text in full precision, not aligned: TUM (for evo), KITTI, CSV. Also the audit trail as CSV."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np

from locfuse.formats.geometry import spatial_covariance
from locfuse.fusion.data import VERDICTS, Array, Audit, Drive, Estimates, Truth, upper_triangles

LINES_AT_ONCE = 4096  # lines per block; the Python values of a line take ten times the memory of its text
TUM_COVARIANCE_HEADER = "# t x y z qx qy qz qw, then P by rows, upper triangle: " + " ".join(
    f"P_{i}_{j}" for i, j in itertools.combinations_with_replacement(("x", "y", "z", "roll", "pitch", "yaw"), 2)
)
CSV_HEADER = "t,x,y,theta,P_xx,P_xy,P_xt,P_yy,P_yt,P_tt"


def seconds(t_ns: int) -> str:
    """Return integer nanoseconds as text in exact decimal seconds."""
    sign, t_ns = ("-", -t_ns) if t_ns < 0 else ("", t_ns)
    return f"{sign}{t_ns // 1_000_000_000}.{t_ns % 1_000_000_000:09d}"


def stamps(epoch_ns: int, t: Array) -> list[int]:
    """Return times t (n,) s since `epoch_ns` as integer nanoseconds."""
    t_ns: list[int] = (epoch_ns + np.rint(t * 1e9).astype(np.int64)).tolist()
    return t_ns


def with_truth_rows(drive: Drive, estimates: Estimates) -> tuple[Array, Array, Array]:
    """Return t (n,) [s], pose (n, 3), and triangles of P (n, 6) at every update time and truth stamp of the drive.

    evo pairs stamps only if they are within 10 ms, unless it is asked to interpolate (since 1.38). So the
    prediction at each truth stamp is written too. Rows at update times do not depend on the truth.
    """
    if drive.truth is None or estimates.truth_pose is None or estimates.truth_P is None:
        return estimates.t, estimates.pose, estimates.triangles
    extra = np.isfinite(estimates.truth_pose[:, 0]) & ~np.isin(drive.truth.t, estimates.t)
    t = np.concatenate((estimates.t, drive.truth.t[extra]))
    order = np.argsort(t, kind="stable")
    pose = np.concatenate((estimates.pose, estimates.truth_pose[extra]))
    triangles = np.concatenate((estimates.triangles, upper_triangles(estimates.truth_P[extra])))
    return t[order], pose[order], triangles[order]


def tum(epoch_ns: int, t: Array, xy: Array, theta: Array | None) -> Iterator[str]:
    """Yield blocks of `t x y z qx qy qz qw` lines.

    If theta is None, a comment line comes first, and every rotation is the identity.
    """
    half = np.zeros(len(t)) if theta is None else 0.5 * theta
    if theta is None:
        yield "# heading unknown\n"
    for at in _blocks(len(t)):
        rows = zip(stamps(epoch_ns, t[at]), xy[at].tolist(), half[at].tolist(), strict=True)
        yield "".join(f"{seconds(s)} {x!r} {y!r} 0 0 0 {math.sin(h)!r} {math.cos(h)!r}\n" for s, (x, y), h in rows)


def _blocks(n: int) -> Iterator[slice]:
    return (slice(a, a + LINES_AT_ONCE) for a in range(0, n, LINES_AT_ONCE))


def write_blocks(blocks: Iterable[str], path: Path) -> None:
    """Write a text block by block, to save memory."""
    with path.open("wb") as file:
        file.writelines(block.encode() for block in blocks)


def tum_blocks(drive: Drive, estimates: Estimates) -> Iterator[str]:
    """Yield a configuration's trajectory in TUM format, block by block."""
    t, pose, _ = with_truth_rows(drive, estimates)
    yield from tum(drive.epoch_ns, t, pose[:, :2], pose[:, 2])


def tum_covariance_blocks(drive: Drive, estimates: Estimates) -> Iterator[str]:
    """Yield the trajectory in TUM format with 21 more columns: the upper triangle of the 6 x 6 pose covariance.

    Rows and columns are x, y, z, roll, pitch, yaw, as in geometry_msgs/PoseWithCovariance and in line 1.
    """
    yield f"{TUM_COVARIANCE_HEADER}\n"
    _, _, triangles = with_truth_rows(drive, estimates)
    rows = "".join(tum_blocks(drive, estimates)).splitlines()
    for row, upper in zip(rows, spatial_covariance(triangles)[:, *np.triu_indices(6)].tolist(), strict=True):
        yield f"{row} {' '.join(map(repr, upper))}\n"


def kitti_blocks(drive: Drive, estimates: Estimates) -> Iterator[str]:
    """Yield the trajectory in KITTI format: a line has rows 1 to 3 of T_map_base in 12 numbers.

    KITTI lines have no stamps (see `kitti_times`).
    """
    _, pose, _ = with_truth_rows(drive, estimates)
    cosines, sines = np.cos(pose[:, 2]).tolist(), np.sin(pose[:, 2]).tolist()
    for c, s, (x, y) in zip(cosines, sines, pose[:, :2].tolist(), strict=True):
        yield f"{c!r} {-s!r} 0 {x!r} {s!r} {c!r} 0 {y!r} 0 0 1 0\n"


def kitti_times(drive: Drive, estimates: Estimates) -> Iterator[str]:
    """Yield the stamps [s] of the lines in the KITTI file."""
    t, _, _ = with_truth_rows(drive, estimates)
    yield from (f"{seconds(s)}\n" for s in stamps(drive.epoch_ns, t))


def truth_tum(drive: Drive, truth: Truth) -> str:
    """Return the truth in TUM format: positions of the body point that the truth tracks."""
    return "".join(tum(drive.epoch_ns, truth.t, truth.xy, truth.theta))


def csv_blocks(drive: Drive, estimates: Estimates) -> Iterator[str]:
    """Yield CSV lines of t, x, y, theta and the upper triangle of P, block by block."""
    t, pose, triangles = with_truth_rows(drive, estimates)
    yield f"{CSV_HEADER}\n"
    for at in _blocks(len(t)):
        wrapped = pose[at].copy()
        wrapped[:, 2] = (wrapped[:, 2] + np.pi) % (2.0 * np.pi) - np.pi
        values = np.column_stack((wrapped, triangles[at])).tolist()
        rows = zip(stamps(drive.epoch_ns, t[at]), values, strict=True)
        yield "".join(f"{seconds(s)},{','.join(map(repr, row))}\n" for s, row in rows)


# --- The audit trail: every measurement with its prediction, innovation and verdict

HEADER = "t,sensor,measurement,verdict,landmark,distance2,threshold,innovation_1,sigma_1,innovation_2,sigma_2"


def audit_csv(drive: Drive, estimates: Estimates) -> str:
    """Return the audit trail as CSV, one line per measurement, in time order.

    `distance2` is the squared Mahalanobis distance, `threshold` is its gate. Innovations are in the sensor's units
    (rad for headings and bearings; m, rad for r, psi of a line). Cells are empty for a measurement without a
    prediction.
    """
    times = [seconds(s) for s in stamps(drive.epoch_ns, estimates.t)]
    rows = [
        (int(k), order, i, line)
        for order, (sensor, audit) in enumerate(estimates.audits.items())
        for i, (k, line) in enumerate(_lines(times, sensor, audit))
    ]
    rows.sort(key=lambda row: row[:3])
    return "\n".join((HEADER, *(line for *_, line in rows))) + "\n"


def _lines(times: list[str], sensor: str, audit: Audit) -> list[tuple[int, str]]:
    numbers = (audit.instant, audit.row, audit.verdict, audit.landmark, audit.nis, audit.threshold)
    rows = zip(*(column.tolist() for column in (*numbers, audit.y, audit.sigma)), strict=True)
    lines = []
    for k, row, v, mark, nis, gate, y, sigma in rows:
        pairs = [value for pair in zip(y, sigma, strict=True) for value in pair]
        cells = [repr(x) if math.isfinite(x) else "" for x in (nis, gate, *pairs, *[math.nan] * (4 - len(pairs)))]
        lines.append(
            (k, ",".join([times[k], sensor, str(row), VERDICTS[v], "" if mark < 0 else str(mark), *cells]))
        )
    return lines
