"""Options of commands that read logs, each declared once: their completion, and the record that carries them.

The parameter of an option has the name of a field in one of the parts of `Options`.
"""

from __future__ import annotations

import contextlib
import functools
import os
import shlex
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar, cast

import click
import msgspec
from click.shell_completion import CompletionItem

from locfuse.cli.analysis import settings
from locfuse.cli.analysis.settings import EXPORTS, Asked, FleetOptions, GateOptions, LogOptions, Outputs

F = TypeVar("F", bound=Callable[..., Any])
Declared = Callable[[Any], Any]  # what click.option returns
SECONDS = "s since the first wheel reading"
HELP_ALL = "locfuse.help_all"  # key in a context's meta: show every option
HELP_GROUPS = {  # group of --help -> its parameters, in a user's order; all others are shown by --help-all
    "Input": ("sensors", "robots", "sets", "truth", "given_map", "smooth"),
    "Many logs": ("jobs", "cluster", "each", "again", "robot_from", "sweep"),
    "Output": ("out", "write", "save", "connect", "web", "tab", "rerun", "open", "verbose"),
    "Checks": ("fail_if",),
}


class Options(msgspec.Struct, frozen=True):
    """All options of a command; those that a command does not have keep their defaults."""

    how: LogOptions = LogOptions()  # how logs are read
    asked: Asked = Asked()  # what is computed for each log
    outputs: Outputs = Outputs()  # what is written, and where
    gates: GateOptions = GateOptions()
    fleet: FleetOptions = FleetOptions()

    @property
    def inputs(self) -> tuple[Path | None, ...]:
        """Input files besides the log, which must not be overwritten."""
        return (*self.how.robots, self.gates.baseline, self.how.given_map)


PARTS = {part.name: part.type for part in msgspec.structs.fields(Options)}
# parameters that set fields of the parts of `Options`
CARRIED_OPTIONS = {"truth", *(name for kind in PARTS.values() for name in kind.__struct_fields__)}


def carried(*declared: Declared) -> Callable[[F], F]:
    """Return a decorator that adds the options `declared` to a command.

    The command gets all values of `Options` as the argument `options`, and each other value as its own argument.
    """

    def decorate(command: F) -> F:
        @functools.wraps(command)
        def wrapped(log: tuple[str, ...], **given: Any) -> Any:
            own = {n: v for n, v in given.items() if n not in CARRIED_OPTIONS}
            return command(log, options=_options(given), **own)

        found: Any = functools.reduce(lambda decorated, option: option(decorated), reversed(declared), wrapped)
        return cast("F", found)

    return decorate


def _options(given: Mapping[str, Any]) -> Options:
    """Return click's values as one record. Raises click.UsageError for contradictions."""
    if given.get("cluster") is not None and given["jobs"] > 1:
        raise click.UsageError("--jobs is for this machine; --cluster runs a job per thread of its workers")
    begin, end, truth = given.get("begin"), given.get("end"), given["truth"]
    if begin is not None and end is not None and begin >= end:
        raise click.UsageError(f"--from {begin:g} --to {end:g}: the first must be the earlier one")
    if truth is not None:
        from locfuse.formats.logs.file_stream import SUFFIXES
        from locfuse.formats.robot.robot_toml import as_set

        if truth.suffix.lower() not in SUFFIXES:
            raise click.UsageError(f"--truth {truth}: a .tum, or a .csv whose first line names t, x, y, is needed")
        given = {**given, "sets": (*given["sets"], as_set("truth.topic", str(truth)))}
    parts = ((name, kind, kind.__struct_fields__) for name, kind in PARTS.items())
    return Options(**{n: kind(**{f: given[f] for f in fields if f in given}) for n, kind, fields in parts})


