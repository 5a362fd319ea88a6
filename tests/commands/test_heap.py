"""What the process tells its allocator and its garbage collector."""

from __future__ import annotations

import gc
import subprocess
import sys

import pytest

from locfuse.cli.analysis import memory


@pytest.mark.parametrize(("peak", "trimmed"), [(memory.SMALL_KB, 0), (memory.SMALL_KB + 1, 1)])
def test_free_pages_go_back_to_the_kernel_once_a_process_was_large(
    peak: int, trimmed: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    calls: list[int] = []

    class GnuC:
        def __init__(self, name: None) -> None:
            self.malloc_trim = calls.append

    monkeypatch.setattr("ctypes.CDLL", GnuC)
    monkeypatch.setattr(memory, "_peak_kb", lambda: peak)
    assert memory.lean(lambda a, b: a + b, 1, b=2) == 3
    assert calls == [0] * trimmed


@pytest.mark.parametrize(("given", "frozen"), [("", True), ("['explain', 'ANEES']", False)])
def test_only_a_process_of_the_command_line_ends_without_looking_for_cycles(given: str, frozen: bool) -> None:
    code = f"""
import gc, sys
from locfuse.cli.main import main
sys.argv = ["locfuse", "explain", "ANEES"]
try:
    main({given})
finally:
    assert (gc.get_freeze_count() > 0) is {frozen}, gc.get_freeze_count()
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_the_heap_keeps_pages_where_the_c_library_can(monkeypatch: pytest.MonkeyPatch) -> None:
    set_to: dict[int, int] = {}

    class GnuC:
        def __init__(self, name: None) -> None:
            self.mallopt = set_to.__setitem__

    monkeypatch.setattr("ctypes.CDLL", GnuC)
    memory.settle_heap()
    assert set_to == {-3: 4 << 20, -1: 16 << 20}  # M_MMAP_THRESHOLD, M_TRIM_THRESHOLD of malloc.h
    assert gc.get_threshold()[0] == memory.OBJECTS_PER_COLLECTION

    class Other:
        def __init__(self, name: None) -> None: ...

    monkeypatch.setattr("ctypes.CDLL", Other)
    memory.settle_heap()
    memory.give_back()
