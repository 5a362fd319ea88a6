"""`locfuse completion`: the script by which a shell completes commands, logs, sensors, keys and topics."""

from __future__ import annotations

import click
from click.shell_completion import get_completion_class

from locfuse.cli.terminal.screen import put

SHELLS = ("bash", "zsh", "fish")
COMPLETION_VARIABLE = "_LOCFUSE_COMPLETE"  # the variable by which the shell asks


@click.command()
@click.argument("shell", type=click.Choice(SHELLS))
def completion(shell: str) -> None:
    """Print what makes SHELL complete locfuse's commands, options, sample logs, sensors, keys and topics.

    \b
    eval "$(locfuse completion bash)"                                # in ~/.bashrc
    eval "$(locfuse completion zsh)"                                 # in ~/.zshrc
    locfuse completion fish > ~/.config/fish/completions/locfuse.fish
    """
    kind = get_completion_class(shell)
    assert kind is not None  # click has all of SHELLS
    put(kind(click.get_current_context().find_root().command, {}, "locfuse", COMPLETION_VARIABLE).source())
