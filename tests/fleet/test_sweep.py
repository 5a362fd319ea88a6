"""A sweep: the log is measured once, and a cell is what --set --no-advice would have given, bit for bit."""

from __future__ import annotations

from pathlib import Path

import pytest
from commands import locfuse as command

import locfuse
from locfuse.cli.session.sweep import cells, parse
from locfuse.fusion.data import UsageError
from locfuse.fusion.sensors.registry import REGISTRY

SETS = {"camera.enabled": False, "path.legs": [{"forward": 1.5}, {"turn_deg": 90}, {"forward": 1.0}]}


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("sweep") / "drive.mcap"
    locfuse.simulate("straight_runs", path, seed=3, sets=SETS)
    return path


def test_words_and_combinations() -> None:
    found = parse(["lrf.sigma_range=0.01,0.03", "lrf.map=grow", "truth.x=[1,2],{a=1,b=2}"])
    assert found["lrf.sigma_range"] == ["lrf.sigma_range=0.01", "lrf.sigma_range=0.03"]
    assert found["truth.x"] == ["truth.x=[1,2]", "truth.x={a=1,b=2}"]
    assert list(cells({"a.b": ["a.b=1", "a.b=2"], "c": ["c=3"]})) == ["a.b=1 c=3", "a.b=2 c=3"]
    with pytest.raises(UsageError, match="more than 1000"):
        cells({str(i): [f"{i}={v}" for v in range(11)] for i in range(3)})
    with pytest.raises(UsageError, match="cannot name a folder"):
        cells({"a": ["a=../x"]})
    with pytest.raises(UsageError, match="twice"):
        parse(["a=1", "a=2"])


@pytest.mark.parametrize(
    ("key", "value", "again"),
    [
        ("lrf.sigma_range", 0.05, {"lrf"}),
        ("compass.time_offset", 0.02, {"compass"}),
        ("wheels.track", 0.61, {"compass", "lrf"}),
        ("start.x", 0.1, set()),
    ],
)
def test_a_cell_is_what_set_gives_and_only_what_changed_is_measured_again(
    log: Path, key: str, value: float, again: set[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    session = locfuse.load(log)
    direct = locfuse.load(log, sets={key: value}).compare(advice=False)
    measured: set[str] = set()
    for name, sensor in REGISTRY.items():
        real = sensor.measure

        def counted(*args: object, _real: object = real, _name: str = name, **kwargs: object) -> object:
            measured.add(_name)
            return _real(*args, **kwargs)  # type: ignore[operator]

        monkeypatch.setattr(sensor, "measure", counted)
    found = session.with_settings({key: value}).compare(advice=False)
    assert measured == again
    assert found.report == direct.report
    assert found.report["key"] is not None


def test_the_command_writes_a_folder_for_each_cell(log: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    words = ("--write", "json,csv", "--sweep", "lrf.sigma_range=0.01,0.05", "--sweep", "compass.sigma_deg=2")
    done = command("compare", log, *words, "-o", out)
    assert done.exit_code == 0, done.stderr
    folder = out / "drive" / "lrf.sigma_range=0.05,compass.sigma_deg=2"
    sets = ("--set", "lrf.sigma_range=0.05", "--set", "compass.sigma_deg=2")
    alone = ("--no-advice", "--no-smooth", "-o", tmp_path / "one", "--write", "json")
    assert command("compare", log, *sets, *alone).exit_code == 0
    assert (folder / "report.json").read_bytes() == (tmp_path / "one" / "report.json").read_bytes()
    header, *lines = (out / "summary.csv").read_text().splitlines()
    assert "lrf.sigma_range,compass.sigma_deg" in header
    assert len(lines) == 2 * 4
    # the same folder takes a comparison without a sweep, but none that holds files of somebody else
    other = tmp_path / "other.mcap"
    other.write_bytes(log.read_bytes())
    plain = ("compare", log, other, "--sensors", "odometry", "--write", "json", "-o", out)
    (out / "drive" / "notes.txt").write_text("mine")
    refused = command(*plain)
    assert "drive is not empty and holds no locfuse result" in refused.stderr
    (out / "drive" / "notes.txt").unlink()
    done = command(*plain)
    assert done.exit_code == 0, done.stderr
    assert (out / "drive" / "report.json").is_file()


def test_python_sweeps_too(log: Path) -> None:
    found = locfuse.load(log).sweep({"lrf.sigma_range": [0.01, 0.05]}, ["lrf"])
    assert list(found) == ["lrf.sigma_range=0.01", "lrf.sigma_range=0.05"]
    errors = [r.evaluations["lrf"].figures["position_rmse_m"] for r in found.values()]
    assert errors[0] != errors[1]
    with pytest.raises(UsageError, match=r"lrf\.topic decides what is read"):
        locfuse.load(log).with_settings({"lrf.topic": "/scan"})
