"""Results appear whole or not at all, and never over somebody else's files."""

import json
import os
import random
import shutil
import socket
import subprocess
import sys
import tempfile
import textwrap
import time
from pathlib import Path
from typing import Any

import pytest
import zstandard
from bags import drive, write
from commands import locfuse, ok, refused
from hostile import Put, crashed_recording, sample, write as sample_write
from mcap.reader import make_reader
from mcap.stream_reader import StreamReader
from rosbags.highlevel import AnyReader

from locfuse.formats import inputs, whole_files
from locfuse.formats.container.file_bytes import WRITTEN_TO, FileBytes, Losses
from locfuse.formats.container.mcap_write import log_writer
from locfuse.formats.logs.log import open_log
from locfuse.formats.whole_files import temporary_for, whole_file, write_results
from locfuse.fusion.data import LocfuseError

FILES: dict[str, str | bytes] = {"run.json": "{}\n", "trajectory.tum": "1 2 3\n", "robot.toml": b"[wheels]\n"}


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def test_a_file_in_place_of_the_folder_is_refused(tmp_path: Path) -> None:
    (tmp_path / "out").write_text("")
    with pytest.raises(LocfuseError, match="is a file, not a folder"):
        write_results(tmp_path / "out", FILES)
    with pytest.raises(LocfuseError, match="cannot write to"):
        write_results(tmp_path / "out" / "deeper", FILES)


def test_the_json_takes_its_name_last(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    order: list[str] = []
    replace = Path.replace

    def noted(self: Path, target: Path) -> Path:
        order.append(Path(target).name)
        return replace(self, target)

    monkeypatch.setattr(Path, "replace", noted)
    write_results(tmp_path, {"report.json": "{}", "z.tum": "", "a.csv": ""})
    assert order == ["a.csv", "z.tum", "report.json"]


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write anywhere")
def test_a_read_only_folder_is_one_line(tmp_path: Path) -> None:
    tmp_path.chmod(0o500)
    with pytest.raises(LocfuseError, match="Permission denied"):
        write_results(tmp_path / "out", FILES)


WRITER = """
    import sys, time
    from pathlib import Path
    from locfuse.formats.whole_files import write_results
    print("ready", flush=True)
    while True:
        write_results(Path(sys.argv[1]), {name: "x" * 1_000_000 for name in ("run.json", "a.tum", "b.csv")})
"""


def test_a_killed_writer_leaves_whole_files_only(tmp_path: Path) -> None:
    rng = random.Random(9)
    for attempt in range(3):
        folder = tmp_path / str(attempt)
        command = [sys.executable, "-c", textwrap.dedent(WRITER), str(folder)]
        with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL) as writer:
            assert writer.stdout is not None
            writer.stdout.readline()
            time.sleep(rng.uniform(0.02, 0.25))
            writer.kill()
        present = names(folder) if folder.exists() else []
        finals = [name for name in present if not name.endswith(whole_files.TEMPORARY)]
        assert all((folder / name).stat().st_size == 1_000_000 for name in finals)
        write_results(folder, {"run.json": "{}"})
        assert not [name for name in names(folder) if name.endswith(whole_files.TEMPORARY)]


# --- a recovered copy holds all that could be read, and is read whole by tools that trust a file's index


Messages = list[tuple[str, int, int, int, bytes]]


def messages(path: Path) -> Messages:
    """Topic, log time, publish time, sequence and bytes, by the public reader with all checksums checked."""
    with path.open("rb") as file:
        found = make_reader(file, validate_crcs=True).iter_messages(log_time_order=False)
        return [(c.topic, m.log_time, m.publish_time, m.sequence, m.data) for _, c, m in found]


def note(path: Path) -> dict[str, str]:
    with path.open("rb") as file:
        (found,) = make_reader(file).iter_metadata()
    assert found.name == "locfuse recover"
    return dict(found.metadata)


def attachments(path: Path) -> dict[str, bytes]:
    with path.open("rb") as file:
        return {a.name: a.data for a in make_reader(file).iter_attachments()}


def test_of_a_whole_log_everything_is_kept(tmp_path: Path) -> None:
    log, fixed = sample_write(tmp_path / "a.mcap"), tmp_path / "fixed.mcap"
    done = locfuse("recover", log, "-o", fixed)
    assert (done.exit_code, done.stderr) == (0, "")
    assert sorted(messages(fixed)) == sorted(messages(log))
    assert attachments(fixed) == attachments(log)
    assert note(fixed)["lost"] == ""
    before, after = (open_log([p]) for p in (log, fixed))
    assert after.topics == before.topics
    assert not after.losses
    assert not after.unchecked  # every chunk has a checksum
    assert done.stdout == f"{fixed}: {len(messages(log))} messages on {len(after.topics)} topics\n"


@pytest.mark.parametrize("damage", ["cut off", "a hole", "no end"])
def test_of_a_damaged_log_all_that_we_read_is_read_by_others_too(tmp_path: Path, damage: str) -> None:
    log = write(tmp_path / "a.mcap", drive(400), chunk_size=4000, attachments={"robot.toml": b"# mine"})
    whole, data = messages(log), bytearray(log.read_bytes())
    middle = len(data) // 2
    if damage == "cut off":
        del data[middle:]
    elif damage == "a hole":
        data[middle : middle + 500] = bytes(500)
    else:
        del data[-30:]
    log.write_bytes(data)
    fixed = tmp_path / "fixed.mcap"
    done = locfuse("recover", log, "-o", fixed, "--json")
    assert done.exit_code == 3
    kept = messages(fixed)
    assert len(kept) > len(whole) // 3
    assert set(kept) <= set(whole)
    read = open_log([log])
    assert len(kept) == sum(len(read.stream(t).t_ns) for t in read.topics)
    assert json.loads(done.stdout)["lost"] == read.losses.lines()
    assert note(fixed)["lost"] == "; ".join(read.losses.lines())
    assert "lost: " in done.stderr
    with fixed.open("rb") as file:  # record by record, every checksum
        assert len(list(StreamReader(file, validate_crcs=True).records)) > 3
    with AnyReader([fixed]) as bag:
        assert sum(1 for _ in bag.messages()) == len(kept)
        for connection, _, raw in bag.messages():
            message: Any = bag.deserialize(raw, connection.msgtype)
            assert message is not None
    again = tmp_path / "again.mcap"
    ok("recover", fixed, "-o", again)
    assert sorted(messages(again)) == sorted(kept)


