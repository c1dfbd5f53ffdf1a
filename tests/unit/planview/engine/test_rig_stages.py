"""What a rig is refused for before its first frame."""

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from toy_rgbd import CAMERA

from calib.errors import InputError
from calib.pose import SE3
from calib.rig import Floor
from planview.engine.config import Config
from planview.engine.setup import Setup
from planview.engine.stereo import stereo_engine
from stereo.rgbd import RgbdRectifier


def test_a_floor_that_the_camera_does_not_see_is_refused_by_name() -> None:
    rectifier = RgbdRectifier(CAMERA, "structured-light")
    upwards = Floor(SE3(np.eye(3), np.array([0.0, 0.0, 3.0])))
    setup = Setup(rectifier, upwards, rectifier.disparities(), "world.toml", "calib.json", "structured-light")
    with pytest.raises(InputError, match=r"hall \(floor: world.toml\): expected a camera that sees"):
        stereo_engine(cast(Any, SimpleNamespace(path="hall")), Config(), setup=setup)
