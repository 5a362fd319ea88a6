"""The rest of the command line in Python: the same values and files, columns for data frames, words of Python."""

from __future__ import annotations

import base64
import json
import re
import shutil
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from commands import locfuse as command
from commands import ok
from hostile import write

import locfuse
from locfuse.cli.session.python_words import in_python, in_tools

LOG = "rounded_rectangle"
TO = 20.0  # s


@pytest.fixture(scope="module")
def session() -> locfuse.Session:
    return locfuse.load(LOG, between=(None, TO))


@pytest.fixture(scope="module")
def compared(session: locfuse.Session) -> locfuse.Comparison:
    return session.compare(["odometry", "compass", "lrf"])


def test_info_gives_what_the_command_prints_also_where_nothing_runs_yet() -> None:
    sets = ("--set", "wheels.radius=-1")
    for words, settings in (((), None), (sets, {"wheels.radius": -1})):
        done = command("info", LOG, "--json", *words)
        if done.exit_code in {0, 3}:
            assert locfuse.info(LOG, sets=settings) == json.loads(done.stdout)
        else:
            with pytest.raises(locfuse.LocfuseError):
                locfuse.info(LOG, sets=settings)
    assert locfuse.load(LOG).info() == locfuse.info(LOG)


def test_tuning_gives_the_commands_values_and_its_file(tmp_path: Path) -> None:
    log, sets = write(tmp_path / "drive.mcap", seconds=10.0), ("--set", "compass.sigma_deg=9")
    done = ok("tune", log, "--sensors", "compass", *sets, "--json", "-o", tmp_path / "a.toml")
    found = locfuse.load(log).with_settings({"compass.sigma_deg": 9}).tune(sensors="compass")
    assert json.loads(done.stdout) == json.loads(json.dumps(found.values()))
    assert found.write(tmp_path / "b.toml").read_text() == (tmp_path / "a.toml").read_text()
    assert "compass.sigma_deg=" in repr(found)
    with pytest.raises(locfuse.LocfuseError, match="overwrite=True"):
        found.write(tmp_path / "b.toml")


def test_calibrating_gives_the_commands_values_and_its_file(tmp_path: Path) -> None:
    done = ok("calibrate", LOG, "rounded_triangle", "--json", "-o", tmp_path / "a.toml")
    found = locfuse.load(LOG).calibrate("rounded_triangle")
    assert json.loads(done.stdout) == json.loads(json.dumps(found.values()))
    assert found.write(tmp_path / "b.toml").read_text() == (tmp_path / "a.toml").read_text()
    assert found._repr_html_().count("<tr>") == 1 + len(found.rows())


def test_a_result_says_what_its_report_says_and_columns_are_data_frames(compared: locfuse.Comparison) -> None:
    assert compared.headline == compared.report["headline"]
    assert compared.findings == compared.report["findings"]
    assert locfuse.Summary({"a": compared}).headline
    pandas = pytest.importorskip("pandas")
    frame = pandas.DataFrame(compared.audit("lrf", "lrf"))
    assert frame[frame["verdict"] == "accepted"]["nis"].notna().all()
    assert len(pandas.DataFrame(compared.errors("lrf"))) > 100


def test_errors_are_columns_by_the_truths_stamps(compared: locfuse.Comparison) -> None:
    errors = compared.errors("lrf")
    assert list(errors) == ["t", "dx", "dy", "heading", "nees"]
    assert len({len(column) for column in errors.values()}) == 1
    rmse = np.sqrt(np.mean(errors["dx"] ** 2 + errors["dy"] ** 2))
    assert rmse == pytest.approx(compared.evaluations["lrf"].figures["position_rmse_m"])
    with pytest.raises(locfuse.LocfuseError, match="did you mean lrf"):
        compared.errors("lrg")


