"""One job in its own process, so that a crash is a failed row of the fleet's table.

The process is `python -m locfuse.cli.fleet.process`. It reads the job from stdin and writes the outcome to stdout.
It ends when stdin is closed, so that no process continues after the command was killed.
"""

from __future__ import annotations

import os
import pickle
import signal
import socket
import subprocess
import sys
import tempfile
import threading
from contextlib import suppress
from pathlib import Path

from locfuse.cli.advice.together import looks, numbers_of
from locfuse.cli.analysis import maps
from locfuse.cli.analysis.errors import expected
from locfuse.cli.analysis.load import load, with_settings
from locfuse.cli.analysis.settings import silent
from locfuse.cli.rerun.record import record_drive
from locfuse.cli.session.session import Session
from locfuse.formats.versions import own

from .jobs import Job, JobOutcome, SweepCell, is_replaceable

COMMAND = (sys.executable, "-m", "locfuse.cli.fleet.process")
EXIT_ORPHANED = 1  # exit code if the parent process has ended
RUNNING: set[subprocess.Popen[bytes]] = set()


def run(job: Job, folder: str, version: str) -> JobOutcome:
    """Run a job in a new process, if this machine sees the command's `folder` and has its `version`."""
    worker, why = f"worker on {socket.gethostname()}", ""
    if (ours := own()) != version:
        why = f"{worker}: it has locfuse {ours}, wanted was {version}"
    elif not Path(folder).is_dir():  # a path of another machine
        why = f"{worker}: it does not see the folder {folder}"
    try:
        return JobOutcome(job.name, "failed", why) if why else _in_a_process(job, folder)
    except OSError as problem:
        return JobOutcome(job.name, "failed", f"no process could be started for it: {problem.strerror or problem}")


def _in_a_process(job: Job, folder: str) -> JobOutcome:
    with (
        tempfile.TemporaryFile() as words,
        subprocess.Popen(
            COMMAND,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=words,
            env={"OPENBLAS_NUM_THREADS": "1", **os.environ},
            cwd=folder,
            start_new_session=True,  # on Ctrl-C the command ends its processes itself
        ) as process,
    ):
        assert process.stdin is not None
        assert process.stdout is not None
        RUNNING.add(process)
        with suppress(BrokenPipeError):  # the process has ended already: see its exit code
            process.stdin.write(pickle.dumps(job))
            process.stdin.flush()
        answer = process.stdout.read()
        code = process.wait()
        with suppress(BrokenPipeError):  # the rest of the job, if the process has not read it
            process.stdin.close()
        RUNNING.discard(process)
        if code == 0 and answer:
            outcome: JobOutcome = pickle.loads(answer)
            return outcome
        words.seek(0)
        return JobOutcome(job.name, "failed", _ended(code, words.read()))


def _ended(code: int, words: bytes) -> str:
    """Return in words how a process ended that wrote no outcome."""
    if code < 0:
        name = signal.Signals(-code).name if -code in set(signal.Signals) else "unknown"
        hint = ": often too little memory for so many --jobs" if -code == signal.SIGKILL else ""
        return f"its process was ended by signal {-code} ({name}){hint}"
    lines = words.decode("utf-8", "replace").strip().splitlines()
    return f"its process ended with code {code}: {' '.join(lines[-1].split()) if lines else 'it said nothing'}"


def stop() -> None:
    """Terminate the processes of all running jobs."""
    for process in tuple(RUNNING):
        with suppress(OSError):
            process.terminate()


def main() -> None:
    """Read a job from stdin, run it, and write its outcome to stdout."""
    with os.fdopen(os.dup(1), "wb") as answer:
        os.dup2(2, 1)  # output of libraries goes to stderr
        job: Job = pickle.load(sys.stdin.buffer)

        def end_with_parent() -> None:
            os.read(0, 1)  # not sys.stdin, whose lock would block the interpreter's exit
            os._exit(EXIT_ORPHANED)

        threading.Thread(target=end_with_parent, daemon=True).start()
        answer.write(pickle.dumps(outcome(job)))


def outcome(job: Job) -> JobOutcome:
    """Run a job in this process, and return its outcome."""
    try:
        if job.tries:
            loaded = load(job.log, job.how)
            return JobOutcome(job.name, "done", looks=looks(loaded, job.tries, job.asked.align, silent))
        return JobOutcome(job.name, "done", warnings=compare(job))
    except Exception as problem:
        known = expected(problem)
        if known is None:
            raise  # a bug: its traceback is shown
        line, code = known
        return JobOutcome(job.name, "failed", line, misused=code == 2)


def compare(job: Job) -> tuple[str, ...]:
    """Measure a job's log once, and write the results of each cell; return warnings."""
    measured = load(job.log, job.how)
    if job.cells == (SweepCell(),) and job.recordings is None:
        measured.log.forget()  # it is not read again
    outputs, warnings = job.outputs, []
    for cell in job.cells:
        loaded = with_settings(measured, cell.sets) if cell.sets else measured
        found = Session(maps.give_topic(loaded), silent).compared(job.asked)
        if job.cells == (SweepCell(),):
            found.report["measured"] = numbers_of(found.loaded, tuple(found.estimates.values()))
        folder = job.place(cell)
        overwrite = outputs.overwrite or is_replaceable(folder)
        found.write(folder, write=outputs.write, export=outputs.export, overwrite=overwrite)
        if outputs.figures is not None:
            found.write_figures(outputs.figures / cell.folder)
        if job.recordings is not None and (why := record_drive(job.recordings, job.recording_of(cell), found)):
            warnings.append(why)
    return tuple(warnings)


if __name__ == "__main__":
    main()
