"""`locfuse init`: a commented draft of robot.toml for a log."""

from __future__ import annotations

import shlex
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from msgspec.structs import replace

from locfuse.cli.terminal import options as o
from locfuse.cli.terminal.screen import put, say

if TYPE_CHECKING:
    from locfuse.cli.inspect.template import Draft
    from locfuse.fusion.checks.finding import Finding

SCHEMA = "robot.schema.json"  # next to robot.toml, so that the path is valid on every machine
LONGEST_UNIT = 24  # characters of the longest unit that is shown, such as "[latitude, longitude]"


@click.command()
@o.LOGS
@o.option("-o --out", "Write robot.toml to this file.  [default: print it]", type=o.FILE)
@o.OVERWRITE
@o.option(
    "--update",
    "Add values that the log shows and this file lacks; its comments and values stay.",
    type=o.EXISTING,
    metavar="ROBOT.TOML",
)
@o.option(
    "--ekf",
    "Take topics and frames from this robot_localization file; parameters that cannot be used are listed.",
    type=o.EXISTING,
    metavar="EKF.YAML",
)
@o.carried(*o.READING)
def init(log: tuple[str, ...], options: o.Options, update: Path | None, ekf: Path | None) -> int:
    """Print a robot.toml for LOG: a starting point with a comment on every line.

    Values that the log shows are set: topics, joints, mounts (/tf_static), wheels (/robot_description), clock
    lags. Guesses are marked. Lines starting with # are inactive: they name what you must measure. With -o or
    --update, on a terminal, locfuse asks for values that no log contains, such as the wheel radius.

    \b
    locfuse init bag/ -o robot.toml
    locfuse init bag/ --update robot.toml
    locfuse init bag/ --ekf ekf.yaml -o robot.toml
    locfuse init bag/ --set wheels.radius=0.033 --set wheels.track=0.16 > robot.toml
    locfuse compare bag/ --robot robot.toml
    """
    from locfuse.cli.analysis.load import find_log
    from locfuse.cli.inspect.template import draft
    from locfuse.cli.terminal import show
    from locfuse.formats.logs.log import open_log
    from locfuse.formats.robot import robot_localization
    from locfuse.formats.robot.robot_toml import printable, render
    from locfuse.formats.whole_files import may_replace, write_text

    how, out = options.how, options.outputs.out
    if update is not None:
        if out is not None or how.robots:
            raise click.UsageError("--update FILE reads and writes FILE: leave out -o and --robot")
        how = replace(how, robots=(update,))
    may_replace(out, options.outputs.overwrite, log)
    place = update or out
    with show.progress(how.quiet) as progress:
        foreign, notes = dict[str, dict[str, Any]](), tuple[str, ...]()
        if ekf is not None:
            imported = robot_localization.read(ekf, list(open_log(find_log(log)).topics))
            foreign, notes = {ekf.name: imported.tables}, imported.notes
        made = draft(log, how, progress, foreign)
    if place is not None and made.missing and not how.quiet and (typed := _asked(made)):
        with show.progress(how.quiet) as progress:
            made = draft(log, replace(how, sets=(*how.sets, *typed)), progress, foreign)
    words = printable(shlex.join(log))
    name = printable(shlex.quote(str(place or "robot.toml")))
    fresh = f"#:schema ./{SCHEMA}\n{render(_head(made, words, name), made.sections, _foot(made))}"
    text = fresh if update is None else _updated(made, update)
    if place is not None:
        write_text(place, text)
        say(f"{place}: use it with --robot {name}")
    else:
        put(text)
    code = show.ended((), made.overview.log.losses.lines(), how.quiet)
    for note in notes:
        say(f"{ekf}: {note}")
    for line in () if how.quiet else _notes(made, words, name):
        show.say(line)
    return code


def _asked(made: Draft) -> tuple[str, ...]:
    """Ask the user for missing values until each is valid or empty; return "table.key=value" of each.

    () if stdin or stderr is a file or a pipe, as in scripts and CI.
    """
    from locfuse.cli.analysis.robot_tables import make_robot
    from locfuse.formats.robot import robot_toml
    from locfuse.fusion.data import LocfuseError

    if not (sys.stdin.isatty() and sys.stderr.isatty()):
        return ()
    words = {f"{section.name}.{line.key}": line.words for section in made.sections for line in section.lines}
    say("No log can tell these values. Enter leaves one blank.", err=True)
    answers = []
    for key in made.missing:
        unit, _, how = words.get(key, "").partition(": ")
        named = how and len(unit) <= LONGEST_UNIT
        say(f"{key} [{unit}]: {how}" if named else f"{key}: {words.get(key, '')}", err=True)
        while answer := str(click.prompt("  value", default="", show_default=False, err=True)).strip():
            try:
                make_robot(robot_toml.apply_sets([f"{key}={answer}"]))
            except LocfuseError as problem:
                say(f"  {problem}", err=True)
            else:
                answers.append(f"{key}={answer}")
                break
    return tuple(answers)


