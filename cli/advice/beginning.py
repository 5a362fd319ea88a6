"""The beginning of a comparison: what its runs were on the part of the drive that advice tries.

A filter's run is causal: its first minutes are the run of the first minutes. So a comparison that is being made
anyway need not be made again on a shorter drive; it is watched, and its runs are cut.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import cast

import numpy as np
from msgspec.structs import replace

from locfuse.cli.analysis.compare import Compared
from locfuse.cli.analysis.trust import evidence
from locfuse.fusion.data import Audit, Drive, Estimates, Evaluation
from locfuse.fusion.judge.consistency import Run
from locfuse.fusion.judge.evaluate import Align, evaluate, shape_error
from locfuse.fusion.judge.predictive import Score, scores_of

from .trial import Trial, predicted, score_of


@dataclass
class Beginning:
    """Watches a comparison of a log; afterwards `compared` is that of the log's beginning, which is tried."""

    trial: Trial
    _judged: dict[str, tuple[Estimates, Evaluation, list[Run]]] = field(default_factory=dict)
    _scores: list[Score] = field(default_factory=list)
    _odometry: Estimates | None = None

    def take(self, e: Estimates, judged: Evaluation) -> None:
        """Take a run while it has its audits."""
        if e.smoothed or e.rates or e.name not in self.trial.configurations:
            return
        tried = self.trial.loaded
        if tried is not self.trial.whole:
            if self.trial.whole.drive.truth is not None:
                self.trial.of_whole(e.name, score_of(judged, shape_error(e, self.trial.whole.drive)))
            found = head(e, self.trial.whole.drive, tried.drive)
            if found is None:
                return
            e, judged = found, evaluate(found, tried.drive, cast("Align", self.trial.align))
        self._judged[e.name] = replace(e, audits={}), judged, evidence(tried.drive, e, tried.robot)

    def hear(self, e: Estimates) -> None:
        """Take a run that others listened to while it has its audits; odometry's comes first."""
        tried = self.trial.loaded
        if tried is not self.trial.whole and e.name in self.trial.configurations:
            self.trial.of_whole(e.name, predicted(self.trial.whole.drive, e))
        found = e if tried is self.trial.whole else head(e, self.trial.whole.drive, tried.drive)
        if found is None:
            return
        self._odometry = self._odometry or found
        self._scores += scores_of(tried.drive, found, self._odometry)
        self.trial.heard((), tried, found)

    def compared(self) -> Compared | None:
        """Return the comparison of the log's beginning; None where not all that it needs was run."""
        configurations = self.trial.configurations
        if not set(configurations) <= set(self._judged):
            return None
        chosen = [self._judged[name] for name in configurations]
        return Compared(
            loaded=self.trial.loaded,
            configurations=list(configurations.values()),
            estimates=[e for e, _, _ in chosen],
            evaluations=[judged for _, judged, _ in chosen],
            runs=[run for _, _, runs in chosen for run in runs],
            credit=None,
            scores=self._scores,
        )


def head(e: Estimates, whole: Drive, drive: Drive) -> Estimates | None:
    """Return the part of a run of the whole drive that lies on its beginning; None where the two do not fit.

    The beginning may end at one update time more, its last wheel reading, which no sensor and no truth shares.
    What is a sum of the whole run (joint NIS, maps, notes) is left out: nothing here reads it.
    """
    until = float(drive.t[-1])
    n = int(np.searchsorted(e.t, until, side="right"))
    if not np.array_equal(e.t[:n], drive.t[:n]):
        return None
    rows = None if whole.truth is None else (whole.truth.t >= drive.t[0]) & (whole.truth.t <= until)
    return replace(
        e,
        t=e.t[:n],
        pose=e.pose[:n],
        triangles=e.triangles[:n],
        audits={s: _audit(a, len(drive.measurements[s].z)) for s, a in e.audits.items()},
        blocks={name: x[:n] for name, x in e.blocks.items()},
        block_sigmas={name: x[:n] for name, x in e.block_sigmas.items()},
        final_map=(),
        points=(),
        truth_pose=None if e.truth_pose is None else e.truth_pose[rows],
        truth_P=None if e.truth_P is None else e.truth_P[rows],
        notes=(),
        lost=tuple((a, min(b, until)) for a, b in e.lost if a < until),
        loops=e.loops[e.loops[:, 1] <= until],
        loop_poses=e.loop_poses[e.loops[:, 1] <= until],
    )


def _audit(audit: Audit, rows: int) -> Audit:
    """Return what an audit says of the first rows of its sensor's numbers."""
    kept = audit.row < rows
    columns = ("instant", "row", "verdict", "landmark", "nis", "threshold", "y", "sigma")
    return replace(audit, joint=audit.joint[:0], **{name: getattr(audit, name)[kept] for name in columns})
