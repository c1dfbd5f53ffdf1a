"""Write the generated pages of docs/ from the code; ``--check`` only reports those that are not current.

Run: python tools/reference.py [--check]
"""

from __future__ import annotations

import ast
import inspect
import itertools
import sys
import textwrap
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from pkgutil import walk_packages
from typing import Any

from pydantic import BaseModel
from pydantic_core import PydanticUndefined

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

import planview  # noqa: E402
from calib.params import Params  # noqa: E402
from planview.engine.config import Config  # noqa: E402

GENERATED = "<!-- written by tools/reference.py from the code (make docs) -->\n"
PACKAGES = ("calib", "stereo", "planview")
BOUNDS = {"gt": "above {}", "ge": "from {}", "lt": "below {}", "le": "to {}"}
GROUPS = {
    "Run and score": ("output", "evaluation", "trajectories"),
    "The engine and its stages": ("engine", "foreground", "maps", "tracking"),
    "Recordings and pairs": ("stereo",),
}


def field_docs(table: type[BaseModel]) -> dict[str, str]:
    """The docstring beneath each field of a table, from its source.

    pydantic could collect them when a class is made (``use_attribute_docstrings``); reading the source of fifty tables
    takes half a second of every start.
    """
    found = {}
    for base in reversed([c for c in table.__mro__ if c is not BaseModel and issubclass(c, BaseModel)]):
        body = ast.parse(textwrap.dedent(inspect.getsource(base))).body[0].body  # type: ignore[attr-defined]
        for field, text in itertools.pairwise(body):
            if isinstance(field, ast.AnnAssign) and isinstance(text, ast.Expr) and isinstance(text.value, ast.Constant):
                found[ast.unparse(field.target)] = inspect.cleandoc(str(text.value.value))
    return found


def main() -> int:
    """Write or check all pages; the number of pages that are not current."""
    pages = {"parameters.md": run_page(), "parameters-other.md": other_page(), "api.md": api_page()}
    stale = [name for name, text in pages.items() if _current(name) != text]
    if "--check" not in sys.argv:
        for name in stale:
            (ROOT / "docs" / name).write_text(pages[name], encoding="utf-8")
        return 0
    for name in stale:
        print(f"docs/{name}: expected what tools/reference.py writes; run make docs", file=sys.stderr)
    return len(stale)


def _current(name: str) -> str:
    path = ROOT / "docs" / name
    return path.read_text(encoding="utf-8") if path.is_file() else ""


def run_page() -> str:
    """Every parameter of a run, by its place in ``Config``."""
    head = (
        "Every parameter of a run, by the table that holds it in a configuration file: `--set maps.cell_m=0.03`\n"
        "changes one, `--config FILE.toml` several. A name that does not exist and a value out of range are refused.\n"
        "Parameters of evaluation, calibration and rendered scenes are on [another page](parameters-other.md).\n"
    )
    tables = _tables(Config, "")
    parts = [_section("##", f"`[{name}]`" if name else "Top level", cls) for name, cls in tables]
    return "\n".join([GENERATED, "# Parameters of a run\n", head, *parts])


def other_page() -> str:
    """All other parameter tables, by their module."""
    of_a_run = {cls for _, cls in _tables(Config, "")}
    others = sorted({cls for cls in _all_tables() if cls not in of_a_run}, key=_full_name)
    head = "Of evaluation, refinement, counting, calibration and rendered scenes, by the class that holds them.\n"
    parts = [_section("##", f"`{_full_name(cls)}`", cls) for cls in others]
    return "\n".join([GENERATED, "# Other parameters\n", head, *parts])


def _full_name(cls: type) -> str:
    return f"{cls.__module__}.{cls.__name__}"


def _tables(cls: type[Params], name: str) -> Iterator[tuple[str, type[Params]]]:
    yield name, cls
    for field, info in cls.model_fields.items():
        if isinstance(info.annotation, type) and issubclass(info.annotation, Params):
            yield from _tables(info.annotation, f"{name}.{field}".lstrip("."))


def _all_tables() -> Iterator[type[Params]]:
    for package in PACKAGES:
        for module in walk_packages([str(ROOT / package)], f"{package}."):
            if ".bench" not in module.name and ".browser" not in module.name and "__main__" not in module.name:
                for value in vars(import_module(module.name)).values():
                    is_table = isinstance(value, type) and issubclass(value, Params) and value is not Params
                    if is_table and value.__module__ == module.name and not value.__name__.startswith("_"):
                        yield value


