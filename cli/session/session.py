"""Sessions: a measured log that can be fused with any sensors, and compared, without reading the log again.

The single steps, for use one by one: open_log -> load -> fuse -> evaluate.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Unpack, cast, get_args

import msgspec
from msgspec.structs import replace

from locfuse.cli.advice.evaluator import advise, advise_on_run
from locfuse.cli.advice.report import Advised, complete
from locfuse.cli.analysis import maps
from locfuse.cli.analysis.compare import (
    Compared,
    add_jitter,
    compare_log,
    report_of,
    report_of_run,
    run_log,
    with_others,
)
from locfuse.cli.analysis.configurations import Configuration, Sensors, configuration_words, for_comparison, parse
from locfuse.cli.analysis.load import Loaded, find_log, load as load_log, with_settings
from locfuse.cli.analysis.results import say_motion
from locfuse.cli.analysis.settings import (
    MAX_REFERENCE_INSTANTS,
    Asked,
    Choices,
    LogOptions,
    PathLike,
    Progress,
    Sets,
    cells,
    check_jitter,
    log_options,
    one_of,
    path_of,
    set_words,
    silent,
    words_of,
)
from locfuse.formats.logs import log as logs
from locfuse.formats.logs.log import Log
from locfuse.formats.robot.robot_toml import as_set
from locfuse.formats.text import visible
from locfuse.fusion.data import Drive, Estimates, Evaluation, LocfuseError, UsageError
from locfuse.fusion.judge import evaluate as judge
from locfuse.fusion.judge.evaluate import Align
from locfuse.fusion.measure import thinned
from locfuse.fusion.robot import Robot

from .python_words import speaks_python
from .result import Comparison, Named, Run

if TYPE_CHECKING:
    from .calibrate import Calibration
    from .tune import Tuning


@speaks_python
def load(
    log: PathLike | Sequence[PathLike],
    *,
    robot: PathLike | None = None,
    sets: Sets | None = None,
    order: str | None = None,
    preset: str | None = None,
    between: tuple[float | None, float | None] = (None, None),
    progress: Progress = silent,
) -> Session:
    """Open a log, choose its topics, and measure every sensor once.

    Args:
        log: an .mcap, .db3 or .bag file, a rosbag2 folder, the name of a sample log ("rounded_rectangle"), or a
            list with the parts of one recording.
        robot: a robot.toml; its keys override those of the robot.toml attached to the log.
        sets: single keys that override both, {"lrf.topic": "/front/scan", "wheels.radius": 0.033}.
        order: clock that is used if stamps run backwards: "auto", "stamp" or "recorded".
        preset: "default", or "paper" for the paper's equations as printed.
        between: (30.0, 90.0) uses only this time, in seconds since the first wheel reading; None: no bound.
        progress: called with the name of every step, such as `print`.

    Raises:
        LocfuseError: no such file, not a log, no wheels, or an invalid setting. The message is one line.
    """
    how = replace(log_options(robot, sets, order, preset), begin=between[0], end=between[1])
    return opened(words_of(log), how, progress)


def opened(log: Sequence[str], how: LogOptions, progress: Progress, read_again: bool = False) -> Session:
    """Open a log given as command-line words, with the map in `how`; its columns stay only with `read_again`."""
    loaded = load_log(log, how, progress)
    if not read_again:
        loaded.log.forget()
    session = Session(maps.give_topic(loaded), progress)
    return session if how.given_map is None else session.with_map(how.given_map)


@speaks_python
def info(
    log: PathLike | Sequence[PathLike],
    *,
    robot: PathLike | None = None,
    sets: Sets | None = None,
    order: str | None = None,
    progress: Progress = silent,
) -> dict[str, Any]:
    """Return what is in a log, which sensor reads which topic and why, what is missing, and what looks wrong.

    Use it for a log that `load` refuses: an error becomes a finding, with the settings that fix it. Values are as
    printed by `locfuse info LOG --json`; `locfuse schema info` has their units and meaning. Arguments are those of
    `load`. Raises LocfuseError for no such file, not a log, or a robot.toml that cannot be read.
    """
    return inspected(words_of(log), log_options(robot, sets, order, None), progress)


def inspected(log: Sequence[str], how: LogOptions, progress: Progress) -> dict[str, Any]:
    """Return the result of `info` for a log given as command-line words."""
    from locfuse.cli.inspect.inspect_log import inspect_log
    from locfuse.cli.inspect.robot_facts import values

    return values(inspect_log(log, how, progress))


def tried_by_fusing(log: Sequence[str], how: LogOptions, progress: Progress) -> dict[str, Any]:
    """Return `Session.findings` of a log given as command-line words; {} if the log cannot be fused."""
    try:
        return opened(log, how, progress).findings()
    except LocfuseError:
        return {}  # `info` reports the reason


class Session(msgspec.Struct, frozen=True, eq=False):
    """A measured log with its settings."""

    loaded: Loaded
    progress: Progress = silent

    @property
    def log(self) -> Log:
        """The log: `log.topics`, `log.stream("/scan").columns("ranges")`."""
        return self.loaded.log

    @property
    def robot(self) -> Robot:
        """The effective settings: `robot.wheels.radius`, `robot.settings("lrf").topic`."""
        return self.loaded.robot

    @property
    def drive(self) -> Drive:
        """The measured log: wheel motion, measurements by sensor, truth; reasons for missing ones in `absent`."""
        return self.loaded.drive

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes on choices, repairs and unusual data while reading the log."""
        return self.drive.notes

    @speaks_python
    def run(
        self,
        sensors: Sensors | Configuration = "all",
        *,
        align: str = "none",
        smooth: bool | None = None,
        advice: bool = True,
        jitter: int = 0,
    ) -> Run:
        """Estimate the trajectory with one set of sensors, as `locfuse run` does.

        Args:
            sensors: "all", "odometry", "compass,lrf", ["compass", "lrf"], or "lrf@2Hz" for a lower rate.
            align: "none", "origin" or "se2": how to move the estimate onto the truth before judging it.
            smooth: also compute the smoothed path, in which each pose uses the whole drive. None: with a laser.
            advice: if something looks wrong, evaluate the log as `compare` does, and try fixes.
            jitter: number of additional runs with stamps moved by 1 us and 1 % of the readings dropped; the report
                then has the range of every figure under `configurations.<name>.jitter`.

        Raises:
            LocfuseError: an unknown sensor, or one that this log lacks.
        """
        one_of(align, get_args(Align), "align")
        asked = Asked(align=align, smooth=smooth, jitter=check_jitter(jitter))
        used = sensors if isinstance(sensors, Configuration) else parse(sensors, self.drive)
        self.progress("fusing")
        compared = run_log(self.loaded, used, asked)
        advised = Advised() if advice else None
        if advice and self._moves():
            advised = advise_on_run(compared, self.progress, align)
        report = report_of_run(compared)
        self._complete(report, compared, asked, advised)
        return Run(compared, report)

    @speaks_python
    def compare(
        self, sensors: Sensors | Iterable[Sensors] | None = None, **choices: Unpack[Choices]
    ) -> Comparison:
        """Run several configurations and evaluate what each sensor adds, as `locfuse compare` does.

        Args:
            sensors: the configurations, such as ["odometry", "compass+lrf", "all", "lrf@2Hz"]; None compares
                odometry, each sensor alone, and all.
            **choices: any of these.
                all_subsets (False): run every subset of the sensors, which gives the average effect of each.
                align ("none"): "origin" or "se2" moves every estimate onto the truth before judging it.
                smooth (None): also smooth every configuration that has sensors: "all-smoothed". None: only those
                with a laser, and none with `jitter`.
                audits (True): keep innovation and verdict of every measurement,
                `estimates["lrf"].audits["lrf"]`. They take most of a result's memory; False frees them as soon
                as the figures are computed.
                advice (True): if something looks wrong, try fixes by fusing again, and report their effect.
                jitter (0): number of additional runs with stamps moved by 1 us and 1 % of the readings dropped;
                the report then has the range of every figure, and a verdict that changes becomes "no effect
                seen".
                estimates ({}): estimates of other programs as rows, {"amcl": "/amcl_pose", "slam": "slam.tum"}.
                reference (None): without truth, measure errors against a smoothed solution of the whole drive.
                None: only if the drive is short or is smoothed anyway.

        Raises:
            LocfuseError: an unknown sensor, or one that this log lacks.
        """
        return self.compared(Asked(configuration_words(sensors), **choices))

    def compared(self, asked: Asked) -> Comparison:
        """Run and evaluate the configurations of `asked`, as `compare` does; return all runs and the report."""
        check_jitter(asked.jitter)
        asked = replace(asked, reference=self._uses_reference(asked))
        wanted = for_comparison(asked.sensors, self.drive, asked.all_subsets)
        foreign: list[Estimates] = []
        if asked.estimates:
            from .foreign import foreign_estimates, named_sources

            foreign = foreign_estimates(self.loaded, named_sources(asked.estimates), [c.name for c in wanted])
        alone = compare_log(self.loaded, wanted, asked, self.progress, draws=True)
        compared = with_others(alone, asked, foreign, self.progress)
        report = report_of(compared, None if foreign or self.loaded.given is None else asked)
        advised = None
        if asked.advice and self._moves():
            advised = advise(self.loaded, self.progress, asked.align, alone)
        self._complete(report, compared, asked, advised)
        return Comparison(compared, report)

    def _uses_reference(self, asked: Asked) -> bool:
        """Return whether errors are measured against a smoothed solution (a reference) instead of the truth.

        `asked.reference` decides. If it is None, a reference is used only without truth, for a drive that is short
        or is smoothed anyway. Raises UsageError if a reference is asked for but impossible.
        """
        wanted = asked.reference
        if wanted and asked.jitter:
            words = "of a jittered drive there is no reference; use one"
            raise UsageError(f"--reference --jitter {asked.jitter}: {words}")
        short = asked.smooth or len(self.drive.t) <= MAX_REFERENCE_INSTANTS
        if wanted is False or asked.jitter or not (wanted or (short and self.drive.truth is None)):
            return False
        from locfuse.fusion.whole_drive.reference import may_have_reference, refuse_reference

        if wanted:
            refuse_reference(self.drive, self.robot)
        return may_have_reference(self.drive, self.robot)

    @speaks_python
    def info(self) -> dict[str, Any]:
        """Return what is in the log and what looks wrong, as `locfuse.info` does, under the session's settings."""
        return inspected(self._words, self.loaded.how, self.progress)

    @speaks_python
    def tune(
        self,
        *more: PathLike | Sequence[PathLike],
        sensors: str = "all",
        hold_out: Sequence[PathLike | Sequence[PathLike]] = (),
        drift: bool = False,
    ) -> Tuning:
        """Estimate sensor and wheel noise (maximum likelihood), as `locfuse tune` does.

        Args:
            *more: more logs of the same robot.
            sensors: sensors whose noise is tuned, by their readings only: "compass,lrf".
            hold_out: logs that judge the tuned noise, not used for tuning; (): the last fifth of every log.
            drift: also estimate whether the compass' offset drifts.

        Raises:
            LocfuseError: an unknown sensor, or a log with a wrong setting that larger noise would hide.
        """
        from . import tune

        logs, held = [self._words, *map(words_of, more)], [*map(words_of, hold_out)]
        return tune.tune_logs(logs, held, tune.sensor_names(sensors), drift, self.loaded.how, self.progress)

    @speaks_python
    def calibrate(self, *more: PathLike | Sequence[PathLike]) -> Calibration:
        """Estimate wheel noise, wheel geometry, laser mount and magnetometer iron, as `locfuse calibrate` does.

        `more` are more logs of the same robot. Raises LocfuseError if the logs show none of these.
        """
        from . import calibrate

        return calibrate.calibrated([self._words, *map(words_of, more)], self.loaded.how, self.progress)

    @property
    def _words(self) -> list[str]:
        return [str(path) for path in self.log.paths]

    @speaks_python
    def findings(self) -> dict[str, Any]:
        """Return the advice in the report of `compare`: problems, and fixes tried by fusing.

        Keys: "headline", "validity", "findings", "fixes".
        """
        report = self.compare(audits=False, smooth=False).report
        return {key: report[key] for key in ("headline", "validity", "findings", "fixes")}

    def _complete(self, report: dict[str, Any], compared: Compared, asked: Asked, advised: Advised | None) -> None:
        """Add ranges under jitter, advice, and warnings on the motion to `report`."""
        if asked.jitter:
            add_jitter(report, compared, asked, self.progress)
        complete(report, compared, advised)
        say_motion(report, self.loaded, advised is not None and "verdicts" in report)
        self.progress("writing")

    def _moves(self) -> bool:
        """Return whether the robot moves, and the chosen motion is the robot's."""
        return not (self.drive.wheels.stands or self.loaded.motion_faults)

    @speaks_python
    def with_settings(self, sets: Sets) -> Session:
        """Return the log under other settings; only sensors whose settings change are measured again.

        The result equals that of `load` with these `sets`, bit for bit. Raises UsageError for an unknown key, and
        for a topic, `order` or `preset`: these decide what is read.
        """
        return replace(self, loaded=with_settings(self.loaded, set_words(sets), self.progress))

    @speaks_python
    def sweep(
        self,
        keys: Mapping[str, Iterable[Any]],
        sensors: Sensors | Iterable[Sensors] | None = None,
        **choices: Unpack[Choices],
    ) -> Named[Comparison]:
        """Compare under every combination of settings, {"lrf.sigma_range": [0.01, 0.03], "lrf.map": ["grow"]}.

        Returns the comparisons by combination, "lrf.sigma_range=0.01 lrf.map=grow". Only sensors whose settings
        change are measured again. Other arguments are those of `compare`, but `audits`, `advice`, `reference` and
        `smooth` are False by default. Raises UsageError as `with_settings` does, and for over 1000 combinations.
        """
        found = cells({key: [as_set(key, value) for value in values] for key, values in keys.items()})
        plain: Choices = {"audits": False, "advice": False, "reference": False, "smooth": False}
        asked: Choices = {**plain, **choices}
        results = {cell: self.with_settings(sets).compare(sensors, **asked) for cell, sets in found.items()}
        return Named("cell", results)

    @speaks_python
    def with_map(self, file: PathLike) -> Session:
        """Return the session with a map file in which the laser localises; the map is not extended.

        The file is a line map written by `Run.save_map`, or the .yaml of an image map (ROS's map_server). In an
        image map the start is searched for, unless `[start]` is set. Raises LocfuseError for a map of another
        building.
        """
        return replace(self, loaded=maps.give(self.loaded, path_of(file)))

    def __repr__(self) -> str:
        """Return the log's name, duration and measured sensors as text."""
        sensors = ", ".join(("wheels", *self.drive.measurements))
        truth = "no truth" if self.drive.truth is None else f"truth {self.drive.truth.topic}"
        lasts = f"{self.drive.t[-1] - self.drive.t[0]:.1f} s"
        return visible(f"<Session of {self.log.name}: {lasts}, {sensors}; {truth}>")


