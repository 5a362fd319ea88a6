"""What the stamps of a log's topics say: repaired, of two clocks, or of a clock that the wheels do not share."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from locfuse.cli.analysis.topics import Choice
from locfuse.formats.logs.clock import ON_STAMPS
from locfuse.fusion.checks.finding import Finding
from locfuse.fusion.robot import Robot
from locfuse.fusion.sensors.registry import REGISTRY

from .topics import OTHER_CLOCK_S, TopicFacts

MIN_MESSAGES = 5  # messages from which a clock is judged


def of_stamps(facts: Sequence[TopicFacts], choice: Choice, robot: Robot) -> list[Finding]:
    """Say which times were taken, of the topics that are read, where it is not simply the header's."""
    known = {f.topic: f for f in facts if f.count >= MIN_MESSAGES and f.problem is None}
    used = {t: (role, known[t]) for role in choice.topics for t in choice.of(role) if t in known}
    found = [
        Finding(role, "stamps", f"{topic}: {f.clock}")
        for topic, (role, f) in used.items()
        if f.delay_s is not None and not f.as_stamped
    ]
    apart = _other_clocks(known, choice, robot)
    if not apart and any(_beside(f) for _, f in used.values()):
        seconds = max((_beside(f) for _, f in used.values()), key=abs)
        words = f"header stamps and log times are {abs(seconds):.1f} s apart: two clocks; header stamps are used"
        found.append(Finding("log", "two clocks", words))
    return [*found, *apart]


def _beside(f: TopicFacts) -> float:
    """Return by how much a topic's times are before those of the recording, 0 for an ordinary delay [s]."""
    return f.delay_s if f.delay_s is not None and abs(f.delay_s) > OTHER_CLOCK_S and f.by_stamps else 0.0


def _other_clocks(known: Mapping[str, TopicFacts], choice: Choice, robot: Robot) -> list[Finding]:
    """Streams whose stamps are of another clock than the wheels': when they were recorded tells how far off."""
    found = []
    wheels = known.get(choice.topics.get("wheels", ""))
    for role, topic in choice.topics.items() if wheels is not None else ():
        f = known.get(topic)
        if f is not None and ON_STAMPS in (f.clock, wheels.clock if wheels is not None else ""):
            continue  # dated on the clock that the stamps are of
        if wheels is None or f is None or abs(off := _beside(f) - _beside(wheels)) <= OTHER_CLOCK_S:
            continue
        settings = robot.truth if role == "truth" else robot.settings(role) if role in REGISTRY else None
        if settings is not None and abs(off - settings.time_offset) > OTHER_CLOCK_S:
            side = "before" if off > 0 else "after"
            words = f"{topic} is stamped {abs(off):.1f} s {side} the wheels, but was recorded with them"
            found.append(Finding(role, "other clock", words, (f"{role}.time_offset={off:.3f}",), True))
    return found
