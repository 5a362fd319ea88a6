"""What holds for all tests: what programs print does not depend on the terminal, and they can be interrupted."""

import gc
import os
import signal
from collections.abc import Generator, Iterator
from pathlib import Path
from typing import Any

import hypothesis
import pytest

# A shell may export its width; what is tested is what a pipe gets.
os.environ.pop("COLUMNS", None)

# On two cores with two workers threads of a library only wait for each other. The command line sets this as well.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

# A runner that was started in the background ignores Ctrl-C, and so would every program it starts.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

# A loaded machine is slow: that says nothing of what is tested.
hypothesis.settings.register_profile(
    "untimed", deadline=None, suppress_health_check=[hypothesis.HealthCheck.too_slow]
)
hypothesis.settings.load_profile("untimed")


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Generator[None, object, object]:
    """Importing the tests makes no garbage, and what they imported stays: it is never swept."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.collect()
        gc.freeze()
        gc.enable()


@pytest.fixture(scope="session")
def plain(tmp_path_factory: pytest.TempPathFactory) -> tuple[Any, Path]:
    """The sample log, compared without any option: what was printed, and the folder of its results."""
    from commands import ok

    out = tmp_path_factory.mktemp("plain") / "out"
    return ok("compare", "rounded_rectangle", "-o", out), out


@pytest.fixture
def unswept() -> Iterator[None]:
    """Look for no garbage: where much is made and kept that takes most of the time."""
    gc.disable()
    yield
    gc.enable()


@pytest.fixture
def jobs_in_this_process() -> Iterator[None]:
    from commands import jobs_here

    with jobs_here():
        yield


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport() -> Generator[None, pytest.TestReport, pytest.TestReport]:
    """With LOCFUSE_MUST_RUN a test that misses recorded logs or a browser fails: nothing is skipped unnoticed."""
    report = yield
    why = report.longrepr[2] if report.skipped and isinstance(report.longrepr, tuple) else ""
    if os.environ.get("LOCFUSE_MUST_RUN") and any(word in why for word in ("LOCFUSE_DATA", "Chromium")):
        report.outcome, report.longrepr = "failed", f"must run here, but: {why}"
    return report
