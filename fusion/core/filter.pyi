from .arrays import Floats, Matrix, Wholes

AT_ONCE: int
FINE: float

def move(
    x: Floats,
    P: Matrix,
    n: int,
    ux: float,
    uy: float,
    turn: float,
    qxx: float,
    qxy: float,
    qxt: float,
    qyy: float,
    qyt: float,
    qtt: float,
    J: Matrix,
    k: int,
    first: int,
    states: int,
) -> None: ...
def whiten(
    P: Matrix, n: int, at: Wholes, states: int, H: Matrix, S: Matrix, y: Floats, m: int, V: Matrix
) -> float: ...
def projected(P: Matrix, n: int, at: Wholes, states: int, H: Matrix, S: Matrix, m: int, V: Matrix) -> float: ...
def factor(S: Matrix, m: int) -> bool: ...
def correct(x: Floats, P: Matrix, n: int, V: Matrix, e: Floats, m: int) -> None: ...
def consider(x: Floats, P: Matrix, n: int, V: Matrix, e: Floats, m: int, kept: Wholes) -> None: ...
def mirror(P: Matrix, i: int, first: int, n: int, least: float) -> None: ...
def take_in(
    x: Floats,
    P: Matrix,
    n: int,
    at: Wholes,
    states: int,
    H: Matrix,
    R: Matrix,
    y: Floats,
    m: int,
    V: Matrix,
    kept: Wholes,
    some: bool,
) -> float: ...
def locate(x: Floats, P: Matrix, first: int, out: Floats) -> None: ...
def by_local(x: Floats, first: int, by_x: float, by_y: float, by_theta: float, row: Floats) -> int: ...
def bent(tt: float) -> float: ...
def swing(P: Matrix, n: int, first: int, dx: float, dy: float) -> None: ...
def keep_heading(x: Floats, P: Matrix, n: int, column: int, behind: float) -> None: ...
def keep_pose(x: Floats, P: Matrix, n: int, column: int) -> None: ...
