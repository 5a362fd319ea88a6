"""A word that is nearly right is answered with the right one, before any work is done."""

from __future__ import annotations

from pathlib import Path

import pytest
from commands import locfuse

from locfuse.formats.report.table import written

LOG = "rounded_rectangle"


@pytest.mark.parametrize(
    ("words", "code", "meant"),
    [
        (("view", "nosuch.rrd"), 2, "no such recording; make one with: locfuse view LOG --save nosuch.rrd"),
        (("compare", LOG, "--set", "lrf.sigma=1"), 2, "sigma_range"),
        (("compare", LOG, "--set", "sigma_range=1"), 2, "did you mean lrf.sigma_range"),
        (("compare", LOG, "--sensors", "laser"), 2, "did you mean lrf?"),
        (("compare", LOG, "--sensors", "imu"), 2, "did you mean gyro or compass?"),
        (("compare", LOG, "--fail-if", "all.rmse > 1"), 2, "did you mean position_rmse_m"),
        (("fleet", LOG, "disturbed", "--fail-if", "all.rmse > 1"), 2, "did you mean position_rmse_m"),
        (("compare", LOG, "--fail-if", "all.nothing_alike > 1"), 2, "locfuse schema report"),
        (("explain", "anes"), 2, "ANEES"),
        (("comapre", LOG), 2, "did you mean compare"),
        (("compare", "rounded_rectangl"), 2, "did you mean rounded_rectangle?"),
        (("compare", LOG, "--sensors", "compass,lfr"), 2, "did you mean lrf?"),
        (("tune", LOG, "--sensors", "cmpass"), 2, "did you mean compass?"),
        (("compare", LOG, "--set", "lrf.sigma_rnge=1"), 2, "did you mean sigma_range?"),
        (("compare", LOG, "--set", "lrf.topic=/scn"), 1, "did you mean /scan?"),
    ],
)
def test_what_was_meant_is_named(words: tuple[str, ...], code: int, meant: str, tmp_path: Path) -> None:
    done = locfuse(*words, *(("-o", tmp_path / "out") if words[0] == "compare" else ()))
    assert done.exit_code == code
    assert meant in done.stderr
    assert len(done.stderr.splitlines()) == 1
    assert not (tmp_path / "out").exists()


def test_a_truth_beside_the_log_is_a_table_of_poses(tmp_path: Path) -> None:
    page = tmp_path / "README.md"
    page.write_text("# no poses")
    done = locfuse("compare", LOG, "--truth", page, "-o", tmp_path / "out")
    assert done.exit_code == 2
    assert f"--truth {page}: a .tum, or a .csv" in done.stderr


def test_a_sensor_is_explained() -> None:
    done = locfuse("explain", "LRF")
    assert (done.exit_code, done.stderr) == (0, "")
    assert "LaserScan" in done.stdout


@pytest.mark.parametrize(
    ("value", "form", "text"),
    [
        (-0.0, "{:.2f}", "0.00"),
        (-0.004, "{:.2f}", "0.00"),
        (-0.006, "{:.2f}", "-0.01"),
        (-0.001, "{:.0%}", "0%"),
        (-0.5, "{:.0%}", "-50%"),
    ],
)
def test_nothing_is_minus_nothing(value: float, form: str, text: str) -> None:
    assert written(value, form) == text
