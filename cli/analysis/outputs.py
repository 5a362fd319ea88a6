"""Files of a result by kind, and trajectories in the formats of other tools (--export)."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from locfuse.formats.logs.clock import MAX_DELAY_S
from locfuse.formats.report import json_report, table, tables
from locfuse.formats.results import trajectory as to
from locfuse.formats.robot import robot_toml
from locfuse.formats.whole_files import Content
from locfuse.fusion import se2
from locfuse.fusion.chi_square import chi_square
from locfuse.fusion.data import Drive, Estimates, Event
from locfuse.fusion.measure import thinned
from locfuse.fusion.sensors.registry import REGISTRY, colours, of_points
from locfuse.fusion.wheels.states import WHEEL_STATES

from . import results
from .compare import Compared
from .load import Loaded
from .robot_tables import files_of
from .verdicts import credit_values

if TYPE_CHECKING:
    from locfuse.formats.figures.panels import Scene

MCAP = "estimates.mcap"


def files(compared: Compared, report: Mapping[str, Any], kinds: Collection[str]) -> dict[str, Content]:
    """Return file name -> content for these kinds of output."""
    from locfuse.formats.report import markdown

    drive, out = compared.loaded.drive, dict[str, Content]()

    def page() -> str:
        from locfuse.formats.figures.sections import sections
        from locfuse.formats.report import html  # imports markupsafe

        return html.render(report, sections(scene(compared)), colours())

    if "tum" in kinds:
        out |= exported_files(["tum"], compared.loaded, {e.name: e for e in compared.estimates})
        out |= {} if drive.truth is None else {"truth.tum": to.truth_tum(drive, drive.truth)}
    made: dict[str, Callable[[], str]] = {
        "html": page,
        "md": lambda: markdown.render(report),
        "csv": lambda: table.csv(tables.everything(report)),
        "tex": lambda: tables.latex(report),
        "json": lambda: json_report.encode(report),
    }
    return out | {f"report.{kind}": make() for kind, make in made.items() if kind in kinds}


def scene(compared: Compared) -> Scene:
    """Return all data that figures show: drive, estimates, evaluations, and NIS with chi-square bounds."""
    from locfuse.formats.figures.panels import Scene

    drive, drawn = compared.loaded.drive, compared.drawn
    dof = 3 if any(j.heading is not None for j in compared.evaluations) else 2
    return Scene(
        drive=drive,
        estimates=[drawn.best if drawn.best and drawn.best.name == e.name else e for e in compared.estimates],
        evaluations=compared.evaluations,
        nis=drawn.nis,
        nees_bounds=(chi_square(0.025, dof) / dof, chi_square(0.975, dof) / dof),
        components={sensor: REGISTRY[sensor].components for sensor in drive.measurements},
        credit=credit_values(compared.credit) if compared.credit else None,
        landmarks=_landmarks(compared),
        events=events(compared.loaded, () if drawn.best is None else (drawn.best,)),
        states=WHEEL_STATES | {name: shown for s in REGISTRY.values() for name, shown in s.states.items()},
    )


def places(sensor: str, settings: Any) -> list[tuple[float, float]]:
    """Return the configured positions [m, map frame] of a sensor's landmarks and anchors."""
    given = settings.places.values() if sensor in of_points() and not settings.grows else ()
    found = (REGISTRY[sensor].landmark(settings), *given)
    return [(float(p[0]), float(p[1])) for p in found if p is not None]


def _landmarks(compared: Compared) -> list[tuple[float, float]]:
    """Return positions [m, map frame] of landmarks and anchors, given or estimated."""
    loaded = compared.loaded
    found = [p for s in loaded.drive.measurements for p in places(s, loaded.robot.settings(s))]
    best = max(compared.estimates, key=lambda e: (len(e.points), len(e.sensors)))
    return list(dict.fromkeys([*found, *((float(x), float(y)) for _, x, y in best.points)]))


def events(loaded: Loaded, runs: Iterable[Estimates]) -> list[Event]:
    """Return timed events: fault labels of the log, events of the drive and of runs with audits."""
    from locfuse.fusion.judge.events import events_of_drive, events_of_run

    found = [*loaded.labels, *events_of_drive(loaded.drive)]
    for e in runs:
        found += events_of_run(thinned(loaded.drive, e.rates) if e.rates else loaded.drive, e)
    return sorted(found)


def exported_files(kinds: Collection[str], loaded: Loaded, found: Mapping[str, Estimates]) -> dict[str, Content]:
    """Return file name -> content in the formats of other tools; `found` has the trajectories by file name."""
    out: dict[str, Content] = {}
    writers: dict[str, dict[str, Callable[[Drive, Estimates], Iterator[str]]]] = {
        "kitti": {"_kitti.txt": to.kitti_blocks, "_kitti_times.txt": to.kitti_times},
        "tum": {".tum": to.tum_blocks},
        "tum-cov": {"_cov.tum": to.tum_covariance_blocks},
        "csv": {".csv": to.csv_blocks},
    }
    for ending, blocks in ((end, b) for kind in kinds for end, b in writers.get(kind, {}).items()):
        out |= {f"{n}{ending}": partial(to.write_blocks, blocks(loaded.drive, e)) for n, e in found.items()}
    if {"mcap", "log"} & set(kinds):
        out |= _mcap(loaded, found, "log" in kinds)
    return out


def _mcap(loaded: Loaded, found: Mapping[str, Estimates], with_log: bool) -> dict[str, Content]:
    """Return the MCAP file with the estimates as ROS 2 messages, and layouts to show it."""
    from locfuse.formats.results.mcap_export import Export, layouts

    tables = results.settings_tables(loaded.robot)
    for name, key, text in list(files_of(tables)):
        if not loaded.log.recorded(text):  # a file that is not part of the exported copy
            tables[name].pop(key, None)
    drive = loaded.drive
    delay_s = loaded.log.stream(loaded.choice.topics["wheels"], loaded.robot.order).delay_s or 0.0
    dt = np.diff(drive.t, prepend=drive.t[0])
    export = Export(
        drive=drive,
        estimates=tuple(found.values()),
        # mean body twist (n, 3) [m/s, m/s, rad/s] by the wheels over the interval that ends at each t
        twist=se2.log(drive.motions.u) / np.where(dt > 0.0, dt, np.inf)[:, None],
        robot_toml=robot_toml.dump(tables).encode(),
        clock_ns=round(delay_s * 1e9) if abs(delay_s) > MAX_DELAY_S else 0,
        log=loaded.log if with_log else None,
    )
    return {MCAP: export.write, **layouts(export.topics)}
