"""Choice of the times of a stream's rows: header stamps, checked against the recording order.

In real logs, stamps run backwards, repeat, are zero or absurd. The recording order is taken as true. A stamp that
contradicts it is replaced: its time is interpolated between trusted stamps by recording time. If several messages
have one recording time, stamps get the smallest changes that put them in order (isotonic regression).

In a simulation, and in a log that was replayed and recorded again, stamps and recording use different clocks. The
recording times of messages without stamps are then converted to the clock of the other topics' stamps.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Callable, Sequence
from typing import Any

import msgspec
import numpy as np
from msgspec.structs import replace
from numpy.lib.stride_tricks import sliding_window_view

from locfuse.fusion.data import Array, ArrayStream, Ints, LocfuseError, Mask, totals
from locfuse.fusion.streams import MAX_DELAY_S

ORDERS = ("auto", "stamp", "recorded")
NS_PER_MS = 10**6
MICROSECONDS = 10**6  # in one second
# ns. If a step of the stamps differs from the step of the recording times by more than JUMP_NS, the clock of the
# stamps has changed. A difference from STEP_NS to JUMP_NS means this only if messages were recorded evenly: a
# recorder that waits causes such a difference too
JUMP_NS, STEP_NS, MIN_EVEN_STEPS = 10 * 10**9, 10**9, 10
# ns, messages: a smaller difference counts if it stays over so many messages before and after it
LASTING_NS, LASTING_MESSAGES = 250 * NS_PER_MS, 20
MIN_PIECE_SHARE = 0.25  # share of messages; a smaller piece on the recording's clock is not preferred
# of a drift: pieces of the log, ns over the log and after the recording, largest deviation from a straight line
DRIFT_PARTS, MIN_DRIFT_NS, MAX_BEND_SHARE = 8, 50 * NS_PER_MS, 0.1
# small message types with headers that most logs have; their stamps show which clock is used
SMALL_TYPES = (
    "nav_msgs/msg/Odometry",
    "sensor_msgs/msg/JointState",
    "sensor_msgs/msg/Imu",
    "sensor_msgs/msg/LaserScan",
)
MIN_MESSAGES, MAX_TOPICS = 20, 3
MIN_REPEATED_SHARE = 0.9  # of the stamps after a step back: a log that was played in a loop
# of right stamps in the wrong order: least step when sorted, in median steps (a wrong stamp lies between two
# others, so less than half a step from one); share of the late messages
MIN_BEAT_SHARE, MIN_LATE_SHARE = 0.6, 0.9
SAME_CLOCK_NS = 10**9  # topics use one clock if their stamps' offsets from recording differ by less

Others = Callable[[], tuple[Ints, Ints] | None]  # the result of common_clock


class RowTimes(msgspec.Struct, frozen=True):
    """The chosen times of a stream's rows, and their source."""

    t_ns: Ints  # (n,) never decreasing
    rows: Ints | None  # (n,) index of each row's message in recording order; None: 0 .. n - 1
    words: str  # description of the choice
    by_stamps: bool = False  # whether the times are header stamps, perhaps sorted or repaired
    repaired: dict[str, int] = {}  # reason -> stamps replaced
    dropped: dict[str, int] = {}  # reason -> messages without a usable time
    notes: tuple[str, ...] = ()
    on_stamps: bool = False  # whether recording times were converted to the clock of other topics' stamps
    again: str = ""  # words on stamps that run back and repeat

    @property
    def as_stamped(self) -> bool:
        """Whether all times are unchanged header stamps."""
        return self.by_stamps and self.rows is None and not self.repaired


class MadeStream(ArrayStream, frozen=True, kw_only=True):
    """A stream derived from another topic or a file, with all rows in memory (fusion.data.Stream)."""

    clock: RowTimes  # the choice of its times
    delay_s: float | None = None  # median of recording time - stamp


