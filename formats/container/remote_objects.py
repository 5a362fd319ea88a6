"""Objects in a store, by obstore: opening, ranges of bytes, listing. Every failure is one line.

Credentials come from the environment alone (AWS_ACCESS_KEY_ID, ...). No request waits for ever: a connection
that stalls is tried again some times and then given up.
"""

from __future__ import annotations

import os
import re
import shutil
import tempfile
import weakref
from bisect import bisect_right, insort
from collections import OrderedDict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from datetime import timedelta
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from locfuse.formats.whole_files import scratch_prefix
from locfuse.fusion.data import LocfuseError

from .file_bytes import FileBytes
from .losses import Losses
from .url import WEB, Url

if TYPE_CHECKING:
    from obstore.store import ObjectStore

Span = tuple[int, int]  # start, stop [bytes]

MAX_GAP_BYTES = 32 * 1024  # between two ranges that are fetched together: a request costs more than these
MAX_TOGETHER_BYTES = 8 * 1024 * 1024  # of one request: a dropped connection loses no more


def joined(spans: Iterable[Span], gap: int = MAX_GAP_BYTES) -> Iterator[Span]:
    """Yield ranges that cover all `spans`, with close ones joined."""
    start = stop = -1
    for a, b in sorted(spans):
        if stop >= 0 and a - stop <= gap and max(b, stop) - start <= MAX_TOGETHER_BYTES:
            stop = max(stop, b)
            continue
        if stop > start:
            yield start, stop
        start, stop = a, b
    if stop > start:
        yield start, stop


def cut(spans: Iterable[Span], size: int = MAX_TOGETHER_BYTES) -> Iterator[Span]:
    """Yield the same bytes in ranges of at most `size`."""
    for start, stop in spans:
        for at in range(start, stop, size):
            yield at, min(at + size, stop)


class Ranges:
    """Cached ranges up to a number of bytes; the least recently used go first."""

    def __init__(self, capacity: int) -> None:
        self.capacity = capacity
        self._held: OrderedDict[int, bytes] = OrderedDict()  # start -> bytes, least recently used first
        self._starts: list[int] = []
        self._size = 0

    def put(self, start: int, data: bytes) -> None:
        """Keep the bytes from `start` on."""
        known = self._held.get(start)
        if known is not None and len(known) >= len(data):
            self._held.move_to_end(start)
            return
        if known is None:
            insort(self._starts, start)
        self._size += len(data) - len(known or b"")
        self._held[start] = data
        self._held.move_to_end(start)
        while self._size > self.capacity and len(self._held) > 1:
            gone, old = self._held.popitem(last=False)
            self._starts.remove(gone)
            self._size -= len(old)

    def get(self, start: int, stop: int) -> bytes | None:
        """Return the bytes of a range, None if some of them are not cached."""
        pieces: list[bytes] = []
        while start < stop:
            i = bisect_right(self._starts, start) - 1
            first = self._starts[i] if i >= 0 else start
            data = self._held.get(first, b"")
            if start >= first + len(data):
                return None
            self._held.move_to_end(first)
            pieces.append(data[start - first : stop - first])
            start += len(pieces[-1])
        return pieces[0] if len(pieces) == 1 else b"".join(pieces)


# --- Objects in a store, by obstore

INSTALL = "pip install 'locfuse[remote]'"
AT_ONCE = 16  # requests
CONNECT_S = 10.0
SILENCE_S = 20.0  # without a byte: the connection has stalled
REQUEST_S = 180.0  # for one request in all
MAX_RETRIES = 3
RETRY_S = 60.0  # after which nothing is tried again
CLOUD_MACHINE = "/latest/api/token", "/latest/meta-data", "/computeMetadata/", "/metadata/identity"
CREDENTIALS = {
    "s3": "AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY (a public bucket: AWS_SKIP_SIGNATURE=true)",
    "gs": "GOOGLE_APPLICATION_CREDENTIALS",
    "az": "AZURE_STORAGE_ACCOUNT_NAME and AZURE_STORAGE_ACCOUNT_KEY",
}
LIST_ALL = 1000  # objects at a time


