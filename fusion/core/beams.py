"""The returns of one laser scan, in an order in which no wall is cut in two by chance, cut at gaps."""

GAP = 1e9  # above every range [m]: beams behind a gap come before beams without one


def gather(ranges, cos, sin, x0, y0, scan, column, beams, begin, low, high, d, ux, uy, ox, oy, x, y, beam):
    """Gather the returns of scan number `scan`, from beam `begin` once round; return how many there are.

    A return is a range [m] in [low, high). Beam j starts at (x0, y0)[column + j] and points along (cos, sin).
    Written are range d [m], direction u, origin o [m], end point (x, y) [m] and which beam it is.
    """
    k = 0
    for i in range(beams):
        j = i + begin
        if j >= beams:
            j -= beams
        reading = ranges[scan * beams + j]
        if low <= reading < high:
            d[k] = reading
            ux[k] = cos[column + j]
            uy[k] = sin[column + j]
            ox[k] = x0[column + j]
            oy[k] = y0[column + j]
            x[k] = ox[k] + reading * ux[k]
            y[k] = oy[k] + reading * uy[k]
            beam[k] = j
            k += 1
    return k


def gap(dx, dy, d, before, growth, max_gap):
    """Return the squared distance of two neighbouring end points in units of what one wall allows.

    That is `max_gap` [m] > 0, or `growth` times the larger range: beam spacings grow with the range and, on a wall
    seen flat, with the angle of incidence.
    """
    limit = growth * (d if d > before else before)
    if limit < max_gap:
        limit = max_gap
    return (dx * dx + dy * dy) / (limit * limit)


def ring_start(d, x, y, k, growth, max_gap):
    """Return which return of a scan of the whole circle is its best first one.

    The one behind the widest gap; where there is none, the farthest, and then -1 - it: the ring is closed.
    """
    best = -1.0
    start = 0
    for i in range(k):
        before = i - 1 if i > 0 else k - 1
        jump = gap(x[i] - x[before], y[i] - y[before], d[i], d[before], growth, max_gap)
        score = GAP + jump if jump > 1.0 else d[i]
        if score > best:
            best = score
            start = i
    return start if best >= GAP else -1 - start


def cut_at_gaps(d, x, y, k, growth, max_gap, first):
    """Write where runs of neighbouring returns begin, `first` (runs + 1), and return how many there are."""
    runs = 0
    for i in range(k):
        if i == 0 or gap(x[i] - x[i - 1], y[i] - y[i - 1], d[i], d[i - 1], growth, max_gap) > 1.0:
            first[runs] = i
            runs += 1
    first[runs] = k
    return runs
