"""Results of a measured log: the report, robot.toml, losses, and warnings on the motion."""

from __future__ import annotations

import shlex
from collections.abc import Collection, Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import msgspec

from locfuse import sample_logs
from locfuse.formats.logs.log import Log
from locfuse.formats.report import json_report
from locfuse.formats.report.findings import counts, options
from locfuse.formats.robot import robot_toml
from locfuse.formats.versions import own
from locfuse.fusion.data import Evaluation
from locfuse.fusion.judge.evaluate import ERROR_KEYS
from locfuse.fusion.robot import Robot
from locfuse.fusion.sensors.registry import SOURCES
from locfuse.fusion.streams import parts_of
from locfuse.fusion.wheels.odometry import BODY_READS

from .errors import has_scipy
from .load import EXACT_LASER, Loaded
from .motion_evidence import MotionEvidence
from .robot_tables import flat, make_robot
from .settings import Asked
from .topics import Note
from .wheel_topics import steers, unused_words

BY_SCANS = "scan matching does not show the mount"  # source of its sigmas, which are 0
MIN_COVERED_SHARE = 0.8  # of the log's duration: a motion that covers less is reported
VOIDABLE = (*ERROR_KEYS, "anees")  # figures that depend on errors
REFUSED_SHARE = 0.01  # of a used sensor's readings: if more are refused, it is a loss
# refused readings that are no loss: such as exact repeats, and readings before or after the wheels' readings
NOT_A_LOSS = ("repeat", "outside_wheels", "other_joints", "other_bodies", "not_in_map", "ignored")


def settings_tables(robot: Robot) -> dict[str, Any]:
    """Return the effective settings as tables of robot.toml, without keys that have no value."""
    structs = {"wheels": robot.wheels, "start": robot.start, "truth": robot.truth, **robot.sensors}
    tables: dict[str, Any] = {"order": robot.order, "preset": robot.preset}
    for name, struct in structs.items():
        tables[name] = {k: v for k, v in msgspec.to_builtins(struct).items() if v is not None}
    return tables


def changed_settings(loaded: Loaded) -> dict[str, dict[str, Any]]:
    """Return settings that differ from their defaults by key ("lrf.x"): value, unit, source; of used sensors."""
    plain = flat(settings_tables(make_robot({})))
    found: dict[str, dict[str, Any]] = {}
    for path, value in flat(settings_tables(loaded.robot)).items():
        table, _, key = path.partition(".")
        if table not in loaded.drive.absent and plain.get(path) != value:
            by_scans = loaded.drive.wheels.matched is not None and path in flat(EXACT_LASER)
            source = loaded.sources.get(path, BY_SCANS if by_scans else "found in the log")
            found[path] = {"value": value, "unit": robot_toml.unit_of(table, key), "from": source}
    return found


def repeat(loaded: Loaded, asked: Asked) -> str:
    """Return the command that reproduces this result from the folder of results, with the log beside it.

    All settings are in the folder's robot.toml. The command has no date, no path and no -o, so it is the same for
    equal results, from the command line or from Python.
    """
    words = ["locfuse", "compare", *log_words(loaded.log), "--robot", "robot.toml"]
    words += [word for sensors in asked.sensors for word in ("--sensors", sensors)]
    words += ["--all-subsets"] * asked.all_subsets
    words += [] if asked.smooth is None else ["--smooth" if asked.smooth else "--no-smooth"]
    words += ["--jitter", str(asked.jitter)] if asked.jitter else []
    words += ["--reference" if asked.reference else "--no-reference"] if loaded.drive.truth is None else []
    words += ["--align", asked.align] if asked.align != "none" else []
    for option, bound in zip(("--from", "--to"), loaded.window, strict=True):
        words += [] if bound is None else [option, f"{bound:g}"]
    return shlex.join(words)


