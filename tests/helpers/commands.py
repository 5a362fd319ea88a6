"""Run the command line in this process: exit code, stdout, stderr, as a user would see them."""

from __future__ import annotations

import contextlib
import io
import pickle
import signal
import threading
from dataclasses import dataclass
from typing import Any

import pytest

from locfuse.cli.fleet import process
from locfuse.cli.fleet.jobs import Job, JobOutcome
from locfuse.cli.main import main


@dataclass(frozen=True)
class Done:
    exit_code: int
    stdout: str
    stderr: str


def locfuse(*words: Any) -> Done:
    out, err = io.StringIO(), io.StringIO()
    handler = signal.getsignal(signal.SIGTERM)
    code = 0
    try:
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
            main([str(w) for w in words])
    except SystemExit as e:
        code = int(e.code or 0)
    finally:
        signal.signal(signal.SIGTERM, handler)
    return Done(code, out.getvalue(), err.getvalue())


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
