"""Two heads in one world against one: rendered scenes of seeds, aligned by their people, tracked, scored."""

from __future__ import annotations

import hashlib
import math
import shutil
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from calib.errors import WorkError
from calib.io import reason
from calib.types import F64
from calib.world import RIGS_FILE, RigEntry, load_rigs
from planview.calibration.align import align_records, rig_entries
from planview.calibration.paths import record_rig
from planview.engine.config import Config
from planview.engine.factory import floor_tracker
from planview.engine.heads import HeadsPipeline
from planview.evaluation.evaluate import evaluate_tracks
from planview.evaluation.result import Evaluation
from planview.synthetic.random_scenes.rigs import random_rigs
from planview.synthetic.render import RENDERER_VERSION
from planview.synthetic.write import write_rigs
from planview.trajectories.table import Trajectories, TrajectoryCollector, concatenated, positions_table, read_truth
from stereo.readers.multi_rig import heads_in

LIMITS = {"position_cm": 5.0, "heading_deg": 0.5, "clock_ms": 30.0}
"""What an alignment must keep."""


@dataclass(frozen=True)
class AlignmentError:
    """Of the second head's camera in the first one's world [m], its heading [rad] and its clock [s]."""

    position_m: float
    heading_rad: float
    clock_s: float

    @property
    def ok(self) -> bool:
        """Whether all limits are kept."""
        return (
            100 * self.position_m <= LIMITS["position_cm"]
            and math.degrees(abs(self.heading_rad)) <= LIMITS["heading_deg"]
            and 1000 * abs(self.clock_s) <= LIMITS["clock_ms"]
        )


@dataclass(frozen=True)
class HeadsScore:
    """One seed.

    Attributes:
        alignment: found against true; None when it was refused.
        refusal: why it was refused; empty otherwise. The heads are then tracked with their true poses.
        single: of each head alone, in its own world.
        joint: of both in one world.
    """

    seed: int
    description: str
    alignment: AlignmentError | None
    refusal: str
    single: tuple[Evaluation, ...]
    joint: Evaluation

    @property
    def single_error_m(self) -> float:
        """Mean position error of the heads alone, over all their matches [m]."""
        return float(np.concatenate([e.position_error_m for e in self.single]).mean())

    @property
    def joint_error_m(self) -> float:
        return float(self.joint.position_error_m.mean())

    def to_json(self) -> dict[str, Any]:
        a = self.alignment
        return {
            "seed": self.seed,
            "scene": self.description,
            "alignment": None
            if a is None
            else {
                "position_cm": 100 * a.position_m,
                "heading_deg": math.degrees(a.heading_rad),
                "clock_ms": 1000 * a.clock_s,
                "ok": a.ok,
            },
            "refusal": self.refusal,
            "single": [e.to_json() for e in self.single],
            "joint": self.joint.to_json(),
        }


def rendered_heads(seed: int, cache: Path) -> Path:
    """The recording of a seed, rendered unless the cache has it.

    Raises:
        WorkError: the cache cannot be written.
    """
    heads = random_rigs(seed)
    text = "".join(h.scene.model_dump_json() + h.mount.model_dump_json() for h in heads)
    key = hashlib.sha256(f"{text} {RENDERER_VERSION}".encode()).hexdigest()[:16]
    folder = cache / f"heads-{seed}-{key}"
    if folder.is_dir():
        return folder
    try:
        cache.mkdir(parents=True, exist_ok=True)
        part = Path(tempfile.mkdtemp(prefix=f".heads-{seed}-", dir=cache))
    except OSError as error:
        raise WorkError(f"{cache}: the cache cannot be written: {reason(error)}") from error
    try:
        write_rigs(heads, part, storage="jpg")
        if not folder.is_dir():
            part.rename(folder)
    finally:
        shutil.rmtree(part, ignore_errors=True)
    return folder


