"""The beginning of a comparison is the comparison of the beginning: held to runs of the shortened drive itself."""

from __future__ import annotations

import numpy as np
import pytest

from locfuse.cli.advice import trial as trials
from locfuse.cli.advice.beginning import Beginning
from locfuse.cli.advice.trial import Trial, score_of
from locfuse.cli.analysis.compare import compare_log
from locfuse.cli.analysis.configurations import for_comparison
from locfuse.cli.analysis.settings import Asked, silent
from locfuse.cli.session.session import load

LOG = "rounded_rectangle"


@pytest.mark.parametrize("truth", [True, False])
def test_a_watched_comparison_equals_one_of_the_beginning(truth: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(trials, "MAX_INSTANTS", 150)
    sets = () if truth else ("truth.topic=none",)
    loaded = load(LOG, sets=sets, between=(None, 12.0)).loaded
    chosen = for_comparison([], loaded.drive)
    trial = Trial(loaded, {c.name: c for c in chosen}, "none", silent)
    assert len(trial.loaded.drive.t) < len(loaded.drive.t)
    seen = Beginning(trial)
    compare_log(loaded, chosen, Asked(audits=False), silent, watch=[seen.take], heard=[seen.hear])
    found, again = seen.compared(), compare_log(trial.loaded, chosen, Asked(audits=False), silent)
    assert found is not None
    assert [score_of(e) for e in found.evaluations] == [score_of(e) for e in again.evaluations]
    for one, other in zip(found.runs, again.runs, strict=True):
        assert one.own == other.own
        n = len(one.estimates.pose)
        assert n >= len(other.estimates.pose) - 1
        assert np.array_equal(one.estimates.pose, other.estimates.pose[:n])
    assert found.scores == again.scores
    if not truth:
        fresh = Trial(trial.loaded, trial.configurations, "none", silent)
        names = [c.name for c in chosen]
        assert fresh((), names) == trial((), names)
        assert (fresh.fusions, trial.fusions) == (len(names), 0)
