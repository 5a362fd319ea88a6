"""Shell completion: sample logs, sensors, keys of robot.toml, topics of the log."""

from __future__ import annotations

import contextlib
import os
import shlex

import click
from click.shell_completion import CompletionItem


def logs(context: click.Context, parameter: click.Parameter, begun: str) -> list[CompletionItem]:
    """Complete a log: names of sample logs, and files."""
    from locfuse.sample_logs import names

    samples = [CompletionItem(name, help="sample log") for name in names() if name.startswith(begun)]
    return [*samples, CompletionItem(begun, type="file")]


def sensors(context: click.Context, parameter: click.Parameter, begun: str) -> list[CompletionItem]:
    """Complete a sensor name, also after a comma."""
    from locfuse.fusion.sensors.registry import REGISTRY

    before, comma, word = begun.rpartition(",")
    known = REGISTRY if comma else ("odometry", "all", *REGISTRY)
    taken = set(before.split(","))
    return [CompletionItem(f"{before}{comma}{s}") for s in known if s.startswith(word) and s not in taken]


def settings(context: click.Context, parameter: click.Parameter, begun: str) -> list[CompletionItem]:
    """Complete a key of robot.toml, with its unit; after TABLE.topic= a topic of the typed log."""
    from msgspec.structs import fields

    from locfuse.cli.analysis.robot_tables import table_types
    from locfuse.formats.robot import units

    key, equals, word = begun.partition("=")
    if equals:
        found = topics(context) if key.rpartition(".")[2].endswith("topic") else []
        return [CompletionItem(f"{key}={topic}") for topic in found if topic.startswith(word)]
    every = ((table, f.encode_name) for table, kind in table_types().items() for f in fields(kind))
    fits = [(table, name) for table, name in every if f"{table}.{name}".startswith(begun)]
    return [CompletionItem(f"{table}.{name}=", help=units.of(table, name)) for table, name in fits]


def topics(context: click.Context) -> list[str]:
    """Return the topics of the log on the command line; [] if it cannot be opened."""
    from locfuse.cli.analysis.load import find_log
    from locfuse.formats.logs.log import open_log
    from locfuse.fusion.data import LocfuseError

    # click stops parsing at an option without a value, perhaps before LOG: then use the shell's words
    typed = context.params.get("log") or shlex.split(os.environ.get("COMP_WORDS", ""))[2:]
    for word in typed:
        with contextlib.suppress(LocfuseError, OSError):
            return sorted(open_log(find_log([word])).topics)
    return []
