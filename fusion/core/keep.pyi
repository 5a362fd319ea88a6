from .arrays import Floats, Matrix, Wholes

def extend(
    pairs: Floats, fate: Wholes, lines: int, low: Floats, high: Floats, hits: Wholes, seen: Wholes, scan: int
) -> None: ...
def lacks(
    P: Matrix, columns: Wholes, places: int, rho: float, beta: float, at: Wholes, missing: Floats
) -> int: ...
