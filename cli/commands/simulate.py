"""`locfuse simulate` and `paper`, which need no log: a drive with known truth, and the paper's experiment."""

from __future__ import annotations

from pathlib import Path

import click

from locfuse.cli.terminal import options as o
from locfuse.cli.terminal.screen import put, say


@click.command()
@click.argument("scenario", required=False)
@o.option("-o --out", "Log to write (.mcap).", type=o.FILE)
@o.option("--seed", "Seed of the random numbers.  [default: the scenario's]", type=click.IntRange(0))
@o.each(
    "--set sets",
    "Set one key of the scenario, e.g. --set compass.noise_deg=0.1. Repeatable.",
    metavar="TABLE.KEY=VALUE",
)
@o.flag("--list listing", "List the included scenarios.")
@o.flag("--show", "Print the scenario with all keys as TOML; start your own from it.")
@o.OVERWRITE
@o.flag("--json as_json", "Print the true values of the drive as JSON.")
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
    """Simulate SCENARIO, and record it as an MCAP log with known truth.

    SCENARIO is a TOML file or the name of an included scenario.

    \b
    locfuse simulate rounded_rectangle -o drive.mcap --seed 7
    locfuse simulate rounded_rectangle -o drive.mcap --set compass.noise_deg=0.1 --set control.estimator=all
    locfuse simulate rounded_rectangle --show > mine.toml
    """
    import json

    from locfuse.cli.session import simulate as job
    from locfuse.formats.whole_files import may_replace
    from locfuse.fusion.data import UsageError
    from locfuse.sample_logs import scenario as scenarios
    from locfuse.sample_logs.simulate import speed_stability

    if listing:
        for name in scenarios.names():
            say(f"{name:24} {scenarios.load(name).title}")
        return
    if scenario is None:
        raise UsageError("which SCENARIO? See: locfuse simulate --list")
    chosen = scenarios.load(scenario, sets)
    if show:
        put(scenarios.dumps(chosen))
        return
    if out is None:
        raise UsageError("where to? Name the log with -o LOG.mcap")
    may_replace(out, overwrite)
    seed = chosen.seed if seed is None else seed
    outcome = job.drive(chosen, seed, out)
    stability = speed_stability(outcome)
    facts = {
        "log": str(out),
        "seed": seed,
        "duration_s": round(outcome.duration, 3),
        "way_m": round(outcome.way, 3),
        "missed_encoder_transitions": outcome.missed,
        "speed_worst_percent": round(100 * stability.worst, 2),
        "speed_within_5_percent": round(stability.within_5_percent, 4),
    }
    if as_json:
        put(json.dumps(facts, indent=2) + "\n")
    else:
        say(
            f"{out}: {facts['duration_s']} s, {facts['way_m']} m; wheel speeds within "
            f"{facts['speed_worst_percent']} % of their set points over 0.1 s"
        )


@click.command()
@o.option(
    "-o --out",
    "Folder for the table, the figures and the page.",
    type=o.DIRECTORY,
    default=Path("locfuse-out/paper"),
    show_default=True,
)
@o.OVERWRITE
@o.option(
    "-j --jobs", "Number of drives to run at once.", type=click.IntRange(min=1), default=2, show_default=True
)
@o.flag("--json as_json", "Print the figures as JSON instead of a table.")
@o.flag("--open shown", "Open the page in the browser when it is written.")
@o.flag("-q --quiet", "Print no progress.")
def paper(out: Path, overwrite: bool, jobs: int, as_json: bool, shown: bool, quiet: bool) -> None:
    """Repeat the paper's experiment: its table, figures 12, 13 and 14, in one folder and on one page.

    Each figure comes as SVG and PDF, one column wide, once with our filter and once with the equations as printed.
    Nothing is downloaded: logs and scenarios are included.

    \b
    locfuse paper -o paper
    locfuse paper -o paper --open
    """
    from locfuse.cli.session import paper as job
    from locfuse.cli.terminal import show
    from locfuse.formats.report import json_report, paper_page
    from locfuse.formats.whole_files import may_write, write_results

    may_write(out, overwrite, ())
    with show.progress(quiet) as progress:
        found = job.repeat(progress, jobs)
        progress("drawing figures")
        values = json_report.plain(found.values())
        files = job.files(found, values)
    write_results(out, files, overwrite)
    if as_json:
        put(json_report.encode(values))
    else:
        show.table(paper_page.table(values))
        show.lines([paper_page.conclusion(values)])
        drives = values["figure_14"]
        show.lines(f"fig. {d['figure']}, {d['steered']}: {d['rms']:.3f} m rms from the path" for d in drives)
        show.end([out / name for name in files])
    if shown:
        show.open_page([out / name for name in files])
