"""What happened when: rest, refusals in a row, being lost, labelled faults."""

from __future__ import annotations

import numpy as np
import pytest
from msgspec.structs import replace
from small_drive import drive as small_drive
from small_drive import robot as small_robot

from locfuse import sample_logs
from locfuse.cli.analysis.load import load
from locfuse.cli.analysis.settings import LogOptions
from locfuse.fusion.data import (
    FAULT,
    JUMP,
    LOOP,
    LOOP_TAKEN,
    LOST,
    REFUSED,
    REST,
    SLIP,
    VERDICTS,
    Audit,
    Drive,
    Estimates,
    Jump,
    Measurements,
    Motions,
    stretches,
)
from locfuse.fusion.fuse import fuse
from locfuse.fusion.judge.events import events_of_drive, events_of_run


def resting(drive: Drive, first: int, last: int) -> Drive:
    """The drive with wheels that stand in the intervals first..last."""
    u = drive.motions.u.copy()
    u[first : last + 1] = 0.0
    return replace(drive, motions=replace(drive.motions, u=u))


def test_a_rest_is_as_long_as_the_wheels_stand() -> None:
    drive = small_drive(1, small_robot(), laps=0.5)
    first = 40
    last = first + int(np.searchsorted(drive.t[first:] - drive.t[first - 1], 3.0))
    (event,) = events_of_drive(resting(drive, first, last))
    assert event.kind == REST
    assert (event.start, event.end) == (drive.t[first - 1], drive.t[last])


@pytest.mark.parametrize(("refused", "told"), [(4, 0), (5, 1), (9, 1)])
def test_readings_refused_in_a_row_are_told(refused: int, told: int) -> None:
    robot = small_robot()
    drive = small_drive(1, robot, laps=0.5)
    run = fuse(drive, robot, ["compass"])
    audit = run.audits["compass"]
    verdict = np.full_like(audit.verdict, VERDICTS.index("accepted"))
    verdict[10 : 10 + refused] = VERDICTS.index("gate")
    changed = replace(run, audits={"compass": replace(audit, verdict=verdict)})
    events = [e for e in events_of_run(drive, changed) if e.kind == REFUSED]
    assert len(events) == told
    for event in events:
        times = drive.t[drive.instant["compass"]]
        assert (event.start, event.end) == (times[10], times[9 + refused])
        assert f"{refused} readings in a row" in event.words


def laid(steps: list[tuple[float, float, float]], period: float = 0.5) -> Drive:
    """A drive of these steps of the wheels (forward, left [m], turn [rad]), one every half second."""
    u = np.array(steps)
    n = len(u)
    return Drive(
        0, np.linspace(0.0, period * (n - 1), n), Motions(u, np.zeros((n, 3, 3)), np.zeros((n, 3, 0))), {}, {}, {}
    )


MOVED, STOOD = (0.1, 0.0, 0.0), (0.0, 0.0, 0.0)


def test_stretches_are_runs_of_true_values() -> None:
    assert stretches(np.array([], bool)) == []
    assert stretches(np.array([True, True, False, True, False, False, True])) == [(0, 1), (3, 3), (6, 6)]


def test_a_reading_counts_as_taken_by_any_of_its_lines_and_an_empty_scan_does_not_count() -> None:
    """Scans of two lines: of the third one is taken; then one that saw nothing amid five that were refused."""
    first = np.array([0, 2, 4, 6, 8, 10, 10, 12, 14, 16])
    m = Measurements(np.arange(9.0), first, np.zeros((16, 2)), np.ones((16, 2, 2)), 1.0, np.zeros((2, 2)))
    for taken, told in (("accepted", 1), ("new", 1), ("repeated", 1), ("unmatched", 0)):
        verdict = np.full(16, VERDICTS.index("gate"), np.int8)
        verdict[[5, 15]] = VERDICTS.index(taken)
        nothing = np.zeros((16, 2))
        audit = Audit(
            first[:-1].repeat(np.diff(first)),
            np.arange(16),
            verdict,
            np.full(16, -1),
            nothing[:, 0],
            nothing[:, 0],
            nothing,
            nothing,
        )
        drive = laid([MOVED] * 9)
        drive = replace(drive, measurements={"lrf": m}, instant={"lrf": np.arange(9)})
        run = Estimates("lrf", ("lrf",), drive.t, np.zeros((9, 3)), np.zeros((9, 6)), {"lrf": audit})
        found = [(e.start, e.end) for e in events_of_run(drive, run)]
        if told:
            assert found == []  # two before, and four behind it
        else:
            assert found == [(0.0, 4.0)]


def test_being_lost_is_told_with_its_times() -> None:
    robot = small_robot()
    drive = small_drive(1, robot, laps=0.1)
    run = replace(fuse(drive, robot, []), lost=((1.0, 2.5),))
    (event,) = events_of_run(drive, run)
    assert (event.start, event.end, event.kind, event.configuration) == (1.0, 2.5, LOST, "odometry")


def test_jumps_of_the_pose_are_told_with_what_they_did() -> None:
    drive = small_drive(1, small_robot(), laps=0.1)
    jumps = (Jump(1.5, SLIP, (0.0, 0.0, np.radians(-8.0))), Jump(2.0, LOOP_TAKEN, (0.3, 0.4, 0.0)))
    first, second = events_of_run(drive, replace(fuse(drive, small_robot(), []), jumps=jumps))
    assert (first.start, first.end, first.kind) == (1.5, 1.5, JUMP)
    assert first.words == "wheel slip undone: moved 0.00 m, turned -8.0°"
    assert second.words == "loop closed: moved 0.50 m, turned +0.0°"


def test_loops_that_follow_close_upon_each_other_are_told_as_one() -> None:
    drive = small_drive(1, small_robot(), laps=0.5)
    loops = np.array([(1.0, 40.0), (3.5, 42.0), (2.0, 60.0)])
    run = replace(fuse(drive, small_robot(), []), loops=loops)
    first, second = events_of_run(drive, run)
    assert (first.start, first.end, first.kind) == (40.0, 42.0, LOOP)
    assert first.words == "places of 1 to 4 s recognised"
    assert (second.start, second.end, second.words) == (60.0, 60.0, "the place of 2 s recognised")


def test_the_faults_that_a_log_labels_are_events_with_their_times() -> None:
    loaded = load([sample_logs.path("disturbed")], LogOptions(None, (), None, strict=False, quiet=True))
    kinds = {event.words.split(" ")[0]: event for event in loaded.labels}
    assert all(event.kind == FAULT for event in loaded.labels)
    assert {"people", "magnetic", "slip", "hidden_landmark", "red_object"} <= set(kinds)
    assert kinds["magnetic"].end - kinds["magnetic"].start == pytest.approx(13.0, abs=2.0)
