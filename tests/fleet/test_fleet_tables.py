"""What is said over all logs: rows, statistics by robot, gates, the page. Against SciPy and pyarrow."""

import csv as csv_module
import io
import json
import math
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet
import pytest
from commands import locfuse as command, ok
from many_logs import simulated_files, simulated_report
from scipy import stats

import locfuse
from locfuse.cli.analysis.gates import Gates
from locfuse.cli.analysis.settings import GateOptions, cells, swept
from locfuse.cli.session.summary import mean_over, summarised
from locfuse.formats.report import summary as over
from locfuse.formats.report.fleet import KINDS, Entry, csv, fleet_table, slim, summary_files
from locfuse.fusion.data import LocfuseError, UsageError
from locfuse.fusion.sensors.registry import colours

RMSE = "position_rmse_m"


def entry(name: str, robot: str | None, figures: dict[str, float | None], **more: Any) -> Entry:
    """A log of a robot with these position errors by configuration."""
    report = simulated_report(np.random.default_rng(0), int(more.pop("log", 0)), 0)
    base = report["configurations"]["all"]
    report["configurations"] = {c: {**base, "configuration": c, RMSE: v} for c, v in figures.items()}
    report["input"]["identity"] = more.pop("identity", name)
    return Entry(name, robot, report=slim({"": {**report, **more}}))


def test_ten_thousand_rows_fit_a_small_page_and_lose_nothing() -> None:
    files = simulated_files(10_000)
    assert len(files["summary.html"]) < 3_000_000
    assert "<p>1760 more logs are in summary.csv (--write csv).</p>" in files["summary.html"]
    table = pyarrow.parquet.read_table(io.BytesIO(files["fleet.parquet"]))
    lines = files["summary.csv"].splitlines()
    assert table.num_rows == len(lines) - 1 == 2000 * 5 - 40 * 4  # one row of each log that failed
    assert table.column_names == lines[0].split(",")
    errors = table.column(RMSE).to_pylist()
    at = table.column_names.index(RMSE)
    assert [None if e is None else repr(e) for e in errors[:500]] == [
        line.split(",")[at] or None for line in lines[1:501]
    ]
    assert sum(state == "failed" for state in table.column("state").to_pylist()) == 40


def test_the_mean_is_of_robots_and_its_interval_students_t_over_them() -> None:
    errors = {"r1": (0.1, 0.3, 0.2), "r2": (0.5,), "r3": (0.4, 0.2), "r4": (0.25,)}
    entries = [
        entry(f"{robot}-{i}", robot, {"all": e}) for robot, found in errors.items() for i, e in enumerate(found)
    ]
    summary = summarised(entries)
    figure = summary["configurations"]["all"]["figures"][RMSE]
    means = [np.mean(found) for found in errors.values()]
    low, high = stats.t.interval(0.95, 3, np.mean(means), stats.sem(means))
    assert figure["mean"] == pytest.approx(np.mean(means))
    assert (figure["low"], figure["high"]) == pytest.approx((low, high), rel=1e-4)
    assert (figure["replicates"], figure["logs"]) == (4, 7)
    assert summary["replicates"] == {"of": "robots", "robots": 4, "logs": 7}
    assert figure["p90"] == pytest.approx(np.percentile([e for found in errors.values() for e in found], 90))


@pytest.mark.parametrize("values", [[0.2], [0.1, 0.3], [0.1, 0.2, 0.3]])
def test_fewer_than_four_replicates_have_no_interval_and_a_tie_of_two_neither(values: list[float]) -> None:
    found = mean_over(values)
    assert found.mean == pytest.approx(0.2)
    assert found[1:] == (None, None, len(values))
    errors: tuple[dict[str, float | None], ...] = ({"lrf": 0.10, "all": 0.12}, {"lrf": 0.12, "all": 0.11})
    tie = summarised([entry(str(i), None, e) for i, e in enumerate(errors)])["ties"]
    assert [(t["low"], t["high"]) for t in tie.values()] == [(None, None)]


