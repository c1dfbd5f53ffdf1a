"""How true what tracks say of themselves is: which way people face, that somebody is there, where, and how fast."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
import pandas
from cyclopts import Parameter

from benchmarks.options import BenchOptions, Row, rendered, report
from benchmarks.passes import Pass, run_pass
from benchmarks.random_scenes.generator import scene_of_table
from calib.io import load_toml
from calib.types import F64
from planview.evaluation.evaluate import velocities
from planview.evaluation.metrics import build_sequence, clear_scores, floor_similarity
from planview.synthetic.assets import SCENES
from planview.synthetic.camera import mount_pose, rectified_world, stereo_rig
from planview.synthetic.people import Cast
from planview.synthetic.scene import Scene
from planview.synthetic.texture import Palette
from planview.trajectories.state import SURE_FACING
from planview.trajectories.table import Trajectories, read_tracks, read_truth, rows_by_id, table_of

RECORDINGS = (("stopping", 15.0), ("running", 15.0), ("running", 30.0))
"""Tables of ``data/synthetic/claims`` and the frames per second at which they are rendered."""
GATE_M = 0.5
"""A row shows somebody who is nearer than this [m]: as tracks are scored."""
WALKING_MPS, RUNNING_MPS = 0.3, 2.0
"""Speeds from which somebody walks, and runs [m/s]."""
VISIBLE_MIN = 0.1
"""Unoccluded share below which a place is a guess and its error is not counted."""
Bins = Mapping[str, tuple[float, float]]
STOPPED: Bins = {
    "walking": (0.0, 1e-9), "stopped up to 2 s ago": (1e-9, 2.0), "2 to 5 s": (2.0, 5.0), "5 to 12 s": (5.0, 12.0),
    "longer": (12.0, np.inf),
}  # fmt: skip
CONFIDENCES: Bins = {"below 0.5": (0.0, 0.5), "0.5 to 0.9": (0.5, 0.9), "from 0.9": (0.9, 1.1)}
DISTANCES: Bins = {f"{a} to {b} m away": (a, b) for a, b in ((0, 2), (2, 3), (3, 4), (4, 5), (5, 12))}
VISIBILITIES: Bins = {f"{a:g} to {b:g} visible": (a, b) for a, b in ((0.1, 0.5), (0.5, 0.75), (0.75, 0.9), (0.9, 1.01))}


@Parameter(name="*")
@dataclass(frozen=True)
class ClaimOptions(BenchOptions):
    """Which recordings are rendered, and how they are tracked."""

    seed: Annotated[Sequence[int], Parameter(negative="")] = (1,)
    """Seeds of the scenes: those below 100 are for tuning, each of the others judges once."""


def claims(*, options: ClaimOptions | None = None) -> None:
    """Compare what tracks say of themselves with the truth of rendered scenes.

    Prints how often people are back to front next to what facing_confidence says, how many rows show somebody next to
    confidence, the errors of places over std_m (rms of both axes), and the speeds and ids of runners.

    Example: python -m benchmarks claims --seed 1
    """
    o = options or ClaimOptions()
    stopping, runners = list[pandas.DataFrame](), list[Row]()
    for seed in o.seed:
        for name, fps in RECORDINGS:
            table = load_toml(SCENES / "claims" / f"{name}.toml", "a challenge in TOML") | {"fps": fps}
            scene = scene_of_table("suite", table, seed, name).scene
            recording = rendered(scene, f"claims-{name}-{seed}-{fps:g}", o.cache_folder)
            folder = run_pass(Pass(recording, o.cache_folder, o.settings()))
            truth = everybody(scene, read_truth(recording / "truth.csv"))
            rows = compared(read_tracks(folder / "tracks.csv"), truth, 1.0 / fps)
            if name == "running":
                runners += speeds(rows, {"recording": f"running, seed {seed}, {fps:g} per second"})
            else:
                stopping.append(rows.assign(scene=seed))
    every = pandas.concat(stopping)
    report(
        o.json_output, facing=facing_table(every), confidence=confidence_table(every),
        place=deviation_table(every), runners=runners,
    )  # fmt: skip


def everybody(scene: Scene, shown: Trajectories) -> Trajectories:
    """The truth of a scene with those who are hidden or beyond the image (``visible`` 0) as well: somebody who is
    predicted there may be there."""
    assert scene.rig is not None  # of every table of claims
    cast, room = Cast(scene, Palette()), rectified_world(stereo_rig(scene.rig), mount_pose(scene.rig))[1]
    rows = []
    for frame in range(scene.n_frames):
        for actor in cast.at(frame / scene.fps):
            if actor.body is not None:
                (x_m, y_m, _), ahead = room @ actor.body.head, room.rotation @ actor.body.chest
                facing_deg = np.rad2deg(np.arctan2(ahead[1], ahead[0]))
                rows.append((frame, actor.person, x_m, y_m, actor.body.top_m, facing_deg))
    whole = pandas.DataFrame(rows, columns=["frame", "id", "x_m", "y_m", "height_m", "facing_deg"])
    seen = pandas.DataFrame({"frame": shown.frame, "id": shown.track_id, "visible": shown.visible})
    return table_of(whole.merge(seen, "left", ["frame", "id"]).fillna({"visible": 0.0}), "everybody")


def compared(tracks: Trajectories, truth: Trajectories, frame_s: float) -> pandas.DataFrame:
    """Every row of tracks with what is true of the person who is nearest; NaN where nobody is."""
    frame = tracks.to_dataframe()
    t, k = clear_scores(build_sequence(truth, tracks, floor_similarity(GATE_M))).matches.T
    speed = np.hypot(*velocities(truth, frame_s).T)
    true = {
        "true_id": truth.track_id, "true_x_m": truth.x_m, "true_y_m": truth.y_m, "true_mps": speed,
        "true_facing_deg": truth.facing_deg, "visible": truth.visible, "stopped_s": stopped_s(truth, speed, frame_s),
    }  # fmt: skip
    for name, values in true.items():
        column = np.full(len(frame), np.nan)
        column[k] = values[t]
        frame[name] = column
    return frame


def stopped_s(truth: Trajectories, speed_mps: F64, frame_s: float) -> F64:
    """(N,) time since a person last walked [s]."""
    since = np.zeros(len(truth))
    for _, rows in rows_by_id(truth.track_id):
        walked = np.where(speed_mps[rows] >= WALKING_MPS, truth.frame[rows], truth.frame[rows[0]] - 1)
        since[rows] = (truth.frame[rows] - np.maximum.accumulate(walked)) * frame_s
    return since


def facing_table(rows: pandas.DataFrame) -> list[Row]:
    """By how long ago people stopped: how many are not back to front, what is said, and the same of the sure ones."""
    rows = rows[(rows.state == "confirmed") & (rows.visible > 0.0) & rows.facing_deg.notna()]
    off = np.abs((rows.facing_deg - rows.true_facing_deg + 180.0) % 360.0 - 180.0)
    rows = rows.assign(right=off < 90.0, axis_deg=np.minimum(off, 180.0 - off))
    found = list[Row]()
    for name, part in {**_binned(rows, "stopped_s", STOPPED), "all": rows}.items():
        sure = part[part.facing_confidence >= SURE_FACING]
        found.append({
            "facing": name, "rows": len(part), "right": _share(part, "right"), "claimed": part.facing_confidence.mean(),
            "from 0.9": len(sure) / max(len(part), 1), "of these right": _share(sure, "right"),
            "axis deg": part.axis_deg.median(),
        })  # fmt: skip
    return found


def confidence_table(rows: pandas.DataFrame) -> list[Row]:
    """How many rows show somebody, next to what is said; of rows with a prediction only, in the image or beyond it,
    separately."""
    rows = rows.assign(right=rows.true_id.notna())
    found = list[Row]()
    for seen, part in (("seen", rows[rows.state != "lost"]), ("predicted", rows[rows.state == "lost"])):
        for name, some in _binned(part, "confidence", CONFIDENCES).items():
            said = {"right": _share(some, "right"), "claimed": some.confidence.mean()}
            found.append({"confidence": f"{seen}, {name}", "rows": len(some), **said})
    return found


def deviation_table(rows: pandas.DataFrame) -> list[Row]:
    """Errors of places over ``std_m``, rms of both axes, by distance from the camera and by what is visible."""
    rows = rows[(rows.state == "confirmed") & (rows.visible >= VISIBLE_MIN)]
    error_m = np.hypot(rows.x_m - rows.true_x_m, rows.y_m - rows.true_y_m) / np.sqrt(2.0)
    rows = rows.assign(error_m=error_m, ratio=error_m / rows.std_m, away_m=np.hypot(rows.x_m, rows.y_m))
    parts = {**_binned(rows, "away_m", DISTANCES), **_binned(rows, "visible", VISIBILITIES), "all": rows}
    return [
        {
            "place": name,
            "rows": len(part),
            "error cm": 100.0 * _rms(part.error_m),
            "std cm": 100.0 * _rms(part.std_m),
            "error / std": _rms(part.ratio),
            "median error / std": part.ratio.median(),
        }
        for name, part in parts.items()
    ]


def speeds(rows: pandas.DataFrame, names: Row) -> list[Row]:
    """Of everybody who runs: true and reported speed, and how many ids."""
    running = rows[(rows.state == "confirmed") & (rows.true_mps >= RUNNING_MPS)]
    return [
        {
            **names, "person": int(who), "rows": len(own), "true m/s": own.true_mps.median(),
            "reported m/s": np.hypot(own.vx_mps, own.vy_mps).median(), "ids": own.id.nunique(),
        }
        for who, own in running.groupby("true_id")
    ]  # fmt: skip


def _binned(rows: pandas.DataFrame, column: str, bins: Bins) -> dict[str, pandas.DataFrame]:
    parts = {name: rows[(rows[column] >= low) & (rows[column] < high)] for name, (low, high) in bins.items()}
    return {name: part for name, part in parts.items() if len(part)}


def _rms(values: pandas.Series[float]) -> float:
    return float(np.sqrt((values**2).mean()))


def _share(rows: pandas.DataFrame, column: str) -> tuple[float, float, float] | float:
    """The share of rows that hold, and the 95 % interval by resampling the people of scenes."""
    if not len(rows):
        return float("nan")
    counts = rows.groupby(["scene", rows.true_id.fillna(rows.id)])[column].agg(["sum", "count"]).to_numpy(np.float64)
    sampled = np.random.default_rng(0).integers(len(counts), size=(500, len(counts)))
    held, of = counts[sampled].sum(axis=1).T
    low, high = np.quantile(held / of, [0.025, 0.975])
    return float(rows[column].mean()), float(low), float(high)
