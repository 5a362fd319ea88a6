"""The simulated building against closed forms: walls, glass, furniture, people; and the drives through it."""

import functools
import math
from pathlib import Path

import msgspec
import numpy as np
import pytest
import rooms

from benchmarks.floor_plan import FREE, OCCUPIED, UNKNOWN, floor_plan, write
from locfuse.fusion.data import Array, LocfuseError
from locfuse.sample_logs import scenario as load
from locfuse.sample_logs.building_scene import (
    LEG_RADIUS_M,
    MIN_PERSON_RANGE_M,
    BuildingScene,
    Walk,
    bent,
    cast_near,
    scene_of,
    stepped_aside,
    straight_walls,
)
from locfuse.sample_logs.paths import waypoints
from locfuse.sample_logs.scenario import (
    Box,
    Building,
    CameraSpec,
    Glass,
    LeggedTable,
    Opening,
    Room,
    Scenario,
    Side,
    Space,
    SwivelChair,
    Walker,
    Waypoints,
)
from locfuse.sample_logs.simulate import OBSTACLE_HEIGHT, in_memory
from locfuse.sample_logs.table import streams
from locfuse.sample_logs.world import Plan, cast, clearance

NAMES = ("office", "hall")
Z = 0.25  # m, height of the laser
HALL = Space(name="hall", area=(0.0, 0.0, 10.0, 8.0))


def scene(building: Building, seed: int = 1, size: tuple[float, float] = (10.0, 8.0)) -> BuildingScene:
    """A building without the landmark of the default room."""
    scenario = Scenario(building=building, room=Room(size=size), camera=CameraSpec(enabled=False))
    scenario = msgspec.structs.replace(scenario, landmark=msgspec.structs.replace(scenario.landmark, x=-50.0))
    found = scene_of(scenario, seed)
    assert isinstance(found, BuildingScene)
    return found


def ranges(of: BuildingScene, at: tuple[float, float], angle: Array, t: float = 0.0) -> Array:
    """What a laser without noise measures, standing still."""
    n = len(angle)
    return of.see(Z, np.full(n, t), np.full((n, 2), at), angle, 80.0)


def hall(**changes: object) -> Building:
    """One empty hall with flat walls, changed."""
    return msgspec.structs.replace(Building(spaces=(HALL,), bow=0.0), **changes)


# --- walls -----------------------------------------------------------------------------------------------


def test_rays_in_an_empty_hall_end_half_a_walls_thickness_before_its_centre_lines() -> None:
    angle = np.radians(np.arange(-180.0, 180.0) + 0.3)
    expected = rooms.scan(rooms.box(0.075, 0.075, 9.925, 7.925), np.array([4.0, 3.0, 0.0]), angle)
    np.testing.assert_allclose(ranges(scene(hall()), (4.0, 3.0), angle), expected, atol=1e-9)


def test_spaces_that_overlap_are_one_and_others_are_two_walls_apart() -> None:
    areas = {"a": (0.0, 0.0, 6.0, 8.0), "b": (5.0, 2.0, 8.0, 4.0), "c": (8.0, 0.0, 10.0, 8.0)}
    spaces = tuple(Space(name=name, area=area) for name, area in areas.items())
    east = ranges(scene(hall(spaces=spaces)), (3.0, 3.0), np.zeros(1))
    assert east[0] == pytest.approx(8.0 - 0.075 - 3.0)  # through a into b, to the wall that b and c share
    west = ranges(scene(hall(spaces=spaces)), (9.0, 3.0), np.array([math.pi]))
    assert west[0] == pytest.approx(9.0 - 8.075)


@pytest.mark.parametrize(
    ("side", "at", "looks_deg"),
    [("east", 3.0, 0.0), ("north", 4.0, 90.0), ("west", 3.0, 180.0), ("south", 4.0, -90.0)],
)
def test_a_door_lets_rays_through_as_far_as_its_jambs_allow(side: Side, at: float, looks_deg: float) -> None:
    """From 2 m before an opening of 1 m the wall's far edge limits the view: half of it over 2.15 m."""
    door = Opening(side=side, at=at, width=1.0)
    building = hall(spaces=(msgspec.structs.replace(HALL, openings=(door,)),))
    standing = {"east": (7.925, 3.0), "north": (4.0, 5.925), "west": (2.075, 3.0), "south": (4.0, 2.075)}[side]
    off = np.arange(-20.0, 20.5, 0.5) + 0.01
    seen = ranges(scene(building), standing, np.radians(looks_deg + off))
    limit = math.degrees(math.atan(0.5 / 2.15))
    np.testing.assert_array_equal(np.isinf(seen), np.abs(off) < limit)


