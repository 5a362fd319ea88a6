"""The times of a stream never decrease, trust the stamps where they can be trusted, and say where they are not."""

from itertools import combinations
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from present import present

from locfuse.formats.logs.clock import RowTimes, common_clock, in_order, never_decreasing, on_clock, pooled, settle
from locfuse.fusion.data import Ints

S = 10**9
MS = 10**6
T0 = 1_700_000_000 * S


def recording(n: int = 200, period: int = 50 * MS, delay: int = 30 * MS) -> tuple[Ints, Ints]:
    """Log times and stamps of a healthy stream with a jitter of some milliseconds in the delay."""
    stamp = T0 + np.arange(n, dtype=np.int64) * period
    jitter = np.random.default_rng(0).integers(0, 5 * MS, n)
    return stamp + delay + jitter, stamp


def error(clock: RowTimes, truth: Ints) -> float:
    """Largest error of the times, seconds."""
    return float(np.abs(clock.t_ns - truth).max()) / S


@pytest.mark.parametrize(
    ("made", "order", "words"),
    [
        (lambda stamp: None, "auto", "log time (no header)"),
        (lambda stamp: np.full_like(stamp, T0), "auto", "all 200 header stamps are the same"),
        (np.zeros_like, "auto", "all header stamps are zero"),
        (lambda stamp: stamp - T0 + S, "recorded", ""),  # of another clock
    ],
)
def test_where_stamps_date_nothing_log_time_is_the_time(made: Any, order: str, words: str) -> None:
    log_time, stamp = recording()
    clock = settle(log_time, made(stamp), order)
    np.testing.assert_array_equal(clock.t_ns, log_time)
    assert words in clock.words


def test_what_waited_and_a_slow_simulation_keep_their_stamps_and_two_clocks_are_noted() -> None:
    """A simulation at half speed for an hour: the delay grows by half an hour without a fault."""
    assert settle(np.full(3, T0), np.full(3, T0 - S)).by_stamps
    log_time, stamp = recording()
    assert settle(log_time + np.where(np.arange(200) < 100, 0, 3 * S), stamp).as_stamped
    apart = 2 + np.median(log_time - stamp) / S
    assert settle(log_time + 2 * S, stamp).notes == (
        f"header stamps and log times differ by {apart:.1f} s: two clocks; header stamps are used",
    )
    stamp = 1 * S + np.arange(36_000, dtype=np.int64) * 100 * MS
    clock = settle(T0 + 2 * stamp, stamp)
    np.testing.assert_array_equal(clock.t_ns, stamp)
    assert "two clocks" in clock.notes[0]


