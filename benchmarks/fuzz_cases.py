"""One fuzz case: a seed decides what is damaged and how, the command line is run, an oracle judges what it did.

What must hold: a log with checksums gives the trajectory of its healthy twin, or exit 3 with the loss counted, or
exit 1 with one line. Where the damage cannot be seen (no checksums, other messages, another robot.toml) values may
change too, but every number is finite, every P positive. Never a traceback.
"""

from __future__ import annotations

import contextlib
import io
import json
import random
import shutil
import traceback
from dataclasses import dataclass, field, replace
from pathlib import Path
from random import Random
from typing import Any

import click
import numpy as np

from benchmarks import fuzz_damage as damage
from benchmarks.fuzz_logs import Base
from locfuse.cli.main import main

REAL_ROBOT = ("--set", "wheels.radius=0.033", "--set", "wheels.track=0.16")  # for logs that do not say
COLUMNS = 10  # of trajectory.csv: t, x, y, theta and the upper triangle of P
EXACT = 1e-18  # a variance below that of a nanometre: what rounding leaves of an exact start


@dataclass(frozen=True)
class Case:
    """A damaged log and how to run it."""

    title: str  # base: damage, damage
    log: bytes
    suffix: str
    visible: bool  # whether the damage can be noticed
    robot: bytes | None = None  # a robot.toml to give along
    words: tuple[str, ...] = ()  # more of the command line
    command: str = "run"

    def save(self, folder: Path) -> None:
        """Keep the case to be looked at."""
        folder.mkdir(parents=True, exist_ok=True)
        (folder / f"log{self.suffix}").write_bytes(self.log)
        if self.robot is not None:
            (folder / "robot.toml").write_bytes(self.robot)
        (folder / "case.json").write_text(json.dumps({"words": [self.command, *self.words], "title": self.title}))


@dataclass(frozen=True)
class Done:
    """What a command did."""

    code: int
    out: str
    err: str


@dataclass
class Workshop:
    """Healthy logs, and what the product made of them."""

    bases: list[Base]
    trajectories: dict[str, bytes] = field(default_factory=dict)  # base -> trajectory.csv
    robots: dict[str, str] = field(default_factory=dict)  # base -> its effective robot.toml

    def learn(self, folder: Path) -> None:
        """Run every healthy log once."""
        for base in self.bases:
            healthy = Case(base.name, base.data, base.suffix, visible=False, words=_words(base))
            run(healthy, folder)
            csv, toml = folder / "out" / "trajectory.csv", folder / "out" / "robot.toml"
            if csv.exists():
                self.trajectories[base.name] = csv.read_bytes()
                self.robots[base.name] = toml.read_text()

    def case(self, seed: int) -> Case:
        """Return the case that belongs to a seed."""
        rng = random.Random(seed)
        base = rng.choices(self.bases, [b.weight for b in self.bases])[0]
        case = Case(base.name, base.data, base.suffix, base.checked, words=_words(base))
        deeds = [_damaged] * 6
        if base.name in self.robots:
            deeds += [self._other_robot] * 2
        case = rng.choice(deeds)(rng, case)
        return replace(case, command="compare" if rng.random() < 0.05 else "run")

    def judge(self, case: Case, folder: Path) -> str:
        """Run a case and return what is wrong with the outcome, "" for nothing."""
        return judge(case, folder, self.trajectories.get(case.title.split(":")[0]))

    def _other_robot(self, rng: Random, case: Case) -> Case:
        text = damage.odd_toml(rng, self.robots[case.title])
        return replace(case, title=f"{case.title}: robot.toml", robot=text, visible=False)


def _words(base: Base) -> tuple[str, ...]:
    return REAL_ROBOT if base.real else ()


def _damaged(rng: Random, case: Case) -> Case:
    ways = damage.MCAP if case.suffix == ".mcap" else damage.ANY_FILE
    name, data, names = case.title, case.log, []
    for _ in range(rng.choice((1, 1, 1, 2))):
        # records are those of the healthy file: what follows a damaged one is found by bytes only
        way = rng.choice(ways if data is case.log else damage.ANY_FILE)
        try:
            data = way(rng, data) if data else data
        except (IndexError, ValueError):  # a real log that is damaged already
            continue
        names.append(way.__name__)
    return replace(case, title=f"{name}: {', '.join(names)}", log=data)


def run(case: Case, folder: Path) -> Done:
    """Run the case in a folder that is emptied first."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    log = folder / f"log{case.suffix}"
    log.write_bytes(case.log)
    words = [case.command, str(log), "-o", str(folder / "out"), *case.words]
    words += ["--write", "all"] if case.command == "run" else []  # what is judged stands in trajectory.csv
    if case.robot is not None:
        (folder / "robot.toml").write_bytes(case.robot)
        words += ["--robot", str(folder / "robot.toml")]
    return locfuse(*words)


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


def judge(case: Case, folder: Path, healthy: bytes | None) -> str:
    """Run a case and return what is wrong with the outcome, "" for nothing."""
    done = run(case, folder)
    wrong = words_are_wrong(done) or (files_are_wrong(folder, done) if done.code in {0, 3} else "")
    if not wrong and done.code == 0 and case.visible and case.command == "run" and healthy is not None:
        same = (folder / "out" / "trajectory.csv").read_bytes() == healthy
        wrong = "" if same else "damage that checksums show changed the trajectory in silence"
    if not wrong and (command := {0: "info", 1: "init"}.get(len(case.log) % 8)):
        wrong = words_are_wrong(locfuse(command, str(folder / f"log{case.suffix}")))
    return wrong


def words_are_wrong(done: Done, short: bool = True) -> str:
    """Hold exit code and stderr against the contract; `short`: a refusal is one line, a loss has numbers."""
    text = done.err
    losses = text + _lost_by_info(done.out)
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
    lines = [line for line in losses.splitlines() if "lost" in line or "void:" in line]
    if done.code == 3 and not any(c.isdigit() for line in lines for c in line):
        return f"exit 3 without numbers: {text[-500:]}"
    return ""


def _lost_by_info(out: str) -> str:
    """Return what `info` says is lost or refused: it says so among its results, as text or as JSON."""
    if out.startswith("{"):
        found = json.loads(out).get("findings") or []
        lines = [f["message"] for f in found if f["code"] in {"lost", "refused"}]
    else:
        lines = [line for line in out.splitlines() if "  file: " in line or "not used: " in line]
    return "".join(f"\nlost: {line}" for line in lines)


def files_are_wrong(folder: Path, done: Done, lost: bool | None = None) -> str:
    """Hold the results against: finite everywhere, P positive, a loss counted where there must be one."""
    lost = done.code == 3 if lost is None else lost
    report = next((folder / "out" / n for n in ("run.json", "report.json") if (folder / "out" / n).exists()), None)
    if report is None:
        return f"exit {done.code} without a result"
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
    scale = np.sqrt(np.maximum(np.einsum("nii->ni", P), EXACT))
    least = np.linalg.eigvalsh(P / (scale[:, :, None] * scale[:, None, :])).min()
    return "" if least > -1e-9 else f"P is not positive: {least:g} after scaling its diagonal to 1"
