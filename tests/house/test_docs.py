"""What a page tells people to type exists: commands, their options, keys of robot.toml, benchmarks."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import click
import msgspec
import pytest

from locfuse.cli.analysis.robot_tables import table_types
from locfuse.cli.main import COMMANDS, locfuse
from locfuse.sample_logs.scenario import Scenario

ROOT = Path(__file__).parents[2]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
SCENARIO = {f.name: getattr(f.type, "__struct_fields__", ()) for f in msgspec.structs.fields(Scenario)}
KEYS = {name: {*table.__struct_fields__, *SCENARIO.get(name, ())} for name, table in table_types().items()}
OPTION = re.compile(r"(?<![\w-])(--?[a-z][a-z-]*)")


def typed(page: Path, what: str) -> Iterator[str]:
    """Lines to type that begin with `what`, and the same in backticks, without comments."""
    for line in page.read_text(encoding="utf-8").splitlines():
        plain = re.match(rf"(?: {{4}}|\$ )\s*(?:\w+=\S+ )*({what} .*)", line)
        for found in [plain[1]] if plain else re.findall(rf"`({what} [^`]+)`", line):
            yield found.split(" #")[0].split(" > ")[0]


def options(command: click.Command) -> set[str]:
    return {o for p in command.params for o in (*p.opts, *p.secondary_opts)} | {"-h", "--help"}


@pytest.mark.parametrize("page", PAGES, ids=lambda p: p.name)
def test_every_command_and_its_options_exist(page: Path) -> None:
    with click.Context(locfuse) as context:
        for line in typed(page, "locfuse"):
            name = line.split()[1]
            if not name.isalpha() or name.isupper():
                continue  # locfuse --help
            assert name in COMMANDS, line
            command = locfuse.get_command(context, name)
            assert command is not None
            assert set(OPTION.findall(line)) <= options(command), line


@pytest.mark.parametrize("page", PAGES, ids=lambda p: p.name)
def test_every_key_of_robot_toml_exists(page: Path) -> None:
    """`table.key` in backticks and after --set, of a robot.toml or a scenario."""
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
def test_no_sentence_is_long(page: Path) -> None:
    """A part before a colon or a semicolon can be read by itself, so it counts by itself."""
    assert [s for s in sentences(page) if len(s.split()) > MAX_WORDS] == []


def slugs(page: Path) -> set[str]:
    """Anchors of a page's headings, as GitHub makes them."""
    found = re.findall(r"^#+ (.*)", page.read_text(encoding="utf-8"), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in found}


@pytest.mark.parametrize("page", PROSE, ids=lambda p: f"{p.parent.name}-{p.name}")
def test_every_link_to_a_heading_leads_to_one(page: Path) -> None:
    links = re.findall(r"\]\(([\w./]*)#([\w-]+)\)", page.read_text(encoding="utf-8"))
    assert [f"{to}#{at}" for to, at in links if at not in slugs(page.parent / to if to else page)] == []


def test_every_page_is_in_the_index() -> None:
    index = (ROOT / "docs" / "README.md").read_text(encoding="utf-8")
    assert [
        p.name for p in PAGES if p.parent.name == "docs" and p.name != "README.md" and f"({p.name})" not in index
    ] == []


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
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8")))
        if isinstance(node, ast.JoinedStr | ast.Constant)
    )
    assert [line for line in shown if line not in source] == []
