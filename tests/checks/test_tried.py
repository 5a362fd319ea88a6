"""Which fixes are offered: held to scores written by hand, as if they were those of runs."""

from collections.abc import Callable, Collection, Mapping, Sequence

import pytest
from msgspec.structs import replace

from locfuse.fusion.checks.finding import Finding
from locfuse.fusion.checks.tried import (
    Advice,
    Candidate,
    Fixes,
    Marks,
    Scores,
    Try,
    improves,
    judged_pairs,
    tried,
    worsens,
    worsens_alone,
    worsens_smoothed,
)

LATE = Candidate(Finding("lrf", "lag", "late"), (("lrf.time_offset=-0.1",),), ("lrf", "all"))
BIASED = Candidate(Finding("compass", "offset", "biased"), (("compass.offset_deg=5",),), ("compass", "all"))
SIGMAS = (("camera.sigma_deg=1",), ("camera.sigma_deg=2",))
NOISY = Candidate(Finding("camera", "noise", "noisy"), SIGMAS, ("camera", "all"))


class Trials:
    """Position errors [m] by settings, and which settings were asked for."""

    def __init__(self, errors: Mapping[frozenset[str], float]) -> None:
        self.errors, self.asked = errors, list[Fixes]()

    def __call__(self, fixes: Fixes, names: Sequence[str]) -> Scores:
        self.asked.append(fixes)
        error = self.errors.get(frozenset(fixes))
        return {} if error is None else {name: Marks(error) for name in names}


class Case:
    """A log of which the same looks wrong whatever is set."""

    def __init__(self, candidates: Sequence[Candidate]) -> None:
        self.candidates = candidates

    def suspicious(self) -> bool:
        return True

    def classes(self) -> Sequence[Sequence[Callable[[], Sequence[Candidate]]]]:
        return [[lambda: self.candidates]]

    def kept(self, role: str) -> Collection[str]:
        return {"all"}


def found_in(candidates: Sequence[Candidate], trial: Try) -> list[Advice]:
    return tried(lambda _: Case(candidates), trial)[0]


def keys(*fixes: str) -> frozenset[str]:
    return frozenset(fixes)


LAG, OFFSET = "lrf.time_offset=-0.1", "compass.offset_deg=5"


def helpful(found: Sequence[Advice]) -> list[Fixes]:
    return [a.fixes for a in found if a.helps]


def test_what_helps_alone_and_not_beside_a_better_fix_is_no_longer_offered() -> None:
    trial = Trials({keys(): 0.1, keys(LAG): 0.01, keys(OFFSET): 0.05, keys(LAG, OFFSET): 0.02})
    assert helpful(found_in([BIASED, LATE], trial)) == [(LAG,)]


def test_fixes_that_combine_are_tried_together_the_most_valuable_first() -> None:
    trial = Trials({keys(): 0.1, keys(LAG): 0.05, keys(OFFSET): 0.08, keys(LAG, OFFSET): 0.01})
    found = found_in([BIASED, LATE], trial)
    assert helpful(found) == [(LAG,), (OFFSET,)]
    assert found[1].pairs["all"][0].position == 0.05  # on top of the first


def test_a_finding_that_no_fix_helps_against_is_kept_without_one_and_an_offer_is_not() -> None:
    trial = Trials({keys(): 0.1, keys(LAG): 0.1})
    assert [(a.finding.role, a.fixes) for a in found_in([LATE], trial)] == [("lrf", ())]
    offer = Candidate(LATE.finding, LATE.alternatives, LATE.judges, offer=True)
    assert found_in([offer], trial) == []


def test_of_several_alternatives_the_best_is_offered_and_one_that_cannot_be_applied_is_not() -> None:
    trial = Trials({keys(): 0.1, keys("camera.sigma_deg=2"): 0.05})
    assert helpful(found_in([NOISY], trial)) == [("camera.sigma_deg=2",)]


