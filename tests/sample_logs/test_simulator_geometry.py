"""The simulated world against closed forms: rays in the plan, rays in the mirror, the landmark in the image."""

import math

import msgspec
import numpy as np
import pytest
import rooms

from locfuse.fusion.data import Array
from locfuse.sample_logs.camera import Painter, Surface, expose, rays, slope
from locfuse.sample_logs.robot import SimulatedRobot
from locfuse.sample_logs.scenario import CameraSpec, Landmark, LrfSpec, Room, Scenario
from locfuse.sample_logs.sensors import SimulatedLaser
from locfuse.sample_logs.table import Pillar, streams
from locfuse.sample_logs.world import Plan, World, cast, clearance

NOTHING = np.zeros((0, 3))
PLACES = [(1.5, 1.5, 0.0), (5.0, 3.0, 1.2), (2.0, 4.5, -2.9), (6.1, 2.1, math.pi / 2), (7.0, 5.0, 3.1)]


def test_rays_in_an_empty_room_end_where_the_rectangle_does() -> None:
    rng = np.random.default_rng(1)
    origin = rng.uniform((0.1, 0.1), (7.9, 5.9), (5000, 2))
    angle = rng.uniform(-np.pi, np.pi, 5000)
    plan = Plan(World(Scenario(room=Room(plates=()))).walls, NOTHING)
    np.testing.assert_allclose(
        cast(plan, origin, angle), rooms.ranges(rooms.box(0, 0, 8, 6), origin, angle), atol=1e-9
    )


def test_rays_meet_a_circle_at_the_law_of_cosines() -> None:
    rng = np.random.default_rng(2)
    angle = rng.uniform(-0.2, 0.2, 1000)
    d, r = 3.0, 0.4
    expected = d * np.cos(angle) - np.sqrt(np.maximum(r**2 - (d * np.sin(angle)) ** 2, 0))
    expected[np.abs(d * np.sin(angle)) > r] = np.inf
    plan = Plan(np.zeros((0, 4)), np.array([[d, 0.0, r]]))
    np.testing.assert_allclose(cast(plan, np.zeros((1000, 2)), angle), expected, atol=1e-9)


def test_rays_hit_nothing_between_walls_or_through_a_door_left_open() -> None:
    plan = Plan(np.array([[1.0, 1.0, 1.0, 2.0], [1.0, -1.0, 1.0, -2.0]]), np.array([[-2.0, 0.0, 0.5]]))
    assert np.isinf(cast(plan, np.zeros((1, 2)), np.zeros(1))[0])
    room = Room(walls=((0, 0, 8, 0), (8, 0, 8, 6), (8, 6, 0, 6), (0, 6, 0, 4)), plates=())
    plan = Plan(World(Scenario(room=room)).walls, NOTHING)
    seen = cast(plan, np.full((2, 2), (4.0, 3.0)), np.array([math.pi, 0.0]))
    assert np.isinf(seen[0])
    assert seen[1] == pytest.approx(4.0)


def test_clearance_is_the_distance_from_the_nearest_wall_end_or_circle() -> None:
    plan = Plan(np.array([[0.0, 0.0, 2.0, 0.0]]), np.array([[0.0, 3.0, 0.5]]))
    points = np.array([[1.0, 0.7], [3.0, 1.0], [0.0, 2.0]])
    np.testing.assert_allclose(clearance(plan, points), [0.7, math.sqrt(2), 0.5])
    points = np.array([[4.0, 4.0], [6.0, 4.0], [4.0, 7.9], [8.5, 4.0]])
    assert clearance(
        World(Scenario(room=ROUND, landmark=Landmark(bottom=1.0))).plan(0.25), points
    ) == pytest.approx([4.0, 2.0, 0.1, -0.5])


def test_the_mirror_obeys_the_law_of_reflection() -> None:
    """Follow a camera ray to the hyperboloid, reflect it on the normal: it must look as eq. tan alpha says."""
    camera = CameraSpec()
    a, b = camera.mirror_a, camera.mirror_b
    c = math.hypot(a, b)
    for radius in np.linspace(camera.inner, camera.outer, 50):
        direction = np.array([radius, camera.focal]) / math.hypot(radius, camera.focal)  # (rho, Z)
        # Z^2/b^2 - rho^2/a^2 = 1 with (rho, Z) = (0, -c) + s direction; the upper sheet is met last
        quadratic = [
            direction[1] ** 2 / b**2 - direction[0] ** 2 / a**2,
            -2 * c * direction[1] / b**2,
            c**2 / b**2 - 1,
        ]
        points = [np.array([0.0, -c]) + s * direction for s in np.roots(quadratic).real if s > 0]
        point = next(p for p in points if p[1] > 0)
        normal = np.array([-point[0] / a**2, point[1] / b**2])
        normal /= np.hypot(*normal)
        away = direction - 2 * (direction @ normal) * normal
        assert away[1] / away[0] == pytest.approx(float(slope(np.array([radius]), camera)[0]), abs=1e-9)
        # and its backward extension passes through the upper focus: one viewpoint
        assert point[1] - away[1] / away[0] * point[0] == pytest.approx(c, abs=1e-9)


