"""The filter's equations in the core: both forms agree to the last bit, whatever stands in the numbers."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from locfuse.fusion.core import filter as interpreted
from locfuse.fusion.core import places
from locfuse.fusion.core.form import form
from locfuse.fusion.core.room import Room
from locfuse.fusion.data import Array, LocfuseError
from locfuse.fusion.ekf.belief_arrays import JointBelief
from locfuse.fusion.lines.extract import rows_in_base
from locfuse.fusion.sensor import Innovation

SOURCE = Room.of(interpreted, None)
UPPER = (0.04, 0.01, 0.002, 0.09, -0.003, 0.01)
NUMBERS = st.one_of(
    st.floats(-1e3, 1e3), st.sampled_from([math.nan, math.inf, -math.inf, 0.0, 1e-300, 1e160, -1e160])
)


def random_belief(states: int, seed: int, room: Room | None = None) -> JointBelief:
    """A pose and states that hang together with it."""
    rng = np.random.default_rng(seed)
    belief = JointBelief((0.3, -0.2, 3.0), UPPER, (), room)
    for _ in range(states):
        belief.augment(rng.normal(size=1), rng.normal(size=(1, 3)), np.array([[rng.uniform(0.01, 0.1)]]))
    return belief


def lines(count: int, states: int, seed: int) -> list[Innovation]:
    """Innovations of two numbers each, by the pose and two states."""
    rng, out = np.random.default_rng(seed), []
    for _ in range(count):
        columns = tuple((3 + rng.choice(states, 2, replace=False)).tolist()) if states > 1 else ()
        H, own, L = rng.normal(size=(2, 3)), rng.normal(size=(2, 2)), np.tril(rng.normal(size=(2, 2)))
        R, y = 0.01 * (L @ L.T + np.eye(2)), tuple(rng.normal(size=2) * 0.1)
        tuples = [tuple(map(tuple, M.tolist())) for M in (H, R, own)]
        out.append(
            Innovation(0, 0, -1, 0.0, 1.0, y, y, tuples[0], tuples[1], columns, tuples[2] if columns else ())
        )
    return out


@pytest.mark.parametrize("states", [0, 1, 5, 30])
@pytest.mark.parametrize("count", [1, 2, 3, 7])
@pytest.mark.parametrize("considered", [(), (0, 3)])
def test_a_correction_is_the_same_in_both_forms_and_that_of_the_textbook(
    states: int, count: int, considered: tuple[int, ...]
) -> None:
    source, belief = random_belief(states, 1, SOURCE), random_belief(states, 1)
    kept = [c for c in considered if c < belief.n]
    seen = lines(count, states, count)
    x, P = belief.state.copy(), belief.covariance.copy()
    for one in (source, belief):
        one.consider(np.array(kept, np.int64))
        one.correct(seen)
    np.testing.assert_array_equal(source.state, belief.state)
    np.testing.assert_array_equal(source.covariance, belief.covariance)
    np.testing.assert_array_equal(belief.covariance, belief.covariance.T)
    H, R = np.zeros((2 * count, belief.n)), np.zeros((2 * count, 2 * count))
    for k, s in enumerate(seen):
        at = slice(2 * k, 2 * k + 2)
        H[at, :3], R[at, at] = s.H, s.R
        H[at, list(s.columns)] = np.array(s.H_block).reshape(2, -1)
    y = np.concatenate([s.y for s in seen])
    S = H @ P @ H.T + R
    K = P @ H.T @ np.linalg.inv(S)
    K[kept] = 0.0  # Schmidt's gain
    J = np.eye(belief.n) - K @ H
    np.testing.assert_allclose(belief.state, x + K @ y, atol=1e-9)
    np.testing.assert_allclose(belief.covariance, J @ P @ J.T + K @ R @ K.T, atol=1e-9)
    if not kept:
        for m in (1, 2 * count):  # the first alone, and all
            expected = float(y[:m] @ np.linalg.solve(S[:m, :m], y[:m]))
            nis, dof = belief.nis_of_first(m)
            assert nis == pytest.approx(expected, rel=1e-9)
            assert dof == m


@settings(deadline=None, max_examples=150)
@given(st.data(), st.integers(0, 6), st.integers(1, 5), st.booleans())
def test_no_numbers_make_either_form_fail_or_differ(data: st.DataObject, states: int, m: int, some: bool) -> None:
    """NaN, Inf, what overflows and what is singular: the same bytes, and the same answer whether S is positive."""
    n, unit = 3 + states, form().functions
    given_numbers = np.array(data.draw(st.lists(NUMBERS, min_size=80, max_size=80)))

    def run(room: Room) -> list[Any]:
        def numbers(*shape: int) -> Array:
            return np.resize(given_numbers, math.prod(shape)).reshape(shape)

        x, P, H, R, y = numbers(n), numbers(n, n), numbers(m, n), numbers(m, m), numbers(m)
        V, kept = np.zeros((-(-m // 4) * 4, n)), np.arange(n, dtype=np.intp) % 2
        at, core = np.arange(n, dtype=np.intp), room.on_arrays
        core.move(x, P, n, *numbers(3).tolist(), *numbers(6).tolist(), np.zeros((1, 1)), 0, 0, 0)
        args = (at, n, H, R, y, m, V, kept, some)
        greatest = core.take_in(x, P, n, *args)
        core.swing(P, n, n - 3, 0.1, -0.2)
        where = np.empty((2, 9))
        core.locate(x, P, n - 3, where[0])
        core.locate(x, P, -1, where[1])
        return [np.float64(greatest).tobytes(), *(a.tobytes() for a in (x, P, y, V, where))]

    found = run(SOURCE)
    if unit is not None:
        compiled = run(Room.of(interpreted, unit))
        for a, b in zip(found, compiled, strict=True):
            np.testing.assert_array_equal(np.frombuffer(a), np.frombuffer(b))  # a NaN's sign is nobody's


def test_a_correction_of_a_hundred_walls_is_that_of_numpy() -> None:
    belief, seen = random_belief(200, 3), lines(12, 200, 4)
    P = belief.covariance.copy()
    belief.correct(seen)
    H = np.zeros((24, 203))
    for k, s in enumerate(seen):
        H[2 * k : 2 * k + 2, :3], H[2 * k : 2 * k + 2, list(s.columns)] = s.H, s.H_block
    R = np.zeros((24, 24))
    for k, s in enumerate(seen):
        R[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] = s.R
    expected = P - P @ H.T @ np.linalg.solve(H @ P @ H.T + R, H @ P)
    np.testing.assert_allclose(belief.covariance, expected, atol=1e-9)


def test_a_number_that_is_none_is_refused_in_one_line() -> None:
    seen = lines(1, 0, 1)[0]
    bad = Innovation(0, 0, -1, 0.0, 1.0, seen.y, seen.y, seen.H, ((math.nan, 0.0), (0.0, 1.0)))
    with pytest.raises(LocfuseError, match="too many powers of ten"):
        random_belief(0, 1).correct([bad])


@settings(deadline=None, max_examples=100)
@given(st.lists(NUMBERS, min_size=7, max_size=42), st.tuples(NUMBERS, NUMBERS, NUMBERS))
def test_lines_are_put_elsewhere_alike_in_both_forms(numbers: list[float], to: tuple[float, float, float]) -> None:
    rows = np.array(numbers[: len(numbers) // 7 * 7]).reshape(-1, 7)
    found = rows_in_base(rows, *to, Room.of(places, None))
    if form().functions is not None:
        np.testing.assert_array_equal(found, rows_in_base(rows, *to, Room.of(places, form().functions)))