class UnreadableStream:
    """Derived topic that cannot be read.

    Access to its times, columns and other attributes of a MadeStream raises `problem`.
    """

    frame_id = ""

    def __init__(self, topic: str, msgtype: str, problem: LocfuseError) -> None:
        self.topic = topic
        self.msgtype = msgtype
        self.problem = problem

    def __getattr__(self, name: str) -> Any:
        """Raise `problem`."""
        raise self.problem


def settle(log_time: Ints, stamp: Ints | None, order: str = "auto", others: Others = lambda: None) -> RowTimes:
    """Choose the times of a stream's messages: header stamps if they are usable, else recording times.

    `log_time` (n,) [ns] are the recording times, which never decrease; `stamp` (n,) [ns] are the header stamps, or
    None. `others` returns the clock of other topics' stamps (`common_clock`) or None; with `order` "auto",
    recording times are converted to this clock.
    """
    read, why, words = (stamp, "", "") if stamp is None else _reread(log_time, stamp)
    clock = _settled(log_time, read, order)
    if read is not None and (again := _played_again(log_time, read)):
        return replace(clock, again=again)
    if clock.by_stamps and why:
        clock = replace(clock, words=f"{clock.words}; {words}", repaired={**clock.repaired, why: len(log_time)})
    if clock.by_stamps or order != "auto" or (known := others()) is None:
        return clock
    return on_clock(clock, known)


def _reread(log_time: Ints, stamp: Ints) -> tuple[Ints, str, str]:
    """Return stamps (n,) [ns] with unit and rate set right, the reason in short and in words; "" if as written."""
    read = whole_ns(log_time, stamp)
    if read is not stamp:
        words = (
            f"their nanoseconds are below {MICROSECONDS} in all messages: they hold microseconds, and are read "
            "as such. Let the driver write nanoseconds"
        )
        return read, "microseconds for nanoseconds", words
    slope = drift(log_time, stamp)
    if not slope:
        return stamp, "", ""
    first = log_time[0 if slope < 0.0 else -1]  # where no stamp is later than its recording
    words = (
        f"their clock is {abs(slope):.2%} too {'fast' if slope < 0.0 else 'slow'} by recording times, and some "
        "are later than their recording: read at the rate of the recording"
    )
    return stamp + np.rint(slope * (log_time - first)).astype(np.int64), "drift", words


def whole_ns(log_time: Ints, stamp: Ints) -> Ints:
    """Return stamps (n,) [ns]; microseconds in place of the nanoseconds within each second become nanoseconds.

    They are below MICROSECONDS in all messages. Messages that come once per second, at its beginning, have such
    stamps too: then only the stamps as they are follow the recording times `log_time` (n,) [ns].
    """
    part = stamp % 10**9
    if len(stamp) < MIN_MESSAGES or part.max() >= MICROSECONDS:
        return stamp
    better = stamp - part + part * 1000
    off, now = (np.abs(delay - np.median(delay)) for delay in (log_time - better, log_time - stamp))
    return better if 2 * np.median(off) < np.median(now) else stamp


def drift(log_time: Ints, stamp: Ints) -> float:
    """Return the change of recording time - stamp per unit of time, if the clock of the stamps drifts; else 0.

    Then it changes on a straight line, and stamps are later than their recording at one end of it. A recorder that
    falls behind makes it grow too, but never negative.
    """
    if len(stamp) < DRIFT_PARTS * MIN_MESSAGES or not stamp.all():
        return 0.0
    since, delay = log_time - log_time[0], log_time - stamp
    parts = np.array_split(np.arange(len(stamp)), DRIFT_PARTS)
    t, off = np.array([[np.median(since[part]), np.median(delay[part])] for part in parts]).T
    slope, at = np.polyfit(t, off, 1).tolist()
    total, bend = abs(slope) * float(since[-1]), np.abs(off - at - slope * t).max()
    far = off.min() > -MIN_DRIFT_NS or np.abs(off).max() > MAX_DELAY_S * 1e9
    return 0.0 if far or total < MIN_DRIFT_NS or bend > MAX_BEND_SHARE * total else float(slope)