def test_equal_configurations_tie_and_different_ones_do_not() -> None:
    rng = np.random.default_rng(2)
    entries = [
        entry(str(i), f"r{i}", {"lrf": e, "all": e * math.exp(0.1 * rng.standard_normal()), "odometry": 9 * e})
        for i, e in enumerate(rng.uniform(0.1, 0.2, 12))
    ]
    summary = summarised(entries)
    assert len(summary["ties"]) == 1
    assert {summary["best"], *summary["ties"]} == {"lrf", "all"}
    assert "A tie with" in over.headline(summary)
    assert "12 robots cannot tell them apart" in over.headline(summary)


def having_effect(name: str, robot: str, ln: float) -> Entry:
    """A log in which every sensor alone makes the error so much smaller, ln(before / after)."""
    report = simulated_report(np.random.default_rng(0), 0, 0)
    for sensor in report["credit"]["sensors"].values():
        sensor["alone"] = {"ln": ln, "expected": 2.0}
    return Entry(name, robot, report=slim({"": report}))


def test_what_a_sensor_does_is_averaged_within_a_robot_first() -> None:
    effects = {"r1": (0.2, 0.4), "r2": (0.9,), "r3": (1.2, 1.0), "r4": (0.8,)}
    found = [having_effect(f"{robot}{ln}", robot, ln) for robot, lns in effects.items() for ln in lns]
    alone = summarised(found)["credit"]["sensors"]["lrf"]["alone"]
    means = [np.mean(found) for found in effects.values()]
    low, high = stats.t.interval(0.95, 3, np.mean(means), stats.sem(means))
    assert alone["ln"] == pytest.approx(np.mean(means))
    assert (math.log(alone["low"]), math.log(alone["high"])) == pytest.approx((low, high), rel=1e-4)


def test_what_is_not_proven_names_the_robots_or_of_one_robot_its_drives() -> None:
    for robots, words in ((2, "Not proven by 2 robots. Record more."), (1, "Not proven by 4 drives.")):
        effects = enumerate((1.5, -0.9, 1.6, 0.3))
        found = summarised([having_effect(str(i), f"r{i % robots}", ln) for i, ln in effects])
        assert words in found["verdicts"]["lrf"]["words"]


def fleet(scale: float = 1.0, count: int = 11) -> dict[str, Any]:
    return summarised([entry(str(i), None, {"all": scale * (0.01 + 0.001 * i)}) for i in range(count)])


@pytest.mark.parametrize(
    ("gate", "line"),
    [
        ("fleet.all.position_rmse_m.p90 > 0.018", "it is 0.019"),
        ("fleet.all.position_rmse_m.p90 > 0.0195", None),
        ("fleet.all.position_rmse_m.worst >= 0.02", "it is 0.02"),
        ("fleet.failed > 0", "it is 1"),
        ("fleet.lrf.position_rmse_m.p90 > 1", "no such configuration"),
        ("fleet.all.position_rmse_m > 1", "name a statistic"),
        ("fleet.all.height_m.p90 > 1", "no such figure"),
    ],
)
def test_a_gate_over_all_logs(gate: str, line: str | None) -> None:
    summary = fleet()
    summary["logs"]["broken"] = {"state": "failed"}
    found = Gates.read(GateOptions((gate,)), of_fleet=True).failures_together(summary)
    assert bool(found) == (line is not None)
    assert line is None or line in found[0]


def test_gates_without_fleet_are_for_every_log() -> None:
    gates = Gates.read(GateOptions(("all.position_rmse_m > 0.1",)), of_fleet=True)
    assert gates.failures_together(fleet()) == []
    assert gates.failures({"configurations": {"all": {RMSE: 0.2}}}) == ["all.position_rmse_m > 0.1: it is 0.2"]


