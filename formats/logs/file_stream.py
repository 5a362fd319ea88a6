"""Text files read like topics of a log: a trajectory (.tum, .csv) or landmark detections (.csv).

Example: `[truth] topic = "vicon.tum"`. The first line of a .csv names its columns; `t` is in seconds or
whole nanoseconds on the log's clock.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from decimal import Decimal
from pathlib import Path

import numpy as np

from locfuse.formats.geometry import quaternions, spatial_covariance
from locfuse.formats.inputs import MAX_TEXT_FILE, csv_table, read_small
from locfuse.formats.text import visible
from locfuse.fusion import se2
from locfuse.fusion.data import END_OF_TIME, Array, Column, Ints, LocfuseError

from .clock import MadeStream, RowTimes

POSE = "geometry_msgs/msg/PoseWithCovarianceStamped"
POINT = "geometry_msgs/msg/PointStamped"
DETECTIONS = "locfuse/msg/Detections"
RANGES = "locfuse/msg/Ranges"
SUFFIXES = (".tum", ".csv", ".txt")
TIMES = ("t", "time", "timestamp", "stamp", "t_s", "time_s", "timestamp [ns]")
HEADINGS = ("theta", "yaw", "heading", "theta_rad", "yaw_rad")
COVARIANCE_COLUMNS = ("p_xx", "p_xy", "p_xt", "p_yy", "p_yt", "p_tt")
MIN_ALONG, MAX_ACROSS = 0.9, 0.5  # length of the mean unit step along headings in the right unit, in a wrong one
MAX_IDENT = 2**53  # smaller integers are exact as floats
MIN_NS = 1e14  # larger times are nanoseconds, smaller ones seconds


def in_time_order(
    topic: str, msgtype: str, t_ns: Ints, data: Mapping[str, Column], words: str = "times of the file"
) -> MadeStream:
    """Return the columns `data`, whose rows have the times t_ns (n,) [ns], as a stream sorted by time.

    `words` name the source of the times.
    """
    order = np.argsort(t_ns, kind="stable")
    t_ns = t_ns[order]
    columns = {name: np.asarray(column)[order] for name, column in data.items()}
    return MadeStream(topic, msgtype, t_ns, columns, clock=RowTimes(t_ns, None, words, by_stamps=True))


def is_file_topic(name: str) -> bool:
    """Return whether a topic name is the path of an existing .tum, .csv or .txt file."""
    path = Path(name).expanduser()
    return path.suffix.lower() in SUFFIXES and path.is_file()


def read_file(name: str) -> MadeStream:
    """Return a text file as a stream. Raises LocfuseError with the number of an invalid line."""
    path = Path(name).expanduser()
    made = _csv(path) if path.suffix.lower() == ".csv" else _tum(path)
    if not len(made.t_ns):
        raise LocfuseError(f"{path} holds no readings")
    return made


def _tum(path: Path) -> MadeStream:
    """Read lines `t x y z qx qy qz qw`, optionally followed by the 21 numbers of a covariance's upper triangle."""
    text = read_small(path, MAX_TEXT_FILE).decode("utf-8", "replace").lstrip("\ufeff")
    times, rows = [], []
    unknown = text.startswith("# heading unknown")
    for number, line in enumerate(text.splitlines(), 1):
        words = line.replace(",", " ").split("#")[0].split()
        if not words:
            continue
        if len(words) < 8:
            raise LocfuseError(f"{path}: line {number} has {len(words)} numbers; t x y z qx qy qz qw are read")
        times.append(_ns(path, number, words[0]))
        rows.append([_number(path, number, word) for word in words[1:29]])
    if len({len(row) for row in rows}) > 1:
        raise LocfuseError(f"{path}: its lines differ in length")
    values = np.array(rows).reshape(len(rows), -1) if rows else np.zeros((0, 7))
    position, q = values[:, :2], None if unknown else values[:, 3:7]
    if values.shape[1] != 28:
        return _poses(path, times, position, q, None)
    P = np.zeros((len(rows), 6, 6))
    for (i, j), column in zip(itertools.combinations_with_replacement(range(6), 2), values[:, 7:].T, strict=True):
        P[:, i, j] = P[:, j, i] = column
    return _poses(path, times, position, q, P)


