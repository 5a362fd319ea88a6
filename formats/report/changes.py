"""changes.json and changes.md: comparison of the error figures in two reports, per configuration."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from .json_report import same_input
from .summary import is_figure
from .table import Table, escape, markdown, of_words, texts
from .tables import MAIN

Report = Mapping[str, Any]
COLUMNS = texts("configuration", "figure", "before", "after", "change", left=2)


def changes(before: Report, after: Report) -> dict[str, Any]:
    """Return the change of each error figure between two reports, and changed settings, inputs and versions."""
    a, b = before["configurations"], after["configurations"]
    was, now = dict(_flat(before["settings"])), dict(_flat(after["settings"]))
    figures: dict[str, dict[str, Any]] = {name: {} for name in a if name in b}
    for name, found in figures.items():
        for key in (k for k in a[name] if k in b[name]):
            if is_figure(key, a[name][key]) or is_figure(key, b[name][key]):
                found[key] = _change(a[name][key], b[name][key])
    return {
        "same_input": same_input(before["input"], after["input"]),
        "inputs": [before["input"]["name"], after["input"]["name"]],
        "versions": [before["locfuse"], after["locfuse"]],
        "settings": {k: [was.get(k), now.get(k)] for k in sorted(was | now) if was.get(k) != now.get(k)},
        "judged_by": [judged_by(before), judged_by(after)],
        "configurations": figures,
        "only_before": [name for name in a if name not in b],
        "only_after": [name for name in b if name not in a],
    }


def judged_by(report: Report) -> str | None:
    """Return "truth", or "a reference of" and its sensors if that was used instead; None if neither exists."""
    if report.get("truth") is not None:
        return "truth"
    reference = report.get("reference")
    return None if reference is None else f"a reference of {'+'.join(reference['sensors'])}"


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
    """Return the main error figures of both results as a table: "0.12 m", "0.09 m", "-25.0%"."""
    rows = []
    for name, figures in found["configurations"].items():
        for column in MAIN:
            figure = figures.get(column.key, {"change": None})
            if figure["change"] is not None:
                share = figure["share"]
                change = "=" if share == 0.0 else ""
                if share:
                    change = f"{share:+.1%}" if abs(share) < 10.0 else f"x {share + 1:.3g}"
                both = column.with_unit(figure["before"]), column.with_unit(figure["after"])
                rows.append((name, column.heading, *both, change))
    return of_words(COLUMNS, rows)


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
