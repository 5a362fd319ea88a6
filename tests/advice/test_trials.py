"""A fix is judged by smoothed paths as well; and what is tried beside it is tried on the log under it."""

from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from present import present

from locfuse.cli.advice import evaluator
from locfuse.cli.advice.evaluator import on_the_whole_drive, smoothed_worse, standard
from locfuse.cli.advice.evidence import Evidence
from locfuse.cli.advice.trial import Trial
from locfuse.cli.analysis.robot_tables import make_robot
from locfuse.cli.analysis.settings import silent
from locfuse.cli.session.session import load
from locfuse.fusion.checks.clocks import Clock
from locfuse.fusion.checks.finding import Finding
from locfuse.fusion.checks.tracked_point import CREEP
from locfuse.fusion.checks.tried import Advice, Candidate, Fixes, Marks
from locfuse.fusion.checks.turning import TRACK

CLOCK, NOISE = "wheels.time_offset=0.147", "wheels.noise=0.0012"
EARLY = Advice(Finding("wheels", "lag", "stamps look early", severe=True), (CLOCK,))
SLIPS = Advice(Finding("wheels", "noise", "they slip more"), (NOISE,))


def trial(smoothed: dict[Fixes, float], agreement: dict[Fixes, float] | None = None) -> Any:
    """Each fix makes the error while driving smaller; `smoothed` are those of the smoothed path [m].

    `agreement` is that of places seen twice, which is asked of logs without a truth.
    """
    causal = {(): 1.38, (CLOCK,): 0.60, (NOISE,): 1.2, (CLOCK, NOISE): 0.52}
    configurations = {"odometry": SimpleNamespace(sensors=()), "lrf": SimpleNamespace(sensors=("lrf",))}

    def score(errors: dict[Fixes, float], fixes: Fixes, names: Sequence[str]) -> dict[str, Marks]:
        return {name: Marks(errors[fixes]) for name in names}

    return SimpleNamespace(
        whole=1,
        loaded=1,
        configurations=configurations,
        on_whole=lambda fixes, names: score(causal, fixes, names),
        smoothed=lambda fixes, names: score(smoothed, fixes, [n for n in names if n == "lrf" and smoothed]),
        agreement=lambda fixes: agreement and agreement[fixes],
    )


@pytest.mark.parametrize(
    ("errors", "left"),
    [
        ((0.16, 0.59, 0.15, 0.56), [(NOISE,), ()]),  # with the clock, with the noise, with both
        ((0.16, 0.15, 0.59, 0.56), [(CLOCK,), ()]),
        ((0.16, 0.15, 0.15, 0.14), [(CLOCK,), (NOISE,)]),
    ],
)
def test_a_fix_that_makes_the_smoothed_path_worse_is_none(errors: tuple[float, ...], left: list[Fixes]) -> None:
    smoothed = dict(zip(((), (CLOCK,), (NOISE,), (CLOCK, NOISE)), errors, strict=True))
    found, kept = on_the_whole_drive([EARLY, SLIPS], trial(smoothed), afterwards=True)
    assert [a.fixes for a in found] == left
    assert kept == tuple(fix for fixes in left for fix in fixes)
    words = [a.finding.brief for a in found if not a.helps]
    assert all("makes the smoothed path worse (16" in text or "(150 -> 560 mm)" in text for text in words)


@pytest.mark.parametrize(("after", "taken"), [(0.46, False), (0.58, True), (0.7, True)])
def test_a_fix_under_which_places_seen_twice_fit_worse_is_none(after: float, taken: bool) -> None:
    (found,), kept = on_the_whole_drive([EARLY], trial({}, {(): 0.66, (CLOCK,): after}), afterwards=True)
    assert kept == ((CLOCK,) if taken else ())
    assert ("lets places seen twice fit worse (66% -> 46%)" in found.finding.brief) is not taken


