"""Clocks that look wrong by truth, other sensors, the laser's run and the wheels; the offsets to try."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cached_property

from msgspec.structs import replace

from locfuse.fusion.checks.clocks import (
    CLOCK,
    MIN_LAG_S,
    SEVERE_LAG_S,
    Clock,
    clock_words,
    differences,
    offset_of,
    wrong_clocks,
)
from locfuse.fusion.checks.finding import Finding
from locfuse.fusion.checks.lag import SAID_SIGMAS
from locfuse.fusion.checks.tried import Candidate, Fixes

from .judged import FINE, LASER, Judged

TRIED_SIGMAS = 2.5  # standard deviations: reason enough to fuse again
MIN_AGAIN_S = 0.005  # s: from which size on a clock that was set is set again
MIN_SPREAD_S = 0.003  # s: of a lag that is known better, and of one that explains less, no other value is tried
CAMERA_LAGS_S = (-0.2, -0.1, 0.1, 0.2)  # s


class Clocks(Judged):
    """Findings on clocks of a compared log."""

    @cached_property
    def wrong(self) -> list[tuple[Clock, ...]]:
        """Return which clocks look wrong, the best explanation first."""
        found = differences(self.loaded.drive, self.loaded.robot, self.compared.estimates)
        again = any(".time_offset=" in fix for fix in self.fixes)
        return wrong_clocks(found, TRIED_SIGMAS, MIN_AGAIN_S if again else MIN_LAG_S)

    def clocks(self) -> list[Candidate]:
        """Return the clocks that look wrong: before they are fixed, other findings are not reliable."""
        found: dict[str, Candidate] = {}
        by_truth = self.loaded.drive.truth is not None
        for clock in (clock for clocks in self.wrong for clock in clocks):
            if clock.name in found or not self.judges(clock.name):
                continue  # a sensor that no run can use as it is has no judge
            sure = abs(clock.offset) > SAID_SIGMAS * clock.sigma
            finding = Finding(clock.name, CLOCK, clock_words(clock), (), sure and abs(clock.offset) > SEVERE_LAG_S)
            steps = (0.0, -1.0, 1.0) if clock.sigma > MIN_SPREAD_S and clock in self.wrong[0] else (0.0,)
            ways: tuple[Fixes, ...] = tuple((offset_of(clock, self.loaded.robot, 3, n),) for n in steps)
            one = self._candidate(finding, ways, not finding.severe)
            found[clock.name] = replace(one, measured=sure or by_truth, by_shape=by_truth and clock.name == LASER)
        return [*found.values(), *self._late_pictures()]

    def _late_pictures(self) -> Iterator[Candidate]:
        """Yield time offsets to try for an inconsistent camera, and a constant bearing error, which looks similar.

        Bearings know no turning, so that these are guesses: not while measuring shows what is wrong.
        """
        verdict = self.consistency.get("camera")
        if any(f.role == "camera" and f.severe and f.fixes for f in self.doctor) or verdict is None:
            return
        if verdict.verdict in {*FINE, "overstated"} or not self.judges("camera"):
            return
        now = float(self.loaded.robot.settings("camera").time_offset)
        ways = tuple((f"camera.time_offset={now + step:z.3f}",) for step in CAMERA_LAGS_S)
        yield self._candidate(Finding("camera", CLOCK, f"{verdict.words}; its clock explains that"), ways, True)
        if constant := self.constant(verdict):
            yield self._candidate(Finding("camera", verdict.verdict, verdict.words), constant, True)
