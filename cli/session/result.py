"""The result of a run or a comparison: estimates, evaluations, a report, and its files, also for other tools."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from functools import cached_property, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import msgspec
import numpy as np
from numpy.typing import NDArray

from locfuse.cli.advice.report import fixes_file, forget_fixes
from locfuse.cli.analysis import results
from locfuse.cli.analysis.compare import Compared
from locfuse.cli.analysis.load import Loaded
from locfuse.cli.analysis.robot_tables import files_of
from locfuse.cli.analysis.settings import EXPORTS, OF_COMPARISON, OF_RUN, PathLike, chosen, path_of
from locfuse.cli.analysis.verdicts import credit_values
from locfuse.formats.report import json_report, table, tables
from locfuse.formats.report.findings import notes_of, void_reasons
from locfuse.formats.results import trajectory as to
from locfuse.formats.robot import robot_toml
from locfuse.formats.text import did_you_mean, visible
from locfuse.formats.whole_files import Content, write_results, write_text
from locfuse.fusion import se2
from locfuse.fusion.data import Array, Drive, Estimates, Evaluation, Event, UsageError
from locfuse.fusion.judge.credit import Credit
from locfuse.fusion.judge.evaluate import events_of_drive, events_of_run
from locfuse.fusion.measure import thinned
from locfuse.fusion.robot import Robot
from locfuse.fusion.sensors.registry import REGISTRY, colours, of_points
from locfuse.fusion.statistics import chi_square
from locfuse.fusion.streams import MAX_DELAY_S
from locfuse.fusion.wheels.motion import WHEEL_STATES

from .python_words import in_python, speaks_python

if TYPE_CHECKING:
    from locfuse.formats.figures.palette import Trace
    from locfuse.formats.figures.panels import Panel, Scene

V = TypeVar("V")
Kinds = str | Iterable[str] | None  # "json,tum" or ["json", "tum"]; None: the default ones


class UnknownNameError(UsageError, KeyError):
    """A name that a `Named` mapping does not have: a KeyError with a one-line message."""

    __str__ = Exception.__str__


class Named(dict[str, V]):
    """A mapping whose KeyError suggests a similar name; `what` names the kind of value: "configuration"."""

    def __init__(self, what: str, values: Mapping[str, V]) -> None:
        super().__init__(values)
        self._what = what

    def __missing__(self, name: str) -> V:
        """Raise UnknownNameError with the most similar name, since the name is unknown."""
        near = did_you_mean(str(name), self)
        hint = f"; {near}" if near else "."
        known = ", ".join(self) or "none"
        raise UnknownNameError(f"no {self._what} {name!r} in this result{hint} There are: {known}")

    def __repr__(self) -> str:
        """Return only the names, since the values are large arrays."""
        return f"<{len(self)} by {self._what}: {', '.join(self)}>"


class Result(msgspec.Struct, frozen=True, eq=False, dict=True):
    """One or several configurations over one log.

    `estimates["all"].pose` is (n, 3): x, y [m], theta [rad], map frame, at `estimates["all"].t` [s since the first
    wheel reading]; `estimates["all"].P` its covariance (n, 3, 3). `evaluations["all"].figures` are the error
    figures against truth (None without truth), SI units with the unit in the key. `report` is the content of
    report.json or run.json.
    """

    compared: Compared
    report: dict[str, Any]

    @property
    def loaded(self) -> Loaded:
        """The log and its settings."""
        return self.compared.loaded

    @cached_property
    def estimates(self) -> Named[Estimates]:
        """The estimates by name of the result: "all", "all-smoothed"."""
        return Named("configuration", {e.name: e for e in self.compared.estimates})

    @cached_property
    def evaluations(self) -> Named[Evaluation]:
        """The evaluations by the name of the result."""
        return Named("configuration", {e.name: e for e in self.compared.evaluations})

    @property
    def drive(self) -> Drive:
        """The measured log: wheel motion, measurements by sensor, truth."""
        return self.loaded.drive

    @property
    def robot(self) -> Robot:
        """The effective settings."""
        return self.loaded.robot

    @property
    def notes(self) -> list[str]:
        """Notes on the figures, from the log and from the configurations."""
        return notes_of(self.report)

    @property
    def headline(self) -> str:
        """One or two sentences: which sensors to keep, the error, and whether the result is reliable."""
        return str(self.report["headline"])

    @property
    def findings(self) -> list[dict[str, Any]]:
        """Problems of log and settings: {"role", "code", "message", "fixes"} each; [] if none was looked for."""
        return self.report["findings"] or []

    def errors(self, name: str) -> dict[str, Array]:
        """Return the errors of one result, `errors("lrf")`, for pandas.DataFrame or polars.DataFrame.

        Columns at the truth's stamps, (q,) each: t [s since the first wheel reading]; dx, dy [m], heading [rad]:
        estimate - truth; nees (expected: 1 per degree of freedom). Missing values are NaN; without truth there are
        no rows.
        """
        found = self.evaluations[name]
        heading = np.full(len(found.t), np.nan) if found.heading is None else found.heading
        dx, dy = found.deviation.T
        return {"t": found.t, "dx": dx, "dy": dy, "heading": heading, "nees": found.nees}

    def audit(self, name: str, sensor: str) -> dict[str, NDArray[Any]]:
        """Return every measurement of a sensor in one result, `audit("all", "lrf")`, as columns for a data frame.

        t [s since the first wheel reading]; verdict: "accepted", "gate", "unmatched" ...; nis and the threshold of
        its gate; innovation_<component> and sigma_<component>, in the unit of the audit.
        """
        estimates = self.estimates[name]
        audit = Named("sensor", estimates.audits)[sensor]
        columns: dict[str, NDArray[Any]] = {
            "t": estimates.t[audit.instant],
            "verdict": audit.verdicts,
            "nis": audit.nis,
            "threshold": audit.threshold,
        }
        for i, component in enumerate(REGISTRY[sensor].components):
            of = component.name
            columns |= {f"innovation_{of}": audit.y[:, i], f"sigma_{of}": audit.sigma[:, i]}
        return columns

    def plot(self, axes: Any = None) -> Any:
        """Draw all paths over the map into `axes` (None: new ones) and return matplotlib's axes.

        Without matplotlib, return the report's figure, an SVG for a notebook.
        """
        from locfuse.formats.figures.for_paper import on_axes
        from locfuse.formats.report.html import NotebookFigure

        panel, traces = self._trajectories()
        try:
            return on_axes(axes, panel, traces, colours())
        except ModuleNotFoundError:  # no matplotlib
            return NotebookFigure(panel, traces, colours())

    def _trajectories(self) -> tuple[Panel, Mapping[str, Trace]]:
        """Return the figure of all paths, and the line style of each."""
        from locfuse.formats.figures.palette import traces_of
        from locfuse.formats.figures.where import trajectories

        panel = trajectories(scene(self.compared)).panels[0]
        return panel, traces_of(self.estimates.values())

    def table(self) -> list[dict[str, Any]]:
        """Return one row per result, for pandas.DataFrame or polars.DataFrame: the columns of report.csv.

        "configuration" is the result's name; figures are in SI units with the unit in the key, None where a
        figure does not exist; `<sensor>_accepted`, `_rejected`, `_absent`, `_nis` count its measurements.
        """
        return table.records(tables.everything(self.report))

    def losses(self, strict: bool = False) -> list[str]:
        """Return a line for each loss: lost bytes, over 1 % refused readings of a used sensor, void figures.

        With any loss, the command exits with 3. With `strict`, a single refused reading is a loss.
        """
        used = sorted({s for e in self.estimates.values() for s in e.sensors})
        return [*results.loss_lines(self.loaded, used, strict), *void_reasons(self.report)]

    def __repr__(self) -> str:
        """Return the kind of result, the log and the names of its results."""
        return visible(f"<{type(self).__name__} of {self.loaded.log.name}: {', '.join(self.estimates)}>")

    def _repr_html_(self) -> str:
        """Return headline, findings, verdicts, table and trajectories as HTML for a notebook."""
        from locfuse.formats.report import html

        panel, traces = self._trajectories()
        return html.notebook_report(self.report, in_python) + html.NotebookFigure(panel, traces, colours()).html()

    @speaks_python
    def write(
        self, folder: PathLike | None = None, *, write: Kinds = None, export: Kinds = (), overwrite: bool = False
    ) -> list[Path]:
        """Write the same files as the command with -o FOLDER, and return their paths.

        Args:
            folder: folder of the files; None is locfuse-out/<log name>.
            write: kinds of output: "html", "md", "json", "tum", "csv", "tex" (for a run: "tum", "csv", "json");
                None writes "html", "json" and "tum" (for a run all); "all" writes all.
            export: formats of other tools: "mcap", "log", "kitti", "tum-cov" ...
            overwrite: write into a folder that holds something else.

        Raises:
            LocfuseError: the folder holds something else, or cannot be written.
        """
        robot: dict[str, Content] = {"robot.toml": robot_toml.dump(results.settings_tables(self.robot))}
        files = robot | self._files(write) | fixes_file(self.report)
        formats = chosen(export, list(EXPORTS), "--export: unknown format")
        files |= exported_files(formats, self.loaded, self._by_file())
        written = self._written(folder, files, overwrite)
        forget_fixes(written)
        return written

    def _files(self, write: Kinds) -> dict[str, Content]:
        raise NotImplementedError

    def _by_file(self) -> Mapping[str, Estimates]:
        """Return the estimates by the name (without suffix) of the file to which their trajectory is written."""
        return self.estimates

    def _written(self, folder: PathLike | None, files: Mapping[str, Content], overwrite: bool) -> list[Path]:
        place = results.default_folder(self.loaded.log.name) if folder is None else path_of(folder)
        write_results(place, files, overwrite)
        return [place / name for name in sorted(files)]


class Run(Result, frozen=True, eq=False):
    """The result of one configuration over one log, filtered and perhaps smoothed."""

    @property
    def filtered(self) -> Estimates:
        """The filter's estimates, with an audit of every measurement."""
        return next(e for e in self.estimates.values() if not e.smoothed)

    @property
    def smoothed(self) -> Estimates | None:
        """The smoothed estimates, which use the whole drive; None if not asked for."""
        return next((e for e in self.estimates.values() if e.smoothed), None)

    def _files(self, write: Kinds) -> dict[str, Content]:
        kinds = chosen(write, OF_RUN)
        files = exported_files(kinds - {"json"}, self.loaded, self._by_file())
        return files | ({"run.json": json_report.encode(self.report)} if "json" in kinds else {})

    def _by_file(self) -> Mapping[str, Estimates]:
        return {"smoothed" if e.smoothed else "trajectory": e for e in self.estimates.values()}

    @speaks_python
    def write_audit(self, file: PathLike) -> None:
        """Write every measurement with its NIS, gate threshold and verdict as CSV."""
        write_text(path_of(file), to.audit_csv(self.drive, self.filtered))

    @speaks_python
    def save_map(self, file: PathLike) -> None:
        """Write the line map of this run, with covariances, as JSON: `session.with_map` reads it.

        To a .csv, write the landmarks or anchors that the run estimated (`landmarks.map = "grow"`): use it as
        `landmarks.map`.
        """
        from locfuse.formats.robot import map_files

        if path_of(file).suffix == ".csv":
            if not self.filtered.points:
                hint = "--set landmarks.map=grow makes a map of them"
                raise UsageError("save_map: this run placed no landmarks", hint=hint)
            write_text(path_of(file), map_files.encode_landmarks(self.filtered.points))
            return
        if "lrf" not in self.filtered.sensors:
            words = "only the laser has a map, and this run did not use it; add lrf to its sensors"
            raise UsageError(f"save_map: {words}")
        write_text(path_of(file), map_files.encode_lines(self.filtered.final_map, self.loaded.log.name))


