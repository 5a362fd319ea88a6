"""Scans compared by the thousand against the same comparison one by one."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray
from textbook import wrap

from locfuse.fusion.lines import scans

Array = NDArray[np.float64]


def lines(rng: np.random.Generator, n: int) -> tuple[NDArray[np.int64], Array]:
    """n scans of none to six lines that hardly change from scan to scan."""
    walls = rng.uniform([0.5, -math.pi], [4.0, math.pi], (6, 2))
    seen = [walls[rng.permutation(6)[: rng.integers(0, 7)]] for _ in range(n)]
    first = np.concatenate(([0], np.cumsum([len(s) for s in seen])))
    z = np.vstack(seen)
    return first, z + rng.normal(0.0, 0.02, z.shape)


def one_turn(before: Array, after: Array) -> float:
    """The weighted median turn of lines (k, 3) = (r, psi, variance) to their nearest, by loops."""
    found = []
    for r, psi, variance in before:
        options = [
            (((wrap(psi - q)) / 0.6) ** 2 + ((r - s) / 0.4) ** 2, wrap(psi - q), variance + v) for s, q, v in after
        ]
        if options and min(options)[0] < 1.0:
            found.append(min(options)[1:])
    if not found:
        return 0.0
    turned, variance = np.array(sorted(found)).T
    passed = np.cumsum(1.0 / variance)
    return float(np.interp(0.5 * passed[-1], passed - 0.5 / variance, turned))


@pytest.mark.parametrize("cells", [1 << 18, 200])
def test_turns_of_all_scans_equal_those_found_one_by_one(cells: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(scans, "CELLS_AT_ONCE", cells)
    rng = np.random.default_rng(3)
    first, z = lines(rng, 80)
    variance = rng.uniform(1e-6, 1e-4, len(z))
    rows = np.column_stack((z, variance))
    pairs = zip(first[:-2], first[1:-1], first[2:], strict=True)
    expected = [one_turn(rows[a:b], rows[b:c]) for a, b, c in pairs]
    np.testing.assert_allclose(scans.turns(first, z, variance), [0.0, *expected], atol=1e-12)


def test_lines_that_are_equally_good_turn_by_their_median() -> None:
    first, psi = np.array([0, 4, 8]), np.array([0.0, 1.0, 2.0, 3.0])
    z = np.column_stack((np.ones(8), np.concatenate((psi, psi - [0.1, 0.12, 0.15, 0.4]))))
    assert scans.turns(first, z, np.full(8, 1e-4))[1] == pytest.approx(0.135)


def test_scans_without_lines_have_no_turns() -> None:
    none = np.zeros((0, 2))
    np.testing.assert_array_equal(scans.turns(np.zeros(4, np.int64), none, none[:, 0]), np.zeros(3))
