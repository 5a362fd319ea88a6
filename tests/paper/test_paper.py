"""The printed preset: each equation against the expression in print, typed out here, and the lock-step of them."""

import math
import re
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import small_drive
from commands import ok, refused, reported
from msgspec.structs import replace
from present import present

from locfuse.cli.session import paper
from locfuse.cli.session.paper import Driven
from locfuse.cli.session.session import load
from locfuse.formats.report import json_report, paper_page
from locfuse.formats.robot import map_files
from locfuse.formats.whole_files import write_results
from locfuse.fusion.data import Array, Drive, LocfuseError, Measurements
from locfuse.fusion.measure import cut
from locfuse.fusion.paper import equations
from locfuse.fusion.paper.filter import PrintedFilter, fuse_as_printed, newest
from locfuse.fusion.robot import Robot
from locfuse.fusion.sensors.camera import CameraSettings

RNG = np.random.default_rng(0)
CASES = [pytest.param(*row, id=f"case {i}") for i, row in enumerate(RNG.uniform(-3, 3, (6, 4)).tolist())]
LANDMARK = (7.9, 5.5)
DEG = math.pi / 180


@pytest.mark.parametrize(("ds", "dtheta", "theta", "d"), CASES)
def test_equation_8_is_the_printed_matrix(ds: float, dtheta: float, theta: float, d: float) -> None:
    l = 0.6  # noqa: E741 - the name in print
    s, c = math.sin(theta + dtheta / 2), math.cos(theta + dtheta / 2)
    W = [[-ds * s / (2 * l), ds * s / (2 * l)], [ds * c / (2 * l), -ds * c / (2 * l)], [1 / l, -1 / l]]
    found = equations.eq8_W(np.array(ds), np.array(dtheta), np.array(theta), l)
    np.testing.assert_allclose(found, np.array(W), rtol=1e-14)
    assert np.linalg.matrix_rank(W) == 1, "the print has no noise along the way"


def test_equation_13_is_the_derivative_only_at_a_distance_of_one_metre() -> None:
    x, beta, h = np.array([0.4, 0.7, 0.2]), 0.3, 1e-6
    for distance in (1.0, 2.0, 3.0):
        rho = distance + x[0] * math.cos(beta) + x[1] * math.sin(beta)

        def predicted(at: Array, rho: float = rho) -> Array:
            C = equations.eq17_C(rho, beta, at[0], at[1])
            return np.array(equations.eq18_prediction(C, beta, at[2]))

        steps = np.eye(3) * h
        numeric = np.stack([(predicted(x + s) - predicted(x - s)) / (2 * h) for s in steps], axis=-1)
        off = equations.eq13_H_line(distance, beta) - numeric
        np.testing.assert_allclose(off[0], (distance - 1.0) * numeric[0], atol=1e-8)
        np.testing.assert_allclose(off[1], 0.0, atol=1e-8)


@pytest.mark.parametrize(("rho", "beta", "x", "y"), CASES)
def test_equations_17_and_18_are_the_printed_prediction(rho: float, beta: float, x: float, y: float) -> None:
    C = rho - x * math.cos(beta) - y * math.sin(beta)
    assert equations.eq17_C(rho, beta, x, y) == pytest.approx(C, abs=1e-15)
    theta = 0.4
    sign = 1 if C > 0 else -1
    psi = beta - (theta - math.pi / 2) + (-0.5 * sign + 0.5) * math.pi
    assert equations.eq18_prediction(C, beta, theta) == pytest.approx((abs(C), psi), abs=1e-14)


def test_a_step_takes_the_newest_reading_since_the_step_before() -> None:
    grid = np.array([0.0, 0.1, 0.2, 0.3, 0.4])
    t = np.array([0.03, 0.09, 0.1, 0.11, 0.35])
    assert newest(grid, t).tolist() == [-1, 2, 3, -1, 4]
    assert newest(grid, np.zeros(0)).tolist() == [-1] * 5


def with_camera(drive: Drive, robot: Robot, seed: int = 5) -> tuple[Drive, Robot]:
    """Add bearings of LANDMARK at 2 Hz: from the axle, 0.5 degrees of noise, every seventh picture without one."""
    rng, truth = np.random.default_rng(seed), present(drive.truth)
    t = np.arange(0.17, float(drive.t[-1]), 0.5)
    x, y, theta = (np.interp(t, truth.t, v) for v in (*truth.xy.T, np.unwrap(present(truth.theta))))
    seen = np.arange(len(t)) % 7 > 0
    z = np.arctan2(LANDMARK[1] - y, LANDMARK[0] - x) - theta + 0.5 * DEG * rng.normal(size=len(t))
    first, one = np.concatenate(([0], np.cumsum(seen))), np.ones((int(seen.sum()), 1, 1))
    camera = Measurements(t, first, z[seen, None], one, 0.5 * DEG, np.zeros((1, 1)))
    measurements = {**drive.measurements, "camera": camera}
    parts = cut(drive.wheels, robot, measurements, None)
    more = replace(drive, measurements=measurements, truth=None, **parts)
    sensors = {**robot.sensors, "camera": CameraSettings(landmark=LANDMARK)}
    return more, replace(robot, sensors=sensors)


