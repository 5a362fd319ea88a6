"""The tables of a report, for all output formats: configurations, sensors, credit, prediction, input."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Iterator, Mapping
from typing import Any

from msgspec.structs import replace

from .findings import MAX_ANEES, fingerprint
from .table import Cell, Column, Path, Table, latex as latex_of, latex_text, of_values

Report = Mapping[str, Any]
Rows = Iterator[tuple[dict[str, Any], Path]]

CONFIGURATION = Column("configuration", "configuration", kind="text")
SENSOR = Column("sensor", "sensor", kind="text")
ANEES = Column("anees", "ANEES", form="{:.2f}")
RMSE = Column("position_rmse_m", "position rmse", "m", "{:.4f}", brief="rmse", brief_form="{:.3f}")
COLUMNS = (
    RMSE,
    Column("position_median_m", "median", "m", "{:.4f}"),
    Column("position_max_m", "max", "m", "{:.4f}", brief_form="{:.3f}", rank=2),
    Column("final_position_error_m", "final", "m", "{:.4f}", brief_form="{:.3f}", rank=4),
    Column("along_rmse_m", "along rmse", "m", "{:.4f}"),
    Column("cross_rmse_m", "cross rmse", "m", "{:.4f}"),
    Column("heading_rmse_deg", "heading rmse", "°", "{:.3f}", brief="heading", brief_form="{:.2f}", rank=1),
    Column("drift_1m", "drift /1 m", form="{:.2%}"),
    Column("drift_5m", "drift /5 m", form="{:.2%}", brief="drift/5 m", rank=3),
    Column("drift_10m", "drift /10 m", form="{:.2%}"),
    ANEES,
)
ON_DEMAND = ("final_position_error_m", "drift_5m")  # on a terminal only with --verbose
IN_MM = 1.0  # m: lengths are in mm if all errors are smaller (as in the headline),
IN_MM_IF_SMALL = (0.01, 10.0)  # m: or if the smallest is below the first limit and the largest below the second
ASIDE = ("position_median_m", "along_rmse_m", "cross_rmse_m", "drift_1m", "drift_10m")  # only in the full table
MAIN = tuple(c for c in COLUMNS if c.key not in ASIDE)
LOST = Column("lost_share", "lost", form="{:.0%}")
DISTANCE = Column("distance_m", "distance", "m", "{:.2f}")
DURATION = Column("duration_s", "duration", "s", "{:.1f}")
JUDGED_BY = Column("judged_by", "judged by", kind="text")
GAIN = Column("gain_nats", "predicts the rest", "nats", "{:+.2f}")
COUNTS = (
    Column("accepted", "accepted"),
    Column("rejected", "rejected"),
    Column("absent", "unusable"),
    Column("nis", "NIS / dof", form="{:.2f}", brief="NIS"),
)
SENSORS = (
    Column("configuration", "in", kind="text"),
    SENSOR,
    *COUNTS,
    Column("joint_nis", "joint NIS / dof", form="{:.2f}", missing=""),
    Column("verdicts", "not accepted, by reason", kind="long", missing=""),
)
RANKING = (
    CONFIGURATION,
    Column("gain_nats", "gain, nats per number", form="{:+.3f}", missing="leaves nothing out"),
    Column("sensors", "on", kind="text"),
)
SCORES = (
    CONFIGURATION,
    Column("sensor", "predicts", kind="text"),
    Column("numbers", "numbers"),
    Column("score_nats", "score, nats", form="{:.3f}"),
    Column("gain_nats", "gain, nats", form="{:+.3f}"),
    Column("low", "95 % from", form="{:+.3f}"),
    Column("high", "to", form="{:+.3f}"),
    Column("by", "left out in", kind="text"),
)
RANGE = Column("bounds", "consistent range", form="{:.2f}")
CONSISTENCY = (CONFIGURATION, ANEES, RANGE, Column("words", "result", kind="long"))
JITTER = (
    Column("configuration", "under jitter", kind="text"),
    RMSE,
    Column("heading_rmse_deg", "heading rmse", "°", "{:.3f}"),
    ANEES,
    Column("path_moved_m", "path moved at most", "m", "{:.4f}"),
)
CREDIT = (
    SENSOR,
    Column("effect", "effect", kind="text"),
    Column("factor", "factor", form="{:.3g}"),
    Column("low", "95 % from", form="{:.3g}"),
    Column("high", "to", form="{:.3g}"),
    Column("expected", "expected", form="{:.3g}"),
)
CHANGED = (
    Column("key", "setting", kind="text"),
    Column("value", "value", form="{:.6g}", kind="long"),
    Column("unit", "unit", kind="text", missing=""),
    Column("from", "set by", kind="text"),
)
INPUT = (
    Column("stream", "stream", kind="text"),
    Column("topic", "topic", kind="code", missing="not used"),
    Column("messages", "messages", missing=""),
    Column("dropped", "dropped, and why", kind="long", missing="nothing"),
)


SENSORS_NOTE = (
    "NIS: 1 is right. Above 1: noise set too low, or clock, mount or scale wrong. Below: noise set too high. "
    "unusable: readings that gave no measurement"
)
MAX_JUMPS = 30  # rows: the largest jumps
MIN_AGREEMENT = 0.3  # revisit agreement; below it the path is wrong, and its crispness is not shown
AGREEMENT = Column("revisit_agreement", "revisits agree", form="{:.0%}", rank=5)
CRISPNESS = Column("crispness", "crispness", rank=5)
JUMPS = (
    CONFIGURATION,
    Column("t_s", "at", "s", "{:.1f}"),
    Column("kind", "what", kind="text"),
    Column("dx_m", "moved in x", "m", "{:+.3f}"),
    Column("dy_m", "in y", "m", "{:+.3f}"),
    Column("dtheta_deg", "turned", "°", "{:+.2f}"),
)
KINDS = {"slip": "wheel slip undone", "relocalised": "lost robot found again", "loop": "loop closed"}  # by kind


def has_figures(report: Report) -> bool:
    """Return whether any configuration has an error figure."""
    return any(v.get(c.key) is not None for c in COLUMNS for v in report["configurations"].values())


def errors_are_in_mm(report: Report) -> bool | None:
    """Return whether the table of errors is in mm, else in m; None without errors."""
    rows = report["configurations"].values()
    errors = [e for c in COLUMNS if c.unit == "m" for v in rows if (e := v.get(c.key))]
    most = IN_MM_IF_SMALL[1] if errors and min(errors) < IN_MM_IF_SMALL[0] else IN_MM
    return max(errors) < most if errors else None


def configurations(report: Report, main: bool = True) -> Table:
    """Return the error figures of every configuration: the main figures, or all.

    If there are no errors, return distance and duration.
    """
    rows = report["configurations"].values()
    found = [c for c in (MAIN if main else COLUMNS) if any(v.get(c.key) is not None for v in rows)]
    found += [LOST] if any(v.get(LOST.key) for v in rows) else []
    found += [JUDGED_BY] if report.get("reference") else []
    if errors_are_in_mm(report):
        in_mm = {"unit": "mm", "scale": 1000.0, "form": "{:.1f}", "brief_form": "{:.1f}"}
        found = [replace(c, **in_mm) if c.unit == "m" else c for c in found]
    found = [*(found or (DISTANCE, DURATION)), *([] if main and report.get("truth") else _scan_quality(report))]
    label = "Main figures of every configuration" if main else "All figures of every configuration"
    return of_values(_readable((CONFIGURATION, *found), report), _configurations(report), label)


def _readable(columns: Iterable[Column], report: Report) -> tuple[Column, ...]:
    """Return the columns; if the noise of the truth is not configured, large ANEES are shown as "over 50"."""
    truth = report.get("settings", {}).get("truth", {})
    known = report["truth"] is None or truth.get("sigma") or truth.get("sigma_theta_deg")
    return tuple(replace(c, most=MAX_ANEES) if c == ANEES and not known else c for c in columns)


def _configurations(report: Report, key: str | None = None) -> Rows:
    """Yield (values, path in report.json) of each configuration, or of its sub-table `key`.

    Added values: the sensors of the reference ("all", "camera", "compass+lrf"), with " *" if the judged result
    uses some of them too, else with " ?" if it contradicts the reference of all sensors; "itself" if it is the
    reference; and the number of crispness cells relative to the fewest ("x 1.20"), or "bad" if the revisit
    agreement is low.
    """
    runs = report["configurations"]
    fewest = min(filter(None, (v.get("crispness_cells") for v in runs.values() if _agrees(v))), default=0)
    for name, values in runs.items():
        judged_by, crispness = None, None if _agrees(values) else "bad"
        if reference := values.get("reference"):
            every = not reference["left_out"] and len(reference["sensors"]) > 1
            mark = " *" if reference["shared"] else "" if reference["agrees"] else " ?"
            judged_by = f"{'all' if every else '+'.join(reference['sensors'])}{mark}"
            judged_by = "itself" if values.get("position_max_m") == 0.0 else judged_by
        if fewest and not crispness and (cells := values.get("crispness_cells")):
            crispness = f"x {cells / fewest:.2f}"
        more = {"configuration": name, JUDGED_BY.key: judged_by, CRISPNESS.key: crispness}
        if own := values if key is None else values.get(key):
            yield {**own, **more}, ("configurations", name, *([key] if key else []))


def _scan_quality(report: Report) -> list[Column]:
    """Return the table columns "revisits agree" and "crispness", without those that have no value."""
    found, runs = {AGREEMENT.key: AGREEMENT, "crispness_cells": CRISPNESS}, report["configurations"].values()
    return [column for key, column in found.items() if any(v.get(key) is not None for v in runs)]


def _agrees(values: Mapping[str, Any]) -> bool:
    """Return whether the revisit agreement is at least MIN_AGREEMENT, or unknown."""
    agreement = values.get(AGREEMENT.key)
    return agreement is None or agreement >= MIN_AGREEMENT


def jumps(report: Report) -> Table:
    """Return the MAX_JUMPS largest jumps of the estimate (slip, relocalisation, loop closure).

    Rows are sorted by configuration and time.
    """
    found = [
        (
            {**event, "kind": KINDS.get(event["kind"], event["kind"]), "configuration": name},
            ("configurations", name, "events", i),
        )
        for name, values in report["configurations"].items()
        for i, event in enumerate(values.get("events", ()))
    ]
    largest = sorted(found, key=lambda row: -math.hypot(row[0]["dx_m"], row[0]["dy_m"], row[0]["dtheta_deg"] / 30))
    rows = sorted(largest[:MAX_JUMPS], key=lambda row: (row[0]["configuration"], row[0]["t_s"]))
    words = "Jumps of the pose" if len(found) <= MAX_JUMPS else f"The largest {MAX_JUMPS} of {len(found)} jumps"
    return of_values(JUMPS, rows, words)


def brief(report: Report, short: bool = False) -> Table:
    """Return the table of configurations for a terminal: error figures, or else distance and prediction score.

    With `short`, the error of a smoothed result is in the row of its filter, and the columns of ON_DEMAND are left
    out.
    """
    if has_figures(report):
        return _short(report) if short else configurations(report)
    ranking = (report.get("prediction") or {}).get("ranking", ())
    gains = {r["configuration"]: r["gain_nats"] for r in ranking}
    columns = [CONFIGURATION, DISTANCE]
    columns += [GAIN] if ranking else []
    columns += _scan_quality(report)
    rows = (({**values, GAIN.key: gains.get(at[1])}, at) for values, at in _configurations(report))
    return of_values(columns, rows)


def _short(report: Report) -> Table:
    """Return the main figures, one row per configuration with its filtered and smoothed error."""
    table, runs = configurations(report).without(*ON_DEMAND), report["configurations"]
    after = {v["configuration"]: v.get(RMSE.key) for v in runs.values() if v.get("smoothed")}
    if not any(after.values()):
        return table
    at = 1 + [c.key for c in table.columns].index(RMSE.key)
    rmse = table.columns[at - 1]
    smoothed = replace(rmse, key="smoothed", heading="smoothed", brief="smoothed", missing="", rank=5)
    causal = (row for row in table.rows if not runs[row[0].value].get("smoothed"))
    rows = tuple((*row[:at], Cell(after.get(row[0].value)), *row[at:]) for row in causal)
    columns = (*table.columns[:at], smoothed, *table.columns[at:])
    return replace(table, columns=columns, rows=rows).without("position_max_m")


def sensors(report: Report) -> Table:
    """Return the counts of each sensor's measurements by verdict, of filtered results."""
    rows = []
    for name, values in report["configurations"].items():
        for sensor, found in {} if values.get("smoothed") else values["sensors"].items():
            refused = {k: v for k, v in found["verdicts"].items() if k != "accepted"}
            own = {**found, "configuration": name, "sensor": sensor, "verdicts": refused}
            rows.append((own, ("configurations", name, "sensors", sensor)))
    return of_values(SENSORS, rows, "Each sensor's measurements by verdict")


