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
from stereo.readers.state import common, find_order, rectified_rig, settled

W, H = 320, 240


LEFT, RIGHT = textured(), textured(12)


@pytest.mark.parametrize("stack", [np.hstack, np.vstack], ids=["side by side", "stacked"])
@pytest.mark.parametrize("squeezed", [False, True])
def test_packing_is_found_from_what_the_views_share(stack, squeezed: bool) -> None:
    picture = cv2.resize(stack([LEFT, RIGHT]), (W, H)) if squeezed else stack([LEFT, RIGHT])
    found, shared = find_packing([picture], W / H if squeezed else None)
    assert found == Packing(stack is np.vstack, squeezed) and len(shared.matches) > 0.3 * shared.corners
    assert found.size((picture.shape[1], picture.shape[0])) == (W, H)


def test_picture_of_one_camera_is_no_packing() -> None:
    found, shared = find_packing([textured()], None)
    assert found is None and len(shared.matches) < 0.05 * shared.corners


@pytest.mark.parametrize("swapped", [False, True])
def test_order_is_found_by_which_corners_lie_nearer_than_infinity(swapped: bool) -> None:
    picture = np.hstack([RIGHT, LEFT] if swapped else [LEFT, RIGHT])
    rig = toy_rig((W, H))
    order = find_order(common([Packing(False, False).split(picture)]).matches, rig, rig)
    assert order is not None and order.swapped == swapped and not order.rectified


def test_images_whose_rows_agree_already_are_rectified() -> None:
    turned = toy_rig((W, H), rotation_deg=(3.0, 0.0, 0.0))
    rectified, assumed = rectified_rig(lambda: turned, turned)
    order = find_order(common([(LEFT, RIGHT)]).matches, turned, rectified)
    assert order is not None and order.rectified and not order.swapped
    assert "alpha 0" in assumed and rectified.baseline_m == pytest.approx(turned.baseline_m)


def test_swapped_video_is_exchanged_with_a_note(tmp_path: Path) -> None:
    write_frames(tmp_path / "pair.avi", [np.hstack([RIGHT, LEFT])] * 3)
    save_rig(toy_rig((W, H)), tmp_path / "rig.toml")
    recording = open_recording(tmp_path)
    frame = next(iter(recording))
    assert frame.image.shape == (H, W)
    assert np.abs(frame.image.astype(int) - LEFT).mean() < 10 < np.abs(frame.images[1].astype(int) - LEFT).mean()
    assert "left and right are exchanged" in recording.notes[0]


def test_depth_next_to_its_image_is_refused(tmp_path: Path) -> None:
    colour = cv2.applyColorMap(textured(), cv2.COLORMAP_JET)
    rng = np.random.default_rng(5)
    depth = cv2.resize(rng.integers(0, 255, (30, 40), dtype=np.uint8), (W, H), interpolation=cv2.INTER_NEAREST)
    write_frames(tmp_path / "pair.avi", [np.hstack([cv2.cvtColor(depth, cv2.COLOR_GRAY2BGR), colour])] * 3)
    with pytest.raises(InputError, match=r"grey and a coloured half .* depth next to its colour image"):
        open_recording(tmp_path / "pair.avi")


def test_images_in_another_state_than_their_calibration_get_its_other_rig() -> None:
    turned, ideal = toy_rig((W, H), rotation_deg=(3.0, 0.0, 0.0)), toy_rig((W, H))
    rig, note = settled([(LEFT, RIGHT)], turned, ideal, "assumed")
    assert rig is ideal and note.startswith("the images are rectified already (rows differ by 0.") and "assumed" in note
    assert settled([(LEFT, RIGHT)], ideal, turned, "") == (ideal, "")
    low = np.roll(RIGHT, 6, axis=0)
    assert "raw images need the raw calibration" in settled([(LEFT, low)], ideal, ideal, "")[1]