@pytest.mark.parametrize(("after", "harmless"), [(0.1, True), (0.15, False)])
def test_of_a_fix_that_does_not_help_it_is_known_whether_it_harms(after: float, harmless: bool) -> None:
    (found,) = found_in([LATE], Trials({keys(): 0.1, keys(LAG): after}))
    assert not found.helps
    assert found.harmless == harmless


def test_after_every_fix_the_log_is_looked_at_again() -> None:
    """The laser is late, or the wheels are early: once one is set, nothing is wrong with the other."""
    early = "wheels.time_offset=0.1"
    wheels = Candidate(Finding("wheels", "lag", "early"), ((early,),), ("all",))
    for first, error, other in ((LAG, 0.01, 0.05), (early, 0.05, 0.01)):
        trial = Trials({keys(): 0.1, keys(LAG): error, keys(early): other, keys(LAG, early): 0.002})
        seen: list[Fixes] = []

        def look(fixes: Fixes, seen: list[Fixes] = seen) -> Case:
            seen.append(fixes)
            return Case([] if fixes else [wheels, LATE])

        found, kept = tried(look, trial)
        assert kept == (LAG if error < other else early,) == helpful(found)[0] == (first,)
        assert seen == [(), kept]


BOUNDS = (0.5, 2.0)


@pytest.mark.parametrize(
    ("before", "after", "worse", "better"),
    [
        (Marks(0.100), Marks(0.089), False, True),
        (Marks(0.100), Marks(0.095), False, False),  # less than a tenth
        (Marks(0.100), Marks(0.103), True, False),
        (Marks(0.0010), Marks(0.00119), False, False),  # 0.2 mm are nothing
        (Marks(0.1, 40.0, BOUNDS), Marks(0.1, 1.0, BOUNDS), False, True),
        (Marks(0.1, 0.8, BOUNDS), Marks(0.1, 1.0, BOUNDS), False, False),  # chance, both
        (Marks(0.1, 1.0, BOUNDS), Marks(0.1, 3.0, BOUNDS), True, False),
        (Marks(0.1, 5.4, BOUNDS), Marks(0.12, 1.0, BOUNDS), True, True),  # no ANEES is worth a larger error
        (Marks(0.295, 220.0, BOUNDS), Marks(0.328, 176.0, BOUNDS), True, False),  # nor is a little of it a gain
        (Marks(0.3, 220.0, BOUNDS), Marks(0.303, 100.0, BOUNDS), False, True),
        (Marks(0.1, 1.0, BOUNDS), Marks(0.05, 3.0, BOUNDS), False, True),  # half the error
        (Marks(0.1, 1.0, BOUNDS), Marks(0.091, 3.0, BOUNDS), True, False),  # less than a tenth
        (Marks(0.26, heading=1.8), Marks(0.21, heading=2.9), True, True),  # a heading is no less than a place
        (Marks(0.26, heading=1.8), Marks(0.12, heading=2.9), False, True),  # less than half the error
        (Marks(0.69, heading=2.9), Marks(0.68, heading=1.9), False, True),
        (Marks(0.1), Marks(0.01, lost=0.2), True, True),  # lost is worse, whatever else
        (Marks(0.1), Marks(), True, False),
        (Marks(prediction=1.0), Marks(prediction=1.2), False, True),
        (Marks(prediction=1.0), Marks(prediction=0.9), True, False),
    ],
)
def test_what_counts_as_worse_and_as_better(before: Marks, after: Marks, worse: bool, better: bool) -> None:
    assert (worsens(before, after), improves(before, after)) == (worse, better)


