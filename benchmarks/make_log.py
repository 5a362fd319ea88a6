"""Write a large log for timing: python -m benchmarks.make_log OUT.mcap --minutes 60.

A robot drives laps in a room (benchmarks/loop_drive.py) while encoders, a compass, a laser and, on request, a
camera are recorded with consistent noise. What is drawn depends on --seed alone.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import click
import numpy as np
import tomli_w
from mcap.writer import CompressionType, Writer

from locfuse.formats.container.mcap_write import StandardMessages

if not __package__:  # run as a script: python benchmarks/make_log.py
    sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from benchmarks import recorded
from benchmarks.loop_drive import LANDMARK, Array, Loop, walls
from benchmarks.recorded import Camera, Compass, Encoders, Laser, RawPictures, Truth, nanoseconds

LATENCY_NS = 2_000_000  # from a reading's stamp to the recorder
BLOCK = 30.0  # s of log in memory at a time


class Topic(NamedTuple):
    """One topic: when it is read and what its messages are."""

    name: str
    msgtype: str
    rate: float  # Hz
    messages: Callable[[Array], list[bytes]]  # times (n,) s -> CDR


def robot_toml(camera: Camera | None) -> str:
    """Return what a user of this robot would write."""
    x, y, theta = Loop().pose(np.zeros(1))[0].tolist()
    tables: dict[str, Any] = {
        "wheels": {"radius": recorded.RADIUS, "track": recorded.TRACK, "noise": recorded.SLIP},
        "start": {"x": x, "y": y, "theta_deg": math.degrees(theta)},
        "compass": {"sigma_deg": math.degrees(recorded.SIGMA_COMPASS)},
        "lrf": {"sigma_range": recorded.SIGMA_RANGE, "sigma_angle_deg": math.degrees(recorded.SIGMA_ANGLE)},
    }
    if camera is not None:
        view = camera.view
        place = {"landmark": list(LANDMARK), "centre": list(view.centre), "inner": view.inner, "outer": view.outer}
        tables["camera"] = {**place, "sigma_deg": 0.3}
    return tomli_w.dumps(tables)


def batches(topics: list[Topic], seconds: float) -> Iterator[list[tuple[int, int, int, bytes]]]:
    """Yield (log time, stamp, topic number, CDR) of all topics, block by block, in the order of the log."""
    for begin in np.arange(0.0, seconds, BLOCK):
        rows: list[tuple[int, int, int, bytes]] = []
        for i, topic in enumerate(topics):
            span = np.ceil(np.array([begin, min(begin + BLOCK, seconds)]) * topic.rate - 1e-9)
            t = np.arange(*span) / topic.rate
            if len(t):
                when = nanoseconds(t)
                rows += zip(
                    (when + LATENCY_NS).tolist(), when.tolist(), [i] * len(t), topic.messages(t), strict=True
                )
        rows.sort(key=lambda row: row[:3])
        yield rows


def write(path: Path, topics: list[Topic], seconds: float, chunk_size: int, compression: str, toml: str) -> int:
    """Write the log and return how many messages it has."""
    store, count = StandardMessages(), 0
    with path.open("wb") as file:
        writer: Any = Writer(file, chunk_size=chunk_size, compression=CompressionType[compression.upper()])
        writer.start(profile="ros2", library="locfuse make_log")
        writer.add_attachment(
            recorded.EPOCH_NS, recorded.EPOCH_NS, "robot.toml", "application/toml", toml.encode()
        )
        channels = []
        for topic in topics:
            schema = writer.register_schema(topic.msgtype, "ros2msg", store.schema(topic.msgtype).encode())
            channels.append(writer.register_channel(topic.name, "cdr", schema))
        for rows in batches(topics, seconds):
            for sequence, (log_time, stamp, i, data) in enumerate(rows, count):
                writer.add_message(channels[i], log_time, data, stamp, sequence)
            count += len(rows)
        writer.finish()
    return count


def size(_context: click.Context, _option: click.Parameter, text: str) -> tuple[int, int]:
    """Read 640x480."""
    width, _, height = text.partition("x")
    if not (width.isdigit() and height.isdigit()):
        raise click.BadParameter(f"{text!r} is not WIDTHxHEIGHT, such as 640x480")
    return int(width), int(height)


@click.command()
@click.argument("out", type=click.Path(dir_okay=False, path_type=Path))
@click.option("--minutes", default=1.0, show_default=True)
@click.option("--encoder-hz", default=50.0, show_default=True)
@click.option("--compass-hz", default=20.0, show_default=True)
@click.option("--scan-hz", default=10.0, show_default=True)
@click.option("--truth-hz", default=10.0, show_default=True)
@click.option("--image-hz", default=0.0, show_default=True)
@click.option("--image-size", default="640x480", callback=size, show_default=True)
@click.option("--raw-image-hz", default=0.0, show_default=True, help="Uncompressed pictures that nothing reads.")
@click.option("--beams", default=361, show_default=True)
@click.option("--sweep", default=0.0, show_default=True, help="Seconds from a scan's first beam to its last.")
@click.option("--walls", "count", default=12, type=click.IntRange(4, 64), show_default=True)
@click.option("--chunk-size", default=1 << 20, show_default=True, help="Bytes before compression.")
@click.option("--compression", default="zstd", type=click.Choice(["none", "lz4", "zstd"]), show_default=True)
@click.option("--seed", default=0, show_default=True)
def main(out: Path, seed: int, **options: Any) -> None:
    """Write the log OUT. A rate of 0 leaves a topic out."""
    drive = Loop()
    rng = [np.random.default_rng(s) for s in np.random.SeedSequence(seed).spawn(4)]
    laser = Laser(drive, rng[0], walls(options["count"]), options["beams"], options["sweep"])
    camera = Camera(drive, rng[1], options["image_size"]) if options["image_hz"] else None
    encoders, compass, truth = Encoders(drive, rng[2]), Compass(drive, rng[3]), Truth(drive)
    topics = [
        Topic("/joint_states", "sensor_msgs/msg/JointState", options["encoder_hz"], encoders.messages),
        Topic("/magnetic_field", "sensor_msgs/msg/MagneticField", options["compass_hz"], compass.messages),
        Topic("/scan", "sensor_msgs/msg/LaserScan", options["scan_hz"], laser.messages),
        Topic("/ground_truth", "geometry_msgs/msg/PoseStamped", options["truth_hz"], truth.messages),
    ]
    if camera is not None:
        name = "/omni/image/compressed"
        topics.append(Topic(name, "sensor_msgs/msg/CompressedImage", options["image_hz"], camera.messages))
    if options["raw_image_hz"]:
        raw = RawPictures(rng[1], options["image_size"])
        topics.append(Topic("/front/image_raw", "sensor_msgs/msg/Image", options["raw_image_hz"], raw.messages))
    topics = [topic for topic in topics if topic.rate > 0]
    seconds = 60.0 * options["minutes"]
    count = write(out, topics, seconds, options["chunk_size"], options["compression"], robot_toml(camera))
    click.echo(f"{out}: {count} messages, {seconds:g} s, {out.stat().st_size / 1e6:.1f} MB", err=True)


if __name__ == "__main__":
    main()
