"""The entry point: imports a command when it is used, and converts errors to exit codes.

`locfuse --help` must not import NumPy, OpenCV or Rerun (benchmarks: "--help"), so a command's module is imported
when the command is used.
"""

from __future__ import annotations

import importlib
import os
import signal
import sys
from types import FrameType
from typing import Any, NoReturn

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # 3 x 3 matrices need no threads; halves NumPy's import

import click

from locfuse.cli.analysis.errors import expected, silence_overflows
from locfuse.cli.terminal.screen import say, settle_streams

COMMANDS = {
    "run": "Estimate the trajectory with one set of sensors.",
    "compare": "Compare sets of sensors, and report what each sensor adds.",
    "fleet": "Compare many logs, and summarise the results in tables and on one page.",
    "info": "Show what is in a log, and what looks wrong, with the fix.",
    "init": "Print a robot.toml for a log; values that you must measure are marked.",
    "view": "Show a log, a result or a recording in Rerun.",
    "calibrate": "Estimate wheel noise, wheel geometry, laser mount and magnetometer iron from logs.",
    "tune": "Estimate the noise of wheels and sensors from logs, without truth.",
    "export": "Write parameters found from a log into YAML files of ROS nodes.",
    "recover": "Copy the readable part of a damaged log into a new MCAP.",
    "explain": "Explain a term of a report, or a sensor: ANEES, NIS, drift ...",
    "completion": "Print a script for your shell that completes locfuse's commands and options.",
    "paper": "Repeat the paper's table and figures, with our filter and as printed, on one page.",
    "simulate": "Simulate a drive, and record it as a log with known truth.",
    "mcp": "Let an AI agent use locfuse on the logs of some folders (Model Context Protocol).",
    "schema": "Print the JSON Schema of robot.toml, of report.json or of --json output.",
}
MODULES = {  # command -> module in cli/commands, where their names differ
    **dict.fromkeys(("calibrate", "tune"), "estimate"),
    **dict.fromkeys(("explain", "completion", "schema"), "words"),
    "paper": "simulate",
}
INTERRUPTED, TERMINATED = 130, 143


class LazyGroup(click.Group):
    """A click group that imports the module of a command when it is used."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Return the names of all commands in the order of --help."""
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Import and return one command."""
        if cmd_name not in COMMANDS:
            return None
        module = importlib.import_module(f"locfuse.cli.commands.{MODULES.get(cmd_name, cmd_name)}")
        command: click.Command = getattr(module, cmd_name)
        return command

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """Find the typed command. An unknown name is an error that suggests a similar one."""
        from locfuse.formats.text import nearest

        if args and not args[0].startswith("-") and args[0] not in COMMANDS:
            near = nearest(args[0], COMMANDS)
            meant = f"did you mean {near}" if near else f"choose from {', '.join(COMMANDS)}"
            ctx.fail(f"no command {args[0]!r}; {meant}")
        return super().resolve_command(ctx, args)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the list of commands without importing them."""
        with formatter.section("Commands"):
            formatter.write_dl(list(COMMANDS.items()))


def _print_version(ctx: click.Context, _option: click.Parameter, asked: bool) -> None:
    """Print the version, and whether the kernels run without compilation."""
    if not asked or ctx.resilient_parsing:
        return
    from locfuse.formats.versions import own
    from locfuse.fusion.kernels.built import COMPILED, how

    click.echo(f"locfuse, version {own()}" + ("" if how() == COMPILED else f" (kernels {how()})"))
    ctx.exit()


VERSION: dict[str, Any] = {"is_flag": True, "expose_value": False, "is_eager": True, "callback": _print_version}


@click.group(cls=LazyGroup, context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100})
@click.option("--version", help="Show the version and exit.", **VERSION)
def locfuse() -> None:
    """Find out which sensors a robot needs: EKF localization from recorded logs, with every set of sensors.

    \b
    Start with:  locfuse compare rounded_rectangle
    Your log:    locfuse info LOG
    """


def main(arguments: list[str] | None = None) -> NoReturn:
    """Run the command line and exit with one of the documented codes (0, 1, 2, 3, 4, 130, 143)."""
    settle_streams()
    signal.signal(signal.SIGTERM, _stop)
    on_interrupt = signal.getsignal(signal.SIGINT)
    if on_interrupt is signal.default_int_handler:  # else `nohup` or `&` ignores SIGINT
        signal.signal(signal.SIGINT, _stop)  # click would print an empty line first
    if arguments is None and not sys.warnoptions:
        silence_overflows()
    code: Any = 0
    try:
        code = locfuse.main(args=arguments, prog_name="locfuse", standalone_mode=False)
    except BaseException as problem:
        code = _exit_code(problem)
    finally:
        signal.signal(signal.SIGINT, on_interrupt)
    sys.exit(code if isinstance(code, int) else 0)


def _exit_code(problem: BaseException) -> int:
    """Print in one line why a command ended, and return its exit code; raise a bug again."""
    # Python 3.11 raises a RuntimeError if a signal arrives while a class is created, as in an import
    for stopped in (problem, problem.__cause__):
        if isinstance(stopped, _Stopped) and stopped.number == signal.SIGTERM:
            return _print_error("terminated; nothing was left half-written", TERMINATED)
        if isinstance(stopped, KeyboardInterrupt | click.Abort | _Stopped):
            return _print_error("interrupted; nothing was left half-written", INTERRUPTED)
    if isinstance(problem, click.exceptions.Exit):
        return problem.exit_code
    if isinstance(problem, click.ClickException):
        if isinstance(problem, getattr(click.exceptions, "NoArgsIsHelpError", ())):  # click 8.1 prints the help
            problem.show()
            return 2
        context = getattr(problem, "ctx", None)
        command = "locfuse" if context is None else context.command_path
        return _print_error(f"{problem.format_message().rstrip('.')}; see: {command} --help", 2)
    known = expected(problem) if isinstance(problem, Exception) else None
    if known is None:
        raise problem
    return _print_error(*known)


def _print_error(text: str, code: int) -> int:
    say(f"locfuse: {' '.join(text.split())}", err=True)
    return code


class _Stopped(BaseException):
    """Raised on SIGINT or SIGTERM."""

    def __init__(self, number: int) -> None:
        super().__init__(number)
        self.number = number


def _stop(number: int, frame: FrameType | None) -> Any:
    if number == signal.SIGINT and sys.stderr.isatty():
        say("", err=True)  # ends the line on which the terminal shows ^C
    raise _Stopped(number)
