"""Progress of long computations, reported to one listener such as the terminal.

The listener is a context variable, so that functions need no argument for it. A library or a worker process has
none.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar

Listener = Callable[[float | None], None]  # argument: completed share of log time, 0 to 1; None: unknown
_listener: ContextVar[Listener | None] = ContextVar("listener", default=None)


def report_progress(share: float | None) -> None:
    """Report the completed share of a computation, 0 to 1; None if unknown."""
    if (listener := _listener.get()) is not None:
        listener(share)


@contextmanager
def reporting_to(listener: Listener) -> Iterator[None]:
    """Send progress reports to the function `listener` inside this context."""
    token = _listener.set(listener)
    try:
        yield
    finally:
        _listener.reset(token)
