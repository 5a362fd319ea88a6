"""Several words after `compare`: logs give a summary, results stand side by side, parts are one log."""

import json
import shutil
from csv import DictReader
from io import StringIO
from pathlib import Path
from typing import Any

import pytest
from bags import S, drive, write
from commands import jobs_here, locfuse, ok, refused
from many_logs import LIGHT, THERE_AND_BACK, write_logs

from locfuse.cli.analysis.grouping import logs_of, results_of
from locfuse.cli.session.summary import summarised
from locfuse.formats.report import changes as sides, summary as over
from locfuse.formats.report.fleet import Entry, csv, fleet_table, slim
from locfuse.formats.report.table import records
from locfuse.fusion.data import UsageError


def report(rmse: dict[str, float | None], anees: float = 1.0, sha: str = "00", **settings: Any) -> dict[str, Any]:
    """A report.json as far as summaries read it."""
    rest = {"anees": anees, "duration_s": 9.0, "align": "none", "smoothed": False, "sensors": {}}
    rows = {name: {"position_rmse_m": value, **rest} for name, value in rmse.items()}
    about = {"locfuse": "0.2.0", "input": {"name": "drive", "sha256": sha}}
    return {**about, "configurations": rows, "settings": settings, "credit": None}


def test_mean_median_and_worst_over_logs() -> None:
    values = (0.1, 0.2, 0.6)
    found = over.summarise({f"log {i}": report({"all": v, "lrf": 2 * v}) for i, v in enumerate(values)})
    figure = found["configurations"]["all"]["figures"]["position_rmse_m"]
    assert figure["mean"] == pytest.approx(0.3)
    assert figure["median"] == pytest.approx(0.2)
    assert (figure["worst"], figure["worst_log"], figure["logs"]) == (0.6, "log 2", 3)
    assert "duration_s" not in found["configurations"]["all"]["figures"]
    assert "smoothed" not in found["configurations"]["all"]["figures"]


def test_the_worst_anees_is_furthest_from_one_and_names_become_no_markup() -> None:
    found = over.summarise({str(a): report({"all": 0.1}, anees=a) for a in (0.1, 1.0, 5.0)})
    figure = found["configurations"]["all"]["figures"]["anees"]
    assert (figure["worst"], figure["worst_log"]) == (0.1, "0.1")
    found = over.summarise({"a|b*": report({"all": 0.1})})
    assert r"a\|b\*" in over.render({**found, "locfuse": "0.2.0"})


def test_the_best_has_the_smallest_mean_among_those_that_every_log_has() -> None:
    reports = {
        "a": report({"odometry": 0.5, "lrf": 0.1, "all": 0.2, "camera": 0.01}),
        "b": report({"odometry": 0.5, "lrf": 0.5, "all": 0.2}),
        "c": report({"odometry": 0.5, "lrf": 0.1, "all": 0.2}),
        "no truth": report({"odometry": None, "lrf": None, "all": None}),
    }
    found = over.summarise(reports)
    assert found["best"] == "all"
    assert found["judged"] == 3
    assert [found["logs"][name]["best"] for name in reports] == ["camera", "all", "lrf", None]
    assert {n: c["best_in"] for n, c in found["configurations"].items()} == {
        "odometry": 0,
        "lrf": 1,
        "all": 1,
        "camera": 1,
    }
    assert over.headline(found).startswith("Best is all: mean position rmse 0.2000 m; the best in 1 of 3 logs")
    assert "1 without truth" in over.headline(found)


def test_a_log_whose_figures_are_void_has_a_truth_and_it_is_said_what_is_wrong() -> None:
    void = {"message": "lost for 70%", "void": True}
    reports = {"a": {**report({"all": None}), "validity": [void]}, "b": report({"all": None})}
    found = summarised([Entry(name, report=slim({"": r})) for name, r in reports.items()])
    assert over.headline(found) == "No log has an error figure: 1 void, 1 without truth."
    assert "void: lost for 70%" in over.render(found)


