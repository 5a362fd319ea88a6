"""Facts of each topic for `locfuse info`: rate, gaps, clock, frame; and findings on stamps."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from typing import Any

import msgspec
import numpy as np

from locfuse.cli.analysis.topics import Choice
from locfuse.formats.logs.clock import RowTimes
from locfuse.formats.logs.log import Log, UnreadableTopicError
from locfuse.fusion.checks.examine import gaps
from locfuse.fusion.checks.finding import Finding
from locfuse.fusion.checks.raw_data import PUBLISHERS
from locfuse.fusion.data import LocfuseError
from locfuse.fusion.robot import Robot
from locfuse.fusion.sensors.registry import REGISTRY
from locfuse.fusion.streams import MAX_DELAY_S, seconds

MAX_GAPS_LISTED = 20  # in JSON
MIN_MESSAGES = 3  # for a rate
MIN_JUDGED = 5  # messages, for a finding on the clock


class TopicFacts(msgspec.Struct, frozen=True):
    """Facts of one topic."""

    topic: str
    msgtype: str
    count: int
    frame_id: str = ""
    rate_hz: float | None = None
    period_s: float | None = None  # median
    gaps: tuple[tuple[float, float], ...] = ()  # (start, end) [s] since the log began
    clock: RowTimes | None = None  # source of the topic's times
    delay_s: float | None = None  # recording time - header stamp, median
    dropped: dict[str, int] | None = None
    problem: str | None = None  # why it cannot be read
    derived: bool = False  # made from another topic or a file, without messages in the log

    @property
    def beside_s(self) -> float:
        """Recording time - header stamp [s] if the difference is so large that it shows two clocks; else 0."""
        stamped = self.clock is not None and self.clock.by_stamps
        return self.delay_s if self.delay_s and abs(self.delay_s) > MAX_DELAY_S and stamped else 0.0

    def values(self) -> dict[str, Any]:
        """Return the facts as plain values for report and JSON."""
        return {
            "type": self.msgtype,
            "messages": self.count,
            "frame": self.frame_id or None,
            "rate_hz": self.rate_hz,
            "period_s": self.period_s,
            "gaps": [list(g) for g in self.gaps[:MAX_GAPS_LISTED]],
            "longest_gap_s": max((b - a for a, b in self.gaps), default=None),
            "clock": self.clock.words if self.clock else None,
            "delay_s": self.delay_s,
            "stamps_repaired": dict(self.clock.repaired) if self.clock else {},
            "dropped": self.dropped or {},
            "problem": self.problem,
        }


def clock_word(f: TopicFacts) -> str:
    """Return the clock of a topic in short: "12 ms late" (stamps), "repaired", "recorded", "two clocks"."""
    if f.clock is None or f.delay_s is None:
        return "no stamps" if f.count else ""
    if f.clock.repaired:
        return "repaired"
    if not f.clock.by_stamps:
        return "recorded"
    return f"{f.delay_s * 1e3:.0f} ms late" if abs(f.delay_s) < MAX_DELAY_S else "two clocks"


def topic_facts(log: Log, order: str) -> list[TopicFacts]:
    """Return the facts of all recorded topics, sorted by name; only headers are read."""
    readable = [name for name, topic in log.topics.items() if topic.problem is None and topic.count]
    with suppress(LocfuseError):  # an unreadable topic is reported by `_facts`
        log.streams(dict.fromkeys(readable, ()), order=order)
    return [_facts(log, name, order) for name in sorted(log.topics) if log.recorded(name)]


def derived_facts(log: Log, order: str) -> list[TopicFacts]:
    """Return the facts of derived topics: two frames of /tf, one number of a message, or a file."""
    return [_facts(log, name, order) for name in sorted(log.topics) if not log.recorded(name)]


def _facts(log: Log, name: str, order: str) -> TopicFacts:
    topic = log.topics[name]
    if topic.problem is not None or not topic.count:
        return TopicFacts(name, topic.msgtype, topic.count, problem=topic.problem)
    try:
        stream = log.stream(name, order)
        t_ns = stream.t_ns
    except LocfuseError as e:
        problem = e.problem if isinstance(e, UnreadableTopicError) else str(e)
        return TopicFacts(name, topic.msgtype, topic.count, problem=problem)
    begin = (log.time_span_ns or (0, 0))[0]
    t = seconds(t_ns, begin)
    dt = np.diff(t)
    moving = dt[dt > 0]
    return TopicFacts(
        topic=name,
        msgtype=topic.msgtype,
        count=topic.count,
        frame_id=stream.frame_id,
        rate_hz=float((len(t) - 1) / (t[-1] - t[0])) if len(t) >= MIN_MESSAGES and t[-1] > t[0] else None,
        period_s=float(np.median(moving)) if len(moving) else None,
        gaps=tuple(gaps(t)),
        clock=stream.clock,
        delay_s=stream.delay_s,
        dropped=dict(stream.dropped),
        derived=not log.recorded(name),
    )


def of_publishers(log: Log, choice: Choice) -> list[Finding]:
    """Return a finding for each used topic with messages of two publishers."""
    found = []
    for role in choice.topics:
        for topic in choice.of(role):
            if counts := log.in_turn(topic):
                n = " and ".join(map(str, counts))
                words = f"{topic} mixes two publishers ({n} messages in turn); record each on a topic of its own"
                found.append(Finding(role, PUBLISHERS, words, severe=True))
    return found


def of_stamps(facts: Sequence[TopicFacts], choice: Choice, robot: Robot) -> list[Finding]:
    """Return findings on used topics whose times are not their header stamps, or whose clocks differ."""
    known = {f.topic: f for f in facts if f.count >= MIN_JUDGED and f.problem is None}
    used = {t: (role, known[t]) for role in choice.topics for t in choice.of(role) if t in known}
    found = [
        Finding(role, "stamps", f"{topic}: {f.clock.words}")
        for topic, (role, f) in used.items()
        if f.clock is not None and f.delay_s is not None and not f.clock.as_stamped
    ]
    again = ((role, topic, f.clock.again) for topic, (role, f) in used.items() if f.clock is not None)
    found += [Finding(role, "again", f"{topic}: {why}", severe=True) for role, topic, why in again if why]
    apart = _other_clocks(known, choice, robot)
    seconds = max((f.beside_s for _, f in used.values()), key=abs, default=0.0)
    if not apart and seconds:
        words = f"header stamps and log times are {abs(seconds):.1f} s apart: two clocks; header stamps are used"
        found.append(Finding("log", "two clocks", words))
    return [*found, *apart]


def _other_clocks(known: Mapping[str, TopicFacts], choice: Choice, robot: Robot) -> list[Finding]:
    """Return a finding for each topic whose clock differs from the wheels', with the time offset as fix."""
    found: list[Finding] = []
    wheels = known.get(choice.topics.get("wheels", ""))
    if wheels is None:
        return found
    for role, topic in choice.topics.items():
        f = known.get(topic)
        if f is None or any(one.clock is not None and one.clock.on_stamps for one in (f, wheels)):
            continue  # stamps and recording times have the same clock
        off = f.beside_s - wheels.beside_s
        settings = robot.truth if role == "truth" else robot.settings(role) if role in REGISTRY else None
        if abs(off) > MAX_DELAY_S and settings and abs(off - settings.time_offset) > MAX_DELAY_S:
            side = "before" if off > 0 else "after"
            words = f"{topic} is stamped {abs(off):.1f} s {side} the wheels, but was recorded with them"
            found.append(Finding(role, "other clock", words, (f"{role}.time_offset={off:.3f}",), True))
    return found