def log_words(log: Log, as_given: bool = False) -> list[str]:
    """Return a log as command-line arguments: its file names, or if `as_given` the paths that the user typed."""
    if log.name in sample_logs.names() and log.paths[0] == sample_logs.path(log.name):
        return [log.name]
    if as_given:
        return [str(place) for place in log.given]
    names = [path.name for path in log.paths]
    in_folder = len({p.parent for p in log.paths}) == 1 and log.paths[0].parent.name == log.name
    return [f"{log.name}/"] if in_folder and not {*log.given} & {*log.paths} else names


def build(loaded: Loaded, evaluations: Sequence[Evaluation]) -> dict[str, Any]:
    """Return the report of these evaluations as plain values; verdicts are added later."""
    log = loaded.log
    source = {
        "name": log.name,
        "files": [p.name for p in log.paths],
        "size": log.identity.size,
        "identity": log.identity.digest,
        "sha256": log.sha256 if loaded.how.hash_all or log.all_read else None,
        **({"etag": ", ".join(log.etags)} if log.etags else {}),  # of a remote log
        "start": _date(loaded.drive.epoch_ns),
        "topics": dict(loaded.choice.topics),
        "messages": {topic: info.count for topic, info in log.topics.items()},
        "losses": log.losses.by_reason(),
        "refused": _refusals(loaded),
    }
    report = json_report.report(loaded.drive, evaluations, source, settings_tables(loaded.robot), own())
    report["made_with"] |= {s: SOURCES[s] for s in loaded.robot.sensors if s in SOURCES}
    return report


def _refusals(loaded: Loaded) -> dict[str, dict[str, int]]:
    """Return {stream: {"readings": number refused, "of": number of all}} for streams with refused readings."""
    found = {}
    for stream, reasons in loaded.drive.dropped.items():
        if refused := sum(_losses(reasons).values()):
            promised = sum(loaded.log.topics[t].count for t in loaded.choice.of(stream))
            found[stream] = {"readings": refused, "of": promised}
    return found


