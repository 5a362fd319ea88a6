"""One table for every medium: the same rows as Markdown, HTML, LaTeX, CSV, records, and on a terminal."""

import csv
import io
import json
import re
from html.parser import HTMLParser
from typing import Any

import pytest
import small_scene
from commands import locfuse, ok

from locfuse.cli.terminal import show
from locfuse.formats.report import table as render, tables
from locfuse.formats.report.findings import notes_of
from locfuse.formats.report.glossary import GLOSSARY, explained
from locfuse.formats.report.table import Cell, Column, Table, of_values, of_words, records, text, texts
from locfuse.formats.report.tables import COUNTS, MAIN

EVIL = "<b>&|*_`$\\"
LENGTH = Column("length_m", "length", "m", "{:.2f}", brief="len", brief_form="{:.1f}")
SHARE = Column("share", "share", form="{:.1%}", rank=1)
TABLE = Table(
    (Column("name", "name", kind="text"), LENGTH, SHARE),
    (
        (Cell("short"), Cell(1.239, ("runs", "short", "length_m")), Cell(0.5, ("runs", "short", "share"))),
        (Cell("none"), Cell(None, ("runs", "none", "length_m")), Cell(float("nan"))),
    ),
)


class Cells(HTMLParser):
    """The texts of a table's cells by row, and what its numbers say of their source."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.rows: list[list[str]] = []
        self.data: dict[str, float] = {}
        self.feed(page)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        if tag == "tr":
            self.rows.append([])
        if tag in {"th", "td"}:
            self.rows[-1].append("")
        if tag == "data":
            found = dict(attrs)
            self.data[found["data-from"] or ""] = float(found["value"] or "")

    def handle_data(self, data: str) -> None:
        if self.rows and self.rows[-1] and data.strip():
            self.rows[-1][-1] += data


def in_html(table: Table) -> list[list[str]]:
    return Cells(render.html(table)).rows[1:]


def in_markdown(table: Table) -> list[list[str]]:
    lines = render.markdown(table).splitlines()[2:]
    cells = [re.split(r"(?<!\\)\|", line)[1:-1] for line in lines]
    return [[re.sub(r"\\([^\w\s])", r"\1", re.sub(r"\\_", "_", c)).strip() for c in row] for row in cells]


def in_latex(table: Table) -> list[list[str]]:
    lines = render.latex(table).split("\\midrule\n")[1].split("\\bottomrule")[0].splitlines()
    return [line.removesuffix(r" \\").replace(r"\%", "%").split(" & ") for line in lines]


@pytest.fixture(scope="module")
def report() -> dict[str, Any]:
    _, found = small_scene.long(minutes=0.2, configurations=3)
    for i, values in enumerate(found["configurations"].values()):
        values |= {"position_max_m": 0.5 + i, "final_position_error_m": 0.25 * i, "drift_5m": 0.0123}
    return found


@pytest.mark.parametrize("build", [tables.configurations, tables.sensors], ids=["configurations", "sensors"])
def test_every_medium_shows_the_same_rows(report: dict[str, Any], build: Any) -> None:
    table = build(report)
    shown = [[text(c, cell) for c, cell in zip(table.columns, row, strict=True)] for row in table.rows]
    assert len(shown) >= 2
    assert in_markdown(table) == shown
    assert [[cell.replace("–", "-") for cell in row] for row in in_html(table)] == shown
    assert [[cell.replace("--", "-") for cell in row] for row in in_latex(table)] == shown


def test_units_stand_in_the_heading_and_what_does_not_exist_is_the_mediums_dash() -> None:
    assert "| name | length, m | share |" in render.markdown(TABLE)
    assert "name & length [m] & share" in render.latex(TABLE)
    assert '<th scope="col">length,\u00a0m</th>' in render.html(TABLE)
    heads, first, _ = render.terminal_lines(TABLE, None)
    assert heads.split() == ["name", "len,", "m", "share"]
    assert first.split() == ["short", "1.2", "50.0%"]
    assert in_markdown(TABLE)[1] == ["none", "-", "-"]
    assert in_html(TABLE)[1] == ["none", "–", "–"]
    assert in_latex(TABLE)[1] == ["none", "--", "--"]
    assert render.terminal_lines(TABLE, None)[2].split() == ["none", "-", "-"]
    assert render.csv(TABLE).splitlines()[2] == "none,,"
    assert records(TABLE)[1]["length_m"] is None


def test_programs_get_full_precision_and_the_place_of_every_number() -> None:
    assert records(TABLE)[0] == {"name": "short", "length_m": 1.239, "share": 0.5}
    assert render.csv(TABLE).splitlines()[:2] == ["name,length_m,share", "short,1.239,0.5"]
    assert Cells(render.html(TABLE)).data == {"/runs/short/length_m": 1.239, "/runs/short/share": 0.5}


def test_counts_and_ranges_are_numbers_of_their_own() -> None:
    columns = (
        Column("n", "n", kind="text"),
        Column("why", "why", kind="long"),
        Column("range", "range", form="{:.1f}"),
    )
    rows = [({"n": "a", "why": {"out_of_order": 3, "repeat": 1}, "range": [0.25, 4.0]}, ("x", 0))]
    table = of_values(columns, rows)
    assert in_markdown(table) == [["a", "3 out of order, 1 repeat", "0.2 – 4.0"]]
    found = Cells(render.html(table))
    assert found.rows[1] == ["a", "3 out of order, 1 repeat", "0.2 – 4.0"]
    assert found.data == {
        "/x/0/why/out_of_order": 3,
        "/x/0/why/repeat": 1,
        "/x/0/range/0": 0.25,
        "/x/0/range/1": 4.0,
    }


def test_text_from_logs_stays_text_in_every_medium() -> None:
    table = of_words(texts("name", "said", left=2), [(EVIL, EVIL)])
    assert in_html(table) == [[EVIL, EVIL]]
    assert in_markdown(table) == [[EVIL, EVIL]]
    assert r"<b>\&|*\_`\$\textbackslash{}" in render.latex(table)
    assert list(csv.reader(io.StringIO(render.csv(table))))[1] == [EVIL, EVIL]


def test_everything_is_one_flat_record_per_configuration(report: dict[str, Any]) -> None:
    found = records(tables.everything(report))
    assert [row["configuration"] for row in found] == list(report["configurations"])
    for row in found:
        values = report["configurations"][row["configuration"]]
        assert row["position_rmse_m"] == values["position_rmse_m"]
        for sensor, counts in values["sensors"].items():
            assert row[f"{sensor}_accepted"] == counts["accepted"]
        assert not any(isinstance(value, list | dict) for value in row.values())
    json.dumps(found)


@pytest.mark.parametrize("width", [120, 80, 60, 50, 40])
def test_a_narrow_terminal_loses_columns_and_never_digits(report: dict[str, Any], width: int) -> None:
    table = tables.configurations(report)
    lines = render.terminal_lines(table, width)
    assert max(map(len, lines)) <= width
    body = "\n".join(lines)
    assert "…" not in body
    for values in report["configurations"].values():
        assert f" {values['position_rmse_m']:.3f}" in body
    wide = render.terminal_lines(table, None)
    assert "rmse, m " in wide[0]
    assert "drift/5 m" in wide[0]
    assert wide == render.terminal_lines(table, 120)


def test_a_name_repeated_from_the_row_above_can_be_left_out() -> None:
    table = of_words(texts("a", "b"), [("x", "1"), ("x", "2"), ("y", "3")])
    assert [row["a"] for row in records(table.once())] == ["x", "", "y"]


def test_brackets_on_a_terminal_are_text_and_no_markup(capsys: pytest.CaptureFixture[str]) -> None:
    show.table(of_words(texts("setting", "found"), [("wheels.noise [m]", "0.0004")]))
    assert "wheels.noise [m]   0.0004" in capsys.readouterr().out


def test_a_path_that_does_not_agree_with_itself_is_bad_and_not_ranked(report: dict[str, Any]) -> None:
    bad, good, best = (
        {**next(iter(report["configurations"].values())), "revisit_agreement": share, "crispness_cells": cells}
        for share, cells in ((0.2, 100), (0.7, 300), (0.8, 200))
    )
    shown = records(
        tables.configurations({**report, "configurations": {"a": bad, "b": good, "c": best}}, main=False)
    )
    assert [row["crispness"] for row in shown] == ["bad", "x 1.50", "x 1.00"]
    assert [row["revisit_agreement"] for row in shown] == [0.2, 0.7, 0.8]
    unknown = {**bad, "crispness_cells": None}
    (row,) = records(tables.configurations({**report, "configurations": {"a": unknown}}, main=False))
    assert row["revisit_agreement"] == 0.2
    assert "crispness" not in row


def test_the_largest_jumps_are_shown_in_order_of_time(report: dict[str, Any]) -> None:
    events = [
        {"t_s": float(t), "kind": "loop", "dx_m": 0.01 * t, "dy_m": 0.0, "dtheta_deg": 0.0}
        for t in range(2 * tables.MAX_JUMPS)
    ]
    values = next(iter(report["configurations"].values()))
    shown = tables.jumps({**report, "configurations": {"lrf": {**values, "events": events}}})
    late = range(tables.MAX_JUMPS, 2 * tables.MAX_JUMPS)
    assert [row["t_s"] for row in records(shown)] == [float(t) for t in late]
    assert str(len(events)) in shown.label


# --- every word of a table has an explanation that a user can ask for


@pytest.mark.parametrize("heading", [(c.brief or c.heading).split("/")[0].strip() for c in (*MAIN, *COUNTS)])
def test_every_column_of_the_terminals_tables_is_explained(heading: str) -> None:
    done = ok("explain", heading)
    assert done.stdout.strip() == explained(heading)


def test_without_a_term_all_are_listed() -> None:
    assert all(f"{term}: " in locfuse("explain").stdout for term in GLOSSARY)


def test_a_number_of_another_configuration_keeps_its_sign() -> None:
    """-88.5 beside -88.8 is not -88.5 beside 88.8; of a span the second number has no sign."""
    runs = {
        name: {"notes": [f"gps: east lies {east} deg off, at 30-40 s"]}
        for name, east in (("gps", -88.5), ("all", -88.8))
    }
    (note,) = notes_of({"notes": [], "configurations": runs})
    assert note == "gps: east lies -88.5 (all: -88.8) deg off, at 30-40 s"