def test_an_audit_has_verdicts_by_name_as_many_as_the_report_counts(compared: locfuse.Comparison) -> None:
    audit = compared.audit("lrf", "lrf")
    names, counts = np.unique(audit["verdict"], return_counts=True)
    reported = compared.report["configurations"]["lrf"]["sensors"]["lrf"]["verdicts"]
    assert dict(zip(names.tolist(), counts.tolist(), strict=True)) == {k: v for k, v in reported.items() if v}
    assert {"innovation_r", "sigma_r", "innovation_psi", "sigma_psi"} < set(audit)
    assert np.all(np.diff(audit["t"]) >= 0.0)


def test_plot_draws_every_path_on_the_axes_given(compared: locfuse.Comparison) -> None:
    from matplotlib.figure import Figure

    axes = Figure().add_subplot()
    assert compared.plot(axes) is axes
    names = axes.get_legend_handles_labels()[1]
    assert {"odometry", "compass", "lrf", "truth"} <= set(names)
    ends = {tuple(np.round((line.get_xdata()[-1], line.get_ydata()[-1]), 1)) for line in axes.lines}
    assert tuple(np.round(compared.estimates["odometry"].pose[-1, :2], 1)) in ends


def test_plot_without_matplotlib_is_the_reports_figure(
    compared: locfuse.Comparison, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("matplotlib", "matplotlib.pyplot"):
        monkeypatch.setitem(sys.modules, name, None)
    svg = compared.plot()._repr_svg_()
    assert svg.startswith('<svg xmlns="http://www.w3.org/2000/svg"')
    assert svg.count("<svg") == svg.count("</svg>") == svg.count("<style>") == 1


def test_a_notebook_shows_headline_findings_and_the_paths_of_a_run_too(session: locfuse.Session) -> None:
    run = session.run("compass", advice=False)
    shown = run._repr_html_()
    assert "<table" in shown
    (picture,) = re.findall(r'src="data:image/svg\+xml;base64,([^"]+)"', shown)
    assert b"<title>compass</title>" in base64.b64decode(picture)
    run.report["headline"] = "<b>0</b>"
    assert "<b>0</b>" not in run._repr_html_()


@pytest.mark.parametrize(
    ("typed", "spoken"),
    [
        ("--set wheels.track=1 --set 'lrf.topic=/a b'", 'sets={"wheels.track": 1, "lrf.topic": "/a b"}'),
        ("--set beacon.place=[X,Y]", 'sets={"beacon.place": [X,Y]}'),
        ("give one with --set wheels.radius=", 'give one with sets={"wheels.radius": ...}'),
        ("--set wheels.track=<metres> helps", 'sets={"wheels.track": <metres>} helps'),
        ("--align origin judges", 'align="origin" judges'),
        ("--reference: this log has a truth", "reference: this log has a truth"),
        ("--no-reference or --smooth", "reference=False or smooth=True"),
        ("--from 3 --to 9: the drive ends", "between=(3, 9): the drive ends"),
        ("see: locfuse info a.mcap", 'see: locfuse.info("a.mcap")'),
        (
            "see: locfuse info a.mcap --robot r.toml --set wheels.track=1 --check",
            'see: locfuse.load("a.mcap", robot="r.toml", sets={"wheels.track": 1}).findings()',
        ),
        ("2 -- 3 of log--7.mcap", "2 -- 3 of log--7.mcap"),
    ],
)  # fmt: skip
def test_options_become_keywords(typed: str, spoken: str) -> None:
    assert in_python(typed) == spoken
    assert in_python(spoken) == spoken


@pytest.mark.parametrize(
    ("typed", "spoken"),
    [
        ("--set lrf.walls=flat --set a.b=true", 'settings={"lrf.walls": "flat", "a.b": true}'),
        ("see: locfuse info a.mcap --set a.b=1 --check", 'see: info("a.mcap", settings={"a.b": 1}, check=true)'),
        ("see: locfuse calibrate a.mcap --set a.b=1", 'see: calibrate(["a.mcap"], settings={"a.b": 1})'),
        ("see: locfuse compare a.mcap", 'see: compare("a.mcap")'),
        ("judge the shape with --align origin", 'judge the shape with align="origin"'),
    ],
)
def test_options_become_arguments_of_tools(typed: str, spoken: str) -> None:
    assert in_tools(typed) == spoken


def test_errors_speak_python_and_the_command_its_own_words(session: locfuse.Session, tmp_path: Path) -> None:
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "mine.txt").write_text("mine")
    wrong: dict[str, Callable[[], Any]] = {
        "sets": lambda: session.with_settings({"lrf.topic": "/x"}),
        "jitter=-1": lambda: session.compare(jitter=-1),
        "reference": lambda: session.compare(reference=True),
        "sensors": lambda: session.run("bacon"),
        "estimates": lambda: session.compare(estimates={"amcl": "/nowhere"}),
        "write": lambda: session.run("odometry").write(tmp_path / "new", write="pdf"),
        "overwrite=True": lambda: session.run("odometry").write(tmp_path / "out"),
        'sets={"wheels.track"': lambda: locfuse.load(LOG, sets=["wheels.track"]),
    }
    for word, call in wrong.items():
        with pytest.raises(locfuse.LocfuseError) as problem:
            call()
        assert word in str(problem.value), problem.value
        assert "--" not in str(problem.value)
    done = command("run", LOG, "--sensors", "odometry", "-o", tmp_path / "out")
    assert "--overwrite" in done.stderr


