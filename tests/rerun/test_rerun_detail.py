"""Long drives stay light, `full` leaves nothing out, and no scene is too poor to be drawn."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest
from msgspec.structs import replace
from recordings import read, read_blueprint
from small_drive import drive as small_drive
from small_drive import robot as small_robot

from locfuse.formats.rerun.recording import save_recording, unfolded
from locfuse.formats.rerun.scene import Detail, RawTopic, RerunScene, SensorLook
from locfuse.formats.rerun.series import reading_states, thinned_states
from locfuse.formats.rerun.style import STATES
from locfuse.fusion.data import (
    VERDICTS,
    Audit,
    Component,
    Drive,
    Estimates,
    Measurements,
    Motions,
    upper_triangles,
)
from locfuse.fusion.fuse import fuse
from locfuse.fusion.judge.evaluate import evaluate

N = 30_000
SIGHTS: Mapping[str, SensorLook] = {
    "compass": SensorLook((Component("heading", "deg", 57.3),), (0.001, 5.02), "heading"),
    "lrf": SensorLook((Component("r", "m"), Component("psi", "deg", 57.3)), (0.05, 7.38), "segments"),
}


def long_scene(epoch_ns: int = 1_700_000_000_000_000_000) -> RerunScene:
    """A compass that speaks 30 000 times on a long spiral."""
    rng = np.random.default_rng(3)
    t = np.linspace(0.0, 0.1 * (N - 1), N)
    turn = t * 0.01
    pose = np.column_stack((turn * np.cos(turn), turn * np.sin(turn), turn))
    heading = Measurements(t, np.arange(N + 1), pose[:, 2:], np.ones((N, 1, 1)), 0.02, np.zeros((1, 1)))
    still = Motions(np.zeros((N, 3)), np.zeros((N, 3, 3)), np.zeros((N, 3, 0)))
    drive = Drive(epoch_ns, t, still, {"compass": heading}, {"compass": np.arange(N)}, {})
    y = rng.normal(size=(N, 1))
    rows = np.arange(N)
    verdict = np.zeros(N, np.int8)
    audit = Audit(rows, rows, verdict, np.full(N, -1), y[:, 0] ** 2, np.full(N, 10.8), y, np.ones((N, 1)))
    triangles = np.broadcast_to(upper_triangles(np.diag([1e-4, 4e-4, 1e-4])), (N, 6))
    estimates = Estimates("compass", ("compass",), t, pose, triangles, {"compass": audit})
    raw = [RawTopic("/imu/heading", t, {"data": pose[:, 2]})]
    return RerunScene("long", drive, [estimates], {}, SIGHTS, raw=raw)


def test_a_long_drive_is_thinned_and_full_keeps_everything(tmp_path: Path) -> None:
    scene = long_scene()
    save_recording(tmp_path / "light.rrd", scene)
    light = read(tmp_path / "light.rrd")
    rows = {path: len(e.ns) for path, e in light.items() if e.parts}
    assert max(rows.values()) <= 4000
    assert rows["world/compass/pose"] == 4000
    assert rows["world/compass/seen/compass/matched"] == 2000
    assert rows["nis/compass/compass"] > 3500
    save_recording(tmp_path / "full.rrd", replace(scene, detail=Detail.everything()))
    full = read(tmp_path / "full.rrd")
    for path in ("world/compass/pose", "nis/compass/compass", "raw/imu/heading/data"):
        assert len(full[path].ns) == N
    assert len(full["world/compass/seen/compass/matched"].ns) == N
    assert (tmp_path / "light.rrd").stat().st_size < 0.25 * (tmp_path / "full.rrd").stat().st_size
    high = max(light["nis/compass/compass"].array("Scalars:scalars"))
    assert high == max(full["nis/compass/compass"].array("Scalars:scalars"))  # the worst one survives


def test_a_clock_that_counts_from_the_robots_start_is_shown_as_a_duration(tmp_path: Path) -> None:
    save_recording(tmp_path / "boot.rrd", long_scene(epoch_ns=5_000_000_000))
    pose = read(tmp_path / "boot.rrd")["world/compass/pose"]
    assert str(pose.parts[0].column("log time").type) == "duration[ns]"
    assert pose.ns[0] == 5_000_000_000


def test_a_drive_without_truth_and_without_sensors_is_drawn(tmp_path: Path) -> None:
    robot = small_robot()
    drive = small_drive(1, robot, sensors=(), laps=0.1, truth=False)
    estimates = fuse(drive, robot, [])
    save_recording(
        tmp_path / "poor.rrd", RerunScene("poor", drive, [estimates], {"odometry": evaluate(estimates, drive)})
    )
    entities = read(tmp_path / "poor.rrd")
    assert {"world/odometry/pose", "world/odometry/path", "world/odometry/sigma"} <= set(entities)
    assert not any(path.startswith(("deviation", "nis", "gate", "camera")) for path in entities)
    views = [e for e in read_blueprint(tmp_path / "poor.rrd").values() if "ViewBlueprint:display_name" in e.static]
    assert [e.static["ViewBlueprint:display_name"] for e in views] == [[["Map"]]]


def test_names_that_are_grammar_to_rerun_are_drawn(tmp_path: Path) -> None:
    robot = small_robot()
    drive = small_drive(1, robot, laps=0.1)
    estimates = [fuse(drive, robot, ["compass", "lrf"], name) for name in ("compass+lrf", "lrf@2Hz", "ä b")]
    raw = [RawTopic("/a b/[x]", drive.t, {"field.0": drive.t})]
    save_recording(tmp_path / "odd.rrd", RerunScene("a/b: c", drive, estimates, {}, SIGHTS, raw=raw))
    entities = read(tmp_path / "odd.rrd")
    assert {"world/compass\\+lrf/path", "world/lrf\\@2Hz/path", "world/ä\\ b/path"} <= set(entities)
    assert "raw/a\\ b/\\[x\\]/field.0" in entities


def test_a_sensor_nobody_described_still_gets_its_curves(tmp_path: Path) -> None:
    save_recording(tmp_path / "new.rrd", replace(long_scene(), sights={}))
    entities = read(tmp_path / "new.rrd")
    assert {"innovation/compass/y0/compass", "nis/compass/compass", "gate/compass/compass"} <= set(entities)
    assert not any("/seen/" in path for path in entities)


def audit_of(rows: list[int], verdicts: list[str]) -> Audit:
    k = len(rows)
    codes = np.array([VERDICTS.index(v) for v in verdicts], np.int8)
    nothing = np.full(k, np.nan)
    return Audit(
        np.zeros(k, int),
        np.array(rows),
        codes,
        np.zeros(k, int),
        nothing,
        nothing,
        np.zeros((k, 2)),
        np.zeros((k, 2)),
    )


def test_a_reading_is_as_good_as_what_became_of_its_parts() -> None:
    m = Measurements(
        np.arange(5.0), np.array([0, 2, 4, 5, 5, 6]), np.zeros((6, 2)), np.zeros((6, 2, 2)), 1.0, np.eye(2)
    )
    audit = audit_of(range(6), ["accepted", "accepted", "accepted", "gate", "ambiguous", "new"])  # type: ignore[arg-type]
    names = list(STATES)
    assert [names[c] for c in reading_states(m, audit)] == ["accepted", "partly", "rejected", "absent", "new"]


def test_a_stretch_of_states_that_is_drawn_as_one_shows_its_worst() -> None:
    names = list(STATES)
    code = np.tile([names.index("accepted"), names.index("new")], 5000)
    code[7321] = names.index("rejected")
    thin = thinned_states(code, 100)
    assert len(thin.code) == 100
    assert [names[c] for c in thin.code].count("rejected") == 1
    at = int(np.flatnonzero(thin.code == names.index("rejected"))[0])
    assert thin.reading[at] <= 7321 < thin.reading[at + 1]
    few = np.zeros(10_000, int)
    assert len(thinned_states(few, 100).code) == 10_000  # no change, nothing to thin


@pytest.mark.parametrize("tag", ["<details>", "</details>", "<summary>"])
def test_the_viewer_gets_markdown_without_tags(tag: str) -> None:
    table = unfolded("a\n\n<details><summary>More</summary>\n\n| b |\n</details>\n")
    assert tag not in table
    assert "### More" in table
