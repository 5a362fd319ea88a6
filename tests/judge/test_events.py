"""What happened when: rest, refusals in a row, being lost, labelled faults."""

from __future__ import annotations

import numpy as np
import pytest
from msgspec.structs import replace
from small_drive import drive as small_drive
from small_drive import robot as small_robot

from locfuse import sample_logs
from locfuse.cli.pipeline.load import load
from locfuse.cli.pipeline.settings import LogOptions
from locfuse.fusion.data import FAULT, LOOP, LOST, REFUSED, REST, VERDICTS, Drive
from locfuse.fusion.fuse import fuse
from locfuse.fusion.judge.events import MIN_REFUSED, events_of_drive, events_of_run


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


def test_a_short_stop_is_no_event() -> None:
    drive = small_drive(1, small_robot(), laps=0.5)
    assert events_of_drive(resting(drive, 40, 45)) == []


@pytest.mark.parametrize(("refused", "told"), [(MIN_REFUSED - 1, 0), (MIN_REFUSED, 1)])
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


def test_being_lost_is_told_with_its_times() -> None:
    robot = small_robot()
    drive = small_drive(1, robot, laps=0.1)
    run = replace(fuse(drive, robot, []), lost=((1.0, 2.5),))
    (event,) = events_of_run(drive, run)
    assert (event.start, event.end, event.kind, event.configuration) == (1.0, 2.5, LOST, "odometry")


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
