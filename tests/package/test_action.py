"""The GitHub Action: its steps run here as a runner runs them, with files in place of the runner's own."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Any, NamedTuple

import pytest
from ruamel.yaml import YAML
from trap_logs import Drive
from traps import elsewhere

ROOT = Path(__file__).parents[2]
ACTION: dict[str, Any] = YAML(typ="safe").load((ROOT / "action.yml").read_text(encoding="utf-8"))
WORKFLOWS = sorted((ROOT / ".github").rglob("*.yml"))
FAST = "--sensors odometry --sensors compass --write json,md --no-advice"


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
