"""Every fault does what it says between its labels, and nothing to anything else."""

import functools
import json
import math
from typing import Any

import msgspec
import numpy as np
import pytest
from present import present

from locfuse.fusion.data import ArrayStream, Ragged
from locfuse.sample_logs import faults, scenario as load
from locfuse.sample_logs.camera import Painter
from locfuse.sample_logs.scenario import Leg, Legs, Scenario
from locfuse.sample_logs.simulate import EPOCH_NS, Outcome, Simulation, in_memory
from locfuse.sample_logs.table import RawMessage
from locfuse.sample_logs.world import World

Drive = tuple[dict[str, ArrayStream], Outcome]
# two metres of the default room's first straight, steered on the truth
SHORT = load.load("rounded_rectangle", ("camera.rate=0.5", "control.estimator=truth"))
SHORT = msgspec.structs.replace(SHORT, path=Legs(legs=(Leg(forward=2.0),), x=1.5, y=1.5))
# the same with rays that are exact
EXACT = msgspec.structs.replace(
    SHORT, lrf=msgspec.structs.replace(SHORT.lrf, sigma_range=0.0, sigma_angle_deg=0.0)
)


@functools.cache
def drive(*wrong: Any, scenario: Scenario = SHORT) -> Drive:
    streams, _, outcome = in_memory(msgspec.structs.replace(scenario, faults=wrong), 3)
    return streams, outcome


@pytest.fixture(scope="module")
def clean() -> Drive:
    return drive()


def seconds(stream: ArrayStream) -> np.ndarray[Any, Any]:
    return np.asarray((stream.t_ns - EPOCH_NS) * 1e-9)


def matrix(stream: ArrayStream, field: str) -> np.ndarray[Any, Any]:
    column = stream.data[field]
    assert isinstance(column, Ragged)
    return present(column.matrix())


def same(a: ArrayStream, b: ArrayStream) -> bool:
    """Whether two streams hold the same readings at the same times."""

    def equal(x: Any, y: Any) -> bool:
        if isinstance(x, Ragged):
            return np.array_equal(x.values, y.values)
        return bool(np.array_equal(x, y)) if isinstance(x, np.ndarray) else x == y

    return np.array_equal(a.t_ns, b.t_ns) and all(equal(a.data[k], b.data[k]) for k in a.data)


SENSOR_FAULTS = [
    (faults.Dropout(start=2, end=5, sensor="compass"), "/compass"),
    (faults.Latency(start=2, end=5, sensor="lrf", seconds=0.2), "/scan"),
    (faults.ClockOffset(sensor="truth", seconds=0.3), "/ground_truth/pose"),
    (faults.Magnetic(start=2, end=5, x=3, y=2.5, strength=5e-6), "/compass"),
    (faults.EncoderSpike(start=3, end=3.03, wheel="left"), "/joint_states"),
    (faults.EncoderRollover(bits=12), "/joint_states"),
    (faults.HiddenLandmark(start=2, end=5), "/omni/image/compressed"),
    (faults.ClockOffset(sensor="lrf", drift_ppm=500.0), "/scan"),
    (faults.ClockOffset(sensor="wheels", jitter=0.005), "/joint_states"),
    (faults.Displaced(start=4, sensor="lrf", x=0.02, y=-0.01, yaw_deg=3.0), "/scan"),
    (faults.Displaced(start=4, sensor="camera", yaw_deg=3.0), "/omni/image/compressed"),
    (faults.Displaced(sensor="compass", yaw_deg_per_s=0.5), "/compass"),
    (faults.Displaced(sensor="truth", x=0.06, y=0.03), "/ground_truth/pose"),
    (faults.TruthStep(start=4, x=0.06, theta_deg=2.0), "/ground_truth/pose"),
]


