from .arrays import Floats, Wholes

GAP: float

def gather(
    ranges: Floats,
    cos: Floats,
    sin: Floats,
    x0: Floats,
    y0: Floats,
    scan: int,
    column: int,
    beams: int,
    begin: int,
    low: float,
    high: float,
    d: Floats,
    ux: Floats,
    uy: Floats,
    ox: Floats,
    oy: Floats,
    x: Floats,
    y: Floats,
    beam: Wholes,
) -> int: ...
def gap(dx: float, dy: float, d: float, before: float, growth: float, max_gap: float) -> float: ...
def ring_start(d: Floats, x: Floats, y: Floats, k: int, growth: float, max_gap: float) -> int: ...
def cut_at_gaps(d: Floats, x: Floats, y: Floats, k: int, growth: float, max_gap: float, first: Wholes) -> int: ...

NONE: float

def tolerances(
    d: Floats, k: int, sigma_range: float, sigma_angle: float, sigmas: float, floor: float, tolerance: Floats
) -> None: ...
def farthest(x: Floats, y: Floats, tolerance: Floats, begin: int, end: int) -> int: ...
def split(
    x: Floats,
    y: Floats,
    tolerance: Floats,
    runs: int,
    run_first: Wholes,
    todo: Wholes,
    first: Wholes,
    linked: Wholes,
) -> int: ...
def moments(
    d: Floats,
    ux: Floats,
    uy: Floats,
    x: Floats,
    y: Floats,
    first: Wholes,
    pieces: int,
    sigma_range: float,
    sigma_angle: float,
    flatness: float,
    m: Floats,
) -> None: ...
def misfit(w: float, sx: float, sy: float, sxx: float, sxy: float, syy: float) -> float: ...
def joint_misfit(m: Floats, i: int, j: int) -> float: ...
def join(m: Floats, i: int, j: int) -> None: ...
def own_misfit(m: Floats, i: int) -> float: ...
def merge(
    m: Floats,
    pieces: int,
    linked: Wholes,
    limit: float,
    own: Floats,
    cost: Floats,
    after: Wholes,
    before: Wholes,
    best: Wholes,
    bounds: Wholes,
) -> int: ...
def cheapest(cost: Floats, after: Wholes, before: Wholes, pieces: int, limit: float, best: Wholes) -> int: ...
def join_pairs(
    m: Floats, own: Floats, cost: Floats, after: Wholes, before: Wholes, best: Wholes, chosen: int
) -> None: ...
def renew_cost(m: Floats, own: Floats, cost: Floats, after: Wholes, i: int) -> None: ...
def compact(m: Floats, after: Wholes, pieces: int, bounds: Wholes) -> int: ...
