"""Every program of examples/ and of the README runs, on a part of the committed clip."""

import json
import runpy
from collections.abc import Callable
from typing import Any

import pytest
from short_clip import ROOT

from tools.typed import blocks

EXAMPLES = ROOT / "examples"
FRAMES = 22


@pytest.fixture
def example(short_clip, monkeypatch) -> Callable[[str], dict[str, Any]]:
    """Load a program where data/synthetic/demo is the short clip."""
    monkeypatch.chdir(short_clip)
    return lambda name: runpy.run_path(str(EXAMPLES / name), run_name="example")


def test_every_example_is_tested():
    found = {path.name for path in EXAMPLES.iterdir() if path.suffix in (".py", ".ipynb")}
    assert found == {"own_sensor.py", "own_matcher.py", "own_tracker.py", "sweep.py", "first_steps.ipynb"}


@pytest.mark.parametrize(
    ("name", "options", "rows"),
    [
        ("own_sensor.py", {}, ["depth up to 6.0 m: mota", "switches 0"]),
        ("own_matcher.py", {}, ["block matching: 1 people"]),
        ("own_tracker.py", {}, ["switches 0"]),
        ("sweep.py", {"sizes_px": (160, 320)}, ["working_px,", "\n160,", "\n320,"]),
    ],
)  # fmt: skip
def test_example_finds_the_visitor(example, name, options, rows, capsys):
    example(name)["main"](frames=FRAMES, **options)
    printed = capsys.readouterr().out
    assert all(row in printed for row in rows)


def notebook() -> list[str]:
    """The code of the notebook, by cell."""
    cells = json.loads((EXAMPLES / "first_steps.ipynb").read_text(encoding="utf-8"))["cells"]
    assert all(cell["outputs"] or cell["execution_count"] in (1, 3) for cell in cells if cell["cell_type"] == "code")
    return ["".join(cell["source"]) for cell in cells if cell["cell_type"] == "code"]


def test_cells_of_the_notebook_run_in_order(short_clip, monkeypatch):
    import matplotlib as mpl

    mpl.use("Agg")
    monkeypatch.chdir(short_clip)
    names = {"__name__": "__main__"}
    for number, source in enumerate(notebook()):
        exec(compile(source, f"cell {number}", "exec"), names)
    assert names["scores"].switches == 0
    assert names["exported"].values["rows"] > 20
    assert all((short_clip / "out" / "first" / name).is_file() for name in ("paths.png", "pedpy.txt", "report.html"))


def test_the_readme_shows_the_twelve_lines_of_the_notebook():
    (example,) = (text for language, text in blocks(ROOT / "README.md") if language == "python")
    lines = [line for line in example.splitlines() if line]
    shown = [line for source in notebook()[1:7] for line in source.splitlines() if line and line != "figure"]
    assert lines == shown
    assert len(lines) <= 12
