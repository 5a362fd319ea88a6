"""A log fused again under other settings: what `advice` costs, and where that is bounded.

Only sensors whose own settings change are measured again. A drive of more than MAX_INSTANTS is tried by its
beginning; what was tried is said with the figures.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import cast

import numpy as np

from locfuse.cli.pipeline.compare import PLAIN_FRAME, Compared
from locfuse.cli.pipeline.configurations import Configuration
from locfuse.cli.pipeline.load import Loaded, with_settings
from locfuse.cli.pipeline.memory import lean
from locfuse.cli.pipeline.settings import Progress
from locfuse.fusion.advice.score import Score
from locfuse.fusion.advice.search import Fixes
from locfuse.fusion.data import Drive, Estimates, Evaluation, LocfuseError
from locfuse.fusion.judge.covariance import honesty
from locfuse.fusion.judge.evaluate import Align, evaluate
from locfuse.fusion.judge.predictive import listeners, log_density
from locfuse.fusion.measure import windowed
from locfuse.fusion.paper.preset import fuser

MAX_INSTANTS = 2400  # of the drive: four minutes of a 10 Hz laser
MAX_FUSIONS = 60  # runs of the filter that one log's advice may cost


def shortened(loaded: Loaded) -> Loaded:
    """Return the log, or its beginning where all of it would take too long to fuse many times."""
    t = loaded.drive.t
    if len(t) <= MAX_INSTANTS:
        return loaded
    begin = loaded.window[0]
    end = float(t[MAX_INSTANTS])
    drive, robot = windowed(loaded.drive, loaded.robot, None, end)
    return replace(loaded, drive=drive, robot=robot, window=(begin, end))


@dataclass
class Trial:
    """Fuses one log under other settings as often as advice needs it, and remembers every score."""

    loaded: Loaded
    configurations: Mapping[str, Configuration]
    align: str
    progress: Progress
    fusions: int = 0
    _logs: dict[Fixes, Loaded | None] = field(default_factory=dict)
    _scores: dict[tuple[Fixes, str], Score] = field(default_factory=dict)

    def __call__(self, fixes: Fixes, names: Sequence[str]) -> dict[str, Score]:
        """Return the scores of these configurations under more settings; {} where these cannot be applied."""
        found = {}
        for name in names:
            if (fixes, name) not in self._scores:
                loaded = self.under(fixes)
                if loaded is None or self.fusions >= MAX_FUSIONS:
                    return {}
                self.progress(f"trying {' '.join(fixes) or 'the settings as they are'} with {name}")
                score = self._score(loaded, self.configurations[name])
                if score is None:
                    return {}
                self._scores[fixes, name] = score
            found[name] = self._scores[fixes, name]
        return found

    def seed(self, fixes: Fixes, compared: Compared) -> None:
        """Take scores from a comparison under these settings, which need not be fused again."""
        if compared.loaded.drive.truth is None:
            return  # what only listens is not among its runs
        for judged in compared.evaluations:
            if judged.name in self.configurations:
                self._scores[fixes, judged.name] = score_of(judged)

    def under(self, fixes: Fixes) -> Loaded | None:
        """Return the log under more settings; None where they fit neither the log nor each other."""
        if not fixes:
            return self.loaded
        if fixes not in self._logs:
            try:
                self._logs[fixes] = with_settings(self.loaded, fixes)
            except LocfuseError:
                self._logs[fixes] = None
        return self._logs[fixes]

    def fused(self, loaded: Loaded, name: str) -> Estimates | None:
        """Return one configuration's run, None where the log lacks a sensor under these settings."""
        self.fusions += 1
        try:
            return lean(self.configurations[name].fuse, loaded.drive, loaded.robot, False)[0]
        except LocfuseError:
            return None

    def _score(self, loaded: Loaded, c: Configuration) -> Score | None:
        if loaded.drive.truth is None:
            return self._predicted(loaded, c)
        e = self.fused(loaded, c.name)
        return None if e is None else score_of(evaluate(e, loaded.drive, cast("Align", self.align)))

    def _predicted(self, loaded: Loaded, c: Configuration) -> Score | None:
        """Score a configuration by what it predicts of the sensors that only listen."""
        self.fusions += 1
        drive = loaded.drive
        if any(s not in drive.measurements for s in c.sensors):
            return None
        flags = listeners(drive, c.sensors)
        e = lean(fuser(loaded.robot.preset), drive, loaded.robot, c.sensors, c.name, flags)
        # that it is lost with half of its readings taken away says nothing of a drive that has them all
        return Score(prediction=mean_density(drive, e, flags))


def score_of(judged: Evaluation) -> Score:
    """Return a configuration's figures against truth."""
    found = honesty(judged) if judged.align == PLAIN_FRAME else None
    return Score(
        judged.figures.get("position_rmse_m"),
        judged.figures.get("anees"),
        None if found is None else found.bounds,
        lost=judged.lost_share,
    )


def mean_density(drive: Drive, e: Estimates, flags: Mapping[str, np.ndarray]) -> float | None:
    """Return the mean log density of what only listened, sensor by sensor [nats per number]; None for nothing."""
    means = []
    for sensor in (s for s in e.audits if s in flags):
        m = drive.measurements[sensor]
        density = log_density(e.audits[sensor], m.z)
        rows = np.repeat(flags[sensor], np.diff(m.first)) & np.isfinite(density)
        if rows.any():
            means.append(float(density[rows].mean()))
    return float(np.mean(means)) if means else None
