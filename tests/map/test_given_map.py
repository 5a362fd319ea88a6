"""A line map leaves one run and is given to another: the file, and localising in it."""

from __future__ import annotations

import json
import math

import msgspec
import numpy as np
import pytest
from msgspec.structs import replace
from worlds import World

from locfuse.formats.robot import line_map
from locfuse.fusion.data import LocfuseError, MapLine
from locfuse.fusion.fuse import fuse
from locfuse.fusion.judge.evaluate import evaluate
from locfuse.fusion.measure import measure
from locfuse.fusion.robot import StartSettings

P = np.array([[1e-4, -3e-5], [-3e-5, 2e-5]])
LINES = [MapLine(3, 2.0, 0.4, (-1.0, 2.5), P, 17), MapLine(8, -1.5, -3.0, (4.0, 4.5), P, 4)]


def test_a_map_survives_its_file() -> None:
    back = line_map.decode(line_map.encode(LINES), "map.json")
    for a, b in zip(LINES, back, strict=True):
        assert (a.id, a.hits) == (b.id, b.hits)
        assert (b.rho, math.cos(b.beta), math.sin(b.beta)) == pytest.approx(
            (a.rho, math.cos(a.beta), math.sin(a.beta))
        )
        assert b.ends == pytest.approx(a.ends)
        np.testing.assert_allclose(b.P, a.P, atol=1e-12)


def test_the_file_holds_points_on_the_walls() -> None:
    walls = json.loads(line_map.encode(LINES))["lines"]
    for line, wall in zip(LINES, walls, strict=True):
        for x, y in (wall["from"], wall["to"]):
            assert x * math.cos(line.beta) + y * math.sin(line.beta) == pytest.approx(line.rho)
        assert math.dist(wall["from"], wall["to"]) == pytest.approx(line.ends[1] - line.ends[0])


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("walls", "is not a line map"),
        ('{"format": "other", "version": 1, "lines": []}', "is not a line map"),
        ('{"format": "locfuse line map", "version": 9, "lines": []}', "version 9"),
        ('{"format": "locfuse line map", "version": 1, "lines": []}', "no lines"),
        (
            '{"format": "locfuse line map", "version": 1, "lines": [{"id": 1, "from": [1, 1], "to": [1, 1]}]}',
            "no length",
        ),
        (
            '{"format": "locfuse line map", "version": 1, "lines": '
            '[{"id": 1, "from": [1, 1], "to": [2, 1], "covariance": [[-1, 0], [0, 1]]}]}',
            "not symmetric and positive",
        ),
    ],
)
def test_what_is_no_map_is_refused_in_one_line(text: str, says: str) -> None:
    with pytest.raises(LocfuseError, match=says) as problem:
        line_map.decode(text, "map.json")
    assert "\n" not in str(problem.value)


def test_a_robot_localises_in_the_map_of_another_drive_and_leaves_it_as_it_is() -> None:
    first = World(seed=1)
    robot = first.robot()
    lines = fuse(measure(first.streams(), robot), robot, ["lrf"]).final_map
    second = World(seed=2, start=(2.0, 2.0, 0.5), settings={"lrf": {"map": "given"}})
    robot = second.robot()
    robot = replace(robot, lines=tuple(lines), start=replace_start(robot.start))
    drive = measure(second.streams(), robot)
    found = fuse(drive, robot, ["lrf"])
    figures = evaluate(found, drive).figures
    assert figures["position_rmse_m"] is not None
    assert figures["position_rmse_m"] < 0.02
    assert figures["anees"] is not None
    assert figures["anees"] < 2.5
    assert [line.rho for line in found.final_map] == pytest.approx([line.rho for line in lines], abs=1e-9)


def replace_start(start: StartSettings) -> StartSettings:
    return msgspec.structs.replace(start, sigma_xy=0.05, sigma_theta_deg=1.0)


def test_localising_in_no_map_says_what_is_missing() -> None:
    world = World(seconds=2.0, settings={"lrf": {"map": "given"}})
    robot = world.robot()
    with pytest.raises(LocfuseError, match="--map FILE"):
        fuse(measure(world.streams(), robot), robot, ["lrf"])
