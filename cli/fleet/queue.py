"""The queue: jobs to an executor and their outcomes back, until all are done or something stops it."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from dataclasses import dataclass, field
from typing import Any, Protocol

from . import process
from .job import Job, Outcome

AHEAD = 4  # jobs that wait at the executor for each that runs
NOT_RUN = "stopped before it was run"
POLL_S = 0.5  # s between looks at the clock while jobs run


class Executor(Protocol):
    """Whatever runs jobs: threads here, workers of a cluster elsewhere."""

    def submit(self, fn: Callable[[Job], Outcome], job: Job, /) -> Future[Outcome]:
        """Run a job some time."""


@dataclass
class Standing:
    """How far the queue is."""

    total: int
    done: int = 0
    failed: int = 0
    resumed: int = 0
    began: float = field(default_factory=time.monotonic)

    @property
    def left(self) -> int:
        """Jobs without an outcome."""
        return self.total - self.done - self.failed

    @property
    def seconds_left(self) -> float | None:
        """How long the rest will take at the pace so far; None before any job was really run."""
        ran = self.done + self.failed - self.resumed
        return (time.monotonic() - self.began) / ran * self.left if ran else None

    def words(self) -> str:
        """Return it in a line."""
        line = f"{self.done} done, {self.failed} failed, {self.left} left"
        seconds = self.seconds_left
        return line if seconds is None or not self.left else f"{line}, about {duration(seconds)}"


def duration(seconds: float) -> str:
    """Return "40 s", "12 min" or "3.5 h"."""
    if seconds < 90.0:
        return f"{seconds:.0f} s"
    return f"{seconds / 60.0:.0f} min" if seconds < 5400.0 else f"{seconds / 3600.0:.1f} h"


@dataclass(frozen=True)
class Ended:
    """The outcomes by the name of the log, and what stopped the queue before its end."""

    outcomes: Mapping[str, Outcome]
    stopped: str = ""  # in words; empty where every job has an outcome
    by: BaseException | None = None  # Ctrl-C or a signal, to be raised once the results are safe


def run_all(
    jobs: Sequence[Job],
    executor: Executor,
    slots: int,
    max_failures: int | None,
    watch: Callable[[Standing, Outcome | None], None],
) -> Ended:
    """Run jobs on an executor with so many slots and return what became of them."""
    found: dict[str, Outcome] = {}
    standing = Standing(len(jobs))
    waiting = iter(jobs)
    running: dict[Future[Outcome], Job] = {}
    process.may_run()
    try:
        while standing.left:
            if max_failures is not None and standing.failed > max_failures:
                return Ended(found, f"more than {max_failures} logs failed (--max-failures)")
            _fill(running, waiting, executor, slots)
            finished, _ = wait(running, POLL_S, FIRST_COMPLETED)
            for future in finished:
                _count(_outcome(future, running.pop(future)), found, standing, watch)
            watch(standing, None)
    except Exception:
        raise
    except BaseException as stopped:  # Ctrl-C, SIGTERM: what is done stays done
        return Ended(found, "interrupted", stopped)
    finally:
        _cancel(running)
    return Ended(found)


def _outcome(future: Future[Outcome], job: Job) -> Outcome:
    """Return what became of a job; an executor that could not even say so is a reason too."""
    try:
        return future.result()
    except Exception as problem:
        from .cluster import lost

        return lost(job, problem)


def _fill(running: dict[Future[Outcome], Job], waiting: Any, executor: Executor, slots: int) -> None:
    """Hand over jobs, few enough that none is far ahead of those that run."""
    while len(running) < AHEAD * slots and (job := next(waiting, None)) is not None:
        running[executor.submit(process.run, job)] = job


def _count(
    outcome: Outcome,
    found: dict[str, Outcome],
    standing: Standing,
    watch: Callable[[Standing, Outcome | None], None],
) -> None:
    found[outcome.name] = outcome
    standing.done += outcome.state == "done"
    standing.failed += outcome.state == "failed"
    standing.resumed += outcome.resumed
    watch(standing, outcome)


def _cancel(running: Mapping[Future[Outcome], Job]) -> None:
    """Take back what has not begun and end what runs."""
    for future in running:
        future.cancel()
    if running:
        process.stop()
