"""A log fused again under other settings: the cost of advice, with its limits.

Only sensors whose own settings change are measured again. A drive of more than MAX_INSTANTS is tried by its
beginning; what was tried is said with the figures.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import cast

from msgspec.structs import replace

from locfuse.cli.analysis.compare import PLAIN_FRAME, Compared
from locfuse.cli.analysis.configurations import Configuration
from locfuse.cli.analysis.load import Loaded, with_settings
from locfuse.cli.analysis.memory import lean
from locfuse.cli.analysis.settings import Asked, Progress
from locfuse.fusion.checks.score import Score
from locfuse.fusion.checks.tried import Fixes, keys
from locfuse.fusion.data import Drive, Estimates, Evaluation, LocfuseError
from locfuse.fusion.judge.covariance import honesty
from locfuse.fusion.judge.evaluate import Align, evaluate, shape_error
from locfuse.fusion.judge.predictive import listeners, mean_density
from locfuse.fusion.measure import windowed
from locfuse.fusion.paper.preset import fuser

MAX_INSTANTS = 2400  # of the drive: four minutes of a 10 Hz laser
SEEN_AFTERWARDS = {"truth.x", "truth.y", "truth.sigma", "truth.sigma_theta_deg"}  # keys that move no estimate
MAX_FUSIONS = 60  # runs of the filter that one log's advice may cost


@dataclass
class Trial:
    """Fuses one log under other settings as often as advice needs it, and remembers every score."""

    whole: Loaded
    configurations: Mapping[str, Configuration]
    align: str
    progress: Progress
    fusions: int = 0
    loaded: Loaded = field(init=False)  # what is tried of the log: all of it, or its beginning
    _end: float | None = field(init=False)  # s, of what is tried; None: of the drive
    _kept: tuple[Fixes, Loaded] = field(init=False)  # the fixes that were found, and the whole log under them
    _last: tuple[Fixes, Loaded | None] = ((), None)  # the whole log under the fixes that were asked for last
    _logs: dict[Fixes, Loaded | None] = field(default_factory=dict)
    _scores: dict[tuple[Fixes, str], Score] = field(default_factory=dict)
    _of_whole: dict[tuple[Fixes, str], Score] = field(default_factory=dict)
    _smoothed: dict[tuple[Fixes, str], Score] = field(default_factory=dict)
    _runs: dict[tuple[Fixes, str], Estimates] = field(
        default_factory=dict
    )  # of the fixes that were found

    def __post_init__(self) -> None:
        """Cut the log if fusing all of it many times would take too long."""
        t = self.whole.drive.t
        self._end = None if len(t) <= MAX_INSTANTS else float(t[MAX_INSTANTS])
        self.loaded = self._shortened(self.whole)
        self._kept = (), self.whole

    def keep(self, fixes: Fixes) -> None:
        """Take the log under these fixes as the one that others change: it is not measured again."""
        loaded = self.whole_under(fixes)
        if loaded is not None:
            self._kept = fixes, loaded
            self._runs = {}

    def __call__(self, fixes: Fixes, names: Sequence[str]) -> dict[str, Score]:
        """Return the scores of these configurations under more settings; {} if these cannot be applied."""
        found = {}
        for name in names:
            if (fixes, name) not in self._scores:
                loaded = self.under(fixes)
                if loaded is None or self.fusions >= MAX_FUSIONS:
                    return {}
                self.progress(f"trying {' '.join(fixes) or 'the settings as they are'} with {name}")
                e = self._runs.get((tuple(fix for fix in fixes if not keys((fix,)) <= SEEN_AFTERWARDS), name))
                score = self._score(loaded, self.configurations[name], e)
                if score is None:
                    return {}
                self._scores[fixes, name] = score
            found[name] = self._scores[fixes, name]
        return found

    def on_whole(self, fixes: Fixes, names: Sequence[str]) -> dict[str, Score]:
        """Return the scores of these configurations on the whole drive, also where its beginning is tried."""
        if self.loaded is self.whole:
            return self(fixes, names)
        left = [name for name in names if (fixes, name) not in self._of_whole]
        loaded = self.whole_under(fixes) if left else None
        for name in left:
            if loaded is None:
                return {}
            self.progress(f"trying {' '.join(fixes) or 'the settings as they are'} with {name} on the whole drive")
            score = self._score(loaded, self.configurations[name])
            if score is None:
                return {}
            self._of_whole[fixes, name] = score
        return {name: self._of_whole[fixes, name] for name in names}

    def smoothed(self, fixes: Fixes, names: Sequence[str]) -> dict[str, Score]:
        """Return the scores of the smoothed paths that a comparison shows, of these configurations.

        The position and heading by the truth on the whole drive: {} without truth.
        """
        if self.whole.drive.truth is None:
            return {}
        every = self.configurations
        shown = [n for n in names if every[n].is_smoothed(Asked(), self.whole.robot)]
        left = [name for name in shown if (fixes, name) not in self._smoothed]
        loaded = self.whole_under(fixes) if left else None
        for name in left:
            if loaded is None:
                break
            self.progress(f"smoothing {name} with {' '.join(fixes) or 'the settings as they are'}")
            e = lean(every[name].fuse, loaded.drive, loaded.robot, True)[-1]
            if e.smoothed:
                judged = evaluate(e, loaded.drive, cast("Align", self.align))
                self.of_smoothed(fixes, name, judged, shape_error(e, loaded.drive))
        return {name: self._smoothed[fixes, name] for name in shown if (fixes, name) in self._smoothed}

    def of_smoothed(self, fixes: Fixes, name: str, judged: Evaluation, shape: float | None) -> None:
        """Receive a smoothed path of a configuration on the whole drive, judged under these settings."""
        self._smoothed[fixes, name] = score_of(judged, shape)._replace(anees=None, bounds=None)

    def of_whole(self, name: str, score: Score) -> None:
        """Receive the score of a configuration on the whole drive under the present settings."""
        self._of_whole[(), name] = score

    def seed(self, fixes: Fixes, compared: Compared) -> None:
        """Receive scores of a comparison under these settings, which need not be fused again."""
        if compared.loaded.drive.truth is None:
            return  # those come by `heard`
        for e, judged in zip(compared.estimates, compared.evaluations, strict=True):
            if judged.name in self.configurations:
                self._runs[fixes, judged.name] = e
                self._scores[fixes, judged.name] = score_of(judged, shape_error(e, compared.loaded.drive))

    def heard(self, fixes: Fixes, loaded: Loaded, e: Estimates) -> None:
        """Receive the score of a run with listening sensors, which need not be fused again."""
        if e.name in self.configurations:
            self._scores[fixes, e.name] = predicted(loaded.drive, e)

    def under(self, fixes: Fixes) -> Loaded | None:
        """Return the log under more settings; None if they fit neither the log nor each other."""
        if not fixes:
            return self.loaded
        if fixes not in self._logs:
            whole = self.whole_under(fixes)
            self._logs[fixes] = None if whole is None else self._shortened(whole)
        return self._logs[fixes]

    def whole_under(self, fixes: Fixes) -> Loaded | None:
        """Return the whole log under more settings, also where only its beginning is tried."""
        if not fixes:
            return self.whole
        if fixes != self._last[0]:
            self._last = (), None  # an hour under every setting that is tried would be hundreds of megabytes
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
        return replace(loaded, drive=drive, robot=robot, window=(loaded.window[0], self._end))

    def fused(self, loaded: Loaded, name: str) -> Estimates | None:
        """Return one configuration's run, None if the log lacks a sensor under these settings."""
        self.fusions += 1
        try:
            return lean(self.configurations[name].fuse, loaded.drive, loaded.robot, False)[0]
        except LocfuseError:
            return None

    def _score(self, loaded: Loaded, c: Configuration, e: Estimates | None = None) -> Score | None:
        """Return the score of a configuration, by its run `e` if that is known."""
        if loaded.drive.truth is None:
            return self._predicted(loaded, c)
        e = self.fused(loaded, c.name) if e is None else e
        if e is None:
            return None
        judged = evaluate(e, loaded.drive, cast("Align", self.align))
        return score_of(judged, shape_error(e, loaded.drive))

    def _predicted(self, loaded: Loaded, c: Configuration) -> Score | None:
        """Score a configuration by its predictions of the sensors that only listen."""
        self.fusions += 1
        drive = loaded.drive
        if any(s not in drive.measurements for s in c.sensors):
            return None
        flags = listeners(drive, c.sensors)
        e = lean(fuser(loaded.robot.preset), drive, loaded.robot, c.sensors, c.name, flags)
        return predicted(drive, e)


def predicted(drive: Drive, e: Estimates) -> Score:
    """Return a run's predictions of the sensors that only listened to it.

    That it is lost with half of its readings taken away says nothing of a drive that has them all.
    """
    return Score(prediction=mean_density(drive, e, listeners(drive, e.sensors)))


def score_of(judged: Evaluation, shape: float | None = None) -> Score:
    """Return a configuration's figures against truth; `shape` is the error of its path's shape [m]."""
    found = honesty(judged) if judged.align == PLAIN_FRAME else None
    return Score(
        judged.figures.get("position_rmse_m"),
        judged.figures.get("anees"),
        None if found is None else found.bounds,
        lost=judged.lost_share,
        shape=shape,
        heading=judged.figures.get("heading_rmse_deg"),
    )
