"""What the user sees: tables on stdout, notes and progress on stderr."""

from __future__ import annotations

import os
import sys
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Protocol

from locfuse.formats.report import json_report
from locfuse.formats.report.columns import written
from locfuse.formats.report.notes import notes_of

from .screen import put, reader_may_leave, screen
from .screen import say as on_screen

COLUMNS = (
    ("rmse", "position_rmse_m", "{:.3f} m"),
    ("max", "position_max_m", "{:.3f} m"),
    ("final", "final_position_error_m", "{:.3f} m"),
    ("heading", "heading_rmse_deg", "{:.2f}°"),
    ("drift/5 m", "drift_5m", "{:.2%}"),
    ("ANEES", "anees", "{:.2f}"),
)
NO_TRUTH = "no truth in this log: the error figures do not exist; if a topic holds it: --set truth.topic=/TOPIC"


class Progress(Protocol):
    """Says what is being worked on."""

    def __call__(self, what: str) -> None:
        """Name the current step."""


def say(line: str) -> None:
    """Print a line on stderr."""
    on_screen(line, err=True)


@contextmanager
def progress(quiet: bool) -> Iterator[Progress]:
    """Show the current step on a terminal; nothing where stderr is a file or --quiet was given."""
    if quiet or not sys.stderr.isatty():
        yield lambda what: None
        return

    own = os.fdopen(os.dup(sys.stderr.fileno()), "w", encoding=sys.stderr.encoding, errors="backslashreplace")
    with own, screen(file=own).status("opening", spinner="dots") as status:
        yield lambda what: status.update(what)  # noqa: PLW0108 - its type differs from Progress


def width() -> int | None:
    """Return how wide the screen is; None in a pipe or a file, where nothing need be wrapped or left out."""
    console = screen()
    return console.width if console.is_terminal or "COLUMNS" in os.environ else None


def lines(text: Iterable[str], bold: Collection[str] = ()) -> None:
    """Print lines as they are, some of them bold where the screen can."""
    from rich.text import Text

    console = screen(soft_wrap=True, highlight=False)
    for line in text:
        console.print(Text(line, "bold" if line in bold else ""))


def result(report: Mapping[str, Any], folder: Path, files: Collection[str], as_json: bool) -> None:
    """Print a finished report, and which files it was written to."""
    with reader_may_leave():
        if as_json:
            put(json_report.encode(report))
            return
        figures(report)
        verdicts(report)
        consistency(report)
        on_screen(f"{folder}: {', '.join(sorted(files))}")


def figures(report: Mapping[str, Any]) -> None:
    """Print the configurations and what became of each sensor's measurements."""
    from rich import box
    from rich.table import Table
    from rich.text import Text

    console = screen()
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    names, columns = list(report["configurations"]), _columns(report)
    table.add_column("configuration", no_wrap=True, min_width=max(map(len, names)))
    for title in columns:
        table.add_column(title, justify="right", no_wrap=True)
    for name, *cells in zip(names, *columns.values(), strict=True):
        table.add_row(Text(name), *cells)
    console.print(table)
    sensors = _sensor_rows(report)
    if sensors:
        console.print(_sensor_table(sensors))


def _columns(report: Mapping[str, Any]) -> dict[str, list[str]]:
    """Return a cell per configuration by title: its errors, and without truth what can be told all the same."""
    rows = report["configurations"]
    shown = [c for c in COLUMNS if any(values.get(c[1]) is not None for values in rows.values())]
    if shown:
        return {title: [number(values.get(key), form) for values in rows.values()] for title, key, form in shown}
    columns = {"distance": [number(values["distance_m"], "{:.2f} m") for values in rows.values()]}
    if report.get("pseudo_reference"):
        against = (values["against_smoothed"]["position_rmse_m"] for values in rows.values())
        columns["rms to smoothed"] = [number(rmse, "{:.3f} m") for rmse in against]
    if report.get("prediction"):
        gains = {r["configuration"]: r["gain_nats"] for r in report["prediction"]["ranking"]}
        columns["predicts the rest"] = [number(gains.get(name), "{:+.2f} nats") for name in rows]
    return columns


def _sensor_rows(report: Mapping[str, Any]) -> list[tuple[str, ...]]:
    return [
        (
            name,
            sensor,
            str(counts["accepted"]),
            str(counts["rejected"]),
            str(counts["absent"]),
            number(counts["nis"], "{:.2f}"),
        )
        for name, values in report["configurations"].items()
        for sensor, counts in values["sensors"].items()
        if not values.get("smoothed")  # its measurements are those of the filter
    ]


def _sensor_table(rows: Sequence[tuple[str, ...]]) -> Any:
    from rich import box
    from rich.table import Table
    from rich.text import Text

    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    for i, title in enumerate(("in", "sensor", "accepted", "rejected", "absent", "NIS")):
        table.add_column(title, justify="left" if i < 2 else "right")
    for row in rows:
        table.add_row(*(Text(cell) for cell in row))
    return table


def number(value: float | None, form: str) -> str:
    """Format a figure; a dash where it does not exist."""
    return "-" if value is None else written(value, form)


def notes(report: Mapping[str, Any], losses: Sequence[str], quiet: bool) -> None:
    """Print to stderr what a reader of the figures must know: absent sensors, oddities, losses."""
    if quiet:
        return
    for sensor, why in report["absent"].items():
        say(f"absent: {sensor}: {why}")
    for note in notes_of(report):
        say(f"note: {note}")
    for stream, reasons in report["input"]["dropped"].items():
        counted = ", ".join(f"{count} {reason.replace('_', ' ')}" for reason, count in reasons.items())
        say(f"dropped: {stream}: {counted}")
    if "pseudo_reference" in report:
        say(f"note: {report['pseudo_reference']['words']}")
    if report["truth"] is None:
        say(NO_TRUTH)
    if report.get("prediction"):
        say(f"note: {report['prediction']['trust']}")
    for line in losses:
        say(f"lost: {line}")


def verdicts(report: Mapping[str, Any]) -> None:
    """Print what each sensor bought, in words."""
    from rich.text import Text

    console = screen()
    for sensor, verdict in report.get("verdicts", {}).items():
        console.print(Text.assemble((f"{sensor} {verdict['verdict']}. ", "bold"), verdict["words"]))


def consistency(report: Mapping[str, Any]) -> None:
    """Print what is not as robot.toml says of the sensors' noise, and how to cure it."""
    from rich.text import Text

    console = screen()
    for found in report.get("consistency", {}).values():
        if found["verdict"] != "consistent":
            console.print(Text.assemble(("Noise: ", "bold"), found["words"]))
