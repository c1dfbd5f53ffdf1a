import cv2
import numpy as np
import pytest
from toy_recordings import textured, write_frames
from toy_stereo import toy_rig

from calib.rig import save_rig
from stereo.readers import open_recording
from stereo.readers.side_by_side import Packing, find_packing

W, H = 320, 240


LEFT, RIGHT = textured(), textured(12)


@pytest.mark.parametrize("stack", [np.hstack, np.vstack], ids=["side by side", "stacked"])
@pytest.mark.parametrize("squeezed", [False, True])
def test_packing_is_found_from_what_the_views_share(stack, squeezed):
    picture = cv2.resize(stack([LEFT, RIGHT]), (W, H)) if squeezed else stack([LEFT, RIGHT])
    found = find_packing([picture], W / H if squeezed else None)
    assert found == Packing(stack is np.vstack, squeezed)
    assert found.size((picture.shape[1], picture.shape[0])) == (W, H)


def test_picture_of_one_camera_is_no_packing():
    assert find_packing([textured()], None) is None


def test_first_view_is_the_left_one_whatever_it_shows(tmp_path):
    write_frames(tmp_path / "pair.avi", [np.hstack([RIGHT, LEFT])] * 3)
    save_rig(toy_rig((W, H)), tmp_path / "rig.toml")
    recording = open_recording(tmp_path)
    frame = next(iter(recording))
    assert frame.image.shape == (H, W)
    assert not recording.notes
    assert np.abs(frame.image.astype(int) - RIGHT).mean() < 10 < np.abs(frame.images[1].astype(int) - RIGHT).mean()