def _settled(log_time: Ints, stamp: Ints | None, order: str) -> RowTimes:
    if stamp is None:
        return RowTimes(log_time, None, "log time (no header)")
    if not len(stamp):
        return RowTimes(log_time, None, "header stamps", by_stamps=True)
    if order == "stamp":
        return _by_stamp(log_time, stamp)
    if not stamp.any():
        return RowTimes(log_time, None, "log time (all header stamps are zero)")
    if (stamp == stamp[0]).all() and log_time[-1] - log_time[0] > MAX_DELAY_S * 1e9:
        words = f"log time (all {len(stamp)} header stamps are the same: let the driver stamp each message)"
        return RowTimes(log_time, None, words)
    if order == "auto" and (late := _recorded_late(log_time, stamp)):
        rows = np.argsort(stamp, kind="stable")
        words = f"header stamps, sorted: {late} of {len(stamp)} messages were recorded after later ones"
        return RowTimes(stamp[rows], rows, words, by_stamps=True, notes=_differ(log_time, stamp))
    bad = _untrusted(log_time, stamp)
    trusted = ~np.any([*bad.values()], axis=0)
    if order == "recorded":
        return _recorded(log_time, stamp, trusted, "recording order, as asked for")
    if trusted.all():
        return RowTimes(stamp, None, "header stamps", by_stamps=True, notes=_differ(log_time, stamp))
    if 2 * trusted.sum() < len(stamp):
        return _recorded(log_time, stamp, trusted, "recording order: most header stamps contradict it")
    return _repaired(log_time, stamp, trusted, bad)


def _recorded_late(log_time: Ints, stamp: Ints) -> int:
    """Return the number of messages with a right stamp that were recorded after later ones; 0 if stamps are wrong.

    Right stamps keep the beat when they are sorted, and a late message has a longer delay than the next in order.
    """
    latest = np.maximum.accumulate(stamp)
    late = np.flatnonzero(stamp < latest)
    if not len(late) or (latest - stamp).max() > MAX_DELAY_S * 1e9 or stamp.min() <= 0:
        return 0
    ordered = np.sort(stamp)
    steps = np.pad(np.diff(ordered).astype(np.float64), 1, constant_values=np.inf)
    at = np.searchsorted(ordered, stamp[late])
    on_beat = np.minimum(steps[at], steps[at + 1]) > MIN_BEAT_SHARE * np.median(steps)
    in_order = np.flatnonzero(stamp == latest)
    after = np.searchsorted(in_order, late)  # place in `in_order` of the next message that is not late
    excess = (log_time - stamp)[late] - np.append(log_time - stamp, 0)[np.append(in_order, -1)[after]]
    longer = (excess > 0.5 * (latest - stamp)[late]) & (log_time[late] > log_time[late - 1])
    return len(late) if (on_beat & longer).mean() > MIN_LATE_SHARE else 0


def _played_again(log_time: Ints, stamp: Ints) -> str:
    """Return a sentence if stamps (n,) run back and repeat earlier ones from there on, else ""."""
    cuts = np.flatnonzero(np.diff(stamp) < -STEP_NS) + 1
    longest, *others = sorted(np.split(np.arange(len(stamp)), cuts), key=len, reverse=True)
    again = np.concatenate(others) if others else cuts
    if len(again) < MIN_MESSAGES or np.isin(stamp[again], stamp[longest]).mean() < MIN_REPEATED_SHARE:
        return ""
    begin, end = ((log_time[longest[[0, -1]]] - log_time[0]) * 1e-9).tolist()
    part = f"{f'--from {begin:.1f} ' if longest[0] else ''}--to {end:.1f}"
    return (
        f"{len(again)} header stamps run back and repeat earlier ones: the log was played in a loop while it was "
        f"recorded, or a simulation was reset. Use one pass: {part}"
    )


def _by_stamp(log_time: Ints, stamp: Ints) -> RowTimes:
    usable = np.flatnonzero(stamp > 0)
    rows = usable[np.argsort(stamp[usable], kind="stable")]
    unusable = len(stamp) - len(rows)
    dropped = {"zero or negative stamp": unusable} if unusable else {}
    words = "header stamps, sorted, as asked for"
    return RowTimes(stamp[rows], rows, words, True, {}, dropped, _differ(log_time, stamp))


