"""Results appear whole or not at all: written under a temporary name, synced, then renamed.

The .json comes last: where it stands, everything it speaks of stands too.
"""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from types import FrameType

from locfuse.fusion.data import LocfuseError, UsageError

RESULTS = ("run.json", "report.json", "summary.json", "changes.json")
TEMPORARY = ".locfuse-tmp"  # ending of files that are being written
Content = str | bytes | Callable[[Path], None]  # what is too big to be held writes itself to a path


def write_results(folder: Path, files: Mapping[str, Content], overwrite: bool = False) -> None:
    """Write files into `folder`, replacing a locfuse result there; another non-empty folder is refused."""
    created = _prepare(folder, overwrite)
    names = sorted(files, key=lambda name: (name.endswith(".json"), name))
    try:
        with _terminable():
            _write_all(folder, {name: files[name] for name in names})
    except OSError as problem:
        raise LocfuseError(f"cannot write to {folder}: {problem.strerror or problem}") from None
    finally:
        _remove_if_empty(folder, created)


def may_write(folder: Path, overwrite: bool = False) -> None:
    """Raise LocfuseError where `write_results` would refuse the folder: to know it before the work is done."""
    _remove_if_empty(folder, _prepare(folder, overwrite))


def may_replace(file: Path | None, overwrite: bool) -> None:
    """Raise UsageError where a file would be lost: to know it before the work is done."""
    if file is not None and file.exists() and not overwrite:
        raise UsageError(f"{file} exists: choose another name, or replace it with --overwrite")


@contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """Give a temporary path beside `path` to write to; it takes the final name when the block ends well."""
    temporary = _temporary(path)
    try:
        with _terminable():
            yield temporary
            _sync(temporary)
            temporary.replace(path)
            _sync(path.parent)
    except OSError as problem:
        raise LocfuseError(f"cannot write {path}: {problem.strerror or problem}") from None
    finally:
        _remove(temporary)


def _write_all(folder: Path, files: Mapping[str, Content]) -> None:
    temporary = {name: _temporary(folder / name) for name in files}
    try:
        for name, content in files.items():
            if callable(content):
                content(temporary[name])
            else:
                temporary[name].write_bytes(content.encode() if isinstance(content, str) else content)
            _sync(temporary[name])
        for name in files:
            temporary[name].replace(folder / name)
        _sync(folder)
    finally:
        for path in temporary.values():
            _remove(path)


def _prepare(folder: Path, overwrite: bool) -> list[Path]:
    """Check the folder rules and make the folder; return the folders made, innermost first."""
    try:
        if folder.exists() and not folder.is_dir():
            raise LocfuseError(f"{folder} is a file, not a folder: choose another with -o")
        present = list(folder.iterdir()) if folder.is_dir() else []
        stale = [p for p in present if p.name.endswith(TEMPORARY)]
        others = {p.name for p in present} - {p.name for p in stale}
        if others and not overwrite and not others.intersection(RESULTS):
            raise LocfuseError(
                f"{folder} is not empty and holds no locfuse result: choose another with -o, or add --overwrite"
            )
        missing = [p for p in (folder, *folder.parents) if not p.exists()]
        folder.mkdir(parents=True, exist_ok=True)
        for path in stale:
            _remove(path)
    except OSError as problem:
        raise LocfuseError(f"cannot write to {folder}: {problem.strerror or problem}") from None
    return missing


def _temporary(path: Path) -> Path:
    return path.with_name(f".{path.name}.{os.getpid()}{TEMPORARY}")


def _remove(path: Path) -> None:
    with suppress(OSError):
        path.unlink()


def _remove_if_empty(folder: Path, created: list[Path]) -> None:
    if folder.is_dir() and not any(folder.iterdir()):
        for path in created:
            with suppress(OSError):
                path.rmdir()


def _sync(path: Path) -> None:
    """Bring a file or a folder's entries to the disk."""
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


@contextmanager
def _terminable() -> Iterator[None]:
    """Turn SIGTERM into an exception while files are open, so that the temporary ones are removed."""
    unhandled = (
        threading.current_thread() is threading.main_thread()
        and signal.getsignal(signal.SIGTERM) is signal.SIG_DFL
    )
    if not unhandled:
        yield
        return
    signal.signal(signal.SIGTERM, _terminate)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, signal.SIG_DFL)


def _terminate(number: int, frame: FrameType | None) -> None:
    raise SystemExit(128 + number)
