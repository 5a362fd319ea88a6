"""report.md: the comparison as Markdown for a pull request, with verdicts, one table, and folded details."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

from . import tables
from .findings import banner_of, counts, fingerprint, notes_of, sentence, title_of, together, unwarned
from .table import SIGNS, code, escape, markdown

CODE, ESCAPE = re.compile(r"\\`(.*?)\\`"), re.compile(r"\\(.)")  # in escaped text


def render(report: Mapping[str, Any]) -> str:
    """Return report.md; text from the log is escaped."""
    source, sensors = report["input"], tables.sensors(report)
    compared_with = "reference" if report.get("reference") else "truth"
    identity = code(fingerprint(source, 16).split()[1])
    details = [
        markdown(tables.configurations(report, main=False)) if tables.has_figures(report) else "",
        markdown(sensors) if sensors.rows else "",
        _listing("Not used", dict(report["absent"])),
        _listing("Dropped", {k: counts(v) for k, v in source["dropped"].items()}),
        _listing("Lost", {k: counts(v) for k, v in source["losses"].items()}),
    ]
    inside, title = "\n\n".join(filter(None, details)), "All figures, sensors, and what was dropped"
    folded = f"<details><summary>{title}</summary>\n\n{inside}\n\n</details>" if inside else ""
    prediction, jitter = report.get("prediction"), report.get("jitter")
    parts = [
        f"# locfuse: {escape(title_of(report))}",
        _with_code(report.get("headline", "")),
        "\n".join(f"- {escape(line)}" for line in banner_of(report)),
        "\n".join(
            f"- {SIGNS.get(v['verdict'], '●')} **{escape(sensor)} {v['verdict']}.** {escape(v['words'])}"
            for sensor, v in report.get("verdicts", {}).items()
        ),
        markdown(tables.configurations(report)),
        _truth_line(report),
        f"{escape(prediction['trust'])}\n\n{markdown(tables.ranking(report))}" if prediction else "",
        f"{escape(jitter['words'])}\n\n{markdown(tables.jitter(report))}" if jitter else "",
        _listing("Findings", dict.fromkeys(map(sentence, unwarned(report)), "")),
        escape(together(report) or ""),
        _listing("Notes", dict.fromkeys(notes_of(report), "")),
        folded,
        f"Input {identity}, locfuse {escape(report['locfuse'])}. Deviation = estimate - {compared_with}.",
    ]
    return "\n\n".join(p for p in parts if p) + "\n"


def _with_code(words: str) -> str:
    """Return a text escaped for Markdown; parts between backticks stay code."""
    return CODE.sub(lambda found: code(ESCAPE.sub(r"\1", found[1])), escape(words))


def _truth_line(report: Mapping[str, Any]) -> str:
    truth = report["truth"]
    if truth is None:
        reference = report.get("reference")
        return escape(reference["words"]) if reference else "No truth in this log: error figures do not exist."
    aligned = {v["align"] for v in report["configurations"].values()} - {"none"}
    how = f" Estimates were aligned to the truth ({', '.join(sorted(aligned))})." if aligned else ""
    heading = "" if truth["heading"] else " It has no heading."
    return f"Truth: {code(truth['topic'])}, {truth['used']} of {truth['stamps']} stamps used.{heading}{how}"


def _listing(title: str, entries: Mapping[str, str]) -> str:
    if not entries:
        return ""
    lines = [f"- {escape(k)}" + (f": {escape(v)}" if v else "") for k, v in entries.items()]
    return f"**{title}**\n\n" + "\n".join(lines)
