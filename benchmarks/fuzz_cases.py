"""One fuzz case: a seed decides what is damaged and how, the command line is run, an oracle judges what it did.

What must hold: a log with checksums gives the trajectory of its healthy twin, or exit 3 with the loss counted, or
exit 1 with one line. Where the damage cannot be seen (no checksums, other messages, another robot.toml) values may
change too, but every number is finite and every covariance is positive. There is never a traceback, no control
character of the log reaches a terminal or a file, every input stays as it was, and nothing is left half written.
"""

from __future__ import annotations

import contextlib
import io
import json
import random
import shutil
import traceback
from dataclasses import dataclass, field
from pathlib import Path
from random import Random
from typing import Any, NamedTuple

import click
import numpy as np

from benchmarks.fuzz_damage import damaged, odd_toml, record_starts
from benchmarks.fuzz_logs import Base, bases, contents
from locfuse.cli.main import main
from locfuse.formats.visible import UNSEEN
from locfuse.formats.whole_files import TEMPORARY

REAL_ROBOT = ("--set", "wheels.radius=0.033", "--set", "wheels.track=0.16")  # for logs that do not say
COLUMNS = 10  # of trajectory.csv: t, x, y, theta and the upper triangle of P
MIN_VARIANCE = 1e-18  # that of a nanometre: below, it is what rounding leaves of an exact start
TEXTS = {".md", ".html", ".json", ".toml", ".csv", ".tex", ".svg", ".tum", ".txt"}


@dataclass(frozen=True)
class Case:
    """A log, the files beside it, and what is asked of them; `{here}` in a word stands for the folder."""

    title: str
    log: bytes
    suffix: str = ".mcap"
    healthy: str = ""  # the log whose trajectory must come out if the damage is not noticed
    beside: dict[str, bytes] = field(default_factory=dict)  # name -> content
    words: tuple[str, ...] = ()
    command: tuple[str, ...] = ("run",)
    name: str = "log"  # of the log file, without its ending

    def write(self, folder: Path) -> Path:
        """Write everything into an empty folder and return the log."""
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir(parents=True)
        for name, content in self.beside.items():
            (folder / name).write_bytes(content)
        log = folder / f"{self.name}{self.suffix}"
        log.write_bytes(self.log)
        return log

    def save(self, folder: Path) -> None:
        """Keep the case to be looked at."""
        self.write(folder)
        (folder / "case.json").write_text(json.dumps({"words": [*self.command, *self.words], "title": self.title}))

    def line(self, log: Path) -> list[str]:
        """Return the command line."""
        command, *options = self.command
        words = [word.replace("{here}", str(log.parent)) for word in self.words]
        results = ["-o", str(log.parent / "out")]
        out = {
            "run": [*results, "--write", "all"],  # what is judged stands in trajectory.csv
            "compare": results,
            "recover": ["-o", str(log.parent / "fixed.mcap")],
            "view": ["--save", str(log.parent / "drive.rrd")],
        }
        return [command, str(log), *options, *out.get(command, []), *words]


class Done(NamedTuple):
    """What a command did."""

    code: int
    out: str
    err: str


@dataclass
class Workshop:
    """Healthy logs, and what the product made of them."""

    bases: list[Base] = field(default_factory=bases)
    trajectories: dict[str, bytes] = field(default_factory=dict)  # base -> trajectory.csv
    robots: dict[str, str] = field(default_factory=dict)  # base -> its effective robot.toml

    def learn(self, folder: Path) -> None:
        """Run every healthy log once."""
        for base in self.bases:
            healthy = Case(base.name, base.data, base.suffix, words=_words(base))
            locfuse(*healthy.line(healthy.write(folder)))
            csv, toml = folder / "out" / "trajectory.csv", folder / "out" / "robot.toml"
            if csv.exists():
                self.trajectories[base.name] = csv.read_bytes()
                self.robots[base.name] = toml.read_text()

    def case(self, seed: int) -> Case:
        """Return the case that belongs to a seed."""
        rng = random.Random(seed)
        base = rng.choices(self.bases, [b.weight for b in self.bases])[0]
        command = ("compare",) if rng.random() < 0.05 else ("run",)
        if base.name in self.robots and rng.random() < 0.25:
            toml, words = odd_toml(rng, self.robots[base.name]), (*_words(base), "--robot", "{here}/robot.toml")
            beside = {"robot.toml": toml}
            return Case(f"{base.name}: robot.toml", base.data, base.suffix, "", beside, words, command)
        log, names = _damaged(rng, base)
        healthy = base.name if base.checked else ""
        title = f"{base.name}: {', '.join(names)}"
        return Case(title, log, base.suffix, healthy, words=_words(base), command=command)

    def judge(self, case: Case, folder: Path) -> str:
        """Run a case and return what is wrong with the outcome, "" for nothing."""
        return judge(case, folder, self.trajectories.get(case.healthy))


def _words(base: Base) -> tuple[str, ...]:
    return REAL_ROBOT if base.real else ()


def _damaged(rng: Random, base: Base) -> tuple[bytes, list[str]]:
    data, names, starts = base.data, [], []
    with contextlib.suppress(Exception):  # a real log that is damaged already
        starts = list(record_starts(data)) if base.suffix == ".mcap" else []
    for _ in range(rng.choice((1, 1, 1, 2))):
        if data:
            data, name = damaged(rng, data, starts=starts)
            names.append(name)
    return data, names


def locfuse(*words: str) -> Done:
    """Run the command line in this process."""
    out, err = io.StringIO(), io.StringIO()
    code = 0
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        try:
            main(list(words))
        except SystemExit as e:
            code = int(e.code or 0)
        except Exception:
            traceback.print_exc()
            code = -1
    return Done(code, out.getvalue(), err.getvalue())


