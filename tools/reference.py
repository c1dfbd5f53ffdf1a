"""Write the generated pages of docs/ from the code; ``--check`` only reports those that are not current.

Run: python tools/reference.py [--check]
"""

from __future__ import annotations

import inspect
import re
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

import planview  # noqa: E402
from calib.params import Params, descriptions, tables_of  # noqa: E402
from planview.api.tools import inside  # noqa: E402
from planview.engine.config import Config  # noqa: E402
from stereo.doctor.hypotheses import BY_KIND  # noqa: E402

GENERATED = "<!-- written by tools/reference.py from the code (make docs) -->\n"
CAUSES = "<!-- causes: written by tools/reference.py from the code (make docs) -->\n"
END_OF_CAUSES = "<!-- end of causes -->\n"
SOURCE = re.compile(r" \((?:Harville|Zhang|OpenCV|Hirschm|section|the paper|our choice|as alpha)[^()]*\)?")
"""Where a default is from, which ``planview params NAME`` prints."""
GROUPS = {
    "What the commands do": ("api",),
    "Tracks and scores": ("evaluation", "trajectories"),
    "The engine and its stages": ("engine", "foreground", "maps", "tracking"),
    "Recordings and pairs": ("stereo",),
    "Poses and errors": ("calib",),
}
"""Rooms of the names under each title."""
EXAMPLES = {
    "What the commands do": """Every command but `demo` is a function of the same name with the same arguments:
`planview run X --out Y --fps 15 --set a.b=1` is `planview.run("X", out="Y", fps=15, config={"a.b": 1})`. What is read
comes first, `out=` is where results go, and `run` is the folder of a run. A `Result` prints, and becomes JSON or
a table; functions are silent: set up `logging` to see what they do, and give `progress=` a function of (done, total) to
draw it.

```python
import planview

print(planview.check("my_recording", quick=True))  # what it holds; without quick, can it be trusted?
tracks = planview.run("my_recording", out="result", config={"foreground.beta": 4}, overwrite=True)
planview.plot(tracks, truth="my_recording")  # a matplotlib figure
planview.export(tracks, "pedpy", out="result/pedpy.txt", overwrite=True)
```
""",
    "Tracks and scores": """```python
import planview

tracks = planview.read_tracks("out/tracks.csv")
confirmed = tracks.to_dataframe().query("state == 'confirmed'")
print(confirmed.groupby("id").height_m.median())
print(planview.evaluate(tracks, "my_recording").to_json()["mota"])
```
""",
    "The engine and its stages": """An engine gives everything about a frame: people, decisions, maps, disparity.

```python
from itertools import islice

import planview

for result in islice(planview.open_engine("my_recording"), 30):
    print(result.frame, [(person.track_id, person.x_m, person.y_m) for person in result.tracks])
```
""",
    "Recordings and pairs": """```python
import planview

recording = planview.open_recording("my_recording")
rectifier = planview.Rectifier(recording.sensor.rig)
matcher = planview.SgbmMatcher(rectifier.geometry)
for frame in recording.at([0, 5]):
    pair = rectifier(*frame.images)
    print(frame.timestamp_s, matcher(pair.left_grey, pair.right_grey).shape)
```
""",
    "Poses and errors": """```python
import planview

try:
    planview.run("nowhere")
except planview.InputError as error:  # bad input or wrong usage, in a sentence; WorkError: the work failed
    print(error)
```
""",
}
"""What stands above the names of a group; tests/integration/test_documents.py runs it."""


def main() -> int:
    """Write or check all pages; the number of pages that are not current."""
    pages = {
        "parameters.md": run_page(),
        "api.md": api_page(),
        "reference.md": reference_page(),
        "troubleshooting.md": with_causes(_current("troubleshooting.md")),
    }
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


def with_causes(page: str) -> str:
    """The page on troubleshooting with every cause that the doctor of recordings tries."""
    before, _, rest = page.partition(CAUSES)
    _, _, after = rest.partition(END_OF_CAUSES)
    rows = []
    for kind, hypotheses in BY_KIND.items():
        names = "; ".join(f"`{hypothesis.name}`" for hypothesis in hypotheses)
        rows.append(f"| {kind} | {names} |")
    table = "\n".join(["", "| tried | if ... |", "|---|---|", *rows])
    return f"{before}{CAUSES}{table}\n{END_OF_CAUSES}{after}"


def run_page() -> str:
    """Every parameter of a run, by its place in ``Config``."""
    head = (
        "Every parameter of a run, by the table that holds it in a configuration file: `--set maps.cell_m=0.03`\n"
        "changes one, `--config FILE.toml` several, `planview run X --print-config` prints all. Ranges, reasons\n"
        "and sources: `planview params NAME`. `planview params --all` also has evaluation, counting and scenes.\n"
    )
    parts, known, places = [], dict[type[Params], str](), dict[str, str]()
    for name, cls in tables_of(Config):
        values = inside(Config(), name)
        parts.append(_again(name, known[cls], values) if cls in known else _section(name, cls, values, places))
        known.setdefault(cls, name)
    return "\n".join([GENERATED, "# Parameters of a run\n", head, *parts])


