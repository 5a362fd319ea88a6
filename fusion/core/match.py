"""Which map line is this, and what do matched lines say together? By the pairs that `pairs` found.

A pair is two numbers of one equation: (r, psi) of a measured line less what is predicted of a map line (eq. 17,
18). Its derivatives (eq. 13) by pose, line and mount stand in `pairs`. A match also teaches the map how far its
lines reach.
"""

from math import cos, sin, sqrt

from .pairs import PAIR, lever

LINE = 7  # columns of a measured line: r, psi, R as 00, 01, 11, and both ends
TOLD = 5  # columns of what is told of a line: NIS, y (2), sigma (2)
COMMON = 0.05  # m of one map line that two measured lines may both claim


def match(pairs, found, rows, lines, gate, zone, rival, share, longest, fate, order):
    """Write fate (4, lines): the pair that matches, the best pair, -1 where there is none; ambiguous; near.

    A pair matches within `gate` where it overlaps by more than `share` of the measured length, of at most
    `longest` [m]; another such pair that is worse by less than `rival` makes it ambiguous. A line is near a map
    line that it overlaps within `zone`. `order` (lines,) is room.
    """
    for i in range(4 * lines):
        fate[i] = -1 if i < 2 * lines else 0
    for p in range(found):
        at = PAIR * p
        i = whole(pairs[at])
        if pairs[at + 14] > 0.0 and pairs[at + 10] <= zone:
            fate[3 * lines + i] = 1
        kind = i if fits_well(pairs, at, rows, i, gate, share, longest) else lines + i
        if fate[kind] < 0 or pairs[at + 11] < pairs[PAIR * fate[kind] + 11]:
            fate[kind] = p
    for p in range(found):
        at = PAIR * p
        i = whole(pairs[at])
        near = fate[i] >= 0 and fate[i] != p and pairs[at + 11] - pairs[PAIR * fate[i] + 11] < rival
        if near and fits_well(pairs, at, rows, i, gate, share, longest):
            fate[2 * lines + i] = 1
    claim(pairs, lines, fate, order)
    for i in range(lines):
        if fate[2 * lines + i] > 0:
            fate[i] = -1


def claim(pairs, lines, fate, order):
    """Let the pair that matches be the best one, and each stretch of a map line be matched once.

    By their scores, lines claim the stretch of the map line that they match; who comes second is ambiguous.
    """
    claims = 0
    for i in range(lines):
        if fate[i] < 0:
            continue
        fate[lines + i] = fate[i]
        at, k = PAIR * fate[i], claims
        while k > 0 and pairs[PAIR * fate[order[k - 1]] + 11] > pairs[at + 11]:
            order[k] = order[k - 1]
            k -= 1
        order[k] = i
        claims += 1
    kept = 0
    for k in range(claims):
        i, j = order[k], 0
        while j < kept and not overlap(pairs, PAIR * fate[i], PAIR * fate[order[j]]):
            j += 1
        if j < kept:
            fate[2 * lines + i] = 1
        else:
            order[kept] = i
            kept += 1


def overlap(pairs, a, b):
    """Tell whether two pairs claim the same stretch of one map line."""
    common = min(pairs[a + 13], pairs[b + 13]) - max(pairs[a + 12], pairs[b + 12])
    return pairs[a + 1] == pairs[b + 1] and common > COMMON


def fits_well(pairs, at, rows, i, gate, share, longest):
    """Tell whether a pair of measured line i may match: by its distance, and by how much both overlap."""
    return pairs[at + 10] <= gate and pairs[at + 14] > share * min(
        rows[LINE * i + 6] - rows[LINE * i + 5], longest
    )


def whole(number):
    """Return the index that stands in a table of floats."""
    return int(number)


def matched_share(rows, lines, fate):
    """Return the share of the measured length that is matched; 1 where there is no length."""
    total = matched = 0.0
    for i in range(lines):
        length = rows[LINE * i + 6] - rows[LINE * i + 5]
        total += length
        if fate[i] >= 0:
            matched += length
    return matched / total if total > 0.0 else 1.0


def judge(pairs, fate, lines, ids, unmatched, ambiguous, new, first, verdicts, landmarks, told):
    """Write verdict, landmark and told (5) of every line, from row `first` on; return how many are accepted.

    `ids` are those of the map lines. Of a line that pairs with none nothing is told.
    """
    accepted = 0
    for i in range(lines):
        p, row = fate[lines + i], first + i
        if p < 0 or (fate[i] < 0 and not fate[3 * lines + i]):
            verdicts[row], landmarks[row] = unmatched if fate[3 * lines + i] else new, -1
            continue
        at = PAIR * p
        verdicts[row], landmarks[row] = 0, ids[whole(pairs[at + 1])]
        if fate[i] < 0:
            verdicts[row] = ambiguous if fate[2 * lines + i] else unmatched
        else:
            accepted += 1
        told[row, 0], told[row, 1], told[row, 2] = pairs[at + 10], pairs[at + 2], pairs[at + 3]
        told[row, 3], told[row, 4] = sqrt(pairs[at + 7]), sqrt(pairs[at + 9])
    return accepted


