"""Boards: what the user types, where corners are found, and in which order."""

import cv2
import numpy as np
import pytest

from benchmarks.calibration import board_views, random_rig
from calib.board.detect import (
    Board,
    Corners,
    Detector,
    complete_charuco,
    dictionaries,
    find_counts,
    larger_counts,
    parse_board,
    parse_square,
    same_order,
)
from calib.board.fit import select_views, sharpness
from calib.errors import InputError
from calib.types import U8

PX = 30


def drawn(cols: int, rows: int) -> U8:
    """A chessboard from straight ahead: corner (0, 0) at pixel (3 PX - 0.5, 3 PX - 0.5)."""
    y, x = np.mgrid[: (rows + 1) * PX, : (cols + 1) * PX]
    board = (((x // PX + y // PX) % 2) * 200 + 25).astype(np.uint8)
    framed = cv2.copyMakeBorder(board, 2 * PX, 2 * PX, 2 * PX, 2 * PX, cv2.BORDER_CONSTANT, value=225)
    return np.asarray(cv2.GaussianBlur(framed, (0, 0), 0.8), dtype=np.uint8)


def test_corners_are_found_to_a_hundredth_of_a_pixel() -> None:
    corners = Detector(Board(8, 5, 0.03))(drawn(8, 5))
    assert corners is not None
    expected = Board(8, 5, 0.1).points[:, :2] / 0.1 * PX + 3 * PX - 0.5
    away = [np.abs(order - expected).max() for order in (corners.pixels, corners.pixels[::-1])]
    assert min(away) < 0.01


def test_corners_of_a_board_in_a_small_image_are_found_at_its_own_pixels() -> None:
    image = np.asarray(cv2.resize(drawn(9, 6), None, fx=1 / 3, fy=1 / 3, interpolation=cv2.INTER_AREA), dtype=np.uint8)
    corners = Detector(Board(9, 6, 0.025))(image)
    assert corners is not None
    expected = Board(9, 6, 0.1).points[:, :2] / 0.1 * PX / 3 + PX - 0.5
    assert min(np.abs(order - expected).max() for order in (corners.pixels, corners.pixels[::-1])) < 0.1


def test_counts_of_a_board_are_found_and_a_part_is_told_from_the_whole() -> None:
    images = [drawn(8, 5)] * 3
    assert find_counts(images) == (8, 5)
    assert larger_counts(images, (4, 3)) == (8, 5)
    assert larger_counts(images, (5, 8)) is None


def test_no_board_is_found_in_blank_and_noisy_images() -> None:
    noise = np.random.default_rng(0).integers(0, 255, (120, 160)).astype(np.uint8)
    blank = np.full((120, 160), 90, np.uint8)
    assert find_counts([blank, noise]) is None
    assert Detector(Board(7, 5, 0.03))(blank) is None


def test_order_of_a_board_that_looks_alike_upside_down_follows_the_other_camera() -> None:
    board = Board(7, 5, 0.03)
    pixels = board.points[:, :2] * 1000
    left = Corners(np.arange(35), pixels)
    right = Corners(np.arange(35), pixels[::-1] - [20.0, 0.0])
    np.testing.assert_allclose(same_order(board, left, right).pixels, pixels - [20.0, 0.0])


def test_order_of_a_square_board_is_right_by_a_quarter_turn() -> None:
    board = Board(4, 4, 0.03)
    pixels = board.points[:, :2] * 1000
    quarter = np.rot90(pixels.reshape(4, 4, 2), 1).reshape(-1, 2)
    turned = same_order(board, Corners(np.arange(16), pixels), Corners(np.arange(16), quarter))
    np.testing.assert_allclose(turned.pixels, pixels)


def charuco(name: str) -> tuple[Board, U8]:
    board = Board(6, 4, 0.04, name, 0.03)
    made = cv2.aruco.CharucoBoard((7, 5), 0.04, 0.03, cv2.aruco.getPredefinedDictionary(dictionaries()[name]))
    return board, np.asarray(made.generateImage((700, 500), marginSize=20), dtype=np.uint8)


def test_charuco_corners_carry_their_ids_when_half_of_the_board_is_hidden() -> None:
    board, image = charuco("DICT_5X5_100")
    whole = Detector(board)(image)
    image[:, 400:] = 255
    part = Detector(board)(image)
    assert whole is not None
    assert part is not None
    assert len(whole.ids) == 24
    assert 8 <= len(part.ids) < 24
    both = dict(zip(whole.ids.tolist(), whole.pixels, strict=True))
    assert max(np.abs(both[int(i)] - p).max() for i, p in zip(part.ids, part.pixels, strict=True)) < 0.5


def test_dictionary_of_a_charuco_board_is_found() -> None:
    board, large = charuco("DICT_6X6_250")
    image = np.asarray(cv2.resize(large, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA), dtype=np.uint8)
    opened = parse_board("charuco:7x5", 0.04, None, None)
    assert opened is not None
    found = complete_charuco(opened, [image], any_dictionary=True, any_marker=True)
    # Smaller dictionaries of a family begin with the same markers.
    assert found.dictionary.startswith("DICT_6X6_")
    assert Detector(found)(image) is not None
    assert (found.cols, found.rows) == (board.cols, board.rows)


@pytest.mark.parametrize("text", ["9", "2x6", "99x6", "charuco:", "nine by six", "9x6x2", "charuco:2x2"])
def test_board_text_without_sense_is_refused(text: str) -> None:
    with pytest.raises(InputError, match="--board"):
        parse_board(text, 0.03, None, None)


@pytest.mark.parametrize("square_m", [0.0001, 24.23])
def test_square_of_a_wrong_unit_is_refused(square_m: float) -> None:
    with pytest.raises(InputError, match="--square"):
        parse_board(None, square_m, None, None)


@pytest.mark.parametrize("text", ["25", " 24.23 ", "2,5"])
def test_square_without_unit_is_refused_with_what_to_type(text: str) -> None:
    with pytest.raises(InputError, match=rf"type --square {text.strip()}mm"):
        parse_square(text)


def test_unknown_dictionary_and_a_marker_larger_than_its_square_are_refused() -> None:
    with pytest.raises(InputError, match="--dictionary"):
        parse_board("charuco:7x5", 0.03, None, "DICT_9X9")
    with pytest.raises(InputError, match="markers smaller than the squares"):
        parse_board("charuco:7x5", 0.03, "40mm", None)


def test_blur_lowers_sharpness() -> None:
    image = drawn(8, 5)
    corners = Detector(Board(8, 5, 0.03))(image)
    assert corners is not None
    blurred = np.asarray(cv2.GaussianBlur(image, (0, 0), 3), dtype=np.uint8)
    assert sharpness(blurred, corners) < 0.6 * sharpness(image, corners)


def test_selection_leaves_out_blurred_and_repeated_views() -> None:
    rng = np.random.default_rng(0)
    rig = random_rig("plain", rng)
    different = board_views(rig, Board(7, 5, 0.04), 10, 0.0, rng)
    views = [different[0]] * 20 + different[1:]
    sharp = [1.0] * 28 + [0.2]
    taken = select_views(views, sharp, rig.left.size, limit=9)
    assert 28 not in taken
    assert set(range(20, 28)) <= set(taken)
