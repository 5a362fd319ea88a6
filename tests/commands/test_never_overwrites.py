"""What is read is never written, and no file is lost that nobody gave up."""

from __future__ import annotations

import os
import shutil
import socket
import subprocess
import sys
import tempfile
import textwrap
from pathlib import Path
from typing import Any

import pytest
from commands import locfuse, ok, refused
from hostile import write

from locfuse.formats import inputs, whole_files
from locfuse.formats.container.file_bytes import WRITTEN_TO, FileBytes
from locfuse.formats.container.losses import Losses
from locfuse.formats.container.mcap_write import log_writer
from locfuse.formats.logs.files import log_name
from locfuse.formats.logs.log import open_log
from locfuse.formats.whole_files import temporary_for, whole_file, write_results
from locfuse.fusion.data import LocfuseError


@pytest.fixture
def log(tmp_path: Path) -> Path:
    return write(tmp_path / "d.mcap")


def writing(log: Path, command: str, option: str, target: Path) -> tuple[Any, ...]:
    """The words of a command that reads the log and writes a file by an option; a run has a folder beside it."""
    return command, log, *(("-o", log.parent / "o") if command == "run" else ()), option, target


outputs = pytest.mark.parametrize(
    ("command", "option"),
    [("run", "--audit"), ("run", "--save-map"), ("run", "--rerun-save"), ("recover", "-o"), ("view", "--save")],
)


@outputs
@pytest.mark.parametrize("overwrite", [[], ["--overwrite"]])
def test_a_named_output_never_replaces_the_log(log: Path, command: str, option: str, overwrite: list[str]) -> None:
    before = log.read_bytes()
    done = locfuse(*writing(log, command, option, log), *overwrite)
    assert (done.exit_code, log.read_bytes() == before) == (2, True)
    assert "it is the input" in done.stderr
    assert not (log.parent / "o").exists()


@outputs
def test_a_named_output_replaces_a_file_only_where_told_to(log: Path, command: str, option: str) -> None:
    mine = log.parent / "mine"
    mine.write_text("mine")
    words = writing(log, command, option, mine)
    done = locfuse(*words)
    assert (done.exit_code, mine.read_text()) == (2, "mine")
    assert "--overwrite" in done.stderr
    if option == "--audit":
        ok(*words, "--overwrite")
        assert mine.read_text().startswith("t,")


@outputs
def test_a_result_never_takes_the_place_of_a_device(log: Path, command: str, option: str) -> None:
    device = log.parent / "device"
    os.mkfifo(device)
    assert "not a regular file" in refused(*writing(log, command, option, device), "--overwrite")
    assert device.is_fifo()
    assert not (log.parent / "o").exists()
    with pytest.raises(LocfuseError, match="not a regular file"), whole_file(device):
        pass


def test_a_result_that_is_read_as_a_log_is_not_replaced_by_its_own_export(log: Path) -> None:
    out = log.parent / "o"
    ok("run", log, "-o", out, "--export", "log")
    before = (out / "estimates.mcap").read_bytes()
    assert "it is the input" in refused("run", out / "estimates.mcap", "-o", out, "--export", "log")
    assert (out / "estimates.mcap").read_bytes() == before


def test_a_robot_toml_in_the_folder_of_results_is_not_replaced_by_the_run_that_reads_it(log: Path) -> None:
    out = log.parent / "o"
    ok("run", log, "-o", out)
    (out / "robot.toml").write_text("# my words\n" + (out / "robot.toml").read_text())
    refused("run", log, "-o", out, "--robot", out / "robot.toml", code=2)
    assert (out / "robot.toml").read_text().startswith("# my words")