def test_a_baseline_is_a_summary_of_the_same_logs(tmp_path: Path) -> None:
    path = tmp_path / "summary.json"
    path.write_text(json.dumps(fleet()))
    gates = Gates.read(GateOptions(baseline=path), of_fleet=True)
    assert gates.failures_together(fleet()) == []
    assert gates.failures_together(fleet(1.04)) == []
    worse = gates.failures_together(fleet(1.06))
    assert any(line.startswith("fleet.all.position_rmse_m.p90: 0.02014 is 6.0% more") for line in worse)
    assert "1 of its logs have no result now (10)" in gates.failures_together(fleet(count=10))[0]
    assert "1 logs are not in it (11)" in gates.failures_together(fleet(count=12))[0]
    path.write_text("{}")
    with pytest.raises(LocfuseError, match=r"not a summary\.json"):
        Gates.read(GateOptions(baseline=path), of_fleet=True)


def page(entries: list[Entry]) -> str:
    found = summary_files(summarised(entries), entries, {"html"}, colours())["summary.html"]
    assert isinstance(found, str)
    return found


def test_the_page_links_every_log_the_worst_first_and_shows_robots_failures_and_days() -> None:
    finding = {"role": "compass", "code": "late", "message": "stamps look late", "fixes": ["compass.x=1"]}
    entries = [
        entry(f"log {i}", f"r{i % 3}", {"all": 0.01 * (i + 1), "odometry": 1.0}, log=20 * i, findings=[finding])
        for i in range(15)
    ]
    void = {"validity": [{"message": "the filter was lost", "void": True}]}
    entries += [entry("truthless", "r1", {"all": None}), entry("lost", "r2", {"all": None}, **void)]
    entries.append(Entry("torn", "r1", "failed", "torn.mcap: not an MCAP file: empty (0 bytes)"))
    found = page(entries)
    logs = found[found.index('id="logs"') : found.index('id="findings"')]
    assert logs.index('href="log%2014/report.html"') < logs.index('href="log%2013/report.html"')
    assert logs.count("/report.html") == logs.count("var(--good)") == logs.count("var(--bad)") == 15
    assert "data-from" not in found  # a summary has no such places
    assert ">15</td>" in found[found.index('id="findings"') : found.index('id="robots"')]
    failures = found[found.index('id="failures"') :]
    for words in ("not an MCAP file: empty", "no truth", "the filter was lost"):
        assert words in failures
    assert "17 logs of 3 robots" in found
    assert "days since 2026-01-01" in found
    assert 'id="distribution"' in found
    assert "<script" not in found


def test_names_of_logs_and_reasons_are_no_markup_on_the_page() -> None:
    evil = '<script>alert(1)</script>"onload=x'
    entries = [
        entry(evil, evil, {"all": 0.1}),
        entry("b", evil, {"all": 0.2}),
        Entry(evil + "2", None, "failed", evil),
    ]
    assert "<script" not in page(entries)
    assert 'href="javascript:' not in page([entry("javascript:alert(1)", None, {"all": 0.1})])


@pytest.mark.parametrize("name", ['=HYPERLINK("http://x")', "+cmd|' /C calc'!A0", "-1+1", "@SUM(1)"])
def test_names_of_logs_and_reasons_act_on_no_terminal_and_in_no_spreadsheet(name: str) -> None:
    header, row = csv_module.reader(io.StringIO(csv(fleet_table([Entry(name, name, "failed", name)], []))))
    assert [dict(zip(header, row, strict=True))[key] for key in ("log", "robot", "reason")] == ["'" + name] * 3
    text = csv(fleet_table([Entry("a\x1b]0;b", None, "failed", "unknown key lrf.\x1b[2J\u202e")], []))
    assert text.isascii()
    assert text.replace("\n", "").isprintable()


def test_logs_without_truth_and_without_any_result_have_a_page() -> None:
    assert "None of these logs has a truth" in page(
        [entry("a", None, {"all": None}), entry("b", "r", {"all": None})]
    )
    assert "No log could be compared" in page([Entry("a", None, "failed", "no")])