@speaks_python
def open_log(log: PathLike | Sequence[PathLike]) -> Log:
    """Open a log without measuring it: `log.topics`, `log.stream("/scan").columns("ranges")`.

    `log` is as in `load`. Raises LocfuseError if it does not exist.
    """
    return logs.open_log(find_log(words_of(log)))


@speaks_python
def fuse(drive: Drive, robot: Robot, sensors: Sensors = "all") -> Estimates:
    """Run the filter over a drive with these sensors: `fuse(session.drive, session.robot, ["compass", "lrf"])`.

    Returns pose (n, 3) and covariance P (n, 3, 3) at the drive's times t (n,), and the audit of every measurement.
    Raises LocfuseError for an unknown sensor, or one that the drive lacks.
    """
    return parse(sensors, drive).fuse(drive, robot)[0]


@speaks_python
def smooth(drive: Drive, robot: Robot, sensors: Sensors = "all") -> Estimates:
    """Run filter and smoother: each pose uses the whole drive, also later readings.

    Rauch, Tung and Striebel (1965). Raises LocfuseError as `fuse` does, and if a setting such as lrf.map =
    first-scan makes the filter's gain suboptimal.
    """
    return parse(sensors, drive).fuse(drive, robot, smooth=True)[-1]


@speaks_python
def evaluate(estimates: Estimates, drive: Drive, align: str = "none") -> Evaluation:
    """Judge an estimate by the drive's truth: deviations, and figures such as `figures["position_rmse_m"]`.

    `align`: "none", "origin" or "se2". Without truth the error figures are None.
    """
    one_of(align, get_args(Align), "align")
    seen = thinned(drive, estimates.rates) if estimates.rates else drive
    return judge.evaluate(estimates, seen, cast("Align", align))
