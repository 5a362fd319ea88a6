"""Red things in an omni picture: its red pixels without lone ones, and what belongs together along the circle.

A vertical line of the world lies along a radius of the picture, so that a pixel is an angle, a radius and a level.
"""

from __future__ import annotations

from typing import Any

from locfuse.fusion.data import Array, Ints

from .arrays import floats, view, wholes

try:
    import cython
except ImportError:  # Cython is only needed to compile
    from . import uncompiled as cython
if not cython.compiled:
    from math import atan2, pi

    from .uncompiled import floor, sqrt

THING_NUMBERS = 5  # of a thing: angle of its middle, pixels, length [px], width [rad], radius of its middle [px]
MIN_RED_NEIGHBOURS = 5  # of a pixel and its eight neighbours: then the median of the nine is red too
MAX_GAP_PX = 2.0  # red pixels further apart than this, along the circle, belong to two things


class Window:
    """The part of a picture that holds the mirror: `left` and `top` are where it begins.

    `excess` (h, w) is red less the greater of green and blue, `red` (h, w) is red, and a pixel is red where the
    excess is at least `least` (256,) of its red.
    """

    def __init__(self, excess: Any, red: Any, least: Any, left: int, top: int) -> None:
        self.excess, self.red, self.least = view(excess, "uint8"), view(red, "uint8"), view(least, "uint8")
        self.left, self.top = left, top


class Circle:
    """The mirror's axis, at (x, y) of the picture, which is so many pixels across and down and may cut the mirror.

    `outer` is the mirror's radius [px].
    """

    def __init__(self, x: float, y: float, across: int, down: int, outer: float) -> None:
        self.x, self.y, self.across, self.down, self.outer = x, y, across, down, outer
        self.cut = outer > min(x, y, across - 1 - x, down - 1 - y)


class Pixels:
    """Red pixels, `count` of at most n: angle [rad], radius [px], level, and whether it is on the picture's edge.

    `order` is that of their angles. A thing has at least the `fewest` pixels; `chosen` are those of one thing.
    """

    def __init__(self, n: int, fewest: float, outer: float) -> None:
        self.count, self.fewest = 0, fewest
        self.theta, self.radius, self.level, self.edge = floats(n), floats(n), floats(n), wholes(n)
        self.order, self.chosen, self.rings = wholes(n), wholes(n), wholes(int(outer) + 2)


def find_things(window: Window, circle: Circle, points: Any, pixels: Pixels, out: Array) -> int:
    """Write what red pixels among the points (n, 2: x, y in the window) show, out (k, THING_NUMBERS); return k.

    The pixels of a thing follow each other along the circle by no more than MAX_GAP_PX.
    """
    find_red(window, circle, points, pixels)
    n = pixels.count
    if n == 0 or n < pixels.fewest:
        return 0
    sort(pixels.theta, n, pixels.order, pixels.chosen)
    first = 0  # where the first gap ends: what lies before it goes on behind the last pixel
    if together(pixels, n - 1, 0, 2.0 * pi):
        while first < n - 1 and together(pixels, first, first + 1, 0.0):
            first += 1
        first = (first + 1) % n
    found, begin = 0, 0
    for i in range(n):
        at, after = (first + i) % n, (first + i + 1) % n
        if i == n - 1 or not together(pixels, at, after, 2.0 * pi if after == 0 else 0.0):
            count = i + 1 - begin
            if count >= pixels.fewest and measure(pixels, circle, first + begin, count, out, found):
                found += 1
            begin = i + 1
    return found


def find_red(window: Window, circle: Circle, points: Any, pixels: Pixels) -> None:
    """Take the points that are red and not alone."""
    excess, found = window.excess, 0
    for k in range(points.shape[0]):
        i, j = points[k, 0], points[k, 1]
        if excess[j, i] < window.least[window.red[j, i]]:
            excess[j, i] = 0
    for k in range(points.shape[0]):
        i, j = points[k, 0], points[k, 1]
        if excess[j, i] > 0 and red_neighbours(window, i, j) >= MIN_RED_NEIGHBOURS:
            x, y = i + window.left, j + window.top
            dx, dy = x - circle.x, y - circle.y
            pixels.theta[found], pixels.radius[found] = atan2(dx, dy), sqrt(dx * dx + dy * dy)
            pixels.level[found] = excess[j, i]
            pixels.edge[found] = x == 0 or y == 0 or x == circle.across - 1 or y == circle.down - 1
            found += 1
    pixels.count = found


