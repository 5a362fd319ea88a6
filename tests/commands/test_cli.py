"""The command line as a user meets it: results, one clear line for bad input, the same bytes twice."""

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from commands import Done, locfuse, ok, refused, report_in, reported
from mcap.writer import Writer
from rewrite_log import rewritten

from locfuse.cli.analysis.gates import Gates
from locfuse.cli.analysis.settings import GateOptions
from locfuse.formats.report.changes import changes, remarks

LOG = "rounded_rectangle"


@pytest.fixture(scope="module")
def compared(plain: tuple[Done, Path]) -> Path:
    return plain[1]


def test_compare_says_what_each_sensor_bought(compared: Path) -> None:
    report = report_in(compared)
    rmse = {name: c["position_rmse_m"] for name, c in report["configurations"].items()}
    assert {"odometry", "compass", "lrf", "all"} <= set(rmse)
    assert rmse["all"] < 0.2 * rmse["odometry"]
    for name in rmse:
        assert (compared / f"{name}.tum").is_file()
    figures = "position_rmse_m position_max_m final_position_error_m heading_rmse_deg anees duration_s"
    assert None not in [report["configurations"]["all"][key] for key in figures.split()]
    assert {"accepted", "rejected", "absent", "nis"} <= set(report["configurations"]["all"]["sensors"]["lrf"])
    assert len(report["input"]["sha256"]) == 64


@pytest.mark.parametrize("sensors", ["odometry", "compass", "lrf", "all"])
def test_run_equals_compares_configuration(compared: Path, tmp_path: Path, sensors: str) -> None:
    words = ("--sensors", sensors, "--no-advice", "--no-smooth", "--write", "tum,csv,json")
    ok("run", LOG, *words, "-o", tmp_path / "out")
    a, b = np.loadtxt(tmp_path / "out" / "trajectory.tum"), np.loadtxt(compared / f"{sensors}.tum")
    np.testing.assert_allclose(a, b, atol=1e-9)
    one, other = (report_in(out)["configurations"][sensors] for out in (tmp_path / "out", compared))
    assert one["position_rmse_m"] == pytest.approx(other["position_rmse_m"], abs=1e-9)
    header = (tmp_path / "out" / "trajectory.csv").read_text().split("\n", 1)[0]
    assert header == "t,x,y,theta,P_xx,P_xy,P_xt,P_yy,P_yt,P_tt"


def test_messages_at_other_positions_in_the_file_give_identical_numbers(compared: Path, tmp_path: Path) -> None:
    log = rewritten(tmp_path / "shuffled.mcap", seed=3)
    ok("compare", log, "--no-advice", "--write", "json,tum", "-o", tmp_path / "out")
    assert report_in(tmp_path / "out")["configurations"] == report_in(compared)["configurations"]
    for name in ("odometry.tum", "all.tum", "truth.tum"):
        assert (tmp_path / "out" / name).read_bytes() == (compared / name).read_bytes()


def test_without_truth_the_other_rows_are_the_same_bytes(compared: Path, tmp_path: Path) -> None:
    topic = report_in(compared)["truth"]["topic"]
    log = rewritten(tmp_path / "untrue.mcap", seed=None, without=topic)
    how = ("--no-advice", "--no-reference", "--no-smooth", "--write", "json,tum")
    done = ok("compare", log, *how, "-v", "-o", tmp_path / "out")
    assert "--set truth.topic=" in done.stderr
    ranking = report_in(tmp_path / "out")["prediction"]["ranking"]
    scores = {r["configuration"]: r["gain_nats"] for r in ranking if r["gain_nats"] is not None}
    printed = dict(re.findall(r"^(\w+) .*? ([+-][\d.]+)\b", done.stdout, re.MULTILINE))
    assert {name: float(text) for name, text in printed.items()} == pytest.approx(scores, abs=0.005)
    assert "This finds a sensor that contradicts" in done.stderr
    with_truth = set((compared / "all.tum").read_text().splitlines())
    without = (tmp_path / "out" / "all.tum").read_text().splitlines()
    assert len(without) > 500
    assert set(without) <= with_truth
    assert report_in(tmp_path / "out")["configurations"]["all"]["position_rmse_m"] is None


