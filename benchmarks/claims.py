"""Truth of the confidence that tracks give: of facing, existence, place and speed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import product
from pathlib import Path

import numpy as np
import pandas

from benchmarks.options import Report, Row, benchmark, cache_folder
from benchmarks.passes import Pass, run_pass
from benchmarks.real import DRAWS, GATE_M, WALKING_MPS, judged_frames, recordings_with_truth, truth_of
from benchmarks.suite import suite_recording
from calib.errors import WorkError
from calib.types import F64
from planview.engine.config import Config, load_config
from planview.engine.open import base_config
from planview.evaluation.metrics import build_sequence, clear_scores, floor_similarity
from planview.synthetic.assets import SCENES, real_recordings
from planview.synthetic.camera import mount_pose, rectified_world, stereo_rig
from planview.synthetic.people import Cast
from planview.synthetic.scene import Scene
from planview.synthetic.texture import Palette
from planview.trajectories.ends import velocities
from planview.trajectories.state import SURE_FACING
from planview.trajectories.table import Trajectories, read_tracks, read_truth, rows_by_id, table_of

STORIES = ("stopping", "backing", "running", "near", "behind")
THINGS = ("door_slides", "pram", "trolley")
"""Scenes of ``data/synthetic/claims``, and those of ``data/synthetic/things`` in which things move."""
RUNNING_MPS = 2.0
"""Speed from which somebody runs [m/s]."""
VISIBLE_MIN = 0.1
"""Unoccluded share below which a place is a guess and its error is not counted."""
STOPPED = {"walking": 0.0, "stopped up to 2 s ago": 1e-9, "2 to 5 s": 2.0, "5 to 12 s": 5.0, "longer": 12.0}
CONFIDENCES = {"below 0.1": 0.0, "0.1 to 0.5": 0.1, "0.5 to 0.9": 0.5, "from 0.9": 0.9}
"""Bins by where they begin."""


@benchmark
def claims(
    *,
    seed: Sequence[int] = (1,),
    data: Path | None = None,
    overrides: Sequence[str] = (),
) -> Report:
    """Compare what tracks say of themselves with the truth of rendered scenes and of real recordings.

    Prints how often people are back to front next to what facing_confidence says, how many rows show somebody next to
    confidence, the errors of places over std_m (rms of both axes), and the speeds and ids of runners.

    Example: python -m benchmarks claims --seed 2 --data ../shared/data

    Args:
        seed: Seeds of the scenes: those below 100 are for tuning, each of the others judges once.
        data: Folder with real recordings; $PLANVIEW_TEST_DATA, else ../shared/data of the repository, by default.
        overrides: One parameter of the engine; can be repeated.
    """
    folder = cache_folder(None)
    judged: list[pandas.DataFrame] = []
    for recording in recordings_with_truth(data or real_recordings()):
        settings = load_config(None, overrides, base_config(recording))
        tracks = read_tracks(run_pass(Pass(recording, folder, settings)) / "tracks.csv")
        truth = truth_of(recording)
        tracks = tracks.where(np.isin(tracks.frame, judged_frames(recording, truth, int(tracks.frame.max()) + 1)))
        judged.append(compare(tracks, truth).assign(material=recording.name, scene=recording.name))
    settings = load_config(None, overrides)
    paths = [SCENES / "claims" / f"{name}.toml" for name in STORIES]
    paths += [SCENES / "things" / f"{name}.toml" for name in THINGS]
    left_out = []
    for one, path in product(seed, paths):
        try:
            judged.append(judge_scene(path, one, folder, settings))
        except WorkError as error:
            left_out.append(f"left out: {path.stem}, seed {one}: {error}")
    every = pandas.concat(judged)
    drawn = every[every.material == "rendered"]
    figures = {
        "facing": facing_rows(drawn),
        "confidence": confidence_rows(every),
        "place": place_rows(every),
        "runners": speed_rows(drawn),
    }
    return Report(figures, [*figures.values()], left_out)


def judge_scene(path: Path, seed: int, cache: Path, settings: Config) -> pandas.DataFrame:
    """Every row of the tracks of the member of a scene that a seed draws, with what is true (``compare``). Raises
    WorkError: it cannot be drawn, or the engine refuses it."""
    recording, scene = suite_recording(path, seed, cache)
    tracks = read_tracks(run_pass(Pass(recording, cache, settings)) / "tracks.csv")
    truth = everybody(scene, read_truth(recording / "truth.csv"))
    return compare(tracks, truth).assign(material="rendered", scene=f"{path.stem}-{seed}")


def everybody(scene: Scene, shown: Trajectories) -> Trajectories:
    """The truth of a scene with those who are hidden or beyond the image (``visible`` 0) as well: somebody who is
    predicted there may be there."""
    assert scene.rig is not None  # of every scene of claims
    cast = Cast(scene, Palette())
    _, world_SE3_room = rectified_world(stereo_rig(scene.rig), mount_pose(scene.rig))
    rows = []
    for frame in range(scene.n_frames):
        for actor in cast.at(frame / scene.fps):
            if actor.body is None:
                continue
            x_m, y_m, _ = world_SE3_room @ actor.body.head
            ahead = world_SE3_room.rotation @ actor.body.chest
            facing_deg = np.rad2deg(np.arctan2(ahead[1], ahead[0]))
            rows.append((frame, actor.person, x_m, y_m, actor.body.top_m, facing_deg))
    whole = pandas.DataFrame(rows, columns=["frame", "id", "x_m", "y_m", "height_m", "facing_deg"])
    seen = pandas.DataFrame({"frame": shown.frame, "id": shown.track_id, "visible": shown.visible})
    return table_of(whole.merge(seen, "left", ["frame", "id"]).fillna({"visible": 0.0}), "everybody")


def compare(tracks: Trajectories, truth: Trajectories) -> pandas.DataFrame:
    """Every row of tracks with what is true of the person who is nearest; NaN where nobody is."""
    frame_s = float(np.ptp(tracks.timestamp_s) / np.ptp(tracks.frame))
    sequence = build_sequence(truth, tracks, floor_similarity(GATE_M))
    truth_row, track_row = clear_scores(sequence).matches.T
    speed_mps = np.hypot(*velocities(truth, frame_s * truth.frame.astype(np.float64)).T)
    true = {
        "true_id": truth.track_id,
        "true_x_m": truth.x_m,
        "true_y_m": truth.y_m,
        "true_mps": speed_mps,
        "true_facing_deg": truth.facing_deg,
        "visible": truth.visible,
        "stopped_s": stopped_s(truth, speed_mps, frame_s),
    }
    rows = tracks.to_dataframe()
    for name, values in true.items():
        rows.loc[track_row, name] = values[truth_row]
    return rows


def stopped_s(truth: Trajectories, speed_mps: F64, frame_s: float) -> F64:
    """(N,) time since a person last walked [s]."""
    since_s = np.zeros(len(truth))
    for _, rows in rows_by_id(truth.track_id):
        frames = truth.frame[rows]
        walked = np.where(speed_mps[rows] >= WALKING_MPS, frames, frames[0] - 1)
        since_s[rows] = (frames - np.maximum.accumulate(walked)) * frame_s
    return since_s


def facing_rows(rows: pandas.DataFrame) -> list[Row]:
    """By how long ago people stopped, and by scene: how many are not back to front, what is said, and the sure ones."""
    rows = rows[(rows.state == "confirmed") & (rows.visible > 0.0) & rows.facing_deg.notna()]
    off_deg = np.abs((rows.facing_deg - rows.true_facing_deg + 180.0) % 360.0 - 180.0)
    rows = rows.assign(right=off_deg < 90.0)
    stopped = rows.groupby(_bin(rows.stopped_s, STOPPED), observed=True)
    figures: list[Row] = []
    for name, part in (*stopped, *rows.groupby("scene"), ("all", rows)):
        sure = part[part.facing_confidence >= SURE_FACING]
        figures.append(
            {
                "rendered: facing": name,
                "rows": len(part),
                "right": _share(part),
                "claimed": part.facing_confidence.mean(),
                "from 0.9": len(sure) / max(len(part), 1),
                "of these right": _share(sure),
            }
        )
    return figures


def confidence_rows(rows: pandas.DataFrame) -> list[Row]:
    """Share of rows that show somebody, next to their confidence, by state and for real and rendered recordings side by
    side: ``lost`` people are predicted, in the image or beyond it."""
    source = np.where(rows.material == "rendered", "rendered", "real")
    rows = rows.assign(source=source, right=rows.true_id.notna(), bin=_bin(rows.confidence, CONFIDENCES))
    figures: list[Row] = []
    for (state, name), both in rows.groupby(["state", "bin"], observed=True):
        figure: Row = {"confidence": f"{state}, {name}"}
        for material, part in both.groupby("source"):
            figure[f"{material}: rows"] = len(part)
            figure[f"{material}: claimed"] = part.confidence.mean()
            figure[f"{material}: right"] = _share(part)
        figures.append(figure)
    return figures


def place_rows(rows: pandas.DataFrame) -> list[Row]:
    """Errors of places over ``std_m``, rms of both axes, by the size of ``std_m``."""
    rows = rows[(rows.state == "confirmed") & (rows.visible >= VISIBLE_MIN)]
    error_m = np.hypot(rows.x_m - rows.true_x_m, rows.y_m - rows.true_y_m) / np.sqrt(2.0)
    rows = rows.assign(error_m=error_m, ratio=error_m / rows.std_m, std="all")
    rank = rows.groupby("material").std_m.rank("first", pct=True)
    thirds = rows.assign(std=pandas.qcut(rank, 3, ["smallest third", "middle third", "largest third"]))
    parts = pandas.concat([rows, thirds]).groupby(["material", "std"])
    figures = parts.agg(
        rows=("ratio", "size"),
        error_m=("error_m", _rms),
        std_m=("std_m", _rms),
        error_over_std=("ratio", _rms),
    )
    return list(figures.reset_index().to_dict("records"))


def speed_rows(rows: pandas.DataFrame) -> list[Row]:
    """True and reported speed of everybody who runs, and how many ids they have."""
    running = rows[(rows.state == "confirmed") & (rows.true_mps >= RUNNING_MPS)]
    reported_mps = np.hypot(running.vx_mps, running.vy_mps)
    figures = (
        running.assign(reported_mps=reported_mps)
        .groupby(["scene", "true_id"])
        .agg(
            rows=("id", "size"),
            true_mps=("true_mps", "median"),
            reported_mps=("reported_mps", "median"),
            ids=("id", "nunique"),
        )
    )
    return list(figures.reset_index().to_dict("records"))


def _bin(values: pandas.Series[float], bins: Mapping[str, float]) -> pandas.Series[str]:
    """The name of the bin of each value."""
    return pandas.cut(values, [*bins.values(), np.inf], right=False, labels=list(bins))


def _rms(values: pandas.Series[float]) -> float:
    return float(np.sqrt((values**2).mean()))


def _share(rows: pandas.DataFrame) -> tuple[float, float, float] | float:
    """The share of rows that are right, and the 95 % interval by resampling the people of scenes."""
    if not len(rows):
        return float("nan")
    person = rows.true_id.fillna(rows.id)
    counts = rows.groupby(["scene", person]).right.agg(["sum", "count"]).to_numpy(np.float64)
    draws = np.random.default_rng(0).integers(len(counts), size=(DRAWS, len(counts)))
    hold, total = counts[draws].sum(axis=1).T
    low, high = np.quantile(hold / total, [0.025, 0.975])
    return float(rows.right.mean()), float(low), float(high)