def test_a_closed_door_is_a_niche_and_an_open_leaf_stands_in_the_room() -> None:
    room = Space(name="room", area=(6.0, 0.0, 10.0, 8.0), openings=(Opening(side="west", at=4.0, kind="closed"),))
    of = scene(hall(spaces=(Space(name="corridor", area=(0.0, 0.0, 6.0, 8.0)), room)))
    assert ranges(of, (3.0, 4.0), np.zeros(1))[0] == pytest.approx(3.0)
    assert ranges(of, (3.0, 5.0), np.zeros(1))[0] == pytest.approx(3.0 - 0.075)
    assert ranges(of, (8.0, 4.0), np.array([math.pi]))[0] == pytest.approx(2.0 - 0.075)
    # Hinged at the lower end, as long as the door is wide, 90 degrees into the room.
    door = Opening(side="south", at=4.0, width=1.0, leaf_deg=90.0)
    of = scene(hall(spaces=(msgspec.structs.replace(HALL, openings=(door,)),)))
    assert ranges(of, (6.0, 1.0), np.array([math.pi]))[0] == pytest.approx(6.0 - 3.5)
    assert ranges(of, (6.0, 1.2), np.array([math.pi]))[0] == pytest.approx(6.0 - 0.075)


# --- bent walls ------------------------------------------------------------------------------------------


def test_bent_walls_still_close_every_room() -> None:
    """Every end of a piece is the end of exactly one other: the outline has no gap."""
    pieces = bent(straight_walls(load.load("office").building or hall(), (46.0, 30.0)), 0.02, streams(3))
    points = np.round(np.concatenate((pieces[:, :2], pieces[:, 2:])), 9)
    _, counts = np.unique(points, axis=0, return_counts=True)
    assert (counts == 2).all()


def test_a_bend_is_smooth_and_drawn_by_the_seed_of_drive_or_building() -> None:
    flat = np.array([[0.0, 0.0, 40.0, 0.0], [0.0, 0.0, 0.0, 1.0]])
    chain = bent(flat, 0.02, streams(4))[:-2]
    slope = np.diff(chain[1:-1, [1, 3]], axis=1)[:, 0] / np.diff(chain[1:-1, [0, 2]], axis=1)[:, 0]
    assert 0.001 < np.abs(slope).max() < 0.03
    assert np.abs(np.diff(slope)).max() < 0.02
    plain, own = hall(bow=0.02), hall(bow=0.02, seed=9)
    np.testing.assert_array_equal(scene(plain, 1).faces, scene(plain, 1).faces)
    assert not np.array_equal(scene(plain, 1).faces, scene(plain, 2).faces)
    np.testing.assert_array_equal(scene(own, 1).faces, scene(own, 2).faces)


def test_rays_end_on_the_bent_wall_and_not_on_the_straight_one() -> None:
    """Rays straight at the north wall: the distance is that of the chain interpolated at x."""
    of = scene(hall(bow=0.02), seed=5)
    north = [f for f in of.faces if abs(f[1] - 7.925) < 0.05 and abs(f[3] - 7.925) < 0.05]
    knots = np.array(sorted({(x, y) for f in north for x, y in (f[:2], f[2:])}))
    for x in np.linspace(0.5, 9.5, 40):
        found = ranges(of, (x, 3.0), np.array([math.pi / 2]))[0]
        assert found == pytest.approx(np.interp(x, knots[:, 0], knots[:, 1]) - 3.0, abs=1e-9)
    assert 0.005 < np.abs(knots[:, 1] - 7.925).max() <= 0.02


# --- glass -----------------------------------------------------------------------------------------------


