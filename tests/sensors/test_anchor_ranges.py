"""Ranges to anchors with ids: a map that is given or made, a start that nobody gave, and what is refused."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bags import T0
from commands import locfuse
from landmark_drive import path_of
from numpy.typing import NDArray
from wheel_bags import GEOMETRY, angles, custom, joint_states, log_of

import locfuse as package
from locfuse.fusion.sensors.ranges import anchor_beside, start_among

Array = NDArray[np.float64]
ANCHORS = {1: (3.5, 3.0), 2: (-2.0, 3.2), 3: (-1.5, -2.5), 4: (3.0, -2.0)}
SIGMA, OFFSET = 0.05, 0.09
START = (0.7, -0.4, math.radians(130.0))


def moved(poses: Array, start: tuple[float, float, float]) -> Array:
    """The path (n, 3) of a robot that begins at `start` [m, rad] instead of at 0."""
    x, y, theta = start
    c, s = math.cos(theta), math.sin(theta)
    return poses @ [[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]] + [x, y, theta]


def written(
    folder: Path, seed: int = 1, anchors: Any = ANCHORS, far: float = 0.0, turns: bool = True
) -> list[str]:
    """Write a log, its truth, ranges to one anchor every 0.1 s and a map; return the words that name them.

    `far`: share of ranges that come 1.5 m too long, by way of a wall.
    """
    t, angle = angles(60.0)
    if not turns:
        angle = np.repeat(angle[:, :1], 2, axis=1)
    true = moved(path_of(t, angle), START)
    rng = np.random.default_rng(seed)
    lines = ["t,id,range"]
    for n, i in enumerate(range(5, len(t), 5)):
        key = sorted(anchors)[n % len(anchors)]
        r = float(np.hypot(*(true[i, :2] - anchors[key]))) + OFFSET + SIGMA * rng.standard_normal()
        lines.append(f"{T0 // 10**9 + t[i]:.9f},{key},{r + 1.5 * (rng.random() < far)!r}")
    (folder / "ranges.csv").write_text("\n".join(lines) + "\n")
    (folder / "anchors.csv").write_text("id,x,y\n" + "".join(f"{k},{x},{y}\n" for k, (x, y) in anchors.items()))
    rows = "".join(
        f"{T0 // 10**9 + s:.9f},{x!r},{y!r},{th!r}\n" for s, (x, y, th) in zip(t, true.tolist(), strict=True)
    )
    (folder / "truth.csv").write_text(f"t,x,y,theta\n{rows}")
    log = log_of(folder / "x.mcap", joint_states(t, angle))
    sets = (
        f"ranges.file={folder / 'ranges.csv'}",
        f"ranges.map={folder / 'anchors.csv'}",
        f"ranges.sigma={SIGMA}",
    )
    return [str(log), *GEOMETRY, *(w for s in sets for w in ("--set", s)), "--truth", str(folder / "truth.csv")]


def compared(folder: Path, *words: str, code: int = 0) -> tuple[dict[str, Any], str]:
    done = locfuse("compare", *words, "--no-advice", "-v", "-o", folder / "out", "--overwrite")
    assert done.exit_code == code, done.stderr
    report: dict[str, Any] = json.loads((folder / "out" / "report.json").read_text())
    return report, done.stderr


def test_ranges_tell_where_a_drive_begins_and_hold_it_there(tmp_path: Path) -> None:
    report, stderr = compared(tmp_path, *written(tmp_path))
    ranges = report["configurations"]["ranges"]
    assert "the drive begins at x 0.7" in stderr
    assert "found by its map" in stderr
    assert ranges["position_rmse_m"] < 0.03
    assert ranges["heading_rmse_deg"] < 5.0  # nobody told the first
    assert 0.85 < ranges["sensors"]["ranges"]["nis"] < 1.15


def test_over_many_drives_the_error_is_as_large_as_the_covariance_says(tmp_path: Path) -> None:
    anees = []
    for seed in range(6):
        words = written(tmp_path, seed)
        report, _ = compared(tmp_path, *words, "--set", "wheels.noise=1e-6", "--sensors", "ranges")
        anees.append(report["configurations"]["ranges"]["anees"])
    assert 0.5 < np.mean(anees) < 1.6


def test_ranges_by_way_of_a_wall_are_refused(tmp_path: Path) -> None:
    report, _ = compared(tmp_path, *written(tmp_path, far=0.15))
    ranges = report["configurations"]["ranges"]
    assert ranges["position_rmse_m"] < 0.05
    assert 0.1 < ranges["sensors"]["ranges"]["rejected"] / 600 < 0.2


def test_a_given_start_is_kept(tmp_path: Path) -> None:
    x, y, theta = START
    start = f"start.x={x}", f"start.y={y}", f"start.theta_deg={math.degrees(theta)}"
    _, stderr = compared(tmp_path, *written(tmp_path), *(w for s in start for w in ("--set", s)))
    assert "found by its map" not in stderr


@pytest.mark.parametrize(
    ("anchors", "turns"), [({1: (3.5, 3.0), 2: (3.5, 0.5)}, False), ({1: (3.5, 3.0)}, True)], ids=["mirror", "one"]
)
def test_a_start_that_the_ranges_do_not_tell_is_not_invented(tmp_path: Path, anchors: Any, turns: bool) -> None:
    report, stderr = compared(tmp_path, *written(tmp_path, anchors=anchors, turns=turns), code=3)
    assert "ranges" not in report["configurations"]
    assert "the ranges do not tell where the drive begins" in stderr
    assert "Set [start] x, y, theta_deg" in stderr


def test_without_a_map_the_anchors_are_found_beside_the_drive(tmp_path: Path) -> None:
    words = [*written(tmp_path), "--set", "ranges.map=grow"]
    save = tmp_path / "found.csv"
    done = locfuse(
        "run", *words[:-4], *words[-2:], "--sensors", "ranges", "--save-map", save, "-o", tmp_path / "run"
    )
    assert done.exit_code == 0, done.stderr
    found = {int(k): (float(x), float(y)) for k, x, y in (row.split(",") for row in save.read_text().split()[1:])}
    true = {key: moved(np.array([[*place, 0.0]]), (0.0, 0.0, 0.0))[0] for key, place in ANCHORS.items()}
    for key, place in true.items():  # in the frame of the start
        c, s, d = math.cos(START[2]), math.sin(START[2]), place[:2] - START[:2]
        assert np.hypot(*(np.array(found[key]) - [c * d[0] + s * d[1], c * d[1] - s * d[0]])) < 0.25


def test_where_an_anchor_stands_a_straight_drive_does_not_tell(tmp_path: Path) -> None:
    _, stderr = compared(tmp_path, *written(tmp_path, turns=False), "--set", "ranges.map=grow", code=3)
    assert "this drive does not tell where its anchors stand" in stderr
    assert "--set ranges.map=anchors.csv" in stderr


LIST = "std_msgs/Header header\nuint16[] id\nfloat32[] dis"
ONE = "std_msgs/Header header\nuint16 id\nfloat32 dis"


@pytest.mark.parametrize(("text", "many"), [(ONE, False), (LIST, True)])
def test_any_message_with_an_id_and_a_range_can_be_read(tmp_path: Path, text: str, many: bool) -> None:
    t = np.arange(5.0)
    one: list[dict[str, Any]] = [{"id": i, "dis": i + 0.5} for i in range(5)]
    lists: list[dict[str, Any]] = [{"id": [i, 7], "dis": [i + 0.5, 2.0]} for i in range(5)]
    log = package.open_log(custom(tmp_path / "c.mcap", "/uwb", "my_msgs/msg/Uwb", text, t, lists if many else one))
    assert log.find("/uwb:id,dis") is not None
    stream = log.stream("/uwb:id,dis")
    columns = stream.columns("id", "range")
    assert stream.msgtype == "locfuse/msg/Ranges"
    assert len(stream.t_ns) == (10 if many else 5)
    assert np.asarray(columns["id"]).tolist() == ([0, 7, 1, 7, 2, 7, 3, 7, 4, 7] if many else [0, 1, 2, 3, 4])
    assert np.asarray(columns["range"])[0] == 0.5


@pytest.mark.parametrize(
    ("fields", "words"),
    [("id,nothing", "nothing"), ("id,header.frame_id", "header.frame_id is a text, not a number"),
     ("id,dis,id", "one field, or those of id and range")],
)  # fmt: skip
def test_fields_that_are_no_ids_and_ranges_are_refused_in_one_line(
    tmp_path: Path, fields: str, words: str
) -> None:
    rows: list[dict[str, Any]] = [{"id": 1, "dis": 1.0}]
    log = package.open_log(custom(tmp_path / "c.mcap", "/uwb", "my_msgs/msg/Uwb", ONE, np.zeros(1), rows))
    with pytest.raises(package.LocfuseError) as error:
        log.find(f"/uwb:{fields}")
    assert words in str(error.value)
    assert "\n" not in str(error.value)


def test_the_labyrinth_is_driven_from_an_unknown_start() -> None:
    """Real ranges of ultra-wideband radio, 7 to 15 cm too long; truth to about 1 cm."""
    table = {row["configuration"]: row for row in package.load("labyrinth").compare().table()}
    assert table["ranges"]["position_rmse_m"] < 0.10
    assert 0.7 < table["ranges"]["anees"] < 1.5


def test_the_start_is_exact_where_the_ranges_are() -> None:
    t, angle = angles(20.0)
    rel = path_of(t, angle)[::10]
    true, ids = moved(rel, START), np.arange(len(rel)) % 4 + 1
    at = np.array([ANCHORS[int(i)] for i in ids])
    ranges = np.hypot(*(true[:, :2] - at).T) + OFFSET
    found = start_among(at, rel[:, :2], t[::10], ranges, (0.05, 0.2))
    assert found is not None
    assert found.values == pytest.approx([*START, OFFSET], abs=2e-3)


def test_an_anchor_is_exact_where_the_ranges_are() -> None:
    t, angle = angles(20.0)
    rel = path_of(t, angle)[::10]
    ranges = np.hypot(*(rel[:, :2] - ANCHORS[1]).T)
    found = anchor_beside(rel[:, :2], t[::10], ranges, (0.05, 0.2))
    assert found is not None
    assert found.values == pytest.approx([*ANCHORS[1], 0.0], abs=1e-3)
