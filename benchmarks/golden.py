"""Regression check of all results: recorded with one version of the code, compared with another.

    git worktree add ../before COMMIT
    (cd ../before; pip install -e .; python -m benchmarks.golden --write /tmp/golden)
    python -m benchmarks.golden --check /tmp/golden         # on the code as it is now

Use the same LOCFUSE_DATA for both. Sample logs, simulated drives and real logs are fused under many options
(`benchmarks.golden_cases`). Poses, covariances, states, the verdict on every measurement, maps, reports and the
output of commands are recorded. Simulated logs are made when they are first needed and stay in the folder, so that
both versions read the same bytes.

Largest differences: 1e-9 m or rad for a pose, 1e-9 relative for a number of a report (at least 1e-12), 1e-7 of the
largest number for other columns, 1e-7 of the sigmas for a covariance. If submaps close loops, these limits are ten
times larger, since the solver of the graph stops at a tolerance.
"""

import json
import os
import re
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import click
import numpy as np
from numpy.typing import NDArray

import locfuse
from benchmarks.experiment import in_processes, locfuse as run_command
from benchmarks.golden_cases import HERE, LOGS, QUICK, SIMULATED, Case, cases, simulate
from benchmarks.real_logs import DATA
from locfuse.fusion.data import VERDICTS, Estimates
from locfuse.fusion.fuse import fuse
from locfuse.fusion.judge.without_truth import listeners

MOST = 500  # largest number of recorded rows of most columns; update times and verdicts are complete
LISTED = 10  # largest number of printed differences of a report
WITHIN, WIDER, LOOPS = 1e-9, 100.0, 10.0
FLOOR = 1e-12
FIRST = ("pose", "covariance", "verdict", "state")  # most important columns, printed first if they differ
VALUES = ""  # name of the values that are not columns of a run
NOT_COMPARED = ("made_with", "locfuse", "key", "cpu_s")  # keys of a report that may differ
Columns = dict[str, NDArray[Any]]
Values = dict[str, Any]


class Found(NamedTuple):
    """The result of a case: columns of its runs, and values of its report."""

    columns: Columns  # "run/what" -> array
    values: Values  # numbers and words, by their path in reports

    @property
    def runs(self) -> set[str]:
        """The names of the case's runs."""
        return {name.partition("/")[0] for name in self.columns}


def evenly(n: int) -> NDArray[np.intp]:
    return np.unique(np.linspace(0, n - 1, min(n, MOST)).round().astype(np.intp)) if n else np.zeros(0, np.intp)


def columns_of(e: Estimates) -> Columns:
    at = evenly(len(e.t))
    found: Columns = {"instants": np.array([len(e.t)]), "t": e.t[at], "pose": e.pose[at]}
    found["covariance"] = e.P[at][:, *np.triu_indices(3)]
    for what, blocks in (("state", e.blocks), ("sigma of state", e.block_sigmas)):
        found |= {f"{what} {name}": values[at] for name, values in blocks.items()}
    for sensor, audit in e.audits.items():
        rows = evenly(len(audit.verdict))
        for name in ("instant", "row", "verdict", "landmark"):
            found[f"{sensor} {name}"] = getattr(audit, name)
        found |= {f"{sensor} {name}": getattr(audit, name)[rows] for name in ("nis", "threshold", "y", "sigma")}
        found[f"{sensor} joint"] = audit.joint[evenly(len(audit.joint))]
    for which, lines in (("first map", e.first_map), ("final map", e.final_map)):
        rows_of = [(m.id, m.hits, m.rho, m.beta, *m.ends, *m.P_map[np.triu_indices(2)]) for m in lines]
        found[which] = np.array(rows_of).reshape(-1, 9)
    found["landmarks"] = np.array(e.points, float).reshape(-1, 3)
    return found | {"loops": e.loops, "loop poses": e.loop_poses, "lost": np.array(e.lost).reshape(-1, 2)}


def flat(value: Any, path: str = "") -> Iterator[tuple[str, Any]]:
    """Yield (path, value) of each number and text in a report."""
    if isinstance(value, Mapping):
        for key, inner in value.items():
            if key not in NOT_COMPARED:
                yield from flat(inner, f"{path}.{key}" if path else str(key))
    elif isinstance(value, list | tuple):
        yield f"{path}.length", len(value)
        for i, inner in enumerate(value):
            yield from flat(inner, f"{path}.{i}")
    else:
        yield path, value if isinstance(value, int | float | None) else str(value)


