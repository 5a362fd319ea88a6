"""A line map leaves one run and is given to another: the file, and localising in it."""

import json
import math
import re
import tracemalloc
from functools import cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import ring_drive
from bags import T0, Said, cdr, header, write
from commands import locfuse, ok, refused, reported
from laser_room import scans_of
from msgspec.structs import replace
from numpy.typing import NDArray
from present import present
from ring_drive import Held, box
from wheel_bags import GEOMETRY, joint_states, turned
from worlds import World

from benchmarks.floor_plan import FloorPlan, floor_plan, write as write_plan
from locfuse.formats.robot import map_files
from locfuse.fusion import se2
from locfuse.fusion.data import Array, LocfuseError, MapLine
from locfuse.fusion.fuse import fuse
from locfuse.fusion.judge.evaluate import evaluate
from locfuse.fusion.map.given_map import Grid, at_start, find_start, walls_of
from locfuse.fusion.wheels.motion import Wheels
from locfuse.sample_logs import scenario as load
from locfuse.sample_logs.building_scene import scene_of

P = np.array([[1e-4, -3e-5], [-3e-5, 2e-5]])
OURS = '{"format": "locfuse line map", "version": 1, "lines": [%s]}'
LINES = [MapLine(3, 2.0, 0.4, (-1.0, 2.5), P, 17), MapLine(8, -1.5, -3.0, (4.0, 4.5), P, 4)]


def test_a_map_survives_its_file() -> None:
    back = map_files.decode_lines(map_files.encode_lines(LINES), "map.json")
    for a, b in zip(LINES, back, strict=True):
        assert (a.id, a.hits) == (b.id, b.hits)
        assert (b.rho, math.cos(b.beta - a.beta)) == pytest.approx((a.rho, 1.0))
        assert b.ends == pytest.approx(a.ends)
        np.testing.assert_allclose(b.P, a.P, atol=1e-12)


def test_the_file_holds_points_on_the_walls() -> None:
    walls = json.loads(map_files.encode_lines(LINES))["lines"]
    for line, wall in zip(LINES, walls, strict=True):
        for x, y in (wall["from"], wall["to"]):
            assert x * math.cos(line.beta) + y * math.sin(line.beta) == pytest.approx(line.rho)
        assert math.dist(wall["from"], wall["to"]) == pytest.approx(line.ends[1] - line.ends[0])


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("walls", "is not a line map"),
        ('{"format": "other", "version": 1, "lines": []}', "is not a line map"),
        ('{"format": "locfuse line map", "versi\\non": 1, "lines": []}', "is not a line map"),
        ('{"format": "locfuse line map", "version": 9, "lines": []}', "version 9"),
        (OURS % "", "no lines"),
        (OURS % '{"id": 1, "from": [1, 1], "to": [1, 1]}', "no length"),
        (OURS % '{"id": 1, "from": [1, 1], "to": [2, 1], "covariance": [[-1, 0], [0, 1]]}', "not symmetric"),
    ],
)
def test_what_is_no_map_is_refused_in_one_line(text: str, says: str) -> None:
    with pytest.raises(LocfuseError, match=says) as problem:
        map_files.decode_lines(text, "map.json")
    assert "\n" not in str(problem.value)


def test_a_robot_localises_in_the_map_of_another_drive_and_leaves_it_as_it_is() -> None:
    lines = fuse(*World(seed=1).measured(), ["lrf"]).final_map
    second = World(seed=2, start=(2.0, 2.0, 0.5), settings={"lrf": {"map": "given"}})
    drive, robot = second.measured()
    start = replace(robot.start, sigma_xy=0.05, sigma_theta_deg=1.0)
    robot = replace(robot, lines=tuple(lines), start=start)
    found = fuse(drive, robot, ["lrf"])
    figures = evaluate(found, drive).figures
    assert present(figures["position_rmse_m"]) < 0.02
    assert present(figures["anees"]) < 2.5
    assert [line.rho for line in found.final_map] == pytest.approx([line.rho for line in lines], abs=1e-9)


def test_localising_in_no_map_says_what_is_missing() -> None:
    drive, robot = World(seconds=2.0, settings={"lrf": {"map": "given"}}).measured()
    with pytest.raises(LocfuseError, match="--map FILE"):
        fuse(drive, robot, ["lrf"])


