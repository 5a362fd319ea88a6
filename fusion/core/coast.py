"""The filter over a stretch of a drive, many instants at once: scans that fit the line map, and single readings.

It stops where the loop in Python must take over: before a scan that hardly fits or a new landmark, after a scan
with a new line.
"""

from .bearings import sight
from .echoes import hear
from .filter import AT_ONCE, FINE, consider, correct, locate, move, swing, whiten
from .fit import folded
from .fixes import locate_fix
from .poses import begin_pose, posed
from .scans import MATCHED, NOTHING, columns_of, look, state, teach
from .sightings import detect, unknown
from .singles import JUDGED, add_singles, make_room, note_fit
from .turns import begin_turn, turned
from .twists import begin_way, driven

DONE, BEFORE, AFTER = (
    0,
    1,
    2,
)  # why it stopped: all done; predicted, no more; all but the map's lessons and the note


def coast(b, m, r, s, w, seat, rule, rest, way, d, notes, progress, last):
    """Predict (eq. 5-7) from the instant of `progress` until `last`, and correct by all that is due (eq. 10-12).

    `progress` says where and why this stopped. Returns what `whiten` does where a correction failed, else FINE.
    """
    for k in range(progress.instant, last):
        progress.instant = k
        roll(b, m, progress, k)
        if is_due(r.sightings.when, r.sightings.due, r.sightings.readings, k) and unknown(
            r.sightings, r.sightings.due
        ):
            progress.why = BEFORE
            return FINE
        scan, kind = progress.scan, NOTHING
        if scan < s.scans and s.when[scan] == k:
            kind = look(b, s, scan, w, seat, rule, rest, progress, d)
            if kind < 0:
                progress.why = BEFORE
                return FINE
            progress.scan += 1
        d.singles = 0
        accepted = 0
        greatest = compare(b, r, w, d, k)
        if greatest > 0.0 and kind == MATCHED:
            accepted = state(b, s, scan, w, seat, rule, d)
        if greatest > 0.0 and (accepted > 0 or r.headings.taken >= 0 or d.singles > 0):
            greatest = correct_by(b, s, scan, accepted, r.headings, r.whole, seat, rule, d)
        if not greatest > 0.0:
            return greatest
        keep(b, r, k, d)
        if kind != NOTHING and teach(b, s, scan, w, rule, rest, way, progress, d):
            progress.why = AFTER
            return FINE
        note(
            b.x, b.P, b.frame, notes.room, k, notes.pose, notes.triangle, notes.columns, notes.blocks, notes.values
        )
    progress.instant, progress.why = last, DONE
    return FINE


def is_due(when, due, readings, k):
    """Tell whether reading `due` of so many `readings` belongs to instant k."""
    return due < readings and when[due] == k


def keep(b, r, k, d):
    """Keep heading and pose of instant k, from which the next reading of some sensors counts."""
    if r.turns.due > 0 and r.turns.when[r.turns.due - 1] == k:
        begin_turn(b, r.turns, r.turns.due - 1)
    if r.poses.due > 0 and r.poses.when[r.poses.due - 1] == k:
        begin_pose(b, r.poses, r.poses.due - 1, d)
    if r.twists.due > 0 and r.twists.when[r.twists.due - 1] == k:
        begin_way(b, r.twists, r.twists.due - 1)


def roll(b, m, progress, k):
    """Predict to instant k, and sum up how far the wheels rolled."""
    ux, uy, turn = m.u[k, 0], m.u[k, 1], m.u[k, 2]
    move(
        b.x, b.P, b.n, ux, uy, turn, m.Q[k, 0], m.Q[k, 1], m.Q[k, 2], m.Q[k, 4], m.Q[k, 5], m.Q[k, 8], m.J, k,
        m.first, m.states,
    )  # fmt: skip
    for j in range(m.drifts):
        b.P[m.drifting[j], m.drifting[j]] += m.drift[j] * m.dt[k]
    progress.x += ux
    progress.y += uy
    progress.theta += turn


