"""A web server on the loopback that answers for ranges of bytes, and misbehaves where a test wants it to."""

import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any
from urllib.parse import parse_qs, unquote
from xml.sax.saxutils import escape


@dataclass
class Shelf:
    """What a server offers, and what was asked of it."""

    files: dict[str, bytes] = field(default_factory=dict)  # by path without the leading "/"
    tags: dict[str, str] = field(default_factory=dict)
    asked: list[tuple[str, int, int]] = field(default_factory=list)  # path, start, stop of every answer
    refuse: dict[str, int] = field(default_factory=dict)  # path -> status
    stall: set[str] = field(default_factory=set)  # paths of which no byte ever comes
    drop: set[str] = field(default_factory=set)  # paths of which only the first bytes come
    whole: bool = False  # knows no ranges
    root: str = ""  # http://127.0.0.1:port
    over: threading.Event = field(default_factory=threading.Event)

    def put(self, path: str, data: bytes, tag: str = "one") -> str:
        """Offer a file and return its address."""
        self.files[path], self.tags[path] = data, tag
        return f"{self.root}/{path}"

    @property
    def sent(self) -> int:
        """Bytes of all answers."""
        return sum(stop - start for _, start, stop in self.asked)


class Handler(BaseHTTPRequestHandler):
    """Answers GET and HEAD from the shelf of its server."""

    protocol_version = "HTTP/1.1"
    shelf: Shelf

    def log_message(self, *_: Any) -> None:
        """Print nothing."""

    def do_GET(self) -> None:
        shelf = self.shelf
        path, _, query = self.path.lstrip("/").partition("?")
        path = unquote(path)
        if "list-type=2" in query:
            self._list(path, parse_qs(query).get("prefix", [""])[0])
            return
        if path not in shelf.files or path in shelf.refuse:
            self._head(shelf.refuse.get(path, 404), 0)
            return
        data = shelf.files[path]
        wanted = None if shelf.whole else self.headers.get("Range")
        start, stop = (0, len(data)) if wanted is None else _range(wanted, len(data))
        if wanted is not None and start >= stop:
            self._head(416, 0)
            return
        self._head(200 if wanted is None else 206, stop - start, path, f"bytes {start}-{stop - 1}/{len(data)}")
        if self.command == "GET":
            shelf.asked.append((path, start, stop))
            self._send(path, data[start:stop])

    do_HEAD = do_PUT = do_GET

    def _list(self, bucket: str, prefix: str) -> None:
        """Answer as S3 does (ListObjectsV2)."""
        found = [path for path in sorted(self.shelf.files) if path.startswith(f"{bucket}/{prefix}")]
        when = "2026-11-01T00:00:00.000Z"
        entries = "".join(
            f"<Contents><Key>{escape(key)}</Key><Size>1</Size><LastModified>{when}</LastModified></Contents>"
            for key in (path.removeprefix(f"{bucket}/") for path in found)
        )
        body = f"<ListBucketResult><IsTruncated>false</IsTruncated>{entries}</ListBucketResult>".encode()
        self._head(200, len(body))
        self.wfile.write(body)

    def _head(self, status: int, length: int, path: str = "", content_range: str = "") -> None:
        self.send_response(status)
        self.send_header("Content-Length", str(length))
        if path:
            self.send_header("ETag", f'"{self.shelf.tags[path]}"')
            self.send_header("Last-Modified", "Sun, 01 Nov 2026 00:00:00 GMT")
        if status == 206:
            self.send_header("Content-Range", content_range)
        self.end_headers()

    def _send(self, path: str, data: bytes) -> None:
        if path in self.shelf.stall:
            self.shelf.over.wait(60)
        with suppress(ConnectionError):  # who asked has gone
            self.wfile.write(data[:5] if path in self.shelf.drop else data)
        if path in self.shelf.drop:
            self.close_connection = True


def _range(wanted: str, size: int) -> tuple[int, int]:
    first, last = wanted.removeprefix("bytes=").split("-")
    if not first:
        return max(size - int(last), 0), size
    return int(first), min(int(last) + 1, size) if last else size


@contextmanager
def serving() -> Iterator[Shelf]:
    """Serve from a free port of 127.0.0.1 until the block ends."""
    shelf = Shelf()
    server = ThreadingHTTPServer(("127.0.0.1", 0), type("Ours", (Handler,), {"shelf": shelf}))
    server.daemon_threads = True
    shelf.root = f"http://127.0.0.1:{server.server_port}"
    thread = threading.Thread(target=server.serve_forever, args=(0.05,), daemon=True)
    thread.start()
    try:
        yield shelf
    finally:
        shelf.over.set()
        server.shutdown()
        server.server_close()
