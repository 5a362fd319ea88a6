"""An agent's program, by the SDK's own client: questions answered from tool outputs alone, and what is refused."""

import asyncio
import json
import os
import re
import shutil
import subprocess
import sys
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from commands import refused
from hostile import write

from locfuse import sample_logs
from locfuse.cli.analysis.settings import Asked
from locfuse.cli.commands import mcp as mcp_command
from locfuse.cli.commands.mcp import Tools, served
from locfuse.cli.inspect.json_schema import SCHEMAS
from locfuse.fusion.data import LocfuseError

jsonschema = pytest.importorskip("jsonschema")
SAMPLES = sample_logs.path("rounded_rectangle").parent
DATA = os.environ.get("LOCFUSE_DATA")


def asked(tools: Tools, name: str, **words: Any) -> dict[str, Any]:
    """Ask by the SDK's client, in memory. Its output is held to the schema that the tool promises."""
    mcp = pytest.importorskip("mcp")

    async def ask() -> Any:
        async with mcp.Client(served(tools)) as client:
            return await client.call_tool(name, words), await client.list_tools()

    done, listed = asyncio.run(ask())
    words_of = " ".join(part.text for part in done.content)
    if done.is_error:
        raise LocfuseError(words_of)
    answer: dict[str, Any] = done.structured_content
    (schema,) = (tool.output_schema for tool in listed.tools if tool.name == name)
    jsonschema.validate(answer, schema)
    assert len(json.dumps(answer)) < 12_000  # short: arrays are in files
    return answer


@pytest.fixture(scope="module")
def tools(tmp_path_factory: pytest.TempPathFactory) -> Tools:
    folder = tmp_path_factory.mktemp("logs")
    for name in sample_logs.names():
        shutil.copy(sample_logs.path(name), folder)  # its bytes: where locfuse lies it may be a link
    return Tools([folder], tmp_path_factory.mktemp("results"))


@pytest.fixture
def nothing_tried(monkeypatch: pytest.MonkeyPatch) -> None:
    """For questions that no fix answers: `compare` tries none."""
    monkeypatch.setattr(mcp_command, "Asked", partial(Asked, advice=False))


def test_the_logs_are_listed_and_what_is_in_one_is_valid(tools: Tools) -> None:
    listed = asked(tools, "info")["values"]["bytes"]
    assert {Path(name).stem for name in listed} == set(sample_logs.names())
    answer = asked(tools, "info", log="labyrinth.mcap")
    assert "ranges" in answer["values"]["roles"]
    jsonschema.Draft7Validator(SCHEMAS["info"]()).validate(json.loads(Path(answer["files"][0]).read_text()))


@pytest.mark.usefixtures("nothing_tried")
def test_which_sensor_is_kept_and_which_adds_nothing(tools: Tools) -> None:
    answer = asked(tools, "compare", log="rounded_rectangle.mcap")
    assert answer["headline"].startswith("Keep the laser (lrf): 3.9 mm")
    assert re.search(r"compass and the camera add nothing", answer["headline"])
    assert answer["values"]["configurations"]["lrf"]["position_rmse_m"] == pytest.approx(0.0039, abs=1e-4)
    (report,) = (Path(file) for file in answer["files"] if file.endswith("report.json"))
    jsonschema.Draft7Validator(SCHEMAS["report"]()).validate(json.loads(report.read_text()))


def test_tuning_and_calibrating_write_files_that_are_valid(tools: Tools, tmp_path: Path) -> None:
    short = Tools([write(tmp_path / "short.mcap", seconds=5.0).parent], tmp_path / "results")
    for name, of, log, words in (
        ("calibrate", tools, "rounded_triangle.mcap", {}),
        ("tune", short, "short.mcap", {"sensors": "compass"}),
    ):
        answer = asked(of, name, logs=[log], **words)
        robot, values = map(Path, answer["files"])
        jsonschema.Draft7Validator(SCHEMAS[name]()).validate(json.loads(values.read_text()))
        assert "[wheels]" in robot.read_text()
        assert answer["values"]["settings"]["wheels"]["noise"] > 0.0


def test_words_are_explained(tools: Tools) -> None:
    assert "1" in asked(tools, "explain", term="ANEES")["headline"]
    assert "LaserScan" in asked(tools, "explain", term="lrf")["headline"]
    with pytest.raises(LocfuseError, match="no such term: anes"):
        asked(tools, "explain", term="anes")


def test_which_sensor_lost_its_way_where_and_when(tools: Tools) -> None:
    answer = asked(tools, "compare", log="disturbed.mcap", sensors=["compass"])
    (iron,) = (f["message"] for f in answer["findings"] if f["role"] == "compass")
    assert "iron near (6.1, 2.2) m" in iron
    first, last = map(float, re.findall(r"between (\d+\.\d) s and (\d+\.\d) s", iron)[0])
    assert 9.0 < first < last < 22.0  # the motor runs in these seconds (sample_logs/disturbed.toml)
    assert last - first > 5.0
    assert 'settings={"compass.field_tolerance": 0.05, "compass.sigma_deg": 11}' in iron


@pytest.fixture(scope="module")
def real(tmp_path_factory: pytest.TempPathFactory) -> Tools:
    if DATA is None:
        pytest.skip("LOCFUSE_DATA is not set: no real logs to try")
    return Tools([Path(DATA)], tmp_path_factory.mktemp("results"))


