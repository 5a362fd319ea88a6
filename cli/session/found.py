"""Common base of `tune` and `calibrate`: estimated settings, and a check for faults that prevent both."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from pathlib import Path
from typing import Any, ClassVar

import msgspec

from locfuse.cli.analysis.examined import examined
from locfuse.cli.analysis.load import Loaded
from locfuse.cli.analysis.results import loss_lines
from locfuse.cli.analysis.settings import LogOptions, PathLike, path_of
from locfuse.formats.report.findings import options
from locfuse.formats.robot import robot_toml
from locfuse.formats.whole_files import may_replace, write_text
from locfuse.fusion.checks.clocks import CLOCK
from locfuse.fusion.checks.examine import HOLE, holes, of_holes
from locfuse.fusion.data import LocfuseError

from .python_words import speaks_python

Row = tuple[str, str, str, str]


class Found(msgspec.Struct, frozen=True, kw_only=True):
    """Settings estimated from logs, with intervals; `with_settings` and `sets=` accept `tables()`."""

    loaded: Sequence[Loaded]  # the logs
    notes: tuple[str, ...] = ()

    command: ClassVar[str]
    titles: ClassVar[Row]  # of the columns of `rows`

    def tables(self) -> dict[str, dict[str, Any]]:
        """Return the estimates as tables of robot.toml, {"wheels": {"noise": 0.0012}}, without uncertain ones."""
        raise NotImplementedError

    def values(self) -> dict[str, Any]:
        """Return all results as plain values for --json; keys and units are in `locfuse schema`."""
        raise NotImplementedError

    def rows(self) -> list[Row]:
        """Return the estimated settings as rows of a table (text), with the columns `titles`."""
        raise NotImplementedError

    @property
    def how(self) -> LogOptions:
        """The options with which the first log was read."""
        return self.loaded[0].how

    def losses(self) -> list[str]:
        """Return a line for each loss: unreadable bytes of the files, or refused readings of the used sensors."""
        return [line for one in self.loaded for line in loss_lines(one, self.used(one), self.how.strict)]

    def used(self, one: Loaded) -> Sequence[str]:
        """Return the sensors of a log whose readings were used."""
        return list(one.drive.measurements)

    def before(self) -> str:
        """Return the comment line that starts a new robot.toml, written if the user gave no file."""
        return f"# found by locfuse {self.command}\n"

    def given(self) -> dict[str, Any]:
        """Return the merged settings of the user's robot.toml files except the first, which `write` extends."""
        return robot_toml.merge(*(robot_toml.parse(file.read_bytes(), str(file)) for file in self.how.robots[1:]))

    @speaks_python
    def write(self, file: PathLike, overwrite: bool = False) -> Path:
        """Write robot.toml, and return its path: the user's first file with its comments, and the estimates added.

        Raises LocfuseError if the file exists, unless `overwrite`.
        """
        path = path_of(file)
        may_replace(path, overwrite)
        text = robot_toml.text_of(next(iter(self.how.robots), None)) or self.before()
        changes = robot_toml.merge(self.given(), self.tables())
        write_text(path, robot_toml.updated(text, changes, f"locfuse {self.command}"))
        return path

    def __repr__(self) -> str:
        """Return the estimated settings as text."""
        found = (f"{table}.{key}={value}" for table, keys in self.tables().items() for key, value in keys.items())
        return f"<{type(self).__name__}: {', '.join(found) or 'nothing to set'}>"

    def _repr_html_(self) -> str:
        """Return the table and the notes as HTML for a notebook."""
        from locfuse.formats.report.html import table_and_notes

        return table_and_notes(self.titles, self.rows(), self.notes)


# what to do about proven faults without a fix, by the code of their finding
UNFIXED = {CLOCK: "Find out which by locfuse compare", HOLE: "Use a part, or leave this log out"}


def refuse_doubtful(one: Loaded, what: str, own: Collection[str] = ()) -> None:
    """Raise LocfuseError if the log has a proven fault that the estimates would hide.

    `what` names these estimates in the message ("noise found now"). Accepted are faults with a code in `own`, and
    a wrong start, which affects neither noise nor wheels. For all other such faults `info --check` exits with 3.
    """
    if one.drive.wheels.stands:
        return
    for finding in of_holes(one.drive, holes(one.drive)) or examined(one):
        unfixed = UNFIXED.get(finding.code, "Leave this log out" if finding.role == "truth" else "")
        role, fixes = finding.role, finding.fixes
        if finding.severe and finding.code not in {"start", *own} and (fixes or unfixed):
            words = finding.brief.partition(". ")[0] if finding.code in UNFIXED else finding.brief
            message = f"{one.log.name}: {role}: {words}; {what} would cover that up."
            hint = f"Set it first: {options(fixes)}" if fixes else unfixed
            raise LocfuseError(message, role=role, fixes=fixes, hint=hint)
