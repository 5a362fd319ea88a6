"""Logs that nothing should be estimated from yet: `info --check` would exit with 3."""

from __future__ import annotations

from collections.abc import Collection

from locfuse.cli.analysis.load import Loaded
from locfuse.formats.report.findings import options
from locfuse.fusion.checks.examine import examine
from locfuse.fusion.data import LocfuseError


def refuse_doubtful(one: Loaded, what: str, own: Collection[str] = ()) -> None:
    """Raise LocfuseError where a setting is surely wrong that `what` would cover up; `own` are codes it finds.

    Where the drive starts spoils neither noise nor wheels.
    """
    if one.drive.wheels.stands:
        return
    streams = {role: one.stream(role) for role in one.choice.topics}
    for finding in examine(one.drive, one.robot, streams):
        if finding.severe and finding.code not in {"start", *own} and (finding.fixes or finding.role == "truth"):
            raise LocfuseError(
                f"{one.log.name}: {finding.role}: {finding.brief}; {what} would cover that up.",
                role=finding.role,
                fixes=finding.fixes,
                hint=f"Set it first: {options(finding.fixes)}" if finding.fixes else "Leave this log out",
            )