def test_a_fix_of_the_shape_is_judged_by_the_shape_of_the_smoothed_path() -> None:
    """Where nobody observes the start, the direction of the map is chance."""
    same = Marks(0.1, aligned=True)
    by_shape = Advice(EARLY.finding, (CLOCK,), {"lrf": (same, same)})
    scores = {(): Marks(0.1, shape=0.05), (CLOCK,): Marks(0.2, shape=0.04)}
    one = SimpleNamespace(smoothed=lambda fixes, names: dict.fromkeys(names, scores[fixes]))
    assert smoothed_worse([by_shape], (), (CLOCK,), ["lrf"], one) is None  # type: ignore[arg-type]
    assert smoothed_worse([EARLY], (), (CLOCK,), ["lrf"], one) == (0.1, 0.2)  # type: ignore[arg-type]


def test_a_trial_beside_a_fix_that_is_kept_gives_what_it_gives_by_itself() -> None:
    """Nothing of the log as configured is left in it, though it is measured from there on."""
    loaded = load("rounded_rectangle").loaded
    several = {c.name: c for c in standard(loaded) if c.name in {"odometry", "compass"}}
    kept, more = ("compass.time_offset=0.05", "wheels.track=0.61"), ("truth.x=0.02", "wheels.track=0.58")
    one, other = (Trial(loaded, several, "none", silent) for _ in range(2))
    one.keep(kept)
    both = (*kept[:1], *more)
    assert one(both, [*several]) == other(both, [*several])
    assert one(kept, [*several]) != one(both, [*several])


def test_the_noise_and_the_point_of_the_truth_are_judged_by_the_run_that_is_known() -> None:
    """They move no estimate: nothing is fused again, and the figures are those of a new run."""
    session = load("rounded_rectangle")
    several = {c.name: c for c in standard(session.loaded) if c.name in {"odometry", "compass"}}
    one, other = (Trial(session.loaded, several, "none", silent) for _ in range(2))
    known = session.compare([*several], advice=False, smooth=False, audits=False).compared
    one.seed((), known)
    sets = ("truth.x=0.02", "truth.sigma=0.01")
    assert one(sets, [*several]) == other(sets, [*several])
    assert (one.fusions, other.fusions) == (0, 2)


def test_a_log_is_not_fused_again_under_settings_that_move_no_estimate() -> None:
    """Of a look, of a trial and of a probe: the runs are the same, whatever the truth's noise is."""
    several = {c.name: c for c in standard(load("rounded_rectangle").loaded) if c.name in {"odometry", "compass"}}
    one, other = (Trial(load("rounded_rectangle").loaded, several, "none", silent) for _ in range(2))
    moving, noise = ("compass.offset_deg=3", "wheels.noise=0.001"), ("truth.sigma=0.02",)
    assert one(moving, [*several])["compass"] != one(moving[:1], [*several])["compass"]
    assert one.fusions == 4
    assert one((*reversed(moving), *noise), [*several]) == other((*moving, *noise), [*several])
    assert set(one.complete((*moving, *noise))) == {"odometry", "compass"}
    again, new = (present(t.run((*noise, *moving), "compass")) for t in (one, other))
    assert np.array_equal(again.pose, new.pose)
    assert len(again.audits["compass"].nis) > 0
    assert (one.fusions, other.fusions) == (4, 2)


