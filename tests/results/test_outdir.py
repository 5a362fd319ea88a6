"""Results appear whole or not at all, and never over somebody else's files."""

from __future__ import annotations

import json
import os
import random
import signal
import subprocess
import sys
import textwrap
import time
from pathlib import Path
from typing import Any

import pytest
import zstandard
from bags import drive, write
from commands import locfuse, ok, refused
from hostile import Put, crashed_recording, sample
from hostile import write as sample_write
from mcap.reader import make_reader
from mcap.stream_reader import StreamReader
from rosbags.highlevel import AnyReader

from locfuse.formats import whole_files
from locfuse.formats.logs.log import open_log
from locfuse.formats.whole_files import whole_file, write_results
from locfuse.fusion.data import LocfuseError

FILES: dict[str, str | bytes] = {"run.json": "{}\n", "trajectory.tum": "1 2 3\n", "robot.toml": b"[wheels]\n"}


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def test_a_new_folder_with_its_parents_is_made(tmp_path: Path) -> None:
    write_results(tmp_path / "a" / "b", FILES)
    assert names(tmp_path / "a" / "b") == sorted(FILES)
    assert (tmp_path / "a" / "b" / "trajectory.tum").read_text() == "1 2 3\n"


def test_a_locfuse_result_is_replaced_file_by_file(tmp_path: Path) -> None:
    write_results(tmp_path, FILES)
    (tmp_path / "notes.txt").write_text("mine")
    write_results(tmp_path, {"run.json": "[]"})
    assert (tmp_path / "run.json").read_text() == "[]"
    assert (tmp_path / "notes.txt").read_text() == "mine"


def test_another_folder_is_refused_unless_told_to_overwrite(tmp_path: Path) -> None:
    (tmp_path / "thesis.tex").write_text("mine")
    with pytest.raises(LocfuseError, match=r"not empty and holds no locfuse result.*--overwrite"):
        write_results(tmp_path, FILES)
    assert names(tmp_path) == ["thesis.tex"]
    write_results(tmp_path, FILES, overwrite=True)
    assert names(tmp_path) == sorted([*FILES, "thesis.tex"])


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


@pytest.mark.parametrize("error", [OSError(28, "No space left on device"), KeyboardInterrupt(), SystemExit(143)])
def test_a_failure_leaves_neither_half_files_nor_temporary_ones(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, error: BaseException
) -> None:
    write_results(tmp_path / "old", FILES)
    before = {path: path.read_bytes() for path in (tmp_path / "old").iterdir()}
    calls = iter(range(100))

    def failing(handle: int) -> None:
        if next(calls) % 3 == 1:
            raise error

    monkeypatch.setattr(os, "fsync", failing)
    expected = LocfuseError if isinstance(error, OSError) else type(error)
    for folder in ("old", "new"):
        with pytest.raises(expected) as raised:
            write_results(tmp_path / folder, {"run.json": "[]", "a.tum": "x", "b.tum": "y"})
        if isinstance(raised.value, LocfuseError):
            assert str(raised.value) == f"cannot write to {tmp_path / folder}: No space left on device"
    assert {path: path.read_bytes() for path in (tmp_path / "old").iterdir()} == before
    assert not (tmp_path / "new").exists()


def test_a_file_that_writes_itself_appears_whole_or_not_at_all(tmp_path: Path) -> None:
    def fails(path: Path) -> None:
        path.write_bytes(b"half")
        raise OSError(28, "No space left on device")

    write_results(tmp_path, {"run.json": "{}", "estimates.mcap": "before"})
    with pytest.raises(LocfuseError, match="No space left"):
        write_results(tmp_path, {"estimates.mcap": fails, "run.json": "new"})
    assert {p.name: p.read_text() for p in tmp_path.iterdir()} == {"run.json": "{}", "estimates.mcap": "before"}


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write anywhere")
def test_a_read_only_folder_is_one_line(tmp_path: Path) -> None:
    tmp_path.chmod(0o500)
    with pytest.raises(LocfuseError, match="Permission denied"):
        write_results(tmp_path / "out", FILES)


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


def test_a_whole_file_keeps_the_old_one_when_the_block_fails(tmp_path: Path) -> None:
    target = tmp_path / "log.mcap"
    target.write_text("old")
    with pytest.raises(UnicodeEncodeError), whole_file(target) as path:
        path.write_text("half\ud800", encoding="utf-8")
    assert (names(tmp_path), target.read_text()) == (["log.mcap"], "old")
    with whole_file(target) as path:
        path.write_text("new")
    assert (names(tmp_path), target.read_text()) == (["log.mcap"], "new")


WRITER = """
    import sys, time
    from pathlib import Path
    from locfuse.formats.whole_files import write_results
    print("ready", flush=True)
    while True:
        write_results(Path(sys.argv[1]), {name: "x" * 1_000_000 for name in ("run.json", "a.tum", "b.csv")})
"""


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT, signal.SIGKILL])
def test_a_killed_writer_leaves_whole_files_only(tmp_path: Path, number: signal.Signals) -> None:
    rng = random.Random(number)
    for attempt in range(3):
        folder = tmp_path / str(attempt)
        writer = subprocess.Popen(
            [sys.executable, "-c", textwrap.dedent(WRITER), str(folder)],
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
        )
        with writer:
            assert writer.stdout is not None
            writer.stdout.readline()
            time.sleep(rng.uniform(0.02, 0.25))
            writer.send_signal(number)
            writer.wait(10)
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


def test_messages_that_unpack_to_gigabytes_are_held_a_few_at_a_time(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("locfuse.formats.container.decompress.MAX_PORTION_BYTES", 100_000)
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
