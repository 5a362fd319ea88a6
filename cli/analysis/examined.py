"""Findings on a loaded log; its odometry settles radius and track of wheels that contradict other sensors."""

from __future__ import annotations

from msgspec.structs import replace

from locfuse.fusion.checks.examine import examine, scales
from locfuse.fusion.checks.finding import Finding, Least
from locfuse.fusion.checks.laser import OPEN_SCALE, size_fix
from locfuse.fusion.checks.truth import WHEEL_SCALE
from locfuse.fusion.checks.turning import turnings
from locfuse.fusion.data import Stream
from locfuse.fusion.truth import looks_like_truth
from locfuse.fusion.wheels.calibrate import geometry_by_odometry
from locfuse.fusion.wheels.odometry import BODY_READS, ODOMETRY

from .load import Loaded
from .topics import filled

SIZES = {"radius", "track", OPEN_SCALE, WHEEL_SCALE}  # codes of findings on sizes of the wheels
MIN_CHANGE = 1e-3  # relative, of a setting that is fixed: four digits are printed


def examined(loaded: Loaded, least: Least | None = None) -> list[Finding]:
    """Return the findings of `examine`; those on the wheels' sizes are one if an odometry settles them.

    Its driver knew radius and track. They are right if no other sensor contradicts them.
    """
    streams = {role: loaded.stream(role) for role in loaded.choice.topics}
    found = examine(loaded.drive, loaded.robot, streams, least)
    if not any(f.code in SIZES and f.severe for f in found):
        return found
    settled = _by_odometry(loaded, streams["wheels"])
    return [*(f for f in found if not settled or f.code not in SIZES), *settled]


def _by_odometry(loaded: Loaded, counters: Stream) -> list[Finding]:
    """Return the finding on radius and track by an odometry of the log; [] if there is none or it does not fit."""
    log, drive, settings = loaded.log, loaded.drive, loaded.robot.wheels
    topics = [t for t in filled(log, ODOMETRY) if not looks_like_truth(t) and t not in loaded.choice.of("truth")]
    counted = counters.msgtype not in BODY_READS and drive.wheels.matched is None
    if not topics or not counted or settings.radius is None or settings.track is None:
        return []
    known = geometry_by_odometry(counters, log.stream(topics[0], loaded.robot.order), settings)
    if known is None or known.track is None or known.mirrored != settings.mirrored:
        return []
    factor = known.radius / settings.radius
    wheels = drive.wheels.rerolled(drive.wheels.rolled * factor, known.track)
    robot = replace(loaded.robot, wheels=replace(settings, radius=known.radius, track=known.track))
    other = replace(drive, wheels=wheels)
    if any(f.code in SIZES and f.severe for f in scales(other, robot, turnings(other))):
        return []
    fix, rival = size_fix(loaded.robot, factor, known.sigmas[0] / settings.radius)
    words = (
        f"{topics[0]} was made with radius {known.radius:.4g} m and track {known.track:.4g} m, which fit the "
        f"other sensors; configured {settings.radius:g} m and {settings.track:g} m{rival}"
    )
    ratios = {fix: factor, f"wheels.track={known.track:.4g}": known.track / settings.track}
    fixes = tuple(fix for fix, ratio in ratios.items() if abs(ratio - 1.0) > MIN_CHANGE)
    return [Finding("wheels", "radius", words, fixes, severe=True)] if fixes else []
