"""Many logs: a job each, failed ones are rows, finished ones are not run again, whatever ends the run."""

import csv
import fnmatch
import json
import os
import pickle
import re
import shutil
import signal
import subprocess
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest
from commands import counted_jobs, locfuse, ok, refused
from many_logs import LIGHT, QUIET, killed, tables, write_logs
from msgspec.structs import replace

from locfuse.cli.analysis.grouping import _regex, expanded
from locfuse.cli.analysis.robot_tables import given_tables
from locfuse.cli.analysis.settings import Asked, LogOptions, Outputs
from locfuse.cli.fleet import process
from locfuse.cli.fleet.jobs import Job, JobOutcome
from locfuse.cli.fleet.queue import QueueState, duration, run_all
from locfuse.formats.logs.log import open_log
from locfuse.formats.whole_files import RUN_LOCK, sole_writer
from locfuse.fusion.data import LocfuseError, UsageError

ONE = ("--sensors", "odometry", "--sensors", "compass", "--write", "json,csv", "-q")


@pytest.fixture(scope="module")
def logs(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Four light drives of two robots: fleet/r0/a.mcap, ..."""
    folder = tmp_path_factory.mktemp("fleet") / "fleet"
    for robot in ("r0", "r1"):
        (folder / robot).mkdir(parents=True)
    names = ("r0/drivea0", "r0/driveb1", "r1/drivea2", "r1/driveb3")
    return write_logs(folder, names, (*LIGHT, "path.legs=[{forward=1.5}]"))


def rows(folder: Path) -> list[dict[str, str]]:
    with (folder / "summary.csv").open() as file:
        return list(csv.DictReader(file))


@pytest.mark.usefixtures("jobs_in_this_process")
def test_a_log_that_cannot_be_read_is_a_row_and_the_others_are_compared(logs: list[Path], tmp_path: Path) -> None:
    bad = tmp_path / "bad.mcap"
    bad.write_text("no log at all")
    done = locfuse("fleet", logs[0], bad, tmp_path / "gone.mcap", logs[1], "-o", tmp_path / "out", *ONE)
    assert done.exit_code == 3, done.stderr
    found = {(r["log"], r["configuration"]): r for r in rows(tmp_path / "out")}
    assert found["bad", ""]["state"] == found["gone", ""]["state"] == "failed"
    assert "not an MCAP file" in found["bad", ""]["reason"]
    assert "no such log" in found["gone", ""]["reason"]
    assert found[logs[1].stem, "compass"]["state"] == "done"
    assert [r["log"] for r in rows(tmp_path / "out")] == [
        *[logs[0].stem] * 2,
        "bad",
        "gone",
        *[logs[1].stem] * 2,
    ]
    assert done.stderr.count("failed: ") == 2
    assert "2 failed" in done.stdout


@pytest.mark.usefixtures("jobs_in_this_process")
def test_all_logs_failing_is_an_error_and_all_by_a_wrong_word_is_misuse(logs: list[Path], tmp_path: Path) -> None:
    for name in ("bad", "worse"):
        (tmp_path / f"{name}.mcap").write_text("no log at all")
    words = (tmp_path / "bad.mcap", tmp_path / "worse.mcap", "-o", tmp_path / "out", "--write", "json")
    assert locfuse("fleet", *words).exit_code == 1
    wrong = locfuse("fleet", *logs[:2], "-o", tmp_path / "b", "--sensors", "odometre")
    assert wrong.exit_code == 2
    assert "unknown sensor 'odometre'" in wrong.stderr
    assert locfuse("fleet", *logs[:2], "-o", tmp_path / "c", "--set", "lrf.sigmarange=1").exit_code == 2


@pytest.mark.usefixtures("jobs_in_this_process")
def test_a_finished_log_is_not_run_again_until_something_changes(
    logs: list[Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    ran = counted_jobs(monkeypatch)
    own = [tmp_path / log.name for log in logs[:2]]
    for source, copy in zip(logs, own, strict=False):
        shutil.copy2(source, copy)
    out = tmp_path / "out"

    def names(*words: Any) -> list[str]:
        ran.clear()
        ok("fleet", *own, "-o", out, *ONE, *words)
        return sorted(ran)

    every = sorted(p.stem for p in own)
    assert names() == every
    before = tables(out)
    assert names() == []
    assert tables(out) == before
    assert names("--again") == every
    assert names("--set", "compass.sigma_deg=5") == every  # other settings
    assert names() == every  # and back
    (out / own[0].stem / "report.json").unlink()
    assert names() == [own[0].stem]
    later = time.time() + 60
    os.utime(own[1], (later, later))  # written to after the result
    assert names() == [own[1].stem]


@pytest.mark.usefixtures("jobs_in_this_process")
def test_a_setting_in_a_file_is_the_setting_on_the_command_line(
    logs: list[Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "out"
    ok("fleet", *logs[:2], "-o", out, *ONE, "--set", "compass.sigma_deg=5")
    (tmp_path / "robot.toml").write_text("# a comment\n[compass]\nsigma_deg = 5\n")
    monkeypatch.setattr(process, "_in_a_process", lambda job, folder: pytest.fail(f"{job.name} was run again"))
    ok("fleet", *logs[:2], "-o", out, *ONE, "--robot", tmp_path / "robot.toml")


@pytest.mark.parametrize("key", ["truth.topic", "landmarks.topic", "landmarks.map"])
def test_a_file_that_a_setting_names_is_part_of_the_key_by_its_content(key: str, tmp_path: Path) -> None:
    file = tmp_path / "beside.csv"
    how = LogOptions(sets=(f'{key}="{file}"',), quiet=True)
    file.write_text("t,x,y\n0,0,0\n")
    before = given_tables(how)
    os.utime(file, (1, 1))
    assert given_tables(how) == before
    file.write_text("t,x,y\n0,0,1\n")
    assert given_tables(how) != before
    assert given_tables(how, (f"{key}=other",)) != given_tables(how)  # a sweep's cell names another


@pytest.mark.usefixtures("jobs_in_this_process")
def test_another_truth_file_is_run_again_and_the_window_is_that_of_every_log(
    logs: list[Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    truth = tmp_path / "truth.csv"
    first = int(open_log([logs[0]]).streams({"/ground_truth/pose": ()})["/ground_truth/pose"].t_ns[0])
    words = ("-o", tmp_path / "out", *ONE, "--truth", truth, "--to", "2")

    def run(y: float) -> list[float]:
        truth.write_text("t,x,y\n" + "".join(f"{first + i * 100_000_000},{0.01 * i},{y}\n" for i in range(30)))
        ok("fleet", f"@{listed}", *words)
        return [float(r["position_rmse_m"]) for r in rows(tmp_path / "out")]

    listed = tmp_path / "logs.txt"
    listed.write_text(str(logs[0]))
    zero = run(0.0)
    assert abs(run(5.0)[0] - zero[0]) > 0.1
    report = json.loads((tmp_path / "out" / logs[0].stem / "report.json").read_text())
    assert report["configurations"]["compass"]["duration_s"] <= 2.0
    monkeypatch.setattr(process, "_in_a_process", lambda job, folder: pytest.fail(f"{job.name} was run again"))
    run(5.0)


@pytest.mark.usefixtures("jobs_in_this_process")
def test_a_run_killed_and_started_again_equals_one_that_is_left_alone(logs: list[Path], tmp_path: Path) -> None:
    ok("fleet", *logs[:2], "-o", tmp_path / "alone", *QUIET)
    found, _ = killed(logs[:2], tmp_path / "killed", times=2, seed=5)
    assert found == tables(tmp_path / "alone")


def test_two_jobs_at_once_give_the_files_of_one(logs: list[Path], tmp_path: Path) -> None:
    for jobs in (1, 2):
        ok("fleet", *logs[:2], "-o", tmp_path / str(jobs), "--jobs", jobs, *ONE)
    assert tables(tmp_path / "1") == tables(tmp_path / "2")


def test_a_process_that_is_killed_is_a_row_that_names_the_signal(
    logs: list[Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    dies = (sys.executable, "-c", "import os, signal; os.kill(os.getpid(), signal.SIGKILL)")
    monkeypatch.setattr(process, "COMMAND", dies)
    done = locfuse("fleet", *logs[:2], "-o", tmp_path / "out", *ONE)
    assert done.exit_code == 1
    assert "ended by signal 9 (SIGKILL)" in done.stderr
    monkeypatch.setattr(process, "COMMAND", (sys.executable, "-c", "raise SystemError('odd')"))
    done = locfuse("fleet", *logs[:2], "-o", tmp_path / "out", *ONE)
    assert "its process ended with code 1: SystemError: odd" in done.stderr


def test_a_job_ends_with_the_command_that_started_it() -> None:
    with subprocess.Popen(
        process.COMMAND, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE
    ) as child:
        assert child.stdin is not None
        child.stdin.write(pickle.dumps(replace(job("a"), log=("/dev/stdin",), folder=Path("/nowhere"))))
        child.stdin.close()
        assert child.wait(60) in {0, 1}


def test_ctrl_c_keeps_what_is_done(logs: list[Path], tmp_path: Path) -> None:
    out = tmp_path / "out"
    slow = tmp_path / "slow.py"  # the first log is compared, every other one takes for ever
    slow.write_text(
        "import time\nfrom locfuse.cli.fleet import process\n"
        "real = process.compare\n"
        f"process.compare = lambda job: real(job) if job.name == {logs[0].stem!r} else time.sleep(600)\n"
        "process.main()\n"
    )
    code = (
        "import sys\nfrom locfuse.cli.commands import fleet as several\n"
        "from locfuse.cli.fleet import process\n"
        f"process.COMMAND = (sys.executable, {str(slow)!r})\n"
        "several.LINE_INTERVAL_S = 0.0\n"  # says at every look how far it is
        "from locfuse.cli.main import main\nmain(sys.argv[1:])\n"
    )
    command = (sys.executable, "-c", code, "fleet", *map(str, logs), "-o", str(out), "--jobs", "2", *ONE[:-1])
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True) as run:
        too_long = threading.Timer(300.0, run.kill)
        too_long.start()
        words = ""
        for line in run.stderr or ():
            if "1 done" in line and "1 done" not in words:
                run.send_signal(signal.SIGINT)
            words += line
        too_long.cancel()
    assert run.returncode == 130, words
    assert "the same command goes on with the rest" in words
    states = {r["log"]: r["state"] for r in rows(out)}
    assert states[logs[3].stem] == "not run"
    assert (out / logs[0].stem / "report.json").is_file()


def test_two_runs_do_not_share_a_folder(logs: list[Path], tmp_path: Path) -> None:
    out = tmp_path / "out"
    out.mkdir()
    with sole_writer(out, RUN_LOCK):
        assert f"is being written by process {os.getpid()}" in refused("fleet", *logs[:2], "-o", out, *ONE)


def job(name: str) -> Job:
    return Job(name, (name,), Path(name), LogOptions(), Asked(), Outputs())


def test_too_many_failures_stop_the_queue(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(process, "run", lambda job, *_: JobOutcome(job.name, "failed", "no luck"))
    jobs, seen = [job(str(i)) for i in range(100)], list[str]()
    with ThreadPoolExecutor(1) as pool:
        ended = run_all(jobs, pool, 2, lambda standing, outcome: seen.append(standing.words()))
        assert len(run_all(jobs, pool, None, lambda standing, outcome: None).outcomes) == 100
    assert "more than 2 logs failed" in ended.stopped
    assert seen[0].startswith("0 done, 1 failed, 99 left")
    assert seen[-1].startswith("0 done, 3 failed, 97 left")


def test_progress_says_how_long_it_will_take() -> None:
    standing = QueueState(10, done=4, failed=1, resumed=3, began=time.monotonic() - 20.0)
    # two were run in 20 s, five are left
    assert standing.words() == "4 done, 1 failed, 5 left, about 50 s"
    assert [duration(s) for s in (89.0, 600.0, 7200.0)] == ["89 s", "10 min", "2.0 h"]


def test_lists_patterns_and_folders_name_logs(logs: list[Path], tmp_path: Path) -> None:
    listed, root = tmp_path / "logs.txt", logs[0].parent.parent
    listed.write_text(f"# two of them\n{logs[0]}\n\n{logs[3].parent}/*.mcap\n")
    assert expanded([f"@{listed}"]) == [str(p) for p in (logs[0], logs[2], logs[3])]
    assert expanded([str(root / "r*" / "*.mcap")]) == expanded([], [str(root)]) == [str(p) for p in logs]
    bag, result = tmp_path / "bag", tmp_path / "result"
    for folder, file, text in (
        (bag, "metadata.yaml", "rosbag2_bagfile_information: {}"),
        (result, "report.json", "{}"),
    ):
        folder.mkdir()
        (folder / file).write_text(text)
        shutil.copy(logs[0], folder / "estimates.mcap")
    assert expanded([], [str(tmp_path)]) == [str(bag)]
    with pytest.raises(UsageError, match="nothing fits"):
        expanded(["*.nothing"])
    with pytest.raises(LocfuseError, match="cannot be read"):
        expanded([f"@{tmp_path / 'robot.toml'}"])


@pytest.mark.usefixtures("jobs_in_this_process")
def test_fleet_is_the_command_and_compare_of_several_logs_gives_the_same(logs: list[Path], tmp_path: Path) -> None:
    for command in ("fleet", "compare"):
        ok(command, *logs[:2], "-o", tmp_path / command, "--sweep", "compass.sigma_deg=3,5", *ONE)
    assert tables(tmp_path / "fleet") == tables(tmp_path / "compare")
    ok("fleet", logs[0], "-o", tmp_path / "one", *ONE)
    assert [r["log"] for r in rows(tmp_path / "one")] == [logs[0].stem] * 2
    (tmp_path / "logs.txt").write_text(f"{logs[0]}\n")  # a list is of many logs, even where it names one
    ok("compare", f"@{tmp_path / 'logs.txt'}", "-o", tmp_path / "list", *ONE)
    assert (tmp_path / "list" / logs[0].stem / "report.json").is_file()
    assert "Missing argument 'LOG...'; see: locfuse fleet --help" in locfuse("fleet").stderr
    assert "--jobs" in locfuse("fleet", "--help").stdout
    assert "--jobs" not in locfuse("compare", "--help").stdout


@pytest.mark.usefixtures("jobs_in_this_process")
def test_a_robot_has_its_own_settings(logs: list[Path], tmp_path: Path) -> None:
    for robot, sigma in (("r0", 4.0), ("r1", 9.0)):
        (tmp_path / f"{robot}.toml").write_text(f"[compass]\nsigma_deg = {sigma}\n")
    words = ("--robot-from", r"/(?P<robot>r\d)/", "--robot", tmp_path / "{robot}.toml", "-o", tmp_path / "out")
    ok("fleet", *logs, *words, *ONE)
    for log, sigma in zip(logs, (4.0, 4.0, 9.0, 9.0), strict=True):
        report = json.loads((tmp_path / "out" / log.stem / "report.json").read_text())
        assert report["settings"]["compass"]["sigma_deg"] == sigma
    assert {r["log"]: r["robot"] for r in rows(tmp_path / "out")} == {log.stem: log.parent.name for log in logs}
    (tmp_path / "fixes.toml").write_text("[compass]\nsigma_deg = 7\n")
    ok("fleet", logs[0], *words, "--robot", tmp_path / "fixes.toml", *ONE)
    report = json.loads((tmp_path / "out" / logs[0].stem / "report.json").read_text())
    assert report["settings"]["compass"]["sigma_deg"] == 7.0, "a later file goes over the robot's own"
    (tmp_path / "r1.toml").unlink()
    done = locfuse("fleet", *logs, *words, *ONE)
    assert done.exit_code == 3
    assert "r1.toml is no file" in done.stderr


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--robot-from", "fleet/r"), "in a group"),
        (("--robot-from", "(r"), "not a regular expression"),
        (("--robot", "robots/{robot}.toml"), "--robot-from REGEX"),
        (("--sweep", "compass.sigma_deg"), "write it like"),
        (("--sweep", "compass.sigmadeg=1,2"), "did you mean"),
        (("--rerun-save", "a.rrd"), "one log at a time"),
        (("--baseline", __file__), "not a summary.json"),
    ],
)
def test_what_cannot_be_done_is_refused_before_any_log_is_read(
    logs: list[Path], tmp_path: Path, words: tuple[str, ...], said: str
) -> None:
    assert said in refused("compare", *logs, "-o", tmp_path / "out", *words, code=None)
    assert not (tmp_path / "out").exists() or not list((tmp_path / "out").glob("drive*"))


@pytest.mark.usefixtures("jobs_in_this_process")
def test_every_drive_of_a_fleet_is_recorded_and_one_command_serves_all(logs: list[Path], tmp_path: Path) -> None:
    from rerun.chunk import RrdReader

    words = ("fleet", *logs[:2], "-o", tmp_path / "out", "--rerun", *ONE)
    done = ok(*words)
    names = [log.stem for log in logs[:2]]
    files = [tmp_path / "out" / "recordings" / f"{name}.rrd" for name in names]
    assert [RrdReader(file).recordings()[0].recording_id for file in files] == names
    assert f"rerun server --host 127.0.0.1 --port 51234 --dataset drives={files[0].parent}" in done.stderr
    made = [file.stat().st_mtime_ns for file in files]
    files[1].unlink()
    ok(*words)
    assert files[0].stat().st_mtime_ns == made[0], "it was there"
    assert files[1].is_file()


@pytest.mark.parametrize(
    "pattern", ["a[bc]", "a[!b]", "a[]b", "a[z-a]", "a[a-", "a[\\d]", "a[[]", "a[^b]", "a[&&b]"]
)
def test_brackets_in_an_address_mean_what_they_mean_to_the_shell(pattern: str) -> None:
    found = re.compile(_regex(pattern))
    for name in ("ab", "ac", "aa", "ad", "a\\", "a[", "a^", "a&", "a1", "a[]b", "a[a-", pattern):
        assert bool(found.fullmatch(name)) == fnmatch.fnmatchcase(name, pattern), name
