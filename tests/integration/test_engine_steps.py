"""Engines driven frame by frame: ``step`` is what iteration does."""

import pytest
from crossing_video import CAMERA, CrossingVideo
from toy_run import EMPTY

from planview.engine.engine import Engine, FrameResult
from planview.engine.one_camera import one_camera_engine
from planview.tracking.ellipse_particle import EllipseParticleTracker

SHOWN = EMPTY + 12


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
    engine = one_camera_engine(CrossingVideo(), EllipseParticleTracker())
    assert [r.tracks for r in stepped(engine, CrossingVideo.n_frames)] == [r.tracks for r in engine]


@pytest.mark.parametrize("known", [True, False])
def test_an_engine_without_stereo_says_what_it_knows_of_its_camera(known: bool) -> None:
    engine = one_camera_engine(CrossingVideo(), EllipseParticleTracker(), camera=CAMERA if known else None)
    assert engine.stereo is None
    assert (engine.camera_info() is not None, engine.floor_info() is not None) == (known, known)
