"""What every sensor of the registry owes the house: a new one is held to it by being registered."""

import copyreg
import math
from collections.abc import Iterator, Sequence
from copy import deepcopy
from itertools import combinations
from typing import Any

import msgspec
import numpy as np
import pytest
import six_sensors
from msgspec.structs import replace
from present import present
from rows import one_by_one, said

from locfuse.cli.analysis.results import settings_tables
from locfuse.cli.analysis.robot_tables import make_robot
from locfuse.formats.robot import robot_toml
from locfuse.fusion.data import Array, ArrayStream, LocfuseError, Measurements, Ragged
from locfuse.fusion.ekf.belief_arrays import JointBelief
from locfuse.fusion.fuse import Filter, due_readings, steps_of
from locfuse.fusion.kernels.ekf import Innovation
from locfuse.fusion.kernels.sight import WallColumns
from locfuse.fusion.map.line_map import Association
from locfuse.fusion.robot import Robot
from locfuse.fusion.sensor import Model, Reversal, Sensor
from locfuse.fusion.sensors.compass import CompassSettings
from locfuse.fusion.sensors.gyro import GyroSettings
from locfuse.fusion.sensors.lrf import LrfSettings
from locfuse.fusion.sensors.registry import REGISTRY, needed, unmet

SENSORS = [pytest.param(sensor, id=name) for name, sensor in REGISTRY.items()]
UNITS = {"m": 1.0, "deg": math.degrees(1.0), "deg/s": math.degrees(1.0), "m/s": 1.0, "%": 100.0}
each_sensor = pytest.mark.parametrize("sensor", SENSORS)


# ---- settings ----


@each_sensor
def test_settings_survive_robot_toml(sensor: Sensor) -> None:
    """As they are by default, and with every number, switch and choice changed."""
    for settings in (sensor.Settings(), changed(sensor.Settings())):
        robot = make_robot({})
        robot = replace(robot, sensors={**robot.sensors, sensor.name: settings})
        again = make_robot(robot_toml.parse(robot_toml.dump(settings_tables(robot)), "robot.toml"))
        assert again.settings(sensor.name) == settings


def changed(settings: Any) -> Any:
    """Settings in which every number that may be is another one, and every switch is turned."""
    for name in settings.__struct_fields__:
        old = getattr(settings, name)
        new = not old if isinstance(old, bool) else old * 0.75 if isinstance(old, float) else old
        try:
            settings = msgspec.structs.replace(settings, **{name: new})
            type(settings)(**msgspec.structs.asdict(settings))
        except ValueError:
            settings = msgspec.structs.replace(settings, **{name: old})
    return settings


@each_sensor
def test_a_sensor_speaks_of_keys_that_its_table_has_and_asks_in_words(sensor: Sensor) -> None:
    keys = set(sensor.Settings.__struct_fields__)
    bias = [key for key in sensor.bias[::3] if key is not None] if sensor.bias else []
    others = [key for key in (sensor.drift_key, sensor.scale_key) if key is not None]
    assert {*sensor.noise_keys, *sensor.asks, *sensor.guesses, *bias, *others} <= keys
    assert sensor.drift_key is None or sensor.bias is not None
    for msgtype in sensor.reads:
        assert any(sensor.concerns(key, msgtype) for key in keys)
    for key, ask in sensor.asks.items():
        assert len(ask.words.split()) > 3, key
        assert key in sensor.Settings.__struct_fields__
        assert not ask.needed or sensor.missing(sensor.Settings()) is not None
    for key, words in sensor.guesses.items():
        assert words.startswith("guess: "), key
    missing = sensor.missing(sensor.Settings())
    assert missing is None or f"{sensor.name}." in missing


@each_sensor
def test_its_first_sigma_is_in_the_unit_of_its_first_number(sensor: Sensor) -> None:
    """So that a verdict on its noise names a value that can be written as it stands."""
    in_degrees = sensor.noise_keys[0].endswith("_deg")
    assert (sensor.components[0].unit == "deg") == in_degrees
    for key in sensor.noise_keys:
        assert getattr(sensor.Settings(), key) > 0.0
    with pytest.raises(ValueError, match=sensor.noise_keys[0]):
        sensor.Settings(**dict[str, Any]({sensor.noise_keys[0]: 0.0}))


# ---- needs ----