def found_by(case: Case, logs: Path, spare: Path) -> Found:
    """Run a case and return its result; `spare` is a folder for temporary files."""
    places = {LOGS: str(logs), HERE: os.environ.get(DATA, ""), "{spare}": str(spare)}

    def here(word: str) -> str:
        return re.sub(r"\{logs\}|\{data\}", lambda m: places[m[0]], word)

    def report(value: Any) -> Values:
        for name, place in places.items():
            value = {k: v.replace(place, name) if isinstance(v, str) and place else v for k, v in flat(value)}
        return dict(value)

    log = str(logs / f"{case.log}.mcap") if case.log in SIMULATED else here(case.log)
    words = [here(word) for word in case.words]
    if case.what == "command":
        return Found({}, report(printed(words)))
    if case.what == "several":
        return Found({}, report(locfuse.compare(*words).report))
    options = {"smooth": False, **case.options}
    read = {key: options.pop(key) for key in ("order", "preset", "between") if key in options}
    session = locfuse.load(log, sets=[here(s) for s in case.sets], **read)
    if case.what == "listen":
        return heard(session)
    if case.what == "image":
        session = session.with_map(logs / f"{case.log}.yaml")
    if case.what == "given":
        session.run("lrf", advice=False).save_map(spare / "map.json")
        session = session.with_map(spare / "map.json")
    result = session.run(**options) if case.what == "run" else session.compare(**options)
    columns = {f"{n}/{what}": c for n, e in result.estimates.items() for what, c in columns_of(e).items()}
    return Found(columns, report(result.report))


def heard(session: locfuse.Session) -> Found:
    """Return the results of runs with predictions for the sensors that they do not use."""
    drive, found = session.drive, Found({}, {})
    for sensors in ([], *([s] for s in drive.measurements), list(drive.measurements)):
        name = "+".join(sensors) or "odometry"
        e = fuse(drive, session.robot, sensors, name, listeners(drive, sensors))
        found.columns.update({f"{name}/{what}": c for what, c in columns_of(e).items()})
    return found


def printed(words: list[str]) -> Any:
    """Return a command's exit code and output, parsed if it is JSON."""
    code, out, _ = run_command(*words)
    try:
        return {"exit": code, "printed": json.loads(out)}
    except json.JSONDecodeError:
        return {"exit": code, "printed": out.splitlines()}


def file_of(case: Case) -> str:
    return f"{re.sub(r'[^a-z0-9=.-]+', '_', case.name.lower())}.npz"


def run(logs: Path, into: Path, case: Case) -> None:
    began = time.process_time()
    try:
        with tempfile.TemporaryDirectory() as spare:
            found = found_by(case, logs, Path(spare))
    except Exception as e:
        found = Found({}, {"error": f"{type(e).__name__}: {e}"})
    values = {**found.values, "cpu_s": time.process_time() - began}
    arrays: dict[str, Any] = {**found.columns, VALUES: np.frombuffer(json.dumps(values).encode(), np.uint8)}
    with (into / file_of(case)).open("wb") as file:
        np.savez_compressed(file, **arrays)


def read(file: Path) -> Found:
    """Return a case's recorded result; an error if its process ended early."""
    if not file.exists():
        return Found({}, {"error": "the process ended without a result"})
    with np.load(file) as kept:
        columns = {name: kept[name] for name in kept.files}
    return Found(columns, json.loads(columns.pop(VALUES).tobytes()))


def differences(before: Found, now: Found, slack: float) -> list[str]:
    if ("error" in before.values) != ("error" in now.values):
        errors = [found.values.get("error", "a result") for found in (before, now)]
        return [f"{errors[0]} before, {errors[1]} now"]
    names, other = before.columns | now.columns, before.runs ^ now.runs
    slack *= LOOPS if any(len(column) for name, column in names.items() if name.endswith("/loops")) else 1.0
    words = [f"{run}: this run is {'new' if run in now.runs else 'missing'}" for run in sorted(other)]
    columns, report = list[str](), list[str]()
    for name in sorted(names, key=lambda name: [word not in re.split("[ /]", name) for word in FIRST]):
        how = _differs(name, before.columns.get(name), now.columns.get(name), slack)
        if how is not None and name.partition("/")[0] not in other:
            columns.append(f"{name}: {how}")
    for key in [key for key in before.values | now.values if key not in NOT_COMPARED]:
        a, b = before.values.get(key, "nothing"), now.values.get(key, "nothing")
        report += [] if _equal(a, b, slack) else [f"{key}: {a} before, {b} now"]
    more = f"and {len(columns[LISTED:])} more columns, {len(report[LISTED:])} more values of the report"
    listed = [*words, *columns[:LISTED], *report[:LISTED]]
    return [*listed, more] if max(len(columns), len(report)) > LISTED else listed


