"""The process of one job: reads it on stdin, compares its log, says on stdout what became of it.

Run as `python -m locfuse.cli.fleet.child`. It ends when its stdin does, so that nothing goes on running for a
command that was killed.
"""

from __future__ import annotations

import os
import sys
import threading
from pathlib import Path

import msgspec

from locfuse.cli.analysis.load import find_log, load
from locfuse.cli.analysis.memory import give_back, settle_heap
from locfuse.cli.analysis.settings import silent
from locfuse.cli.rerun.recordings import write
from locfuse.cli.session.session import Session
from locfuse.fusion.data import LocfuseError, UsageError

from .job import Cell, Job, Outcome
from .resume import is_replaceable

ORPHANED = 1  # exit code where the command that started it is gone


def main() -> None:
    """Run the job on stdin."""
    job = msgspec.json.decode(sys.stdin.buffer.readline(), type=Job)
    threading.Thread(target=_end_with_parent, daemon=True).start()
    out, sys.stdout = sys.stdout, sys.stderr  # what a library prints is no outcome
    settle_heap()
    out.write(msgspec.json.encode(outcome(job)).decode() + "\n")
    out.flush()


def _end_with_parent() -> None:
    os.read(0, 1)  # past the buffer of sys.stdin, whose lock the end of the interpreter needs
    os._exit(ORPHANED)


def outcome(job: Job) -> Outcome:
    """Run a job in this process and say what became of it, in one line where it failed."""
    try:
        warnings = compare(job)
    except LocfuseError as problem:
        return Outcome(job.name, "failed", " ".join(str(problem).split()), isinstance(problem, UsageError))
    except OSError as problem:
        where = f" {problem.filename}" if problem.filename else ""
        return Outcome(job.name, "failed", f"{problem.strerror or problem}:{where}" if where else str(problem))
    except MemoryError:
        return Outcome(job.name, "failed", "out of memory")
    return Outcome(job.name, "done", warnings=warnings)


def compare(job: Job) -> tuple[str, ...]:
    """Measure the log of a job once and write the results of every cell; return what did not work beside them."""
    loaded = load(find_log(job.log), job.how)
    if job.cells == (Cell(),) and job.recording is None:
        loaded.log.forget()
    give_back()
    session, warnings = Session(loaded, silent), []
    for cell in job.cells:
        changed = session.with_settings(cell.sets) if cell.sets else session
        found = changed.compare(
            job.asked.sensors or None,
            all_subsets=job.asked.all_subsets,
            align=job.asked.align,
            smooth=job.asked.smooth,
            audits=job.recording is not None,
            reference=False,  # truth and references do not mix in a table
            advice=False,  # a fleet is compared; a single log is advised on
        )
        folder = job.place(cell)
        found.write(folder, write=job.kinds, export=job.export, overwrite=job.overwrite or is_replaceable(folder))
        if job.figures is not None:
            found.write_figures(Path(job.figures) / cell.name.replace(" ", ","))
        if job.recording is not None and (why := write(job.recording, job.recording_of(cell), found)):
            warnings.append(why)
    return tuple(warnings)


if __name__ == "__main__":
    main()
