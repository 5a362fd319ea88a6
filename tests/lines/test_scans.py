"""A range that means "nothing came back" is no wall, whatever range_max says."""

import math
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from laser_room import SCAN, ranges_of, scan_stream
from msgspec.structs import replace
from numpy.typing import NDArray
from ring_drive import box
from textbook import wrap

from locfuse.fusion import se2
from locfuse.fusion.checks.laser_ranges import scatter
from locfuse.fusion.data import Array, ArrayStream, Block, Measurements
from locfuse.fusion.ekf.belief_arrays import JointBelief
from locfuse.fusion.kernels.sight import Rules
from locfuse.fusion.lines import scans
from locfuse.fusion.lines.extract import Lines, LineSettings
from locfuse.fusion.lines.points import Longest, ScanPoints
from locfuse.fusion.lines.scans import LAG_SCANS, Laser, line_process_noise, lines_in_base, sweep_time, wall_floor
from locfuse.fusion.map.line_map import Association, LineMap, mount_states_of
from locfuse.fusion.map.scan import Scan
from locfuse.fusion.robot import WheelSettings
from locfuse.fusion.se2 import wrap_all
from locfuse.fusion.sensors.lrf import Lrf, LrfSettings, laser_of
from locfuse.fusion.streams import take
from locfuse.fusion.wheels.motion import Wheels
from locfuse.fusion.wheels.motion_by_scans import STANDING, match_scans

BEAMS, SCANS, WORD = 120, 60, 8.0  # m; range_max of the scans is 12 m
YARD = np.array(box(-4.0, -3.0, 4.5, 3.5)[:3] + box(1.0, 2.6, 2.2, 3.4))  # a room without its fourth wall
STAMPS = [200_000_000 * i for i in range(SCANS)]


def yard(word: float, step: float = 0.0) -> ArrayStream:
    """Scans along a circle in the yard, in steps of `step` m, with `word` where nothing comes back."""
    rng, rows = np.random.default_rng(5), []
    for i in range(SCANS):
        turn = 0.07 * i
        row = ranges_of(np.array([np.sin(turn), 1.0 - np.cos(turn), turn]), YARD, rng)
        row = np.round(row / step) * step if step else row
        rows.append(np.where(np.isinf(row), word, row))
    return scan_stream(STAMPS, np.stack(rows))


def lines_of(stream: ArrayStream, **settings: Any) -> Measurements:
    return Lrf().measure(stream, LrfSettings(**settings), STANDING, 0)


@pytest.mark.parametrize("step", [0.0, 0.05])
def test_a_word_for_no_return_gives_the_lines_that_nan_gives(step: float) -> None:
    said, right = lines_of(yard(WORD, step)), lines_of(yard(math.nan, step))
    np.testing.assert_array_equal(said.first, right.first)
    np.testing.assert_array_equal(said.z, right.z)
    assert [note for note in said.notes if note not in right.notes] == [said.notes[0]]
    assert "exactly 8 m, the longest: read as no return" in said.notes[0]
    kept = lines_of(yard(WORD, step), range_max=8.0)
    assert kept.first[-1] > right.first[-1] or len(kept.notes) > len(right.notes)  # walls that are none


def test_scans_are_matched_as_if_it_were_no_number() -> None:
    laser = laser_of(LrfSettings())
    said, right = (match_scans(yard(word), laser).reading(WheelSettings(), 0.0) for word in (WORD, math.inf))
    np.testing.assert_array_equal(said.wheels.pose, right.wheels.pose)


@pytest.mark.parametrize(("near", "far"), [(0.0, 0.0), (0.15, 0.0), (0.0, math.nan), (math.nan, 12.0), (2.0, 1.0)])
def test_limits_that_the_driver_does_not_fill_in_limit_nothing(near: float, far: float) -> None:
    right = yard(math.inf)
    n = len(right.t_ns)
    stream = replace(right, data={**right.data, "range_min": np.full(n, near), "range_max": np.full(n, far)})
    found, expected = lines_of(stream), lines_of(right)
    np.testing.assert_array_equal(found.z, expected.z)
    (note,) = set(found.notes) - set(expected.notes)
    assert f"range_max is {far:g} m and range_min {near:g} m in {n} of {n} scans" in note
    assert not any("not filled in" in note for note in lines_of(stream, range_max=12.0).notes)  # the user decided
    laser = laser_of(LrfSettings())
    said, known = (match_scans(s, laser).reading(WheelSettings(), 0.0) for s in (stream, right))
    np.testing.assert_array_equal(said.wheels.pose, known.wheels.pose)
    np.testing.assert_array_equal(scatter({**stream.data}), scatter({**right.data}))


