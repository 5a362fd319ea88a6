"""Bad input in Python: LocfuseError with the command's line; never SystemExit, never a bare KeyError."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from commands import locfuse as command
from rewrite_log import rewritten

import locfuse

LOG = "rounded_rectangle"


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("bad")
    (folder / "text.mcap").write_text("hello")
    (folder / "empty.mcap").write_bytes(b"")
    (folder / "folder").mkdir()
    (folder / "typo.toml").write_text("[wheels]\ntrak = 0.6\n")
    rewritten(folder / "wheelless.mcap", seed=None, without="/joint_states")
    return folder


@pytest.fixture(scope="module")
def session() -> locfuse.Session:
    return locfuse.load(LOG, between=(None, 10.0))


@pytest.fixture(scope="module")
def result(session: locfuse.Session) -> locfuse.Comparison:
    return session.compare(["odometry", "compass"])


@pytest.mark.parametrize("name", ["nosuch.mcap", "text.mcap", "empty.mcap", "folder", "wheelless.mcap"])
def test_a_log_that_cannot_be_used_gets_the_commands_line(files: Path, tmp_path: Path, name: str) -> None:
    with pytest.raises(locfuse.LocfuseError) as caught:
        locfuse.load(files / name)
    done = command("run", files / name, "-o", tmp_path / "out")
    assert done.stderr == f"locfuse: {caught.value}\n"
    assert done.exit_code == caught.value.exit_code


@pytest.mark.parametrize(
    "setting", ["lrf.topic=/nowhere", "wheels.trak=0.5", "whels.track=0.5", "wheels.track=wide", "wheels.track=-1"]
)
def test_a_setting_that_fits_nothing_gets_the_commands_line(tmp_path: Path, setting: str) -> None:
    key, _, value = setting.partition("=")
    done = command("run", LOG, "--set", setting, "-o", tmp_path / "out")
    for sets in ([setting], {key: -1 if value == "-1" else 0.5 if value == "0.5" else value}):
        with pytest.raises(locfuse.LocfuseError) as caught:
            locfuse.load(LOG, sets=sets)
        assert done.stderr == f"locfuse: {caught.value}\n"


@pytest.mark.parametrize("sensors", ["lrg", "sonar,lrf", "lrf@fast"])
def test_sensors_that_are_not_there_get_the_commands_line(
    session: locfuse.Session, tmp_path: Path, sensors: str
) -> None:
    done = command("run", LOG, "--sensors", sensors, "-o", tmp_path / "out")
    calls: list[Callable[[], Any]] = [
        lambda: session.run(sensors),
        lambda: session.run(sensors.split(",")),
        lambda: session.compare([sensors]),
        lambda: locfuse.fuse(session.drive, session.robot, sensors),
        lambda: locfuse.smooth(session.drive, session.robot, sensors),
    ]
    for call in calls:
        with pytest.raises(locfuse.LocfuseError) as caught:
            call()
        assert done.stderr.replace("--sensors", "sensors") == f"locfuse: {caught.value}\n"


BAD: dict[str, tuple[Callable[[locfuse.Session, locfuse.Comparison, Path], Any], str]] = {
    "configuration": (lambda s, r, p: r.estimates["compas"], "did you mean compass?"),
    "judgement": (lambda s, r, p: r.evaluations["all"], "There are: odometry, compass"),
    "verdict": (lambda s, r, p: r.verdicts["compss"], "did you mean compass?"),
    "align": (lambda s, r, p: s.run("odometry", align="left"), "choose from none, origin, se2"),
    "align of compare": (lambda s, r, p: s.compare(["odometry"], align="left"), "choose from none, origin, se2"),
    "align of evaluate": (
        lambda s, r, p: locfuse.evaluate(r.estimates["compass"], s.drive, "left"),
        "choose from none, origin, se2",
    ),
    "preset": (lambda s, r, p: locfuse.load(LOG, preset="papr"), "choose from default, paper"),
    "order": (lambda s, r, p: locfuse.load(LOG, order="up"), "choose from auto, stamp, recorded"),
    "no robot": (lambda s, r, p: locfuse.load(LOG, robot=p / "none.toml"), "locfuse init LOG > robot.toml"),
    "robot": (lambda s, r, p: locfuse.load(LOG, robot=p / "typo.toml"), "did you mean track"),
    "value": (lambda s, r, p: locfuse.load(LOG, sets={"lrf.topic": None}), "lrf.topic = None"),
    "no log": (lambda s, r, p: locfuse.load([]), "which log?"),
    "no logs": (lambda s, r, p: locfuse.compare(), "which log?"),  # type: ignore[call-overload]
    "open_log": (lambda s, r, p: locfuse.open_log("nosuch"), "no such log: nosuch"),
    "kind": (lambda s, r, p: r.write(p / "out", write="pdf"), "unknown output 'pdf'"),
    "export": (lambda s, r, p: r.write(p / "out", export="pdf"), "unknown format 'pdf'"),
    "folder": (lambda s, r, p: r.write(p), "is not empty and holds no locfuse result"),
    "map": (lambda s, r, p: s.with_map(p / "none.json"), "none.json: cannot be read"),
    "save_map": (lambda s, r, p: s.run("odometry").save_map(p / "m.json"), "only the laser has a map"),
    "scenario": (lambda s, r, p: locfuse.simulate("rounded_rectangel"), "did you mean rounded_rectangle?"),
    "scenario's key": (lambda s, r, p: locfuse.simulate(LOG, sets={"lrf.bems": 1}), "did you mean beams?"),
    "seed": (lambda s, r, p: locfuse.simulate(LOG, seed=-1), "seed = -1"),
    "one of several": (lambda s, r, p: locfuse.compare(LOG, p / "wheelless.mcap"), "wheelless"),
}


@pytest.mark.parametrize("what", BAD)
def test_anything_else_is_one_line_that_helps(
    session: locfuse.Session, result: locfuse.Comparison, files: Path, what: str
) -> None:
    call, says = BAD[what]
    with pytest.raises(locfuse.LocfuseError) as caught:
        call(session, result, files)
    assert says in str(caught.value)
    assert "\n" not in str(caught.value)


def test_results_by_name_are_a_mapping_like_any_other(result: locfuse.Comparison) -> None:
    assert "compass" in result.estimates
    assert "foo" not in result.estimates
    assert result.estimates.get("foo") is None
    assert list(result.estimates) == ["odometry", "compass"]
    with pytest.raises(KeyError):
        result.estimates["foo"]