def ranking(report: Report) -> Table:
    """Return the configurations, ranked by how well they predict the sensors that they do not use."""
    found = enumerate(report["prediction"]["ranking"])
    rows = (({**r, "sensors": ", ".join(r["sensors"])}, ("prediction", "ranking", i)) for i, r in found)
    return of_values(RANKING, rows, "Ranked by prediction")


def scores(report: Report) -> Table:
    """Return the log scores [nats]: how well each configuration predicts each sensor that it does not use."""
    where = {"stretches": "stretches", "sensors": "all of the drive"}
    found = enumerate(report["prediction"]["scores"])
    rows = (({**s, "by": where[s["by"]]}, ("prediction", "scores", i)) for i, s in found)
    return of_values(SCORES, rows, "Predictions of each sensor")


def consistency(report: Report) -> Table:
    """Return ANEES, its range for a consistent filter, and the result in words, for every configuration."""
    rows = _configurations(report, "consistency")
    return of_values(_readable(CONSISTENCY, report), rows, "Consistency of every configuration")


def jitter(report: Report) -> Table:
    """Return the range of each configuration's main figures on slightly changed drives."""
    found = [v["jitter"] for v in report["configurations"].values() if v.get("jitter")]
    columns = [JITTER[0], *(c for c in JITTER[1:] if any(c.key in values for values in found))]
    return of_values(columns, _configurations(report, "jitter"), "Ranges of the main figures under jitter")


