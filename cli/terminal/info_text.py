"""The text of `locfuse info`, wrapped at the terminal's width; not wrapped in a pipe or a file."""

from __future__ import annotations

import re
import shlex
from collections.abc import Collection, Iterator, Mapping, Sequence
from typing import Any

from msgspec.structs import replace

from locfuse.cli.analysis.robot_tables import table_types
from locfuse.cli.inspect.robot_facts import Overview, absent, configurations, extrinsics, wheels_missing
from locfuse.cli.inspect.topics import clock_word
from locfuse.formats.report.findings import options
from locfuse.formats.report.table import Column, of_rows, terminal_lines
from locfuse.fusion.checks.finding import Finding
from locfuse.fusion.checks.laser import OPEN_SCALE
from locfuse.fusion.checks.tried import by_key, keys
from locfuse.fusion.sensors.registry import REGISTRY

from .screen import wrapped

TOGETHER = "all logs together"
READS, CONFIGURATIONS, SPOILS, WORTH, NEXT = TITLES = (
    "sensors and their topics",
    "configurations",
    "would spoil an estimate",
    "worth knowing",
    "next",
)
BY_EFFECT = ((SPOILS, True), (WORTH, False))  # (title, whether its findings are severe)
TOPIC_COLUMNS = (
    Column("topic", "topic", kind="text"),
    Column("type", "type", kind="text", shorter=lambda kind: kind.rpartition("/")[2]),
    Column("messages", "messages"),
    Column("rate_hz", "Hz", form="{:.1f}", missing=""),
    Column("longest_gap_s", "gap", "s", "{:.1f}", missing="", rank=1),
    Column("clock", "clock", kind="text", rank=2),
    Column("frame", "frame", kind="text", missing="", rank=3),
    Column("roles", "read by", kind="text"),
)
TOPICS_NOTE = "clock: how long after its stamp a message was recorded."
GAP_NOTE = " gap: the longest time without a message."
CORRECT = "correct the settings that are named above, then: locfuse info LOG"
SETTING = re.compile(rf"\b({'|'.join(table_types())})\.[a-z_]+")
RECORD = "no setting helps: record the robot's wheels, odometry or laser scans, then: locfuse info LOG"
NO_BREAK = "\xa0"  # a space at which textwrap breaks no line
MAX_UNREADABLE_LISTED = 6  # number of unreadable topics listed with their reasons


def lines(
    overview: Overview, typed: Sequence[str], width: int | None, tried: Mapping[str, Any] | None = None
) -> Iterator[str]:
    """Yield the lines on one log; `typed`: the words after `info`, `width`: characters per line, None: no limit.

    `tried` has the fixes that help, and findings with those that do not; None: no fix was tried.
    """
    helped = tried["fixes"] if tried else None
    others = [fix for f in (tried or {}).get("findings", ()) for fixes in f["alternatives"] for fix in fixes]
    failed = keys(others) - keys(helped or ())
    yield _headline(overview)
    yield ""
    yield from _topics(overview, width)
    yield from _roles(overview, width)
    yield from _configurations(overview, width)
    for title, severe in BY_EFFECT:
        found = (f for f in overview.findings if f.severe == severe)
        yield from _section(title, [line for f in found for line in _finding(f, width, failed)])
    yield from _section(NEXT, [f"  {command}" for command in _next(overview, typed, helped)])


def together(overviews: Mapping[str, Overview], shown: Mapping[str, Any]) -> Iterator[str]:
    """Yield the lines on several logs of one robot: shared values, then findings, each once."""
    yield from map(_headline, overviews.values())
    yield from _section(TOGETHER, [f"  {value['words']}" for value in shown["values"]])
    common = {value["key"] for value in shown["values"]}
    found: dict[tuple[str, str], dict[str, Finding]] = {}
    for name, overview in overviews.items():
        for f in (f for f in overview.findings if not (f.fixes and keys(f.fixes) <= common)):
            found.setdefault((f.role, f.code), {})[name] = f
    for title, severe in BY_EFFECT:
        body = []
        for of in found.values():
            (name, first), logs = next(iter(of.items())), len(overviews)
            where = f"in {'all' if len(of) == logs else f'{len(of)} of'} {logs} logs, {name}"
            if any(f.severe for f in of.values()) == severe:
                body += _finding(replace(first, role=f"{first.role} ({where})"), None, set())
        yield from _section(title, body)


