"""Layout files of Foxglove and PlotJuggler for `estimates.mcap`.

Foxglove: paths and poses of all configurations on the map, position and turn rate over time. PlotJuggler: y over x
of the paths, and the same curves over time.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from itertools import cycle
from typing import Any, NamedTuple
from xml.etree import ElementTree as ET

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
    shown = list(_shown(topics))
    paths = [name for name, msgtype in topics.items() if msgtype.endswith("/Path")]
    return {FOXGLOVE: _foxglove(shown, paths), PLOTJUGGLER: _plotjuggler(shown)}


def _shown(topics: Mapping[str, str]) -> Iterator[ShownTopic]:
    colours = cycle(COLOURS)
    for topic, msgtype in topics.items():
        kind = msgtype.rpartition("/")[2]
        if kind in POSITION:
            fields = {axis: f"{POSITION[kind]}.{axis}" for axis in ("x", "y")}
            odometry = kind == "Odometry"
            fields |= {"turn rate": "twist.twist.angular.z"} if odometry else {}
            yield ShownTopic(topic, fields, next(colours) if odometry else TRUTH)


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
