"""Several logs of one robot: common clock offset, track and mount, with their spread over the logs.

Each log gives estimates with standard deviations (`shown`). An estimate is common if all logs but a few agree on
it; its standard deviation includes the scatter between logs (random effects: DerSimonian & Laird, Controlled
Clinical Trials 1986). The wrong clocks are found from the pooled lags, so they are the same for all logs. A common
setting is a fix if it makes no log worse and improves most logs.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from statistics import fmean

import msgspec

from locfuse.fusion.data import BASES, Drive, Estimates
from locfuse.fusion.robot import Robot
from locfuse.fusion.wheels.motion import MAX_PRIOR_SHARE

from .clocks import MIN_LAG_S, SPEED_SIGMA_S, Pair, differences, explained, wrong_clocks
from .lag import SAID_SIGMAS, Lag
from .laser import laser_motion
from .probes import MIN_SCALE, MOUNT_KEYS, path_scale
from .tracked_point import swing
from .tried import (
    MIN_GAIN,
    MIN_GAIN_NATS,
    Fixes,
    Marks,
    gain,
    improves,
    keys,
    readable,
    together,
    worsens_alone,
    worsens_far,
)
from .truth import wheels_metre
from .turning import clock_offset, observed_track, turnings, turns_by_truth

LASER, CLOCK = "lrf", "time_offset"
AFFECT_ALL = {"wheels", "truth"}  # roles whose settings affect every configuration
APART_SIGMAS = 4.0  # sigmas of the difference beyond which two logs disagree
MAX_APART_SHARE = 0.25  # largest share of the logs that may disagree about a common value (one of three may too)
# by the end of a key: format, unit, difference up to which two logs always agree, smallest reported error, and
# whether both are relative to the configured value
SCALES = {
    CLOCK: ("z.3f", " s", 0.03, MIN_LAG_S, False),
    "x": ("z.3f", " m", 0.01, 0.004, False),
    "y": ("z.3f", " m", 0.01, 0.004, False),
    "yaw_deg": ("z.2f", "°", 0.5, 0.2, False),
    "track": (".4g", " m", 0.03, 0.01, True),
    "radius": (".4g", " m", 0.02, 0.01, True),
    **dict.fromkeys(("range_scale", "scale", "turn_scale"), (".4g", "", 0.01, 0.005, True)),
}
# classes of settings by the ends of their keys: an error of an earlier class looks like one of a later class
CLASSES = ("radius scale range_scale", "track turn_scale", "x y yaw_deg")
MAX_MEAN_LOSS = 0.02  # largest growth of ln(error), mean over the logs, for any configuration with sensors
MAX_STEPS = 6  # largest number of fixes for one robot


class Number(msgspec.Struct, frozen=True):
    """Estimate of one setting of robot.toml by one log, in the unit of the setting."""

    value: float
    sigma: float
    now: float = 0.0  # as configured


class LogEstimates(msgspec.Struct, frozen=True):
    """Estimates of settings and clock lags by one log."""

    settings: dict[str, Number] = {}  # "wheels.track" -> its value
    lags: dict[str, Number] = {}  # "gyro wheels.time_offset" -> s to add to the first's
    clocks: dict[str, float] = {}  # "gyro" -> its time_offset as configured [s]


class Common(msgspec.Struct, frozen=True):
    """Estimate of one setting over several logs; `value` is None if they differ."""

    key: str
    now: float  # as configured
    each: dict[str, float]  # log -> its value
    value: float | None = None
    sigma: float = 0.0
    apart: dict[str, float] = {}  # log that disagrees -> difference in sigmas

    @property
    def off(self) -> bool:
        """Whether the common value differs significantly from the configured one."""
        if self.value is None:
            return False
        return abs(self.value - self.now) > max(APART_SIGMAS * self.sigma, _scale(self.key, self.now)[3])

    @property
    def setting(self) -> str:
        """The common value as a setting, such as "wheels.track=0.32"."""
        return f"{self.key}={format(self.value or 0.0, _scale(self.key, self.now)[0])}"

    @property
    def words(self) -> str:
        """Text like "lrf.time_offset = 0.17 s in 6 logs (0.16 to 0.19)", with the logs that disagree."""
        digits, unit, *_ = _scale(self.key, self.now)
        each = {log: f"{format(value, digits)}{unit}" for log, value in self.each.items()}
        if self.value is None:
            listed = ", ".join(f"{log} {value}" for log, value in each.items())
            what = "the time between {} and {}".format(*pair_of(self.key)) if " " in self.key else self.key
            return f"{what} differs between the logs, so there is no common value: {listed}"
        agreeing = [value for log, value in self.each.items() if log not in self.apart]
        low, high, common = (format(value, digits) for value in (min(agreeing), max(agreeing), self.value))
        words = f"{self.key} = {common}{unit} in {len(agreeing)} logs ({low} to {high}; 1 sigma {self.sigma:.1g})"
        words += "".join(f"; {log} disagrees: {each[log]} ({n:.0f} sigma)" for log, n in self.apart.items())
        return f"{words}; configured {self.now:g}{unit}" if self.off else words


class Look(msgspec.Struct, frozen=True):
    """Result of one log under one set of settings: estimates of settings, and errors of each configuration."""

    shown: LogEstimates
    sensors: dict[str, tuple[str, ...]] = {}  # configuration -> its sensors
    marks: dict[str, Marks] = {}  # configuration (if it could be fused) -> its errors


class CommonTrial(msgspec.Struct, frozen=True):
    """Result of one common setting that was tried on all logs."""

    fixes: Fixes
    configuration: str = ""  # the one that gains most
    pairs: dict[str, tuple[Marks, Marks]] = {}  # log -> its errors before and after
    losers: tuple[str, ...] = ()  # logs in which something gets worse
    helps: bool = False
    worth: float = 0.0


class Together(msgspec.Struct, frozen=True):
    """Common estimates by several logs of one robot, and the settings that were tried on all of them."""

    common: tuple[Common, ...] = ()
    fix: CommonTrial | None = None  # all settings that help, together
    refused: tuple[CommonTrial, ...] = ()


Looks = Callable[[Sequence[Fixes]], Mapping[str, Mapping[Fixes, Look]]]  # settings -> by log, then by settings


def shown(drive: Drive, robot: Robot, runs: Sequence[Estimates] = ()) -> LogEstimates:
    """Return the estimates of settings and clock lags by one drive and its filter `runs`."""
    wheels, found = robot.wheels, dict[str, Number]()
    by_sensor, motion = turnings(drive), None
    if drive.wheels.matched is None and turns_by_truth(drive) is None:
        motion = laser_motion(drive, robot, clock_offset(LASER, by_sensor))
    scale, track = wheels_metre(drive), observed_track(1.0, drive, by_sensor, motion)
    if track is not None:
        times, sigma = track[0], max(track[1], 0.0 if motion is None else track[0] * motion.by_slips)
        if wheels.is_of_driver:  # it turns too little where the track is too large
            turn = wheels.turn_scale
            found["wheels.turn_scale"] = Number(turn / times, turn * sigma / times**2, turn)
        elif wheels.track and wheels.radius:
            found["wheels.track"] = Number(wheels.track * times, wheels.track * sigma, wheels.track)
    key, own = ("scale", wheels.scale) if wheels.is_of_driver else ("radius", wheels.radius)
    if scale is not None and own:
        found[f"wheels.{key}"] = Number(own * scale[0], own * scale[1], own)
    swings = None if drive.truth is None else swing(drive.truth, drive)
    if swings is not None and drive.truth is not None:
        for i, key in enumerate(("truth.x", "truth.y")):
            found[key] = Number(float(swings.x[i]), float(swings.sigma[i]), drive.truth.point[i])
    single = (e for e in runs if len(e.sensors) == 1 and not e.smoothed and not e.lost)
    for e in (e for e in single if (m := drive.measurements[e.sensors[0]]).absent < len(m.t)):
        found |= _mount(e, robot)
        ratio = path_scale(e, drive) if e.sensors == (LASER,) else None
        if ratio is not None:
            now = float(robot.settings(LASER).range_scale)
            found["lrf.range_scale"] = Number(now * ratio, now * MIN_SCALE, now)
    pairs = differences(drive, robot, runs)
    clocks = {
        name: float((getattr(robot, name) if name in AFFECT_ALL else robot.settings(name)).time_offset)
        for name in sorted({name for pair in pairs for name in pair})
    }
    lags = {
        f"{a} {b}.{CLOCK}": Number(float(lag.offset), float(lag.sigma), clocks[a] - clocks[b])
        for (a, b), lag in pairs.items()
        if lag.offset
        or lag.sigma < SPEED_SIGMA_S  # leave out a lag of 0 by speeds: it only means that no lag was found
    }
    known = {k: Number(*map(float, (n.value, n.sigma, n.now))) for k, n in found.items() if math.isfinite(n.sigma)}
    return LogEstimates(known, lags, clocks)


def _mount(e: Estimates, robot: Robot) -> dict[str, Number]:
    """Return the mount of a run's only sensor by the drive alone: the effect of the prior is removed.

    The information of the state is the sum of the drive's and the prior's; the mean of the prior is the configured
    value.
    """
    (sensor,), found = e.sensors, {}
    for part, (key, scale) in MOUNT_KEYS.items():
        if (name := f"{sensor}_{part}") not in e.blocks:
            continue
        now = float(getattr(robot.settings(sensor), key))
        value, sigma, prior = (
            scale * float(block[i, 0])
            for block, i in ((e.blocks[name], -1), (e.block_sigmas[name], -1), (e.block_sigmas[name], 0))
        )
        if sigma < MAX_PRIOR_SHARE * prior:
            share = 1.0 - (sigma / prior) ** 2  # share of the drive in the information
            found[f"{sensor}.{key}"] = Number(now + (value - now) / share, sigma / math.sqrt(share), now)
    return found


def _scale(key: str, now: float) -> tuple[str, str, float, float]:
    """Return format and unit of a setting, the largest difference between logs, the smallest reported error."""
    digits, unit, close, least, relative = SCALES[key.rpartition(".")[2]]
    size = abs(now) if relative else 1.0
    return digits, unit, close * size, least * size


def commons(logs: Mapping[str, Mapping[str, Number]]) -> list[Common]:
    """Return the common estimates of all settings that at least two equally configured logs show."""
    found = dict.fromkeys(key for numbers in logs.values() for key in numbers)
    by_key = {key: {log: numbers[key] for log, numbers in logs.items() if key in numbers} for key in found}
    values = {key: {round(n.now, 9) for n in numbers.values()} for key, numbers in by_key.items()}
    alike = {key: len(values[key]) == 1 < len(numbers) for key, numbers in by_key.items()}
    return [common(key, numbers) for key, numbers in by_key.items() if alike[key]]


def common(key: str, numbers: Mapping[str, Number]) -> Common:
    """Return the value of a setting that most logs agree on; without a value if too many disagree."""
    logs, each = list(numbers), {log: n.value for log, n in numbers.items()}
    now = numbers[logs[0]].now
    close = _scale(key, now)[2]

    def near(one: Number, other: Number) -> bool:
        return abs(one.value - other.value) <= max(close, APART_SIGMAS * math.hypot(one.sigma, other.sigma))

    sets = [[log for log in logs if near(numbers[log], numbers[middle])] for middle in logs]
    agreeing = max(sets, key=len)
    if len(logs) - len(agreeing) > (max(1, int(MAX_APART_SHARE * len(logs))) if len(logs) > 2 else 0):
        return Common(key, now, each)
    value, sigma, scatter = _pooled([numbers[log] for log in agreeing])
    others = {log: n for log, n in numbers.items() if log not in agreeing}
    apart = {log: abs(n.value - value) / math.hypot(n.sigma, sigma, scatter) for log, n in others.items()}
    return Common(key, now, each, value, sigma, apart)


def _pooled(numbers: Sequence[Number]) -> tuple[float, float, float]:
    """Return the weighted mean of estimates, its sigma, and the scatter beyond the sigmas of the logs."""
    variances = [max(n.sigma, 1e-6) ** 2 for n in numbers]
    scatter = 0.0
    for _ in range(2):
        w = [1.0 / (v + scatter) for v in variances]
        mean = sum(a * n.value for a, n in zip(w, numbers, strict=True)) / sum(w)
        if scatter > 0.0 or len(numbers) < 2:
            break
        excess = sum(a * (n.value - mean) ** 2 for a, n in zip(w, numbers, strict=True)) - (len(numbers) - 1)
        scatter = max(0.0, excess / (sum(w) - sum(a * a for a in w) / sum(w)))
    return mean, sum(w) ** -0.5, math.sqrt(scatter)


def clocks_of(logs: Mapping[str, LogEstimates]) -> list[list[Common]]:
    """Return sets of wrong clocks that explain the lags in all logs, the best set first; [] if no clock is wrong.

    Lags on which the logs do not agree are left out: a truth may have another lag in every log.
    """
    lags = {pair_of(c.key): Lag(c.value, 1.0, 1.0, c.sigma) for c in lags_of(logs) if c.value is not None}
    found = []
    for off in ([clock.name for clock in clocks] for clocks in wrong_clocks(lags, SAID_SIGMAS, early=0.0)):
        each: dict[str, dict[str, Number]] = {}
        for log, one in logs.items():
            own = {p: n for key, n in one.lags.items() if (p := pair_of(key)) in lags}
            alone = {p: Lag(n.value, 1.0, 1.0, n.sigma) for p, n in own.items()}
            clocks = explained(alone, {p: n.sigma for p, n in own.items()}, off)[1] if own else ()
            each[log] = {
                f"{c.name}.{CLOCK}": Number(one.clocks[c.name] + c.offset, c.sigma, one.clocks[c.name])
                for c in clocks
            }
        found.append(commons(each))
    return found


def lags_of(logs: Mapping[str, LogEstimates]) -> list[Common]:
    """Return the common lags of all pairs of clocks."""
    return commons({log: one.lags for log, one in logs.items()})


def pair_of(key: str) -> Pair:
    """Return the two clocks in a key: ("gyro", "wheels") for "gyro wheels.time_offset"."""
    first, second = key.removesuffix(f".{CLOCK}").split()
    return first, second


def settings_of(logs: Mapping[str, LogEstimates]) -> list[Common]:
    """Return the common estimates of all settings except clock offsets."""
    return commons({log: one.settings for log, one in logs.items()})


def asked(first: Mapping[str, LogEstimates], look: Looks) -> Together:
    """Return the common estimates of several logs of one robot, and the settings that help in all of them.

    In each round, the first class with a helpful setting is used, and its best setting is kept; then all logs are
    measured again.
    """
    kept: Fixes = ()
    logs, seen, apart = first, dict[str, dict[Fixes, Look]](), set[str]()
    for _ in range(MAX_STEPS):
        offers = [{f: of for f, of in group.items() if together(kept, f) != kept} for group in _offers(logs)]
        sets = [kept, *(together(kept, fixes) for group in offers for fixes in group)]
        refused: list[CommonTrial] = []
        if len(sets) == 1:
            break
        for log, looks in look(list(dict.fromkeys(sets))).items():
            seen.setdefault(log, {}).update(looks)
        best: CommonTrial | None = None
        for group in offers:
            steps = [judged(fixes, kept, seen, of) for fixes, of in group.items()]
            refused += (step for step in steps if not keys(step.fixes) <= keys(kept))
            best = max((step for step in steps if step.helps), key=lambda step: step.worth, default=None)
            if best is not None:
                break
        if best is None:
            break
        apart |= next(group[best.fixes] for group in offers if best.fixes in group)
        kept = together(kept, best.fixes)
        logs = {log: looks[kept].shown for log, looks in seen.items() if kept in looks}
    whole = judged(kept, (), seen, apart)
    fix = whole if whole.helps else None
    explanations = clocks_of(first)
    clocks = [e for e in explanations if fix is not None and {c.key for c in e} <= keys(fix.fixes)] or explanations
    every = (*(clocks[0] if clocks else ()), *(c for c in lags_of(first) if c.value is None), *settings_of(first))
    return Together(every, fix, tuple(step for step in refused if step.pairs))


def _offers(logs: Mapping[str, LogEstimates]) -> list[dict[Fixes, set[str]]]:
    """Return groups of settings to try, in the order of their classes.

    A group maps settings to the logs that disagree about their values. The last group has all settings together,
    since several faults may hide the effect of each fix.
    """
    off = [c for c in settings_of(logs) if c.off]
    classes = [[tuple(clocks) for clocks in clocks_of(logs) if all(c.off for c in clocks)]]
    for ends in CLASSES:
        of_class = [c for c in off if c.key.rpartition(".")[2] in ends.split()]
        roles = dict.fromkeys(c.key.partition(".")[0] for c in of_class)
        groups = [tuple(c for c in of_class if c.key.partition(".")[0] == role) for role in roles]
        classes.append([*groups, *((c,) for group in groups if len(group) > 1 for c in group)])
    every = (*(c for clocks in classes[0][:1] for c in clocks), *off)
    classes += [] if any(every in group for group in classes) else [[every]]
    return [
        {fixes: {log for c in one for log in c.apart} for one in group for fixes in _with_track(one, logs)}
        for group in classes
    ]


def _with_track(one: Sequence[Common], logs: Mapping[str, LogEstimates]) -> list[Fixes]:
    """Return settings for common values; a new wheel radius also scales the track, so that turns stay equal."""
    fixes, given = tuple(c.setting for c in one), {c.key: c for c in one}
    track = next((n for s in logs.values() if (n := s.settings.get("wheels.track")) is not None), None)
    radius = given.get("wheels.radius")
    if radius is None or radius.value is None or track is None:
        return [fixes]
    # measured with the configured radius
    now = given["wheels.track"].value if "wheels.track" in given else track.now
    scaled = together(fixes, (f"wheels.track={(now or track.now) * radius.value / radius.now:.4g}",))
    return [scaled] if "wheels.track" in given else [scaled, fixes]


def judged(
    fixes: Fixes, kept: Fixes, found: Mapping[str, Mapping[Fixes, Look]], apart: Iterable[str]
) -> CommonTrial:
    """Return the effect of adding `fixes` to `kept` on all logs; logs in `apart` may get worse."""
    of: dict[str, dict[str, tuple[Marks, Marks]]] = {}  # log -> configuration -> before and after
    losers, gained = list[str](), 0
    roles = {key.partition(".")[0] for key in keys(fixes)}
    for log, looks in found.items():
        one, other = looks.get(kept), looks.get(together(kept, fixes))
        if one is None or other is None:
            continue
        using = [n for n in one.marks if n in other.marks and (roles & AFFECT_ALL or roles & set(one.sensors[n]))]
        if not using:
            continue
        pairs = of[log] = {name: readable(one.marks[name], other.marks[name]) for name in using}
        if log in apart:
            continue
        kept_by_user = {max(using, key=lambda n: len(one.sensors[n])), _best(using, one.marks)}
        # other configurations may get worse by chance in one log: only the mean over the logs counts
        if any(
            worsens_alone(*pairs[n]) if n in kept_by_user else n not in BASES and worsens_far(*pairs[n])
            for n in using
        ):
            losers.append(log)
        gained += any(improves(*pair) for pair in pairs.values())
    judges = [log for log in of if log not in apart]
    everywhere = [n for n in of[judges[0]] if all(n in of[log] for log in judges)] if judges else []
    if not everywhere:
        return CommonTrial(fixes)
    gains = {name: fmean(gain(*of[log][name]) for log in judges) for name in everywhere}
    most = max(everywhere, key=lambda name: gains[name])
    least = MIN_GAIN if of[judges[0]][most][0].position is not None else MIN_GAIN_NATS
    kept_gains = [gains[n] for n in everywhere if n not in BASES] or [gains[most]]
    helps = not losers and 2 * gained >= len(judges) > 1 and gains[most] > least > -min(gains.values())
    helps = helps and min(kept_gains) > -MAX_MEAN_LOSS
    shown_by = {log: pairs[most] for log, pairs in of.items() if most in pairs}
    return CommonTrial(fixes, most, shown_by, tuple(losers), helps, gains[most])


def _best(names: Sequence[str], marks: Mapping[str, Marks]) -> str:
    """Return the configuration with the smallest position error, of those with sensors if any; else the first."""
    names = [n for n in names if n not in BASES] or names
    known = {n: p for n in names if (p := marks[n].position) is not None}
    return min(known, key=lambda n: known[n]) if known else names[0]
