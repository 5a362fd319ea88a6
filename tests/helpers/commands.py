"""Run the command line in this process: exit code, stdout, stderr, as a user would see them."""

from __future__ import annotations

import pickle
import threading
from typing import Any

import pytest

from benchmarks import experiment
from locfuse.cli.fleet import process
from locfuse.cli.fleet.jobs import Job, JobOutcome

Done = experiment.Done
locfuse = experiment.locfuse


def ok(*words: Any) -> Done:
    """Run what must succeed."""
    done = locfuse(*words)
    assert done.exit_code == 0, done.stderr
    return done


# --- the jobs of a fleet, run in this process one after the other, or counted


def jobs_here(monkeypatch: pytest.MonkeyPatch) -> None:
    """Start no process from now on; a job still arrives as the bytes that a process would read."""
    one_at_a_time = threading.Lock()

    def here(job: Job, _folder: str) -> JobOutcome:
        with one_at_a_time:
            return process.outcome(pickle.loads(pickle.dumps(job)))

    monkeypatch.setattr(process, "_in_a_process", here)


def counted_jobs(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Return a list that gets the name of every job that is run from now on."""
    ran: list[str] = []
    real = process._in_a_process

    def counted(job: Job, folder: str) -> JobOutcome:
        ran.append(job.name)
        return real(job, folder)

    monkeypatch.setattr(process, "_in_a_process", counted)
    return ran