def _updated(made: Draft, file: Path) -> str:
    """Return the text of a robot.toml; keys that the file lacks and the log shows are added."""
    from locfuse.formats.robot import robot_toml

    text = robot_toml.text_of(file)
    there = robot_toml.parse(text, str(file))
    changes: dict[str, Any] = {}
    for section in (s for s in made.sections if s.name):
        known = there.get(section.name, {})
        shown = [line for line in section.lines if line.holds and line.value is not None]
        new = {line.key: line.value for line in shown if line.key not in known}
        changes |= {section.name: new} if new else {}
    return robot_toml.updated(text, changes, "locfuse init --update")


def _head(made: Draft, words: str, name: str) -> str:
    tuned = " --robot tuned.toml" if _tunes(made) else ""
    commands = [
        f"info {words} --check --robot {name}",
        *([f"tune {words} --robot {name} -o tuned.toml"] if tuned else []),
        f"compare {words} --robot {name}{tuned}",
        f"schema robot > {SCHEMA}   (then an editor completes and checks this file)",
    ]
    what = f"robot.toml of {made.overview.log.name}, a starting point by locfuse init."
    return "\n  locfuse ".join([f"{what} Lines starting with # are inactive.\n", *commands])


def _foot(made: Draft) -> str:
    """Return a comment on sensors without a topic, with reasons."""
    written = {section.name for section in made.sections if section.lines}
    absent = {name: why for name, why in made.overview.choice.absent.items() if name not in written - {"wheels"}}
    plain = [name for name in absent if name in made.overview.choice.foreign]
    others = [f"{name}: {why}" for name, why in absent.items() if name not in plain]
    return "\n".join(([f"Not in this log: {', '.join(plain)}."] if plain else []) + others)


def _notes(made: Draft, words: str, name: str) -> list[str]:
    """Return notes on guessed values and on the next command."""
    from locfuse.cli.analysis.motion_evidence import unjudged
    from locfuse.cli.inspect.robot_facts import wheels_missing
    from locfuse.formats.report.findings import options
    from locfuse.fusion.checks.laser import OPEN_SCALE

    loaded = made.overview.loaded
    if (nothing := made.overview.choice.absent.get("wheels")) is not None:
        last = f"this log cannot run: {nothing}"
    elif loaded is None and (why := wheels_missing(made.overview)) and not made.missing:
        last = f"this log cannot run: {why}"
    elif made.missing:
        last = f"fill in {', '.join(made.missing)} (their comments say how to measure them)"
        last += f"; {why}" if (why := made.overview.robot_facts.unsteered) else ""
    elif faults := made.overview.motion_faults:
        last = f"no motion to use: {faults[0].words}"
    elif loaded is not None and (why := unjudged(loaded.drive)):
        last = why
    else:
        tune, compare = f"tune {words} --robot {name} -o tuned.toml", f"compare {words} --robot {name}"
        # an open scale has two fixes: the user must choose
        fixes = [fix for f in _wrong(made) if f.code != OPEN_SCALE for fix in f.fixes]
        last = f"next: locfuse {tune if _tunes(made) else compare} {options(fixes)}"
    of_robot = f"{made.robot}: its figures that the log does not tell are taken from locfuse's own files"
    guesses = (f"guessed: {guess}" for guess in (*([of_robot] if made.robot else []), *made.guesses))
    wrong = (f"still wrong: {f.role}: {f.sentence}" for f in _wrong(made))
    return [*guesses, *wrong, last.rstrip()]


def _wrong(made: Draft) -> list[Finding]:
    """Return the severe findings on truth and sensors that remain under the new settings."""
    from locfuse.fusion.sensors.registry import REGISTRY

    return [f for f in made.overview.findings if f.severe and f.role in {"truth", *REGISTRY}]


def _tunes(made: Draft) -> bool:
    """Return whether `tune` can be used: the log has a sensor and a motion, and no severe finding."""
    loaded = made.overview.loaded
    usable = loaded is not None and bool(loaded.drive.measurements) and not loaded.motion_faults
    return usable and not _wrong(made)
