"""Objects in a store, by obstore: opening, ranges of bytes, listing. Every failure is one line.

Credentials come from the environment alone (AWS_ACCESS_KEY_ID, ...). No request waits for ever: a connection
that stalls is tried again some times and then given up.
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from datetime import timedelta
from functools import cache
from typing import TYPE_CHECKING, Any, NamedTuple

from locfuse.fusion.data import LocfuseError

from .remote_ranges import Span
from .url import WEB, Url

if TYPE_CHECKING:
    from obstore.store import ObjectStore

INSTALL = "pip install 'locfuse[remote]'"
AT_ONCE = 16  # requests
CONNECT_S = 10.0
SILENCE_S = 20.0  # without a byte: the connection has stalled
REQUEST_S = 180.0  # for one request in all
RETRIES = 3
RETRY_S = 60.0  # after which nothing is tried again
CLOUD_MACHINE = "/latest/api/token", "/latest/meta-data", "/computeMetadata/", "/metadata/identity"
CREDENTIALS = {
    "s3": "AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY (a public bucket: AWS_SKIP_SIGNATURE=true)",
    "gs": "GOOGLE_APPLICATION_CREDENTIALS",
    "az": "AZURE_STORAGE_ACCOUNT_NAME and AZURE_STORAGE_ACCOUNT_KEY",
}
LIST_ALL = 1000  # objects at a time


class State(NamedTuple):
    """Which state of an object was seen."""

    size: int  # bytes
    tag: str  # changes with the content: the store's ETag, or where there is none the time of the last change


def state_of(meta: Mapping[str, Any]) -> State:
    """Return the state that an answer of a store is of."""
    return State(int(meta["size"]), str(meta["e_tag"] or meta["last_modified"]))


class Object:
    """One object. What is read of it is of one state: the one of the first answer."""

    def __init__(self, url: Url) -> None:
        self.url = url
        self._store = store(url.root)
        self._state: State | None = None

    @property
    def state(self) -> State:
        """Size and tag of the object."""
        if self._state is None:
            self._see(self._asked(lambda obs: obs.head(self._store, self.url.key)))
        assert self._state is not None
        return self._state

    def tail(self, n: int) -> bytes:
        """Return the last n bytes, all where there are fewer."""
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
        """Return a range; errors are those of obstore but for what every request may meet."""
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
        """Raise LocfuseError where the object is not what it was."""
        found = state_of(meta)
        if self._state is None:
            self._state = found
        elif found != self._state:
            raise LocfuseError(f"{self.url}: it was replaced while it was read; start again")


def asked(url: Url, ask: Callable[[Any], Any]) -> Any:
    """Return what a store answers. Raises LocfuseError in one line."""
    import obstore
    from obstore.exceptions import BaseError

    try:
        return ask(obstore)
    except (BaseError, OSError) as problem:
        raise LocfuseError(f"{url}: {_words(problem, url)}") from None


def below(folder: Url) -> list[Url]:
    """Return all objects below a folder, by key. Raises LocfuseError where the store cannot list."""
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
    retry: Any = {"max_retries": RETRIES, "retry_timeout": timedelta(seconds=RETRY_S)}
    make: Any = HTTPStore.from_url if root.startswith(WEB) else from_url
    try:
        return make(root, client_options=client, retry_config=retry)  # type: ignore[no-any-return]
    except (BaseError, ValueError) as problem:
        raise LocfuseError(f"{root}: {_first_line(problem)}") from None


def _endpoint() -> str:
    return os.environ.get("AWS_ENDPOINT_URL_S3") or os.environ.get("AWS_ENDPOINT_URL") or ""


def _words(problem: BaseException, url: Url) -> str:
    """Return what went wrong in one line with what to do about it."""
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
        return f"the connection stalled; {RETRIES + 1} attempts of {SILENCE_S:g} s failed; try again"
    return f"it cannot be read: {_first_line(problem)}"


def _first_line(problem: BaseException) -> str:
    """Return the message of the store without addresses of requests and times, which are different every time."""
    line = " ".join(str(problem).partition("\n\nDebug source")[0].split())
    return re.sub(r"Error performing \w+ \S+ in [\d.]+\w+(, after .*?retry_timeout: \w+)?\s+- ", "", line)[:300]