def by_hand(drive: Drive, robot: Robot) -> tuple[Array, Array]:
    """The printed filter with all sensors, straight from the page; poses and covariances at every 100 ms."""
    wheels, m = drive.wheels, drive.measurements
    rolled = np.vstack(([0.0, 0.0], np.cumsum(wheels.rolled, axis=0)))
    x = np.array([*small_drive.START])
    P = np.zeros((3, 3))
    lines: list[tuple[float, float]] = []
    phi_0 = None
    start_direction = math.atan2(LANDMARK[1] - x[1], LANDMARK[0] - x[0])
    last, poses, covariances = np.zeros(2), [], []
    for k in range(int(drive.t[-1] / 0.1 + 1e-6) + 1):
        now = rolled[np.flatnonzero(wheels.t <= 0.1 * k + 1e-9)[-1]]
        (x, P), last = rolled_by_hand(x, P, *(now - last)), now
        z, h, H, R = [], [], [], []
        for i in newest_by_hand(m["lrf"], k):
            scan = m["lrf"].z[m["lrf"].first[i] : m["lrf"].first[i + 1]] + np.array([0.0, math.pi / 2])
            if not lines:
                betas = scan[:, 1] + x[2] - math.pi / 2
                lines += zip(scan[:, 0] + x[0] * np.cos(betas) + x[1] * np.sin(betas), betas, strict=True)
                continue
            for r, psi in scan:
                for _, r_, psi_, dpsi, rows in sorted(in_window(lines, x, r, psi), key=lambda n: n[0])[:1]:
                    z += [r, psi_ + dpsi]
                    h += [r_, psi_]
                    H += rows
                    R += [0.03**2, (0.25 * DEG) ** 2]
        headings = []
        for i in newest_by_hand(m["compass"], k):
            phi = m["compass"].z[i, 0]
            phi_0 = phi - x[2] if phi_0 is None else phi_0
            headings.append((phi - phi_0, 0.01))
        for i in newest_by_hand(m["camera"], k):
            bearings = m["camera"].z[m["camera"].first[i] : m["camera"].first[i + 1], 0]
            headings += [(start_direction - bearing, (0.5 * DEG) ** 2) for bearing in bearings]
        for heading, variance in headings:
            z.append(x[2] + math.remainder(heading - x[2], math.tau))
            h.append(x[2])
            H.append([0, 0, 1])
            R.append(variance)
        if z:
            H_ = np.array(H)
            K = P @ H_.T @ np.linalg.inv(H_ @ P @ H_.T + np.diag(R))
            x = x + K @ (np.array(z) - np.array(h))
            P = (np.eye(3) - K @ H_) @ P
        poses.append(x)
        covariances.append(P)
    return np.array(poses), np.array(covariances)


def rolled_by_hand(x: Array, P: Array, ds_L: float, ds_R: float) -> tuple[Array, Array]:
    L = small_drive.TRACK
    ds, dth, th = (ds_L + ds_R) / 2, (ds_R - ds_L) / L, x[2]
    s, c = math.sin(th + dth / 2), math.cos(th + dth / 2)
    A = np.array([[1, 0, -ds * s], [0, 1, ds * c], [0, 0, 1]])
    W = np.array([[-ds * s / 2, ds * s / 2], [ds * c / 2, -ds * c / 2], [1, -1]]) / L
    P = A @ P @ A.T + W @ np.diag([0.01 * ds_R**2, 0.01 * ds_L**2]) @ W.T
    return x + np.array([ds * c, ds * s, dth]), P


def in_window(lines: list[tuple[float, float]], x: Array, r: float, psi: float) -> list[Any]:
    """Map lines within 0.5 m and 15 degrees of (r, psi): distance, prediction, difference in psi, rows of H."""
    near = []
    for rho, beta in lines:
        C = rho - x[0] * math.cos(beta) - x[1] * math.sin(beta)
        r_, psi_ = abs(C), beta - (x[2] - math.pi / 2) + (-0.5 * np.sign(C) + 0.5) * math.pi
        dr, dpsi = r - r_, math.remainder(psi - psi_, math.tau)
        if abs(dr) <= 0.5 and abs(dpsi) <= 15 * DEG:
            rows = [[-C * math.cos(beta), -C * math.sin(beta), 0], [0, 0, -1]]
            near.append(((dr / 0.5) ** 2 + (dpsi / (15 * DEG)) ** 2, r_, psi_, dpsi, rows))
    return near