def refuse_alone(pairs, lines, fate, d2, turn, offset):
    """Let a scan's only match be none where others failed to match and it does not fit nearly perfectly.

    That is within the squared distance `d2`, `turn` [rad] and `offset` [m].
    """
    alone = -1
    for i in range(lines):
        if fate[i] >= 0:
            if alone >= 0:
                return
            alone = i
    if alone >= 0 and lines > 1:
        at = PAIR * fate[alone]
        if pairs[at + 10] > d2 or abs(pairs[at + 3]) > turn or abs(pairs[at + 2]) > offset:
            fate[alone] = -1


def is_new(fate, lines, i):
    """Tell whether line i matches nothing and is near nothing that is known."""
    return fate[i] < 0 and not fate[3 * lines + i]


def equation(
    pairs, fate, row, lines, columns, states, mount, free, at_mount, rows, shared, parts, at, H, G, R, y
):  # fmt: skip
    """Write y = H dx + noise of covariance R (2 k,) for the k pairs in a row of `fate`, and the states of H.

    `at` is the pose, the mount's `free` states `at_mount`, and where lines are `states` two `columns` for each,
    which may stand there twice. `shared` (lines, 2, parts) are unit errors that the lines of a scan share, already
    in R of each line: they are written, as the pairs read their lines, over G (2 k, parts), and add to R between
    pairs. H and R are given as zeros.
    """
    for i in range(3):
        at[i] = i
    for i in range(free):
        at[3 + i] = at_mount[i]
    a = 0
    for i in range(lines):
        p = fate[row * lines + i]
        if p < 0:
            continue
        of, b = PAIR * p, a + 1
        y[a], y[b] = pairs[of + 2], pairs[of + 3]
        H[a, 0], H[a, 1], H[b, 2] = -pairs[of + 15], -pairs[of + 16], -1.0
        c_psi = s_psi = 0.0
        if free > 0:
            c_psi, s_psi = cos(pairs[of + 18]), sin(pairs[of + 18])
        for j in range(free):
            H[a, 3 + j], H[b, 3 + j] = lever(mount, j, c_psi, s_psi), -1.0 if mount[2 + j] == 2.0 else 0.0
        if states:
            j = 3 + free + a
            at[j] = columns[whole(pairs[of + 1])]
            at[j + 1] = at[j] + 1
            H[a, j], H[a, j + 1], H[b, j + 1] = 1.0, pairs[of + 17], 1.0
        R[a, a], R[a, b], R[b, a], R[b, b] = pairs[of + 4], pairs[of + 5], pairs[of + 5], pairs[of + 6]
        if parts > 0:
            share(pairs, of, rows, i, shared, parts, G, a, R)
        a += 2


def share(pairs, of, rows, i, shared, parts, G, a, R):
    """Write what line i shares over rows a, a + 1 of G, and add it to R between them and those before.

    A line that is read as (-r, psi + pi) shares the r of the other sign.
    """
    side = 1.0 if cos(pairs[of + 18] - rows[LINE * i + 1]) > 0.0 else -1.0
    for k in range(parts):
        G[a, k], G[a + 1, k] = side * shared[2 * parts * i + k], shared[parts * (2 * i + 1) + k]
    for m in range(a, a + 2):
        for j in range(a):
            for k in range(parts):
                R[m, j] += G[m, k] * G[j, k]
            R[j, m] = R[m, j]


def extend(pairs, fate, lines, low, high, hits, seen, scan):
    """Let the map lines that were matched reach as far as the measured ones, and count them as seen in `scan`."""
    for i in range(lines):
        if fate[i] >= 0:
            at = PAIR * fate[i]
            j = whole(pairs[at + 1])
            low[j], high[j] = min(low[j], pairs[at + 12]), max(high[j], pairs[at + 13])
            hits[j] += 1
            seen[j] = scan


def bends(P, pairs, fate, lines, columns, rho, beta, most_rho, most_beta, at, missing):
    """Write by what variance the states of the lines that were seen bend, `most` of each, and which these are.

    A wall stays within its unevenness rho, beta (variances), so a line that is known no better is left alone.
    Returns how many states there are.
    """
    found = 0
    for i in range(lines):
        if fate[i] < 0:
            continue
        j, known = columns[whole(pairs[PAIR * fate[i] + 1])], 0
        while known < found and at[known] != j:
            known += 2
        if known < found:
            continue
        at[found], at[found + 1] = j, j + 1
        missing[found] = min(max(rho - P[j, j], 0.0), most_rho)
        missing[found + 1] = min(max(beta - P[j + 1, j + 1], 0.0), most_beta)
        found += 2
    return found


def lacks(P, columns, places, rho, beta, at, missing):
    """Write which states of the lines at `columns` (places,) vary by less than rho and beta, and by how much.

    First all offsets, then all angles. Returns how many there are.
    """
    found = 0
    for k in range(2):
        floor = beta if k else rho
        for i in range(places):
            j = columns[i] + k
            if floor - P[j, j] > 0.0:
                at[found], missing[found] = j, floor - P[j, j]
                found += 1
    return found
