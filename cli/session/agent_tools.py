"""The tools of `locfuse mcp` for an agent: short answers on logs below some folders, files in one other.

Nothing outside these folders is read: links are followed before a path is compared, and settings that name files
are held to the same rule. Arrays and whole reports are not part of an answer, it names the files that hold them.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from locfuse.cli.analysis.robot_tables import files_of, texts_of
from locfuse.cli.analysis.settings import Asked, LogOptions, set_words, silent
from locfuse.formats.logs.files import ENDINGS, log_files
from locfuse.formats.report import json_report
from locfuse.formats.report.findings import notes_of, sentence, void_reasons
from locfuse.formats.robot import robot_toml
from locfuse.formats.whole_files import write_text
from locfuse.fusion.data import UsageError

from .explain import explain
from .found import Found
from .python_words import in_tools
from .result import Comparison
from .session import inspected, opened, tried_by_fusing

MAX_LISTED = 200  # logs and notes of one answer
FIGURES = ("position_rmse_m", "heading_rmse_deg", "anees", "lost_share", "revisit_agreement")
Settings = dict[str, Any]  # {"table.key": value} of robot.toml


@dataclass
class AgentFinding:
    """A finding: something missing, wrong, or improvable."""

    role: str  # sensor, wheels, truth, start ...
    code: str  # stays the same from version to version
    message: str
    fixes: list[str]  # "table.key=value" each: give them as `settings`


@dataclass
class Answer:
    """The answer of a tool."""

    headline: str
    findings: list[AgentFinding] = field(default_factory=list)
    values: dict[str, Any] = field(default_factory=dict)  # SI units, degrees where a key ends in _deg
    files: list[str] = field(default_factory=list)  # that hold everything, arrays included


class Tools:
    """The tools, for logs below `folders`; results are written below `out`."""

    def __init__(self, folders: Sequence[Path], out: Path) -> None:
        self._folders = [folder.resolve() for folder in folders]
        self._out = out.resolve()

    def info(self, log: str = "", settings: Settings | None = None, check: bool = False) -> Answer:
        """Say what is in a log, which sensor reads which topic, what is missing, and what looks wrong, with fixes.

        Without `log`, list the logs. `check` also tries the fixes by fusing (minutes on a long log).
        """
        if not log:
            return self._listed()
        words, how = [str(self._below(log))], self._how(settings)
        found = inspected(words, how, silent)
        tried = tried_by_fusing(words, how, silent) if check else {}
        topics = {
            name: f"{t['type']}, {t['messages']} messages, {t['rate_hz'] or 0:.3g} Hz"
            for name, t in found["topics"].items()
        }
        listed = [*found["findings"], *(tried.get("findings") or ())]
        state = "an estimate would be spoiled" if found["severe"] else "nothing speaks against a run"
        headline = tried.get("headline") or f"{found['name']}: {found['duration_s'] or 0:.1f} s; {state}."
        brief = {key: found[key] for key in ("duration_s", "roles", "absent", "configurations", "severe")}
        whole = {**found, **({"tried": tried} if check else {})}
        files = [self._write(f"{found['name']}.info.json", whole)]
        return Answer(headline, _findings(listed), {**brief, "topics": topics}, files)

    def compare(
        self,
        log: str,
        sensors: list[str] | None = None,
        settings: Settings | None = None,
        align: str = "none",
        smooth: bool | None = None,
    ) -> Answer:
        """Say what each sensor of a log is worth: errors of all configurations, verdicts, what looks wrong, fixes.

        `sensors` are configurations, such as ["odometry", "compass,lrf", "all"]; none: odometry, each alone, all.
        `align` "se2" judges the shape of the path only. `smooth` adds paths from the whole drive; null: those with
        the laser, where the log allows it.
        """
        asked = Asked(tuple(sensors or ()), align=align, smooth=smooth, audits=False)
        return self._compared(opened([str(self._below(log))], self._how(settings), silent).compared(asked))

    def tune(self, logs: list[str], sensors: str = "all", settings: Settings | None = None) -> Answer:
        """Find the noise of wheels and sensors from logs of one robot, without truth (minutes on a long log)."""
        from . import tune

        paths = [[self._below(log)] for log in logs]
        found = tune.tune_logs(paths, [], tune.sensor_names(sensors), False, self._how(settings), silent)
        refused = "A log gets worse with the noise that was found: it is not used."
        return self._found(found, refused if found.refused else f"Noise from {_logs(logs)}.")

    def calibrate(self, logs: list[str], settings: Settings | None = None) -> Answer:
        """Find wheel noise, radius and track, laser mount and magnetometer iron from logs of one robot."""
        from . import calibrate

        paths = [[str(self._below(log))] for log in logs]
        found = calibrate.calibrated(paths, self._how(settings), silent)
        return self._found(found, f"Calibration from {_logs(logs)}.")

    def explain(self, term: str = "") -> Answer:
        """Say what a word of an answer or a report means: ANEES, lrf, drift; without `term`, all but sensors."""
        from locfuse.formats.report.glossary import GLOSSARY

        return Answer(explain(term)) if term else Answer("Words of reports.", values=dict(GLOSSARY))

    def _compared(self, result: Comparison) -> Answer:
        report = result.report
        files = result.write(self._out / result.loaded.log.name)
        values = {
            "verdicts": {s: v["verdict"] for s, v in report["verdicts"].items()},
            "configurations": {
                name: {key: c[key] for key in FIGURES if c.get(key) is not None}
                for name, c in report["configurations"].items()
            },
            "truth": None if report["truth"] is None else report["truth"]["topic"],
            "void": void_reasons(report),
            "doubtful": [v["message"] for v in report["validity"] if not v["void"]],
            "path_doubted": report.get("doubt"),
            "absent": report["absent"],
            "notes": notes_of(report)[:MAX_LISTED],
        }
        return Answer(result.headline, _findings(result.findings), values, list(map(str, files)))

    def _found(self, found: Found, headline: str) -> Answer:
        name = f"{found.loaded[0].log.name}.{found.command}"
        values = self._write(f"{name}.json", found.values())
        files = [str(found.write(self._out / f"{name}.robot.toml", overwrite=True)), values]
        rows = [dict(zip(found.titles, row, strict=True)) for row in found.rows()]
        return Answer(headline, [], {"settings": found.tables(), "found": rows, "notes": list(found.notes)}, files)

    def _listed(self) -> Answer:
        logs = list(self._logs())
        names = {str(path): path.stat().st_size for path in sorted(logs)[:MAX_LISTED]}
        more = "" if len(logs) <= MAX_LISTED else f", the first {MAX_LISTED} are listed"
        return Answer(f"{_logs(logs)}{more}.", values={"bytes": names})

    def _logs(self) -> Iterator[Path]:
        for folder in self._folders:
            for ending in ENDINGS:
                yield from (path for path in folder.rglob(ending) if path.is_file() and self._inside(path))

    def _inside(self, path: Path) -> bool:
        place = path.resolve()
        return any(place.is_relative_to(folder) for folder in self._folders)

    def _below(self, word: str) -> Path:
        """Return the path of a file or folder, given whole or below one of the folders. Raises UsageError."""
        found = [folder / word for folder in self._folders if "\0" not in word and (folder / word).exists()]
        allowed = ", ".join(map(str, self._folders))
        outside = UsageError(f"{word!r} is not below the folders that this server may read: {allowed}")
        if not found or not self._inside(found[0]):
            raise outside
        parts = [*log_files(found[0]), found[0] / "metadata.yaml"] if found[0].is_dir() else []
        if not all(isinstance(part, Path) and self._inside(part) for part in parts):
            raise outside
        return found[0]

    def _how(self, settings: Settings | None) -> LogOptions:
        """Return the options to read a log under these settings. Raises UsageError for a file outside."""
        words = list(set_words(settings or {}))
        tables = robot_toml.apply_sets(words)
        named = list(files_of(tables))
        for table, key, text in named:
            value = tables[table][key]
            place = str(self._below(text))
            now = place if isinstance(value, str) else [place if one == text else one for one in value]
            tables[table][key] = now
            words.append(robot_toml.as_set(f"{table}.{key}", now))
        for text in texts_of(tables):
            if _is_file(text) and not self._inside(Path(text).expanduser()):
                raise UsageError(f"{text!r} is a file outside the folders that this server may read")
        return LogOptions(sets=tuple(words), quiet=True)

    def _write(self, name: str, values: Mapping[str, Any]) -> str:
        """Write values beside the folder of `compare`; return the file."""
        self._out.mkdir(parents=True, exist_ok=True)
        write_text(self._out / name, json_report.encode(values))
        return str(self._out / name)


def _findings(found: Iterable[Mapping[str, Any]]) -> list[AgentFinding]:
    """Return findings in short form, each once: the trial of a fix is in its sentence."""
    unique = {
        (f["role"], f["code"], f["message"]): AgentFinding(
            f["role"], f["code"], sentence(f) if "tried" in f else str(f["message"]), list(f["fixes"])
        )
        for f in found
    }
    return list(unique.values())


def spoken(part: Any) -> Any:
    """Return an answer, or a part of it, whose messages name settings in the words of these tools."""
    if isinstance(part, Answer):
        words = {name: spoken(getattr(part, name)) for name in ("headline", "findings", "values")}
        return replace(part, **words)
    if isinstance(part, AgentFinding):
        return replace(part, message=in_tools(part.message))
    if isinstance(part, dict):
        return {key: spoken(value) for key, value in part.items()}
    if isinstance(part, list):
        return [spoken(value) for value in part]
    return in_tools(part) if isinstance(part, str) else part


def _logs(logs: Sequence[object]) -> str:
    return f"{len(logs)} log" + "s" * (len(logs) != 1)


def _is_file(text: str) -> bool:
    try:
        return Path(text).expanduser().is_file()
    except (OSError, ValueError, RuntimeError):  # too long, or a NUL in it: no path
        return False