@each_sensor
def test_a_sensor_needs_registered_others_and_says_why(sensor: Sensor) -> None:
    assert sensor.name not in needed(sensor.name)
    assert set(needed(sensor.name)) <= set(REGISTRY)
    everybody = set(REGISTRY)
    assert sensor.name not in unmet(everybody)
    for other, why in sensor.needs.items():
        assert unmet(everybody - {other})[sensor.name] == f"it is {why}, and that is absent"


# ---- measuring ----


@each_sensor
def test_measurements_have_the_numbers_that_it_names_later_by_its_time_offset(sensor: Sensor) -> None:
    m = six_sensors.drive()[0].measurements[sensor.name]
    d = len(sensor.components)
    assert m.z.shape[1] == d
    assert m.R_unit.shape[1:] == m.floor.shape == (d, d)
    assert m.first[-1] == len(m.z) > 0
    assert (np.diff(m.t) >= 0.0).all()
    drive, robot = six_sensors.drive()
    stream: Any = six_sensors.streams()[0][sensor.name]
    settings = robot.settings(sensor.name)
    later = msgspec.structs.replace(settings, time_offset=settings.time_offset + 0.5)
    before, after = (sensor.measure(stream, s, drive.wheels, drive.epoch_ns) for s in (settings, later))
    assert after.t[0] - before.t[0] == pytest.approx(0.5, abs=0.06)  # some sum readings up to full periods


@each_sensor
def test_nothing_measured_is_nothing_or_one_line(sensor: Sensor) -> None:
    """No message at all, every number NaN, every number 0: measurements that are finite, or a LocfuseError."""
    drive, robot = six_sensors.drive()
    stream: Any = six_sensors.streams()[0][sensor.name]
    part = getattr(stream, "parts", (stream,))[0]
    for value in (None, math.nan, 0.0):
        spoilt = filled(part, sensor.reads[part.msgtype], value)
        try:
            m = sensor.measure(spoilt, robot.settings(sensor.name), drive.wheels, drive.epoch_ns)
        except LocfuseError as e:
            words = str(e)
        else:
            words = f"{sensor.name}: "
            assert np.isfinite(m.z).all()
            assert np.isfinite(m.R_unit).all()
            assert m.first[0] == 0
            assert m.first[-1] == len(m.z)
            assert len(m.first) == len(m.t) + 1
        assert "\n" not in words
        assert words.startswith((f"{sensor.name}: ", f"{spoilt.topic}: "))


@each_sensor
def test_one_damaged_reading_leaves_the_others_as_they_are(sensor: Sensor) -> None:
    drive, robot = six_sensors.drive()
    stream: Any = six_sensors.streams()[0][sensor.name]
    part = getattr(stream, "parts", (stream,))[0]
    fields = sensor.reads[part.msgtype]
    whole = ArrayStream(part.topic, part.msgtype, part.t_ns, dict(part.columns(*fields)), part.frame_id)
    columns: dict[str, Any] = {name: damaged_row(column, 7) for name, column in whole.data.items()}
    settings = robot.settings(sensor.name)
    before = sensor.measure(whole, settings, drive.wheels, drive.epoch_ns)
    m = sensor.measure(replace(whole, data=columns), settings, drive.wheels, drive.epoch_ns)
    assert np.isfinite(m.z).all()
    lost = set(before.t.tolist()) - set(m.t.tolist())
    assert len(lost) <= 1
    assert len(before.z) - len(m.z) < 10


def filled(stream: ArrayStream, fields: tuple[str, ...], value: float | None) -> ArrayStream:
    """Return the stream with all its numbers the same, its text and bytes empty; None: without any message."""
    columns: dict[str, Any] = {}
    rows, number = slice(None if value is not None else 0), value or 0.0
    for name, column in stream.columns(*fields).items():
        if isinstance(column, Ragged):
            first = column.first if value is not None else column.first[:1]
            columns[name] = Ragged(np.full_like(column.values, number)[rows], first)
        elif isinstance(column, list):
            columns[name] = [type(v)() for v in column[rows]]
        else:
            columns[name] = np.full_like(column, number if column.dtype.kind == "f" else 0)[rows]
    return ArrayStream(stream.topic, stream.msgtype, stream.t_ns[rows], columns)


def damaged_row(column: Any, i: int) -> Any:
    """Return a column whose row i holds nothing that is a number."""
    if isinstance(column, list):
        return [b"" if k == i and isinstance(v, bytes) else v for k, v in enumerate(column)]
    column = deepcopy(column)
    row = column[i] if isinstance(column, Ragged) else column[i : i + 1]
    if row.dtype.kind == "f":
        row[...] = math.nan
    return column


# ---- Jacobians ----

