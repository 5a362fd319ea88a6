"""What a page tells people to type exists: commands, their options, keys of robot.toml, benchmarks."""

import ast
import contextlib
import json
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import click
import msgspec
import numpy as np
import pytest
from commands import locfuse, ok
from hostile import write
from present import present
from sources import parsed

from benchmarks import readme
from benchmarks.notebook import EXAMPLES, executed, without_figures
from locfuse.cli import main as cli
from locfuse.cli.analysis.robot_tables import table_types
from locfuse.cli.main import COMMANDS
from locfuse.fusion.data import ArrayStream
from locfuse.fusion.sensors.registry import REGISTRY, SOURCES, register_installed
from locfuse.sample_logs.scenario import Scenario

ROOT = Path(__file__).parents[2]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
SCENARIO = {f.name: getattr(f.type, "__struct_fields__", ()) for f in msgspec.structs.fields(Scenario)}
KEYS = {name: {*table.__struct_fields__, *SCENARIO.get(name, ())} for name, table in table_types().items()}
OPTION = re.compile(r"(?<![\w-])(--?[a-z][a-z-]*)")


def teardown_module() -> None:
    """A million nodes would make every later sweep for garbage slow."""
    parsed.cache_clear()


def typed(page: Path, what: str) -> Iterator[str]:
    """Lines to type that begin with `what`, and the same in backticks, without comments."""
    for line in page.read_text(encoding="utf-8").splitlines():
        plain = re.match(rf"(?: {{4}}|\$ )\s*(?:\w+=\S+ )*({what} .*)", line)
        for found in [plain[1]] if plain else re.findall(rf"`({what} [^`]+)`", line):
            yield found.split(" #")[0].split(" > ")[0]


def options(command: click.Command) -> set[str]:
    return {o for p in command.params for o in (*p.opts, *p.secondary_opts)} | {"-h", "--help"}


@pytest.mark.parametrize("page", PAGES, ids=lambda p: p.name)
def test_every_command_option_and_key_of_robot_toml_exists(page: Path) -> None:
    with click.Context(cli.locfuse) as context:
        for line in typed(page, "locfuse"):
            name = line.split()[1]
            if not name.isalpha() or name.isupper():
                continue  # locfuse --help
            assert name in COMMANDS, line
            command = present(cli.locfuse.get_command(context, name))
            assert set(OPTION.findall(line)) <= options(command), line
    # `table.key` in backticks and after --set, of a robot.toml or a scenario.
    text = page.read_text(encoding="utf-8")
    named = re.findall(rf"(?:`|--set[ =])({'|'.join(KEYS)})\.([a-z_]+)(?![.\w])", text)
    assert {
        f"{table}.{key}" for table, key in named if key not in KEYS[table] and key not in {"py", "md"}
    } == set()


@pytest.mark.parametrize("page", PAGES, ids=lambda p: p.name)
def test_every_benchmark_and_its_options_exist(page: Path) -> None:
    for line in typed(page, "python -m"):
        module = line.split()[2].split(".")
        if module[0] != "benchmarks":
            continue
        file = ROOT.joinpath(*module).with_suffix(".py")
        source = (file if len(module) > 1 else ROOT / "benchmarks" / "__main__.py").read_text(encoding="utf-8")
        if "experiment.command(" in source:  # brings options of its own
            source += (ROOT / "benchmarks" / "experiment.py").read_text(encoding="utf-8")
        for option in OPTION.findall(line.split("python -m", 1)[1][3:]):
            assert f'"{option}' in source or f"/{option}" in source, line


def test_the_page_on_trust_lists_every_verdict() -> None:
    from typing import get_args

    from locfuse.fusion.data import VERDICTS
    from locfuse.fusion.judge.consistency import Verdict

    page = (ROOT / "docs" / "trust.md").read_text(encoding="utf-8")
    rows = "\n".join(line.split("|")[1] for line in page.splitlines() if line.startswith("|"))
    assert {v for v in (*get_args(Verdict), *VERDICTS) if f"`{v}`" not in rows} == set()


