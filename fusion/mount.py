"""Mount of a sensor on the base: known exactly, or estimated as states of the filter.

An error of the laser's yaw rotates the whole map, and innovations hardly show it. So if a mount is wrongly taken
as exact, the filter becomes overconfident; therefore uncertain components are states. If the drive can show the
mount (a laser that builds its map), the default sigmas are those of a measurement by hand: 1 cm and 0.5 degrees.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np
from msgspec.structs import replace

from .data import Array, Component
from .sensor import Belief, Block, SensorSettings

Row = tuple[float, ...]
ASK_MOUNT = (
    "not in this log (no /tf_static says it). Measure from the middle between the wheels: forward, left, turned. "
    "How well they are known: sigma_x, sigma_y, sigma_yaw_deg (of a laser 0.01 m and 0.5 degrees unless set)"
)
PARTS = ("x", "y", "yaw")  # components of a mount: suffixes of its states' names
MAX_MOUNT_M = 20.0  # m: a sensor farther from the base is in other units
SIGMA_M, SIGMA_DEG = 0.01, 0.5  # m, degrees: default sigmas of an observable mount
MAX_PRIOR_SIGMAS = 3.0  # configured sigmas; a larger change may come from another error
OTHER_MOUNT = "it seems to sit at"  # start of the note on a changed mount
MIN_CHANGE_SIGMAS = 4.0  # estimated sigmas; a smaller change is not reported

# words of topics whose IMU is inside a camera or laser, or on an arm
NOT_ON_BODY = (
    *("camera", "zed", "realsense", "oak", "d435", "t265", "lidar", "livox", "ouster", "velodyne"),
    *("gripper", "wrist", "arm", "hand", "head", "tilt", "tool"),
)
BARE_NUMBERS = ("std_msgs/msg/Float64", "std_msgs/msg/Float32")  # no unit, direction, frame: used last


class MountedSettings(SensorSettings, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Settings of a sensor with a mount (x, y, yaw) on the base."""

    x: float = 0.0  # m, position of the sensor on the base, forward
    y: float = 0.0  # m, position of the sensor on the base, to the left
    yaw_deg: float = 0.0  # degrees, direction of the sensor, counter-clockwise
    # standard deviations: above 0 a state, 0 exact; None: SIGMA_M, SIGMA_DEG if the drive shows the mount, else 0
    sigma_x: float | None = None  # m; 0: exact. Default of a laser that builds its map: 0.01
    sigma_y: float | None = None  # m, as sigma_x
    sigma_yaw_deg: float | None = None  # degrees; 0: exact. Default of a laser that builds its map: 0.5

    only_fused: ClassVar[frozenset[str]] = SensorSettings.only_fused | {"sigma_x", "sigma_y", "sigma_yaw_deg"}

    @property
    def mount(self) -> tuple[float, float, float]:
        """Configured pose on the base: x [m], y [m], yaw [rad]."""
        return self.x, self.y, math.radians(self.yaw_deg)

    def __post_init__(self) -> None:
        """Raise ValueError if a standard deviation is negative or not finite, or a position is not in metres."""
        super().__post_init__()
        for key in ("x", "y"):
            if abs(getattr(self, key)) > MAX_MOUNT_M:
                raise ValueError(f"{key} = {getattr(self, key):g} must be in metres, at most {MAX_MOUNT_M:g} m")
        for key in ("sigma_x", "sigma_y", "sigma_yaw_deg"):
            if not 0.0 <= (getattr(self, key) or 0.0) < math.inf:
                raise ValueError(f"{key} = {getattr(self, key)} must be 0 (known exactly) or above")

    def sigmas(self, observable: bool) -> tuple[float, float, float]:
        """Return the sigmas of x, y [m] and yaw [rad]; by default above 0 only for an `observable` mount."""
        place, turn = (SIGMA_M, SIGMA_DEG) if observable else (0.0, 0.0)
        x, y = (place if sigma is None else sigma for sigma in (self.sigma_x, self.sigma_y))
        return x, y, math.radians(turn if self.sigma_yaw_deg is None else self.sigma_yaw_deg)


def exact(settings: SensorSettings) -> SensorSettings:
    """Return the settings with all standard deviations of the mount set to 0."""
    if not isinstance(settings, MountedSettings):
        return settings
    return replace(settings, sigma_x=0.0, sigma_y=0.0, sigma_yaw_deg=0.0)


