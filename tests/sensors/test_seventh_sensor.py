"""A sensor of another package is found by its entry point, and everything else follows by itself.

The beacon of tests/helpers/beacon.py is laid down as an installed package, a log is written that carries it, and
nothing else is touched.
"""

import json
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import beacon
import numpy as np
import pytest
import recordings
from commands import locfuse, ok
from trap_logs import TRUTH, Drive, numbers

from locfuse import LocfuseError, register
from locfuse.fusion.sensors import registry
from locfuse.fusion.sensors.registry import REGISTRY

PLACE = (4.0, 1.5)
NOISE = 0.05  # m
TOO_MUCH = 0.4  # m: what the radio measures too much, of which nobody was told


HELPERS = Path(beacon.__file__).parent


def package(
    folder: Path, value: str = "beacon:Beacon", name: str = "locfuse-beacon", code: str | None = None
) -> Path:
    """Lay down a package as pip does: its module, and its metadata with the entry point."""
    folder.mkdir(parents=True, exist_ok=True)
    module = value.partition(":")[0]
    code = (HELPERS / "beacon.py").read_text() if code is None else code
    (folder / f"{module}.py").write_text(code)
    info = folder / f"{name.replace('-', '_')}-0.3.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 0.3\n")
    (info / "entry_points.txt").write_text(f"[locfuse.sensors]\nbeacon = {value}\n")
    return folder


def in_a_process(*words: object, path: Path) -> subprocess.CompletedProcess[str]:
    """Run the command in a process of its own, with the packages of these folders."""
    command, env = (sys.executable, "-m", "locfuse", *map(str, words)), {**os.environ, "PYTHONPATH": str(path)}
    return subprocess.run(command, env=env, capture_output=True, text=True, check=False)


