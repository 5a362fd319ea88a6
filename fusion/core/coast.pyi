from .arrays import Floats, Matrix, Wholes
from .tables import Belief, Desk, Headings, Notes, Progress, Readings, Rest, Rules, Scans, Seat, Walls, Way, Wheels

DONE: int
BEFORE: int
AFTER: int

def coast(
    b: Belief,
    m: Wheels,
    r: Readings,
    s: Scans,
    w: Walls,
    seat: Seat,
    rule: Rules,
    rest: Rest,
    way: Way,
    d: Desk,
    notes: Notes,
    progress: Progress,
    last: int,
) -> float: ...
def is_due(when: Wholes, due: int, readings: int, k: int) -> bool: ...
def keep(b: Belief, r: Readings, k: int, d: Desk) -> None: ...
def roll(b: Belief, m: Wheels, progress: Progress, k: int) -> None: ...
def compare(b: Belief, r: Readings, w: Walls, d: Desk, k: int) -> float: ...
def turn(b: Belief, h: Headings, i: int, d: Desk) -> float: ...
def correct_by(
    b: Belief, s: Scans, scan: int, accepted: int, h: Headings, whole: bool, seat: Seat, rule: Rules, d: Desk
) -> float: ...
def add_heading(h: Headings, i: int, d: Desk, m: int, width: int) -> None: ...
def correct_in_frame(b: Belief, V: Matrix, e: Floats, m: int) -> None: ...
def note(
    x: Floats,
    P: Matrix,
    frame: int,
    room: Floats,
    k: int,
    pose: Matrix,
    triangle: Matrix,
    columns: Wholes,
    blocks: int,
    values: Matrix,
) -> None: ...