def _date(epoch_ns: int) -> str | None:
    """Return the time of the first wheel reading (ns since 1970) in UTC; None if it is no valid date."""
    try:
        return datetime.fromtimestamp(epoch_ns // 1_000_000_000, UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
    except (ValueError, OverflowError, OSError):
        return None


def default_folder(name: str) -> Path:
    """Return the default folder of results."""
    return Path("locfuse-out") / name


def loss_lines(loaded: Loaded, used: Sequence[str], strict: bool) -> list[str]:
    """Return losses in words: bytes of the file, and used streams with too many refused readings."""
    source = {"refused": _refusals(loaded), "dropped": loaded.drive.dropped}
    return [*loaded.log.losses.lines(), *_refused_lines(source, used, strict)]


def lost_in(report: Mapping[str, Any], strict: bool) -> list[str]:
    """Return losses of a finished report in words, with the rules of `loss_lines`."""
    source = report["input"]
    bytes_lost = [f"{reason} ({lost['bytes']} bytes)" for reason, lost in source.get("losses", {}).items()]
    used = sorted({s for values in report["configurations"].values() for s in values["sensors"]})
    return [*bytes_lost, *_refused_lines(source, used, strict)]


def _refused_lines(source: Mapping[str, Any], used: Sequence[str], strict: bool) -> list[str]:
    lines, refused = [], source.get("refused", {})
    for stream in (s for s in ("wheels", *used) if s in refused):
        count, total = refused[stream]["readings"], refused[stream]["of"]
        if count > (0 if strict else REFUSED_SHARE * total):
            why = counts(_losses(source["dropped"][stream]))
            lines.append(f"{stream}: {count} of {total} readings refused ({why})")
    return lines


def _losses(reasons: Mapping[str, int]) -> dict[str, int]:
    return {reason: count for reason, count in reasons.items() if reason not in NOT_A_LOSS}


# --- Warnings on the motion: void figures, unused wheels


def say_motion(report: dict[str, Any], loaded: Loaded, judged: bool) -> None:
    """Add warnings on the robot's motion to the report, most of them at the start of its headline.

    All figures become void (not valid) if the motion is not the robot's. With `judged`, wheel counters are also
    compared with scan matching.
    """
    if loaded.motion_faults:
        _void_all(report, loaded.motion_faults)
    if judged and (words := _behind_scans(loaded)):
        report["notes"].append(f"wheels: {words}")
    first = [note.words for note in loaded.choice.notes if note.first]
    if loaded.window == (None, None):
        first += [f"wheels: {part.clock.again}" for part in parts_of(loaded.stream("wheels")) if part.clock.again]
    for words in filter(None, (*first, _partial_motion(loaded))):
        report["headline"] = f"{words[0].upper()}{words[1:]}. {report['headline']}"
    if words := unused_words(loaded.choice):
        typed = (f"{key}={flat(loaded.tables)[key]}" for key, who in loaded.sources.items() if who == "--set")
        sets = (word for setting in typed for word in ("--set", setting))
        log = log_words(loaded.log, as_given=True)
        command = shlex.join(("locfuse", "init", *log, *sets, "-o", "robot.toml"))
        truth = loaded.drive.truth
        known = truth is not None and truth.theta is not None
        by = "finds them by the truth, or says why not" if known else "needs a truth with headings to find them"
        does = by if steers(loaded.choice.unused_wheels) else "asks for them"
        report["headline"] = f"{words}: `{command}` {does}. {report['headline']}"


def _behind_scans(loaded: Loaded) -> str:
    """Return a warning if scan matching fits the laser better than the wheel counters do; else ""."""
    topics, lasers = loaded.choice.of("wheels"), loaded.choice.of("lrf")
    encoders = loaded.log.topics[topics[0]].msgtype not in BODY_READS
    if not encoders or len(lasers) != 1 or loaded.reading is None or not has_scipy():
        return ""
    return MotionEvidence(loaded.log, loaded.robot, lasers[0], {}).behind(topics, loaded.reading)


def _partial_motion(loaded: Loaded) -> str:
    """Return a warning if the motion covers only part of the log; else ""."""
    span, t = loaded.log.time_span_ns, loaded.drive.wheels.t
    if span is None or loaded.window != (None, None):
        return ""
    covered, whole = float(t[-1] - t[0]), (span[1] - span[0]) * 1e-9
    if (known := loaded.log.stamps_clock) is not None and len(known[0]) > 1:
        stamped, recorded = known[1][[0, -1]], known[0][[0, -1]]
        whole *= float((stamped[1] - stamped[0]) / (recorded[1] - recorded[0]))  # a simulation may run slower
    if covered >= MIN_COVERED_SHARE * whole:
        return ""
    topics = " and ".join(loaded.choice.of("wheels"))
    return f"The motion by {topics} covers {covered:.1f} s of the {whole:.1f} s of this log"


def void_figures(values: dict[str, Any], reason: str) -> None:
    """Move the figures of a configuration that depend on errors to `void`, and set them to None."""
    known = {key: values[key] for key in VOIDABLE if values.get(key) is not None}
    values["void"] = {"reason": reason, "figures": {**values.get("void", {}).get("figures", {}), **known}}
    values.update(dict.fromkeys(known))


def withdraw_verdicts(report: dict[str, Any], words: str, sensors: Collection[str] | None = None) -> None:
    """Replace verdicts of `sensors` (None: all) by "no verdict", since their figures are void or doubtful."""
    for sensor, verdict in (report.get("verdicts") or {}).items():
        if sensors is None or sensor in sensors:
            verdict.update(verdict="no verdict", words=words)


def _void_all(report: dict[str, Any], faults: Sequence[Note]) -> None:
    """Set all figures and verdicts of a report to void, since its motion is not the robot's."""
    message = "; ".join(f"{n.role}: {n.words}" + (f": {options(n.fixes)}" if n.fixes else "") for n in faults)
    for values in report["configurations"].values():
        void_figures(values, message)
    withdraw_verdicts(report, "What is used as the motion is not the robot's.")
    report.update(dict.fromkeys(key for key in ("credit", "prediction") if report.get(key) is not None))
    entry = {"code": "motion", "message": message, "since_s": 0.0, "void": True}
    report["validity"] = [{**entry, "configurations": [*report["configurations"]]}]
    report["headline"] = f"No verdict on this log: {message}."