def newest_by_hand(m: Measurements, k: int) -> list[int]:
    return [int(i) for i in np.flatnonzero((m.t > 0.1 * (k - 1) + 1e-9) & (m.t <= 0.1 * k + 1e-9))[-1:]]


def test_the_lock_step_filter_is_the_print_line_by_line() -> None:
    robot = small_drive.robot()
    drive, robot = with_camera(small_drive.drive(3, robot, laps=0.5), robot)
    run = PrintedFilter(drive, robot, ("compass", "lrf", "camera"), {})
    for k in range(len(run.grid)):
        run.step(k)
    pose, P = run.at(run.grid)
    expected, expected_P = by_hand(drive, robot)
    assert len(expected) > 200
    np.testing.assert_allclose(pose, expected, atol=1e-9)
    np.testing.assert_allclose(P, expected_P, atol=1e-12)


def test_a_listening_sensor_is_audited_but_moves_nothing() -> None:
    robot = small_drive.robot()
    drive = small_drive.drive(2, robot)
    alone = fuse_as_printed(drive, robot, ("compass",))
    every = np.ones(len(drive.measurements["lrf"].t), bool)
    heard = fuse_as_printed(drive, robot, ("compass",), listen={"lrf": every})
    np.testing.assert_array_equal(alone.pose, heard.pose)
    assert heard.sensors == ("compass",)
    assert np.isfinite(heard.audits["lrf"].nis).sum() > 100
    every[::2] = False
    half = fuse_as_printed(drive, robot, ("compass", "lrf"), listen={"lrf": every})
    assert np.abs(half.pose - heard.pose).max() > 0.01