def test_the_table_for_machines_has_a_row_per_log_and_configuration() -> None:
    reports = {"a": report({"odometry": 0.5, "all": 0.125}), "b": report({"all": None})}
    entries = [Entry(name, "r1", report=slim({"": r})) for name, r in reports.items()]
    rows = list(DictReader(StringIO(csv(fleet_table([*entries, Entry("c", None, "failed", "a text, no log")])))))
    wanted = ("log", "robot", "configuration", "position_rmse_m", "anees", "state", "reason")
    assert [tuple(row[c] for c in wanted) for row in rows] == [
        ("a", "r1", "odometry", "0.5", "1.0", "done", ""),
        ("a", "r1", "all", "0.125", "1.0", "done", ""),
        ("b", "r1", "all", "", "1.0", "done", ""),
        ("c", "", "", "", "", "failed", "a text, no log"),
    ]


def test_changes_of_every_figure_and_setting_between_two_results() -> None:
    before = report({"all": 0.2, "lrf": 0.4}, lrf={"map": "grow", "x": 0.2}, order="auto")
    after = report({"all": 0.3, "camera": 0.1}, sha="11", lrf={"map": "refine", "x": 0.2}, order="auto")
    found = sides.changes(before, after)
    figure = found["configurations"]["all"]["position_rmse_m"]
    assert figure == pytest.approx({"before": 0.2, "after": 0.3, "change": 0.1, "share": 0.5})
    assert found["settings"] == {"lrf.map": ["grow", "refine"]}
    assert (found["only_before"], found["only_after"]) == (["lrf"], ["camera"])
    said = " ".join(sides.remarks(found))
    assert "different input" in said
    assert "lrf.map: grow -> refine" in said
    assert "| all | position rmse | 0.2000 m | 0.3000 m | +50.0% |" in sides.render(("a", "b"), found)
    found = sides.changes(report({"all": None}), report({"all": 0.3}))  # only one of them has the figure
    assert found["configurations"]["all"]["position_rmse_m"]["change"] is None
    assert [row["figure"] for row in records(sides.table(found))] == ["ANEES"]


