"""Recordings with truth: how often the right number of people is found and who is who; PETS S2-L1 for one camera."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated, Literal, NamedTuple, get_args

import numpy as np
from cyclopts import Parameter
from pandas import read_csv

from benchmarks.claims import GATE_M, WALKING_MPS
from benchmarks.options import JsonFlag, Row, progress, report
from benchmarks.passes import FACING, bench_engine
from calib.errors import InputError
from calib.ground_camera import load_ground_camera, save_ground_camera
from calib.types import I64
from planview.api.run import run
from planview.engine.config import Config, load_config
from planview.engine.open import base_config
from planview.evaluation.evaluate import EvaluationParams, evaluate_tracks, velocities
from planview.evaluation.metrics import build_sequence, clear_scores, floor_similarity
from planview.evaluation.result import Evaluation
from planview.synthetic.assets import real_recordings
from planview.trajectories.formats import load_truth
from planview.trajectories.table import Trajectories, positions_table, read_truth

BASELINE = "peaks"
"""The tracker to beat, which is always scored too."""
PRINTED = ("mota", "idf1", "position_error_mean_m", "misses", "false_positives", "facing deg")
WALKER_PATH = "walker_path_from_depth.csv"
WALKER_VISIBLE_FRAMES, BESIDE_WALKER_M = 30, 0.3
"""The walker's path comes without ids: later the walker stands cut by the image's border, and so does a second person
to the right [m] (README of the recording). Its frames without a row are not judged."""


SEPARATE_S = 0.5
"""Errors of places within one step of a walker are one error [s]."""
SEPARATE_MIN = 4
"""Fewer steps give no interval."""


def recordings_with_truth(data: Path, names: Sequence[str] = ()) -> list[Path]:
    """Folders of recordings with truth on the floor, by name. Raises InputError: there is none, or none of a name."""
    known = {p.name: p for p in sorted(data.glob("*")) if (p / "truth.csv").is_file() or (p / WALKER_PATH).is_file()}
    for name in names:
        if name not in known:
            raise InputError(f"--recording: expected one of {', '.join(known) or 'none'} in {data}, found {name!r}")
    if not known:
        raise InputError(
            f"{data}: no recordings with truth.csv; --data or $PLANVIEW_TEST_DATA names their folder, and "
            "docs/results.md has their sources"
        )
    return [known[name] for name in names or known]


def truth_of(folder: Path) -> Trajectories:
    """People of a recording on the floor."""
    if (folder / "truth.csv").is_file():
        return read_truth(folder / "truth.csv")
    rows = read_csv(folder / WALKER_PATH)[["frame", "x_m", "z_m", "height_m"]].to_numpy(np.float64)
    frame = rows[:, 0].astype(np.int64)
    is_second = (frame >= WALKER_VISIBLE_FRAMES) & (rows[:, 1] > BESIDE_WALKER_M)
    ids = 1 + is_second.astype(np.int64)
    order = np.lexsort((ids, frame))
    visible = (frame < WALKER_VISIBLE_FRAMES).astype(np.float64)
    return positions_table(frame[order], ids[order], rows[order, 1:3], rows[order, 3], visible=visible[order])


def score_real(tracks: Trajectories, truth: Trajectories, frames: I64) -> dict[str, float]:
    """Figures of the confirmed tracks of a recording in the (F,) frames that are judged.

    Returns:
        right_number: share of frames in which as many people are reported as show; those too hidden or cut off to judge
        (``visible`` 0 in the truth) may be reported or not. ids, people: confirmed ids, and people who show at any
        time. judged, positions: rows of the truth of people who show, and all.
    """
    confirmed = tracks.where(np.isin(tracks.frame, frames) & (tracks.state == "confirmed"))
    shown = truth.where(~(truth.visible <= 0))
    n = int(frames.max()) + 1
    found, least, most = (np.bincount(t.frame, minlength=n)[frames] for t in (confirmed, shown, truth))
    return {
        "right_number": float(((found >= least) & (found <= most)).mean()),
        "ids": len(np.unique(confirmed.track_id)),
        "people": len(np.unique(shown.track_id)),
        "judged": len(shown),
        "positions": len(truth),
    }


def ahead_of_heads(tracks: Trajectories, truth: Trajectories, frame_s: float) -> tuple[float, float, float]:
    """How far the reported places of walkers are ahead of their heads along the way that they walk [cm], with the 95 %
    interval; NaN where too few walk to tell.

    Least squares of (reported - true place) = ahead * (unit vector of the true velocity) + offset: cameras are not
    registered to the centimetre, which moves everybody alike. The interval is from bootstrapping the walkers' steps.
    """
    confirmed = tracks.where(tracks.state == "confirmed")
    velocity = velocities(truth, frame_s)
    t, k = clear_scores(build_sequence(truth, confirmed, floor_similarity(GATE_M))).matches.T
    judged = (np.hypot(*velocity[t].T) >= WALKING_MPS) & ~(truth.visible[t] <= 0)
    t, k = t[judged], k[judged]
    off_m = np.stack([confirmed.x_m[k] - truth.x_m[t], confirmed.y_m[k] - truth.y_m[t]], axis=1)
    way = velocity[t] / np.hypot(*velocity[t].T)[:, None]
    unknowns = np.concatenate([way[:, :, None], np.tile(np.eye(2), (len(t), 1, 1))], axis=2)
    step = np.stack([truth.track_id[t], (truth.frame[t] * frame_s / SEPARATE_S).astype(np.int64)])
    steps, step_of = np.unique(step, axis=1, return_inverse=True)
    n = steps.shape[1]
    if n < SEPARATE_MIN:
        return math.nan, math.nan, math.nan
    normal, right = np.zeros((n, 3, 3)), np.zeros((n, 3, 1))
    np.add.at(normal, step_of.reshape(-1), unknowns.transpose(0, 2, 1) @ unknowns)
    np.add.at(right, step_of.reshape(-1), unknowns.transpose(0, 2, 1) @ off_m[..., None])
    sampled = np.random.default_rng(0).multinomial(n, np.full(n, 1.0 / n), size=500)
    times = np.concatenate([np.ones((1, n)), sampled])
    ahead_cm = 100.0 * (np.linalg.pinv(np.tensordot(times, normal, 1)) @ np.tensordot(times, right, 1))[:, 0, 0]
    low, high = np.quantile(ahead_cm[1:], [0.025, 0.975])
    return float(ahead_cm[0]), float(low), float(high)


@Parameter(name="*")
@dataclass(frozen=True)
class RealOptions:
    """Which recordings are tracked, and by what."""

    data: Path | None = None
    """Folder with recordings; $PLANVIEW_TEST_DATA, else ../shared/data of the repository, by default."""
    recording: Annotated[Sequence[str], Parameter(negative="")] = ()
    """Only these recordings, by the names of their folders."""
    tracker: Annotated[Sequence[str], Parameter(negative="")] = ("joint",)
    """Trackers, as of planview run; the baseline of height peaks is always added."""
    set_: Annotated[Sequence[str], Parameter(name="--set", negative="", show_default=False)] = ()
    """One parameter of the engine."""
    json_output: JsonFlag = False
    """Print one JSON object."""


def real(*, options: RealOptions | None = None) -> None:
    """Score every real plan-view recording with truth, and the baseline of height peaks.

    A recording is a folder with truth.csv (frame, id, x_m, y_m, height_m, visible); people with visible 0 are too
    hidden or cut off to judge, and may be reported or not. docs/results.md has the sources of the recordings.

    Example: python -m benchmarks real --data ../shared/data --recording rgbd-six-people
    """
    o = options or RealOptions()
    rows = []
    for folder in recordings_with_truth(o.data or real_recordings(), o.recording):
        truth = truth_of(folder)
        for tracker in dict.fromkeys((*o.tracker, BASELINE)):
            progress(f"{folder.name}: {tracker}")
            engine = bench_engine(folder, tracker, load_config(None, o.set_, base_config(folder)))
            tracks = run(engine, quiet=True)
            judged = np.unique(truth.frame)
            if (folder / "truth.csv").is_file():  # frames without a row are empty
                judged = np.arange(max(engine.recording.n_frames, int(judged.max()) + 1))
            scores = evaluate_tracks(tracks.where(np.isin(tracks.frame, judged)), truth)
            figures = scores.to_json() | {"facing deg": scores.facing.walkers_deg}
            names = figures if o.json_output else PRINTED
            counts = {"recording": folder.name, "tracker": tracker, **score_real(tracks, truth, judged)}
            ahead = {"ahead cm": ahead_of_heads(tracks, truth, 1.0 / engine.recording.fps)}
            rows.append(counts | {name: figures[name] for name in names} | ahead)
    report(o.json_output, scores=rows)
    progress("right number: as many people are reported as show; those too hidden to judge may be reported or not")
    progress(f"facing deg: {FACING}")
    progress("ahead cm: places of walkers ahead of their heads, along the way that they walk, with the 95 % interval")


SingleTracker = Literal["human-model", "ellipse-particle"]
FPS = 7.0
"""Nominal frame rate of the sequence."""
PRINTED_FIGURES = ("truth_rows", "mota", "idf1", "hota", "switches", "misses", "false_positives")


class PetsScores(NamedTuple):
    """Scores of one run of one tracker: with boxes at IoU 0.5, and on the floor with a gate of 1 m, after the rigid
    motion between the two world frames, where tracks have positions."""

    tracker: SingleTracker
    frames: int
    boxes: Evaluation
    floor: Evaluation | None

    @property
    def protocols(self) -> dict[str, Evaluation]:
        """The scores by what they are of."""
        return {"boxes, IoU 0.5": self.boxes} | ({"floor, 1 m": self.floor} if self.floor is not None else {})

    def rows(self, whole: bool) -> list[Row]:
        """A row per protocol, with every figure or the most important ones."""
        rows = []
        for protocol, result in self.protocols.items():
            figures = result.to_json()
            named = {"tracker": self.tracker, "protocol": protocol, "tracked_frames": self.frames}
            rows.append(named | {name: figures[name] for name in (figures if whole else PRINTED_FIGURES)})
        return rows


def spread(runs: Sequence[PetsScores]) -> list[Row]:
    """Mean, deviation and range over several runs, a row per protocol."""
    rows = []
    for protocol in runs[0].protocols:
        scored = [run.protocols[protocol] for run in runs]
        mota, idf1 = np.array([(result.clear.mota, result.idf1) for result in scored], dtype=np.float64).T  # None: NaN
        figures = {"mota_mean": mota.mean(), "mota_deviation": mota.std(), "mota_range": np.ptp(mota)}
        figures |= {"idf1_mean": idf1.mean(), "idf1_deviation": idf1.std()}
        named = {"tracker": runs[0].tracker, "protocol": protocol.partition(",")[0], "runs": len(scored)}
        rows.append(named | figures)
    return rows


def score_pets(
    tracker: SingleTracker, folder: Path, camera: Path | None, frames: int | None = None, seeds: int = 1
) -> list[PetsScores]:
    """Score ``seeds`` runs of a tracker; without a camera.toml only boxes are scored. The human-model tracker draws no
    random numbers: its runs differ by 1e-5 in the focal length of the camera. Raises InputError: files that are missing
    or do not fit."""
    if camera is None or tracker == "ellipse-particle":
        return [_score_run(tracker, folder, camera, frames, seed) for seed in range(seeds)]
    with TemporaryDirectory() as place:
        like, nearby = load_ground_camera(camera), [Path(place) / f"{n}.toml" for n in range(seeds)]
        for n, path in enumerate(nearby):
            save_ground_camera(replace(like, focal_px=like.focal_px * (1.0 + 1e-5 * n)), path)
        return [_score_run(tracker, folder, path, frames, 0) for path in nearby]


def _score_run(tracker: SingleTracker, folder: Path, camera: Path | None, frames: int | None, seed: int) -> PetsScores:
    for name in ("gt.txt", "view001.mp4"):
        if not (folder / name).is_file():
            raise InputError(f"{folder}: expected a folder with {name} (PETS S2-L1 view 1), found none")
    truth = load_truth(folder / "gt.txt")
    tracked: list[int] = []
    tracks = run(
        folder / "view001.mp4", tracker=tracker, config=Config(seed=seed), camera=camera, frames=frames,
        watch=lambda result: tracked.append(result.frame),
    )  # fmt: skip
    n = len(tracked)
    boxes = evaluate_tracks(tracks, truth, EvaluationParams(match_on="boxes", fps=FPS), (0, n - 1))
    on_floor = EvaluationParams(gate_m=1.0, align=True, fps=FPS)
    floor = None if camera is None else evaluate_tracks(tracks, truth, on_floor, (0, n - 1))
    return PetsScores(tracker, n, boxes, floor)


@Parameter(name="*")
@dataclass(frozen=True)
class PetsOptions:
    """Which trackers are scored, and on how much."""

    camera: Path | None = None
    """camera.toml, e.g. from planview calibrate human with tests/data/pets_people.json; the ellipse-particle tracker
    needs none, but is scored on the floor with one."""
    tracker: Literal["both", "human-model", "ellipse-particle"] = "both"
    """Which tracker to score."""
    frames: int | None = None
    """Only the first frames."""
    seeds: int = 1
    """Run the ellipse-particle tracker with this many seeds, the human-model tracker with this many cameras that are
    nearly alike, and print the spread of the scores."""
    json_output: JsonFlag = False
    """Print one JSON object on stdout."""


def pets(folder: Path, *, options: PetsOptions | None = None) -> None:
    """Score the single-camera trackers on PETS S2-L1 view 1.

    Example: python -m benchmarks pets ../shared/data/pets09-s2l1-view001 --camera camera.toml

    Example: python -m benchmarks pets ../shared/data/pets09-s2l1-view001 --tracker ellipse-particle --seeds 20

    Parameters
    ----------
    folder
        Folder with view001.mp4 and gt.txt.
    """
    o = options or PetsOptions()
    if (o.frames is not None and o.frames < 1) or not 1 <= o.seeds <= 1000:
        raise InputError(f"expected --frames from 1, --seeds 1 to 1000, found {o.frames}, {o.seeds}")
    if o.camera is None and o.tracker != "ellipse-particle":
        raise InputError("--camera: the human-model tracker needs a camera.toml (see planview calibrate human)")
    progress(f"tracking {folder}")
    trackers = [tracker for tracker in get_args(SingleTracker) if o.tracker in ("both", tracker)]
    runs = [score_pets(tracker, folder, o.camera, o.frames, o.seeds) for tracker in trackers]
    report(
        o.json_output,
        scores=[row for first, *_ in runs for row in first.rows(whole=o.json_output)],
        spread=[row for some in runs if len(some) > 1 for row in spread(some)],
    )
