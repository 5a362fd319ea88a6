"""`locfuse completion`: the script by which a shell completes commands, logs, sensors, keys and topics."""

from __future__ import annotations

import click

from locfuse.cli.terminal.completion import SHELLS, script
from locfuse.cli.terminal.screen import put


@click.command()
@click.argument("shell", type=click.Choice(SHELLS))
def completion(shell: str) -> None:
    """Print what makes SHELL complete locfuse's commands, options, sample logs, sensors, keys and topics.

    \\b
    eval "$(locfuse completion bash)"                                # in ~/.bashrc
    eval "$(locfuse completion zsh)"                                 # in ~/.zshrc
    locfuse completion fish > ~/.config/fish/completions/locfuse.fish
    """
    put(script(shell, click.get_current_context().find_root().command))
