"""Cases of benchmarks.advice: faults of a setting or of the robot, alone and in pairs.

A drive is one lap of the paper's robot. Settings and robot are right, except for the faults of the case.
"""

from dataclasses import dataclass, replace

SCENARIO = (
    *("truth.rate=20", "compass.noise_deg=1", "compass.sigma_deg=1"),
    *("compass.hard_iron=[0, 0]", "compass.soft_iron=[1, 1, 0]"),
)
NORTH = -65.0  # compass.offset_deg: the scenario's magnetic north
CAMERA_DEG = 0.18  # camera.sigma_deg, from its bearing errors
OFFSET, CAMERA = f"compass.offset_deg={NORTH}", f"camera.sigma_deg={CAMERA_DEG}"
RIGHT = (OFFSET, CAMERA)
MIDDLE_S = 30.0  # s: middle of the lap, the time of events in the middle


@dataclass(frozen=True)
class Fault:
    """A fault, the sensors that a finding may name, and the settings that fix it."""

    roles: tuple[str, ...]  # sensors that a right finding may name
    keys: tuple[str, ...] = ()  # a right fix sets one of these keys; (): no key can fix it, a finding is enough
    sets: tuple[str, ...] = ()  # wrong settings
    scenario: tuple[str, ...] = ()  # faults of the robot, as --set of `locfuse simulate`
    faults: tuple[str, ...] = ()  # faults of the robot, as entries of the scenario's [[faults]] in inline TOML
    right: tuple[str, ...] = ()  # settings that fix it, if these are not the log's own settings
    closes: bool = True  # whether the right settings remove the error


def _wrong(*settings: str, also: tuple[str, ...] = (), right: tuple[str, ...] = ()) -> Fault:
    """Return a fault of wrong settings of one sensor; `also` are other keys that may fix it."""
    keys = tuple(setting.partition("=")[0] for setting in settings)
    return Fault((keys[0].partition(".")[0],), (*keys, *also), settings, right=right)


def _mount(setting: str) -> Fault:
    """Return a fault of a wrong mount; the right mount is set too, since a set mount becomes a state."""
    return _wrong(setting, also=("lrf.x", "lrf.y", "lrf.yaw_deg"), right=(f"{setting.partition('=')[0]}=0",))


def _happens(roles: str, kind: str, values: str, *keys: str, right: tuple[str, ...] = ()) -> Fault:
    """Return an event of the simulator (a kind of fault) that happens to the robot."""
    return Fault(tuple(roles.split()), keys, faults=(f'{{kind="{kind}", {values}}}',), right=right)


def _robot(roles: str, *scenario: str, right: str = "") -> Fault:
    """Return a fault of the robot itself: simulator settings, and the setting that fixes it."""
    keys, rights = ((right.partition("=")[0],), (right,)) if right else ((), ())
    return Fault(tuple(roles.split()), keys, scenario=scenario, right=rights)


