"""What each dependency costs: its size on disk, its import, and what a run can do without it.

    python -m benchmarks.dependencies           print the table of docs/install.md
    python -m benchmarks.dependencies --write   put today's table into the page

Sizes are those of the installed files (of this platform), imports the CPU time of a fresh interpreter less that of
an empty one, the least of five. `locfuse --help` imports click only.
"""

from __future__ import annotations

import re
import sys
from importlib import metadata
from pathlib import Path

from benchmarks import experiment
from benchmarks.__main__ import cost
from locfuse.cli.analysis.errors import PACKAGES

PAGE = Path(__file__).parent.parent / "docs" / "install.md"
MODULES = {package: module for module, package in PACKAGES.items()}
USES = {
    "click": "every command",
    "msgspec": "settings, reports: every run",
    "numpy": "every run",
    "mcap": "`--export mcap`, `simulate`, `recover`",
    "rosbags": "message definitions, ROS 1 and .db3: every run",
    "lz4": "logs compressed with lz4",
    "zstandard": "logs compressed with zstd",
    "rich": "tables on a terminal",
    "opencv-python-headless": "a camera",
    "scipy": "`--smooth` with loops, `tune`, `calibrate`",
    "matplotlib": "report.html, `--figures`",
    "jinja2": "report.html",
    "rerun-sdk": "Rerun recordings, `view`, fleet.parquet (by its pyarrow)",
    "tomli_w": "writing robot.toml",
}
RUNS = 5


def needed() -> list[str]:
    """Return the packages that locfuse names itself."""
    lines = metadata.requires("locfuse") or []
    return [re.split(r"[<>=!~\[; ]", line)[0] for line in lines if "extra ==" not in line]


def with_their_own(package: str) -> set[str]:
    """Return a package and everything that it needs in turn, extras left out."""
    found, waiting = set[str](), [package]
    while waiting:
        name = _plain(waiting.pop())
        if name in found:
            continue
        try:
            lines = metadata.requires(name) or []
        except metadata.PackageNotFoundError:
            continue
        found.add(name)
        waiting += [re.split(r"[<>=!~\[;( ]", line)[0] for line in lines if "extra ==" not in line]
    return found


def _plain(name: str) -> str:
    return re.sub(r"[-_.]+", "-", name).lower()


def megabytes(packages: set[str]) -> float:
    """Return the size of packages on disk."""
    files = [file for package in packages for file in metadata.files(package) or []]
    paths = [Path(str(file.locate())) for file in files]
    return sum(path.stat().st_size for path in paths if path.is_file()) / 1e6


def seconds(code: str) -> float:
    """Return the CPU time that a fresh interpreter takes for some code: the least of a few."""
    return min(cost((sys.executable, "-c", code)).cpu for _ in range(RUNS))


def table() -> list[str]:
    """Return the rows, the largest first."""
    empty = seconds("pass")
    rows = []
    for package in needed():
        own, all_of_it = megabytes({_plain(package)}), megabytes(with_their_own(package))
        module = MODULES.get(package, package)
        rows.append((own, all_of_it, package, seconds(f"import {module}") - empty))
    lines = ["| package | MB | MB with what it needs | import [s] | used for |", "|---|--:|--:|--:|---|"]
    for own, all_of_it, package, took in sorted(rows, reverse=True):
        lines.append(f"| {package} | {own:.1f} | {all_of_it:.1f} | {max(took, 0.0):.2f} | {USES[package]} |")
    everything = {name for package in needed() for name in with_their_own(package)}
    lines.append(f"| **all of them** | | **{megabytes(everything):.0f}** | | |")
    return lines


def main(write: bool) -> None:
    """Print the table, or put it into the page."""
    today = table()
    if write:
        experiment.put(PAGE, "dependencies", today)
    else:
        print("\n".join(today))


if __name__ == "__main__":
    main("--write" in sys.argv)
