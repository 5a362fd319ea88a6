"""Notebooks in examples/: run, and updated with today's outputs.

    python -m benchmarks.notebook           exit 1 where a notebook differs from what its cells print today
    python -m benchmarks.notebook --write   put today's outputs into the notebooks

A cell's output is the text that it prints, the value of its last expression, and the figures that it draws.
Jupyter is not needed: a notebook is JSON (nbformat 4). Figures are not compared, since their bytes depend on the
fonts of the machine.
"""

import ast
import base64
import contextlib
import io
import json
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from benchmarks.readme import kept

ROOT = Path(__file__).parent.parent
EXAMPLES = ROOT / "examples"
Outputs = list[dict[str, Any]]


def executed(notebook: dict[str, Any], folder: Path) -> dict[str, Any]:
    """Return a notebook with the outputs of its cells, run in order in `folder`, in one namespace."""
    import matplotlib as mpl

    mpl.use("Agg")
    namespace: dict[str, Any] = {"__name__": "__main__"}
    cells, count = [], 0
    with contextlib.chdir(folder):
        for cell in notebook["cells"]:
            if cell["cell_type"] != "code":
                cells.append(cell)
                continue
            count += 1
            outputs = _run("".join(cell["source"]), namespace, count)
            cells.append({**cell, "execution_count": count, "outputs": outputs})
    return {**notebook, "cells": cells}


def _run(source: str, namespace: dict[str, Any], count: int) -> Outputs:
    import matplotlib.pyplot as plt

    tree = ast.parse(source)
    shown = tree.body and isinstance(tree.body[-1], ast.Expr) and not source.rstrip().endswith(";")
    last = tree.body.pop() if shown else None
    printed, value = io.StringIO(), None
    with contextlib.redirect_stdout(printed):
        exec(compile(tree, "cell", "exec"), namespace)
        if isinstance(last, ast.Expr):
            value = eval(compile(ast.Expression(last.value), "cell", "eval"), namespace)
    outputs: Outputs = []
    if printed.getvalue():
        outputs.append({"output_type": "stream", "name": "stdout", "text": printed.getvalue().splitlines(True)})
    if value is not None:
        result = {"output_type": "execute_result", "execution_count": count, "data": _shown(value), "metadata": {}}
        outputs.append(result)
    for number in plt.get_fignums():
        image = io.BytesIO()
        plt.figure(number).savefig(image, format="png", dpi=80, metadata={"Software": None})
        data = {"image/png": base64.b64encode(image.getvalue()).decode(), "text/plain": ["<Figure>"]}
        outputs.append({"output_type": "display_data", "data": data, "metadata": {}})
    plt.close("all")
    return outputs


def _shown(value: Any) -> dict[str, Any]:
    """Return a value as a notebook's output: text, and HTML if it has any."""
    html = getattr(value, "_repr_html_", None)
    return {"text/plain": repr(value).splitlines(True), **({"text/html": html().splitlines(True)} if html else {})}


def without_figures(notebook: dict[str, Any]) -> list[Any]:
    cells: list[Any] = json.loads(
        json.dumps(notebook["cells"]),
        object_hook=lambda part: {key: "..." if key == "image/png" else part[key] for key in part},
    )
    return cells


def today() -> Iterator[tuple[Path, str]]:
    """Yield each notebook with today's outputs; unchanged if only figures differ."""
    for path in sorted(EXAMPLES.glob("*.ipynb")):
        text = path.read_text(encoding="utf-8")
        with tempfile.TemporaryDirectory() as folder:
            now = executed(json.loads(text), Path(folder))
        same = without_figures(now) == without_figures(json.loads(text))
        yield path, text if same else json.dumps(now, indent=1, ensure_ascii=False) + "\n"


if __name__ == "__main__":
    kept(today(), "--write" in sys.argv)
