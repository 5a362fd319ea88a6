"""Rerun recordings of a fleet: one for every drive, side by side in one folder that Rerun's catalog serves."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import TYPE_CHECKING

import msgspec

from locfuse.formats.visible import writable

from .record import saved, warning

if TYPE_CHECKING:
    from locfuse.cli.session.result import Result

FOLDER = "recordings"  # in the fleet's results; the catalog reads no folders below it
CATALOG_PORT = 51234  # Rerun's own default for a catalog


class Recording(msgspec.Struct, frozen=True):
    """What a job records of its drive, and the folder."""

    folder: str

    def file(self, name: str) -> Path:
        """Return the file of a drive, or of a sweep's cell "drive,lrf.sigma_range=0.03"."""
        return Path(self.folder) / f"{writable(name)}.rrd"


def write(wanted: Recording, name: str, result: Result) -> str:
    """Write the recording of a result with its audits; return the reason in one line if it fails, else ""."""
    path = wanted.file(name)
    problem = saved(path, result, identity=path.stem)  # by which the catalog lists it
    return f"{name}: {warning(problem)}" if problem else ""


def catalog(folder: Path) -> str:
    """Return the commands that show all recordings of a folder in one viewer on this machine."""
    there = shlex.quote(str(folder))
    serve = f"rerun server --host 127.0.0.1 --port {CATALOG_PORT} --dataset drives={there}"
    return f"{serve}   and beside it: rerun rerun+http://127.0.0.1:{CATALOG_PORT}"
