"""Scans of a robot at rest: which lines repeat one another, against all pairs at once in NumPy."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from core_tables import table

from locfuse.fusion.core import rests
from locfuse.fusion.data import Array, Ints
from locfuse.fusion.linemap.scan import Scan
from locfuse.fusion.linemap.standing import SAME_D2, SAME_LENGTH, Standing
from locfuse.fusion.se2 import wrap_all

LIKE = np.diag([1e-4, 4e-4])


def lines(rng: np.random.Generator, n: int) -> Scan:
    """Lines close to one another, of which some are alike."""
    z = np.column_stack((rng.uniform(1.0, 1.3, n), rng.choice([3.1, -3.1, 0.4], n) + rng.normal(0.0, 0.1, n)))
    middle, half = rng.normal(0.0, 0.5, n), rng.uniform(0.2, 1.5, n)
    root = rng.normal(0.0, 0.03, (n, 2, 2))
    return Scan(z, root @ root.transpose(0, 2, 1) + LIKE, np.column_stack((middle - half, middle + half)))


def apart(a: Array, b: Array) -> Array:
    """Return a - b (..., 2), the angle wrapped."""
    off = a - b
    return np.stack((off[..., 0], wrap_all(off[..., 1])), axis=-1)


def same_by_all_pairs(scan: Scan, first: Scan) -> Ints:
    off = apart(scan.z[:, None], first.z)
    d2 = np.einsum("ijk,ikl,ijl->ij", off, np.linalg.inv(2.0 * scan.R), off)
    own, there = scan.ends[:, None], first.ends
    common = np.minimum(own[..., 1], there[:, 1]) - np.maximum(own[..., 0], there[:, 0])
    longer = np.maximum(own[..., 1] - own[..., 0], there[:, 1] - there[:, 0])
    d2 = np.where(common > SAME_LENGTH * longer, d2, np.inf)
    k, best = np.arange(len(d2)), d2.argmin(axis=1)
    mutual = d2.argmin(axis=0)[best] == k
    return np.asarray(np.where((d2[k, best] < SAME_D2) & mutual, best, -1))


@pytest.mark.parametrize("seed", range(40))
def test_a_line_repeats_the_one_that_is_nearest_where_each_is_the_others(seed: int) -> None:
    rng = np.random.default_rng(seed)
    first = lines(rng, 6)
    noise = rng.normal(size=(6, 2)) * 0.02
    scan = Scan(first.z + noise, first.R, first.ends) if seed % 2 else lines(rng, 5)
    standing = Standing()
    standing.take(first)
    standing.take(first)
    np.testing.assert_array_equal(standing._same(scan), same_by_all_pairs(scan, first))


def test_the_sums_are_by_how_much_lines_are_off_and_the_angle_is_wrapped() -> None:
    rows = Scan(np.array([[2.02, 0.12], [1.01, -3.1]]), np.tile(LIKE, (2, 1, 1)), np.ones((2, 2))).rows()
    known = np.array([[1.0, 3.1, -1.0, 1.0], [2.0, 0.1, -1.0, 1.0]])
    rest: Any = table(lines=known, sums=np.zeros((2, 2)), counts=np.zeros(2, np.intp), scans=2)
    for _ in range(3):
        rests.add_repeated(rows, 0, 2, rest, [1, 0])
    assert rest.scans == 5
    np.testing.assert_allclose(rest.sums, [[0.03, 3.0 * (2.0 * np.pi - 6.2)], [0.06, 0.06]], atol=1e-9)
    assert rest.counts.tolist() == [3, 3]


@pytest.mark.parametrize(
    ("scans", "counts"), [(1, True), (2, True), (3, False), (4, True), (6, False), (64, True)]
)
def test_of_scans_at_rest_the_first_second_fourth_and_eighth_count(scans: int, counts: bool) -> None:
    assert rests.counts(scans) == counts


@pytest.mark.parametrize("before", range(10))
def test_a_scan_that_only_repeats_is_taken_unless_it_is_the_first_second_fourth_or_eighth(before: int) -> None:
    z = np.array([[5.0, 1.0], [2.02, 0.12], [1.01, -3.1], [7.0, 1.0]])  # of one line, of two that repeat, of one
    scans: Any = table(
        first=[0, 1, 3, 4], rows=Scan(z, np.tile(LIKE, (4, 1, 1)), np.tile([-1.0, 1.0], (4, 1))).rows(),
        verdict=[9] * 4, landmark=[9] * 4,
    )  # fmt: skip
    known = np.array([[1.0, 3.1, -1.0, 1.0], [2.0, 0.1, -1.0, 1.0]])
    rest: Any = table(
        lines=known, sums=np.zeros((2, 2)), counts=np.zeros(2, np.intp), scans=before, known=2, near=SAME_D2,
        share=SAME_LENGTH, best=[7, 7], least=[0.0, 0.0], same=[0, 0], repeated=6, taken=0,
    )  # fmt: skip
    taken = before >= 2 and before + 1 not in {1, 2, 4, 8}  # of fewer there are no sums yet
    assert rests.only_repeats(scans, 1, rest) == taken
    assert (rest.scans, rest.taken) == ((before + 1, 1) if taken else (before, 0))
    assert scans.verdict == ([9, 6, 6, 9] if taken else [9] * 4)
    assert scans.landmark == ([9, -1, -1, 9] if taken else [9] * 4)
    assert rest.counts.tolist() == [int(taken)] * 2
    off = [[0.01, 2.0 * np.pi - 6.2], [0.02, 0.02]]
    np.testing.assert_allclose(rest.sums, off if taken else np.zeros((2, 2)), atol=1e-9)


@pytest.mark.parametrize("strange", [0, 1])
def test_a_scan_with_one_line_that_repeats_none_is_left_alone(strange: int) -> None:
    z = np.array([[2.02, 0.12], [1.01, -3.1]])
    z[strange, 0] += 3.0
    scans: Any = table(
        first=[0, 2], rows=Scan(z, np.tile(LIKE, (2, 1, 1)), np.tile([-1.0, 1.0], (2, 1))).rows(),
        verdict=[9, 9], landmark=[9, 9],
    )  # fmt: skip
    known = np.array([[1.0, 3.1, -1.0, 1.0], [2.0, 0.1, -1.0, 1.0]])
    rest: Any = table(
        lines=known, sums=np.zeros((2, 2)), counts=[0, 0], scans=5, known=2,
        near=SAME_D2, share=SAME_LENGTH, best=[7, 7], least=[0.0, 0.0], same=[0, 0], repeated=6, taken=0,
    )  # fmt: skip
    assert not rests.only_repeats(scans, 0, rest)
    assert (rest.scans, rest.taken, rest.counts, scans.verdict, scans.landmark) == (5, 0, [0, 0], [9, 9], [9, 9])
