"""Parameters of robot_localization's ekf_filter_node: inputs with switches, gates, and process noise.

The node's Q is per second, locfuse's per metre. So wheel noise becomes the covariance of the twist
(fusion.wheels.velocity_noise), which the driver must publish: the node takes R from the messages. Q then describes
only how fast speeds change. A rejection threshold is a Mahalanobis distance, and locfuse's gate a confidence: the
threshold is the square root of the chi-square quantile for the number of fused values (state_estimation_nodes).
"""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

import numpy as np

from locfuse.formats.robot.robot_localization import ACCELERATION, INPUT, SPEED, SWITCH_COUNT, TURN, YAW, X, Y
from locfuse.formats.robot.ros_yaml import ASSUMED, KEPT, Origin, Setting
from locfuse.fusion.sensors.compass import OFFSET
from locfuse.fusion.sensors.gyro import BIAS, up_rate
from locfuse.fusion.sensors.magnetic import IMU
from locfuse.fusion.sensors.registry import REGISTRY
from locfuse.fusion.statistics import chi_square
from locfuse.fusion.wheels.odometry import ODOMETRY
from locfuse.fusion.wheels.velocity_noise import random_walk

from .found import FoundRobot

POSE = "geometry_msgs/msg/PoseWithCovarianceStamped"
TWIST = "geometry_msgs/msg/TwistWithCovarianceStamped"
KINDS = {ODOMETRY: "odom", TWIST: "twist", POSE: "pose", IMU: "imu"}
DRIVERS_TOPIC = "/odom"  # the usual name, if the log has no odometry
STATES = ("x", "y", "z", "roll", "pitch", "yaw", "vx", "vy", "vz", "vroll", "vpitch", "vyaw", "ax", "ay", "az")
SURE_SIGMAS = 3.0  # an offset of more sigmas is proven
TINY_VARIANCE = 1e-9  # variance per second: negligible, but keeps P positive
OPTION_WORDS = {  # option -> explanation if it is false, explanation if it is true
    "differential": (
        "it does not drift in the frame of the filter",
        "only its changes count: it drifts, or has an offset that robot_localization does not estimate",
    ),
    "relative": (
        "its zero is that of the filter",
        "counted from its first reading: robot_localization does not estimate its offset",
    ),
}
REASONS = {
    "lrf": "robot_localization reads no laser: fuse the pose of AMCL as pose0 (--to amcl)",
    "gps": "satellite fixes come through navsat_transform_node: fuse its odometry/gps as another odom input",
}
POSES, TWISTS = (X, Y, YAW), (SPEED, TURN)
FRAMES = ("map", "odom", "base_link")


class FilterInput(NamedTuple):
    """An input of the filter: a topic, the values it fuses, and its gates."""

    kind: str  # odom, twist, pose or imu
    topic: str
    switches: tuple[int, ...]  # indices of fused values
    words: str
    gates: Mapping[str, tuple[float, str]]  # "pose" or "twist" -> (confidence, source in words)
    options: Mapping[str, bool]  # differential, relative
    covariances: tuple[str, ...] = ()  # covariances that the messages must have, in words
    origin: Origin = KEPT


def settings(found: FoundRobot, there: Mapping[str, Any]) -> list[Setting]:
    """Return the filter node's parameters; `there`: parameters that the file has now, {} for a new file."""
    rate = 1.0 / found.velocity.period
    sources = list(_sources(found))
    in_map = found.has("pose") and found.robot.settings("pose").frame in {"map", "own"}
    world = "map" if in_map else "odom"
    made = [
        Setting("frequency", float(max(1, round(rate))), "Hz, as the wheels report", KEPT),
        Setting("two_d_mode", True, "locfuse estimates in the plane", KEPT),
        *(Setting(f"{frame}_frame", frame, "REP 105; name your own", KEPT) for frame in FRAMES),
        Setting("world_frame", world, "odom, or map where a pose is of the map", KEPT),
    ]
    count = Counter[str]()
    for source in sources:
        name = _input_name(source, there) if there else f"{source.kind}{count[source.kind]}"
        count[source.kind] += 1
        if name is None:
            made.append(Setting(source.topic, None, "no input of the file reads it"))
        else:
            made += _input(name, source, there)
    topics = {source.topic for source in sources}
    mapped = {sensor for sensor in found.loaded.drive.measurements if found.topic(sensor)[0] in topics}
    return [*made, _process_noise(found, there), *found.unmapped("robot_localization", mapped, REASONS)]