@pytest.fixture(scope="module")
def drives(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Three short drives that begin at the same instant, named as the parts of a split recording are."""
    names = [f"drive_{seed}" for seed in range(3)]
    return write_logs(tmp_path_factory.mktemp("drives"), names, (*LIGHT, THERE_AND_BACK))


@pytest.fixture(scope="module")
def summary(drives: list[Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("summary") / "out"
    with jobs_here():
        done = ok("compare", *drives, "-o", out, "--write", "json,md,csv")
    assert "Best is" in done.stdout
    assert "mean" in done.stdout
    return out


def test_several_logs_give_a_summary_and_a_folder_each(drives: list[Path], summary: Path) -> None:
    assert {p.name for p in summary.iterdir()} == {
        "summary.json",
        "summary.md",
        "summary.csv",
        "fleet.parquet",
        *(d.stem for d in drives),
    }
    found = json.loads((summary / "summary.json").read_text())
    each = [json.loads((summary / d.stem / "report.json").read_text()) for d in drives]
    for name in ("odometry", "compass"):
        values = [r["configurations"][name]["position_rmse_m"] for r in each]
        assert found["configurations"][name]["figures"]["position_rmse_m"]["mean"] == pytest.approx(
            sum(values) / 3
        )
        assert found["configurations"][name]["figures"]["position_rmse_m"]["worst"] == max(values)
    assert found["logs"].keys() == {d.stem for d in drives}


@pytest.mark.usefixtures("jobs_in_this_process")
def test_a_summary_is_replaced_and_a_foreign_folder_not(drives: list[Path], summary: Path, tmp_path: Path) -> None:
    before = (summary / "summary.json").read_bytes()
    done = ok("compare", *drives, "-o", summary, "--write", "json", "--json")
    assert (summary / "summary.json").read_bytes() == before == done.stdout.encode()
    (tmp_path / "chapter1.tex").write_text("precious")
    assert "--overwrite" in refused("compare", *drives, "-o", tmp_path)
    assert [p.name for p in tmp_path.iterdir()] == ["chapter1.tex"]


@pytest.mark.usefixtures("jobs_in_this_process")
def test_a_gate_that_one_log_fails_fails_the_summary(drives: list[Path], tmp_path: Path) -> None:
    words = ("--sensors", "odometry", "--write", "json", "-o", tmp_path / "out")
    done = locfuse("compare", *drives, *words, "--fail-if", "odometry.position_rmse_m > 0.0001")
    assert done.exit_code == 4


def test_results_are_set_side_by_side(drives: list[Path], summary: Path, tmp_path: Path) -> None:
    other = tmp_path / "noisier"
    words = ("--set", "compass.sigma_deg=30", "--write", "json")
    ok("compare", drives[0], *words, "-o", other)
    done = ok("compare", summary / drives[0].stem, other)
    assert "compass.sigma_deg: 3.0 -> 30.0" in done.stdout
    assert "odometry" in done.stdout
    assert "different input" not in done.stdout
    as_json = json.loads(locfuse("compare", summary / drives[0].stem, other, "--json").stdout)
    odometry = as_json["after"][str(other)]["configurations"]["odometry"]["position_rmse_m"]
    assert odometry["change"] == 0.0
    written = ok("compare", summary / drives[0].stem, other, "-o", tmp_path / "changes")
    assert {p.name for p in (tmp_path / "changes").iterdir()} == {"changes.json", "changes.md"}
    assert f"{tmp_path / 'changes'}: changes.json, changes.md" in written.stdout


def test_a_result_beside_itself_has_not_changed_and_a_log_or_a_broken_one_is_refused(
    summary: Path, drives: list[Path], tmp_path: Path
) -> None:
    one = summary / drives[0].stem
    done = ok("compare", one, one)
    assert sum(line.split()[-1:] == ["="] for line in done.stdout.splitlines()) >= 2
    assert "either logs or results" in refused("compare", drives[0], summary / drives[0].stem, code=2)
    with pytest.raises(UsageError):
        results_of([str(drives[0]), str(summary / drives[0].stem)])
    assert results_of([str(summary / drives[0].stem)]) is None
    (tmp_path / "report.json").write_text('{"configurations": 3}')
    assert "not a report of locfuse" in refused("compare", summary / drives[0].stem, tmp_path)


@pytest.mark.parametrize(
    "option",
    [("--fail-if", "all.position_rmse_m > 0"), ("--set", "lrf.map=refine"), ("--strict",), ("--all-subsets",)],
)
def test_what_needs_a_log_is_refused_beside_results_and_not_passed_by(
    summary: Path, drives: list[Path], option: tuple[str, ...]
) -> None:
    results = [summary / drive.stem for drive in drives[:2]]
    assert f"{option[0]} is for logs" in refused("compare", *results, *option, code=2)


def test_numbered_recordings_that_overlap_in_time_are_logs_of_their_own(drives: list[Path]) -> None:
    words = [str(d) for d in drives]
    assert logs_of(words) == [[w] for w in words]


def test_what_is_named_twice_counts_once(drives: list[Path], tmp_path: Path) -> None:
    bag = tmp_path / "bag"
    bag.mkdir()
    (bag / "bag.mcap").write_bytes(drives[0].read_bytes())
    (bag / "metadata.yaml").write_text("rosbag2_bagfile_information: {}")
    inside, beside = str(bag / "bag.mcap"), str(bag / ".." / "bag" / "bag.mcap")
    assert logs_of([inside, str(bag / "metadata.yaml")]) == [[inside]]
    assert logs_of([inside, beside, str(drives[1])]) == [[inside], [str(drives[1])]]
    assert logs_of([str(bag / "metadata.yaml")]) == [[str(bag / "metadata.yaml")]]


def test_numbered_recordings_that_follow_each_other_are_one_log(tmp_path: Path) -> None:
    parts = [tmp_path / f"bag_{i}.mcap" for i in range(2)]
    for i, part in enumerate(parts):
        write(part, [m._replace(log_time=m.log_time + i * 3600 * S) for m in drive(20)])
    other = tmp_path / "elsewhere.mcap"
    shutil.copy(parts[0], other)
    assert logs_of([str(p) for p in (*parts, other)]) == [[str(p) for p in parts], [str(other)]]


@pytest.mark.usefixtures("jobs_in_this_process")
def test_equal_names_get_folders_of_their_own(drives: list[Path], tmp_path: Path) -> None:
    twin = tmp_path / "again" / drives[0].name
    twin.parent.mkdir()
    shutil.copy(drives[0], twin)
    ok("compare", drives[0], twin, "-o", tmp_path / "out", "--write", "json", "--sensors", "odometry")
    assert {p.name for p in (tmp_path / "out").iterdir()} == {"drive_0", "drive_0_2", "summary.json"}