def test_order_recorded_takes_log_time_less_the_median_delay_without_repeated_stamps() -> None:
    log_time, stamp = recording()
    clock = settle(log_time, stamp, "recorded")
    assert (np.diff(clock.t_ns) == np.diff(log_time)).all()
    assert np.median(clock.t_ns - stamp) == pytest.approx(0, abs=1)
    clock = settle(log_time, stamp[np.arange(200) // 4 * 4], "recorded")
    assert error(clock, stamp) < 0.006  # the jitter of the delay, 5 ms


def test_microseconds_in_the_field_of_nanoseconds_are_read_as_such_and_whole_seconds_are_kept() -> None:
    """A stamp of 1.25 s is written as 1 s and 250000 ns."""
    log_time, stamp = recording()
    clock = settle(log_time, stamp // S * S + stamp % S // 1000)
    np.testing.assert_array_equal(clock.t_ns, stamp)
    assert clock.by_stamps
    assert "microseconds" in clock.words
    log_time, stamp = recording(period=S)
    stamp += np.random.default_rng(1).integers(0, 900_000, 200)
    assert settle(log_time, stamp).as_stamped


@pytest.mark.parametrize("rate", [1.02, 0.98])
def test_a_clock_that_drifts_past_the_recording_is_read_at_its_rate_and_one_that_waits_is_not(rate: float) -> None:
    log_time, stamp = recording(400)
    last = stamp[0 if rate > 1.0 else -1]
    clock = settle(log_time, last + np.rint((stamp - last) * rate).astype(np.int64))
    assert error(clock, stamp) < 0.002
    assert "drift" in clock.repaired
    assert settle(log_time + np.arange(400) * MS, stamp).as_stamped


@pytest.mark.parametrize("seconds", [-3600.0, -3.0, 1.5])
@pytest.mark.parametrize("number", [80, 120])
def test_a_clock_that_is_set_while_it_is_recorded_goes_on_as_it_would_have(seconds: float, number: int) -> None:
    """The recording's clock was right all the time, before or after."""
    log_time, truth = recording()
    stamp = truth + np.where(np.arange(200) < number, int(seconds * S), 0)
    clock = settle(log_time, stamp)
    assert error(clock, truth) < 0.011
    assert common_clock([(log_time, stamp)]) is None


@pytest.mark.parametrize(
    ("rows", "value", "reason"),
    [
        ([50], 0, "zero"),
        ([0], 0, "zero"),
        ([199], 0, "zero"),
        ([0, 1, 2, 60, 61, 199], 0, "zero"),
        ([50], -5 * S, "negative"),
        ([50], T0 + 10**6 * S, "off the stream's clock"),
        ([0], 100 * S, "off the stream's clock"),
        ([199], T0 + 3600 * S, "off the stream's clock"),
        ([199], np.iinfo(np.int64).max, "off the stream's clock"),
        ([50], T0 + 1 * S, "off the stream's clock"),
        ([50], T0 + 4 * S, "off the stream's clock"),
        ([50], T0 + 2 * S, "backwards"),
    ],
)
def test_an_impossible_stamp_is_dated_by_its_recording_time(rows: list[int], value: int, reason: str) -> None:
    log_time, truth = recording()
    stamp = truth.copy()
    stamp[rows] = value
    clock = settle(log_time, stamp)
    assert error(clock, truth) < 0.011  # the jitter of the delay, twice
    assert clock.repaired == {reason: len(rows)}
    assert f"{len(rows)} {reason}" in clock.words
    good = np.setdiff1d(np.arange(200), rows)
    np.testing.assert_array_equal(clock.t_ns[good], truth[good])


def test_a_log_whose_stamps_run_backwards_keeps_the_order_of_recording() -> None:
    """The Intel lab log: 631 of 13 631 stamps run backwards by up to 0.9 s, and file order is the true order."""
    rng = np.random.default_rng(2)
    n = 13_631
    truth = T0 + np.arange(n, dtype=np.int64) * 200 * MS
    stamp = truth.copy()
    late = rng.choice(np.arange(10, n - 10), 640, replace=False)
    stamp[late] -= rng.integers(250 * MS, 900 * MS, len(late))
    clock = settle(truth + 10 * MS, stamp)
    assert (np.diff(clock.t_ns) >= 0).all()
    assert (np.abs(clock.t_ns - truth) > 1 * MS).mean() < 0.002  # late stamps beside later ones contradict nothing
    assert 600 < clock.repaired["backwards"] <= 640
    assert clock.rows is None


@pytest.mark.parametrize("wrong", ["swapped", "late"])
def test_stamps_of_messages_that_were_recorded_together_are_moved_into_their_order(wrong: str) -> None:
    """Both messages of a pair have one recording time: it cannot date either of them."""
    true = T0 + np.arange(400) * 100 * MS
    stamp, at = true.copy(), np.arange(20, 380, 37)
    if wrong == "swapped":
        stamp[at], stamp[at + 1] = true[at + 1], true[at]
    else:
        stamp[at] += 350 * MS
    found = settle(np.maximum.accumulate(stamp) + 2 * MS, stamp)
    assert (np.diff(found.t_ns) >= 49 * MS).all()
    assert np.abs(found.t_ns - true).max() <= 51 * MS
    away = np.ones(400, bool)
    away[np.add.outer(at, np.arange(-1, 6))] = False
    np.testing.assert_array_equal(found.t_ns[away], true[away])
    assert "moved into their order" in found.words


@pytest.mark.parametrize("wrong", ["recording", "stamps"])
def test_right_stamps_of_messages_that_were_recorded_late_are_sorted(wrong: str) -> None:
    """Every 37th message is 150 ms late: in its recording, or by its stamp."""
    true = T0 + np.arange(400) * 100 * MS
    late = np.arange(400) % 37 == 20
    if wrong == "recording":
        at = true + np.where(late, 153, 3) * MS
        order = np.argsort(at)
        found = settle(at[order], true[order])
        np.testing.assert_array_equal(found.t_ns, true)
        np.testing.assert_array_equal(order[found.rows], np.arange(400))
        assert f"{late.sum()} of 400 messages were recorded after later ones" in found.words
    else:
        found = settle(true + 3 * MS, true - np.where(late, 150 * MS, 0))
        assert found.rows is None
        assert np.abs(found.t_ns - true).max() < 5 * MS


def test_moving_stamps_into_their_order_is_isotonic_regression() -> None:
    """By its min-max formula, of stamps that scatter by more than their step and keep no beat to be off."""
    rng = np.random.default_rng(5)
    stamp = T0 + np.rint(np.cumsum(rng.exponential(1.0, 12)) * 1e8 + rng.normal(0.0, 3e7, 12)).astype(np.int64)
    steps = np.diff(stamp)
    half = 0.5 * np.median(steps[steps > 0])
    room = np.append(0.0, np.cumsum(np.where(steps > 0, np.minimum(half, steps), half)))
    y = stamp - T0 - room
    means = [[min(y[j : k + 1].mean() for k in range(i, 12)) for j in range(i + 1)] for i in range(12)]
    expected = [max(some) for some in means] + room
    assert (steps < 0).any()
    np.testing.assert_allclose(in_order(stamp) - T0, expected, atol=1.0)


STEPS = [(200, -15 * S, 0), (100, 500 * S, 500 * S), (200, S, 0), (200, 4 * S // 10, 0), (200, -4 * S // 10, 0)]


@pytest.mark.parametrize(("since", "by", "of_larger"), STEPS)
def test_a_clock_that_is_set_for_good_goes_on(since: int, by: int, of_larger: int) -> None:
    """As when a simulation is reset: the smaller part is dated on the clock of the larger one."""
    log_time, truth = np.add(recording(300), ((3600 * S,), (0,)))
    stamp = truth + by * (np.arange(300) >= since)
    clock = settle(log_time, stamp)
    assert (np.diff(clock.t_ns) >= 0).all()
    assert error(clock, truth + of_larger) < 0.011
    assert clock.repaired == {"off the stream's clock": 100}


@pytest.mark.parametrize("times", [2, 3])
def test_a_log_that_was_played_in_a_loop_says_which_part_is_one_pass(times: int) -> None:
    log_time, stamp = recording()
    passes = np.concatenate([log_time + k * 60 * S for k in range(times)])
    words = settle(passes, np.tile(stamp, times)).again
    assert f"{200 * (times - 1)} header stamps run back and repeat" in words
    assert words.endswith(f"Use one pass: --to {(log_time[-1] - log_time[0]) / S:.1f}")
    begun_late = settle(passes[50:], np.tile(stamp, times)[50:])
    assert "Use one pass: --from " in begun_late.again
    other = np.concatenate([stamp, stamp[:150] + S // 1000])  # a clock that was set
    assert not settle(passes[:350], other).again


def stalled(log_time: Ints, stamp: Ints) -> tuple[Ints, Ints]:
    """The recording stalls and catches up."""
    return np.where((np.arange(300) >= 100) & (np.arange(300) < 160), log_time[160], log_time), stamp


def paused(log_time: Ints, stamp: Ints) -> tuple[Ints, Ints]:
    later = 100 * S * (np.arange(300) >= 150)
    return log_time + later, stamp + later


def repeated(log_time: Ints, stamp: Ints) -> tuple[Ints, Ints]:
    return log_time, stamp[np.append(np.arange(7), np.arange(6, 299))]


@pytest.mark.parametrize("change", [lambda *times: times, stalled, paused, repeated])
def test_a_stream_without_faults_keeps_its_stamps(change: Any) -> None:
    log_time, stamp = change(*recording(300))
    clock = settle(np.sort(log_time), stamp)
    np.testing.assert_array_equal(clock.t_ns, stamp)
    assert (clock.words, clock.repaired, clock.dropped, clock.notes) == ("header stamps", {}, {}, ())


def test_stamps_that_are_mostly_unusable_give_way_to_recording_times() -> None:
    log_time, truth = recording()
    stamp = truth.copy()
    stamp[:150] = 0
    clock = settle(log_time, stamp)
    assert error(clock, truth) < 0.011
    assert clock.words.startswith(
        "recording order: most header stamps contradict it; log time less the median delay"
    )


def test_order_stamp_sorts_the_rows_and_drops_what_has_no_stamp() -> None:
    log_time, stamp = recording(10)
    stamp[[3, 4]] = stamp[[4, 3]]
    stamp[7] = 0
    clock = settle(log_time, stamp, "stamp")
    assert clock.rows is not None
    assert clock.rows.tolist() == [0, 1, 2, 4, 3, 5, 6, 8, 9]
    np.testing.assert_array_equal(clock.t_ns, stamp[clock.rows])
    assert clock.dropped == {"zero or negative stamp": 1}


@pytest.mark.parametrize("order", ["auto", "stamp", "recorded"])
def test_no_messages_and_one_message(order: str) -> None:
    none = np.empty(0, np.int64)
    assert len(settle(none, none, order).t_ns) == 0
    one = np.array([T0])
    assert settle(one, one - MS, order).t_ns.tolist() == [T0 - MS]


@settings(max_examples=200, deadline=None)
@given(st.lists(st.integers(0, 12), max_size=9))
def test_the_largest_believable_part_is_the_largest_of_all_subsets(values: list[int]) -> None:
    keep = never_decreasing(np.array(values, np.int64), np.ones(len(values)))
    kept = [value for value, good in zip(values, keep, strict=True) if good]
    assert kept == sorted(kept)
    subsets = (choice for n in range(len(values) + 1) for choice in combinations(values, n))
    assert len(kept) == max(len(choice) for choice in subsets if list(choice) == sorted(choice))


def test_of_two_contradicting_stamps_the_weightier_one_is_believed() -> None:
    values = np.array([1, 2, 9, 4, 5], np.int64)
    assert never_decreasing(values, np.ones(5)).tolist() == [True, True, False, True, True]
    values = np.array([3, 2], np.int64)
    assert never_decreasing(values, np.array([0.2, 1])).tolist() == [False, True]
    assert never_decreasing(values, np.array([1, 0.2])).tolist() == [True, False]


@settings(max_examples=300, deadline=None)
@given(
    st.lists(
        st.tuples(st.integers(0, 3 * S), st.one_of(st.integers(-(10**10), 10**10), st.integers(-(2**62), 2**62))),
        max_size=40,
    ),
    st.sampled_from(["auto", "stamp", "recorded"]),
)
def test_times_never_decrease_whatever_the_stamps_are(rows: list[tuple[int, int]], order: str) -> None:
    log_time = T0 + np.cumsum(np.array([step for step, _ in rows], np.int64))
    stamp = T0 + np.array([value for _, value in rows], np.int64)
    clock = settle(log_time, stamp, order)
    assert (np.diff(clock.t_ns) >= 0).all()
    expected = len(stamp) if clock.rows is None else len(clock.rows)
    assert len(clock.t_ns) == expected


def test_what_has_no_header_is_dated_on_the_clock_of_the_others_stamps() -> None:
    """A simulation at 0.8 of the wall's speed, its stamps from 12 s on: recorded together is happened together."""
    true = np.arange(0, 100 * S, S // 10)
    wall = T0 + (true * 5) // 4
    known = present(common_clock([(wall, true + 12 * S), (wall + 10**6, true + 12 * S)]))
    some = RowTimes(wall[55:900:7] + 2, None, "log time (no header)")
    dated = on_clock(some, known)
    np.testing.assert_allclose(dated.t_ns, true[55:900:7] + 12 * S, atol=1000)
    assert dated.on_stamps
    outside = on_clock(RowTimes(wall[[0, -1]] + np.array([-S, S]), None, ""), known)
    np.testing.assert_allclose(outside.t_ns, true[[0, -1]] + 12 * S + np.array([-S, S]), atol=1000)


@pytest.mark.parametrize("stamp", [0, -5])
def test_stamps_that_cannot_be_used_are_dated_on_the_clock_of_the_others_stamps(stamp: int) -> None:
    """A log that was replayed and recorded again 8 days later, one topic without usable stamps."""
    log_time, own = recording()
    behind = 8 * 86400 * S
    clock = settle(log_time, np.full(200, stamp), "auto", lambda: (log_time, own - behind))
    np.testing.assert_array_equal(clock.t_ns, own - behind)
    apart = behind / S + float(np.median(log_time - own)) / S
    assert f"less the {apart:.3f} s (median)" in clock.words
    assert clock.notes == ()
    np.testing.assert_array_equal(settle(log_time, np.full(200, stamp)).t_ns, log_time)
    plain = settle(log_time, own, "auto", lambda: (log_time, own - behind))
    assert (plain.as_stamped, plain.t_ns.tolist()) == (True, own.tolist())


def test_stamps_of_the_recordings_clock_or_of_several_clocks_date_nothing_else() -> None:
    true = T0 + np.arange(0, 10 * S, S // 10)
    late, other = (true + 20_000_000, true), (true, true - 3600 * S)
    assert common_clock([late]) is None
    assert common_clock([late, other]) is None
    assert common_clock([other, (true, true - 5 * S)]) is None
    assert common_clock([(true, true[::-1] - 3600 * S)]) is None
    assert common_clock([]) is None
    assert common_clock([other]) is not None


# --- times that run backwards: the order of the file, or the times? And which of two times in the wrong order?


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
    found = present(pooled(set_back(truth)))
    times, replaced = found
    assert (np.diff(times) >= 0).all()
    error = np.abs(times - truth) / MS
    assert error.max() < 60.0  # half a period
    assert (error > 20.0).mean() < 0.005
    assert 0.04 * len(truth) < replaced < 0.06 * len(truth)


@pytest.mark.parametrize("later", [1, 2, 5])
def test_messages_that_were_written_late_have_right_times_in_the_wrong_order(later: int) -> None:
    truth = steady()
    order = np.arange(len(truth), dtype=np.float64)
    order[::37] += later + 0.5
    assert pooled(truth[np.argsort(order)]) is None


def test_times_in_order_stay_and_uneven_ones_are_wrong_by_their_longest_steps_at_most() -> None:
    truth = steady()
    assert pooled(truth) is None
    assert pooled(np.concatenate((truth[2000:], truth[:2000]))) is None  # two files in the other order
    assert pooled(truth[:0]) is None
    truth = steady(uneven_ms=50.0)
    found = present(pooled(set_back(truth)))
    assert np.abs(found[0] - truth).max() <= 3 * np.diff(truth).max()
    assert (np.abs(found[0] - truth) > 60 * MS).mean() < 0.02  # of 5 % that were wrong by 450 ms in the mean


def test_stamps_off_the_beat_are_dated_by_a_steady_recording_and_not_by_one_that_stalls() -> None:
    truth = steady()
    clock = settle(truth + 10 * MS, set_back(truth))
    assert np.abs(clock.t_ns - truth).max() < 25 * MS
    assert set(clock.repaired) == {"backwards", "off the beat"}
    truth = steady(uneven_ms=0.5)
    stamp, log_time = truth.copy(), truth + 10 * MS
    stamp[50] -= 500 * MS
    log_time[100:110] = log_time[110]
    clock = settle(log_time, stamp)
    np.testing.assert_array_equal(clock.t_ns[100:110], truth[100:110])
    assert clock.repaired == {"backwards": 1}