def glazed(**glass: float) -> BuildingScene:
    """Two rooms with a glass wall of 4 m between, at x = 5."""
    pane = Opening(side="east", at=4.0, width=4.0, kind="glass")
    spaces = (
        Space(name="west", area=(0.0, 0.0, 5.0, 8.0), openings=(pane,)),
        Space(name="east", area=(5.0, 0.0, 10.0, 8.0)),
    )
    return scene(hall(spaces=spaces, glass=Glass(post_every=10.0, **glass)))


def test_glass_returns_beams_within_its_angle_and_as_often_as_it_is_told() -> None:
    angle = np.radians(np.arange(-20.0, 20.5, 0.5) + 0.1)
    seen = ranges(glazed(within_deg=8.0, returns=1.0), (3.0, 4.0), angle)
    expected = np.where(np.abs(np.degrees(angle)) <= 8.0, 2.0, 6.925) / np.cos(angle)
    np.testing.assert_allclose(seen, expected, atol=1e-9)
    of = glazed(within_deg=8.0, returns=0.7)
    angle = np.radians(np.linspace(-7.9, 7.9, 400))
    echoes = np.array([ranges(of, (3.0, 4.0), angle, t) < 3.0 for t in np.arange(50) * 0.2])
    assert echoes.mean() == pytest.approx(0.7, abs=4 * math.sqrt(0.7 * 0.3 / echoes.size))
    assert 0.3 < (echoes[1:] != echoes[:-1]).mean() < 0.55  # 2 * 0.7 * 0.3
    np.testing.assert_array_equal(echoes[7], ranges(of, (3.0, 4.0), angle, 7 * 0.2) < 3.0)


def test_posts_between_panes_return_every_beam() -> None:
    of = glazed(returns=0.0)
    held = scene(msgspec.structs.replace(of.building, glass=Glass(returns=0.0, post_every=1.5)))
    # 4 m hold three panes: posts of 6 cm at y = 2 + 4 / 3 and 2 + 8 / 3
    y = 2 + 4 / 3
    assert ranges(held, (3.0, y + 0.02), np.zeros(1))[0] == pytest.approx(2.0 - 0.03)
    assert ranges(held, (3.0, y + 0.04), np.zeros(1))[0] == pytest.approx(6.925)
    assert ranges(of, (3.0, y + 0.02), np.zeros(1))[0] == pytest.approx(6.925)


def test_what_a_robot_can_hit_includes_glass() -> None:
    plan = glazed().obstacles(OBSTACLE_HEIGHT)
    assert clearance(plan, np.array([[4.7, 4.0]]))[0] == pytest.approx(0.3)


# --- furniture -------------------------------------------------------------------------------------------


def furnished(*pieces: Box | LeggedTable | SwivelChair) -> BuildingScene:
    return scene(hall(spaces=(msgspec.structs.replace(HALL, furniture=pieces),)))


def test_a_table_is_four_thin_legs() -> None:
    """Each leg takes the angle 2 asin(r / d) of the view, and nothing lies between."""
    of = furnished(LeggedTable(at=(6.0, 4.0), size=(2.0, 1.0)))
    angle = np.radians(np.arange(-40.0, 40.0, 0.02))
    seen = ranges(of, (3.0, 4.0), angle)
    wall = ranges(scene(hall()), (3.0, 4.0), angle)
    expected = wall.copy()
    for x, y in ((5.05, 3.55), (5.05, 4.45), (6.95, 3.55), (6.95, 4.45)):  # 5 cm inside the corners
        d, off = math.hypot(x - 3.0, y - 4.0), angle - math.atan2(y - 4.0, x - 3.0)
        hit = np.abs(off) < math.asin(0.025 / d)
        leg = d * np.cos(off) - np.sqrt(np.maximum(0.025**2 - (d * np.sin(off)) ** 2, 0.0))
        expected = np.where(hit, np.minimum(expected, leg), expected)
    np.testing.assert_allclose(seen, expected, atol=1e-9)
    assert 0 < (seen < wall - 0.1).mean() < 0.15


def test_boxes_show_their_corners_and_low_ones_end_below_a_high_laser() -> None:
    of = furnished(Box(at=(6.0, 4.0), size=(2.0, 2.0), turn_deg=45.0))
    assert ranges(of, (3.0, 4.0), np.zeros(1))[0] == pytest.approx(3.0 - math.sqrt(2))
    of = furnished(Box(at=(6.0, 4.0), size=(1.0, 1.0), height=0.6), SwivelChair(at=(5.0, 4.0)))
    n = np.full(1, 0.0)
    for z, expected in ((0.3, 2.0 - 0.035), (0.5, 2.5), (0.7, 6.925)):
        assert of.see(z, n, np.array([[3.0, 4.0]]), n, 80.0)[0] == pytest.approx(expected)


