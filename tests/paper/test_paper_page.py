"""`locfuse paper`: table, figures and page say what the two comparisons and the four drives gave."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pytest
from commands import locfuse

from locfuse.cli.session import paper
from locfuse.cli.session.paper import Driven
from locfuse.cli.session.session import load
from locfuse.formats.report import paper_page
from locfuse.formats.whole_files import write_results

PATHS = ("rounded_rectangle", "rounded_rectangle_ekf", "rounded_triangle", "rounded_triangle_ekf")


def circle(radius: float) -> np.ndarray:
    angle = np.linspace(0.0, 2.0 * np.pi, 200)
    return np.stack((4.0 + radius * np.cos(angle), 3.0 + radius * np.sin(angle)), axis=-1)


@pytest.fixture(scope="module")
def found() -> paper.Repeated:
    """Both comparisons for real; of the drives, which take a minute, made-up ones 20 cm beside their path."""
    compared = {
        which: load(paper.LOG, preset=p).compare(smooth=False, advice=False) for which, p in paper.PRESETS.items()
    }
    return paper.Repeated(compared, {name: Driven(name, circle(1.7), circle(1.5)) for name in PATHS})


@pytest.fixture(scope="module")
def folder(found: paper.Repeated, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("paper") / "out"
    write_results(out, paper.files(found), overwrite=False)
    return out


def test_every_figure_is_there_as_svg_and_pdf_and_on_the_page(folder: Path) -> None:
    page = (folder / "paper.html").read_text()
    for name in ("fig12", "fig12_print", "fig13", "fig13_print", "fig14a", "fig14b"):
        ET.fromstring((folder / f"{name}.svg").read_bytes())
        assert (folder / f"{name}.pdf").read_bytes().startswith(b"%PDF")
        assert f'<section id="{name}">' in page
    assert "http" not in page.replace("http-equiv", "")


def test_the_table_sets_the_print_beside_our_filter(found: paper.Repeated, folder: Path) -> None:
    rows = {row["configuration"]: row for row in found.rows()}
    assert list(rows) == ["odometry", "compass", "lrf", "camera", "all"]
    for which, comparison in found.compared.items():
        for name, figures in comparison.report["configurations"].items():
            assert rows[name][f"{which}_position_rmse_m"] == figures["position_rmse_m"]
    alone = rows["odometry"]  # a chord (eq. 3) for an arc makes no difference that is seen
    assert alone["print_position_rmse_m"] == pytest.approx(alone["ours_position_rmse_m"], rel=1e-3)
    assert rows["all"]["print_position_rmse_m"] > 5 * rows["all"]["ours_position_rmse_m"]
    shown = re.findall(r'data-from="/table/4/ours_position_rmse_m">([\d.]+)', (folder / "paper.html").read_text())
    assert [float(v) for v in shown] == [pytest.approx(rows["all"]["ours_position_rmse_m"], abs=5e-4)]


def test_the_conclusion_names_the_configuration_with_the_smallest_error(
    found: paper.Repeated, folder: Path
) -> None:
    said = paper_page.conclusion(found.values())
    assert re.search(r"with our filter lrf \(3\.9 mm, all 4\.1 mm\)", said)  # a laser alone is as good
    assert re.search(r"as printed lrf \(52 mm, all 75 mm\)", said)  # the printed camera spoils the rest
    assert said in (folder / "paper.html").read_text()
    row = {"ours_position_rmse_m": 0.2, "print_position_rmse_m": 0.3}
    better = {
        "table": [{"configuration": "lrf", **row}, {"configuration": "all", **{k: v / 2 for k, v in row.items()}}]
    }
    assert "with our filter all (0.10 m) and by the equations as printed all (0.15 m)" in paper_page.conclusion(
        better
    )


def test_the_distance_from_the_path_is_that_to_its_nearest_point(found: paper.Repeated) -> None:
    for row in found.distances():
        assert row["rms"] == pytest.approx(0.2, abs=1e-3)
        assert row["largest"] == pytest.approx(0.2, abs=1e-3)


def test_figure_13_has_y_below_x_on_one_time_axis(folder: Path) -> None:
    text = (folder / "fig13.svg").read_text()
    assert text.index("deviation in x, m") < text.index("deviation in y, m")
    assert text.count(">time, s<") == 1


def test_the_walls_of_figure_14_are_those_of_the_scenario(found: paper.Repeated) -> None:
    a, b = paper.path_panels(found.driven)
    walls = next(m for m in a.marks if m.of == paper.WALLS)
    assert (a.name, b.name) == ("fig14a", "fig14b")
    assert {8.0, 6.0, 0.0} <= set(np.ravel(walls.ends))  # type: ignore[union-attr]


def test_a_folder_that_holds_something_else_is_refused_before_any_work(tmp_path: Path) -> None:
    (tmp_path / "thesis.tex").touch()
    done = locfuse("paper", "-o", tmp_path)
    assert done.exit_code == 1
    assert done.stderr.count("\n") == 1
