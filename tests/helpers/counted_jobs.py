"""Which jobs of a fleet really run in a process: what was finished before does not."""

from __future__ import annotations

import pytest

from locfuse.cli.fleet import process
from locfuse.cli.fleet.job import Job, JobOutcome


def counted_jobs(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Return a list that gets the name of every job that is run from now on."""
    ran: list[str] = []
    real = process._in_a_process

    def counted(job: Job, folder: str) -> JobOutcome:
        ran.append(job.name)
        return real(job, folder)

    monkeypatch.setattr(process, "_in_a_process", counted)
    return ran
