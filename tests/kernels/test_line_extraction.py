"""Lines by the compiled kernels and by their source interpreted are the same, and no input makes either fail."""

from __future__ import annotations

import math
from typing import Any, cast

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from interpreted import interpreted
from msgspec.structs import replace
from rooms import ARENA, poses, scan

from locfuse.fusion.data import Array
from locfuse.fusion.lines import extract
from locfuse.fusion.lines.extract import LineSettings, Scans, motion_of

MOUNT = motion_of(np.array([0.2, -0.1, 0.4]))
NUMBERS = st.one_of(
    st.floats(0.05, 30.0),
    st.sampled_from([math.nan, math.inf, -math.inf, 0.0, -1.0, 1e-300, 1e5, 1e30, 2.0, 2.0, 2.0]),
)


def agree(scans: Scans, how: LineSettings | None = None, moving: bool = False) -> extract.Lines:
    """Return the lines, after the interpreted kernels gave the same."""
    asked = scans, how or LineSettings(), MOUNT if moving else None
    found = extract.lines_of(*asked)
    with pytest.MonkeyPatch.context() as patch:
        for name in ("segments", "line_fits"):
            patch.setattr(extract, name, interpreted(name))
        other = extract.lines_of(*asked)
    for name in extract.Lines.__struct_fields__:
        np.testing.assert_allclose(getattr(other, name), getattr(found, name), rtol=1e-9, atol=1e-9, err_msg=name)
    return found


def seen(angles: Array, n: int, seed: int = 0) -> Array:
    """Noisy scans of a room with plates in it (n, b), some beams lost."""
    rng = np.random.default_rng(seed)
    real = angles + rng.normal(0.0, math.radians(0.25), (n, len(angles)))
    d = np.array([scan(ARENA, p, a) for p, a in zip(poses(rng, n), real, strict=True)])
    d += rng.normal(0.0, 0.03, d.shape)
    d[rng.uniform(size=d.shape) < 0.05] = math.inf
    return d


@pytest.mark.parametrize("beams", [181, 361, 720])
@pytest.mark.parametrize("moving", [False, True])
def test_scans_of_a_room_have_the_same_lines_interpreted(beams: int, moving: bool) -> None:
    turn = 1.0 if beams == 720 else 0.5  # of the circle
    angles = np.linspace(-math.pi, math.pi, beams, endpoint=False) * turn
    d = seen(angles, 20)
    offsets = np.random.default_rng(1).normal(0.0, 0.01, (*d.shape, 3)) if moving else None
    lines = agree(Scans(d, angles, offsets, 0.0, math.inf), moving=moving)
    assert len(lines.z) > 60
    assert (np.abs(lines.sweep).sum() > 0.0) == moving


@settings(deadline=None, max_examples=150)
@given(st.data(), st.integers(0, 60), st.integers(0, 3), st.booleans(), st.booleans())
def test_no_scan_makes_either_fail_or_differ(
    data: st.DataObject, beams: int, n: int, ring: bool, moving: bool
) -> None:
    numbers = data.draw(st.lists(NUMBERS, min_size=n * beams, max_size=n * beams))
    step = data.draw(st.sampled_from([0.0, 1e-9, math.radians(0.5), 0.1]))
    angles: Array = np.arange(beams, dtype=np.float64) * (2.0 * math.pi / max(beams, 1) if ring else step)
    offsets = None
    if moving:
        few = st.sampled_from([0.0, 0.0, 0.01, -0.02, 1e30, math.nan])
        offsets = np.resize(data.draw(st.lists(few, min_size=7, max_size=7)), (n, beams, 3))
    with np.errstate(all="ignore"):
        agree(
            Scans(np.array(numbers, np.float64).reshape(n, beams), angles, offsets, 0.0, math.inf), moving=moving
        )


@settings(deadline=None, max_examples=80)
@given(
    st.integers(0, 10_000),
    st.sampled_from(
        ["sigma_angle", "min_points", "min_length", "max_gap", "gap_spacings", "bridge", "split_floor"]
    ),
    st.sampled_from([0.0, 1e-6, 1.0, 1e6]),
)
def test_no_setting_makes_either_fail_or_differ(seed: int, name: str, value: float) -> None:
    angles = np.linspace(-math.pi, math.pi, 90, endpoint=False)
    d: Array = np.round(seen(angles, 1, seed), 1)  # to 10 cm: many points lie alike
    how = replace(LineSettings(flatness=0.0), **{name: cast("Any", value)})
    agree(Scans(d, angles, None, 0.0, math.inf), how)


@pytest.mark.parametrize("shape", [(0, 361), (3, 0), (3, 1), (3, 2), (0, 0)])
def test_nothing_to_see_is_no_line(shape: tuple[int, int]) -> None:
    lines = agree(Scans(np.full(shape, 2.0), np.linspace(-1.0, 1.0, shape[1]), np.zeros((*shape, 3)), 0.0, 9.0))
    assert len(lines.z) == 0