# --- several logs in Python and on the command line: the same files, one log at a time


LIGHT = {
    "camera.enabled": False,
    "lrf.enabled": False,
    "path.legs": [{"forward": 1.5}, {"turn_deg": 180}, {"forward": 1.5}],
}


@pytest.fixture(scope="module")
def drives(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    folder = tmp_path_factory.mktemp("drives")
    for seed, name in enumerate(("monday", "tuesday")):
        locfuse.simulate("straight_runs", folder / f"{name}.mcap", seed=seed, sets=LIGHT)
    return [folder / "monday.mcap", folder / "tuesday.mcap"]


def tree(folder: Path) -> dict[str, bytes]:
    return {str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


@pytest.mark.parametrize("write", [None, "md,tum"])
def test_a_summary_writes_the_commands_files_byte_for_byte(
    drives: list[Path], tmp_path: Path, write: str | None
) -> None:
    words = ("--write", write) if write else ()
    ok("compare", *drives, "-o", tmp_path / "a", *words)
    written = locfuse.compare(*drives).write(tmp_path / "b", write=write)
    assert tree(tmp_path / "a") == tree(tmp_path / "b")
    assert {p.name for p in written} == {p.name for p in (tmp_path / "a").iterdir() if p.is_file()}


def test_a_summary_holds_every_logs_comparison_and_table(drives: list[Path]) -> None:
    summary = locfuse.compare(*drives, sensors=["odometry", "compass"])
    assert list(summary.results) == ["monday", "tuesday"]
    rows = summary.table()
    assert [(r["log"], r["configuration"]) for r in rows] == [
        (log, name) for log in ("monday", "tuesday") for name in ("odometry", "compass")
    ]
    alone = locfuse.compare(drives[1], sensors=["odometry", "compass"], smooth=False)
    one = summary.results["tuesday"].report
    same = {"findings": alone.report["findings"], "fixes": alone.report["fixes"]}
    assert {**one, **same} == {**alone.report, "measured": one["measured"]}
    assert one["findings"] is None  # several logs are compared, a single one is evaluated
    mean = sum(r["position_rmse_m"] for r in rows if r["configuration"] == "compass") / 2
    assert summary.report["configurations"]["compass"]["figures"]["position_rmse_m"]["mean"] == pytest.approx(mean)
    assert f"{mean:.4f}" in summary._repr_html_()
    assert repr(summary).startswith("<Summary of monday, tuesday: Best is ")


def test_a_list_is_one_log_and_the_same_log_twice_is_one(drives: list[Path], tmp_path: Path) -> None:
    assert list(locfuse.compare(drives[0], drives[0], sensors="odometry").results) == ["monday"]
    twin = tmp_path / "monday.mcap"
    shutil.copy(drives[0], twin)
    both = locfuse.compare([drives[0]], [twin], sensors="odometry")
    assert list(both.results) == ["monday", "monday_2"]