def painted(scenario: Scenario, place: tuple[float, float, float]) -> tuple[Array, Array]:
    """Return azimuth [rad] and radius [px] of the red pixels seen with the robot at `place`."""
    camera = scenario.camera
    x, y, theta = place
    c, s = math.cos(theta), math.sin(theta)
    eye = np.array(
        [x + c * camera.x - s * camera.y, y + s * camera.x + c * camera.y, theta + math.radians(camera.yaw_deg)]
    )
    image = Painter(camera, World(scenario)).paint(eye, 0.0)
    red, green, blue = np.moveaxis(image, -1, 0)
    v, u = np.nonzero((red > 40) & (red > 3 * green) & (red > 3 * blue))
    du, dv = u - camera.centre[0], v - camera.centre[1]
    return np.arctan2(du, dv), np.hypot(du, dv)


def mean_angle(angle: Array, weight: Array) -> float:
    return math.atan2((weight * np.sin(angle)).sum(), (weight * np.cos(angle)).sum())


def bearing(scenario: Scenario, place: tuple[float, float, float]) -> float:
    """Bearing of the landmark's axis from the camera [rad]."""
    camera, mark = scenario.camera, scenario.landmark
    x, y, theta = place
    dx = mark.x - x - camera.x * math.cos(theta) + camera.y * math.sin(theta)
    dy = mark.y - y - camera.x * math.sin(theta) - camera.y * math.cos(theta)
    return math.atan2(dy, dx) - theta - math.radians(camera.yaw_deg)


def turn_deg(a: float, b: float) -> float:
    return math.degrees(abs((a - b + math.pi) % (2 * math.pi) - math.pi))


@pytest.mark.parametrize("place", PLACES)
@pytest.mark.parametrize(
    "camera",
    [
        CameraSpec(),
        CameraSpec(x=-0.2, y=0.15, yaw_deg=30.0),
        CameraSpec(zero_deg=90.0),
        CameraSpec(zero_deg=-40.0, clockwise=True),
    ],
    ids=["as shipped", "off the axle", "turned in the image", "unmirrored"],
)
def test_the_landmark_stands_where_its_bearing_says(place: tuple[float, float, float], camera: CameraSpec) -> None:
    scenario = Scenario(camera=camera, room=Room(plates=()))
    angle, radius = painted(scenario, place)
    column = mean_angle(angle, 1 / radius)  # a degree holds pixels in proportion to the radius
    seen = math.radians(camera.zero_deg) + (-column if camera.clockwise else column)
    assert turn_deg(seen, bearing(scenario, place)) < 0.1


def test_a_higher_landmark_reaches_further_out_in_the_image() -> None:
    """Its ends lie where the mirror shows their elevations: radius from tan alpha, by bisection."""
    place = (5.0, 3.0, 0.4)
    for bottom, top in ((0.0, 1.6), (0.0, 1.2), (0.5, 1.4)):
        mark = Landmark(bottom=bottom, top=top)
        scenario = Scenario(landmark=mark, room=Room(plates=()))
        _, radius = painted(scenario, place)
        camera = scenario.camera
        gap = math.hypot(7.9 - 5.0 - 0.1 * math.cos(0.4), 5.5 - 3.0 - 0.1 * math.sin(0.4)) - 0.08
        table = np.linspace(camera.inner, camera.outer, 20_000)
        low, high = np.interp([(h - camera.z) / gap for h in (bottom, top)], slope(table, camera), table)
        assert radius.max() == pytest.approx(high, abs=1.0)
        assert radius.min() == pytest.approx(low, abs=1.0)


def test_camera_and_laser_see_the_same_room() -> None:
    """Two ray casters, written apart: along a level ray both find the same distance."""
    scenario = Scenario(room=Room(pillars=(Pillar(x=4.0, y=2.5, radius=0.3, top=2.0),)))
    scene = World(scenario)
    level = CameraSpec(z=0.6)
    bundle = rays(level)
    near_level = np.abs(bundle.slope) < 0.01
    for x, y, theta in PLACES:
        hits = Painter(level, scene).trace(np.array([x, y, level.z, theta]), 0.0)
        origin = np.full((int(near_level.sum()), 2), (x, y))
        expected = cast(scene.plan(level.z), origin, bundle.azimuth[near_level] + theta)
        differs = np.abs(hits.way[near_level] - expected) > 1e-3
        assert differs.mean() < 1e-3  # a ray within rounding of an edge may pass it