def _csv(path: Path) -> MadeStream:
    """Read a .csv with columns t, x, y (theta) of poses, or t, id, range, bearing of landmarks."""
    names, body = csv_table(path, MAX_TEXT_FILE)
    if not names:
        raise LocfuseError(f"{path} is empty")
    at = {name: i for i, name in enumerate(names)}
    time = next((name for name in TIMES if name in at), None)
    if time is None:
        raise LocfuseError(f"{path}: its first line names no column t; it has {_few(names)}")
    for number, row in body:
        if len(row) != len(names):
            raise LocfuseError(f"{path}: line {number} has {len(row)} values, the first line names {len(names)}")

    def column(name: str) -> Array:
        return np.array([_number(path, number, row[at[name]]) for number, row in body])

    times = [_ns(path, number, row[at[time]]) for number, row in body]
    if "id" in at and ("range" in at or "bearing" in at):
        idents = column("id")
        for (number, row), ident in zip(body, idents.tolist(), strict=True):
            if not abs(ident) < MAX_IDENT or ident != round(ident):
                word = row[at["id"]].strip()[:40]
                raise LocfuseError(f"{path}: line {number}: {word!r} is no id: whole numbers are read")
        missing = np.full(len(times), np.nan)
        measured = {name: column(name) if name in at else missing for name in ("range", "bearing")}
        kind = DETECTIONS if "bearing" in at else RANGES
        data = {"id": idents.astype(np.int64), **measured}
        return in_time_order(str(path), kind, np.array(times, np.int64), data)
    if not {"x", "y"} <= at.keys():
        read = "x and y of poses, or id, range and bearing of landmarks are read"
        raise LocfuseError(f"{path}: {read}, not {_few(names)}")
    return _table_of_poses(path, times, at, column)


def _few(names: Sequence[str]) -> str:
    """Return the first 12 column names as one line."""
    return ", ".join(visible(name[:40]) for name in names[:12])


def _table_of_poses(
    path: Path, times: Sequence[int], at: Mapping[str, int], column: Callable[[str], Array]
) -> MadeStream:
    position = np.stack((column("x"), column("y")), axis=-1)
    heading = next((name for name in HEADINGS if name in at), None)
    if heading is None and "qw" in at:
        none, parts = np.zeros(len(times)), ("qx", "qy", "qz", "qw")
        q = np.stack([column(name) if name in at else none for name in parts], -1)
        return _poses(path, times, position, q, None)
    if heading is None:
        return _poses(path, times, position, None, None)
    theta = column(heading)
    if _are_degrees(position, theta):
        most = float(np.nanmax(np.abs(theta)))
        raise LocfuseError(f"{path}: {heading} reaches {most:.0f}: it looks like degrees. Write radians")
    q = quaternions(np.where(np.isfinite(theta), theta, np.nan))  # infinite headings are missing; sin() would warn
    if not set(COVARIANCE_COLUMNS) <= at.keys():
        return _poses(path, times, position, q, None)
    P = spatial_covariance(np.stack([column(name) for name in COVARIANCE_COLUMNS], axis=-1))
    return _poses(path, times, position, q, P)


def _are_degrees(xy: Array, theta: Array) -> bool:
    """Return whether a path xy (n, 2) goes along headings theta (n,) in degrees, and not along them in radians."""
    step = np.diff(xy @ (1.0, 1.0j))
    used = (np.abs(step) > 0.0) & np.isfinite(step + theta[1:])
    step, heading = step[used], theta[1:][used]
    if not len(step) or np.abs(heading).max() <= 2.0 * math.pi:
        return False
    # of twice the angles: a robot that backs up goes along its heading too
    in_radians, in_degrees = (
        abs(np.abs(step) @ (step / np.abs(step) * np.exp(-1.0j * angle)) ** 2) / np.abs(step).sum()
        for angle in (heading, np.radians(heading))
    )
    return bool(in_degrees > MIN_ALONG and in_radians < MAX_ACROSS)


def _poses(path: Path, times: Sequence[int], xy: Array, q: Array | None, P: Array | None) -> MadeStream:
    """Return a stream of poses, or of points if the rotations q (n, 4) are None."""
    t_ns = np.array(times, np.int64)
    if q is None:
        return in_time_order(str(path), POINT, t_ns, {"point.x": xy[:, 0], "point.y": xy[:, 1]})
    if se2.is_about_x(q):
        words = f"{path}: its quaternions turn about the x axis: qw seems to come first"
        raise LocfuseError(f"{words}. Write t x y z qx qy qz qw")
    data: dict[str, Column] = {"pose.pose.position.x": xy[:, 0], "pose.pose.position.y": xy[:, 1]}
    data |= {f"pose.pose.orientation.{axis}": column for axis, column in zip("xyzw", q.T, strict=True)}
    data["pose.covariance"] = np.zeros((len(xy), 36)) if P is None else P.reshape(len(P), 36)
    return in_time_order(str(path), POSE, t_ns, data)


def _number(path: Path, line: int, word: str) -> float:
    try:
        if "_" in word:  # Python would accept it as a digit separator
            raise ValueError
        return float(word)
    except ValueError:
        raise LocfuseError(f"{path}: line {line}: {word.strip()[:40]!r} is no number") from None


def _ns(path: Path, line: int, word: str) -> int:
    """Return a time in integer nanoseconds, from decimal seconds (exact) or nanoseconds."""
    value = _number(path, line, word)
    try:
        exact = Decimal(word.strip()) if math.isfinite(value) else Decimal(END_OF_TIME)
        total = exact if abs(value) > MIN_NS else exact.scaleb(9)
    except ArithmeticError:  # the exponent has too many digits
        total = Decimal(END_OF_TIME)
    if abs(total) >= END_OF_TIME:
        raise LocfuseError(f"{path}: line {line}: {word.strip()[:40]!r} is no time")
    return int(total)
