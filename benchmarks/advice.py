"""Does obeying the advice help? Wrong settings, alone and in pairs: who is accused, what is offered, what it does.

    python -m benchmarks.advice --seeds 8 -o advice.jsonl

Each seed is one lap of the paper's robot with settings that are right but for one or two. `compare`'s findings are
taken at their word: all their fixes are set, and the position error is compared with that before and with that of
the right settings. Every case runs with and without truth in the log; without it the error is known to this
benchmark only. Finished cases stand in the file of -o and are not run again; `--write` puts the table into
docs/advice.md. Delete the file when the code changes: all rows of a table are of one state of it.
"""

from __future__ import annotations

import json
import math
import re
import tempfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click

from locfuse.cli.session.session import Session, load
from locfuse.sample_logs.load import load as scenario_of
from locfuse.sample_logs.record import on_truth, write_log

PAGE = Path(__file__).parent.parent / "docs" / "advice.md"
FIRST_SEED = 3000
SCENARIO = (
    "truth.rate=20",
    "compass.noise_deg=1",
    "compass.sigma_deg=1",
    "compass.hard_iron=[0, 0]",
    "compass.soft_iron=[1, 1, 0]",
)
NORTH = -65.0  # compass.offset_deg: the scenario's magnetic north
CAMERA_DEG = 0.18  # camera.sigma_deg, as its bearings against the truth show
RIGHT = (f"compass.offset_deg={NORTH}", f"camera.sigma_deg={CAMERA_DEG}")
MAX_LOSS, MAX_LOSS_M = 0.02, 2e-4
MIN_GAP, MIN_GAP_M = 0.10, 5e-4  # relative, m: a fault that costs less leaves nothing to close


@dataclass(frozen=True)
class Fault:
    """Settings that are wrong, and who should be accused of what."""

    sets: tuple[str, ...]
    role: str
    keys: tuple[str, ...]  # one of which a right fix sets
    right: tuple[
        str, ...
    ] = ()  # where the right value leaves something: a mount set by hand is a state from then on


def _noise(role: str, factor: float, **sigmas: float) -> Fault:
    sets = tuple(f"{role}.{key}={value * factor:.4g}" for key, value in sigmas.items())
    return Fault(sets, role, tuple(f"{role}.{key}" for key in sigmas))


def _late(role: str, seconds: float) -> Fault:
    return Fault((f"{role}.time_offset={seconds}",), role, (f"{role}.time_offset",))


def _one(setting: str, *also: str) -> Fault:
    key = setting.partition("=")[0]
    return Fault((setting,), key.partition(".")[0], (key, *also))


