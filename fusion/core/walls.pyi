from .arrays import Floats, Wholes

MAX_STRAY_BEAMS: int
MAX_CORNER_BEAMS: int
MAX_CORNER_SHARE: float
MIN_CORNER_SINE: float
FAR: float

def distance(x: Floats, y: Floats, i: int, j: int) -> float: ...
def long_enough(
    x: Floats,
    y: Floats,
    first: Wholes,
    bounds: Wholes,
    groups: int,
    min_points: float,
    min_length: float,
    m: Floats,
    start: Wholes,
    stop: Wholes,
) -> int: ...
def near(
    x: Floats,
    y: Floats,
    head: int,
    tail: int,
    next_head: int,
    next_tail: int,
    between: int,
    bridge: float,
    max_gap: float,
) -> bool: ...
def link_parts(
    x: Floats, y: Floats, start: Wholes, stop: Wholes, parts: int, bridge: float, max_gap: float, linked: Wholes
) -> None: ...
def close_ring(
    x: Floats,
    y: Floats,
    k: int,
    start: Wholes,
    stop: Wholes,
    bounds: Wholes,
    walls: int,
    m: Floats,
    bridge: float,
    max_gap: float,
    limit: float,
    room: Wholes,
) -> int: ...
def rotate(values: Wholes, n: int, by: int, room: Wholes) -> None: ...
def perpendicular_fit(m: Floats, walls: int, r: Floats, psi: Floats) -> None: ...
def corner_limits(
    d: Floats,
    x: Floats,
    y: Floats,
    k: int,
    start: Wholes,
    stop: Wholes,
    bounds: Wholes,
    walls: int,
    closed: bool,
    r: Floats,
    psi: Floats,
    sigma_range: float,
    sigma_angle: float,
    sigmas: float,
    max_gap: float,
    low: Floats,
    high: Floats,
) -> None: ...
def limit_end(
    x: Floats,
    y: Floats,
    head: int,
    tail: int,
    psi: float,
    corner: float,
    margin: float,
    i: int,
    low: Floats,
    high: Floats,
) -> None: ...
def limit_begin(
    x: Floats,
    y: Floats,
    head: int,
    tail: int,
    psi: float,
    corner: float,
    margin: float,
    i: int,
    low: Floats,
    high: Floats,
) -> None: ...
