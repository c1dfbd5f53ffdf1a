"""Floors of rendered rooms, at every tilt of the camera."""

import math

import numpy as np
import pytest

from calib.rig import Floor
from planview.synthetic.assets import SCENES
from planview.synthetic.render import SceneRenderer
from planview.synthetic.scene import load_scene
from stereo.floor import FloorSearch, PairFrames
from stereo.recording import Frame, StereoPair
from stereo.viewpoint import STANDS, SpreadView

FRAMES = 6


@pytest.mark.slow
@pytest.mark.parametrize("tilt_deg", [0, 15, 30, 45, 60, 75])
def test_floor_of_a_rendered_room_is_found(tilt_deg):
    scene = load_scene(SCENES / "demo.toml")
    # Steep cameras hang above the middle of the room, flat ones at its wall.
    place_m = (3.5, 2.0, 2.9) if tilt_deg < 50 else (3.5, 0.2, 2.6)
    mount = scene.mount.model_copy(update={"tilt_deg": float(tilt_deg), "at_m": place_m})
    renderer = SceneRenderer(scene.model_copy(update={"rig": mount}))
    frames = []
    for index in np.linspace(0, renderer.n_frames - 1, FRAMES).astype(int).tolist():
        rendered = renderer.frame(index)
        frames.append(Frame(index, rendered.timestamp_s, ((rendered.left, rendered.right),)))
    found = PairFrames(StereoPair(renderer.rig), frames, FloorSearch(), SpreadView(FRAMES, [], {}, STANDS)).floor()
    true = Floor(renderer.world_SE3_left)
    assert found.height_m == pytest.approx(true.height_m, abs=0.02)
    assert math.degrees(found.tilt_rad) == pytest.approx(math.degrees(true.tilt_rad), abs=0.3)
    assert math.degrees(found.roll_rad) == pytest.approx(math.degrees(true.roll_rad), abs=0.3)
