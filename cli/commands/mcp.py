"""`locfuse mcp`: tools for an AI agent, by the Model Context Protocol over standard input and output.

Only files inside the command's folders are read: links are resolved before the check, and files named in settings
are checked too. Answers contain no arrays and no whole reports, only the names of their files.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import wraps
from pathlib import Path
from threading import Lock
from typing import TYPE_CHECKING, Any

import click

from locfuse.cli.analysis.errors import expected
from locfuse.cli.analysis.robot_tables import file_named, files_of, texts_of
from locfuse.cli.analysis.settings import Asked, LogOptions, set_words, silent
from locfuse.cli.session import tune
from locfuse.cli.session.calibrate import calibrated
from locfuse.cli.session.found import Found
from locfuse.cli.session.python_words import in_tools
from locfuse.cli.session.session import inspected, opened, tried_by_fusing
from locfuse.cli.terminal import options as o
from locfuse.formats.logs.files import ENDINGS, log_files
from locfuse.formats.report import json_report
from locfuse.formats.report.findings import notes_of, sentence, void_reasons
from locfuse.formats.report.glossary import GLOSSARY
from locfuse.formats.robot import robot_toml
from locfuse.formats.versions import own
from locfuse.formats.whole_files import write_text
from locfuse.fusion.data import UsageError

from .words import meaning

if TYPE_CHECKING:
    from mcp.server.mcpserver import MCPServer

INSTRUCTIONS = (
    "locfuse computes from recorded logs what each sensor of a wheeled robot adds: info() lists the logs, "
    "info(log) shows what is in one, compare(log) which sensors to keep and which settings are wrong. Findings "
    "have fixes: pass them as settings, {'table.key': value}, and compare again. Read the headline first; figures "
    "of a log with void or doubtful entries must not be used."
)
MAX_LISTED = 200  # logs and notes of one answer
FIGURES = ("position_rmse_m", "heading_rmse_deg", "anees", "lost_share", "revisit_agreement")
Settings = dict[str, Any]  # {"table.key": value} of robot.toml


@click.command()
@click.argument("folders", nargs=-1, required=True, type=click.Path(path_type=Path, file_okay=False, exists=True))
@o.option("-o --out", "Folder for the results.", required=True, type=o.DIRECTORY)
def mcp(folders: tuple[Path, ...], out: Path) -> None:
    """Let an AI agent use locfuse, by the Model Context Protocol over stdin and stdout.

    The agent can read logs below FOLDERS only, and write below -o only. Its program starts this command.

    \b
    pip install 'locfuse[mcp]'
    locfuse mcp bags/ -o results/
    """
    served(Tools(folders, out)).run("stdio")


def served(tools: Tools) -> MCPServer:
    """Return an MCP server with these tools. Raises ModuleNotFoundError if the SDK is not installed."""
    from mcp.server.mcpserver import MCPServer
    from mcp.server.mcpserver.exceptions import ToolError

    server = MCPServer("locfuse", instructions=INSTRUCTIONS, version=own(), log_level="ERROR")
    lock = Lock()

    def one_at_a_time(tool: Any) -> Any:
        """Return the tool with a lock against parallel calls, and with one-line errors."""

        @wraps(tool)
        def call(*args: Any, **keywords: Any) -> Any:
            try:
                with lock:
                    return _in_tool_words(tool(*args, **keywords))
            except Exception as problem:
                known = expected(problem)
                if known is None:
                    raise
                raise ToolError(_in_tool_words(known[0])) from None

        return call

    for tool in (tools.info, tools.compare, tools.tune, tools.calibrate, tools.explain):
        server.add_tool(one_at_a_time(tool))
    return server


@dataclass
class AgentFinding:
    """A finding: something missing, wrong, or improvable."""

    role: str  # sensor, wheels, truth, start ...
    code: str  # stays the same from version to version
    message: str
    fixes: list[str]  # "table.key=value" each: give them as `settings`


@dataclass
class ToolAnswer:
    """The answer of a tool."""

    headline: str
    findings: list[AgentFinding] = field(default_factory=list)
    values: dict[str, Any] = field(default_factory=dict)  # SI units, degrees where a key ends in _deg
    files: list[str] = field(default_factory=list)  # files with all results, also arrays


class Tools:
    """The tools of the server, for logs below `folders`; results are written below `out`."""

    def __init__(self, folders: Sequence[Path], out: Path) -> None:
        self._folders = [folder.resolve() for folder in folders]
        self._out = out.resolve()

    def info(self, log: str = "", settings: Settings | None = None, check: bool = False) -> ToolAnswer:
        """Show what is in a log, which topic each sensor uses, what is missing, and what looks wrong, with fixes.

        Without `log`, list the logs. `check` also tries the fixes by fusing (minutes on a long log).
        """
        if not log:
            return self._listed()
        words, how = [str(self._below(log))], self._how(settings)
        found = inspected(words, how, silent)
        tried = tried_by_fusing(words, how, silent) if check else {}
        kinds = found["topics"].items()
        topics = {name: f"{t['type']}, {t['messages']} messages, {t['rate_hz'] or 0:.3g} Hz" for name, t in kinds}
        state = "an estimate would be spoiled" if found["severe"] else "nothing speaks against a run"
        headline = tried.get("headline") or f"{found['name']}: {found['duration_s'] or 0:.1f} s; {state}."
        brief = {key: found[key] for key in ("duration_s", "roles", "absent", "configurations", "severe")}
        file = self._write(f"{found['name']}.info.json", {**found, **({"tried": tried} if check else {})})
        findings = _findings([*found["findings"], *(tried.get("findings") or ())])
        return ToolAnswer(headline, findings, {**brief, "topics": topics}, [file])

    def compare(
        self,
        log: str,
        sensors: list[str] | None = None,
        settings: Settings | None = None,
        align: str = "none",
        smooth: bool | None = None,
    ) -> ToolAnswer:
        """Return what each sensor of a log adds: errors of all configurations, verdicts, what looks wrong, fixes.

        `sensors` are configurations, such as ["odometry", "compass,lrf", "all"]; none: odometry, each alone, all.
        `align` "se2" judges only the shape of the path. `smooth` adds smoothed paths; null: of configurations with
        the laser, if the log allows it.
        """
        asked = Asked(tuple(sensors or ()), align=align, smooth=smooth, audits=False)
        result = opened([str(self._below(log))], self._how(settings), silent).compared(asked)
        report = result.report
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
        files = result.write(self._out / result.loaded.log.name)
        return ToolAnswer(result.headline, _findings(result.findings), values, list(map(str, files)))

    def tune(self, logs: list[str], sensors: str = "all", settings: Settings | None = None) -> ToolAnswer:
        """Estimate wheel and sensor noise from logs of one robot, without truth (a long log takes minutes)."""
        paths = [[self._below(log)] for log in logs]
        found = tune.tune_logs(paths, [], tune.sensor_names(sensors), False, self._how(settings), silent)
        refused = "A log gets worse with the noise that was found: it is not used."
        return self._found(found, refused if found.refused else f"Noise from {_logs(logs)}.")

    def calibrate(self, logs: list[str], settings: Settings | None = None) -> ToolAnswer:
        """Estimate wheel noise, radius and track, laser mount and magnetometer iron from logs of one robot."""
        found = calibrated([[self._below(log)] for log in logs], self._how(settings), silent)
        return self._found(found, f"Calibration from {_logs(logs)}.")

    def explain(self, term: str = "") -> ToolAnswer:
        """Explain a term of an answer or a report: ANEES, lrf, drift; without `term`, all terms except sensors."""
        return ToolAnswer(meaning(term)) if term else ToolAnswer("Words of reports.", values=dict(GLOSSARY))

    def _found(self, found: Found, headline: str) -> ToolAnswer:
        name = f"{found.loaded[0].log.name}.{found.command}"
        values = self._write(f"{name}.json", found.values())
        files = [str(found.write(self._out / f"{name}.robot.toml", overwrite=True)), values]
        rows = [dict(zip(found.titles, row, strict=True)) for row in found.rows()]
        answer = {"settings": found.tables(), "found": rows, "notes": list(found.notes)}
        return ToolAnswer(headline, [], answer, files)

    def _listed(self) -> ToolAnswer:
        there = (path for folder in self._folders for ending in ENDINGS for path in folder.rglob(ending))
        logs = sorted(path for path in there if path.is_file() and self._inside(path))
        names = {str(path): path.stat().st_size for path in logs[:MAX_LISTED]}
        more = "" if len(logs) <= MAX_LISTED else f", the first {MAX_LISTED} are listed"
        return ToolAnswer(f"{_logs(logs)}{more}.", values={"bytes": names})

    def _inside(self, path: Path) -> bool:
        place = path.resolve()
        return any(place.is_relative_to(folder) for folder in self._folders)

    def _below(self, word: str) -> Path:
        """Return the path of a file or folder inside the allowed folders. Raises UsageError for any other path."""
        there = (folder / word for folder in self._folders if "\0" not in word and (folder / word).exists())
        found = next(there, None)
        parts: list[Any] = [] if found is None else [found]
        if found is not None and found.is_dir() and self._inside(found):
            parts += [*log_files(found), found / "metadata.yaml"]
        if found is None or not all(isinstance(part, Path) and self._inside(part) for part in parts):
            allowed = ", ".join(map(str, self._folders))
            raise UsageError(f"{word!r} is not below the folders that this server may read: {allowed}")
        return found

    def _how(self, settings: Settings | None) -> LogOptions:
        """Return the options for reading a log with these settings. Raises UsageError for a file outside."""
        words = list(set_words(settings or {}))
        tables = robot_toml.apply_sets(words)
        for table, key, text in list(files_of(tables)):
            value, place = tables[table][key], str(self._below(text))
            now = place if isinstance(value, str) else [place if one == text else one for one in value]
            tables[table][key] = now
            words.append(robot_toml.as_set(f"{table}.{key}", now))
        for text in texts_of(tables):
            if (path := file_named(text)) is not None and not self._inside(path):
                raise UsageError(f"{text!r} is a file outside the folders that this server may read")
        return LogOptions(sets=tuple(words), quiet=True)

    def _write(self, name: str, values: Mapping[str, Any]) -> str:
        """Write values as JSON in the output folder; return the file's path."""
        self._out.mkdir(parents=True, exist_ok=True)
        write_text(self._out / name, json_report.encode(values))
        return str(self._out / name)


def _findings(found: Iterable[Mapping[str, Any]]) -> list[AgentFinding]:
    """Return findings in short form, without duplicates; the effect of a tried fix is in the message."""
    unique = {
        (f["role"], f["code"], f["message"]): AgentFinding(
            f["role"], f["code"], sentence(f) if "tried" in f else str(f["message"]), list(f["fixes"])
        )
        for f in found
    }
    return list(unique.values())


def _in_tool_words(part: Any) -> Any:
    """Return an answer, or part of it, with command-line options replaced by the tools' arguments."""
    if isinstance(part, ToolAnswer):
        words = {name: _in_tool_words(getattr(part, name)) for name in ("headline", "findings", "values")}
        return replace(part, **words)
    if isinstance(part, AgentFinding):
        return replace(part, message=in_tools(part.message))
    if isinstance(part, dict):
        return {key: _in_tool_words(value) for key, value in part.items()}
    if isinstance(part, list):
        return [_in_tool_words(value) for value in part]
    return in_tools(part) if isinstance(part, str) else part


def _logs(logs: Sequence[object]) -> str:
    return f"{len(logs)} log" + "s" * (len(logs) != 1)
