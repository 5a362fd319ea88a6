"""The filter over a stretch of a drive on which nothing but headings is read: many instants at once."""

from .filter import correct, locate, move, swing, whiten
from .fit import wrapped

HEARD = 4  # columns of what is told of a reading: verdict, NIS, y, sigma


def coast(
    x, P, n, frame, first, last, u, Q, dt, drifting, drift, drifts, when, reading, stop, z, r, usable, gate,
    refused, unused, offset, at, states, room, y, S, H, V, pose, triangle, columns, blocks, values, told
):  # fmt: skip
    """Predict (eq. 5-7) from instant `first` until `last`, and correct by every heading due there (eq. 10-12).

    u (instants, 3), Q (instants, 9) and dt (instants,) are the motions; the states `drifting` (drifts,) gain the
    variance `drift` each second. Headings `reading` until `stop` are due here: heading i at instant when[i] is
    z[i] [rad] of variance r[i], and what is predicted is `offset` and the sum of the states `at` (states,). Where
    it is not `usable`, or beyond `gate`, it corrects nothing. room (9,), y (1,), S (1, 1), H (1, states) of ones,
    and V (4, n) of zeros are room. Written are pose (instants, 3) and triangle (instants, 6) by `locate`, the
    states `columns` (blocks,) and their variances as values (instants, 2 blocks), and told (readings, 4), with the
    verdict 0, `refused` or `unused`. Returns what `whiten` does where a correction failed, else 1.
    """
    i = reading
    for k in range(first, last):
        move(x, P, n, u[k, 0], u[k, 1], u[k, 2], Q[k, 0], Q[k, 1], Q[k, 2], Q[k, 4], Q[k, 5], Q[k, 8])
        for j in range(drifts):
            P[drifting[j], drifting[j]] += drift[j] * dt[k]
        if i < stop and when[i] == k:
            told[i, 0] = 0.0 if usable[i] else unused
            greatest = heading(x, P, n, frame, z[i] - offset, r[i], gate, refused, at, states, y, S, H, V, told, i)
            if not greatest > 0.0:
                return greatest
            i += 1
        note(x, P, frame, room, k, pose, triangle, columns, blocks, values)
    return 1.0


def heading(x, P, n, frame, z, r, gate, refused, at, states, y, S, H, V, told, i):
    """Correct by heading i, and tell what became of it; returns what `whiten` does."""
    turn = z
    for j in range(states):
        turn -= x[at[j]]
    y[0], S[0, 0] = turn - turn, r  # NaN where there is no heading
    if y[0] == 0.0:
        y[0] = wrapped(turn)
    told[i, 2] = y[0]
    greatest = whiten(P, n, at, states, H, S, y, 1, V)
    if not greatest > 0.0:
        return greatest
    told[i, 1], told[i, 3] = y[0] * y[0], S[0, 0]
    if told[i, 0] == 0.0 and not told[i, 1] <= gate:
        told[i, 0] = refused
    if told[i, 0] == 0.0:
        correct_in_frame(x, P, n, frame, V, y)
    return greatest


def correct_in_frame(x, P, n, frame, V, e):
    """Correct by one row, and let the uncertainty of the map frame's place follow its correction."""
    if frame < 0:
        correct(x, P, n, V, e, 1)
        return
    place_x, place_y = x[frame], x[frame + 1]
    correct(x, P, n, V, e, 1)
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
