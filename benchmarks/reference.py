"""Generated pages: reference pages of docs/ from the code; AGENTS.md and llms.txt from other pages.

python -m benchmarks.reference           exit 1 where a page differs from the code of today
python -m benchmarks.reference --write   write the pages
"""

import json
import re
import sys
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import click

from benchmarks.readme import kept
from locfuse.cli.analysis.robot_tables import table_types
from locfuse.cli.inspect.json_schema import SCHEMAS, robot_schema
from locfuse.cli.main import COMMANDS, locfuse
from locfuse.cli.terminal.options import HELP_ALL
from locfuse.fusion.sensors.registry import REGISTRY

ROOT = Path(__file__).resolve().parent.parent
DOCS = ROOT / "docs"
MADE = "Made by `python -m benchmarks.reference --write`; do not edit.\n"
WIDTH = 100
MIN_SHARED = 3  # a key that this many tables have, with the same description, is listed once on the page
FIRST_KEYS = {  # keys of robot.toml that users set first
    "wheels": "topic radius track ticks_per_revolution noise time_offset",
    "start": "x y theta_deg",
    "truth": "topic sigma",
    "lrf": "topic x y yaw_deg time_offset sigma_range map",
    "compass": "sigma_deg",
    "camera": "landmark",
}
ON_THEIR_PAGE = {"camera": "camera.md#setting-one-up"}  # tables whose keys a page explains
HEAD = ("| key | meaning |", "|---|---|")
Schema = dict[str, Any]


def commands_page() -> str:
    """Return the page of all commands with the text of --help; shared options are listed once."""
    parts = [
        "# Commands",
        MADE,
        "`locfuse --help` lists the commands, `locfuse COMMAND --help` the most used options of a command.",
    ]
    with click.Context(locfuse) as root:
        commands = {name: command for name in COMMANDS if (command := locfuse.get_command(root, name))}
    contexts = {name: _context(command, f"locfuse {name}") for name, command in commands.items()}
    of = {
        name: [
            record
            for p in command.get_params(contexts[name])
            if isinstance(p, click.Option) and (record := p.get_help_record(contexts[name]))
        ]
        for name, command in commands.items()
    }
    counts = Counter(record for records in of.values() for record in records)
    shared = [record for record, n in counts.items() if n > 1 and not record[0].startswith("--help")]
    shared.sort(key=lambda record: record[0].lstrip("-"))
    parts += ["\n## Options of several commands\n", "```text", _definitions(shared), "```"]
    for name, command in commands.items():
        context = contexts[name]
        formatter = context.make_formatter()
        command.format_usage(context, formatter)
        command.format_help_text(context, formatter)
        formatter.write("\n" + _definitions([record for record in of[name] if counts[record] == 1]))
        also = [re.findall(r"--[a-z-]+", option)[0] for option, words in of[name] if counts[option, words] > 1]
        also = [option for option in also if option not in {"--help", "--help-all"}]
        if also:
            formatter.write_paragraph()
            formatter.write_text(f"And: {', '.join(also)}")
        parts += [f"\n## {name}\n", "```text", formatter.getvalue(), "```"]
    return re.sub(r"\n{3,}", "\n\n", "\n".join(parts)).replace("\n\n```\n", "\n```\n") + "\n"


def _context(command: click.Command, name: str) -> click.Context:
    context = click.Context(command, info_name=name, max_content_width=WIDTH, terminal_width=WIDTH)
    context.meta[HELP_ALL] = True
    return context


def _definitions(records: Sequence[tuple[str, str]]) -> str:
    formatter = click.HelpFormatter(width=WIDTH, max_width=WIDTH)
    if records:
        formatter.write_dl(records)
    return formatter.getvalue()


def settings_page() -> str:
    schema = robot_schema()
    head = (
        "SI units; degrees where a key ends in `_deg`. A key without a default is found, estimated or not used. "
        "What each sensor reads: [bags.md](bags.md), `locfuse explain lrf`. "
        "An editor completes these keys after `locfuse schema robot > robot.schema.json`."
    )
    parts = ["# Sensors and settings", MADE, head, "\n## Set first\n", *_first(schema)]
    tables = {
        name: [_setting(*item) for item in schema["$defs"][kind.__name__]["properties"].items()]
        for name, kind in table_types().items()
    }
    counts = Counter(row for rows in tables.values() for row in rows)
    shared = [row for row, n in counts.items() if n >= MIN_SHARED]
    parts += ["\n## Keys of several sensors\n", *HEAD, *shared]
    for name, rows in tables.items():
        if name in ON_THEIR_PAGE:
            parts += [f"\n## {name}\n", *_of_sensor(name), f"Its keys: [{name}.md]({ON_THEIR_PAGE[name]})."]
            continue
        own = [row for row in rows if row not in shared]
        also = [row.split("`")[1].split(" = ")[0] for row in rows if row in shared]
        parts += [f"\n## {name}\n", *_of_sensor(name), *HEAD, *own]
        parts += [f"\nAnd {', '.join(f'`{key}`' for key in also)}."] if also else []
    return "\n".join(parts) + "\n"


