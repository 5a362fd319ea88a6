"""A Dask cluster as an executor: jobs go to its workers, which run each in a process of its own.

Logs, settings and the folder of the results are on disks that all machines share, or logs are at addresses.
"""

from __future__ import annotations

import logging
import warnings
from collections.abc import Iterator
from concurrent.futures import Executor
from contextlib import contextmanager
from importlib.metadata import version
from typing import Any

from locfuse.formats.versions import own
from locfuse.fusion.data import LocfuseError

INSTALL_COMMAND = "pip install 'locfuse[cluster]'"
CONNECT_TIMEOUT_S = 20.0  # for a scheduler to answer, and for its first worker
MAX_RETRIES = 2  # of a job whose worker raised what no job raises


@contextmanager
def cluster(address: str) -> Iterator[tuple[Executor, int]]:
    """Connect to a scheduler, such as "tcp://127.0.0.1:8786"; yield its executor and how many jobs run at once.

    Raises LocfuseError where none answers, where it has no workers, or where a worker has another locfuse.
    """
    with _connected(address) as client:
        _check_workers(address, client)
        yield client.get_executor(retries=MAX_RETRIES, pure=False), sum(client.nthreads().values())


@contextmanager
def _connected(address: str) -> Iterator[Any]:
    try:
        import distributed
    except ImportError:
        raise LocfuseError(f"--cluster {address}: it needs another package: {INSTALL_COMMAND}") from None
    logging.getLogger("distributed").setLevel(logging.CRITICAL)  # what matters is in the outcomes
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # other versions of Dask: what does not fit fails in words
        connect: Any = distributed.Client
        try:
            client = connect(address, timeout=CONNECT_TIMEOUT_S, set_as_default=False)
        except (OSError, ValueError) as problem:
            raise LocfuseError(
                f"--cluster {address}: no scheduler answers there ({_line(problem)}); start one with: "
                "dask scheduler --host 127.0.0.1 --dashboard-address 127.0.0.1:0"
            ) from None
        with client:
            yield client


def _check_workers(address: str, client: Any) -> None:
    try:
        client.wait_for_workers(1, timeout=CONNECT_TIMEOUT_S)
    except TimeoutError:
        raise LocfuseError(
            f"--cluster {address}: the scheduler has no workers; start some with: dask worker {address}"
        ) from None
    ours = own()
    for worker, found in client.run(version, "locfuse", on_error="return").items():
        if isinstance(found, Exception):
            raise LocfuseError(f"--cluster {address}: worker {worker} has no locfuse: pip install locfuse=={ours}")
        if found != ours:
            raise LocfuseError(f"--cluster {address}: worker {worker} has locfuse {found}, this is {ours}")


def _line(problem: Any) -> str:
    return " ".join(str(problem).split())[:200]
