from .arrays import Floats, Matrix, Wholes

class Belief:
    x: Floats
    P: Matrix
    n: int
    frame: int
    def __init__(self, x: Floats, P: Matrix, n: int, frame: int) -> None: ...

class Scans:
    rows: Matrix
    first: Wholes
    when: Wholes
    scans: int
    shared: Floats
    parts: int
    verdict: Wholes
    landmark: Wholes
    told: Matrix
    joint: Matrix
    sights: Matrix
    def __init__(
        self,
        rows: Matrix,
        first: Wholes,
        when: Wholes,
        scans: int,
        shared: Floats,
        parts: int,
        verdict: Wholes,
        landmark: Wholes,
        told: Matrix,
        joint: Matrix,
        sights: Matrix,
    ) -> None: ...

class Walls:
    columns: Wholes
    anchors: Matrix
    low: Floats
    high: Floats
    hits: Wholes
    seen: Wholes
    born: Wholes
    ids: Wholes
    fixed: Floats
    width: int
    places: int
    states: bool
    def __init__(
        self,
        columns: Wholes,
        anchors: Matrix,
        low: Floats,
        high: Floats,
        hits: Wholes,
        seen: Wholes,
        born: Wholes,
        ids: Wholes,
        fixed: Floats,
        width: int,
        places: int,
        states: bool,
    ) -> None: ...

class Seat:
    told: Floats
    which: Wholes
    at: Wholes
    free: int
    def __init__(self, told: Floats, which: Wholes, at: Wholes, free: int) -> None: ...

class Rules:
    max_turn: float
    max_offset: float
    sigmas: float
    gate: float
    zone: float
    rival: float
    share: float
    longest: float
    unmatched: int
    ambiguous: int
    new: int
    watched: bool
    least: float
    well: float
    grows: bool
    joint: bool
    lone_d2: float
    lone_turn: float
    lone_offset: float
    tidy: int
    trial: int
    hits: int
    double_turn: float
    double_offset: float
    double_apart: float
    rolled: float
    turned: float
    floor: float
    floor_turn: float
    uneven: float
    uneven_turn: float
    bend: float
    bend_turn: float
    def __init__(
        self,
        max_turn: float,
        max_offset: float,
        sigmas: float,
        gate: float,
        zone: float,
        rival: float,
        share: float,
        longest: float,
        unmatched: int,
        ambiguous: int,
        new: int,
        watched: bool,
        least: float,
        well: float,
        grows: bool,
        joint: bool,
        lone_d2: float,
        lone_turn: float,
        lone_offset: float,
        tidy: int,
        trial: int,
        hits: int,
        double_turn: float,
        double_offset: float,
        double_apart: float,
        rolled: float,
        turned: float,
        floor: float,
        floor_turn: float,
        uneven: float,
        uneven_turn: float,
        bend: float,
        bend_turn: float,
    ) -> None: ...

class Way:
    follows: bool
    length: float
    x: float
    y: float
    ask_at: float
    origin_x: float
    origin_y: float
    reach: float
    most: int
    looks: bool
    sight_x: float
    sight_y: float
    sight_turn: float
    stride: float
    turn: float
    def __init__(
        self,
        follows: bool,
        length: float,
        x: float,
        y: float,
        ask_at: float,
        origin_x: float,
        origin_y: float,
        reach: float,
        most: int,
        looks: bool,
        sight_x: float,
        sight_y: float,
        sight_turn: float,
        stride: float,
        turn: float,
    ) -> None: ...

class Desk:
    raw: Matrix
    seated: Matrix
    rows: Floats
    wall_rows: Matrix
    walls: Floats
    mount: Floats
    place: Floats
    offset: Floats
    pose: Floats
    triangle: Floats
    seen: Floats
    pairs: Floats
    fate: Wholes
    order: Wholes
    shared: Floats
    at: Wholes
    H: Matrix
    G: Matrix
    R: Matrix
    y: Floats
    V: Matrix
    loose: Wholes
    missing: Floats
    located: Floats
    ray: Floats
    ray_row: Floats
    ray_at: Wholes
    def __init__(
        self,
        raw: Matrix,
        seated: Matrix,
        rows: Floats,
        wall_rows: Matrix,
        walls: Floats,
        mount: Floats,
        place: Floats,
        offset: Floats,
        pose: Floats,
        triangle: Floats,
        seen: Floats,
        pairs: Floats,
        fate: Wholes,
        order: Wholes,
        shared: Floats,
        at: Wholes,
        H: Matrix,
        G: Matrix,
        R: Matrix,
        y: Floats,
        V: Matrix,
        loose: Wholes,
        missing: Floats,
        located: Floats,
        ray: Floats,
        ray_row: Floats,
        ray_at: Wholes,
    ) -> None: ...

class Progress:
    instant: int
    why: int
    scan: int
    x: float
    y: float
    theta: float
    number: int
    well: int
    def __init__(
        self, instant: int, why: int, scan: int, x: float, y: float, theta: float, number: int, well: int
    ) -> None: ...

class Odometer:
    t: Floats
    twist: Matrix
    pose: Matrix
    rolled: Matrix
    silence: Matrix
    matched: Matrix
    readings: int
    track: float
    noise: float
    silent: bool
    matches: bool
    parameters: bool
    def __init__(
        self,
        t: Floats,
        twist: Matrix,
        pose: Matrix,
        rolled: Matrix,
        silence: Matrix,
        matched: Matrix,
        readings: int,
        track: float,
        noise: float,
        silent: bool,
        matches: bool,
        parameters: bool,
    ) -> None: ...

class Wheels:
    u: Matrix
    Q: Matrix
    dt: Floats
    drifting: Wholes
    drift: Floats
    drifts: int
    def __init__(self, u: Matrix, Q: Matrix, dt: Floats, drifting: Wholes, drift: Floats, drifts: int) -> None: ...

class Headings:
    when: Wholes
    z: Floats
    r: Floats
    usable: Wholes
    gate: float
    refused: float
    unused: float
    offset: float
    at: Wholes
    states: int
    told: Matrix
    readings: int
    due: int
    taken: int
    def __init__(
        self,
        when: Wholes,
        z: Floats,
        r: Floats,
        usable: Wholes,
        gate: float,
        refused: float,
        unused: float,
        offset: float,
        at: Wholes,
        states: int,
        told: Matrix,
        readings: int,
        due: int,
        taken: int,
    ) -> None: ...

class Bearings:
    when: Wholes
    first: Wholes
    z: Floats
    r: Floats
    told: Matrix
    x: float
    y: float
    nearest: float
    gate: float
    margin: float
    refused: float
    ambiguous: float
    unmatched: float
    seat: Seat
    readings: int
    due: int
    chosen: int
    def __init__(
        self,
        when: Wholes,
        first: Wholes,
        z: Floats,
        r: Floats,
        told: Matrix,
        x: float,
        y: float,
        nearest: float,
        gate: float,
        margin: float,
        refused: float,
        ambiguous: float,
        unmatched: float,
        seat: Seat,
        readings: int,
        due: int,
        chosen: int,
    ) -> None: ...

class Notes:
    room: Floats
    pose: Matrix
    triangle: Matrix
    columns: Wholes
    blocks: int
    values: Matrix
    def __init__(
        self, room: Floats, pose: Matrix, triangle: Matrix, columns: Wholes, blocks: int, values: Matrix
    ) -> None: ...
