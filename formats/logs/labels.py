"""Fault labels in a log: texts on /faults, which `locfuse simulate` writes."""

from __future__ import annotations

from typing import Any

import msgspec

from locfuse.formats.visible import visible
from locfuse.fusion.data import FAULT, Drive, Event

from .log import Log

TOPIC, MSGTYPE = "/faults", "std_msgs/msg/String"
MAX_WORDS = 120  # characters shown of a label
TIMES = ("event", "start", "end")


def labels(log: Log, drive: Drive, order: str) -> list[Event]:
    """Return the labelled faults of a log, clipped to the drive; [] without the topic /faults."""
    info = log.topics.get(TOPIC)
    if info is None or info.msgtype != MSGTYPE:
        return []
    stream = log.stream(TOPIC, order=order)
    texts = stream.columns("data")["data"]
    assert isinstance(texts, list)
    end = float(drive.t[-1])
    t = ((stream.t_ns - drive.epoch_ns) * 1e-9).tolist()
    begun: dict[str, float] = {}
    found: list[Event] = []
    for at, text in zip(t, texts, strict=True):
        event, words = _parse_label(str(text))
        if event == "begin":
            begun[words] = at
        else:
            start = begun.pop(words, 0.0 if event == "end" else at)
            found.append(Event(max(start, 0.0), min(at, end), FAULT, words))
    # a fault without an end label lasts to the end of the drive
    found += [Event(max(at, 0.0), end, FAULT, words) for words, at in begun.items()]
    return sorted(e for e in found if e.start <= end and e.end >= 0.0)


def _parse_label(text: str) -> tuple[str, str]:
    """Return (event, words) of a label; the event is "begin", "end" or "" (neither)."""
    try:
        table = msgspec.json.decode(text, type=dict[str, Any])
    except msgspec.DecodeError:
        return "", visible(text[:MAX_WORDS])
    kind, sensor = table.get("kind", "fault"), table.get("sensor", "")
    values = {k: v for k, v in table.items() if k not in (*TIMES, "kind", "sensor")}
    more = [f"{key} {value}" for key, value in values.items() if isinstance(value, int | float | str)]
    words = " ".join(str(part) for part in (sensor, kind, f"({', '.join(more)})" if more else "") if part)
    return str(table.get("event", "")), visible(words[:MAX_WORDS])