def _input_name(source: FilterInput, there: Mapping[str, Any]) -> str | None:
    """Return the name of the file's input ("odom0") that reads this topic; None if there is none."""
    bare = source.topic.strip("/")
    inputs = ((key, str(value).strip("/")) for key, value in there.items() if INPUT.fullmatch(key))
    if source.origin == ASSUMED:  # the log has no odometry: use the first odometry in the file
        return next((key for key, _ in inputs if key.startswith("odom")), None)
    return next((key for key, topic in inputs if topic == bare or bare.endswith(f"/{topic}")), None)


def _input(name: str, source: FilterInput, there: Mapping[str, Any]) -> Iterator[Setting]:
    yield Setting(name, source.topic, source.words, source.origin)
    on = [place in source.switches for place in range(SWITCH_COUNT)]
    rows = ("x y z", "roll pitch yaw", "their speeds", "their rates", "accelerations")
    yield Setting(f"{name}_config", on, rows[0], KEPT, row=3, row_words=rows)
    for option, value in source.options.items():
        yield Setting(f"{name}_{option}", value, OPTION_WORDS[option][value], KEPT)
    config = there.get(f"{name}_config")
    used = on if not isinstance(config, list) else config
    for part, (gate, words) in source.gates.items():
        size = sum(bool(used[place]) for place in (POSES if part == "pose" else TWISTS) if place < len(used))
        if not size:
            continue
        of_part = f"{part}_" if source.kind in {"odom", "imu"} else ""
        key = f"{name}_{of_part}rejection_threshold"
        if gate >= 1.0:
            yield Setting(key, None, f"gate {gate:g} accepts all; {words}")
        else:
            distance = math.sqrt(chi_square(gate, size))
            yield Setting(key, distance, f"gate {gate:g}, {size} number{'s' * (size > 1)}; {words}")
    for words in source.covariances:
        what = f"it comes with the messages, so the driver must set it: {words}"
        yield Setting(f"{name} covariance", None, what)


def _sources(found: FoundRobot) -> Iterator[FilterInput]:
    yield _wheels(found)
    yield from _imu(found)
    topic, kind = found.topic("pose")
    if found.has("pose") and kind in {ODOMETRY, POSE}:
        pose = found.robot.settings("pose")
        drifts = pose.frame == "drift" or (pose.frame is None and kind == ODOMETRY)
        on = POSES if pose.heading else (X, Y)
        of = f"pose x, y {pose.sigma**2:.4g} m^2, yaw {math.radians(pose.sigma_theta_deg) ** 2:.4g} rad^2"
        needed = (of,) if pose.covariance == "sigma" else ()
        gates, options = {"pose": _gate(found, "pose")}, {"differential": drifts}
        yield FilterInput(KINDS[kind], topic, on, f"{topic} in the log", gates, options, needed)
    topic, kind = found.topic("twist")
    if found.has("twist") and kind in {ODOMETRY, TWIST}:
        words, gates = f"{topic} in the log", {"twist": _gate(found, "twist")}
        yield FilterInput(KINDS[kind], topic, TWISTS, words, gates, {})


def _wheels(found: FoundRobot) -> FilterInput:
    """Return the wheels' odometry, or /odom if the log has no odometry topic."""
    topic, kind = found.topic("wheels")
    speed, turn = found.velocity.reading.tolist()
    at = f"at {1.0 / found.velocity.period:.3g} Hz"
    noise = f"twist vx {speed:.4g} (m/s)^2, vyaw {turn:.4g} (rad/s)^2 {at}; {found.why('wheels.noise')}"
    if kind in {ODOMETRY, TWIST}:
        return FilterInput(KINDS[kind], topic, TWISTS, f"{topic} in the log", {}, {}, (noise,))
    words = f"{topic} is {kind or 'no topic of ROS'}: name the odometry that your driver makes of it"
    return FilterInput("odom", DRIVERS_TOPIC, TWISTS, words, {}, {}, (noise,), ASSUMED)


def _imu(found: FoundRobot) -> Iterator[FilterInput]:
    """Yield the IMU topics read as compass, gyro or both."""
    roles: dict[str, list[str]] = {}
    for role in ("compass", "gyro"):
        topic, kind = found.topic(role)
        if found.has(role) and kind == IMU:
            roles.setdefault(topic, []).append(role)
    for topic, uses in roles.items():
        switches, gates, options, covariances = [], {}, {}, []
        if "compass" in uses:
            compass = found.robot.settings("compass")
            switches.append(YAW)
            gates["pose"] = _gate(found, "compass")
            options = _heading_options(found)
            variance = f"orientation, yaw {math.radians(compass.sigma_deg) ** 2:.4g} rad^2"
            covariances.append(f"{variance}; {found.why('compass.sigma_deg')}")
        if "gyro" in uses:
            switches.append(TURN)
            gates["twist"] = _gate(found, "gyro")
            variance = f"angular_velocity, z {gyro_variance(found):.4g} (rad/s)^2"
            bias = "with the gyro's bias, which robot_localization does not estimate"
            covariances.append(f"{variance}, {bias}; {found.why('gyro.sigma_deg')}")
        yield FilterInput("imu", topic, tuple(switches), f"{topic} in the log", gates, options, tuple(covariances))