RADIUS = Candidate(
    Finding("wheels", "wheel scale", "6 % long", severe=True),
    (("wheels.radius=0.05",),),
    ("camera", "odometry"),
    ("odometry",),
)
TRACK = Candidate(
    Finding("wheels", "track", "4 % off"),
    (("wheels.track=0.624",),),
    ("camera", "all", "odometry"),
    ("camera", "odometry"),
    ("camera",),
    offer=True,
)
RATIO = Candidate(
    Finding("wheels", "ratio", "one is larger", severe=True),
    (("wheels.ratio=0.9",),),
    ("odometry", "gyro"),
    ("odometry",),
)
SLIPS = Candidate(Finding("wheels", "noise", "slips"), (("wheels.noise=0.004",),), ("lrf",), guards=("odometry",))
MOUNT = replace(LATE, minor=("lrf",), measured=True)
Pair = tuple[Marks, Marks]  # before and after
STILL = Marks(0.0035), Marks(0.0035)


def error(before: float, after: float) -> Pair:
    return Marks(before), Marks(after)


def smaller(before: float, after: float) -> Pair:
    return Marks(0.1, before, BOUNDS), Marks(0.1, after, BOUNDS)


def turned(before: float, heading_before: float, after: float, heading_after: float) -> Pair:
    return Marks(before, heading=heading_before), Marks(after, heading=heading_after)


def nats(before: float, after: float) -> Pair:
    return Marks(prediction=before), Marks(prediction=after)


