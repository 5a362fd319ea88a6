from .arrays import Floats, Wholes

LEAST_TURN: float
MOST_TURN: float
SHADOW: float
SURE: float
SPARED: float
STRAIGHT: float
LEAST_PIECES: int

def following(walls: int, closed: bool, i: int) -> int: ...
def joints(
    x: Floats,
    y: Floats,
    start: Wholes,
    stop: Wholes,
    bounds: Wholes,
    walls: int,
    closed: bool,
    psi: Floats,
    joint: Floats,
) -> int: ...
def curvature_of(joint: Floats, walls: int, closed: bool, i: int) -> float: ...
def gain(
    d: Floats,
    ux: Floats,
    uy: Floats,
    ox: Floats,
    oy: Floats,
    row: Wholes,
    n: int,
    r: float,
    psi: float,
    ratio: float,
    variance: float,
    bent: float,
    e: Floats,
    q: Floats,
    w: Floats,
    sums: Floats,
) -> float: ...
def goes_on(joint: Floats, gains: Floats, walls: int, closed: bool, i: int, step: int, sums: Floats) -> None: ...
def is_piece(
    joint: Floats, gains: Floats, walls: int, closed: bool, i: int, length: float, sums: Floats
) -> bool: ...
def find_curves(
    d: Floats,
    ux: Floats,
    uy: Floats,
    ox: Floats,
    oy: Floats,
    x: Floats,
    y: Floats,
    start: Wholes,
    stop: Wholes,
    bounds: Wholes,
    walls: int,
    closed: bool,
    r: Floats,
    psi: Floats,
    ratio: float,
    variance: float,
    row: Wholes,
    e: Floats,
    q: Floats,
    w: Floats,
    sums: Floats,
    joint: Floats,
    gains: Floats,
    curved: Wholes,
) -> None: ...