# --- `--map map.yaml` and `lrf.map_topic`: a log is localised in a floor plan, from a start that nobody says

LOG = "rounded_rectangle"
UNKNOWN_START = ("--set", "start.sigma_xy=5")


@cache
def plan() -> FloorPlan:
    return floor_plan(scene_of(load.load(LOG), 0).obstacles(0.25), (2.0, 2.0), 0.043)


@pytest.fixture
def given(tmp_path: Path) -> Path:
    write_plan(plan(), tmp_path / "arena")
    return tmp_path / "arena.yaml"


def judged(given: Path, *words: Any) -> tuple[dict[str, Any], str]:
    done = reported("compare", LOG, "--map", given, "--sensors", "lrf", *words, "--no-advice", "-v")
    return done.report, done.stderr


def test_a_log_is_localised_in_a_floor_plan_from_anywhere(given: Path) -> None:
    report, stderr = judged(given, *UNKNOWN_START)
    figures = report["configurations"]["lrf"]
    assert figures["position_rmse_m"] < 0.05
    assert figures["heading_rmse_deg"] < 1.0
    assert figures["anees"] < 2.0
    assert "looked for in all of the map" in " ".join(stderr.split())
    assert "truth starts at" not in stderr
    assert (report["repeat"], report["key"]) == (None, None)  # robot.toml does not hold the map


def test_a_start_that_is_known_is_not_looked_for(given: Path) -> None:
    report, stderr = judged(given)
    assert report["configurations"]["lrf"]["position_rmse_m"] < 0.05
    assert "looked for" not in stderr


def test_a_floor_too_large_to_be_looked_through_is_one_line(given: Path) -> None:
    """A picture of 200 m x 200 m is some kB; 32 million places and headings took 5 GiB and minutes."""
    pixels = np.full((4000, 4000), 254, np.uint8)
    for x0, y0, x1, y1 in box(10, 10, 3990, 3990):
        pixels[min(y0, y1) : max(y0, y1) + 1, min(x0, x1) : max(x0, x1) + 1] = 0
    given.with_name("large.png").write_bytes(cv2.imencode(".png", pixels)[1].tobytes())
    large = given.with_name("large.yaml")
    large.write_text("image: large.png\nresolution: 0.05\norigin: [-100, -100, 0]\nnegate: 0\n")
    words = ("run", LOG, "--map", large, "--sensors", "lrf", "--no-advice", "-o", given.parent / "out")
    tracemalloc.start()
    try:
        done = locfuse(*words, *UNKNOWN_START)
        assert tracemalloc.get_traced_memory()[1] < 1 << 30
    finally:
        tracemalloc.stop()
    assert done.exit_code == 1
    found = re.search(r"(\d+) free places x (\d+) headings are (\d+), more than the cap of (\d+)", done.stderr)
    assert found is not None, done.stderr
    places, headings, tried, cap = map(int, found.groups())
    assert (tried, places * headings > cap) == (places * headings, True)
    assert 600**2 < places < 667**2  # of a lattice of 0.3 m
    assert cap > places / 4 * headings  # 100 m x 100 m are looked through
    assert "--set start.x=" in done.stderr
    assert len(done.stderr.splitlines()) == 1


def test_a_map_of_very_many_walls_is_refused_before_the_filter_holds_them(given: Path) -> None:
    """Two states each: 8 000 plates in a picture of 40 kB took 10 GiB, 10 000 walls in a line map 3 GiB."""
    pixels = np.full((1800, 1800), 254, np.uint8)
    pixels[5::20] = np.arange(1800) % 40 // 36 * 254  # 90 x 45 plates of 1.8 m, each with two sides
    given.with_name("plates.png").write_bytes(cv2.imencode(".png", pixels)[1].tobytes())
    picture, walls = given.with_name("plates.yaml"), given.with_name("walls.json")
    picture.write_text("image: plates.png\nresolution: 0.05\norigin: [-1, -1, 0]\n")
    lines = [{"id": i, "from": [0, i], "to": [1, i]} for i in range(3001)]
    walls.write_text(json.dumps({"format": "locfuse line map", "version": 1, "lines": lines}))
    for file, found in ((picture, 90 * 45 * 2), (walls, 3001)):
        refusal = refused("run", LOG, "--map", file, "--sensors", "lrf", "-o", given.parent / "out")
        said = re.search(r"([\d ]+) walls, more than the cap of 3 000", refusal)
        assert said is not None
        assert int(said[1].replace(" ", "")) == found