class Grouped(click.Command):
    """A command whose --help shows the most used options in groups, and --help-all all options."""

    def __init__(self, *args: Any, **given: Any) -> None:
        super().__init__(*args, **given)
        own: dict[str, Any] = {"is_flag": True, "is_eager": True, "expose_value": False, "callback": _help_all}
        self.params.append(click.Option(["--help-all"], help="Show all options.", **own))

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the groups of options, with --help-all also the other options."""
        shown = [p for p in self.get_params(ctx) if isinstance(p, click.Option)]
        records = {p.name: record for p in shown if (record := p.get_help_record(ctx))}
        own = self.get_help_option(ctx)
        help_itself = [records.pop(name) for name in (own and own.name, "help_all") if name in records]
        groups = {title: [records.pop(n) for n in names if n in records] for title, names in HELP_GROUPS.items()}
        groups |= {"More": list(records.values()) if ctx.meta.get(HELP_ALL) else [], "Help": help_itself}
        for title, rows in groups.items():
            if rows:
                with formatter.section(title):
                    formatter.write_dl(rows)


def _help_all(ctx: click.Context, param: click.Parameter, wanted: bool) -> None:
    if wanted and not ctx.resilient_parsing:
        ctx.meta[HELP_ALL] = True
        click.echo(ctx.get_help())
        ctx.exit()


class RobotFile(click.Path):
    """The type of --robot: an existing file, or a pattern with {robot} for the robots of a fleet."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Return the path; one with {robot} need not exist."""
        return Path(value) if "{robot}" in str(value) else super().convert(value, param, ctx)


class Folder(click.Path):
    """The type of --each: a local folder, or a remote one such as s3://bucket/day1/."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Return the folder or URL as text."""
        from locfuse.formats.container.file_bytes import is_url

        return value if is_url(str(value)) else str(super().convert(value, param, ctx))


def kinds_of(known: Sequence[str], what: str, default: str | None) -> Callable[..., frozenset[str]]:
    """Return a callback that parses comma-separated kinds of output. Raises UsageError for unknown ones."""
    return lambda context, parameter, value: frozenset(
        settings.chosen(default if value is None else value, known, what)
    )


FILE = click.Path(path_type=Path, dir_okay=False)
EXISTING = click.Path(path_type=Path, dir_okay=False, exists=True)
DIRECTORY = click.Path(path_type=Path, file_okay=False)


def option(names: str, words: str, **more: Any) -> Declared:
    """Return a click option with these names and this help text."""
    return click.option(*names.split(), help=words, **more)


def flag(names: str, words: str, **more: Any) -> Declared:
    """Return an option without a value."""
    return option(names, words, is_flag=True, **more)


def each(names: str, words: str, **more: Any) -> Declared:
    """Return a click option that may be given several times in one command."""
    return option(names, words, multiple=True, **more)


def complete_log(context: click.Context, parameter: click.Parameter, begun: str) -> list[CompletionItem]:
    """Complete a log: names of sample logs, and files."""
    from locfuse.sample_logs import names

    samples = [CompletionItem(name, help="sample log") for name in names() if name.startswith(begun)]
    return [*samples, CompletionItem(begun, type="file")]


def complete_sensors(context: click.Context, parameter: click.Parameter, begun: str) -> list[CompletionItem]:
    """Complete a sensor name, also after a comma."""
    from locfuse.fusion.sensors.registry import REGISTRY

    before, comma, word = begun.rpartition(",")
    known = REGISTRY if comma else ("odometry", "all", *REGISTRY)
    taken = set(before.split(","))
    return [CompletionItem(f"{before}{comma}{s}") for s in known if s.startswith(word) and s not in taken]


def complete_setting(context: click.Context, parameter: click.Parameter, begun: str) -> list[CompletionItem]:
    """Complete a key of robot.toml, with its unit; after TABLE.topic= a topic of the typed log."""
    from msgspec.structs import fields

    from locfuse.cli.analysis.robot_tables import table_types
    from locfuse.formats.robot import robot_toml

    key, equals, word = begun.partition("=")
    if equals:
        found = _topics(context) if key.rpartition(".")[2].endswith("topic") else []
        return [CompletionItem(f"{key}={topic}") for topic in found if topic.startswith(word)]
    every = ((table, f.encode_name) for table, kind in table_types().items() for f in fields(kind))
    fits = [(table, name) for table, name in every if f"{table}.{name}".startswith(begun)]
    return [CompletionItem(f"{table}.{name}=", help=robot_toml.unit_of(table, name)) for table, name in fits]