def test_what_the_print_has_no_equation_for_is_refused_by_name() -> None:
    robot = small_drive.robot()
    drive = small_drive.drive(2, robot, laps=0.1)
    sonar: Any = {**drive.measurements, "sonar": drive.measurements["compass"]}
    with pytest.raises(LocfuseError, match="sonar: the paper has no equation"):
        fuse_as_printed(replace(drive, measurements=sonar), robot, ("sonar",))
    with pytest.raises(LocfuseError, match="camera"):
        fuse_as_printed(drive, robot, ("camera",))


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A short simulated drive with a sonar that the paper has no equation for."""
    path = tmp_path_factory.mktemp("paper") / "drive.mcap"
    legs = "path.legs=[{forward=2.0}, {turn_deg=90}, {forward=1.0}]"
    sets = ("camera.enabled=false", legs, 'sonar=[{name="front", x=0.2}]')
    ok("simulate", "straight_runs", "-o", path, *(w for s in sets for w in ("--set", s)))
    return path


def test_the_preset_is_said_and_recorded_and_reproduces(log: Path) -> None:
    done = reported("compare", log, "-v", "--no-advice", "--preset", "paper")
    assert "note: preset paper" in done.stderr
    report = done.report
    assert report["settings"]["preset"] == "paper"
    assert report["settings"]["camera"]["chain"] == "paper"
    assert "no equation" in report["absent"]["sonar"]
    assert list(report["configurations"]) == ["odometry", "compass", "lrf", "all"]
    words = (log, "--no-advice", "--robot", done.out / "robot.toml")
    assert reported("compare", *words).rows == done.rows
    ours = reported("run", *words, "--preset", "default", "--sensors", "lrf").rows["lrf"]
    assert ours["position_rmse_m"] != done.rows["lrf"]["position_rmse_m"]


def test_an_unknown_preset_is_refused_with_the_known_ones(log: Path, tmp_path: Path) -> None:
    refused("run", log, "--preset", "papr", "-o", tmp_path / "out", code=2)
    robot = tmp_path / "robot.toml"
    robot.write_text('preset = "papr"\n')
    assert "choose from default, paper" in refused("run", log, "--robot", robot, "-o", tmp_path / "out")


def test_the_printed_filter_refuses_a_given_map_and_does_not_pass_it_by(tmp_path: Path) -> None:
    hall = tmp_path / "hall.json"
    hall.write_text(map_files.encode_lines((), "nowhere"))
    words = ("run", "rounded_rectangle", "--map", hall, "--preset", "paper", "-o", tmp_path / "out")
    assert "leave --preset paper out" in refused(*words, code=2)


def test_a_drive_of_more_steps_than_memory_is_refused_in_one_line() -> None:
    drive = small_drive.drive(1, small_drive.robot())
    years = replace(drive, t=np.append(drive.t[:-1], 1.7e9))
    why = r"^[^\n]*1\.7e\+10 steps; 2000000 are the most\. Fuse a part of it[^\n]*$"
    with pytest.raises(LocfuseError, match=why):
        PrintedFilter(years, small_drive.robot(), (), {})


# --- `locfuse paper`: table, figures and page say what the two comparisons and the four drives gave

PATHS = ("rounded_rectangle", "rounded_rectangle_ekf", "rounded_triangle", "rounded_triangle_ekf")


def circle(radius: float) -> np.ndarray:
    angle = np.linspace(0.0, 2.0 * np.pi, 200)
    return np.stack((4.0 + radius * np.cos(angle), 3.0 + radius * np.sin(angle)), axis=-1)


@pytest.fixture(scope="module")
def found() -> paper.Repeated:
    """Both comparisons for real; of the drives, which take a minute, made-up ones 20 cm beside their path."""
    compared = {
        which: load(paper.LOG, preset=p).compare(smooth=False, advice=False) for which, p in paper.PRESETS.items()
    }
    return paper.Repeated(compared, {name: Driven(circle(1.7), circle(1.5)) for name in PATHS})


@pytest.fixture(scope="module")
def folder(found: paper.Repeated, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("paper") / "out"
    values = json_report.plain(found.values())
    write_results(out, paper.files(found, values), overwrite=False)
    return out


def test_every_figure_is_there_and_figure_13_has_y_below_x_on_one_time_axis(folder: Path) -> None:
    page = (folder / "paper.html").read_text()
    for name in ("fig12", "fig12_print", "fig13", "fig13_print", "fig14a", "fig14b"):
        ET.fromstring((folder / f"{name}.svg").read_bytes())
        assert (folder / f"{name}.pdf").read_bytes().startswith(b"%PDF")
        assert f'<section id="{name}">' in page
    assert "http" not in page.replace("http-equiv", "")
    text = (folder / "fig13.svg").read_text()
    assert text.index("deviation in x, m") < text.index("deviation in y, m")
    assert text.count(">time, s<") == 1


def test_the_table_sets_the_print_beside_our_filter(found: paper.Repeated, folder: Path) -> None:
    rows = {row["configuration"]: row for row in found.rows()}
    assert list(rows) == ["odometry", "compass", "lrf", "camera", "all"]
    for which, comparison in found.compared.items():
        for name, figures in comparison.report["configurations"].items():
            assert rows[name][f"{which}_position_rmse_m"] == figures["position_rmse_m"]
    alone = rows["odometry"]  # a chord (eq. 3) for an arc makes no difference that is seen
    assert alone["print_position_rmse_m"] == pytest.approx(alone["ours_position_rmse_m"], rel=1e-3)
    assert rows["all"]["print_position_rmse_m"] > 5 * rows["all"]["ours_position_rmse_m"]
    shown = re.findall(r'data-from="/table/4/ours_position_rmse_m">([\d.]+)', (folder / "paper.html").read_text())
    assert [float(v) for v in shown] == [pytest.approx(rows["all"]["ours_position_rmse_m"], abs=5e-4)]


def test_the_conclusion_names_the_smallest_error(found: paper.Repeated, folder: Path) -> None:
    said = paper_page.conclusion(found.values())
    assert re.search(r"with our filter lrf \(3\.9 mm, all 4\.1 mm\)", said)  # a laser alone is as good
    assert re.search(r"as printed lrf \(52 mm, all 75 mm\)", said)  # the printed camera spoils the rest
    assert said in (folder / "paper.html").read_text()
    lrf = {"configuration": "lrf", "ours_position_rmse_m": 0.2, "print_position_rmse_m": 0.3}
    everything = {"configuration": "all", "ours_position_rmse_m": 0.1, "print_position_rmse_m": 0.15}
    better = paper_page.conclusion({"table": [lrf, everything]})
    assert "with our filter all (100 mm) and by the equations as printed all (150 mm)" in better


def test_the_walls_of_figure_14_are_the_scenario_s_and_distances_to_the_nearest_point(
    found: paper.Repeated,
) -> None:
    a, b = paper.path_panels(found.driven)
    walls = next(m for m in a.marks if m.of == paper.WALLS)
    assert (a.name, b.name) == ("fig14a", "fig14b")
    assert {8.0, 6.0, 0.0} <= set(np.ravel(walls.ends))  # type: ignore[union-attr]
    for row in found.distances():
        assert row["rms"] == pytest.approx(0.2, abs=1e-3)
        assert row["largest"] == pytest.approx(0.2, abs=1e-3)


def test_a_folder_that_holds_something_else_is_refused_before_any_work(tmp_path: Path) -> None:
    (tmp_path / "thesis.tex").touch()
    refused("paper", "-o", tmp_path)
