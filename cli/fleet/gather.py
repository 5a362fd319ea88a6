"""What the jobs of a fleet left behind, read from their folders: the same whether they ran now or long ago."""

from __future__ import annotations

from collections.abc import Mapping

import msgspec
from msgspec import field

from locfuse.cli.analysis.gates import FleetGates
from locfuse.cli.analysis.results import lost_in
from locfuse.formats.fleet.entry import Entry, slim

from .job import Job, Outcome
from .plan import Plan
from .resume import read_report

GONE = "its report.json is gone or cannot be read; run it again with --again"


class Gathered(msgspec.Struct, frozen=True):
    """A fleet as rows, and what must be said about it."""

    entries: list[Entry] = field(default_factory=list)
    gates: list[str] = field(default_factory=list)  # a line per gate that a log fails
    lost: dict[str, list[str]] = field(default_factory=dict)  # what each log lost, in words

    @property
    def void(self) -> dict[str, list[str]]:
        """Why figures of logs are void, in words."""
        return {e.name: e.void for e in self.entries if e.void}


def gather(plan: Plan, outcomes: Mapping[str, Outcome], stopped: str, gates: FleetGates, strict: bool) -> Gathered:
    """Read the report of every job that is done; what `stopped` the others is their reason."""
    found = Gathered()
    for name in plan.names:
        outcome = outcomes.get(name) or plan.refused.get(name)
        robot = plan.groups[name]
        if outcome is None:
            found.entries.append(Entry(name, robot, "not run", stopped))
        elif outcome.state == "failed":
            found.entries.append(Entry(name, robot, "failed", outcome.reason))
        else:
            found.entries.append(_entry(plan.jobs[name], found, gates, strict))
    return found


def _entry(job: Job, found: Gathered, gates: FleetGates, strict: bool) -> Entry:
    """Return what is kept of one log; its report is let go."""
    reports = {cell.name: read_report(job.place(cell)) for cell in job.cells}
    whole = {cell: report for cell, report in reports.items() if report is not None}
    if len(whole) < len(reports):
        return Entry(job.name, job.group, "failed", GONE)
    for cell, report in whole.items():
        title = f"{job.name} [{cell}]" if cell else job.name
        found.gates.extend(f"{title}: {line}" for line in gates.each.failures(report))
        if lines := lost_in(report, strict):
            found.lost[job.name] = lines
    return Entry(job.name, job.group, report=slim(whole), cells=tuple(whole))
