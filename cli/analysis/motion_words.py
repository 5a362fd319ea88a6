"""Notes on the motion source in a report: void figures, and wheels that could not be used."""

from __future__ import annotations

import shlex
from typing import Any

from locfuse.fusion.wheels.odometry import BODY_READS

from .errors import has_scipy
from .load import Loaded
from .motion_evidence import Evidence
from .refused_motion import void_all
from .results import log_words
from .robot_tables import flat
from .wheel_topics import steers, unused_words

MIN_COVERED_SHARE = 0.8  # of the log's time: a motion that covers less is said to


def say_motion(report: dict[str, Any], loaded: Loaded, judged: bool = False) -> None:
    """Add warnings on the motion to a report, to be read before any figure.

    Where it is `judged`, encoders are compared with the matching of the scans beside them.
    """
    void_all(report, loaded.spoils)
    if judged and (words := _behind_scans(loaded)):
        report["notes"].append(f"wheels: {words}")
    first = [note.words for note in loaded.choice.notes if note.first]
    for words in filter(None, (*first, _part(loaded))):
        report["headline"] = f"{words[0].upper()}{words[1:]}. {report['headline']}"
    if words := unused_words(loaded.choice):
        typed = (f"{key}={flat(loaded.tables)[key]}" for key, who in loaded.sources.items() if who == "--set")
        sets = (word for setting in typed for word in ("--set", setting))
        log = log_words(loaded.log, as_given=True)
        command = shlex.join(("locfuse", "init", *log, *sets, "-o", "robot.toml"))
        does = "finds them by the truth" if steers(loaded.choice.unused_wheels) else "asks for them"
        report["headline"] = f"{words}: `{command}` {does}. {report['headline']}"


def _behind_scans(loaded: Loaded) -> str:
    """Return a warning if scan matching fits the laser better than the encoders do; "" if it does not."""
    topics, lasers = loaded.choice.of("wheels"), loaded.choice.of("lrf")
    encoders = loaded.log.topics[topics[0]].msgtype not in BODY_READS
    if not encoders or len(lasers) != 1 or loaded.reading is None or not has_scipy():
        return ""
    return Evidence(loaded.log, loaded.robot, lasers[0], {}).behind(topics, loaded.reading)


def _part(loaded: Loaded) -> str:
    """Return a warning if the motion covers only a part of the log; "" if it covers most of it."""
    span, t = loaded.log.time_span_ns, loaded.drive.wheels.t
    if span is None or loaded.window != (None, None):
        return ""
    covered, whole = float(t[-1] - t[0]), (span[1] - span[0]) * 1e-9
    if covered >= MIN_COVERED_SHARE * whole:
        return ""
    topics = " and ".join(loaded.choice.of("wheels"))
    return f"The motion by {topics} covers {covered:.1f} s of the {whole:.1f} s of this log"