def _recorded(log_time: Ints, stamp: Ints, trusted: Mask, words: str) -> RowTimes:
    """Return the recording times minus the median delay (recording time - stamp) of the trusted stamps.

    A repeated stamp is too old for its message and does not count. A delay above MAX_DELAY_S is not subtracted,
    since it means two clocks.
    """
    trusted = trusted & (np.diff(stamp, prepend=stamp[0] - 1) != 0)
    delay = int(np.median((log_time - stamp)[trusted])) if trusted.any() else 0
    if abs(delay) > MAX_DELAY_S * 1e9:
        return RowTimes(log_time, None, f"{words}; log time", notes=_differ(log_time, stamp))
    return RowTimes(log_time - delay, None, f"{words}; log time less the median delay of {delay / 1e9:.3f} s")


def _repaired(log_time: Ints, stamp: Ints, trusted: Mask, bad: dict[str, Mask]) -> RowTimes:
    counts = {why: int(m.sum()) for why, m in bad.items() if m.any()}
    why = ", ".join(f"{n} {reason}" for reason, n in counts.items())
    n_bad, notes = int((~trusted).sum()), _differ(log_time[trusted], stamp[trusted])
    times = np.maximum.accumulate(filled(stamp, trusted, log_time, 1))
    how = "dated by recording time instead"
    if (np.diff(times)[np.diff(stamp) != 0] == 0).any():  # equal recording times: only the order is known
        ordered = trusted | bad["backwards"] | bad["off the beat"]
        times, how = in_order(filled(stamp, ordered, log_time, 1)), "moved into their order"
    words = f"header stamps; {n_bad} of {len(stamp)} {how} ({why})"
    return RowTimes(times, None, words, True, repaired=counts, notes=notes)


def _untrusted(log_time: Ints, stamp: Ints) -> dict[str, Mask]:
    """Return reason -> mask (n,) of the stamps that are not trusted."""
    off = np.zeros(len(stamp), bool)
    ordinary = np.flatnonzero(stamp > 0)
    off[ordinary] = _off_the_clock(log_time[ordinary], stamp[ordinary])
    backwards, unsteady = np.zeros(len(stamp), bool), np.zeros(len(stamp), bool)
    left = np.flatnonzero((stamp > 0) & ~off)
    if (np.diff(stamp[left]) < 0).any():  # rare, and the search is slow
        backwards[left], unsteady[left] = _out_of_order(log_time[left], stamp[left])
    of_clock = {"off the stream's clock": off, "backwards": backwards, "off the beat": unsteady}
    return {"zero": stamp == 0, "negative": stamp < 0, **of_clock}


def _out_of_order(log_time: Ints, stamp: Ints) -> tuple[Mask, Mask]:
    """Return masks (n,) of two kinds of wrong stamps: out of order, and with an unusual delay.

    The delay is recording time - stamp. If it is unusual, either the stamp or the recording time is wrong: the one
    with less regular steps. No stamp is in both masks.
    """
    delay = log_time - stamp
    off = np.abs(delay - np.median(delay))
    deviations = off / max(float(np.median(off)), NS_PER_MS)
    weights, _ = credibility(stamp)
    backwards = ~never_decreasing(stamp, cauchy(deviations) * weights)
    recorded, _ = credibility(log_time)
    # recording times in quick succession, such as after a stall, are unreliable
    steps = np.diff(log_time)
    close = steps < 0.25 * np.median(steps) if len(steps) else np.zeros(0, bool)
    in_burst = np.append(close, False) | np.append(False, close)
    steady = (weights < recorded) & ~in_burst
    return backwards, steady & (deviations > MIN_OFF_DEVIATIONS) & ~backwards