LASER_NOISE = {"sigma_range": 0.03, "sigma_angle_deg": 0.25}
MOUNT = ("lrf.x", "lrf.y", "lrf.yaw_deg")
FAULTS: dict[str, Fault] = {
    "none": Fault((), "", ()),
    "compass sigma x 3": _noise("compass", 3.0, sigma_deg=1.0),
    "compass sigma / 3": _noise("compass", 1 / 3, sigma_deg=1.0),
    "laser sigma x 3": _noise("lrf", 3.0, **LASER_NOISE),
    "laser sigma / 3": _noise("lrf", 1 / 3, **LASER_NOISE),
    "camera sigma x 3": _noise("camera", 3.0, sigma_deg=CAMERA_DEG),
    "camera sigma / 3": _noise("camera", 1 / 3, sigma_deg=CAMERA_DEG),
    "wheels noise x 9": _noise("wheels", 9.0, noise=4e-4),
    "wheels noise / 9": _noise("wheels", 1 / 9, noise=4e-4),
    **{f"compass {ms} ms late": _late("compass", ms / 1000) for ms in (20, 50, 100, 200)},
    **{f"laser {ms} ms late": _late("lrf", ms / 1000) for ms in (20, 50, 100, 200)},
    "camera 200 ms late": _late("camera", 0.2),
    "wheels 100 ms late": _late("wheels", 0.1),
    "truth 100 ms late": _late("truth", 0.1),
    "laser 3 cm ahead": Fault(("lrf.x=0.03",), "lrf", MOUNT, ("lrf.x=0",)),
    "laser 3 cm aside": Fault(("lrf.y=0.03",), "lrf", MOUNT, ("lrf.y=0",)),
    "laser 2 degrees": Fault(("lrf.yaw_deg=2",), "lrf", MOUNT, ("lrf.yaw_deg=0",)),
    "laser 10 degrees": Fault(("lrf.yaw_deg=10",), "lrf", MOUNT, ("lrf.yaw_deg=0",)),
    "laser upside-down": _one("lrf.flipped=true"),
    "range scale 1.05": _one("lrf.range_scale=1.05"),
    "track + 3 %": _one("wheels.track=0.618"),
    "track - 10 %": _one("wheels.track=0.54"),
    "radius + 6 %": _one("wheels.radius=0.053", "wheels.track"),
    "wheel mirrored": _one("wheels.mirrored=left"),
    "camera zero + 5": _one("camera.zero_deg=5"),
    "camera mirrored": _one("camera.clockwise=true", "camera.zero_deg"),
    "compass + 5": _one(f"compass.offset_deg={NORTH + 5}"),
    "compass + 30": _one(f"compass.offset_deg={NORTH + 30}"),
    "compass upside-down": _one("compass.roll_deg=180"),
}
PAIRS = (
    ("laser 50 ms late", "compass + 5"),
    ("laser 2 degrees", "compass sigma / 3"),
    ("laser 3 cm ahead", "track + 3 %"),
    ("laser sigma / 3", "compass + 5"),
    ("wheel mirrored", "laser 100 ms late"),
    ("radius + 6 %", "laser 2 degrees"),
    ("wheels noise x 9", "compass 100 ms late"),
    ("camera zero + 5", "laser 20 ms late"),
    ("compass 200 ms late", "laser sigma x 3"),
    ("track - 10 %", "camera mirrored"),
)


@dataclass(frozen=True)
class Case:
    """One or two faults together."""

    name: str
    faults: tuple[Fault, ...]

    @property
    def sets(self) -> tuple[str, ...]:
        """All settings that are wrong."""
        return tuple(s for fault in self.faults for s in fault.sets)

    @property
    def right(self) -> tuple[str, ...]:
        """What sets the wrong settings right, where they then differ from those of the log."""
        return tuple(s for fault in self.faults for s in fault.right)

    @property
    def roles(self) -> set[str]:
        """Whom a right verdict accuses."""
        return {fault.role for fault in self.faults if fault.role}

    @property
    def of_truth(self) -> bool:
        """Whether the truth itself is wrong: without it nothing is."""
        return any(fault.role == "truth" for fault in self.faults)


def cases() -> list[Case]:
    """Return single faults, then pairs."""
    single = [Case(name, (fault,)) for name, fault in FAULTS.items()]
    return [*single, *(Case(f"{a}, {b}", (FAULTS[a], FAULTS[b])) for a, b in PAIRS)]


def drive(seed: int, folder: Path) -> Path:
    """Write one lap of the robot and return the log."""
    path = folder / f"{seed}.mcap"
    write_log(scenario_of("rounded_rectangle", SCENARIO), seed, on_truth, path)
    return path


def errors(session: Session) -> dict[str, float]:
    """Return the position error of every configuration that exists."""
    found = session.compare(advice=False, audits=False).report["configurations"]
    return {name: v["position_rmse_m"] for name, v in found.items() if v["position_rmse_m"] is not None}


def run(
    session: Session, seen: Session, case: Case, right: Mapping[str, float], before: Mapping[str, float]
) -> dict[str, Any]:
    """Return what is found in one case, and the errors before and after everything that is advised is set.

    `session` is the log under the settings of the case, `seen` what is judged, perhaps without the log's truth.
    Findings do not depend on a reference, so none is solved.
    """
    report = seen.compare(audits=False, reference=False).report
    after = errors(session.with_settings(report["fixes"])) if report["fixes"] else before
    return {
        "accused": sorted({f["role"] for f in report["findings"] if f["fixes"]}),
        "unfixed": sorted({f["role"] for f in report["findings"] if not f["fixes"]}),
        "fixes": report["fixes"],
        "messages": [f"{f['role']}: {f['message']}" for f in report["findings"]],
        "right_m": dict(right),
        "before_m": dict(before),
        "after_m": dict(after),
        **judged(case, right, before, after, report["fixes"]),
    }


