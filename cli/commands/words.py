"""`locfuse explain`, `schema` and `completion`: meanings of terms, JSON Schemas, and shell completion."""

from __future__ import annotations

import click
from click.shell_completion import get_completion_class

from locfuse.cli.terminal.screen import put

COMPLETION_VARIABLE = "_LOCFUSE_COMPLETE"  # environment variable set by the shell's completion


@click.command()
@click.argument("term", required=False)
def explain(term: str | None) -> int:
    """Explain TERM of a report, or a sensor; without TERM, list all terms.

    \b
    locfuse explain ANEES
    locfuse explain drift
    """
    from locfuse.formats.report.glossary import GLOSSARY

    lines = [f"{name}: {text}" for name, text in GLOSSARY.items()] if term is None else [meaning(term)]
    put("".join(f"{line}\n" for line in lines))
    return 0


def meaning(term: str) -> str:
    """Return the meaning of a term or sensor, in upper or lower case. Raises UsageError for an unknown word."""
    from locfuse.formats.report.glossary import explained, similar
    from locfuse.fusion.data import UsageError
    from locfuse.fusion.sensors.registry import REGISTRY

    if words := explained(term):
        return words
    sensor = REGISTRY.get(term.strip().lower())
    if sensor is None:
        raise UsageError(f"no such term: {term}. Known: {', '.join(similar(term))}")
    measured = ", ".join(f"{part.name} [{part.unit}]" for part in sensor.components)
    return f"Sensor. Reads {', '.join(sensor.reads)}; measures {measured}. Its settings: docs/settings.md"


@click.command()
@click.argument("what", type=click.Choice(["robot", "report", "info", "tune", "calibrate"]))
def schema(what: str) -> int:
    """Print the JSON Schema of robot.toml, of report.json, or of what a command prints with --json.

    With this schema an editor completes the keys of robot.toml, shows their units and marks errors. Save it beside
    robot.toml, whose first line (by `locfuse init`) names it. report.json and run.json have the same schema.

    \b
    locfuse schema robot > robot.schema.json
    locfuse schema report > report.schema.json
    locfuse schema info > info.schema.json
    """
    import json

    from locfuse.cli.inspect.json_schema import SCHEMAS

    put(json.dumps(SCHEMAS[what](), indent=2) + "\n")
    return 0


@click.command()
@click.argument("shell", type=click.Choice(["bash", "zsh", "fish"]))
def completion(shell: str) -> None:
    """Print a script for your shell that completes commands, options, sample logs, sensors, keys and topics.

    \b
    eval "$(locfuse completion bash)"                                # in ~/.bashrc
    eval "$(locfuse completion zsh)"                                 # in ~/.zshrc
    locfuse completion fish > ~/.config/fish/completions/locfuse.fish
    """
    kind = get_completion_class(shell)
    assert kind is not None  # click supports all three shells
    put(kind(click.get_current_context().find_root().command, {}, "locfuse", COMPLETION_VARIABLE).source())
