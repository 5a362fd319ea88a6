"""Experiments of benchmarks/ go on where they stopped, and a task that fails is a row."""

from __future__ import annotations

import json
import os
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from benchmarks import advice, advice_logs, experiment
from benchmarks.advice_cases import CASES, CLEAN, RIGHT
from locfuse.cli.analysis.robot_tables import make_robot, table_types
from locfuse.formats.robot import robot_toml
from locfuse.sample_logs.load import load

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


def test_tasks_of_one_unit_run_in_one_process(tmp_path: Path) -> None:
    tasks = [(name, seed) for seed in range(4) for name in ("a", "b")]
    found = experiment.rows(partial(work, folder=tmp_path), tasks, jobs=2, unit=lambda task: task[1])
    for a, b in zip(found[::2], found[1::2], strict=True):
        assert a["process"] == b["process"]


# --- the ruler of the advice: what counts as named, as plaster, as worse, and as a gap that is closed


LAG = "truth.time_offset=-0.05"


def judged(case: str, *findings: tuple[str, str], **more: Any) -> dict[str, Any]:
    """Judge a case in which these (role, fix) were printed; errors are 4, 20 and 8 mm unless `more` says more."""
    errors = {"right": {"all": (0.004, 0.2)}, "before": {"all": (0.02, 0.2)}, "after": {"all": (0.008, 0.2)}}
    return advice.judged(
        {
            "task": [case, 3000, True],
            "fixes": [fix for _, fix in findings if fix],
            "headline": "Keep the laser: 4 mm.",
            "findings": [[role, [fix] if fix else [], "words"] for role, fix in findings],
            **errors,
            **more,
        }
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


def test_a_key_that_is_set_is_named_and_another_role_is_another() -> None:
    assert judged("laser 50 ms late", ("lrf", "lrf.time_offset=0.05"))["named"]
    wrong = judged("laser 50 ms late", ("wheels", "wheels.time_offset=-0.05"))
    assert not wrong["named"]
    assert wrong["others"] == ["wheels"]


def test_a_pair_is_named_when_both_keys_are_set() -> None:
    name = "laser 50 ms late, compass + 5"
    assert not judged(name, ("lrf", "lrf.time_offset=0.05"))["named"]
    both = judged(name, ("lrf", "lrf.time_offset=0.05"), ("compass", "compass.offset_deg=-65"))
    assert both["named"]
    assert both["others"] == []


def test_where_no_key_helps_a_finding_without_a_fix_names_the_sensor() -> None:
    assert judged("laser bumped by 4 degrees", ("lrf", ""))["named"]
    assert not judged("laser bumped by 4 degrees", ("compass", ""))["named"]


def test_noise_and_leaving_out_are_plasters_where_another_key_is_wrong() -> None:
    assert judged("hard iron 14 %", ("compass", "compass.sigma_deg=89"))["plaster"] == ["compass.sigma_deg=89"]
    assert judged("compass sigma / 3", ("compass", "compass.sigma_deg=1"))["plaster"] == []
    assert (
        judged("a steel cabinet", ("compass", "compass.sigma_deg=15"))["plaster"] == []
    )  # no key sets that right
    assert judged("a steel cabinet", ("compass", "compass.sigma_deg=79"))["plaster"] == ["compass.sigma_deg=79"]
    assert judged("compass + 5", ("compass", "compass.sigma_offset_deg=0.3"))["plaster"] == []  # of a state
    words = "Keep the laser: 4 mm. With all sensors it is 9 mm: leave the compass out."
    assert judged("compass + 5", headline=words)["plaster"] == ["leave compass out"]


def test_the_gap_is_measured_where_a_fault_costs_a_fifth_and_a_millimetre() -> None:
    assert judged("compass + 5")["closed"] == pytest.approx((20 - 8) / (20 - 4))
    cheap = {"before": {"all": (0.0057, 0.2)}}  # 1.2 * 4 + 1 = 5.8 mm
    assert judged("compass + 5", **cheap)["closed"] is None
    assert judged("compass + 5", before={"all": (0.0059, 0.2)}, after={"all": (0.004, 0.2)})["closed"] == 1.0


def test_an_error_that_grows_in_position_or_heading_is_worse_but_not_than_the_right_one() -> None:
    assert judged("compass + 5")["worse"] == []
    assert judged("compass + 5", after={"all": (0.021, 0.2)})["worse"] == ["all 20.0 -> 21.0 mm"]
    assert judged("compass + 5", after={"all": (0.004, 0.3)})["worse"] == ["all 0.20 -> 0.30 degrees"]
    lucky = {"before": {"all": (0.003, 0.2)}, "after": {"all": (0.004, 0.2)}}  # chance: as the right settings are
    assert judged("compass + 5", **lucky)["worse"] == []


def test_a_wrong_truth_costs_what_is_printed_and_a_withheld_figure_costs_nothing() -> None:
    same = {key: {"all": (0.004, 0.2)} for key in ("right", "before", "after")}
    fixed = judged("truth 50 ms late", ("truth", LAG), **same, printed=[{"all": 0.016}, {"all": 0.004}])
    assert fixed["closed"] == pytest.approx(1.0)
    assert fixed["errors_m"] == [0.004, 0.016, 0.004]
    bent = {**same, "after": {"all": (0.014, 0.2)}}  # the laser's clock was set to a wrong truth
    fooled = judged(
        "truth 50 ms late", ("lrf", "lrf.time_offset=0.05"), **bent, printed=[{"all": 0.016}, {"all": 0.004}]
    )
    assert fooled["closed"] == pytest.approx(2 / 12)
    void = judged("truth 50 ms late", ("truth", ""), **same, printed=[{"all": None}, {"all": None}])
    assert void["closed"] is None


def test_a_clean_drive_has_the_right_settings() -> None:
    assert CASES["none"].sets == CASES["none"].right == RIGHT


def real_row(after: tuple[float, float]) -> dict[str, Any]:
    """Return the row of a real log whose `all` had 0.4 m and 4 degrees, and has `after` now."""

    def figures(*errors: float) -> dict[str, Any]:
        return {"all": {"errors": [*errors, 7.0], "void": False}}

    return {
        "task": ["fr079"],
        "fixes": ["wheels.time_offset=0.13"],
        "again": [],
        "findings": [{"what": "wheels: lag", "fixes": ["wheels.time_offset=0.13"], "judged": None, "words": ""}],
        "before": figures(0.4, 4.0),
        "after": figures(*after),
        "cpu": [10.0, 25.0],
        "relations": None,
    }


@pytest.mark.parametrize(
    ("after", "bad"), [((0.3, 2.0), "no"), ((0.41, 2.0), "**yes**"), ((0.3, 4.2), "**yes**"), ((0.4, 4.05), "no")]
)
def test_a_real_log_got_worse_where_position_or_heading_did(after: tuple[float, float], bad: str) -> None:
    (line,) = advice_logs.obeyed_table([real_row(after)])[2:]
    log, name, position, heading, anees, worse, again, cpu = (cell.strip() for cell in line.split("|")[1:-1])
    assert (log, name, anees, again, cpu) == ("fr079", "all", "7 -> 7", "nothing", "2.5 x, 1 fixes")
    assert position.startswith("0.40 m -> 0.")
    assert heading == f"4.00° -> {after[1]:.2f}°"
    assert worse == bad