def test_an_image_itself_and_several_logs_are_refused(given: Path) -> None:
    assert "name the .yaml beside the image" in refused("run", LOG, "--map", given.with_suffix(".pgm"), code=2)
    assert "compare one log at a time" in refused("compare", LOG, "disturbed", "--map", given, code=2)


ROOM = np.array(box(-2.0, -2.5, 4.5, 3.5) + box(1.0, 2.6, 2.2, 3.5) + box(-2.0, -2.5, -1.2, -1.0))
MAP, CHOSEN = "nav_msgs/msg/OccupancyGrid", ("--set", "lrf.map_topic=/map")
PERIOD = 0.2  # s, of the scans


def drive() -> tuple[np.ndarray[Any, Any], np.ndarray[Any, Any], np.ndarray[Any, Any]]:
    """Times, wheel angles (n, 2) and true poses (n, 3): a curve through the room."""
    t = np.arange(0.0, 20.0, PERIOD)
    speed = np.stack((4.0 + 0.8 * np.sin(t / 3.0), 5.6 + 0.0 * t), axis=-1)
    angle = np.concatenate((np.zeros((1, 2)), np.cumsum(speed[:-1] * PERIOD, axis=0)))
    sides = np.diff(angle, axis=0) * 0.05
    twist = np.stack((sides.mean(axis=1), 0.0 * sides[:, 0], (sides[:, 1] - sides[:, 0]) / 0.3), axis=-1)
    return t, angle, se2.chain(se2.exp(twist))


def with_map(folder: Path, cells: int | None = None) -> Path:
    """A log whose map is turned and moved against the odometry: begins at (3.0, 1.0) m, 30 degrees in it."""
    t, angle, pose = drive()
    said = [*joint_states(t, angle), *scans_of(t, pose, ROOM, "base_link")]
    grid = np.zeros((140, 150), np.int8)
    low = np.array([-2.5, -3.0])
    for x0, y0, x1, y1 in ROOM.tolist():
        i, j = np.floor((np.linspace((x0, y0), (x1, y1), 400) - low) / 0.05).astype(int).T
        grid[j, i] = 100
    origin = se2.compose(np.array([3.0, 1.0, np.radians(30.0)]), np.array([*low, 0.0]))
    place, turn = {"x": float(origin[0]), "y": float(origin[1])}, turned(float(origin[2]))
    info: dict[str, Any] = {"resolution": 0.05, "width": 150, "height": 140 if cells is None else cells}
    info |= {"origin": {"position": place, "orientation": turn}}
    body = cdr(MAP, header=header(T0, "map"), info=info, data=grid.ravel())
    said.append(Said("/map", MAP, body, T0))
    return write(folder / "x.mcap", said)


def test_the_map_may_be_a_topic_of_the_log(tmp_path: Path) -> None:
    log = with_map(tmp_path)
    words = ("-o", tmp_path / "out", "--write", "tum")
    done = ok("run", log, "-v", "--no-advice", *GEOMETRY, *CHOSEN, *words)
    assert "the drive begins in /map at x" in done.stderr
    path = np.loadtxt(tmp_path / "out/trajectory.tum")
    _, _, pose = drive()
    true = se2.compose(np.array([3.0, 1.0, np.radians(30.0)]), pose[-1])
    assert np.hypot(*(path[-1, 1:3] - true[:2])) < 0.05


def test_info_and_init_offer_a_map_of_the_log_and_leave_it_to_the_user(tmp_path: Path) -> None:
    log = with_map(tmp_path)
    info = ("info", log, *GEOMETRY, "--json")
    found, chosen = (json.loads(locfuse(*info, *more).stdout)["findings"] for more in ((), CHOSEN))
    offers = [(f["fixes"], f["severe"]) for f in found if f["code"] == "map"]
    assert offers == [(["lrf.map_topic=/map"], False)]
    assert not any(f["code"] == "map" for f in chosen)
    assert "# map_topic = " in locfuse("init", log, *GEOMETRY).stdout