def score_heads(seed: int, cache: Path, config: Config, tell: Callable[[str], None]) -> HeadsScore:
    """Render (once), track every head alone, align the heads by their people, track both in one world, score all."""
    tell(f"seed {seed}: rendering")
    folder = rendered_heads(seed, cache)
    true = load_rigs(folder / RIGS_FILE)
    tell(f"seed {seed}: each head alone")
    records = [record_rig(folder / entry.folder, config) for entry in true]
    single = tuple(evaluate_tracks(r.tracks, read_truth(r.path / "truth.csv")) for r in records)
    refusal, error, entries = "", None, list(true)
    try:
        entries = rig_entries(records, align_records(records), folder)
        error = alignment_error(entries, true)
    except WorkError as refused:
        refusal = str(refused)
    tell(f"seed {seed}: both heads")
    joint = _joint(folder, entries, true, config)
    return HeadsScore(seed, random_rigs(seed)[0].scene.description, error, refusal, single, joint)


def alignment_error(found: Sequence[RigEntry], true: Sequence[RigEntry]) -> AlignmentError:
    """Of the second head beside the first; heights and tilts are the floor's affair."""
    (angle, place), (true_angle, true_place) = _floor_motion(found[1]), _floor_motion(true[1])
    return AlignmentError(
        float(np.hypot(*(place - true_place))),
        math.remainder(angle - true_angle, 2 * math.pi),
        found[1].start_s - true[1].start_s,
    )


def _floor_motion(entry: RigEntry) -> tuple[float, F64]:
    """Heading [rad] and place (2,) [m] of a head's own world in the common one: below its camera, along its x axis."""
    axis = entry.world_SE3_left.rotation[:2, 0]
    return math.atan2(axis[1], axis[0]), np.asarray(entry.world_SE3_left.translation[:2])


def _joint(folder: Path, entries: Sequence[RigEntry], true: Sequence[RigEntry], config: Config) -> Evaluation:
    recording = heads_in(folder, entries)
    engine = HeadsPipeline.from_recording(recording, floor_tracker("template", config), config)
    collector, times = TrajectoryCollector(), []
    for result in engine:
        collector.add(result.frame, result.timestamp_s, result.tracks)
        times.append(result.timestamp_s)
    begin_s = min(entry.start_s for entry in entries)
    truths = [read_truth(folder / entry.folder / "truth.csv") for entry in true]
    truth = common_truth(truths, true, recording.fps, np.array(times) + begin_s)
    return evaluate_tracks(collector.trajectories(), truth)


def common_truth(truths: Sequence[Trajectories], entries: Sequence[RigEntry], fps: float, times_s: F64) -> Trajectories:
    """All people whom any head sees, in the common world, at the times of the moments (frames count them).

    Args:
        truths: of the heads, each in its own world and frames.
        entries: the true poses and clocks.
        fps: of the heads.
        times_s: (T,) on the clock of the first head [s].
    """
    parts = []
    for truth, entry in zip(truths, entries, strict=True):
        angle, place = _floor_motion(entry)
        c, s = math.cos(angle), math.sin(angle)
        xy = np.column_stack([truth.x_m, truth.y_m]) @ np.array([[c, s], [-s, c]]) + place
        when = truth.frame / fps + entry.start_s
        for person in np.unique(truth.track_id):
            own = np.flatnonzero(truth.track_id == person)
            later = np.searchsorted(when[own], times_s).clip(1, max(1, len(own) - 1))
            if len(own) < 2:
                continue
            near = (when[own][later] - when[own][later - 1] < 1.5 / fps) & (times_s >= when[own][0])
            frames = np.flatnonzero(near & (times_s <= when[own][-1]))
            at = times_s[frames]
            columns = [np.interp(at, when[own], v[own]) for v in (*xy.T, truth.height_m, truth.visible)]
            ids = np.full(len(frames), person, dtype=np.int64)
            parts.append(positions_table(frames, ids, np.column_stack(columns[:2]), columns[2], at, visible=columns[3]))
    every = concatenated(parts)
    # Of a person whom several heads see, the row of the head that sees most.
    order = np.lexsort((-every.visible, every.track_id, every.frame))
    rows = every.where(order)
    first = np.r_[True, (np.diff(rows.frame) != 0) | (np.diff(rows.track_id) != 0)]
    return rows.where(first)
