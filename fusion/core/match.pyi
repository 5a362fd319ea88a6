from .arrays import Floats, Matrix, Wholes

LINE: int
TOLD: int
COMMON: float

def match(
    pairs: Floats,
    found: int,
    rows: Floats,
    lines: int,
    gate: float,
    zone: float,
    rival: float,
    share: float,
    longest: float,
    fate: Wholes,
    order: Wholes,
) -> None: ...
def claim(pairs: Floats, lines: int, fate: Wholes, order: Wholes) -> None: ...
def overlap(pairs: Floats, a: int, b: int) -> bool: ...
def fits_well(pairs: Floats, at: int, rows: Floats, i: int, gate: float, share: float, longest: float) -> bool: ...
def whole(number: float) -> int: ...
def matched_share(rows: Floats, lines: int, fate: Wholes) -> float: ...
def judge(
    pairs: Floats,
    fate: Wholes,
    lines: int,
    ids: Wholes,
    unmatched: int,
    ambiguous: int,
    new: int,
    first: int,
    verdicts: Wholes,
    landmarks: Wholes,
    told: Matrix,
) -> int: ...
def refuse_alone(pairs: Floats, lines: int, fate: Wholes, d2: float, turn: float, offset: float) -> None: ...
def is_new(fate: Wholes, lines: int, i: int) -> bool: ...
def equation(
    pairs: Floats,
    fate: Wholes,
    row: int,
    lines: int,
    columns: Wholes,
    states: bool,
    mount: Floats,
    free: int,
    at_mount: Wholes,
    rows: Floats,
    shared: Floats,
    parts: int,
    at: Wholes,
    H: Matrix,
    G: Matrix,
    R: Matrix,
    y: Floats,
) -> None: ...
def share(
    pairs: Floats, of: int, rows: Floats, i: int, shared: Floats, parts: int, G: Matrix, a: int, R: Matrix
) -> None: ...
def extend(
    pairs: Floats, fate: Wholes, lines: int, low: Floats, high: Floats, hits: Wholes, seen: Wholes, scan: int
) -> None: ...
def bends(
    P: Matrix,
    pairs: Floats,
    fate: Wholes,
    lines: int,
    columns: Wholes,
    rho: float,
    beta: float,
    most_rho: float,
    most_beta: float,
    at: Wholes,
    missing: Floats,
) -> int: ...
def lacks(
    P: Matrix, columns: Wholes, places: int, rho: float, beta: float, at: Wholes, missing: Floats
) -> int: ...
