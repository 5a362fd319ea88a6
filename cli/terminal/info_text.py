"""What `locfuse info` prints for people: lines no wider than the terminal, whole sentences where there is none."""

from __future__ import annotations

import re
import shlex
import textwrap
from collections.abc import Collection, Iterator, Mapping, Sequence
from typing import Any

from locfuse.cli.inspect.mounts import extrinsics
from locfuse.cli.inspect.overview import Look
from locfuse.cli.inspect.topics import TopicFacts, clock_word
from locfuse.cli.inspect.values import absent, configurations, wheels_missing
from locfuse.formats.report.table import Cell, Column, Table
from locfuse.fusion.doctor.finding import Oddity
from locfuse.fusion.sensors.registry import REGISTRY

from . import text_table

READS, CONFIGURATIONS, SPOILS, WORTH, NEXT = TITLES = (
    "what reads what",
    "configurations",
    "would spoil an estimate",
    "worth knowing",
    "next",
)
TOPICS = (
    Column("topic", "topic", kind="text"),
    Column("type", "type", kind="text", shorter=lambda kind: kind.rpartition("/")[2]),
    Column("messages", "messages"),
    Column("rate_hz", "Hz", form="{:.1f}", missing=""),
    Column("longest_gap_s", "silent", "s", "{:.1f}", missing="", rank=1),
    Column("clock", "clock", kind="text", rank=2),
    Column("frame", "frame", kind="text", rank=3),
    Column("roles", "read by", kind="text"),
)
MOST = 6  # unreadable topics, each with its reason
OPTION = re.compile(r"[.;:?] (?=[^.;:?]*--set )")  # the clause that tells an option: it stands in the next line


def lines(seen: Look, typed: Sequence[str], width: int | None) -> Iterator[str]:
    """Yield everything about a log; `typed` is what the user gave `info`, `width` that of the screen or None."""
    yield _headline(seen)
    yield ""
    yield from _topics(seen, width)
    yield from _roles(seen, width)
    yield from _configurations(seen, width)
    for title, oddities in grouped(seen).items():
        yield from _section(title, [line for o in oddities for line in _oddity(o, width)])
    yield from _section(NEXT, [f"  {command}" for command in _next(seen, typed)])


def grouped(seen: Look) -> dict[str, list[Oddity]]:
    """Return the oddities under what they mean for an estimate."""
    return {
        SPOILS: [o for o in seen.oddities if o.spoils],
        WORTH: [o for o in seen.oddities if not o.spoils],
    }


def _section(title: str, body: Sequence[str]) -> Iterator[str]:
    if body:
        yield ""
        yield title
        yield from body


def _headline(seen: Look) -> str:
    span = seen.log.time_span_ns
    seconds = f"{(span[1] - span[0]) * 1e-9:.1f} s" if span else "no messages"
    count = sum(f.count for f in seen.facts)
    size = sum(p.stat().st_size for p in seen.log.paths) / 1e6
    files = f" in {len(seen.log.paths)} files" if len(seen.log.paths) > 1 else ""
    return f"{seen.log.name}: {seconds}, {count} messages on {len(seen.facts)} topics, {size:.1f} MB{files}"


def _topics(seen: Look, width: int | None) -> Iterator[str]:
    """Yield the table of the topics with messages, those that are read first; then the others."""
    role: dict[str, list[str]] = {}
    for name in seen.choice.topics:
        for topic in seen.choice.of(name):
            role.setdefault(topic, []).append(name)
    full = [f for f in seen.facts if f.count and f.problem is None]
    full.sort(key=lambda f: f.topic not in role)
    yield from (line.rstrip() for line in text_table.lines(_table(full, role), width))
    if empty := [f.topic for f in seen.facts if not f.count]:
        yield from _wrapped("empty: ", ", ".join(empty), width, "  ")
    unreadable = [f for f in seen.facts if f.problem is not None and f.count]
    for f in unreadable[:MOST]:
        yield from _wrapped("not readable: ", f"{f.topic}: {f.problem}", width, "  ")
    if len(unreadable) > MOST:
        yield f"not readable: {len(unreadable) - MOST} more"


def _table(facts: Sequence[TopicFacts], role: Mapping[str, Sequence[str]]) -> Table:
    rows = (
        (
            f.topic,
            f.msgtype.replace("/msg/", "/"),
            f.count,
            f.rate_hz,
            _silence(f),
            clock_word(f),
            f.frame_id,
            ", ".join(role.get(f.topic, ())),
        )
        for f in facts
    )
    return Table(TOPICS, tuple(tuple(map(Cell, row)) for row in rows))


def _silence(f: TopicFacts) -> float | None:
    return max(b - a for a, b in f.gaps) if f.gaps else None


