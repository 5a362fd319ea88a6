"""Bytes of an object in a store: ranges on request, or a copy of all of it in a temporary file."""

from __future__ import annotations

import os
import shutil
import tempfile
import weakref
from collections.abc import Callable, Iterable
from pathlib import Path

from locfuse.formats.whole_files import scratch_prefix
from locfuse.fusion.data import LocfuseError

from .file_bytes import FileBytes
from .losses import Losses
from .remote_objects import Object, State
from .remote_ranges import Ranges, Span, cut, joined
from .url import Url

TAIL_BYTES = 64 * 1024  # fetched at once: the summary of most logs fits in
KEPT_BYTES = 64 * 1024 * 1024
COPIED_AT_ONCE = 8  # ranges that are in memory while an object is copied


class RemoteBytes(FileBytes):
    """Random access to an object (FileBytes is that to a file), until it is copied; then to the copy."""

    def __init__(self, url: Url, losses: Losses) -> None:  # not that of FileBytes: there is no file yet
        self.path = url
        self.losses = losses
        self.far = True
        self._object = Object(url)
        self._kept = Ranges(KEPT_BYTES)
        self.fetched = 0  # bytes that came over the network
        tail = self._object.tail(TAIL_BYTES)
        self._given_size = self.size = self._object.state.size
        self._take(self.size - len(tail), tail)
        self._packed: Path | None = None  # the copy, where it had to be unpacked

    @property
    def state(self) -> State:
        """Size and tag of the object."""
        return self._object.state

    @property
    def transfer(self) -> tuple[int, int]:
        """Bytes that came over the network, and the size of the object."""
        return self.fetched, self._given_size

    @property
    def all_read(self) -> bool:
        """Whether every byte was read: never said of an object, which is known by its tag."""
        return False

    def read(self, at: int, n: int) -> bytes:
        """Return up to n bytes from `at` on (fewer at the end)."""
        if not self.far:
            return super().read(at, n)
        start, stop = max(at, 0), min(at + n, self.size)
        if stop <= start:
            return b""
        found = self._kept.get(start, stop)
        if found is None:
            self.fetch([(start, stop)])
            found = self._kept.get(start, stop)
        return found if found is not None else b"".join(self._pieces([(start, stop)]))  # larger than what is kept

    def fetch(self, spans: Iterable[Span]) -> None:
        """Have these ranges at hand for the next reads: what lies close together in one request."""
        if self.far:
            inside = ((max(a, 0), min(b, self.size)) for a, b in spans)
            missing = [span for span in inside if self._kept.get(*span) is None]
            for _ in self._pieces(joined(missing)):
                pass

    def _pieces(self, spans: Iterable[Span]) -> Iterable[bytes]:
        for (start, _), data in self._object.read_all(list(cut(spans))):
            self._take(start, data)
            yield data

    def _take(self, start: int, data: bytes) -> None:
        self.fetched += len(data)
        self._kept.put(start, data)

    def copy_here(self) -> None:
        """Copy all of it into a temporary file, which is read from then on."""
        if self.far:
            self._read_from(self._copied())

    def unpacked(self, unpack: Callable[[Path], Path]) -> FileBytes:
        """Read from the temporary file that `unpack` makes of the copy from now on."""
        self.copy_here()
        self._packed = self.where
        self._read_from(unpack(self.where))
        return self

    def _read_from(self, file: Path) -> None:
        url = self.path
        super().__init__(file, self.losses)
        self.path = url
        self.far = False
        self._kept = Ranges(0)
        weakref.finalize(self, file.unlink, missing_ok=True)

    def _copied(self) -> Path:
        self._refuse_too_large()
        handle, name = tempfile.mkstemp(prefix=scratch_prefix())
        try:
            with os.fdopen(handle, "wb") as file:
                spans = list(cut([(0, self.size)]))
                for i in range(0, len(spans), COPIED_AT_ONCE):
                    for (start, _), data in self._object.read_all(spans[i : i + COPIED_AT_ONCE]):
                        self.fetched += len(data)
                        os.pwrite(file.fileno(), data, start)
        except OSError as problem:
            Path(name).unlink()
            raise LocfuseError(f"{self.path}: cannot be copied to {name}: {problem.strerror or problem}") from None
        except BaseException:
            Path(name).unlink()
            raise
        return Path(name)

    def _refuse_too_large(self) -> None:
        free = shutil.disk_usage(tempfile.gettempdir()).free
        if self.size > free:
            raise LocfuseError(
                f"{self.path}: {self.size / 1e6:.0f} MB must be copied to {tempfile.gettempdir()}, which has "
                f"{free / 1e6:.0f} MB left; set TMPDIR to a larger place"
            )

    def feed(self, take: Callable[[bytes], None]) -> None:
        """Give all bytes of the object as it is in the store, piece by piece."""
        self.copy_here()
        with (self._packed or self.where).open("rb") as file:
            while piece := file.read(1 << 20):
                take(piece)

    def still_the_same(self) -> None:
        """Nothing to ask: every range was checked to be of the same object, and nobody else knows the copy."""
