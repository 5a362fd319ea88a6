"""Experiments of benchmarks/ go on where they stopped, and a task that fails is a row."""

import json
import math
import os
import subprocess
import sys
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from lock_step import simulated

from benchmarks import accuracy, advice, advice_logs, experiment, faults
from benchmarks.advice_cases import CASES, CLEAN
from benchmarks.building import relation_errors
from benchmarks.fuzz_parsers import PARSERS, corpus, fuzz_parser, wrong
from locfuse.cli.analysis.robot_tables import make_robot, table_types
from locfuse.formats.robot import robot_toml
from locfuse.fusion import se2
from locfuse.fusion.data import Array, Evaluation
from locfuse.sample_logs.scenario import load

TASKS = [(name, seed) for seed in (1, 2) for name in ("a", "b", "bad")]


def work(name: str, seed: int, folder: Path) -> dict[str, Any]:
    """Note the call in a file, so that other processes can be asked as well."""
    with (folder / "calls").open("a") as file:
        file.write(f"{name}{seed}\n")
    if name == "bad":
        raise ValueError("no such thing")
    return {"value": f"{name}{seed}", "process": os.getpid()}


def calls(folder: Path) -> list[str]:
    return (folder / "calls").read_text().split()


@pytest.mark.parametrize("jobs", [1, 2])
def test_rows_come_in_the_order_of_the_tasks_and_failures_stand_among_them(tmp_path: Path, jobs: int) -> None:
    found = experiment.rows(partial(work, folder=tmp_path), TASKS, tmp_path / "rows", jobs)
    assert [row["task"] for row in found] == [list(task) for task in TASKS]
    assert [row["value"] for row in experiment.well(found)] == ["a1", "b1", "a2", "b2"]
    assert [line.partition(" (")[0] for line in experiment.failures(found)] == [
        "failed: bad 1: ValueError: no such thing",
        "failed: bad 2: ValueError: no such thing",
    ]
    assert sorted(calls(tmp_path)) == sorted(f"{name}{seed}" for name, seed in TASKS)


def test_what_stands_in_the_file_is_not_done_again_but_what_failed_is(tmp_path: Path) -> None:
    out = tmp_path / "rows"
    first = experiment.rows(partial(work, folder=tmp_path), TASKS[:3], out)
    (tmp_path / "calls").unlink()
    again = experiment.rows(partial(work, folder=tmp_path), TASKS, out)
    assert again[:2] == first[:2]
    assert calls(tmp_path) == ["bad1", "a2", "b2", "bad2"]


def test_a_row_that_was_cut_off_is_made_again(tmp_path: Path) -> None:
    out = tmp_path / "rows"
    whole = experiment.rows(partial(work, folder=tmp_path), TASKS[:2], out)
    out.write_text(out.read_text()[:-9])
    assert experiment.rows(partial(work, folder=tmp_path), TASKS[:2], out) == whole
    assert calls(tmp_path) == ["a1", "b1", "b1"]
    assert [json.loads(line)["value"] for line in out.read_text().splitlines()] == ["a1", "b1"]


def judged(case: str, *findings: tuple[str, str], **more: Any) -> dict[str, Any]:
    """Judge a case in which these (role, fix) were printed; errors are 4, 20 and 8 mm unless `more` says more."""
    errors = {"right": {"all": (0.004, 0.2)}, "before": {"all": (0.02, 0.2)}, "after": {"all": (0.008, 0.2)}}
    return advice.judged(
        case,
        {
            "fixes": [fix for _, fix in findings if fix],
            "headline": "Keep the laser: 4 mm.",
            "findings": [[role, [fix] if fix else [], "words"] for role, fix in findings],
            **errors,
            **more,
        },
    )


@pytest.mark.parametrize("name", CASES)
def test_every_case_is_a_drive_and_settings_that_exist(name: str) -> None:
    case = CASES[name]
    load("rounded_rectangle", case.scenario)
    for sets in (case.sets, case.right):
        make_robot(robot_toml.apply_sets(sets))
    assert (case.roles == set()) == (name in CLEAN)
    assert {key for fault in case.faults for key in fault.keys} <= set(keys_of_robot())


