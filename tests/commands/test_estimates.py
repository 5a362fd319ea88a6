"""`compare --estimate`: other people's estimates are judged as ours are, and as evo judges them."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from commands import locfuse, ok, report_in, reported
from evo.core import metrics, sync
from evo.tools import file_interface

SAMPLE = "rounded_rectangle"
ERRORS = ("position_rmse_m", "position_max_m", "heading_rmse_deg", "drift_1m", "drift_5m", "along_rmse_m")


@pytest.fixture(scope="module")
def ours(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One run of ours, with its trajectory as .tum and .csv."""
    out = tmp_path_factory.mktemp("ours")
    words = ("--sensors", "compass", "--no-advice", "--write", "all", "-o", out, "--overwrite")
    ok("run", SAMPLE, *words)
    ok("compare", SAMPLE, "--sensors", "compass", "-o", out / "c", "--write", "tum", "--no-advice")
    return out


def compared(out: Path, *words: Any) -> tuple[dict[str, Any], str]:
    how = ("--sensors", "compass", "-o", out, "--write", "json,tum,html", "--no-advice", "-v")
    done = reported("compare", SAMPLE, *how, *words)
    return done.rows, done.stderr


def test_our_own_trajectory_gives_our_own_figures_and_with_covariances_our_consistency(
    ours: Path, tmp_path: Path
) -> None:
    files = (word for kind in ("tum", "csv") for word in ("--estimate", f"{kind}={ours / 'trajectory'}.{kind}"))
    found, stderr = compared(tmp_path / "o", *files)
    for key in ERRORS:
        assert found["tum"][key] == pytest.approx(found["compass"][key], abs=1e-9), key
    assert found["tum"]["anees"] is None  # it says no covariance
    assert found["csv"]["anees"] == pytest.approx(found["compass"]["anees"], rel=1e-6)
    assert found["csv"]["position_rmse_m"] == pytest.approx(found["compass"]["position_rmse_m"], abs=1e-9)
    headline = report_in(tmp_path / "o")["headline"]
    assert headline.startswith("With the compass: position error")  # an estimate is no sensor to keep
    assert "another frame" not in stderr


def test_a_strangers_trajectory_is_judged_as_evo_judges_it(ours: Path, tmp_path: Path) -> None:
    """Ours, spoilt by a wave: the same rows, other places."""
    rows = [line.split() for line in (ours / "trajectory.tum").read_text().splitlines()]
    spoilt = tmp_path / "spoilt.tum"
    moved = [
        f"{r[0]} {float(r[1]) + 0.2 * math.sin(i / 40)!r} {float(r[2]) - 0.1!r} {' '.join(r[3:])}"
        for i, r in enumerate(rows)
    ]
    spoilt.write_text("\n".join(moved) + "\n")
    found, _ = compared(tmp_path / "o", "--estimate", f"wave={spoilt}")
    reference = file_interface.read_tum_trajectory_file(str(ours / "c" / "truth.tum"))
    estimate = file_interface.read_tum_trajectory_file(str(spoilt))
    ape = metrics.APE(metrics.PoseRelation.translation_part)
    ape.process_data(sync.associate_trajectories(reference, estimate, max_diff=1e-7))
    assert found["wave"]["position_rmse_m"] == pytest.approx(
        ape.get_statistic(metrics.StatisticsType.rmse), abs=1e-9
    )
    assert found["wave"]["position_max_m"] == pytest.approx(
        ape.get_statistic(metrics.StatisticsType.max), abs=1e-9
    )


def turned(ours: Path, tmp_path: Path) -> Path:
    """Our own trajectory in a frame that is turned by 0.7 rad and lies elsewhere."""
    rows = np.array(
        [list(map(float, line.split())) for line in (ours / "trajectory.tum").read_text().splitlines()]
    )
    times = [line.split()[0] for line in (ours / "trajectory.tum").read_text().splitlines()]
    c, s = math.cos(0.7), math.sin(0.7)
    x, y = c * rows[:, 1] - s * rows[:, 2] + 5.0, s * rows[:, 1] + c * rows[:, 2] - 3.0
    half = np.arctan2(rows[:, 6], rows[:, 7]) + 0.35
    lines = (
        f"{t} {a!r} {b!r} 0 0 0 {math.sin(h)!r} {math.cos(h)!r}"
        for t, a, b, h in zip(times, x.tolist(), y.tolist(), half.tolist(), strict=True)
    )
    path = tmp_path / "turned.tum"
    path.write_text("\n".join(lines) + "\n")
    return path


def test_an_estimate_of_another_frame_is_aligned_at_its_first_pose_and_says_so(ours: Path, tmp_path: Path) -> None:
    found, stderr = compared(tmp_path / "o", "--estimate", f"turned={turned(ours, tmp_path)}")
    assert "of another frame: aligned at its first pose" in stderr
    by_us, _ = compared(tmp_path / "a", "--align", "origin")
    assert found["turned"]["position_rmse_m"] == pytest.approx(by_us["compass"]["position_rmse_m"], abs=1e-6)


def test_without_truth_it_is_aligned_with_the_reference_likewise(ours: Path, tmp_path: Path) -> None:
    hidden = ("--set", "truth.topic=none", "--reference", "--to", 20)
    found, stderr = compared(tmp_path / "o", "--estimate", f"turned={turned(ours, tmp_path)}", *hidden)
    assert "m from the reference, so it is of another frame: aligned at its first pose" in " ".join(stderr.split())
    by_us, _ = compared(tmp_path / "a", "--align", "origin", *hidden)
    assert found["turned"]["position_rmse_m"] == pytest.approx(by_us["compass"]["position_rmse_m"], abs=0.01)
    assert found["turned"]["position_rmse_m"] < 1.0  # m; the frame lies 5.8 m away


def test_gaps_of_an_estimate_are_not_judged(ours: Path, tmp_path: Path) -> None:
    rows = (ours / "trajectory.tum").read_text().splitlines()
    path = tmp_path / "half.tum"
    path.write_text("\n".join([*rows[: len(rows) // 4], *rows[len(rows) // 2 :]]) + "\n")
    found, _ = compared(tmp_path / "o", "--estimate", f"half={path}")
    assert 0.6 < found["half"]["truth_coverage"] < 0.9


@pytest.mark.parametrize(
    ("word", "code", "says"),
    [
        ("compass=x.tum", 2, "that is the name of a configuration"),
        ("all-smoothed=x.tum", 2, "that is the name of a configuration"),
        ("mine", 2, "it reads NAME=/topic or NAME=file.tum"),
        ("mine=/nowhere", 1, "has no topic /nowhere"),
        ("mine=/scan", 1, "/scan is sensor_msgs/msg/LaserScan"),
        ("mine=other.tum", 1, "another clock?"),
        ("mine=bad.tum", 1, "bad.tum: line 1 has 3 numbers"),
    ],
)
def test_bad_estimates_are_refused_in_one_line(
    word: str, code: int, says: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "other.tum").write_text("1 0 0 0 0 0 0 1\n2 0 0 0 0 0 0 1\n")
    (tmp_path / "bad.tum").write_text("1 0 0\n")
    done = locfuse("compare", SAMPLE, "--sensors", "odometry", "-o", "out", "--estimate", word)
    assert done.exit_code == code
    assert says in done.stderr
    assert "Traceback" not in done.stderr
