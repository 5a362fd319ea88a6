"""A floor of 160 x 100 m as a scenario: python -m benchmarks.campus > campus.toml.

There are three corridors in each direction, 2.4 m wide, with rooms on both sides; doors are closed, ajar or open.
The first loop is half a kilometre long, and the drive 1.4 km: more than in any shipped building.
"""

import random
from collections.abc import Iterator, Sequence
from itertools import pairwise

import tomli_w

Table = dict[str, object]
SIZE = (160.0, 100.0)  # m
EASTWARD, NORTHWARD = (8.0, 50.0, 90.0), (8.0, 80.0, 150.0)  # m: south and west edges of the corridors
WIDTH, DEPTH = 2.4, 5.5  # m of a corridor, of the rooms beside it
ROOMS = (3.5, 9.0)  # m along the corridor
# crossings of the corridors, column and row, one after another
TOUR = "00 20 22 02 00 10 12 02 01 21 20 00 01 11 10 20 21 11"


def scenario() -> str:
    points = [[NORTHWARD[int(at[0])] + 0.5 * WIDTH, EASTWARD[int(at[1])] + 0.5 * WIDTH] for at in TOUR.split()]
    laser = {"rate": 5.0, "phase": 0.031, "beams": 181, "field_of_view_deg": 180.0, "duration": 0.0133}
    tables: Table = {
        "title": "A floor of 160 x 100 m: corridors that form loops of 500 m",
        "control": {"estimator": "truth", "speed": 0.8, "wait": 4.0, "clearance": 0.32, "time_limit": 4000.0},
        "wheels": {"radius": 0.075, "track": 0.5, "noise": 4e-4},
        "lrf": laser | {"range_min": 0.1, "range_max": 30.0, "sigma_range": 0.02, "lost": 0.005},
        "camera": {"enabled": False},
        "compass": {"rate": 10.0, "noise_deg": 1.0},
        "truth": {"rate": 10.0},
        "landmark": {"x": SIZE[0] - 1.0, "y": 15.0, "radius": 0.1},
        "room": {"size": list(SIZE)},
        "path": {"kind": "waypoints", "radius": 0.7, "points": points},
        "building": {"bow": 0.02, "spaces": [*corridors(), *rooms(random.Random(0))]},
    }
    return tomli_w.dumps(tables)


def corridors() -> Iterator[Table]:
    for y in EASTWARD:
        yield {"name": f"eastward {y:g}", "area": [NORTHWARD[0], y, NORTHWARD[-1] + WIDTH, y + WIDTH]}
    for x in NORTHWARD:
        yield {"name": f"northward {x:g}", "area": [x, EASTWARD[0], x + WIDTH, EASTWARD[-1] + WIDTH]}


def rooms(rng: random.Random) -> Iterator[Table]:
    """Yield the rooms beside the corridors as spaces; those in the corners open to the east and the west."""
    for y in EASTWARD:
        for begin, end in along(NORTHWARD, 0.0, rng):
            for side, south in (("south", y + WIDTH), ("north", y - DEPTH)):
                if south + DEPTH < SIZE[1]:
                    yield room([begin, south, end, south + DEPTH], side, (begin, end), rng)
    for x in NORTHWARD:
        for begin, end in along(EASTWARD, DEPTH, rng):
            for side, west in (("west", x + WIDTH), ("east", x - DEPTH)):
                if west + DEPTH < SIZE[0]:
                    yield room([west, begin, west + DEPTH, end], side, (begin, end), rng)


def along(crossings: Sequence[float], free: float, rng: random.Random) -> Iterator[tuple[float, float]]:
    """Yield (from, to) of the rooms along a corridor, leaving `free` m beside crossing corridors."""
    for a, b in pairwise(crossings):
        begin, end = a + WIDTH + free, b - free
        while end - begin >= ROOMS[0]:
            to = begin + rng.uniform(*ROOMS)
            to = end if end - to < ROOMS[0] else to
            yield begin, to
            begin = to


def room(area: list[float], side: str, wall: tuple[float, float], rng: random.Random) -> Table:
    """Return a room (west, south, east, north) with furniture, and a door in its wall (from, to)."""
    door: Table = {"side": side, "at": rng.uniform(wall[0] + 0.9, wall[1] - 0.9)}
    kind = rng.random()
    if kind < 0.4:
        door["kind"] = "closed"
    elif kind < 0.8:
        door["leaf_deg"] = rng.uniform(40.0, 95.0)
    else:
        door["width"] = 1.4
    furniture = [piece(area, rng) for _ in range(rng.randrange(1, 5))]
    return {"name": f"room {area[0]:.1f} {area[1]:.1f}", "area": area, "openings": [door], "furniture": furniture}


def piece(area: list[float], rng: random.Random) -> Table:
    kind = rng.choice(("box", "table", "chair"))
    place = [rng.uniform(area[0] + 0.8, area[2] - 0.8), rng.uniform(area[1] + 0.8, area[3] - 0.8)]
    size = {} if kind == "chair" else {"size": [rng.uniform(0.5, 1.8), rng.uniform(0.4, 1.0)]}
    return {"kind": kind, "at": place, **size}


if __name__ == "__main__":
    print(scenario(), end="")
