"""Remote objects (S3, GCS, Azure, HTTP) read like files with obstore: a block is downloaded on its first read.

Credentials come from the environment only (AWS_ACCESS_KEY_ID, ...). A stalled request is repeated MAX_RETRIES
times. Every error message has one line.
"""

from __future__ import annotations

import os
import re
import shutil
import tempfile
import weakref
from collections.abc import Iterable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from datetime import timedelta
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from locfuse.formats.inputs import identity
from locfuse.formats.whole_files import scratch_prefix
from locfuse.fusion.data import LocfuseError

from .file_bytes import WEB, FileBytes, Losses, Url

if TYPE_CHECKING:
    from obstore.store import ObjectStore

INSTALL = "pip install 'locfuse[remote]'"
CONNECT_S = 10.0
SILENCE_S = 20.0  # a connection that sends no byte for this time counts as stalled
REQUEST_S = 180.0  # limit of one whole request
MAX_RETRIES = 3
RETRY_S = 60.0  # limit of all retries of a request
METADATA_SERVICES = "/latest/api/token", "/latest/meta-data", "/computeMetadata/", "/metadata/identity"
CREDENTIALS = {
    "s3": "AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY (a public bucket: AWS_SKIP_SIGNATURE=true)",
    "gs": "GOOGLE_APPLICATION_CREDENTIALS",
    "az": "AZURE_STORAGE_ACCOUNT_NAME and AZURE_STORAGE_ACCOUNT_KEY",
}
LIST_PAGE_OBJECTS = 1000


@cache
def store(root: str) -> ObjectStore:
    """Return obstore's store for "s3://bucket" or "https://server". Raises LocfuseError if obstore is missing."""
    try:
        from obstore.exceptions import BaseError
        from obstore.store import HTTPStore, from_url
    except ImportError:
        raise LocfuseError(f"{root}: reading logs from there needs another package: {INSTALL}") from None
    endpoint = os.environ.get("AWS_ENDPOINT_URL_S3") or os.environ.get("AWS_ENDPOINT_URL") or ""
    client: Any = {
        "connect_timeout": timedelta(seconds=CONNECT_S),
        "read_timeout": timedelta(seconds=SILENCE_S),
        "timeout": timedelta(seconds=REQUEST_S),
        "allow_http": root.startswith("http:") or endpoint.startswith("http:"),  # the user wrote http:// himself
    }
    retry: Any = {"max_retries": MAX_RETRIES, "retry_timeout": timedelta(seconds=RETRY_S)}
    make: Any = HTTPStore.from_url if root.startswith(WEB) else from_url
    try:
        return make(root, client_options=client, retry_config=retry)  # type: ignore[no-any-return]
    except (BaseError, ValueError) as problem:
        raise LocfuseError(f"{root}: {_first_line(problem)}") from None


@contextmanager
def _one_line(url: Url) -> Iterator[None]:
    """Context manager: turns every obstore error into a LocfuseError of one line, with the fix."""
    from obstore.exceptions import BaseError, NotSupportedError, PermissionDeniedError, UnauthenticatedError

    try:
        yield
    except (BaseError, OSError) as problem:
        text, names = str(problem), CREDENTIALS.get(url.scheme[:2], "")
        if any(word in text for word in METADATA_SERVICES):  # obstore's last attempt to find credentials
            words = f"no credentials were found in the environment: set {names}"
        elif isinstance(problem, NotSupportedError):
            words = "its server does not answer for parts of a file; download it first"
        elif isinstance(problem, FileNotFoundError):
            words = "no such object (404)"
        elif isinstance(problem, PermissionDeniedError | PermissionError) or "403 Forbidden" in text:
            words = "access denied (403)" + (f": the credentials of {names} may not read it" if names else "")
        elif isinstance(problem, UnauthenticatedError):
            words = "not signed in (401)" + (f": set {names}" if names else "")
        elif "TimedOut" in text or "kind: Timeout" in text:
            words = f"the connection stalled; {MAX_RETRIES + 1} attempts of {SILENCE_S:g} s failed; try again"
        else:
            words = f"it cannot be read: {_first_line(problem)}"
        raise LocfuseError(f"{url}: {words}") from None


def _first_line(problem: BaseException) -> str:
    """Return an obstore error in one line, without request addresses and times, which differ each time."""
    line = " ".join(str(problem).partition("\n\nDebug source")[0].split())
    return re.sub(r"Error performing \w+ \S+ in [\d.]+\w+(, after .*?retry_timeout: \w+)?\s+- ", "", line)[:300]