def _off_the_clock(log_time: Ints, stamp: Ints) -> Mask:
    """Return the mask (n,) of stamps on another clock than most of the stream, e.g. from before the clock was set.

    The stream is split into pieces at jumps of the delay (recording time - stamp). The trusted piece is the
    longest one on the recording's clock, else the longest of all; a piece with another delay is on another clock.
    """
    delay, period = log_time - stamp, np.diff(log_time)
    step = np.abs(np.diff(delay))
    cut, least = step > JUMP_NS, STEP_NS
    if len(period) >= MIN_EVEN_STEPS:
        even = np.abs(period - np.median(period)) < 0.5 * step
        cut |= (step > STEP_NS) & even
        for k in np.flatnonzero((step > LASTING_NS) & even & ~cut).tolist():
            before, after = (
                delay[max(0, k + 1 - LASTING_MESSAGES) : k + 1],
                delay[k + 1 : k + 1 + LASTING_MESSAGES],
            )
            lasts = abs(np.median(after) - np.median(before)) > LASTING_NS
            cut[k] = lasts and min(len(before), len(after)) == LASTING_MESSAGES
            least = LASTING_NS if cut[k] else least
    cuts = np.flatnonzero(cut) + 1
    if not len(cuts):
        return np.zeros(len(stamp), bool)
    edges = np.concatenate(([0], cuts, [len(stamp)]))
    lengths = np.diff(edges)
    middle = np.array([np.median(piece) for piece in np.split(delay, cuts)])
    near = (np.abs(middle) < STEP_NS) & (lengths >= MIN_PIECE_SHARE * len(stamp))  # most logs have one clock
    trusted = np.argmax(np.where(near, lengths, 0) if near.any() else lengths)
    off = np.abs(middle - middle[trusted]) > least
    return np.repeat(off, lengths)


def _differ(log_time: Ints, stamp: Ints) -> tuple[str, ...]:
    """Return a note if stamps and recording times use different clocks, else ()."""
    delay = float(np.median(log_time - stamp)) / 1e9
    if abs(delay) <= MAX_DELAY_S:
        return ()
    return (f"header stamps and log times differ by {delay:.1f} s: two clocks; header stamps are used",)


def common_clock(pairs: Sequence[tuple[Ints, Ints]]) -> tuple[Ints, Ints] | None:
    """Return rising log times and stamps (n,) [ns] of one topic, to convert recording times to the stamps' clock.

    `pairs` are the log times and stamps (m,) of several topics. Their stamps must share one clock other than the
    recording's. So the result is None if a topic uses the recording clock, if offsets differ, or if stamps run
    backwards.
    """
    pairs = [(log_time[on], stamp[on]) for log_time, stamp in pairs for on in [~_off_the_clock(log_time, stamp)]]
    if not pairs or any(np.diff(stamp).min(initial=0) < 0 for _, stamp in pairs):
        return None
    offsets = [int(np.median(log_time - stamp)) for log_time, stamp in pairs]
    if min(abs(offset) for offset in offsets) < MAX_DELAY_S * 1e9 or np.ptp(offsets) > SAME_CLOCK_NS:
        return None
    log_time, stamp = max(pairs, key=lambda pair: len(pair[0]))
    keep = np.append(np.diff(log_time) > 0, True)
    return log_time[keep], stamp[keep]


def on_clock(clock: RowTimes, known: tuple[Ints, Ints]) -> RowTimes:
    """Convert a stream's recording times to the clock of other topics' stamps, by interpolation.

    `known` are the log times and stamps (n,) of another topic, the result of `common_clock`.
    """
    log_time, stamp = known
    inside = np.clip(clock.t_ns, log_time[0], log_time[-1])
    # beyond both ends, the clocks are assumed to run at the same rate
    t_ns = stamp[0] + np.interp(inside - log_time[0], log_time - log_time[0], stamp - stamp[0]).astype(np.int64)
    apart = float(np.median(log_time - stamp)) * 1e-9
    words = f"{clock.words}, less the {apart:.3f} s (median) that the stamps of the other topics are behind it"
    return replace(clock, t_ns=t_ns + (clock.t_ns - inside), words=words, on_stamps=True, notes=())


