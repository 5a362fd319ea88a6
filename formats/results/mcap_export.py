"""Export of estimates as ROS 2 messages in one MCAP, for Foxglove, rosbag2 and other tools.

Each configuration has /locfuse/<name>/odometry (a message with covariance per row of the .tum),
/locfuse/<name>/path, and its frame on /tf. The truth is added, and optionally unchanged copies of all messages of
the log. Layout files of Foxglove (paths and poses of all configurations on the map, position and turn rate over
time) and PlotJuggler (y over x of the paths, and the same curves over time) show `estimates.mcap`.

A log's messages are copied with their bytes, times and order. Recovery copies what is readable of a damaged log;
the copy has chunks, indexes and checksums, and its metadata lists the losses.
"""

from __future__ import annotations

import json
import re
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from functools import cached_property
from itertools import cycle
from pathlib import Path
from typing import Any, NamedTuple, cast
from xml.etree import ElementTree as ET

import msgspec
import numpy as np
from numpy.typing import NDArray

from locfuse.formats.columns import Bytes, nested
from locfuse.formats.container.mcap_write import (
    CHUNK_BYTES,
    LATCHED,
    LogWriter,
    StandardMessages,
    add_messages,
    open_writer,
)
from locfuse.formats.geometry import quaternions, spatial_covariance
from locfuse.formats.logs.log import TF_TYPES, Log
from locfuse.formats.messages.cdr import CDR, read_layout
from locfuse.formats.messages.schema import Many, Scalar, parse, resolve
from locfuse.formats.text import writable
from locfuse.formats.whole_files import whole_file
from locfuse.fusion.data import Array, Drive, Estimates, Ints, LocfuseError, evenly

from .trajectory import stamps, with_truth_rows

MESSAGES = StandardMessages()
Columns = Mapping[str, NDArray[Any]]  # dotted path of a field -> numbers (n,), or (n, k) for an array of k


