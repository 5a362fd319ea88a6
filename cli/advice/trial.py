"""Trials of fixes: one log fused again under other settings, with a limit on the number of runs.

Only sensors whose settings change are measured again. In a drive of more than MAX_INSTANTS update times, fixes are
tried on the beginning.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import cast

from msgspec.structs import replace

from locfuse.cli.analysis.compare import PLAIN_FRAME, Compared
from locfuse.cli.analysis.configurations import Configuration, fuser
from locfuse.cli.analysis.load import Loaded, with_settings
from locfuse.cli.analysis.settings import Asked, Progress
from locfuse.fusion.checks.tried import Fixes, Marks, keys
from locfuse.fusion.data import LASER, Drive, Estimates, Evaluation, LocfuseError
from locfuse.fusion.judge.evaluate import Align, covariance_check, evaluate, shape_error
from locfuse.fusion.judge.without_truth import OwnScans, listeners, mean_density
from locfuse.fusion.measure import windowed

MAX_INSTANTS = 2400  # update times: 4 min of a 10 Hz laser
# keys that do not change estimates
SEEN_AFTERWARDS = {"truth.x", "truth.y", "truth.yaw_deg", "truth.sigma", "truth.sigma_theta_deg"}
TRIED, WHOLE, SMOOTHED = "trying", "trying on the whole drive", "smoothing"  # kinds of figures
MAX_FUSIONS = 60  # runs of the filter for one log's advice
MAX_STORED_RUNS = 12  # runs of one configuration on the beginning that are stored


@dataclass
class Trial:
    """Fuses one log under other settings, and stores the figures."""

    whole: Loaded
    configurations: Mapping[str, Configuration]
    align: str
    progress: Progress
    fusions: int = 0
    loaded: Loaded = field(init=False)  # the log for trials: whole, or its beginning
    _end: float | None = field(init=False)  # s, end of the beginning; None: whole
    _kept: tuple[Fixes, Loaded] = field(init=False)  # kept fixes, and the whole log under them
    _last: tuple[Fixes, Loaded | None] = ((), None)  # fixes of the last call, and the whole log under them
    _logs: dict[Fixes, Loaded | None] = field(default_factory=dict)
    _marks: dict[tuple[str, Fixes, str], Marks] = field(default_factory=dict)  # by TRIED, WHOLE or SMOOTHED
    # the last runs by kind and configuration, then by the fixes that change them
    _runs: dict[tuple[str, str], dict[Fixes, Estimates]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Limit trials on a long drive to its first MAX_INSTANTS update times."""
        t = self.whole.drive.t
        self._end = None if len(t) <= MAX_INSTANTS else float(t[MAX_INSTANTS])
        self.loaded = self._shortened(self.whole)
        self._kept = (), self.whole

    def keep(self, fixes: Fixes) -> None:
        """Make the log under these fixes the base of later trials, so that fewer sensors are measured again."""
        loaded = self.whole_under(fixes)
        if loaded is not None:
            self._kept = fixes, loaded

    def __call__(self, fixes: Fixes, names: Sequence[str]) -> dict[str, Marks]:
        """Return the figures of these configurations with settings added; {} if they cannot be applied."""
        return self._of(TRIED, fixes, names)

    def on_whole(self, fixes: Fixes, names: Sequence[str]) -> dict[str, Marks]:
        """Return the figures of these configurations on the whole drive, {} if the settings cannot be applied."""
        return self._of(self._kind_of_whole, fixes, names)

    def smoothed(self, fixes: Fixes, names: Sequence[str]) -> dict[str, Marks]:
        """Return the errors of the smoothed paths of `names` that are shown by default; {} without truth."""
        if self.whole.drive.truth is None:
            return {}
        shown = [n for n in names if self.configurations[n].is_smoothed(Asked(), self.whole.robot)]
        return self._of(SMOOTHED, fixes, shown)

    def agreement(self, fixes: Fixes) -> float | None:
        """Return the share of scan points that agree at revisited places, in the run with the laser alone.

        None if the log has a truth (errors judge better), or no such run.
        """
        name = next((n for n, c in self.configurations.items() if c.sensors == (LASER,)), None)
        if self.whole.drive.truth is not None or name is None:
            return None
        loaded = self.whole_under(fixes)
        if self.loaded is self.whole:
            run = self.run(fixes, name)
        else:
            run = None if loaded is None else self.fused(loaded, name)
        scans = None if loaded is None or run is None else OwnScans.of(loaded.drive)
        return None if scans is None or run is None else scans.judge(run)[0]

    def _of(self, kind: str, fixes: Fixes, names: Sequence[str]) -> dict[str, Marks]:
        for name in (n for n in names if (kind, fixes, n) not in self._marks):
            loaded = self.under(fixes) if kind == TRIED else self.whole_under(fixes)
            if loaded is None or (kind == TRIED and self.fusions >= MAX_FUSIONS):
                return {}
            self.progress(f"{kind} {' '.join(fixes) or 'the settings as they are'} with {name}")
            marks = self._fused_marks(kind, fixes, name, loaded)
            if marks is None:
                return {}
            self._marks[kind, fixes, name] = marks
        return {name: self._marks[kind, fixes, name] for name in names}

    def _fused_marks(self, kind: str, fixes: Fixes, name: str, loaded: Loaded) -> Marks | None:
        drive = loaded.drive
        if drive.truth is None:  # the run is scored by its predictions of the sensors that it does not use
            self.fusions += 1
            c = self.configurations[name]
            if any(s not in drive.measurements for s in c.sensors):
                return None
            flags = listeners(drive, c.sensors)
            # no share of time lost: some of its own readings may be left out here, to be predicted
            alone = fuser(loaded.robot.preset)(drive, loaded.robot, c.sensors, c.name, flags)
            return Marks(prediction=mean_density(drive, alone, flags))
        e = self.stored(kind, fixes, name)
        if e is None:
            before = self.stored(self._kind_of_whole, fixes, name) if kind == SMOOTHED else None
            e = self.fused(loaded, name, kind == SMOOTHED, before)
        if e is None or e.smoothed != (kind == SMOOTHED):
            return None
        self._store(kind, fixes, e)
        return marks_of(e, evaluate(e, drive, cast("Align", self.align)), drive)

    @property
    def _kind_of_whole(self) -> str:
        return TRIED if self.loaded is self.whole else WHOLE

    def stored(self, kind: str, fixes: Fixes, name: str) -> Estimates | None:
        """Return a stored run under fixes that give the same estimates; None without one."""
        return self._runs.get((kind, name), {}).get(moving_part(fixes))

    def run(self, fixes: Fixes, name: str) -> Estimates | None:
        """Return a configuration's run on the log for trials, with its audits; None if it cannot be fused."""
        loaded, e = self.under(fixes), self.complete(fixes).get(name)
        if e is None and loaded is not None and (e := self.fused(loaded, name)) is not None:
            self._store(TRIED, fixes, e)
        return e

    def complete(self, fixes: Fixes) -> dict[str, Estimates]:
        """Return the stored runs for trials under these fixes that have their audits, by configuration."""
        runs = ((name, c, self.stored(TRIED, fixes, name)) for name, c in self.configurations.items())
        return {name: e for name, c, e in runs if e is not None and set(c.sensors) <= set(e.audits)}

    def _store(self, kind: str, fixes: Fixes, e: Estimates) -> None:
        """Store a run, in place of the oldest one if there are too many."""
        if kind == SMOOTHED:
            return
        runs, moving = self._runs.setdefault((kind, e.name), {}), moving_part(fixes)
        if moving in runs:
            return
        # of a whole drive only one: an hour's run takes tens of megabytes
        if len(runs) >= (MAX_STORED_RUNS if kind == TRIED else 1):
            del runs[next(iter(runs))]
        smoothed = self.configurations[e.name].is_smoothed(Asked(), self.whole.robot)
        runs[moving] = e if kind == TRIED or smoothed else replace(e, audits={})

    def know(self, kind: str, fixes: Fixes, name: str, marks: Marks) -> None:
        """Store the figures of a finished run, so that it is not fused again."""
        self._marks[kind, fixes, name] = marks

    def seed(self, fixes: Fixes, compared: Compared) -> None:
        """Store the figures of a comparison, and if the log has a truth also the runs."""
        for name, density in compared.densities.items():
            self.know(TRIED, fixes, name, Marks(prediction=density))
        if compared.loaded.drive.truth is None:
            return
        for e, judged in zip(compared.estimates, compared.evaluations, strict=True):
            self._store(TRIED, fixes, e)
            self.know(TRIED, fixes, e.name, marks_of(e, judged, compared.loaded.drive))

    def under(self, fixes: Fixes) -> Loaded | None:
        """Return the log (or its beginning) with settings added; None if they cannot be applied."""
        if not fixes:
            return self.loaded
        if fixes not in self._logs:
            whole = self.whole_under(fixes)
            self._logs[fixes] = None if whole is None else self._shortened(whole)
        return self._logs[fixes]

    def whole_under(self, fixes: Fixes) -> Loaded | None:
        """Return the whole log with settings added; None if they cannot be applied."""
        if not fixes:
            return self.whole
        if fixes != self._last[0]:
            self._last = (), None  # only one: an hour's log takes hundreds of megabytes
            kept, loaded = self._kept
            if not keys(kept) <= keys(fixes):
                kept, loaded = (), self.whole
            more = tuple(fix for fix in fixes if fix not in kept)
            try:
                self._last = fixes, with_settings(loaded, more) if more else loaded
            except LocfuseError:
                self._last = fixes, None
        return self._last[1]

    def _shortened(self, loaded: Loaded) -> Loaded:
        if self._end is None:
            return loaded
        drive, robot = windowed(loaded.drive, loaded.robot, None, self._end)
        return replace(loaded, drive=drive, robot=robot, how=replace(loaded.how, end=self._end))

    def fused(
        self, loaded: Loaded, name: str, smooth: bool = False, filtered: Estimates | None = None
    ) -> Estimates | None:
        """Run one configuration; None if the log lacks a sensor under these settings.

        `filtered` is the filter's run, if known, which is then only smoothed.
        """
        self.fusions += 1
        try:
            return self.configurations[name].fuse(loaded.drive, loaded.robot, smooth, filtered)[-1]
        except LocfuseError:
            return None


def moving_part(fixes: Fixes) -> Fixes:
    """Return the fixes that change estimates, sorted."""
    return tuple(sorted(fix for fix in fixes if not keys((fix,)) <= SEEN_AFTERWARDS))


def marks_of(e: Estimates, judged: Evaluation, drive: Drive) -> Marks:
    """Return a run's figures against truth: errors, ANEES, share of the time lost."""
    found = covariance_check(judged) if judged.align == PLAIN_FRAME else None
    return Marks(
        judged.figures.get("position_rmse_m"),
        judged.figures.get("anees"),
        None if found is None else found.bounds,
        lost=judged.lost_share,
        shape=shape_error(e, drive),
        heading=judged.figures.get("heading_rmse_deg"),
    )
