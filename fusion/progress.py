"""How much of the work in hand is done, for whoever shows it.

Long loops say it once per block, and one listener hears it: the terminal. It travels beside the values, as a log
line would, so that no function on the way passes it on. Nobody listens in a library or in a worker process.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar

Hear = Callable[[float | None], None]  # is given the share of log time that is done, 0 to 1; None: unknown
_listener: ContextVar[Hear | None] = ContextVar("listener", default=None)


def say_done(share: float | None) -> None:
    """Say how much of the work in hand is done (0 to 1); None where a loop has ended and the rest is unknown."""
    if (hear := _listener.get()) is not None:
        hear(share)


@contextmanager
def heard_by(hear: Hear) -> Iterator[None]:
    """Let `hear` be told how much is done, inside this context."""
    token = _listener.set(hear)
    try:
        yield
    finally:
        _listener.reset(token)