def keys_of_robot() -> list[str]:
    return [f"{table}.{key}" for table, kind in table_types().items() for key in kind.__struct_fields__]


PAIR, CABINET, FIVE, TRUTH = "laser 50 ms late, compass + 5", "a steel cabinet", "compass + 5", "truth 50 ms late"
LASER, COMPASS = ("lrf", "lrf.time_offset=0.05"), ("compass", "compass.offset_deg=-65")
LEAVE_OUT = "Keep the laser: 4 mm. With all sensors it is 9 mm: leave the compass out."
SAME = {key: {"all": (0.004, 0.2)} for key in ("right", "before", "after")}
BENT = {**SAME, "after": {"all": (0.014, 0.2)}}  # the laser's clock was set to a wrong truth
PRINTED, WITHHELD = [{"all": 0.016}, {"all": 0.004}], [{"all": None}, {"all": None}]


def after(metres: float, degrees: float, before: float = 0.02) -> dict[str, Any]:
    return {"before": {"all": (before, 0.2)}, "after": {"all": (metres, degrees)}}


@pytest.mark.parametrize(
    ("case", "findings", "more", "expected"),
    [
        # what is named
        ("laser 50 ms late", [LASER], {}, {"named": True}),
        ("laser 50 ms late", [("wheels", "wheels.time_offset=-0.05")], {}, {"named": False, "others": ["wheels"]}),
        (PAIR, [LASER], {}, {"named": False}),
        (PAIR, [LASER], after(0.0057, 0.2), {"named": True}),  # the other fault costs nothing
        (PAIR, [], after(0.0057, 0.2), {"named": False}),
        (PAIR, [LASER, COMPASS], {}, {"named": True, "others": []}),
        ("laser bumped by 4 degrees", [("lrf", "")], {}, {"named": True}),  # no key helps
        ("laser bumped by 4 degrees", [("compass", "")], {}, {"named": False}),
        # noise and leaving out are plasters where another key is wrong
        ("hard iron 14 %", [("compass", "compass.sigma_deg=89")], {}, {"plaster": ["compass.sigma_deg=89"]}),
        ("compass sigma / 3", [("compass", "compass.sigma_deg=1")], {}, {"plaster": []}),
        (CABINET, [("compass", "compass.sigma_deg=15")], {}, {"plaster": []}),  # no key sets that right
        (CABINET, [("compass", "compass.sigma_deg=79")], {}, {"plaster": ["compass.sigma_deg=79"]}),
        (FIVE, [("compass", "compass.sigma_offset_deg=0.3")], {}, {"plaster": []}),  # of a state
        (FIVE, [], {"headline": LEAVE_OUT}, {"plaster": ["leave compass out"]}),
        # the gap is measured where a fault costs a fifth and a millimetre: 1.2 * 4 + 1 = 5.8 mm
        (FIVE, [], {}, {"closed": pytest.approx((20 - 8) / (20 - 4)), "worse": []}),
        (FIVE, [], after(0.008, 0.2, 0.0057), {"closed": None}),
        (FIVE, [], after(0.004, 0.2, 0.0059), {"closed": 1.0}),
        # an error that grows is worse, but not than that of the right settings
        (FIVE, [], after(0.021, 0.2), {"worse": ["all 20.0 -> 21.0 mm"]}),
        (FIVE, [], after(0.004, 0.3), {"worse": ["all 0.20 -> 0.30 degrees"]}),
        (FIVE, [], after(0.004, 0.2, 0.003), {"worse": []}),
        # a wrong truth costs what is printed, and a withheld figure costs nothing
        (
            TRUTH,
            [("truth", "truth.time_offset=-0.05")],
            {**SAME, "printed": PRINTED},
            {"closed": pytest.approx(1.0), "errors_m": [0.004, 0.016, 0.004]},
        ),
        (TRUTH, [LASER], {**BENT, "printed": PRINTED}, {"closed": pytest.approx(2 / 12)}),
        (TRUTH, [("truth", "")], {**SAME, "printed": WITHHELD}, {"closed": None}),
    ],
)
def test_advice_is_judged_by_what_it_names_covers_up_and_closes(
    case: str, findings: list[tuple[str, str]], more: dict[str, Any], expected: dict[str, Any]
) -> None:
    found = judged(case, *findings, **more)
    assert {key: found[key] for key in expected} == expected


