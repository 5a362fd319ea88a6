"""Scenarios are data: every shipped one is complete, and what does not fit is refused by name."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner, Result

from locfuse.cli.commands.simulate import simulate
from locfuse.cli.session.simulate import localise
from locfuse.fusion.data import LocfuseError, UsageError
from locfuse.sample_logs import load
from locfuse.sample_logs.messages import streams
from locfuse.sample_logs.record import in_memory, on_truth
from locfuse.sample_logs.scenario import Scenario
from locfuse.sample_logs.simulate import Simulation

BLIND = ("camera.enabled=false", "lrf.enabled=false", "compass.enabled=false")


def run(*arguments: str) -> Result:
    return CliRunner().invoke(simulate, list(arguments))


CREEP = 'faults=[{kind="creep", ratio=0.02}]'  # whose other keys are left out


@pytest.mark.parametrize(("name", "sets"), [*((name, ()) for name in load.names()), ("tour", (CREEP,))])
def test_a_scenario_says_what_it_is_and_survives_being_written_out(
    name: str, sets: tuple[str, ...], tmp_path: Path
) -> None:
    scenario = load.load(name, sets)
    assert 20 < len(scenario.title) < 120
    copy = tmp_path / "copy.toml"
    copy.write_text(load.dumps(scenario))
    assert load.load(str(copy)) == scenario


def test_the_same_seed_gives_the_same_drive_in_one_simulation_too() -> None:
    scenario = load.load("tour", (*BLIND, "path.length=3"))
    first, again, other = (in_memory(scenario, seed)[2].truth for seed in (1, 1, 2))
    np.testing.assert_array_equal(first, again)
    assert not np.array_equal(first[0], other[0])
    simulation = Simulation(load.load("tour", (*BLIND, "path.length=3")), 1)
    first, again = (simulation.run(None, lambda message: None).truth for _ in range(2))
    np.testing.assert_array_equal(first, again)


def test_sources_of_chance_are_independent_of_each_other() -> None:
    a, b, again = (streams(5)(name).standard_normal(1000) for name in ("lrf", "compass", "lrf"))
    np.testing.assert_array_equal(a, again)
    assert abs((a * b).mean()) < 0.12


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[wheels]\ntrak = 0.5", "no key trak in wheels; did you mean track?"),
        ("[rom]\nsize = [3, 4]", "no key rom in a scenario; did you mean room?"),
        ("[[faults]]\nkind = 'slipp'", "no kind slipp of faults[0]; did you mean slip?"),
        ("[[faults]]\nkind = 'slip'\nweel = 'left'", "no key weel in faults[0]; did you mean wheel?"),
        ("[path]\nkind = 'tour'\nradus = 1", "no key radus in path; did you mean radius?"),
        ("[[sonar]]\nname = 'a'\nx = 1\nsigm = 1", "no key sigm in sonar[0]; did you mean sigma?"),
        ("[lrf]\nrate = 0", "expected `float` > 0.0 - at `lrf.rate`"),
        ("[lrf]\nrate = 'fast'", "expected `float`, got `str` - at `lrf.rate`"),
        ("[lrf\n", "is not TOML"),
        ("base = 'rounded_rectangel'", "did you mean rounded_rectangle?"),
        ("base = 'hall'\n[building]\nspaces = [{name = 'a', aera = [0, 0, 1, 1]}]", "did you mean area?"),
        ("base = 'hall'\n[building]\npeople = [{path = [[1, 2]]}]", "at least two points"),
        ("base = 'office'\n[camera]\nenabled = true", "set camera.enabled = false"),
        (
            "[[faults]]\nkind = 'magnetic'\nx = 1\ny = 1\nstrength = 1\nstart = 5\nend = 4",
            "end = 4 must come after",
        ),
        ("[[faults]]\nkind = 'people'\npath = [[1, 1], [2, 2]]", "a walk needs an `end`"),
        ("[[faults]]\nkind = 'kidnap'\nx = 1\ny = 1", "a kidnapping needs an `end`"),
        ("[[faults]]\nkind = 'slip'\nwheel = 'left'\nratio = 1.5", "`float` <= 1.0 - at `faults[0].ratio`"),
    ],
)
def test_a_scenario_that_does_not_fit_is_refused_by_its_key(text: str, message: str, tmp_path: Path) -> None:
    file = tmp_path / "mine.toml"
    file.write_text(text)
    with pytest.raises(LocfuseError) as error:
        load.load(str(file))
    assert message in str(error.value)
    assert "\n" not in str(error.value)


def test_a_scenario_that_is_not_text_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "mine.toml"
    file.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(LocfuseError, match="cannot be read as a scenario"):
        load.load(str(file))


def test_settings_take_toml_values_or_plain_text_and_reach_defaults() -> None:
    changes = ("control.speed=0.2", "landmark.top=1.2", "camera.clockwise=true", "control.estimator=truth")
    scenario = load.load("rounded_rectangle", changes)
    assert scenario.control.speed == 0.2
    assert scenario.landmark.top == 1.2
    assert scenario.landmark.x == 7.9
    assert scenario.camera.clockwise
    assert scenario.control.estimator == "truth"


@pytest.mark.parametrize("setting", ["control.speeed=0.2", "control.speed=fast", "control", "=3"])
def test_a_setting_that_does_not_fit_is_the_command_lines_fault(setting: str) -> None:
    with pytest.raises(UsageError):
        load.load("rounded_rectangle", (setting,))


def test_a_table_of_another_kind_replaces_the_old_one() -> None:
    old = {"path": {"kind": "polygon", "radius": 0.6}, "lrf": {"x": 0.1}}
    assert load.merge(old, {"path": {"kind": "tour"}, "lrf": {"y": 0.2}}) == {
        "path": {"kind": "tour"},
        "lrf": {"x": 0.1, "y": 0.2},
    }


def test_a_file_beats_a_shipped_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "tour").write_text("title = 'mine, all mine'")
    monkeypatch.chdir(tmp_path)
    assert load.load("tour").title == "mine, all mine"


def test_list_names_every_scenario_with_its_title() -> None:
    lines = run("--list").output.splitlines()
    assert [line.split()[0] for line in lines] == load.names()
    assert all(len(line.split()) > 3 for line in lines)


def test_show_prints_a_complete_scenario(tmp_path: Path) -> None:
    file = tmp_path / "mine.toml"
    file.write_text(run("disturbed", "--show", "--set", "lrf.rate=5").output)
    scenario = load.load(str(file))
    assert scenario.lrf.rate == 5
    assert len(scenario.faults) == len(load.load("disturbed").faults)


def test_a_drive_is_recorded_and_summed_up_as_json(tmp_path: Path) -> None:
    log = tmp_path / "drive.mcap"
    options = [text for setting in ("path.length=2", "camera.rate=0.5") for text in ("--set", setting)]
    result = run("tour", "-o", str(log), "--seed", "4", "--json", *options)
    assert result.exit_code == 0, result.output
    facts = json.loads(result.output)
    assert facts["seed"] == 4
    assert facts["duration_s"] > 5
    assert log.stat().st_size > 10_000


def test_an_existing_file_is_only_replaced_when_asked(tmp_path: Path) -> None:
    log = tmp_path / "drive.mcap"
    log.write_bytes(b"my only bag")
    result = run("tour", "-o", str(log))
    assert isinstance(result.exception, UsageError)
    assert "--overwrite" in str(result.exception)
    assert log.read_bytes() == b"my only bag"


@pytest.mark.parametrize("arguments", [(), ("tour",), ("nowhere", "-o", "x.mcap")])
def test_a_command_line_that_says_too_little_is_refused(arguments: tuple[str, ...]) -> None:
    assert isinstance(run(*arguments).exception, UsageError)


def test_the_robot_can_steer_on_the_truth_on_odometry_or_on_the_filter() -> None:
    """Fig. 14: with the EKF in the loop the robot comes back to its start, on odometry it does not."""
    scenario = load.load("rounded_rectangle", ("camera.enabled=false", "lrf.rate=2"))
    ends = {}
    for word in ("odometry", "compass+lrf", "truth"):
        _, _, outcome = in_memory(scenario, 1, localise(word))
        ends[word] = float(np.hypot(*(outcome.truth[-1, :2] - (1.5, 1.5))))
    assert ends["odometry"] > 0.5
    assert ends["compass+lrf"] < 0.25
    assert ends["truth"] < 0.15
    assert localise("truth") is on_truth


def test_steering_on_a_sensor_the_robot_lacks_is_refused() -> None:
    tables = Simulation(Scenario(), 1).robot_tables
    with pytest.raises(UsageError, match="this robot has no sonar; choose from truth, odometry, compass"):
        localise("sonar")(tables)
