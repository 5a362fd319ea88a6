"""Other distributions: which version is installed, and one that is left aside."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager


def installed(distribution: str) -> str | None:
    """Return the version of a distribution, None where there is none of that name."""
    from importlib import metadata

    try:
        return metadata.version(distribution)
    except metadata.PackageNotFoundError:
        return None


def own() -> str:
    """Return the version of locfuse."""
    return installed("locfuse") or "unknown"


class _Absent:
    """An import hook under which pandas is not installed."""

    def find_spec(self, name: str, path: object, target: object = None) -> None:
        """Raise ModuleNotFoundError for pandas; all other modules are found as usual."""
        if name == "pandas":
            raise ModuleNotFoundError(name, name=name)


@contextmanager
def without_pandas() -> Iterator[None]:
    """Keep pyarrow from importing pandas where it is installed: 45 MB and a second that nothing here needs."""
    hook = _Absent()
    sys.meta_path.insert(0, hook)
    try:
        yield
    finally:
        sys.meta_path.remove(hook)
