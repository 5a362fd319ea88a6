"""AMCL's parameters: a likelihood field made by hand prefers the exported sigma_hit; steps are as noisy."""

from __future__ import annotations

from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest
from commands import locfuse
from numpy.typing import NDArray
from ros_drive import parameters
from scipy.ndimage import distance_transform_edt

from locfuse import load

Floats = NDArray[np.float64]
CELL_M = 0.05
WALLS = [  # of the sample log's room, m
    *((0, 0, 8, 0), (8, 0, 8, 6), (8, 6, 0, 6), (0, 6, 0, 0)),
    *((3, 0, 3, 1), (5, 6, 5, 5.4), (8, 3, 7, 3), (0, 5.2, 0.8, 5.2)),
]


@pytest.fixture(scope="module")
def amcl() -> dict[str, Any]:
    done = locfuse("export", "ros", "rounded_rectangle", "--to", "amcl", "--as-set", "-q")
    assert done.exit_code == 0, done.stderr
    return parameters(done.stdout, "amcl")


def field() -> Floats:
    """Distance [m] of every cell from the nearest cell with a wall, as AMCL makes it from a map of 5 cm cells."""
    cells = np.zeros((140, 180), bool)  # from (-0.5, -0.5) m
    for x1, y1, x2, y2 in WALLS:
        t = np.linspace(0.0, 1.0, 2000)
        column = ((x1 + t * (x2 - x1) + 0.5) / CELL_M).astype(int)
        row = ((y1 + t * (y2 - y1) + 0.5) / CELL_M).astype(int)
        cells[row, column] = True
    return np.asarray(CELL_M * distance_transform_edt(~cells))


def ends() -> Floats:
    """Where beams end [m], each seen from the true pose at its own instant."""
    log = load("rounded_rectangle").log
    truth, scans = log.stream("/ground_truth/pose"), log.stream("/scan")
    pose = cast("dict[str, Floats]", truth.columns("pose.position.x", "pose.position.y"))
    turn = cast("dict[str, Floats]", truth.columns("pose.orientation.z", "pose.orientation.w"))
    yaw = np.unwrap(2.0 * np.arctan2(turn["pose.orientation.z"], turn["pose.orientation.w"]))
    fields = ("ranges", "angle_min", "angle_increment", "time_increment")
    columns: dict[str, Any] = scans.columns(*fields)
    found = []
    for i in range(0, len(scans.t_ns), 10):
        r = np.asarray(columns["ranges"][i], float)
        beam = np.arange(len(r))
        t = scans.t_ns[i] + beam * columns["time_increment"][i] * 1e9
        x, y = (np.interp(t, truth.t_ns, column) for column in pose.values())
        theta = np.interp(t, truth.t_ns, yaw)
        angle = theta + columns["angle_min"][i] + beam * columns["angle_increment"][i]
        good = np.isfinite(r) & (r > 0.05) & (beam % 6 == 0)
        at = np.column_stack(
            (x + 0.2 * np.cos(theta) + r * np.cos(angle), y + 0.2 * np.sin(theta) + r * np.sin(angle))
        )
        found.append(at[good])
    return np.concatenate(found)


def test_a_likelihood_field_prefers_the_exported_sigma_to_half_and_to_twice_of_it(amcl: dict[str, Any]) -> None:
    points, distance = ends(), field()
    column, row = ((points + 0.5) / CELL_M).astype(int).T
    d = distance[row.clip(0, 139), column.clip(0, 179)]

    def likelihood(sigma: float) -> float:
        hit = amcl["z_hit"] * np.exp(-0.5 * (d / sigma) ** 2) / (np.sqrt(2.0 * np.pi) * sigma)
        return float(np.log(hit + amcl["z_rand"] / amcl["laser_max_range"]).mean())

    best = likelihood(amcl["sigma_hit"])
    print(amcl["sigma_hit"], best, likelihood(0.5 * amcl["sigma_hit"]), likelihood(2.0 * amcl["sigma_hit"]))
    assert best > likelihood(0.5 * amcl["sigma_hit"]) + 0.05
    assert best > likelihood(2.0 * amcl["sigma_hit"]) + 0.05


def test_a_step_is_as_noisy_in_amcl_as_wheels_of_the_log_make_it(amcl: dict[str, Any]) -> None:
    """Drawn by hand: wheels of variance 4e-4 m per metre, 0.6 m apart, over one step of AMCL."""
    rng = np.random.default_rng(0)
    k, track, n = 4e-4, 0.6, 200_000
    d, a = amcl["update_min_d"], amcl["update_min_a"]
    straight = d + np.sqrt(k * d) * rng.standard_normal((n, 2))
    rolled = 0.5 * a * track
    spot = np.array([-rolled, rolled]) + np.sqrt(k * rolled) * rng.standard_normal((n, 2))
    turn, way = (straight[:, 1] - straight[:, 0]) / track, straight.mean(axis=1)
    assert 2.0 * amcl["alpha2"] * d**2 == pytest.approx(turn.var(), rel=0.03)
    assert amcl["alpha3"] * d**2 == pytest.approx(way.var(), rel=0.03)
    turn, way = (spot[:, 1] - spot[:, 0]) / track, spot.mean(axis=1)
    assert amcl["alpha1"] * a**2 == pytest.approx(turn.var(), rel=0.03)
    assert amcl["alpha4"] * a**2 == pytest.approx(way.var(), rel=0.03)


def test_values_go_into_the_users_file_and_nothing_else_changes(tmp_path: Path) -> None:
    file = tmp_path / "nav2.yaml"
    text = (
        "amcl:\n  ros__parameters:\n    alpha1: 0.2   # turning\n    update_min_d: 0.5\n    sigma_hit: 0.2\n"
        "    z_hit: 0.5\nbt_navigator:\n  ros__parameters:\n    alpha1: 7\n"
    )
    file.write_text(text.replace("    alpha1: 7\n", "    x: 7\n"))
    done = locfuse("export", "ros", "rounded_rectangle", "--to", "amcl", "--as-set", "--into", file)
    assert done.exit_code == 0, done.stderr
    now = file.read_text().splitlines()
    assert [line.partition(":")[0] for line in now] == [
        line.partition(":")[0] for line in text.replace("alpha1: 7", "x: 7").splitlines()
    ]
    assert now[2].endswith("   # turning")
    assert now[3] == "    update_min_d: 0.5"
    assert f"+{now[4]}" in done.stdout.splitlines()
    assert "z_rand: 0.0" in done.stdout
    assert "not in the file, add it by hand" in done.stdout


def test_a_second_export_changes_nothing_and_does_not_write(tmp_path: Path) -> None:
    file = tmp_path / "nav2.yaml"
    file.write_text("amcl:\n  ros__parameters:\n    alpha1: 0.2\n    sigma_hit: 0.2  # found: m: of another log\n")
    words = ("export", "ros", "rounded_rectangle", "--to", "amcl", "--as-set", "--into", file)
    assert locfuse(*words).stdout.splitlines()[-1] == f"{file}: written"
    text, inode = file.read_text(), file.stat().st_ino
    assert "of another log" not in text
    assert locfuse(*words).stdout.splitlines()[-1] == f"{file}: nothing to change"
    assert (file.read_text(), file.stat().st_ino) == (text, inode)