@pytest.mark.parametrize(("fault", "topic"), SENSOR_FAULTS, ids=lambda v: type(v).__name__)
def test_a_sensors_fault_changes_it_and_not_one_bit_of_another(fault: Any, topic: str, clean: Drive) -> None:
    streams, _ = drive(fault)
    for other, stream in clean[0].items():
        assert same(stream, streams[other]) == (other != topic), other


def test_labels_frame_every_fault_with_its_settings(clean: Drive) -> None:
    assert "/faults" not in clean[0]
    slip = faults.Slip(start=3.0, end=4.5, wheel="left", ratio=0.3)
    whole_drive = faults.ClockOffset(sensor="lrf", seconds=0.1)
    labels = drive(slip, whole_drive)[0]["/faults"]
    texts = labels.data["data"]
    assert isinstance(texts, list)
    begin_whole, begin, end = (json.loads(text) for text in texts)
    np.testing.assert_allclose(seconds(labels), [0.0, 3.0, 4.5])
    assert begin == {"event": "begin", "kind": "slip", "start": 3.0, "end": 4.5, "wheel": "left", "ratio": 0.3}
    assert end == {**begin, "event": "end"}
    assert begin_whole["kind"] == "clock_offset"
    assert begin_whole["end"] is None


def test_a_dropout_loses_the_interval_and_keeps_the_rest_as_it_was(clean: Drive) -> None:
    t, t_clean = (seconds(s["/compass"]) for s in (drive(SENSOR_FAULTS[0][0])[0], clean[0]))
    assert not ((t >= 2) & (t < 5)).any()
    np.testing.assert_array_equal(t, t_clean[(t_clean < 2) | (t_clean >= 5)])


def arrivals(fault: Any) -> list[tuple[int, int]]:
    """Return (stamp, arrival) of every scan."""
    blind = msgspec.structs.replace(SHORT.camera, enabled=False)
    simulation = Simulation(msgspec.structs.replace(SHORT, faults=(fault,), camera=blind), 3)
    scans: list[tuple[int, int]] = []

    def emit(message: RawMessage) -> None:
        if message.topic == "/scan":
            scans.append((message.stamp_ns, message.log_ns))

    simulation.run(None, emit)
    return scans


def test_latency_delays_and_may_date_on_arrival() -> None:
    late = arrivals(faults.Latency(start=2, end=5, sensor="lrf", seconds=0.3))
    well_dated = arrivals(faults.Latency(start=2, end=5, sensor="lrf", seconds=0.3, dated_on_arrival=False))
    normal = arrivals(faults.Latency(start=100, end=101, sensor="lrf", seconds=0.3))
    for (stamp, log), (good_stamp, good_log), (stamp0, log0) in zip(late, well_dated, normal, strict=True):
        inside = 2 <= (stamp0 - EPOCH_NS) * 1e-9 < 5
        assert stamp - stamp0 == (300_000_000 if inside else 0)
        assert good_stamp == stamp0
        assert log == good_log
        assert log >= log0 + (300_000_000 if inside else 0)
    assert np.diff([log for _, log in late]).min() > 0  # nobody overtakes


def test_a_clock_offset_moves_stamps_and_not_arrivals() -> None:
    ahead = arrivals(faults.ClockOffset(sensor="lrf", seconds=0.4))
    normal = arrivals(faults.Latency(start=100, end=101, sensor="lrf", seconds=0.3))
    assert all(a[0] - b[0] == 400_000_000 and a[1] == b[1] for a, b in zip(ahead, normal, strict=True))


def delays(fault: faults.ClockOffset, topic: str, clean: Drive) -> tuple[Any, Any]:
    """Return when the readings of a topic were taken, and by how much their stamps are later [s]."""
    taken = seconds(clean[0][topic])
    return taken, seconds(drive(fault)[0][topic]) - taken