def _heading_options(found: FoundRobot) -> dict[str, bool]:
    """Return the options `relative` or `differential` for a compass, whose offset the node does not estimate."""
    pose = found.robot.settings("pose")
    if not (found.has("pose") and pose.heading and pose.frame in {"map", "own"}):
        return {"relative": found.robot.settings("compass").offset_deg != 0.0}
    offsets, sigmas = (of.get(OFFSET) for of in (found.estimates.blocks, found.estimates.block_sigmas))
    if offsets is None or sigmas is None:
        return {"differential": found.robot.settings("compass").offset_deg != 0.0}
    return {"differential": bool(abs(offsets[-1, 0]) > SURE_SIGMAS * sigmas[-1, 0])}


def _gate(found: FoundRobot, sensor: str) -> tuple[float, str]:
    return found.robot.settings(sensor).gate, found.why(f"{sensor}.gate")


def gyro_rate_hz(found: FoundRobot) -> float:
    """Return the mean message rate of the gyro [Hz]."""
    drive = found.loaded.drive
    name = found.topic("gyro")[0]
    count = found.loaded.log.topics[name].count if name in found.loaded.log.topics else 0
    return max(count, 2) / max(float(drive.t[-1]), 1e-3)


def gyro_variance(found: FoundRobot, with_bias: bool = True) -> float:
    """Return the variance of one turning rate [(rad/s)^2], with the square of the gyro's bias if wanted."""
    gyro = found.robot.settings("gyro")
    white = math.radians(gyro.sigma_deg) ** 2 * gyro_rate_hz(found)
    biases = found.estimates.blocks.get(BIAS)
    bias = math.radians(gyro.bias_deg or 0.0) if biases is None or not len(biases) else float(biases[-1, 0])
    return white + (bias**2 if with_bias else 0.0)


def _turn_walk(found: FoundRobot) -> float:
    """Return the random walk of the turning rate [(rad/s)^2 per s], by the gyro, else by the wheels."""
    if not found.has("gyro") or found.topic("gyro")[1] != IMU:
        return float(found.velocity.walk[1])
    stream, settings = found.loaded.stream("gyro"), found.robot.settings("gyro")
    columns: Any = stream.columns(*REGISTRY["gyro"].reads[IMU])
    rate = up_rate(columns, settings, stream.topic)
    white = gyro_variance(found, with_bias=False)
    return random_walk(rate[np.isfinite(rate)], white, 1.0 / gyro_rate_hz(found))


def _process_noise(found: FoundRobot, there: Mapping[str, Any]) -> Setting:
    """Return the process noise Q per second, (15, 15) row by row; only its diagonal if the file has 15 values."""
    velocity = found.velocity
    diagonal = [TINY_VARIANCE] * SWITCH_COUNT
    along, turn = velocity.pose.tolist()
    diagonal[X] = diagonal[Y] = TINY_VARIANCE + 0.5 * along
    diagonal[YAW] = TINY_VARIANCE + turn
    diagonal[SPEED], diagonal[TURN] = float(velocity.walk[0]), _turn_walk(found)
    reasons = {
        X: f"m^2/s of the wheels beyond their twist's covariance; {found.why('wheels.noise')}",
        Y: "as x",
        YAW: f"rad^2/s of the wheels beyond their twist's covariance; {found.why('wheels.noise')}",
        SPEED: "(m/s)^2/s: how fast this drive's speed changes",
        TURN: "(rad/s)^2/s: how fast its turning rate changes",
    }
    rows = tuple(f"{name}: {reasons.get(i, 'not estimated')}" for i, name in enumerate(STATES))
    fuses = any(
        isinstance(config, list) and len(config) > ACCELERATION and config[ACCELERATION]
        for key, config in there.items()
        if re.fullmatch(r"imu\d+_config", key)
    )
    places = [*reasons, *([] if fuses else [ACCELERATION])]  # an unmeasured acceleration gets almost no noise
    old, value = there.get("process_noise_covariance"), diagonal
    if not (isinstance(old, list) and len(old) == SWITCH_COUNT):
        value, places = np.diag(diagonal).ravel().tolist(), [place * (SWITCH_COUNT + 1) for place in places]
    words = "; ".join(f"{STATES[place]} {reasons[place]}" for place in (X, SPEED, TURN))
    key = "process_noise_covariance"
    return Setting(key, value, words, places=tuple(places), row=SWITCH_COUNT, row_words=rows)
