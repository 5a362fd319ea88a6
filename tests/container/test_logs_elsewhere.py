"""Logs on a server: results are those of the same log here, few bytes come, and every failure is one line."""

import json
import random
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zstandard
from bags import STORE, T0, S, Said, cdr, header, write
from commands import counted_jobs, locfuse, ok, refused
from mcap.reader import make_reader
from mcap.writer import CompressionType
from range_server import Shelf, serving
from rosbags.rosbag2 import Writer

from benchmarks.__main__ import make_log
from locfuse.cli.analysis.grouping import expanded
from locfuse.formats.container import remote_objects as objects
from locfuse.formats.container.file_bytes import Losses, Url, is_url, place
from locfuse.formats.container.remote_objects import RemoteBytes
from locfuse.formats.logs.log import Log, open_log
from locfuse.fusion.data import LocfuseError, UsageError

pytest.importorskip("obstore")
WHAT_DIFFERS = ("identity", "sha256", "etag")  # of the input


@pytest.fixture
def shelf() -> Iterator[Shelf]:
    with serving() as found:
        yield found


@pytest.fixture(scope="module")
def logs(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Six seconds with raw pictures that nothing reads, by compression."""
    folder = tmp_path_factory.mktemp("logs")
    make_log(folder / "drive.mcap", minutes=0.1)
    with (folder / "drive.mcap").open("rb") as file:
        reader = make_reader(file)
        robot = next(reader.iter_attachments()).data
        said = [Said(c.topic, s.name, m.data, m.log_time) for s, c, m in reader.iter_messages() if s is not None]
    picture, kind = random.Random(1).randbytes(320 * 240 * 3), "sensor_msgs/msg/Image"
    data = cdr(kind, header=header(T0), data=np.frombuffer(picture, np.uint8))
    said += [Said("/front/image_raw", kind, data, said[0].log_time + i * S // 5) for i in range(30)]
    said.sort(key=lambda m: m.log_time)
    how: dict[str, Any] = {"chunk_size": 400_000, "attachments": {"robot.toml": robot}}
    return {
        name: write(folder / f"{name}.mcap", said, compression=CompressionType[name.upper()], **how)
        for name in ("none", "zstd")
    }


def columns(log: Log) -> dict[str, dict[str, np.ndarray]]:
    fields = {
        "/joint_states": ("position",),
        "/compass": ("magnetic_field.x",),
        "/ground_truth/pose": ("pose.position.x",),
    }
    streams = log.streams(fields)
    return {
        topic: {"t": streams[topic].t_ns, **{k: np.asarray(v) for k, v in streams[topic].columns(*names).items()}}
        for topic, names in fields.items()
    }


@pytest.mark.parametrize("kind", ["none", "zstd"])
def test_every_file_is_that_of_the_log_here_but_for_its_identity(
    kind: str, logs: dict[str, Path], shelf: Shelf, tmp_path: Path
) -> None:
    url = shelf.put(f"{kind}.mcap", logs[kind].read_bytes())
    words = ("--no-advice", "--sensors", "odometry", "--sensors", "compass", "--write", "json,tum,csv,md")
    for where, folder in ((logs[kind], "here"), (url, "there")):
        done = ok("compare", where, "-o", tmp_path / folder, *words)
    assert "MB over the network" in done.stderr
    for file in sorted((tmp_path / "here").iterdir()):
        other = tmp_path / "there" / file.name
        if file.suffix in {".tum", ".csv", ".toml"}:
            assert other.read_bytes() == file.read_bytes()
    here, there = (json.loads((tmp_path / f / "report.json").read_text()) for f in ("here", "there"))
    assert there["input"]["sha256"] is None
    assert there["input"]["etag"] == '"one"'
    for report in (here, there):
        report.pop("key")
        for key in WHAT_DIFFERS:
            report["input"].pop(key, None)
    assert there == here


def test_bytes_are_those_of_the_object_wherever_they_are_read(shelf: Shelf) -> None:
    rng = random.Random(4)
    data = rng.randbytes(40 * objects.BLOCK_BYTES + 123)
    there = RemoteBytes(Url(shelf.put("bytes", data)), Losses())
    for _ in range(50):
        at, n = rng.randrange(len(data)), rng.randrange(3 * objects.BLOCK_BYTES)
        assert there.read(at, n) == data[at : at + n]
    assert shelf.sent <= len(data)  # no block comes twice


def test_a_long_range_comes_in_several_requests(shelf: Shelf, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(objects, "BLOCKS_TOGETHER", 2)
    data = random.Random(4).randbytes(9 * objects.BLOCK_BYTES + 1)
    there = RemoteBytes(Url(shelf.put("long", data)), Losses())
    there.copy_here()
    assert there.read(0, len(data)) == data
    assert max(stop - start for _, start, stop in shelf.asked) == 2 * objects.BLOCK_BYTES


def test_topics_are_listed_by_one_or_two_requests(logs: dict[str, Path], shelf: Shelf) -> None:
    url = shelf.put("listed.mcap", logs["none"].read_bytes())
    shelf.asked.clear()
    done = ok("info", "--topics", url)
    assert len(shelf.asked) <= 2
    assert done.stdout == locfuse("info", "--topics", logs["none"]).stdout
    assert "/front/image_raw" in done.stdout


def test_other_kinds_of_files_are_copied_and_read(logs: dict[str, Path], shelf: Shelf, tmp_path: Path) -> None:
    data = logs["none"].read_bytes()
    cut_off = tmp_path / "cut.mcap"
    cut_off.write_bytes(data[: len(data) // 2])
    for name, content, like in (
        ("whole.mcap.zstd", zstandard.compress(data), logs["none"]),
        ("cut.mcap", cut_off.read_bytes(), cut_off),
    ):
        there, here = open_log([Url(shelf.put(name, content))]), open_log([like])
        np.testing.assert_array_equal(columns(there)["/joint_states"]["t"], columns(here)["/joint_states"]["t"])
        assert list(there.losses.by_reason()) == list(here.losses.by_reason())
        assert there.identity.size == len(content)
    with Writer(tmp_path / "bag", version=9) as writer:
        connection = writer.add_connection("/imu", "sensor_msgs/msg/Imu", typestore=STORE)
        writer.write(connection, 10**18, cdr("sensor_msgs/msg/Imu", header=header(10**18)))
    bag = next((tmp_path / "bag").glob("*.db3"))
    log = open_log([Url(shelf.put("bag.db3", bag.read_bytes()))])
    assert log.topics.keys() == open_log([bag]).topics.keys()


def test_a_hash_is_taken_of_all_bytes_as_they_are_on_the_server(logs: dict[str, Path], shelf: Shelf) -> None:
    data = zstandard.compress(logs["none"].read_bytes())
    log = open_log([Url(shelf.put("hashed.mcap.zstd", data))])
    import hashlib

    assert log.sha256 == hashlib.sha256(data).hexdigest()
    assert not log.all_read


@pytest.fixture
def impatient(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    for name, value in (("SILENCE_S", 0.2), ("CONNECT_S", 1.0), ("MAX_RETRIES", 1), ("RETRY_S", 2.0)):
        monkeypatch.setattr(objects, name, value)
    objects.store.cache_clear()
    yield
    objects.store.cache_clear()


def unread(url: str) -> str:
    return refused("compare", url, "--write", "json")


@pytest.mark.usefixtures("impatient")
def test_what_a_server_refuses_or_does_not_give_is_one_line(logs: dict[str, Path], shelf: Shelf) -> None:
    data = logs["none"].read_bytes()
    for status, said in (
        (403, "access denied (403)"),
        (404, "no such object (404)"),
        (401, "not signed in (401)"),
    ):
        url = shelf.put(f"{status}.mcap", data)
        shelf.refuse[f"{status}.mcap"] = status
        assert said in unread(url)
    shelf.refuse["500.mcap"] = 500
    assert "500 Internal Server Error" in unread(shelf.put("500.mcap", data))
    assert "empty (0 bytes)" in unread(shelf.put("empty.mcap", b""))
    assert "not an MCAP file: it is a text file" in unread(shelf.put("text.mcap", b"no log at all\n"))
    shelf.stall.add("stall.mcap")
    assert "the connection stalled" in unread(shelf.put("stall.mcap", data))
    shelf.drop.add("drop.mcap")
    assert "drop.mcap: " in unread(shelf.put("drop.mcap", data))
    shelf.whole = True
    assert "does not answer for parts" in unread(shelf.put("parts.mcap", data))
    shelf.whole = False


@pytest.mark.usefixtures("impatient")
def test_without_credentials_the_line_names_them(shelf: Shelf, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("AWS_ACCESS_KEY_ID", "AWS_SECRET_ACCESS_KEY", "AWS_PROFILE"):
        monkeypatch.delenv(name, raising=False)
    shelf.refuse["latest/api/token"] = 403
    monkeypatch.setenv("AWS_METADATA_ENDPOINT", shelf.root)  # where a machine of the cloud would ask
    assert "set AWS_ACCESS_KEY_ID" in unread("s3://bucket/drive.mcap")


def test_a_bucket_is_searched_by_patterns_by_folders_and_as_one_log(
    logs: dict[str, Path], shelf: Shelf, monkeypatch: pytest.MonkeyPatch
) -> None:
    settings = {"AWS_ENDPOINT_URL": shelf.root, "AWS_ACCESS_KEY_ID": "a", "AWS_SECRET_ACCESS_KEY": "b"}
    for name, value in {**settings, "AWS_REGION": "us-east-1"}.items():
        monkeypatch.setenv(name, value)
    objects.store.cache_clear()
    for key in ("day1/a.mcap", "day1/b.mcap", "day1/deep/c.mcap", "day2/d.mcap", "day1/notes.txt"):
        shelf.put(f"bucket/{key}", logs["none"].read_bytes())
    day1 = ["s3://bucket/day1/a.mcap", "s3://bucket/day1/b.mcap"]
    assert expanded(["s3://bucket/day1/*.mcap"]) == day1
    assert expanded(["s3://bucket/day?/[bd].mcap"]) == [day1[1], "s3://bucket/day2/d.mcap"]
    assert expanded(["s3://bucket/**/*.mcap"]) == expanded([], ["s3://bucket/"])
    assert expanded([], ["s3://bucket/day1/"]) == [*day1, "s3://bucket/day1/deep/c.mcap"]
    one = open_log([Url("s3://bucket/day1/")])
    assert (one.name, [str(path) for path in one.paths]) == ("day1", day1)
    with pytest.raises(UsageError, match="nothing fits"):
        expanded(["s3://bucket/day3/*.mcap"])
    with pytest.raises(LocfuseError, match="a web server has no list"):
        expanded([], [f"{shelf.root}/bucket/"])
    objects.store.cache_clear()


def test_an_object_that_changes_while_it_is_read_ends_the_job(logs: dict[str, Path], shelf: Shelf) -> None:
    data = logs["none"].read_bytes()
    log = open_log([Url(shelf.put("changing.mcap", data))])
    shelf.put("changing.mcap", data, tag="two")
    with pytest.raises(LocfuseError, match="it was replaced while it was read"):
        columns(log)


def test_a_connection_that_drops_midway_is_one_line(logs: dict[str, Path], shelf: Shelf, impatient: None) -> None:
    log = open_log([Url(shelf.put("middle.mcap", logs["none"].read_bytes()))])
    shelf.drop.add("middle.mcap")
    with pytest.raises(LocfuseError, match=r"middle\.mcap: "):
        columns(log)


def test_copies_leave_no_file_behind(
    logs: dict[str, Path], shelf: Shelf, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    log = open_log([Url(shelf.put("gone.mcap.zstd", zstandard.compress(logs["none"].read_bytes())))])
    assert len(list(tmp_path.iterdir())) == 2  # packed and unpacked
    del log
    assert not list(tmp_path.iterdir())
    monkeypatch.setattr(shutil, "disk_usage", lambda _: shutil._ntuple_diskusage(10, 10, 0))
    with pytest.raises(LocfuseError, match="set TMPDIR to a larger place"):
        open_log([Url(shelf.put("large.mcap.zstd", zstandard.compress(b"1" * 1000)))])


@pytest.mark.usefixtures("jobs_in_this_process")
def test_a_log_that_was_finished_is_not_run_again_until_its_tag_changes(
    logs: dict[str, Path], shelf: Shelf, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    ran = counted_jobs(monkeypatch)
    url = shelf.put("day/a.mcap", logs["none"].read_bytes())
    (tmp_path / "list.txt").write_text(url)
    words = (f"@{tmp_path / 'list.txt'}", "-o", tmp_path / "out", "--sensors", "odometry", "--write", "json", "-q")
    for expected in (["a"], []):
        ran.clear()
        ok("compare", *words)
        assert ran == expected
    shelf.put("day/a.mcap", b"", tag="another")
    assert locfuse("compare", *words).exit_code == 1
    assert ran == ["a"]


def test_without_obstore_the_line_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    import sys

    objects.store.cache_clear()
    monkeypatch.setitem(sys.modules, "obstore.store", None)
    with pytest.raises(LocfuseError, match=r"pip install 'locfuse\[remote\]'"):
        objects.store("s3://bucket")


def test_an_address_has_a_store_a_key_and_a_name() -> None:
    url = Url("s3://bucket/day 1/drive.mcap")
    assert (url.root, url.key, url.name) == ("s3://bucket", "day 1/drive.mcap", "drive.mcap")
    assert str(url.parent) == "s3://bucket/day 1/"
    assert url.parent.is_folder
    assert Url("https://host:8080/a%20b.mcap").key == "a b.mcap"
    assert place("s3://bucket/a.mcap") == Url("s3://bucket/a.mcap")
    assert not is_url("C:/logs/a.mcap")
    assert not is_url("logs/s3/a.mcap")


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("ftp://host/a.mcap", "logs are read from s3"),
        ("https://me:secret@host/a.mcap", "no passwords"),
        ("https://host/a.mcap?X-Amz-Signature=secret", "with ? or #"),
        ("s3:///a.mcap", "which bucket"),
    ],
)
def test_an_address_that_cannot_be_read_is_refused_without_its_secrets(text: str, said: str) -> None:
    with pytest.raises(UsageError, match=r".") as refused:
        Url(text)
    assert said in str(refused.value)
    assert "secret" not in str(refused.value)
