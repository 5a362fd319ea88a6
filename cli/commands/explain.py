"""`locfuse explain`: what a word of a report means."""

from __future__ import annotations

import click

from locfuse.cli.terminal.screen import put, reader_may_leave


@click.command()
@click.argument("term", required=False)
def explain(term: str | None) -> int:
    """Say what TERM of a report or what a sensor is; without TERM, list the terms.

    \b
    locfuse explain ANEES
    locfuse explain drift
    """
    from locfuse.cli.session.explain import explain
    from locfuse.formats.report.glossary import GLOSSARY

    lines = [f"{name}: {text}" for name, text in GLOSSARY.items()] if term is None else [explain(term)]
    with reader_may_leave():
        put("".join(f"{line}\n" for line in lines))
    return 0
