"""Cases of benchmarks.golden: simulated logs, sample logs, real logs, each with its options."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import tomli_w

from benchmarks import floor_plan
from benchmarks.real_logs import FILES, KNOWN, are_there
from locfuse.cli.analysis.settings import set_words
from locfuse.formats.container.mcap_write import log_writer
from locfuse.sample_logs import scenario as load
from locfuse.sample_logs.simulate import EPOCH_NS, Simulation, to_log
from locfuse.sample_logs.table import RawMessage

Words = tuple[str, ...]
LOGS, HERE = "{logs}", "{data}"  # placeholders for the folders of simulated and of real logs


class Case(NamedTuple):
    """One log under one set of options."""

    name: str
    log: str
    sets: Words = ()
    what: str = "compare"  # or run, listen, given (the map of a first run), image, several, command
    options: Mapping[str, Any] = {}  # of `load` (order, preset, between), and of `compare` or `run`
    words: Words = ()  # words of a command, or several logs
    slack: float = 1.0  # factor on the largest allowed differences

    def simulated(self) -> list[str]:
        """Return the names of the simulated logs that the case reads."""
        return [s for s in SIMULATED if s == self.log or f"{LOGS}/{s}.mcap" in self.words]


LEGS = (
    "{turn_deg=80, speed=0.25}, {forward=0.8, speed=0.4}, {turn_deg=60, speed=0.3}, {forward=0.4},"
    "{turn_deg=-70, speed=0.3}"
)
PICTURES = ("camera.enabled=true", "camera.size=[240,240]", "camera.centre=[120.7,119.1]", "camera.focal=160")
EVERY = (
    f'path={{kind="legs", x=2.2, y=2.4, theta_deg=120.0, legs=[{LEGS}]}}',
    *("control.estimator=truth", "control.wait=1.5", "compass.rate=10", *PICTURES),
    *("camera.inner=31", "camera.outer=116"),
)
BLIND = ("camera.enabled=false", "control.estimator=truth")
OFFICE = "path.points=[[35.4,2.4],[33.0,2.4],[33.0,6.9],[23.0,6.9],[23.0,4.2],[19.4,4.2],[19.4,6.9],[6.5,6.9]]"
SIMULATED: dict[str, tuple[str, int, Words]] = {  # log -> scenario, seed, its settings
    **{f"every_{seed}": ("extras", seed, EVERY) for seed in (5, 6, 7)},
    **{f"tour_{seed}": ("tour", seed, (*BLIND[1:], "path.length=10")) for seed in (1, 2, 3)},
    **{f"sonars_{seed}": ("extras", seed, (*BLIND, "path.length=10")) for seed in (1, 2)},
    **{name: (name, 1, BLIND) for name in ("kidnapped", "bad_electronics", "round_room")},
    "straight_runs": ("straight_runs", 1, BLIND),
    "turns": ("turns_on_the_spot", 1, BLIND),
    "moving": ("rounded_rectangle", 2, (*BLIND, "control.wait=0", "lrf.phase=0.6")),
    "late": ("rounded_rectangle", 3, (*BLIND, 'faults=[{kind="dropout", sensor="lrf", end=6}]')),
    "gap": ("rounded_rectangle", 4, (*BLIND, 'faults=[{kind="dropout", sensor="lrf", start=20, end=35}]')),
    "rest": ("rounded_triangle", 5, (*BLIND, "control.wait=20", "lrf.pattern=0.006")),
    "fast": ("rounded_triangle", 6, (*BLIND, "lrf.rate=40", "lrf.duration=0.02")),
    "unknown_start": ("rounded_rectangle", 7, (*BLIND, "start.sigma_theta_deg=20", "start.sigma_xy=0.5")),
    "clock": ("tour", 8, (*BLIND, 'faults=[{kind="clock_offset", sensor="lrf", seconds=0.02}]')),
    "office": ("office", 1, (OFFICE,)),
}
PLANNED = ("every", "tour", "office")  # scenarios with a floor plan as an image
OTHERS = ("gyro", "pose", "twist", "landmarks", "sonar", "gps", "compass", "lrf", "camera")
PLACES = {6: (0.5, 0.7), 7: (4.5, 1.0), 11: (4.0, 4.2), 20: (0.8, 3.9)}  # m, landmarks in the logs every_*


class Others:
    """Messages of sensors that the simulator lacks, from the true pose: gyro, pose, twist, detections."""

    def __init__(self, seed: int) -> None:
        self.rng = np.random.default_rng(seed)
        self.rows = ["t,id,range,bearing"]
        self.last: tuple[float, float, float, float] | None = None
        self.n = 0

    def of(self, m: RawMessage) -> Iterator[RawMessage]:
        """Yield the messages that belong to one message of the truth."""
        x, y = (m.fields[f"pose.position.{axis}"] for axis in "xy")
        theta = 2.0 * np.arctan2(m.fields["pose.orientation.z"], m.fields["pose.orientation.w"])
        t, last = m.stamp_ns * 1e-9, self.last
        self.last, self.n = (t, x, y, theta), self.n + 1
        noise = self.rng.standard_normal(6)
        if last is not None:
            dt = t - last[0]
            way = np.cos(theta) * (x - last[1]) + np.sin(theta) * (y - last[2])
            turn = (theta - last[3] + np.pi) % (2.0 * np.pi) - np.pi
            imu = {"angular_velocity.z": turn / dt + 0.01 + 0.003 * noise[0], "orientation_covariance": NO_HEADING}
            yield m._replace(topic="/imu", msgtype="sensor_msgs/msg/Imu", frame_id="base_link", fields=imu)
            speeds = {"twist.linear.x": way / dt + 0.03 * noise[1], "twist.angular.z": turn / dt + 0.02 * noise[2]}
            yield m._replace(topic="/flow", msgtype="geometry_msgs/msg/TwistStamped", fields=speeds)
        if self.n % 4 == 0:
            c, s, half = np.cos(0.7), np.sin(0.7), 0.5 * theta + 0.35
            px, py = x + 0.02 * noise[3], y + 0.02 * noise[4]
            P = np.diag([4e-4, 4e-4, 0.0, 0.0, 0.0, 1e-4]).reshape(36)
            pose: dict[str, Any] = {
                "pose.pose.orientation.z": np.sin(half),
                "pose.pose.orientation.w": np.cos(half),
            }
            pose |= {"pose.pose.position.x": c * px - s * py + 3.0, "pose.pose.position.y": s * px + c * py - 2.0}
            pose["pose.covariance"], kind = P, "geometry_msgs/msg/PoseWithCovarianceStamped"
            yield m._replace(topic="/other_pose", msgtype=kind, frame_id="other", fields=pose)
        if self.n % 5 == 0:
            for key, (lx, ly) in list(PLACES.items())[self.n // 5 % 2 :: 2]:
                noise = self.rng.standard_normal(2)
                away, bearing = np.hypot(lx - x, ly - y), np.arctan2(ly - y, lx - x) - theta
                self.rows.append(f"{t:.9f},{key},{away + 0.05 * noise[0]:.6f},{bearing + 0.02 * noise[1]:.6f}")


def grid(plan: floor_plan.FloorPlan) -> RawMessage:
    occupied = {floor_plan.OCCUPIED: 100, floor_plan.UNKNOWN: -1, floor_plan.FREE: 0}
    cells = [occupied[grey] for grey in plan.image[::-1].ravel().tolist()]
    rows, columns = plan.image.shape
    fields = {"info.resolution": plan.cell, "info.width": columns, "info.height": rows}
    fields |= {"info.origin.position.x": plan.origin[0], "info.origin.position.y": plan.origin[1]}
    fields |= {"info.origin.orientation.w": 1.0, "data": np.array(cells, np.int8)}
    return RawMessage("/map", "nav_msgs/msg/OccupancyGrid", EPOCH_NS, EPOCH_NS, "map", fields)


NO_HEADING = np.array([-1.0] + [0.0] * 8)


def simulate(logs: Path, name: str) -> None:
    """Write a simulated log and the files of its robot, unless they exist."""
    if (path := logs / f"{name}.mcap").exists():
        return
    scenario, seed, sets = SIMULATED[name]
    chosen = load.load(scenario, sets)
    simulation, others = Simulation(chosen, seed), Others(seed)
    plan = None
    if name.startswith(PLANNED):
        plan = floor_plan.floor_plan(simulation.scene.obstacles(0.25), simulation.start[:2])
        floor_plan.write(plan, logs / name)
    with log_writer(path) as log:
        log.attach("robot.toml", tomli_w.dumps(simulation.robot_tables).encode())
        emit = to_log(log)
        if plan is not None and name.startswith("every"):
            emit(grid(plan))

        def both(m: RawMessage) -> None:
            emit(m)
            if name.startswith("every") and m.topic == "/ground_truth/pose":
                for message in others.of(m):
                    emit(message)

        simulation.run(None, both)
        (logs / f"{name}.csv").write_text("\n".join(others.rows) + "\n")
        rows = [f"{key},{x},{y}" for key, (x, y) in PLACES.items()]
        (logs / "places.csv").write_text("\n".join(["id,x,y", *rows]) + "\n")


MODES = {f"map={mode}": (f"lrf.map={mode}",) for mode in ("grow", "first-scan", "consider", "refine")}
MOUNTS = tuple(f"{s}.sigma_{k}" for s in ("lrf", "camera") for k in ("x=0.02", "y=0.02", "yaw_deg=1"))
INFLATE = tuple(f"{s}.outliers=inflate" for s in ("compass", "lrf", "camera"))
PLAIN = {"advice": False}
FILTER: dict[str, Words] = {  # options of any log with a laser
    **MODES,
    "wheels": ("wheels.estimate=true",),
    "mounts": MOUNTS,
    "wheels and mounts": ("wheels.estimate=true", *MOUNTS),
    "inflate": INFLATE,
    "inflate, map=refine": (*INFLATE, "lrf.map=refine"),
    "recover=false": ("lrf.recover=false",),
    "unsure start": ("start.sigma_xy=0.1", "start.sigma_theta_deg=5"),
}
SHORTER = (*MODES, "wheels", "mounts", "inflate", "recover=false")
MORE: dict[str, Words] = {
    **{f"wheels, {mode}": ("wheels.estimate=true", *sets) for mode, sets in MODES.items()},
    **{f"unsure start, {mode}": (*FILTER["unsure start"], *sets) for mode, sets in MODES.items()},
    "walls=flat": ("lrf.walls=flat",),
    "deskew=false": ("lrf.deskew=false",),
    "gates": ("compass.gate=0.9", "lrf.gate=0.9", "camera.gate=0.9"),
    "late": ("lrf.time_offset=0.05", "compass.time_offset=-0.03"),
    "scale": ("lrf.range_scale=1.01", "lrf.range_offset=0.02"),
    "far": ("lrf.range_max=2.5",),
    "noise": ("wheels.noise=4e-3",),
    "quiet wheels": ("wheels.noise=4e-6",),
    "drift": ("compass.offset_drift_deg=0.1",),
    "offset": ("compass.offset_deg=-60", "compass.sigma_offset_deg=10"),
    "absolute": ("camera.bearing=absolute", "camera.chain=paper"),
}
ASKED: dict[str, dict[str, Any]] = {
    "smooth": {"smooth": True},
    "subsets": {"all_subsets": True},
    "rates": {"sensors": ["odometry", "lrf@2Hz", "compass@5Hz,lrf"]},
    "jitter": {"jitter": 1, "sensors": ["odometry", "lrf", "all"]},
    "se2": {"align": "se2"},
    "between": {"between": (8.0, 30.0)},
    "paper": {"preset": "paper"},
    "recorded": {"order": "recorded"},
}
TOPICS = ("pose.topic=/other_pose", "twist.topic=/flow")
SENSORS: dict[str, Words] = {  # options of the logs every_*
    "placed": (f"landmarks.map={LOGS}/places.csv",),
    "placed, inflate": (f"landmarks.map={LOGS}/places.csv", *(f"{s}.outliers=inflate" for s in OTHERS)),
    "grown": ("landmarks.map=grow",),
    "grown, offset": ("landmarks.map=grow", "landmarks.range_offset=0"),
    "pose=map": ("pose.frame=map",),
    "pose=own": ("pose.frame=own", "pose.covariance=sigma"),
    "pose=drift": ("pose.frame=drift",),
    "pose, inflate": ("pose.correlated=1", "pose.outliers=inflate"),
    "gyro": ("gyro.bias_deg=0.57", "gyro.period=0", "gyro.gate=0.99"),
    "gyro, twist": ("gyro.period=0.5", "twist.period=0", "twist.covariance=sigma"),
    "gps": ("gps.east_deg=0", "gps.sigma=0.5"),
    "sonar": ("sonar.sigma=0.1", "sonar.widen_deg=0"),
    "grid": ("lrf.map=given", "lrf.map_topic=/map"),
}
ARENA = (*set_words(KNOWN["brenner"]), "wheels.track=0.155")
WARTHOG = ("wheels.radius=0.286", "wheels.track=1.78")
BARCODES = (
    *("start.x=1.426", "start.y=-3.905", "start.theta_deg=134.8", "wheels.time_offset=0.19"),
    *(f"landmarks.file={HERE}/mrclam/detections.csv", f"landmarks.map={HERE}/mrclam/landmarks.csv"),
)
LASERS = ("brenner", "turtlebot4", "controller_twist", "odometry_in_tf", "laser_only")
HALLS = ("freiburg-101", "edmonton")
REAL: dict[str, tuple[str, Words]] = {  # name -> log, settings
    "brenner": ("brenner", (*ARENA, "lrf.time_offset=-0.45", "lrf.range_scale=1.13")),
    **{n: (n, ()) for n in (*LASERS[1:], *HALLS)},
    "uwb": ("uwb", set_words(KNOWN["uwb"])),
    "warthog": ("warthog", WARTHOG),
    "mrclam": ("mrclam", BARCODES),
    "mrclam, grown": ("mrclam", (*BARCODES[:-1], "landmarks.map=grow")),
    **{n: (n, ()) for n in ("marker_in_camera", "setpoints", "sideways", "world_frame_twist")},
    **{n: (n, ()) for n in ("standing_odometry", "tricycle", "nav2_turtlebot")},
}
LONG: dict[str, tuple[Words, Words]] = {  # log -> settings, options
    "pimouse": ((), ("recover=false",)),
    "aces": ((), ("mounts",)),
    "fr079": (set_words(KNOWN["fr079"]), ("wheels",)),
}
SAMPLES = ("disturbed", "rounded_rectangle", "rounded_triangle")
QUICK = {  # names of cases: some of every kind
    *(f"disturbed: {option}" for option in ("default", "listen", "given", "smooth", "paper", *FILTER)),
    *(f"every_5: {option}" for option in ("listen", "image", "smooth", *SENSORS)),
    *("tune compass", "several logs"),
    *("brenner: default", "freiburg-101: map=grow", "turtlebot4: map=refine", "fr079: short"),
}


def cases() -> list[Case]:
    """Return all cases; those of real logs only if their folder is set."""
    return [*_samples(), *_simulated(), *_commands(), *(_real() if are_there() else ())]


def _samples() -> Iterator[Case]:
    for log in SAMPLES:
        yield Case(f"{log}: default", log)
        yield Case(f"{log}: listen", log, what="listen")
        yield Case(f"{log}: given", log, what="given", options=PLAIN)
        for name, sets in (FILTER | MORE if log != SAMPLES[-1] else FILTER).items():
            yield Case(f"{log}: {name}", log, sets, options=PLAIN)
        for name, asked in ASKED.items():
            yield Case(f"{log}: {name}", log, options=PLAIN | asked)
        for name, sets in (MODES | {"wheels": FILTER["wheels"], "mounts": MOUNTS}).items():
            yield Case(f"{log}: smooth, {name}", log, sets, options=PLAIN | {"smooth": True})
            yield Case(f"{log}: listen, {name}", log, sets, "listen")


def _simulated() -> Iterator[Case]:
    for log in SIMULATED:
        every = log.startswith("every")
        own = (f"landmarks.file={LOGS}/{log}.csv", *TOPICS) if every else ()
        options = FILTER | SENSORS if every else {name: FILTER[name] for name in SHORTER}
        for name, sets in options.items():
            yield Case(f"{log}: {name}", log, (*own, *sets), options=PLAIN)
        yield Case(f"{log}: default", log, own)
        yield Case(f"{log}: listen", log, own, "listen")
        yield Case(f"{log}: given", log, own, "given", PLAIN)
        if log.startswith(PLANNED):
            yield Case(f"{log}: image", log, own, "image", PLAIN)
        yield Case(f"{log}: smooth", log, own, options=PLAIN | {"smooth": True})


def _commands() -> Iterator[Case]:
    for log in SAMPLES:
        yield Case(f"info {log}", log, what="command", words=("info", log, "--check", "--json", "-q"))
        yield Case(f"calibrate {log}", log, what="command", words=("calibrate", log, "--json", "-q"))
    yield Case("calibrate", "straight_runs", what="command", words=CALIBRATE)
    tune = ("tune", "rounded_triangle", "--json", "-q")
    yield Case("tune", "rounded_triangle", what="command", words=tune, slack=TUNED)
    short = (*tune, "--sensors", "compass")
    yield Case("tune compass", "rounded_triangle", what="command", words=short, slack=TUNED)
    yield Case("several logs", SAMPLES[0], what="several", words=SAMPLES)


CALIBRATE = ("calibrate", f"{LOGS}/straight_runs.mcap", f"{LOGS}/turns.mcap", "--json", "-q")
TUNED = 1e4  # slack for results of an optimiser, which stops at a tolerance


def _real() -> Iterator[Case]:
    for name, (file, sets) in REAL.items():
        log = f"{HERE}/{FILES[file]}"
        yield Case(f"{name}: default", log, sets)
        yield Case(f"{name}: listen", log, sets, "listen")
        yield Case(f"{name}: smooth", log, sets, options=PLAIN | {"smooth": True})
        more = FILTER if name in LASERS + HALLS else {k: FILTER[k] for k in ("wheels", "unsure start")}
        for option, others in more.items():
            yield Case(f"{name}: {option}", log, (*sets, *others), options=PLAIN)
        if name in LASERS + HALLS:
            yield Case(f"{name}: given", log, sets, "given", PLAIN)
    for name, (sets, options) in LONG.items():
        log, short = f"{HERE}/{FILES[name]}", {"between": (0.0, 350.0), **PLAIN}
        yield Case(f"{name}: short", log, sets, "run", short)
        yield Case(f"{name}: plain", log, sets, options=PLAIN)
        for option in options:
            yield Case(f"{name}: {option}", log, (*sets, *FILTER[option]), "run", PLAIN)
        if name == "aces":  # to smooth fr079 takes a minute and a half
            yield Case(f"{name}: smooth", log, sets, "run", PLAIN | {"smooth": True})