@pytest.fixture(scope="module", autouse=True)
def installed(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    folder = package(tmp_path_factory.mktemp("packages"))
    with pytest.MonkeyPatch.context() as patch:
        patch.delitem(sys.modules, "beacon")
        patch.syspath_prepend(folder)
        registry.register_installed()
        registry.register_installed()  # once is enough
        yield folder
        del REGISTRY["beacon"], registry.SOURCES["beacon"]
    sys.modules["beacon"] = beacon


def write(path: Path, error: float = 0.0) -> Path:
    """Write a short drive that a beacon measured too, `error` [m] too far."""
    drive = Drive()
    truth = drive.on(TRUTH)
    at = np.array([[m.fields["pose.position.x"], m.fields["pose.position.y"]] for m in truth])
    ranges = np.hypot(*(at - PLACE).T) + error + NOISE * np.random.default_rng(3).standard_normal(len(at))
    drive.add(numbers("/beacon/range", "Float32", truth, ranges.tolist()))
    return drive.record(path)


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write(tmp_path_factory.mktemp("beacon") / "beacon.mcap")


SET = ("--set", f"beacon.place=[{PLACE[0]}, {PLACE[1]}]")


@pytest.fixture(scope="module")
def compared(log: Path) -> Path:
    out = log.parent / "out"
    words = ("--sensors", "odometry", "--sensors", "beacon", "--sensors", "all")
    recording = ("--rerun-save", log.parent / "beacon.rrd")
    done = ok("compare", log, "-v", "--write", "all", *SET, "-o", out, *recording, *words)
    (log.parent / "stdout.txt").write_text(done.stdout)
    return out


def test_info_says_what_reads_it_and_init_asks_for_its_place(log: Path) -> None:
    done = locfuse("info", log)
    assert "not yet  beacon: beacon.place is not set" in done.stdout
    known = json.loads(locfuse("info", log, "--json", *SET).stdout)
    assert known["roles"]["beacon"]["topics"] == ["/beacon/range"]
    assert known["configurations"]["beacon"] is None
    done = locfuse("init", log)
    table = done.stdout.partition("[beacon]")[2].partition("\n[")[0]
    assert 'topic = "/beacon/range"' in table
    assert "Where the beacon stands" in table
    assert "beacon.place" in done.stderr


def test_compare_lists_it_it_helps_and_the_report_names_it_with_its_unit(compared: Path) -> None:
    rows = (compared.parent / "stdout.txt").read_text().splitlines()
    assert any(row.split()[:1] == ["beacon"] for row in rows)
    assert any(row.split()[:2] == ["all", "beacon"] for row in rows)
    report = json.loads((compared / "report.json").read_text())
    alone, without = (report["configurations"][name] for name in ("beacon", "odometry"))
    assert alone["sensors"]["beacon"]["accepted"] > 50
    assert alone["position_rmse_m"] < without["position_rmse_m"]
    page = (compared / "report.html").read_text()
    assert "beacon: innovation of range" in page
    assert "beacon range, m" in page
    assert REGISTRY["beacon"].colour.light in page
    assert "beacon" in (compared / "report.md").read_text()


def test_a_recording_names_it_with_its_unit(compared: Path) -> None:
    path = compared.parent / "beacon.rrd"
    drawn = recordings.read(path)
    assert "innovation/beacon/range/beacon" in drawn
    assert "nis/beacon/beacon" in drawn
    assert any(name.startswith("raw/beacon/range") for name in drawn)
    assert any(name.endswith("/landmark") for name in drawn)
    names = [str(v) for e in recordings.read_blueprint(path).values() for v in e.static.values()]
    assert any("beacon range [m]" in name for name in names)


def test_a_constant_error_is_named_with_the_key_that_takes_it_out(tmp_path: Path) -> None:
    """In metres: nothing is wrapped as an angle would be."""
    log, out = write(tmp_path / "far.mcap", TOO_MUCH), tmp_path / "out"
    done = ok("compare", log, *SET, "--set", "beacon.gate=1", "-o", out, "--write", "json")
    said = next(line for line in done.stdout.splitlines() if line.startswith("beacon: "))
    assert "on average" in said
    assert said.endswith(f"--set beacon.offset={TOO_MUCH}")


def test_a_process_of_its_own_finds_it_and_checks_its_settings(installed: Path, log: Path, tmp_path: Path) -> None:
    schema = json.loads(in_a_process("schema", "robot", path=installed).stdout)
    assert schema["$defs"]["BeaconSettings"]["properties"]["sigma"]["description"] == "m: noise of one range"
    done = in_a_process("run", log, "--set", "beacon.plaice=[1, 2]", path=installed)
    assert done.returncode == 2
    assert done.stderr.startswith("locfuse: unknown key beacon.plaice; did you mean place?")
    done = in_a_process("run", log, *SET, "--sensors", "beacon", "-o", tmp_path, "--no-advice", path=installed)
    assert done.returncode == 0, done.stderr
    made_with = json.loads((tmp_path / "run.json").read_text())["made_with"]
    assert made_with["beacon"] == "package locfuse-beacon 0.3 (beacon:Beacon)"


BROKEN = {
    "import nowhere": "ModuleNotFoundError: No module named 'nowhere'",
    "class Beacon: pass": "is no locfuse.Sensor",
    "from locfuse import Sensor\nclass Beacon(Sensor): pass": "TypeError: Can't instantiate abstract class Beacon",
    "import beacon_of_tests as b\nclass Beacon(b.Beacon): name = 'lrf'": "locfuse itself has a sensor lrf too",
    "import beacon_of_tests as b\nclass Beacon(b.Beacon): name = 'all'": "its name 'all' is reserved",
    "import beacon_of_tests as b\nclass Beacon(b.Beacon): noise_keys = ('sigmma',)": "sigmma, which is no setting",
}


@pytest.mark.parametrize("code", BROKEN, ids=list(BROKEN.values()))
def test_a_broken_package_is_a_line_with_a_fix(code: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = package(tmp_path, "broken_beacon:Beacon", "locfuse-broken", code)
    monkeypatch.setitem(sys.modules, "beacon_of_tests", beacon)
    monkeypatch.delitem(sys.modules, "broken_beacon", raising=False)
    monkeypatch.syspath_prepend(folder)
    before = list(REGISTRY)
    with pytest.raises(LocfuseError) as problem:
        registry.register_installed()
    words = str(problem.value)
    assert words.startswith("package locfuse-broken 0.3 (broken_beacon:Beacon): this sensor cannot be used: ")
    assert BROKEN[code] in words
    assert words.endswith("Update that package, or remove it: python -m pip uninstall locfuse-broken")
    assert "\n" not in words
    assert list(REGISTRY) == before


def test_a_process_with_a_broken_package_stops_in_one_line_but_helps(tmp_path: Path) -> None:
    package(tmp_path, code="1 / 0")
    done = in_a_process("info", "rounded_rectangle", path=tmp_path)
    assert done.returncode == 1
    assert "ZeroDivisionError" in done.stderr
    assert len(done.stderr.splitlines()) == 1
    assert in_a_process("--help", path=tmp_path).returncode == 0


def test_two_packages_with_one_sensor_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(package(tmp_path, "beacon_too:Beacon", "other-beacon"))
    with pytest.raises(LocfuseError, match=r"package locfuse-beacon 0\.3 .* has a sensor beacon too"):
        registry.register_installed()


def test_a_sensor_of_a_script_is_registered_by_a_call() -> None:
    class Here(beacon.Beacon):
        name = "here"

    with pytest.raises(LocfuseError, match="beacon too"):
        register(beacon.Beacon())
    register(Here)
    try:
        assert REGISTRY["here"].colour == beacon.Beacon.colour
    finally:
        del REGISTRY["here"], registry.SOURCES["here"]
