"""A session and its results: the commands' files byte for byte, arrays, tables, and what a notebook shows."""

import base64
import csv
import json
import re
import shutil
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from commands import locfuse as command, ok
from hostile import write
from many_logs import LIGHT, THERE_AND_BACK, write_logs

import locfuse
from locfuse.cli.analysis import load
from locfuse.cli.session.python_words import in_python, in_tools
from locfuse.fusion.camera import detect
from locfuse.fusion.fuse import BLOCK_INSTANTS
from locfuse.fusion.lines.scans import lines_in_base
from locfuse.fusion.progress import reporting_to
from locfuse.fusion.sensors import lrf
from locfuse.fusion.wheels.read import read_wheels

LOG = "rounded_rectangle"
WORDS = ("odometry", "lrf", "compass,lrf@2Hz")
TO = 20.0  # s: enough of the drive for everything to happen


def contents(folder: Path) -> dict[str, bytes]:
    return {p.name: p.read_bytes() for p in folder.iterdir()}


@pytest.fixture(scope="module")
def session() -> locfuse.Session:
    return locfuse.load(LOG, between=(None, TO))


@pytest.fixture(scope="module")
def compared(session: locfuse.Session) -> locfuse.Comparison:
    return session.compare(WORDS, smooth=True)


@pytest.fixture(scope="module")
def by_command(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("command") / "out"
    words = [w for sensors in WORDS for w in ("--sensors", sensors)]
    ok("compare", LOG, "--to", TO, *words, "--smooth", "--write", "all", "--export", "kitti,mcap", "-o", out)
    return out


def test_other_settings_decode_no_picture_again(session: locfuse.Session, monkeypatch: pytest.MonkeyPatch) -> None:
    looked: list[Any] = []

    def none(stream: Any, by: Any) -> list[Any]:
        looked.append(stream)
        return []

    monkeypatch.setattr(detect, "detections", none)
    later = session.with_settings({"camera.time_offset": 0.05})
    before, now = session.drive.measurements["camera"], later.drive.measurements["camera"]
    assert now.t[0] == pytest.approx(before.t[0] + 0.05)
    np.testing.assert_array_equal(now.z[:50], before.z[:50])
    assert not looked
    session.with_settings({"camera.red_ratio": 0.6})
    assert len(looked) == 1


@pytest.mark.parametrize(
    ("changes", "again"),
    [
        ({"lrf.gate": 0.999, "compass.outliers": "inflate"}, ()),
        ({"lrf.sigma_x": 0.05, "lrf.recover": False, "wheels.estimate": True}, ()),
        ({"compass.time_offset": 0.02, "start.x": 0.1}, ()),
        ({"lrf.sigma_range": 0.05}, ("lines",)),
        ({"wheels.noise": 1e-3}, ("lines",)),  # a deskewed scan is as uncertain as the wheels
        ({"wheels.track": 0.61}, ("wheels", "lines")),
    ],
)
def test_other_settings_measure_again_what_depends_on_them_and_are_those_of_a_new_load(
    session: locfuse.Session, monkeypatch: pytest.MonkeyPatch, changes: dict[str, Any], again: tuple[str, ...]
) -> None:
    looked: list[str] = []

    def noted(name: str, work: Any) -> Any:
        def done(*args: Any) -> Any:
            looked.append(name)
            return work(*args)

        return done

    monkeypatch.setattr(load, "read_wheels", noted("wheels", read_wheels))
    monkeypatch.setattr(lrf, "lines_in_base", noted("lines", lines_in_base))
    later = session.with_settings(changes)
    assert set(looked) == set(again)
    fresh = locfuse.load(LOG, sets=changes, between=(None, TO))
    for one in ("odometry", "compass+lrf"):
        a, b = (s.run(one.replace("+", ","), smooth=False, advice=False).estimates[one] for s in (later, fresh))
        assert (a.pose.tobytes(), a.triangles.tobytes()) == (b.pose.tobytes(), b.triangles.tobytes())


def test_a_comparison_writes_the_commands_files_byte_for_byte(
    compared: locfuse.Comparison, by_command: Path, tmp_path: Path
) -> None:
    written = compared.write(tmp_path / "out", write="all", export=["kitti", "mcap"])
    assert contents(tmp_path / "out") == contents(by_command)
    assert {p.name for p in written} == {p.name for p in by_command.iterdir()}


def test_without_audits_the_files_are_the_same(session: locfuse.Session, by_command: Path, tmp_path: Path) -> None:
    lean = session.compare(WORDS, smooth=True, audits=False)
    assert not any(e.audits for e in lean.estimates.values())
    lean.write(tmp_path / "out", write="html,json")
    for name in ("report.html", "report.json"):
        assert (tmp_path / "out" / name).read_bytes() == (by_command / name).read_bytes()


def test_a_run_writes_the_commands_files_byte_for_byte(session: locfuse.Session, tmp_path: Path) -> None:
    files = ("--audit", tmp_path / "a.csv", "--save-map", tmp_path / "a.json", "-o", tmp_path / "a")
    ok("run", LOG, "--to", TO, "--sensors", "compass,lrf", "--smooth", "--no-advice", *files)
    run = session.run(["compass", "lrf"], smooth=True, advice=False)
    run.write(tmp_path / "b")
    run.write_audit(tmp_path / "b.csv")
    run.save_map(tmp_path / "b.json")
    assert contents(tmp_path / "a") == contents(tmp_path / "b")
    for kind in ("csv", "json"):
        assert (tmp_path / f"a.{kind}").read_bytes() == (tmp_path / f"b.{kind}").read_bytes()


def test_settings_are_those_of_the_command(tmp_path: Path) -> None:
    (tmp_path / "robot.toml").write_text("[compass]\nsigma_deg = 7.0\n[lrf]\nsigma_range = 0.05\n")
    how = ("--robot", tmp_path / "robot.toml", "--set", "lrf.topic=/scan", "--set", "lrf.sigma_range=0.04")
    ok("run", LOG, "--to", 2, "--sensors", "odometry", *how, "--order", "stamp", "-o", tmp_path / "a")
    sets = {"lrf": {"topic": "/scan"}, "lrf.sigma_range": np.float64(0.04)}
    session = locfuse.load(LOG, robot=str(tmp_path / "robot.toml"), sets=sets, order="stamp", between=(None, 2.0))
    session.run("odometry").write(tmp_path / "b")
    assert contents(tmp_path / "a") == contents(tmp_path / "b")


@pytest.mark.parametrize(
    ("value", "text"),
    [
        ("/scan", '"/scan"'),
        ("5", '"5"'),
        (True, "true"),
        (3, "3"),
        (0.5, "0.5"),
        (np.array([1.0, 2.0]), "[1.0,2.0,]"),
    ],
)
def test_a_set_keeps_the_type_of_its_value(value: Any, text: str) -> None:
    from locfuse.cli.analysis.settings import set_words
    from locfuse.formats.robot.robot_toml import apply_sets

    assert set_words({"table.key": value}) == (f"table.key={text}",)
    back = apply_sets(set_words({"table.key": value}))["table"]["key"]
    assert type(back) is (list if isinstance(value, np.ndarray) else type(value))
    assert np.array_equal(back, value)


def test_a_result_has_the_shapes_of_the_page_and_says_what_it_is_of(compared: locfuse.Comparison) -> None:
    e = compared.estimates["lrf"]
    assert e.pose.shape == (len(e.t), 3)
    assert e.P.shape == (len(e.t), 3, 3)
    np.testing.assert_array_equal(e.t, compared.drive.t)
    assert len(e.audits["lrf"].nis) > 1000
    e = compared.estimates["compass+lrf@2Hz-smoothed"]
    assert (e.configuration, e.smoothed, e.sensors, e.rates) == (
        "compass+lrf@2Hz",
        True,
        ("compass", "lrf"),
        {"lrf": 2.0},
    )
    row = compared.report["configurations"][e.name]
    assert (row["configuration"], row["smoothed"], row["rates_hz"]) == ("compass+lrf@2Hz", True, {"lrf": 2.0})
    assert compared.report["schema_version"] == 1
    assert compared.evaluations[e.name].name == e.name


def test_the_table_is_that_of_the_csv_and_what_is_printed_one_short_line(
    compared: locfuse.Comparison, by_command: Path, session: locfuse.Session
) -> None:
    with (by_command / "report.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    table = compared.table()
    assert [list(row) for row in table] == [list(row) for row in rows]
    for row, text in zip(table, rows, strict=True):
        assert {k: "" if v is None else str(v) for k, v in row.items()} == text
    for thing in (session, compared, compared.estimates, session.run("odometry", advice=False)):
        assert "\n" not in repr(thing)
        assert len(repr(thing)) < 200
    assert "truth /ground_truth/pose" in repr(session)
    assert "no truth" in repr(locfuse.load(LOG, between=(None, TO), sets={"truth.topic": "none"}))


def test_a_notebook_shows_verdicts_table_and_paths_without_markup_of_a_log(
    compared: locfuse.Comparison, session: locfuse.Session
) -> None:
    page = compared._repr_html_()
    words = re.split("<[^>]*>", page)
    assert f"lrf {compared.verdicts['lrf']['verdict']}." in words
    assert f"{1000.0 * compared.report['configurations']['lrf']['position_rmse_m']:.1f}" in words
    assert page.count("<tr") == 1 + len(compared.estimates)
    from locfuse.formats.report import html

    evil = "<script>alert(1)</script>"
    report = {**compared.report, "verdicts": {"lrf": {"verdict": "helps", "words": evil}}}
    assert "<script" not in html.notebook_report(report)
    run = session.run("compass", advice=False)
    shown = run._repr_html_()
    assert "<table" in shown
    (picture,) = re.findall(r'src="data:image/svg\+xml;base64,([^"]+)"', shown)
    assert b"<title>compass</title>" in base64.b64decode(picture)
    run.report["headline"] = "<b>0</b>"
    assert "<b>0</b>" not in run._repr_html_()


def test_step_by_step_gives_a_session_s_numbers(session: locfuse.Session, compared: locfuse.Comparison) -> None:
    for sensors, name in (("lrf", "lrf"), (["compass", "lrf@2Hz"], "compass+lrf@2Hz")):
        filtered = locfuse.fuse(session.drive, session.robot, sensors)
        np.testing.assert_array_equal(filtered.pose, compared.estimates[name].pose)
        figures = locfuse.evaluate(filtered, session.drive).figures
        assert figures == compared.evaluations[name].figures
    smoothed = locfuse.smooth(session.drive, session.robot, "lrf")
    np.testing.assert_array_equal(smoothed.pose, compared.estimates["lrf-smoothed"].pose)


def test_the_papers_filter_is_fused_where_the_session_asks_for_it() -> None:
    session = locfuse.load(LOG, preset="paper", between=(None, TO))
    run = session.run("compass", advice=False)
    direct = locfuse.fuse(session.drive, session.robot, "compass")
    np.testing.assert_array_equal(direct.pose, run.filtered.pose)
    ours = locfuse.load(LOG, between=(None, TO)).run("compass", advice=False).filtered
    assert np.abs(direct.pose - ours.pose).max() > 1e-3


def test_a_map_of_one_run_is_localised_in_by_another_and_the_session_stays_as_it_was(
    session: locfuse.Session, tmp_path: Path
) -> None:
    session.run("lrf", advice=False).save_map(tmp_path / "room.json")
    again = session.with_map(tmp_path / "room.json")
    assert len(again.robot.lines) > 3
    assert not session.robot.lines
    assert again.run("lrf", advice=False).report["settings"]["lrf"]["map"] == "given"


def test_a_log_opens_without_being_measured_and_progress_names_the_steps() -> None:
    log = locfuse.open_log(LOG)
    assert log.topics["/scan"].count == 548
    assert len(log.stream("/scan").columns("range_max")["range_max"]) == 548
    steps: list[str] = []
    locfuse.load(LOG, progress=steps.append).run("odometry", advice=False)
    assert steps[:4] == ["opening", "reading", "measuring the wheels", "measuring compass"]
    assert "fusing" in steps


def test_reading_and_fusing_say_which_share_of_the_log_is_done() -> None:
    heard: dict[str, list[float | None]] = {}
    doing: list[str] = []

    def begin(step: str) -> None:
        doing.append(step)
        heard[step] = []

    def listener(share: float | None) -> None:
        heard[doing[-1]].append(share)

    with reporting_to(listener):
        session = locfuse.load(LOG, progress=begin)
        session.run("all", advice=False)
    for step in ("reading", "measuring camera", "fusing"):
        assert heard[step][-1] is None, "the loop has ended: what comes next is unknown"
        shares = [share for share in heard[step][: heard[step].index(None)] if share is not None]
        assert min(np.diff(shares)) > -0.05, "a chunk's topics come one after the other"
        assert 0.0 <= shares[0] < 0.2
        assert 0.8 < shares[-1] <= 1.0
    fused = [share for share in heard["fusing"] if share is not None]
    assert len(session.drive.t) / BLOCK_INSTANTS > 6.0
    assert max(np.diff([*fused, 1.0])) < 0.25, "the core goes on for several blocks, but not for long"


def test_losses_are_those_of_the_command(tmp_path: Path) -> None:
    path = locfuse.open_log(LOG).paths[0]
    assert isinstance(path, Path)
    data = path.read_bytes()
    (tmp_path / "cut.mcap").write_bytes(data[: len(data) // 2])
    sets = {"wheels.radius": 0.05, "wheels.track": 0.6}
    words = [w for k, v in sets.items() for w in ("--set", f"{k}={v}")]
    done = command(
        "run", tmp_path / "cut.mcap", "--sensors", "odometry", *words, "--no-advice", "-o", tmp_path / "out"
    )
    assert done.exit_code == 3, done.stderr
    run = locfuse.load(tmp_path / "cut.mcap", sets=sets).run("odometry", advice=False)
    assert [f"lost: {line}" for line in run.losses()] == [x for x in done.stderr.splitlines() if "lost:" in x]
    assert not locfuse.load(LOG).run("odometry", advice=False).losses(strict=True)


def test_a_simulated_drive_is_the_commands_log_and_a_temporary_one_goes_with_its_session(tmp_path: Path) -> None:
    sets = {"camera.enabled": False, "lrf.enabled": False, "path.legs": [{"forward": 0.5}]}
    words = ("--set", "camera.enabled=false", "--set", "lrf.enabled=false", "--set", "path.legs=[{forward=0.5}]")
    ok("simulate", "straight_runs", "-o", tmp_path / "a.mcap", "--seed", 3, *words)
    kept = locfuse.simulate("straight_runs", tmp_path / "b.mcap", seed=3, sets=sets)
    assert (tmp_path / "a.mcap").read_bytes() == (tmp_path / "b.mcap").read_bytes()
    temporary = locfuse.simulate("straight_runs", seed=3, sets=sets)
    assert temporary.log.sha256 == kept.log.sha256
    (path,) = temporary.log.paths
    del temporary
    assert isinstance(path, Path)
    assert not path.parent.exists()
    with pytest.raises(locfuse.LocfuseError, match="exists"):
        locfuse.simulate("straight_runs", tmp_path / "b.mcap", sets=sets)


# --- the rest of the command line in Python: the same values and files, words of Python


@pytest.fixture(scope="module")
def three(session: locfuse.Session) -> locfuse.Comparison:
    return session.compare(["odometry", "compass", "lrf"])


def test_info_gives_what_the_command_prints_also_where_nothing_runs_yet(drives: list[Path]) -> None:
    for words, sets in (((), {}), (("--set", "wheels.radius=-1"), {"wheels.radius": -1})):
        assert locfuse.info(drives[0], sets=sets) == json.loads(ok("info", drives[0], "--json", *words).stdout)
    assert locfuse.load(drives[0]).info() == locfuse.info(drives[0])


def test_tuning_gives_the_commands_values_and_its_file(tmp_path: Path) -> None:
    log, sets = write(tmp_path / "drive.mcap", seconds=5.0), ("--set", "compass.sigma_deg=9")
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


def test_a_result_says_what_its_report_says_and_columns_are_data_frames(three: locfuse.Comparison) -> None:
    assert three.headline == three.report["headline"]
    assert three.findings == three.report["findings"]
    assert locfuse.Summary({"a": three}).headline
    pandas = pytest.importorskip("pandas")
    frame = pandas.DataFrame(three.audit("lrf", "lrf"))
    assert frame[frame["verdict"] == "accepted"]["nis"].notna().all()
    assert len(pandas.DataFrame(three.errors("lrf"))) > 100


def test_errors_and_audits_are_columns_as_the_report_counts(three: locfuse.Comparison) -> None:
    errors = three.errors("lrf")
    assert list(errors) == ["t", "dx", "dy", "heading", "nees"]
    assert len({len(column) for column in errors.values()}) == 1
    rmse = np.sqrt(np.mean(errors["dx"] ** 2 + errors["dy"] ** 2))
    assert rmse == pytest.approx(three.evaluations["lrf"].figures["position_rmse_m"])
    with pytest.raises(locfuse.LocfuseError, match="did you mean lrf"):
        three.errors("lrg")
    audit = three.audit("lrf", "lrf")
    names, counts = np.unique(audit["verdict"], return_counts=True)
    reported = three.report["configurations"]["lrf"]["sensors"]["lrf"]["verdicts"]
    assert dict(zip(names.tolist(), counts.tolist(), strict=True)) == {k: v for k, v in reported.items() if v}
    assert {"innovation_r", "sigma_r", "innovation_psi", "sigma_psi"} < set(audit)
    assert np.all(np.diff(audit["t"]) >= 0.0)


def test_plot_draws_every_path_on_the_axes_given(three: locfuse.Comparison) -> None:
    from matplotlib.figure import Figure

    axes = Figure().add_subplot()
    assert three.plot(axes) is axes
    names = axes.get_legend_handles_labels()[1]
    assert {"odometry", "compass", "lrf", "truth"} <= set(names)
    ends = {tuple(np.round((line.get_xdata()[-1], line.get_ydata()[-1]), 1)) for line in axes.lines}
    assert tuple(np.round(three.estimates["odometry"].pose[-1, :2], 1)) in ends


def test_plot_without_matplotlib_is_the_figure(three: locfuse.Comparison, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("matplotlib", "matplotlib.pyplot"):
        monkeypatch.setitem(sys.modules, name, None)
    svg = three.plot()._repr_svg_()
    assert svg.startswith('<svg xmlns="http://www.w3.org/2000/svg"')
    assert svg.count("<svg") == svg.count("</svg>") == svg.count("<style>") == 1


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
)
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


@pytest.fixture(scope="module")
def drives(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    return write_logs(tmp_path_factory.mktemp("drives"), ("monday", "tuesday"), (*LIGHT, THERE_AND_BACK))


def tree(folder: Path) -> dict[str, bytes]:
    return {str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


@pytest.mark.usefixtures("jobs_in_this_process")
def test_a_summary_writes_the_files_byte_for_byte(drives: list[Path], tmp_path: Path) -> None:
    for name, sensors, kinds in (("a", None, None), ("b", "odometry", "md,tum")):
        words = ("--sensors", sensors, "--write", kinds) if kinds else ()
        ok("compare", *drives, "-o", tmp_path / name, *words)
        written = locfuse.compare(*drives, sensors=sensors).write(tmp_path / f"{name} too", write=kinds)
        assert tree(tmp_path / name) == tree(tmp_path / f"{name} too")
        assert {p.name for p in written} == {p.name for p in (tmp_path / name).iterdir() if p.is_file()}


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