def within(ranges: Array, far: float = 12.0) -> dict[str, Array]:
    """Return scans of `ranges` (k, b) [m] with a range_max [m]."""
    return {"ranges": ranges, "range_min": np.zeros(len(ranges)), "range_max": np.full(len(ranges), far)}


@pytest.mark.parametrize("step", [0.0, 0.01, 0.05])
@pytest.mark.parametrize("seed", range(4))
def test_the_longest_range_of_a_room_is_a_wall(step: float, seed: int) -> None:
    """Drives in closed rooms, ranges in whole centimetres too, by a robot that never moves as well."""
    rng = np.random.default_rng(seed)
    for moves in (0.0, 0.05):
        longest = Longest()
        for i in range(SCANS):
            angle = np.linspace(-np.pi, np.pi, BEAMS, endpoint=False) + moves * i
            with np.errstate(divide="ignore"):
                wall = np.minimum(4.0 / np.abs(np.cos(angle)), (3.0 + moves * i) / np.abs(np.sin(angle)))
            noisy = wall + 0.02 * rng.standard_normal(BEAMS)
            row = np.round(noisy / step) * step if step else noisy
            longest.add(within(row[None]))
        assert longest.no_return is None


def test_how_the_log_is_cut_into_blocks_does_not_matter() -> None:
    ranges: Array = np.asarray(yard(WORD).data["ranges"].values).reshape(SCANS, BEAMS)  # type: ignore[union-attr]
    whole, pieces, backwards = Longest(), Longest(), Longest()
    whole.add(within(ranges))
    for i in range(SCANS):
        pieces.add(within(ranges[i : i + 1]))
        backwards.add(within(ranges[-1 - i][None]))
    assert whole.no_return == pieces.no_return == backwards.no_return == WORD
    laser = laser_of(LrfSettings())
    assert whole.notes(laser) == pieces.notes(laser) == backwards.notes(laser)
    assert whole.count == int((ranges == WORD).sum())


def test_scans_without_a_beam_or_a_return_say_nothing() -> None:
    longest = Longest()
    longest.add(within(np.zeros((3, 0))))
    longest.add(within(np.full((3, 40), np.nan)))
    longest.add(within(np.full((3, 40), 13.0)))  # beyond range_max: known to be none
    assert longest.no_return is None


@pytest.mark.parametrize("body", [0.25, 1.5])
def test_beams_that_see_the_robot_itself_are_no_walls(body: float) -> None:
    """Farther away they may be a wall beside the robot, and if nothing changes the robot stands."""
    right, some = yard(math.inf), np.s_[10:40]
    ranges = np.array(right.data["ranges"].values).reshape(SCANS, BEAMS)  # type: ignore[union-attr]
    free, held = ranges.copy(), ranges.copy()
    free[:, some] = math.inf
    held[:, some] = body + 0.01 * np.random.default_rng(1).standard_normal((SCANS, 30))
    found, expected = (lines_of(scan_stream(STAMPS, r)) for r in (held, free))
    notes = [note for note in found.notes if "see the robot itself" in note]
    assert len(notes) == (body < 0.6)
    assert all(note.startswith("30 of 120 beams read 0.25 m in all scans") for note in notes)
    if notes:
        np.testing.assert_array_equal(found.z, expected.z)
        laser = laser_of(LrfSettings())
        by_held, by_free = (match_scans(scan_stream(STAMPS, r), laser) for r in (held, free))
        paths = [matched.reading(WheelSettings(), 0.0).wheels.pose for matched in (by_held, by_free)]
        np.testing.assert_array_equal(paths[0], paths[1])
    stands = Longest()
    stands.add(within(np.tile(held[:1], (SCANS, 1))))
    assert stands.blocked is None


# --- a laser that freezes: its driver sends one scan again and again


