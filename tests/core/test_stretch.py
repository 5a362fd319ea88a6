"""The steps of a stretch of a drive, each against a textbook filter in matrices."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from core_tables import FRAME, GATE, REFUSED, N, believed, table
from textbook import TextbookEkf

from locfuse.fusion.core import coast as core
from locfuse.fusion.core.scans import MATCHED, NOTHING
from locfuse.fusion.data import Array
from locfuse.fusion.sensor import untold

OFFSET = 3  # the column of the compass' offset
UNUSED = 5.0


def headings(z: list[float], r: float, at: tuple[int, ...], when: tuple[int, ...] = ()) -> Any:
    n = len(z)
    return table(
        z=z, r=[r] * n, usable=[True] * n, gate=GATE, refused=REFUSED, unused=UNUSED, offset=0.1, at=at,
        states=len(at), told=untold(n, 1), when=when, readings=n,
        due=0,
        taken=-1,
    )  # fmt: skip


def readings(h: Any) -> Any:
    """A drive's single readings: headings, nothing else."""
    none = table(readings=0, due=0, when=())
    others = ("bearings", "echoes", "fixes", "turns", "sightings", "poses", "twists")
    return table(headings=h, **dict.fromkeys(others, none), whole=True)


def desk(rows: int, columns: int) -> Any:
    """Room for so many rows, left full of another scan's numbers."""
    m = max(rows, 1)
    return table(
        H=np.full((m, columns), 7.0), R=np.full((m, m), 7.0), y=np.full(m, 7.0), at=np.full(columns, 7),
        V=np.full((-(-m // 4) * 4, N), 7.0), singles=0,
    )  # fmt: skip


def swung(x: Array, P: Array, before: Array) -> Array:
    """The covariance after the frame's place was moved: a turn of the map now moves it otherwise."""
    A = np.eye(N)
    dx, dy = (x - before)[FRAME : FRAME + 2]
    A[FRAME, FRAME + 2], A[FRAME + 1, FRAME + 2] = -dy, dx
    return np.asarray(A @ P @ A.T)


@pytest.mark.parametrize("frame", [-1, FRAME])
@pytest.mark.parametrize("at", [(2,), (2, OFFSET)])
@pytest.mark.parametrize("free", [0, 2])
@pytest.mark.parametrize("accepted", [1, 2, 3])
@pytest.mark.parametrize("taken", [False, True])
@pytest.mark.parametrize("kept", [(), (8, 9, 12)])
def test_a_scan_and_a_heading_of_one_instant_correct_together(
    kept: tuple[int, ...], taken: bool, accepted: int, free: int, at: tuple[int, ...], frame: int
) -> None:
    rng = np.random.default_rng(accepted)
    b, h, m = believed(accepted, frame, kept), headings([0.0, 0.0], 0.02, at), 2 * accepted
    h.told[:, 4] = 9.0, 0.07  # innovations, of which the second is meant
    lines = [8 + k for k in range(2 * accepted)]
    columns = [0, 1, 2, *[7, 6][:free], *lines]
    width, root = len(columns), 0.1 * rng.normal(size=(m, m))
    H, R, y = rng.normal(size=(m, width)), root @ root.T + 0.01 * np.eye(m), rng.normal(0.0, 0.1, m)
    d = desk(m + 1, width + 2)
    d.H[:m, :width], d.R[:m, :m], d.y[:m], d.at[:width] = H, R, y, columns
    s, joint = table(joint=np.zeros((3, 2))), table(joint=True)
    full, book = np.zeros((m + 1, N)), TextbookEkf(b.x, b.P)
    full[:m, columns], full[m, list(at)] = H, 1.0
    noise = np.zeros((m + 1, m + 1))
    noise[:m, :m], noise[m, m] = R, 0.02
    rows = m + taken
    fit = y @ np.linalg.solve((full @ b.P @ full.T + noise)[:m, :m], y)
    book.correct(np.append(y, 0.07)[:rows], full[:rows], noise[:rows, :rows], kept)
    before, h.taken, own = b.x.copy(), 1 if taken else -1, b.P[np.ix_(kept, kept)]
    assert core.correct_by(b, s, 1, accepted, h, True, table(free=free), joint, d) > 0.0
    np.testing.assert_allclose(b.x, book.x, atol=1e-12)
    np.testing.assert_allclose(b.P, book.P if frame < 0 else swung(book.x, book.P, before), atol=1e-12)
    np.testing.assert_array_equal(b.x[list(kept)], before[list(kept)])
    np.testing.assert_array_equal(b.P[np.ix_(kept, kept)], own)
    np.testing.assert_allclose(s.joint[1], np.array([fit, m]) if accepted > 1 else np.zeros(2))
    assert not s.joint[[0, 2]].any()


@pytest.mark.parametrize("frame", [-1, FRAME])
@pytest.mark.parametrize(("at", "z"), [((2,), 1.2), ((2, OFFSET), 1.2), ((2, OFFSET), 1.2 + 4.0 * math.pi)])
def test_a_heading_alone_is_compared_and_corrects(at: tuple[int, ...], z: float, frame: int) -> None:
    b, h, d = believed(3, frame), headings([0.0, z], 0.02, at), desk(1, 2)
    b.x[list(at)] = 1.2 / len(at)
    d.R = np.full((1, 1), np.nan)
    H, before = np.zeros((1, N)), b.x.copy()
    H[0, list(at)] = 1.0
    S, book = float(H[0] @ b.P @ H[0]) + 0.02, TextbookEkf(b.x, b.P)
    book.correct(np.array([-0.1]), H, np.array([[0.02]]))
    assert core.turn(b, h, 1, d) == pytest.approx(S)
    np.testing.assert_allclose(h.told[1], [0.0, -1.0, 0.01 / S, GATE, -0.1, math.sqrt(S)])
    core.correct_by(b, table(), 0, 0, h, True, table(free=0), table(joint=True), d)
    np.testing.assert_allclose(b.x, book.x, atol=1e-12)
    np.testing.assert_allclose(b.P, book.P if frame < 0 else swung(book.x, book.P, before), atol=1e-12)


def test_a_heading_beyond_the_gate_one_of_no_use_and_one_that_is_none_are_told_apart() -> None:
    b, d = believed(4), desk(1, 2)
    b.P = 1e-4 * np.eye(N)
    sigma = math.sqrt(1e-4 + 0.02)
    for share, verdict in ((0.99, 0.0), (1.01, REFUSED)):
        h = headings([b.x[2] + 0.1 + share * math.sqrt(GATE) * sigma], 0.02, (2,))
        core.turn(b, h, 0, d)
        assert h.told[0, 0] == verdict
        assert h.told[0, 2] == pytest.approx(share**2 * GATE)
    h = headings([b.x[2] + 2.0], 0.02, (2,))
    h.usable[0] = False
    core.turn(b, h, 0, d)
    assert h.told[0, 0] == UNUSED
    h = headings([math.nan], 0.02, (2,))
    core.turn(b, h, 0, d)
    assert h.told[0, 0] == REFUSED
    h = headings([0.0], -1.0, (2,))  # no variance
    assert not core.turn(b, h, 0, d) > 0.0


WHEELS = 10  # the first of three columns by which motions are corrected


def motions(seed: int, n: int, states: int = 0) -> Any:
    rng = np.random.default_rng(seed)
    root = 0.01 * rng.normal(size=(n, 3, 3))
    return table(
        u=rng.normal(0.0, 0.2, (n, 3)), Q=(root @ root.transpose(0, 2, 1)).reshape(n, 9),
        dt=rng.uniform(0.1, 0.2, n), drifting=[OFFSET, 7], drift=[0.02, 0.03], drifts=2,
        J=rng.normal(size=(n, 3 * states)), first=WHEELS, states=states,
    )  # fmt: skip


def predict(book: TextbookEkf, m: Any, k: int) -> None:
    J = m.J[k].reshape(3, m.states) if m.states else None
    book.predict(m.u[k], m.Q[k].reshape(3, 3), J, range(m.first, m.first + m.states))
    book.P[[OFFSET, 7], [OFFSET, 7]] += np.array([0.02, 0.03]) * m.dt[k]


@pytest.mark.parametrize("states", [0, 1, 3])
def test_a_prediction_is_the_textbooks_with_drift_and_counts_the_way(states: int) -> None:
    b, m = believed(5), motions(5, 3, states)
    progress, book = table(x=0.5, y=-0.2, theta=0.1), TextbookEkf(b.x, b.P)
    core.roll(b, m, progress, 2)
    predict(book, m, 2)
    np.testing.assert_allclose(b.x, book.x, atol=1e-12)
    np.testing.assert_allclose(b.P, book.P, atol=1e-12)
    np.testing.assert_allclose((progress.x, progress.y, progress.theta), m.u[2] + (0.5, -0.2, 0.1))


def test_a_stretch_without_scans_is_the_textbooks_instant_by_instant_and_notes_each() -> None:
    n = 12
    b, m, when = believed(6), motions(6, n), (2, 3, 7, 10)
    h, d, book = headings([0.3, -0.2, 0.1, 9.0], 0.02, (2, OFFSET), when), desk(1, 2), TextbookEkf(b.x, b.P)
    h.gate = math.inf
    h.usable[2] = False
    notes = table(
        room=np.zeros(9), pose=np.zeros((n, 3)), triangle=np.zeros((n, 6)), columns=[OFFSET, 9], blocks=2,
        values=np.zeros((n, 4)),
    )  # fmt: skip
    progress: Any = table(instant=1, why=-1, scan=0, x=0.0, y=0.0, theta=0.0)
    none, no = table(scans=0), table()
    assert core.coast(b, m, readings(h), none, no, table(free=0), no, no, no, d, notes, progress, n) > 0.0
    assert (progress.instant, progress.why) == (n, core.DONE)
    H, upper = np.eye(N)[[2]] + np.eye(N)[[OFFSET]], np.triu_indices(3)
    for k in range(1, n):
        predict(book, m, k)
        if k in when and k != 7:
            y = h.z[when.index(k)] - 0.1 - book.x[2] - book.x[OFFSET]
            book.correct(np.array([math.remainder(y, math.tau)]), H, np.array([[0.02]]))
        np.testing.assert_allclose(notes.pose[k], book.x[:3], atol=1e-10)
        np.testing.assert_allclose(notes.triangle[k], book.P[:3, :3][upper], atol=1e-10)
        expected = [*book.x[[OFFSET, 9]], book.P[OFFSET, OFFSET], book.P[9, 9]]
        np.testing.assert_allclose(notes.values[k], expected, atol=1e-10)
    np.testing.assert_allclose((progress.x, progress.y, progress.theta), m.u[1:].sum(axis=0))
    assert not notes.pose[0].any()
    h.r[0] = -1.0  # a correction that fails says so
    progress.instant, h.due = 1, 0
    assert not core.coast(b, m, readings(h), none, no, table(free=0), no, no, no, d, notes, progress, n) > 0.0


def test_scans_come_one_after_another_each_with_the_heading_of_its_instant(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """What a scan says is another file's: here the place x, measured. One line, psi unknown."""
    n, when = 8, (1, 4, 6)
    b, m = believed(7), motions(7, n)
    h, d, book = headings([0.3, -0.2, 0.1], 0.02, (2, OFFSET), (1, 5, 6)), desk(3, 7), TextbookEkf(b.x, b.P)
    h.gate = math.inf
    seen, fit = [0.4, -0.1, 0.2], [MATCHED] * 3
    row, noise = np.zeros(N), np.diag([0.01, 1e12])
    row[0] = 1.0

    def state(b: Any, s: Any, scan: int, *rest: Any) -> int:
        d.at[:5], d.H[:2, :5], d.R[:2, :2] = [0, 1, 2, 8, 9], 0.0, noise
        d.H[0, 0], d.y[:2] = 1.0, (seen[scan] - b.x[0], 0.0)
        return 1

    monkeypatch.setattr(core, "look", lambda b, s, scan, *rest: fit[scan])
    monkeypatch.setattr(core, "state", state)
    monkeypatch.setattr(core, "teach", lambda b, s, scan, *rest: scan == 2)
    notes = table(
        room=np.zeros(9),
        pose=np.zeros((n, 3)),
        triangle=np.zeros((n, 6)),
        columns=[],
        blocks=0,
        values=np.zeros((n, 0)),
    )
    progress = table(instant=0, why=-1, scan=0, x=0.0, y=0.0, theta=0.0)
    given = (
        b,
        m,
        readings(h),
        table(scans=3, when=when),
        table(),
        table(free=0),
        table(joint=True),
        table(),
        table(),
        d,
        notes,
        progress,
    )
    assert core.coast(*given, n) > 0.0
    assert (progress.instant, progress.why, progress.scan) == (6, core.AFTER, 3)  # the last one taught a new line
    for k in range(7):
        predict(book, m, k)
        H, y, R = [], [], []
        if k in when:
            H, y, R = [row], [seen[when.index(k)] - book.x[0]], [0.01]
        if k in h.when:
            H.append(np.eye(N)[2] + np.eye(N)[OFFSET])
            y.append(math.remainder(h.z[h.when.index(k)] - 0.1 - book.x[2] - book.x[OFFSET], math.tau))
            R.append(0.02)
        if H:
            book.correct(np.array(y), np.array(H), np.diag(R))
    np.testing.assert_allclose(b.x, book.x, atol=1e-7)
    np.testing.assert_allclose(b.P, book.P, atol=1e-7)
    fit[0], progress.instant, progress.scan = NOTHING - 1, 0, 0  # hardly fits: the loop must see to it
    assert core.coast(*given, n) > 0.0
    assert (progress.instant, progress.why, progress.scan) == (1, core.BEFORE, 0)
