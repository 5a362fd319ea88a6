"""locfuse on somebody's computer: what is missing is one line with the command that installs it."""

import json
import os
import re
import subprocess
import sys
import tomllib
from importlib import metadata
from pathlib import Path
from typing import Any, NamedTuple

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name
from present import present
from rewrite_log import rewritten
from ruamel.yaml import YAML
from trap_logs import Drive
from traps import elsewhere

ROOT = Path(__file__).parents[2]
PYPROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
PROJECT = PYPROJECT["project"]


def python(code: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)


def command(before: str, *words: str) -> subprocess.CompletedProcess[str]:
    return python(f"import sys\n{before}\nfrom locfuse.cli.main import main\nmain({list(words)!r})")


@pytest.mark.parametrize(
    ("module", "package", "words"),
    [
        ("cv2", "opencv-python-headless", ("run", "rounded_triangle", "--sensors", "camera")),
        (
            "jinja2",
            "jinja2",
            ("compare", "rounded_triangle", "--sensors", "odometry", "--write", "html", "--no-advice"),
        ),
        (
            "rerun",
            "rerun-sdk",
            ("run", "rounded_triangle", "--sensors", "odometry", "--rerun-save", "x.rrd", "--no-advice"),
        ),
    ],
)
def test_a_missing_package_is_one_line_with_the_pip_command(
    module: str, package: str, words: tuple[str, ...], tmp_path: Path
) -> None:
    done = command(f"sys.modules[{module!r}] = None", *words, "-o", str(tmp_path / "out"), "-q")
    assert done.returncode == 1, done.stderr
    assert "Traceback" not in done.stderr
    assert f"python -m pip install {package}" in done.stderr.strip().splitlines()[-1]


def test_a_module_of_our_own_that_is_missing_is_a_bug_and_shown_as_one() -> None:
    done = command("sys.modules['locfuse.cli.analysis.compare'] = None", "compare", "rounded_triangle")
    assert "Traceback" in done.stderr


def test_an_old_python_is_one_line() -> None:
    done = python("import sys\nsys.version_info = (3, 10, 2)\nimport locfuse")
    assert done.stderr.splitlines()[-1].endswith("this is 3.10: python3.11 -m pip install locfuse")
    assert PROJECT["requires-python"] == ">=3.11"


def test_the_metadata_says_what_it_is_and_names_no_person() -> None:
    about = metadata.metadata("locfuse")
    assert about["License-Expression"] == "Apache-2.0 AND CC-BY-SA-4.0"
    assert "Author" not in about
    assert "Author-email" not in about
    assert "Programming Language :: Python :: 3.11" in (about.get_all("Classifier") or [])


def test_the_extra_all_names_only_extras_that_exist() -> None:
    extras = PROJECT["optional-dependencies"]
    named = {n for line in extras["all"] for n in line.partition("[")[2].rstrip("]").split(",") if n}
    assert named <= extras.keys() - {"all"}


LOCKED = re.compile(
    r"^([a-z0-9-]+)==(\S+)(?: ; .*)? \\\n((?:    --hash=sha256:[0-9a-f]{64}(?: \\)?\n)+)", re.MULTILINE
)


@pytest.mark.parametrize("name", ["run", "product", "release"])
def test_a_lock_pins_every_package_with_hashes(name: str) -> None:
    text = (ROOT / ".ci" / "locks" / f"{name}.txt").read_text(encoding="utf-8")
    assert LOCKED.sub("", text) == ""  # no line of another kind


@pytest.mark.parametrize(
    ("name", "groups"), [("run", ("test", "docs")), ("product", ()), ("release", ("release",))]
)
def test_a_lock_holds_what_pyproject_asks_for(name: str, groups: tuple[str, ...]) -> None:
    """A dependency that was added, or whose bounds moved, needs .ci/lock."""
    text = (ROOT / ".ci" / "locks" / f"{name}.txt").read_text(encoding="utf-8")
    pinned: dict[str, set[str]] = {}
    for package, version, _ in LOCKED.findall(text):
        pinned.setdefault(package, set()).add(version)
    extras = PROJECT["optional-dependencies"]
    asked = [] if name == "release" else [*PROJECT["dependencies"], *extras["remote"], *extras["cluster"]]
    waiting = list(groups)
    while waiting:
        for line in PYPROJECT["dependency-groups"][waiting.pop()]:
            if isinstance(line, str):
                asked.append(line)
            else:
                waiting.append(line["include-group"])
    for line in map(Requirement, asked):
        versions = pinned.get(canonicalize_name(line.name), set())
        assert versions, line
        assert all(line.specifier.contains(v) for v in versions), line


