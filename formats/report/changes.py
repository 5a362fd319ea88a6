"""changes.json and changes.md: comparison of the error figures in two reports, per configuration."""

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
    """Return the change of each error figure between two reports, and changed settings, inputs and versions."""
    a, b = before["configurations"], after["configurations"]
    was, now = dict(_flat(before["settings"])), dict(_flat(after["settings"]))
    return {
        "same_input": same_input(before["input"], after["input"]),
        "inputs": [before["input"]["name"], after["input"]["name"]],
        "versions": [before["locfuse"], after["locfuse"]],
        "settings": {k: [was.get(k), now.get(k)] for k in sorted(was | now) if was.get(k) != now.get(k)},
        "judged_by": [judged_by(before), judged_by(after)],
        "configurations": {name: _figures(a[name], b[name]) for name in a if name in b},
        "only_before": [name for name in a if name not in b],
        "only_after": [name for name in b if name not in a],
    }


def judged_by(report: Report) -> str | None:
    """Return "truth", or "a reference of" and its sensors if that was used instead; None if neither exists."""
    if report.get("truth") is not None:
        return "truth"
    reference = report.get("reference")
    return None if reference is None else f"a reference of {'+'.join(reference['sensors'])}"


def _figures(before: Mapping[str, Any], after: Mapping[str, Any]) -> dict[str, dict[str, float | None]]:
    keys = [k for k in before if k in after and (is_figure(k, before[k]) or is_figure(k, after[k]))]
    return {k: _change(before[k], after[k]) for k in keys}


def _change(before: float | None, after: float | None) -> dict[str, float | None]:
    change = share = None
    if before is not None and after is not None:
        change = after - before
        share = after / before - 1.0 if before > 0.0 else None
    return {"before": before, "after": after, "change": change, "share": share}


def _flat(tables: Mapping[str, Any], path: str = "") -> Iterator[tuple[str, Any]]:
    """Yield the dotted key and the value of every setting."""
    for key, value in tables.items():
        if isinstance(value, Mapping):
            yield from _flat(value, f"{path}{key}.")
        else:
            yield f"{path}{key}", value


def table(found: Mapping[str, Any]) -> Table:
    """Return the main error figures of both results, before and after, as a table."""
    rows = (
        (name, column.heading, *_before_after_change(column, figures[column.key]))
        for name, figures in found["configurations"].items()
        for column in MAIN
        if column.key in figures and figures[column.key]["change"] is not None
    )
    return of_words(COLUMNS, rows)


def _before_after_change(column: Column, figure: Mapping[str, float | None]) -> tuple[str, str, str]:
    """Return an error figure before, after, and its relative change, as text: "0.12 m", "0.09 m", "-25.0%"."""
    share, change = figure["share"], ""
    if share is not None:
        change = "=" if share == 0.0 else f"{share:+.1%}" if abs(share) < 10.0 else f"x {share + 1:.3g}"
    return column.with_unit(figure["before"]), column.with_unit(figure["after"]), change


def remarks(found: Mapping[str, Any]) -> list[str]:
    """Return the differences of input, version, reference, settings and configurations, one line each."""
    lines = []
    if not found["same_input"]:
        lines.append("different input: {} and {}".format(*found["inputs"]))
    if len(set(found["versions"])) > 1:
        lines.append("different versions of locfuse: {} and {}".format(*found["versions"]))
    if len(set(found["judged_by"])) > 1 and None not in found["judged_by"]:
        lines.append("errors cannot be compared: before against {}, after against {}".format(*found["judged_by"]))
    for key, values in found["settings"].items():
        before, after = ("not set" if value is None else str(value) for value in values)
        lines.append(f"setting {key}: {before} -> {after}")
    only = {which: ", ".join(found[f"only_{which}"]) for which in ("before", "after")}
    return [*lines, *(f"only {which}: {names}" for which, names in only.items() if names)]


def render(folders: tuple[str, str], found: Mapping[str, Any]) -> str:
    """Return the changes as Markdown."""
    title = f"# locfuse: {escape(folders[0])} and {escape(folders[1])}"
    lines = [title, "", markdown(table(found)), "", *(f"- {escape(r)}" for r in remarks(found))]
    return "\n".join(lines).rstrip() + "\n"