@pytest.mark.parametrize(("turns", "way"), [(True, True), (False, True), (True, False)])
def test_copies_of_a_scan_while_the_wheels_move_are_no_measurements(*, turns: bool, way: bool) -> None:
    """As if the copies were not there; a robot that stands sees exactly the same, and its odometry may drift."""
    right, n = yard(math.nan), 12
    ranges = np.array(right.data["ranges"].values).reshape(SCANS, BEAMS)  # type: ignore[union-attr]
    ranges[21 : 21 + n] = ranges[20]
    stream, left = scan_stream(STAMPS, ranges), np.r_[0:21, 21 + n : SCANS]
    twist = np.tile([0.07 * way, 0.0, 0.07 * turns], (SCANS - 1, 1))
    t = 1e-9 * np.array(STAMPS)
    driven = Wheels.from_twists(t, twist, 0.3, 1e-4)
    found = Lrf().measure(stream, LrfSettings(), driven, 0)
    fewer = replace(right, t_ns=right.t_ns[left], data={k: take(v, left) for k, v in right.data.items()})
    expected = Lrf().measure(fewer, LrfSettings(), driven, 0)
    assert found.dropped == {"repeat": n}
    for name in ("t", "first", "z", "R"):
        np.testing.assert_array_equal(getattr(found, name), getattr(expected, name))
    assert found.points is not None
    (seen,) = found.points.read(np.array([21]))
    np.testing.assert_array_equal(seen, expected.points.read(np.array([21]))[0])  # type: ignore[union-attr]
    drifts = Wheels.from_twists(t, 0.004 * twist, 0.3, 1e-4)  # 1.4 mm/s, 0.08 degrees/s
    stood = Lrf().measure(stream, LrfSettings(), drifts, 0)
    assert stood.dropped == {}
    assert len(stood.t) == SCANS


def test_scans_that_see_nothing_are_no_copies() -> None:
    stream = scan_stream(STAMPS, np.full((SCANS, BEAMS), math.inf))
    twist = np.tile([0.1, 0.0, 0.0], (SCANS - 1, 1))
    driven = Wheels.from_twists(1e-9 * np.array(STAMPS), twist, 0.3, 1e-4)
    assert Lrf().measure(stream, LrfSettings(), driven, 0).dropped == {}


# --- points of chosen scans: read from the log again, but not again for scans that lie beside the last ones

SEEN, PER_BLOCK, RAYS = 12, 4, 8
RANGES = np.repeat(1.0 + np.arange(SEEN)[:, None] / 2.0, RAYS, axis=1)  # m: another one in each scan


class Blocks:
    """A stream of scans, a few in each block; it counts the blocks that were read."""

    def __init__(self, whole: ArrayStream) -> None:
        self.whole, self.read = whole, 0

    def blocks(self, *fields: str, rows: int) -> Iterator[Block]:
        for at in np.split(np.arange(SEEN), range(PER_BLOCK, SEEN, PER_BLOCK)):
            self.read += 1
            yield at, {name: take(column, at) for name, column in self.whole.columns(*fields).items()}


def test_scans_beside_the_last_ones_are_not_read_again() -> None:
    stream = Blocks(scan_stream(range(SEEN), RANGES))
    how = np.zeros(SEEN), laser_of(LrfSettings()), STANDING, np.arange(SEEN)
    points = ScanPoints(stream, Lrf.reads[SCAN], *how)  # type: ignore[arg-type]  # only its blocks are read
    # readings, and how many blocks are read by then: beside the last ones, over the end of a block, before it
    for readings, read in (([9, 10], 3), ([10, 11], 3), ([8, 9], 3), ([7, 8], 5), ([1, 0], 6), ([2, 3], 6)):
        found = points.read(np.array(readings))
        for reading, seen in zip(readings, found, strict=True):
            assert len(seen) == RAYS
            np.testing.assert_allclose(np.hypot(*seen.T), RANGES[reading], rtol=1e-12)
        assert stream.read == read, readings
    assert points.take(np.array([3])).read(np.array([0]))[0].shape == (RAYS, 2)
    assert stream.read == 6
    # later ones: the reader goes on from where it stopped; earlier ones: from the beginning
    for reading, read in ((5, 7), (11, 8), (6, 10)):
        np.testing.assert_allclose(np.hypot(*points.read(np.array([reading]))[0].T), RANGES[reading], rtol=1e-12)
        assert stream.read == read, reading


# --- scans compared by the thousand against the same comparison one by one


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
        turned = [(s, wrap(psi - q), v) for s, q, v in after]
        options = [((w / 0.6) ** 2 + ((r - s) / 0.4) ** 2, w, variance + v) for s, w, v in turned]
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


