from .arrays import Floats, Matrix

KNOWN: int

def into_base(rows: Matrix, lines: int, x: float, y: float, yaw: float, out: Matrix) -> None: ...
def moved(place: Floats, told: Floats, out: Floats) -> None: ...
def shares_into_base(
    rows: Matrix, lines: int, parts: int, x: float, y: float, yaw: float, shared: Floats, first: int, out: Floats
) -> None: ...
def behind(
    rows: Matrix,
    lines: int,
    samples: int,
    walls: Matrix,
    m: int,
    x: float,
    y: float,
    theta: float,
    both: bool,
    near: float,
    margin: float,
    grazing: float,
    normal: Matrix,
    out: Floats,
) -> None: ...
def normals(walls: Matrix, m: int, normal: Matrix) -> None: ...
def blocked(
    walls: Matrix,
    m: int,
    normal: Matrix,
    x: float,
    y: float,
    dx: float,
    dy: float,
    reach: float,
    both: bool,
    margin: float,
    grazing: float,
) -> bool: ...
def explained(
    poses: Matrix,
    h: int,
    rows: Matrix,
    lines: int,
    walls: Matrix,
    m: int,
    angle: float,
    offset: float,
    overlap: float,
    normal: Matrix,
    out: Matrix,
) -> None: ...
def likeness(
    poses: Matrix,
    p: int,
    rows: Matrix,
    i: int,
    walls: Matrix,
    m: int,
    angle: float,
    offset: float,
    least: float,
    normal: Matrix,
) -> int: ...
def hypotheses(
    rows: Matrix, a: int, b: int, walls: Matrix, m: int, parallel: float, normal: Matrix, found: int, poses: Matrix
) -> int: ...
def against(walls: Matrix, j: int, normal: Matrix) -> float: ...