@pytest.mark.parametrize(
    ("after", "bad"), [((0.3, 2.0), "no"), ((0.41, 2.0), "**yes**"), ((0.3, 4.2), "**yes**"), ((0.4, 4.05), "no")]
)
def test_a_real_log_got_worse_where_position_or_heading_did(after: tuple[float, float], bad: str) -> None:
    """`all` had 0.4 m and 4 degrees."""
    fixes, figures = (
        ["wheels.time_offset=0.13"],
        {"before": {"all": [0.4, 4.0, 7.0]}, "after": {"all": [*after, 7.0]}},
    )
    row = {"task": ["fr079"], "fixes": fixes, "again": [], "cpu": 2.5, **figures}
    (line,) = list(advice_logs.table([row]))[2:]
    log, fix, name, position, heading, anees, worse, again, cpu = (cell.strip() for cell in line.split("|")[1:-1])
    assert (log, fix, name, anees) == ("fr079", "`wheels.time_offset=0.13`", "all", "7 -> 7")
    assert (again, cpu) == ("nothing", "2.5 x")
    assert position == f"400 mm -> {1000 * after[0]:.0f} mm"
    assert heading == f"4.00° -> {after[1]:.2f}°"
    assert worse == bad


# --- random damage to logs and robots, and to what a drive is located by, held to the promise

ROOT = Path(__file__).parents[2]


