"""Questions to the person at the terminal: values of robot.toml that are in no log.

Nothing is asked where stdin or stderr is a file or a pipe: scripts and CI run as before.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from typing import NamedTuple

import click

from locfuse.cli.analysis.robot_tables import make_robot
from locfuse.formats.robot import robot_toml
from locfuse.fusion.data import LocfuseError

from .screen import say

LONGEST_UNIT = 24  # "[latitude, longitude]"


class Question(NamedTuple):
    """A key of robot.toml, and "unit: how to find its value" as `init` writes it beside the key."""

    key: str  # "table.key"
    words: str


def somebody_is_there() -> bool:
    """Return whether a person can be asked: keyboard and screen are a terminal."""
    return sys.stdin.isatty() and sys.stderr.isatty()


def answers(questions: Sequence[Question]) -> tuple[str, ...]:
    """Ask each question until its answer fits or is empty; return the answers as "table.key=value"."""
    if questions:
        say("No log can tell these values. Enter leaves one blank.", err=True)
    found = [f"{q.key}={answer}" for q in questions if (answer := _answer(q))]
    return tuple(found)


def _answer(question: Question) -> str:
    unit, _, how = question.words.partition(": ")
    named = how and len(unit) <= LONGEST_UNIT
    say(f"{question.key} [{unit}]: {how}" if named else f"{question.key}: {question.words}", err=True)
    while True:
        answer = str(click.prompt("  value", default="", show_default=False, err=True)).strip()
        try:
            if answer:
                make_robot(robot_toml.apply_sets([f"{question.key}={answer}"]))
        except LocfuseError as problem:
            say(f"  {problem}", err=True)
        else:
            return answer
