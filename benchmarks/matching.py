"""Disparity compared with rendered truth: the engine's matcher, and OpenCV's StereoSGBM at full size."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import cv2
import numpy as np
from cyclopts import Parameter

from benchmarks.options import JsonFlag, progress, report, scene_files
from calib.images import as_grey
from calib.types import F32, I32, U8, Bool
from planview.synthetic.render import SceneRenderer
from planview.synthetic.scene import Scene, load_scene
from stereo.depth import RectifiedGeometry
from stereo.matcher import DisparityRange, Matcher, SgbmMatcher, disparity_range

INLIER_PX = 1.0
"""Errors beyond it are bad pixels, and do not count for the rms."""
RING_PX = 5
"""How far around bodies fattening is looked for."""


class RenderedPair(NamedTuple):
    """A pair of ideal pinholes, (H, W): grey images; true disparity [px], 0 where nothing is; owners of pixels,
    positive on people, 0 in the room."""

    left: U8
    right: U8
    disparity: F32
    owner: I32


class FullSize:
    """OpenCV's StereoSGBM (three-way, blocks of 5 x 5, checks as ours) on the images as they are."""

    def __init__(self, searched: DisparityRange) -> None:
        area = 25
        self._pad = searched.first_px + searched.count
        self._sgbm = cv2.StereoSGBM.create(
            searched.first_px, searched.count, 5, 8 * area, 32 * area, 1, 31, 8, 100, 1, cv2.STEREO_SGBM_MODE_SGBM_3WAY
        )

    def __call__(self, left_grey: U8, right_grey: U8) -> F32:
        """(H, W) float32 disparity [px], NaN where there is none."""
        padded = (cv2.copyMakeBorder(i, 0, 0, self._pad, 0, cv2.BORDER_REPLICATE) for i in (left_grey, right_grey))
        found = np.asarray(self._sgbm.compute(*padded)[:, self._pad :], dtype=np.float32) / np.float32(16)
        return np.where(found > 0, found, np.float32(np.nan))


def ideal(scene: Scene) -> Scene:
    """A scene whose rig needs no rectification."""
    assert scene.rig is not None
    plain = {"right_rotation_deg": (0.0, 0.0, 0.0), "right_offset_m": (0.0, 0.0), "centre_offset_px": (0.0, 0.0)}
    return scene.model_copy(update={"rig": scene.rig.model_copy(update={**plain, "distortion": (), "aspect": 1.0})})


def rendered_pairs(scene: Scene, count: int) -> tuple[RectifiedGeometry, Iterator[RenderedPair]]:
    """The geometry of an ``ideal`` scene, and pairs spread over it."""
    renderer = SceneRenderer(scene)
    assert renderer.rig is not None
    camera = renderer.rig.left
    geometry = RectifiedGeometry(*camera.size, camera.fx, camera.fy, camera.cx, camera.cy, renderer.rig.baseline_m)

    def pairs() -> Iterator[RenderedPair]:
        for index in np.linspace(0, renderer.n_frames - 1, count + 2).astype(int)[1:-1]:
            frame = renderer.frame(int(index))
            assert frame.right is not None
            disparity = (geometry.disparity_metre / frame.depth).astype(np.float32)
            yield RenderedPair(as_grey(frame.left), as_grey(frame.right), disparity, frame.owner)

    return geometry, pairs()


def matching_errors(found: F32, pair: RenderedPair) -> dict[str, tuple[F32, Bool]]:
    """By surface, errors [px] and which of them are bad: bodies, the room, and the room next to nearer bodies, where
    what is nearer than it by over a pixel is bad (foreground fattening)."""
    error = found - pair.disparity
    u = np.arange(error.shape[1])
    body, room = pair.owner > 0, (pair.owner == 0) & (pair.disparity > 0)
    near = cv2.dilate(np.where(body, pair.disparity, 0), np.ones((2 * RING_PX + 1, 2 * RING_PX + 1), np.uint8))
    ring = room & (near > pair.disparity + 2) & (pair.disparity < u)
    bad = np.abs(error) > INLIER_PX
    return {
        "bodies": (error[body], bad[body]),
        "room": (error[room & (near == 0)], bad[room & (near == 0)]),
        "ring": (error[ring], (error > INLIER_PX)[ring]),
    }


def score_matching(path: Path, count: int) -> list[dict[str, Any]]:
    """Rows by matcher of one scene."""
    progress(f"rendering {count} pairs of {path.stem}")
    geometry, pairs = rendered_pairs(ideal(load_scene(path)), count)
    matchers: dict[str, Matcher] = {
        "planview": SgbmMatcher(geometry),
        "full-size SGBM": FullSize(disparity_range(geometry)),
    }
    parts: dict[str, list[dict[str, tuple[F32, Bool]]]] = {name: [] for name in matchers}
    for pair in pairs:
        for name, matcher in matchers.items():
            parts[name].append(matching_errors(matcher(pair.left, pair.right), pair))
    rows = []
    for name, frames in parts.items():
        row: dict[str, Any] = {"scene": path.stem, "matcher": name}
        for surface in ("bodies", "room", "ring"):
            error, bad = (np.concatenate([frame[surface][k] for frame in frames]) for k in (0, 1))
            known = np.isfinite(error)
            if surface != "ring":
                inlier = error[known & ~bad]
                row |= {f"{surface}_rms_px": float(np.sqrt(np.mean(inlier**2))), f"{surface}_mean_px": inlier.mean()}
                row |= {f"{surface}_bad": float(bad[known].mean()), f"{surface}_unknown": float((~known).mean())}
            else:
                row["fattened"] = float(bad.mean())
        rows.append(row)
    return rows


@Parameter(name="*")
@dataclass(frozen=True)
class MatchingOptions:
    """What is rendered."""

    scene: Annotated[Sequence[str], Parameter(negative="")] = ("demo", "office", "overhead")
    """Committed scenes, by name."""
    frames: int = 12
    """Pairs of each."""
    json_output: JsonFlag = False
    """Print one JSON object."""


def matching(*, options: MatchingOptions | None = None) -> None:
    """Compare disparity with rendered truth: on bodies, in the room, and next to bodies.

    Example: python -m benchmarks matching --scene demo
    """
    o = options or MatchingOptions()
    report(o.json_output, rows=[row for path in scene_files(o.scene) for row in score_matching(path, o.frames)])
