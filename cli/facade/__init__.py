"""locfuse: what is each sensor of my robot worth? EKF localization from recorded logs.

    import locfuse

    session = locfuse.load("rounded_rectangle")     # a log, measured once; or your own .mcap, .bag, folder
    result = session.compare()                      # all configurations: result.verdicts, result.table()
    result.estimates["all"].pose                    # (n, 3) x, y [m], theta [rad], map frame
    result.write("out")                             # the files of `locfuse compare`

Expected errors are LocfuseErrors with one line: what is wrong, where, and what to try. The command line is
`locfuse`, or `python -m locfuse`; docs/python.md compares it with Python.
"""

from __future__ import annotations

import sys
from importlib import import_module
from typing import TYPE_CHECKING, Any

if sys.version_info < (3, 11):  # noqa: UP036  an old pip, or a copied folder: no check of the version
    this = ".".join(map(str, sys.version_info[:2]))
    raise ImportError(f"locfuse needs Python 3.11 or newer, this is {this}: python3.11 -m pip install locfuse")

if TYPE_CHECKING:
    from locfuse.cli.session.result import Comparison, Run
    from locfuse.cli.session.session import Session, evaluate, fuse, info, load, open_log, smooth
    from locfuse.cli.session.simulate import simulate
    from locfuse.cli.session.summary import Summary, compare
    from locfuse.fusion.data import Colour, Component, Drive, Estimates, Evaluation, LocfuseError, Measurements
    from locfuse.fusion.sensor import Ask, Model, Sensor, SensorSettings
    from locfuse.fusion.sensors.registry import register
    from locfuse.fusion.statistics import chi_square

    __version__: str

# Imported when they are used (PEP 562): `import locfuse` alone loads no NumPy, nor does `locfuse --help`.
_HOMES = {
    **dict.fromkeys(("Session", "evaluate", "fuse", "info", "load", "open_log", "smooth"), "cli.session.session"),
    **dict.fromkeys(("Comparison", "Run"), "cli.session.result"),
    **dict.fromkeys(("Summary", "compare"), "cli.session.summary"),
    "simulate": "cli.session.simulate",
    **dict.fromkeys(
        ("Colour", "Component", "Drive", "Estimates", "Evaluation", "LocfuseError", "Measurements"), "fusion.data"
    ),
    **dict.fromkeys(("Ask", "Model", "Sensor", "SensorSettings"), "fusion.sensor"),
    "chi_square": "fusion.statistics",
    "register": "fusion.sensors.registry",
}
__all__ = [
    "Ask",
    "Colour",
    "Comparison",
    "Component",
    "Drive",
    "Estimates",
    "Evaluation",
    "LocfuseError",
    "Measurements",
    "Model",
    "Run",
    "Sensor",
    "SensorSettings",
    "Session",
    "Summary",
    "__version__",
    "chi_square",
    "compare",
    "evaluate",
    "fuse",
    "info",
    "load",
    "open_log",
    "register",
    "simulate",
    "smooth",
]


def __getattr__(name: str) -> Any:
    """Import a public name when it is used. Raises AttributeError for an unknown name."""
    if name == "__version__":
        from locfuse.formats.versions import own

        value: Any = own()
    elif name in _HOMES:
        value = getattr(import_module(f"locfuse.{_HOMES[name]}"), name)
    else:
        raise AttributeError(f"module 'locfuse' has no attribute {name!r}")
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    """Return all public names, imported or not."""
    return sorted({*__all__, "__doc__", "__name__", "__file__", "__path__"})
