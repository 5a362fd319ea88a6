"""The places of a log's files (paths, addresses of remote objects), their bytes at any offset, and their losses.

Memory is bounded. Losses are the parts of a log that cannot be read.
"""

from __future__ import annotations

import os
import re
import weakref
import zlib
from collections.abc import Callable, Iterable
from pathlib import Path
from urllib.parse import unquote

import msgspec
from msgspec.structs import replace

from locfuse.formats import inputs
from locfuse.fusion.data import LocfuseError, UsageError

SCHEMES = ("s3", "s3a", "gs", "az", "adl", "azure", "abfs", "abfss", "http", "https")
ADDRESS = re.compile(r"(?P<scheme>[a-z][a-z0-9+.-]*)://(?P<place>[^/?#]*)(?P<key>.*)", re.DOTALL)
WEB = ("http", "https")


class Url(msgspec.Struct, frozen=True, order=True):
    """Address of one remote object; an address that ends in "/" is that of a folder of objects."""

    text: str

    def __post_init__(self) -> None:
        """Raise UsageError for an unknown scheme, a password, a query or a missing host."""
        if self.scheme not in SCHEMES:
            raise UsageError(f"{self.scheme}://: unknown; logs are read from {', '.join(SCHEMES)}")
        if "@" in self.host and self.scheme in WEB:
            raise UsageError(f"{self.scheme}://...@{self.host.rpartition('@')[2]}: no passwords in addresses")
        if self.scheme in WEB and re.search(r"[?#]", self.text):
            raise UsageError(
                f"{self.text.partition('?')[0]}: an address with ? or # is not read; give a plain one"
            )
        if not self.host:
            raise UsageError(f"{self.text}: which bucket or server? Write it like s3://bucket/drive.mcap")

    @property
    def scheme(self) -> str:
        """The scheme: "s3", "https", ..."""
        return self.text.partition("://")[0]

    @property
    def root(self) -> str:
        """The address of the bucket or server: "s3://bucket"."""
        return f"{self.scheme}://{self.host}"

    @property
    def host(self) -> str:
        """The name of the bucket or server."""
        return re.split(r"[/?#]", self.text.partition("://")[2])[0]

    @property
    def key(self) -> str:
        """The path of the object in its bucket or server, without a leading "/"."""
        key = self.text.removeprefix(self.root).lstrip("/")
        return unquote(key) if self.scheme in WEB else key

    @property
    def name(self) -> str:
        """The last part of the key."""
        return self.key.rstrip("/").rpartition("/")[2]

    @property
    def parent(self) -> Url:
        """The folder of this object."""
        return Url(self.text.rstrip("/").rpartition("/")[0] + "/")

    @property
    def is_folder(self) -> bool:
        """Whether this is the address of a folder."""
        return self.text.endswith("/") or not self.key

    def at(self, key: str) -> Url:
        """Return the object with another key in the same bucket or server."""
        return Url(f"{self.root}/{key}")

    def __str__(self) -> str:
        """Return the address as given."""
        return self.text


Place = Path | Url  # a local file or a remote object


def is_url(word: str) -> bool:
    """Return whether a command-line argument is an address (scheme://...)."""
    return ADDRESS.fullmatch(word) is not None


def place(word: str) -> Place:
    """Return a command-line argument as a local path or an address. Raises UsageError for an invalid address."""
    return Url(word) if is_url(word) else Path(word)


class Loss(msgspec.Struct, frozen=True):
    """One unreadable place of one file."""

    path: str
    reason: str
    bytes: int  # unusable bytes of the file
    messages: int | None = None  # None where the number is unknown
    of_settings: bool = False  # only the settings in the log cannot be read; all messages can


class Losses(msgspec.Struct):
    """All losses of a log; a place counts once, even if it is read twice."""

    places: dict[tuple[str, str, int], Loss] = {}  # (path, reason, offset) -> loss

    def add(self, path: str, reason: str, offset: int, n_bytes: int, messages: int | None = None) -> None:
        """Record the loss of `n_bytes` from `offset` on."""
        self.places.setdefault((path, reason, offset), Loss(path, reason, n_bytes, messages))

    def add_settings(self, path: str, reason: str) -> None:
        """Record that the settings in the log cannot be read."""
        self.places.setdefault((path, reason, 0), Loss(path, reason, 0, 0, of_settings=True))

    def explain_settings(self, reason: str, words: str) -> None:
        """Replace the `reason` of losses of settings by better `words`."""
        for place, loss in self.places.items():
            if loss.reason == reason:
                self.places[place] = replace(loss, reason=words, of_settings=True)

    def __bool__(self) -> bool:
        return bool(self.places)

    @property
    def recoverable(self) -> bool:
        """Whether more than settings is lost (bytes, messages or an end mark), so that `locfuse recover` helps."""
        return any(not loss.of_settings for loss in self.places.values())

    @property
    def bytes(self) -> int:
        """Number of lost bytes."""
        return sum(loss.bytes for loss in self.places.values())

    @property
    def messages(self) -> int:
        """Number of lost messages, where known."""
        return sum(loss.messages or 0 for loss in self.places.values())

    def by_reason(self) -> dict[str, dict[str, int]]:
        """Return reason -> {places, bytes, messages}, for reports."""
        table: dict[str, dict[str, int]] = {}
        for loss in self.places.values():
            row = table.setdefault(loss.reason, {"places": 0, "bytes": 0, "messages": 0})
            row["places"] += 1
            row["bytes"] += loss.bytes
            row["messages"] += loss.messages or 0
        return table

    def lines(self) -> list[str]:
        """Return the losses as text, one line per file and reason."""
        groups: dict[str, list[Loss]] = {}
        for loss in self.places.values():
            groups.setdefault(f"{loss.path}: {loss.reason}", []).append(loss)
        lines = []
        for line, losses in groups.items():
            n_bytes = sum(loss.bytes for loss in losses)
            known = [loss.messages for loss in losses if loss.messages is not None]
            parts = [f"{len(losses)} places"] if len(losses) > 1 else []
            parts += [f"{n_bytes} bytes"] if n_bytes else []
            parts += [f"{sum(known)} message{'' if sum(known) == 1 else 's'}"] if known else []
            lines.append(f"{line} ({', '.join(parts)})" if parts else line)
        return lines


