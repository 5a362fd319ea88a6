from .arrays import Floats, Matrix, Wholes
from .tables import Bearings, Belief, Desk, Headings, Notes, Progress, Rules, Scans, Seat, Walls, Way, Wheels

HEARD: int
DONE: int
BEFORE: int
AFTER: int

def coast(
    b: Belief,
    m: Wheels,
    h: Headings,
    g: Bearings,
    s: Scans,
    w: Walls,
    seat: Seat,
    rule: Rules,
    way: Way,
    d: Desk,
    notes: Notes,
    progress: Progress,
    last: int,
) -> float: ...
def roll(b: Belief, m: Wheels, progress: Progress, k: int) -> None: ...
def compare(b: Belief, h: Headings, g: Bearings, d: Desk, k: int) -> float: ...
def turn(b: Belief, h: Headings, i: int, d: Desk) -> float: ...
def correct_by(
    b: Belief, s: Scans, scan: int, accepted: int, h: Headings, g: Bearings, seat: Seat, rule: Rules, d: Desk
) -> float: ...
def add_heading(h: Headings, i: int, d: Desk, m: int, width: int) -> None: ...
def add_bearing(d: Desk, states: int, m: int, width: int) -> None: ...
def make_room(d: Desk, m: int, width: int, states: int) -> None: ...
def note_fit(joint: Matrix, scan: int, e: Floats, m: int) -> None: ...
def correct_in_frame(x: Floats, P: Matrix, n: int, frame: int, V: Matrix, e: Floats, m: int) -> None: ...
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
