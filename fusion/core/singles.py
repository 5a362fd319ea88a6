"""Single readings of an instant (a bearing, a fix, an echo, a turn): rows of one equation, beside those of a scan.

Each is compared with the belief by itself. Those that are accepted wait on the desk, each with the states of its
own, until the instant is corrected at once.
"""

from math import sqrt

from .filter import FINE, by_local, factor, whiten

WIDE = 10  # states that a reading depends on at most: pose, map frame, and four more
JUDGED = 4  # columns of what is told of a reading, before its y and its sigmas: verdict, landmark, NIS, threshold


def derive(b, local, by_x, by_y, by_theta, k, d):
    """Let the states of row k be pose and map frame, and write its derivatives by them; return how many they are.

    Given are those by the pose in the map, or by the `local` pose itself.
    """
    states = 3
    d.chain[0], d.chain[1], d.chain[2] = by_x, by_y, by_theta
    if not local:
        states = by_local(b.x, b.frame, by_x, by_y, by_theta, d.chain)
    for j in range(states):
        d.own_H[k, j] = d.chain[j]
        d.own_at[k, j] = j if j < 3 else b.frame + j - 3
    return states


def product(P, d, i, j, states):
    """Return H_i P H_j' of two rows of so many states."""
    total = 0.0
    for p in range(states):
        for q in range(states):
            if d.own_H[i, p] != 0.0 and d.own_H[j, q] != 0.0:  # what is not asked for may be no number
                total += d.own_H[i, p] * d.own_H[j, q] * P[d.own_at[i, p], d.own_at[j, q]]
    return total


def variance(P, d, k, states):
    """Return H P H' of row k."""
    return max(product(P, d, k, k, states), 0.0)  # but for rounding


def state_of(d, k, j, at, by):
    """Let state j of row k be that of column `at`, by which its derivative is `by`."""
    d.own_at[k, j], d.own_H[k, j] = at, by


def say(d, k, y, r, shared, follows):
    """Write innovation and noise of row k: its variance, and what it `shared` with the row before.

    It `follows` so many rows of its reading.
    """
    d.own_y[k], d.own_R[k, 0], d.own_R[k, 1] = y, r, shared
    d.follows[k] = follows


def say_third(d, k, y, r, shared, first):
    """Write the same of a third row, with what it shared with the `first`."""
    say(d, k, y, r, shared, 2)
    d.own_R[k, 2] = first


def weigh(b, d, numbers, states, told, row):
    """Write NIS, innovations and sigmas of the next rows, which are one reading of so many `numbers`.

    Eq. 10's S = H P H' + R, and y' S^-1 y, which is left NaN for what is no number. Returns what `whiten` does.
    """
    k, nis, total = d.singles, 0.0, 0.0
    for i in range(numbers):
        for j in range(i):
            d.S[i, j] = product(b.P, d, k + i, k + j, states) + d.own_R[k + i, i - j]
        d.S[i, i] = variance(b.P, d, k + i, states) + d.own_R[k + i, 0]
        told[row, JUDGED + i] = d.own_y[k + i]
        told[row, JUDGED + numbers + i] = sqrt(d.S[i, i]) if d.S[i, i] > 0.0 else d.S[i, i]
        total += d.S[i, i]
    greatest = max(0.0, d.S[0, 0])
    if total * total - total * total != 0.0:  # no number, or so large that its products are none
        return FINE
    if not factor(d.S, numbers):
        return -greatest
    for i in range(numbers):
        d.e[i] = d.own_y[k + i]
        for j in range(i):
            d.e[i] -= d.S[i, j] * d.e[j]
        d.e[i] /= d.S[i, i]
        nis += d.e[i] * d.e[i]
    told[row, 2] = nis
    return greatest


def settle(d, numbers, states, told, row, landmark, gate, refused):
    """Give a reading that was weighed its verdict, 0 within the `gate`: then it waits for the correction."""
    told[row, 0], told[row, 1], told[row, 3] = refused, landmark, gate
    if told[row, 2] <= gate:
        told[row, 0] = 0.0
        wait(d, numbers, states)


def wait(d, numbers, states):
    """Let the next rows, so many `numbers` of one reading, wait for the correction."""
    for k in range(d.singles, d.singles + numbers):
        d.own_states[k] = states
    d.singles += numbers


def add_singles(d, first, last, m, width):
    """Write the rows first:last that wait, from row m on and behind `width` columns; return the columns then."""
    for k in range(first, last):
        states = d.own_states[k]
        if d.follows[k]:
            make_room(d, m, width, 0)
            d.R[m, m - 1] = d.R[m - 1, m] = d.own_R[k, 1]
            if d.follows[k] > 1:
                d.R[m, m - 2] = d.R[m - 2, m] = d.own_R[k, 2]
        else:
            make_room(d, m, width, states)
            width += states
        for j in range(states):
            d.at[width - states + j], d.H[m, width - states + j] = d.own_at[k, j], d.own_H[k, j]
        d.y[m], d.R[m, m] = d.own_y[k], d.own_R[k, 0]
        m += 1
    return width


def make_room(d, m, width, states):
    """Let row m, and so many columns behind the `width` of the rows before it, be zero, and its noise its own."""
    for k in range(m):
        for j in range(states):
            d.H[k, width + j] = 0.0
        d.R[k, m] = d.R[m, k] = 0.0
    for j in range(width + states):
        d.H[m, j] = 0.0


def fit_of(b, d, first, last, joint, i):
    """Write how well the rows first:last that wait fit as a whole; return what `whiten` does."""
    m = last - first
    width = add_singles(d, first, last, 0, 0)
    greatest = whiten(b.P, b.n, d.at, width, d.H, d.R, d.y, m, d.V)
    if greatest > 0.0:
        note_fit(joint, i, d.y, m)
    return greatest


def note_fit(joint, i, e, m):
    """Write how well the first m numbers of a correction fit as a whole: y' S^-1 y and the degrees of freedom."""
    total = 0.0
    for j in range(m):
        total += e[j] * e[j]
    joint[i, 0], joint[i, 1] = total, m
