"""Every engine, taken up again from its memory at several moments: the tracks of the run that was not interrupted."""

import json
import math
from collections.abc import Callable, Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest

from calib.ground_camera import GroundCamera
from calib.people.model import HumanModel
from calib.types import U8
from planview.engine.engine import Engine
from planview.engine.maps_pipeline import MapsPipeline
from planview.engine.pipeline import Pipeline
from planview.engine.single_camera_pipeline import SingleCameraPipeline
from planview.maps.recording import MapsRecording
from planview.output.checkpoint.decode import decode
from planview.output.checkpoint.encode import Encoded, encode
from planview.output.maps_log import MapsLog
from planview.tracking.ellipse_particle import floor_ellipse_tracker, image_ellipse_tracker
from planview.tracking.human_model import HumanModelParams, HumanModelTracker
from planview.tracking.human_model.model_map import HumanModelMapParams, build_model_map
from planview.tracking.template import TemplateTracker
from stereo.recording import Skipped, VideoFrame

CAMERA = GroundCamera(160, 120, 120.0, 4.0, math.radians(62))
PARAMS = HumanModelParams(map=HumanModelMapParams(min_height_px=12))
MAP = build_model_map(CAMERA, params=PARAMS.map)


class CrossingVideo:
    """Two people of one camera who cross, before a noisy wall; empty for a second."""

    path, n_frames, fps, size = Path("crossing"), 60, 10.0, (160, 120)
    skipped: tuple[Skipped, ...] = ()

    def __iter__(self) -> Iterator[VideoFrame]:
        rng = np.random.default_rng(5)
        for i in range(self.n_frames):
            image = np.clip(128 + rng.normal(0, 2, (120, 160, 3)), 0, 255).astype(np.uint8)
            if i >= 10:
                self._paint(image, (i - 10) / self.fps)
            yield VideoFrame(i, i / self.fps, image)

    def _paint(self, image: U8, t: float) -> None:
        for x, y, colour in ((0.8 * t - 2, 6.0, (20, 20, 200)), (2 - 0.8 * t, 7.0, (200, 40, 20))):
            hull = HumanModel().hull(CAMERA, x, y)
            cv2.fillConvexPoly(image, np.rint(hull).astype(np.int32), colour)


def through_a_file(encoded: Encoded) -> Encoded:
    """As it comes back: JSON, and memory of its own."""
    roots, nodes = json.loads(json.dumps([encoded.roots, encoded.nodes]))
    return Encoded(roots, nodes, [block.copy() for block in encoded.blocks])


def assert_resumes(make: Callable[[], Engine], moments: tuple[int, ...]) -> None:
    """Take up a run anew at each of the moments (frames) and compare all that follows, bit for bit."""
    engine = make()
    engine.reset()
    told, saved = [], {}
    for n, result in enumerate(engine.after(-1)):
        told.append(repr((result.frame, result.tracks, result.decisions)))
        if n in moments:
            saved[n] = result.frame, through_a_file(encode(engine.memory()))
    assert any("confirmed" in line for line in told)
    for n, (frame, memory) in saved.items():
        fresh = make()
        fresh.reset()
        decode(memory, fresh.memory())
        assert [repr((r.frame, r.tracks, r.decisions)) for r in fresh.after(frame)] == told[n + 1 :]


def moments(seed: int, first: int, last: int, count: int = 3) -> tuple[int, ...]:
    return tuple(int(n) for n in np.random.default_rng(seed).integers(first, last, count))


@pytest.mark.parametrize("tracker", ["template", "ellipse"])
def test_a_stereo_engine_resumes(engine: Pipeline, tracker: str) -> None:
    def make() -> Engine:
        c = engine.config
        chosen = TemplateTracker(c.template) if tracker == "template" else floor_ellipse_tracker(c.ellipse_particle, 3)
        return Pipeline(engine.recording, engine.setup, c, chosen)

    assert_resumes(make, moments(1, 8, 35))


def test_the_engine_of_recorded_maps_resumes(engine: Pipeline, tmp_path: Path) -> None:
    log = MapsLog(engine, tmp_path / "maps.h5")
    for result in engine:
        log.frame(result)
    log.close()

    def make() -> Engine:
        return MapsPipeline(MapsRecording(tmp_path / "maps.h5"), TemplateTracker(engine.config.template))

    assert_resumes(make, moments(2, 8, 35))


def test_the_engine_of_one_camera_resumes() -> None:
    def make() -> Engine:
        return SingleCameraPipeline(CrossingVideo(), HumanModelTracker(PARAMS, CAMERA, MAP), camera=CAMERA)

    assert_resumes(make, moments(3, 2, 58, 3))


@pytest.mark.parametrize("compose", [SingleCameraPipeline, SingleCameraPipeline.from_recording])
def test_the_ellipse_engine_of_one_camera_resumes(compose: Callable[..., Engine]) -> None:
    def make() -> Engine:
        return compose(CrossingVideo(), image_ellipse_tracker())

    assert_resumes(make, moments(4, 2, 58, 3))
