"""A recovered copy holds all that could be read, and is read whole by tools that trust a file's index."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
import zstandard
from bags import drive, write
from commands import locfuse, ok
from hostile import Put, crashed_recording, sample
from hostile import write as sample_write
from mcap.reader import make_reader
from mcap.stream_reader import StreamReader
from rosbags.highlevel import AnyReader

from locfuse.formats.logs.log import open_log

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


def test_the_log_itself_is_never_written_and_other_files_only_where_told_to(tmp_path: Path) -> None:
    log, mine = sample_write(tmp_path / "a.mcap", seconds=0.5), tmp_path / "mine"
    before = log.read_bytes()
    mine.write_text("mine")
    assert locfuse("recover", log, "-o", log, "--overwrite").exit_code == 2
    assert locfuse("recover", log, "-o", mine).exit_code == 2
    assert (log.read_bytes(), mine.read_text()) == (before, "mine")
    ok("recover", log, "-o", mine, "--overwrite")


def test_of_nothing_nothing_is_written(tmp_path: Path) -> None:
    log = write(tmp_path / "a.mcap", [])
    done = locfuse("recover", log, "-o", tmp_path / "fixed.mcap")
    assert done.exit_code == 1
    assert "not one message can be read" in done.stderr
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
    held = [sum(len(one.data) for one in batch) for batch in open_log([log]).messages()]
    assert sum(held) == 20 * 60_000
    assert max(held) <= 100_000 + 60_000
    fixed = tmp_path / "fixed.mcap"
    ok("recover", log, "-o", fixed)
    assert sorted(one[-1] for one in messages(fixed)) == plain
