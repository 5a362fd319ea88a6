"""The heap of the process: the only place that configures the allocator and the garbage collector."""

from __future__ import annotations

import contextlib
import ctypes
import gc
from collections.abc import Callable
from typing import ParamSpec, TypeVar

P = ParamSpec("P")
R = TypeVar("R")


OBJECTS_PER_COLLECTION = 200_000  # of the youngest generation; the imports of a command keep more than 50 000
M_TRIM_THRESHOLD, M_MMAP_THRESHOLD = -1, -3  # of malloc.h of the GNU C library
KEPT_BYTES, MAPPED_BYTES = 16 << 20, 4 << 20  # free at the heap's end; an array's that gets pages of its own
SMALL_KB = 100_000  # a process that held no more keeps its free pages: it takes longer to get them again


def settle_heap() -> None:
    """Collect garbage cycles rarely, and keep pages for reuse.

    Among millions of small tuples the collector took a twentieth of the time. By default the C library maps every
    array of more than 128 kB anew, page by page, and the kernel clears each page: a fourteenth of an hour's time.
    """
    gc.set_threshold(OBJECTS_PER_COLLECTION)
    with contextlib.suppress(OSError, AttributeError, TypeError):
        set_option = ctypes.CDLL(None).mallopt
        set_option(M_MMAP_THRESHOLD, MAPPED_BYTES)
        set_option(M_TRIM_THRESHOLD, KEPT_BYTES)


def lean(work: Callable[P, R], *args: P.args, **kwargs: P.kwargs) -> R:
    """Call a function, then return the heap memory that it freed to the system.

    Measuring, fusing and judging leave tens of megabytes of holes between what stays. The C library returns only
    the end of its heap, and what comes next does not fit into the holes (benchmarks: "peak memory").
    """
    done = work(*args, **kwargs)
    give_back()
    return done


def give_back() -> None:
    """Return the free pages of a large heap to the kernel; no effect if the C library cannot."""
    with contextlib.suppress(OSError, AttributeError, TypeError):  # TypeError: Windows has no CDLL(None)
        trim = ctypes.CDLL(None).malloc_trim
        if _peak_kb() > SMALL_KB:
            trim(0)


def _peak_kb() -> int:
    """Return the peak memory of this process [kB]. Only used with GNU's C library."""
    import resource  # there is none on Windows

    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss


def leave_as_it_is() -> None:
    """Skip the search for garbage cycles at exit, which took 5 % of comparing ten minutes."""
    gc.freeze()
