"""Engines driven frame by frame: ``step`` is what iteration does."""

from pathlib import Path

import numpy as np
import pytest
from toy_run import EMPTY

from calib.types import U8
from planview.engine.engine import Engine, FrameResult
from planview.engine.one_camera import one_camera_engine
from planview.tracking.ellipse_particle import EllipseParticleTracker
from stereo.recording import Skipped, VideoFrame

SHOWN = EMPTY + 12


class SquareVideo:
    """A dark square that walks over a grey image from frame 3 on."""

    path, n_frames, fps, size = Path("square"), 12, 10.0, (160, 120)
    skipped: tuple[Skipped, ...] = ()

    def __iter__(self):
        for i in range(self.n_frames):
            yield VideoFrame(i, i / self.fps, self.image(i))

    def image(self, i: int) -> U8:
        image = np.full((120, 160, 3), 150, np.uint8)
        if i >= 3:
            image[40:90, 4 * i : 4 * i + 20] = 40
        return image


def stepped(engine: Engine, frames: int) -> list[FrameResult]:
    engine.reset()
    return [engine.step(frame) for frame, _ in zip(engine.recording, range(frames), strict=False)]  # type: ignore[call-overload]


def test_steps_of_a_stereo_engine_give_the_tracks_of_its_iteration(engine: Engine) -> None:
    iterated = [result.tracks for result, _ in zip(engine, range(SHOWN), strict=False)]
    assert any(iterated)
    assert [result.tracks for result in stepped(engine, SHOWN)] == iterated


def test_a_stereo_step_is_timed_by_stage_without_reading(engine: Engine) -> None:
    (result,) = stepped(engine, 1)
    assert list(result.stages_ms) == ["rectify", "match", "foreground", "maps", "track"]


def test_reset_forgets_the_background_of_a_stereo_engine(engine: Engine) -> None:
    stepped(engine, EMPTY + 3)
    assert not stepped(engine, 1)[0].observation.foreground.any()


def test_steps_of_a_single_camera_engine_give_the_tracks_of_its_iteration() -> None:
    engine = one_camera_engine(SquareVideo(), EllipseParticleTracker())
    assert [r.tracks for r in stepped(engine, 12)] == [r.tracks for r in engine]


@pytest.mark.parametrize("known", [True, False])
def test_an_engine_without_stereo_says_what_it_knows_of_its_camera(known: bool) -> None:
    from calib.ground_camera import GroundCamera

    camera = GroundCamera(160, 120, 130.0, 4.0, 1.0) if known else None
    engine = one_camera_engine(SquareVideo(), EllipseParticleTracker(), camera=camera)
    assert engine.stereo is None
    assert (engine.camera_info() is not None, engine.floor_info() is not None) == (known, known)