PAGE = (Path(__file__).parents[2] / "docs" / "install.md").read_text(encoding="utf-8")
HIDE = """
import importlib.abc, re, sys
from importlib.metadata import packages_distributions

installed, owners = set({installed!r}), packages_distributions()
plain = lambda name: re.sub("[-_.]+", "-", name).lower()


class Hidden(importlib.abc.MetaPathFinder):
    def find_spec(self, name, path=None, target=None):
        mine = owners.get(name.partition(".")[0], [])
        if mine and not any(plain(owner) in installed for owner in mine):
            raise ModuleNotFoundError("not installed: " + name, name=name)


sys.meta_path.insert(0, Hidden())
from locfuse.cli.main import main
main({words!r})
"""


def run(*words: str) -> subprocess.CompletedProcess[str]:
    found = present(re.search(r"pip install --no-deps (.+)", PAGE))
    installed = [re.sub("[-_.]+", "-", name).lower() for name in found[1].split()]
    code = HIDE.format(installed=installed, words=list(words))
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)


def test_a_comparison_with_gates_needs_nothing_else(tmp_path: Path) -> None:
    log = rewritten(tmp_path / "log.mcap", None, "/omni/image/compressed", "rounded_triangle")
    out = tmp_path / "out"
    gates = ("--fail-if", "all.position_rmse_m > 0.5", "--write", "json,md", "-o", str(out))
    done = run("compare", str(log), "--to", "20", "--sensors", "all", "--sensors", "compass", *gates)
    assert done.returncode == 0, done.stderr
    assert "all" in json.loads((out / "report.json").read_text())["configurations"]


def test_what_it_lacks_is_said_with_the_pip_command(tmp_path: Path) -> None:
    done = run("compare", "rounded_triangle", "--sensors", "odometry", "-o", str(tmp_path / "out"))
    assert done.returncode == 1
    assert "python -m pip install" in done.stderr.splitlines()[-1]
    assert "Traceback" not in done.stderr


# --- the GitHub Action: its steps run here as a runner runs them, with files in place of the runner's own

ACTION: dict[str, Any] = YAML(typ="safe").load((ROOT / "action.yml").read_text(encoding="utf-8"))
WORKFLOWS = sorted((ROOT / ".github").rglob("*.yml"))
FAST = "--sensors odometry --sensors compass --to 10 --write json,md --no-advice"


class Ran(NamedTuple):
    exit_code: int
    outputs: dict[str, str]
    summary: str
    printed: str


def compare(folder: Path, **given: str) -> Ran:
    """The step `compare` with these inputs, the others at their defaults."""
    step = next(s for s in ACTION["runs"]["steps"] if s.get("id") == "compare")
    inputs = {name: value.get("default", "") for name, value in ACTION["inputs"].items()} | given
    environment = {
        **os.environ,
        **{key: filled(value, inputs) for key, value in step["env"].items()},
        "GITHUB_OUTPUT": str(folder / "output"),
        "GITHUB_STEP_SUMMARY": str(folder / "summary"),
        "PATH": f"{Path(sys.executable).parent}:{os.environ['PATH']}",
    }
    (folder / "output").touch()
    (folder / "summary").touch()
    command = ["bash", "--noprofile", "--norc", "-eo", "pipefail", "-c", step["run"]]
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=False)
    outputs = dict(line.split("=", 1) for line in (folder / "output").read_text().splitlines())
    return Ran(done.returncode, outputs, (folder / "summary").read_text(), done.stdout + done.stderr)


def filled(text: str, inputs: dict[str, str]) -> str:
    for name, value in inputs.items():
        text = text.replace("${{ inputs." + name + " }}", value)
    assert "${{" not in text, text
    return text


