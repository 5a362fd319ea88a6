"""Damage logs and robots at random and see that nothing breaks: python -m benchmarks.fuzz --cases 10000.

Each case is a seed (benchmarks/fuzz_cases.py), run by forked workers under a memory limit and a limit of CPU time,
which a busy machine does not stretch. A case that fails is saved: its log, its robot.toml, what went wrong;
`--only SEED` runs one again. Exit 1 if any failed.
"""

from __future__ import annotations

import math
import multiprocessing
import os
import resource
import tempfile
import time
from collections import Counter
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import click

from benchmarks.fuzz_cases import Workshop
from benchmarks.fuzz_directed import DirectedShop
from benchmarks.fuzz_logs import bases
from locfuse.cli.analysis.errors import silence_overflows

FORK = multiprocessing.get_context("fork")
SLEEP = 20  # x the limit of CPU time: as long may a case take by the clock, for one that waits uses no CPU
TICK = os.sysconf("SC_CLK_TCK")  # clock ticks a second, in which /proc counts CPU time
SLOW_SHARE = 1 / 3  # of the CPU time a case may take: what takes longer is named
BATCH = 50  # cases per process: what leaks or is poisoned does not live long
GIB = 1 << 30


class Case(Protocol):
    """What a seed builds."""

    @property
    def title(self) -> str:
        """The command and what was done to its input."""

    def save(self, folder: Path) -> None:
        """Keep the case to be looked at."""


class Shop(Protocol):
    """What builds the cases and judges them."""

    def learn(self, folder: Path) -> None:
        """Run what is healthy."""

    def case(self, seed: int) -> Any:
        """Return the case that belongs to a seed."""

    def judge(self, case: Any, folder: Path) -> str:
        """Return what is wrong with what came of a case, "" for nothing."""


class Answer(NamedTuple):
    """What came of a case."""

    title: str
    seconds: float  # of CPU
    wrong: str  # "" for nothing


class Worker:
    """A forked process that works through some seeds, one answer per seed."""

    def __init__(self, shop: Shop, seeds: list[int], folder: Path, memory: int) -> None:
        self.seeds = seeds
        self.cpu = 0.0  # s used when the case at hand began
        self.answers, theirs = FORK.Pipe(duplex=False)
        self.process: BaseProcess = FORK.Process(target=_work, args=(shop, seeds, folder, memory, theirs))
        self.process.start()
        theirs.close()
        self._start()

    def _start(self) -> None:
        """Begin to count the time of the next case."""
        self.since, self.cpu = time.monotonic(), self._used()

    def _used(self) -> float:
        """Return the CPU time of the process and of what it has waited for (s)."""
        try:
            stat = Path(f"/proc/{self.process.pid}/stat").read_text()
        except OSError:  # it has ended
            return self.cpu
        return sum(map(int, stat.rpartition(")")[2].split()[11:15])) / TICK

    def overdue(self, seconds: float) -> str:
        """Return how long the case at hand takes, "" within so many seconds of CPU."""
        cpu, wall = self._used() - self.cpu, time.monotonic() - self.since
        if cpu > seconds:
            return f"no answer within {cpu:.0f} s of CPU"
        return f"no answer within {wall:.0f} s, and only {cpu:.0f} s of CPU" if wall > SLEEP * seconds else ""

    def answer(self) -> Answer | None:
        """Return what came of the case at hand, None where the process has ended without an answer."""
        try:
            answer: Answer = self.answers.recv()
        except EOFError:
            return None
        self._start()
        return answer

    def end(self) -> int | None:
        """End the process and return its exit code."""
        self.process.kill()
        self.process.join()
        self.answers.close()
        return self.process.exitcode


def _work(shop: Shop, seeds: list[int], folder: Path, memory: int, answers: Connection) -> None:
    with open("/proc/self/statm") as f:  # noqa: PTH123
        baseline = int(f.read().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (baseline + memory, baseline + memory))
    silence_overflows()  # as the program does
    for seed in seeds:
        case, began = shop.case(seed), _cpu()
        try:
            wrong = shop.judge(case, folder)
        except Exception as e:
            wrong = f"the oracle: {type(e).__name__}: {e}"
        answers.send(Answer(case.title, _cpu() - began, wrong))


def _cpu() -> float:
    """Return the CPU time of this process and of what it has waited for (s)."""
    return sum(os.times()[:4])