ANTENNA = {"x": 0.3, "y": 0.1}
CERTAIN_GPS = {"east_deg": 20.0, **ANTENNA}
VARIANTS: dict[str, list[dict[str, dict[str, Any]]]] = {
    "compass": [{}, {"compass": {"offset_deg": 10.0}}],
    "lrf": [{}, {"lrf": {"map": "first-scan"}}, {"lrf": {"sigma_x": 0.02, "sigma_y": 0.02, "sigma_yaw_deg": 1.0}}],
    "camera": [{}, {"camera": {"sigma_x": 0.02, "sigma_y": 0.02, "sigma_yaw_deg": 1.0}}],
    "sonar": [{}, {"lrf": {"map": "first-scan"}}],
    "gps": [{"gps": ANTENNA}, {"gps": CERTAIN_GPS}, {"gps": {**CERTAIN_GPS, "origin": (48.0, 11.0)}}],
    "gyro": [{}, {"gyro": {"bias_deg": 0.5}}],
    "landmarks": [
        {"landmarks": settings}
        for settings in ({}, {"range_offset": 0.1}, {"file": "seen.csv"}, {"range_depth": 1.0})
    ],
    "pose": [{}, {"pose": {"frame": "drift"}}, {"pose": {"frame": "map", "gate": 1.0}}],
    "twist": [{}],
}
STEP = 1e-6


@each_sensor
def test_jacobians_are_the_derivatives_of_the_innovation(sensor: Sensor) -> None:
    """By central differences: standing still, across the heading pi, and at readings in between.

    H = dh/dstate = -d(z - h)/dstate, by the pose and by every state that the sensor names.
    """
    drive, robot = six_sensors.drive()
    for variant in VARIANTS.get(sensor.name, [{}]):
        used = (*needed(sensor.name), sensor.name)
        checked = 0
        for seen, model, m, i, belief in walked(with_settings(robot, variant), used, sensor.name):
            checked += check(seen, model, m, i, belief)
        assert checked >= (3 if sensor.name == "camera" else 8), (variant, drive.absent)


def test_the_bearing_to_a_near_landmark_has_the_right_derivative() -> None:
    """A hand's breadth away its direction changes by 5 rad per metre."""
    _, robot = six_sensors.drive()
    x, y = robot.settings("camera").landmark
    for seen, model, m, i, belief in walked(robot, ("camera",), "camera"):
        if not seen:
            continue
        for away in ((-0.3, 0.0), (0.1, 0.1), (0.0, -0.2)):
            near = copy_of(belief)
            near.place((x + away[0], y + away[1], math.pi), 1e-4, 1e-4)
            near.begin()
            assert check(one_by_one(copied(model).innovations(m, i, near)), model, m, i, near) == 1


def with_settings(robot: Robot, changes: dict[str, dict[str, Any]]) -> Robot:
    sensors = {s: msgspec.structs.replace(c, **changes.get(s, {})) for s, c in robot.sensors.items()}
    return replace(robot, sensors=sensors)


def walked(
    robot: Robot, sensors: tuple[str, ...], of: str
) -> Iterator[tuple[Sequence[Innovation], Model, Measurements, int, JointBelief]]:
    """Run the filter; yield what one sensor makes of some readings, with copies of its model and the belief."""
    drive, _ = six_sensors.drive()
    m = drive.measurements[of]
    run = Filter(robot, sensors)
    at_pi = np.argsort(np.abs(true_heading(m.t) - math.pi))[:2]
    wanted = {1, 2, *at_pi.tolist(), *np.linspace(3, len(m.t) - 1, 30).astype(int).tolist()}
    if of == "camera":
        wanted = set(range(len(m.t)))
    steps = steps_of(drive)
    for k, due in enumerate(due_readings(drive, sensors)):
        mine = [i for s, i in due if s == of and i in wanted]
        ahead = copy_of(run.belief)
        ahead.predict(steps, k)
        for i in mine:
            model = copied(run.models[of])
            ahead.begin()
            yield one_by_one(copied(model).innovations(m, i, ahead)), model, m, i, ahead
        run.advance(k, steps, due, drive.measurements)


def copy_of(belief: JointBelief) -> JointBelief:
    """Return an independent copy of a belief."""
    copy = JointBelief((0.0,) * 3, (0.0,) * 6)
    for name, value in belief.__dict__.items():
        if name not in ("_rows", "_queue", "_flags"):
            setattr(copy, name, value.copy() if isinstance(value, np.ndarray | dict | list | set) else value)
    copy.n, copy.frame, copy.wheels = belief.n, belief.frame, belief.wheels
    copy._hold()
    copy._let_drift()
    return copy