class Comparison(Result, frozen=True, eq=False):
    """The result of several configurations over one log, with the effect of each sensor."""

    @cached_property
    def verdicts(self) -> Named[dict[str, Any]]:
        """Verdicts by sensor: {"verdict": "helps", "words": the reason}."""
        return Named("sensor", self.report["verdicts"])

    @property
    def credit(self) -> Credit | None:
        """How much each sensor changes the position error, with confidence intervals; None without truth."""
        return self.compared.credit

    def _files(self, write: Kinds) -> dict[str, Content]:
        return files(self.compared, self.report, chosen(write, OF_COMPARISON))

    @speaks_python
    def write_figures(self, folder: PathLike) -> list[Path]:
        """Write every figure as SVG and PDF, for a paper, and return the files."""
        from locfuse.formats.figures.for_paper import paper_figures
        from locfuse.formats.figures.palette import traces_of
        from locfuse.formats.figures.sections import sections

        shown = sections(scene(self.compared))
        figures = paper_figures(shown, traces_of(self.compared.estimates), colours())
        return self._written(folder, figures, overwrite=True)


MCAP = "estimates.mcap"


def files(compared: Compared, report: Mapping[str, Any], kinds: Collection[str]) -> dict[str, Content]:
    """Return file name -> content for these kinds of output."""
    from locfuse.formats.report import markdown

    drive, out = compared.loaded.drive, dict[str, Content]()

    def page() -> str:
        from locfuse.formats.figures.sections import sections
        from locfuse.formats.report import html  # imports markupsafe

        return html.render(report, sections(scene(compared)), colours())

    if "tum" in kinds:
        out |= exported_files(["tum"], compared.loaded, {e.name: e for e in compared.estimates})
        out |= {} if drive.truth is None else {"truth.tum": to.truth_tum(drive, drive.truth)}
    made: dict[str, Callable[[], str]] = {
        "html": page,
        "md": lambda: markdown.render(report),
        "csv": lambda: table.csv(tables.everything(report)),
        "tex": lambda: tables.latex(report),
        "json": lambda: json_report.encode(report),
    }
    return out | {f"report.{kind}": make() for kind, make in made.items() if kind in kinds}