PROSE = [ROOT / "CONTRIBUTING.md", ROOT / "SECURITY.md", ROOT / "sample_logs" / "README.md", *PAGES]
MAX_WORDS = 30  # of a sentence


def sentences(page: Path) -> Iterator[str]:
    """Yield the sentences of a page: no code, tables or headings; a link counts by its words."""
    text = re.sub(r"```.*?```", "\n\n", page.read_text(encoding="utf-8"), flags=re.DOTALL)
    lines = [line if not line.startswith(("|", "#", "    ")) else "" for line in text.splitlines()]
    for paragraph in re.split(r"\n\s*\n|\n(?=- |\d+\. )", "\n".join(lines)):
        plain = re.sub(r"\]\([^)]*\)", "]", re.sub(r"`[^`]*`", "CODE", " ".join(paragraph.split())))
        yield from re.split(r"(?<=[.!?:;])\)? +", plain)


@pytest.mark.parametrize("page", PROSE, ids=lambda p: f"{p.parent.name}-{p.name}")
def test_no_sentence_is_long_and_every_link_to_a_heading_leads_to_one(page: Path) -> None:
    """A part before a colon or a semicolon can be read by itself, so it counts by itself."""
    assert [s for s in sentences(page) if len(s.split()) > MAX_WORDS] == []
    links = re.findall(r"\]\(([\w./]*)#([\w-]+)\)", page.read_text(encoding="utf-8"))
    assert [f"{to}#{at}" for to, at in links if at not in slugs(page.parent / to if to else page)] == []


def slugs(page: Path) -> set[str]:
    """Anchors of a page's headings, as GitHub makes them."""
    found = re.findall(r"^#+ (.*)", page.read_text(encoding="utf-8"), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in found}


def test_every_page_is_in_the_index() -> None:
    index = (ROOT / "docs" / "README.md").read_text(encoding="utf-8")
    assert [
        p.name for p in PAGES if p.parent.name == "docs" and p.name != "README.md" and f"({p.name})" not in index
    ] == []


@pytest.mark.usefixtures("unswept")
def test_every_printed_line_that_is_explained_is_printed_by_some_code() -> None:
    page = (ROOT / "docs" / "troubleshooting.md").read_text(encoding="utf-8")
    shown = re.findall(r"^\| `([^`]+)` \|", page, re.MULTILINE)
    assert len(shown) > 20
    source = " ".join(
        "".join(
            part.value for part in ast.walk(node) if isinstance(part, ast.Constant) and isinstance(part.value, str)
        )
        for top in ("cli", "formats", "fusion")
        for file in sorted((ROOT / top).rglob("*.py"))
        for node in ast.walk(parsed(file.read_text(encoding="utf-8")))
        if isinstance(node, ast.JoinedStr | ast.Constant)
    )
    assert [line for line in shown if line not in source] == []


# --- docs are tests: every command the README shows runs, and prints what the page says

PAGE = (ROOT / "README.md").read_text()


@pytest.mark.parametrize("name", readme.PAGES)
def test_every_command_on_a_page_prints_what_it_shows(name: str, tmp_path: Path) -> None:
    page = (ROOT / name).read_text(encoding="utf-8")
    assert readme.commands("\n".join(readme.BLOCK.findall(page)))
    assert readme.replayed(page, tmp_path) == page


@pytest.mark.parametrize("name", readme.PYTHON_PAGES)
def test_the_python_on_a_page_runs_in_order_and_prints_what_it_shows(name: str, tmp_path: Path) -> None:
    page = (ROOT / name).read_text(encoding="utf-8")
    assert len(readme.PYTHON.findall(page)) >= 2
    assert readme.replayed_python(page, tmp_path) == page


def test_the_two_set_up_commands_are_the_ones_ci_uses() -> None:
    assert "python3 -m venv .venv && .venv/bin/pip install -e . && .venv/bin/locfuse compare" in PAGE
    # a fresh environment may hold a pip that knows no groups (before 25.1)
    groups = ".venv/bin/python -m pip install -U pip && .venv/bin/pip install --group test"
    assert f"{groups} && .venv/bin/python -m pytest" in PAGE


