"""`locfuse schema`: the JSON Schema of robot.toml, of report.json, or of what --json prints."""

from __future__ import annotations

import click

from locfuse.cli.terminal.screen import put, reader_may_leave


@click.command()
@click.argument("what", type=click.Choice(["robot", "report", "info", "tune", "calibrate"]))
def schema(what: str) -> int:
    """Print the JSON Schema of robot.toml, of report.json, or of what a command prints with --json.

    With the schema beside a robot.toml, an editor completes keys, shows their units, and marks what is wrong:
    the first line that `init` writes names that file. report.json and run.json share one schema.

    \b
    locfuse schema robot > robot.schema.json
    locfuse schema report > report.schema.json
    locfuse schema info > info.schema.json
    """
    import json

    from locfuse.cli.inspect.json_schema import SCHEMAS

    with reader_may_leave():
        put(json.dumps(SCHEMAS[what](), indent=2) + "\n")
    return 0
