"""The key of a result: equal for equal input, settings, configurations and version, so that nothing is run twice.

It is known before a log is opened: settings that the log itself carries are part of its content.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from typing import Any

import msgspec

from locfuse.formats.caps import MAX_ROBOT_TOML
from locfuse.formats.inputs import read_small
from locfuse.formats.log.identity import Identity
from locfuse.formats.report.json_report import SCHEMA_VERSION, made_with
from locfuse.formats.robot import robot_toml

from .configurations import Sensors
from .settings import LogOptions


@dataclass(frozen=True)
class Asked:
    """What is asked of a log beyond its settings."""

    sensors: tuple[str, ...]  # as --sensors names them; none: the default configurations
    all_subsets: bool
    align: str
    smooth: bool

    @classmethod
    def of(cls, sensors: Iterable[Sensors], all_subsets: bool, align: str, smooth: bool) -> Asked:
        """Return it with every configuration as one word."""
        words = tuple(s if isinstance(s, str) else ",".join(s) for s in sensors)
        return cls(words, all_subsets, align, smooth)


def asked_tables(how: LogOptions, more: Sequence[str] = ()) -> dict[str, Any]:
    """Return the settings that --robot, --set and `more` words of --set give, without what the log carries."""
    layers = [robot_toml.parse(read_small(file, MAX_ROBOT_TOML), str(file)) for file in how.robot_files]
    layers.append(robot_toml.apply_sets((*how.sets, *more)))
    given = {"order": how.order, "preset": how.preset, "from": how.begin, "to": how.end}
    return robot_toml.merge(*layers, {name: value for name, value in given.items() if value is not None})


def key(content: Identity, tables: Mapping[str, Any], asked: Asked) -> str:
    """Return the key of a comparison: 64 hexadecimal digits."""
    parts = {
        "content": content._asdict(),
        "settings": tables,
        "asked": asked,
        "locfuse": version("locfuse"),
        "schema_version": SCHEMA_VERSION,
        "made_with": made_with(),
    }
    return hashlib.sha256(msgspec.json.encode(parts, order="deterministic")).hexdigest()
