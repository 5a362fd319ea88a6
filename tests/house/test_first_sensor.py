"""The page on a first sensor: its package, typed in as it stands and installed, is a sensor."""

from __future__ import annotations

import contextlib
import json
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from commands import locfuse, ok

from locfuse.fusion.data import ArrayStream
from locfuse.fusion.sensors.registry import REGISTRY, SOURCES, register_installed

PAGE = (Path(__file__).parents[2] / "docs" / "first_sensor.md").read_text(encoding="utf-8")
(PYPROJECT,) = re.findall(r"```toml\n(.*?)```", PAGE, re.DOTALL)
MAKE_LOG, SENSOR, READINGS = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)


def test_its_log_and_its_sensor_give_a_verdict_and_its_noise(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "pyproject.toml").write_text(PYPROJECT)
    (tmp_path / "locfuse_cable.py").write_text(SENSOR)
    words = ("install", "-q", "--no-deps", "--no-build-isolation", "--target", tmp_path / "installed", tmp_path)
    subprocess.run([sys.executable, "-m", "pip", *map(str, words)], check=True)
    monkeypatch.syspath_prepend(tmp_path / "installed")
    register_installed()
    try:
        _has_a_verdict_and_its_noise(tmp_path)
        assert SOURCES["cable"] == "package locfuse-cable 0.1 (locfuse_cable:Cable)"
    finally:
        del REGISTRY["cable"], SOURCES["cable"]


def _has_a_verdict_and_its_noise(tmp_path: Path) -> None:
    with contextlib.chdir(tmp_path):
        exec(compile(MAKE_LOG, "make_log.py", "exec"), {})
    log, post = tmp_path / "cable.mcap", ("--set", "cable.post=[4, 2]")
    words = ("--sensors", "odometry", "--sensors", "cable", "--write", "json", "-o", tmp_path / "out")
    ok("compare", log, *post, *words)
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
