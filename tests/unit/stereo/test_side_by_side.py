from pathlib import Path

import cv2
import numpy as np
import pytest
from toy_recordings import textured, write_frames
from toy_stereo import toy_rig

from calib.errors import InputError
from calib.rig import save_rig
from stereo.readers import open_recording
from stereo.readers.side_by_side import Packing, find_packing

W, H = 320, 240


LEFT, RIGHT = textured(), textured(12)


@pytest.mark.parametrize("stack", [np.hstack, np.vstack], ids=["side by side", "stacked"])
@pytest.mark.parametrize("squeezed", [False, True])
def test_packing_is_found_from_what_the_views_share(stack, squeezed: bool) -> None:
    picture = cv2.resize(stack([LEFT, RIGHT]), (W, H)) if squeezed else stack([LEFT, RIGHT])
    found, shared = find_packing([picture], W / H if squeezed else None)
    assert found == Packing(stack is np.vstack, squeezed) and shared.matched > 0.3 * shared.corners
    assert found.size((picture.shape[1], picture.shape[0])) == (W, H)


def test_picture_of_one_camera_is_no_packing() -> None:
    found, shared = find_packing([textured()], None)
    assert found is None and shared.matched < 0.05 * shared.corners


def test_first_view_is_the_left_one_whatever_it_shows(tmp_path: Path) -> None:
    write_frames(tmp_path / "pair.avi", [np.hstack([RIGHT, LEFT])] * 3)
    save_rig(toy_rig((W, H)), tmp_path / "rig.toml")
    recording = open_recording(tmp_path)
    frame = next(iter(recording))
    assert frame.image.shape == (H, W) and not recording.notes
    assert np.abs(frame.image.astype(int) - RIGHT).mean() < 10 < np.abs(frame.images[1].astype(int) - RIGHT).mean()


def test_depth_next_to_its_image_is_refused(tmp_path: Path) -> None:
    colour = cv2.applyColorMap(textured(), cv2.COLORMAP_JET)
    rng = np.random.default_rng(5)
    depth = cv2.resize(rng.integers(0, 255, (30, 40), dtype=np.uint8), (W, H), interpolation=cv2.INTER_NEAREST)
    write_frames(tmp_path / "pair.avi", [np.hstack([cv2.cvtColor(depth, cv2.COLOR_GRAY2BGR), colour])] * 3)
    with pytest.raises(InputError, match=r"grey and a coloured half .* depth next to its colour image"):
        open_recording(tmp_path / "pair.avi")