def test_lines_that_are_equally_good_turn_by_their_median_and_none_do_not_turn() -> None:
    first, psi = np.array([0, 4, 8]), np.array([0.0, 1.0, 2.0, 3.0])
    z = np.column_stack((np.ones(8), np.concatenate((psi, psi - [0.1, 0.12, 0.15, 0.4]))))
    assert scans.turns(first, z, np.full(8, 1e-4))[1] == pytest.approx(0.135)
    none = np.zeros((0, 2))
    np.testing.assert_array_equal(scans.turns(np.zeros(4, np.int64), none, none[:, 0]), np.zeros(3))


# --- walls that are not planes are recognised from the lines alone, and flat ones are left alone

FIT = math.radians(0.2)


def corridor(bend: float, seed: int, scans: int = 600) -> tuple[float, float]:
    """Floors found from a corridor whose walls point off by `bend` [rad], anew wherever they are looked at."""
    rng = np.random.default_rng(seed)
    t = np.arange(scans, dtype=float)
    psi = np.tile([math.pi / 2, -math.pi / 2], scans) + rng.normal(0.0, math.hypot(FIT, bend), 2 * scans)
    z = np.stack((np.ones(2 * scans), wrap_all(psi)), axis=-1)
    wheels = Wheels.from_wheels(t, 0.1 * t, 0.1 * t, TRACK, 0.0)  # 0.1 m ahead from scan to scan
    return wall_floor(t, np.arange(scans + 1) * 2, z, np.full(2 * scans, FIT**2), wheels)


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("bend_deg", [0.3, 0.6])
def test_the_floor_is_what_walls_bend(bend_deg: float, seed: int) -> None:
    _, angle = corridor(math.radians(bend_deg), seed)
    assert math.degrees(angle) == pytest.approx(bend_deg, rel=0.2)


@pytest.mark.parametrize("seed", range(5))
def test_flat_walls_ask_for_no_floor_and_slips_are_not_taken_for_uneven_ones(seed: int) -> None:
    assert corridor(0.0, seed) == (0.0, 0.0)
    taken, known = walls_of_slipping_scans(math.radians(0.4), seed)
    assert math.degrees(taken) == pytest.approx(0.4, rel=0.2)
    assert known == 0.0


def test_too_few_walls_say_nothing() -> None:
    assert corridor(math.radians(1.0), 0, scans=100) == (0.0, 0.0)
    assert corridor(math.radians(1.0), 0, scans=5) == (0.0, 0.0)


def test_a_line_that_bends_changes_over_the_lag_as_the_walls_did() -> None:
    """Two readings of a wall with unevenness u differ by 2 u; a random walk must get there in LAG_SCANS steps."""
    uneven = np.array([1e-4, 7e-5])
    steps = np.random.default_rng(0).normal(size=(4000, LAG_SCANS, 2)) * np.sqrt(line_process_noise(uneven))
    assert steps.sum(axis=1).var(axis=0) == pytest.approx(2.0 * uneven, rel=0.1)


def test_a_line_that_is_seen_for_ever_stays_within_its_walls_unevenness() -> None:
    """Looked at again and again, a wall that is known well becomes as uncertain as it is uneven, and no more."""
    uneven = np.array([1e-4, 7e-5])
    belief = JointBelief((0.0, 0.0, 0.0), (1e-6, 0.0, 0.0, 1e-6, 0.0, 1e-6), [])
    walls = LineMap()
    for start in (1e-6, 4e-4):  # one well known, one worse than it is uneven
        column = belief.augment(np.zeros(2), np.zeros((2, 3)), start * np.eye(2))
        walls.append(np.array([2.0, 0.0]), np.zeros(2), np.zeros((2, 2)), column, (-1.0, 1.0), 0)
    z, R, ends = np.array([[2.0, 0.0]]), np.diag([1e-4, 1e-4])[None], np.array([[-1.0, 1.0]])
    for which in (0, 1):
        walls.lo[:], walls.hi[:] = 10.0, 11.0  # the other one lies elsewhere
        walls.lo[which], walls.hi[which] = -1.0, 1.0
        found = Association(Rules(math.inf, True, True, 0, 0, 0), mount_states_of(None, belief))
        found.compare(belief, walls, Scan.of(z, R, ends).rows)
        for _ in range(10 * LAG_SCANS):
            walls.raise_variances(belief, uneven, line_process_noise(uneven), np.array([which]))
    np.testing.assert_allclose(np.diagonal(belief.covariance)[3:], [*uneven, 4e-4, 4e-4], rtol=1e-9)


# --- noise of deskewing: what lines owe to wheels that slip within a sweep, against scans of a slipping robot