def listed(topics: Mapping[str, Mapping[str, Any]], width: int | None) -> Sequence[str]:
    """Return a table of the `topics` of a log as lines of at most `width` characters; None: no limit."""
    return _table([{**found, "topic": name} for name, found in topics.items()], width, TOPIC_COLUMNS[:4])


def _table(rows: Sequence[Mapping[str, Any]], width: int | None, columns: Sequence[Column]) -> list[str]:
    brief = ({**row, "type": row["type"].replace("/msg/", "/")} for row in rows)
    return [line.rstrip() for line in terminal_lines(of_rows(columns, brief), width)]


def _section(title: str, body: Sequence[str]) -> Iterator[str]:
    if body:
        yield ""
        yield title
        yield from body


def _headline(overview: Overview) -> str:
    span = overview.log.time_span_ns
    seconds = f"{(span[1] - span[0]) * 1e-9:.1f} s" if span else "no messages"
    recorded = [f for f in overview.facts if not f.derived]
    count, size = overview.log.message_count, overview.log.identity.size / 1e6
    megabytes = f"{size:.1f}" if size >= 1.0 else f"{size:.1g}"
    files = f" in {len(overview.log.paths)} files" if len(overview.log.paths) > 1 else ""
    topics = f"{len(recorded)} topic{'' if len(recorded) == 1 else 's'}"
    return f"{overview.log.name}: {seconds}, {count} messages on {topics}, {megabytes} MB{files}"


def _topics(overview: Overview, width: int | None) -> Iterator[str]:
    """Yield a table of the topics with messages, used ones first; then empty and unreadable topics."""
    role: dict[str, list[str]] = {}
    for name in overview.choice.topics:
        for topic in overview.choice.of(name):
            role.setdefault(topic, []).append(name)
    full = [f for f in overview.facts if f.count and f.problem is None]
    full.sort(key=lambda f: f.topic not in role)
    roles = {f.topic: ", ".join(role.get(f.topic, ())) for f in full}
    rows = [{**f.values(), "topic": f.topic, "clock": clock_word(f), "roles": roles[f.topic]} for f in full]
    yield from _table(rows, width, TOPIC_COLUMNS)
    if rows:
        gap = GAP_NOTE if any(row["longest_gap_s"] is not None for row in rows) else ""
        yield from wrapped("", f"{TOPICS_NOTE}{gap}", width, "")
    if empty := [f.topic for f in overview.facts if not f.count]:
        yield from wrapped("empty: ", ", ".join(empty), width, "  ")
    unreadable = [f for f in overview.facts if f.problem is not None and f.count]
    for f in unreadable[:MAX_UNREADABLE_LISTED]:
        yield from wrapped("not readable: ", f"{f.topic}: {f.problem}", width, "  ")
    if len(unreadable) > MAX_UNREADABLE_LISTED:
        yield f"not readable: {len(unreadable) - MAX_UNREADABLE_LISTED} more"


def _roles(overview: Overview, width: int | None) -> Iterator[str]:
    mounts = extrinsics(overview)
    body: list[str] = []
    for role in overview.choice.topics:
        topics = overview.choice.of(role)
        words = f"{' and '.join(topics)}, {overview.choice.why.get(role, '')}"
        if role in mounts:
            words += f"; {_place(mounts[role], overview.frames_of(role)[0])}"
        body += wrapped(f"  {role:<8} ", words, width)
    yield from _section(READS, body)


def _place(mount: dict[str, Any], frame: str) -> str:
    """Return in words the mount of a sensor and its source, or that the mount is unknown."""
    if mount["by"] == "nobody":
        return f"the mount of frame {frame} is unknown" if frame else "its mount is unknown"
    if "mounts" in mount:
        return f"{len(mount['mounts'])} places by {mount['by']}"
    parts = [f"{k} {mount[k] + 0.0:.3g} m" for k in ("x", "y") if k in mount]
    angles = [(k, mount[k]) for k in ("roll_deg", "pitch_deg", "yaw_deg") if round(mount.get(k) or 0.0, 1)]
    parts += [f"{k.removesuffix('_deg')} {v:.3g}°" for k, v in angles]
    parts += ["upside-down"] if mount.get("flipped") else []
    return f"at {', '.join(parts)} by {mount['by']}" if parts else f"level by {mount['by']}"