def scene(compared: Compared) -> Scene:
    """Return all data that figures show: drive, estimates, evaluations, and NIS with chi-square bounds."""
    from locfuse.formats.figures.panels import Scene

    drive, drawn = compared.loaded.drive, compared.drawn
    dof = 3 if any(j.heading is not None for j in compared.evaluations) else 2
    return Scene(
        drive=drive,
        estimates=[drawn.best if drawn.best and drawn.best.name == e.name else e for e in compared.estimates],
        evaluations=compared.evaluations,
        nis=drawn.nis,
        nees_bounds=(chi_square(0.025, dof) / dof, chi_square(0.975, dof) / dof),
        components={sensor: REGISTRY[sensor].components for sensor in drive.measurements},
        credit=credit_values(compared.credit) if compared.credit else None,
        landmarks=_landmarks(compared),
        events=events(compared.loaded, () if drawn.best is None else (drawn.best,)),
        states=WHEEL_STATES | {name: shown for s in REGISTRY.values() for name, shown in s.states.items()},
    )


def places(sensor: str, settings: Any) -> list[tuple[float, float]]:
    """Return the configured positions [m, map frame] of a sensor's landmarks and anchors."""
    given = settings.places.values() if sensor in of_points() and not settings.grows else ()
    found = (REGISTRY[sensor].landmark(settings), *given)
    return [(float(p[0]), float(p[1])) for p in found if p is not None]