def _topics(context: click.Context) -> list[str]:
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


LOGS = click.argument("log", nargs=-1, required=True, shell_complete=complete_log)
OVERWRITE = flag("--overwrite", "Replace existing files.")
QUIET = flag("-q --quiet", "Print no progress and no notes.")

# --- how a log is read
READING = (
    each(
        "--robot robots",
        "A robot.toml. Its values replace those in the log. Repeatable: the last value counts.",
        type=RobotFile(path_type=Path, exists=True, dir_okay=False),
    ),
    each(
        "--set sets",
        "Set one key of robot.toml, e.g. --set lrf.sigma_range=0.03. Repeatable.",
        metavar="TABLE.KEY=VALUE",
        shell_complete=complete_setting,
    ),
    option(
        "--order", "Clock to use where stamps run backwards.  [default: auto]", type=click.Choice(settings.ORDERS)
    ),
    option(
        "--truth",
        "File with reference poses: a .tum, or a .csv with columns t, x, y (theta).",
        type=EXISTING,
        metavar="FILE",
    ),
    flag("--strict", "Exit with 3 if any data is lost."),
    flag(
        "--hash hash_all",
        "Put the log's hash into the report; this reads the whole log.  [default: only if it is read anyway]",
    ),
    QUIET,
)
FUSING = (  # of a command that runs the filter on a log
    *READING,
    option(
        "--preset",
        "The filter: our own, or the paper's equations as printed (docs/paper.md).  [default: default]",
        type=click.Choice(settings.PRESETS),
    ),
    option("--from begin", f"Use only the drive after this time: {SECONDS}.", type=float, metavar="S"),
    option("--to end", f"Use only the drive before this time: {SECONDS}.", type=float, metavar="S"),
)

GIVEN_MAP = option(
    "--map given_map",
    "Localise in this map: a .json of --save-map, or a .yaml of map_server, in which the start is searched. "
    "The map is not changed.",
    type=EXISTING,
)

# --- what is computed
ALIGN = option(
    "--align",
    "Move the estimate onto the truth before the error is computed.",
    type=click.Choice(["none", "origin", "se2"]),
    default="none",
    show_default=True,
)
SMOOTH = option(
    "--smooth/--no-smooth",
    "Also compute the smoothed estimate (uses the whole log).  [default: with a laser, of a single log]",
    default=None,
)
REFERENCE = option(
    "--reference/--no-reference",
    "Without truth: measure errors against the smoothed solution of all sensors; judge each sensor by a "
    "solution without it.  [default: with --smooth, and for drives of up to "
    f"{settings.MAX_REFERENCE_INSTANTS} update times]",
    default=None,
)
ADVICE = option(
    "--no-advice advice",
    "Do not try fixes: report only the results of the present settings.",
    flag_value=False,
    default=True,
)
JITTER = option(
    "--jitter",
    "Also run the filter N times with stamps moved by 1 µs and 1 % of the readings dropped; report the range "
    "of every figure.",
    type=int,
    default=0,
    metavar="N",
)
CONFIGURATIONS = (
    each(
        "--sensors",
        "A set of sensors to compare, e.g. compass,lrf; lrf@2Hz uses a lower rate. Repeatable.  [default: "
        "odometry, each sensor alone, all]",
        shell_complete=complete_sensors,
    ),
    flag("--all-subsets", "Run every subset of the sensors, to compute the average effect of each (its credit)."),
)


def sensors(words: str) -> Declared:
    """Return --sensors, with the help text `words`, for a command that runs one configuration."""
    return option(
        "--sensors",
        words,
        shell_complete=complete_sensors,
        default="all",
        show_default=True,
        callback=lambda context, parameter, value: (value,),
    )


