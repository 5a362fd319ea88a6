"""The jobs of a fleet run in this process, one after the other: for tests of anything but the processes."""

from __future__ import annotations

import pickle
import threading

import pytest

from locfuse.cli.fleet import process
from locfuse.cli.fleet.job import Job, JobOutcome


def jobs_here(monkeypatch: pytest.MonkeyPatch) -> None:
    """Start no process from now on; a job still arrives as the bytes that a process would read."""
    one_at_a_time = threading.Lock()

    def here(job: Job, _folder: str) -> JobOutcome:
        with one_at_a_time:
            return process.outcome(pickle.loads(pickle.dumps(job)))

    monkeypatch.setattr(process, "_in_a_process", here)
