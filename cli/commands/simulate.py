"""`locfuse simulate`: a drive with known truth, as a log."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from locfuse.cli.terminal.findings import may_replace
from locfuse.cli.terminal.screen import put, say

if TYPE_CHECKING:
    from locfuse.sample_logs.messages import Estimator
    from locfuse.sample_logs.record import Localise
    from locfuse.sample_logs.scenario import Scenario
    from locfuse.sample_logs.simulate import Outcome


@click.command()
@click.argument("scenario", required=False)
@click.option("-o", "--out", type=click.Path(path_type=Path, dir_okay=False), help="Log to write (.mcap).")
@click.option("--seed", type=click.IntRange(0), help="Seed of all chance.  [default: the scenario's]")
@click.option(
    "--set",
    "sets",
    multiple=True,
    metavar="TABLE.KEY=VALUE",
    help="Set one key of the scenario, e.g. --set compass.noise_deg=0.1. Repeatable.",
)
@click.option("--list", "listing", is_flag=True, help="List the shipped scenarios.")
@click.option("--show", is_flag=True, help="Print the scenario with all its keys as TOML: a start for your own.")
@click.option("--overwrite", is_flag=True, help="Replace an existing file.")
@click.option("--json", "as_json", is_flag=True, help="Print what the simulator knows of the drive as JSON.")
def simulate(
    scenario: str | None,
    out: Path | None,
    seed: int | None,
    sets: tuple[str, ...],
    listing: bool,
    show: bool,
    overwrite: bool,
    as_json: bool,
) -> None:
    """Drive SCENARIO and record it as an MCAP log with known truth.

    SCENARIO is a TOML file or the name of a shipped scenario.

    \b
    locfuse simulate rounded_rectangle -o drive.mcap --seed 7
    locfuse simulate rounded_rectangle -o drive.mcap --set compass.noise_deg=0.1 --set control.estimator=all
    locfuse simulate rounded_rectangle --show > mine.toml
    """
    from locfuse.fusion.data import UsageError
    from locfuse.sample_logs import load

    if listing:
        for name in load.names():
            say(f"{name:24} {load.load(name).title}")
        return
    if scenario is None:
        raise UsageError("which SCENARIO? See: locfuse simulate --list")
    chosen = load.load(scenario, sets)
    if show:
        put(load.dumps(chosen))
        return
    if out is None:
        raise UsageError("where to? Name the log with -o LOG.mcap")
    may_replace(out, overwrite)
    _drive(chosen, chosen.seed if seed is None else seed, out, as_json)


def _drive(scenario: Scenario, seed: int, out: Path, as_json: bool) -> None:
    import json

    from locfuse.sample_logs.record import write_log

    outcome = write_log(scenario, seed, localise(scenario.control.estimator), out)
    facts = {"log": str(out), "seed": seed, **_facts(outcome)}
    if as_json:
        put(json.dumps(facts, indent=2) + "\n")
    else:
        say(
            f"{out}: {facts['duration_s']} s, {facts['way_m']} m; wheel speeds within "
            f"{facts['speed_worst_percent']} % of their set points over 0.1 s"
        )


def _facts(outcome: Outcome) -> dict[str, Any]:
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
    from locfuse.cli.jobs.control_loop import make_estimator
    from locfuse.fusion.data import UsageError
    from locfuse.fusion.sensors.registry import REGISTRY
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
