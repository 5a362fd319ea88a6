"""What a process was given and needs no more goes back to the system."""

from __future__ import annotations

import contextlib
import ctypes


def give_back() -> None:
    """Return the free pages of the heap to the kernel; where the C library cannot, nothing happens.

    Measuring and every run of the filter leave tens of megabytes of holes between what stays (glibc returns only
    the heap's end), and what comes next does not fit into them: benchmarks, "peak memory".
    """
    with contextlib.suppress(OSError, AttributeError, TypeError):  # TypeError: no CDLL(None) on Windows
        ctypes.CDLL(None).malloc_trim(0)
