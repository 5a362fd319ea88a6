"""Costs of each dependency: size on disk, import time, and features that need it.

    python -m benchmarks.dependencies           print the table of docs/install.md

A size is that of the installed files on this platform. An import time is the CPU time of a new interpreter that
imports the package, minus that of an empty one: the smallest of five runs. `locfuse --help` imports only click.
"""

import contextlib
import sys
from importlib import metadata
from pathlib import Path

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name as plain

from benchmarks.__main__ import cost
from benchmarks.experiment import table
from locfuse.cli.analysis.errors import PACKAGES

MODULES = {package: module for module, package in PACKAGES.items()}
USES = {
    "click": "every command",
    "msgspec": "settings, reports: every run",
    "numpy": "every run",
    "mcap": "`--export mcap`, `simulate`, `recover`",
    "rosbags": "message definitions, ROS 1 and .db3: every run",
    "lz4": "logs compressed with lz4",
    "zstandard": "logs compressed with zstd",
    "rich": "the spinner on a terminal",
    "opencv-python-headless": "a camera",
    "scipy": "`--smooth` with loops, `tune`, `calibrate`",
    "matplotlib": "report.html, `--figures`",
    "jinja2": "report.html",
    "rerun-sdk": "Rerun recordings, `view`, fleet.parquet (by its pyarrow)",
    "ruamel.yaml": "maps with a .yaml, parameters of ROS",
    "tomli_w": "writing robot.toml",
}
RUNS = 5


def needed(package: str) -> set[str]:
    """Return the packages that a package requires, without extras; none if it is not installed."""
    with contextlib.suppress(metadata.PackageNotFoundError):
        wanted = [Requirement(line) for line in metadata.requires(package) or []]
        return {plain(one.name) for one in wanted if one.marker is None or one.marker.evaluate({"extra": ""})}
    return set()


def with_their_own(packages: set[str]) -> set[str]:
    found = set[str]()
    while packages:
        found |= packages
        packages = {name for package in packages for name in needed(package)} - found
    return found


def megabytes(packages: set[str]) -> float:
    size = 0
    for package in packages & {plain(d.name) for d in metadata.distributions()}:
        paths = [Path(str(file.locate())) for file in metadata.files(package) or []]
        size += sum(path.stat().st_size for path in paths if path.is_file())
    return size / 1e6


def seconds(code: str) -> float:
    return min(cost((sys.executable, "-c", code)).cpu for _ in range(RUNS))


def main() -> None:
    packages, rows, empty = needed("locfuse"), [], seconds("pass")
    assert packages == {plain(name) for name in USES}
    for name in USES:
        own: set[str] = {plain(name)}
        took = max(seconds(f"import {MODULES.get(name, name)}") - empty, 0.0)
        rows.append((megabytes(own), megabytes(with_their_own(own)), name, took))
    lines = [(name, f"{own:.1f}", f"{all_:.1f}", f"{s:.2f}", USES[name]) for own, all_, name, s in sorted(rows)]
    last = ("**all of them**", "", f"**{megabytes(with_their_own(packages)):.0f}**", "", "")
    head = ("package", "MB", "MB with what it needs", "import [s]", "used for")
    print("\n".join(table(head, [*reversed(lines), last], "123")))


if __name__ == "__main__":
    main()