def judged(
    case: Case,
    right: Mapping[str, float],
    before: Mapping[str, float],
    after: Mapping[str, float],
    fixes: Sequence[str],
) -> dict[str, Any]:
    """Judge advice: named, harmless, and which share of the gap to the right settings it closes."""
    keys = {fix.partition("=")[0] for fix in fixes}
    named = all(not f.keys or keys & set(f.keys) for f in case.faults)
    both = [n for n in before if n in after and n in right]
    # what the right settings give is no harm, even where chance made the wrong ones better on this drive
    allowed = {n: max(before[n], right[n]) * (1 + MAX_LOSS) + MAX_LOSS_M for n in both}
    worse = [n for n in dict.fromkeys(("all", _best(before))) if n in both and after[n] > allowed[n]]
    gaps = {n: before[n] - right[n] for n in both if before[n] > right[n] * (1 + MIN_GAP) + MIN_GAP_M}
    widest = max(gaps, key=lambda n: math.log(before[n] / right[n]), default=None) if gaps else None
    closed = None if widest is None else (before[widest] - after[widest]) / gaps[widest]
    return {
        "named": named,
        "worse": worse,
        "gap": widest,
        "closed": closed,
        "errors_m": None if widest is None else [right[widest], before[widest], after[widest]],
    }


def _best(found: Mapping[str, float]) -> str:
    return min(found, key=lambda n: found[n])


def results(seeds: range, out: Path, chosen: Sequence[Case], truths: Sequence[bool]) -> Iterator[dict[str, Any]]:
    """Yield the result of every case, from the file where it was run before."""
    done = {}
    if out.exists():
        rows = (json.loads(line) for line in out.read_text(encoding="utf-8").splitlines())
        done = {(r["case"], r["seed"], r["truth"]): r for r in rows}
    with tempfile.TemporaryDirectory() as folder:
        for seed in seeds:
            wanted = [(c, t) for c in chosen for t in truths if t or not c.of_truth]
            left = [(c, t) for c, t in wanted if (c.name, seed, t) not in done]
            yield from (done[c.name, seed, t] for c, t in wanted if (c.name, seed, t) in done)
            if not left:
                continue
            log = drive(seed, Path(folder))
            whole, blind = load(log, sets=RIGHT), load(log, sets=(*RIGHT, "truth.topic=none"))
            right = errors(whole)
            for case in dict.fromkeys(c for c, _ in left):
                session = whole.with_settings(case.sets)  # measures only the sensors again that it changes
                before = errors(session)
                own = errors(session.with_settings(case.right)) if case.right else right
                for truth in (t for c, t in left if c == case):
                    row = {"case": case.name, "seed": seed, "truth": truth}
                    seen = session if truth else blind.with_settings(case.sets)
                    row |= run(session, seen, case, own, before)
                    with out.open("a", encoding="utf-8") as file:
                        file.write(json.dumps(row) + "\n")
                    yield row


def table(rows: Sequence[Mapping[str, Any]], chosen: Sequence[Case]) -> list[str]:
    """Return one line for each case: with truth, then without."""
    lines = [
        "| fault | right key | others accused | worse | gap closed | errors, mm: right, before, after |",
        "|---|---|---|---|---|---|",
    ]
    for case in chosen:
        sides = [[r for r in rows if r["case"] == case.name and r["truth"] == t] for t in (True, False)]
        if not any(sides):
            continue
        cells = (
            [f"{sum(r['named'] for r in side)} of {len(side)}" for side in sides],
            [str(sum(bool(set(r["accused"]) - case.roles) for r in side)) for side in sides],
            [str(sum(bool(r["worse"]) for r in side)) for side in sides],
            [_mean(r["closed"] for r in side if r["closed"] is not None) for side in sides],
        )
        beside = (", ".join(c if side else "-" for c, side in zip(cell, sides, strict=True)) for cell in cells)
        lines.append(f"| {case.name} | {' | '.join(beside)} | {_errors(sides)} |")
    return lines


