"""Gates for CI: what fails, what does not exist, what is a typing mistake."""

import json
import os
import re
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from commands import locfuse, ok, refused, report_in, reported

from locfuse.cli.analysis.gates import (
    Gates,
    figure,
    parse_gate,
    parse_tolerance,
    read_baseline,
    refuse_another_log,
)
from locfuse.cli.analysis.verdicts import add_pairs
from locfuse.formats.logs.files import Identity
from locfuse.fusion.data import LocfuseError, UsageError

# the cheapest comparison that has a figure for a gate
ODOMETRY = ("compare", "rounded_rectangle", "--no-advice", "--sensors", "odometry", "--write", "json")
REPORT: dict[str, Any] = {
    "locfuse": "0.2.0",
    "schema_version": 1,
    "truth": {"topic": "/gt"},
    "configurations": {
        "odometry": {"position_rmse_m": 0.5, "position_max_m": 0.9, "heading_rmse_deg": None, "sensors": {}},
        "all": {
            "position_rmse_m": 0.02,
            "position_max_m": 0.05,
            "anees": 1.1,
            "align": "none",
            "sensors": {"lrf": {"accepted": 10, "nis": 1.5}},
        },
        "lrf@2.5Hz": {"position_rmse_m": 0.03, "sensors": {}},
    },
}

WITH_VERSION = '{"locfuse": "0.2.0", "schema_version": 1, %s}'


def lines(*gates: str) -> list[str]:
    return Gates([parse_gate(g) for g in gates]).failures(REPORT)


def test_a_gate_that_holds_fails_with_a_line_of_its_own_that_names_it_and_the_number() -> None:
    gates = ("all.position_rmse_m > 0.01", "all.position_rmse_m>=0.02", "all.anees < 2", "all.anees <= 1.1")
    found = lines(*gates)
    assert [line.startswith(gate) for line, gate in zip(found, gates, strict=True)] == [True] * 4
    assert all("it is" in line for line in found)
    quiet = ("all.position_rmse_m > 0.02", "all.position_rmse_m >= 0.0200001", "all.anees < 1.1", "all.anees <= 1")
    assert lines(*quiet) == []


def test_gates_reach_into_sensors_and_names_with_dots() -> None:
    assert figure(REPORT["configurations"], "all.sensors.lrf.nis") == ("all", 1.5)
    assert figure(REPORT["configurations"], "lrf@2.5Hz.position_rmse_m") == ("lrf@2.5Hz", 0.03)


@pytest.mark.parametrize(
    ("gate", "why"),
    [
        ("camera.position_rmse_m > 1", "no such configuration"),
        ("all.positon_rmse_m > 1", "no such figure"),
        ("odometry.heading_rmse_deg > 1", "does not exist"),
        ("all.align > 1", "does not exist"),
        ("all.sensors.camera.nis > 1", "no such figure"),
    ],
)
def test_a_figure_that_does_not_exist_fails(gate: str, why: str) -> None:
    (line,) = lines(gate)
    assert why in line


@pytest.mark.parametrize(
    "text",
    ["all.position_rmse_m", "all.position_rmse_m = 1", "all.position_rmse_m > x", "> 1", "all > 1", "all.x > nan"],
)
def test_a_gate_that_is_none_is_a_usage_error(text: str) -> None:
    with pytest.raises(UsageError, match="write it like"):
        parse_gate(text)


@pytest.mark.parametrize(
    ("text", "share", "metres", "degrees"),
    [
        ("5%", 0.05, 0, 0),
        ("0.05", 0.05, 0, 0),
        ("0", 0, 0, 0),
        (" 12.5 % ", 0.125, 0, 0),
        ("500%", 5, 0, 0),
        ("5%,1mm", 0.05, 0.001, 0.0),
        ("2cm, 1 %", 0.01, 0.02, 0.0),
        ("0.1deg,0.5m", 0.0, 0.5, 0.1),
        ("1°", 0, 0, 1),
    ],
)
def test_a_tolerance_is_a_share_maybe_with_a_floor(text: str, share: float, metres: float, degrees: float) -> None:
    found = parse_tolerance(text)
    assert (found.share, found.metres, found.degrees) == pytest.approx((share, metres, degrees))


def test_five_without_a_per_cent_sign_is_refused_as_it_would_be_500_per_cent() -> None:
    with pytest.raises(UsageError, match="write it like 5%, or"):
        parse_tolerance("5")


@pytest.mark.parametrize(
    "text", ["-1%", "much", "", "inf", "1", "5%,", "5%,1%", "1mm,1cm", "m", "1km", "nan%", "5%,-1mm", "5% 1mm"]
)
def test_a_tolerance_that_is_none_is_a_usage_error(text: str) -> None:
    with pytest.raises(UsageError, match="tolerance"):
        parse_tolerance(text)