def judge(case: Case, folder: Path, healthy: bytes | None = None) -> str:
    """Run a case and return what is wrong with the outcome, "" for nothing."""
    log = case.write(folder)
    before = {path: path.read_bytes() for path in folder.iterdir()}
    done = locfuse(*case.line(log))
    short = "--check" not in case.command  # its lines name settings
    wrong = words_are_wrong(done, short) or _acts(done, folder, before) or _changed(folder, before)
    if not wrong and done.code in {0, 3}:
        if case.command[0] == "run":
            wrong = files_are_wrong(folder, lost=done.code == 3 and "--strict" not in case.words)
        elif case.command[0] == "recover":
            wrong = _unreadable(folder / "fixed.mcap")
    if not wrong and done.code == 0 and case.command == ("run",) and healthy is not None:
        same = (folder / "out" / "trajectory.csv").read_bytes() == healthy
        wrong = "" if same else "damage that checksums show changed the trajectory, without a word"
    if not wrong and (command := {0: "info", 1: "init"}.get(len(case.log) % 8)):
        wrong = words_are_wrong(locfuse(command, str(log)))
    return wrong


def words_are_wrong(done: Done, short: bool = True) -> str:
    """Hold exit code and stderr against the contract; `short`: a refusal is one line, a loss has numbers."""
    text = done.err
    if "Traceback" in text:
        return text[text.index("Traceback") :][-3000:]
    if "Warning:" in text:
        return f"a warning of the runtime reaches the user: {text[-500:]}"
    if done.code not in {0, 1, 2, 3}:
        return f"exit {done.code}: {text[-500:]}"
    if "out of memory" in text:
        return "more memory than a case may take"
    if not short:
        return ""
    if done.code in {1, 2} and (text.count("\n") != 1 or not text.startswith("locfuse: ")):
        return f"exit {done.code} is not one line: {text[-500:]}"
    losses = (text + _lost_by_info(done.out)).splitlines()
    lines = [line for line in losses if "lost" in line or "void:" in line]
    if done.code == 3 and not any(c.isdigit() for line in lines for c in line):
        return f"exit 3 without numbers: {text[-500:]}"
    return ""


def _lost_by_info(out: str) -> str:
    """Return what `info` prints as lost or refused: it stands among its results, as text or as JSON."""
    if out.startswith("{"):
        found = json.loads(out).get("findings") or []
        lines = [f["message"] for f in found if f["code"] in {"lost", "refused"}]
    else:
        lines = [line for line in out.splitlines() if "  file: " in line or "not used: " in line]
    return "".join(f"\nlost: {line}" for line in lines)


def files_are_wrong(folder: Path, lost: bool) -> str:
    """Hold the results against: finite everywhere, P positive, a loss counted where there must be one."""
    report = folder / "out" / "run.json"
    if not report.exists():
        return "an exit code of success without a result"
    found = json.loads(report.read_text(), parse_constant=_refuse)
    void = any("void" in one for one in found["configurations"].values())
    if lost and not (found["input"]["losses"] or found["input"]["dropped"] or void):
        return "exit 3, but nothing is counted as lost"
    for path in (folder / "out").glob("*.tum"):
        if not np.isfinite(np.loadtxt(path, ndmin=2)).all():
            return f"{path.name} is not finite"
    csv = folder / "out" / "trajectory.csv"
    return _of_trajectory(np.loadtxt(csv, delimiter=",", skiprows=1, ndmin=2)) if csv.exists() else ""


def _refuse(word: str) -> None:
    raise click.ClickException(f"{word} in a report")


def _of_trajectory(rows: np.ndarray[Any, np.dtype[np.float64]]) -> str:
    if rows.shape[1] != COLUMNS or not np.isfinite(rows).all():
        return "the trajectory is not finite"
    P = rows[:, [4, 5, 6, 5, 7, 8, 6, 8, 9]].reshape(-1, 3, 3)
    scale = np.sqrt(np.maximum(np.einsum("nii->ni", P), MIN_VARIANCE))
    least = np.linalg.eigvalsh(P / (scale[:, :, None] * scale[:, None, :])).min()
    return "" if least > -1e-9 else f"P is not positive: {least:g} after scaling its diagonal to 1"


def _acts(done: Done, folder: Path, before: dict[Path, bytes]) -> str:
    """Return where a control character of the log reaches a terminal or a file."""
    texts = {"stdout": done.out, "stderr": done.err}
    for path in folder.rglob("*"):
        if path.suffix in TEXTS and path not in before and path.is_file():
            texts[path.name] = path.read_text(encoding="utf-8", errors="surrogateescape")
    for name, text in texts.items():
        line = text.replace("\n", "")
        if found := UNSEEN.search(line):
            return f"{found[0]!r} acts in {name}: {line[max(found.start() - 60, 0) :][:120]!r}"
        if name.endswith((".html", ".svg")) and "<script>&" in text:
            return f"text of the log is no text in {name}"
    return ""


def _changed(folder: Path, before: dict[Path, bytes]) -> str:
    for path, content in before.items():
        if not path.exists() or path.read_bytes() != content:
            return f"the input {path.name} was changed"
    left = [path.name for path in folder.rglob("*") if path.name.endswith((TEMPORARY, "-shm", "-journal"))]
    return f"left behind: {left}" if left else ""


def _unreadable(path: Path) -> str:
    try:
        contents(path.read_bytes())
    except Exception as e:
        return f"the recovered copy cannot be read by others: {type(e).__name__}: {e}"
    return ""
