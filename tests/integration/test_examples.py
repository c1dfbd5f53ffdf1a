"""Every program of examples/ and of the README runs, on a part of the committed clip."""

import json
import re
import runpy
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from short_clip import KEPT, ROOT

EXAMPLES = ROOT / "examples"
FRAMES = 22


@pytest.fixture
def example(short_clip: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[str], dict[str, Any]]:
    """Load a program where data/synthetic/demo is the short clip."""
    monkeypatch.chdir(short_clip)
    return lambda name: runpy.run_path(str(EXAMPLES / name), run_name="example")


def test_every_example_is_tested() -> None:
    found = {path.name for path in EXAMPLES.iterdir() if path.suffix in (".py", ".ipynb")}
    assert found == {"own_matcher.py", "own_tracker.py", "ablation.py", "sweep.py", "first_steps.ipynb"}


def test_own_matcher_finds_the_visitor(example: Any, capsys: pytest.CaptureFixture[str]) -> None:
    example("own_matcher.py")["main"](frames=FRAMES)
    assert "block matching: 1 people" in capsys.readouterr().out


def test_own_tracker_finds_the_visitor(example: Any, capsys: pytest.CaptureFixture[str]) -> None:
    example("own_tracker.py")["main"](frames=FRAMES)
    assert "switches 0" in capsys.readouterr().out


@pytest.mark.slow
def test_ablation_prints_a_row_for_each_variant(example: Any, capsys: pytest.CaptureFixture[str]) -> None:
    example("ablation.py")["main"](frames=FRAMES)
    rows = capsys.readouterr().out.splitlines()
    assert [row[:16].strip() for row in rows] == ["as configured", "half the image", "more foreground", "template"]


def test_sweep_prints_a_row_for_each_value(example: Any, capsys: pytest.CaptureFixture[str]) -> None:
    example("sweep.py")["main"](frames=FRAMES, sizes_px=(160, 320))
    rows = capsys.readouterr().out.splitlines()
    assert [row.split(",")[0] for row in rows] == ["working_px", "160", "320"]


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


def examples() -> list[str]:
    readme = ROOT / "README.md"
    return re.findall(r"^```python\n(.*?)^```", readme.read_text(encoding="utf-8"), re.DOTALL | re.MULTILINE)


def test_the_readme_has_an_example():
    assert examples()


@pytest.mark.parametrize("example", examples())
def test_the_example_prints_people(example, short_clip, monkeypatch, capsys):
    monkeypatch.chdir(short_clip)
    exec(compile(example, "README.md", "exec"), {"__name__": "__main__"})
    rows = [[float(word) for word in line.split()] for line in capsys.readouterr().out.splitlines()]
    assert len(rows) > 5
    assert all(12 <= frame < len(KEPT) and person >= 1 and 0 < y < 9 for frame, person, _, y in rows)