class Pool:
    """Some workers, each in a folder of its own; who dies or hangs is replaced and its case has failed."""

    def __init__(
        self, shop: Shop, seeds: list[int], folder: Path, jobs: int, memory: int, seconds: float, keep: Path
    ) -> None:
        self.shop, self.memory, self.seconds, self.keep = shop, memory, seconds, keep
        self.waiting = [seeds[i : i + BATCH] for i in range(0, len(seeds), BATCH)][::-1]
        self.free = [folder / str(i) for i in range(jobs)]
        self.busy: dict[Connection, tuple[Worker, Path]] = {}
        self.wrong: dict[int, str] = {}  # seed -> what went wrong
        self.judged = 0  # cases
        self.kinds: Counter[str] = Counter()  # of them, by what was done to the input
        self.end = math.inf  # monotonic time (s) at which to stop

    def run(self) -> dict[int, str]:
        """Run all seeds and return what went wrong by seed."""
        try:
            self._run()
        finally:
            for worker, _ in self.busy.values():
                worker.end()
        return self.wrong

    def _run(self) -> None:
        while (self.waiting or self.busy) and time.monotonic() < self.end:
            while self.waiting and self.free:
                place = self.free.pop()
                worker = Worker(self.shop, self.waiting.pop(), place, self.memory)
                self.busy[worker.answers] = worker, place
            for ready in wait(list(self.busy), timeout=1.0):
                self._take(self.busy[ready][0])  # type: ignore[index]
            for worker, _ in list(self.busy.values()):
                if late := worker.overdue(self.seconds):
                    self._note(worker.seeds[0], late)
                    self._close(worker, worker.seeds[1:])

    def _take(self, worker: Worker) -> None:
        answer = worker.answer()
        if not worker.seeds:  # all are done
            self._close(worker, [])
            return
        seed, worker.seeds = worker.seeds[0], worker.seeds[1:]
        self.judged += 1
        if answer is None:
            self._note(seed, f"the process died (exit code {self._close(worker, worker.seeds)})")
            return
        self.kinds.update(answer.title.partition(": ")[2].split(", "))
        if answer.seconds > SLOW_SHARE * self.seconds:
            click.echo(f"seed {seed}: {answer.title}: {answer.seconds:.0f} s of CPU")
        if answer.wrong:
            self._note(seed, answer.wrong)

    def _note(self, seed: int, wrong: str) -> None:
        """Save and say what failed, at once: a long run may be stopped at any time."""
        self.wrong[seed] = wrong
        case: Case = self.shop.case(seed)
        place = self.keep / str(seed)
        case.save(place)
        (place / "wrong.txt").write_text(wrong)
        click.echo(f"seed {seed}: {case.title}: {wrong.strip().splitlines()[-1][:300]}")

    def _close(self, worker: Worker, rest: list[int]) -> int | None:
        self.free.append(self.busy.pop(worker.answers)[1])
        if rest:
            self.waiting.append(rest)
        return worker.end()


@click.command()
@click.option("--cases", default=300, show_default=True)
@click.option("--first", default=0, show_default=True, help="The first seed.")
@click.option("--minutes", default=math.inf, help="Stop after so long by the clock.  [default: never]")
@click.option("--only", type=int, help="Run the case of one seed.")
@click.option("--directed", is_flag=True, help="Build logs that lie (fuzz_directed.py) instead of damaging some.")
@click.option("--deeds", default="", help="Of --directed: do one of these first, such as odd_scans,line_maps.")
@click.option("--jobs", default=2, show_default=True)
@click.option("--memory", default=1.0, show_default=True, help="GiB of address space a case may take on top.")
@click.option("--seconds", default=60.0, show_default=True, help="CPU time a case may take.")
@click.option(
    "--keep",
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
    keep: Path,
) -> None:
    """Run random cases and print what failed."""
    seeds = list(range(first, first + cases)) if only is None else [only]
    memory_first = Path("/dev/shm")  # results are synced to the disk, thousands of times
    with tempfile.TemporaryDirectory(dir=memory_first if memory_first.is_dir() else None) as temporary:
        shop: Shop = DirectedShop(tuple(filter(None, deeds.split(",")))) if directed else Workshop(bases())
        shop.learn(Path(temporary) / "healthy")
        began = time.monotonic()
        pool = Pool(shop, seeds, Path(temporary), jobs, int(memory * GIB), seconds, keep)
        pool.end = began + 60.0 * minutes
        wrong = pool.run()
        kinds: Counter[str] = Counter(shop.case(seed).title.split(": ", 1)[1] for seed in wrong)
        for kind, count in kinds.most_common():
            click.echo(f"{count} failed: {kind}")
    click.echo(", ".join(f"{kind} {count}" for kind, count in pool.kinds.most_common()))
    click.echo(f"{pool.judged} cases, {len(wrong)} failed, {time.monotonic() - began:.0f} s")
    raise SystemExit(1 if wrong else 0)


if __name__ == "__main__":
    main()