def test_the_reference_pages_are_what_their_command_writes() -> None:
    """In a process of its own: another test may have registered a sensor."""
    command = [sys.executable, "-m", "benchmarks.reference"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (0, ""), done.stderr


FIRST_PAGE = (Path(__file__).parents[2] / "docs" / "first_sensor.md").read_text(encoding="utf-8")
(PYPROJECT,) = re.findall(r"```toml\n(.*?)```", FIRST_PAGE, re.DOTALL)
MAKE_LOG, SENSOR, READINGS = re.findall(r"```python\n(.*?)```", FIRST_PAGE, re.DOTALL)


def test_its_sensor_gets_a_verdict_and_its_noise(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "pyproject.toml").write_text(PYPROJECT)
    (tmp_path / "locfuse_cable.py").write_text(SENSOR)
    words = ("install", "-q", "--no-deps", "--no-build-isolation", "--target", tmp_path / "installed", tmp_path)
    subprocess.run([sys.executable, "-m", "pip", *map(str, words)], check=True)
    monkeypatch.syspath_prepend(tmp_path / "installed")
    register_installed()
    try:
        _has_a_verdict_and_its_noise(tmp_path)
        assert SOURCES["cable"] == "package locfuse-cable 0.1 (locfuse_cable:Cable)"
    finally:
        del REGISTRY["cable"], SOURCES["cable"]


def _has_a_verdict_and_its_noise(tmp_path: Path) -> None:
    with contextlib.chdir(tmp_path):
        exec(compile(MAKE_LOG, "make_log.py", "exec"), {})
    log, post = tmp_path / "cable.mcap", ("--set", "cable.post=[4, 2]")
    words = ("--sensors", "odometry", "--sensors", "cable", "--no-advice", "--write", "json")
    ok("compare", log, *post, *words, "-o", tmp_path / "out")
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    rows = report["configurations"]
    assert rows["cable"]["position_rmse_m"] < 0.5 * rows["odometry"]["position_rmse_m"]
    assert report["settings"]["cable"]["sigma"] == 0.05
    assert 0.5 < rows["cable"]["sensors"]["cable"]["consistency"]["scale"] < 0.7  # 3 cm are true, 5 are set
    assert "cable.post is not set" in locfuse("info", log).stdout


def test_its_readings_for_the_contract_are_lengths() -> None:
    typed: dict[str, Any] = {"np": np, "ArrayStream": ArrayStream}
    exec(compile(READINGS, "six_sensors.py", "exec"), typed)
    fields = {"pose.position.x": np.array([4.0, 7.0]), "pose.position.y": np.array([2.0, 6.0])}
    stream = typed["cable"](ArrayStream("/truth", "geometry_msgs/msg/PoseStamped", np.array([0, 1]), fields))
    assert stream.columns("data")["data"].tolist() == [0.0, 5.0]


# --- plain words: texts that users read hold none of the riddles of 0.1 (docs, README, help, messages)

BANNED = re.compile(
    r"\b(as told|for news|bought|sure and wrong|(its|their) metre|in force|carried off|cures?|cured|oddit(y|ies)|"
    r"witness(es)?|court|modest|luck|honest(ly|y)?|buys|untold|against odometry)\b",
    re.IGNORECASE,
)
PLAIN_PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").glob("*.md"))]
CODE = [p for top in ("cli", "formats", "fusion", "sample_logs") for p in sorted((ROOT / top).rglob("*.py"))]


def strings(source: str) -> list[tuple[int, str]]:
    """Return every text of a module that a user may read: no docstrings, but those of commands, which are help."""
    tree = parsed(source)
    hidden = {
        id(node.body[0].value)
        for node in ast.walk(tree)
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef)
        and not any("command" in ast.dump(d) for d in getattr(node, "decorator_list", ()))
        and node.body
        and isinstance(node.body[0], ast.Expr)
    }
    return [
        (node.lineno, node.value)
        for node in ast.walk(tree)
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in hidden
    ]