# --- people ----------------------------------------------------------------------------------------------

ACROSS = Walker(path=((6.0, 2.0), (6.0, 6.0)), speed=1.0, pause=0.0)


def test_a_person_walks_there_and_back_at_even_speed() -> None:
    walk = Walk(msgspec.structs.replace(ACROSS, pause=4.0), np.random.default_rng(2))
    t = np.arange(0.0, 60.0, 0.1)
    way = walk.way(t)
    speed = np.abs(np.diff(way)) / 0.1
    assert way.min() == pytest.approx(0.0, abs=1e-9)
    assert way.max() == pytest.approx(4.0)
    assert 0.8 <= walk.speed <= 1.2
    assert 2.0 <= walk.pause <= 6.0
    assert set(np.round(speed[(speed > 1e-9) & (np.abs(speed - walk.speed) > 1e-9)] < walk.speed)) <= {True}
    np.testing.assert_allclose(walk.way(t + 2 * (walk.once + walk.pause)), way, atol=1e-9)


def test_a_person_in_the_way_hides_the_wall_by_two_legs() -> None:
    of = scene(hall(people=(ACROSS,)))
    angle = np.radians(np.arange(-45.0, 45.0, 0.1))
    free = ranges(scene(hall()), (3.0, 4.0), angle)
    for t in (0.0, 1.3, 7.7):
        seen = ranges(of, (3.0, 4.0), angle, t)
        legs = of.walks[0].circles(np.array([t]), Z, np.array([[3.0, 4.0]]))[0]
        middle = legs[:, :2].mean(axis=0)
        assert middle[0] == pytest.approx(6.0)
        assert middle[1] == pytest.approx(2.0 + of.walks[0].way(np.array([t]))[0])
        hidden = np.zeros(len(angle), bool)
        for x, y, r in legs:
            assert r == LEG_RADIUS_M
            off = angle - math.atan2(y - 4.0, x - 3.0)
            hidden |= np.abs(off) < math.asin(r / math.hypot(x - 3.0, y - 4.0))
        assert hidden.any()
        np.testing.assert_array_equal(seen < free - 0.5, hidden)


def test_people_step_aside_for_the_robot() -> None:
    middle = np.array([[1.0, 0.2], [3.0, 0.0], [0.0, 0.5]])
    found = stepped_aside(middle, np.zeros((3, 2)))
    assert np.hypot(*found.T) == pytest.approx([math.hypot(1.0, 0.2), 3.0, MIN_PERSON_RANGE_M])
    np.testing.assert_allclose(found[2], (0.0, MIN_PERSON_RANGE_M))


# --- ray casting -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", NAMES)
def test_the_quick_ray_caster_finds_what_the_plain_one_finds(name: str) -> None:
    plan = office_or_hall(name).solid(Z)
    rng = np.random.default_rng(6)
    for _ in range(20):
        n = 360
        origin = rng.uniform((0, 0), (46, 30)) + np.linspace(0, 1, n)[:, None] * rng.uniform(-0.2, 0.2, 2)
        angle = rng.uniform(-9, 9) + np.radians(np.arange(n)) + 0.004 * rng.standard_normal(n)
        expected = cast(plan, origin, angle)
        np.testing.assert_array_equal(
            cast_near(plan, origin, angle, 12.0), np.where(expected <= 12.0, expected, np.inf)
        )


def test_the_quick_ray_caster_survives_an_empty_plan_and_an_origin_on_a_wall() -> None:
    nothing = Plan(np.zeros((0, 4)), np.zeros((0, 3)))
    angle = np.radians(np.arange(0.0, 360.0, 1.0))
    assert np.isinf(cast_near(nothing, np.zeros((360, 2)), angle, 12.0)).all()
    wall = Plan(np.array([[-1.0, 0.0, 1.0, 0.0]]), np.zeros((0, 3)))
    np.testing.assert_array_equal(
        cast_near(wall, np.zeros((360, 2)), angle, 12.0), cast(wall, np.zeros((360, 2)), angle)
    )