def test_floor_and_ceiling_lie_at_their_heights() -> None:
    camera = CameraSpec()
    bundle = rays(camera)
    hits = Painter(camera, World(Scenario())).trace(np.array([4.0, 3.0, camera.z, 0.3]), 0.0)
    z = camera.z + hits.way * bundle.slope
    np.testing.assert_allclose(z[hits.surface == Surface.FLOOR], 0.0, atol=1e-5)
    np.testing.assert_allclose(z[hits.surface == Surface.CEILING], 2.6, atol=1e-5)


def test_a_person_in_front_of_the_landmark_hides_it() -> None:
    place = (5.0, 3.0, 0.0)
    person = Pillar(x=6.45, y=4.25, radius=0.25, top=1.8, colour=(40, 60, 110))
    scenario = Scenario(room=Room(plates=(), pillars=(person,)))
    assert len(painted(scenario, place)[0]) == 0
    assert len(painted(msgspec.structs.replace(scenario, room=Room(plates=())), place)[0]) > 50


def test_image_noise_has_the_deviation_that_was_asked_for() -> None:
    camera = CameraSpec(noise=4.0, blur=0.0, brightness=1.0)
    grey = np.full((480, 480, 3), 128.0, np.float32)
    image = expose(grey, camera, np.random.default_rng(3)).astype(float)
    # truncation to whole grey levels adds 1/12 of variance
    assert image.std() == pytest.approx(math.sqrt(16 + 1 / 12), rel=0.01)
    assert abs(np.corrcoef(image[:, :-1, 0].ravel(), image[:, 1:, 0].ravel())[0, 1]) < 0.01


# --- a round room

ROUND = Room(size=(8.0, 8.0), radius=4.0, plates=())
CENTRE = np.array([4.0, 4.0])


def to_round_wall(origin: Array, angle: Array) -> Array:
    """Return how far each ray goes in the round room, (n,) m: the larger root of |p + s d - c|^2 = r^2."""
    p = origin - CENTRE
    b = np.cos(angle) * p[:, 0] + np.sin(angle) * p[:, 1]
    return np.asarray(-b + np.sqrt(b * b + 4.0**2 - (p * p).sum(axis=1)))


def test_ranges_in_a_round_room_equal_the_closed_form() -> None:
    lrf = LrfSpec(sigma_range=0.0, sigma_angle_deg=0.0, lost=0.0, x=0.2, y=-0.1, yaw_deg=10.0)
    scenario = Scenario(lrf=lrf, room=ROUND, landmark=Landmark(bottom=1.0))
    robot = SimulatedRobot(scenario, (2.5, 3.0, 0.5), streams(1))
    for _ in range(3):
        robot.drive((3.0, 4.0))  # every ray leaves from a place of its own
    laser = SimulatedLaser(lrf, World(scenario), robot, np.random.default_rng(7))
    measured = laser.read(0.01)["ranges"]
    pose = robot.trail.pose(0.01 + laser.times)
    c, s = np.cos(pose[:, 2]), np.sin(pose[:, 2])
    origin = pose[:, :2] + np.stack((0.2 * c + 0.1 * s, 0.2 * s - 0.1 * c), axis=-1)
    angle = pose[:, 2] + np.radians(10.0 + np.arange(181) - 90.0)
    assert np.abs(measured - to_round_wall(origin, angle)).max() < 1e-6


def test_a_round_wall_is_seen_from_inside_only_and_hides_nothing_before_it() -> None:
    plan = Plan(np.zeros((0, 4)), np.array([[6.0, 4.0, 0.5]]), World(Scenario(room=ROUND)).rings)
    origin = np.array([[4.0, 4.0], [4.0, 4.0], [9.0, 4.0]])
    assert cast(plan, origin, np.array([0.0, np.pi, np.pi])) == pytest.approx([1.5, 4.0, 2.5])
    empty = Plan(np.zeros((0, 4)), np.zeros((0, 3)), World(Scenario(room=ROUND)).rings)
    assert np.isinf(cast(empty, np.array([[9.0, 4.0]]), np.array([np.pi]))).all()


def test_the_camera_sees_the_round_wall_where_it_is() -> None:
    painter = Painter(CameraSpec(), World(Scenario(room=ROUND, landmark=Landmark(x=4.0, y=7.8, radius=0.01))))
    eye = np.array([5.0, 3.0, 0.9, 0.7])
    hits = painter.trace(eye, 0.0)
    wall = hits.surface == 2
    assert wall.mean() > 0.1
    angle = np.arctan2(hits.dy[wall], hits.dx[wall]).astype(float)
    expected = to_round_wall(np.broadcast_to(eye[:2], (len(angle), 2)), angle)
    assert np.abs(hits.way[wall] - expected).max() < 1e-4
    inward = hits.nx[wall] * hits.dx[wall] + hits.ny[wall] * hits.dy[wall]
    assert (inward < 0).all()  # the wall's normal turns against the ray
    assert np.abs(np.hypot(hits.nx[wall], hits.ny[wall]) - 1.0).max() < 1e-5