MIN_WINDOW_BYTES = 1 << 12  # read-ahead after a jump, for example to the next chunk header
WINDOW_BYTES = 1 << 18  # read-ahead in sequential reads
WRITTEN_TO = "the file was written to while it was read: what was read may not fit together"


class FileBytes:
    """Random access to a file, with a read-ahead window: memory holds at most the request and the window.

    The file is opened for each read (some microseconds), so that nothing needs to be closed. A replaced file
    raises an error. While this object exists, locfuse does not overwrite the file. A compressed file is unpacked
    to a temporary file, which is deleted with this object.
    """

    def __init__(self, path: Path, losses: Losses) -> None:
        self.path: Place = path  # name in messages
        self.losses = losses
        self.far = False  # whether every read is a request over the network
        self.state: tuple[int, str] | None = None  # version of a remote object: size [bytes] and ETag
        self.fetched = 0  # bytes that came over the network
        self._file = path
        self._given = inputs.identity(path)
        self._spans: set[tuple[int, int]] = set()  # ranges that were read, (start, stop)
        inputs.hold(self, self._given)
        self._read_from(path)

    def _read_from(self, where: Path) -> None:
        self.where = where  # local file with the bytes
        self._read = inputs.identity(where)
        self.size = self._read.size
        self._start = 0
        self._window = b""
        self._ahead = MIN_WINDOW_BYTES

    def read(self, at: int, n: int) -> bytes:
        """Return up to n bytes from `at` on (fewer at the end of the file)."""
        if n > WINDOW_BYTES:
            return self._pread(n, at)
        offset = at - self._start
        if not 0 <= offset <= len(self._window) - n:
            follows = 0 <= offset <= len(self._window)
            self._ahead = min(2 * self._ahead, WINDOW_BYTES) if follows else MIN_WINDOW_BYTES
            self._window = self._pread(max(n, self._ahead), at)
            self._start, offset = at, 0
        return self._window[offset : offset + n]

    def fetch(self, spans: Iterable[tuple[int, int]]) -> None:
        """Download the byte ranges (start, stop) of a remote file; does nothing for a local one."""

    def copy_here(self) -> None:
        """Download all bytes of a remote file; does nothing for a local one."""

    def use_unpacked(self, temporary: Path) -> None:
        """Read the unpacked bytes from this temporary file from now on. The file is deleted with this object."""
        self._read_from(temporary)
        weakref.finalize(self, temporary.unlink, missing_ok=True)

    def lose(self, reason: str, offset: int, n_bytes: int, messages: int | None = None) -> None:
        """Record the loss of `n_bytes` of this file from `offset` on."""
        self.losses.add(str(self.path), reason, offset, n_bytes, messages)

    @property
    def read_bytes(self) -> int:
        """The number of distinct bytes that were read."""
        total = end = 0
        for start, stop in sorted(self._spans):
            total += max(stop - max(start, end), 0)
            end = max(end, stop)
        return total

    @property
    def all_read(self) -> bool:
        """Whether every byte of a local file was read.

        False for a remote object, since its ETag identifies its content.
        """
        whole = self.where != self._file or self.read_bytes >= self.size  # unpacking reads the whole file
        return whole and self.state is None

    def crc32(self, start: int, stop: int) -> int:
        """Return the CRC-32 of the bytes from `start` up to `stop`."""
        crc = 0
        for at in range(start, stop, WINDOW_BYTES):
            crc = zlib.crc32(self._pread(min(WINDOW_BYTES, stop - at), at), crc)
        return crc

    def feed(self, take: Callable[[bytes], None]) -> None:
        """Pass the original (perhaps compressed) bytes of the file to `take`, at most 1 MiB at a time."""
        self.copy_here()
        with inputs.reading(self.path), self._file.open("rb") as file:
            self._compare(inputs.identity_of(os.fstat(file.fileno())), self._given)
            while piece := file.read(1 << 20):
                take(piece)

    def check_unchanged(self) -> None:
        """Raise LocfuseError if the file was replaced by another; record a loss if it was written to."""
        self._compare(inputs.identity(self._file), self._given)

    def _pread(self, n: int, at: int) -> bytes:
        with inputs.reading(self.path), self.where.open("rb", buffering=0) as file:
            if (now := inputs.identity_of(os.fstat(file.fileno()))) != self._read:
                self._compare(now, self._read)
            data = os.pread(file.fileno(), n, at)
        self._spans.add((at, at + len(data)))
        return data

    def _compare(self, now: inputs.FileIdentity, then: inputs.FileIdentity) -> None:
        if now.file != then.file:
            raise LocfuseError(f"{self.path}: it was replaced by another file while it was read; start again")
        if now != then:
            self.lose(WRITTEN_TO, 0, 0)