@pytest.mark.parametrize(
    ("topic", "cells", "said"),
    [
        ("/scan", None, "lrf.map_topic: /scan is sensor_msgs/msg/LaserScan; it takes"),
        ("/gone", None, "lrf.map_topic: /gone is not there"),
        ("/map", 7, "are no map of 150 x 7"),  # not all of its cells are there
    ],
)
def test_a_topic_that_is_no_map_is_one_line(tmp_path: Path, topic: str, cells: int | None, said: str) -> None:
    assert said in refused("run", with_map(tmp_path, cells), *GEOMETRY, "--set", f"lrf.map_topic={topic}")


# --- a picture of the room, drawn cell by cell here, lies where map_server says: nothing is shifted by half a cell

SIZE = (8.0, 6.0)  # m: its walls stand at 0 and there
CELL = 0.2


def solid(x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Walls as an architect draws them: black where a cell's middle is outside the room."""
    return (x < 0.0) | (x > SIZE[0]) | (y < 0.0) | (y > SIZE[1])


def hit(x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Walls as a mapping program leaves them: black where a wall passes within half a cell of the middle."""
    near = [np.abs(x), np.abs(x - SIZE[0]), np.abs(y), np.abs(y - SIZE[1])]
    return np.asarray(np.min(near, axis=0) < 0.5 * CELL - 1e-9)


def draw(path: Path, walls: NDArray[np.bool_], x: NDArray[np.float64], y: NDArray[np.float64]) -> Path:
    """Write the room as P5 and YAML; x and y are those of the cells' middles, the first row the southernmost."""
    inside = (x > 0.0) & (x < SIZE[0]) & (y > 0.0) & (y < SIZE[1])
    grey = np.where(walls, 0, np.where(inside, 254, 205)).astype(np.uint8)
    rows, columns = grey.shape
    path.with_suffix(".pgm").write_bytes(b"P5 %d %d 255\n" % (columns, rows) + grey[::-1].tobytes())
    origin = [float(x[0, 0]) - 0.5 * CELL, float(y[0, 0]) - 0.5 * CELL, 0.0]
    path.write_text(f"image: {path.stem}.pgm\nresolution: {CELL}\norigin: {origin}\nnegate: 0\n")
    return path


@pytest.mark.parametrize(
    ("wall", "begin"),
    [(solid, (-1.0 + 0.5 * CELL, -2.0 + 0.5 * CELL)), (hit, (-1.0, -2.0))],  # of the lower left cell: its middle
)
def test_a_picture_lies_where_its_origin_says(wall: object, begin: tuple[float, float], tmp_path: Path) -> None:
    """Both draw these walls without any rounding, so that what is left is the laser's own error."""
    x, y = np.meshgrid(begin[0] + CELL * np.arange(60), begin[1] + CELL * np.arange(55))
    assert callable(wall)
    given = draw(tmp_path / "room.yaml", wall(x, y), x, y)
    found = reported("compare", LOG, "--map", given, "--no-advice", "--sensors", "lrf").rows["lrf"]
    assert found["position_rmse_m"] < 0.1 * CELL


# --- walls in the pictures of given maps, and a start looked for among them

PIXEL = 0.05


def drawn(inside: NDArray[np.bool_], thick: int, origin: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Grid:
    """A grid whose free cells are given; around them a wall of some cells, beyond it nothing is known."""
    wall, grown = np.zeros_like(inside), inside
    for _ in range(thick):
        padded = np.pad(grown, 1)
        grown = padded[1:-1, 1:-1] | padded[2:, 1:-1] | padded[:-2, 1:-1] | padded[1:-1, 2:] | padded[1:-1, :-2]
        wall |= grown & ~inside
    return Grid(wall, inside, PIXEL, np.array(origin))


def centres(rows: int, columns: int) -> tuple[Array, Array]:
    """X and y [m] of the middles of cells, (rows, columns) each."""
    y, x = np.meshgrid((np.arange(rows) + 0.5) * PIXEL, (np.arange(columns) + 0.5) * PIXEL, indexing="ij")
    return x, y


def room(thick: int, origin: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Grid:
    """A room of 6 m x 4 m whose lower left corner is at (0.5, 0.5) in the grid."""
    x, y = centres(100, 140)
    return drawn((x > 0.5) & (x < 6.5) & (y > 0.5) & (y < 4.5), thick, origin)


def by_direction(lines: list[MapLine]) -> dict[int, MapLine]:
    return {round(math.degrees(line.beta)) % 360: line for line in lines}


@pytest.mark.parametrize(("thick", "depth"), [(4, 0.0), (1, PIXEL / 2.0)])
def test_a_room_has_four_walls_with_their_normals_outward(thick: int, depth: float) -> None:
    """Thick walls lie where they begin, walls of one cell in its middle."""
    found = by_direction(walls_of(room(thick)))
    assert sorted(found) == [0, 90, 180, 270]
    for degrees, rho in {0: 6.5, 90: 4.5, 180: -0.5, 270: -0.5}.items():
        assert found[degrees].rho == pytest.approx(rho + depth, abs=1e-6)
    lengths = {degrees: line.ends[1] - line.ends[0] for degrees, line in found.items()}
    assert lengths[0] == pytest.approx(4.0, abs=2 * PIXEL)
    assert lengths[90] == pytest.approx(6.0, abs=2 * PIXEL)


def test_the_grid_lies_where_its_origin_says() -> None:
    turned = math.radians(30.0)
    found = by_direction(walls_of(room(4, (1.0, -2.0, turned))))
    assert sorted(found) == [30, 120, 210, 300]
    corner = se2.transform(np.array([1.0, -2.0, turned]), np.array([6.5, 4.5]))
    for degrees in (30, 120):
        line = found[degrees]
        assert corner @ (math.cos(line.beta), math.sin(line.beta)) == pytest.approx(line.rho, abs=1e-6)


@pytest.mark.parametrize("degrees", [7.0, 20.0, 33.0, 45.0, 68.0])
@pytest.mark.parametrize("thick", [1, 4])
def test_a_wall_across_the_grid_is_found_as_one(degrees: float, thick: int) -> None:
    """Its staircase leaves it by less than a cell; all errors lie within three of its sigmas."""
    x, y = centres(160, 160)
    c, s = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    grid = drawn((c * x + s * y < 5.0) & (x > 0.5) & (y > 0.5) & (x < 7.0) & (y < 7.0), thick)
    along = [one for one in walls_of(grid) if abs(one.beta - math.radians(degrees)) < 0.05]
    line = max(along, key=lambda one: one.ends[1] - one.ends[0])
    assert line.ends[1] - line.ends[0] > 2.5
    middle = 0.5 * (line.ends[0] + line.ends[1])
    G = np.array([[1.0, -middle], [0.0, 1.0]])  # what is known of its middle
    offset, angle = np.sqrt(np.diagonal(G @ line.P @ G.T))
    assert abs(line.beta - math.radians(degrees)) < 3.0 * angle
    n = np.array([math.cos(line.beta), math.sin(line.beta)])
    at = line.rho * n + middle * np.array([-n[1], n[0]])
    depth = 0.5 * PIXEL if thick == 1 else 0.0
    assert abs(at @ (c, s) - 5.0 - depth) < 3.0 * offset


def test_a_door_parts_a_wall_and_a_short_piece_is_none() -> None:
    grid = room(1)
    occupied, free = grid.occupied.copy(), grid.free.copy()
    occupied[:, 40:60][90] = False  # a door of 1 m in the northern wall
    free[90:, 40:60] = True
    occupied[30:33, 30:33], free[30:33, 30:33] = True, False  # a post of 15 cm
    found = walls_of(Grid(occupied, free, PIXEL, grid.origin))
    assert (len(found), sum(abs(line.beta - math.pi / 2) < 0.1 for line in found)) == (5, 2)


def test_a_wall_between_two_rooms_is_seen_from_both_sides() -> None:
    grid = room(1)
    occupied, free = grid.occupied.copy(), grid.free.copy()
    occupied[10:90, 70], free[10:90, 70] = True, False
    found = walls_of(Grid(occupied, free, PIXEL, grid.origin))
    middle = [one for one in found if abs(math.cos(one.beta)) > 0.9 and abs(abs(one.rho) - 70.5 * PIXEL) < 1e-6]
    assert sorted(round(math.degrees(line.beta)) % 360 for line in middle) == [0, 180]


def test_a_picture_of_noise_is_refused_before_its_cells_are_walked() -> None:
    black = np.indices((1024, 1024)).sum(axis=0) % 2 == 1  # 2 100 000 sides of cells in a picture of 2 kB
    with pytest.raises(LocfuseError, match="more than 1000000 sides"):
        walls_of(Grid(black, ~black, PIXEL, np.zeros(3)))


# --- where a drive began in a given map: found, refused where the map is of another place, and left open

WALL_MAP = np.array([3.0, -7.0, math.radians(40.0)])  # where the ring lies in the map
OTHER = np.array(box(-3.0, -5.0, 19.0, 12.0) + box(0.0, -2.0, 3.0, 9.0) + box(6.0, 1.0, 15.0, 3.0))


def grid_of(segments: Array, origin: Array = WALL_MAP) -> Grid:
    """A plan of walls (k, 4) of one cell, in the frame of the ring; all else is free."""
    low = segments.reshape(-1, 2).min(axis=0) - 1.0
    columns, rows = np.ceil((segments.reshape(-1, 2).max(axis=0) + 1.0 - low) / PIXEL).astype(int)
    occupied = np.zeros((rows, columns), dtype=bool)
    for x0, y0, x1, y1 in segments.tolist():
        n = 2 + int(2.0 * math.hypot(x1 - x0, y1 - y0) / PIXEL)
        i, j = np.floor((np.linspace((x0, y0), (x1, y1), n) - low) / PIXEL).astype(int).T
        occupied[j, i] = True
    return Grid(occupied, ~occupied, PIXEL, se2.compose(origin, np.array([*low, 0.0])))


def walls_drive(segments: Array, first: int = 0, last: int = 250) -> tuple[Array, Held, Wheels, Array]:
    """Times, scans, wheels, and the true first pose in the map."""
    t, pose = ring_drive.path(1.0)
    t, pose = t[first:last] - t[first], pose[first:last]
    rng = np.random.default_rng(5)
    every = slice(0, None, 4)
    scans = [ring_drive.scan(one, segments, rng) for one in pose[every]]
    steps = se2.log(se2.between(pose[:-1], pose[1:])) * (1.02, 1.0, 0.98)  # wheels that are a little wrong
    return t[every], Held(scans), Wheels.from_twists(t, steps, 0.3, 4e-4), se2.compose(WALL_MAP, pose[0])


@pytest.mark.parametrize(("first", "last"), [(0, 150), (40, 240)])
def test_the_start_is_found_in_all_of_the_map(first: int, last: int) -> None:
    walls = ring_drive.walls(alike=False)
    t, scans, wheels, true = walls_drive(walls, first, last)
    found = find_start(grid_of(walls), t, scans, wheels)
    off = se2.between(true, at_start(found, wheels))
    assert math.hypot(off[0], off[1]) < 0.15
    assert abs(se2.wrap(float(off[2]))) < math.radians(3.0)
    assert found.share > 0.9


def test_a_map_of_another_building_is_refused_within_thirty_seconds() -> None:
    t, scans, wheels, _ = walls_drive(ring_drive.walls(alike=False), last=420)
    with pytest.raises(LocfuseError, match=r"no place in the map fits.*Is it a map of this building\?") as problem:
        find_start(grid_of(OTHER), t, scans, wheels)
    until = present(re.search(r"the first (\d+) s", str(problem.value)))
    assert int(until[1]) <= 31


def test_where_two_places_look_alike_none_is_taken() -> None:
    """The ring turned by half a turn is the same ring: no drive can tell."""
    walls = ring_drive.walls(alike=True)
    t, scans, wheels, _ = walls_drive(walls, last=420)
    with pytest.raises(LocfuseError, match=r"several places in the map fit.*start\.x"):
        find_start(grid_of(walls), t, scans, wheels)


def test_a_robot_that_sees_nothing_is_told_so() -> None:
    t, scans, wheels, _ = walls_drive(ring_drive.walls(alike=False), last=100)
    with pytest.raises(LocfuseError, match="too little is seen"):
        find_start(grid_of(OTHER), t, Held([np.zeros((0, 2)) for _ in scans.scans]), wheels)