def _equal(a: Any, b: Any, slack: float) -> bool:
    if not all(isinstance(v, int | float) and not isinstance(v, bool) for v in (a, b)):
        return bool(a == b)
    return bool(np.isclose(a, b, rtol=WITHIN * slack, atol=FLOOR, equal_nan=True))


def _differs(name: str, a: NDArray[Any] | None, b: NDArray[Any] | None, slack: float) -> str | None:
    """Return the difference of two columns in words, None if they are equal."""
    if a is None or b is None:
        return "new" if a is None else "missing"
    if a.shape != b.shape:
        return f"{a.shape} before, {b.shape} now"
    if np.array_equal(a, b, equal_nan=a.dtype.kind == "f"):
        return None
    if a.dtype.kind == "i":
        rows = np.argwhere(a != b)
        first = [VERDICTS[v] if name.endswith("verdict") else v for v in (a[*rows[0]], b[*rows[0]])]
        return f"{len(rows)} of {a.size} differ, first in row {rows[0][0]}: {first[0]} before, {first[1]} now"
    known = np.isfinite(a) & np.isfinite(b)
    if not np.array_equal(a[~known], b[~known], equal_nan=True):
        return f"{(~known).sum()} are no numbers, before or now"
    off = np.abs(np.where(known, a, 0.0) - np.where(known, b, 0.0))
    if name.endswith("/pose"):
        far, turned = float(np.hypot(off[:, 0], off[:, 1]).max()), float(off[:, 2].max())
        return f"{far:.2g} m, {turned:.2g} rad" if max(far, turned) > WITHIN * slack else None
    if name.endswith("/covariance"):
        i, j = np.triu_indices(3)
        sigma = np.sqrt(np.abs(a[:, [0, 3, 5]]))
        scale = sigma[:, i] * sigma[:, j]
    else:
        scale = np.abs(np.where(known, a, 0.0)).max(axis=0)
    size = float((off / (scale + FLOOR)).max())
    return f"{size:.2g} of its size" if size > WITHIN * WIDER * slack else None


@click.command()
@click.option("--write", "record", type=click.Path(file_okay=False, path_type=Path), help="Keep results there.")
@click.option("--check", type=click.Path(file_okay=False, exists=True, path_type=Path), help="Compare with these.")
@click.option("--only", default="", help="Only cases whose name holds this.")
@click.option("--quick", is_flag=True, help="Some of every kind, in two minutes.")
@click.option("--jobs", default=1, show_default=True)
def main(record: Path | None, check: Path | None, only: str, quick: bool, jobs: int) -> None:
    """Record what the filter does on many logs under many options, or check that it still does the same."""
    chosen = [c for c in cases() if only in c.name and (c.name in QUICK or not quick)]
    if (record is None) == (check is None):
        raise click.UsageError("give --write FOLDER or --check FOLDER")
    logs = ((record or check or Path()) / "logs").absolute()
    logs.mkdir(parents=True, exist_ok=True)
    if check is not None:
        for case in [c for c in chosen if not (check / file_of(c)).exists()]:
            click.echo(f"{case.name}: not recorded")
            chosen.remove(case)
    needed = dict.fromkeys(name for case in chosen for name in case.simulated())
    for name, failed in in_processes(partial(simulate, logs), needed, 1):  # threads of cv2 do not survive a fork
        if failed:
            raise click.ClickException(f"the log {name} could not be simulated: {failed}")
    cpu, equal = 0.0, 0
    with tempfile.TemporaryDirectory() as spare:
        into = record or Path(spare)
        for case, _ in in_processes(partial(run, logs, into), chosen, jobs):
            now = read(into / file_of(case))
            took = now.values.get("cpu_s", 0.0)
            said = [] if check is None else differences(read(check / file_of(case)), now, case.slack)
            cpu, equal = cpu + took, equal + (not said)
            kept = f"{len(now.runs) or 1} runs, {took:.1f} s {now.values.get('error', '')}"
            verdict = kept if check is None else "differs" if said else "ok"
            click.echo("\n  ".join([f"{case.name}: {verdict}", *said]))
    what = "kept" if check is None else "equal"
    click.echo(f"{equal} of {len(chosen)} cases {what}, {cpu:.0f} s of CPU time")
    sys.exit(equal != len(chosen))


if __name__ == "__main__":
    main()