def _first(schema: Schema) -> Iterator[str]:
    for table, keys in FIRST_KEYS.items():
        assert set(keys.split()) <= schema["$defs"][table_types()[table].__name__]["properties"].keys(), table
        yield f"- [{table}](#{table}): {', '.join(f'`{key}`' for key in keys.split())}"


def _of_sensor(name: str) -> Iterator[str]:
    """Yield lines on a sensor's measurement and required settings; none for other tables."""
    if name not in REGISTRY:
        return
    sensor = REGISTRY[name]
    measured = ", ".join(f"{part.name} [{part.unit}]" for part in sensor.components)
    yield f"Measures {measured}."
    for other, why in sensor.needs.items():
        yield f"Needs {other}: {why}."
    yield ""


def report_page() -> str:
    schema = SCHEMAS["report"]()
    head = (
        "`report.json` of `locfuse compare`, `run.json` of `locfuse run`. A report may hold more keys; "
        "`schema_version` grows when one of these changes its meaning. With all types: `locfuse schema report`."
    )
    parts = ["# Keys of report.json", MADE, head]
    first = schema["$ref"].rpartition("/")[2]
    for name in (first, *(n for n in schema["$defs"] if n != first)):
        definition = schema["$defs"][name]
        parts += [f"\n## {name}\n", definition.get("description", ""), "", *_table(definition)]
    return "\n".join(parts) + "\n"


def _table(definition: Schema) -> Iterator[str]:
    """Yield a table of keys with their meaning, and a line of keys without explanation."""
    yield from HEAD
    plain = []
    for key, part in definition["properties"].items():
        kind = _type(part)
        words = "; ".join(filter(None, (kind if "](" in kind else "", _meaning(part))))
        if words:
            yield f"| `{key}` | {words} |"
        else:
            plain.append(f"`{key}`")
    if plain:
        yield f"\nAnd {', '.join(plain)}."


def _setting(key: str, part: Schema) -> str:
    default = f" = {json.dumps(part['default'])}" if part.get("default") is not None else ""
    choices = _type(part) if "enum" in part else ""
    return f"| `{key}{default}` | {'; '.join(filter(None, (choices, _meaning(part))))} |"


def _meaning(part: Schema) -> str:
    return str(part.get("description", "")).replace("|", "\\|")


def _type(part: Schema) -> str:
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


def agents_page() -> str:
    """Return AGENTS.md: instructions for programs that work on this repository, or with its tools."""
    working, tools = (ROOT / "CONTRIBUTING.md").read_text(), (DOCS / "mcp.md").read_text()
    parts = ["# For agents\n", MADE, f"{_summary()}\n"]
    parts += [_section(working, name) for name in ("Set up", "The house", "Tests, benchmarks, pages", "Habits")]
    parts += ["\n# With its tools\n", _section(tools, "The tools").replace("](", "](docs/")]
    return "\n".join(parts)


def llms_page() -> str:
    """Return llms.txt: every page in a line, with its first sentence."""
    parts = ["# locfuse\n", f"> {_summary()}\n", "## Docs\n"]
    names = re.findall(r"\]\(([^)]+)\)", (DOCS / "README.md").read_text())
    for name in dict.fromkeys(f"docs/{name}" for name in names):
        path = (ROOT / name).resolve()
        title, _, text = path.read_text(encoding="utf-8").partition("\n")
        found = re.search(r"^[A-Z`][^|]*?[.:](?=\s)", text.replace(MADE, ""), re.MULTILINE | re.DOTALL)
        first = re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", " ".join(found[0].split())) if found else ""
        parts.append(f"- [{title.lstrip('# ')}]({path.relative_to(ROOT)}): {first.rstrip(':')}")
    return "\n".join(parts) + "\n"


def _summary() -> str:
    return " ".join((ROOT / "README.md").read_text().split("\n\n")[1].split())


def _section(page: str, name: str) -> str:
    found = re.search(rf"^## {name}\n.*?(?=^## |\Z)", page, re.MULTILINE | re.DOTALL)
    assert found is not None, name
    return found[0].rstrip() + "\n"


PAGES = {
    "docs/commands.md": commands_page,
    "docs/settings.md": settings_page,
    "docs/report_keys.md": report_page,
    "AGENTS.md": agents_page,
    "llms.txt": llms_page,
}


if __name__ == "__main__":
    kept(((ROOT / name, page()) for name, page in PAGES.items()), "--write" in sys.argv)