def compare(b, r, w, d, k):
    """Compare all single readings that are due at instant k with the belief; returns what `whiten` does.

    What corrects it is `r.headings.taken`, else -1, and the rows that wait on the desk.
    """
    greatest = FINE
    r.headings.taken = -1
    if is_due(r.headings.when, r.headings.due, r.headings.readings, k):
        greatest = turn(b, r.headings, r.headings.due, d)
        r.headings.due += 1
    if greatest > 0.0 and is_due(r.bearings.when, r.bearings.due, r.bearings.readings, k):
        greatest = sight(b, r.bearings, r.bearings.due, d)
        r.bearings.due += 1
    if greatest > 0.0 and is_due(r.echoes.when, r.echoes.due, r.echoes.readings, k):
        greatest = hear(b, w, r.echoes, r.echoes.due, d)
        r.echoes.due += 1
    if greatest > 0.0 and is_due(r.fixes.when, r.fixes.due, r.fixes.readings, k):
        greatest = locate_fix(b, r.fixes, r.fixes.due, d)
        r.fixes.due += 1
    if greatest > 0.0 and is_due(r.turns.when, r.turns.due, r.turns.readings, k):
        greatest = turned(b, r.turns, r.turns.due, d)
        r.turns.due += 1
    if greatest > 0.0 and is_due(r.sightings.when, r.sightings.due, r.sightings.readings, k):
        greatest = detect(b, r.sightings, r.sightings.due, r.whole, d)
        r.sightings.due += 1
    if greatest > 0.0 and is_due(r.poses.when, r.poses.due, r.poses.readings, k):
        greatest = posed(b, r.poses, r.poses.due, d)
        r.poses.due += 1
    if greatest > 0.0 and is_due(r.twists.when, r.twists.due, r.twists.readings, k):
        greatest = driven(b, r.twists, r.twists.due, d)
        r.twists.due += 1
    return greatest


def turn(b, h, i, d):
    """Compare heading i with the belief, and tell what became of it; returns what `whiten` does."""
    y = h.z[i] - h.offset
    for j in range(h.states):
        y -= b.x[h.at[j]]
        d.H[0, j] = 1.0
    d.y[0], d.R[0, 0], none = folded(y), h.r[i], h.r[i] - h.r[i]
    h.told[i, 0], h.told[i, 3] = 0.0 if h.usable[i] else h.unused, h.gate
    h.told[i, JUDGED] = d.y[0]
    if none != 0.0:  # a variance that is no number, or infinite
        h.told[i, 2], h.told[i, JUDGED + 1] = none, h.r[i]
        if h.told[i, 0] == 0.0:
            h.told[i, 0] = h.refused
        return FINE
    greatest = whiten(b.P, b.n, h.at, h.states, d.H, d.R, d.y, 1, d.V)
    if greatest > 0.0:
        h.told[i, 2], h.told[i, JUDGED + 1] = d.y[0] * d.y[0], d.R[0, 0]
        if h.told[i, 0] == 0.0 and not h.told[i, 2] <= h.gate:
            h.told[i, 0] = h.refused
        if h.told[i, 0] == 0.0:
            h.taken = i
    return greatest


def correct_by(b, s, scan, accepted, h, whole, seat, rule, d):
    """Correct once by a scan's accepted lines, which are written, by the heading that is taken, and what waits.

    A heading alone is what `turn` has just whitened. How well a scan fits as a `whole` is noted,
    where that is asked.
    """
    greatest, m, width = FINE, 2 * accepted, 0
    if accepted > 0 or d.singles > 0:
        if accepted > 0:
            width = columns_of(accepted, seat, rule)
        if h.taken >= 0:
            add_heading(h, h.taken, d, m, width)
            m, width = m + 1, width + h.states
        width = add_singles(d, 0, d.singles, m, width)
        m += d.singles
        greatest = whiten(b.P, b.n, d.at, width, d.H, d.R, d.y, m, d.V)
        if not greatest > 0.0:
            return greatest
        if whole and accepted > 1:
            note_fit(s.joint, scan, d.y, 2 * accepted)
    correct_in_frame(b, d.V, d.y, max(m, 1))
    return greatest


def add_heading(h, i, d, m, width):
    """Write heading i as row m, with its states behind the `width` columns of the rows before it."""
    make_room(d, m, width, h.states)
    for j in range(h.states):
        d.at[width + j], d.H[m, width + j] = h.at[j], 1.0
    d.y[m], d.R[m, m] = h.told[i, JUDGED], h.r[i]


def correct_in_frame(b, V, e, m):
    """Correct by m rows, and let the uncertainty of the map frame's place follow its correction."""
    place_x = place_y = 0.0
    if b.frame >= 0:
        place_x, place_y = b.x[b.frame], b.x[b.frame + 1]
    if b.some:
        consider(b.x, b.P, b.n, V, e, m, b.kept)
    else:
        for k in range(m, m + (AT_ONCE - m % AT_ONCE) % AT_ONCE):
            for j in range(b.n):
                V[k, j] = 0.0
        correct(b.x, b.P, b.n, V, e, m)
    if b.frame >= 0:
        swing(b.P, b.n, b.frame, b.x[b.frame] - place_x, b.x[b.frame + 1] - place_y)


def note(x, P, frame, room, k, pose, triangle, columns, blocks, values):
    """Write where the robot is at instant k, and the states of blocks with their variances."""
    locate(x, P, frame, room)
    for j in range(3):
        pose[k, j] = room[j]
    for j in range(6):
        triangle[k, j] = room[3 + j]
    for j in range(blocks):
        values[k, j], values[k, blocks + j] = x[columns[j]], P[columns[j], columns[j]]
