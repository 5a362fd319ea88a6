"""SIGINT and SIGTERM while files are being written: they end the work, never the cleaning up behind it.

Python runs a signal's handler between any two steps, so also inside `finally:`. There its exception would leave a
lock or half a file behind. Within `orderly_end` signals are therefore kept back, except inside `interruptible`.
"""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any

SIGNALS = (signal.SIGINT, signal.SIGTERM)
Handler = Callable[[int, FrameType | None], Any]


class _Gate:
    """Holds back signals while it is shut. One per process: only the main thread gets signals."""

    def __init__(self) -> None:
        self.shut = False
        self.waiting: list[tuple[Handler, int]] = []

    def handler(self, original: Handler) -> Handler:
        def handle(number: int, frame: FrameType | None) -> None:
            if self.shut:
                self.waiting.append((original, number))
            else:
                original(number, frame)

        return handle

    def open(self) -> None:
        """Let signals through again, first the one that waits."""
        self.shut = False
        if self.waiting:
            original, number = self.waiting[0]
            self.waiting.clear()
            original(number, None)


_gate = _Gate()


@contextmanager
def orderly_end() -> Iterator[None]:
    """Keep signals back until the block is over, but for what runs in `interruptible` inside it."""
    if threading.current_thread() is not threading.main_thread() or _gate.shut:
        yield
        return
    before = {number: signal.getsignal(number) for number in SIGNALS}
    _gate.shut = True
    try:
        for number, handler in before.items():
            if callable(handler) or handler is signal.SIG_DFL:
                signal.signal(number, _gate.handler(handler if callable(handler) else _exit))
        yield
    finally:
        for number, handler in before.items():
            if handler is not None:  # one that was not set from Python stays as it is
                signal.signal(number, handler)
        _gate.open()


@contextmanager
def interruptible() -> Iterator[None]:
    """Let signals end the block: what belongs to it is cleaned up outside, where they are kept back again."""
    if not _gate.shut or threading.current_thread() is not threading.main_thread():
        yield
        return
    try:
        _gate.open()
        yield
    finally:
        _gate.shut = True


def _exit(number: int, frame: FrameType | None) -> None:
    raise SystemExit(128 + number)
