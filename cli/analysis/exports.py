"""--export: results in the formats of other tools."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from locfuse.formats.whole_files import Content
    from locfuse.fusion.data import Array, Drive, Estimates

    from .load import Loaded

KINDS = {
    "mcap": "estimates.mcap for Foxglove and rosbag2: Odometry with covariance, Path, /tf, truth",
    "log": "the same with every message of the log beside them",
    "kitti": "12 numbers a line, stamps in a file beside it",
    "tum": "",
    "tum-cov": "TUM and the upper triangle of the 6 x 6 covariance",
    "csv": "with covariance",
}
MCAP = "estimates.mcap"
OTHER_CLOCK_S = 1.0  # s between stamps and recording: more is another clock, in which players live


def files(kinds: Collection[str], loaded: Loaded, found: Mapping[str, Estimates]) -> dict[str, Content]:
    """Return the files of these kinds; `found` gives each trajectory the name of its files."""
    from locfuse.formats.results import trajectory as to

    out: dict[str, Content] = {}
    writers: dict[str, dict[str, Callable[[Drive, Estimates], str]]] = {
        "kitti": {"_kitti.txt": to.estimates_kitti, "_kitti_times.txt": to.kitti_times},
        "tum": {".tum": to.estimates_tum},
        "tum-cov": {"_cov.tum": to.estimates_tum_covariance},
        "csv": {".csv": to.estimates_csv},
    }
    for kind, endings in writers.items():
        if kind in kinds:
            out |= {f"{n}{end}": w(loaded.drive, e) for n, e in found.items() for end, w in endings.items()}
    if {"mcap", "log"} & set(kinds):
        out[MCAP] = _mcap(loaded, found, "log" in kinds)
    return out


def _mcap(loaded: Loaded, found: Mapping[str, Estimates], with_log: bool) -> Callable[[Any], None]:
    from locfuse.formats.results.mcap_export import Export
    from locfuse.formats.robot import robot_toml

    from .key import files_of
    from .results import settings_tables

    tables = settings_tables(loaded.robot)
    for table, key, text in list(files_of(tables)):
        if not loaded.log.recorded(text):  # a file of this machine: it does not go with the copy
            tables[table].pop(key, None)
    drive = loaded.drive
    export = Export(
        drive=drive,
        estimates=tuple(found.values()),
        twist=_twist(drive),
        robot_toml=robot_toml.dump(tables).encode(),
        clock_ns=_other_clock(loaded),
        log=loaded.log if with_log else None,
    )
    return export.write


def _twist(drive: Drive) -> Array:
    """Return the mean body twist (n, 3) by the wheels over the interval that ends at each instant."""
    import numpy as np

    from locfuse.fusion import se2

    dt = np.diff(drive.t, prepend=drive.t[0])
    twist: Array = se2.log(drive.motions.u) / np.where(dt > 0.0, dt, np.inf)[:, None]
    return twist


def _other_clock(loaded: Loaded) -> int:
    """Return by how much the recording's clock runs ahead of the stamps, 0 for one clock [ns]."""
    delay = loaded.log.stream(loaded.choice.topics["wheels"], loaded.robot.order).delay_s or 0.0
    return round(delay * 1e9) if abs(delay) > OTHER_CLOCK_S else 0