def stamp_columns(path: str, t_ns: Ints) -> dict[str, Ints]:
    """Return the columns of a builtin_interfaces/Time field at `path`."""
    return {f"{path}.sec": t_ns // 1_000_000_000, f"{path}.nanosec": t_ns % 1_000_000_000}


# --- Series of poses as messages: nav_msgs/Odometry, PoseStamped, PointStamped, Path, and /tf

MAP = "map"
ODOMETRY, PATH, TF = "nav_msgs/msg/Odometry", "nav_msgs/msg/Path", "tf2_msgs/msg/TFMessage"
POSE, POINT = "geometry_msgs/msg/PoseStamped", "geometry_msgs/msg/PointStamped"
MAX_PATH_POSES = 2000  # of a Path, for display; the odometry topic has every pose


class PoseSeries(msgspec.Struct, frozen=True, dict=True):
    """Messages of one type at times t_ns (n,) [ns].

    `constant` has fields that are equal in all messages, `columns` has numbers per message; other fields are zero.
    """

    msgtype: str
    t_ns: Ints
    constant: dict[str, Any]
    columns: Callable[[slice], Columns]  # rows -> columns of these rows

    @cached_property
    def _template(self) -> tuple[Bytes, dict[str, tuple[int, np.dtype[Any]]]]:
        """One message as CDR bytes (size,), and field path -> (byte offset in the message, dtype)."""
        one = MESSAGES.cdr(self.msgtype, nested(self.constant))
        message = parse(self.msgtype, "ros2msg", MESSAGES.schema(self.msgtype))
        paths = self.columns(slice(1)).keys()
        layout = read_layout(message, nested({path: path for path in paths}), memoryview(one), CDR)
        places = {}
        for path in paths:
            node = resolve(message, path)[0].node
            scalar = cast("Scalar", node.element if isinstance(node, Many) else node)
            places[path] = layout.leaves[path].offsets[0], np.dtype(scalar.dtype).newbyteorder("<")
        return np.frombuffer(one, np.uint8), places

    def messages(self, rows: slice) -> Bytes:
        """Return the messages of these rows as CDR bytes (k, size)."""
        one, places = self._template
        columns = self.columns(rows)
        out = np.tile(one, (len(self.t_ns[rows]), 1))
        for path, values in columns.items():
            at, dtype = places[path]
            data = np.ascontiguousarray(values, dtype).view(np.uint8).reshape(len(out), -1)
            out[:, at : at + data.shape[1]] = data
        return out


def odometry(t_ns: Ints, pose: Array, triangles: Array, twist: Array, child: str) -> PoseSeries:
    """Return Odometry messages of poses (n, 3), covariance triangles (n, 6) and body twists (n, 3)."""

    def columns(rows: slice) -> Columns:
        return {
            **stamp_columns("header.stamp", t_ns[rows]),
            **_pose("pose.pose", pose[rows]),
            "pose.covariance": spatial_covariance(triangles[rows]).reshape(-1, 36),
            "twist.twist.linear.x": twist[rows, 0],
            "twist.twist.linear.y": twist[rows, 1],
            "twist.twist.angular.z": twist[rows, 2],
        }

    return PoseSeries(ODOMETRY, t_ns, {"header.frame_id": MAP, "child_frame_id": child}, columns)


def poses(t_ns: Ints, pose: Array) -> PoseSeries:
    """Return PoseStamped messages of poses (n, 3)."""
    return PoseSeries(
        POSE,
        t_ns,
        {"header.frame_id": MAP},
        lambda rows: {**stamp_columns("header.stamp", t_ns[rows]), **_pose("pose", pose[rows])},
    )


def points(t_ns: Ints, xy: Array) -> PoseSeries:
    """Return PointStamped messages of points (n, 2)."""
    return PoseSeries(
        POINT,
        t_ns,
        {"header.frame_id": MAP},
        lambda rows: {**stamp_columns("header.stamp", t_ns[rows]), "point.x": xy[rows, 0], "point.y": xy[rows, 1]},
    )


def transforms(t_ns: Ints, pose: Array, child: str) -> PoseSeries:
    """Return TFMessages with the poses (n, 3) of frame `child` in the map."""
    constant = {"transforms": [{"header": {"frame_id": MAP}, "child_frame_id": child}]}

    def columns(rows: slice) -> Columns:
        stamped = stamp_columns("transforms.header.stamp", t_ns[rows])
        return {**stamped, **_pose("transforms.transform", pose[rows], "translation", "rotation")}

    return PoseSeries(TF, t_ns, constant, columns)


def path(t_ns: Ints, pose: Array) -> Bytes:
    """Return one Path message of poses (n, 3), thinned to MAX_PATH_POSES, as CDR bytes (1, size)."""
    rows = evenly(len(t_ns), MAX_PATH_POSES)
    columns = {**stamp_columns("header.stamp", t_ns[rows]), **_pose("pose", pose[rows])}
    values = zip(*(column.tolist() for column in columns.values()), strict=True)
    listed = [nested({"header.frame_id": MAP, **dict(zip(columns, one, strict=True))}) for one in values]
    fields = {**stamp_columns("header.stamp", t_ns[0]), "header.frame_id": MAP, "poses": listed}
    return np.frombuffer(MESSAGES.cdr(PATH, nested(fields)), np.uint8)[None]


def _pose(at: str, pose: Array, position: str = "position", orientation: str = "orientation") -> dict[str, Array]:
    turned = quaternions(pose[:, 2])
    return {
        f"{at}.{position}.x": pose[:, 0],
        f"{at}.{position}.y": pose[:, 1],
        f"{at}.{orientation}.z": turned[:, 2],
        f"{at}.{orientation}.w": turned[:, 3],
    }


# --- Estimates and truth

BASE = "base_link"
TRUTH_POINT, TRUTH_POSE, TRUTH_PATH = (f"/locfuse/truth/{what}" for what in ("point", "pose", "path"))
FIRST_STAMP, LAST_STAMP = -(2**31), 2**31 - 1  # s: ROS stamps have 32-bit seconds


class Export(msgspec.Struct, frozen=True):
    """The content of an exported MCAP."""

    drive: Drive
    estimates: Sequence[Estimates]
    twist: Array  # (n, 3) body twist [m/s, m/s, rad/s] by the wheels, over the interval before each update time
    robot_toml: bytes
    clock_ns: int = 0  # recording clock - clock of the stamps
    log: Log | None = None  # log to copy messages from

    @property
    def topics(self) -> dict[str, str]:
        """Topic with positions or poses -> message type."""
        found: dict[str, str] = {}
        for name in (ros_name(e.name) for e in self.estimates):
            found |= {f"/locfuse/{name}/odometry": ODOMETRY, f"/locfuse/{name}/path": PATH}
        truth = self.drive.truth
        if truth is not None and truth.theta is None:
            return {**found, TRUTH_POINT: POINT}
        return found if truth is None else {**found, TRUTH_POSE: POSE, TRUTH_PATH: PATH}

    def write(self, file: Path) -> None:
        """Write the file. Raises LocfuseError if a time is outside the range of ROS stamps."""
        self._check("the drive", self.drive.t)
        if self.drive.truth is not None:
            self._check("the truth", self.drive.truth.t)
        with file.open("wb") as opened:
            out = LogWriter(opened)
            began = max(self.drive.epoch_ns + self.clock_ns, 0)
            out.writer.add_attachment(began, began, "robot.toml", "application/toml", self.robot_toml)
            topics = _Topics(out, self.clock_ns)
            for e in self.estimates:
                self._estimates(topics, e)
            if self.drive.truth is not None:
                truth = self.drive.truth
                t_ns = np.array(stamps(self.drive.epoch_ns, truth.t), np.int64)
                if truth.theta is None:
                    topics.add(TRUTH_POINT, points(t_ns, truth.xy))
                else:
                    pose = np.column_stack((truth.xy, truth.theta))
                    topics.add(TRUTH_POSE, poses(t_ns, pose))
                    topics.once(TRUTH_PATH, t_ns, pose)
            topics.write()
            if self.log is not None:
                copy_messages(out.writer, self.log)
            out.finish()

    def _check(self, what: str, t: Array) -> None:
        """Raise LocfuseError if times (n,) do not fit a ROS stamp."""
        for does, at in (("begins", t[:1]), ("ends", t[-1:])):
            for seconds in (self.drive.epoch_ns + (at * 1e9).astype(np.int64)) // 10**9:
                if not FIRST_STAMP <= seconds <= LAST_STAMP:
                    raise LocfuseError(
                        f"--export: {what} {does} {seconds} s after 1970, and a ROS stamp ends in January 2038; "
                        "leave mcap and log out of --export, or try --order stamp"
                    )

    def _estimates(self, topics: _Topics, e: Estimates) -> None:
        name = ros_name(e.name)
        t, pose, triangles = with_truth_rows(self.drive, e)
        t_ns = np.array(stamps(self.drive.epoch_ns, t), np.int64)
        twist = self.twist[np.minimum(np.searchsorted(e.t, t), len(e.t) - 1)]
        topics.add(f"/locfuse/{name}/odometry", odometry(t_ns, pose, triangles, twist, f"{name}/{BASE}"))
        topics.once(f"/locfuse/{name}/path", t_ns, pose)
        topics.add("/tf", transforms(t_ns, pose, f"{name}/{BASE}"))
        recorded = self.log.topics.items() if self.log is not None else ()
        has_tf = any(t.msgtype in TF_TYPES and not name.endswith("tf_static") for name, t in recorded)
        if e is self.estimates[-1] and not has_tf:
            topics.add("/tf", transforms(t_ns, pose, BASE))


class _Topics:
    """The topics of an exported MCAP, with their series of messages."""

    def __init__(self, out: LogWriter, clock_ns: int) -> None:
        self._out, self._clock_ns = out, clock_ns
        self._parts: list[tuple[int, PoseSeries]] = []  # channel, its messages

    def add(self, topic: str, series: PoseSeries) -> None:
        """Add a series of messages to a topic."""
        self._parts.append((self._out.channel(topic, series.msgtype), series))

    def once(self, topic: str, t_ns: Ints, pose: Array) -> None:
        """Write a path as one latched message."""
        channel, recorded = self._out.channel(topic, PATH, latched=True), self._recorded(t_ns[:1])
        add_messages(self._out.writer, channel, recorded, np.ones(1, np.int64), path(t_ns, pose))

    def _recorded(self, t_ns: Ints) -> Ints:
        """Return the recording times (n,) of stamps (n,); they are at least 0, as MCAP requires."""
        return np.maximum(t_ns + self._clock_ns, 0)

    def write(self) -> None:
        """Write all series in chunks; a chunk has the messages of all series in one time interval."""
        t = np.sort(np.concatenate([series.t_ns for _, series in self._parts]))
        size = sum(series.messages(slice(1)).size * len(series.t_ns) for _, series in self._parts)
        number = -(-size // CHUNK_BYTES)
        cuts = t[np.linspace(0, len(t) - 1, number + 1).astype(np.int64)[1:-1]]
        ends = [[0, *np.searchsorted(s.t_ns, cuts).tolist(), len(s.t_ns)] for _, s in self._parts]
        for i in range(number):
            for (channel, series), e in zip(self._parts, ends, strict=True):
                rows = slice(e[i], e[i + 1])
                recorded, sequence = self._recorded(series.t_ns[rows]), np.arange(rows.start + 1, rows.stop + 1)
                add_messages(self._out.writer, channel, recorded, sequence, series.messages(rows))


def ros_name(configuration: str) -> str:
    """Return the name of a configuration as a valid ROS name: compass+lrf -> compass_lrf."""
    return re.sub(r"[^A-Za-z0-9_]+", "_", configuration)


FOXGLOVE, PLOTJUGGLER = "estimates.foxglove.json", "estimates.plotjuggler.xml"
COLOURS = ("#1f77b4", "#d62728", "#1ac938", "#ff7f0e", "#9467bd", "#17becf", "#bcbd22", "#f14cc1")
TRUTH = "#8c8c8c"
POSITION = {"Odometry": "pose.pose.position", "PoseStamped": "pose.position", "PointStamped": "point"}
CURVES = ("x", "y", "turn rate")  # [m], [m], [rad/s]


class ShownTopic(NamedTuple):
    """A topic with positions, and its colour."""

    topic: str
    fields: dict[str, str]  # curve of CURVES -> dotted path in the message
    colour: str


def layouts(topics: Mapping[str, str]) -> dict[str, str]:
    """Return layout file name -> content; `topics` maps each topic of the export to its message type."""
    shown, colours = [], cycle(COLOURS)
    for topic, msgtype in topics.items():
        kind = msgtype.rpartition("/")[2]
        if kind in POSITION:
            fields = {axis: f"{POSITION[kind]}.{axis}" for axis in ("x", "y")}
            odometry = kind == "Odometry"
            fields |= {"turn rate": "twist.twist.angular.z"} if odometry else {}
            shown.append(ShownTopic(topic, fields, next(colours) if odometry else TRUTH))
    paths = [name for name, msgtype in topics.items() if msgtype.endswith("/Path")]
    return {FOXGLOVE: _foxglove(shown, paths), PLOTJUGGLER: _plotjuggler(shown)}


def _foxglove(shown: Sequence[ShownTopic], paths: Sequence[str]) -> str:
    """Return a Foxglove layout as JSON, for "Import from file"."""
    colour = {s.topic.rpartition("/")[0]: s.colour for s in shown}
    drawn: dict[str, Any] = {s.topic: {"visible": True} for s in shown}
    shades = {p: [colour[p.rpartition("/")[0]]] * 2 for p in paths}
    drawn |= {p: {"visible": True, "lineWidth": 0.03, "gradient": shade} for p, shade in shades.items()}
    panels: dict[str, Any] = {
        "3D!map": {
            "cameraState": {"perspective": False, "distance": 20, "phi": 0, "thetaOffset": 90},
            "followMode": "follow-none",
            "followTf": "map",
            "layers": {"grid": {"visible": True, "layerId": "foxglove.Grid", "instanceId": "grid", "size": 20}},
            "topics": drawn,
        }
    }
    for curve in CURVES:
        lines = [
            {"value": f"{s.topic}.{s.fields[curve]}", "label": s.topic, "color": s.colour, "enabled": True}
            | {"timestampMethod": "headerStamp"}
            for s in shown
            if curve in s.fields
        ]
        panels[f"Plot!{curve}"] = {"title": curve, "paths": lines, "xAxisVal": "timestamp", "showLegend": True}
    below = {"direction": "column", "first": "Plot!y", "second": "Plot!turn rate"}
    plots = {"direction": "column", "splitPercentage": 34, "first": "Plot!x", "second": below}
    layout = {"direction": "row", "splitPercentage": 60, "first": "3D!map", "second": plots}
    whole = {"configById": panels, "globalVariables": {}, "userNodes": {}, "layout": layout}
    return json.dumps(whole, indent=1) + "\n"


def _plotjuggler(shown: Sequence[ShownTopic]) -> str:
    """Return a PlotJuggler layout as XML, for the option --layout of PlotJuggler."""
    root = ET.Element("root")
    tabs = ET.SubElement(root, "tabbed_widget", {"name": "Main Window", "parent": "main_window"})
    _area(_tab(tabs, "paths", 1), "XYPlot", [(s, {"x": s.fields["x"], "y": s.fields["y"]}) for s in shown])
    split = _tab(tabs, "over time", len(CURVES))
    for curve in CURVES:
        _area(split, "TimeSeries", [(s, {"": s.fields[curve]}) for s in shown if curve in s.fields])
    ET.SubElement(tabs, "currentTabIndex", index="0")
    ET.SubElement(root, "use_relative_time_offset", enabled="1")
    ET.indent(root, " ")
    return f"<?xml version='1.0' encoding='UTF-8'?>\n{ET.tostring(root, 'unicode')}\n"


def _tab(tabs: ET.Element, name: str, plots: int) -> ET.Element:
    """Add a tab to the layout; return the element that holds its plots, one below the other."""
    container = ET.SubElement(ET.SubElement(tabs, "Tab", tab_name=name, containers="1"), "Container")
    sizes = ";".join([f"{1 / plots:.6f}"] * plots)
    return ET.SubElement(container, "DockSplitter", orientation="-", count=str(plots), sizes=sizes)


def _area(split: ET.Element, mode: str, curves: Sequence[tuple[ShownTopic, dict[str, str]]]) -> None:
    """Add a plot of curves: y over x in the mode XYPlot, values over time in the mode TimeSeries."""
    area = ET.SubElement(split, "DockArea", name="...")
    plot = ET.SubElement(area, "plot", mode=mode, style="Lines", flip_x="false", flip_y="false")
    for shown, fields in curves:
        series = {axis: f"{shown.topic}/{path.replace('.', '/')}" for axis, path in fields.items()}
        ends = {f"curve_{axis}": name for axis, name in series.items() if axis}
        names = {"name": series.get("", shown.topic), "color": shown.colour}
        ET.SubElement(plot, "curve", names | ends)


RECOVERY_RECORD = "locfuse recover"  # name of the metadata record
CLOCKLESS_LOG_NS = 0  # log time of a message from before 1970
MAX_STAMP_NS = 2**63 - 1


class Recovered(msgspec.Struct, frozen=True):
    """The result of a recovery."""

    path: Path
    messages: dict[str, int]  # topic -> number
    lost: tuple[str, ...]  # one line for each file and reason


def recover(log: Log, path: Path) -> Recovered:
    """Write all readable messages of a log to an MCAP at `path`. Raises LocfuseError if none is readable."""
    encodings = {topic.encoding for topic in log.topics.values()}
    with whole_file(path) as temporary, temporary.open("wb") as file:
        writer = open_writer(file, "ros1" if encodings == {"ros1"} else "ros2")
        for name, data in log.attachments.items():
            writer.add_attachment(0, 0, name, "application/octet-stream", data)
        counts = copy_messages(writer, log)
        if not counts:
            why = f": {log.losses.lines()[0]}" if log.losses else ""
            raise LocfuseError(f"{log.name}: not one message can be read{why}")
        lines = tuple(log.losses.lines())
        writer.add_metadata(
            RECOVERY_RECORD,
            {
                "input": ", ".join(writable(file.name) for file in log.paths),
                "messages": str(counts.total()),
                "lost": "; ".join(map(writable, lines)),
                "lost_messages": str(log.losses.messages),
                "lost_bytes": str(log.losses.bytes),
            },
        )
        writer.finish()
    return Recovered(path, dict(sorted(counts.items())), lines)


def copy_messages(writer: Any, log: Log) -> Counter[str]:
    """Copy every message of a log with its bytes, times and order; return topic -> number of messages."""
    schemas: dict[tuple[str, str, bytes], int] = {}
    channels: dict[tuple[str, str, int], int] = {}
    counts: Counter[str] = Counter()
    for channel, data, messages in log.messages():
        schema = (channel.msgtype, channel.schema_encoding, channel.schema)
        if schema not in schemas:
            schemas[schema] = writer.register_schema(*schema) if channel.schema_encoding else 0
        key = (channel.topic, channel.encoding, schemas[schema])
        if key not in channels:
            once = channel.n == 1 or channel.topic.endswith("tf_static")  # such topics are latched
            channels[key] = writer.register_channel(*key, {"offered_qos_profiles": LATCHED if once else ""})
        ends = (messages.start + messages.length).tolist()
        payload = [data[a:b].data for a, b in zip(messages.start.tolist(), ends, strict=True)]
        log_time = messages.log_time.clip(CLOCKLESS_LOG_NS, MAX_STAMP_NS)
        published = messages.published.clip(CLOCKLESS_LOG_NS, MAX_STAMP_NS)
        add_messages(writer, channels[key], log_time, messages.sequence, payload, published)
        counts[channel.topic] += len(messages.start)
    return counts