# ---- repair of jittered times: messages are in the right order, but some of their times run backwards ----
#
# If a time is earlier than that of the previous message, there are two possible causes. The message was written
# late: then its time is right, and the times of other messages have a gap there. Or its time is wrong: then the
# gap is at the message's place in the file, between its two neighbours.

MAX_BACK_NS = 2 * 10**9  # a larger step back is no jitter: the clock or the order of files has changed
MAX_BACK_SHARE = 0.25  # largest share of times in the wrong order; with more, the right times are unknown

WINDOW_READINGS = 7  # neighbours on either side that determine the expected time
MIN_OFF_DEVIATIONS, MIN_OFF_PERIODS = 8.0, 0.25  # a time is wrong if it is off by both: robust sigmas, periods


def credibility(times: Ints) -> tuple[Array, Mask]:
    """Return weights (n,), low for times that do not fit regular steps, and a mask (n,) of irregular times.

    The expected time at i is the median of t_j + (i - j) T over the neighbours j, with their median step T. Most
    streams are regular. So if two times are in the wrong order, the one with the lower weight is wrong.
    """
    n = len(times)
    if n <= 2 * WINDOW_READINGS:
        return np.ones(n), np.zeros(n, bool)
    t = (times - times[0]).astype(np.float64)
    steps = np.pad(np.diff(t), WINDOW_READINGS, mode="reflect")
    period = np.median(sliding_window_view(steps, 2 * WINDOW_READINGS), axis=1)[:n]
    places = np.arange(-WINDOW_READINGS, WINDOW_READINGS + 1)
    inner = np.arange(WINDOW_READINGS, n - WINDOW_READINGS)
    expected = t.copy()
    expected[inner] = np.median(t[inner[:, None] + places] - places * period[inner, None], axis=1)
    off = np.abs(t - expected)
    scale = max(float(np.median(off[inner])), 1e6)
    return cauchy(off / scale), (off > MIN_OFF_DEVIATIONS * scale) & (off > MIN_OFF_PERIODS * period)


def cauchy(deviations: Array) -> Array:
    """Return the weights (n,) of a Cauchy distribution (long tails) for deviations (n,) [robust sigmas]."""
    return 1.0 / (1.0 + deviations**2) + 1e-6  # > 0: of two equal sums, the one of more times wins


def pooled(times: Ints) -> tuple[Ints, int] | None:
    """Return never-decreasing times (n,) in file order, and the number of replaced times.

    The least credible times are replaced by times evenly spaced between their neighbours (isotonic regression in
    the L0 norm: a wrong time does not move a right one). If any time runs backwards, irregular times are replaced
    too. None if the times are in order, or if the times are right and the file's order is wrong.
    """
    if len(times) < 3 or (np.diff(times) >= 0).all():
        return None
    weights, off = credibility(times)
    keep = never_decreasing(times, weights)
    backwards = np.flatnonzero(~keep)
    if len(backwards) > MAX_BACK_SHARE * len(times) or not _gap_in_file(times, keep, backwards):
        return None
    keep &= ~off
    wrong = np.flatnonzero(~keep)
    if len(wrong) > MAX_BACK_SHARE * len(times):
        return None
    even = _evenly_filled(times, keep)
    if np.abs(even - times)[wrong].max() > MAX_BACK_NS:
        return None
    return even, len(wrong)


def in_order(times: Ints) -> Ints:
    """Return rising times (n,) in file order, with the smallest changes (isotonic regression).

    Irregular times are replaced first. Moved times are at least half a median step apart.
    """
    from scipy.optimize import isotonic_regression

    weights, off = credibility(times)
    t = _evenly_filled(times, ~off) if not off.all() else times
    steps = np.diff(t)
    half = 0.5 * float(np.median(steps[steps > 0])) if (steps > 0).any() else 0.0
    apart = np.where((steps > 0) | (np.diff(times) == 0), np.minimum(half, np.maximum(steps, 0)), half)
    room = totals(apart)
    level = isotonic_regression(t - t[0] - room, weights=weights).x
    out: Ints = t[0] + np.rint(level + room).astype(np.int64)
    return out