def red_neighbours(window: Window, x: int, y: int) -> int:
    """Return how many of a pixel and its neighbours are red; beyond the window the nearest counts."""
    found, height, width = 0, window.excess.shape[0], window.excess.shape[1]
    for k in range(3):
        row = min(max(y + k - 1, 0), height - 1)
        for m in range(3):
            if window.excess[row, min(max(x + m - 1, 0), width - 1)] > 0:
                found += 1
    return found


def sort(values: Array, n: int, order: Ints, room: Ints) -> None:
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


def merge_runs(values: Array, begin: int, middle: int, end: int, order: Ints, room: Ints) -> None:
    """Write the two sorted runs begin:middle and middle:end of an order as one."""
    a, b = begin, middle
    for i in range(begin, end):
        if a < middle and (b >= end or values[order[a]] <= values[order[b]]):
            room[i] = order[a]
            a += 1
        else:
            room[i] = order[b]
            b += 1


def together(pixels: Pixels, a: int, b: int, turn: float) -> bool:
    """Return whether pixel b of the order, `turn` [rad] further round, follows pixel a without a gap."""
    p, q = pixels.order[a], pixels.order[b]
    apart = (pixels.theta[q] + turn - pixels.theta[p]) * 2.0 * (pixels.radius[q] + pixels.radius[p])
    return apart <= 4.0 * MAX_GAP_PX


def measure(pixels: Pixels, circle: Circle, begin: int, count: int, out: Array, k: int) -> bool:
    """Write the thing of so many pixels of the order from `begin` on; return whether anything is left of it."""
    left = choose_whole_circles(pixels, circle.cut, begin, count)
    if left == 0:
        return False
    near = far = pixels.radius[pixels.chosen[0]]
    for i in range(left):
        r = pixels.radius[pixels.chosen[i]]
        near, far = min(near, r), max(far, r)
    radius = 0.5 * (near + far)
    if not radius > 0.0:  # a pixel on the axis
        return False
    length = circles(pixels, left, near, far)
    out[k, 0], out[k, 1], out[k, 2] = middle_of(pixels, left), left, length
    out[k, 3], out[k, 4] = left / (length * radius), radius
    return True


def choose_whole_circles(pixels: Pixels, cut: bool, begin: int, count: int) -> int:
    """Choose the pixels of a thing, without those on circles that the picture's edge cuts slantwise.

    Returns how many these are.
    """
    most, left = 1e9, 0  # px
    if cut:
        for i in range(count):
            p = pixels.order[(begin + i) % pixels.count]
            if pixels.edge[p]:
                most = min(most, pixels.radius[p] - 1.0)
    for i in range(count):
        p = pixels.order[(begin + i) % pixels.count]
        if pixels.radius[p] < most:
            pixels.chosen[left] = p
            left += 1
    return left


def circles(pixels: Pixels, count: int, near: float, far: float) -> float:
    """Return on how many circles, a pixel wide, the chosen pixels lie."""
    for i in range(ring(near, far) + 1):
        pixels.rings[i] = 0
    found = 0.0
    for i in range(count):
        at = ring(near, pixels.radius[pixels.chosen[i]])
        if pixels.rings[at] == 0:
            pixels.rings[at] = 1
            found += 1.0
    return found


def ring(near: float, radius: float) -> int:
    """Return the circle that a radius lies on, counted from `near`."""
    return int(radius - near)


def middle_of(pixels: Pixels, count: int) -> float:
    """Return the angle in [0, 2 pi) of the centre of weight of the chosen pixels, which may lie across pi.

    A pixel's weight is its level, at most three quarters of the mean: shading must not shift the middle.
    """
    total, weights, moment, first = 0.0, 0.0, 0.0, pixels.theta[pixels.chosen[0]]
    for i in range(count):
        total += pixels.level[pixels.chosen[i]]
    for i in range(count):
        p = pixels.chosen[i]
        weight, theta = min(pixels.level[p], 0.75 * (total / count)), pixels.theta[p]
        if theta < first:
            theta += 2.0 * pi
        weights += weight
        moment += weight * theta
    middle = moment / weights
    return middle - 2.0 * pi * floor(middle / (2.0 * pi))