def test_the_cells_of_a_sweep_are_columns_and_configurations() -> None:
    reports = {f"lrf.x={x}": simulated_report(np.random.default_rng(x), 0, 0) for x in (1, 2)}
    one = Entry("a", report=slim(reports), cells=tuple(reports))
    header, *lines = csv(fleet_table([one], ["lrf.x"])).splitlines()
    assert header.startswith("log,robot,start,configuration,cell,state,reason,lrf.x,")
    assert len(lines) == 10
    assert lines[0].split(",")[3:8] == ["odometry", "lrf.x=1", "done", "", "1"]
    assert "all [lrf.x=2]" in summarised([one])["configurations"]


def test_without_pyarrow_the_csv_stands_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    entries = [entry("a", None, {"all": 0.1})]
    files = summary_files(summarised(entries), entries, KINDS, colours())
    assert "fleet.parquet" not in files
    assert "summary.csv" in files


# --- a sweep: the log is measured once, and a cell is what --set --no-advice would have given, bit for bit


SETS = {"camera.enabled": False, "path.legs": [{"forward": 1.5}, {"turn_deg": 90}, {"forward": 1.0}]}


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("sweep") / "drive.mcap"
    locfuse.simulate("straight_runs", path, seed=3, sets=SETS)
    return path


def test_words_and_combinations() -> None:
    found = swept(["lrf.sigma_range=0.01,0.03", "lrf.map=grow", "truth.x=[1,2],{a=1,b=2}"])
    assert found["lrf.sigma_range"] == ["lrf.sigma_range=0.01", "lrf.sigma_range=0.03"]
    assert found["truth.x"] == ["truth.x=[1,2]", "truth.x={a=1,b=2}"]
    assert list(cells({"a.b": ["a.b=1", "a.b=2"], "c": ["c=3"]})) == ["a.b=1 c=3", "a.b=2 c=3"]
    with pytest.raises(UsageError, match="more than 1000"):
        cells({str(i): [f"{i}={v}" for v in range(11)] for i in range(3)})
    with pytest.raises(UsageError, match="cannot name a folder"):
        cells({"a": ["a=../x"]})
    with pytest.raises(UsageError, match="twice"):
        swept(["a=1", "a=2"])


@pytest.mark.usefixtures("jobs_in_this_process")
def test_the_command_writes_a_folder_for_each_cell(log: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    words = ("--write", "json,csv", "--sweep", "lrf.sigma_range=0.01,0.05", "--sweep", "compass.sigma_deg=2")
    ok("compare", log, *words, "-o", out)
    folder = out / "drive" / "lrf.sigma_range=0.05,compass.sigma_deg=2"
    sets = ("--set", "lrf.sigma_range=0.05", "--set", "compass.sigma_deg=2")
    alone = ("--no-advice", "--no-smooth", "-o", tmp_path / "one", "--write", "json")
    ok("compare", log, *sets, *alone)
    assert (folder / "report.json").read_bytes() == (tmp_path / "one" / "report.json").read_bytes()
    header, *lines = (out / "summary.csv").read_text().splitlines()
    assert "lrf.sigma_range,compass.sigma_deg" in header
    assert len(lines) == 2 * 4
    # the same folder takes a comparison without a sweep, but none that holds files of somebody else
    other = tmp_path / "other.mcap"
    other.write_bytes(log.read_bytes())
    plain = ("compare", log, other, "--sensors", "odometry", "--write", "json", "-o", out)
    (out / "drive" / "notes.txt").write_text("mine")
    refused = command(*plain)
    assert "drive is not empty and holds no locfuse result" in refused.stderr
    (out / "drive" / "notes.txt").unlink()
    ok(*plain)
    assert (out / "drive" / "report.json").is_file()


def test_python_sweeps_too(log: Path) -> None:
    found = locfuse.load(log).sweep({"lrf.sigma_range": [0.01, 0.05]}, ["lrf"])
    assert list(found) == ["lrf.sigma_range=0.01", "lrf.sigma_range=0.05"]
    errors = [r.evaluations["lrf"].figures["position_rmse_m"] for r in found.values()]
    assert errors[0] != errors[1]
    with pytest.raises(UsageError, match=r"lrf\.topic decides what is read"):
        locfuse.load(log).with_settings({"lrf.topic": "/scan"})
