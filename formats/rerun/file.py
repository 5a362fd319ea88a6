"""A recording on disk: written under a temporary name, read back, compared with what was sent, then renamed."""

from __future__ import annotations

import os
import shutil
import warnings
from collections import Counter
from pathlib import Path

from locfuse.formats.no_pandas import without_pandas
from locfuse.formats.whole_files import whole_file
from locfuse.fusion.data import LocfuseError

from .recording import Sketch, write_recording


def save_recording(path: Path, drawn: Sketch) -> None:
    """Write a sketch to `path`, whole or not at all.

    Raises LocfuseError where it cannot be written, or where what was read back is not what was sent.
    """
    quiet_rust()
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with whole_file(path) as temporary, without_pandas():
            verify(temporary, write_recording(temporary, drawn))
    except OSError as problem:
        raise LocfuseError(f"cannot write {path}: {problem.strerror or problem}") from None
    except RuntimeError as problem:  # what Rerun's writer thread says when the disk is full
        full = "prematurely" in str(problem)
        why = "the disk is full or went away" if full else _first_line(problem)
        raise LocfuseError(f"cannot write {path}: {why}") from None


def verify(path: Path, sent: Counter[str]) -> None:
    """Read a recording back. Raises LocfuseError unless every entity has the rows that were sent to it."""
    found = check(path)
    lost = [entity for entity, n in sent.items() if found[entity] != n]
    if lost:
        raise LocfuseError(f"{path.name} lacks what was written: {len(lost)} entities differ, first {lost[0]}")


def check(path: Path) -> Counter[str]:
    """Return the rows of every entity of a recording.

    Raises LocfuseError for a file that is no recording, was cut short, or has no blueprint.
    """
    quiet_rust()
    from rerun.chunk import RrdReader

    rows: Counter[str] = Counter()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")  # a file without its footer was cut short
            reader = RrdReader(path)
            whole = bool(reader.recordings()) and bool(reader.blueprints())
            for chunk in reader.stream():
                if not chunk.is_static:
                    rows[chunk.entity_path.strip("/")] += chunk.num_rows
    except Warning:
        raise LocfuseError(f"{path.name} is no whole recording: it was cut short") from None
    except (RuntimeError, ValueError, OSError) as problem:
        raise LocfuseError(f"{path.name} is no whole recording: {_first_line(problem)}") from None
    if not whole:
        raise LocfuseError(f"{path.name} is no recording of ours: it holds no drive or no blueprint")
    return rows


def copy(source: Path, target: Path) -> None:
    """Copy a recording, whole or not at all. Raises LocfuseError where it cannot be written."""
    with whole_file(target) as temporary:
        shutil.copyfile(source, temporary)


def quiet_rust() -> None:
    """Keep Rerun's own log off the terminal: what goes wrong is said once, by us. Before its first import."""
    os.environ.setdefault("RUST_LOG", "off")


def _first_line(problem: BaseException) -> str:
    return str(problem).strip().splitlines()[0][:200] if str(problem).strip() else type(problem).__name__