class Mount:
    """Mount of one sensor on the base, x [m], y [m], yaw [rad]; each uncertain component is a state block."""

    def __init__(self, sensor: str, settings: MountedSettings, observable: bool = False) -> None:
        """Make a state of each component with a sigma above 0.

        `observable`: whether the drive shows the mount; sigmas that are not configured are then above 0.
        """
        self.sensor, self.configured = sensor, settings.mount
        sigmas = settings.sigmas(observable)
        self.free = tuple(i for i in range(3) if sigmas[i] > 0.0)  # which of x, y, yaw are states
        self._names = {i: f"{sensor}_{PARTS[i]}" for i in self.free}
        self._variances = {i: sigmas[i] ** 2 for i in self.free}

    def blocks(self) -> list[Block]:
        """Return the state blocks of the uncertain components."""
        states = ((name, self.configured[i], self._variances[i]) for i, name in self._names.items())
        return [Block(name, np.array([x]), np.array([[P]]), np.zeros(1)) for name, x, P in states]

    def now(self, belief: Belief) -> tuple[float, float, float]:
        """Return the present mount: x [m], y [m], yaw [rad]."""
        if not self.free:
            return self.configured
        at = list(self.configured)
        for i, name in self._names.items():
            at[i] = belief.value(belief.column(name))
        return at[0], at[1], at[2]

    def columns(self, belief: Belief) -> tuple[int, ...]:
        """Return the state columns of the uncertain components."""
        return tuple(belief.column(name) for name in self._names.values())

    def words(self, belief: Any) -> list[str]:
        """Return a note on the estimated mount, if it differs significantly from the configured mount."""
        parts, sets, far = [], [], False
        for i, name in self._names.items():
            column, value = belief.block(name)
            found, sigma = float(value[0]), math.sqrt(max(float(belief.covariance[column, column]), 0.0))
            if abs(found - self.configured[i]) <= max(MIN_CHANGE_SIGMAS * sigma, math.sqrt(self._variances[i])):
                continue
            far = far or abs(found - self.configured[i]) > MAX_PRIOR_SIGMAS * math.sqrt(self._variances[i])
            key, unit, times = (("x", " m", 1.0), ("y", " m", 1.0), ("yaw_deg", "°", math.degrees(1.0)))[i]
            shown = f"{to_a_tenth_of(times * sigma, times * found):g}"
            sets.append(f"--set {self.sensor}.{key}={shown}")
            parts.append(
                f"{key} {shown}{unit} (± {times * sigma:.2g}), "
                f"not {times * self.configured[i]:.4g}{unit} as {'set' if any(self.configured) else 'assumed'}"
            )
        doubt = ". Measure it: if the setting is right, something else is wrong" if far else ""
        if far and not any(self.configured):
            doubt = f". Measure it, then: {' '.join(sets)}"
        return [f"{OTHER_MOUNT} {'; '.join(parts)}{doubt}"] if parts else []

    def rows(self, by_mount: tuple[Row, ...]) -> tuple[Row, ...]:
        """Return the columns of the estimated components.

        They are taken from derivatives (d, 3) by x, y and yaw of the mount.
        """
        return tuple(tuple(row[i] for i in self.free) for row in by_mount)


def found_mount(sensor: str, configured: Array, blocks: Mapping[str, Array]) -> Array:
    """Return the estimated mount (3,), x [m], y [m], yaw [rad]; components without a state as in `configured`."""
    return np.array([blocks[n][-1, 0] if n in blocks else value for n, value in _by_name(sensor, configured)])


def mount_blocks(sensor: str, mount: Array, blocks: Mapping[str, Array]) -> dict[str, Array]:
    """Return the blocks of the sensor's mount, those in `blocks`, with the values of `mount` (3,).

    Each is (n, 1), filled with one value.
    """
    return {name: np.full_like(blocks[name], value) for name, value in _by_name(sensor, mount) if name in blocks}


def _by_name(sensor: str, mount: Array) -> list[tuple[str, float]]:
    return [(f"{sensor}_{part}", value) for part, value in zip(PARTS, mount.tolist(), strict=True)]


def mount_states(sensor: str) -> dict[str, tuple[Component, ...]]:
    """Return names, units and scales of a sensor's mount states, by block name."""
    units = {"x": ("m", 1.0), "y": ("m", 1.0), "yaw": ("deg", math.degrees(1.0))}
    return {f"{sensor}_{part}": (Component(f"{sensor} mount {part}", *unit),) for part, unit in units.items()}


def to_a_tenth_of(sigma: float, value: float) -> float:
    """Return a value rounded to a tenth of its standard deviation `sigma`."""
    return round(value, 1 - math.floor(math.log10(sigma))) + 0.0 if sigma > 0.0 else value
