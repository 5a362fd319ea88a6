"""Simulated drives: a scenario driven with a localisation of ours in its control loop, recorded as a log."""

from __future__ import annotations

import tempfile
import weakref
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any

from locfuse.cli.analysis.settings import PathLike, Progress, Sets, path_of, set_words, silent
from locfuse.formats.whole_files import may_replace, scratch_prefix
from locfuse.fusion.data import UsageError
from locfuse.fusion.sensors.registry import REGISTRY

from .control_loop import make_estimator
from .python_words import speaks_python
from .session import Session, load

if TYPE_CHECKING:
    from locfuse.sample_logs.messages import Estimator
    from locfuse.sample_logs.record import Localise
    from locfuse.sample_logs.scenario import Scenario
    from locfuse.sample_logs.simulate import Outcome


@speaks_python
def simulate(
    scenario: PathLike,
    out: PathLike | None = None,
    *,
    seed: int | None = None,
    sets: Sets | None = None,
    overwrite: bool = False,
    progress: Progress = silent,
) -> Session:
    """Drive a scenario with known truth, record it as an MCAP log, and load that.

    Args:
        scenario: a TOML file, or the name of a shipped scenario such as "rounded_rectangle".
        out: the log to write (.mcap). None writes a temporary one that goes with the session's log.
        seed: of all chance; None is the scenario's own.
        sets: single keys of the scenario: {"compass.noise_deg": 0.1, "control.estimator": "all"}.
        overwrite: replace an existing file.
        progress: called with the name of every step, such as `print`.

    Raises:
        LocfuseError: no such scenario, a key that it does not have, a file that exists.
    """
    from locfuse.sample_logs import load as scenarios

    chosen = scenarios.load(str(scenario), set_words(sets))
    seed = chosen.seed if seed is None else seed
    if seed < 0:
        raise UsageError(f"seed = {seed}: it must be 0 or more")
    progress("driving")
    if out is not None:
        path = path_of(out)
        may_replace(path, overwrite)
        drive(chosen, seed, path)
        return load(path, progress=progress)
    with ExitStack() as until:
        folder = until.enter_context(tempfile.TemporaryDirectory(prefix=scratch_prefix()))
        path = Path(folder) / f"{Path(scenario).stem}.mcap"
        drive(chosen, seed, path)
        session = load(path, progress=progress)
        weakref.finalize(session.log, until.pop_all().close)  # the log may be read again as long as it lives
    return session


def drive(scenario: Scenario, seed: int, out: Path) -> Outcome:
    """Drive a scenario into a log. Raises LocfuseError where the file cannot be written."""
    from locfuse.sample_logs.record import write_log

    return write_log(scenario, seed, localise(scenario.control.estimator), out)


def facts(outcome: Outcome) -> dict[str, Any]:
    """Return what the simulator knows of a drive: s, m, and how well the wheels kept their speed."""
    from locfuse.sample_logs.stability import speed_stability

    stability = speed_stability(outcome)
    return {
        "duration_s": round(outcome.duration, 3),
        "way_m": round(outcome.way, 3),
        "missed_encoder_transitions": outcome.missed,
        "speed_worst_percent": round(100 * stability.worst, 2),
        "speed_within_5_percent": round(stability.within_5_percent, 4),
    }


def localise(word: str) -> Localise:
    """Return what builds the robot's localisation: "truth", "odometry", "all", or sensors such as compass+lrf."""
    from locfuse.sample_logs.record import on_truth

    def build(tables: dict[str, dict[str, Any]]) -> Estimator | None:
        carried = tuple(name for name in REGISTRY if name in tables)
        asked = {"odometry": [], "all": list(carried)}.get(word, word.replace("+", ",").split(","))
        for name in asked:
            if name not in carried:
                known = ", ".join(("truth", "odometry", *carried, "all"))
                raise UsageError(f"control.estimator = {word}: this robot has no {name}; choose from {known}")
        sensors = tuple(name for name in carried if name in asked)
        return make_estimator({name: tables[name] for name in ("wheels", "start", *sensors)}, sensors)

    return on_truth if word == "truth" else build
