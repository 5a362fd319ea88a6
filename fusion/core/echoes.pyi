from .arrays import Floats
from .tables import Belief, Desk, Echoes, Walls

OVERHANG: float
CLEAR: float
CLUTTER: float
SQUARE: float
FAR: float
ECHO: int

def answering(
    x: Floats,
    w: Walls,
    px: float,
    py: float,
    theta: float,
    lever_x: float,
    lever_y: float,
    yaw: float,
    half: float,
    widen: float,
    sigma: float,
    out: Floats,
) -> int: ...
def rho_of(x: Floats, w: Walls, j: int) -> float: ...
def beta_of(x: Floats, w: Walls, j: int) -> float: ...
def slanted(w: Walls, j: int, distance: float, foot: float, off: float, half: float) -> float: ...
def likelier(distance: float, sigma: float) -> float: ...
def hear(b: Belief, w: Walls, e: Echoes, i: int, d: Desk) -> float: ...