def test_a_crashed_database_becomes_an_mcap(tmp_path: Path) -> None:
    fixed = tmp_path / "fixed.mcap"
    ok("recover", crashed_recording(tmp_path), "-o", fixed)
    assert len(messages(fixed)) == 600


def test_of_nothing_nothing_is_written(tmp_path: Path) -> None:
    log = write(tmp_path / "a.mcap", [])
    assert "not one message can be read" in refused("recover", log, "-o", tmp_path / "fixed.mcap")
    assert [p.name for p in tmp_path.iterdir()] == ["a.mcap"]


def test_messages_of_gigabytes_are_held_a_few_at_a_time(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("locfuse.formats.container.source.MAX_PORTION_BYTES", 100_000)
    plain = [bytes([i]) * 60_000 for i in range(20)]

    def packed(put: Put) -> Put:
        i = sample()[0].index(put)
        return put._replace(topic="/packed", data=zstandard.compress(plain[i]))

    log = sample_write(tmp_path / "a.mcap", packed, keep=lambda put: put in sample()[0][:20])
    held = [len(data) for _, data, _ in open_log([log]).messages()]
    assert sum(held) == 20 * 60_000
    assert max(held) <= 100_000 + 60_000
    fixed = tmp_path / "fixed.mcap"
    ok("recover", log, "-o", fixed)
    assert sorted(one[-1] for one in messages(fixed)) == plain


# --- what is read is never written, and no file is lost that nobody gave up


@pytest.fixture
def log(tmp_path: Path) -> Path:
    return sample_write(tmp_path / "d.mcap")


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
def test_a_named_output_replaces_a_file_only_where_told_to_and_never_a_device(
    log: Path, command: str, option: str
) -> None:
    device = log.parent / "device"
    os.mkfifo(device)
    assert "not a regular file" in refused(*writing(log, command, option, device), "--overwrite")
    assert device.is_fifo()
    assert not (log.parent / "o").exists()
    with pytest.raises(LocfuseError, match="not a regular file"), whole_file(device):
        pass
    mine = log.parent / "mine"
    mine.write_text("mine")
    words = writing(log, command, option, mine)
    done = locfuse(*words)
    assert (done.exit_code, mine.read_text()) == (2, "mine")
    assert "--overwrite" in done.stderr
    if option == "--audit":
        ok(*words, "--overwrite")
        assert mine.read_text().startswith("t,")


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
    sample_write(tmp_path / name)
    (tmp_path / "robot.toml").write_text("mine")
    assert locfuse("run", name).exit_code == 1 or not (tmp_path / "locfuse-out" / "run.json").exists()
    assert (tmp_path / "robot.toml").read_text() == "mine"
    assert not (tmp_path / "run.json").exists()


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


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="no /proc: processes are not shown as files")
def test_what_a_process_left_is_cleared_away_before_its_parent_has_asked_for_its_end(tmp_path: Path) -> None:
    with subprocess.Popen([sys.executable, "-c", ""], stdout=subprocess.PIPE) as child:
        assert child.stdout is not None
        child.stdout.read()
        left = tmp_path / f".report.csv.{child.pid}{whole_files.TEMPORARY}"
        left.write_text("x")
        for _ in range(200):
            if not whole_files.alive(child.pid):
                break
            time.sleep(0.01)
        assert child.returncode is None
        write_results(tmp_path, {"report.json": "{}"})
        assert not left.exists()


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
    log = sample_write(tmp_path / "d.mcap", seconds=20.0)
    opened = open_log([log])
    other = sample_write(log.parent / "other.mcap", seconds=2.0)
    shutil.move(other, log)
    with pytest.raises(LocfuseError, match="replaced by another file"):
        opened.stream("/scan").columns("ranges")
    with pytest.raises(LocfuseError, match="replaced by another file"):
        opened.sha256  # noqa: B018 - the property reads


def test_a_log_that_is_written_to_while_it_is_read_is_counted(tmp_path: Path) -> None:
    log = sample_write(tmp_path / "d.mcap", seconds=20.0)
    opened = open_log([log])
    with log.open("ab") as file:
        file.write(b"more")
    opened.stream("/scan").columns("ranges")
    assert any(WRITTEN_TO in line for line in opened.losses.lines())


def test_a_pipe_is_refused_and_not_waited_for(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.mcap")
    assert "not a regular file" in refused("info", tmp_path / "pipe.mcap")
    log = sample_write(tmp_path / "a.mcap")
    assert "not a regular file" in refused("info", log, "--robot", tmp_path / "pipe.mcap")
    os.mkfifo(tmp_path / "metadata.yaml")
    ok("info", tmp_path)  # read without either pipe


def test_a_small_file_that_is_large_is_refused_by_its_cap(tmp_path: Path) -> None:
    (tmp_path / "robot.toml").write_bytes(b"#" * 2_000_000)
    with pytest.raises(LocfuseError, match=r"2 000 000 bytes, more than the cap of 1 000"):
        inputs.read_small(tmp_path / "robot.toml", 1000)
