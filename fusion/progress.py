"""Progress of the present work, for whatever displays it.

Long loops report it once per block to one listener: the terminal. It travels beside the values, as a log
line would, so that no function on the way passes it on. A library or a worker process has no listener.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar

Hear = Callable[[float | None], None]  # is given the share of log time that is done, 0 to 1; None: unknown
_listener: ContextVar[Hear | None] = ContextVar("listener", default=None)


def say_done(share: float | None) -> None:
    """Report the share of the work that is done (0 to 1); None after a loop if the rest is unknown."""
    if (hear := _listener.get()) is not None:
        hear(share)


@contextmanager
def heard_by(hear: Hear) -> Iterator[None]:
    """Report progress to `hear` inside this context."""
    token = _listener.set(hear)
    try:
        yield
    finally:
        _listener.reset(token)