@pytest.mark.parametrize(
    ("candidate", "scores", "taken"),
    [
        # without truth: a mount that the drive shows by eight sigmas. Where others gain, a hundred bearings say
        # little against it; where nothing gains they were right: the laser's own error grew by a third
        (MOUNT, {"lrf": nats(3.24, 3.225), "all": nats(3.03, 3.03)}, True),
        (MOUNT, {"lrf": nats(3.24, 3.20), "all": nats(3.03, 3.03)}, False),
        (MOUNT, {"lrf": nats(3.24, 3.20), "all": nats(3.03, 3.09)}, True),
        (replace(MOUNT, minor=()), {"lrf": nats(3.24, 3.20), "all": nats(3.03, 3.09)}, False),
        (MOUNT, {"lrf": nats(3.24, 3.18), "all": nats(3.03, 3.09)}, False),
        # a run with the wheels' scales as states finds the same mount: the laser alone may lose what chance does
        (replace(MOUNT, proven=True), {"lrf": nats(3.24, 3.20), "all": nats(3.03, 3.03)}, True),
        (replace(MOUNT, proven=True), {"lrf": nats(3.24, 3.18), "all": nats(3.03, 3.03)}, False),
        # a measured value need not gain, but must not lose
        (replace(LATE, measured=True), {"lrf": nats(1.0, 1.01), "all": nats(1.0, 1.01)}, True),
        (LATE, {"lrf": nats(1.0, 1.01), "all": nats(1.0, 1.01)}, False),
        (replace(LATE, measured=True), {"lrf": nats(1.0, 0.99), "all": nats(1.0, 0.99)}, True),
        (replace(LATE, measured=True), {"lrf": nats(1.0, 0.97), "all": nats(1.0, 0.97)}, False),
        # nor need a clock that two others agree on
        (replace(LATE, measured=True, proven=True), {"lrf": error(0.3, 0.298), "all": error(0.3, 0.298)}, True),
        (replace(LATE, measured=True), {"lrf": error(0.3, 0.298), "all": error(0.3, 0.298)}, False),
        (replace(LATE, measured=True, proven=True), {"lrf": error(0.3, 0.31), "all": error(0.3, 0.31)}, False),
        (replace(LATE, measured=True, proven=True), {"lrf": error(0.3, 0.1), "all": error(0.1, 0.14)}, True),
        (replace(LATE, measured=True), {"lrf": error(0.3, 0.1), "all": error(0.1, 0.14)}, False),
        (replace(LATE, measured=True, proven=True), {"lrf": error(0.3, 0.1), "all": error(0.1, 0.21)}, False),
        # 14 -> 19 mm of the camera are chance, 34 mm say that the track fits the slips of this drive
        (TRACK, {"odometry": error(0.319, 0.166), "camera": error(0.014, 0.019), "all": STILL}, True),
        (TRACK, {"odometry": error(0.319, 0.166), "camera": error(0.014, 0.034), "all": STILL}, False),
        # odometry's two errors cancel on this drive: its covariance says that it is chance, or not
        (
            RADIUS,
            {
                "camera": (Marks(0.540, 27.0, BOUNDS), Marks(0.043, 0.95, BOUNDS)),
                "odometry": (Marks(0.277, 7.8, BOUNDS), Marks(0.391, 0.9, BOUNDS)),
            },
            True,
        ),
        (
            RADIUS,
            {
                "camera": (Marks(0.540, 27.0, BOUNDS), Marks(0.043, 0.95, BOUNDS)),
                "odometry": (Marks(0.277, 1.0, BOUNDS), Marks(0.391, 0.9, BOUNDS)),
            },
            False,
        ),
        # a compass 30 degrees off: 1.3 m -> 25 mm; of `all` the error shrinks below what was claimed anyway
        (
            BIASED,
            {
                "compass": (Marks(1.35, 380.0, BOUNDS), Marks(0.025, 0.7, BOUNDS)),
                "all": (Marks(0.00312, 0.48, BOUNDS), Marks(0.00296, 0.38, BOUNDS)),
            },
            True,
        ),
        # a sensor's own error that falls to less than half may cost the rest what chance does
        (LATE, {"lrf": error(0.1, 0.04), "all": error(0.005, 0.0055)}, True),
        (replace(LATE, offer=True), {"lrf": error(0.1, 0.04), "all": error(0.005, 0.0055)}, False),
        (LATE, {"lrf": error(0.1, 0.07), "all": error(0.005, 0.0055)}, False),
        # the turns of odometry are right again: a heading of the gyro that was better by chance may double
        (RATIO, {"odometry": turned(6.3, 68.0, 1.1, 11.0), "gyro": turned(0.42, 0.4, 0.43, 0.6)}, True),
        (RATIO, {"odometry": turned(6.3, 68.0, 1.1, 11.0), "gyro": turned(0.42, 0.4, 0.43, 1.0)}, False),
        (RATIO, {"odometry": turned(6.3, 68.0, 1.1, 66.0), "gyro": turned(0.42, 0.4, 0.43, 0.6)}, False),
        (RATIO, {"odometry": turned(6.3, 68.0, 4.1, 11.0), "gyro": turned(0.42, 0.4, 0.43, 0.6)}, False),
        # noise of the wheels: that of odometry is too large already, and may not become larger still
        (
            SLIPS,
            {"lrf": (Marks(0.1, 7.0, BOUNDS), Marks(0.1, 3.0, BOUNDS)), "odometry": smaller(0.26, 0.25)},
            True,
        ),
        (
            SLIPS,
            {"lrf": (Marks(0.1, 7.0, BOUNDS), Marks(0.1, 3.0, BOUNDS)), "odometry": smaller(0.26, 0.03)},
            False,
        ),
        # what nobody would keep may lose what chance does and no more
        (replace(BIASED, minor=("compass",)), {"all": error(0.006, 0.004), "compass": error(0.03, 0.033)}, True),
        (BIASED, {"all": error(0.006, 0.004), "compass": error(0.03, 0.033)}, False),
        (replace(BIASED, minor=("compass",)), {"all": error(0.006, 0.004), "compass": error(0.03, 0.039)}, False),
    ],
)
def test_a_fix_must_be_worth_what_it_costs(candidate: Candidate, scores: dict[str, Pair], taken: bool) -> None:
    def trial(fixes: Fixes, names: Sequence[str]) -> Scores:
        return {name: scores[name][bool(fixes)] for name in names}

    assert helpful(found_in([candidate], trial)) == ([candidate.alternatives[0]] if taken else [])