FIELD_T = 20e-6  # T, horizontal part of the earth's field
OFF_AXLE = 'sensor="truth", x=0.06, y=0.03'
HARD_IRON = f"compass.hard_iron=[{0.14 * FIELD_T}, 0]"
OPTICS = ("camera.centre=[241.5, 238.2]", "camera.inner=62", "camera.outer=232")
FAULTS: dict[str, Fault] = {
    "none": Fault(()),
    "compass sigma x 3": _wrong("compass.sigma_deg=3"),
    "compass sigma / 3": _wrong("compass.sigma_deg=0.3333"),
    "laser sigma x 3": _wrong("lrf.sigma_range=0.09", "lrf.sigma_angle_deg=0.75"),
    "laser sigma / 3": _wrong("lrf.sigma_range=0.01", "lrf.sigma_angle_deg=0.08333"),
    "camera sigma x 3": _wrong(f"camera.sigma_deg={CAMERA_DEG * 3:g}"),
    "camera sigma / 3": _wrong(f"camera.sigma_deg={CAMERA_DEG / 3:g}"),
    "wheels noise x 9": _wrong("wheels.noise=0.0036"),
    "wheels noise / 9": _wrong("wheels.noise=4.444e-05"),
    **{f"compass {ms} ms late": _wrong(f"compass.time_offset={ms / 1000}") for ms in (20, 50, 100, 200)},
    **{f"laser {ms} ms late": _wrong(f"lrf.time_offset={ms / 1000}") for ms in (20, 50, 100, 200)},
    "camera 200 ms late": _wrong("camera.time_offset=0.2"),
    **{f"wheels {ms} ms late": _wrong(f"wheels.time_offset={ms / 1000}") for ms in (50, 100)},
    "laser 3 cm ahead": _mount("lrf.x=0.03"),
    "laser 3 cm aside": _mount("lrf.y=0.03"),
    "laser 2 degrees": _mount("lrf.yaw_deg=2"),
    "laser 10 degrees": _mount("lrf.yaw_deg=10"),
    "laser upside-down": _wrong("lrf.flipped=true"),
    "range scale 1.05": _wrong("lrf.range_scale=1.05"),
    "range offset 5 cm": _wrong("lrf.range_offset=0.05"),
    "track + 3 %": _wrong("wheels.track=0.618"),
    "track - 10 %": _wrong("wheels.track=0.54"),
    "radius + 6 %": _wrong("wheels.radius=0.053", also=("wheels.track",)),
    "right wheel + 2 %": _wrong("wheels.ratio=0.98"),
    "wheel mirrored": _wrong("wheels.mirrored=left"),
    "camera zero + 5": _wrong("camera.zero_deg=5"),
    "camera mirrored": _wrong("camera.clockwise=true", also=("camera.zero_deg",)),
    "compass + 1.5": _wrong(f"compass.offset_deg={NORTH + 1.5}"),
    "compass + 5": _wrong(f"compass.offset_deg={NORTH + 5}"),
    "compass + 30": _wrong(f"compass.offset_deg={NORTH + 30}"),
    "compass upside-down": _wrong("compass.roll_deg=180"),
    # the truth
    "truth 100 ms late": _wrong("truth.time_offset=0.1"),
    "truth 50 ms late": _happens("truth", "clock_offset", 'sensor="truth", seconds=0.05', "truth.time_offset"),
    "truth steps 6 cm": _happens("truth", "truth_step", f"start={MIDDLE_S}, x=0.06"),
    "truth 6, 3 cm off the axle": _happens("truth", "displaced", OFF_AXLE, "truth.x", "truth.y"),
    "truth with 8 mm of noise": replace(
        _robot("truth", "truth.noise=0.008", "truth.noise_deg=0.5"),
        keys=("truth.sigma", "truth.sigma_theta_deg"),
        closes=False,
    ),
    # the start
    "start 4 degrees wrong": _robot("start truth", "start.error=[0, 0, 4]", right="start.theta_deg=0"),
    # iron, and a compass that moves
    "hard iron 14 %": _robot("compass", HARD_IRON, right=HARD_IRON),
    "soft iron 10 %": _robot(
        "compass", "compass.soft_iron=[1.1, 0.9, 0]", right=f"compass.soft_iron=[{1 / 1.1}, 0, 0, {1 / 0.9}]"
    ),
    "a steel cabinet": _happens("compass", "magnetic", "x=4.0, y=5.4, strength=4e-6, axis_deg=20"),
    "compass jumps 10 degrees": _happens(
        "compass", "displaced", f'sensor="compass", start={MIDDLE_S}, yaw_deg=10'
    ),
    "compass drifts 0.1 degrees/s": _happens(
        "compass",
        "displaced",
        'sensor="compass", yaw_deg_per_s=0.1',
        "compass.offset_drift_deg",
        right=("compass.sigma_offset_deg=1", "compass.offset_drift_deg=0.5"),
    ),
    # clocks that no offset sets right
    "wheels jitter 8 ms": _happens("wheels", "clock_offset", 'sensor="wheels", jitter=0.008'),
    "laser jitter 40 ms": _happens("lrf", "clock_offset", 'sensor="lrf", jitter=0.04'),
    "laser clock 0.1 % fast": _happens("lrf", "clock_offset", 'sensor="lrf", drift_ppm=1000'),
    # the laser and the ground
    "range scale 0.98": _robot("lrf", "lrf.scale=0.98", right=f"lrf.range_scale={1 / 0.98}"),
    "laser bumped by 4 degrees": _happens(
        "lrf", "displaced", f'sensor="lrf", start={MIDDLE_S}, x=0.02, yaw_deg=4'
    ),
    "side creep 2 %": _happens("wheels lrf", "creep", "ratio=0.02"),
    "both wheels slip": _happens(
        "wheels", "slip", f'wheel="both", ratio=0.3, start={MIDDLE_S}, end={MIDDLE_S + 3}'
    ),
    # the camera
    "camera zero 25, uncalibrated": replace(
        _robot("camera", "camera.zero_deg=25", "camera.calibrated=false", right="camera.zero_deg=25"),
        right=(*OPTICS, "camera.zero_deg=25"),
    ),
}
PAIRS = (
    ("laser 50 ms late", "compass + 5"),
    ("laser 2 degrees", "compass sigma / 3"),
    ("laser 3 cm ahead", "track + 3 %"),
    ("laser sigma / 3", "compass + 5"),
    ("wheel mirrored", "laser 100 ms late"),
    ("radius + 6 %", "laser 2 degrees"),
    ("wheels noise x 9", "compass 100 ms late"),
    ("camera zero + 5", "laser 20 ms late"),
    ("compass 200 ms late", "laser sigma x 3"),
    ("track - 10 %", "camera mirrored"),
    ("truth 50 ms late", "compass + 5"),
    ("hard iron 14 %", "laser 50 ms late"),
)


@dataclass(frozen=True)
class Case:
    """One or two faults together."""

    faults: tuple[Fault, ...]
    base: tuple[str, ...] = RIGHT  # settings that the user knows

    def _all(self, field: str) -> tuple[str, ...]:
        return tuple(value for fault in self.faults for value in getattr(fault, field))

    @property
    def scenario(self) -> tuple[str, ...]:
        """The drive's scenario settings, as --set of `locfuse simulate`."""
        faults = self._all("faults")
        return (*SCENARIO, *self._all("scenario"), *((f"faults=[{', '.join(faults)}]",) if faults else ()))

    @property
    def sets(self) -> tuple[str, ...]:
        """The user's settings, including wrong ones."""
        return (*self.base, *self._all("sets"))

    @property
    def right(self) -> tuple[str, ...]:
        """The right settings for this drive."""
        return (*self.base, *self._all("right"))

    @property
    def roles(self) -> set[str]:
        """The sensors that a right finding names."""
        return set(self._all("roles"))

    @property
    def has_key(self) -> bool:
        """Whether settings can fix every fault."""
        return all(fault.keys for fault in self.faults)

    @property
    def closes(self) -> bool:
        """Whether the right settings remove the error."""
        return self.has_key and all(fault.closes for fault in self.faults)

    @property
    def of_truth(self) -> bool:
        """Whether only the truth is wrong."""
        return any(fault.roles == ("truth",) for fault in self.faults)


CLEAN = ("none", "none, offset estimated")
CASES = {
    **{name: Case((fault,)) for name, fault in FAULTS.items()},
    CLEAN[1]: Case((FAULTS["none"],), (CAMERA,)),
    **{f"{a}, {b}": Case((FAULTS[a], FAULTS[b])) for a, b in PAIRS},
}
