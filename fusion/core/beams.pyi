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