BAD = [
    (("run", "nosuch.mcap"), 2, "no such log"),
    (("run", "{text}"), 1, "not an MCAP file"),
    (("run", "{empty}"), 1, "empty"),
    (("run", "{nothing}"), 1, "nothing"),
    (("run", LOG, "--sensors", "lrg"), 2, "unknown sensor 'lrg'"),
    (("run", LOG, "--sensors", "sonar,lrf"), (1, 2), "sonar"),
    (("run", LOG, "--set", "lrf.topic=/nowhere"), 1, "has no topic /nowhere"),
    (("run", LOG, "--set", "lrf.topic=/joint_states"), 1, "accepted: sensor_msgs/LaserScan"),
    (("run", LOG, "--set", "wheels.trak=0.5"), 2, "did you mean track"),
    (("run", LOG, "--set", "whels.track=0.5"), 2, "did you mean wheels"),
    (("run", LOG, "--set", "wheels.track=wide"), 2, "wheels.track"),
    (("run", LOG, "--set", "wheels.track=-1"), 1, "must both be at least 1e-06 m"),
    (("run", LOG, "--set", "compass.sigma_deg=0"), 2, "locfuse: compass: sigma_deg = 0.0: no sensor is exact"),
    (("run", LOG, "--set", "lrf.sigma_range=0"), 2, "locfuse: lrf: sigma_range = 0.0"),
    (("run", LOG, "--set", "camera.sigma_deg=0"), 2, "locfuse: camera: sigma_deg = 0.0"),
    (("run", LOG, "--set", "wheels.left=arm_joint"), 1, "no joint 'arm_joint'"),
    (("run", LOG, "--robot", "{typo}"), 1, "did you mean track"),
    (("run", LOG, "--robot", "{broken}"), 1, "broken.toml"),
    (("run", LOG, "--write", "pdf"), 2, "unknown output 'pdf'"),
    (("run", "{wheelless}"), 1, "has no topic /joint_states"),
    (("run", LOG, "--set", "wheels.radius=big"), 2, "must be a number, in metres"),
    (("run", LOG, "--set", "compass.sigma_deg=true"), 2, "must be a number, in degrees"),
    (("run", LOG, "--set", "wheels.time_offset=[1]"), 2, "must be a number, in seconds"),
    (("run", LOG, "--set", "lrf.min_points=2.5"), 2, "must be a whole number"),
    (("run", LOG, "--sensors", "all,lrf"), 2, "write --sensors all or --sensors lrf"),
    (("run", LOG, "--export", "mcap,rosbag"), 2, "'rosbag'; choose from mcap, log, kitti, tum, tum-cov, csv"),
    (("run", LOG, "--smooth", "--set", "lrf.map=first-scan"), 2, "lrf.map = first-scan"),
    (("run", LOG, "--smooth", "--preset", "paper"), 2, "--preset paper"),
    (("compare", LOG, "--smooth", "--set", "lrf.map=consider"), 2, "lrf.map = consider"),
    (("compare", LOG, "--sensors", "lrf,odometry"), 2, "write --sensors odometry or --sensors lrf"),
    (("compare", LOG, "--sensors", "all,odometry"), 2, "write --sensors all or --sensors odometry"),
    (("compare", LOG, "--sensors", "lrf@fast"), 2, "lrf@fast"),
    (("compare", LOG, "--sensors", "lrf@0Hz"), 2, "lrf@0Hz"),
    (("compare", LOG, "--sensors", "sonar@2Hz"), 1, "sonar"),
    (("compare", LOG, "--fail-if", "nonsense"), 2, "nonsense"),
    (("compare", LOG, "--baseline", "no/such/file.json"), 2, "no/such/file.json"),
    (("compare", LOG, "--jitter", "-1"), 2, "--jitter -1: give a number of runs from 1 to 1000"),
    (("compare", LOG, "disturbed", "--jitter", "2"), 2, "--jitter 2: several logs say by themselves"),
    (("compare", LOG, "--bogus"), 2, "see: locfuse compare --help"),
    (("compare", LOG, "--align", "left"), 2, "'left' is not one of"),
    (("tune", LOG, "--sensors", "all,lrf"), 2, "write --sensors all or --sensors lrf"),
    (("view", LOG, "--connect", "127.0.0.1:9876"), 2, "no viewer's address"),
    (("view", LOG, "--connect", "http://127.0.0.1:9876/proxy"), 2, "no viewer's address"),
    (("view", LOG, "--images", "every=0"), 2, "neither every=N"),
    (("view", LOG, "--images", "some"), 2, "neither every=N"),
    (("run",), 2, "Missing argument 'LOG...'; see: locfuse run --help"),
    (("frobnicate",), 2, "no command 'frobnicate'; choose from run"),
    # what was meant is named
    (("view", "nosuch.rrd"), 2, "no such recording; make one with: locfuse view LOG --save nosuch.rrd"),
    (("compare", LOG, "--set", "lrf.sigma=1"), 2, "sigma_range"),
    (("compare", LOG, "--set", "sigma_range=1"), 2, "did you mean lrf.sigma_range"),
    (("compare", LOG, "--sensors", "laser"), 2, "did you mean lrf?"),
    (("compare", LOG, "--sensors", "imu"), 2, "did you mean gyro or compass?"),
    (("compare", LOG, "--fail-if", "all.rmse > 1"), 2, "did you mean position_rmse_m"),
    (("fleet", LOG, "disturbed", "--fail-if", "all.rmse > 1"), 2, "did you mean position_rmse_m"),
    (("compare", LOG, "--fail-if", "all.nothing_alike > 1"), 2, "locfuse schema report"),
    (("explain", "anes"), 2, "ANEES"),
    (("comapre", LOG), 2, "no command 'comapre'; did you mean compare"),
    (("compare", "rounded_rectangl"), 2, "did you mean rounded_rectangle?"),
    (("compare", LOG, "--sensors", "compass,lfr"), 2, "did you mean lrf?"),
    (("tune", LOG, "--sensors", "cmpass"), 2, "did you mean compass?"),
    (("compare", LOG, "--set", "lrf.sigma_rnge=1"), 2, "did you mean sigma_range?"),
    (("compare", LOG, "--set", "lrf.topic=/scn"), 1, "did you mean /scan?"),
]


