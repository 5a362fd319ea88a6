"""The queue of a fleet: runs jobs on an executor and collects outcomes, until all are done or it is stopped."""

from __future__ import annotations

import logging
import time
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Executor, Future, ThreadPoolExecutor, wait
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, field
from importlib.metadata import version
from pathlib import Path
from typing import Any

from locfuse.cli.analysis.settings import FleetOptions
from locfuse.formats.versions import own
from locfuse.fusion.data import LocfuseError, UsageError

from . import process
from .jobs import Job, JobOutcome, is_finished

NOT_RUN = "stopped before it was run"
POLL_S = 0.5  # between updates of the progress
STOP_S = 0.1  # between attempts to end running processes
REASONS_LOST = {  # exception of an executor -> why a job has no outcome
    "KilledWorker": "every worker that ran it died; often too little memory",
    "CancelledError": "the connection to the scheduler was lost",
    "ModuleNotFoundError": "a worker cannot import what it needs: {problem}",
}


@dataclass
class QueueState:
    """Numbers of jobs done, failed, skipped and left."""

    total: int
    done: int = 0
    failed: int = 0
    resumed: int = 0
    began: float = field(default_factory=time.monotonic)

    def count(self, outcome: JobOutcome) -> None:
        """Add the outcome of a job."""
        self.done += outcome.state == "done"
        self.failed += outcome.state == "failed"
        self.resumed += outcome.resumed

    @property
    def left(self) -> int:
        """Number of jobs without an outcome."""
        return self.total - self.done - self.failed

    def words(self) -> str:
        """Return the progress in one line, with the time for the remaining jobs at the pace so far."""
        line = f"{self.done} done, {self.failed} failed, {self.left} left"
        ran = self.done + self.failed - self.resumed
        seconds = (time.monotonic() - self.began) / max(ran, 1) * self.left
        return f"{line}, about {duration(seconds)}" if ran and self.left else line


def duration(seconds: float) -> str:
    """Return a duration [s] as text: "40 s", "12 min" or "3.5 h"."""
    if seconds < 90.0:
        return f"{seconds:.0f} s"
    return f"{seconds / 60.0:.0f} min" if seconds < 5400.0 else f"{seconds / 3600.0:.1f} h"


Watch = Callable[[QueueState, JobOutcome | None], None]


@dataclass(frozen=True)
class Ended:
    """The outcomes by log name, and the reason if the queue was stopped early."""

    outcomes: Mapping[str, JobOutcome]
    stopped: str = ""  # the reason; "" if every job has an outcome
    by: BaseException | None = None  # interrupt or signal to raise again after the results are written


def executor(fleet: FleetOptions) -> AbstractContextManager[Executor]:
    """Return the executor of jobs: threads of this machine (one process per job), or a cluster."""
    return ThreadPoolExecutor(fleet.jobs) if fleet.cluster is None else cluster(fleet.cluster)


def run_all(jobs: Sequence[Job], pool: Executor, max_failures: int | None, watch: Watch) -> Ended:
    """Run jobs on an executor, except those with complete results, and return their outcomes."""
    found: dict[str, JobOutcome] = {}
    state = QueueState(len(jobs))
    running: dict[Future[JobOutcome], Job] = {}
    try:
        for outcome in _outcomes(jobs, pool, running):
            if outcome is not None:
                found[outcome.name] = outcome
                state.count(outcome)
            watch(state, outcome)
            if max_failures is not None and state.failed > max_failures and state.left:
                return Ended(found, f"more than {max_failures} logs failed (--max-failures)")
    except Exception:
        raise
    except BaseException as stopped:  # Ctrl-C, SIGTERM: outcomes so far are kept
        return Ended(found, "interrupted", stopped)
    finally:  # cancels jobs that have not started, and ends those that run
        for future in running:
            future.cancel()
        while not all(future.done() for future in running):
            process.stop()
            time.sleep(STOP_S)
    return Ended(found)


def _outcomes(
    jobs: Sequence[Job], pool: Executor, running: dict[Future[JobOutcome], Job]
) -> Iterator[JobOutcome | None]:
    """Yield each job's outcome when it is known, and None every POLL_S seconds."""
    for job in jobs:
        if (outcome := already(job)) is not None:
            yield outcome
        else:
            running[pool.submit(process.run, job, str(Path.cwd()), own())] = job
    while running:
        finished, _ = wait(running, POLL_S, FIRST_COMPLETED)
        yield from (_outcome(future, running.pop(future)) for future in finished)
        yield None


def already(job: Job) -> JobOutcome | None:
    """Return the outcome of a job that need not run (complete results, or an unreadable log), else None."""
    if job.refused:
        return JobOutcome(job.name, "failed", job.refused, misused=True)
    try:
        return JobOutcome(job.name, "done", resumed=True) if is_finished(job) else None
    except LocfuseError as problem:
        return JobOutcome(job.name, "failed", " ".join(str(problem).split()), isinstance(problem, UsageError))


def _outcome(future: Future[JobOutcome], job: Job) -> JobOutcome:
    """Return a job's outcome; if the executor failed, a failed outcome with its error."""
    try:
        return future.result()
    except Exception as problem:
        kind, words = type(problem).__name__, _line(problem)
        why = REASONS_LOST.get(kind, f"the cluster failed it: {kind}: {{problem}}")
        return JobOutcome(job.name, "failed", why.format(problem=words))


# --- A Dask cluster as executor: its workers run each job in a new process. All machines share the disk with logs,
# settings and results; logs may also be remote.

INSTALL_COMMAND = "pip install 'locfuse[cluster]'"
CONNECT_TIMEOUT_S = 20.0  # for a scheduler to answer, and for its first worker
MAX_RETRIES = 2  # of a job whose worker failed


@contextmanager
def cluster(address: str) -> Iterator[Executor]:
    """Connect to a Dask scheduler, such as "tcp://127.0.0.1:8786", and yield its executor.

    Raises LocfuseError if none answers, it has no workers, or a worker has another version of locfuse.
    """
    try:
        import distributed
    except ImportError:
        raise LocfuseError(f"--cluster {address}: it needs another package: {INSTALL_COMMAND}") from None
    logging.getLogger("distributed").setLevel(logging.CRITICAL)  # errors are in the outcomes
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # on other versions of Dask; real problems raise errors
        connect: Any = distributed.Client
        try:
            client = connect(address, timeout=CONNECT_TIMEOUT_S, set_as_default=False)
        except (OSError, ValueError) as problem:
            start = "dask scheduler --host 127.0.0.1 --dashboard-address 127.0.0.1:0"
            words = f"no scheduler answers there ({_line(problem)}); start one with: {start}"
            raise LocfuseError(f"--cluster {address}: {words}") from None
        with client:
            _check_workers(address, client)
            yield client.get_executor(retries=MAX_RETRIES, pure=False)


def _check_workers(address: str, client: Any) -> None:
    try:
        client.wait_for_workers(1, timeout=CONNECT_TIMEOUT_S)
    except TimeoutError:
        words = f"the scheduler has no workers; start some with: dask worker {address}"
        raise LocfuseError(f"--cluster {address}: {words}") from None
    ours = own()
    for worker, found in client.run(version, "locfuse", on_error="return").items():
        if found != ours:
            other = f"locfuse {found}, this is {ours}"
            other = f"no locfuse: pip install locfuse=={ours}" if isinstance(found, Exception) else other
            raise LocfuseError(f"--cluster {address}: worker {worker} has {other}")


def _line(problem: Any) -> str:
    return " ".join(str(problem).split())[:200]