@pytest.mark.parametrize("name", ["...mcap", "..mcap"])
def test_a_log_named_after_a_folder_above_keeps_its_results_below(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    monkeypatch.chdir(tmp_path)
    write(tmp_path / name)
    (tmp_path / "robot.toml").write_text("mine")
    assert locfuse("run", name).exit_code == 1 or not (tmp_path / "locfuse-out" / "run.json").exists()
    assert (tmp_path / "robot.toml").read_text() == "mine"
    assert not (tmp_path / "run.json").exists()


def test_every_name_of_a_log_is_one_folder() -> None:
    for name in ("...mcap", "..mcap", "....mcap.zstd", ".mcap", "a.mcap"):
        stem = log_name([Path("x") / name])
        assert stem.strip(".")
        assert Path(stem).name == stem


HOLDER = """
    import sys, time
    from pathlib import Path
    from locfuse.formats.whole_files import write_results
    def slowly(path):
        path.write_text("x")
        print("writing", flush=True)
        time.sleep(60)
    write_results(Path(sys.argv[1]), {"run.json": slowly})
"""


def test_a_second_run_at_one_folder_says_who_is_there(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(whole_files, "LOCK_TIMEOUT_S", 0.1)
    command = [sys.executable, "-c", textwrap.dedent(HOLDER), str(tmp_path)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as holder:
        assert holder.stdout is not None
        holder.stdout.readline()
        with pytest.raises(LocfuseError, match=f"being written by process {holder.pid}"):
            write_results(tmp_path, {"run.json": "{}"})
        assert list(tmp_path.glob(".run.json.*"))  # the other's file is not taken from it
        holder.kill()
    write_results(tmp_path, {"run.json": "{}"})  # a dead process holds nothing
    assert [p.name for p in tmp_path.iterdir()] == ["run.json"]


def _ended() -> int:
    with subprocess.Popen([sys.executable, "-c", ""]) as process:
        process.wait()
    return process.pid


def test_what_a_killed_process_left_of_a_file_goes_with_the_next(tmp_path: Path) -> None:
    target = tmp_path / "drive.mcap"
    left = tmp_path / f".drive.mcap.{_ended()}{whole_files.TEMPORARY}"
    living = tmp_path / f".drive.mcap.{os.getppid()}{whole_files.TEMPORARY}"
    for path in (left, living):
        path.write_text("half")
    temporary_for(target)
    assert (left.exists(), living.exists()) == (False, True)


def test_scratch_of_killed_processes_of_this_machine_goes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    monkeypatch.setattr(socket, "gethostname", lambda: "node-7.lab")
    folder = tmp_path / f"locfuse-node_7_lab-{_ended()}-x"
    folder.mkdir()
    (folder / "recording.rrd").write_text("x")
    others = tmp_path / f"locfuse-node_8_lab-{_ended()}-x"  # of a living process of another machine, perhaps
    mine = tmp_path / f"locfuse-node_7_lab-{os.getpid()}-y"
    for path in (others, mine):
        path.write_text("kept")
    assert whole_files.scratch_prefix() == f"locfuse-node_7_lab-{os.getpid()}-"
    assert sorted(tmp_path.iterdir()) == sorted((others, mine))


def test_a_link_under_a_temporary_name_is_not_written_through(tmp_path: Path) -> None:
    victim, out = tmp_path / "victim", tmp_path / "out"
    out.mkdir()
    victim.write_text("mine")
    for name in ("run.json", "map.json", "x.mcap"):
        (out / f".{name}.{os.getpid()}{whole_files.TEMPORARY}").symlink_to(victim)
    write_results(out, {"run.json": "{}"})
    with whole_file(out / "map.json") as path:
        path.write_text("[]")
    with log_writer(out / "x.mcap"):
        pass
    assert victim.read_text() == "mine"
    assert not any(path.is_symlink() for path in out.iterdir())
    assert sorted(path.name for path in out.iterdir()) == ["map.json", "run.json", "x.mcap"]


def test_a_file_may_be_written_when_its_reader_is_gone(tmp_path: Path) -> None:
    path = tmp_path / "a"
    path.write_text("a")
    reader = FileBytes(path, Losses())
    with pytest.raises(LocfuseError, match="it is the input"), whole_file(path):
        pass
    del reader
    with whole_file(path) as temporary:
        temporary.write_text("b")
    assert path.read_text() == "b"


def test_a_log_that_is_replaced_while_it_is_read_is_noticed(tmp_path: Path) -> None:
    log = write(tmp_path / "d.mcap", seconds=20.0)
    opened = open_log([log])
    other = write(log.parent / "other.mcap", seconds=2.0)
    shutil.move(other, log)
    with pytest.raises(LocfuseError, match="replaced by another file"):
        opened.stream("/scan").columns("ranges")
    with pytest.raises(LocfuseError, match="replaced by another file"):
        opened.sha256  # noqa: B018 - the property reads


def test_a_log_that_is_written_to_while_it_is_read_is_counted(tmp_path: Path) -> None:
    log = write(tmp_path / "d.mcap", seconds=20.0)
    opened = open_log([log])
    with log.open("ab") as file:
        file.write(b"more")
    opened.stream("/scan").columns("ranges")
    assert any(WRITTEN_TO in line for line in opened.losses.lines())


def test_a_pipe_is_refused_and_not_waited_for(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.mcap")
    assert "not a regular file" in refused("info", tmp_path / "pipe.mcap")
    log = write(tmp_path / "a.mcap")
    assert "not a regular file" in refused("info", log, "--robot", tmp_path / "pipe.mcap")
    os.mkfifo(tmp_path / "metadata.yaml")
    ok("info", tmp_path)  # read without either pipe


def test_a_small_file_that_is_large_is_refused_by_its_cap(tmp_path: Path) -> None:
    (tmp_path / "robot.toml").write_bytes(b"#" * 2_000_000)
    with pytest.raises(LocfuseError, match=r"2 000 000 bytes, more than the cap of 1 000"):
        inputs.read_small(tmp_path / "robot.toml", 1000)
