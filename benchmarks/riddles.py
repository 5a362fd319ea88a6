"""A sample of docstrings for a new reader to mark: python -m benchmarks.riddles --seed 7.

It prints first paragraphs drawn at random. A riddle is a paragraph that a student who reads English as a second
language must read twice. The results are in benchmarks/riddles.md.
"""

import ast
import random
from collections.abc import Iterator
from pathlib import Path

import click

ROOT = Path(__file__).parent.parent
FOLDERS = ("cli", "formats", "fusion", "sample_logs")


def docstrings() -> Iterator[tuple[str, str]]:
    """Yield (place, first paragraph) of every docstring of the product."""
    for path in sorted(path for folder in FOLDERS for path in (ROOT / folder).rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef) and (text := ast.get_docstring(node)):
                name = getattr(node, "name", "")
                yield f"{path.relative_to(ROOT)}:{name}", " ".join(text.split("\n\n")[0].split())


@click.command()
@click.option("--seed", default=1, show_default=True)
def main(seed: int) -> None:
    """Print docstrings to mark."""
    for number, (place, text) in enumerate(random.Random(seed).sample(sorted(docstrings()), 100), 1):
        click.echo(f"{number:3} {place}\n    {text}")


if __name__ == "__main__":
    main()