def copied(model: Model) -> Model:
    """A copy without what the kernels work on, which it makes anew."""
    with pytest.MonkeyPatch.context() as patch:
        for kernel in (Association, WallColumns):
            patch.setitem(copyreg.dispatch_table, kernel, lambda _: (type(None), ()))
        return deepcopy(model)


def check(seen: Sequence[Innovation], model: Model, m: Measurements, i: int, belief: JointBelief) -> int:
    """Compare the H of every innovation that has one with central differences; return how many there were."""
    predicted = [s for s in seen if s.first >= 0 and math.isfinite(s.nis)]
    for s in predicted:
        columns, H, _ = said(s, belief)
        for j, column in enumerate((0, 1, 2, *columns)):
            ahead, behind = (moved(s, model, m, i, belief, column, d) for d in (STEP, -STEP))
            numeric = (behind - ahead) / (2.0 * STEP)
            assert numeric == pytest.approx(H[:, j], abs=2e-4 * max(1.0, float(np.abs(H).max()))), (i, column)
    return len(predicted)


def moved(s: Innovation, model: Model, m: Measurements, i: int, belief: JointBelief, j: int, d: float) -> Array:
    """Return the innovation of the same row by the same landmark with state j moved by d, (k,)."""
    at = copy_of(belief)
    at.transform(np.array([j]), np.array([float(at.state[j]) + d]), np.eye(1))
    rows = one_by_one(copied(model).innovations(m, i, at))
    (same,) = [row for row in rows if row.row == s.row and row.landmark == s.landmark]
    return np.array(same.y)


# ---- how it is shown ----


@each_sensor
def test_components_and_states_have_names_and_units(sensor: Sensor) -> None:
    shown = [*sensor.components, *(c for state in sensor.states.values() for c in state)]
    assert shown
    for c in shown:
        assert c.scale == pytest.approx(UNITS[c.unit]), c
    names = [c.name for c in sensor.components]
    assert len(set(names)) == len(names)
    assert all(name.isidentifier() for name in names)
    for variant in VARIANTS.get(sensor.name, [{}]):
        settings = with_settings(six_sensors.drive()[1], variant).settings(sensor.name)
        for b in sensor.model(settings).blocks():
            assert b.name.startswith("_") or len(sensor.states[b.name]) == len(b.x), b.name


@pytest.mark.parametrize("theme", ["light", "dark"])
def test_colours_differ(theme: str) -> None:
    """By more than a screen's or a printer's error; the paper's sensors are held to more in the figures' tests."""
    inks = {name: np.array(list(bytes.fromhex(getattr(s.colour, theme)[1:]))) for name, s in REGISTRY.items()}
    for a, b in combinations(inks, 2):
        assert np.linalg.norm(inks[a] - inks[b]) > 40.0, (a, b)


# ---- turning ----


@each_sensor
def test_a_heading_of_its_own_turns_as_the_robot_does(sensor: Sensor) -> None:
    drive, _ = six_sensors.drive()
    found = sensor.heading(drive.measurements[sensor.name])
    if found is None:
        return
    t, heading = found
    assert np.corrcoef(true_heading(t), heading)[0, 1] > 0.99


def true_heading(t: Array) -> Array:
    """The heading at times t (n,), (n,) rad, unwrapped."""
    truth = present(six_sensors.drive()[0].truth)
    assert truth.theta is not None
    return np.interp(t, truth.t, np.unwrap(truth.theta))


def test_what_turns_a_sensor_round_is_its_own_setting() -> None:
    def of(sensor: str, settings: Any, msgtype: str) -> Reversal:
        return REGISTRY[sensor].reversal(settings, msgtype)

    assert of("lrf", LrfSettings(flipped=True), "").sets == {"flipped": False}
    assert of("gyro", GyroSettings(roll_deg=180.0), "").sets == {"roll_deg": 0.0}
    number = "std_msgs/msg/Float64"
    for now, other in (("enu_deg", "compass_deg"), ("compass_rad", "enu_rad")):
        told = msgspec.convert({"convention": now}, CompassSettings)
        assert of("compass", told, number).sets == {"convention": other}
    assert of("compass", CompassSettings(), six_sensors.IMU).sets == {"convention": "compass_rad"}
    assert of("compass", CompassSettings(), "sensor_msgs/msg/MagneticField").sets == {"roll_deg": 180.0}
    assert not of("gps", REGISTRY["gps"].Settings(), "").sets
