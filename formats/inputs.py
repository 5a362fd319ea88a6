"""Input files: caps on their size and complexity, regular files only, never overwritten by locfuse.

The caps are far above real logs, against malicious files. The number of bytes alone does not limit the work: 24 kB
of zstd hold millions of empty records, and 3 kB of text define a message of 10^8 fields. So counts, nesting and
repetition have caps too. An input above a cap raises an error of one line that names the cap. If the rest of the
log is readable, a loss is recorded instead.
"""

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

# bytes
MAX_CHUNK = 256 * 1024 * 1024  # of one chunk, compressed or not; writers use 1 to 8 MiB
MAX_MESSAGE = 64 * 1024 * 1024  # of one message
MAX_LONG = 64 * 1024 * 1024  # of all messages of a topic that are longer than 64 KiB and read into columns
MAX_TEXT = 4 * 1024 * 1024  # of one string in a message; a robot's description has some hundred thousand
MAX_ATTACHMENT = 16 * 1024 * 1024  # larger attachments stay in the file
MAX_ROBOT_TOML = 128 * 1024  # `locfuse init` writes 5 kB
MAX_TEXT_FILE = 256 * 1024 * 1024  # a trajectory or detections: an hour at 100 Hz is 40 MB
MAX_METADATA = 4 * 1024 * 1024  # metadata.yaml of a rosbag2 folder; a bag of 10 000 files has 1 MB
MAX_MAP_FILE = 64 * 1024 * 1024  # a line map: 150 bytes a wall
MAX_MAP_PICTURE = 129 * 1024 * 1024  # a map image: 2 bytes for each of MAX_MAP_PIXELS, and the header
MAX_WALLS = 3000  # of a line map: their covariance takes 0.7 GiB and grows with the square of the number
MAX_REPORT = 64 * 1024 * 1024  # report.json; over an hour's drive it has 100 kB

# structure of a file
FREE_RECORDS = 4096  # records accepted in any chunk; each further one needs a compressed byte
MAX_TOPICS = 10_000  # topics of a log; a busy robot has 500
MAX_DATABASE_SECONDS = 20.0  # CPU time of one sqlite step; a row takes microseconds

# structure of a message definition
MAX_DEFINITION = 256 * 1024  # bytes; the longest of ROS (a planning scene) has 70 kB
MAX_DEFINITION_LINES = 4096  # without blank and comment lines; a planning scene has 1000
MAX_EXPRESSIONS = 1024  # of IDL (array lengths, constants, annotations); each takes 2 to 5 ms to parse
MAX_DEPTH = 32  # of nested structures
MAX_FIELDS = 10_000  # of a message, with those of nested messages at every use

# structure of a message
MAX_ITEMS = 100_000  # strings, arrays and structures decoded one by one

# structure of a robot's description
MAX_KEYS = 4096  # of a robot.toml
MAX_KEY_DEPTH = 16  # of nested tables in a robot.toml
MAX_DOTS = 500  # in a line of a robot.toml: the time to parse a dotted key grows with the square of its parts
MAX_JOINTS = 10_000  # of a URDF
MAX_TRANSFORMS = 10_000  # child frames of /tf_static


def names_its_cap(what: str, found: float, cap: float, unit: str = "") -> str:
    """Return the error text for an input above its cap: "what: 12 units, more than the cap of 10 units"."""
    units = f" {unit}" if unit else ""
    return f"{what}: {_grouped(found)}{units}, more than the cap of {_grouped(cap)}"


def refuse_above(
    what: str, found: float, cap: float, unit: str = "", error: type[Exception] = LocfuseError
) -> None:
    """Raise `error` with the text of `names_its_cap` if the input `found` is above its `cap`."""
    if found > cap:
        raise error(names_its_cap(what, found, cap, unit))


def _grouped(number: float) -> str:
    return f"{number:,.0f}".replace(",", " ")


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