def _errors(sides: Sequence[Sequence[Mapping[str, Any]]]) -> str:
    """Return the mean errors with the right and the wrong settings, and after advice with truth and without."""
    known = [[r["errors_m"] for r in side if r["errors_m"]] for side in sides]
    first = next((side for side in known if side), None)
    if first is None:
        return ""
    means = [sum(e[i] for e in first) / len(first) for i in (0, 1)]
    means += [sum(e[2] for e in side) / len(side) for side in known if side]
    return ", ".join(f"{1000 * mean:.1f}" for mean in means)


def goals(rows: Sequence[Mapping[str, Any]], chosen: Sequence[Case]) -> list[str]:
    """Return what the table comes to, with truth and without."""
    lines = ["| all cases | with truth | without |", "|---|--:|--:|"]
    faulty = {c.name: c for c in chosen if c.faults and c.roles}
    sides = [[r for r in rows if r["truth"] == truth and r["case"] in faulty] for truth in (True, False)]
    every = [[r for r in rows if r["truth"] == truth] for truth in (True, False)]

    def row(name: str, cells: Sequence[str]) -> None:
        lines.append(f"| {name} | {' | '.join(cells)} |")

    gaps = [[r for r in side if r["closed"] is not None] for side in sides]
    row("the right key is offered, where the fault costs anything", [_share(g, "named") for g in gaps])
    others = [sum(bool(set(r["accused"]) - faulty[r["case"]].roles) for r in side) for side in sides]
    row("somebody else gets a fix too", [f"{n} of {len(s)}" for n, s in zip(others, sides, strict=True)])
    row("an error grows", [f"{sum(bool(r['worse']) for r in side)} of {len(side)}" for side in every])
    row("of the gap to the right settings is closed", [_mean(r["closed"] for r in g) for g in gaps])
    return lines


def _share(rows: Sequence[Mapping[str, Any]], key: str) -> str:
    return f"{sum(bool(r[key]) for r in rows)} of {len(rows)}"


def _mean(shares: Iterable[float]) -> str:
    """Return the mean share; more than all of it counts as all."""
    values = [min(share, 1.0) for share in shares]
    return f"{sum(values) / len(values):.0%}" if values else "no gap"


def put(page: Path, name: str, lines: Sequence[str]) -> None:
    """Put lines into a page, between <!-- name --> and <!-- end -->."""
    block = re.compile(rf"<!-- {name} -->\n.*?<!-- end -->", re.DOTALL)
    text = page.read_text(encoding="utf-8")
    if not block.search(text):
        raise click.ClickException(f"{page} has no place for {name}")
    whole = "\n".join((f"<!-- {name} -->", *lines, "<!-- end -->"))
    page.write_text(block.sub(lambda _: whole, text), encoding="utf-8")


@click.command()
@click.option("--seeds", default=8, show_default=True)
@click.option("--first", default=FIRST_SEED, show_default=True, help="The first seed: others are fresh drives.")
@click.option("--case", "words", multiple=True, help="Only cases whose name holds this word. Repeatable.")
@click.option(
    "--truth", "which", type=click.Choice(["both", "with", "without"]), default="both", show_default=True
)
@click.option("-o", "out", type=click.Path(path_type=Path), default=Path("advice.jsonl"), show_default=True)
@click.option("--write", is_flag=True, help="Put the table into docs/advice.md.")
def main(seeds: int, first: int, words: tuple[str, ...], which: str, out: Path, write: bool) -> None:
    """Print a table; cases that stand in the file of -o are not run again."""
    chosen = [c for c in cases() if not words or any(word in c.name for word in words)]
    truths = {"both": (True, False), "with": (True,), "without": (False,)}[which]
    rows = []
    for row in results(range(first, first + seeds), out, chosen, truths):
        rows.append(row)
        closed = "" if row["closed"] is None else f"{row['closed']:.0%} closed"
        click.echo(
            f"{row['seed']} {row['case']}: {' '.join(row['fixes']) or '-'} {closed} {row['worse']}", err=True
        )
    lines = [*goals(rows, chosen), "", *table(rows, chosen)]
    for line in lines:
        click.echo(line)
    if write:
        put(PAGE, "drives", lines)


if __name__ == "__main__":
    main()
