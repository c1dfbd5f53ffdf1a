"""The project's size: no room outgrows ``budget.toml``, no tracker its numbers, and no class name means two things."""

import ast
import tomllib
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = ("calib", "stereo", "planview", "benchmarks")
BUDGET: dict[str, Any] = tomllib.loads((ROOT / "budget.toml").read_text(encoding="utf-8"))


def files_of(room: str) -> list[Path]:
    """Of a room: all below its folder; of ``planview/*`` those beside the rooms."""
    folder = ROOT / room.removesuffix("/*")
    return sorted(folder.glob("*.py") if room.endswith("/*") else folder.rglob("*.py"))


def rooms() -> list[str]:
    """All rooms there are: the packages, and the folders of planview."""
    inside = sorted(path.name for path in (ROOT / "planview").iterdir() if (path / "__init__.py").is_file())
    return ["calib", "stereo", "benchmarks", "planview/*", *(f"planview/{name}" for name in inside)]


def size_of(files: list[Path]) -> tuple[int, int]:
    """Lines and files."""
    return sum(len(path.read_text(encoding="utf-8").splitlines()) for path in files), len(files)


def numbers_in(path: Path) -> int:
    """Fields of parameter classes and numeric constants of a module."""
    count = 0
    for node in ast.parse(path.read_text(encoding="utf-8")).body:
        if isinstance(node, ast.ClassDef) and any(ast.unparse(base).endswith("Params") for base in node.bases):
            count += sum(isinstance(field, ast.AnnAssign) for field in node.body)
        elif isinstance(node, ast.Assign | ast.AnnAssign) and node.value is not None:
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            names = [name for target in targets for name in ast.walk(target) if isinstance(name, ast.Name)]
            if all(name.id.isupper() for name in names) and _is_numeric(node.value):
                count += len(names)
    return count


def _is_numeric(value: ast.expr) -> bool:
    """Whether an expression is made of numbers, or of numbers and other constants."""
    try:
        parts = ast.literal_eval(value)
    except ValueError:
        numbers = [n for n in ast.walk(value) if isinstance(n, ast.Constant) and isinstance(n.value, int | float)]
        return isinstance(value, ast.BinOp | ast.UnaryOp | ast.Call) and bool(numbers)
    parts = parts if isinstance(parts, tuple) else (parts,)
    return all(isinstance(part, int | float) and not isinstance(part, bool) for part in parts)


def classes() -> Iterator[tuple[str, str]]:
    """Name and module of every class."""
    for path in (path for package in PACKAGES for path in (ROOT / package).rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ClassDef):
                yield node.name, path.relative_to(ROOT).as_posix()


def test_every_room_has_a_budget() -> None:
    assert sorted(BUDGET["rooms"]) == sorted(rooms())


@pytest.mark.parametrize("room", rooms())
def test_no_room_outgrows_its_budget(room: str) -> None:
    lines, files = size_of(files_of(room))
    allowed = BUDGET["rooms"].get(room, {"lines": 0, "files": 0})
    assert lines <= allowed["lines"] and files <= allowed["files"], (
        f"{room}: {lines} lines in {files} files, budget.toml allows {allowed['lines']} in {allowed['files']}: "
        "make it smaller, or raise the budget and say in the commit why"
    )


def test_the_project_is_no_larger_than_it_may_be() -> None:
    lines, files = size_of([path for room in rooms() for path in files_of(room)])
    assert lines <= BUDGET["total"]["lines"] and files <= BUDGET["total"]["files"], (lines, files)


@pytest.mark.parametrize("tracker", sorted(BUDGET["numbers"]))
def test_no_tracker_has_more_numbers_than_it_may(tracker: str) -> None:
    numbers = sum(map(numbers_in, files_of(f"planview/tracking/{tracker}")))
    assert 0 < numbers <= BUDGET["numbers"][tracker], f"{tracker}: {numbers} parameters and named numbers"


def test_a_class_name_means_one_thing() -> None:
    count = Counter(name for name, _ in classes())
    twice = {name: [where for other, where in classes() if other == name] for name, n in count.items() if n > 1}
    assert set(twice) <= set(BUDGET["classes"]["defined_twice"]), twice
