"""`locfuse simulate`: a drive with known truth, as a log."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING

import click

if TYPE_CHECKING:
    from ..sample_logs.messages import Estimator, Pose, RawMessage
    from ..sample_logs.scenario import Scenario


def dead_reckoning(scenario: Scenario) -> Estimator:
    """Return the plainest localisation: wheel angles, summed up from the start of the path."""
    from ..sample_logs.path import PathFollower

    x, y, theta = PathFollower(scenario.path, 1.0).start
    last: list[float] = []

    def estimate(messages: list[RawMessage]) -> Pose:
        nonlocal x, y, theta
        for message in messages:
            if message.topic != "/joint_states":
                continue
            now = message.fields["position"].tolist()
            if last:
                left, right = (scenario.wheels.radius * (b - a) for a, b in zip(last, now, strict=True))
                ds, turn = (left + right) / 2, (right - left) / scenario.wheels.track
                x += ds * math.cos(theta + turn / 2)
                y += ds * math.sin(theta + turn / 2)
                theta += turn
            last[:] = now
        return x, y, theta

    return estimate


@click.command()
@click.option("-o", "--out", type=click.Path(path_type=Path, dir_okay=False), required=True, help="Log to write.")
@click.option("--seed", type=int, default=1, show_default=True)
def simulate(out: Path, seed: int) -> None:
    """Drive a scenario and record it as an MCAP log with known truth."""
    import tomli_w

    from ..formats.mcap_write import LogWriter
    from ..sample_logs.scenario import Scenario
    from ..sample_logs.simulate import robot_tables
    from ..sample_logs.simulate import simulate as drive

    scenario = Scenario(seed=seed)
    with LogWriter(out) as log:
        log.attach("robot.toml", tomli_w.dumps(robot_tables(scenario)).encode())

        def emit(m: RawMessage) -> None:
            log.write(
                m.topic,
                m.msgtype,
                m.fields,
                m.log_ns,
                stamp_ns=m.stamp_ns,
                frame_id=m.frame_id,
                latched=m.topic == "/tf_static",
            )

        outcome = drive(scenario, seed, dead_reckoning(scenario), emit)
    click.echo(f"{outcome.duration:.1f} s in {out}")


if __name__ == "__main__":
    simulate()
