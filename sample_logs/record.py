"""Outputs of a simulated drive: a log file, or columns in memory."""

from __future__ import annotations

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

# From the robot's tables to its localisation; None steers on the truth.
Localise = Callable[[dict[str, dict[str, Any]]], Estimator | None]


def on_truth(robot_tables: dict[str, dict[str, Any]]) -> None:
    """Let the robot steer on the truth, as if its localisation were perfect."""


def write_log(scenario: Scenario, seed: int, localise: Localise, path: Path) -> Outcome:
    """Drive the scenario into an MCAP log, with robot.toml and the scenario itself as attachments."""
    simulation = Simulation(scenario, seed)
    tables = simulation.robot_tables
    with log_writer(path) as log:
        log.attach("robot.toml", tomli_w.dumps(tables).encode())
        log.attach("scenario.toml", dumps(msgspec.structs.replace(scenario, seed=seed)).encode())
        return simulation.run(localise(tables), to_log(log))


def to_log(log: LogWriter) -> Emit:
    """Return a function that writes every message to a log."""

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
    """Drive the scenario into columns: streams by topic, the robot's tables, and the truth. No file is touched."""
    simulation = Simulation(scenario, seed)
    tables = simulation.robot_tables
    columns = Columns()
    outcome = simulation.run(localise(tables), columns.emit)
    return columns.streams(), tables, outcome


class Columns:
    """Collects raw messages and turns them into one stream per topic."""

    def __init__(self) -> None:
        self._messages: dict[str, list[RawMessage]] = {}

    def emit(self, message: RawMessage) -> None:
        """Keep one message, in the order of its topic."""
        self._messages.setdefault(message.topic, []).append(message)

    def streams(self) -> dict[str, ArrayStream]:
        """Return the streams; a message dated before its predecessor is dropped and counted."""
        return {topic: _stream(messages) for topic, messages in self._messages.items()}


def _stream(messages: list[RawMessage]) -> ArrayStream:
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
