"""Several logs in Python and on the command line: the same files, one log at a time."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
from commands import locfuse as command

import locfuse

LIGHT = {
    "camera.enabled": False,
    "lrf.enabled": False,
    "path.legs": [{"forward": 1.5}, {"turn_deg": 180}, {"forward": 1.5}],
}


@pytest.fixture(scope="module")
def drives(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    folder = tmp_path_factory.mktemp("drives")
    for seed, name in enumerate(("monday", "tuesday")):
        locfuse.simulate("straight_runs", folder / f"{name}.mcap", seed=seed, sets=LIGHT)
    return [folder / "monday.mcap", folder / "tuesday.mcap"]


def tree(folder: Path) -> dict[str, bytes]:
    return {str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


@pytest.mark.parametrize("write", [None, "json", "md,tum"])
def test_a_summary_writes_the_commands_files_byte_for_byte(
    drives: list[Path], tmp_path: Path, write: str | None
) -> None:
    words = ("--write", write) if write else ()
    done = command("compare", *drives, "-o", tmp_path / "a", *words)
    assert done.exit_code == 0, done.stderr
    written = locfuse.compare(*drives).write(tmp_path / "b", write=write)
    assert tree(tmp_path / "a") == tree(tmp_path / "b")
    assert {p.name for p in written} == {p.name for p in (tmp_path / "a").iterdir() if p.is_file()}


def test_a_summary_holds_every_logs_comparison_and_table(drives: list[Path]) -> None:
    summary = locfuse.compare(*drives, sensors=["odometry", "compass"])
    assert list(summary.results) == ["monday", "tuesday"]
    rows = summary.table()
    assert [(r["log"], r["configuration"]) for r in rows] == [
        (log, name) for log in ("monday", "tuesday") for name in ("odometry", "compass")
    ]
    alone = locfuse.compare(drives[1], sensors=["odometry", "compass"], smooth=False)
    one = summary.results["tuesday"].report
    assert {**one, "findings": alone.report["findings"], "fixes": alone.report["fixes"]} == alone.report
    assert one["findings"] is None  # several logs are compared, a single one is evaluated
    mean = sum(r["position_rmse_m"] for r in rows if r["configuration"] == "compass") / 2
    assert summary.report["configurations"]["compass"]["figures"]["position_rmse_m"]["mean"] == pytest.approx(mean)
    assert f"{mean:.4f}" in summary._repr_html_()
    assert repr(summary).startswith("<Summary of monday, tuesday: Best is ")


def test_a_list_is_one_log_and_the_same_log_twice_is_one(drives: list[Path], tmp_path: Path) -> None:
    assert list(locfuse.compare(drives[0], drives[0], sensors="odometry").results) == ["monday"]
    twin = tmp_path / "monday.mcap"
    shutil.copy(drives[0], twin)
    both = locfuse.compare([drives[0]], [twin], sensors="odometry")
    assert list(both.results) == ["monday", "monday_2"]
