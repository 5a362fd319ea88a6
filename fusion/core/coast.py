"""The filter over a stretch of a drive, many instants at once: headings, bearings, scans that fit the line map.

It stops where the loop in Python must take over: before a scan that hardly fits, after one with a new line.
"""

from .bearings import sight
from .filter import AT_ONCE, correct, locate, move, swing, whiten
from .fit import wrapped
from .scans import MATCHED, NOTHING, columns_of, look, state, teach

HEARD = 4  # columns of what is told of a reading: verdict, NIS, y, sigma
DONE, BEFORE, AFTER = (
    0,
    1,
    2,
)  # why it stopped: all done; predicted, no more; all but the map's lessons and the note


def coast(b, m, h, g, s, w, seat, rule, way, d, notes, progress, last):
    """Predict (eq. 5-7) from the instant of `progress` until `last`, and correct by all that is due (eq. 10-12).

    `progress` says where and why this stopped. Returns what `whiten` does where a correction failed, else 1.
    """
    for k in range(progress.instant, last):
        progress.instant = k
        roll(b, m, progress, k)
        scan, kind = progress.scan, NOTHING
        if scan < s.scans and s.when[scan] == k:
            kind = look(b, s, scan, w, seat, rule, progress, d)
            if kind < 0:
                progress.why = BEFORE
                return 1.0
            progress.scan += 1
        accepted, greatest = 0, compare(b, h, g, d, k)
        if greatest > 0.0 and kind == MATCHED:
            accepted = state(b, s, scan, w, seat, rule, d)
        if greatest > 0.0 and (accepted > 0 or h.taken >= 0 or g.chosen >= 0):
            greatest = correct_by(b, s, scan, accepted, h, g, seat, rule, d)
        if not greatest > 0.0:
            return greatest
        if kind == MATCHED and teach(b, s, scan, w, rule, way, progress, d):
            progress.why = AFTER
            return 1.0
        note(
            b.x, b.P, b.frame, notes.room, k, notes.pose, notes.triangle, notes.columns, notes.blocks, notes.values
        )
    progress.instant, progress.why = last, DONE
    return 1.0


def roll(b, m, progress, k):
    """Predict to instant k, and sum up how far the wheels rolled."""
    ux, uy, turn = m.u[k, 0], m.u[k, 1], m.u[k, 2]
    move(b.x, b.P, b.n, ux, uy, turn, m.Q[k, 0], m.Q[k, 1], m.Q[k, 2], m.Q[k, 4], m.Q[k, 5], m.Q[k, 8])
    for j in range(m.drifts):
        b.P[m.drifting[j], m.drifting[j]] += m.drift[j] * m.dt[k]
    progress.x += ux
    progress.y += uy
    progress.theta += turn


def compare(b, h, g, d, k):
    """Compare heading and picture with the belief where they are due at instant k; returns what `whiten` does.

    What corrects it is `h.taken` and `g.chosen`, else -1.
    """
    greatest = 1.0
    h.taken = g.chosen = -1
    if h.due < h.readings and h.when[h.due] == k:
        greatest = turn(b, h, h.due, d)
        h.due += 1
    if greatest > 0.0 and g.due < g.readings and g.when[g.due] == k:
        greatest = sight(b, g, g.due, d)
        g.due += 1
    return greatest


def turn(b, h, i, d):
    """Compare heading i with the belief, and tell what became of it; returns what `whiten` does."""
    y = h.z[i] - h.offset
    for j in range(h.states):
        y -= b.x[h.at[j]]
        d.H[0, j] = 1.0
    d.y[0], d.R[0, 0] = y - y, h.r[i]  # NaN where there is no heading
    if d.y[0] == 0.0:
        d.y[0] = wrapped(y)
    h.told[i, 0] = 0.0 if h.usable[i] else h.unused
    h.told[i, 2] = d.y[0]
    greatest = whiten(b.P, b.n, h.at, h.states, d.H, d.R, d.y, 1, d.V)
    if greatest > 0.0:
        h.told[i, 1], h.told[i, 3] = d.y[0] * d.y[0], d.R[0, 0]
        if h.told[i, 0] == 0.0 and not h.told[i, 1] <= h.gate:
            h.told[i, 0] = h.refused
        if h.told[i, 0] == 0.0:
            h.taken = i
    return greatest


def correct_by(b, s, scan, accepted, h, g, seat, rule, d):
    """Correct once by what is written of a scan's accepted lines, and by heading and bearing where they are taken.

    A heading alone is what `turn` has just whitened.
    """
    greatest, m, width = 1.0, 2 * accepted, 0
    if accepted > 0 or g.chosen >= 0:
        if accepted > 0:
            width = columns_of(accepted, seat, rule)
        if h.taken >= 0:
            add_heading(h, h.taken, d, m, width)
            m, width = m + 1, width + h.states
        if g.chosen >= 0:
            states = g.seat.free + (3 if b.frame < 0 else 6)
            add_bearing(d, states, m, width)
            m, width = m + 1, width + states
        greatest = whiten(b.P, b.n, d.at, width, d.H, d.R, d.y, m, d.V)
        if not greatest > 0.0:
            return greatest
        if rule.joint and accepted > 1:
            note_fit(s.joint, scan, d.y, 2 * accepted)
    correct_in_frame(b.x, b.P, b.n, b.frame, d.V, d.y, max(m, 1))
    return greatest


def add_heading(h, i, d, m, width):
    """Write heading i as row m, with its states behind the `width` columns of the rows before it."""
    make_room(d, m, width, h.states)
    for j in range(h.states):
        d.at[width + j], d.H[m, width + j] = h.at[j], 1.0
    d.y[m], d.R[m, m] = h.told[i, 2], h.r[i]


def add_bearing(d, states, m, width):
    """Write the bearing on the desk as row m, with its states behind the `width` columns of the rows before it."""
    make_room(d, m, width, states)
    for j in range(states):
        d.at[width + j], d.H[m, width + j] = d.ray_at[j], d.ray_row[j]
    d.y[m], d.R[m, m] = d.ray[7], d.ray[8]


def make_room(d, m, width, states):
    """Let row m, and so many columns behind the `width` of the rows before it, be zero, and its noise its own."""
    for k in range(m):
        for j in range(states):
            d.H[k, width + j] = 0.0
        d.R[k, m] = d.R[m, k] = 0.0
    for j in range(width):
        d.H[m, j] = 0.0


def note_fit(joint, scan, e, m):
    """Write how well the first m numbers of a correction fit as a whole: y' S^-1 y and the degrees of freedom."""
    total = 0.0
    for j in range(m):
        total += e[j] * e[j]
    joint[scan, 0], joint[scan, 1] = total, m


def correct_in_frame(x, P, n, frame, V, e, m):
    """Correct by m rows, and let the uncertainty of the map frame's place follow its correction."""
    for k in range(m, m + (AT_ONCE - m % AT_ONCE) % AT_ONCE):
        for j in range(n):
            V[k, j] = 0.0
    if frame < 0:
        correct(x, P, n, V, e, m)
        return
    place_x, place_y = x[frame], x[frame + 1]
    correct(x, P, n, V, e, m)
    swing(P, n, frame, x[frame] - place_x, x[frame + 1] - place_y)


def note(x, P, frame, room, k, pose, triangle, columns, blocks, values):
    """Write where the robot is at instant k, and the states of blocks with their variances."""
    locate(x, P, frame, room)
    for j in range(3):
        pose[k, j] = room[j]
    for j in range(6):
        triangle[k, j] = room[3 + j]
    for j in range(blocks):
        values[k, j], values[k, blocks + j] = x[columns[j]], P[columns[j], columns[j]]