BEAMS_A_SWEEP, SWEEP, TRACK, NOISE = 360, 0.1, 0.3, 4e-4
MOUNT = np.array([0.2, -0.1, 0.7])
ANGLES = np.linspace(-math.pi, math.pi, BEAMS_A_SWEEP, endpoint=False)
WALLS = np.array([(2.0, 0.3), (1.5, 0.3 + math.pi / 2), (2.5, 0.3 + math.pi), (1.8, 0.3 - math.pi / 2)])  # r, psi


def seen_from(poses: Array) -> Array:
    """Ranges (..., b) of beams along ANGLES from laser poses (..., b, 3) in the room of WALLS."""
    heading = ANGLES + poses[..., 2]
    away = WALLS[:, 0] - poses[..., :1] * np.cos(WALLS[:, 1]) - poses[..., 1:2] * np.sin(WALLS[:, 1])
    towards = np.cos(heading[..., None] - WALLS[:, 1])
    ranges: Array = np.where(towards > 1e-6, away / np.maximum(towards, 1e-6), np.inf).min(axis=-1)
    return ranges


def driven(speed: float, turn: float) -> Wheels:
    """Wheels that roll steadily for two seconds."""
    t = np.linspace(0.0, 2.0, 201)
    left, right = (speed - 0.5 * TRACK * turn) * t, (speed + 0.5 * TRACK * turn) * t
    return Wheels.from_wheels(t, left, right, TRACK, NOISE)


def measured(wheels: Wheels, base: Array) -> Lines:
    """Lines in the base of scans whose beams were fired from base poses (n, b, 3) seen from the middle."""
    ranges = seen_from(se2.compose(base, MOUNT))
    n = len(ranges)
    scans = {
        "ranges": ranges,
        "angle_min": np.full(n, ANGLES[0]),
        "angle_increment": np.full(n, ANGLES[1] - ANGLES[0]),
        "range_min": np.zeros(n),
        "range_max": np.full(n, 100.0),
        "time_increment": np.full(n, SWEEP / (BEAMS_A_SWEEP - 1)),
    }
    laser = Laser(MOUNT, False, 1.0, 0.0, None, True, LineSettings(sigma_range=0.01))
    return lines_in_base(scans, np.full(n, 1.0 - 0.5 * SWEEP), laser, wheels)[0]