def below(folder: Url) -> list[Url]:
    """Return all objects below a folder, sorted. Raises LocfuseError for a web server, which cannot list."""
    if folder.scheme in WEB:
        raise LocfuseError(f"{folder}: a web server has no list of its files; name each log, or use @list.txt")
    at, prefix = store(folder.root), folder.key if folder.is_folder else folder.key + "/"
    with _one_line(folder):
        import obstore

        found = list(obstore.list(at, prefix=prefix, chunk_size=LIST_PAGE_OBJECTS))
    return sorted(folder.at(entry["path"]) for chunk in found for entry in chunk)


class ObjectState(NamedTuple):
    """The version of an object: its size and ETag."""

    size: int  # bytes
    tag: str  # ETag; the time of the last change if the store has none


def state_of(url: Url) -> ObjectState:
    """Return the version of a remote object. Raises LocfuseError."""
    at = store(url.root)
    with _one_line(url):
        import obstore

        return _version(obstore.head(at, url.key))


def _version(meta: Mapping[str, Any]) -> ObjectState:
    return ObjectState(int(meta["size"]), str(meta["e_tag"] or meta["last_modified"]))


# --- Bytes of an object: a sparse temporary file of its size, into which blocks are downloaded on first read

BLOCK_BYTES = 32 * 1024
BLOCKS_TOGETHER = 128  # blocks of one request; a dropped connection loses at most these
REQUESTS_AT_ONCE = 16
TAIL_BYTES = 64 * 1024  # downloaded first: it holds the summary of most logs


class RemoteBytes(FileBytes):
    """Random access to one version of a remote object, with the interface of FileBytes."""

    def __init__(self, url: Url, losses: Losses) -> None:
        self._url = url
        state = state_of(url)
        if not state.size:
            raise LocfuseError(f"{url}: empty (0 bytes)")
        handle, name = tempfile.mkstemp(prefix=scratch_prefix())
        weakref.finalize(self, Path(name).unlink, missing_ok=True)
        os.truncate(handle, state.size)  # sparse: takes no space until blocks are written
        os.close(handle)
        super().__init__(Path(name), losses)
        self.path, self.far, self.state = url, True, state
        self._downloaded = np.zeros(-(-self.size // BLOCK_BYTES), bool)
        self.fetch([(self.size - TAIL_BYTES, self.size)])

    def read(self, at: int, n: int) -> bytes:
        """Return up to n bytes from `at` on (fewer at the end)."""
        if not self.far:
            return super().read(at, n)
        self.fetch([(at, at + n)])
        return self._pread(n, at)

    def fetch(self, spans: Iterable[tuple[int, int]]) -> None:
        """Download the missing blocks of these byte ranges (start, stop), with concurrent requests."""
        if not self.far:
            return
        wanted = np.zeros(len(self._downloaded), bool)
        for start, stop in spans:
            wanted[max(start, 0) // BLOCK_BYTES : max(-(-stop // BLOCK_BYTES), 0)] = True
        edges = np.flatnonzero(np.diff(wanted & ~self._downloaded, prepend=False, append=False)).tolist()
        requests = [
            (a * BLOCK_BYTES, min(min(a + BLOCKS_TOGETHER, last) * BLOCK_BYTES, self.size))
            for first, last in zip(edges[::2], edges[1::2], strict=True)
            for a in range(first, last, BLOCKS_TOGETHER)
        ]
        if requests:
            with ThreadPoolExecutor(min(REQUESTS_AT_ONCE, len(requests))) as threads:
                self.fetched += sum(threads.map(self._load, requests))
            self._downloaded |= wanted
            self._given = self._read = identity(self.where)

    def _load(self, span: tuple[int, int]) -> int:
        """Download a byte range; return its size [bytes]. Raises LocfuseError, also for a changed object."""
        at, (start, stop) = store(self._url.root), span
        with _one_line(self._url):
            import obstore

            options: Any = {"range": span}
            found = obstore.get(at, self._url.key, options=options)
            if _version(found.meta) != self.state:
                raise LocfuseError(f"{self._url}: it was replaced while it was read; start again")
            data = bytes(found.bytes())
        if len(data) != stop - start:
            raise LocfuseError(f"{self._url}: {len(data)} bytes came instead of {stop - start}; try again")
        try:
            with self.where.open("rb+", buffering=0) as file:
                os.pwrite(file.fileno(), data, start)
        except OSError as problem:
            words = problem.strerror or problem
            raise LocfuseError(f"{self._url}: cannot be copied to {self.where}: {words}") from None
        return len(data)

    def copy_here(self) -> None:
        """Download the whole object."""
        free = shutil.disk_usage(tempfile.gettempdir()).free
        if self.far and self.size > free:
            raise LocfuseError(
                f"{self.path}: {self.size / 1e6:.0f} MB must be copied to {tempfile.gettempdir()}, which has "
                f"{free / 1e6:.0f} MB left; set TMPDIR to a larger place"
            )
        self.fetch([(0, self.size)])
        self.far = False