def test_a_clock_that_runs_too_fast_is_ahead_by_more_and_more(clean: Drive) -> None:
    taken, ahead = delays(
        faults.ClockOffset(start=2.0, sensor="lrf", seconds=0.01, drift_ppm=500.0), "/scan", clean
    )
    expected = np.where(taken < 2.0, 0.0, 0.01 + 5e-4 * (taken - 2.0))
    np.testing.assert_allclose(ahead, expected, atol=1e-8)


def test_jitter_scatters_the_stamps_of_the_wheels_and_keeps_their_order(clean: Drive) -> None:
    _, ahead = delays(faults.ClockOffset(sensor="wheels", jitter=0.005), "/joint_states", clean)
    n = len(ahead)
    assert n > 300
    assert abs(ahead.mean()) < 4 * 0.005 / math.sqrt(n)
    assert ahead.std() == pytest.approx(0.005, rel=4 / math.sqrt(2 * n))
    wild = drive(faults.ClockOffset(sensor="wheels", jitter=0.05))[0]["/joint_states"]
    assert not wild.dropped  # none is dated before its predecessor
    assert np.diff(wild.t_ns).min() > 0


def hits(streams: dict[str, ArrayStream], outcome: Outcome, mount: tuple[float, float, float]) -> Any:
    """Return where the rays of every scan end in the map (n, 181, 2) m, of a laser at `mount` = m, m, degrees."""
    scan = streams["/scan"]
    ranges, t = matrix(scan, "ranges"), seconds(scan)[:, None] + np.linspace(0, 0.025, 181)
    x, y, theta = (np.interp(t, outcome.truth_t, outcome.truth[:, k]) for k in range(3))
    laser_x = x + np.cos(theta) * mount[0] - np.sin(theta) * mount[1]
    laser_y = y + np.sin(theta) * mount[0] + np.cos(theta) * mount[1]
    angle = theta + np.radians(mount[2]) + np.radians(np.linspace(-90, 90, 181))
    return np.stack((laser_x + ranges * np.cos(angle), laser_y + ranges * np.sin(angle)), axis=-1)


def off_the_back_wall(scan: Any) -> float:
    """Return how far the rays that look along +x end from the wall at x = 8 m, rms [m]."""
    ends = scan[:, 85:96]
    on_wall = (ends[..., 1] > 0.5) & (ends[..., 1] < 2.5)
    return float(np.sqrt(np.mean((ends[on_wall][:, 0] - 8.0) ** 2)))


def test_a_bumped_laser_sees_the_same_walls_from_its_new_place() -> None:
    bumped = faults.Displaced(start=4.0, sensor="lrf", x=0.2, y=-0.1, yaw_deg=10.0)
    streams, outcome = drive(bumped, scenario=EXACT)
    late = seconds(streams["/scan"]) > 4.0
    assert late.sum() > 20
    as_told, as_it_is = (hits(streams, outcome, mount) for mount in ((0.2, 0.0, 0.0), (0.4, -0.1, 10.0)))
    assert off_the_back_wall(as_told[~late]) < 2e-3
    assert off_the_back_wall(as_it_is[late]) < 2e-3
    assert off_the_back_wall(as_told[late]) > 0.1


def test_a_laser_of_a_wrong_scale_reads_a_share_of_every_range() -> None:
    short = msgspec.structs.replace(EXACT, lrf=msgspec.structs.replace(EXACT.lrf, scale=0.98))
    read, true = (matrix(drive(scenario=s)[0]["/scan"], "ranges") for s in (short, EXACT))
    seen = np.isfinite(true)
    np.testing.assert_allclose(read[seen], 0.98 * true[seen], rtol=1e-5)


def field_turn(fault: Any, clean: Drive) -> tuple[Any, Any]:
    """Return the times of the compass and by how many degrees the field turned in its axes."""
    now, then = (
        np.arctan2(np.asarray(c.data["magnetic_field.y"]), np.asarray(c.data["magnetic_field.x"]))
        for c in (drive(fault)[0]["/compass"], clean[0]["/compass"])
    )
    return seconds(clean[0]["/compass"]), np.degrees((now - then + np.pi) % (2 * np.pi) - np.pi)


