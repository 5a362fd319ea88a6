from .arrays import Floats, Matrix, Wholes

def worthless(hits: Wholes, born: Wholes, j: int, scan: int, least: int, trial: int) -> bool: ...
def one_wall(
    rows: Matrix, low: Floats, high: Floats, i: int, j: int, angle: float, offset: float, apart: float
) -> bool: ...
def neighbours(
    rows: Matrix,
    low: Floats,
    high: Floats,
    places: int,
    i: int,
    angle: float,
    offset: float,
    apart: float,
    found: Wholes,
) -> int: ...
