"""Red things in an omni picture: its red pixels without lone ones, and what belongs together along the circle.

A vertical line of the world lies along a radius of the picture, so that a pixel is an angle, a radius and a level.
"""

from math import atan2, floor, pi, sqrt

# numbers of a thing: angle of its middle, pixels, length [px], width [rad], radius of its middle [px]
MEASURED = 5
NINE = 9  # a pixel and its neighbours


def things(g, n, out):
    """Write what the red pixels among n points show, out (k, MEASURED); return how many things these are.

    A thing has at least `g.fewest` pixels, which follow each other along the circle by no more than `g.gap` [px].
    """
    n = red_pixels(g, n)
    if n == 0 or n < g.fewest:
        return 0
    sort(g.theta, n, g.order, g.room)
    first = 0  # where the first gap ends: what lies before it goes on behind the last pixel
    if together(g, n - 1, 0, 2.0 * pi):
        while first < n - 1 and together(g, first, first + 1, 0.0):
            first += 1
        first = (first + 1) % n
    found, begin = 0, 0
    for i in range(n):
        at, after = (first + i) % n, (first + i + 1) % n
        if i == n - 1 or not together(g, at, after, 2.0 * pi if after == 0 else 0.0):
            if i + 1 - begin >= g.fewest and measure(g, first + begin, i + 1 - begin, n, out, found):
                found += 1
            begin = i + 1
    return found


def red_pixels(g, n):
    """Write angle, radius and level of the points that are red and not alone; return how many."""
    for k in range(n):
        i, j = g.points[k, 0], g.points[k, 1]
        if g.excess[j, i] < g.least[g.red[j, i]]:
            g.excess[j, i] = 0
    found = 0
    for k in range(n):
        i, j = g.points[k, 0], g.points[k, 1]
        if g.excess[j, i] > 0 and reds(g, j, i) > NINE // 2:  # the median of the nine is red too
            dx, dy = (i + g.left) - g.x_c, (j + g.top) - g.y_c
            g.theta[found], g.radius[found] = atan2(dx, dy), sqrt(dx * dx + dy * dy)
            g.level[found] = g.excess[j, i]
            g.edge[found] = on_edge(i + g.left, j + g.top, g.across, g.down)
            found += 1
    return found


def on_edge(x, y, across, down):
    """Return whether a pixel lies on the edge of a picture of so many pixels across and down."""
    return 1 if x == 0 or y == 0 or x == across - 1 or y == down - 1 else 0


def reds(g, j, i):
    """Return how many of a pixel and its neighbours are red; beyond the window the nearest counts."""
    found = 0
    for k in range(3):
        y = min(max(j + k - 1, 0), g.height - 1)
        for m in range(3):
            if g.excess[y, min(max(i + m - 1, 0), g.width - 1)] > 0:
                found += 1
    return found


def sort(values, n, order, room):
    """Write the order (n,) of values (n,) from the least up; equal ones keep theirs. `room` (n,) is scratch."""
    for i in range(n):
        order[i] = i
    size = 1
    while size < n:
        begin = 0
        while begin < n:
            merge_runs(values, begin, min(begin + size, n), min(begin + 2 * size, n), order, room)
            begin += 2 * size
        for i in range(n):
            order[i] = room[i]
        size *= 2


def merge_runs(values, begin, middle, end, order, room):
    """Write the two sorted runs begin:middle and middle:end of an order as one."""
    a, b = begin, middle
    for i in range(begin, end):
        if a < middle and (b >= end or values[order[a]] <= values[order[b]]):
            room[i] = order[a]
            a += 1
        else:
            room[i] = order[b]
            b += 1


def together(g, a, b, turn):
    """Return whether pixel b of the order, `turn` [rad] further round, follows pixel a without a gap."""
    p, q = g.order[a], g.order[b]
    return (g.theta[q] + turn - g.theta[p]) * 2.0 * (g.radius[q] + g.radius[p]) <= 4.0 * g.gap


def measure(g, begin, count, n, out, k):
    """Write the thing of so many pixels of the order from `begin` on; return whether anything is left of it."""
    pixels = whole_circles(g, begin, count, n)
    if pixels == 0:
        return False
    near = far = g.radius[g.room[0]]
    for i in range(pixels):
        r = g.radius[g.room[i]]
        near, far = min(near, r), max(far, r)
    radius = 0.5 * (near + far)
    if not radius > 0.0:  # a pixel on the axis
        return False
    length = circles(g, pixels, near, far)
    out[k, 0], out[k, 1], out[k, 2] = middle_of(g, pixels), pixels, length
    out[k, 3], out[k, 4] = pixels / (length * radius), radius
    return True


def whole_circles(g, begin, count, n):
    """Write the pixels of a thing to the room, without those on circles that the picture's edge cuts slantwise.

    Returns how many these are.
    """
    most, pixels = 1e9, 0  # px
    for i in range(count if g.cut else 0):
        p = g.order[(begin + i) % n]
        if g.edge[p]:
            most = min(most, g.radius[p] - 1.0)
    for i in range(count):
        p = g.order[(begin + i) % n]
        if g.radius[p] < most:
            g.room[pixels] = p
            pixels += 1
    return pixels


def circles(g, pixels, near, far):
    """Return on how many circles, a pixel wide, the pixels in the room lie."""
    for i in range(ring(near, far) + 1):
        g.rings[i] = 0
    found = 0.0
    for i in range(pixels):
        at = ring(near, g.radius[g.room[i]])
        if g.rings[at] == 0:
            g.rings[at] = 1
            found += 1.0
    return found


def ring(near, radius):
    """Return the circle that a radius lies on, counted from `near`."""
    return int(radius - near)


def middle_of(g, pixels):
    """Return the angle in [0, 2 pi) of the centre of weight of the pixels in the room, which may lie across pi.

    A pixel's weight is its level, at most three quarters of the mean: shading must not shift the middle.
    """
    total, weights, moment, first = 0.0, 0.0, 0.0, g.theta[g.room[0]]
    for i in range(pixels):
        total += g.level[g.room[i]]
    for i in range(pixels):
        p = g.room[i]
        weight, theta = min(g.level[p], 0.75 * (total / pixels)), g.theta[p]
        if theta < first:
            theta += 2.0 * pi
        weights += weight
        moment += weight * theta
    middle = moment / weights
    return middle - 2.0 * pi * floor(middle / (2.0 * pi))
