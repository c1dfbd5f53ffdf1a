"""Every program of examples/ and of the README runs, on a part of the committed clip."""

import json
import runpy
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from short_clip import KEPT, ROOT

from tools.typed import blocks

EXAMPLES = ROOT / "examples"
FRAMES = 22


@pytest.fixture
def example(short_clip: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[str], dict[str, Any]]:
    """Load a program where data/synthetic/demo is the short clip."""
    monkeypatch.chdir(short_clip)
    return lambda name: runpy.run_path(str(EXAMPLES / name), run_name="example")


def test_every_example_is_tested() -> None:
    found = {path.name for path in EXAMPLES.iterdir() if path.suffix in (".py", ".ipynb")}
    assert found == {"own_head.py", "own_matcher.py", "own_tracker.py", "sweep.py", "first_steps.ipynb"}


@pytest.mark.parametrize(
    ("name", "options", "rows"),
    [
        ("own_head.py", {}, ["depth up to 6.0 m: mota", "switches 0"]),
        ("own_matcher.py", {}, ["block matching: 1 people"]),
        ("own_tracker.py", {}, ["switches 0"]),
        ("sweep.py", {"sizes_px": (160, 320)}, ["working_px,", "\n160,", "\n320,"]),
    ],
)  # fmt: skip
def test_example_finds_the_visitor_and_prints_its_rows(example, name, options, rows, capsys):
    example(name)["main"](frames=FRAMES, **options)
    printed = capsys.readouterr().out
    assert all(row in printed for row in rows)


def test_cells_of_the_notebook_run_in_order(short_clip: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("pandas", reason="the extra table is not installed")
    import matplotlib as mpl

    mpl.use("Agg")
    monkeypatch.chdir(short_clip)
    notebook = json.loads((EXAMPLES / "first_steps.ipynb").read_text(encoding="utf-8"))
    names: dict[str, Any] = {"__name__": "__main__"}
    for cell in notebook["cells"]:
        if cell["cell_type"] == "code":
            assert cell["outputs"] or cell["execution_count"] == 1, "python tools/notebook.py stores the outputs"
            source = "".join(cell["source"]).replace("frames = 0", f"frames = {FRAMES}")
            exec(compile(source, cell["id"], "exec"), names)
    assert names["scores"]["switches"] == 0
    assert set(names["table"].columns) >= {"frame", "id", "x_m", "y_m", "state"}


def test_the_example_of_the_readme_prints_people(short_clip, monkeypatch, capsys):
    monkeypatch.chdir(short_clip)
    (example,) = (text for language, text in blocks(ROOT / "README.md") if language == "python")
    exec(compile(example, "README.md", "exec"), {"__name__": "__main__"})
    rows = [[float(word) for word in line.split()] for line in capsys.readouterr().out.splitlines()]
    assert len(rows) > 5
    assert all(12 <= frame < len(KEPT) and person >= 1 and 0 < y < 9 for frame, person, _, y in rows)
