"""Run examples/first_steps.ipynb and store what its cells show: text, tables, plots.

Run: python tools/notebook.py    (from the folder of the repository; Jupyter is not needed)
"""

import ast
import base64
import contextlib
import io
import json
from pathlib import Path
from typing import Any

import matplotlib as mpl

NOTEBOOK = Path(__file__).resolve().parents[1] / "examples" / "first_steps.ipynb"


def main() -> None:
    """Run all cells in order and write the notebook with their outputs."""
    mpl.use("Agg")
    notebook = json.loads(NOTEBOOK.read_text(encoding="utf-8"))
    names: dict[str, Any] = {"__name__": "__main__"}
    code = [cell for cell in notebook["cells"] if cell["cell_type"] == "code"]
    for number, cell in enumerate(code, 1):
        cell["execution_count"] = number
        cell["outputs"] = outputs("".join(cell["source"]), names, number)
    NOTEBOOK.write_text(json.dumps(notebook, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")


def outputs(source: str, names: dict[str, Any], number: int) -> list[dict[str, Any]]:
    """Run a cell; what it printed, the value of its last line, and its figures."""
    import matplotlib.pyplot as plt

    tree, last = ast.parse(source), None
    if isinstance(tree.body[-1], ast.Expr) and not source.rstrip().endswith(";"):
        last = ast.Expression(tree.body.pop().value)  # type: ignore[attr-defined]
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed):
        exec(compile(tree, "cell", "exec"), names)
        value = eval(compile(last, "cell", "eval"), names) if last else None
    found: list[dict[str, Any]] = []
    if printed.getvalue():
        found.append({"output_type": "stream", "name": "stdout", "text": printed.getvalue().splitlines(True)})
    figures = list(map(plt.figure, plt.get_fignums()))
    if hasattr(value, "savefig"):
        figures.append(value)
    elif value is not None:
        data = {"text/plain": repr(value).splitlines(True)}
        if hasattr(value, "to_html"):
            data["text/html"] = value.to_html(border=0).splitlines(True)
        found.append({"output_type": "execute_result", "execution_count": number, "metadata": {}, "data": data})
    for figure in figures:
        png = io.BytesIO()
        figure.savefig(png, format="png", dpi=72, bbox_inches="tight")
        data = {"image/png": base64.b64encode(png.getvalue()).decode(), "text/plain": ["<Figure>"]}
        found.append({"output_type": "display_data", "metadata": {}, "data": data})
    plt.close("all")
    return found


if __name__ == "__main__":
    main()
