"""Every fault does what it says between its labels, and nothing to anything else."""

from __future__ import annotations

import functools
import json
import math
from typing import Any

import msgspec
import numpy as np
import pytest

from locfuse.fusion.data import ArrayStream, LocfuseError, Ragged
from locfuse.sample_logs import faults, load
from locfuse.sample_logs.camera import Painter
from locfuse.sample_logs.messages import RawMessage
from locfuse.sample_logs.record import in_memory
from locfuse.sample_logs.scenario import Leg, Legs, Scenario
from locfuse.sample_logs.simulate import EPOCH_NS, Outcome, Simulation
from locfuse.sample_logs.world import Scene

Drive = tuple[dict[str, ArrayStream], Outcome]
# two metres of the default room's first straight, steered on the truth
SHORT = load.load("rounded_rectangle", ("camera.rate=0.5", "control.estimator=truth"))
SHORT = msgspec.structs.replace(SHORT, path=Legs(legs=(Leg(forward=2.0),), x=1.5, y=1.5))


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
    rows = column.matrix()
    assert rows is not None
    return rows


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
]


@pytest.mark.parametrize(("fault", "topic"), SENSOR_FAULTS, ids=lambda v: type(v).__name__)
def test_a_sensors_fault_changes_that_sensor_and_not_one_bit_of_another(
    fault: Any, topic: str, clean: Drive
) -> None:
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


def test_a_magnet_is_a_dipole() -> None:
    """On its axis the field is 2 m / r^3 along it, across it m / r^3 against it."""
    magnet = faults.Magnetic(x=1.0, y=2.0, strength=4e-6, axis_deg=90.0)
    points = np.array([[1.0, 3.0], [1.0, 4.0], [3.0, 2.0]])
    expected = np.array([[0.0, 8e-6], [0.0, 1e-6], [0.0, -0.5e-6]])
    np.testing.assert_allclose(magnet.field(points), expected, atol=1e-12)


def test_the_disturbed_log_bends_the_compass_by_tens_of_degrees() -> None:
    scenario = load.load("disturbed", ("camera.enabled=false", "lrf.enabled=false", "control.estimator=truth"))
    streams, _, outcome = in_memory(scenario, 1)
    compass = streams["/compass"]
    t = seconds(compass)
    heading = math.radians(65) - np.arctan2(
        np.asarray(compass.data["magnetic_field.y"]), np.asarray(compass.data["magnetic_field.x"])
    )
    error = heading - np.interp(t, outcome.truth_t, outcome.truth[:, 2])
    error = np.degrees((error + np.pi) % (2 * np.pi) - np.pi)
    inside = (t >= 9) & (t < 22)
    assert 20 < np.abs(error[inside]).max() < 90
    assert np.abs(error[~inside]).max() < 5


def test_a_slipping_wheel_rolls_further_than_it_carries() -> None:
    still = msgspec.structs.replace(SHORT, wheels=msgspec.structs.replace(SHORT.wheels, noise=0.0))
    slip = faults.Slip(start=3.0, end=4.0, wheel="right", ratio=0.25)
    _, outcome = drive(slip, scenario=still)
    ticks = np.searchsorted(outcome.ticks_t, (3.0 - 1e-6, 4.0 - 1e-6))
    rolled = np.diff(outcome.counts[ticks], axis=0)[0] * outcome.rad_per_count * 0.05
    before, after = (outcome.truth[i * 4] for i in ticks)
    turned = ((1 - 0.25) * rolled[1] - rolled[0]) / 0.6
    assert after[2] - before[2] == pytest.approx(turned, abs=1e-3)


def test_a_kidnapped_robot_is_carried_while_its_wheels_turn_in_the_air() -> None:
    kidnap = faults.Kidnap(start=4.0, end=5.0, x=0.2, y=0.4, theta_deg=30.0)
    _, outcome = drive(kidnap)
    i, j = np.searchsorted(outcome.truth_t, (4.0 - 1e-6, 5.0 - 1e-6))
    np.testing.assert_allclose(outcome.truth[j] - outcome.truth[i], (0.2, 0.4, math.radians(30)), atol=1e-9)
    k, m = np.searchsorted(outcome.ticks_t, (4.0 - 1e-6, 5.0 - 1e-6))
    assert (outcome.counts[m] - outcome.counts[k]).min() > 500
    steps = np.hypot(*np.diff(outcome.truth[i : j + 1, :2], axis=0).T)
    assert steps.max() == pytest.approx(steps.min(), rel=1e-6)  # carried evenly, not thrown


def test_a_spike_jumps_and_returns(clean: Drive) -> None:
    spiked = matrix(drive(SENSOR_FAULTS[4][0])[0]["/joint_states"], "position")
    jump = np.round((spiked - matrix(clean[0]["/joint_states"], "position")) * 2000 / (2 * np.pi))
    assert np.flatnonzero(jump[:, 0]).tolist() == [150, 151]  # 3.00 s and 3.02 s
    assert set(jump[:, 0]) == {0.0, 5000.0}
    assert not jump[:, 1].any()


def test_a_counter_of_12_bits_rolls_over_and_unwraps_to_the_true_one(clean: Drive) -> None:
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
    image = Painter(scenario.camera, Scene(scenario)).paint(np.array([4.0, 3.0, 0.0]), t)
    return int(((image[..., 0] > 40) & (image[..., 0] > 3 * image[..., 1])).sum())


def test_a_hidden_landmark_is_not_red_and_a_red_object_is() -> None:
    hidden = faults.HiddenLandmark(start=2.0, end=5.0)
    assert red_pixels(1.9, hidden) == red_pixels(1.9) > 50
    assert red_pixels(2.1, hidden) == 0
    impostor = faults.RedObject(start=2.0, end=5.0, x=2.0, y=2.0, radius=0.08)
    assert red_pixels(1.9, impostor) == red_pixels(1.9)
    assert red_pixels(2.1, impostor) > 1.5 * red_pixels(1.9)


@pytest.mark.parametrize(
    ("table", "what"),
    [
        ({"kind": "magnetic", "x": 1, "y": 1, "strength": 1, "start": 5, "end": 4}, "end = 4 must come after"),
        ({"kind": "people", "path": [[1, 1], [2, 2]]}, "a walk needs an `end`"),
        ({"kind": "kidnap", "x": 1, "y": 1}, "a kidnapping needs an `end`"),
        ({"kind": "slip", "wheel": "left", "ratio": 1.5}, "`float` <= 1.0 - at `faults[0].ratio`"),
    ],
)  # fmt: skip
def test_impossible_faults_are_refused_with_their_place(table: dict[str, Any], what: str) -> None:
    with pytest.raises(LocfuseError) as error:
        load.convert({"faults": [table]}, "mine.toml", LocfuseError)
    assert what in str(error.value)
    assert "faults[0]" in str(error.value)
