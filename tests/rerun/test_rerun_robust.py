"""No display, no viewer, a stranger's port, a full disk: the run completes, one warning, no hang."""

import json
import os
import shutil
import socketserver
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from commands import locfuse, ok, refused
from recordings import read
from small_drive import drive as small_drive, robot as small_robot
from trap_logs import Drive

from locfuse.cli.rerun import viewer
from locfuse.formats.rerun.recording import check, save_recording
from locfuse.formats.rerun.scene import RerunScene
from locfuse.fusion.data import LocfuseError
from locfuse.fusion.fuse import fuse

LOG = "rounded_triangle"
LIGHT = ("--sensors", "odometry", "--write", "json")


@pytest.fixture(autouse=True)
def lonely(monkeypatch: pytest.MonkeyPatch) -> int:
    """No display, and a port where no viewer is."""
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    port = viewer.free_port(0)
    monkeypatch.setattr(viewer, "PORT", port)
    monkeypatch.setattr(viewer, "LOCAL_VIEWER", f"rerun+http://127.0.0.1:{port}/proxy")
    return port


def poor_scene() -> RerunScene:
    robot = small_robot()
    drive = small_drive(1, robot, sensors=(), laps=0.2, truth=False)
    return RerunScene("poor", drive, [fuse(drive, robot, [])], {})


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("whole") / "whole.rrd"
    save_recording(path, poor_scene())
    return path


@pytest.fixture(params=["silent", "rude"])
def stranger(lonely: int, request: pytest.FixtureRequest) -> Iterator[None]:
    """Somebody else's server on the viewer's port: it never answers, or hangs up."""
    with socketserver.TCPServer(("127.0.0.1", lonely), socketserver.BaseRequestHandler) as server:
        if request.param == "silent":
            yield
            return
        threading.Thread(target=server.serve_forever).start()
        yield
        server.shutdown()


def warnings_of(stderr: str) -> list[str]:
    return [line for line in stderr.splitlines() if line.startswith("warning: rerun: ")]


def test_without_display_and_viewer_the_recording_lies_with_the_results(tmp_path: Path) -> None:
    done = ok("run", LOG, "--no-advice", *LIGHT, "-o", tmp_path / "out", "--rerun")
    (warning,) = warnings_of(done.stderr)
    assert "no display" in warning
    assert "locfuse view" in warning
    assert "world/odometry/pose" in read(tmp_path / "out" / "recording.rrd")
    assert json.loads((tmp_path / "out" / "run.json").read_text())["configurations"]


@pytest.mark.usefixtures("stranger")
def test_a_stranger_on_the_port_costs_a_warning_no_hang(monkeypatch: pytest.MonkeyPatch, recording: Path) -> None:
    monkeypatch.setattr(viewer, "SEND_TIMEOUT_S", 0.5)
    with pytest.raises(LocfuseError, match="take"):
        viewer.show(recording)


