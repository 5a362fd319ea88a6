"""Atomic writing of files: written under a temporary name, synced to disk, then renamed.

The .json of a result is renamed last. So if it exists, all files that it names exist.
"""

from __future__ import annotations

import glob
import os
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path

from locfuse.fusion.data import LocfuseError, UsageError

from .inputs import DESTROYS, is_among, refuse_to_write
from .text import visible_lines

try:
    import fcntl
except ImportError:  # Windows: no locks, so two runs may write to one folder
    fcntl = None  # type: ignore[assignment]

UNFINISHED = "unfinished.json"  # file of a run over many logs that ended before it wrote its summary
RESULTS = ("run.json", "report.json", "summary.json", "changes.json", UNFINISHED)
TEMPORARY = ".locfuse-tmp"  # ending of unfinished files: .NAME.PID.locfuse-tmp
LOCK = f".lock{TEMPORARY}"  # file in a folder while it is written to: PID of the writer
RUN_LOCK = f".run-lock{TEMPORARY}"  # file in the folder of a run over many logs: PID of the run
SCRATCH = "locfuse-"  # prefix of temporary files in other folders: locfuse-HOST-PID-...
LOCK_TIMEOUT_S = 20.0  # longest wait for another process to finish writing
# files that a user might also give as input
REPLACED = ("robot.toml", "fixes.toml", *RESULTS, "estimates.mcap", "recording.rrd")
Content = str | bytes | Callable[[Path], None]  # a function writes large content to a path itself


def write_results(folder: Path, files: Mapping[str, Content], overwrite: bool = False) -> None:
    """Write files to a folder that is empty or holds a locfuse result.

    Any other folder is accepted only with `overwrite`.
    """
    for name in files:
        refuse_to_write(folder / name)
    created = _prepare(folder, overwrite)
    names = sorted(files, key=lambda name: (name.endswith(".json"), name))
    try:
        with sole_writer(folder):
            _remove_leftovers(folder.iterdir())
            _write_all(folder, {name: files[name] for name in names})
    except OSError as problem:
        raise LocfuseError(f"cannot write to {folder}: {problem.strerror or problem}") from None
    finally:
        _remove_if_empty(folder, created)


def may_write(folder: Path, overwrite: bool = False, given: Iterable[Path | None] = ()) -> None:
    """Check before any work whether `write_results` would accept the folder; else raise LocfuseError.

    Raises UsageError if one of the `given` input files would be replaced, unless `overwrite` is true.
    """
    paths = [folder / name for name in REPLACED]
    inputs = [path for path in given if path is not None]
    for path in paths:
        refuse_to_write(path)
        if not overwrite and is_among(path, inputs):
            raise UsageError(f"{path} is an input and would be replaced: choose another -o, or add --overwrite")
    _remove_if_empty(folder, _prepare(folder, overwrite))


def may_replace(file: Path | None, overwrite: bool, given: Iterable[str | Path] = ()) -> None:
    """Raise UsageError if `file` is one of the `given` inputs, or exists and `overwrite` is false."""
    if file is not None and is_among(file, map(Path, given)):
        raise UsageError(f"{file}: {DESTROYS}")
    if file is not None and file.exists() and not overwrite:
        raise UsageError(f"{file} exists: choose another name, or replace it with --overwrite")
    if file is not None:
        refuse_to_write(file)


@contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """Context manager: yields a temporary path; it is renamed to `path` if the block ends without an error."""
    temporary = temporary_for(path)
    try:
        claim(temporary)
        yield temporary
        _sync(temporary)
        temporary.replace(path)
        _sync(path.parent)
    except OSError as problem:
        raise LocfuseError(f"cannot write {path}: {problem.strerror or problem}") from None
    finally:
        _remove(temporary)


def write_text(path: Path, text: str) -> None:
    """Write a text file in UTF-8 atomically."""
    with whole_file(path) as temporary:
        temporary.write_bytes(text.encode("utf-8"))


def _write_all(folder: Path, files: Mapping[str, Content]) -> None:
    temporary = {name: _temporary(folder / name) for name in files}
    try:
        for name, content in files.items():
            claim(temporary[name])
            if callable(content):
                content(temporary[name])
            elif isinstance(content, str):
                text = visible_lines(content) if name.endswith((".md", ".html")) else content
                temporary[name].write_bytes(text.encode(errors="replace"))
            else:
                temporary[name].write_bytes(content)
            _sync(temporary[name])
        for name in files:
            temporary[name].replace(folder / name)
        _sync(folder)
    finally:
        for path in temporary.values():
            _remove(path)


