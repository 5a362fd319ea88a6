"""Choice of the times of a stream's rows: header stamps, checked against the recording order.

In real logs, stamps run backwards, repeat, are zero or absurd. The recording order is taken as true. A stamp that
contradicts it is replaced: its time is interpolated between trusted stamps by recording time. If several messages
have one recording time, stamps get the smallest changes that put them in order (isotonic regression).

In a simulation, and in a log that was replayed and recorded again, stamps and recording use different clocks. The
recording times of messages without stamps are then converted to the clock of the other topics' stamps.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import msgspec
import numpy as np
from msgspec import field
from msgspec.structs import replace
from numpy.typing import NDArray

from locfuse.fusion.data import ArrayStream, Ints, LocfuseError

from . import jitter

ORDERS = ("auto", "stamp", "recorded")
NS_PER_MS = 10**6
# ns. If a step of the stamps differs from the step of the recording times by more than JUMP_NS, the clock of the
# stamps has changed. A difference from STEP_NS to JUMP_NS means this only if messages were recorded evenly: a
# recorder that waits causes such a difference too
JUMP_NS, STEP_NS, MIN_EVEN_STEPS = 10 * 10**9, 10**9, 10
# ns, messages: a smaller difference counts if it stays over so many messages before and after it
LASTING_NS, LASTING_MESSAGES = 250 * NS_PER_MS, 20
MIN_PIECE_SHARE = 0.25  # share of messages; a smaller piece on the recording's clock is not preferred
MAX_DELAY_S = 1.0  # a larger difference of stamp and recording time means two clocks, not a delay
# small message types with headers that most logs have; their stamps show which clock is used
SMALL_TYPES = (
    "nav_msgs/msg/Odometry",
    "sensor_msgs/msg/JointState",
    "sensor_msgs/msg/Imu",
    "sensor_msgs/msg/LaserScan",
)
MIN_MESSAGES, MAX_TOPICS = 20, 3
SAME_CLOCK_NS = 10**9  # topics use one clock if their stamps' offsets from recording differ by less

Mask = NDArray[np.bool_]
Others = Callable[[], tuple[Ints, Ints] | None]  # the result of common_clock


class RowTimes(msgspec.Struct, frozen=True):
    """The chosen times of a stream's rows, and their source."""

    t_ns: Ints  # (n,) never decreasing
    rows: Ints | None  # (n,) index of each row's message in recording order; None: 0 .. n - 1
    words: str  # description of the choice
    by_stamps: bool = False  # whether the times are header stamps, perhaps sorted or repaired
    repaired: dict[str, int] = field(default_factory=dict)  # reason -> stamps replaced
    dropped: dict[str, int] = field(default_factory=dict)  # reason -> messages without a usable time
    notes: tuple[str, ...] = ()
    on_stamps: bool = False  # whether recording times were converted to the clock of other topics' stamps

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
    clock = _settled(log_time, stamp, order)
    if clock.by_stamps or order != "auto" or (known := others()) is None:
        return clock
    return on_clock(clock, known)


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
    bad = _untrusted(log_time, stamp)
    trusted = ~np.any([*bad.values()], axis=0)
    if order == "recorded":
        return _recorded(log_time, stamp, trusted, "recording order, as asked for")
    if trusted.all():
        return RowTimes(stamp, None, "header stamps", by_stamps=True, notes=_differ(log_time, stamp))
    if 2 * trusted.sum() < len(stamp):
        return _recorded(log_time, stamp, trusted, "recording order: most header stamps contradict it")
    return _repaired(log_time, stamp, trusted, bad)


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
    times = np.maximum.accumulate(jitter.filled(stamp, trusted, log_time, 1))
    how = "dated by recording time instead"
    if (np.diff(times)[np.diff(stamp) != 0] == 0).any():  # equal recording times: only the order is known
        ordered = trusted | bad["backwards"] | bad["off the beat"]
        times, how = jitter.in_order(jitter.filled(stamp, ordered, log_time, 1)), "moved into their order"
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
    weights, _ = jitter.credibility(stamp)
    backwards = ~jitter.never_decreasing(stamp, jitter.cauchy(deviations) * weights)
    recorded, _ = jitter.credibility(log_time)
    steady = (weights < recorded) & ~_in_bursts(log_time)
    return backwards, steady & (deviations > jitter.MIN_OFF_DEVIATIONS) & ~backwards


def _in_bursts(log_time: Ints) -> Mask:
    """Return the mask (n,) of messages that were recorded in quick succession, such as after a stall.

    Their recording times are unreliable.
    """
    steps = np.diff(log_time)
    close = steps < 0.25 * np.median(steps) if len(steps) else np.zeros(0, bool)
    marked = np.zeros(len(log_time), bool)
    marked[1:] |= close
    marked[:-1] |= close
    return marked


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
    return (f"header stamps and log times differ by {delay:.3f} s (median): two clocks; header stamps are used",)


def stamped_topics(types: Mapping[str, str], counts: Mapping[str, int]) -> list[str]:
    """Return up to MAX_TOPICS topics of small messages with headers, to find the clock of the stamps."""
    found = [t for kind in SMALL_TYPES for t in sorted(types) if types[t] == kind and counts[t] >= MIN_MESSAGES]
    return found[:MAX_TOPICS]


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