class Accusers:
    """Two sensors that contradict each other: either gains once it moves, and all sensors know who is right."""

    def __call__(self, fixes: Fixes, names: Sequence[str]) -> Scores:
        gains = {frozenset({LAG}): {"lrf": 1.0, "all": 1.0}, frozenset({OFFSET}): {"compass": 3.0, "all": 0.2}}
        gained = gains.get(frozenset(fixes), {})
        return {name: Marks(prediction=1.0 + gained.get(name, 0.0 if len(fixes) < 2 else -1.0)) for name in names}


def test_of_two_sensors_that_accuse_each_other_that_one_is_moved_that_all_the_others_gain_by() -> None:
    assert helpful(found_in([BIASED, LATE], Accusers())) == [(LAG,)]


def test_errors_within_what_is_claimed_may_move_by_chance() -> None:
    """A compass alone that was lucky, with ANEES in its range before and after; not one that claims too little."""
    claim = (0.5, 1.7)
    lucky, usual = Marks(0.033, anees=1.4, bounds=claim), Marks(0.038, anees=1.0, bounds=claim)
    assert not worsens_alone(lucky, usual)
    assert worsens_alone(lucky, usual._replace(position=0.045))
    assert worsens_alone(lucky._replace(anees=2.5), usual._replace(anees=2.5, position=0.039))
    path, other = Marks(0.0029, anees=0.5, bounds=claim), Marks(0.0052, anees=0.7, bounds=claim)
    assert not worsens_smoothed(path, other)
    assert worsens_smoothed(path, other._replace(anees=3.0))
    assert worsens_smoothed(path, other._replace(position=0.0063))
    sure = path._replace(anees=9.0)
    for position, worse in ((0.0032, False), (0.0036, True)):  # 10 and 24 %, under a fix that halved an error
        assert worsens_smoothed(sure, sure._replace(position=position), settled=True) == worse


@pytest.mark.parametrize(
    ("shape", "measured", "helps"),
    [(0.0049, True, True), (0.0049, False, False), (0.0040, False, True), (0.006, True, False)],
)
def test_a_fix_that_moves_a_free_map_is_judged_by_shape(shape: float, measured: bool, helps: bool) -> None:
    """The map's direction is drawn anew: the position gets worse by chance, whatever becomes of the shape."""

    def trial(fixes: Fixes, names: Sequence[str]) -> Scores:
        before, after = Marks(0.015, 1.0, BOUNDS, shape=0.005), Marks(0.02, 1.0, BOUNDS, shape=shape)
        return dict.fromkeys(names, after if fixes else before)

    candidate = Candidate(LATE.finding, LATE.alternatives, LATE.judges, measured=measured, by_shape=True)
    (found,) = found_in([candidate], trial)
    assert found.helps == helps
    assert not any(a.helps for a in found_in([replace(candidate, by_shape=False)], trial))
    if helps:
        before, after = found.pairs["lrf"]
        assert after == Marks(shape, shape=shape, aligned=True)
        assert before.position == 0.005


def test_where_the_position_itself_gains_the_shape_is_not_asked() -> None:
    def trial(fixes: Fixes, names: Sequence[str]) -> Scores:
        return {name: Marks(0.01 if fixes else 0.02, shape=0.004) for name in names}

    (found,) = found_in([replace(LATE, by_shape=True)], trial)
    assert found.helps
    befores = {name: before for name, (before, _) in found.pairs.items()}
    assert befores == dict.fromkeys(LATE.judges, Marks(0.02, shape=0.004))


@pytest.mark.parametrize(("third", "taken"), [("-0.18", True), ("-0.24", False)])
def test_a_value_that_keeps_moving_on_when_it_is_measured_again_is_no_fix(third: str, taken: bool) -> None:
    """A tenth of a second, then 0.07 s more under it; a third time as much: something else looks like a clock."""
    values = [f"lrf.time_offset={value}" for value in ("-0.1", "-0.17", third)]
    trial = Trials({keys(): 0.1, **{keys(v): 0.05 / 2**i for i, v in enumerate(values)}})

    def look(fixes: Fixes) -> Case:
        at = values.index(fixes[0]) + 1 if fixes else 0
        return Case([replace(LATE, alternatives=((values[min(at, 2)],),))])

    found, kept = tried(look, trial, lambda key: 0.0)
    assert kept == ((values[-1],) if taken else ())
    assert any("something else is wrong" in a.finding.message for a in found) != taken


