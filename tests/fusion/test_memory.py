"""What an hour of log must not cost, in bytes that are counted, not measured: the same on every machine."""

from __future__ import annotations

import tracemalloc
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from locfuse import sample_logs
from locfuse.cli.analysis.compare import Compared, compare_log
from locfuse.cli.analysis.configurations import for_comparison
from locfuse.cli.analysis.load import load
from locfuse.cli.analysis.settings import Asked, LogOptions
from locfuse.fusion.data import Audit, Estimates, Measurements
from locfuse.fusion.judge.innovations import own

LINES = 100_000


def peak(work: Callable[[], Any]) -> int:
    """Bytes held at most while some work is done, beyond what was held before."""
    work()  # what is imported or computed once is there
    tracemalloc.start()
    try:
        work()
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


def size(table: Any) -> int:
    """Bytes of the arrays of a table."""
    columns = [getattr(table, name) for name in table.__struct_fields__]
    columns += [one for column in columns if isinstance(column, dict) for one in column.values()]
    return sum(column.nbytes for column in columns if isinstance(column, np.ndarray))


def lines() -> tuple[Audit, Measurements]:
    """Innovations of many lines."""
    rng = np.random.default_rng(1)
    k = np.arange(LINES, dtype=np.int32)
    y = rng.normal(size=(LINES, 2))
    verdict, nis, gate = np.zeros(LINES, np.int8), (y**2).sum(axis=1), np.full(LINES, 18.4)
    audit = Audit(k // 8, k, verdict, k % 8, nis, gate, y, np.full((LINES, 2), 1.0))
    R_unit = np.broadcast_to(np.eye(2), (LINES, 2, 2)).copy()
    first = np.arange(0, LINES + 1, 8)
    return audit, Measurements(np.arange(len(first) - 1.0), first, y, R_unit, 0.5, 0.1 * np.eye(2))


@pytest.fixture(scope="module")
def compared() -> tuple[Compared, list[Estimates]]:
    seen: list[Estimates] = []
    loaded = load([sample_logs.path("rounded_rectangle")], LogOptions(None, (), None, strict=False, quiet=True))
    wanted = for_comparison((), loaded.drive)
    asked = Asked(audits=False)
    return compare_log(loaded, wanted, asked, lambda _: None, watch=[lambda e, _: seen.append(e)]), seen


def test_audits_are_shown_to_who_draws_them_and_end_with_the_judgement(
    compared: tuple[Compared, list[Estimates]],
) -> None:
    found, seen = compared
    assert sorted(e.name for e in seen) == sorted(e.name for e in found.estimates)
    assert all(set(e.audits) == set(e.sensors) for e in seen)
    assert not any(e.audits for e in (*found.estimates, *(run.estimates for run in found.runs)))


def test_what_remains_of_a_configuration_is_a_few_numbers_an_instant(
    compared: tuple[Compared, list[Estimates]],
) -> None:
    found, _ = compared
    truth = found.loaded.drive.truth
    assert truth is not None
    for e, judged in zip(found.estimates, found.evaluations, strict=True):
        assert size(e) <= 8 * (12 * len(e.t) + 12 * len(truth.t))
        assert size(judged) <= 8 * 13 * len(truth.t)


def test_judging_a_sensors_noise_takes_little_more_than_its_audit() -> None:
    audit, m = lines()
    assert peak(lambda: own(audit, m)) < 1.5 * size(audit)