def written(folder: Path, **changes: Any) -> Path:
    """The report with other values, as a file."""
    path = folder / "old.json"
    path.write_text(json.dumps(REPORT | changes))
    return path


def baseline(tmp_path: Path, tolerance: str, **changes: float | None) -> list[str]:
    rows = REPORT["configurations"]
    path = written(tmp_path, configurations={**rows, "all": rows["all"] | changes})
    return Gates([], read_baseline(path, tolerance)).failures(REPORT)


def test_only_what_grew_by_more_than_the_tolerance_and_stands_in_both_reports_fails(tmp_path: Path) -> None:
    assert baseline(tmp_path, "5%") == []
    assert baseline(tmp_path, "5%", position_rmse_m=0.0191) == []
    (line,) = baseline(tmp_path, "5%", position_rmse_m=0.0189)
    assert line.startswith("all.position_rmse_m: 0.02 is 5.8% more")
    assert baseline(tmp_path, "0%", position_rmse_m=1.0, anees=0.1) == []
    assert baseline(tmp_path, "0%", heading_rmse_deg=0.001) == []
    assert baseline(tmp_path, "0%", position_rmse_m=None) == []


def test_a_floor_lets_small_lengths_and_angles_grow_by_more_than_their_share(tmp_path: Path) -> None:
    assert len(baseline(tmp_path, "5%", position_rmse_m=0.0185)) == 1
    assert baseline(tmp_path, "5%,2mm", position_rmse_m=0.0185) == []
    (line,) = baseline(tmp_path, "5%,1mm", position_rmse_m=0.0185)
    assert line.endswith("(tolerance 5%,1mm)")
    assert len(baseline(tmp_path, "5%,2deg", position_rmse_m=0.0185)) == 1
    limit = parse_tolerance("5%,1mm,0.1deg").limit
    assert limit("heading_rmse_deg", 1.0) == pytest.approx(1.1)
    assert limit("position_rmse_m", 1.0) == pytest.approx(1.05)
    assert limit("drift_5m", 0.01) == pytest.approx(0.0105)  # a share of the way, no length


def test_a_baseline_with_nothing_in_common_fails(tmp_path: Path) -> None:
    path = written(tmp_path, configurations={"else": {"position_rmse_m": 1.0}})
    (line,) = Gates([], read_baseline(path, "5%")).failures(REPORT)
    assert "no error figure in common" in line


@pytest.mark.parametrize(
    "text",
    [
        "",
        "[]",
        "{}",
        "\xff",
        "[" * 200_000,
        WITH_VERSION % '"configurations": 3',
        WITH_VERSION % '"configurations": {"all": 1}',
        WITH_VERSION % '"configurations": {"all": {}}, "input": []',
        WITH_VERSION % '"configurations": {"all": {"reference": "x"}}',
        WITH_VERSION % '"configurations": {"all": {"reference": {"sensors": [{}]}, "position_rmse_m": 1}}',
        WITH_VERSION % f'"configurations": {{"all": {{"position_rmse_m": 1{"0" * 400}}}}}',
    ],
)
def test_a_baseline_that_is_no_report_is_one_line(tmp_path: Path, text: str) -> None:
    path = tmp_path / "old.json"
    path.write_text(text, encoding="latin-1")
    with pytest.raises(LocfuseError, match=r"not a report\.json of locfuse"):
        read_baseline(path, "5%")


def test_the_command_exits_with_4_and_one_line_per_gate_and_writes_its_results(tmp_path: Path) -> None:
    out = tmp_path / "out"
    words = (*ODOMETRY, "-o", out, "-q")
    ok(*words, "--fail-if", "odometry.position_rmse_m > 100")
    done = locfuse(*words, "--fail-if", "odometry.position_rmse_m > 0", "--fail-if", "all.anees > 1")
    assert done.exit_code == 4
    assert len(done.stderr.splitlines()) == 2
    assert (out / "report.json").exists()


@pytest.mark.parametrize(("how", "both"), [((), True), (("--json",), False)])
def test_gates_hold_although_the_reader_has_left(tmp_path: Path, how: tuple[str, ...], both: bool) -> None:
    """As with `| head -1`, or `2>&1 | head -1`, whose pipe closes early; here it is closed from the start."""
    read, write = os.pipe()
    os.close(read)
    gate = ("--fail-if", "odometry.position_rmse_m > 0", *(() if both else ("-q",)))
    command = [sys.executable, "-m", "locfuse", *ODOMETRY, "-o", str(tmp_path), *gate, *how]
    stderr = write if both else subprocess.PIPE
    done = subprocess.run(command, stdout=write, stderr=stderr, text=True, check=False, timeout=300)
    os.close(write)
    assert done.returncode == 4
    assert (tmp_path / "report.json").exists()
    assert both or re.fullmatch("gate: .*\n", done.stderr)