def test_only_the_newest_runs_are_stored(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("locfuse.cli.advice.trial.MAX_STORED_RUNS", 2)
    loaded = load("rounded_rectangle").loaded
    one = Trial(loaded, {c.name: c for c in standard(loaded) if c.name == "odometry"}, "none", silent)
    fixes: list[tuple[str, ...]] = [(f"wheels.noise={noise}",) for noise in (0.001, 0.002, 0.003)]
    for some in fixes:
        one(some, ["odometry"])
    assert [one.stored("trying", some, "odometry") is None for some in fixes] == [True, False, False]


# --- two faults that hide each other: a fix that helps only beside another one. Scores are written by hand


@pytest.mark.parametrize(
    ("last", "left"),
    [
        ("0.000", [("lrf", ("lrf.range_scale=0.95",))]),
        ("-0.050", [("camera", ("camera.time_offset=-0.050",)), ("lrf", ("lrf.range_scale=0.95",))]),
    ],
)
def test_a_clock_that_is_moved_and_moved_back_is_no_advice(last: str, left: list[tuple[str, Fixes]]) -> None:
    """It only looked wrong beside a laser whose ranges were."""
    moved = Advice(Finding("camera", "lag", "late"), (f"camera.time_offset={last}",))
    scaled = Advice(Finding("lrf", "range scale", "too long"), ("lrf.range_scale=0.95",))
    open_one = Advice(Finding("compass", "outliers", "a third does not fit"))
    kept = (f"camera.time_offset={last}", "lrf.range_scale=0.95")
    found = evaluator.without_repeated([moved, scaled, open_one], kept, make_robot({}))
    assert [(a.finding.role, a.fixes) for a in found] == [*left, ("compass", ())]
    far = make_robot({"camera": {"time_offset": 1.7e9}})  # another clock: its rest is small beside it
    late = Advice(moved.finding, ("camera.time_offset=1699999999.9",))
    assert evaluator.without_repeated([late], late.fixes, far) == [late]


@pytest.mark.parametrize("creeps", [False, True])
def test_errors_by_wheels_that_creep_sideways_show_no_noise(creeps: bool) -> None:
    """What residuals show, or slips, is still tried."""
    by_errors, by_residuals, by_slips = (
        Candidate(Finding(role, "noise", ""), ((fix,),), ("all",), offer=offer, measured=measured)
        for role, fix, offer, measured in (
            ("compass", "compass.sigma_deg=3.7", True, False),
            ("lrf", "lrf.sigma_range=0.02", False, False),
            ("wheels", "wheels.noise=3e-05", True, True),
        )
    )
    case: Any = SimpleNamespace(doctor=[Finding("wheels", CREEP, "")] if creeps else [])
    found = Evidence.unspoilt(case, lambda: [by_errors, by_residuals, by_slips])
    assert found == [*([] if creeps else [by_errors]), by_residuals, by_slips]


@pytest.mark.parametrize(
    ("offset_s", "truth", "tried"),
    [(0.013, False, False), (0.013, True, True), (-0.013, False, True), (0.032, False, True)],
)
def test_stamps_that_look_early_near_chance_are_tried_with_truth_only(
    offset_s: float, truth: bool, tried: bool
) -> None:
    """The sigma of the lag is 5 ms: without truth four times as much is needed."""
    clock = Clock("lrf", offset_s, 0.005, ("wheels", "compass"))
    case: Any = SimpleNamespace(
        loaded=SimpleNamespace(drive=SimpleNamespace(truth=truth or None), robot=make_robot({})),
        wrong=[(clock,)],
        judges=lambda _: ("all",),
        _bumped=False,
        _with_start=lambda fixes: fixes,
        _candidate=lambda finding, ways, offer: Candidate(finding, ways, ("all",), offer=offer),
    )
    found = [c.alternatives[0] for c in Evidence._late(case, case.wrong)]
    assert found == [(f"lrf.time_offset={offset_s:.3f}",)] * tried


@pytest.mark.parametrize(
    ("role", "code", "severe", "measured"),
    [("wheels", TRACK, False, False), ("wheels", TRACK, True, True), ("lrf", "yaw", False, True)],
)
def test_what_wheels_or_walls_show_beyond_slip_need_not_improve_a_prediction(
    role: str, code: str, severe: bool, measured: bool
) -> None:
    """Beside a laser and a gyro, odometry that turns 6 % too far changes no prediction.

    Nor does a laser's yaw that is 5 degrees off: its run estimates the mount.
    """
    finding = Finding(role, code, "", (f"{role}.turn_scale=0.94",), severe)
    one = SimpleNamespace(
        _with_camera_offset=lambda finding: (),
        _candidate=lambda finding, ways, offer: Candidate(finding, ways, ()),
    )
    assert Evidence._seen(cast("Any", one), finding).measured == measured