def test_a_compass_that_twists_on_its_mount_sees_north_turn_the_other_way(clean: Drive) -> None:
    t, jump = field_turn(faults.Displaced(start=4.0, sensor="compass", yaw_deg=10.0), clean)
    np.testing.assert_allclose(jump[t < 4.0], 0.0, atol=1e-12)
    np.testing.assert_allclose(jump[t >= 4.0], -10.0, atol=0.5)  # soft iron and steps of 0.1 degrees
    t, drift = field_turn(faults.Displaced(start=2.0, sensor="compass", yaw_deg_per_s=1.5), clean)
    np.testing.assert_allclose(drift, -1.5 * np.maximum(t - 2.0, 0.0), atol=0.5)


def truth_of(streams: dict[str, ArrayStream]) -> Any:
    """Return the poses (n, 3) of the truth as the log has them."""
    data = streams["/ground_truth/pose"].data
    turn = 2 * np.arctan2(np.asarray(data["pose.orientation.z"]), np.asarray(data["pose.orientation.w"]))
    return np.stack((np.asarray(data["pose.position.x"]), np.asarray(data["pose.position.y"]), turn), axis=-1)


def test_a_marker_off_the_axle_is_carried_round_by_the_heading() -> None:
    curve = msgspec.structs.replace(SHORT, path=Legs(legs=(Leg(turn_deg=90.0),), x=4.0, y=3.0))
    marker = faults.Displaced(sensor="truth", x=0.06, y=0.03)
    at, axle = truth_of(drive(marker, scenario=curve)[0]), truth_of(drive(scenario=curve)[0])
    assert np.ptp(axle[:, 2]) > 1.5
    seen = (at[:, 0] - axle[:, 0]) + 1j * (at[:, 1] - axle[:, 1])
    np.testing.assert_allclose(seen * np.exp(-1j * axle[:, 2]), 0.06 + 0.03j, atol=1e-9)
    np.testing.assert_allclose(at[:, 2], axle[:, 2], atol=1e-12)


def test_the_frame_of_the_truth_steps_at_one_instant_and_returns(clean: Drive) -> None:
    step = faults.TruthStep(start=4.0, end=6.0, x=0.06, y=-0.02, theta_deg=2.0)
    at, before, t = truth_of(drive(step)[0]), truth_of(clean[0]), seconds(clean[0]["/ground_truth/pose"])
    inside = (t >= 4.0) & (t < 6.0)
    np.testing.assert_array_equal(at[~inside], before[~inside])
    seen, was = (p[inside, 0] + 1j * p[inside, 1] for p in (at, before))
    np.testing.assert_allclose(seen, 0.06 - 0.02j + was * np.exp(1j * math.radians(2.0)), atol=1e-9)
    np.testing.assert_allclose(at[inside, 2] - before[inside, 2], math.radians(2.0), atol=1e-9)


def test_the_truth_has_the_noise_that_the_scenario_says_and_no_other_sensor_has_it(clean: Drive) -> None:
    noisy = msgspec.structs.replace(SHORT, truth=msgspec.structs.replace(SHORT.truth, noise=0.004, noise_deg=0.3))
    streams, _ = drive(scenario=noisy)
    off = truth_of(streams) - truth_of(clean[0])
    n = len(off)
    allowed = 4 / math.sqrt(2 * n)
    np.testing.assert_allclose(off.std(axis=0), (0.004, 0.004, math.radians(0.3)), rtol=allowed)
    assert np.abs(off.mean(axis=0) / off.std(axis=0)).max() < 4 / math.sqrt(n)
    assert all(same(stream, streams[topic]) for topic, stream in clean[0].items() if "truth" not in topic)


