"""Layouts of board images on disk."""

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
import pytest

from calib.errors import InputError
from planview.calibration.board import BoardImages


def save(folder: Path, names: Sequence[str], size: tuple[int, int] = (40, 30)) -> Path:
    for i, name in enumerate(names):
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        cv2.imwrite(str(path), np.full((size[1], size[0]), 10 * i + 5, dtype=np.uint8))
    return folder


def values(images: BoardImages) -> list[tuple[int, int]]:
    """Grey values of the pairs: which file went where."""
    return [(int(p.left[0, 0]), int(p.right[0, 0])) for p in images if p.left is not None and p.right is not None]


@pytest.mark.parametrize(
    "names",
    [
        ("left01.png", "left02.png", "right01.png", "right02.png"),
        ("left/1.png", "left/2.png", "right/1.png", "right/2.png"),
        ("cam0/a.png", "cam0/b.png", "cam1/a.png", "cam1/b.png"),
        ("Im_L_1.png", "Im_L_2.png", "Im_R_1.png", "Im_R_2.png"),
        ("L1.png", "L2.png", "R1.png", "R2.png"),
        ("cam0_img1.png", "cam0_img2.png", "cam1_img1.png", "cam1_img2.png"),
        ("1_left.png", "10_left.png", "1_right.png", "10_right.png"),
        ("leftcamera/Im_L_1.png", "leftcamera/Im_L_2.png", "rightcamera/Im_R_1.png", "rightcamera/Im_R_2.png"),
    ],
)
def test_pairs_are_found_in_folders_and_by_name(names: Sequence[str], tmp_path: Path) -> None:
    assert values(BoardImages(save(tmp_path, names))) == [(5, 25), (15, 35)]


def test_an_image_without_a_mate_is_named(tmp_path: Path) -> None:
    images = BoardImages(save(tmp_path, ["left1.png", "left2.png", "left3.png", "right1.png", "right3.png"]))
    assert [(p.name, p.why) for p in images if p.left is None] == [("left2.png", "has no mate from the other camera")]
    assert values(images) == [(5, 35), (25, 45)]


def test_wide_images_are_split_in_halves(tmp_path: Path) -> None:
    picture = np.hstack([np.full((30, 40), 7, np.uint8), np.full((30, 40), 9, np.uint8)])
    cv2.imwrite(str(tmp_path / "a.png"), picture)
    assert values(BoardImages(tmp_path)) == [(7, 9)]


def test_images_that_are_neither_named_nor_wide_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"expected a left and a right image side by side .* found 40x30"):
        list(BoardImages(save(tmp_path, ["a.png"])))


def test_an_image_that_cannot_be_decoded_is_named(tmp_path: Path) -> None:
    save(tmp_path, ["left1.png", "right1.png"])
    (tmp_path / "left1.png").write_bytes(b"\x89PNG broken")
    (pair,) = BoardImages(tmp_path)
    assert pair.why.endswith("left1.png cannot be decoded")


def test_a_side_by_side_video_gives_named_frames(tmp_path: Path) -> None:
    writer = cv2.VideoWriter(str(tmp_path / "v.avi"), cv2.VideoWriter.fourcc(*"MJPG"), 10, (160, 48))
    for _ in range(6):
        writer.write(np.zeros((48, 160, 3), np.uint8))
    writer.release()
    images = BoardImages(tmp_path / "v.avi")
    assert images.names[0] == "frame 0"
    assert [pair.left.shape[:2] for pair in images if pair.left is not None] == [(48, 80)] * 6


@pytest.mark.parametrize("names", [[], ["left/1.png"], ["left/1.png", "left2/1.png", "right/1.png"]])
def test_folders_without_pairs_are_refused(names: Sequence[str], tmp_path: Path) -> None:
    with pytest.raises(InputError, match="expected"):
        BoardImages(save(tmp_path, names))


def test_a_path_that_is_not_there_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="expected a folder of board images or a video"):
        BoardImages(tmp_path / "none")
