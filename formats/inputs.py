"""Input files: only regular files are read; changes are detected; locfuse never overwrites its own inputs."""

from __future__ import annotations

import csv
import io
import os
import stat
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple
from weakref import WeakKeyDictionary

from locfuse.fusion.data import LocfuseError

from .caps import refuse_above


class FileIdentity(NamedTuple):
    """Device, inode, size and modification time of a file."""

    device: int
    inode: int
    size: int  # bytes
    mtime_ns: int

    @property
    def file(self) -> tuple[int, int]:
        """Device and inode: they identify the file, and stay the same when the file's content changes."""
        return self.device, self.inode


_HELD: WeakKeyDictionary[object, tuple[int, int]] = WeakKeyDictionary()  # reader -> file
DESTROYS = "it is the input: to write there would destroy it; choose another name"


@contextmanager
def reading(name: object) -> Iterator[None]:
    """Context manager: turns an OSError while the file `name` is read into a LocfuseError of one line."""
    try:
        yield
    except OSError as problem:
        raise LocfuseError(f"{name}: cannot be read: {problem.strerror or problem}") from None


def identity(path: Path) -> FileIdentity:
    """Return device, inode, size and modification time of a file, to notice later that it was changed.

    Raises LocfuseError unless it is a regular file: a pipe never ends.
    """
    with reading(path):
        found = path.stat()
    if not stat.S_ISREG(found.st_mode):
        raise LocfuseError(f"{path}: not a regular file; copy its content to one first")
    return identity_of(found)


def identity_of(found: os.stat_result) -> FileIdentity:
    """Return device, inode, size and modification time of a file from its stat()."""
    return FileIdentity(found.st_dev, found.st_ino, found.st_size, found.st_mtime_ns)


def hold(reader: object, file: FileIdentity) -> None:
    """Protect a file from being overwritten by this process while `reader` exists."""
    _HELD[reader] = file.file


def refuse_to_write(path: Path) -> None:
    """Raise LocfuseError if `path` is a file that is being read, or not a regular file (such as a device)."""
    try:
        found = path.stat()
    except OSError:
        return
    if not stat.S_ISREG(found.st_mode):  # a renamed file would replace the device /dev/null
        raise LocfuseError(f"{path}: not a regular file, so that no result can take its place; name a file")
    if (found.st_dev, found.st_ino) in _HELD.values():
        raise LocfuseError(f"{path}: {DESTROYS}")


def is_among(path: Path, given: Iterable[Path]) -> bool:
    """Return whether `path` is one of the `given` files or directly in one of the `given` folders."""
    if not path.exists():
        return False
    files = (file for one in given for file in (one.iterdir() if one.is_dir() else (one,)))
    return any(file.exists() and file.samefile(path) for file in files)


def read_small(path: Path, cap: int) -> bytes:
    """Return the bytes of a regular file of at most `cap` bytes. Raises LocfuseError."""
    found = identity(path)
    refuse_above(str(path), found.size, cap, "bytes")
    with reading(path), path.open("rb") as file:
        return file.read(found.size)  # no more bytes if the file grows; file.read(cap) would allocate `cap` bytes


def csv_table(path: Path, cap: int) -> tuple[list[str], list[tuple[int, list[str]]]]:
    """Return the column names of a .csv, and (line number, values) of each further non-blank line.

    The names come from the first line, in lower case and without a "#" before them; [] for an empty file. Lines
    may end in any way.
    """
    text = read_small(path, cap).decode("utf-8", "replace").lstrip("\ufeff")
    rows = csv.reader(io.StringIO(text, newline=""))
    try:
        lines = [(rows.line_num, row) for row in rows if any(word.strip() for word in row)]
    except csv.Error as problem:
        raise LocfuseError(f"{path}: line {rows.line_num}: no .csv: {problem}") from None
    head = lines[0][1] if lines else []
    return [word.strip().lstrip("#").strip().lower() for word in head], lines[1:]