# --- gates
GATES = (
    each(
        "--fail-if",
        'Exit with 4 if this condition is true, e.g. "all.position_rmse_m > 0.02"; for several logs also '
        '"fleet.all.position_rmse_m.p90 > 0.05". Repeatable.',
        metavar="GATE",
    ),
    option(
        "--baseline",
        "Exit with 4 if an error figure is worse than in this earlier report of the same log (for "
        "several logs: their summary.json).",
        type=EXISTING,
        metavar="REPORT.JSON",
    ),
    option(
        "--tolerance",
        "How much worse than the baseline is allowed: in per cent, as a length or angle, or both: 5%,1mm,0.1deg.",
        default="5%",
        show_default=True,
    ),
)

# --- what is written
FIGURES = option(
    "--figures", "Also write every figure there as SVG and PDF, for a paper.", type=DIRECTORY, metavar="DIR"
)
OPEN = flag("--open", "Open the report in the browser.")
EXPORT = option(
    "--export",
    "Comma-separated formats of other tools to write too (docs/bags.md): "
    f"{'; '.join(f'{kind} ({what})' if what else kind for kind, what in EXPORTS.items())}.",
    callback=kinds_of(list(EXPORTS), "--export: unknown format", ""),
    metavar="KINDS",
)


def written(kinds: Sequence[str]) -> tuple[Declared, ...]:
    """Return --out, --overwrite, --write, --json and --verbose, for a command that can write these `kinds`."""
    usual = ",".join(settings.by_default(kinds))
    return (
        option("-o --out", "Folder for the results.  [default: locfuse-out/<log name>]", type=DIRECTORY),
        OVERWRITE,
        option(
            "--write",
            f"Comma-separated outputs to write: {', '.join(kinds)}, or all.  [default: {usual}]",
            callback=kinds_of(kinds, "--write: unknown output", None),
            metavar="KINDS",
        ),
        flag("--json as_json", "Print the report as JSON instead of a table."),
        flag("-v --verbose", "Also print the notes and the table of sensors."),
    )


# --- Rerun
RERUN_SHOW = flag(
    "--rerun", "Show the drive in Rerun; several logs are only recorded. More options: locfuse view."
)
RERUN = (
    RERUN_SHOW,
    option("--rerun-save", "Write the Rerun recording to this file.", type=FILE, metavar="FILE.rrd"),
)


# --- many logs
def fleet(hidden: bool = False) -> tuple[Declared, ...]:
    """Return the options for many logs; with `hidden` they are not in --help."""
    own = functools.partial(option, hidden=hidden)
    return (
        own(
            "-j --jobs",
            "Number of logs to compare at once, each in its own process.",
            type=click.IntRange(min=1),
            default=1,
            show_default=True,
        ),
        own(
            "--cluster",
            "Compare the logs on the workers of a Dask scheduler, such as tcp://127.0.0.1:8786 (docs/fleet.md).",
            metavar="ADDRESS",
        ),
        own(
            "--each",
            "Compare every log below this folder. Repeatable.",
            multiple=True,
            type=Folder(exists=True, file_okay=False),
            metavar="DIR",
        ),
        own("--again", "Also run logs that already have results.", is_flag=True),
        own(
            "--max-failures",
            "Stop when more than N logs have failed.  [default: go on]",
            type=click.IntRange(min=0),
            metavar="N",
        ),
        own(
            "--robot-from",
            "Regular expression that finds the robot's name in a log's path, such as 'fleet/([^/]+)/'. With it, "
            "--robot 'robots/{robot}.toml' names a file per robot.",
            metavar="REGEX",
        ),
        own(
            "--sweep",
            "Run each log with each of these values of a key, e.g. lrf.sigma_range=0.01,0.03. Repeatable.",
            multiple=True,
            metavar="KEY=V1,V2",
        ),
    )
