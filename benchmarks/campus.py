"""A floor of 160 x 100 m as a scenario: python -m benchmarks.campus -o campus.toml --seed 0.

    python -m benchmarks.simulated_building --scenario campus.toml --drives 2

Three corridors each way, of 2.4 m, with rooms on both sides whose doors are closed, ajar or open. The first loop
is half a kilometre long and the drive 0.9 or 1.4 km: what no shipped building asks of a map. Another seed is
another floor; odd ones are driven another way round.
"""

from __future__ import annotations

import random
from collections.abc import Iterator, Sequence
from itertools import pairwise
from pathlib import Path

import click
import tomli_w

Table = dict[str, object]
SIZE = (160.0, 100.0)  # m
EASTWARD, NORTHWARD = (8.0, 50.0, 90.0), (8.0, 80.0, 150.0)  # m: south and west edges of the corridors
WIDTH, DEPTH = 2.4, 5.5  # m of a corridor, of the rooms beside it
ROOMS = (3.5, 9.0)  # m along the corridor
# crossings of the corridors, column and row, one after another
TOURS = (
    "00 20 22 02 00 10 12 02 01 21 20 00 01 11 10 20 21 11",
    "11 12 22 20 10 11 01 00 20 21 01 02 22",
)
LASER: Table = {  # 180 degrees, 30 m
    "rate": 5.0,
    "phase": 0.031,
    "beams": 181,
    "field_of_view_deg": 180.0,
    "duration": 0.0133,
    "range_min": 0.1,
    "range_max": 30.0,
    "sigma_range": 0.02,
    "lost": 0.005,
}
Area = tuple[float, float, float, float]  # m: west, south, east, north


def scenario(seed: int) -> Table:
    """Return a floor and a drive through it as the tables of a scenario."""
    tour = TOURS[seed % len(TOURS)].split()
    points = [[NORTHWARD[int(at[0])] + 0.5 * WIDTH, EASTWARD[int(at[1])] + 0.5 * WIDTH] for at in tour]
    return {
        "title": f"A floor of 160 x 100 m (seed {seed}): corridors that form loops of 500 m",
        "control": {"estimator": "truth", "speed": 0.8, "wait": 4.0, "clearance": 0.32, "time_limit": 4000.0},
        "wheels": {"radius": 0.075, "track": 0.5, "noise": 4e-4},
        "lrf": LASER,
        "camera": {"enabled": False},
        "compass": {"rate": 10.0, "noise_deg": 1.0},
        "truth": {"rate": 10.0},
        "landmark": {"x": SIZE[0] - 1.0, "y": 15.0, "radius": 0.1},
        "room": {"size": list(SIZE)},
        "path": {"kind": "waypoints", "radius": 0.7, "points": points},
        "building": {"bow": 0.02, "spaces": [*corridors(), *rooms(random.Random(seed))]},
    }


def corridors() -> Iterator[Table]:
    """Yield the corridors as spaces."""
    west, east = NORTHWARD[0], NORTHWARD[-1] + WIDTH
    south, north = EASTWARD[0], EASTWARD[-1] + WIDTH
    for y in EASTWARD:
        yield {"name": f"eastward {y:g}", "area": [west, y, east, y + WIDTH]}
    for x in NORTHWARD:
        yield {"name": f"northward {x:g}", "area": [x, south, x + WIDTH, north]}


def rooms(rng: random.Random) -> Iterator[Table]:
    """Yield the rooms beside the corridors as spaces; those in the corners open to the east and the west."""
    for y in EASTWARD:
        for begin, end in along(NORTHWARD, 0.0, rng):
            if y + WIDTH + DEPTH < SIZE[1]:
                yield room((begin, y + WIDTH, end, y + WIDTH + DEPTH), "south", (begin, end), rng)
            yield room((begin, y - DEPTH, end, y), "north", (begin, end), rng)
    for x in NORTHWARD:
        for begin, end in along(EASTWARD, DEPTH, rng):
            if x + WIDTH + DEPTH < SIZE[0]:
                yield room((x + WIDTH, begin, x + WIDTH + DEPTH, end), "west", (begin, end), rng)
            yield room((x - DEPTH, begin, x, end), "east", (begin, end), rng)


def along(crossings: Sequence[float], free: float, rng: random.Random) -> Iterator[tuple[float, float]]:
    """Yield (from, to) of the rooms along a corridor, but for `free` m beside the corridors that cross it."""
    for a, b in pairwise(crossings):
        yield from cut(a + WIDTH + free, b - free, rng)


def cut(begin: float, end: float, rng: random.Random) -> Iterator[tuple[float, float]]:
    """Cut a stretch of corridor into rooms."""
    least = ROOMS[0]
    while end - begin >= least:
        to = begin + rng.uniform(*ROOMS)
        if end - to < least:
            to = end
        yield begin, to
        begin = to


def room(area: Area, side: str, wall: tuple[float, float], rng: random.Random) -> Table:
    """Return a room with furniture, and a door in the wall (from, to) to its corridor."""
    door: Table = {"side": side, "at": rng.uniform(wall[0] + 0.9, wall[1] - 0.9)}
    kind = rng.random()
    if kind < 0.4:
        door["kind"] = "closed"
    elif kind < 0.8:
        door["leaf_deg"] = rng.uniform(40.0, 95.0)
    else:
        door["width"] = 1.4
    furniture = [piece(area, rng) for _ in range(rng.randrange(1, 5))]
    name = f"room {area[0]:.1f} {area[1]:.1f}"
    return {"name": name, "area": list(area), "openings": [door], "furniture": furniture}


def piece(area: Area, rng: random.Random) -> Table:
    """Return a piece of furniture somewhere in a room."""
    found: Table = {
        "kind": rng.choice(("box", "table", "chair")),
        "at": [rng.uniform(area[0] + 0.8, area[2] - 0.8), rng.uniform(area[1] + 0.8, area[3] - 0.8)],
    }
    if found["kind"] != "chair":
        found["size"] = [rng.uniform(0.5, 1.8), rng.uniform(0.4, 1.0)]
    return found


@click.command()
@click.option("-o", "--out", type=click.Path(path_type=Path), required=True, help="Scenario to write (.toml).")
@click.option("--seed", default=0, show_default=True)
def main(out: Path, seed: int) -> None:
    """Write a floor of 160 x 100 m, and a drive through it, as a scenario."""
    out.write_text(tomli_w.dumps(scenario(seed)), encoding="utf-8")


if __name__ == "__main__":
    main()