class ObjectState(NamedTuple):
    """One version of an object: its size and tag."""

    size: int  # bytes
    tag: str  # changes with the content: the store's ETag, or where there is none the time of the last change


def state_of(meta: Mapping[str, Any]) -> ObjectState:
    """Return the version of an object by a store's answer."""
    return ObjectState(int(meta["size"]), str(meta["e_tag"] or meta["last_modified"]))


class Object:
    """One object; all reads are of one version: that of the first answer."""

    def __init__(self, url: Url) -> None:
        self.url = url
        self._store = store(url.root)
        self._state: ObjectState | None = None

    @property
    def state(self) -> ObjectState:
        """Size and tag of the object."""
        if self._state is None:
            self._see(self._asked(lambda obs: obs.head(self._store, self.url.key)))
        assert self._state is not None
        return self._state

    def tail(self, n: int) -> bytes:
        """Return the last n bytes, or all if there are fewer."""
        import obstore.exceptions as problems

        try:
            return self._get({"suffix": n})
        except problems.BaseError as problem:
            unsupported = isinstance(problem, problems.NotSupportedError)  # Azure knows no ranges from the end
            if not unsupported and "416" not in str(problem):  # a range of nothing
                raise LocfuseError(f"{self.url}: {_words(problem, self.url)}") from None
            size = self.state.size
        if not size:
            raise LocfuseError(f"{self.url}: empty (0 bytes)")
        return self.read((max(size - n, 0), size))

    def read(self, span: Span) -> bytes:
        """Return a range of bytes."""
        import obstore.exceptions as problems

        try:
            data = self._get(span)
        except problems.NotSupportedError:
            raise LocfuseError(
                f"{self.url}: its server does not answer for parts of a file; download it first"
            ) from None
        except problems.BaseError as problem:
            raise LocfuseError(f"{self.url}: {_words(problem, self.url)}") from None
        if len(data) != span[1] - span[0]:
            raise LocfuseError(f"{self.url}: {len(data)} bytes came instead of {span[1] - span[0]}; try again")
        return data

    def read_all(self, spans: Sequence[Span]) -> Iterator[tuple[Span, bytes]]:
        """Yield ranges with their bytes, several of them fetched at once."""
        if len(spans) < 2:
            yield from ((span, self.read(span)) for span in spans)
            return
        with ThreadPoolExecutor(min(AT_ONCE, len(spans))) as threads:
            yield from zip(spans, threads.map(self.read, spans), strict=True)

    def _get(self, span: Span | Mapping[str, int]) -> bytes:
        """Return a range; raises errors of obstore, except those that any request may meet."""
        import obstore

        try:
            options: Any = {"range": span}
            found = obstore.get(self._store, self.url.key, options=options)
            self._see(found.meta)
            return bytes(found.bytes())
        except (FileNotFoundError, PermissionError) as problem:
            raise LocfuseError(f"{self.url}: {_words(problem, self.url)}") from None

    def _asked(self, ask: Callable[[Any], Any]) -> Any:
        return asked(self.url, ask)

    def _see(self, meta: Mapping[str, Any]) -> None:
        """Raise LocfuseError if the object has changed."""
        found = state_of(meta)
        if self._state is None:
            self._state = found
        elif found != self._state:
            raise LocfuseError(f"{self.url}: it was replaced while it was read; start again")


def asked(url: Url, ask: Callable[[Any], Any]) -> Any:
    """Return a store's answer. Raises LocfuseError in one line."""
    import obstore
    from obstore.exceptions import BaseError

    try:
        return ask(obstore)
    except (BaseError, OSError) as problem:
        raise LocfuseError(f"{url}: {_words(problem, url)}") from None


def below(folder: Url) -> list[Url]:
    """Return all objects below a folder, by key. Raises LocfuseError if the store cannot list."""
    if folder.scheme in WEB:
        raise LocfuseError(f"{folder}: a web server has no list of its files; name each log, or use @list.txt")
    prefix = folder.key if folder.is_folder else folder.key + "/"
    found = asked(folder, lambda obs: list(obs.list(store(folder.root), prefix=prefix, chunk_size=LIST_ALL)))
    return sorted(folder.at(entry["path"]) for chunk in found for entry in chunk)