def _roles(seen: Look, width: int | None) -> Iterator[str]:
    frames = {f.topic: f.frame_id for f in seen.facts}
    mounts = extrinsics(seen)
    body: list[str] = []
    for role in seen.choice.topics:
        topics = seen.choice.of(role)
        words = f"{' and '.join(topics)}, {seen.choice.why.get(role, '')}"
        if role in mounts:
            words += f"; {_place(mounts[role], frames[topics[0]])}"
        body += _wrapped(f"  {role:<9}", words, width)
    yield from _section(READS, body)


def _place(mount: dict[str, Any], frame: str) -> str:
    """Say where a sensor sits, and who says so."""
    if mount["by"] == "nobody":
        return f"nothing says where {f'frame {frame}' if frame else 'it'} sits"
    if "mounts" in mount:
        return f"{len(mount['mounts'])} places by {mount['by']}"
    parts = [f"{k} {mount[k] + 0.0:.3g} m" for k in ("x", "y") if k in mount]
    angles = [(k, mount[k]) for k in ("roll_deg", "pitch_deg", "yaw_deg") if round(mount.get(k) or 0.0, 1)]
    parts += [f"{k.removesuffix('_deg')} {v:.3g}°" for k, v in angles]
    parts += ["upside-down"] if mount.get("flipped") else []
    return f"at {', '.join(parts)} by {mount['by']}" if parts else f"level by {mount['by']}"


def _configurations(seen: Look, width: int | None) -> Iterator[str]:
    """Yield what can be estimated, what lacks a setting, and, without alarm, what the log does not carry."""
    known, why = configurations(seen), absent(seen)
    base = wheels_missing(seen)
    ready = [name for name, what in known.items() if what is None]
    body = _wrapped("  ready    ", ", ".join(ready), width) if ready else []
    body += _wrapped("  not yet  ", f"all: {_briefly(base, 'wheels', seen)}", width) if base is not None else []
    foreign = [name for name in REGISTRY if name in seen.choice.foreign]
    for name in REGISTRY:
        if name in why and name not in foreign:
            body += _wrapped(
                "  not yet  ", f"{name}: {_briefly(why[name].removeprefix(f'{name}: '), name, seen)}", width
            )
    body += _wrapped("  no topic ", ", ".join(foreign), width) if foreign else []
    yield from _section(CONFIGURATIONS, body)


def _briefly(words: str, stream: str, seen: Look) -> str:
    """Say once what is told among the oddities too."""
    told = any(o.stream == stream and (o.spoils or o.words == words) for o in seen.oddities)
    return "see below" if told else words


def _oddity(o: Oddity, width: int | None) -> list[str]:
    words = OPTION.split(o.words)[0] if o.cures else o.words
    body = _wrapped(f"  {o.stream}: ", words, width, "    ")
    return [*body, *_options("    cure: ", o.cures, width)] if o.cures else body


def _options(head: str, cures: Sequence[str], width: int | None) -> list[str]:
    """Return --set options, never broken within one."""
    rows, row = [], head
    for option in (f"--set {shlex.quote(cure)}" for cure in cures):
        if width is not None and row.strip() and row != head and len(row) + len(option) > width:
            rows.append(row.rstrip())
            row = " " * len(head)
        row += f"{option} "
    return [*rows, row.rstrip()]


def _wrapped(head: str, words: str, width: int | None, indent: str | None = None) -> list[str]:
    """Return a paragraph; later lines begin under its words, or with `indent`. Nothing is wrapped in a pipe."""
    if width is None:
        return [f"{head}{words}"]
    later = " " * len(head) if indent is None else indent
    return textwrap.wrap(
        words, max(width, 40), initial_indent=head, subsequent_indent=later, break_long_words=False,
        break_on_hyphens=False,
    )  # fmt: skip


def _next(seen: Look, typed: Sequence[str]) -> list[str]:
    """Return the commands to try next: once more with what cures the worst, a robot.toml, or the comparison."""
    cures = dict(cure.partition("=")[::2] for o in seen.oddities if o.spoils for cure in o.cures)
    if cures:
        kept = _without(typed, cures)
        options = [word for key, value in cures.items() for word in ("--set", f"{key}={value}")]
        return [shlex.join(("locfuse", "info", *kept, *options))]
    if seen.loaded is not None:
        return [shlex.join(("locfuse", "compare", *typed))]
    return [f"{shlex.join(('locfuse', 'init', *typed))} > robot.toml"] if seen.choice.of("wheels") else []


def _without(typed: Sequence[str], cures: Collection[str]) -> list[str]:
    """Return what was typed less the --set of keys that are cured."""
    kept: list[str] = []
    for word in typed:
        if kept and kept[-1] == "--set" and word.partition("=")[0] in cures:
            kept.pop()
        else:
            kept.append(word)
    return kept
