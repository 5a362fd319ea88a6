from .arrays import Floats
from .tables import Belief, Desk, Fixes

FIX: int

def fix(
    x: float,
    y: float,
    theta: float,
    lever_x: float,
    lever_y: float,
    from_x: float,
    from_y: float,
    tie: Floats,
    known: bool,
    out: Floats,
) -> None: ...
def locate_fix(b: Belief, f: Fixes, i: int, d: Desk) -> float: ...
