"""Progress of long computations, reported to one listener such as the terminal.

The listener is a context variable, so that functions need no argument for it. A library or a worker process has
none.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar

Hear = Callable[[float | None], None]  # argument: completed share of log time, 0 to 1; None: unknown
_listener: ContextVar[Hear | None] = ContextVar("listener", default=None)


def say_done(share: float | None) -> None:
    """Report the completed share of a computation, 0 to 1; None if unknown."""
    if (hear := _listener.get()) is not None:
        hear(share)


@contextmanager
def heard_by(hear: Hear) -> Iterator[None]:
    """Send progress reports to the function `hear` inside this context."""
    token = _listener.set(hear)
    try:
        yield
    finally:
        _listener.reset(token)