def test_the_stated_start_is_wrong_by_the_users_error() -> None:
    wrong = msgspec.structs.replace(SHORT.start, error=(0.1, -0.2, 4.0))
    told, right = (
        Simulation(msgspec.structs.replace(SHORT, start=start), 3).robot_tables["start"]
        for start in (wrong, SHORT.start)
    )
    assert set(told) == {"x", "y", "theta_deg"}  # and called exact
    assert {k: round(told[k] - right[k], 9) for k in told} == {"x": 0.1, "y": -0.2, "theta_deg": 4.0}


def test_an_uncalibrated_cameras_optics_are_not_in_robot_toml() -> None:
    camera = msgspec.structs.replace(SHORT.camera, calibrated=False)
    tables = Simulation(msgspec.structs.replace(SHORT, camera=camera), 3).robot_tables["camera"]
    assert set(tables) == {"topic", "landmark", "x", "y", "yaw_deg", "sigma_deg"}


def test_a_magnet_is_a_dipole() -> None:
    """On its axis the field is 2 m / r^3 along it, across it m / r^3 against it."""
    magnet = faults.Magnetic(x=1.0, y=2.0, strength=4e-6, axis_deg=90.0)
    points = np.array([[1.0, 3.0], [1.0, 4.0], [3.0, 2.0]])
    expected = np.array([[0.0, 8e-6], [0.0, 1e-6], [0.0, -0.5e-6]])
    np.testing.assert_allclose(magnet.field(points), expected, atol=1e-12)


def test_a_slipping_wheel_rolls_further_than_it_carries() -> None:
    still = msgspec.structs.replace(SHORT, wheels=msgspec.structs.replace(SHORT.wheels, noise=0.0))
    slip = faults.Slip(start=3.0, end=4.0, wheel="right", ratio=0.25)
    _, outcome = drive(slip, scenario=still)
    ticks = np.searchsorted(outcome.ticks_t, (3.0 - 1e-6, 4.0 - 1e-6))
    rolled = np.diff(outcome.counts[ticks], axis=0)[0] * outcome.rad_per_count * 0.05
    before, after = (outcome.truth[i * 4] for i in ticks)
    turned = ((1 - 0.25) * rolled[1] - rolled[0]) / 0.6
    assert after[2] - before[2] == pytest.approx(turned, abs=1e-3)


def ways(fault: Any) -> tuple[float, float, float, float]:
    """Return how far [m] the wheels rolled and the robot went ahead and to its left, and its mean heading."""
    still = msgspec.structs.replace(SHORT, wheels=msgspec.structs.replace(SHORT.wheels, noise=0.0))
    _, outcome = drive(fault, scenario=still)
    x, y, theta = outcome.truth.T
    middle = (theta[1:] + theta[:-1]) / 2
    ahead = np.diff(x) * np.cos(middle) + np.diff(y) * np.sin(middle)
    left = np.diff(y) * np.cos(middle) - np.diff(x) * np.sin(middle)
    assert np.ptp(theta) < 0.05
    rolled = float((outcome.counts[-1] - outcome.counts[0]).mean()) * outcome.rad_per_count * outcome.radius
    return rolled, float(ahead.sum()), float(left.sum()), float(np.average(middle, weights=np.abs(ahead)))


def test_slip_and_creep_take_their_share_of_the_way() -> None:
    rolled, ahead, left, _ = ways(faults.Slip(wheel="both", ratio=0.1))
    assert ahead == pytest.approx(0.9 * rolled, abs=3e-4)
    assert left == pytest.approx(0.0, abs=1e-6)
    rolled, ahead, left, _ = ways(faults.Creep(ratio=0.02))
    assert ahead == pytest.approx(rolled, abs=3e-4)  # a count is 0.16 mm
    assert left == pytest.approx(0.02 * rolled, abs=1e-5)
    rolled, ahead, left, heading = ways(faults.Creep(ratio=0.02, downhill_deg=-60.0))
    down = math.radians(-60) - heading
    assert ahead == pytest.approx(rolled * (1 + 0.02 * math.cos(down)), abs=3e-4)
    assert left == pytest.approx(0.02 * rolled * math.sin(down), abs=1e-4)


