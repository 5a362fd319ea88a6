from .arrays import Floats, Matrix
from .tables import Bearings, Belief, Desk

RAY: int

def bearing(
    pose: Floats, to_x: float, to_y: float, x: float, y: float, yaw: float, nearest: float, out: Floats
) -> bool: ...
def sight(b: Belief, g: Bearings, i: int, d: Desk) -> float: ...
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
