"""OpenCV, imported in one place, so that its limits are set before it reads its first byte.

Importing this module costs 60 ms and more: import it (or what imports it: images, panorama, radial, preview)
only inside functions that really look at a picture.
"""

from __future__ import annotations

import os
import re
import tempfile
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TypeVar

# A 5 kB JPEG can claim 20000 x 20000 pixels. An 8K frame (7680 x 4320) still fits: 100 MB decoded.
# images.py holds every header to the same cap, whoever imported OpenCV first.
MAX_PIXELS = 2**25
MAX_MAP_PIXELS = 2**26  # of a map: 400 m x 400 m in cells of 5 cm
os.environ.setdefault("OPENCV_IO_MAX_IMAGE_PIXELS", str(MAX_MAP_PIXELS))  # the larger: it is of the whole process

import cv2  # noqa: E402

# One picture per core (camera.py) beats many cores per picture, and keeps results free of the core count.
cv2.setNumThreads(1)

__all__ = ["MAX_MAP_PIXELS", "MAX_PIXELS", "cv2", "listened", "tells_of_damage"]


# ---- messages of the picture libraries about damaged pictures: kept off the terminal, and recognised ----
#
# libjpeg returns a picture of damaged data as if it were whole and says so only on the process' stderr. While a
# picture is decoded, that stream leads to a file in memory; what arrives there tells which picture is damaged.

T = TypeVar("T")
STDERR = 2
# a few bytes too many in front of the end mark: some cameras pad so, and the picture in front of them is whole;
# many are what a decoder that lost its place has left over
PADDING = re.compile(rb"(\d+) extraneous bytes before marker 0xd9")
MAX_PADDING_BYTES = 15


class _Listener:
    """Redirects stderr to a file while pictures are decoded."""

    def __init__(self) -> None:
        self._change = threading.Condition()
        self._decoding = 0
        self._saved = -1
        self._file = -1
        self.heard = 0  # bytes of the file whose picture is known

    @contextmanager
    def listening(self, alone: bool) -> Iterator[int]:
        """Let a thread decode: beside others, or alone, so that each message on stderr belongs to one picture."""
        with self._change:
            while alone and self._decoding:
                self._change.wait()
            file = self._enter()
            if alone:  # no other thread enters while the lock is held
                try:
                    yield file
                finally:
                    self._leave()
                return
        try:
            yield file
        finally:
            with self._change:
                self._leave()

    def _enter(self) -> int:
        if self._file < 0:
            with tempfile.TemporaryFile() as file:
                self._file = os.dup(file.fileno())  # stays as long as the process
        if not self._decoding:
            self._saved = os.dup(STDERR)
            os.dup2(self._file, STDERR)
        self._decoding += 1
        return self._file

    def _leave(self) -> None:
        self._decoding -= 1
        if not self._decoding:
            os.dup2(self._saved, STDERR)
            os.close(self._saved)
            self._change.notify_all()


_LISTENER = _Listener()


def listened(decode: Callable[[], T]) -> tuple[T, bytes]:
    """Return the result of `decode`, and what the libraries wrote to stderr (mostly nothing)."""
    with _LISTENER.listening(alone=False) as file:
        before = _LISTENER.heard
        found = decode()
        if _size(file) == before:
            return found, b""
    with _LISTENER.listening(alone=True) as file:  # it may have been said of another thread's picture
        before = _size(file)
        found = decode()
        _LISTENER.heard = _size(file)
        return found, os.pread(file, 4096, before)


def tells_of_damage(words: bytes) -> bool:
    """Return whether a library's message means that part of a picture was lost."""
    padding = (PADDING.search(line) for line in words.splitlines() if b"JPEG" in line)
    return any(found is None or int(found[1]) > MAX_PADDING_BYTES for found in padding)


def _size(file: int) -> int:
    return os.fstat(file).st_size
