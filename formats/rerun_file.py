"""A recording on disk: written under a temporary name, read back, compared with what was sent, then renamed."""

from __future__ import annotations

import os
import warnings
from collections import Counter
from pathlib import Path

from ..fusion.data import LocfuseError
from .outdir import whole_file
from .rerun_recording import write_recording
from .rerun_scene import Scene


def save_recording(path: Path, scene: Scene, tab: str | None = None) -> None:
    """Write the scene to `path`, whole or not at all; `tab` names the tab of curves in front.

    Raises LocfuseError where it cannot be written, or where what was read back is not what was sent.
    """
    quiet_rust()
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with whole_file(path) as temporary:
            verify(temporary, write_recording(temporary, scene, tab))
    except OSError as problem:
        raise LocfuseError(f"cannot write {path}: {problem.strerror or problem}") from None
    except RuntimeError as problem:  # what Rerun's writer thread says when the disk is full
        raise LocfuseError(f"cannot write {path}: {_first_line(problem)} (is the disk full?)") from None


def verify(path: Path, sent: Counter[str]) -> None:
    """Read a recording back. Raises LocfuseError unless every entity has the rows that were sent to it."""
    from rerun.chunk import RrdReader

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")  # a file without its footer was cut short
            reader = RrdReader(path)
            blueprints = len(reader.blueprints())
            found: Counter[str] = Counter()
            for chunk in reader.stream():
                if not chunk.is_static:
                    found[chunk.entity_path.strip("/")] += chunk.num_rows
    except (RuntimeError, ValueError, Warning) as problem:
        raise LocfuseError(f"{path.name} cannot be read back: {_first_line(problem)}") from None
    lost = {entity: n - found[entity] for entity, n in sent.items() if found[entity] != n}
    if lost or not blueprints:
        what = next(iter(lost), "its blueprint")
        raise LocfuseError(
            f"{path.name} does not hold what was written: {len(lost)} entities differ, first {what}"
        )


def quiet_rust() -> None:
    """Keep Rerun's own log off the terminal: what goes wrong is said once, by us. Before its first import."""
    os.environ.setdefault("RUST_LOG", "off")


def _first_line(problem: BaseException) -> str:
    return str(problem).strip().splitlines()[0][:200] if str(problem).strip() else type(problem).__name__
