"""Stereo plan-view people tracking; the public API, imported on first use.

```python
import planview

for result in planview.open_engine("data/synthetic/demo"):
    for person in result.tracks:
        print(result.timestamp_s, person.track_id, person.x_m, person.y_m)

tracks = planview.run("data/synthetic/demo", out="out")  # a whole run: tracks.csv, run.json, report.html
print(tracks.to_dataframe().groupby("id").height_m.median())
print(planview.evaluate(tracks, "data/synthetic/demo/truth.csv").mota)
```

``docs/api`` has every name, ``examples/`` programs that run.
"""

import re
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any

# The stub next to this file has every name once, for type checkers and for us.
_STUB = Path(__file__).with_suffix(".pyi").read_text(encoding="utf-8")
_HOME_OF = {name: home for home, name in re.findall(r"^from (\S+) import (\w+)", _STUB, re.MULTILINE)}
__all__ = sorted(_HOME_OF)  # noqa: PLE0605


def _refuse_hidden() -> None:
    """Python takes a user's calib.py or stereo.py next to the script for ours of the same name."""
    for name in ("calib", "stereo"):
        spec = find_spec(name)
        places = (spec.submodule_search_locations if spec else None) or ()
        if not any((Path(place) / "py.typed").is_file() for place in places):
            found = spec.origin if spec else "nothing"
            raise ImportError(
                f"planview needs its own package {name!r}, and Python finds {found} instead: "
                "rename that file, or run the script from another folder"
            )


_refuse_hidden()


def __getattr__(name: str) -> Any:
    if name == "__version__":
        from importlib.metadata import version  # brings the mail package

        return version("planview")
    if name not in _HOME_OF:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    home = import_module(_HOME_OF[name])
    # What is no name of a module is a module in a package.
    value = getattr(home, name) if hasattr(home, name) else import_module(f"{home.__name__}.{name}")
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return [*__all__, "__version__"]