BRENNER = {"wheels.radius": 0.0199962, "wheels.track": 0.173}
FOUND = {  # log -> settings; role, code and a fix of a finding, its value and how far it may move
    "whose clock is off": ("fr079/fr079.mcap", {}, "wheels", "lag", "wheels.time_offset", 0.13, 0.01),
    "how late are the scans": ("brenner/brenner.mcap", BRENNER, "lrf", "lag", "lrf.time_offset", -0.45, 0.045),
    "scale": ("brenner/brenner.mcap", BRENNER, "lrf", "range scale", "lrf.range_scale", 1 / 0.89, 0.02),
}


@pytest.mark.parametrize("question", FOUND)
def test_clock_and_scale_are_findings_with_their_fix(real: Tools, question: str) -> None:
    log, settings, role, code, key, value, tolerance = FOUND[question]
    answer = asked(real, "info", log=log, settings=settings)
    (fixes,) = (f["fixes"] for f in answer["findings"] if (f["role"], f["code"]) == (role, code))
    found = dict(fix.split("=") for fix in fixes)
    assert float(found[key]) == pytest.approx(value, abs=tolerance)


@pytest.mark.usefixtures("nothing_tried")
def test_how_a_laser_is_yawed(real: Tools) -> None:
    answer = asked(real, "compare", log="strangers/pimouse.bag", sensors=["lrf"], smooth=False)
    (words,) = (note for note in answer["values"]["notes"] if "seems to sit" in note)
    assert float(re.findall(r"yaw_deg (-?[\d.]+)", words)[0]) == pytest.approx(-2.2, abs=0.2)


@pytest.mark.usefixtures("nothing_tried")
def test_which_sensor_is_kept_among_landmarks_and_how_its_ranges_are_meant(real: Tools) -> None:
    files = {"landmarks.file": "mrclam/detections.csv", "landmarks.map": "mrclam/landmarks.csv"}
    start = {"start.x": 1.426, "start.y": -3.905, "start.theta_deg": 134.8, "wheels.time_offset": 0.19}
    answer = asked(real, "compare", log="mrclam/mrclam.mcap", settings={**files, **start})
    assert re.search(r"[Kk]eep the landmarks", answer["headline"])
    assert any("depth" in note for note in answer["values"]["notes"])


@pytest.mark.usefixtures("nothing_tried")
def test_whether_a_causal_result_is_to_be_trusted_and_what_is_better(real: Tools) -> None:
    values = asked(real, "compare", log="halls/edmonton.mcap", sensors=["lrf"], smooth=True)["values"]
    assert not values["void"]
    assert "Use lrf-smoothed" in values["path_doubted"]  # loops are closed only in the smoothed path
    agreement = {name: v["revisit_agreement"] for name, v in values["configurations"].items()}
    assert agreement["lrf-smoothed"] > agreement["lrf"]


def test_strangers_setpoints_are_not_to_be_used(real: Tools) -> None:
    answer = asked(real, "info", log="strangers/setpoints.bag")
    assert answer["values"]["severe"]
    assert any("setpoint" in f["message"] for f in answer["findings"])


def test_errors_and_fixes_name_arguments_of_the_tools(real: Tools) -> None:
    with pytest.raises(LocfuseError, match=r'settings=\{"wheels\.radius": <metres>'):
        asked(real, "compare", log="uwb/labyrinth_uwb.mcap")
    answer = asked(real, "info", log="brenner/brenner.mcap", settings=BRENNER)
    assert any('settings={"lrf.walls": "flat"}' in f["message"] for f in answer["findings"])


def outside(folder: Path) -> list[str]:
    """Ways out of a folder that an agent may try."""
    logs = folder / "logs"
    logs.mkdir()
    (logs / "link.mcap").symlink_to(sample_logs.path("rounded_triangle"))
    (logs / "bag").mkdir()
    (logs / "bag" / "part.mcap").symlink_to(sample_logs.path("rounded_triangle"))
    (logs / "up").symlink_to(SAMPLES, target_is_directory=True)
    (folder / "beside.mcap").write_bytes(sample_logs.path("rounded_triangle").read_bytes())
    inside = ("link.mcap", "bag", "up", "up/rounded_triangle.mcap", "../beside.mcap", "bag/../../beside.mcap")
    return [*inside, str(folder / "beside.mcap"), "rounded_triangle", "s3://bucket/a.mcap", "\0", "/etc/passwd"]


def test_nothing_outside_the_folders_is_read(tmp_path: Path) -> None:
    ways = outside(tmp_path)
    tools = Tools([tmp_path / "logs"], tmp_path / "out")
    for way in ways:
        for call in (tools.info, tools.compare, lambda log: tools.tune([log]), lambda log: tools.calibrate([log])):
            with pytest.raises(LocfuseError, match="not below the folders that this server may read"):
                call(way)
    assert tools.info().values == {"bytes": {}}  # a link out of the folder is not listed


def test_settings_name_no_file_outside(tools: Tools, tmp_path: Path) -> None:
    secret = tmp_path / "secret.csv"
    secret.write_text("1,2,3\n")
    (tmp_path / "secret").write_text("1")
    for settings in (
        {"truth.topic": str(secret)},
        {"landmarks.map": "../secret.csv"},
        {"landmarks": {"map": str(tmp_path / "secret")}},
        {"truth.topic": str(tmp_path / "secret")},
    ):
        with pytest.raises(LocfuseError, match="the folders that this server may read"):
            tools.info("rounded_triangle.mcap", settings)


def test_without_the_sdk_the_command_is_one_line_and_nothing_else_imports_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "mcp.server.mcpserver", None)
    monkeypatch.setitem(sys.modules, "mcp", None)
    assert "python -m pip install locfuse[mcp]" in refused("mcp", tmp_path, "-o", tmp_path / "out")
    code = "import sys; from locfuse.cli.commands import mcp; assert 'mcp' not in sys.modules"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