def filled(times: Ints, keep: Mask, at: Ints, pace: int) -> Ints:
    """Return times (n,) [ns] in which all times outside the mask `keep` are replaced.

    Replaced times are interpolated over `at` (n,). Before the first and after the last kept time they are
    extrapolated with the slope `pace`.
    """
    known = np.flatnonzero(keep)
    first, last = known[0], known[-1]
    x, lost = at - at[first], np.flatnonzero(~keep)
    out: Ints = times.copy()
    between = np.interp(x[lost], x[known], times[known] - times[first])
    out[lost] = times[first] + np.rint(between).astype(np.int64)
    out[:first] = times[first] + pace * (at[:first] - at[first])
    out[last + 1 :] = times[last] + pace * (at[last + 1 :] - at[last])
    return out


def _evenly_filled(times: Ints, keep: Mask) -> Ints:
    """Return times (n,) in which times outside the mask `keep` are replaced by evenly spaced ones.

    At both ends of the series the spacing is the median period.
    """
    period = int(np.median(np.diff(times[keep]))) if keep.sum() > 1 else 0
    return filled(times, keep, np.arange(len(times)), period)


def _gap_in_file(times: Ints, keep: Mask, wrong: Ints) -> bool:
    """Return whether most messages with indices `wrong` have wrong times; if not, they were written late.

    For a wrong time, the gap in the kept times is larger at the message's place in the file than at its time.
    """
    known, kept = np.flatnonzero(keep), times[keep]
    after = np.searchsorted(known, wrong)
    inner = (after > 0) & (after < len(known))
    if not inner.any():
        return False
    wrong, after = wrong[inner], after[inner]
    between = known[after] - known[after - 1]  # number of steps from the kept neighbour before to the one after
    in_file: Array = (kept[after] - kept[after - 1]) / between
    by_time = np.clip(np.searchsorted(kept, times[wrong]), 1, len(kept) - 1)
    in_time: Array = (kept[by_time] - kept[by_time - 1]) / 2.0
    return bool(2 * np.count_nonzero(in_file > in_time) > len(wrong))


# --- The stamps to trust: the never-decreasing subsequence of greatest weight


def never_decreasing(values: Ints, weights: Array) -> Mask:
    """Return the mask (n,) of the never-decreasing subsequence of `values` with the largest sum of `weights` > 0.

    The values are split into blocks; no value of a block is above any value of the next one. Ordered values are
    blocks of length one, so only disordered parts are searched.
    """
    keep = np.ones(len(values), bool)
    if len(values) < 2:
        return keep
    highest = np.maximum.accumulate(values)[:-1]
    lowest = np.minimum.accumulate(values[::-1])[::-1][1:]
    edges = np.concatenate(([0], np.flatnonzero(highest <= lowest) + 1, [len(values)]))
    for i in np.flatnonzero(np.diff(edges) > 1).tolist():
        block = slice(int(edges[i]), int(edges[i + 1]))
        keep[block] = _heaviest(values[block], weights[block])
    return keep


def _heaviest(values: Ints, weights: Array) -> Mask:
    """Return the mask (n,) of the never-decreasing subsequence of a block with the largest weight, in O(n log n).

    `series` has the candidate subsequences, sorted by last value and by weight. A candidate with a higher last
    value but a lower weight than another one is removed, since it cannot become part of the best.
    """
    last_values: list[int] = []
    series: list[tuple[float, int]] = []  # weight, last element
    before: list[int] = []  # element -> previous element of its best subsequence, -1: none
    for i, (value, weight) in enumerate(zip(values.tolist(), weights.tolist(), strict=True)):
        at = bisect_right(last_values, value)
        so_far, previous = series[at - 1] if at else (0.0, -1)
        before.append(previous)
        longer, end = (so_far + weight, i), at
        while end < len(series) and series[end] < longer:
            end += 1
        last_values[at:end], series[at:end] = [value], [longer]
    keep = np.zeros(len(values), bool)
    i = series[-1][1]
    while i >= 0:
        keep[i] = True
        i = before[i]
    return keep