@cache
def store(root: str) -> ObjectStore:
    """Return the store of "s3://bucket" or "https://server". Raises LocfuseError without obstore."""
    try:
        from obstore.exceptions import BaseError
        from obstore.store import HTTPStore, from_url
    except ImportError:
        raise LocfuseError(f"{root}: reading logs from there needs another package: {INSTALL}") from None
    plain = root.startswith("http:") or _endpoint().startswith("http:")
    client: Any = {
        "connect_timeout": timedelta(seconds=CONNECT_S),
        "read_timeout": timedelta(seconds=SILENCE_S),
        "timeout": timedelta(seconds=REQUEST_S),
        "allow_http": plain,  # the user wrote http:// himself
    }
    retry: Any = {"max_retries": MAX_RETRIES, "retry_timeout": timedelta(seconds=RETRY_S)}
    make: Any = HTTPStore.from_url if root.startswith(WEB) else from_url
    try:
        return make(root, client_options=client, retry_config=retry)  # type: ignore[no-any-return]
    except (BaseError, ValueError) as problem:
        raise LocfuseError(f"{root}: {_first_line(problem)}") from None


def _endpoint() -> str:
    return os.environ.get("AWS_ENDPOINT_URL_S3") or os.environ.get("AWS_ENDPOINT_URL") or ""


def _words(problem: BaseException, url: Url) -> str:
    """Return an error of a store in one line, with its fix."""
    from obstore.exceptions import PermissionDeniedError, UnauthenticatedError

    text = str(problem)
    names = CREDENTIALS.get(url.scheme[:2], "")
    if any(word in text for word in CLOUD_MACHINE):  # where a machine of the cloud would get some: the last resort
        return f"no credentials were found in the environment: set {names}"
    if isinstance(problem, FileNotFoundError):
        return "no such object (404)"
    if isinstance(problem, PermissionDeniedError | PermissionError) or "403 Forbidden" in text:
        return "access denied (403)" + (f": the credentials of {names} may not read it" if names else "")
    if isinstance(problem, UnauthenticatedError):
        return "not signed in (401)" + (f": set {names}" if names else "")
    if "TimedOut" in text or "kind: Timeout" in text:
        return f"the connection stalled; {MAX_RETRIES + 1} attempts of {SILENCE_S:g} s failed; try again"
    return f"it cannot be read: {_first_line(problem)}"


def _first_line(problem: BaseException) -> str:
    """Return the message of the store without request addresses and times, which always differ."""
    line = " ".join(str(problem).partition("\n\nDebug source")[0].split())
    return re.sub(r"Error performing \w+ \S+ in [\d.]+\w+(, after .*?retry_timeout: \w+)?\s+- ", "", line)[:300]


# --- Bytes of an object: ranges on request, or a copy of all of it in a temporary file

TAIL_BYTES = 64 * 1024  # fetched at once: the summary of most logs fits in
KEPT_BYTES = 64 * 1024 * 1024
COPIED_AT_ONCE = 8  # ranges that are in memory while an object is copied


class RemoteBytes(FileBytes):
    """Random access to an object, as FileBytes for a file; after a copy, access to the copy."""

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
    def state(self) -> ObjectState:
        """Size and tag of the object."""
        return self._object.state

    @property
    def transfer(self) -> tuple[int, int]:
        """Bytes that came over the network, and the size of the object."""
        return self.fetched, self._given_size

    @property
    def all_read(self) -> bool:
        """Whether every byte was read: always False for an object, which is identified by its tag."""
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
        """Load these ranges for the next reads: close ones in one request."""
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
        """Read from now on the temporary file that `unpack` makes of the copy."""
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
        """Pass all bytes of the object, as they are in the store, piece by piece."""
        self.copy_here()
        with (self._packed or self.where).open("rb") as file:
            while piece := file.read(1 << 20):
                take(piece)

    def still_the_same(self) -> None:
        """Do nothing: every range was checked to be of the same version, and the copy is private."""
