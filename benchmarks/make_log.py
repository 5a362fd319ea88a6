"""Write a large log for timing: python -m benchmarks.make_log OUT.mcap --minutes 60.

The paper's robot drives laps of the rounded rectangle, on its true pose and without a rest. Its laser has
361 beams, its compass no iron.
"""

from __future__ import annotations

from pathlib import Path

import click

from locfuse.sample_logs.load import load
from locfuse.sample_logs.record import on_truth, write_log

LAP_S = 52.5  # s
SETS = (
    *("control.estimator=truth", "control.wait=0", "control.time_limit=1e6", "truth.rate=10"),
    *("lrf.beams=361", "compass.hard_iron=[0, 0]", "compass.soft_iron=[1, 1, 0]"),
)


@click.command()
@click.argument("out", type=click.Path(dir_okay=False, path_type=Path))
@click.option("--minutes", default=1.0, show_default=True)
@click.option("--image-hz", default=0.0, show_default=True, help="0: no camera.")
@click.option("--seed", default=0, show_default=True)
@click.option("--set", "sets", multiple=True, help="Scenario key.")
def main(out: Path, minutes: float, image_hz: float, seed: int, sets: tuple[str, ...]) -> None:
    """Write the log OUT."""
    camera = (f"camera.rate={image_hz}",) if image_hz else ("camera.enabled=false",)
    length = f"path.laps={60.0 * minutes / LAP_S}"
    outcome = write_log(load("rounded_rectangle", (*SETS, *camera, length, *sets)), seed, on_truth, out)
    click.echo(f"{out}: {outcome.duration:.1f} s, {out.stat().st_size / 1e6:.1f} MB", err=True)


if __name__ == "__main__":
    main()