def test_the_command_compares_with_a_baseline_and_refuses_that_of_another_log_before_anything_is_fused(
    tmp_path: Path,
) -> None:
    words = ("--sensors", "odometry", "--write", "json", "-o")
    ok("compare", "rounded_rectangle", "--no-advice", *words, tmp_path / "a")
    baseline = ("--baseline", tmp_path / "a" / "report.json", "--tolerance", "900%")
    same = locfuse("compare", "rounded_rectangle", "--no-advice", *words, tmp_path / "b", *baseline)
    assert (same.exit_code, "baseline" in same.stderr) == (0, False)
    report = report_in(tmp_path / "a")
    report["configurations"]["odometry"]["position_rmse_m"] *= 0.9
    (tmp_path / "better.json").write_text(json.dumps(report))
    worse = ("--baseline", tmp_path / "better.json")
    grown = locfuse("compare", "rounded_rectangle", "--no-advice", *words, tmp_path / "d", *worse)
    assert (grown.exit_code, "odometry.position_rmse_m" in grown.stderr) == (4, True)
    refusal = refused("compare", "rounded_triangle", "--no-advice", *words, tmp_path / "c", *baseline)
    assert "is of rounded_rectangle, and this is rounded_triangle" in refusal
    assert "locfuse compare rounded_triangle -o DIR" in refusal
    assert not (tmp_path / "c").exists()


def known(name: str, identity: Identity) -> Any:
    """What gates ask of a log."""
    return SimpleNamespace(name=name, identity=identity)


def test_a_baseline_of_other_bytes_under_the_same_name_is_refused(tmp_path: Path) -> None:
    before = read_baseline(written(tmp_path, input={"name": "drive", "identity": "a"}), "5%")
    refuse_another_log(before, known("drive", Identity(5, "a")))
    with pytest.raises(LocfuseError, match="another log that is also called drive"):
        refuse_another_log(before, known("drive", Identity(5, "b")))


def test_a_what_if_keeps_its_name() -> None:
    words = ("--sensors", "compass,lrf@2Hz", "--sensors", "compass@1Hz", "--write", "json,tum")
    done = reported("compare", "rounded_rectangle", "--no-advice", *words)
    assert list(done.rows) == ["compass+lrf@2Hz", "compass@1Hz"]
    counts = done.rows["compass@1Hz"]["sensors"]["compass"]
    assert sum(counts["verdicts"].values()) == pytest.approx(55, abs=1)
    assert (done.out / "compass+lrf@2Hz.tum").exists()


@pytest.mark.parametrize("version", [0, 2])
def test_a_baseline_of_another_version_is_refused_in_one_line_with_the_fix(tmp_path: Path, version: int) -> None:
    with pytest.raises(LocfuseError, match=rf"schema_version {version}.*9\.9.*[Uu]pdate locfuse"):
        read_baseline(written(tmp_path, schema_version=version, locfuse="9.9"), "5%")


# --- what pairs of configurations add to a verdict: a lower rate, and sensors beside which one harms


SETS: dict[str, tuple[str, ...]] = {
    "odometry": (),
    "compass": ("compass",),
    "camera": ("camera",),
    "lrf": ("lrf",),
    "compass+camera": ("compass", "camera"),
    "all": ("compass", "camera", "lrf"),
}
ERRORS = {"odometry": 0.5, "compass": 0.3, "camera": 0.064, "lrf": 0.004, "compass+camera": 0.12, "lrf@2Hz": 0.008}


def test_a_lower_rate_and_a_pair_in_which_one_harms_are_said_in_figures() -> None:
    found = {s: {"verdict": "helps", "words": "Why."} for s in ("compass", "camera", "lrf")}
    add_pairs(found, SETS, {"lrf@2Hz": ("lrf",)}, ERRORS, by_truth=True)
    words = {s: v["words"].removeprefix("Why.").strip() for s, v in found.items()}
    beside, slower = "Beside camera: 64 -> 120 mm (1.9x worse).", "lrf@2Hz: 4 -> 8 mm (2.0x worse)."
    assert words == {"camera": "", "compass": beside, "lrf": slower}
    none = {"lrf": {"verdict": "no verdict", "words": ""}}
    add_pairs(none, SETS, {"lrf@2Hz": ("lrf",)}, dict.fromkeys(ERRORS), by_truth=True)
    assert none == {"lrf": {"verdict": "no verdict", "words": ""}}
