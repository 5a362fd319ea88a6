"""Running one job: not at all where its results are there, else in a process of its own, whose end is a row.

`run` takes and returns plain values and needs nothing but the folders: any executor with `submit` can call it.
"""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import tempfile
import threading
from contextlib import suppress

import msgspec

from locfuse.formats.versions import own
from locfuse.fusion.data import LocfuseError, UsageError

from .job import Job, Outcome
from .resume import is_finished

COMMAND = (sys.executable, "-m", "locfuse.cli.fleet.child")
_RUNNING: set[subprocess.Popen[bytes]] = set()
_STOPPED = threading.Event()


def run(job: Job) -> Outcome:
    """Run a job and return what became of it; whatever happens to its process is a reason, never an exception."""
    return already(job) or _started(job)


def already(job: Job) -> Outcome | None:
    """Return the outcome of a job that needs no process: its results are there, or its log cannot be opened."""
    try:
        return Outcome(job.name, "done", resumed=True) if is_finished(job) else None
    except LocfuseError as problem:
        return Outcome(job.name, "failed", " ".join(str(problem).split()), isinstance(problem, UsageError))


def run_elsewhere(job: Job, folder: str, wanted: str) -> Outcome:
    """Run a job on another machine: in `folder`, on disks that are shared, by locfuse of version `wanted`."""
    machine = socket.gethostname()
    if (ours := own()) != wanted:
        return Outcome(job.name, "failed", f"worker on {machine}: it has locfuse {ours}, wanted was {wanted}")
    if not os.path.isdir(folder):  # noqa: PTH112 - as typed elsewhere
        return Outcome(job.name, "failed", f"worker on {machine}: it does not see the folder {folder}")
    return _started(msgspec.structs.replace(job, within=folder))


def _started(job: Job) -> Outcome:
    try:
        return _in_a_process(job)
    except OSError as problem:
        return Outcome(job.name, "failed", f"no process could be started for it: {problem.strerror or problem}")


def _in_a_process(job: Job) -> Outcome:
    environment = {"OPENBLAS_NUM_THREADS": "1", **os.environ}
    with (
        tempfile.TemporaryFile() as words,
        subprocess.Popen(
            COMMAND,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=words,
            env=environment,
            cwd=job.within,
            start_new_session=True,  # Ctrl-C is for the command, which ends its processes itself
        ) as process,
    ):
        _RUNNING.add(process)
        if _STOPPED.is_set():
            process.terminate()
        assert process.stdin is not None
        assert process.stdout is not None
        with suppress(BrokenPipeError):  # it died at once: its exit code says how
            process.stdin.write(msgspec.json.encode(job) + b"\n")
            process.stdin.flush()
        answer = process.stdout.read()
        code = process.wait()
        _RUNNING.discard(process)
        with suppress(msgspec.DecodeError, msgspec.ValidationError):
            if code == 0:
                return msgspec.json.decode(answer, type=Outcome)
        words.seek(0)
        return Outcome(job.name, "failed", _ended(code, words.read()))


def _ended(code: int, words: bytes) -> str:
    """Say how a process ended that left no answer."""
    if code < 0:
        name = signal.Signals(-code).name if -code in set(signal.Signals) else "unknown"
        hint = ": often too little memory for so many --jobs" if -code == signal.SIGKILL else ""
        return f"its process was ended by signal {-code} ({name}){hint}"
    lines = words.decode("utf-8", "replace").strip().splitlines()
    return f"its process ended with code {code}: {' '.join(lines[-1].split()) if lines else 'it said nothing'}"


def stop() -> None:
    """End the processes of all jobs that run; their temporary files go with them."""
    _STOPPED.set()
    for process in tuple(_RUNNING):
        with suppress(OSError):
            process.terminate()


def may_run() -> None:
    """Let jobs run again after a stop."""
    _STOPPED.clear()
