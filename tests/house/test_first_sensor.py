"""The page on a first sensor: its code, typed in as it stands, is a sensor."""

from __future__ import annotations

import contextlib
import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from commands import locfuse

from locfuse.fusion.data import ArrayStream
from locfuse.fusion.sensors.registry import REGISTRY

PAGE = (Path(__file__).parents[2] / "docs" / "first_sensor.md").read_text(encoding="utf-8")
MAKE_LOG, SENSOR, READINGS = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)


def test_its_log_and_its_sensor_give_a_verdict_and_its_noise(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    typed: dict[str, Any] = {"__name__": "cable"}
    with contextlib.chdir(tmp_path):
        exec(compile(MAKE_LOG, "make_log.py", "exec"), {})
        exec(compile(SENSOR, "cable.py", "exec"), typed)
    monkeypatch.setitem(REGISTRY, "cable", typed["Cable"]())
    log, post = tmp_path / "cable.mcap", ("--set", "cable.post=[4, 2]")
    words = ("--sensors", "odometry", "--sensors", "cable", "--write", "json", "-o", tmp_path / "out")
    done = locfuse("compare", log, *post, *words)
    assert done.exit_code == 0, done.stderr
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    rows = report["configurations"]
    assert rows["cable"]["position_rmse_m"] < 0.5 * rows["odometry"]["position_rmse_m"]
    assert report["settings"]["cable"]["sigma"] == 0.05
    assert 0.5 < rows["cable"]["sensors"]["cable"]["consistency"]["scale"] < 0.7  # 3 cm are true, 5 are set
    assert "cable.post is not set" in locfuse("info", log).stdout


def test_its_readings_for_the_contract_are_lengths() -> None:
    typed: dict[str, Any] = {"np": np, "ArrayStream": ArrayStream}
    exec(compile(READINGS, "six_sensors.py", "exec"), typed)
    fields = {"pose.position.x": np.array([4.0, 7.0]), "pose.position.y": np.array([2.0, 6.0])}
    stream = typed["cable"](ArrayStream("/truth", "geometry_msgs/msg/PoseStamped", np.array([0, 1]), fields))
    assert stream.columns("data")["data"].tolist() == [0.0, 5.0]