def _again(name: str, first: str, values: Params) -> str:
    """A table whose parameters have been described: those with other defaults only."""
    other = [
        f"`{f.name} = {f.default}`" for f in descriptions(type(values), values) if f not in descriptions(type(values))
    ]
    return f"## `[{name}]`\n\nAs `[{first}]`, with {', '.join(other) or 'the same defaults'}.\n"


def _section(name: str, cls: type[Params], values: Params, places: dict[str, str]) -> str:
    """A table; ``places`` has the table of each meaning so far, which is not repeated."""
    title = f"`[{name}]`" if name else "Top level"
    rows, again = [], dict[str, list[str]]()
    for field in descriptions(cls, values):
        shown = f"`{field.name} = {field.default}`"
        if field.meaning in places:
            again.setdefault(places[field.meaning], []).append(shown)
        else:
            rows.append(f"- {shown}: {_cell(SOURCE.sub('', field.sentence))}")
            places[field.meaning] = name
    rows += [f"- as in `[{first}]`: {', '.join(shown)}" for first, shown in again.items()]
    about = _cell((cls.__doc__ or "").partition("\n\n")[0])
    return "\n".join([f"## {title}", "", about, "", *rows, *([""] if rows else [])])


def _cell(text: str) -> str:
    return " ".join(text.split()).replace("<", "&lt;").replace("``", "`")


OWN_DEPTH = """## Maps of a depth image of your own

Height and occupancy above the floor take three lines, given depth in metres and a mask of people. Here the camera is
2.7 m above the floor and looks 30 degrees from straight down; the baseline only has to be above 0:

```python
import numpy as np
import planview

depth_m = np.full((480, 640), 3.0, np.float32)  # of your camera; NaN where unknown
people = (depth_m < 2.5).astype(np.uint8)  # of your own detector; 1 where a person is

geometry = planview.RectifiedGeometry(640, 480, 525.0, 525.0, 319.5, 239.5, baseline_m=0.1)
build = planview.ViewBuilder(geometry, planview.SE3.from_rotvec([np.radians(180 + 30), 0, 0], [0, 0, 2.7]))
maps = build(geometry.disparity_metre / depth_m, people)
```

`maps.height` and `maps.occupancy` are arrays, `maps.grid` places their cells on the floor, and `maps.around(x_m, y_m)`
cuts a person's template (T_H, T_O) out of them. Of a tracked frame, `result.template(track)` is the template of a
person, and `result.point_cloud()` gives the points for open3d.
"""


def api_page() -> str:
    """Every public name in a table per group, with its first sentence, below an example."""
    parts = [
        GENERATED,
        "# From Python\n",
        "`import planview` gives these names; each is imported when it is first used. Programs that run are in\n"
        "`examples/` of the repository. `help(planview.run)` and the [reference](reference.md) of the site\n"
        "(`make docs`) have arguments, results and errors.\n",
    ]
    for group, names in _grouped():
        values = {name: getattr(planview, name) for _, name in names}
        for module in [name for name, value in values.items() if inspect.ismodule(value)]:
            home = values.pop(module)
            values |= {f"{module}.{name}": getattr(home, name) for name in home.__all__}
        rows = [f"| `{name}` | {_first_sentence(value)} |" for name, value in values.items()]
        parts += [f"## {group}\n", EXAMPLES[group], "\n".join(["| name | what it is |", "|---|---|", *rows, ""])]
    return "\n".join([*parts, OWN_DEPTH])


def reference_page() -> str:
    """Every public name under its group, to be filled by mkdocstrings when the site is built."""
    parts = [
        GENERATED,
        "# Reference\n",
        "Filled when the site is built (`make docs`); [From Python](api.md) has a table.\n",
    ]
    for group, names in _grouped():
        parts += [f"## {group}\n", *(_directive(module, name) for module, name in names)]
    return "\n".join(parts)


def _grouped() -> list[tuple[str, list[tuple[str, str]]]]:
    stub = (ROOT / "planview" / "__init__.pyi").read_text(encoding="utf-8")
    public = re.findall(r"^from (\S+) import (\w+)", stub, re.MULTILINE)
    groups = [(group, [one for one in public if _room(one[0]) in rooms]) for group, rooms in GROUPS.items()]
    if left := set(public) - {one for _, names in groups for one in names}:
        raise ValueError(f"expected every public name in a group, found {sorted(left)}")
    return groups


def _first_sentence(value: object) -> str:
    """The first sentence of a docstring, without what it raises."""
    paragraph = " ".join((inspect.getdoc(value) or "").partition("\n\n")[0].split())
    return _cell(re.split(r"(?<=[a-z\])`])(?<!e\.g)\.(?:\s|$)", paragraph)[0]).replace("|", r"\|")


def _room(module: str) -> str:
    first, second = f"{module}.".split(".")[:2]
    return second if first == "planview" else first


def _directive(module: str, name: str) -> str:
    value = getattr(planview, name)
    if inspect.ismodule(value):
        return "\n".join(f"::: {getattr(value, one).__module__}.{one}\n" for one in value.__all__)
    home = getattr(value, "__module__", module) if isinstance(value, type) or inspect.isfunction(value) else module
    return f"::: {home}.{name}\n"


if __name__ == "__main__":
    raise SystemExit(main())