def test_a_kidnapped_robot_is_carried_while_its_wheels_turn_in_the_air() -> None:
    kidnap = faults.Kidnap(start=4.0, end=5.0, x=0.2, y=0.4, theta_deg=30.0)
    _, outcome = drive(kidnap)
    i, j = np.searchsorted(outcome.truth_t, (4.0 - 1e-6, 5.0 - 1e-6))
    np.testing.assert_allclose(outcome.truth[j] - outcome.truth[i], (0.2, 0.4, math.radians(30)), atol=1e-9)
    k, m = np.searchsorted(outcome.ticks_t, (4.0 - 1e-6, 5.0 - 1e-6))
    assert (outcome.counts[m] - outcome.counts[k]).min() > 500
    steps = np.hypot(*np.diff(outcome.truth[i : j + 1, :2], axis=0).T)
    assert steps.max() == pytest.approx(steps.min(), rel=1e-6)  # carried evenly, not thrown


def test_a_spike_jumps_and_returns_and_a_counter_of_12_bits_unwraps(clean: Drive) -> None:
    spiked = matrix(drive(SENSOR_FAULTS[4][0])[0]["/joint_states"], "position")
    jump = np.round((spiked - matrix(clean[0]["/joint_states"], "position")) * 2000 / (2 * np.pi))
    assert np.flatnonzero(jump[:, 0]).tolist() == [150, 151]  # 3.00 s and 3.02 s
    assert set(jump[:, 0]) == {0.0, 5000.0}
    assert not jump[:, 1].any()
    step = 2 * np.pi / 2000
    rolled = matrix(drive(SENSOR_FAULTS[5][0])[0]["/joint_states"], "position") / step
    assert rolled.min() >= -2048
    assert rolled.max() <= 2047
    assert (np.abs(np.diff(rolled[:, 0])) > 2048).sum() >= 2
    unwrapped = np.unwrap(np.round(rolled), period=4096, axis=0)
    np.testing.assert_allclose(unwrapped, matrix(clean[0]["/joint_states"], "position") / step, atol=1e-6)


def test_people_shorten_rays_while_they_are_there_and_only_towards_them(clean: Drive) -> None:
    person = faults.People(start=2.0, end=6.0, path=((5.0, 2.5), (5.0, 0.8)))
    scan, empty = drive(person)[0]["/scan"], clean[0]["/scan"]
    shorter = matrix(scan, "ranges") < matrix(empty, "ranges") - 0.5
    t = seconds(scan)
    inside = (t >= 2) & (t < 6)
    assert shorter[inside].any(axis=1).mean() > 0.8
    assert not shorter[~inside].any()
    directions = np.flatnonzero(shorter.any(axis=0)) - 90.0  # deg, legs of 14 cm at 2 to 3 m ahead
    assert directions.min() > -30
    assert directions.max() < 35


def red_pixels(t: float, *wrong: Any) -> int:
    scenario = Scenario(faults=wrong)
    image = Painter(scenario.camera, World(scenario)).paint(np.array([4.0, 3.0, 0.0]), t)
    return int(((image[..., 0] > 40) & (image[..., 0] > 3 * image[..., 1])).sum())


def test_a_hidden_landmark_is_not_red_and_a_red_object_is() -> None:
    hidden = faults.HiddenLandmark(start=2.0, end=5.0)
    assert red_pixels(1.9, hidden) == red_pixels(1.9) > 50
    assert red_pixels(2.1, hidden) == 0
    impostor = faults.RedObject(start=2.0, end=5.0, x=2.0, y=2.0, radius=0.08)
    assert red_pixels(1.9, impostor) == red_pixels(1.9)
    assert red_pixels(2.1, impostor) > 1.5 * red_pixels(1.9)
