"""Times that run backwards: the order of the file, or the times? And which of two times in the wrong order?"""

from __future__ import annotations

import numpy as np
import pytest

from locfuse.formats.logs import jitter
from locfuse.formats.logs.clock import settle
from locfuse.fusion.data import Ints

S, MS = 10**9, 10**6
T0 = 1_700_000_000 * S


def steady(n: int = 4000, uneven_ms: float = 5.0) -> Ints:
    """A stream at 8 Hz whose period varies."""
    steps = 120.0 + np.random.default_rng(1).normal(0.0, uneven_ms, n)
    stamps: Ints = T0 + np.rint(np.cumsum(np.maximum(steps, 5.0)) * MS).astype(np.int64)
    return stamps


def set_back(truth: Ints, share: float = 0.05, most: float = 0.9) -> Ints:
    rng = np.random.default_rng(2)
    late = rng.random(len(truth)) < share
    return truth - np.where(late, rng.uniform(0.0, most * S, len(truth)), 0.0).astype(np.int64)


def test_times_that_jitter_in_the_right_order_are_pooled() -> None:
    truth = steady()
    found = jitter.pooled(set_back(truth))
    assert found is not None
    times, replaced = found
    assert (np.diff(times) >= 0).all()
    error = np.abs(times - truth) / MS
    assert error.max() < 60.0  # half a period
    assert (error > 20.0).mean() < 0.005
    assert 0.04 * len(truth) < replaced < 0.06 * len(truth)


def test_of_a_stream_with_an_uneven_period_no_time_is_wrong_by_more_than_its_longest_steps() -> None:
    truth = steady(uneven_ms=50.0)
    found = jitter.pooled(set_back(truth))
    assert found is not None
    assert np.abs(found[0] - truth).max() <= 3 * np.diff(truth).max()
    assert (np.abs(found[0] - truth) > 60 * MS).mean() < 0.02  # of 5 % that were wrong by 450 ms in the mean


@pytest.mark.parametrize("later", [1, 2, 5])
def test_messages_that_were_written_late_have_right_times_in_the_wrong_order(later: int) -> None:
    truth = steady()
    order = np.arange(len(truth), dtype=np.float64)
    order[::37] += later + 0.5
    assert jitter.pooled(truth[np.argsort(order)]) is None


def test_times_in_order_and_another_clock_are_left_alone() -> None:
    truth = steady()
    assert jitter.pooled(truth) is None
    assert jitter.pooled(np.concatenate((truth[2000:], truth[:2000]))) is None  # two files in the other order
    assert jitter.pooled(truth[:0]) is None


def test_stamps_off_the_beat_beside_stamps_that_run_backwards_are_dated_by_a_steady_recording() -> None:
    truth = steady()
    clock = settle(truth + 10 * MS, set_back(truth))
    assert np.abs(clock.t_ns - truth).max() < 25 * MS
    assert set(clock.repaired) == {"backwards", "off the beat"}


def test_a_recording_that_stalls_does_not_make_steady_stamps_wrong() -> None:
    truth = steady(uneven_ms=0.5)
    stamp, log_time = truth.copy(), truth + 10 * MS
    stamp[50] -= 500 * MS
    log_time[100:110] = log_time[110]
    clock = settle(log_time, stamp)
    np.testing.assert_array_equal(clock.t_ns[100:110], truth[100:110])
    assert clock.repaired == {"backwards": 1}
