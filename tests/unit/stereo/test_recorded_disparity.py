from pathlib import Path

import cv2
import numpy as np
import pytest

from calib.errors import InputError
from stereo.depth import RectifiedGeometry
from stereo.recorded import RecordedDisparity, load_disparity

GEOMETRY = RectifiedGeometry(8, 6, 100.0, 100.0, 4.0, 3.0, 0.1)
BLANK = np.zeros((6, 8), np.uint8)


def test_png_holds_256ths_and_zero_is_invalid(tmp_path: Path) -> None:
    values = np.full((6, 8), 2560, np.uint16)
    values[0, 0] = 0
    cv2.imwrite(str(tmp_path / "000000.png"), values)
    disparity = RecordedDisparity(tmp_path, GEOMETRY)(BLANK, BLANK)
    assert disparity.dtype == np.float32
    assert np.isnan(disparity[0, 0]) and disparity[1, 1] == 10.0


def test_files_follow_the_frame_index(tmp_path: Path) -> None:
    for i in range(4):
        np.save(tmp_path / f"{i:03d}.npy", np.full((6, 8), 1.0 + i, np.float32))
    matcher = RecordedDisparity(tmp_path, GEOMETRY)
    assert matcher(BLANK, BLANK)[0, 0] == 1.0
    assert matcher(BLANK, BLANK)[0, 0] == 2.0
    matcher.index = 3
    assert matcher(BLANK, BLANK)[0, 0] == 4.0
    with pytest.raises(InputError, match="frame 4, found 4 files"):
        matcher(BLANK, BLANK)


def test_larger_disparities_are_scaled_to_the_working_size(tmp_path: Path) -> None:
    np.savez(tmp_path / "a.npz", np.full((12, 16), 20.0))
    disparity = load_disparity(tmp_path / "a.npz", GEOMETRY)
    assert disparity.shape == (6, 8) and disparity[2, 2] == 10.0


def test_other_shapes_are_refused(tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", np.zeros((6, 9)))
    with pytest.raises(InputError, match=r"\(6, 8\) or a whole multiple, found \(6, 9\)"):
        load_disparity(tmp_path / "a.npy", GEOMETRY)


def test_pickles_are_never_loaded(tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", np.array([[{"a": 1}]], dtype=object), allow_pickle=True)
    np.savez(tmp_path / "b.npz", np.array([[{"a": 1}]], dtype=object))
    for name in ("a.npy", "b.npz"):
        with pytest.raises(InputError, match="expected a disparity image"):
            load_disparity(tmp_path / name, GEOMETRY)


@pytest.mark.parametrize("name", ["a.npy", "a.npz", "a.png"])
@pytest.mark.parametrize("content", [b"", b"garbage", b"\x93NUMPY\x01\x00", b"PK\x03\x04 no"])
def test_garbage_is_refused(tmp_path: Path, name: str, content: bytes) -> None:
    (tmp_path / name).write_bytes(content)
    with pytest.raises(InputError, match="expected a disparity image"):
        load_disparity(tmp_path / name, GEOMETRY)


def test_huge_archives_are_refused_before_they_are_unpacked(tmp_path: Path) -> None:
    np.savez_compressed(tmp_path / "bomb.npz", np.zeros((4000, 4000)))
    with pytest.raises(InputError, match="no array of at most"):
        load_disparity(tmp_path / "bomb.npz", GEOMETRY)


def test_empty_folder_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="found none"):
        RecordedDisparity(tmp_path, GEOMETRY)
    with pytest.raises(InputError, match="found none"):
        RecordedDisparity(tmp_path / "absent", GEOMETRY)
