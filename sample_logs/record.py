"""Output of a simulated drive to a log file, or to columns in memory."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import tomli_w

from locfuse.formats.container.mcap_write import LogWriter, log_writer
from locfuse.fusion.data import ArrayStream, Column, Ints, Ragged

from .load import dumps
from .messages import Emit, Estimator, RawMessage
from .scenario import Scenario
from .simulate import Outcome, Simulation

# Tables of robot.toml -> localisation; None: steer by the truth.
Localise = Callable[[dict[str, dict[str, Any]]], Estimator | None]


def on_truth(robot_tables: dict[str, dict[str, Any]]) -> None:
    """Return None in place of an estimator: the robot then steers by its true pose."""


def write_log(scenario: Scenario, seed: int, localise: Localise, path: Path) -> Outcome:
    """Simulate a drive into an MCAP log, with robot.toml and the scenario as attachments."""
    simulation = Simulation(scenario, seed)
    tables = simulation.robot_tables
    with log_writer(path) as log:
        log.attach("robot.toml", tomli_w.dumps(tables).encode())
        log.attach("scenario.toml", dumps(msgspec.structs.replace(scenario, seed=seed)).encode())
        return simulation.run(localise(tables), to_log(log))


def to_log(log: LogWriter) -> Emit:
    """Return a function that writes messages to a log."""

    def emit(m: RawMessage) -> None:
        log.write(
            m.topic,
            m.msgtype,
            m.fields,
            m.log_ns,
            stamp_ns=m.stamp_ns,
            frame_id=m.frame_id,
            latched=m.topic == "/tf_static",
        )

    return emit


def in_memory(
    scenario: Scenario, seed: int, localise: Localise = on_truth
) -> tuple[dict[str, ArrayStream], dict[str, dict[str, Any]], Outcome]:
    """Simulate a drive in memory; return streams by topic, the tables of robot.toml, and the outcome."""
    simulation = Simulation(scenario, seed)
    tables = simulation.robot_tables
    messages = defaultdict[str, list[RawMessage]](list)
    outcome = simulation.run(localise(tables), lambda message: messages[message.topic].append(message))
    return {topic: stream_of(some) for topic, some in messages.items()}, tables, outcome


def stream_of(messages: list[RawMessage]) -> ArrayStream:
    """Convert the messages of one topic to a stream; drop each message with a stamp earlier than one before it."""
    stamps: Ints = np.array([m.stamp_ns for m in messages], np.int64)
    in_order = stamps >= np.maximum.accumulate(stamps)
    kept = [m for m, keep in zip(messages, in_order.tolist(), strict=True) if keep]
    first = messages[0]
    return ArrayStream(
        topic=first.topic,
        msgtype=first.msgtype,
        t_ns=stamps[in_order],
        data={name: _column([m.fields[name] for m in kept]) for name in first.fields},
        frame_id=first.frame_id,
        dropped={} if in_order.all() else {"stamp runs backwards": int((~in_order).sum())},
    )


def _column(values: list[Any]) -> Column:
    if isinstance(values[0], np.ndarray):
        first = np.concatenate(([0], np.cumsum([len(v) for v in values])))
        return Ragged(np.concatenate(values), first)
    if isinstance(values[0], int | float):
        return np.array(values)
    return values
