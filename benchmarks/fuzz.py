"""Test of the behaviour with damaged and wrong input: python -m benchmarks.fuzz --cases 10000.

    python -m benchmarks.fuzz --parsers 240              every parser by itself, seconds of CPU each
    python -m benchmarks.fuzz --cases 10000              random damage to whole logs, through the command line
    python -m benchmarks.fuzz --cases 10000 --directed   logs, maps and tables that are wrong on purpose (DEEDS)

The tested rules: a parser rejects input by an error of its own with one line, within SLOW seconds. A command ends
with a result or with an error of one line, never with a traceback. Every number of a result is finite, and every
covariance positive. Damage that checksums show is counted or changes nothing. Control characters of a log have no
effect on a terminal or in a file. Input files are not changed.

Each case is a seed, and runs in its own process with limited memory and CPU time. Cases that fail are saved in
--keep; `--first SEED --cases 1` runs one again. The exit code is 1 if a case failed.
"""

import json
import resource
import signal
import tempfile
import time
import traceback
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from typing import Any

import click
import numpy as np

from benchmarks.experiment import in_processes, locfuse, scratch
from benchmarks.fuzz_cases import Case, bases, contents, damaged_case, directed_case
from benchmarks.fuzz_parsers import PARSERS, fuzz_parser
from locfuse.cli.analysis.errors import silence_overflows
from locfuse.formats.text import UNSEEN
from locfuse.formats.whole_files import TEMPORARY

MAX_WALL_RATIO = 20  # largest wall time / limit of CPU time: a process that waits uses no CPU time
MIN_VARIANCE = 1e-18  # (1 nm)^2: a smaller variance is a rounding error of an exact start
MAX_BYTES, MAX_CPU_S = 1 << 30, 60  # limits of a case: additional address space, CPU time
FEW_CASES = 100  # so few cases use only some of the healthy logs: the others need no trajectory
TEXTS = {".md", ".html", ".json", ".toml", ".csv", ".tex", ".svg", ".tum", ".txt"}  # text files
LOSSES = ("lost", "void", "file:", "not used")  # words of messages that count lost data


@cache
def trajectory(name: str) -> bytes:
    """Return locfuse's trajectory of a healthy log; b"" if there is none."""
    folder = scratch() / f"healthy {name}"
    locfuse(*bases()[name][0].write(folder))
    csv = folder / "out" / "trajectory.csv"
    return csv.read_bytes() if csv.exists() else b""


def problems(case: Case, folder: Path) -> Iterator[str]:
    line = case.write(folder)
    before = {path: path.read_bytes() for path in folder.iterdir()}
    code, out, err = locfuse(*line)
    yield from of_messages(code, out, err, "--check" in line)
    yield from of_files(case, folder, {"stdout": out, "stderr": err})
    for path, content in before.items():
        if not path.exists() or path.read_bytes() != content:
            yield f"the input {path.name} was changed"
    if line[0] == "run" and code in {0, 3}:
        yield from of_results(folder / "out", lost=code == 3 and "--strict" not in line)
        kept = folder / "out" / "trajectory.csv"
        if code == 0 and case.healthy and kept.read_bytes() != trajectory(case.healthy):
            yield "damage that checksums show changed the trajectory, without a word"
    if line[0] == "recover" and code in {0, 3}:
        contents((folder / "fixed.mcap").read_bytes())  # by the public reader
    if again := {0: "info", 1: "init"}.get(len(case.log) % 8):
        yield from of_messages(*locfuse(again, line[1]))


def of_files(case: Case, folder: Path, texts: dict[str, str]) -> Iterator[str]:
    texts |= {p.name: p.read_text("utf-8", "surrogateescape") for p in folder.rglob("*") if p.suffix in TEXTS}
    for name, text in texts.items():
        if name not in case.beside and (found := UNSEEN.search(text.replace("\n", ""))):
            yield f"{found[0]!r} acts in {name}"
        if name.endswith((".html", ".svg")) and "<script>&" in text:
            yield f"text of the log is no text in {name}"
    for path in folder.rglob("*"):
        if path.name.endswith((TEMPORARY, "-shm", "-journal")):
            yield f"left behind: {path.name}"


def of_messages(code: int, out: str, err: str, is_list: bool = False) -> Iterator[str]:
    """Yield problems of an exit code and messages: an error must be one line, a loss must have numbers."""
    if "Traceback" in err or "Warning:" in err or "out of memory" in err or code not in {0, 1, 2, 3}:
        yield f"exit {code}: {err[-3000:]}"
    if not is_list and code in {1, 2} and (err.count("\n") != 1 or not err.startswith("locfuse: ")):
        yield f"exit {code} is not one line: {err[-500:]}"
    lines = out.splitlines()
    if out.startswith("{"):
        lines = [finding["message"] for finding in json.loads(out).get("findings") or []]
    losses = [one for one in (*err.splitlines(), *lines) if any(word in one for word in LOSSES)]
    if not is_list and code == 3 and not any(c.isdigit() for c in "".join(losses)):
        yield f"exit 3 without numbers: {err[-500:]}"