def test_pages_use_plain_words() -> None:
    lines = [(page.name, line) for page in PLAIN_PAGES for line in page.read_text(encoding="utf-8").splitlines()]
    assert [line for line in lines if BANNED.search(line[1])] == []


@pytest.mark.usefixtures("unswept")
def test_messages_and_help_use_plain_words() -> None:
    found = [
        f"{path.relative_to(ROOT)}:{line}: {text}"
        for path in CODE
        for line, text in strings(path.read_text(encoding="utf-8"))
        if BANNED.search(text) and not text.isidentifier()  # a key is no text
    ]
    assert found == []


RAISING = [path for folder in ("cli", "fusion", "formats") for path in sorted((ROOT / folder).rglob("*.py"))]
ERRORS = {"LocfuseError", "UsageError", "NoWheelsError", "UnreadableTopicError"}


def raised(source: str) -> Iterator[ast.Call]:
    """Yield the calls that make one of our errors."""
    for node in ast.walk(parsed(source)):
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id in ERRORS:
            yield node


def text(node: ast.expr | None) -> str:
    """Return a string or f-string as it is written, {} where a value stands."""
    if isinstance(node, ast.JoinedStr):
        return "".join(str(v.value) if isinstance(v, ast.Constant) else "{}" for v in node.values)
    if isinstance(node, ast.BinOp):
        return text(node.left) + text(node.right)
    return str(node.value) if isinstance(node, ast.Constant) else "{}"


def wrong(call: ast.Call) -> str | None:
    """Say what is wrong with an error: a setting that its reader would have to look for in the words."""
    values = {k.arg: k.value for k in call.keywords}
    message, hint = text(call.args[0]) if call.args else "", text(values.get("hint"))
    if "--set " in message.removeprefix("--set "):  # which may be what it is about
        return f"the message tells a setting, which belongs into the hint: {message}"
    if "--set {}" in hint and "fixes" not in values:
        return f"what the hint sets is not among the fixes: {hint}"
    return None


@pytest.mark.usefixtures("unswept")
def test_no_setting_has_to_be_read_out_of_an_error() -> None:
    found = {path: [words for call in raised(path.read_text()) if (words := wrong(call))] for path in RAISING}
    assert {path: words for path, words in found.items() if words} == {}


@pytest.mark.parametrize(
    "source",
    [
        'raise LocfuseError(f"2 topics fit. Choose one with --set lrf.topic={topic}")',
        'raise UsageError("2 topics fit.", hint=f"Choose one with --set {fix}")',
    ],
)
def test_an_error_that_hides_its_setting_is_found(source: str) -> None:
    (call,) = raised(source)
    assert wrong(call)


# --- examples print what they show

NOTEBOOKS = sorted(EXAMPLES.glob("*.ipynb"))


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda p: p.stem)
def test_a_notebook_holds_what_its_cells_print_today(path: Path, tmp_path: Path) -> None:
    notebook = json.loads(path.read_text(encoding="utf-8"))
    now = executed(notebook, tmp_path)
    assert without_figures(now) == without_figures(notebook)
    assert any(
        "image/png" in output.get("data", {}) for cell in now["cells"] for output in cell.get("outputs", ())
    )


def test_the_script_tunes_on_one_log_and_gates_on_another(tmp_path: Path) -> None:
    log = str(write(tmp_path / "drive.mcap", seconds=5.0))
    words = (log, log, "--sensors", "compass", "-o", str(tmp_path / "tuned.toml"))
    command = [sys.executable, str(EXAMPLES / "tune_and_gate.py"), *words]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode in {0, 4}, done.stderr
    assert (done.returncode == 4) == ("FAILED" in done.stdout)
    assert {line.partition(":")[0] for line in done.stdout.splitlines()} == {
        "position_rmse_m",
        "heading_rmse_deg",
        "anees",
    }
    assert "[compass]" in (tmp_path / "tuned.toml").read_text()


def test_every_example_has_a_line_on_the_page_about_python() -> None:
    page = (ROOT / "docs" / "python.md").read_text(encoding="utf-8")
    assert [p.name for p in EXAMPLES.iterdir() if p.is_file() and p.name not in page] == []
