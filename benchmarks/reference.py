"""The reference pages of docs/ are made from the code: --help of every command, the settings, the report's keys.

python -m benchmarks.reference           exit 1 where a page differs from the code of today
python -m benchmarks.reference --write   write the pages
"""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import click

from locfuse.cli.analysis.robot_tables import table_types
from locfuse.cli.inspect.json_schema import SCHEMAS, robot_schema
from locfuse.cli.main import COMMANDS, locfuse
from locfuse.cli.terminal.options import HELP_ALL
from locfuse.fusion.sensors.registry import REGISTRY

DOCS = Path(__file__).parent.parent / "docs"
MADE = "Made from the code by `python -m benchmarks.reference --write`; do not edit.\n"
WIDTH = 100
FIRST_KEYS = (  # of robot.toml: what users set first
    "wheels.topic",
    "wheels.radius",
    "wheels.track",
    "wheels.ticks_per_revolution",
    "wheels.noise",
    "wheels.time_offset",
    "start.x",
    "start.y",
    "start.theta_deg",
    "truth.topic",
    "truth.sigma",
    "lrf.topic",
    "lrf.x",
    "lrf.y",
    "lrf.yaw_deg",
    "lrf.time_offset",
    "lrf.sigma_range",
    "lrf.map",
    "compass.sigma_deg",
    "camera.landmark",
)
Schema = dict[str, Any]


def commands_page() -> str:
    """Return the page of all commands, as --help prints them."""
    parts = ["# Commands", MADE, "```text", _help(locfuse, "locfuse"), "```"]
    for name in COMMANDS:
        with click.Context(locfuse) as context:
            command = locfuse.get_command(context, name)
        assert command is not None
        parts += [f"\n## {name}\n", "```text", _help(command, f"locfuse {name}"), "```"]
    return "\n".join(parts) + "\n"


def _help(command: click.Command, name: str) -> str:
    context = click.Context(command, info_name=name, max_content_width=WIDTH, terminal_width=WIDTH)
    context.meta[HELP_ALL] = True
    return command.get_help(context)


def settings_page() -> str:
    """Return the page of all sensors and all keys of robot.toml."""
    schema = robot_schema()
    head = (
        "A key that is left out has its default. SI units; angles in degrees where a key ends in `_deg`. "
        "An editor completes these keys after `locfuse schema robot > robot.schema.json`."
    )
    parts = ["# Sensors and settings", MADE, head, "\n## Set first\n", *_first(schema)]
    for name, kind in table_types().items():
        parts += [f"\n## {name}\n", *_of_sensor(name), *_table(schema, schema["$defs"][kind.__name__])]
    return "\n".join(parts) + "\n"


def _first(schema: Schema) -> Iterator[str]:
    """Yield the table of the keys that most robots need, in the order in which people need them."""
    yield "| key | type | default | meaning |"
    yield "|---|---|---|---|"
    types = table_types()
    for path in FIRST_KEYS:
        table, key = path.split(".")
        yield _row(path, schema["$defs"][types[table].__name__]["properties"][key])


def _of_sensor(name: str) -> Iterator[str]:
    """Yield what a sensor reads and measures; nothing of the robot's own tables."""
    if name not in REGISTRY:
        return
    sensor = REGISTRY[name]
    yield f"Reads {', '.join(f'`{kind}`' for kind in sensor.reads)}."
    measured = ", ".join(f"{part.name} [{part.unit}]" for part in sensor.components)
    yield f"Measures {measured}."
    for other, why in sensor.needs.items():
        yield f"Needs {other}: {why}."
    yield ""


def report_page() -> str:
    """Return the page of the keys of report.json."""
    schema = SCHEMAS["report"]()
    head = (
        "`report.json` of `locfuse compare`, `run.json` of `locfuse run`. A report may hold more keys; "
        "`schema_version` grows when one of these changes its meaning. As JSON Schema: `locfuse schema report`."
    )
    parts = ["# Keys of report.json", MADE, head]
    first = schema["$ref"].rpartition("/")[2]
    for name in (first, *(n for n in schema["$defs"] if n != first)):
        definition = schema["$defs"][name]
        parts += [f"\n## {name}\n", definition.get("description", ""), "", *_table(schema, definition)]
    return "\n".join(parts) + "\n"


def _table(schema: Schema, definition: Schema) -> Iterator[str]:
    yield "| key | type | default | meaning |"
    yield "|---|---|---|---|"
    for key, part in definition["properties"].items():
        yield _row(key, part)


def _row(key: str, part: Schema) -> str:
    default = f"`{json.dumps(part['default'])}`" if "default" in part else ""
    words = part.get("description", "").replace("|", "\\|")
    return f"| `{key}` | {_type(part)} | {default} | {words} |"


def _type(part: Schema) -> str:
    """Return a type in words."""
    if "$ref" in part:
        name = part["$ref"].rpartition("/")[2]
        return f"[{name}](#{name.lower()})"
    if "enum" in part:
        return ", ".join(f"`{value}`" for value in part["enum"])
    if "anyOf" in part:
        return " or ".join(_type(kind) for kind in part["anyOf"])
    kind = str(part.get("type", "any"))
    if kind == "array" and isinstance(part.get("items"), dict):
        n = part.get("minItems")
        return f"{n if n and n == part.get('maxItems') else 'list of'} {_type(part['items'])}s"
    if kind == "object" and isinstance(part.get("additionalProperties"), dict):
        return f"table of {_type(part['additionalProperties'])}"
    return kind


PAGES = {"commands.md": commands_page, "settings.md": settings_page, "report_keys.md": report_page}


def main(write: bool) -> int:
    """Check or write all pages."""
    wrong = 0
    for name, page in PAGES.items():
        path, now = DOCS / name, page()
        if write:
            path.write_text(now, encoding="utf-8")
        elif not path.exists() or path.read_text(encoding="utf-8") != now:
            wrong += 1
            print(f"docs/{name} is not what the code says today: python -m benchmarks.reference --write")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main("--write" in sys.argv))
