from collections.abc import Callable

from .arrays import Floats, Wholes

MAX_TURN: float
MIN_RATIO: float

def extract(
    floats: Callable[[int], Floats],
    wholes: Callable[[int], Wholes],
    scans: int,
    beams: int,
    ranges: Floats,
    cos_: Floats,
    sin_: Floats,
    x0: Floats,
    y0: Floats,
    stride: int,
    growth: Floats,
    ring: Wholes,
    low: float,
    high: float,
    settings: Floats,
    share: Floats,
    slips: int,
    counts: Wholes,
    hidden: Wholes,
    out: Floats,
    loads: Floats,
) -> int: ...
def fit(
    d: Floats,
    ux: Floats,
    uy: Floats,
    ox: Floats,
    oy: Floats,
    row: Wholes,
    n: int,
    begin: float,
    end: float,
    e: Floats,
    q: Floats,
    w: Floats,
    sums: Floats,
    r: float,
    psi: float,
    settings: Floats,
    out: Floats,
    line: int,
) -> int: ...
def finish(
    ux: Floats,
    uy: Floats,
    ox: Floats,
    oy: Floats,
    row: Wholes,
    n: int,
    sums: Floats,
    r: float,
    psi: float,
    settings: Floats,
    out: Floats,
    line: int,
) -> bool: ...
def loadings(
    row: Wholes,
    n: int,
    beam: Wholes,
    beams: int,
    q: Floats,
    w: Floats,
    sums: Floats,
    psi: float,
    motion: Floats,
    share: Floats,
    slips: int,
    loads: Floats,
    line: int,
) -> None: ...
