from .arrays import Floats, Matrix, Wholes

WALL: int
PAIR: int
FACE_SIGMAS: float
MAX_ANGLE: float
NOWHERE: float

def gather_walls(
    x: Floats, P: Matrix, columns: Wholes, anchors: Matrix, places: int, at: Wholes, free: int, walls: Matrix
) -> None: ...
def gather_mount(P: Matrix, at: Wholes, free: int, mount: Floats) -> None: ...
def predict(walls: Floats, width: int, places: int, pose: Floats, seen: Floats) -> None: ...
def pairs(
    rows: Floats,
    lines: int,
    walls: Floats,
    width: int,
    low: Floats,
    high: Floats,
    places: int,
    states: bool,
    pose: Floats,
    P: Floats,
    mount: Floats,
    free: int,
    max_turn: float,
    max_offset: float,
    sigmas: float,
    limit: float,
    seen: Floats,
    out: Floats,
) -> int: ...
def spread(
    rows: Floats,
    i: int,
    walls: Floats,
    width: int,
    j: int,
    states: bool,
    pose: Floats,
    P: Floats,
    mount: Floats,
    free: int,
    side: float,
    seen: Floats,
    out: Floats,
    at: int,
) -> None: ...
def seat(walls: Floats, w: int, mount: Floats, free: int, out: Floats, at: int) -> None: ...
def lever(mount: Floats, a: int, c: float, s: float) -> float: ...
def fits(distance: float, limit: float, out: Floats, at: int) -> bool: ...
def extent(
    rows: Floats,
    i: int,
    walls: Floats,
    width: int,
    j: int,
    pose: Floats,
    side: float,
    low: Floats,
    high: Floats,
    out: Floats,
    at: int,
) -> None: ...