def _configurations(overview: Overview, width: int | None) -> Iterator[str]:
    """Yield lines on configurations that can run, on those that cannot (and why), and on sensors without topic."""
    foreign, reasons = [name for name in REGISTRY if name in overview.choice.foreign], absent(overview)
    why = [(name, name, reasons[name]) for name in REGISTRY if name in reasons and name not in foreign]
    if (base := wheels_missing(overview)) is not None:
        why.insert(0, ("all", "wheels", base))
    ready = ", ".join(name for name, what in configurations(overview).items() if what is None)
    body = wrapped("  ready    ", ready, width) if ready else []
    for name, role, words in why:
        below = any(f.role == role and (f.severe or f.sentence == words) for f in overview.findings)
        body += wrapped("  not yet  ", f"{name}: {'see below' if below else words}", width)
    body += wrapped("  no topic ", ", ".join(foreign), width) if foreign else []
    yield from _section(CONFIGURATIONS, body)


def _finding(f: Finding, width: int | None, failed: set[str]) -> list[str]:
    fixes = () if f.code == OPEN_SCALE else f.fixes  # the message names two alternative fixes
    body = wrapped(f"  {f.role}: ", f.brief if fixes else f.sentence, width, "    ")
    useless = f.severe and keys(fixes) <= failed
    head = "    as measured, but it does not help (see below): " if useless else "    fix: "
    return [*body, *_options(head, fixes, width)] if fixes else body


def _options(head: str, fixes: Sequence[str], width: int | None) -> list[str]:
    """Return `fixes` as --set options after the text `head`, wrapped at `width` characters; None: one line."""
    unbroken = " ".join(options((fix,)).replace(" ", NO_BREAK) for fix in fixes)
    return [line.replace(NO_BREAK, " ") for line in wrapped(head, unbroken, width)]


def _next(overview: Overview, typed: Sequence[str], helped: Sequence[str] | None) -> list[str]:
    """Return the next command: `recover`, `init`, `info` with fixes that help, `compare`; or what to record."""
    losses = overview.log.losses
    if losses.recoverable and losses.messages < overview.log.message_count:
        return [shlex.join(("locfuse", "recover", *map(str, overview.log.given), "-o", "recovered.mcap"))]
    if overview.choice.unused_wheels:  # wheels first: other findings depend on their size
        return [shlex.join(("locfuse", "init", *typed, "-o", "robot.toml"))]
    worst = [f for f in overview.findings if f.severe and f.code != OPEN_SCALE]  # its fix is the user's choice
    sizeless = any(f.code == "geometry" for f in worst)  # `init` asks for the size
    topics = {word.partition(".topic=")[0] for word in typed if ".topic=" in word}
    wrong = (f for f in worst if f.code in {"choice", "unusable"} and not f.fixes)
    if {"--set", "--robot"} & {*typed} and any(f.role in topics or SETTING.search(f.message) for f in wrong):
        return [CORRECT]
    unusable = overview.loaded is None or overview.motion_faults
    if unusable and not sizeless and any(f.role in {"wheels", "log"} and not f.fixes for f in worst):
        scans = overview.choice.of("lrf")
        if scans and overview.choice.of("wheels") != scans:  # scans may give the motion instead
            kept = _without(typed, {"wheels.topic"})
            return [shlex.join(("locfuse", "info", *kept, "--set", f"wheels.topic={scans[0]}"))]
        return [RECORD]
    fixes = by_key(fix for f in worst for fix in f.fixes)
    if fixes := by_key(helped) if fixes and helped is not None else fixes:
        kept = _without(typed, fixes)
        options = [word for key, value in fixes.items() for word in ("--set", f"{key}={value}")]
        return [shlex.join(("locfuse", "info", *kept, *options))]
    if overview.loaded is not None:  # without the robot's motion nothing can be compared
        return [shlex.join(("locfuse", "compare", *typed))]
    command = shlex.join(("locfuse", "init", *typed))
    return [f"{command} > robot.toml"] if overview.choice.of("wheels") else [RECORD]


def _without(typed: Sequence[str], fixes: Collection[str]) -> list[str]:
    """Return the typed words without each `--set KEY=VALUE` whose KEY is in `fixes`."""
    kept: list[str] = []
    for word in typed:
        if kept and kept[-1] == "--set" and word.partition("=")[0] in fixes:
            kept.pop()
        else:
            kept.append(word)
    return kept
