"""Import of OpenCV with limits on picture size and threads.

The import takes 60 ms or more. So this module, and those that import it (images, panorama, detect, preview), are
imported only inside functions that process pictures.
"""

from __future__ import annotations

import os
import re
import tempfile
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TypeVar

# A 5 kB JPEG can declare 20000 x 20000 pixels. An 8K frame (7680 x 4320) is below the limit: 100 MB decoded.
# images.py checks every header against this limit too.
MAX_PIXELS = 2**25
MAX_MAP_PIXELS = 2**26  # of a map: 400 m x 400 m in cells of 5 cm
os.environ.setdefault("OPENCV_IO_MAX_IMAGE_PIXELS", str(MAX_MAP_PIXELS))  # for the whole process

import cv2  # noqa: E402

# One picture per core (detect.py) is faster than several cores per picture, and gives the same results.
cv2.setNumThreads(1)

__all__ = ["MAX_MAP_PIXELS", "MAX_PIXELS", "cv2", "listened", "reports_damage"]


# ---- messages of the picture libraries on stderr about damaged pictures ----
#
# libjpeg returns a picture for damaged data too, and reports the damage only on the process' stderr. While a
# picture is decoded, stderr is redirected to a temporary file, which shows whether that picture is damaged.

T = TypeVar("T")
STDERR = 2
# some cameras add a few bytes of padding before the end mark; more extra bytes mean damaged data
PADDING = re.compile(rb"(\d+) extraneous bytes before marker 0xd9")
MAX_PADDING_BYTES = 15


class _StderrRedirect:
    """Redirects stderr to a file while pictures are decoded."""

    def __init__(self) -> None:
        self._change = threading.Condition()
        self._decoding = 0
        self._saved = -1
        self._file = -1
        self.read = 0  # bytes of the file that belong to earlier pictures

    @contextmanager
    def redirected(self, alone: bool) -> Iterator[int]:
        """Context manager: while a picture is decoded, stderr goes to a file; yields its file descriptor.

        With `alone`, no other thread decodes at this time, so that new text in the file belongs to one picture.
        """
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
                self._file = os.dup(file.fileno())  # open until the process ends
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


_REDIRECT = _StderrRedirect()


def listened(decode: Callable[[], T]) -> tuple[T, bytes]:
    """Return the result of `decode`, and the text that libraries wrote to stderr during its call."""
    with _REDIRECT.redirected(alone=False) as file:
        before = _REDIRECT.read
        found = decode()
        if _size(file) == before:
            return found, b""
    with _REDIRECT.redirected(alone=True) as file:  # the text may belong to another picture: decode again
        before = _size(file)
        found = decode()
        _REDIRECT.read = _size(file)
        return found, os.pread(file, 4096, before)


def reports_damage(words: bytes) -> bool:
    """Return whether the stderr text `words` of a picture library reports a damaged picture."""
    padding = (PADDING.search(line) for line in words.splitlines() if b"JPEG" in line)
    return any(found is None or int(found[1]) > MAX_PADDING_BYTES for found in padding)


def _size(file: int) -> int:
    return os.fstat(file).st_size
