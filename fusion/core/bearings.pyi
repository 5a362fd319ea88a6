from .arrays import Floats, Matrix, Wholes
from .tables import Bearings, Belief, Desk

POINTED: int
RAY: int

def bearing(
    pose: Floats, to_x: float, to_y: float, x: float, y: float, yaw: float, nearest: float, out: Floats
) -> bool: ...
def sight(b: Belief, g: Bearings, i: int, d: Desk) -> float: ...
def derive(b: Belief, by_x: float, by_y: float, by_theta: float, d: Desk) -> int: ...
def quadratic(P: Matrix, at: Wholes, row: Floats, states: int) -> float: ...
def judge_each(g: Bearings, i: int, predicted: float, variance: float, more: float) -> float: ...
def choose(
    told: Matrix,
    first: int,
    last: int,
    gate: float,
    margin: float,
    refused: float,
    ambiguous: float,
    unmatched: float,
) -> int: ...