@pytest.mark.parametrize(
    ("cases", "words"),
    [(4, ()), (12, ("--directed", "--deeds", "map_pictures,line_maps,detection_files,odd_values"))],
)
def test_no_random_damage_breaks_the_promise(tmp_path: Path, cases: int, words: tuple[str, ...]) -> None:
    environment = {k: v for k, v in os.environ.items() if k != "LOCFUSE_DATA"}  # real logs take longer
    done = subprocess.run(
        [sys.executable, "-m", "benchmarks.fuzz", "--cases", f"{cases}", *words, "--keep", str(tmp_path)],
        cwd=ROOT,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr[-2000:]
    assert f"{cases} cases, 0 failed" in done.stdout
    assert all(f"{deed} " in done.stdout for word in words[2:] for deed in word.split(","))


@pytest.mark.parametrize("name", PARSERS)
def test_every_input_of_the_fuzzer_is_read_and_damaged_refused_in_its_own_words(name: str) -> None:
    assert [wrong(PARSERS[name], data) for data in corpus(name)] == [""] * len(corpus(name))
    n, problems = fuzz_parser(name, seed=1, seconds=0.15)
    assert problems == {}
    assert n > 20


def test_the_fuzzer_sees_a_parser_that_breaks() -> None:
    assert "IndexError" in wrong(lambda data: data[10**9], b"a")


# --- a small sample of `python -m benchmarks.accuracy`: four of its drives, without the camera (it takes long)

MODES = accuracy.MODES


@pytest.fixture(scope="module")
def table() -> dict[str, dict[str, float]]:
    north = ("compass.offset_deg=-65",)
    drives = [accuracy.work(1000 + i, no_camera=True, robot_sets=north)["found"] for i in range(4)]
    return accuracy.over_drives(drives)


def test_every_sensor_beats_odometry_and_all_is_among_the_best(table: dict[str, dict[str, float]]) -> None:
    for mode in MODES:
        rmse = {name: table[f"{mode} {name}"]["mean_mm"] for name in ("odometry", "compass", "lrf", "all")}
        assert rmse["compass"] < rmse["odometry"]
        assert rmse["lrf"] < rmse["odometry"]
        assert rmse["all"] < 1.1 * min(rmse.values()), mode  # over fifty it is the best


def test_the_more_of_the_map_is_estimated_the_better_and_only_the_papers_is_overconfident(
    table: dict[str, dict[str, float]],
) -> None:
    rmse = [table[f"{mode} all"]["mean_mm"] for mode in MODES]
    assert rmse == sorted(rmse, reverse=True)
    anees = {mode: table[f"{mode} lrf"]["anees"] for mode in MODES}
    assert anees["first-scan"] > 2.0
    assert all(0.6 < anees[mode] < 1.6 for mode in ("consider", "refine", "grow")), anees
    found = table["grow all"]
    assert found["position_rmse_mm"] < 4.0
    assert found["heading_rmse_deg"] < 0.06
    assert 0.7 < found["anees"] < 1.4


FAULTS = {n: c for n, c in faults.CASES.items() if c.sensor in {"compass", "lrf", ""} and n != faults.CLOCK}
SEEDS = (1000, 1001)


@cache
def driven(seed: int, fault: str, without: str = "") -> Evaluation:
    return faults.judged(*simulated(seed, sets=(f"faults=[{fault}]",) if fault else ()), without)


@pytest.mark.parametrize("case", FAULTS.values(), ids=FAULTS)
def test_a_fault_costs_no_more_than_is_allowed_and_passes(case: faults.Case) -> None:
    drives = [driven(seed, case.fault) for seed in SEEDS]
    yard = [driven(seed, case.fault if case.sensor else "", case.sensor) for seed in SEEDS]
    assert sum(map(faults.rmse, drives)) <= case.factor * sum(map(faults.rmse, yard))
    assert max(map(faults.anees_outside, drives)) < 2.0


# --- relation errors of a building, as they are defined


def circle(n: int = 200) -> tuple[Array, Array]:
    """Poses on a circle of 2 m, one turn in 20 s."""
    t = np.linspace(0.0, 20.0, n)
    a = 2.0 * math.pi * t / 20.0
    return t, np.stack((2.0 * np.sin(a), 2.0 - 2.0 * np.cos(a), a), axis=-1)


def relations(t: Array, pose: Array, pairs: list[tuple[int, int]]) -> Array:
    """What is true between pairs of poses, as a file of relations says it."""
    steps = [(t[i], t[j], *se2.between(pose[i], pose[j])[:2], pose[j, 2] - pose[i, 2]) for i, j in pairs]
    return np.insert(np.array(steps), [4, 4, 4], 0.0, axis=1)


def test_relations_are_blind_to_the_frame_and_see_a_bend() -> None:
    """Moved and turned as a whole a trajectory is as good as before; bent by 5 degrees in the middle it is not."""
    t, pose = circle()
    table = relations(t, pose, [(0, 50), (20, 120), (10, 190)])
    moved = se2.compose(np.array([3.0, -1.0, 2.5]), pose)
    translation, rotation = relation_errors(t, moved, table)
    assert translation.max() < 1e-9
    assert rotation.max() < 1e-9
    bent = pose.copy()
    pivot = np.array([*pose[80, :2], 0.0])
    bend = np.array([0.0, 0.0, math.radians(5.0)])
    bent[80:] = se2.compose(pivot, se2.compose(bend, se2.between(pivot, pose[80:])))
    translation, rotation = relation_errors(t, bent, table)
    assert np.degrees(rotation) == pytest.approx([0.0, 5.0, 5.0], abs=1e-6)
    ahead = np.hypot(*(pose[120, :2] - pose[80, :2]))
    assert translation[:2] == pytest.approx([0.0, 2.0 * ahead * math.sin(math.radians(2.5))], abs=1e-6)
