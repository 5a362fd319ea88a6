"""Jobs on the workers of a cluster: the same tables as on this machine, and every trouble is a row or one line."""

import re
import socket
import sys
from collections.abc import Iterator
from concurrent.futures import Future
from importlib.metadata import version
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import pytest
from commands import locfuse, ok, refused
from many_logs import LIGHT, tables, write_logs

from locfuse.cli.analysis.settings import Asked, LogOptions, Outputs
from locfuse.cli.fleet import process, queue as clusters
from locfuse.cli.fleet.jobs import Job, JobOutcome
from locfuse.cli.fleet.queue import run_all
from locfuse.fusion.data import LocfuseError

ONE = ("--sensors", "odometry", "--write", "json,csv", "-q")


@pytest.fixture(scope="module")
def logs(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    folder = tmp_path_factory.mktemp("cluster")
    made = write_logs(folder, ("good",), (*LIGHT, "path.legs=[{forward=0.5}]"))
    bad = folder / "bad.mcap"
    bad.write_text("no log at all")
    return [*made, bad]


@pytest.fixture
def address() -> Iterator[str]:
    """A scheduler and a worker in this process, on the loopback."""
    distributed = pytest.importorskip("distributed")
    options: dict[str, Any] = {"host": "127.0.0.1", "dashboard_address": None, "protocol": "tcp://"}
    with distributed.LocalCluster(n_workers=1, threads_per_worker=1, processes=False, **options) as found:
        yield found.scheduler_address


def job(name: str, folder: Path) -> Job:
    return Job(name, (name,), folder, LogOptions(), Asked(), Outputs())


@pytest.mark.filterwarnings("ignore")
def test_tables_are_those_of_this_machine_and_what_is_finished_is_not_sent(
    logs: list[Path], address: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(logs[0].parent)
    names = [log.name for log in logs]  # relative to the folder in which the command is typed
    for out, words in (("here", ()), ("there", ("--cluster", address))):
        done = locfuse("fleet", *names, "-o", tmp_path / out, *ONE, *words)
        assert done.exit_code == 3, done.stderr
    assert tables(tmp_path / "here") == tables(tmp_path / "there")
    monkeypatch.setattr(process, "run", None)
    ok("fleet", names[0], "-o", tmp_path / "there", *ONE, "--cluster", address)


def test_a_worker_of_another_version_or_without_the_folder_is_a_row(tmp_path: Path) -> None:
    found = process.run(job("a", tmp_path), str(tmp_path), "9.9")
    assert found.state == "failed"
    assert "wanted was 9.9" in found.reason
    assert socket.gethostname() in found.reason
    found = process.run(job("a", tmp_path), str(tmp_path / "gone"), version("locfuse"))
    assert f"does not see the folder {tmp_path / 'gone'}" in found.reason


@pytest.mark.parametrize(
    ("workers", "said"),
    [
        ({"run.return_value": {"tcp://w:1": ModuleNotFoundError("locfuse")}}, "tcp://w:1 has no locfuse: pip"),
        ({"run.return_value": {"tcp://w:1": "0.0.1"}}, "worker tcp://w:1 has locfuse 0.0.1, this is"),
        ({"wait_for_workers.side_effect": TimeoutError}, "no workers; start some with: dask worker tcp://s:1"),
    ],
)
def test_workers_that_cannot_do_it_are_named_before_anything_is_sent(workers: dict[str, Any], said: str) -> None:
    with pytest.raises(LocfuseError, match=re.escape(said)):
        clusters._check_workers("tcp://s:1", Mock(**workers))


def test_what_the_cluster_fails_is_a_row(tmp_path: Path) -> None:
    class KilledWorker(Exception):  # noqa: N818 - as the cluster calls it
        pass

    problems = (KilledWorker("x"), ModuleNotFoundError("No module named 'cv2'"), ValueError("odd\nthing"))
    futures = [Future[JobOutcome]() for _ in problems]
    for future, problem in zip(futures, problems, strict=True):
        future.set_exception(problem)
    pool = Mock(**{"submit.side_effect": futures})
    ended = run_all([job(str(i), tmp_path) for i in range(3)], pool, None, lambda standing, outcome: None)
    reasons = " ".join(outcome.reason for outcome in ended.outcomes.values())
    assert "every worker that ran it died" in reasons
    assert "a worker cannot import what it needs: No module named 'cv2'" in reasons
    assert "the cluster failed it: ValueError: odd thing" in reasons
    assert {outcome.state for outcome in ended.outcomes.values()} == {"failed"}


@pytest.mark.filterwarnings("ignore")
def test_no_scheduler_and_no_package_are_one_line(
    logs: list[Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    words = ("fleet", *logs, "-o", tmp_path / "out", *ONE, "--cluster")
    assert locfuse(*words, "tcp://127.0.0.1:1", "--jobs", "2").exit_code == 2
    with monkeypatch.context() as patched:
        patched.setitem(sys.modules, "distributed", None)
        assert "pip install 'locfuse[cluster]'" in locfuse(*words, "tcp://127.0.0.1:1").stderr
    pytest.importorskip("distributed")
    monkeypatch.setattr(clusters, "CONNECT_TIMEOUT_S", 0.3)
    assert "no scheduler answers there" in refused(*words, "tcp://127.0.0.1:1")