def credit(report: Report) -> Table:
    """Return every sensor's effects on the position error."""
    rows = []
    for sensor, values in report["credit"]["sensors"].items():
        others = " and ".join(values["beside"])
        beside = f"beside {others}" if others else "alone"
        effects = {"credit": "credit", "alone": beside, "leave_one_out": "last, beside all others"}
        for kind, title in effects.items():
            at = ("credit", "sensors", sensor, kind)
            rows += [({**values[kind], "sensor": sensor, "effect": title}, at)] if values[kind] else []
    return of_values(CREDIT, rows, "Credit of every sensor")


def streams(report: Report) -> Table:
    """Return topic, messages and dropped readings of each stream, and the reasons for absent sensors."""
    source = report["input"]
    rows = [
        (
            Cell(role),
            Cell(topic),
            Cell(source["messages"].get(topic), ("input", "messages", topic)),
            Cell(source["dropped"].get(role), ("input", "dropped", role)),
        )
        for role, topic in source["topics"].items()
    ]
    absent = [(Cell(sensor), Cell(), Cell(), Cell(why)) for sensor, why in report["absent"].items()]
    return Table(INPUT, (*rows, *absent), "What was read and what was dropped")


def changed_settings(report: Report) -> Table:
    """Return the settings that differ from their defaults, with unit and source."""
    rows = []
    for key, changed in report["changed_settings"].items():
        value = changed["value"]
        numbers = value if isinstance(value, list) else [value]
        if not numbers or not all(isinstance(v, int | float) and not isinstance(v, bool) for v in numbers):
            value = json.dumps(value).strip('"')
        rows.append(({**changed, "key": key, "value": value}, ("changed_settings", key)))
    return of_values(CHANGED, rows, "Settings that were changed")


def everything(report: Report) -> Table:
    """Return the rows of report.csv.

    They have every value of a configuration except lists, and the counts of every sensor.
    """
    runs = report["configurations"]
    keys = dict.fromkeys(k for v in runs.values() for k, x in v.items() if not isinstance(x, Mapping | list))
    keys.pop("configuration")  # the first column has the name of the row instead, such as all-smoothed
    names = dict.fromkeys(sensor for v in runs.values() for sensor in v["sensors"])
    counts = {f"{s}_{c.key}": (s, c.key) for s in names for c in COUNTS}
    rows = []
    for values, at in _configurations(report):
        own = {flat: values["sensors"].get(s, {}).get(key) for flat, (s, key) in counts.items()}
        rows.append(({**values, **own}, at))
    return of_values([Column(key, key) for key in ("configuration", *keys, *counts)], rows)


def latex(report: Report) -> str:
    """Return report.tex: the table of configurations as LaTeX."""
    source = report["input"]
    return (
        f"% {latex_text(source['name'])}, {fingerprint(source, 16)}, locfuse {report['locfuse']}\n"
        f"% needs \\usepackage{{booktabs}} and \\usepackage{{textcomp}}\n{latex_of(configurations(report))}\n"
    )
