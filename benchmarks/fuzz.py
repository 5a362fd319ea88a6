"""Damage logs and robots at random and see that nothing breaks: python -m benchmarks.fuzz --cases 10000.

Each case is a seed (benchmarks/fuzz_cases.py), run by a forked process under limits of memory and CPU time, which
a busy machine does not stretch. A case that fails is saved: its log, its robot.toml, what went wrong; `--only
SEED` runs one again. Exit 1 if any failed.
"""

from __future__ import annotations

import contextlib
import math
import os
import resource
import signal
import tempfile
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import click

from benchmarks.fuzz_cases import Workshop
from benchmarks.fuzz_directed import DirectedShop
from locfuse.cli.analysis.errors import silence_overflows

MAX_WALL_RATIO = 20  # wall time of a case over its limit of CPU time: one that waits uses no CPU
SLOW_SHARE = 1 / 3  # of the CPU time a case may take: what takes longer is named
GIB = 1 << 30


class Limits(NamedTuple):
    """What a case may take."""

    memory: int  # bytes of address space on top
    seconds: float  # of CPU


class Answer(NamedTuple):
    """The outcome of a case."""

    seed: int
    title: str
    seconds: float  # of CPU
    wrong: str  # "" for nothing


def started(shop: Workshop, seed: int, folder: Path, limits: Limits) -> int:
    """Fork a process that judges one case and writes title and verdict beside its folder; return its number."""
    if process := os.fork():
        return process
    os.setpgrp()  # what it starts ends with it
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    memory, cpu = pages * resource.getpagesize() + limits.memory, math.ceil(limits.seconds)
    resource.setrlimit(resource.RLIMIT_AS, (memory, memory))
    resource.setrlimit(resource.RLIMIT_CPU, (cpu, cpu + 1))
    signal.alarm(MAX_WALL_RATIO * cpu)
    silence_overflows()  # as the program does
    case = shop.case(seed)
    try:
        wrong = shop.judge(case, folder)
    except Exception as e:
        wrong = f"the oracle: {type(e).__name__}: {e}"
    folder.with_suffix(".txt").write_text(f"{case.title}\n{wrong}", errors="surrogateescape")
    os._exit(0)


def answers(
    shop: Workshop, seeds: Sequence[int], scratch: Path, jobs: int, limits: Limits, end: float
) -> Iterator[Answer]:
    """Yield the outcome of every case, `jobs` at a time, begun before `end` [s of the monotonic clock]."""
    waiting, running = list(seeds)[::-1], dict[int, tuple[int, Path]]()
    free = [scratch / str(i) for i in range(jobs)]
    try:
        while running or (waiting and time.monotonic() < end):
            while free and waiting and time.monotonic() < end:
                seed, folder = waiting.pop(), free.pop()
                running[started(shop, seed, folder, limits)] = seed, folder
            process, status, usage = os.wait4(-1, 0)
            seed, folder = running.pop(process)
            free.append(folder)
            end_group(process)
            words = folder.with_suffix(".txt")
            title, _, wrong = (
                words.read_text(errors="surrogateescape").partition("\n") if not status else ("", "", "")
            )
            words.unlink(missing_ok=True)
            if status:
                title, wrong = shop.case(seed).title, died(os.waitstatus_to_exitcode(status), limits)
            yield Answer(seed, title, usage.ru_utime + usage.ru_stime, wrong)
    finally:
        for process in running:
            end_group(process)


def end_group(process: int) -> None:
    """End a process and all that it started."""
    with contextlib.suppress(ProcessLookupError):
        os.killpg(process, signal.SIGKILL)


def died(code: int, limits: Limits) -> str:
    """Return in words why a process ended without an answer."""
    slow = {signal.SIGXCPU: "of CPU", signal.SIGALRM: f"x {MAX_WALL_RATIO} by the clock"}
    for number, clock in slow.items():
        if code == -number:
            return f"no answer within {limits.seconds:g} s {clock}"
    return f"the process died (exit code {code})"


def keep(shop: Workshop, answer: Answer, folder: Path) -> None:
    """Save a case that failed, and print it at once: a long run may be stopped at any time."""
    shop.case(answer.seed).save(folder / str(answer.seed))
    (folder / str(answer.seed) / "wrong.txt").write_text(answer.wrong)
    click.echo(f"seed {answer.seed}: {answer.title}: {answer.wrong.strip().splitlines()[-1][:300]}")


@click.command()
@click.option("--cases", default=300, show_default=True)
@click.option("--first", default=0, show_default=True, help="The first seed.")
@click.option("--minutes", default=math.inf, help="Stop after so long by the clock.  [default: never]")
@click.option("--only", type=int, help="Run the case of one seed.")
@click.option("--directed", is_flag=True, help="Build logs that are wrong on purpose (fuzz_directed.py).")
@click.option("--deeds", default="", help="Of --directed: do one of these first, such as odd_scans,line_maps.")
@click.option("--jobs", default=2, show_default=True)
@click.option("--memory", default=1.0, show_default=True, help="GiB of address space a case may take on top.")
@click.option("--seconds", default=60.0, show_default=True, help="CPU time a case may take.")
@click.option(
    "--keep",
    "kept",
    type=click.Path(file_okay=False, path_type=Path),
    default=Path("fuzz-failures"),
    show_default=True,
    help="Where failing cases are saved.",
)
def main(
    cases: int,
    first: int,
    minutes: float,
    only: int | None,
    directed: bool,
    deeds: str,
    jobs: int,
    memory: float,
    seconds: float,
    kept: Path,
) -> None:
    """Run random cases and print what failed."""
    seeds = list(range(first, first + cases)) if only is None else [only]
    limits = Limits(int(memory * GIB), seconds)
    kinds, wrong, judged = Counter[str](), Counter[str](), 0
    memory_first = Path("/dev/shm")  # results are synced to the disk, thousands of times
    with tempfile.TemporaryDirectory(dir=memory_first if memory_first.is_dir() else None) as temporary:
        shop: Workshop = DirectedShop([], first=tuple(filter(None, deeds.split(",")))) if directed else Workshop()
        shop.learn(Path(temporary) / "healthy")
        began = time.monotonic()
        for answer in answers(shop, seeds, Path(temporary), jobs, limits, began + 60.0 * minutes):
            what = answer.title.partition(": ")[2]
            kinds.update(what.split(", "))
            judged += 1
            if answer.wrong:
                wrong[what] += 1
                keep(shop, answer, kept)
            elif answer.seconds > SLOW_SHARE * seconds:
                click.echo(f"seed {answer.seed}: {answer.title}: {answer.seconds:.0f} s of CPU")
        for kind, count in wrong.most_common():
            click.echo(f"{count} failed: {kind}")
    click.echo(", ".join(f"{kind} {count}" for kind, count in kinds.most_common()))
    click.echo(f"{judged} cases, {wrong.total()} failed, {time.monotonic() - began:.0f} s")
    raise SystemExit(1 if wrong else 0)


if __name__ == "__main__":
    main()
