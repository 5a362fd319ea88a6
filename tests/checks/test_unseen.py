"""What a drive cannot tell is named, with the manoeuvre that would; a drive that has them all is told nothing."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from locfuse.fusion.checks.unseen import unseen

PERIOD_S = 0.05


def drive(*parts: tuple[float, float, float], sensors: tuple[str, ...] = ("gyro",)) -> Any:
    """A drive of parts: seconds, speed [m/s], turning rate [rad/s]."""
    speed, rate = (np.concatenate([np.full(round(p[0] / PERIOD_S), p[i]) for p in parts]) for i in (1, 2))
    t = np.arange(len(speed) + 1) * PERIOD_S
    way, turned = (np.append(0.0, np.cumsum(v) * PERIOD_S) for v in (speed, rate))
    wheels = SimpleNamespace(
        t=t, heading=lambda at: np.interp(at, t, turned), driven=lambda at: np.interp(at, t, way)
    )
    return SimpleNamespace(wheels=wheels, measurements=dict.fromkeys(sensors))


STAND, AHEAD, LEFT, RIGHT, ARC = (
    (6.0, 0.0, 0.0),
    (8.0, 0.3, 0.0),
    (4.0, 0.0, 0.8),
    (4.0, 0.0, -0.8),
    (30.0, 0.3, 0.3),
)


@pytest.mark.parametrize(
    ("parts", "manoeuvres"),
    [
        ((STAND, AHEAD, LEFT, RIGHT), ()),
        ((AHEAD, LEFT, RIGHT), ("Stand for 5 s",)),
        ((STAND, AHEAD, LEFT), ("once each way",)),
        ((STAND, ARC, RIGHT), ("Drive 3 m straight",)),
        ((AHEAD,), ("once each way", "Stand for 5 s")),
    ],
)
def test_the_manoeuvre_that_is_missing_is_named(parts: Any, manoeuvres: tuple[str, ...]) -> None:
    found = unseen(drive(*parts))
    assert len(found) == len(manoeuvres)
    assert all(any(word in f.message for f in found) for word in manoeuvres)
    assert not any(f.fixes or f.severe for f in found)


def test_without_a_gyro_nobody_needs_to_stand() -> None:
    assert not unseen(drive(AHEAD, LEFT, RIGHT, sensors=("compass",)))


def test_a_drive_that_never_moves_a_metre_is_no_error() -> None:
    (first, second) = unseen(drive(STAND))
    assert "0° to the left" in first.message
    assert "no metre" in second.message