def test_a_viewer_or_a_display_that_is_not_there_is_said_so(
    recording: Path, lonely: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    with pytest.raises(LocfuseError, match=f"no viewer answers at 127.0.0.1:{lonely}"):
        viewer.send(recording, f"rerun+http://127.0.0.1:{lonely}/proxy")
    monkeypatch.setenv("DISPLAY", ":4711")
    with pytest.raises(LocfuseError, match="viewer ended"):
        viewer.show(recording)


FULL_DISK = """
import resource, signal, sys
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
from locfuse.cli.main import main
from locfuse.formats.rerun import recording as file
before = file.save_recording
def full(*a, **named):
    resource.setrlimit(resource.RLIMIT_FSIZE, (200_000, 200_000))
    before(*a, **named)
file.save_recording = full
main(sys.argv[1:])
"""


def test_a_full_disk_costs_what_was_asked_for_by_name_and_leaves_nothing_half_written(tmp_path: Path) -> None:
    save = tmp_path / "drive.rrd"
    words = ["run", LOG, *LIGHT, "--no-advice", "-o", str(tmp_path / "out"), "--rerun-save", str(save)]
    done = subprocess.run(
        [sys.executable, "-c", FULL_DISK, *words], capture_output=True, text=True, timeout=300, check=False
    )
    assert done.returncode == 1, done.stderr
    (line,) = (one for one in done.stderr.splitlines() if "--rerun-save" in one)
    assert "disk is full" in line
    assert line.endswith("The other results are written")
    assert "ERROR" not in done.stderr  # Rerun's own log stays quiet
    assert sorted(p.name for p in tmp_path.iterdir()) == ["out"]
    assert (tmp_path / "out" / "run.json").is_file()


def test_a_place_that_cannot_be_written_is_an_error_after_the_results(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    save = tmp_path / "file" / "drive.rrd"
    words = ("run", LOG, "--no-advice", *LIGHT, "-o", tmp_path / "out", "--rerun-save", save)
    assert "--rerun-save" in refused(*words)
    assert (tmp_path / "out" / "run.json").is_file()


def test_a_smoothed_configuration_at_a_lower_rate_is_recorded(tmp_path: Path) -> None:
    words = ("--sensors", "lrf@2Hz", "--smooth", "--set", "lrf.map=refine", "--write", "json")
    save = tmp_path / "drive.rrd"
    where = ("-o", tmp_path / "out", "--rerun-save", save)
    done = locfuse("compare", LOG, *words, "--no-advice", *where)
    assert not warnings_of(done.stderr)
    assert len(read(save)["world/lrf\\@2Hz-smoothed/path"].ns) > 100


@pytest.mark.parametrize("share", [0.0, 0.01, 0.5, 0.99])
def test_a_recording_cut_short_is_refused(recording: Path, tmp_path: Path, share: float) -> None:
    data = recording.read_bytes()
    cut = tmp_path / "cut.rrd"
    cut.write_bytes(data[: int(share * len(data))])
    with pytest.raises(LocfuseError, match="no whole recording"):
        check(cut)


@pytest.mark.skipif(not Path("/proc/net/tcp").exists(), reason="needs Linux to see who listens where")
def test_the_web_view_is_reachable_from_this_machine_only(recording: Path) -> None:
    port = viewer.free_port(0)
    environment = {k: v for k, v in os.environ.items() if k not in {"DISPLAY", "WAYLAND_DISPLAY"}}
    command = [sys.executable, "-m", "locfuse", "view", str(recording), "--web", "--web-port", str(port)]
    server = subprocess.Popen(command, stderr=subprocess.PIPE, text=True, env=environment)
    try:
        deadline = time.monotonic() + 300
        while not viewer.listening("127.0.0.1", port) and time.monotonic() < deadline:
            time.sleep(0.1)
        listeners = [
            line.split()[1] for line in Path("/proc/net/tcp").read_text().splitlines()[1:] if " 0A " in line
        ]
        (mine,) = [a for a in listeners if a.endswith(f":{port:04X}")]
        assert mine.startswith("0100007F")  # 127.0.0.1
    finally:
        server.terminate()
        _, said = server.communicate(timeout=300)
    assert f"http://127.0.0.1:{port}/?url=" in said
    assert server.returncode == 143
    assert not viewer.listening("127.0.0.1", port)  # the server does not outlive the command


# --- `view`: recordings of logs and of folders of results


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("view") / "out"
    words = ("--sensors", "odometry", "--sensors", "lrf", "--write", "json,tum", "--no-advice")
    ok("compare", LOG, *words, "-o", out)
    return out


def test_a_log_becomes_a_recording_of_the_configurations_asked_for(tmp_path: Path) -> None:
    words = ("--sensors", "odometry", "--sensors", "compass", "--images", "none")
    log = Drive(pictures=True).record(tmp_path / "drive.mcap")
    ok("view", log, *words, "--save", tmp_path / "drive.rrd", "--tab", "nis")
    entities = read(tmp_path / "drive.rrd")
    assert {"world/odometry/pose", "world/compass/pose", "nis/compass/compass"} <= set(entities)
    assert "world/lrf/pose" not in entities
    assert "camera/omni" not in entities


def test_a_folder_of_results_is_shown_from_its_files(results: Path, tmp_path: Path) -> None:
    ok("view", results, "--save", tmp_path / "drive.rrd")
    entities = read(tmp_path / "drive.rrd")
    tum = np.loadtxt(results / "lrf.tum")
    pose = entities["world/lrf/pose"]
    np.testing.assert_allclose(pose.array("Transform3D:translation")[:, 0, :2], tum[:, 1:3], atol=1e-5)
    np.testing.assert_allclose(pose.ns * 1e-9, tum[:, 0], atol=1e-6)
    truth = np.loadtxt(results / "truth.tum")
    rows = np.isin(np.rint(truth[:, 0] * 1e3), np.rint(tum[:, 0] * 1e3))
    at = np.searchsorted(tum[:, 0], truth[rows, 0] - 1e-6)
    deviation = entities["deviation/x/lrf"].array("Scalars:scalars")[:, 0]
    np.testing.assert_allclose(deviation, tum[at, 1] - truth[rows, 1], atol=1e-9)
    assert "world/lrf/sigma" not in entities  # a .tum holds no covariances


def test_a_run_folder_keeps_its_covariances_and_what_was_smoothed_beside_what_was_not(tmp_path: Path) -> None:
    out = tmp_path / "out"
    words = ("--no-advice", "--smooth", "--sensors", "compass", "--write", "all")
    ok("run", LOG, *words, "-o", out)
    ok("view", out, "--save", tmp_path / "drive.rrd")
    shown = read(tmp_path / "drive.rrd")
    for name, file in (("compass", "trajectory.tum"), ("compass-smoothed", "smoothed.tum")):
        drawn = shown[f"world/{name}/pose"].array("Transform3D:translation")[:, 0, :2]
        np.testing.assert_allclose(drawn, np.loadtxt(out / file)[:, 1:3], atol=1e-5)
    rows = np.loadtxt(out / "trajectory.csv", delimiter=",", skiprows=1)
    P = rows[:, [4, 5, 5, 7]].reshape(-1, 2, 2)
    axes = shown["world/compass/sigma"].array("Ellipses2D:half_sizes")[:, 0]
    np.testing.assert_allclose(
        axes[:, 0], 3.0 * np.sqrt(np.linalg.eigvalsh(P)[:, 1].clip(0)), atol=1e-6, rtol=1e-5
    )


def test_a_recording_beside_the_results_is_used_while_it_is_not_older(
    results: Path, recording: Path, tmp_path: Path
) -> None:
    shutil.copy(recording, results / "recording.rrd")
    ok("view", results, "--save", tmp_path / "fresh.rrd")
    assert (tmp_path / "fresh.rrd").read_bytes() == recording.read_bytes()
    os.utime(results / "recording.rrd", (1.0, 1.0))
    ok("view", results, "--save", tmp_path / "new.rrd")
    assert "world/lrf/pose" in read(tmp_path / "new.rrd")
    (results / "recording.rrd").unlink()


WITHOUT_TRACKS = '{"locfuse": "0.2.0", "schema_version": %d, "configurations": {"all": {}}}'


@pytest.mark.parametrize(
    ("name", "content", "said"),
    [
        ("report.json", "{", "not as locfuse writes them"),
        ("report.json", WITHOUT_TRACKS % 1, "lacks all.tum"),
        ("report.json", WITHOUT_TRACKS % 2, "schema_version 2"),
        ("drive.rrd", "junk", "no whole recording"),
    ],
)
def test_what_cannot_be_shown_is_said_in_one_line(tmp_path: Path, name: str, content: str, said: str) -> None:
    (tmp_path / name).write_text(content)
    what = tmp_path if name.endswith("json") else tmp_path / name
    assert said in refused("view", what, "--save", tmp_path / "x.rrd")
    assert not (tmp_path / "x.rrd").exists()


def test_files_of_two_runs_in_one_folder_are_not_drawn_as_one(tmp_path: Path) -> None:
    for sensors, kinds in (("lrf", "tum,csv,json"), ("compass", "tum,json")):
        words = ("--sensors", sensors, "--write", kinds, "--no-advice", "--no-smooth", "--overwrite")
        ok("run", LOG, "-o", tmp_path, *words)
    assert "trajectory.csv and trajectory.tum are of different runs" in refused(
        "view", tmp_path, "--save", tmp_path / "x.rrd"
    )


def test_nothing_to_look_with_is_said_before_anything_is_computed(monkeypatch: pytest.MonkeyPatch) -> None:
    from locfuse.cli.rerun import viewer

    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    monkeypatch.setattr(viewer, "PORT", viewer.free_port(0))
    assert "--web" in refused("view", LOG)