def slipped(wheels: Wheels, n: int, seed: int) -> Array:
    """Base poses (n, b, 3) seen from the middle of the sweep, of robots whose wheels slip as a random walk."""
    dt = SWEEP / (BEAMS_A_SWEEP - 1)
    rolled = wheels.rolled[1] / (wheels.t[1] - wheels.t[0]) * dt  # (2,) m a beam
    rng = np.random.default_rng(seed)
    steps = rolled + np.sqrt(NOISE * np.abs(rolled)) * rng.normal(size=(n, BEAMS_A_SWEEP - 1, 2))
    ahead, turn = steps.mean(axis=-1), (steps[..., 1] - steps[..., 0]) / TRACK
    poses = np.zeros((n, BEAMS_A_SWEEP, 3))
    for k in range(1, BEAMS_A_SWEEP):
        arc = np.stack((ahead[:, k - 1], np.zeros(n), turn[:, k - 1]), axis=-1)
        poses[:, k] = se2.compose(poses[:, k - 1], arc)
    middle = 0.5 * (poses[:, BEAMS_A_SWEEP // 2 - 1] + poses[:, BEAMS_A_SWEEP // 2])
    return se2.compose(se2.inverse(middle)[:, None], poses)


def in_order(lines: Lines, values: Array) -> Array:
    """`values` (m, ...) of scans that show every wall as one line, in the order of WALLS: (scans, walls, ...)."""
    whole = lines.first[:-1][np.diff(lines.first) == len(WALLS)]
    rows = whole[:, None] + np.arange(len(WALLS))
    turn = np.abs(wrap_all(lines.z[rows, 1][:, None, :] - WALLS[:, 1][:, None]))
    ordered: Array = values[np.take_along_axis(rows, turn.argmin(axis=2), axis=1)]
    return ordered


@pytest.mark.parametrize(("speed", "turn"), [(0.3, 0.0), (0.0, 1.2), (0.3, -0.6)])
def test_lines_err_together_as_their_loadings_say(speed: float, turn: float) -> None:
    wheels = driven(speed, turn)
    lines = measured(wheels, slipped(wheels, 1000, seed=1))
    z, G = in_order(lines, lines.z), in_order(lines, lines.sweep)[0].astype(float)
    assert len(z) > 400
    error = np.concatenate((z[..., 0] - WALLS[:, 0], wrap_all(z[..., 1] - WALLS[:, 1])), axis=1)
    G = np.concatenate((G[:, 0], G[:, 1]))  # r of every wall, then psi of every wall
    found, expected = np.cov(error.T), G @ G.T
    # a random walk in six pieces: a line that is seen within one of them errs by a little more
    ratio = np.sqrt(np.diagonal(found) / np.diagonal(expected))
    np.testing.assert_allclose(ratio, 1.0, atol=0.15)
    assert np.median(ratio) == pytest.approx(1.0, abs=0.1)
    np.testing.assert_allclose(correlation(found), correlation(expected), atol=0.4)
    assert np.abs(correlation(found) - correlation(expected)).mean() < 0.15


def correlation(covariance: Array) -> Array:
    sigma = np.sqrt(np.diagonal(covariance))
    ratio: Array = covariance / np.outer(sigma, sigma)
    return ratio


def test_a_robot_at_rest_deskews_without_noise() -> None:
    lines = measured(driven(0.0, 0.0), np.zeros((3, BEAMS_A_SWEEP, 3)))
    assert len(lines.z) == 12
    assert not lines.sweep.any()


def walls_of_slipping_scans(sweep: float, seed: int) -> tuple[float, float]:
    """The floor that two walls ask for whose angle slips by `sweep` [rad] in every scan; it is told, or not."""
    rng = np.random.default_rng(seed)
    n, fit = 600, math.radians(0.2)
    slip = np.stack((rng.normal(0.0, sweep, n), rng.normal(0.0, sweep, n)), axis=1)
    psi = np.tile([math.pi / 2, -math.pi / 2], (n, 1)) + slip + rng.normal(0.0, fit, (n, 2))
    z = np.stack((np.ones(2 * n), wrap_all(psi.ravel())), axis=-1)
    loadings = np.tile([(sweep, 0.0), (0.0, sweep)], (n, 1))
    seen = np.arange(float(n)) / n, np.arange(n + 1) * 2, z, np.full(2 * n, fit**2), driven(0.0, 0.0)
    return wall_floor(*seen)[1], wall_floor(*seen, loadings)[1]


def test_the_last_beam_of_a_backward_sweep_is_taken_first() -> None:
    """The robot turns on the spot at 1 rad/s in a scan of 0.3 s: a beam looks from where it is then."""
    t = np.arange(0.0, 4.0, 0.01)
    wheels = Wheels.from_wheels(t, -0.5 * TRACK * t, 0.5 * TRACK * t, TRACK, 0.0)
    bearing, at = np.linspace(-1.5, 1.5, 301), np.arange(301) * 0.001  # rad; s since the stamp, of beam after beam
    scan = {
        "angle_min": bearing[:1],
        "angle_increment": np.diff(bearing[:2]),
        "time_increment": np.array([0.001]),
        "range_min": np.zeros(1),
        "range_max": np.full(1, 9.0),
        "ranges": np.full((1, 301), 2.0),
    }
    for settings, order in ((LrfSettings(), np.s_[:]), (LrfSettings(sweep="backward"), np.s_[::-1])):
        (points,), middle = scans.points_in_base(scan, np.array([2.0]), laser_of(settings), wheels)
        np.testing.assert_allclose(middle, 2.15)
        np.testing.assert_allclose(np.arctan2(*points.T[::-1]), bearing[order] + at - 0.15, atol=1e-4)


def test_a_sweep_takes_at_most_a_second_and_no_time_where_its_increment_is_no_number() -> None:
    told = np.array([0.001, -1.0, 0.0, np.nan, np.inf, 5.0])
    np.testing.assert_allclose(sweep_time(told, 101, 10.0), [0.1, 0.0, 0.0, 0.0, 100.0 / 101.0, 100.0 / 101.0])
    assert sweep_time(np.array([-0.001]), 101, 0.1) == pytest.approx(0.1)


@pytest.mark.parametrize(("told", "sweep"), [(1e-3, 0.1), (1.0, 0.1), (1e3, 0.1), (0.02, 0.2), (0.2, 0.2)])
def test_an_increment_in_ms_or_us_and_the_time_of_a_whole_scan_are_understood(told: float, sweep: float) -> None:
    """Of scans with 100 beams that come every 0.2 s."""
    np.testing.assert_allclose(sweep_time(np.array([told]), 100, 0.2), 0.99 * sweep)
