"""The project's size: no room outgrows its budget, no tracker gains numbers, and no class name means two things."""

import ast
import warnings
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import pytest

from tools.budget import BUDGET, ROOT, files_of, measured, rooms, size_of_text

PACKAGES = ("calib", "stereo", "planview", "benchmarks")


def allowed(name: str, size: float, target: float, ceiling: float) -> float:
    """The larger of target and ceiling; warns above the target."""
    if size > target:
        warnings.warn(f"{name}: {size}, {size - target:.6g} above its target of {target}", stacklevel=2)
    return max(target, ceiling)


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
    """Whether an expression is made of numbers, or of numbers and other constants; ``range`` numbers names."""
    try:
        parts = ast.literal_eval(value)
    except ValueError:
        numbers = [n for n in ast.walk(value) if isinstance(n, ast.Constant) and isinstance(n.value, int | float)]
        of = ast.unparse(value.func) if isinstance(value, ast.Call) else ""
        return isinstance(value, ast.BinOp | ast.UnaryOp | ast.Call) and of != "range" and bool(numbers)
    parts = parts if isinstance(parts, tuple) else (parts,)
    return all(isinstance(part, int | float) and not isinstance(part, bool) for part in parts)


def classes() -> Iterator[tuple[str, str]]:
    """Name and module of every class."""
    for path in (path for package in PACKAGES for path in (ROOT / package).rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ClassDef):
                yield node.name, path.relative_to(ROOT).as_posix()


def test_every_room_has_a_budget():
    assert sorted(BUDGET["tokens"]) == sorted(BUDGET["density"]) == sorted(["total", "tests", *rooms()])


@pytest.fixture(scope="module")
def sizes() -> dict[str, dict[str, float]]:
    return measured()


@pytest.mark.parametrize("table", ["tokens", "density", "per 1000 lines"])
def test_nothing_outgrows_its_budget(table, sizes):
    budgets = BUDGET[table]
    too_large = {name: size for name, size in sizes[table].items() if size > allowed(name, size, **budgets[name])}
    assert not too_large


def test_size_leaves_out_what_is_no_program():
    size = size_of_text('"""Text."""\n\n# comment\na, b = 1, 2\nc = a if b else 0\n')
    assert (size.tokens, size.code_lines) == (7 + 7, 2)
    assert (size.double_assignments, size.conditionals, size.comprehensions) == (1, 1, 0)


@pytest.mark.parametrize("tracker", sorted(set(BUDGET["numbers"]) - {"target"}))
def test_no_tracker_has_more_numbers_than_it_may(tracker):
    numbers = sum(map(numbers_in, files_of(f"planview/tracking/{tracker}")))
    name, budget = f"numbers of {tracker}", BUDGET["numbers"]
    assert 0 < numbers <= allowed(name, numbers, budget["target"], budget[tracker])


def test_a_class_name_means_one_thing():
    count = Counter(name for name, _ in classes())
    twice = {name: [where for other, where in classes() if other == name] for name, n in count.items() if n > 1}
    assert set(twice) <= set(BUDGET["classes"]["defined_twice"]), twice