def _prepare(folder: Path, overwrite: bool) -> list[Path]:
    """Create the folder for results, if writing is allowed; return the created folders, innermost first."""
    try:
        if folder.exists() and not folder.is_dir():
            raise LocfuseError(f"{folder} is a file, not a folder: choose another with -o")
        present = list(folder.iterdir()) if folder.is_dir() else []
        others = {p.name for p in present if not p.name.endswith(TEMPORARY)}
        if others and not overwrite and not others.intersection(RESULTS):
            fix = "choose another with -o, or add --overwrite"
            raise LocfuseError(f"{folder} is not empty and holds no locfuse result: {fix}")
        missing = [p for p in (folder, *folder.parents) if not p.exists()]
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as problem:
        raise LocfuseError(f"cannot write to {folder}: {problem.strerror or problem}") from None
    return missing


@contextmanager
def sole_writer(folder: Path, name: str = LOCK, patience_s: float | None = None) -> Iterator[None]:
    """Context manager: lock a folder for this process. Raises LocfuseError if another process keeps its lock."""
    path = folder / name
    handle = _locked(path, LOCK_TIMEOUT_S if patience_s is None else patience_s)
    try:
        yield
    finally:
        _remove(path)
        if handle is not None:
            os.close(handle)


def _locked(path: Path, patience_s: float) -> int | None:
    """Lock a file and return its open handle; None on a system without file locks.

    Waits up to `patience_s` [s], then raises LocfuseError. The system releases the lock when the process ends.
    """
    end = time.monotonic() + patience_s
    while fcntl is not None:
        path.parent.mkdir(parents=True, exist_ok=True)
        try:
            handle = os.open(path, os.O_RDWR | os.O_CREAT, 0o644)
        except FileNotFoundError:  # the other process failed and removed its empty folder
            continue
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
            # the lock file was not removed meanwhile
            if path.exists() and path.stat().st_ino == os.fstat(handle).st_ino:
                os.write(handle, str(os.getpid()).encode())
                return handle
        except BlockingIOError:
            if time.monotonic() > end:
                who = os.read(handle, 20).decode("ascii", "replace")
                os.close(handle)
                fix = "wait for it, or choose another -o"
                raise LocfuseError(f"{path.parent} is being written by process {who}: {fix}") from None
            time.sleep(0.02)
        except OSError:  # a file system without locks
            os.close(handle)
            return None
        os.close(handle)
    return None


def temporary_for(path: Path) -> Path:
    """Return a temporary path for `path`; remove the temporary files of killed processes.

    Raises LocfuseError if `path` is being read.
    """
    refuse_to_write(path)
    with suppress(OSError):
        _remove_leftovers(path.parent.glob(f".{glob.escape(path.name)}.*{TEMPORARY}"))
    return _temporary(path)


def claim(temporary: Path) -> None:
    """Create an empty temporary file; an existing link with this name is not followed."""
    temporary.unlink(missing_ok=True)
    os.close(os.open(temporary, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o666))


def _temporary(path: Path) -> Path:
    return path.with_name(f".{path.name}.{os.getpid()}{TEMPORARY}")


def _remove_leftovers(paths: Iterable[Path]) -> None:
    """Remove the temporary files of processes that have ended."""
    for path in list(paths):
        pid = path.name.removesuffix(TEMPORARY).rpartition(".")[2]
        if path.name.endswith(TEMPORARY) and pid.isdecimal() and not alive(int(pid)):
            _remove(path)


def scratch_prefix() -> str:
    """Return the prefix of this process's temporary files; remove those of killed processes."""
    import re
    import shutil
    import socket
    import tempfile

    # only files of this machine: processes of other machines on a shared disk are not visible
    mine = f"{SCRATCH}{re.sub(r'[^A-Za-z0-9]', '_', socket.gethostname())}-"
    for path in Path(tempfile.gettempdir()).glob(f"{mine}*"):
        pid = path.name.removeprefix(mine).partition("-")[0]
        if pid.isdecimal() and not alive(int(pid)):
            if path.is_dir() and not path.is_symlink():
                shutil.rmtree(path, ignore_errors=True)
            else:
                _remove(path)
    return f"{mine}{os.getpid()}-"


def alive(pid: int) -> bool:
    """Return whether the process is running (a zombie is not)."""
    try:
        os.kill(pid, 0)
    except (ProcessLookupError, OverflowError):
        return False
    except OSError:
        pass
    try:
        state = Path(f"/proc/{pid}/stat").read_text(encoding="utf-8", errors="replace").rpartition(")")[2]
    except OSError:  # a system without /proc
        return True
    return not state.lstrip().startswith(("Z", "X"))


def _remove(path: Path) -> None:
    with suppress(OSError):
        path.unlink()


def _remove_if_empty(folder: Path, created: list[Path]) -> None:
    if folder.is_dir() and not any(folder.iterdir()):
        for path in created:
            with suppress(OSError):
                path.rmdir()


def _sync(path: Path) -> None:
    """Flush a file, or the entries of a folder, to the disk."""
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
