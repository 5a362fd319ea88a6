"""A drive fused in stretches, instant by instant and by the interpreted core: ways that must agree."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from locfuse.fusion.core.room import Room
from locfuse.fusion.data import Audit, Drive, Estimates
from locfuse.fusion.fuse import Filter, fuse
from locfuse.fusion.instants import due_readings, steps_of
from locfuse.fusion.robot import Robot


def instant_by_instant(drive: Drive, robot: Robot, sensors: Sequence[str]) -> Estimates:
    run = Filter(robot, sensors)
    for k, (step, due) in enumerate(zip(steps_of(drive), due_readings(drive, sensors), strict=True)):
        run.advance(k, step, due, drive.measurements)
    return run.estimates(drive, "the loop")


def by_row(audit: Audit) -> Audit:
    """Return the record in the order of rows: of the candidates of a picture the loop notes the best first."""
    order = np.lexsort((audit.row, audit.instant))
    columns = {name: getattr(audit, name)[order] for name in Audit.__struct_fields__ if name != "joint"}
    return Audit(**columns, joint=audit.joint)


def assert_same(a: Estimates, b: Estimates) -> None:
    np.testing.assert_allclose(a.pose, b.pose, atol=1e-11)
    np.testing.assert_allclose(a.triangles, b.triangles, rtol=1e-9, atol=1e-15)
    for name in a.blocks:
        np.testing.assert_allclose(a.blocks[name], b.blocks[name], atol=1e-11)
        np.testing.assert_allclose(a.block_sigmas[name], b.block_sigmas[name], rtol=1e-9)
    assert [(line.id, line.hits) for line in a.final_map] == [(line.id, line.hits) for line in b.final_map]
    for line, same in zip(a.final_map, b.final_map, strict=True):
        np.testing.assert_allclose(
            (line.rho, line.beta, *line.ends), (same.rho, same.beta, *same.ends), atol=1e-10
        )
        np.testing.assert_allclose(line.P, same.P, rtol=1e-7, atol=1e-15)
    assert (a.notes, a.lost) == (b.notes, b.lost)
    for name in a.audits:
        audit, other = by_row(a.audits[name]), by_row(b.audits[name])
        np.testing.assert_allclose(audit.joint, other.joint, rtol=1e-7)
        for column in ("instant", "row", "verdict", "landmark"):
            np.testing.assert_array_equal(getattr(audit, column), getattr(other, column), column)
        for column in ("nis", "threshold", "y", "sigma"):
            numbers, others = getattr(audit, column), getattr(other, column)
            np.testing.assert_allclose(numbers, others.reshape(numbers.shape), rtol=1e-7, atol=1e-12)


def advanced(drive: Drive, robot: Robot, sensors: Sequence[str]) -> list[int]:
    """Return the instants that the loop took, one by one."""
    run, taken = Filter(robot, sensors), list[int]()
    on, k = run.stretches(drive), 0
    each = list(zip(steps_of(drive), due_readings(drive, sensors), strict=True))
    while k < len(each):
        last = run.coast(on, k)
        if last == k:
            run.advance(k, *each[k], drive.measurements, predicted=on.left(k))
            taken.append(k)
        k = max(last, k + 1)
    return taken


def assert_same_bits(compiled: Estimates, interpreted: Estimates) -> None:
    """All arrays are the same to the bit, but for the bits of what is no number."""
    for a, b in ((compiled.pose, interpreted.pose), (compiled.triangles, interpreted.triangles)):
        assert bits(a) == bits(b)
    for name, audit in compiled.audits.items():
        for column in ("verdict", "landmark", "nis", "threshold", "y", "sigma", "joint"):
            assert bits(getattr(audit, column)) == bits(getattr(interpreted.audits[name], column)), (name, column)


def bits(values: NDArray[Any]) -> bytes:
    return np.where(np.isnan(values), np.nan, values).tobytes()


def assert_all_ways_agree(drive: Drive, robot: Robot, sensors: Sequence[str]) -> Estimates:
    """The core in stretches, the loop, and the core interpreted, whose arrays are the same to the bit."""
    run = fuse(drive, robot, sensors)
    assert_same(run, instant_by_instant(drive, robot, sensors))
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr("locfuse.fusion.core.room._here", lambda source: Room.of(source, None))
        assert_same_bits(run, fuse(drive, robot, sensors))
    return run