@pytest.mark.parametrize("again", [LAG, "lrf.time_offset=-0.12"])
def test_a_fix_under_which_the_same_is_measured_off_again_says_that_more_is_wrong(again: str) -> None:
    trial = Trials({keys(): 0.1, keys(LAG): 0.05, keys("lrf.time_offset=-0.12"): 0.06})
    later = replace(LATE, alternatives=((again,),))
    (found, *_), kept = tried(lambda fixes: Case([later if fixes else LATE]), trial, lambda key: 0.0)
    assert kept == (LAG,)
    assert ("something else is wrong too" in found.finding.message) == (again != LAG)


@pytest.mark.parametrize("judges", [("odometry", "all"), ("all", "odometry")])
def test_odometry_lucky_under_a_wrong_start_hinders_no_fix_whoever_is_asked_first(judges: tuple[str, ...]) -> None:
    """Its error grows, and falls from 20 times what it claims to what it claims; that of all sensors is cured."""
    start = Candidate(Finding("truth", "start", "4 deg off"), (("start.theta_deg=4",),), judges, ("odometry",))
    before = {"odometry": Marks(0.257, 19.9, (0.9, 1.1)), "all": Marks(0.307, 3695.0, (0.1, 2.8))}
    after = {"odometry": Marks(0.458, 1.0, (0.3, 2.1)), "all": Marks(0.002, 0.65, (0.8, 1.2))}

    def trial(cured: Mapping[str, Marks]) -> Try:
        return lambda fixes, names: {n: (cured if fixes else before)[n] for n in names}

    fixes = start.alternatives[0]
    assert set(judged_pairs(start, (), fixes, trial(after))) == set(judges)
    not_cured = {**after, "all": Marks(0.29, 3600.0, (0.8, 1.2))}
    assert judged_pairs(start, (), fixes, trial(not_cured)) == {}


@pytest.mark.parametrize("drifting", [True, False])
def test_a_drift_that_cancels_a_wrong_start_hinders_no_fix_of_the_start(drifting: bool) -> None:
    """A start 1.3 deg off over 6 m is 0.14 m: odometry drifts as far the other way, the laser does not."""
    before = {"odometry": Marks(0.07, 180.0, BOUNDS, shape=0.03), "lrf": Marks(0.104, 900.0, BOUNDS, shape=0.005)}
    after = {"odometry": Marks(0.139, 0.29, BOUNDS, shape=0.03), "lrf": Marks(0.008, 0.95, BOUNDS, shape=0.005)}
    start = Candidate(Finding("truth", "start", "off"), (("start.theta_deg=-1.3",),), ("lrf", "odometry"))
    start = replace(start, drifting=("odometry",) if drifting else ())
    (found,) = found_in([start], lambda fixes, names: {n: (after if fixes else before)[n] for n in names})
    assert found.helps == drifting


@pytest.mark.parametrize("needed", [True, False])
def test_a_fix_of_noise_before_its_cause_was_known_is_kept_only_if_it_still_helps(needed: bool) -> None:
    noise = "lrf.sigma_range=0.1"
    finding = Finding("lrf", "understated", "noise is set too low")
    plaster = replace(LATE, finding=finding, alternatives=((noise,),))
    errors = {keys(): 0.1, keys(noise): 0.06, keys(LAG): 0.03 if needed else 0.01, keys(noise, LAG): 0.01}
    _, kept = tried(lambda fixes: Case([LATE if fixes else plaster]), Trials(errors), lambda key: None)
    assert set(kept) == ({noise, LAG} if needed else {LAG})