def of_results(out: Path, lost: bool) -> Iterator[str]:
    """Yield problems of results: values must be finite, P positive, and losses counted."""
    if not (out / "run.json").exists():
        yield "an exit code of success without a result"
        return
    odd: list[str] = []
    report = json.loads((out / "run.json").read_text(), parse_constant=odd.append)
    yield from (f"{word} in a report" for word in odd)
    void = any("void" in one for one in report["configurations"].values())
    if lost and not (report["input"]["losses"] or report["input"]["dropped"] or void):
        yield "exit 3, but nothing is counted as lost"
    for path in out.glob("*.tum"):
        if not np.isfinite(np.loadtxt(path, ndmin=2)).all():
            yield f"{path.name} is not finite"
    if (out / "trajectory.csv").exists():
        rows = np.loadtxt(out / "trajectory.csv", delimiter=",", skiprows=1, ndmin=2)
        P = rows[:, [4, 5, 6, 5, 7, 8, 6, 8, 9]].reshape(-1, 3, 3)  # columns 4 to 9 are its triangle
        scale = np.sqrt(np.maximum(np.einsum("nii->ni", P), MIN_VARIANCE))
        least = np.linalg.eigvalsh(P / (scale[:, :, None] * scale[:, None, :])).min()
        if not np.isfinite(rows).all() or least < -1e-9:
            yield "the trajectory is not finite, or a covariance not positive"


# --- many cases


def judged(make: Callable[[int], Case], seed: int) -> tuple[str, float, str]:
    """Return title, CPU time [s] and problems of a case, run in its own process."""
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    memory = pages * resource.getpagesize() + MAX_BYTES
    resource.setrlimit(resource.RLIMIT_AS, (memory, memory))
    resource.setrlimit(resource.RLIMIT_CPU, (MAX_CPU_S, MAX_CPU_S + 1))
    signal.alarm(MAX_WALL_RATIO * MAX_CPU_S)
    silence_overflows()  # as the program does
    case, begin = make(seed), time.process_time()
    with tempfile.TemporaryDirectory(dir=scratch()) as folder:
        try:
            wrong = next(problems(case, Path(folder) / "case"), "")
        except Exception:  # an error of locfuse, or of this test
            wrong = traceback.format_exc()
    return case.title, time.process_time() - begin, wrong


@click.command()
@click.option("--cases", default=300, show_default=True)
@click.option("--first", default=0, show_default=True, help="The first seed.")
@click.option("--directed", is_flag=True, help="Build logs and files that are wrong on purpose.")
@click.option("--deeds", default="", help="Of --directed: do one of these first, such as odd_values,line_maps.")
@click.option("--parsers", type=float, help="Give every parser damaged input for so many seconds of CPU.")
@click.option("--jobs", default=2, show_default=True)
@click.option("--keep", type=click.Path(path_type=Path), default=Path("fuzz-failures"), show_default=True)
def main(parsers: float | None, jobs: int, keep: Path, **how: Any) -> None:
    """Run random cases and print the failed ones."""
    if parsers is not None:
        raise SystemExit(all_parsers(parsers, how["first"], keep))
    make = partial(directed_case, tuple(how["deeds"].split(","))) if how["directed"] else damaged_case
    seeds = range(how["first"], how["first"] + how["cases"])
    kinds, failed = Counter[str](), Counter[str]()
    few = len(seeds) < FEW_CASES
    for name in () if how["directed"] else {make(seed).healthy for seed in seeds} - {""} if few else bases():
        trajectory(name)
    for command in ("run", "compare", "view"):  # loads every library before memory is limited
        healthy = replace(bases()["zstd"][0], healthy="", command=(command,))
        assert not [*problems(healthy, scratch() / command)]
    for seed, answer in in_processes(partial(judged, make), seeds, jobs):
        died = isinstance(answer, RuntimeError)
        title, took, wrong = (make(seed).title, 0.0, f"the process died: {answer}") if died else answer
        what = title.partition(": ")[2]
        kinds.update(what.split(", "))
        if wrong:
            failed[what] += 1
            make(seed).write(keep / f"{seed}")
            (keep / f"{seed}" / "wrong.txt").write_text(f"{title}\n{wrong}", errors="surrogateescape")
            click.echo(f"seed {seed}: {title}: {wrong.strip().splitlines()[-1][:300]}")
        elif took > MAX_CPU_S / 3:
            click.echo(f"seed {seed}: {title}: {took:.0f} s of CPU")
    click.echo(", ".join(f"{kind} {count}" for kind, count in kinds.most_common()))
    click.echo(f"{len(seeds)} cases, {failed.total()} failed")
    raise SystemExit(bool(failed))


def all_parsers(seconds: float, seed: int, keep: Path) -> int:
    """Give damaged input to all parsers, print problems, and return 1 if there are any."""
    bad = 0
    for name in PARSERS:
        n, found = fuzz_parser(name, seed, seconds)
        click.echo(f"{name:16} {n:8} inputs, {len(found)} findings")
        for problem, data in found.items():
            keep.mkdir(parents=True, exist_ok=True)
            (keep / f"{name.replace(' ', '_')}-{seed}-{bad}").write_bytes(data)
            click.echo(problem)
            bad += 1
    return min(bad, 1)


if __name__ == "__main__":
    main()
