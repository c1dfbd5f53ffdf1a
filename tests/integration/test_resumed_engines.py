"""Every engine, resumed from its state at several moments: the tracks of the run that was not interrupted."""

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from crossing_video import CAMERA, CrossingVideo

from planview.engine.engine import Engine
from planview.engine.one_camera import one_camera_engine
from planview.engine.open import open_engine
from planview.engine.replay import replay_engine
from planview.engine.setup import set_up
from planview.engine.stereo import stereo_engine
from planview.maps.recording import MapsRecording
from planview.output.maps_log import MapsLog
from planview.output.state import SavedState, decode, encode
from planview.tracking.ellipse_particle import EllipseParticleTracker
from planview.tracking.human_model import HumanModelParams
from planview.tracking.human_model.model_map import HumanModelMapParams, build_model_map
from planview.tracking.human_model.tracker import HumanModelTracker
from planview.tracking.joint import JointTracker

PARAMS = HumanModelParams(map=HumanModelMapParams(min_height_px=12))
MAP = build_model_map(CAMERA, params=PARAMS.map)


def through_a_file(state: SavedState) -> SavedState:
    """As it comes back: JSON, and memory of its own."""
    roots, nodes = json.loads(json.dumps([state.roots, state.nodes]))
    return SavedState(roots, nodes, [array.copy() for array in state.arrays])


def assert_resumes(make: Callable[[], Engine], moments: tuple[int, ...]) -> None:
    """Resume a run at each of the moments (frames) and compare all that follows, bit for bit."""
    engine = make()
    engine.reset()
    lines, saved = [], {}
    for n, result in enumerate(engine.after(-1)):
        lines.append(repr((result.frame, result.tracks, result.decisions)))
        if n in moments:
            saved[n] = result.frame, through_a_file(encode(engine.memory()))
    assert any("confirmed" in line for line in lines)
    for n, (frame, memory) in saved.items():
        fresh = make()
        fresh.reset()
        decode(memory, fresh.memory())
        assert [repr((r.frame, r.tracks, r.decisions)) for r in fresh.after(frame)] == lines[n + 1 :]


def moments(seed: int, first: int, last: int, count: int = 3) -> tuple[int, ...]:
    return tuple(int(n) for n in np.random.default_rng(seed).integers(first, last, count))


def test_a_stereo_engine_resumes(engine: Engine) -> None:
    c, setup = engine.config, set_up(engine.recording, engine.config)
    assert_resumes(lambda: stereo_engine(engine.recording, c, JointTracker(c.joint), setup=setup), moments(1, 8, 35))


@pytest.mark.slow
def test_the_engine_of_two_rigs_resumes(engine: Engine, heads: Path) -> None:
    assert_resumes(lambda: open_engine(heads, config=engine.config), moments(5, 8, 35, 2))


def test_the_engine_of_recorded_maps_resumes(engine: Engine, tmp_path: Path) -> None:
    log = MapsLog(engine, tmp_path / "maps.h5")
    for result in engine:
        log.frame(result)
    log.close()

    def make() -> Engine:
        return replay_engine(MapsRecording(tmp_path / "maps.h5"), JointTracker(engine.config.joint))

    assert_resumes(make, moments(2, 8, 35))


def test_the_engine_of_one_camera_resumes() -> None:
    def make() -> Engine:
        return one_camera_engine(CrossingVideo(), HumanModelTracker(PARAMS, CAMERA, MAP), camera=CAMERA)

    assert_resumes(make, moments(3, 2, 58))


@pytest.mark.parametrize("overview", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_the_ellipse_engine_of_one_camera_resumes(overview: bool) -> None:
    assert_resumes(
        lambda: one_camera_engine(CrossingVideo(), EllipseParticleTracker(), overview=overview), moments(4, 2, 58)
    )