# --- the shipped buildings -------------------------------------------------------------------------------


@functools.cache
def office_or_hall(name: str, seed: int = 1) -> BuildingScene:
    found = scene_of(load.load(name), seed)
    assert isinstance(found, BuildingScene)
    return found


def path(name: str) -> Array:
    way = load.load(name).path
    assert isinstance(way, Waypoints)
    return waypoints(way).pose


def nearest(plan: Plan, points: Array) -> Array:
    return np.concatenate([clearance(plan, part) for part in np.array_split(points, max(1, len(points) // 200))])


@functools.cache
def driven(name: str) -> Array:
    """The truth of a drive, ten times a second, steered without laser and compass."""
    _, _, outcome = in_memory(load.load(name, ("lrf.enabled=false", "compass.enabled=false")), 3)
    return outcome.truth[::20]


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("name", NAMES)
def test_the_path_is_clear_however_the_walls_are_bent(name: str, seed: int) -> None:
    plan = office_or_hall(name, seed).obstacles(OBSTACLE_HEIGHT)
    assert nearest(plan, path(name)[::5, :2]).min() > load.load(name).control.clearance + 0.1


def revisits(truth: Array, apart: float, turned: bool) -> list[float]:
    """The ways [m] since places were seen before (within 0.5 m), in the opposite or in the same direction."""
    gone = np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(truth[:, :2], axis=0).T))))
    found = []
    for i in range(0, len(truth), 10):
        before = gone < gone[i] - apart
        close = before & (np.hypot(*(truth[:, :2] - truth[i, :2]).T) < 0.5)
        opposite = np.cos(truth[:, 2] - truth[i, 2]) < -0.9
        same = np.cos(truth[:, 2] - truth[i, 2]) > 0.9
        at = np.flatnonzero(close & (opposite if turned else same))
        if len(at):
            found.append(float(gone[i] - gone[at[-1]]))
    return found


def test_the_office_has_loops_of_100_m_in_both_directions() -> None:
    truth = driven("office")
    same, opposite = revisits(truth, 60.0, False), revisits(truth, 60.0, True)
    assert sum(80 < way < 180 for way in same) > 20
    assert len(opposite) > 40
    assert max(*same, *opposite) > 200


def test_the_office_lies_on_its_floor_plan(tmp_path: Path) -> None:
    plan = floor_plan(office_or_hall("office").obstacles(Z), (35.4, 2.4), 0.05)
    assert set(np.unique(plan.image)) == {OCCUPIED, UNKNOWN, FREE}
    cell = np.floor((path("office")[:, :2] - plan.origin) / plan.cell).astype(int)
    assert (plan.image[-1 - cell[:, 1], cell[:, 0]] == FREE).all()
    assert plan.image[0, 0] == UNKNOWN  # nothing leaks out, not even through glass
    archive = np.floor((np.array([3.0, 3.0]) - plan.origin) / plan.cell).astype(int)
    assert plan.image[-1 - archive[1], archive[0]] == UNKNOWN
    write(plan, tmp_path / "office")
    head, size, depth, cells = (tmp_path / "office.pgm").read_bytes().split(b"\n", 3)
    assert (head, depth) == (b"P5", b"255")
    assert size.split() == [str(n).encode() for n in plan.image.shape[::-1]]
    assert cells == plan.image.tobytes()
    assert "resolution: 0.05\norigin: [-0.6, -0.6, 0]\n" in (tmp_path / "office.yaml").read_text()


# --- whole drives ----------------------------------------------------------------------------------------


def test_the_robot_slows_down_for_its_corners() -> None:
    truth = driven("office")
    speed = np.hypot(*np.diff(truth[:, :2], axis=0).T) / 0.1
    turning = np.abs(np.diff(np.unwrap(truth[:, 2]))) / 0.1
    assert np.median(speed) == pytest.approx(0.6, abs=0.02)
    calm = np.convolve(turning, np.ones(5) / 5, "same")
    assert calm.max() < 1.5
    assert np.median(speed[calm > 0.6]) < 0.5


def test_a_path_needs_two_points() -> None:
    with pytest.raises(LocfuseError, match="needs at least two"):
        waypoints(Waypoints(points=((1.0, 2.0),)))