def test_a_log_within_its_gates_passes_and_its_report_is_the_summary(tmp_path: Path) -> None:
    done = compare(
        tmp_path, log="rounded_triangle", gates="all.anees > 900\nodometry.position_rmse_m > 9\n", options=FAST
    )
    assert done.exit_code == 4, done.printed  # `all` was not compared: a gate is never skipped silently
    done = compare(tmp_path, log="rounded_triangle", gates="odometry.position_rmse_m > 9\n", options=FAST)
    assert done.exit_code == 0, done.printed
    assert done.outputs == {"report": "locfuse-report/report.json", "exit-code": "0"}
    assert "odometry" in done.summary
    assert json.loads((tmp_path / done.outputs["report"]).read_text())["configurations"].keys() >= {"odometry"}


def test_a_baseline_that_was_better_fails_and_the_summary_is_written_all_the_same(tmp_path: Path) -> None:
    assert compare(tmp_path, log="rounded_triangle", options=FAST).exit_code == 0
    report = json.loads((tmp_path / "locfuse-report" / "report.json").read_text())
    report["configurations"]["compass"]["position_rmse_m"] /= 2
    (tmp_path / "before.json").write_text(json.dumps(report))
    (tmp_path / "summary").unlink()
    done = compare(tmp_path, log="rounded_triangle", baseline="before.json", options=FAST)
    assert done.exit_code == 4
    assert done.outputs["exit-code"] == "4"
    assert "compass.position_rmse_m" in done.printed
    assert "odometry" in done.summary


@pytest.mark.parametrize("logs", [1, 2])
def test_void_figures_fail(tmp_path: Path, logs: int) -> None:
    """The truth starts elsewhere than a drive whose start nobody states."""
    void = Drive()
    elsewhere(void)
    recorded = [void.record(tmp_path / "void.mcap"), Drive().record(tmp_path / "right.mcap")][:logs]
    done = compare(tmp_path, log="\n".join(map(str, recorded)), options=FAST)
    assert (done.exit_code, done.outputs["exit-code"]) == (3, "3"), done.printed
    assert "::error::locfuse: figures are void" in done.printed


def test_lost_data_is_a_warning(tmp_path: Path) -> None:
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(Drive().record(tmp_path / "whole.mcap").read_bytes()[:-20000])
    done = compare(tmp_path, log=str(cut), options=FAST)
    assert (done.exit_code, done.printed.count("::warning::")) == (0, 1), done.printed


def test_words_of_an_input_are_never_run_as_a_command(tmp_path: Path) -> None:
    evil = "$(touch pwned); touch pwned; `touch pwned`"
    assert compare(tmp_path, **dict.fromkeys(ACTION["inputs"], evil)).exit_code == 2
    assert not (tmp_path / "pwned").exists()
    scripts = [step["run"] for step in ACTION["runs"]["steps"] if "run" in step]
    assert not any("${{" in script for script in scripts)


def test_what_the_action_promises_it_has() -> None:
    ids = {step.get("id") for step in ACTION["runs"]["steps"]}
    assert {output["value"].split(".")[1] for output in ACTION["outputs"].values()} <= ids
    page = (ROOT / "docs" / "ci.md").read_text(encoding="utf-8")
    assert [name for name in ACTION["inputs"] if f"`{name}`" not in page] == []


@pytest.mark.parametrize("path", WORKFLOWS, ids=lambda p: p.stem)
def test_a_workflow_asks_for_no_more_than_it_needs(path: Path) -> None:
    flow = YAML(typ="safe").load(path.read_text(encoding="utf-8"))
    if "jobs" not in flow:
        return  # a form for issues
    assert flow["permissions"] == {"contents": "read"}
    assert "secrets." not in path.read_text(encoding="utf-8")


@pytest.mark.parametrize("path", [*WORKFLOWS, ROOT / "action.yml"], ids=lambda p: p.stem)
def test_an_action_of_others_is_pinned_by_its_commit(path: Path) -> None:
    """A tag can be moved to other code; the comment says which release the commit is."""
    used = re.findall(r"uses: (?!\./)(.*)", path.read_text(encoding="utf-8"))
    assert [line for line in used if not re.fullmatch(r"[\w/-]+@[0-9a-f]{40} # v\d+\.\d+\.\d+", line)] == []
