"""Run the command line in this process: exit code, stdout, stderr, as a user would see them."""

import json
import pickle
import tempfile
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

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


def refused(*words: Any, code: int | None = 1) -> str:
    """Run what must fail with this code (None: with 1 or 2), and return its one line."""
    done = locfuse(*words)
    assert done.exit_code in ((1, 2) if code is None else (code,)), done.stderr
    assert done.stderr.count("\n") == 1, done.stderr
    assert done.stderr.startswith("locfuse: ")
    return done.stderr


class Reported(NamedTuple):
    """What `compare` or `run` says: its report and its output."""

    report: dict[str, Any]
    stdout: str
    stderr: str
    out: Path  # the folder of results

    @property
    def rows(self) -> dict[str, Any]:
        """The figures of every configuration."""
        found: dict[str, Any] = self.report["configurations"]
        return found


def reported(*words: Any, code: int = 0) -> Reported:
    """Run `compare` or `run`; what the words do not name is a folder of its own with nothing but the report."""
    if "-o" not in words:
        words = (*words, "-o", Path(tempfile.mkdtemp(dir=experiment.scratch())) / "out")
    if "--write" not in words:
        words = (*words, "--write", "json")
    done, out = locfuse(*words), Path(words[words.index("-o") + 1])
    assert done.exit_code == code, done.stderr
    return Reported(report_in(out), done.stdout, done.stderr, out)


def report_in(folder: Path) -> dict[str, Any]:
    """The report.json or run.json of a folder of results."""
    (file,) = folder.glob("*[nt].json")
    found: dict[str, Any] = json.loads(file.read_text())
    return found


@contextmanager
def jobs_here() -> Iterator[None]:
    """Start no process for a fleet's jobs; a job still arrives as the bytes that a process would read."""
    one_at_a_time = threading.Lock()

    def here(job: Job, _folder: str) -> JobOutcome:
        with one_at_a_time:
            return process.outcome(pickle.loads(pickle.dumps(job)))

    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(process, "_in_a_process", here)
        yield


def counted_jobs(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Return a list that gets the name of every job that is run from now on."""
    ran: list[str] = []
    real = process._in_a_process

    def counted(job: Job, folder: str) -> JobOutcome:
        ran.append(job.name)
        return real(job, folder)

    monkeypatch.setattr(process, "_in_a_process", counted)
    return ran