@pytest.fixture(scope="module")
def bad_files(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    folder = tmp_path_factory.mktemp("bad")
    paths = {name: folder / f"{name}.toml" for name in ("typo", "broken")}
    paths |= {name: folder / f"{name}.mcap" for name in ("text", "empty", "nothing", "wheelless")}
    paths["typo"].write_text("[wheels]\ntrak = 0.6\n")
    paths["broken"].write_text("[wheels\n")
    paths["text"].write_text("hello")
    paths["empty"].write_bytes(b"")
    with paths["nothing"].open("wb") as sink:
        writer: Any = Writer(sink)
        writer.start()
        writer.finish()
    rewritten(paths["wheelless"], seed=None, without="/joint_states")
    return paths


@pytest.mark.parametrize(("words", "code", "says"), BAD, ids=[" ".join(b[0]) for b in BAD])
def test_bad_input_gets_one_clear_line_and_nothing_is_written(
    bad_files: dict[str, Path], tmp_path: Path, words: tuple[str, ...], code: int | tuple[int, ...], says: str
) -> None:
    out = tmp_path / "out"
    where = ("-o", out) if words[0] in {"run", "compare"} else ()
    done = locfuse(*(w.format(**bad_files) for w in words), *where)
    assert done.exit_code in (code if isinstance(code, tuple) else (code,)), done.stderr
    assert says in done.stderr
    assert done.stdout == ""
    assert "Traceback" not in done.stderr
    assert done.stderr.startswith("locfuse: ")
    assert len(done.stderr.strip().splitlines()) == 1
    assert not out.exists()


def test_json_on_stdout_is_the_report_and_write_chooses_the_files(tmp_path: Path) -> None:
    done = reported("run", LOG, "--no-advice", "--sensors", "odometry", "--json")
    assert json.loads(done.stdout) == done.report
    ok("compare", LOG, "--no-advice", "--sensors", "odometry", "--write", "json", "-o", tmp_path / "out")
    written = {p.name for p in (tmp_path / "out").iterdir()}
    assert written - {"timing.json", "fixes.toml"} == {"report.json", "robot.toml"}


def test_alignment_is_said_and_ends_consistency_figures() -> None:
    words = ("--no-advice", "--sensors", "odometry", "--align", "se2")
    figures = reported("run", LOG, *words).rows["odometry"]
    assert figures["align"] == "se2"
    assert figures["anees"] is None


def test_the_audit_accounts_for_every_measurement(tmp_path: Path) -> None:
    done = reported("run", LOG, "--sensors", "compass,lrf", "--audit", tmp_path / "audit.csv", "--no-advice")
    rows = [line.split(",") for line in (tmp_path / "audit.csv").read_text().splitlines()]
    head, rows = rows[0], rows[1:]
    assert head[:5] == ["t", "sensor", "measurement", "verdict", "landmark"]
    for sensor, figures in done.rows["compass+lrf"]["sensors"].items():
        counted = [r[3] for r in rows if r[1] == sensor]
        assert {v: counted.count(v) for v in figures["verdicts"]} == figures["verdicts"]
    assert [float(r[0]) for r in rows] == sorted(float(r[0]) for r in rows)
    accepted = [r for r in rows if r[3] == "accepted"]
    assert all(float(r[5]) <= float(r[6]) for r in accepted)


# --- references and smoothing on the command line

REFERENCE_LOG = "rounded_triangle"
SENSORS = [word for name in ("odometry", "compass", "lrf") for word in ("--sensors", name)]
WORDS = ("compare", REFERENCE_LOG, "-v", "--write", "all", *SENSORS, "--no-advice")
NO_TRUTH = ("--set", "truth.topic=none")


@pytest.fixture(scope="module")
def judged(tmp_path_factory: pytest.TempPathFactory) -> tuple[Done, Path]:
    out = tmp_path_factory.mktemp("reference") / "out"
    done = ok(*WORDS, *NO_TRUTH, "--estimate", "tracker=/ground_truth/pose", "-o", out)
    return done, out


def test_the_report_names_the_reference_and_what_judged_each_result(judged: tuple[Done, Path]) -> None:
    found = report_in(judged[1])
    assert found["truth"] is None
    assert found["reference"]["sensors"] == ["compass", "lrf", "camera"]
    assert found["reference"]["left_out"] == []
    assert 0.0 < found["reference"]["sigma_m"] < 0.02
    rows = found["configurations"]
    assert rows["odometry"]["reference"]["shared"] == []
    assert rows["compass"]["reference"]["left_out"] == ["compass"]
    assert rows["compass"]["position_rmse_m"] == pytest.approx(0.098, abs=0.01)  # by truth 0.0977
    assert rows["compass"]["anees"] is None


def test_every_page_says_that_it_is_a_reference(judged: tuple[Done, Path]) -> None:
    done, out = judged
    assert "Measured against a reference, not truth" in done.stdout
    assert "Distances are to a reference, not to truth" in done.stdout
    assert "the odometry, compass, lrf and camera" in done.stderr
    page, table = (out / "report.html").read_text(), (out / "report.md").read_text()
    for text in (page, table):
        assert "Measured against a reference, not truth" in text
        assert "the odometry, compass, lrf and camera" in text
        assert "judged by" in text
    assert "Deviation from reference" in page
    assert "Deviation is estimate minus reference" in page
    assert "Deviation = estimate - reference" in table


def test_a_verdict_names_the_reference_that_the_sensor_has_no_part_in(judged: tuple[Done, Path]) -> None:
    words = report_in(judged[1])["verdicts"]["compass"]["words"]
    assert words.startswith("Against a reference without it (lrf and camera, 1 sigma ")


def failed(report: dict[str, Any], gate: str) -> list[str]:
    return Gates.read(GateOptions((gate,))).failures(report)


def test_a_gate_on_truth_fails_on_a_reference_unless_it_says_so(judged: tuple[Done, Path]) -> None:
    plain, meant = "compass.position_rmse_m > 5", "reference.compass.position_rmse_m > 5"
    (line,) = failed(report_in(judged[1]), plain)
    assert f"errors are against a reference, not truth; if that is meant: {meant}" in line
    assert failed(report_in(judged[1]), meant) == []
    (line,) = failed(report_in(judged[1]), "reference.compass.position_rmse_m > 0.01")
    assert ": it is 0.09" in line
    assert failed(report_in(judged[1]), "compass.sensors.compass.accepted < 1") == []


def test_truth_and_reference_are_not_mixed_by_gate_or_baseline(judged: tuple[Done, Path], tmp_path: Path) -> None:
    baseline = judged[1] / "report.json"
    gates = ("--baseline", baseline, "--fail-if", "reference.odometry.position_rmse_m > 5")
    words = ("compare", REFERENCE_LOG, "-v", "--sensors", "odometry", "--no-advice", "--write", "json", "-q")
    done = locfuse(*words, *gates, "-o", tmp_path / "truth")
    assert done.exit_code == 4
    gate, other = [line for line in done.stderr.splitlines() if line.startswith("gate: ")]
    assert "no reference judged this log" in gate
    assert "its errors are against a reference of compass+lrf+camera, these against truth" in other
    assert Gates.read(GateOptions(baseline=baseline)).failures(report_in(judged[1])) == []


def test_it_can_be_left_out_and_is_refused_where_there_is_truth(tmp_path: Path) -> None:
    words = ("compare", REFERENCE_LOG, "-v", "--sensors", "odometry", "--no-advice", "--write", "json")
    done = reported(*words, *NO_TRUTH, "--no-reference")
    found = done.report
    assert found["reference"] is None
    assert found["configurations"]["odometry"]["position_rmse_m"] is None
    assert "--no-reference" in found["repeat"]
    assert "or measure against the solution of the whole drive: --reference" in done.stderr
    refusal = refused(*words, "--reference", "-o", tmp_path / "truth", code=2)
    assert "this log has a truth, /ground_truth/pose" in refusal


def test_results_by_truth_and_by_reference_side_by_side_say_so(judged: tuple[Done, Path]) -> None:
    by_reference = report_in(judged[1])
    by_truth = {**by_reference, "reference": None, "truth": {"topic": "/truth"}}
    found = changes(by_truth, by_reference)
    (line,) = [r for r in remarks(found) if r.startswith("errors cannot be compared")]
    assert "before against truth, after against a reference of compass+lrf+camera" in line


# --- --smooth as a user meets it: extra configurations and files, labelled; refused where it has no meaning


SMOOTH_LOG = "rounded_rectangle"


def test_compare_smooths_every_configuration_with_sensors() -> None:
    words = ("--sensors", "odometry", "--sensors", "lrf", "--smooth", "--no-advice", "--write", "json,tum")
    done = reported("compare", SMOOTH_LOG, *words)
    found = done.rows
    assert list(found) == ["odometry", "lrf", "lrf-smoothed"]
    assert [c["smoothed"] for c in found.values()] == [False, False, True]
    assert [c["configuration"] for c in found.values()] == ["odometry", "lrf", "lrf"]
    assert found["lrf-smoothed"]["position_rmse_m"] < found["lrf"]["position_rmse_m"]
    assert (done.out / "lrf-smoothed.tum").is_file()
    assert "reference" not in done.stderr


def test_run_writes_the_smoothed_drive_beside_the_filtered_one(tmp_path: Path) -> None:
    words = ("run", SMOOTH_LOG, "--no-advice", "--sensors", "lrf", "--write", "all")
    plain = locfuse(*words, "--no-smooth", "-o", tmp_path / "plain")
    done = locfuse(*words, "-o", tmp_path / "out")
    assert (plain.exit_code, done.exit_code) == (0, 0), done.stderr
    for kind in ("tum", "csv"):
        filtered = (tmp_path / "out" / f"trajectory.{kind}").read_bytes()
        assert filtered == (tmp_path / "plain" / f"trajectory.{kind}").read_bytes()
        assert filtered != (tmp_path / "out" / f"smoothed.{kind}").read_bytes()
    rows = np.loadtxt(tmp_path / "out" / "smoothed.csv", delimiter=",", skiprows=1)
    before = np.loadtxt(tmp_path / "out" / "trajectory.csv", delimiter=",", skiprows=1)
    np.testing.assert_array_equal(rows[:, 0], before[:, 0])
    assert (np.abs(rows[:, 3]) <= np.pi).all()
    assert rows[:, [4, 7, 9]].mean() < before[:, [4, 7, 9]].mean()


def test_what_has_a_laser_is_smoothed_unasked() -> None:
    of = ("compare", SMOOTH_LOG, "--to", 15, "--no-advice", *SENSORS, "--sensors", "lrf@2Hz")
    plain = ["odometry", "compass", "lrf", "lrf@2Hz"]
    assert list(reported(*of).rows) == [*plain, "lrf-smoothed"]
    for words in (("--no-smooth",), ("--jitter", 1), ("--set", "lrf.map=consider")):
        done = reported(*of, *words)
        assert list(done.rows) == plain
        assert words[0] != "--no-smooth" or "--no-smooth" in done.report["repeat"]


@pytest.mark.usefixtures("jobs_in_this_process")
def test_a_fleet_and_a_sweep_are_not_smoothed_unasked(tmp_path: Path) -> None:
    words = ("--to", 10, "--sensors", "lrf", "--write", "json")
    ok("fleet", SMOOTH_LOG, *words, "--sweep", "lrf.sigma_range=0.02,0.03", "-o", tmp_path / "out")
    found = [json.loads(p.read_text())["configurations"] for p in sorted((tmp_path / "out").rglob("report.json"))]
    assert [list(configurations) for configurations in found] == [["lrf"], ["lrf"]]
