"""The schemas of robot.toml, report.json and --json, by an independent validator and by what the readers do."""

import json
import tomllib
from functools import cache
from pathlib import Path
from typing import Any

import msgspec
import pytest
from commands import locfuse, ok, refused, reported
from hostile import write
from mcap.reader import make_reader
from rewrite_log import rewritten

from locfuse import sample_logs
from locfuse.cli.analysis.robot_tables import make_robot, table_types
from locfuse.cli.inspect.json_schema import SCHEMAS
from locfuse.fusion.data import LocfuseError

jsonschema = pytest.importorskip("jsonschema")
ROOT = Path(__file__).parents[2]
ROBOTS = sorted(ROOT.glob("robots/*.toml"))


@cache
def printed(what: str) -> dict[str, Any]:
    done = ok("schema", what)
    found: dict[str, Any] = json.loads(done.stdout)
    jsonschema.Draft7Validator.check_schema(found)
    return found


def problems(what: str, value: Any) -> list[str]:
    return [e.message for e in jsonschema.Draft7Validator(printed(what)).iter_errors(value)]


def attached(name: str) -> dict[str, Any]:
    """The robot.toml that a sample log carries."""
    with sample_logs.path(name).open("rb") as file:
        return next(tomllib.loads(a.data.decode()) for a in make_reader(file).iter_attachments())


@pytest.mark.parametrize("path", ROBOTS, ids=lambda p: p.stem)
def test_every_robot_toml_of_the_repository_is_valid(path: Path) -> None:
    assert problems("robot", tomllib.loads(path.read_text(encoding="utf-8"))) == []


def test_robots_inside_logs_and_those_that_init_and_run_write_are_valid(tmp_path: Path) -> None:
    for name in sample_logs.names():
        assert problems("robot", attached(name)) == []
    written = locfuse("init", "disturbed").stdout
    assert written.startswith("#:schema ./robot.schema.json\n")
    assert problems("robot", tomllib.loads(written)) == []
    locfuse("run", "rounded_triangle", "--sensors", "compass", "--write", "json", "--no-advice", "-o", tmp_path)
    assert problems("robot", tomllib.loads((tmp_path / "robot.toml").read_text())) == []


@pytest.mark.parametrize(
    "tables",
    [
        {"wheels": {"radus": 0.1}},
        {"wheels": {"radius": "0.1"}},
        {"wheels": {"mirrored": "up"}},
        {"start": {"sigma_xy": -1.0}},
        {"lrf": {"map": "growing"}},
        {"compass": {"hard_iron": [1.0]}},
        {"order": "random"},
        {"lidar": {}},
        {"lrf": 3},
    ],
    ids=str,
)
def test_what_the_reader_refuses_the_schema_refuses_too(tables: dict[str, Any]) -> None:
    with pytest.raises(LocfuseError):
        make_robot(tables)
    assert problems("robot", tables)


def test_every_key_has_its_default_or_none_and_most_have_words() -> None:
    schema = SCHEMAS["robot"]()
    described = total = 0
    for kind in table_types().values():
        properties = schema["$defs"][kind.__name__]["properties"]
        for field in msgspec.structs.fields(kind):
            shown = properties[field.encode_name]
            default = None if field.default is msgspec.NODEFAULT else msgspec.to_builtins(field.default)
            if field.default_factory is msgspec.NODEFAULT:
                assert shown.get("default") == default, field.name
            described, total = described + ("description" in shown), total + 1
    assert described > 0.75 * total
    track = schema["$defs"]["WheelSettings"]["properties"]["track"]
    assert track["description"].startswith("m between the wheels")


def test_real_reports_are_valid_with_and_without_truth(tmp_path: Path) -> None:
    words = ("--sensors", "odometry", "--sensors", "compass", "--smooth", "--to", "30")
    report = reported("compare", "rounded_triangle", *words).report
    assert problems("report", report) == []
    nameless = rewritten(tmp_path / "log.mcap", None, "/ground_truth/pose", "rounded_triangle")
    for log in ("rounded_triangle", nameless):
        run = reported("run", log, "--no-advice", "--sensors", "compass", "--to", "20").report
        assert (run["truth"] is None) == (log == nameless)
        assert problems("report", run) == []
    broken = {**report, "configurations": {"odometry": {"anees": "1"}}, "schema_version": 2}
    assert len(problems("report", broken)) >= 2


OUTPUTS: dict[str, list[tuple[str, ...]]] = {  # what prints JSON -> words
    "info": [
        ("info", "rounded_triangle", "--json"),
        ("info", "labyrinth", "--json"),
        ("info", "disturbed", "--topics", "--json"),
        ("info", "rounded_triangle", "--set", "wheels.topic=/nowhere", "--json", "--check"),
        ("info", "rounded_triangle", "--json", "--check", "--set", "camera.topic=none", "--set", "lrf.topic=none"),
    ],
    "tune": [("tune", "SHORT", "--sensors", "compass", "--json")],
    "calibrate": [
        ("calibrate", "rounded_triangle", "--json"),
        ("calibrate", "rounded_triangle", "--set", "truth.topic=none", "--json"),
    ],
}


@pytest.mark.parametrize(
    ("what", "words"), [(w, words) for w, found in OUTPUTS.items() for words in found], ids=str
)
def test_what_commands_print_as_json_is_valid(what: str, words: tuple[str, ...], tmp_path: Path) -> None:
    short = write(tmp_path / "short.mcap", seconds=5.0)
    done = locfuse(*(short if word == "SHORT" else word for word in words))
    assert done.exit_code in {0, 3}, done.stderr
    value = json.loads(done.stdout)
    assert problems(what, value) == []
    defined = printed(what)["$defs"]
    assert set(value) <= set(defined[f"{what.capitalize()}Output"]["properties"])
    assert sum("description" in p for d in defined.values() for p in d["properties"].values()) >= 7
    for key in set(value) - {"tried"}:  # the schema notices what is missing, and what is of another kind
        assert problems(what, {k: v for k, v in value.items() if k != key}), key
        assert problems(what, {**value, key: object}), key


def test_a_word_that_is_no_schema_is_one_line() -> None:
    assert "robot" in refused("schema", "robots", code=2)
