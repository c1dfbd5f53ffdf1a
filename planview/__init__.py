"""Stereo plan-view people tracking; the public API, imported on first use.

```python
import planview

for result in planview.open_engine("data/synthetic/demo"):
    for person in result.tracks:
        print(result.timestamp_s, person.track_id, person.x_m, person.y_m)

tracks = planview.run("data/synthetic/demo", "out")  # a whole run: tracks.csv, run.json, report.html
print(tracks.to_dataframe().groupby("id").height_m.median())
print(planview.evaluate(tracks, "data/synthetic/demo/truth.csv").to_json()["mota"])
```

``docs/api`` has every name, ``examples/`` programs that run.
"""

from importlib import import_module, metadata
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    __version__: str

    from calib.errors import InputError, WorkError
    from calib.pose import SE3
    from planview.engine.config import Config, load_config
    from planview.engine.engine import Engine, FrameResult
    from planview.engine.one_camera import one_camera_engine
    from planview.engine.open import open_engine
    from planview.engine.setup import set_up
    from planview.engine.stereo import stereo_engine
    from planview.evaluation.evaluate import EvaluationParams, evaluate_tracks
    from planview.evaluation.result import Evaluation
    from planview.foreground.mixture import Foreground
    from planview.maps.builder import MapBuilder
    from planview.output.script import count_tracks, evaluate, load_rules, run
    from planview.tracking.base import Decision, Observation, Tracker, TrackerDebug
    from planview.tracking.ellipse_particle.tracker import EllipseParticleTracker
    from planview.tracking.human_model.tracker import HumanModelTracker
    from planview.tracking.joint import JointTracker
    from planview.tracking.template import TemplateTracker
    from planview.trajectories.state import TrackState
    from planview.trajectories.table import Trajectories, TrajectoryCollector, read_tracks, read_truth
    from stereo.depth import RectifiedGeometry
    from stereo.matcher import Matcher, SgbmMatcher
    from stereo.readers import OpenOptions, open_recording, open_video
    from stereo.rectify import Rectifier

_HOMES = {
    "calib.errors": ("InputError", "WorkError"),
    "calib.pose": ("SE3",),
    "stereo.depth": ("RectifiedGeometry",),
    "planview.evaluation.evaluate": ("EvaluationParams", "evaluate_tracks"),
    "planview.evaluation.result": ("Evaluation",),
    "planview.foreground.mixture": ("Foreground",),
    "planview.maps.builder": ("MapBuilder",),
    "planview.engine.config": ("Config", "load_config"),
    "planview.engine.engine": ("Engine", "FrameResult"),
    "planview.engine.one_camera": ("one_camera_engine",),
    "planview.engine.open": ("open_engine",),
    "planview.engine.setup": ("set_up",),
    "planview.engine.stereo": ("stereo_engine",),
    "planview.output.script": ("count_tracks", "evaluate", "load_rules", "run"),
    "planview.tracking.base": ("Decision", "Observation", "Tracker", "TrackerDebug"),
    "planview.tracking.ellipse_particle.tracker": ("EllipseParticleTracker",),
    "planview.tracking.human_model.tracker": ("HumanModelTracker",),
    "planview.tracking.template": ("TemplateTracker",),
    "planview.tracking.joint": ("JointTracker",),
    "planview.trajectories.state": ("TrackState",),
    "planview.trajectories.table": ("Trajectories", "TrajectoryCollector", "read_tracks", "read_truth"),
    "stereo.matcher": ("Matcher", "SgbmMatcher"),
    "stereo.readers": ("OpenOptions", "open_recording", "open_video"),
    "stereo.rectify": ("Rectifier",),
}
_MODULE_OF = {name: module for module, names in _HOMES.items() for name in names}

__all__ = [
    "SE3",
    "Config",
    "Decision",
    "EllipseParticleTracker",
    "Engine",
    "Evaluation",
    "EvaluationParams",
    "Foreground",
    "FrameResult",
    "HumanModelTracker",
    "InputError",
    "JointTracker",
    "MapBuilder",
    "Matcher",
    "Observation",
    "OpenOptions",
    "RectifiedGeometry",
    "Rectifier",
    "SgbmMatcher",
    "TemplateTracker",
    "TrackState",
    "Tracker",
    "TrackerDebug",
    "Trajectories",
    "TrajectoryCollector",
    "WorkError",
    "count_tracks",
    "evaluate",
    "evaluate_tracks",
    "load_config",
    "load_rules",
    "one_camera_engine",
    "open_engine",
    "open_recording",
    "open_video",
    "read_tracks",
    "read_truth",
    "run",
    "set_up",
    "stereo_engine",
]


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
        return metadata.version("planview")
    if name not in _MODULE_OF:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(import_module(_MODULE_OF[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
