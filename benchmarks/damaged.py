"""Recordings with frames that show nothing in them: what these cost each tracker."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import cv2
import numpy as np
from cyclopts import Parameter

from benchmarks.options import JsonFlag, progress, report
from benchmarks.passes import bench_engine
from benchmarks.real import recordings_with_truth, truth_of
from calib.errors import InputError
from calib.types import AnyArray
from planview.api.run import run
from planview.engine.config import Config
from planview.engine.engine import Trackable
from planview.evaluation.evaluate import EvaluationParams, evaluate_tracks
from planview.synthetic.assets import real_recordings
from planview.trajectories.formats import load_truth
from planview.trajectories.table import Trajectories
from stereo.recording import Frame, Shot

Rng = np.random.Generator
SHAKE_PX = 12
"""Largest shift of a camera that is shaken [px of a 640 px wide image]."""


def _shaken(image: AnyArray, rng: Rng) -> AnyArray:
    shift = rng.integers(-SHAKE_PX, SHAKE_PX + 1, 2) * image.shape[1] // 640
    return np.roll(image, shift, (0, 1))


def _grey(image: AnyArray, rng: Rng) -> AnyArray:
    return image if image.ndim == 2 else cv2.cvtColor(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), cv2.COLOR_GRAY2BGR)


def _one_level(image: AnyArray, rng: Rng) -> AnyArray:
    """One grey level more or less on 1 % of the pixels: how much rounding decides."""
    change = rng.choice([-1, 1], image.shape[:2]) * (rng.uniform(size=image.shape[:2]) < 0.01)
    levels = image.astype(np.int16) + change.reshape(*image.shape[:2], *[1] * (image.ndim - 2))
    return np.asarray(np.clip(levels, 0, 255), np.uint8)


IMAGES: dict[str, Callable[[AnyArray, Rng], AnyArray]] = {
    "none": lambda image, rng: image,
    "noise": lambda image, rng: rng.integers(0, 256, image.shape, np.uint8),
    "black": lambda image, rng: np.zeros_like(image),
    "white": lambda image, rng: np.full_like(image, 255),
    "one-black": lambda image, rng: image,
    "shaken": _shaken,
    "blurred": lambda image, rng: cv2.GaussianBlur(image, (0, 0), image.shape[1] / 60),
    "grey": _grey,
    "dark-flash": lambda image, rng: (0.15 * image).astype(np.uint8),
    "one-level": _one_level,
    "every-second-dark": lambda image, rng: (0.5 * image).astype(np.uint8),
}
"""By kind of damage, an image of any camera after it."""
RANGES = {"noise", "black", "white", "one-black"}
"""Kinds that leave no depth of a sensor of depth; of a pair, "one-black" is the right camera."""


def after(frame: Frame[Shot], kind: str, rng: Rng) -> Frame[Shot]:
    """A frame of one camera, of a pair, or with depth, after damage."""
    change, black = IMAGES[kind], IMAGES["black"]
    seed = int(rng.integers(2**32))  # both cameras are shaken together

    def of(image: AnyArray) -> AnyArray:
        return change(image, np.random.default_rng(seed))

    first, *second = frame.images
    if second and second[0].dtype == np.uint8:
        right = black(second[0], rng) if kind == "one-black" else of(second[0])
        second = [rng.permutation(right) if kind == "noise" else right]
    elif second:
        depth = np.full_like(second[0], np.nan) if kind in RANGES else second[0]
        second = [of(depth) if kind == "shaken" else depth]
    return replace(frame, shots=((of(first), *second),))


class Damaged:
    """A recording with damage of ``length`` frames from each of some frames on ("one-level": of all frames)."""

    def __init__(self, recording: Trackable, kind: str, length: int, starts: Sequence[int]) -> None:
        self._recording, self._kind, self._rng = recording, kind, np.random.default_rng(0)
        every = 2 if kind == "every-second-dark" else 1
        self._hit = {start + k for start in starts for k in range(0, every * length, every)}

    def __getattr__(self, name: str) -> Any:
        return getattr(self._recording, name)

    def __iter__(self) -> Iterator[Frame[Shot]]:
        for frame in self._recording:
            hit = frame.index in self._hit or self._kind == "one-level"
            yield after(frame, self._kind, self._rng) if hit else frame


@Parameter(name="*")
@dataclass(frozen=True)
class DamagedOptions:
    """What is damaged, how, and who tracks it."""

    recording: Annotated[Sequence[Path], Parameter(negative="")] = ()
    """Folders of recordings with truth.csv, or with gt.txt next to a video (boxes are scored then). Default: the real
    recordings."""
    camera: Path | None = None
    """camera.toml of the videos, for the human-model tracker."""
    tracker: Annotated[Sequence[str], Parameter(negative="")] = ()
    """Trackers, as of planview run. Default: joint and template; of videos ellipse-particle and, with a camera,
    human-model."""
    kind: Annotated[Sequence[str], Parameter(negative="")] = ()
    """Kinds of damage. Default: all."""
    length: Annotated[Sequence[int], Parameter(negative="")] = (8,)
    """Damaged frames in a row."""
    at: Annotated[Sequence[float], Parameter(negative="")] = (0.35, 0.55, 0.75)
    """Where damage begins, as shares of the recording."""
    frames: int = 0
    """Only the first frames; 0 for all."""
    json_output: JsonFlag = False
    """Print one JSON object."""


def _score(
    folder: Path, tracker: str, kind: str, length: int, o: DamagedOptions, plain: Trajectories | None
) -> tuple[dict[str, Any], Trajectories]:
    """Figures of one run, compared with the tracks of the ``plain`` recording; its tracks."""
    boxes = (folder / "gt.txt").is_file()
    truth: Trajectories = load_truth(folder / "gt.txt") if boxes else truth_of(folder)
    recording, camera = (next(folder.glob("*.mp4")), o.camera) if boxes else (folder, None)
    engine = bench_engine(recording, tracker, Config(), camera)
    n = min(o.frames or engine.recording.n_frames, engine.recording.n_frames)
    engine.recording = Damaged(engine.recording, kind, length, [int(share * n) for share in o.at])
    tracks = run(engine, frames=n, quiet=True)
    params = EvaluationParams(match_on="boxes", fps=engine.recording.fps) if boxes else EvaluationParams()
    figures = evaluate_tracks(tracks, truth, params, (0, n - 1)).to_json()
    found = {"significant": figures["significant_errors"]["total"], "lasting": figures["strict_identity_changes"]}
    found |= {"mota": figures["mota"], "idf1": figures["idf1"], **_moved(tracks, plain or tracks)}
    shown = length if kind != "none" else 0
    return {"recording": folder.name, "tracker": tracker, "damage": kind, "frames": shown, **found}, tracks


def _moved(tracks: Trajectories, plain: Trajectories) -> dict[str, float]:
    """How far people are from where they are without damage, by frame and id [cm]: median and largest."""
    mine, theirs = (t.frame * 100_000 + t.track_id for t in (tracks, plain))
    _, here, there = np.intersect1d(mine, theirs, return_indices=True)
    moved = 100.0 * np.hypot(tracks.x_m[here] - plain.x_m[there], tracks.y_m[here] - plain.y_m[there])
    moved = np.append(moved, math.nan) if len(moved) == 0 else moved
    return {"moved_median_cm": float(np.median(moved)), "moved_most_cm": float(np.max(moved))}


def damaged(*, options: DamagedOptions | None = None) -> None:
    """Score recordings with and without frames that show nothing in them.

    Example: python -m benchmarks damaged --recording data/synthetic/demo --kind black --length 8
    """
    o = options or DamagedOptions()
    kinds = list(o.kind or [kind for kind in IMAGES if kind != "none"])
    if foreign := set(kinds) - set(IMAGES):
        raise InputError(f"--kind: expected {', '.join(IMAGES)}, found {min(foreign)!r}")
    folders = list(o.recording) or recordings_with_truth(real_recordings())
    rows = []
    for folder in folders:
        single = ("ellipse-particle", "human-model") if o.camera else ("ellipse-particle",)
        for tracker in o.tracker or (single if (folder / "gt.txt").is_file() else ("joint", "template")):
            plain: Trajectories | None = None
            for kind, length in [("none", 0), *((kind, length) for kind in kinds for length in o.length)]:
                progress(f"{folder.name}: {tracker}, {kind} {length}")
                row, tracks = _score(folder, tracker, kind, length, o, plain)
                plain = plain or tracks
                rows.append(row)
    report(o.json_output, scores=rows)