def _section(level: str, title: str, cls: type[Params]) -> str:
    meanings = field_docs(cls)
    rows = [
        f"| `{name}` | {_default(info)} | {_range(info)} | {_cell(meanings.get(name, ''))} |"
        for name, info in cls.model_fields.items()
        if not (isinstance(info.annotation, type) and issubclass(info.annotation, Params))
    ]
    head = ["", "| name | default | range | meaning and source |", "|---|---|---|---|"] if rows else []
    return "\n".join([f"{level} {title}", "", inspect.cleandoc(cls.__doc__ or ""), *head, *rows, ""])


def _default(info: Any) -> str:
    if info.default is PydanticUndefined:
        return "required" if info.default_factory is None else f"`{_plain(info.default_factory())}`"
    return f"`{_plain(info.default)}`"


def _plain(value: object) -> str:
    return value if isinstance(value, str) and value else repr(value)


def _range(info: Any) -> str:
    choices = getattr(info.annotation, "__args__", ())
    if "Literal" in str(info.annotation) and choices:
        return ", ".join(f"`{c}`" for c in choices if isinstance(c, str))
    found = [BOUNDS[key].format(f"{getattr(m, key):g}") for m in info.metadata for key in BOUNDS if hasattr(m, key)]
    return " ".join(found)


def _cell(text: str) -> str:
    return " ".join(text.split()).replace("|", "\\|").replace("<", "&lt;").replace("``", "`")


OWN_DEPTH = """## Maps of a depth image of your own

Height and occupancy above the floor take three lines, given depth in metres and a mask of people. Here the camera is
2.7 m above the floor and looks 30 degrees from straight down; the baseline only has to be above 0:

```python
import numpy as np
import planview

depth_m = np.full((480, 640), 3.0, np.float32)  # of your camera; NaN where unknown
people = (depth_m < 2.5).astype(np.uint8)  # of your own detector; 1 where a person is

geometry = planview.RectifiedGeometry(640, 480, 525.0, 525.0, 319.5, 239.5, baseline_m=0.1)
build = planview.MapBuilder(geometry, planview.SE3.from_rotvec([np.radians(180 + 30), 0, 0], [0, 0, 2.7]))
maps = build(geometry.disparity_metre / depth_m, people)
```

`maps.height` and `maps.occupancy` are arrays, `maps.grid` places their cells on the floor, and `maps.around(x_m, y_m)`
cuts a person's template (T_H, T_O) out of them. Of a tracked frame, `result.template(track)` is the template of a
person, and `result.point_cloud()` gives the points for open3d.
"""


def api_page() -> str:
    """Every public name under its group, to be filled by mkdocstrings when the site is built."""
    parts = [
        GENERATED,
        "# From Python\n",
        "`import planview` gives these names; each is imported when it is first used. Programs that run are in "
        "`examples/` of the repository.\n",
        OWN_DEPTH,
    ]
    for group, rooms in GROUPS.items():
        parts.append(f"## {group}\n")
        parts += [_directive(module, name) for module, name in _public() if _room(module) in rooms]
    return "\n".join(parts)


def _public() -> list[tuple[str, str]]:
    tree = ast.parse((ROOT / "planview" / "__init__.py").read_text(encoding="utf-8"))
    assigned = [n for n in tree.body if isinstance(n, ast.Assign)]
    homes = next(n.value for n in assigned if getattr(n.targets[0], "id", "") == "_HOMES")
    public = [(module, name) for module, names in ast.literal_eval(homes).items() for name in names]
    missing = {name for _, name in public} ^ set(planview.__all__)
    if missing:
        raise SystemExit(f"planview/__init__.py: expected the same names in _HOMES and __all__, found {missing} in one")
    return sorted(public, key=lambda entry: entry[1] not in ("run", "evaluate", "open_engine"))


def _room(module: str) -> str:
    first, second = module.split(".")[:2]
    return second if first == "planview" else first


def _directive(module: str, name: str) -> str:
    value = getattr(planview, name)
    home = getattr(value, "__module__", module) if isinstance(value, type) or inspect.isfunction(value) else module
    return f"::: {home}.{name}\n"


if __name__ == "__main__":
    raise SystemExit(main())
