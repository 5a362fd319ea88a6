"""The comparison as tables for other programs: CSV with every figure, LaTeX ready for a paper."""

from __future__ import annotations

import csv as csv_format
import io
from collections.abc import Mapping
from typing import Any

from .columns import cell, columns_of

ESCAPES = {
    "\\": r"\textbackslash{}",
    "&": r"\&",
    "%": r"\%",
    "$": r"\$",
    "#": r"\#",
    "_": r"\_",
    "{": r"\{",
    "}": r"\}",
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
    "°": r"\textdegree{}",
}


def csv(report: Mapping[str, Any]) -> str:
    """Return one row per configuration with every figure in full precision; empty where there is none.

    Lists (notes, intervals of being lost) are no figures: report.json has them.
    """
    rows = report["configurations"]
    keys = list(
        dict.fromkeys(k for v in rows.values() for k, x in v.items() if not isinstance(x, (Mapping, list)))
    )
    keys.remove("configuration")  # the first column: there it is the row's name, such as all-smoothed
    sensors = list(dict.fromkeys(s for v in rows.values() for s in v["sensors"]))
    counts = ("accepted", "rejected", "absent", "nis")
    out = io.StringIO()
    writer = csv_format.writer(out, lineterminator="\n")
    writer.writerow(["configuration", *keys, *(f"{s}_{c}" for s in sensors for c in counts)])
    for name, values in rows.items():
        own = [values["sensors"].get(s, {}).get(c) for s in sensors for c in counts]
        writer.writerow([name, *(_plain(values.get(k)) for k in keys), *(_plain(v) for v in own)])
    return out.getvalue()


def _plain(value: Any) -> str:
    if value is None:
        return ""
    return repr(value) if isinstance(value, float) else str(value)


def latex(report: Mapping[str, Any]) -> str:
    """Return a booktabs table with the page's main columns."""
    rows = report["configurations"]
    columns = columns_of(rows, main=True)
    heads = [f"{c.title} [{c.unit}]" if c.unit else c.title for c in columns]
    source = report["input"]
    lines = [
        f"% {_escape(source['name'])}, sha256 {source['sha256'][:16]}, locfuse {report['locfuse']}",
        r"% needs \usepackage{booktabs} and \usepackage{textcomp}",
        rf"\begin{{tabular}}{{l{'r' * len(columns)}}}",
        r"\toprule",
        "configuration & " + " & ".join(map(_escape, heads)) + r" \\",
        r"\midrule",
        *(
            f"{_escape(name)} & " + " & ".join(_escape(cell(c, v.get(c.key), "--")) for c in columns) + r" \\"
            for name, v in rows.items()
        ),
        r"\bottomrule",
        r"\end{tabular}",
    ]
    return "\n".join(lines) + "\n"


def _escape(text: str) -> str:
    return " ".join("".join(ESCAPES.get(character, character) for character in text).split())
