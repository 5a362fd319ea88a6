"""Converts errors of locfuse and of the system to a line and an exit code; silences overflow warnings."""

from __future__ import annotations

import errno
import os
import warnings

EXIT_LOSS = 3  # exit code if parts of a log were lost, or figures are void
PACKAGES = {  # module -> what to install, where their names differ
    "cv2": "opencv-python-headless",
    "distributed": "locfuse[cluster]",
    "mcp": "locfuse[mcp]",
    "obstore": "locfuse[remote]",
    "rerun": "rerun-sdk",
}
OUT_OF_MEMORY_WORDS = ("failed to map segment", "annot allocate memory")  # in messages of the dynamic loader


def has_scipy() -> bool:
    """Return whether SciPy is installed; if not, default features that need SciPy are skipped."""
    try:
        import scipy  # noqa: F401
    except ImportError:
        return False
    return True


def expected(e: Exception) -> tuple[str, int] | None:
    """Return (line to print, exit code) of an expected error; None if the exception is a bug."""
    from locfuse.fusion.data import LocfuseError

    if isinstance(e, LocfuseError):
        return e.typed or str(e), e.exit_code
    if isinstance(e, MemoryError):
        return "out of memory", 1
    if isinstance(e, OSError) and e.errno is not None:
        what = os.strerror(e.errno)
        where = f": {e.filename}" if e.filename else ""
        hint = ". Free some space or choose another folder with -o" if e.errno == errno.ENOSPC else ""
        return f"{what}{where}{hint}", 1
    if isinstance(e, ImportError) and any(words in str(e) for words in OUT_OF_MEMORY_WORDS):
        return f"out of memory: a library could not be loaded ({str(e).splitlines()[-1].strip()})", 1
    module = (e.name or "").partition(".")[0] if isinstance(e, ModuleNotFoundError) else ""
    if module not in {"", "locfuse"}:  # a missing module of locfuse is a bug
        package = PACKAGES.get(module, module)
        return f"this needs {package}, which is not installed: python -m pip install {package}", 1
    if isinstance(e, RuntimeError) and "can't start new thread" in str(e):
        return "out of memory: a thread could not be started", 1
    return None


def silence_overflows() -> None:
    """Ignore RuntimeWarning in this process from now on. Only the command line calls this.

    Absurd readings (1e300 m, NaN) overflow before a gate counts and reports them. NumPy's warning names a line of
    source code, not the reading, so it does not help the user.
    """
    warnings.simplefilter("ignore", RuntimeWarning)