def _landmarks(compared: Compared) -> list[tuple[float, float]]:
    """Return positions [m, map frame] of landmarks and anchors, given or estimated."""
    loaded = compared.loaded
    found = [p for s in loaded.drive.measurements for p in places(s, loaded.robot.settings(s))]
    best = max(compared.estimates, key=lambda e: (len(e.points), len(e.sensors)))
    return list(dict.fromkeys([*found, *((float(x), float(y)) for _, x, y in best.points)]))


def events(loaded: Loaded, runs: Iterable[Estimates]) -> list[Event]:
    """Return timed events: fault labels of the log, events of the drive and of runs with audits."""
    found = [*loaded.labels, *events_of_drive(loaded.drive)]
    for e in runs:
        found += events_of_run(thinned(loaded.drive, e.rates) if e.rates else loaded.drive, e)
    return sorted(found)


def exported_files(kinds: Collection[str], loaded: Loaded, found: Mapping[str, Estimates]) -> dict[str, Content]:
    """Return file name -> content in the formats of other tools; `found` has the trajectories by file name."""
    out: dict[str, Content] = {}
    writers: dict[str, dict[str, Callable[[Drive, Estimates], Iterator[str]]]] = {
        "kitti": {"_kitti.txt": to.kitti_blocks, "_kitti_times.txt": to.kitti_times},
        "tum": {".tum": to.tum_blocks},
        "tum-cov": {"_cov.tum": to.tum_covariance_blocks},
        "csv": {".csv": to.csv_blocks},
    }
    for ending, blocks in ((end, b) for kind in kinds for end, b in writers.get(kind, {}).items()):
        out |= {f"{n}{ending}": partial(to.write_blocks, blocks(loaded.drive, e)) for n, e in found.items()}
    if {"mcap", "log"} & set(kinds):
        out |= _mcap(loaded, found, "log" in kinds)
    return out


def _mcap(loaded: Loaded, found: Mapping[str, Estimates], with_log: bool) -> dict[str, Content]:
    """Return the MCAP file with the estimates as ROS 2 messages, and layouts to show it."""
    from locfuse.formats.results.mcap_export import Export, layouts

    tables = results.settings_tables(loaded.robot)
    for name, key, text in list(files_of(tables)):
        if not loaded.log.recorded(text):  # a file that is not part of the exported copy
            tables[name].pop(key, None)
    drive = loaded.drive
    delay_s = loaded.log.stream(loaded.choice.topics["wheels"], loaded.robot.order).delay_s or 0.0
    dt = np.diff(drive.t, prepend=drive.t[0])
    export = Export(
        drive=drive,
        estimates=tuple(found.values()),
        # mean body twist (n, 3) [m/s, m/s, rad/s] by the wheels over the interval that ends at each t
        twist=se2.log(drive.motions.u) / np.where(dt > 0.0, dt, np.inf)[:, None],
        robot_toml=robot_toml.dump(tables).encode(),
        clock_ns=round(delay_s * 1e9) if abs(delay_s) > MAX_DELAY_S else 0,
        log=loaded.log if with_log else None,
    )
    return {MCAP: export.write, **layouts(export.topics)}
