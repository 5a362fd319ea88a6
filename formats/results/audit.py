"""The audit trail: every measurement with what was predicted, how far off it was, and what became of it."""

from __future__ import annotations

import math

from locfuse.fusion.data import VERDICTS, Audit, Drive, Estimates

from .trajectory import seconds, stamps

HEADER = "t,sensor,measurement,verdict,landmark,distance2,threshold,innovation_1,sigma_1,innovation_2,sigma_2"


def audit_csv(drive: Drive, estimates: Estimates) -> str:
    """Return one line per measurement in time order.

    `distance2` is the squared Mahalanobis distance and `threshold` the gate it had to pass; innovations are in the
    sensor's units (rad for headings and bearings; m, rad for a line's r, psi). Empty where nothing was predicted.
    """
    times = [seconds(s) for s in stamps(drive.epoch_ns, estimates.t)]
    rows = [
        (int(k), order, i, line)
        for order, (sensor, audit) in enumerate(estimates.audits.items())
        for i, (k, line) in enumerate(_lines(times, sensor, audit))
    ]
    rows.sort(key=lambda row: row[:3])
    return "\n".join((HEADER, *(line for *_, line in rows))) + "\n"


def _lines(times: list[str], sensor: str, audit: Audit) -> list[tuple[int, str]]:
    columns = zip(
        audit.instant.tolist(),
        audit.row.tolist(),
        audit.verdict.tolist(),
        audit.landmark.tolist(),
        audit.nis.tolist(),
        audit.threshold.tolist(),
        audit.y.tolist(),
        audit.sigma.tolist(),
        strict=True,
    )
    return [
        (k, f"{times[k]},{sensor},{row},{VERDICTS[v]},{'' if mark < 0 else mark},{_cells(nis, gate, y, sigma)}")
        for k, row, v, mark, nis, gate, y, sigma in columns
    ]


def _cells(nis: float, gate: float, y: list[float], sigma: list[float]) -> str:
    pairs = [value for pair in zip(y, sigma, strict=True) for value in pair]
    return ",".join(_number(v) for v in (nis, gate, *pairs, *[math.nan] * (4 - len(pairs))))


def _number(value: float) -> str:
    return repr(value) if math.isfinite(value) else ""
