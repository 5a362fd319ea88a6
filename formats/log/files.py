"""Which files make up a log: one .mcap, several, or a rosbag2 directory."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import takewhile
from pathlib import Path

from locfuse.formats.caps import MAX_METADATA
from locfuse.formats.container.file_bytes import FileBytes
from locfuse.formats.container.losses import Losses
from locfuse.formats.container.source import Source
from locfuse.formats.container.zstd_file import ZSTD_MAGIC, unpack_file
from locfuse.formats.inputs import read_small
from locfuse.formats.mcap.source import McapSource
from locfuse.formats.visible import writable
from locfuse.fusion.data import LocfuseError, UsageError


def _sqlite(data: FileBytes, losses: Losses) -> Source:
    from locfuse.formats.container.rosbag2_sqlite import SqliteSource

    return SqliteSource(data, losses)


def _bag(data: FileBytes, losses: Losses) -> Source:
    from locfuse.formats.container.ros1_bag import BagSource

    return BagSource(data, losses)


SOURCES: dict[bytes, Callable[[FileBytes, Losses], Source]] = {
    b"SQLite format 3\x00": _sqlite,
    b"#ROSBAG V2.0\n": _bag,
}
ENDINGS = ("*.mcap", "*.mcap.zstd", "*.db3", "*.db3.zstd", "*.bag")  # of the files in a folder without metadata
RESULTS = ("run.json", "report.json")
UNNAMED = "log"  # what to call "...mcap": its stem ".." would lead results out of their folder


def log_files(path: Path) -> list[Path]:
    """Return the files of the log that `path` names: a file, a rosbag2 folder, or its metadata.yaml."""
    try:
        if not path.exists():
            raise UsageError(f"{path}: no such file or folder")
        if path.is_dir():
            return _folder(path)
        return _folder(path.parent) if path.name == "metadata.yaml" else [path]
    except OSError as problem:
        raise LocfuseError(f"{path}: cannot be read: {problem.strerror}") from None


def _folder(folder: Path) -> list[Path]:
    listed = [folder / name for name in _listed(folder / "metadata.yaml")]
    files = [file for file in listed if file.is_file()] or _by_ending(folder)
    if files:
        return files
    if any((folder / name).exists() for name in RESULTS):
        raise LocfuseError(f"{folder} is a locfuse result, not a log; see: locfuse view {folder}")
    raise LocfuseError(f"{folder}: no log in this folder (.mcap, .db3, .bag)")


def _by_ending(folder: Path) -> list[Path]:
    """Return the files of the first ending there are any of: kinds are not mixed."""
    return next(
        (files for ending in ENDINGS if (files := sorted(f for f in folder.glob(ending) if f.is_file()))),
        [],
    )


def _listed(metadata: Path) -> list[str]:
    """Return the files a rosbag2 metadata.yaml lists (after a crash there is none: then those of the folder)."""
    if not metadata.is_file():  # a pipe would never end
        return []
    text = read_small(metadata, MAX_METADATA).decode("utf-8", "replace")
    lines = iter(text.splitlines())
    if not any(line.strip() == "relative_file_paths:" for line in lines):
        return []
    entries = takewhile(lambda line: line.startswith("- "), map(str.strip, lines))
    listed = [Path(entry[2:].strip().strip("'\"")).name for entry in entries]
    return [name for given in listed for name in (given, f"{given}.zstd")]  # some versions leave the .zstd out


def log_name(paths: Sequence[Path]) -> str:
    """Return what to call the log: the file without its ending, or the folder."""
    first = paths[0].parent if paths[0].name == "metadata.yaml" else paths[0]
    name = first.resolve().name if first.is_dir() else Path(first.name.removesuffix(".zstd")).stem
    return writable(name) if name.strip(".") else UNNAMED


def open_source(file: Path, losses: Losses) -> Source:
    """Open one file of a log by what its first bytes say it is."""
    try:
        data = FileBytes(file, losses)
        if data.read(0, len(ZSTD_MAGIC)) == ZSTD_MAGIC:
            data = unpack_file(file, losses)
        head = data.read(0, 64)
        for magic, source in SOURCES.items():
            if head.startswith(magic):
                return source(data, losses)
        return McapSource(data, losses)  # which says what else the file is
    except OSError as problem:
        raise LocfuseError(f"{file}: cannot be read: {problem.strerror}") from None
