"""changes.json, .md: two finished results side by side, per configuration and figure."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from .json_report import same_input
from .render import escape, markdown
from .summary import is_figure
from .table import Column, Table, of_words, texts
from .tables import MAIN

Report = Mapping[str, Any]
COLUMNS = texts("configuration", "figure", "before", "after", "change", left=2)


def changes(before: Report, after: Report) -> dict[str, Any]:
    """Return every figure of both reports with its change, and other differences between them."""
    a, b = before["configurations"], after["configurations"]
    return {
        "same_input": same_input(before["input"], after["input"]),
        "inputs": [before["input"]["name"], after["input"]["name"]],
        "versions": [before["locfuse"], after["locfuse"]],
        "settings": _settings(before["settings"], after["settings"]),
        "judged_by": [judged_by(before), judged_by(after)],
        "configurations": {name: _figures(a[name], b[name]) for name in a if name in b},
        "only_before": [name for name in a if name not in b],
        "only_after": [name for name in b if name not in a],
    }


def judged_by(report: Report) -> str | None:
    """Return the reference of a report's errors: "truth", or the sensors of a reference; None without one."""
    if report.get("truth") is not None:
        return "truth"
    reference = report.get("reference")
    return None if reference is None else f"a reference of {'+'.join(reference['sensors'])}"


def _figures(before: Mapping[str, Any], after: Mapping[str, Any]) -> dict[str, dict[str, float | None]]:
    keys = [k for k in before if k in after and (is_figure(k, before[k]) or is_figure(k, after[k]))]
    return {k: _change(before[k], after[k]) for k in keys}


def _change(before: float | None, after: float | None) -> dict[str, float | None]:
    known = before is not None and after is not None
    return {
        "before": before,
        "after": after,
        "change": after - before if before is not None and after is not None else None,
        "share": after / before - 1.0
        if before is not None and after is not None and known and before > 0.0
        else None,
    }


def _settings(before: Mapping[str, Any], after: Mapping[str, Any]) -> dict[str, list[Any]]:
    """Return the settings that differ by their dotted key: [before, after]."""
    a, b = dict(_flat(before)), dict(_flat(after))
    return {key: [a.get(key), b.get(key)] for key in sorted(a.keys() | b.keys()) if a.get(key) != b.get(key)}


def _flat(tables: Mapping[str, Any], path: str = "") -> Iterator[tuple[str, Any]]:
    for key, value in tables.items():
        if isinstance(value, Mapping):
            yield from _flat(value, f"{path}{key}.")
        else:
            yield f"{path}{key}", value


def table(found: Mapping[str, Any]) -> Table:
    """Return the main figures of both results, before and after, as a table."""
    rows = (
        (name, column.heading, *_sides(column, figures[column.key]))
        for name, figures in found["configurations"].items()
        for column in MAIN
        if column.key in figures and figures[column.key]["change"] is not None
    )
    return of_words(COLUMNS, rows)


def _sides(column: Column, figure: Mapping[str, float | None]) -> tuple[str, str, str]:
    """Return before, after and change as text; a column may hold figures of different units."""
    share = figure["share"]
    change = (
        ""
        if share is None
        else "="
        if share == 0.0
        else f"{share:+.1%}"
        if abs(share) < 10.0
        else f"x {share + 1:.3g}"
    )
    before, after = (column.with_unit(figure[side]) for side in ("before", "after"))
    return before, after, change


def remarks(found: Mapping[str, Any]) -> list[str]:
    """Return notes that a reader of the changes needs."""
    lines = []
    if not found["same_input"]:
        lines.append("different input: {} and {}".format(*found["inputs"]))
    if len(set(found["versions"])) > 1:
        lines.append("different versions of locfuse: {} and {}".format(*found["versions"]))
    if len(set(found["judged_by"])) > 1 and None not in found["judged_by"]:
        lines.append("errors cannot be compared: before against {}, after against {}".format(*found["judged_by"]))
    lines += [f"setting {key}: {_said(a)} -> {_said(b)}" for key, (a, b) in found["settings"].items()]
    for which in ("before", "after"):
        if found[f"only_{which}"]:
            lines.append(f"only {which}: {', '.join(found[f'only_{which}'])}")
    return lines


def _said(value: Any) -> str:
    return "not set" if value is None else str(value)


def render(folders: tuple[str, str], found: Mapping[str, Any]) -> str:
    """Return the changes as Markdown."""
    title = f"# locfuse: {escape(folders[0])} and {escape(folders[1])}"
    lines = [title, "", markdown(table(found)), "", *(f"- {escape(r)}" for r in remarks(found))]
    return "\n".join(lines).rstrip() + "\n"
