"""A log without truth as a user meets it: a reference is said on every page, and never taken for truth."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from commands import Done, locfuse, ok, refused, report_in, reported
from present import present

from locfuse.cli.analysis.gates import Gates
from locfuse.cli.analysis.settings import GateOptions
from locfuse.formats.report.changes import changes, remarks

LOG = "rounded_triangle"
SENSORS = [word for name in ("odometry", "compass", "lrf") for word in ("--sensors", name)]
WORDS = ("compare", LOG, "-v", "--write", "all", *SENSORS, "--no-advice")
NO_TRUTH = ("--set", "truth.topic=none")


@pytest.fixture(scope="module")
def judged(tmp_path_factory: pytest.TempPathFactory) -> tuple[Done, Path]:
    out = tmp_path_factory.mktemp("reference") / "out"
    done = ok(*WORDS, *NO_TRUTH, "--estimate", "tracker=/ground_truth/pose", "-o", out)
    return done, out


def test_the_report_names_the_reference_and_what_judged_each_result(judged: tuple[Done, Path]) -> None:
    found = report_in(judged[1])
    assert found["truth"] is None
    assert found["reference"]["sensors"] == ["compass", "lrf", "camera"]
    assert found["reference"]["left_out"] == []
    assert 0.0 < found["reference"]["sigma_m"] < 0.02
    rows = found["configurations"]
    assert rows["odometry"]["reference"]["shared"] == []
    assert rows["compass"]["reference"]["left_out"] == ["compass"]
    assert rows["compass"]["position_rmse_m"] == pytest.approx(0.098, abs=0.01)  # by truth 0.0977
    assert rows["compass"]["anees"] is None


def test_every_page_says_that_it_is_a_reference(judged: tuple[Done, Path]) -> None:
    done, out = judged
    assert "Measured against a reference, not truth" in done.stdout
    assert "Distances are to a reference, not to truth" in done.stdout
    assert "the odometry, compass, lrf and camera" in done.stderr
    page, table = (out / "report.html").read_text(), (out / "report.md").read_text()
    for text in (page, table):
        assert "Measured against a reference, not truth" in text
        assert "the odometry, compass, lrf and camera" in text
        assert "judged by" in text
    assert "Deviation from reference" in page
    assert "Deviation is estimate minus reference" in page
    assert "Deviation = estimate - reference" in table


def test_a_verdict_names_the_reference_that_the_sensor_has_no_part_in(judged: tuple[Done, Path]) -> None:
    words = report_in(judged[1])["verdicts"]["compass"]["words"]
    assert words.startswith("Against a reference without it (lrf and camera, 1 sigma ")


def failed(report: dict[str, Any], gate: str) -> list[str]:
    return Gates.read(GateOptions((gate,))).failures(report)


def test_a_gate_on_truth_fails_on_a_reference_unless_it_says_so(judged: tuple[Done, Path]) -> None:
    plain, meant = "compass.position_rmse_m > 5", "reference.compass.position_rmse_m > 5"
    (line,) = failed(report_in(judged[1]), plain)
    assert f"errors are against a reference, not truth; if that is meant: {meant}" in line
    assert failed(report_in(judged[1]), meant) == []
    (line,) = failed(report_in(judged[1]), "reference.compass.position_rmse_m > 0.01")
    assert ": it is 0.09" in line
    assert failed(report_in(judged[1]), "compass.sensors.compass.accepted < 1") == []


def test_truth_and_reference_are_never_mixed_by_a_gate_or_a_baseline(
    judged: tuple[Done, Path], tmp_path: Path
) -> None:
    baseline = judged[1] / "report.json"
    gates = ("--baseline", baseline, "--fail-if", "reference.odometry.position_rmse_m > 5")
    words = ("compare", LOG, "-v", "--sensors", "odometry", "--no-advice", "--write", "json", "-q")
    done = locfuse(*words, *gates, "-o", tmp_path / "truth")
    assert done.exit_code == 4
    gate, other = [line for line in done.stderr.splitlines() if line.startswith("gate: ")]
    assert "no reference judged this log" in gate
    assert "its errors are against a reference of compass+lrf+camera, these against truth" in other
    assert Gates.read(GateOptions(baseline=baseline)).failures(report_in(judged[1])) == []


def test_it_can_be_left_out_and_is_refused_where_there_is_truth(tmp_path: Path) -> None:
    words = ("compare", LOG, "-v", "--sensors", "odometry", "--no-advice", "--write", "json")
    done = reported(*words, *NO_TRUTH, "--no-reference")
    found = done.report
    assert found["reference"] is None
    assert found["configurations"]["odometry"]["position_rmse_m"] is None
    assert "--no-reference" in found["repeat"]
    assert "or measure against the solution of the whole drive: --reference" in done.stderr
    refusal = refused(*words, "--reference", "-o", tmp_path / "truth", code=2)
    assert "this log has a truth, /ground_truth/pose" in refusal


def test_another_estimate_is_held_against_the_reference_too(judged: tuple[Done, Path]) -> None:
    error = present(report_in(judged[1])["configurations"]["tracker"]["position_rmse_m"])
    assert error < 0.01  # it is the truth


def test_results_by_truth_and_by_reference_side_by_side_say_so(judged: tuple[Done, Path]) -> None:
    by_reference = report_in(judged[1])
    by_truth = {**by_reference, "reference": None, "truth": {"topic": "/truth"}}
    found = changes(by_truth, by_reference)
    (line,) = [r for r in remarks(found) if r.startswith("errors cannot be compared")]
    assert "before against truth, after against a reference of compass+lrf+camera" in line


# --- --smooth as a user meets it: extra configurations and files, labelled; refused where it has no meaning


SMOOTH_LOG = "rounded_rectangle"


def test_compare_smooths_every_configuration_with_sensors() -> None:
    words = ("--sensors", "odometry", "--sensors", "lrf", "--smooth", "--no-advice", "--write", "json,tum")
    done = reported("compare", SMOOTH_LOG, *words)
    found = done.rows
    assert list(found) == ["odometry", "lrf", "lrf-smoothed"]
    assert [c["smoothed"] for c in found.values()] == [False, False, True]
    assert [c["configuration"] for c in found.values()] == ["odometry", "lrf", "lrf"]
    assert found["lrf-smoothed"]["position_rmse_m"] < found["lrf"]["position_rmse_m"]
    assert (done.out / "lrf-smoothed.tum").is_file()
    assert "reference" not in done.stderr


def test_run_writes_the_smoothed_drive_beside_the_filtered_one(tmp_path: Path) -> None:
    words = ("run", SMOOTH_LOG, "--no-advice", "--sensors", "lrf", "--write", "all")
    plain = locfuse(*words, "--no-smooth", "-o", tmp_path / "plain")
    done = locfuse(*words, "-o", tmp_path / "out")
    assert (plain.exit_code, done.exit_code) == (0, 0), done.stderr
    for kind in ("tum", "csv"):
        filtered = (tmp_path / "out" / f"trajectory.{kind}").read_bytes()
        assert filtered == (tmp_path / "plain" / f"trajectory.{kind}").read_bytes()
        assert filtered != (tmp_path / "out" / f"smoothed.{kind}").read_bytes()
    rows = np.loadtxt(tmp_path / "out" / "smoothed.csv", delimiter=",", skiprows=1)
    before = np.loadtxt(tmp_path / "out" / "trajectory.csv", delimiter=",", skiprows=1)
    np.testing.assert_array_equal(rows[:, 0], before[:, 0])
    assert (np.abs(rows[:, 3]) <= np.pi).all()
    assert rows[:, [4, 7, 9]].mean() < before[:, [4, 7, 9]].mean()


def test_what_has_a_laser_is_smoothed_unasked() -> None:
    of = ("compare", SMOOTH_LOG, "--to", 15, "--no-advice", *SENSORS, "--sensors", "lrf@2Hz")
    plain = ["odometry", "compass", "lrf", "lrf@2Hz"]
    assert list(reported(*of).rows) == [*plain, "lrf-smoothed"]
    for words in (("--no-smooth",), ("--jitter", 1), ("--set", "lrf.map=consider")):
        done = reported(*of, *words)
        assert list(done.rows) == plain
        assert words[0] != "--no-smooth" or "--no-smooth" in done.report["repeat"]


def test_a_fleet_and_a_sweep_are_not_smoothed_unasked(tmp_path: Path) -> None:
    words = ("--to", 10, "--sensors", "lrf", "--write", "json")
    ok("fleet", SMOOTH_LOG, *words, "--sweep", "lrf.sigma_range=0.02,0.03", "-o", tmp_path / "out")
    found = [json.loads(p.read_text())["configurations"] for p in sorted((tmp_path / "out").rglob("report.json"))]
    assert [list(configurations) for configurations in found] == [["lrf"], ["lrf"]]
